//! What people see of a run under `launch`: lines on stderr, and the news of the live page.

use murmurate::config::shown::counted;
use murmurate::results::episode::Episode;
use murmurate_launch::results;
use murmurate_robot::output::{colour, talk};

use crate::watch::team::News;

/// ANSI colour codes of the host names before log lines. Red is left out, because it looks like an error.
const COLOURS: [u8; 10] = [36, 32, 33, 35, 34, 96, 92, 93, 95, 94];

/// Output of a run while it goes on.
pub struct Told {
    names: Vec<String>,
    width: usize,
    wanted: u32,
    quiet: bool,
    coloured: bool,
    /// Sender of results and of what happens to processes to the live page; `None` without a page.
    pub page: Option<std::sync::mpsc::Sender<News>>,
}

impl Told {
    /// Returns the output of a run with the processes `names` and `wanted` episodes; with `quiet` only warnings.
    pub fn new(names: &[String], wanted: u32, quiet: bool) -> Told {
        let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
        Told { names: names.to_vec(), width, wanted, quiet, coloured: colour(), page: None }
    }

    /// Prints news of the process with the index `at`, and passes them on to the live page.
    pub fn tell(&self, at: usize, news: results::News) {
        match news {
            results::News::Line(line) => self.pass_on(at, &line),
            results::News::Note(text) => talk(&format!("warning: {text}")),
            results::News::Died(text) => {
                talk(&format!("warning: {text}"));
                self.tell_page(News::Died(at, text));
            }
            results::News::Back(text) => {
                talk(&text);
                self.tell_page(News::Back(at, text));
            }
            results::News::AllRun => {
                let run = if self.names.len() == 1 { "runs" } else { "run" };
                let processes = counted(self.names.len(), "process");
                self.info(&format!("{processes} {run}; Ctrl-C stops them and prints the results so far"));
            }
            results::News::Episode(episode) => {
                self.tell_page(News::Episode(episode));
                self.episode(&episode);
            }
            results::News::Reason(episode) => self.episode(&episode),
        }
    }

    /// Passes news on to the live page, if there is one.
    pub fn tell_page(&self, news: News) {
        if let Some(page) = &self.page {
            // Sending fails if the page has ended, which does not matter.
            let _ = page.send(news);
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
