//! World and radio of a study that all its deployed columns (every column but `sim`, the conditions of training)
//! share.
//!
//! No other module of a study sets physics or links. The module `columns` has the differences between columns.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::PolicyUnderTest;
use crate::chassis;
use crate::deploy::conditions::Conditions;
use crate::deploy::{Deployment, Impair, Stepping};
use crate::hearing::CommRange;
use crate::net::media::radio::Radio;
use crate::scenario::Scenario;
use crate::trial::Trial;
use crate::world::{Clamp, Placement};

/// World and radio of a study's deployed columns: all columns but `sim`, which has the conditions of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deployed {
    /// Name of the plant; the plant sets the physics of the robots (`Physics::robomaster`, `docs/world.md`).
    pub plant: String,
    /// Radio of every wireless link, a preset of `net::media::radio` (`docs/radio.md`).
    pub radio: String,
    /// Conditions from a file, such as those fitted to a recorded run: they change the physics of the plant, and
    /// may replace the radio by a delay and loss of messages between robots. `None` for plant and radio alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fitted: Option<Conditions>,
    /// Chassis of all robots, in the column `sim`, too: a robot keeps its wheels. The default is holonomic and
    /// without limits.
    #[serde(default, skip_serializing_if = "chassis::Settings::is_empty")]
    pub body: chassis::Settings,
}

impl Deployed {
    /// Returns the default world and radio of all deployed columns: plant `rigid` and radio `paper`.
    pub fn shared() -> Deployed {
        Deployed { plant: "rigid".to_owned(), radio: "paper".to_owned(), fitted: None, body: Default::default() }
    }

    /// Returns this world and radio with the conditions of a file (`fitted`). If the file names a plant, it
    /// replaces the plant.
    pub fn with(self, conditions: Conditions) -> Deployed {
        let plant = conditions.plant.clone().unwrap_or(self.plant);
        Deployed { plant, fitted: Some(conditions), ..self }
    }
}

/// Model of the links between robots in a column of a study.
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

/// Returns a trial of one episode of the policy `tested` in a deployed column of a study, which is any column
/// except `sim`. `medium` is the model of its links, `range` the communication range (`None` for that of the policy),
/// `shared` the world and radio.
pub fn deployed(
    mut deployment: Deployment,
    medium: LinkModel,
    range: Option<CommRange>,
    scenario: Arc<dyn Scenario>,
    tested: &PolicyUnderTest,
    shared: &Deployed,
) -> Trial {
    let fitted = shared.fitted.clone().unwrap_or_default();
    match medium {
        // In a mode in which no message between robots crosses a link, there is nothing to act on.
        LinkModel::Radio if fitted.impair() => deployment = fitted.links(deployment.clone()).unwrap_or(deployment),
        LinkModel::Radio => deployment = deployment.with_radio(&Radio::preset(&shared.radio).expect("it is a preset")),
        LinkModel::Impaired { delay_s, loss } if delay_s > 0.0 || loss > 0.0 => {
            deployment =
                deployment.impaired(Some(delay_s), Some(loss), Impair::Latent).expect("columns pass their check");
        }
        LinkModel::Impaired { .. } => {}
    }
    let mut trial = Trial::new(deployment, scenario, tested.model.clone()).plant(&shared.plant);
    trial.physics = fitted.physics(trial.physics, None);
    trial = trial.clamp(tested.handling.clamp).safety(tested.handling.safety);
    (trial.handling, trial.range) = (tested.handling.messages, range);
    trial
}

/// Returns a trial of one episode of the policy `tested` under the conditions of training: lock step, exact
/// placement, perfect messages, and the training world with its limit of acceleration. Panics unless the deployment has
/// lock step and exact placement.
pub fn training(deployment: Deployment, scenario: Arc<dyn Scenario>, tested: &PolicyUnderTest) -> Trial {
    assert_eq!((deployment.stepping, deployment.placement), (Stepping::Lockstep, Placement::Exact));
    let mut trial = Trial::new(deployment, scenario, tested.model.clone()).clamp(Clamp::Training);
    trial = trial.safety(tested.handling.safety);
    trial.handling = tested.handling.messages;
    trial
}
