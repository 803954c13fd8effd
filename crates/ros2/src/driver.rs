//! Driver of ROS 2 robots that receive `geometry_msgs/Twist` or `TwistStamped` and report `nav_msgs/Odometry`.
//!
//! The driver does no I/O: the DDS process and its supervisor are in `ros2`. Silence of the odometry is a fault, and
//! the robot is told to stand. Zeros are repeated at full rate until the odometry says that the robot stands, then five
//! times a second.

use murmurate::config::ConfigError;
use murmurate::edge::Settings;
use murmurate::edge::sender_clock::{Novelty, SenderClock};
use murmurate::messages::geometry::{Planar, Vec2, limit_below};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::{Hardware, Health, MAX_VALIDITY, Reason};
use murmurate::time::{Span, Time};
use serde::Deserialize;

use crate::packet::{
    self, Drive, FromNode, Plan, PoseSample, Publication, Read, Sample, Subscription, ToNode, Written,
};
use crate::reading::{self, Axes};
use crate::settings;
use crate::supervisor::Supervisor;
use crate::topics::Topics;
use murmurate::drivers::{Command, Driver, Limits, Out, Parts};
use murmurate::messages::local::BodyTwist;

/// Description of the driver in one line, for lists of all drivers.
pub const ABOUT: &str = "a ROS 2 robot: Twist or TwistStamped out, Odometry in";

/// Periods at which zero velocities are sent: first until the robot stands, then while it stands.
const ZEROS: [Span; 2] = [Span::from_millis(20), Span::from_millis(200)];
/// Time for which a robot without odometry gets zero velocities at the short period: longer than the watchdogs of known
/// bases, 0.5 s.
const BLIND: Span = Span::from_millis(1000);
/// Time without odometry since the start after which a warning is logged. DDS discovery takes 1.3 s, at worst 5.7 s.
const DISCOVERY: Span = Span::from_millis(6000);
/// Reason and warning before the first odometry. It fits into a [`Reason`] whole.
const UNHEARD: &str = "no odometry is heard: see namespace, odom, interface and its ROS_DOMAIN_ID";
/// Validity of a zero velocity that is sent \[ms\], longer than the longest period of zero velocities.
const ZERO_FOR_MS: u32 = 300;
/// Number of older stamps in a row that show a clock that was set back: DDS may let messages overtake each other.
const OVERTAKEN: u32 = 3;
/// Largest speed \[m/s\] and yaw rate \[rad/s\] at which a robot counts as standing. The noise of wheel encoders is
/// below a tenth of it.
const STANDS: (f64, f64) = (0.01, 0.02);

/// Form of the stamp in commands of type `TwistStamped`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum StampForm {
    /// The stamp is zero, which ros2_control takes for "now": clocks need not agree.
    #[default]
    Zero,
    /// The stamp is the time of this machine's clock.
    Now,
}

/// Settings of the ROS 2 driver in the team file.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Config {
    /// Namespace of the robot, such as `/r1`; empty for none.
    namespace: String,
    /// DDS domain, `ROS_DOMAIN_ID` of the robot.
    #[serde(default)]
    domain: u16,
    /// Name or address of the network interface for multicast and announced addresses; all interfaces if left out. The
    /// data ports accept datagrams from every interface, so this setting does not restrict access.
    interface: Option<String>,
    /// Whether commands have the type `TwistStamped` instead of `Twist`.
    #[serde(default)]
    stamped: bool,
    /// Form of the stamp in commands, if `stamped` is true.
    #[serde(default)]
    stamp: StampForm,
    /// Convention of the axes in commands and odometry.
    #[serde(default)]
    axes: Axes,
    /// Topic to which velocity commands are published.
    #[serde(default = "cmd_vel")]
    cmd_vel: String,
    /// Topic of `nav_msgs/Odometry`; empty for a robot without odometry.
    #[serde(default = "odom")]
    odom: String,
    /// Topic of `sensor_msgs/BatteryState`; left out for a robot without it.
    battery: Option<String>,
    /// Time without odometry after which the robot is stopped and reported as faulty \[s\].
    #[serde(default = "silence_s")]
    silence_s: f64,
    /// Largest speed of the robot's commands \[m/s\].
    speed_m_s: f32,
    /// Largest yaw rate of the robot's commands \[rad/s\].
    #[serde(default = "yaw_rate_rad_s")]
    yaw_rate_rad_s: f32,
    /// Limit on the memory of each DDS process \[MiB\].
    #[serde(default = "settings::memory_mib")]
    memory_mib: u32,
    /// Whether a second DDS process runs as a spare, to take over if the first one ends.
    #[serde(default = "settings::yes")]
    spare: bool,
}

fn cmd_vel() -> String {
    "cmd_vel".to_owned()
}

fn odom() -> String {
    "odom".to_owned()
}

/// Returns the default of the setting `silence_s` \[s\]: the time of three odometry messages at 10 Hz.
fn silence_s() -> f64 {
    0.3
}

/// Returns the default of the setting `yaw_rate_rad_s` \[rad/s\]. It is below the limits of small differential drives:
/// 1.82 rad/s on a TurtleBot3 Waffle Pi, 1.9 on a Create 3.
fn yaw_rate_rad_s() -> f32 {
    1.5
}

/// Makes the ROS 2 driver of `robot` and its worker; an error names the wrong setting.
pub fn make(settings: &Settings, robot: RobotId) -> Result<Parts, ConfigError> {
    let config: Config = settings.read()?;
    let plan = plan(&config, robot)?;
    let (spare, checked) = (config.spare, config.clone());
    Ok(Parts {
        driver: Box::new(move || Box::new(Ros2::new(robot, &checked))),
        worker: Some(Box::new(Supervisor { plan, spare, program: None, field: "name" })),
    })
}

/// Checks the settings and returns the plan of the DDS process: domain, interface, and the topics that it writes and
/// reads.
fn plan(config: &Config, robot: RobotId) -> Result<Plan, ConfigError> {
    settings::check_participant(config.domain, config.interface.as_deref(), config.memory_mib)?;
    settings::check_namespace(&config.namespace)?;
    for (field, value) in [("speed_m_s", config.speed_m_s), ("yaw_rate_rad_s", config.yaw_rate_rad_s)] {
        if !(value > 0.0 && value.is_finite()) {
            let reason = format!("{value} is not above zero; take it from the data sheet of the robot");
            return Err(ConfigError::field(field, reason));
        }
    }
    if !(0.05..=5.0).contains(&config.silence_s) {
        let reason = format!("{} is not from 0.05 to 5 s; take three periods of the odometry", config.silence_s);
        return Err(ConfigError::field("silence_s", reason));
    }
    let kind = match (config.stamped, config.stamp) {
        (false, _) => Written::Twist,
        (true, StampForm::Zero) => Written::TwistUnstamped,
        (true, StampForm::Now) => Written::TwistStamped,
    };
    let full = |field, topic: &str| settings::full_topic(field, &config.namespace, topic);
    let writers = vec![Publication { topic: full("cmd_vel", &config.cmd_vel)?, kind }];
    let mut readers = Vec::new();
    if !config.odom.is_empty() {
        readers.push(Subscription { topic: full("odom", &config.odom)?, kind: Read::Odometry });
    }
    if let Some(battery) = &config.battery {
        readers.push(Subscription { topic: full("battery", battery)?, kind: Read::Battery });
    }
    let (domain, interface, memory_mib) = (config.domain, config.interface.clone(), config.memory_mib);
    Ok(Plan { name: robot.to_string(), domain, interface, memory_mib, writers, readers })
}

/// Part without I/O of the ROS 2 driver of one robot: turns commands into velocities for the DDS process, and watches
/// the robot's odometry.
struct Ros2 {
    robot: RobotId,
    limits: Limits,
    yaw_rate_rad_s: f32,
    axes: Axes,
    /// Time without odometry after which the robot is stopped and reported as faulty; `None` for a robot without
    /// odometry.
    silence: Option<Span>,
    /// Arrival time of the last new odometry message; `None` before the first.
    heard: Option<Time>,
    /// Whether the robot was stopped because its odometry is missing, and none has arrived since.
    silent: bool,
    clock: SenderClock,
    /// Reason why the newest odometry message could not be used, with its topic; `None` if it could.
    unusable: Option<String>,
    /// Whether the odometry has shown that the robot stands, since the driver began to send zero velocities.
    stood: bool,
    /// Time since which zero velocities are sent, and time of the next one. `None` while the robot moves and before the
    /// first command.
    standing: Option<(Time, Time)>,
    /// Arrival time of the first packet of the DDS process, from which the wait for odometry counts; `None` after the
    /// first odometry or the warning that none arrives.
    waits: Option<Time>,
    topics: Topics,
    battery: Option<u8>,
    /// Last reported condition of the hardware.
    told: Option<Hardware>,
}

impl Ros2 {
    fn new(robot: RobotId, config: &Config) -> Ros2 {
        // A robot without odometry has no such topic.
        let odom = settings::full_topic("odom", &config.namespace, &config.odom).unwrap_or_default();
        Ros2 {
            robot,
            limits: Limits { speed_m_s: limit_below(config.speed_m_s) },
            yaw_rate_rad_s: limit_below(config.yaw_rate_rad_s),
            axes: config.axes,
            silence: (!config.odom.is_empty()).then(|| Span::from_secs(config.silence_s)),
            heard: None,
            silent: false,
            clock: SenderClock::new(OVERTAKEN),
            unusable: None,
            stood: false,
            standing: None,
            waits: None,
            topics: Topics::new(robot, odom),
            battery: None,
            told: None,
        }
    }

    /// Whether the robot's odometry has been missing for too long.
    fn is_silent(&self, now: Time) -> bool {
        self.silence.is_some_and(|most| self.heard.is_none_or(|heard| now.since(heard) >= most))
    }

    fn health(&self, now: Time) -> (Health, Option<Reason>) {
        let reason = |text: &str| Reason::new(text);
        if let Some(problem) = self.topics.unmatched().or_else(|| self.topics.twins()) {
            return (Health::Faulty, reason(&problem));
        }
        // Odometry that arrives and cannot be used is no silence of the network.
        let unusable = self.unusable.clone().or_else(|| self.topics.problem_of_odometry());
        match (self.silence, self.heard) {
            (Some(_), _) if self.is_silent(now) && unusable.is_some() => {
                (Health::Faulty, unusable.as_deref().and_then(Reason::new))
            }
            (Some(_), None) => (Health::Silent, reason(UNHEARD)),
            (Some(_), Some(_)) if self.is_silent(now) => (Health::Faulty, reason("its odometry is silent")),
            _ if self.topics.is_obeyed() => (Health::Ready, None),
            // The robot reports odometry, but nothing subscribes to its commands yet.
            _ => (Health::Silent, reason("no subscriber of its commands")),
        }
    }

    /// Reports the condition of the hardware if it has changed.
    fn report(&mut self, now: Time, out: &mut Vec<Out>) {
        let (health, reason) = self.health(now);
        let hardware = Hardware { health, battery: self.battery, temperature: None, reason };
        if self.told.as_ref() != Some(&hardware) {
            self.told = Some(hardware.clone());
            out.push(Out::Condition(hardware));
        }
    }

    fn send(&self, twist: BodyTwist, for_ms: u32, out: &mut Vec<Out>) {
        let sign = self.axes.sign();
        let [x, left, yaw] = [twist.forward, twist.left, twist.yaw_rate].map(f64::from);
        // Plus zero, since minus zero is odd to read in a log of the robot.
        let drive = Drive { topic: 0, x, y: sign * left + 0.0, yaw: sign * yaw + 0.0, for_ms };
        out.push(Out::Send(packet::encode(&ToNode::Drive(drive)).into()));
    }

    /// Stops the robot: sends a zero velocity if one is due, and schedules the next.
    fn halt(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.standing.is_none() {
            self.stood = false;
        }
        let (since, next) = self.standing.unwrap_or((now, now));
        if now < next {
            return;
        }
        let calm = self.stood || (self.silence.is_none() && now.since(since) >= BLIND);
        let period = if calm { ZEROS[1] } else { ZEROS[0] };
        self.standing = Some((since, now + period));
        self.send(BodyTwist { forward: 0.0, left: 0.0, yaw_rate: 0.0 }, ZERO_FOR_MS, out);
    }

    /// Returns `body` reduced to the robot's limits of speed and yaw rate; `None` if it is zero or not finite.
    fn within_limits(&self, body: BodyTwist) -> Option<BodyTwist> {
        let linear = Vec2::new(body.forward, body.left).capped(self.limits.speed_m_s);
        let yaw_rate = body.yaw_rate.clamp(-self.yaw_rate_rad_s, self.yaw_rate_rad_s);
        let numbers = [linear.x, linear.y, yaw_rate];
        let moves = numbers.iter().all(|v| v.is_finite()) && numbers.iter().any(|v| *v != 0.0);
        moves.then_some(BodyTwist { forward: linear.x, left: linear.y, yaw_rate })
    }

    fn odometry(&mut self, now: Time, pose: PoseSample, out: &mut Vec<Out>) {
        // A sender without stamps has zeros: then each message is new, at its arrival.
        let stamp_ns = if pose.stamp_ns == 0 { now.as_nanos() } else { pose.stamp_ns };
        let (Novelty::New(stamp_ns) | Novelty::Anew(stamp_ns)) = self.clock.take(now, stamp_ns) else { return };
        let pose = reading::in_rep103(self.axes, pose);
        let reading = match reading::velocity(&pose) {
            None => Err("its orientation is all zero; correct its sender"),
            Some(velocity) => reading::reading(self.robot, stamp_ns, &pose, velocity)
                .ok_or("a number of it is out of range; correct its sender"),
        };
        let reading = match reading {
            Ok(reading) => reading,
            Err(why) => {
                self.unusable = Some(format!("{}: {why}", self.topics.odom()));
                return out.push(Out::Refused(why));
            }
        };
        self.unusable = None;
        if std::mem::take(&mut self.silent) {
            tracing::info!("{}: its odometry is heard again", self.robot);
        }
        (self.heard, self.waits) = (Some(now), None);
        let slow = pose.twist.is_some_and(|v| libm::hypot(v.x, v.y) < STANDS.0 && v.yaw_rate.abs() < STANDS.1);
        if self.standing.is_some() {
            self.stood |= slow;
        }
        out.push(Out::Odometry(reading));
    }
}

impl Driver for Ros2 {
    fn limits(&self) -> Limits {
        self.limits
    }

    fn drive(&mut self, now: Time, command: &Command, out: &mut Vec<Out>) {
        let left = command.drive.until.since(now).as_nanos().min(MAX_VALIDITY.as_nanos()) / 1_000_000;
        let for_ms = u32::try_from(left).unwrap_or(0);
        match command.body.and_then(|body| self.within_limits(body)) {
            Some(body) if for_ms > 0 && !self.is_silent(now) && self.topics.twins().is_none() => {
                self.standing = None;
                self.send(body, for_ms, out);
            }
            _ => self.halt(now, out),
        }
    }

    fn receive(&mut self, now: Time, packet: &[u8], out: &mut Vec<Out>) {
        if self.told.is_none() && self.silence.is_some() {
            self.waits = Some(now);
        }
        match packet::decode_from_node(packet) {
            Ok(FromNode::Received(heard)) => match heard.sample {
                Sample::Pose(pose) => self.odometry(now, pose, out),
                Sample::Battery(charge) => self.battery = charge.map(|charge| (charge * 100.0).round() as u8),
                Sample::Scan(_) => out.push(Out::Refused("a driver takes no scans")),
            },
            Ok(FromNode::Topic(state)) => self.topics.take(state),
            Ok(FromNode::Beat(_)) => {}
            Err(error) => out.push(Out::Refused(error.reason())),
        }
        self.report(now, out);
    }

    fn wake_at(&self) -> Option<Time> {
        let zero = self.standing.map(|(_, next)| next);
        let silent = self.heard.zip(self.silence).filter(|_| !self.silent);
        let waits = self.waits.map(|since| since + DISCOVERY);
        zero.into_iter().chain(silent.map(|(heard, most)| heard + most)).chain(waits).min()
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        if self.waits.is_some_and(|since| now >= since + DISCOVERY) {
            self.waits = None;
            let robot = self.robot;
            if self.unusable.is_none() && self.topics.problem_of_odometry().is_none() {
                tracing::warn!("{robot}: {UNHEARD}");
            }
        }
        if !self.silent && self.heard.is_some() && self.is_silent(now) {
            self.silent = true;
            tracing::warn!("{}: its odometry is silent, and it is told to stand; see the robot's base", self.robot);
            self.halt(now, out);
        } else if self.standing.is_some() {
            self.halt(now, out);
        }
        self.report(now, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::{ReceivedMessage, TopicState, TwistSample};

    fn config(text: &str) -> Config {
        let text = format!("namespace = '/r1'\nspeed_m_s = 0.5\n{text}");
        Settings { name: "ros2".to_owned(), table: text.parse().unwrap() }.read().unwrap()
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    /// Driver with a robot that answers at given times.
    struct Bench {
        driver: Ros2,
        out: Vec<Out>,
    }

    impl Bench {
        fn new(text: &str) -> Bench {
            let mut bench = Bench { driver: Ros2::new(RobotId(1), &config(text)), out: vec![] };
            bench.topic(0, "/r1/cmd_vel", 1, None);
            bench
        }

        fn topic(&mut self, ms: u64, topic: &str, peers: u32, problem: Option<&str>) {
            let (topic, problem) = (topic.to_owned(), problem.map(str::to_owned));
            let state = FromNode::Topic(TopicState { topic, written: true, peers, problem, refused: 0 });
            self.driver.receive(at_ms(ms), &packet::encode(&state), &mut self.out);
        }

        fn odometry(&mut self, ms: u64, x: f64) {
            let twist = Some(TwistSample { x, ..TwistSample::default() });
            let pose = PoseSample { stamp_ns: ms + 1, yaw: Some(0.0), twist, ..PoseSample::default() };
            let heard = FromNode::Received(ReceivedMessage { topic: 0, sample: Sample::Pose(pose) });
            self.driver.receive(at_ms(ms), &packet::encode(&heard), &mut self.out);
        }

        fn drive(&mut self, ms: u64, body: Option<[f32; 3]>) {
            use murmurate::messages::local::Drive;
            let until = at_ms(ms + 200);
            let drive = Drive { robot: RobotId(1), velocity: Vec2::zeros(), until };
            let body = body.map(|[forward, left, yaw_rate]| BodyTwist { forward, left, yaw_rate });
            self.driver.drive(at_ms(ms), &Command { drive, body }, &mut self.out);
        }

        /// Commands since the last call.
        fn sent(&mut self) -> Vec<Drive> {
            let drive = |out| match out {
                Out::Send(packet) => match packet::decode_to_node(&packet) {
                    Ok(ToNode::Drive(drive)) => Some(drive),
                    other => panic!("{other:?}"),
                },
                _ => None,
            };
            self.out.drain(..).filter_map(drive).collect()
        }

        fn condition(&mut self) -> Option<(Health, Option<u8>)> {
            let condition = |out| match out {
                Out::Condition(Hardware { health, battery, .. }) => Some((health, battery)),
                _ => None,
            };
            self.out.drain(..).filter_map(condition).next_back()
        }
    }

    #[test]
    fn a_command_keeps_to_the_limits_and_to_the_axes_of_the_robot() {
        for (axes, sign) in [("rep103", 1.0), ("ned", -1.0)] {
            let mut bench = Bench::new(&format!("axes = '{axes}'"));
            bench.odometry(0, 0.0);
            bench.sent();
            bench.drive(10, Some([3.0, 4.0, 9.0]));
            let sent = bench.sent()[0];
            assert!((sent.x - 0.3).abs() < 1e-6 && (sent.y - sign * 0.4).abs() < 1e-6, "{sent:?}");
            assert_eq!((sent.yaw, sent.for_ms), (sign * 1.5, 200));
            bench.drive(20, Some([f32::NAN, 0.0, 0.0]));
            assert_eq!(bench.sent()[0].x, 0.0);
        }
    }

    #[test]
    fn zeros_are_fast_until_odometry_says_that_the_robot_stands() {
        let mut bench = Bench::new("");
        bench.odometry(0, 0.4);
        bench.drive(0, Some([0.4, 0.0, 0.0]));
        bench.sent();
        assert_eq!(bench.driver.wake_at(), Some(at_ms(300)), "it moves: the odometry alone is awaited");
        bench.drive(100, None);
        let mut times = Vec::new();
        for ms in 100..1200 {
            match ms {
                200 | 300 => bench.odometry(ms, 0.3),
                400 | 600 | 800 | 1000 => bench.odometry(ms, 0.001),
                _ => {}
            }
            if bench.driver.wake_at().is_some_and(|at| at <= at_ms(ms)) {
                bench.driver.wake(at_ms(ms), &mut bench.out);
            }
            for zero in bench.sent() {
                assert_eq!((zero.x, zero.y, zero.yaw, zero.for_ms), (0.0, 0.0, 0.0, 300));
                times.push(ms);
            }
        }
        assert_eq!(times[..4], [100, 120, 140, 160]);
        assert_eq!(times[15..], [400, 600, 800, 1000]);
    }

    #[test]
    fn silent_odometry_is_a_fault_and_the_robot_stands_until_it_is_back() {
        let mut bench = Bench::new("");
        assert_eq!(bench.condition(), Some((Health::Silent, None)));
        assert!(!Reason::new(UNHEARD).unwrap().is_cut());
        bench.drive(0, Some([0.2, 0.0, 0.0]));
        assert_eq!(bench.sent()[0].x, 0.0, "nothing is known of the robot");
        bench.odometry(100, 0.0);
        assert_eq!(bench.condition(), Some((Health::Ready, None)));
        bench.drive(110, Some([0.2, 0.0, 0.0]));
        assert!(bench.sent()[0].x > 0.0);
        let before = at_ms(100);
        assert_eq!(bench.driver.wake_at(), Some(before + Span::from_millis(300)));
        bench.driver.wake(at_ms(400), &mut bench.out);
        let silent = Hardware::of(Health::Faulty).because("its odometry is silent");
        assert!(bench.out.contains(&Out::Condition(silent)));
        assert_eq!(bench.sent()[0].x, 0.0);
        bench.drive(410, Some([0.2, 0.0, 0.0]));
        assert!(bench.sent().iter().all(|zero| zero.x == 0.0));
        bench.odometry(500, 0.0);
        bench.drive(510, Some([0.2, 0.0, 0.0]));
        assert!(bench.sent()[0].x > 0.0);
    }

    #[test]
    fn odometry_that_cannot_be_used_is_named_and_is_no_fault_of_the_network() {
        let reason = |bench: &mut Bench| {
            let mut all = bench.out.drain(..).filter_map(|out| match out {
                Out::Condition(Hardware { health, reason, .. }) => Some((health, reason?.text().to_owned())),
                _ => None,
            });
            all.next_back()
        };
        let mut bench = Bench::new("");
        let zero = |ms: u64| {
            let pose = PoseSample { stamp_ns: ms + 1, twist: Some(TwistSample::default()), ..PoseSample::default() };
            packet::encode(&FromNode::Received(ReceivedMessage { topic: 0, sample: Sample::Pose(pose) }))
        };
        bench.driver.receive(at_ms(20), &zero(20), &mut bench.out);
        let why = "/r1/odom: its orientation is all zero; correct its sender".to_owned();
        assert_eq!(reason(&mut bench), Some((Health::Faulty, why.clone())));
        bench.odometry(40, 0.0);
        assert_eq!(bench.condition(), Some((Health::Ready, None)), "the next message is a good one");
        for ms in (60..600).step_by(20) {
            bench.driver.receive(at_ms(ms), &zero(ms), &mut bench.out);
        }
        assert_eq!(reason(&mut bench), Some((Health::Faulty, why)));
        // What the DDS process cannot read, it reports as a problem of the topic.
        let mut bench = Bench::new("");
        let state = TopicState {
            topic: "/r1/odom".to_owned(),
            written: false,
            peers: 1,
            problem: Some("a message: its position is not finite; see whether the sender is localized".to_owned()),
            refused: 1,
        };
        bench.driver.receive(at_ms(20), &packet::encode(&FromNode::Topic(state)), &mut bench.out);
        let (health, why) = reason(&mut bench).unwrap();
        assert!(health == Health::Faulty && why.starts_with("/r1/odom: a message: its position is not"), "{why}");
    }

    #[test]
    fn two_robots_in_one_namespace_are_not_driven() {
        let mut bench = Bench::new("");
        bench.odometry(0, 0.0);
        assert_eq!(bench.condition(), Some((Health::Ready, None)));
        let state = TopicState { topic: "/r1/odom".to_owned(), written: false, peers: 2, problem: None, refused: 0 };
        bench.driver.receive(at_ms(10), &packet::encode(&FromNode::Topic(state)), &mut bench.out);
        assert_eq!(bench.condition(), None, "a second publisher alone may be a base that was started again");
        bench.topic(20, "/r1/cmd_vel", 2, None);
        assert_eq!(bench.condition(), Some((Health::Faulty, None)));
        bench.drive(30, Some([0.2, 0.0, 0.0]));
        assert!(bench.sent().iter().all(|sent| sent.x == 0.0));
        bench.topic(40, "/r1/cmd_vel", 1, None);
        assert_eq!(bench.condition(), Some((Health::Ready, None)), "one was ended");
    }

    #[test]
    fn it_never_asks_to_be_woken_in_the_past() {
        for odom in ["", "odom = ''"] {
            let mut bench = Bench::new(odom);
            bench.topic(0, "/r1/cmd_vel", 0, None);
            for ms in 0..20_000 {
                match ms {
                    100 | 200 | 9000 => bench.odometry(ms, 0.2),
                    300 | 5000 => bench.drive(ms, None),
                    9010 => bench.drive(ms, Some([0.1, 0.0, 0.0])),
                    9100 => bench.topic(ms, "/r1/cmd_vel", 1, None),
                    _ => {}
                }
                if bench.driver.wake_at().is_some_and(|at| at <= at_ms(ms)) {
                    bench.driver.wake(at_ms(ms), &mut bench.out);
                }
                assert!(bench.driver.wake_at().is_none_or(|at| at > at_ms(ms)), "{ms}");
            }
        }
    }

    #[test]
    fn a_repeated_stamp_is_no_sign_of_life() {
        let mut bench = Bench::new("");
        bench.odometry(0, 0.0);
        let readings = |bench: &Bench| bench.out.iter().filter(|out| matches!(out, Out::Odometry(_))).count();
        assert_eq!(readings(&bench), 1);
        let again = bench.driver.heard;
        let pose =
            PoseSample { stamp_ns: 1, yaw: Some(0.0), twist: Some(TwistSample::default()), ..Default::default() };
        let heard = FromNode::Received(ReceivedMessage { topic: 0, sample: Sample::Pose(pose) });
        bench.driver.receive(at_ms(200), &packet::encode(&heard), &mut bench.out);
        assert_eq!((readings(&bench), bench.driver.heard), (1, again));
    }

    #[test]
    fn topics_without_a_match_and_batteries_are_part_of_the_condition() {
        let mut bench = Bench::new("battery = 'battery_state'");
        bench.odometry(0, 0.0);
        assert_eq!(bench.condition(), Some((Health::Ready, None)));
        bench.topic(10, "/r1/cmd_vel", 0, Some("QoS policy Durability"));
        assert_eq!(bench.condition(), Some((Health::Faulty, None)));
        bench.topic(20, "/r1/cmd_vel", 1, Some("QoS policy Durability"));
        assert_eq!(bench.condition(), Some((Health::Ready, None)), "an observer is refused, the robot is not");
        let heard = FromNode::Received(ReceivedMessage { topic: 1, sample: Sample::Battery(Some(0.875)) });
        bench.driver.receive(at_ms(30), &packet::encode(&heard), &mut bench.out);
        assert_eq!(bench.condition(), Some((Health::Ready, Some(88))));
        bench.driver.receive(at_ms(40), b"{}", &mut bench.out);
        assert!(matches!(bench.out[..], [Out::Refused(_)]));
    }

    #[test]
    fn a_robot_without_odometry_gets_fast_zeros_for_a_second() {
        let mut bench = Bench::new("odom = ''");
        assert_eq!(bench.condition(), Some((Health::Ready, None)));
        bench.drive(0, None);
        let zeros = (0..2000).filter(|ms| {
            bench.driver.wake(at_ms(*ms), &mut bench.out);
            !bench.sent().is_empty()
        });
        assert_eq!(zeros.count(), 51 + 4);
    }

    #[test]
    fn wrong_settings_are_refused_by_name() {
        let refusal = |text: &str| plan(&config(text), RobotId(1)).unwrap_err().to_string();
        assert!(refusal("domain = 300").starts_with("domain: "));
        assert!(refusal("yaw_rate_rad_s = 0.0").starts_with("yaw_rate_rad_s: "));
        assert!(refusal("silence_s = 9.0").starts_with("silence_s: "));
        assert!(refusal("odom = 'my odom'").starts_with("odom: "));
        let plan = plan(&config("stamped = true\nbattery = '/bat'"), RobotId(1)).unwrap();
        assert_eq!((plan.writers[0].topic.as_str(), plan.writers[0].kind), ("/r1/cmd_vel", Written::TwistUnstamped));
        let readers: Vec<&str> = plan.readers.iter().map(|reader| reader.topic.as_str()).collect();
        assert_eq!(readers, ["/r1/odom", "/bat"]);
    }
}
