//! Clock offset between the stamps of two hosts, from echoed stamps (RFC 5905, section 8).
//!
//! Stamps start at a random value, so the offset itself has no meaning. It is used to find how long a report was in
//! transit.

use std::collections::VecDeque;

use super::report::{Entry, Stamp};
use crate::time::{Span, Time};

/// Number of measurements kept. The one with the smallest error is used (RFC 5905, section 10: the clock filter has 8).
const KEPT: usize = 8;
/// Largest drift between two clocks \[s/s\] (RFC 5905: 15 ppm for one clock).
const DRIFT: f64 = 30e-6;

/// Estimated offset between the clock of another host and that of this host, with its error bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// Stamps of the other host minus those of this host \[s\].
    pub ahead_s: f64,
    /// Bound on the error of the offset \[s\]: half of the round trip, and the drift since the measurement.
    pub uncertainty_s: f64,
    /// Round-trip time of the link reports from which the offset was measured \[s\].
    pub round_trip_s: f64,
}

/// Recent measurements of the offset between the stamps of another host and those of this host.
#[derive(Clone, Debug, Default)]
pub struct Offsets(VecDeque<(Time, f64, f64)>);

impl Offsets {
    /// Adds a measurement from a link report of the other host that arrived at `now`, and returns its round trip \[s\].
    /// `entry` is the report's entry about this host, `theirs` its stamp, and `here` the stamp of this host's clock at
    /// `now`. `None` for a round trip that cannot be, which is left out.
    pub fn measure(&mut self, now: Time, here: Stamp, theirs: Stamp, entry: &Entry) -> Option<f64> {
        let round_trip = here.ahead_us(entry.echo) as f64 * 1e-6 - entry.held.as_secs();
        // A negative round trip means that the sender claims to have held the stamp for longer than possible.
        let round_trip = Some(round_trip).filter(|round_trip| *round_trip >= -1e-5)?.max(0.0);
        if self.0.len() == KEPT {
            self.0.pop_front();
        }
        self.0.push_back((now, theirs.ahead_us(here) as f64 * 1e-6 + 0.5 * round_trip, round_trip));
        Some(round_trip)
    }

    /// Returns whether a link report that arrived at `now` was certainly in transit for longer than `most`, or was
    /// stamped by another clock than the measured one. `theirs` is its stamp, `here` the stamp of this host's clock at
    /// `now`. `false` without a measurement.
    pub fn is_off(&self, now: Time, here: Stamp, theirs: Stamp, most: Span) -> bool {
        let Some(offset) = self.estimate(now) else { return false };
        let delay_s = offset.ahead_s - theirs.ahead_us(here) as f64 * 1e-6;
        delay_s.abs() > most.as_secs() + offset.uncertainty_s
    }

    /// Returns the estimate of the offset with the smallest error bound at `now`; `None` without a measurement.
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
    use super::super::report::Stamps;
    use super::*;
    use crate::messages::ids::HostId;

    #[test]
    fn the_true_offset_lies_within_the_uncertainty() {
        let mut offsets = Offsets::default();
        let (here, there) = (Stamps::beginning_at(1 << 47), Stamps::beginning_at((1 << 47) + 3_000_000));
        let at_us = |us: u64| Time::ZERO + Span::from_nanos(us * 1000);
        // The other clock is 3 s ahead. Delays: 200 us there, 5 ms held, 600 us back, then 100 us back.
        for (start, back) in [(1_000_000, 600), (2_000_000, 100)] {
            let theirs = there.of(at_us(start + 200 + 5000));
            let (host, held, echo) = (HostId(0), Span::from_millis(5), here.of(at_us(start)));
            let entry = Entry { host, echo, held, lost: 0, challenge: false, direct: None };
            let now = at_us(start + 5200 + back);
            offsets.measure(now, here.of(now), theirs, &entry);
        }
        let now = at_us(2_100_000);
        let offset = offsets.estimate(now).unwrap();
        assert!((offset.ahead_s - 3.0).abs() <= offset.uncertainty_s, "{offset:?}");
        assert!((offset.round_trip_s - 300e-6).abs() < 2e-6 && offset.uncertainty_s < 160e-6, "{offset:?}");
        let is_off =
            |written: u64| offsets.is_off(now, here.of(now), there.of(at_us(written)), Span::from_millis(2000));
        assert!(!is_off(200_000) && !is_off(2_100_000) && is_off(90_000) && is_off(4_200_000));
    }
}
