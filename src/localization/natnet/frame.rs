//! Frames of motion capture data, bitstreams 3.0 to 4.4: decoder of rigid bodies, stamp and flags.
//!
//! Two layouts exist. From 4.1 every section carries its length, and sections that are not needed are skipped by it.
//! Before, they are walked through. 3.0 to 4.1 were read from independent servers; 4.2 to 4.4 are unproven: they are
//! known from hand-made frames alone.

use super::packet::{Malformed, Reader, Version};

/// Layout of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Bitstreams 3.0 to 4.0.
    Plain,
    /// Bitstreams from 4.1: sections with lengths, a section of assets, and a precise stamp.
    Sized,
}

/// Pose of a rigid body, in the axes of the tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidBody {
    /// Its streaming ID.
    pub id: i32,
    /// Position \[m\].
    pub position: [f64; 3],
    /// Rotation as a quaternion x, y, z, w; of unit length if the body is tracked.
    pub rotation: [f64; 4],
    /// Mean distance between its measured markers and the model \[m\]; zero if the server does not say.
    pub error_m: f32,
    /// Whether it is tracked in this frame. A lost body stays in the frame at some pose.
    pub tracked: bool,
}

/// Frame of motion capture data.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Its number.
    pub number: i32,
    /// Time of measurement on the tracker's clock \[s\].
    pub stamp_s: f64,
    /// Whether the model definitions have changed.
    pub models_changed: bool,
    /// Its rigid bodies, in the order of the server.
    pub bodies: Vec<RigidBody>,
}

/// Bytes of a rigid body: id, position, rotation, error and params.
const RIGID_BODY: usize = 38;
/// Bytes of a labelled marker: id, position, size, params and residual.
const LABELED_MARKER: usize = 26;
/// Bytes of a precise stamp: seconds and fraction.
const PRECISE_STAMP: usize = 8;
/// Bytes of a frame's params.
const PARAMS: usize = 2;
/// Bytes of the tag at the end of a frame.
const END: usize = 4;
/// Largest deviation of a rotation's squared length from one; f32 is exact to 1e-6.
const ROUNDING: f64 = 0.01;
/// Latest stamp that is valid \[s\]: 300 years.
const LATEST_S: f64 = 1e10;
/// Params of a rigid body: it is tracked.
const TRACKED: i16 = 1;
/// Params of a frame: model definitions have changed.
const MODELS_CHANGED: i16 = 2;

impl Layout {
    /// Layout that a server of this version uses by itself.
    pub fn of(version: Version) -> Layout {
        if version >= (Version { major: 4, minor: 1 }) { Layout::Sized } else { Layout::Plain }
    }

    fn other(self) -> Layout {
        match self {
            Layout::Plain => Layout::Sized,
            Layout::Sized => Layout::Plain,
        }
    }
}

/// Decodes the payload of a frame, and finds its layout. `expected` is tried first.
///
/// In unicast a server may send another bitstream than its own. The other layout has to fit to the last byte.
pub fn decode(payload: &[u8], expected: Layout) -> Result<(Frame, Layout), Malformed> {
    let error = match decode_as(payload, expected) {
        Ok((frame, _)) => return Ok((frame, expected)),
        Err(error) => error,
    };
    match decode_as(payload, expected.other()) {
        Ok((frame, 0)) => Ok((frame, expected.other())),
        _ => Err(error),
    }
}

/// Decodes the payload of a frame in one layout. Also returns the number of bytes after its end.
fn decode_as(payload: &[u8], layout: Layout) -> Result<(Frame, usize), Malformed> {
    let mut reader = Reader::new(payload);
    let number = reader.i32()?;
    let bodies = match layout {
        Layout::Plain => plain_sections(&mut reader)?,
        Layout::Sized => sized_sections(&mut reader)?,
    };
    // Time code: frame and subframe.
    reader.skip(2, 4)?;
    let stamp_s = reader.f64()?;
    if !(0.0..LATEST_S).contains(&stamp_s) {
        return Err(Malformed("the stamp of a NatNet frame is out of range"));
    }
    // Ticks of mid-exposure, of reception and of transmission.
    reader.skip(3, 8)?;
    // Precise stamp. The manufacturer's samples disagree on whether 4.0 has it.
    if layout == Layout::Sized || reader.left() >= PRECISE_STAMP + PARAMS + END {
        reader.skip(1, PRECISE_STAMP)?;
    }
    let params = reader.i16()?;
    reader.skip(1, END)?;
    Ok((Frame { number, stamp_s, models_changed: params & MODELS_CHANGED != 0, bodies }, reader.left()))
}

/// Reads the sections of a frame since 4.1: marker sets, other markers, rigid bodies, then skeletons, assets, labelled
/// markers, force plates and devices.
fn sized_sections(reader: &mut Reader) -> Result<Vec<RigidBody>, Malformed> {
    for _ in 0..2 {
        section(reader)?;
    }
    let (count, mut bodies) = section(reader)?;
    let read = rigid_bodies(count, &mut bodies)?;
    for _ in 0..5 {
        section(reader)?;
    }
    Ok(read)
}

/// Takes a section: its number of elements, and a reader of its bytes.
fn section<'a>(reader: &mut Reader<'a>) -> Result<(usize, Reader<'a>), Malformed> {
    let (count, length) = (reader.count()?, reader.count()?);
    if (count == 0) != (length == 0) {
        return Err(Malformed("a section of a NatNet frame has a length that its count contradicts"));
    }
    Ok((count, Reader::new(reader.bytes(length)?)))
}

/// Reads rigid bodies that fill their section. Elements of a later bitstream may be longer: the rest is skipped.
fn rigid_bodies(count: usize, section: &mut Reader) -> Result<Vec<RigidBody>, Malformed> {
    let size = section.left().checked_div(count).unwrap_or(RIGID_BODY);
    if size < RIGID_BODY || size * count != section.left() {
        return Err(Malformed("the section of rigid bodies in a NatNet frame has a length that does not fit"));
    }
    let one = |_| {
        let mut element = Reader::new(section.bytes(size)?);
        rigid_body(&mut element)
    };
    (0..count).map(one).collect()
}

/// Walks through the sections of a frame before 4.1.
fn plain_sections(reader: &mut Reader) -> Result<Vec<RigidBody>, Malformed> {
    // Marker sets: a name, then positions.
    for _ in 0..reader.count()? {
        reader.text()?;
        vectors(reader)?;
    }
    // Other markers.
    vectors(reader)?;
    let count = reader.count()?;
    let bodies = (0..count).map(|_| rigid_body(reader)).collect::<Result<_, _>>()?;
    // Skeletons: an id, then their bones.
    for _ in 0..reader.count()? {
        reader.skip(1, 4)?;
        let bones = reader.count()?;
        reader.skip(bones, RIGID_BODY)?;
    }
    let labeled = reader.count()?;
    reader.skip(labeled, LABELED_MARKER)?;
    // Force plates, then devices: an id, then channels of samples.
    for _ in 0..2 {
        for _ in 0..reader.count()? {
            reader.skip(1, 4)?;
            for _ in 0..reader.count()? {
                let samples = reader.count()?;
                reader.skip(samples, 4)?;
            }
        }
    }
    Ok(bodies)
}

/// Skips a number of positions.
fn vectors(reader: &mut Reader) -> Result<(), Malformed> {
    let count = reader.count()?;
    reader.skip(count, 12)
}

fn rigid_body(reader: &mut Reader) -> Result<RigidBody, Malformed> {
    let id = reader.i32()?;
    let (position, rotation) = (reader.vector()?, reader.vector()?);
    let (error_m, tracked) = (reader.f32()?, reader.i16()? & TRACKED != 0);
    let length = rotation.iter().map(|number| number * number).sum::<f64>();
    let sound = position.iter().all(|number| number.is_finite()) && (length - 1.0).abs() <= ROUNDING;
    if tracked && !sound {
        return Err(Malformed("a tracked body in a NatNet frame has no pose"));
    }
    Ok(RigidBody { id, position, rotation, error_m, tracked })
}
