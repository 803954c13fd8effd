//! Height of a copter: when it rises, holds its height and lands, by what its autopilot reports. No messages, no I/O.

use mavlink::dialects::common::MavLandedState;
use murmurate::messages::wire::Flight;
use murmurate::time::{Span, Time};

use super::settings::Firmware;

/// Largest age of a height by which the copter is held at its own.
const HEIGHT: Span = Span::from_millis(500);
/// Speeds at which a copter climbs and sinks to its height \[m/s\], at the most, and the share of the way for which it
/// does so in a second.
const CLIMB: (f64, f64, f64) = (0.7, 0.5, 1.0);
/// Distance from its height within which a copter is there \[m\], and the same as a share of the height.
const THERE: (f64, f64) = (0.1, 0.1);
/// Period at which the take-off is asked for again while the copter is on the ground.
const AGAIN: Span = Span::from_millis(1000);

/// Order that this host has given.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Plan {
    /// Nothing: the copter does what its autopilot or its pilot does.
    None,
    /// To rise to this height above the ground \[m\]; take-off was asked for last at the time.
    Rise(f64, Option<Time>),
    /// To stay at this height above the ground \[m\].
    Hold(f64),
    /// To land.
    Land,
}

/// Height of one copter.
#[derive(Clone, Debug)]
pub struct Lift {
    firmware: Firmware,
    plan: Plan,
    /// Height above the autopilot's origin \[m\], with its arrival; `None` before the first.
    height: Option<(Time, f64)>,
    /// Height of the ground above the autopilot's origin \[m\], where the copter rose.
    ground_m: f64,
    landed: MavLandedState,
    /// Whether the motors may turn; `None` before it is known.
    armed: Option<bool>,
}

impl Lift {
    /// Makes the height of a copter of which nothing is known.
    pub fn new(firmware: Firmware) -> Lift {
        let landed = MavLandedState::MAV_LANDED_STATE_UNDEFINED;
        Lift { firmware, plan: Plan::None, height: None, ground_m: 0.0, landed, armed: None }
    }

    /// Takes an order to rise to a height above the ground \[m\].
    pub fn rise(&mut self, height_m: f32) {
        if matches!(self.plan, Plan::None | Plan::Land) && self.flight() == Some(Flight::Grounded) {
            self.ground_m = self.height.map_or(0.0, |(_, height_m)| height_m);
            self.plan = Plan::Rise(height_m.into(), None);
        }
    }

    /// Takes an order to land.
    pub fn land(&mut self) {
        self.plan = if self.flight() == Some(Flight::Grounded) { Plan::None } else { Plan::Land };
    }

    /// Takes over that this host orders nothing any more: another flies the copter.
    pub fn leave(&mut self) {
        self.plan = Plan::None;
    }

    /// Takes the height above the autopilot's origin \[m\].
    pub fn height(&mut self, now: Time, height_m: f64) {
        if height_m.is_finite() {
            self.height = Some((now, height_m));
        }
        self.arrive();
    }

    /// Takes whether the copter is on the ground, as its autopilot says.
    pub fn landed(&mut self, landed: MavLandedState) {
        self.landed = landed;
    }

    /// Takes whether the motors may turn. Returns whether a landing of this host has ended by it.
    pub fn armed(&mut self, armed: bool) -> bool {
        let was = self.armed.replace(armed);
        let ended = !armed && self.plan == Plan::Land;
        // A copter that was disarmed in any other way is not armed again.
        if !armed && (ended || was == Some(true)) {
            self.plan = Plan::None;
        }
        ended
    }

    fn arrive(&mut self) {
        let (Plan::Rise(height_m, _), Some(true), Some((_, now_m))) = (self.plan, self.armed, self.height) else {
            return;
        };
        if now_m - self.ground_m > height_m - THERE.0.max(THERE.1 * height_m) {
            self.plan = Plan::Hold(height_m);
        }
    }

    /// Returns the state of the flight; `None` before it is known.
    pub fn flight(&self) -> Option<Flight> {
        let armed = self.armed?;
        Some(match self.plan {
            _ if !armed => Flight::Grounded,
            Plan::Rise(..) => Flight::Rising,
            Plan::Hold(_) => Flight::Flying,
            Plan::Land => Flight::Landing,
            Plan::None => match self.landed {
                MavLandedState::MAV_LANDED_STATE_IN_AIR | MavLandedState::MAV_LANDED_STATE_TAKEOFF => Flight::Flying,
                MavLandedState::MAV_LANDED_STATE_LANDING => Flight::Landing,
                _ => Flight::Grounded,
            },
        })
    }

    /// Whether the copter is to rise and its motors do not turn.
    pub fn waits_for_arming(&self) -> bool {
        matches!(self.plan, Plan::Rise(..)) && self.armed == Some(false)
    }

    /// Whether the copter is to land, or lands.
    pub fn lands(&self) -> bool {
        self.plan == Plan::Land
    }

    /// Whether the autopilot rises by itself, so that setpoints would interrupt it: ArduPilot does.
    pub fn rises_by_itself(&self) -> bool {
        self.firmware == Firmware::ArduPilot && matches!(self.plan, Plan::Rise(..))
    }

    /// Whether the copter may be driven: it is at the height that this host has ordered.
    pub fn is_driven(&self) -> bool {
        matches!(self.plan, Plan::Hold(_)) && self.armed == Some(true)
    }

    /// Returns the height for which take-off is to be asked for at `now` \[m\]; `None` if it is not.
    pub fn take_off(&mut self, now: Time) -> Option<f32> {
        let Plan::Rise(height_m, asked) = self.plan else { return None };
        let on_ground = !matches!(self.landed, MavLandedState::MAV_LANDED_STATE_IN_AIR);
        let due = asked.is_none_or(|at| on_ground && now.since(at) >= AGAIN);
        if !(due && self.rises_by_itself() && self.armed == Some(true)) {
            return None;
        }
        self.plan = Plan::Rise(height_m, Some(now));
        Some(height_m as f32)
    }

    /// Returns the speed upwards of a setpoint \[m/s\]: towards the height, and zero while the own height is unknown.
    pub fn climb_m_s(&self, now: Time) -> f32 {
        let wanted_m = match self.plan {
            Plan::Rise(height_m, _) | Plan::Hold(height_m) => height_m,
            Plan::None | Plan::Land => return 0.0,
        };
        let Some((_, now_m)) = self.height.filter(|(at, _)| now.since(*at) <= HEIGHT) else { return 0.0 };
        let way_m = wanted_m - (now_m - self.ground_m);
        (CLIMB.2 * way_m).clamp(-CLIMB.1, CLIMB.0) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// A copter on the ground, 12 m above its origin.
    fn grounded(firmware: Firmware) -> Lift {
        let mut lift = Lift::new(firmware);
        assert_eq!(lift.flight(), None);
        lift.armed(false);
        lift.height(at(0), 12.0);
        lift
    }

    #[test]
    fn a_copter_rises_from_where_it_stands_and_is_held_there() {
        let mut lift = grounded(Firmware::Px4);
        lift.rise(1.5);
        assert!(lift.waits_for_arming() && lift.flight() == Some(Flight::Grounded) && !lift.is_driven());
        lift.armed(true);
        assert_eq!((lift.flight(), lift.climb_m_s(at(0)), lift.take_off(at(0))), (Some(Flight::Rising), 0.7, None));
        lift.height(at(2000), 13.3);
        assert_eq!((lift.flight(), lift.is_driven()), (Some(Flight::Rising), false));
        lift.height(at(2100), 13.4);
        assert_eq!((lift.flight(), lift.is_driven()), (Some(Flight::Flying), true));
        lift.height(at(2200), 14.5);
        assert_eq!(lift.climb_m_s(at(2200)), -0.5, "it is too high");
        assert_eq!(lift.climb_m_s(at(2800)), 0.0, "its height is old");
    }

    #[test]
    fn ardupilot_is_asked_to_take_off_once_and_again_while_it_is_on_the_ground() {
        let mut lift = grounded(Firmware::ArduPilot);
        lift.rise(1.5);
        assert_eq!(lift.take_off(at(0)), None, "it is not armed");
        lift.armed(true);
        assert!(lift.rises_by_itself());
        assert_eq!(
            (lift.take_off(at(0)), lift.take_off(at(500)), lift.take_off(at(1000))),
            (Some(1.5), None, Some(1.5))
        );
        lift.landed(MavLandedState::MAV_LANDED_STATE_IN_AIR);
        assert_eq!(lift.take_off(at(3000)), None);
        lift.height(at(4000), 13.5);
        assert!(lift.is_driven() && !lift.rises_by_itself());
    }

    #[test]
    fn a_landing_ends_when_the_motors_do_not_turn() {
        let mut lift = grounded(Firmware::Px4);
        lift.rise(1.0);
        lift.armed(true);
        lift.height(at(100), 13.0);
        lift.land();
        assert_eq!((lift.flight(), lift.lands(), lift.is_driven()), (Some(Flight::Landing), true, false));
        assert!(!lift.armed(true) && lift.armed(false), "it has landed");
        assert_eq!(lift.flight(), Some(Flight::Grounded));
        lift.land();
        assert!(!lift.lands(), "there is nothing to land");
    }

    #[test]
    fn a_copter_that_somebody_disarms_or_flies_is_left_to_him() {
        let mut lift = grounded(Firmware::Px4);
        lift.rise(1.0);
        lift.armed(true);
        assert!(!lift.armed(false), "no landing of this host");
        assert!(!lift.waits_for_arming(), "it is not armed again");
        lift.rise(1.0);
        lift.armed(true);
        lift.leave();
        lift.landed(MavLandedState::MAV_LANDED_STATE_IN_AIR);
        assert_eq!((lift.flight(), lift.is_driven()), (Some(Flight::Flying), false));
    }
}
