//! Estimator that filters the readings of a robot with a constant-velocity Kalman filter and predicts its state at the
//! tick.
//!
//! The state along each axis is position and velocity, driven by white acceleration (Bar-Shalom et al., Estimation
//! with Applications to Tracking and Navigation, 2001, section 6.2.2). Both axes share one covariance. The time of a
//! reading is the time of measurement: its stamp, converted to this host's clock with the smallest transit time seen so
//! far, minus the known delay of the source. A measured velocity is used if its standard deviation is known; otherwise
//! the filter derives the velocity from positions. A reading that no robot could have reached is an outlier, unless the
//! next one confirms it. If a manoeuvre explains the reading, such as a stop at a wall, the filter increases the
//! variance of the velocity.

use super::{Estimator, Settings};
use crate::messages::geometry::{Motion, Vec2};
use crate::messages::wire::Reading;
use crate::time::{Span, Time};

/// Longest time over which the filter predicts from the last measurement, so that a robot without readings is not
/// estimated to go through a wall.
const LONGEST: Span = Span::from_millis(500);

/// Standard deviation of the acceleration between two readings \[m/s²\]: a robot that is commanded to change its
/// velocity by 1 m/s reaches 2 m/s² with a drivetrain's lag of 0.5 s, and more with a shorter one. A filter that
/// expects less goes on in the old direction for too long: in `passage` its robots touch walls.
const ACCELERATION: f64 = 3.0;

/// Standard deviation of a measured position that is assumed if the reading gives none \[m\]. `LEAST_POSITION` \[m\]
/// and `LEAST_VELOCITY` \[m/s\] are the smallest ones assumed: an exact sensor must not make the covariance singular.
const POSITION: f64 = 0.01;
const LEAST_POSITION: f64 = 1e-4;
const LEAST_VELOCITY: f64 = 1e-3;

/// Standard deviation of the estimated velocity after a first reading without velocity \[m/s\]. In a manoeuvre, its
/// square is added to the variance of the velocity.
const UNKNOWN_VELOCITY: f64 = 1.0;

/// Distance of a measured position from the predicted one, in standard deviations along an axis, beyond which the robot
/// counts as manoeuvring.
const MANOEUVRE: f64 = 3.0;

/// Largest speed at which a robot can have moved between two readings \[m/s\]; a reading beyond it is an outlier.
/// `GATE` is the position noise that is added to that distance, in standard deviations.
const FASTEST: f64 = 3.0;
const GATE: f64 = 6.0;

/// Largest drift of a sensor's clock against this host's clock, as a share of elapsed time: 100 ppm, twice the
/// tolerance of quartz clocks.
const CLOCK_DRIFT: f64 = 1e-4;

/// Change of the offset between a sensor's clock and this host's from which the sensor counts as restarted \[s\].
const RESTARTED: f64 = 1.0;

/// State of the filter: position and velocity along both axes, with one covariance for both axes.
#[derive(Clone, Copy, Debug, PartialEq)]
struct State {
    /// Time to which the state refers \[s\], on this host's clock: that of the last measurement, or of the prediction.
    at: f64,
    position: [f64; 2],
    velocity: [f64; 2],
    /// Variance of the position, covariance of position and velocity, and variance of the velocity, for each axis
    /// alike.
    covariance: [f64; 3],
}

/// Kalman filter that estimates the state of one robot.
#[derive(Debug)]
struct Kalman {
    /// Known, constant delay from a measurement to the arrival of its reading \[s\].
    delay: f64,
    state: Option<State>,
    /// Arrival time of the last reading \[s\], and the smallest difference seen between arrival and stamp \[s\], which
    /// may grow with the clocks' drift; `None` before the first reading.
    offset: Option<(f64, f64)>,
    /// Time \[s\] and position (x, y) \[m\] of the last reading, if it was an outlier; otherwise `None`.
    outlier: Option<[f64; 3]>,
}

/// Makes a Kalman filter that has received no reading yet. `settings` has the known delay of readings.
pub fn make(settings: &Settings) -> Box<dyn Estimator> {
    Box::new(Kalman { delay: settings.delay.as_secs(), state: None, offset: None, outlier: None })
}

fn axes(vector: Vec2) -> [f64; 2] {
    [f64::from(vector.x), f64::from(vector.y)]
}

fn squared(number: f64) -> f64 {
    number * number
}

impl State {
    /// Returns the state of the filter after a first reading, measured at time `at` \[s\].
    fn first(at: f64, reading: &Reading) -> State {
        let (position_m, velocity_m_s) = deviations(reading);
        let velocity = velocity_m_s.map_or([0.0; 2], |_| axes(reading.twist.velocity));
        let covariance = [squared(position_m), 0.0, squared(velocity_m_s.unwrap_or(UNKNOWN_VELOCITY))];
        State { at, position: axes(reading.pose.position), velocity, covariance }
    }

    /// Returns the state as predicted for the time `at` \[s\]; unchanged if that is earlier than the state.
    fn predicted(&self, at: f64) -> State {
        let t = (at - self.at).max(0.0);
        let [pp, pv, vv] = self.covariance;
        let power = squared(ACCELERATION);
        let position = [0, 1].map(|axis| self.position[axis] + t * self.velocity[axis]);
        let covariance = [
            pp + t * (2.0 * pv + t * vv) + power * t * t * t * t / 4.0,
            pv + t * vv + power * t * t * t / 2.0,
            vv + power * t * t,
        ];
        State { at: self.at.max(at), position, covariance, ..*self }
    }

    /// Increases the covariance if the position `measured` is too far from the predicted one for a robot that keeps its
    /// velocity. `over` is the predicted time \[s\], and `variance` that of the measured position \[m²\].
    fn doubt(&mut self, over: f64, measured: [f64; 2], variance: f64) {
        let most = squared(MANOEUVRE) * (self.covariance[0] + variance);
        if (0..2).any(|axis| squared(measured[axis] - self.position[axis]) > most) {
            self.covariance[0] += squared(UNKNOWN_VELOCITY * over.max(0.0));
            self.covariance[1] += squared(UNKNOWN_VELOCITY) * over.max(0.0);
            self.covariance[2] += squared(UNKNOWN_VELOCITY);
        }
    }

    /// Corrects the state by a measurement with variance `variance` along each axis: of the position if `quantity` is
    /// 0, of the velocity if it is 1.
    fn correct(&mut self, quantity: usize, measured: [f64; 2], variance: f64) {
        let [pp, pv, vv] = self.covariance;
        let (own, gains) = match quantity {
            0 => (self.position, [pp / (pp + variance), pv / (pp + variance)]),
            _ => (self.velocity, [pv / (vv + variance), vv / (vv + variance)]),
        };
        for axis in 0..2 {
            let off = measured[axis] - own[axis];
            self.position[axis] += gains[0] * off;
            self.velocity[axis] += gains[1] * off;
        }
        self.covariance = match quantity {
            0 => [(1.0 - gains[0]) * pp, (1.0 - gains[0]) * pv, vv - gains[1] * pv],
            _ => [pp - gains[0] * pv, (1.0 - gains[1]) * pv, (1.0 - gains[1]) * vv],
        };
    }
}

/// Returns the standard deviations of a reading's position \[m\] and velocity \[m/s\]. The latter is `None` if the
/// reading does not give it; its velocity is then not used.
fn deviations(reading: &Reading) -> (f64, Option<f64>) {
    let position_m = reading.deviation.position_m.map_or(POSITION, f64::from).max(LEAST_POSITION);
    (position_m, reading.deviation.velocity_m_s.map(|deviation| f64::from(deviation).max(LEAST_VELOCITY)))
}

impl Kalman {
    /// Returns the time at which a reading was measured \[s\], on this host's clock, and updates the offset of the
    /// clocks. `now` is its arrival time \[s\], `stamp_ns` its stamp on the sensor's clock \[ns\].
    fn measured_at(&mut self, now: f64, stamp_ns: u64) -> f64 {
        let stamp = stamp_ns as f64 * 1e-9;
        let difference = now - stamp;
        let offset = match self.offset {
            // The least difference may grow with the drift of both clocks.
            Some((last, least)) if (difference - least).abs() < RESTARTED => {
                difference.min(least + CLOCK_DRIFT * (now - last))
            }
            _ => difference,
        };
        self.offset = Some((now, offset));
        stamp + offset - self.delay
    }

    /// Returns whether a reading, measured at time `at` \[s\], is an outlier: too far from the state for a robot, and
    /// from the outlier before it. Stores an outlier. If the reading confirms the stored outlier, the state is cleared.
    fn is_outlier(&mut self, at: f64, reading: &Reading) -> bool {
        let Some(state) = self.state else { return false };
        let (position_m, _) = deviations(reading);
        let measured = axes(reading.pose.position);
        let reachable = |from: [f64; 2], since: f64| {
            let most = FASTEST * (at - since).max(0.0) + GATE * position_m;
            (0..2).map(|axis| squared(measured[axis] - from[axis])).sum::<f64>() <= squared(most)
        };
        if reachable(state.position, state.at) {
            self.outlier = None;
            return false;
        }
        match self.outlier.take() {
            Some([since, x, y]) if reachable([x, y], since) => {
                self.state = None;
                false
            }
            _ => {
                self.outlier = Some([at, measured[0], measured[1]]);
                true
            }
        }
    }
}

impl Kalman {
    /// Returns the state as predicted for `now`, or for the latest time to which predictions reach; `None` before the
    /// first reading.
    fn state_at(&self, now: Time) -> Option<State> {
        let state = self.state?;
        Some(state.predicted(now.as_secs().min(state.at + LONGEST.as_secs() + self.delay)))
    }
}

impl Estimator for Kalman {
    fn finds_velocities(&self) -> bool {
        true
    }

    fn take(&mut self, now: Time, reading: &Reading) {
        let at = self.measured_at(now.as_secs(), reading.stamp_ns);
        if self.is_outlier(at, reading) {
            return;
        }
        let (position_m, velocity_m_s) = deviations(reading);
        self.state = Some(match self.state {
            Some(before) => {
                let mut state = before.predicted(at);
                state.doubt(at - before.at, axes(reading.pose.position), squared(position_m));
                state.correct(0, axes(reading.pose.position), squared(position_m));
                if let Some(velocity_m_s) = velocity_m_s {
                    state.correct(1, axes(reading.twist.velocity), squared(velocity_m_s));
                }
                state
            }
            None => State::first(at, reading),
        });
    }

    fn at(&self, now: Time) -> Option<Motion> {
        let State { position: [x, y], velocity: [vx, vy], .. } = self.state_at(now)?;
        Some(Motion { position: Vec2::new(x as f32, y as f32), velocity: Vec2::new(vx as f32, vy as f32) })
    }

    fn deviation_m(&self, now: Time) -> f32 {
        self.state_at(now).map_or(0.0, |state| state.covariance[0].max(0.0).sqrt() as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::geometry::Deviation;
    use crate::messages::ids::RobotId;
    use crate::random::{Seed, normals};

    fn at_ms(ms: u64) -> Time {
        Time::ZERO + Span::from_millis(ms)
    }

    fn reading(stamp_ms: u64, x: f64, position_m: Option<f32>) -> Reading {
        let motion = Motion { position: Vec2::new(x as f32, 1.0), velocity: Vec2::zeros() };
        let deviation = Deviation { position_m, ..Deviation::default() };
        Reading { deviation, ..Reading::of_point(RobotId(0), stamp_ms * 1_000_000, motion) }
    }

    fn x_at(kalman: &dyn Estimator, ms: u64) -> f64 {
        f64::from(kalman.at(at_ms(ms)).unwrap().position.x)
    }

    #[test]
    fn a_known_delay_is_made_up_for_and_a_velocity_found_from_positions() {
        let mut kalman = make(&Settings { delay: Span::from_millis(100) });
        // At 0.5 m/s, every 100 ms; each reading 100 ms late, and up to 40 ms later than that; stamps of another clock.
        for step in 0..50_u64 {
            let measured_ms = 100 * step;
            let late_ms = 100 + [0, 40, 10, 25][step as usize % 4];
            kalman.take(
                at_ms(measured_ms + late_ms),
                &reading(7_000_000 + measured_ms, 0.0005 * measured_ms as f64, None),
            );
        }
        assert!((x_at(&*kalman, 5050) - 0.0005 * 5050.0).abs() < 2e-3, "{}", x_at(&*kalman, 5050));
        let velocity = kalman.at(at_ms(5050)).unwrap().velocity;
        assert!((velocity - Vec2::new(0.5, 0.0)).norm() < 5e-3, "{velocity:?}");
        let halted = x_at(&*kalman, 60_000);
        assert!(halted < 0.0005 * 4900.0 + 0.5 * 0.61, "a silent source moves it no further: {halted}");
    }

    #[test]
    fn one_reading_far_off_is_ignored_and_two_that_agree_count() {
        let mut kalman = make(&Settings::default());
        (0..20).for_each(|step| kalman.take(at_ms(50 * step), &reading(50 * step, 1.0, Some(0.01))));
        kalman.take(at_ms(1000), &reading(1000, 3.0, Some(0.01)));
        assert!((x_at(&*kalman, 1000) - 1.0).abs() < 0.02, "an outlier");
        kalman.take(at_ms(1050), &reading(1050, 1.0, Some(0.01)));
        assert!((x_at(&*kalman, 1050) - 1.0).abs() < 0.02);
        // A robot that is put elsewhere.
        kalman.take(at_ms(1100), &reading(1100, -2.0, Some(0.01)));
        kalman.take(at_ms(1150), &reading(1150, -2.0, Some(0.01)));
        assert!((x_at(&*kalman, 1150) + 2.0).abs() < 0.02);
    }

    #[test]
    fn a_robot_that_stops_at_a_wall_is_not_moved_on() {
        let mut kalman = make(&Settings::default());
        (0..=10).for_each(|step| kalman.take(at_ms(100 * step), &reading(100 * step, 0.08 * step as f64, Some(0.01))));
        assert!((kalman.at(at_ms(1000)).unwrap().velocity.x - 0.8).abs() < 0.1);
        (11..=12).for_each(|step| kalman.take(at_ms(100 * step), &reading(100 * step, 0.8, Some(0.01))));
        let motion = kalman.at(at_ms(1200)).unwrap();
        assert!(motion.velocity.x.abs() < 0.15 && (motion.position.x - 0.8).abs() < 0.02, "{motion:?}");
    }

    #[test]
    fn noise_is_smoothed_and_an_exact_sensor_is_followed() {
        let mut stream = Seed::of_run(3).stream("noise");
        let (mut kalman, mut squares) = (make(&Settings::default()), [0.0; 2]);
        for step in 0..2000_u64 {
            let [noise, _] = normals(&mut stream);
            kalman.take(at_ms(10 * step), &reading(10 * step, 0.02 * noise, Some(0.02)));
            if step > 100 {
                squares[0] += squared(0.02 * noise);
                squares[1] += squared(x_at(&*kalman, 10 * step));
            }
        }
        assert!(squares[1] < 0.5 * squares[0], "{squares:?}");
        let mut kalman = make(&Settings::default());
        (0..20).for_each(|step| kalman.take(at_ms(50 * step), &reading(50 * step, 0.001 * step as f64, Some(0.0))));
        assert!((x_at(&*kalman, 950) - 0.019).abs() < 1e-5);
    }
}
