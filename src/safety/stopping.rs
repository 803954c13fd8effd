//! Stopping point of a robot: where it comes to rest if it is commanded to stand from now on.
//!
//! The model of a velocity-commanded robot is a first-order lag with limited acceleration, each axis of the world frame
//! by itself: `v' = clamp((u - v) / lag, ±a)`. Under the command zero the robot travels `lag v` if `|v| <= a lag`, and
//! else `v^2 / 2a + a lag^2 / 2`. So the stopping point `q = p + travel(v)` is at rest while the command is zero, and
//! moves at exactly the command while the acceleration is below its limit: a single integrator, whatever the lag.

use crate::messages::geometry::Vec2;

/// Least lag in the model, in periods for which a command is held. With one or two periods, robots with a lag of 0.1 s
/// or less came too near to a corner of a wall within 13 000 steps of hostile policies; with three, none did in a
/// million.
const LEAST_LAGS: f32 = 3.0;
/// Number of bisections in the search for the share of a velocity from which a robot stops within a distance.
const SHARE_BITS: i32 = 10;

/// Model of how a robot's velocity follows its commands, along each axis of the world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Time constant of the first-order lag from command to velocity \[s\], above zero.
    lag_s: f32,
    /// Largest acceleration along each axis \[m/s^2\].
    acceleration_m_s2: f32,
    /// Largest difference of a command from the velocity along each axis \[m/s\] that is not braking, as the drive with
    /// the lag above would need it.
    step_m_s: f32,
    /// Difference between command and velocity after which the robot's velocity changes within a period as much as that
    /// of a drive with the lag above does after a difference of 1; below 1 for a robot whose lag is shorter.
    effort: f32,
}

impl Model {
    /// Makes the model of a robot with the time constant `lag_s` \[s\] and the largest acceleration `acceleration_m_s2`
    /// \[m/s^2\]. A lag shorter than three times `period_s` \[s\], for which a command is held, is replaced by that,
    /// and commands differ from the velocity by so much less that the robot follows them no faster.
    /// Commands that do not brake differ from the velocity by `step_m_s` \[m/s\] at most along each axis.
    pub fn new(lag_s: f32, acceleration_m_s2: f32, period_s: f32, step_m_s: f32) -> Model {
        // Without this, a robot that brakes along one axis turns up to three times as fast as its limits allow for.
        let effort = (1.0 / LEAST_LAGS / (1.0 - libm::expf(-period_s / lag_s))).min(1.0);
        let lag_s = lag_s.max(LEAST_LAGS * period_s);
        Model { lag_s, acceleration_m_s2, step_m_s: (step_m_s / effort).min(acceleration_m_s2 * lag_s), effort }
    }

    /// Returns the time constant of the drive in the model \[s\].
    pub fn lag_s(&self) -> f32 {
        self.lag_s
    }

    /// Returns the vector \[m\] from the position of a robot that moves at `velocity` \[m/s\] to its stopping point.
    pub fn travel(&self, velocity: Vec2) -> Vec2 {
        let Model { lag_s, acceleration_m_s2: most, .. } = *self;
        velocity.map(|v| match v.abs() <= most * lag_s {
            true => v * lag_s,
            false => v.signum() * (v * v / (2.0 * most) + most * lag_s * lag_s / 2.0),
        })
    }

    /// Returns an upper bound \[m\] of how far a robot that moves at `velocity` \[m/s\] leaves the straight line to
    /// its stopping point on the way there; 0 if the acceleration stays below its limit along both axes.
    pub fn bend(&self, velocity: Vec2) -> f32 {
        // Two axes that brake at the limit until they stand, for the times k T and T, differ in the covered share of
        // their travel by (1 - k) / (1 + k) at most. Here both ends are exponential. At its first speed, r times that
        // from which the limit is reached, an axis would cover its travel in (r + 1 / r) / 2 times the lag. With the
        // ratio of these times as k, the difference is less than that: a test compares it for all speeds up to 3 m/s.
        let [x, y] = [velocity.x, velocity.y].map(|v| self.ratio(v)).map(|r| r + 1.0 / r);
        let (short, long, travel) = (x.min(y), x.max(y), self.travel(velocity));
        if short == long {
            return 0.0;
        }
        (long - short) / (long + short) * (travel.x * travel.y).abs() / travel.norm()
    }

    /// Returns `velocity` \[m/s\], shortened if need be so that a robot that moves at it for another `delay_s` \[s\]
    /// and is then commanded to stand comes to rest within `most_m` \[m\].
    pub fn stopping_within(&self, velocity: Vec2, delay_s: f32, most_m: f32) -> Vec2 {
        let distance_m = |v: Vec2| v.norm() * delay_s + self.travel(v).norm() + self.bend(v);
        let stops = |velocity: Vec2| distance_m(velocity) <= most_m;
        if stops(velocity) {
            return velocity;
        }
        let mut share = 0.0;
        for halves in 1..=SHARE_BITS {
            let more = share + 0.5_f32.powi(halves);
            if stops(velocity * more) {
                share = more;
            }
        }
        velocity * share
    }

    /// Returns the speed of the stopping point for each m/s between command and velocity.
    fn ratio(&self, v: f32) -> f32 {
        (v.abs() / (self.acceleration_m_s2 * self.lag_s)).max(1.0)
    }

    /// Returns the velocity \[m/s\] of the stopping point of a robot that moves at `velocity` and is commanded the
    /// velocity `command`, both \[m/s\].
    pub fn advance(&self, velocity: Vec2, command: Vec2) -> Vec2 {
        let most = self.acceleration_m_s2 * self.lag_s;
        let axis = |v: f32, u: f32| v + ((u - v) / self.effort).clamp(-most, most) * self.ratio(v);
        Vec2::new(axis(velocity.x, command.x), axis(velocity.y, command.y))
    }

    /// Returns the velocity \[m/s\] to command to a robot that moves at `velocity`, so that its stopping point moves at
    /// `advance`, both \[m/s\]: the inverse of the method `advance`.
    pub fn command(&self, velocity: Vec2, advance: Vec2) -> Vec2 {
        let axis = |v: f32, w: f32| v + (w - v) / self.ratio(v) * self.effort;
        Vec2::new(axis(velocity.x, advance.x), axis(velocity.y, advance.y))
    }

    /// Returns the least and the largest velocity \[m/s\], along one axis, that the stopping point of a robot can have
    /// under its next command if the robot moves at `v` \[m/s\] along the axis. Zero is between them.
    pub fn reach(&self, v: f32) -> (f32, f32) {
        let step = self.step_m_s * self.ratio(v);
        // Braking at the largest acceleration keeps the stopping point of a fast robot where it is, and no more.
        let most = self.acceleration_m_s2 * self.lag_s * self.ratio(v);
        ((v.min(0.0) - step).max(v - most), (v.max(0.0) + step).min(v + most))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One millisecond of the model.
    fn moved(model: &Model, p: f32, v: f32, u: f32) -> (f32, f32) {
        let most = model.acceleration_m_s2;
        let v = v + ((u - v) / model.lag_s).clamp(-most, most) * 1e-3;
        (p + v * 1e-3, v)
    }

    #[test]
    fn a_robot_that_is_commanded_to_stand_comes_to_rest_at_its_stopping_point() {
        for (lag_s, most) in [(0.5, 1.0), (0.5, 100.0), (0.05, 1.0), (1.0, 0.3)] {
            let model = Model::new(lag_s, most, 0.05, 1.0);
            for speed in [-1.5_f32, -0.4, 0.1, 0.6, 1.5] {
                let end = model.travel(Vec2::new(speed, 0.0)).x;
                let (p, v) = (0..9000).fold((0.0, speed), |(p, v), _| moved(&model, p, v, 0.0));
                assert!((p - end).abs() < 5e-3 && v.abs() < 5e-3, "{lag_s} s, {speed} m/s: {p} m, {end} m");
            }
        }
    }

    #[test]
    fn a_velocity_is_shortened_until_the_robot_stops_in_time() {
        let model = Model::new(0.5, 1.0, 0.05, 1.0);
        let within = |x, y| model.stopping_within(Vec2::new(x, y), 0.05, 0.65);
        assert_eq!(within(0.95, 0.0), Vec2::new(0.95, 0.0), "it stops after 0.0475 + 0.57625 m");
        let (along, across) = (within(1.5, 0.0), within(-1.5, 1.5));
        assert!(along.x > 0.97 && model.travel(along).norm() + 0.05 * along.x <= 0.65, "{along:?}");
        assert!(across.x == -across.y && across.y > 0.76, "{across:?}");
        assert!(model.travel(across).norm() + 0.05 * across.norm() <= 0.65, "{across:?}");
    }

    #[test]
    fn the_way_to_the_stopping_point_stays_within_its_bend_of_the_straight_line() {
        let model = Model::new(0.5, 1.0, 0.05, 1.0);
        let (mut widest, mut loosest) = (0.0_f32, 0.0_f32);
        for (vx, vy) in (0..30).flat_map(|i| (0..30).map(move |j| (0.1 * i as f32, 0.1 * j as f32))) {
            let end = model.travel(Vec2::new(vx, vy));
            let bend = model.bend(Vec2::new(vx, vy));
            let (mut x, mut y, mut beside) = ((0.0, vx), (0.0, vy), 0.0_f32);
            for _ in 0..6000 {
                (x, y) = (moved(&model, x.0, x.1, 0.0), moved(&model, y.0, y.1, 0.0));
                beside = beside.max((x.0 * end.y - y.0 * end.x).abs() / end.norm().max(1e-6));
            }
            assert!(beside <= bend + 2e-3, "{vx}, {vy} m/s: {beside} m beside, at most {bend}");
            assert!(bend == 0.0 || vx.max(vy) > 0.5);
            (widest, loosest) = (widest.max(beside), loosest.max(bend - beside));
        }
        assert!(widest > 0.2 && loosest < 0.2, "{widest} m beside, bound looser by {loosest} m");
    }

    #[test]
    fn the_stopping_point_reaches_no_farther_than_the_drive_can_move_it() {
        for (lag_s, most, step) in [(0.5, 1.0, 2.0), (0.5, 1e3, 0.25), (0.1, 1.0, 2.0)] {
            let model = Model::new(lag_s, most, 0.05, step);
            for v in (-15..=15).map(|tenths| 0.1 * tenths as f32) {
                let (low, high) = model.reach(v);
                let at = |u: f32| model.advance(Vec2::new(v, 0.0), Vec2::new(u, 0.0)).x;
                assert!(low <= 0.0 && high >= 0.0 && at(-1e3) <= low + 1e-4 && high <= at(1e3) + 1e-4, "{v} m/s");
            }
        }
        let fast = Model::new(0.5, 1.0, 0.05, 2.0).reach(-1.2);
        assert_eq!(fast.1, 0.0, "it brakes with all that its drive has, and so has nothing for a retreat");
    }

    #[test]
    fn the_stopping_point_moves_as_predicted_and_a_command_is_found_from_that() {
        for (lag_s, most) in [(0.5_f32, 1.0_f32), (0.5, 100.0), (0.05, 1.0)] {
            let model = Model::new(lag_s, most, 0.05, 1.0);
            for (v, u) in [(0.0, 0.3), (0.4, -0.2), (1.2, 1.4), (-1.2, 0.0), (1.2, 0.9)] {
                let at = |p: f32, v: f32| p + model.travel(Vec2::new(v, 0.0)).x;
                let (mut p, mut now) = (0.0, v);
                (0..10).for_each(|_| (p, now) = moved(&model, p, now, u));
                let speed = (at(p, now) - at(0.0, v)) / 0.01;
                let predicted = model.advance(Vec2::new(v, 0.0), Vec2::new(u, 0.0)).x;
                assert!((speed - predicted).abs() < 0.02 + 0.01 * predicted.abs(), "{speed}, {predicted}");
                if (u - v).abs() < most * lag_s {
                    let command = model.command(Vec2::new(v, 0.0), Vec2::new(predicted, 0.0)).x;
                    assert!((command - u).abs() < 1e-5);
                }
            }
        }
    }
}
