//! One station of a measured case: says what the emulated one would say, at the same moments, and notes what it hears.
//! A core like any other; who gives it a clock and a network is not its business.

use serde::{Deserialize, Serialize};

use super::case::Case;
use super::emulate;
use super::endpoint::{DRAIN, NEVER, STEP, WARM};
use super::outcome::{Outcome, Tally};
use super::talk::{self, Schedule};
use crate::actor::Core;
use crate::messages::wire::{Latent, Wire};
use crate::time::{Span, Time};

/// Messages that a station says at once when it was held up: a burst of this many is what a busy machine makes of a
/// tenth of a second at 500 a second. Older ones are skipped and counted, so that no burst is as long as a hold-up.
const BURST: u32 = 64;

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
    /// Messages that were due in the window and never said, because the station was held up for too long. They count
    /// as expected and not as delivered.
    #[serde(default)]
    pub skipped: u64,
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
            tally.expects((one.said + one.skipped) * u64::from(self.stations - 1));
            one.delays_us.iter().for_each(|delay| tally.delayed(us(*delay)));
            one.ages_us.iter().for_each(|age| tally.aged(age.map_or(NEVER, us)));
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
        self.speak(now, out);
        if self.step <= now {
            let others = (0..self.newest.len()).filter(|from| *from != usize::from(self.station));
            let age = |from: usize| self.newest[from].map(|said| now.since(said).as_nanos() / 1000);
            self.notes.ages_us.extend(others.map(age));
            // Steps that were missed are not made up for: a robot that was held up has not acted meanwhile.
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
    /// Says what is due: after a hold-up in a burst, in which the oldest are left out if there are too many.
    fn speak(&mut self, now: Time, out: &mut Vec<Wire>) {
        let mut owed = Vec::new();
        while self.schedule.next() <= now {
            let due = self.schedule.next();
            owed.push((due, self.schedule.say()));
        }
        let skipped = owed.len().saturating_sub(BURST as usize);
        self.notes.skipped += owed[..skipped].iter().filter(|(due, _)| self.counts(*due)).count() as u64;
        for (_, sequence) in &owed[skipped..] {
            let stamp = now.since(self.begin);
            self.notes.said += u64::from(self.counts(now));
            out.push(Wire::Latent(talk::message(self.station, self.task.number, *sequence, stamp, self.task.features)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::network::{Addressing, Assurance, Network};

    fn peer() -> Peer {
        let case = Case {
            network: Network::AdHoc,
            addressing: Addressing::Multicast,
            reliability: Assurance::BestEffort,
            retries: 7,
            rate: 1000.0,
        };
        Peer::new(Task { number: 3, case, stations: 2, features: 4, seconds: 20.0, seed: 1 }, 0, Time::ZERO)
    }

    /// The messages of one wake.
    fn woken(peer: &mut Peer, now: Time) -> usize {
        let mut out = Vec::new();
        peer.wake(now, &mut out);
        assert!(peer.wake_at().is_none_or(|next| next > now), "it has to be woken once at one instant");
        out.len()
    }

    #[test]
    fn a_station_that_was_held_up_says_a_burst_and_counts_what_it_skips() {
        let mut peer = peer();
        let begin = Time::ZERO + WARM;
        while let Some(next) = peer.wake_at().filter(|next| *next < begin) {
            assert!(woken(&mut peer, next) <= 1, "one that is woken in time says one at a time");
        }
        assert_eq!(peer.notes().said, 0, "nothing counts before the window");
        // A tenth of a second at 500 a second: all of it is said late.
        let said = woken(&mut peer, begin + Span::from_millis(100));
        assert!((45..=55).contains(&said), "{said}");
        assert_eq!(peer.notes().skipped, 0);
        // Ten seconds: more than could be said one wake at a time.
        assert_eq!(woken(&mut peer, begin + Span::from_millis(10_100)), BURST as usize);
        let Notes { said, skipped, ages_us, .. } = peer.notes();
        assert!((4990..=5110).contains(&(said + skipped)), "{said} and {skipped}");
        assert!(ages_us.len() <= 3, "missed steps are not made up for");
        woken(&mut peer, begin + Span::from_secs(1000.0));
        assert!(peer.is_over(begin + Span::from_secs(1000.0)));
    }
}
