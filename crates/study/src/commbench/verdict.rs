//! Scores of episodes, and verdicts on two results of the same episodes: the paired difference of their means with an
//! interval by the bootstrap.

use murmurate::random::{RngExt, Seed};
use murmurate::results::episode::Episode;
use murmurate::scenario::judge::Verdict as Outcome;
use murmurate_report::statistics::quantile;
use serde::Serialize;

/// Confidence of an interval. At 95 %, every twentieth of several hundred comparisons of equal results would be a
/// difference by chance, and with another seed some of them would be the opposite one.
pub const LEVEL: f64 = 0.999;

/// Number of resamples of a bootstrap: five are beyond each end of an interval.
const RESAMPLES: usize = 10_000;

/// Measure of an episode. Whatever its unit, one direction is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Measure {
    /// Whether the episode did not fail, 1 or 0; more is better.
    Done,
    /// Makespan \[s\], and the time limit of the task for an episode that failed; less is better. For a task without
    /// goals, the cost of the episode in its own unit.
    Score,
}

/// Measures of an episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scored {
    /// Value of [`Measure::Done`].
    pub done: f64,
    /// Value of [`Measure::Score`]; `None` for an aborted episode of a task without goals, whose cost is of its part.
    pub score: Option<f64>,
}

impl Scored {
    /// Returns the measures of an episode. `limit_s` is the time limit of its task \[s\] if that has goals.
    pub fn of(episode: &Episode, limit_s: Option<f64>) -> Scored {
        let score = match limit_s {
            Some(limit_s) => Some(episode.makespan_s.unwrap_or(limit_s)),
            None => episode.cost.filter(|_| episode.verdict != Outcome::Aborted),
        };
        Scored { done: f64::from(u8::from(!episode.verdict.is_failure())), score }
    }

    fn measure(&self, measure: Measure) -> Option<f64> {
        match measure {
            Measure::Done => Some(self.done),
            Measure::Score => self.score,
        }
    }
}

/// Whether a result is better than another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The interval of the difference is on the better side of zero.
    Better,
    /// The interval of the difference contains zero, or there is none.
    Tie,
    /// The interval of the difference is on the worse side of zero.
    Worse,
}

impl Verdict {
    /// Returns the sign of the verdict in tables: `+`, `=` or `-`.
    pub fn sign(self) -> &'static str {
        match self {
            Verdict::Better => "+",
            Verdict::Tie => "=",
            Verdict::Worse => "-",
        }
    }
}

/// Paired difference of two results.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Number of episodes in which both have a value.
    pub pairs: usize,
    /// Mean of the differences, in the unit of the measure.
    pub difference: f64,
    /// Ends of its interval at [`LEVEL`].
    pub interval: [f64; 2],
    /// Whether the first result is better than the second.
    pub verdict: Verdict,
}

impl Difference {
    /// Returns the difference of two results of the same episodes in their order, the first minus the second, with its
    /// interval by the bootstrap over episodes (Efron, 1979), whose random numbers come from a stream of `seed` with
    /// the name `name`. `None` without an episode in which both have a value.
    pub fn of((one, other): (&[Scored], &[Scored]), measure: Measure, (seed, name): (u64, &str)) -> Option<Difference> {
        let pairs = one.iter().zip(other).filter_map(|(a, b)| Some(a.measure(measure)? - b.measure(measure)?));
        let differences: Vec<f64> = pairs.collect();
        let (difference, interval) = bootstrap(&differences, seed, name)?;
        let more = if interval[0] > 0.0 {
            Verdict::Better
        } else if interval[1] < 0.0 {
            Verdict::Worse
        } else {
            Verdict::Tie
        };
        let verdict = match (measure, more) {
            (Measure::Score, Verdict::Better) => Verdict::Worse,
            (Measure::Score, Verdict::Worse) => Verdict::Better,
            (_, more) => more,
        };
        Some(Difference { pairs: differences.len(), difference, interval, verdict })
    }
}

/// Returns the mean of the values, and the ends of its interval at [`LEVEL`]; `None` without values.
fn bootstrap(values: &[f64], seed: u64, name: &str) -> Option<(f64, [f64; 2])> {
    let count = values.len();
    let first = *values.first()?;
    let mean = values.iter().sum::<f64>() / count as f64;
    if values.iter().all(|value| *value == first) {
        // One value repeated says nothing of its spread: without a difference it is a tie, and otherwise too, if few.
        let end = if count < FEWEST { 0.0 } else { first };
        return Some((first, [first.min(end), first.max(end)]));
    }
    let mut stream = Seed::of_run(seed).stream(&format!("commbench/bootstrap/{name}"));
    let mut resample = || (0..count).map(|_| values[stream.random_range(0..count)]).sum::<f64>() / count as f64;
    let means: Vec<f64> = (0..RESAMPLES).map(|_| resample()).collect();
    let end = |q| quantile(&means, q).unwrap_or(mean);
    let tail = (1.0 - LEVEL) / 2.0;
    let (low, high) = (end(tail), end(1.0 - tail));
    // Of a few episodes no interval at this level can be told.
    let (low, high) = if count < FEWEST { (low.min(0.0), high.max(0.0)) } else { (low, high) };
    Some((mean, [low.min(mean), high.max(mean)]))
}

/// Number of pairs below which every comparison is a tie: if all of them had one sign by chance, that would happen once
/// in 1024 times.
const FEWEST: usize = 11;

#[cfg(test)]
mod tests {
    use super::*;
    use murmurate::results::episode::Judged;

    fn scored(values: &[f64]) -> Vec<Scored> {
        values.iter().map(|value| Scored { done: f64::from(u8::from(*value < 9.0)), score: Some(*value) }).collect()
    }

    fn difference(one: &[f64], other: &[f64], measure: Measure) -> Difference {
        Difference::of((&scored(one), &scored(other)), measure, (3, "a test")).expect("there are pairs")
    }

    fn episode(verdict: Outcome, makespan_s: Option<f64>, cost: Option<f64>) -> Episode {
        let (repeat, episode, reset_s, min_separation_m) = (0, 0, 0.0, 1.0);
        let (judged, reason) = (Judged::Truth, None);
        Episode { repeat, episode, verdict, makespan_s, reset_s, min_separation_m, judged, cost, reason }
    }

    #[test]
    fn a_failed_episode_counts_as_the_time_limit_and_an_aborted_one_has_no_cost() {
        let failed = Scored::of(&episode(Outcome::Timeout, None, None), Some(25.0));
        assert_eq!(failed, Scored { done: 0.0, score: Some(25.0) });
        let arrived = Scored::of(&episode(Outcome::Success, Some(6.5), None), Some(25.0));
        assert_eq!(arrived, Scored { done: 1.0, score: Some(6.5) });
        let collided = Scored::of(&episode(Outcome::RobotCollision, None, Some(0.3)), None);
        assert_eq!(collided, Scored { done: 0.0, score: Some(0.3) });
        assert_eq!(Scored::of(&episode(Outcome::Aborted, None, Some(0.1)), None).score, None);
    }

    #[test]
    fn less_time_and_more_successes_are_better() {
        let (fast, slow): (Vec<f64>, Vec<f64>) = (0..40).map(|at| (5.0 + 0.01 * f64::from(at), 12.0)).unzip();
        for measure in [Measure::Done, Measure::Score] {
            assert_eq!(difference(&fast, &slow, measure).verdict, Verdict::Better, "{measure:?}");
            assert_eq!(difference(&slow, &fast, measure).verdict, Verdict::Worse, "{measure:?}");
            assert_eq!(difference(&fast, &fast, measure).verdict, Verdict::Tie, "{measure:?}");
        }
        let found = difference(&fast, &slow, Measure::Score);
        assert!((found.difference + 6.805).abs() < 1e-9 && found.interval[1] < 0.0, "{found:?}");
    }

    #[test]
    fn a_difference_that_changes_its_sign_from_pair_to_pair_is_a_tie() {
        let one: Vec<f64> = (0..60).map(|at| 5.0 + f64::from(at % 7)).collect();
        let other: Vec<f64> = (0..60).map(|at| 5.0 + f64::from((at + 3) % 7)).collect();
        let found = difference(&one, &other, Measure::Score);
        assert_eq!(found.verdict, Verdict::Tie);
        assert!(found.interval[0] < found.difference && found.difference < found.interval[1], "{found:?}");
    }

    #[test]
    fn a_few_episodes_are_no_difference_and_neither_are_seven_failures_of_many() {
        assert_eq!(difference(&[1.0; 10], &[2.0; 10], Measure::Score).verdict, Verdict::Tie);
        assert_eq!(difference(&[1.0; 11], &[2.0; 11], Measure::Score).verdict, Verdict::Better);
        let failed = |failures: usize| (0..200).map(|at| if at < failures { 20.0 } else { 5.0 }).collect::<Vec<f64>>();
        assert_eq!(difference(&failed(5), &failed(0), Measure::Done).verdict, Verdict::Tie);
        assert_eq!(difference(&failed(20), &failed(0), Measure::Done).verdict, Verdict::Worse);
    }

    #[test]
    fn an_interval_depends_on_seed_and_name_alone() {
        let values: Vec<f64> = (0..50).map(|at| f64::from(at * at % 17)).collect();
        let of = |seed, name: &str| bootstrap(&values, seed, name).expect("there are values");
        assert_eq!(of(1, "a"), of(1, "a"));
        assert_ne!(of(1, "a"), of(2, "a"));
        assert_ne!(of(1, "a"), of(1, "b"));
    }
}
