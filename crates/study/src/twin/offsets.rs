//! Offsets of the agents' ticks within their period, against the steps of the World. Which part of a period a message
//! waits for its receiver's next tick depends on them, so they decide on the ages of messages.

use std::f64::consts::TAU;

/// Length of the mean direction (0 to 1) of tick times on a circle of one period, below which ticks have no fixed
/// offset: the clocks of agent and World drift against each other.
const STEADY: f64 = 0.95;

/// Returns the mean of times within a period, as a share of the period (0 to 1). It is the direction of the mean of the
/// times as points on a circle (Fisher, Statistical Analysis of Circular Data, 1993). `None` without times, or if they
/// drift and have no fixed place in the period.
pub fn steady(times_ns: impl Iterator<Item = i64>, period_ns: i64) -> Option<f64> {
    let (mut count, mut x, mut y) = (0u64, 0.0, 0.0);
    for time in times_ns {
        let angle = time.rem_euclid(period_ns) as f64 / period_ns as f64 * TAU;
        (count, x, y) = (count + 1, x + angle.cos(), y + angle.sin());
    }
    let length = (x * x + y * y).sqrt() / count.max(1) as f64;
    (count > 0 && length >= STEADY).then(|| (y.atan2(x) / TAU).rem_euclid(1.0))
}

/// Returns the time \[s\] from a step of the simulated World to the agent's next tick: at least 0, less than a period.
/// `tick` and `step` are their mean times within the period of `period_ns` \[ns\], each as a share of it (0 to 1).
pub fn between(tick: f64, step: f64, period_ns: i64) -> f64 {
    let offset_ns = ((tick - step).rem_euclid(1.0) * period_ns as f64).round() as i64 % period_ns;
    offset_ns as f64 / 1e9
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: i64 = 50_000_000;

    #[test]
    fn an_offset_is_found_across_the_end_of_the_period_and_drift_is_noticed() {
        let ticks = |offset: i64, drift: i64| {
            (0..2000i64).map(move |tick| tick * (PERIOD + drift) + offset + tick * 31 % 400_000 - 200_000)
        };
        let step = steady(ticks(10_000_000, 0), PERIOD).unwrap();
        let tick = steady(ticks(0, 0), PERIOD).unwrap();
        assert!((between(tick, step, PERIOD) - 0.04).abs() < 1e-5);
        assert_eq!(steady(ticks(0, 20_000), PERIOD), None);
        assert_eq!(steady(std::iter::empty(), PERIOD), None);
    }
}
