//! Rate adaptation of unicast frames: Minstrel, by which Linux chooses rates.
//!
//! After the documentation of Linux (wireless.wiki.kernel.org, "Minstrel Rate Control"). A station keeps for each
//! receiver and rate a moving average of the share of transmissions that were acknowledged. Frames go at the rate that
//! carries most; a tenth of them sample another one. Each update is 100 ms after the last.

use std::collections::BTreeMap;

use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

use super::rate::Rate;
use super::{ACK_BYTES, Adaptation, Radio};
use crate::random::{Seed, Stream, stored};
use crate::time::{Span, Time};

/// Time between updates of the averages.
const UPDATE: Span = Span::from_millis(100);
/// Weight of the past in an average.
const PAST: f64 = 0.75;
/// Share of frames that sample a rate \[%\].
const SAMPLES_PERCENT: u64 = 10;
/// Length of the frame for which rates are compared \[bytes\].
const REFERENCE_BYTES: usize = 1200;
/// Time that all transmissions of a frame at one rate may take \[s\].
const SEGMENT_S: f64 = 6e-3;
/// Largest number of transmissions of a frame at one rate.
const MOST_TRIES: u32 = 7;
/// Shares of success beyond which a rate is hardly worth more transmissions or samples.
const CLEAR: [f64; 2] = [0.1, 0.95];
/// Number of transmissions at a rate, and of samples of it in an update, whose share of success is clear.
const CLEAR_TRIES: u32 = 2;
const CLEAR_SAMPLES: u32 = 4;
/// Number of updates without a transmission at a slower rate after which a sample of it goes first.
const SKIPPED: u32 = 10;

/// Rates of unicast frames, as each station has learnt them for each receiver.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Rates {
    /// Rates to choose from, in the order of [`Rate::choices`]; none if all frames go at the same rate.
    choices: Vec<Rate>,
    /// By sender and receiver.
    tables: BTreeMap<(u16, u16), Table>,
    #[serde(with = "stored")]
    stream: Stream,
}

/// Success of one rate to one receiver, as its station has seen it.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Known {
    /// Time of a frame of the reference length with its acknowledgement \[s\].
    took_s: f64,
    tries: u32,
    successes: u32,
    /// Average share of success; `None` before the first transmission.
    share: Option<f64>,
    /// Number of updates without a transmission.
    skipped: u32,
    samples_left: u32,
    /// Number of transmissions of one frame in a row, at best and now.
    most_tries: u32,
    tries_now: u32,
}

/// Rates to one receiver, and the frames that its station has sent there.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Table {
    rates: Vec<Known>,
    /// Rates of the frame that is sent, with the number of transmissions at each.
    chain: Vec<(usize, u32)>,
    best: usize,
    second: usize,
    surest: usize,
    frames: u64,
    samples: u64,
    deferred: u64,
    /// Order in which rates are sampled, and the place in it.
    order: Vec<usize>,
    place: usize,
    updated: Time,
    last: usize,
}

impl Rates {
    /// Returns rates of which nothing is known, for a channel with these parameters.
    pub fn new(radio: &Radio, seed: &Seed) -> Rates {
        let choices = match radio.adaptation {
            Adaptation::Fixed => Vec::new(),
            Adaptation::Minstrel => radio.rate.choices(radio.band, radio.width_mhz).collect(),
        };
        Rates { choices, tables: BTreeMap::new(), stream: seed.stream("rates") }
    }

    /// Returns the rate of the transmission of a frame between two stations, after `failures` failed ones.
    pub fn of_frame(&mut self, radio: &Radio, now: Time, between: (u16, u16), failures: u32) -> Rate {
        if self.choices.is_empty() {
            return radio.rate;
        }
        let Rates { choices, tables, stream } = self;
        let table = tables.entry(between).or_insert_with(|| Table::new(radio, choices, now, stream));
        if failures == 0 {
            table.next_frame(now, stream);
        }
        table.last = table.of_try(failures);
        choices[table.last]
    }

    /// Learns whether the last transmission between two stations was acknowledged.
    pub fn report(&mut self, between: (u16, u16), success: bool) {
        if let Some(table) = self.tables.get_mut(&between) {
            let known = &mut table.rates[table.last];
            known.tries += 1;
            known.successes += u32::from(success);
        }
    }
}

impl Table {
    fn new(radio: &Radio, choices: &[Rate], now: Time, stream: &mut Stream) -> Table {
        let rates: Vec<Known> = choices.iter().map(|rate| Known::new(radio, *rate)).collect();
        let mut order: Vec<usize> = (0..rates.len()).collect();
        order.shuffle(stream);
        // Nothing is known yet: the slowest rate is the surest.
        Table {
            rates,
            chain: Vec::new(),
            best: 0,
            second: 0,
            surest: 0,
            frames: 0,
            samples: 0,
            deferred: 0,
            order,
            place: 0,
            updated: now,
            last: 0,
        }
    }

    /// Chooses the rates of a new frame.
    fn next_frame(&mut self, now: Time, stream: &mut Stream) {
        if now.since(self.updated) >= UPDATE {
            self.update();
            self.updated = now;
        }
        self.frames += 1;
        let sample = self.sample(stream);
        let mut stages = vec![self.best, self.second, self.surest, 0];
        if let Some((at, first)) = sample {
            // A slower rate comes second, so that a frame seldom goes at it, unless nothing was known for long.
            if first {
                stages.insert(0, at);
            } else {
                stages.insert(1, at);
            }
        }
        self.chain.clear();
        for at in stages {
            if self.chain.iter().all(|(other, _)| *other != at) {
                self.chain.push((at, self.rates[at].tries_now));
            }
        }
    }

    /// Returns a rate to sample now, and whether it goes first.
    fn sample(&mut self, stream: &mut Stream) -> Option<(usize, bool)> {
        let due = self.frames * SAMPLES_PERCENT / 100;
        if due <= self.samples + self.deferred / 2 {
            return None;
        }
        let at = self.order[self.place];
        self.place += 1;
        if self.place == self.order.len() {
            self.place = 0;
            self.order.shuffle(stream);
        }
        let (slower, known) = (self.rates[at].took_s > self.rates[self.best].took_s, &mut self.rates[at]);
        if at == self.best || known.samples_left == 0 {
            self.samples += 1;
            return None;
        }
        known.samples_left -= 1;
        let first = !slower || known.skipped >= SKIPPED;
        if first {
            self.samples += 1;
        } else {
            self.deferred += 1;
        }
        Some((at, first))
    }

    /// Returns the rate of a transmission after `failures` failed ones of the same frame.
    fn of_try(&self, failures: u32) -> usize {
        let mut left = failures;
        for &(at, tries) in &self.chain {
            if left < tries {
                return at;
            }
            left -= tries;
        }
        0
    }

    fn update(&mut self) {
        self.rates.iter_mut().for_each(Known::update);
        // Of equal ones the first.
        let most = |value: fn(&Known) -> f64, but: Option<usize>| {
            let all = (0..self.rates.len()).filter(|at| Some(*at) != but && value(&self.rates[*at]) > 0.0);
            all.reduce(|best, at| if value(&self.rates[at]) > value(&self.rates[best]) { at } else { best })
        };
        let best = most(Known::carries, None).unwrap_or(0);
        let second = most(Known::carries, Some(best)).unwrap_or(0);
        let sure = |known: &Known| if known.is_sure() { known.carries() } else { 0.0 };
        let surest = most(sure, None).or_else(|| most(|known| known.share.unwrap_or(0.0), None)).unwrap_or(0);
        (self.best, self.second, self.surest) = (best, second, surest);
    }
}

impl Known {
    fn new(radio: &Radio, rate: Rate) -> Known {
        let airtime = |rate: Rate, bytes: usize| rate.airtime(bytes, radio.width_mhz, radio.band).as_secs();
        let times = radio.times();
        let sifs_s = 1e-6 * f64::from(radio.sifs_us);
        let answer_s = sifs_s + airtime(rate.answer(radio.ack_rate), ACK_BYTES);
        let took_s = times.aifs.as_secs() + airtime(rate, REFERENCE_BYTES) + answer_s;
        let (mut most_tries, mut window, mut all_s) = (0, f64::from(radio.cw_min), 0.0);
        while most_tries < MOST_TRIES && (most_tries == 0 || all_s < SEGMENT_S) {
            all_s += took_s + 0.5 * window * times.slot.as_secs();
            window = (2.0 * window + 1.0).min(f64::from(radio.cw_max));
            most_tries += 1;
        }
        Known {
            took_s,
            tries: 0,
            successes: 0,
            share: None,
            skipped: SKIPPED,
            samples_left: CLEAR_SAMPLES,
            most_tries,
            tries_now: most_tries,
        }
    }

    fn update(&mut self) {
        if self.tries == 0 {
            self.skipped += 1;
        } else {
            let now = f64::from(self.successes) / f64::from(self.tries);
            self.share = Some(self.share.map_or(now, |share| PAST * share + (1.0 - PAST) * now));
            (self.tries, self.successes, self.skipped) = (0, 0, 0);
        }
        let [low, high] = CLEAR;
        let clear = self.share.is_none_or(|share| share < low || share > high);
        self.tries_now = if clear { self.most_tries.min(CLEAR_TRIES) } else { self.most_tries };
        self.samples_left = if clear { CLEAR_SAMPLES } else { u32::MAX };
    }

    /// Returns what the rate carries \[frames/s\]; nothing if it hardly ever succeeds.
    fn carries(&self) -> f64 {
        let share = self.share.unwrap_or(0.0);
        if share < CLEAR[0] { 0.0 } else { share / self.took_s }
    }

    fn is_sure(&self) -> bool {
        self.share.is_some_and(|share| share >= CLEAR[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::media::radio::Topology;

    fn radio() -> Radio {
        Radio { channel: Topology::AdHoc, adaptation: Adaptation::Minstrel, ..Radio::default() }
    }

    /// Sends frames for some seconds, of which those succeed whose rate is at most `most`, and returns how many of the
    /// last thousand transmissions went at each rate.
    fn sent(radio: &Radio, most: &'static str) -> BTreeMap<&'static str, u32> {
        let most = Rate::named(most);
        let mut rates = Rates::new(radio, &Seed::of_run(1));
        let choices = rates.choices.clone();
        let place = |rate: Rate| choices.iter().position(|choice| *choice == rate);
        let mut counts = BTreeMap::new();
        for frame in 0..4000_u32 {
            let now = Time::ZERO + Span::from_millis(1) * u64::from(frame);
            for failures in 0..8 {
                let rate = rates.of_frame(radio, now, (0, 1), failures);
                let success = place(rate) <= place(most);
                rates.report((0, 1), success);
                if frame >= 3000 {
                    *counts.entry(rate.name()).or_default() += 1;
                }
                if success {
                    break;
                }
            }
        }
        counts
    }

    #[test]
    fn the_fastest_rate_that_carries_is_found() {
        // Where those up to 6 Mbit/s of OFDM succeed, 11 Mbit/s of DSSS do, too.
        for (most, best) in [("ofdm-54", "ofdm-54"), ("ofdm-24", "ofdm-24"), ("ofdm-6", "dsss-11")] {
            let counts = sent(&radio(), most);
            assert!(counts[best] > 800, "{most}: {counts:?}");
        }
        let narrow = Radio { rate: Rate::named("ofdm-12"), ..radio() };
        let counts = sent(&narrow, "ofdm-12");
        assert!(!counts.contains_key("ofdm-18") && counts["ofdm-12"] > 800, "{counts:?}");
    }

    #[test]
    fn acknowledgements_go_at_mandatory_rates() {
        let most = Rate::named("ofdm-24");
        let of = |name| Rate::named(name).answer(most).name();
        for (rate, answer) in [
            ("ofdm-54", "ofdm-24"),
            ("ofdm-18", "ofdm-12"),
            ("ofdm-9", "ofdm-6"),
            ("dsss-11", "dsss-11"),
            ("dsss-1", "dsss-1"),
            ("ht-mcs7", "ofdm-24"),
            ("ht-mcs0", "ofdm-6"),
        ] {
            assert_eq!(of(rate), answer, "{rate}");
        }
    }
}
