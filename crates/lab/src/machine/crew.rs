//! Commands in stations: one process a station, its output line by line, and its end.

use std::io::{BufRead, BufReader, Read};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;

use super::error::{Context, Result};

/// Longest time for a command to end after it was asked to; then it is killed.
const STOP: Duration = Duration::from_secs(5);
/// Interval at which ended processes are looked for.
const TICK: Duration = Duration::from_millis(50);

/// Outcome of the commands.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CrewEnd {
    /// Stations whose command has failed by itself, each with its exit status.
    pub failed: Vec<(u16, String)>,
    /// Whether the user has ended them.
    pub interrupted: bool,
}

/// Group of processes, each in a station.
pub struct Crew {
    children: Vec<(u16, Child)>,
    events: Receiver<Event>,
    sender: Sender<Event>,
}

enum Event {
    Line(u16, String),
    Stop,
}

/// Handle that ends the commands from another thread.
pub struct CrewStopper(Sender<Event>);

impl CrewStopper {
    /// Ends the commands: asks them at the first call, and kills them at the second.
    pub fn stop(&self) {
        // The receiver is gone once all have ended.
        let _ = self.0.send(Event::Stop);
    }
}

impl Crew {
    /// Starts these commands, each with the number of its station. If one cannot be started, none is left.
    pub fn start(commands: Vec<(u16, Command)>) -> Result<Crew> {
        let (sender, events) = channel();
        let mut crew = Crew { children: Vec::new(), events, sender };
        for (station, mut command) in commands {
            // Its own process group: Ctrl-C on the terminal is for this program, which then ends the others.
            command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
            let child = command.spawn().with_context(|| format!("the command of station {station}"))?;
            crew.children.push((station, child));
            let child = &mut crew.children.last_mut().expect("it was added").1;
            let pipes: [Box<dyn Read + Send>; 2] = [
                Box::new(child.stdout.take().expect("it is piped")),
                Box::new(child.stderr.take().expect("it is piped")),
            ];
            for pipe in pipes {
                let sender = crew.sender.clone();
                thread::spawn(move || {
                    for line in BufReader::new(pipe).split(b'\n').map_while(Result::ok) {
                        let text = String::from_utf8_lossy(line.trim_ascii_end()).into_owned();
                        if sender.send(Event::Line(station, text)).is_err() {
                            return;
                        }
                    }
                });
            }
        }
        Ok(crew)
    }

    /// Returns a handle that ends the commands from another thread.
    pub fn stopper(&self) -> CrewStopper {
        CrewStopper(self.sender.clone())
    }

    /// Waits until all commands have ended, at most `limit`; then they are asked to end, and killed if they do not.
    /// Calls `take` with each line of output and its station.
    pub fn wait(mut self, limit: Option<Duration>, mut take: impl FnMut(u16, &str)) -> CrewEnd {
        let began = Instant::now();
        let mut end = CrewEnd::default();
        let mut stopping: Option<Instant> = None;
        while !self.children.is_empty() {
            match self.events.recv_timeout(TICK) {
                Ok(Event::Line(station, line)) => {
                    take(station, &line);
                    continue;
                }
                Ok(Event::Stop) => {
                    end.interrupted = true;
                    match stopping {
                        None => stopping = Some(self.signal(Signal::SIGTERM)),
                        Some(_) => drop(self.signal(Signal::SIGKILL)),
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => unreachable!("a sender is kept"),
            }
            if stopping.is_none() && limit.is_some_and(|limit| began.elapsed() > limit) {
                stopping = Some(self.signal(Signal::SIGTERM));
            }
            if stopping.is_some_and(|since| since.elapsed() > STOP) {
                self.signal(Signal::SIGKILL);
            }
            self.children.retain_mut(|(station, child)| match child.try_wait() {
                Ok(None) => true,
                Ok(Some(status)) => {
                    if !status.success() && stopping.is_none() {
                        end.failed.push((*station, status.to_string()));
                    }
                    false
                }
                Err(error) => {
                    end.failed.push((*station, error.to_string()));
                    false
                }
            });
        }
        while let Ok(Event::Line(station, line)) = self.events.recv_timeout(TICK) {
            take(station, &line);
        }
        end
    }

    fn signal(&self, signal: Signal) -> Instant {
        for (_, child) in &self.children {
            if let Ok(pid) = i32::try_from(child.id()) {
                // One that has ended meanwhile is what is wanted.
                let _ = killpg(Pid::from_raw(pid), signal);
            }
        }
        Instant::now()
    }
}

/// Kills the commands that still run, for example after one could not be started.
impl Drop for Crew {
    fn drop(&mut self) {
        self.signal(Signal::SIGKILL);
        for (_, child) in &mut self.children {
            // It is waited for so that it does not stay as a zombie.
            let _ = child.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(station: u16, script: &str) -> (u16, Command) {
        let mut command = Command::new("sh");
        command.args(["-c", script]);
        (station, command)
    }

    #[test]
    fn output_and_failures_are_those_of_their_stations() {
        let crew = Crew::start(vec![shell(0, "echo one; echo two >&2"), shell(3, "echo three; exit 4")]).unwrap();
        let mut lines = Vec::new();
        let end = crew.wait(None, |station, line| lines.push(format!("{station} {line}")));
        lines.sort();
        assert_eq!(lines, ["0 one", "0 two", "3 three"]);
        assert_eq!(end, CrewEnd { failed: vec![(3, "exit status: 4".to_owned())], interrupted: false });
    }

    #[test]
    fn commands_end_at_the_limit_and_that_is_no_failure() {
        let limit = Some(Duration::from_millis(100));
        let end = Crew::start(vec![shell(0, "tail -f /dev/null")]).unwrap().wait(limit, |_, _| {});
        assert_eq!(end, CrewEnd::default());
    }

    #[test]
    fn a_second_request_to_stop_kills() {
        let crew = Crew::start(vec![shell(0, "trap 'echo asked' TERM; echo ready; tail -f /dev/null & wait; wait")]);
        let crew = crew.unwrap();
        let stopper = crew.stopper();
        let end = crew.wait(None, |_, line| {
            if matches!(line, "ready" | "asked") {
                stopper.stop();
            }
        });
        assert_eq!(end, CrewEnd { failed: Vec::new(), interrupted: true });
    }

    #[test]
    fn if_one_command_cannot_be_started_none_is_left() {
        let missing = (1, Command::new("/nowhere/at/all"));
        let error = Crew::start(vec![shell(0, "tail -f /dev/null"), missing]).err().unwrap();
        assert!(error.to_string().starts_with("the command of station 1: "), "{error}");
    }
}
