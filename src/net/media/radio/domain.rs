//! A medium without space: all stations sense each other, so there are no hidden stations.
//!
//! Two stations that start in one slot collide, and neither frame is received; there is no capture effect. A range
//! keeps frames from receivers that are farther away, but not from being sensed.

use serde::{Deserialize, Serialize};

use super::station::{Destination, Hop, QueuedFrame, Station};
use super::traffic::{Delivery, Sent, Traffic};
use crate::random::RngExt;
use crate::time::{Span, Time};

/// Start and end of the transmission that is in progress; if several frames collide, the end is that of the longest.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct OnAir {
    since: Time,
    until: Time,
}

/// Medium that all stations of a channel sense alike (collision domain).
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Domain {
    on_air: Option<OnAir>,
    senders: Vec<usize>,
    /// Time from which stations count backoff slots: the medium is idle, and the interframe space after the last frame
    /// is over.
    free_at: Time,
    /// Whether all stations read each other, wherever they are when a frame ends.
    reads_all: bool,
}

impl Domain {
    /// Returns an idle medium at time zero.
    pub fn new<T>(traffic: &Traffic<T>) -> Domain {
        Domain { reads_all: false, ..Domain::idle_from(Time::ZERO + traffic.times.aifs) }
    }

    /// Returns an idle medium of stations that all read each other, which count backoff slots from `free_at` on.
    pub fn idle_from(free_at: Time) -> Domain {
        Domain { on_air: None, senders: Vec::new(), free_at, reads_all: true }
    }

    /// Returns the time from which stations count backoff slots, if they do at `now`: nothing is on the air, and the
    /// space after the last frame is over.
    pub fn idle_since(&self, now: Time) -> Option<Time> {
        (self.on_air.is_none() && self.free_at <= now).then_some(self.free_at)
    }

    /// Returns whether several stations begin at `now`, in one slot.
    pub fn collides_at<T: Clone>(&self, traffic: &Traffic<T>, now: Time) -> bool {
        let begins =
            |station: &Station<T>| station.slot().is_some_and(|slot| self.free_at + traffic.times.slot * slot <= now);
        self.on_air.is_none() && traffic.stations.iter().filter(|station| begins(station)).take(2).count() == 2
    }

    /// Queues a frame at a station; if its queue was empty, schedules its transmission.
    pub fn push<T: Clone>(&self, traffic: &mut Traffic<T>, now: Time, station: usize, frame: QueuedFrame<T>) {
        if !traffic.enqueue(station, frame) {
            return;
        }
        let at = &mut traffic.stations[station];
        if self.on_air.is_some() || now < self.free_at {
            at.ready_after(&mut traffic.backoff);
        } else {
            // Stations transmit at slot boundaries, however long the medium was idle (10.22.2.4).
            at.ready_at(now.since(self.free_at).as_nanos().div_ceil(traffic.times.slot.as_nanos()));
        }
    }

    /// Returns the time at which the next transmission begins or ends.
    pub fn due<T: Clone>(&self, traffic: &Traffic<T>) -> Option<Time> {
        match self.on_air {
            Some(on_air) => Some(on_air.until),
            None => {
                let slot = traffic.stations.iter().filter_map(Station::slot).min();
                slot.map(|slot| self.free_at + traffic.times.slot * slot)
            }
        }
    }

    /// Begins or ends, at time `now`, the transmission that is due then.
    pub fn wake<T: Clone>(&mut self, traffic: &mut Traffic<T>, now: Time, deliveries: &mut Vec<Delivery<T>>) {
        match self.on_air {
            Some(on_air) => self.end(traffic, on_air, deliveries),
            None => self.begin(traffic, now),
        }
    }

    /// Starts, at time `now`, the transmissions of all stations whose backoff ends in the slot that begins then.
    /// Updates the backoff of the other stations.
    fn begin<T: Clone>(&mut self, traffic: &mut Traffic<T>, now: Time) {
        let slot = now.since(self.free_at).as_nanos() / traffic.times.slot.as_nanos();
        self.senders.clear();
        let mut longest = Span::ZERO;
        for (at, station) in traffic.stations.iter_mut().enumerate() {
            if station.pass(slot, traffic.radio.counting) {
                let frame = station.queue.front().expect("a station that sends has a frame");
                longest = longest.max(frame.airtime(&traffic.radio));
                self.senders.push(at);
            }
        }
        self.on_air = Some(OnAir { since: now, until: now + longest + traffic.times.propagation });
    }

    /// Ends the transmission `on_air`. A single frame is received, unless noise or range prevents it; several frames
    /// have collided, and none is received. Appends the received frames to `deliveries`, and schedules retries.
    fn end<T: Clone>(&mut self, traffic: &mut Traffic<T>, on_air: OnAir, deliveries: &mut Vec<Delivery<T>>) {
        let OnAir { since, until } = on_air;
        let senders = std::mem::take(&mut self.senders);
        let collided = senders.len() > 1;
        let (mut own, mut idle) = (false, traffic.times.recovery);
        let mut taken = until.since(since);
        for &by in &senders {
            let frame = traffic.stations[by].queue.pop_front().expect("a station that has sent has a frame");
            if frame.hop != Hop::Foreign {
                own = true;
                let airtime = frame.airtime(&traffic.radio);
                traffic.count(&frame, Sent { by, since, airtime, collided });
            }
            let drawn: u32 = traffic.backoff.random();
            if !frame.unicast() {
                traffic.stations[by].done(&traffic.radio, drawn);
                if collided {
                    traffic.counts.lost_collision += frame.copies();
                    traffic.stations[by].counts.lost_collision += u64::from(frame.hop != Hop::Beacon);
                } else {
                    idle = traffic.times.aifs;
                    self.deliver_multicast(traffic, until, &frame, deliveries);
                }
            } else if !collided && self.receives(traffic, &frame) {
                let acknowledged = traffic.times.acknowledged;
                taken = taken + acknowledged;
                traffic.stations[by].counts.airtime_ns += acknowledged.as_nanos();
                idle = acknowledged + traffic.times.aifs;
                traffic.stations[by].done(&traffic.radio, drawn);
                if let Some(relayed) = traffic.receive(until, &frame, deliveries) {
                    self.push(traffic, until, usize::from(traffic.members), relayed);
                }
            } else {
                traffic.fail(by, frame, drawn);
            }
        }
        (self.senders, self.on_air) = (senders, None);
        self.free_at = until + idle;
        let time = if own { &mut traffic.counts.airtime_ns } else { &mut traffic.counts.foreign_ns };
        *time += taken.as_nanos();
    }

    /// Returns whether a frame of one station is in the range of another one.
    fn in_range<T: Clone>(&self, traffic: &Traffic<T>, from: u16, to: u16) -> bool {
        self.reads_all || traffic.in_range(from, to)
    }

    /// Returns whether the receiver of a unicast frame that did not collide can decode it: it is in range, and no noise
    /// corrupts the frame. True for frames of other networks.
    fn receives<T: Clone>(&self, traffic: &mut Traffic<T>, frame: &QueuedFrame<T>) -> bool {
        match (frame.hop, &frame.to) {
            (Hop::Foreign, _) => true,
            (Hop::Direct, Destination::One(to)) if !self.in_range(traffic, frame.from, *to) => false,
            _ => !traffic.lost_to_noise(),
        }
    }

    /// Delivers a multicast frame to each receiver, or counts its loss there.
    fn deliver_multicast<T: Clone>(
        &self,
        traffic: &mut Traffic<T>,
        at: Time,
        frame: &QueuedFrame<T>,
        deliveries: &mut Vec<Delivery<T>>,
    ) {
        let Destination::Many(listeners) = &frame.to else { unreachable!("a frame for one is unicast") };
        for &to in listeners.iter().filter(|&&to| to != frame.from) {
            if frame.hop == Hop::Direct && !self.in_range(traffic, frame.from, to) {
                traffic.miss_range(to);
            } else if traffic.lost_to_noise() {
                traffic.miss_noise(to);
            } else {
                traffic.deliver(at, frame, to, deliveries);
            }
        }
    }
}
