//! Times of frames on the air, and loss by multicast, from pairs: two datagrams of one size that leave back to back.
//!
//! The second one waits for the first, so what lies between their arrivals is the time of one frame and of the
//! station's turn. All hosts of a link measure the pairs of all others, and take what they see for what they cause.

use std::collections::{BTreeMap, VecDeque};

use crate::messages::ids::HostId;
use crate::net::protocol::codec::{Content, DecodeError, Flags, Header};
use crate::net::protocol::report::DatagramId;
use crate::time::{Span, Time};

/// Number of newest gaps from which a time is taken.
const GAPS: usize = 12;
/// Number of gaps from which on a time is known.
const ENOUGH: usize = 3;
/// Bounds of a gap: two that arrive closer were read together from a buffer, as no frame is that short; and nothing of
/// a datagram's size takes longer.
const SHORTEST: Span = Span::from_nanos(50_000);
const LONGEST: Span = Span::from_millis(20);
/// Time of a station's turn in a short gap \[s\]: the space AIFS of 802.11, and a quarter of the least contention
/// window.
const TURN_S: f64 = 77e-6;
/// Least time of a frame \[s\]: a preamble.
const LEAST_S: f64 = 20e-6;
/// Weight of a datagram in the running mean of the loss.
const WEIGHT: f64 = 1.0 / 64.0;
/// Number of pairs that a sender may have sent unheard, above which they tell nothing.
const MOST_MISSED: u16 = 32;

/// Block that marks a pair: the same datagram follows as a copy, by the same way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::net::protocol) struct Pair {
    /// Whether both leave by unicast.
    pub(super) unicast: bool,
    /// Number of the sender's pairs by multicast so far, this one included.
    pub(super) number: u16,
}

impl Pair {
    /// Length of the body without padding \[bytes\].
    const BYTES: usize = 3;

    /// Reads the body of the block; zeros that follow are padding.
    pub(in crate::net::protocol) fn read(body: &[u8]) -> Result<Pair, DecodeError> {
        match body.split_first_chunk() {
            Some((&[unicast @ 0..=1, low, high], padding)) if padding.iter().all(|byte| *byte == 0) => {
                Ok(Pair { unicast: unicast == 1, number: u16::from_le_bytes([low, high]) })
            }
            _ => Err(DecodeError::Link(Content::Pair)),
        }
    }

    /// Appends the body, and zeros up to `length` bytes.
    pub(super) fn write(self, length: usize, bytes: &mut Vec<u8>) {
        let end = bytes.len() + length.max(Pair::BYTES);
        bytes.push(u8::from(self.unicast));
        bytes.extend_from_slice(&self.number.to_le_bytes());
        bytes.resize(end, 0);
    }
}

/// Last datagram that a host took on a link.
#[derive(Clone, Copy, Debug)]
struct Last {
    id: DatagramId,
    at: Time,
    pair: Option<Pair>,
    is_copy: bool,
}

/// Pairs of a sender by multicast.
#[derive(Clone, Copy, Debug)]
struct Told {
    incarnation: u32,
    number: u16,
    /// Number of datagrams of the newest pair that arrived, 1 or 2.
    arrived: u8,
}

/// Pairs of all other hosts on a link, as they arrived.
#[derive(Clone, Debug, Default)]
pub(super) struct Pairs {
    last: Option<Last>,
    /// Newest gaps \[s\]: by multicast, and by unicast.
    gaps: [VecDeque<f64>; 2],
    told: BTreeMap<HostId, Told>,
    loss: f64,
}

impl Pairs {
    /// Returns whether a datagram is the second one of a pair whose first one was the last that arrived, so that their
    /// gap can be measured. A datagram between the two tells that the medium was another's for a while.
    pub(super) fn completes(&self, now: Time, header: &Header) -> bool {
        self.last.is_some_and(|last| {
            let gap = now.since(last.at);
            let same = header.flags.has(Flags::COPY) && !last.is_copy && last.id == DatagramId::of(header);
            same && last.pair.is_some() && gap >= SHORTEST && gap <= LONGEST
        })
    }

    /// Takes note of a datagram that was accepted or that completes a pair, with its block.
    pub(super) fn note(&mut self, now: Time, header: &Header, pair: Option<Pair>) {
        let completes = self.completes(now, header);
        let (id, is_copy) = (DatagramId::of(header), header.flags.has(Flags::COPY));
        if let Some(pair) = pair.filter(|_| completes)
            && let Some(before) = self.last
        {
            let gaps = &mut self.gaps[usize::from(pair.unicast)];
            gaps.truncate(GAPS - 1);
            gaps.push_front(now.since(before.at).as_secs());
        }
        self.last = Some(Last { id, at: now, pair, is_copy });
        if let Some(pair) = pair.filter(|pair| !pair.unicast) {
            self.count(header, pair.number);
        }
    }

    /// Takes note of a datagram of the pair `number` by multicast, and of those before it that did not arrive.
    fn count(&mut self, header: &Header, number: u16) {
        let first = Told { incarnation: header.incarnation, number, arrived: 0 };
        let told = self.told.entry(header.sender).or_insert(first);
        let ahead = number.wrapping_sub(told.number);
        let begins = told.incarnation != header.incarnation || ahead > MOST_MISSED;
        let lost = if begins || ahead == 0 { 0 } else { 2 * ahead - u16::from(told.arrived.min(2)) };
        if begins || ahead > 0 {
            *told = first;
        }
        told.arrived += 1;
        // The first datagrams weigh more, as they are few.
        for _ in 0..lost {
            self.loss += WEIGHT * (1.0 - self.loss);
        }
        self.loss -= WEIGHT * self.loss;
    }

    /// Returns the time on the air of a frame by multicast or by unicast \[s\]; `None` while it is unknown.
    pub(super) fn frame_s(&self, unicast: bool) -> Option<f64> {
        let mut gaps: Vec<f64> = self.gaps[usize::from(unicast)].iter().copied().collect();
        gaps.sort_by(f64::total_cmp);
        // Frames of others between the two only make a gap longer, so a short one tells most.
        (gaps.len() >= ENOUGH).then(|| (gaps[gaps.len() / 4] - TURN_S).max(LEAST_S))
    }

    /// Returns the share of the datagrams of pairs by multicast, 0 to 1, that did not arrive.
    pub(super) fn loss(&self) -> f64 {
        self.loss
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(sender: u16, sequence: u32, copy: bool) -> Header {
        let flags = Flags(if copy { Flags::COPY } else { 0 });
        Header { flags, team: 1, sender: HostId(sender), incarnation: 1, sequence }
    }

    fn at(us: u64) -> Time {
        Time::from_nanos(1000 * us)
    }

    /// Takes pairs of the host 1 with this gap \[us\], each after the number of the one before.
    fn take(pairs: &mut Pairs, numbers: std::ops::Range<u16>, gap_us: u64, between: bool) {
        for number in numbers {
            let (us, sequence) = (100_000 * u64::from(number), u32::from(number));
            let pair = Some(Pair { unicast: false, number });
            pairs.note(at(us), &header(1, sequence, false), pair);
            if between {
                pairs.note(at(us + 10), &header(2, sequence, false), None);
            }
            let second = header(1, sequence, true);
            if pairs.completes(at(us + gap_us), &second) {
                pairs.note(at(us + gap_us), &second, pair);
            }
        }
    }

    #[test]
    fn a_frame_takes_what_lies_between_two_without_the_turn() {
        let mut pairs = Pairs::default();
        take(&mut pairs, 1..3, 195, false);
        assert_eq!(pairs.frame_s(false), None, "two are too few");
        take(&mut pairs, 3..9, 195, false);
        let time_s = pairs.frame_s(false).expect("it is known");
        assert!((time_s - 118e-6).abs() < 1e-9 && pairs.frame_s(true).is_none(), "{time_s}");
        take(&mut pairs, 9..30, 900, true);
        assert_eq!(pairs.frame_s(false), Some(time_s), "frames of others were between those");
        take(&mut pairs, 30..60, 10, false);
        assert_eq!(pairs.frame_s(false), Some(time_s), "those were read together");
        take(&mut pairs, 60..62, 2397, false);
        assert_eq!(pairs.frame_s(false), Some(time_s), "a long gap now and then tells nothing");
        take(&mut pairs, 62..80, 2397, false);
        assert!((pairs.frame_s(false).expect("it is known") - 2320e-6).abs() < 1e-9);
    }

    #[test]
    fn numbers_of_pairs_tell_the_loss() {
        let mut pairs = Pairs::default();
        take(&mut pairs, 1..200, 195, false);
        assert_eq!(pairs.loss(), 0.0);
        for number in 200..1000 {
            // Each fourth pair is lost, and the second datagram of each other.
            if number % 4 > 0 {
                pairs.note(at(0), &header(1, u32::from(number), false), Some(Pair { unicast: false, number }));
            }
        }
        assert!((pairs.loss() - 0.625).abs() < 0.05, "{}", pairs.loss());
        let restarted = Header { incarnation: 2, ..header(1, 1, false) };
        let before = pairs.loss();
        pairs.note(at(0), &restarted, Some(Pair { unicast: false, number: 3 }));
        assert!(pairs.loss() <= before, "a restart is no loss");
    }

    #[test]
    fn a_block_is_read_as_it_was_written_and_anything_else_is_refused() {
        for length in [0, 3, 40] {
            let (pair, mut bytes) = (Pair { unicast: true, number: 0x1234 }, Vec::new());
            pair.write(length, &mut bytes);
            assert_eq!((Pair::read(&bytes), bytes.len()), (Ok(pair), length.max(3)));
        }
        for wrong in [&[][..], &[1, 2], &[2, 0, 0], &[1, 0, 0, 1]] {
            assert!(Pair::read(wrong).is_err(), "{wrong:?}");
        }
    }
}
