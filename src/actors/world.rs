//! World: one Plant and its clock. It steps the Plant, and sends true states to each Body and to the Recorder.
//!
//! It enforces the validity of every command itself, in case a Body has crashed. It also repairs failed resets, as a
//! person would: it places the robots of a simulated plant at their next starts. Some plants let two robots block each
//! other for good.

use std::cell::RefCell;
use std::rc::Rc;

use crate::actor::Core;
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::local::{Drive, Sample, Truth};
use crate::messages::wire::{Mode, Phase, Round};
use crate::time::{Span, Time};
use crate::world::{Placement, Plant, PlantState};

/// Input of a World.
#[derive(Clone, Debug)]
pub enum In {
    /// Command of one of its Bodies.
    Drive(Drive),
    /// Instruction of the state server.
    Mode(Mode),
}

/// Output of a World.
#[derive(Clone, Debug)]
pub enum Out {
    /// True state for one of its Bodies.
    Sample(Sample),
    /// True states for the Recorder.
    Truth(Truth),
}

/// State that outlives the actor, as real robots outlive the process that watches them: the plant, and the round for
/// which each robot was last placed. Without a World it does not advance.
pub struct PersistentPlant {
    plant: Box<dyn Plant>,
    placed: Vec<Round>,
    /// Last instruction to the team.
    last_mode: (Round, Phase),
    /// First episode for which robots are placed because the reset before it has failed.
    repair_from: Option<u32>,
}

impl PersistentPlant {
    /// Makes the state of a plant in which no robot was placed yet.
    pub fn new(plant: Box<dyn Plant>) -> PersistentPlant {
        let placed = vec![Round::default(); plant.states().len()];
        PersistentPlant { plant, placed, last_mode: (Round::default(), Phase::NeedReset), repair_from: None }
    }
}

/// World of some robots.
pub struct World {
    persistent: Rc<RefCell<PersistentPlant>>,
    period: Span,
    placement: Placement,
    bodies: Vec<Attached>,
    next: Time,
    placed_at: Option<Time>,
}

/// One robot of the world.
#[derive(Clone, Copy, Debug)]
struct Attached {
    robot: RobotId,
    command: Vec2,
    until: Time,
}

impl World {
    /// Makes a world of these robots, in the order of their ids; the plant holds them in the same order.
    pub fn new(persistent: Rc<RefCell<PersistentPlant>>, placement: Placement, robots: &[RobotId]) -> World {
        assert!(robots.is_sorted(), "a world holds its robots in the order of their ids");
        let attach = |&robot: &RobotId| Attached { robot, command: Vec2::zeros(), until: Time::ZERO };
        let period = persistent.borrow().plant.period();
        let bodies = robots.iter().map(attach).collect();
        World { persistent, period, placement, bodies, next: Time::ZERO, placed_at: None }
    }

    /// Whether robots are placed for this instruction.
    fn is_to_place(&mut self, mode: &Mode) -> bool {
        let mut persistent = self.persistent.borrow_mut();
        let (round, phase) = persistent.last_mode;
        if (phase, mode.phase) == (Phase::Resetting, Phase::AbortRunning) && round.episode == mode.round.episode {
            persistent.repair_from = Some(round.episode + 1);
        }
        persistent.last_mode = (mode.round, mode.phase);
        match self.placement {
            Placement::Exact => mode.phase == Phase::Running,
            Placement::Drive => mode.phase == Phase::Resetting && persistent.repair_from == Some(mode.round.episode),
        }
    }

    fn place(&mut self, now: Time, mode: &Mode, out: &mut Vec<Out>) {
        let mut persistent = self.persistent.borrow_mut();
        for (index, body) in self.bodies.iter_mut().enumerate() {
            // A new term of a running episode places no robot again.
            let due = persistent.placed[index].term == 0 || persistent.placed[index].episode < mode.round.episode;
            if let Some(task) = mode.task_of(body.robot).filter(|_| due) {
                persistent.plant.place(index, task.start, task.heading());
                persistent.placed[index] = mode.round;
                (body.command, body.until) = (Vec2::zeros(), now);
                self.placed_at = Some(now);
                out.push(Out::Sample(sample(now, body, &persistent.plant.states()[index])));
            }
        }
    }

    fn samples(&self, now: Time) -> Vec<Sample> {
        let persistent = self.persistent.borrow();
        self.bodies.iter().zip(persistent.plant.states()).map(|(body, state)| sample(now, body, state)).collect()
    }
}

fn sample(now: Time, body: &Attached, state: &PlantState) -> Sample {
    let PlantState { motion, heading, yaw_rate, contacts } = *state;
    Sample { robot: body.robot, time: now, motion, heading, yaw_rate, command: body.command, contacts }
}

impl Core for World {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Drive(drive) => {
                if let Ok(at) = self.bodies.binary_search_by_key(&drive.robot, |body| body.robot) {
                    let body = &mut self.bodies[at];
                    (body.command, body.until) = (drive.velocity, drive.until);
                }
            }
            In::Mode(mode) => {
                if self.is_to_place(&mode) {
                    self.place(now, &mode, out);
                }
            }
        }
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        // A step moves robots for a whole period, so robots placed since the last step wait for the next.
        let steps = self.placed_at.is_none_or(|placed| now.since(placed) >= self.period);
        if steps {
            let mut persistent = self.persistent.borrow_mut();
            for (index, body) in self.bodies.iter_mut().enumerate() {
                if body.until <= now {
                    body.command = Vec2::zeros();
                }
                persistent.plant.drive(index, body.command);
            }
            persistent.plant.advance();
        }
        let samples = self.samples(now);
        out.extend(samples.iter().copied().map(Out::Sample));
        if steps {
            out.push(Out::Truth(Truth { time: now, samples: samples.into() }));
        }
        self.next = now.next_on_grid(Span::ZERO, self.period);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Task;
    use crate::messages::latch::Latch;
    use crate::random::Seed;
    use crate::scenario::{Settings, build};
    use crate::world::{Physics, kinematic};

    fn world(placement: Placement) -> World {
        let passage = build("passage", &Settings::of(2)).unwrap();
        let starts = [Vec2::new(0.0, -1.0), Vec2::new(1.0, -1.0)];
        let physics = Physics::published(passage.arena());
        let persistent = PersistentPlant::new(kinematic::build(passage.arena(), &physics, &starts, Seed::of_run(0)));
        World::new(Rc::new(RefCell::new(persistent)), placement, &[RobotId(0), RobotId(1)])
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn truth(world: &mut World, ms: u64) -> Option<Truth> {
        let mut out = Vec::new();
        world.wake(at_ms(ms), &mut out);
        out.into_iter().find_map(|said| match said {
            Out::Truth(truth) => Some(truth),
            Out::Sample(_) => None,
        })
    }

    #[test]
    fn a_command_that_has_lapsed_drives_no_longer() {
        let mut world = world(Placement::Drive);
        let drive = Drive { robot: RobotId(1), velocity: Vec2::new(0.0, 1.0), until: at_ms(100) };
        world.handle(at_ms(0), In::Drive(drive), &mut Vec::new());
        assert_eq!(truth(&mut world, 50).unwrap().samples[1].command, drive.velocity);
        assert_eq!(truth(&mut world, 100).unwrap().samples[1].command, Vec2::zeros());
    }

    #[test]
    fn after_a_failed_reset_robots_are_put_at_their_next_starts() {
        let mut world = world(Placement::Drive);
        let task = Task { start: Vec2::new(0.5, -2.0), goal: Vec2::zeros() };
        let mut say = |episode: u32, phase: Phase| {
            let (round, latch, mut out) = (Round { term: 1, episode }, Latch::default(), Vec::new());
            let mode = Mode { round, repeat: 0, phase, first: RobotId(0), tasks: [task; 2].into(), latch };
            world.handle(at_ms(50), In::Mode(mode), &mut out);
            out.len()
        };
        assert_eq!(say(0, Phase::Running) + say(0, Phase::AbortRunning) + say(1, Phase::Resetting), 0);
        assert_eq!(say(1, Phase::AbortRunning), 0, "that reset has failed");
        assert_eq!(say(2, Phase::Resetting), 2, "both robots are put in place");
        assert_eq!(say(2, Phase::Resetting) + say(2, Phase::Running) + say(3, Phase::Resetting), 0, "once");
    }

    #[test]
    fn who_was_placed_waits_for_a_whole_step() {
        let mut world = world(Placement::Exact);
        let task = Task { start: Vec2::new(0.5, -2.0), goal: Vec2::zeros() };
        let tasks = [task; 2].into();
        let round = Round { term: 1, episode: 0 };
        let mode = Mode { round, repeat: 0, phase: Phase::Running, first: RobotId(0), tasks, latch: Latch::default() };
        let mut out = Vec::new();
        world.handle(at_ms(50), In::Mode(mode.clone()), &mut out);
        assert_eq!(out.len(), 2, "both bodies learn where they are");
        assert_eq!(truth(&mut world, 50), None, "no step at the instant of placement");
        assert_eq!(truth(&mut world, 100).unwrap().samples[0].motion.position, task.start);
        out.clear();
        world.handle(at_ms(120), In::Mode(mode), &mut out);
        assert!(out.is_empty(), "a repeated instruction places nobody again");
    }
}
