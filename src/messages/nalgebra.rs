//! Conversions to and from nalgebra, which many robotics crates use for points and poses.

use nalgebra::{Isometry2, Point2, Vector2};

use crate::messages::geometry::{Pose, Vec2};

impl From<Vec2> for Vector2<f32> {
    fn from(v: Vec2) -> Vector2<f32> {
        Vector2::new(v.x, v.y)
    }
}

impl From<Vector2<f32>> for Vec2 {
    fn from(v: Vector2<f32>) -> Vec2 {
        Vec2::new(v.x, v.y)
    }
}

impl From<Vec2> for Point2<f32> {
    fn from(v: Vec2) -> Point2<f32> {
        Point2::new(v.x, v.y)
    }
}

impl From<Point2<f32>> for Vec2 {
    fn from(p: Point2<f32>) -> Vec2 {
        Vec2::new(p.x, p.y)
    }
}

impl From<Isometry2<f32>> for Pose {
    fn from(pose: Isometry2<f32>) -> Pose {
        Pose { position: pose.translation.vector.into(), heading: Some(pose.rotation.angle()) }
    }
}

impl Pose {
    /// Returns the rigid transform that maps coordinates \[m\] in the robot's frame to the world frame; `None` if the
    /// heading is unknown.
    pub fn isometry(&self) -> Option<Isometry2<f32>> {
        self.heading.map(|heading| Isometry2::new(self.position.into(), heading))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_turn_what_lies_in_the_robots_frame() {
        let pose = Pose { position: Vec2::new(2.0, 1.0), heading: Some(std::f32::consts::FRAC_PI_2) };
        let transform = pose.isometry().unwrap();
        let ahead = Vec2::from(transform * Point2::from(Vec2::new(1.0, 0.0)));
        assert!((ahead - Vec2::new(2.0, 2.0)).norm() < 1e-6, "counter-clockwise, as in REP-103");
        let again = Pose::from(transform);
        assert_eq!(again.position, pose.position);
        assert!((again.heading.unwrap() - pose.heading.unwrap()).abs() < 1e-6);
        assert_eq!(Pose::default().isometry(), None, "an unknown heading is not zero");
        let v = Vec2::new(3.0, -4.0);
        assert_eq!(Vec2::from(Vector2::from(v)), v);
    }
}
