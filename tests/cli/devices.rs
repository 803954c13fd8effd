//! `doctor` with the drivers and the source of a host, and `doctor --wiggle`, against robots that are a program.
//!
//! The robots and their tracker are in `tests/peers/bench.py`, with what is wrong with them.

use std::fs::{read_to_string, write};
use std::net::{Ipv4Addr, SocketAddrV4, UdpSocket};
use std::path::Path;
use std::process::{Output, Stdio};

use crate::program::skip::skip;
use crate::program::{murmurate, refuses, text};
use serde_json::Value;
use tempfile::TempDir;

/// Whether the machine can run the robots; otherwise the test skips, and says so.
fn has_python() -> bool {
    let has = std::process::Command::new("python3").arg("-SEV").stdout(Stdio::null()).status().is_ok();
    if !has {
        skip("python", "the robots are a Python program, and there is no python3");
    }
    has
}

/// A free UDP port of the loopback interface.
fn free_port() -> u16 {
    let socket = UdpSocket::bind(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0)).expect("a free port");
    socket.local_addr().expect("it is bound").port()
}

/// Ages at which the guard stops a robot: beside seventy other tests the tracker, a Python program, and the control
/// tick can be late, and the guard is not under test here.
const SAFETY: &str = "[safety]\nown_state_s = 1.0\nlate_tick_s = 1.0\n";

/// A folder with a team of one host, with one or two real robots of two, which have a fault.
struct Bench {
    folder: TempDir,
    real: usize,
}

impl Bench {
    fn new(real: usize, fault: &str, body: &str) -> Bench {
        let (folder, port) = (TempDir::new().expect("a temporary folder"), free_port());
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("tests/peers/bench.py");
        let command = |part: &str| {
            format!("[\"python3\", \"-SE\", \"{}\", \"{part}\", \"{port}\", \"{fault}\"]", program.display())
        };
        let (all, rest) = if real == 1 { ("0", "simulates = [1]\n") } else { ("0, 1", "") };
        let file = format!(
            "team = 5\nscenario = \"swap\"\npolicy = \"orca\"\n[deployment]\nmode = \"bench\"\nrobots = 2\n\
             placement = \"drive\"\nstepping = \"seeded\"\n{SAFETY}[deployment.body]\n{body}\n\
             [[deployment.host]]\nname = \"bench\"\n\
             agents = [[0], [1]]\nactuates = [{all}]\nlocalizes = [{all}]\n{rest}state_server = true\n\
             driver = {{ name = \"program\", command = {} }}\nsource = {{ name = \"program\", command = {} }}\n",
            command("drive"),
            command("track")
        );
        let bench = Bench { folder, real };
        write(bench.file(), file).expect("it can be written");
        bench
    }

    fn file(&self) -> String {
        self.folder.path().join("bench.toml").to_string_lossy().into_owned()
    }

    fn doctor(&self, flags: &[&str]) -> Output {
        let file = self.file();
        let listen = if flags.contains(&"--listen") { &[][..] } else { &["--listen", "2"] };
        let args = [&["doctor", &*file][..], listen, flags].concat();
        murmurate(&args).output().expect("the program starts")
    }

    /// Runs the wiggle; returns the exit code, and the lines about it.
    fn wiggle(&self) -> (Option<i32>, Vec<String>) {
        let output = self.doctor(&["--wiggle", "--yes"]);
        let out = text(&output.stdout);
        let lines: Vec<String> = out.lines().filter(|line| line.contains("wiggle:")).map(str::to_owned).collect();
        assert_eq!(lines.len(), self.real, "one line a robot: {out}\n{}", text(&output.stderr));
        (output.status.code(), lines)
    }
}

fn has(lines: &[String], words: &[&str]) {
    assert!(lines.iter().any(|line| words.iter().all(|word| line.contains(word))), "{words:?} in {lines:#?}");
}

/// Runs a test of several cases, four at a time: they mostly wait.
fn side_by_side<T: Sync>(cases: &[T], test: impl Fn(&T) + Sync) {
    for some in cases.chunks(4) {
        std::thread::scope(|scope| some.iter().for_each(|case| drop(scope.spawn(|| test(case)))));
    }
}

#[test]
fn sound_devices_are_named_with_their_rates_and_conditions() {
    if !has_python() {
        return;
    }
    // Beside seventy other tests the tracker, a Python program, can be late: what is broken is so three times.
    let sound = || Bench::new(2, "none", "battery_least = 0.2\ntemperature_most_c = 70.0").doctor(&["--json"]);
    let is_quiet = |output: &Output| !text(&output.stdout).contains("longest gap");
    let output = (0..2).map(|_| sound()).find(is_quiet).unwrap_or_else(sound);
    let report: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!((output.status.code(), report["fit"].as_bool()), (Some(0), Some(true)), "{report:#}");
    let checks = report["checks"].as_array().expect("a list");
    let found = |what: &str| {
        let check = checks.iter().find(|check| check["what"] == what).unwrap_or_else(|| panic!("{what} in {report:#}"));
        assert_eq!(check["status"], "ok", "{check}");
        check["found"].as_str().expect("text").to_owned()
    };
    let rate: f64 = found("robot 1, source program").split(' ').next().unwrap().parse().expect("a rate");
    // It sends fifty a second, and fewer beside other tests.
    assert!(rate > 0.0 && rate <= 60.0, "{rate} Hz");
    assert!(found("robot 0, source program").contains("at (-1.00, -1.00) m"));
    assert_eq!(found("robot 0, driver program"), "ready, battery 87 %, 41 \u{b0}C");
    assert_eq!(text(&output.stderr).lines().count(), 0, "{}", text(&output.stderr));
}

#[test]
fn each_broken_device_is_named_in_a_line() {
    if !has_python() {
        return;
    }
    let faults = [
        (
            "dead-tracker",
            "",
            &["fail source program: no reading of robot 0, robot 1 in 2 s", "does the tracker run"][..],
        ),
        ("lost", "", &["fail source program: no reading of robot 1 in 2 s", "in its sight"]),
        ("frozen", "", &["fail robot 0, source program: one reading, repeated", "frozen"]),
        ("milliseconds", "", &["warn robot 0, source program", "its stamps advance by"]),
        (
            "flat",
            "battery_least = 0.2",
            &["fail robot 0, driver program: faulty: battery 3 %, least 20 %: charge it to 30 %"],
        ),
        ("hot", "temperature_most_c = 70.0", &["fail robot 0, driver program: faulty: 88 deg C, at most 70"]),
        ("mute", "battery_least = 0.2", &["fail robot 0, driver program: it reports no charge"]),
        ("faulty", "", &["fail robot 0, driver program: faulty: bumper pressed, battery 87 %"]),
        ("ended", "", &["fail robot 0, driver program: does not answer", "has ended and is started again"]),
    ];
    side_by_side(&faults, |(fault, body, words)| {
        let output = Bench::new(2, fault, body).doctor(&[]);
        let out = text(&output.stdout);
        let wanted = if words[0].starts_with("fail") { 1 } else { 0 };
        assert_eq!(output.status.code(), Some(wanted), "{fault}: {out}");
        let named = out.lines().filter(|line| words.iter().all(|word| line.contains(word))).count();
        assert_eq!(named, 1, "{fault}: {words:?} in\n{out}{}", text(&output.stderr));
    });
}

#[test]
fn a_robot_is_judged_by_the_ground_of_the_team_s_scale() {
    if !has_python() {
        return;
    }
    let bench = Bench::new(2, "none", "");
    let file = read_to_string(bench.file())
        .expect("it is there")
        .replace("robots = 2\n", "robots = 2\nscale = 0.25\nhull_m = 0.08\n");
    write(bench.file(), file).expect("it can be written");
    let output = bench.doctor(&[]);
    let out = text(&output.stdout);
    assert!(out.contains("the ground reaches to ±0.5 m, ±0.2 m"), "{out}{}", text(&output.stderr));
}

#[test]
fn sound_robots_pass_the_wiggle_one_after_the_other() {
    if !has_python() {
        return;
    }
    let bench = Bench::new(2, "none", "");
    let (code, lines) = bench.wiggle();
    assert_eq!(code, Some(0), "{lines:#?}");
    for robot in ["robot 0", "robot 1"] {
        has(&lines, &["ok", robot, "cm, ", "degrees off, and back"]);
    }
}

#[test]
fn mistakes_in_names_and_axes_are_found_by_the_wiggle() {
    if !has_python() {
        return;
    }
    let faults = [
        ("swapped", 2, &["fail", "robot 0, wiggle: robot 0 was driven, robot 1 moved"][..]),
        ("mirrored-y", 1, &["fail", "robot 0, wiggle: went", "of where it should, as with the sign of y wrong"]),
        ("swapped-axes", 1, &["fail", "robot 0, wiggle: went", "as with x and y swapped"]),
        ("deaf", 1, &["fail", "robot 0, wiggle: was driven, and no robot moved"]),
        ("slow", 1, &["fail", "robot 0, wiggle: went", "instead of 10 cm"]),
        ("dead-tracker", 1, &["fail", "robot 0, wiggle: no reading of it"]),
        ("faulty", 1, &["fail", "robot 0, wiggle: was not driven: bumper pressed"]),
    ];
    side_by_side(&faults, |(fault, real, words)| {
        let (code, lines) = Bench::new(*real, fault, "").wiggle();
        assert_eq!(code, Some(1), "{fault}: {lines:#?}");
        has(&lines, words);
    });
}

#[test]
fn no_robot_moves_without_a_confirmation() {
    let bench = Bench::new(1, "none", "");
    let file = bench.file();
    refuses(&["doctor", &file, "--wiggle", "--listen", "0.2"], &["--wiggle", "--yes"]);
    refuses(&["doctor", &file, "--wiggle", "--yes", "--listen", "0"], &["--listen 0"]);
    let offboard = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("teams/offboard.toml");
    let offboard = offboard.to_string_lossy();
    refuses(&["doctor", &offboard, "--robot", "0", "--wiggle", "--yes"], &["no real robot", "needs no wiggle"]);
}

#[test]
fn no_robot_moves_beside_a_state_server() {
    let bench = Bench::new(1, "none", "");
    let file = read_to_string(bench.file()).expect("it is there");
    let (head, host) = file.split_once("[[deployment.host]]").expect("it has a host");
    let host = host.replace("state_server = true\n", "");
    let pc = "[[deployment.host]]\nname = \"pc\"\nstate_server = true\n[[deployment.link]]\nname = \"air\"\n\
              carries = [\"reading\", \"heartbeat\", \"mode\", \"stop\"]\n[link.air]\ninterface = \"lo\"\n";
    let group = format!("group = \"239.255.78.1:{}\"\n", free_port());
    write(bench.file(), format!("{head}[[deployment.host]]{host}{pc}{group}")).expect("it can be written");
    let file = bench.file();
    let mut command = murmurate(&["host", &file, "--host", "pc", "--json"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("it starts");
    let mut ready = String::new();
    let mut events = std::io::BufReader::new(child.stdout.take().expect("it is piped"));
    std::io::BufRead::read_line(&mut events, &mut ready).expect("it is ready");
    let output = bench.doctor(&["--robot", "0", "--wiggle", "--yes", "--listen", "1.2"]);
    child.kill().expect("it runs");
    child.wait().expect("it ends");
    let out = text(&output.stdout);
    if out.contains("what this machine sends does not come back to it") {
        return skip("multicast", "what this machine sends to a group does not come back to it");
    }
    assert_eq!(output.status.code(), Some(1), "{out}");
    assert!(out.contains("fail wiggle: refused: the host of the state server is running"), "{out}");
    assert!(!text(&output.stderr).contains("drives"), "no robot has moved");
}

#[test]
fn an_interrupt_stops_the_wiggle_and_the_robot() {
    if !has_python() {
        return;
    }
    let bench = Bench::new(1, "slow", "");
    let file = bench.file();
    let mut command = murmurate(&["doctor", &file, "--wiggle", "--yes", "--listen", "2"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    let mut said = std::io::BufReader::new(child.stderr.take().expect("it is piped"));
    let mut line = String::new();
    std::io::BufRead::read_line(&mut said, &mut line).expect("it says when a robot is driven");
    assert!(line.contains("robot 0 drives"), "{line}");
    let pid = nix::unistd::Pid::from_raw(child.id().try_into().expect("a process id"));
    nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGINT).expect("it runs");
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(130));
    assert!(
        !text(&output.stdout).contains("wiggle: went"),
        "it has not driven on to the end: {}",
        text(&output.stdout)
    );
}

#[test]
fn two_robots_of_one_address_are_refused() {
    let bench = Bench::new(2, "none", "");
    let file = read_to_string(bench.file()).expect("it is there");
    let driver = "driver = { name = \"robomaster\", connection = \"router\", address = \"10.0.0.7\" }";
    let lines = file.lines().map(|line| if line.starts_with("driver") { driver } else { line });
    write(bench.file(), lines.collect::<Vec<_>>().join("\n")).expect("it can be written");
    refuses(
        &["config", "check", &bench.file()],
        &["driver.robot.1", "robot 1 and robot 0 of host 'bench'", "address 10.0.0.7"],
    );
}

#[test]
fn a_robot_that_is_not_there_is_named_with_its_address() {
    if !has_python() {
        return;
    }
    let bench = Bench::new(1, "none", "");
    let file = read_to_string(bench.file()).expect("it is there");
    let driver = "driver = { name = \"robomaster\", connection = \"router\", address = \"127.0.41.9\" }";
    let lines = file.lines().map(|line| if line.starts_with("driver") { driver } else { line });
    write(bench.file(), lines.collect::<Vec<_>>().join("\n")).expect("it can be written");
    let output = bench.doctor(&[]);
    let out = text(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{out}");
    let named = "fail robot 0, driver robomaster: does not answer: robot 0 at 127.0.41.9 refuses TCP port 40923";
    assert_eq!(out.lines().filter(|line| line.starts_with(named)).count(), 1, "{out}");
}

#[test]
fn the_results_of_a_host_have_its_robots_hardware() {
    if !has_python() {
        return;
    }
    let bench = Bench::new(1, "flat", "battery_least = 0.2");
    let file = bench.file();
    let mut command = murmurate(&["host", &file, "--host", "bench", "--json"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    let mut lines = std::io::BufRead::lines(std::io::BufReader::new(child.stdout.take().expect("it is piped")));
    let counted = lines.find_map(|line| {
        let event: Value = serde_json::from_str(&line.expect("text")).expect("JSON");
        (event["event"] == "counted" && !event["hardware"][0].is_null()).then_some(event)
    });
    // Asked to end, it writes what is left of its log.
    let pid = nix::unistd::Pid::from_raw(child.id().try_into().expect("a process id"));
    nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGTERM).expect("it runs");
    let output = child.wait_with_output().expect("it ends");
    let hardware = &counted.expect("counts come every second")["hardware"][0];
    assert_eq!((&hardware["robot"], &hardware["battery"], &hardware["faults"]), (&0.into(), &3.into(), &1.into()));
    assert!(hardware["last_fault"].as_str().expect("a text").starts_with("battery 3 %, least 20 %"), "{hardware}");
    let log = text(&output.stderr);
    let stands = log.lines().filter(|line| line.contains("robot 0 stands: battery 3 %")).count();
    assert_eq!(stands, 1, "one line: {log}");
}
