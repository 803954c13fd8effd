//! Control blocks of the link layer, which datagrams contain beside messages: link reports, acknowledgements, requests
//! to retransmit and offers to do so. This module only encodes and decodes them; `link` uses them. Fields have fixed
//! widths, little-endian.
//!
//! A link report has the sender's stamp, and an entry for each host from which the sender receives. From its entry, a
//! host learns that the sender is alive (it echoes a stamp of the host), how many datagrams are lost, and the clock
//! offset.

use rand::RngExt;

use super::codec::{Content, DecodeError, Flags, Header};
use crate::messages::ids::HostId;
use crate::random::Stream;
use crate::time::{Span, Time};

/// Length of a [`Stamp`] in a link report \[bytes\].
const STAMP_BYTES: usize = 6;
/// Length of a [`Stamp`] \[bits\]. The stamp wraps after 2^48 us, which is nine years.
const STAMP_BITS: u32 = 48;
/// Length of an [`Entry`] in a link report without numbers of unicast datagrams \[bytes\].
pub(crate) const ENTRY_BYTES: usize = 12;
/// Length of an [`Entry`] in a link report that also has the number of the sender's next unicast datagram to the
/// entry's host \[bytes\].
pub(crate) const NUMBERED_ENTRY_BYTES: usize = 16;
/// Length of a link report without entries \[bytes\].
pub(crate) const REPORT_BYTES: usize = STAMP_BYTES;
/// Length of an encoded [`DatagramId`] \[bytes\].
pub(crate) const ID_BYTES: usize = 11;
/// Longest time that the field `held` of an [`Entry`] in a link report can express: three bytes of microseconds, 16.8
/// s. Longer times are sent as this one.
pub(crate) const MAX_HELD_FOR: Span = Span::from_nanos(0xff_ffff * 1000);
/// Bit in the loss field of an [`Entry`] by which the sender of a link report asks the entry's host for a liveness
/// proof.
const CHALLENGE: u8 = 0x80;

/// Timestamp \[us\] of a link report, on a clock of the report's sender that starts at a random value. Differences are
/// taken modulo 2^48. The default, zero, means no stamp.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp(u64);

impl Stamp {
    /// Returns the stamp for a clock that shows `micros` microseconds, modulo 2^48. It is never zero, because zero
    /// means no stamp.
    pub fn new(micros: u64) -> Stamp {
        Stamp((micros % (1 << STAMP_BITS)).max(1))
    }

    /// Returns how much later this stamp is than `other`, a stamp of the same clock \[us\]; negative if it is earlier.
    pub(crate) fn ahead_us(self, other: Stamp) -> i64 {
        let spare = u64::BITS - STAMP_BITS;
        (self.0.wrapping_sub(other.0) << spare).cast_signed() >> spare
    }
}

/// Clock from which a host takes the stamps of its link reports on one link. It starts at a random value, so that
/// stamps of earlier runs are not valid.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stamps(u64);

impl Stamps {
    /// Returns a clock for stamps that shows `base` microseconds at the start of the program.
    #[cfg(test)]
    pub(crate) fn beginning_at(base: u64) -> Stamps {
        Stamps(base)
    }

    /// Returns a clock for stamps that shows a random value, drawn from `stream`, at the start of the program.
    pub(crate) fn random(stream: &mut Stream) -> Stamps {
        Stamps(stream.random_range(0..1 << STAMP_BITS))
    }

    /// Returns the stamp that this clock gives at `time`.
    pub(crate) fn of(self, time: Time) -> Stamp {
        Stamp::new(self.0.wrapping_add(time.as_nanos() / 1000))
    }

    /// Returns the time from `stamp`, which this host has sent, until `now`. `None` if this clock cannot have given the
    /// stamp: it is zero, later than `now`, or from before the start of the program.
    pub(crate) fn age(self, now: Time, stamp: Stamp) -> Option<Span> {
        let micros = u64::try_from(self.of(now).ahead_us(stamp)).ok()?;
        (stamp != Stamp::default() && micros <= now.as_nanos() / 1000).then(|| Span::from_nanos(micros * 1000))
    }
}

/// Entry of a link report about one host from which the report's sender receives: it echoes the host's newest stamp and
/// gives the loss of its datagrams. The stamp also identifies the incarnation, as each has a clock of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Host that the entry is about. If it is the report's sender, the entry is about another live process with the
    /// sender's id.
    pub host: HostId,
    /// Newest stamp that the report's sender has received from the host that the entry is about.
    pub echo: Stamp,
    /// Time from the arrival of the echoed stamp at the report's sender until the report was sent. In an entry about
    /// another process with the sender's id: the uptime of the sender. At most `MAX_HELD_FOR` (16.8 s) is sent.
    pub held: Span,
    /// Number of datagrams that the report's sender did not receive, among the newest 64 of the host that the entry is
    /// about.
    pub lost: u8,
    /// Whether the report's sender asks the host that the entry is about for a liveness proof.
    pub challenge: bool,
    /// Sequence number of the sender's next unicast datagram to the host that the entry is about; `None` on links
    /// without unicast or without a key.
    pub direct: Option<u32>,
}

/// Link report: the stamp of the host that sends it, and an entry with echo, delay and loss for each listed host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// Time at which the report was written, on its sender's clock for stamps.
    pub stamp: Stamp,
    /// Entries about hosts from which the sender receives; one report need not list all.
    pub heard: Vec<Entry>,
}

impl Report {
    /// Returns the content type of the block in which this report is sent: `NumberedReport` if an entry has the number
    /// of the next unicast datagram to its host, otherwise `Report`. All entries are to have such a number, or none.
    pub(crate) fn content(&self) -> Content {
        if self.heard.iter().any(|entry| entry.direct.is_some()) { Content::NumberedReport } else { Content::Report }
    }

    /// Appends the encoded report to `bytes`, as the body of a block.
    pub fn write(&self, bytes: &mut Vec<u8>) {
        let numbered = self.content() == Content::NumberedReport;
        bytes.extend_from_slice(&self.stamp.0.to_le_bytes()[..STAMP_BYTES]);
        for entry in &self.heard {
            bytes.extend_from_slice(&entry.host.0.to_le_bytes());
            bytes.extend_from_slice(&entry.echo.0.to_le_bytes()[..STAMP_BYTES]);
            let held = entry.held.min(MAX_HELD_FOR).as_nanos() / 1000;
            bytes.extend_from_slice(&held.to_le_bytes()[..3]);
            bytes.push(entry.lost & !CHALLENGE | if entry.challenge { CHALLENGE } else { 0 });
            if numbered {
                bytes.extend_from_slice(&entry.direct.unwrap_or_default().to_le_bytes());
            }
        }
    }

    /// Decodes a link report from `bytes`, the body of a block with the content type `content`. Fails if the type is no
    /// report or the length is wrong.
    pub fn read(content: Content, bytes: &[u8]) -> Result<Report, DecodeError> {
        let wrong = DecodeError::Link(content);
        let Some((stamp, rest)) = bytes.split_first_chunk::<STAMP_BYTES>() else { return Err(wrong) };
        let entry = |b: &[u8], direct: Option<u32>| Entry {
            host: HostId(u16::from_le_bytes([b[0], b[1]])),
            echo: Stamp(number(&b[2..8])),
            held: Span::from_nanos(number(&b[8..11]) * 1000),
            lost: b[11] & !CHALLENGE,
            challenge: b[11] & CHALLENGE != 0,
            direct,
        };
        let heard = match content {
            Content::Report => {
                let (entries, []) = rest.as_chunks::<ENTRY_BYTES>() else { return Err(wrong) };
                entries.iter().map(|b| entry(b, None)).collect()
            }
            // A report without entries is never numbered.
            Content::NumberedReport if !rest.is_empty() => {
                let (entries, []) = rest.as_chunks::<NUMBERED_ENTRY_BYTES>() else { return Err(wrong) };
                entries.iter().map(|b| entry(b, Some(u32::from_le_bytes([b[12], b[13], b[14], b[15]])))).collect()
            }
            _ => return Err(wrong),
        };
        Ok(Report { stamp: Stamp(number(stamp)), heard })
    }
}

fn number(bytes: &[u8]) -> u64 {
    bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte))
}

/// Identity of a datagram in acknowledgements and requests to retransmit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DatagramId {
    /// Host that sent the datagram.
    pub host: HostId,
    /// Incarnation (random number of one run) of the host that sent the datagram.
    pub(crate) incarnation: u32,
    /// Whether the datagram is unicast. Sequence numbers of unicast datagrams are counted for each receiver; all others
    /// of the sender are counted together.
    pub direct: bool,
    /// Sequence number of the datagram.
    pub sequence: u32,
}

impl DatagramId {
    /// Returns the id of the datagram with the header `header`.
    pub(crate) fn of(header: &Header) -> DatagramId {
        let Header { sender: host, incarnation, sequence, flags, .. } = *header;
        DatagramId { host, incarnation, direct: flags.has(Flags::DIRECT), sequence }
    }
}

/// Largest number of datagram ids in one block of acknowledgements or of requests to retransmit.
pub(crate) const MAX_IDS: usize = 64;

/// Appends the encoded datagram ids `ids` to `bytes`, as the body of a block of acknowledgements or of requests to
/// retransmit.
pub(crate) fn write_ids(ids: &[DatagramId], bytes: &mut Vec<u8>) {
    for id in ids {
        bytes.extend_from_slice(&id.host.0.to_le_bytes());
        bytes.extend_from_slice(&id.incarnation.to_le_bytes());
        bytes.push(u8::from(id.direct));
        bytes.extend_from_slice(&id.sequence.to_le_bytes());
    }
}

/// Decodes datagram ids from `bytes`, the body of a block of acknowledgements or of requests to retransmit. Fails if
/// there are none, more than `MAX_IDS`, or malformed ones; the error names `content`, the type of the block.
pub fn read_ids(content: Content, bytes: &[u8]) -> Result<Vec<DatagramId>, DecodeError> {
    let (ids, []) = bytes.as_chunks::<ID_BYTES>() else { return Err(DecodeError::Link(content)) };
    if ids.is_empty() || ids.len() > MAX_IDS || ids.iter().any(|id| id[6] > 1) {
        return Err(DecodeError::Link(content));
    }
    let id = |b: &[u8; ID_BYTES]| DatagramId {
        host: HostId(u16::from_le_bytes([b[0], b[1]])),
        incarnation: u32::from_le_bytes([b[2], b[3], b[4], b[5]]),
        direct: b[6] == 1,
        sequence: u32::from_le_bytes([b[7], b[8], b[9], b[10]]),
    };
    Ok(ids.iter().map(id).collect())
}

/// Largest number of sequence numbers in a block that offers earlier datagrams for retransmission.
pub(crate) const MAX_HELD: usize = 16;

/// Appends `held` to `bytes`, as the body of a block that offers retransmission: the sequence numbers of datagrams that
/// the sender still keeps, so that receivers may request them.
pub(crate) fn write_held(held: &[u32], bytes: &mut Vec<u8>) {
    held.iter().for_each(|sequence| bytes.extend_from_slice(&sequence.to_le_bytes()));
}

/// Decodes the sequence numbers of datagrams that the sender offers for retransmission from `bytes`, the body of such a
/// block. Fails if there are more than `MAX_HELD`, or if the length is wrong.
pub fn read_held(bytes: &[u8]) -> Result<Vec<u32>, DecodeError> {
    match bytes.as_chunks::<4>() {
        (held, []) if held.len() <= MAX_HELD => Ok(held.iter().map(|four| u32::from_le_bytes(*four)).collect()),
        _ => Err(DecodeError::Link(Content::Held)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read_and_nothing_shorter() {
        let id = DatagramId { host: HostId(3), incarnation: 1 << 30, direct: true, sequence: u32::MAX };
        let (host, held) = (id.host, Span::from_millis(7));
        for (direct, size) in [(None, ENTRY_BYTES), (Some(u32::MAX), NUMBERED_ENTRY_BYTES)] {
            let entry = Entry { host, echo: Stamp::new(1 << 47), held, lost: 64, challenge: true, direct };
            let report = Report { stamp: Stamp::new(77), heard: vec![entry, Entry { challenge: false, ..entry }] };
            let (content, mut bytes) = (report.content(), Vec::new());
            report.write(&mut bytes);
            assert_eq!((bytes.len(), Report::read(content, &bytes)), (REPORT_BYTES + 2 * size, Ok(report)));
            assert!(Report::read(content, &bytes[1..]).is_err() && Report::read(Content::Ack, &bytes).is_err());
        }
        let mut bytes = Vec::new();
        write_ids(&[id; 2], &mut bytes);
        assert_eq!(read_ids(Content::Ack, &bytes), Ok(vec![id; 2]));
        assert!(read_ids(Content::Ack, &bytes[1..]).is_err() && read_ids(Content::Nack, &[]).is_err());
    }

    #[test]
    fn stamps_are_compared_across_their_wrap_and_none_of_another_clock_has_an_age() {
        let at = |ms: u64| Time::ZERO + Span::from_millis(ms);
        let stamps = Stamps::beginning_at((1 << STAMP_BITS) - 500_000);
        assert_eq!(stamps.age(at(1500), stamps.of(at(100))), Some(Span::from_millis(1400)));
        assert_eq!(stamps.age(at(1500), stamps.of(at(1501))), None, "of the future");
        assert_eq!(stamps.age(at(1500), Stamp::default()), None, "none");
        assert_eq!(stamps.age(at(100), Stamp::new((1 << STAMP_BITS) - 500_001)), None, "of before its beginning");
        assert_eq!(Stamps::beginning_at(1 << 40).age(at(1500), stamps.of(at(1500))), None, "of another clock");
        assert_eq!(stamps.of(at(100)).ahead_us(stamps.of(at(1500))), -1_400_000);
    }
}
