//! A radio channel that stations share by the distributed coordination function (IEEE 802.11-2016, 10.3).
//!
//! The simulation is event-driven: time advances from one transmission to the next, however many idle slots lie
//! between. A study runs a channel by itself, and an emulated link runs one inside an actor.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::counts::{RadioCounts, StationCounts};
use super::domain::Domain;
use super::field::Field;
pub use super::station::Destination;
use super::station::{Hop, QueuedFrame};
pub use super::traffic::{Delivery, Reached, Transmission};
use super::traffic::{FOREIGN_BYTES, Traffic};
use super::{Radio, Topology};
use crate::messages::geometry::Vec2;
use crate::random::{self, RngExt, Seed, Stream, stored};
use crate::time::{Span, Time};

/// Length of the body of a beacon \[bytes\]: time stamp, interval and capabilities 12, and elements of a network
/// without encryption (IEEE 802.11-2016, 9.3.3.3).
const BEACON_BYTES: usize = 90;

/// Medium that the stations of a channel share.
#[derive(Clone, Debug, Serialize, Deserialize)]
enum Medium<T> {
    /// All stations sense each other.
    Shared(Domain),
    /// Each station has its own view.
    Space(Box<Field<T>>),
}

/// Simulated radio channel of IEEE 802.11 with its stations, which contend for the medium. Stations have indices from
/// zero. `T` is the caller's payload, which a frame carries to its receivers.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Channel<T> {
    traffic: Traffic<T>,
    medium: Medium<T>,
    due: Option<Time>,
    foreign_due: Option<Time>,
    foreign_gap_s: f64,
    #[serde(with = "stored")]
    foreign: Stream,
    beacon_due: Option<Time>,
    #[serde(with = "stored")]
    beacons: Stream,
}

impl<T: Clone> Channel<T> {
    /// Returns a channel at time zero with the parameters `radio` and `members` idle stations, of the indices 0 to
    /// `members` - 1. An access point and the load by other networks are added if the parameters say so. All random
    /// numbers are drawn from streams of `seed`.
    ///
    /// The parameters must have passed `Radio::check`; otherwise this function or a later call may panic.
    pub fn new(radio: Radio, members: u16, seed: &Seed) -> Channel<T> {
        let traffic: Traffic<T> = Traffic::new(radio, members, seed);
        let (radio, times) = (&traffic.radio, &traffic.times);
        let taken = radio.frame_airtime(FOREIGN_BYTES) + times.propagation + times.acknowledged;
        let mut channel = Channel {
            medium: if radio.has_space() {
                Medium::Space(Box::new(Field::new(&traffic, seed)))
            } else {
                Medium::Shared(Domain::new(&traffic))
            },
            due: None,
            foreign_due: None,
            foreign_gap_s: taken.as_secs() / radio.background,
            foreign: seed.stream("foreign"),
            beacon_due: (radio.beacon_ms > 0.0 && members > 0).then(|| Time::ZERO + beacon_period(radio)),
            beacons: seed.stream("beacons"),
            traffic,
        };
        if channel.traffic.radio.background > 0.0 {
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
        self.traffic.counts.offered += 1;
        self.traffic.counts.wanted += frame.copies();
        self.push(now, usize::from(from), frame);
        self.plan();
    }

    /// Saturates the station `from`: from time `now` on, it always has a datagram of `bytes` bytes for the receivers
    /// `to` to send. Each delivery carries a copy of `token`.
    ///
    /// # Panics
    /// If `now` is later than `wake_at`: then call `wake` first.
    pub fn saturate(&mut self, now: Time, from: u16, to: Destination, bytes: usize, token: T) {
        self.traffic.stations[usize::from(from)].refill = Some(self.frame(from, to.clone(), bytes, token.clone()));
        self.offer(now, from, to, bytes, token);
    }

    /// Sets the position \[m\] of the station with index `station`, world frame. A station without a position is within
    /// range of all.
    pub fn place(&mut self, station: u16, position: Vec2) {
        let at = &mut self.traffic.positions[usize::from(station)];
        if *at != Some(position) {
            *at = Some(position);
            if let Medium::Space(field) = &mut self.medium {
                field.moved();
            }
        }
    }

    /// Returns whom a transmission of the station `from` reaches, itself left out, by the paths alone: shadowing and
    /// fading come to that.
    pub fn reached(&self, from: u16) -> Vec<Reached> {
        match &self.medium {
            Medium::Shared(_) => self.traffic.reached(from),
            Medium::Space(field) => field.reached(&self.traffic, from),
        }
    }

    /// Sets the walls that weaken frames which cross them, as the corners of their outlines \[m\], world frame; two for
    /// a line. They matter if the parameters have a loss for walls.
    pub fn wall_in(&mut self, walls: Vec<Vec<[f32; 2]>>) {
        if let Medium::Space(field) = &mut self.medium {
            field.wall_in(walls);
        }
    }

    /// Returns the counters of frames and airtime from time zero to `now`, the present time.
    pub fn counts(&self, now: Time) -> RadioCounts {
        RadioCounts { channel_ns: now.as_nanos(), ..self.traffic.counts }
    }

    /// Returns the counters of the station with index `station` since time zero; those of the access point have the
    /// index after the last member.
    ///
    /// # Panics
    /// If there is no such station.
    pub fn station_counts(&self, station: u16) -> StationCounts {
        self.traffic.stations[usize::from(station)].counts
    }

    /// Records every transmission from now on, for `transmissions`.
    pub fn record_transmissions(&mut self) {
        self.traffic.transmissions.get_or_insert_default();
    }

    /// Returns the recorded transmissions since the last call, in the order of their ends, without frames of other
    /// networks and beacons.
    pub fn transmissions(&mut self) -> Vec<Transmission<T>> {
        self.traffic.transmissions.as_mut().map(std::mem::take).unwrap_or_default()
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
            } else if self.beacon_due == Some(due) {
                self.beacon_due = Some(due + beacon_period(&self.traffic.radio));
                self.push_beacon(due);
            } else {
                match &mut self.medium {
                    Medium::Shared(domain) => domain.wake(&mut self.traffic, due, deliveries),
                    Medium::Space(field) => field.wake(&mut self.traffic, due, deliveries),
                }
            }
            self.plan();
        }
    }

    fn frame(&self, from: u16, to: Destination, bytes: usize, token: T) -> QueuedFrame<T> {
        let hop = if self.traffic.radio.channel == Topology::Infrastructure { Hop::Up } else { Hop::Direct };
        QueuedFrame { hop, from, to, bytes, token: Some(token), received: false }
    }

    fn next_foreign(&mut self, now: Time) -> Time {
        now + Span::from_secs(random::exponential(&mut self.foreign) * self.foreign_gap_s)
    }

    fn push_foreign(&mut self, now: Time) {
        let to = Destination::One(0);
        let frame = QueuedFrame { hop: Hop::Foreign, from: 0, to, bytes: FOREIGN_BYTES, token: None, received: false };
        self.push(now, self.traffic.stations.len() - 1, frame);
    }

    fn push_beacon(&mut self, now: Time) {
        let members = self.traffic.members;
        let from = match self.traffic.radio.channel {
            Topology::Infrastructure => members,
            Topology::AdHoc => self.beacons.random_range(0..members),
        };
        let to = Destination::Many(Arc::new([]));
        // A beacon has no headers of LLC, IP and UDP.
        let bytes = (BEACON_BYTES + super::BEACON_OVERHEAD_BYTES).saturating_sub(self.traffic.radio.overhead_bytes);
        let frame = QueuedFrame { hop: Hop::Beacon, from, to, bytes, token: None, received: false };
        self.push(now, usize::from(from), frame);
    }

    fn push(&mut self, now: Time, station: usize, frame: QueuedFrame<T>) {
        match &mut self.medium {
            Medium::Shared(domain) => domain.push(&mut self.traffic, now, station, frame),
            Medium::Space(field) => field.push(&mut self.traffic, now, station, frame),
        }
    }

    fn plan(&mut self) {
        let next = match &self.medium {
            Medium::Shared(domain) => domain.due(&self.traffic),
            Medium::Space(field) => field.due(&self.traffic),
        };
        self.due = [next, self.foreign_due, self.beacon_due].into_iter().flatten().min();
    }
}

/// Returns the time from one beacon to the next.
fn beacon_period(radio: &Radio) -> Span {
    Span::from_secs(1e-3 * radio.beacon_ms)
}
