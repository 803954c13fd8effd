//! The training world of the paper: holonomic discs with limited acceleration and speed, blocked by walls
//! and by each other. Arithmetic and order are those of the published environment, in f32.
//!
//! `step` is the one definition of these dynamics; the World actor and the trainer both call it.

use super::{ContactRule, Physics, Plant, PlantState};
use crate::cells::{self, Cells};
use crate::messages::geometry::Vec2;
use crate::messages::local::Contacts;
use crate::random::Seed;
use crate::scenario::Arena;
use crate::time::Span;

/// One step \[s\].
pub const PERIOD: Span = Span::from_millis(50);
/// The same as a number \[s\].
const DT_S: f32 = 0.05;
/// Largest speed along each axis \[m/s\] (published environment).
pub const MAX_SPEED_M_S: f32 = 1.5;
/// Largest acceleration along each axis \[m/s^2\] (published environment).
pub const MAX_ACCELERATION_M_S2: f32 = 1.0;

/// The robots of one world, as a step reads and writes them.
#[derive(Debug)]
pub struct Team<'a> {
    /// Positions \[m\].
    pub position: &'a mut [Vec2],
    /// Velocities \[m/s\].
    pub velocity: &'a mut [Vec2],
    /// What blocked each robot.
    pub contacts: &'a mut [Contacts],
    /// Positions before the step, for its own use.
    pub before: &'a mut [Vec2],
}

/// Moves every robot on by one step toward its commanded velocity \[m/s\].
pub fn step(arena: &Arena, physics: &Physics, commands: &[Vec2], team: &mut Team) {
    team.before.copy_from_slice(team.position);
    let (most, gain) = (physics.acceleration_m_s2, physics.gain(PERIOD));
    // Axis by axis, and both alike: that way the compiler divides several at once.
    let driven = |velocity: f32, command: f32| {
        let mut wanted = limited(command, MAX_SPEED_M_S);
        if gain < 1.0 {
            wanted = velocity + (wanted - velocity) * gain;
        }
        velocity + limited((wanted - velocity) / DT_S, most) * DT_S
    };
    for (velocity, command) in team.velocity.iter_mut().zip(commands) {
        *velocity = Vec2::new(driven(velocity.x, command.x), driven(velocity.y, command.y));
    }
    let (blocks, apart) = match physics.contacts {
        ContactRule::Block => (true, 2.0 * arena.robot_radius_m),
        ContactRule::Judge => (false, 2.0 * physics.wall_radius_m),
    };
    if team.position.len() <= cells::LINEAR_SEARCH_MAX || !meet_by_cells(apart, blocks, team) {
        meet_all(apart, blocks, team);
    }
    let half = arena.half_extent;
    for ((position, before), contacts) in team.position.iter_mut().zip(&*team.before).zip(&mut *team.contacts) {
        let at = *position;
        if at_most(arena.keep_outs.iter().map(|block| at - block.nearest(at)), NOBODY, physics.wall_radius_m) {
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

/// A robot moves to where it wants to be, unless another that it touches blocks it.
#[inline(always)]
fn meet(robot: usize, candidate: Vec2, touches: bool, blocks: bool, team: &mut Team) {
    team.contacts[robot] = Contacts { robot: touches, wall: false };
    if !(touches && blocks) {
        team.position[robot] = candidate;
    }
}

/// In the order of their ids, each against all others: those before it have moved already.
#[inline(always)]
fn meet_all(apart: f32, blocks: bool, team: &mut Team) {
    for robot in 0..team.position.len() {
        let candidate = team.position[robot] + team.velocity[robot] * DT_S;
        let touches = at_most(team.position.iter().map(|other| candidate - other), robot, apart);
        meet(robot, candidate, touches, blocks, team);
    }
}

/// The same as looking at all others, in the same order: whoever can be touched was not farther away before the step
/// than the others may have come since. `false`, and nothing is done, if that is no distance.
fn meet_by_cells(apart: f32, blocks: bool, team: &mut Team) -> bool {
    let fastest = team.velocity.iter().fold(0.0, |most: f32, velocity| most.max(velocity.norm()));
    // Twice: what rounding adds is far less than a step.
    let Some(grid) = Cells::new(apart * SURELY + 2.0 * fastest * DT_S, team.before.iter().copied()) else {
        return false;
    };
    let mut near = Vec::new();
    for robot in 0..team.position.len() {
        let candidate = team.position[robot] + team.velocity[robot] * DT_S;
        grid.near(candidate, &mut near);
        let own = near.binary_search(&robot).unwrap_or(NOBODY);
        let touches = at_most(near.iter().map(|&other| candidate - team.position[other]), own, apart);
        meet(robot, candidate, touches, blocks, team);
    }
    true
}

/// Within `most` of zero; what is no number stays so.
#[inline(always)]
fn limited(axis: f32, most: f32) -> f32 {
    let axis = if axis < -most { -most } else { axis };
    if axis > most { most } else { axis }
}

/// No place in a list.
const NOBODY: usize = usize::MAX;
/// A distance times this is beyond it, whatever rounding does.
const SURELY: f32 = 1.01;

/// Whether the shortest of some offsets but the one at `own` is at most `distance` long. Only that one's root is drawn,
/// and only if its square leaves a doubt: a root never changes an order, and its rounding is part of the published
/// arithmetic.
#[inline(always)]
fn at_most(offsets: impl Iterator<Item = Vec2>, own: usize, distance: f32) -> bool {
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
    states: Vec<PlantState>,
}

/// Makes the plant.
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
        states: vec![PlantState::default(); positions.len()],
    };
    plant.show();
    Box::new(plant)
}

impl Kinematic {
    fn show(&mut self) {
        (0..self.states.len()).for_each(|robot| self.show_one(robot));
    }

    fn show_one(&mut self, robot: usize) {
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
        self.show_one(robot);
    }

    fn drive(&mut self, robot: usize, velocity: Vec2) {
        self.commands[robot] = velocity;
    }

    fn advance(&mut self) {
        let mut team = Team {
            position: &mut self.position,
            velocity: &mut self.velocity,
            contacts: &mut self.contacts,
            before: &mut self.before,
        };
        step(&self.arena, &self.physics, &self.commands, &mut team);
        self.show();
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
        // After one time constant, 1 - 1/e of the way.
        assert!((plant.states()[0].motion.velocity.x - 0.632).abs() < 1e-3);
    }

    #[test]
    fn a_crowd_touches_whom_it_touches_by_cells_or_not() {
        use rand::RngExt;
        let mut stream = crate::random::Seed::of_run(2).stream("crowd");
        let mut some = |most: f32| Vec2::new(stream.random_range(-most..=most), stream.random_range(-most..=most));
        let before: Vec<Vec2> = (0..200).map(|_| some(8.0)).collect();
        let mut velocity: Vec<Vec2> = (0..200).map(|_| some(1.5)).collect();
        let step = |by_cells: bool, velocity: &mut [Vec2]| {
            let (mut position, mut contacts) = (before.clone(), vec![Contacts::default(); 200]);
            let (position_of, contacts_of) = (&mut position, &mut contacts);
            let mut team = Team { position: position_of, velocity, contacts: contacts_of, before: &mut before.clone() };
            if by_cells {
                assert!(meet_by_cells(0.5, true, &mut team));
            } else {
                meet_all(0.5, true, &mut team);
            }
            (position, contacts)
        };
        assert_eq!(step(true, &mut velocity), step(false, &mut velocity));
        let touching = step(true, &mut velocity).1.iter().filter(|contacts| contacts.robot).count();
        assert!((20..180).contains(&touching), "{touching} of 200 touch somebody");
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
