//! How a policy is handled once it is deployed: what becomes of messages, how actions are drawn, what limits them. Two
//! presets, by name.

use crate::hearing::Handling;
use crate::policy::Draw;
use crate::world::Clamp;

/// One way to handle a policy.
#[derive(Debug, PartialEq)]
pub struct Preset {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it means, in one sentence.
    pub about: &'static str,
    /// What becomes of neighbours' messages once a step has seen them.
    pub messages: Handling,
    /// How actions are drawn.
    pub draw: Draw,
    /// What limits them in the deployed columns.
    pub clamp: Clamp,
}

/// All presets.
pub const PRESETS: [Preset; 2] = [
    Preset {
        name: "default",
        about: "a neighbour's newest message is held for the policy's own window (0.2 s if its file says none), \
                actions are the mean, and one limit holds for resets, episodes and the training of the shipped \
                policy: commands within 0.25 m/s of the measured velocity along each axis",
        messages: Handling::Hold,
        draw: Draw::Mean,
        clamp: Clamp::Training,
    },
    Preset {
        name: "as-published",
        about: "the message buffer is cleared at every step, actions are sampled, and only a controller limits \
                acceleration, to 1 m/s^2 at a gain of 4 Hz, five times looser a step than those policies' training",
        messages: Handling::AsPublished,
        draw: Draw::Sample,
        clamp: Clamp::Deployed,
    },
];

/// The preset of that name.
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|preset| preset.name == name)
}

/// What there is, for errors.
pub fn names() -> String {
    PRESETS.iter().map(|preset| preset.name).collect::<Vec<_>>().join(", ")
}
