//! Rigid body of one robot: refuses poses that jump, and computes velocity and yaw rate from a short window of poses.
//! All poses are in the team's frame.
//!
//! A tracker may exchange the ids of two bodies, or take a reflection for a body. So a pose that is too far from the
//! last accepted one is refused. A body that stays at a new place for `settle_s` is accepted there, as after it was
//! carried. A body that appears at the last place of another body is not accepted there: its poses are refused until it
//! is back at its own place, or the host is restarted.

use std::collections::VecDeque;

use crate::messages::geometry::wrapped;
/// Largest distance between two poses that tracker noise alone explains \[m\]: ten times the error of motion capture,
/// 0.2 mm to 2 mm.
const SLACK_M: f64 = 0.02;
/// Longest time for which a body is assumed to have moved at top speed \[s\]. The guard stops a robot without readings
/// before this time has passed.
const MOVING_S: f64 = 0.5;
/// Longest time between two consecutive poses from which a velocity is computed \[s\] (25 frames at 100 Hz). After a
/// longer gap, the window of poses begins anew.
const GAP_S: f64 = 0.25;
/// Distance from another body's last place within which a jump counts as an exchange of ids \[m\]. Two robots that are
/// so close touch each other.
const EXCHANGE_M: f64 = 0.2;
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

/// Limits by which the poses of a rigid body are accepted or refused as jumps, and the window of its velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest speed of the robot \[m/s\]. A pose that would need a higher speed is refused as a jump.
    pub speed_most_m_s: f64,
    /// Time that a body has to stay at a new place after a jump before it is accepted there \[s\].
    pub settle_s: f64,
    /// Length of the window over which the velocity is computed \[s\].
    pub window_s: f64,
}

/// Velocity and yaw rate of a rigid body, computed from a short window of its poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Mean velocity over the window \[m/s\]. It lags the true velocity by half the window.
    pub velocity: [f64; 2],
    /// Mean yaw rate over the window \[rad/s\], counter-clockwise; `None` if a heading in the window is unknown.
    pub yaw_rate: Option<f64>,
    /// Time between the first and the last pose of the window \[s\].
    pub span_s: f64,
}

/// Sequence of consecutive poses of a rigid body that are refused, because they are too far from the last accepted
/// pose.
#[derive(Clone, Copy, Debug)]
struct Held {
    since_s: f64,
    newest: Pose,
    exchanged: bool,
}

/// Filter of one robot's rigid body: refuses poses that jump, and computes the velocity from the accepted ones.
#[derive(Clone, Debug, Default)]
pub struct Body {
    /// Accepted poses in the window, the oldest first.
    window: VecDeque<Pose>,
    /// Last accepted pose; `None` before the first.
    newest: Option<Pose>,
    held: Option<Held>,
}

impl Body {
    /// Returns the last accepted pose; `None` before the first.
    pub fn newest(&self) -> Option<Pose> {
        self.newest
    }

    /// Accepts or refuses a new pose of the body. An error is the reason for which the pose is refused. `others` are
    /// the last accepted poses of the other bodies.
    pub fn take(
        &mut self,
        pose: Pose,
        limits: &Limits,
        others: impl Iterator<Item = Pose>,
    ) -> Result<(), &'static str> {
        let Some(newest) = self.newest else {
            self.accept(pose, limits);
            return Ok(());
        };
        let is_back = self.held.is_none_or(|held| distance(&newest, &pose) < distance(&held.newest, &pose));
        let exchanged = is_exchange(&newest, &pose, others);
        if is_back && !exchanged && is_reachable(&newest, &pose, limits) {
            self.accept(pose, limits);
            return Ok(());
        }
        let stays = |held: &Held| is_one_motion(&held.newest, &pose) && is_reachable(&held.newest, &pose, limits);
        let held = match self.held.filter(|held| held.exchanged || stays(held)) {
            Some(held) => Held { newest: pose, ..held },
            None => Held { since_s: pose.stamp_s, newest: pose, exchanged },
        };
        self.held = Some(held);
        if held.exchanged {
            return Err("a rigid body is where another was: the tracker has exchanged their ids; correct them there");
        }
        if pose.stamp_s - held.since_s < limits.settle_s {
            return Err("a rigid body has jumped further than its robot can move; it has to stay there for settle_s");
        }
        // No velocity is found across the jump.
        self.window.clear();
        self.accept(pose, limits);
        Ok(())
    }

    fn accept(&mut self, pose: Pose, limits: &Limits) {
        // Poses that were refused in between cost themselves: the accepted ones go on.
        self.held = None;
        if !self.newest.is_some_and(|newest| is_one_motion(&newest, &pose)) {
            self.window.clear();
        }
        self.newest = Some(pose);
        self.window.push_back(pose);
        // The oldest pose is removed when the pose after it already spans the window.
        let spans = |old: &Pose| pose.stamp_s - old.stamp_s >= limits.window_s - ROUNDING_S;
        while self.window.len() > MOST || self.window.get(1).is_some_and(spans) {
            self.window.pop_front();
        }
    }

    /// Returns velocity and yaw rate over the window; `None` while the window is shorter than half of `window_s`.
    pub fn rates(&self, limits: &Limits) -> Option<Rates> {
        let (old, new) = (self.window.front()?, self.window.back()?);
        let span_s = new.stamp_s - old.stamp_s;
        if span_s <= 0.0 || span_s < limits.window_s / 2.0 {
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

/// Returns whether a robot within `limits` can have moved from `old` to `new` in the time between the two poses.
fn is_reachable(old: &Pose, new: &Pose, limits: &Limits) -> bool {
    let moving_s = (new.stamp_s - old.stamp_s).clamp(0.0, MOVING_S);
    distance(old, new) <= SLACK_M + limits.speed_most_m_s * moving_s
}

fn is_one_motion(old: &Pose, new: &Pose) -> bool {
    new.stamp_s - old.stamp_s <= GAP_S
}

/// Returns whether the tracker seems to have exchanged the ids of two bodies: `pose` is at the last place of one of the
/// `others`, and nearer to that place than to `own`, the last place of its own body.
fn is_exchange(own: &Pose, pose: &Pose, mut others: impl Iterator<Item = Pose>) -> bool {
    let moved_m = distance(own, pose);
    moved_m > SLACK_M && others.any(|other| distance(&other, pose) < moved_m.min(EXCHANGE_M))
}

#[cfg(test)]
mod tests {
    use std::iter::empty;

    use super::*;

    const LIMITS: Limits = Limits { speed_most_m_s: 2.0, settle_s: 1.0, window_s: 0.05 };

    fn pose(frame: u32, x: f64) -> Pose {
        Pose { stamp_s: f64::from(frame) * 0.01, position: [x, 0.0], heading: Some(0.0) }
    }

    #[test]
    fn velocity_is_that_of_the_window_and_unknown_before() {
        let mut body = Body::default();
        for frame in 0..20 {
            let x = 0.005 * f64::from(frame);
            let turned = Pose { heading: Some(wrapped(3.1 + 0.03 * f64::from(frame))), ..pose(frame, x) };
            body.take(turned, &LIMITS, empty()).unwrap();
            let rates = body.rates(&LIMITS);
            assert_eq!(rates.is_some(), frame >= 3, "{frame}");
            let Some(rates) = rates else { continue };
            assert!((rates.velocity[0] - 0.5).abs() < 1e-9 && (rates.yaw_rate.unwrap() - 3.0).abs() < 1e-9);
            assert!(rates.span_s < 0.0501);
        }
        body.take(pose(60, 0.1), &LIMITS, empty()).unwrap();
        assert_eq!(body.rates(&LIMITS), None, "no velocity across a gap");
    }

    #[test]
    fn a_slow_tracker_gives_a_velocity_between_two_frames() {
        let mut body = Body::default();
        for (frame, x) in [(0, 0.0), (10, 0.1), (20, 0.2)] {
            body.take(pose(frame, x), &LIMITS, empty()).unwrap();
        }
        assert!((body.rates(&LIMITS).unwrap().velocity[0] - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_jump_is_refused_until_the_body_has_stayed_there() {
        let mut body = Body::default();
        (0..5).for_each(|frame| body.take(pose(frame, 0.0), &LIMITS, empty()).unwrap());
        (5..105).for_each(|frame| assert!(body.take(pose(frame, 3.0), &LIMITS, empty()).is_err(), "{frame}"));
        body.take(pose(105, 3.0), &LIMITS, empty()).unwrap();
        assert_eq!(body.rates(&LIMITS), None, "the jump is no velocity");
        (106..110).for_each(|frame| body.take(pose(frame, 3.0), &LIMITS, empty()).unwrap());
        body.take(pose(110, 5.0), &LIMITS, empty()).unwrap_err();
        body.take(pose(111, 3.0), &LIMITS, empty()).unwrap();
        assert_eq!(body.rates(&LIMITS).unwrap().velocity, [0.0; 2], "one refused pose costs itself");
        for frame in 112..400 {
            let x = if frame % 2 == 0 { 5.0 } else { 7.0 };
            body.take(pose(frame, x), &LIMITS, empty()).expect_err("it flickers");
        }
    }

    #[test]
    fn exchanged_bodies_are_held_until_they_are_back() {
        let mut bodies = [Body::default(), Body::default()];
        let mut feed = |frame: u32, places: [f64; 2]| {
            [0, 1].map(|at| {
                let other = bodies[1 - at].newest();
                bodies[at].take(pose(frame, places[at]), &LIMITS, other.into_iter()).is_ok()
            })
        };
        (0..5).for_each(|frame| assert_eq!(feed(frame, [0.0, 1.0]), [true; 2]));
        let times = (5..1000).chain(1100..1200).chain(5000..5200);
        times.for_each(|frame| assert_eq!(feed(frame, [1.0, 0.0]), [false; 2], "{frame}"));
        assert_eq!(feed(5200, [0.0, 1.0]), [true; 2]);
    }
}
