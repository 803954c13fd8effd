//! Scripted navigation: optimal reciprocal collision avoidance (van den Berg et al., ISRR 2009) around
//! neighbours and walls, with a queue at bottlenecks. It drives every reset, and it is the baseline that
//! must solve each scenario.
//!
//! A robot broadcasts its radius and the velocity that it would prefer if it were alone; from positions and
//! these it follows who else is bound for the bottleneck, and keeps its place in the line.

use std::borrow::Cow;

use dodgy_2d::{Agent, AvoidanceOptions, Obstacle};

use super::route::{Crossing, Leg, leg};
use super::{Interface, Neighbour, Policy};
use crate::messages::geometry::Vec2;
use crate::random::Stream;
use crate::scenario::{Arena, Observation};
use crate::time::Span;

/// Radius and preferred velocity.
const FEATURES: usize = 3;
/// Cruising speed \[m/s\]: from it a robot stops within half a metre.
const SPEED_M_S: f32 = 1.0;
/// Deceleration that braking is planned with \[m/s^2\]; the training world allows 1.
const BRAKING_M_S2: f32 = 0.7;
/// What is added to the radius toward neighbours, and toward walls \[m\].
const NEIGHBOUR_MARGIN_M: f32 = 0.02;
const WALL_MARGIN_M: f32 = 0.02;
/// How far ahead collisions with neighbours, and with walls, are considered \[s\].
const HORIZON_S: f32 = 1.2;
const WALL_HORIZON_S: f32 = 0.4;
/// Time constant of the approach to a point \[s\].
const APPROACH_S: f32 = 0.35;
/// Distance kept behind the robot ahead in the line \[m\], and to the middle while others come the other way.
const FOLLOWING_M: f32 = 0.66;
const ONCOMING_M: f32 = 1.5;
/// A robot that stands nearer than this to a mouth that others come out of makes room \[m\].
const MOUTH_ROOM_M: f32 = 0.9;
/// Two robots that meet head-on pass each other because each prefers to bear right by this angle \[rad\].
const BEAR_RIGHT_RAD: f32 = 0.08;

/// What the rest of the system has to know of it.
pub const INTERFACE: Interface = Interface {
    features: FEATURES,
    radius_m: 4.0,
    period: Span::from_millis(50),
    limit_m_s: 1.5,
    hold: Span::from_millis(200),
};

/// One robot's navigation.
#[derive(Debug)]
pub struct Orca {
    arena: Arena,
    obstacles: Vec<Obstacle>,
}

/// A neighbour, and the bottleneck that it is bound for.
struct Bound {
    crossing: Crossing,
    ahead_m: f32,
    /// Breaks a tie in the line in the same way for both.
    tie: (f32, f32),
}

impl Orca {
    /// A navigation for this arena.
    pub fn new(arena: &Arena) -> Orca {
        let corner = |x: f32, y: f32| dodgy_2d::Vec2::new(x, y);
        let block = |min: Vec2, max: Vec2| Obstacle::Closed {
            // Counter-clockwise: solid inside.
            vertices: vec![corner(min.x, min.y), corner(max.x, min.y), corner(max.x, max.y), corner(min.x, max.y)],
        };
        let obstacles = arena.keep_outs.iter().map(|keep_out| block(keep_out.min, keep_out.max)).collect();
        Orca { arena: arena.clone(), obstacles }
    }

    /// The velocity toward the goal if the robot were alone.
    fn preferred(&self, own: &Observation) -> Vec2 {
        let at = own.motion.position;
        match leg(&self.arena, at, own.goal) {
            Leg::Direct => approach(own.goal - at),
            Leg::Through(crossing) => (crossing.aim(&self.arena, at) - at).normalize() * SPEED_M_S,
        }
    }

    /// The bottleneck that a robot at `at` with this preferred velocity is bound for.
    fn bound(&self, at: Vec2, preferred: Vec2) -> Option<Bound> {
        let speed = preferred.norm();
        if speed < 0.9 * SPEED_M_S {
            return None;
        }
        self.arena.portals.iter().find_map(|portal| {
            [(portal.near, portal.far), (portal.far, portal.near)].into_iter().find_map(|(entry, exit)| {
                let crossing = Crossing { entry, exit };
                let aim = crossing.aim(&self.arena, at) - at;
                let before = (exit - at).dot(&(exit - entry)) > 0.0;
                let aims = aim.dot(&preferred) > 0.995 * aim.norm() * speed;
                (before && aims).then(|| Bound {
                    crossing,
                    ahead_m: crossing.ahead(&self.arena, at),
                    tie: (at.x, at.y),
                })
            })
        })
    }

    /// The preferred velocity, given who else is about a bottleneck.
    fn yielding(&self, own: &Observation, preferred: Vec2, neighbours: &[Neighbour]) -> Vec2 {
        let at = own.motion.position;
        let mut others = neighbours.iter().filter_map(|neighbour| {
            let said = neighbour.features;
            self.bound(neighbour.motion.position, Vec2::new(said[1], said[2]))
        });
        let Some(mine) = self.bound(at, preferred) else {
            // Not in the line: make room for those who will come out, and go home afterwards.
            return others.find_map(|other| self.make_room(own, other.crossing.exit)).unwrap_or(preferred);
        };
        let mut speed = SPEED_M_S;
        for other in others {
            if (other.ahead_m, other.tie) >= (mine.ahead_m, mine.tie) {
                continue;
            }
            let oncoming = other.crossing.entry != mine.crossing.entry;
            let room = if oncoming { mine.ahead_m - ONCOMING_M } else { mine.ahead_m - other.ahead_m - FOLLOWING_M };
            speed = speed.min(room / APPROACH_S);
        }
        preferred * (speed.max(-0.3) / SPEED_M_S)
    }

    /// The way out of the room before a mouth, for a robot that stands or is to stand there.
    fn make_room(&self, own: &Observation, mouth: Vec2) -> Option<Vec2> {
        let same_side = |point: Vec2| super::route::is_free(&self.arena, point, mouth);
        let in_the_way = |point: Vec2| (point - mouth).norm() < MOUTH_ROOM_M && same_side(point);
        if !in_the_way(own.goal) && !in_the_way(own.motion.position) {
            return None;
        }
        let mut outward = own.goal - mouth;
        if outward.norm() < 1e-3 {
            outward = own.motion.position - mouth;
        }
        let outward = outward.try_normalize(1e-6)?;
        Some(approach(mouth + outward * (MOUTH_ROOM_M + 0.05) - own.motion.position))
    }

    /// Takes away what a robot could not brake before it touched a block.
    fn braked(&self, at: Vec2, mut velocity: Vec2) -> Vec2 {
        for block in &self.arena.keep_outs {
            let offset = block.nearest(at) - at;
            let distance = offset.norm();
            let Some(toward) = offset.try_normalize(1e-6) else { continue };
            let room = (distance - self.arena.robot_radius_m - WALL_MARGIN_M / 2.0).max(0.0);
            let excess = velocity.dot(&toward) - (2.0 * BRAKING_M_S2 * room).sqrt();
            if excess > 0.0 {
                velocity -= toward * excess;
            }
        }
        velocity
    }
}

/// The velocity toward a point `offset` away: cruising, and then braking.
fn approach(offset: Vec2) -> Vec2 {
    let distance = offset.norm();
    let speed = SPEED_M_S.min((2.0 * BRAKING_M_S2 * distance).sqrt()).min(distance / APPROACH_S);
    if distance < 1e-6 { Vec2::zeros() } else { offset * (speed / distance) }
}

fn glam(v: Vec2) -> dodgy_2d::Vec2 {
    dodgy_2d::Vec2::new(v.x, v.y)
}

impl Policy for Orca {
    fn interface(&self) -> Interface {
        INTERFACE
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        let preferred = self.preferred(own);
        features.copy_from_slice(&[self.arena.robot_radius_m, preferred.x, preferred.y]);
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        let at = own.motion.position;
        let preferred = self.yielding(own, Vec2::new(features[1], features[2]), neighbours);
        let (sin, cos) = (-BEAR_RIGHT_RAD).sin_cos();
        let preferred = Vec2::new(cos * preferred.x - sin * preferred.y, sin * preferred.x + cos * preferred.y);
        let agent = |position: Vec2, velocity: Vec2, radius: f32| Agent {
            position: glam(position),
            velocity: glam(velocity),
            radius: radius + NEIGHBOUR_MARGIN_M,
            avoidance_responsibility: 1.0,
        };
        let others: Vec<Cow<Agent>> = neighbours
            .iter()
            .map(|n| {
                Cow::Owned(agent(
                    n.motion.position + n.motion.velocity * n.age.as_secs() as f32,
                    n.motion.velocity,
                    n.features[0],
                ))
            })
            .collect();
        let obstacles: Vec<Cow<Obstacle>> = self.obstacles.iter().map(Cow::Borrowed).collect();
        let velocity = agent(at, own.motion.velocity, self.arena.robot_radius_m).compute_avoiding_velocity(
            &others,
            &obstacles,
            glam(preferred),
            SPEED_M_S,
            INTERFACE.period.as_secs() as f32,
            &AvoidanceOptions {
                obstacle_margin: self.arena.robot_radius_m + WALL_MARGIN_M,
                time_horizon: HORIZON_S,
                obstacle_time_horizon: WALL_HORIZON_S,
            },
        );
        self.braked(at, Vec2::new(velocity.x, velocity.y))
    }
}
