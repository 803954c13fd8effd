//! Datagrams with a valid tag that are refused and change nothing: copies of what has arrived, and recordings.
//!
//! Anybody on the network can send these again and again, so they must not cost more than a count: neither state nor
//! room in a record. The checks are those of [`Incoming::admit`], on state that stays as it is.

use super::candidates::Novelty;
use super::codec::{Flags, Header};
use super::counts::Refusal;
use super::incoming::Incoming;
use super::limits::{FRESH, PROOF_VALIDITY, REPORT_VALIDITY};
use super::report::Report;
use super::window::Position;
use crate::time::Time;

impl Incoming {
    /// Returns the cause for which a datagram of this team is refused, if nothing but the count of it changes; `None`
    /// if it has to be admitted, or refused with an effect. A duplicate whose sender wants an acknowledgement is among
    /// the causes: the caller decides whether it gets one.
    pub fn refuses(&self, now: Time, header: &Header, report: Option<&Report>) -> Option<Refusal> {
        let id = (header.sender, header.incarnation);
        let sender = match self.local.authenticated {
            false => self.senders.get(id)?,
            true => {
                let direct = header.flags.has(Flags::DIRECT);
                let proof = report.and_then(|report| self.liveness_proof(now, report)).filter(|_| !direct);
                let accepted = self.senders.get(id).filter(|sender| now.since(sender.proved) <= PROOF_VALIDITY);
                match (accepted, report) {
                    (Some(sender), Some(report)) => {
                        if sender.offsets.is_off(now, self.local.stamps.of(now), report.stamp, FRESH) {
                            return proof.is_none().then_some(Refusal::Late);
                        }
                        sender
                    }
                    (Some(sender), None) if now.since(sender.reported) <= REPORT_VALIDITY => sender,
                    _ if proof.is_some() => return None,
                    _ => return self.refuses_candidate(now, header, report),
                }
            }
        };
        let space = usize::from(header.flags.has(Flags::DIRECT));
        if self.rate.as_ref().is_some_and(|rate| sender.is_ahead(now, space, header.sequence, rate)) {
            return Some(Refusal::Ahead);
        }
        let window = &sender.spaces[space].window;
        let late = self.local.authenticated && sender.lateness.would_be_late(now, space, header.sequence);
        if late && window.misses(header.sequence) && !self.gaps.awaits(header) {
            return Some(Refusal::Late);
        }
        match window.unchanged(header.sequence, header.flags.has(Flags::COPY))? {
            Position::Seen => Some(Refusal::Duplicate),
            Position::Behind if self.local.authenticated => Some(Refusal::Replay),
            Position::Behind | Position::New => None,
        }
    }

    /// As [`Incoming::refuses`], of an incarnation that has not proved its liveness.
    fn refuses_candidate(&self, now: Time, header: &Header, report: Option<&Report>) -> Option<Refusal> {
        let id = (header.sender, header.incarnation);
        let current = self.senders.other_incarnation(id).and_then(|id| self.senders.get(id));
        if current.is_some_and(|current| current.predecessor == Some(header.incarnation)) {
            return Some(Refusal::Replay);
        }
        let Some(report) = report else { return Some(Refusal::Unproven) };
        self.novelty(now, header, report).map(|_| Refusal::Unproven)
    }

    /// Returns whether a datagram is of a candidate that is waiting for reports of this host, and no news of it.
    pub fn is_of_waiting(&self, now: Time, header: &Header, report: Option<&Report>) -> bool {
        report.is_some_and(|report| self.novelty(now, header, report) == Some(Novelty::Repeated))
    }

    fn novelty(&self, now: Time, header: &Header, report: &Report) -> Option<Novelty> {
        self.candidates.unchanged(now, header.sender, header.incarnation, report.stamp)
    }

    /// Returns the cause for which a datagram of another process with the id of this host is refused, if nothing but
    /// the count of it changes.
    pub fn refuses_own_id(&self, now: Time, header: &Header, report: Option<&Report>) -> Option<Refusal> {
        if !self.local.authenticated {
            return Some(Refusal::DuplicateId);
        }
        let Some(report) = report else { return Some(Refusal::Unproven) };
        let known = self.novelty(now, header, report).is_some();
        (known && self.liveness_proof(now, report).is_none()).then_some(Refusal::Unproven)
    }
}
