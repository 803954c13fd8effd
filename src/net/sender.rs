//! What a host remembers of one sender on one link: its incarnation, what has come, when, and what it said of us.
//!
//! Every field is of a fixed size, or bounded by the size of the team. What follows from it is decided in `incoming`.

use std::collections::BTreeMap;

use serde::Serialize;

use super::bucket::{Bucket, Rate};
use super::offset::Offsets;
use super::report::Stamp;
use super::window::{LOSS_SPAN, Window};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// How much a new gap between arrivals weighs in their mean (as RFC 3550, section 6.4.1, weighs jitter).
const WEIGHT: f64 = 1.0 / 16.0;

/// The datagrams of a sender to all, or those to this host.
#[derive(Clone, Debug, Default)]
pub struct Lane {
    /// Which have been here.
    pub window: Window,
    /// The newest sequence number of each stream: a kind about a robot.
    pub newest: BTreeMap<(Kind, RobotId), u32>,
}

/// One sender.
#[derive(Clone, Debug)]
pub struct Sender {
    /// Its incarnation.
    pub epoch: u32,
    /// Whether it has shown that it is alive now.
    pub proven: bool,
    /// When it last has.
    pub proved: Time,
    /// When this incarnation was taken up.
    pub since: Stamp,
    /// Its datagrams to all and, second, to this host.
    pub lanes: [Lane; 2],
    /// What it may still say.
    pub bucket: Bucket,
    /// Its newest stamp, and when it came.
    pub stamp: Option<(Stamp, Time)>,
    /// A later incarnation that has not shown yet that it is alive: its epoch, its stamp, when that came.
    pub challenger: Option<(u32, Stamp, Time)>,
    /// How its clock lies.
    pub offsets: Offsets,
    /// How many of our newest 64 datagrams it has lost by its own account.
    pub told_lost: u8,
    /// Until when that asks for a repeat, and for a second one.
    pub asks: [Time; 2],
    /// How many datagrams of a second live host under this id.
    pub twins: u64,
    heard: Option<Time>,
    spacing_s: f64,
    jitter_s: f64,
}

impl Sender {
    /// A sender of which nothing is known but its incarnation.
    pub fn new(now: Time, epoch: u32, proven: bool, rate: Option<&Rate>) -> Sender {
        Sender {
            epoch,
            proven,
            proved: now,
            since: Stamp::of(now),
            lanes: [Lane::default(), Lane::default()],
            bucket: Bucket::full(now, rate.unwrap_or(&super::reliability::RATE)),
            stamp: None,
            challenger: None,
            offsets: Offsets::default(),
            told_lost: 0,
            asks: [Time::ZERO; 2],
            twins: 0,
            heard: None,
            spacing_s: 0.0,
            jitter_s: 0.0,
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

    /// All that is known of it.
    pub fn peer(&self, now: Time, link: LinkId, host: HostId) -> Peer {
        let (passed, missing) = self
            .lanes
            .iter()
            .map(|lane| lane.window.missing())
            .fold((0, 0), |sum, lane| (sum.0 + lane.0, sum.1 + lane.1));
        let offset = self.offsets.estimate(now);
        Peer {
            link: link.0,
            host: host.0,
            epoch: self.epoch,
            proven: self.proven,
            age_s: self.age(now).map(Span::as_secs),
            spacing_s: self.spacing_s,
            jitter_s: self.jitter_s,
            loss: f64::from(self.lost()) / f64::from(LOSS_SPAN),
            passed,
            missing,
            told_loss: f64::from(self.told_lost) / f64::from(LOSS_SPAN),
            ahead_s: offset.map(|offset| offset.ahead_s),
            uncertainty_s: offset.map(|offset| offset.uncertainty_s),
            round_trip_s: offset.map(|offset| offset.round_trip_s),
            twins: self.twins,
        }
    }
}

/// What a host knows of another on one link, for people and reports.
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
    /// How far its clock is ahead \[s\].
    pub ahead_s: Option<f64>,
    /// How far off that may be \[s\].
    pub uncertainty_s: Option<f64>,
    /// There and back \[s\]; half of it is about the latency of the link.
    pub round_trip_s: Option<f64>,
    /// How many datagrams came from a second live host under its id.
    pub twins: u64,
}
