//! The way through an arena: which point to steer for next, who goes first through a bottleneck, and which
//! commands keep clear of the walls. Geometry and kinematics only, used by the scripted policy.

use crate::messages::geometry::{Motion, Vec2};
use crate::scenario::{Arena, Portal};

/// Extra room between a robot's hull and a block on a planned way \[m\].
const MARGIN_M: f32 = 0.03;
/// Who heads for a point heads there within this cosine (6 degrees): what is said is a little older than what
/// is seen.
const AIMS_COS: f32 = 0.995;
/// Rounding of a way's length that has been told as a velocity \[m\].
const SLACK_M: f32 = 0.05;

/// Acceleration that a robot reaches along each axis \[m/s^2\], for what it can still brake in time.
const ACCELERATION_M_S2: f32 = 1.0;
/// Hull to wall that no command gives up \[m\]: rounding, and a command that comes into force a little late.
const TOUCH_MARGIN_M: f32 = 0.01;
/// Periods within which a robot must have stopped: more than from any speed that a sound reading tells of.
const MAX_BRAKING_PERIODS: u32 = 200;
/// Commands that are tried to each side of the present velocity, along each axis, when the wanted one is unsafe.
const WINDOW: i8 = 4;

/// Where to steer for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Leg {
    /// Straight to the destination.
    Direct,
    /// Through a bottleneck.
    Through(Crossing),
}

/// A way through a bottleneck, from one mouth to the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// The mouth on this side \[m\].
    pub entry: Vec2,
    /// The mouth on the other side \[m\].
    pub exit: Vec2,
}

impl Crossing {
    /// The point to steer for from `at` \[m\]: the exit once nothing stands before it, else the entry.
    pub fn aim(&self, arena: &Arena, at: Vec2) -> Vec2 {
        if is_free(arena, at, self.exit) { self.exit } else { self.entry }
    }

    /// How far it is to the middle of the bottleneck \[m\]; negative behind it.
    pub fn ahead(&self, arena: &Arena, at: Vec2) -> f32 {
        let half = (self.exit - self.entry).norm() / 2.0;
        let along = (self.exit - self.entry) / (2.0 * half);
        if is_free(arena, at, self.exit) {
            (self.exit - at).dot(&along) - half
        } else {
            (self.entry - at).norm() + half
        }
    }

    /// The length of the way from `at` through here to `to` \[m\].
    pub fn way(&self, arena: &Arena, at: Vec2, to: Vec2) -> f32 {
        let aim = self.aim(arena, at);
        (aim - at).norm() + (self.exit - aim).norm() + (to - self.exit).norm()
    }

    /// Whether a robot at `at` that sets out in the direction `heading` (a unit vector), with `way_m` before it,
    /// is about to pass here: by way of the mouths, or straight through to where it is bound.
    pub fn is_passed(&self, arena: &Arena, at: Vec2, heading: Vec2, way_m: f32) -> bool {
        let (along, middle) = (self.exit - self.entry, (self.entry + self.exit) / 2.0);
        if (self.exit - at).dot(&along) <= 0.0 {
            return false;
        }
        let aim = self.aim(arena, at);
        let aims = (aim - at).dot(&heading) > AIMS_COS * (aim - at).norm();
        // A robot with less before it has its destination on this side, by chance in the same direction.
        let goes_on = way_m > (aim - at).norm() + (self.exit - aim).norm() - SLACK_M;
        let end = at + heading * way_m;
        let parts = (at - middle).dot(&along) < 0.0 && (end - middle).dot(&along) > 0.0;
        aims && goes_on || parts && is_free(arena, at, end)
    }
}

/// Whether the straight way between two points is free for a robot.
pub fn is_free(arena: &Arena, from: Vec2, to: Vec2) -> bool {
    // A robot that is nearer to a block than the margin must still be able to leave it.
    let margin = |block_distance: f32| (arena.robot_radius_m + MARGIN_M).min(block_distance - 1e-3);
    arena.keep_outs.iter().all(|block| !block.blocks(from, to, margin(block.distance(from).min(block.distance(to)))))
}

/// The next leg of the way from `from` to `to` \[m\].
pub fn leg(arena: &Arena, from: Vec2, to: Vec2) -> Leg {
    if is_free(arena, from, to) {
        return Leg::Direct;
    }
    let length = |crossing: &Crossing| (crossing.entry - from).norm() + (to - crossing.exit).norm();
    let crossings = arena.portals.iter().map(|&Portal { near, far }| {
        let (a, b) = (Crossing { entry: near, exit: far }, Crossing { entry: far, exit: near });
        if length(&a) <= length(&b) { a } else { b }
    });
    match crossings.min_by(|a, b| length(a).total_cmp(&length(b))) {
        Some(crossing) => Leg::Through(crossing),
        None => Leg::Direct,
    }
}

/// Whether a robot that takes this command for one period, and then brakes, stays clear of all blocks. Its
/// acceleration is limited along each axis, so it does not stay on a line while it brakes.
fn is_safe(arena: &Arena, own: &Motion, command: Vec2, period_s: f32) -> bool {
    let step = ACCELERATION_M_S2 * period_s;
    let toward = |velocity: Vec2, wanted: Vec2| velocity + (wanted - velocity).map(|axis| axis.clamp(-step, step));
    let (mut at, mut velocity) = (own.position, toward(own.velocity, command));
    let limit = arena.robot_radius_m + TOUCH_MARGIN_M;
    let border = outside(arena, at).max(0.0);
    for _ in 0..MAX_BRAKING_PERIODS {
        at += velocity * period_s;
        // Who is too near already, in whatever way he got there, must not come nearer.
        if arena.clearance(at) < limit.min(arena.clearance(own.position)) || outside(arena, at) > border {
            return false;
        }
        if velocity == Vec2::zeros() {
            return true;
        }
        velocity = toward(velocity, Vec2::zeros());
    }
    false
}

/// How far a point is outside the ground \[m\]; negative inside.
fn outside(arena: &Arena, point: Vec2) -> f32 {
    (point.abs() - arena.half_extent).max()
}

/// The command nearest to the wanted one after which a robot can still brake before it touches a block.
pub fn braked(arena: &Arena, own: &Motion, wanted: Vec2, period_s: f32) -> Vec2 {
    if is_safe(arena, own, wanted, period_s) {
        return wanted;
    }
    let reach = ACCELERATION_M_S2 * period_s;
    let side = -WINDOW..=WINDOW;
    let window = side.clone().flat_map(|x| side.clone().map(move |y| Vec2::new(x as f32, y as f32)));
    let commands = window.map(|offset| own.velocity + offset * (reach / WINDOW as f32));
    // To brake has been safe when the last command was chosen, and is what is left.
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
    fn the_way_to_the_other_side_leads_through_the_gap() {
        let passage = build("passage", &Settings::default()).unwrap();
        let arena = passage.arena();
        let (from, to) = (Vec2::new(1.5, -1.5), Vec2::new(1.0, 1.5));
        let Leg::Through(crossing) = leg(arena, from, to) else { panic!("a wall stands between") };
        assert!(crossing.entry.y < 0.0 && crossing.exit.y > 0.0);
        assert_eq!(crossing.aim(arena, from), crossing.entry);
        assert_eq!(crossing.aim(arena, Vec2::new(0.0, -0.5)), crossing.exit);
        assert!(crossing.ahead(arena, from) > crossing.ahead(arena, Vec2::new(0.0, -0.5)));
        assert_eq!(leg(arena, from, Vec2::new(-1.5, -1.5)), Leg::Direct);
    }

    #[test]
    fn who_passes_is_told_from_who_only_heads_that_way() {
        let passage = build("passage", &Settings::default()).unwrap();
        let arena = passage.arena();
        let (from, to) = (Vec2::new(1.5, -1.5), Vec2::new(1.0, 1.5));
        let Leg::Through(crossing) = leg(arena, from, to) else { panic!("a wall stands between") };
        let back = Crossing { entry: crossing.exit, exit: crossing.entry };
        let heading = (crossing.entry - from).normalize();
        let way_m = crossing.way(arena, from, to);
        assert!(crossing.is_passed(arena, from, heading, way_m) && !back.is_passed(arena, from, heading, way_m));
        assert!(!crossing.is_passed(arena, from, heading, 1.0), "its destination lies before the entry");
        assert!(!crossing.is_passed(arena, from, -heading, way_m), "it goes the other way");
        assert!(crossing.is_passed(arena, Vec2::new(0.1, -1.0), Vec2::y(), 3.0), "it sees its destination");
    }

    #[test]
    fn whatever_is_wanted_no_wall_is_touched_and_the_ground_is_not_left() {
        let passage = build("passage", &Settings::default()).unwrap();
        let arena = passage.arena();
        // At corners, into the gap, along the wall and off the ground, from speed and at random angles.
        for (step, start) in [(0.3, Vec2::new(0.0, -1.5)), (0.7, Vec2::new(1.2, -0.6)), (1.1, Vec2::new(-1.9, 2.9))] {
            let mut plant = kinematic::build(arena, &Physics::published(arena), &[start], Seed::of_run(0));
            for tick in 0..4000 {
                let state = plant.states()[0];
                assert!(!state.contacts.wall && outside(arena, state.motion.position) <= 1e-4);
                let (sin, cos) = ((tick / 37) as f32 * step).sin_cos();
                let aim = if tick % 500 < 250 { Vec2::new(cos, sin) * 1.5 } else { -state.motion.position };
                plant.drive(0, braked(arena, &state.motion, aim, 0.05));
                plant.advance();
            }
        }
    }
}
