//! Sense of a robot whose scans come from ROS 2, as `sensor_msgs/LaserScan`.
//!
//! Does no I/O: the DDS process takes the scans along the rays of the sense, and its supervisor is the worker.

use std::f64::consts::{PI, TAU};

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::messages::ids::RobotId;
use murmurate::observation::{Sweep, Unit};
use murmurate::senses::rays::MAX_RAYS;
use murmurate::senses::{Entry, In, Layout, Out, Parts, Sense};
use murmurate::time::Time;
use serde::Deserialize;

use super::packet::{self, FromNode, Plan, Read, Sample, Subscription, TopicState};
use super::scan::Fan;
use super::settings;
use super::supervisor::Supervisor;

/// Entry of the sense `ros2` in a registry.
pub const ENTRY: Entry = Entry { name: "ros2", about: "scans from ROS 2: LaserScan", example: EXAMPLE, make };

/// Settings of an example.
const EXAMPLE: &str = "topic = \"/r{robot}/scan\"\nrays = 32\nrange_m = 2.0";

/// Text in the setting `topic` that is replaced by the number of the robot.
const NUMBER: &str = "{robot}";

/// Settings of the sense `ros2` in a deployment.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// ROS topic of the robot's scans, in which `{robot}` is replaced by the robot's number.
    #[serde(default = "topic")]
    topic: String,
    /// Number of rays.
    rays: u16,
    /// Distance beyond which an echo counts as none \[m\].
    range_m: f32,
    /// Angle of the first ray \[rad\], counter-clockwise from the direction ahead.
    #[serde(default = "backward")]
    from_rad: f64,
    /// Angle from the first to the last ray \[rad\]. If it is a whole turn, or left out, the rays divide it evenly.
    opening_rad: Option<f64>,
    /// Angle of the scanner's x axis \[rad\], counter-clockwise from the direction ahead.
    #[serde(default)]
    yaw_rad: f64,
    /// Whether the scanner hangs upside down.
    #[serde(default)]
    upside_down: bool,
    /// Place of the scanner on the robot \[m\]: ahead of its centre and to the left.
    #[serde(default)]
    mount_m: [f32; 2],
    /// DDS domain, `ROS_DOMAIN_ID` of the publisher.
    #[serde(default)]
    domain: u16,
    /// Name or address of the network interface that DDS uses; `None` for all interfaces.
    interface: Option<String>,
    /// Limit on the memory of each DDS process \[MiB\].
    #[serde(default = "settings::memory_mib")]
    memory_mib: u32,
    /// Whether a second DDS process runs as a spare, which takes over if the first one ends.
    #[serde(default = "settings::yes")]
    spare: bool,
}

fn topic() -> String {
    format!("/r{NUMBER}/scan")
}

fn backward() -> f64 {
    -PI
}

impl Config {
    /// Checks the ranges of the settings of the rays, and returns their directions. An error names the wrong setting.
    fn sweep(&self) -> Result<Sweep, ConfigError> {
        let opening_rad = self.opening_rad.unwrap_or(TAU);
        // An opening that is rounded up to a whole turn is one.
        let numbers = [
            ("rays", f64::from(self.rays), 1.0, MAX_RAYS as f64),
            ("range_m", self.range_m.into(), 0.01, 1000.0),
            ("from_rad", self.from_rad, -TAU, TAU),
            ("opening_rad", opening_rad, 0.001, TAU + 1e-3),
            ("yaw_rad", self.yaw_rad, -TAU, TAU),
            ("mount_m", self.mount_m[0].into(), -10.0, 10.0),
            ("mount_m", self.mount_m[1].into(), -10.0, 10.0),
        ];
        match numbers.into_iter().find(|(_, value, least, most)| !(least..=most).contains(&value)) {
            Some((field, value, least, most)) => {
                Err(ConfigError::field(field, format!("{value} is not {least} to {most}")))
            }
            None => {
                let directions = (self.from_rad, opening_rad);
                Ok(Sweep { mount_m: self.mount_m, ..Sweep::new(self.rays.into(), directions, self.range_m) })
            }
        }
    }

    /// Checks the settings of the topic and of DDS, and returns the plan of the DDS process: one topic with scans along
    /// the rays `fan`. An error names the wrong setting.
    fn plan(&self, robot: RobotId, fan: Fan) -> Result<Plan, ConfigError> {
        settings::check_participant(self.domain, self.interface.as_deref(), self.memory_mib)?;
        let topic = settings::full_topic("topic", "", &self.topic.replace(NUMBER, &robot.0.to_string()))?;
        Ok(Plan {
            name: format!("sense ros2 of {robot}"),
            domain: self.domain,
            interface: self.interface.clone(),
            memory_mib: self.memory_mib,
            writers: Vec::new(),
            readers: vec![Subscription { topic, kind: Read::LaserScan(fan) }],
        })
    }
}

/// Makes the sense of a robot that gets scans from a ROS 2 topic, and the worker that runs the DDS process. The error
/// names the wrong setting.
fn make(settings: &Settings, robot: RobotId) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    let within = |error: ConfigError| error.within(&settings.name);
    let sweep = config.sweep().map_err(within)?;
    let fan = Fan::new(config.rays, &sweep, config.yaw_rad, config.upside_down);
    let plan = config.plan(robot, fan).map_err(within)?;
    let (rays, spare) = (usize::from(config.rays), config.spare);
    Ok(Parts {
        layout: Layout { shape: vec![rays], unit: Unit::Metre, sweep: Some(sweep) },
        sense: Box::new(move |site| Box::new(Scans::new(site.robot, rays))),
        worker: Some(Box::new(Supervisor { plan, spare, program: None, field: "kind" })),
    })
}

/// Sense of one robot: takes the scans of its DDS process, and logs what is wrong with their topic.
struct Scans {
    robot: RobotId,
    rays: usize,
    /// Last problem of the topic; `None` before the first.
    problem: Option<String>,
    /// Number of problems of the topic so far. One that repeats the last one is not counted.
    problems: u64,
}

impl Scans {
    fn new(robot: RobotId, rays: usize) -> Scans {
        Scans { robot, rays, problem: None, problems: 0 }
    }

    fn topic(&mut self, state: &TopicState) {
        let mixed = || format!("it has {} publishers, whose scans take turns; end all but one", state.peers);
        let problem = if state.peers > 1 { Some(mixed()) } else { state.problem.clone() };
        if problem.is_none() {
            // The next one is new, even if it is that of before.
            self.problem = None;
        }
        let Some(problem) = problem.filter(|problem| self.problem.as_ref() != Some(problem)) else { return };
        self.problems += 1;
        // A hostile sender may change the problem all the time.
        if self.problems < 8 || self.problems.is_power_of_two() {
            let (problems, refused) = (self.problems, state.refused);
            tracing::warn!(problems, refused, "{}: topic {}: {problem}", self.robot, state.topic);
        }
        self.problem = Some(problem);
    }
}

impl Sense for Scans {
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(packet) = input else { return };
        match packet::decode_from_node(packet) {
            Ok(FromNode::Received(heard)) => match heard.sample {
                Sample::Scan(scan) if scan.ranges_m.len() == self.rays => {
                    let stamp_ns = if scan.stamp_ns == 0 { now.as_nanos() } else { scan.stamp_ns };
                    let values = scan.ranges_m.into_iter().map(|range| range.unwrap_or(f32::INFINITY)).collect();
                    out.push(Out::Values { stamp_ns, values });
                }
                Sample::Scan(_) => out.push(Out::Refused("a scan has other rays than the sense")),
                Sample::Pose(_) | Sample::Battery(_) => out.push(Out::Refused("a sense takes scans alone")),
            },
            Ok(FromNode::Topic(state)) => self.topic(&state),
            Ok(FromNode::Beat(_)) => {}
            Err(error) => out.push(Out::Refused(error.reason())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::ReceivedMessage;
    use crate::scan::ScanSample;

    fn settings(text: &str) -> Settings {
        Settings { name: "eyes".to_owned(), table: text.parse().expect("it is TOML") }
    }

    fn parts(text: &str) -> Result<Parts, ConfigError> {
        make(&settings(text), RobotId(7))
    }

    fn taken(sense: &mut Scans, packet: &FromNode) -> Vec<Out> {
        let mut out = Vec::new();
        sense.take(Time::from_nanos(9), In::Packet(&packet::encode(packet)), &mut out);
        out
    }

    #[test]
    fn it_keeps_the_contract_of_senses() {
        murmurate::senses::contract::check(&ENTRY).expect("it keeps the contract");
    }

    #[test]
    fn scans_are_values_and_other_packets_are_refused() {
        let mut sense = Scans::new(RobotId(7), 2);
        let heard = |sample| FromNode::Received(ReceivedMessage { topic: 0, sample });
        let scan = |stamp_ns, ranges_m: &[Option<f32>]| {
            heard(Sample::Scan(ScanSample { stamp_ns, ranges_m: ranges_m.to_vec() }))
        };
        let values = vec![1.5, f32::INFINITY];
        let of_sensor = Out::Values { stamp_ns: 5, values: values.clone() };
        assert_eq!(taken(&mut sense, &scan(5, &[Some(1.5), None])), [of_sensor]);
        let unstamped = Out::Values { stamp_ns: 9, values };
        assert_eq!(taken(&mut sense, &scan(0, &[Some(1.5), None])), [unstamped], "it is stamped when it arrives");
        for wrong in [scan(5, &[None]), heard(Sample::Battery(None)), heard(Sample::Pose(Default::default()))] {
            assert!(matches!(taken(&mut sense, &wrong)[..], [Out::Refused(_)]), "{wrong:?}");
        }
    }

    #[test]
    fn a_topic_with_something_wrong_is_named_once() {
        let mut sense = Scans::new(RobotId(7), 2);
        let state = |peers, refused| {
            let problem = Some("a message: its angle_increment is 0; correct its sender".to_owned());
            FromNode::Topic(TopicState { topic: "/r7/scan".to_owned(), written: false, peers, problem, refused })
        };
        (1..9).for_each(|refused| assert_eq!(taken(&mut sense, &state(1, refused)), []));
        assert_eq!(sense.problems, 1, "however many are refused");
        taken(&mut sense, &state(2, 9));
        assert!(sense.problem.as_deref().is_some_and(|problem| problem.starts_with("it has 2 publishers")));
    }

    #[test]
    fn the_topic_is_that_of_the_robot_and_wrong_settings_are_refused_by_their_names() {
        let config: Config = settings("rays = 8\nrange_m = 3.5\nyaw_rad = 0.5").read().expect("it is valid");
        let fan = Fan::new(8, &config.sweep().expect("it is valid"), 0.5, false);
        let plan = config.plan(RobotId(7), fan).expect("it is valid");
        assert_eq!(plan.readers, [Subscription { topic: "/r7/scan".to_owned(), kind: Read::LaserScan(fan) }]);
        let layout = parts("rays = 8\nrange_m = 3.5\nmount_m = [0.1, 0.0]").expect("it is valid").layout;
        let sweep = Sweep { mount_m: [0.1, 0.0], ..Sweep::new(8, (-PI, TAU), 3.5) };
        assert_eq!((layout.floats(), layout.sweep), (8, Some(sweep)));
        for (text, field) in [
            ("rays = 0\nrange_m = 1.0", "eyes.rays"),
            ("rays = 257\nrange_m = 1.0", "eyes.rays"),
            ("rays = 8\nrange_m = nan", "eyes.range_m"),
            ("rays = 8\nrange_m = 1.0\nfrom_rad = 7.0", "eyes.from_rad"),
            ("rays = 8\nrange_m = 1.0\nopening_rad = 7.0", "eyes.opening_rad"),
            ("rays = 8\nrange_m = 1.0\nyaw_rad = inf", "eyes.yaw_rad"),
            ("rays = 8\nrange_m = 1.0\nmount_m = [0.0, 11.0]", "eyes.mount_m"),
            ("rays = 8\nrange_m = 1.0\ntopic = 'r1 /scan'", "eyes.topic"),
            ("rays = 8\nrange_m = 1.0\ndomain = 233", "eyes.domain"),
            ("rays = 8", "eyes: missing field `range_m`"),
        ] {
            let error = parts(text).err().expect("it is refused").to_string();
            assert!(error.starts_with(field), "{text}: {error}");
        }
    }
}
