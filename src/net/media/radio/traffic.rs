//! Traffic of a radio channel: the queues of its stations, what came of their frames, and the counters of both. How the
//! stations share the medium is told elsewhere.

use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::counts::RadioCounts;
use super::station::{Destination, Hop, QueuedFrame, Station};
use super::{Radio, Times, Topology};
use crate::messages::geometry::Vec2;
use crate::random::{Seed, Stream, stored};
use crate::time::{Span, Time};

/// Length of the datagram in each simulated frame of other networks, which load the channel \[bytes\]. It is a full
/// Ethernet payload (IEEE 802.3, 3.2.7) less the IP and UDP headers, which are part of `OVERHEAD_BYTES`.
pub(super) const FOREIGN_BYTES: usize = 1500 - 28;

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

/// Station that a transmission reaches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reached {
    /// Index of the station.
    pub station: u16,
    /// Whether it can read the frame, if no other one spoils it; otherwise it senses that something is on the air.
    pub reads: bool,
}

/// Stations of a radio channel with their queues, and the counters of their frames.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Traffic<T> {
    pub radio: Radio,
    pub times: Times,
    /// Stations of the channel: first the members, which are the caller's stations; then the access point, if there is
    /// one; then a station that sends the frames of other networks, if they load the channel.
    pub stations: Vec<Station<T>>,
    pub members: u16,
    /// Position \[m\] of each member (station of the caller), by its index; a member without a position is within range
    /// of all.
    #[serde(with = "positions")]
    pub positions: Vec<Option<Vec2>>,
    #[serde(with = "stored")]
    pub backoff: Stream,
    #[serde(with = "stored")]
    noise: Stream,
    pub counts: RadioCounts,
    /// Transmissions since the caller has last asked for them; `None` if they are not recorded.
    pub transmissions: Option<Vec<Transmission<T>>>,
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

/// Transmission that has ended on a medium, to be counted.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sent {
    /// Index of the station that has transmitted.
    pub by: usize,
    /// Time at which the transmission began.
    pub since: Time,
    /// Time that the frame took on the air.
    pub airtime: Span,
    /// Whether another frame prevented that it was read.
    pub collided: bool,
}

impl<T: Clone> Traffic<T> {
    /// Returns idle stations: `members` of the caller, and those that the parameters add.
    pub fn new(radio: Radio, members: u16, seed: &Seed) -> Traffic<T> {
        let relays = usize::from(radio.channel == Topology::Infrastructure);
        let all = usize::from(members) + relays + usize::from(radio.background > 0.0);
        Traffic {
            times: radio.times(),
            stations: (0..all).map(|_| Station::new(&radio)).collect(),
            members,
            positions: vec![None; usize::from(members)],
            backoff: seed.stream("backoff"),
            noise: seed.stream("noise"),
            counts: RadioCounts::default(),
            transmissions: None,
            radio,
        }
    }

    /// Returns whether a frame of one station is in the range of another one.
    pub fn in_range(&self, from: u16, to: u16) -> bool {
        let Some(range_m) = self.radio.range_m else { return true };
        match (self.positions[usize::from(from)], self.positions[usize::from(to)]) {
            (Some(from), Some(to)) => (to - from).norm_squared() <= range_m * range_m,
            _ => true,
        }
    }

    /// Returns whom a transmission of the station `from` reaches if all stations sense each other.
    pub fn reached(&self, from: u16) -> Vec<Reached> {
        let others = (0..self.members).filter(|station| *station != from);
        others.map(|station| Reached { station, reads: self.in_range(from, station) }).collect()
    }

    /// Puts a frame into the transmit queue of the station with index `station`; counts it as lost if the queue is
    /// full. Returns whether the queue was empty before.
    pub fn enqueue(&mut self, station: usize, frame: QueuedFrame<T>) -> bool {
        let at = &mut self.stations[station];
        at.counts.offered += 1;
        if at.queue.len() >= self.radio.queue {
            self.counts.lost_queue += frame.copies();
            at.counts.lost_queue += 1;
            return false;
        }
        at.queue.push_back(frame);
        at.queue.len() == 1
    }

    /// Counts a transmission of `frame`, and records it if transmissions are recorded.
    pub fn count(&mut self, frame: &QueuedFrame<T>, sent: Sent) {
        let Sent { by, since, airtime, collided } = sent;
        self.counts.transmissions += 1;
        self.counts.collided += u64::from(collided);
        let station = &mut self.stations[by];
        let retry = station.failures();
        station.counts.transmissions += 1;
        station.counts.retries += u64::from(retry > 0);
        station.counts.collided += u64::from(collided);
        station.counts.airtime_ns += airtime.as_nanos();
        if let (Some(all), Some(token)) = (&mut self.transmissions, &frame.token) {
            all.push(Transmission {
                since,
                until: since + airtime,
                by: by as u16,
                from: frame.from,
                to: frame.to.clone(),
                unicast: frame.unicast(),
                retry,
                collided,
                token: token.clone(),
            });
        }
    }

    /// Ends a unicast frame of the station `by` without an acknowledgement: it is sent again, or lost. The backoff
    /// follows from the random number `drawn`.
    pub fn fail(&mut self, by: usize, frame: QueuedFrame<T>, drawn: u32) {
        if let Some(dropped) = self.stations[by].failed(frame, &self.radio, drawn) {
            self.counts.lost_retries += dropped.copies();
            self.stations[by].counts.lost_retries += u64::from(!dropped.received);
        }
    }

    /// Returns whether noise corrupts a frame at one receiver.
    pub fn lost_to_noise(&mut self) -> bool {
        self.radio.noise_loss > 0.0 && self.noise.random_bool(self.radio.noise_loss)
    }

    /// Counts a copy of a multicast frame that the receiver `to` is too far away to read.
    pub fn miss_range(&mut self, to: u16) {
        self.counts.lost_range += 1;
        self.stations[usize::from(to)].counts.missed_range += 1;
    }

    /// Counts a copy of a multicast frame that noise corrupts at the receiver `to`.
    pub fn miss_noise(&mut self, to: u16) {
        self.counts.lost_noise += 1;
        self.stations[usize::from(to)].counts.missed_noise += 1;
    }

    /// Delivers a frame to the caller's station `to`.
    pub fn deliver(&mut self, at: Time, frame: &QueuedFrame<T>, to: u16, deliveries: &mut Vec<Delivery<T>>) {
        self.counts.arrived += 1;
        self.stations[usize::from(to)].counts.received += 1;
        let token = frame.token.clone().expect("frames of other networks are not delivered");
        deliveries.push(Delivery { at, from: frame.from, to, token });
    }

    /// Hands a unicast frame on that its receiver has read at time `at`: to the caller, or back for its way from the
    /// access point on.
    pub fn receive(
        &mut self,
        at: Time,
        frame: &QueuedFrame<T>,
        deliveries: &mut Vec<Delivery<T>>,
    ) -> Option<QueuedFrame<T>> {
        match (frame.hop, &frame.to) {
            _ if frame.received => None,
            (Hop::Foreign | Hop::Beacon, _) => None,
            (Hop::Up, _) => Some(QueuedFrame { hop: Hop::Down, ..frame.clone() }),
            (_, Destination::One(to)) => {
                self.deliver(at, frame, *to, deliveries);
                None
            }
            (_, Destination::Many(_)) => unreachable!("a frame for many is unicast on its way up alone"),
        }
    }
}
