//! Results of the paper's Table I, as far as they are known for certain; unknown values are left out.
//!
//! Source: Blumenkamp, Morad, Gielis, Li, Prorok, "A Framework for Real-World Multi-Robot Systems Running Decentralized
//! GNN-Based Policies", ICRA 2022 (arXiv 2111.01777), Table I and its text: real robots, five of them, 16 episodes
//! repeated 12 times. The layouts of a study are the paper's only if they are read from its published episodes.

/// Published results of a column of Table I.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Published {
    /// Name of the column in this study.
    pub column: &'static str,
    /// Success rate, 0 to 1.
    pub success: Option<f64>,
    /// Median makespan \[s\].
    pub makespan_s: Option<f64>,
}

const fn unknown(column: &'static str) -> Published {
    Published { column, success: None, makespan_s: None }
}

/// Table I of the paper.
pub const TABLE_I: [Published; 7] = [
    unknown("sim"),
    Published { column: "centralized", success: Some(0.901), makespan_s: Some(9.1) },
    Published { column: "offboard", success: Some(0.859), makespan_s: Some(9.1) },
    unknown("onboard-infra"),
    unknown("onboard-adhoc"),
    unknown("onboard-adhoc-rinf"),
    unknown("onboard-adhoc-noise"),
];

/// Largest drop of success against simulation, from the paper's text \[percentage points\].
pub const LARGEST_DROP_POINTS: f64 = 36.4;

/// Returns the published results of a column; unknown ones for a name outside the table.
pub fn of(column: &str) -> Published {
    TABLE_I.into_iter().find(|entry| entry.column == column).unwrap_or(unknown("-"))
}
