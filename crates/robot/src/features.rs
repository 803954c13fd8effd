//! Commands and flags of optional parts: the error of a program without them when they are used.

use std::ffi::OsStr;

use clap::Error;
use clap::error::{ContextKind, ContextValue};

use crate::Program;

/// Commands and flags that a program can be built without.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Names of commands, and of flags with their dashes.
    pub words: &'static [&'static str],
    /// Feature of the build that has the part.
    pub feature: &'static str,
    /// Command that builds a program with the part.
    pub build: &'static str,
    /// Whether this program has the part.
    pub there: bool,
}

/// Advice of a robot's program on a command that it does not know, as the end of a sentence about the program.
pub const WHOLE: &str =
    "which has the commands of a robot alone: 'cargo build --release' builds the program that has all";

/// Parts of the program of a robot.
pub const OF_ROBOT: &[Part] = &[
    Part {
        words: &["--record", "--record-last", "--record-size"],
        feature: "record",
        build: "cargo build --package murmurate-robot --features program,record --profile robot",
        there: cfg!(feature = "record"),
    },
    Part {
        words: &["--metrics", "--metrics-token-file"],
        feature: "watch",
        build: "cargo build --package murmurate-robot --features program,watch --profile robot",
        there: cfg!(feature = "watch"),
    },
];

/// Returns the text of the error that a command or a flag is of a part that this program was built without, with the
/// command that builds it; `None` for every other error.
pub fn missing(error: &Error, parts: &[Part]) -> Option<String> {
    [ContextKind::InvalidSubcommand, ContextKind::InvalidArg].into_iter().find_map(|kind| {
        let Some(ContextValue::String(word)) = error.get(kind) else { return None };
        // A flag is named with its value.
        let name = word.split(['=', ' ']).next().unwrap_or(word);
        let Part { feature, build, .. } = parts.iter().find(|part| !part.there && part.words.contains(&name))?;
        Some(format!(
            "error: '{name}' is not in this program, which was built without the feature '{feature}': build one that \
             has it with '{build}' (docs/run-a-team.md)"
        ))
    })
}

/// Returns the text of the error that the first word of a command line is no command of the program, if another program
/// may have it; `None` for every other error.
pub fn unknown(error: &Error, first: &OsStr, program: &Program) -> Option<String> {
    let Some(ContextValue::String(word)) = error.get(ContextKind::InvalidSubcommand) else { return None };
    // A command that the program has may have no such subcommand.
    let known = first != word.as_str() || program.commands.iter().any(|command| command.name() == word);
    let why = program.unknown.filter(|_| !known)?;
    Some(format!("error: '{word}' is no command of this program, {why} (docs/run-a-team.md)"))
}
