//! Commands and flags of optional parts: what a program without them says when they are used.

use clap::Error;
use clap::error::{ContextKind, ContextValue};

/// Commands and flags that a program may lack.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Names of commands, and of flags with their dashes.
    pub words: &'static [&'static str],
    /// Feature of the build that adds them; `None` for what only the whole program has.
    pub feature: Option<&'static str>,
    /// Whether this program has them.
    pub there: bool,
}

/// Parts of the program of a robot.
pub const OF_ROBOT: &[Part] = &[
    Part {
        words: &[
            "sim",
            "deployment",
            "launch",
            "record",
            "replay",
            "study",
            "train",
            "watch",
            "lab",
            "completions",
            "man",
        ],
        feature: None,
        there: false,
    },
    Part {
        words: &["--record", "--record-last", "--record-size"],
        feature: Some("record"),
        there: cfg!(feature = "record"),
    },
    Part { words: &["--metrics", "--metrics-token-file"], feature: Some("watch"), there: cfg!(feature = "watch") },
];

/// Returns what is wrong with a command line that asks for a command or a flag of a part that this program was built
/// without, and how to build it; `None` for every other error.
pub fn missing(error: &Error, parts: &[Part]) -> Option<String> {
    [ContextKind::InvalidSubcommand, ContextKind::InvalidArg].into_iter().find_map(|kind| {
        let Some(ContextValue::String(word)) = error.get(kind) else { return None };
        // A flag is named with its value.
        let name = word.split(['=', ' ']).next().unwrap_or(word);
        let part = parts.iter().find(|part| !part.there && part.words.contains(&name))?;
        Some(match part.feature {
            Some(feature) => format!(
                "error: '{name}' is not in this program, which was built without the feature '{feature}': build it \
                 with 'cargo build --release --features {feature}' (docs/run-a-team.md)"
            ),
            None => format!(
                "error: '{name}' is not in this program, which has the commands of a robot alone: build the whole one \
                 with 'cargo build --release' (docs/run-a-team.md)"
            ),
        })
    })
}
