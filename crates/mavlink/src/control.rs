//! Control of an autopilot's mode and arming: times of requests, and the takeover by another. No messages, no I/O.
//!
//! This host asks for its mode only while the vehicle is disarmed, after a second of setpoints. Once another mode is
//! seen after its own, it sends no setpoints any more until its process is started again. It arms once, if it may.

use murmurate::time::{Span, Time};

use super::firmware::Mode;
use super::settings::{Firmware, Vehicle};

/// Time for which setpoints are sent before the mode is asked for. PX4 enters OFFBOARD only if they already arrive.
const BEFORE: Span = Span::from_millis(1000);
/// Period at which the mode, and arming, are asked for again while they are not there.
const AGAIN: Span = Span::from_millis(1000);

/// Request to the autopilot that is due.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Ask for the mode in which it follows setpoints.
    Mode,
    /// Arm it.
    Arm,
}

/// State of an autopilot, as its messages say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Mode that it is in.
    pub mode: Mode,
    /// Whether its motors may turn.
    pub armed: bool,
    /// Whether it reports a failsafe: its state is critical or an emergency.
    pub failsafe: bool,
}

/// Party that commands the autopilot.
#[derive(Clone, Debug, PartialEq)]
enum State {
    /// Nobody is known to. The text says why this host does not ask for its mode, if it could.
    Waiting(Option<String>),
    /// Setpoints are sent since this time; the mode is asked for after `BEFORE`.
    Preparing(Time),
    /// The mode was asked for last at this time.
    Asked(Time),
    /// This host commands it.
    Own,
    /// Somebody else has taken over, for good. The text says who, and which mode.
    Lost(String),
}

/// Control of one autopilot.
#[derive(Clone, Debug)]
pub struct Control {
    firmware: Firmware,
    vehicle: Vehicle,
    /// Whether this host arms the vehicle.
    arm: bool,
    state: State,
    seen: Option<Seen>,
    /// Whether the vehicle was ever armed since this process was started. Then it is not armed by this host again.
    was_armed: bool,
    /// Time at which arming was asked for last.
    arm_asked: Option<Time>,
    /// Mode of the autopilot's own that this host has ordered beside the one of setpoints, such as landing.
    ordered: Option<Mode>,
    /// Whether a copter is to rise, for which it has to be armed.
    rises: bool,
    /// Order that the autopilot refuses, with its reason, as text; `None` if it refuses none.
    refused: Option<String>,
}

impl Control {
    /// Makes the control of an autopilot that has not been heard. With `arm`, this host arms it.
    pub fn new(firmware: Firmware, vehicle: Vehicle, arm: bool) -> Control {
        Control {
            firmware,
            vehicle,
            arm,
            state: State::Waiting(None),
            seen: None,
            was_armed: false,
            arm_asked: None,
            ordered: None,
            rises: false,
            refused: None,
        }
    }

    fn own_mode(&self) -> Mode {
        Mode::followed(self.firmware, self.vehicle)
    }

    fn name(&self, mode: Mode) -> String {
        mode.name(self.firmware, self.vehicle)
    }

    /// Returns the last state of the autopilot; `None` before the first.
    pub fn seen(&self) -> Option<Seen> {
        self.seen
    }

    /// Takes the mode that the autopilot is in at `now`, as one of its messages says, and what is known beside it.
    pub fn see(&mut self, now: Time, seen: Seen) {
        self.was_armed |= seen.armed;
        self.seen = Some(seen);
        let own = seen.mode.is(self.own_mode(), self.firmware);
        let ordered = self.ordered.is_some_and(|mode| seen.mode.is(mode, self.firmware));
        match self.state {
            State::Lost(_) => {}
            State::Own if !own && !ordered => {
                let who = if seen.failsafe { "its failsafe" } else { "the pilot" };
                self.state = State::Lost(format!("{who} took over: mode {}", self.name(seen.mode)));
            }
            State::Own => {}
            _ if own => {
                (self.state, self.refused) = (State::Own, None);
            }
            _ if seen.armed => {
                let why = format!(
                    "it is armed in mode {}: disarm it, or choose {}",
                    self.name(seen.mode),
                    self.name(self.own_mode())
                );
                self.state = State::Waiting(Some(why));
            }
            State::Waiting(_) => self.state = State::Preparing(now),
            State::Preparing(_) | State::Asked(_) => {}
        }
    }

    /// Takes over that the autopilot has begun anew. What it does then, a person has to look at.
    pub fn restarted(&mut self) {
        if self.state == State::Own {
            self.state = State::Lost("it has restarted; start its host again".to_owned());
        }
    }

    /// Takes over that the autopilot is silent: preparations begin anew when it is heard again.
    pub fn silent(&mut self) {
        if matches!(self.state, State::Preparing(_) | State::Asked(_)) {
            self.state = State::Waiting(None);
        }
    }

    /// Takes the refusal of an order, with the reason in words.
    pub fn refuse(&mut self, order: Order, why: &str) {
        self.refused = Some(match order {
            Order::Mode => format!("it refuses mode {}: {why}", self.name(self.own_mode())),
            Order::Arm => format!("it refuses to arm: {why}"),
        });
    }

    /// Takes over that this host orders a mode of the autopilot's own, such as landing, or none any more.
    pub fn order(&mut self, mode: Option<Mode>) {
        self.ordered = mode;
    }

    /// Whether setpoints are sent to the autopilot.
    pub fn streams(&self) -> bool {
        matches!(self.state, State::Preparing(_) | State::Asked(_) | State::Own)
    }

    /// Whether this host commands the autopilot.
    pub fn is_own(&self) -> bool {
        self.state == State::Own
    }

    /// Whether this host commands the autopilot, and its motors may turn.
    pub fn is_ready(&self) -> bool {
        self.is_own() && self.seen.is_some_and(|seen| seen.armed)
    }

    /// Takes whether a copter is to rise and its motors do not turn.
    pub fn rise(&mut self, rises: bool) {
        self.rises = rises;
    }

    /// Takes over that a landing that this host has ordered has ended: the mode is asked for again, and the next
    /// take-off may arm.
    pub fn has_landed(&mut self, now: Time) {
        (self.was_armed, self.arm_asked, self.ordered) = (false, None, None);
        if self.state == State::Own {
            self.state = State::Preparing(now);
        }
    }

    /// Returns the reason for which the autopilot does not follow this host; `None` if it does.
    pub fn fault(&self) -> Option<String> {
        match &self.state {
            State::Lost(why) | State::Waiting(Some(why)) => Some(why.clone()),
            State::Waiting(None) => Some("its mode is unknown".to_owned()),
            State::Preparing(_) | State::Asked(_) => {
                let asked = || format!("mode {} is asked for", self.name(self.own_mode()));
                Some(self.refused.clone().unwrap_or_else(asked))
            }
            State::Own if !self.is_ready() && (self.rises || self.was_armed || self.vehicle == Vehicle::Rover) => {
                let how = match (self.arm, self.was_armed) {
                    (_, true) => "it was disarmed: arm it by hand, or start its host again",
                    (false, _) => "it is not armed: arm it, or set arm = true of its driver",
                    (true, _) => "arming is asked for",
                };
                Some(self.refused.clone().unwrap_or_else(|| how.to_owned()))
            }
            State::Own => None,
        }
    }

    /// Whether this host arms the vehicle: a rover at once, a copter when it is to rise.
    fn arms(&self) -> bool {
        self.arm && self.is_own() && !self.was_armed && (self.rises || self.vehicle == Vehicle::Rover)
    }

    /// Returns the time at which `wake` has to be called next; `None` if nothing is to be asked for.
    pub fn wake_at(&self) -> Option<Time> {
        match self.state {
            State::Preparing(since) => Some(since + BEFORE),
            State::Asked(at) => Some(at + AGAIN),
            State::Own if self.arms() => Some(self.arm_asked.map_or(Time::ZERO, |at| at + AGAIN)),
            _ => None,
        }
    }

    /// Returns the order that is due at `now`.
    pub fn wake(&mut self, now: Time) -> Option<Order> {
        if self.wake_at().is_none_or(|at| at > now) {
            return None;
        }
        if self.state == State::Own {
            self.arm_asked = Some(now);
            return Some(Order::Arm);
        }
        self.state = State::Asked(now);
        Some(Order::Mode)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MANUAL: Mode = Mode(1 << 16);
    const OFFBOARD: Mode = Mode(6 << 16);

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn seen(mode: Mode, armed: bool) -> Seen {
        Seen { mode, armed, failsafe: false }
    }

    fn px4(arm: bool) -> Control {
        Control::new(Firmware::Px4, Vehicle::Rover, arm)
    }

    #[test]
    fn the_mode_is_asked_for_after_a_second_of_setpoints_and_again_until_it_is_there() {
        let mut control = px4(false);
        assert!(!control.streams() && control.wake_at().is_none());
        control.see(at(0), seen(MANUAL, false));
        assert!(control.streams());
        assert_eq!((control.wake(at(999)), control.wake(at(1000))), (None, Some(Order::Mode)));
        control.refuse(Order::Mode, "denied");
        assert_eq!(control.fault().as_deref(), Some("it refuses mode OFFBOARD: denied"));
        assert_eq!((control.wake(at(1999)), control.wake(at(2000))), (None, Some(Order::Mode)));
        control.see(at(2050), seen(OFFBOARD, false));
        assert_eq!(control.wake(at(9000)), None, "arm is not set");
        assert!(control.fault().expect("a reason").contains("set arm = true"));
        control.see(at(2100), seen(OFFBOARD, true));
        assert!(control.is_ready() && control.fault().is_none());
    }

    #[test]
    fn a_pilot_who_takes_over_keeps_it_until_the_process_is_started_again() {
        for armed in [false, true] {
            let mut control = px4(true);
            control.see(at(0), seen(MANUAL, false));
            control.see(at(1100), seen(OFFBOARD, armed));
            assert!(control.streams());
            control.see(at(1200), seen(MANUAL, armed));
            let why = control.fault();
            assert_eq!((control.streams(), why.as_deref()), (false, Some("the pilot took over: mode MANUAL")));
            for ms in (1300..20_000).step_by(100) {
                control.see(at(ms), seen(if ms % 300 == 0 { OFFBOARD } else { MANUAL }, ms % 200 == 0));
                assert!(control.wake(at(ms)).is_none() && !control.streams(), "{ms}");
            }
            assert_eq!(control.fault(), why);
        }
    }

    #[test]
    fn a_failsafe_and_a_restart_are_named_and_kept_as_well() {
        let mut control = px4(false);
        control.see(at(0), seen(OFFBOARD, true));
        control.see(at(10), Seen { failsafe: true, ..seen(Mode(4 << 16 | 6 << 24), true) });
        assert_eq!(control.fault().as_deref(), Some("its failsafe took over: mode AUTO.LAND"));
        let mut control = px4(false);
        control.see(at(0), seen(OFFBOARD, true));
        control.restarted();
        assert!(!control.streams() && control.fault().expect("a reason").contains("restarted"));
    }

    #[test]
    fn a_pilot_of_an_armed_vehicle_is_not_interrupted() {
        let mut control = px4(true);
        control.see(at(0), seen(MANUAL, true));
        assert!(!control.streams() && control.wake_at().is_none());
        assert_eq!(control.fault().as_deref(), Some("it is armed in mode MANUAL: disarm it, or choose OFFBOARD"));
        control.see(at(100), seen(MANUAL, false));
        assert!(control.streams(), "it was disarmed");
        control.see(at(500), seen(MANUAL, true));
        assert!(!control.streams(), "somebody has armed it meanwhile");
    }

    #[test]
    fn it_is_armed_once_and_never_again_after_it_was_disarmed() {
        let mut control = px4(true);
        control.see(at(0), seen(OFFBOARD, false));
        assert_eq!(control.wake(at(10)), Some(Order::Arm));
        assert_eq!((control.wake(at(500)), control.wake(at(1010))), (None, Some(Order::Arm)), "until it is");
        control.see(at(1020), seen(OFFBOARD, true));
        control.see(at(5000), seen(OFFBOARD, false));
        assert_eq!((control.wake_at(), control.wake(at(60_000))), (None, None));
        assert!(control.fault().expect("a reason").contains("was disarmed"));
        let mut taken = px4(true);
        taken.see(at(0), seen(OFFBOARD, true));
        taken.see(at(10), seen(OFFBOARD, false));
        assert_eq!(taken.wake(at(9000)), None, "somebody else had armed it");
    }

    #[test]
    fn a_copter_is_armed_to_rise_and_once_more_after_a_landing_that_was_ordered() {
        let mut control = Control::new(Firmware::Px4, Vehicle::Copter, true);
        control.see(at(0), seen(OFFBOARD, false));
        assert_eq!((control.wake(at(10)), control.fault()), (None, None), "it stands ready");
        control.rise(true);
        assert_eq!(control.wake(at(20)), Some(Order::Arm));
        control.rise(false);
        control.see(at(100), seen(OFFBOARD, true));
        let land = Mode::landing(Firmware::Px4);
        control.order(Some(land));
        control.see(at(200), seen(land, true));
        control.see(at(900), seen(land, false));
        assert!(control.is_own(), "the landing is this host's own");
        control.has_landed(at(900));
        assert_eq!(control.wake(at(1900)), Some(Order::Mode));
        control.see(at(2000), seen(OFFBOARD, false));
        control.rise(true);
        assert_eq!(control.wake(at(2010)), Some(Order::Arm));
        control.see(at(2100), seen(OFFBOARD, true));
        control.see(at(2200), seen(OFFBOARD, false));
        assert_eq!(control.wake(at(9000)), None, "somebody has disarmed it");
        assert!(control.fault().expect("a reason").contains("was disarmed"));
        control.order(Some(land));
        control.see(at(9100), seen(Mode(3 << 16), true));
        assert_eq!(control.fault().as_deref(), Some("the pilot took over: mode POSITION"), "he does not land");
    }

    #[test]
    fn silence_before_the_mode_is_there_begins_anew_and_after_it_changes_nothing() {
        let mut control = px4(false);
        control.see(at(0), seen(MANUAL, false));
        control.silent();
        assert!(!control.streams());
        control.see(at(9000), seen(MANUAL, false));
        assert_eq!((control.wake(at(9900)), control.wake(at(10_000))), (None, Some(Order::Mode)));
        control.see(at(10_010), seen(OFFBOARD, true));
        control.silent();
        assert!(control.streams() && control.is_ready());
    }
}
