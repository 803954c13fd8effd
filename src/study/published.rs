//! Results of the paper's Table I.
//!
//! Source: Blumenkamp, Morad, Gielis, Li, Prorok, "A Framework for Real-World Multi-Robot Systems Running Decentralized
//! GNN-Based Policies", ICRA 2022 (arXiv 2111.01777), Table I and its text: real robots, five of them, 16 episodes
//! repeated 12 times; `sim` is the published environment. The layouts of a study are the paper's only if they are read
//! from its published episodes.

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

/// Returns the paper's results of the column with this name; results without values if the column is not in Table I.
pub fn of(column: &str) -> Published {
    TABLE_I.into_iter().find(|entry| entry.column == column).unwrap_or(Published {
        column: "-",
        success: None,
        makespan_s: None,
    })
}
