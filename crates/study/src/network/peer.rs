//! Station of a network study's case that is measured between hosts. It publishes the same messages at the same
//! times as an emulated station, and records what it receives. Pure; the caller supplies clock and network.

use serde::{Deserialize, Serialize};

use super::case::Case;
use super::emulate;
use super::endpoint::{DRAIN, NEVER, STEP, WARM_UP};
use super::outcome::{Outcome, Tally};
use super::traffic::{self, Moments, Schedule};
use murmurate::actor::Core;
use murmurate::messages::wire::{Latent, Wire};
use murmurate::time::{Span, Time};

/// Largest number of messages published in a burst after a scheduling delay: about a tenth of a second at 500 messages
/// a second. Older ones are skipped and counted.
const BURST: u32 = 64;

/// Request to measure one case of a network study, sent by the coordinating host to all stations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Task {
    /// Number of this measurement, which every message carries. Stations ignore messages with another number.
    pub number: u32,
    /// Case to measure.
    pub case: Case,
    /// Number of stations that take part.
    pub stations: u16,
    /// Number of floats of the latent in each message.
    pub features: usize,
    /// Duration of the measurement \[s\], without warm-up and drain.
    pub seconds: f64,
    /// Seed of the stations' publication schedules.
    pub seed: u64,
}

/// Messages and ages that one station has counted in a measured case.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StationResult {
    /// Number of messages that the station published within the measurement.
    pub said: u64,
    /// Number of messages that were due within the measurement and not published, because the host ran its program too
    /// late. They count as expected and not delivered.
    #[serde(default)]
    pub skipped: u64,
    /// Delay from publication to arrival \[us\] of each received message that was published within the measurement.
    pub delays_us: Vec<u64>,
    /// Age of each other station's newest message at each control step \[us\]; `None` if none of it had arrived yet.
    pub ages_us: Vec<Option<u64>>,
}

impl Task {
    /// Returns the duration of the case including warm-up and drain.
    pub fn lasts(&self) -> Span {
        WARM_UP + Span::from_secs(self.seconds) + DRAIN
    }

    /// Combines the results of all stations into the outcome of the case.
    pub fn outcome(&self, results: &[StationResult]) -> Outcome {
        let begin = Time::ZERO + WARM_UP;
        let mut tally = Tally::new(self.stations, (begin, begin + Span::from_secs(self.seconds)));
        let us = |us: u64| Span::from_nanos(1000 * us);
        for one in results {
            tally.add_due((one.said + one.skipped) * u64::from(self.stations - 1));
            one.delays_us.iter().for_each(|delay| tally.add_delay(us(*delay)));
            one.ages_us.iter().for_each(|age| tally.add_age(age.map_or(NEVER, us)));
        }
        tally.outcome()
    }
}

/// Station of a case that is measured between hosts: its publication schedule, received messages and result.
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
    /// For each station: publication time of its newest message.
    newest: Vec<Option<Time>>,
    result: StationResult,
}

impl Peer {
    /// Returns the station with the index `station` of a case that begins at `begin` on the station's own clock.
    pub fn new(task: Task, station: u16, begin: Time) -> Peer {
        let seed = emulate::seed(task.seed, &task.case);
        let window = (begin + WARM_UP, begin + WARM_UP + Span::from_secs(task.seconds));
        Peer {
            station,
            begin,
            window,
            over: window.1 + DRAIN,
            ended: false,
            schedule: Schedule::new(begin, station, (task.stations, task.case.rate), (&seed, Moments::Random)),
            step: window.0 + traffic::phases(task.stations, STEP, &seed)[usize::from(station)],
            newest: vec![None; usize::from(task.stations)],
            result: StationResult::default(),
            task,
        }
    }

    /// Returns whether the measurement is over, including the time in which late messages may arrive (drain).
    pub fn is_over(&self, now: Time) -> bool {
        self.ended || now >= self.over
    }

    /// Returns the messages and ages that the station has counted so far.
    pub fn result(&self) -> &StationResult {
        &self.result
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
        if latent.round.term != self.task.number {
            return;
        }
        let published = self.begin + traffic::stamp(&latent);
        *newest = (*newest).max(Some(published));
        if self.counts(published) {
            self.result.delays_us.push(now.since(published).as_nanos() / 1000);
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
        self.publish_due(now, out);
        if self.step <= now {
            let others = (0..self.newest.len()).filter(|from| *from != usize::from(self.station));
            let age = |from: usize| self.newest[from].map(|published| now.since(published).as_nanos() / 1000);
            self.result.ages_us.extend(others.map(age));
            // Missed steps are not made up for, since a delayed robot would not have acted either.
            while self.step <= now {
                self.step += STEP;
            }
            if self.step >= self.window.1 {
                self.step = Time::MAX;
            }
        }
    }
}

impl Peer {
    /// Appends all messages that are due to `out`. After a scheduling delay these are the newest `BURST`; older
    /// ones are skipped and counted.
    fn publish_due(&mut self, now: Time, out: &mut Vec<Wire>) {
        let mut due_messages = Vec::new();
        while self.schedule.next() <= now {
            let due = self.schedule.next();
            due_messages.push((due, self.schedule.publish()));
        }
        let skipped = due_messages.len().saturating_sub(BURST as usize);
        self.result.skipped += due_messages[..skipped].iter().filter(|(due, _)| self.counts(*due)).count() as u64;
        for (_, sequence) in &due_messages[skipped..] {
            let stamp = now.since(self.begin);
            self.result.said += u64::from(self.counts(now));
            out.push(Wire::Latent(traffic::message(
                self.station,
                self.task.number,
                *sequence,
                stamp,
                self.task.features,
            )));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::{Addressing, NetworkKind, ReliabilityMode};

    fn peer() -> Peer {
        let case = Case {
            network: NetworkKind::AdHoc,
            addressing: Addressing::Multicast,
            reliability: ReliabilityMode::BestEffort,
            retries: 7,
            rate: 1000.0,
        };
        Peer::new(Task { number: 3, case, stations: 2, features: 4, seconds: 20.0, seed: 1 }, 0, Time::ZERO)
    }

    /// Wakes the station. Returns the number of messages that it publishes.
    fn woken(peer: &mut Peer, now: Time) -> usize {
        let mut out = Vec::new();
        peer.wake(now, &mut out);
        assert!(peer.wake_at().is_none_or(|next| next > now), "one wake handles everything that is due");
        out.len()
    }

    #[test]
    fn a_delayed_station_publishes_a_burst_and_counts_skipped_messages() {
        let mut peer = peer();
        let begin = Time::ZERO + WARM_UP;
        while let Some(next) = peer.wake_at().filter(|next| *next < begin) {
            assert!(woken(&mut peer, next) <= 1, "a station that is woken in time publishes one message at a time");
        }
        assert_eq!(peer.result().said, 0, "nothing counts before the window");
        // A tenth of a second at 500 a second: all messages are published late.
        let said = woken(&mut peer, begin + Span::from_millis(100));
        assert!((45..=55).contains(&said), "{said}");
        assert_eq!(peer.result().skipped, 0);
        // Ten seconds: more messages than a burst.
        assert_eq!(woken(&mut peer, begin + Span::from_millis(10_100)), BURST as usize);
        let StationResult { said, skipped, ages_us, .. } = peer.result();
        assert!((4990..=5110).contains(&(said + skipped)), "{said} and {skipped}");
        assert!(ages_us.len() <= 3, "missed steps are not repeated");
        woken(&mut peer, begin + Span::from_secs(1000.0));
        assert!(peer.is_over(begin + Span::from_secs(1000.0)));
    }
}
