//! The commands of the whole program, and what it says of those that it was built without.

use crate::program::{refuses, run, text};

/// Commands of every build.
const ALWAYS: [&str; 18] = [
    "sim",
    "deployment",
    "study",
    "train",
    "policy",
    "host",
    "doctor",
    "stop",
    "resume",
    "place",
    "key",
    "config",
    "launch",
    "record",
    "replay",
    "watch",
    "completions",
    "man",
];

#[test]
fn a_program_has_the_commands_of_its_features_and_no_others() {
    let help = text(&run(&["--help"]).stdout);
    let (_, list) = help.split_once("Commands:\n").expect("help has a list of commands");
    let commands = list.lines().take_while(|line| !line.is_empty()).filter(|line| line.starts_with("  "));
    let mut found: Vec<&str> = commands
        .filter(|line| !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .collect();
    let mut wanted: Vec<&str> = ALWAYS.to_vec();
    wanted.extend(cfg!(feature = "lab").then_some("lab"));
    found.sort_unstable();
    wanted.sort_unstable();
    assert_eq!(found, wanted);
}

#[test]
fn a_command_of_a_missing_feature_says_which_one_the_program_needs() {
    if !cfg!(feature = "lab") {
        refuses(&["lab", "--help"], &["'lab'", "without the feature '", "cargo build", "--features "]);
        refuses(&["lab", "up", "lab.toml"], &["the feature 'lab'", "--features lab"]);
        refuses(&["launch", "team.toml", "--lab", "lab.toml"], &["'--lab'", "--features lab"]);
    }
    refuses(&["labs", "up"], &["labs"]);
}
