//! A channel that stations share by the distributed coordination function (IEEE 802.11-2016, 10.3).
//!
//! The simulation is event-driven: time advances from one transmission to the next, however many idle slots lie
//! between. All stations sense each other, so there are no hidden terminals. Two stations that start in one slot
//! collide, and neither frame is received; there is no capture effect. A study runs a channel by itself, and an
//! emulated link runs one inside an actor.

use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::counts::{RadioCounts, StationCounts};
pub use super::station::Destination;
use super::station::{Hop, QueuedFrame, Station};
use super::{Radio, Times, Topology};
use crate::messages::geometry::Vec2;
use crate::random;
use crate::random::{Seed, Stream, stored};
use crate::time::{Span, Time};

/// Length of the datagram in each simulated frame of other networks, which load the channel \[bytes\]. It is a full
/// Ethernet payload (IEEE 802.3, 3.2.7) less the IP and UDP headers, which are part of `OVERHEAD_BYTES`.
const FOREIGN_BYTES: usize = 1500 - 28;

/// Frame that a station of a radio channel has received.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delivery<T> {
    /// Time at which the last bit of the frame arrived.
    pub at: Time,
    /// Index of the station that sent the frame.
    pub from: u16,
    /// Index of the station that received the frame.
    pub to: u16,
    /// The caller's payload, a copy of the one given when the frame was offered.
    pub token: T,
}

/// Frame that a station of a radio channel, or its access point, has transmitted, as a monitor sees it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Transmission<T> {
    /// Time at which the transmission began.
    pub since: Time,
    /// Time at which the frame's last bit was sent.
    pub until: Time,
    /// Index of the transmitting station. An access point has the index after the last member.
    pub by: u16,
    /// Index of the station that offered the frame.
    pub from: u16,
    /// Final receivers of the frame.
    pub to: Destination,
    /// Whether this transmission is addressed to one receiver, which acknowledges it: the final one or an access point.
    pub unicast: bool,
    /// Number of earlier transmissions of the same frame by this station.
    pub retry: u32,
    /// Whether another frame was transmitted at the same time, so that neither could be read.
    pub collided: bool,
    /// Payload with which the caller offered the frame to the channel.
    pub token: T,
}

/// Start and end of the transmission that is in progress; if several frames collide, the end is that of the longest.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct OnAir {
    since: Time,
    until: Time,
}

/// Simulated radio channel of IEEE 802.11 with its stations, which contend for the medium. Stations have indices from
/// zero. `T` is the caller's payload, which a frame carries to its receivers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Channel<T> {
    radio: Radio,
    times: Times,
    /// Stations of the channel: first the members, which are the caller's stations; then the access point, if there is
    /// one; then a station that sends the frames of other networks, if they load the channel.
    stations: Vec<Station<T>>,
    members: u16,
    /// Position \[m\] of each member (station of the caller), by its index; a member without a position is within range
    /// of all.
    #[serde(with = "positions")]
    positions: Vec<Option<Vec2>>,
    on_air: Option<OnAir>,
    senders: Vec<usize>,
    /// Time from which stations count backoff slots: the medium is idle, and the interframe space after the last frame
    /// is over.
    free_at: Time,
    due: Option<Time>,
    foreign_due: Option<Time>,
    foreign_gap_s: f64,
    #[serde(with = "stored")]
    backoff: Stream,
    #[serde(with = "stored")]
    noise: Stream,
    #[serde(with = "stored")]
    foreign: Stream,
    counts: RadioCounts,
    /// Transmissions since the last call of `transmissions`; `None` if they are not recorded.
    transmissions: Option<Vec<Transmission<T>>>,
}

/// Stores positions as pairs of numbers.
mod positions {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use crate::messages::geometry::{Planar, Vec2};

    pub fn serialize<S: Serializer>(positions: &[Option<Vec2>], to: S) -> Result<S::Ok, S::Error> {
        let pairs = positions.iter().map(|position| position.as_ref().map(Planar::to_array));
        pairs.collect::<Vec<Option<[f32; 2]>>>().serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<Option<Vec2>>, D::Error> {
        let pairs = Vec::<Option<[f32; 2]>>::deserialize(from)?;
        Ok(pairs.into_iter().map(|pair| pair.map(Vec2::from)).collect())
    }
}

impl<T: Clone> Channel<T> {
    /// Returns a channel at time zero with the parameters `radio` and `members` idle stations, of the indices 0 to
    /// `members` - 1. An access point and the load by other networks are added if the parameters say so. All random
    /// numbers are drawn from streams of `seed`.
    ///
    /// The parameters must have passed `Radio::check`; otherwise this function or a later call may panic.
    pub fn new(radio: Radio, members: u16, seed: &Seed) -> Channel<T> {
        let relays = usize::from(radio.channel == Topology::Infrastructure);
        let all = usize::from(members) + relays + usize::from(radio.background > 0.0);
        let times = radio.times();
        let taken = radio.frame_airtime(FOREIGN_BYTES) + times.propagation + times.acknowledged;
        let mut channel = Channel {
            times,
            stations: (0..all).map(|_| Station::new(&radio)).collect(),
            members,
            positions: vec![None; usize::from(members)],
            on_air: None,
            senders: Vec::new(),
            free_at: Time::ZERO + times.aifs,
            due: None,
            foreign_due: None,
            foreign_gap_s: taken.as_secs() / radio.background,
            backoff: seed.stream("backoff"),
            noise: seed.stream("noise"),
            foreign: seed.stream("foreign"),
            counts: RadioCounts::default(),
            transmissions: None,
            radio,
        };
        if channel.radio.background > 0.0 {
            channel.foreign_due = Some(channel.next_foreign(Time::ZERO));
        }
        channel.plan();
        channel
    }

    /// Queues a datagram of `bytes` bytes at the station `from` at time `now`, for the receivers `to`. Each delivery
    /// carries a copy of `token`. The datagram is lost if the station's queue is full.
    ///
    /// # Panics
    /// If `now` is later than `wake_at`: then call `wake` first.
    pub fn offer(&mut self, now: Time, from: u16, to: Destination, bytes: usize, token: T) {
        assert!(self.due.is_none_or(|due| now <= due), "wake the channel before offering more");
        let frame = self.frame(from, to, bytes, token);
        self.counts.offered += 1;
        self.counts.wanted += frame.copies();
        self.push(now, usize::from(from), frame);
        self.plan();
    }

    /// Saturates the station `from`: from time `now` on, it always has a datagram of `bytes` bytes for the receivers
    /// `to` to send. Each delivery carries a copy of `token`.
    ///
    /// # Panics
    /// If `now` is later than `wake_at`: then call `wake` first.
    pub fn saturate(&mut self, now: Time, from: u16, to: Destination, bytes: usize, token: T) {
        self.stations[usize::from(from)].refill = Some(self.frame(from, to.clone(), bytes, token.clone()));
        self.offer(now, from, to, bytes, token);
    }

    /// Sets the position \[m\] of the station with index `station`, world frame. A station without a position is within
    /// range of all.
    pub fn place(&mut self, station: u16, position: Vec2) {
        self.positions[usize::from(station)] = Some(position);
    }

    /// Returns the counters of frames and airtime from time zero to `now`, the present time.
    pub fn counts(&self, now: Time) -> RadioCounts {
        RadioCounts { channel_ns: now.as_nanos(), ..self.counts }
    }

    /// Returns the counters of the station with index `station` since time zero; those of the access point have the
    /// index after the last member.
    ///
    /// # Panics
    /// If there is no such station.
    pub fn station_counts(&self, station: u16) -> StationCounts {
        self.stations[usize::from(station)].counts
    }

    /// Records every transmission from now on, for `transmissions`.
    pub fn record_transmissions(&mut self) {
        self.transmissions.get_or_insert_default();
    }

    /// Returns the recorded transmissions since the last call, in the order of their ends, without frames of other
    /// networks.
    pub fn transmissions(&mut self) -> Vec<Transmission<T>> {
        self.transmissions.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Returns the time at which `wake` is next due; `None` if nothing is to be sent.
    pub fn wake_at(&self) -> Option<Time> {
        self.due
    }

    /// Runs the channel up to time `now`, and appends the received frames to `deliveries` in the order of arrival.
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

    fn frame(&self, from: u16, to: Destination, bytes: usize, token: T) -> QueuedFrame<T> {
        let hop = if self.radio.channel == Topology::Infrastructure { Hop::Up } else { Hop::Direct };
        QueuedFrame { hop, from, to, bytes, token: Some(token) }
    }

    fn next_foreign(&mut self, now: Time) -> Time {
        now + Span::from_secs(random::exponential(&mut self.foreign) * self.foreign_gap_s)
    }

    fn push_foreign(&mut self, now: Time) {
        let frame =
            QueuedFrame { hop: Hop::Foreign, from: 0, to: Destination::One(0), bytes: FOREIGN_BYTES, token: None };
        self.push(now, self.stations.len() - 1, frame);
    }

    /// Puts a frame into the transmit queue of the station with index `station`; counts it as lost if the queue is
    /// full. If the queue was empty, schedules the station's transmission.
    fn push(&mut self, now: Time, station: usize, frame: QueuedFrame<T>) {
        let at = &mut self.stations[station];
        at.counts.offered += 1;
        if at.queue.len() >= self.radio.queue {
            self.counts.lost_queue += frame.copies();
            at.counts.lost_queue += 1;
            return;
        }
        at.queue.push_back(frame);
        if at.queue.len() > 1 {
            return;
        }
        if self.on_air.is_some() || now < self.free_at {
            at.ready_after(&mut self.backoff);
        } else {
            // Stations transmit at slot boundaries, however long the medium was idle (10.22.2.4).
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

    /// Starts, at time `now`, the transmissions of all stations whose backoff ends in the slot that begins then.
    /// Updates the backoff of the other stations.
    fn begin(&mut self, now: Time) {
        let slot = now.since(self.free_at).as_nanos() / self.times.slot.as_nanos();
        self.senders.clear();
        let mut longest = Span::ZERO;
        for (at, station) in self.stations.iter_mut().enumerate() {
            if station.pass(slot, self.radio.counting) {
                let frame = station.queue.front().expect("a station that sends has a frame");
                longest = longest.max(frame.airtime(&self.radio));
                self.senders.push(at);
            }
        }
        self.on_air = Some(OnAir { since: now, until: now + longest + self.times.propagation });
    }

    /// Ends the transmission `on_air`. A single frame is received, unless noise or range prevents it; several frames
    /// have collided, and none is received. Appends the received frames to `deliveries`, and schedules retries.
    fn end(&mut self, on_air: OnAir, deliveries: &mut Vec<Delivery<T>>) {
        let OnAir { since, until } = on_air;
        let senders = std::mem::take(&mut self.senders);
        let collision = senders.len() > 1;
        let (mut own, mut idle) = (false, self.times.recovery);
        let mut taken = until.since(since);
        for &at in &senders {
            let frame = self.stations[at].queue.pop_front().expect("a station that has sent has a frame");
            if frame.hop != Hop::Foreign {
                own = true;
                self.count_transmission(at, &frame, since, collision);
            }
            if !frame.unicast() {
                self.stations[at].done(&self.radio, &mut self.backoff);
                if collision {
                    self.counts.lost_collision += frame.copies();
                    self.stations[at].counts.lost_collision += 1;
                } else {
                    idle = self.times.aifs;
                    self.deliver_multicast(until, &frame, deliveries);
                }
            } else if !collision && self.receives(&frame) {
                taken = taken + self.times.acknowledged;
                self.stations[at].counts.airtime_ns += self.times.acknowledged.as_nanos();
                idle = self.times.acknowledged + self.times.aifs;
                self.stations[at].done(&self.radio, &mut self.backoff);
                self.receive_unicast(until, frame, deliveries);
            } else if let Some(dropped) = self.stations[at].failed(frame, &self.radio, &mut self.backoff) {
                self.counts.lost_retries += dropped.copies();
                self.stations[at].counts.lost_retries += 1;
            }
        }
        (self.senders, self.on_air) = (senders, None);
        self.free_at = until + idle;
        let time = if own { &mut self.counts.airtime_ns } else { &mut self.counts.foreign_ns };
        *time += taken.as_nanos();
    }

    /// Counts a transmission of `frame` by the station with index `at`, and records it if transmissions are recorded.
    fn count_transmission(&mut self, at: usize, frame: &QueuedFrame<T>, since: Time, collided: bool) {
        self.counts.transmissions += 1;
        self.counts.collided += u64::from(collided);
        let airtime = frame.airtime(&self.radio);
        let station = &mut self.stations[at];
        let retry = station.failures();
        station.counts.transmissions += 1;
        station.counts.retries += u64::from(retry > 0);
        station.counts.collided += u64::from(collided);
        station.counts.airtime_ns += airtime.as_nanos();
        if let (Some(all), Some(token)) = (&mut self.transmissions, &frame.token) {
            all.push(Transmission {
                since,
                until: since + airtime,
                by: at as u16,
                from: frame.from,
                to: frame.to.clone(),
                unicast: frame.unicast(),
                retry,
                collided,
                token: token.clone(),
            });
        }
    }

    /// Returns whether the receiver of a unicast frame that did not collide can decode it: it is in range, and no noise
    /// corrupts the frame. True for frames of other networks.
    fn receives(&mut self, frame: &QueuedFrame<T>) -> bool {
        match (frame.hop, &frame.to) {
            (Hop::Foreign, _) => true,
            (Hop::Direct, Destination::One(to)) if !self.in_range(frame.from, *to) => false,
            _ => !self.lost_to_noise(),
        }
    }

    fn lost_to_noise(&mut self) -> bool {
        self.radio.noise_loss > 0.0 && self.noise.random_bool(self.radio.noise_loss)
    }

    fn in_range(&self, from: u16, to: u16) -> bool {
        let Some(range_m) = self.radio.range_m else { return true };
        match (self.positions[usize::from(from)], self.positions[usize::from(to)]) {
            (Some(from), Some(to)) => (to - from).norm_squared() <= range_m * range_m,
            _ => true,
        }
    }

    /// Handles a unicast frame at its receiver: an access point queues it for its second transmission, and a station
    /// delivers it to the caller.
    fn receive_unicast(&mut self, at: Time, frame: QueuedFrame<T>, deliveries: &mut Vec<Delivery<T>>) {
        match (frame.hop, &frame.to) {
            (Hop::Foreign, _) => {}
            (Hop::Up, _) => {
                self.push(at, usize::from(self.members), QueuedFrame { hop: Hop::Down, ..frame });
            }
            (_, Destination::One(to)) => self.deliver(at, frame.from, *to, frame.token.as_ref(), deliveries),
            (_, Destination::Many(_)) => unreachable!("a frame for many is unicast on its way up alone"),
        }
    }

    /// Delivers a multicast frame to each receiver, or counts its loss there.
    fn deliver_multicast(&mut self, at: Time, frame: &QueuedFrame<T>, deliveries: &mut Vec<Delivery<T>>) {
        let Destination::Many(listeners) = &frame.to else { unreachable!("a frame for one is unicast") };
        for &to in listeners.iter().filter(|&&to| to != frame.from) {
            if frame.hop == Hop::Direct && !self.in_range(frame.from, to) {
                self.counts.lost_range += 1;
                self.stations[usize::from(to)].counts.missed_range += 1;
            } else if self.lost_to_noise() {
                self.counts.lost_noise += 1;
                self.stations[usize::from(to)].counts.missed_noise += 1;
            } else {
                self.deliver(at, frame.from, to, frame.token.as_ref(), deliveries);
            }
        }
    }

    fn deliver(&mut self, at: Time, from: u16, to: u16, token: Option<&T>, deliveries: &mut Vec<Delivery<T>>) {
        self.counts.arrived += 1;
        self.stations[usize::from(to)].counts.received += 1;
        let token = token.expect("frames of other networks are not delivered").clone();
        deliveries.push(Delivery { at, from, to, token });
    }
}
