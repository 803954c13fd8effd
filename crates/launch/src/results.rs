//! Results of a team's run, from the output of its processes: episodes, counts, and events for the user.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

use crate::outcome::Outcome;
use crate::supervisor::{Output, Response};
use murmurate::report::TrialReport;
use murmurate::results::episode::{AbortReason, Episode};
use murmurate::scenario::judge::Verdict;
use murmurate::time::Span;
use murmurate_report::event::{self, Counted, HostEvent, Unwritten};
use murmurate_report::heard::Heard;

/// Event of a run that the caller shows to the user.
#[derive(Clone, Debug, PartialEq)]
pub enum RunEvent {
    /// A line of a process's log, or one on stdout that is no event.
    Line(String),
    /// The supervisor has stopped or killed the process; the text names it and says why.
    Note(String),
    /// The process has died; the text names it and says how, and whether it is started again.
    Died(String),
    /// The process is back after its death; the text names it and says after how long.
    Back(String),
    /// All processes run, for the first time.
    AllRun,
    /// An episode has its result.
    Episode(Episode),
    /// Report of the process's host on the hosts that it hears, and on its way of sending.
    Heard(Heard),
    /// The reason is known now for which an episode was aborted whose result was there already.
    Reason(Episode),
}

/// Results received from the processes so far.
pub struct Results {
    names: Vec<String>,
    wanted: u32,
    /// Time at which all processes were ready.
    began: Instant,
    /// Processes that have been ready.
    ready: BTreeSet<usize>,
    /// Time at which each process died that is not back yet.
    down: BTreeMap<usize, Instant>,
    /// Results of episodes, by their index.
    episodes: BTreeMap<u32, Episode>,
    /// Reasons of aborted episodes, by their index, as the host of the state server knows them.
    aborted: BTreeMap<u32, AbortReason>,
    /// Counts (messages and the like) that the newest incarnation of each process has reported, by process.
    counted: Vec<Counted>,
    /// Last counts of processes that have been restarted since: one entry per earlier incarnation.
    past: Vec<Counted>,
}

impl Results {
    /// Returns results of which nothing was received yet: `names` are those of the processes, `wanted` the number of
    /// episodes.
    pub fn new(names: &[String], wanted: u32) -> Results {
        Results {
            names: names.to_vec(),
            wanted,
            began: Instant::now(),
            ready: BTreeSet::new(),
            down: BTreeMap::new(),
            episodes: BTreeMap::new(),
            aborted: BTreeMap::new(),
            counted: vec![Counted::default(); names.len()],
            past: Vec::new(),
        }
    }

    /// Handles an output of the process with the index `at`. Returns the response to the supervisor, and calls
    /// `observe` with each event of the run that follows from the output.
    pub fn take(&mut self, at: usize, output: &Output<'_>, mut observe: impl FnMut(RunEvent)) -> Response {
        match *output {
            Output::Log(line) => observe(RunEvent::Line(line.to_owned())),
            Output::Note(note) => observe(RunEvent::Note(self.about(at, note))),
            Output::Died(note) => {
                self.down.insert(at, Instant::now());
                observe(RunEvent::Died(self.about(at, note)));
            }
            Output::Data(line) => match HostEvent::from_line(line) {
                Some(HostEvent::Ready { .. }) => {
                    self.past.push(std::mem::take(&mut self.counted[at]));
                    self.ready(at, observe);
                }
                Some(HostEvent::Aborted { episode, reason }) => {
                    self.aborted(episode, reason).map(RunEvent::Reason).into_iter().for_each(observe);
                }
                Some(HostEvent::Episode(episode)) => {
                    self.episode(episode).map(RunEvent::Episode).into_iter().for_each(observe);
                }
                Some(HostEvent::Heard(heard)) => observe(RunEvent::Heard(heard)),
                // The host's log has a line about it.
                Some(HostEvent::Link { .. }) => {}
                Some(HostEvent::Counted(counted)) => self.counted[at] = counted,
                Some(HostEvent::Finished(counted)) => {
                    self.counted[at] = counted;
                    return Response::Done;
                }
                None => observe(RunEvent::Line(line.to_owned())),
            },
        }
        Response::Continue
    }

    fn about(&self, at: usize, note: &str) -> String {
        format!("the process '{}' {note}", self.names[at])
    }

    /// Notes why the state server has aborted the episode with this index. Returns the episode if the judge has
    /// reported it already, without a reason.
    fn aborted(&mut self, index: u32, reason: AbortReason) -> Option<Episode> {
        self.aborted.insert(index, reason);
        let known = self.episodes.get_mut(&index);
        let known = known.filter(|known| known.verdict == Verdict::Aborted && known.reason.is_none())?;
        known.reason = Some(reason);
        Some(*known)
    }

    /// Counts a process as ready, with an event if it had died. The run's clock starts when all are ready.
    fn ready(&mut self, at: usize, mut observe: impl FnMut(RunEvent)) {
        if let Some(died) = self.down.remove(&at) {
            observe(RunEvent::Back(self.about(at, &format!("is back, after {:.2} s", died.elapsed().as_secs_f64()))));
        }
        if self.ready.insert(at) && self.ready.len() == self.names.len() {
            self.began = Instant::now();
            observe(RunEvent::AllRun);
        }
    }

    /// Takes the result of an episode. Returns it, with the reason if it was aborted; `None` if it is there already.
    fn episode(&mut self, mut episode: Episode) -> Option<Episode> {
        if episode.verdict == Verdict::Aborted {
            episode.reason = episode.reason.or(self.aborted.get(&episode.episode).copied());
        }
        // A restarted host may report an episode again; the first report counts.
        if self.episodes.contains_key(&episode.episode) {
            return None;
        }
        self.episodes.insert(episode.episode, episode);
        Some(episode)
    }

    /// Returns the number of episodes that have a result.
    pub fn received(&self) -> usize {
        self.episodes.len()
    }

    /// Returns whether every episode has a result.
    pub fn are_all(&self) -> bool {
        self.episodes.len() == self.wanted as usize
    }

    /// Returns the time since all processes were ready \[s\], or since the beginning if they are not.
    pub fn wall_s(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    /// Returns whether the run has ended regularly, and a sentence about its end for the user.
    pub fn ending(&self, outcome: &Outcome) -> (bool, String) {
        let (got, all) = (self.episodes.len(), self.wanted);
        let successes = self.episodes.values().filter(|episode| !episode.verdict.is_failure()).count();
        let results = format!("{got} of {all} episodes have a result, {successes} without a failure");
        match outcome {
            Outcome::Done => (true, format!("The run is over: {results}.")),
            Outcome::Interrupted => (true, format!("The run was interrupted: {results}.")),
            Outcome::Incomplete(why) | Outcome::Refused(why) | Outcome::Failed(why) => {
                (false, format!("The run has failed: {why}; {results}."))
            }
        }
    }

    fn incarnations(&self) -> impl Iterator<Item = &Counted> + Clone {
        self.past.iter().chain(&self.counted)
    }

    /// Returns the output that all processes together have dropped.
    pub fn unwritten(&self) -> Unwritten {
        self.incarnations().map(|counted| counted.unwritten).sum()
    }

    /// Returns the report of the run, which took `wall_s` \[s\].
    pub fn report(&self, wall_s: f64) -> TrialReport {
        let report = TrialReport {
            episodes: self.episodes.values().copied().collect(),
            simulated: Span::from_secs(wall_s),
            finished: self.are_all(),
            ..TrialReport::default()
        };
        event::counted(report, self.incarnations())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::results::episode::{AbortCause, Judged};

    fn episode(index: u32, verdict: Verdict) -> Episode {
        Episode {
            repeat: 0,
            episode: index,
            verdict,
            makespan_s: None,
            reset_s: 0.0,
            min_separation_m: 1.0,
            judged: Judged::Readings,
            cost: None,
            reason: None,
        }
    }

    fn results() -> Results {
        Results::new(&["a".to_owned(), "b".to_owned()], 2)
    }

    /// Handles an event of a process. Returns the response, and the events of the run.
    fn event(results: &mut Results, at: usize, event: &HostEvent) -> (Response, Vec<RunEvent>) {
        let mut events = Vec::new();
        let response = results.take(at, &Output::Data(&event.to_line()), |event| events.push(event));
        (response, events)
    }

    fn ready(host: &str) -> HostEvent {
        HostEvent::Ready { host: host.to_owned() }
    }

    #[test]
    fn an_episode_counts_once_and_the_last_one_completes_the_results() {
        let mut results = results();
        let first = episode(0, Verdict::Success);
        assert_eq!(event(&mut results, 0, &HostEvent::Episode(first)).1, [RunEvent::Episode(first)]);
        let again = HostEvent::Episode(episode(0, Verdict::Timeout));
        assert_eq!(event(&mut results, 1, &again).1, [], "a restarted host reports it again");
        assert!(!results.are_all() && results.received() == 1);
        event(&mut results, 0, &HostEvent::Episode(episode(1, Verdict::Timeout)));
        assert!(results.are_all());
        assert_eq!(results.report(3.0).episodes, [first, episode(1, Verdict::Timeout)]);
        let (regular, text) = results.ending(&Outcome::Done);
        assert!(regular && text == "The run is over: 2 of 2 episodes have a result, 1 without a failure.", "{text}");
        assert!(!results.ending(&Outcome::Failed("why".to_owned())).0);
    }

    #[test]
    fn the_reason_of_an_aborted_episode_may_come_before_or_after_its_result() {
        let reason = AbortReason { cause: AbortCause::Stopped, robot: None, others: 0 };
        let known = |index| Episode { reason: Some(reason), ..episode(index, Verdict::Aborted) };
        let said = |index| HostEvent::Aborted { episode: index, reason };
        let result = |index| HostEvent::Episode(episode(index, Verdict::Aborted));
        let mut results = results();
        assert_eq!(event(&mut results, 0, &said(0)).1, []);
        assert_eq!(event(&mut results, 1, &result(0)).1, [RunEvent::Episode(known(0))]);
        assert_eq!(event(&mut results, 1, &result(1)).1, [RunEvent::Episode(episode(1, Verdict::Aborted))]);
        assert_eq!(event(&mut results, 0, &said(1)).1, [RunEvent::Reason(known(1))]);
        assert_eq!(event(&mut results, 0, &said(1)).1, [], "it is known");
    }

    #[test]
    fn counts_of_all_incarnations_are_added_and_a_return_after_a_death_is_an_event() {
        let mut results = results();
        let counted = |messages| Counted { messages, ..Counted::default() };
        assert_eq!(event(&mut results, 0, &ready("a")).1, []);
        assert_eq!(event(&mut results, 1, &ready("b")).1, [RunEvent::AllRun]);
        event(&mut results, 1, &HostEvent::Counted(counted(3)));
        let mut events = Vec::new();
        results.take(1, &Output::Died("has failed"), |event| events.push(event));
        assert_eq!(events, [RunEvent::Died("the process 'b' has failed".to_owned())]);
        let (_, events) = event(&mut results, 1, &ready("b"));
        assert!(matches!(&events[..], [RunEvent::Back(text)] if text.starts_with("the process 'b' is back, after ")));
        let (response, events) = event(&mut results, 1, &HostEvent::Finished(counted(4)));
        assert_eq!((response, events), (Response::Done, Vec::new()));
        event(&mut results, 0, &HostEvent::Counted(counted(10)));
        assert_eq!(results.report(1.0).totals.messages, 17);
    }

    #[test]
    fn lines_that_are_no_events_are_passed_on() {
        let mut events = Vec::new();
        let mut results = results();
        for output in [Output::Log("log"), Output::Data("text"), Output::Note("has not stopped")] {
            assert_eq!(results.take(0, &output, |event| events.push(event)), Response::Continue);
        }
        let note = RunEvent::Note("the process 'a' has not stopped".to_owned());
        assert_eq!(events, [RunEvent::Line("log".to_owned()), RunEvent::Line("text".to_owned()), note]);
    }
}
