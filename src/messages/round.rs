//! Round: the number of an instruction of the state server, and the rule by which an actor follows from one to the
//! next.

use serde::{Deserialize, Serialize};

use super::latch::second_largest;

/// Largest term on the wire. At `Round::JUMP` for each of a state server's 20 decisions a second it is reached after
/// 38 days.
pub(super) const MAX_TERM: u32 = 1 << 30;

/// Number of an instruction of the state server: a later term outranks, then a later episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Round {
    /// Term of the state server, as of a leader in Raft: each start begins a later one. Zero before its first message.
    pub term: u32,
    /// Episode, counted from zero over the whole trial.
    pub episode: u32,
}

impl Round {
    /// Largest term that is accepted without a look at the known one: a state server that is started once an hour
    /// reaches it after a century.
    const CREDIBLE: u32 = 1 << 20;
    /// Most that a term beyond `CREDIBLE` may exceed the known one. Without these bounds, no later term could follow
    /// one message with the largest term.
    const JUMP: u32 = 16;

    /// Whether another round is so far ahead of this one that it cannot be genuine.
    pub fn is_overshot_by(self, other: Round) -> bool {
        other.term > self.term.max(Round::CREDIBLE) + Round::JUMP
    }

    /// Returns the latest of some rounds, without a single one whose term is out of reach of the others and of the
    /// known one. The term after it is still within reach of actors that follow the known one.
    pub fn latest(known: Round, rounds: impl Iterator<Item = Round> + Clone) -> Round {
        let second = second_largest(rounds.clone().map(|round| round.term.into()));
        let ceiling = u64::from(known.term).max(second).max(Round::CREDIBLE.into()) + u64::from(Round::JUMP) - 1;
        rounds.filter(|round| u64::from(round.term) <= ceiling).max().unwrap_or_default()
    }
}

/// Round that one actor follows.
#[derive(Clone, Copy, Debug, Default)]
pub struct RoundFollower {
    round: Round,
    /// Term of the newest round, if that overshot.
    overshot: Option<u32>,
}

impl RoundFollower {
    /// Round that is followed.
    pub fn round(&self) -> Round {
        self.round
    }

    /// Whether an instruction of this round is to be followed. An earlier round never is. One that overshoots is
    /// followed the second time it arrives: an actor that has just started cannot know the term, and a corrupted one
    /// does not repeat.
    pub fn admits(&mut self, round: Round) -> bool {
        let before = self.overshot.take();
        let repeated = before.is_some_and(|before| (before..=before.saturating_add(Round::JUMP)).contains(&round.term));
        if self.round.is_overshot_by(round) && !repeated {
            self.overshot = Some(round.term);
            return false;
        }
        round >= self.round
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
    fn an_earlier_round_is_refused_and_one_that_overshoots_has_to_arrive_twice() {
        let round = |term| Round { term, episode: 0 };
        let mut follower = RoundFollower::default();
        assert!(follower.admits(round(1)));
        follower.follow(round(1));
        assert!(!follower.admits(round(0)));
        let far = Round::CREDIBLE + 900;
        assert!(!follower.admits(round(far)) && !follower.admits(round(far + 99)), "two garbled ones");
        assert!(follower.admits(round(1)) && !follower.admits(round(far)), "not in a row");
        assert!(follower.admits(round(far + 16)), "a state server that goes on meanwhile");
        assert!(follower.admits(round(Round::CREDIBLE)), "what is credible at once");
    }
}
