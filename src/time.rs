//! Instants and durations as types, in whole nanoseconds since the start of the run.
//!
//! No clock is read here: cores are given `now`, and only `runtime::clock` advances it.

use std::fmt;
use std::ops::{Add, AddAssign, Mul, Sub};

use serde::{Deserialize, Serialize};

/// An instant \[ns since the start of the run\] on the clock of one host. Instants of two hosts are never compared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Time(u64);

/// A duration \[ns\], never negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Span(u64);

impl Time {
    /// Instant of the start of the run: 0 ns.
    pub const ZERO: Time = Time(0);
    /// The largest instant that the type can express, later than any that a run reaches.
    pub const MAX: Time = Time(u64::MAX);

    /// Returns the instant `ns` nanoseconds after the start of the run.
    pub const fn from_nanos(ns: u64) -> Time {
        Time(ns)
    }

    /// Returns this instant as nanoseconds since the start of the run \[ns\].
    pub const fn as_nanos(self) -> u64 {
        self.0
    }

    /// Returns this instant as seconds since the start of the run \[s\].
    #[inline]
    pub fn as_secs(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Returns the duration from `earlier` to this instant; zero if `earlier` is the later one.
    pub const fn since(self, earlier: Time) -> Span {
        Span(self.0.saturating_sub(earlier.0))
    }

    /// Returns the first of the instants `phase + k * period`, k = 0, 1, ..., that is strictly after this one. The
    /// `phase` counts from the start of the run.
    ///
    /// # Panics
    /// If `period` is zero.
    pub(crate) const fn next_on_grid(self, phase: Span, period: Span) -> Time {
        assert!(period.0 > 0, "a grid needs a period");
        if self.0 < phase.0 {
            return Time(phase.0);
        }
        Time(phase.0 + ((self.0 - phase.0) / period.0 + 1) * period.0)
    }
}

impl Span {
    /// The duration zero.
    pub const ZERO: Span = Span(0);

    /// Returns a duration of `ns` nanoseconds.
    pub const fn from_nanos(ns: u64) -> Span {
        Span(ns)
    }

    /// Returns a duration of `ms` milliseconds.
    pub const fn from_millis(ms: u64) -> Span {
        Span(ms * 1_000_000)
    }

    /// Returns a duration of `s` seconds, to the nearest nanosecond; zero for negative or non-finite `s`.
    pub fn from_secs(s: f64) -> Span {
        if s.is_finite() && s > 0.0 { Span((s * 1e9).round() as u64) } else { Span::ZERO }
    }

    /// Returns the duration in nanoseconds \[ns\].
    pub const fn as_nanos(self) -> u64 {
        self.0
    }

    /// Returns the duration in seconds \[s\].
    #[inline]
    pub fn as_secs(self) -> f64 {
        self.0 as f64 * 1e-9
    }
}

impl Add<Span> for Time {
    type Output = Time;
    fn add(self, span: Span) -> Time {
        Time(self.0.saturating_add(span.0))
    }
}

impl AddAssign<Span> for Time {
    fn add_assign(&mut self, span: Span) {
        *self = *self + span;
    }
}

impl Add for Span {
    type Output = Span;
    fn add(self, other: Span) -> Span {
        Span(self.0.saturating_add(other.0))
    }
}

impl Sub for Span {
    type Output = Span;
    fn sub(self, other: Span) -> Span {
        Span(self.0.saturating_sub(other.0))
    }
}

impl Mul<u64> for Span {
    type Output = Span;
    fn mul(self, times: u64) -> Span {
        Span(self.0.saturating_mul(times))
    }
}

impl fmt::Display for Time {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} s", self.as_secs())
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} s", self.as_secs())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_grid_point_is_strictly_later() {
        let (phase, period) = (Span::from_millis(7), Span::from_millis(50));
        assert_eq!(Time::ZERO.next_on_grid(phase, period), Time::ZERO + phase);
        let first = Time::ZERO + phase;
        assert_eq!(first.next_on_grid(phase, period), first + period);
        let late = Time::from_nanos(123_456_789);
        assert!(late.next_on_grid(phase, period) > late);
        assert!(late.next_on_grid(phase, period).since(late) <= period);
    }
}
