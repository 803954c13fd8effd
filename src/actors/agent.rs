//! Agent: the policy at work, for one robot or for several at once.
//!
//! An Agent steps when the Caches of all its robots have perceived: for one robot that is its own tick, for
//! several a joint, synchronous one. Robots of one Agent exchange latents within the step; all others are
//! heard through their Caches.

use std::sync::Arc;

use crate::actor::Core;
use crate::cells::{self, Cells};
use crate::hearing::CommRange;
use crate::messages::geometry::{Motion, Task, Vec2, is_finite};
use crate::messages::ids::RobotId;
use crate::messages::local::{Action, NEAR_M, NeighbourLatent, OtherRobot, Percept, Progress};
use crate::messages::round::RoundFollower;
use crate::messages::wire::{Features, Latent, MAX_FEATURES, Mode, Phase, Round, all_sound};
use crate::policy::{Neighbour, Policy};
use crate::random::Stream;
use crate::scenario::Scenario;
use crate::time::{Span, Time};

/// How near to its start a robot must be before an episode may begin \[m\].
pub const START_M: f32 = 0.05;

/// A robot cannot have arrived sooner than this after a round began: what says so is a reading from before.
pub const SETTLING: Span = Span::from_millis(300);

/// What an Agent accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// Of one of its robots.
    Percept(Percept),
    /// The state server's instruction.
    Mode(Mode),
}

/// What an Agent says.
#[derive(Clone, Debug)]
pub enum Out {
    /// To the neighbours of one of its robots.
    Latent(Latent),
    /// To the Controller of one of its robots.
    Action(Action),
}

/// The policies of one robot and what they draw from.
pub struct Pilot {
    /// The robot.
    pub robot: RobotId,
    /// The policy under test.
    pub run: Box<dyn Policy>,
    /// The policy that drives to the start.
    pub reset: Box<dyn Policy>,
    /// Of its actions.
    pub actions: Stream,
    /// Of its random ranges toward robots of the same Agent.
    pub ranges: Stream,
}

/// One robot within an Agent.
struct Seat {
    pilot: Pilot,
    task: Option<Task>,
    percept: Option<Percept>,
    /// What it broadcasts in this step.
    features: Vec<f32>,
    /// Whether that is a latent at all. If it is not, the policy has come apart and moves nobody.
    sound: bool,
    /// How wide latents are: of the policy under test, and of the one that drives to the start.
    widths: [usize; 2],
}

/// What a robot shows the others of its Agent in the step at hand. Small and side by side: each robot looks at all that
/// are near it.
#[derive(Clone, Copy)]
struct Shown {
    robot: RobotId,
    motion: Motion,
    /// From where to where its features stand among all that was said; none if it says nothing.
    said: Option<[u32; 2]>,
}

impl Seat {
    fn new(pilot: Pilot) -> Seat {
        let widths = [&pilot.run, &pilot.reset].map(|policy| policy.interface().features);
        Seat { pilot, task: None, percept: None, features: Vec::new(), sound: true, widths }
    }

    fn width(&self, phase: Phase) -> usize {
        self.widths[usize::from(phase != Phase::Running)]
    }
}

/// An agent for some robots.
pub struct Agent {
    scenario: Arc<dyn Scenario>,
    range: CommRange,
    /// How long a joint step waits for the last percept.
    patience: Span,
    seats: Vec<Seat>,
    rounds: RoundFollower,
    /// The round that it follows.
    round: Round,
    phase: Phase,
    /// When the round began here.
    began: Time,
    waiting_since: Option<Time>,
    /// How many of its robots have not perceived yet.
    missing: usize,
    /// By seat: what is shown in the step at hand, by those that have perceived; and the features of all of them.
    shown: Vec<Option<Shown>>,
    said: Vec<f32>,
    /// Its robots by where they are, for the step at hand; none where everyone counts or they are few.
    whereabouts: Option<Cells>,
    near: Vec<usize>,
}

impl Agent {
    /// An agent for these robots, in the order of their ids.
    pub fn new(scenario: Arc<dyn Scenario>, range: CommRange, patience: Span, pilots: Vec<Pilot>) -> Agent {
        assert!(pilots.is_sorted_by_key(|pilot| pilot.robot), "sums run in the order of ids");
        assert!(pilots.is_sorted_by_key(|pilot| pilot.robot), "an agent has its robots in the order of their ids");
        Agent {
            scenario,
            range,
            patience,
            missing: pilots.len(),
            shown: Vec::new(),
            said: Vec::new(),
            whereabouts: None,
            near: Vec::new(),
            seats: pilots.into_iter().map(Seat::new).collect(),
            rounds: RoundFollower::default(),
            round: Round::default(),
            phase: Phase::NeedReset,
            began: Time::ZERO,
            waiting_since: None,
        }
    }

    fn follow(&mut self, now: Time, mode: &Mode) {
        if !self.rounds.admits(mode.round) {
            return;
        }
        self.rounds.follow(mode.round);
        if mode.round > self.round {
            self.seats.iter_mut().for_each(|seat| seat.task = None);
            self.began = now;
        }
        (self.round, self.phase) = (mode.round, mode.phase);
        let block = mode.first.index()..mode.first.index() + mode.tasks.len();
        let first = self.seats.partition_point(|seat| seat.pilot.robot.index() < block.start);
        for seat in self.seats[first..].iter_mut().take_while(|seat| block.contains(&seat.pilot.robot.index())) {
            seat.task = mode.task_of(seat.pilot.robot);
        }
    }

    /// One step of all robots that have perceived.
    fn step(&mut self, now: Time, out: &mut Vec<Out>) {
        self.waiting_since = None;
        if matches!(self.phase, Phase::Resetting | Phase::Running) {
            self.shown.clear();
            self.said.clear();
            let latents: Vec<Latent> = (0..self.seats.len()).filter_map(|at| self.show(at)).collect();
            self.whereabouts = self.locate();
            // Actions go first: wheels before words, and what follows from both is sent in one go.
            out.extend((0..self.seats.len()).filter_map(|at| self.act(now, at)).map(Out::Action));
            out.extend(latents.into_iter().map(Out::Latent));
        }
        self.seats.iter_mut().for_each(|seat| seat.percept = None);
        self.missing = self.seats.len();
    }

    /// Where everyone is that has perceived, to look at those alone who can be heard or met. A range that is drawn for
    /// every message has no bound.
    fn locate(&self) -> Option<Cells> {
        if self.seats.len() <= cells::LINEAR_SEARCH_MAX || self.range.std_m > 0.0 {
            return None;
        }
        let nowhere = Vec2::repeat(f32::NAN);
        let at = |shown: &Option<Shown>| shown.map_or(nowhere, |shown| shown.motion.position);
        Cells::new(self.range.mean_m.max(NEAR_M), self.shown.iter().map(at))
    }

    /// What a robot broadcasts, if it does. Notes what it shows to the others here.
    fn show(&mut self, at: usize) -> Option<Latent> {
        let latent = self.encode(at);
        let Seat { pilot, percept, features, .. } = &self.seats[at];
        let place = |at: usize| u32::try_from(at).expect("a team says less than four gigabytes");
        let said = latent.as_ref().map(|_| [self.said.len(), self.said.len() + features.len()].map(place));
        let shown = percept.as_ref().map(|percept| Shown { robot: pilot.robot, motion: percept.estimate, said });
        self.shown.push(shown);
        if said.is_some() {
            self.said.extend_from_slice(features);
        }
        latent
    }

    fn encode(&mut self, at: usize) -> Option<Latent> {
        let (phase, round) = (self.phase, self.round);
        let seat = &mut self.seats[at];
        let agreed = seat.width(phase);
        let (percept, task) = (seat.percept.as_ref()?, seat.task.as_ref()?);
        let task = bound_for(phase, task);
        let policy = if phase == Phase::Running { &mut seat.pilot.run } else { &mut seat.pilot.reset };
        let width = policy.interface().features;
        // It writes as much as it says, whether or not that is what it said at first.
        seat.features.resize(width, 0.0);
        policy.encode(&self.scenario.observe(&task, &percept.estimate), &mut seat.features);
        let sound = width == agreed && width <= MAX_FEATURES && all_sound(&seat.features);
        if !sound && seat.sound {
            tracing::error!(width, agreed, "the policy says something that is no latent; its robot is to stop");
        }
        seat.sound = sound;
        sound.then(|| Latent {
            robot: seat.pilot.robot,
            round,
            phase,
            motion: percept.estimate,
            features: Features(seat.features.as_slice().into()),
        })
    }

    fn act(&mut self, now: Time, at: usize) -> Option<Action> {
        let position = self.shown[at]?.motion.position;
        match &self.whereabouts {
            Some(grid) => grid.near(position, &mut self.near),
            None => {
                self.near.clear();
                self.near.extend(0..self.seats.len());
            }
        }
        let settled = now.since(self.began) >= SETTLING;
        let (phase, round) = (self.phase, self.round);
        let seat = &mut self.seats[at];
        let width = seat.width(phase);
        let (percept, task) = (seat.percept.as_ref()?, seat.task.as_ref()?);
        let task = bound_for(phase, task);
        let own = percept.estimate;
        let frame = self.scenario.frame(&task);
        let policy = if phase == Phase::Running { &mut seat.pilot.run } else { &mut seat.pilot.reset };

        let usable =
            |heard: &&NeighbourLatent| heard.round == round && heard.phase == phase && heard.features.0.len() == width;
        let cached = percept.heard.iter().filter(usable).map(|heard| {
            (
                heard.robot,
                Neighbour { motion: frame.turn_motion(&heard.motion), features: &heard.features.0, age: heard.age },
            )
        });
        let companions = self.near.iter().filter(|other| **other != at).filter_map(|&other| self.shown[other]);
        let (range, ranges, said) = (self.range, &mut seat.pilot.ranges, &self.said);
        let joint = companions.clone().filter_map(|other| {
            let [begins, ends] = other.said?.map(|at| at as usize);
            range.admits(own.position, other.motion.position, ranges).then(|| {
                let motion = frame.turn_motion(&other.motion);
                (other.robot, Neighbour { motion, features: &said[begins..ends], age: Span::ZERO })
            })
        });
        let mut neighbours: Vec<(RobotId, Neighbour)> = cached.chain(joint).collect();
        neighbours.sort_by_key(|(robot, _)| *robot);
        let neighbours: Vec<Neighbour> = neighbours.into_iter().map(|(_, neighbour)| neighbour).collect();

        let seen = self.scenario.observe(&task, &own);
        let velocity = match seat.sound {
            true => policy.act(&seen, &seat.features, &neighbours, &mut seat.pilot.actions),
            // Left for the Controller to stop, as any other output that is no velocity.
            false => Vec2::repeat(f32::NAN),
        };
        let limit = policy.interface().limit_m_s;
        let there = match phase {
            Phase::Running => self.scenario.reached(&task, own.position),
            _ => (task.goal - own.position).norm() <= START_M,
        };
        let known =
            percept.heard.iter().map(|heard| OtherRobot { robot: heard.robot, motion: heard.motion, age: heard.age });
        let beside = companions.map(|other| OtherRobot { robot: other.robot, motion: other.motion, age: Span::ZERO });
        let near = |other: &OtherRobot| (other.motion.position - own.position).norm_squared() <= NEAR_M * NEAR_M;
        Some(Action {
            robot: seat.pilot.robot,
            round,
            phase,
            due: percept.due,
            velocity: self.scenario.steer(&task, limited(velocity, limit)),
            estimate: own,
            others: known.chain(beside).filter(near).collect(),
            progress: if there && settled { Progress::Reached } else { Progress::Underway },
        })
    }
}

/// The task of the moment: during a reset, to get to the start.
fn bound_for(phase: Phase, task: &Task) -> Task {
    if phase == Phase::Running { *task } else { Task { start: task.start, goal: task.start } }
}

/// Within the policy's own limit along each axis; what is no velocity at all is left for the Controller to stop.
fn limited(velocity: Vec2, limit: f32) -> Vec2 {
    if is_finite(velocity) { velocity.map(|axis| axis.clamp(-limit, limit)) } else { velocity }
}

impl Core for Agent {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Mode(mode) => self.follow(now, &mode),
            In::Percept(percept) => {
                let place = self.seats.binary_search_by_key(&percept.robot, |seat| seat.pilot.robot);
                let Some(seat) = place.ok().map(|place| &mut self.seats[place]) else { return };
                if seat.percept.replace(percept).is_none() {
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
        self.waiting_since.map(|since| since + self.patience)
    }

    /// A robot has not perceived in time: the others go on without it.
    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        self.step(now, out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Motion;
    use crate::messages::latch::Latch;
    use crate::policy::Interface;
    use crate::random::Seed;
    use crate::scenario::{Observation, Settings, build};

    /// Wants to move at as many m/s as it has neighbours.
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
            assert!(neighbours.iter().all(|neighbour| neighbour.features == [7.0]), "it hears what was said");
            Vec2::new(neighbours.len() as f32, 0.0)
        }
    }

    const ROUND: Round = Round { term: 1, episode: 0 };
    const MEASURED: Vec2 = Vec2::new(0.1, -0.2);

    fn agent(robots: &[u16]) -> Agent {
        let passage = build("passage", &Settings::of(3)).unwrap();
        let stream = || Seed::of_run(0).stream("agent");
        let pilot = |&robot: &u16| Pilot {
            robot: RobotId(robot),
            run: Box::new(Counting),
            reset: Box::new(Counting),
            actions: stream(),
            ranges: stream(),
        };
        let pilots = robots.iter().map(pilot).collect();
        let mut agent = Agent::new(passage, CommRange::fixed(2.0), Span::from_millis(12), pilots);
        let task = Task { start: Vec2::new(0.0, -1.5), goal: Vec2::new(0.0, 1.5) };
        let tasks = [task; 3].into();
        let (phase, first, latch) = (Phase::Running, RobotId(0), Latch::default());
        let mode = Mode { round: ROUND, repeat: 0, phase, first, tasks, latch };
        agent.handle(Time::ZERO, In::Mode(mode), &mut Vec::new());
        agent
    }

    fn percept(robot: u16, x: f32, heard: Vec<NeighbourLatent>) -> In {
        let estimate = Motion { position: Vec2::new(x, -1.5), velocity: MEASURED };
        In::Percept(Percept { robot: RobotId(robot), due: Time::ZERO, estimate, heard })
    }

    fn speeds(out: &[Out]) -> Vec<(u16, f32)> {
        let action = |said: &Out| match said {
            Out::Action(action) => {
                assert_eq!(action.estimate.velocity, MEASURED, "it says how the robot moved");
                Some((action.robot.0, action.velocity.x))
            }
            Out::Latent(_) => None,
        };
        out.iter().filter_map(action).collect()
    }

    #[test]
    fn a_joint_step_waits_for_all_and_hears_who_is_in_range() {
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
        // A range that is drawn, if from next to nothing, has no bound: then everyone is looked at.
        let out = [0.0, 1e-30].map(|std_m| {
            let (mut agent, mut out) = (agent(&robots), Vec::new());
            agent.range.std_m = std_m;
            for &robot in &robots {
                agent.seats[usize::from(robot)].task = agent.seats[0].task;
                agent.handle(Time::ZERO, percept(robot, f32::from(robot * 37 % 60) * 0.7, Vec::new()), &mut out);
            }
            assert_eq!(agent.whereabouts.is_some(), std_m == 0.0);
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

    /// Says latents of one width at first and of another from its third word on, or none that is finite.
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
    fn what_is_no_latent_is_neither_said_nor_heard_and_moves_nobody() {
        for (width, value) in [(2, 0.0), (0, 0.0), (MAX_FEATURES + 1, 0.0), (1, f32::NAN), (1, f32::INFINITY)] {
            let mut agent = agent(&[0, 1]);
            agent.seats[0].pilot.run = Box::new(Unsound(width, value, std::cell::Cell::new(2)));
            let mut out = Vec::new();
            agent.handle(Time::ZERO, percept(0, 0.0, Vec::new()), &mut out);
            agent.handle(Time::ZERO, percept(1, 1.0, Vec::new()), &mut out);
            let speeds = speeds(&out);
            assert!(speeds[0].1.is_nan(), "{width} {value}: the Controller has to stop it");
            assert_eq!(speeds[1], (1, 0.0), "{width} {value}: its companion hears nobody, and goes on");
            assert!(out.iter().all(|said| !matches!(said, Out::Latent(latent) if latent.robot == RobotId(0))));
        }
    }
}
