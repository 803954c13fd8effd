//! The program of a robot: its commands, and what it says of those that it lacks.

#[path = "../program/mod.rs"]
mod program;

use std::fs::{copy, read_dir, write};
use std::path::Path;

use program::{commands, refuses, run, text};
use tempfile::TempDir;

#[test]
fn a_robot_s_program_has_its_own_commands_alone() {
    let all = commands();
    for (name, there) in [("host", true), ("doctor", true), ("stop", true), ("sim", false), ("train", false)] {
        assert_eq!(all.iter().any(|other| other == name), there, "{name} in {all:?}");
    }
}

#[test]
fn a_command_or_a_flag_that_the_program_lacks_says_which_program_has_it() {
    for name in ["sim", "lab", "completions", "labs"] {
        refuses(&[name, "--help"], &[&format!("'{name}'"), "a robot alone", "cargo build --release"]);
    }
    if !cfg!(feature = "record") {
        refuses(&["host", "team.toml", "--record", "out"], &["'--record'", "the feature 'record'", "program,record"]);
    }
    if !cfg!(feature = "watch") {
        refuses(&["host", "team.toml", "--metrics", "127.0.0.1:1"], &["'--metrics'", "the feature 'watch'"]);
    }
    // `key` is a command, but has no such subcommand.
    let output = run(&["key", "key"]);
    assert!(!text(&output.stderr).contains("a robot alone"), "{}", text(&output.stderr));
}

#[test]
fn every_example_is_checked_and_shown_in_every_build() {
    let examples = read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("teams")).expect("the examples");
    for path in examples.map(|entry| entry.expect("an example").path()) {
        let folder = TempDir::new().expect("a temporary folder");
        let inside = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        let (file, key) = (inside("team.toml"), inside("team.key"));
        copy(&path, &file).expect("it can be copied");
        assert_eq!(run(&["key", "new", "--out", &key]).status.code(), Some(0));
        for command in ["check", "show"] {
            let output = run(&["config", command, &file]);
            assert_eq!(output.status.code(), Some(0), "{}: {}", path.display(), text(&output.stderr));
        }
    }
}

#[test]
fn a_team_that_needs_a_missing_feature_is_refused_by_field_and_feature() {
    let folder = TempDir::new().expect("a temporary folder");
    let file = folder.path().join("team.toml").to_string_lossy().into_owned();
    write(&file, "team = 1\nmode = \"sim\"\nplant = \"rigid\"\n").expect("it can be written");
    if cfg!(feature = "rigid") {
        assert_eq!(run(&["config", "check", &file]).status.code(), Some(0));
        return;
    }
    for command in
        [&["config", "check"][..], &["config", "show"], &["host", "--robot", "0"], &["doctor", "--robot", "0"]]
    {
        refuses(&[command, &[&*file]].concat(), &["plant (line 3)", "feature 'rigid'"]);
    }
}
