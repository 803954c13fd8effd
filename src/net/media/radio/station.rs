//! One station of a channel: its transmit queue, its contention window and its backoff counter. Knows no other station.

use std::collections::VecDeque;
use std::sync::Arc;

use rand::RngExt;

use super::{Counting, Radio};
use crate::random::Stream;

/// Whom a frame is for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum To {
    /// One station: acknowledged, and sent again without an acknowledgement.
    One(u16),
    /// These stations, its sender aside: at the basic rate, once.
    Many(Arc<[u16]>),
}

/// Which way a frame goes in one transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Hop {
    /// From station to station.
    Direct,
    /// To the access point.
    Up,
    /// From the access point.
    Down,
    /// Between stations that are not of this channel's.
    Foreign,
}

/// A frame that waits.
#[derive(Clone, Debug)]
pub(super) struct Job<T> {
    pub hop: Hop,
    pub from: u16,
    pub to: To,
    pub bytes: usize,
    /// None for a foreign one.
    pub token: Option<T>,
}

impl<T> Job<T> {
    /// How many stations it is for.
    pub fn copies(&self) -> u64 {
        match &self.to {
            _ if self.hop == Hop::Foreign => 0,
            To::One(_) => 1,
            To::Many(all) => all.iter().filter(|&&to| to != self.from).count() as u64,
        }
    }

    /// Whether it is acknowledged.
    pub fn unicast(&self) -> bool {
        match self.hop {
            Hop::Up | Hop::Foreign => true,
            Hop::Direct | Hop::Down => matches!(self.to, To::One(_)),
        }
    }
}

/// A station of a channel.
#[derive(Clone, Debug)]
pub(super) struct Station<T> {
    pub queue: VecDeque<Job<T>>,
    /// What takes the place of a frame that has left, where there is always one to send.
    pub refill: Option<Job<T>>,
    /// When it sends, or may send again: so many slots after the medium is free. None if it may at once.
    counter: Option<u64>,
    window: u32,
    failures: u32,
}

impl<T: Clone> Station<T> {
    pub fn new(radio: &Radio) -> Station<T> {
        Station { queue: VecDeque::new(), refill: None, counter: None, window: radio.cw_min, failures: 0 }
    }

    /// In which slot after the medium is free it sends, if the medium stays so.
    pub fn slot(&self) -> Option<u64> {
        self.counter.filter(|_| !self.queue.is_empty())
    }

    /// A frame has come to an empty queue while the medium is idle, not before this slot (10.3.4.2).
    pub fn ready_at(&mut self, slot: u64) {
        self.counter = Some(self.counter.unwrap_or(0).max(slot));
    }

    /// The same while the medium is taken: a backoff is drawn, unless one is still under way (10.3.4.2, 10.3.4.3).
    pub fn ready_after(&mut self, stream: &mut Stream) {
        if self.counter.is_none() {
            self.draw(stream);
        }
    }

    /// A transmission begins in this slot; whether it is one of this station.
    pub fn pass(&mut self, slot: u64, counting: Counting) -> bool {
        let Some(counter) = self.counter.take() else { return false };
        if counter <= slot {
            return !self.queue.is_empty();
        }
        let left = counter - slot - u64::from(counting == Counting::Edca);
        // Nothing to send and nothing left to count: the backoff after the last frame is over.
        self.counter = Some(left).filter(|&left| left > 0 || !self.queue.is_empty());
        false
    }

    /// Its frame is done with, acknowledged or not to be sent again: there is a backoff before the next (10.3.4.3).
    pub fn done(&mut self, radio: &Radio, stream: &mut Stream) {
        (self.window, self.failures) = (radio.cw_min, 0);
        self.draw(stream);
        if self.queue.is_empty() {
            self.queue.extend(self.refill.clone());
        }
    }

    /// Its frame was not acknowledged: it goes out again from a window twice as large (10.3.3, 10.3.4.4), or comes back
    /// as given up.
    pub fn failed(&mut self, job: Job<T>, radio: &Radio, stream: &mut Stream) -> Option<Job<T>> {
        if self.failures >= radio.retries {
            self.done(radio, stream);
            return Some(job);
        }
        self.queue.push_front(job);
        self.failures += 1;
        self.window = (2 * self.window + 1).min(radio.cw_max);
        self.draw(stream);
        None
    }

    fn draw(&mut self, stream: &mut Stream) {
        self.counter = Some(u64::from(stream.random_range(0..=self.window)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;

    fn job() -> Job<u8> {
        Job { hop: Hop::Direct, from: 0, to: To::One(1), bytes: 100, token: Some(0) }
    }

    #[test]
    fn a_counter_stands_still_while_the_medium_is_taken() {
        for (counting, left) in [(Counting::Dcf, 6), (Counting::Edca, 5)] {
            let mut station = Station::new(&Radio::default());
            station.queue.push_back(job());
            station.ready_at(10);
            assert!(!station.pass(4, counting));
            assert_eq!(station.slot(), Some(left));
            assert!(station.pass(left, counting), "its own slot");
        }
    }

    #[test]
    fn a_window_doubles_up_to_its_bound_and_a_frame_is_given_up() {
        let radio = Radio { cw_max: 63, retries: 3, ..Radio::default() };
        let (mut station, mut stream) = (Station::new(&radio), Seed::of_run(1).stream("station"));
        let mut windows = Vec::new();
        for _ in 0..3 {
            assert!(station.failed(job(), &radio, &mut stream).is_none());
            windows.push(station.window);
            station.queue.clear();
        }
        assert_eq!(windows, [31, 63, 63]);
        assert!(station.failed(job(), &radio, &mut stream).is_some(), "once and three times more");
        assert_eq!((station.window, station.failures), (15, 0));
    }

    #[test]
    fn a_backoff_follows_every_frame() {
        let radio = Radio { cw_min: 1023, ..Radio::default() };
        let (mut station, mut stream) = (Station::<u8>::new(&radio), Seed::of_run(1).stream("station"));
        station.done(&radio, &mut stream);
        assert_eq!(station.slot(), None, "there is nothing to send");
        let counter = station.counter.unwrap();
        assert!(counter > 4, "the seed gives a long one");
        station.ready_at(3);
        assert_eq!(station.counter, Some(counter), "a frame that comes early waits for it");
        station.ready_at(2000);
        assert_eq!(station.counter, Some(2000), "one that comes late does not");
    }
}
