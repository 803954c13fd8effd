//! State of the fusion of odometry with a source: an estimated pose with its covariance, moved and corrected as in an
//! extended Kalman filter.

use crate::messages::geometry::rotated;

/// State of the Kalman filter: estimated pose (x, y, heading) \[m, m, rad\] in the team's frame, and its covariance.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    /// Position \[m, m\] and heading \[rad\].
    pub pose: [f64; 3],
    /// Covariance of the pose.
    pub covariance: [[f64; 3]; 3],
}

impl State {
    /// Returns a pose of which nothing is known but what was measured or said: with the standard deviations
    /// `position_m` \[m\] and `heading_rad` \[rad\].
    pub fn at(pose: [f64; 3], position_m: f64, heading_rad: f64) -> State {
        let mut covariance = [[0.0; 3]; 3];
        for (at, deviation) in [position_m, position_m, heading_rad].into_iter().enumerate() {
            covariance[at][at] = deviation * deviation;
        }
        State { pose, covariance }
    }

    /// Increases the variances by the squares of these deviations \[m, m, rad\].
    pub fn doubt(&mut self, deviations: [f64; 3]) {
        (0..3).for_each(|at| self.covariance[at][at] += deviations[at] * deviations[at]);
    }

    /// Moves the pose by a motion in the robot's own frame (ahead, left, turn) \[m, m, rad\], and increases the
    /// covariance by the error `drift` of the odometry.
    pub fn advance(&mut self, [ahead, left, turn]: [f64; 3], drift: f64) {
        let [x, y, heading] = self.pose;
        // At half the turn, as on an arc.
        let (dx, dy) = rotated(heading + turn / 2.0, ahead, left);
        self.pose = [x + dx, y + dy, heading + turn];
        // Jacobian of the motion: the identity, but for the position by the heading.
        let by_heading = [-dy, dx, 0.0];
        let p = self.covariance;
        let mut moved = p;
        for row in 0..3 {
            for column in 0..3 {
                moved[row][column] = p[row][column]
                    + by_heading[row] * p[2][column]
                    + p[row][2] * by_heading[column]
                    + by_heading[row] * p[2][2] * by_heading[column];
            }
        }
        // A turn of 1 rad counts as 0.2 m of a wheel's way, about half the distance between two wheels.
        let noise = drift * drift * (libm::hypot(ahead, left) + 0.2 * turn.abs());
        (0..3).for_each(|at| moved[at][at] += noise);
        self.covariance = moved;
    }

    /// Returns the inverse covariance of the difference between a measured and the estimated position. `variance` is
    /// that of the measurement \[m²\].
    fn information(&self, variance: f64) -> [[f64; 2]; 2] {
        let [[xx, xy, _], [_, yy, _], _] = self.covariance;
        let (xx, yy) = (xx + variance, yy + variance);
        let determinant = xx * yy - xy * xy;
        [[yy / determinant, -xy / determinant], [-xy / determinant, xx / determinant]]
    }

    /// Returns the squared Mahalanobis distance of `error`, the difference \[m\] between a measured and the estimated
    /// position. `variance` is that of the measurement \[m²\].
    pub fn distance(&self, error: [f64; 2], variance: f64) -> f64 {
        let s = self.information(variance);
        (0..2).map(|row| (0..2).map(|column| error[row] * s[row][column] * error[column]).sum::<f64>()).sum()
    }

    /// Corrects the pose by a measured position. `error` is its difference from the estimate \[m\], and `variance` that
    /// of the measurement \[m²\].
    pub fn correct_position(&mut self, error: [f64; 2], variance: f64) {
        let (s, p) = (self.information(variance), self.covariance);
        let gain: [[f64; 2]; 3] =
            std::array::from_fn(|row| std::array::from_fn(|at| p[row][0] * s[0][at] + p[row][1] * s[1][at]));
        self.pose = std::array::from_fn(|at| self.pose[at] + gain[at][0] * error[0] + gain[at][1] * error[1]);
        let less = |row: usize, column: usize| gain[row][0] * p[0][column] + gain[row][1] * p[1][column];
        self.covariance = std::array::from_fn(|row| std::array::from_fn(|at| p[row][at] - less(row, at)));
    }

    /// Corrects the pose by a measured heading. `error` is its difference from the estimate \[rad\], and `variance`
    /// that of the measurement \[rad²\].
    pub fn correct_heading(&mut self, error: f64, variance: f64) {
        let p = self.covariance;
        let gain: [f64; 3] = std::array::from_fn(|row| p[row][2] / (p[2][2] + variance));
        self.pose = std::array::from_fn(|at| self.pose[at] + gain[at] * error);
        self.covariance = std::array::from_fn(|row| std::array::from_fn(|at| p[row][at] - gain[row] * p[2][at]));
    }
}
