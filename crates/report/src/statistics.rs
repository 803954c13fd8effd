//! Statistics of reports: Wilson interval, quantiles, and mean with its interval.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Quantile of the standard normal distribution for a two-sided confidence of 95 %: about 1.96.
const Z_95: f64 = 1.959_963_984_540_054;

/// Returns the two ends of the 95 % Wilson score interval of the proportion of `successes` in `trials` (Wilson, JASA
/// 1927); 0 and 1 if there are no trials.
pub fn wilson_95(successes: usize, trials: usize) -> [f64; 2] {
    if trials == 0 {
        return [0.0, 1.0];
    }
    let (n, z2) = (trials as f64, Z_95 * Z_95);
    let p = successes as f64 / n;
    let centre = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
    let half = Z_95 / (1.0 + z2 / n) * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
    // At 0 and at 1 an end is the estimate itself, which rounding would put a little outside.
    [(centre - half).clamp(0.0, p), (centre + half).clamp(p, 1.0)]
}

/// Returns the quantile `q` (0 to 1) of the values, interpolated linearly; `None` if there are no values.
pub fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().checked_sub(1)?;
    let at = q * last as f64;
    let (low, high) = (sorted[at.floor() as usize], sorted[at.ceil() as usize]);
    Some(low + (high - low) * at.fract())
}

/// Returns the mean of the values, and the two ends of its 95 % confidence interval by Student's t distribution: both
/// ends equal the mean for a single value, whose deviation is unknown. `None` if there are no values.
pub fn mean_95(values: &[f64]) -> Option<(f64, [f64; 2])> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let degrees = values.len().checked_sub(1)?;
    let squares = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
    let half = if degrees == 0 { 0.0 } else { student_95(degrees) * (squares / (n - 1.0) / n).sqrt() };
    Some((mean, [mean - half, mean + half]))
}

/// Returns the quantile of Student's t distribution with so many degrees of freedom, one at least, for a two-sided
/// confidence of 95 %.
fn student_95(degrees: usize) -> f64 {
    let distribution = StudentsT::new(0.0, 1.0, degrees as f64).expect("it has a degree of freedom");
    distribution.inverse_cdf(0.975)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_matches_a_worked_example() {
        // Newcombe, Statistics in Medicine 1998, table I: 81 of 263 gives 0.2553 to 0.3662.
        let [low, high] = wilson_95(81, 263);
        assert!((low - 0.2553).abs() < 5e-5 && (high - 0.3662).abs() < 5e-5, "{low} {high}");
        assert_eq!(wilson_95(0, 0), [0.0, 1.0]);
    }

    #[test]
    fn an_interval_holds_its_estimate_so_that_bars_have_no_negative_length() {
        for trials in 1..=2000 {
            for successes in [0, 1, trials / 2, trials - 1, trials] {
                let (p, [low, high]) = (successes as f64 / trials as f64, wilson_95(successes, trials));
                assert!(0.0 <= low && low <= p && p <= high && high <= 1.0, "{successes} of {trials}: {low} {high}");
                assert!(low < high, "{successes} of {trials}");
            }
            assert_eq!((wilson_95(0, trials)[0], wilson_95(trials, trials)[1]), (0.0, 1.0));
        }
    }

    #[test]
    fn the_interval_of_a_mean_is_that_of_student() {
        // Tabulated quantiles, as in Abramowitz and Stegun, table 26.10.
        for (degrees, t) in [(1, 12.706), (3, 3.182), (4, 2.776), (10, 2.228), (30, 2.042), (1000, 1.962)] {
            assert!((student_95(degrees) - t).abs() < 5e-4, "{degrees}: {}", student_95(degrees));
        }
        // Standard deviation 1.581, standard error 0.7071, four degrees of freedom.
        let (mean, [low, high]) = mean_95(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert!(
            (mean - 3.0).abs() < 1e-12 && (high - 3.0 - 2.776 * std::f64::consts::FRAC_1_SQRT_2).abs() < 2e-3,
            "{high}"
        );
        assert!((low + high - 6.0).abs() < 1e-12);
        assert_eq!(mean_95(&[2.5]), Some((2.5, [2.5, 2.5])));
        assert_eq!(mean_95(&[]), None);
    }

    #[test]
    fn the_median_is_interpolated() {
        assert_eq!(quantile(&[3.0, 1.0, 2.0], 0.5), Some(2.0));
        assert_eq!(quantile(&[4.0, 1.0, 2.0, 3.0], 0.5), Some(2.5));
        assert_eq!(quantile(&[], 0.5), None);
    }
}
