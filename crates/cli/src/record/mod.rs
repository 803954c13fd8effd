//! The command `murmurate record`: describes, repairs, merges, shares, exports and imports records.

pub mod chosen;
mod export;
mod import;
mod info;
pub mod merge;
mod repair;
mod share;

use anyhow::Result;

use murmurate::registry::Registry;
use murmurate_robot::Ended;

/// Looks at records, repairs, merges, exports and imports them.
#[derive(clap::Subcommand)]
#[command(after_help = "Exit codes: 0 done; 1 a record is damaged or lacks events; 2 a flag or a file is wrong, and \
    nothing was written.")]
pub enum Args {
    /// Describes records: of which runs they are, what they contain, and whether they are complete
    Info(info::Args),
    /// Repairs records that a crash has cut: adds the end and the index that other readers need
    Repair(repair::Args),
    /// Merges the records of a team's hosts into one on a common clock, and prints its uncertainty
    Merge(merge::Args),
    /// Makes a copy of a host's record that others can replay without the team's key
    Share(share::Args),
    /// Writes trajectories, links or messages of a record as CSV
    Export(export::Args),
    /// Makes a record of a run of another program: CSV files or a bag of ROS 2, and a mapping of them
    Import(import::Args),
}

/// Runs a subcommand of `record`.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    match args {
        Args::Info(args) => info::run(args),
        Args::Repair(args) => repair::run(args),
        Args::Merge(args) => merge::run(args),
        Args::Share(args) => share::run(args),
        Args::Export(args) => export::run(args),
        Args::Import(args) => import::run(args, registry),
    }
}
