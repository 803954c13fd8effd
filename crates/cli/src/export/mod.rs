//! The command `murmurate export`: teams as programs for testbeds of others.

mod network;
mod probe;
mod robotarium;

use anyhow::Result;
use murmurate::registry::Registry;
use murmurate_robot::Ended;

/// Writes a team as a program for a testbed of others.
#[derive(clap::Subcommand)]
#[command(
    after_help = "Exit codes: 0 the folder is complete; 1 it could not be written; 2 a flag or a file is wrong, or \
    the testbed cannot run the team, and nothing was written."
)]
pub enum Args {
    /// Writes a folder to upload to the Robotarium: policy, messages, safety filter and resets of a team in numpy
    /// (docs/robotarium.md)
    Robotarium(robotarium::Args),
}

/// Runs a subcommand of `export`.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    let Args::Robotarium(args) = args;
    robotarium::run(args, registry)
}
