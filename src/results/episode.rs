//! Result of one episode.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize};

use crate::messages::ids::RobotId;
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

/// Cause for which the state server has aborted an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum AbortCause {
    /// No heartbeat of the robot has arrived for a second.
    Missing,
    /// The robot's guard has stopped it and given the episode up, as for a policy's invalid output.
    GaveUp,
    /// The robot was not at its start when the time for the reset was over.
    NotInPlace,
    /// The team's emergency stop was engaged, or the team was held.
    Stopped,
    /// The state server was restarted during the episode.
    ServerRestarted,
    /// The episode has exceeded its time limit.
    TimeLimit,
    /// The robot's host was removed from the team's roster, so what the robot does is unknown.
    Revoked,
    /// The robot's measured pose has jumped further than it can drive, so that nobody knows where it is.
    PoseJumped,
}

/// Reason why an episode was aborted, with the robot that was the cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AbortReason {
    /// Cause of the end.
    pub cause: AbortCause,
    /// First robot to which the cause applies; `None` if the cause is none of a robot.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<RobotId>,
    /// Number of further robots that have prevented the episode at the same time.
    #[serde(default)]
    pub others: usize,
}

impl AbortReason {
    /// Returns a reason that is none of a robot.
    pub(crate) fn of_team(cause: AbortCause) -> AbortReason {
        AbortReason { cause, robot: None, others: 0 }
    }

    /// Returns the reason for these robots, each with its cause; `None` without any.
    pub(crate) fn of_robots(robots: &[(RobotId, AbortCause)]) -> Option<AbortReason> {
        let (robot, cause) = *robots.first()?;
        Some(AbortReason { cause, robot: Some(robot), others: robots.len() - 1 })
    }
}

impl fmt::Display for AbortReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let who = self.robot.map_or_else(|| "a robot".to_owned(), |robot| robot.to_string());
        match self.cause {
            AbortCause::Missing => write!(f, "{who} has not been heard for 1 s")?,
            AbortCause::GaveUp => write!(f, "{who} has stopped and gives up")?,
            AbortCause::NotInPlace => write!(f, "{who} was not in place in time")?,
            AbortCause::Stopped => f.write_str("emergency stop")?,
            AbortCause::ServerRestarted => f.write_str("the state server was restarted")?,
            AbortCause::TimeLimit => f.write_str("out of time")?,
            AbortCause::Revoked => write!(f, "{who} was revoked and may move uncontrolled")?,
            AbortCause::PoseJumped => write!(f, "the pose of {who} has jumped")?,
        }
        match self.others {
            0 => Ok(()),
            1 => f.write_str(", and one more robot"),
            more => write!(f, ", and {more} more robots"),
        }
    }
}

/// Result of one episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Episode {
    /// Index of the episode's trial among the repeats, from 0. What people read counts from 1.
    pub repeat: u32,
    /// Index of the episode in its trial, from 0. What people read counts from 1.
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
    /// Reason why the episode was aborted; `None` if it was not, or if the process that judges does not know it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<AbortReason>,
}

impl Episode {
    /// Returns the number of the episode in its trial, from 1, as people read it.
    pub fn number(&self) -> u32 {
        self.episode + 1
    }

    /// Returns the verdict in words, with the makespan of a success or the reason of an aborted one, or with the cost.
    pub fn in_words(&self) -> String {
        let makespan = self.makespan_s.map_or_else(String::new, |makespan| format!(" in {makespan:.2} s"));
        let cost = self.cost.map_or_else(String::new, |cost| format!(", cost {cost:.4}"));
        let reason = self.reason.map_or_else(String::new, |reason| format!(": {reason}"));
        format!("{}{makespan}{cost}{reason}", self.verdict.word())
    }
}

/// Reads null as infinity, which JSON cannot express.
fn infinite_if_null<'de, D: Deserializer<'de>>(from: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f32::INFINITY))
}
