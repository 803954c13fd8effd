//! Poses as the rigid transforms of nalgebra, and back.

use nalgebra::Isometry2;

use crate::messages::geometry::Pose;

impl From<Isometry2<f32>> for Pose {
    fn from(pose: Isometry2<f32>) -> Pose {
        Pose { position: pose.translation.vector, heading: Some(pose.rotation.angle()) }
    }
}

impl Pose {
    /// Returns the rigid transform that maps coordinates \[m\] in the robot's frame to the world frame; `None` if the
    /// heading is unknown.
    pub fn isometry(&self) -> Option<Isometry2<f32>> {
        self.heading.map(|heading| Isometry2::new(self.position, heading))
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::*;
    use crate::messages::geometry::Vec2;

    #[test]
    fn poses_turn_what_lies_in_the_robots_frame() {
        let pose = Pose { position: Vec2::new(2.0, 1.0), heading: Some(std::f32::consts::FRAC_PI_2) };
        let transform = pose.isometry().unwrap();
        let ahead = (transform * Point2::new(1.0, 0.0)).coords;
        assert!((ahead - Vec2::new(2.0, 2.0)).norm() < 1e-6, "counter-clockwise, as in REP-103");
        let again = Pose::from(transform);
        assert_eq!(again.position, pose.position);
        assert!((again.heading.unwrap() - pose.heading.unwrap()).abs() < 1e-6);
        assert_eq!(Pose::default().isometry(), None, "an unknown heading is not zero");
    }
}
