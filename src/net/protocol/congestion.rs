//! Queueing delay of a link, from the round trips of its link reports, as in LEDBAT (RFC 6817): base delays over
//! intervals, and what a round trip takes beyond. It tells the loss of a full channel, which messages that are sent
//! again make worse, from the loss of a noisy one.

use crate::time::{Span, Time};

/// Length of an interval of the base delay. The base is the least round trip of this and the interval before.
const INTERVAL: Span = Span::from_millis(60_000);
/// Smoothed queueing delay of a round trip from which on a link is congested \[s\]: most messages of 20 Hz then arrive
/// after their successor was sent.
const CONGESTED_S: f64 = 0.04;
/// Weight of a new queueing delay in the running mean.
const WEIGHT: f64 = 1.0 / 8.0;
/// Time for which a link counts as congested after it was.
const HOLD: Span = Span::from_millis(10_000);

/// Base delay of the round trips to one host.
#[derive(Clone, Copy, Debug)]
pub struct BaseDelay {
    began: Time,
    /// Least round trips of this interval and the one before \[s\].
    least_s: [f64; 2],
}

impl BaseDelay {
    /// Returns the base delay of a host that was accepted at `now`, without a round trip yet.
    pub fn new(now: Time) -> BaseDelay {
        BaseDelay { began: now, least_s: [f64::INFINITY; 2] }
    }

    /// Takes a round trip of `round_trip_s` \[s\] that was measured at `now`; returns its queueing delay \[s\].
    pub fn queueing_s(&mut self, now: Time, round_trip_s: f64) -> f64 {
        if now.since(self.began) >= INTERVAL {
            (self.began, self.least_s) = (now, [f64::INFINITY, self.least_s[0]]);
        }
        self.least_s[0] = self.least_s[0].min(round_trip_s);
        round_trip_s - self.least_s[0].min(self.least_s[1])
    }
}

/// Congestion of a link, by the queueing delays of the round trips to all hosts.
#[derive(Clone, Copy, Debug, Default)]
pub struct Congestion {
    queueing_s: f64,
    until: Time,
}

impl Congestion {
    /// Takes a queueing delay \[s\] that was measured at `now`.
    pub fn note(&mut self, now: Time, queueing_s: f64) {
        self.queueing_s += WEIGHT * (queueing_s - self.queueing_s);
        if self.queueing_s > CONGESTED_S {
            self.until = now + HOLD;
        }
    }

    /// Whether the link is congested, or was within the last 10 s.
    pub fn is_on(&self, now: Time) -> bool {
        now < self.until
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn a_long_way_is_no_congestion_and_a_queue_is() {
        let (mut base, mut link) = (BaseDelay::new(at(0)), Congestion::default());
        for ms in (0..10_000).step_by(250) {
            link.note(at(ms), base.queueing_s(at(ms), 0.3));
        }
        assert!(!link.is_on(at(10_000)));
        link.note(at(10_000), base.queueing_s(at(10_000), 0.5));
        assert!(!link.is_on(at(10_000)), "one late report is none either");
        for ms in (10_250..12_000).step_by(250) {
            link.note(at(ms), base.queueing_s(at(ms), 0.5));
        }
        assert!(link.is_on(at(12_000)) && !link.is_on(at(23_000)));
    }

    #[test]
    fn a_base_is_forgotten_after_two_minutes() {
        let mut base = BaseDelay::new(at(0));
        assert_eq!(base.queueing_s(at(0), 0.1), 0.0);
        let queueing = (1..240).map(|second| base.queueing_s(at(1000 * second), 0.4)).collect::<Vec<_>>();
        assert!(queueing[58] > 0.29 && queueing[238] == 0.0, "{queueing:?}");
    }
}
