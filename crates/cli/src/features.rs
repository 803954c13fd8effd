//! Commands and flags of optional features: what a program that was built without them says when they are used.

use clap::Error;
use clap::error::{ContextKind, ContextValue};

/// Commands that depend on a feature of the build: name, feature, and whether this program has it.
const COMMANDS: [(&str, &str, bool); 11] = [
    ("sim", "sim", cfg!(feature = "sim")),
    ("deployment", "sim", cfg!(feature = "sim")),
    ("launch", "sim", cfg!(feature = "sim")),
    ("record", "sim", cfg!(feature = "sim")),
    ("replay", "sim", cfg!(feature = "sim")),
    ("study", "study", cfg!(feature = "study")),
    ("train", "train", cfg!(feature = "train")),
    ("watch", "watch", cfg!(feature = "watch")),
    ("lab", "lab", cfg!(feature = "lab")),
    ("completions", "completions", cfg!(feature = "completions")),
    ("man", "completions", cfg!(feature = "completions")),
];

/// Flags that depend on a feature of the build, of whatever command.
const FLAGS: [(&str, &str, bool); 10] = [
    ("--record", "record", cfg!(feature = "record")),
    ("--record-last", "record", cfg!(feature = "record")),
    ("--record-size", "record", cfg!(feature = "record")),
    ("--watch", "watch", cfg!(feature = "watch")),
    ("--listen", "watch", cfg!(feature = "watch")),
    ("--control", "watch", cfg!(feature = "watch")),
    ("--token-file", "watch", cfg!(feature = "watch")),
    ("--metrics", "watch", cfg!(feature = "watch")),
    ("--metrics-token-file", "watch", cfg!(feature = "watch")),
    ("--lab", "lab", cfg!(feature = "lab")),
];

/// Returns what is wrong with a command line that asks for a command or a flag of a feature that this program was built
/// without, and how to build it; `None` for every other error.
pub fn missing(error: &Error) -> Option<String> {
    let context = |kind| match error.get(kind) {
        Some(ContextValue::String(word)) => Some(word.as_str()),
        _ => None,
    };
    let wanted = [(&COMMANDS[..], ContextKind::InvalidSubcommand), (&FLAGS[..], ContextKind::InvalidArg)];
    wanted.into_iter().find_map(|(known, kind)| {
        let word = context(kind)?;
        // A flag is named with its value.
        let name = word.split(['=', ' ']).next().unwrap_or(word);
        let (_, feature, _) = known.iter().find(|(known, _, there)| *known == name && !there)?;
        Some(format!(
            "error: '{name}' is not in this program, which was built without the feature '{feature}': build it with \
             'cargo build --release --features {feature}' (docs/run-a-team.md)"
        ))
    })
}
