//! The phases (states) of an episode, one attempt at the team's task.

use serde::{Deserialize, Serialize};

use super::numbered::numbered;

/// Phase of an episode (one attempt at the team's task), of a single robot or of the whole team. The phases are those
/// of the state machine in section IV of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "u8", from = "u8")]
pub enum Phase {
    /// The robot or the whole team stands, and waits for the reset: the drive to the starts of the next episode.
    NeedReset,
    /// Robots drive to their start positions.
    Resetting,
    /// The robot has reached its start position and stays there.
    FinishedResetting,
    /// The policy under test drives the robots.
    Running,
    /// The robot has reached its goal; the policy under test still drives.
    FinishedRunning,
    /// The episode has failed; the whole team stops.
    AbortRunning,
    /// All episodes are done; the whole team stops for good.
    EpisodesFinished,
    /// The whole team stands, because a host has left or an operator holds the team during a reset; afterwards the
    /// interrupted episode begins again.
    Waiting,
    /// A phase of a later version: the robot or the whole team stands.
    Other = 255,
}

impl Phase {
    /// All phases of this version, in the order of their numbers.
    pub(crate) const ALL: [Phase; 8] = [
        Phase::NeedReset,
        Phase::Resetting,
        Phase::FinishedResetting,
        Phase::Running,
        Phase::FinishedRunning,
        Phase::AbortRunning,
        Phase::EpisodesFinished,
        Phase::Waiting,
    ];
}

numbered!(Phase);
