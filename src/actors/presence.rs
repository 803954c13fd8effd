//! The last heartbeat of each robot of a team, as a state server knows them.

use crate::messages::ids::RobotId;
use crate::messages::latch::{self, Latch};
use crate::messages::wire::{Heartbeat, Hindrance, MAX_HINDRANCES, Marks, Phase, REVISION, Round};
use crate::results::episode::AbortCause;
use crate::time::{Span, Time};

/// Time without a heartbeat after which a robot counts as missing: five heartbeat periods.
pub const MISSING_AFTER: Span = Span::from_millis(1000);

/// Last heartbeat of each robot, by its id, with the time at which it arrived.
#[derive(Debug)]
pub(super) struct Presence {
    last: Vec<Option<(Time, Heartbeat)>>,
    /// Robots whose hosts have messages of another revision, each with that revision.
    unequal: Vec<(RobotId, u16)>,
    /// Marks of the state server's host.
    marks: Marks,
    /// Robots that run another policy, each with the beginning of its digest.
    mixed: Vec<(RobotId, u32)>,
    /// Robots whose hosts have another task file, each with the beginning of its digest.
    elsewhere: Vec<(RobotId, u32)>,
    /// Number of heartbeats whose term or latch number is too far ahead to be accepted.
    pub(super) beyond_reach: u64,
}

impl Presence {
    /// Returns the presence of a team of `robots` before any heartbeat. `marks` are those of the state server's
    /// host.
    pub(super) fn new(robots: usize, marks: Marks) -> Presence {
        let (unequal, mixed, elsewhere) = (Vec::new(), Vec::new(), Vec::new());
        Presence { last: vec![None; robots], unequal, marks, mixed, elsewhere, beyond_reach: 0 }
    }

    /// Takes a heartbeat that arrived at time `now`. Returns whether it is of a robot of the team.
    pub(super) fn take(&mut self, now: Time, beat: Heartbeat) -> bool {
        if self.is_missing(now, beat.robot) {
            tracing::info!("heartbeats of {} arrive", beat.robot);
        }
        let last = self.last.get_mut(beat.robot.index());
        last.map(|last| *last = Some((now, beat))).is_some()
    }

    /// Notes a heartbeat whose term or latch number is too far ahead, and logs the counts 1, 2, 4, 8, ... of them.
    pub(super) fn note_beyond_reach(&mut self, beat: &Heartbeat) {
        self.beyond_reach += 1;
        let times = self.beyond_reach;
        if times.is_power_of_two() {
            let (robot, term, number) = (beat.robot, beat.round.term, beat.latch.number());
            tracing::error!(
                "{robot} sent term {term} and stop number {number}, which are out of reach: ignored ({times} times)"
            );
        }
    }

    /// Returns whether a robot of the team is missing: no heartbeat of it has arrived for a second.
    fn is_missing(&self, now: Time, robot: RobotId) -> bool {
        let last = self.last.get(robot.index());
        last.is_some_and(|last| last.as_ref().is_none_or(|(at, _)| now.since(*at) >= MISSING_AFTER))
    }

    /// Returns the last heartbeat of each robot, in the order of their ids; `None` for a missing robot.
    fn by_robot(&self, now: Time) -> impl Iterator<Item = Option<&Heartbeat>> + Clone {
        self.last.iter().map(move |last| {
            let (at, beat) = last.as_ref()?;
            (now.since(*at) < MISSING_AFTER).then_some(beat)
        })
    }

    /// Returns each robot with its last heartbeat; `None` for a missing robot.
    pub(super) fn all(&self, now: Time) -> impl Iterator<Item = (RobotId, Option<&Heartbeat>)> {
        RobotId::team(self.last.len()).zip(self.by_robot(now))
    }

    /// Returns the last heartbeats of the robots that are not missing.
    pub(super) fn present(&self, now: Time) -> impl Iterator<Item = &Heartbeat> + Clone {
        self.by_robot(now).flatten()
    }

    /// Returns whether no robot is missing.
    pub(super) fn is_complete(&self, now: Time) -> bool {
        self.by_robot(now).all(|beat| beat.is_some())
    }

    /// Returns whether no robot is missing and all are in `phase` of `round`.
    pub(super) fn all_are(&self, now: Time, round: Round, phase: Phase) -> bool {
        self.by_robot(now).all(|beat| beat.is_some_and(|beat| beat.round == round && beat.phase == phase))
    }

    /// Returns whether the team has to stand because its hosts have messages of different revisions or different
    /// task files, or its robots different policies.
    pub(super) fn differs(&mut self, now: Time) -> bool {
        let [unequal, mixed, elsewhere] = [self.is_unequal(now), self.is_mixed(now), self.is_elsewhere(now)];
        unequal || mixed || elsewhere
    }

    /// Returns whether hosts of present robots have messages of another revision than this one. Logs which have which
    /// when that changes.
    fn is_unequal(&mut self, now: Time) -> bool {
        let others = self.present(now).filter(|beat| beat.revision != REVISION);
        let unequal: Vec<(RobotId, u16)> = others.map(|beat| (beat.robot, beat.revision)).collect();
        if unequal != self.unequal {
            let each = unequal.iter().map(|(robot, revision)| format!("{robot} has {revision}"));
            match &each.collect::<Vec<_>>()[..] {
                [] => tracing::warn!("all hosts have messages of revision {REVISION} now"),
                each => tracing::error!(
                    "the team stands: messages of this host are of revision {REVISION}, {}; install one version of the \
                     program on all hosts",
                    each.join(", ")
                ),
            }
            self.unequal = unequal;
        }
        !self.unequal.is_empty()
    }

    /// Returns whether present robots run another policy than the team's. Logs which run which when that changes.
    fn is_mixed(&mut self, now: Time) -> bool {
        let others = self.present(now).filter(|beat| self.runs_another(beat));
        let mixed: Vec<(RobotId, u32)> = others.map(|beat| (beat.robot, beat.policy)).collect();
        if mixed != self.mixed {
            let each = mixed.iter().map(|(robot, policy)| format!("{robot} runs {policy:08x}"));
            match &each.collect::<Vec<_>>()[..] {
                [] => tracing::warn!("all robots run the policy {:08x} now", self.marks.policy),
                each => tracing::error!(
                    "the team stands: its policy is {:08x}, {}; give all hosts the same policy file",
                    self.marks.policy,
                    each.join(", ")
                ),
            }
            self.mixed = mixed;
        }
        !self.mixed.is_empty()
    }

    /// Returns whether a robot says that it runs another policy than the team's.
    fn runs_another(&self, beat: &Heartbeat) -> bool {
        beat.policy != self.marks.policy && self.says_marks(beat)
    }

    /// Returns whether hosts of present robots have another task file than this one. Logs which have which when that
    /// changes.
    fn is_elsewhere(&mut self, now: Time) -> bool {
        let others = self.present(now).filter(|beat| self.has_another_task(beat));
        let elsewhere: Vec<(RobotId, u32)> = others.map(|beat| (beat.robot, beat.task)).collect();
        if elsewhere != self.elsewhere {
            let named = |task: u32| if task == 0 { "none".to_owned() } else { format!("{task:08x}") };
            let each = elsewhere.iter().map(|(robot, task)| format!("the host of {robot} has {}", named(*task)));
            match &each.collect::<Vec<_>>()[..] {
                [] => tracing::warn!("all hosts have the task file {} now", named(self.marks.task)),
                each => tracing::error!(
                    "the team stands: the task file of this host is {}, {}; give all hosts the same task file",
                    named(self.marks.task),
                    each.join(", ")
                ),
            }
            self.elsewhere = elsewhere;
        }
        !self.elsewhere.is_empty()
    }

    /// Returns whether the host of a robot says that it has another task file than this one.
    fn has_another_task(&self, beat: &Heartbeat) -> bool {
        beat.task != self.marks.task && self.says_marks(beat)
    }

    /// Returns whether a heartbeat has marks to compare: it is of no simulation, and not of an older version.
    fn says_marks(&self, beat: &Heartbeat) -> bool {
        beat.policy != 0 && self.marks.policy != 0
    }

    /// Returns the latest of `round` and those of the present robots, ignoring rounds too far ahead.
    pub(super) fn latest_round(&self, now: Time, round: Round) -> Round {
        Round::latest(round, self.present(now).map(|beat| beat.round))
    }

    /// Returns the latch of a server whose own is `latch`. One that `knows` the team's takes the latest of it and those
    /// of the present robots that are as restrictive, ignoring numbers too far ahead; another one takes the strictest.
    pub(super) fn latch(&self, now: Time, latch: Latch, knows: bool) -> Latch {
        let all = self.present(now).map(|beat| beat.latch);
        if knows {
            latch::latest(latch, all.filter(|other| other.is_as_strict_as(latch)))
        } else {
            latch::strictest(latch, all)
        }
    }

    /// Returns the robots that prevent a resume of a team whose latch is `latch`, each with the reason. `left` says
    /// whether a host of the robot has left.
    pub(super) fn hindrances(
        &self,
        now: Time,
        latch: Latch,
        left: impl Fn(RobotId) -> bool,
    ) -> Vec<(RobotId, Hindrance)> {
        let of = |(robot, beat): (RobotId, Option<&Heartbeat>)| {
            let hindrance = match beat {
                _ if left(robot) => Hindrance::Left,
                None => Hindrance::Missing,
                Some(beat) if beat.revision != REVISION => Hindrance::Unequal,
                Some(beat) if self.runs_another(beat) => Hindrance::Policy,
                Some(beat) if self.has_another_task(beat) => Hindrance::Task,
                Some(beat) if beat.latch != latch => Hindrance::Latched,
                Some(_) => return None,
            };
            Some((robot, hindrance))
        };
        self.all(now).filter_map(of).take(MAX_HINDRANCES).collect()
    }

    /// Returns the robots that have not reported the end of the reset of `round`.
    pub(super) fn late(&self, now: Time, round: Round) -> Vec<RobotId> {
        let is_late = |(_, beat): &(RobotId, Option<&Heartbeat>)| {
            beat.is_none_or(|beat| beat.round != round || beat.phase != Phase::FinishedResetting)
        };
        self.all(now).filter(is_late).map(|(robot, _)| robot).collect()
    }

    /// Returns why the running episode of `round` has to be aborted: each robot that is missing or gives up. Empty if
    /// it goes on.
    pub(super) fn reasons_to_abort(&self, now: Time, round: Round) -> Vec<(RobotId, AbortCause)> {
        let of = |(robot, beat): (RobotId, Option<&Heartbeat>)| match beat {
            None => Some((robot, AbortCause::Missing)),
            Some(beat) if beat.round == round && beat.phase == Phase::AbortRunning => Some((robot, AbortCause::GaveUp)),
            Some(_) => None,
        };
        self.all(now).filter_map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::episode::AbortReason;

    const ROUND: Round = Round { term: 1, episode: 0 };

    fn heard(phases: [Phase; 2], at: Time) -> Presence {
        let mut presence = Presence::new(2, Marks::default());
        for (robot, phase) in RobotId::team(2).zip(phases) {
            assert!(presence.take(at, Heartbeat::new(robot, ROUND, phase, Latch::default())));
        }
        presence
    }

    #[test]
    fn a_reason_to_abort_names_the_robot() {
        let presence = heard([Phase::Running, Phase::AbortRunning], Time::ZERO);
        assert_eq!(presence.reasons_to_abort(Time::ZERO, ROUND), [(RobotId(1), AbortCause::GaveUp)]);
        let later = Round { episode: 1, ..ROUND };
        assert!(presence.reasons_to_abort(Time::ZERO, later).is_empty(), "it gave up in an earlier episode");
        let mut presence = heard([Phase::Running; 2], Time::ZERO);
        assert!(presence.reasons_to_abort(Time::ZERO, ROUND).is_empty());
        let late = Time::ZERO + MISSING_AFTER;
        let running = Heartbeat::new(RobotId(1), ROUND, Phase::Running, Latch::default());
        presence.take(late, running);
        assert_eq!(presence.reasons_to_abort(late, ROUND), [(RobotId(0), AbortCause::Missing)]);
        assert_eq!(MISSING_AFTER, Span::from_millis(1000), "as the words of the cause say");
        let words = |robots: &[(RobotId, AbortCause)]| AbortReason::of_robots(robots).map(|reason| reason.to_string());
        let missing = (RobotId(0), AbortCause::Missing);
        assert_eq!(words(&[missing; 3]).as_deref(), Some("robot 0 has not been heard for 1 s, and 2 more robots"));
        assert_eq!(words(&[]), None);
    }

    #[test]
    fn a_robot_that_is_not_of_the_team_is_not_taken() {
        let mut presence = heard([Phase::Running; 2], Time::ZERO);
        let stranger = Heartbeat::new(RobotId(2), ROUND, Phase::Waiting, Latch::default());
        assert!(!presence.take(Time::ZERO, stranger));
        assert!(presence.all_are(Time::ZERO, ROUND, Phase::Running));
    }
}
