//! Commands and flags of optional parts: the error of a program without them when they are used.

use clap::Error;
use clap::error::{ContextKind, ContextValue};

/// Commands and flags that a program can be built without.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Names of commands, and of flags with their dashes.
    pub words: &'static [&'static str],
    /// What the program is without the part, as the end of a sentence about it.
    pub lack: &'static str,
    /// Command that builds a program with the part.
    pub build: &'static str,
    /// Whether this program has the part.
    pub there: bool,
}

/// Commands of the whole program that a robot's lacks.
pub const WHOLE: &[&str] =
    &["sim", "deployment", "launch", "record", "replay", "study", "train", "watch", "lab", "completions", "man"];

/// Parts of the program of a robot.
pub const OF_ROBOT: &[Part] = &[
    Part {
        words: WHOLE,
        lack: "which has the commands of a robot alone",
        build: "cargo build --release",
        there: false,
    },
    Part {
        words: &["--record", "--record-last", "--record-size"],
        lack: "which was built without the feature 'record'",
        build: "cargo build --package murmurate-robot --features program,record --profile robot",
        there: cfg!(feature = "record"),
    },
    Part {
        words: &["--metrics", "--metrics-token-file"],
        lack: "which was built without the feature 'watch'",
        build: "cargo build --package murmurate-robot --features program,watch --profile robot",
        there: cfg!(feature = "watch"),
    },
];

/// Returns what is wrong with a command line that asks for a command or a flag of a part that this program was built
/// without, and how to build it; `None` for every other error.
pub fn missing(error: &Error, parts: &[Part]) -> Option<String> {
    [ContextKind::InvalidSubcommand, ContextKind::InvalidArg].into_iter().find_map(|kind| {
        let Some(ContextValue::String(word)) = error.get(kind) else { return None };
        // A flag is named with its value.
        let name = word.split(['=', ' ']).next().unwrap_or(word);
        let Part { lack, build, .. } = parts.iter().find(|part| !part.there && part.words.contains(&name))?;
        Some(format!(
            "error: '{name}' is not in this program, {lack}: build one that has it with '{build}' \
             (docs/run-a-team.md)"
        ))
    })
}
