//! ROS 2 messages as serde structs, with the fields of the ROS `.msg` files in the same order, so that their CDR
//! encoding is that of ROS 2.
//!
//! Sources: common_interfaces (`geometry_msgs`, `nav_msgs`, `sensor_msgs`, `std_msgs`) and `builtin_interfaces`. Units
//! and axes are REP-103: metres, radians, x forward, y left. No I/O, and no DDS.

use serde::{Deserialize, Serialize};

/// Name of a ROS message's type in DDS, which ROS 2 derives from the package and the message. The name is needed to
/// create a DDS topic.
pub trait Typed {
    /// Name of the type in DDS, such as `geometry_msgs::msg::dds_::Twist_`.
    const TYPE: &'static str;
}

/// Covariance matrix of a pose or twist in a ROS message, by rows. The order is x, y, z, then rotation about x, y and
/// z.
pub type Covariance = [[f64; 6]; 6];

/// ROS message `builtin_interfaces/Time`: time since the epoch of the sender's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// Whole seconds \[s\].
    pub sec: i32,
    /// Nanoseconds within the second \[ns\].
    pub nanosec: u32,
}

impl Stamp {
    /// Returns the time \[ns\]. The error says what is wrong with the stamp.
    pub fn nanoseconds(self) -> Result<u64, &'static str> {
        let sec = u64::try_from(self.sec).map_err(|_| "its stamp is negative; set the clock of its sender")?;
        if self.nanosec >= 1_000_000_000 {
            return Err("its stamp has a second or more of nanoseconds; correct its sender");
        }
        Ok(sec * 1_000_000_000 + u64::from(self.nanosec))
    }
}

/// ROS message `std_msgs/Header`: time and coordinate frame of the data in a message.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Time of the measurement on the sender's clock.
    pub stamp: Stamp,
    /// Name of the coordinate frame in which the data are given, such as `map`.
    pub frame_id: String,
}

/// ROS messages `geometry_msgs/Vector3` and `geometry_msgs/Point`: three components in the unit of the field with this
/// type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Component along the x axis.
    pub x: f64,
    /// Component along the y axis.
    pub y: f64,
    /// Component along the z axis.
    pub z: f64,
}

/// ROS message `geometry_msgs/Quaternion`: an orientation as a unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// First imaginary part of the quaternion, that of the x axis.
    pub x: f64,
    /// Second imaginary part of the quaternion, that of the y axis.
    pub y: f64,
    /// Third imaginary part of the quaternion, that of the z axis.
    pub z: f64,
    /// Real part of the quaternion.
    pub w: f64,
}

impl Default for Quaternion {
    /// The identity, which is no rotation: (0, 0, 0, 1).
    fn default() -> Quaternion {
        Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

/// ROS message `geometry_msgs/Pose`: position and orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position \[m\] in the frame that the header of the whole message names.
    pub position: Vector3,
    /// Orientation in the frame that the header of the whole message names.
    pub orientation: Quaternion,
}

/// ROS message `geometry_msgs/Twist`: linear and angular velocity, here in the frame of the robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Linear velocity \[m/s\] along the robot's axes.
    pub linear: Vector3,
    /// Angular velocity \[rad/s\] about the robot's axes.
    pub angular: Vector3,
}

/// ROS message `geometry_msgs/TwistStamped`: a velocity command with a time and a frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistStamped {
    /// Time of the command, and name of the frame in which the velocity is given.
    pub header: Header,
    /// Commanded linear and angular velocity.
    pub twist: Twist,
}

/// ROS message `geometry_msgs/PoseWithCovariance`: a measured pose with its uncertainty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// Measured position and orientation.
    pub pose: Pose,
    /// Covariance matrix of the pose \[m^2, m rad, rad^2\].
    pub covariance: Covariance,
}

/// ROS message `geometry_msgs/TwistWithCovariance`: a measured velocity with its uncertainty.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// Measured linear and angular velocity.
    pub twist: Twist,
    /// Covariance matrix of the velocity \[(m/s)^2, m rad/s^2, (rad/s)^2\].
    pub covariance: Covariance,
}

/// ROS message `geometry_msgs/PoseStamped`: a pose with its time and frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseStamped {
    /// Time of the measurement, and name of the frame of the pose.
    pub header: Header,
    /// Position and orientation in the frame of the header.
    pub pose: Pose,
}

/// ROS message `geometry_msgs/PoseWithCovarianceStamped`: a pose with uncertainty, time and frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovarianceStamped {
    /// Time of the measurement, and name of the frame of the pose.
    pub header: Header,
    /// Pose in the frame of the header, with its covariance.
    pub pose: PoseWithCovariance,
}

/// ROS message `geometry_msgs/Transform`: translation and rotation of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Place of the frame's origin \[m\].
    pub translation: Vector3,
    /// Rotation of the frame.
    pub rotation: Quaternion,
}

/// ROS message `geometry_msgs/TransformStamped`: the place of one frame in another, as trackers send that of a body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Time of the measurement, and name of the frame in which the other one is given.
    pub header: Header,
    /// Name of the frame that is given, such as that of a body.
    pub child_frame_id: String,
    /// Place of that frame in the frame of the header.
    pub transform: Transform,
}

/// ROS message `nav_msgs/Odometry`: the pose of a robot in the frame of the header, and the velocity in the robot's own
/// frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Time of the measurement, and name of the frame of the pose.
    pub header: Header,
    /// Name of the robot's own frame, in which the velocity is given.
    pub child_frame_id: String,
    /// Pose of the robot in the frame of the header, with its covariance.
    pub pose: PoseWithCovariance,
    /// Velocity of the robot in its own frame, with its covariance.
    pub twist: TwistWithCovariance,
}

/// ROS message `sensor_msgs/BatteryState`: condition of a battery. A number that is not measured is NaN.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BatteryState {
    /// Time of the measurement; the frame has no meaning here.
    pub header: Header,
    /// Voltage of the battery \[V\].
    pub voltage: f32,
    /// Temperature of the battery \[degrees Celsius\]; NaN if not measured.
    pub temperature: f32,
    /// Current \[A\], negative when discharging; NaN if not measured.
    pub current: f32,
    /// Present charge \[Ah\]; NaN if not measured.
    pub charge: f32,
    /// Charge of the full battery, as last known \[Ah\]; NaN if not measured.
    pub capacity: f32,
    /// Capacity of the battery by design \[Ah\]; NaN if not known.
    pub design_capacity: f32,
    /// Charge as a fraction of the full one, 0 to 1; NaN if not measured.
    pub percentage: f32,
    /// Charging status, one of the constants `POWER_SUPPLY_STATUS_*` of the ROS message.
    pub power_supply_status: u8,
    /// Health of the battery, one of the constants `POWER_SUPPLY_HEALTH_*` of the ROS message.
    pub power_supply_health: u8,
    /// Chemistry of the battery, one of the constants `POWER_SUPPLY_TECHNOLOGY_*` of the ROS message.
    pub power_supply_technology: u8,
    /// Whether a battery is present in the robot.
    pub present: bool,
    /// Voltage of each cell \[V\]; empty if the cells are not measured.
    pub cell_voltage: Vec<f32>,
    /// Temperature of each cell \[degrees Celsius\]; empty if the cells are not measured.
    pub cell_temperature: Vec<f32>,
    /// Name of the place of the battery, such as a slot of the robot.
    pub location: String,
    /// Serial number of the battery.
    pub serial_number: String,
}

/// ROS message `sensor_msgs/LaserScan`: distances along rays of a scanner that turns about the z axis of its frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LaserScan {
    /// Time at which the first ray was measured, and name of the scanner's frame.
    pub header: Header,
    /// Angle of the first ray \[rad\], about the z axis of the frame from its x axis.
    pub angle_min: f32,
    /// Angle of the last ray \[rad\].
    pub angle_max: f32,
    /// Angle from each ray to the next one \[rad\]; negative for a scanner that turns clockwise.
    pub angle_increment: f32,
    /// Time from each ray to the next one \[s\].
    pub time_increment: f32,
    /// Time from one scan to the next one \[s\].
    pub scan_time: f32,
    /// Smallest distance that can be measured \[m\].
    pub range_min: f32,
    /// Largest distance that can be measured \[m\].
    pub range_max: f32,
    /// Distance along each ray \[m\]. Infinities and NaN are those of REP-117.
    pub ranges: Vec<f32>,
    /// Strength of each echo, in a unit of the scanner; empty if it is not measured.
    pub intensities: Vec<f32>,
}

/// ROS message `std_msgs/MultiArrayDimension`: one dimension of an array.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dimension {
    /// Name of the dimension, such as `robot`.
    pub label: String,
    /// Number of entries along the dimension.
    pub size: u32,
    /// Number of floats in one whole extent of this dimension: its size times the sizes of all inner dimensions.
    pub stride: u32,
}

/// ROS message `std_msgs/MultiArrayLayout`: the shape of an array whose numbers are stored in one list.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct MultiArrayLayout {
    /// Dimensions of the array, the outermost first.
    pub dim: Vec<Dimension>,
    /// Number of floats in the list before the first number of the array.
    pub data_offset: u32,
}

/// ROS message `std_msgs/Float32MultiArray`: an array of 32-bit floats with its shape.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Float32MultiArray {
    /// Shape of the array: its dimensions, and where its numbers begin.
    pub layout: MultiArrayLayout,
    /// Numbers of the array in one list, the last dimension varying fastest.
    pub data: Vec<f32>,
}

impl Float32MultiArray {
    /// Makes a two-dimensional array. `rows` and `columns` are the name and size of each dimension, and `data` has the
    /// numbers row by row.
    pub fn of_rows(rows: (&str, usize), columns: (&str, usize), data: Vec<f32>) -> Float32MultiArray {
        let stride = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
        let dimension = |(label, size): (&str, usize), reach: usize| Dimension {
            label: label.to_owned(),
            size: stride(size),
            stride: stride(reach),
        };
        let dim = vec![dimension(rows, rows.1 * columns.1), dimension(columns, columns.1)];
        Float32MultiArray { layout: MultiArrayLayout { dim, data_offset: 0 }, data }
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
    LaserScan = "sensor_msgs::msg::dds_::LaserScan_",
    Float32MultiArray = "std_msgs::msg::dds_::Float32MultiArray_",
}

/// Returns the name in DDS of a ROS topic: `rt` followed by the full ROS name, such as `rt/r1/odom`.
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
