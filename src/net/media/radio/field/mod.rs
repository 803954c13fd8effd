//! A medium with space: each station has its own view of what others send, and frames collide at receivers.
//!
//! Stations that do not sense each other are hidden from each other. An acknowledgement is a transmission of its own,
//! with its own hearers, and can be lost. If all stations sense and read each other, the field is the domain of
//! `domain`: with the same seed, each delivery is the same.

mod ending;
mod together;
mod turns;

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use serde::{Deserialize, Serialize};

use super::adaptation::Rates;
use super::domain::Domain;
use super::links::{Hearer, Links};
use super::rate::Rate;
use super::receiver::{Arrival, Receiver, Thresholds};
use super::station::{Attempts, Destination, Hop, QueuedFrame};
use super::traffic::{Delivery, Reached, Traffic};
use super::view::View;
use super::{ACK_BYTES, Topology};
use crate::messages::geometry::Vec2;
use crate::random::{Seed, Stream, stored};
use crate::time::Time;
use turns::Turns;

/// Probability of reading a frame from which on no random number is drawn for it.
const CERTAIN: f64 = 1.0 - 1e-9;

/// Event of a field beside the turns of its stations, in the order in which those of one instant are handled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
enum Event {
    /// A transmission ends; its number.
    End(u32),
    /// A station begins to acknowledge the frame it has read; its index.
    Acknowledge(u16),
}

/// Content of a transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Cargo {
    /// The frame at the front of the sender's queue.
    Frame,
    /// An acknowledgement for the station with this index.
    Acknowledgement(u16),
}

/// Transmission on the air.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Air {
    by: u16,
    since: Time,
    cargo: Cargo,
    rate: Rate,
    /// Bits of the frame for each second of its time on the air.
    bits_per_s: f64,
    /// Whether the sender has sensed another transmission meanwhile.
    overlapped: bool,
    hearers: Vec<Hearer>,
}

/// Reception of a frame at one station that it reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Reception {
    /// It is too weak to be read.
    Far,
    /// Noise, shadowing or fading has spoilt it.
    Faded,
    /// Another frame has spoilt it, or the station was sending.
    Collided,
    /// It is read.
    Read,
}

/// Frame whose receiver has read it, and whose acknowledgement is under way.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Awaited<T> {
    frame: QueuedFrame<T>,
    attempts: Attempts,
    drawn: u32,
}

/// Outcome of a station's own transmission that has ended, while the medium around it is still busy. The frame is still
/// in its queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Outcome {
    /// The frame is done.
    Done,
    /// No acknowledgement will come.
    Failed,
}

/// Medium in which each station has its own view.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Field<T> {
    thresholds: Thresholds,
    links: Links,
    rates: Rates,
    /// View of each station, by its index.
    views: Vec<View>,
    /// Receiver of each station, by its index.
    receivers: Vec<Receiver>,
    /// Number of the transmission on the air, if it is the only one: no receiver knows of it, since each reads it as it
    /// would by itself.
    alone: Option<u32>,
    /// Positions of all stations, with the access point and the station of other networks.
    #[serde(skip)]
    places: Vec<Option<Vec2>>,
    /// Whether they are those of now.
    #[serde(skip)]
    placed: bool,
    /// Medium of all stations while they sense and read each other: it tells the same in less time.
    together: Option<Domain>,
    /// Whether all stations sense and read each other now.
    #[serde(skip)]
    close: bool,
    turns: Turns,
    airs: Vec<Option<Air>>,
    idle_airs: Vec<u32>,
    events: BinaryHeap<Reverse<(Time, Event)>>,
    /// Acknowledgement that each station is about to send: to whom, and at which rate.
    owed: Vec<Option<(u16, Rate)>>,
    awaited: Vec<Option<Awaited<T>>>,
    outcomes: Vec<Option<Outcome>>,
    occupied: Occupied,
    /// Reception at each station of the transmission that ends.
    #[serde(skip)]
    receptions: Vec<Reception>,
    #[serde(skip)]
    spare: Vec<Vec<Hearer>>,
    /// Transmissions that begin at one instant.
    #[serde(skip)]
    begun: Vec<u32>,
    #[serde(with = "stored")]
    fading: Stream,
    #[serde(with = "stored")]
    reading: Stream,
}

/// Time with anything on the air anywhere, to count it.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Occupied {
    number: u32,
    own: bool,
    since: Time,
    until: Time,
}

impl<T: Clone> Field<T> {
    /// Returns an idle medium at time zero.
    pub fn new(traffic: &Traffic<T>, seed: &Seed) -> Field<T> {
        let stations = traffic.stations.len();
        let free_at = Time::ZERO + traffic.times.aifs;
        Field {
            thresholds: Thresholds::new(&traffic.radio),
            links: Links::new(&traffic.radio, stations),
            rates: Rates::new(&traffic.radio, seed),
            views: vec![View::new(free_at); stations],
            receivers: vec![Receiver::default(); stations],
            alone: None,
            places: Vec::new(),
            placed: false,
            together: None,
            close: false,
            turns: Turns::new(stations),
            airs: Vec::new(),
            idle_airs: Vec::new(),
            events: BinaryHeap::new(),
            owed: vec![None; stations],
            awaited: vec![None; stations],
            outcomes: vec![None; stations],
            occupied: Occupied::default(),
            receptions: Vec::new(),
            spare: Vec::new(),
            begun: Vec::new(),
            fading: seed.stream("fading"),
            reading: seed.stream("reading"),
        }
    }

    /// Takes note that stations have moved.
    pub fn moved(&mut self) {
        self.placed = false;
    }

    /// Returns whom a transmission of a station reaches, itself left out, without shadowing and fading.
    pub fn reached(&self, traffic: &Traffic<T>, from: u16) -> Vec<Reached> {
        let places: Vec<Option<Vec2>> = places(traffic).collect();
        let all = self.links.paths(&traffic.radio, &places, from);
        let others = all.into_iter().filter(|hearer| hearer.station != from && hearer.station < traffic.members);
        let reached = |hearer: Hearer| Reached { station: hearer.station, reads: self.thresholds.hears(hearer.power) };
        others.filter(|hearer| hearer.sensed || self.thresholds.hears(hearer.power)).map(reached).collect()
    }

    /// Sets the walls that weaken frames.
    pub fn wall_in(&mut self, walls: Vec<Vec<[f32; 2]>>) {
        self.links.wall_in(walls);
        self.moved();
    }

    /// Returns the time of the next event.
    pub fn due(&self, traffic: &Traffic<T>) -> Option<Time> {
        if let Some(together) = &self.together {
            return together.due(traffic);
        }
        let event = self.events.peek().map(|Reverse((at, _))| *at);
        [event, self.turns.next()].into_iter().flatten().min()
    }

    /// Queues a frame at a station; if its queue was empty, schedules its transmission.
    pub fn push(&mut self, traffic: &mut Traffic<T>, now: Time, station: usize, frame: QueuedFrame<T>) {
        self.gather_or_part(traffic, now);
        if let Some(together) = &self.together {
            return together.push(traffic, now, station, frame);
        }
        if !traffic.enqueue(station, frame) {
            return;
        }
        let view = &self.views[station];
        if view.busy > 0 || now < view.free_at {
            traffic.stations[station].ready_after(&mut traffic.backoff);
        } else {
            let idle = now.since(view.free_at).as_nanos();
            traffic.stations[station].ready_at(idle.div_ceil(traffic.times.slot.as_nanos()));
        }
        self.plan(traffic, station);
    }

    /// Handles all events of the instant `now`: what ends, and then what begins.
    pub fn wake(&mut self, traffic: &mut Traffic<T>, now: Time, deliveries: &mut Vec<Delivery<T>>) {
        self.gather_or_part(traffic, now);
        if let Some(together) = &mut self.together {
            return together.wake(traffic, now, deliveries);
        }
        while let Some(&Reverse((at, Event::End(air)))) = self.events.peek() {
            if at > now {
                break;
            }
            self.events.pop();
            self.end(traffic, now, air, deliveries);
        }
        self.begin(traffic, now);
    }

    /// Schedules the transmission of a station's next frame, if the medium around it is idle.
    fn plan(&mut self, traffic: &Traffic<T>, station: usize) {
        let view = &self.views[station];
        let slot = traffic.stations[station].slot().filter(|_| view.busy == 0);
        self.turns.set(station, slot.map(|slot| view.free_at + traffic.times.slot * slot));
    }

    /// Begins all transmissions that are to begin at `now`: no sender can sense the others in time.
    fn begin(&mut self, traffic: &mut Traffic<T>, now: Time) {
        let mut begun = std::mem::take(&mut self.begun);
        while let Some(&Reverse((at, Event::Acknowledge(station)))) = self.events.peek() {
            if at > now {
                break;
            }
            self.events.pop();
            let (to, rate) = self.owed[usize::from(station)].take().expect("a station that owes");
            begun.push(self.send(traffic, now, station, Cargo::Acknowledgement(to), (rate, ACK_BYTES)));
        }
        while let Some(by) = self.turns.take(now) {
            let slot = self.views[by].slots(now, traffic.times.slot).expect("a station that counts slots");
            let ready = traffic.stations[by].pass(slot, traffic.radio.counting);
            assert!(ready, "a station that may not send has no turn");
            let frame = traffic.stations[by].queue.front().expect("a station that sends has a frame");
            let bytes = traffic.radio.overhead_bytes + frame.bytes;
            let rate = self.rate_of(traffic, now, by);
            begun.push(self.send(traffic, now, by as u16, Cargo::Frame, (rate, bytes)));
        }
        self.alone = begun.first().copied().filter(|_| self.occupied.number == 1).or(self.alone);
        for air in begun.drain(..) {
            self.spread(traffic, now, air);
        }
        self.begun = begun;
    }

    /// Returns the rate at which a station sends the frame at the front of its queue.
    fn rate_of(&mut self, traffic: &Traffic<T>, now: Time, by: usize) -> Rate {
        let station = &traffic.stations[by];
        let frame = station.queue.front().expect("a station that sends has a frame");
        match receiver_of(traffic, frame) {
            Some(to) => self.rates.of_frame(&traffic.radio, now, (by as u16, to), station.failures()),
            None if frame.unicast() => traffic.radio.rate,
            None => traffic.radio.basic_rate,
        }
    }

    /// Puts a transmission of a station on the air, and returns its number.
    fn send(&mut self, traffic: &Traffic<T>, now: Time, by: u16, cargo: Cargo, (rate, bytes): (Rate, usize)) -> u32 {
        if let Some(other) = self.alone.take() {
            self.tell_receivers(other);
        }
        let airtime = rate.airtime(bytes, traffic.radio.width_mhz, traffic.radio.band);
        let number = self.idle_airs.pop().unwrap_or_else(|| {
            self.airs.push(None);
            self.airs.len() as u32 - 1
        });
        let mut hearers = self.spare.pop().unwrap_or_default();
        hearers.clear();
        self.links.hearers(&traffic.radio, &self.places, by, &mut self.fading, &mut hearers);
        let bits_per_s = 8.0 * bytes as f64 / airtime.as_secs();
        self.airs[number as usize] = Some(Air { by, since: now, cargo, rate, bits_per_s, overlapped: false, hearers });
        self.events.push(Reverse((now + airtime + traffic.times.propagation, Event::End(number))));
        self.receivers[usize::from(by)].stop();
        let view = &mut self.views[usize::from(by)];
        (view.sending, view.busy) = (Some(number), view.busy + 1);
        let frame = traffic.stations[usize::from(by)].queue.front();
        self.occupied.begin(now, cargo != Cargo::Frame || frame.is_some_and(|frame| frame.hop != Hop::Foreign));
        number
    }

    /// Lets the hearers of a transmission that has begun know of it.
    fn spread(&mut self, traffic: &mut Traffic<T>, now: Time, number: u32) {
        if self.alone != Some(number) {
            self.tell_receivers(number);
        }
        let air = self.airs[number as usize].as_mut().expect("a transmission on the air");
        let (by, hearers, mut overlapped) = (air.by, std::mem::take(&mut air.hearers), false);
        for hearer in hearers.iter().filter(|hearer| hearer.sensed && hearer.station != by) {
            let at = usize::from(hearer.station);
            let view = &mut self.views[at];
            if view.busy == 0 {
                let station = &mut traffic.stations[at];
                if station.counts_down() {
                    self.turns.set(at, None);
                    if let Some(slot) = view.slots(now, traffic.times.slot) {
                        station.pass(slot, traffic.radio.counting);
                    }
                }
            }
            view.busy += 1;
            if let Some(other) = view.sending {
                overlapped = true;
                self.airs[other as usize].iter_mut().for_each(|other| other.overlapped = true);
            }
        }
        let air = self.airs[number as usize].as_mut().expect("a transmission on the air");
        (air.hearers, air.overlapped) = (hearers, air.overlapped || overlapped);
    }

    /// Lets the receivers that a transmission reaches know that it has begun.
    fn tell_receivers(&mut self, number: u32) {
        let air = self.airs[number as usize].as_ref().expect("a transmission on the air");
        for hearer in air.hearers.iter().filter(|hearer| hearer.station != air.by && hearer.power > 0.0) {
            let at = usize::from(hearer.station);
            let sending = self.views[at].sending.is_some();
            let arrival = air.arrival(number, hearer.power);
            self.receivers[at].arrive(air.since, arrival, sending, &self.thresholds);
        }
    }
}

impl Air {
    /// Returns the transmission, which has this number, as it is at a receiver that it reaches with a power \[mW\].
    fn arrival(&self, air: u32, power: f64) -> Arrival {
        Arrival { air, power, rate: self.rate, bits_per_s: self.bits_per_s }
    }
}

impl Occupied {
    /// Counts that a transmission begins.
    fn begin(&mut self, now: Time, own: bool) {
        if self.number == 0 {
            *self = Occupied { since: now.max(self.until), until: self.until, own: false, number: 0 };
        }
        self.number += 1;
        self.own |= own;
    }

    /// Counts that a transmission ends, of which the medium is taken up to `until`.
    fn end<T>(&mut self, until: Time, traffic: &mut Traffic<T>) {
        self.until = self.until.max(until);
        self.number -= 1;
        if self.number == 0 {
            let counts = &mut traffic.counts;
            let time = if self.own { &mut counts.airtime_ns } else { &mut counts.foreign_ns };
            *time += self.until.as_nanos().saturating_sub(self.since.as_nanos());
        }
    }
}

/// Returns the station that acknowledges a unicast frame; `None` for multicast, and for frames of other networks.
fn receiver_of<T>(traffic: &Traffic<T>, frame: &QueuedFrame<T>) -> Option<u16> {
    match (frame.hop, &frame.to) {
        (Hop::Foreign | Hop::Beacon, _) => None,
        (Hop::Up, _) => Some(traffic.members),
        (_, Destination::One(to)) => Some(*to),
        (_, Destination::Many(_)) => None,
    }
}

/// Returns the position of each station of the channel.
fn places<T>(traffic: &Traffic<T>) -> impl Iterator<Item = Option<Vec2>> {
    let relay =
        (traffic.radio.channel == Topology::Infrastructure).then(|| traffic.radio.access_point_m.map(Vec2::from));
    let all = traffic.positions.iter().copied().chain(relay);
    all.chain(std::iter::repeat(None)).take(traffic.stations.len())
}
