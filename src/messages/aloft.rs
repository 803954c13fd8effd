//! State of the flight of a robot that flies.

use serde::{Deserialize, Serialize};

use super::body::{Body, Unfit};
use super::ids::RobotId;
use super::numbered::numbered;

/// State of the flight of a robot that flies, as the robot reports it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", from = "u8")]
pub enum Flight {
    /// The robot stands on the ground with its motors off.
    Grounded,
    /// The robot rises to its height; it is not driven meanwhile.
    Rising,
    /// The robot is at its height, and follows velocities.
    Flying,
    /// The robot lands where it is.
    Landing,
    /// A state of a later version.
    Other = 255,
}

impl Flight {
    /// All states of this version, in the order of their numbers.
    pub(crate) const ALL: [Flight; 4] = [Flight::Grounded, Flight::Rising, Flight::Flying, Flight::Landing];

    /// Returns the state in words for reports and pages, such as `on the ground`.
    pub fn words(self) -> &'static str {
        match self {
            Flight::Grounded => "on the ground",
            Flight::Rising => "rising",
            Flight::Flying => "flying",
            Flight::Landing => "landing",
            Flight::Other => "in the air or not",
        }
    }
}

numbered!(Flight);

/// State of the flight of one robot, from the host of its Body to its Controller and to operators. It is soft state:
/// repeated, and sent at each change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Aloft {
    /// Number of the robot.
    pub robot: RobotId,
    /// State of its flight. A robot that flies and has been ordered to land is `Landing`, whatever it does yet.
    pub flight: Flight,
}

impl Body for Aloft {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        Ok(())
    }
}
