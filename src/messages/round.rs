//! Round: the number of an instruction of the state server, and the rule by which an actor follows from one to the
//! next.

use serde::{Deserialize, Serialize};

use super::latch::second_largest;

/// Largest term on the wire. At `Round::JUMP` for each of a state server's 20 decisions a second it is reached after
/// 38 days.
pub(super) const MAX_TERM: u32 = 1 << 30;

/// Number by which instructions of the state server, the coordinator of the team, are ordered. The larger term is the
/// later, then the larger episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
pub struct Round {
    /// Term of the state server, as of a leader in Raft: each start of the state server begins a later term. Zero
    /// before the first instruction has arrived.
    pub term: u32,
    /// Number of the episode, counted from zero over the whole trial.
    pub episode: u32,
}

impl Round {
    /// Largest term that is accepted without a look at the known one: a state server that is started once an hour
    /// reaches it after a century.
    const CREDIBLE: u32 = 1 << 20;
    /// Most that a term beyond `CREDIBLE` may exceed the known one. Without these bounds, no later term could follow
    /// one message with the largest term.
    const JUMP: u32 = 16;

    /// Whether the term of `other` is so far above the term of this round that `other` must be corrupted or forged.
    pub fn is_overshot_by(self, other: Round) -> bool {
        other.term > self.term.max(Round::CREDIBLE) + Round::JUMP
    }

    /// The latest of the received `rounds`; the default round if none is left. A single round with a term implausibly
    /// far above `known` and above the other rounds is ignored.
    pub fn latest(known: Round, rounds: impl Iterator<Item = Round> + Clone) -> Round {
        let second = second_largest(rounds.clone().map(|round| round.term.into()));
        let ceiling = u64::from(known.term).max(second).max(Round::CREDIBLE.into()) + u64::from(Round::JUMP) - 1;
        rounds.filter(|round| u64::from(round.term) <= ceiling).max().unwrap_or_default()
    }
}

/// Round (number of a state server's instruction) that one actor follows, with the check of newly received rounds.
#[derive(Clone, Copy, Debug, Default)]
pub struct RoundFollower {
    round: Round,
    /// Term of the newest round, if that overshot.
    overshot: Option<u32>,
}

impl RoundFollower {
    /// Round of the instruction that the actor follows at present.
    pub fn round(&self) -> Round {
        self.round
    }

    /// Whether an instruction with this round is to be followed; an instruction with an earlier round is not. A round
    /// with an implausibly high term is admitted the second time it arrives. An actor that has just started cannot know
    /// the term, and a corrupted term does not repeat.
    pub fn admits(&mut self, round: Round) -> bool {
        let before = self.overshot.take();
        let repeated = before.is_some_and(|before| (before..=before.saturating_add(Round::JUMP)).contains(&round.term));
        if self.round.is_overshot_by(round) && !repeated {
            self.overshot = Some(round.term);
            return false;
        }
        round >= self.round
    }

    /// Sets the round that the actor follows from now on.
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
