//! Results of trainings with the presets, by their length, so that a user knows what to expect.
//!
//! Measured with `murmurate train passage --preset NAME --steps DECISIONS --seed 1`, a training for each number: the
//! curriculum follows a training's progress, so a shorter training is not the beginning of a longer one.

/// Scenario of the measured trainings.
pub const SCENARIO: &str = "passage";

/// Result of a training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Number of decisions: one per environment and step of the policy.
    pub decisions: u64,
    /// Success rate at the end of the training, with mean actions and perfect messages, 0 to 1.
    pub success: f64,
}

/// Results of trainings with the preset of this name, by length; `None` if none were measured.
pub fn measured(preset: &str) -> Option<&'static [Measured]> {
    MEASURED.iter().find(|(name, _)| *name == preset).map(|(_, measured)| *measured)
}

/// By preset and length.
const MEASURED: &[(&str, &[Measured])] = &[
    ("robust", &[Measured { decisions: 1_015_808, success: 0.0 }, Measured { decisions: 3_014_656, success: 0.68 }]),
    (
        "published",
        &[Measured { decisions: 1_015_808, success: 0.0 }, Measured { decisions: 15_007_744, success: 0.995 }],
    ),
];
