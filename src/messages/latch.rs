//! Emergency stop latch: whether the team may move. It is soft state: robots and state server repeat it, and of two
//! different latches the later one is valid.
//!
//! An emergency stop engages the latch. A re-arm ends the stop, but the team is held and stands; a resume lets it move
//! again. A stop is never refused; a re-arm and a resume count only if they are later than the state that they end.

use serde::{Deserialize, Serialize};

/// Number by which the encoded latch is multiplied in messages, so that no single bit error turns one latch into
/// another.
const WIRE_FACTOR: u64 = 251;
/// Largest number of a latch (count of its changes) that a message may have. If each of 8000 messages a second raises
/// the number by `JUMP`, it is reached after 17 years.
const MAX_NUMBER: u64 = 1 << 52;
/// Number of a latch (count of its changes) up to which a received latch is accepted whatever the present number is. A
/// team that is stopped, re-armed and resumed once a second reaches it after 45 years.
const CREDIBLE: u64 = 1 << 32;
/// Most by which the number of a received latch may exceed `CREDIBLE` or the present number, whichever is larger.
/// Without this bound, one message with the largest number would keep a team stopped for ever.
const JUMP: u64 = 1024;

/// State of the emergency stop, in ascending order of restriction: clear (robots may move), held (stop re-armed, robots
/// stand until a resume), engaged (stop in force).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum State {
    #[default]
    Clear,
    Held,
    Engaged,
}

/// State of the team's emergency stop (clear, held or engaged), with the number of its changes. Of two latches the one
/// with the larger number is the later. With equal numbers, the more restrictive state counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "u64", try_from = "u64")]
pub struct Latch {
    number: u64,
    state: State,
}

impl Latch {
    /// Makes a latch in the state clear: robots may move. `number` counts the changes so far; a team starts with zero.
    pub const fn clear(number: u64) -> Latch {
        Latch { number, state: State::Clear }
    }

    /// Makes a latch in the state held: the emergency stop was re-armed, and the team waits for a resume. `number`
    /// counts the changes so far.
    pub const fn held(number: u64) -> Latch {
        Latch { number, state: State::Held }
    }

    /// Makes a latch in the state engaged: an emergency stop is in force and all robots stand. `number` counts the
    /// changes so far.
    pub const fn engaged(number: u64) -> Latch {
        Latch { number, state: State::Engaged }
    }

    /// Returns whether the state is clear: no emergency stop is in force, and robots may move.
    pub fn is_clear(self) -> bool {
        self.state == State::Clear
    }

    /// Whether the emergency stop was re-armed and the team still stands, waiting for a resume.
    pub fn is_held(self) -> bool {
        self.state == State::Held
    }

    /// Whether the emergency stop is engaged: it is in force, and all robots stand.
    pub fn is_engaged(self) -> bool {
        self.state == State::Engaged
    }

    /// Returns the number of changes of the emergency stop up to this latch; the later of two latches has the larger
    /// number.
    pub(crate) fn number(self) -> u64 {
        self.number
    }

    /// Returns the word for the state in output for people and in JSON: `clear`, `held` or `stopped`.
    pub fn word(self) -> &'static str {
        match self.state {
            State::Clear => "clear",
            State::Held => "held",
            State::Engaged => "stopped",
        }
    }

    /// Whether the number of `other` is so far above the number of this latch (by more than 1024, and above 2^32) that
    /// `other` must be corrupted or forged.
    pub(crate) fn is_overshot_by(self, other: Latch) -> bool {
        other.number > ceiling(self.number)
    }

    /// Returns the later of this latch and `other`, a latch in another host's message. If the number of `other` is
    /// implausibly far above that of this latch, this latch is returned.
    pub(crate) fn joined(self, other: Latch) -> Latch {
        if self.is_overshot_by(other) { self } else { self.max(other) }
    }

    /// Returns the later of this latch and `other`, a latch that a robot's host repeats, unless that is less
    /// restrictive: a robot's host cannot end a stop or a hold. A number that is implausibly far ahead is ignored, as
    /// by [`Latch::joined`].
    pub(crate) fn tightened(self, other: Latch) -> Latch {
        if other.is_as_strict_as(self) { self.joined(other) } else { self }
    }

    /// Whether the state of this latch is at least as restrictive as that of `other`.
    pub(crate) fn is_as_strict_as(self, other: Latch) -> bool {
        self.state >= other.state
    }

    /// Returns the latch after a stop, re-arm or resume (`other`). A stop counts whatever its number, since its sender
    /// need not know the present number. A re-arm has to be later than the stop, and `commanded`: of an operator, or to
    /// the state server of its own host; another host's hold ends no stop. A resume changes nothing here: the state
    /// server, the coordinator of the team, grants it with [`Latch::resumed`].
    pub(crate) fn after(self, other: Latch, commanded: bool) -> Latch {
        match other.state {
            State::Clear => self,
            State::Held if commanded => self.joined(other),
            State::Held => self.tightened(other),
            State::Engaged if self.is_engaged() => self.joined(other),
            State::Engaged if self.is_overshot_by(other) => Latch::engaged(self.number + 1),
            State::Engaged => Latch::engaged(other.number.max(self.number + 1)),
        }
    }

    /// Returns `other`, the latch that a resume asks for, if the resume is granted. This latch must be held, and
    /// `other` clear with the next number; otherwise `None`. Only the state server, the coordinator of the team, calls
    /// this.
    pub(crate) fn resumed(self, other: Latch) -> Option<Latch> {
        (self.is_held() && other.is_clear() && other.number == self.number + 1).then_some(other)
    }
}

/// Emergency stop state that one actor of a robot (its Controller or its Body) obeys, updated by received messages.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LatchFollower {
    latch: Latch,
    /// Whether a latch of the state server has arrived; before that, the robot must not move.
    informed: bool,
    /// Newest latch of the state server, if its number was implausibly high and it was ignored; otherwise `None`.
    overshot: Option<Latch>,
    /// Whether orders are signed where they end a stop or a hold: then the state server ends none by itself.
    signed: bool,
    /// Latest latch of a resume that an operator has sent.
    resumed: Latch,
}

impl LatchFollower {
    /// Creates the state before any message. If orders are `signed`, what the state server repeats can only make it
    /// stricter, unless it is what an operator has permitted.
    pub(crate) fn new(signed: bool) -> LatchFollower {
        LatchFollower { signed, ..LatchFollower::default() }
    }

    /// Returns the emergency stop state that the actor obeys at present.
    pub(crate) fn latch(&self) -> Latch {
        self.latch
    }

    /// Returns whether a latch of the state server (the coordinator of the team) has arrived. Before that, the robot
    /// must not move.
    pub(crate) fn is_informed(&self) -> bool {
        self.informed
    }

    /// Applies a stop, re-arm or resume, which is `commanded` if an operator has sent it: see [`Latch::after`]. Returns
    /// whether the emergency stop state that the actor obeys changed.
    pub(crate) fn apply(&mut self, other: Latch, commanded: bool) -> bool {
        if commanded && other.is_clear() {
            self.resumed = self.resumed.max(other);
        }
        self.set(self.latch.after(other, commanded))
    }

    /// Applies a latch that the state server repeats, and returns whether the state that the actor obeys changed. A
    /// latch with an implausibly high number is accepted only when it arrives a second time: a corrupted number does
    /// not repeat, and an actor that has just started cannot know the true one.
    pub(crate) fn update(&mut self, other: Latch) -> bool {
        self.informed = true;
        if self.signed && !other.is_as_strict_as(self.latch) && other != self.resumed {
            return false;
        }
        let before = self.overshot.take();
        let later = if !self.latch.is_overshot_by(other) {
            self.latch.joined(other)
        } else if before.is_some_and(|before| before <= other && !before.is_overshot_by(other)) {
            // Keep a stop that has not reached the state server yet.
            if self.latch.is_engaged() { other.after(self.latch, false) } else { other }
        } else {
            self.overshot = Some(other);
            self.latch
        };
        self.set(later)
    }

    fn set(&mut self, latch: Latch) -> bool {
        std::mem::replace(&mut self.latch, latch) != latch
    }
}

/// Returns the largest number of a received latch (the count of changes of the emergency stop) that is accepted if the
/// newest known number is `known`. A larger number is taken for corrupted or forged.
fn ceiling(known: u64) -> u64 {
    known.max(CREDIBLE) + JUMP
}

/// Returns the latch of a state server that has just started: the most restrictive state of `known` and the `latches`
/// of robots' hosts, with the largest number. A single number that is implausibly far above the others is ignored.
pub(crate) fn strictest(known: Latch, latches: impl Iterator<Item = Latch> + Clone) -> Latch {
    let number = latest(known, latches.clone()).number;
    let plausible = latches.filter(|latch| latch.number <= number).map(|latch| latch.state);
    Latch { number, state: plausible.fold(known.state, State::max) }
}

/// Returns the latest of `known` and the received `latches`. A single latch with a number implausibly far above `known`
/// and above the others is ignored.
pub fn latest(known: Latch, latches: impl Iterator<Item = Latch> + Clone) -> Latch {
    let known_of_two = second_largest(latches.clone().map(Latch::number));
    let ceiling = ceiling(known.number.max(known_of_two));
    latches.filter(|latch| latch.number <= ceiling).fold(known, Latch::max)
}

/// Returns the second largest of `numbers`, which hold one number from each sender; so at least two senders have sent
/// this number or a larger one. Returns zero for fewer than two numbers.
pub(crate) fn second_largest(numbers: impl Iterator<Item = u64>) -> u64 {
    let (mut largest, mut second) = (0, 0);
    for number in numbers {
        (largest, second) = if number > largest { (number, largest) } else { (largest, second.max(number)) };
    }
    second
}

impl From<Latch> for u64 {
    fn from(latch: Latch) -> u64 {
        (3 * latch.number + latch.state as u64) * WIRE_FACTOR
    }
}

impl TryFrom<u64> for Latch {
    type Error = String;
    fn try_from(word: u64) -> Result<Latch, String> {
        let code = word / WIRE_FACTOR;
        let number = code / 3;
        if !word.is_multiple_of(WIRE_FACTOR) || number > MAX_NUMBER {
            return Err(format!("{word} is no latch"));
        }
        let state = [State::Clear, State::Held, State::Engaged][(code % 3) as usize];
        Ok(Latch { number, state })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_always_counts_and_a_re_arm_only_if_it_is_later() {
        let stopped = Latch::default().after(Latch::engaged(0), true);
        assert_eq!(stopped, Latch::engaged(1), "its sender need not know the number");
        assert_eq!(stopped.after(Latch::engaged(1), true), stopped, "again");
        assert_eq!(stopped.after(Latch::held(1), true), stopped, "no later than the stop");
        let held = stopped.after(Latch::held(2), true);
        assert_eq!(held, Latch::held(2));
        assert_eq!(held.after(Latch::engaged(1), true), Latch::engaged(3), "a stop is never too old");
        assert_eq!(stopped.after(Latch::held(2), false), stopped, "a robot's host ends no stop");
        assert_eq!(stopped.after(Latch::engaged(9), false), Latch::engaged(9), "but it may stop");
        assert_eq!(Latch::clear(3).after(Latch::held(4), false), Latch::held(4), "and say that the team is held");
        assert_eq!(held.joined(Latch::engaged(1)), held, "what others knew before is");
        assert_eq!(held.joined(Latch::engaged(2)), Latch::engaged(2), "in doubt everyone stands");
    }

    #[test]
    fn only_the_resume_for_this_very_hold_clears_it_and_nobody_but_the_state_server_takes_it() {
        let held = Latch::held(2);
        assert_eq!(held.after(Latch::clear(3), true), held, "robots do not take it from an operator");
        assert_eq!(held.resumed(Latch::clear(3)), Some(Latch::clear(3)));
        for wrong in [Latch::clear(2), Latch::clear(4), Latch::held(3), Latch::engaged(3)] {
            assert_eq!(held.resumed(wrong), None, "{wrong:?}");
        }
        for not_held in [Latch::engaged(2), Latch::clear(2)] {
            assert_eq!(not_held.resumed(Latch::clear(3)), None, "{not_held:?}");
        }
    }

    #[test]
    fn a_number_that_overshoots_stops_the_team_and_can_be_taken_back() {
        let far = MAX_NUMBER;
        for known in [Latch::clear(4), Latch::held(4), Latch::engaged(4)] {
            for other in [Latch::clear(far), Latch::held(far), Latch::engaged(far)] {
                assert_eq!(known.joined(other), known, "what others repeat");
            }
            let stopped = known.after(Latch::engaged(far), true);
            assert!(stopped.is_engaged() && stopped.number() <= 5, "{known:?} {far:?}");
            assert!(stopped.after(Latch::held(stopped.number() + 1), true).is_held());
        }
    }

    #[test]
    fn a_fresh_follower_learns_any_number_from_the_state_server_and_forgets_no_stop() {
        let mut fresh = LatchFollower::default();
        assert!(!fresh.is_informed() && fresh.update(Latch::held(CREDIBLE)) && fresh.is_informed());
        assert_eq!(fresh.latch(), Latch::held(CREDIBLE), "at once");
        let far = CREDIBLE + 9 * JUMP;
        assert!(!fresh.update(Latch::clear(far)), "a latch that overshoots has to arrive twice");
        assert!(!fresh.update(Latch::held(CREDIBLE)) && !fresh.update(Latch::clear(far)), "and in a row");
        assert!(fresh.update(Latch::clear(far + 1)));
        assert_eq!(fresh.latch(), Latch::clear(far + 1));
        let mut stopped = LatchFollower::default();
        assert!(stopped.apply(Latch::engaged(0), true) && !stopped.update(Latch::clear(far)));
        assert!(stopped.update(Latch::clear(far)));
        assert_eq!(stopped.latch(), Latch::engaged(far + 1), "the state server has not heard of the stop yet");
    }

    #[test]
    fn where_orders_are_signed_the_state_server_ends_no_stop_and_no_hold_by_itself() {
        let mut robot = LatchFollower::new(true);
        assert!(robot.update(Latch::clear(4)) && robot.is_informed(), "there was none");
        assert!(robot.update(Latch::held(5)), "it may hold the team, as after a failed reset");
        assert!(!robot.update(Latch::clear(6)), "and not end that");
        assert!(robot.apply(Latch::engaged(0), false));
        assert_eq!(robot.latch(), Latch::engaged(6));
        for lie in [Latch::held(7), Latch::clear(7), Latch::clear(1 << 40), Latch::clear(1 << 40), Latch::clear(0)] {
            assert!(!robot.update(lie) && !robot.apply(lie, false), "{lie:?}");
        }
        assert!(robot.apply(Latch::held(7), true), "an operator may");
        assert!(!robot.update(Latch::clear(8)), "which was no resume");
        assert!(!robot.apply(Latch::clear(8), true), "a resume is granted by the state server");
        assert!(robot.apply(Latch::engaged(8), false) && !robot.update(Latch::clear(8)), "it ends no later stop");
        assert!(robot.apply(Latch::held(9), true) && !robot.apply(Latch::clear(10), true));
        assert!(!robot.apply(Latch::clear(0), true), "a question in between");
        assert!(robot.update(Latch::clear(10)));
    }

    #[test]
    fn a_robot_that_has_missed_a_thousand_changes_follows_the_next_and_so_does_a_server_that_forgot_them() {
        let mut robot = LatchFollower::default();
        assert!(
            robot.apply(Latch::engaged(5000), true)
                && robot.apply(Latch::held(9000), true)
                && robot.update(Latch::clear(20_000))
        );
        assert_eq!(Latch::default().after(Latch::engaged(5000), true), Latch::engaged(5000));
        assert_eq!(Latch::default().after(Latch::held(5000), true), Latch::held(5000));
    }

    #[test]
    fn a_single_claim_out_of_reach_is_not_the_latest() {
        let (far, known) = (Latch::engaged(MAX_NUMBER), Latch::clear(4));
        assert_eq!(latest(known, [far].into_iter()), known);
        assert_eq!(latest(known, [far, Latch::held(7)].into_iter()), Latch::held(7));
        assert_eq!(latest(known, [far, far].into_iter()), far, "two claim it");
        assert_eq!(latest(known, [Latch::held(CREDIBLE)].into_iter()), Latch::held(CREDIBLE));
    }

    #[test]
    fn no_single_bit_error_makes_another_latch() {
        for latch in [Latch::clear(0), Latch::engaged(1), Latch::held(77), Latch::engaged(MAX_NUMBER)] {
            let word = u64::from(latch);
            assert_eq!(Latch::try_from(word), Ok(latch));
            assert!((0..64).all(|bit| Latch::try_from(word ^ (1 << bit)).is_err()), "{latch:?}");
        }
        assert!(Latch::try_from(u64::from(Latch::clear(MAX_NUMBER)) + 3 * WIRE_FACTOR).is_err(), "none is larger");
    }
}
