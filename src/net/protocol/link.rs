//! State of one link of one host: transmission (`outgoing`), reception (`incoming`) and counters. Pure, without sockets
//! and clock.

use std::collections::BTreeSet;
use std::net::SocketAddr;

use rand::RngExt;

use super::bucket::{Bucket, Rate};
use super::codec::{self, DecodeError, EncodeError, Flags, Frame, HEADER_BYTES, Header, MAX_FRAME_BYTES, TAG_BYTES};
use super::control_blocks::ControlBlocks;
pub use super::counts::{LinkCounts, Refusal};
pub use super::duplicate_id::DuplicateId;
use super::gaps::backoff;
use super::incoming::{Admission, Incoming, LocalEnd, Urgency};
use super::key::Key;
use super::outgoing::{Outbound, Outgoing, REPORT_PERIOD};
use super::parts::Lacking;
use super::reliability::{Reports, Setup};
use super::report::{DatagramId, ENTRY_BYTES, MAX_IDS, NUMBERED_ENTRY_BYTES, Stamps};
use super::router::Audience;
use super::sender::Peer;
use super::senders::MAX_SENDERS;
use super::ways::Sending;
use crate::messages::ids::{HostId, LinkId};
use crate::messages::wire::{Stop, Wire};
use crate::random::Stream;
use crate::time::{Span, Time};

/// Identity of a host on its links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// Id of the host.
    pub host: HostId,
    /// Team number of the host.
    pub team: u16,
    /// Incarnation of the host: a random number drawn at each start.
    pub incarnation: u32,
}

/// Whether data may be sent to the address that a host's last datagram came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// The sender has not proved its liveness yet, or not from this address, and needs reports of this host to do so.
    Candidate,
    /// The sender has proved its liveness or the link has no key, and its last datagram was new.
    Accepted,
}

/// Sender of the last datagram on a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Arrival {
    /// Id of the host.
    pub(crate) host: HostId,
    /// Whether the host is accepted, or has to prove its liveness first.
    pub(crate) standing: Standing,
    /// Whether this very datagram proves the sender's liveness, so that it is no recording. Always true on a link
    /// without a key.
    pub(crate) proves: bool,
}

/// Host whose address is learned from its datagrams: an operator, or a host of the team that has moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Guest {
    /// Id of the host.
    pub host: HostId,
    /// Source address of the host's last datagram.
    pub at: SocketAddr,
    /// Whether the host is accepted, or has to prove its liveness first.
    pub standing: Standing,
}

/// State of one link of one host: transmission, reception and counters.
#[derive(Clone, Debug)]
pub struct LinkState {
    pub(super) me: Identity,
    pub(super) id: LinkId,
    pub(super) key: Option<Key>,
    /// Smallest host id that is no host of the team.
    pub(super) first_guest: HostId,
    reports: Reports,
    pub(super) incoming: Incoming,
    pub(super) outgoing: Outgoing,
    pub(super) counts: LinkCounts,
    /// Time at which the next action is due; cached, since it is read far more often than it changes.
    due: Option<Time>,
    /// Sender of the last datagram; `None` if it was neither new nor of a candidate.
    heard: Option<Arrival>,
    /// Cause for which the last datagram was refused without any effect but its count; `None` for others.
    refusal: Option<Refusal>,
    /// Emergency stop in the last datagram, if it holds although the datagram was refused for its number.
    pub(super) urgent: Option<Stop>,
    /// Parts of messages that the sender of the last datagram has not received.
    pub(super) lacking: Vec<Lacking>,
    /// Limit of the acknowledgements that are sent again for copies of datagrams.
    again: Bucket,
    /// Hosts of the team of which datagrams of the former version of the wire format have arrived.
    former: BTreeSet<HostId>,
}

/// Limit of the acknowledgements that are sent again on a link because a datagram has come again: anybody can send
/// copies. Without one, a sender sends its datagram once more, or gives it up although it has arrived.
const AGAIN: Rate = Rate { per_s: 200.0, burst: 200.0 };

impl LinkState {
    /// Returns the state of a link at the start of this host. With a `key`, link reports are always sent, since they
    /// prove liveness. Stamps start at a number drawn from `stream`, which must be unpredictable on a real host.
    pub fn new(me: Identity, id: LinkId, key: Option<Key>, mut setup: Setup, stream: &mut Stream) -> LinkState {
        if key.is_some() {
            setup.reports = Reports::On;
        }
        let Identity { host, team, incarnation } = me;
        let jitter = Span::from_nanos(stream.random_range(0..=REPORT_PERIOD.as_nanos()));
        let first = if setup.report_piggyback_age == Span::ZERO { Span::ZERO } else { REPORT_PERIOD + jitter };
        let header = Header { flags: Flags::default(), team, sender: host, incarnation, sequence: 0 };
        let authenticated = key.is_some();
        let entry_bytes = if authenticated && setup.is_addressed() { NUMBERED_ENTRY_BYTES } else { ENTRY_BYTES };
        let first_guest = setup.hosts.map_or(HostId::operator(0), HostId);
        let local = LocalEnd {
            host,
            incarnation,
            link: id,
            authenticated,
            first_guest,
            entry_bytes,
            slows: setup.slows_reports(),
            stamps: Stamps::random(stream),
        };
        let mut state = LinkState {
            me,
            id,
            first_guest,
            reports: setup.reports,
            incoming: Incoming::new(local, setup.rate),
            outgoing: Outgoing::new(header, id, key.clone(), setup, first),
            key,
            counts: LinkCounts::default(),
            due: None,
            heard: None,
            refusal: None,
            urgent: None,
            lacking: Vec::new(),
            again: Bucket::full(Time::ZERO, &AGAIN),
            former: BTreeSet::new(),
        };
        state.save_airtime();
        state.plan();
        state
    }

    pub(super) fn plan(&mut self) {
        self.due = [self.outgoing.due(), self.incoming.gaps.due()].into_iter().flatten().min();
    }

    /// Sends a message to the hosts in `audience`: appends the datagrams that are due at `now` to `out`. Returns the
    /// message as a datagram without tag. Fails if the message is out of range or too long.
    pub fn send(
        &mut self,
        now: Time,
        audience: Audience,
        message: &Wire,
        out: &mut Vec<Outbound>,
    ) -> Result<Frame, EncodeError> {
        self.incoming.duplicate_ids.uptime(now);
        let encoded = self.outgoing.send(now, audience, message, &mut self.incoming, &mut self.counts, out);
        self.plan();
        encoded
    }

    /// Handles the received datagram `frame`. Returns its header and its bytes without the tag; `None` if it is refused
    /// or a duplicate. Appends replies to `out`; random waits are drawn from `stream`.
    pub fn admit<'a>(
        &mut self,
        now: Time,
        frame: &'a [u8],
        stream: &mut Stream,
        out: &mut Vec<Outbound>,
    ) -> Option<codec::Opened<'a>> {
        (self.heard, self.refusal, self.urgent) = (None, None, None);
        self.lacking.clear();
        let read = self.read(now, frame, stream, out);
        match read {
            Ok(admitted) => {
                self.plan();
                admitted
            }
            Err(cause) => {
                self.refusal = Some(cause);
                self.counts.refuse(cause, 1);
                None
            }
        }
    }

    /// Returns the cause for which the last datagram was refused, if nothing but the count of it has changed.
    pub(crate) fn refusal(&self) -> Option<Refusal> {
        self.refusal
    }

    fn read<'a>(
        &mut self,
        now: Time,
        frame: &'a [u8],
        stream: &mut Stream,
        out: &mut Vec<Outbound>,
    ) -> Result<Option<codec::Opened<'a>>, Refusal> {
        let (header, plain) = self.open(frame)?;
        let mut blocks = ControlBlocks::read(&plain).map_err(|error| Refusal::of(&error))?;
        let report = blocks.report.as_ref();
        // Operators draw their ids at random, so two of them may have the same.
        let own_id = header.sender == self.me.host && !header.sender.is_operator();
        let refusal = match own_id {
            true => self.incoming.refuses_own_id(now, &header, report),
            false => self.incoming.refuses(now, &header, report),
        };
        if let Some(refusal) = refusal.filter(|refusal| !self.acknowledges_again(now, &header, *refusal)) {
            let waits = refusal == Refusal::Unproven && self.incoming.is_of_waiting(now, &header, report);
            if waits {
                self.heard = Some(Arrival { host: header.sender, standing: Standing::Candidate, proves: false });
            }
            if refusal == Refusal::Duplicate && self.outgoing.completes(now, &header, blocks.pair) {
                self.counts.duplicate += 1;
                return Ok(None);
            }
            let stop = if refusal == Refusal::Unproven { None } else { self.new_stop(now, &header, &plain) };
            let Some(stop) = stop else { return Err(refusal) };
            self.urgent = stop;
            self.counts.refuse(refusal, 1);
            return Ok(None);
        }
        self.incoming.duplicate_ids.uptime(now);
        if own_id {
            self.note_duplicate_id(now, &header, &blocks);
            return Ok(None);
        }
        let verdict = self.incoming.admit(now, &header, blocks.report.as_ref(), &mut self.counts);
        match verdict {
            Admission::New(urgency) | Admission::Candidate(urgency) => self.outgoing.request_report(now, urgency),
            Admission::Duplicate | Admission::Refused => {}
        }
        self.tell_news(verdict);
        let standing = match verdict {
            Admission::New(_) => Some(Standing::Accepted),
            Admission::Candidate(_) => Some(Standing::Candidate),
            Admission::Duplicate | Admission::Refused => None,
        };
        let proves = self.key.is_none() || self.incoming.has_proved();
        self.heard = standing.map(|standing| Arrival { host: header.sender, standing, proves });
        if matches!(verdict, Admission::Duplicate | Admission::Refused) {
            self.urgent = self.new_stop(now, &header, &plain).flatten();
        }
        if matches!(verdict, Admission::Candidate(_) | Admission::Refused) {
            return Ok(None);
        }
        if header.flags.has(Flags::ACK) {
            self.outgoing.acknowledge(now, DatagramId::of(&header));
        }
        if verdict == Admission::Duplicate {
            return Ok(None);
        }
        self.counts.skipped += blocks.skipped;
        self.outgoing.note_arrival(now, &header, blocks.pair);
        self.lacking = std::mem::take(&mut blocks.lacking);
        self.incoming.note_gaps(now, &header, &blocks.held, || backoff(stream));
        if !(blocks.acks.is_empty() && blocks.requests.is_empty()) {
            self.answer(now, header.sender, blocks, out);
        }
        Ok(Some((header, plain)))
    }

    /// Checks the length and the tag of a datagram, and that another process of this team has sent it. Returns its
    /// header and its bytes without the tag.
    fn open<'a>(&mut self, frame: &'a [u8]) -> Result<codec::Opened<'a>, Refusal> {
        let tagged = frame.get(codec::FLAGS_AT).is_some_and(|flags| flags & Flags::TAGGED != 0);
        let shortest = HEADER_BYTES + if self.key.is_some() { TAG_BYTES } else { 0 };
        if frame.len() < shortest || frame.len() > MAX_FRAME_BYTES {
            return Err(Refusal::Malformed);
        }
        let plain = match &self.key {
            Some(key) => key.open(frame, self.id, self.me.host),
            None => (!tagged).then_some(frame.into()),
        };
        let plain = plain.ok_or_else(|| self.key_trouble(frame).unwrap_or(Refusal::Auth))?;
        let header = codec::peek(&plain).map_err(|error| Refusal::of(&error))?;
        if header.team != self.me.team {
            return Err(Refusal::Team);
        }
        if !codec::is_current(&plain) {
            // Where the deployment is not known, only so many are noted.
            let known = header.sender < self.first_guest && self.former.len() < MAX_SENDERS;
            self.former.extend(known.then_some(header.sender));
            return Err(Refusal::Version);
        }
        if (header.sender, header.incarnation) == (self.me.host, self.me.incarnation) {
            return Err(Refusal::Own);
        }
        Ok((header, plain))
    }

    /// Returns whether a datagram that is refused for this cause is a copy whose acknowledgement is sent again.
    fn acknowledges_again(&mut self, now: Time, header: &Header, cause: Refusal) -> bool {
        cause == Refusal::Duplicate
            && header.flags.has(Flags::ACK)
            && !self.outgoing.acknowledges(&DatagramId::of(header))
            && self.again.has(now, &AGAIN)
            && self.again.take(now, &AGAIN)
    }

    /// Handles a datagram of another process that uses the id of this host: a second live one, or a recording.
    #[cold]
    fn note_duplicate_id(&mut self, now: Time, header: &Header, blocks: &ControlBlocks) {
        self.outgoing.hasten_report();
        match (&self.key, &blocks.report) {
            (Some(_), Some(report)) => self.incoming.note_duplicate_id(now, header, report, &mut self.counts),
            (Some(_), None) => self.counts.unproven += 1,
            (None, _) => self.counts.duplicate_id += 1,
        }
    }

    /// Handles the acknowledgements and retransmission requests of the host `from`.
    #[inline(never)]
    fn answer(&mut self, now: Time, from: HostId, blocks: ControlBlocks, out: &mut Vec<Outbound>) {
        let mine = |ids: Vec<DatagramId>| -> (Vec<DatagramId>, Vec<DatagramId>) {
            ids.into_iter().partition(|id| (id.host, id.incarnation) == (self.me.host, self.me.incarnation))
        };
        if !blocks.acks.is_empty() {
            self.outgoing.acknowledged(now, from, &mine(blocks.acks).0);
        }
        if !blocks.requests.is_empty() {
            let (mine, others) = mine(blocks.requests);
            self.incoming.asked_by_others(now, &others);
            self.outgoing.requested(now, from, &mine, &mut self.counts, out);
        }
    }

    /// Returns another live host that has the id of this host and was started earlier; `None` if there is none.
    pub(crate) fn duplicate(&self) -> Option<DuplicateId> {
        self.incoming.duplicate_ids.duplicate()
    }

    /// Returns the sender of the last datagram, and whether it is accepted or has to prove its liveness first. `None`
    /// if the datagram was a duplicate, or refused for another reason.
    pub(crate) fn heard(&self) -> Option<Arrival> {
        self.heard
    }

    /// Sends a link report of its own soon, which lists the accepted host `host`, so that it can prove its liveness
    /// from another address.
    #[cold]
    pub(crate) fn invite(&mut self, now: Time, host: HostId) {
        self.incoming.list_soon(host);
        self.outgoing.request_report(now, Urgency::Immediate);
        self.plan();
    }

    /// Counts a datagram that could not be decoded, by the cause `error`.
    #[cold]
    pub(crate) fn refuse(&mut self, error: &DecodeError) {
        self.counts.refuse(Refusal::of(error), 1);
    }

    /// Returns the hosts of the team that are accepted, each with its incarnation.
    pub(crate) fn hosts(&self) -> impl Iterator<Item = (HostId, u32)> {
        self.incoming.senders.iter().map(|(id, _)| id).filter(|(host, _)| *host < self.first_guest)
    }

    /// Returns the hosts of the team that are accepted and were heard in the last `within`.
    pub(crate) fn neighbours(&self, now: Time, within: Span) -> impl Iterator<Item = HostId> {
        let senders = self.incoming.senders.iter();
        let near = senders.filter(move |(_, sender)| sender.age(now).is_some_and(|age| age <= within));
        near.map(|((host, _), _)| host).filter(|host| *host < self.first_guest)
    }

    /// Returns the counters of the link, to be changed.
    pub(crate) fn counts(&mut self) -> &mut LinkCounts {
        &mut self.counts
    }

    /// Returns the counters of the link so far.
    pub(crate) fn counted(&self) -> LinkCounts {
        self.counts
    }

    /// Returns a summary of each other host (such as delay and loss); nothing on a link without link reports.
    pub(crate) fn peers(&self, now: Time) -> impl Iterator<Item = Peer> {
        let told = self.reports == Reports::On;
        let former = self.former.iter().filter(|host| !self.incoming.senders.knows(**host));
        let former = former.map(move |host| Peer::former(now, self.id, *host));
        let sends = self.outgoing.choice.as_ref().map(|choice| choice.decision().to_string());
        let peers = self.incoming.peers(now).chain(former).filter(move |_| told);
        peers.map(move |peer| Peer { sends: sends.clone(), ..peer })
    }

    /// Returns how this host sends on a link that chooses; `None` if its way is fixed.
    pub(crate) fn sending(&self, now: Time) -> Option<Sending> {
        self.outgoing.choice.as_ref().map(|choice| choice.told(now, self.id))
    }

    /// Returns the time at which `wake` has to be called next; `None` if nothing is due.
    pub fn due(&self) -> Option<Time> {
        self.due
    }

    /// Sends what is due at `now`, such as reports and retransmissions: appends the datagrams to `out`. Random waits
    /// are drawn from `stream`.
    pub fn wake(&mut self, now: Time, stream: &mut Stream, out: &mut Vec<Outbound>) {
        self.incoming.duplicate_ids.uptime(now);
        self.outgoing.wake(now, &mut self.incoming, &mut self.counts, out);
        if self.incoming.gaps.due().is_some_and(|due| due <= now) {
            let ids = self.incoming.gaps.ask(now, MAX_IDS, || backoff(stream));
            if !ids.is_empty() {
                self.outgoing.ask(&ids, &mut self.counts, out);
            }
        }
        self.plan();
    }
}
