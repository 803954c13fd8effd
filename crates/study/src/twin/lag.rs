//! Fit of a twin's drivetrain: lag and slip, from the recorded commands and velocities of robots.
//!
//! The model is that of `world::drivetrain`: in every step the velocity makes up the share 1 - exp(-step / lag) of its
//! difference to the command, within limits. The lag is that with which the model, run forward from the first velocity
//! of a series by the recorded commands, comes nearest to the recorded velocities (least squares). Slip is the rest
//! that the fitted model leaves in single steps: its standard deviation over the commanded speed, and its correlation
//! time.

use std::ops::RangeInclusive;

use super::estimate::{Estimate, bootstrap, quantile_of};
use murmurate::random::Stream;

/// Velocity of a robot after a step of the simulation, and the command that drove it in that step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moved {
    /// Velocity \[m/s\], world frame.
    pub velocity: [f64; 2],
    /// Commanded velocity \[m/s\], world frame.
    pub command: [f64; 2],
}

/// Motion of one robot in consecutive steps, in none of which it touches anything.
pub type Series = Vec<Moved>;

/// Limits of the drivetrain in the fit of its lag; they are given and not fitted.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Duration of a step of the simulation \[s\].
    pub step_s: f64,
    /// Largest speed \[m/s\].
    pub speed_m_s: f64,
    /// Largest acceleration along each axis \[m/s^2\].
    pub axis_m_s2: f64,
    /// Largest acceleration in any direction \[m/s^2\].
    pub total_m_s2: f64,
}

/// Wheel slip that a fit has found: a random difference between driven and commanded velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// Standard deviation of the slip along each axis, as a share of the commanded speed.
    pub share: Estimate,
    /// Correlation time of the slip \[s\].
    pub time_s: f64,
}

/// Largest lag that the search looks at \[s\].
const MOST_S: f64 = 3.0;
const COARSE_S: f64 = 0.05;
const FINE_S: f64 = 0.0025;
/// Ratio of the standard deviation of a zero-mean normal distribution to the median of its absolute values.
const MEDIAN_TO_DEVIATION: f64 = 1.4826;
/// Largest number of control ticks, in the search, until a command has an effect on the robot's own velocity estimates.
const MOST_TICKS: usize = 8;
/// Least commanded speed of a step from which slip is taken \[m/s\].
const SLOW_M_S: f64 = 0.1;

fn norm([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

fn shortened(vector: [f64; 2], most: f64) -> [f64; 2] {
    let norm = norm(vector);
    if norm > most { vector.map(|axis| axis * (most / norm)) } else { vector }
}

fn gain(lag_s: f64, step_s: f64) -> f64 {
    if lag_s > 0.0 { 1.0 - (-step_s / lag_s).exp() } else { 1.0 }
}

/// Returns the velocity after one step of the drivetrain model without slip \[m/s\], and whether no limit acted. `gain`
/// is the share of the difference to the command that a step makes up.
fn next(velocity: [f64; 2], command: [f64; 2], gain: f64, limits: &Limits) -> ([f64; 2], bool) {
    let command = shortened(command, limits.speed_m_s);
    let most = limits.axis_m_s2 * limits.step_s;
    let wanted = [0, 1].map(|axis| (command[axis] - velocity[axis]) * gain);
    let change = shortened(wanted.map(|axis| axis.clamp(-most, most)), limits.total_m_s2 * limits.step_s);
    ([0, 1].map(|axis| velocity[axis] + change[axis]), change == wanted)
}

/// Runs the drivetrain model with the lag `lag_s` by the commands of a series, and returns the sum of squared errors of
/// its velocities against the recorded ones \[m^2/s^2\].
fn squares(series: &Series, lag_s: f64, limits: &Limits) -> f64 {
    let Some(first) = series.first() else { return 0.0 };
    let gain = gain(lag_s, limits.step_s);
    let (mut velocity, mut sum) = (first.velocity, 0.0);
    for step in &series[1..] {
        velocity = next(velocity, step.command, gain, limits).0;
        sum += (velocity[0] - step.velocity[0]).powi(2) + (velocity[1] - step.velocity[1]).powi(2);
    }
    sum
}

/// Finds the lag of the drivetrain \[s\] from the robots' motion in each episode, with a bootstrap interval over
/// episodes; `None` if no robot moved.
pub fn fit(episodes: &[Vec<Series>], limits: &Limits, stream: &mut Stream) -> Option<Estimate> {
    let moved = |series: &&Series| series.iter().any(|step| norm(step.command) > SLOW_M_S);
    episodes.iter().flatten().find(moved)?;
    let of_episode =
        |series: &Vec<Series>, lag_s: f64| series.iter().map(|series| squares(series, lag_s, limits)).sum();
    let sum = |lag_s: f64| episodes.iter().map(|series| -> f64 { of_episode(series, lag_s) }).sum::<f64>();
    let (near, _) = nearest(&sum)?;
    let reach = (2.0 * COARSE_S / FINE_S).round() as i32;
    let lags: Vec<f64> =
        (-reach..=reach).map(|at| near + f64::from(at) * FINE_S).filter(|lag_s| *lag_s >= 0.0).collect();
    let table: Vec<Vec<f64>> =
        episodes.iter().map(|series| lags.iter().map(|&lag_s| of_episode(series, lag_s)).collect()).collect();
    bootstrap(episodes.len(), stream, |drawn| {
        let sums: Vec<f64> = (0..lags.len()).map(|at| drawn.iter().map(|episode| table[*episode][at]).sum()).collect();
        Some(lowest(&lags, &sums))
    })
}

/// Returns the drivetrain lag \[s\] of a coarse grid for which `error` is least, and that error.
fn nearest(error: &impl Fn(f64) -> f64) -> Option<(f64, f64)> {
    let lags = (0..=(MOST_S / COARSE_S).round() as u32).map(|at| f64::from(at) * COARSE_S);
    lags.map(|lag_s| (lag_s, error(lag_s))).min_by(|one, other| one.1.total_cmp(&other.1))
}

/// Returns the series with each command `steps` steps later; the first `skipped` steps of a series, which is at least
/// as many, are left out.
fn late(episodes: &[Vec<Series>], steps: usize, skipped: usize) -> Vec<Vec<Series>> {
    let one = |series: &Series| -> Series {
        let moved = |at: usize| Moved { command: series[at - steps].command, ..series[at] };
        (skipped..series.len()).map(moved).collect()
    };
    episodes.iter().map(|episode| episode.iter().map(one).filter(|series| series.len() > 1).collect()).collect()
}

/// Returns the number of steps, one of `steps`, until a command has an effect on the velocities: that with which the
/// model comes nearest to them. `None` without any.
fn lateness(episodes: &[Vec<Series>], steps: RangeInclusive<usize>, limits: &Limits) -> Option<usize> {
    let most = *steps.end();
    let error = |number: usize| {
        // All shifts leave the same steps to compare.
        let series = late(episodes, number, most);
        let sum = |lag_s: f64| series.iter().flatten().map(|series| squares(series, lag_s, limits)).sum::<f64>();
        Some((number, nearest(&sum)?.1))
    };
    let best = steps.filter_map(error).min_by(|one, other| one.1.total_cmp(&other.1));
    best.map(|(number, _)| number)
}

/// Finds the lag of the drivetrain \[s\] from the velocities that robots estimated and commanded at their control
/// ticks. The second number is the time \[s\], in whole ticks, until a command has an effect on these estimates. `None`
/// if no robot moved.
pub fn fit_estimates(episodes: &[Vec<Series>], limits: &Limits, stream: &mut Stream) -> Option<(Estimate, f64)> {
    // A command of one tick can show at the next.
    let steps = lateness(episodes, 1..=MOST_TICKS + 1, limits)?;
    let lag_s = fit(&late(episodes, steps, MOST_TICKS + 1), limits, stream)?;
    Some((lag_s, (steps - 1) as f64 * limits.step_s))
}

/// Returns the series with each command at the step at which it has its effect, and by how many steps that is late.
/// For logs of other programs, of which it is not known which step a command drives.
pub fn matched(episodes: &[Vec<Series>], limits: &Limits) -> (Vec<Vec<Series>>, usize) {
    let steps = lateness(episodes, 0..=MOST_TICKS, limits).unwrap_or(0);
    (late(episodes, steps, steps), steps)
}

/// Returns the argument at which a sampled function has its minimum, from the parabola through the smallest of `values`
/// and its neighbours. `places` are the arguments of the values.
fn lowest(places: &[f64], values: &[f64]) -> f64 {
    let least = (0..values.len()).min_by(|one, other| values[*one].total_cmp(&values[*other])).unwrap_or(0);
    if least == 0 || least + 1 == values.len() {
        return places[least];
    }
    let [before, at, after] = [values[least - 1], values[least], values[least + 1]];
    let bend = before - 2.0 * at + after;
    let shift = if bend > 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
    places[least] + shift * (places[least + 1] - places[least])
}

/// Finds the wheel slip: the random velocity errors that the drivetrain model with the lag `lag_s` \[s\] leaves in
/// single steps, with a bootstrap interval over episodes. `None` without steps of enough commanded speed. Pushes of
/// other robots and of rails are no slip: the standard deviation is taken from the median size, and steps beyond five
/// of it are left out.
pub fn slip(episodes: &[Vec<Series>], lag_s: f64, limits: &Limits, stream: &mut Stream) -> Option<Slip> {
    let gain = gain(lag_s, limits.step_s);
    let all: Vec<Vec<Vec<Option<[f64; 2]>>>> =
        episodes.iter().map(|series| series.iter().map(|series| slips(series, gain, limits)).collect()).collect();
    let sizes = |episode: &usize| all[*episode].iter().flatten().flatten().flatten().map(|slip| slip.abs());
    let share = bootstrap(episodes.len(), stream, |drawn| {
        Some(MEDIAN_TO_DEVIATION * quantile_of(drawn.iter().flat_map(sizes).collect(), 0.5)?)
    })?;
    let (mut squares, mut products, mut pairs) = (0.0, 0.0, 0.0f64);
    let most = 5.0 * share.value;
    for pair in all.iter().flatten().flat_map(|slips| slips.windows(2)) {
        let (Some(one), Some(other)) = (pair[0], pair[1]) else { continue };
        for axis in (0..2).filter(|axis| one[*axis].abs().max(other[*axis].abs()) <= most) {
            pairs += 1.0;
            squares += (one[axis] * one[axis] + other[axis] * other[axis]) / 2.0;
            products += one[axis] * other[axis];
        }
    }
    let together = if pairs > 0.0 && squares > 0.0 { products / squares } else { 0.0 };
    let time_s = if together > 0.0 && together < 1.0 { -limits.step_s / together.ln() } else { 0.0 };
    Some(Slip { share, time_s })
}

/// Returns the slip of each step of a series along each axis, as a share of the commanded speed; `None` for steps of
/// low commanded speed, and where a limit acted.
fn slips(series: &Series, gain: f64, limits: &Limits) -> Vec<Option<[f64; 2]>> {
    let of = |pair: &[Moved]| {
        let (velocity, command) = (pair[0].velocity, pair[1].command);
        let (expected, free) = next(velocity, command, gain, limits);
        let speed = norm(command);
        (free && speed > SLOW_M_S).then(|| [0, 1].map(|axis| (pair[1].velocity[axis] - expected[axis]) / gain / speed))
    };
    series.windows(2).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::random::{Seed, normals};

    const LIMITS: Limits = Limits { step_s: 0.05, speed_m_s: 2.5, axis_m_s2: 1.0, total_m_s2: 6.0 };

    /// Series of robots with this lag and slip.
    fn driven(lag_s: f64, slip: f64, slip_s: f64) -> Vec<Vec<Series>> {
        let mut stream = Seed::of_run(5).stream("test");
        let gain = gain(lag_s, LIMITS.step_s);
        let decay = (-LIMITS.step_s / slip_s).exp();
        let series = |stream: &mut Stream| {
            let (mut velocity, mut slipped, mut series) = ([0.0; 2], [0.0; 2], Series::new());
            for step in 0..140 {
                let angle = f64::from(step) * 0.05;
                let command = [0.5 * angle.cos(), 0.4 * (1.3 * angle).sin()];
                let noise = normals(stream).map(|normal| normal * slip * (1.0 - decay * decay).sqrt());
                slipped = [0, 1].map(|axis| slipped[axis] * decay + noise[axis]);
                let wanted = [0, 1].map(|axis| command[axis] + slipped[axis] * norm(command));
                velocity = next(velocity, wanted, gain, &LIMITS).0;
                series.push(Moved { velocity, command });
            }
            series
        };
        (0..16).map(|_| (0..5).map(|_| series(&mut stream)).collect()).collect()
    }

    #[test]
    fn lag_and_slip_are_found_within_their_intervals() {
        for lag_s in [0.0, 0.2, 0.5, 0.8] {
            let episodes = driven(lag_s, 0.02, 0.5);
            let found = fit(&episodes, &LIMITS, &mut Seed::of_run(1).stream("lag")).unwrap();
            assert!((found.value - lag_s).abs() < 0.01, "{lag_s}: {found:?}");
            let slip = slip(&episodes, found.value, &LIMITS, &mut Seed::of_run(1).stream("slip")).unwrap();
            assert!((slip.share.value - 0.02).abs() < 0.003, "{lag_s}: {slip:?}");
            assert!((slip.time_s - 0.5).abs() < 0.15, "{lag_s}: {slip:?}");
        }
    }

    #[test]
    fn estimates_at_ticks_tell_the_lag_and_how_late_commands_show() {
        let late = |series: &Series, ticks: usize| -> Series {
            let command = |at: usize| series.get(at + 1 + ticks).map_or([0.0; 2], |step| step.command);
            series.iter().enumerate().map(|(at, step)| Moved { command: command(at), ..*step }).collect()
        };
        for ticks in [0, 2, 5] {
            let episodes = driven(0.5, 0.02, 0.5);
            let told: Vec<Vec<Series>> =
                episodes.iter().map(|all| all.iter().map(|series| late(series, ticks)).collect()).collect();
            let (lag_s, late_s) = fit_estimates(&told, &LIMITS, &mut Seed::of_run(1).stream("lag")).unwrap();
            assert!((lag_s.value - 0.5).abs() < 0.03, "{ticks}: {lag_s:?}");
            assert!((late_s - ticks as f64 * 0.05).abs() < 1e-9, "{ticks}: {late_s}");
        }
    }

    #[test]
    fn commands_of_a_log_are_matched_with_the_steps_that_they_drive() {
        let later = |series: &Series, steps: usize| -> Series {
            let command = |at: usize| series.get(at + steps).map_or([0.0; 2], |step| step.command);
            series.iter().enumerate().map(|(at, step)| Moved { command: command(at), ..*step }).collect()
        };
        let episodes = driven(0.3, 0.02, 0.5);
        assert_eq!(matched(&episodes, &LIMITS), (episodes.clone(), 0), "nothing is left out");
        for steps in [1, 4] {
            let told: Vec<Vec<Series>> =
                episodes.iter().map(|all| all.iter().map(|series| later(series, steps)).collect()).collect();
            let (found, late) = matched(&told, &LIMITS);
            assert_eq!(late, steps);
            assert!(found[0][0].iter().zip(&episodes[0][0][steps..]).all(|(one, other)| one == other));
        }
    }

    #[test]
    fn robots_that_stand_tell_nothing() {
        let still = vec![vec![vec![Moved { velocity: [0.0; 2], command: [0.0; 2] }; 50]]; 4];
        assert_eq!(fit(&still, &LIMITS, &mut Seed::of_run(1).stream("lag")), None);
    }
}
