//! Way out of deadlocks: a robot that its limits hold, although it wants to move, turns its aim aside.
//!
//! Filters of this kind only ever brake, so two robots that face each other, or one before a parked robot, stand for
//! good. The turned velocity still passes all limits.

use crate::messages::geometry::Vec2;

/// Smallest speed that a robot's policy has to want for the robot to count as held, which means that the safety filter
/// keeps it from moving \[m/s\]. A robot whose policy wants less is at rest by its own choice.
const AIMS_M_S: f32 = 0.1;
/// Share of the wanted speed below which a robot counts as held.
const HELD: f32 = 0.2;
/// Turn of the aim for each second in which the robot was held \[rad/s\].
const TURN_RAD_S: f32 = 0.5;
/// Largest turn of the aim \[rad\].
const MOST_RAD: f32 = 1.57;
/// Time for which a robot is held on one side before it tries the other \[s\].
const SIDE_S: f32 = 8.0;
/// Time by which the time of being held is shortened for each second in which the robot moves \[s\].
const RELEASE: f32 = 2.0;
/// Sine of the angle between aim and limited velocity above which a robot is held more on one side than on the other.
const SKEW: f32 = 0.05;

/// State of a robot's way out of deadlocks: for how long its safety limits have kept it from moving, and the side to
/// which its wanted velocity is turned.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Yielding {
    held_s: f32,
    left: bool,
}

impl Yielding {
    /// Returns the wanted velocity `aim` \[m/s\], turned aside by an angle that grows with the time for which the robot
    /// has been kept from moving, up to a right angle.
    pub fn turned(&self, aim: Vec2) -> Vec2 {
        if self.held_s <= 0.0 {
            return aim;
        }
        let angle = (self.held_s * TURN_RAD_S).min(MOST_RAD);
        let (sin, cos) = libm::sincosf(if self.left { angle } else { -angle });
        Vec2::new(cos * aim.x - sin * aim.y, sin * aim.x + cos * aim.y)
    }

    /// Records a control period of `period_s` \[s\] in which the robot wanted the velocity `aim` \[m/s\] and its limits
    /// changed it to `limited` \[m/s\].
    ///
    /// A robot that is kept from moving turns to the side to which its limits let it slide, otherwise to the right. So
    /// two robots that meet turn to different sides of the line between them.
    pub fn update(&mut self, aim: Vec2, limited: Vec2, period_s: f32) {
        let square = aim.norm_squared();
        if square < AIMS_M_S * AIMS_M_S || limited.norm_squared() > HELD * HELD * square {
            self.held_s = (self.held_s - RELEASE * period_s).max(0.0);
            return;
        }
        if self.held_s <= 0.0 {
            self.left = aim.x * limited.y - aim.y * limited.x > SKEW * square;
        }
        self.held_s += period_s;
        if self.held_s > SIDE_S {
            *self = Yielding { held_s: period_s, left: !self.left };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_is_held_turns_to_the_right_then_tries_the_left_and_is_released() {
        let (mut yielding, aim) = (Yielding::default(), Vec2::new(0.5, 0.0));
        assert_eq!(yielding.turned(aim), aim);
        (0..80).for_each(|_| yielding.update(aim, Vec2::zeros(), 0.05));
        assert!((yielding.turned(aim) - Vec2::new(0.0, -0.5)).norm() < 1e-3, "{yielding:?}");
        (0..120).for_each(|_| yielding.update(aim, Vec2::zeros(), 0.05));
        assert!(yielding.turned(aim).y > 0.3, "{yielding:?}");
        (0..40).for_each(|_| yielding.update(aim, aim, 0.05));
        assert_eq!(yielding.turned(aim), aim);
        yielding.update(aim, Vec2::new(0.0, 0.05), 0.05);
        assert!(yielding.turned(aim).y > 0.0, "it may slide to the left: {yielding:?}");
        let mut resting = Yielding::default();
        resting.update(Vec2::new(0.05, 0.0), Vec2::zeros(), 0.05);
        assert_eq!(resting, Yielding::default());
    }
}
