//! Channels of the observation that every team has. A new one is a line of `channels`.

use super::channel::{Channel, Quantity, Unit};

/// Returns all built-in channels.
pub fn channels() -> Vec<Channel> {
    use Quantity::{Angle, Number, Point, Vector};
    use Unit::{Metre, MetrePerSecond, One, Radian, RadianPerSecond, Second};
    let unknown = f32::NAN;
    vec![
        Channel::new("position", "estimated position", (vec![2], Metre, Point), |known, out| {
            out.copy_from_slice(known.own.motion.position.as_slice());
        }),
        Channel::new("velocity", "estimated velocity", (vec![2], MetrePerSecond, Vector), |known, out| {
            out.copy_from_slice(known.own.motion.velocity.as_slice());
        }),
        Channel::new("goal", "position of the goal", (vec![2], Metre, Point), |known, out| {
            out.copy_from_slice(known.own.goal.as_slice());
        }),
        Channel::new("goal-minus-position", "from the robot to its goal", (vec![2], Metre, Vector), |known, out| {
            out.copy_from_slice((known.own.goal - known.own.motion.position).as_slice());
        }),
        Channel::new("heading", "measured heading", (vec![1], Radian, Angle), move |known, out| {
            out[0] = known.own.heading.unwrap_or(unknown);
        }),
        Channel::new("yaw-rate", "measured yaw rate", (vec![1], RadianPerSecond, Number), move |known, out| {
            out[0] = known.own.yaw_rate.unwrap_or(unknown);
        }),
        Channel::new("filter", "1 with a safety filter, else 0", (vec![1], One, Number), |known, out| {
            out[0] = if known.own.dynamics.filtered { 1.0 } else { 0.0 };
        }),
        Channel::new("lag", "time constant of the drivetrain's lag", (vec![1], Second, Number), |known, out| {
            out[0] = known.own.dynamics.lag_s;
        }),
        Channel::new("time-in-episode", "time since the episode began", (vec![1], Second, Number), |known, out| {
            out[0] = known.own.elapsed.as_secs() as f32;
        }),
    ]
}
