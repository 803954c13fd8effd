//! The states of an episode.

use serde::{Deserialize, Serialize};

/// The states of an episode (paper, section IV: the state machine of agents and of the state server).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "u8", try_from = "u8")]
pub enum Phase {
    /// Waits for a reset; the whole team stands.
    NeedReset,
    /// Robots drive to their starts.
    Resetting,
    /// A robot is at its start and holds it.
    FinishedResetting,
    /// The policy under test drives the robots.
    Running,
    /// A robot has reached its goal; the policy still drives.
    FinishedRunning,
    /// The episode has failed; the whole team stops.
    AbortRunning,
    /// All episodes are done; the whole team stops for good.
    EpisodesFinished,
    /// A host has left; the whole team stands until it is back, and then runs the interrupted episode again.
    Waiting,
}

const PHASES: [Phase; 8] = [
    Phase::NeedReset,
    Phase::Resetting,
    Phase::FinishedResetting,
    Phase::Running,
    Phase::FinishedRunning,
    Phase::AbortRunning,
    Phase::EpisodesFinished,
    Phase::Waiting,
];

impl From<Phase> for u8 {
    fn from(phase: Phase) -> u8 {
        phase as u8
    }
}

impl TryFrom<u8> for Phase {
    type Error = String;
    fn try_from(byte: u8) -> Result<Phase, String> {
        PHASES.get(usize::from(byte)).copied().ok_or_else(|| format!("no phase has the number {byte}"))
    }
}
