//! Skipping of tests that cannot run on this machine: it adds a line to the summary that `.ci/skipped` prints, or fails
//! if what it needs was promised.
//!
//! The variable `TESTS_MUST` has the words of what is promised, with spaces between. The gate sets it to what it has
//! found or installed, a recipe to what it asks of its user.

use std::fs::OpenOptions;
use std::io::Write;
use std::path::Path;

/// Reports that the calling test is not run, or only in part, because `need` is absent. Panics if `need` was promised.
pub fn skip(need: &str, why: &str) {
    let promised = std::env::var("TESTS_MUST").unwrap_or_default();
    assert!(!promised.split_whitespace().any(|word| word == need), "TESTS_MUST promises '{need}': {why}");
    let program = std::env::current_exe().unwrap_or_default();
    let program = program.file_stem().unwrap_or_default().to_string_lossy();
    // Without the number that Cargo adds.
    let program = program.rsplit_once('-').map_or(&*program, |(name, _)| name);
    let thread = std::thread::current();
    let test = format!("{program} {}", thread.name().unwrap_or("test"));
    // Directly to stderr, because the output of a passing test is captured.
    let _ = writeln!(std::io::stderr(), "skipped: {test}: {why}");
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("skipped");
    let opened = OpenOptions::new().create(true).append(true).open(file);
    // In one write: other tests add theirs.
    let _ = opened.and_then(|mut file| file.write_all(format!("{why}\t{test}\n").as_bytes()));
}
