//! Wheels of robots in training environments whose chassis is not the default one: robots with a differential drive, or
//! with limits of their own.

use std::ops::Range;

use murmurate::chassis::Chassis;
use murmurate::messages::geometry::{Motion, Vec2};
use murmurate::world::Wheels;

/// Wheels of robots, and true motions of the points that the policy commands, one entry per robot.
#[derive(Clone, Debug)]
pub struct Rolling {
    /// Chassis, heading and yaw rate of each robot.
    pub wheels: Vec<Wheels>,
    /// Positions of the commanded points \[m\], world frame.
    pub position: Vec<Vec2>,
    /// Velocities of the commanded points \[m/s\], world frame.
    pub velocity: Vec<Vec2>,
}

impl Rolling {
    /// Returns robots at rest at the origin with this chassis; `None` for the default chassis, which needs no wheels.
    pub fn new(chassis: &Chassis, robots: usize) -> Option<Rolling> {
        let zeros = vec![Vec2::zeros(); robots];
        (*chassis != Chassis::default()).then(|| Rolling {
            wheels: vec![Wheels::new(*chassis, 0.0); robots],
            position: zeros.clone(),
            velocity: zeros,
        })
    }

    /// Returns the distance of the commanded points ahead of the robots' centres \[m\]; 0 for holonomic robots.
    pub fn ahead_m(&self) -> f32 {
        self.wheels.first().map_or(0.0, |wheels| wheels.chassis().point_ahead_m)
    }

    /// Updates the commanded points of some robots from the positions \[m\] and velocities \[m/s\] of all centres,
    /// world frame.
    pub fn follow(&mut self, robots: Range<usize>, (position, velocity): (&[Vec2], &[Vec2])) {
        for robot in robots {
            self.update(robot, &Motion { position: position[robot], velocity: velocity[robot] });
        }
    }

    /// Updates the commanded point of the robot with index `robot` from `centre`, the motion of its centre, world
    /// frame.
    pub fn update(&mut self, robot: usize, centre: &Motion) {
        let point = self.wheels[robot].point(centre);
        (self.position[robot], self.velocity[robot]) = (point.position, point.velocity);
    }
}
