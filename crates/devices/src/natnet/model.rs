//! Model definitions of NatNet, by which a tracker describes its rigid bodies, in bitstreams (versions of the format)
//! 3.0 to 4.4: decoder of the names and streaming IDs of rigid bodies.
//!
//! From 4.1, each definition begins with its length. Before 4.1, each definition has to be decoded to find its end; 4.0
//! has names of markers, which 3.0 lacks. For 4.2 to 4.4 the decoder was tested with hand-made definitions only.

use super::packet::{Cursor, Malformed, Version};

/// Definition of a rigid body in the tracker: its name, and the ID by which frames identify it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Definition {
    /// Name of the rigid body in the tracker.
    pub name: String,
    /// Streaming ID of the rigid body, which identifies it in frames of motion capture data.
    pub id: i32,
}

/// Layout of model definitions, which depends on the bitstream (version of the NatNet format).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ModelLayout {
    /// Layout of the NatNet bitstreams 3.0 and 3.1: no lengths, and no names of markers.
    Plain,
    /// Layout of the NatNet bitstream 4.0: no lengths, and rigid bodies have names of markers.
    NamedMarkers,
    /// Layout of the NatNet bitstreams from 4.1: each definition begins with its length.
    Sized,
}

const ALL: [ModelLayout; 3] = [ModelLayout::Sized, ModelLayout::NamedMarkers, ModelLayout::Plain];

/// Number that identifies a marker set in a datagram with model definitions. Rigid bodies, skeletons, force plates,
/// devices and cameras have the numbers after it.
const MARKER_SET: i32 = 0;
const RIGID_BODY: i32 = 1;
const SKELETON: i32 = 2;
const FORCE_PLATE: i32 = 3;
const DEVICE: i32 = 4;
const CAMERA: i32 = 5;

/// Size of a force plate's fields between its serial number and its channels \[bytes\]: width, length and origin;
/// calibration; corners.
const PLATE: usize = 4 * (2 + 3 + 144 + 12);
/// Size of a position and a rotation \[bytes\].
const POSE: usize = 28;

/// Decodes the payload of a datagram with model definitions, and returns those of rigid bodies. The layout of the
/// bitstream `version` is tried first, or that of 4.1 and later if `version` is `None`; then the other layouts are
/// tried. One of these is accepted only if the definitions end at the payload's last byte.
pub fn decode(payload: &[u8], version: Option<Version>) -> Result<Vec<Definition>, Malformed> {
    let expected = match version {
        Some(version) if version < (Version { major: 4, minor: 0 }) => ModelLayout::Plain,
        Some(Version { major: 4, minor: 0 }) => ModelLayout::NamedMarkers,
        _ => ModelLayout::Sized,
    };
    let error = match decode_as(payload, expected) {
        Ok((definitions, _)) => return Ok(definitions),
        Err(error) => error,
    };
    let others = ALL.into_iter().filter(|layout| *layout != expected);
    let mut fitting = others.filter_map(|layout| decode_as(payload, layout).ok().filter(|(_, left)| *left == 0));
    fitting.next().map(|(definitions, _)| definitions).ok_or(error)
}

/// Decodes the payload of model definitions in one layout. Returns the definitions of rigid bodies, and the number of
/// bytes after the end of all definitions.
fn decode_as(payload: &[u8], layout: ModelLayout) -> Result<(Vec<Definition>, usize), Malformed> {
    let (mut reader, mut definitions) = (Cursor::new(payload), Vec::new());
    for _ in 0..reader.count()? {
        let kind = reader.i32()?;
        if layout == ModelLayout::Sized {
            let length = reader.count()?;
            let mut definition = Cursor::new(reader.bytes(length)?);
            // A definition that cannot be read costs itself alone.
            if kind == RIGID_BODY {
                definitions.extend(named(&mut definition));
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

/// Reads the name and id at the start of a definition.
fn named(reader: &mut Cursor) -> Result<Definition, Malformed> {
    let name = String::from_utf8_lossy(reader.text()?).into_owned();
    Ok(Definition { name, id: reader.i32()? })
}

/// Reads the definition of a rigid body in a layout before 4.1, and returns its name and id. Skips parent, offset, and
/// the markers with positions, labels and names.
fn rigid_body(reader: &mut Cursor, layout: ModelLayout) -> Result<Definition, Malformed> {
    let definition = named(reader)?;
    reader.skip(4, 4)?;
    let markers = reader.count()?;
    reader.skip(markers, 12 + 4)?;
    if layout == ModelLayout::NamedMarkers {
        for _ in 0..markers {
            reader.text()?;
        }
    }
    Ok(definition)
}

/// Skips the end of a force plate or device: two numbers of kinds of data, then the names of channels.
fn channels(reader: &mut Cursor) -> Result<(), Malformed> {
    reader.skip(2, 4)?;
    texts(reader)
}

/// Skips a list of texts, which begins with their number.
fn texts(reader: &mut Cursor) -> Result<(), Malformed> {
    for _ in 0..reader.count()? {
        reader.text()?;
    }
    Ok(())
}
