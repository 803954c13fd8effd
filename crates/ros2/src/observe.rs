//! State of the team as standard ROS messages, for people who work with `rviz2` and `rosbag2`. Does no I/O.
//!
//! Each robot's reading is `nav_msgs/Odometry` on `<prefix>/robot_<id>/odom` in the frame `map`. The team's state and
//! latents are `std_msgs/Float32MultiArray`, one row for each robot by id. These messages control no robot.

use serde::Deserialize;

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::messages::geometry::{Motion, rotated};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;

use super::messages::check_topic;
use super::packet::{self, MAX_FLOATS, Outgoing, Plan, PoseSample, Publication, Publish, ToNode, TwistSample, Written};
use super::settings;
use super::supervisor::Supervisor;

/// Number of columns in the table of the team's state: robot id, x, y \[m\], velocity along x and y \[m/s\].
pub const STATE_COLUMNS: u32 = 5;

/// Settings of the table `observe` of a host in the team file: how the host publishes the team's state to ROS 2.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Beginning of the names of all topics with the team's state, such as `/team`.
    #[serde(default = "prefix")]
    prefix: String,
    /// DDS domain in which the topics are published, the `ROS_DOMAIN_ID` of the observers' tools.
    #[serde(default)]
    domain: u16,
    /// Name or address of the network interface to use; `None`: all interfaces.
    interface: Option<String>,
    /// Memory that the DDS process may use in addition to its size at its start \[MiB\].
    #[serde(default = "settings::memory_mib")]
    memory_mib: u32,
}

fn prefix() -> String {
    "/team".to_owned()
}

/// Makes the topics on which a host publishes the state of `robots` to ROS 2, and the worker that publishes them, from
/// the settings of the host's table `observe` in the team file.
///
/// # Errors
///
/// A setting is wrong; the error has its name.
pub fn make(settings: &Settings, robots: &[RobotId]) -> Result<(Observation, Supervisor), ConfigError> {
    let Config { prefix, domain, interface, memory_mib } = settings.read()?;
    settings::check_participant(domain, interface.as_deref(), memory_mib)?;
    let name = "the observation of the team".to_owned();
    let plan = Plan { name, domain, interface, memory_mib, writers: Vec::new(), readers: Vec::new() };
    let observation = Observation::new(&prefix, robots, plan)?;
    let worker = Supervisor { plan: observation.plan().clone(), spare: false, program: None, field: "name" };
    Ok((observation, worker))
}

/// Topics on which a host publishes the state of its team as standard ROS messages, for tools such as `rviz2`.
#[derive(Clone, Debug)]
pub struct Observation {
    robots: Vec<RobotId>,
    plan: Plan,
}

impl Observation {
    /// Makes the topics for these robots under a prefix such as `/team`. Of `plan`, the lists of topics are replaced.
    ///
    /// # Errors
    ///
    /// The prefix is no valid name of a ROS topic, or there are more robots than one DDS process can have topics for.
    pub fn new(prefix: &str, robots: &[RobotId], plan: Plan) -> Result<Observation, ConfigError> {
        check_topic(prefix).map_err(|why| ConfigError::field("prefix", format!("'{prefix}': {why}")))?;
        if robots.len() + 2 > packet::MAX_TOPICS {
            let reason = format!("{} robots are too many; observe at most 254 from one host", robots.len());
            return Err(ConfigError::field("robots", reason));
        }
        let mut robots = robots.to_vec();
        robots.sort_unstable();
        let floats = |name: &str| Publication { topic: format!("{prefix}/{name}"), kind: Written::Floats };
        let pose = |robot: &RobotId| format!("{prefix}/robot_{}/odom", robot.0);
        let poses = robots.iter().map(|robot| Publication { topic: pose(robot), kind: Written::Odometry });
        let writers = [floats("state"), floats("latents")].into_iter().chain(poses).collect();
        let plan = Plan { writers, readers: Vec::new(), ..plan };
        Ok(Observation { robots, plan })
    }

    /// Returns the plan of the DDS process that publishes the team's state, with all topics.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Encodes the packet to a DDS process that publishes a robot's reading as `nav_msgs/Odometry`. Returns `None` for
    /// a robot for which no topic was made.
    pub fn pose(&self, reading: &Reading) -> Option<Vec<u8>> {
        let index = self.robots.binary_search(&reading.robot).ok()?;
        let heading = reading.pose.heading.map(f64::from);
        let velocity = reading.twist.velocity;
        // The twist of an Odometry is in the frame of the robot; without a heading that frame is unknown.
        let twist = heading.map(|heading| {
            let (x, y) = rotated(-heading, f64::from(velocity.x), f64::from(velocity.y));
            let deviation = &reading.deviation;
            TwistSample {
                x,
                y,
                yaw_rate: f64::from(reading.twist.yaw_rate.unwrap_or(0.0)),
                velocity_m_s: deviation.velocity_m_s.map(f64::from),
                yaw_rate_rad_s: deviation.yaw_rate_rad_s.map(f64::from),
            }
        });
        let pose = PoseSample {
            // Zero: the process stamps it with the clock of this machine, as the sensor's clock means nothing to ROS.
            stamp_ns: 0,
            x: f64::from(reading.pose.position.x),
            y: f64::from(reading.pose.position.y),
            yaw: heading,
            position_m: reading.deviation.position_m.map(f64::from),
            heading_rad: reading.deviation.heading_rad.map(f64::from),
            twist,
        };
        publish(2 + index, Outgoing::Pose(pose))
    }

    /// Encodes the packet to a DDS process that publishes a table with the robots' positions \[m\] and velocities
    /// \[m/s\], world frame, one row for each robot in the order of `team`, which should be by robot id. Returns `None`
    /// if the table is too large or a number is not finite.
    pub fn state(&self, team: &[(RobotId, Motion)]) -> Option<Vec<u8>> {
        let row = |(robot, motion): &(RobotId, Motion)| {
            let (at, velocity) = (motion.position, motion.velocity);
            [f32::from(robot.0), at.x, at.y, velocity.x, velocity.y]
        };
        self.rows(0, STATE_COLUMNS, team.iter().flat_map(row).collect())
    }

    /// Encodes the packet to a DDS process that publishes the robots' latents: a table with one row for each robot, its
    /// id and the features of its latent. Shorter rows are filled up with zeros. Returns `None` if `team` is empty, the
    /// table is too large or a number is not finite.
    pub fn latents(&self, team: &[(RobotId, &[f32])]) -> Option<Vec<u8>> {
        let most = team.iter().map(|(_, features)| features.len()).max()?;
        let mut data = Vec::with_capacity(team.len() * (most + 1));
        for (robot, features) in team {
            data.push(f32::from(robot.0));
            data.extend_from_slice(features);
            data.resize(data.len() + most - features.len(), 0.0);
        }
        self.rows(1, u32::try_from(most + 1).ok()?, data)
    }

    /// Encodes the packet to a DDS process that publishes a table of numbers with this number of columns on `topic`, an
    /// index in the plan's list `writers`. Returns `None` if the table is too large or a number is not finite.
    fn rows(&self, topic: usize, columns: u32, data: Vec<f32>) -> Option<Vec<u8>> {
        let fits = data.len() <= MAX_FLOATS && data.iter().all(|value| value.is_finite());
        fits.then(|| publish(topic, Outgoing::Floats(columns, data)))?
    }
}

fn publish(topic: usize, message: Outgoing) -> Option<Vec<u8>> {
    let topic = u16::try_from(topic).ok()?;
    Some(packet::encode(&ToNode::Publish(Publish { topic, message })))
}

#[cfg(test)]
mod tests {
    use murmurate::messages::geometry::Vec2;

    use super::*;

    fn observation() -> Observation {
        let plan = Plan {
            name: "team".to_owned(),
            domain: 0,
            interface: None,
            memory_mib: 192,
            writers: Vec::new(),
            readers: Vec::new(),
        };
        Observation::new("/team", &[RobotId(7), RobotId(2)], plan).unwrap()
    }

    fn published(line: Option<Vec<u8>>) -> Publish {
        match packet::decode_to_node(&line.unwrap()) {
            Ok(ToNode::Publish(publish)) => publish,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn each_robot_has_its_topic_and_the_team_has_two() {
        let topics = observation().plan().writers.iter().map(|writer| writer.topic.clone()).collect::<Vec<_>>();
        assert_eq!(topics, ["/team/state", "/team/latents", "/team/robot_2/odom", "/team/robot_7/odom"]);
        let wrong = Observation::new("team", &[], observation().plan).unwrap_err();
        assert!(wrong.to_string().starts_with("prefix: "));
    }

    #[test]
    fn a_velocity_is_turned_into_the_frame_of_the_robot() {
        let motion = Motion { position: Vec2::new(1.0, 2.0), velocity: Vec2::new(0.0, 0.5) };
        let mut reading = Reading::of_point(RobotId(7), 1, motion);
        let Publish { topic, message: Outgoing::Pose(pose) } = published(observation().pose(&reading)) else {
            panic!()
        };
        assert_eq!((topic, pose.x, pose.y, pose.yaw, pose.twist), (3, 1.0, 2.0, None, None));
        reading.pose.heading = Some(std::f32::consts::FRAC_PI_2);
        let Publish { message: Outgoing::Pose(pose), .. } = published(observation().pose(&reading)) else { panic!() };
        let twist = pose.twist.unwrap();
        assert!((twist.x - 0.5).abs() < 1e-6 && twist.y.abs() < 1e-6, "{twist:?}");
        assert_eq!(observation().pose(&Reading { robot: RobotId(3), ..reading }), None);
    }

    #[test]
    fn arrays_have_a_row_for_each_robot() {
        let motion = Motion { position: Vec2::new(1.0, 2.0), velocity: Vec2::new(3.0, 4.0) };
        let state = published(observation().state(&[(RobotId(2), motion)]));
        assert_eq!(state.message, Outgoing::Floats(5, vec![2.0, 1.0, 2.0, 3.0, 4.0]));
        let latents = published(observation().latents(&[(RobotId(2), &[0.5, 0.25]), (RobotId(7), &[1.0])]));
        assert_eq!(latents, Publish { topic: 1, message: Outgoing::Floats(3, vec![2.0, 0.5, 0.25, 7.0, 1.0, 0.0]) });
        assert_eq!(observation().latents(&[]), None);
        assert_eq!(observation().latents(&[(RobotId(2), &[f32::NAN])]), None);
        assert_eq!(observation().latents(&[(RobotId(2), &[0.0; 600])]), None);
    }
}
