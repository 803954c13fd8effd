//! Packets between a host and its DDS process, the child process that connects the host to ROS 2: one JSON object a
//! line, in both directions.
//!
//! JSON costs about 5 us a packet; there are some hundreds a second. A recording of them can be read by eye. Encoding
//! and decoding do no I/O. A line that cannot be decoded gives an error value.

use serde::{Deserialize, Serialize};

pub use super::sample::{PoseSample, Sample, TwistSample};
use super::scan::Fan;

/// Longest line \[bytes\] that a host and its DDS process accept from each other. The largest message is 512 floats of
/// 12 digits.
pub const LONGEST: usize = 16_384;
/// Largest number of topics that one DDS process publishes, and also the largest number it subscribes to.
pub const MAX_TOPICS: usize = 256;
/// Largest number of floats in one array message for observers: 64 latents (policy messages) of 8 features.
pub const MAX_FLOATS: usize = 512;

/// Reason for which a line from a host to its DDS process (the child process that connects it to ROS 2), or back, is
/// refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// The line is longer than `LONGEST` bytes.
    #[error("a packet of the DDS process is longer than 16384 bytes")]
    Long,
    /// The line is not a JSON object of the packet format.
    #[error("a packet of the DDS process is not in its format")]
    Format,
    /// A number in the line is out of range.
    #[error("a packet of the DDS process has a number out of range")]
    Range,
}

impl PacketError {
    /// Returns the text of the error, under which refused packets are counted.
    pub fn reason(self) -> &'static str {
        match self {
            PacketError::Long => "a packet of the DDS process is too long",
            PacketError::Format => "a packet of the DDS process is not in its format",
            PacketError::Range => "a packet of the DDS process has a number out of range",
        }
    }
}

/// Packet from a host to its DDS process (the child process that connects it to ROS 2), one JSON object in a line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ToNode {
    /// The first packet that a DDS process receives: the topics to open, and limits of the process.
    Open(Plan),
    /// Heartbeat of the host, every 50 ms, with the role that the process has to play.
    Beat(Role),
    /// Velocity command for a robot, which replaces the robot's previous command.
    Drive(Drive),
    /// ROS message to publish for observers of the team, such as a user of `rviz2`.
    Publish(Publish),
}

/// Packet from a DDS process (the child process that connects a host to ROS 2) to its host, one JSON object in a line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FromNode {
    /// Heartbeat of the DDS process, every 50 ms, with its memory use and whether its command topics have subscribers.
    Beat(Vitals),
    /// ROS message that the DDS process has received on a subscribed topic. Records have it by this word.
    #[serde(rename = "heard")]
    Received(ReceivedMessage),
    /// State of a topic (number of remote endpoints, newest problem), sent after each change of the state.
    Topic(TopicState),
}

/// Role of a DDS process; a host runs an active one and usually a spare that can take over at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// The process publishes commands and reports every message that it receives.
    Active,
    /// The process is connected but publishes nothing. It reports a few of the messages that it receives.
    Spare,
}

/// Task of a DDS process, which connects a host to ROS 2: the topics to publish and to subscribe to, and its limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Name of the DDS process in log lines and error messages, such as `robot 1`.
    pub name: String,
    /// Number of the DDS domain, as in the environment variable `ROS_DOMAIN_ID` of ROS 2.
    pub domain: u16,
    /// Name or address of the network interface to use; `None` for all interfaces.
    pub interface: Option<String>,
    /// Memory that the process may use in addition to its size at its start \[MiB\].
    pub memory_mib: u32,
    /// Topics that the process publishes; packets name a topic by its index in this list.
    pub writers: Vec<Publication>,
    /// Topics that the process subscribes to; packets name a topic by its index in this list.
    pub readers: Vec<Subscription>,
}

/// Topic that a DDS process publishes, with the type of its messages.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Publication {
    /// Full ROS name of the topic, such as `/r1/cmd_vel`.
    pub topic: String,
    /// Type of the ROS messages on the topic.
    pub kind: Written,
}

/// Type of the messages on a topic that a DDS process publishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Written {
    /// Messages `geometry_msgs/Twist`: velocity commands.
    Twist,
    /// Messages `geometry_msgs/TwistStamped` with stamp zero, which ros2_control takes for "now": velocity commands.
    TwistUnstamped,
    /// Messages `geometry_msgs/TwistStamped`, stamped with the clock of this machine: velocity commands.
    TwistStamped,
    /// Messages `nav_msgs/Odometry`: pose and velocity of a robot, for observers of the team.
    Odometry,
    /// Messages `std_msgs/Float32MultiArray`: tables of numbers for observers of the team.
    Floats,
}

impl Written {
    /// Whether messages of this type are velocity commands for a robot.
    pub fn is_command(self) -> bool {
        matches!(self, Written::Twist | Written::TwistUnstamped | Written::TwistStamped)
    }
}

/// Topic that a DDS process subscribes to, with the type of its messages.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Subscription {
    /// Full ROS name of the topic, such as `/r1/odom`.
    pub topic: String,
    /// Type of the ROS messages on the topic.
    pub kind: Read,
}

/// Type of the messages on a topic that a DDS process subscribes to.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Read {
    /// Messages `nav_msgs/Odometry`: pose and velocity of a robot.
    Odometry,
    /// Messages `geometry_msgs/PoseStamped`: poses of a robot.
    PoseStamped,
    /// Messages `geometry_msgs/PoseWithCovarianceStamped`: poses of a robot with their uncertainty.
    PoseWithCovarianceStamped,
    /// Messages `sensor_msgs/BatteryState`: condition of a robot's battery.
    Battery,
    /// Messages `sensor_msgs/LaserScan`: distances about a robot, which are taken along these rays.
    LaserScan(Fan),
}

/// Velocity command for a robot, in the robot's own axes, to be published on a command topic.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// Index of the command topic in the list `writers` of the [`Plan`] of the DDS process.
    pub topic: u16,
    /// Linear velocity along the robot's x axis \[m/s\].
    pub x: f64,
    /// Linear velocity along the robot's y axis \[m/s\].
    pub y: f64,
    /// Angular velocity about the robot's z axis \[rad/s\].
    pub yaw: f64,
    /// Validity of the command \[ms\]; after that the DDS process publishes zero velocities.
    pub for_ms: u32,
}

/// Message that a DDS process is to publish for observers of the team, such as users of `rviz2`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Publish {
    /// Index of the topic in the list `writers` of the [`Plan`] of the DDS process.
    pub topic: u16,
    /// Content of the message to publish.
    pub message: Outgoing,
}

/// Content of a ROS message that is published for observers of the team.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outgoing {
    /// Pose and velocity of a robot, published as `nav_msgs/Odometry`.
    Pose(PoseSample),
    /// Table of numbers: the number of columns, then the numbers row by row.
    Floats(u32, Vec<f32>),
}

/// Memory use of a DDS process, and whether its command topics have subscribers, as its heartbeats report them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vitals {
    /// Resident memory of the process \[MiB\].
    pub resident_mib: u32,
    /// Whether each topic on which the process publishes velocity commands has at least one subscriber.
    pub matched: bool,
}

/// ROS message that a DDS process has received on a topic and passes to its host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReceivedMessage {
    /// Index of the topic in the list `readers` of the [`Plan`] of the DDS process.
    pub topic: u16,
    /// Content of the received ROS message.
    pub sample: Sample,
}

/// State of one topic of a DDS process: how many publishers or subscribers of other programs it is connected to, and
/// the newest problem.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopicState {
    /// Full ROS name of the topic, such as `/r1/odom`.
    pub topic: String,
    /// Whether the process publishes the topic; otherwise it subscribes to the topic.
    pub written: bool,
    /// Number of matched publishers or subscribers of other programs.
    pub peers: u32,
    /// Newest reason for which another program's endpoint was not matched, or a message refused; `None` if there is
    /// none.
    pub problem: Option<String>,
    /// Number of received messages that were refused.
    #[serde(default)]
    pub refused: u64,
}

/// Encodes a packet between a host and its DDS process as one line of JSON, including the newline.
pub fn encode(packet: &impl Serialize) -> Vec<u8> {
    let mut line = serde_json::to_vec(packet).expect("a packet has text keys only");
    line.push(b'\n');
    line
}

/// Decodes a line that the host received from its DDS process, with or without the newline. Fails if the line is too
/// long, is not in the packet format, or has a number out of range.
pub fn decode_from_node(line: &[u8]) -> Result<FromNode, PacketError> {
    let packet: FromNode = decode(line)?;
    let sound = match &packet {
        FromNode::Beat(_) => true,
        FromNode::Received(heard) => usize::from(heard.topic) < MAX_TOPICS && heard.sample.is_sound(),
        FromNode::Topic(state) => state.topic.len() <= 200 && state.problem.as_ref().is_none_or(|p| p.len() <= 400),
    };
    if sound { Ok(packet) } else { Err(PacketError::Range) }
}

/// Decodes a line that the DDS process received from its host, with or without the newline. Fails if the line is too
/// long, is not in the packet format, or has a number out of range.
pub fn decode_to_node(line: &[u8]) -> Result<ToNode, PacketError> {
    let packet: ToNode = decode(line)?;
    let sound = match &packet {
        ToNode::Beat(_) => true,
        ToNode::Open(plan) => plan.writers.len() <= MAX_TOPICS && plan.readers.len() <= MAX_TOPICS,
        ToNode::Drive(drive) => [drive.x, drive.y, drive.yaw].iter().all(|v| v.is_finite()),
        ToNode::Publish(publish) => match &publish.message {
            Outgoing::Pose(pose) => pose.is_sound(),
            Outgoing::Floats(columns, data) => *columns > 0 && data.len() <= MAX_FLOATS,
        },
    };
    if sound { Ok(packet) } else { Err(PacketError::Range) }
}

fn decode<T: for<'a> Deserialize<'a>>(line: &[u8]) -> Result<T, PacketError> {
    if line.len() > LONGEST {
        return Err(PacketError::Long);
    }
    serde_json::from_slice(line).map_err(|_| PacketError::Format)
}

#[cfg(test)]
mod tests {
    use murmurate::observation::Sweep;

    use super::super::scan::ScanSample;
    use super::*;

    fn packets() -> (Vec<FromNode>, Vec<ToNode>) {
        let twist = Some(TwistSample { x: 0.3, velocity_m_s: Some(0.1), ..TwistSample::default() });
        let pose =
            PoseSample { stamp_ns: 12_000_000_034, x: 1.5, y: -2.5, yaw: Some(0.7), twist, ..Default::default() };
        let sample = Sample::Pose(pose);
        let scan = ScanSample { stamp_ns: 5, ranges_m: vec![Some(1.25), None] };
        let problem = Some("a \"policy\"\n".to_owned());
        let from = vec![
            FromNode::Beat(Vitals { resident_mib: 12, matched: true }),
            FromNode::Received(ReceivedMessage { topic: 0, sample }),
            FromNode::Received(ReceivedMessage { topic: 1, sample: Sample::Battery(None) }),
            FromNode::Received(ReceivedMessage { topic: 2, sample: Sample::Scan(scan) }),
            FromNode::Topic(TopicState { topic: "/r1/odom".to_owned(), written: false, peers: 2, problem, refused: 3 }),
        ];
        let fan = Fan::new(32, &Sweep::new(32, (-0.1, 1.3), 2.5), 0.25, true);
        let plan = Plan {
            name: "robot 1".to_owned(),
            domain: 3,
            interface: Some("lo".to_owned()),
            memory_mib: 192,
            writers: vec![Publication { topic: "/r1/cmd_vel".to_owned(), kind: Written::TwistUnstamped }],
            readers: vec![
                Subscription { topic: "/r1/odom".to_owned(), kind: Read::Odometry },
                Subscription { topic: "/r1/scan".to_owned(), kind: Read::LaserScan(fan) },
            ],
        };
        let to = vec![
            ToNode::Open(plan),
            ToNode::Beat(Role::Spare),
            ToNode::Drive(Drive { topic: 0, x: 0.1, y: -0.0, yaw: 1e-300, for_ms: 200 }),
            ToNode::Publish(Publish { topic: 0, message: Outgoing::Pose(pose) }),
            ToNode::Publish(Publish { topic: 0, message: Outgoing::Floats(2, vec![0.1, 0.2]) }),
        ];
        (from, to)
    }

    #[test]
    fn packets_are_read_as_they_were_written_and_no_part_of_one_is_read() {
        let (from, to) = packets();
        for packet in from {
            let line = encode(&packet);
            assert_eq!(decode_from_node(&line), Ok(packet));
            assert_eq!(line.iter().filter(|byte| **byte == b'\n').count(), 1);
            for end in 0..line.len() - 1 {
                assert_eq!(decode_from_node(&line[..end]), Err(PacketError::Format), "{end}");
            }
        }
        for packet in to {
            let line = encode(&packet);
            assert_eq!(decode_to_node(&line), Ok(packet));
            for end in 0..line.len() - 1 {
                assert_eq!(decode_to_node(&line[..end]), Err(PacketError::Format), "{end}");
            }
        }
    }

    #[test]
    fn changed_bytes_give_a_sound_packet_or_an_error() {
        let lines: Vec<Vec<u8>> = packets().0.iter().map(encode).collect();
        // Constants of a linear congruential generator: Knuth, MMIX.
        let mut state = 1_u64;
        let mut draw = |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            usize::try_from(state >> 33).unwrap() % below
        };
        let mut taken = 0;
        for _ in 0..50_000 {
            let mut line = lines[draw(lines.len())].clone();
            for _ in 0..1 + draw(3) {
                let at = draw(line.len());
                line[at] =
                    if draw(2) == 0 { b"0123456789eE.-+\"{}[],:"[draw(22)] } else { u8::try_from(draw(256)).unwrap() };
            }
            if let Ok(FromNode::Received(heard)) = decode_from_node(&line) {
                assert!(heard.sample.is_sound());
                taken += 1;
            }
        }
        assert!(taken > 100, "{taken}");
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let pose = FromNode::Received(ReceivedMessage { topic: 0, sample: Sample::Pose(PoseSample::default()) });
        let far = String::from_utf8(encode(&pose)).unwrap().replace(r#""x":0.0"#, r#""x":1e999"#);
        assert!(decode_from_node(far.as_bytes()).is_err());
        assert_eq!(decode_from_node(br#"{"heard":{"topic":0,"sample":{"battery":1.5}}}"#), Err(PacketError::Range));
        assert_eq!(decode_from_node(br#"{"heard":{"topic":300,"sample":{"battery":0.5}}}"#), Err(PacketError::Range));
        for ranges in ["", "-1.0", "1e7"] {
            let scan =
                format!(r#"{{"heard":{{"topic":0,"sample":{{"scan":{{"stamp_ns":1,"ranges_m":[{ranges}]}}}}}}}}"#);
            assert_eq!(decode_from_node(scan.as_bytes()), Err(PacketError::Range), "{ranges}");
        }
        assert_eq!(decode_from_node(&vec![b' '; LONGEST + 1]), Err(PacketError::Long));
    }
}
