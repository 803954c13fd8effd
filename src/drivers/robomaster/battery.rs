//! Battery of the robot: when to ask for its charge, and when it is too low to move.

use crate::time::{Span, Time};

/// Charge above the least at which a robot may move again \[%\]: a battery recovers when the motors stop.
const RECOVERED: u8 = 3;

/// Battery of one robot.
#[derive(Clone, Debug)]
pub struct Battery {
    /// Charge at which the robot stops \[%\]; zero for none.
    least: u8,
    period: Span,
    /// Charge \[%\]; `None` until the robot has told it.
    pub charge: Option<u8>,
    /// Time of the next question.
    pub due: Time,
    /// Whether the charge is too low to move.
    pub low: bool,
}

impl Battery {
    /// Makes a battery of unknown charge. The robot stops at the charge `least` (0 to 1, 0 for never) and is asked
    /// every `period_s` \[s\].
    pub fn new(least: f32, period_s: f64) -> Battery {
        let least = (least * 100.0).round() as u8;
        Battery { least, period: Span::from_secs(period_s), charge: None, due: Time::ZERO, low: false }
    }

    /// Postpones the next query of the charge by one period.
    pub fn asked(&mut self, now: Time) {
        self.due = now + self.period;
    }

    /// Takes an answer \[%\].
    pub fn take(&mut self, charge: u8) {
        let recovered = self.least.saturating_add(RECOVERED).min(100);
        self.low = self.least > 0 && (charge <= self.least || (self.low && charge < recovered));
        self.charge = Some(charge);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_low_battery_has_to_recover() {
        let mut battery = Battery::new(0.2, 5.0);
        let low = [25, 21, 20, 21, 22, 23, 21].map(|charge| {
            battery.take(charge);
            battery.low
        });
        assert_eq!(low, [false, false, true, true, true, false, false]);
        let mut any = Battery::new(0.0, 5.0);
        any.take(0);
        assert!(!any.low, "no least charge is set");
    }
}
