//! Round: which instruction of the state server is meant, and how an actor follows from one to the next.

use serde::{Deserialize, Serialize};

/// The largest epoch on the wire. At `Round::JUMP` for each of 20 heartbeats a second it is reached after 38 days.
pub(super) const MAX_EPOCH: u32 = 1 << 30;

/// Which instruction of the state server is meant: later epochs outrank, then later episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Round {
    /// Incarnation of the state server, counted from one; zero before any was heard.
    pub epoch: u32,
    /// Episode, counted from zero over the whole trial.
    pub episode: u32,
}

impl Round {
    /// The furthest that an epoch may be ahead of what is known: a state server goes on from the epoch that it hears,
    /// so nobody has missed so many. Without a bound, one message with the largest epoch could never be overtaken.
    pub const JUMP: u32 = 16;

    /// Whether another round is so far ahead of this one that it cannot be an honest one.
    pub fn is_overshot_by(self, other: Round) -> bool {
        other.epoch > self.epoch.saturating_add(Round::JUMP)
    }
}

/// The round that one actor follows.
#[derive(Clone, Copy, Debug, Default)]
pub struct RoundFollower {
    round: Round,
    /// The epoch of a round that overshot, if the newest did.
    doubted: Option<u32>,
}

impl RoundFollower {
    /// The round that it follows.
    pub fn round(&self) -> Round {
        self.round
    }

    /// Whether an instruction of this round is to be followed. An earlier round never is; one that overshoots is when
    /// it comes a second time, since an actor that was started afresh cannot know, and a garbled one does not repeat.
    pub fn admits(&mut self, said: Round) -> bool {
        let before = self.doubted.take();
        if self.round.is_overshot_by(said) && before != Some(said.epoch) {
            self.doubted = Some(said.epoch);
            return false;
        }
        said >= self.round
    }

    /// Follows this round from now on.
    pub fn follow(&mut self, round: Round) {
        self.round = round;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_earlier_round_is_refused_and_one_that_overshoots_has_to_be_said_twice() {
        let round = |epoch| Round { epoch, episode: 0 };
        let mut follower = RoundFollower::default();
        assert!(follower.admits(round(1)));
        follower.follow(round(1));
        assert!(!follower.admits(round(0)));
        assert!(!follower.admits(round(900)) && !follower.admits(round(901)), "two garbled ones");
        assert!(follower.admits(round(1)) && !follower.admits(round(901)), "not in a row");
        assert!(follower.admits(round(901)));
    }
}
