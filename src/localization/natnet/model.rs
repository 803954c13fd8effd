//! Model definitions, bitstreams 3.0 to 4.4: decoder of the rigid bodies' names and streaming IDs.
//!
//! From 4.1 every definition carries its length. Before, definitions are walked through; 4.0 has names of markers that
//! 3.0 lacks. 4.2 to 4.4 are unproven: they are known from hand-made definitions alone.

use super::packet::{Malformed, Reader, Version};

/// Definition of a rigid body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Definition {
    /// Name of the body in the tracker.
    pub name: String,
    /// Streaming ID of the rigid body: the number by which frames of motion capture data name it.
    pub id: i32,
}

/// Layout of model definitions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    /// Bitstreams 3.0 and 3.1.
    Plain,
    /// Bitstream 4.0.
    NamedMarkers,
    /// Bitstreams from 4.1.
    Sized,
}

const ALL: [Layout; 3] = [Layout::Sized, Layout::NamedMarkers, Layout::Plain];

/// Kinds of definitions.
const MARKER_SET: i32 = 0;
const RIGID_BODY: i32 = 1;
const SKELETON: i32 = 2;
const FORCE_PLATE: i32 = 3;
const DEVICE: i32 = 4;
const CAMERA: i32 = 5;

/// Bytes of a force plate between its serial number and its channels: width, length and origin; calibration; corners.
const PLATE: usize = 4 * (2 + 3 + 144 + 12);
/// Bytes of a position and a rotation.
const POSE: usize = 28;

/// Decodes the payload of model definitions. The layout of `version` is tried first, then the others, which have to fit
/// to the last byte.
pub fn decode(payload: &[u8], version: Option<Version>) -> Result<Vec<Definition>, Malformed> {
    let expected = match version {
        Some(version) if version < (Version { major: 4, minor: 0 }) => Layout::Plain,
        Some(Version { major: 4, minor: 0 }) => Layout::NamedMarkers,
        _ => Layout::Sized,
    };
    let error = match decode_as(payload, expected) {
        Ok((definitions, _)) => return Ok(definitions),
        Err(error) => error,
    };
    let others = ALL.into_iter().filter(|layout| *layout != expected);
    let mut fitting = others.filter_map(|layout| decode_as(payload, layout).ok().filter(|(_, left)| *left == 0));
    fitting.next().map(|(definitions, _)| definitions).ok_or(error)
}

/// Decodes the payload in one layout. Also returns the number of bytes after its end.
fn decode_as(payload: &[u8], layout: Layout) -> Result<(Vec<Definition>, usize), Malformed> {
    let (mut reader, mut definitions) = (Reader::new(payload), Vec::new());
    for _ in 0..reader.count()? {
        let kind = reader.i32()?;
        if layout == Layout::Sized {
            let length = reader.count()?;
            let mut definition = Reader::new(reader.bytes(length)?);
            if kind == RIGID_BODY {
                definitions.push(named(&mut definition)?);
            }
            continue;
        }
        match kind {
            MARKER_SET => {
                reader.text()?;
                texts(&mut reader)?;
            }
            RIGID_BODY => definitions.push(rigid_body(&mut reader, layout)?),
            SKELETON => {
                named(&mut reader)?;
                for _ in 0..reader.count()? {
                    rigid_body(&mut reader, layout)?;
                }
            }
            FORCE_PLATE => {
                reader.skip(1, 4)?;
                reader.text()?;
                reader.skip(1, PLATE)?;
                channels(&mut reader)?;
            }
            DEVICE => {
                reader.skip(1, 4)?;
                reader.text()?;
                reader.text()?;
                channels(&mut reader)?;
            }
            CAMERA => {
                reader.text()?;
                reader.skip(1, POSE)?;
            }
            _ => return Err(Malformed("a NatNet model definition is of an unknown kind")),
        }
    }
    Ok((definitions, reader.left()))
}

/// Reads a name and an id.
fn named(reader: &mut Reader) -> Result<Definition, Malformed> {
    let name = String::from_utf8_lossy(reader.text()?).into_owned();
    Ok(Definition { name, id: reader.i32()? })
}

/// Reads a rigid body before 4.1: name, id, parent, offset, and its markers with positions, labels and names.
fn rigid_body(reader: &mut Reader, layout: Layout) -> Result<Definition, Malformed> {
    let definition = named(reader)?;
    reader.skip(4, 4)?;
    let markers = reader.count()?;
    reader.skip(markers, 12 + 4)?;
    if layout == Layout::NamedMarkers {
        for _ in 0..markers {
            reader.text()?;
        }
    }
    Ok(definition)
}

/// Skips two kinds, and the names of channels.
fn channels(reader: &mut Reader) -> Result<(), Malformed> {
    reader.skip(2, 4)?;
    texts(reader)
}

/// Skips a number of texts.
fn texts(reader: &mut Reader) -> Result<(), Malformed> {
    for _ in 0..reader.count()? {
        reader.text()?;
    }
    Ok(())
}
