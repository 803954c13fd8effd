//! Outcome of one case of a network study: delays, shares delivered in time, and the age of the newest message at
//! each control step.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use super::case::{Addressing, Case, NetworkKind, ReliabilityMode, Source};
use super::endpoint::NEVER;
use murmurate::results::ages::Ages;
use murmurate::time::{Span, Time};
use murmurate_report::statistics::quantile;

/// Largest age of a message that a control step uses: 200 ms, the hold time of the policies.
pub const USABLE: Span = Span::from_millis(200);
/// Delays of 20 and 50 ms. The paper's network study reports the share of messages that arrive within each.
pub const MARKS: [Span; 2] = [Span::from_millis(20), Span::from_millis(50)];

/// Outcome of a case of a network study, emulated or measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outcome {
    /// Duration of the measurement \[s\], without warm-up and drain.
    pub seconds: f64,
    /// Number of expected deliveries: each message published within the measurement, at every other station.
    pub due: u64,
    /// Number of the expected deliveries that arrived.
    pub arrived: u64,
    /// Number of deliveries with a delay of at most 20 ms, and of at most 50 ms.
    pub within: [u64; 2],
    /// Quantiles of the delay of deliveries \[s\]: 10, 50, 90 and 99 %; `None` without deliveries.
    pub quantiles_s: Option<[f64; 4]>,
    /// Histogram of the delays of deliveries.
    pub delays: Ages,
    /// Histogram, over stations and their control steps, of the age of the newest message that has arrived from each
    /// other station, since its publication.
    pub ages: Ages,
    /// Quantiles (50 and 90 %), over control steps and other stations, of the age of the newest message \[s\]; `None`
    /// if for more than a tenth of them none had arrived yet.
    pub age_quantiles_s: Option<[f64; 2]>,
    /// Share (0 to 1) of the ages of other stations' newest messages at control steps that are at most 200 ms.
    pub usable: f64,
    /// Datagrams sent by all stations \[1/s\]; `None` in a measurement between hosts.
    pub datagrams_per_s: Option<f64>,
    /// Bytes sent by all stations \[1/s\]; `None` in a measurement between hosts.
    pub bytes_per_s: Option<f64>,
    /// Share of time in which the medium was busy with frames of the stations; `None` in a measurement between hosts.
    pub airtime: Option<f64>,
}

/// Counters of a running case of a network study, from which its outcome is computed. Its measurement window is the
/// time of the case without warm-up and drain.
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
    busy_s: [Option<f64>; 2],
    /// For each station: publication times of its newest messages, and the sequence number of the first of them.
    published_at: Vec<(u32, VecDeque<Time>)>,
    /// For each receiver and sender: publication time of the newest received message.
    newest: Vec<Option<Time>>,
    /// By receiver and sender: whether the one is too far away to hear the other.
    apart: Vec<bool>,
}

/// Largest number of publication times that the counters of a case keep for a station.
const REMEMBERED: usize = 100_000;

impl Tally {
    /// Returns empty counters for this number of stations. `window` has the start and end of the measurement; messages
    /// that are published outside of it are not counted.
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
            busy_s: [None; 2],
            published_at: vec![(0, VecDeque::new()); stations],
            newest: vec![None; stations * stations],
            apart: vec![false; stations * stations],
        }
    }

    /// Counts nothing from now on between stations that do not hear each other: `hears` tells whether a station, the
    /// first one, hears another.
    pub fn count_only(&mut self, hears: impl Fn(u16, u16) -> bool) {
        for (at, apart) in self.apart.iter_mut().enumerate() {
            *apart = !hears((at / self.stations) as u16, (at % self.stations) as u16);
        }
    }

    /// Returns whether a station is too far from another one to hear it.
    fn is_apart(&self, station: usize, from: usize) -> bool {
        self.apart[station * self.stations + from]
    }

    /// Returns start and end of the measurement, outside of which published messages are not counted.
    pub fn window(&self) -> (Time, Time) {
        self.window
    }

    fn counts(&self, at: Time) -> bool {
        at >= self.window.0 && at < self.window.1
    }

    /// Counts the message `sequence` that the station with index `station` publishes at `now`. Panics unless the
    /// station's sequence numbers are consecutive, from 0.
    pub fn published(&mut self, now: Time, station: u16, sequence: u32) {
        let (first, times) = &mut self.published_at[usize::from(station)];
        assert_eq!(sequence as usize, *first as usize + times.len(), "numbers follow each other");
        times.push_back(now);
        if times.len() > REMEMBERED {
            times.pop_front();
            *first += 1;
        }
        if self.counts(now) {
            let from = usize::from(station);
            self.due += (0..self.stations).filter(|to| *to != from && !self.is_apart(*to, from)).count() as u64;
        }
    }

    /// Counts the delivery, at the station with index `station`, of the message `sequence` from the station `from`. The
    /// caller leaves out duplicates.
    pub fn received(&mut self, now: Time, station: u16, from: u16, sequence: u32) {
        let (first, times) = &self.published_at[usize::from(from)];
        let place = sequence.checked_sub(*first).and_then(|place| times.get(place as usize));
        let Some(&published) = place.filter(|_| !self.is_apart(usize::from(station), usize::from(from))) else {
            return;
        };
        let newest = &mut self.newest[usize::from(station) * self.stations + usize::from(from)];
        *newest = (*newest).max(Some(published));
        if self.counts(published) {
            self.add_delay(now.since(published));
        }
    }

    /// Counts the delay of a delivered message that was published within the measurement.
    pub fn add_delay(&mut self, delay: Span) {
        self.delays.add(delay);
        for (within, mark) in self.within.iter_mut().zip(MARKS) {
            *within += u64::from(delay <= mark);
        }
        self.delays_s.push(delay.as_secs());
    }

    /// Counts a control step of `station` at `now`: the age of the newest message that it has from each other station.
    pub fn step(&mut self, now: Time, station: u16) {
        let at = usize::from(station);
        let heard: Vec<usize> = (0..self.stations).filter(|from| *from != at && !self.is_apart(at, *from)).collect();
        for from in heard {
            // If there is no message of a station, its age exceeds every limit.
            let age = self.newest[usize::from(station) * self.stations + from].map_or(NEVER, |at| now.since(at));
            self.add_age(age);
        }
    }

    /// Counts `age`, the age of another station's newest message at a control step; `NEVER` if none has arrived.
    pub fn add_age(&mut self, age: Span) {
        self.ages.add(age);
        self.ages_s.push(age.as_secs());
        self.usable += u64::from(age <= USABLE);
    }

    /// Counts datagrams that a station sends at `now`, with the sum of their `bytes`, if `now` is within the
    /// measurement.
    pub fn sent(&mut self, now: Time, datagrams: u64, bytes: usize) {
        if self.counts(now) {
            self.sent.0 += datagrams;
            self.sent.1 += bytes as u64;
        }
    }

    /// Stores the medium's busy time \[s\] at the start and at the end of the measurement, as soon as `now` has passed
    /// each. `busy_s` returns the busy time so far.
    pub fn sample_airtime(&mut self, now: Time, busy_s: impl Fn() -> f64) {
        for (seen, edge) in self.busy_s.iter_mut().zip([self.window.0, self.window.1]) {
            if seen.is_none() && now >= edge {
                *seen = Some(busy_s());
            }
        }
    }

    /// Adds `due` to the number of expected deliveries. It is for measurements between hosts, in which each station
    /// counts its own messages.
    pub fn add_due(&mut self, due: u64) {
        self.due += due;
    }

    /// Returns the outcome of the case from the counts so far.
    pub fn outcome(self) -> Outcome {
        let window_s = self.window.1.since(self.window.0).as_secs();
        let (arrived, seen) = (self.delays_s.len() as u64, self.sent.0 > 0);
        let delay = |q: f64| quantile(&self.delays_s, q);
        // The quantile does not exist if too many pairs of stations never had a message.
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
            airtime: self.busy_s[0].zip(self.busy_s[1]).map(|(from, to)| (to - from) / window_s),
        }
    }
}

/// Row of the results of a network study: one case, as `--json` prints it. Later versions may add fields and remove
/// none.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Whether the case was emulated or measured.
    pub source: Source,
    /// Addressing of messages.
    pub addressing: Addressing,
    /// Reliability mode of messages.
    pub reliability: ReliabilityMode,
    /// Retry limit (802.11) of unicast frames.
    pub retries: u32,
    /// Kind of network between the stations.
    pub network: NetworkKind,
    /// Message rate of all stations together \[1/s\].
    pub rate: f64,
    /// Duration of the measurement \[s\], without warm-up and drain.
    pub seconds: f64,
    /// Share of expected deliveries that arrived, 0 to 1.
    pub delivered: f64,
    /// Share of expected deliveries that arrived within 20 ms, 0 to 1.
    pub within_20ms: f64,
    /// Share of expected deliveries that arrived within 50 ms, 0 to 1.
    pub within_50ms: f64,
    /// 10 % quantile of the delay of deliveries \[ms\]; null without deliveries.
    pub p10_ms: Option<f64>,
    /// Median delay of deliveries \[ms\]; null without deliveries.
    pub p50_ms: Option<f64>,
    /// 90 % quantile of the delay of deliveries \[ms\]; null without deliveries.
    pub p90_ms: Option<f64>,
    /// 99 % quantile of the delay of deliveries \[ms\]; null without deliveries.
    pub p99_ms: Option<f64>,
    /// Share of time in which the medium was busy with the stations' frames; null in a measurement between hosts.
    pub airtime: Option<f64>,
    /// Median, over control steps and other stations, of the age of the newest message \[ms\]; null if for more than a
    /// tenth of them none had arrived yet.
    pub age_p50_ms: Option<f64>,
    /// 90 % quantile, over control steps and other stations, of the age of the newest message \[ms\]; null if for more
    /// than a tenth of them none had arrived yet.
    pub age_p90_ms: Option<f64>,
    /// Share of the ages of other stations' newest messages at control steps that are at most 200 ms, 0 to 1.
    pub usable: f64,
    /// Datagrams sent per message, including those of the protocol, such as acknowledgements; null in a measurement
    /// between hosts.
    pub datagrams_per_message: Option<f64>,
}

impl Row {
    /// Returns the row's case: network, addressing, reliability mode, retry limit and message rate.
    pub fn case(&self) -> Case {
        let Row { network, addressing, reliability, retries, rate, .. } = *self;
        Case { network, addressing, reliability, retries, rate }
    }

    /// Returns the case's parameters as text, without the message rate; for a measurement with the word `live`.
    pub fn combination(&self) -> String {
        let name = self.case().combination();
        if self.source == Source::Emulated { name } else { format!("{name}, {}", self.source) }
    }

    /// Returns the row of results for a case and its outcome.
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
