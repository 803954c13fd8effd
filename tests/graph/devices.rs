//! Contracts of every driver, source and estimator of the registry, and user programs as drivers and sources.

use std::os::fd::AsFd;

use murmurate::chassis::Chassis;
use murmurate::drivers::{self, Command};
use murmurate::edge::{self, Gate, Running, Settings, Worker};
use murmurate::estimation;
use murmurate::localization::{self, In};
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::{BodyTwist, Drive};
use murmurate::messages::wire::{Celsius, Hardware, Health, Reading, Reason};
use murmurate::registry::Registry;
use murmurate::time::{Span, Time};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use crate::common::{HANGS, ends};

const ROBOT: RobotId = RobotId(3);

/// Returns valid settings of each driver and source of this crate.
fn settings(name: &str) -> Settings {
    match name {
        "odometry" => Settings { name: name.to_owned(), table: toml::Table::new() },
        "program" => program("while read line; do :; done"),
        "robomaster" => table("robomaster", "connection = 'usb'"),
        "natnet" => table("natnet", "server = '127.0.0.1'"),
        "gpsd" => table("gpsd", "origin_latitude_deg = 52.2053\norigin_longitude_deg = 0.1218"),
        _ => panic!("'{name}' is new: say here what it can be made with"),
    }
}

fn table(name: &str, text: &str) -> Settings {
    Settings { name: name.to_owned(), table: text.parse().expect("it is TOML") }
}

fn program(script: &str) -> Settings {
    let command = ["sh", "-c", script].map(|word| toml::Value::String(word.to_owned())).to_vec();
    let table = [("command".to_owned(), toml::Value::Array(command))].into_iter().collect();
    Settings { name: "program".to_owned(), table }
}

fn with(mut settings: Settings, field: &str, value: impl Into<toml::Value>) -> Settings {
    settings.table.insert(field.to_owned(), value.into());
    settings
}

fn driver(settings: &Settings) -> Result<drivers::Parts, murmurate::config::ConfigError> {
    murmurate_ros2::add(murmurate_devices::add(Registry::builtin())).driver(settings, ROBOT)
}

fn source(settings: &Settings) -> Result<localization::Parts, murmurate::config::ConfigError> {
    murmurate_ros2::add(murmurate_devices::add(Registry::builtin())).source(settings, &[ROBOT])
}

fn drive(x: f32) -> Drive {
    Drive { robot: ROBOT, velocity: Vec2::new(x, 0.0), until: Time::ZERO + Span::from_millis(200) }
}

/// Starts a worker; returns the gate to it, and the running worker.
fn employ(worker: Box<dyn Worker>) -> (Gate, Running) {
    edge::start(worker, "a device").expect("there are descriptors and threads left")
}

/// Returns the next packets of a worker.
fn next<const COUNT: usize>(gate: &mut Gate) -> [Vec<u8>; COUNT] {
    let mut packets = Vec::new();
    while packets.len() < COUNT {
        let bell = gate.bell();
        let mut watched = [PollFd::new(bell.as_fd(), PollFlags::POLLIN)];
        let longest = PollTimeout::try_from(HANGS).expect("a minute");
        assert_eq!(poll(&mut watched, longest), Ok(1), "the worker sends nothing");
        gate.take(|packet| packets.push(packet.into_vec()));
    }
    packets.try_into().expect("it says no more than that")
}

#[test]
fn every_driver_stands_survives_noise_and_ends_with_its_host() {
    // The worker of ROS 2 starts this very program with another command, and needs a feature: see crates/ros2.
    for entry in murmurate_ros2::add(murmurate_devices::add(Registry::builtin()))
        .drivers()
        .iter()
        .filter(|entry| entry.name != "ros2")
    {
        let parts = driver(&settings(entry.name)).expect("its settings are sound");
        let (mut driver, mut out) = ((parts.driver)(), Vec::new());
        assert!(driver.limits().speed_m_s > 0.0, "{}", entry.name);
        driver.drive(Time::ZERO, &Command { drive: drive(0.0), body: Some(BodyTwist::default()) }, &mut out);
        // A RoboMaster cannot be told before its connection stands; tests/graph/robomaster.rs tells it then.
        assert!(!out.is_empty() || entry.name == "robomaster", "{}: to stand is an order, too", entry.name);
        for noise in [&b""[..], b"\n", b"{}", &[0xff; 5000], b"{\"health\": 7}"] {
            driver.receive(Time::ZERO, noise, &mut out);
        }
        if let Some(worker) = parts.worker {
            let (gate, worker) = employ(worker);
            drop(gate);
            ends(worker, entry.name);
        }
        let error = driver_error(&with(settings(entry.name), "colour", "red"));
        assert!(error.contains(&format!("driver.{}", entry.name)) && error.contains("colour"), "{error}");
    }
}

fn driver_error(settings: &Settings) -> String {
    driver(settings).err().expect("it is refused").to_string()
}

fn is_refusal(said: &localization::Out) -> bool {
    matches!(said, localization::Out::Refused(_) | localization::Out::RefusedOf(..))
}

#[test]
fn every_source_refuses_invalid_packets() {
    for entry in murmurate_ros2::add(murmurate_devices::add(Registry::builtin()))
        .sources()
        .iter()
        .filter(|entry| entry.name != "ros2")
    {
        let parts = source(&settings(entry.name)).expect("its settings are sound");
        let (mut source, mut out) = ((parts.source)(), Vec::new());
        for noise in [&b""[..], b"\n", b"{}", &[0xff; 5000], b"{\"robot\": 3}"] {
            source.take(Time::ZERO, In::Packet(noise), &mut out);
        }
        assert!(out.iter().all(is_refusal), "{}: {out:?}", entry.name);
    }
}

#[test]
fn every_estimator_starts_without_an_estimate_and_keeps_a_resting_robot_in_place() {
    for entry in Registry::builtin().estimators() {
        let mut estimator = (entry.make)(&estimation::Settings::default());
        assert_eq!(estimator.at(Time::ZERO), None, "{}", entry.name);
        let motion = Motion::at_rest(Vec2::new(1.5, -2.0));
        estimator.take(Time::ZERO, &Reading::of_point(ROBOT, 1, motion));
        for ms in [0, 50, 5000] {
            assert_eq!(estimator.at(Time::ZERO + Span::from_millis(ms)), Some(motion), "{}", entry.name);
        }
    }
}

#[test]
fn wrong_settings_are_refused_by_their_field() {
    let unknown = Settings { name: "telepathy".to_owned(), table: toml::Table::new() };
    let error = driver_error(&unknown);
    assert!(error.contains("driver.name") && error.contains("there are: program"), "{error}");
    let error = driver_error(&with(settings("program"), "speed_m_s", -1.0));
    assert!(error.contains("speed_m_s"), "{error}");
    let error = source(&with(settings("program"), "command", toml::Value::Array(Vec::new()))).err();
    assert!(error.expect("it is refused").to_string().contains("command"));
}

#[test]
fn a_program_drives_a_robot_and_reports_its_status() {
    let said = r#"{"health": "faulty", "battery": 12, "temperature_c": 41.5, "reason": "bumper"}"#;
    let script = format!("while read line; do echo \"$line\"; echo '{said}'; done");
    let parts = driver(&with(program(&script), "speed_m_s", 0.5)).expect("it is sound");
    let (mut driver, mut out) = ((parts.driver)(), Vec::new());
    assert_eq!(driver.limits().speed_m_s, 0.5);
    let body = Chassis::default().twist(Vec2::new(0.25, 0.0), Some(std::f32::consts::FRAC_PI_2));
    driver.drive(Time::ZERO, &Command { drive: drive(0.25), body }, &mut out);
    let Some(drivers::Out::Send(line)) = out.pop() else { panic!("it sends a line to its program") };
    let (mut gate, worker) = employ(parts.worker.expect("a program is a worker"));
    gate.send(line);
    let [line, word] = next(&mut gate);
    let said: serde_json::Value = serde_json::from_slice(&line).expect("a line is JSON");
    assert_eq!((said["robot"].as_u64(), said["vx"].as_f64(), said["for_s"].as_f64()), (Some(3), Some(0.25), Some(0.2)));
    let [ahead, left] = ["ahead", "left"].map(|field| said[field].as_f64().expect("the heading is known"));
    assert!(ahead.abs() < 1e-6 && (left + 0.25).abs() < 1e-6, "east is to the right of who points north: {said}");
    driver.receive(Time::ZERO, &word, &mut out);
    let (temperature, reason) = (Celsius::of(41.5), Reason::new("bumper"));
    let hardware = Hardware { health: Health::Faulty, battery: Some(12), temperature, reason };
    assert_eq!(out.pop(), Some(drivers::Out::Condition(hardware.clone())));
    let odd = b"{\"health\": \"faulty\", \"temperature_c\": 1e9, \"battery\": 300, \"reason\": \"bumper\"}";
    driver.receive(Time::ZERO, odd, &mut out);
    assert!(matches!(out.pop(), Some(drivers::Out::Refused(_))) && matches!(out.pop(), Some(drivers::Out::Refused(_))));
    let hardware = Hardware { battery: None, temperature: None, ..hardware };
    assert_eq!(out.pop(), Some(drivers::Out::Condition(hardware)), "an odd value does not hide a fault");
    drop(gate);
    ends(worker, "program");
}

#[test]
fn a_program_localizes_robots() {
    let script = r#"
        echo '{"robot": 3, "stamp_s": 1.5, "x": 1, "y": 2, "vx": 0.5, "vy": 0, "heading": 0.25}'
        echo '{"robot": 4, "stamp_s": 1.5, "x": 1, "y": 2, "vx": 0, "vy": 0}'
        echo '{"robot": 3, "stamp_s": 1.6, "x": 1e9, "y": 2, "vx": 0, "vy": 0}'
        cat"#;
    let parts = source(&program(script)).expect("it is sound");
    let (mut source, mut out) = ((parts.source)(), Vec::new());
    let (mut gate, worker) = employ(parts.worker);
    for packet in next::<3>(&mut gate) {
        source.take(Time::ZERO, In::Packet(&packet), &mut out);
    }
    let localization::Out::Reading(reading) = &out[0] else { panic!("{out:?}") };
    assert_eq!((reading.robot, reading.stamp_ns, reading.pose.heading), (ROBOT, 1_500_000_000, Some(0.25)));
    assert_eq!((reading.twist.yaw_rate, reading.deviation.position_m), (None, None), "what is not said is unknown");
    assert!(is_refusal(&out[1]) && is_refusal(&out[2]), "another's robot, and a place that is none: {out:?}");
    drop(gate);
    ends(worker, "program");
}

#[test]
fn a_program_without_ros_2_reads_the_team_file_and_starts_no_robot() {
    if murmurate_ros2::BUILT {
        return;
    }
    let driver = driver(&table("ros2", "namespace = '/r3'\nspeed_m_s = 0.3")).expect("an operator may have it");
    let source = source(&table("ros2", "")).expect("an operator may have it");
    for worker in [driver.worker.expect("it has one"), source.worker] {
        let refused = worker.check().expect_err("it cannot run here").to_string();
        assert!(refused.contains("--features ros2"), "{refused}");
    }
}
