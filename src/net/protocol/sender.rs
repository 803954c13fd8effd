//! State of one sender on one link: its incarnation, its datagrams with their times, and its reports about this host.
//! Every field has a fixed size, or is bounded by the size of the team. `incoming` makes the decisions.

use std::collections::BTreeMap;

use serde::Serialize;

use super::bucket::{Bucket, Rate};
use super::candidates::Candidate;
use super::congestion::BaseDelay;
use super::lateness::Lateness;
use super::limits::{FRESH, LOSS_TO_REPEAT, LOSS_TO_REPEAT_TWICE};
use super::offset::Offsets;
use super::report::Stamp;
use super::signing::Checked;
use super::window::{LOSS_SPAN, Window};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::latch::Latch;
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// Weight of a new interarrival time in the running mean (as for jitter in RFC 3550, section 6.4.1).
const WEIGHT: f64 = 1.0 / 16.0;
/// Time for which a report of loss causes repeats. In a team of 200, the next report of the same host may come that
/// late.
const REPEATS_FOR: Span = Span::from_millis(4000);
/// Time for which repeats continue after a report without loss.
const STOPS_AFTER: Span = Span::from_millis(2000);

/// Datagrams of one sender that are numbered together: either those to all hosts, or those to this host alone.
#[derive(Clone, Debug, Default)]
pub(crate) struct SequenceSpace {
    /// Replay window, which tells new datagrams from duplicates.
    pub(crate) window: Window,
    /// Newest sequence number of each stream (kind and robot).
    pub(crate) newest: BTreeMap<(Kind, RobotId), u32>,
}

/// State of another host whose datagrams this host accepts on one link.
#[derive(Clone, Debug)]
pub(crate) struct Sender {
    /// Time at which this host accepted the sender.
    pub(crate) since: Time,
    /// Time at which the sender last proved its liveness by the echo of a recent stamp.
    pub(crate) proved: Time,
    /// Time at which the last link report of the sender arrived and was accepted.
    pub(crate) reported: Time,
    /// State of the sender's datagrams to all hosts (index 0), and of those to this host alone (index 1).
    pub(crate) spaces: [SequenceSpace; 2],
    /// Recent link reports of the sender, from which datagrams that were held back on the way are recognized.
    pub(crate) lateness: Lateness,
    /// Token bucket that limits the rate of the sender's datagrams.
    pub(crate) bucket: Bucket,
    /// Latest emergency stop of this incarnation; clear before its first.
    pub(crate) stop: Latch,
    /// Signatures in its messages that were checked.
    pub(crate) checked: Checked,
    /// Newest stamp in the sender's link reports, and its arrival time; `None` before the first report.
    pub(crate) stamp: Option<(Stamp, Time)>,
    /// Measurements of the offset between the sender's stamps and this host's.
    pub(crate) offsets: Offsets,
    /// Base delay of the round trips to the sender.
    pub(crate) base_delay: BaseDelay,
    /// Time of this host's last link report with an entry about the sender; `None` if there was none.
    pub(crate) listed: Option<Time>,
    /// Number of lost datagrams among the sender's newest 64, as stated in this host's last link report about the
    /// sender.
    pub(crate) loss_sent: u8,
    /// Whether the sender has asked for a proof that this host is alive and has not got it yet.
    pub(crate) challenged: bool,
    /// Number of lost datagrams among this host's newest 64, as stated in the sender's last link report about this
    /// host.
    pub(crate) reported_lost: u8,
    /// Times until which messages in the reliability mode `repeat` are sent a second and a third time, because of the
    /// loss that the sender reports.
    pub(crate) repeat_until: [Time; 2],
    /// Incarnation of the same host that was accepted before and that this one has replaced; `None` if there was none.
    pub(crate) predecessor: Option<u32>,
    /// Number of refused datagrams of a second live host with the same id.
    pub(crate) duplicate_ids: u64,
    /// Another incarnation of the same host, of which datagrams are refused, and the time of the first of them; `None`
    /// if there is none.
    contested: Option<(u32, Time)>,
    /// Whether the sender and another incarnation of the same host were alive at the same time.
    is_duplicated: bool,
    /// Another incarnation of the same host that has proved its liveness, and the times at which it did so first and
    /// last; `None` if there is none, and in small teams.
    rival: Option<(u32, Time, Time)>,
    heard: Option<Time>,
    spacing_s: f64,
    jitter_s: f64,
}

impl Sender {
    /// Returns the state of a sender that is accepted at `now`. `rate` is the limit on its datagrams; `None` for no
    /// limit.
    pub(crate) fn new(now: Time, rate: Option<&Rate>) -> Sender {
        Sender {
            since: now,
            proved: now,
            reported: now,
            spaces: [SequenceSpace::default(), SequenceSpace::default()],
            lateness: Lateness::default(),
            bucket: Bucket::full(now, rate.unwrap_or(&super::reliability::RATE)),
            stop: Latch::default(),
            checked: Checked::new(now),
            stamp: None,
            offsets: Offsets::default(),
            base_delay: BaseDelay::new(now),
            listed: None,
            loss_sent: 0,
            challenged: false,
            reported_lost: 0,
            repeat_until: [Time::ZERO; 2],
            predecessor: None,
            duplicate_ids: 0,
            contested: None,
            is_duplicated: false,
            rival: None,
            heard: None,
            spacing_s: 0.0,
            jitter_s: 0.0,
        }
    }

    /// Records a link report of the sender with the stamp `stamp`, which arrived at `now` and was accepted.
    pub(crate) fn stamped(&mut self, now: Time, stamp: Stamp) {
        self.reported = now;
        if self.stamp.is_none_or(|(before, _)| stamp.ahead_us(before) > 0) {
            self.stamp = Some((stamp, now));
        }
    }

    /// Records that the sender reports the loss of `lost` of this host's newest 64 datagrams, which decides about
    /// repeats.
    pub(crate) fn note_reported_loss(&mut self, now: Time, lost: u8) {
        self.reported_lost = lost.min(LOSS_SPAN as u8);
        for (until, bar) in self.repeat_until.iter_mut().zip([LOSS_TO_REPEAT, LOSS_TO_REPEAT_TWICE]) {
            *until = if lost >= bar { now + REPEATS_FOR } else { (*until).min(now + STOPS_AFTER) };
        }
    }

    /// Records that a datagram of `other`, another incarnation of the same host, is refused at `now`, because this one
    /// is accepted. Returns whether both are known to be alive at the same time, so that their id is a duplicate.
    ///
    /// A host that was killed is restarted within less time than it takes to count as silent, so another incarnation
    /// alone tells nothing: this one may just have died.
    pub(crate) fn contest(&mut self, now: Time, other: u32) -> bool {
        self.contested.get_or_insert((other, now));
        self.duplicate_ids += u64::from(self.is_duplicated);
        self.is_duplicated
    }

    /// Records that `other`, another incarnation of the same host, proves its liveness at `now`. Returns since when it
    /// does.
    pub(crate) fn rivalled(&mut self, now: Time, other: u32) -> Time {
        let known = self.rival.filter(|(rival, _, last)| *rival == other && now.since(*last) < FRESH);
        let since = known.map_or(now, |(_, since, _)| since);
        self.rival = Some((other, since, now));
        since
    }

    /// Whether another incarnation of the same host has proved its liveness lately.
    pub(crate) fn has_rival(&self, now: Time) -> bool {
        self.rival.is_some_and(|(_, _, last)| now.since(last) < FRESH)
    }

    /// The same as `contest` on a link without a key, where nothing proves when a host was alive: both have to be heard
    /// for longer than a datagram of a dead process can be in transit.
    pub(crate) fn contest_without_key(&mut self, now: Time, other: u32) -> bool {
        match self.contested {
            Some((before, since)) if before == other => self.is_duplicated |= now.since(since) > FRESH,
            _ => self.contested = Some((other, now)),
        }
        self.contest(now, other)
    }

    /// Records that the sender was alive at some time in the last `age` before `now`. If another incarnation of the
    /// same host was received before that, both are alive: a dead process cannot have echoed so recent a stamp, however
    /// long its datagrams were in transit.
    pub(crate) fn alive_within(&mut self, now: Time, age: Span) {
        self.is_duplicated |= self.contested.is_some_and(|(_, since)| now.since(since) > age);
    }

    /// Returns whether the number `sequence` is further ahead in the sequence space `space` than the sender can have
    /// sent since its last datagram arrived.
    pub(crate) fn is_ahead(&self, now: Time, space: usize, sequence: u32, rate: &Rate) -> bool {
        let since = now.since(self.heard.unwrap_or(self.since)).as_secs();
        f64::from(self.spaces[space].window.ahead(sequence)) > rate.burst + rate.per_s * since
    }

    /// Records the arrival of a datagram of the sender, for age, mean interval and jitter.
    pub(crate) fn heard(&mut self, now: Time) {
        if let Some(before) = self.heard.replace(now) {
            let gap = now.since(before).as_secs();
            if self.spacing_s == 0.0 {
                self.spacing_s = gap;
            }
            self.jitter_s += WEIGHT * ((gap - self.spacing_s).abs() - self.jitter_s);
            self.spacing_s += WEIGHT * (gap - self.spacing_s);
        }
    }

    /// Returns the time since the sender's last datagram; `None` if there was none.
    pub(crate) fn age(&self, now: Time) -> Option<Span> {
        self.heard.map(|heard| now.since(heard))
    }

    /// Returns the number of the sender's newest 64 datagrams whose first transmission was lost.
    pub(crate) fn lost(&self) -> u8 {
        self.spaces.iter().map(|space| space.window.lost()).max().unwrap_or(0)
    }

    /// Returns a summary of this sender on the link `link` at `now`, for display. `accepted` says whether it is
    /// accepted.
    pub(crate) fn peer(&self, now: Time, link: LinkId, (host, incarnation): (HostId, u32), accepted: bool) -> Peer {
        let (passed, missing) = self
            .spaces
            .iter()
            .map(|space| space.window.missing())
            .fold((0, 0), |sum, space| (sum.0 + space.0, sum.1 + space.1));
        let offset = self.offsets.estimate(now);
        Peer {
            link: link.0,
            host: host.0,
            incarnation,
            accepted,
            age_s: self.age(now).map(Span::as_secs),
            spacing_s: self.spacing_s,
            jitter_s: self.jitter_s,
            loss: f64::from(self.lost()) / f64::from(LOSS_SPAN),
            passed,
            missing,
            reported_loss: f64::from(self.reported_lost) / f64::from(LOSS_SPAN),
            uncertainty_s: offset.map(|offset| offset.uncertainty_s),
            round_trip_s: offset.map(|offset| offset.round_trip_s),
            duplicate_ids: self.duplicate_ids,
            is_former: false,
            withholds: false,
            sends: None,
        }
    }
}

impl Peer {
    /// Returns a summary of an accepted host that was heard `age_s` ago \[s\], with this share of datagrams lost in
    /// both directions and all else unknown, as tests of other packages need it.
    pub fn heard(link: u16, host: u16, age_s: f64, loss: f64) -> Peer {
        let unknown = Sender::new(Time::ZERO, None).peer(Time::ZERO, LinkId(link), (HostId(host), 0), true);
        Peer { age_s: Some(age_s), loss, reported_loss: loss, ..unknown }
    }

    /// Returns a summary of a host that speaks the former version of the wire format.
    pub(crate) fn former(now: Time, link: LinkId, host: HostId) -> Peer {
        Peer { is_former: true, ..Sender::new(now, None).peer(now, link, (host, 0), false) }
    }

    /// Returns a summary of a candidate, an incarnation of the host `host` that has not proved its liveness yet.
    pub(crate) fn candidate(now: Time, link: LinkId, host: HostId, candidate: &Candidate) -> Peer {
        let unknown = Sender::new(now, None).peer(now, link, (host, candidate.incarnation), false);
        Peer { age_s: Some(now.since(candidate.at).as_secs()), ..unknown }
    }
}

/// Summary of another host on one link (such as delay and loss), for display and reports.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Peer {
    /// Id of the link on which the other host is received.
    pub link: u16,
    /// Id of the other host.
    pub host: u16,
    /// Incarnation of the other host: random number of its run.
    #[serde(rename = "epoch")]
    pub(crate) incarnation: u32,
    /// Whether the host is accepted: it has proved its liveness, or the link has no key. Messages of a host that is not
    /// accepted are refused.
    #[serde(rename = "proven")]
    pub accepted: bool,
    /// Time since the host's last datagram \[s\]; `None` if there was none.
    pub age_s: Option<f64>,
    /// Mean time between datagrams of the host \[s\].
    pub(crate) spacing_s: f64,
    /// Mean deviation of the time between datagrams from `spacing_s` \[s\].
    pub(crate) jitter_s: f64,
    /// Share (0 to 1) of the newest 64 datagrams from the other host to this one whose first transmission was lost.
    pub loss: f64,
    /// Number of the host's datagrams that should have arrived so far, by their sequence numbers.
    pub(crate) passed: u64,
    /// Number of the host's datagrams that never arrived, not even as a retransmission.
    pub missing: u64,
    /// Share of this host's newest 64 datagrams that the other host reports as lost.
    #[serde(rename = "told_loss")]
    pub reported_loss: f64,
    /// Bound on the error of one-way delays from the host \[s\]: half of the round trip, and the clock drift since it
    /// was measured; `None` without a measurement.
    pub uncertainty_s: Option<f64>,
    /// Round trip time \[s\]; half of it approximates the latency of the link. `None` without a measurement.
    pub round_trip_s: Option<f64>,
    /// Number of datagrams that were refused because they are of a second live host with the same id.
    #[serde(rename = "twins")]
    pub duplicate_ids: u64,
    /// Whether the host speaks the version of the wire format before this one, so that nothing of it is accepted.
    #[serde(rename = "former")]
    pub is_former: bool,
    /// Whether the host passes nothing on, on a mesh on which it would have had to for seconds.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub withholds: bool,
    /// Way in which this host sends its data on a link that chooses, with the figures behind it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sends: Option<String>,
}
