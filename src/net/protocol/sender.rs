//! State of one sender on one link: its incarnation, what has come, when, and what it said of us.
//!
//! Every field is of a fixed size, or bounded by the size of the team. What follows from it is decided in `incoming`.

use std::collections::BTreeMap;

use serde::Serialize;

use super::bucket::{Bucket, Rate};
use super::candidates::Candidate;
use super::limits::{LOSS_TO_REPEAT, LOSS_TO_REPEAT_TWICE};
use super::offset::Offsets;
use super::order::Order;
use super::report::Stamp;
use super::window::{LOSS_SPAN, Window};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// How much a new gap between arrivals weighs in their mean (as RFC 3550, section 6.4.1, weighs jitter).
const WEIGHT: f64 = 1.0 / 16.0;
/// How long a report asks for repeats: in a team of 200 the next one of the same host may take so long.
const ASKS_FOR: Span = Span::from_millis(4000);
/// How long repeats go on after a report without loss.
const STOPS_AFTER: Span = Span::from_millis(2000);

/// The datagrams of a sender to all, or those to this host.
#[derive(Clone, Debug, Default)]
pub struct Lane {
    /// Which have been here.
    pub window: Window,
    /// The newest sequence number of each stream: a kind about a robot.
    pub newest: BTreeMap<(Kind, RobotId), u32>,
}

/// One sender: an incarnation of a host that is believed.
#[derive(Clone, Debug)]
pub struct Sender {
    /// When this incarnation was taken up.
    pub since: Time,
    /// When it last showed that it was alive.
    pub proved: Time,
    /// When its last report was admitted.
    pub reported: Time,
    /// Its datagrams to all and, second, to this host.
    pub lanes: [Lane; 2],
    /// Which of its datagrams have been held back.
    pub order: Order,
    /// Budget of its datagrams.
    pub bucket: Bucket,
    /// Its newest stamp, and when it came.
    pub stamp: Option<(Stamp, Time)>,
    /// How its stamps lie.
    pub offsets: Offsets,
    /// When a report of ours last listed it.
    pub listed: Option<Time>,
    /// The loss that it was told then.
    pub told: u8,
    /// Whether it has asked for proof that this host is alive.
    pub wants: bool,
    /// How many of our newest 64 datagrams it has lost by its own account.
    pub told_lost: u8,
    /// Until when that asks for a repeat, and for a second one.
    pub asks: [Time; 2],
    /// The incarnation that it has followed.
    pub former: Option<u32>,
    /// How many datagrams of a second live host under this id.
    pub twins: u64,
    heard: Option<Time>,
    spacing_s: f64,
    jitter_s: f64,
}

impl Sender {
    /// A sender that is taken up now.
    pub fn new(now: Time, rate: Option<&Rate>) -> Sender {
        Sender {
            since: now,
            proved: now,
            reported: now,
            lanes: [Lane::default(), Lane::default()],
            order: Order::default(),
            bucket: Bucket::full(now, rate.unwrap_or(&super::reliability::RATE)),
            stamp: None,
            offsets: Offsets::default(),
            listed: None,
            told: 0,
            wants: false,
            told_lost: 0,
            asks: [Time::ZERO; 2],
            former: None,
            twins: 0,
            heard: None,
            spacing_s: 0.0,
            jitter_s: 0.0,
        }
    }

    /// A report of it was admitted that was written at `stamp`.
    pub fn stamped(&mut self, now: Time, stamp: Stamp) {
        self.reported = now;
        if self.stamp.is_none_or(|(before, _)| stamp.ahead_us(before) > 0) {
            self.stamp = Some((stamp, now));
        }
    }

    /// It reports that so many of our newest 64 datagrams were lost.
    pub fn told_of_loss(&mut self, now: Time, lost: u8) {
        self.told_lost = lost.min(LOSS_SPAN as u8);
        for (asks, bar) in self.asks.iter_mut().zip([LOSS_TO_REPEAT, LOSS_TO_REPEAT_TWICE]) {
            *asks = if lost >= bar { now + ASKS_FOR } else { (*asks).min(now + STOPS_AFTER) };
        }
    }

    /// A datagram of this sender has come.
    pub fn heard(&mut self, now: Time) {
        if let Some(before) = self.heard.replace(now) {
            let gap = now.since(before).as_secs();
            if self.spacing_s == 0.0 {
                self.spacing_s = gap;
            }
            self.jitter_s += WEIGHT * ((gap - self.spacing_s).abs() - self.jitter_s);
            self.spacing_s += WEIGHT * (gap - self.spacing_s);
        }
    }

    /// How long ago anything came; none if never.
    pub fn age(&self, now: Time) -> Option<Span> {
        self.heard.map(|heard| now.since(heard))
    }

    /// How many of its newest 64 datagrams were lost.
    pub fn lost(&self) -> u8 {
        self.lanes.iter().map(|lane| lane.window.lost()).max().unwrap_or(0)
    }

    /// All that is known of it; `proven` says whether it is believed now.
    pub fn peer(&self, now: Time, link: LinkId, (host, epoch): (HostId, u32), proven: bool) -> Peer {
        let (passed, missing) = self
            .lanes
            .iter()
            .map(|lane| lane.window.missing())
            .fold((0, 0), |sum, lane| (sum.0 + lane.0, sum.1 + lane.1));
        let offset = self.offsets.estimate(now);
        Peer {
            link: link.0,
            host: host.0,
            epoch,
            proven,
            age_s: self.age(now).map(Span::as_secs),
            spacing_s: self.spacing_s,
            jitter_s: self.jitter_s,
            loss: f64::from(self.lost()) / f64::from(LOSS_SPAN),
            passed,
            missing,
            told_loss: f64::from(self.told_lost) / f64::from(LOSS_SPAN),
            uncertainty_s: offset.map(|offset| offset.uncertainty_s),
            round_trip_s: offset.map(|offset| offset.round_trip_s),
            twins: self.twins,
        }
    }
}

impl Peer {
    /// State of an incarnation that has not shown yet that it is alive.
    pub fn candidate(now: Time, link: LinkId, host: HostId, candidate: &Candidate) -> Peer {
        let unknown = Sender::new(now, None).peer(now, link, (host, candidate.epoch), false);
        Peer { age_s: Some(now.since(candidate.at).as_secs()), ..unknown }
    }
}

/// Summary of another host on one link, for people and reports.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Peer {
    /// The link.
    pub link: u16,
    /// The other host.
    pub host: u16,
    /// Its incarnation.
    pub epoch: u32,
    /// Whether it has shown that it is alive; without, nothing of it is let in.
    pub proven: bool,
    /// How long ago anything of it came \[s\].
    pub age_s: Option<f64>,
    /// The mean time between two arrivals \[s\].
    pub spacing_s: f64,
    /// The mean deviation from that \[s\].
    pub jitter_s: f64,
    /// The share of its newest 64 datagrams whose first transmission was lost.
    pub loss: f64,
    /// How many of its datagrams should have come.
    pub passed: u64,
    /// How many of those never came, not even as a copy.
    pub missing: u64,
    /// The share of our newest 64 datagrams that it has lost, by its own account.
    pub told_loss: f64,
    /// How well the way from there is known \[s\]: half of the way there and back, and drift since it was measured.
    pub uncertainty_s: Option<f64>,
    /// There and back \[s\]; half of it is about the latency of the link.
    pub round_trip_s: Option<f64>,
    /// How many datagrams came from a second live host under its id.
    pub twins: u64,
}
