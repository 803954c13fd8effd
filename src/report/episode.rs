//! Result of one episode.

use serde::{Deserialize, Deserializer, Serialize};

use crate::scenario::judge::Verdict;

/// Data from which an episode is judged: true states of a simulation, or readings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Judged {
    /// True states of the robots, from a World actor that simulates the whole team.
    #[default]
    Truth,
    /// Readings (measured states) that have arrived at the host of the state server. Between two measurements nothing
    /// is known.
    Readings,
}

/// Result of one episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Index of the episode's trial among the repeats, from 0.
    pub repeat: u32,
    /// Index of the episode in its trial, from 0.
    pub episode: u32,
    /// Outcome of the episode: success, collision, timeout, aborted or unseen.
    pub verdict: Verdict,
    /// Time from the start of the episode to the last robot's arrival \[s\]; `None` if the episode failed.
    pub makespan_s: Option<f64>,
    /// Duration of the reset before the episode (the drive to the starts) \[s\]; 0 if the robots were placed at their
    /// starts.
    pub reset_s: f64,
    /// Smallest distance between the centres of two robots during the episode \[m\]; infinite if it is unknown.
    #[serde(deserialize_with = "infinite_if_null")]
    pub min_separation_m: f32,
    /// Data from which the episode was judged.
    #[serde(default)]
    pub judged: Judged,
    /// Mean cost of the steps of the episode, in the unit of the scenario's cost; `None` in a scenario with goals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cost: Option<f64>,
}

impl Episode {
    /// Returns the verdict in words, with the makespan of a success, or with the cost.
    pub fn in_words(&self) -> String {
        let makespan = self.makespan_s.map_or_else(String::new, |makespan| format!(" in {makespan:.2} s"));
        let cost = self.cost.map_or_else(String::new, |cost| format!(", cost {cost:.4}"));
        format!("{}{makespan}{cost}", self.verdict.word())
    }
}

/// Reads null as infinity, which JSON cannot express.
fn infinite_if_null<'de, D: Deserializer<'de>>(from: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f32::INFINITY))
}
