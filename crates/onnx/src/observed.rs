//! Observations of a contract: what a graph takes of its own robot.

use murmurate::observation::{Frame, IfStale, Miss, Taking, Unit};
use serde::{Deserialize, Serialize};

/// Observation that a graph takes, a channel or a sense of the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observed {
    /// Name of the channel; the name of the input if it is left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<String>,
    /// Number of values along each axis, without the axis of robots.
    pub shape: Vec<usize>,
    /// Unit of the values.
    pub unit: Unit,
    /// Frame of the values; needed for all that has a direction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame: Option<Frame>,
    /// Angle of the first ray of a sense \[rad\], in the frame of the values.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_rad: Option<f64>,
    /// Distance beyond which an echo of a sense counts as none \[m\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range_m: Option<f32>,
    /// Value that stands for no echo of a sense.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub miss: Option<Miss>,
    /// Age above which the values of a sense are stale \[s\]; needed for a sense.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stale_after_s: Option<f64>,
    /// Values that stand for stale ones of a sense.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub if_stale: Option<IfStale>,
}

impl Observed {
    /// Returns how the policy takes the values of a sense.
    pub(crate) fn taking(&self) -> Taking {
        let Observed { from_rad, range_m, miss, stale_after_s, if_stale, .. } = *self;
        Taking { from_rad, range_m, miss, stale_after_s, if_stale }
    }
}
