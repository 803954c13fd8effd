//! Blocks of the link layer: link reports, acknowledgements, requests to send again. Bytes only, fixed
//! width, little-endian; what follows from them is decided in `link`.
//!
//! A report is the sender's clock and, for each host that it hears, what it has heard of it. Hosts see from it that
//! the other is alive now (its own clock comes back), how much is lost, and how far the clocks lie apart.

use rand::RngExt;

use super::codec::{Content, DecodeError, Flags, Header};
use crate::messages::ids::HostId;
use crate::random::Stream;
use crate::time::{Span, Time};

/// Bytes of a stamp.
const STAMP_BYTES: usize = 6;
/// Bits of a stamp: it wraps after 2^48 us, which is nine years.
const STAMP_BITS: u32 = 48;
/// Bytes of one host in a report.
pub const ENTRY_BYTES: usize = 12;
/// Bytes of one host in a report that numbers what is for one host alone.
pub const NUMBERED_ENTRY_BYTES: usize = 16;
/// Bytes of a report before its hosts.
pub const REPORT_BYTES: usize = STAMP_BYTES;
/// Bytes of the name of a datagram.
pub const NAME_BYTES: usize = 11;
/// The longest time that an entry can carry: three bytes of microseconds.
pub const MAX_HELD_FOR: Span = Span::from_nanos(0xff_ffff * 1000);
/// The bit of an entry's loss that asks for proof.
const ASKS: u8 = 0x80;

/// An instant as reports carry it \[us\], on the clock of its writer, which began at a random value. Differences are
/// taken modulo 2^48.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stamp(u64);

impl Stamp {
    /// The stamp of so many microseconds. Never zero, which stands for none.
    pub fn new(micros: u64) -> Stamp {
        Stamp((micros % (1 << STAMP_BITS)).max(1))
    }

    /// How far it lies ahead of another stamp of the same clock \[us\]; negative behind it.
    pub fn ahead_us(self, other: Stamp) -> i64 {
        let spare = u64::BITS - STAMP_BITS;
        (self.0.wrapping_sub(other.0) << spare).cast_signed() >> spare
    }
}

/// The clock that a link's stamps are of: it begins at a random value, so that no stamp of a former run is one of now.
#[derive(Clone, Copy, Debug)]
pub struct Stamps(u64);

impl Stamps {
    /// A clock that begins at `base` microseconds.
    pub fn beginning_at(base: u64) -> Stamps {
        Stamps(base)
    }

    /// A clock that begins at random.
    pub fn random(stream: &mut Stream) -> Stamps {
        Stamps(stream.random_range(0..1 << STAMP_BITS))
    }

    /// The stamp of an instant.
    pub fn of(self, time: Time) -> Stamp {
        Stamp::new(self.0.wrapping_add(time.as_nanos() / 1000))
    }

    /// How long ago this stamp was given; none if it never was.
    pub fn age(self, now: Time, stamp: Stamp) -> Option<Span> {
        let micros = u64::try_from(self.of(now).ahead_us(stamp)).ok()?;
        (stamp != Stamp::default() && micros <= now.as_nanos() / 1000).then(|| Span::from_nanos(micros * 1000))
    }
}

/// An entry of a report, about one host that is heard. The echo shows the incarnation: each has stamps of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The host; that of the report's sender for another live incarnation of it.
    pub host: HostId,
    /// The newest stamp of this host, on its own clock.
    pub echo: Stamp,
    /// How long ago that came. For another incarnation of the sender: how long the sender has run, at most
    /// `MAX_HELD_FOR`.
    pub held: Span,
    /// How many of its newest 64 datagrams were lost.
    pub lost: u8,
    /// Whether the sender asks this host for proof that it is alive.
    pub asks: bool,
    /// The number of the next datagram that goes to this host alone, on links where any does.
    pub direct: Option<u32>,
}

/// A link report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// When it was written, on its sender's clock.
    pub stamp: Stamp,
    /// The hosts that are heard.
    pub heard: Vec<Entry>,
}

impl Report {
    /// The content of a block with this report: either all entries have the number of the next direct datagram or none.
    pub fn content(&self) -> Content {
        if self.heard.iter().any(|entry| entry.direct.is_some()) { Content::NumberedReport } else { Content::Report }
    }

    /// Appends its bytes.
    pub fn write(&self, bytes: &mut Vec<u8>) {
        let numbered = self.content() == Content::NumberedReport;
        bytes.extend_from_slice(&self.stamp.0.to_le_bytes()[..STAMP_BYTES]);
        for entry in &self.heard {
            bytes.extend_from_slice(&entry.host.0.to_le_bytes());
            bytes.extend_from_slice(&entry.echo.0.to_le_bytes()[..STAMP_BYTES]);
            let held = entry.held.min(MAX_HELD_FOR).as_nanos() / 1000;
            bytes.extend_from_slice(&held.to_le_bytes()[..3]);
            bytes.push(entry.lost & !ASKS | if entry.asks { ASKS } else { 0 });
            if numbered {
                bytes.extend_from_slice(&entry.direct.unwrap_or_default().to_le_bytes());
            }
        }
    }

    /// Reads the bytes of a block that holds a report.
    pub fn read(content: Content, bytes: &[u8]) -> Result<Report, DecodeError> {
        let wrong = DecodeError::Link(content);
        let Some((stamp, rest)) = bytes.split_first_chunk::<STAMP_BYTES>() else { return Err(wrong) };
        let entry = |b: &[u8], direct: Option<u32>| Entry {
            host: HostId(u16::from_le_bytes([b[0], b[1]])),
            echo: Stamp(number(&b[2..8])),
            held: Span::from_nanos(number(&b[8..11]) * 1000),
            lost: b[11] & !ASKS,
            asks: b[11] & ASKS != 0,
            direct,
        };
        let heard = match content {
            Content::Report => {
                let (entries, []) = rest.as_chunks::<ENTRY_BYTES>() else { return Err(wrong) };
                entries.iter().map(|b| entry(b, None)).collect()
            }
            // An empty one has no second form.
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

/// One datagram, by name: in acknowledgements and in requests to send again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Name {
    /// The host that sent it.
    pub host: HostId,
    /// That host's incarnation.
    pub epoch: u32,
    /// Whether it is counted among those that are for one host.
    pub direct: bool,
    /// Its number.
    pub sequence: u32,
}

impl Name {
    /// The name of the datagram with this header.
    pub fn of(header: &Header) -> Name {
        let Header { sender: host, epoch, sequence, flags, .. } = *header;
        Name { host, epoch, direct: flags.has(Flags::DIRECT), sequence }
    }
}

/// The most names in one block.
pub const MAX_NAMES: usize = 64;

/// Appends the bytes of some names.
pub fn write_names(names: &[Name], bytes: &mut Vec<u8>) {
    for name in names {
        bytes.extend_from_slice(&name.host.0.to_le_bytes());
        bytes.extend_from_slice(&name.epoch.to_le_bytes());
        bytes.push(u8::from(name.direct));
        bytes.extend_from_slice(&name.sequence.to_le_bytes());
    }
}

/// Reads the names of a block.
pub fn read_names(content: Content, bytes: &[u8]) -> Result<Vec<Name>, DecodeError> {
    let (names, []) = bytes.as_chunks::<NAME_BYTES>() else { return Err(DecodeError::Link(content)) };
    if names.is_empty() || names.len() > MAX_NAMES || names.iter().any(|name| name[6] > 1) {
        return Err(DecodeError::Link(content));
    }
    let name = |b: &[u8; NAME_BYTES]| Name {
        host: HostId(u16::from_le_bytes([b[0], b[1]])),
        epoch: u32::from_le_bytes([b[2], b[3], b[4], b[5]]),
        direct: b[6] == 1,
        sequence: u32::from_le_bytes([b[7], b[8], b[9], b[10]]),
    };
    Ok(names.iter().map(name).collect())
}

/// The most numbers in one block of datagrams that are held.
pub const MAX_HELD: usize = 16;

/// Appends the numbers of datagrams that may be asked for.
pub fn write_held(held: &[u32], bytes: &mut Vec<u8>) {
    held.iter().for_each(|sequence| bytes.extend_from_slice(&sequence.to_le_bytes()));
}

/// Reads them.
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
        let name = Name { host: HostId(3), epoch: 1 << 30, direct: true, sequence: u32::MAX };
        let (host, held) = (name.host, Span::from_millis(7));
        for (direct, size) in [(None, ENTRY_BYTES), (Some(u32::MAX), NUMBERED_ENTRY_BYTES)] {
            let entry = Entry { host, echo: Stamp::new(1 << 47), held, lost: 64, asks: true, direct };
            let report = Report { stamp: Stamp::new(77), heard: vec![entry, Entry { asks: false, ..entry }] };
            let (content, mut bytes) = (report.content(), Vec::new());
            report.write(&mut bytes);
            assert_eq!((bytes.len(), Report::read(content, &bytes)), (REPORT_BYTES + 2 * size, Ok(report)));
            assert!(Report::read(content, &bytes[1..]).is_err() && Report::read(Content::Ack, &bytes).is_err());
        }
        let mut bytes = Vec::new();
        write_names(&[name; 2], &mut bytes);
        assert_eq!(read_names(Content::Ack, &bytes), Ok(vec![name; 2]));
        assert!(read_names(Content::Ack, &bytes[1..]).is_err() && read_names(Content::Nack, &[]).is_err());
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
