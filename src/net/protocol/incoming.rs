//! Reception on a link: which incarnations are accepted, which datagrams are new, which are missing. Sends nothing.
//!
//! On a link with a key a sender is accepted once it proves its liveness: it echoes a stamp of this host that is no
//! older than `FRESH`. So a recording proves nothing, not even to a host that has just restarted. Of a host of the
//! deployment one incarnation is accepted; another replaces it after it has fallen silent. Operators are identified by
//! incarnation, and any number are accepted at once.

use super::bucket::Rate;
use super::candidates::{Candidates, Noted};
use super::codec::{Flags, Header};
use super::counts::LinkCounts;
use super::gaps::Gaps;
use super::limits::{FRESH, PROOF_HOLDS, REPORT_HOLDS, SILENT, UNHEARD};
use super::offset::Offsets;
use super::report::{Entry, DatagramId, REPORT_BYTES, Report, Stamps};
use super::router::Audience;
use super::sender::{Peer, Sender};
use super::senders::Senders;
use super::telling::{Occasion, Telling};
use super::twins::Twins;
use super::window::{Place, Window};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::Kind;
use crate::time::{Span, Time};

/// Datagrams of a second live host from which it is logged: a host restarted within `SILENT` sends fewer.
const TWINS_TO_LOG: u64 = 8;

/// Urgency of a report for another host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Prompt {
    /// With the next regular report.
    #[default]
    No,
    /// Piggybacked on the next datagram.
    Soon,
    /// Immediately.
    Now,
}

/// Outcome of the admission of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is new.
    New(Prompt),
    /// It is a duplicate; if its sender wants acknowledgements, one was lost.
    Again,
    /// It is refused: its sender has to prove its liveness first, and may wait for a report to do so.
    Unproven(Prompt),
    /// It is refused.
    Refused,
}

/// This host's identity and settings on one link.
#[derive(Clone, Copy, Debug)]
pub struct Here {
    /// The host.
    pub host: HostId,
    /// Its incarnation.
    pub epoch: u32,
    /// The link.
    pub link: LinkId,
    /// Whether senders have to prove their liveness: on a link with a key.
    pub guarded: bool,
    /// Smallest number of a guest: one that no host of the team has.
    pub first_guest: HostId,
    /// Bytes of an entry in its reports.
    pub entry_bytes: usize,
    /// Clock of its stamps.
    pub stamps: Stamps,
}

/// Liveness proof: an entry about this host that echoes a recent stamp of it.
#[derive(Clone, Copy, Debug)]
struct Proof {
    entry: Entry,
    /// Age of the echoed stamp.
    age: Span,
}

/// Reception state of one link.
#[derive(Clone, Debug)]
pub struct Incoming {
    here: Here,
    rate: Option<Rate>,
    senders: Senders,
    candidates: Candidates,
    /// Missing datagrams.
    pub gaps: Gaps,
    telling: Telling,
    /// Other processes with the id of this host.
    pub twins: Twins,
}

impl Incoming {
    /// Returns the initial state.
    pub fn new(here: Here, rate: Option<Rate>) -> Incoming {
        let telling = Telling::new(here.host, here.guarded, here.entry_bytes);
        let twins = Twins::new(here.link, here.host, here.epoch);
        let (senders, candidates) = (Senders::new(here.first_guest), Candidates::new(here.first_guest));
        Incoming { here, rate, senders, candidates, gaps: Gaps::default(), telling, twins }
    }

    /// Admits a datagram of this team with a valid tag.
    pub fn admit(&mut self, now: Time, header: &Header, report: Option<&Report>, counts: &mut LinkCounts) -> Verdict {
        let proof = report.and_then(|report| self.about_us(now, report));
        let known = match self.here.guarded {
            true => self.known(now, header, report, proof, counts),
            false => self.known_openly(now, header, counts),
        };
        if let Err(verdict) = known {
            return verdict;
        }
        let sender = self.senders.get_mut((header.sender, header.epoch)).expect("it is known by now");
        let lane = usize::from(header.flags.has(Flags::DIRECT));
        let window = &mut sender.lanes[lane].window;
        let late = self.here.guarded && sender.order.is_late(now, lane, header.sequence);
        if late && window.misses(header.sequence) && !self.gaps.awaits(header) {
            counts.late += 1;
            return Verdict::Refused;
        }
        match window.place(header.sequence, header.flags.has(Flags::COPY)) {
            Place::New => {}
            Place::Seen => {
                counts.duplicate += 1;
                return Verdict::Again;
            }
            Place::Behind if self.here.guarded => {
                counts.replay += 1;
                return Verdict::Refused;
            }
            // Without a key replays are not detected, and the newest message of a stream counts anyway.
            Place::Behind => {}
        }
        if let Some(rate) = &self.rate
            && !sender.bucket.take(now, rate)
        {
            counts.rate += 1;
            return Verdict::Refused;
        }
        sender.heard(now);
        let Some(report) = report else { return Verdict::New(Prompt::No) };
        let asked = sender.wants || (sender.listed.is_none() && sender.stamp.is_some());
        sender.stamped(now, report.stamp);
        if lane == 0 {
            let direct = proof.and_then(|proof| proof.entry.direct);
            sender.order.reported(now, [Some(header.sequence), direct]);
        }
        if let Some(Proof { entry, .. }) = proof {
            sender.proved = now;
            sender.offsets.measure(now, self.here.stamps.of(now), report.stamp, &entry);
            sender.wants |= entry.asks;
            sender.told_of_loss(now, entry.lost);
        }
        let asks = !asked && (sender.wants || sender.listed.is_none());
        Verdict::New(match asks {
            true if header.sender.is_operator() => Prompt::Now,
            true => Prompt::Soon,
            false => Prompt::No,
        })
    }

    /// Checks that this incarnation is accepted, on a link with a key; accepts it if the datagram proves its liveness.
    fn known(
        &mut self,
        now: Time,
        header: &Header,
        report: Option<&Report>,
        proof: Option<Proof>,
        counts: &mut LinkCounts,
    ) -> Result<(), Verdict> {
        let id = (header.sender, header.epoch);
        // A unicast report would not show where the sequence to all hosts stands.
        let proof = proof.filter(|_| !header.flags.has(Flags::DIRECT));
        let believed = self.senders.get_mut(id).filter(|sender| now.since(sender.proved) <= PROOF_HOLDS);
        match (believed, report) {
            (Some(sender), Some(report)) => {
                let off = sender.offsets.is_off(now, self.here.stamps.of(now), report.stamp, FRESH);
                if off && proof.is_none() {
                    counts.late += 1;
                    return Err(Verdict::Refused);
                } else if off {
                    // The echo shows that the report is recent although its stamp is not: the sender's clock has
                    // paused.
                    sender.offsets = Offsets::default();
                }
                return Ok(());
            }
            (Some(sender), None) if now.since(sender.reported) <= REPORT_HOLDS => return Ok(()),
            _ => {}
        }
        match (report, proof) {
            (Some(report), Some(proof)) => self.taken_up(now, header, report, proof, counts),
            _ => Err(self.noted(now, header, report, counts)),
        }
    }

    /// Notes a datagram of an incarnation without a liveness proof. It needs a report of this host to prove its
    /// liveness.
    #[cold]
    fn noted(&mut self, now: Time, header: &Header, report: Option<&Report>, counts: &mut LinkCounts) -> Verdict {
        let rival = self.senders.rival((header.sender, header.epoch)).and_then(|id| self.senders.get(id));
        if rival.is_some_and(|rival| rival.former == Some(header.epoch)) {
            counts.replay += 1;
            return Verdict::Refused;
        }
        counts.unproven += 1;
        // Without a report there is nothing to echo, and a stamp that is known adds nothing. So a repeated recording
        // gets no answer.
        let noted = report.map(|report| self.candidates.note(now, header.sender, header.epoch, report.stamp));
        match noted {
            Some(Noted::News) if header.sender.is_operator() => Verdict::Unproven(Prompt::Now),
            Some(Noted::News) => Verdict::Unproven(Prompt::Soon),
            Some(Noted::Known) => Verdict::Unproven(Prompt::No),
            Some(Noted::Old) | None => Verdict::Refused,
        }
    }

    /// Accepts an incarnation that proves its liveness.
    #[cold]
    fn taken_up(
        &mut self,
        now: Time,
        header: &Header,
        report: &Report,
        proof: Proof,
        counts: &mut LinkCounts,
    ) -> Result<(), Verdict> {
        let id = (header.sender, header.epoch);
        let mut sender = Sender::new(now, self.rate.as_ref());
        if let Some(rival) = self.senders.rival((header.sender, header.epoch)) {
            let other = self.senders.get_mut(rival).expect("it was found");
            if proof.age >= now.since(other.since) {
                // The echoed stamp predates the accepted incarnation: a recording.
                counts.replay += 1;
                return Err(Verdict::Refused);
            }
            if now.since(other.reported) < SILENT {
                counts.twin += 1;
                other.twins += 1;
                if other.twins >= TWINS_TO_LOG && other.twins.is_power_of_two() {
                    let (id, times) = (header.sender.0, other.twins);
                    tracing::error!("two live hosts have the id {id} (noticed {times} times): stop one of them");
                }
                self.candidates.note(now, header.sender, header.epoch, report.stamp);
                return Err(Verdict::Refused);
            }
            (sender.twins, sender.former) = (other.twins, Some(rival.1));
            self.senders.remove(rival);
        } else if let Some(before) = self.senders.get(id) {
            (sender.twins, sender.former) = (before.twins, before.former);
        } else if !self.senders.make_room(now, header.sender) {
            counts.crowd += 1;
            return Err(Verdict::Refused);
        }
        sender.lanes[0].window = Window::starting(header.sequence);
        if let Some(direct) = proof.entry.direct {
            sender.lanes[1].window = Window::starting(direct);
        }
        if self.candidates.forget(header.sender, header.epoch).is_some_and(|candidate| candidate.echoed > 0) {
            sender.listed = Some(now);
        }
        self.senders.insert(id, sender);
        Ok(())
    }

    /// The same without a key: every sender is accepted, one incarnation of a host at a time.
    fn known_openly(&mut self, now: Time, header: &Header, counts: &mut LinkCounts) -> Result<(), Verdict> {
        let id = (header.sender, header.epoch);
        if self.senders.get(id).is_some() {
            return Ok(());
        }
        let mut sender = Sender::new(now, self.rate.as_ref());
        if let Some(rival) = self.senders.rival((header.sender, header.epoch)) {
            let other = self.senders.get_mut(rival).expect("it was found");
            if other.age(now).is_some_and(|age| age < UNHEARD) {
                counts.twin += 1;
                other.twins += 1;
                return Err(Verdict::Refused);
            }
            sender.twins = other.twins;
            self.senders.remove(rival);
        } else if !self.senders.make_room(now, header.sender) {
            counts.crowd += 1;
            return Err(Verdict::Refused);
        }
        self.senders.insert(id, sender);
        Ok(())
    }

    /// Handles a report of another incarnation of this host: a live one, or a recording of a former run.
    #[cold]
    pub fn rival_of_us(&mut self, now: Time, header: &Header, report: &Report, counts: &mut LinkCounts) {
        self.candidates.note(now, header.sender, header.epoch, report.stamp);
        match self.about_us(now, report) {
            Some(proof) => {
                counts.twin += 1;
                self.twins.claim(now, header.epoch, proof.entry.held);
            }
            None => counts.unproven += 1,
        }
    }

    /// Returns the liveness proof in a report: an entry about this host with a recent echo.
    fn about_us(&self, now: Time, report: &Report) -> Option<Proof> {
        let about_us = report.heard.iter().filter(|entry| entry.host == self.here.host);
        about_us
            .filter_map(|entry| Some(Proof { entry: *entry, age: self.here.stamps.age(now, entry.echo)? }))
            .find(|proof| proof.age <= FRESH)
    }

    /// Whether a message about `robot` is the newest of its stream, and if so records it. All kinds are state, so an
    /// older message is useless.
    pub fn accept(&mut self, header: &Header, kind: Kind, robot: RobotId, counts: &mut LinkCounts) -> bool {
        let Some(sender) = self.senders.get_mut((header.sender, header.epoch)) else { return false };
        let newest = &mut sender.lanes[usize::from(header.flags.has(Flags::DIRECT))].newest;
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

    /// Notes the numbers that a new datagram offers and that have not arrived.
    pub fn note_gaps(&mut self, now: Time, header: &Header, held: &[u32], backoff: impl FnMut() -> Span) {
        if held.is_empty() && self.gaps.is_empty() {
            return;
        }
        let Some(sender) = self.senders.get((header.sender, header.epoch)) else { return };
        let lane = &sender.lanes[usize::from(header.flags.has(Flags::DIRECT))];
        self.gaps.note(now, header, held, &lane.window, backoff);
    }

    /// Notes requests of another host.
    pub fn asked_by_others(&mut self, now: Time, ids: &[DatagramId]) {
        self.gaps.asked_by_others(now, ids);
    }

    /// Returns the next report, in at most `room` bytes.
    pub fn report(&mut self, now: Time, room: usize, occasion: Occasion) -> Option<Report> {
        let places = room.checked_sub(REPORT_BYTES)? / self.here.entry_bytes;
        let uptime = self.twins.uptime(now);
        let (candidates, senders) = (&mut self.candidates, &mut self.senders);
        let heard = self.telling.entries((now, uptime), places, occasion, candidates, senders);
        Some(Report { stamp: self.here.stamps.of(now), heard })
    }

    /// Returns the number of repeats of a message to these hosts, by their reported loss.
    pub fn repeats(&self, now: Time, audience: Audience) -> u8 {
        self.senders.repeats(now, audience)
    }

    /// Returns summaries of all other hosts; of a host without an accepted incarnation, that of the newest candidate.
    pub fn peers(&self, now: Time) -> impl Iterator<Item = Peer> {
        let link = self.here.link;
        let believed = self.senders.iter().map(move |(id, sender)| {
            let proven = !self.here.guarded
                || (now.since(sender.proved) <= PROOF_HOLDS && now.since(sender.reported) <= REPORT_HOLDS);
            sender.peer(now, link, id, proven)
        });
        let us = self.here.host;
        let candidates = self.candidates.newest().filter(move |(host, _)| *host != us && !self.senders.knows(*host));
        candidates.map(move |(host, candidate)| Peer::candidate(now, link, host, &candidate)).chain(believed)
    }
}
