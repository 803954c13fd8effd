//! Programs of a host's driver and source that are halted: robots stand in time, an emergency stop works meanwhile,
//! commands that have waited drive no robot, and the team goes on.

use std::net::UdpSocket;
use std::path::Path;
use std::time::{Duration, Instant};

use murmurate_report::event::HostEvent;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use serde_json::Value;
use tempfile::TempDir;

use crate::alone;
use crate::crew::{Crew, Heard, Said, folder, report};
use crate::program::lateness::Lateness;
use crate::program::skip::skip;
use crate::program::{murmurate, run, text};

/// Age of a reading after which a robot stands \[s\]. Beside other tests a Python program can be late.
const OWN_STATE_S: f64 = 0.3;
/// A control tick \[s\].
const TICK_S: f64 = 0.05;
/// Longest time after which a program that does not read is replaced \[s\]: ten looks of 0.1 s and one before them, and
/// its end, with a search for what it has left.
const UNREAD_S: f64 = 1.1 + 0.2;
/// Allowed lateness of a process; that of the machine is measured.
const SLACK_S: f64 = 0.1;

/// Command that a driver's program has read.
struct Told {
    at: Instant,
    pid: i32,
    robot: u16,
    moves: bool,
}

impl Told {
    fn read(heard: &Heard) -> Option<Told> {
        let Said::Log(line) = &heard.said else { return None };
        let told: Value = serde_json::from_str(line).ok()?;
        Some(Told {
            at: heard.at,
            pid: i32::try_from(told["drives"].as_i64()?).ok()?,
            robot: u16::try_from(told["robot"].as_u64()?).ok()?,
            moves: told["vx"] != 0.0 || told["vy"] != 0.0,
        })
    }
}

/// A team of two robots on one host, and a host of the state server.
struct Team {
    crew: Crew,
    file: String,
    /// Process that tracks the robots.
    tracker: Pid,
    _folder: TempDir,
}

impl Team {
    fn start(number: u16) -> Team {
        // The port is free again once this socket is dropped.
        let port = UdpSocket::bind("127.0.0.1:0").expect("a socket").local_addr().expect("bound").port();
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("tests/peers/bench.py");
        let command =
            |part: &str| format!("[\"python3\", \"-SE\", \"{}\", \"{part}\", \"{port}\", \"told\"]", program.display());
        let (_folder, file) = folder(&format!(
            "team = {number}\nkey_file = \"team.key\"\nscenario = \"swap\"\npolicy = \"orca\"\nepisodes = 1000\n\
             [safety]\nown_state_s = {OWN_STATE_S}\nlate_tick_s = 1.0\n\
             [link.air]\ninterface = \"lo\"\ngroup = \"239.255.77.62:{}\"\n\
             [deployment]\nmode = \"bench\"\nrobots = 2\nplacement = \"drive\"\nstepping = \"seeded\"\n\
             [deployment.body]\nspeed_m_s = 0.4\n\
             [[deployment.host]]\nname = \"robots\"\nagents = [[0], [1]]\nactuates = [0, 1]\nlocalizes = [0, 1]\n\
             driver = {{ name = \"program\", command = {} }}\nsource = {{ name = \"program\", command = {} }}\n\
             [[deployment.host]]\nname = \"pc\"\nstate_server = true\n\
             [[deployment.link]]\nname = \"air\"\ncarries = [\"reading\", \"heartbeat\", \"mode\", \"stop\"]\n",
            40_000 + number,
            command("drive"),
            command("track"),
        ));
        let path = file.clone();
        let mut crew = Crew::new(move |host| murmurate(&["host", &path, "--host", host, "--json"]));
        crew.start("robots");
        let tracker = crew.until("a tracker", |heard| {
            let Said::Log(line) = &heard.said else { return None };
            serde_json::from_str::<Value>(line).ok()?["tracks"].as_i64()
        });
        crew.start("pc");
        Team { crew, file, tracker: Pid::from_raw(i32::try_from(tracker).expect("a process")), _folder }
    }

    /// Waits until both robots move, and returns the processes that drive them.
    fn moves(&self) -> [Pid; 2] {
        let mut pids = [None; 2];
        self.crew.until("both robots move", |heard| {
            let told = Told::read(heard)?;
            pids[usize::from(told.robot)] = told.moves.then_some(Pid::from_raw(told.pid));
            Some([pids[0]?, pids[1]?])
        })
    }

    /// Runs a command of an operator, which has to succeed.
    fn operate(&self, words: &[&str]) {
        let output = run(&[&[words[0], &*self.file], &words[1..]].concat());
        let said = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{words:?}: {said}");
    }
}

/// Whether there is a Python; otherwise the test skips, and says so.
fn has_python() -> bool {
    let has = std::process::Command::new("python3").arg("--version").output().is_ok_and(|said| said.status.success());
    if !has {
        skip("python", "the robots are a Python program, and there is no python3");
    }
    has
}

#[test]
fn a_driver_that_is_halted_is_replaced_in_time_and_drives_nobody_by_what_has_waited() {
    let _alone = alone();
    if !has_python() {
        return;
    }
    let team = Team::start(785);
    for stopped in [false, true] {
        let [halted, other] = team.moves();
        let machine = Lateness::watch();
        kill(halted, Signal::SIGSTOP).expect("it runs");
        let halts = Instant::now();
        // The host confirms a stop while one of its programs is halted.
        let asked = stopped.then(|| team.operate(&["stop"])).map(|()| Instant::now());
        let (mut silent, mut faults) = (None, 0);
        team.crew.until("a line that robot 0 stands, and its fault in the counts", |heard| {
            match (&heard.said, Told::read(heard)) {
                (_, Some(told)) => {
                    assert!(told.pid != halted.as_raw() || told.at <= halts + Duration::from_secs_f64(SLACK_S));
                    let late = asked.is_some_and(|asked| told.at > asked + Duration::from_secs_f64(SLACK_S));
                    assert!(!late || !told.moves, "robot {} moves under a stop", told.robot);
                }
                (Said::Log(line), None) if line.contains("robot 0 stands: its driver has ended") => {
                    silent = Some(heard.at.saturating_duration_since(halts).as_secs_f64());
                }
                (Said::Event(HostEvent::Counted(counted)), None) => {
                    faults = serde_json::to_value(&counted.hardware).expect("JSON")[0]["faults"].as_u64().unwrap_or(0);
                }
                _ => {}
            }
            (silent.is_some() && faults > u64::from(stopped)).then_some(())
        });
        let (silent_s, machine_s) = (silent.expect("it is silent"), machine.end().as_secs_f64());
        report(&format!("a halted driver is replaced after {silent_s:.3} s; up to {machine_s:.3} s by the machine"));
        assert!(silent_s <= UNREAD_S + SLACK_S + machine_s, "{silent_s} s");
        assert!(kill(halted, None).is_err(), "the halted program is killed");
        if stopped {
            team.operate(&["stop", "--rearm"]);
            team.operate(&["resume"]);
        }
        let [new, same] = team.moves();
        assert!(new != halted && same == other, "{halted} {other}, {new} {same}");
    }
}

#[test]
fn robots_whose_tracker_is_halted_stand_in_time_and_go_on_with_it() {
    let _alone = alone();
    if !has_python() {
        return;
    }
    let team = Team::start(786);
    let before = team.moves();
    let machine = Lateness::watch();
    kill(team.tracker, Signal::SIGSTOP).expect("it runs");
    let halts = Instant::now();
    let (mut last_s, mut standing) = (0.0_f64, [false; 2]);
    let longest = Duration::from_secs_f64(2.0);
    team.crew.until("two seconds without readings", |heard| {
        if let Some(told) = Told::read(heard) {
            standing[usize::from(told.robot)] = !told.moves;
            if told.moves {
                last_s = last_s.max(told.at.saturating_duration_since(halts).as_secs_f64());
            }
        }
        (heard.at >= halts + longest).then_some(())
    });
    let machine_s = machine.end().as_secs_f64();
    report(&format!("without readings they move for {last_s:.3} s; up to {machine_s:.3} s by the machine"));
    assert!(last_s <= OWN_STATE_S + TICK_S + SLACK_S + machine_s, "{last_s} s");
    assert_eq!(standing, [true; 2], "they are told to stand");
    // The host is no slower for it.
    team.operate(&["stop"]);
    team.operate(&["stop", "--rearm"]);
    kill(team.tracker, Signal::SIGCONT).expect("it runs");
    team.operate(&["resume"]);
    assert_eq!(team.moves(), before, "by the same programs");
}
