//! Conversion of a wanted velocity to one that a RoboMaster's chassis can follow: axes, limits and smallest speeds.

use super::protocol::ChassisSpeed;
use murmurate::messages::geometry::{Planar, Vec2, toward_zero};
use murmurate::messages::local::BodyTwist;

/// Smallest speed that the robot follows \[m/s\]. At lower commanded speeds it turns at random (RoboMaster-SDK#11).
const LEAST_M_S: f32 = 0.1;
/// Smallest yaw rate that is sent \[degrees/s\]. The robot ignored yaw rates up to 1 degree/s (RoboMaster-SDK#11).
const LEAST_YAW_DEG_S: f32 = 1.5;

/// Limits of the velocities that are sent to a RoboMaster's chassis, and the grid to which they are rounded.
#[derive(Clone, Copy, Debug)]
pub struct Chassis {
    /// Largest speed that the chassis is commanded \[m/s\].
    pub speed_m_s: f32,
    /// Largest yaw rate that the chassis is commanded \[rad/s\].
    pub yaw_rate_rad_s: f32,
    /// Step to whose multiples the speed along each axis is rounded \[m/s\]; zero for no rounding.
    pub(crate) step_m_s: f32,
}

impl Chassis {
    /// Returns the velocity that the chassis can follow, in the chassis' own axes, nearest to the wanted `twist`, a
    /// motion in the robot's own frame; `None` to stand. Each speed is rounded to the grid, to zero below half a step.
    /// Without a grid, a speed below 0.1 m/s becomes 0 or 0.1 m/s in its direction. A yaw rate below 1.5 degrees/s
    /// becomes 0 or 1.5. A velocity that is not finite gives `None`.
    pub fn follow(&self, twist: &BodyTwist) -> Option<ChassisSpeed> {
        let wanted = Vec2::new(twist.forward, twist.left).capped(self.speed_m_s);
        let mut yaw = twist.yaw_rate.clamp(-self.yaw_rate_rad_s, self.yaw_rate_rad_s).to_degrees();
        if f64::from(yaw).abs().to_radians() > f64::from(self.yaw_rate_rad_s) {
            yaw = toward_zero(yaw);
        }
        if !(wanted.norm_squared() + yaw * yaw).is_finite() {
            return None;
        }
        let planar = if self.step_m_s > 0.0 { self.on_grid(wanted) } else { at_least(wanted) };
        let z = if yaw.abs() < LEAST_YAW_DEG_S / 2.0 { 0.0 } else { -yaw.signum() * yaw.abs().max(LEAST_YAW_DEG_S) };
        let stands = planar == Vec2::zeros() && z == 0.0;
        (!stands).then_some(ChassisSpeed { x: planar.x, y: -planar.y, z })
    }

    /// Returns the nearest velocity on the grid, or one nearer to zero if that is too fast.
    fn on_grid(&self, wanted: Vec2) -> Vec2 {
        let steps = |of: fn(f32) -> f32| wanted.map(|speed| of(speed / self.step_m_s));
        // Steps are decimals such as 0.1 m/s, whose nearest f32 may be larger: a speed on the grid that is the limit is
        // within it.
        let most = f64::from(self.speed_m_s) / f64::from(self.step_m_s) * (1.0 + 1e-6);
        let is_too_fast = |steps: Vec2| libm::hypot(steps.x.into(), steps.y.into()) > most;
        let mut near = steps(f32::round);
        if is_too_fast(near) {
            near = steps(|steps| (steps + 1e-4 * steps.signum()).trunc());
        }
        while is_too_fast(near) {
            let less = |steps: f32| steps - steps.signum();
            near = if near.x.abs() >= near.y.abs() {
                Vec2::new(less(near.x), near.y)
            } else {
                Vec2::new(near.x, less(near.y))
            };
        }
        near * self.step_m_s
    }
}

/// Returns `wanted` \[m/s\] with a speed that the robot follows: a speed below `LEAST_M_S` becomes `LEAST_M_S`, or zero
/// if it is below half of that.
fn at_least(wanted: Vec2) -> Vec2 {
    let speed = wanted.norm();
    if speed < LEAST_M_S / 2.0 {
        Vec2::zeros()
    } else if speed < LEAST_M_S {
        wanted * (LEAST_M_S / speed)
    } else {
        wanted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chassis(step_m_s: f32) -> Chassis {
        Chassis { speed_m_s: 0.75, yaw_rate_rad_s: 2.0, step_m_s }
    }

    fn follow(step_m_s: f32, forward: f32, left: f32, yaw_rate: f32) -> Option<[f32; 3]> {
        let speed = chassis(step_m_s).follow(&BodyTwist { forward, left, yaw_rate })?;
        Some([speed.x, speed.y, speed.z].map(|value| (value * 1000.0).round() / 1000.0))
    }

    #[test]
    fn left_and_counter_clockwise_become_negative() {
        assert_eq!(follow(0.1, 0.5, 0.3, 1f32.to_radians() * 10.0), Some([0.5, -0.3, -10.0]));
        assert_eq!(follow(0.1, -0.5, -0.3, -0.5), Some([-0.5, 0.3, 28.648]));
    }

    #[test]
    fn small_speeds_are_rounded_along_each_axis() {
        assert_eq!(follow(0.1, 0.049, -0.049, 0.0), None);
        assert_eq!(follow(0.1, 0.051, 0.16, 0.0), Some([0.1, -0.2, 0.0]));
        assert_eq!(follow(0.0, 0.03, 0.03, 0.0), None);
        assert_eq!(follow(0.0, 0.06, 0.0, 0.0), Some([0.1, 0.0, 0.0]));
        assert_eq!(follow(0.0, 0.3, 0.06, 0.0), Some([0.3, -0.06, 0.0]));
        assert_eq!(follow(0.1, 0.0, 0.0, 0.7f32.to_radians()), None);
        assert_eq!(follow(0.1, 0.0, 0.0, 0.8f32.to_radians()), Some([0.0, 0.0, -1.5]));
    }

    #[test]
    fn no_rounding_exceeds_a_limit_and_nonsense_is_standing() {
        for k in 0..2000 {
            let (angle, speed) = (k as f32 * 0.1, k as f32 * 0.001);
            let twist =
                BodyTwist { forward: speed * libm::cosf(angle), left: speed * libm::sinf(angle), yaw_rate: angle };
            let Some(speed) = chassis(0.1).follow(&twist) else { continue };
            assert!(Vec2::new(speed.x, speed.y).norm() <= 0.75 && speed.z.abs() <= 114.592, "{speed:?}");
        }
        // Limits beside the grid: the nearest velocity on it is beyond them by less than a hundredth of a step.
        for limit in [0.36, 0.3605, 0.5, 0.8, 1.0] {
            let chassis = Chassis { speed_m_s: limit, ..chassis(0.1) };
            for k in 0..10_000 {
                let (angle, speed) = (k as f32 * 0.01, limit * (1.0 + k as f32 * 1e-4));
                let (forward, left) = (speed * libm::cosf(angle), speed * libm::sinf(angle));
                let Some(sent) = chassis.follow(&BodyTwist { forward, left, yaw_rate: 0.0 }) else { continue };
                let tenths = [sent.x, sent.y].map(|axis| f64::from((axis * 10.0).round()));
                let norm = libm::hypot(tenths[0], tenths[1]) / 10.0;
                assert!(norm <= f64::from(limit) + 1e-7, "{sent:?} of {limit} m/s");
            }
        }
        assert_eq!(follow(0.1, f32::NAN, 0.0, 0.0), None);
        assert_eq!(follow(0.1, 0.5, 0.0, f32::NAN), None);
        assert_eq!(follow(0.1, f32::INFINITY, 0.0, 0.0), None);
    }
}
