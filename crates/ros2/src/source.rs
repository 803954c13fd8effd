//! Source of poses that ROS 2 nodes publish: a motion capture bridge, a localization by laser, or odometry.
//!
//! Does no I/O: the DDS process and its supervisor are in the module `ros2`. If messages have no velocity, it is
//! computed from the difference of two poses, so the first message gives no reading.

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::edge::sender_clock::{Novelty, SenderClock};
use murmurate::localization::alignment::Alignment;
use murmurate::localization::plausibility::{Fix, Limits, Quality};
use murmurate::localization::{In, Out, Parts, Source, odometry};
use murmurate::messages::geometry::{Pose, Vec2, wrapped};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Reading;
use murmurate::time::Time;
use serde::Deserialize;

use crate::packet::{self, FromNode, Plan, PoseSample, Read, Sample, Subscription, TopicState};
use crate::reading::{self, Velocity};
use crate::settings;
use crate::supervisor::Supervisor;

/// Description of the source `ros2` in one line, for lists of all sources.
pub const ABOUT: &str = "poses from ROS 2: PoseStamped, PoseWithCovarianceStamped or Odometry";

/// Text in the setting `topic` that is replaced by the number of a robot.
const NUMBER: &str = "{robot}";
/// Longest time between two poses from whose difference a velocity is computed \[s\]. Over a longer time the path of a
/// robot at 1 m/s may be too curved.
const LONGEST_S: f64 = 0.5;
/// Shortest time between two poses from whose difference a velocity is computed \[s\]. At this time, noise of 0.2 mm
/// alone gives a velocity of 0.1 m/s.
const SHORTEST_S: f64 = 0.002;

/// Number of older stamps in a row that show a clock that was set back: DDS may let messages overtake each other.
const OVERTAKEN: u32 = 3;

/// Settings of the source `ros2` in the team file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// ROS topic of each robot's poses, in which `{robot}` is replaced by the robot's number.
    #[serde(default = "topic")]
    topic: String,
    /// Type of the messages on the topics.
    #[serde(default, rename = "type")]
    kind: Kind,
    /// DDS domain, `ROS_DOMAIN_ID` of the publisher.
    #[serde(default)]
    domain: u16,
    /// Name or address of the network interface that DDS uses; `None` for all interfaces.
    interface: Option<String>,
    /// Rotation of the messages' frame relative to the world frame \[rad\], counter-clockwise.
    #[serde(default)]
    yaw_rad: f64,
    /// Origin of the messages' frame in the world frame \[m\].
    #[serde(default)]
    origin_m: [f64; 2],
    /// Limit on the memory of each DDS process \[MiB\].
    #[serde(default = "settings::memory_mib")]
    memory_mib: u32,
    /// Whether a second DDS process runs as a spare, which takes over if the first one ends.
    #[serde(default = "settings::yes")]
    spare: bool,
}

fn topic() -> String {
    format!("/r{NUMBER}/pose")
}

/// Type of the ROS messages from which poses are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Kind {
    /// Message type `geometry_msgs/PoseStamped`.
    #[default]
    PoseStamped,
    /// Message type `geometry_msgs/PoseWithCovarianceStamped`.
    PoseWithCovarianceStamped,
    /// Message type `nav_msgs/Odometry`.
    Odometry,
}

/// Makes the source that gets poses from ROS 2 topics, and the worker that runs the DDS process. The error names the
/// wrong setting.
pub fn make(settings: &Settings, robots: &[RobotId]) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    let plan = plan(&config, robots)?;
    let frame = Alignment::new(config.yaw_rad, config.origin_m)?;
    let topics = plan.readers.iter().map(|reader| reader.topic.clone());
    let robots: Vec<(RobotId, String)> = robots.iter().copied().zip(topics).collect();
    let (spare, reckons) = (config.spare, config.kind == Kind::Odometry);
    Ok(Parts {
        source: Box::new(move || Box::new(Poses { reckons, ..Poses::new(frame, &robots) })),
        worker: Box::new(Supervisor { plan, spare, program: None, field: "name" }),
    })
}

/// Checks the settings, and returns the plan of the DDS process: its readers, one topic for each of `robots` in their
/// order, and no writers. An error names the wrong setting.
fn plan(config: &Config, robots: &[RobotId]) -> Result<Plan, ConfigError> {
    settings::check_participant(config.domain, config.interface.as_deref(), config.memory_mib)?;
    if robots.len() > packet::MAX_TOPICS {
        return Err(ConfigError::field("topic", "a source has at most 256 robots; divide them among hosts"));
    }
    if robots.len() > 1 && !config.topic.contains(NUMBER) {
        let reason = format!("it is the same for all {} robots; write {NUMBER} where the number belongs", robots.len());
        return Err(ConfigError::field("topic", reason));
    }
    let kind = match config.kind {
        Kind::PoseStamped => Read::PoseStamped,
        Kind::PoseWithCovarianceStamped => Read::PoseWithCovarianceStamped,
        Kind::Odometry => Read::Odometry,
    };
    let reader = |robot: &RobotId| {
        let topic = settings::full_topic("topic", "", &config.topic.replace(NUMBER, &robot.0.to_string()))?;
        Ok(Subscription { topic, kind })
    };
    Ok(Plan {
        name: format!("source ros2 of {} robots", robots.len()),
        domain: config.domain,
        interface: config.interface.clone(),
        memory_mib: config.memory_mib,
        writers: Vec::new(),
        readers: robots.iter().map(reader).collect::<Result<_, ConfigError>>()?,
    })
}

/// Source of readings from ROS 2: converts pose messages, one topic for each robot, to poses in the world frame and
/// velocities.
struct Poses {
    /// Alignment of the messages' frame.
    frame: Alignment,
    /// Robots in the order of the plan's readers.
    tracks: Vec<Track>,
    /// Whether the poses are dead reckoning: `nav_msgs/Odometry` is in a frame that drifts (REP-105).
    reckons: bool,
}

/// State of the source `ros2` for one robot: stamps of its messages, its last pose, and what was wrong with its topic.
struct Track {
    robot: RobotId,
    topic: String,
    clock: SenderClock,
    /// Number of problems of the topic so far. One that repeats the last one is not counted.
    problems: u64,
    /// Last problem of the topic; `None` before the first.
    problem: Option<String>,
    /// Stamp \[ns\] and pose of the last message from which a velocity can be computed, in the world frame; `None`
    /// before the first.
    last: Option<(u64, PoseSample)>,
    /// The last message as a pose with its arrival; `None` before the first.
    fix: Option<Fix>,
    limits: Limits,
    /// What may be assumed of the newest message.
    quality: Quality,
}

impl Poses {
    /// Makes the source of `robots`, each with its topic, in the order of the plan's readers.
    fn new(frame: Alignment, robots: &[(RobotId, String)]) -> Poses {
        let track = |(robot, topic): &(RobotId, String)| Track {
            robot: *robot,
            topic: topic.clone(),
            clock: SenderClock::new(OVERTAKEN),
            problems: 0,
            problem: None,
            last: None,
            fix: None,
            limits: Limits::default(),
            quality: Quality::MEASURED,
        };
        Poses { frame, tracks: robots.iter().map(track).collect(), reckons: false }
    }

    /// Converts a pose from the messages' frame to the world frame.
    fn aligned(&self, mut pose: PoseSample) -> PoseSample {
        [pose.x, pose.y] = self.frame.position(pose.x, pose.y);
        pose.yaw = pose.yaw.map(|yaw| self.frame.heading(yaw));
        pose
    }

    fn pose(&mut self, now: Time, topic: usize, pose: PoseSample, out: &mut Vec<Out>) {
        let (pose, quality) = (self.aligned(pose), self.quality_of(&pose));
        let Some(track) = self.tracks.get_mut(topic) else {
            return out.push(Out::Refused("its robot is not of this source"));
        };
        let stamp_ns = if pose.stamp_ns == 0 { now.as_nanos() } else { pose.stamp_ns };
        // A pose that is none is no beginning of a velocity either.
        let Some(still) = reading::reading(track.robot, stamp_ns, &pose, Velocity::default()) else {
            return out.push(Out::RefusedOf(track.robot, "a pose has a number out of range"));
        };
        let stamp_ns = match track.clock.take(now, stamp_ns) {
            Novelty::Old => return,
            Novelty::Anew(stamp_ns) => {
                track.last = None;
                stamp_ns
            }
            Novelty::New(stamp_ns) => stamp_ns,
        };
        track.quality = quality;
        let fix = Fix::of(now, &Reading { stamp_ns, ..still }, quality);
        // Between two poses that are no motion there is no velocity, either.
        let before = track.fix.replace(fix).filter(|before| before.reaches(&fix, &track.limits));
        let last = track.last.filter(|_| before.is_some());
        let Some(velocity) = reading::velocity(&pose).or_else(|| difference(last?, (stamp_ns, &pose))) else {
            // A pose too soon after the stored one gives no velocity: the stored one is kept for the next message.
            if last.is_none_or(|(before, _)| seconds(before, stamp_ns) >= SHORTEST_S) {
                track.last = Some((stamp_ns, pose));
            }
            return;
        };
        track.last = Some((stamp_ns, pose));
        out.push(match reading::reading(track.robot, stamp_ns, &pose, velocity) {
            Some(reading) => Out::Reading(reading),
            None => Out::RefusedOf(track.robot, "a velocity is out of range"),
        });
    }

    /// Returns what may be assumed of a message, from its pose in its own frame.
    fn quality_of(&self, pose: &PoseSample) -> Quality {
        let Some(yaw) = pose.yaw.filter(|_| self.reckons) else {
            return if self.reckons { Quality::RECKONED } else { Quality::MEASURED };
        };
        let position = Vec2::new(pose.x as f32, pose.y as f32);
        odometry::quality(&Pose { position, heading: Some(yaw as f32) })
    }

    fn topic(&mut self, state: &TopicState) {
        let Some(track) = self.tracks.iter_mut().find(|track| track.topic == state.topic) else { return };
        let mixed =
            || format!("it has {} publishers, and its poses are a mixture of theirs; end all but one", state.peers);
        let problem = if state.peers > 1 { Some(mixed()) } else { state.problem.clone() };
        let Some(problem) = problem.filter(|problem| track.problem.as_ref() != Some(problem)) else { return };
        track.problems += 1;
        // A hostile sender may change the problem all the time.
        if track.problems < 8 || track.problems.is_power_of_two() {
            tracing::warn!(problems = track.problems, "{}: topic {}: {problem}", track.robot, state.topic);
        }
        track.problem = Some(problem);
    }
}

fn seconds(before: u64, after: u64) -> f64 {
    after.saturating_sub(before) as f64 * 1e-9
}

/// Returns the mean velocity between two poses, each with its stamp \[ns\]; `None` if the time between them is shorter
/// than `SHORTEST_S` or longer than `LONGEST_S`.
fn difference((before, from): (u64, PoseSample), (after, to): (u64, &PoseSample)) -> Option<Velocity> {
    let dt = seconds(before, after);
    (SHORTEST_S..=LONGEST_S).contains(&dt).then(|| Velocity {
        x: (to.x - from.x) / dt,
        y: (to.y - from.y) / dt,
        yaw_rate: to.yaw.zip(from.yaw).map(|(to, from)| wrapped(to - from) / dt),
    })
}

impl Source for Poses {
    fn take(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        let In::Packet(packet) = input else { return };
        match packet::decode_from_node(packet) {
            Ok(FromNode::Received(heard)) => match heard.sample {
                Sample::Pose(pose) => self.pose(now, usize::from(heard.topic), pose, out),
                Sample::Battery(_) | Sample::Scan(_) => out.push(Out::Refused("a source takes poses alone")),
            },
            Ok(FromNode::Topic(state)) => self.topic(&state),
            Ok(FromNode::Beat(_)) => {}
            Err(error) => out.push(Out::Refused(error.reason())),
        }
    }

    fn quality(&self, robot: RobotId) -> Quality {
        let own = self.tracks.iter().find(|track| track.robot == robot);
        own.map_or(Quality::MEASURED, |track| track.quality)
    }

    fn limit(&mut self, robot: RobotId, limits: &Limits) {
        let own = self.tracks.iter_mut().find(|track| track.robot == robot);
        own.into_iter().for_each(|track| track.limits = *limits);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::{ReceivedMessage, TwistSample};
    use murmurate::messages::wire::Reading;
    use murmurate::time::Span;

    fn of(robots: &[u16]) -> Vec<(RobotId, String)> {
        robots.iter().map(|robot| (RobotId(*robot), format!("/r{robot}/pose"))).collect()
    }

    fn config(text: &str) -> Config {
        Settings { name: "ros2".to_owned(), table: text.parse().unwrap() }.read().unwrap()
    }

    fn take(source: &mut Poses, ms: u64, topic: u16, pose: PoseSample) -> Vec<Out> {
        let line = packet::encode(&FromNode::Received(ReceivedMessage { topic, sample: Sample::Pose(pose) }));
        let mut out = Vec::new();
        source.take(Time::ZERO + Span::from_millis(ms), In::Packet(&line), &mut out);
        out
    }

    fn at(ms: u64, x: f64) -> PoseSample {
        PoseSample { stamp_ns: ms * 1_000_000, x, yaw: Some(3.1 + x), ..PoseSample::default() }
    }

    fn reading(out: &[Out]) -> &Reading {
        match out {
            [Out::Reading(reading)] => reading,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn velocity_is_the_difference_where_messages_have_none() {
        let mut source = Poses::new(Alignment::default(), &of(&[4, 7]));
        assert_eq!(take(&mut source, 10, 1, at(10, 0.0)), [], "the first alone has no velocity");
        let out = take(&mut source, 20, 1, at(20, 0.01));
        let told = reading(&out);
        assert_eq!((told.robot, told.stamp_ns), (RobotId(7), 20_000_000));
        assert!((told.twist.velocity.x - 1.0).abs() < 1e-5 && (told.twist.yaw_rate.unwrap() - 1.0).abs() < 1e-5);
        assert_eq!(take(&mut source, 30, 1, at(20, 0.01)), [], "a repeated stamp");
        assert_eq!(take(&mut source, 31, 1, at(21, 0.02)), [], "too close to the one before it");
        assert!((reading(&take(&mut source, 40, 1, at(30, 0.02))).twist.velocity.x - 1.0).abs() < 1e-5);
        assert_eq!(take(&mut source, 900, 1, at(900, 0.02)), [], "after a gap");
        assert_eq!(reading(&take(&mut source, 910, 1, at(910, 0.02))).twist.velocity.x, 0.0);
        assert!(matches!(take(&mut source, 910, 2, at(910, 0.02))[..], [Out::Refused(_)]));
    }

    #[test]
    fn a_heading_that_passes_pi_gives_no_turn_of_its_own() {
        let mut source = Poses::new(Alignment::default(), &of(&[0]));
        take(&mut source, 0, 0, PoseSample { yaw: Some(3.0), ..at(10, 0.0) });
        let out = take(&mut source, 20, 0, PoseSample { yaw: Some(-3.0), ..at(30, 0.0) });
        let rate = reading(&out).twist.yaw_rate.unwrap();
        assert!((rate - 14.159_265).abs() < 1e-3, "{rate}");
    }

    #[test]
    fn poses_and_velocities_are_turned_into_the_world() {
        let frame = Alignment::new(std::f64::consts::FRAC_PI_2, [10.0, 20.0]).unwrap();
        let mut source = Poses::new(frame, &of(&[0]));
        let twist = Some(TwistSample { x: 0.5, y: 0.0, yaw_rate: 0.1, ..TwistSample::default() });
        let pose = PoseSample { stamp_ns: 1, x: 1.0, y: 2.0, yaw: Some(0.0), twist, ..PoseSample::default() };
        let out = take(&mut source, 0, 0, pose);
        let told = reading(&out);
        let off = told.pose.position - murmurate::messages::geometry::Vec2::new(8.0, 21.0);
        assert!(off.norm() < 1e-5, "{told:?}");
        assert!((told.twist.velocity.y - 0.5).abs() < 1e-6 && told.twist.velocity.x.abs() < 1e-6, "{told:?}");
        assert!((told.pose.heading.unwrap() - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
        assert_eq!(told.twist.yaw_rate, Some(0.1));
    }

    #[test]
    fn a_sender_without_stamps_is_timed_by_arrival() {
        let mut source = Poses::new(Alignment::default(), &of(&[0]));
        let pose = |x| PoseSample { stamp_ns: 0, x, ..PoseSample::default() };
        take(&mut source, 100, 0, pose(0.0));
        let out = take(&mut source, 110, 0, pose(0.005));
        assert!((reading(&out).twist.velocity.x - 0.5).abs() < 1e-5);
    }

    #[test]
    fn a_clock_that_is_set_under_the_stamps_costs_a_few_readings_and_no_false_velocity() {
        // 0.5 m/s at 50 Hz; after 1 s the sender's clock is set by so much [ms].
        for step in [-5000i64, -500, -40, 500, 3_600_000] {
            let mut source = Poses::new(Alignment::default(), &of(&[0]));
            let (mut lost, mut longest) = (0, 0);
            for k in 0..150u64 {
                let ms = 20 * k;
                let stamp = (100_000 + ms as i64 + if k >= 50 { step } else { 0 }) as u64;
                let out = take(&mut source, ms, 0, at(stamp, 0.0005 * ms as f64));
                let Some(Out::Reading(reading)) = out.first() else {
                    lost += 1;
                    longest = longest.max(lost);
                    continue;
                };
                lost = 0;
                let speed = reading.twist.velocity.x;
                // The one difference across a clock that is set forward is too small, never too large.
                assert!((speed - 0.5).abs() < 1e-3 || (step == 500 && k == 50 && speed < 0.5), "{step} {k}: {speed}");
            }
            assert!(longest <= 3, "{step}: {longest} in a row");
        }
    }

    #[test]
    fn a_topic_of_two_publishers_is_named_once() {
        let mut source = Poses::new(Alignment::default(), &of(&[4, 7]));
        let state = TopicState { topic: "/r7/pose".to_owned(), written: false, peers: 2, problem: None, refused: 0 };
        (0..3).for_each(|_| source.topic(&state));
        assert_eq!(source.tracks.iter().map(|track| track.problems).collect::<Vec<_>>(), [0, 1]);
        assert!(source.tracks[1].problem.as_deref().unwrap().starts_with("it has 2 publishers"));
    }

    #[test]
    fn topics_are_those_of_the_robots_and_wrong_settings_are_refused() {
        let robots = [RobotId(0), RobotId(12)];
        let topics = plan(&config("type = 'odometry'"), &robots).unwrap().readers;
        assert_eq!((topics[1].topic.as_str(), topics[1].kind), ("/r12/pose", Read::Odometry));
        let refusal = |text: &str| plan(&config(text), &robots).unwrap_err().to_string();
        assert!(refusal("topic = '/pose'").starts_with("topic: it is the same"));
        assert!(refusal("domain = 233").starts_with("domain: "));
    }
}
