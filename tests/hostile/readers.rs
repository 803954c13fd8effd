//! The readers of what comes from outside, each with a use of what it has read. A reader returns whether it has
//! accepted the bytes. Mutations (`main.rs`) and coverage-guided fuzzing (`fuzz/`) share them.
#![allow(dead_code)] // Each fuzz target uses one.

use std::path::Path;

use murmurate::deploy::conditions::Conditions;
use murmurate::deploy::team::TeamFile;
use murmurate::deploy::{Deployment, Impair};
use murmurate::edge::Settings as Device;
use murmurate::faults::FaultPlan;
use murmurate::localization::{In, Out, Parts, program};
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::wire::Wire;
use murmurate::net::media::radio::Radio;
use murmurate::observation::{Observation, Request};
use murmurate::policy::{Model, Neighbour};
use murmurate::random::Seed;
use murmurate::registry::Registry;
use murmurate::safety::Safety;
use murmurate::scenario::layout::Layouts;
use murmurate::scenario::{self, Settings};
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate_devices::robomaster::{link, protocol};
use murmurate_devices::{gpsd as satellites, natnet as tracker};
use murmurate_ros2::packet as ros;

fn text(bytes: &[u8]) -> Option<&str> {
    std::str::from_utf8(bytes).ok()
}

/// A policy file: read, checked, and one step of a robot that hears four others.
pub fn policy(bytes: &[u8]) -> bool {
    let Ok(model) = Model::from_file(bytes, "passage") else { return false };
    let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
    let mut policy = model.instance(passage.arena(), RobotId(0));
    let values = vec![0.25; model.requests().iter().map(Request::floats).sum()];
    let observation = Observation {
        values: &values,
        ..Observation::new(Motion::at_rest(Vec2::new(0.3, -1.5)), Vec2::new(-0.2, 1.5))
    };
    let mut features = vec![0.0; policy.interface().features];
    let heard = vec![0.5; features.len()];
    let neighbour = Neighbour { motion: observation.motion, features: &heard, age: Span::ZERO };
    let neighbours: Vec<Neighbour> = vec![neighbour; 4];
    policy.encode(&observation, &mut features);
    for hop in 1..policy.hops() {
        policy.relay(hop, &observation, &mut features, &neighbours);
    }
    policy.act(&observation, &features, &neighbours, &mut Seed::of_run(1).stream("draw"));
    true
}

/// The parts of the program.
fn registry() -> Registry {
    murmurate_ros2::add(murmurate_devices::add(Registry::builtin())).with_transport(murmurate_zenoh::ENTRY)
}

/// A team file: read, checked for every host, and shown.
pub fn team(bytes: &[u8]) -> bool {
    let Some(text) = text(bytes) else { return false };
    let Ok(file) = TeamFile::read(&registry(), text, Path::new("."), &[], &[]) else { return false };
    let sound = file.check().is_ok();
    let first = file.hosts().next();
    for host in [None, first] {
        assert!(!file.values(host).is_empty());
    }
    sound
}

/// A deployment file: read, checked, and made a trial of.
pub fn deployment(bytes: &[u8]) -> bool {
    let Some(Ok(deployment)) = text(bytes).map(Deployment::from_toml) else { return false };
    let _ = deployment.clone().impaired(Some(0.1), Some(0.5), Impair::All);
    let settings = Settings::of(deployment.robots);
    let Ok(passage) = scenario::build("passage", &settings) else { return false };
    let model = Model::shipped("passage").expect("it is shipped");
    Trial::new(deployment, passage, model).check().is_ok()
}

/// A fault plan: read, checked against a deployment, and described.
pub fn faults(bytes: &[u8]) -> bool {
    let Some(Ok(plan)) = text(bytes).map(FaultPlan::from_toml) else { return false };
    let deployment = Deployment::preset("onboard-adhoc", 5).expect("it is a mode");
    assert!(plan.describe().len() < 1_000_000 && plan.over() >= Time::ZERO);
    plan.check(&deployment.targets()).is_ok() && plan.check_episodes(16).is_ok()
}

/// Conditions of a simulation: read, and applied to a deployment.
pub fn conditions(bytes: &[u8]) -> bool {
    let Some(Ok(conditions)) = text(bytes).map(Conditions::from_toml) else { return false };
    conditions.links(Deployment::preset("onboard-adhoc", 5).expect("it is a mode")).is_ok()
}

/// A radio file: read, and the airtime of a frame.
pub fn radio(bytes: &[u8]) -> bool {
    let Some(Ok(radio)) = text(bytes).map(Radio::from_toml) else { return false };
    radio.frame_airtime(1472) >= Span::ZERO && radio.multicast_airtime(100) >= Span::ZERO
}

/// Limits of a guard.
pub fn safety(bytes: &[u8]) -> bool {
    text(bytes).map(Safety::from_toml).is_some_and(|read| read.is_ok())
}

/// An episodes file.
pub fn episodes(bytes: &[u8]) -> bool {
    let passage = scenario::build("passage", &Settings::default()).expect("the default is sound");
    let read = text(bytes).map(|text| Layouts::from_json(text, &*passage, 1));
    read.is_some_and(|read| read.is_ok())
}

/// Packets, each after its length in two bytes, as joined by `joined`.
fn packets(mut bytes: &[u8]) -> Vec<&[u8]> {
    let mut packets = Vec::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<2>() {
        let (packet, after) = rest.split_at(usize::from(u16::from_le_bytes(*length)).min(rest.len()));
        packets.push(packet);
        bytes = after;
    }
    packets
}

/// Joins packets to the input of a reader of several.
pub fn joined(packets: &[Vec<u8>]) -> Vec<u8> {
    let length = |packet: &[u8]| u16::try_from(packet.len()).expect("a packet is short").to_le_bytes();
    packets.iter().flat_map(|packet| [&length(packet)[..], packet].concat()).collect()
}

/// Feeds a source with packets, and checks what it makes of them. Returns whether there was a reading.
fn fed<'a>(parts: Parts, packets: impl Iterator<Item = &'a [u8]>) -> bool {
    let mut source = (parts.source)();
    let (mut out, mut found) = (Vec::new(), false);
    for (at, packet) in packets.enumerate() {
        source.take(Time::from_nanos(at as u64 * 10_000_000), In::Packet(packet), &mut out);
        for said in out.drain(..) {
            if let Out::Reading(reading) = said {
                assert!(Wire::Reading(reading).check().is_ok(), "a reading that may not be sent");
                found = true;
            }
        }
    }
    found
}

fn device(name: &str, table: &str) -> Device {
    Device { name: name.to_owned(), table: table.parse().expect("it is TOML") }
}

/// Datagrams of a motion capture server, each after its length.
pub fn natnet(bytes: &[u8]) -> bool {
    let robots = [RobotId(0), RobotId(1)];
    let parts = tracker::make(&device("natnet", "server = '127.0.0.1'\nrate_hz = 1000.0"), &robots)
        .expect("the settings are sound");
    fed(parts, packets(bytes).into_iter())
}

/// Lines of gpsd.
pub fn gpsd(bytes: &[u8]) -> bool {
    let settings = device("gpsd", "origin_latitude_deg = 52.2053\norigin_longitude_deg = 0.1218");
    let parts = satellites::make(&settings, &[RobotId(0)]).expect("the settings are sound");
    fed(parts, bytes.split_inclusive(|byte| *byte == b'\n'))
}

/// Lines of a user's program that localizes robots.
pub fn lines(bytes: &[u8]) -> bool {
    let settings = device("program", "command = ['none']");
    let parts = program::make(&settings, &[RobotId(0), RobotId(1)]).expect("the settings are sound");
    fed(parts, bytes.split_inclusive(|byte| *byte == b'\n'))
}

/// What a RoboMaster and its worker say.
pub fn robomaster(bytes: &[u8]) -> bool {
    let statement = String::from_utf8_lossy(bytes);
    let answered = protocol::decode_answer(&statement).is_ok() | protocol::decode_hit(&statement).is_ok();
    let pushed = protocol::decode_push(bytes).is_ok() | protocol::decode_announcement(bytes).is_ok();
    let passed = link::ToWorker::decode(bytes).is_some() | link::FromWorker::decode(bytes).is_some();
    answered | pushed | passed
}

/// What a host and its DDS process say to each other.
pub fn ros2(bytes: &[u8]) -> bool {
    ros::decode_from_node(bytes).is_ok() | ros::decode_to_node(bytes).is_ok()
}
