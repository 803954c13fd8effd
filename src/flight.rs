//! Settings of robots that fly: at which height, and how an emergency stop ends in the air.

use serde::{Deserialize, Serialize};

use crate::time::Span;

/// Greatest height of a robot above the ground \[m\]: beyond it, laws and winds of the open air count, which this
/// project knows nothing of.
pub const MOST_M: f32 = 50.0;

/// Longest time for which a process that ends waits for the landing of its robots. One that has not landed by then is
/// its firmware's.
pub const LANDING: Span = Span::from_millis(15_000);

/// Action of a robot in the air after an emergency stop, once it has hovered for a second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum InAir {
    /// It lands where it is.
    #[default]
    Land,
    /// It hovers until the team goes on, its battery is low or its host ends.
    Hover,
}

/// Settings of one robot that flies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Height above the ground at which the robot is driven \[m\], above 0 and at most [`MOST_M`]: the same for all
    /// episodes.
    pub height_m: f32,
    /// Action of the robot after an emergency stop.
    pub stop: InAir,
}
