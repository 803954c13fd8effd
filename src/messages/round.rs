//! Round: the number of an instruction of the state server, and the rule by which an actor follows from one to the
//! next.

use serde::{Deserialize, Serialize};

use super::latch::second_largest;

/// Largest term (number of a state server's start) that a message may contain. If forged messages raised the term by
/// `Round::JUMP` (16) at each of the state server's 20 decisions a second, they would reach this limit after 38 days.
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
    /// Largest term that is accepted whatever term the receiver knows. A state server that is started once an hour
    /// reaches it after a century.
    const CREDIBLE: u32 = 1 << 20;
    /// Most by which a received term above `CREDIBLE` may exceed the larger of `CREDIBLE` and the known term. Without
    /// this bound, one corrupted message with the largest term would make receivers ignore all later ones.
    const JUMP: u32 = 16;

    /// Whether the term of `other` is so far above the term of this round (by more than 16, and above 2^20) that
    /// `other` must be corrupted or forged.
    pub(crate) fn is_overshot_by(self, other: Round) -> bool {
        other.term > self.term.max(Round::CREDIBLE) + Round::JUMP
    }

    /// Returns the latest of the received `rounds`. A single round is ignored if its term is implausibly far above the
    /// term of `known`, the latest round so far, and above the other rounds. Returns term 0, episode 0 if none is left.
    pub(crate) fn latest(known: Round, rounds: impl Iterator<Item = Round> + Clone) -> Round {
        let second = second_largest(rounds.clone().map(|round| round.term.into()));
        let ceiling = u64::from(known.term).max(second).max(Round::CREDIBLE.into()) + u64::from(Round::JUMP) - 1;
        rounds.filter(|round| u64::from(round.term) <= ceiling).max().unwrap_or_default()
    }
}

/// Round (number of a state server's instruction) that one actor follows, with the check of newly received rounds.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RoundFollower {
    round: Round,
    /// Term of the round that arrived last, if it was refused because its term is implausibly high; otherwise `None`.
    /// It is admitted if the next round confirms it with the same term or a slightly higher one.
    overshot: Option<u32>,
}

impl RoundFollower {
    /// Returns the round of the instruction that the actor follows at present.
    pub(crate) fn round(&self) -> Round {
        self.round
    }

    /// Returns whether the actor is to follow an instruction with this round: one that is not earlier than the round it
    /// follows. An implausibly high term is admitted only if the round that arrived just before had about the same
    /// term, since a corrupted term does not repeat.
    pub(crate) fn admits(&mut self, round: Round) -> bool {
        let before = self.overshot.take();
        let repeated = before.is_some_and(|before| (before..=before.saturating_add(Round::JUMP)).contains(&round.term));
        if self.round.is_overshot_by(round) && !repeated {
            self.overshot = Some(round.term);
            return false;
        }
        round >= self.round
    }

    /// Sets the round that the actor follows from now on.
    pub(crate) fn follow(&mut self, round: Round) {
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
