//! Safety filter: reduces a commanded velocity until the robot can stop before its neighbours, the walls and the
//! geofence.
//!
//! The limits are those of the velocity of the robot's stopping point (`stopping`). Zero satisfies them all, unless a
//! moving obstacle comes near. The filter does no I/O, and allocates nothing once it is made.

use std::sync::Arc;

use super::barrier::Barrier;
use super::limits::{Limits, geofence};
use super::stopping::Model;
use super::yielding::{Close, Yielding};
use super::{Safety, Switch};
use crate::messages::geometry::{Motion, Vec2, is_finite};
use crate::safety::Clamp;
use crate::scenario::{Arena, KeepOut, Mover};
use crate::time::Span;

/// Settings of the guard of one robot and of its safety filter: thresholds, ground, walls, and limits of commands.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Thresholds of the safety filter, and the switches of its limits.
    pub safety: Safety,
    /// Half the size of the robot's ground along x and y \[m\], world frame; the ground is centred at the origin.
    pub half_extent: Vec2,
    /// Solid blocks of the arena that the robot must not touch, world frame.
    pub walls: Arc<[KeepOut]>,
    /// Obstacles that move while an episode runs, world frame.
    pub movers: Arc<[Mover]>,
    /// Largest commanded speed along each axis \[m/s\].
    pub limit_m_s: f32,
    /// Limit of speed, and possibly of the difference from the measured velocity, that is applied to a policy's
    /// velocity before the filter, on this robot and on its neighbours.
    pub clamp: Clamp,
    /// Time from one command to the next, for which the robot follows it.
    pub period: Span,
}

impl Settings {
    /// Returns the distance within which a robot has to be able to stop \[m\]: half of that from where two robots have
    /// heard each other to the minimum distance.
    fn stopping_m(&self) -> f32 {
        (self.safety.distance_heard_m - self.safety.distance_min_m).max(0.0) / 2.0
    }
}

/// Result of the safety filter: the velocity to command, and the kinds of limits that have changed it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filtered {
    /// Velocity to command \[m/s\], world frame.
    pub velocity: Vec2,
    /// Whether the geofence has changed the velocity.
    pub(crate) fence: bool,
    /// Whether a wall or the edge of the ground has changed the velocity.
    pub(crate) walls: bool,
    /// Whether the minimum distance to a neighbour has changed the velocity.
    pub(crate) distance: bool,
}

/// Safety filter of one robot: changes a velocity command to the nearest one after which the robot can stop before
/// neighbours, walls and the geofence.
#[derive(Clone, Debug)]
pub struct Filter {
    settings: Settings,
    barrier: Barrier,
    yielding: Yielding,
    /// Time since the episode runs; `None` while none runs.
    elapsed: Option<Span>,
}

impl Filter {
    /// Makes the safety filter of a robot from its settings.
    pub fn new(settings: Settings) -> Filter {
        let Settings { safety, limit_m_s, clamp, period, .. } = &settings;
        let step_m_s = clamp.step_m_s().min(2.0 * limit_m_s);
        let barrier = Barrier {
            model: Model::new(safety.lag_s, safety.acceleration_m_s2, period.as_secs() as f32, step_m_s),
            distance_min_m: safety.distance_min_m,
            wall_min_m: safety.walls_min_m,
            gain_per_s: safety.distance_gain_per_s,
            delay_s: safety.distance_delay_s,
        };
        Filter { settings, barrier, yielding: Yielding::default(), elapsed: None }
    }

    /// Sets the solid blocks and the moving obstacles of the arena, world frame, from now on.
    pub(crate) fn enter(&mut self, arena: &Arena) {
        self.settings.walls = arena.keep_outs.as_slice().into();
        self.settings.movers = arena.movers.as_slice().into();
    }

    /// Sets the time since the episode runs, by which moving obstacles are where they are at the next step. While none
    /// runs, it is `None`, and there are no moving obstacles.
    pub fn elapse(&mut self, elapsed: Option<Span>) {
        self.elapsed = elapsed;
    }

    /// Returns the state of the filter that changes from step to step: for how long the limits have kept the robot from
    /// moving. The method `restore` continues from it.
    pub fn yielding(&self) -> Yielding {
        self.yielding
    }

    /// Replaces the state of the filter that changes from step to step by one that the method `yielding` has returned.
    pub fn restore(&mut self, yielding: Yielding) {
        self.yielding = yielding;
    }

    /// Returns the velocity to command in place of `wanted` \[m/s\]. `own` is the robot's motion, and `neighbours` has
    /// the last known motions of others with their ages since their arrival \[s\], all in the world frame.
    pub fn apply(&mut self, own: &Motion, neighbours: impl Iterator<Item = (Motion, f32)>, wanted: Vec2) -> Filtered {
        let Filter { settings, barrier, yielding, elapsed } = self;
        let Safety { geofence: fence, distance, walls, .. } = settings.safety;
        let mut filtered = Filtered { velocity: wanted, fence: false, walls: false, distance: false };
        if [fence, distance, walls] == [Switch::Off; 3] {
            return filtered;
        }
        // Two robots that have not heard each other drive at each other at this speed at the most. As a limit of the
        // drive, it is not counted.
        let wanted = match distance {
            Switch::On => {
                barrier.model.stopping_within(wanted, settings.period.as_secs() as f32, settings.stopping_m())
            }
            Switch::Off => wanted,
        };
        let aim = barrier.model.advance(own.velocity, wanted);
        let turned = yielding.turned(aim);
        let (mut limits, mut result) = (Limits::default(), turned);
        barrier.drive(own.velocity).into_iter().for_each(|limit| limits.push(limit));
        let mut reduce = |limits: &Limits| {
            let before = std::mem::replace(&mut result, limits.nearest(turned));
            result != before
        };
        // A limit of the drive is not counted as a limit of the filter.
        reduce(&limits);
        if fence == Switch::On {
            let edge = settings.half_extent.map(|axis| axis + settings.safety.geofence_margin_m);
            let stopping = own.position + barrier.model.travel(own.velocity);
            limits.extend(geofence(edge, settings.safety.geofence_horizon_s, stopping));
            filtered.fence = reduce(&limits);
        }
        // A bound above this speed takes nothing away.
        let fastest_m_s = turned.norm();
        if walls == Switch::On {
            let blocks = settings.walls.iter().map(|block| barrier.wall(own, block));
            let moving = elapsed
                .iter()
                .flat_map(|elapsed| settings.movers.iter().flat_map(|mover| barrier.mover(own, mover, *elapsed)));
            let all = blocks.chain(barrier.edge(own, settings.half_extent)).chain(moving);
            limits.extend(all.filter(|limit| limit.most_m_s < fastest_m_s));
            filtered.walls = reduce(&limits);
        }
        let mut close = Close::default();
        if distance == Switch::On {
            let others = neighbours.flat_map(|(motion, age_s)| {
                close.count(own.position, &motion, barrier.distance_min_m);
                barrier.neighbour(own, &motion, age_s)
            });
            limits.extend(others.filter(|limit| limit.most_m_s < fastest_m_s));
            filtered.distance = reduce(&limits);
        }
        yielding.update(aim, result, close, settings.period.as_secs() as f32);
        let reduced = barrier.model.command(own.velocity, result);
        // Along an axis that nothing limits, the command stays as it was.
        let axis = |result: f32, aim: f32, wanted: f32, reduced: f32| if result == aim { wanted } else { reduced };
        let velocity =
            Vec2::new(axis(result.x, aim.x, wanted.x, reduced.x), axis(result.y, aim.y, wanted.y, reduced.y));
        filtered.velocity = if is_finite(velocity) { velocity } else { Vec2::zeros() };
        filtered
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings of robots whose drives lag by `lag_s` \[s\], among `walls` on wide ground.
    fn settings(lag_s: f32, walls: Arc<[KeepOut]>) -> Settings {
        let safety = Safety::filter().driving(lag_s, 1.0);
        let (half_extent, period) = (Vec2::repeat(10.0), Span::from_millis(50));
        let movers = Arc::default();
        Settings { safety, half_extent, walls, movers, limit_m_s: 1.05, clamp: Clamp::Training, period }
    }

    /// Moves a robot whose drive lags by `lag_s` \[s\] for a control period.
    fn drive(robot: &mut Motion, command: Vec2, lag_s: f32) {
        for _ in 0..50 {
            let change = (command - robot.velocity) / lag_s.max(1e-3);
            robot.velocity += change.map(|axis| axis.clamp(-1.0, 1.0)) * 1e-3;
            robot.position += robot.velocity * 1e-3;
        }
    }

    /// Drives two robots at each other along the diagonal, as fast as they can, and returns the least distance of their
    /// centres \[m\]. They hear each other from 1.7 m on, and their settings say `heard_m` \[m\].
    fn nearest_m(lag_s: f32, heard_m: f32) -> f32 {
        let mut settings = settings(lag_s, Arc::default());
        settings.safety.distance_heard_m = heard_m;
        let mut filters = [Filter::new(settings.clone()), Filter::new(settings)];
        let mut robots = [-3.0, 3.0].map(|at| Motion::at_rest(Vec2::repeat(at)));
        let mut least_m = f32::INFINITY;
        for _ in 0..200 {
            let before = robots;
            let apart_m = (before[1].position - before[0].position).norm();
            for (own, robot) in robots.iter_mut().enumerate() {
                let heard = (apart_m <= 1.7).then_some((before[1 - own], 0.0));
                let wanted = Vec2::repeat(if own == 0 { 1.05 } else { -1.05 });
                let command = filters[own].apply(robot, heard.into_iter(), wanted).velocity;
                drive(robot, command, lag_s);
            }
            least_m = least_m.min((robots[1].position - robots[0].position).norm());
        }
        least_m
    }

    /// Drives a robot between two that are parked at their goals with too little room between them, and returns how far
    /// each is from its goal after 20 s \[m\]. With `rigid`, the filters forget their way out of deadlocks every step.
    fn off_m(rigid: bool) -> [f32; 3] {
        let mut filters = [(); 3].map(|()| Filter::new(settings(0.2, Arc::default())));
        let goals = [Vec2::new(3.0, 0.0), Vec2::new(0.0, 0.42), Vec2::new(0.0, -0.42)];
        let mut robots = [Vec2::new(-1.0, 0.0), goals[1], goals[2]].map(Motion::at_rest);
        for _ in 0..400 {
            let before = robots;
            for (own, robot) in robots.iter_mut().enumerate() {
                if rigid {
                    filters[own].restore(Yielding::default());
                }
                let others = (0..3).filter(|other| *other != own).map(|other| (before[other], 0.05));
                let wanted = (goals[own] - robot.position).map(|axis| axis.clamp(-0.5, 0.5));
                let command = filters[own].apply(robot, others, wanted).velocity;
                drive(robot, command, 0.2);
            }
            for pair in [(0, 1), (0, 2), (1, 2)] {
                assert!((robots[pair.0].position - robots[pair.1].position).norm() > 0.4, "{robots:?}");
            }
        }
        std::array::from_fn(|own| (robots[own].position - goals[own]).norm())
    }

    #[test]
    fn a_robot_passes_between_two_that_have_parked_too_near_to_each_other() {
        assert!(off_m(false).iter().all(|off_m| *off_m < 0.1), "all are at their goals: {:?}", off_m(false));
        assert!(off_m(true)[0] > 3.0, "without the way out of deadlocks it stays before them: {:?}", off_m(true));
    }

    #[test]
    fn a_robot_that_gives_way_keeps_its_distance_from_a_wall() {
        let walls = Arc::from([KeepOut::rect(Vec2::new(-2.0, -1.0), Vec2::new(2.0, 0.0))]);
        let mut filter = Filter::new(settings(0.2, walls));
        let (mut robot, mut least_m) = (Motion::at_rest(Vec2::new(0.0, 0.3)), f32::INFINITY);
        for _ in 0..60 {
            let other = Motion::at_rest(robot.position + Vec2::new(0.0, 0.45));
            let command = filter.apply(&robot, [(other, 0.05)].into_iter(), Vec2::zeros()).velocity;
            drive(&mut robot, command, 0.2);
            least_m = least_m.min(robot.position.y);
        }
        assert!((0.2..0.28).contains(&least_m), "it moves toward the wall, and stops before it: {least_m} m");
    }

    #[test]
    fn a_robot_that_follows_at_once_turns_no_nearer_around_a_corner() {
        let walls: Arc<[KeepOut]> = Arc::from([KeepOut::rect(Vec2::new(-2.0, -0.15), Vec2::new(-0.5, 0.15))]);
        let mut least_m = f32::INFINITY;
        for (start, slope) in (0..8).flat_map(|start| (0..12).map(move |slope| (start as f32, slope as f32))) {
            let mut filter = Filter::new(settings(0.0, Arc::clone(&walls)));
            let position = Vec2::new(-0.9 - 0.05 * start, -1.3);
            let mut robot = Motion { position, velocity: Vec2::new(0.8, 0.9) };
            for step in 0..40 {
                let wanted = Vec2::new(1.05 - 0.01 * slope * step as f32, 1.0);
                let command = filter.apply(&robot, [].into_iter(), wanted).velocity;
                drive(&mut robot, command, 0.0);
                least_m = least_m.min((walls[0].nearest(robot.position) - robot.position).norm());
            }
        }
        assert!(
            (0.199..0.25).contains(&least_m),
            "it passes close to the corner, and no nearer than 0.2 m: {least_m} m"
        );
    }

    #[test]
    fn robots_drive_no_faster_than_they_can_stop_after_they_have_heard_each_other() {
        for lag_s in [0.0, 0.5] {
            let (limited, not) = (nearest_m(lag_s, 1.7), nearest_m(lag_s, 10.0));
            assert!(limited > 0.36 && not < 0.3, "lag {lag_s} s: {limited} m apart, without the limit {not} m");
        }
    }
}
