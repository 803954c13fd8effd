//! Scripted navigation: optimal reciprocal collision avoidance (ORCA; van den Berg et al., ISRR 2009) around neighbours
//! and walls, with a queue at bottlenecks. It drives every reset, and it is the baseline that must solve each scenario.
//!
//! A robot broadcasts its radius and its preferred velocity: the velocity that it would have if it were alone and had
//! no speed limit. Its direction is that of the path, and its norm encodes the length of the remaining path
//! (`approach`). From these and the positions, a robot computes which others are going to use its bottleneck, and its
//! place in the queue. It also knows which robots are at their goals, which give way to those that are underway.
//!
//! ORCA assumes that robots change their velocity at once. So the result passes through `route::safe_command`, which
//! models their acceleration and only allows commands after which a robot can still brake before a wall.

use std::borrow::Cow;

use dodgy_2d::{Agent, AvoidanceOptions, Obstacle};

use super::roadmap::Roadmap;
use super::route::{self, Crossing};
use super::{Interface, Neighbour, Policy};
use crate::messages::geometry::{Motion, Vec2};
use crate::observation::Observation;
use crate::random::Stream;
use crate::scenario::{Arena, KeepOut};
use crate::time::Span;

/// Number of floats of a broadcast: radius and preferred velocity.
const FEATURES: usize = 3;
/// Cruising speed \[m/s\]; the stopping distance from it is about half a metre.
const SPEED_M_S: f32 = 1.0;
/// Planned deceleration \[m/s^2\]: slightly less than the available one.
const BRAKING_M_S2: f32 = 0.85;
/// Remaining path below which a robot counts as at its goal \[m\]. With twice this value, dense teams (12 in the
/// passage) deadlock far more often.
const AT_GOAL_M: f32 = 0.3;
/// Smallest difference of two robots' remaining paths \[m\] from which the one at its goal gives way to the other.
const PRIORITY_LEAD_M: f32 = 0.1;
/// Responsibility in ORCA (share in avoiding a collision) of a robot that is underway, relative to 1 for a robot at its
/// goal. With 0.25, the robot that is underway does a fifth of the avoidance.
const UNDERWAY_SHARE: f32 = 0.25;
/// Velocity that a robot at its goal assumes for a robot that is underway, as a fraction of that robot's preferred
/// velocity, limited to cruising speed. With the true velocity, a blocked robot would wait for ever, because the robot
/// at its goal would have no reason to move.
const UNDERWAY_SPEED_FRACTION: f32 = 0.5;
/// Margin \[m\] that is added to the radius of each robot when collisions between robots are avoided.
const NEIGHBOUR_MARGIN_M: f32 = 0.02;
/// Margin \[m\] that is added to the robot's radius when collisions with walls are avoided.
const WALL_MARGIN_M: f32 = 0.02;
/// Time horizon \[s\] of ORCA for neighbours: collisions that are expected within this time are avoided.
const HORIZON_S: f32 = 1.2;
/// Time horizon \[s\] of ORCA for walls: collisions that are expected within this time are avoided.
const WALL_HORIZON_S: f32 = 0.4;
/// Time constant of the approach to a point \[s\]: the speed is at most the distance divided by this time.
const APPROACH_S: f32 = 0.35;
/// Distance kept to the robot ahead in the queue \[m\]: slightly more than avoidance keeps anyway.
const FOLLOWING_M: f32 = 0.58;
/// Distance \[m\] that a robot keeps to the middle of a bottleneck while others come through it in the other direction.
const ONCOMING_M: f32 = 1.5;
/// Distance \[m\] from a mouth (an end of a bottleneck) within which a robot that waits or has its goal there moves
/// away from the mouth, so that other robots can come out of the bottleneck.
const MOUTH_ROOM_M: f32 = 0.9;
/// Rotation of the preferred velocity to the right \[rad\], so that two robots that meet head-on pass each other.
const BEAR_RIGHT_RAD: f32 = 0.08;

/// Largest plausible distance \[m\] of a robot from the origin, of a neighbour from the robot, and of a broadcast
/// radius. A neighbour beyond it is ignored; a robot whose own position is beyond it stands.
const MAX_DISTANCE_M: f32 = 1e3;
/// Largest plausible speed \[m/s\]. A neighbour that states a higher one is ignored; a robot whose own speed is higher
/// is commanded to stand.
const MAX_SPEED_M_S: f32 = 1e2;

/// Parameters of scripted navigation that the rest of the system needs to run it: message size, communication radius,
/// period, speed limit and hold time.
pub const INTERFACE: Interface = Interface {
    features: FEATURES,
    radius_m: 4.0,
    period: Span::from_millis(50),
    limit_m_s: 1.5,
    hold: Span::from_millis(200),
};

/// Scripted navigation of one robot, a policy: optimal reciprocal collision avoidance (ORCA) along a planned path
/// through the arena.
#[derive(Debug)]
pub(crate) struct Orca {
    arena: Arena,
    /// Factor on distances between robots, and from robots to walls and bottlenecks.
    share: f32,
    obstacles: Vec<Obstacle>,
    roadmap: Roadmap,
}

/// A robot's place in the queue at a bottleneck. Of two robots, the one that is nearer to the middle goes first.
struct QueuePlace {
    crossing: Crossing,
    /// Distance to the middle of the bottleneck \[m\].
    ahead_m: f32,
    /// The robot's position \[m\]: of two robots at the same distance, the one with the lower x, then y, goes first. So
    /// both compute the same order.
    tie: (f32, f32),
}

impl Orca {
    /// Makes one robot's instance of scripted navigation for `arena`: ground, walls and bottlenecks, in the policy
    /// frame, and the robots' radius.
    pub(crate) fn new(arena: &Arena) -> Orca {
        let corner = |x: f32, y: f32| dodgy_2d::Vec2::new(x, y);
        // Counter-clockwise vertices: solid inside. Those about a disc are where paths would turn that touch it.
        let rim = |block: &KeepOut| if block.radius_m() > 0.0 { block.turns(0.0) } else { block.corners().collect() };
        let block = |block: &KeepOut| Obstacle::Closed { vertices: rim(block).into_iter().map(to_glam).collect() };
        let share = route::share(arena);
        let reach = arena.half_extent + Vec2::repeat(arena.robot_radius_m + share * WALL_MARGIN_M);
        // Clockwise vertices: solid outside. The world clamps robots to the ground, at times into another robot.
        // Two that overlap are stuck for ever, because no move that leaves them overlapping is made.
        let ground = Obstacle::Closed {
            vertices: vec![
                corner(-reach.x, -reach.y),
                corner(-reach.x, reach.y),
                corner(reach.x, reach.y),
                corner(reach.x, -reach.y),
            ],
        };
        let blocks = arena.keep_outs.iter().map(block);
        let obstacles = blocks.chain([ground]).collect();
        Orca { arena: arena.clone(), share, obstacles, roadmap: Roadmap::new(arena) }
    }

    /// Returns the robot's preferred velocity \[m/s\] along the path to its goal, without other robots and without a
    /// speed limit; zero if no path leads there. Its norm encodes the length of the remaining path, as in `approach`.
    fn preferred(&self, own: &Observation) -> Vec2 {
        let at = own.motion.position;
        match self.roadmap.path(at, own.goal).as_deref() {
            Some([goal]) => approach(goal - at),
            Some(path @ [next, ..]) => {
                let points = [at].into_iter().chain(path.iter().copied());
                let length_m: f32 = points.zip(path).map(|(from, to)| (to - from).norm()).sum();
                approach((next - at).try_normalize(1e-6).unwrap_or_else(Vec2::zeros) * length_m)
            }
            _ => Vec2::zeros(),
        }
    }

    /// Returns the place in the queue at the next bottleneck of a robot at `at` \[m\] with the preferred velocity
    /// `preferred` \[m/s\]; `None` if it is not going to use a bottleneck.
    fn queue_place(&self, at: Vec2, preferred: Vec2) -> Option<QueuePlace> {
        let heading = preferred.try_normalize(1e-6)?;
        let path_m = remaining_path(preferred);
        let places = self.arena.portals.iter().filter_map(|portal| {
            let both = [(portal.near, portal.far), (portal.far, portal.near)];
            let mut crossings = both.into_iter().map(|(entry, exit)| Crossing { entry, exit });
            let crossing = crossings.find(|crossing| crossing.is_ahead_of(&self.arena, at, heading, path_m))?;
            Some(QueuePlace { crossing, ahead_m: crossing.ahead(&self.arena, at), tie: (at.x, at.y) })
        });
        places.min_by(|a, b| a.ahead_m.total_cmp(&b.ahead_m))
    }

    /// Returns the robot's velocity \[m/s\] after it gave way at bottlenecks. In a queue it is `preferred` with a lower
    /// speed. A robot that uses no bottleneck moves away from a mouth at which others come out; otherwise it takes
    /// `preferred`.
    fn yielding(&self, own: &Observation, preferred: Vec2, neighbours: &[Neighbour]) -> Vec2 {
        let at = own.motion.position;
        let mut others = neighbours.iter().filter_map(|neighbour| {
            let broadcast = neighbour.features;
            self.queue_place(neighbour.motion.position, Vec2::new(broadcast[1], broadcast[2]))
        });
        let Some(mine) = self.queue_place(at, preferred) else {
            // Not in the queue: clear the mouth for those who will come out, and return to the goal afterwards.
            return others.find_map(|other| self.clear_mouth(own, other.crossing)).unwrap_or(preferred);
        };
        let mut speed = SPEED_M_S;
        for other in others {
            if (other.ahead_m, other.tie) >= (mine.ahead_m, mine.tie) {
                continue;
            }
            let oncoming = other.crossing.entry != mine.crossing.entry;
            let room = match oncoming {
                true => mine.ahead_m - self.share * ONCOMING_M,
                false => mine.ahead_m - other.ahead_m - self.share * FOLLOWING_M,
            };
            speed = speed.min(room / APPROACH_S);
        }
        preferred.normalize() * speed.max(-0.3)
    }

    /// Returns the velocity \[m/s\] with which a robot moves away from the mouth (end of a bottleneck) at which another
    /// robot ends its crossing `crossing`; `None` if neither the robot nor its goal is in the way.
    fn clear_mouth(&self, own: &Observation, crossing: Crossing) -> Option<Vec2> {
        let mouth = crossing.exit;
        let along = (crossing.exit - crossing.entry).normalize();
        let same_side = |point: Vec2| route::is_free(&self.arena, point, mouth);
        let room_m = self.share * MOUTH_ROOM_M;
        let in_the_way = |point: Vec2| (point - mouth).norm() < room_m && same_side(point);
        if !in_the_way(own.goal) && !in_the_way(own.motion.position) {
            return None;
        }
        // Never back into the bottleneck: at least sideways, or straight away from it if the robot is in its axis.
        let away = |point: Vec2| {
            let offset = point - mouth;
            (offset - along * offset.dot(&along).min(0.0)).try_normalize(1e-3)
        };
        let outward = away(own.goal).or_else(|| away(own.motion.position)).unwrap_or(along);
        Some(approach(mouth + outward * (room_m + 0.05 * self.share) - own.motion.position))
    }
}

/// Returns the velocity \[m/s\] toward the point at `offset` \[m\] from the robot. It grows with the distance, and is
/// low enough that the robot can stop at that point.
fn approach(offset: Vec2) -> Vec2 {
    let distance = offset.norm();
    let speed = (2.0 * BRAKING_M_S2 * distance).sqrt().min(distance / APPROACH_S);
    if distance < 1e-6 { Vec2::zeros() } else { offset * (speed / distance) }
}

/// Returns the length \[m\] of the remaining path of a robot whose preferred velocity is `preferred` \[m/s\]: the
/// inverse of `approach`.
fn remaining_path(preferred: Vec2) -> f32 {
    let speed = preferred.norm();
    (speed * speed / (2.0 * BRAKING_M_S2)).max(speed * APPROACH_S)
}

/// Returns `velocity` \[m/s\], scaled down to the cruising speed if it is faster.
fn limit_to_cruising(velocity: Vec2) -> Vec2 {
    velocity * (SPEED_M_S / velocity.norm().max(SPEED_M_S))
}

/// Returns the velocity \[m/s\] that ORCA assumes for `neighbour`, and the neighbour's responsibility (its share in
/// avoiding a collision) relative to 1 for the robot itself. `own` is the robot's own preferred velocity \[m/s\].
/// `share` is the factor on distances.
fn assumed_motion(own: Vec2, neighbour: &Neighbour, share: f32) -> (Vec2, f32) {
    let (at_goal_m, lead_m) = (share * AT_GOAL_M, share * PRIORITY_LEAD_M);
    let preferred = Vec2::new(neighbour.features[1], neighbour.features[2]);
    let (mine, theirs) = (remaining_path(own), remaining_path(preferred));
    if mine < at_goal_m && theirs > mine + lead_m {
        (limit_to_cruising(preferred) * UNDERWAY_SPEED_FRACTION, UNDERWAY_SHARE)
    } else if theirs < at_goal_m && mine > theirs + lead_m {
        (neighbour.motion.velocity, 1.0 / UNDERWAY_SHARE)
    } else {
        (neighbour.motion.velocity, 1.0)
    }
}

/// Returns true if a neighbour's position, velocity and broadcast are plausible; others are ignored, because messages
/// can be corrupted and sensors broken.
fn is_plausible(own: &Observation, neighbour: &Neighbour) -> bool {
    let broadcast = neighbour.features;
    let offset = neighbour.motion.position - own.motion.position;
    offset.norm() <= MAX_DISTANCE_M
        && neighbour.motion.velocity.norm() <= MAX_SPEED_M_S
        && (0.0..=MAX_DISTANCE_M).contains(&broadcast[0])
        && Vec2::new(broadcast[1], broadcast[2]).norm() <= MAX_SPEED_M_S
}

/// Returns whether a vector is too short to have a direction.
fn is_undirected(v: Vec2) -> bool {
    let inverse = v.norm().recip();
    !(inverse.is_finite() && inverse > 0.0)
}

fn to_glam(v: Vec2) -> dodgy_2d::Vec2 {
    dodgy_2d::Vec2::new(v.x, v.y)
}

impl Policy for Orca {
    fn interface(&self) -> Interface {
        INTERFACE
    }

    fn enter(&mut self, arena: &Arena) {
        *self = Orca::new(arena);
    }

    fn encode(&mut self, own: &Observation, features: &mut [f32]) {
        let preferred = self.preferred(own);
        features.copy_from_slice(&[self.arena.robot_radius_m, preferred.x, preferred.y]);
    }

    fn act(&mut self, own: &Observation, features: &[f32], neighbours: &[Neighbour], _: &mut Stream) -> Vec2 {
        // Corrupted messages and broken sensors can give values of any size; those are not used.
        let near: Vec<Neighbour> =
            neighbours.iter().filter(|neighbour| is_plausible(own, neighbour)).copied().collect();
        let neighbours = &near[..];
        let at = own.motion.position;
        if at.norm() > MAX_DISTANCE_M || own.motion.velocity.norm() > MAX_SPEED_M_S {
            return Vec2::zeros();
        }
        let broadcast = Vec2::new(features[1], features[2]);
        let preferred = limit_to_cruising(self.yielding(own, broadcast, neighbours));
        let (sin, cos) = libm::sincosf(-BEAR_RIGHT_RAD);
        let preferred = Vec2::new(cos * preferred.x - sin * preferred.y, sin * preferred.x + cos * preferred.y);
        let agent = |position: Vec2, velocity: Vec2, radius_m: f32, share: f32| Agent {
            position: to_glam(position),
            velocity: to_glam(velocity),
            radius: radius_m + self.share * NEIGHBOUR_MARGIN_M,
            avoidance_responsibility: share,
        };
        let period_s = INTERFACE.period.as_secs() as f32;
        let others = neighbours.iter().map(|neighbour| {
            let Motion { position, velocity } = neighbour.motion;
            let (assumed_velocity, share) = assumed_motion(broadcast, neighbour, self.share);
            let mut now = position + velocity * neighbour.age.as_secs() as f32;
            let closing = own.motion.velocity - assumed_velocity;
            if now == at || is_undirected(closing - (now - at) / period_s) {
                // The library would draw the direction in which to avoid from an unseeded generator.
                now.x += NEIGHBOUR_MARGIN_M;
            }
            Cow::Owned(agent(now, assumed_velocity, neighbour.features[0], share))
        });
        let movers = self.arena.movers.iter().flat_map(|mover| {
            let (now, radius_m) = mover.disc(own.elapsed);
            let (then, _) = mover.disc(own.elapsed + Span::from_secs(f64::from(HORIZON_S)));
            // One that turns within the horizon is also avoided as if it were on its way after the turn already.
            let turned = Motion { position: then.position - then.velocity * HORIZON_S, ..then };
            let ways = [Some(now), (then.velocity != now.velocity).then_some(turned)];
            // It gives no way: the robot does all of the avoidance.
            ways.into_iter().flatten().map(move |way| (way, radius_m))
        });
        let movers = movers.map(|(way, radius_m)| Cow::Owned(agent(way.position, way.velocity, radius_m, 0.0)));
        let others: Vec<Cow<Agent>> = others.chain(movers).collect();
        let obstacles: Vec<Cow<Obstacle>> = self.obstacles.iter().map(Cow::Borrowed).collect();
        let velocity = agent(at, own.motion.velocity, self.arena.robot_radius_m, 1.0).compute_avoiding_velocity(
            &others,
            &obstacles,
            to_glam(preferred),
            SPEED_M_S,
            period_s,
            &AvoidanceOptions {
                obstacle_margin: self.arena.robot_radius_m + self.share * WALL_MARGIN_M,
                time_horizon: HORIZON_S,
                obstacle_time_horizon: WALL_HORIZON_S,
            },
        );
        route::safe_command(&self.arena, &own.motion, Vec2::new(velocity.x, velocity.y), period_s)
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use crate::random::Seed;
    use crate::scenario::{Settings, build};

    fn passage() -> Arena {
        build("passage", &Settings::default()).unwrap().arena().clone()
    }

    #[test]
    fn a_preferred_velocity_encodes_the_length_of_the_remaining_path() {
        for distance in [0.0, 0.05, 0.1, 0.5, 3.0, 6.0] {
            let decoded = remaining_path(approach(Vec2::new(distance, 0.0)));
            assert!((decoded - distance).abs() < 1e-4, "{decoded} for {distance}");
        }
        assert!((limit_to_cruising(Vec2::new(3.0, 4.0)).norm() - SPEED_M_S).abs() < 1e-6);
    }

    #[test]
    fn a_robot_at_its_goal_gives_way_and_one_underway_does_not() {
        let (at_goal, underway) = (Vec2::zeros(), approach(Vec2::new(2.0, 0.0)));
        let assumed = |own: &Vec2, other: Vec2| {
            let (motion, features) = (Motion::at_rest(Vec2::zeros()), [0.25, other.x, other.y]);
            assumed_motion(*own, &Neighbour { motion, features: &features, age: Span::ZERO }, 1.0)
        };
        assert!(assumed(&at_goal, underway).1 < 1.0 && assumed(&at_goal, underway).0.x > 0.0);
        assert!(assumed(&underway, at_goal).1 > 1.0 && assumed(&underway, at_goal).0 == Vec2::zeros());
        assert_eq!(assumed(&underway, underway).1, 1.0);
    }

    #[test]
    fn a_robot_clears_the_mouth_sideways_and_never_into_the_bottleneck() {
        let orca = Orca::new(&passage());
        let portal = orca.arena.portals[0];
        let crossing = Crossing { entry: portal.far, exit: portal.near };
        let own = Observation::new(Motion::at_rest(Vec2::new(-0.2, -0.4)), Vec2::new(-0.05, -0.46));
        let away = orca.clear_mouth(&own, crossing).expect("it stands in the mouth");
        assert!(away.x < 0.0 && away.y <= 0.0);
    }

    #[test]
    fn robots_that_would_be_at_one_place_a_step_later_avoid_each_other_equally_each_time() {
        let period_s = INTERFACE.period.as_secs() as f32;
        let underway = approach(Vec2::new(2.0, 0.0));
        let features = [0.16, underway.x, underway.y];
        let mut random = Seed::of_run(7).stream("meetings");
        for _ in 0..1000 {
            // They overlap, and their relative velocity is just their distance in a step.
            let at = Vec2::new(0.5, -1.5);
            let other = at + Vec2::new(random.random_range(-0.05..0.05), random.random_range(-0.05..0.05));
            let own = Observation::new(Motion { position: at, velocity: (other - at) / period_s }, Vec2::new(1.0, 1.5));
            let neighbour = Neighbour { motion: Motion::at_rest(other), age: Span::ZERO, features: &features };
            let act = || Orca::new(&passage()).act(&own, &features, &[neighbour], &mut Seed::of_run(1).stream("none"));
            assert_eq!(act(), act(), "{other:?}");
        }
    }
}
