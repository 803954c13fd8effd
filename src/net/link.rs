//! One link as one host sees it: what leaves (`outgoing`), what arrives (`incoming`), and everything counted. Pure;
//! no sockets, no clock.

use rand::RngExt;

use super::codec::{self, Content, DecodeError, EncodeError, Flags, Frame, HEADER_BYTES, Header, MAX_FRAME_BYTES};
pub use super::counts::LinkCounts;
use super::incoming::{BACKOFF, Incoming, Verdict};
use super::key::{Key, TAG_BYTES};
use super::outgoing::{Leaving, Outgoing, REPORT_PERIOD};
use super::reliability::{Reports, Setup};
use super::report::{MAX_NAMES, Name, Report, read_held, read_names};
use super::router::Audience;
use super::sender::Peer;
use crate::messages::ids::{HostId, LinkId, RobotId};
use crate::messages::wire::{Kind, Wire};
use crate::random::Stream;
use crate::time::{Span, Time};

/// Who this host is on its links.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The host.
    pub host: HostId,
    /// Its team.
    pub team: u16,
    /// Its incarnation: a host that is started again must choose a later one.
    pub epoch: u32,
}

/// One link as one host sees it.
#[derive(Clone, Debug)]
pub struct LinkState {
    me: Identity,
    id: LinkId,
    key: Option<Key>,
    reports: Reports,
    incoming: Incoming,
    outgoing: Outgoing,
    counts: LinkCounts,
    /// When anything is next due: asked for far more often than it changes.
    due: Option<Time>,
}

impl LinkState {
    /// The state at the start of an epoch. With a key there are always reports: they show who is alive.
    pub fn new(me: Identity, id: LinkId, key: Option<Key>, mut setup: Setup, stream: &mut Stream) -> LinkState {
        if key.is_some() {
            setup.reports = Reports::On;
        }
        let Identity { host, team, epoch } = me;
        let first = REPORT_PERIOD + Span::from_nanos(stream.random_range(0..=REPORT_PERIOD.as_nanos()));
        let header = Header { flags: Flags::default(), team, sender: host, epoch, sequence: 0 };
        let mut state = LinkState {
            me,
            id,
            reports: setup.reports,
            incoming: Incoming::new(host, epoch, key.is_some(), setup.rate),
            outgoing: Outgoing::new(header, id, key.clone(), setup, first),
            key,
            counts: LinkCounts::default(),
            due: None,
        };
        state.plan();
        state
    }

    fn plan(&mut self) {
        self.due = [self.outgoing.due(), self.incoming.gaps_due()].into_iter().flatten().min();
    }

    /// A message leaves for these hosts. Gives what was encoded.
    pub fn say(
        &mut self,
        now: Time,
        audience: Audience,
        message: &Wire,
        out: &mut Vec<Leaving>,
    ) -> Result<Frame, EncodeError> {
        let encoded = self.outgoing.say(now, audience, message, &mut self.incoming, &mut self.counts, out);
        self.plan();
        encoded
    }

    /// Takes a datagram in: what it holds, without its tag, if it is to be believed and new.
    pub fn admit<'a>(
        &mut self,
        now: Time,
        frame: &'a [u8],
        stream: &mut Stream,
        out: &mut Vec<Leaving>,
    ) -> Option<(Header, &'a [u8])> {
        let read = self.read(now, frame, stream, out);
        self.plan();
        match read {
            Ok(admitted) => admitted,
            Err(error) => {
                self.refuse(&error);
                None
            }
        }
    }

    fn read<'a>(
        &mut self,
        now: Time,
        frame: &'a [u8],
        stream: &mut Stream,
        out: &mut Vec<Leaving>,
    ) -> Result<Option<(Header, &'a [u8])>, DecodeError> {
        let shortest = HEADER_BYTES + if self.key.is_some() { TAG_BYTES } else { 0 };
        if frame.len() < shortest || frame.len() > MAX_FRAME_BYTES {
            return Err(DecodeError::Length(frame.len()));
        }
        let plain = match &self.key {
            Some(key) => key.open(frame, self.id, self.me.host),
            None => (frame[codec::FLAGS_AT] & Flags::TAGGED == 0).then_some(frame),
        };
        let Some(plain) = plain else {
            self.counts.auth += 1;
            return Ok(None);
        };
        let header = codec::peek(plain)?;
        if !self.ours(&header) {
            return Ok(None);
        }
        let (mut report, mut held, mut acks, mut asks) = (None, Vec::new(), Vec::new(), Vec::new());
        let mut empty = true;
        for block in codec::blocks(plain) {
            empty = false;
            match block? {
                (Content::Message(_), _) => {}
                (Content::Report, body) => report = Some(Report::read(body)?),
                (Content::Held, body) => held.extend(read_held(body)?),
                (content @ Content::Ack, body) => acks.extend(read_names(content, body)?),
                (content @ Content::Nack, body) => asks.extend(read_names(content, body)?),
            }
        }
        if empty {
            return Err(DecodeError::Blocks);
        }
        let verdict = self.incoming.admit(now, &header, report.as_ref(), &mut self.counts);
        if let Verdict::Refused { prompt } = verdict {
            if prompt {
                self.outgoing.prompt(now, stream.random_range(0.0..1.0));
            }
            return Ok(None);
        }
        if self.incoming.owes() {
            self.outgoing.prompt(now, stream.random_range(0.0..1.0));
        }
        if header.flags.has(Flags::ACK) {
            let Header { sender: host, epoch, sequence, flags, .. } = header;
            self.outgoing.acknowledge(now, Name { host, epoch, direct: flags.has(Flags::DIRECT), sequence });
        }
        if verdict == Verdict::Again {
            return Ok(None);
        }
        self.incoming.note_gaps(now, &header, &held, || backoff(stream));
        let mine = |names: Vec<Name>| -> (Vec<Name>, Vec<Name>) {
            names.into_iter().partition(|name| (name.host, name.epoch) == (self.me.host, self.me.epoch))
        };
        if !acks.is_empty() {
            self.outgoing.acknowledged(now, header.sender, &mine(acks).0);
        }
        if !asks.is_empty() {
            let (mine, others) = mine(asks);
            self.incoming.asked_by_others(now, &others);
            self.outgoing.asked(now, &mine, &mut self.counts, out);
        }
        Ok(Some((header, plain)))
    }

    /// Whether it is from another host of this team.
    fn ours(&mut self, header: &Header) -> bool {
        let cause = if header.team != self.me.team {
            &mut self.counts.team
        } else if header.sender != self.me.host {
            return true;
        } else if header.epoch > self.me.epoch {
            // Not a former self of this host: epochs grow.
            if self.counts.twin.is_power_of_two() || self.counts.twin == 0 {
                tracing::error!("a second live host has the id {} of this one: stop one of them", self.me.host.0);
            }
            &mut self.counts.twin
        } else {
            &mut self.counts.own
        };
        *cause += 1;
        false
    }

    /// Whether a decoded message about `robot` is the newest of its stream.
    pub fn accept(&mut self, header: &Header, kind: Kind, robot: RobotId) -> bool {
        self.incoming.accept(header, kind, robot, &mut self.counts)
    }

    /// Counts bytes that are no message.
    pub fn refuse(&mut self, error: &DecodeError) {
        match error {
            DecodeError::Version(_) => self.counts.version += 1,
            DecodeError::Unfit(..) => self.counts.range += 1,
            _ => self.counts.malformed += 1,
        }
    }

    /// What has been counted, to add to it.
    pub fn counts(&mut self) -> &mut LinkCounts {
        &mut self.counts
    }

    /// What has happened so far.
    pub fn counted(&self) -> LinkCounts {
        self.counts
    }

    /// What is known of the others; none on a link without reports.
    pub fn peers(&self, now: Time) -> impl Iterator<Item = Peer> {
        let told = self.reports == Reports::On;
        self.incoming.peers(now, self.id).filter(move |_| told)
    }

    /// When anything is next due.
    pub fn due(&self) -> Option<Time> {
        self.due
    }

    /// Does what is due.
    pub fn wake(&mut self, now: Time, stream: &mut Stream, out: &mut Vec<Leaving>) {
        self.outgoing.wake(now, &mut self.incoming, &mut self.counts, out);
        if self.incoming.gaps_due().is_some_and(|due| due <= now) {
            let names = self.incoming.ask(now, MAX_NAMES, || backoff(stream));
            if !names.is_empty() {
                self.outgoing.ask(&names, &mut self.counts, out);
            }
        }
        self.plan();
    }
}

/// How long to wait before asking for a repair: mostly long, rarely short, so that few ask (RFC 5401, section 3.2,
/// `RandomBackoff`).
fn backoff(stream: &mut Stream) -> Span {
    /// A group of about this size is reckoned with.
    const GROUP: f64 = 10.0;
    let (lambda, longest) = (GROUP.ln() + 1.0, BACKOFF.as_secs());
    let scale = lambda / (longest * (lambda.exp() - 1.0));
    let drawn = stream.random_range(0.0..1.0) * (lambda / longest) + scale;
    Span::from_secs((longest / lambda * (drawn / scale).ln()).min(longest))
}
