//! A team of processes in network namespaces, and an operator beside it.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::rc::Rc;
use std::time::{Duration, Instant};

use crate::crew::{Crew, Heard, Said, folder};
use crate::lab;
use crate::lab::{Lab, Machine};
use crate::program::lateness::Lateness;
use crate::program::skip::skip;
use crate::program::text;
use murmurate::deploy::Deployment;
use murmurate::messages::wire::Kind;
use nix::sys::signal::Signal;

/// Share of frames that each receiver loses \[%\].
const LOSS_PERCENT: u32 = 20;
/// Longest times from the start of the operator's process until the motors stand still, and until robots confirm, on a
/// machine that has nothing else to do.
pub const STANDS: Duration = Duration::from_millis(200);
pub const CONFIRMED_S: f64 = 0.5;
pub const WORST_S: f64 = 1.0;
/// A step of the World, with the allowed lateness of its line.
pub const STEP: Duration = Duration::from_millis(60);
/// Time after a re-arm for which no robot may move.
const HELD: Duration = Duration::from_millis(1500);
pub const OPERATOR: &str = "operator";

/// Environment variables of started processes, by host.
pub type Clocks = Rc<RefCell<BTreeMap<String, Vec<(String, String)>>>>;

/// Team of one of the files in `teams/`, with its own key and interfaces.
pub struct Case {
    pub mode: &'static str,
    pub file: &'static str,
    pub unicast: bool,
    /// Whether a relay lies between the World and all others on the wires.
    pub relayed: bool,
}

/// Running team.
pub struct Running {
    pub lab: Lab,
    pub crew: Crew,
    pub file: String,
    pub sets: Vec<String>,
    /// Name of the state server's host.
    pub server: String,
    /// Variables that set the clocks of hosts at their start.
    pub clocks: Clocks,
    _folder: tempfile::TempDir,
}

/// Result of one stop.
pub struct Stopped {
    /// Time from the start of the operator's process until the motors stood still.
    pub stood: Duration,
    /// Time until all robots had confirmed, by the operator's clock \[s\].
    pub took_s: f64,
    /// What the machine has added to these at most: its lateness meanwhile, and the start of a process.
    pub machine: Duration,
}

impl Case {
    pub fn start(&self) -> Option<Running> {
        let deployment = Deployment::preset(self.mode, 5).expect("it is a preset");
        let stop = deployment.links.iter().find(|link| link.carries.contains(&Kind::Stop)).expect("one carries it");
        let hosts: Vec<String> = deployment.hosts.iter().map(|host| host.name.clone()).collect();
        let all: Vec<(String, String)> = deployment.links.iter().map(|l| (l.name.clone(), l.name.clone())).collect();
        let mut machines: Vec<Machine> = hosts.iter().map(|host| (host.clone(), all.clone())).collect();
        if self.relayed {
            let world = machines.iter_mut().find(|(name, _)| name == "world").expect("there is one");
            let wires = world.1.iter_mut().find(|(interface, _)| interface == "wires").expect("it has them");
            wires.1 = "beyond".to_owned();
            let sides = [("left", "wires"), ("right", "beyond")].map(|(side, to)| (side.to_owned(), to.to_owned()));
            machines.push(("relay".to_owned(), sides.to_vec()));
        }
        machines.push((OPERATOR.to_owned(), vec![(stop.name.clone(), stop.name.clone())]));
        let lab = Lab::build("stop", machines)?;
        if !self.relayed && !lab.lose(LOSS_PERCENT) {
            skip("nft", "frames are lost by the program 'nft', which is not there");
            return None;
        }
        let mut sets = vec!["episodes=100000".to_owned()];
        for (at, link) in deployment.links.iter().enumerate() {
            sets.push(format!("link.{}.interface={}", link.name, link.name));
            let addressed = self.unicast || (self.file == "onboard-wlan" && link.name == "wires");
            if addressed {
                sets.push(format!("link.{}.transport=unicast", link.name));
                let peer = |host: &String| {
                    format!("link.{}.peers.{host}={}:{}", link.name, lab.address(host, &link.name), 7710 + at)
                };
                sets.extend(hosts.iter().map(peer));
            }
        }
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(format!("teams/{}.toml", self.file));
        let source = std::fs::read_to_string(source).expect("it is there");
        // Fields of single hosts name the interfaces of real machines.
        let source = source.split("\n# The PC is cabled").next().expect("there is a beginning");
        let (folder, file) = folder(&source.replace("key_file = \"team.key\"\n", ""));
        let server = deployment.hosts.iter().find(|host| host.state_server).expect("there is one").name.clone();
        let (spaces, path, flags) = (
            hosts.iter().map(|host| (host.clone(), lab.space(host))).collect::<BTreeMap<_, _>>(),
            file.clone(),
            words(&file, &sets),
        );
        let key = Path::new(&path).with_file_name("team.key");
        let set = Rc::new(RefCell::new(BTreeMap::new()));
        let clocks: Clocks = Rc::clone(&set);
        let mut crew = Crew::new(move |host| {
            let mut command = lab::on(&spaces[host], env!("CARGO_BIN_EXE_murmurate"));
            command.arg("host").args(&flags).args(["--host", host, "--json", "--key-file"]).arg(&key);
            if host == "world" {
                command.args(["--trajectories", "/dev/stdout"]);
            }
            if let Some(clock) = clocks.borrow().get(host) {
                command.envs(clock.iter().cloned());
            }
            command.stdin(Stdio::null());
            command
        });
        let names: Vec<&str> = hosts.iter().map(String::as_str).collect();
        names.iter().for_each(|host| crew.start(host));
        crew.ready(&names);
        Some(Running { lab, crew, file, sets, server, clocks: set, _folder: folder })
    }
}

fn words(file: &str, sets: &[String]) -> Vec<String> {
    let sets = sets.iter().flat_map(|set| ["--set".to_owned(), set.clone()]);
    std::iter::once(file.to_owned()).chain(sets).collect()
}

impl Running {
    /// Returns a command of the operator.
    pub fn command(&self, words_of: &[&str]) -> Command {
        let mut command = self.lab.command(OPERATOR, env!("CARGO_BIN_EXE_murmurate"));
        let key = Path::new(&self.file).with_file_name("team.key");
        command.arg(words_of[0]).args(words(&self.file, &self.sets)).args(&words_of[1..]);
        command.arg("--json").arg("--key-file").arg(key).stdin(Stdio::null());
        command
    }

    /// Runs a command of the operator; returns its output and the time of its start.
    pub fn operator(&self, words: &[&str]) -> (Output, Instant) {
        let mut command = self.command(words);
        let began = Instant::now();
        (command.output().expect("the program starts"), began)
    }

    pub fn succeeds(&self, words: &[&str]) -> (serde_json::Value, Instant) {
        let (output, began) = self.operator(words);
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(0), "{words:?}: {out}{err}");
        (serde_json::from_str(&out).expect("one JSON object"), began)
    }

    /// Waits until every robot was driven at least once from now on.
    pub fn driven(&self) {
        let mut waiting = vec![0, 1, 2, 3, 4];
        self.crew.row("all robots are driven", |row, _| {
            waiting.retain(|robot| !(*robot == row.robot && row.is_driven()));
            waiting.is_empty().then_some(())
        });
    }

    /// Returns the time that this machine takes now to start the program.
    pub fn start_of_a_process(&self) -> Duration {
        let began = Instant::now();
        let output = self.lab.command(OPERATOR, env!("CARGO_BIN_EXE_murmurate")).arg("--version").output();
        assert!(output.expect("the program starts").status.success());
        began.elapsed()
    }

    /// Stops the team; returns when it stood still and when it had confirmed.
    pub fn stop(&self) -> Stopped {
        let (start, lateness) = (self.start_of_a_process(), Lateness::watch());
        let (said, began) = self.succeeds(&["stop"]);
        let deadline = Instant::now() + STEP;
        // The first step of the World after which no robot is driven any more.
        let mut stood = None;
        self.crew.until("the World steps on", |heard: &Heard| {
            if let Said::Row(row) = &heard.said
                && heard.at > began
            {
                stood = if row.is_driven() { None } else { stood.or(Some(heard.at)) };
            }
            (heard.at >= deadline).then_some(())
        });
        let stood = stood.expect("the World steps on and nobody is driven");
        let took_s = said["took_s"].as_f64().expect("it took");
        Stopped { stood: stood.saturating_duration_since(began), took_s, machine: start + lateness.end() }
    }

    /// Checks that no robot is driven for a while.
    pub fn nobody_moves(&self, what: &str) {
        let deadline = Instant::now() + HELD;
        self.crew.until("time goes by", |heard: &Heard| {
            if let Said::Row(row) = &heard.said {
                assert!(!row.is_driven(), "{what}: robot {} is driven", row.robot);
            }
            (heard.at >= deadline).then_some(())
        });
    }

    /// Runs one stop, re-arm and resume; every second time the state server is killed and restarted while the team is
    /// held.
    pub fn cycle(&mut self, number: usize) -> Stopped {
        let kill = number % 2 == 1;
        self.driven();
        // Anywhere within a step of the World.
        self.crew.pass(Duration::from_millis(17 * number as u64 % 50));
        let stopped = self.stop();
        let (said, _) = self.succeeds(&["stop", "--rearm"]);
        assert_eq!(said["state"], "held");
        if kill {
            let server = self.server.clone();
            self.crew.signal(&server, Signal::SIGKILL);
            self.crew.ended(&server);
            self.crew.start(&server);
            self.crew.ready(&[&server]);
        }
        self.nobody_moves("after the re-arm");
        let deadline = Instant::now() + Duration::from_secs(15);
        // A restarted state server must receive every robot first, and until then refuses with the missing ones.
        loop {
            let (output, _) = self.operator(&["resume"]);
            if output.status.code() == Some(0) {
                return stopped;
            }
            assert!(kill && Instant::now() < deadline, "{}{}", text(&output.stdout), text(&output.stderr));
            assert!(text(&output.stderr).contains("refused: robot"), "{}", text(&output.stderr));
        }
    }
}
