//! Free straight lines in an arena, the crossings of its bottlenecks, and commands after which a robot can still brake
//! before a wall, for scripted navigation (ORCA). Other robots are not considered.

use crate::messages::geometry::{Motion, Vec2};
use crate::scenario::Arena;

/// Clearance \[m\] that a planned path keeps between a robot's hull and a solid block (wall) of the arena.
const MARGIN_M: f32 = 0.03;
/// Smallest cosine of the angle between a robot's heading and the direction to a point, from which the robot counts as
/// heading for that point: 6 degrees. The broadcast heading is slightly older than the position.
const HEADING_COS: f32 = 0.995;
/// Tolerance \[m\] for the length of a neighbour's remaining path, which is computed from the preferred velocity that
/// the neighbour broadcast.
const SLACK_M: f32 = 0.05;

/// Acceleration available along each axis \[m/s^2\], for predicting braking.
const ACCELERATION_M_S2: f32 = 1.0;
/// Clearance between hull and wall that every command keeps \[m\], for rounding and for commands that take effect late.
const TOUCH_MARGIN_M: f32 = 0.01;
/// Number of periods within which a robot must come to rest after a command; otherwise the command counts as unsafe. It
/// is more than a robot needs from any plausible speed.
const MAX_BRAKING_PERIODS: u32 = 200;
/// Number of commands tried to each side of the current velocity, along each axis, if the wanted one is unsafe.
const SEARCH_STEPS: i8 = 4;

/// Radius of the robots for which the distances of scripted navigation were chosen \[m\]. For smaller robots they are
/// smaller in proportion; larger ones keep farther from each other by their radius alone.
const CHOSEN_FOR_M: f32 = 0.25;

/// Returns the factor on distances of scripted navigation for the robots in `arena`, 1 for those of the paper.
pub(crate) fn share(arena: &Arena) -> f32 {
    (arena.robot_radius_m / CHOSEN_FOR_M).min(1.0)
}

/// Crossing of a bottleneck in one direction, along the straight line between the two ends (mouths) of the bottleneck.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Crossing {
    /// Mouth of the bottleneck at which the crossing begins \[m\].
    pub(crate) entry: Vec2,
    /// Mouth of the bottleneck at which the crossing ends \[m\].
    pub(crate) exit: Vec2,
}

impl Crossing {
    /// Returns the point \[m\] for which a robot at `at` \[m\] steers in order to cross the bottleneck. It is the exit
    /// if the straight line there is free of walls, and the entry otherwise. All points are in the frame of `arena`.
    pub(crate) fn aim(&self, arena: &Arena, at: Vec2) -> Vec2 {
        if is_free(arena, at, self.exit) { self.exit } else { self.entry }
    }

    /// Returns the length of the path \[m\] from a robot at `at` \[m\] to the middle of the bottleneck; negative beyond
    /// the middle. All points are in the frame of `arena`.
    pub(crate) fn ahead(&self, arena: &Arena, at: Vec2) -> f32 {
        let half = (self.exit - self.entry).norm() / 2.0;
        let along = (self.exit - self.entry) / (2.0 * half);
        if is_free(arena, at, self.exit) {
            (self.exit - at).dot(&along) - half
        } else {
            (self.entry - at).norm() + half
        }
    }

    /// Returns true if a robot's path still leads through the bottleneck in this direction: on to its exit, or past its
    /// middle on a free straight line to the robot's destination. The robot is at `at` \[m\], moves along the unit
    /// vector `heading`, and has `path_m` \[m\] of path left.
    pub(crate) fn is_ahead_of(&self, arena: &Arena, at: Vec2, heading: Vec2, path_m: f32) -> bool {
        let (along, middle) = (self.exit - self.entry, (self.entry + self.exit) / 2.0);
        if (self.exit - at).dot(&along) <= 0.0 {
            return false;
        }
        let aim = self.aim(arena, at);
        let heads_for_aim = (aim - at).dot(&heading) > HEADING_COS * (aim - at).norm();
        // A shorter path ends on this side of the bottleneck, by chance in the same direction.
        let long_enough = path_m > (aim - at).norm() + (self.exit - aim).norm() - SLACK_M;
        let end = at + heading * path_m;
        let crosses_middle = (at - middle).dot(&along) < 0.0 && (end - middle).dot(&along) > 0.0;
        heads_for_aim && long_enough || crosses_middle && is_free(arena, at, end)
    }
}

/// Returns the distance \[m\] that a planned path keeps between a robot's centre and a block of `arena`.
pub(crate) fn margin_m(arena: &Arena) -> f32 {
    arena.robot_radius_m + share(arena) * MARGIN_M
}

/// Returns true if a robot can move along the straight line from `from` to `to` \[m\] without touching a solid block
/// (wall) of `arena`. Other robots are not considered.
pub(crate) fn is_free(arena: &Arena, from: Vec2, to: Vec2) -> bool {
    // A robot that is nearer to a block than the margin must still be able to leave it.
    let margin_m = margin_m(arena);
    let margin = |block_distance: f32| margin_m.min(block_distance - 1e-3);
    arena.keep_outs.iter().all(|block| !block.blocks(from, to, margin(block.distance(from).min(block.distance(to)))))
}

/// Returns true if a robot that follows `command` \[m/s\] for one period and then brakes touches no solid block and
/// does not leave the ground. Its acceleration is limited along each axis, so it does not brake along a straight line.
/// A robot that is already too near a block or off the ground must only not get nearer to it or further off.
fn is_safe(arena: &Arena, own: &Motion, command: Vec2, period_s: f32) -> bool {
    let step = ACCELERATION_M_S2 * period_s;
    let toward = |velocity: Vec2, wanted: Vec2| velocity + (wanted - velocity).map(|axis| axis.clamp(-step, step));
    let (mut at, mut velocity) = (own.position, toward(own.velocity, command));
    let limit = arena.robot_radius_m + share(arena) * TOUCH_MARGIN_M;
    let border = distance_outside(arena, at).max(0.0);
    for _ in 0..MAX_BRAKING_PERIODS {
        at += velocity * period_s;
        // A robot that is already too near must not come nearer.
        if arena.clearance(at) < limit.min(arena.clearance(own.position)) || distance_outside(arena, at) > border {
            return false;
        }
        if velocity == Vec2::zeros() {
            return true;
        }
        velocity = toward(velocity, Vec2::zeros());
    }
    false
}

/// Returns the distance \[m\] by which a point lies outside the ground, along the axis where this is largest; negative
/// if it lies inside.
fn distance_outside(arena: &Arena, point: Vec2) -> f32 {
    (point.abs() - arena.half_extent).max()
}

/// Returns the velocity command \[m/s\] nearest to `wanted` \[m/s\] after which a robot can still brake before it
/// touches a solid block of `arena` or leaves the ground. `own` is the robot's position \[m\] and velocity \[m/s\], and
/// `period_s` the time until the next command \[s\].
///
/// The result is `wanted` itself if that is safe. Otherwise the function searches a grid of commands around the current
/// velocity; if none is safe, it returns zero.
pub fn safe_command(arena: &Arena, own: &Motion, wanted: Vec2, period_s: f32) -> Vec2 {
    if is_safe(arena, own, wanted, period_s) {
        return wanted;
    }
    let reach = ACCELERATION_M_S2 * period_s;
    let side = -SEARCH_STEPS..=SEARCH_STEPS;
    let window = side.clone().flat_map(|x| side.clone().map(move |y| Vec2::new(x as f32, y as f32)));
    let commands = window.map(|offset| own.velocity + offset * (reach / SEARCH_STEPS as f32));
    // If none is safe, brake: that was safe when the last command was chosen.
    let safe = commands.filter(|command| is_safe(arena, own, *command, period_s));
    safe.min_by(|a, b| (a - wanted).norm().total_cmp(&(b - wanted).norm())).unwrap_or_else(Vec2::zeros)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Seed;
    use crate::scenario::{Settings, build};
    use crate::world::{Physics, kinematic};

    #[test]
    fn a_robot_steers_for_the_exit_of_a_bottleneck_once_it_sees_it() {
        let passage = build("passage", &Settings::default()).unwrap();
        let arena = passage.arena();
        let from = Vec2::new(1.5, -1.5);
        let crossing = Crossing { entry: arena.portals[0].near, exit: arena.portals[0].far };
        assert_eq!(crossing.aim(arena, from), crossing.entry);
        assert_eq!(crossing.aim(arena, Vec2::new(0.0, -0.5)), crossing.exit);
        assert!(crossing.ahead(arena, from) > crossing.ahead(arena, Vec2::new(0.0, -0.5)));
    }

    #[test]
    fn robots_that_will_cross_are_distinguished_from_those_that_only_head_that_way() {
        let passage = build("passage", &Settings::default()).unwrap();
        let arena = passage.arena();
        let (from, to) = (Vec2::new(1.5, -1.5), Vec2::new(1.0, 1.5));
        let crossing = Crossing { entry: arena.portals[0].near, exit: arena.portals[0].far };
        let back = Crossing { entry: crossing.exit, exit: crossing.entry };
        let heading = (crossing.entry - from).normalize();
        let [first, second, third] = [crossing.entry - from, crossing.exit - crossing.entry, to - crossing.exit];
        let path_m = first.norm() + second.norm() + third.norm();
        assert!(crossing.is_ahead_of(arena, from, heading, path_m) && !back.is_ahead_of(arena, from, heading, path_m));
        assert!(!crossing.is_ahead_of(arena, from, heading, 1.0), "its destination lies before the entry");
        assert!(!crossing.is_ahead_of(arena, from, -heading, path_m), "it goes the other way");
        assert!(crossing.is_ahead_of(arena, Vec2::new(0.1, -1.0), Vec2::y(), 3.0), "straight to its destination");
    }

    #[test]
    fn safe_commands_touch_no_wall_and_stay_on_the_ground() {
        let passage = build("passage", &Settings::default()).unwrap();
        let arena = passage.arena();
        // At corners, into the gap, along the wall and off the ground, from speed and at random angles.
        for (step, start) in [(0.3, Vec2::new(0.0, -1.5)), (0.7, Vec2::new(1.2, -0.6)), (1.1, Vec2::new(-1.9, 2.9))] {
            let mut plant = kinematic::build(arena, &Physics::published(arena), &[start], Seed::of_run(0));
            for tick in 0..4000 {
                let state = plant.states()[0];
                assert!(!state.contacts.wall && distance_outside(arena, state.motion.position) <= 1e-4);
                let (sin, cos) = ((tick / 37) as f32 * step).sin_cos();
                let aim = if tick % 500 < 250 { Vec2::new(cos, sin) * 1.5 } else { -state.motion.position };
                plant.drive(0, safe_command(arena, &state.motion, aim, 0.05));
                plant.advance();
            }
        }
    }
}
