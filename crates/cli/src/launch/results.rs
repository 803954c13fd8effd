//! Results of the processes of a team under `launch`, from their events: episodes, counts, deaths and returns.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use crate::watch::team::News;
use murmurate::config::shown::counted;
use murmurate::report::episode::{AbortReason, Episode};
use murmurate::report::event::{Counted, HostEvent, Unwritten};
use murmurate::report::trial::TrialReport;
use murmurate::scenario::judge::Verdict;
use murmurate::time::Span;
use murmurate_launch::outcome::Outcome;
use murmurate_launch::supervisor::{Output, Response};
use murmurate_robot::output::{colour, log_lines_dropped, talk};

/// ANSI colour codes of the host names before log lines. Red is left out, because it looks like an error.
const COLOURS: [u8; 10] = [36, 32, 33, 35, 34, 96, 92, 93, 95, 94];

/// Results received from the processes so far.
pub struct Results {
    names: Vec<String>,
    width: usize,
    wanted: u32,
    quiet: bool,
    coloured: bool,
    /// Time at which all processes were ready.
    pub began: Instant,
    /// Processes that have been ready.
    ready: BTreeSet<usize>,
    /// Time at which each process died that is not back yet.
    down: BTreeMap<usize, Instant>,
    /// Results of episodes, by their index.
    pub episodes: BTreeMap<u32, Episode>,
    /// Reasons of aborted episodes, by their index, as the host of the state server knows them.
    aborted: BTreeMap<u32, AbortReason>,
    /// Counts (messages and the like) that the newest incarnation of each process has reported, by process.
    counted: Vec<Counted>,
    /// Last counts of processes that have been restarted since: one entry per earlier incarnation.
    past: Vec<Counted>,
    /// Sender of results and of what happens to processes to the live page; `None` without a page.
    pub page: Option<std::sync::mpsc::Sender<News>>,
}

impl Results {
    /// Returns results of which nothing was received yet: `names` are those of the processes, `wanted` the number of
    /// episodes.
    pub fn new(names: &[String], wanted: u32, quiet: bool) -> Results {
        Results {
            names: names.to_vec(),
            width: names.iter().map(|name| name.chars().count()).max().unwrap_or(0),
            wanted,
            quiet,
            coloured: colour(),
            began: Instant::now(),
            ready: BTreeSet::new(),
            down: BTreeMap::new(),
            episodes: BTreeMap::new(),
            aborted: BTreeMap::new(),
            counted: vec![Counted::default(); names.len()],
            past: Vec::new(),
            page: None,
        }
    }

    /// Takes an output of the process with the index `at` in.
    pub fn handle(&mut self, at: usize, output: &Output<'_>) -> Response {
        match *output {
            Output::Log(line) => self.pass_on(at, line),
            Output::Note(note) => talk(&format!("warning: the process '{}' {note}", self.names[at])),
            Output::Died(note) => self.died(at, note),
            Output::Data(line) => match HostEvent::from_line(line) {
                Some(HostEvent::Ready { .. }) => {
                    self.past.push(std::mem::take(&mut self.counted[at]));
                    self.ready(at);
                }
                Some(HostEvent::Aborted { episode, reason }) => self.aborted(episode, reason),
                Some(HostEvent::Episode(episode)) => self.episode(episode),
                // The log of the host says it.
                Some(HostEvent::Link { .. }) => {}
                Some(HostEvent::Counted(counted)) => self.counted[at] = counted,
                Some(HostEvent::Finished(counted)) => {
                    self.counted[at] = counted;
                    return Response::Done;
                }
                None => self.pass_on(at, line),
            },
        }
        Response::Continue
    }

    /// Notes why the state server has aborted the episode with this index. The judge may have reported it already.
    fn aborted(&mut self, index: u32, reason: AbortReason) {
        self.aborted.insert(index, reason);
        let known = self.episodes.get_mut(&index);
        if let Some(known) = known.filter(|known| known.verdict == Verdict::Aborted && known.reason.is_none()) {
            known.reason = Some(reason);
            let line = format!("episode {} of {}: {}", known.number(), self.wanted, known.in_words());
            self.info(&line);
        }
    }

    /// Says that a process has died; `note` says how, and whether it is started again.
    fn died(&mut self, at: usize, note: &str) {
        self.down.insert(at, Instant::now());
        let text = format!("the process '{}' {note}", self.names[at]);
        talk(&format!("warning: {text}"));
        self.tell_page(News::Died(at, text));
    }

    /// Counts a process as ready, and says so if it had died. The run's clock starts when all are ready.
    fn ready(&mut self, at: usize) {
        if let Some(died) = self.down.remove(&at) {
            let text = format!("the process '{}' is back, after {:.2} s", self.names[at], died.elapsed().as_secs_f64());
            talk(&text);
            self.tell_page(News::Back(at, text));
        }
        if self.ready.insert(at) && self.ready.len() == self.names.len() {
            self.began = Instant::now();
            let (run, processes) =
                (if self.ready.len() == 1 { "runs" } else { "run" }, counted(self.ready.len(), "process"));
            self.info(&format!("{processes} {run}; Ctrl-C stops them and prints the results so far"));
        }
    }

    /// Passes news on to the live page, if there is one.
    pub fn tell_page(&self, news: News) {
        if let Some(page) = &self.page {
            // Sending fails if the page has ended, which does not matter.
            let _ = page.send(news);
        }
    }

    /// Returns what the live page says of the end of the run.
    pub fn ending(&self, outcome: &Outcome) -> murmurate_view::status::Ending {
        let (got, all) = (self.episodes.len(), self.wanted);
        let successes = self.episodes.values().filter(|episode| !episode.verdict.is_failure()).count();
        let results = format!("{got} of {all} episodes have a result, {successes} without a failure");
        let (regular, text) = match outcome {
            Outcome::Done => (true, format!("The run is over: {results}.")),
            Outcome::Interrupted => (true, format!("The run was interrupted: {results}.")),
            Outcome::Incomplete(why) | Outcome::Refused(why) | Outcome::Failed(why) => {
                (false, format!("The run has failed: {why}; {results}."))
            }
        };
        murmurate_view::status::Ending { regular, text }
    }

    fn episode(&mut self, mut episode: Episode) {
        if episode.verdict == Verdict::Aborted {
            episode.reason = episode.reason.or(self.aborted.get(&episode.episode).copied());
        }
        // A restarted host may report an episode again; the first report counts.
        if self.episodes.contains_key(&episode.episode) {
            return;
        }
        self.episodes.insert(episode.episode, episode);
        self.tell_page(News::Episode(episode));
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

    fn incarnations(&self) -> impl Iterator<Item = &Counted> + Clone {
        self.past.iter().chain(&self.counted)
    }

    /// Returns the output that was dropped, of all processes and of this one.
    pub fn unwritten(&self) -> Unwritten {
        let own = Unwritten { log_lines: log_lines_dropped(), ..Unwritten::default() };
        self.incarnations().map(|counted| counted.unwritten).chain([own]).sum()
    }

    /// Returns the report of the run, which took `wall_s` \[s\].
    pub fn report(&self, wall_s: f64) -> TrialReport {
        let report = TrialReport {
            episodes: self.episodes.values().copied().collect(),
            simulated: Span::from_secs(wall_s),
            finished: self.episodes.len() == self.wanted as usize,
            ..TrialReport::default()
        };
        report.counted(self.incarnations())
    }
}
