//! Rigid body of one robot: computes velocity and yaw rate from a short window of poses. All poses are in the team's
//! frame.
//!
//! A tracker may take a reflection for a body, or exchange the ids of two. So poses are kept as two sequences, each of
//! one motion: a pose that jumps begins a sequence of its own, and the velocity is never computed across a jump. Which
//! of the two is believed, the screen of the Localizer decides (`localization::screen`).

use std::collections::VecDeque;

use murmurate::localization::plausibility::Limits;
use murmurate::messages::geometry::wrapped;

/// Largest distance between two poses that tracker noise alone explains \[m\]: ten times the error of motion capture,
/// 0.2 mm to 2 mm.
const SLACK_M: f64 = 0.02;
/// Largest turn between two poses that tracker noise alone explains \[rad\].
const SLACK_RAD: f64 = 0.1;
/// Distance at which a turn counts in the choice of the nearer sequence \[m/rad\].
const TURN_M: f64 = 0.5;
/// Longest time between two consecutive poses from which a velocity is computed \[s\] (25 frames at 100 Hz). After a
/// longer gap, the window of poses begins anew.
const GAP_S: f64 = 0.25;
/// Largest rounding error of stamps \[s\]. It makes a window of 50 ms end at five frame periods of 100 Hz.
const ROUNDING_S: f64 = 1e-4;
/// Largest number of poses in the window from which the velocity is computed. The longest allowed `velocity_window_s`
/// has fewer, even at 360 Hz.
const MOST: usize = 256;

/// Pose of a rigid body at one time, in the coordinate frame of the team.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Time of measurement on the tracker's clock \[s\].
    pub stamp_s: f64,
    /// Position of the body \[m\], in the team's frame.
    pub position: [f64; 2],
    /// Heading \[rad\], counter-clockwise from the x axis, within -pi and pi; `None` if the body is not level.
    pub heading: Option<f64>,
}

/// Velocity and yaw rate of a rigid body, computed from a short window of its poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Mean velocity over the window \[m/s\]. It lags the true velocity by half the window.
    pub velocity: [f64; 2],
    /// Mean yaw rate over the window \[rad/s\], counter-clockwise; `None` if a heading in the window is unknown.
    pub yaw_rate: Option<f64>,
    /// Time between the first and the last pose of the window \[s\].
    pub(crate) span_s: f64,
}

/// Poses of one robot's rigid body, as sequences of one motion each, of which velocities are computed.
#[derive(Clone, Debug, Default)]
pub struct Body {
    /// Poses of the newest sequence in its window, the oldest first.
    window: VecDeque<Pose>,
    /// The same of the sequence before it, which goes on if the body is back there.
    other: VecDeque<Pose>,
}

impl Body {
    /// Takes a new pose of the body, and returns velocity and yaw rate over the window of `window_s` \[s\]; `None`
    /// while the sequence of the pose is shorter than half of it. A pose that a robot within `limits` cannot have moved
    /// to begins a new sequence.
    pub fn take(&mut self, pose: Pose, limits: &Limits, window_s: f64) -> Option<Rates> {
        let newest = |poses: &VecDeque<Pose>| poses.back().copied().filter(|old| is_one_motion(old, &pose, limits));
        match (newest(&self.window), newest(&self.other)) {
            (Some(own), Some(other)) if apart(&other, &pose) < apart(&own, &pose) => self.exchange(),
            (Some(_), _) => {}
            (None, Some(_)) => self.exchange(),
            (None, None) => {
                self.exchange();
                self.window.clear();
            }
        }
        self.window.push_back(pose);
        // The oldest pose is removed when the pose after it already spans the window.
        let spans = |old: &Pose| pose.stamp_s - old.stamp_s >= window_s - ROUNDING_S;
        while self.window.len() > MOST || self.window.get(1).is_some_and(spans) {
            self.window.pop_front();
        }
        self.rates(window_s)
    }

    fn exchange(&mut self) {
        std::mem::swap(&mut self.window, &mut self.other);
    }

    fn rates(&self, window_s: f64) -> Option<Rates> {
        let (old, new) = (self.window.front()?, self.window.back()?);
        let span_s = new.stamp_s - old.stamp_s;
        if span_s <= 0.0 || span_s < window_s / 2.0 {
            return None;
        }
        let velocity = [0, 1].map(|axis| (new.position[axis] - old.position[axis]) / span_s);
        Some(Rates { velocity, yaw_rate: self.turned().map(|angle| angle / span_s), span_s })
    }

    /// Returns the angle by which the body turned between the first and the last pose of its window \[rad\], which may
    /// exceed half a turn; `None` if a heading is unknown.
    fn turned(&self) -> Option<f64> {
        let steps = self.window.iter().zip(self.window.iter().skip(1));
        steps.map(|(old, new)| Some(wrapped(new.heading? - old.heading?))).sum()
    }
}

fn distance(one: &Pose, other: &Pose) -> f64 {
    libm::hypot(one.position[0] - other.position[0], one.position[1] - other.position[1])
}

fn turn(one: &Pose, other: &Pose) -> f64 {
    one.heading.zip(other.heading).map_or(0.0, |(one, other)| wrapped(one - other).abs())
}

fn apart(one: &Pose, other: &Pose) -> f64 {
    distance(one, other) + TURN_M * turn(one, other)
}

/// Returns whether a robot within `limits` can have moved from `old` to `new`, and no gap is between them.
fn is_one_motion(old: &Pose, new: &Pose, limits: &Limits) -> bool {
    let elapsed_s = new.stamp_s - old.stamp_s;
    (0.0..=GAP_S).contains(&elapsed_s)
        && distance(old, new) <= SLACK_M + limits.speed_m_s * elapsed_s
        && turn(old, new) <= SLACK_RAD + limits.yaw_rate_rad_s * elapsed_s
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW_S: f64 = 0.05;

    fn pose(frame: u32, x: f64) -> Pose {
        Pose { stamp_s: f64::from(frame) * 0.01, position: [x, 0.0], heading: Some(0.0) }
    }

    fn take(body: &mut Body, pose: Pose) -> Option<Rates> {
        body.take(pose, &Limits { speed_m_s: 2.0, ..Limits::default() }, WINDOW_S)
    }

    #[test]
    fn velocity_is_that_of_the_window_and_unknown_before() {
        let mut body = Body::default();
        for frame in 0..20 {
            let x = 0.005 * f64::from(frame);
            let turned = Pose { heading: Some(wrapped(3.1 + 0.03 * f64::from(frame))), ..pose(frame, x) };
            let rates = take(&mut body, turned);
            assert_eq!(rates.is_some(), frame >= 3, "{frame}");
            let Some(rates) = rates else { continue };
            assert!((rates.velocity[0] - 0.5).abs() < 1e-9 && (rates.yaw_rate.unwrap() - 3.0).abs() < 1e-9);
            assert!(rates.span_s < 0.0501);
        }
        assert_eq!(take(&mut body, pose(60, 0.1)), None, "no velocity across a gap");
    }

    #[test]
    fn a_slow_tracker_gives_a_velocity_between_two_frames() {
        let mut body = Body::default();
        let rates: Vec<_> = [(0, 0.0), (10, 0.1), (20, 0.2)].map(|(frame, x)| take(&mut body, pose(frame, x))).into();
        assert!((rates[2].unwrap().velocity[0] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_jump_is_in_no_velocity_and_a_reflection_costs_none() {
        let mut body = Body::default();
        for frame in 0..20 {
            take(&mut body, pose(frame, 0.0));
        }
        assert_eq!(take(&mut body, pose(20, 3.0)), None, "a reflection");
        assert_eq!(take(&mut body, pose(21, 0.0)).unwrap().velocity, [0.0, 0.0], "the body is back");
        for frame in 22..40 {
            let rates = take(&mut body, pose(frame, 3.0));
            assert_eq!(rates.map(|rates| rates.velocity), (frame >= 23).then_some([0.0, 0.0]), "{frame}");
        }
        let turned = Pose { heading: Some(1.0), ..pose(40, 3.0) };
        assert_eq!(take(&mut body, turned), None, "a heading jumps, too");
    }
}
