//! Scripted navigation: optimal reciprocal collision avoidance (van den Berg et al., ISRR 2009) around
//! neighbours and walls, with a queue at bottlenecks. It drives every reset, and it is the baseline that
//! must solve each scenario.
//!
//! A robot broadcasts its radius and the velocity that it would prefer if it were alone and could go as fast
//! as it liked: it heads along the robot's way, and its size tells how long that way is (`approach`). From
//! positions and these it follows who else is bound for the bottleneck, so that a robot keeps its place in the
//! line; and who is underway and who at home, so that the one gives way to the other.
//!
//! Avoidance reckons with robots that change their velocity at once. So the last word is with `route::braked`, which
//! knows their acceleration and lets no command pass after which a wall could not be missed.

use std::borrow::Cow;

use dodgy_2d::{Agent, AvoidanceOptions, Obstacle};

use super::route::{self, Crossing, Leg, leg};
use super::{Interface, Neighbour, Policy};
use crate::messages::geometry::{Motion, Vec2};
use crate::random::Stream;
use crate::scenario::{Arena, Observation};
use crate::time::Span;

/// Radius and preferred velocity.
const FEATURES: usize = 3;
/// Cruising speed \[m/s\]: from it a robot stops within half a metre.
const SPEED_M_S: f32 = 1.0;
/// Deceleration that braking is planned with \[m/s^2\]: a little less than there is.
const BRAKING_M_S2: f32 = 0.85;
/// A robot that has less of its way before it is at home \[m\], and gives way to one that has this much more.
/// Twice as large, and dense teams (12 in the passage) come to a halt far more often.
const HOME_M: f32 = 0.3;
const HOME_LEAD_M: f32 = 0.1;
/// Of avoiding each other, the share of who is underway against one of who is at home: a fifth in all.
const UNDERWAY_SHARE: f32 = 0.25;
/// With which share of its cruising velocity one that is underway is taken to come, however it is held up: it
/// would wait for ever for one that only minds how it moves.
const INSISTENCE: f32 = 0.5;
/// What is added to the radius toward neighbours, and toward walls \[m\].
const NEIGHBOUR_MARGIN_M: f32 = 0.02;
const WALL_MARGIN_M: f32 = 0.02;
/// How far ahead collisions with neighbours, and with walls, are considered \[s\].
const HORIZON_S: f32 = 1.2;
const WALL_HORIZON_S: f32 = 0.4;
/// Time constant of the approach to a point \[s\].
const APPROACH_S: f32 = 0.35;
/// Distance kept behind the robot ahead in the line \[m\], little more than avoidance keeps anyway; and to the
/// middle while others come the other way.
const FOLLOWING_M: f32 = 0.58;
const ONCOMING_M: f32 = 1.5;
/// A robot that stands nearer than this to a mouth that others come out of makes room \[m\].
const MOUTH_ROOM_M: f32 = 0.9;
/// Two robots that meet head-on pass each other because each prefers to bear right by this angle \[rad\].
const BEAR_RIGHT_RAD: f32 = 0.08;

/// The largest distance and speed that are taken for true.
const FARTHEST_M: f32 = 1e3;
const FASTEST_M_S: f32 = 1e2;

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
        let reach = arena.half_extent + Vec2::repeat(arena.robot_radius_m + WALL_MARGIN_M);
        // Clockwise: solid outside. Who leaves the ground is put back on it, at times into another robot, and
        // two that overlap never part: no move that leaves them overlapping is let through.
        let ground = Obstacle::Closed {
            vertices: vec![
                corner(-reach.x, -reach.y),
                corner(-reach.x, reach.y),
                corner(reach.x, reach.y),
                corner(reach.x, -reach.y),
            ],
        };
        let blocks = arena.keep_outs.iter().map(|keep_out| block(keep_out.min, keep_out.max));
        let obstacles = blocks.chain([ground]).collect();
        Orca { arena: arena.clone(), obstacles }
    }

    /// The velocity along the way to the goal if the robot were alone and had no top speed.
    fn preferred(&self, own: &Observation) -> Vec2 {
        let at = own.motion.position;
        match leg(&self.arena, at, own.goal) {
            Leg::Direct => approach(own.goal - at),
            Leg::Through(crossing) => {
                let heading = (crossing.aim(&self.arena, at) - at).try_normalize(1e-6).unwrap_or_else(Vec2::zeros);
                approach(heading * crossing.way(&self.arena, at, own.goal))
            }
        }
    }

    /// The bottleneck that a robot at `at` with this preferred velocity is bound for.
    fn bound(&self, at: Vec2, preferred: Vec2) -> Option<Bound> {
        let heading = preferred.try_normalize(1e-6)?;
        let way_m = remaining(preferred);
        self.arena.portals.iter().find_map(|portal| {
            let both = [(portal.near, portal.far), (portal.far, portal.near)];
            let mut crossings = both.into_iter().map(|(entry, exit)| Crossing { entry, exit });
            let crossing = crossings.find(|crossing| crossing.is_passed(&self.arena, at, heading, way_m))?;
            Some(Bound { crossing, ahead_m: crossing.ahead(&self.arena, at), tie: (at.x, at.y) })
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
            return others.find_map(|other| self.make_room(own, other.crossing)).unwrap_or(preferred);
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
        preferred.normalize() * speed.max(-0.3)
    }

    /// The way out of the room before a mouth, for a robot that stands or is to stand there.
    fn make_room(&self, own: &Observation, crossing: Crossing) -> Option<Vec2> {
        let mouth = crossing.exit;
        let along = (crossing.exit - crossing.entry).normalize();
        let same_side = |point: Vec2| route::is_free(&self.arena, point, mouth);
        let in_the_way = |point: Vec2| (point - mouth).norm() < MOUTH_ROOM_M && same_side(point);
        if !in_the_way(own.goal) && !in_the_way(own.motion.position) {
            return None;
        }
        // Never back into the bottleneck: sideways at the least, and straight away if there is no side.
        let away = |point: Vec2| {
            let offset = point - mouth;
            (offset - along * offset.dot(&along).min(0.0)).try_normalize(1e-3)
        };
        let outward = away(own.goal).or_else(|| away(own.motion.position)).unwrap_or(along);
        Some(approach(mouth + outward * (MOUTH_ROOM_M + 0.05) - own.motion.position))
    }
}

/// The velocity toward a point `offset` away from which a robot still stops there; it grows with the distance.
fn approach(offset: Vec2) -> Vec2 {
    let distance = offset.norm();
    let speed = (2.0 * BRAKING_M_S2 * distance).sqrt().min(distance / APPROACH_S);
    if distance < 1e-6 { Vec2::zeros() } else { offset * (speed / distance) }
}

/// The length of the way that a robot with this preferred velocity has before it \[m\]: what `approach` began with.
fn remaining(preferred: Vec2) -> f32 {
    let speed = preferred.norm();
    (speed * speed / (2.0 * BRAKING_M_S2)).max(speed * APPROACH_S)
}

/// A velocity of the same direction that is no faster than a robot cruises.
fn cruising(velocity: Vec2) -> Vec2 {
    velocity * (SPEED_M_S / velocity.norm().max(SPEED_M_S))
}

/// The velocity that a neighbour is taken to have, and its share in the avoidance when one's own is 1, for a
/// robot that has said `own`.
fn meant(own: Vec2, neighbour: &Neighbour) -> (Vec2, f32) {
    let said = Vec2::new(neighbour.features[1], neighbour.features[2]);
    let (mine, theirs) = (remaining(own), remaining(said));
    if mine < HOME_M && theirs > mine + HOME_LEAD_M {
        (cruising(said) * INSISTENCE, UNDERWAY_SHARE)
    } else if theirs < HOME_M && mine > theirs + HOME_LEAD_M {
        (neighbour.motion.velocity, 1.0 / UNDERWAY_SHARE)
    } else {
        (neighbour.motion.velocity, 1.0)
    }
}

/// Whether a neighbour can be where it says, and want what it says.
fn is_plausible(own: &Observation, neighbour: &Neighbour) -> bool {
    let said = neighbour.features;
    let offset = neighbour.motion.position - own.motion.position;
    offset.norm() <= FARTHEST_M
        && neighbour.motion.velocity.norm() <= FASTEST_M_S
        && (0.0..=FARTHEST_M).contains(&said[0])
        && Vec2::new(said[1], said[2]).norm() <= FASTEST_M_S
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
        // What was garbled on its way, or measured by a broken sensor, can be of any size: nobody drives on that.
        let near: Vec<Neighbour> =
            neighbours.iter().filter(|neighbour| is_plausible(own, neighbour)).copied().collect();
        let neighbours = &near[..];
        let at = own.motion.position;
        if at.norm() > FARTHEST_M || own.motion.velocity.norm() > FASTEST_M_S {
            return Vec2::zeros();
        }
        let said = Vec2::new(features[1], features[2]);
        let preferred = cruising(self.yielding(own, said, neighbours));
        let (sin, cos) = libm::sincosf(-BEAR_RIGHT_RAD);
        let preferred = Vec2::new(cos * preferred.x - sin * preferred.y, sin * preferred.x + cos * preferred.y);
        let agent = |position: Vec2, velocity: Vec2, radius_m: f32, share: f32| Agent {
            position: glam(position),
            velocity: glam(velocity),
            radius: radius_m + NEIGHBOUR_MARGIN_M,
            avoidance_responsibility: share,
        };
        let others = neighbours.iter().map(|neighbour| {
            let Motion { position, velocity } = neighbour.motion;
            let (velocity_meant, share) = meant(said, neighbour);
            let mut now = position + velocity * neighbour.age.as_secs() as f32;
            if now == at {
                // Of two robots in one place the library draws lots, from a generator that has no seed.
                now.x += NEIGHBOUR_MARGIN_M;
            }
            Cow::Owned(agent(now, velocity_meant, neighbour.features[0], share))
        });
        let others: Vec<Cow<Agent>> = others.collect();
        let obstacles: Vec<Cow<Obstacle>> = self.obstacles.iter().map(Cow::Borrowed).collect();
        let period_s = INTERFACE.period.as_secs() as f32;
        let velocity = agent(at, own.motion.velocity, self.arena.robot_radius_m, 1.0).compute_avoiding_velocity(
            &others,
            &obstacles,
            glam(preferred),
            SPEED_M_S,
            period_s,
            &AvoidanceOptions {
                obstacle_margin: self.arena.robot_radius_m + WALL_MARGIN_M,
                time_horizon: HORIZON_S,
                obstacle_time_horizon: WALL_HORIZON_S,
            },
        );
        route::braked(&self.arena, &own.motion, Vec2::new(velocity.x, velocity.y), period_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Settings, build};

    fn passage() -> Arena {
        build("passage", &Settings::default()).unwrap().arena().clone()
    }

    #[test]
    fn a_preferred_velocity_tells_the_way_that_is_left() {
        for distance in [0.0, 0.05, 0.1, 0.5, 3.0, 6.0] {
            let told = remaining(approach(Vec2::new(distance, 0.0)));
            assert!((told - distance).abs() < 1e-4, "{told} for {distance}");
        }
        assert!((cruising(Vec2::new(3.0, 4.0)).norm() - SPEED_M_S).abs() < 1e-6);
    }

    #[test]
    fn a_robot_at_home_gives_way_and_one_underway_does_not() {
        let (home, underway) = (Vec2::zeros(), approach(Vec2::new(2.0, 0.0)));
        let seen = |said: &Vec2, other: Vec2| {
            let features = [0.25, other.x, other.y];
            meant(*said, &Neighbour { motion: Motion::at_rest(Vec2::zeros()), features: &features, age: Span::ZERO })
        };
        assert!(seen(&home, underway).1 < 1.0 && seen(&home, underway).0.x > 0.0);
        assert!(seen(&underway, home).1 > 1.0 && seen(&underway, home).0 == Vec2::zeros());
        assert_eq!(seen(&underway, underway).1, 1.0);
    }

    #[test]
    fn room_is_made_beside_the_mouth_never_in_the_bottleneck() {
        let orca = Orca::new(&passage());
        let portal = orca.arena.portals[0];
        let crossing = Crossing { entry: portal.far, exit: portal.near };
        let own = Observation { motion: Motion::at_rest(Vec2::new(-0.2, -0.4)), goal: Vec2::new(-0.05, -0.46) };
        let away = orca.make_room(&own, crossing).expect("it stands in the mouth");
        assert!(away.x < 0.0 && away.y <= 0.0);
    }
}
