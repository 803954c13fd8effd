//! Action of a policy in its contract: the meaning of the output `action`, with its unit, frame and limits.

use murmurate::config::ConfigError;
use murmurate::observation::{Frame, Unit};
use serde::{Deserialize, Serialize};

/// Meaning of the output `action`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Action {
    /// Kind of action.
    pub kind: Kind,
    /// Unit of the output: m/s for velocities and twists, m/s2 for accelerations. Of a choice it is the unit of
    /// `choices`: m/s2 for accelerations, and left out for velocities.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<Unit>,
    /// Frame of the output, or of the velocities of a choice.
    #[serde(default)]
    pub frame: Frame,
    /// Largest value along each axis, in the unit of the output; what is larger is clamped. For a twist it is the speed
    /// ahead. Left out for a choice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<f32>,
    /// Largest speed along each axis that is commanded \[m/s\]; `limit` for velocities if it is left out. Needed for
    /// accelerations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed_limit: Option<f32>,
    /// Distribution of which the outputs are the parameters.
    #[serde(default)]
    pub distribution: Distribution,
    /// Velocities \[m/s\] or accelerations \[m/s²\] of a choice, in the order of the outputs; the largest output is
    /// taken.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub choices: Vec<[f32; 2]>,
}

/// Kind of action.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Velocity: x and y.
    Velocity,
    /// Acceleration: x and y, added to the measured velocity over one period.
    Acceleration,
    /// Speed ahead and yaw rate \[rad/s\] of a robot with a differential drive.
    Twist,
    /// One of several velocities or accelerations.
    Choice,
}

/// Distribution of which the outputs of a policy are the parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Distribution {
    /// None: the output is the action.
    #[default]
    None,
    /// Independent normal distributions: the means, then the natural logarithms of the standard deviations.
    DiagonalNormal,
}

impl Action {
    /// Returns the number of floats of the output `action`.
    pub fn floats(&self) -> usize {
        match (self.kind, self.distribution) {
            (Kind::Choice, _) => self.choices.len(),
            (_, Distribution::None) => 2,
            (_, Distribution::DiagonalNormal) => 4,
        }
    }

    /// Returns the largest speed along each axis that is commanded \[m/s\].
    pub(crate) fn speed_limit(&self) -> f32 {
        let largest = self.choices.iter().flatten().fold(0.0_f32, |most, axis| most.max(axis.abs()));
        let own = if self.kind == Kind::Choice { Some(largest) } else { self.limit };
        self.speed_limit.or(own).unwrap_or(f32::NAN)
    }

    /// Returns whether the action is an acceleration, added to the measured velocity over one period.
    pub fn accelerates(&self) -> bool {
        self.kind == Kind::Acceleration || self.unit == Some(Unit::MetrePerSecondSquared)
    }

    /// Checks what no type says. An error names the first wrong field.
    pub(crate) fn check(&self) -> Result<(), ConfigError> {
        let refuse = |field: &str, why: &str| Err(ConfigError::field(format!("action.{field}"), why));
        let Action { kind, unit, limit, speed_limit, distribution, choices, frame } = self;
        let wanted = match kind {
            Kind::Velocity | Kind::Twist => Some(Unit::MetrePerSecond),
            Kind::Acceleration => Some(Unit::MetrePerSecondSquared),
            Kind::Choice => None,
        };
        let above_zero = |value: &f32| *value > 0.0 && value.is_finite();
        if *unit != wanted && !(*kind == Kind::Choice && self.accelerates()) {
            let why = wanted.map_or("a choice has none, or m/s2 for accelerations".to_owned(), |unit| {
                format!("it has to be {unit} for this kind")
            });
            return refuse("unit", &why);
        }
        if *kind == Kind::Choice {
            if choices.is_empty() || choices.len() > 256 || choices.iter().flatten().any(|axis| !axis.is_finite()) {
                return refuse("choices", "a choice needs 1 to 256 velocities [x, y] in m/s, or accelerations");
            }
            if limit.is_some() || *distribution != Distribution::None {
                return refuse("limit", "a choice has neither a limit nor a distribution");
            }
        } else if !choices.is_empty() {
            return refuse("choices", "only a choice has them");
        } else if !limit.as_ref().is_some_and(above_zero) {
            return refuse("limit", "it is missing or not above zero");
        }
        if self.accelerates() && speed_limit.is_none() {
            return refuse("speed_limit", "it is missing: the largest speed along each axis [m/s]");
        }
        if speed_limit.as_ref().is_some_and(|limit| !above_zero(limit)) {
            return refuse("speed_limit", "it is not above zero");
        }
        if *kind == Kind::Twist && *frame != Frame::Body {
            return refuse("frame", "a twist is in the frame 'body'");
        }
        Ok(())
    }
}
