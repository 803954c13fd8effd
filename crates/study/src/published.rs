//! Results of the paper's Table I.
//!
//! Source: Blumenkamp, Morad, Gielis, Li, Prorok, "A Framework for Real-World Multi-Robot Systems Running Decentralized
//! GNN-Based Policies", ICRA 2022 (arXiv 2111.01777), Table I and its text: real robots, five of them, 16 episodes
//! repeated 12 times; `sim` is the published environment. The layouts of a study are the paper's only if they are read
//! from its published episodes.

use super::{PolicyUnderTest, Study};
use murmurate::chassis::Settings;
use murmurate::policy::manifest::Manifest;
use murmurate::policy::{Model, shipped};
use murmurate::scenario;

/// Name of the study that repeats the paper's Table I.
const STUDY: &str = "modes";
/// Task and team of the paper: passage, five robots, and the width of the gap \[m\].
const SCENARIO: &str = "passage";
const ROBOTS: usize = 5;
const GAP_M: f32 = 1.0;
/// Name of the built-in policy that was trained for the paper's conditions.
const POLICY: &str = "published";

/// Published results of one column of the paper's Table I.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Published {
    /// Name of the column, as in the study `modes`.
    pub column: &'static str,
    /// Success rate, 0 to 1; `None` if the paper does not give it.
    pub success: Option<f64>,
    /// Median makespan \[s\]; `None` if the paper does not give it.
    pub makespan_s: Option<f64>,
}

const fn column(column: &'static str, success: f64, makespan_s: f64) -> Published {
    Published { column, success: Some(success), makespan_s: Some(makespan_s) }
}

/// Results in Table I of the paper, one entry for each column.
pub const TABLE_I: [Published; 7] = [
    column("sim", 0.958, 6.3),
    column("centralized", 0.901, 9.1),
    column("offboard", 0.859, 9.1),
    column("onboard-infra", 0.594, 9.8),
    column("onboard-adhoc", 0.703, 9.9),
    column("onboard-adhoc-rinf", 0.667, 9.6),
    column("onboard-adhoc-noise", 0.625, 10.7),
];

/// Largest drop of the success rate from simulation to real robots, from the paper's text \[percentage points\].
pub const LARGEST_DROP_POINTS: f64 = 36.4;

/// Whether the paper ran what a study has: its task with five robots, its gap and its drive, and one of its policies in
/// the study `modes`. Its policies are the one that its authors published, whose file has no manifest, and the built-in
/// one that was trained here for the conditions of the paper. Beside anything else its figures would compare nothing.
pub fn ran(study: &Study, tested: &PolicyUnderTest) -> bool {
    let published = Manifest::published();
    let authors = matches!(&tested.model, Model::Gnn(network, _) if network.manifest().format_1() == Some(&published));
    let ours = shipped::built_in(POLICY, SCENARIO).map(|bytes| blake3::hash(bytes).to_hex()[..16].to_owned());
    let setup = study.name == STUDY && study.scenario.name() == SCENARIO && study.scenario.robots() == ROBOTS;
    let scenario::Settings { gap_m, scale, hull_m, .. } = study.settings;
    let is = |setting: Option<f32>, paper: f32| setting.is_none_or(|setting| setting.to_bits() == paper.to_bits());
    let sizes = is(gap_m, GAP_M) && is(scale, 1.0) && hull_m.is_none();
    let world = sizes && study.conditions.body == Settings::default();
    setup && world && (authors || ours.is_some_and(|digest| digest == tested.digest))
}

/// Returns the paper's results of the column with this name; results without values if the column is not in Table I.
pub fn of(column: &str) -> Published {
    TABLE_I.into_iter().find(|entry| entry.column == column).unwrap_or(Published {
        column: "-",
        success: None,
        makespan_s: None,
    })
}
