//! Latch: whether the team's emergency stop is engaged. Soft state: robots and state server repeat it, and whoever
//! hears two takes the later.
//!
//! A stop is never refused; a re-arm counts only if it is later than the stop that it takes back.

use serde::{Deserialize, Serialize};

/// Every latch on the wire is a multiple of this: a single turned bit makes none of another.
const WIRE_FACTOR: u64 = 251;

/// Whether motors may turn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum State {
    #[default]
    Armed,
    Engaged,
}

/// The state of the emergency stop, and how often it has changed: a later number outranks, and of two with the same
/// number the engaged one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "u64", try_from = "u64")]
pub struct Latch {
    number: u32,
    state: State,
}

impl Latch {
    /// Engaged, as the change with this number.
    pub const fn engaged(number: u32) -> Latch {
        Latch { number, state: State::Engaged }
    }

    /// Armed, as the change with this number; zero is how a team starts.
    pub const fn armed(number: u32) -> Latch {
        Latch { number, state: State::Armed }
    }

    /// Whether everyone is to stand.
    pub fn is_engaged(self) -> bool {
        self.state == State::Engaged
    }

    /// Which change it is.
    pub fn number(self) -> u32 {
        self.number
    }

    /// What holds for one who knows this and has heard what another knows.
    pub fn joined(self, other: Latch) -> Latch {
        self.max(other)
    }

    /// What holds for one who knows this and is told to stop or to go on. Whoever says stop need not know how often
    /// that was said before, so a stop counts whatever its number; a re-arm has to be later than the stop.
    pub fn told(self, said: Latch) -> Latch {
        if said.is_engaged() && !self.is_engaged() {
            Latch::engaged(said.number.max(self.number.saturating_add(1)))
        } else {
            self.joined(said)
        }
    }
}

impl From<Latch> for u64 {
    fn from(latch: Latch) -> u64 {
        (2 * u64::from(latch.number) + u64::from(latch.is_engaged())) * WIRE_FACTOR
    }
}

impl TryFrom<u64> for Latch {
    type Error = String;
    fn try_from(word: u64) -> Result<Latch, String> {
        let code = word / WIRE_FACTOR;
        let number = u32::try_from(code / 2).ok().filter(|_| word.is_multiple_of(WIRE_FACTOR));
        let number = number.ok_or_else(|| format!("{word} is no latch"))?;
        Ok(if code.is_multiple_of(2) { Latch::armed(number) } else { Latch::engaged(number) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_always_counts_and_a_re_arm_only_if_it_is_later() {
        let stopped = Latch::default().told(Latch::engaged(0));
        assert_eq!(stopped, Latch::engaged(1), "whoever says it need not know the number");
        assert_eq!(stopped.told(Latch::engaged(1)), stopped, "again");
        assert_eq!(stopped.told(Latch::armed(1)), stopped, "no later than the stop");
        let armed = stopped.told(Latch::armed(2));
        assert_eq!(armed, Latch::armed(2));
        assert_eq!(armed.told(Latch::engaged(1)), Latch::engaged(3), "a stop is never too old");
        assert_eq!(armed.joined(Latch::engaged(1)), armed, "what others knew before is");
        assert_eq!(armed.joined(Latch::engaged(2)), Latch::engaged(2), "in doubt everyone stands");
    }

    #[test]
    fn no_turned_bit_makes_another_latch() {
        for latch in [Latch::armed(0), Latch::engaged(1), Latch::armed(77), Latch::engaged(u32::MAX)] {
            let word = u64::from(latch);
            assert_eq!(Latch::try_from(word), Ok(latch));
            assert!((0..64).all(|bit| Latch::try_from(word ^ (1 << bit)).is_err()), "{latch:?}");
        }
    }
}
