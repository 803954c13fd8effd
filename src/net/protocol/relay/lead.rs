//! Instructions of the state server across hops: the lead, which names starts and goals by a digest, and these, the
//! layout, which travel once.

use serde::{Deserialize, Serialize};

use super::entry::{Content, Entry};
use crate::messages::ids::RobotId;
use crate::messages::latch::Latch;
use crate::messages::wire::{Kind, Mode, Phase, Round, Wire};
use crate::net::protocol::codec::{self, Frame};
use crate::net::protocol::link::Identity;
use crate::time::{Span, Time};

/// Digest of a layout: the first 16 bytes of its BLAKE3 hash.
pub(super) type Digest = [u8; 16];

/// Times that a host says a layout when it has got it, and once for each neighbour that lacks it.
const TIMES: u8 = 2;
/// Least time between two sayings for those that lack a layout.
const AGAIN: Span = Span::from_millis(100);

/// Instruction without starts and goals.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lead {
    pub round: Round,
    pub repeat: u32,
    pub phase: Phase,
    pub first: RobotId,
    pub latch: Latch,
    pub layout: Digest,
}

/// Fields of a lead after its digest, as one MessagePack array.
#[derive(Serialize, Deserialize)]
struct Fields(Round, u32, Phase, RobotId, Latch);

impl Lead {
    /// Returns the body of the lead of an instruction.
    pub fn body(mode: &Mode) -> Vec<u8> {
        let mut bytes = Layout::of(mode).digest.to_vec();
        let fields = Fields(mode.round, mode.repeat, mode.phase, mode.first, mode.latch);
        rmp_serde::encode::write(&mut bytes, &fields).expect("plain data is always MessagePack");
        bytes
    }

    /// Reads the body of a lead; `None` if it is none.
    pub fn read(body: &[u8]) -> Option<Lead> {
        let (layout, fields) = body.split_first_chunk()?;
        let Fields(round, repeat, phase, first, latch) = rmp_serde::from_slice(fields).ok()?;
        Some(Lead { round, repeat, phase, first, latch, layout: *layout })
    }
}

/// Starts and goals of robots, and when they are to be said.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub first: RobotId,
    pub digest: Digest,
    body: Box<[u8]>,
    /// Number of times that it is still to be said.
    left: u8,
    /// Time at which this host, or a neighbour, last said it.
    last: Option<Time>,
}

impl Layout {
    /// Returns the layout of an instruction.
    pub fn of(mode: &Mode) -> Layout {
        let bare = Mode {
            round: Round::default(),
            repeat: 0,
            phase: Phase::Waiting,
            first: mode.first,
            tasks: mode.tasks.clone(),
            latch: Latch::default(),
        };
        let mut body = Vec::new();
        rmp_serde::encode::write(&mut body, &Wire::Mode(bare)).expect("plain data is always MessagePack");
        Layout::with(mode.first, body)
    }

    fn with(first: RobotId, body: Vec<u8>) -> Layout {
        let mut digest = Digest::default();
        digest.copy_from_slice(&blake3::hash(&body).as_bytes()[..16]);
        Layout { first, digest, body: body.into(), left: TIMES, last: None }
    }

    /// Reads the body of an entry; `None` if it is none of a layout.
    pub fn read(body: &[u8]) -> Option<Layout> {
        let Wire::Mode(mode) = codec::message(Kind::Mode, body).ok()? else { return None };
        Some(Layout::with(mode.first, body.to_vec()))
    }

    /// Returns the instruction with the fields of `lead` and these starts and goals; `None` if it names others.
    pub fn mode(&self, lead: &Lead) -> Option<Mode> {
        let Wire::Mode(bare) = codec::message(Kind::Mode, &self.body).ok()? else { return None };
        let Lead { round, repeat, phase, first, latch, layout } = lead.clone();
        let mode = Mode { round, repeat, phase, first, latch, ..bare };
        let is_sound = Wire::Mode(mode.clone()).check().is_ok();
        (self.digest == layout && is_sound).then_some(mode)
    }

    /// Returns its entry. It has no proof: the digest in a lead is one.
    pub fn entry(&self, me: Identity) -> Frame {
        let Identity { host, incarnation, .. } = me;
        let entry = Entry { origin: host, incarnation, number: 0, content: Content::Layout, echoes: Vec::new() };
        entry.bytes(&self.body, &[])
    }

    /// Whether it is to be said at `now`.
    pub fn is_due(&self, now: Time) -> bool {
        self.left > 0 && self.last.is_none_or(|last| now.since(last) >= AGAIN)
    }

    /// Takes note that an entry has left. Returns whether it was of this layout.
    pub fn said(&mut self, now: Time, entry: &[u8]) -> bool {
        let is_this = entry.ends_with(&self.body);
        if is_this {
            (self.left, self.last) = (self.left.saturating_sub(1), Some(now));
        }
        is_this
    }

    /// Takes note that a neighbour has said it.
    pub fn heard(&mut self, now: Time) {
        self.last = Some(now);
    }

    /// Takes note that a neighbour lacks a layout.
    pub fn asked(&mut self) {
        self.left = self.left.max(1);
    }
}
