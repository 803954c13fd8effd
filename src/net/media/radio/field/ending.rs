//! Ends of transmissions in a field: what was read where, what becomes of the frame, and who may count slots again.

use std::cmp::Reverse;

use super::{Air, Awaited, CERTAIN, Cargo, Event, Field, Outcome, Reception, receiver_of};
use crate::net::media::radio::links::Hearer;
use crate::net::media::radio::rate::Rate;
use crate::net::media::radio::receiver::Read;
use crate::net::media::radio::station::{Destination, Hop, QueuedFrame};
use crate::net::media::radio::traffic::{Delivery, Sent, Traffic};
use crate::net::media::radio::{ACK_BYTES, Radio, Times};
use crate::random::RngExt;
use crate::time::{Span, Time};

/// Acknowledgement after a transmission, as those expect it who have read the transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Answer {
    /// There is none after such a transmission.
    None,
    /// The receiver has not read the frame, and will send none.
    Missing,
    /// It is on the air up to this time.
    Until(Time),
}

impl<T: Clone> Field<T> {
    /// Ends a transmission: hands on what was read, and lets its hearers know.
    pub(super) fn end(&mut self, traffic: &mut Traffic<T>, now: Time, number: u32, deliveries: &mut Vec<Delivery<T>>) {
        let air = self.airs[number as usize].take().expect("a transmission on the air");
        self.views[usize::from(air.by)].sending = None;
        self.receptions.clear();
        self.receptions.resize(traffic.stations.len(), Reception::Far);
        let alone = self.alone.take_if(|alone| *alone == number).is_some();
        for hearer in air.hearers.iter().filter(|hearer| hearer.station != air.by && hearer.power > 0.0) {
            let at = usize::from(hearer.station);
            let read = if alone {
                self.thresholds.undisturbed(air.since, now, air.arrival(number, hearer.power))
            } else {
                self.receivers[at].leave(now, number, &self.thresholds)
            };
            self.receptions[at] = self.received(read, *hearer);
        }
        let (answer, relayed) = match air.cargo {
            Cargo::Acknowledgement(to) => {
                self.acknowledged(traffic, usize::from(to));
                (Answer::None, None)
            }
            Cargo::Frame => self.end_frame(traffic, now, (&air, alone), deliveries),
        };
        self.occupied.end(if let Answer::Until(until) = answer { until } else { now }, traffic);
        self.let_know(traffic, now, &air, answer);
        if let Some(relayed) = relayed {
            self.push(traffic, now, usize::from(traffic.members), relayed);
        }
        self.spare.push(air.hearers);
        self.idle_airs.push(number);
    }

    /// Ends the transmission of the frame at the front of its sender's queue; `alone` says whether nothing else was on
    /// the air meanwhile. Returns what hearers expect after it, and
    /// the frame that an access point has to relay.
    fn end_frame(
        &mut self,
        traffic: &mut Traffic<T>,
        now: Time,
        (air, alone): (&Air, bool),
        deliveries: &mut Vec<Delivery<T>>,
    ) -> (Answer, Option<QueuedFrame<T>>) {
        let by = usize::from(air.by);
        let frame = traffic.stations[by].queue.pop_front().expect("a station that has sent has a frame");
        let missed = if alone { 0 } else { self.missed(traffic, &frame) };
        if frame.hop != Hop::Foreign {
            let airtime = now.since(air.since) - traffic.times.propagation;
            let unwanted = !frame.unicast() && frame.copies() == 0;
            let collided = missed > 0 || air.overlapped && unwanted;
            traffic.count(&frame, Sent { by, since: air.since, airtime, collided });
        }
        if !frame.unicast() {
            self.deliver_multicast(traffic, now, &frame, deliveries);
            traffic.stations[by].queue.push_front(frame);
            self.outcomes[by] = Some(Outcome::Done);
            return (Answer::None, None);
        }
        if !self.receives(traffic, &frame, air.overlapped) {
            traffic.stations[by].queue.push_front(frame);
            self.outcomes[by] = Some(Outcome::Failed);
            return (Answer::Missing, None);
        }
        let (rate, took) = answer(&traffic.radio, &traffic.times, air.rate);
        traffic.stations[by].counts.airtime_ns += took.as_nanos();
        let relayed = traffic.receive(now, &frame, deliveries);
        self.promise(traffic, now, by, frame, rate);
        (Answer::Until(now + took), relayed)
    }

    /// Lets the hearers of a transmission that has ended know of it, and of the acknowledgement after it.
    fn let_know(&mut self, traffic: &mut Traffic<T>, now: Time, air: &Air, answer: Answer) {
        for hearer in &air.hearers {
            let at = usize::from(hearer.station);
            let (is_sender, reception) = (hearer.station == air.by, self.receptions[at]);
            let view = &mut self.views[at];
            if let Answer::Until(until) = answer
                && (is_sender || reception == Reception::Read)
            {
                view.reserved = view.reserved.max(until);
            }
            if !hearer.sensed {
                // Read, though too weak to be sensed: the reservation holds all the same.
                if view.busy == 0 && view.free_at < view.reserved + traffic.times.aifs {
                    view.free_at = view.reserved + traffic.times.aifs;
                    self.plan(traffic, at);
                }
                continue;
            }
            match reception {
                _ if is_sender => view.unread |= answer == Answer::Missing,
                Reception::Read => view.unread = answer == Answer::Missing,
                Reception::Far => {}
                Reception::Faded | Reception::Collided => view.unread = true,
            }
            view.busy -= 1;
            if view.busy == 0 {
                self.idle(traffic, now, at);
            }
        }
    }

    /// Returns what comes of a transmission that ends at a station which has read it so, or not at all.
    #[inline]
    fn received(&mut self, read: Option<Read>, hearer: Hearer) -> Reception {
        match read {
            Some(read) => {
                let share = if read.ln_read == 0.0 { 1.0 } else { libm::exp(read.ln_read) };
                if share > CERTAIN || self.reading.random::<f64>() < share {
                    Reception::Read
                } else if read.alone {
                    Reception::Faded
                } else {
                    Reception::Collided
                }
            }
            None if self.thresholds.hears(hearer.power) => Reception::Collided,
            None => Reception::Far,
        }
    }

    /// Returns how many of the receivers of a frame could not read it for another frame.
    fn missed(&self, traffic: &Traffic<T>, frame: &QueuedFrame<T>) -> usize {
        let collided = |to: u16| self.receptions[usize::from(to)] == Reception::Collided;
        match (receiver_of(traffic, frame), &frame.to) {
            (Some(to), _) => usize::from(collided(to)),
            (None, Destination::Many(all)) => all.iter().filter(|&&to| to != frame.from && collided(to)).count(),
            (None, Destination::One(_)) => 0,
        }
    }

    /// Returns whether the receiver of a unicast frame has read it, and no noise has corrupted it. A frame of another
    /// network is read if nothing has overlapped it.
    fn receives(&mut self, traffic: &mut Traffic<T>, frame: &QueuedFrame<T>, overlapped: bool) -> bool {
        match receiver_of(traffic, frame) {
            None => !overlapped,
            Some(to) => self.receptions[usize::from(to)] == Reception::Read && !traffic.lost_to_noise(),
        }
    }

    /// Lets the receiver of a frame acknowledge it soon, at the rate `answer`. The sender's next backoff is drawn now.
    fn promise(&mut self, traffic: &mut Traffic<T>, now: Time, by: usize, frame: QueuedFrame<T>, answer: Rate) {
        let drawn: u32 = traffic.backoff.random();
        let attempts = traffic.stations[by].attempts();
        traffic.stations[by].done(&traffic.radio, drawn);
        let Some(to) = receiver_of(traffic, &frame) else { return };
        self.owed[usize::from(to)] = Some((by as u16, answer));
        let sifs = Span::from_nanos(1000 * u64::from(traffic.radio.sifs_us));
        self.events.push(Reverse((now + sifs, Event::Acknowledge(to))));
        self.awaited[by] = Some(Awaited { frame: QueuedFrame { received: true, ..frame }, attempts, drawn });
    }

    /// Ends the acknowledgement for the station `to`: if it was not read, the frame has failed.
    fn acknowledged(&mut self, traffic: &mut Traffic<T>, to: usize) {
        let awaited = self.awaited[to].take().expect("a frame that is acknowledged");
        let Awaited { frame, attempts, drawn } = awaited;
        let read = self.receptions[to] == Reception::Read;
        if let Some(peer) = receiver_of(traffic, &frame) {
            self.rates.report((to as u16, peer), read);
        }
        if !read {
            traffic.stations[to].restore(attempts);
            traffic.fail(to, frame, drawn);
            self.plan(traffic, to);
        }
    }

    /// Delivers a multicast frame to each receiver that has read it, or counts its loss there.
    fn deliver_multicast(
        &mut self,
        traffic: &mut Traffic<T>,
        now: Time,
        frame: &QueuedFrame<T>,
        deliveries: &mut Vec<Delivery<T>>,
    ) {
        let Destination::Many(listeners) = &frame.to else { unreachable!("a frame for one is unicast") };
        let mut spoilt = false;
        for &to in listeners.iter().filter(|&&to| to != frame.from) {
            match self.receptions[usize::from(to)] {
                Reception::Far => traffic.miss_range(to),
                Reception::Faded => traffic.miss_noise(to),
                Reception::Collided => {
                    traffic.counts.lost_collision += 1;
                    spoilt = true;
                }
                Reception::Read if traffic.lost_to_noise() => traffic.miss_noise(to),
                Reception::Read => traffic.deliver(now, frame, to, deliveries),
            }
        }
        if spoilt {
            let by = if frame.hop == Hop::Down { traffic.members } else { frame.from };
            traffic.stations[usize::from(by)].counts.lost_collision += 1;
        }
    }

    /// Handles that a station senses nothing any more: settles its own transmission, and plans its next one.
    fn idle(&mut self, traffic: &mut Traffic<T>, now: Time, station: usize) {
        let view = &mut self.views[station];
        let wait = if view.unread { traffic.times.recovery } else { traffic.times.aifs };
        view.unread = false;
        view.free_at = (now + wait).max(view.reserved + traffic.times.aifs);
        if let Some(outcome) = self.outcomes[station].take() {
            let frame = traffic.stations[station].queue.pop_front().expect("a station that has sent has a frame");
            let drawn = traffic.backoff.random();
            match outcome {
                Outcome::Done => traffic.stations[station].done(&traffic.radio, drawn),
                Outcome::Failed => {
                    if let Some(to) = receiver_of(traffic, &frame) {
                        self.rates.report((station as u16, to), false);
                    }
                    traffic.fail(station, frame, drawn);
                }
            }
        }
        // Who counts no slots has no turn already.
        if traffic.stations[station].counts_down() {
            self.plan(traffic, station);
        }
    }
}

/// Returns the rate of the acknowledgement of a frame at `rate`, and the time from the frame's end to that of the
/// acknowledgement.
fn answer(radio: &Radio, times: &Times, rate: Rate) -> (Rate, Span) {
    if rate == radio.rate {
        return (radio.ack_rate, times.acknowledged);
    }
    let answer = rate.answer(radio.ack_rate);
    let sifs = Span::from_nanos(1000 * u64::from(radio.sifs_us));
    (answer, sifs + answer.airtime(ACK_BYTES, radio.width_mhz, radio.band) + times.propagation)
}
