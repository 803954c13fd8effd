//! Flight of a copter in its session: orders of its Body, and the state of its flight.

use mavlink::dialects::common::MavMessage;
use murmurate::drivers::{Out, Vertical};
use murmurate::time::Time;

use super::super::firmware::Mode;
use super::super::link::Hold;
use super::super::orders;
use super::Session;

impl Session {
    /// Carries out an order of the Body. A copter that another flies is left to that pilot, but for `Cut`.
    pub(super) fn steer(&mut self, now: Time, order: Vertical, out: &mut Vec<Out>) {
        let Some(lift) = &mut self.lift else { return };
        match order {
            Vertical::Rise { height_m } if self.control.is_own() => lift.rise(height_m),
            Vertical::Rise { .. } => {}
            Vertical::Land if self.control.is_own() => {
                lift.land();
                if lift.lands() {
                    let mode = Mode::landing(self.config.firmware);
                    self.control.order(Some(mode));
                    self.send(Hold::Standing, &[orders::set_mode(&self.config, mode)], out);
                }
            }
            Vertical::Land => lift.leave(),
            Vertical::Cut => self.send(Hold::Standing, &[orders::cut(&self.config.link)], out),
        }
        // An order that changes nothing is answered, too.
        self.flight = None;
        self.go_on(now, out);
    }

    /// Takes whether the motors may turn.
    pub(super) fn armed(&mut self, now: Time, armed: bool) {
        let Some(lift) = &mut self.lift else { return };
        if !self.control.is_own() {
            lift.leave();
        }
        if lift.armed(armed) {
            self.control.has_landed(now);
        }
        self.control.rise(lift.waits_for_arming());
    }

    /// Returns the request to take off, if it is due.
    pub(super) fn takes_off(&mut self, now: Time) -> Option<MavMessage> {
        let own = self.control.is_own();
        let lift = self.lift.as_mut().filter(|_| own)?;
        self.control.rise(lift.waits_for_arming());
        lift.take_off(now).map(|height_m| orders::take_off(&self.config.link, height_m))
    }

    /// Reports the state of the flight if it has changed.
    pub(super) fn report_flight(&mut self, out: &mut Vec<Out>) {
        let flight = self.lift.as_ref().and_then(|lift| lift.flight());
        if flight.is_some() && self.flight != flight {
            self.flight = flight;
            out.extend(flight.map(Out::Flight));
        }
    }
}
