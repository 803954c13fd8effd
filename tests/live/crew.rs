//! Team of real processes for tests: starts, halts, kills and restarts hosts, and reads their output. Nothing here
//! sleeps: time passes in steps of the World, which arrive as lines.

use std::collections::BTreeMap;
use std::fs::write;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use murmurate_report::event::HostEvent;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use tempfile::TempDir;

use crate::program::{murmurate, run};

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(90);

/// One robot in one step of the World.
#[derive(Clone, Debug)]
pub struct Row {
    pub episode: u32,
    pub phase: String,
    pub time_s: f64,
    pub robot: u16,
    pub command: [f32; 2],
}

impl Row {
    fn read(line: &str) -> Option<Row> {
        let fields: Vec<&str> = line.split(',').collect();
        let float = |at: usize| fields.get(at)?.parse::<f32>().ok();
        Some(Row {
            episode: fields.get(1)?.parse().ok()?,
            phase: (*fields.get(2)?).to_owned(),
            time_s: fields.get(3)?.parse().ok()?,
            robot: fields.get(4)?.parse().ok()?,
            command: [float(9)?, float(10)?],
        })
    }

    pub fn is_driven(&self) -> bool {
        self.command != [0.0; 2]
    }
}

/// Output of a host.
#[derive(Debug)]
pub enum Said {
    Row(Row),
    Event(HostEvent),
    /// A line of stderr.
    Log(String),
    /// The end of an output.
    Closed,
}

/// Output of a host, with its incarnation and time of arrival.
pub struct Heard {
    pub host: String,
    pub life: u32,
    pub at: Instant,
    pub said: Said,
}

/// A host's process.
struct Member {
    child: Child,
    life: u32,
}

/// Processes of a team; all are killed when this is dropped.
pub struct Crew {
    command: Box<dyn Fn(&str) -> Command>,
    members: BTreeMap<String, Member>,
    heard: (SyncSender<Heard>, Receiver<Heard>),
}

impl Crew {
    /// Creates a team without processes; `command` starts a host by name. The host of the World prints trajectories.
    pub fn new(command: impl Fn(&str) -> Command + 'static) -> Crew {
        Crew { command: Box::new(command), members: BTreeMap::new(), heard: sync_channel(65_536) }
    }

    /// Starts or restarts a host.
    pub fn start(&mut self, host: &str) {
        let life = self.members.remove(host).map_or(1, |member| member.life + 1);
        let mut command = (self.command)(host);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
        let (data, logs) = (child.stdout.take().expect("it is piped"), child.stderr.take().expect("it is piped"));
        self.members.insert(host.to_owned(), Member { child, life });
        self.listen(host, life, data, |line| {
            let event = HostEvent::from_line(&line).map(Said::Event);
            event.or_else(|| Row::read(&line).map(Said::Row))
        });
        self.listen(host, life, logs, |line| Some(Said::Log(line)));
    }

    fn listen(&self, host: &str, life: u32, pipe: impl Read + Send + 'static, read: fn(String) -> Option<Said>) {
        let (sender, host) = (self.heard.0.clone(), host.to_owned());
        thread::spawn(move || {
            let lines = BufReader::new(pipe).lines().map_while(Result::ok).filter_map(read);
            for said in lines.chain([Said::Closed]) {
                let heard = Heard { host: host.clone(), life, at: Instant::now(), said };
                if sender.send(heard).is_err() {
                    return;
                }
            }
        });
    }

    pub fn pid(&self, host: &str) -> Pid {
        Pid::from_raw(i32::try_from(self.members[host].child.id()).expect("process numbers are small"))
    }

    /// Sends a signal to a host; returns the time right after it.
    pub fn signal(&self, host: &str, signal: Signal) -> Instant {
        kill(self.pid(host), signal).expect("it runs");
        Instant::now()
    }

    /// Waits for a host to end; returns its exit code, or none after a signal.
    pub fn ended(&mut self, host: &str) -> Option<i32> {
        self.members.get_mut(host).expect("it was started").child.wait().expect("it is ours").code()
    }

    /// Reads output until `found` returns something.
    pub fn until<T>(&self, what: &str, mut found: impl FnMut(&Heard) -> Option<T>) -> T {
        let deadline = Instant::now() + PATIENCE;
        let (mut last, mut logs) = (String::new(), String::new());
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            let Ok(heard) = self.heard.1.recv_timeout(left) else { panic!("never came: {what}; last: {last}{logs}") };
            // Late output of a former incarnation is ignored.
            if self.members[&heard.host].life != heard.life {
                continue;
            }
            if let Some(found) = found(&heard) {
                return found;
            }
            if matches!(heard.said, Said::Log(_) | Said::Closed) {
                logs += &format!("\n{}: {:?}", heard.host, heard.said);
            }
            last = format!("{}: {:?}", heard.host, heard.said);
        }
    }

    /// Reads output for this long, and drops it.
    pub fn pass(&self, span: Duration) {
        let until = Instant::now() + span;
        while let Some(left) = until.checked_duration_since(Instant::now()) {
            let _ = self.heard.1.recv_timeout(left);
        }
    }

    /// Waits until these hosts run.
    pub fn ready(&self, hosts: &[&str]) {
        let mut waiting: Vec<&str> = hosts.to_vec();
        self.until("all hosts run", |heard| {
            if matches!(heard.said, Said::Event(HostEvent::Ready { .. })) {
                waiting.retain(|host| *host != heard.host);
            }
            if let Said::Log(line) = &heard.said {
                assert!(!line.contains("error:"), "{} does not start: {line}", heard.host);
            }
            waiting.is_empty().then_some(())
        });
    }

    /// Waits for a row.
    pub fn row<T>(&self, what: &str, mut found: impl FnMut(&Row, Instant) -> Option<T>) -> T {
        self.until(what, |heard| match &heard.said {
            Said::Row(row) => found(row, heard.at),
            _ => None,
        })
    }

    /// Waits until all these robots are driven in an episode after this one; returns the episode.
    pub fn runs_after(&self, episode: Option<u32>, robots: &[u16]) -> u32 {
        let (mut now, mut waiting) = (None, robots.to_vec());
        self.row("the next episode runs", |row, _| {
            if now != Some(row.episode) {
                (now, waiting) = (Some(row.episode), robots.to_vec());
            }
            if row.phase == "Running" && episode.is_none_or(|before| row.episode > before) && row.is_driven() {
                waiting.retain(|robot| *robot != row.robot);
            }
            waiting.is_empty().then_some(row.episode)
        })
    }
}

impl Drop for Crew {
    fn drop(&mut self) {
        for member in self.members.values_mut() {
            let _ = member.child.kill();
            let _ = member.child.wait();
        }
    }
}

/// Returns a folder with a key and this team file, and the path of the file.
pub fn folder(team: &str) -> (TempDir, String) {
    let folder = TempDir::new().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    write(path("team.toml"), team).expect("it can be written");
    assert_eq!(run(&["key", "new", "--out", &path("team.key")]).status.code(), Some(0));
    let file = path("team.toml");
    (folder, file)
}

/// Starts the team of this text, with key files of their own in the folder `keys` for these hosts; that of the World
/// prints trajectories. Returns the folder and the path of the team file, too.
pub fn of_members(team: &str, hosts: &[&str]) -> (Crew, TempDir, String) {
    let tables = hosts.iter().map(|host| format!("[host.{host}]\nkey_file = \"keys/{host}.key\"\n\n"));
    let team = team.replace("\"team.key\"", "\"keys/operator-1.key\"") + &tables.collect::<String>();
    let (folder, file) = folder(&team);
    let keys = folder.path().join("keys").to_string_lossy().into_owned();
    assert_eq!(run(&["key", "new", &file, "--out", &keys]).status.code(), Some(0));
    let of = file.clone();
    let mut crew = Crew::new(move |host| {
        let mut command = murmurate(&["host", &of, "--host", host, "--json"]);
        if host == "world" {
            command.args(["--trajectories", "/dev/stdout"]);
        }
        command
    });
    hosts.iter().for_each(|host| crew.start(host));
    crew.ready(hosts);
    (crew, folder, file)
}

/// Prints directly to stderr, because the output of a passing test is captured.
pub fn report(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
