//! State of the fusion of odometry with a source: an estimated pose with its covariance, moved and corrected as in an
//! extended Kalman filter.

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::messages::geometry::rotated;

/// State of the Kalman filter: estimated pose (x, y, heading) \[m, m, rad\] in the team's frame, and its covariance.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    /// Position \[m, m\] and heading \[rad\].
    pub pose: Vector3<f64>,
    /// Covariance of the pose.
    pub covariance: Matrix3<f64>,
}

impl State {
    /// Returns a pose of which nothing is known but what was measured or said: with the standard deviations
    /// `position_m` \[m\] and `heading_rad` \[rad\].
    pub fn at(pose: Vector3<f64>, position_m: f64, heading_rad: f64) -> State {
        let mut state = State { pose, covariance: Matrix3::zeros() };
        state.doubt(Vector3::new(position_m, position_m, heading_rad));
        state
    }

    /// Increases the variances by the squares of these deviations \[m, m, rad\].
    pub fn doubt(&mut self, deviations: Vector3<f64>) {
        self.covariance += Matrix3::from_diagonal(&deviations.component_mul(&deviations));
    }

    /// Moves the pose by a motion in the robot's own frame (ahead, left, turn) \[m, m, rad\], and increases the
    /// covariance by the error `drift` of the odometry.
    pub fn advance(&mut self, [ahead, left, turn]: [f64; 3], drift: f64) {
        // At half the turn, as on an arc.
        let (dx, dy) = rotated(self.pose.z + turn / 2.0, ahead, left);
        self.pose += Vector3::new(dx, dy, turn);
        let mut jacobian = Matrix3::identity();
        (jacobian.m13, jacobian.m23) = (-dy, dx);
        // A turn of 1 rad counts as 0.2 m of a wheel's way, about half the distance between two wheels.
        let noise = drift * drift * (libm::hypot(ahead, left) + 0.2 * turn.abs());
        self.covariance = jacobian * self.covariance * jacobian.transpose() + Matrix3::from_diagonal_element(noise);
    }

    /// Returns the inverse covariance of the difference between a measured and the estimated position. `variance` is
    /// that of the measurement \[m²\], above zero. (Zero if rounding has left nothing to invert: such a measurement
    /// corrects nothing.)
    fn information(&self, variance: f64) -> Matrix2<f64> {
        let covariance = self.covariance.fixed_view::<2, 2>(0, 0) + Matrix2::from_diagonal_element(variance);
        covariance.try_inverse().unwrap_or_default()
    }

    /// Returns the squared Mahalanobis distance of `error`, the difference \[m\] between a measured and the estimated
    /// position. `variance` is that of the measurement \[m²\].
    pub fn distance(&self, error: Vector2<f64>, variance: f64) -> f64 {
        error.dot(&(self.information(variance) * error))
    }

    /// Corrects the pose by a measured position. `error` is its difference from the estimate \[m\], and `variance` that
    /// of the measurement \[m²\].
    pub fn correct_position(&mut self, error: Vector2<f64>, variance: f64) {
        let gain = self.covariance.fixed_columns::<2>(0) * self.information(variance);
        self.pose += gain * error;
        self.covariance -= gain * self.covariance.fixed_rows::<2>(0);
    }

    /// Corrects the pose by a measured heading. `error` is its difference from the estimate \[rad\], and `variance`
    /// that of the measurement \[rad²\].
    pub fn correct_heading(&mut self, error: f64, variance: f64) {
        let gain = self.covariance.column(2) / (self.covariance.m33 + variance);
        self.pose += gain * error;
        self.covariance -= gain * self.covariance.row(2);
    }
}
