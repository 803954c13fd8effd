//! Counts of verdicts, with the same names in every table, JSON object and CSV file.

use serde::Serialize;

use crate::statistics::{mean_95, quantile, wilson_95};
use murmurate::results::episode::Episode;
use murmurate::scenario::judge::Verdict;

/// Counts of verdicts, success rate and makespan of a set of episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outcomes {
    /// Number of episodes with a verdict.
    pub episodes: usize,
    /// Number of successful episodes.
    pub(crate) successes: usize,
    /// Share of successful episodes, 0 to 1.
    pub success_rate: f64,
    /// Lower and upper end of the 95 % Wilson interval of the success rate.
    pub success_ci95: [f64; 2],
    /// Median makespan of the successful episodes \[s\]; `None` without a success.
    pub makespan_median_s: Option<f64>,
    /// Lower and upper quartile of the makespan of the successful episodes \[s\]; `None` without a success.
    pub makespan_quartiles_s: Option<[f64; 2]>,
    /// Number of episodes that failed because two robots came too close to each other.
    pub robot_collisions: usize,
    /// Number of episodes that failed because a robot touched a wall.
    pub wall_collisions: usize,
    /// Number of episodes that failed because not all robots arrived in time.
    pub timeouts: usize,
    /// Number of episodes that the state server ended before they had a verdict, such as after an emergency stop or
    /// when a robot failed.
    pub(crate) aborted: usize,
    /// Number of episodes that could not be judged, because a robot was not measured for more than a second. Zero if
    /// true states are judged.
    pub(crate) unseen: usize,
    /// Costs of the episodes; left out in a scenario with goals. In one without, nothing succeeds: the counts and rates
    /// of successes are zero, and `completed` counts the episodes without a failure.
    #[serde(flatten)]
    pub cost: Option<CostOutcomes>,
}

/// Costs of some episodes of a scenario without goals. An episode with a collision lasts its time and counts, too; an
/// aborted one has a cost only of its part.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CostOutcomes {
    /// Number of episodes that lasted their time without a collision.
    pub completed: usize,
    /// Mean cost of all episodes but the aborted ones, in the unit of the scenario's cost.
    pub cost_mean: f64,
    /// Interval of `cost_mean` at 95 %, by Student's t distribution.
    pub cost_ci95: [f64; 2],
    /// Median cost of these episodes.
    pub cost_median: f64,
}

impl CostOutcomes {
    /// Returns the costs of the episodes; `None` if none of them has one.
    pub(crate) fn of(episodes: &[Episode]) -> Option<CostOutcomes> {
        let lasted = episodes.iter().filter(|episode| episode.verdict != Verdict::Aborted);
        let costs: Vec<f64> = lasted.filter_map(|episode| episode.cost).collect();
        let (cost_mean, cost_ci95) = mean_95(&costs)?;
        let cost_median = quantile(&costs, 0.5)?;
        let completed = episodes.iter().filter(|episode| episode.verdict == Verdict::Completed).count();
        Some(CostOutcomes { completed, cost_mean, cost_ci95, cost_median })
    }

    /// Returns the mean cost and its interval as text, such as `0.0123 (95 %: 0.0120 to 0.0126)`.
    pub fn in_words(&self) -> String {
        let [low, high] = self.cost_ci95;
        format!("{:.4} (95 %: {low:.4} to {high:.4})", self.cost_mean)
    }
}

impl Outcomes {
    /// Counts the verdicts of the episodes and computes their statistics. The success rate of no episodes is 0.
    pub fn of(episodes: &[Episode]) -> Outcomes {
        let count = |verdict| episodes.iter().filter(|episode| episode.verdict == verdict).count();
        let makespans: Vec<f64> = episodes.iter().filter_map(|episode| episode.makespan_s).collect();
        let at = |q| quantile(&makespans, q);
        let successes = count(Verdict::Success);
        Outcomes {
            episodes: episodes.len(),
            successes,
            success_rate: successes as f64 / episodes.len().max(1) as f64,
            success_ci95: wilson_95(successes, episodes.len()),
            makespan_median_s: at(0.5),
            makespan_quartiles_s: at(0.25).zip(at(0.75)).map(|(first, third)| [first, third]),
            robot_collisions: count(Verdict::RobotCollision),
            wall_collisions: count(Verdict::WallCollision),
            timeouts: count(Verdict::Timeout),
            aborted: count(Verdict::Aborted),
            unseen: count(Verdict::Unseen),
            cost: CostOutcomes::of(episodes),
        }
    }

    /// Describes the failures, such as "2 robot collisions, 1 timeout"; "none" without failures.
    pub fn failures(&self) -> String {
        let kinds = [
            (self.robot_collisions, "robot collision", "robot collisions"),
            (self.wall_collisions, "wall collision", "wall collisions"),
            (self.timeouts, "timeout", "timeouts"),
            (self.aborted, "aborted", "aborted"),
            (self.unseen, "unseen", "unseen"),
        ];
        let found = kinds.iter().filter(|(count, ..)| *count > 0);
        let words: Vec<String> =
            found.map(|(count, one, many)| format!("{count} {}", if *count == 1 { one } else { many })).collect();
        if words.is_empty() { "none".to_owned() } else { words.join(", ") }
    }
}
