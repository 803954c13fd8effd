//! Channels of the observation that a team has: named arrays with a unit, computed at each step.

use std::borrow::Cow;
use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Observation;
use super::sense::Sense;
use crate::messages::geometry::Task;
use crate::messages::local::Sensation;

/// Unit of a channel's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Unit {
    /// Metres.
    #[serde(rename = "m")]
    Metre,
    /// Metres per second.
    #[serde(rename = "m/s")]
    MetrePerSecond,
    /// Metres per second squared.
    #[serde(rename = "m/s2")]
    MetrePerSecondSquared,
    /// Radians.
    #[serde(rename = "rad")]
    Radian,
    /// Radians per second.
    #[serde(rename = "rad/s")]
    RadianPerSecond,
    /// Seconds.
    #[serde(rename = "s")]
    Second,
    /// A number without a unit.
    #[serde(rename = "1")]
    One,
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Unit::Metre => "m",
            Unit::MetrePerSecond => "m/s",
            Unit::MetrePerSecondSquared => "m/s2",
            Unit::Radian => "rad",
            Unit::RadianPerSecond => "rad/s",
            Unit::Second => "s",
            Unit::One => "1",
        })
    }
}

/// Kind of a channel's values, by which they are transformed into another frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Numbers that are the same in every frame.
    Number,
    /// Pairs (x, y) that are directions with a length, such as velocities and differences of positions.
    Vector,
    /// Pairs (x, y) that are positions.
    Point,
    /// Angles \[rad\], counter-clockwise from the x axis.
    Angle,
}

/// State of a robot at a step, from which the values of channels are computed.
#[derive(Clone, Copy, Debug)]
pub struct Known<'a> {
    /// Start and goal of the robot \[m\], world frame.
    pub task: &'a Task,
    /// Start and goal of each robot of the team \[m\], world frame, in the order of robot ids; `None` for one that the
    /// robot has not been told yet.
    pub team: &'a [Option<Task>],
    /// Observation of the robot in the policy frame; its `values` are empty.
    pub own: &'a Observation<'a>,
    /// Newest values of each sense of the robot, in the order of the senses; empty in a team without senses.
    pub sensed: &'a [Option<Sensation>],
}

/// Function that writes a channel's values in the policy frame; NaN is written for a value that is not known. The first
/// argument is the channel's memory of the robot.
type Write = dyn Fn(&mut [f32], &Known, &mut [f32]) + Send + Sync;

/// Channel of the observation that a team has: its name, shape, unit, and the function that computes its values.
#[derive(Clone)]
pub struct Channel {
    /// Name by which a policy asks for the channel, such as `velocity`.
    pub name: Cow<'static, str>,
    /// Description in one line, for lists of channels.
    pub about: &'static str,
    /// Number of values along each axis of the array.
    pub shape: Vec<usize>,
    /// Largest number of values along the first axis that a policy may take, where it has the choice.
    pub most: Option<usize>,
    /// Unit of all values.
    pub unit: Unit,
    /// Kind of the values.
    pub quantity: Quantity,
    /// Number of floats that the channel remembers of a robot's episode, such as what the robot has seen.
    pub memory: usize,
    pub(super) write: Arc<Write>,
    /// Sense whose values the channel has; `None` for a channel that `write` computes.
    pub(super) sense: Option<Sense>,
}

impl fmt::Debug for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Channel").field("name", &self.name).field("shape", &self.shape).finish_non_exhaustive()
    }
}

impl Channel {
    /// Makes a channel of arrays of the given `shape`. `write` computes its values in the policy frame, one after the
    /// other with the last axis running fastest; `quantity` says how they are transformed into other frames.
    ///
    /// # Panics
    /// If the array is empty, or if pairs do not fill the last axis.
    pub fn new(
        name: impl Into<Cow<'static, str>>,
        about: &'static str,
        (shape, unit, quantity): (Vec<usize>, Unit, Quantity),
        write: impl Fn(&Known, &mut [f32]) + Send + Sync + 'static,
    ) -> Channel {
        let write = move |_: &mut [f32], known: &Known, out: &mut [f32]| write(known, out);
        Channel::remembering(name, about, (shape, unit, quantity), 0, write)
    }

    /// Makes a channel as [`Channel::new`] does, with a memory: `memory` floats for each robot, zero when an episode
    /// begins, which `write` gets in each step of the robot's policy, and may change.
    ///
    /// # Panics
    /// As `Channel::new` does.
    pub fn remembering(
        name: impl Into<Cow<'static, str>>,
        about: &'static str,
        (shape, unit, quantity): (Vec<usize>, Unit, Quantity),
        memory: usize,
        write: impl Fn(&mut [f32], &Known, &mut [f32]) + Send + Sync + 'static,
    ) -> Channel {
        let name = name.into();
        assert!(floats(&shape) > 0, "the channel '{name}' has no values");
        let pairs = matches!(quantity, Quantity::Vector | Quantity::Point);
        assert!(!pairs || shape.last() == Some(&2), "the last axis of the channel '{name}' is not 2, for x and y");
        Channel { name, about, shape, most: None, unit, quantity, memory, write: Arc::new(write), sense: None }
    }

    /// Returns the channel as one of which a policy takes 1 to `most` values along the first axis, as it says itself.
    pub fn up_to(self, most: usize) -> Channel {
        Channel { most: Some(most), ..self }
    }

    /// Returns whether a policy may take an array of this shape.
    pub(super) fn has(&self, shape: &[usize]) -> bool {
        match (self.most, shape.split_first(), self.shape.split_first()) {
            (Some(most), Some((rows, theirs)), Some((_, ours))) => (1..=most).contains(rows) && theirs == ours,
            _ => self.shape == shape,
        }
    }
}

/// Returns the number of values of an array of this shape.
pub(super) fn floats(shape: &[usize]) -> usize {
    shape.iter().try_fold(1, |product: usize, axis| product.checked_mul(*axis)).unwrap_or(usize::MAX)
}
