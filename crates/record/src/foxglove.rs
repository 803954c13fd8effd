//! Foxglove's message types as Protobuf, which Foxglove, Lichtblick and Rerun draw without plug-ins. Only the fields
//! that records use are described.

use super::protobuf::{EnumType, Message, MessageType, Type};

/// Name of the team's world frame in Foxglove messages: `map`, as in REP-105.
pub const MAP: &str = "map";

/// Colour as red, green, blue and opacity, each 0 to 1.
pub type Colour = [f64; 4];

const TIMESTAMP: Type = Type::One(".google.protobuf.Timestamp");
const DURATION: Type = Type::One(".google.protobuf.Duration");
const POSE: Type = Type::One(".foxglove.Pose");
const VECTOR: Type = Type::One(".foxglove.Vector3");
const COLOUR: Type = Type::One(".foxglove.Color");

/// Definitions of the Protobuf message types of the package `foxglove` that records use: each with its fields and their
/// numbers.
pub const MESSAGES: &[MessageType] = &[
    ("Vector3", &[("x", 1, Type::Double), ("y", 2, Type::Double), ("z", 3, Type::Double)]),
    ("Point3", &[("x", 1, Type::Double), ("y", 2, Type::Double), ("z", 3, Type::Double)]),
    ("Quaternion", &[("x", 1, Type::Double), ("y", 2, Type::Double), ("z", 3, Type::Double), ("w", 4, Type::Double)]),
    ("Color", &[("r", 1, Type::Double), ("g", 2, Type::Double), ("b", 3, Type::Double), ("a", 4, Type::Double)]),
    ("Pose", &[("position", 1, VECTOR), ("orientation", 2, Type::One(".foxglove.Quaternion"))]),
    (
        "FrameTransform",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("parent_frame_id", 2, Type::Text),
            ("child_frame_id", 3, Type::Text),
            ("translation", 4, VECTOR),
            ("rotation", 5, Type::One(".foxglove.Quaternion")),
        ],
    ),
    ("FrameTransforms", &[("transforms", 1, Type::Many(".foxglove.FrameTransform"))]),
    ("PoseInFrame", &[("timestamp", 1, TIMESTAMP), ("frame_id", 2, Type::Text), ("pose", 3, POSE)]),
    (
        "Log",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("level", 2, Type::Enum(".foxglove.Level")),
            ("message", 3, Type::Text),
            ("name", 4, Type::Text),
            ("file", 5, Type::Text),
            ("line", 6, Type::Fixed32),
        ],
    ),
    (
        "ArrowPrimitive",
        &[
            ("pose", 1, POSE),
            ("shaft_length", 2, Type::Double),
            ("shaft_diameter", 3, Type::Double),
            ("head_length", 4, Type::Double),
            ("head_diameter", 5, Type::Double),
            ("color", 6, COLOUR),
        ],
    ),
    ("CubePrimitive", &[("pose", 1, POSE), ("size", 2, VECTOR), ("color", 3, COLOUR)]),
    (
        "CylinderPrimitive",
        &[
            ("pose", 1, POSE),
            ("size", 2, VECTOR),
            ("bottom_scale", 3, Type::Double),
            ("top_scale", 4, Type::Double),
            ("color", 5, COLOUR),
        ],
    ),
    (
        "LinePrimitive",
        &[
            ("type", 1, Type::Enum(".foxglove.LineType")),
            ("pose", 2, POSE),
            ("thickness", 3, Type::Double),
            ("scale_invariant", 4, Type::Bool),
            ("points", 5, Type::Many(".foxglove.Point3")),
            ("color", 6, COLOUR),
            ("colors", 7, Type::Many(".foxglove.Color")),
        ],
    ),
    (
        "TextPrimitive",
        &[
            ("pose", 1, POSE),
            ("billboard", 2, Type::Bool),
            ("font_size", 3, Type::Double),
            ("scale_invariant", 4, Type::Bool),
            ("color", 5, COLOUR),
            ("text", 6, Type::Text),
        ],
    ),
    (
        "SceneEntity",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Type::Text),
            ("id", 3, Type::Text),
            ("lifetime", 4, DURATION),
            ("frame_locked", 5, Type::Bool),
            ("arrows", 7, Type::Many(".foxglove.ArrowPrimitive")),
            ("cubes", 8, Type::Many(".foxglove.CubePrimitive")),
            ("cylinders", 10, Type::Many(".foxglove.CylinderPrimitive")),
            ("lines", 11, Type::Many(".foxglove.LinePrimitive")),
            ("texts", 13, Type::Many(".foxglove.TextPrimitive")),
        ],
    ),
    ("SceneUpdate", &[("entities", 2, Type::Many(".foxglove.SceneEntity"))]),
    (
        "PackedElementField",
        &[("name", 1, Type::Text), ("offset", 2, Type::Fixed32), ("type", 3, Type::Enum(".foxglove.NumericType"))],
    ),
    (
        "PointCloud",
        &[
            ("timestamp", 1, TIMESTAMP),
            ("frame_id", 2, Type::Text),
            ("pose", 3, POSE),
            ("point_stride", 4, Type::Fixed32),
            ("fields", 5, Type::Many(".foxglove.PackedElementField")),
            ("data", 6, Type::Bytes),
        ],
    ),
];

/// Definitions of the Protobuf enumerations of the package `foxglove` that records use: each with its values in order,
/// from 0.
pub const ENUMS: &[EnumType] = &[
    ("Level", &["UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL"]),
    ("LineType", &["LINE_STRIP", "LINE_LOOP", "LINE_LIST"]),
    ("NumericType", &["NUMERIC_UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"]),
];

/// Severity of a log message, with Foxglove's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Severity {
    /// Detail that helps to find the cause of a problem.
    Debug = 1,
    /// Normal event.
    Info = 2,
    /// Event that needs attention.
    Warning = 3,
    /// Event that has ended or prevented something.
    Error = 4,
}

/// Writes a time (since 1970 or the start of a simulation) or a duration, \[ns\], as the field with the number `field`.
pub fn time(out: &mut Message, field: u32, nanos: u64) {
    out.message(field, |stamp| {
        stamp.uint(1, nanos / 1_000_000_000);
        stamp.uint(2, nanos % 1_000_000_000);
    });
}

/// Writes a vector or a point (x, y, z) as the field with the number `field`.
pub fn vector(out: &mut Message, field: u32, [x, y, z]: [f64; 3]) {
    out.message(field, |vector| {
        vector.double(1, x);
        vector.double(2, y);
        vector.double(3, z);
    });
}

/// Writes the rotation about the vertical axis by `yaw` \[rad\], as a quaternion, as the field with the number `field`.
pub fn rotation(out: &mut Message, field: u32, yaw: f64) {
    out.message(field, |quaternion| {
        quaternion.double(3, libm::sin(yaw / 2.0));
        quaternion.double(4, libm::cos(yaw / 2.0));
    });
}

/// Writes a pose as the field with the number `field`: position `at` \[m\], and yaw \[rad\] counter-clockwise from x.
pub fn pose(out: &mut Message, field: u32, at: [f64; 3], yaw: f64) {
    out.message(field, |pose| {
        vector(pose, 1, at);
        rotation(pose, 2, yaw);
    });
}

/// Writes a colour as the field with the number `field`.
pub fn colour(out: &mut Message, field: u32, [red, green, blue, opacity]: Colour) {
    out.message(field, |colour| {
        colour.double(1, red);
        colour.double(2, green);
        colour.double(3, blue);
        colour.double(4, opacity);
    });
}

/// Adds an entity (a group of shapes) with the id `id` in the world frame to a scene update; `write` adds its shapes.
/// `at` is its time \[ns\], since 1970 or the start of a simulation.
pub fn entity(update: &mut Message, at: u64, id: &str, write: impl FnOnce(&mut Message)) {
    update.message(2, |entity| {
        time(entity, 1, at);
        entity.text(2, MAP);
        entity.text(3, id);
        write(entity);
    });
}

/// Writes the fields of a log message: time `at` \[ns\] since 1970 or the start of a simulation, severity `level`, name
/// of the actor or thread that logged it, and text.
pub fn log(out: &mut Message, at: u64, level: Severity, name: &str, text: &str) {
    time(out, 1, at);
    out.uint(2, level as u64);
    out.text(3, text);
    out.text(4, name);
}
