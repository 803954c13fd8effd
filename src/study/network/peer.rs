//! One station of a measured case: says what the emulated one would say, at the same moments, and notes what it hears.
//! A core like any other; who gives it a clock and a network is not its business.

use serde::{Deserialize, Serialize};

use super::case::Case;
use super::emulate::{self, DRAIN, STEP, WARM};
use super::outcome::{Outcome, Tally};
use super::talk::{self, Schedule};
use crate::actors::Core;
use crate::messages::wire::{Latent, Wire};
use crate::time::{Span, Time};

/// A case that hosts are to measure together.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Task {
    /// Its number, by which messages of other cases are told apart.
    pub number: u32,
    /// What is measured.
    pub case: Case,
    /// How many stations there are.
    pub stations: u16,
    /// How many features a message has.
    pub features: usize,
    /// How long messages count \[s\].
    pub seconds: f64,
    /// The seed of the schedules.
    pub seed: u64,
}

/// What one station found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Notes {
    /// Messages that it said in the window.
    pub said: u64,
    /// Delays of those of others that came \[us\].
    pub delays_us: Vec<u64>,
    /// At its control steps, ages of the newest message of each other station \[us\]; `None` where there was none yet.
    pub ages_us: Vec<Option<u64>>,
}

impl Task {
    /// How long it takes from its beginning.
    pub fn lasts(&self) -> Span {
        WARM + Span::from_secs(self.seconds) + DRAIN
    }

    /// What all stations found, together.
    pub fn outcome(&self, notes: &[Notes]) -> Outcome {
        let begin = Time::ZERO + WARM;
        let mut tally = Tally::new(self.stations, (begin, begin + Span::from_secs(self.seconds)));
        let us = |us: u64| Span::from_nanos(1000 * us);
        for one in notes {
            tally.expects(one.said * u64::from(self.stations - 1));
            one.delays_us.iter().for_each(|delay| tally.delayed(us(*delay)));
            one.ages_us.iter().for_each(|age| tally.aged(age.map_or(emulate::NEVER, us)));
        }
        tally.outcome()
    }
}

/// One station.
#[derive(Debug)]
pub struct Peer {
    task: Task,
    station: u16,
    begin: Time,
    window: (Time, Time),
    over: Time,
    ended: bool,
    schedule: Schedule,
    step: Time,
    /// By station: when its newest message was said.
    newest: Vec<Option<Time>>,
    notes: Notes,
}

impl Peer {
    /// A station of a case that begins then, on its own clock.
    pub fn new(task: Task, station: u16, begin: Time) -> Peer {
        let seed = emulate::seed(task.seed, &task.case);
        let window = (begin + WARM, begin + WARM + Span::from_secs(task.seconds));
        Peer {
            station,
            begin,
            window,
            over: window.1 + DRAIN,
            ended: false,
            schedule: Schedule::new(begin, station, (task.stations, task.case.rate), &seed),
            step: window.0 + talk::phases(task.stations, STEP, &seed)[usize::from(station)],
            newest: vec![None; usize::from(task.stations)],
            notes: Notes::default(),
            task,
        }
    }

    /// Whether the case is over.
    pub fn is_over(&self, now: Time) -> bool {
        self.ended || now >= self.over
    }

    /// What it has found.
    pub fn notes(&self) -> &Notes {
        &self.notes
    }

    fn counts(&self, at: Time) -> bool {
        at >= self.window.0 && at < self.window.1
    }
}

impl Core for Peer {
    type In = Latent;
    type Out = Wire;

    fn handle(&mut self, now: Time, latent: Latent, _: &mut Vec<Wire>) {
        let Some(newest) = self.newest.get_mut(latent.robot.index()) else { return };
        if latent.round.epoch != self.task.number {
            return;
        }
        let said = self.begin + talk::stamp(&latent);
        *newest = (*newest).max(Some(said));
        if self.counts(said) {
            self.notes.delays_us.push(now.since(said).as_nanos() / 1000);
        }
    }

    fn wake_at(&self) -> Option<Time> {
        (!self.ended).then(|| self.schedule.next().min(self.step).min(self.over))
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Wire>) {
        if now >= self.over {
            self.ended = true;
            return;
        }
        if self.schedule.next() <= now {
            let sequence = self.schedule.say();
            let stamp = now.since(self.begin);
            self.notes.said += u64::from(self.counts(now));
            out.push(Wire::Latent(talk::message(self.station, self.task.number, sequence, stamp, self.task.features)));
        }
        if self.step <= now {
            let others = (0..self.newest.len()).filter(|from| *from != usize::from(self.station));
            let age = |from: usize| self.newest[from].map(|said| now.since(said).as_nanos() / 1000);
            self.notes.ages_us.extend(others.map(age));
            let next = self.step + STEP;
            self.step = if next < self.window.1 { next } else { Time::MAX };
        }
    }
}
