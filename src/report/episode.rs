//! Result of one episode.

use serde::{Deserialize, Deserializer, Serialize};

use crate::scenario::judge::Verdict;

/// Data from which an episode is judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Judged {
    /// True states, from a World that simulates the whole team.
    #[default]
    Truth,
    /// Readings that have arrived at the host of the state server: positions at the times of measurement only.
    Readings,
}

/// Result of one episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Index of the episode's trial among the repeats, from 0.
    pub repeat: u32,
    /// Index of the episode in its trial, from 0.
    pub episode: u32,
    /// Verdict on the episode.
    pub verdict: Verdict,
    /// Time from the start of the episode to the last robot's arrival \[s\]; `None` if the episode failed.
    pub makespan_s: Option<f64>,
    /// Duration of the reset before the episode \[s\]; 0 if the robots were placed.
    pub reset_s: f64,
    /// Smallest distance between two robots' centres during the episode \[m\]; infinite if no two robots were seen
    /// together.
    #[serde(deserialize_with = "infinite_if_null")]
    pub min_separation_m: f32,
    /// Data from which the episode was judged.
    #[serde(default)]
    pub judged: Judged,
}

impl Episode {
    /// Returns the verdict, and for a success the makespan, in words.
    pub fn in_words(&self) -> String {
        let makespan = self.makespan_s.map_or_else(String::new, |makespan| format!(" in {makespan:.2} s"));
        format!("{}{makespan}", self.verdict.word())
    }
}

/// Reads null as infinity, which JSON cannot express.
fn infinite_if_null<'de, D: Deserializer<'de>>(from: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f32::INFINITY))
}
