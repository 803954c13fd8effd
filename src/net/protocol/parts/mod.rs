//! Messages in parts, which are too large for one datagram: pace and repair of what a host sends (`outbox`), and what
//! it receives (`inbox`). Pure.
//!
//! The parts of a message leave one after the other over a part of the policy's period, so that everything else finds
//! the channel free in between. A receiver knows from any part how many there are and when the others have left. It
//! asks for those that are missing, and waits for them for one period. A newer message replaces an older one
//! everywhere.

mod inbox;
mod link;
mod outbox;

pub use inbox::{Inbox, Refused};
pub use outbox::Outbox;

use std::sync::Arc;

use super::codec::{Content, DecodeError, TAG_BYTES};
use crate::messages::ids::RobotId;
use crate::messages::wire::{Encoding, Features, Form, GRAIN, Latent, MAX_PART_BYTES, Part, Piece, Wire, cut};
use crate::time::Span;

/// Share of the period over which the parts of a message leave. In the rest of it those that are lost are repaired: at
/// a loss of 20 % four receivers together ask for each part about once.
const PACE: f64 = 0.4;
/// Time after which a receiver asks again for a part, as a share of the period.
const RETRY: f64 = 0.12;
/// Bytes of a part without its floats: headers of the datagram and the block, and the fields of a latent.
const OVERHEAD: usize = 88;
/// Length of an encoded [`Lacking`] \[bytes\].
const LACKING_BYTES: usize = 20;
/// Largest number of messages of which one datagram lists missing parts.
const MAX_LACKING: usize = 32;

/// Settings of a host for the messages in parts of its team.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Form of the messages.
    pub form: Form,
    /// Number of floats of a message.
    pub floats: usize,
    /// Period of the policy: time between two messages of a robot.
    pub period: Span,
    /// Beginning of the policy's digest.
    pub policy: u32,
}

impl Settings {
    /// Returns the time between two parts of a message of `parts` parts.
    fn spacing(&self, parts: u8) -> Span {
        Span::from_secs(self.period.as_secs() * PACE / f64::from(parts.max(1)))
    }

    /// Returns the number of datagrams that a host of `robots` robots sends per second, with all repairs.
    pub fn datagrams_per_s(&self, robots: usize) -> f64 {
        let (datagrams, _) = datagrams(self.floats, self.form.encoding);
        3.0 * (robots * datagrams) as f64 / self.period.as_secs()
    }

    /// Returns the time after which a receiver asks again for a part.
    fn retry(&self) -> Span {
        Span::from_secs(self.period.as_secs() * RETRY)
    }

    /// Returns the largest number of bytes of floats in a part, where a datagram has `room` bytes without its tags.
    pub fn most(room: usize) -> usize {
        room.saturating_sub(OVERHEAD).min(MAX_PART_BYTES)
    }
}

/// Returns the number of datagrams of a message of `floats` floats, and their length without UDP, with the tag of a
/// team with one key \[bytes\].
pub fn datagrams(floats: usize, encoding: Encoding) -> (usize, usize) {
    let bytes = floats * encoding.bytes();
    let parts = bytes.div_ceil(MAX_PART_BYTES);
    (parts, cut(bytes, parts.max(1)) + OVERHEAD + TAG_BYTES)
}

/// Parts of a message that a host has not received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lacking {
    /// Robot that has sent the message.
    pub robot: RobotId,
    /// Number of the message.
    pub message: u16,
    /// Bit for each part of the message, that of part 0 lowest: whether it is missing.
    pub parts: u128,
}

impl Lacking {
    /// Appends the encoded list `all` to `bytes`, as the body of a block.
    pub(super) fn write(all: &[Lacking], bytes: &mut Vec<u8>) {
        for Lacking { robot, message, parts } in all.iter().take(MAX_LACKING) {
            bytes.extend_from_slice(&robot.0.to_le_bytes());
            bytes.extend_from_slice(&message.to_le_bytes());
            bytes.extend_from_slice(&parts.to_le_bytes());
        }
    }

    /// Decodes the body of a block. Fails if it lists none, too many or half a one.
    pub fn read(bytes: &[u8]) -> Result<Vec<Lacking>, DecodeError> {
        let (all, []) = bytes.as_chunks::<LACKING_BYTES>() else { return Err(DecodeError::Link(Content::Lacking)) };
        if all.is_empty() || all.len() > MAX_LACKING {
            return Err(DecodeError::Link(Content::Lacking));
        }
        let read = |bytes: &[u8; LACKING_BYTES]| {
            let [r0, r1, m0, m1, parts @ ..] = *bytes;
            let (robot, message) = (RobotId(u16::from_le_bytes([r0, r1])), u16::from_le_bytes([m0, m1]));
            Lacking { robot, message, parts: u128::from_le_bytes(parts) }
        };
        Ok(all.iter().map(read).collect())
    }
}

/// Returns the parts of a message whose floats are rounded to `encoding`, of at most `most` bytes of floats each.
/// `message` is its number, and `policy` the beginning of the digest of the sender's policy.
///
/// # Panics
/// If the message has no float, more than `MAX_FLOATS`, or would have more than `MAX_PARTS` parts.
pub fn split(latent: &Latent, encoding: Encoding, (message, policy): (u16, u32), most: usize) -> Vec<Latent> {
    let (all, exponent) = encoding.encode(&latent.features.0);
    let most = most.clamp(GRAIN, MAX_PART_BYTES) / GRAIN * GRAIN;
    let parts = all.len().div_ceil(most);
    let number = |number: usize| u8::try_from(number).expect("a message has at most 128 parts");
    let floats = u16::try_from(latent.features.0.len()).expect("a message has at most 16 384 floats");
    let nothing: Arc<[f32]> = Arc::from([]);
    let part = |(index, bytes): (usize, &[u8])| Latent {
        features: Features(Arc::clone(&nothing)),
        part: Some(Part {
            message,
            index: number(index),
            of: number(parts),
            floats,
            encoding: encoding.code(),
            exponent,
            policy,
            bytes: Piece(bytes.into()),
        }),
        ..latent.clone()
    };
    all.chunks(cut(all.len(), parts)).enumerate().map(part).collect()
}

/// Returns the numbers of the parts whose bits are set.
fn numbers(parts: u128) -> impl Iterator<Item = u8> {
    (0..128).filter(move |index| parts & (1 << index) != 0)
}

/// Returns whether a message is one of the parts of another.
pub fn is_part(message: &Wire) -> bool {
    matches!(message, Wire::Latent(Latent { part: Some(_), .. }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::messages::wire::{MAX_FLOATS, MAX_PARTS, Missing, Phase, Round};
    use crate::time::Time;

    pub(super) const FLOATS: usize = 6144;
    pub(super) const POLICY: u32 = 5;

    pub(super) fn settings(missing: Missing) -> Settings {
        let form = Form { encoding: Encoding::F16, missing };
        Settings { form, floats: FLOATS, period: Span::from_millis(100), policy: POLICY }
    }

    /// The twelve parts of message `message`, all of whose floats are `value`.
    pub(super) fn parts(message: u16, value: f32) -> Vec<Latent> {
        let features = Features(vec![value; FLOATS].into());
        let (round, phase, motion) = (Round::default(), Phase::Running, Motion::default());
        let whole = Latent { robot: RobotId(1), round, phase, motion, features, part: None };
        split(&whole, Encoding::F16, (message, POLICY), MAX_PART_BYTES)
    }

    pub(super) fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn parts_make_up_the_message_whatever_its_size_and_encoding() {
        let (round, phase, motion) = (Round::default(), Phase::Running, Motion::default());
        for encoding in Encoding::ALL {
            for number in [1, 2, 3, 255, 256, 257, 1023, 6144, MAX_FLOATS] {
                for most in [4, 500, MAX_PART_BYTES, 9000] {
                    if number * encoding.bytes() > MAX_PARTS * most.min(MAX_PART_BYTES) {
                        continue;
                    }
                    let mut whole: Vec<f32> = (0..number).map(|at| libm::sinf(at as f32) * 9.0).collect();
                    encoding.round(&mut whole);
                    let features = Features(whole.clone().into());
                    let latent = Latent { robot: RobotId(3), round, phase, motion, features, part: None };
                    let mut joined = vec![f32::NAN; number];
                    for part in split(&latent, encoding, (7, 9), most) {
                        assert!(Wire::Latent(part.clone()).check().is_ok(), "{encoding} {number} {most}");
                        let part = part.part.expect("it is a part");
                        assert!(part.bytes.0.len() <= most, "{encoding} {number} {most}");
                        part.write(&mut joined);
                    }
                    assert_eq!(joined, whole, "{encoding} {number} {most}");
                }
            }
        }
    }

    #[test]
    fn a_list_of_missing_parts_survives_the_wire_and_half_a_one_does_not() {
        let all =
            [1_u16, 7, 65_535].map(|at| Lacking { robot: RobotId(at), message: at, parts: u128::MAX >> at.min(99) });
        let mut bytes = Vec::new();
        Lacking::write(&all, &mut bytes);
        assert_eq!(Lacking::read(&bytes), Ok(all.to_vec()));
        let wrong = Err(DecodeError::Link(Content::Lacking));
        assert_eq!(Lacking::read(&bytes[1..]), wrong);
        assert_eq!(Lacking::read(&[]), wrong);
        assert_eq!(Lacking::read(&[0; LACKING_BYTES * (MAX_LACKING + 1)]), wrong);
    }
}
