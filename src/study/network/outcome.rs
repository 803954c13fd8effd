//! What came of one case: delays, what was delivered in time, how old the newest message was at each control step.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::case::{Addressing, Assurance, Case, Network, Source};
use super::endpoint::NEVER;
use crate::report::ages::Ages;
use crate::report::statistics::quantile;
use crate::time::{Span, Time};

/// For how long a control step may use a message: the policies' hold window.
pub const USABLE: Span = Span::from_millis(200);
/// The marks of the paper's network study.
pub const MARKS: [Span; 2] = [Span::from_millis(20), Span::from_millis(50)];

/// What came of a case.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outcome {
    /// How long messages were counted \[s\].
    pub seconds: f64,
    /// Copies that there would be if nothing was lost: every message of the window at every other station.
    pub due: u64,
    /// Those that there were.
    pub arrived: u64,
    /// Those that came within 20 and within 50 ms.
    pub within: [u64; 2],
    /// Quantiles of the delays of those that came: 10, 50, 90 and 99 % \[s\].
    pub quantiles_s: Option<[f64; 4]>,
    /// Their delays.
    pub delays: Ages,
    /// How old the newest message of each other station was, at each control step.
    pub ages: Ages,
    /// Quantiles of the same: 50 and 90 % \[s\].
    pub age_quantiles_s: Option<[f64; 2]>,
    /// The share of control steps and other stations in which that was `USABLE`.
    pub usable: f64,
    /// Datagrams of all stations a second; unknown where it was measured between hosts.
    pub datagrams_per_s: Option<f64>,
    /// Their bytes a second, likewise.
    pub bytes_per_s: Option<f64>,
    /// The share of time in which the medium was taken by them; unknown where it was measured between hosts.
    pub airtime: Option<f64>,
}

/// Counts while a case runs.
#[derive(Clone, Debug)]
pub struct Tally {
    window: (Time, Time),
    stations: usize,
    due: u64,
    within: [u64; 2],
    delays_s: Vec<f64>,
    delays: Ages,
    ages: Ages,
    ages_s: Vec<f64>,
    usable: u64,
    sent: (u64, u64),
    taken_s: [Option<f64>; 2],
    /// By station: when its newest messages were said, and the number of the first of them.
    said: Vec<(u32, VecDeque<Time>)>,
    /// By receiver and sender: when the newest message that has come was said.
    newest: Vec<Option<Time>>,
}

/// Messages of one station whose times are remembered.
const REMEMBERED: usize = 100_000;

impl Tally {
    /// Nothing yet; what is said in the window counts.
    pub fn new(stations: u16, window: (Time, Time)) -> Tally {
        let stations = usize::from(stations);
        Tally {
            window,
            stations,
            due: 0,
            within: [0; 2],
            delays_s: Vec::new(),
            delays: Ages::default(),
            ages: Ages::default(),
            ages_s: Vec::new(),
            usable: 0,
            sent: (0, 0),
            taken_s: [None; 2],
            said: vec![(0, VecDeque::new()); stations],
            newest: vec![None; stations * stations],
        }
    }

    /// When messages count.
    pub fn window(&self) -> (Time, Time) {
        self.window
    }

    fn counts(&self, at: Time) -> bool {
        at >= self.window.0 && at < self.window.1
    }

    /// A station says a message.
    pub fn published(&mut self, now: Time, station: u16, sequence: u32) {
        let (first, times) = &mut self.said[usize::from(station)];
        assert_eq!(sequence as usize, *first as usize + times.len(), "numbers follow each other");
        times.push_back(now);
        if times.len() > REMEMBERED {
            times.pop_front();
            *first += 1;
        }
        if self.counts(now) {
            self.due += self.stations as u64 - 1;
        }
    }

    /// A station has a message that it had not before.
    pub fn heard(&mut self, now: Time, station: u16, from: u16, sequence: u32) {
        let (first, times) = &self.said[usize::from(from)];
        let place = sequence.checked_sub(*first).and_then(|place| times.get(place as usize));
        let Some(&said) = place else { return };
        let newest = &mut self.newest[usize::from(station) * self.stations + usize::from(from)];
        *newest = (*newest).max(Some(said));
        if self.counts(said) {
            self.delayed(now.since(said));
        }
    }

    /// A message of the window came after so long.
    pub fn delayed(&mut self, delay: Span) {
        self.delays.add(delay);
        for (within, mark) in self.within.iter_mut().zip(MARKS) {
            *within += u64::from(delay <= mark);
        }
        self.delays_s.push(delay.as_secs());
    }

    /// A station looks at the newest message of each other one.
    pub fn step(&mut self, now: Time, station: u16) {
        for from in (0..self.stations).filter(|from| *from != usize::from(station)) {
            // Of whom nothing was ever heard, everything is too old.
            let age = self.newest[usize::from(station) * self.stations + from].map_or(NEVER, |at| now.since(at));
            self.aged(age);
        }
    }

    /// At a control step the newest message of another station was so old.
    pub fn aged(&mut self, age: Span) {
        self.ages.add(age);
        self.ages_s.push(age.as_secs());
        self.usable += u64::from(age <= USABLE);
    }

    /// A station has handed its medium a datagram.
    pub fn sent(&mut self, now: Time, datagrams: u64, bytes: usize) {
        if self.counts(now) {
            self.sent.0 += datagrams;
            self.sent.1 += bytes as u64;
        }
    }

    /// Asks how long the medium was taken, at the beginning and at the end of the window.
    pub fn sees_airtime(&mut self, now: Time, taken_s: impl Fn() -> f64) {
        for (seen, edge) in self.taken_s.iter_mut().zip([self.window.0, self.window.1]) {
            if seen.is_none() && now >= edge {
                *seen = Some(taken_s());
            }
        }
    }

    /// So many copies are due: where nobody sees all stations.
    pub fn expects(&mut self, due: u64) {
        self.due += due;
    }

    /// What came of it.
    pub fn outcome(self) -> Outcome {
        let window_s = self.window.1.since(self.window.0).as_secs();
        let (arrived, seen) = (self.delays_s.len() as u64, self.sent.0 > 0);
        let delay = |q: f64| quantile(&self.delays_s, q);
        // Where that many were never heard there is no such age.
        let age = |q: f64| quantile(&self.ages_s, q).filter(|age| *age < NEVER.as_secs());
        let steps = self.ages_s.len().max(1) as f64;
        let all = |qs: [f64; 4]| Some([delay(qs[0])?, delay(qs[1])?, delay(qs[2])?, delay(qs[3])?]);
        Outcome {
            seconds: window_s,
            due: self.due,
            arrived,
            within: self.within,
            quantiles_s: all([0.1, 0.5, 0.9, 0.99]),
            delays: self.delays,
            ages: self.ages,
            age_quantiles_s: age(0.5).zip(age(0.9)).map(|(half, most)| [half, most]),
            usable: self.usable as f64 / steps,
            datagrams_per_s: seen.then_some(self.sent.0 as f64 / window_s),
            bytes_per_s: seen.then_some(self.sent.1 as f64 / window_s),
            airtime: self.taken_s[0].zip(self.taken_s[1]).map(|(from, to)| (to - from) / window_s),
        }
    }
}

/// One line of the results, as `--json` prints it. Fields are only ever added.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// How it was found.
    pub source: Source,
    /// See `Case`.
    pub addressing: Addressing,
    /// See `Case`.
    pub reliability: Assurance,
    /// See `Case`.
    pub retries: u32,
    /// See `Case`.
    pub network: Network,
    /// Messages of all stations together \[1/s\].
    pub rate: f64,
    /// How long they were counted \[s\].
    pub seconds: f64,
    /// The share of messages that came, over all readers.
    pub delivered: f64,
    /// The share that came within 20 ms, of all that were due.
    pub within_20ms: f64,
    /// The share that came within 50 ms, of all that were due.
    pub within_50ms: f64,
    /// Quantiles of the delay of those that came \[ms\]; none if none came.
    pub p10_ms: Option<f64>,
    /// See `p10_ms`.
    pub p50_ms: Option<f64>,
    /// See `p10_ms`.
    pub p90_ms: Option<f64>,
    /// See `p10_ms`.
    pub p99_ms: Option<f64>,
    /// The share of time in which the medium was taken; none where it was not measured.
    pub airtime: Option<f64>,
    /// Age of the newest message of another station at a control step, median and 90 % \[ms\].
    pub age_p50_ms: Option<f64>,
    /// See `age_p50_ms`.
    pub age_p90_ms: Option<f64>,
    /// The share of control steps at which it was no older than 200 ms.
    pub usable: f64,
    /// Datagrams a message, all that protocols add included; none where it was not counted.
    pub datagrams_per_message: Option<f64>,
}

impl Row {
    /// The case that it is of.
    pub fn case(&self) -> Case {
        let Row { network, addressing, reliability, retries, rate, .. } = *self;
        Case { network, addressing, reliability, retries, rate }
    }

    /// What all rates of its combination have in common, in a few words.
    pub fn combination(&self) -> String {
        let name = self.case().combination();
        if self.source == Source::Emulated { name } else { format!("{name}, {}", self.source) }
    }

    /// The line of a case.
    pub fn of(source: Source, case: &Case, outcome: &Outcome) -> Row {
        let due = outcome.due.max(1) as f64;
        let delay = |at: usize| outcome.quantiles_s.map(|all| 1000.0 * all[at]);
        let age = |at: usize| outcome.age_quantiles_s.map(|all| 1000.0 * all[at]);
        Row {
            source,
            addressing: case.addressing,
            reliability: case.reliability,
            retries: case.retries,
            network: case.network,
            rate: case.rate,
            seconds: outcome.seconds,
            delivered: outcome.arrived as f64 / due,
            within_20ms: outcome.within[0] as f64 / due,
            within_50ms: outcome.within[1] as f64 / due,
            p10_ms: delay(0),
            p50_ms: delay(1),
            p90_ms: delay(2),
            p99_ms: delay(3),
            airtime: outcome.airtime,
            age_p50_ms: age(0),
            age_p90_ms: age(1),
            usable: outcome.usable,
            datagrams_per_message: outcome.datagrams_per_s.map(|datagrams| datagrams / case.rate),
        }
    }
}
