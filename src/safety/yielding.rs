//! Way out of deadlocks: a robot that its limits hold, although it wants to move, turns its aim aside, and a robot at
//! rest gives way to one that stands close by.
//!
//! Filters of this kind only ever brake, so two robots that face each other, or one before parked robots, stand for
//! good. The changed velocity still passes all limits.

use crate::messages::geometry::{Motion, Vec2};

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

/// Distance beyond the least one within which a neighbour that stands is close \[m\]. A robot that wants to pass is
/// kept at the least distance and a few centimetres for the age of messages.
const CLOSE_M: f32 = 0.09;
/// Speed below which a neighbour stands \[m/s\].
const STANDS_M_S: f32 = 0.1;
/// Time over which a robot's aim is averaged to tell whether it is at rest by its own choice \[s\]. The aim of a policy
/// that holds a robot in place may alternate from step to step.
const MEAN_S: f32 = 0.5;
/// Time for which a robot at rest has a neighbour close by before it gives way \[s\].
const PATIENCE_S: f32 = 0.5;
/// Time for which it gives way \[s\].
const GIVES_S: f32 = 1.5;
/// Speed at which it gives way \[m/s\].
const GIVES_M_S: f32 = 0.25;

/// Nearest neighbour of those that stand close to a robot.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Close(Option<(f32, Vec2)>);

impl Close {
    /// Counts a neighbour with the motion `other`, of a robot at `position` \[m\], if it stands within `least_m` \[m\],
    /// the least distance, and a margin.
    pub(crate) fn count(&mut self, position: Vec2, other: &Motion, least_m: f32) {
        let away = position - other.position;
        let apart_m = away.norm();
        if apart_m < self.0.map_or(least_m + CLOSE_M, |(nearest_m, _)| nearest_m)
            && other.velocity.norm_squared() < STANDS_M_S * STANDS_M_S
        {
            self.0 = away.try_normalize(f32::EPSILON).map(|away| (apart_m, away));
        }
    }
}

/// State of a robot's way out of deadlocks: for how long its safety limits have kept it from moving, the side to which
/// its wanted velocity is turned, and how it gives way to a neighbour.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Yielding {
    held_s: f32,
    left: bool,
    /// Mean of the last aims \[m/s\].
    mean: [f32; 2],
    /// For how long a neighbour has stood close to the robot at rest \[s\]; while the robot gives way, for how long.
    close_s: f32,
    /// Direction away from the neighbour that the robot gives way to; `None` if it does not.
    gives: Option<[f32; 2]>,
}

impl Yielding {
    /// Returns the velocity to aim at \[m/s\] in place of the wanted `aim`: that of giving way, or the wanted one,
    /// turned aside by an angle that grows with the time for which the robot has been kept from moving, up to a right
    /// angle.
    pub(crate) fn turned(&self, aim: Vec2) -> Vec2 {
        if let Some([x, y]) = self.gives {
            return Vec2::new(x, y) * GIVES_M_S;
        }
        if self.held_s <= 0.0 {
            return aim;
        }
        let angle = (self.held_s * TURN_RAD_S).min(MOST_RAD);
        let (sin, cos) = libm::sincosf(if self.left { angle } else { -angle });
        Vec2::new(cos * aim.x - sin * aim.y, sin * aim.x + cos * aim.y)
    }

    /// Records a control period of `period_s` \[s\] in which the robot wanted the velocity `aim` \[m/s\], its limits
    /// changed it to `limited` \[m/s\], and `close` was the neighbour that stood close to it.
    ///
    /// A robot that is kept from moving turns to the side to which its limits let it slide, otherwise to the right. So
    /// two robots that meet turn to different sides of the line between them.
    pub(crate) fn update(&mut self, aim: Vec2, limited: Vec2, close: Close, period_s: f32) {
        let square = aim.norm_squared();
        let mean = Vec2::from(self.mean) + (aim - Vec2::from(self.mean)) * (period_s / MEAN_S).min(1.0);
        (self.mean, self.close_s) = ([mean.x, mean.y], self.close_s + period_s);
        match (self.gives, close.0) {
            (Some(_), _) if self.close_s < GIVES_S => return,
            (None, Some((_, away))) if mean.norm_squared() < AIMS_M_S * AIMS_M_S => {
                if self.close_s > PATIENCE_S {
                    *self = Yielding { mean: self.mean, gives: Some([away.x, away.y]), ..Yielding::default() };
                    return;
                }
            }
            _ => (self.gives, self.close_s) = (None, 0.0),
        }
        if square < AIMS_M_S * AIMS_M_S || limited.norm_squared() > HELD * HELD * square {
            self.held_s = (self.held_s - RELEASE * period_s).max(0.0);
            return;
        }
        if self.held_s <= 0.0 {
            self.left = aim.x * limited.y - aim.y * limited.x > SKEW * square;
        }
        self.held_s += period_s;
        if self.held_s > SIDE_S {
            *self = Yielding { held_s: period_s, left: !self.left, ..*self };
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
        (0..80).for_each(|_| yielding.update(aim, Vec2::zeros(), Close::default(), 0.05));
        assert!((yielding.turned(aim) - Vec2::new(0.0, -0.5)).norm() < 1e-3, "{yielding:?}");
        (0..120).for_each(|_| yielding.update(aim, Vec2::zeros(), Close::default(), 0.05));
        assert!(yielding.turned(aim).y > 0.3, "{yielding:?}");
        (0..40).for_each(|_| yielding.update(aim, aim, Close::default(), 0.05));
        assert_eq!(yielding.turned(aim), aim);
        yielding.update(aim, Vec2::new(0.0, 0.05), Close::default(), 0.05);
        assert!(yielding.turned(aim).y > 0.0, "it may slide to the left: {yielding:?}");
        let mut resting = Yielding::default();
        resting.update(Vec2::new(0.05, 0.0), Vec2::zeros(), Close::default(), 0.05);
        assert_eq!(resting.turned(aim), aim);
    }

    #[test]
    fn a_robot_at_rest_gives_way_for_a_time_to_one_that_stands_close_and_to_no_other() {
        let close = |x: f32, speed_m_s: f32| {
            let mut close = Close::default();
            close.count(Vec2::zeros(), &Motion::at_rest(Vec2::new(0.0, 0.48)), 0.4);
            let other = Motion { position: Vec2::new(x, 0.0), velocity: Vec2::new(speed_m_s, 0.0) };
            close.count(Vec2::zeros(), &other, 0.4);
            close
        };
        let standing = close(0.45, 0.0);
        assert_eq!((close(0.5, 0.0), close(0.45, 0.2)), (close(9.0, 0.0), close(9.0, 0.0)), "too far, or it moves");
        // What a policy wants that holds its robot in place.
        let (mut yielding, rest) = (Yielding::default(), [Vec2::new(0.15, 0.0), Vec2::new(-0.15, 0.0)]);
        let mut given = Vec::new();
        for step in 0..50 {
            given.push(yielding.turned(rest[step % 2]));
            yielding.update(rest[step % 2], rest[step % 2], standing, 0.05);
        }
        let away = Vec2::new(-GIVES_M_S, 0.0);
        assert_eq!((given[8], given[12], given[38]), (rest[0], away, away), "it waits, and gives way to the nearest");
        assert_eq!(given[44], rest[0], "for a time");
        let mut driving = Yielding::default();
        (0..40).for_each(|_| driving.update(Vec2::new(0.5, 0.0), Vec2::new(0.4, 0.0), standing, 0.05));
        assert_eq!(driving.turned(away), away, "a robot that wants to move goes on");
    }
}
