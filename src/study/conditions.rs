//! The world and the radio that all deployed columns share: the one place that says what they are.
//!
//! Nothing in a study but this file sets physics or a medium. Whatever differs between columns is in `columns`.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Entrant;
use crate::deploy::{Deployment, Impair, Stepping};
use crate::net::range::CommRange;
use crate::scenario::Scenario;
use crate::trial::Trial;
use crate::world::{Clamp, ContactRule, Physics, Placement};

/// What the deployed columns are deployed in. One set of figures for all of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deployed {
    /// The plant.
    pub plant: String,
    /// Time constant of the drivetrains \[s\]. Fitted: with the authors' weights 0.5 s comes near the makespans that
    /// the paper measured on its robots.
    pub lag_s: f32,
    /// How near to a wall a robot's centre touches it \[m\]: the hull of the published robots.
    pub wall_radius_m: f32,
    /// What messages go through, in words.
    pub radio: String,
}

impl Deployed {
    /// The world and the radio of all deployed columns.
    pub fn shared() -> Deployed {
        Deployed {
            plant: "kinematic".to_owned(),
            lag_s: 0.5,
            wall_radius_m: 0.16,
            radio: "ideal, but for the delay and the loss of a column".to_owned(),
        }
    }

    /// A trial in this world.
    fn trial(&self, mut deployment: Deployment, scenario: Arc<dyn Scenario>, entrant: &Entrant) -> Trial {
        deployment.plant.clone_from(&self.plant);
        let mut trial = Trial::new(deployment, scenario, entrant.model.clone());
        // Nothing but lag and controllers limits acceleration there.
        trial.physics = Physics {
            contacts: ContactRule::Judge,
            wall_radius_m: self.wall_radius_m,
            acceleration_m_s2: f32::INFINITY,
            lag_s: self.lag_s,
        };
        (trial.handling, trial.clamp) = (entrant.handling.messages, entrant.handling.clamp);
        trial
    }
}

/// What is done to messages between robots, beyond what the shared radio does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Impairment {
    /// How long each takes \[s\].
    pub delay_s: f64,
    /// The share that a listener misses, 0 to 1.
    pub loss: f64,
}

/// A trial in a deployed column.
pub fn deployed(
    mode: &str,
    impairment: Impairment,
    range: Option<CommRange>,
    scenario: Arc<dyn Scenario>,
    entrant: &Entrant,
) -> Trial {
    let mut deployment = Deployment::preset(mode, scenario.robots()).expect("columns name modes");
    let Impairment { delay_s, loss } = impairment;
    if delay_s > 0.0 || loss > 0.0 {
        deployment = deployment.impaired(Some(delay_s), Some(loss), Impair::Latent).expect("columns are sound");
    }
    let mut trial = Deployed::shared().trial(deployment, scenario, entrant);
    trial.range = range;
    trial
}

/// A trial in the conditions of training: lock step, exact placement, perfect messages, and the training world with its
/// own limit of acceleration.
pub fn training(scenario: Arc<dyn Scenario>, entrant: &Entrant) -> Trial {
    let deployment = Deployment::preset("sim", scenario.robots()).expect("it is a preset");
    assert_eq!((deployment.stepping, deployment.placement), (Stepping::Lockstep, Placement::Exact));
    let mut trial = Trial::new(deployment, scenario, entrant.model.clone()).clamp(Clamp::Training);
    trial.handling = entrant.handling.messages;
    trial
}
