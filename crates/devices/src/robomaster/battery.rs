//! Battery of the robot: when to ask for its charge, and when it is too low to move.

use murmurate::time::{Span, Time};

/// Charge above the stop limit at which a robot that was stopped may move again \[percentage points\]: a battery's
/// charge appears to rise when the motors stop.
const RECOVERED: u8 = 3;

/// State of one robot's battery: its charge, whether that is too low to move, and the time of the next query.
#[derive(Clone, Debug)]
pub struct Battery {
    /// Charge at which the robot stops \[%\]; zero for no limit.
    least: u8,
    period: Span,
    /// Charge \[%\] that the robot reported last; `None` before its first report.
    pub charge: Option<u8>,
    /// Time at which the charge has to be queried next.
    pub due: Time,
    /// Whether the charge is too low to move.
    pub low: bool,
}

impl Battery {
    /// Makes the state of a battery of unknown charge. The robot stops at the charge `least` (0 to 1; 0 for never), and
    /// its charge is queried every `period_s` \[s\].
    pub fn new(least: f32, period_s: f64) -> Battery {
        let least = (least * 100.0).round() as u8;
        Battery { least, period: Span::from_secs(period_s), charge: None, due: Time::ZERO, low: false }
    }

    /// Stores that the charge was queried at `now`: the next query is due one period later.
    pub fn asked(&mut self, now: Time) {
        self.due = now + self.period;
    }

    /// Stores a charge \[%\] that the robot has reported, and updates whether it is too low to move. After it was too
    /// low, it stays so until the charge is 3 percentage points above the limit.
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
