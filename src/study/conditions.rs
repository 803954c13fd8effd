//! The world and the radio that all deployed columns share: the one place that says what they are.
//!
//! Nothing in a study but this file sets physics or a medium. Whatever differs between columns is in `columns`.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Entrant;
use crate::deploy::{Deployment, Impair, Stepping};
use crate::hearing::CommRange;
use crate::net::media::radio::Radio;
use crate::scenario::Scenario;
use crate::trial::Trial;
use crate::world::{Clamp, Placement};

/// What the deployed columns are deployed in. One set of figures for all of them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deployed {
    /// The plant; what its robots are like is what it says (`Physics::robomaster`, `docs/world.md`).
    pub plant: String,
    /// The radio on every link that would have one, a preset of `net::radio` (`docs/radio.md`).
    pub radio: String,
}

impl Deployed {
    /// The world and the radio of all deployed columns.
    pub fn shared() -> Deployed {
        Deployed { plant: "rigid".to_owned(), radio: "paper".to_owned() }
    }
}

/// What messages go through.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Medium {
    /// The radio that all deployed columns share.
    Radio,
    /// Links that are as slow and as lossy as is said, for messages between robots, and perfect for all others.
    Impaired {
        /// How long each takes \[s\].
        delay_s: f64,
        /// The share that a listener misses, 0 to 1.
        loss: f64,
    },
}

/// A trial in a deployed column.
pub fn deployed(
    mut deployment: Deployment,
    medium: Medium,
    range: Option<CommRange>,
    scenario: Arc<dyn Scenario>,
    entrant: &Entrant,
) -> Trial {
    let shared = Deployed::shared();
    match medium {
        Medium::Radio => deployment = deployment.with_radio(&Radio::preset(&shared.radio).expect("it is a preset")),
        Medium::Impaired { delay_s, loss } if delay_s > 0.0 || loss > 0.0 => {
            deployment = deployment.impaired(Some(delay_s), Some(loss), Impair::Latent).expect("columns are sound");
        }
        Medium::Impaired { .. } => {}
    }
    let mut trial = Trial::new(deployment, scenario, entrant.model.clone()).plant(&shared.plant);
    trial = trial.clamp(entrant.handling.clamp);
    (trial.handling, trial.range) = (entrant.handling.messages, range);
    trial
}

/// A trial in the conditions of training: lock step, exact placement, perfect messages, and the training world with its
/// own limit of acceleration. The deployment is one in lock step.
pub fn training(deployment: Deployment, scenario: Arc<dyn Scenario>, entrant: &Entrant) -> Trial {
    assert_eq!((deployment.stepping, deployment.placement), (Stepping::Lockstep, Placement::Exact));
    let mut trial = Trial::new(deployment, scenario, entrant.model.clone()).clamp(Clamp::Training);
    trial.handling = entrant.handling.messages;
    trial
}
