//! Datagrams of RTPS in a network study, and their lengths: OMG DDSI-RTPS 2.5, section 9.4, and what Fast DDS 2.9 adds.

use murmurate::time::Time;

/// Length of the RTPS header \[bytes\] (9.4.4). The following constants are lengths of submessages with their
/// 4-byte headers (9.4.5): DATA includes the encapsulation of 4 bytes (10.2) and excludes the payload; ACKNACK excludes
/// its bitmap.
const HEADER: usize = 20;
const INFO_TS: usize = 12;
/// Length of a submessage INFO_DST \[bytes\], which names the participant that a datagram is for.
pub const INFO_DST: usize = 16;
const DATA: usize = 24 + 4;
const HEARTBEAT: usize = 32;
const ACKNACK: usize = 28;
/// Length of the vendor's submessage 0x80 at the end of every datagram \[bytes\]: counters of Fast DDS that is built
/// with `FASTDDS_STATISTICS`, as Debian's is.
const STATISTICS: usize = 60;
/// Length of an announcement of a participant without header \[bytes\]: SPDP, 8.5.3.
const ANNOUNCEMENT: usize = INFO_TS + 364;

/// Range of sequence numbers of the samples that an RTPS writer keeps for retransmission: the first, and the one
/// after the last.
pub type Holds = (u32, u32);
/// Sample of an RTPS writer: its sequence number and the time of its publication.
pub type Sample = (u32, Time);

/// RTPS message of a station in a network study.
#[derive(Clone, Debug)]
pub enum Packet {
    /// One or more DATA with their INFO_TS: index of the writing station, and the samples in their order.
    Data(u16, Vec<Sample>),
    /// HEARTBEAT: index of the writing station, and the range of samples that it keeps.
    Heartbeat(u16, Holds),
    /// ACKNACK.
    AckNack {
        /// Index of the reading station.
        reader: u16,
        /// Sequence number below which the reader misses no sample.
        base: u32,
        /// Sequence numbers that the reader requests.
        missing: Vec<u32>,
    },
    /// Announcement of a participant (SPDP).
    Announcement,
}

/// Returns the length of `samples` DATA and their INFO_TS, with a payload of `payload` bytes each \[bytes\].
pub fn data_bytes(payload: usize, samples: usize) -> usize {
    samples * (INFO_TS + DATA + payload)
}

impl Packet {
    /// Returns the length of the datagram for samples of `payload` bytes, without INFO_DST \[bytes\].
    pub fn bytes(&self, payload: usize) -> usize {
        HEADER
            + STATISTICS
            + match self {
                Packet::Data(_, samples) => data_bytes(payload, samples.len()),
                Packet::Heartbeat(..) => HEARTBEAT,
                Packet::AckNack { missing, base, .. } => {
                    let bits = missing.last().map_or(0, |last| last - base + 1);
                    ACKNACK + 4 * bits.div_ceil(32) as usize
                }
                Packet::Announcement => ANNOUNCEMENT,
            }
    }
}
