//! ROS 2 messages as serde structs whose CDR encoding is that of their `.msg` files, in the order of the fields there.
//!
//! Sources: common_interfaces (`geometry_msgs`, `nav_msgs`, `sensor_msgs`, `std_msgs`) and `builtin_interfaces`. Units
//! and axes are REP-103: metres, radians, x forward, y left. No I/O, and no DDS.

use serde::{Deserialize, Serialize};

/// Name of a message's type in DDS, as ROS 2 derives it from the package and the message.
pub trait Typed {
    /// The name, such as `geometry_msgs::msg::dds_::Twist_`.
    const TYPE: &'static str;
}

/// Covariance of six numbers by rows; the order is x, y, z, roll, pitch, yaw.
pub type Covariance = [[f64; 6]; 6];

/// `builtin_interfaces/Time`: time since the epoch of the sender's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Whole seconds \[s\].
    pub sec: i32,
    /// Nanoseconds within the second \[ns\].
    pub nanosec: u32,
}

/// `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Time of the measurement.
    pub stamp: Stamp,
    /// Name of the frame.
    pub frame_id: String,
}

/// `geometry_msgs/Vector3` and `geometry_msgs/Point`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Along x.
    pub x: f64,
    /// Along y.
    pub y: f64,
    /// Along z.
    pub z: f64,
}

/// `geometry_msgs/Quaternion`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// First imaginary part.
    pub x: f64,
    /// Second imaginary part.
    pub y: f64,
    /// Third imaginary part.
    pub z: f64,
    /// Real part.
    pub w: f64,
}

impl Default for Quaternion {
    /// The identity.
    fn default() -> Quaternion {
        Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// `geometry_msgs/Pose`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position \[m\] in the frame of the header.
    pub position: Vector3,
    /// Orientation in the same frame.
    pub orientation: Quaternion,
}

/// `geometry_msgs/Twist`: command or velocity, in the frame of the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Linear velocity \[m/s\].
    pub linear: Vector3,
    /// Angular velocity \[rad/s\].
    pub angular: Vector3,
}

/// `geometry_msgs/TwistStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistStamped {
    /// Time and frame.
    pub header: Header,
    /// The command.
    pub twist: Twist,
}

/// `geometry_msgs/PoseWithCovariance`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// The pose.
    pub pose: Pose,
    /// Its covariance \[m^2, m rad, rad^2\].
    pub covariance: Covariance,
}

/// `geometry_msgs/TwistWithCovariance`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// The velocity.
    pub twist: Twist,
    /// Its covariance \[(m/s)^2, m rad/s^2, (rad/s)^2\].
    pub covariance: Covariance,
}

/// `geometry_msgs/PoseStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Time and frame.
    pub header: Header,
    /// The pose.
    pub pose: Pose,
}

/// `geometry_msgs/PoseWithCovarianceStamped`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovarianceStamped {
    /// Time and frame.
    pub header: Header,
    /// The pose.
    pub pose: PoseWithCovariance,
}

/// `nav_msgs/Odometry`: the pose in the frame of the header, the twist in the frame of the robot.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Time, and frame of the pose.
    pub header: Header,
    /// Frame of the twist.
    pub child_frame_id: String,
    /// The pose.
    pub pose: PoseWithCovariance,
    /// The velocity.
    pub twist: TwistWithCovariance,
}

/// `sensor_msgs/BatteryState`; a value that is not measured is NaN.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BatteryState {
    /// Time and frame.
    pub header: Header,
    /// Voltage \[V\].
    pub voltage: f32,
    /// Temperature \[degrees Celsius\].
    pub temperature: f32,
    /// Current, negative when discharging \[A\].
    pub current: f32,
    /// Charge \[Ah\].
    pub charge: f32,
    /// Last full capacity \[Ah\].
    pub capacity: f32,
    /// Capacity by design \[Ah\].
    pub design_capacity: f32,
    /// Charge from 0 to 1.
    pub percentage: f32,
    /// Charging status.
    pub power_supply_status: u8,
    /// Health of the battery.
    pub power_supply_health: u8,
    /// Chemistry.
    pub power_supply_technology: u8,
    /// Whether there is a battery.
    pub present: bool,
    /// Voltage of each cell \[V\].
    pub cell_voltage: Vec<f32>,
    /// Temperature of each cell \[degrees Celsius\].
    pub cell_temperature: Vec<f32>,
    /// Place of the battery.
    pub location: String,
    /// Serial number.
    pub serial_number: String,
}

/// `std_msgs/MultiArrayDimension`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dimension {
    /// Name.
    pub label: String,
    /// Number of entries.
    pub size: u32,
    /// Number of floats from one entry of the dimension before it to the next.
    pub stride: u32,
}

/// `std_msgs/MultiArrayLayout`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Layout {
    /// Dimensions, the outermost first.
    pub dim: Vec<Dimension>,
    /// Number of floats before the data.
    pub data_offset: u32,
}

/// `std_msgs/Float32MultiArray`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Float32MultiArray {
    /// Shape.
    pub layout: Layout,
    /// The numbers.
    pub data: Vec<f32>,
}

impl Float32MultiArray {
    /// Array of shape `[rows, columns]`, by rows.
    pub fn of_rows(rows: (&str, usize), columns: (&str, usize), data: Vec<f32>) -> Float32MultiArray {
        let stride = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        let dimension = |(label, size): (&str, usize), reach: usize| Dimension {
            label: label.to_owned(),
            size: stride(size),
            stride: stride(reach),
        };
        let dim = vec![dimension(rows, rows.1 * columns.1), dimension(columns, columns.1)];
        Float32MultiArray { layout: Layout { dim, data_offset: 0 }, data }
    }
}

macro_rules! typed {
    ($($message:ident = $name:literal),* $(,)?) => {
        $(impl Typed for $message { const TYPE: &'static str = $name; })*
    };
}

typed! {
    Twist = "geometry_msgs::msg::dds_::Twist_",
    TwistStamped = "geometry_msgs::msg::dds_::TwistStamped_",
    PoseStamped = "geometry_msgs::msg::dds_::PoseStamped_",
    PoseWithCovarianceStamped = "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_",
    Odometry = "nav_msgs::msg::dds_::Odometry_",
    BatteryState = "sensor_msgs::msg::dds_::BatteryState_",
    Float32MultiArray = "std_msgs::msg::dds_::Float32MultiArray_",
}

/// Name of a ROS topic in DDS: `rt` before it, since it begins with a slash.
pub fn dds_topic(topic: &str) -> String {
    format!("rt{topic}")
}

/// Checks a full ROS topic name. The error says what is wrong with it.
///
/// Rules: ROS 2 design, "Topic and Service Names": letters, digits and underscores between slashes; no part is empty,
/// begins with a digit or has two underscores in a row.
pub fn check_topic(topic: &str) -> Result<(), &'static str> {
    let Some(parts) = topic.strip_prefix('/') else {
        return Err("it must begin with '/'; write it like \"/r1/cmd_vel\"");
    };
    // Fast DDS keeps names of topics in strings of at most 255 bytes.
    if topic.len() > 200 {
        return Err("it is longer than 200 characters; shorten it");
    }
    for part in parts.split('/') {
        if part.is_empty() {
            return Err("a part of it is empty; write one '/' between two names, and none at the end");
        }
        if part.starts_with(|first: char| first.is_ascii_digit()) {
            return Err("a part of it begins with a digit, which ROS refuses; begin it with a letter");
        }
        if !part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') || part.contains("__") {
            return Err("ROS takes letters, digits and single underscores only; correct it");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_ros_refuses_are_refused() {
        for good in ["/r1/cmd_vel", "/cmd_vel", "/Team/r_1/odom", "/_hidden"] {
            assert_eq!(check_topic(good), Ok(()), "{good}");
        }
        let long = format!("/{}", "a".repeat(200));
        for bad in ["", "r1/odom", "/", "/r1/", "/r1//odom", "/1r", "/r-1", "/r__1", "/r1 ", "/ä", long.as_str()] {
            assert!(check_topic(bad).is_err(), "{bad}");
        }
        assert_eq!(dds_topic("/r1/cmd_vel"), "rt/r1/cmd_vel");
    }

    #[test]
    fn rows_have_the_strides_of_std_msgs() {
        let array = Float32MultiArray::of_rows(("robot", 2), ("feature", 3), vec![0.0; 6]);
        let strides: Vec<u32> = array.layout.dim.iter().map(|dimension| dimension.stride).collect();
        assert_eq!(strides, [6, 3]);
    }
}
