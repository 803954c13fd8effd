//! Driver of simulated robots, whose commands go to their World. A simulated robot that flies has its height here,
//! since Worlds are of the plane: it rises and lands at a constant speed, and its battery is full until a fault plan
//! says otherwise.

use std::cell::RefCell;
use std::rc::Rc;

use super::{Command, Driver, Limits, Out, Vertical};
use crate::messages::wire::{Flight, Hardware, Health};
use crate::time::{Span, Time};

/// Speed at which a simulated robot rises and lands \[m/s\]: that of the high-level commander of small quadrotors.
const SPEED_M_S: f32 = 0.5;

/// Height of a simulated robot that flies, which outlives restarts of its Body as that of a real robot does.
#[derive(Clone, Copy, Debug)]
pub struct Lift {
    flight: Flight,
    /// Height at `since` \[m\], and the height to which the robot goes \[m\].
    from_m: f32,
    to_m: f32,
    since: Time,
}

impl Default for Lift {
    fn default() -> Lift {
        Lift { flight: Flight::Grounded, from_m: 0.0, to_m: 0.0, since: Time::ZERO }
    }
}

impl Lift {
    /// Returns the height above the ground at `now` \[m\].
    fn height_m(&self, now: Time) -> f32 {
        let way = SPEED_M_S * now.since(self.since).as_secs() as f32;
        if self.to_m > self.from_m { (self.from_m + way).min(self.to_m) } else { (self.from_m - way).max(self.to_m) }
    }

    /// Returns the time at which the robot arrives at the height to which it goes; `None` if it goes to none.
    fn arrival(&self) -> Option<Time> {
        let goes = matches!(self.flight, Flight::Rising | Flight::Landing);
        goes.then(|| self.since + Span::from_secs(f64::from((self.to_m - self.from_m).abs() / SPEED_M_S)))
    }

    fn go(&mut self, now: Time, flight: Flight, to_m: f32) {
        (self.from_m, self.to_m, self.since, self.flight) = (self.height_m(now), to_m, now, flight);
    }

    fn order(&mut self, now: Time, order: Vertical) {
        match order {
            Vertical::Rise { height_m } => self.go(now, Flight::Rising, height_m),
            Vertical::Land if self.flight != Flight::Grounded => self.go(now, Flight::Landing, 0.0),
            Vertical::Land => {}
            Vertical::Cut => *self = Lift { since: now, ..Lift::default() },
        }
    }

    fn arrive(&mut self, now: Time) {
        if self.arrival().is_some_and(|at| at <= now) {
            let arrived = if self.flight == Flight::Rising { Flight::Flying } else { Flight::Grounded };
            (self.from_m, self.since, self.flight) = (self.to_m, now, arrived);
        }
    }
}

/// Driver of a simulated robot: passes each command on to the World that simulates the robot.
#[derive(Default)]
pub struct Simulated {
    /// Height of a robot that flies; `None` for one that stays on the ground.
    lift: Option<Rc<RefCell<Lift>>>,
    /// State of the flight that was reported last; `None` before the first report.
    told: Option<Flight>,
}

impl Simulated {
    /// Makes the driver of a robot that flies, with its height, or of one that stays on the ground.
    pub fn with(lift: Option<Rc<RefCell<Lift>>>) -> Simulated {
        Simulated { lift, told: None }
    }

    fn report(&mut self, out: &mut Vec<Out>) {
        let Some(flight) = self.lift.as_ref().map(|lift| lift.borrow().flight) else { return };
        if self.told.replace(flight) != Some(flight) {
            out.push(Out::Flight(flight));
        }
    }
}

impl Driver for Simulated {
    fn limits(&self) -> Limits {
        Limits { speed_m_s: f32::INFINITY }
    }

    fn drive(&mut self, _: Time, command: &Command, out: &mut Vec<Out>) {
        out.push(Out::Drive(command.drive));
    }

    fn receive(&mut self, _: Time, packet: &[u8], out: &mut Vec<Out>) {
        // A simulated robot has no worker: the only packet is the charge that a fault plan gives it.
        match (packet, &self.lift) {
            ([charge], Some(_)) => {
                out.push(Out::Condition(Hardware { battery: Some(*charge), ..Hardware::of(Health::Ready) }));
            }
            _ => out.push(Out::Refused("a simulated robot has no worker")),
        }
    }

    fn flies(&self) -> bool {
        self.lift.is_some()
    }

    fn fly(&mut self, now: Time, order: Vertical, out: &mut Vec<Out>) {
        self.lift.iter().for_each(|lift| lift.borrow_mut().order(now, order));
        self.report(out);
    }

    fn wake_at(&self) -> Option<Time> {
        let lift = self.lift.as_ref()?.borrow();
        if self.told.is_none() { Some(Time::ZERO) } else { lift.arrival() }
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.told.is_none() && self.lift.is_some() {
            out.push(Out::Condition(Hardware { battery: Some(100), ..Hardware::of(Health::Ready) }));
        }
        self.lift.iter().for_each(|lift| lift.borrow_mut().arrive(now));
        self.report(out);
    }
}
