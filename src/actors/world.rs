//! World: one Plant with its step period. It steps the Plant, and sends true states to each Localizer and to the
//! Recorder.
//!
//! Robots that it does not simulate, for example real ones, stand in its Plant where their readings say, so that
//! simulated robots collide with them.
//!
//! It enforces the validity of every command itself, in case a Body has crashed. It also repairs failed resets, as a
//! person would: it places simulated robots at their next starts. This is needed because some plants let two robots
//! block each other for good.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;

use crate::actor::Core;
use crate::chassis::Chassis;
use crate::messages::geometry::{Motion, Task, Vec2};
use crate::messages::ids::RobotId;
use crate::messages::local::{Drive, Sample, Scene, Standing, Truth};
use crate::messages::wire::{Mode, Phase, Reading, Round};
use crate::scenario::Scenario;
use crate::scenario::judge::JudgedRobot;
use crate::scenario::layout::Layouts;
use crate::scenario::watched::Onlooker;
use crate::time::{Span, Time};
use crate::world::{Placement, Plant, PlantState};

/// Longest time for which a World extrapolates a robot that it does not simulate with the velocity of its newest
/// reading; then that robot stands still in the plant. It is twice the age of own readings at which a robot stops.
const MOVED_ON: Span = Span::from_millis(200);

/// Time for which a robot that was placed in motion keeps its velocity, if it gets no command: the validity of a
/// command. Its Agent needs a step of its own to command it.
const COASTING: Span = Span::from_millis(200);

/// Input message of a World, the actor that steps the plant of simulated robots.
#[derive(Clone, Debug)]
pub enum In {
    /// Command from the Body of a simulated robot.
    Drive(Drive),
    /// Instruction of the state server, with the robots' starts and goals.
    Mode(Mode),
    /// Reading of a robot that the World does not simulate.
    Reading(Reading),
}

/// Output message of a World, the actor that steps the plant of simulated robots.
#[derive(Clone, Debug)]
pub enum Out {
    /// True state of a simulated robot, for the robot's Localizer, which makes readings of it.
    Sample(Sample),
    /// True states of all robots that the World simulates, after one step of the plant, for the Recorder.
    Truth(Truth),
    /// True poses of all robots of the team, for the senses of those that the World simulates. Only of a World with
    /// senses.
    Scene(Scene),
}

/// State that survives a crash of the World actor: the plant, and the round for which each robot was last placed.
/// Without a running World the plant does not advance.
pub struct PersistentPlant {
    plant: Box<dyn Plant>,
    placed: Vec<Round>,
    /// Round and phase of the last instruction.
    last_mode: (Round, Phase),
    /// Episode from which on robots are placed, because the reset before it has failed.
    repair_from: Option<u32>,
    /// Time since which the episode runs; `None` while none runs.
    running: Option<Time>,
    /// Episode whose obstacles are in the plant; `None` before the first, or if all episodes have one arena.
    entered: Option<u32>,
}

impl PersistentPlant {
    /// Wraps a plant in which no robot was placed at a start yet.
    pub fn new(plant: Box<dyn Plant>) -> PersistentPlant {
        let placed = vec![Round::default(); plant.states().len()];
        PersistentPlant {
            plant,
            placed,
            last_mode: (Round::default(), Phase::NeedReset),
            repair_from: None,
            running: None,
            entered: None,
        }
    }
}

/// World: the actor that steps the plant of all or some robots of a team, and publishes their true states.
pub struct World {
    persistent: Rc<RefCell<PersistentPlant>>,
    scenario: Arc<dyn Scenario>,
    period: Span,
    placement: Placement,
    bodies: Vec<Attached>,
    others: Vec<Other>,
    next: Time,
    placed_at: Option<Time>,
    /// Whether its robots have senses, which take scenes.
    senses: bool,
    /// Arenas of the episodes, where these differ.
    layouts: Layouts,
    /// Observer of the episodes for the sense `task`, if this World simulates the whole team.
    observing: Option<Observing>,
}

/// Observer of the episodes with what instructions have said of the present one.
#[derive(Debug)]
struct Observing {
    onlooker: Onlooker,
    chassis: Rc<[Chassis]>,
    /// Index of the episode.
    episode: u32,
    /// Tasks of the robots, as far as they are known.
    tasks: Vec<Option<Task>>,
    /// Time since which the episode runs; `None` before.
    since: Option<Time>,
}

impl Observing {
    /// Follows an instruction: an episode begins once all its tasks are known and it runs.
    fn follow(&mut self, now: Time, mode: &Mode) {
        if self.episode != mode.round.episode {
            (self.episode, self.since) = (mode.round.episode, None);
            self.tasks.fill(None);
        }
        let team = RobotId::team(self.tasks.len());
        team.zip(&mut self.tasks).for_each(|(robot, task)| *task = mode.task_of(robot).or(*task));
        if mode.phase != Phase::Running {
            self.since = None;
        } else if self.since.is_none()
            && let Some(tasks) = self.tasks.iter().copied().collect()
        {
            self.since = Some(now);
            self.onlooker.begin((mode.repeat, mode.round.episode), tasks);
        }
    }

    /// Returns what the robots observe in these states; empty while no episode runs.
    fn look(&mut self, now: Time, samples: &[Sample]) -> Arc<[f32]> {
        let Some(since) = self.since else { return Arc::default() };
        let seen = |sample: &Sample| JudgedRobot {
            position: sample.motion.position,
            point: self.chassis[sample.robot.index()].point_of(sample),
            velocity: sample.motion.velocity,
            contacts: sample.contacts,
        };
        let robots: Vec<JudgedRobot> = samples.iter().map(seen).collect();
        self.onlooker.look(now.since(since), &robots).map_or_else(Arc::default, Arc::from)
    }
}

/// Robot that the World simulates, with its last command and the command's expiry.
#[derive(Clone, Copy, Debug)]
struct Attached {
    robot: RobotId,
    command: Vec2,
    until: Time,
}

/// Robot of the team that the World does not simulate.
#[derive(Clone, Debug)]
struct Other {
    robot: RobotId,
    chassis: Chassis,
    /// Index of the robot in the plant.
    index: usize,
    /// Newest reading of the robot, with its arrival time. Before the first one, it stands at its first start.
    seen: Option<(Time, Reading)>,
}

impl Other {
    /// Returns the motion of the robot's centre and its heading \[rad\] at `now`, extrapolated from the newest reading;
    /// `None` before the first reading.
    fn motion(&self, now: Time) -> Option<(Motion, f32)> {
        let (arrived, reading) = self.seen.as_ref()?;
        let age = now.since(*arrived);
        let velocity = reading.twist.velocity;
        let moved = velocity * age.min(MOVED_ON).as_secs() as f32;
        let position = self.chassis.centre(reading) + moved;
        let velocity = if age <= MOVED_ON { velocity } else { Vec2::zeros() };
        Some((Motion { position, velocity }, reading.pose.heading.unwrap_or(0.0)))
    }
}

impl World {
    /// Creates a World that simulates `robots`; `others` stand where their readings say. Both are in the order of their
    /// ids. The plant holds the robots first, then the others, in the same order. `scenario` gives the velocities with
    /// which placed robots start.
    pub fn new(
        persistent: Rc<RefCell<PersistentPlant>>,
        scenario: Arc<dyn Scenario>,
        placement: Placement,
        robots: &[RobotId],
        others: &[(RobotId, Chassis)],
    ) -> World {
        assert!(robots.is_sorted(), "a world holds its robots in the order of their ids");
        let attach = |&robot: &RobotId| Attached { robot, command: Vec2::zeros(), until: Time::ZERO };
        let other = |(at, &(robot, chassis)): (usize, &(RobotId, Chassis))| Other {
            robot,
            chassis,
            index: robots.len() + at,
            seen: None,
        };
        let period = persistent.borrow().plant.period();
        let bodies = robots.iter().map(attach).collect();
        let others = others.iter().enumerate().map(other).collect();
        World {
            persistent,
            scenario,
            period,
            placement,
            bodies,
            others,
            next: Time::ZERO,
            placed_at: None,
            senses: false,
            layouts: Layouts::default(),
            observing: None,
        }
    }

    /// Returns the World with the layouts of the trial: its plant has the obstacles of each episode.
    pub fn with_layouts(self, layouts: Layouts) -> World {
        World { layouts, ..self }
    }

    /// Returns the World with scenes for the senses of its robots, if `senses` says that they have any.
    pub fn with_scenes(self, senses: bool) -> World {
        World { senses, ..self }
    }

    /// Returns the World with an observer of its episodes, if the behaviour of the task observes and the World
    /// simulates the whole team, which has these `chassis`.
    pub fn observing(self, chassis: Rc<[Chassis]>) -> World {
        let whole = self.senses && self.others.is_empty();
        let onlooker = Onlooker::of(&self.scenario).filter(|_| whole);
        let tasks = vec![None; self.bodies.len()];
        let observing = onlooker.map(|onlooker| Observing { onlooker, chassis, episode: 0, tasks, since: None });
        World { observing, ..self }
    }

    /// Returns the poses of all robots that the World knows, in the order of their ids.
    fn scene(&mut self, now: Time, placed: bool) -> Scene {
        let samples = self.samples(now);
        let observed = self.observing.as_mut().map_or_else(Arc::default, |observing| observing.look(now, &samples));
        let persistent = self.persistent.borrow();
        let ids = self.bodies.iter().map(|body| body.robot).chain(self.others.iter().map(|other| other.robot));
        let standing = |(robot, state): (RobotId, &PlantState)| Standing {
            robot,
            centre: state.motion.position,
            heading: state.heading,
        };
        let mut robots: Vec<Standing> = ids.zip(persistent.plant.states()).map(standing).collect();
        robots.sort_by_key(|standing| standing.robot);
        let (episode, elapsed) = (persistent.last_mode.0.episode, persistent.running.map(|since| now.since(since)));
        Scene { time: now, placed, episode, elapsed, robots: robots.into(), observed }
    }

    /// Returns whether the World places robots at their starts for the instruction `mode`, and stores the instruction's
    /// round and phase, with the time from which on the episode runs.
    fn is_to_place(&mut self, now: Time, mode: &Mode) -> bool {
        let mut persistent = self.persistent.borrow_mut();
        let (round, phase) = persistent.last_mode;
        if (phase, mode.phase) == (Phase::Resetting, Phase::AbortRunning) && round.episode == mode.round.episode {
            persistent.repair_from = Some(round.episode + 1);
        }
        if mode.phase != Phase::Running {
            persistent.running = None;
        } else if phase != Phase::Running || round.episode != mode.round.episode {
            persistent.running = Some(now);
        }
        persistent.last_mode = (mode.round, mode.phase);
        match self.placement {
            Placement::Exact => mode.phase == Phase::Running,
            Placement::Drive => mode.phase == Phase::Resetting && persistent.repair_from == Some(mode.round.episode),
        }
    }

    /// Puts the obstacles of the instruction's episode into the plant, if they are others than before. Returns the
    /// indices of the simulated robots that are within them.
    fn enter(&mut self, mode: &Mode) -> Vec<usize> {
        let mut persistent = self.persistent.borrow_mut();
        let episode = mode.round.episode;
        let Some(arena) = self.layouts.arena(episode).filter(|_| persistent.entered != Some(episode)) else {
            return Vec::new();
        };
        persistent.entered = Some(episode);
        assert!(persistent.plant.enter(arena), "the trial was checked: its plant takes the obstacles of episodes");
        let states = self.bodies.iter().zip(persistent.plant.states()).enumerate();
        let within = |state: &PlantState| arena.clearance(state.motion.position) <= arena.robot_radius_m;
        states.filter(|(_, (_, state))| within(state)).map(|(index, _)| index).collect()
    }

    /// Places the robots that the instruction has tasks of and that were not placed for its episode yet.
    fn place(&mut self, now: Time, mode: &Mode, out: &mut Vec<Out>) {
        let mut persistent = self.persistent.borrow_mut();
        let mut placed = Vec::new();
        for (index, body) in self.bodies.iter().enumerate() {
            // A new term of a running episode places no robot again.
            let due = persistent.placed[index].term == 0 || persistent.placed[index].episode < mode.round.episode;
            if let Some(task) = mode.task_of(body.robot).filter(|_| due) {
                persistent.placed[index] = mode.round;
                placed.push((index, task, self.scenario.start_velocity(&task)));
            }
        }
        drop(persistent);
        self.put(now, &placed, out);
    }

    /// Places robots at their starts that stand where obstacles were put, by their indices.
    fn free(&mut self, now: Time, mode: &Mode, caught: &[usize], out: &mut Vec<Out>) {
        let tasks = self.layouts.episode(mode.round.episode);
        let at_start = |&index: &usize| (index, tasks[self.bodies[index].robot.index()], Vec2::zeros());
        let placed: Vec<(usize, Task, Vec2)> = caught.iter().map(at_start).collect();
        self.put(now, &placed, out);
    }

    /// Puts robots at the starts of their tasks, by their indices, each with its velocity \[m/s\], and tells their
    /// Localizers and senses.
    fn put(&mut self, now: Time, robots: &[(usize, Task, Vec2)], out: &mut Vec<Out>) {
        let mut persistent = self.persistent.borrow_mut();
        for &(index, task, velocity) in robots {
            let body = &mut self.bodies[index];
            persistent.plant.place(index, task.start, task.heading());
            (body.command, body.until) = (Vec2::zeros(), now);
            if velocity != Vec2::zeros() {
                persistent.plant.launch(index, velocity);
                (body.command, body.until) = (velocity, now + COASTING);
            }
            self.placed_at = Some(now);
            out.push(Out::Sample(sample(now, body, &persistent.plant.states()[index])));
        }
        drop(persistent);
        if self.senses && self.placed_at == Some(now) {
            out.push(Out::Scene(self.scene(now, true)));
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
            In::Reading(reading) => {
                if let Ok(at) = self.others.binary_search_by_key(&reading.robot, |other| other.robot) {
                    self.others[at].seen = Some((now, reading));
                }
            }
            In::Mode(mode) => {
                if let Some(observing) = &mut self.observing {
                    observing.follow(now, &mode);
                }
                let places = self.is_to_place(now, &mode);
                let caught = self.enter(&mode);
                if places {
                    self.place(now, &mode, out);
                } else if !caught.is_empty() {
                    self.free(now, &mode, &caught, out);
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
            for other in &self.others {
                if let Some((motion, heading)) = other.motion(now) {
                    persistent.plant.carry(other.index, motion, heading);
                }
            }
            let elapsed = persistent.running.map(|since| now.since(since));
            persistent.plant.elapse(elapsed);
            persistent.plant.advance();
        }
        let samples = self.samples(now);
        out.extend(samples.iter().copied().map(Out::Sample));
        if steps {
            out.push(Out::Truth(Truth { time: now, samples: samples.into() }));
            if self.senses {
                out.push(Out::Scene(self.scene(now, false)));
            }
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
    use crate::scenario::{Settings, TaskFile, build};
    use crate::world::{Physics, kinematic};

    fn world(placement: Placement) -> World {
        let passage = build("passage", &Settings::of(2)).unwrap();
        let starts = [Vec2::new(0.0, -1.0), Vec2::new(1.0, -1.0)];
        let physics = Physics::published(passage.arena());
        let persistent = PersistentPlant::new(kinematic::build(passage.arena(), &physics, &starts, Seed::of_run(0)));
        World::new(Rc::new(RefCell::new(persistent)), passage, placement, &[RobotId(0), RobotId(1)], &[])
    }

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn truth(world: &mut World, ms: u64) -> Option<Truth> {
        let mut out = Vec::new();
        world.wake(at_ms(ms), &mut out);
        out.into_iter().find_map(|said| match said {
            Out::Truth(truth) => Some(truth),
            Out::Sample(_) | Out::Scene(_) => None,
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
    fn a_robot_of_elsewhere_stands_where_it_was_measured_and_blocks_the_way() {
        let passage = build("passage", &Settings::of(2)).unwrap();
        let starts = [Vec2::new(0.0, -1.0), Vec2::new(1.0, -1.0)];
        let physics = Physics::published(passage.arena());
        let plant = PersistentPlant::new(kinematic::build(passage.arena(), &physics, &starts, Seed::of_run(0)));
        let elsewhere = [(RobotId(0), Chassis::default())];
        let plant = Rc::new(RefCell::new(plant));
        let mut world = World::new(plant, passage, Placement::Drive, &[RobotId(1)], &elsewhere);
        let wall = Motion { position: Vec2::new(0.0, -2.0), velocity: Vec2::new(0.0, 0.5) };
        let mut see = |ms: u64| {
            world.handle(at_ms(ms), In::Reading(Reading::of_point(RobotId(0), ms, wall)), &mut Vec::new());
            let drive = Drive { robot: RobotId(1), velocity: Vec2::new(0.0, -1.0), until: at_ms(ms + 100) };
            world.handle(at_ms(ms), In::Drive(drive), &mut Vec::new());
            let samples = truth(&mut world, ms).expect("a step").samples;
            let [only] = &samples[..] else { panic!("it tells of its own robots alone") };
            assert_eq!(only.robot, RobotId(1));
            (only.motion.position, only.contacts.robot)
        };
        let last = (1..200).map(|step| see(50 * step)).last().unwrap();
        assert!((last.0 - starts[0]).norm() < 0.6, "its own robot began there: {last:?}");
        assert!(last.1 && (last.0 - wall.position).norm() > 0.5, "it is blocked: {last:?}");
        let seen = world.others[0].motion(at_ms(50 * 199 + 1000)).unwrap().0;
        let age = MOVED_ON.as_secs() as f32;
        assert_eq!(seen, Motion::at_rest(wall.position + wall.velocity * age), "silent, it stands");
    }

    #[test]
    fn a_robot_that_stands_where_an_obstacle_is_put_is_placed_at_its_start() {
        let text = "name = \"field\"\nrobots = { default = 2, least = 2, most = 2 }\nhalf_extent_m = [3.0, 3.0]\n\
                    obstacles = [{ count = 6, size_m = [0.6, 0.6], within = [-3, -3, 3, 3], each_episode = true }]\n\
                    area = { rect = [-3, -3, 3, 3] }\nrules = { arrival_m = 0.25, limit_s = 40.0 }";
        let field = TaskFile::read(text).expect("it is sound").scenario(&Settings::default()).expect("it is sound");
        let layouts = Layouts::of_scenario(&*field, 5, 2);
        let blocks = &layouts.arena(1).expect("it has one").keep_outs;
        let caught = (blocks[0].min + blocks[0].max) / 2.0;
        let tasks = layouts.episode(1);
        let physics = Physics::published(field.arena());
        let plant = kinematic::build(field.arena(), &physics, &[caught, tasks[1].start], Seed::of_run(0));
        let plant = Rc::new(RefCell::new(PersistentPlant::new(plant)));
        let robots = [RobotId(0), RobotId(1)];
        let mut world = World::new(plant, Arc::clone(&field), Placement::Drive, &robots, &[]);
        world = world.with_layouts(layouts.clone());
        let round = Round { term: 1, episode: 1 };
        let (phase, first, latch) = (Phase::Resetting, RobotId(1), Latch::default());
        // An instruction that has the task of the other robot alone.
        let mode = Mode { round, repeat: 0, phase, first, tasks: tasks[1..].into(), latch };
        let mut out = Vec::new();
        world.handle(at_ms(50), In::Mode(mode.clone()), &mut out);
        let [Out::Sample(moved)] = &out[..] else { panic!("one robot is moved: {out:?}") };
        assert_eq!((moved.robot, moved.motion.position), (RobotId(0), tasks[0].start));
        out.clear();
        world.handle(at_ms(60), In::Mode(mode), &mut out);
        assert!(out.is_empty(), "a repeated instruction moves no robot again");
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
