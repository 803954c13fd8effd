//! Packets between a host and its DDS process: one JSON object a line, both ways.
//!
//! JSON costs about 5 us a packet; there are some hundreds a second. A recording of them is read by eye. Both sides are
//! pure. A line that is not understood is an error value.

use serde::{Deserialize, Serialize};

pub use super::sample::{PoseSample, Sample, TwistSample};

/// Longest line that is taken \[bytes\]. The largest message is 512 floats of 12 digits.
pub const LONGEST: usize = 16_384;
/// Most topics of a process each way; a robot has three, a source one for each of its robots.
pub const MAX_TOPICS: usize = 256;
/// Most floats in a message: those of 64 latents of 8 features.
pub const MAX_FLOATS: usize = 512;

/// Refusal of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PacketError {
    /// It is longer than `LONGEST`.
    #[error("a packet of the DDS process is longer than 16384 bytes")]
    Long,
    /// It is not an object of the format.
    #[error("a packet of the DDS process is not in its format")]
    Format,
    /// A number in it is out of range.
    #[error("a packet of the DDS process has a number out of range")]
    Range,
}

impl PacketError {
    /// The reason, for a count of refused packets.
    pub fn reason(self) -> &'static str {
        match self {
            PacketError::Long => "a packet of the DDS process is too long",
            PacketError::Format => "a packet of the DDS process is not in its format",
            PacketError::Range => "a packet of the DDS process has a number out of range",
        }
    }
}

/// Packet from the host to the DDS process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ToNode {
    /// First packet: topics and limits.
    Open(Plan),
    /// Heartbeat every 50 ms, with the role of the process.
    Beat(Role),
    /// Velocity for a robot, which replaces the one before it.
    Drive(Drive),
    /// Message for observers.
    Publish(Publish),
}

/// Packet from the DDS process to the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FromNode {
    /// Heartbeat every 50 ms.
    Beat(Vitals),
    /// Message that was received.
    Heard(Heard),
    /// State of a topic, after each change of it.
    Topic(TopicState),
}

/// Role of a DDS process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// It publishes, and reports all that it hears.
    Active,
    /// It is discovered and publishes nothing; it reports a few of the messages it hears.
    Spare,
}

/// Task of a DDS process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// Name in messages for people, such as `robot 1`.
    pub name: String,
    /// DDS domain, which is `ROS_DOMAIN_ID`.
    pub domain: u16,
    /// Name or address of the interface; none: all.
    pub interface: Option<String>,
    /// Memory that it may take \[MiB\].
    pub memory_mib: u32,
    /// Topics that it publishes; packets name them by their index.
    pub writers: Vec<Writer>,
    /// Topics that it subscribes to; packets name them by their index.
    pub readers: Vec<Reader>,
}

/// Topic that is published.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Writer {
    /// Full ROS name, such as `/r1/cmd_vel`.
    pub topic: String,
    /// Its messages.
    pub kind: Written,
}

/// Messages that are published.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Written {
    /// `geometry_msgs/Twist`.
    Twist,
    /// `geometry_msgs/TwistStamped` with stamp zero, which ros2_control takes for "now".
    TwistUnstamped,
    /// `geometry_msgs/TwistStamped` with the clock of this machine.
    TwistStamped,
    /// `nav_msgs/Odometry`.
    Odometry,
    /// `std_msgs/Float32MultiArray`.
    Floats,
}

impl Written {
    /// Whether its messages are commands.
    pub fn is_command(self) -> bool {
        matches!(self, Written::Twist | Written::TwistUnstamped | Written::TwistStamped)
    }
}

/// Topic that is subscribed to.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reader {
    /// Full ROS name, such as `/r1/odom`.
    pub topic: String,
    /// Its messages.
    pub kind: Read,
}

/// Messages that are subscribed to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Read {
    /// `nav_msgs/Odometry`.
    Odometry,
    /// `geometry_msgs/PoseStamped`.
    PoseStamped,
    /// `geometry_msgs/PoseWithCovarianceStamped`.
    PoseWithCovarianceStamped,
    /// `sensor_msgs/BatteryState`.
    Battery,
}

/// Velocity of a robot, in the axes of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Drive {
    /// Index among the plan's writers.
    pub topic: u16,
    /// `linear.x` \[m/s\].
    pub x: f64,
    /// `linear.y` \[m/s\].
    pub y: f64,
    /// `angular.z` \[rad/s\].
    pub yaw: f64,
    /// Validity \[ms\]; then the process publishes zeros.
    pub for_ms: u32,
}

/// Message for observers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Publish {
    /// Index among the plan's writers.
    pub topic: u16,
    /// The message.
    pub message: Outgoing,
}

/// Content of a message for observers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outgoing {
    /// Pose and velocity of a robot.
    Pose(PoseSample),
    /// Rows of numbers: number of columns, and the numbers by rows.
    Floats(u32, Vec<f32>),
}

/// Condition of a DDS process.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vitals {
    /// Memory in use \[MiB\].
    pub resident_mib: u32,
    /// Whether each command topic has a subscriber.
    pub matched: bool,
}

/// Message that was received.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Heard {
    /// Index among the plan's readers.
    pub topic: u16,
    /// Content.
    pub sample: Sample,
}

/// State of a topic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TopicState {
    /// Full ROS name.
    pub topic: String,
    /// Whether this process publishes it.
    pub written: bool,
    /// Number of matched endpoints of others.
    pub peers: u32,
    /// Newest reason for which an endpoint was not matched, or a message refused.
    pub problem: Option<String>,
}

/// Encodes a packet as a line with its end.
pub fn encode(packet: &impl Serialize) -> Vec<u8> {
    let mut line = serde_json::to_vec(packet).expect("a packet has text keys only");
    line.push(b'\n');
    line
}

/// Decodes a line of the DDS process, with or without its end.
pub fn decode_from_node(line: &[u8]) -> Result<FromNode, PacketError> {
    let packet: FromNode = decode(line)?;
    let sound = match &packet {
        FromNode::Beat(_) => true,
        FromNode::Heard(heard) => usize::from(heard.topic) < MAX_TOPICS && heard.sample.is_sound(),
        FromNode::Topic(state) => state.topic.len() <= 200 && state.problem.as_ref().is_none_or(|p| p.len() <= 400),
    };
    if sound { Ok(packet) } else { Err(PacketError::Range) }
}

/// Decodes a line of the host, with or without its end.
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
    use super::*;

    fn packets() -> (Vec<FromNode>, Vec<ToNode>) {
        let twist = Some(TwistSample { x: 0.3, velocity_m_s: Some(0.1), ..TwistSample::default() });
        let pose =
            PoseSample { stamp_ns: 12_000_000_034, x: 1.5, y: -2.5, yaw: Some(0.7), twist, ..Default::default() };
        let sample = Sample::Pose(pose);
        let problem = Some("a \"policy\"\n".to_owned());
        let from = vec![
            FromNode::Beat(Vitals { resident_mib: 12, matched: true }),
            FromNode::Heard(Heard { topic: 0, sample }),
            FromNode::Heard(Heard { topic: 1, sample: Sample::Battery(None) }),
            FromNode::Topic(TopicState { topic: "/r1/odom".to_owned(), written: false, peers: 2, problem }),
        ];
        let plan = Plan {
            name: "robot 1".to_owned(),
            domain: 3,
            interface: Some("lo".to_owned()),
            memory_mib: 192,
            writers: vec![Writer { topic: "/r1/cmd_vel".to_owned(), kind: Written::TwistUnstamped }],
            readers: vec![Reader { topic: "/r1/odom".to_owned(), kind: Read::Odometry }],
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
            if let Ok(FromNode::Heard(heard)) = decode_from_node(&line) {
                assert!(heard.sample.is_sound());
                taken += 1;
            }
        }
        assert!(taken > 100, "{taken}");
    }

    #[test]
    fn numbers_out_of_range_are_refused() {
        let pose = FromNode::Heard(Heard { topic: 0, sample: Sample::Pose(PoseSample::default()) });
        let far = String::from_utf8(encode(&pose)).unwrap().replace(r#""x":0.0"#, r#""x":1e999"#);
        assert!(decode_from_node(far.as_bytes()).is_err());
        assert_eq!(decode_from_node(br#"{"heard":{"topic":0,"sample":{"battery":1.5}}}"#), Err(PacketError::Range));
        assert_eq!(decode_from_node(br#"{"heard":{"topic":300,"sample":{"battery":0.5}}}"#), Err(PacketError::Range));
        assert_eq!(decode_from_node(&vec![b' '; LONGEST + 1]), Err(PacketError::Long));
    }
}
