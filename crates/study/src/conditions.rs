//! World and radio of a study that all its deployed columns (every column but `sim`, the conditions of training)
//! share.
//!
//! No other module of a study sets physics or links. The module `columns` has the differences between columns.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::PolicyUnderTest;
use murmurate::chassis;
use murmurate::deploy::conditions::Conditions;
use murmurate::deploy::{Deployment, Impair, Stepping};
use murmurate::hearing::CommRange;
use murmurate::net::media::radio::Radio;
use murmurate::safety::Clamp;
use murmurate::scenario::Scenario;
use murmurate::trial::Trial;
use murmurate::world::Placement;

/// World and radio of a study's deployed columns: all columns but `sim`, which has the conditions of training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Deployed {
    /// Name of the plant (simulator of the robots' motion), such as `rigid`.
    pub plant: String,
    /// Name of a preset of the radio, such as `paper`, for every wireless link (`docs/radio.md`).
    pub radio: String,
    /// Conditions from a file, such as those fitted to a recorded run. They change the plant's physics, and may replace
    /// the radio by a delay and loss of messages between robots. `None` if no file is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fitted: Option<Conditions>,
    /// Chassis of all robots, with its limits of speed. It applies to all columns of the study, the column `sim`
    /// included. The default is holonomic and without limits.
    #[serde(default, skip_serializing_if = "chassis::Settings::is_empty")]
    pub body: chassis::Settings,
}

impl Deployed {
    /// Returns the default world and radio of the deployed columns (all but `sim`): plant `rigid` and radio `paper`.
    pub fn shared() -> Deployed {
        Deployed { plant: "rigid".to_owned(), radio: "paper".to_owned(), fitted: None, body: Default::default() }
    }

    /// Returns this world and radio, changed by the conditions of a file. A plant that the file names replaces the
    /// present plant.
    pub fn with(self, conditions: Conditions) -> Deployed {
        let plant = conditions.plant.clone().unwrap_or(self.plant);
        Deployed { plant, fitted: Some(conditions), ..self }
    }
}

/// Model of the links between robots in a column of a study.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkModel {
    /// The radio that all columns of the study share, except `sim`.
    Radio,
    /// Fixed delay and independent loss for messages between robots; all other messages are perfect.
    Impaired {
        /// One-way delay \[s\].
        delay_s: f64,
        /// Probability that a receiver loses a message, 0 to 1.
        loss: f64,
    },
}

/// Returns a trial of the policy `tested` in `deployment`, for a column of a study other than `sim`. `medium` is the
/// model of the links between robots, `range` the communication range (`None` for the policy's own), and `shared` the
/// simulated world and radio. Panics if a radio, delay or loss is invalid.
pub fn deployed(
    mut deployment: Deployment,
    medium: LinkModel,
    range: Option<CommRange>,
    scenario: Arc<dyn Scenario>,
    tested: &PolicyUnderTest,
    shared: &Deployed,
) -> Trial {
    let fitted = shared.fitted.clone().unwrap_or_default();
    deployment = deployment.for_task(scenario.task_file());
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

/// Returns a trial of the policy `tested` under the conditions of training: lock step, exact placement, perfect
/// messages, and the training world with its limit of acceleration. Panics unless `deployment` has lock step and exact
/// placement.
pub fn training(deployment: Deployment, scenario: Arc<dyn Scenario>, tested: &PolicyUnderTest) -> Trial {
    assert_eq!((deployment.stepping, deployment.placement), (Stepping::Lockstep, Placement::Exact));
    let mut trial = Trial::new(deployment, scenario, tested.model.clone()).clamp(Clamp::Training);
    trial = trial.safety(tested.handling.safety);
    trial.handling = tested.handling.messages;
    trial
}
