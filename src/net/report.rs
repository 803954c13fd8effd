//! What the link layer says for itself: link reports, acknowledgements, requests to send again. Bytes only, fixed
//! width, little-endian; what follows from them is decided in `link`.
//!
//! A report is the sender's clock and, for each host that it hears, what it has heard of it. Hosts see from it that
//! the other is alive now (its own clock comes back), how much is lost, and how far the clocks lie apart.

use super::codec::{Content, DecodeError};
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

const STAMP_BYTES: usize = 6;
/// Bytes of one host in a report.
pub const ENTRY_BYTES: usize = 20;
/// Bytes of a report before its hosts.
pub const REPORT_BYTES: usize = STAMP_BYTES;
const NAME_BYTES: usize = 11;

/// An instant as reports carry it \[us\], on the clock of whoever wrote it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stamp(u64);

impl Stamp {
    /// The stamp of an instant on this host's clock. Never zero, which stands for none.
    pub fn of(time: Time) -> Stamp {
        Stamp((time.as_nanos() / 1000 % (1 << 48)).max(1))
    }

    /// Microseconds.
    pub fn micros(self) -> u64 {
        self.0
    }
}

/// What a report says of one host that is heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The host.
    pub host: HostId,
    /// Its incarnation.
    pub epoch: u32,
    /// The newest stamp that it has sent, on its own clock; zero for none of late.
    pub echo: Stamp,
    /// How long ago that came.
    pub held: Span,
    /// How many of its newest 64 datagrams were lost.
    pub lost: u8,
    /// The number of the next datagram that goes to this host alone.
    pub direct: u32,
}

/// A link report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    /// When it was written, on its sender's clock.
    pub stamp: Stamp,
    /// What is heard.
    pub heard: Vec<Entry>,
}

impl Report {
    /// Appends its bytes.
    pub fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&self.stamp.0.to_le_bytes()[..STAMP_BYTES]);
        for entry in &self.heard {
            bytes.extend_from_slice(&entry.host.0.to_le_bytes());
            bytes.extend_from_slice(&entry.epoch.to_le_bytes());
            bytes.extend_from_slice(&entry.echo.0.to_le_bytes()[..STAMP_BYTES]);
            let held = (entry.held.as_nanos() / 1000).min(0xff_ffff) as u32;
            bytes.extend_from_slice(&held.to_le_bytes()[..3]);
            bytes.push(entry.lost);
            bytes.extend_from_slice(&entry.direct.to_le_bytes());
        }
    }

    /// Reads its bytes.
    pub fn read(bytes: &[u8]) -> Result<Report, DecodeError> {
        let wrong = DecodeError::Link(Content::Report);
        let Some((stamp, rest)) = bytes.split_first_chunk::<STAMP_BYTES>() else { return Err(wrong) };
        let (entries, []) = rest.as_chunks::<ENTRY_BYTES>() else { return Err(wrong) };
        let entry = |b: &[u8; ENTRY_BYTES]| Entry {
            host: HostId(u16::from_le_bytes([b[0], b[1]])),
            epoch: u32::from_le_bytes([b[2], b[3], b[4], b[5]]),
            echo: Stamp(number(&b[6..12])),
            held: Span::from_nanos(number(&b[12..15]) * 1000),
            lost: b[15],
            direct: u32::from_le_bytes([b[16], b[17], b[18], b[19]]),
        };
        Ok(Report { stamp: Stamp(number(stamp)), heard: entries.iter().map(entry).collect() })
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
        let (host, epoch, held) = (name.host, name.epoch, Span::from_millis(7));
        let entry = Entry { host, epoch, echo: Stamp(1 << 47), held, lost: 64, direct: 5 };
        let report = Report { stamp: Stamp(77), heard: vec![entry; 2] };
        let mut bytes = Vec::new();
        report.write(&mut bytes);
        assert_eq!((bytes.len(), Report::read(&bytes)), (REPORT_BYTES + 2 * ENTRY_BYTES, Ok(report)));
        assert!(Report::read(&bytes[1..]).is_err());
        let mut bytes = Vec::new();
        write_names(&[name; 2], &mut bytes);
        assert_eq!(read_names(Content::Ack, &bytes), Ok(vec![name; 2]));
        assert!(read_names(Content::Ack, &bytes[1..]).is_err() && read_names(Content::Nack, &[]).is_err());
    }
}
