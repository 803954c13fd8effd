//! Motion of a simulated robot by its chassis: from velocities of the point that its policy commands to positions of
//! its centre and headings.
//!
//! The commanded point of a differential drive lies ahead of the axle. Over a step it moves at a constant velocity, and
//! the axle trails behind it on a tractrix. Let `u` be the speed of the point, `d` its distance ahead, and `a` the
//! angle from the heading to the velocity. Then `a' = -(u / d) sin a`, and so `tan(a / 2)` decays with `exp(-u t / d)`:
//! the step is exact. The simulated drive therefore follows its heading without delay, whereas a real one follows each
//! measured heading (`actors::body`).

use crate::chassis::{Chassis, DriveKind};
use crate::messages::geometry::{Motion, Vec2, wrapped};

/// Speed of the commanded point below which a robot counts as standing still \[m/s\]. Its square is far above the
/// smallest f32.
const STANDS_M_S: f32 = 1e-6;

/// Chassis, heading, yaw rate and velocity of one simulated robot, which turn velocities of its commanded point into
/// motions of its centre. The commanded point is the centre of a holonomic robot, or a point ahead of the axle of a
/// differential drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheels {
    chassis: Chassis,
    heading: f32,
    yaw_rate: f32,
    /// Velocity of the centre at the end of the last step, if nothing was in the way \[m/s\], world frame.
    velocity: Vec2,
}

impl Wheels {
    /// Makes the wheels of a robot with this `chassis`, at rest. `heading` is the initial heading of a differential
    /// drive \[rad\], counter-clockwise from the x axis of the world frame. A holonomic robot ignores `heading`: it has
    /// the heading that its chassis holds, or zero.
    pub fn new(chassis: Chassis, heading: f32) -> Wheels {
        let mut wheels = Wheels { chassis, heading: 0.0, yaw_rate: 0.0, velocity: Vec2::zeros() };
        wheels.place(heading);
        wheels
    }

    /// Puts the robot at rest. A differential drive takes `heading` \[rad\], counter-clockwise from the x axis of the
    /// world frame. A holonomic robot ignores `heading`: it has the heading that its chassis holds, or zero.
    pub fn place(&mut self, heading: f32) {
        self.heading = match self.chassis.drive {
            DriveKind::Holonomic => self.chassis.held_rad.map_or(0.0, |held| wrapped(f64::from(held)) as f32),
            DriveKind::Differential => wrapped(f64::from(heading)) as f32,
        };
        (self.yaw_rate, self.velocity) = (0.0, Vec2::zeros());
    }

    /// Returns the robot's chassis: its kind of drive and its limits.
    pub fn chassis(&self) -> &Chassis {
        &self.chassis
    }

    /// Returns the robot's heading \[rad\], counter-clockwise from the x axis of the world frame, within -pi and pi.
    pub fn heading(&self) -> f32 {
        self.heading
    }

    /// Returns the robot's yaw rate \[rad/s\], counter-clockwise.
    pub fn yaw_rate(&self) -> f32 {
        self.yaw_rate
    }

    /// Sets the robot's `heading` \[rad\], counter-clockwise from the x axis, and its `yaw_rate` \[rad/s\], to continue
    /// from a saved state.
    pub fn restore(&mut self, heading: f32, yaw_rate: f32) {
        (self.heading, self.yaw_rate) = (heading, yaw_rate);
    }

    /// Returns position \[m\] and velocity \[m/s\] of the robot's commanded point, from those of its centre, `centre`;
    /// world frame. The commanded point of a differential drive lies ahead of the axle; that of a holonomic robot is
    /// the centre.
    pub fn point(&self, centre: &Motion) -> Motion {
        self.chassis.point_motion(centre, self.heading, self.yaw_rate)
    }

    /// Returns the velocity \[m/s\], world frame, that the robot's centre has at the end of the last step if no
    /// obstacle blocked it.
    pub fn velocity(&self) -> Vec2 {
        self.velocity
    }

    /// Turns the robot in one step of duration `step_s` \[s\]. Its commanded point moves at `velocity` \[m/s\], world
    /// frame, reduced to the limits of the chassis. Returns the mean velocity of the robot's centre over the step
    /// \[m/s\], world frame.
    ///
    /// The limits hold for the motion at the beginning and for the motion at the end of the step.
    pub fn drive(&mut self, velocity: Vec2, step_s: f32) -> Vec2 {
        if self.chassis.drive == DriveKind::Holonomic {
            self.velocity = self.chassis.limited(velocity, self.heading);
            return self.velocity;
        }
        let before = self.heading;
        let mut point = self.chassis.limited(velocity, before);
        let unlimited = self.trailed(point, step_s);
        let at_end = self.chassis.limited(point, unlimited);
        self.heading = if at_end == point { unlimited } else { self.trailed(at_end, step_s) };
        point = at_end;
        let ahead = self.chassis.ahead(self.heading);
        let d = self.chassis.point_ahead_m;
        // Forward speed and yaw rate at the end, as in `Chassis::twist`.
        let velocity = ahead * (point.dot(&ahead) / (d * d));
        let yaw_rate = (ahead.x * point.y - ahead.y * point.x) / (d * d);
        (self.velocity, self.yaw_rate) = self.chassis.settled(velocity, yaw_rate);
        point - (ahead - self.chassis.ahead(before)) / step_s
    }

    /// Returns the heading \[rad\] after a step of `step_s` \[s\] in which the commanded point moves at the velocity
    /// `point` \[m/s\], world frame.
    fn trailed(&self, point: Vec2, step_s: f32) -> f32 {
        let speed = point.norm();
        if speed < STANDS_M_S {
            return self.heading;
        }
        let (sin, cos) = libm::sincosf(self.heading);
        let (along, across) = (cos * point.x + sin * point.y, cos * point.y - sin * point.x);
        let decay = libm::expf(-speed * step_s / self.chassis.point_ahead_m);
        // Two forms of the tangent of half the angle, each where it is well conditioned.
        let half = match along >= 0.0 {
            true => libm::atan2f(decay * across, speed + along),
            false => libm::atan2f(decay * (speed - along), across),
        };
        wrapped(f64::from(libm::atan2f(point.y, point.x)) - 2.0 * f64::from(half)) as f32
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::chassis::Settings;

    const STEP_S: f32 = 0.05;

    fn settings() -> Settings {
        Settings { drive: Some(DriveKind::Differential), point_ahead_m: Some(0.1), ..Settings::default() }
    }

    fn wheels(settings: &Settings, heading: f32) -> Wheels {
        Wheels::new(settings.chassis().unwrap(), heading)
    }

    /// Drives for a step; returns the state of the centre after it.
    fn driven(wheels: &mut Wheels, centre: Motion, velocity: Vec2) -> Motion {
        let mean = wheels.drive(velocity, STEP_S);
        Motion { position: centre.position + mean * STEP_S, velocity: wheels.velocity() }
    }

    #[test]
    fn the_point_moves_as_commanded_and_the_centre_trails_behind_it() {
        for direction in [0.0_f32, 0.4, FRAC_PI_2, 2.0, 3.1, -0.7, -FRAC_PI_2, -2.5] {
            for speed in [0.02_f32, 0.3, 1.5] {
                let wanted = Vec2::new(direction.cos(), direction.sin()) * speed;
                let mut wheels = wheels(&settings(), 0.0);
                let mut centre = Motion::default();
                for step in 1..=60 {
                    let before = centre;
                    centre = driven(&mut wheels, centre, wanted);
                    let point = wheels.point(&centre);
                    let due = Vec2::new(0.1, 0.0) + wanted * (step as f32 * STEP_S);
                    assert!((point.position - due).norm() < 2e-5, "{direction} rad, {speed} m/s: {point:?}");
                    assert!((point.velocity - wanted).norm() < 2e-5, "{direction} rad, {speed} m/s: {point:?}");
                    let (sin, cos) = wheels.heading().sin_cos();
                    let sideways = cos * centre.velocity.y - sin * centre.velocity.x;
                    assert!(sideways.abs() < 1e-5, "wheels do not slip: {sideways}");
                    assert!((centre.position - before.position).norm() <= speed * STEP_S + 1e-5, "it trails");
                }
                let travelled = speed * 60.0 * STEP_S;
                let off = wrapped(f64::from(direction - wheels.heading())).abs() as f32;
                assert!(travelled < 0.5 || off < 0.02, "it heads where the point goes: {off} rad off");
            }
        }
    }

    #[test]
    fn the_step_is_the_limit_of_many_small_motions_in_the_robots_own_frame() {
        for (heading, wanted) in
            [(1.0_f32, Vec2::new(0.9, -0.2)), (3.0, Vec2::new(0.4, 0.3)), (-0.4, Vec2::new(-1.0, 1.0))]
        {
            let mut wheels = wheels(&settings(), heading);
            let exact = driven(&mut wheels, Motion::default(), wanted);
            let (mut at, mut angle) = ((0.0_f64, 0.0_f64), f64::from(heading));
            let chassis = settings().chassis().unwrap();
            for _ in 0..50_000 {
                let twist = chassis.twist(wanted, Some(angle as f32)).unwrap();
                let (sin, cos) = angle.sin_cos();
                at.0 += cos * f64::from(twist.forward) * 1e-6;
                at.1 += sin * f64::from(twist.forward) * 1e-6;
                angle += f64::from(twist.yaw_rate) * 1e-6;
            }
            let off = (exact.position - Vec2::new(at.0 as f32, at.1 as f32)).norm();
            assert!(off < 2e-5, "{off} m");
            assert!(wrapped(angle - f64::from(wheels.heading())).abs() < 2e-4, "{angle} and {}", wheels.heading());
        }
    }

    #[test]
    fn a_robot_that_is_driven_straight_back_keeps_its_heading() {
        let mut back = wheels(&settings(), FRAC_PI_2);
        let mut centre = Motion::default();
        for _ in 0..5 {
            centre = driven(&mut back, centre, Vec2::new(0.0, -0.2));
        }
        assert!((centre.position - Vec2::new(0.0, -0.05)).norm() < 1e-4, "{centre:?}");
        assert!((back.heading() - FRAC_PI_2).abs() < 1e-3, "{}", back.heading());
        let mut still = wheels(&settings(), PI + 0.5);
        assert_eq!(driven(&mut still, Motion::default(), Vec2::zeros()), Motion::default());
        assert!((still.heading() - (0.5 - PI)).abs() < 1e-5, "{}", still.heading());
    }

    #[test]
    fn limits_slow_the_point_and_keep_its_direction() {
        let limited = Settings { speed_m_s: Some(0.22), yaw_rate_rad_s: Some(2.8), ..settings() };
        let mut wheels = wheels(&limited, 0.0);
        let mut centre = Motion::default();
        for _ in 0..100 {
            let before = (wheels.point(&centre).position, wheels.heading());
            centre = driven(&mut wheels, centre, Vec2::new(-0.3, 0.8));
            let moved = wheels.point(&centre).position - before.0;
            assert!((moved.x / moved.y + 0.375).abs() < 1e-3, "along the command: {moved:?}");
            assert!(centre.velocity.norm() <= 0.22 + 1e-5 && wheels.yaw_rate().abs() <= 2.8 + 1e-4);
        }
        assert!((centre.velocity.norm() - 0.22).abs() < 1e-3, "at its top speed");
        let slow = Settings { speed_m_s: Some(0.5), ..Settings::default() };
        assert!(
            (Wheels::new(slow.chassis().unwrap(), 1.0).drive(Vec2::new(3.0, 4.0), STEP_S).norm() - 0.5).abs() < 1e-6
        );
    }

    #[test]
    fn the_motion_of_a_simulated_robot_keeps_to_its_limits_as_they_are_written() {
        use rand::RngExt;
        let mut stream = crate::random::Seed::of_run(5).stream("wheels");
        for robot in 0..200 {
            let mut of = |least: u16, most: u16| f64::from(stream.random_range(least..=most)) / 100.0;
            let (wheel, track, yaw) = (of(10, 60), of(10, 50), of(100, 400));
            let limited = Settings {
                wheel_speed_m_s: Some(wheel as f32),
                track_m: Some(track as f32),
                yaw_rate_rad_s: Some(yaw as f32),
                ..settings()
            };
            let mut wheels = wheels(&limited, 0.3);
            for _ in 0..100 {
                let mut axis = || stream.random_range(-1.5..1.5f32);
                wheels.drive(Vec2::new(axis(), axis()), STEP_S);
                let (velocity, turns) = (wheels.velocity(), f64::from(wheels.yaw_rate()).abs());
                let outer = libm::hypot(velocity.x.into(), velocity.y.into()) + turns * track / 2.0;
                assert!(
                    outer <= wheel && turns <= yaw,
                    "robot {robot}: {outer} of {wheel} m/s, {turns} of {yaw} rad/s"
                );
            }
        }
    }

    #[test]
    fn a_holonomic_robot_has_the_heading_that_it_holds() {
        use crate::chassis::HeadingMode;
        let held = Settings { heading: Some(HeadingMode::Hold), heading_rad: Some(1.5), ..Settings::default() };
        assert_eq!(wheels(&held, 0.3).heading(), 1.5);
        assert_eq!(wheels(&Settings::default(), 0.3).heading(), 0.0);
    }
}
