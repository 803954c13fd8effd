//! The training world of the paper: holonomic discs with limited acceleration, which walls and other robots block.
//! Arithmetic and order of operations are those of the environment published with the paper, in 32-bit floats.
//!
//! A robot with another chassis is a disc about its centre. Its limits act on the velocity of the point that its policy
//! commands, which [`Wheels`] turns into a motion of centre and heading. A robot that is blocked still turns, because
//! its hull is round.
//!
//! The function `step` alone defines these dynamics. The World, an actor, and the trainer both call it.

use std::array::from_fn;
use std::collections::BTreeMap;

use super::{ContactRule, Physics, Plant, PlantState, Wheels};
use crate::cells::{self, Cells};
use crate::chassis::Chassis;
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::local::Contacts;
use crate::random::Seed;
use crate::scenario::Arena;
use crate::time::Span;

/// Duration of one step of the training world (50 ms); the plant `rigid` has the same.
pub const PERIOD: Span = Span::from_millis(50);
/// Duration of a step \[s\], as a number.
const DT_S: f32 = 0.05;
/// Largest speed of a simulated robot along each axis of the training world \[m/s\], as in the environment published
/// with the paper.
pub const MAX_SPEED_M_S: f32 = 1.5;
/// Default limit of a simulated robot's acceleration along each axis \[m/s^2\], as in the environment published with
/// the paper.
pub const MAX_ACCELERATION_M_S2: f32 = 1.0;

/// State of all robots of one simulated world, which `step` updates in place. Each slice has one entry per robot,
/// except `wheels`, which may be empty.
#[derive(Debug)]
pub struct TeamMotion<'a> {
    /// Positions of the robots' centres \[m\], world frame.
    pub position: &'a mut [Vec2],
    /// Velocities of the robots' centres \[m/s\], world frame.
    pub velocity: &'a mut [Vec2],
    /// Chassis and heading of each robot; empty if all robots are holonomic without limits of their own.
    pub wheels: &'a mut [Wheels],
    /// Output: contacts of each robot with other robots and with walls in the step.
    pub contacts: &'a mut [Contacts],
    /// Scratch space, into which the step copies the positions that the robots had before \[m\].
    pub before: &'a mut [Vec2],
}

/// Advances every robot of `team` by one step of duration `PERIOD`. `arena` gives the ground, the walls and the robots'
/// radius, with moving obstacles among the walls where they are at the end of the step (`Arena::at`); `physics` gives
/// lag, limits and the effect of contacts.
///
/// `commands` has, for each robot, the commanded velocity \[m/s\], world frame. The velocity is that of the commanded
/// point: the centre of a holonomic robot, a point ahead of the axle of a differential drive.
pub fn step(arena: &Arena, physics: &Physics, commands: &[Vec2], team: &mut TeamMotion) {
    team.before.copy_from_slice(team.position);
    let (max_acceleration, gain) = (physics.acceleration_m_s2, physics.gain(PERIOD));
    let driven = |velocity: f32, command: f32| {
        let mut wanted = limited(command, MAX_SPEED_M_S);
        if gain < 1.0 {
            wanted = velocity + (wanted - velocity) * gain;
        }
        velocity + limited((wanted - velocity) / DT_S, max_acceleration) * DT_S
    };
    if team.wheels.is_empty() {
        // The axes of two robots at once, so that the compiler computes them as one vector.
        let axes = |[one, other]: [Vec2; 2]| [one.x, one.y, other.x, other.y];
        let (pairs, last) = team.velocity.as_chunks_mut::<2>();
        let (pairs_commanded, last_commanded) = commands.as_chunks::<2>();
        for (pair, commands) in pairs.iter_mut().zip(pairs_commanded) {
            let (velocity, command) = (axes(*pair), axes(*commands));
            let [a, b, c, d] = from_fn(|axis| driven(velocity[axis], command[axis]));
            *pair = [Vec2::new(a, b), Vec2::new(c, d)];
        }
        for (velocity, command) in last.iter_mut().zip(last_commanded) {
            *velocity = velocity.zip_map(command, driven);
        }
    } else {
        for ((velocity, wheels), command) in team.velocity.iter_mut().zip(&mut *team.wheels).zip(commands) {
            let point = wheels.point(&Motion { position: Vec2::zeros(), velocity: *velocity }).velocity;
            let wanted = Vec2::new(driven(point.x, command.x), driven(point.y, command.y));
            *velocity = wheels.drive(wanted, DT_S);
        }
    }
    let (blocks, distance) = match physics.contacts {
        ContactRule::Block => (true, 2.0 * arena.robot_radius_m),
        ContactRule::Judge => (false, 2.0 * physics.wall_radius_m),
    };
    if team.position.len() <= cells::LINEAR_SEARCH_MAX || !move_with_grid(distance, blocks, team) {
        move_with_all_pairs(distance, blocks, team);
    }
    let half = arena.half_extent;
    for ((position, before), contacts) in team.position.iter_mut().zip(&*team.before).zip(&mut *team.contacts) {
        let at = *position;
        if any_within(arena.keep_outs.iter().map(|block| at - block.nearest(at)), NO_INDEX, physics.wall_radius_m) {
            contacts.wall = true;
            if blocks {
                *position = *before;
            }
        }
        *position = Vec2::new(limited(position.x, half.x), limited(position.y, half.y));
    }
    if !team.wheels.is_empty() {
        return end_motions(team);
    }
    for ((velocity, now), before) in team.velocity.iter_mut().zip(&*team.position).zip(&*team.before) {
        *velocity = (*now - *before) / DT_S;
    }
}

/// Replaces each robot's mean velocity over the step by that at its end, which is that of its wheels unless it was
/// blocked.
fn end_motions(team: &mut TeamMotion) {
    for (robot, wheels) in team.wheels.iter().enumerate() {
        let (before, now) = (team.before[robot], team.position[robot]);
        // That of positions is rounded by more than a limit of speed allows.
        let limited = wheels.chassis().point_ahead_m > 0.0 || wheels.chassis().speed_m_s.is_finite();
        let free = limited && now == before + team.velocity[robot] * DT_S;
        team.velocity[robot] = if free { wheels.velocity() } else { (now - before) / DT_S };
    }
}

/// Moves a robot to its candidate position, unless a robot that it touches blocks it, and records the contact.
#[inline(always)]
fn move_robot(robot: usize, candidate: Vec2, touches: bool, blocks: bool, team: &mut TeamMotion) {
    team.contacts[robot] = Contacts { robot: touches, wall: false };
    if !(touches && blocks) {
        team.position[robot] = candidate;
    }
}

/// Moves all robots in the order of their ids. Each is checked for contact with all others, of which those with lower
/// ids have already moved.
#[inline(always)]
fn move_with_all_pairs(distance: f32, blocks: bool, team: &mut TeamMotion) {
    for robot in 0..team.position.len() {
        let candidate = team.position[robot] + team.velocity[robot] * DT_S;
        let (before, others) = team.position.split_at(robot);
        let near = is_near(candidate, before, distance) || is_near(candidate, &others[1..], distance);
        let touches = near && any_within(team.position.iter().map(|other| candidate - other), robot, distance);
        move_robot(robot, candidate, touches, blocks, team);
    }
}

/// Moves all robots with the same result as `move_with_all_pairs`, but with a grid over the positions before the step.
/// The query radius is the contact distance and the farthest that another robot can have moved since. Returns `false`
/// and does nothing if that is not finite.
fn move_with_grid(distance: f32, blocks: bool, team: &mut TeamMotion) -> bool {
    let fastest = team.velocity.iter().fold(0.0, |max: f32, velocity| max.max(velocity.norm()));
    // Twice the largest move: rounding errors are far smaller than a step.
    let radius_m = distance * ROUNDING_MARGIN + 2.0 * fastest * DT_S;
    let Some(grid) = Cells::new(radius_m, team.before.iter().copied()) else {
        return false;
    };
    let mut near = Vec::new();
    for robot in 0..team.position.len() {
        let candidate = team.position[robot] + team.velocity[robot] * DT_S;
        grid.near(candidate, &mut near);
        let own = near.binary_search(&robot).unwrap_or(NO_INDEX);
        let touches = any_within(near.iter().map(|&other| candidate - team.position[other]), own, distance);
        move_robot(robot, candidate, touches, blocks, team);
    }
    true
}

/// Clamps a value to at most `max` in magnitude; NaN stays NaN.
#[inline(always)]
fn limited(axis: f32, max: f32) -> f32 {
    let axis = if axis < -max { -max } else { axis };
    if axis > max { max } else { axis }
}

/// Index that no list has, used where no element is to be excluded.
const NO_INDEX: usize = usize::MAX;
/// Factor by which a search distance is enlarged, so that rounding errors cannot exclude a robot.
const ROUNDING_MARGIN: f32 = 1.01;

/// Largest square of an offset whose length may be rounded to `distance`.
#[inline(always)]
fn near_square(distance: f32) -> f32 {
    1.001 * distance * distance
}

/// Whether any of `others` may be within `distance` of a point: all that `any_within` finds, and few more.
#[inline(always)]
fn is_near(point: Vec2, others: &[Vec2], distance: f32) -> bool {
    let square = near_square(distance);
    // Without a branch, so that the compiler looks at several at once.
    others.iter().fold(false, |near, other| near | ((point - other).norm_squared() <= square))
}

/// Whether any offset except the one at index `own` is at most `distance` long. Squares are compared first, because the
/// square root keeps their order. The root of the shortest is then taken if it may decide, because its rounding is part
/// of the published arithmetic.
#[inline(always)]
fn any_within(offsets: impl Iterator<Item = Vec2>, own: usize, distance: f32) -> bool {
    let shortest = offsets.enumerate().fold(f32::INFINITY, |least, (at, offset)| {
        let square = offset.x * offset.x + offset.y * offset.y;
        let square = if at == own { f32::INFINITY } else { square };
        if square < least { square } else { least }
    });
    shortest <= near_square(distance) && shortest.sqrt() <= distance
}

/// Training world of the paper as a plant (simulated world): discs that follow their commands within a limited
/// acceleration.
#[derive(Debug)]
pub(crate) struct Kinematic {
    arena: Arena,
    /// Time since the episode runs at the end of the next step; `None` while none runs.
    elapsed: Option<Span>,
    physics: Physics,
    position: Vec<Vec2>,
    velocity: Vec<Vec2>,
    contacts: Vec<Contacts>,
    before: Vec<Vec2>,
    commands: Vec<Vec2>,
    /// Robots that are moved from outside, with their states; none in most worlds.
    carried: BTreeMap<usize, Motion>,
    /// Chassis and heading of each robot; empty if all are holonomic without limits of their own.
    wheels: Vec<Wheels>,
    states: Vec<PlantState>,
}

/// Makes the training world of the paper, with one robot at rest at each of `positions` \[m\], world frame. `arena`
/// gives the ground, and `physics` the parameters of the robots. The seed is ignored, because this world draws no
/// random numbers.
pub fn build(arena: &Arena, physics: &Physics, positions: &[Vec2], _: Seed) -> Box<dyn Plant> {
    let zeros = vec![Vec2::zeros(); positions.len()];
    let mut plant = Kinematic {
        arena: arena.clone(),
        elapsed: None,
        physics: *physics,
        position: positions.to_vec(),
        velocity: zeros.clone(),
        contacts: vec![Contacts::default(); positions.len()],
        before: zeros.clone(),
        commands: zeros,
        carried: BTreeMap::new(),
        wheels: Vec::new(),
        states: vec![PlantState::default(); positions.len()],
    };
    plant.update_states();
    Box::new(plant)
}

impl Kinematic {
    fn update_states(&mut self) {
        (0..self.states.len()).for_each(|robot| self.update_state(robot));
    }

    fn update_state(&mut self, robot: usize) {
        let state = &mut self.states[robot];
        state.motion.position = self.position[robot];
        state.motion.velocity = self.velocity[robot];
        state.contacts = self.contacts[robot];
        if let Some(wheels) = self.wheels.get(robot) {
            (state.heading, state.yaw_rate) = (wheels.heading(), wheels.yaw_rate());
        }
    }
}

impl Plant for Kinematic {
    fn period(&self) -> Span {
        PERIOD
    }

    fn equip(&mut self, robot: usize, chassis: Chassis, heading: f32) {
        self.wheels.resize(self.states.len(), Wheels::new(Chassis::default(), 0.0));
        self.wheels[robot] = Wheels::new(chassis, heading);
        self.update_state(robot);
    }

    fn place(&mut self, robot: usize, position: Vec2, heading: f32) {
        if let Some(wheels) = self.wheels.get_mut(robot) {
            wheels.place(heading);
        }
        self.position[robot] = position;
        self.velocity[robot] = Vec2::zeros();
        self.contacts[robot] = Contacts::default();
        self.commands[robot] = Vec2::zeros();
        self.update_state(robot);
    }

    fn launch(&mut self, robot: usize, velocity: Vec2) {
        (self.velocity[robot], self.commands[robot]) = (velocity, velocity);
        self.update_state(robot);
    }

    fn enter(&mut self, arena: &Arena) -> bool {
        self.arena.clone_from(arena);
        true
    }

    fn elapse(&mut self, elapsed: Option<Span>) -> bool {
        self.elapsed = elapsed;
        true
    }

    fn drive(&mut self, robot: usize, velocity: Vec2) {
        self.commands[robot] = velocity;
    }

    fn carry(&mut self, robot: usize, motion: Motion, heading: f32) {
        if let Some(wheels) = self.wheels.get_mut(robot) {
            wheels.place(heading);
        }
        self.carried.insert(robot, motion);
        (self.position[robot], self.velocity[robot]) = (motion.position, motion.velocity);
        self.states[robot].heading = heading;
        self.update_state(robot);
    }

    fn advance(&mut self) {
        // A robot that is moved from outside stands for the step, so that the others are moved around it.
        for &robot in self.carried.keys() {
            (self.velocity[robot], self.commands[robot]) = (Vec2::zeros(), Vec2::zeros());
        }
        let mut team = TeamMotion {
            position: &mut self.position,
            velocity: &mut self.velocity,
            wheels: &mut self.wheels,
            contacts: &mut self.contacts,
            before: &mut self.before,
        };
        step(&self.arena.at(self.elapsed), &self.physics, &self.commands, &mut team);
        for (&robot, motion) in &self.carried {
            (self.position[robot], self.velocity[robot]) = (motion.position, motion.velocity);
        }
        self.update_states();
    }

    fn states(&self) -> &[PlantState] {
        &self.states
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::KeepOut;

    fn arena() -> Arena {
        let wall = KeepOut::rect(Vec2::new(-2.0, 0.5), Vec2::new(2.0, 0.8));
        Arena::new(Vec2::new(2.0, 3.0), vec![wall], 0.25)
    }

    #[test]
    fn acceleration_and_speed_are_limited_and_a_wall_blocks() {
        let mut plant = build(&arena(), &Physics::published(&arena()), &[Vec2::zeros()], Seed::of_run(0));
        plant.drive(0, Vec2::new(9.0, 0.0));
        plant.advance();
        assert!((plant.states()[0].motion.velocity.x - 0.05).abs() < 1e-5);
        plant.place(0, Vec2::new(0.0, 0.249), 0.0);
        plant.drive(0, Vec2::new(0.0, 1.0));
        plant.advance();
        assert!(plant.states()[0].contacts.wall);
        assert_eq!(plant.states()[0].motion.position, Vec2::new(0.0, 0.249));
    }

    #[test]
    fn a_robot_that_is_launched_keeps_its_velocity_until_it_is_commanded_another() {
        let mut plant = build(&arena(), &Physics::published(&arena()), &[Vec2::zeros()], Seed::of_run(0));
        let velocity = Vec2::new(0.4, -0.3);
        plant.place(0, Vec2::new(0.5, -1.0), 0.0);
        plant.launch(0, velocity);
        assert_eq!(plant.states()[0].motion, Motion { position: Vec2::new(0.5, -1.0), velocity });
        (0..10).for_each(|_| plant.advance());
        let motion = plant.states()[0].motion;
        assert!((motion.velocity - velocity).norm() < 1e-5, "{motion:?}");
        assert!((motion.position - Vec2::new(0.7, -1.15)).norm() < 1e-4, "{motion:?}");
        plant.place(0, Vec2::zeros(), 0.0);
        assert_eq!(plant.states()[0].motion, Motion::at_rest(Vec2::zeros()), "placed anew, it stands");
    }

    #[test]
    fn judged_contacts_are_flagged_and_block_nothing() {
        let physics = Physics { contacts: ContactRule::Judge, wall_radius_m: 0.16, ..Physics::published(&arena()) };
        let mut plant =
            build(&arena(), &physics, &[Vec2::new(0.0, 0.335), Vec2::new(0.3, 0.335), Vec2::zeros()], Seed::of_run(0));
        (0..3).for_each(|robot| plant.drive(robot, Vec2::new(0.0, 1.0)));
        (0..4).for_each(|_| plant.advance());
        let states = plant.states();
        assert!(states[0].contacts.wall && states[0].contacts.robot && states[0].motion.position.y > 0.34);
        assert_eq!(states[2].contacts, Contacts::default());
    }

    #[test]
    fn a_lagging_drivetrain_follows_as_a_first_order_system() {
        let free = Physics { acceleration_m_s2: f32::INFINITY, lag_s: 0.5, ..Physics::published(&arena()) };
        let mut plant = build(&arena(), &free, &[Vec2::new(-1.0, -2.0)], Seed::of_run(0));
        plant.drive(0, Vec2::new(1.0, 0.0));
        (0..10).for_each(|_| plant.advance());
        // After one time constant, 1 - 1/e of the step.
        assert!((plant.states()[0].motion.velocity.x - 0.632).abs() < 1e-3);
    }

    #[test]
    fn a_large_team_moves_and_touches_the_same_with_and_without_the_grid() {
        use rand::RngExt;
        let mut stream = crate::random::Seed::of_run(2).stream("crowd");
        let mut random = |max: f32| Vec2::new(stream.random_range(-max..=max), stream.random_range(-max..=max));
        let before: Vec<Vec2> = (0..200).map(|_| random(8.0)).collect();
        let mut velocity: Vec<Vec2> = (0..200).map(|_| random(1.5)).collect();
        let step = |with_grid: bool, velocity: &mut [Vec2]| {
            let (mut position, mut contacts) = (before.clone(), vec![Contacts::default(); 200]);
            let (position_of, contacts_of) = (&mut position, &mut contacts);
            let before = &mut before.clone();
            let mut team =
                TeamMotion { position: position_of, velocity, wheels: &mut [], contacts: contacts_of, before };
            if with_grid {
                assert!(move_with_grid(0.5, true, &mut team));
            } else {
                move_with_all_pairs(0.5, true, &mut team);
            }
            (position, contacts)
        };
        assert_eq!(step(true, &mut velocity), step(false, &mut velocity));
        let touching = step(true, &mut velocity).1.iter().filter(|contacts| contacts.robot).count();
        assert!((20..180).contains(&touching), "{touching} of 200 touch another");
        velocity[7] = Vec2::repeat(300.0);
        assert_eq!(step(true, &mut velocity), step(false, &mut velocity), "whatever their speed");
    }

    /// A plant with one robot whose point is 0.1 m ahead of its centre.
    fn with_wheels(position: Vec2, heading: f32) -> Box<dyn Plant> {
        use crate::chassis::{DriveKind, Settings};
        let settings =
            Settings { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Settings::default() };
        let mut plant = build(&arena(), &Physics::published(&arena()), &[position], Seed::of_run(0));
        plant.equip(0, settings.chassis().unwrap(), heading);
        plant
    }

    fn point(state: &PlantState) -> Motion {
        let ahead = Vec2::new(state.heading.cos(), state.heading.sin()) * 0.1;
        let turning = Vec2::new(-ahead.y, ahead.x) * state.yaw_rate;
        Motion { position: state.motion.position + ahead, velocity: state.motion.velocity + turning }
    }

    #[test]
    fn the_point_of_a_differential_robot_moves_like_a_holonomic_one() {
        let mut plant = with_wheels(Vec2::new(-1.0, -2.0), 2.0);
        let start = point(&plant.states()[0]).position;
        let mut other = build(&arena(), &Physics::published(&arena()), &[start], Seed::of_run(0));
        for step in 0..200 {
            let (sin, cos) = (step as f32 * 0.05).sin_cos();
            for plant in [&mut plant, &mut other] {
                plant.drive(0, Vec2::new(cos, sin) * 0.6);
                plant.advance();
            }
            let (ours, theirs) = (point(&plant.states()[0]), other.states()[0].motion);
            assert!((ours.position - theirs.position).norm() < 1e-3, "step {step}: {ours:?}, {theirs:?}");
            assert!((ours.velocity - theirs.velocity).norm() < 1e-3, "step {step}: {ours:?}, {theirs:?}");
        }
    }

    #[test]
    fn the_centre_of_a_differential_robot_is_what_a_wall_blocks_and_it_still_turns() {
        let mut plant = with_wheels(Vec2::new(0.0, -0.5), std::f32::consts::FRAC_PI_2);
        let mut blocked = 0;
        for _ in 0..100 {
            plant.drive(0, Vec2::new(0.0, 1.0));
            plant.advance();
            let state = plant.states()[0];
            blocked += u32::from(state.contacts.wall);
            assert!(state.motion.position.y < 0.25, "the centre stays 0.25 m from the wall at 0.5 m: {state:?}");
        }
        let state = plant.states()[0];
        assert!(blocked > 20 && point(&state).position.y > 0.27, "the point may come nearer: {state:?}");
        plant.drive(0, Vec2::new(0.5, 0.0));
        (0..10).for_each(|_| plant.advance());
        assert!(plant.states()[0].heading < 1.4, "{:?}", plant.states()[0]);
        plant.place(0, Vec2::zeros(), -1.0);
        let state = plant.states()[0];
        assert_eq!((state.motion, state.heading, state.yaw_rate), (Motion::at_rest(Vec2::zeros()), -1.0, 0.0));
    }

    #[test]
    fn a_holonomic_robot_beside_a_differential_one_moves_as_ever() {
        let starts = [Vec2::new(-1.0, -2.0), Vec2::new(1.0, -2.0)];
        let plant = || build(&arena(), &Physics::published(&arena()), &starts, Seed::of_run(0));
        let (mut mixed, mut plain) = (plant(), plant());
        mixed.equip(0, crate::chassis::Chassis { speed_m_s: 0.2, ..Default::default() }, 0.0);
        for _ in 0..60 {
            for plant in [&mut mixed, &mut plain] {
                (0..2).for_each(|robot| plant.drive(robot, Vec2::new(0.3, 0.4)));
                plant.advance();
            }
            assert_eq!(mixed.states()[1], plain.states()[1]);
        }
        assert!((mixed.states()[0].motion.velocity.norm() - 0.2).abs() < 1e-4, "its own limit");
    }

    #[test]
    fn a_robot_blocks_another() {
        let mut plant =
            build(&arena(), &Physics::published(&arena()), &[Vec2::zeros(), Vec2::new(0.501, 0.0)], Seed::of_run(0));
        plant.drive(0, Vec2::new(1.0, 0.0));
        plant.advance();
        assert!(plant.states()[0].contacts.robot && !plant.states()[1].contacts.robot);
        assert_eq!(plant.states()[0].motion.velocity, Vec2::zeros());
    }
}
