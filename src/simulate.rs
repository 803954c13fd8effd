//! Driver of a trial in one process under virtual time: faster than real time, and equal bit for bit each time.

use std::cell::RefCell;
use std::rc::Rc;

use crate::actors::state_server;
use crate::graph;
use crate::graph::event::{Event, Report};
use crate::graph::process::Graph;
use crate::messages::ids::HostId;
use crate::report::TrialReport;
use crate::results::episode::Episode;
use crate::runtime::clock::Clock;
use crate::runtime::drive::{End, run_virtual};
use crate::scenario::judge::Verdict;
use crate::time::Time;
use crate::trial::Trial;

/// Decision of a caller, after each event of a trial, whether the trial continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Proceed {
    /// The trial continues with the next event.
    Continue,
    /// The trial continues. The time until its next event is not counted in its time limit, because a person has paused
    /// the team.
    Hold,
    /// The trial stops; the report holds the results up to that time.
    Stop,
}

impl Trial {
    /// Runs the trial to its end on the calling thread and returns the report.
    pub fn run(&self) -> TrialReport {
        self.run_while(|_| Proceed::Continue)
    }

    /// Runs the trial on the calling thread until its end, or until `proceed` returns [`Proceed::Stop`]. The function
    /// `proceed` is called after each event of the simulation with the results of the episodes so far.
    pub fn run_while(&self, mut proceed: impl FnMut(&[Episode]) -> Proceed) -> TrialReport {
        self.run_with(|_| None, |_, _, episodes| proceed(episodes))
    }

    /// Runs the trial on the calling thread until its end, or until `proceed` returns [`Proceed::Stop`], and reports
    /// its events. The function `report` is called with each event, its time, and the host where it happened.
    /// `proceed` is called after the events of each instant, with the actors, the time, and the results so far.
    pub fn run_observed(
        &self,
        report: impl Fn(Time, HostId, Event) + 'static,
        proceed: impl FnMut(&Graph, Time, &[Episode]) -> Proceed,
    ) -> TrialReport {
        let timed = |time: Clock| -> Report { Rc::new(move |host, event: Event| report(time.now(), host, event)) };
        self.run_with(|time| Some(timed(time)), proceed)
    }

    /// Runs the trial on the calling thread, with the function that gets its events, as `report` makes it for the run's
    /// clock.
    fn run_with(
        &self,
        report: impl FnOnce(Clock) -> Option<Report>,
        mut proceed: impl FnMut(&Graph, Time, &[Episode]) -> Proceed,
    ) -> TrialReport {
        let shared = Rc::new(RefCell::new(TrialReport::default()));
        let sink = {
            let shared = Rc::clone(&shared);
            move |output| shared.borrow_mut().note(output)
        };
        let (mut deadline, mut held_since) = (self.deadline(), None);
        let (graph, end) = run_virtual(
            |clock| graph::wire(clock, self, report(clock.clone()), sink),
            |graph, now| {
                let mut report = shared.borrow_mut();
                report.simulated = now.since(Time::ZERO);
                let closed = self.until.is_some_and(|until| now >= until);
                if let Some(since) = held_since.take() {
                    deadline += now.since(since);
                }
                let proceed = proceed(graph, now, &report.episodes);
                held_since = (proceed == Proceed::Hold).then_some(now);
                // Robots in the air land before the run is over.
                report.finished && !graph.is_airborne() || closed || now >= deadline || proceed == Proceed::Stop
            },
        );
        assert_eq!(end, End::Done, "a team with heartbeats never falls idle");
        let mut report = shared.borrow().clone();
        (report.refused, report.lost) = graph.undelivered();
        if !report.finished && Time::ZERO + report.simulated >= deadline {
            self.give_up(&mut report);
        }
        report
    }

    /// Returns the time at which a trial is given up, whatever has crashed: every episode may take the longest times
    /// that the state server allows.
    fn deadline(&self) -> Time {
        let each = state_server::MUSTER_LIMIT * 2 + state_server::RESET_LIMIT + self.scenario.rules().limit;
        Time::ZERO + (each + state_server::GRACE) * (u64::from(self.layouts.len()) + 1)
    }

    /// Adds an aborted result for every episode without a result.
    fn give_up(&self, report: &mut TrialReport) {
        let open = u32::try_from(report.episodes.len()).expect("episodes were counted in u32");
        report.episodes.extend((open..self.layouts.len()).map(|episode| Episode {
            repeat: self.repeat,
            episode,
            verdict: Verdict::Aborted,
            makespan_s: None,
            reset_s: 0.0,
            min_separation_m: f32::INFINITY,
            judged: self.deployment.judged(),
            cost: None,
            reason: None,
        }));
        report.finished = true;
    }
}
