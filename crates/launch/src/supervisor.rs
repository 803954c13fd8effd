//! Supervises a group of processes: starts them, reads their output, restarts them within limits, and stops them
//! together.
//!
//! The caller provides the commands of the processes and interprets their output.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;

use crate::outcome::Outcome;

/// Interval at which the supervisor checks for ended processes and exceeded time limits while no process prints.
const TICK: Duration = Duration::from_millis(50);

/// Longest time that the output of an ended process is waited for, because a child of it holds the pipes open.
const PIPES: Duration = Duration::from_secs(1);

/// Largest length of a line of a process's output \[bytes\]; longer lines are split.
const LINE: u64 = 1 << 16;

/// Capacity of the queue of output lines that the caller has not handled yet \[lines\]. Processes that print faster
/// have to wait.
const QUEUE: usize = 1024;

/// Exit code of a process that refuses its flags or files; it is not restarted.
const REFUSED: i32 = 2;
/// Exit code of a process that has failed. A process whose work is done can only have lost output.
const FAILED: i32 = 1;

/// Limits on the restarts of processes, and on the time for their end.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Largest number of restarts of a process within `window`.
    pub restarts: usize,
    /// Length of the time window in which restarts of a process are counted.
    pub window: Duration,
    /// Longest time for the remaining processes to end by themselves, after the work is done or a process has ended
    /// with exit code 0. Then they are asked to stop; it is a failure if the work is not done.
    pub finish: Duration,
    /// Longest time for a process to end after a request to stop (SIGTERM). Then it is killed.
    pub stop: Duration,
}

impl Default for Limits {
    fn default() -> Limits {
        let s = Duration::from_secs;
        Limits { restarts: 3, window: s(60), finish: s(4), stop: s(5) }
    }
}

/// Process that a supervisor starts: its name and its command.
pub struct Process {
    /// Name of the process.
    pub name: String,
    /// Command of the process, for its first start and for each restart.
    pub command: Command,
}

/// Line of output of a supervised process, or a note of the supervisor about the process.
pub enum Output<'a> {
    /// Line that a process has printed on stdout.
    Data(&'a str),
    /// Line that a process has printed on stderr.
    Log(&'a str),
    /// Note that the supervisor has stopped or killed a process, and why.
    Note(&'a str),
    /// Note that a process has died before its work was done, and whether it is started again.
    Died(&'a str),
}

/// Whether a note of the supervisor is about the death of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum About {
    Death,
    Stop,
}

/// Response of the supervisor's caller to an output of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// The work is not done; the run continues.
    Continue,
    /// The work is done, and all processes are expected to end by themselves.
    Done,
}

enum Event {
    Line { at: usize, data: bool, text: String },
    Closed { at: usize, start: u32 },
    Stop,
}

/// Handle for requests to stop all processes of a [`Supervisor`]. The first request sends SIGTERM; a second one kills
/// them.
#[derive(Clone)]
pub struct Stopper(SyncSender<Event>);

impl Stopper {
    /// Asks the supervisor to stop all processes by SIGTERM; a second call kills them.
    pub fn stop(&self) {
        // The receiver is gone once all processes have ended.
        let _ = self.0.send(Event::Stop);
    }
}

/// State of one supervised process over its restarts.
struct Slot {
    process: Process,
    child: Option<Child>,
    /// Number of starts of the process so far.
    start: u32,
    open_pipes: u8,
    gone: Option<(ExitStatus, Instant)>,
    crashes: VecDeque<Instant>,
    last_line: String,
    /// Whether the process has reported since its last start that the work is done.
    done: bool,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Phase {
    Running,
    /// The work is done, or a process has ended too early, at this time and for this reason; the other processes are
    /// expected to end, too.
    Finishing(Instant, Why),
    /// All processes were asked to stop at this time.
    Stopping(Instant),
    Killed,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Why {
    Done,
    Ended(String),
}

/// Starts a group of processes, reads their output, restarts those that fail, and stops them together.
pub struct Supervisor {
    limits: Limits,
    slots: Vec<Slot>,
    phase: Phase,
    outcome: Outcome,
    notes: Vec<(usize, About, String)>,
    events: Receiver<Event>,
    sender: SyncSender<Event>,
}

impl Supervisor {
    /// Returns a supervisor of these processes, none of which it has started yet.
    pub fn new(processes: Vec<Process>, limits: Limits) -> Supervisor {
        let (sender, events) = sync_channel(QUEUE);
        let slot = |process| Slot {
            process,
            child: None,
            start: 0,
            open_pipes: 0,
            gone: None,
            crashes: VecDeque::new(),
            last_line: String::new(),
            done: false,
        };
        let slots = processes.into_iter().map(slot).collect();
        let (phase, outcome, notes) = (Phase::Running, Outcome::Done, Vec::new());
        Supervisor { limits, slots, phase, outcome, notes, events, sender }
    }

    /// Returns a handle that stops the processes from another thread.
    pub fn stopper(&self) -> Stopper {
        Stopper(self.sender.clone())
    }

    /// Starts the processes, and returns the outcome when all have ended. Calls `handle` with each output and the index
    /// of its process; its response [`Response::Done`] says that all processes should now end by themselves.
    pub fn run(mut self, mut handle: impl FnMut(usize, Output<'_>) -> Response) -> Outcome {
        for at in 0..self.slots.len() {
            if self.phase == Phase::Running {
                self.start(at);
            }
        }
        while self.slots.iter().any(|slot| slot.child.is_some()) {
            match self.events.recv_timeout(TICK) {
                Ok(Event::Line { at, data, text }) => {
                    if !data {
                        self.slots[at].last_line.clone_from(&text);
                    }
                    let output = if data { Output::Data(&text) } else { Output::Log(&text) };
                    let response = handle(at, output);
                    self.slots[at].done |= response == Response::Done;
                    if response == Response::Done && matches!(self.phase, Phase::Running | Phase::Finishing(..)) {
                        self.phase = Phase::Finishing(Instant::now(), Why::Done);
                    }
                }
                Ok(Event::Closed { at, start }) if self.slots[at].start == start => self.slots[at].open_pipes -= 1,
                Ok(Event::Closed { .. }) => {}
                Ok(Event::Stop) => self.asked_to_stop(),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => unreachable!("a sender is kept"),
            }
            self.reap();
            self.enforce_limits();
            for (at, about, note) in std::mem::take(&mut self.notes) {
                handle(at, if about == About::Death { Output::Died(&note) } else { Output::Note(&note) });
            }
        }
        self.outcome.clone()
    }

    fn start(&mut self, at: usize) {
        let slot = &mut self.slots[at];
        let command = &mut slot.process.command;
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        // Each process gets its own process group, so that Ctrl-C on the terminal reaches only this program, which then
        // stops the others.
        command.process_group(0);
        slot.start += 1;
        slot.done = false;
        match command.spawn() {
            Ok(mut child) => {
                let pipes: [(bool, Box<dyn Read + Send>); 2] = [
                    (true, Box::new(child.stdout.take().expect("it is piped"))),
                    (false, Box::new(child.stderr.take().expect("it is piped"))),
                ];
                for (data, pipe) in pipes {
                    let (sender, start) = (self.sender.clone(), slot.start);
                    thread::spawn(move || read_lines(pipe, at, data, start, &sender));
                }
                (slot.open_pipes, slot.gone, slot.child) = (2, None, Some(child));
            }
            Err(error) => {
                let why = format!("the process '{}' cannot be started: {error}", slot.process.name);
                self.fail(Outcome::Failed(why));
            }
        }
    }

    /// Finds processes that have ended and whose output was read, and restarts them or ends the run. Output is waited
    /// for up to `PIPES`.
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
                self.phase = Phase::Finishing(Instant::now(), Why::Ended(name));
            }
            return;
        }
        let how = how(status);
        let words = if slot.last_line.is_empty() { String::new() } else { format!(": {}", slot.last_line) };
        if status.code() == Some(REFUSED) {
            let line = slot.last_line.trim_start_matches("error: ");
            let why = if line.is_empty() { "it has refused its flags or files" } else { line };
            let refused = Outcome::Refused(format!("the process '{name}': {why}"));
            return self.fail(refused);
        }
        if slot.done && status.code() == Some(FAILED) {
            let why = slot.last_line.trim_start_matches("error: ");
            return self.outcome.lose(format!("the process '{name}' could not write all of its output: {why}"));
        }
        if self.phase != Phase::Running {
            self.notes.push((at, About::Death, format!("has failed at the very end ({how})")));
            let why = format!("the process '{name}' has failed at the very end ({how}){words}");
            return self.fail(Outcome::Failed(why));
        }
        let now = Instant::now();
        slot.crashes.retain(|crash| now.duration_since(*crash) < limits.window);
        slot.crashes.push_back(now);
        let (crashes, window) = (slot.crashes.len(), limits.window.as_secs());
        if crashes > limits.restarts {
            let note = format!("has failed too often, {crashes} times in {window} s ({how}); the team is stopped");
            self.notes.push((at, About::Death, note));
            let why = format!("the process '{name}' has failed {crashes} times in {window} s ({how}){words}");
            return self.fail(Outcome::Failed(why));
        }
        let note = format!("has failed ({how}); started again, {crashes} of {} times in {window} s", limits.restarts);
        self.notes.push((at, About::Death, note));
        self.start(at);
    }

    fn fail(&mut self, outcome: Outcome) {
        self.outcome.fail(outcome);
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

    /// Ends the run if processes do not end by themselves in `Limits::finish`, and kills them if they do not stop in
    /// `Limits::stop`.
    fn enforce_limits(&mut self) {
        match &self.phase {
            Phase::Finishing(since, why) if since.elapsed() > self.limits.finish => {
                match why {
                    // The work is done. A process that was restarted at the very end has not heard of it.
                    Why::Done => {
                        let note = "has not heard that the team has finished; it is asked to stop";
                        let late = self.slots.iter().enumerate().filter(|(_, slot)| slot.child.is_some());
                        self.notes.extend(late.map(|(at, _)| (at, About::Stop, note.to_owned())));
                    }
                    Why::Ended(name) => {
                        let why = format!("the process '{name}' has ended before the team has finished");
                        self.outcome.fail(Outcome::Failed(why));
                    }
                }
                self.stop_all();
            }
            Phase::Stopping(since) if since.elapsed() > self.limits.stop => {
                let why = format!("has not stopped in {} s", self.limits.stop.as_secs_f64());
                let killed = self.kill(&why);
                if !killed.is_empty() && matches!(self.outcome, Outcome::Interrupted | Outcome::Done) {
                    self.outcome = Outcome::Failed(format!("killed, because it {why}: {}", killed.join(", ")));
                }
            }
            _ => {}
        }
    }

    /// Kills the processes that still run, and notes the reason `why` for each. Returns their names.
    fn kill(&mut self, why: &str) -> Vec<String> {
        self.phase = Phase::Killed;
        let mut killed = Vec::new();
        for (at, slot) in self.slots.iter_mut().enumerate().filter(|(_, slot)| slot.gone.is_none()) {
            let Some(child) = &mut slot.child else { continue };
            kill(child);
            self.notes.push((at, About::Stop, format!("{why}; killed")));
            killed.push(slot.process.name.clone());
        }
        killed
    }
}

/// Kills the processes that still run, for example after a panic.
impl Drop for Supervisor {
    fn drop(&mut self) {
        self.slots.iter_mut().filter_map(|slot| slot.child.as_mut()).for_each(kill);
    }
}

/// Sends the lines of a process's pipe as events until it is closed. Invalid UTF-8 is replaced; long lines are split.
fn read_lines(pipe: impl Read, at: usize, data: bool, start: u32, sender: &SyncSender<Event>) {
    let mut reader = BufReader::new(pipe);
    let mut line = Vec::new();
    while let Ok(1..) = reader.by_ref().take(LINE).read_until(b'\n', &mut line) {
        let text = String::from_utf8_lossy(line.trim_ascii_end()).into_owned();
        line.clear();
        if sender.send(Event::Line { at, data, text }).is_err() {
            return;
        }
    }
    // The receiver is gone once all processes have ended.
    let _ = sender.send(Event::Closed { at, start });
}

fn ask_to_stop(child: &mut Child) {
    signal(child, Signal::SIGTERM);
    // A halted process handles the signal once it continues.
    signal(child, Signal::SIGCONT);
}

fn kill(child: &mut Child) {
    signal(child, Signal::SIGKILL);
}

/// Sends a signal to a process and to all processes that it has started. Its id is not reused, because it was not
/// waited for yet. If it has just ended, the signal has no effect.
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
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        Process { name: name.to_owned(), command }
    }

    /// Shell script that waits for SIGTERM and then exits with code 0.
    const PATIENT: &str = "trap 'echo stopped; exit 0' TERM; echo ready; tail -f /dev/null & wait";
    /// Shell script that ignores SIGTERM.
    const STUBBORN: &str = "trap '' TERM; echo ready; tail -f /dev/null & wait; wait; wait";

    /// Runs the processes. Returns the outcome and the output; each line begins with process and kind.
    fn run(processes: Vec<Process>, limits: Limits, stop_at: &str) -> (Outcome, Vec<String>) {
        let names: Vec<String> = processes.iter().map(|process| process.name.clone()).collect();
        let supervisor = Supervisor::new(processes, limits);
        let stopper = supervisor.stopper();
        let mut all = Vec::new();
        let mut ready = 0;
        let outcome = supervisor.run(|at, output| {
            let (kind, line) = match output {
                Output::Data(line) => ("out", line),
                Output::Log(line) => ("err", line),
                Output::Note(line) => ("note", line),
                Output::Died(line) => ("note", line),
            };
            all.push(format!("{} {kind}: {line}", names[at]));
            ready += usize::from(line == "ready");
            if !stop_at.is_empty() && (line == stop_at || (stop_at == "all ready" && ready == names.len())) {
                ready = 0;
                stopper.stop();
            }
            if line == "done" { Response::Done } else { Response::Continue }
        });
        (outcome, all)
    }

    fn short() -> Limits {
        let ms = Duration::from_millis;
        Limits { finish: ms(200), stop: ms(200), ..Limits::default() }
    }

    #[test]
    fn processes_that_exit_with_0_are_done_and_all_their_output_is_passed_on() {
        let script = "echo one; echo two >&2; printf three";
        let (outcome, mut heard) = run(vec![shell("a", script), shell("b", "exit 0")], Limits::default(), "");
        heard.sort();
        assert_eq!(outcome, Outcome::Done);
        assert_eq!(heard, ["a err: two", "a out: one", "a out: three"]);
    }

    #[test]
    fn a_crashed_process_is_restarted_three_times_and_then_all_are_stopped() {
        let (outcome, heard) = run(vec![shell("a", PATIENT), shell("b", "echo boom >&2; exit 7")], short(), "");
        let why = "the process 'b' has failed 4 times in 60 s (exit code 7): boom";
        assert_eq!(outcome, Outcome::Failed(why.to_owned()));
        assert_eq!(heard.iter().filter(|line| *line == "b err: boom").count(), 4);
        assert_eq!(heard.iter().filter(|line| line.starts_with("b note: has failed (exit code 7)")).count(), 3);
        assert!(heard.iter().any(|line| line.contains("started again, 3 of 3 times in 60 s")), "{heard:?}");
    }

    #[test]
    fn a_killed_process_is_restarted_and_the_run_is_done() {
        let folder = tempfile::TempDir::new().expect("a temporary folder");
        let mark = folder.path().join("mark");
        let script = format!("test -e {0} && echo done && exit 0; touch {0}; kill -9 $$", mark.display());
        let (outcome, heard) = run(vec![shell("a", &script)], Limits::default(), "");
        assert_eq!(outcome, Outcome::Done);
        let note = "a note: has failed (signal 9, SIGKILL); started again, 1 of 3 times in 60 s";
        assert_eq!(heard, [note, "a out: done"]);
    }

    #[test]
    fn a_request_to_stop_reaches_all_processes() {
        let (outcome, heard) = run(vec![shell("a", PATIENT), shell("b", PATIENT)], Limits::default(), "all ready");
        assert_eq!(outcome, Outcome::Interrupted);
        assert_eq!(heard.iter().filter(|line| line.ends_with("out: stopped")).count(), 2, "{heard:?}");
    }

    #[test]
    fn a_process_that_does_not_stop_is_killed_and_named() {
        let (outcome, heard) = run(vec![shell("b", STUBBORN)], short(), "all ready");
        assert_eq!(outcome, Outcome::Failed("killed, because it has not stopped in 0.2 s: b".to_owned()));
        assert!(heard.contains(&"b note: has not stopped in 0.2 s; killed".to_owned()), "{heard:?}");
    }

    #[test]
    fn a_second_request_kills_at_once() {
        let processes = vec![shell("a", "trap 'echo stopped' TERM; echo ready; tail -f /dev/null & wait; wait")];
        let supervisor = Supervisor::new(processes, Limits { stop: Duration::from_secs(600), ..Limits::default() });
        let stopper = supervisor.stopper();
        let outcome = supervisor.run(|_, output| {
            if matches!(output, Output::Data("ready" | "stopped")) {
                stopper.stop();
            }
            Response::Continue
        });
        assert_eq!(outcome, Outcome::Interrupted);
    }

    #[test]
    fn a_process_that_runs_on_after_the_end_is_stopped_and_named() {
        let (outcome, heard) = run(vec![shell("a", "echo done"), shell("b", PATIENT)], short(), "");
        assert_eq!(outcome, Outcome::Done, "the work is done, and it has stopped when it was asked to");
        assert!(heard.iter().any(|line| line.starts_with("b note: has not heard that the team")), "{heard:?}");
        let (outcome, _) = run(vec![shell("a", "echo done"), shell("b", STUBBORN)], short(), "");
        assert_eq!(outcome, Outcome::Failed("killed, because it has not stopped in 0.2 s: b".to_owned()));
        let (outcome, _) = run(vec![shell("a", "exit 0"), shell("b", PATIENT)], short(), "");
        assert_eq!(outcome, Outcome::Failed("the process 'a' has ended before the team has finished".to_owned()));
    }

    #[test]
    fn a_process_that_loses_output_at_its_end_leaves_the_work_done() {
        let full = "echo done; echo 'error: no space' >&2; exit 1";
        let all = vec![shell("a", full), shell("b", "echo done"), shell("c", full)];
        let (outcome, heard) = run(all, Limits::default(), "");
        let Outcome::Incomplete(why) = outcome else { panic!("{outcome:?}") };
        for name in ["a", "c"] {
            let lost = format!("the process '{name}' could not write all of its output: no space");
            assert!(why.contains(&lost), "{why}");
        }
        assert!(heard.iter().all(|line| !line.contains("note")), "no restart: {heard:?}");
    }

    #[test]
    fn a_process_that_refuses_its_flags_is_not_restarted() {
        let script = "echo 'error: link infra has no interface' >&2; exit 2";
        let (outcome, heard) = run(vec![shell("a", script), shell("b", PATIENT)], short(), "");
        assert_eq!(outcome, Outcome::Refused("the process 'a': link infra has no interface".to_owned()));
        assert_eq!(heard.iter().filter(|line| line.starts_with("a err")).count(), 1);
    }

    #[test]
    fn a_missing_program_stops_the_other_processes() {
        let missing = Process { name: "b".to_owned(), command: Command::new("/nowhere/at/all") };
        let (outcome, _) = run(vec![shell("a", PATIENT), missing], short(), "");
        let Outcome::Failed(why) = outcome else { panic!("{outcome:?}") };
        assert!(why.starts_with("the process 'b' cannot be started"), "{why}");
    }

    #[test]
    fn endless_lines_are_split_and_invalid_utf8_is_replaced() {
        let script = "head -c 200000 /dev/zero | tr '\\0' x; printf '\\377\\376\\n'";
        let (outcome, heard) = run(vec![shell("a", script)], Limits::default(), "");
        assert_eq!((outcome, heard.len()), (Outcome::Done, 4));
        assert!(heard.iter().all(|line| line.len() <= (1 << 16) + 16));
    }
}
