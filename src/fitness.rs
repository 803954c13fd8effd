//! Results of checks of a machine or a device: severity, subject, observation and advice.

use serde::Serialize;

/// Severity of a result, in rising order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Fitness {
    /// Nothing is wrong.
    Ok,
    /// It is fit, and something should be looked at.
    Warn,
    /// It is not fit: a host would not work, or its robot would stand.
    Fail,
}

/// Result of one check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// Severity of the result.
    pub fitness: Fitness,
    /// Subject of the check, such as "MTU".
    pub what: &'static str,
    /// Observation, such as `1500 bytes`.
    pub found: String,
    /// Advice on how to remove the defect; empty if there is none.
    pub advice: String,
}

impl Finding {
    /// Returns a finding without defect: `what` is the subject of the check, `found` the text that says what was found.
    pub fn ok(what: &'static str, found: String) -> Finding {
        Finding { fitness: Fitness::Ok, what, found, advice: String::new() }
    }
}
