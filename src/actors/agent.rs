//! Agent: runs the policy of one robot or of several robots jointly.
//!
//! An Agent steps when the Caches of all its robots have sent a percept: for one robot at its own tick, for several in
//! one synchronous step. Robots of one Agent exchange latents within the step. Latents of all others arrive through the
//! Caches.

pub mod apart;
mod exchange;
mod slot;
pub mod timed;

pub use slot::RobotPolicies;

use std::sync::Arc;

use self::slot::{Outcome, Slot};
use super::neighbours::SharedData;
use crate::actor::Core;
use crate::cells::Cells;
use crate::edge::Packet;
use crate::messages::geometry::{Task, Vec2, is_finite};
use crate::messages::local::{Action, NEAR_M, OtherRobot, Percept, Progress, Remembered};
use crate::messages::round::RoundFollower;
use crate::messages::wire::{Features, Latent, Mode, Phase, Round};
use crate::observation::Observation;
use crate::scenario::course::{Course, TURNING};
use crate::scenario::layout::Layouts;
use crate::scenario::{Scenario, goals};
use crate::time::{Span, Time};

/// Largest distance between a robot and its start at which the robot counts as ready for the episode \[m\].
pub const START_M: f32 = 0.05;

/// Time from the start of a round (reset or episode) during which an Agent reports no robot as arrived, because its
/// percept may still come from the round before.
pub const SETTLING: Span = Span::from_millis(300);

/// Time for which a robot has held an unlabelled goal before it reports that: longer than the reports of two robots are
/// apart, so that there was an instant at which all held theirs once all have said so.
const HELD: Span = Span::from_millis(500);

/// Input message of an Agent, the actor that runs the policy of one or more robots.
#[derive(Clone, Debug)]
pub enum In {
    /// Inputs of the policy (percept) of one of the Agent's robots at a control tick.
    Percept(Percept),
    /// Instruction of the state server: phase of the episode, and the robots' starts and goals.
    Mode(Mode),
    /// Answer of the worker that computes the policies, for an Agent whose policies are computed by one.
    Answer(Packet),
    /// Notice that the worker has ended or begins again.
    Ended,
}

/// Output message of an Agent, the actor that runs the policy of one or more robots.
#[derive(Clone, Debug)]
pub enum Out {
    /// Latent (policy message) of one of the Agent's robots, for the robot's neighbours.
    Latent(Latent),
    /// Action (desired velocity) of one of the Agent's robots, for the robot's Controller.
    Action(Action),
    /// Digest of what the policy of one of the Agent's robots remembers after its step, for records.
    Remembered(Remembered),
}

/// Agent: the actor that computes the latents (policy messages) and actions of one or more robots from their percepts,
/// with their policies.
pub struct Agent {
    scenario: Arc<dyn Scenario>,
    /// Longest wait of a joint step for the last percept. After it, the step runs without the missing robots.
    max_wait: Span,
    slots: Vec<Slot>,
    /// Mean time between two latents of a robot; zero for one in every step.
    between_latents: Span,
    /// Whether policies under test compute the steps of several robots together.
    joint: bool,
    /// Arenas of the episodes, where these differ.
    layouts: Layouts,
    /// Tasks of all robots of the team that the Agent was told, in the order of their ids.
    team: Vec<Option<Task>>,
    rounds: RoundFollower,
    /// Round of the last instruction that the Agent follows.
    round: Round,
    phase: Phase,
    /// Time at which the Agent began to follow the round.
    began: Time,
    /// Time at which the Agent heard that the present episode runs.
    episode_began: Time,
    waiting_since: Option<Time>,
    /// Time of the last step.
    stepped: Time,
    /// Number of the Agent's robots whose percept for the next step has not arrived yet.
    missing: usize,
    /// For each slot, the data that its robot shares with the Agent's other robots in the current step; `None` without
    /// a percept. `features` has the latent features of all these robots, one after the other.
    shared: Vec<Option<SharedData>>,
    features: Vec<f32>,
    /// Grid of the robots' positions in the current step; `None` for few robots, or if the range is unlimited or
    /// random.
    grid: Option<Cells>,
    near: Vec<usize>,
}

impl Agent {
    /// Creates an Agent of the robots in `robots`; panics if they are not in the order of their ids. `scenario` defines
    /// what a policy observes, and `max_wait` is the longest time for which a joint step waits for late percepts.
    pub fn new(scenario: Arc<dyn Scenario>, max_wait: Span, robots: Vec<RobotPolicies>) -> Agent {
        assert!(robots.is_sorted_by_key(|policies| policies.robot), "sums run over robots in the order of their ids");
        Agent {
            team: vec![None; scenario.robots()],
            scenario,
            layouts: Layouts::default(),
            max_wait,
            between_latents: Span::ZERO,
            joint: robots.len() > 1 && robots.iter().any(|policies| policies.run.is_joint()),
            missing: robots.len(),
            shared: Vec::new(),
            features: Vec::new(),
            grid: None,
            near: Vec::new(),
            slots: robots.into_iter().map(Slot::new).collect(),
            rounds: RoundFollower::default(),
            round: Round::default(),
            phase: Phase::NeedReset,
            began: Time::ZERO,
            episode_began: Time::ZERO,
            waiting_since: None,
            stepped: Time::ZERO,
        }
    }

    /// Returns the Agent with the layouts of the trial: its policies get the arena of each episode.
    pub fn with_layouts(self, layouts: Layouts) -> Agent {
        Agent { layouts, ..self }
    }

    /// Returns the Agent with a mean time between two latents of a robot that is longer than a control step. Robots of
    /// one Agent exchange latents in every step all the same.
    pub fn broadcasting(self, between_latents: Span) -> Agent {
        Agent { between_latents, ..self }
    }

    fn follow(&mut self, now: Time, mode: &Mode) {
        if !self.rounds.admits(mode.round) {
            return;
        }
        self.rounds.follow(mode.round);
        if mode.round > self.round {
            self.slots.iter_mut().for_each(|slot| slot.task = None);
            self.team.fill(None);
            self.began = now;
            if let Some(arena) = self.layouts.arena(mode.round.episode) {
                self.slots.iter_mut().for_each(|slot| slot.policies.enter(arena));
            }
            for slot in &mut self.slots {
                slot.course = self.layouts.course(mode.round.episode, slot.policies.robot);
            }
        }
        let ran = self.phase == Phase::Running && mode.round == self.round;
        if mode.phase == Phase::Running && !ran {
            self.episode_began = now;
            self.slots.iter_mut().for_each(Slot::begin);
        }
        (self.round, self.phase) = (mode.round, mode.phase);
        let block = mode.first.index()..mode.first.index() + mode.tasks.len();
        for (known, task) in self.team.iter_mut().skip(block.start).zip(&*mode.tasks) {
            *known = Some(*task);
        }
        let first = self.slots.partition_point(|slot| slot.policies.robot.index() < block.start);
        for slot in self.slots[first..].iter_mut().take_while(|slot| block.contains(&slot.policies.robot.index())) {
            slot.task = mode.task_of(slot.policies.robot);
        }
    }

    /// Takes back the last step of all policies, which counts as none.
    fn undo(&mut self) {
        self.slots.iter_mut().for_each(|slot| slot.undo(self.stepped));
    }

    /// Runs one step of the policies: computes latents and actions of all robots with a percept, and appends them to
    /// `out`.
    fn step(&mut self, now: Time, out: &mut Vec<Out>) {
        (self.waiting_since, self.stepped) = (None, now);
        if matches!(self.phase, Phase::Resetting | Phase::Running) {
            self.shared.clear();
            self.features.clear();
            (0..self.slots.len()).for_each(|at| self.observe(now, at));
            (0..self.slots.len()).for_each(|at| self.share(now, at));
            self.grid = self.locate();
            self.relay();
            if self.joint && self.phase == Phase::Running {
                (0..self.slots.len()).for_each(|at| self.prepare_act(at));
            }
            // Send actions before latents: actuation latency matters more. Both leave in one visit to the Network.
            out.extend((0..self.slots.len()).filter_map(|at| self.act(now, at)).map(Out::Action));
            out.extend((0..self.slots.len()).filter_map(|at| self.latent(now, at)).map(Out::Latent));
            if self.phase == Phase::Running {
                out.extend(self.slots.iter().filter_map(Slot::remembered).map(Out::Remembered));
            }
        }
        self.slots.iter_mut().for_each(|slot| slot.percept = None);
        self.missing = self.slots.len();
    }

    /// Encodes the observation of the robot in slot `at` and stores the data that the Agent's other robots read of this
    /// robot.
    fn share(&mut self, now: Time, at: usize) {
        let encoded = self.encode(at).is_some();
        let slot = &self.slots[at];
        let age = slot.age(now);
        let said = slot.held().filter(|_| slot.outcome == Outcome::Held).map(|held| held.motion);
        let Slot { policies, percept, features, .. } = slot;
        let place = |at: usize| u32::try_from(at).expect("the latents of a step take less than four gigabytes");
        let range = encoded.then(|| [self.features.len(), self.features.len() + features.len()].map(place));
        let shared = percept.as_ref().map(|percept| SharedData {
            robot: policies.robot,
            motion: percept.estimate,
            said: said.unwrap_or(percept.estimate),
            features: range,
            age,
        });
        self.shared.push(shared);
        if range.is_some() {
            self.features.extend_from_slice(features);
        }
    }

    /// Returns the latent of the robot in slot `at`; `None` if it broadcasts none in this step.
    fn latent(&mut self, now: Time, at: usize) -> Option<Latent> {
        let SharedData { robot, motion, .. } = self.shared[at]?;
        let slot = &mut self.slots[at];
        if slot.outcome != Outcome::Sound || !slot.broadcasts(now, self.between_latents) {
            return None;
        }
        slot.reported = false;
        let features = Features(slot.features.as_slice().into());
        Some(Latent { robot, round: self.round, phase: self.phase, motion, features, part: None })
    }

    /// Makes the observation of the robot in slot `at`, which has a step if it knows its state and its task and its
    /// period is over.
    fn observe(&mut self, now: Time, at: usize) {
        let (phase, joint) = (self.phase, self.joint);
        let slot = &mut self.slots[at];
        slot.outcome = Outcome::Silent;
        let Some((percept, task)) = slot.percept.as_ref().zip(slot.task.as_ref()) else { return };
        if phase == Phase::Running {
            slot.course.pass(percept.estimate.position, TURNING * self.scenario.rules().arrival_m);
        }
        let task = bound_for(phase, task, &slot.course);
        let own = slot.policies.observe(&*self.scenario, &task, percept, now.since(self.episode_began));
        slot.own = own;
        slot.outcome = if slot.is_due(now, phase) { Outcome::Due } else { Outcome::Held };
        if slot.outcome == Outcome::Due && phase == Phase::Running {
            slot.steps(now, (&task, &self.team), &own);
            if joint {
                slot.policies.run.prepare_encode(&Observation { values: &slot.values, ..own });
            }
        }
    }

    /// Encodes the observation of the robot in slot `at`; `None` if it broadcasts nothing in this step.
    fn encode(&mut self, at: usize) -> Option<()> {
        let phase = self.phase;
        let slot = &mut self.slots[at];
        match slot.outcome {
            Outcome::Due => {}
            Outcome::Held => return slot.held().filter(|held| held.sound).map(drop),
            _ => return None,
        }
        let seen = Observation { values: &slot.values, ..slot.own };
        let policy = slot.policies.of(phase);
        let width = policy.interface().features;
        // The policy declares its width anew in each step; it may differ from that at the start.
        slot.features.resize(width, 0.0);
        policy.encode(&seen, &mut slot.features);
        slot.encoded(phase);
        (slot.outcome == Outcome::Sound).then_some(())
    }

    fn act(&mut self, now: Time, at: usize) -> Option<Action> {
        self.find_near(self.shared[at]?.motion.position);
        let settled = now.since(self.began) >= SETTLING;
        let (phase, round) = (self.phase, self.round);
        let slot = &mut self.slots[at];
        let step = slot.step((round, phase), &self.features);
        let (percept, task) = (slot.percept.as_ref()?, slot.task.as_ref()?);
        let task = bound_for(phase, task, &slot.course);
        let own = percept.estimate;
        let companions = self.near.iter().filter(|other| **other != at).filter_map(|&other| self.shared[other]);
        let neighbours = step.neighbours(percept, companions.clone(), &mut slot.policies.ranges);

        let seen = Observation { values: &slot.values, ..slot.own };
        let policy = if phase == Phase::Running { &mut slot.policies.run } else { &mut slot.policies.reset };
        let limit = policy.interface().limit_m_s;
        let acts = matches!(slot.outcome, Outcome::Sound | Outcome::Silent);
        let act = || policy.act(&seen, &slot.features, &neighbours, &mut slot.policies.actions);
        let velocity = acts.then(act).unwrap_or_default();
        let said = percept.heard.iter().filter(|heard| !percept.measures(heard.robot));
        let said = said.map(|heard| OtherRobot { robot: heard.robot, motion: heard.motion, age: heard.age });
        let known = said.chain(percept.measured.iter().copied());
        let beside = companions.map(|other| OtherRobot { robot: other.robot, motion: other.motion, age: Span::ZERO });
        let near = |other: &OtherRobot| (other.motion.position - own.position).norm_squared() <= NEAR_M * NEAR_M;
        let others: Vec<OtherRobot> = known.chain(beside).filter(near).collect();
        let due = percept.due;
        let there = match phase {
            Phase::Running if self.scenario.goals().are_unlabelled() => {
                let holds = holds_goal(&*self.scenario, &self.team, percept, &others);
                slot.held_since = holds.then(|| slot.held_since.unwrap_or(now));
                slot.held_since.is_some_and(|since| now.since(since) >= HELD)
            }
            Phase::Running => {
                let point = farther(own.position, task.goal, percept.deviation_m);
                slot.course.is_through() && self.scenario.reached(&task, point)
            }
            _ => (task.goal - own.position).norm() <= START_M,
        };
        if acts {
            slot.acted(phase);
        }
        let velocity = match slot.outcome {
            Outcome::Sound | Outcome::Silent => Some(limited(velocity, limit)),
            Outcome::Held => slot.held().map(|held| held.velocity),
            Outcome::Failed => None,
            Outcome::Due => unreachable!("a step is encoded before its action"),
            // The Controller stops the robot for it, as for any output that is not finite.
            Outcome::Invalid => Some(Vec2::repeat(f32::NAN)),
        };
        if slot.outcome != Outcome::Held {
            slot.hold(velocity);
        }
        Some(Action {
            robot: slot.policies.robot,
            round,
            phase,
            due,
            velocity: velocity.map(|velocity| self.scenario.frame(&task).turn(velocity)),
            estimate: own,
            others,
            progress: if there && settled { Progress::Reached } else { Progress::Underway },
        })
    }
}

/// Returns whether a robot is certainly at an unlabelled goal of the `team`, and nearer to it than all `others`.
fn holds_goal(scenario: &dyn Scenario, team: &[Option<Task>], percept: &Percept, others: &[OtherRobot]) -> bool {
    let goals = || team.iter().flatten().map(|task| task.goal);
    let (position, arrival_m) = (percept.estimate.position, scenario.rules().arrival_m);
    let Some(goal) = goals::goal_at(goals(), position, arrival_m).and_then(|at| goals().nth(at)) else { return false };
    let from_m = |point: Vec2| (point - goal).norm();
    from_m(farther(position, goal, percept.deviation_m)) <= arrival_m
        && others.iter().all(|other| from_m(other.motion.position) > from_m(position))
}

/// Returns `position` moved away from `goal` by twice the position's standard deviation \[m\], so that arrival counts
/// only if it is certain.
fn farther(position: Vec2, goal: Vec2, deviation_m: f32) -> Vec2 {
    match (position - goal).try_normalize(0.0) {
        Some(direction) if deviation_m > 0.0 => position + direction * (2.0 * deviation_m),
        _ => position,
    }
}

/// Returns the task that a robot follows in `phase`: the present leg of its `course` with its `task` in a running
/// episode, otherwise the drive to its start (the goal is the start).
fn bound_for(phase: Phase, task: &Task, course: &Course) -> Task {
    if phase == Phase::Running { course.leg(task) } else { Task { start: task.start, goal: task.start } }
}

/// Returns `velocity` with each component clamped to plus or minus the policy's `limit` \[m/s\]. A non-finite velocity
/// is returned unchanged; the Controller stops the robot for it.
fn limited(velocity: Vec2, limit: f32) -> Vec2 {
    if is_finite(velocity) { velocity.map(|axis| axis.clamp(-limit, limit)) } else { velocity }
}

impl Core for Agent {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Mode(mode) => self.follow(now, &mode),
            // This Agent computes its policies itself.
            In::Answer(_) | In::Ended => {}
            In::Percept(percept) => {
                let place = self.slots.binary_search_by_key(&percept.robot, |slot| slot.policies.robot);
                let Some(slot) = place.ok().map(|place| &mut self.slots[place]) else { return };
                if slot.percept.replace(percept).is_none() {
                    self.missing -= 1;
                }
                if self.missing == 0 {
                    self.step(now, out);
                } else {
                    self.waiting_since.get_or_insert(now);
                }
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        self.waiting_since.map(|since| since + self.max_wait)
    }

    /// Runs the joint step without the robots whose percepts are late. It is due when the Agent has waited the longest
    /// permitted time.
    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        self.step(now, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hearing::CommRange;
    use crate::messages::geometry::Motion;
    use crate::messages::ids::RobotId;
    use crate::messages::latch::Latch;
    use crate::messages::local::NeighbourLatent;
    use crate::messages::wire::MAX_FEATURES;
    use crate::observation::{Bound, Dynamics, Request, Taking, Unit};
    use crate::policy::{Broadcast, Interface, Neighbour, Policy};
    use crate::random::{Seed, Stream};
    use crate::scenario::{Settings, build};

    /// Test policy that moves at as many m/s as it has neighbours.
    struct Counting;

    impl Policy for Counting {
        fn interface(&self) -> Interface {
            let (period, hold) = (Span::from_millis(50), Span::from_millis(200));
            Interface { features: 1, radius_m: 2.0, period, limit_m_s: 1.5, hold }
        }
        fn encode(&mut self, _: &Observation, features: &mut [f32]) {
            features[0] = 7.0;
        }
        fn act(&mut self, _: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
            assert!(
                neighbours.iter().all(|neighbour| neighbour.features == [7.0]),
                "it receives the latents that were sent"
            );
            Vec2::new(neighbours.len() as f32, 0.0)
        }
    }

    const ROUND: Round = Round { term: 1, episode: 0 };
    const MEASURED: Vec2 = Vec2::new(0.1, -0.2);

    fn agent(robots: &[u16]) -> Agent {
        let passage = build("passage", &Settings::of(3)).unwrap();
        let stream = || Seed::of_run(0).stream("agent");
        let policies = |&robot: &u16| RobotPolicies {
            robot: RobotId(robot),
            dynamics: Dynamics::default(),
            range: CommRange::fixed(2.0),
            point_ahead_m: 0.0,
            every: 1,
            channels: Bound::default(),
            run: Box::new(Counting),
            reset: Box::new(Counting),
            actions: stream(),
            resets: stream(),
            ranges: stream(),
        };
        let robots = robots.iter().map(policies).collect();
        let mut agent = Agent::new(passage, Span::from_millis(12), robots);
        let task = Task { start: Vec2::new(0.0, -1.5), goal: Vec2::new(0.0, 1.5) };
        let tasks = [task; 3].into();
        let (phase, first, latch) = (Phase::Running, RobotId(0), Latch::default());
        let mode = Mode { round: ROUND, repeat: 0, phase, first, tasks, latch };
        agent.handle(Time::ZERO, In::Mode(mode), &mut Vec::new());
        agent
    }

    fn percept(robot: u16, x: f32, heard: Vec<NeighbourLatent>) -> In {
        let estimate = Motion { position: Vec2::new(x, -1.5), velocity: MEASURED };
        In::Percept(Percept {
            robot: RobotId(robot),
            due: Time::ZERO,
            estimate,
            deviation_m: 0.0,
            heading: None,
            yaw_rate: None,
            heard,
            measured: Vec::new(),
            sensed: Vec::new(),
        })
    }

    fn speeds(out: &[Out]) -> Vec<(u16, f32)> {
        let action = |out: &Out| match out {
            Out::Action(action) => {
                assert_eq!(action.estimate.velocity, MEASURED, "it has the measured velocity");
                Some((action.robot.0, action.velocity.expect("no step has failed").x))
            }
            Out::Latent(_) | Out::Remembered(_) => None,
        };
        out.iter().filter_map(action).collect()
    }

    #[test]
    fn a_joint_step_waits_for_all_and_uses_neighbours_in_range() {
        let (mut agent, mut out) = (agent(&[0, 1, 2]), Vec::new());
        agent.handle(Time::ZERO, percept(0, 0.0, Vec::new()), &mut out);
        agent.handle(Time::ZERO, percept(2, 1.5, Vec::new()), &mut out);
        assert!(out.is_empty());
        agent.handle(Time::ZERO, percept(1, -1.5, Vec::new()), &mut out);
        // Robots 1 and 2 are 3 m apart.
        assert_eq!(speeds(&out), [(0, 1.5), (1, 1.0), (2, 1.0)], "two neighbours, limited to 1.5 m/s");
        assert_eq!(out.len(), 6, "and three latents");
        assert_eq!(agent.wake_at(), None);
    }

    #[test]
    fn of_many_robots_those_near_are_heard_and_met_as_if_everyone_was_looked_at() {
        let robots: Vec<u16> = (0..60).collect();
        // A drawn range, even with a tiny deviation, has no bound: all robots are examined.
        let out = [0.0, 1e-30].map(|std_m| {
            let (mut agent, mut out) = (agent(&robots), Vec::new());
            agent.slots.iter_mut().for_each(|slot| slot.policies.range.std_m = std_m);
            for &robot in &robots {
                agent.slots[usize::from(robot)].task = agent.slots[0].task;
                agent.handle(Time::ZERO, percept(robot, f32::from(robot * 37 % 60) * 0.7, Vec::new()), &mut out);
            }
            assert_eq!(agent.grid.is_some(), std_m == 0.0);
            out
        });
        assert_eq!(out.each_ref().map(Vec::len), [120; 2]);
        for (by_cells, by_all) in out[0].iter().zip(&out[1]) {
            assert_eq!(format!("{by_cells:?}"), format!("{by_all:?}"));
        }
    }

    #[test]
    fn a_joint_step_goes_on_without_a_robot_that_does_not_perceive() {
        let (mut agent, mut out) = (agent(&[0, 1, 2]), Vec::new());
        agent.handle(Time::ZERO, percept(0, 0.0, Vec::new()), &mut out);
        agent.handle(Time::ZERO, percept(1, 1.0, Vec::new()), &mut out);
        let due = agent.wake_at().unwrap();
        assert_eq!(due, Time::ZERO + Span::from_millis(12));
        agent.wake(due, &mut out);
        assert_eq!(speeds(&out), [(0, 1.0), (1, 1.0)]);
    }

    #[test]
    fn latents_of_another_round_phase_or_width_are_not_heard() {
        let heard = |robot: u16, round: Round, phase: Phase, floats: &[f32]| NeighbourLatent {
            robot: RobotId(robot),
            round,
            phase,
            motion: Motion::default(),
            features: Features(floats.into()),
            age: Span::ZERO,
        };
        let other = Round { term: 1, episode: 1 };
        let all = vec![
            heard(1, ROUND, Phase::Running, &[7.0]),
            heard(2, ROUND, Phase::Resetting, &[7.0]),
            heard(3, other, Phase::Running, &[7.0]),
            heard(4, ROUND, Phase::Running, &[7.0, 7.0]),
        ];
        let (mut agent, mut out) = (agent(&[0]), Vec::new());
        agent.handle(Time::ZERO, percept(0, 0.0, all), &mut out);
        assert_eq!(speeds(&out), [(0, 1.0)]);
    }

    /// Test policy whose latents change their width at the third step, or are not finite.
    struct Unsound(usize, f32, std::cell::Cell<usize>);

    impl Policy for Unsound {
        fn interface(&self) -> Interface {
            self.2.set(self.2.get() + 1);
            Interface { features: if self.2.get() > 2 { self.0 } else { 1 }, ..Counting.interface() }
        }
        fn encode(&mut self, _: &Observation, features: &mut [f32]) {
            features.fill(self.1);
        }
        fn act(&mut self, _: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
            Vec2::x()
        }
    }

    #[test]
    fn an_invalid_latent_is_neither_sent_nor_used_and_moves_no_robot() {
        for (width, value) in [(2, 0.0), (0, 0.0), (MAX_FEATURES + 1, 0.0), (1, f32::NAN), (1, f32::INFINITY)] {
            let mut agent = agent(&[0, 1]);
            agent.slots[0].policies.run = Box::new(Unsound(width, value, std::cell::Cell::new(2)));
            let mut out = Vec::new();
            agent.handle(Time::ZERO, percept(0, 0.0, Vec::new()), &mut out);
            agent.handle(Time::ZERO, percept(1, 1.0, Vec::new()), &mut out);
            let speeds = speeds(&out);
            assert!(speeds[0].1.is_nan(), "{width} {value}: the Controller has to stop it");
            assert_eq!(speeds[1], (1, 0.0), "{width} {value}: its companion hears nobody, and goes on");
            assert!(out.iter().all(|out| !matches!(out, Out::Latent(latent) if latent.robot == RobotId(0))));
        }
    }

    /// Test policy of three hops: a robot encodes its x, every hop adds what the neighbours had in the hop before, and
    /// the velocity is the sum of the neighbours' third numbers. Not a number is sent from a hop on, if it is given.
    struct Adding(Option<usize>);

    impl Policy for Adding {
        fn interface(&self) -> Interface {
            Interface { features: 3, limit_m_s: 1e3, ..Counting.interface() }
        }
        fn hops(&self) -> usize {
            3
        }
        fn encode(&mut self, own: &Observation, features: &mut [f32]) {
            features.copy_from_slice(&[own.motion.position.x.abs(), 0.0, 0.0]);
        }
        fn relay(&mut self, hop: usize, _: &Observation, features: &mut [f32], neighbours: &[Neighbour]) {
            let sum: f32 = neighbours.iter().map(|neighbour| neighbour.features[hop - 1]).sum();
            features[hop] = if self.0 == Some(hop) { f32::NAN } else { features[hop - 1] + sum };
        }
        fn act(&mut self, _: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
            Vec2::new(neighbours.iter().map(|neighbour| neighbour.features[2]).sum(), 0.0)
        }
    }

    fn adding(robots: &[u16]) -> Agent {
        let mut agent = agent(robots);
        for slot in &mut agent.slots {
            slot.policies.run = Box::new(Adding(None));
            slot.widths[0] = 3;
        }
        agent
    }

    fn latents(out: &[Out]) -> Vec<Vec<f32>> {
        let latent = |out: &Out| match out {
            Out::Latent(latent) => Some(latent.features.0.to_vec()),
            Out::Action(_) | Out::Remembered(_) => None,
        };
        out.iter().filter_map(latent).collect()
    }

    #[test]
    fn robots_that_step_together_exchange_all_hops_in_one_step() {
        let (mut agent, mut out) = (adding(&[0, 1, 2]), Vec::new());
        // A row, in which only neighbours hear each other: 0 - 1 - 2.
        for (robot, x) in [(0, 1.0), (1, 2.5), (2, 4.0)] {
            agent.handle(Time::ZERO, percept(robot, x, Vec::new()), &mut out);
        }
        assert_eq!(latents(&out), [[1.0, 3.5, 11.0], [2.5, 7.5, 17.5], [4.0, 6.5, 14.0]]);
        assert_eq!(speeds(&out).iter().map(|(_, speed)| *speed).collect::<Vec<_>>(), [17.5, 25.0, 17.5]);
    }

    #[test]
    fn a_hop_of_a_robot_alone_is_made_of_the_newest_messages_and_waits_for_none() {
        let (mut agent, mut out) = (adding(&[0]), Vec::new());
        let heard = NeighbourLatent {
            robot: RobotId(1),
            round: ROUND,
            phase: Phase::Running,
            motion: Motion::default(),
            features: Features([10.0, 200.0, 3000.0].into()),
            age: Span::from_millis(40),
        };
        agent.handle(Time::ZERO, percept(0, 1.0, vec![heard]), &mut out);
        assert_eq!(latents(&out), [[1.0, 11.0, 211.0]]);
        assert_eq!(speeds(&out)[0].1, 1000.0);
    }

    #[test]
    fn a_robot_whose_later_hop_is_invalid_sends_nothing_and_stops() {
        let (mut agent, mut out) = (adding(&[0, 1]), Vec::new());
        agent.slots[0].policies.run = Box::new(Adding(Some(1)));
        for (robot, x) in [(0, 1.0), (1, 2.0)] {
            agent.handle(Time::ZERO, percept(robot, x, Vec::new()), &mut out);
        }
        // Robot 1 has heard the input of the first hop, and none of the others.
        assert_eq!(latents(&out), [[2.0, 3.0, 3.0]]);
        assert!(speeds(&out)[0].1.is_nan());
        assert_eq!(speeds(&out)[1], (1, 0.0));
    }

    /// Test policy that counts its steps, moves at their number in cm/s and broadcasts it after the step.
    struct Remembering {
        steps: f32,
        said: [f32; 1],
    }

    impl Policy for Remembering {
        fn interface(&self) -> Interface {
            Counting.interface()
        }
        fn reset(&mut self, _: u64) {
            (self.steps, self.said) = (0.0, [0.0]);
        }
        fn forgets_after(&self) -> Option<Span> {
            Some(Span::from_millis(500))
        }
        fn encode(&mut self, _: &Observation, features: &mut [f32]) {
            features.copy_from_slice(&self.said);
        }
        fn act(&mut self, own: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
            self.steps += 1.0;
            self.said = [self.steps];
            let values: [f32; 1] = own.values.try_into().expect("it takes one value");
            Vec2::new(self.steps / 100.0, values[0] / 10.0)
        }
        fn broadcast(&self) -> Broadcast<'_> {
            Broadcast::Computed(&self.said)
        }
    }

    /// Gives each robot of an Agent the policy under test that `make` returns, with the channels that it takes.
    fn replace(agent: &mut Agent, make: impl Fn() -> (Box<dyn Policy>, Bound)) {
        for slot in &mut agent.slots {
            let (run, channels) = make();
            let stream = || Seed::of_run(0).stream("agent");
            let (robot, task, reset) = (slot.policies.robot, slot.task, Box::new(Counting));
            let RobotPolicies { range, point_ahead_m, every, .. } = slot.policies;
            let (dynamics, actions, resets, ranges) = (Dynamics::default(), stream(), stream(), stream());
            let policies = RobotPolicies {
                robot,
                dynamics,
                range,
                point_ahead_m,
                every,
                channels,
                run,
                reset,
                actions,
                resets,
                ranges,
            };
            *slot = Slot::new(policies);
            slot.task = task;
        }
    }

    /// Returns what the robots move at along both axes and what they broadcast, in their order.
    fn step_of(agent: &mut Agent, ms: u64) -> Vec<([f32; 2], f32)> {
        let (now, mut out) = (Time::ZERO + Span::from_millis(ms), Vec::new());
        for robot in [0, 1] {
            agent.handle(now, percept(robot, f32::from(robot), Vec::new()), &mut out);
        }
        let actions = out.iter().filter_map(|out| match out {
            Out::Action(action) => action.velocity.map(|velocity| [velocity.x, velocity.y]),
            Out::Latent(_) | Out::Remembered(_) => None,
        });
        let latents = out.iter().filter_map(|out| match out {
            Out::Latent(latent) => Some(latent.features.0[0]),
            Out::Action(_) | Out::Remembered(_) => None,
        });
        actions.zip(latents).collect()
    }

    #[test]
    fn a_policy_remembers_within_an_episode_and_begins_anew_after_it_and_after_a_gap() {
        let mut agent = agent(&[0, 1]);
        let time = Request {
            input: "time".to_owned(),
            channel: "time-in-episode".to_owned(),
            shape: vec![1],
            unit: Unit::Second,
            frame: None,
            taking: Taking::default(),
        };
        replace(&mut agent, || {
            let channels = Bound::new(std::slice::from_ref(&time), &[]).expect("every team has it");
            (Box::new(Remembering { steps: 0.0, said: [0.0] }), channels)
        });
        assert_eq!(step_of(&mut agent, 100), [([0.01, 0.1_f32 / 10.0], 1.0); 2], "what act has computed is broadcast");
        let elapsed = 0.6_f32 / 10.0;
        assert_eq!(step_of(&mut agent, 600), [([0.02, elapsed], 2.0); 2], "half a second is no gap");
        assert_eq!(step_of(&mut agent, 1101), [([0.01, 1.101_f32 / 10.0], 1.0); 2], "it begins anew");
        let round = Round { episode: 1, ..ROUND };
        let mode = |phase| {
            let tasks = [agent.slots[0].task.expect("it has one"); 3].into();
            In::Mode(Mode { round, repeat: 0, phase, first: RobotId(0), tasks, latch: Latch::default() })
        };
        let (resetting, running) = (mode(Phase::Resetting), mode(Phase::Running));
        agent.handle(Time::ZERO + Span::from_millis(1150), resetting, &mut Vec::new());
        assert_eq!(step_of(&mut agent, 1200)[0].1, 7.0, "the policy of resets drives");
        agent.handle(Time::ZERO + Span::from_millis(1250), running, &mut Vec::new());
        assert_eq!(step_of(&mut agent, 1300), [([0.01, 0.05_f32 / 10.0], 1.0); 2], "a new episode, and its time");
    }

    #[test]
    fn robots_of_one_agent_hear_a_broadcast_of_act_in_the_next_step() {
        /// Test policy that broadcasts after each step how often it has stepped, and moves at what it has heard.
        struct Echo(Remembering);
        impl Policy for Echo {
            fn interface(&self) -> Interface {
                self.0.interface()
            }
            fn encode(&mut self, own: &Observation, features: &mut [f32]) {
                self.0.encode(own, features);
            }
            fn act(&mut self, _: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
                self.0.said[0] += 1.0;
                Vec2::new(neighbours[0].features[0] / 100.0, 0.0)
            }
            fn broadcast(&self) -> Broadcast<'_> {
                self.0.broadcast()
            }
        }
        let mut agent = agent(&[0, 1]);
        for slot in &mut agent.slots {
            slot.policies.run = Box::new(Echo(Remembering { steps: 0.0, said: [0.0] }));
        }
        let steps = [100, 150, 200].map(|ms| step_of(&mut agent, ms)[1]);
        assert_eq!(steps, [([0.0, 0.0], 1.0), ([0.01, 0.0], 2.0), ([0.02, 0.0], 3.0)]);
    }

    /// Test policy that counts its steps like [`Remembering`], three times slower.
    struct Slow(Remembering);

    impl Policy for Slow {
        fn interface(&self) -> Interface {
            Interface { period: Span::from_millis(150), ..Counting.interface() }
        }
        fn encode(&mut self, own: &Observation, features: &mut [f32]) {
            self.0.encode(own, features);
        }
        fn act(&mut self, _: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
            self.0.steps += 1.0;
            self.0.said = [self.0.steps];
            Vec2::new(self.0.steps / 100.0, 0.0)
        }
        fn broadcast(&self) -> Broadcast<'_> {
            self.0.broadcast()
        }
    }

    /// Test policy that notes the message, the age \[ms\] and the place of its only neighbour; it stands.
    struct Noting(std::rc::Rc<std::cell::RefCell<Vec<(f32, u64, f32)>>>);

    impl Policy for Noting {
        fn interface(&self) -> Interface {
            Counting.interface()
        }
        fn encode(&mut self, _: &Observation, _: &mut [f32]) {}
        fn act(&mut self, _: &Observation, _: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
            let note = |one: &Neighbour| (one.features[0], one.age.as_nanos() / 1_000_000, one.motion.position.x);
            self.0.borrow_mut().extend(neighbours.iter().map(note));
            Vec2::zeros()
        }
    }

    #[test]
    fn a_slower_policy_steps_at_its_own_rate_holds_its_velocity_between_and_is_heard_with_its_age() {
        let (mut agent, heard) = (agent(&[0, 1]), std::rc::Rc::<std::cell::RefCell<Vec<_>>>::default());
        agent.slots[0].policies.run = Box::new(Noting(heard.clone()));
        let RobotPolicies { robot, range, .. } = agent.slots[1].policies;
        let stream = || Seed::of_run(0).stream("agent");
        let task = agent.slots[1].task;
        agent.slots[1] = Slot::new(RobotPolicies {
            robot,
            dynamics: Dynamics::default(),
            range,
            point_ahead_m: 0.0,
            every: 3,
            channels: Bound::default(),
            run: Box::new(Slow(Remembering { steps: 0.0, said: [0.0] })),
            reset: Box::new(Counting),
            actions: stream(),
            resets: stream(),
            ranges: stream(),
        });
        agent.slots[1].task = task;
        // Of robot 1, which moves by 1 cm a tick: its speed, and whether it broadcasts.
        let step = |agent: &mut Agent, ms: u16| {
            let (now, mut out) = (Time::ZERO + Span::from_millis(ms.into()), Vec::new());
            agent.handle(now, percept(0, 0.0, Vec::new()), &mut out);
            agent.handle(now, percept(1, f32::from(ms) / 5000.0, Vec::new()), &mut out);
            let said = out.iter().filter(|out| matches!(out, Out::Latent(latent) if latent.robot == RobotId(1)));
            (speeds(&out)[1].1, said.count())
        };
        let steps = [100, 150, 200, 250, 300, 350, 400].map(|ms| step(&mut agent, ms));
        assert_eq!(steps.map(|(_, said)| said), [1, 0, 0, 1, 0, 0, 1]);
        assert_eq!(steps.map(|(speed, _)| speed), [0.01, 0.01, 0.01, 0.02, 0.02, 0.02, 0.03]);
        // What `act` has computed is heard from the next tick on, with the place of the step that has made it.
        let all = heard.take();
        assert_eq!(all[..4], [(0.0, 0, 0.02), (1.0, 50, 0.02), (1.0, 100, 0.02), (1.0, 150, 0.05)], "{all:?}");
        assert_eq!(all[4..6], [(2.0, 50, 0.05), (2.0, 100, 0.05)], "{all:?}");
        // It has no percept for half a second; what it made before then does not hold any longer.
        agent.handle(Time::ZERO + Span::from_millis(450), percept(0, 0.0, Vec::new()), &mut Vec::new());
        agent.wake(Time::ZERO + Span::from_millis(462), &mut Vec::new());
        assert_eq!(step(&mut agent, 1000), (0.04, 1), "it has a step as soon as it can");
        agent.undo();
        assert_eq!(step(&mut agent, 1050), (0.05, 1), "a step that was late is made up for");
    }

    #[test]
    fn a_robot_broadcasts_at_its_rate_on_average_and_does_not_make_up_for_a_silence() {
        let between = Span::from_millis(125);
        let mut agent = agent(&[0]).broadcasting(between);
        let mut said = |ms: u64| {
            let mut out = Vec::new();
            agent.handle(Time::ZERO + Span::from_millis(ms), percept(0, 0.0, Vec::new()), &mut out);
            assert!(out.iter().any(|out| matches!(out, Out::Action(_))), "it acts in each step");
            out.iter().filter(|out| matches!(out, Out::Latent(_))).count()
        };
        // Eight a second of twenty steps, whatever the first step's time.
        let second: usize = (20..40).map(|step| said(step * 50)).sum();
        assert_eq!(second, 8);
        // Steps that come a little early, as on a real clock, take the turn of those in time.
        let early: usize = (40..60).map(|step| said(step * 50 - 3)).sum();
        assert_eq!(early, 8);
        let after: Vec<usize> = [10_000, 10_050, 10_100, 10_150, 10_200, 10_250].map(&mut said).to_vec();
        assert_eq!(after, [1, 0, 1, 0, 0, 1], "after seven seconds of silence");
    }

    #[test]
    fn a_robot_without_a_task_in_the_round_says_nothing() {
        let (mut agent, mut out) = (agent(&[0, 1]), Vec::new());
        (0..2).for_each(|robot| agent.handle(Time::ZERO, percept(robot, f32::from(robot), Vec::new()), &mut out));
        let latents = |out: &[Out]| out.iter().filter(|out| matches!(out, Out::Latent(_))).count();
        assert_eq!(latents(&out), 2);
        // The instruction of the next round has come for the first robot alone.
        let task = agent.slots[0].task.expect("it has one");
        let round = Round { episode: 1, ..ROUND };
        let (phase, first, latch) = (Phase::Running, RobotId(0), Latch::default());
        let mode = Mode { round, repeat: 0, phase, first, tasks: [task].into(), latch };
        agent.handle(Time::ZERO, In::Mode(mode), &mut out);
        out.clear();
        (0..2).for_each(|robot| agent.handle(Time::ZERO, percept(robot, f32::from(robot), Vec::new()), &mut out));
        assert_eq!(latents(&out), 1, "{out:?}");
    }

    /// Test policy that counts steps like [`Remembering`], and whose steps fail while told so.
    struct Failing(Remembering, std::rc::Rc<std::cell::Cell<bool>>);

    impl Policy for Failing {
        fn interface(&self) -> Interface {
            Counting.interface()
        }
        fn reset(&mut self, seed: u64) {
            self.0.reset(seed);
        }
        fn forgets_after(&self) -> Option<Span> {
            self.0.forgets_after()
        }
        fn broadcast(&self) -> Broadcast<'_> {
            if self.1.get() { Broadcast::Failed } else { Broadcast::Encoded }
        }
        fn encode(&mut self, own: &Observation, features: &mut [f32]) {
            self.0.encode(own, features);
        }
        fn act(&mut self, _: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
            self.0.steps += 1.0;
            Vec2::new(self.0.steps / 100.0, 0.0)
        }
    }

    #[test]
    fn steps_that_fail_move_and_say_nothing_and_count_as_a_gap() {
        let mut agent = agent(&[0]);
        let fails = std::rc::Rc::new(std::cell::Cell::new(false));
        replace(&mut agent, || {
            let policy = Failing(Remembering { steps: 0.0, said: [0.0] }, fails.clone());
            (Box::new(policy), Bound::default())
        });
        let mut step = |ms: u64| {
            let mut out = Vec::new();
            agent.handle(Time::ZERO + Span::from_millis(ms), percept(0, 0.0, Vec::new()), &mut out);
            let said = out.iter().any(|out| matches!(out, Out::Latent(_)));
            let Some(Out::Action(action)) = out.into_iter().next() else { panic!("it acts in each step") };
            (action.velocity.map(|velocity| velocity.x), said)
        };
        assert_eq!([step(100), step(150)], [(Some(0.01), true), (Some(0.02), true)]);
        fails.set(true);
        (4..14).for_each(|at| assert_eq!(step(50 * at), (None, false)));
        fails.set(false);
        assert_eq!(step(700), (Some(0.01), true), "550 ms after the last step that counted it begins anew");
    }
}
