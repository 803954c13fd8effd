//! What came of some episodes, counted: the columns that every table and every JSON object has.

use serde::Serialize;

use super::episode::Episode;
use super::statistics::{quantile, wilson_95};
use crate::scenario::judge::Verdict;

/// What came of some episodes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outcomes {
    /// Episodes that have a result.
    pub episodes: usize,
    /// Episodes that succeeded.
    pub successes: usize,
    /// Their share.
    pub success_rate: f64,
    /// The Wilson interval of the share, 95 %.
    pub success_ci95: [f64; 2],
    /// Median over the successes of when the last robot arrived \[s\].
    pub makespan_median_s: Option<f64>,
    /// Quartiles of the same \[s\].
    pub makespan_quartiles_s: Option<[f64; 2]>,
    /// Episodes that failed because two robots came too near to each other.
    pub collisions_robot: usize,
    /// Episodes that failed because a wall was touched.
    pub collisions_wall: usize,
    /// Episodes that failed because not all robots arrived in time.
    pub timeouts: usize,
    /// Episodes that the state server gave up.
    pub aborts: usize,
    /// Episodes in which a robot was out of sight for too long, where readings are judged.
    pub unseen: usize,
}

impl Outcomes {
    /// Counts the episodes. The share of none is zero.
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
            collisions_robot: count(Verdict::RobotCollision),
            collisions_wall: count(Verdict::WallCollision),
            timeouts: count(Verdict::Timeout),
            aborts: count(Verdict::Aborted),
            unseen: count(Verdict::Unseen),
        }
    }
}
