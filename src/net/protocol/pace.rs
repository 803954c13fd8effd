//! Pace of link reports that need datagrams of their own: rarer in a larger team, while no host waits for one and
//! nothing is lost. Pure.
//!
//! Every host receives the reports of all others, so at a fixed period the team's work would grow with the square of
//! its size. As for the reports of RTCP (RFC 3550, section 6.2), the period is proportional to the number of members.
//! It has a limit here, since an echo proves liveness only while the echoed stamp is fresh.

use super::codec::Header;
use super::counts::LinkCounts;
use super::duplicate_id::refuse_another;
use super::incoming::{Admission, Incoming};
use super::limits::{FRESH, LOSS_TO_REPEAT, REPORT_VALIDITY, SILENT};
use super::link::LinkState;
use super::outgoing::{Outgoing, REPORT_PERIOD};
use super::report::Report;
use super::sender::Sender;
use super::senders::SenderId;
use crate::messages::ids::HostId;
use crate::time::{Span, Time};

/// Part of the period of link reports for each host that is received: up to five, the period is the shortest.
const PERIOD_PER_HOST: Span = Span::from_millis(50);
/// Longest period of link reports. An echo of a stamp that is as old still proves liveness.
const MAX_PERIOD: Span = Span::from_millis(1500);
/// The same while another host reports the loss of any datagram. With a loss for which messages are repeated, 3 %, it
/// is the shortest one: a sender of which no report arrives for 3 s is refused.
const MAX_PERIOD_LOSSY: Span = Span::from_millis(500);
/// Time for which an accepted incarnation that reports less often may leave a request for a liveness proof unanswered
/// before another one replaces it: the request waits for a report, and so does the answer.
const SILENT_IF_ASKED: Span = Span::from_millis(800);

impl Incoming {
    /// Returns the time until this host's next link report, after one that leaves at `now`.
    pub fn report_period(&self, now: Time) -> Span {
        let longest = self.longest_period();
        if longest == REPORT_PERIOD || self.is_awaited(now) {
            return REPORT_PERIOD;
        }
        let senders = self.senders.iter().map(|(_, sender)| sender);
        let present = senders.filter(|sender| now.since(sender.reported) <= REPORT_VALIDITY);
        match present.map(|sender| sender.reported_lost).max().unwrap_or(0) {
            0 => longest,
            lost if lost < LOSS_TO_REPEAT => longest.min(MAX_PERIOD_LOSSY),
            _ => REPORT_PERIOD,
        }
    }

    /// Lists the accepted incarnations of the host `host` in the next link report, even in an urgent one.
    pub fn list_soon(&mut self, host: HostId) {
        self.senders.iter_mut().filter(|((id, _), _)| *id == host).for_each(|(_, sender)| sender.challenged = true);
    }

    /// Returns the period of link reports in a team of as many hosts as this one receives, while nothing is lost.
    fn longest_period(&self) -> Span {
        let hosts = self.senders.len() as u64 + 1;
        if self.local.slows { (PERIOD_PER_HOST * hosts).clamp(REPORT_PERIOD, MAX_PERIOD) } else { REPORT_PERIOD }
    }

    /// Whether another host waits for an entry of this host, or this one for a liveness proof.
    fn is_awaited(&self, now: Time) -> bool {
        let stamped = |sender: &Sender| sender.stamp.is_some_and(|(_, at)| now.since(at) < FRESH);
        let awaited =
            |sender: &Sender| sender.listed.is_none() || sender.challenged || self.schedule.challenges(now, sender);
        !self.candidates.waiting(now).is_empty()
            || self.senders.iter().any(|(_, sender)| stamped(sender) && awaited(sender))
    }

    /// Returns whether the accepted incarnation `id` of a host may be alive, so that another one, whose datagram proves
    /// its own liveness, is refused. Where hosts report less often, the accepted one is first asked for a proof.
    pub(super) fn keeps(
        &mut self,
        now: Time,
        id: SenderId,
        other: &Header,
        report: &Report,
        counts: &mut LinkCounts,
    ) -> bool {
        let slow = self.longest_period() > REPORT_PERIOD;
        let Some(current) = self.senders.get_mut(id) else { return false };
        let asked = slow.then(|| current.rivalled(now, other.incarnation));
        let silent = now.since(current.reported) >= SILENT;
        if silent && asked.is_none_or(|asked| now.since(asked) >= SILENT_IF_ASKED) {
            return false;
        }
        let duplicated = current.contest(now, other.incarnation);
        refuse_another(other.sender, duplicated.then_some(current.duplicate_ids), counts);
        self.candidates.note(now, other.sender, other.incarnation, report.stamp);
        true
    }
}

impl LinkState {
    /// Hastens the next link report if the last datagram was new and tells of a loss.
    pub(super) fn tell_news(&mut self, verdict: Admission) {
        if matches!(verdict, Admission::New(_)) && self.incoming.news {
            self.outgoing.hasten_report();
        }
    }
}

impl Outgoing {
    /// Plans the next link report, after one that leaves at `now`.
    pub(super) fn plan_report(&mut self, now: Time, incoming: &Incoming) {
        let eager = self.setup.report_piggyback_age == Span::ZERO;
        let period = if eager { REPORT_PERIOD } else { incoming.report_period(now) };
        (self.report_sent, self.report_due) = (Some(now), Some(now + period));
    }

    /// Makes the next link report due as soon as in a small team: another host waits for it, or it has news.
    pub(super) fn hasten_report(&mut self) {
        if let (Some(due), Some(sent)) = (self.report_due, self.report_sent) {
            self.report_due = Some(due.min(sent + REPORT_PERIOD));
        }
    }
}
