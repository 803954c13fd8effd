//! Observations in the file of a policy: channels and senses of the robot that it takes, with shape, unit and frame.

use serde::{Deserialize, Serialize};

use super::bound::{MAX_FLOATS, Request};
use super::channel::Unit;
use super::frame::Frame;
use super::sense::{IfStale, Miss, Taking};

/// Observation that a policy takes, a channel or a sense of the robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observed {
    /// Name of the channel; the name of the policy's input if it is left out.
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
    /// Returns the number of values, if the shape is one: one to three axes, for at most [`MAX_FLOATS`] values.
    ///
    /// # Errors
    /// The reason, if it is none.
    pub fn floats(&self) -> Result<usize, String> {
        let axes = 1..=3;
        let floats = self.shape.iter().try_fold(1, |floats: usize, axis| floats.checked_mul(*axis));
        let floats = floats.filter(|floats| axes.contains(&self.shape.len()) && (1..=MAX_FLOATS).contains(floats));
        floats.ok_or_else(|| format!("it is not 1 to 3 numbers above zero for at most {MAX_FLOATS} values"))
    }

    /// Returns the request for this observation by the policy's input named `input`.
    pub fn request(&self, input: &str) -> Request {
        let Observed { from_rad, range_m, miss, stale_after_s, if_stale, .. } = *self;
        Request {
            input: input.to_owned(),
            channel: self.source.as_deref().unwrap_or(input).to_owned(),
            shape: self.shape.clone(),
            unit: self.unit,
            frame: self.frame,
            taking: Taking { from_rad, range_m, miss, stale_after_s, if_stale },
        }
    }
}
