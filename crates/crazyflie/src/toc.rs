//! Tables of contents of a Crazyflie: the numbers and types of its log variables and parameters, by their names.

use std::collections::BTreeMap;

use murmurate::time::{Span, Time};

use crate::packet::Packet;
use crate::requests::{toc_info, toc_item};

/// Time after which a question without an answer is repeated: some round trips of a slow radio link.
pub const REPEAT: Span = Span::from_millis(100);
/// Questions about entries that may be without an answer at a time. The firmware has room for 16 packets.
const ASKED: usize = 8;
/// Most entries of a table that are asked for: firmwares have some hundreds.
const MOST: u16 = 4096;

/// Table of contents: for `group.name`, the number and the type of an entry.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Toc(BTreeMap<String, (u16, u8)>);

impl Toc {
    /// Returns the number and the type of an entry; `None` if the firmware has none of this name.
    pub fn find(&self, name: &str) -> Option<(u16, u8)> {
        self.0.get(name).copied()
    }
}

/// Tables that were read before, by port, length and CRC: a robot with the same firmware is not asked again.
pub type Kept = BTreeMap<(u8, u16, u32), Toc>;

/// Reading of one table from a robot.
#[derive(Clone, Debug)]
pub struct Fetch {
    /// Port of the table.
    pub port: u8,
    /// Length and CRC of the table; `None` before the answer about them.
    info: Option<(u16, u32)>,
    toc: Toc,
    /// Entries that have arrived.
    arrived: Vec<bool>,
    /// Last question about each entry without an answer, or about the length; and the next entry to be asked for.
    asked: BTreeMap<u16, Time>,
    next: u16,
}

impl Fetch {
    /// Begins with a table.
    pub fn new(port: u8) -> Fetch {
        let (toc, asked) = (Toc::default(), BTreeMap::new());
        Fetch { port, info: None, toc, arrived: Vec::new(), asked, next: 0 }
    }

    /// Returns the questions that are due at `now`.
    pub fn due(&mut self, now: Time) -> Vec<Packet> {
        let Some((length, _)) = self.info else {
            let asked = self.asked.entry(0).or_insert(Time::ZERO);
            let first = *asked == Time::ZERO;
            if !first && now.since(*asked) < REPEAT {
                return Vec::new();
            }
            *asked = now;
            return vec![toc_info(self.port)];
        };
        while self.asked.len() < ASKED && self.next < length {
            self.asked.insert(self.next, Time::ZERO);
            self.next += 1;
        }
        let mut due = Vec::new();
        for (index, asked) in &mut self.asked {
            if *asked == Time::ZERO || now.since(*asked) >= REPEAT {
                *asked = now;
                due.push(toc_item(self.port, *index));
            }
        }
        due
    }

    /// Takes an answer. Returns the table once it is complete, of which `kept` may have it already.
    ///
    /// # Errors
    /// If the table is longer than any firmware's.
    pub fn take(&mut self, data: &[u8], kept: &mut Kept) -> Result<Option<Toc>, &'static str> {
        match (data, self.info) {
            ([3, a, b, c, d, e, f, ..], None) => {
                let (length, crc) = (u16::from_le_bytes([*a, *b]), u32::from_le_bytes([*c, *d, *e, *f]));
                if length > MOST {
                    return Err("its table of contents is longer than any firmware's");
                }
                if let Some(toc) = kept.get(&(self.port, length, crc)) {
                    return Ok(Some(toc.clone()));
                }
                (self.info, self.arrived) = (Some((length, crc)), vec![false; usize::from(length)]);
                self.asked.clear();
                Ok((length == 0).then(Toc::default))
            }
            ([2, a, b, kind, names @ ..], Some((length, crc))) => {
                let index = u16::from_le_bytes([*a, *b]);
                let Some(arrived) = self.arrived.get_mut(usize::from(index)) else { return Ok(None) };
                let mut names = names.split(|byte| *byte == 0).map(String::from_utf8_lossy);
                let (Some(group), Some(name)) = (names.next(), names.next()) else { return Ok(None) };
                self.toc.0.insert(format!("{group}.{name}"), (index, kind & 0x0f));
                *arrived = true;
                self.asked.remove(&index);
                if self.next < length || !self.asked.is_empty() || !self.arrived.iter().all(|arrived| *arrived) {
                    return Ok(None);
                }
                kept.insert((self.port, length, crc), self.toc.clone());
                Ok(Some(self.toc.clone()))
            }
            _ => Ok(None),
        }
    }
}
