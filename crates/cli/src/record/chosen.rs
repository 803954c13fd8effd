//! Records that a command takes as arguments: prints on stderr which files are left out or damaged, and reports
//! unusable ones as wrong arguments.

use std::path::PathBuf;

use murmurate_record::chosen::{self, Chosen, Unusable};
use murmurate_record::health::Health;
use murmurate_robot::BadInput;
use murmurate_robot::output::talk;

/// Returns all `named` files, with each folder among them replaced by the MCAP files in it (`*.mcap`), sorted by name.
pub fn files(named: &[PathBuf]) -> Result<Vec<PathBuf>, BadInput> {
    chosen::files(named).map_err(wrong)
}

/// Returns the first files of all `named` records: further files of a record are read together with its first one.
pub fn first_files(named: &[PathBuf]) -> Result<Vec<PathBuf>, BadInput> {
    chosen::first_files(named).map_err(wrong)
}

/// Returns the records among the `named` files and folders. Files that are not taken are named on stderr.
pub fn records(named: &[PathBuf]) -> Result<Chosen, BadInput> {
    chosen::records(named, talk).map_err(wrong)
}

/// Converts the error of unusable files to that of a wrong argument.
pub fn wrong(error: Unusable) -> BadInput {
    BadInput(error.0)
}

/// Prints the damaged places of a record on stderr, with times since `zero` \[ns\]. Returns whether it is whole.
pub fn print_damage(health: &Health, zero: u64) -> bool {
    health.lines(zero).iter().for_each(|line| talk(line));
    health.is_whole()
}
