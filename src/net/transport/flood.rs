//! Detection of a flood on a link, from the numbers of datagrams that are read.

use crate::time::{Span, Time};

/// Time for which a flooded link is not read after each read. With at most 128 datagrams a read, it bounds the cost of
/// a flood to 128 000 datagrams a second; further ones are lost once the queue below is full.
pub const REST: Span = Span::from_millis(1);
/// Number of datagrams within `REST` from which on a link is flooded: four times what the fastest team sends.
const FLOOD: usize = 20;
/// Number of datagrams in one read below which a flood has ended.
const EBB: usize = 10;

/// Detection of a flood: more datagrams than are worth a wake-up each.
#[derive(Clone, Copy, Debug, Default)]
pub struct Flood {
    on: bool,
    /// Number of datagrams read since `since`.
    count: usize,
    since: Time,
}

impl Flood {
    /// Notes that `count` datagrams were read at `now`.
    pub fn read(&mut self, now: Time, count: usize) {
        if self.on {
            *self = Flood { on: count >= EBB, count: 0, since: now };
            return;
        }
        if now.since(self.since) >= REST {
            (self.since, self.count) = (now, 0);
        }
        self.count += count;
        self.on = self.count >= FLOOD;
    }

    /// Whether the link is flooded.
    pub fn is_on(&self) -> bool {
        self.on
    }
}
