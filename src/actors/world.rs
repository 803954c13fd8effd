//! World: one Plant and its clock. It steps the Plant, tells each Body its true state, and the Recorder all.
//!
//! It enforces the validity of every command by itself, for a Body that has stopped in mid-command.

use std::sync::Arc;

use super::Core;
use crate::messages::geometry::Vec2;
use crate::messages::ids::RobotId;
use crate::messages::local::{Drive, Sample, Truth};
use crate::messages::wire::{Mode, Phase, Round};
use crate::time::{Span, Time};
use crate::world::{Placement, Plant};

/// What a World accepts.
#[derive(Clone, Debug)]
pub enum In {
    /// From one of its Bodies.
    Drive(Drive),
    /// The state server's instruction.
    Mode(Mode),
}

/// What a World says.
#[derive(Clone, Debug)]
pub enum Out {
    /// To one of its Bodies.
    Sample(Sample),
    /// To the Recorder.
    Truth(Truth),
}

/// A world of some robots.
pub struct World {
    plant: Box<dyn Plant>,
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
    /// The last round that it was placed for.
    placed: Round,
}

impl World {
    /// A world of these robots, which the plant holds in the same order.
    pub fn new(plant: Box<dyn Plant>, placement: Placement, robots: &[RobotId]) -> World {
        let attach =
            |&robot: &RobotId| Attached { robot, command: Vec2::zeros(), until: Time::ZERO, placed: Round::default() };
        World { plant, placement, bodies: robots.iter().map(attach).collect(), next: Time::ZERO, placed_at: None }
    }

    fn period(&self) -> Span {
        self.plant.period()
    }

    fn place(&mut self, now: Time, mode: &Mode, out: &mut Vec<Out>) {
        let mut placed = false;
        for (index, body) in self.bodies.iter_mut().enumerate() {
            if let Some(task) = mode.task_of(body.robot).filter(|_| body.placed < mode.round) {
                self.plant.place(index, task.start);
                (body.command, body.until, body.placed) = (Vec2::zeros(), now, mode.round);
                placed = true;
            }
        }
        if placed {
            self.placed_at = Some(now);
            self.tell(now, out);
        }
    }

    fn samples(&self, now: Time) -> impl Iterator<Item = Sample> + '_ {
        self.bodies.iter().zip(self.plant.states()).map(move |(body, state)| Sample {
            robot: body.robot,
            time: now,
            motion: state.motion,
            command: body.command,
            contacts: state.contacts,
        })
    }

    fn tell(&self, now: Time, out: &mut Vec<Out>) {
        out.extend(self.samples(now).map(Out::Sample));
    }
}

impl Core for World {
    type In = In;
    type Out = Out;

    fn handle(&mut self, now: Time, input: In, out: &mut Vec<Out>) {
        match input {
            In::Drive(drive) => {
                if let Some(body) = self.bodies.iter_mut().find(|body| body.robot == drive.robot) {
                    (body.command, body.until) = (drive.velocity, drive.until);
                }
            }
            In::Mode(mode) if self.placement == Placement::Exact && mode.phase == Phase::Running => {
                self.place(now, &mode, out);
            }
            In::Mode(_) => {}
        }
    }

    fn wake_at(&self) -> Option<Time> {
        Some(self.next)
    }

    fn wake(&mut self, now: Time, out: &mut Vec<Out>) {
        // A step moves robots through a whole period: whoever was placed since the last one waits for the next.
        if self.placed_at.is_none_or(|placed| now.since(placed) >= self.period()) {
            for (index, body) in self.bodies.iter_mut().enumerate() {
                if body.until <= now {
                    body.command = Vec2::zeros();
                }
                self.plant.drive(index, body.command);
            }
            self.plant.advance();
            out.push(Out::Truth(Truth { time: now, samples: self.samples(now).collect::<Arc<[Sample]>>() }));
        }
        self.tell(now, out);
        self.next = now.next_on_grid(Span::ZERO, self.period());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Task;
    use crate::scenario::{Settings, build};
    use crate::world::kinematic;

    fn world(placement: Placement) -> World {
        let passage = build("passage", &Settings { robots: Some(2) }).unwrap();
        let starts = [Vec2::new(0.0, -1.0), Vec2::new(1.0, -1.0)];
        World::new(kinematic::build(passage.arena(), &starts), placement, &[RobotId(0), RobotId(1)])
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
    fn who_was_placed_waits_for_a_whole_step() {
        let mut world = world(Placement::Exact);
        let task = Task { start: Vec2::new(0.5, -2.0), goal: Vec2::zeros() };
        let tasks = [task; 2].into();
        let round = Round { epoch: 1, episode: 0 };
        let mode = Mode { round, repeat: 0, phase: Phase::Running, first: RobotId(0), tasks };
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
