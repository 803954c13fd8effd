//! Columns of the tables of studies, as data: the conditions in which the columns of a study differ (mode,
//! communication range, links).

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::PolicyUnderTest;
use super::conditions::{self, Deployed, LinkModel};
use murmurate::deploy::{Deployment, Stepping};
use murmurate::hearing::CommRange;
use murmurate::scenario::Scenario;
use murmurate::trial::Trial;

/// Conditions of one column of a study's table: mode, communication range and links.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Column {
    /// Name of the column in the study's results, such as `onboard-adhoc-noise`.
    pub name: String,
    /// Mode of the deployment, such as `offboard`. `sim` has the conditions of training; all columns with other modes
    /// share one simulated world.
    pub mode: String,
    /// Communication range of the robots in this column.
    pub range: Range,
    /// Model of the links between robots: the radio, or a fixed delay and loss.
    pub medium: LinkModel,
}

/// Communication range of a policy (R_COM of the paper) in a column of a study.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Range {
    /// The communication range that the policy was trained with.
    Own,
    /// Unlimited: every robot uses every message.
    Everyone,
    /// Radius that is drawn for every message from a normal distribution; a message from farther away is not used.
    Within {
        /// Mean of the radius \[m\].
        mean_m: f32,
        /// Standard deviation of the radius \[m\]; zero for a fixed radius.
        std_m: f32,
    },
}

impl Range {
    fn resolved(self) -> Option<CommRange> {
        match self {
            Range::Own => None,
            Range::Everyone => Some(CommRange::fixed(f32::INFINITY)),
            Range::Within { mean_m, std_m } => Some(CommRange { mean_m, std_m }),
        }
    }
}

/// Name of the column of a study that has the conditions of training. The other columns are compared with it.
pub const BASELINE: &str = "sim";

/// Names of the columns of the study `modes`, in the order of the paper's Table I: deployment modes, some with another
/// communication range.
pub const MODES: [&str; 7] = [
    BASELINE,
    "centralized",
    "offboard",
    "onboard-infra",
    "onboard-adhoc",
    "onboard-adhoc-rinf",
    "onboard-adhoc-noise",
];

/// Communication range of the column `onboard-adhoc-noise`: normally distributed with mean 2 m and standard deviation
/// 0.5 m (paper, section V).
const NOISY: Range = Range::Within { mean_m: 2.0, std_m: 0.5 };

/// Delays of messages between robots in the study `delay` \[s\].
pub const DELAYS_S: [f64; 5] = [0.0, 0.02, 0.05, 0.1, 0.2];
/// Probabilities of the loss of messages between robots in the study `delay`, 0 to 1.
pub const LOSSES: [f64; 4] = [0.0, 0.16, 0.3, 0.56];

/// Communication ranges \[m\] of the columns of the study `range`. One more column has an unlimited range.
pub const RANGES_M: [f32; 8] = [0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0];

impl Column {
    /// Returns the column of the study `modes` with this name, one of [`MODES`]; `None` if there is none.
    pub fn of_table(name: &str) -> Option<Column> {
        let name = MODES.into_iter().find(|other| *other == name)?;
        let (mode, range) = match name {
            "onboard-adhoc-rinf" => ("onboard-adhoc", Range::Everyone),
            "onboard-adhoc-noise" => ("onboard-adhoc", NOISY),
            mode => (mode, Range::Own),
        };
        Some(Column { name: name.to_owned(), mode: mode.to_owned(), range, medium: LinkModel::Radio })
    }

    fn adhoc(name: String, range: Range, medium: LinkModel) -> Column {
        Column { name, mode: "onboard-adhoc".to_owned(), range, medium }
    }

    /// Returns a study's columns, one for each combination of a delay \[s\] and a loss probability (0 to 1) of messages
    /// between robots, all in mode `onboard-adhoc`.
    pub fn delays(delays_s: &[f64], losses: &[f64]) -> Vec<Column> {
        let cell = |&delay_s: &f64, &loss: &f64| {
            let name = format!("{:.0}ms-{:.0}%", 1000.0 * delay_s, 100.0 * loss);
            Column::adhoc(name, Range::Own, LinkModel::Impaired { delay_s, loss })
        };
        losses.iter().flat_map(|loss| delays_s.iter().map(move |delay| cell(delay, loss))).collect()
    }

    /// Returns a study's columns, one for each of these communication ranges \[m\] and one more with an unlimited
    /// range, all in mode `onboard-adhoc`.
    pub fn ranges(ranges_m: &[f32]) -> Vec<Column> {
        let within = |&mean_m: &f32| {
            let range = Range::Within { mean_m, std_m: 0.0 };
            Column::adhoc(format!("{mean_m}m"), range, LinkModel::Radio)
        };
        let everyone = Column::adhoc("everyone".to_owned(), Range::Everyone, LinkModel::Radio);
        ranges_m.iter().map(within).chain([everyone]).collect()
    }

    /// Returns the fixed delay \[s\] and the loss probability (0 to 1) of messages between robots in this column;
    /// `None` if its links use the radio.
    pub fn impairment(&self) -> Option<(f64, f64)> {
        match self.medium {
            LinkModel::Radio => None,
            LinkModel::Impaired { delay_s, loss } => Some((delay_s, loss)),
        }
    }

    /// Returns a trial of the policy `tested` in `scenario` under the conditions of this column. `shared` is the
    /// simulated world and radio of all columns except `sim`. Panics if the column's mode is not one of the program's
    /// modes.
    pub fn trial(&self, scenario: Arc<dyn Scenario>, tested: &PolicyUnderTest, shared: &Deployed) -> Trial {
        let mut deployment = Deployment::preset(&self.mode, scenario.robots()).expect("columns name modes");
        deployment.body = shared.body.clone();
        match deployment.stepping {
            Stepping::Lockstep => conditions::training(deployment, scenario, tested),
            Stepping::Seeded => {
                conditions::deployed(deployment, self.medium, self.range.resolved(), scenario, tested, shared)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_of_the_table_exists_and_the_grids_are_complete() {
        for name in MODES {
            assert_eq!(Column::of_table(name).unwrap().name, name);
        }
        assert_eq!(Column::of_table("telepathy"), None);
        let grid = Column::delays(&DELAYS_S, &LOSSES);
        assert_eq!((grid.len(), grid[7].name.as_str()), (20, "50ms-16%"));
        assert_eq!(Column::ranges(&RANGES_M).len(), 9);
    }
}
