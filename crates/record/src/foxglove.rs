//! Parts of Foxglove's messages, which Foxglove, Lichtblick and Rerun draw without plug-ins.

use ::foxglove::messages::{Color, Log, Point3, Pose, Quaternion, SceneEntity, Timestamp, Vector3};

/// Name of the team's world frame in Foxglove messages: `map`, as in REP-105.
pub const MAP: &str = "map";

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

/// Returns the time `nanos` \[ns\], since 1970 or the start of a simulation, as that of a message. One past the year
/// 2106 is that year.
pub fn time(nanos: u64) -> Option<Timestamp> {
    const SECOND_NS: u64 = 1_000_000_000;
    let seconds = u32::try_from(nanos / SECOND_NS).unwrap_or(u32::MAX);
    Some(Timestamp::new(seconds, (nanos % SECOND_NS) as u32))
}

/// Returns a vector (x, y, z).
pub fn vector([x, y, z]: [f64; 3]) -> Option<Vector3> {
    Some(Vector3 { x, y, z })
}

/// Returns a point (x, y, z) of a line.
pub fn point([x, y, z]: [f64; 3]) -> Point3 {
    Point3 { x, y, z }
}

/// Returns the rotation about the vertical axis by `yaw` \[rad\], as a quaternion.
pub fn rotation(yaw: f64) -> Option<Quaternion> {
    Some(Quaternion { x: 0.0, y: 0.0, z: libm::sin(yaw / 2.0), w: libm::cos(yaw / 2.0) })
}

/// Returns a pose: position `at` \[m\], and yaw \[rad\] counter-clockwise from x.
pub fn pose(at: [f64; 3], yaw: f64) -> Option<Pose> {
    Some(Pose { position: vector(at), orientation: rotation(yaw) })
}

/// Returns a colour of its parts, each 0 to 1.
pub const fn colour([r, g, b, a]: [f64; 4]) -> Color {
    Color { r, g, b, a }
}

/// Returns an entity (a group of shapes) with the id `id` in the world frame, without shapes. `at` is its time \[ns\],
/// since 1970 or the start of a simulation.
pub fn entity(at: u64, id: String) -> SceneEntity {
    SceneEntity { timestamp: time(at), frame_id: MAP.to_owned(), id, ..SceneEntity::default() }
}

/// Returns a log message: time `at` \[ns\] since 1970 or the start of a simulation, severity `level`, name of the actor
/// or thread that logged it, and text.
pub fn log(at: u64, level: Severity, name: &str, text: &str) -> Log {
    let (name, message) = (name.to_owned(), text.to_owned());
    Log { timestamp: time(at), level: level as i32, message, name, ..Log::default() }
}
