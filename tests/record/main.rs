//! Records: equal runs have equal bytes, hosts of real teams run again to the bit, and files survive crashes.

#[path = "../program/mod.rs"]
mod program;

mod crashes;
mod damage;
mod edited;
mod folders;
mod hostile;
mod hosts;
mod junk;
mod kept;
mod lab_files;
mod lab_run;
mod readers;
mod senses;
mod simulated;
mod twin;

use std::path::{Path, PathBuf};

/// Records in a folder, in the order of their names.
fn records(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("the folder is there");
    let mut all: Vec<PathBuf> = entries.map(|entry| entry.expect("it can be read").path()).collect();
    all.sort();
    all
}
