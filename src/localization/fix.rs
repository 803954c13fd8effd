//! Quality of a satellite receiver's fix, by the corrections that it has.

use serde::Deserialize;

/// Quality of a satellite position fix, in ascending order of accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
pub enum Fix {
    /// Fix in three dimensions without correction data.
    #[serde(rename = "3d")]
    ThreeD,
    /// Fix with corrections of the code measurement: accurate to metres or decimetres.
    #[serde(rename = "dgps")]
    Dgps,
    /// Fix with corrections of the carrier phase (RTK) whose ambiguities are not resolved: accurate to decimetres.
    #[serde(rename = "rtk-float")]
    RtkFloat,
    /// Fix with corrections of the carrier phase (RTK) whose ambiguities are resolved: accurate to centimetres.
    #[serde(rename = "rtk-fixed")]
    RtkFixed,
}
