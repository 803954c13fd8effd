//! Running the program in tests, and checking its refusals. Shared by the tests of the command line.
#![allow(dead_code)] // Each test uses its part.

use std::process::{Command, Output, Stdio};

/// The repository's folder: paths in the arguments of tests are relative to it.
pub const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

pub fn murmurate(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_murmurate"));
    command.current_dir(ROOT);
    command.args(args).stdin(Stdio::null());
    // Variables of tests name no field of a team file, and a program refuses them; those of a user would change its log.
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
