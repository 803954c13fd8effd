//! Stamps of a sensor's clock: tells new measurements from repeated and late ones, also when that clock is set.
//!
//! A clock that is set forward, or back by more than a second, is followed at once. One that is set back by less cannot
//! be told from late messages at first: their stamps are older, too. But then all of them are, and they go on at the
//! pace at which they arrive. After a few such messages the clock counts as set back, and from then on its stamps are
//! put out later by what it was set back: so whoever compares stamps with arrivals sees a clock that was never set.

use crate::time::{Span, Time};

/// Smallest step back of a stamp \[ns\] that is taken at once for a clock that was set back. A smaller step is taken
/// for a late message at first.
const CLOCK_SET_NS: u64 = 1_000_000_000;
/// Shortest and longest time between the arrivals of older messages whose stamps advance by a given time, as factors of
/// that time, for them to be a clock that was set back. Messages that were held up arrive together.
const PACE: (f64, f64) = (0.5, 2.0);
/// Time by which the arrivals of two messages may be further apart than their stamps, whatever their pace \[s\].
const JITTER_S: f64 = 0.05;
/// Time after a measurement from which one with the same stamp is a new one in a leap second \[ns\]. A report that is
/// repeated comes sooner.
const LEAP_NS: u64 = 900_000_000;

/// Result of comparing the stamp of a measurement with earlier stamps of the same sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Novelty {
    /// The measurement is newer than all before. Its stamp \[ns\] is on a clock that was not set since the one before.
    New(u64),
    /// The measurement is new, but the time since earlier ones is unknown: it is the first, the sender's clock was set
    /// by more than a second, or the one before had an older stamp. Its stamp \[ns\] follows.
    Anew(u64),
    /// The stamp belongs to a repeated or late measurement.
    Old,
}

/// Clock of one sender, as its stamps show it.
#[derive(Clone, Copy, Debug)]
pub struct SenderClock {
    /// Stamp \[ns\] and arrival of the newest measurement; `None` before the first.
    newest: Option<(u64, Time)>,
    /// Run of measurements with older stamps since the newest one, each with a later stamp than the one before: the
    /// last stamp \[ns\], its arrival, and their number. `None` if there is none.
    older: Option<(u64, Time, u32)>,
    /// Number of such measurements after which the clock counts as set back.
    patience: u32,
    /// Time by which the clock was set back in all, in steps below a second \[ns\].
    shift_ns: u64,
    /// Last stamp \[ns\] that was accepted twice, in a leap second.
    leapt: Option<u64>,
}

impl SenderClock {
    /// Makes the clock of a sender that has sent nothing. `patience` is the number of older stamps in a row, at the
    /// pace at which they arrive, after which the clock counts as set back: three where messages may overtake each
    /// other, two where they cannot.
    pub fn new(patience: u32) -> SenderClock {
        SenderClock { newest: None, older: None, patience, shift_ns: 0, leapt: None }
    }

    /// Records the stamp \[ns\] of a measurement that has arrived at `now`, and returns whether it is new.
    pub fn take(&mut self, now: Time, stamp_ns: u64) -> Novelty {
        let Some((newest, at)) = self.newest else { return self.anew(now, stamp_ns) };
        if stamp_ns > newest {
            let overtaken = self.older.is_some();
            let accepted = self.accept(now, stamp_ns);
            // Messages with older stamps were late, or of a clock that was set back by less than it has run since.
            return if let (true, Novelty::New(stamp_ns)) = (overtaken, accepted) {
                Novelty::Anew(stamp_ns)
            } else {
                accepted
            };
        }
        if newest - stamp_ns > CLOCK_SET_NS {
            return self.anew(now, stamp_ns);
        }
        if stamp_ns == newest {
            return Novelty::Old;
        }
        let run = match self.older {
            Some((last, arrived, count)) if stamp_ns > last && is_pace(arrived, now, stamp_ns - last) => count + 1,
            Some((last, ..)) if stamp_ns == last => return Novelty::Old,
            _ => 1,
        };
        self.older = Some((stamp_ns, now, run));
        if run < self.patience { Novelty::Old } else { self.set_back(now, stamp_ns, (newest, at)) }
    }

    /// Does the same as [`SenderClock::take`] for a stamp within a second of a leap second, which many senders have
    /// twice: there, a stamp that is up to a second older is new at once, and an equal one if it comes a second later.
    pub fn take_in_leap(&mut self, now: Time, stamp_ns: u64) -> Novelty {
        let Some((newest, at)) = self.newest else { return self.anew(now, stamp_ns) };
        let again = stamp_ns == newest && now.since(at).as_nanos() >= LEAP_NS && self.leapt != Some(stamp_ns);
        if again || (stamp_ns < newest && newest - stamp_ns <= CLOCK_SET_NS && self.leapt != Some(newest)) {
            self.leapt = Some(if again { stamp_ns } else { newest });
            return self.set_back(now, stamp_ns, (newest, at));
        }
        self.take(now, stamp_ns)
    }

    /// Returns true if a measurement with this stamp \[ns\] is the newest one again.
    pub fn is_repeated(&self, stamp_ns: u64) -> bool {
        self.newest.is_some_and(|(newest, _)| newest == stamp_ns)
    }

    fn accept(&mut self, now: Time, stamp_ns: u64) -> Novelty {
        (self.newest, self.older) = (Some((stamp_ns, now)), None);
        Novelty::New(stamp_ns.saturating_add(self.shift_ns))
    }

    fn anew(&mut self, now: Time, stamp_ns: u64) -> Novelty {
        self.shift_ns = 0;
        self.accept(now, stamp_ns);
        Novelty::Anew(stamp_ns)
    }

    /// Accepts a stamp that is older than the newest one, since the clock was set back.
    fn set_back(&mut self, now: Time, stamp_ns: u64, (newest, at): (u64, Time)) -> Novelty {
        let expected = newest.saturating_add(now.since(at).as_nanos());
        self.shift_ns = self.shift_ns.saturating_add(expected - stamp_ns);
        self.accept(now, stamp_ns)
    }
}

/// Whether the arrivals of two measurements are as far apart as their stamps, which differ by `advance_ns` \[ns\].
fn is_pace(before: Time, now: Time, advance_ns: u64) -> bool {
    let (arrived_s, advance_s) = (now.since(before).as_secs(), Span::from_nanos(advance_ns).as_secs());
    (PACE.0 * advance_s..=PACE.1 * advance_s + JITTER_S).contains(&arrived_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Feeds stamps \[ms\] that arrive at times \[ms\]; returns what is put out \[ms\], `None` for old ones.
    fn feed(clock: &mut SenderClock, all: &[(u64, u64)]) -> Vec<Option<u64>> {
        let one = |&(at, stamp): &(u64, u64)| match clock.take(at_ms(at), stamp * 1_000_000) {
            Novelty::New(stamp) | Novelty::Anew(stamp) => Some(stamp / 1_000_000),
            Novelty::Old => None,
        };
        all.iter().map(one).collect()
    }

    #[test]
    fn new_stamps_are_told_from_repeated_and_late_ones() {
        let mut clock = SenderClock::new(3);
        let said =
            feed(&mut clock, &[(0, 5000), (20, 5020), (40, 5020), (41, 5010), (60, 5060), (61, 5030), (62, 5040)]);
        assert_eq!(said, [Some(5000), Some(5020), None, None, Some(5060), None, None]);
        let burst = feed(&mut clock, &[(80, 5080), (81, 5061), (82, 5065), (83, 5070), (84, 5075)]);
        assert_eq!(burst, [Some(5080), None, None, None, None], "held-up messages that come together are late ones");
    }

    #[test]
    fn a_clock_that_is_set_by_more_than_a_second_is_followed_at_once() {
        let mut clock = SenderClock::new(3);
        let said = feed(&mut clock, &[(0, 50_000), (20, 7), (40, 27), (60, 3_600_000), (80, 47), (100, 67)]);
        assert_eq!(said, [Some(50_000), Some(7), Some(27), Some(3_600_000), Some(47), Some(67)]);
        assert_eq!(clock.take(at_ms(120), 1), Novelty::Old);
    }

    #[test]
    fn a_clock_that_is_set_back_by_half_a_second_costs_three_messages_and_is_put_out_as_if_it_was_not() {
        for (patience, lost) in [(3, 2), (2, 1)] {
            let mut clock = SenderClock::new(patience);
            let stamp = |k: u64| if k < 10 { 10_000 + 20 * k } else { 9_500 + 20 * k };
            let all: Vec<(u64, u64)> = (0..50).map(|k| (20 * k, stamp(k))).collect();
            let said = feed(&mut clock, &all);
            assert_eq!(said.iter().filter(|stamp| stamp.is_none()).count(), lost, "{said:?}");
            for (k, stamp) in said.iter().enumerate().filter_map(|(k, stamp)| Some((k as u64, (*stamp)?))) {
                assert_eq!(stamp, 10_000 + 20 * k, "as if the clock had never been set");
            }
        }
    }

    #[test]
    fn a_repeated_second_costs_nothing_and_a_stamp_that_stands_is_no_leap() {
        for period in [100, 200, 1000] {
            let mut clock = SenderClock::new(2);
            let count = 3000 / period;
            let said: Vec<Novelty> = (0..count)
                .map(|k| {
                    let ms = period * k;
                    // The second from 1000 to 2000 ms comes twice.
                    let stamp = if ms < 2000 { ms } else { ms - 1000 };
                    clock.take_in_leap(at_ms(ms), stamp * 1_000_000)
                })
                .collect();
            assert!(said.iter().all(|novelty| *novelty != Novelty::Old), "{period}: {said:?}");
            assert_eq!(said.last(), Some(&Novelty::New((count - 1) * period * 1_000_000)));
        }
        let mut clock = SenderClock::new(2);
        let stands = (0..100).filter(|k| clock.take_in_leap(at_ms(100 * k), 7) != Novelty::Old).count();
        assert_eq!(stands, 2, "once, and once more as a leap second");
    }
}
