//! The result of one episode.

use serde::Serialize;

use crate::scenario::judge::Verdict;

/// What came of one episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Episode {
    /// Which repeat of the experiment.
    pub repeat: u32,
    /// Which episode of the repeat.
    pub episode: u32,
    /// How it ended.
    pub verdict: Verdict,
    /// When the last robot arrived, since the episode began \[s\]; only for a success.
    pub makespan_s: Option<f64>,
    /// How long the reset before it took \[s\].
    pub reset_s: f64,
    /// The smallest distance between two robots' centres \[m\].
    pub min_separation_m: f32,
}
