//! Frames of motion capture data, bitstreams 3.0 to 4.4: decoder of the rigid bodies, the stamp and the flags.
//!
//! A bitstream is a version of the NatNet format; a frame has the poses of all rigid bodies at one time. There are two
//! layouts. From 4.1, each section begins with its length, and a section that is not needed is skipped.
//! Before 4.1, each section has to be decoded to find its end. The decoder was tested with frames from independent
//! servers for 3.0 to 4.1, and only with hand-made frames for 4.2 to 4.4.

use murmurate::messages::geometry::{MAX_SIZE, NoRotation, unit_quaternion};

use super::packet::{Cursor, Malformed, Version};

/// Layout of a frame of motion capture data, which depends on the bitstream (version of the NatNet format).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameLayout {
    /// Layout of the NatNet bitstreams 3.0 to 4.0: sections have no length.
    Plain,
    /// Layout of the NatNet bitstreams from 4.1: each section has a length, a section of assets is added, and the frame
    /// has a precise stamp.
    Sized,
}

/// Pose of a rigid body, such as a robot with markers, in the tracker's own frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigidBody {
    /// Streaming ID: number by which the tracker identifies the body.
    pub id: i32,
    /// Position of the body \[m\] in the tracker's own frame.
    pub position: [f64; 3],
    /// Rotation from the body's axes to those of the tracker's frame, as a quaternion (x, y, z, w); of unit length if
    /// the body has a pose.
    pub rotation: [f64; 4],
    /// Mean distance between the body's measured markers and its model \[m\]; zero if the server does not report it.
    pub error_m: f32,
    /// Whether the body has a pose in this frame.
    pub(crate) tracking: Tracking,
}

/// State of a rigid body in one frame: whether it has a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tracking {
    /// The body is tracked, and its pose is sound.
    Tracked,
    /// The body is lost. It stays in the frame with an arbitrary pose.
    Lost,
    /// The body is tracked, and its numbers are no pose, for this reason. The other bodies of the frame are not
    /// concerned.
    NoPose(&'static str),
}

/// Frame of motion capture data: the poses of all rigid bodies at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct MocapFrame {
    /// Number of the frame, by which a repeated frame is recognised.
    pub number: i32,
    /// Time of measurement on the tracker's clock \[s\].
    pub stamp_s: f64,
    /// Whether the model definitions (names and IDs of rigid bodies) have changed since the last frame.
    pub models_changed: bool,
    /// Rigid bodies with their poses, in the server's order.
    pub bodies: Vec<RigidBody>,
}

/// Size of a rigid body \[bytes\]: id, position, rotation, error and flags.
const RIGID_BODY: usize = 38;
/// Size of a labelled marker \[bytes\]: id, position, size, flags and residual.
const LABELED_MARKER: usize = 26;
/// Size of the precise stamp \[bytes\]: seconds and fraction.
const PRECISE_STAMP: usize = 8;
/// Size of a frame's flags \[bytes\].
const PARAMS: usize = 2;
/// Size of the tag at the end of a frame \[bytes\].
const END: usize = 4;
/// Latest stamp that is valid \[s\]: 300 years.
const LATEST_S: f64 = 1e10;
/// Bit in the flags of a rigid body: it is tracked in this frame.
const TRACKED: i16 = 1;
/// Bit in the flags of a frame: the model definitions have changed.
const MODELS_CHANGED: i16 = 2;

impl FrameLayout {
    /// Returns the layout in which a server of this NatNet version sends frames, if the client requests no other
    /// version.
    pub fn of(version: Version) -> FrameLayout {
        if version >= (Version { major: 4, minor: 1 }) { FrameLayout::Sized } else { FrameLayout::Plain }
    }

    fn other(self) -> FrameLayout {
        match self {
            FrameLayout::Plain => FrameLayout::Sized,
            FrameLayout::Sized => FrameLayout::Plain,
        }
    }
}

/// Decodes the payload of a frame. Returns the frame and its layout.
///
/// The layout `expected` is tried first, then the other one, because a unicast server may send another bitstream than
/// its own. The other layout is accepted only if it ends at the payload's last byte.
pub fn decode(payload: &[u8], expected: FrameLayout) -> Result<(MocapFrame, FrameLayout), Malformed> {
    let error = match decode_as(payload, expected) {
        Ok((frame, _)) => return Ok((frame, expected)),
        Err(error) => error,
    };
    match decode_as(payload, expected.other()) {
        Ok((frame, 0)) => Ok((frame, expected.other())),
        _ => Err(error),
    }
}

/// Decodes the payload of a frame in one layout. Returns the frame and the number of bytes after its end.
fn decode_as(payload: &[u8], layout: FrameLayout) -> Result<(MocapFrame, usize), Malformed> {
    let mut reader = Cursor::new(payload);
    let number = reader.i32()?;
    let bodies = match layout {
        FrameLayout::Plain => plain_sections(&mut reader)?,
        FrameLayout::Sized => sized_sections(&mut reader)?,
    };
    // Timecode, then its subframe.
    reader.skip(2, 4)?;
    let stamp_s = reader.f64()?;
    if !(0.0..LATEST_S).contains(&stamp_s) {
        return Err(Malformed("the stamp of a NatNet frame is out of range"));
    }
    // Ticks of mid-exposure, of reception and of transmission.
    reader.skip(3, 8)?;
    // Precise stamp. The manufacturer's samples disagree on whether bitstream 4.0 has it.
    if layout == FrameLayout::Sized || reader.left() >= PRECISE_STAMP + PARAMS + END {
        reader.skip(1, PRECISE_STAMP)?;
    }
    let params = reader.i16()?;
    reader.skip(1, END)?;
    Ok((MocapFrame { number, stamp_s, models_changed: params & MODELS_CHANGED != 0, bodies }, reader.left()))
}

/// Reads the sections of a frame in the layout from 4.1, and returns the rigid bodies. The sections are marker sets,
/// other markers, rigid bodies, skeletons, assets, labelled markers, force plates and devices.
fn sized_sections(reader: &mut Cursor) -> Result<Vec<RigidBody>, Malformed> {
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

/// Reads the header of a section. Returns the number of elements and a reader of the section's bytes.
fn section<'a>(reader: &mut Cursor<'a>) -> Result<(usize, Cursor<'a>), Malformed> {
    let (count, length) = (reader.count()?, reader.count()?);
    if (count == 0) != (length == 0) {
        return Err(Malformed("a section of a NatNet frame has a length that its count contradicts"));
    }
    Ok((count, Cursor::new(reader.bytes(length)?)))
}

/// Reads the rigid bodies of a section. Elements of a later bitstream may be longer; their remaining bytes are skipped.
fn rigid_bodies(count: usize, section: &mut Cursor) -> Result<Vec<RigidBody>, Malformed> {
    let size = section.left().checked_div(count).unwrap_or(RIGID_BODY);
    if size < RIGID_BODY || size * count != section.left() {
        return Err(Malformed("the section of rigid bodies in a NatNet frame has a length that does not fit"));
    }
    let one = |_| {
        let mut element = Cursor::new(section.bytes(size)?);
        rigid_body(&mut element)
    };
    (0..count).map(one).collect()
}

/// Reads the sections of a frame in the layout before 4.1, and returns the rigid bodies.
fn plain_sections(reader: &mut Cursor) -> Result<Vec<RigidBody>, Malformed> {
    // Marker sets: each a name, then positions.
    for _ in 0..reader.count()? {
        reader.text()?;
        vectors(reader)?;
    }
    // Unlabelled markers.
    vectors(reader)?;
    let count = reader.count()?;
    let bodies = (0..count).map(|_| rigid_body(reader)).collect::<Result<_, _>>()?;
    // Skeletons: each an id, then its bones.
    for _ in 0..reader.count()? {
        reader.skip(1, 4)?;
        let bones = reader.count()?;
        reader.skip(bones, RIGID_BODY)?;
    }
    let labeled = reader.count()?;
    reader.skip(labeled, LABELED_MARKER)?;
    // Force plates, then devices: each an id, then channels of samples.
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

/// Skips a list of positions, which begins with their number.
fn vectors(reader: &mut Cursor) -> Result<(), Malformed> {
    let count = reader.count()?;
    reader.skip(count, 12)
}

fn rigid_body(reader: &mut Cursor) -> Result<RigidBody, Malformed> {
    let id = reader.i32()?;
    let (position, rotation) = (reader.vector()?, reader.vector()?);
    let (error_m, tracked) = (reader.f32()?, reader.i16()? & TRACKED != 0);
    let (rotation, tracking) = match unit_quaternion(rotation) {
        _ if !tracked => (rotation, Tracking::Lost),
        _ if !position.iter().all(|number| number.abs() <= f64::from(MAX_SIZE)) => {
            (rotation, Tracking::NoPose("its rigid body is tracked, and its position is not finite, or beyond 100 km"))
        }
        Ok(unit) => (unit, Tracking::Tracked),
        Err(NoRotation::Zero) => {
            (rotation, Tracking::NoPose("its rigid body is tracked, and its rotation is all zero"))
        }
        Err(NoRotation::Length) => {
            (rotation, Tracking::NoPose("its rigid body is tracked, and its rotation is no unit quaternion"))
        }
    };
    Ok(RigidBody { id, position, rotation, error_m, tracking })
}
