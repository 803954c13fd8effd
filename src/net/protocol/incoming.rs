//! Reception on a link: which incarnations are accepted, and which datagrams are new or missing. Pure; sends nothing.
//!
//! On a link with a key, a sender is accepted once it proves its liveness: it echoes a stamp of this host that is at
//! most `FRESH` old. So a recording is never accepted, not even by a host that has just restarted. Of each host of the
//! deployment, one incarnation is accepted; another replaces it after it has fallen silent. Operators are identified by
//! incarnation, and any number of them are accepted at the same time.

use super::bucket::Rate;
use super::candidates::{Candidates, Novelty};
use super::codec::{Flags, Header};
use super::congestion::Congestion;
use super::counts::LinkCounts;
use super::duplicate_id::{DuplicateIds, refuse_another};
use super::gaps::Gaps;
use super::limits::{FRESH, LOSS_TO_REPEAT, PROOF_VALIDITY, REPORT_VALIDITY, SILENT_WITHOUT_KEY};
use super::offset::Offsets;
use super::report::{DatagramId, Entry, REPORT_BYTES, Report, Stamps};
use super::report_schedule::{Occasion, ReportSchedule};
use super::router::Audience;
use super::sender::{Peer, Sender};
use super::senders::Senders;
use super::window::{Position, Window};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// How soon this host has to send its next link report because another host needs it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// With the next regular report.
    #[default]
    Regular,
    /// In the next datagram, whatever that is for.
    NextDatagram,
    /// The same, and on a link that sends to single hosts also in a datagram of its own: the host that needs it may not
    /// receive those with data.
    OwnDatagram,
    /// At once, in a datagram of its own if need be.
    Immediate,
}

/// Decision on a received datagram: whether it is accepted, and how soon its sender needs a link report of this host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// The datagram is accepted: it is new. The urgency is that of this host's next link report.
    New(Urgency),
    /// The datagram has arrived before. If its sender asks for acknowledgements, the one for it was lost and is sent
    /// again.
    Duplicate,
    /// The datagram is refused, because its sender has not proved its liveness. For that it needs a link report of this
    /// host, with this urgency.
    Candidate(Urgency),
    /// The datagram is refused for another reason, which is counted.
    Refused,
}

/// Identity and settings of this host on one link.
#[derive(Clone, Copy, Debug)]
pub struct LocalEnd {
    /// Id of this host.
    pub host: HostId,
    /// Incarnation of this host: random number of this run.
    pub incarnation: u32,
    /// Id of the link.
    pub link: LinkId,
    /// Whether senders have to prove their liveness before they are accepted: true on links with a key.
    pub authenticated: bool,
    /// Smallest host id of a guest (operator, or host that the deployment does not know); hosts of the team have
    /// smaller ids.
    pub first_guest: HostId,
    /// Length of an entry in this host's link reports \[bytes\].
    pub entry_bytes: usize,
    /// Whether hosts of a larger team report less often on this link.
    pub slows: bool,
    /// Clock from which this host's link reports take their stamps.
    pub stamps: Stamps,
}

/// Liveness proof of another host: an entry of its report that echoes a recent stamp of this host.
#[derive(Clone, Copy, Debug)]
pub(super) struct LivenessProof {
    entry: Entry,
    /// Time since this host sent the echoed stamp.
    age: Span,
}

/// State of the reception on one link: accepted senders, candidates that have not proved their liveness, and missing
/// datagrams.
#[derive(Clone, Debug)]
pub struct Incoming {
    pub(super) local: LocalEnd,
    pub(super) rate: Option<Rate>,
    pub(super) senders: Senders,
    pub(super) candidates: Candidates,
    /// Datagrams that have not arrived, among those that their senders offer for retransmission.
    pub gaps: Gaps,
    pub(super) schedule: ReportSchedule,
    pub(super) congestion: Congestion,
    /// Detection of other processes with the id of this host.
    pub duplicate_ids: DuplicateIds,
    /// Whether the last datagram proved its sender's liveness.
    proved: bool,
    /// Whether the last datagram or its report tells of a loss that other hosts are to know soon.
    pub news: bool,
}

impl Incoming {
    /// Returns the state before any datagram. `rate` limits the datagrams that are accepted from each sender.
    pub fn new(local: LocalEnd, rate: Option<Rate>) -> Incoming {
        let schedule = ReportSchedule::new(local.host, local.authenticated, local.entry_bytes);
        let duplicate_ids = DuplicateIds::new(local.link, local.host, local.incarnation);
        let (senders, candidates) = (Senders::new(local.first_guest), Candidates::new(local.first_guest));
        let (gaps, congestion, proved, news) = (Gaps::default(), Congestion::default(), false, false);
        Incoming { local, rate, senders, candidates, gaps, schedule, congestion, duplicate_ids, proved, news }
    }

    /// Decides whether to accept a datagram of this team whose tag was valid. `report` is the link report in the
    /// datagram, if any; a refusal is counted in `counts` by its cause.
    pub fn admit(&mut self, now: Time, header: &Header, report: Option<&Report>, counts: &mut LinkCounts) -> Admission {
        let proof = report.and_then(|report| self.liveness_proof(now, report));
        self.proved = proof.is_some();
        let known = match self.local.authenticated {
            true => self.check_accepted(now, header, report, proof, counts),
            false => self.check_without_key(now, header, counts),
        };
        if let Err(verdict) = known {
            return verdict;
        }
        let sender = self.senders.get_mut((header.sender, header.incarnation)).expect("it is known by now");
        let space = usize::from(header.flags.has(Flags::DIRECT));
        if self.rate.as_ref().is_some_and(|rate| sender.is_ahead(now, space, header.sequence, rate)) {
            counts.ahead += 1;
            return Admission::Refused;
        }
        let window = &mut sender.spaces[space].window;
        let late = self.local.authenticated && sender.lateness.is_late(now, space, header.sequence);
        if late && window.misses(header.sequence) && !self.gaps.awaits(header) {
            counts.late += 1;
            return Admission::Refused;
        }
        match window.record(header.sequence, header.flags.has(Flags::COPY)) {
            Position::New => {}
            Position::Seen => {
                counts.duplicate += 1;
                return Admission::Duplicate;
            }
            Position::Behind if self.local.authenticated => {
                counts.replay += 1;
                return Admission::Refused;
            }
            // Without a key replays are not detected; only the newest message of each stream is accepted anyway.
            Position::Behind => {}
        }
        if let Some(rate) = &self.rate
            && !sender.bucket.take(now, rate)
        {
            counts.rate += 1;
            return Admission::Refused;
        }
        sender.heard(now);
        self.news = ReportSchedule::has_news(sender);
        let Some(report) = report else { return Admission::New(Urgency::Regular) };
        let challenged = sender.challenged || (sender.listed.is_none() && sender.stamp.is_some());
        sender.stamped(now, report.stamp);
        if space == 0 {
            let direct = proof.and_then(|proof| proof.entry.direct);
            sender.lateness.reported(now, [Some(header.sequence), direct]);
        }
        if let Some(LivenessProof { entry, age }) = proof {
            sender.proved = now;
            if self.local.authenticated {
                sender.alive_within(now, age);
            }
            let round_trip_s = sender.offsets.measure(now, self.local.stamps.of(now), report.stamp, &entry);
            if let Some(round_trip_s) = round_trip_s {
                self.congestion.note(now, sender.base_delay.queueing_s(now, round_trip_s));
            }
            sender.challenged |= entry.challenge;
            sender.note_reported_loss(now, entry.lost);
            self.news |= entry.lost >= LOSS_TO_REPEAT;
        }
        let report_due = !challenged && (sender.challenged || sender.listed.is_none());
        Admission::New(match report_due {
            true if header.sender.is_operator() => Urgency::Immediate,
            true => Urgency::NextDatagram,
            false => Urgency::Regular,
        })
    }

    /// Returns whether the datagram that was given to `admit` last proves its sender's liveness: it echoes a recent
    /// stamp of this host.
    pub fn has_proved(&self) -> bool {
        self.proved
    }

    /// Checks on a link with a key that the sender's incarnation is accepted. Accepts it if the datagram proves its
    /// liveness.
    fn check_accepted(
        &mut self,
        now: Time,
        header: &Header,
        report: Option<&Report>,
        proof: Option<LivenessProof>,
        counts: &mut LinkCounts,
    ) -> Result<(), Admission> {
        let id = (header.sender, header.incarnation);
        // A unicast datagram does not tell the sequence number of datagrams to all hosts.
        let proof = proof.filter(|_| !header.flags.has(Flags::DIRECT));
        let accepted = self.senders.get_mut(id).filter(|sender| now.since(sender.proved) <= PROOF_VALIDITY);
        match (accepted, report) {
            (Some(sender), Some(report)) => {
                let off = sender.offsets.is_off(now, self.local.stamps.of(now), report.stamp, FRESH);
                if off && proof.is_none() {
                    counts.late += 1;
                    return Err(Admission::Refused);
                } else if off {
                    // The echo shows that the report is recent although its stamp is old: the sender's clock has
                    // paused.
                    sender.offsets = Offsets::default();
                }
                return Ok(());
            }
            (Some(sender), None) if now.since(sender.reported) <= REPORT_VALIDITY => return Ok(()),
            _ => {}
        }
        match (report, proof) {
            (Some(report), Some(proof)) => self.accept_incarnation(now, header, report, proof, counts),
            _ => Err(self.note_candidate(now, header, report, counts)),
        }
    }

    /// Records an incarnation without a liveness proof as a candidate. Returns how soon it needs a report of this host.
    #[cold]
    fn note_candidate(
        &mut self,
        now: Time,
        header: &Header,
        report: Option<&Report>,
        counts: &mut LinkCounts,
    ) -> Admission {
        let current =
            self.senders.other_incarnation((header.sender, header.incarnation)).and_then(|id| self.senders.get(id));
        if current.is_some_and(|current| current.predecessor == Some(header.incarnation)) {
            counts.replay += 1;
            return Admission::Refused;
        }
        counts.unproven += 1;
        // Without a report there is no stamp to echo, and a known stamp needs no further echo. So a repeated recording
        // gets no answer.
        let novelty = report.map(|report| self.candidates.note(now, header.sender, header.incarnation, report.stamp));
        match novelty {
            Some(Novelty::New | Novelty::Unanswered) if header.sender.is_operator() => {
                Admission::Candidate(Urgency::Immediate)
            }
            Some(Novelty::New) => Admission::Candidate(Urgency::NextDatagram),
            Some(Novelty::Unanswered) => Admission::Candidate(Urgency::OwnDatagram),
            Some(Novelty::Repeated) => Admission::Candidate(Urgency::Regular),
            Some(Novelty::Expired) | None => Admission::Refused,
        }
    }

    /// Accepts an incarnation that proves its liveness.
    #[cold]
    fn accept_incarnation(
        &mut self,
        now: Time,
        header: &Header,
        report: &Report,
        proof: LivenessProof,
        counts: &mut LinkCounts,
    ) -> Result<(), Admission> {
        let id = (header.sender, header.incarnation);
        let mut sender = Sender::new(now, self.rate.as_ref());
        if let Some(current_id) = self.senders.other_incarnation((header.sender, header.incarnation)) {
            let current = self.senders.get(current_id).expect("it was found");
            if proof.age >= now.since(current.since) {
                // The echoed stamp is older than the accepted incarnation, so the datagram is a recording.
                counts.replay += 1;
                return Err(Admission::Refused);
            }
            let duplicate_ids = current.duplicate_ids;
            if self.keeps(now, current_id, header, report, counts) {
                return Err(Admission::Refused);
            }
            (sender.duplicate_ids, sender.predecessor) = (duplicate_ids, Some(current_id.1));
            self.senders.remove(current_id);
        } else if let Some(before) = self.senders.get(id) {
            (sender.duplicate_ids, sender.predecessor) = (before.duplicate_ids, before.predecessor);
            // It is the same run: a recording of its stops is none of a new one.
            (sender.stop, sender.checked) = (before.stop, before.checked.clone());
        } else if !self.senders.make_room(now, header.sender) {
            counts.crowd += 1;
            return Err(Admission::Refused);
        }
        sender.spaces[0].window = Window::starting(header.sequence);
        if let Some(direct) = proof.entry.direct {
            sender.spaces[1].window = Window::starting(direct);
        }
        if self.candidates.forget(header.sender, header.incarnation).is_some_and(|candidate| candidate.echoed > 0) {
            sender.listed = Some(now);
        }
        self.senders.insert(id, sender);
        Ok(())
    }

    /// Checks a sender on a link without a key: all are accepted, but only one incarnation of a host at a time.
    fn check_without_key(&mut self, now: Time, header: &Header, counts: &mut LinkCounts) -> Result<(), Admission> {
        let id = (header.sender, header.incarnation);
        if self.senders.get(id).is_some() {
            return Ok(());
        }
        let mut sender = Sender::new(now, self.rate.as_ref());
        if let Some(current_id) = self.senders.other_incarnation((header.sender, header.incarnation)) {
            let current = self.senders.get_mut(current_id).expect("it was found");
            if current.age(now).is_some_and(|age| age < SILENT_WITHOUT_KEY) {
                let duplicated = current.contest_without_key(now, header.incarnation);
                refuse_another(header.sender, duplicated.then_some(current.duplicate_ids), counts);
                return Err(Admission::Refused);
            }
            sender.duplicate_ids = current.duplicate_ids;
            self.senders.remove(current_id);
        } else if !self.senders.make_room(now, header.sender) {
            counts.crowd += 1;
            return Err(Admission::Refused);
        }
        self.senders.insert(id, sender);
        Ok(())
    }

    /// Handles the link report of another process with this host's id: a live one, or a recording of an earlier run.
    #[cold]
    pub fn note_duplicate_id(&mut self, now: Time, header: &Header, report: &Report, counts: &mut LinkCounts) {
        self.candidates.note(now, header.sender, header.incarnation, report.stamp);
        match self.liveness_proof(now, report) {
            Some(proof) => {
                counts.duplicate_id += 1;
                self.duplicate_ids.claim(now, header.incarnation, proof.entry.held);
            }
            None => counts.unproven += 1,
        }
    }

    /// Returns the liveness proof in a report: an entry about this host with a recent echo.
    pub(super) fn liveness_proof(&self, now: Time, report: &Report) -> Option<LivenessProof> {
        let about_this_host = report.heard.iter().filter(|entry| entry.host == self.local.host);
        about_this_host
            .filter_map(|entry| Some(LivenessProof { entry: *entry, age: self.local.stamps.age(now, entry.echo)? }))
            .find(|proof| proof.age <= FRESH)
    }

    /// Returns whether a message about `robot` is newer than all others of its stream (kind and robot), and records it
    /// if so. All kinds of messages are state, so older messages are useless.
    pub fn accept(&mut self, header: &Header, kind: Kind, robot: RobotId, counts: &mut LinkCounts) -> bool {
        let Some(sender) = self.senders.get_mut((header.sender, header.incarnation)) else { return false };
        let newest = &mut sender.spaces[usize::from(header.flags.has(Flags::DIRECT))].newest;
        let newest = newest.entry((kind, robot)).or_insert(header.sequence.wrapping_sub(1));
        let ahead = header.sequence.wrapping_sub(*newest);
        if ahead == 0 {
            counts.duplicate += 1;
            return false;
        }
        if ahead > u32::MAX / 2 {
            counts.stale += 1;
            return false;
        }
        *newest = header.sequence;
        counts.accepted += 1;
        counts.repaired += u64::from(header.flags.has(Flags::COPY));
        true
    }

    /// Records as missing those datagrams that their sender still keeps for retransmission, by the sequence numbers
    /// `held` in a datagram of it, and that have not arrived. `backoff` draws the wait before each request.
    pub fn note_gaps(&mut self, now: Time, header: &Header, held: &[u32], backoff: impl FnMut() -> Span) {
        if held.is_empty() && self.gaps.is_empty() {
            return;
        }
        let Some(sender) = self.senders.get((header.sender, header.incarnation)) else { return };
        let space = &sender.spaces[usize::from(header.flags.has(Flags::DIRECT))];
        self.gaps.note(now, header, held, &space.window, backoff);
    }

    /// Records that another host requested these datagrams at `now`, so that this host does not request them at the
    /// same time.
    pub fn asked_by_others(&mut self, now: Time, ids: &[DatagramId]) {
        self.gaps.asked_by_others(now, ids);
    }

    /// Returns this host's next link report, of at most `room` bytes; `None` if not even its stamp fits.
    pub fn report(&mut self, now: Time, room: usize, occasion: Occasion) -> Option<Report> {
        let places = room.checked_sub(REPORT_BYTES)? / self.local.entry_bytes;
        let uptime = self.duplicate_ids.uptime(now);
        let (candidates, senders) = (&mut self.candidates, &mut self.senders);
        let heard = self.schedule.entries((now, uptime), places, occasion, candidates, senders);
        Some(Report { stamp: self.local.stamps.of(now), heard })
    }

    /// Returns how many times a message to the hosts in `audience` is to be repeated, 0 to 2, by the loss that they
    /// report; none while the link is congested, because they would make it worse.
    pub fn repeats(&self, now: Time, audience: Audience) -> u8 {
        if self.congestion.is_on(now) { 0 } else { self.senders.repeats(now, audience) }
    }

    /// Returns a summary of each other host on the link: of its accepted incarnations, or else of its newest candidate.
    pub fn peers(&self, now: Time) -> impl Iterator<Item = Peer> {
        let link = self.local.link;
        let accepted = self.senders.iter().map(move |(id, sender)| {
            let proven = !self.local.authenticated
                || (now.since(sender.proved) <= PROOF_VALIDITY && now.since(sender.reported) <= REPORT_VALIDITY);
            sender.peer(now, link, id, proven)
        });
        let us = self.local.host;
        let candidates = self.candidates.newest().filter(move |(host, _)| *host != us && !self.senders.knows(*host));
        candidates.map(move |(host, candidate)| Peer::candidate(now, link, host, &candidate)).chain(accepted)
    }
}
