//! Pilot: when a robot that flies rises, hovers and lands. It does no more than order; the robot's driver carries out
//! the orders and reports the state of the flight.

use crate::drivers::Vertical;
use crate::flight::{InAir, Settings};
use crate::messages::latch::Latch;
use crate::messages::phase::Phase;
use crate::messages::wire::Flight;
use crate::time::{Span, Time};

/// Time for which a robot hovers after a stop, before it lands. A choice of this project: long enough for the operator
/// to see where it stands, short enough that a stop is not a flight.
pub const HOVER: Span = Span::from_millis(1000);
/// Silence of the state server after which a robot in the air lands: the second after which a guard stops its robot,
/// and a second of hovering.
pub const SILENCE: Span = Span::from_millis(2000);
/// Period at which an order is repeated that the state of the flight does not follow, since packets to robots get lost.
const REPEAT: Span = Span::from_millis(500);

/// Decides about the height of one robot that flies.
#[derive(Clone, Debug)]
pub(super) struct Pilot {
    settings: Settings,
    /// State of the flight that the driver reported last; `None` before its first report.
    flight: Option<Flight>,
    /// Phase of the team in the last instruction of the state server; `None` before the first.
    phase: Option<Phase>,
    /// Whether the robot rises: since a reset has begun, until it has left the ground once. A robot that comes down by
    /// itself stays there until the next reset.
    rises: bool,
    /// Time of the last instruction of the state server; of the first event before there is one.
    heard: Option<Time>,
    /// Time since which the emergency stop is engaged, and whether it is engaged or held now.
    stopped: Option<Time>,
    clear: bool,
    /// Time of the last order, and the order.
    ordered: Option<(Time, Vertical)>,
}

impl Pilot {
    /// Makes the pilot of a robot of which nothing is known yet.
    pub(super) fn new(settings: Settings) -> Pilot {
        Pilot {
            settings,
            flight: None,
            phase: None,
            rises: false,
            heard: None,
            stopped: None,
            clear: false,
            ordered: None,
        }
    }

    /// Whether the robot is at its height and stays there, so that it may be driven.
    pub(super) fn is_at_height(&self) -> bool {
        self.flight == Some(Flight::Flying) && !self.lands()
    }

    /// Whether the robot was ordered down and is not there yet.
    fn lands(&self) -> bool {
        matches!(self.ordered, Some((_, Vertical::Land | Vertical::Cut)))
    }

    /// State of the flight for others: a robot that is ordered to land is landing. `None` before the driver's first
    /// report.
    pub(super) fn flight(&self) -> Option<Flight> {
        match self.flight? {
            Flight::Flying if !self.is_at_height() => Some(Flight::Landing),
            flight => Some(flight),
        }
    }

    /// Takes the state of the flight that the driver reports.
    pub(super) fn take(&mut self, flight: Flight) {
        self.flight = Some(flight);
        self.rises &= !matches!(flight, Flight::Rising | Flight::Flying) || self.lands();
        // What was ordered in the air is over on the ground, so that the next flight begins with an order of its own.
        if flight == Flight::Grounded && self.lands() {
            self.ordered = None;
        }
    }

    /// Takes the phase of the team from an instruction of the state server that arrived at `now`.
    pub(super) fn instructed(&mut self, now: Time, phase: Phase) {
        self.heard = Some(now);
        if self.phase.replace(phase) != Some(phase) {
            let up = matches!(self.flight, Some(Flight::Rising | Flight::Flying)) && !self.lands();
            self.rises = phase == Phase::Resetting && !up;
        }
    }

    /// Takes the emergency stop state that the Body follows since `now`.
    pub(super) fn latched(&mut self, now: Time, latch: Latch) {
        self.clear = latch.is_clear();
        self.stopped = latch.is_engaged().then(|| self.stopped.unwrap_or(now));
    }

    /// Returns the order that is due at `now`, which the caller gives to the driver. `fit` says whether battery,
    /// temperature and driver permit motion, and `leaves` whether the host is shutting down.
    pub(super) fn order(&mut self, now: Time, fit: bool, leaves: bool) -> Option<Vertical> {
        let heard = *self.heard.get_or_insert(now);
        let grounded = self.flight == Some(Flight::Grounded);
        let silent = now.since(heard) >= SILENCE;
        let stopped = self.settings.stop == InAir::Land && self.stopped.is_some_and(|at| now.since(at) >= HOVER);
        // A landing that has begun ends on the ground, whatever comes.
        let order = match () {
            () if grounded && self.rises && self.clear && fit && !leaves && !silent => {
                Some(Vertical::Rise { height_m: self.settings.height_m })
            }
            () if !grounded && (leaves || !fit || self.is_over() || silent || stopped || self.lands()) => {
                Some(Vertical::Land)
            }
            () => None,
        }?;
        let since = self.ordered.filter(|(_, last)| *last == order).map(|(at, _)| at);
        if since.is_some_and(|at| now.since(at) < REPEAT) || !self.is_repeated(order, since.is_some()) {
            return None;
        }
        self.ordered = Some((now, order));
        Some(order)
    }

    /// Whether the trial is over.
    fn is_over(&self) -> bool {
        self.phase == Some(Phase::EpisodesFinished)
    }

    /// Whether `order` is given now: at once if it is new, and again while the state of the flight does not follow it.
    fn is_repeated(&self, order: Vertical, given: bool) -> bool {
        let follows = match order {
            Vertical::Rise { .. } => matches!(self.flight, Some(Flight::Rising | Flight::Flying)),
            Vertical::Land | Vertical::Cut => matches!(self.flight, Some(Flight::Landing | Flight::Grounded)),
        };
        !given || !follows
    }

    /// Returns the time at which `order` has to be called next, if nothing else happens.
    pub(super) fn wake_at(&self) -> Option<Time> {
        if self.flight == Some(Flight::Grounded) {
            return self.ordered.map(|(at, _)| at + REPEAT).filter(|_| self.rises);
        }
        let lands = self.settings.stop == InAir::Land;
        let begun = self.ordered.is_some_and(|(_, order)| order == Vertical::Land);
        let after_stop = self.stopped.filter(|_| lands && !begun).map(|at| at + HOVER);
        let after_silence = self.heard.filter(|_| !begun).map(|at| at + SILENCE);
        let again = self.ordered.filter(|_| begun && self.flight != Some(Flight::Landing)).map(|(at, _)| at + REPEAT);
        [after_stop, after_silence, again].into_iter().flatten().min()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RISE: Vertical = Vertical::Rise { height_m: 0.5 };

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Returns the pilot of a robot that has been at its height since the time zero.
    fn aloft(stop: InAir) -> Pilot {
        let mut pilot = Pilot::new(Settings { height_m: 0.5, stop });
        pilot.latched(at(0), Latch::default());
        pilot.take(Flight::Grounded);
        pilot.instructed(at(0), Phase::Resetting);
        assert_eq!(pilot.order(at(0), true, false), Some(RISE));
        pilot.take(Flight::Rising);
        pilot.take(Flight::Flying);
        pilot
    }

    #[test]
    fn a_robot_rises_for_a_reset_alone_and_while_all_permits_it() {
        let mut pilot = Pilot::new(Settings { height_m: 0.5, stop: InAir::Land });
        pilot.take(Flight::Grounded);
        pilot.instructed(at(0), Phase::Running);
        pilot.latched(at(0), Latch::default());
        assert_eq!(pilot.order(at(0), true, false), None, "it was not in the air when the episode began");
        pilot.instructed(at(10), Phase::NeedReset);
        pilot.instructed(at(20), Phase::Resetting);
        assert_eq!(pilot.order(at(20), false, false), None, "its battery is low");
        assert_eq!(pilot.order(at(20), true, true), None, "its host ends");
        pilot.latched(at(20), Latch::held(2));
        assert_eq!(pilot.order(at(20), true, false), None, "the team is held");
        pilot.latched(at(20), Latch::clear(3));
        assert_eq!(pilot.order(at(20), true, false), Some(RISE));
        assert_eq!(pilot.order(at(519), true, false), None, "not with every message");
        assert_eq!((pilot.wake_at(), pilot.order(at(520), true, false)), (Some(at(520)), Some(RISE)), "it was lost");
        assert!(!pilot.is_at_height());
    }

    #[test]
    fn a_robot_that_comes_down_by_itself_stays_there_until_the_next_reset() {
        let mut pilot = aloft(InAir::Land);
        assert!(pilot.is_at_height());
        pilot.take(Flight::Grounded);
        for ms in [100, 700, 1300] {
            pilot.instructed(at(ms), Phase::Resetting);
            assert_eq!(pilot.order(at(ms), true, false), None);
        }
        pilot.instructed(at(1400), Phase::NeedReset);
        pilot.instructed(at(1500), Phase::Resetting);
        assert_eq!(pilot.order(at(1500), true, false), Some(RISE));
    }

    #[test]
    fn a_stopped_robot_hovers_then_lands_to_the_ground_whatever_comes() {
        let mut pilot = aloft(InAir::Land);
        pilot.instructed(at(1000), Phase::Running);
        pilot.latched(at(1000), Latch::engaged(1));
        assert_eq!(pilot.order(at(1000), true, false), None);
        assert_eq!(pilot.wake_at(), Some(at(2000)));
        assert_eq!(pilot.order(at(2000), true, false), Some(Vertical::Land));
        assert_eq!((pilot.is_at_height(), pilot.flight()), (false, Some(Flight::Landing)));
        pilot.latched(at(2100), Latch::clear(3));
        pilot.instructed(at(2100), Phase::Resetting);
        assert_eq!(pilot.order(at(2500), true, false), Some(Vertical::Land), "the order was lost");
        pilot.take(Flight::Landing);
        pilot.take(Flight::Grounded);
        assert_eq!(pilot.order(at(2600), true, false), Some(RISE), "the team goes on");

        let mut pilot = aloft(InAir::Hover);
        pilot.instructed(at(1000), Phase::Running);
        pilot.latched(at(1000), Latch::engaged(1));
        assert_eq!(pilot.order(at(2900), true, false), None);
        assert_eq!(pilot.order(at(2900), false, false), Some(Vertical::Land), "its battery is low");
    }

    #[test]
    fn a_robot_lands_at_the_end_without_the_state_server_and_when_its_host_ends() {
        let mut pilot = aloft(InAir::Land);
        assert_eq!(pilot.order(at(1999), true, false), None);
        assert_eq!((pilot.wake_at(), pilot.order(at(2000), true, false)), (Some(at(2000)), Some(Vertical::Land)));
        let mut pilot = aloft(InAir::Land);
        assert_eq!(pilot.order(at(10), true, true), Some(Vertical::Land));
        let mut pilot = aloft(InAir::Land);
        pilot.instructed(at(10), Phase::EpisodesFinished);
        assert_eq!(pilot.order(at(10), true, false), Some(Vertical::Land));
    }
}
