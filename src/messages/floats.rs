//! Float vectors on the wire: one MessagePack `bin` of little-endian f32, without a marker for each number.
//!
//! Holds `Features`, the only message field of variable length, and serde impls. `Wire::check` checks whether numbers
//! make sense.

use std::fmt;
use std::sync::Arc;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::geometry::{Deviation, Motion, Planar, Pose, Task, Twist, Vec2};

/// Largest number of floats in the features of a latent, a robot's broadcast to its neighbours, that travels in one
/// datagram. More travel in parts.
pub const MAX_FEATURES: usize = 256;
/// Largest number of floats in the features of a latent.
pub const MAX_FLOATS: usize = 16_384;

/// Largest absolute value of a number in the features that a policy sends. A policy that exceeds it counts as diverged.
pub const MAX_FEATURE: f32 = 1e6;

/// Whether no number in `floats` is NaN, infinite or larger than [`MAX_FEATURE`] (1e6) in absolute value. There is no
/// early return, so the function compiles to a few vector instructions.
pub(crate) fn all_sound(floats: &[f32]) -> bool {
    floats.iter().fold(true, |all, float| all & (float.abs() <= MAX_FEATURE))
}

/// Numbers that a robot's policy sends to its neighbours. For a graph neural network they are the encoder's output; for
/// the policy ORCA, the radius \[m\] and the preferred velocity \[m/s\].
#[derive(Clone, Debug, PartialEq)]
pub struct Features(pub Arc<[f32]>);

/// Serde visitor that passes a byte string to the parser in the first field. The second field says in errors what was
/// expected.
struct Bytes<T>(fn(&[u8]) -> Option<T>, &'static str);

impl<T> Visitor<'_> for Bytes<T> {
    type Value = T;
    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.1)
    }
    fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<T, E> {
        self.0(bytes).ok_or_else(|| E::invalid_length(bytes.len(), &self))
    }
}

/// Value that is encoded in messages as a fixed number of floats.
trait Floats<const N: usize>: Sized {
    /// Description of the expected bytes, for decoding errors.
    const EXPECTED: &'static str;
    fn floats(&self) -> [f32; N];
    /// Returns the value that these floats encode; `None` if no value is encoded so.
    fn of(floats: [f32; N]) -> Option<Self>;
}

fn write<const N: usize, T: Floats<N>, S: Serializer>(value: &T, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_bytes(value.floats().map(f32::to_le_bytes).as_flattened())
}

fn read<'de, const N: usize, T: Floats<N>, D: Deserializer<'de>>(d: D) -> Result<T, D::Error> {
    d.deserialize_bytes(Bytes(|bytes| T::of(unpack_exactly(bytes)?), T::EXPECTED))
}

fn unpack(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    bytes.as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four))
}

fn unpack_exactly<const N: usize>(bytes: &[u8]) -> Option<[f32; N]> {
    let (fours, rest) = bytes.as_chunks::<4>();
    let fours: &[[u8; 4]; N] = fours.try_into().ok().filter(|_| rest.is_empty())?;
    Some(fours.map(f32::from_le_bytes))
}

/// Encodes a number that may be unknown (`None`): an unknown number becomes the bit pattern of `f32::NAN`.
fn unknown(float: Option<f32>) -> f32 {
    float.unwrap_or(f32::NAN)
}

/// Decodes a number that may be unknown. Returns `Some(None)` for the bit pattern of `f32::NAN`, which stands for an
/// unknown number, and `None` for every other NaN, which is an error.
fn known(float: f32) -> Option<Option<f32>> {
    match float.is_nan() {
        true => (float.to_bits() == f32::NAN.to_bits()).then_some(None),
        false => Some(Some(float)),
    }
}

impl Floats<2> for Vec2 {
    const EXPECTED: &'static str = "8 bytes: x and y";

    fn floats(&self) -> [f32; 2] {
        self.to_array()
    }

    fn of([x, y]: [f32; 2]) -> Option<Vec2> {
        Some(Vec2::new(x, y))
    }
}

impl Floats<4> for Motion {
    const EXPECTED: &'static str = "16 bytes: position and velocity";

    fn floats(&self) -> [f32; 4] {
        [self.position.x, self.position.y, self.velocity.x, self.velocity.y]
    }

    fn of([px, py, vx, vy]: [f32; 4]) -> Option<Motion> {
        Some(Motion { position: Vec2::new(px, py), velocity: Vec2::new(vx, vy) })
    }
}

impl Floats<3> for Pose {
    const EXPECTED: &'static str = "12 bytes: position and heading";

    fn floats(&self) -> [f32; 3] {
        [self.position.x, self.position.y, unknown(self.heading)]
    }

    fn of([x, y, heading]: [f32; 3]) -> Option<Pose> {
        Some(Pose { position: Vec2::new(x, y), heading: known(heading)? })
    }
}

impl Floats<3> for Twist {
    const EXPECTED: &'static str = "12 bytes: velocity and yaw rate";

    fn floats(&self) -> [f32; 3] {
        [self.velocity.x, self.velocity.y, unknown(self.yaw_rate)]
    }

    fn of([x, y, yaw_rate]: [f32; 3]) -> Option<Twist> {
        Some(Twist { velocity: Vec2::new(x, y), yaw_rate: known(yaw_rate)? })
    }
}

impl Floats<4> for Deviation {
    const EXPECTED: &'static str = "16 bytes: four standard deviations";

    fn floats(&self) -> [f32; 4] {
        [self.position_m, self.heading_rad, self.velocity_m_s, self.yaw_rate_rad_s].map(unknown)
    }

    fn of([position_m, heading_rad, velocity_m_s, yaw_rate_rad_s]: [f32; 4]) -> Option<Deviation> {
        Some(Deviation {
            position_m: known(position_m)?,
            heading_rad: known(heading_rad)?,
            velocity_m_s: known(velocity_m_s)?,
            yaw_rate_rad_s: known(yaw_rate_rad_s)?,
        })
    }
}

macro_rules! as_floats {
    ($($value:ty),*) => {
        $(impl Serialize for $value {
            fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
                write(self, s)
            }
        }

        impl<'de> Deserialize<'de> for $value {
            fn deserialize<D: Deserializer<'de>>(d: D) -> Result<$value, D::Error> {
                read(d)
            }
        })*
    };
}

as_floats!(Motion, Pose, Twist, Deviation);

impl Serialize for Features {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        if self.0.len() > MAX_FLOATS {
            return Err(serde::ser::Error::custom("more than MAX_FLOATS floats"));
        }
        let bytes: Vec<[u8; 4]> = self.0.iter().map(|float| float.to_le_bytes()).collect();
        s.serialize_bytes(bytes.as_flattened())
    }
}

impl<'de> Deserialize<'de> for Features {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Features, D::Error> {
        let parse = |bytes: &[u8]| {
            // The length is known, so the shared slice is allocated once and filled in one pass.
            let whole = bytes.len().is_multiple_of(4) && bytes.len() <= 4 * MAX_FLOATS;
            whole.then(|| Features(unpack(bytes).collect()))
        };
        d.deserialize_bytes(Bytes(parse, "4 bytes for each of at most MAX_FLOATS floats"))
    }
}

/// Functions for serde's attribute `with` that encode one `Vec2` that may be missing, as an array or as nothing.
pub(super) mod optional_vec2 {
    use super::*;

    /// Encodes a vector that may be missing.
    pub fn serialize<S: Serializer>(v: &Option<Vec2>, s: S) -> Result<S::Ok, S::Error> {
        v.map(|v| v.to_array()).serialize(s)
    }

    /// Decodes a vector that may be missing.
    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Option<Vec2>, D::Error> {
        Ok(Option::<[f32; 2]>::deserialize(d)?.map(Vec2::from))
    }
}

/// Serde functions (for `serde(with)`) that encode one [`Vec2`], such as a velocity \[m/s\], as 8 bytes.
pub(super) mod vec2 {
    use super::*;

    /// Encodes a vector as 8 bytes: x, then y, as little-endian f32.
    pub fn serialize<S: Serializer>(v: &Vec2, s: S) -> Result<S::Ok, S::Error> {
        write(v, s)
    }

    /// Decodes a vector from 8 bytes: x, then y, as little-endian f32.
    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Vec2, D::Error> {
        read(d)
    }
}

/// Serde functions (for `serde(with)`) that encode a list of tasks, each as 16 bytes: start and goal.
pub(super) mod tasks {
    use super::*;

    /// Encodes a list of tasks as 16 bytes each: start x and y, goal x and y \[m\], as little-endian f32.
    pub fn serialize<S: Serializer>(tasks: &Arc<[Task]>, s: S) -> Result<S::Ok, S::Error> {
        let floats = |task: &Task| [task.start.x, task.start.y, task.goal.x, task.goal.y];
        let bytes: Vec<[u8; 4]> = tasks.iter().flat_map(floats).map(f32::to_le_bytes).collect();
        s.serialize_bytes(bytes.as_flattened())
    }

    /// Decodes a list of tasks from 16 bytes each: start x and y, goal x and y \[m\], as little-endian f32. Fails if
    /// the length is no multiple of 16 bytes.
    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Arc<[Task]>, D::Error> {
        let parse = |bytes: &[u8]| {
            bytes.len().is_multiple_of(16).then(|| {
                bytes
                    .chunks_exact(16)
                    .filter_map(unpack_exactly)
                    .map(|[sx, sy, gx, gy]| Task { start: Vec2::new(sx, sy), goal: Vec2::new(gx, gy) })
                    .collect()
            })
        };
        d.deserialize_bytes(Bytes(parse, "16 bytes a task: start and goal"))
    }
}
