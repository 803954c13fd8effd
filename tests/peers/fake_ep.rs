//! A fake RoboMaster EP: it speaks the plaintext SDK and prints what its chassis does as JSON lines.
//!
//! It was written from DJI's guide and from what DJI's script for the robot's side does, apart from the driver's
//! codec, and is judged by two clients of others (`ep_clients.py`). It keeps its last velocity for ever: no watchdog
//! is documented. Orders on stdin: `half-open on|off`, `mute on|off`, `no-pushes on|off`, `slow SECONDS`, `restart
//! SECONDS`, `battery N`, `roll on|off`, `hit PLATE KIND`.

use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, SocketAddrV4, TcpListener, TcpStream, UdpSocket};
use std::os::fd::AsFd;

use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::time::{ClockId, clock_gettime};

/// Period of the robot's own loop \[s\]: its pushes come at divisors of 50 Hz (the guide's rates).
const PERIOD_S: f64 = 0.02;

/// Behaviour of a robot.
#[derive(Clone, Debug)]
pub struct Options {
    /// Time that each line takes \[s\]. Lines wait in a queue.
    pub line_s: f64,
    /// Time that the SDK takes to start \[s\].
    pub entry_s: f64,
    /// Lines that arrive while one is carried out are answered and ignored (RoboMaster-SDK#9).
    pub overrun: bool,
    /// Charge of the battery \[%\].
    pub battery: u8,
}

impl Default for Options {
    fn default() -> Options {
        Options { line_s: 0.003, entry_s: 0.3, overrun: false, battery: 87 }
    }
}

/// Output of a robot.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Text for a control connection.
    Answer(u32, String),
    /// Datagram for the push port of every host that was ever connected.
    Push(String),
    /// Motion of the robot, as a JSON line.
    Report(String),
}

/// Line in the queue.
#[derive(Clone, Debug)]
struct Job {
    connection: u32,
    words: Vec<String>,
    seq: Option<u64>,
    arrived: f64,
    overrun: bool,
}

/// Pushes of one kind: every so many periods; zero for none.
#[derive(Clone, Copy, Debug, Default)]
struct Rate(u64);

/// Robot without I/O. Its axes: x forward, y right, yaw clockwise \[degrees\].
pub struct Robot {
    /// Its behaviour.
    pub options: Options,
    /// Position \[m\] and yaw \[degrees\] since power-on.
    pub pose: [f64; 3],
    /// Speed of the chassis \[m/s, m/s, degrees/s\].
    pub speed: [f64; 3],
    /// Whether it lies on its side.
    pub rolled_over: bool,
    /// Whether it answers.
    pub answers: bool,
    /// Whether it pushes.
    pub pushes: bool,
    sdk: bool,
    free: bool,
    queue: VecDeque<Job>,
    /// Time at which the next line may be carried out.
    busy_until: f64,
    /// Text without an end: one for all connections, as DJI's script has it.
    rest: String,
    rates: [Rate; 3],
    ticks: u64,
    now: f64,
    /// Output to send and to print.
    pub out: Vec<Output>,
}

impl Robot {
    /// Makes a robot that was just switched on.
    pub fn new(now: f64, options: Options) -> Robot {
        Robot {
            options,
            pose: [0.0; 3],
            speed: [0.0; 3],
            rolled_over: false,
            answers: true,
            pushes: true,
            sdk: false,
            free: false,
            queue: VecDeque::new(),
            busy_until: now,
            rest: String::new(),
            rates: [Rate::default(); 3],
            ticks: (now / PERIOD_S) as u64,
            now,
            out: Vec::new(),
        }
    }

    /// Time at which it has something to do.
    pub fn next_at(&self) -> f64 {
        let tick = (self.ticks + 1) as f64 * PERIOD_S;
        if self.queue.is_empty() { tick } else { tick.min(self.done_at()) }
    }

    /// Time at which the first line of the queue is carried out.
    fn done_at(&self) -> f64 {
        let arrived = self.queue.front().map_or(self.now, |job| job.arrived);
        self.busy_until.max(arrived) + self.options.line_s
    }

    /// Prints what it does, for a reason.
    pub fn report(&mut self, why: &str, waited_s: f64) {
        let ([vx, vy, wz], [x, y, yaw], t) = (self.speed, self.pose, self.now);
        let motion = format!(r#""vx":{vx:.3},"vy":{vy:.3},"wz":{wz:.3},"x":{x:.4},"y":{y:.4},"yaw":{yaw:.3}"#);
        let waited_ms = waited_s * 1e3;
        let line = format!(r#"{{"t":{t:.6},{motion},"waited_ms":{waited_ms:.1},"why":"{why}"}}"#);
        self.out.push(Output::Report(line));
    }

    /// A control connection has ended: SDK mode ends, whichever connection began it.
    pub fn disconnected(&mut self, now: f64) {
        self.advance(now);
        self.leave("disconnected");
    }

    fn leave(&mut self, why: &str) {
        if self.sdk {
            (self.sdk, self.free, self.rates) = (false, false, [Rate::default(); 3]);
            self.queue.clear();
            self.rest.clear();
            self.speed = [0.0; 3];
            self.report(why, 0.0);
        }
    }

    fn answer(&mut self, connection: u32, text: &str, seq: Option<u64>) {
        let text = seq.map_or(format!("{text};"), |seq| format!("{text} seq {seq};"));
        if self.answers {
            self.out.push(Output::Answer(connection, text));
        }
    }

    /// Takes bytes of a control connection.
    pub fn take(&mut self, now: f64, connection: u32, bytes: &[u8]) {
        self.advance(now);
        self.rest.push_str(&String::from_utf8_lossy(bytes));
        let text = std::mem::take(&mut self.rest);
        let mut statements: Vec<&str> = text.split(';').collect();
        let rest = statements.pop().unwrap_or_default().to_owned();
        for statement in statements {
            self.statement(connection, statement);
        }
        self.rest = rest;
    }

    fn statement(&mut self, connection: u32, statement: &str) {
        let mut words: Vec<String> = statement.split(' ').map(str::to_owned).collect();
        let mut seq = None;
        if let Some(at) = words.iter().position(|word| word == "seq") {
            seq = words.get(at + 1).and_then(|number| number.parse().ok());
            words.truncate(at);
        }
        match &words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
            ["command"] if self.sdk => self.answer(connection, "Already in SDK mode", seq),
            ["command"] => {
                self.sdk = true;
                self.busy_until = self.now + self.options.entry_s;
                self.answer(connection, "ok", seq);
                self.report("command", 0.0);
            }
            ["version"] if self.sdk => self.answer(connection, "version 00.00.00.60", seq),
            ["quit"] if self.sdk => {
                self.answer(connection, "ok", seq);
                self.leave("quit");
            }
            // Outside of SDK mode it has no connection to answer to.
            _ if !self.sdk => {}
            _ => {
                let overrun = self.options.overrun && (!self.queue.is_empty() || self.now < self.busy_until);
                self.queue.push_back(Job { connection, words, seq, arrived: self.now, overrun });
            }
        }
    }

    /// Lets time pass: lines are carried out, the robot moves and pushes.
    pub fn advance(&mut self, now: f64) {
        while self.next_at() <= now {
            let at = self.next_at();
            self.integrate(at);
            if !self.queue.is_empty() && self.done_at() <= at {
                let job = self.queue.pop_front().expect("it is not empty");
                self.busy_until = at;
                self.carry_out(&job);
            }
            while (self.ticks + 1) as f64 * PERIOD_S <= at {
                self.ticks += 1;
                self.push();
            }
        }
        self.integrate(now);
    }

    fn integrate(&mut self, to: f64) {
        let dt = (to - self.now).max(0.0);
        self.now = self.now.max(to);
        let [vx, vy, wz] = self.speed;
        // Along the arc, by its middle; clockwise yaw turns x towards y, which is right.
        let (sin, cos) = (self.pose[2] + 0.5 * wz * dt).to_radians().sin_cos();
        self.pose[0] += (cos * vx - sin * vy) * dt;
        self.pose[1] += (sin * vx + cos * vy) * dt;
        self.pose[2] = (self.pose[2] + wz * dt + 180.0).rem_euclid(360.0) - 180.0;
    }

    fn carry_out(&mut self, job: &Job) {
        let words: Vec<&str> = job.words.iter().map(String::as_str).collect();
        if job.overrun {
            return self.answer(job.connection, "ok", job.seq);
        }
        let ([vx, vy, wz], [x, y, yaw]) = (self.speed, self.pose);
        let text = match words[..] {
            ["chassis", "speed", "?"] => Some(format!("{vx:.3} {vy:.3} {wz:.3} 0 0 0 0 ")),
            ["chassis", "position", "?"] => Some(format!("{x:.3} {y:.3} {yaw:.3} ")),
            ["chassis", "attitude", "?"] => Some(format!("0.000 0.000 {yaw:.3} ")),
            ["chassis", "status", "?"] => Some(format!("{} ", self.status())),
            ["robot", "battery", "?"] => Some(format!("{} ", self.options.battery)),
            ["robot", "mode", "?"] => Some(if self.free { "free " } else { "chassis_lead " }.to_owned()),
            ["robot", "mode", mode @ ("free" | "chassis_lead" | "gimbal_lead")] => {
                self.free = mode == "free";
                Some("ok".to_owned())
            }
            ["chassis", "speed", ref rest @ ..] => self.set_speed(rest),
            ["chassis", "wheel", ref rest @ ..] => self.set_wheels(rest),
            ["chassis", "push", ref rest @ ..] => self.set_pushes(rest),
            ["armor" | "sound", "event", _, "on" | "off"] | ["AI", "push", _, "on" | "off"] => Some("ok".to_owned()),
            _ => None,
        };
        let text = text.unwrap_or_else(|| "command format error: command parse error".to_owned());
        self.answer(job.connection, &text, job.seq);
        if matches!(words[..], ["chassis", "speed" | "wheel", "x" | "y" | "z" | "w1" | "w2" | "w3" | "w4", ..]) {
            let waited = self.now - job.arrived;
            self.report(&format!("{} seq {}", job.words.join(" "), job.seq.unwrap_or(0)), waited);
        }
    }

    fn set_speed(&mut self, rest: &[&str]) -> Option<String> {
        let values = pairs(rest)?;
        let value = |key: &str| values.get(key).copied().unwrap_or(0.0);
        let (x, y, z) = (value("x"), value("y"), value("z"));
        let known = values.keys().all(|key| ["x", "y", "z"].contains(key));
        if !known || x.abs() > 3.5 || y.abs() > 3.5 || z.abs() > 600.0 {
            return Some("fail".to_owned());
        }
        // Speeds are cut to tenths, small yaw rates to the right are ignored, and speed zero creeps to the left.
        let cut = |speed: f64| (speed * 10.0).trunc() / 10.0;
        let z = if (0.0..=1.0).contains(&z) || !self.free { 0.0 } else { z };
        self.speed = [cut(x), cut(y), z];
        if self.speed == [0.0; 3] {
            self.speed[2] = -1.5;
        }
        Some("ok".to_owned())
    }

    /// Wheels: right front, left front, right rear, left rear \[rpm\], of a radius of 5 cm.
    fn set_wheels(&mut self, rest: &[&str]) -> Option<String> {
        let values = pairs(rest)?;
        let wheel = |key: &str| values.get(key).copied().unwrap_or(0.0) * 0.05 * std::f64::consts::TAU / 60.0;
        let [rf, lf, rr, lr] = ["w1", "w2", "w3", "w4"].map(wheel);
        self.speed = [(rf + lf + rr + lr) / 4.0, (lf - rf + rr - lr) / 4.0, (lf - rf + lr - rr).to_degrees() / 0.8];
        Some("ok".to_owned())
    }

    fn set_pushes(&mut self, rest: &[&str]) -> Option<String> {
        let mut rates = self.rates;
        let mut words = rest.iter();
        while let Some(word) = words.next() {
            let value = *words.next()?;
            let kind = ["position", "attitude", "status"].iter().position(|kind| kind == word);
            let frequency = ["pfreq", "afreq", "sfreq", "freq"].iter().position(|kind| kind == word);
            match (kind, frequency, value) {
                (Some(kind), _, "on") => rates[kind] = Rate(10),
                (Some(kind), _, "off") => rates[kind] = Rate(0),
                (None, Some(kind), "1" | "5" | "10" | "20" | "30" | "50") => {
                    let hz: f64 = value.parse().ok()?;
                    let every = Rate((1.0 / (hz * PERIOD_S)).round().max(1.0) as u64);
                    let kinds = if kind == 3 { 0..3 } else { kind..kind + 1 };
                    rates[kinds].fill(every);
                }
                _ => return None,
            }
        }
        self.rates = rates;
        Some("ok".to_owned())
    }

    /// Status flags, of which the first says that it stands, and the tenth that it has rolled over.
    fn status(&self) -> String {
        let stands = u8::from(self.speed == [0.0; 3]);
        format!("{stands} 0 0 0 0 0 0 0 0 {} 0", u8::from(self.rolled_over))
    }

    fn push(&mut self) {
        let due = self.rates.map(|Rate(every)| every > 0 && self.ticks.is_multiple_of(every));
        if !self.sdk || !self.pushes || due == [false; 3] {
            return;
        }
        let [x, y, yaw] = self.pose;
        let mut text = "chassis push".to_owned();
        for (due, part) in due.into_iter().zip([
            format!(" position {x:.3} {y:.3} ;"),
            format!(" attitude 0.000 0.000 {yaw:.3} ;"),
            format!(" status {} ;", self.status()),
        ]) {
            text.push_str(if due { &part } else { "" });
        }
        text.push(';');
        self.out.push(Output::Push(text));
    }
}

/// Numbers by their keys; none if a key has none.
fn pairs<'a>(words: &[&'a str]) -> Option<BTreeMap<&'a str, f64>> {
    let (pairs, []) = words.as_chunks::<2>() else { return None };
    pairs.iter().map(|[key, value]| value.parse().ok().map(|value: f64| (*key, value))).collect()
}

/// A robot's ports.
struct Ports {
    control: TcpListener,
    events: TcpListener,
    push: UdpSocket,
}

impl Ports {
    fn open(address: Ipv4Addr) -> std::io::Result<Ports> {
        let listen = |port| {
            let listener = TcpListener::bind(SocketAddrV4::new(address, port))?;
            listener.set_nonblocking(true).map(|()| listener)
        };
        let push = UdpSocket::bind(SocketAddrV4::new(address, 0))?;
        push.set_broadcast(true)?;
        Ok(Ports { control: listen(40923)?, events: listen(40925)?, push })
    }
}

/// Robot with its sockets.
pub struct Peer {
    address: Ipv4Addr,
    robot: Robot,
    ports: Option<Ports>,
    connections: BTreeMap<u32, TcpStream>,
    event_connections: Vec<TcpStream>,
    hosts: Vec<Ipv4Addr>,
    next: u32,
    half_open: bool,
    opens_at: f64,
    announces_at: Option<f64>,
}

/// Time of the monotonic clock, which all processes share \[s\].
pub fn clock_s() -> f64 {
    let time = clock_gettime(ClockId::CLOCK_MONOTONIC).expect("Linux has this clock");
    time.tv_sec() as f64 + time.tv_nsec() as f64 * 1e-9
}

impl Peer {
    /// Switches a robot on.
    pub fn new(address: Ipv4Addr, options: Options, announces: bool) -> std::io::Result<Peer> {
        let now = clock_s();
        Ok(Peer {
            address,
            robot: Robot::new(now, options),
            ports: Some(Ports::open(address)?),
            connections: BTreeMap::new(),
            event_connections: Vec::new(),
            hosts: Vec::new(),
            next: 1,
            half_open: false,
            opens_at: now,
            announces_at: announces.then_some(now),
        })
    }

    /// Does what is due; waits for at most 5 ms.
    pub fn step(&mut self, mut print: impl FnMut(&str)) {
        if !self.half_open {
            self.wait();
        } else {
            let _ = poll(&mut [], PollTimeout::from(2u8));
        }
        let now = clock_s();
        if self.ports.is_none() && now >= self.opens_at {
            self.ports = Ports::open(self.address).ok();
            self.robot.report("switched on", 0.0);
        }
        if !self.half_open {
            self.accept();
            self.read(now);
            self.announce(now);
        }
        self.robot.advance(now);
        for output in std::mem::take(&mut self.robot.out) {
            match output {
                Output::Report(line) => print(&line),
                _ if self.half_open => {}
                Output::Answer(connection, text) => {
                    if let Some(stream) = self.connections.get_mut(&connection) {
                        let _ = stream.write_all(text.as_bytes());
                    }
                }
                Output::Push(text) => {
                    for (ports, host) in self.ports.iter().flat_map(|ports| self.hosts.iter().map(move |h| (ports, h)))
                    {
                        let _ = ports.push.send_to(text.as_bytes(), (*host, 40924));
                    }
                }
            }
        }
    }

    fn wait(&self) {
        let now = clock_s();
        let ms = ((self.robot.next_at() - now) * 1e3).ceil().clamp(0.0, 5.0) as u8;
        let mut fds: Vec<PollFd> = Vec::new();
        if let Some(ports) = &self.ports {
            fds.push(PollFd::new(ports.control.as_fd(), PollFlags::POLLIN));
            fds.push(PollFd::new(ports.events.as_fd(), PollFlags::POLLIN));
        }
        fds.extend(self.connections.values().map(|stream| PollFd::new(stream.as_fd(), PollFlags::POLLIN)));
        let _ = poll(&mut fds, PollTimeout::from(ms));
    }

    fn accept(&mut self) {
        let Some(ports) = &self.ports else { return };
        while let Ok((stream, from)) = ports.control.accept() {
            let _ = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true));
            if let std::net::IpAddr::V4(host) = from.ip()
                && !self.hosts.contains(&host)
            {
                self.hosts.push(host);
            }
            self.connections.insert(self.next, stream);
            self.robot.report(&format!("connection {} opened", self.next), 0.0);
            self.next += 1;
        }
        while let Ok((stream, _)) = ports.events.accept() {
            self.event_connections.push(stream);
        }
    }

    fn read(&mut self, now: f64) {
        let mut ended = Vec::new();
        for (&connection, stream) in &mut self.connections {
            let mut bytes = [0; 2048];
            match stream.read(&mut bytes) {
                Ok(0) => ended.push(connection),
                Ok(length) => self.robot.take(now, connection, &bytes[..length]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => {}
                Err(_) => ended.push(connection),
            }
        }
        for connection in ended {
            self.connections.remove(&connection);
            self.robot.report(&format!("connection {connection} closed"), 0.0);
            self.robot.disconnected(now);
        }
    }

    fn announce(&mut self, now: f64) {
        if let Some(at) = self.announces_at.filter(|at| *at <= now && !self.robot.sdk)
            && let Some(ports) = &self.ports
        {
            self.announces_at = Some(at.max(now) + 2.0);
            let [a, ..] = self.address.octets();
            let everyone = Ipv4Addr::new(a, 255, 255, 255);
            let _ = ports.push.send_to(format!("robot ip {}", self.address).as_bytes(), (everyone, 40926));
        }
    }

    /// Carries out an order of a test.
    pub fn order(&mut self, order: &str) {
        let now = clock_s();
        self.robot.advance(now);
        let words: Vec<&str> = order.split_whitespace().collect();
        let number = || words.get(1).and_then(|word| word.parse::<f64>().ok()).unwrap_or(0.0);
        let on = words.get(1) == Some(&"on");
        match words.first().copied() {
            Some("half-open") => self.half_open = on,
            Some("mute") => self.robot.answers = !on,
            Some("no-pushes") => self.robot.pushes = !on,
            Some("roll") => self.robot.rolled_over = on,
            Some("slow") => self.robot.options.line_s = number(),
            Some("battery") => self.robot.options.battery = number() as u8,
            Some("hit") => {
                let text = format!("armor event hit {} ;;", words[1..].join(" "));
                self.event_connections.retain_mut(|stream| stream.write_all(text.as_bytes()).is_ok());
            }
            Some("restart") => {
                let options = self.robot.options.clone();
                (self.robot, self.ports) = (Robot::new(now, options), None);
                self.connections.clear();
                self.event_connections.clear();
                self.opens_at = now + number();
            }
            _ => {}
        }
        self.robot.report(&order.replace(['"', '\\'], ""), 0.0);
    }
}

/// Runs a robot with the address and the options of the command line.
#[allow(dead_code)] // Tests that include this file have no need of it.
fn main() {
    let mut arguments = std::env::args().skip(1);
    let (mut address, mut options) = (Ipv4Addr::new(127, 0, 0, 2), Options::default());
    let (mut announces, mut s1) = (false, false);
    while let Some(flag) = arguments.next() {
        let mut value = || arguments.next().unwrap_or_else(|| panic!("{flag} needs a value"));
        match flag.as_str() {
            "--address" => address = value().parse().expect("an IPv4 address"),
            "--line-s" => options.line_s = value().parse().expect("seconds"),
            "--entry-s" => options.entry_s = value().parse().expect("seconds"),
            "--battery" => options.battery = value().parse().expect("percent"),
            "--overrun" => options.overrun = true,
            "--announce" => announces = true,
            "--s1" => s1 = true,
            _ => panic!("{flag} is not a flag"),
        }
    }
    let mut peer = (!s1).then(|| Peer::new(address, options, announces).expect("the address has free ports"));
    println!(r#"{{"t":{:.6},"why":"ready at {address}"}}"#, clock_s());
    let (tx, orders) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            let _ = tx.send(line);
        }
    });
    loop {
        if let Some(peer) = &mut peer {
            orders.try_iter().for_each(|order| peer.order(&order));
            peer.step(|line| println!("{line}"));
        } else {
            let _ = orders.recv();
        }
    }
}
