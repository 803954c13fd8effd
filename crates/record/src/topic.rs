//! Topics of a record: their names, encodings and schemas.

use foxglove::Encode;
use foxglove::messages::{FrameTransforms, LaserScan, Log, PointCloud, PoseInFrame, SceneUpdate};

use super::stage::Stage;
use super::{schemas, truth};
use murmurate::messages::ids::{HostId, RobotId};

/// Name of the topic with the lines that the program has logged.
pub const PROGRAM: &str = "/log/program";
/// Name of the topic with the state of the host's Wi-Fi cards.
pub const WIFI: &str = "/wifi";
/// Name of the topic with the messages that an operator has received.
pub const RECEIVED: &str = "/received";
/// Name of the topic with the receipts of an imported run's messages.
pub const RECEIPTS: &str = "/receipts";

/// Topic of a record, to which each of its messages belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Turns of the host's event loop (passes over all pending inputs), each with its inputs.
    Turn,
    /// Messages that this host has published, as datagrams without authentication tags.
    Wire(HostId),
    /// True states of simulated robots.
    Truth,
    /// Drawing of walls, goals, robots and links.
    Scene,
    /// Positions of the robots as a point cloud.
    Robots,
    /// Transforms from the world frame to the robots' frames.
    Transforms,
    /// Estimated position of this robot, with its last measured heading.
    Pose(RobotId),
    /// Scans of this robot by its sense with this index, for senses whose values are distances along rays.
    Scan(RobotId, u8),
    /// Phases of episodes, verdicts and stops, as text.
    Log,
    /// Lines that the program has logged. A replay does not repeat them.
    Program,
    /// Messages that an operator has received, as datagrams.
    Received,
    /// Phases and results of episodes.
    Episode,
    /// State of the host's links to other hosts: age, delay, loss.
    Links,
    /// Numbers of stops and reduced velocities by the robots' guards.
    Guard,
    /// Digests of what the robots' policies remember after each step.
    Memory,
    /// Numbers of datagrams on the host's links, and of events that the record lacks.
    Counts,
    /// Condition of real robots' hardware.
    Hardware,
    /// State of the host's Wi-Fi cards. A replay does not repeat it.
    Wifi,
    /// Messages between robots, with the times of sending and arrival. Only in imported records.
    Receipts,
}

/// Schema of a topic's messages.
pub struct Schema {
    /// Name of the type of the messages.
    pub name: String,
    /// Encoding of the schema by its name in MCAP, such as `protobuf`.
    pub encoding: &'static str,
    /// Content of the schema: text or binary.
    pub data: Vec<u8>,
}

impl Topic {
    /// Returns the topic's name in a record, such as `/truth`. `stage` has the names of the hosts.
    pub fn name(self, stage: &Stage) -> String {
        match self {
            Topic::Turn => "/tape/turn".to_owned(),
            Topic::Wire(host) => format!("/wire/{}", stage.hosts[usize::from(host.0)]),
            Topic::Truth => "/truth".to_owned(),
            Topic::Scene => "/scene".to_owned(),
            Topic::Robots => "/robots".to_owned(),
            Topic::Transforms => "/tf".to_owned(),
            Topic::Pose(robot) => format!("/robot/{}/pose", robot.0),
            Topic::Scan(robot, sense) => format!("/robot/{}/sense/{}", robot.0, stage.senses[usize::from(sense)].name),
            Topic::Log => "/log".to_owned(),
            Topic::Program => PROGRAM.to_owned(),
            Topic::Received => RECEIVED.to_owned(),
            Topic::Episode => "/episode".to_owned(),
            Topic::Links => "/links".to_owned(),
            Topic::Guard => "/guard".to_owned(),
            Topic::Memory => "/memory".to_owned(),
            Topic::Counts => "/counts".to_owned(),
            Topic::Hardware => "/hardware".to_owned(),
            Topic::Wifi => WIFI.to_owned(),
            Topic::Receipts => RECEIPTS.to_owned(),
        }
    }

    /// Returns the encoding of the topic's messages: by its name in MCAP, or one of this program for its own binary
    /// formats.
    pub fn encoding(self) -> &'static str {
        match self {
            Topic::Turn => "murmurate-turn-1",
            Topic::Wire(_) | Topic::Received => "murmurate-datagram",
            Topic::Episode | Topic::Links | Topic::Guard | Topic::Memory => "json",
            Topic::Counts | Topic::Hardware | Topic::Wifi | Topic::Receipts => "json",
            _ => "protobuf",
        }
    }

    /// Returns the schema of the topic's messages; `None` for binary formats of this program.
    pub fn schema(self) -> Option<Schema> {
        let json = |name: &str, text: &str| Schema {
            name: format!("murmurate.{name}"),
            encoding: "jsonschema",
            data: text.as_bytes().to_vec(),
        };
        Some(match self {
            Topic::Turn | Topic::Wire(_) | Topic::Received => return None,
            Topic::Truth => Schema { name: "murmurate.Truth".to_owned(), encoding: "protobuf", data: truth::schema() },
            Topic::Scene => described::<SceneUpdate>(),
            Topic::Robots => described::<PointCloud>(),
            Topic::Transforms => described::<FrameTransforms>(),
            Topic::Pose(_) => described::<PoseInFrame>(),
            Topic::Scan(..) => described::<LaserScan>(),
            Topic::Log | Topic::Program => described::<Log>(),
            Topic::Episode => json("Episode", schemas::EPISODE),
            Topic::Links => json("Links", schemas::LINKS),
            Topic::Guard => json("Guard", schemas::GUARD),
            Topic::Memory => json("Memory", schemas::MEMORY),
            Topic::Counts => json("Counts", schemas::COUNTS),
            Topic::Hardware => json("Hardware", schemas::HARDWARE),
            Topic::Wifi => json("Wifi", schemas::WIFI),
            Topic::Receipts => json("Receipt", schemas::RECEIPT),
        })
    }
}

/// Returns the schema of a type of Foxglove's messages.
fn described<T: Encode>() -> Schema {
    let schema = T::get_schema().expect("Foxglove describes its types");
    Schema { name: schema.name, encoding: "protobuf", data: schema.data.into_owned() }
}
