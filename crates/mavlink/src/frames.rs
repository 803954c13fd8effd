//! Frames of MAVLink 1 and 2: how they are found in bytes, read, and made.

use mavlink::dialects::common::MavMessage;
use mavlink::{MAV_STX, MAV_STX_V2, MAVLinkV1MessageRaw, MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, Message};

use super::signing::{SIGNED, Signer};

/// Bytes of a frame beside its payload: of MAVLink 1, of MAVLink 2, and those of a signature.
const AROUND: [usize; 3] = [8, 12, 13];
/// Largest frame \[bytes\]: of MAVLink 2 with a signature.
pub const LARGEST: usize = 280;

/// Version of MAVLink.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Version {
    /// MAVLink 1, without signatures and with messages up to number 255.
    One,
    /// MAVLink 2.
    Two,
}

/// Content of a link's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found<'a> {
    /// A whole frame with a correct checksum.
    Frame(&'a [u8]),
    /// A frame of a message that the dialect lacks, so its checksum is unknown.
    Unknown,
    /// Bytes that begin like a frame and are none.
    Damaged,
}

/// Sender and content of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// Number of the system (the vehicle) that has sent it.
    pub system: u8,
    /// Number of the component of the system; autopilots are 1.
    pub component: u8,
    /// Content of the frame.
    pub message: MavMessage,
}

/// Header of a frame whose bytes are all there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Version of the frame.
    pub version: Version,
    /// Whether the frame has a signature.
    pub signed: bool,
    /// Number of the system that has sent it.
    pub system: u8,
    /// Number of the component that has sent it.
    pub component: u8,
    /// Number of the message.
    pub id: u32,
}

/// Returns the length of the frame that begins with `bytes`: `None` if they are too few to tell, and an error if no
/// frame begins so.
fn length(bytes: &[u8]) -> Result<Option<usize>, ()> {
    match bytes {
        [] | [MAV_STX | MAV_STX_V2] | [MAV_STX_V2, _] => Ok(None),
        [MAV_STX, length, ..] => Ok(Some(usize::from(*length) + AROUND[0])),
        // Other flags change the form of a frame.
        [MAV_STX_V2, _, flags, ..] if flags & !SIGNED != 0 => Err(()),
        [MAV_STX_V2, length, flags, ..] => {
            Ok(Some(usize::from(*length) + AROUND[1] + if flags & SIGNED == 0 { 0 } else { AROUND[2] }))
        }
        _ => Err(()),
    }
}

/// Returns the header of a whole frame.
pub fn header(frame: &[u8]) -> Option<Header> {
    match *frame {
        [MAV_STX, _, _, system, component, id, ..] => {
            Some(Header { version: Version::One, signed: false, system, component, id: id.into() })
        }
        [MAV_STX_V2, _, flags, _, _, system, component, low, middle, high, ..] => {
            let (id, signed) = (u32::from_le_bytes([low, middle, high, 0]), flags & SIGNED != 0);
            Some(Header { version: Version::Two, signed, system, component, id })
        }
        _ => None,
    }
}

/// Returns a frame of MAVLink 2 in the buffer that the crate computes signatures from.
pub fn raw(frame: &[u8]) -> MAVLinkV2MessageRaw {
    let mut raw = MAVLinkV2MessageRaw::new();
    let length = frame.len().min(raw.as_slice().len());
    raw.as_mut_slice()[..length].copy_from_slice(&frame[..length]);
    raw
}

/// Whether the checksum of a whole frame is correct; `None` if the dialect lacks its message.
fn is_whole(frame: &[u8], header: Header) -> Option<bool> {
    let whole = match header.version {
        Version::One => {
            let mut raw = MAVLinkV1MessageRaw::new();
            raw.as_mut_slice()[..frame.len()].copy_from_slice(frame);
            raw.has_valid_crc::<MavMessage>()
        }
        Version::Two => raw(frame).has_valid_crc::<MavMessage>(),
    };
    let known = whole || MavMessage::default_message_from_id(header.id).is_some();
    known.then_some(whole)
}

/// Reads a whole frame. The error is the reason for which it is not understood.
pub fn parse(frame: &[u8]) -> Result<Received, &'static str> {
    let Header { version, system, component, id, .. } = header(frame).ok_or("a frame is cut")?;
    let (version, front) = match version {
        Version::One => (MavlinkVersion::V1, 6),
        Version::Two => (MavlinkVersion::V2, 10),
    };
    let payload = frame.get(front..front + usize::from(frame[1])).ok_or("a frame is cut")?;
    let message = MavMessage::parse(version, id, payload).map_err(|_| "a message has a value that is unknown here")?;
    Ok(Received { system, component, message })
}

/// Splitter of a stream of bytes into frames; of datagrams, which contain whole frames, if it is emptied after each.
#[derive(Debug, Default)]
pub struct Splitter(Vec<u8>);

impl Splitter {
    /// Takes bytes, and calls `each` with what they complete. Bytes of no frame are skipped.
    pub fn take(&mut self, bytes: &[u8], mut each: impl FnMut(Found)) {
        self.0.extend_from_slice(bytes);
        let mut at = 0;
        while let Some(next) = self.0[at..].iter().position(|byte| [MAV_STX, MAV_STX_V2].contains(byte)) {
            at += next;
            let rest = &self.0[at..];
            at += match length(rest) {
                Ok(Some(length)) if length <= rest.len() => {
                    let frame = &rest[..length];
                    match header(frame).and_then(|header| is_whole(frame, header)) {
                        Some(true) => {
                            each(Found::Frame(frame));
                            length
                        }
                        Some(false) => {
                            each(Found::Damaged);
                            1
                        }
                        None => {
                            each(Found::Unknown);
                            length
                        }
                    }
                }
                Ok(_) => {
                    self.0.drain(..at);
                    return;
                }
                Err(()) => {
                    each(Found::Damaged);
                    1
                }
            };
        }
        self.0.clear();
    }

    /// Forgets a frame that has begun and did not end, as at the end of a datagram. Returns whether there was one.
    pub fn end(&mut self) -> bool {
        let begun = !self.0.is_empty();
        self.0.clear();
        begun
    }
}

/// Maker of the frames of one sender: numbers them, and signs them if its link is signed.
#[derive(Debug)]
pub struct Framer {
    system: u8,
    component: u8,
    sequence: u8,
    version: Version,
    /// Signatures of the link; `None` if it is not signed.
    pub signer: Option<Signer>,
}

impl Framer {
    /// Makes the framer of a component of a system, without signatures.
    pub fn new(system: u8, component: u8, version: Version) -> Framer {
        Framer { system, component, sequence: 0, version, signer: None }
    }

    /// Makes the framer of a component of a system whose frames are signed, and so of MAVLink 2.
    pub fn signed(system: u8, component: u8, signer: Signer) -> Framer {
        Framer { signer: Some(signer), ..Framer::new(system, component, Version::Two) }
    }

    /// Returns the next frame, with this message. `now` is the time for a signature: units of 10 us since the beginning
    /// of 2015.
    pub fn frame(&mut self, now: u64, message: &MavMessage) -> Vec<u8> {
        let header = MavHeader { system_id: self.system.into(), component_id: self.component, sequence: self.sequence };
        self.sequence = self.sequence.wrapping_add(1);
        match (self.version, &mut self.signer) {
            (Version::One, _) => {
                let mut raw = MAVLinkV1MessageRaw::new();
                raw.serialize_message(header, message);
                raw.raw_bytes().to_vec()
            }
            (Version::Two, None) => {
                let mut raw = MAVLinkV2MessageRaw::new();
                raw.serialize_message(header, message);
                raw.raw_bytes().to_vec()
            }
            (Version::Two, Some(signer)) => {
                let mut raw = MAVLinkV2MessageRaw::new();
                raw.serialize_message_for_signing(header, message);
                signer.sign(now, &mut raw);
                raw.raw_bytes().to_vec()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use mavlink::dialects::common::{ATTITUDE_DATA, HEARTBEAT_DATA};
    use proptest::prelude::*;

    fn attitude(yaw: f32) -> MavMessage {
        MavMessage::ATTITUDE(ATTITUDE_DATA { time_boot_ms: 7, yaw, ..ATTITUDE_DATA::DEFAULT })
    }

    fn all(bytes: &[u8], piece: usize) -> (Vec<Received>, usize) {
        let (mut splitter, mut found, mut damaged) = (Splitter::default(), Vec::new(), 0);
        for part in bytes.chunks(piece.max(1)) {
            splitter.take(part, |what| match what {
                Found::Frame(frame) => found.extend(parse(frame)),
                Found::Damaged => damaged += 1,
                Found::Unknown => {}
            });
        }
        (found, damaged)
    }

    /// The messages of `sent` by pymavlink 2.4.50, of MAVLink 1.
    const ONE: [&str; 4] = [
        "fe090001bf00000000001208000403058c",
        "fe350101bf54e80300000000000000000000000000000000003f000080be000000000000000000000000000000000000\
         000000000000e70d01010157e6",
        "fe210201bf4c0000803f0000c0400000000000000000000000000000000000000000b0000101009134",
        "fe140301bf14ffff0101434f4d5f4f465f4c4f53535f54000000532b",
    ];
    /// The same of MAVLink 2.
    const TWO: [&str; 4] = [
        "fd0900000001bf000000000000001208000403aec6",
        "fd3500000101bf540000e80300000000000000000000000000000000003f000080be0000000000000000000000000000\
         00000000000000000000e70d0101013202",
        "fd2000000201bf4c00000000803f0000c0400000000000000000000000000000000000000000b00001019c2a",
        "fd1100000301bf140000ffff0101434f4d5f4f465f4c4f53535f54b8ed",
    ];
    /// The same, signed by a key of bytes 0x0f from the time 37e12 on.
    const SIGNED: [&str; 4] = [
        "fd0901000001bf000000000000001208000403493e000050dbbba6212bc49cf9e9e6",
        "fd3501000101bf540000e80300000000000000000000000000000000003f000080be0000000000000000000000000000\
         00000000000000000000e70d010101a27d000150dbbba621273c4f400e6f",
        "fd2001000201bf4c00000000803f0000c0400000000000000000000000000000000000000000b00001014bb4000250db\
         bba62190fdd6d9cec8",
        "fd1101000301bf140000ffff0101434f4d5f4f465f4c4f53535f54e820000350dbbba6214fae62910a96",
    ];

    /// Messages that a host sends.
    fn sent() -> [MavMessage; 4] {
        let config = crate::settings::tests_config("");
        let velocity = murmurate::messages::geometry::Vec2::new(-0.25, 0.5);
        let wanted = crate::orders::Wanted { velocity, ..crate::orders::Wanted::STAND };
        let now = murmurate::time::Time::from_nanos(1_000_000_000);
        let mode = crate::firmware::Mode::followed(config.firmware, config.vehicle);
        [
            crate::orders::heartbeat(),
            crate::orders::setpoint(&config, now, &wanted),
            crate::orders::set_mode(&config, mode),
            crate::orders::parameter(&config.link, "COM_OF_LOSS_T"),
        ]
    }

    #[test]
    fn every_byte_is_that_of_pymavlink_signatures_included() {
        let key = crate::signing::Key::read(&b"0f".repeat(32)).expect("a key");
        let signer = Signer::new(key);
        let kinds = [
            (ONE, Framer::new(1, 191, Version::One)),
            (TWO, Framer::new(1, 191, Version::Two)),
            (SIGNED, Framer::signed(1, 191, signer.clone())),
        ];
        let mut judge = signer;
        for (expected, mut framer) in kinds {
            for (message, hex) in sent().iter().zip(expected) {
                let bytes = data_encoding::HEXLOWER.decode(hex.as_bytes()).expect("hexadecimal digits");
                assert_eq!(framer.frame(37_000_000_000_000, message), bytes, "{message:?}");
                let read = parse(&bytes).expect("a frame");
                assert_eq!((read.system, read.component, &read.message), (1, 191, message));
                if framer.signer.is_some() {
                    assert_eq!(judge.check(37_000_000_000_000, &raw(&bytes)), Ok(()));
                }
            }
        }
    }

    #[test]
    fn several_frames_of_both_versions_are_found_in_any_pieces() {
        let mut bytes = Vec::new();
        for version in [Version::One, Version::Two] {
            let mut framer = Framer::new(3, 1, version);
            (0..5u8).for_each(|k| bytes.extend(framer.frame(0, &attitude(k.into()))));
            bytes.extend([0, 17]);
        }
        for piece in [1, 2, 7, 30, 1000] {
            let (found, damaged) = all(&bytes, piece);
            let yaws: Vec<&MavMessage> = found.iter().map(|received| &received.message).collect();
            assert_eq!((found.len(), damaged), (10, 0), "{piece}: {yaws:?}");
            assert!(found.iter().all(|one| (one.system, one.component) == (3, 1)));
            assert_eq!(*yaws[4], attitude(4.0));
        }
    }

    #[test]
    fn a_changed_bit_costs_its_frame_alone() {
        let mut framer = Framer::new(3, 1, Version::Two);
        let frames: Vec<Vec<u8>> = (0..3u8).map(|k| framer.frame(0, &attitude(f32::from(k) + 0.5))).collect();
        let whole = frames.concat();
        for bit in 0..frames[1].len() * 8 {
            let mut bytes = whole.clone();
            bytes[frames[0].len() + bit / 8] ^= 1 << (bit % 8);
            let (found, _) = all(&bytes, 1000);
            let yaw = |at: usize| found.get(at).map(|one| one.message.clone());
            assert_eq!(yaw(0), Some(attitude(0.5)), "bit {bit}");
            assert!(!found.iter().any(|one| one.message == attitude(1.5)), "bit {bit}");
        }
    }

    #[test]
    fn a_message_that_the_dialect_lacks_is_skipped_as_a_whole() {
        let mut framer = Framer::new(3, 1, Version::Two);
        let mut odd = framer.frame(0, &MavMessage::HEARTBEAT(HEARTBEAT_DATA::default()));
        // Number 11020 is of ArduPilot's own dialect.
        odd[7..10].copy_from_slice(&[0x0c, 0x2b, 0]);
        let bytes = [odd, framer.frame(0, &attitude(1.0))].concat();
        assert_eq!(all(&bytes, 1000).0.len(), 1);
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic_or_keep_more_than_a_frame(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let mut splitter = Splitter::default();
            for part in bytes.chunks(50) {
                splitter.take(part, |what| if let Found::Frame(frame) = what { drop(parse(frame)) });
                prop_assert!(splitter.0.len() < LARGEST + 26);
            }
        }
    }
}
