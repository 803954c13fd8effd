//! Age of datagrams by what reports say: one that is numbered below a report that came long ago was held back.
//! No bytes, no clock.
//!
//! A relay without the key can otherwise release one long after it was said, as long as nothing newer of its stream has
//! come. Numbers order the datagrams, so it costs no byte to refuse it.

use std::collections::VecDeque;

use crate::time::{Span, Time};

/// How long after a report a datagram that left before it may still come: jitter of 100 ms, and all retries of one
/// that was lost. Those take 155 ms, and 174 ms where each timer is an eighth late to share a wake-up.
pub const LATE: Span = Span::from_millis(280);
/// Reports that come faster than this are not all remembered, so that few are.
const APART: Span = Span::from_nanos(LATE.as_nanos() / 16);

/// The reports of one sender that were admitted, in the order of their arrival.
#[derive(Clone, Debug, Default)]
pub struct Order {
    /// When; the numbers of the next datagrams to all and to this host.
    lately: VecDeque<(Time, [Option<u32>; 2])>,
    /// The least numbers that are not late.
    least: [Option<u32>; 2],
}

impl Order {
    /// A report was admitted: all datagrams before these numbers, to all and to this host, had left before it.
    pub fn reported(&mut self, now: Time, numbers: [Option<u32>; 2]) {
        self.advance(now);
        if self.lately.back().is_none_or(|(at, _)| now.since(*at) >= APART) {
            self.lately.push_back((now, numbers));
        }
    }

    fn advance(&mut self, now: Time) {
        while let Some((_, numbers)) = self.lately.front().copied().filter(|(at, _)| now.since(*at) > LATE) {
            self.lately.pop_front();
            for (least, number) in self.least.iter_mut().zip(numbers) {
                let Some(number) = number else { continue };
                if least.is_none_or(|least| is_before(least, number)) {
                    *least = Some(number);
                }
            }
        }
    }

    /// Whether a datagram with this number, to all or (1) to this host, has been held back.
    pub fn is_late(&mut self, now: Time, lane: usize, sequence: u32) -> bool {
        self.advance(now);
        self.least[lane].is_some_and(|least| is_before(sequence, least))
    }
}

/// Serial number arithmetic (RFC 1982): half of the numbers are ahead, half behind.
fn is_before(one: u32, other: u32) -> bool {
    one != other && other.wrapping_sub(one) <= u32::MAX / 2
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_left_before_a_report_may_come_for_a_while_after_it_and_then_no_more() {
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        let mut order = Order::default();
        order.reported(at(0), [Some(u32::MAX), Some(7)]);
        order.reported(at(100), [Some(5), None]);
        assert!(!order.is_late(at(280), 0, 3) && !order.is_late(at(280), 1, 6));
        assert!(order.is_late(at(281), 1, 6) && !order.is_late(at(281), 1, 7));
        assert!(order.is_late(at(281), 0, u32::MAX - 1) && !order.is_late(at(281), 0, u32::MAX));
        assert!(order.is_late(at(381), 0, 4) && !order.is_late(at(381), 0, 5), "across the wrap");
        for ms in 400..10_000 {
            order.reported(at(ms), [Some(9), Some(9)]);
        }
        assert!(order.lately.len() <= 18, "{} are remembered", order.lately.len());
    }
}
