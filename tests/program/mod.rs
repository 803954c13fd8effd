//! Running the program in tests, and checking its refusals. Shared by the tests of the command line.
#![allow(dead_code)] // Each test uses its part.

pub mod lateness;
#[path = "../skip/mod.rs"]
pub mod skip;

use std::process::{Command, Output, Stdio};

/// The repository's folder: paths in the arguments of tests are relative to it.
pub const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

/// The program of the package that is tested: the whole one, or that of robots.
const PROGRAM: Option<&str> = match option_env!("CARGO_BIN_EXE_murmurate") {
    None => option_env!("CARGO_BIN_EXE_murmurate-robot"),
    whole => whole,
};

pub fn murmurate(args: &[&str]) -> Command {
    let mut command = Command::new(PROGRAM.expect("a test of a package that has a program"));
    command.current_dir(ROOT);
    command.args(args).stdin(Stdio::null());
    // A program refuses variables that name no field of a team file, as those of tests do.
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("MURMURATE_")) {
        command.env_remove(name);
    }
    command
}

pub fn run(args: &[&str]) -> Output {
    murmurate(args).output().expect("the program starts")
}

pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).expect("output is UTF-8")
}

/// The commands that the program's help lists, sorted.
pub fn commands() -> Vec<String> {
    let help = text(&run(&["--help"]).stdout);
    let (_, list) = help.split_once("Commands:\n").expect("help has a list of commands");
    let lines = list.lines().take_while(|line| !line.is_empty());
    // Further lines of a description are indented deeper.
    let named = lines.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    let names = named.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help");
    let mut names: Vec<String> = names.map(str::to_owned).collect();
    names.sort_unstable();
    names
}

/// Checks that the program refuses: exit code 2, nothing on stdout, one line on stderr with all of `words`.
pub fn refuses(args: &[&str], words: &[&str]) {
    let output = run(args);
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(2), "{args:?}: {err}");
    assert_eq!(out, "", "{args:?}");
    assert_eq!(err.trim_end().lines().count(), 1, "{args:?}: one line, not\n{err}");
    assert!(!err.contains("panicked"), "{args:?}: {err}");
    for word in words {
        assert!(err.contains(word), "{args:?}: '{word}' is missing in: {err}");
    }
}
