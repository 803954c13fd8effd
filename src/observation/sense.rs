//! Form of the values of a sense, and how a policy takes them, as its file says.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

/// Directions and range of the rays of a sense whose values are distances \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep {
    /// Angle of the first ray \[rad\], counter-clockwise from the direction ahead of the robot.
    pub from_rad: f64,
    /// Angle from each ray to the next one \[rad\].
    pub step_rad: f64,
    /// Whether the rays go all around the robot.
    pub around: bool,
    /// Largest distance at which something is seen \[m\].
    pub range_m: f32,
    /// Place from which the rays go \[m\]: ahead of the robot's centre and to the left.
    pub mount_m: [f32; 2],
}

/// How far an opening may be from a whole turn and still be one \[rad\]: that of a decimal with three digits.
pub const WHOLE_RAD: f64 = 1e-3;

impl Sweep {
    /// Returns the directions of `rays` rays of which the first is at `from_rad` and the last `opening_rad` further; in
    /// a whole turn the rays divide it evenly \[rad\]. They go from the robot's centre.
    pub fn new(rays: usize, (from_rad, opening_rad): (f64, f64), range_m: f32) -> Sweep {
        let around = opening_rad >= TAU - WHOLE_RAD;
        let gaps = if around { rays } else { rays.saturating_sub(1).max(1) };
        let whole = if around { TAU } else { opening_rad };
        Sweep { from_rad, step_rad: whole / gaps as f64, around, range_m, mount_m: [0.0; 2] }
    }
}

/// How a policy takes the values of a sense, as its file says.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Taking {
    /// Angle of the first ray \[rad\], counter-clockwise in the frame of the values; that of the sense if left out.
    pub from_rad: Option<f64>,
    /// Distance beyond which an echo counts as none \[m\]; the range of the sense if left out.
    pub range_m: Option<f32>,
    /// Value that stands for no echo.
    pub miss: Option<Miss>,
    /// Age from the arrival of the values above which they are stale \[s\].
    pub stale_after_s: Option<f64>,
    /// Values that stand for stale ones.
    pub if_stale: Option<IfStale>,
}

/// Value that stands for no echo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Miss {
    /// This number, in the unit of the values.
    Number(f32),
    /// A value with a name.
    Named(NamedMiss),
}

/// Name of a value that stands for no echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NamedMiss {
    /// The range.
    Range,
    /// Zero.
    Zero,
}

/// Values that stand for stale ones, or for those that have not come yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IfStale {
    /// Nothing: its step counts as none, and the robot stands.
    #[default]
    Stop,
    /// The values that came last, whatever their age. Before the first ones it is as for `Stop`.
    Last,
    /// No echo in all values.
    Miss,
}

/// Source of the values of a channel that is a sense.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sense {
    /// Index of the sense among those of the robot.
    pub index: usize,
    /// Directions of the rays of a sense whose values are distances.
    pub sweep: Option<Sweep>,
}
