//! Float vectors on the wire: one MessagePack `bin` of little-endian f32, not one marker a number.
//!
//! Holds `Features`, the one message field of no fixed length, and serde impls; whether numbers make sense is checked
//! by `Wire::check`.

use std::fmt;
use std::sync::Arc;

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::geometry::{Deviation, Motion, Pose, Task, Twist, Vec2};

/// The most floats that a latent may carry: with them a frame stays inside one datagram.
pub const MAX_FEATURES: usize = 256;

/// What a robot's policy tells its neighbours: for a GNN the encoder's output, for ORCA the radius \[m\]
/// and the preferred velocity \[m/s\].
#[derive(Clone, Debug, PartialEq)]
pub struct Features(pub Arc<[f32]>);

/// Takes a byte string and hands it to a parser, which says what it expected.
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

fn pack<const BYTES: usize>(floats: &[f32]) -> [u8; BYTES] {
    let mut bytes = [0; BYTES];
    for (four, float) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(floats) {
        *four = float.to_le_bytes();
    }
    bytes
}

fn unpack(bytes: &[u8]) -> impl Iterator<Item = f32> + '_ {
    bytes.as_chunks::<4>().0.iter().map(|four| f32::from_le_bytes(*four))
}

fn unpack_exactly<const N: usize>(bytes: &[u8]) -> Option<[f32; N]> {
    if bytes.len() != 4 * N {
        return None;
    }
    let mut floats = [0.0; N];
    floats.iter_mut().zip(unpack(bytes)).for_each(|(to, from)| *to = from);
    Some(floats)
}

impl Serialize for Motion {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let (p, v) = (self.position, self.velocity);
        s.serialize_bytes(&pack::<16>(&[p.x, p.y, v.x, v.y]))
    }
}

impl<'de> Deserialize<'de> for Motion {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Motion, D::Error> {
        let parse = |bytes: &[u8]| {
            let [px, py, vx, vy] = unpack_exactly(bytes)?;
            Some(Motion { position: Vec2::new(px, py), velocity: Vec2::new(vx, vy) })
        };
        d.deserialize_bytes(Bytes(parse, "16 bytes: position and velocity"))
    }
}

/// How a number is written that may be unknown: as this NaN, and no other.
fn unknown(float: Option<f32>) -> f32 {
    float.unwrap_or(f32::NAN)
}

/// The same the other way; none if it is another NaN.
fn known(float: f32) -> Option<Option<f32>> {
    match float.is_nan() {
        true => (float.to_bits() == f32::NAN.to_bits()).then_some(None),
        false => Some(Some(float)),
    }
}

impl Serialize for Pose {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_bytes(&pack::<12>(&[self.position.x, self.position.y, unknown(self.heading)]))
    }
}

impl<'de> Deserialize<'de> for Pose {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Pose, D::Error> {
        let parse = |bytes: &[u8]| {
            let [x, y, heading] = unpack_exactly(bytes)?;
            Some(Pose { position: Vec2::new(x, y), heading: known(heading)? })
        };
        d.deserialize_bytes(Bytes(parse, "12 bytes: position and heading"))
    }
}

impl Serialize for Twist {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_bytes(&pack::<12>(&[self.velocity.x, self.velocity.y, unknown(self.yaw_rate)]))
    }
}

impl<'de> Deserialize<'de> for Twist {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Twist, D::Error> {
        let parse = |bytes: &[u8]| {
            let [x, y, yaw_rate] = unpack_exactly(bytes)?;
            Some(Twist { velocity: Vec2::new(x, y), yaw_rate: known(yaw_rate)? })
        };
        d.deserialize_bytes(Bytes(parse, "12 bytes: velocity and yaw rate"))
    }
}

impl Serialize for Deviation {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        let all = [self.position_m, self.heading_rad, self.velocity_m_s, self.yaw_rate_rad_s];
        s.serialize_bytes(&pack::<16>(&all.map(unknown)))
    }
}

impl<'de> Deserialize<'de> for Deviation {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Deviation, D::Error> {
        let parse = |bytes: &[u8]| {
            let [position_m, heading_rad, velocity_m_s, yaw_rate_rad_s] = unpack_exactly(bytes)?;
            Some(Deviation {
                position_m: known(position_m)?,
                heading_rad: known(heading_rad)?,
                velocity_m_s: known(velocity_m_s)?,
                yaw_rate_rad_s: known(yaw_rate_rad_s)?,
            })
        };
        d.deserialize_bytes(Bytes(parse, "16 bytes: four standard deviations"))
    }
}

impl Serialize for Features {
    fn serialize<S: Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        if self.0.len() > MAX_FEATURES {
            return Err(serde::ser::Error::custom("more than MAX_FEATURES floats"));
        }
        let bytes: Vec<[u8; 4]> = self.0.iter().map(|float| float.to_le_bytes()).collect();
        s.serialize_bytes(bytes.as_flattened())
    }
}

impl<'de> Deserialize<'de> for Features {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Features, D::Error> {
        let parse = |bytes: &[u8]| {
            // Of known length, so that the shared slice is allocated once and filled in one sweep.
            let whole = bytes.len().is_multiple_of(4) && bytes.len() <= 4 * MAX_FEATURES;
            whole.then(|| Features(unpack(bytes).collect()))
        };
        d.deserialize_bytes(Bytes(parse, "4 bytes for each of at most MAX_FEATURES floats"))
    }
}

/// One velocity \[m/s\] as 8 bytes.
pub(super) mod vec2 {
    use super::*;

    pub fn serialize<S: Serializer>(v: &Vec2, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_bytes(&pack::<8>(&[v.x, v.y]))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Vec2, D::Error> {
        let parse = |bytes: &[u8]| unpack_exactly(bytes).map(|[x, y]| Vec2::new(x, y));
        d.deserialize_bytes(Bytes(parse, "8 bytes: x and y"))
    }
}

/// A block of tasks as 16 bytes each.
pub(super) mod tasks {
    use super::*;

    pub fn serialize<S: Serializer>(tasks: &Arc<[Task]>, s: S) -> Result<S::Ok, S::Error> {
        let bytes: Vec<u8> =
            tasks.iter().flat_map(|task| pack::<16>(&[task.start.x, task.start.y, task.goal.x, task.goal.y])).collect();
        s.serialize_bytes(&bytes)
    }

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
