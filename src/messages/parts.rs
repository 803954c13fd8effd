//! Messages that are too large for one datagram: how their floats are encoded, and the parts in which they travel.
//!
//! Each part has all fields of the message but its floats, and a piece of these, so that it is a message of its own on
//! every link. `net::protocol::parts` sends and joins them.

use std::fmt;
use std::sync::Arc;

use half::{bf16, f16};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::body::Unfit;
use super::floats::{MAX_FEATURES, MAX_FLOATS, all_sound};

/// Largest number of bytes of floats in one part.
pub const MAX_PART_BYTES: usize = 1024;
/// Largest number of parts of a message: a bit for each fits into 128. So many of 512 bytes are `MAX_FLOATS` floats of
/// four bytes.
pub const MAX_PARTS: usize = 128;
/// Size to whose multiples parts are cut \[bytes\], so that no float lies in two parts.
pub(crate) const GRAIN: usize = 4;
/// Largest number that an encoding with eight bits has.
const MAX_INT8: f32 = 127.0;
/// Number that is added to an exponent in a message, in which all numbers are unsigned.
const BIAS: i32 = 128;
/// Smallest exponent of an encoding with eight bits. Floats below 2^-121 are zero with it.
const MIN_EXPONENT: i32 = -120;

/// Encoding of the floats of a policy's message on the wire. Robots compute with 32 bits; what they send is rounded
/// first, so that every robot hears the same numbers, whether a message has crossed a network or not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// IEEE 754 binary32, four bytes: nothing is rounded.
    #[default]
    F32,
    /// IEEE 754 binary16, two bytes: 11 significant bits, up to 65 504.
    F16,
    /// The upper half of a binary32, two bytes: 8 significant bits, and the range of 32 bits.
    Bf16,
    /// Integers of one byte, times one power of two for the whole message.
    Int8,
}

/// Use of a message in parts of which some have not arrived in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Missing {
    /// The message is not used.
    #[default]
    Whole,
    /// The floats of a missing part are those of the sender's message before.
    Last,
    /// The floats of a missing part are zero.
    Zero,
}

/// Form in which the message of a policy travels. The default is that of messages that fit into a datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Form {
    /// Encoding of the floats.
    pub encoding: Encoding,
    /// Use of a message of which some parts are missing.
    pub missing: Missing,
}

/// Piece of the floats of a message, one of several parts that make it up.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// Number of the message: the next higher one for each message of the sender, modulo 2^16.
    pub message: u16,
    /// Number of this part, from zero.
    pub index: u8,
    /// Number of parts of the message.
    pub of: u8,
    /// Number of floats of the whole message.
    pub floats: u16,
    /// Code of the encoding of the floats ([`Encoding::code`]).
    pub encoding: u8,
    /// Power of two by which the integers of the encoding `int8` are multiplied, and 128; zero in others.
    pub exponent: u8,
    /// Beginning of the digest of the sender's policy: messages of another policy are not used.
    pub policy: u32,
    /// Encoded floats of this part.
    pub bytes: Piece,
}

/// Bytes of a part, as one MessagePack `bin`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece(pub Arc<[u8]>);

impl Encoding {
    /// All encodings, in the order of their codes on the wire.
    pub const ALL: [Encoding; 4] = [Encoding::F32, Encoding::F16, Encoding::Bf16, Encoding::Int8];

    /// Returns the number of the encoding on the wire.
    pub fn code(self) -> u8 {
        self as u8
    }

    /// Returns the encoding with this code; `None` if there is none.
    pub fn of_code(code: u8) -> Option<Encoding> {
        Encoding::ALL.get(usize::from(code)).copied()
    }

    /// Returns the number of bytes of a float.
    pub fn bytes(self) -> usize {
        match self {
            Encoding::F32 => 4,
            Encoding::F16 | Encoding::Bf16 => 2,
            Encoding::Int8 => 1,
        }
    }

    /// Rounds `floats` to numbers that the encoding has. What is too large for it becomes infinite.
    pub fn round(self, floats: &mut [f32]) {
        match self {
            Encoding::F32 => {}
            Encoding::F16 => floats.iter_mut().for_each(|float| *float = f16::from_f32(*float).to_f32()),
            Encoding::Bf16 => floats.iter_mut().for_each(|float| *float = bf16::from_f32(*float).to_f32()),
            Encoding::Int8 => {
                let unit = power_of_two(exponent_of(floats));
                floats.iter_mut().for_each(|float| *float = (*float / unit).round_ties_even() * unit);
            }
        }
    }

    /// Returns the bytes of `floats`, which [`Encoding::round`] has rounded and which are finite, and the exponent.
    pub(crate) fn encode(self, floats: &[f32]) -> (Vec<u8>, u8) {
        let bytes = match self {
            Encoding::F32 => floats.iter().flat_map(|float| float.to_le_bytes()).collect(),
            Encoding::F16 => floats.iter().flat_map(|float| f16::from_f32(*float).to_le_bytes()).collect(),
            Encoding::Bf16 => floats.iter().flat_map(|float| bf16::from_f32(*float).to_le_bytes()).collect(),
            Encoding::Int8 => {
                let exponent = exponent_of(floats);
                let unit = power_of_two(exponent);
                #[expect(clippy::cast_possible_truncation, reason = "an integer of at most 127")]
                let byte = |float: &f32| ((float / unit) as i8).to_le_bytes()[0];
                let biased = u8::try_from(exponent + BIAS).expect("exponents of 32-bit floats fit");
                return (floats.iter().map(byte).collect(), biased);
            }
        };
        (bytes, 0)
    }

    /// Writes the floats that `bytes` encode into `floats`, of the same number.
    fn decode(self, bytes: &[u8], exponent: u8, floats: &mut [f32]) {
        let unit = power_of_two(i32::from(exponent) - BIAS);
        let each = bytes.chunks_exact(self.bytes());
        for (float, bytes) in floats.iter_mut().zip(each) {
            *float = match (self, bytes) {
                (Encoding::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
                (Encoding::F16, &[a, b]) => f16::from_le_bytes([a, b]).to_f32(),
                (Encoding::Bf16, &[a, b]) => bf16::from_le_bytes([a, b]).to_f32(),
                (Encoding::Int8, &[a]) => f32::from(i8::from_le_bytes([a])) * unit,
                _ => unreachable!("the chunks have the length of a float"),
            };
        }
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Encoding::F32 => "f32",
            Encoding::F16 => "f16",
            Encoding::Bf16 => "bf16",
            Encoding::Int8 => "int8",
        })
    }
}

/// Returns the smallest exponent of a power of two by which the largest of `floats` becomes an integer of at most 127.
/// It is the same for the rounded floats. A power of two, since by another factor a float that is rounded twice would
/// become another one.
fn exponent_of(floats: &[f32]) -> i32 {
    let largest = floats.iter().fold(0.0_f32, |largest, float| largest.max(float.abs()));
    if !largest.is_normal() {
        return MIN_EXPONENT;
    }
    let exponent = i32::from(u8::try_from(largest.to_bits() >> 23).expect("the sign of a magnitude is zero")) - 127 - 6;
    let fits = largest <= MAX_INT8 * power_of_two(exponent.max(MIN_EXPONENT));
    if fits { exponent.max(MIN_EXPONENT) } else { exponent + 1 }
}

fn power_of_two(exponent: i32) -> f32 {
    let biased = u32::try_from((exponent + 127).clamp(1, 254)).expect("it is within these bounds");
    f32::from_bits(biased << 23)
}

impl Form {
    /// Returns whether a message of `floats` floats travels in parts, and not as one list of 32-bit floats.
    pub fn is_in_parts(&self, floats: usize) -> bool {
        self.encoding != Encoding::F32 && floats > 0 || floats > MAX_FEATURES
    }
}

/// Returns the size of all but the last one of `parts` parts of `total` bytes.
pub(crate) fn cut(total: usize, parts: usize) -> usize {
    total.div_ceil(parts).next_multiple_of(GRAIN)
}

impl Part {
    /// Returns the range of floats of the whole message that the part has, and their encoding; `None` if its fields
    /// contradict each other.
    fn place(&self) -> Option<(std::ops::Range<usize>, Encoding)> {
        let encoding = Encoding::of_code(self.encoding)?;
        let (floats, of, width) = (usize::from(self.floats), usize::from(self.of), encoding.bytes());
        if !(1..=MAX_FLOATS).contains(&floats) || !(1..=MAX_PARTS).contains(&of) || self.index >= self.of {
            return None;
        }
        let total = floats * width;
        let size = cut(total, of);
        let begins = usize::from(self.index) * size;
        let ends = (begins + size).min(total);
        // All parts have floats, and as many as their place says.
        let fits =
            (of - 1) * size < total && size <= MAX_PART_BYTES && self.bytes.0.len() == ends.saturating_sub(begins);
        fits.then_some((begins / width..ends / width, encoding))
    }

    /// Checks that the fields agree with each other, and that the floats are in range.
    pub(super) fn check(&self) -> Result<(), Unfit> {
        let (range, encoding) = self.place().ok_or(Unfit::Length)?;
        let mut floats = vec![0.0; range.len()];
        encoding.decode(&self.bytes.0, self.exponent, &mut floats);
        all_sound(&floats).then_some(()).ok_or(Unfit::Number)
    }

    /// Returns whether the part is of the same message as `other`, a part of the same sender, by all that both say of
    /// the whole message.
    pub(crate) fn is_of(&self, other: &Part) -> bool {
        let whole = |part: &Part| (part.message, part.of, part.floats, part.encoding, part.exponent, part.policy);
        whole(self) == whole(other)
    }

    /// Writes the floats of the part, which has been checked, to their place in `floats`, those of the whole message.
    pub(crate) fn write(&self, floats: &mut [f32]) {
        if let Some((range, encoding)) = self.place()
            && let Some(floats) = floats.get_mut(range)
        {
            encoding.decode(&self.bytes.0, self.exponent, floats);
        }
    }
}

impl Serialize for Piece {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_bytes(&self.0)
    }
}

impl<'de> Deserialize<'de> for Piece {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Piece, D::Error> {
        struct Bytes;
        impl serde::de::Visitor<'_> for Bytes {
            type Value = Piece;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                write!(f, "at most {MAX_PART_BYTES} bytes")
            }
            fn visit_bytes<E: serde::de::Error>(self, bytes: &[u8]) -> Result<Piece, E> {
                let fits = bytes.len() <= MAX_PART_BYTES;
                fits.then(|| Piece(bytes.into())).ok_or_else(|| E::invalid_length(bytes.len(), &self))
            }
        }
        d.deserialize_bytes(Bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Floats of a latent, from both ends of what a policy says.
    fn floats(number: usize) -> Vec<f32> {
        (0..number).map(|at| libm::sinf(at as f32 * 0.7) * libm::powf(10.0, (at % 9) as f32 - 4.0)).collect()
    }

    #[test]
    fn what_is_rounded_stays_as_it_is_and_is_as_near_as_its_bits_allow() {
        for (encoding, error) in [(Encoding::F32, 0.0), (Encoding::F16, 5e-4), (Encoding::Bf16, 4e-3)] {
            let before = floats(5000);
            let mut once = before.clone();
            encoding.round(&mut once);
            let mut twice = once.clone();
            encoding.round(&mut twice);
            assert_eq!(once, twice, "{encoding}");
            let normal = |float: &f32| float.abs() > 1e-4;
            let near = before.iter().zip(&once).filter(|(one, _)| normal(one));
            near.for_each(|(one, other)| {
                assert!((one - other).abs() <= error * one.abs(), "{encoding}: {one} {other}")
            });
        }
        for scale in [1e-30, 1e-3, 1.0, 63.4, 63.5, 126.9, 127.0, 127.4, 127.5, 128.0, 9e5] {
            let mut once: Vec<f32> = floats(999).iter().map(|float| float.clamp(-1.0, 1.0) * scale).collect();
            once.push(scale);
            let before = once.clone();
            Encoding::Int8.round(&mut once);
            let mut twice = once.clone();
            Encoding::Int8.round(&mut twice);
            assert_eq!(once, twice, "{scale}");
            let worst = before.iter().zip(&once).map(|(one, other)| (one - other).abs()).fold(0.0, f32::max);
            assert!(worst <= scale / 126.0, "{scale}: {worst}");
        }
        let mut large = [7e4, -1e6];
        Encoding::F16.round(&mut large);
        assert_eq!(large, [f32::INFINITY, f32::NEG_INFINITY]);
    }

    #[test]
    fn a_part_whose_fields_contradict_each_other_is_none() {
        let bytes = |number: usize| Piece(vec![0; number].into());
        // The second of three parts of 600 floats.
        let sound = Part {
            message: 0,
            index: 1,
            of: 3,
            floats: 600,
            encoding: Encoding::F32.code(),
            exponent: 0,
            policy: 0,
            bytes: bytes(800),
        };
        assert!(sound.check().is_ok());
        for wrong in [
            Part { of: 0, ..sound.clone() },
            Part { of: 1, ..sound.clone() },
            Part { of: 2, ..sound.clone() },
            Part { of: 255, ..sound.clone() },
            Part { index: 3, ..sound.clone() },
            Part { floats: 0, ..sound.clone() },
            Part { floats: u16::MAX, ..sound.clone() },
            Part { encoding: 4, ..sound.clone() },
            Part { encoding: 1, ..sound.clone() },
            Part { bytes: bytes(0), ..sound.clone() },
            Part { bytes: bytes(801), ..sound.clone() },
        ] {
            assert!(wrong.check().is_err(), "{wrong:?}");
        }
        for (floats, encoding, exponent) in [
            ([f32::NAN, 0.0], Encoding::F32, 0),
            ([1.1e6, 0.0], Encoding::F32, 0),
            ([f32::NEG_INFINITY, 0.0], Encoding::F16, 0),
            ([2e6, 0.0], Encoding::Bf16, 0),
            ([127.0, 1.0], Encoding::Int8, 255),
        ] {
            let (bytes, own) = encoding.encode(&floats);
            let exponent = if exponent > 0 { exponent } else { own };
            let (encoding, bytes) = (encoding.code(), Piece(bytes.into()));
            let part = Part { index: 0, of: 1, floats: 2, encoding, exponent, bytes, ..sound.clone() };
            assert_eq!(part.check(), Err(Unfit::Number), "{part:?}");
        }
    }
}
