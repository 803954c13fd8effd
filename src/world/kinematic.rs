//! The training world of the paper: holonomic discs with limited acceleration and speed that walls and other robots
//! block. Arithmetic and order of operations are those of the published environment, in f32.
//!
//! `step` alone defines these dynamics; the World actor and the trainer both call it.

use std::collections::BTreeMap;

use super::{ContactRule, Physics, Plant, PlantState};
use crate::cells::{self, Cells};
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::local::Contacts;
use crate::random::Seed;
use crate::scenario::Arena;
use crate::time::Span;

/// Duration of a step.
pub const PERIOD: Span = Span::from_millis(50);
/// Duration of a step \[s\], as a number.
const DT_S: f32 = 0.05;
/// Largest speed along each axis \[m/s\] (published environment).
pub const MAX_SPEED_M_S: f32 = 1.5;
/// Largest acceleration along each axis \[m/s^2\] (published environment).
pub const MAX_ACCELERATION_M_S2: f32 = 1.0;

/// State of the robots of one world, which a step updates in place.
#[derive(Debug)]
pub struct Team<'a> {
    /// Positions \[m\].
    pub position: &'a mut [Vec2],
    /// Velocities \[m/s\].
    pub velocity: &'a mut [Vec2],
    /// Contacts of each robot in the step.
    pub contacts: &'a mut [Contacts],
    /// Scratch space for the positions before the step.
    pub before: &'a mut [Vec2],
}

/// Advances every robot by one step with its commanded velocity \[m/s\], world frame.
pub fn step(arena: &Arena, physics: &Physics, commands: &[Vec2], team: &mut Team) {
    team.before.copy_from_slice(team.position);
    let (max_acceleration, gain) = (physics.acceleration_m_s2, physics.gain(PERIOD));
    // The same expression for both axes, so that the compiler vectorizes the divisions.
    let driven = |velocity: f32, command: f32| {
        let mut wanted = limited(command, MAX_SPEED_M_S);
        if gain < 1.0 {
            wanted = velocity + (wanted - velocity) * gain;
        }
        velocity + limited((wanted - velocity) / DT_S, max_acceleration) * DT_S
    };
    for (velocity, command) in team.velocity.iter_mut().zip(commands) {
        *velocity = Vec2::new(driven(velocity.x, command.x), driven(velocity.y, command.y));
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
    for ((velocity, now), before) in team.velocity.iter_mut().zip(&*team.position).zip(&*team.before) {
        *velocity = (*now - *before) / DT_S;
    }
}

/// Moves a robot to its candidate position, unless a robot that it touches blocks it, and records the contact.
#[inline(always)]
fn move_robot(robot: usize, candidate: Vec2, touches: bool, blocks: bool, team: &mut Team) {
    team.contacts[robot] = Contacts { robot: touches, wall: false };
    if !(touches && blocks) {
        team.position[robot] = candidate;
    }
}

/// Moves all robots in the order of their ids, each checked against all others; those before it have already moved.
#[inline(always)]
fn move_with_all_pairs(distance: f32, blocks: bool, team: &mut Team) {
    for robot in 0..team.position.len() {
        let candidate = team.position[robot] + team.velocity[robot] * DT_S;
        let touches = any_within(team.position.iter().map(|other| candidate - other), robot, distance);
        move_robot(robot, candidate, touches, blocks, team);
    }
}

/// Moves all robots with the same result as `move_with_all_pairs`, but with a grid over the positions before the step.
/// The query radius is the contact distance and the farthest that another robot can have moved since. Returns `false`
/// and does nothing if that is not finite.
fn move_with_grid(distance: f32, blocks: bool, team: &mut Team) -> bool {
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

/// An index that no list has.
const NO_INDEX: usize = usize::MAX;
/// Factor on a distance that exceeds all rounding errors.
const ROUNDING_MARGIN: f32 = 1.01;

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
    shortest <= 1.001 * distance * distance && shortest.sqrt() <= distance
}

/// The training world as a plant.
#[derive(Debug)]
pub struct Kinematic {
    arena: Arena,
    physics: Physics,
    position: Vec<Vec2>,
    velocity: Vec<Vec2>,
    contacts: Vec<Contacts>,
    before: Vec<Vec2>,
    commands: Vec<Vec2>,
    /// Robots that are moved from outside, with their states; none in most worlds.
    carried: BTreeMap<usize, (Motion, f32)>,
    states: Vec<PlantState>,
}

/// Makes the training world with robots at rest at these positions \[m\]; it draws no random numbers.
pub fn build(arena: &Arena, physics: &Physics, positions: &[Vec2], _: Seed) -> Box<dyn Plant> {
    let zeros = vec![Vec2::zeros(); positions.len()];
    let mut plant = Kinematic {
        arena: arena.clone(),
        physics: *physics,
        position: positions.to_vec(),
        velocity: zeros.clone(),
        contacts: vec![Contacts::default(); positions.len()],
        before: zeros.clone(),
        commands: zeros,
        carried: BTreeMap::new(),
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
    }
}

impl Plant for Kinematic {
    fn period(&self) -> Span {
        PERIOD
    }

    fn place(&mut self, robot: usize, position: Vec2) {
        self.position[robot] = position;
        self.velocity[robot] = Vec2::zeros();
        self.contacts[robot] = Contacts::default();
        self.commands[robot] = Vec2::zeros();
        self.update_state(robot);
    }

    fn drive(&mut self, robot: usize, velocity: Vec2) {
        self.commands[robot] = velocity;
    }

    fn carry(&mut self, robot: usize, motion: Motion, heading: f32) {
        self.carried.insert(robot, (motion, heading));
        (self.position[robot], self.velocity[robot]) = (motion.position, motion.velocity);
        self.states[robot].heading = heading;
        self.update_state(robot);
    }

    fn advance(&mut self) {
        // A robot that is moved from outside stands for the step, so that the others are moved around it.
        for &robot in self.carried.keys() {
            (self.velocity[robot], self.commands[robot]) = (Vec2::zeros(), Vec2::zeros());
        }
        let mut team = Team {
            position: &mut self.position,
            velocity: &mut self.velocity,
            contacts: &mut self.contacts,
            before: &mut self.before,
        };
        step(&self.arena, &self.physics, &self.commands, &mut team);
        for (&robot, (motion, _)) in &self.carried {
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
        let wall = KeepOut { min: Vec2::new(-2.0, 0.5), max: Vec2::new(2.0, 0.8) };
        Arena { half_extent: Vec2::new(2.0, 3.0), keep_outs: vec![wall], portals: Vec::new(), robot_radius_m: 0.25 }
    }

    #[test]
    fn acceleration_and_speed_are_limited_and_a_wall_blocks() {
        let mut plant = build(&arena(), &Physics::published(&arena()), &[Vec2::zeros()], Seed::of_run(0));
        plant.drive(0, Vec2::new(9.0, 0.0));
        plant.advance();
        assert!((plant.states()[0].motion.velocity.x - 0.05).abs() < 1e-5);
        plant.place(0, Vec2::new(0.0, 0.249));
        plant.drive(0, Vec2::new(0.0, 1.0));
        plant.advance();
        assert!(plant.states()[0].contacts.wall);
        assert_eq!(plant.states()[0].motion.position, Vec2::new(0.0, 0.249));
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
            let mut team = Team { position: position_of, velocity, contacts: contacts_of, before: &mut before.clone() };
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
