//! Source `odometry`: makes readings from the odometry that drivers report, transformed to the team's frame by poses
//! that the user measures and writes into the team file.
//!
//! Odometry drifts, so the source is for tests and for short runs. It is also for robots that correct their odometry on
//! board, such as those that localize themselves on a map.

use std::collections::BTreeMap;

use actix::Recipient;
use serde::Deserialize;

use super::alignment::Alignment;
use super::plausibility::Quality;
use super::{In, Out, Parts, Source};
use crate::config::ConfigError;
use crate::edge::{Input, Seat, Settings, Worker};
use crate::messages::geometry::Pose;
use crate::messages::ids::RobotId;
use crate::time::Time;

/// Description of the source `odometry` in one line, for lists of all sources.
pub(crate) const ABOUT: &str = "the robots' own odometry, from their drivers on the same host";

/// Settings of the source `odometry` for one robot, in the team file. The frame of its odometry is the pose of the
/// robot when it was switched on, or when the odometry was last reset.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Origin of the robot's odometry in the team's frame \[m\].
    #[serde(default)]
    origin_m: [f64; 2],
    /// Rotation from the odometry's frame to the team's \[rad\], counter-clockwise.
    #[serde(default)]
    yaw_rad: f64,
}

/// Distance \[m\] and angle \[rad\] from the origin of its frame within which odometry may just have begun anew.
const ORIGIN: (f32, f32) = (0.005, 0.005);

/// Returns what may be assumed of odometry that states this pose in its own frame.
pub fn quality(pose: &Pose) -> Quality {
    let turned = pose.heading.is_some_and(|heading| heading.abs() > ORIGIN.1);
    Quality { at_origin: pose.position.norm() <= ORIGIN.0 && !turned, ..Quality::RECKONED }
}

/// Logic of the source `odometry`: converts odometry that drivers report to readings in the team's frame.
struct Odometry {
    robots: BTreeMap<RobotId, Alignment>,
    /// Stamp of the last odometry of each robot \[ns\], by which a repeated measurement is recognised.
    stamps: BTreeMap<RobotId, u64>,
    /// What may be assumed of the newest odometry of each robot.
    qualities: BTreeMap<RobotId, Quality>,
}

/// Makes the source of readings that uses the robots' own odometry. The error names the wrong setting.
pub(crate) fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let mut team = BTreeMap::new();
    for robot in robots {
        let config: Config = settings.for_robot(*robot)?.read()?;
        team.insert(*robot, Alignment::new(config.yaw_rad, config.origin_m)?);
    }
    let source = move || Box::new(Odometry::new(team.clone())) as Box<dyn Source>;
    Ok(Parts { source: Box::new(source), worker: Box::new(Idle) })
}

impl Odometry {
    fn new(robots: BTreeMap<RobotId, Alignment>) -> Odometry {
        Odometry { robots, stamps: BTreeMap::new(), qualities: BTreeMap::new() }
    }
}

impl Source for Odometry {
    fn quality(&self, robot: RobotId) -> Quality {
        self.qualities.get(&robot).copied().unwrap_or(Quality::RECKONED)
    }

    fn take(&mut self, _: Time, input: In, out: &mut Vec<Out>) {
        let odometry = match input {
            In::Odometry(odometry) => odometry,
            In::Packet(_) => return out.push(Out::Refused("odometry comes from drivers, not from a worker")),
            In::Sample(_) => return,
        };
        let Some(alignment) = self.robots.get(&odometry.robot) else {
            let why = "a driver has odometry of a robot that this source does not localize";
            return out.push(Out::RefusedOf(odometry.robot, why));
        };
        // A robot that repeats its last measurement has not measured again.
        if self.stamps.insert(odometry.robot, odometry.stamp_ns) == Some(odometry.stamp_ns) {
            return;
        }
        self.qualities.insert(odometry.robot, quality(&odometry.pose));
        let reading = alignment.reading(odometry);
        let robot = reading.robot;
        out.push(reading.unfit().map_or(Out::Reading(reading), |why| Out::RefusedOf(robot, why)));
    }
}

/// Worker that does nothing until its host ends.
struct Idle;

impl Worker for Idle {
    fn start(self: Box<Self>, seat: Seat) -> Recipient<Input> {
        seat.serve(|| drop)
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::FRAC_PI_2;

    use super::*;
    use crate::messages::geometry::{Motion, Vec2};
    use crate::messages::wire::Reading;

    fn odometry(robot: u16, stamp_ns: u64, x: f32) -> Reading {
        let motion = Motion { position: Vec2::new(x, 0.0), velocity: Vec2::new(0.5, 0.0) };
        let mut reading = Reading::of_point(RobotId(robot), stamp_ns, motion);
        reading.pose.heading = Some(3.0);
        reading
    }

    #[test]
    fn a_robots_own_frame_is_put_where_it_was_switched_on() {
        let table = "robot.4 = { origin_m = [1.0, 2.0], yaw_rad = 1.5707964 }".parse().unwrap();
        let settings = Settings { name: "odometry".to_owned(), table };
        let (mut source, mut out) = ((make(&settings, &[RobotId(4)]).unwrap().source)(), Vec::new());
        source.take(Time::ZERO, In::Odometry(&odometry(4, 1, 3.0)), &mut out);
        let Some(Out::Reading(reading)) = out.pop() else { panic!("{out:?}") };
        assert!((reading.pose.position - Vec2::new(1.0, 5.0)).norm() < 1e-5);
        assert!((reading.twist.velocity - Vec2::new(0.0, 0.5)).norm() < 1e-6);
        let heading = reading.pose.heading.unwrap();
        assert!((heading - (3.0 + FRAC_PI_2 - std::f32::consts::TAU)).abs() < 1e-5, "{heading}");
        source.take(Time::ZERO, In::Odometry(&odometry(4, 1, 3.0)), &mut out);
        assert!(out.is_empty(), "the same stamp is the same measurement");
        source.take(Time::ZERO, In::Odometry(&odometry(5, 2, 3.0)), &mut out);
        source.take(Time::ZERO, In::Odometry(&odometry(4, 2, f32::NAN)), &mut out);
        assert!(matches!(&out[..], [Out::RefusedOf(RobotId(5), _), Out::RefusedOf(RobotId(4), _)]), "{out:?}");
    }
}
