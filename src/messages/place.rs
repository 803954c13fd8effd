//! Placement of a robot by a person, and what the host that measures robots knows of their poses.

use serde::{Deserialize, Serialize};

use super::body::MAX_BLOCK;
use super::body::{Body, Publisher, Unfit};
use super::geometry::Pose;
use super::ids::{HostId, RobotId};
use super::numbered::numbered;

/// Statement of an operator of where a robot is, sent to every host; the host that measures the robot acts on it. It is
/// repeated until that host answers with a [`Placed`] in a [`Located`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Host number of the operator.
    pub by: HostId,
    /// Number of this statement, drawn at random, by which its repetitions and its answer are recognised.
    pub number: u32,
    /// Robot that the operator has looked at.
    pub robot: RobotId,
    /// Position of the robot's centre, and its heading, in the world frame.
    pub pose: Pose,
}

/// Whether the pose of a robot is known to the host that measures it, and if not, why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", from = "u8")]
pub enum Whereabouts {
    /// The pose is known: readings are published.
    #[default]
    Known,
    /// The measured pose has jumped further than the robot can drive. It is known again once poses have agreed with
    /// each other for a while.
    Jumped,
    /// Odometry has jumped, or begun anew. Where the robot is, only a person can say.
    Adrift,
    /// Several robots have jumped by one motion: the frame of their source has changed. A person has to put it right,
    /// or to say where the robots are.
    Shifted,
    /// The pose is at the place of another robot: the source has exchanged the two. A person has to put it right.
    Exchanged,
    /// The pose is unknown for a cause of a later version.
    Other = 255,
}

impl Whereabouts {
    /// All values of this version, in the order of their numbers.
    pub(crate) const ALL: [Whereabouts; 5] =
        [Whereabouts::Known, Whereabouts::Jumped, Whereabouts::Adrift, Whereabouts::Shifted, Whereabouts::Exchanged];

    /// Whether the robot has to stand.
    pub fn is_lost(self) -> bool {
        self != Whereabouts::Known
    }

    /// Returns what has happened, as the predicate of a sentence about a robot, such as `its pose has jumped`.
    pub fn reason(self) -> &'static str {
        match self {
            Whereabouts::Known => "its pose is known",
            Whereabouts::Jumped => "its pose has jumped further than it can drive",
            Whereabouts::Adrift => "its odometry has jumped or begun anew",
            Whereabouts::Shifted => "its pose has jumped as those of others: the frame of their source has changed",
            Whereabouts::Exchanged => "its pose has jumped to another robot's place: their source has exchanged them",
            Whereabouts::Other => "its pose is lost, for a cause that only a later version knows",
        }
    }

    /// Returns what makes the pose known again, as a sentence for a person.
    pub fn remedy(self) -> &'static str {
        match self {
            Whereabouts::Known => "nothing has to be done",
            Whereabouts::Jumped => "it goes on once its poses have agreed with each other for settle_s",
            Whereabouts::Adrift => "look where it is, and say so with 'murmurate place'",
            Whereabouts::Shifted => "put the source's frame right, or say where each is with 'murmurate place'",
            Whereabouts::Exchanged => "correct them in the source, or say where each is with 'murmurate place'",
            Whereabouts::Other => "see the log of the host that measures it",
        }
    }
}

/// Answer of the host that measures a robot to the [`Place`] of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "u8", from = "u8")]
pub enum PlaceAnswer {
    /// Taken over: readings of the robot continue from this pose.
    Aligned,
    /// Taken over: the source measures the robot there, within half a metre and half a radian.
    Agrees,
    /// Refused: the source measures the robot elsewhere, and its frame cannot be moved from here.
    Differs,
    /// Refused: the robot moves, or has moved in the last half second.
    Moves,
    /// Refused: nothing has been measured of the robot in the last second.
    Unmeasured,
    /// Refused, for a reason of a later version.
    Other = 255,
}

impl PlaceAnswer {
    /// All values of this version, in the order of their numbers.
    pub(crate) const ALL: [PlaceAnswer; 5] =
        [PlaceAnswer::Aligned, PlaceAnswer::Agrees, PlaceAnswer::Differs, PlaceAnswer::Moves, PlaceAnswer::Unmeasured];

    /// Returns the value in a word, as in JSON.
    pub fn word(self) -> &'static str {
        match self {
            PlaceAnswer::Aligned => "aligned",
            PlaceAnswer::Agrees => "agrees",
            PlaceAnswer::Differs => "differs",
            PlaceAnswer::Moves => "moves",
            PlaceAnswer::Unmeasured => "unmeasured",
            PlaceAnswer::Other => "other",
        }
    }

    /// Whether the statement has taken effect.
    pub fn is_taken(self) -> bool {
        matches!(self, PlaceAnswer::Aligned | PlaceAnswer::Agrees)
    }
}

/// Answer to one [`Place`] of an operator.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Placed {
    /// Operator whose statement is answered.
    pub by: HostId,
    /// Number of the statement.
    pub number: u32,
    /// Robot of the statement.
    pub robot: RobotId,
    /// What has become of the statement.
    pub verdict: PlaceAnswer,
    /// Pose at which the source measures the robot, in the world frame; `None` if it measures none.
    pub measured: Option<Pose>,
}

/// What the host that measures robots knows of the poses of those that are lost, or were until just now. It is sent at
/// each change and repeated while a robot is lost, to the hosts of the robots' agents, the state server and operators.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Located {
    /// Host that measures the robots.
    pub host: HostId,
    /// Robots that are lost, or that were until just now, at most 64 (`MAX_BLOCK`) in one message.
    pub robots: Vec<(RobotId, Whereabouts)>,
    /// Answer to an operator; `None` if the message answers nobody.
    pub answer: Option<Placed>,
}

impl Body for Place {
    fn robot(&self) -> RobotId {
        self.robot
    }

    fn check(&self) -> Result<(), Unfit> {
        self.pose.is_sound().then_some(()).ok_or(Unfit::Number)
    }

    fn author(&self) -> Option<HostId> {
        Some(self.by)
    }
}

impl Body for Located {
    fn robot(&self) -> RobotId {
        self.robots.first().map_or(RobotId(0), |(robot, _)| *robot)
    }

    fn check(&self) -> Result<(), Unfit> {
        match () {
            () if self.answer.and_then(|answer| answer.measured).is_some_and(|pose| !pose.is_sound()) => {
                Err(Unfit::Number)
            }
            () if self.robots.len() > MAX_BLOCK => Err(Unfit::Length),
            () => Ok(()),
        }
    }

    fn author(&self) -> Option<HostId> {
        Some(self.host)
    }

    /// It is about robots that the sender measures.
    fn is_for(&self, is: impl Fn(Publisher, RobotId) -> bool) -> bool {
        let answered = self.answer.iter().map(|answer| answer.robot);
        self.robots.iter().map(|(robot, _)| *robot).chain(answered).all(|robot| is(Publisher::Localizer, robot))
    }
}

numbered!(Whereabouts, PlaceAnswer);
