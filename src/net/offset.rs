//! How far the clock of another host lies from this one's, from stamps that came back (RFC 5905, section 8).
//!
//! Only for people and logs: no age and no order is ever reckoned from it.

use std::collections::VecDeque;

use super::report::{Entry, Stamp};
use crate::time::Time;

/// How many of the newest measurements the best is taken from (RFC 5905, section 10: the clock filter has 8).
const KEPT: usize = 8;
/// How fast two clocks may drift apart (RFC 5905: 15 ppm for one).
const DRIFT: f64 = 30e-6;

/// How far another clock is ahead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// The other clock less this one \[s\].
    pub ahead_s: f64,
    /// It is this much less or more at the most \[s\]: half the way there and back, and drift since.
    pub uncertainty_s: f64,
    /// The shortest way there and back that was seen lately \[s\].
    pub round_trip_s: f64,
}

/// The newest measurements: when, clock ahead \[s\], there and back \[s\].
#[derive(Clone, Debug, Default)]
pub struct Offsets(VecDeque<(Time, f64, f64)>);

impl Offsets {
    /// Takes up what came back: an entry about this host in a report written at `theirs` on the other clock.
    pub fn measure(&mut self, now: Time, theirs: Stamp, entry: &Entry) {
        let here = now.as_nanos() as f64 * 1e-9;
        let (sent, written) = (entry.echo.micros() as f64 * 1e-6, theirs.micros() as f64 * 1e-6);
        let round_trip = here - sent - entry.held.as_secs();
        // A sender that has held it for longer than it was under way tells tales.
        if round_trip >= -1e-5 {
            let round_trip = round_trip.max(0.0);
            if self.0.len() == KEPT {
                self.0.pop_front();
            }
            self.0.push_back((now, written + 0.5 * round_trip - here, round_trip));
        }
    }

    /// The best estimate: that of the shortest way there and back.
    pub fn estimate(&self, now: Time) -> Option<Offset> {
        let of = |&(at, ahead_s, round_trip_s): &(Time, f64, f64)| {
            let uncertainty_s = 0.5 * round_trip_s + DRIFT * now.since(at).as_secs() + 1e-6;
            Offset { ahead_s, uncertainty_s, round_trip_s }
        };
        self.0.iter().map(of).min_by(|a, b| a.uncertainty_s.total_cmp(&b.uncertainty_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::ids::HostId;
    use crate::time::Span;

    #[test]
    fn the_true_offset_lies_within_the_uncertainty() {
        let mut offsets = Offsets::default();
        let at_us = |us: u64| Time::ZERO + Span::from_nanos(us * 1000);
        // The other clock is 3 s ahead; 200 us there, 5 ms held, 600 us and then 100 us back.
        for (start, back) in [(1_000_000, 600), (2_000_000, 100)] {
            let theirs = Stamp::of(at_us(start + 200 + 5000 + 3_000_000));
            let (host, held) = (HostId(0), Span::from_millis(5));
            let entry = Entry { host, epoch: 1, echo: Stamp::of(at_us(start)), held, lost: 0, direct: 0 };
            offsets.measure(at_us(start + 5200 + back), theirs, &entry);
        }
        let offset = offsets.estimate(at_us(2_100_000)).unwrap();
        assert!((offset.ahead_s - 3.0).abs() <= offset.uncertainty_s, "{offset:?}");
        assert!((offset.round_trip_s - 300e-6).abs() < 2e-6 && offset.uncertainty_s < 160e-6, "{offset:?}");
    }
}
