//! Robots of a team in a contract: the number by which a graph tells them apart.

use murmurate::config::ConfigError;
use murmurate::messages::ids::RobotId;
use serde::{Deserialize, Serialize};

/// Largest number of robots that a policy may tell apart.
pub const MAX_ROBOTS: usize = 4096;

/// Robots of a team as the graphs of a policy tell them apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Robots {
    /// Form of the input `id`, the robot's place in its team.
    pub id: Id,
    /// Number of robots of the largest team, 1 to 4096. For a one-hot input it is the input's size if it is left out,
    /// and for a number no bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub most: Option<usize>,
}

/// Form of the input `id`, the robot's place in its team, which counts from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Id {
    /// A number for each robot of the largest team: 1 at the robot's place, else 0.
    OneHot,
    /// The place itself as one float.
    Number,
}

impl Robots {
    /// Returns the number of floats of the input `id` that the contract knows; `None` if the graph has to say it.
    pub fn floats(&self) -> Option<usize> {
        match self.id {
            Id::OneHot => self.most,
            Id::Number => Some(1),
        }
    }

    /// Checks what no type says. `in_python` says that no graph gives the size of the input. An error names the field.
    pub(crate) fn check(&self, in_python: bool) -> Result<(), ConfigError> {
        match self.most {
            Some(most) if !(1..=MAX_ROBOTS).contains(&most) => {
                Err(ConfigError::field("robots.most", format!("{most} is not 1 to {MAX_ROBOTS}")))
            }
            None if self.id == Id::OneHot && in_python => {
                let why = "it is missing: the number of robots of the largest team, which is the size of 'id'";
                Err(ConfigError::field("robots.most", why))
            }
            _ => Ok(()),
        }
    }

    /// Writes the place of `robot` in its team into `floats`, the input `id` of one robot. An error is a sentence.
    pub(crate) fn write(&self, robot: RobotId, floats: &mut [f32]) -> Result<(), String> {
        let index = robot.index();
        let most = if self.id == Id::OneHot { floats.len() } else { self.most.unwrap_or(usize::MAX) };
        if index >= most {
            return Err(format!(
                "its input 'id' tells {most} robots apart, and {robot} is number {} of its team",
                index + 1
            ));
        }
        match self.id {
            Id::OneHot => floats[index] = 1.0,
            Id::Number => floats[0] = index as f32,
        }
        Ok(())
    }
}
