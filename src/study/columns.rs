//! The columns of each study, as data: what differs between them, and nothing else.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::Entrant;
use super::conditions::{self, Medium};
use crate::deploy::{Deployment, Stepping};
use crate::hearing::CommRange;
use crate::scenario::Scenario;
use crate::trial::Trial;

/// One column.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Column {
    /// Its name in results.
    pub name: String,
    /// Which mode of the paper; `sim` stands for the conditions of training, all others share one deployed world.
    pub mode: String,
    /// Who is near enough to be heard.
    pub range: Range,
    /// What messages go through.
    pub medium: Medium,
}

/// Who is near enough to be heard: the communication range R_COM of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Range {
    /// As the policy was trained.
    Own,
    /// Everyone.
    Everyone,
    /// Within a radius \[m\], drawn for every message from a normal distribution.
    Within {
        /// Mean \[m\].
        mean_m: f32,
        /// Standard deviation \[m\].
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

/// The name of the column that all others are measured against.
pub const BASELINE: &str = "sim";

/// The names of the columns of the paper's Table I, in its order.
pub const MODES: [&str; 7] = [
    BASELINE,
    "centralized",
    "offboard",
    "onboard-infra",
    "onboard-adhoc",
    "onboard-adhoc-rinf",
    "onboard-adhoc-noise",
];

/// R_COM ~ N(2, 0.5) m (paper, section V).
const NOISY: Range = Range::Within { mean_m: 2.0, std_m: 0.5 };

/// The delays \[s\] and losses of the grid.
pub const DELAYS_S: [f64; 5] = [0.0, 0.02, 0.05, 0.1, 0.2];
/// See `DELAYS_S`.
pub const LOSSES: [f64; 4] = [0.0, 0.16, 0.3, 0.56];

/// The communication radii of the sweep \[m\]; the last column hears everyone.
pub const RANGES_M: [f32; 8] = [0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0];

impl Column {
    /// The column of Table I that has this name.
    pub fn of_table(name: &str) -> Option<Column> {
        let name = MODES.into_iter().find(|other| *other == name)?;
        let (mode, range) = match name {
            "onboard-adhoc-rinf" => ("onboard-adhoc", Range::Everyone),
            "onboard-adhoc-noise" => ("onboard-adhoc", NOISY),
            mode => (mode, Range::Own),
        };
        Some(Column { name: name.to_owned(), mode: mode.to_owned(), range, medium: Medium::Radio })
    }

    fn adhoc(name: String, range: Range, medium: Medium) -> Column {
        Column { name, mode: "onboard-adhoc".to_owned(), range, medium }
    }

    /// Every delay with every loss.
    pub fn delays(delays_s: &[f64], losses: &[f64]) -> Vec<Column> {
        let cell = |&delay_s: &f64, &loss: &f64| {
            let name = format!("{:.0}ms-{:.0}%", 1000.0 * delay_s, 100.0 * loss);
            Column::adhoc(name, Range::Own, Medium::Impaired { delay_s, loss })
        };
        losses.iter().flat_map(|loss| delays_s.iter().map(move |delay| cell(delay, loss))).collect()
    }

    /// Every radius, and no limit at all.
    pub fn ranges(ranges_m: &[f32]) -> Vec<Column> {
        let within = |&mean_m: &f32| {
            let range = Range::Within { mean_m, std_m: 0.0 };
            Column::adhoc(format!("{mean_m}m"), range, Medium::Radio)
        };
        let everyone = Column::adhoc("everyone".to_owned(), Range::Everyone, Medium::Radio);
        ranges_m.iter().map(within).chain([everyone]).collect()
    }

    /// The delay \[s\] and the loss of a column that has them in place of the radio.
    pub fn impairment(&self) -> Option<(f64, f64)> {
        match self.medium {
            Medium::Radio => None,
            Medium::Impaired { delay_s, loss } => Some((delay_s, loss)),
        }
    }

    /// A trial of an entrant in this column, of one episode.
    pub fn trial(&self, scenario: Arc<dyn Scenario>, entrant: &Entrant) -> Trial {
        let deployment = Deployment::preset(&self.mode, scenario.robots()).expect("columns name modes");
        match deployment.stepping {
            Stepping::Lockstep => conditions::training(deployment, scenario, entrant),
            Stepping::Seeded => conditions::deployed(deployment, self.medium, self.range.resolved(), scenario, entrant),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_column_of_the_table_is_there_and_the_grids_are_whole() {
        for name in MODES {
            assert_eq!(Column::of_table(name).unwrap().name, name);
        }
        assert_eq!(Column::of_table("telepathy"), None);
        let grid = Column::delays(&DELAYS_S, &LOSSES);
        assert_eq!((grid.len(), grid[7].name.as_str()), (20, "50ms-16%"));
        assert_eq!(Column::ranges(&RANGES_M).len(), 9);
    }
}
