//! Progress of a run under `launch`: log lines on stderr, and events for the live page.

use murmurate::config::shown::counted;
use murmurate::results::episode::Episode;
use murmurate_launch::results::RunEvent;
use murmurate_robot::output::{colour, talk};

use crate::watch::team::TeamEvent;

/// ANSI colour codes of the host names before log lines. Red is left out, because it looks like an error.
const COLOURS: [u8; 10] = [36, 32, 33, 35, 34, 96, 92, 93, 95, 94];

/// Progress of a run, for the user: log lines on stderr, and events for the live page.
pub struct Progress {
    names: Vec<String>,
    width: usize,
    wanted: u32,
    quiet: bool,
    coloured: bool,
    /// Sender of events to the live page; `None` without a page.
    pub page: Option<std::sync::mpsc::Sender<TeamEvent>>,
}

impl Progress {
    /// Returns the progress of a run with the processes `names` and `wanted` episodes; with `quiet` only warnings.
    pub fn new(names: &[String], wanted: u32, quiet: bool) -> Progress {
        let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
        Progress { names: names.to_vec(), width, wanted, quiet, coloured: colour(), page: None }
    }

    /// Shows an event of the process with the index `at`.
    pub fn show(&self, at: usize, event: RunEvent) {
        match event {
            RunEvent::Line(line) => self.pass_on(at, &line),
            RunEvent::Note(text) => talk(&format!("warning: {text}")),
            RunEvent::Died(text) => {
                talk(&format!("warning: {text}"));
                self.send(TeamEvent::Died(at, text));
            }
            RunEvent::Back(text) => {
                talk(&text);
                self.send(TeamEvent::Back(at, text));
            }
            RunEvent::Heard(heard) => self.send(TeamEvent::Heard(at, heard)),
            RunEvent::AllRun => {
                let run = if self.names.len() == 1 { "runs" } else { "run" };
                let processes = counted(self.names.len(), "process");
                self.info(&format!("{processes} {run}; Ctrl-C stops them and prints the results so far"));
            }
            RunEvent::Episode(episode) => {
                self.send(TeamEvent::Episode(episode));
                self.episode(&episode);
            }
            RunEvent::Reason(episode) => self.episode(&episode),
        }
    }

    /// Sends an event to the live page, if there is one.
    pub fn send(&self, event: TeamEvent) {
        if let Some(page) = &self.page {
            // Sending fails if the page has ended, which does not matter.
            let _ = page.send(event);
        }
    }

    fn episode(&self, episode: &Episode) {
        self.info(&format!("episode {} of {}: {}", episode.number(), self.wanted, episode.in_words()));
    }

    fn info(&self, text: &str) {
        if !self.quiet {
            talk(text);
        }
    }

    fn pass_on(&self, at: usize, line: &str) {
        let name = format!("{:1$}", self.names[at], self.width);
        let name = if self.coloured { format!("\x1b[{}m{name}\x1b[0m", COLOURS[at % COLOURS.len()]) } else { name };
        self.info(&format!("{name} | {line}"));
    }
}
