//! Measured success rates of trainings with each preset and number of decisions, as a guide for users.
//!
//! Each number is from its own run of `murmurate train passage --preset NAME --steps DECISIONS --seed 1`. A shorter
//! training is not the beginning of a longer one, because the curriculum depends on the completed fraction.

/// Name of the scenario of all trainings whose results `measured` returns.
pub const SCENARIO: &str = "passage";

/// Measured result of one training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Number of decisions in the training: one per environment and step of the policy.
    pub decisions: u64,
    /// Success rate at the end of the training, with mean actions and perfect messages, 0 to 1.
    pub success: f64,
}

/// Returns the measured results of trainings with the preset named `preset`, by increasing number of decisions; `None`
/// if none were measured.
pub fn measured(preset: &str) -> Option<&'static [Measured]> {
    MEASURED.iter().find(|(name, _)| *name == preset).map(|(_, measured)| *measured)
}

/// Results by preset, then by number of decisions.
const MEASURED: &[(&str, &[Measured])] = &[
    ("robust", &[Measured { decisions: 1_015_808, success: 0.0 }, Measured { decisions: 3_014_656, success: 0.68 }]),
    (
        "published",
        &[Measured { decisions: 1_015_808, success: 0.0 }, Measured { decisions: 15_007_744, success: 0.995 }],
    ),
];
