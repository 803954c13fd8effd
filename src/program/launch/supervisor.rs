//! Processes that belong together: started, listened to, restarted within bounds, and stopped together.
//!
//! What they are and what their lines mean is not known here; the command is handed in.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;

/// How often the processes are looked at when they say nothing.
const TICK: Duration = Duration::from_millis(50);

/// How long after a process has gone its pipes may stay open, held by a process of its own.
const PIPES: Duration = Duration::from_secs(1);

/// The longest line that is passed on whole \[bytes\].
const LINE: u64 = 1 << 16;

/// Lines that may wait; processes that talk faster wait, too.
const QUEUE: usize = 1024;

/// The exit code of a process that has refused its flags or files: it would do so again.
const REFUSED: i32 = 2;

/// How patient the supervisor is.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// How often a process is started again within the window.
    pub restarts: usize,
    /// The window.
    pub window: Duration,
    /// How long the others may take once the first has finished.
    pub farewell: Duration,
    /// How long a process may take to stop when it is asked to.
    pub stop: Duration,
}

impl Default for Limits {
    fn default() -> Limits {
        let s = Duration::from_secs;
        Limits { restarts: 3, window: s(60), farewell: s(10), stop: s(5) }
    }
}

/// A process to be.
pub struct Process {
    /// Its name.
    pub name: String,
    /// Its command, made anew for every start.
    pub command: Box<dyn Fn() -> Command>,
}

/// What is heard while the processes run.
pub enum Heard<'a> {
    /// A line of a process's stdout.
    Data(&'a str),
    /// A line of a process's stderr.
    Log(&'a str),
    /// What the supervisor has done about a process.
    Note(&'a str),
}

/// What the listener makes of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Go on.
    On,
    /// The work is done: all processes are expected to end by themselves now.
    Done,
}

/// How it ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// All processes ended by themselves and well.
    Done,
    /// Somebody asked for it.
    Interrupted,
    /// A process has refused its flags or files; its last words.
    Refused(String),
    /// A process has failed, or had to be stopped; which, and how.
    Failed(String),
}

enum Event {
    Line { at: usize, data: bool, text: String },
    Closed { at: usize, start: u32 },
    Stop,
}

/// Asks the supervisor to stop; asked a second time, it kills.
#[derive(Clone)]
pub struct Stopper(SyncSender<Event>);

impl Stopper {
    /// Asks.
    pub fn stop(&self) {
        // Nobody listens any more when all has ended, and then there is nothing to stop.
        let _ = self.0.send(Event::Stop);
    }
}

/// What runs, and what has run, under one name.
struct Slot {
    process: Process,
    child: Option<Child>,
    /// How often it was started.
    start: u32,
    open_pipes: u8,
    gone: Option<(ExitStatus, Instant)>,
    crashes: VecDeque<Instant>,
    last_words: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Phase {
    Running,
    /// The work is done, or somebody has ended well, before whom nobody should.
    Farewell(Instant, Why),
    /// All were asked to stop.
    Stopping(Instant),
    Killed,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Why {
    Done,
    Ended(String),
}

/// The supervisor.
pub struct Supervisor {
    limits: Limits,
    slots: Vec<Slot>,
    phase: Phase,
    outcome: Outcome,
    notes: Vec<(usize, String)>,
    events: Receiver<Event>,
    sender: SyncSender<Event>,
}

impl Supervisor {
    /// A supervisor of these processes; nothing is started yet.
    pub fn new(processes: Vec<Process>, limits: Limits) -> Supervisor {
        let (sender, events) = sync_channel(QUEUE);
        let slot = |process| Slot {
            process,
            child: None,
            start: 0,
            open_pipes: 0,
            gone: None,
            crashes: VecDeque::new(),
            last_words: String::new(),
        };
        let slots = processes.into_iter().map(slot).collect();
        let (phase, outcome, notes) = (Phase::Running, Outcome::Done, Vec::new());
        Supervisor { limits, slots, phase, outcome, notes, events, sender }
    }

    /// What stops it from another thread.
    pub fn stopper(&self) -> Stopper {
        Stopper(self.sender.clone())
    }

    /// Starts the processes and returns when all have ended. `listen` hears everything, with the number of the process.
    pub fn run(mut self, mut listen: impl FnMut(usize, Heard<'_>) -> Answer) -> Outcome {
        for at in 0..self.slots.len() {
            if self.phase == Phase::Running {
                self.start(at);
            }
        }
        while self.slots.iter().any(|slot| slot.child.is_some()) {
            match self.events.recv_timeout(TICK) {
                Ok(Event::Line { at, data, text }) => {
                    if !data {
                        self.slots[at].last_words.clone_from(&text);
                    }
                    let heard = if data { Heard::Data(&text) } else { Heard::Log(&text) };
                    let answer = listen(at, heard);
                    if answer == Answer::Done && matches!(self.phase, Phase::Running | Phase::Farewell(..)) {
                        self.phase = Phase::Farewell(Instant::now(), Why::Done);
                    }
                }
                Ok(Event::Closed { at, start }) if self.slots[at].start == start => self.slots[at].open_pipes -= 1,
                Ok(Event::Closed { .. }) => {}
                Ok(Event::Stop) => self.asked_to_stop(),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => unreachable!("a sender is kept"),
            }
            self.reap();
            self.hurry();
            for (at, note) in std::mem::take(&mut self.notes) {
                listen(at, Heard::Note(&note));
            }
        }
        self.outcome.clone()
    }

    fn start(&mut self, at: usize) {
        let slot = &mut self.slots[at];
        let mut command = (slot.process.command)();
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Ctrl-C on the terminal comes here only, and is passed on once.
        command.process_group(0);
        slot.start += 1;
        match command.spawn() {
            Ok(mut child) => {
                let pipes: [(bool, Box<dyn Read + Send>); 2] = [
                    (true, Box::new(child.stdout.take().expect("it is piped"))),
                    (false, Box::new(child.stderr.take().expect("it is piped"))),
                ];
                for (data, pipe) in pipes {
                    let (sender, start) = (self.sender.clone(), slot.start);
                    thread::spawn(move || listen_to(pipe, at, data, start, &sender));
                }
                (slot.open_pipes, slot.gone, slot.child) = (2, None, Some(child));
            }
            Err(error) => {
                let why = format!("the process '{}' cannot be started: {error}", slot.process.name);
                self.fail(Outcome::Failed(why));
            }
        }
    }

    /// Finds out who has ended, once all that it said was heard.
    fn reap(&mut self) {
        for at in 0..self.slots.len() {
            let slot = &mut self.slots[at];
            let Some(child) = &mut slot.child else { continue };
            if slot.gone.is_none() {
                let status = child.try_wait().expect("a child can be waited for");
                slot.gone = status.map(|status| (status, Instant::now()));
            }
            if let Some((status, since)) = slot.gone
                && (slot.open_pipes == 0 || since.elapsed() > PIPES)
            {
                slot.child = None;
                self.ended(at, status);
            }
        }
    }

    fn ended(&mut self, at: usize, status: ExitStatus) {
        let limits = self.limits;
        let slot = &mut self.slots[at];
        let name = slot.process.name.clone();
        if matches!(self.phase, Phase::Stopping(_) | Phase::Killed) {
            return;
        }
        if status.success() {
            if self.phase == Phase::Running {
                self.phase = Phase::Farewell(Instant::now(), Why::Ended(name));
            }
            return;
        }
        let how = how(status);
        let words = if slot.last_words.is_empty() { String::new() } else { format!(": {}", slot.last_words) };
        if status.code() == Some(REFUSED) {
            let said = slot.last_words.trim_start_matches("error: ");
            let why = if said.is_empty() { "it has refused its flags or files" } else { said };
            let refused = Outcome::Refused(format!("the process '{name}': {why}"));
            return self.fail(refused);
        }
        if self.phase != Phase::Running {
            let why = format!("the process '{name}' has failed at the very end ({how}){words}");
            return self.fail(Outcome::Failed(why));
        }
        let now = Instant::now();
        slot.crashes.retain(|crash| now.duration_since(*crash) < limits.window);
        slot.crashes.push_back(now);
        let (crashes, window) = (slot.crashes.len(), limits.window.as_secs());
        if crashes > limits.restarts {
            let why = format!("the process '{name}' has failed {crashes} times in {window} s ({how}){words}");
            return self.fail(Outcome::Failed(why));
        }
        let note = format!("has failed ({how}); started again, {crashes} of {} times in {window} s", limits.restarts);
        self.notes.push((at, note));
        self.start(at);
    }

    fn fail(&mut self, outcome: Outcome) {
        // The first to fail is the cause; what falls after it is not.
        if self.outcome == Outcome::Done {
            self.outcome = outcome;
        }
        self.stop_all();
    }

    fn asked_to_stop(&mut self) {
        if matches!(self.phase, Phase::Stopping(_)) {
            self.kill("was asked to stop a second time");
            return;
        }
        if self.outcome == Outcome::Done {
            self.outcome = Outcome::Interrupted;
        }
        self.stop_all();
    }

    fn stop_all(&mut self) {
        if !matches!(self.phase, Phase::Stopping(_) | Phase::Killed) {
            self.phase = Phase::Stopping(Instant::now());
            self.slots.iter_mut().filter_map(|slot| slot.child.as_mut()).for_each(ask_to_stop);
        }
    }

    /// Stops those that take too long.
    fn hurry(&mut self) {
        match &self.phase {
            Phase::Farewell(since, why) if since.elapsed() > self.limits.farewell => {
                let slots = self.slots.iter().filter(|slot| slot.child.is_some());
                let late: Vec<&str> = slots.map(|slot| slot.process.name.as_str()).collect();
                let s = self.limits.farewell.as_secs_f64();
                let why = match why {
                    Why::Done => format!("still running {s} s after the team has finished: {}", late.join(", ")),
                    Why::Ended(name) => format!("the process '{name}' has ended before the team has finished"),
                };
                self.fail(Outcome::Failed(why));
            }
            Phase::Stopping(since) if since.elapsed() > self.limits.stop => {
                let why = format!("has not stopped in {} s", self.limits.stop.as_secs_f64());
                let killed = self.kill(&why);
                if !killed.is_empty() && self.outcome == Outcome::Interrupted {
                    self.outcome = Outcome::Failed(format!("killed, because it {why}: {}", killed.join(", ")));
                }
            }
            _ => {}
        }
    }

    /// Kills what is left, and says whom.
    fn kill(&mut self, why: &str) -> Vec<String> {
        self.phase = Phase::Killed;
        let mut killed = Vec::new();
        for (at, slot) in self.slots.iter_mut().enumerate().filter(|(_, slot)| slot.gone.is_none()) {
            let Some(child) = &mut slot.child else { continue };
            kill(child);
            self.notes.push((at, format!("{why}; killed")));
            killed.push(slot.process.name.clone());
        }
        killed
    }
}

/// A supervisor that goes, by a panic say, leaves nobody behind.
impl Drop for Supervisor {
    fn drop(&mut self) {
        self.slots.iter_mut().filter_map(|slot| slot.child.as_mut()).for_each(kill);
    }
}

/// Passes on the lines of a pipe until it is closed; what is no UTF-8 is replaced, what is too long is cut in pieces.
fn listen_to(pipe: impl Read, at: usize, data: bool, start: u32, sender: &SyncSender<Event>) {
    let mut reader = BufReader::new(pipe);
    let mut line = Vec::new();
    while let Ok(1..) = reader.by_ref().take(LINE).read_until(b'\n', &mut line) {
        let text = String::from_utf8_lossy(line.trim_ascii_end()).into_owned();
        line.clear();
        if sender.send(Event::Line { at, data, text }).is_err() {
            return;
        }
    }
    // Nobody listens any more when all has ended.
    let _ = sender.send(Event::Closed { at, start });
}

fn ask_to_stop(child: &mut Child) {
    signal(child, Signal::SIGTERM);
    // One that is halted must go on to hear it.
    signal(child, Signal::SIGCONT);
}

fn kill(child: &mut Child) {
    signal(child, Signal::SIGKILL);
}

/// Sends a signal to a process and all that it has started. It is not yet waited for, so its number is still its own;
/// if it has ended in this moment, the signal goes nowhere.
fn signal(child: &Child, signal: Signal) {
    let group = Pid::from_raw(i32::try_from(child.id()).expect("process numbers are small"));
    let _ = killpg(group, signal);
}

fn how(status: ExitStatus) -> String {
    if let Some(signal) = status.signal() {
        let name = Signal::try_from(signal).map_or("unknown", |signal| signal.as_str());
        return format!("signal {signal}, {name}");
    }
    status.code().map_or_else(|| "no exit code".to_owned(), |code| format!("exit code {code}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(name: &str, script: &str) -> Process {
        let script = script.to_owned();
        let command = move || {
            let mut command = Command::new("sh");
            command.args(["-c", &script]);
            command
        };
        Process { name: name.to_owned(), command: Box::new(command) }
    }

    /// Waits until it is told to stop, and then ends well.
    const PATIENT: &str = "trap 'echo stopped; exit 0' TERM; echo ready; tail -f /dev/null & wait";
    /// Does not want to be told.
    const STUBBORN: &str = "trap '' TERM; echo ready; tail -f /dev/null & wait; wait; wait";

    /// Runs them; gives how it ended and what was heard, a letter for its kind before each line.
    fn run(processes: Vec<Process>, limits: Limits, stop_at: &str) -> (Outcome, Vec<String>) {
        let names: Vec<String> = processes.iter().map(|process| process.name.clone()).collect();
        let supervisor = Supervisor::new(processes, limits);
        let stopper = supervisor.stopper();
        let mut all = Vec::new();
        let mut ready = 0;
        let outcome = supervisor.run(|at, heard| {
            let (kind, line) = match heard {
                Heard::Data(line) => ("out", line),
                Heard::Log(line) => ("err", line),
                Heard::Note(line) => ("note", line),
            };
            all.push(format!("{} {kind}: {line}", names[at]));
            ready += usize::from(line == "ready");
            if !stop_at.is_empty() && (line == stop_at || (stop_at == "all ready" && ready == names.len())) {
                ready = 0;
                stopper.stop();
            }
            if line == "done" { Answer::Done } else { Answer::On }
        });
        (outcome, all)
    }

    fn short() -> Limits {
        let ms = Duration::from_millis;
        Limits { farewell: ms(200), stop: ms(200), ..Limits::default() }
    }

    #[test]
    fn processes_that_end_well_are_done_and_all_that_they_said_was_heard() {
        let script = "echo one; echo two >&2; printf three";
        let (outcome, mut heard) = run(vec![shell("a", script), shell("b", "exit 0")], Limits::default(), "");
        heard.sort();
        assert_eq!(outcome, Outcome::Done);
        assert_eq!(heard, ["a err: two", "a out: one", "a out: three"]);
    }

    #[test]
    fn a_crash_is_started_again_three_times_and_then_stops_all() {
        let (outcome, heard) = run(vec![shell("a", PATIENT), shell("b", "echo boom >&2; exit 7")], short(), "");
        let why = "the process 'b' has failed 4 times in 60 s (exit code 7): boom";
        assert_eq!(outcome, Outcome::Failed(why.to_owned()));
        assert_eq!(heard.iter().filter(|line| *line == "b err: boom").count(), 4);
        assert_eq!(heard.iter().filter(|line| line.starts_with("b note: has failed (exit code 7)")).count(), 3);
        assert!(heard.iter().any(|line| line.contains("started again, 3 of 3 times in 60 s")), "{heard:?}");
    }

    #[test]
    fn a_process_that_was_killed_comes_back_and_the_team_ends_well() {
        let folder = tempfile::TempDir::new().expect("a temporary folder");
        let mark = folder.path().join("mark");
        let script = format!("test -e {0} && echo done && exit 0; touch {0}; kill -9 $$", mark.display());
        let (outcome, heard) = run(vec![shell("a", &script)], Limits::default(), "");
        assert_eq!(outcome, Outcome::Done);
        let note = "a note: has failed (signal 9, SIGKILL); started again, 1 of 3 times in 60 s";
        assert_eq!(heard, [note, "a out: done"]);
    }

    #[test]
    fn a_request_to_stop_reaches_all() {
        let (outcome, heard) = run(vec![shell("a", PATIENT), shell("b", PATIENT)], Limits::default(), "all ready");
        assert_eq!(outcome, Outcome::Interrupted);
        assert_eq!(heard.iter().filter(|line| line.ends_with("out: stopped")).count(), 2, "{heard:?}");
    }

    #[test]
    fn one_that_does_not_stop_is_killed_and_named() {
        let (outcome, heard) = run(vec![shell("b", STUBBORN)], short(), "all ready");
        assert_eq!(outcome, Outcome::Failed("killed, because it has not stopped in 0.2 s: b".to_owned()));
        assert!(heard.contains(&"b note: has not stopped in 0.2 s; killed".to_owned()), "{heard:?}");
    }

    #[test]
    fn a_second_request_kills_at_once() {
        let processes = vec![shell("a", "trap 'echo stopped' TERM; echo ready; tail -f /dev/null & wait; wait")];
        let supervisor = Supervisor::new(processes, Limits { stop: Duration::from_secs(600), ..Limits::default() });
        let stopper = supervisor.stopper();
        let outcome = supervisor.run(|_, heard| {
            if matches!(heard, Heard::Data("ready" | "stopped")) {
                stopper.stop();
            }
            Answer::On
        });
        assert_eq!(outcome, Outcome::Interrupted);
    }

    #[test]
    fn one_that_stays_after_the_end_is_stopped_and_named() {
        let (outcome, _) = run(vec![shell("a", "echo done"), shell("b", PATIENT)], short(), "");
        assert_eq!(outcome, Outcome::Failed("still running 0.2 s after the team has finished: b".to_owned()));
        let (outcome, _) = run(vec![shell("a", "exit 0"), shell("b", PATIENT)], short(), "");
        assert_eq!(outcome, Outcome::Failed("the process 'a' has ended before the team has finished".to_owned()));
    }

    #[test]
    fn one_that_refuses_its_flags_is_not_started_again() {
        let script = "echo 'error: link infra has no interface' >&2; exit 2";
        let (outcome, heard) = run(vec![shell("a", script), shell("b", PATIENT)], short(), "");
        assert_eq!(outcome, Outcome::Refused("the process 'a': link infra has no interface".to_owned()));
        assert_eq!(heard.iter().filter(|line| line.starts_with("a err")).count(), 1);
    }

    #[test]
    fn a_program_that_is_not_there_stops_the_others() {
        let missing = Process { name: "b".to_owned(), command: Box::new(|| Command::new("/nowhere/at/all")) };
        let (outcome, _) = run(vec![shell("a", PATIENT), missing], short(), "");
        let Outcome::Failed(why) = outcome else { panic!("{outcome:?}") };
        assert!(why.starts_with("the process 'b' cannot be started"), "{why}");
    }

    #[test]
    fn lines_without_end_and_without_sense_do_no_harm() {
        let script = "head -c 200000 /dev/zero | tr '\\0' x; printf '\\377\\376\\n'";
        let (outcome, heard) = run(vec![shell("a", script)], Limits::default(), "");
        assert_eq!((outcome, heard.len()), (Outcome::Done, 4));
        assert!(heard.iter().all(|line| line.len() <= (1 << 16) + 16));
    }
}
