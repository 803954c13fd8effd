//! Histogram of message ages over five decades. It is small, and exact at the edges of its bins.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::time::Span;

/// Bin edges of one decade: the series R20 of preferred numbers (ISO 3), so that 20 ms and 50 ms are edges.
const DECADE: [u64; 20] =
    [100, 112, 125, 140, 160, 180, 200, 224, 250, 280, 315, 355, 400, 450, 500, 560, 630, 710, 800, 900];
/// Number of bin edges, from 100 us to 10 s.
const EDGES: usize = 101;
/// Number of bins: one below each edge, and one for ages above the last.
const BINS: usize = EDGES + 1;

/// Histogram of the ages of messages, with bins from 100 us to 10 s. A bin includes its upper edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ages {
    counts: [u64; BINS],
}

impl Default for Ages {
    fn default() -> Ages {
        Ages { counts: [0; BINS] }
    }
}

/// Returns the upper edge of a bin.
fn edge(bin: usize) -> Span {
    let exponent = u32::try_from(bin / DECADE.len()).expect("five decades");
    Span::from_nanos(DECADE[bin % DECADE.len()] * 10u64.pow(exponent) * 1000)
}

impl Ages {
    /// Counts one age.
    pub fn add(&mut self, age: Span) {
        let (mut low, mut high) = (0, EDGES);
        while low < high {
            let middle = usize::midpoint(low, high);
            if edge(middle) < age { low = middle + 1 } else { high = middle }
        }
        self.counts[low] += 1;
    }

    /// Adds the counts of another histogram.
    pub(crate) fn merge(&mut self, other: &Ages) {
        self.counts.iter_mut().zip(other.counts).for_each(|(mine, theirs)| *mine += theirs);
    }

    /// Returns the largest count of all bins.
    pub(crate) fn most(&self) -> u64 {
        self.counts.into_iter().max().unwrap_or(0)
    }

    /// Returns the number of ages counted.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Returns the share (0 to 1) of ages up to `limit`, which has to be an edge of a bin; `None` if nothing was
    /// counted.
    pub fn share_within(&self, limit: Span) -> Option<f64> {
        let within: u64 = (0..EDGES).filter(|&bin| edge(bin) <= limit).map(|bin| self.counts[bin]).sum();
        let total = self.total();
        (total > 0).then(|| within as f64 / total as f64)
    }

    /// Returns the quantile `q` (0 to 1) of the ages \[s\], rounded up to the edge of a bin; `None` if nothing was
    /// counted, or if the quantile lies beyond the last edge, 10 s.
    pub fn quantile_s(&self, q: f64) -> Option<f64> {
        self.cumulative().into_iter().find(|&(_, share)| share >= q).map(|(edge_s, _)| edge_s)
    }

    /// Returns the cumulative distribution of the ages: each bin edge \[s\] with the share (0 to 1) of ages up to it;
    /// empty if nothing was counted.
    pub fn cumulative(&self) -> Vec<(f64, f64)> {
        let total = self.total();
        if total == 0 {
            return Vec::new();
        }
        let mut sum = 0;
        let point = |bin: usize| {
            sum += self.counts[bin];
            (edge(bin).as_secs(), sum as f64 / total as f64)
        };
        (0..EDGES).map(point).collect()
    }
}

/// Serializes pairs of bin index and count, without empty bins.
impl Serialize for Ages {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.collect_seq(self.counts.iter().enumerate().filter(|(_, count)| **count > 0))
    }
}

impl<'de> Deserialize<'de> for Ages {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Ages, D::Error> {
        let mut ages = Ages::default();
        for (bin, count) in Vec::<(usize, u64)>::deserialize(from)? {
            let place = ages.counts.get_mut(bin).ok_or_else(|| serde::de::Error::custom("there is no such bin"))?;
            *place = count;
        }
        Ok(ages)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_exact_at_twenty_and_fifty_milliseconds() {
        let mut ages = Ages::default();
        for ms in [0, 20, 21, 50, 51, 20_000] {
            ages.add(Span::from_millis(ms));
        }
        assert_eq!(ages.share_within(Span::from_millis(20)), Some(2.0 / 6.0));
        assert_eq!(ages.share_within(Span::from_millis(50)), Some(4.0 / 6.0));
        assert_eq!(ages.cumulative().last(), Some(&(10.0, 5.0 / 6.0)));
        assert_eq!(ages.quantile_s(0.5), Some(0.0224));
        assert_eq!(ages.quantile_s(0.99), None, "one is older than the last edge");
        let text = serde_json::to_string(&ages).unwrap();
        assert_eq!(serde_json::from_str::<Ages>(&text).unwrap(), ages);
    }
}
