//! Lateness of deliveries: how long after the channel's time a frame was written to its station's interface.

use serde::{Deserialize, Serialize};

use murmurate::time::{Span, Time};

/// Width of a class of the histogram \[ns\].
const CLASS_NS: u64 = 10_000;
/// Number of classes: up to 20 ms, and a last one for all above.
const CLASSES: usize = 2001;

/// Histogram of the lateness of deliveries, with the number of those beyond a limit.
#[derive(Clone, Debug)]
pub struct Lateness {
    limit: Span,
    classes: Vec<u64>,
    max: Span,
    late: u64,
    total: u64,
}

/// Lateness of deliveries in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LatenessSummary {
    /// Lateness from which a delivery counts as late \[us\].
    pub limit_us: u64,
    /// Number of deliveries.
    pub deliveries: u64,
    /// Number of late deliveries.
    pub late: u64,
    /// Median \[us\], rounded up to 10 us.
    pub p50_us: u64,
    /// Lateness that one delivery in a hundred exceeds \[us\], rounded up to 10 us.
    pub p99_us: u64,
    /// Largest lateness \[us\].
    pub max_us: u64,
}

impl Lateness {
    /// Returns an empty histogram. Deliveries later than `limit` count as late.
    pub fn new(limit: Span) -> Lateness {
        Lateness { limit, classes: vec![0; CLASSES], max: Span::ZERO, late: 0, total: 0 }
    }

    /// Counts a delivery that was due at `due` and made at `made`. Returns whether it was late.
    pub fn count(&mut self, due: Time, made: Time) -> bool {
        let lateness = made.since(due);
        let class = (lateness.as_nanos() / CLASS_NS) as usize;
        self.classes[class.min(CLASSES - 1)] += 1;
        self.max = self.max.max(lateness);
        self.total += 1;
        let late = lateness > self.limit;
        self.late += u64::from(late);
        late
    }

    /// Returns the lateness so far in numbers.
    pub fn summary(&self) -> LatenessSummary {
        let quantile = |per_cent: u64| {
            let wanted = (self.total * per_cent).div_ceil(100).max(1);
            let mut sum = 0;
            let class = self.classes.iter().position(|count| {
                sum += count;
                sum >= wanted
            });
            let upper_us = |class| (class as u64 + 1) * CLASS_NS / 1000;
            class.map_or(0, upper_us)
        };
        LatenessSummary {
            limit_us: self.limit.as_nanos() / 1000,
            deliveries: self.total,
            late: self.late,
            p50_us: quantile(50),
            p99_us: quantile(99),
            max_us: self.max.as_nanos().div_ceil(1000),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_delivery_beyond_the_limit_counts_as_late() {
        let mut lateness = Lateness::new(Span::from_nanos(500_000));
        let due = Time::from_nanos(1_000_000);
        for us in 0..98 {
            assert!(!lateness.count(due, due + Span::from_nanos(1000 * us)));
        }
        assert!(!lateness.count(due, Time::ZERO + Span::from_nanos(1_500_000)), "the limit itself is not late");
        assert!(lateness.count(due, due + Span::from_millis(30)));
        let summary = lateness.summary();
        assert_eq!((summary.deliveries, summary.late, summary.max_us), (100, 1, 30_000));
        assert_eq!((summary.p50_us, summary.p99_us), (50, 510));
        assert_eq!(Lateness::new(Span::ZERO).summary().p50_us, 0);
    }
}
