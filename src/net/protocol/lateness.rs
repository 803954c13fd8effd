//! Detection of datagrams that were held back: their number is below that of a report which arrived long ago. Pure.
//!
//! Without it, a relay without the key could release a datagram long after it was sent, as long as nothing newer of its
//! stream has arrived. The sequence numbers give the order, so this costs no bytes.

use std::collections::VecDeque;

use crate::time::{Span, Time};

/// Time after the arrival of a link report during which datagrams that were sent before it are still accepted. It
/// covers a jitter of 100 ms, and all retransmissions of a lost datagram: these take 155 ms, or 174 ms if each timer is
/// an eighth late to share a wake-up.
pub const LATE: Span = Span::from_millis(280);
/// Smallest interval between stored reports, which bounds their number.
const MIN_SPACING: Span = Span::from_nanos(LATE.as_nanos() / 16);

/// Recent link reports of one sender, from which datagrams that were held back on the way are recognized.
#[derive(Clone, Debug, Default)]
pub struct Lateness {
    /// For each report: its arrival time, and the numbers of the next datagrams to all hosts and to this host.
    reports: VecDeque<(Time, [Option<u32>; 2])>,
    /// Smallest numbers that are not late: of datagrams to all hosts, and to this host.
    least: [Option<u32>; 2],
}

impl Lateness {
    /// Records a link report that arrived at `now`. `numbers` are the sequence numbers of the sender's next datagrams
    /// to all hosts and to this host when it sent the report, each `None` if unknown; datagrams with smaller numbers
    /// were sent before.
    pub fn reported(&mut self, now: Time, numbers: [Option<u32>; 2]) {
        self.advance(now);
        if self.reports.back().is_none_or(|(at, _)| now.since(*at) >= MIN_SPACING) {
            self.reports.push_back((now, numbers));
        }
    }

    fn advance(&mut self, now: Time) {
        while let Some((_, numbers)) = self.reports.front().copied().filter(|(at, _)| now.since(*at) > LATE) {
            self.reports.pop_front();
            for (least, number) in self.least.iter_mut().zip(numbers) {
                let Some(number) = number else { continue };
                if least.is_none_or(|least| is_before(least, number)) {
                    *least = Some(number);
                }
            }
        }
    }

    /// Returns what [`Lateness::is_late`] returns, and changes nothing.
    pub fn would_be_late(&self, now: Time, space: usize, sequence: u32) -> bool {
        let passed = self.reports.iter().take_while(|(at, _)| now.since(*at) > LATE);
        let numbers = passed.filter_map(|(_, numbers)| numbers[space]);
        let advance = |least: Option<u32>, number: u32| match least {
            Some(least) if !is_before(least, number) => Some(least),
            _ => Some(number),
        };
        numbers.fold(self.least[space], advance).is_some_and(|least| is_before(sequence, least))
    }

    /// Returns whether the datagram with this sequence number was sent before a link report that arrived more than 280
    /// ms ([`LATE`]) ago. `space` is 0 for datagrams to all hosts, 1 for those to this host.
    pub fn is_late(&mut self, now: Time, space: usize, sequence: u32) -> bool {
        self.advance(now);
        self.least[space].is_some_and(|least| is_before(sequence, least))
    }
}

/// Whether `one` is before `other` in serial number arithmetic (RFC 1982).
fn is_before(one: u32, other: u32) -> bool {
    one != other && other.wrapping_sub(one) <= u32::MAX / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_left_before_a_report_may_come_for_a_while_after_it_and_then_no_more() {
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        let mut lateness = Lateness::default();
        lateness.reported(at(0), [Some(u32::MAX), Some(7)]);
        lateness.reported(at(100), [Some(5), None]);
        assert!(!lateness.is_late(at(280), 0, 3) && !lateness.is_late(at(280), 1, 6));
        assert!(lateness.is_late(at(281), 1, 6) && !lateness.is_late(at(281), 1, 7));
        assert!(lateness.is_late(at(281), 0, u32::MAX - 1) && !lateness.is_late(at(281), 0, u32::MAX));
        assert!(lateness.is_late(at(381), 0, 4) && !lateness.is_late(at(381), 0, 5), "across the wrap");
        for ms in 400..10_000 {
            lateness.reported(at(ms), [Some(9), Some(9)]);
        }
        assert!(lateness.reports.len() <= 18, "{} are remembered", lateness.reports.len());
    }
}
