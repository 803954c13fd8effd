//! The network study between five network namespaces on one bridge. With each sender shaped by `tc tbf` and each
//! receiver losing by nftables it is compared with the emulation of the same; without, it is interrupted, continued,
//! and a radio is fitted to it. Needs root, `ip`, `tc` and `nft`; skips with a notice where it cannot run.
use crate::program::lateness::Lateness;
use crate::program::skip::skip;
use crate::{alone, beside};
use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;

/// Messages a second, each to four receivers by unicast: below and above the 263 that five links of 1 Mbit/s carry.
const RATES: [f64; 2] = [240.0, 400.0];
const STATIONS: usize = 5;
/// Payload of a message, which makes a datagram of 552 bytes, 594 on the link.
const BYTES: &str = "512";
const MTU: &str = "760";
const MEDIUM: &str = "rate_bit_s = 1e6\nburst_bytes = 774\nqueue_bytes = 12000\nloss = 0.16\n";
const SHAPE: [&str; 6] = ["rate", "1mbit", "burst", "774", "limit", "12000"];

/// Namespaces of this process, removed at its end.
struct Lab(String);

/// Links of a lab.
#[derive(Clone, Copy, PartialEq)]
enum Links {
    Plain,
    Shaped,
}

impl Lab {
    /// Builds the lab; `None` where that is not permitted.
    fn build(links: Links) -> Option<Lab> {
        let lab = Lab(format!("mnet{}", std::process::id()));
        let tools = ["tc", "nft"].iter().all(|tool| run(tool, &["-V"]) || run(tool, &["-v"]));
        if !tools || !run("ip", &["netns", "add", &lab.space("hub")]) {
            skip("namespaces", "a radio in namespaces needs root and the programs 'ip', 'tc' and 'nft'");
            return None;
        }
        let hub = lab.space("hub");
        assert!(run("ip", &["-n", &hub, "link", "add", "bridge", "mtu", MTU, "type", "bridge", "mcast_snooping", "0"]));
        assert!(run("ip", &["-n", &hub, "addr", "add", "10.81.0.1/24", "dev", "bridge"]));
        assert!(run("ip", &["-n", &hub, "link", "set", "bridge", "up"]));
        for station in 0..STATIONS {
            let (space, port) = (lab.space(&format!("robot-{station}")), format!("port{station}"));
            let address = format!("10.81.0.{}/24", 10 + station);
            assert!(run("ip", &["netns", "add", &space]));
            let pair = ["-n", &space, "link", "add", "eth0", "mtu", MTU, "type", "veth"];
            let pair = [&pair[..], &["peer", "name", &port, "mtu", MTU, "netns", &hub]].concat();
            assert!(run("ip", &pair));
            assert!(run("ip", &["-n", &hub, "link", "set", &port, "master", "bridge", "up"]));
            assert!(run("ip", &["-n", &space, "addr", "add", &address, "dev", "eth0"]));
            assert!(run("ip", &["-n", &space, "link", "set", "lo", "up"]));
            assert!(run("ip", &["-n", &space, "link", "set", "eth0", "up"]));
            if links == Links::Plain {
                continue;
            }
            let shape = ["netns", "exec", &space, "tc", "qdisc", "add", "dev", "eth0", "root", "tbf"];
            assert!(run("ip", &[&shape[..], &SHAPE[..]].concat()), "tbf");
            // Only UDP is measured; the coordinator's connection is spared.
            let rules = "table netdev loss {\nchain in {\n\
                         type filter hook ingress device \"eth0\" priority 0;\n\
                         ip protocol udp numgen random mod 100 < 16 drop\n}\n}\n";
            assert!(run("ip", &["netns", "exec", &space, "nft", rules]), "nft");
        }
        Some(lab)
    }

    fn space(&self, name: &str) -> String {
        format!("{}-{name}", self.0)
    }

    /// Returns the program in a namespace.
    fn program(&self, space: &str, args: &[&str]) -> Command {
        // With a high priority, to measure the link and not the wait for a processor.
        let mut command = Command::new("nice");
        command.args(["-n", "-15", "ip", "netns", "exec", &self.space(space)]);
        command.args([env!("CARGO_BIN_EXE_murmurate"), "study", "network"]);
        command.args(args).stdin(Stdio::null());
        command
    }
}

impl Drop for Lab {
    fn drop(&mut self) {
        let stations = (0..STATIONS).map(|station| format!("robot-{station}"));
        for name in stations.chain(["hub".to_owned()]) {
            run("ip", &["netns", "del", &self.space(&name)]);
        }
    }
}

fn run(program: &str, args: &[&str]) -> bool {
    let mut command = Command::new(program);
    command.args(args).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// Process that is killed at the end of the test.
struct Process(Option<Child>);

impl Process {
    fn start(command: &mut Command) -> Process {
        Process(Some(command.spawn().expect("it starts")))
    }

    fn child(&mut self) -> &mut Child {
        self.0.as_mut().expect("it has not ended")
    }

    /// Waits for the process to end.
    fn end(mut self) -> Output {
        self.0.take().expect("it has not ended").wait_with_output().expect("it ends")
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

/// Maximum number of measurements: a busy machine may delay datagrams more than the links, but seldom three times.
const ATTEMPTS: usize = 3;

/// Team of five in its own folder, with its participants.
struct Team {
    folder: TempDir,
}

impl Team {
    fn new() -> Team {
        let team = Team { folder: tempfile::tempdir().unwrap() };
        let key = ["key", "new", "--out", &team.path("team.key")];
        assert!(Command::new(env!("CARGO_BIN_EXE_murmurate")).args(key).status().unwrap().success());
        let peers = |port: u16| {
            let peer = |station: usize| format!("robot-{station} = \"10.81.0.{}:{port}\"\n", 10 + station);
            (0..STATIONS).map(peer).collect::<String>() + &format!("world = \"10.81.0.1:{port}\"\n")
        };
        let link = |name: &str, port: u16| {
            let peers = peers(port);
            format!("[link.{name}]\ninterface = \"eth0\"\ntransport = \"unicast\"\n[link.{name}.peers]\n{peers}")
        };
        let links = link("ad-hoc", 7711) + &link("infra", 7712) + &link("wires", 7713);
        let text = "team = 81\nkey_file = \"team.key\"\nmode = \"onboard-adhoc\"\n".to_owned() + &links;
        fs::write(team.path("team.toml"), text).unwrap();
        fs::write(team.path("medium.toml"), MEDIUM).unwrap();
        team
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_string_lossy().into_owned()
    }

    /// Starts the program of one host, which prints the case that it measures.
    fn participant(&self, lab: &Lab, station: usize) -> Process {
        let name = format!("robot-{station}");
        let args = ["--live", &self.path("team.toml"), "--coordinator", COORDINATOR, "--host", &name];
        Process::start(lab.program(&name, &args).stdout(Stdio::null()).stderr(Stdio::piped()))
    }

    fn participants(&self, lab: &Lab) -> Vec<Process> {
        (0..STATIONS).map(|station| self.participant(lab, station)).collect()
    }

    fn coordinator(&self, lab: &Lab, args: &[&str]) -> Command {
        lab.program(
            "hub",
            &[&["--live", &self.path("team.toml"), "--coordinator", COORDINATOR, "--quiet"], args].concat(),
        )
    }
}

const COORDINATOR: &str = "10.81.0.1:7790";

#[test]
fn a_measurement_between_namespaces_agrees_with_its_emulation() {
    let _alone = alone();
    let mut found = Vec::new();
    for _ in 0..ATTEMPTS {
        match disagreements() {
            Some(found) if found.is_empty() => return,
            Some(more) => found.push(more),
            None => return,
        }
    }
    panic!("never alike: {found:#?}");
}

#[test]
fn a_measurement_continues_after_an_interruption_and_a_radio_is_fitted_to_it() {
    // No time is judged here.
    let _beside = beside();
    let Some(lab) = Lab::build(Links::Plain) else { return };
    let team = Team::new();
    let (out, fitted) = (team.path("out"), team.path("room.toml"));
    let sweep = ["--medium", "wifi", "--rates", "60,120,200", "--reliability", "repeat", "--addressing", "unicast"];
    let args = [&sweep[..], &["--seconds", "2", "--fit", &fitted, "--out", &out, "--json"]].concat();

    let mut hosts = team.participants(&lab);
    let mut command = team.coordinator(&lab, &args);
    let mut coordinator = Process::start(command.stdout(Stdio::piped()).stderr(Stdio::piped()));
    // The first case is recorded when the second begins.
    let mut told = BufReader::new(hosts[0].child().stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(told.any(|line| line.starts_with("case 1:")), "the second case begins");
    assert!(run("kill", &["-INT", &coordinator.child().id().to_string()]));
    let output = coordinator.end();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(130), "{said}");
    assert!(said.contains("2 of 6 cases are kept"), "{said}");
    let kept = |at: usize| fs::read(team.folder.path().join(format!("out/cases/live-{at:04}.json")));
    let first = kept(0).unwrap();
    assert!(kept(1).is_ok() && kept(2).is_err());
    assert!(fs::metadata(&fitted).is_err(), "nothing is fitted to a part");

    let _hosts = team.participants(&lab);
    let machine = Lateness::watch();
    let output = team.coordinator(&lab, &args).output().unwrap();
    let machine_s = machine.end().as_secs_f64();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let rows = report["rows"].as_array().unwrap();
    let live: Vec<&Value> = rows.iter().filter(|row| row["source"] == "live").collect();
    assert_eq!((rows.len(), live.len()), (6, 3));
    assert!(live.iter().all(|row| row["delivered"].as_f64().unwrap() > 0.99), "{live:#?}");
    assert!(kept(0).unwrap() == first, "what was measured is not measured again");
    // A bridge is not a radio, but the result of the fit is a valid one.
    let fit = &report["fit"];
    assert!(fit["rows"] == 3 && fit["rate"].is_string() && fit["residual_shares"].is_number(), "{fit}");
    assert!(report["uncertainty_s"].as_f64().is_some_and(|off| off > 0.0 && off < 0.01 + machine_s), "{report}");
    let radio = fs::read_to_string(&fitted).unwrap();
    assert!(radio.starts_with('#') && radio.contains("noise_loss"), "{radio}");
    let sim = ["sim", "--mode", "onboard-adhoc", "--radio", &fitted, "--episodes", "1", "--repeats", "1", "--json"];
    let output = Command::new(env!("CARGO_BIN_EXE_murmurate")).args(sim).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Returns the differences between a measurement and its emulation; `None` where it cannot run.
fn disagreements() -> Option<Vec<String>> {
    let lab = Lab::build(Links::Shaped)?;
    let team = Team::new();
    let medium = team.path("medium.toml");
    let _stations = team.participants(&lab);
    let rates = RATES.map(|rate| rate.to_string()).join(",");
    let out = std::env::var("NETWORK_LIVE_OUT").unwrap_or_else(|_| team.path("out"));
    let sweep = ["--medium", &medium, "--rates", &rates, "--reliability", "best-effort", "--addressing", "unicast"];
    let more = ["--bytes", BYTES, "--seconds", "8", "--json", "--out", &out];
    let output = team.coordinator(&lab, &[&sweep[..], &more].concat()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let row = |source: &str, rate: f64| {
        let rows = report["rows"].as_array().unwrap();
        rows.iter().find(|row| row["source"] == source && row["rate"] == rate).unwrap().clone()
    };
    let mut apart = Vec::new();
    for rate in RATES {
        let (live, emulated) = (row("live", rate), row("emulated", rate));
        let pair = |field: &str| [&live, &emulated].map(|row| row[field].as_f64().unwrap());
        let all = ["delivered", "p50_ms", "p90_ms", "p99_ms", "age_p50_ms"].map(|field| (field, pair(field)));
        let _ = writeln!(std::io::stderr(), "{rate} messages/s, live and emulated: {all:?}");
        let [measured, reckoned] = pair("delivered");
        if (measured - reckoned).abs() >= 0.02 {
            apart.push(format!("delivered at {rate}: {measured} and {reckoned}"));
        }
        for field in ["p50_ms", "p90_ms"] {
            let [measured, reckoned] = pair(field);
            if (measured / reckoned - 1.0).abs() >= 0.15 {
                apart.push(format!("{field} at {rate}: {measured} and {reckoned}"));
            }
        }
    }
    Some(apart)
}
