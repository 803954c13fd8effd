//! The result of one episode.

use serde::{Deserialize, Deserializer, Serialize};

use crate::scenario::judge::Verdict;

/// What a verdict was found from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Judged {
    /// The true states of a World that simulates the whole team.
    #[default]
    Truth,
    /// Readings, as they have arrived at the host of the state server: it knows robots where and when they were
    /// measured, and nothing of what happened between.
    Readings,
}

/// What came of one episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
    /// The smallest distance between two robots' centres \[m\]; infinite if no two were seen together.
    #[serde(deserialize_with = "infinite_if_null")]
    pub min_separation_m: f32,
    /// What this was found from.
    #[serde(default)]
    pub judged: Judged,
}

/// JSON has no infinity, which is the distance in a team of one.
fn infinite_if_null<'de, D: Deserializer<'de>>(from: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f32::INFINITY))
}
