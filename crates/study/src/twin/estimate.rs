//! Estimates with intervals: the bootstrap over episodes, which are the independent parts of a run.

use rand::RngExt;
use serde::Serialize;

use murmurate::random::Stream;
use murmurate_report::statistics::quantile;

/// Number of resamples of a bootstrap.
const RESAMPLES: usize = 200;

/// Range of ranks on each side of a quantile over which a smooth quantile averages, as a share of all values.
const REACH: f64 = 0.025;

/// A number with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Estimated value.
    pub value: f64,
    /// Lower and upper end of the 95 % interval.
    pub ci95: [f64; 2],
}

impl Estimate {
    /// Returns an estimate of a number that is known exactly; its interval is that number alone.
    pub fn exact(value: f64) -> Estimate {
        Estimate { value, ci95: [value; 2] }
    }

    /// Returns the estimate with value and interval multiplied by `factor`, to change the unit.
    pub fn scaled(self, factor: f64) -> Estimate {
        Estimate { value: self.value * factor, ci95: self.ci95.map(|end| end * factor) }
    }
}

/// Returns a statistic of all episodes, with its 95 % interval by the bootstrap (Efron, 1979): the spread of the
/// statistic over sets of episodes that are drawn with replacement. `statistic` takes the indices of episodes, and
/// returns `None` if they have no data; so does this function.
pub fn bootstrap(
    episodes: usize,
    stream: &mut Stream,
    mut statistic: impl FnMut(&[usize]) -> Option<f64>,
) -> Option<Estimate> {
    let all: Vec<usize> = (0..episodes).collect();
    let value = statistic(&all)?;
    let mut drawn = all;
    let mut values = Vec::new();
    for _ in 0..RESAMPLES {
        drawn.iter_mut().for_each(|index| *index = stream.random_range(0..episodes));
        values.extend(statistic(&drawn));
    }
    let end = |q| quantile(&values, q).unwrap_or(value);
    Some(Estimate { value, ci95: [end(0.025), end(0.975)] })
}

/// Returns the quantile `q` (0 to 1) of the values: the smallest value that at least the share `q` of all does not
/// exceed. `None` without values.
pub fn quantile_of(mut values: Vec<f64>, q: f64) -> Option<f64> {
    let last = values.len().checked_sub(1)?;
    let at = ((q * values.len() as f64).ceil() as usize).clamp(1, last + 1) - 1;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// Returns a smooth quantile `q` (0 to 1): the mean of the values whose ranks are within 2.5 percentage points of it.
/// It is for values many of which are equal, where the plain quantile would jump. `None` without values.
pub fn smooth_quantile_of(mut values: Vec<f64>, q: f64) -> Option<f64> {
    let rank = |q: f64| ((q * values.len() as f64).round() as usize).min(values.len());
    let (low, high) = (rank(q - REACH), rank(q + REACH));
    if low + 1 >= high {
        return quantile_of(values, q);
    }
    values.select_nth_unstable_by(low, f64::total_cmp);
    let above = &mut values[low..];
    above.select_nth_unstable_by(high - low - 1, f64::total_cmp);
    Some(above[..high - low].iter().sum::<f64>() / (high - low) as f64)
}

/// Returns the 95 % interval of the number of successes in `trials` independent trials that each succeed with
/// probability `p`.
pub fn binomial_95(trials: usize, p: f64) -> [usize; 2] {
    let (mut terms, mut term) = (Vec::with_capacity(trials + 1), (1.0 - p).powi(trials as i32));
    if p >= 1.0 {
        return [trials; 2];
    }
    for k in 0..=trials {
        terms.push(term);
        term *= (trials - k) as f64 / (k + 1) as f64 * p / (1.0 - p);
    }
    let ends = |terms: &mut dyn Iterator<Item = f64>| {
        let mut sum = 0.0;
        terms
            .take_while(|term| {
                sum += term;
                sum <= 0.025
            })
            .count()
    };
    let below = ends(&mut terms.iter().copied());
    let above = ends(&mut terms.iter().rev().copied());
    [below, trials - above]
}

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::random::Seed;

    #[test]
    fn intervals_contain_the_value_and_shrink_with_more_episodes() {
        let width = |episodes: usize| {
            let values: Vec<f64> = (0..episodes).map(|at| (at * 7 % 13) as f64).collect();
            let mean = |at: &[usize]| Some(at.iter().map(|at| values[*at]).sum::<f64>() / at.len() as f64);
            let found = bootstrap(episodes, &mut Seed::of_run(1).stream("test"), mean).unwrap();
            assert!(found.ci95[0] < found.value && found.value < found.ci95[1], "{found:?}");
            found.ci95[1] - found.ci95[0]
        };
        assert!(width(400) < 0.5 * width(40));
        assert_eq!(quantile_of(vec![3.0, 1.0, 2.0, 4.0], 0.5), Some(2.0));
        assert_eq!(quantile_of(Vec::new(), 0.5), None);
        let even: Vec<f64> = (0..1000).rev().map(f64::from).collect();
        assert!((smooth_quantile_of(even, 0.9).unwrap() - 900.0).abs() < 1.0);
        let lumps = |low: usize| (0..1000).map(|at| if at < low { 1.0 } else { 2.0 }).collect();
        let [one, other] = [495, 505].map(|low| smooth_quantile_of(lumps(low), 0.5).unwrap());
        assert!((one - 1.6).abs() < 1e-9 && (other - 1.4).abs() < 1e-9, "and not 2 and 1: {one} {other}");
        assert_eq!((smooth_quantile_of(vec![3.0], 0.9), smooth_quantile_of(Vec::new(), 0.5)), (Some(3.0), None));
    }

    #[test]
    fn the_binomial_interval_is_that_of_tables() {
        // R: qbinom(c(0.025, 0.975), 20, 0.5) is 6 and 14.
        assert_eq!(binomial_95(20, 0.5), [6, 14]);
        assert_eq!(binomial_95(32, 0.95), [28, 32]);
        assert_eq!((binomial_95(5, 1.0), binomial_95(5, 0.0)), ([5, 5], [0, 0]));
    }
}
