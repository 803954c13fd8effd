//! Wired network with shaped links: a token bucket with a queue at each sender, and independent loss at each receiver.
//! It models an Ethernet with `tc tbf` and `netem loss`, without contention.

use std::collections::{BTreeMap, VecDeque};

use rand::RngExt;
use serde::{Deserialize, Serialize};

use murmurate::config::ConfigError;
use murmurate::net::media::radio::{Delivery, Destination};
use murmurate::random::{Seed, Stream};
use murmurate::time::{Span, Time};

/// Parameters of a wired network in which each station has one link, whose rate a token bucket limits (a shaped link).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shaped {
    /// Rate of each station's link \[bit/s\].
    pub rate_bit_s: f64,
    /// Size of the token bucket \[bytes\].
    pub burst_bytes: usize,
    /// Size of each station's queue of frames to send \[bytes\]. A frame that does not fit is dropped.
    pub queue_bytes: usize,
    /// Probability that a receiver loses a frame, 0 to 1; independent for each receiver.
    #[serde(default)]
    pub loss: f64,
    /// Constant part of the one-way delay \[us\]: network stack, bridge and wake-up of the receiver.
    #[serde(default)]
    pub latency_us: f64,
    /// Header bytes on the link for each datagram \[bytes\]: Ethernet 14, IPv4 20, UDP 8.
    #[serde(default = "headers")]
    pub overhead_bytes: usize,
}

fn headers() -> usize {
    14 + 20 + 8
}

impl Shaped {
    /// Returns the parameters of links with a rate of 1 Mbit/s, as with `tc tbf rate 1mbit`, and 16 % loss.
    pub fn megabit() -> Shaped {
        Shaped {
            rate_bit_s: 1e6,
            burst_bytes: 1600,
            queue_bytes: 20_000,
            loss: 0.16,
            latency_us: 0.0,
            overhead_bytes: headers(),
        }
    }

    /// Checks the ranges of the parameters. An error names the field.
    pub fn check(&self) -> Result<(), ConfigError> {
        let wrong = |field: &str, reason: String| Err(ConfigError::field(field, reason));
        if !(1e3..=1e12).contains(&self.rate_bit_s) {
            return wrong("rate_bit_s", format!("{} is not 1000 to 1e12", self.rate_bit_s));
        }
        if !(0.0..=1.0).contains(&self.loss) {
            return wrong("loss", format!("{} is not a share of 0 to 1", self.loss));
        }
        if !(0.0..=1e6).contains(&self.latency_us) {
            return wrong("latency_us", format!("{} is not 0 to 1000000", self.latency_us));
        }
        for (field, value) in [("burst_bytes", self.burst_bytes), ("queue_bytes", self.queue_bytes)] {
            if !(100..=100_000_000).contains(&value) {
                return wrong(field, format!("{value} is not 100 to 100000000"));
            }
        }
        Ok(())
    }
}

/// Traffic shaper of one station's outgoing link.
#[derive(Clone, Debug)]
struct Sender {
    /// Tokens in the bucket at the time `at` of the last departure \[bytes\].
    tokens: f64,
    at: Time,
    /// Queued frames: departure time, and length \[bytes\].
    queue: VecDeque<(Time, usize)>,
    waiting: usize,
}

/// Emulator of a wired network with one shaped link for each station. `T` is what identifies a datagram in its
/// deliveries.
#[derive(Clone, Debug)]
pub struct Links<T> {
    shaped: Shaped,
    senders: Vec<Sender>,
    /// Frames in flight, ordered by arrival time and then by order of sending.
    in_flight: BTreeMap<(Time, u64), (u16, Destination, T)>,
    offered: u64,
    loss: Stream,
    sent_bytes: f64,
}

impl<T: Clone> Links<T> {
    /// Returns an emulator with this number of stations and empty queues.
    pub fn new(shaped: Shaped, stations: u16, seed: &Seed) -> Links<T> {
        let tokens = shaped.burst_bytes as f64;
        let sender = Sender { tokens, at: Time::ZERO, queue: VecDeque::new(), waiting: 0 };
        Links {
            shaped,
            senders: vec![sender; usize::from(stations)],
            in_flight: BTreeMap::new(),
            offered: 0,
            loss: seed.stream("loss"),
            sent_bytes: 0.0,
        }
    }

    /// Queues a datagram of `bytes` \[bytes\] at the station `from`, for the receivers `to`; drops it if that station's
    /// queue is full or its token bucket too small. `token` is returned in its deliveries.
    pub fn offer(&mut self, now: Time, from: u16, to: Destination, bytes: usize, token: T) {
        let length = bytes + self.shaped.overhead_bytes;
        let sender = &mut self.senders[usize::from(from)];
        while let Some(&(left, length)) = sender.queue.front().filter(|(left, _)| *left <= now) {
            debug_assert!(left <= now);
            sender.waiting -= length;
            sender.queue.pop_front();
        }
        if sender.waiting + length > self.shaped.queue_bytes || length > self.shaped.burst_bytes {
            return;
        }
        let bytes_per_s = self.shaped.rate_bit_s / 8.0;
        let from_when = now.max(sender.at);
        let refilled = sender.tokens + from_when.since(sender.at).as_secs() * bytes_per_s;
        let tokens = refilled.min(self.shaped.burst_bytes as f64) - length as f64;
        let leaves = from_when + Span::from_secs((-tokens / bytes_per_s).max(0.0));
        (sender.tokens, sender.at) = (tokens.max(0.0), leaves);
        sender.queue.push_back((leaves, length));
        sender.waiting += length;
        self.sent_bytes += length as f64;
        self.offered += 1;
        let arrives = leaves + Span::from_secs(self.shaped.latency_us * 1e-6);
        self.in_flight.insert((arrives, self.offered), (from, to, token));
    }

    /// Returns the time of the next arrival of a frame; `None` if none is in flight.
    pub fn wake_at(&self) -> Option<Time> {
        self.in_flight.first_key_value().map(|((at, _), _)| *at)
    }

    /// Appends the frames that have arrived by `now` to `deliveries`, without those that their receivers lose.
    pub fn wake(&mut self, now: Time, deliveries: &mut Vec<Delivery<T>>) {
        while let Some(first) = self.in_flight.first_entry().filter(|first| first.key().0 <= now) {
            let ((at, _), (from, to, token)) = first.remove_entry();
            let one;
            let listeners: &[u16] = match &to {
                Destination::One(to) => {
                    one = [*to];
                    &one
                }
                Destination::Many(all) => all,
            };
            for &to in listeners.iter().filter(|to| **to != from) {
                if self.shaped.loss == 0.0 || !self.loss.random_bool(self.shaped.loss) {
                    deliveries.push(Delivery { at, from, to, token: token.clone() });
                }
            }
        }
    }

    /// Returns the time \[s\] in which a link was busy so far, as the mean over the stations.
    pub fn busy_s(&self) -> f64 {
        self.sent_bytes * 8.0 / self.shaped.rate_bit_s / self.senders.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn links(queue_bytes: usize, loss: f64) -> Links<u8> {
        let shaped = Shaped { burst_bytes: 1000, queue_bytes, loss, overhead_bytes: 0, ..Shaped::megabit() };
        Links::new(shaped, 3, &Seed::of_run(1))
    }

    #[test]
    fn a_burst_leaves_at_once_and_later_frames_leave_at_the_rate() {
        let mut links = links(10_000, 0.0);
        let all: Destination = Destination::Many([0, 1, 2].into());
        (0..3).for_each(|token| links.offer(Time::ZERO, 0, all.clone(), 500, token));
        links.offer(Time::ZERO, 1, Destination::One(2), 500, 9);
        let mut deliveries = Vec::new();
        links.wake(Time::MAX, &mut deliveries);
        let at = |token: u8| deliveries.iter().find(|d| d.token == token).unwrap().at.as_nanos();
        assert_eq!([at(0), at(1), at(9)], [0; 3], "a bucket each");
        assert_eq!(at(2), 4_000_000, "500 bytes at 125 a millisecond");
        assert_eq!(deliveries.len(), 3 * 2 + 1);
    }

    #[test]
    fn frames_are_lost_at_a_full_queue_and_independently_at_each_receiver() {
        let mut tight = links(1200, 0.0);
        (0..5).for_each(|token| tight.offer(Time::ZERO, 0, Destination::One(1), 500, token));
        let mut deliveries = Vec::new();
        tight.wake(Time::MAX, &mut deliveries);
        // Two leave with the tokens of the burst, two are queued, and one is dropped.
        assert_eq!(deliveries.len(), 4);
        let mut lossy = links(1 << 20, 0.16);
        let all: Destination = Destination::Many([0, 1, 2].into());
        deliveries.clear();
        for ms in 0..5000 {
            lossy.offer(Time::ZERO + Span::from_millis(10 * ms), 0, all.clone(), 100, 0);
        }
        lossy.wake(Time::MAX, &mut deliveries);
        let share = deliveries.len() as f64 / 10_000.0;
        assert!((share - 0.84).abs() < 0.012, "{share}");
    }
}
