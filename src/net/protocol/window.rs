//! Replay window of one sequence space, and measurement of loss. Pure.

/// Size of the replay window \[datagrams\]: older datagrams can no longer be told from duplicates.
pub const WINDOW: u32 = 1024;
const WORDS: usize = WINDOW as usize / 64;
/// Number of newest datagrams of a sender over which loss is measured.
pub const LOSS_SPAN: u32 = 64;

/// Position of a received datagram relative to the replay window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Position {
    /// The datagram has not arrived before, so it is accepted.
    New,
    /// The datagram has arrived before, so it is a duplicate.
    Seen,
    /// The datagram is older than the window, so it cannot be told whether it has arrived before.
    Behind,
}

/// Replay window of one sequence space: which of its newest datagrams have arrived, and how many were lost.
#[derive(Clone, Debug, Default)]
pub struct Window {
    newest: Option<u32>,
    /// Bit for each sequence number modulo the size of the window: whether the datagram has arrived.
    seen: [u64; WORDS],
    /// Bit for each of the newest `LOSS_SPAN` datagrams, newest in bit 0: whether its first transmission has arrived.
    originals: u64,
    /// Number of datagrams that should have arrived, and of those that have.
    passed: u64,
    arrived: u64,
}

impl Window {
    /// Returns a window that begins at the sequence number `first`; smaller numbers are behind the window.
    pub fn starting(first: u32) -> Window {
        let mut window = Window { newest: Some(first.wrapping_sub(1)), ..Window::default() };
        window.seen = [u64::MAX; WORDS];
        window
    }

    /// Returns the position of a datagram with this sequence number if [`Window::record`] would change nothing for it;
    /// `None` if it would. `copy` says whether it is a retransmission.
    pub fn unchanged(&self, sequence: u32, copy: bool) -> Option<Position> {
        let behind = self.newest?.wrapping_sub(sequence);
        if behind > u32::MAX / 2 {
            return None;
        }
        if behind >= WINDOW {
            return Some(Position::Behind);
        }
        let marked = copy || behind >= LOSS_SPAN || self.originals & (1 << behind) != 0;
        (self.has(sequence) && marked).then_some(Position::Seen)
    }

    /// Records the arrival of a datagram and returns its position relative to the window. `copy` says that it is a
    /// retransmission, which does not count for loss.
    pub fn record(&mut self, sequence: u32, copy: bool) -> Position {
        let Some(newest) = self.newest else {
            *self = Window::starting(sequence);
            return self.record(sequence, copy);
        };
        // Serial number arithmetic (RFC 1982): half of the numbers are ahead, half behind.
        let ahead = sequence.wrapping_sub(newest);
        let position = if ahead != 0 && ahead <= u32::MAX / 2 {
            self.advance(newest, ahead);
            Position::New
        } else {
            let behind = newest.wrapping_sub(sequence);
            if behind >= WINDOW {
                return Position::Behind;
            }
            if self.has(sequence) {
                // The retransmission has overtaken the first transmission, which was not lost.
                self.mark_original(behind, copy);
                return Position::Seen;
            }
            Position::New
        };
        let newest = self.newest.expect("there is one by now");
        self.seen[word(sequence)] |= bit(sequence);
        self.mark_original(newest.wrapping_sub(sequence), copy);
        self.arrived += 1;
        position
    }

    fn mark_original(&mut self, behind: u32, copy: bool) {
        if !copy && behind < LOSS_SPAN {
            self.originals |= 1 << behind;
        }
    }

    fn advance(&mut self, newest: u32, by: u32) {
        if by >= WINDOW {
            self.seen = [0; WORDS];
        } else {
            for skipped in 1..=by {
                let at = newest.wrapping_add(skipped);
                self.seen[word(at)] &= !bit(at);
            }
        }
        self.originals = if by < 64 { self.originals << by } else { 0 };
        self.passed += u64::from(by);
        self.newest = Some(newest.wrapping_add(by));
    }

    fn has(&self, sequence: u32) -> bool {
        self.seen[word(sequence)] & bit(sequence) != 0
    }

    /// Returns by how much this sequence number is ahead of the newest; 0 if it is not, or if there is none yet.
    pub fn ahead(&self, sequence: u32) -> u32 {
        let ahead = self.newest.map_or(0, |newest| sequence.wrapping_sub(newest));
        if ahead <= u32::MAX / 2 { ahead } else { 0 }
    }

    /// Returns whether the datagram with this sequence number is within the window and has not arrived.
    pub fn misses(&self, sequence: u32) -> bool {
        self.newest.is_some_and(|newest| newest.wrapping_sub(sequence) < WINDOW) && !self.has(sequence)
    }

    /// Returns the number of the newest 64 (`LOSS_SPAN`) datagrams whose first transmission was lost.
    pub fn lost(&self) -> u8 {
        let span = self.passed.min(u64::from(LOSS_SPAN)) as u32;
        (span - self.originals.count_ones().min(span)) as u8
    }

    /// Returns two numbers of datagrams since the window began: those that should have arrived, and of these the ones
    /// that have not, not even as a retransmission.
    pub fn missing(&self) -> (u64, u64) {
        (self.passed, self.passed.saturating_sub(self.arrived))
    }
}

fn word(sequence: u32) -> usize {
    (sequence % WINDOW / 64) as usize
}

fn bit(sequence: u32) -> u64 {
    1 << (sequence % 64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_is_new_once_in_whatever_order_and_across_a_wrap() {
        let mut window = Window::default();
        assert_eq!(window.record(u32::MAX - 1, false), Position::New);
        assert_eq!(window.record(1, false), Position::New);
        assert_eq!(window.record(u32::MAX, false), Position::New);
        assert_eq!(window.record(u32::MAX, false), Position::Seen);
        assert_eq!(window.lost(), 1);
        assert_eq!(window.record(0, true), Position::New);
        assert_eq!((window.lost(), window.missing()), (1, (4, 0)), "a copy repairs and the loss remains known");
        assert_eq!(window.record(0, false), Position::Seen);
        assert_eq!(window.lost(), 0, "it was late, not lost");
        assert_eq!(window.record(1 + WINDOW, false), Position::New);
        assert_eq!(window.record(1, false), Position::Behind);
        assert_eq!(window.record(2, false), Position::New);
    }

    #[test]
    fn a_window_that_begins_somewhere_takes_nothing_from_before() {
        let mut window = Window::starting(500);
        assert_eq!(window.record(499, false), Position::Seen);
        assert_eq!(window.record(500, false), Position::New);
        assert_eq!(window.missing(), (1, 0));
    }
}
