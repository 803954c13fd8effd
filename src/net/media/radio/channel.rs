//! A channel that stations share by the distributed coordination function (10.3): who sends when, and who hears it.
//!
//! Event-driven: from one transmission to the next, however many slots lie between. All stations hear each other start,
//! so none is hidden from another; two that start in one slot collide, and nobody reads either. A study runs it by
//! itself, an emulated ether inside of an actor.

use rand::RngExt;

use super::counts::RadioCounts;
pub use super::station::To;
use super::station::{Hop, Job, Station};
use super::{Radio, Times, Topology};
use crate::messages::geometry::Vec2;
use crate::random;
use crate::random::{Seed, Stream};
use crate::time::{Span, Time};

/// What foreign frames carry: a full Ethernet payload (IEEE 802.3, 3.2.7), less what `OVERHEAD_BYTES` counts of IP and
/// UDP \[bytes\].
const FOREIGN_BYTES: usize = 1500 - 28;

/// A frame that a station has received.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivery<T> {
    /// When its last bit came.
    pub at: Time,
    /// Whose it is.
    pub from: u16,
    /// Who has received it.
    pub to: u16,
    /// What it was offered with.
    pub token: T,
}

/// A transmission under way.
#[derive(Clone, Copy, Debug)]
struct OnAir {
    since: Time,
    until: Time,
}

/// One channel and its stations.
#[derive(Clone, Debug)]
pub struct Channel<T> {
    radio: Radio,
    times: Times,
    /// Those that were asked for, then the access point and the foreign one if there are such.
    stations: Vec<Station<T>>,
    members: u16,
    /// Where the members are; those of whom nothing is known are in everybody's reach.
    places: Vec<Option<Vec2>>,
    on_air: Option<OnAir>,
    senders: Vec<usize>,
    /// From when on slots are counted.
    free_at: Time,
    due: Option<Time>,
    foreign_due: Option<Time>,
    foreign_gap_s: f64,
    backoff: Stream,
    noise: Stream,
    foreign: Stream,
    counts: RadioCounts,
}

impl<T: Clone> Channel<T> {
    /// A channel with idle stations, at the start of the run; draws from streams of this seed alone. Panics unless the
    /// radio is checked.
    pub fn new(radio: Radio, members: u16, seed: &Seed) -> Channel<T> {
        let relays = usize::from(radio.channel == Topology::Infrastructure);
        let all = usize::from(members) + relays + usize::from(radio.background > 0.0);
        let times = radio.times();
        let taken = radio.frame_airtime(FOREIGN_BYTES) + times.propagation + times.acknowledged;
        let mut channel = Channel {
            times,
            stations: (0..all).map(|_| Station::new(&radio)).collect(),
            members,
            places: vec![None; usize::from(members)],
            on_air: None,
            senders: Vec::new(),
            free_at: Time::ZERO + times.space,
            due: None,
            foreign_due: None,
            foreign_gap_s: taken.as_secs() / radio.background,
            backoff: seed.stream("backoff"),
            noise: seed.stream("noise"),
            foreign: seed.stream("foreign"),
            counts: RadioCounts::default(),
            radio,
        };
        if channel.radio.background > 0.0 {
            channel.foreign_due = Some(channel.next_foreign(Time::ZERO));
        }
        channel.plan();
        channel
    }

    /// A station is given a datagram of so many bytes to send. `now` must not lie beyond `wake_at`.
    pub fn offer(&mut self, now: Time, from: u16, to: To, bytes: usize, token: T) {
        assert!(self.due.is_none_or(|due| now <= due), "a channel is woken before it is offered more");
        let job = self.job(from, to, bytes, token);
        self.counts.offered += 1;
        self.counts.wanted += job.copies();
        self.push(now, usize::from(from), job);
        self.plan();
    }

    /// From now on a station always has such a datagram to send.
    pub fn saturate(&mut self, now: Time, from: u16, to: To, bytes: usize, token: T) {
        self.stations[usize::from(from)].refill = Some(self.job(from, to.clone(), bytes, token.clone()));
        self.offer(now, from, to, bytes, token);
    }

    /// A station is there \[m\].
    pub fn place(&mut self, station: u16, position: Vec2) {
        self.places[usize::from(station)] = Some(position);
    }

    /// What was counted until `now`.
    pub fn counts(&self, now: Time) -> RadioCounts {
        RadioCounts { channel_ns: now.as_nanos(), ..self.counts }
    }

    /// How many frames wait at a station.
    pub fn queued(&self, station: u16) -> usize {
        self.stations[usize::from(station)].queue.len()
    }

    /// When anything is next due.
    pub fn wake_at(&self) -> Option<Time> {
        self.due
    }

    /// Does all that is due until `now`, and puts what has arrived into `deliveries`, in the order of its arrival.
    pub fn wake(&mut self, now: Time, deliveries: &mut Vec<Delivery<T>>) {
        while let Some(due) = self.due.filter(|&due| due <= now) {
            if self.foreign_due == Some(due) {
                self.foreign_due = Some(self.next_foreign(due));
                self.push_foreign(due);
            } else if let Some(on_air) = self.on_air {
                self.end(on_air, deliveries);
            } else {
                self.begin(due);
            }
            self.plan();
        }
    }

    fn job(&self, from: u16, to: To, bytes: usize, token: T) -> Job<T> {
        let hop = if self.radio.channel == Topology::Infrastructure { Hop::Up } else { Hop::Direct };
        Job { hop, from, to, bytes, token: Some(token) }
    }

    fn next_foreign(&mut self, now: Time) -> Time {
        now + Span::from_secs(random::exponential(&mut self.foreign) * self.foreign_gap_s)
    }

    fn push_foreign(&mut self, now: Time) {
        let job = Job { hop: Hop::Foreign, from: 0, to: To::One(0), bytes: FOREIGN_BYTES, token: None };
        self.push(now, self.stations.len() - 1, job);
    }

    /// Puts a frame into a station's queue, if there is room; the first one starts its access to the medium.
    fn push(&mut self, now: Time, station: usize, job: Job<T>) {
        let at = &mut self.stations[station];
        if at.queue.len() >= self.radio.queue {
            self.counts.lost_queue += job.copies();
            return;
        }
        at.queue.push_back(job);
        if at.queue.len() > 1 {
            return;
        }
        if self.on_air.is_some() || now < self.free_at {
            at.ready_after(&mut self.backoff);
        } else {
            // All stations send at the boundaries of slots, long after the last frame too (10.22.2.4).
            at.ready_at(now.since(self.free_at).as_nanos().div_ceil(self.times.slot.as_nanos()));
        }
    }

    fn plan(&mut self) {
        let next = match self.on_air {
            Some(on_air) => Some(on_air.until),
            None => {
                let slot = self.stations.iter().filter_map(Station::slot).min();
                slot.map(|slot| self.free_at + self.times.slot * slot)
            }
        };
        self.due = [next, self.foreign_due].into_iter().flatten().min();
    }

    /// Those whose slot this is send.
    fn begin(&mut self, now: Time) {
        let slot = now.since(self.free_at).as_nanos() / self.times.slot.as_nanos();
        self.senders.clear();
        let mut longest = Span::ZERO;
        for (at, station) in self.stations.iter_mut().enumerate() {
            if station.pass(slot, self.radio.counting) {
                let job = station.queue.front().expect("who sends has a frame");
                let airtime = if job.unicast() {
                    self.radio.frame_airtime(job.bytes)
                } else {
                    self.radio.multicast_airtime(job.bytes)
                };
                longest = longest.max(airtime);
                self.senders.push(at);
            }
        }
        self.on_air = Some(OnAir { since: now, until: now + longest + self.times.propagation });
    }

    /// What was sent has arrived or collided.
    fn end(&mut self, on_air: OnAir, deliveries: &mut Vec<Delivery<T>>) {
        let OnAir { since, until } = on_air;
        let senders = std::mem::take(&mut self.senders);
        let collision = senders.len() > 1;
        let (mut own, mut quiet) = (false, self.times.recovery);
        let mut taken = until.since(since);
        for &at in &senders {
            let job = self.stations[at].queue.pop_front().expect("who has sent has a frame");
            if job.hop != Hop::Foreign {
                own = true;
                self.counts.transmissions += 1;
                self.counts.collided += u64::from(collision);
            }
            if !job.unicast() {
                self.stations[at].done(&self.radio, &mut self.backoff);
                if collision {
                    self.counts.lost_collision += job.copies();
                } else {
                    quiet = self.times.space;
                    self.spread(until, &job, deliveries);
                }
            } else if !collision && self.hears(&job) {
                taken = taken + self.times.acknowledged;
                quiet = self.times.acknowledged + self.times.space;
                self.stations[at].done(&self.radio, &mut self.backoff);
                self.arrive(until, job, deliveries);
            } else if let Some(given_up) = self.stations[at].failed(job, &self.radio, &mut self.backoff) {
                self.counts.lost_retries += given_up.copies();
            }
        }
        (self.senders, self.on_air) = (senders, None);
        self.free_at = until + quiet;
        let time = if own { &mut self.counts.airtime_ns } else { &mut self.counts.foreign_ns };
        *time += taken.as_nanos();
    }

    /// Whether the one that an undisturbed unicast frame is for can read it.
    fn hears(&mut self, job: &Job<T>) -> bool {
        match (job.hop, &job.to) {
            (Hop::Foreign, _) => true,
            (Hop::Direct, To::One(to)) if !self.in_reach(job.from, *to) => false,
            _ => !self.spoilt(),
        }
    }

    fn spoilt(&mut self) -> bool {
        self.radio.noise_loss > 0.0 && self.noise.random_bool(self.radio.noise_loss)
    }

    fn in_reach(&self, from: u16, to: u16) -> bool {
        let Some(range_m) = self.radio.range_m else { return true };
        match (self.places[usize::from(from)], self.places[usize::from(to)]) {
            (Some(from), Some(to)) => (to - from).norm_squared() <= range_m * range_m,
            _ => true,
        }
    }

    /// A unicast frame has been read by the station that it was sent to.
    fn arrive(&mut self, at: Time, job: Job<T>, deliveries: &mut Vec<Delivery<T>>) {
        match (job.hop, &job.to) {
            (Hop::Foreign, _) => {}
            (Hop::Up, _) => {
                self.push(at, usize::from(self.members), Job { hop: Hop::Down, ..job });
            }
            (_, To::One(to)) => self.deliver(at, job.from, *to, job.token.as_ref(), deliveries),
            (_, To::Many(_)) => unreachable!("a frame for many is unicast on its way up alone"),
        }
    }

    /// A multicast frame is over: each listener has read it or not.
    fn spread(&mut self, at: Time, job: &Job<T>, deliveries: &mut Vec<Delivery<T>>) {
        let To::Many(listeners) = &job.to else { unreachable!("a frame for one is unicast") };
        for &to in listeners.iter().filter(|&&to| to != job.from) {
            if job.hop == Hop::Direct && !self.in_reach(job.from, to) {
                self.counts.lost_range += 1;
            } else if self.spoilt() {
                self.counts.lost_noise += 1;
            } else {
                self.deliver(at, job.from, to, job.token.as_ref(), deliveries);
            }
        }
    }

    fn deliver(&mut self, at: Time, from: u16, to: u16, token: Option<&T>, deliveries: &mut Vec<Delivery<T>>) {
        self.counts.arrived += 1;
        let token = token.expect("a foreign frame is for nobody here").clone();
        deliveries.push(Delivery { at, from, to, token });
    }
}
