//! Files and datagrams of an attacker: mutations of sound ones, which every reader has to accept or refuse without a
//! panic, without 256 MB and within five seconds.
//!
//! `MURMURATE_MUTATIONS=20000 cargo test --release --test hostile` is the whole of it (`just full-hostile`); without
//! the variable it is a few hundred of each kind. An input that a reader does not survive is kept, and named.

mod contracts;
#[path = "../peers/natnet.rs"]
mod fake;
mod readers;
mod trainings;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Duration;

use murmurate::deploy::conditions::Conditions;
use murmurate::deploy::{Deployment, Impair};
use murmurate::faults::FaultPlan;
use murmurate::net::media::radio::{self, Radio};
use murmurate::random::{RngExt, Seed, Stream};
use murmurate::time::Span;
use murmurate_study::Job;
use murmurate_study::record::TrialRecord;
use murmurate_train::config::{Config, PRESETS};
use murmurate_train::trainer::{Plan, Trainer};

/// Most memory that a reader may have at a time \[bytes\].
const MOST_BYTES: u64 = 256_000_000;
/// Longest time of a processor for one input: what else the machine does is no matter.
const LONGEST: Duration = Duration::from_secs(5);

/// Numbers that break arithmetic, as JSON and TOML have them.
const NUMBERS: [&str; 14] = [
    "0",
    "-1",
    "1e308",
    "-1e308",
    "1e-320",
    "1e39",
    "nan",
    "inf",
    "18446744073709551615",
    "9223372036854775807",
    "4294967296",
    "65536",
    "null",
    "\"\"",
];

fn mutations() -> usize {
    std::env::var("MURMURATE_MUTATIONS").map_or(300, |count| count.parse().expect("a number"))
}

fn file(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(name);
    fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Where a number begins and ends that is found from a random place on; `None` if there is none.
fn number(bytes: &[u8], stream: &mut Stream) -> Option<(usize, usize)> {
    let from = stream.random_range(0..bytes.len());
    let begin = from + bytes[from..].iter().position(u8::is_ascii_digit)?;
    let part = |byte: &u8| byte.is_ascii_digit() || b".eE-+_".contains(byte);
    let length = bytes[begin..].iter().position(|byte| !part(byte)).unwrap_or(bytes.len() - begin);
    Some((begin, begin + length))
}

/// Where the line begins and ends in which a random place lies.
fn line(bytes: &[u8], stream: &mut Stream) -> (usize, usize) {
    let at = stream.random_range(0..bytes.len());
    let begin = bytes[..at].iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
    (begin, at + bytes[at..].iter().position(|byte| *byte == b'\n').map_or(bytes.len() - at, |end| end + 1))
}

/// Makes one to four changes: a bit, a byte, a piece removed, repeated or taken from another file, a number replaced, a
/// line removed or repeated, the end cut.
fn mutate(bytes: &mut Vec<u8>, other: &[u8], stream: &mut Stream) {
    for _ in 0..stream.random_range(1..=4) {
        if bytes.is_empty() {
            return;
        }
        let at = stream.random_range(0..bytes.len());
        let end = (at + stream.random_range(1..16)).min(bytes.len());
        match stream.random_range(0..10) {
            0 => bytes[at] ^= 1 << stream.random_range(0..8),
            1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xc4, 0xdd, 0xff][stream.random_range(0..7)],
            2 => drop(bytes.drain(at..end)),
            3 => {
                let piece = bytes[at..end].to_vec();
                bytes.splice(at..at, piece);
            }
            4 => {
                let from = stream.random_range(0..other.len());
                let until = (from + stream.random_range(1..32)).min(other.len());
                bytes.splice(at..end, other[from..until].iter().copied());
            }
            5..=7 => {
                let with = NUMBERS[stream.random_range(0..NUMBERS.len())];
                if let Some((begin, end)) = number(bytes, stream) {
                    bytes.splice(begin..end, with.bytes());
                }
            }
            8 => {
                let (begin, end) = line(bytes, stream);
                let piece = bytes[begin..end].to_vec();
                if stream.random_range(0..2) == 0 {
                    bytes.drain(begin..end);
                } else {
                    bytes.splice(end..end, piece);
                }
            }
            _ => bytes.truncate(at),
        }
    }
}

/// Returns the time that this thread has had of a processor.
fn processor_time() -> Duration {
    let spent = nix::time::ClockId::CLOCK_THREAD_CPUTIME_ID.now().expect("Linux has this clock");
    Duration::from(spent)
}

/// Keeps an input that a reader does not survive, and returns its path.
fn kept(kind: &str, bytes: &[u8]) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("hostile-{kind}"));
    fs::write(&path, bytes).expect("it can be kept");
    path
}

/// Feeds a reader with mutations of `seeds`, all of which it accepts.
fn survives(kind: &str, seeds: &[Vec<u8>], read: fn(&[u8]) -> bool) {
    for (at, seed) in seeds.iter().enumerate() {
        assert!(read(seed), "{kind}: seed {at} is sound");
    }
    let mut stream = Seed::of_run(1).stream(&format!("hostile/{kind}"));
    let (mut accepted, count) = (0, mutations());
    for round in 0..count {
        let mut bytes = seeds[round % seeds.len()].clone();
        let other = &seeds[stream.random_range(0..seeds.len())];
        mutate(&mut bytes, other, &mut stream);
        let (began, mut outcome) = (processor_time(), Ok(false));
        let memory = allocation_counter::measure(|| outcome = catch_unwind(AssertUnwindSafe(|| read(&bytes))));
        let Ok(is_accepted) = outcome else { panic!("{kind}: a panic; see {}", kept(kind, &bytes).display()) };
        let (took, most) = (processor_time() - began, memory.bytes_max);
        assert!(took < LONGEST, "{kind}: {took:?}; see {}", kept(kind, &bytes).display());
        assert!(most < MOST_BYTES, "{kind}: {most} bytes; see {}", kept(kind, &bytes).display());
        accepted += usize::from(is_accepted);
    }
    println!("{kind}: {accepted} of {count} mutations are accepted");
    assert!(accepted < count, "{kind}: the mutations bite");
}

#[test]
fn policy_files() {
    let names = ["python_full", "python_published", "conv_gatv2", "conv_three_hops", "conv_transformer", "memory"];
    let seeds = names.map(|name| file(&format!("tests/data/{name}.safetensors")));
    survives("policy", &seeds, readers::policy);
}

#[test]
fn contracts_of_policies() {
    let names = ["recurrent", "lidar", "wide", "scout", "id-one-hot"];
    let seeds = names.map(|name| file(&format!("tests/onnx/data/{name}.policy.toml")));
    survives("contract", &seeds, contracts::contract);
}

#[test]
fn graphs_of_policies() {
    survives("graph", &[file("tests/onnx/data/recurrent.onnx")], contracts::graph);
}

#[test]
fn frames_of_a_policy_in_python() {
    use murmurate_onnx::Contract;
    use murmurate_onnx::frames::{Kind, PROTOCOL, frame};
    let contract = String::from_utf8(file("tests/onnx/data/recurrent.policy.toml")).expect("text");
    let contract = Contract::parse(&contract).expect("it is sound");
    let floats = contract.action_floats() + contract.message.floats + contract.state_floats();
    let greeting = format!("{{\"protocol\":{PROTOCOL},\"name\":\"A\",\"digest\":\"00\",\"two\":false}}");
    let hello = frame(Kind::Hello, 1, greeting.as_bytes()).expect("it is short");
    let answer = frame(Kind::Answer, 2, &0.5_f32.to_le_bytes().repeat(floats)).expect("it is short");
    survives("python", &[[hello, answer].concat()], contracts::python);
}

#[test]
fn roles_files() {
    survives("roles", &[file("examples/roles.toml")], contracts::roles);
}

#[test]
fn team_files() {
    let names = ["mixed", "offboard", "onboard-adhoc", "onboard-wlan", "robomaster-optitrack", "rtk", "centralized"];
    survives("team", &names.map(|name| file(&format!("teams/{name}.toml"))), readers::team);
}

#[test]
fn deployment_files() {
    let modes = ["sim", "centralized", "offboard", "onboard-infra", "onboard-adhoc"];
    let preset = |mode| Deployment::preset(mode, 5).expect("it is a mode");
    let mut seeds: Vec<Vec<u8>> = modes.map(|mode| preset(mode).to_toml().into_bytes()).to_vec();
    let slow = preset("onboard-adhoc").impaired(Some(0.05), Some(0.1), Impair::Latent).expect("it has links");
    seeds.push(slow.to_toml().into_bytes());
    survives("deployment", &seeds, readers::deployment);
}

#[test]
fn fault_plans() {
    let deployment = Deployment::preset("onboard-adhoc", 5).expect("it is a mode");
    let plan = |seed| FaultPlan::random(seed, &deployment.targets(), Span::from_millis(60_000)).to_toml().into_bytes();
    survives("faults", &(1..6).map(plan).collect::<Vec<_>>(), readers::faults);
}

#[test]
fn conditions_files() {
    let some = Conditions { lag_s: Some(0.5), slip: Some(0.1), slip_s: Some(1.0), ..Conditions::default() };
    let all = Conditions { plant: Some("rigid".to_owned()), delay_s: Some(0.02), loss: Some(0.1), ..some.clone() };
    survives("conditions", &[some, all].map(|file| file.to_toml().into_bytes()), readers::conditions);
}

#[test]
fn radio_files() {
    let seeds: Vec<Vec<u8>> = radio::PRESETS
        .iter()
        .map(|name| toml::to_string(&Radio::preset(name).expect("it is a preset")).expect("TOML").into_bytes())
        .collect();
    survives("radio", &seeds, readers::radio);
}

#[test]
fn episodes_files() {
    let robot = |x: f32| format!("{{\"start\": [{x}, -1.5], \"goal\": [{x}, 1.5]}}");
    let robots = [-1.0, -0.5, 0.0, 0.5, 1.0].map(robot).join(", ");
    let text = format!("{{\"episodes\": [[{robots}], [{robots}]]}}");
    survives("episodes", &[text.into_bytes()], readers::episodes);
}

#[test]
fn training_configurations() {
    let seeds: Vec<Vec<u8>> = PRESETS.iter().map(|(_, text)| text.as_bytes().to_vec()).collect();
    survives("training", &seeds, trainings::training);
}

/// A training that is quick to restore.
fn small() -> Trainer {
    let mut config = Config::preset("robust").expect("it is a preset");
    (config.ppo.environments, config.ppo.decisions, config.ppo.minibatch) = (40, 4, 80);
    (config.policy.encoder, config.policy.update) = (vec![6, 6], vec![8]);
    config.policy.message = vec![8, 8, 8];
    let plan = Plan { scenario: "passage".to_owned(), preset: "robust".to_owned(), config, seed: 1, task: None };
    Trainer::new(plan, &murmurate::registry::Registry::builtin()).expect("it is sound")
}

#[test]
fn checkpoints() {
    survives("checkpoint", &[small().checkpoint()], trainings::checkpoint);
}

#[test]
fn checkpoints_of_imitation() {
    use murmurate_train::imitation::config::Config;
    use murmurate_train::imitation::trainer::{Plan, Trainer};
    let config = Config::from_toml(&String::from_utf8(file("policies/flocking.toml")).expect("text"));
    let plan = Plan {
        scenario: "flocking".to_owned(),
        preset: "imitation".to_owned(),
        config: config.expect("it is sound"),
        seed: 1,
    };
    let trainer = Trainer::new(plan, &murmurate::registry::Registry::builtin()).expect("it is sound");
    survives("imitation", &[trainer.checkpoint()], trainings::imitation);
}

#[test]
fn the_journal_of_a_study() {
    let study = trainings::study();
    let job = Job { column: 0, policy: 0, repeat: 0 };
    let record = TrialRecord::of(&study, job, &study.trial(job).run());
    let json = serde_json::to_vec(&record).expect("a record is JSON");
    survives("journal", &[json], trainings::journal);
}

#[test]
fn datagrams_of_a_tracker() {
    let seed = |version: fake::Version| {
        let bodies = vec![
            fake::Body::standing("robot-0", 7, [0.1, 0.1, 0.0], 0.5),
            fake::Body::standing("robot-1", 8, [2.0, 0.1, -3.0], 0.0),
        ];
        let scene = |number: i32| fake::Scene {
            number,
            stamp_s: f64::from(number) * 0.01,
            models_changed: false,
            bodies: bodies.clone(),
            extras: 3,
        };
        let mut packets = vec![fake::server_info(version, true, 1511), fake::model(version, &bodies, 3)];
        packets.extend((0..10).map(|number| fake::frame(version, &scene(number))));
        readers::joined(&packets)
    };
    let seeds: Vec<Vec<u8>> = [[3, 0], [3, 1], [4, 0], [4, 1], [4, 2]].map(seed).to_vec();
    survives("natnet", &seeds, readers::natnet);
}

#[test]
fn lines_of_a_receiver() {
    let line = |second: u32| {
        format!(
            "{{\"class\":\"TPV\",\"mode\":3,\"status\":3,\"time\":\"2026-11-22T12:00:{second:02}.000Z\",\"lat\":52.2,\
             \"lon\":0.1218,\"altHAE\":58.0,\"track\":90.0,\"speed\":0.5,\"epx\":0.4}}\r\n{{\"class\":\"GST\",\"time\":\
             \"2026-11-22T12:00:{second:02}.000Z\",\"lat\":0.02,\"lon\":0.02}}\r\n"
        )
    };
    let text: String = (1..4).map(line).collect();
    survives("gpsd", &[text.into_bytes()], readers::gpsd);
}

#[test]
fn lines_of_a_user_s_program() {
    let line = "{\"robot\": 0, \"x\": 0.5, \"y\": -1.0, \"vx\": 0.0, \"vy\": 0.1, \"heading\": 0.25, \
                \"stamp_s\": 1.5, \"position_m\": 0.01}\n";
    survives("lines", &[format!("{line}{}", line.replace("1.5", "1.52")).into_bytes()], readers::lines);
}
