//! What the paper reports, as far as it is known here for certain: its Table I. What is not known stays out.
//!
//! Source: Blumenkamp, Morad, Gielis, Li, Prorok, "A Framework for Real-World Multi-Robot Systems Running Decentralized
//! GNN-Based Policies", ICRA 2022 (arXiv 2111.01777), Table I and its text: real robots, five of them, 16 episodes
//! repeated 12 times. The layouts of a study are the paper's only if they are read from its published episodes.

/// A column of Table I.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Published {
    /// The column's name here.
    pub column: &'static str,
    /// The share of episodes that succeeded.
    pub success: Option<f64>,
    /// Median makespan \[s\].
    pub makespan_s: Option<f64>,
}

const fn unknown(column: &'static str) -> Published {
    Published { column, success: None, makespan_s: None }
}

/// Table I.
pub const TABLE_I: [Published; 7] = [
    unknown("sim"),
    Published { column: "centralized", success: Some(0.901), makespan_s: Some(9.1) },
    Published { column: "offboard", success: Some(0.859), makespan_s: Some(9.1) },
    unknown("onboard-infra"),
    unknown("onboard-adhoc"),
    unknown("onboard-adhoc-rinf"),
    unknown("onboard-adhoc-noise"),
];

/// By how many percentage points success falls at most against simulation, in the paper's own words.
pub const LARGEST_DROP_POINTS: f64 = 36.4;

/// What the paper reports of a column.
pub fn of(column: &str) -> Published {
    TABLE_I.into_iter().find(|entry| entry.column == column).unwrap_or(unknown("-"))
}
