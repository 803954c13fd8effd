//! Soft state on a mesh: what each host says to all or to the state server, as others pass it on hop by hop. Pure.
//!
//! A host makes an **entry** of its newest heartbeat, instruction, status or release, with a number and a proof of its
//! own (`proof`). Entries leave in datagrams that are sent anyway; each host says each entry of another twice, unless
//! many neighbours have (`pool`). A number alone does not show that an entry is not held back or recorded. So the state
//! server echoes the newest number of each robot's host, and these echo the server's (`echoes`): what is older than two
//! seconds by its reader's own clock is not believed. Starts and goals travel once, by their digest (`lead`).

mod echoes;
mod entry;
mod last_hops;
mod lead;
mod own;
mod pool;
mod proof;
#[cfg(test)]
mod tests;
mod withholding;

use std::collections::BTreeMap;

use self::echoes::Echoes;
pub(crate) use self::entry::{Block, Content};
use self::entry::{Entry, EntryId};
use self::last_hops::LastHops;
use self::lead::{Digest, Layout, Lead};
use self::own::Own;
use self::pool::Pool;
use self::proof::{Checks, Verdict};
use self::withholding::Withholding;
use super::codec::{self, Frame};
use super::counts::LinkCounts;
use super::key::Key;
use super::link::Identity;
use super::ways::LastHop;
use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::{Kind, Wire};
use crate::random::Stream;
use crate::time::{Span, Time};

/// Largest number of entries in a datagram, and of bytes that these take: a third of what a datagram has room for.
const MOST_ENTRIES: usize = 10;
const MOST_BYTES: usize = 420;
/// Number of robots beyond which none is the first of an instruction.
const MOST_ROBOTS: usize = 1024;
/// Longest time that an entry waits for a datagram with data.
const WAIT: Span = Span::from_millis(100);
/// Time since a message has arrived from its publisher itself during which what others pass on of it is not read: the
/// order of the two is not known.
const DIRECT: Span = Span::from_millis(500);

/// Soft state of a team, as one host says it, passes it on and believes it.
#[derive(Clone, Debug)]
pub(crate) struct Relay {
    me: Identity,
    /// Host of the state server.
    server: HostId,
    own: Own,
    pool: Pool,
    echoes: Echoes,
    checks: BTreeMap<HostId, Checks>,
    /// Newest number of each stream that was believed, with the incarnation of its origin.
    believed: BTreeMap<EntryId, (u32, u32)>,
    /// Time at which each message last arrived from its publisher itself.
    direct: BTreeMap<(HostId, Kind, RobotId), Time>,
    /// Newest instruction, of which the layout may be missing, for each first robot.
    leads: BTreeMap<RobotId, Lead>,
    layouts: BTreeMap<RobotId, Layout>,
    /// Digests of the layouts that the newest leads with a sound proof name, fresh or not.
    named: BTreeMap<RobotId, Digest>,
    /// Time since which something waits to be said; `None` if nothing does.
    waits: Option<Time>,
    counts: LinkCounts,
    withholding: Withholding,
    ways: LastHops,
}

impl Relay {
    /// Returns the state of a host that has just started; `server` is the host of the state server. Numbers begin at
    /// one drawn from `stream`.
    pub fn new(me: Identity, server: HostId, stream: &mut Stream) -> Relay {
        Relay {
            me,
            server,
            own: Own::default(),
            pool: Pool::default(),
            echoes: Echoes::new(stream),
            checks: BTreeMap::new(),
            believed: BTreeMap::new(),
            direct: BTreeMap::new(),
            leads: BTreeMap::new(),
            layouts: BTreeMap::new(),
            named: BTreeMap::new(),
            waits: None,
            counts: LinkCounts::default(),
            withholding: Withholding::default(),
            ways: LastHops::default(),
        }
    }

    /// Returns the counts so far, of which those of entries alone are not zero.
    pub fn counts(&self) -> LinkCounts {
        self.counts
    }

    /// Takes a message that this host publishes, to be said across hops.
    pub fn put(&mut self, now: Time, message: &Wire) {
        if let Wire::Mode(mode) = message {
            let layout = Layout::of(mode);
            let known = self.layouts.get(&mode.first).is_some_and(|known| known.digest == layout.digest);
            if !known {
                self.layouts.insert(mode.first, layout);
            }
        }
        self.own.put(message);
        if !self.own.due(now).is_empty() {
            self.waits = self.waits.or(Some(now));
        }
    }

    /// Takes note of a message that has arrived from its publisher itself.
    pub fn note_direct(&mut self, now: Time, from: HostId, message: &Wire) {
        self.direct.insert((from, message.kind(), message.robot()), now);
    }

    /// Returns the entries for a datagram to all that leaves at `now`. Those that leave are to be told to `said`.
    pub fn choose(&mut self, now: Time, key: Option<&Key>) -> Block {
        let Relay { own, pool, echoes, layouts, me, server, .. } = self;
        let mut entries: Vec<Frame> = Vec::new();
        let mut bytes = 0;
        for (kind, robot) in own.due(now) {
            let to = if *server == me.host { None } else { Some(*server) };
            let echoed = if kind == Kind::Release { Vec::new() } else { echoes.of(now, to) };
            let (origin, incarnation, number) = (me.host, me.incarnation, echoes.number(now));
            own.make(now, (kind, robot), |content, body| {
                let entry = Entry { origin, incarnation, number, content, echoes: echoed };
                proof::sealed(&entry, body, me.team, key, *server)
            });
        }
        for entry in own.unsaid().chain(&pool.unsaid(now)) {
            if entries.len() < MOST_ENTRIES && bytes + entry.len() <= MOST_BYTES {
                bytes += entry.len();
                entries.push(Frame::clone(entry));
            }
        }
        // That of a large team takes most of a datagram. What has no room beside data leaves in one of its own.
        entries.extend(layouts.values().filter(|layout| layout.is_due(now)).map(|layout| layout.entry(*me)));
        let lacks = self.lacks();
        Block { lacks, entries, left: false }
    }

    /// Takes note that a datagram with these entries has left.
    pub fn said(&mut self, now: Time, entries: &[Frame]) {
        for entry in entries {
            let layout = self.layouts.values_mut().any(|layout| layout.said(now, entry));
            let own = layout || self.own.said(entry);
            self.counts.passed_on += u64::from(!own && self.pool.said(entry));
        }
        if !entries.is_empty() {
            self.withholding.note_said(now, entries.len());
        }
        self.waits = self.has_unsaid(now).then_some(now);
    }

    fn has_unsaid(&self, now: Time) -> bool {
        self.own.unsaid().next().is_some()
            || !self.pool.unsaid(now).is_empty()
            || self.layouts.values().any(|layout| layout.is_due(now))
    }

    /// Returns the time at which entries have to leave in a datagram of their own; `None` if none waits.
    pub fn due(&self) -> Option<Time> {
        self.waits.map(|since| since + WAIT)
    }

    /// Returns the neighbours that are heard, and have passed nothing on for seconds in which they had to.
    pub fn withholders(&self, now: Time) -> Vec<HostId> {
        self.withholding.hosts(now)
    }

    /// Returns by whom the newest soft state of each other host has come, in the order of their ids.
    pub fn last_hops(&self, now: Time) -> Vec<LastHop> {
        self.ways.told(now)
    }

    /// Whether the layout of an instruction is missing.
    fn lacks(&self) -> bool {
        self.named.iter().any(|(first, digest)| self.layouts.get(first).is_none_or(|known| known.digest != *digest))
    }

    /// Takes the entries in a datagram of the neighbour `from`, an accepted host. `permits` says whether a host may
    /// publish a message. Returns the messages that are believed, each with its origin.
    pub fn hear(
        &mut self,
        now: Time,
        from: HostId,
        block: &Block,
        key: Option<&Key>,
        permits: impl Fn(HostId, &Wire) -> bool,
    ) -> Vec<(HostId, Wire)> {
        if block.lacks {
            self.layouts.values_mut().for_each(Layout::asked);
        }
        let passes = |entry: &Frame| Entry::read(entry).is_some_and(|(entry, ..)| entry.origin != from);
        if !from.is_operator() {
            self.withholding.note_heard(now, from, block.entries.iter().any(passes));
        }
        let heard = block.entries.iter().filter_map(|entry| self.hear_one(now, from, entry, key, &permits)).collect();
        if self.waits.is_none() && self.has_unsaid(now) {
            self.waits = Some(now);
        }
        heard
    }

    fn hear_one(
        &mut self,
        now: Time,
        from: HostId,
        bytes: &Frame,
        key: Option<&Key>,
        permits: &impl Fn(HostId, &Wire) -> bool,
    ) -> Option<(HostId, Wire)> {
        let Some((entry, body, proof)) = Entry::read(bytes) else {
            self.counts.forged += 1;
            return None;
        };
        if entry.origin == self.me.host {
            return None;
        }
        if entry.content == Content::Layout {
            return self.take_layout(now, body);
        }
        let Some(said) = said(entry.content, body) else {
            self.counts.forged += 1;
            return None;
        };
        let is_permitted = match &said {
            Said::Message(message) => permits(entry.origin, message),
            Said::Lead(lead) => entry.origin == self.server && lead.first.index() < MOST_ROBOTS,
        };
        if !is_permitted {
            self.counts.misrouted += 1;
            return None;
        }
        let id = (entry.origin, entry.content, said.robot());
        if self.pool.heard(from, id, bytes) {
            return None;
        }
        let checks = self.checks.entry(from).or_insert_with(|| Checks::new(now));
        let verdict = checks.verdict(now, (&entry, &said), (body, proof), key, (self.me, self.server));
        if verdict == Verdict::False {
            self.counts.forged += 1;
            return None;
        }
        let newer = self.is_newer(id, &entry);
        if verdict == Verdict::Sound && !newer {
            return None;
        }
        self.ways.note(now, (entry.origin, from), (entry.incarnation, entry.number));
        let is_passed_on = !self.me.host.is_operator();
        if is_passed_on {
            self.pool.put(now, (id, from), (entry.incarnation, entry.number), bytes, verdict == Verdict::Sound);
        }
        if verdict == Verdict::Unreadable {
            return None;
        }
        if let Said::Lead(lead) = &said {
            self.named.insert(lead.first, lead.layout);
        }
        self.believe(now, id, &entry, said)
    }

    /// Whether an entry is newer than what was believed of its stream.
    fn is_newer(&self, id: EntryId, entry: &Entry) -> bool {
        self.believed.get(&id).is_none_or(|(incarnation, number)| {
            *incarnation != entry.incarnation || entry.number.wrapping_sub(*number).wrapping_sub(1) < u32::MAX / 2
        })
    }

    /// Takes an entry with a sound proof that is new. Returns its message if it is fresh, and nothing newer has come
    /// from its origin itself.
    fn believe(&mut self, now: Time, id: EntryId, entry: &Entry, said: Said) -> Option<(HostId, Wire)> {
        let leads = self.me.host == self.server;
        if leads || entry.origin == self.server {
            self.echoes.note(now, entry);
        }
        // An operator shows a status, and a release is for one run of its reader.
        let needs = match entry.content {
            Content::Message(Kind::Heartbeat) | Content::Lead => true,
            Content::Message(Kind::Status) => leads,
            Content::Message(_) | Content::Layout => false,
        };
        if entry.content == Content::Message(Kind::Heartbeat) && !leads {
            return None;
        }
        if needs && !self.echoes.is_fresh(now, entry, self.me.host) {
            self.counts.unfresh += 1;
            return None;
        }
        self.believed.insert(id, (entry.incarnation, entry.number));
        if needs {
            self.echoes.trust(now, entry);
        }
        let message = match said {
            Said::Message(message) => message,
            Said::Lead(lead) => {
                self.leads.insert(lead.first, lead.clone());
                Wire::Mode(self.layouts.get(&lead.first)?.mode(&lead)?)
            }
        };
        let direct = self.direct.get(&(entry.origin, message.kind(), message.robot()));
        if direct.is_some_and(|at| now.since(*at) < DIRECT) {
            return None;
        }
        self.counts.over_hops += 1;
        Some((entry.origin, message))
    }

    /// Takes starts and goals: those that the newest instruction names, whoever has said them.
    fn take_layout(&mut self, now: Time, body: &[u8]) -> Option<(HostId, Wire)> {
        let layout = Layout::read(body)?;
        if let Some(known) = self.layouts.get_mut(&layout.first).filter(|known| known.digest == layout.digest) {
            known.heard(now);
            return None;
        }
        if self.named.get(&layout.first) != Some(&layout.digest) {
            return None;
        }
        let mode = self.leads.get(&layout.first).and_then(|lead| layout.mode(lead));
        let direct = self.direct.get(&(self.server, Kind::Mode, layout.first));
        let is_direct = direct.is_some_and(|at| now.since(*at) < DIRECT);
        self.layouts.insert(layout.first, layout);
        mode.filter(|_| !is_direct).map(|mode| (self.server, Wire::Mode(mode)))
    }
}

/// Content of an entry.
enum Said {
    Message(Wire),
    Lead(Lead),
}

impl Said {
    fn robot(&self) -> RobotId {
        match self {
            Said::Message(message) => message.robot(),
            Said::Lead(lead) => lead.first,
        }
    }
}

/// Reads the body of an entry; `None` if it is none of its kind.
fn said(content: Content, body: &[u8]) -> Option<Said> {
    match content {
        Content::Message(kind) => codec::message(kind, body).ok().map(Said::Message),
        Content::Lead => Lead::read(body).map(Said::Lead),
        Content::Layout => None,
    }
}
