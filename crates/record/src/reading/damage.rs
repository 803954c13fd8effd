//! Survey of a file: its intact ranges and its damaged places.

use std::collections::BTreeMap;
use std::ops::Range;

use super::element::{Channel, Map, Schema};

/// Part of a record that is lost by damage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// Nothing, as an index is damaged, or a copy is left.
    Nothing,
    /// Messages, which a replay and a picture then lack.
    Messages,
    /// Metadata or attached files, and no message.
    Other,
}

/// Damaged place of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Place of the damage \[bytes\] from the beginning of the file.
    pub range: Range<u64>,
    /// Description of the damage.
    pub what: String,
    /// Time of the last intact message before the damage and of the first after it \[ns\].
    pub times: (Option<u64>, Option<u64>),
    /// Part of the record that is lost by it.
    pub loss: Loss,
}

/// End of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum End {
    /// With the mark of its end.
    Marked,
    /// Without that mark: it can be read up to the place `at`. The last `zeros` bytes are zero.
    Cut {
        /// Place up to which the file can be read \[bytes\].
        at: u64,
        /// Number of zeros at the end of the file \[bytes\].
        zeros: u64,
    },
    /// At its beginning: the file has no bytes.
    Empty,
    /// Nowhere: all bytes are zero.
    Zeros,
}

/// Survey of a file after all of it was read: its intact ranges and its damaged places.
#[derive(Clone, Debug)]
pub struct Survey {
    /// Length of the file \[bytes\].
    pub length: u64,
    /// Ranges of the file with intact elements, in order \[bytes\].
    pub intact: Vec<Range<u64>>,
    /// Damaged places, in order.
    pub damage: Vec<Damage>,
    /// End of the file.
    pub end: End,
    /// Whether a part of the file has no checksum.
    pub unchecked: bool,
    /// Whether messages that have no checksum of their own, in chunks without one and outside chunks, are left out,
    /// because a checksum over all of them is wrong.
    pub skips_loose: bool,
    /// Places of the intact attachments, from opcode to checksum \[bytes\].
    pub attachments: Vec<Range<u64>>,
    /// Time of the last intact message \[ns\].
    pub last: Option<u64>,
    /// Intact metadata, each name and content once.
    pub metadata: Vec<(String, Map)>,
    /// Channels by their id.
    pub channels: BTreeMap<u16, Channel>,
    /// Schemas by their id.
    pub schemas: BTreeMap<u16, Schema>,
    /// Profile in the file's header.
    pub profile: String,
}

impl Survey {
    /// Returns the survey of a file of `length` bytes before any was read.
    pub fn unread(length: u64) -> Survey {
        Survey {
            length,
            intact: Vec::new(),
            damage: Vec::new(),
            end: End::Empty,
            unchecked: false,
            skips_loose: false,
            attachments: Vec::new(),
            last: None,
            metadata: Vec::new(),
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            profile: String::new(),
        }
    }

    /// Returns the survey of a file of `length` bytes of which nothing can be used, for the reason `what`.
    pub fn lost(length: u64, what: String) -> Survey {
        let damage = vec![Damage { range: 0..length, what, times: (None, None), loss: Loss::Messages }];
        Survey { damage, end: End::Marked, ..Survey::unread(length) }
    }

    /// Whether the file has its end, nothing is damaged and nothing is lost.
    pub fn is_whole(&self) -> bool {
        self.end == End::Marked && self.damage.is_empty()
    }

    /// Whether nothing was written into the file.
    pub fn is_nothing(&self) -> bool {
        matches!(self.end, End::Empty | End::Zeros)
    }

    /// Returns at how many places before the place `at` of the file messages are lost.
    pub fn losses_before(&self, at: u64) -> usize {
        let lost = |damage: &&Damage| damage.loss == Loss::Messages && damage.range.start < at;
        self.damage.iter().filter(lost).count()
    }
}
