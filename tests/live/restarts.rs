//! A team under `launch` whose processes are killed and started again: the log and the page name each death and return,
//! and no live host is taken for a second one. `MURMURATE_RESTARTS=100` kills so often (six minutes: a process is
//! started again three times in 60 s).

use std::collections::{BTreeMap, VecDeque};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use tungstenite::protocol::Role;
use tungstenite::{Message, WebSocket};

use crate::beside;
use crate::crew::{folder, report};
use crate::kill::team;
use crate::program::murmurate;

/// Hosts of the team.
const HOSTS: [&str; 5] = ["agent-0", "agent-1", "agent-2", "world", "server"];
/// Largest number of restarts of a process in `WINDOW`, and some seconds more than the window of `launch`.
const RESTARTS: usize = 3;
const WINDOW: Duration = Duration::from_secs(63);
/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(60);

/// What `launch` and its page say.
enum Said {
    /// Line of stderr.
    Line(String),
    /// Status of the page.
    Status(Value),
}

/// Opens the WebSocket of a page's status, as its page does.
pub fn control(address: &str) -> WebSocket<TcpStream> {
    let mut stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(PATIENCE)).expect("a timeout");
    let request = format!(
        "GET /control HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\nUpgrade: websocket\r\n\
         Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    );
    stream.write_all(request.as_bytes()).expect("it reads");
    let (mut head, mut byte) = (Vec::new(), [0]);
    while !head.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte).expect("an answer");
        head.push(byte[0]);
    }
    assert!(head.starts_with(b"HTTP/1.1 101 "), "{}", String::from_utf8_lossy(&head));
    WebSocket::from_raw_socket(stream, Role::Client, None)
}

/// Passes every status of a page on until it closes.
fn watch(address: &str, to: Sender<Said>) {
    let mut page = control(address);
    thread::spawn(move || {
        while let Ok(message) = page.read() {
            let Message::Text(text) = message else { continue };
            let said: Value = serde_json::from_str(&text).expect("it is JSON");
            if said["kind"] == "status" && to.send(Said::Status(said["body"].clone())).is_err() {
                return;
            }
        }
    });
}

/// A running `launch --watch`, with all that it and its page have said.
struct Launched {
    child: Child,
    said: Receiver<Said>,
    lines: Vec<String>,
    /// Lines of the page's log, by the number that they got first.
    log: BTreeMap<u64, String>,
    last: Value,
    /// Hosts' robots that were shown as down at any time.
    down: bool,
}

impl Launched {
    fn start(file: &str) -> Launched {
        let mut command = murmurate(&["launch", file, "--watch", "--json"]);
        command.env_remove("MURMURATE_RESTARTS");
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("it starts");
        let (sender, said) = channel();
        let lines = BufReader::new(child.stderr.take().expect("it is piped")).lines();
        let from_page = sender.clone();
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                if let Some(url) = line.strip_prefix("watch: http://") {
                    watch(url.split('/').next().expect("an address"), from_page.clone());
                }
                if sender.send(Said::Line(line)).is_err() {
                    return;
                }
            }
        });
        let (lines, log, last) = (Vec::new(), BTreeMap::new(), Value::Null);
        Launched { child, said, lines, log, last, down: false }
    }

    /// Takes in what is said for at most `span`, or until `found`.
    fn take(&mut self, span: Duration, found: impl Fn(&Launched) -> bool) -> bool {
        let until = Instant::now() + span;
        loop {
            if found(self) {
                return true;
            }
            let left = until.saturating_duration_since(Instant::now());
            match self.said.recv_timeout(left) {
                Ok(Said::Line(line)) => self.lines.push(line),
                Ok(Said::Status(status)) => {
                    for line in status["log"].as_array().expect("a log") {
                        let id = line["id"].as_u64().expect("a number");
                        self.log.insert(id, line["text"].as_str().expect("text").to_owned());
                    }
                    self.down |= status["down"].as_array().is_some_and(|down| !down.is_empty());
                    self.last = status;
                }
                Err(RecvTimeoutError::Timeout) => return found(self),
                Err(RecvTimeoutError::Disconnected) => return found(self),
            }
        }
    }

    fn until(&mut self, what: &str, found: impl Fn(&Launched) -> bool) {
        assert!(self.take(PATIENCE, found), "never: {what}; {:#?} {:#?}", self.lines, self.log);
    }

    fn told(&self, words: &[&str]) -> [usize; 2] {
        let fits = |line: &&String| words.iter().all(|word| line.contains(word));
        [self.lines.iter().filter(fits).count(), self.log.values().filter(fits).count()]
    }

    /// Returns the process of a host: the child of `launch` whose arguments name it.
    fn pid(&self, host: &str) -> Pid {
        let own = format!("/proc/{0}/task/{0}/children", self.child.id());
        let children = std::fs::read_to_string(own).expect("it runs");
        let is = |pid: &&str| {
            let arguments = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let mut words = arguments.split(|byte| *byte == 0);
            words.any(|word| word == b"--host") && words.next() == Some(host.as_bytes())
        };
        let pid = children.split_whitespace().find(is).unwrap_or_else(|| panic!("{host} runs: {children}"));
        Pid::from_raw(pid.parse().expect("a number"))
    }
}

impl Drop for Launched {
    fn drop(&mut self) {
        // Its processes end when it does.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn every_death_and_return_is_named_and_no_restarted_host_is_taken_for_a_second_one() {
    let _beside = beside();
    let (_folder, file) = folder(&team(784));
    let mut launched = Launched::start(&file);
    launched.until("all run", |said| said.lines.iter().any(|line| line.starts_with("5 processes run")));
    launched.until("the page shows an episode", |said| said.last["phase"] == 3);
    let kills = std::env::var("MURMURATE_RESTARTS").map_or(HOSTS.len(), |kills| kills.parse().expect("a number"));
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut struck: BTreeMap<&str, VecDeque<Instant>> = BTreeMap::new();
    for count in 1..=kills {
        // In turn, and of those that may be started again.
        let host = HOSTS[count % HOSTS.len()];
        let times = struck.entry(host).or_default();
        if times.len() >= RESTARTS {
            let first = times.pop_front().expect("there are three");
            launched.take(WINDOW.saturating_sub(first.elapsed()), |_| false);
        }
        launched.take(Duration::from_millis(random.random_range(0..1500)), |_| false);
        kill(launched.pid(host), Signal::SIGKILL).expect("it runs");
        struck.entry(host).or_default().push_back(Instant::now());
        launched.until("it is back", |said| said.told(&["' is back"]) == [count; 2]);
        assert_eq!(launched.told(&["has failed (signal 9, SIGKILL); started again"]), [count; 2]);
    }
    for host in HOSTS {
        let times = (1..=kills).filter(|count| HOSTS[count % HOSTS.len()] == host).count();
        assert_eq!(launched.told(&[&format!("the process '{host}' has failed (signal 9, SIGKILL)")]), [times; 2]);
        assert_eq!(launched.told(&[&format!("the process '{host}' is back, after ")]), [times; 2]);
    }
    assert!(launched.down, "its robots were shown as down meanwhile");
    assert_eq!((launched.told(&["two live hosts"]), launched.told(&["second live host"])), ([0; 2], [0; 2]));
    // A restart in the middle of an episode aborts it, and the results say so and name a robot or the server.
    launched.until("the next episode runs", |said| said.last["phase"] == 3);
    kill(Pid::from_raw(launched.child.id().cast_signed()), Signal::SIGINT).expect("it runs");
    launched.until("the page knows of the end", |said| said.last["over"] == true);
    assert_eq!(launched.last["ending"]["regular"], true, "{}", launched.last["ending"]);
    assert_eq!(launched.child.wait().expect("it is ours").code(), Some(130));
    let reasons: Vec<&String> = launched.lines.iter().filter(|line| line.contains(": aborted: ")).collect();
    report(&format!("{kills} kills, all named; {} episodes aborted, such as {:?}", reasons.len(), reasons.first()));
    assert!(!reasons.is_empty(), "aborted episodes have a reason");
}
