//! The worker of the driver `robomaster` against the fake EP, over sockets of the loopback interface.

#[path = "../peers/fake_ep.rs"]
#[allow(dead_code)] // Each program of tests uses its part.
mod fake_ep;

use std::net::Ipv4Addr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use crate::program::lateness::Lateness;
use crate::program::{run as run_program, text};
use fake_ep::{Options, Peer, clock_s};
use murmurate::drivers::{Command, Driver, Out};
use murmurate::edge::{self, Gate, Running, Settings};
use murmurate::messages::geometry::Vec2;
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::{BodyTwist, Drive};
use murmurate::messages::wire::{Hardware, Health};
use murmurate::time::{Span, Time};
use murmurate_devices::robomaster::ENTRY;
use nix::poll::{PollTimeout, poll};

/// A robot on a thread of its own, with what it has printed.
struct Fake {
    reports: Arc<Mutex<Vec<serde_json::Value>>>,
    ends: Arc<AtomicBool>,
    /// Whether it is halted: it keeps its connections, and neither reads nor sends.
    halted: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Fake {
    fn start(address: Ipv4Addr, battery: u8) -> Fake {
        let (reports, ends) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let halted = Arc::new(AtomicBool::new(false));
        let (into, end, halt) = (Arc::clone(&reports), Arc::clone(&ends), Arc::clone(&halted));
        let mut peer = Peer::new(address, Options { battery, ..Options::default() }, false).expect("free ports");
        let thread = thread::spawn(move || {
            while !end.load(Ordering::Relaxed) {
                if halt.load(Ordering::Relaxed) {
                    let _ = poll(&mut [], PollTimeout::from(1u8));
                    continue;
                }
                peer.step(|line| into.lock().unwrap().push(serde_json::from_str(line).expect("JSON")));
            }
        });
        Fake { reports, ends, halted, thread: Some(thread) }
    }

    /// Time of the first report since `from_s` in which the robot stands; none if it moves on.
    fn stood_at(&self, from_s: f64) -> Option<f64> {
        let reports = self.reports.lock().unwrap();
        let stood = |line: &&serde_json::Value| line["t"].as_f64().unwrap() >= from_s && line["vx"] == 0.0;
        reports.iter().find(stood).map(|line| line["t"].as_f64().unwrap())
    }

    fn last(&self) -> serde_json::Value {
        self.reports.lock().unwrap().last().unwrap().clone()
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// A driver with its worker.
struct Host {
    gate: Gate,
    driver: Box<dyn Driver>,
    worker: Running,
    began_s: f64,
    twist: BodyTwist,
    due_s: f64,
    outs: Vec<Out>,
}

impl Host {
    fn start(address: Ipv4Addr) -> Host {
        let table = format!("connection = 'usb'\naddress = '{address}'\nbattery_period_s = 1.0").parse().unwrap();
        let parts = (ENTRY.make)(&Settings { name: "robomaster".to_owned(), table }, RobotId(0)).unwrap();
        let (gate, worker) = edge::start(parts.worker.expect("it has one"), "driver").unwrap();
        let (driver, twist) = ((parts.driver)(), BodyTwist::default());
        Host { gate, driver, worker, began_s: clock_s(), twist, due_s: 0.0, outs: Vec::new() }
    }

    fn step(&mut self) {
        let (mut packets, mut out) = (Vec::new(), Vec::new());
        self.gate.take(|packet| packets.push(packet));
        let now = Time::ZERO + Span::from_secs(clock_s() - self.began_s);
        packets.iter().for_each(|packet| self.driver.receive(now, packet, &mut out));
        if self.driver.wake_at().is_some_and(|at| at <= now) {
            self.driver.wake(now, &mut out);
        }
        if clock_s() >= self.due_s {
            self.due_s = clock_s() + 0.02;
            let drive = Drive { robot: RobotId(0), velocity: Vec2::zeros(), until: now + Span::from_millis(200) };
            self.driver.drive(now, &Command { drive, body: Some(self.twist) }, &mut out);
        }
        for out in out {
            if let Out::Send(packet) = out { self.gate.send(packet) } else { self.outs.push(out) }
        }
    }

    fn is_ready(&self) -> bool {
        let condition = |out: &&Out| matches!(out, Out::Condition(..));
        matches!(self.outs.iter().rfind(condition), Some(Out::Condition(Hardware { health: Health::Ready, .. })))
    }

    /// Ends the host, and waits for its worker. Only one that hangs takes a minute.
    fn end(self) {
        drop(self.gate);
        assert!(self.worker.join(Duration::from_secs(60)), "the worker does not end with its host");
    }
}

/// Runs hosts for some seconds, or until it is enough.
fn run(hosts: &mut [Host], seconds: f64, enough: impl Fn(&[Host]) -> bool) {
    let until = clock_s() + seconds;
    while clock_s() < until && !enough(hosts) {
        hosts.iter_mut().for_each(Host::step);
        let _ = poll(&mut [], PollTimeout::from(1u8));
    }
}

fn ready(hosts: &mut [Host]) {
    run(hosts, 60.0, |hosts| hosts.iter().all(Host::is_ready));
    assert!(hosts.iter().all(Host::is_ready), "the robots are never ready");
}

#[test]
fn the_end_of_the_host_is_told_and_a_hanging_control_thread_stops_the_robot() {
    let address = Ipv4Addr::new(127, 0, 40, 2);
    let fake = Fake::start(address, 50);
    let mut hosts = [Host::start(address)];
    ready(&mut hosts);
    hosts[0].twist.forward = 0.5;
    let drives = |_: &[Host]| fake.last()["vx"] == 0.5;
    run(&mut hosts, 60.0, drives);
    assert!(drives(&hosts));
    let (hangs_s, machine) = (clock_s(), Lateness::watch());
    let _ = poll(&mut [], PollTimeout::from(400u16));
    let stopped = fake.stood_at(hangs_s).expect("the worker has stopped it") - hangs_s;
    let machine_s = machine.end().as_secs_f64();
    assert!(stopped < 0.3 + machine_s, "after {stopped} s; its command was valid for 0.2 s");
    run(&mut hosts, 60.0, drives);
    assert!(drives(&hosts), "the control thread is back");
    let [host] = hosts;
    let ends_s = clock_s();
    host.end();
    // The fake's own words may come late on a busy machine.
    let quits = || fake.reports.lock().unwrap().iter().any(|line| line["why"] == "quit");
    while (fake.stood_at(ends_s).is_none() || !quits()) && clock_s() < ends_s + 60.0 {
        let _ = poll(&mut [], PollTimeout::from(20u8));
    }
    assert!(fake.stood_at(ends_s).is_some());
    assert!(quits(), "it has left SDK mode");
}

#[test]
fn a_robot_that_is_halted_is_silent_in_time_and_stands_when_it_goes_on() {
    let address = Ipv4Addr::new(127, 0, 40, 6);
    let fake = Fake::start(address, 50);
    let mut hosts = [Host::start(address)];
    ready(&mut hosts);
    for _ in 0..3 {
        hosts[0].twist.forward = 0.5;
        let drives = |_: &[Host]| fake.last()["vx"] == 0.5;
        run(&mut hosts, 60.0, drives);
        assert!(drives(&hosts));
        let (halts_s, machine) = (clock_s(), Lateness::watch());
        fake.halted.store(true, Ordering::Relaxed);
        run(&mut hosts, 60.0, |hosts| !hosts[0].is_ready());
        let silent_s = clock_s() - halts_s - machine.end().as_secs_f64();
        assert!(!hosts[0].is_ready() && silent_s < 0.3, "it is silent after {silent_s} s");
        // The host goes on, and commands it to stand, as a Body does under a stop. What was not read waits for it.
        hosts[0].twist.forward = 0.0;
        run(&mut hosts, 1.0, |_| false);
        assert!(!hosts[0].is_ready());
        let (back_s, machine) = (clock_s(), Lateness::watch());
        fake.halted.store(false, Ordering::Relaxed);
        ready(&mut hosts);
        let stood_s = fake.stood_at(back_s).expect("it stands") - back_s - machine.end().as_secs_f64();
        assert!(stood_s < 0.7, "it stands {stood_s} s after it goes on");
        let stood_s = fake.stood_at(back_s).expect("it stands");
        run(&mut hosts, 0.5, |_| false);
        let moves = |line: &serde_json::Value| line["t"].as_f64().unwrap() > stood_s && line["vx"] != 0.0;
        assert!(!fake.reports.lock().unwrap().iter().any(moves), "it drives by what has waited");
    }
    let [host] = hosts;
    fake.halted.store(true, Ordering::Relaxed);
    host.end();
}

#[test]
fn pushes_of_several_robots_to_one_port_are_never_crossed() {
    let addresses = [3, 4, 5].map(|k| Ipv4Addr::new(127, 0, 40, k));
    let fakes: Vec<Fake> = addresses.iter().zip([30, 40, 50]).map(|(at, battery)| Fake::start(*at, battery)).collect();
    let mut hosts = addresses.map(Host::start);
    ready(&mut hosts);
    hosts.iter_mut().zip([0.2, 0.4, 0.6]).for_each(|(host, speed)| host.twist.forward = speed);
    run(&mut hosts, 1.0, |_| false);
    hosts.iter_mut().for_each(|host| host.twist.forward = 0.0);
    run(&mut hosts, 0.6, |_| false);
    for ((host, fake), battery) in hosts.into_iter().zip(&fakes).zip([30, 40, 50]) {
        let at = fake.last()["x"].as_f64().unwrap();
        let mut readings = host.outs.iter().filter_map(|out| if let Out::Odometry(r) = out { Some(r) } else { None });
        let last = f64::from(readings.next_back().unwrap().pose.position.x);
        assert!(at > 0.1 && (last - at).abs() < 0.002, "{last} m instead of {at} m");
        let ready = Hardware { battery: Some(battery), ..Hardware::of(Health::Ready) };
        assert!(host.outs.contains(&Out::Condition(ready)));
        host.end();
    }
}

#[test]
fn a_robot_that_is_not_there_is_silent_and_its_worker_ends() {
    let mut hosts = [Host::start(Ipv4Addr::new(127, 0, 40, 9))];
    run(&mut hosts, 0.5, |_| false);
    let reason = |out: &Out| match out {
        Out::Condition(Hardware { health: Health::Silent, reason: Some(reason), .. }) => reason.text().to_owned(),
        _ => panic!("{out:?}"),
    };
    let reasons: Vec<String> = hosts[0].outs.iter().map(reason).collect();
    assert_eq!((reasons[0].as_str(), reasons.len()), ("no connection yet", 2));
    assert!(reasons[1].starts_with("127.0.40.9 refuses TCP port 40923"), "{reasons:?}");
    let [host] = hosts;
    host.end();
}

/// A team file with two robots at these addresses, localized by their odometry.
fn team(addresses: [Ipv4Addr; 2]) -> String {
    let [first, second] = addresses;
    format!(
        "team = 9\nscenario = \"swap\"\npolicy = \"orca\"\n[deployment]\nmode = \"ep\"\nrobots = 2\n\
         placement = \"drive\"\nstepping = \"seeded\"\n[deployment.body]\nbattery_least = 0.2\n\
         [[deployment.host]]\nname = \"pc\"\nagents = [[0], [1]]\nactuates = [0, 1]\nlocalizes = [0, 1]\n\
         state_server = true\n\
         driver = {{ name = \"robomaster\", connection = \"router\", robot.0 = {{ address = \"{first}\" }}, \
         robot.1 = {{ address = \"{second}\" }} }}\n\
         source = {{ name = \"odometry\", robot.0 = {{ origin_m = [-1.0, -1.0] }}, \
         robot.1 = {{ origin_m = [1.0, -1.0], yaw_rad = 1.57 }} }}\n"
    )
}

#[test]
fn the_doctor_drives_a_sound_robot_10_cm_and_not_a_flat_one() {
    let addresses = [22, 23].map(|k| Ipv4Addr::new(127, 0, 40, k));
    let fakes: Vec<Fake> = addresses.iter().zip([87, 12]).map(|(at, battery)| Fake::start(*at, battery)).collect();
    let folder = tempfile::TempDir::new().expect("a temporary folder");
    let file = folder.path().join("ep.toml");
    std::fs::write(&file, team(addresses)).expect("it can be written");
    // Beside other tests the fakes can be late: what is broken is so three times.
    let doctor = || run_program(&["doctor", &file.to_string_lossy(), "--wiggle", "--yes", "--listen", "0.6"]);
    let is_quiet = |output: &std::process::Output| !text(&output.stdout).contains("longest gap");
    let output = (0..2).map(|_| doctor()).find(is_quiet).unwrap_or_else(doctor);
    let out = text(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{out}{}", text(&output.stderr));
    for line in [
        "ok   robot 0, driver robomaster: ready, battery 87 %",
        "ok   robot 0, wiggle: went ",
        "fail robot 1, driver robomaster: faulty: battery 12 %, least 20 %: charge it to 30 %",
        "fail robot 1, wiggle: was not driven: battery 12 %",
    ] {
        assert_eq!(out.lines().filter(|other| other.starts_with(line)).count(), 1, "{line} in\n{out}");
    }
    let moved = |fake: &Fake| fake.reports.lock().unwrap().iter().any(|line| line["vx"] != 0.0 || line["vy"] != 0.0);
    assert!(moved(&fakes[0]) && !moved(&fakes[1]));
}
