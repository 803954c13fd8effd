//! What arrives on a link: who is believed, what is new, what is missing. Decides; sends nothing.
//!
//! On a link with a key a sender is let in only once it has shown that it is alive now: it echoes a stamp of this host
//! that is no older than `FRESH`. So a recording proves nothing, not even to a host that has just been restarted.

use std::collections::BTreeMap;

use super::bucket::Rate;
use super::codec::{Flags, Header};
use super::counts::LinkCounts;
use super::report::{ENTRY_BYTES, Entry, Name, REPORT_BYTES, Report, Stamp};
use super::sender::{Peer, Sender};
use super::window::{LOSS_SPAN, Place, Window};
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::Kind;
use crate::net::router::Audience;
use crate::time::{Span, Time};

/// The most senders that are remembered on a link.
pub const MAX_SENDERS: usize = 1024;
/// How old an echo may be and still show that its sender is alive; and how long a stamp is echoed.
pub const FRESH: Span = Span::from_millis(2000);
/// How long after showing that it is alive a sender is believed: what was held back for longer is worth nothing.
pub const PROOF_HOLDS: Span = Span::from_millis(5000);
/// Reported loss from which a message is repeated: 2 of 64, about 3 %.
pub const LOSS_TO_REPEAT: u8 = 2;
/// Reported loss from which it is repeated twice: 40 %.
pub const LOSS_TO_REPEAT_TWICE: u8 = 26;
/// How long a report asks for repeats.
const ASKS_FOR: Span = Span::from_millis(2000);
/// How long a sender is remembered in silence, once there are too many.
const FORGET: Span = Span::from_millis(10_000);
/// The most datagrams that are known to be missing.
const MAX_GAPS: usize = 256;
/// How often a missing datagram is asked for.
const ASKS: u32 = 3;
/// The longest random wait before asking, so that one asks for all (RFC 5401, section 3.2).
pub const BACKOFF: Span = Span::from_millis(10);

/// What becomes of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is new.
    New,
    /// It was here; whoever wants acknowledgements has missed one.
    Again,
    /// It is not let in.
    Refused {
        /// Its sender should hear from us soon, so that it can prove itself.
        prompt: bool,
    },
}

/// A datagram that is missing.
#[derive(Clone, Copy, Debug)]
struct Gap {
    due: Time,
    asked: u32,
}

/// Everything that has arrived on one link.
#[derive(Clone, Debug)]
pub struct Incoming {
    host: HostId,
    epoch: u32,
    /// Whether senders have to prove themselves.
    guarded: bool,
    rate: Option<Rate>,
    senders: BTreeMap<HostId, Sender>,
    forgot: Time,
    gaps: BTreeMap<Name, Gap>,
    /// Whether somebody is believed who has had no echo of ours yet, and so cannot believe us.
    owes: bool,
    /// Where the next report goes on, when there are more hosts than one report holds.
    turn: usize,
}

impl Incoming {
    /// Nothing yet.
    pub fn new(host: HostId, epoch: u32, guarded: bool, rate: Option<Rate>) -> Incoming {
        let (senders, gaps) = (BTreeMap::new(), BTreeMap::new());
        Incoming { host, epoch, guarded, rate, senders, forgot: Time::ZERO, gaps, owes: false, turn: 0 }
    }

    /// Takes up a datagram of this team whose tag is right.
    pub fn admit(&mut self, now: Time, header: &Header, report: Option<&Report>, counts: &mut LinkCounts) -> Verdict {
        if let Err(verdict) = self.known(now, header, report, counts) {
            return verdict;
        }
        let sender = self.senders.get_mut(&header.sender).expect("it is known by now");
        let direct = header.flags.has(Flags::DIRECT);
        let copy = header.flags.has(Flags::COPY);
        match sender.lanes[usize::from(direct)].window.place(header.sequence, copy) {
            Place::New => {}
            Place::Seen => {
                counts.duplicate += 1;
                return Verdict::Again;
            }
            Place::Behind if self.guarded => {
                counts.replay += 1;
                return Verdict::Refused { prompt: false };
            }
            // Without a key there is no replay to fear, and newest wins all the same.
            Place::Behind => {}
        }
        if let Some(rate) = &self.rate
            && !sender.bucket.take(now, rate)
        {
            counts.rate += 1;
            return Verdict::Refused { prompt: false };
        }
        sender.heard(now);
        if let Some(report) = report {
            self.owes |= sender.stamp.is_none();
            sender.stamp = Some((report.stamp, now));
            if let Some(entry) = self.about_us(now, report) {
                let sender = self.senders.get_mut(&header.sender).expect("it is known");
                sender.proved = now;
                sender.offsets.measure(now, report.stamp, entry);
                sender.told_lost = entry.lost.min(LOSS_SPAN as u8);
                for (asks, from) in sender.asks.iter_mut().zip([LOSS_TO_REPEAT, LOSS_TO_REPEAT_TWICE]) {
                    if entry.lost >= from {
                        *asks = now + ASKS_FOR;
                    }
                }
            }
        }
        Verdict::New
    }

    /// Whether this incarnation of the sender is the one that is believed.
    fn known(
        &mut self,
        now: Time,
        header: &Header,
        report: Option<&Report>,
        counts: &mut LinkCounts,
    ) -> Result<(), Verdict> {
        const REFUSED: Verdict = Verdict::Refused { prompt: false };
        // A report to one host alone would not show where the datagrams to all stand.
        let proof = report.filter(|_| !header.flags.has(Flags::DIRECT)).and_then(|report| self.about_us(now, report));
        let proof = proof.copied();
        let taken_up = |rate: Option<&Rate>, guarded: bool| {
            let mut sender = Sender::new(now, header.epoch, !guarded || proof.is_some(), rate);
            if let Some(entry) = proof.filter(|_| guarded) {
                sender.lanes[0].window = Window::starting(header.sequence);
                sender.lanes[1].window = Window::starting(entry.direct);
            }
            sender.stamp = report.map(|report| (report.stamp, now));
            sender
        };
        let Some(sender) = self.senders.get_mut(&header.sender) else {
            if !self.room(now) {
                counts.crowd += 1;
                return Err(REFUSED);
            }
            let sender = taken_up(self.rate.as_ref(), self.guarded);
            let proven = sender.proven;
            self.owes |= proven && report.is_some();
            self.senders.insert(header.sender, sender);
            return if proven { Ok(()) } else { Err(unproven(counts)) };
        };
        if header.epoch < sender.epoch {
            // Whoever echoes what we said after its successor had come is alive beside it.
            if proof.is_some_and(|entry| entry.echo > sender.since) {
                counts.twin += 1;
                sender.twins += 1;
                if sender.twins.is_power_of_two() {
                    let (id, times) = (header.sender.0, sender.twins);
                    tracing::error!("two live hosts have the id {id} (noticed {times} times): stop one of them");
                }
            } else if self.guarded {
                counts.replay += 1;
            } else {
                counts.stale += 1;
            }
            return Err(REFUSED);
        }
        let later = header.epoch > sender.epoch;
        if self.guarded && now.since(sender.proved) > PROOF_HOLDS {
            sender.proven = false;
        }
        if !later && sender.proven {
            return Ok(());
        }
        if !self.guarded || proof.is_some() {
            let twins = sender.twins;
            *sender = taken_up(self.rate.as_ref(), self.guarded);
            sender.twins = twins;
            self.owes |= report.is_some();
            return Ok(());
        }
        if let Some(report) = report {
            if later {
                sender.challenger = Some((header.epoch, report.stamp, now));
            } else {
                sender.stamp = Some((report.stamp, now));
            }
        }
        Err(unproven(counts))
    }

    /// What a report says of this host, if it can only have been written just now.
    fn about_us<'a>(&self, now: Time, report: &'a Report) -> Option<&'a Entry> {
        let oldest = now.as_nanos().saturating_sub(FRESH.as_nanos());
        let fresh = Stamp::of(Time::from_nanos(oldest))..=Stamp::of(now);
        report
            .heard
            .iter()
            .find(|entry| entry.host == self.host && entry.epoch == self.epoch && fresh.contains(&entry.echo))
    }

    fn room(&mut self, now: Time) -> bool {
        // Not for every datagram: whoever makes up senders must not make us search.
        if self.senders.len() >= MAX_SENDERS && now.since(self.forgot) >= FORGET {
            self.forgot = now;
            self.senders.retain(|_, sender| sender.age(now).is_some_and(|age| age < FORGET));
        }
        self.senders.len() < MAX_SENDERS
    }

    /// Whether a message about `robot` is the newest of its stream; all kinds are state, so an older one is worth
    /// nothing.
    pub fn accept(&mut self, header: &Header, kind: Kind, robot: RobotId, counts: &mut LinkCounts) -> bool {
        let Some(sender) = self.senders.get_mut(&header.sender) else { return false };
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

    /// A new datagram says what its sender still holds: whatever of it has not been here is missing. `backoff` draws
    /// how long to wait before asking. Only what is held is asked for, so requests never breed requests.
    pub fn note_gaps(&mut self, now: Time, header: &Header, held: &[u32], mut backoff: impl FnMut() -> Span) {
        if held.is_empty() && self.gaps.is_empty() {
            return;
        }
        let (host, epoch, direct) = (header.sender, header.epoch, header.flags.has(Flags::DIRECT));
        let name = |sequence| Name { host, epoch, direct, sequence };
        self.gaps.remove(&name(header.sequence));
        let Some(sender) = self.senders.get(&host) else { return };
        let window = &sender.lanes[usize::from(direct)].window;
        for &sequence in held.iter().filter(|sequence| window.misses(**sequence)) {
            if self.gaps.len() < MAX_GAPS {
                self.gaps.entry(name(sequence)).or_insert_with(|| Gap { due: now + backoff(), asked: 0 });
            }
        }
    }

    /// Another host has asked for these: whoever asks a second time is late.
    pub fn asked_by_others(&mut self, now: Time, names: &[Name]) {
        for name in names {
            if let Some(gap) = self.gaps.get_mut(name) {
                gap.due = gap.due.max(now + BACKOFF * 2);
            }
        }
    }

    /// When something is to be asked for.
    pub fn gaps_due(&self) -> Option<Time> {
        self.gaps.values().map(|gap| gap.due).min()
    }

    /// What is to be asked for now, at most `room` datagrams.
    pub fn ask(&mut self, now: Time, room: usize, mut backoff: impl FnMut() -> Span) -> Vec<Name> {
        let mut names = Vec::new();
        for (name, gap) in &mut self.gaps {
            if gap.due <= now && names.len() < room {
                names.push(*name);
                gap.asked += 1;
                gap.due = now + BACKOFF * (1 << gap.asked) + backoff();
            }
        }
        self.gaps.retain(|_, gap| gap.asked < ASKS);
        names
    }

    /// Whether the others should hear from this host soon: somebody waits for an echo.
    pub fn owes(&self) -> bool {
        self.owes
    }

    /// What to tell the others, in at most `room` bytes; whoever waits for it to prove itself comes first.
    pub fn report(&mut self, now: Time, room: usize) -> Option<Report> {
        let places = room.checked_sub(REPORT_BYTES)? / ENTRY_BYTES;
        let echo = |stamp: Option<(Stamp, Time)>| {
            let fresh = stamp.filter(|(_, at)| now.since(*at) < FRESH);
            fresh.map_or((Stamp::default(), Span::ZERO), |(stamp, at)| (stamp, now.since(at)))
        };
        let (mut waiting, mut others) = (Vec::new(), Vec::new());
        for (&host, sender) in &self.senders {
            let entry = |epoch, (echo, held), lost| Entry { host, epoch, echo, held, lost, direct: 0 };
            if let Some((epoch, stamp, at)) = sender.challenger.filter(|(.., at)| now.since(*at) < FRESH) {
                waiting.push(entry(epoch, echo(Some((stamp, at))), 0));
            }
            let stamped = sender.stamp.is_some_and(|(_, at)| now.since(at) < FRESH);
            let heard = sender.age(now).is_some_and(|age| age < FRESH);
            match sender.proven {
                true if heard => others.push(entry(sender.epoch, echo(sender.stamp), sender.lost())),
                false if stamped => waiting.push(entry(sender.epoch, echo(sender.stamp), 0)),
                _ => {}
            }
        }
        let turn = self.turn.checked_rem(others.len()).unwrap_or(0);
        others.rotate_left(turn);
        waiting.extend(others);
        // All of them had their turn, or the next report goes on where this one ends.
        self.turn = if waiting.len() > places { self.turn.wrapping_add(places.max(1)) } else { 0 };
        waiting.truncate(places);
        self.owes = false;
        Some(Report { stamp: Stamp::of(now), heard: waiting })
    }

    /// How many times a message to these hosts is to be repeated, by what they report.
    pub fn repeats(&self, now: Time, audience: Audience) -> u8 {
        let asked = |sender: &Sender| sender.asks.iter().filter(|until| **until > now).count() as u8;
        match audience {
            Audience::Host(host) => self.senders.get(&host).map_or(0, asked),
            Audience::All => self.senders.values().map(asked).max().unwrap_or(0),
        }
    }

    /// All that is known of the others.
    pub fn peers(&self, now: Time, link: LinkId) -> impl Iterator<Item = Peer> {
        self.senders.iter().map(move |(&host, sender)| sender.peer(now, link, host))
    }
}

fn unproven(counts: &mut LinkCounts) -> Verdict {
    counts.unproven += 1;
    Verdict::Refused { prompt: true }
}
