//! Handling of a deployed policy in a study: how long messages are used, whether actions are the mean or sampled,
//! what limits the acceleration of commands, and the safety filter.

use murmurate::hearing::Handling;
use murmurate::policy::Draw;
use murmurate::safety::{Clamp, Safety};

/// Named handling of a deployed policy in a study: use of messages, choice of actions, limit of commands, and
/// safety.
#[derive(Debug, PartialEq)]
pub struct Preset {
    /// Name of the preset on the command line.
    pub name: &'static str,
    /// Description in one sentence, for reports and help texts.
    pub about: &'static str,
    /// Use of neighbours' messages: each for the whole hold time, or in one control step only.
    pub messages: Handling,
    /// Choice of actions: the mean of their distribution, or a sample.
    pub draw: Draw,
    /// Limit of velocity commands in the deployed columns of a study: of speed alone, as in training, or also of the
    /// acceleration, as of the published robots.
    pub clamp: Clamp,
    /// Safety functions between policy and motors: conditions that stop or slow a robot, with the safety filter or
    /// without.
    pub safety: Safety,
}

/// All presets of the handling of a deployed policy.
pub const PRESETS: [Preset; 4] = [
    Preset {
        name: "default",
        about: "a neighbour's newest message is held for the policy's own window (0.2 s if its file has none), \
                actions are the mean, and velocities are limited along each axis alone, as in training: the \
                simulated world limits acceleration to 1 m/s^2",
        messages: Handling::Hold,
        draw: Draw::Mean,
        clamp: Clamp::Training,
        safety: Safety::emulated(),
    },
    Preset {
        name: "filtered",
        about: "as 'default', with the safety filter between policy and motors: geofence, and least distances to \
                neighbours and walls that allow for lag and age",
        messages: Handling::Hold,
        draw: Draw::Mean,
        clamp: Clamp::Training,
        safety: Safety::filter(),
    },
    Preset {
        name: "as-published",
        about: "the message buffer is cleared at every step, actions are sampled, and only a controller limits \
                acceleration, to 1 m/s^2 at a gain of 4 Hz, five times looser a step than those policies' training",
        messages: Handling::AsPublished,
        draw: Draw::Sample,
        clamp: Clamp::Deployed,
        safety: Safety::emulated(),
    },
    Preset {
        name: "as-published-filtered",
        about: "as 'as-published', with the safety filter of 'filtered'",
        messages: Handling::AsPublished,
        draw: Draw::Sample,
        clamp: Clamp::Deployed,
        safety: Safety::filter(),
    },
];

/// Returns the preset of handling with this name; `None` if there is none.
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|preset| preset.name == name)
}

/// Returns the names of all presets of handling as text, for error messages.
pub fn names() -> String {
    PRESETS.iter().map(|preset| preset.name).collect::<Vec<_>>().join(", ")
}
