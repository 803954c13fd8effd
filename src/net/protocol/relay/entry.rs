//! Bytes of the entries of soft state that hosts pass on, and of the block that has them, little-endian.
//!
//! A block (0x88) is a byte, 1 if its sender lacks a layout and else 0, and entries. An entry:
//!
//! | bytes | field |
//! |---|---|
//! | 2 | length of what follows |
//! | 2 | origin: the host that has made it |
//! | 4 | incarnation of the origin |
//! | 4 | number: milliseconds of the origin's clock, from a random one on |
//! | 1 | content: a kind of message, 0xe0 a lead, 0xe1 a layout |
//! | 1 | number of echoes |
//! | 6 each | echo: a host 2, its newest number 4 |
//! | 1 | length of the proof |
//! | | proof: none, a tag of 8 for the state server, or a signature of 64 |
//! | | body |

use crate::messages::ids::{HostId, RobotId};
use crate::messages::wire::{KINDS, Kind};
use crate::net::protocol::codec::{self, BLOCK_BYTES, Frame};

/// Content of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Content {
    /// Message of this kind.
    Message(Kind),
    /// Instruction of the state server, with the digest of its starts and goals.
    Lead,
    /// Starts and goals of an instruction.
    Layout,
}

impl Content {
    const LEAD: u8 = 0xe0;
    const LAYOUT: u8 = 0xe1;

    fn byte(self) -> u8 {
        match self {
            Content::Message(kind) => kind as u8,
            Content::Lead => Content::LEAD,
            Content::Layout => Content::LAYOUT,
        }
    }

    fn of(byte: u8) -> Option<Content> {
        match byte {
            Content::LEAD => Some(Content::Lead),
            Content::LAYOUT => Some(Content::Layout),
            _ => {
                let kind = KINDS.get(usize::from(byte)).copied();
                kind.filter(|kind| kind.crosses_hops() && *kind != Kind::Mode).map(Content::Message)
            }
        }
    }
}

/// Stream of an entry: its origin, its content, and the robot that this is about.
pub(super) type EntryId = (HostId, Content, RobotId);

/// Head of an entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    pub origin: HostId,
    pub incarnation: u32,
    pub number: u32,
    pub content: Content,
    /// Hosts, each with the newest number that the origin has of it.
    pub echoes: Vec<(HostId, u32)>,
}

/// Length of the bytes before the echoes, with that of the length \[bytes\].
const HEAD_BYTES: usize = 2 + 2 + 4 + 4 + 1 + 1;
const ECHO_BYTES: usize = 6;
/// Largest number of echoes in an entry.
pub(super) const MAX_ECHOES: usize = 50;

impl Entry {
    /// Returns the bytes that a proof covers: all but the length and the proof.
    pub(super) fn proved(&self, body: &[u8]) -> Vec<u8> {
        let mut bytes = self.head();
        bytes.extend_from_slice(body);
        bytes
    }

    fn head(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEAD_BYTES + ECHO_BYTES * self.echoes.len() + 128);
        bytes.extend_from_slice(&self.origin.0.to_le_bytes());
        bytes.extend_from_slice(&self.incarnation.to_le_bytes());
        bytes.extend_from_slice(&self.number.to_le_bytes());
        bytes.extend_from_slice(&[self.content.byte(), self.echoes.len() as u8]);
        for (host, number) in &self.echoes {
            bytes.extend_from_slice(&host.0.to_le_bytes());
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes
    }

    /// Returns the entry with its length, its proof and its body.
    pub(super) fn bytes(&self, body: &[u8], proof: &[u8]) -> Frame {
        let head = self.head();
        let mut bytes = Vec::with_capacity(head.len() + body.len() + proof.len() + 3);
        let length = head.len() + 1 + proof.len() + body.len();
        bytes.extend_from_slice(&(length as u16).to_le_bytes());
        bytes.extend_from_slice(&head);
        bytes.push(proof.len() as u8);
        bytes.extend_from_slice(proof);
        bytes.extend_from_slice(body);
        bytes.into()
    }

    /// Reads an entry with its length; returns it with its body and its proof. `None` if it has not the form of one.
    pub(super) fn read(bytes: &[u8]) -> Option<(Entry, &[u8], &[u8])> {
        let (head, rest) = bytes.split_first_chunk::<HEAD_BYTES>()?;
        let [_, _, o0, o1, i0, i1, i2, i3, n0, n1, n2, n3, content, count] = *head;
        let (echoes, rest) = rest.split_at_checked(ECHO_BYTES * usize::from(count))?;
        let (length, rest) = rest.split_first()?;
        let (proof, body) = rest.split_at_checked(usize::from(*length))?;
        let echo = |bytes: &[u8]| {
            let (host, number) = bytes.split_first_chunk::<2>()?;
            Some((HostId(u16::from_le_bytes(*host)), u32::from_le_bytes(number.try_into().ok()?)))
        };
        let echoes = echoes.chunks_exact(ECHO_BYTES).filter_map(echo).collect();
        let entry = Entry {
            origin: HostId(u16::from_le_bytes([o0, o1])),
            incarnation: u32::from_le_bytes([i0, i1, i2, i3]),
            number: u32::from_le_bytes([n0, n1, n2, n3]),
            content: Content::of(content)?,
            echoes,
        };
        Some((entry, body, proof))
    }
}

/// Entries in a datagram, each with its length.
#[derive(Clone, Debug, Default)]
pub(crate) struct Block {
    /// Whether the sender lacks the layout of an instruction.
    pub(crate) lacks: bool,
    /// The entries.
    pub(crate) entries: Vec<Frame>,
    /// Whether they are in a datagram.
    pub(crate) left: bool,
}

impl Block {
    /// Whether there is nothing to say.
    pub(crate) fn is_empty(&self) -> bool {
        self.entries.is_empty() && !self.lacks
    }

    /// Appends a block with the entries that fit into a datagram of at most `most` bytes, and drops the others.
    pub(crate) fn add_to(&mut self, bytes: &mut Vec<u8>, most: usize) {
        let mut left = most.saturating_sub(bytes.len() + BLOCK_BYTES + 1);
        self.entries.retain(|entry| {
            let fits = entry.len() <= left;
            left -= if fits { entry.len() } else { 0 };
            fits
        });
        if self.is_empty() || bytes.len() + BLOCK_BYTES + 1 > most {
            return;
        }
        self.left = true;
        codec::add(bytes, codec::Content::Relayed, |bytes| {
            bytes.push(u8::from(self.lacks));
            self.entries.iter().for_each(|entry| bytes.extend_from_slice(entry));
        });
    }

    /// Reads the body of a block, up to where an entry is longer than the block.
    pub(crate) fn read(body: &[u8]) -> Block {
        let Some((lacks, mut rest)) = body.split_first() else { return Block::default() };
        let mut entries = Vec::new();
        while let Some(length) = rest.first_chunk::<2>() {
            let Some((entry, after)) = rest.split_at_checked(2 + usize::from(u16::from_le_bytes(*length))) else {
                break;
            };
            entries.push(entry.into());
            rest = after;
        }
        Block { lacks: *lacks == 1, entries, left: false }
    }
}
