//! World and radio that all deployed columns share.
//!
//! No other module of a study sets physics or links. `columns` has the differences between columns.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::PolicyUnderTest;
use crate::deploy::{Deployment, Impair, Stepping};
use crate::hearing::CommRange;
use crate::net::media::radio::Radio;
use crate::scenario::Scenario;
use crate::trial::Trial;
use crate::world::{Clamp, Placement};

/// World and radio of the deployed columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deployed {
    /// Name of the plant; the plant sets the physics of the robots (`Physics::robomaster`, `docs/world.md`).
    pub plant: String,
    /// Radio of every wireless link, a preset of `net::media::radio` (`docs/radio.md`).
    pub radio: String,
}

impl Deployed {
    /// Returns the world and the radio of all deployed columns.
    pub fn shared() -> Deployed {
        Deployed { plant: "rigid".to_owned(), radio: "paper".to_owned() }
    }
}

/// Model of the links in a column.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkModel {
    /// The radio that all deployed columns share.
    Radio,
    /// Fixed delay and independent loss for messages between robots; all other messages are perfect.
    Impaired {
        /// One-way delay \[s\].
        delay_s: f64,
        /// Probability that a receiver loses a message, 0 to 1.
        loss: f64,
    },
}

/// Returns a trial of one episode of a policy, for any column except `sim`.
pub fn deployed(
    mut deployment: Deployment,
    medium: LinkModel,
    range: Option<CommRange>,
    scenario: Arc<dyn Scenario>,
    tested: &PolicyUnderTest,
) -> Trial {
    let shared = Deployed::shared();
    match medium {
        LinkModel::Radio => deployment = deployment.with_radio(&Radio::preset(&shared.radio).expect("it is a preset")),
        LinkModel::Impaired { delay_s, loss } if delay_s > 0.0 || loss > 0.0 => {
            deployment =
                deployment.impaired(Some(delay_s), Some(loss), Impair::Latent).expect("columns pass their check");
        }
        LinkModel::Impaired { .. } => {}
    }
    let mut trial = Trial::new(deployment, scenario, tested.model.clone()).plant(&shared.plant);
    trial = trial.clamp(tested.handling.clamp);
    (trial.handling, trial.range) = (tested.handling.messages, range);
    trial
}

/// Returns a trial of one episode under the conditions of training: lock step, exact placement, perfect messages, and
/// the training world with its limit of acceleration. Panics unless the deployment has lock step and exact placement.
pub fn training(deployment: Deployment, scenario: Arc<dyn Scenario>, tested: &PolicyUnderTest) -> Trial {
    assert_eq!((deployment.stepping, deployment.placement), (Stepping::Lockstep, Placement::Exact));
    let mut trial = Trial::new(deployment, scenario, tested.model.clone()).clamp(Clamp::Training);
    trial.handling = tested.handling.messages;
    trial
}
