//! Token bucket: rate limit of one sender. Pure; the caller passes the time.

use crate::time::{Span, Time};

/// Rate limit that a receiver applies to the datagrams of one sender: sustained rate and burst size of a token bucket.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Sustained rate that is permitted \[datagrams/s\].
    pub per_s: f64,
    /// Largest number of datagrams that may arrive at once after a pause.
    pub burst: f64,
}

/// State of a token bucket, which limits the rate of one sender: the remaining tokens, each worth one datagram.
#[derive(Clone, Copy, Debug)]
pub struct Bucket {
    tokens: f64,
    at: Time,
}

impl Rate {
    /// Returns a rate that permits so many a second more, and as many more at once.
    pub(crate) fn with(self, per_s: f64) -> Rate {
        Rate { per_s: self.per_s + per_s, burst: self.burst + per_s }
    }
}

impl Bucket {
    /// Returns a bucket that is full at `now`: it holds `rate.burst` tokens.
    pub fn full(now: Time, rate: &Rate) -> Bucket {
        Bucket { tokens: rate.burst, at: now }
    }

    /// Returns whether a token is left at `now`. Unlike [`Bucket::take`], it changes nothing.
    pub fn has(&self, now: Time, rate: &Rate) -> bool {
        self.tokens + now.since(self.at).as_secs() * rate.per_s >= 1.0
    }

    fn fill(&mut self, now: Time, rate: &Rate) {
        let passed: Span = now.since(self.at);
        self.tokens = (self.tokens + passed.as_secs() * rate.per_s).min(rate.burst);
        self.at = self.at.max(now);
    }

    /// Returns the number of whole tokens that the bucket holds at `now`, after it was refilled at the rate `rate`.
    pub fn left(&mut self, now: Time, rate: &Rate) -> usize {
        self.fill(now, rate);
        self.tokens as usize
    }

    /// Takes one token at `now`, after the bucket was refilled at the rate `rate`. Returns `false` if there was none:
    /// the limit is exceeded.
    pub fn take(&mut self, now: Time, rate: &Rate) -> bool {
        self.fill(now, rate);
        let left = self.tokens >= 1.0;
        if left {
            self.tokens -= 1.0;
        }
        left
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_passes_and_then_the_rate() {
        let rate = Rate { per_s: 100.0, burst: 10.0 };
        let mut bucket = Bucket::full(Time::ZERO, &rate);
        let mut taken = 0;
        for ms in 0..1000 {
            taken += usize::from(bucket.take(Time::ZERO + Span::from_millis(ms), &rate));
        }
        assert!((108..=110).contains(&taken), "{taken} of 1000 in one second");
    }
}
