//! Poses, velocities, scans and battery charges in the form in which a host exchanges them with its DDS process, with
//! their conversion from and to ROS messages. Does no I/O.

use serde::{Deserialize, Serialize};

use murmurate::messages::geometry::{NoRotation, unit_quaternion};

use super::messages::{
    BatteryState, Covariance, Header, Odometry, Pose, PoseStamped, PoseWithCovarianceStamped, Stamp, Transform,
    TransformStamped, TwistWithCovariance,
};
use super::scan::ScanSample;

/// Content of a received ROS message, reduced to what a driver or source uses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sample {
    /// Pose of a robot, with a velocity if the message has one.
    Pose(PoseSample),
    /// Charge of a robot's battery from 0 to 1; `None` if the charge is not measured.
    Battery(Option<f32>),
    /// Distances along the rays of a sense.
    Scan(ScanSample),
}

/// Pose of a robot in the frame of the ROS message, with the axes that the sender uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PoseSample {
    /// Time of measurement \[ns\] on the sender's clock; zero if the message has no time stamp.
    pub stamp_ns: u64,
    /// Position of the robot along the frame's x axis \[m\].
    pub x: f64,
    /// Position of the robot along the frame's y axis \[m\].
    pub y: f64,
    /// Rotation of the robot about the z axis \[rad\]; `None` if the message has no orientation.
    pub yaw: Option<f64>,
    /// Standard deviation of the position along each axis, the larger one \[m\]; `None` if unknown.
    pub position_m: Option<f64>,
    /// Standard deviation of the yaw angle \[rad\]; `None` if unknown.
    pub heading_rad: Option<f64>,
    /// Velocity of the robot; `None` if the message has none.
    pub twist: Option<TwistSample>,
}

/// Velocity of a robot in the robot's own frame, with the axes that the sender uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwistSample {
    /// Velocity along the robot's x axis \[m/s\].
    pub x: f64,
    /// Velocity along the robot's y axis \[m/s\].
    pub y: f64,
    /// Angular velocity about the robot's z axis \[rad/s\].
    pub yaw_rate: f64,
    /// Standard deviation of the linear velocity along each axis, the larger one \[m/s\]; `None` if unknown.
    pub velocity_m_s: Option<f64>,
    /// Standard deviation of the yaw rate \[rad/s\]; `None` if unknown.
    pub yaw_rate_rad_s: Option<f64>,
}

impl Sample {
    /// Whether all numbers are in range: pose and velocity are finite, deviations and distances not negative, a charge
    /// from 0 to 1.
    pub fn is_sound(&self) -> bool {
        match self {
            Sample::Pose(pose) => pose.is_sound(),
            Sample::Battery(charge) => charge.is_none_or(|charge| (0.0..=1.0).contains(&charge)),
            Sample::Scan(scan) => scan.is_sound(),
        }
    }
}

impl PoseSample {
    /// Whether all numbers of the pose and velocity are finite and no standard deviation is negative.
    pub fn is_sound(&self) -> bool {
        let deviation = |deviation: Option<f64>| deviation.is_none_or(|d| d.is_finite() && d >= 0.0);
        let twist = self.twist.is_none_or(|twist| {
            let numbers = [twist.x, twist.y, twist.yaw_rate].iter().all(|v| v.is_finite());
            numbers && deviation(twist.velocity_m_s) && deviation(twist.yaw_rate_rad_s)
        });
        let numbers = [self.x, self.y, self.yaw.unwrap_or(0.0)].iter().all(|v| v.is_finite());
        numbers && twist && deviation(self.position_m) && deviation(self.heading_rad)
    }
}

impl PoseSample {
    /// Converts this sample to a ROS message `nav_msgs/Odometry`. `frame` names the frame of the pose, `child` the
    /// robot's own frame. An unknown yaw is sent as zero.
    pub fn to_odometry(&self, frame: &str, child: &str) -> Odometry {
        let (sin, cos) = libm::sincos(self.yaw.unwrap_or(0.0) / 2.0);
        let sec = i32::try_from(self.stamp_ns / 1_000_000_000).unwrap_or(i32::MAX);
        let nanosec = u32::try_from(self.stamp_ns % 1_000_000_000).expect("less than 1e9");
        let mut odometry = Odometry {
            header: Header { stamp: Stamp { sec, nanosec }, frame_id: frame.to_owned() },
            child_frame_id: child.to_owned(),
            ..Odometry::default()
        };
        let pose = &mut odometry.pose;
        (pose.pose.position.x, pose.pose.position.y) = (self.x, self.y);
        (pose.pose.orientation.z, pose.pose.orientation.w) = (sin, cos);
        spread(&mut pose.covariance, self.position_m, self.heading_rad);
        if let Some(sample) = self.twist {
            let twist = &mut odometry.twist;
            (twist.twist.linear.x, twist.twist.linear.y) = (sample.x, sample.y);
            twist.twist.angular.z = sample.yaw_rate;
            spread(&mut twist.covariance, sample.velocity_m_s, sample.yaw_rate_rad_s);
        }
        odometry
    }
}

/// Sets the variances of x and y to the square of the standard deviation `plane`, and that of yaw to the square of
/// `yaw`. Those that are `None` (unknown) are set to zero.
fn spread(covariance: &mut Covariance, plane: Option<f64>, yaw: Option<f64>) {
    let square = |deviation: Option<f64>| deviation.map_or(0.0, |d| d * d);
    (covariance[0][0], covariance[1][1], covariance[5][5]) = (square(plane), square(plane), square(yaw));
}

/// ROS message that can be reduced to a [`Sample`], the content that a driver or source uses.
pub trait IntoSample {
    /// Reduces the message to its content. The error says what is wrong with the message.
    fn sample(&self) -> Result<Sample, &'static str>;
}

impl IntoSample for Odometry {
    fn sample(&self) -> Result<Sample, &'static str> {
        let pose = pose(self.header.stamp, &self.pose.pose, Some(&self.pose.covariance))?;
        Ok(Sample::Pose(PoseSample { twist: Some(twist(&self.twist)?), ..pose }))
    }
}

impl IntoSample for PoseStamped {
    fn sample(&self) -> Result<Sample, &'static str> {
        pose(self.header.stamp, &self.pose, None).map(Sample::Pose)
    }
}

impl IntoSample for PoseWithCovarianceStamped {
    fn sample(&self) -> Result<Sample, &'static str> {
        pose(self.header.stamp, &self.pose.pose, Some(&self.pose.covariance)).map(Sample::Pose)
    }
}

impl IntoSample for TransformStamped {
    fn sample(&self) -> Result<Sample, &'static str> {
        let Transform { translation, rotation } = self.transform;
        pose(self.header.stamp, &Pose { position: translation, orientation: rotation }, None).map(Sample::Pose)
    }
}

impl IntoSample for BatteryState {
    fn sample(&self) -> Result<Sample, &'static str> {
        // Some drivers report a full battery as slightly more than 1.
        match self.percentage {
            charge if charge.is_nan() => Ok(Sample::Battery(None)),
            charge if (0.0..=1.05).contains(&charge) => Ok(Sample::Battery(Some(charge.min(1.0)))),
            _ => Err("its percentage is not from 0 to 1, which sensor_msgs/BatteryState demands"),
        }
    }
}

fn pose(stamp: Stamp, pose: &Pose, covariance: Option<&Covariance>) -> Result<PoseSample, &'static str> {
    let stamp_ns = stamp.nanoseconds()?;
    if !(pose.position.x.is_finite() && pose.position.y.is_finite()) {
        return Err("its position is not finite; see whether the sender is localized");
    }
    let deviations = covariance.map(deviations).unwrap_or_default();
    Ok(PoseSample {
        stamp_ns,
        x: pose.position.x,
        y: pose.position.y,
        yaw: yaw([pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w])?,
        position_m: deviations.0,
        heading_rad: deviations.1,
        twist: None,
    })
}

/// Returns the rotation about the z axis \[rad\] of an orientation x, y, z, w; `None` if all components of the
/// quaternion are zero, so that no orientation was set. An error says that it is not a unit quaternion.
pub fn yaw(orientation: [f64; 4]) -> Result<Option<f64>, &'static str> {
    match unit_quaternion(orientation) {
        Ok([x, y, z, w]) => Ok(Some(libm::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))),
        Err(NoRotation::Zero) => Ok(None),
        Err(NoRotation::Length) => Err("its orientation is not a unit quaternion; correct its sender"),
    }
}

fn twist(twist: &TwistWithCovariance) -> Result<TwistSample, &'static str> {
    let (linear, angular) = (twist.twist.linear, twist.twist.angular);
    if !(linear.x.is_finite() && linear.y.is_finite() && angular.z.is_finite()) {
        return Err("its twist is not finite; correct its sender");
    }
    let (velocity_m_s, yaw_rate_rad_s) = deviations(&twist.covariance);
    Ok(TwistSample { x: linear.x, y: linear.y, yaw_rate: angular.z, velocity_m_s, yaw_rate_rad_s })
}

/// Returns the standard deviations of position or velocity in the plane (the larger of x and y) and of yaw, from a
/// covariance matrix. `None` if unknown: a variance is zero, negative or not finite.
fn deviations(covariance: &Covariance) -> (Option<f64>, Option<f64>) {
    let root = |variance: f64| (variance.is_finite() && variance > 0.0).then(|| variance.sqrt());
    (root(covariance[0][0].max(covariance[1][1])), root(covariance[5][5]))
}

#[cfg(test)]
mod tests {
    use super::super::messages::{PoseWithCovariance, Quaternion, Twist, Vector3};
    use super::*;

    fn odometry() -> Odometry {
        let half = 0.35_f64;
        let mut pose = PoseWithCovariance::default();
        (pose.pose.position.x, pose.pose.position.y) = (1.5, -2.5);
        pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z: half.sin(), w: half.cos() };
        (pose.covariance[0][0], pose.covariance[1][1], pose.covariance[5][5]) = (0.01, 0.04, 0.25);
        let linear = Vector3 { x: 0.3, y: 0.1, z: 0.0 };
        let angular = Vector3 { z: -0.5, ..Vector3::default() };
        Odometry {
            header: Header { stamp: Stamp { sec: 12, nanosec: 34 }, frame_id: "r1/odom".to_owned() },
            child_frame_id: "r1/base_link".to_owned(),
            pose,
            twist: TwistWithCovariance { twist: Twist { linear, angular }, covariance: [[0.0; 6]; 6] },
        }
    }

    #[test]
    fn each_field_of_odometry_is_taken_and_given_back() {
        let Ok(Sample::Pose(pose)) = odometry().sample() else { panic!("it is a pose") };
        assert_eq!((pose.stamp_ns, pose.x, pose.y), (12_000_000_034, 1.5, -2.5));
        assert!((pose.yaw.unwrap() - 0.7).abs() < 1e-12);
        assert_eq!((pose.position_m, pose.heading_rad), (Some(0.2), Some(0.5)));
        let twist = pose.twist.unwrap();
        assert_eq!((twist.x, twist.y, twist.yaw_rate), (0.3, 0.1, -0.5));
        assert_eq!((twist.velocity_m_s, twist.yaw_rate_rad_s), (None, None), "a variance of zero is unknown");
        let Ok(Sample::Pose(again)) = pose.to_odometry("map", "r1/base_link").sample() else { panic!("a pose") };
        assert!((again.yaw.unwrap() - 0.7).abs() < 1e-12);
        assert_eq!(PoseSample { yaw: pose.yaw, ..again }, pose);
    }

    #[test]
    fn messages_that_are_no_measurement_are_refused() {
        let refused = |change: &dyn Fn(&mut Odometry)| {
            let mut odometry = odometry();
            change(&mut odometry);
            odometry.sample().is_err()
        };
        assert!(refused(&|o| o.pose.pose.position.x = f64::NAN));
        assert!(refused(&|o| o.pose.pose.orientation.w = 3.0));
        assert!(refused(&|o| o.pose.pose.orientation.z = f64::NAN));
        assert!(refused(&|o| o.twist.twist.angular.z = f64::INFINITY));
        assert!(refused(&|o| o.header.stamp.sec = -1));
        assert!(refused(&|o| o.header.stamp.nanosec = 1_000_000_000));
        assert!(!refused(&|o| o.pose.covariance[0][0] = f64::NAN));
        let mut unset = odometry();
        unset.pose.pose.orientation = Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 };
        assert!(matches!(unset.sample(), Ok(Sample::Pose(PoseSample { yaw: None, .. }))));
        let battery = |percentage| BatteryState { percentage, ..BatteryState::default() }.sample();
        assert_eq!(battery(0.87), Ok(Sample::Battery(Some(0.87))));
        assert_eq!(battery(f32::NAN), Ok(Sample::Battery(None)));
        assert!(battery(87.0).is_err());
    }
}
