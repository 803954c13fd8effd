//! Poses and commands in the messages of ROS 2 that a bag holds, in plain CDR.

use byteorder::{BigEndian, LittleEndian};
use serde::de::DeserializeOwned;

use murmurate_ros2::messages::{
    Header, Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped, Twist, TwistStamped,
};
use murmurate_ros2::sample::{IntoSample, PoseSample, Sample};

/// Types of messages with the pose of a robot.
pub const POSES: [&str; 4] = [
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
];
/// Types of messages with the command of a robot, those with a stamp last.
pub const COMMANDS: [&str; 2] = ["geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"];

/// Command of a robot as a message has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CommandSample {
    /// Time in the message's header \[ns\]; zero if it has none.
    pub stamp_ns: u64,
    /// Speeds along x and y \[m/s\].
    pub velocity: [f64; 2],
}

/// Decodes the pose in a message of one of the types [`POSES`]. The error says what is wrong with the message.
pub fn pose(kind: &str, data: &[u8]) -> Result<PoseSample, &'static str> {
    let sample = match kind {
        "nav_msgs/msg/Odometry" => decoded::<Odometry>(data)?.sample(),
        "geometry_msgs/msg/PoseStamped" => decoded::<PoseStamped>(data)?.sample(),
        "geometry_msgs/msg/PoseWithCovarianceStamped" => decoded::<PoseWithCovarianceStamped>(data)?.sample(),
        "geometry_msgs/msg/TransformStamped" => decoded::<TransformStamped>(data)?.sample(),
        _ => return Err("its type has no pose"),
    };
    match sample? {
        Sample::Pose(pose) => Ok(pose),
        _ => Err("its type has no pose"),
    }
}

/// Decodes the command in a message of one of the types [`COMMANDS`]. The error says what is wrong with the message.
pub fn command(kind: &str, data: &[u8]) -> Result<CommandSample, &'static str> {
    let (header, twist) = match kind {
        "geometry_msgs/msg/Twist" => (Header::default(), decoded::<Twist>(data)?),
        "geometry_msgs/msg/TwistStamped" => {
            let TwistStamped { header, twist } = decoded(data)?;
            (header, twist)
        }
        _ => return Err("its type has no command"),
    };
    let velocity = [twist.linear.x, twist.linear.y];
    if !velocity.iter().all(|speed| speed.is_finite()) {
        return Err("its velocity is not finite");
    }
    Ok(CommandSample { stamp_ns: header.stamp.nanoseconds()?, velocity })
}

/// Decodes a message. Its first four bytes say how the rest is encoded (DDS-XTypes 1.3, 7.6.3.1.2).
fn decoded<T: DeserializeOwned>(data: &[u8]) -> Result<T, &'static str> {
    const SHORT: &str = "it is cut, or its bytes are not of its type";
    let (head, body) = data.split_at_checked(4).ok_or(SHORT)?;
    let decoded = match head[..2] {
        [0, 0] => cdr_encoding::from_bytes::<T, BigEndian>(body),
        [0, 1] => cdr_encoding::from_bytes::<T, LittleEndian>(body),
        _ => return Err("its encoding is not plain CDR"),
    };
    decoded.map(|(message, _)| message).map_err(|_| SHORT)
}
