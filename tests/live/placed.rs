//! Odometry that fails on real processes and sockets, and people who say where the robot is: no robot moves in between,
//! and the episode is no success.

use std::fs::write;
use std::net::UdpSocket;
use std::path::Path;
use std::time::{Duration, Instant};

use murmurate::random::{RngExt, Seed};
use murmurate::scenario::judge::Verdict;
use murmurate_report::event::HostEvent;
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::beside;
use crate::crew::{Crew, Said};
use crate::program::skip::skip;
use crate::program::{murmurate, run, text};

/// Number of failures of odometry in the test.
const FAILURES: usize = 20;

/// A team of two robots whose odometry the test can spoil, with its folder.
struct Spoilt {
    folder: TempDir,
    socket: UdpSocket,
    /// Port of the robots' program.
    port: u16,
}

impl Spoilt {
    fn new() -> Spoilt {
        let socket = UdpSocket::bind("127.0.0.1:0").expect("a socket");
        socket.set_read_timeout(Some(Duration::from_millis(500))).expect("it can be set");
        // The port is free again once this socket is dropped.
        let port = UdpSocket::bind("127.0.0.1:0").expect("a socket").local_addr().expect("bound").port();
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("tests/peers/odometer.py");
        let command = |part: &str| format!("[\"python3\", \"-SE\", \"{}\", \"{part}\", \"{port}\"]", program.display());
        let file = format!(
            "team = 61\nscenario = \"swap\"\npolicy = \"orca\"\nepisodes = 1000\nwall_radius_m = 0.16\n\
             [safety]\nown_state_s = 0.5\nlate_tick_s = 1.0\n\
             [link.air]\ninterface = \"lo\"\ngroup = \"239.255.77.61:7761\"\n\
             [deployment]\nmode = \"spoilt\"\nrobots = 2\nplacement = \"drive\"\nstepping = \"seeded\"\n\
             [deployment.body]\nspeed_m_s = 0.8\n\
             [[deployment.host]]\nname = \"robots\"\nagents = [[0], [1]]\nactuates = [0, 1]\nlocalizes = [0, 1]\n\
             driver = {{ name = \"program\", command = {} }}\n\
             source = {{ name = \"program\", drifts = true, command = {} }}\n\
             [[deployment.host]]\nname = \"pc\"\nstate_server = true\n\
             [[deployment.link]]\nname = \"air\"\ncarries = [\"reading\", \"heartbeat\", \"mode\", \"stop\"]\n",
            command("drive"),
            command("measure"),
        );
        let spoilt = Spoilt { folder: TempDir::new().expect("a temporary folder"), socket, port };
        write(spoilt.file(), file).expect("it can be written");
        spoilt
    }

    fn file(&self) -> String {
        self.folder.path().join("team.toml").to_string_lossy().into_owned()
    }

    fn spoil(&self, fault: &Value) {
        // Not connected: before the robots are there, nothing is refused, and an answer is waited for.
        self.socket.send_to(fault.to_string().as_bytes(), ("127.0.0.1", self.port)).expect("loopback");
    }

    /// Returns where a robot really is, and its speed.
    fn truth(&self, robot: usize) -> [f64; 4] {
        let mut answer = [0; 4096];
        for _ in 0..120 {
            self.spoil(&json!({ "ask": true }));
            let Ok(length) = self.socket.recv(&mut answer) else { continue };
            let told: Value = serde_json::from_slice(&answer[..length]).expect("JSON");
            return std::array::from_fn(|at| told[robot.to_string()][at].as_f64().expect("a number"));
        }
        panic!("the robots do not answer");
    }

    /// Waits until robot 0 drives.
    fn drives(&self) {
        let deadline = Instant::now() + Duration::from_secs(60);
        while self.truth(0)[3] < 0.2 {
            assert!(Instant::now() < deadline, "robot 0 does not drive");
        }
    }

    /// Runs `place` for robot 0; returns its exit code and its answer.
    fn place(&self, [x, y, heading]: [f64; 3]) -> (Option<i32>, Value) {
        let [x, y, heading] = [x, y, heading].map(|number| number.to_string());
        let args = ["place", &*self.file(), "--robot", "0", "--at", &x, &y, "--heading", &heading, "--json"];
        let output = run(&args);
        (output.status.code(), serde_json::from_slice(&output.stdout).unwrap_or(Value::Null))
    }
}

#[test]
fn odometry_that_fails_twenty_times_moves_nobody_before_a_person_has_said_where_the_robot_is() {
    let _permit = beside();
    if run_python().is_none() {
        return skip("python", "the robots are a Python program, and there is no python3");
    }
    let spoilt = Spoilt::new();
    let file = spoilt.file();
    let mut crew = Crew::new(move |host| murmurate(&["host", &file, "--host", host, "--json"]));
    crew.start("pc");
    crew.start("robots");
    let mut random = Seed::of_run(1).stream("failures");
    spoilt.drives();
    // A robot that moves is not placed.
    let refused = (0..20).any(|_| {
        spoilt.drives();
        let [x, y, heading, _] = spoilt.truth(0);
        let (code, said) = spoilt.place([x, y, heading]);
        said["answer"] == "moves" && code == Some(1)
    });
    assert!(refused, "a robot that moves is placed");
    for failure in 0..FAILURES {
        spoilt.drives();
        let by: [f64; 3] =
            [random.random_range(0.4..5.0), random.random_range(-5.0..5.0), random.random_range(-1.0..1.0)];
        spoilt.spoil(&match failure % 3 {
            0 => json!({ "fault": "jump", "robot": 0, "by": by }),
            1 => json!({ "fault": "jump", "robot": 0, "by": [0.0, 0.0, 1.0 + random.random_range(0.0..2.0)] }),
            _ => json!({ "fault": "silence", "robot": 0, "for_s": 1.5 }),
        });
        // Both stand: nobody knows where robot 0 is.
        let (mut robot, mut team) = (false, false);
        crew.until("a line that robot 0 stands, and why, and one that the team does", |heard| {
            if let Said::Log(line) = &heard.said {
                robot |= line.contains("robot 0 stands: its odometry has jumped");
                team |= line.contains("the team stands and waits for robot 0: its odometry has jumped");
            }
            if let Said::Event(HostEvent::Episode(episode)) = &heard.said {
                assert!(!team || episode.verdict != Verdict::Success, "in failure {failure}");
            }
            (robot && team).then_some(())
        });
        let stood = Instant::now();
        let before = loop {
            let (robot, other) = (spoilt.truth(0), spoilt.truth(1));
            if robot[3] == 0.0 && other[3] == 0.0 {
                break [robot, other];
            }
            assert!(stood.elapsed() < Duration::from_secs(60), "they drive on: {robot:?} {other:?}");
        };
        let stood = Instant::now();
        while stood.elapsed() < Duration::from_millis(1500) {
            assert_eq!([spoilt.truth(0), spoilt.truth(1)], before, "failure {failure}");
        }
        let [x, y, heading, _] = before[0];
        let (code, said) = spoilt.place([x, y, heading]);
        assert_eq!((code, &said["answer"]), (Some(0), &json!("aligned")), "failure {failure}: {said}");
    }
    spoilt.drives();
    assert_eq!(spoilt.place([1e9, 0.0, 0.0]).0, Some(2));
    let output = run(&["place", &spoilt.file(), "--robot", "7", "--at", "nan", "0", "--heading", "0"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
}

/// Returns something if there is a Python.
fn run_python() -> Option<()> {
    let output = std::process::Command::new("python3").arg("--version").output();
    output.is_ok_and(|output| output.status.success()).then_some(())
}
