//! The safety filter, whatever the policy: within its assumptions no robot touches another or a wall.
//!
//! Teams of guards drive the training world with lag. Each guard knows its own state, and what arrives of the others:
//! one step late, 30 % lost. Seeds are fixed, so a failure repeats.

use std::sync::{Arc, Mutex};

use murmurate::chassis::{Chassis, DriveKind, Settings};
use murmurate::deploy::Impair;
use murmurate::messages::geometry::{Motion, Planar, Vec2};
use murmurate::messages::ids::RobotId;
use murmurate::messages::local::{Action, Contacts, OtherRobot, Progress};
use murmurate::messages::wire::{Phase, Round};
use murmurate::observation::{Dynamics, Observation};
use murmurate::policy::{Interface, Model, Neighbour, Policy};
use murmurate::random::{Seed, Stream};
use murmurate::safety::filter;
use murmurate::safety::guard::{Decision, Guard};
use murmurate::safety::{Clamp, Safety, Switch};
use murmurate::scenario::judge::Verdict;
use murmurate::scenario::{self, Arena};
use murmurate::time::{Span, Time};
use murmurate::trial::Trial;
use murmurate::world::kinematic::{self, PERIOD, TeamMotion};
use murmurate::world::{ContactRule, Physics, Wheels};
use rand::RngExt;

/// Radius of a hull \[m\].
const HULL_M: f32 = 0.16;
/// Share of messages that are lost.
const LOSS: f32 = 0.3;

/// What a robot's policy wants.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wish {
    /// Another random velocity every step.
    Jitter,
    /// A random velocity for a second.
    Wander,
    /// Full speed at the nearest robot.
    Chase,
    /// Full speed at the nearest wall.
    Ram,
    /// Each robot one of the above, drawn anew every two seconds.
    Mixed,
}

/// A team of guards and its world.
struct Bench {
    arena: Arena,
    physics: Physics,
    guards: Vec<Guard>,
    position: Vec<Vec2>,
    velocity: Vec<Vec2>,
    wheels: Vec<Wheels>,
    contacts: Vec<Contacts>,
    before: Vec<Vec2>,
    /// By receiver and sender: the newest motion that has arrived, and when.
    known: Vec<Option<(Time, Motion)>>,
    wishes: Vec<(Wish, Vec2)>,
    stream: Stream,
    now: Time,
}

impl Bench {
    fn new(robots: usize, seed: u64, clamp: Clamp, lag_s: f32, drive: &Settings) -> Bench {
        let chassis = drive.chassis().expect("it is sound");
        let settings = scenario::Settings { robots: Some(robots), ..scenario::Settings::default() };
        let passage = scenario::build("passage", &settings).expect("a size of the passage");
        let arena = passage.arena().clone();
        let position: Vec<Vec2> = passage.tasks(seed, 0).iter().map(|task| task.start).collect();
        let acceleration_m_s2 = if clamp == Clamp::Training { 1.0 } else { f32::INFINITY };
        let (contacts, wall_radius_m) = (ContactRule::Judge, HULL_M);
        let physics = Physics { contacts, wall_radius_m, acceleration_m_s2, lag_s, ..Physics::published(&arena) };
        let ahead = chassis.point_ahead_m;
        let safety = Safety { own_state: Switch::Off, late_tick: Switch::Off, ..Safety::deployed() };
        let safety = safety.driving(lag_s, acceleration_m_s2).about_point(ahead, ahead);
        let config = filter::Settings {
            safety,
            half_extent: arena.half_extent.add_scalar(-ahead),
            walls: arena.keep_outs.as_slice().into(),
            movers: Arc::default(),
            limit_m_s: 1.5,
            clamp,
            period: PERIOD,
        };
        let zeros = vec![Vec2::zeros(); robots];
        let wheels = match chassis == Chassis::default() {
            true => Vec::new(),
            false => vec![Wheels::new(chassis, 1.0); robots],
        };
        Bench {
            arena,
            physics,
            guards: (0..robots).map(|_| Guard::new(config.clone())).collect(),
            position,
            velocity: zeros.clone(),
            wheels,
            contacts: vec![Contacts::default(); robots],
            before: zeros.clone(),
            known: vec![None; robots * robots],
            wishes: vec![(Wish::Jitter, Vec2::zeros()); robots],
            stream: Seed::of_run(seed).stream("filter"),
            now: Time::ZERO,
        }
    }

    /// Motion of the point of a robot that its policy commands.
    fn point(&self, robot: usize) -> Motion {
        let centre = Motion { position: self.position[robot], velocity: self.velocity[robot] };
        self.wheels.get(robot).map_or(centre, |wheels| wheels.point(&centre))
    }

    fn any_velocity(&mut self) -> Vec2 {
        let mut axis = || self.stream.random_range(-1.5f32..1.5);
        Vec2::new(axis(), axis())
    }

    fn wanted(&mut self, wish: Wish, step: u32, robot: usize) -> Vec2 {
        if wish == Wish::Mixed {
            if step.is_multiple_of(40) {
                let drawn = [Wish::Jitter, Wish::Wander, Wish::Chase, Wish::Ram][self.stream.random_range(0..4)];
                self.wishes[robot].0 = drawn;
            }
            return self.wanted(self.wishes[robot].0, step, robot);
        }
        let own = self.position[robot];
        let toward = |to: Vec2| (to - own).try_normalize(1e-3).unwrap_or_else(Vec2::x) * 2.1;
        match wish {
            Wish::Jitter => self.any_velocity(),
            Wish::Wander => {
                if step.is_multiple_of(20) {
                    self.wishes[robot].1 = self.any_velocity();
                }
                self.wishes[robot].1
            }
            Wish::Chase => {
                let others = self.position.iter().enumerate().filter(|(other, _)| *other != robot);
                let nearest = others.min_by(|a, b| (*a.1 - own).norm().total_cmp(&(*b.1 - own).norm()));
                toward(*nearest.expect("there are others").1)
            }
            Wish::Ram => {
                let walls = self.arena.keep_outs.iter().map(|block| block.nearest(own));
                toward(walls.min_by(|a, b| (*a - own).norm().total_cmp(&(*b - own).norm())).expect("there are walls"))
            }
            Wish::Mixed => unreachable!("it is one of the others"),
        }
    }

    /// Lets every guard decide and the world move on; messages with the states before arrive afterwards.
    fn step(&mut self, step: u32, wish: impl Fn(&mut Bench, u32, usize) -> Vec2) {
        let robots = self.guards.len();
        let points: Vec<Motion> = (0..robots).map(|robot| self.point(robot)).collect();
        let mut commands = vec![Vec2::zeros(); robots];
        for robot in 0..robots {
            let others = (0..robots).filter_map(|other| {
                let (arrived, motion) = self.known[robot * robots + other]?;
                Some(OtherRobot { robot: RobotId(other as u16), motion, age: self.now.since(arrived) })
            });
            let action = Action {
                robot: RobotId(robot as u16),
                round: Round::default(),
                phase: Phase::Running,
                due: self.now,
                others: others.collect(),
                velocity: Some(wish(self, step, robot)),
                estimate: points[robot],
                progress: Progress::Underway,
            };
            self.guards[robot].server_heard(self.now);
            commands[robot] = match self.guards[robot].decide(self.now, &action) {
                Decision::Drive(granted) => granted.velocity(),
                decision => panic!("{decision:?}"),
            };
        }
        self.now += PERIOD;
        for receiver in 0..robots {
            for sender in (0..robots).filter(|sender| *sender != receiver) {
                // All are heard at the start.
                if step == 0 || self.stream.random::<f32>() >= LOSS {
                    self.known[receiver * robots + sender] = Some((self.now, points[sender]));
                }
            }
        }
        let mut team = TeamMotion {
            position: &mut self.position,
            velocity: &mut self.velocity,
            wheels: &mut self.wheels,
            contacts: &mut self.contacts,
            before: &mut self.before,
        };
        kinematic::step(&self.arena, &self.physics, &commands, &mut team);
    }

    /// Least distance between two centres, and between a centre and a wall \[m\].
    fn least(&self) -> (f32, f32) {
        let mut apart = f32::INFINITY;
        for (index, one) in self.position.iter().enumerate() {
            self.position[..index].iter().for_each(|other| apart = apart.min((*one - *other).norm()));
        }
        (apart, self.position.iter().map(|at| self.arena.clearance(*at)).fold(f32::INFINITY, f32::min))
    }
}

/// Runs teams for `steps` steps of 50 ms in total, with each wish and each world in turn. Returns the least distances.
fn run(steps: u32, drive: &Settings) -> (f32, f32) {
    // The clamp of the training lets robots brake at the limit of their acceleration.
    let braking = [0.5, 0.25, 0.1, 0.05, 0.02, 0.0].map(|lag_s| (Clamp::Training, lag_s));
    let deployed = [0.5, 0.25, 0.8, 0.1].map(|lag_s| (Clamp::Deployed, lag_s));
    let worlds = [&deployed[..], &braking[..]].concat();
    let wishes = [Wish::Jitter, Wish::Wander, Wish::Chase, Wish::Ram, Wish::Mixed];
    let (mut least, length) = ((f32::INFINITY, f32::INFINITY), 400);
    for episode in 0..steps / length {
        let (wish, (clamp, lag_s)) = (wishes[episode as usize % 5], worlds[episode as usize / 5 % worlds.len()]);
        let robots = 2 + episode as usize * 5 % 7;
        let mut bench = Bench::new(robots, u64::from(episode), clamp, lag_s, drive);
        for step in 0..length {
            bench.step(step, |bench, step, robot| bench.wanted(wish, step, robot));
            let (apart, clear) = bench.least();
            let place = format!("episode {episode} step {step}: {robots} robots, {wish:?}, {clamp:?}, lag {lag_s} s");
            assert!(apart > 2.0 * HULL_M, "{place}: two robots are {apart} m apart");
            assert!(clear > HULL_M, "{place}: a robot is {clear} m from a wall");
            least = (least.0.min(apart), least.1.min(clear));
        }
    }
    println!("{steps} steps: at least {} m apart, {} m from walls", least.0, least.1);
    least
}

fn differential() -> Settings {
    Settings { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Settings::default() }
}

/// Number of steps: MURMURATE_FILTER_STEPS, or few.
fn steps(few: u32) -> u32 {
    std::env::var("MURMURATE_FILTER_STEPS").map_or(few, |steps| steps.parse().expect("a number of steps"))
}

#[test]
fn no_policy_makes_holonomic_robots_touch_each_other_or_a_wall() {
    run(steps(60_000), &Settings::default());
}

#[test]
fn no_policy_makes_differential_robots_touch_each_other_or_a_wall() {
    run(steps(30_000), &differential());
}

/// Interface of the policies of whole trials.
const INTERFACE: Interface =
    Interface { features: 1, radius_m: 2.0, period: PERIOD, limit_m_s: 1.5, hold: Span::from_millis(400) };

/// Policy that drives in random directions, or at its nearest neighbour.
struct Unsafe(Wish);

impl Policy for Unsafe {
    fn interface(&self) -> Interface {
        INTERFACE
    }

    fn encode(&mut self, _: &Observation, features: &mut [f32]) {
        features.fill(0.0);
    }

    fn act(&mut self, own: &Observation, _: &[f32], neighbours: &[Neighbour], stream: &mut Stream) -> Vec2 {
        let apart = |other: &&Neighbour| (other.motion.position - own.motion.position).norm();
        match neighbours.iter().min_by(|a, b| apart(a).total_cmp(&apart(b))) {
            Some(nearest) if self.0 == Wish::Chase => (nearest.motion.position - own.motion.position) * 9.0,
            _ => Vec2::new(stream.random_range(-1.5..1.5), stream.random_range(-1.5..1.5)),
        }
    }
}

/// Whole trials at lag 0.5 s, 50 ms and 30 % loss; MURMURATE_FILTER_EPISODES of each policy, or four.
#[test]
fn no_policy_makes_whole_teams_collide() {
    let episodes = std::env::var("MURMURATE_FILTER_EPISODES").map_or(4, |n| n.parse().expect("a number of episodes"));
    for wish in [Wish::Jitter, Wish::Chase] {
        for clamp in [Clamp::Deployed, Clamp::Training] {
            let mut trial = Trial::preset("onboard-adhoc", "passage").expect("a preset").seed(7).episodes(episodes);
            trial.models = Model::custom("unsafe", INTERFACE, move |_| Box::new(Unsafe(wish))).into();
            (trial.physics.contacts, trial.physics.wall_radius_m) = (ContactRule::Judge, HULL_M);
            trial.physics.lag_s = 0.5;
            trial.deployment =
                trial.deployment.impaired(Some(0.05), Some(LOSS.into()), Impair::Latent).expect("it has links");
            let report = trial.clamp(clamp).safety(Safety::deployed()).run();
            let failed = |verdict| report.episodes.iter().filter(|episode| episode.verdict == verdict).count();
            let (robots, walls) = (failed(Verdict::RobotCollision), failed(Verdict::WallCollision));
            println!("{wish:?}, {clamp:?}: {episodes} episodes, {robots} collisions of robots, {walls} with walls");
            assert_eq!((report.episodes.len(), robots, walls), (episodes as usize, 0, 0), "{wish:?}, {clamp:?}");
        }
    }
}

/// Policy that stands still and notes the dynamics that it observes.
struct Noting(Arc<Mutex<Vec<Dynamics>>>);

impl Policy for Noting {
    fn interface(&self) -> Interface {
        INTERFACE
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        self.0.lock().expect("no thread has panicked").push(own.dynamics);
        features.fill(0.0);
    }

    fn act(&mut self, own: &Observation, _: &[f32], _: &[Neighbour], _: &mut Stream) -> Vec2 {
        self.0.lock().expect("no thread has panicked").push(own.dynamics);
        Vec2::zeros()
    }
}

#[test]
fn a_policy_observes_whether_the_filter_is_on_and_the_lag_of_its_robot() {
    for (filtered, lag_s) in [(false, 0.0), (false, 0.5), (true, 0.7)] {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let mut trial = Trial::preset("onboard-adhoc", "passage").expect("a preset").lasting(Span::from_secs(20.0));
        let notes = Arc::clone(&seen);
        trial.models = Model::custom("noting", INTERFACE, move |_| Box::new(Noting(Arc::clone(&notes)))).into();
        trial.physics.lag_s = lag_s;
        let trial = if filtered { trial.safety(Safety::filter()) } else { trial };
        trial.run();
        let seen = seen.lock().expect("no thread has panicked");
        assert!(!seen.is_empty(), "the episode has begun");
        assert!(
            seen.iter().all(|dynamics| *dynamics == Dynamics { filtered, lag_s, point_ahead_m: 0.0 }),
            "{:?}",
            seen[0]
        );
    }
}

#[test]
fn without_the_filter_the_same_policies_collide() {
    let mut bench = Bench::new(6, 1, Clamp::Deployed, 0.5, &Settings::default());
    let (distance, walls) = (Switch::Off, Switch::Off);
    let arena = bench.arena.clone();
    for guard in &mut bench.guards {
        *guard = Guard::new(filter::Settings {
            safety: Safety { distance, walls, ..Safety::emulated() },
            half_extent: arena.half_extent,
            walls: arena.keep_outs.as_slice().into(),
            movers: Arc::default(),
            limit_m_s: 1.5,
            clamp: Clamp::Deployed,
            period: PERIOD,
        });
    }
    let mut least = f32::INFINITY;
    for step in 0..100 {
        bench.step(step, |bench, step, robot| bench.wanted(Wish::Chase, step, robot));
        least = least.min(bench.least().0);
    }
    assert!(least < 0.1, "{least}");
}

/// Robots on a circle that all want to the opposite point: they meet in the middle.
#[test]
fn robots_that_meet_head_on_get_past_each_other() {
    for robots in [2, 3, 4, 6, 8] {
        let mut bench = Bench::new(robots, 1, Clamp::Deployed, 0.5, &Settings::default());
        bench.arena.keep_outs.clear();
        for guard in &mut bench.guards {
            let safety = Safety { own_state: Switch::Off, late_tick: Switch::Off, ..Safety::deployed() };
            let (half_extent, walls, period) = (Vec2::new(4.0, 4.0), Arc::default(), PERIOD);
            *guard = Guard::new(filter::Settings {
                safety,
                half_extent,
                walls,
                movers: Arc::default(),
                limit_m_s: 1.0,
                clamp: Clamp::Deployed,
                period,
            });
        }
        let starts: Vec<Vec2> = (0..robots)
            .map(|robot| {
                let (y, x) = (robot as f32 * std::f32::consts::TAU / robots as f32).sin_cos();
                Vec2::new(x, y) * 1.6
            })
            .collect();
        bench.position.copy_from_slice(&starts);
        let mut after = None;
        for step in 0..1600 {
            bench.step(step, |bench, _, robot| (-starts[robot] - bench.position[robot]).capped(1.0));
            assert!(bench.least().0 > 2.0 * HULL_M, "{robots} robots, step {step}: {} m apart", bench.least().0);
            if bench.position.iter().zip(&starts).all(|(at, start)| (*at + *start).norm() < 0.25) {
                after = Some(step);
                break;
            }
        }
        println!("{robots} robots have changed places after {after:?} steps");
        assert!(after.is_some(), "{robots} robots: {:?}", bench.position);
    }
}

#[test]
fn a_tick_of_a_guard_with_four_neighbours_allocates_nothing() {
    let mut bench = Bench::new(5, 3, Clamp::Deployed, 0.5, &Settings::default());
    let others: Vec<OtherRobot> = (1..5)
        .map(|other| OtherRobot {
            robot: RobotId(other),
            motion: Motion { position: bench.position[usize::from(other)], velocity: Vec2::new(0.3, -0.2) },
            age: Span::from_millis(20),
        })
        .collect();
    let estimate = Motion { position: bench.position[0], velocity: Vec2::new(0.4, 0.1) };
    let mut action = Action {
        robot: RobotId(0),
        round: Round::default(),
        phase: Phase::Running,
        due: Time::ZERO,
        others,
        velocity: Some(Vec2::new(1.0, 0.5)),
        estimate,
        progress: Progress::Underway,
    };
    let guard = &mut bench.guards[0];
    guard.server_heard(Time::ZERO);
    guard.decide(Time::ZERO, &action);
    let counted = allocation_counter::measure(|| {
        for tick in 1..15 {
            let now = Time::ZERO + Span::from_millis(50 * tick);
            (action.due, action.velocity) = (now, action.velocity.map(|velocity| -velocity));
            std::hint::black_box(guard.decide(now, &action));
        }
    });
    assert_eq!(counted.count_total, 0, "{counted:?}");
}
