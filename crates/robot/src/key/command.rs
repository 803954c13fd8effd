//! The command `murmurate key`, with those that make keys, change rosters and send them.

use anyhow::Result;
use clap::Subcommand;
use murmurate::registry::Registry;

use super::change::{Add, Change, Rotate};
use super::new::{self, New};
use super::spread::Spread;
use crate::Ended;

/// Makes the keys that a team's messages are authenticated with.
#[derive(Subcommand)]
pub enum Args {
    /// Makes new key files that only you can read
    New(New),
    /// Makes a roster without a member, whose key ends at once
    Revoke(Change),
    /// Makes a roster with a new operator, or with a new key of a member
    Add(Add),
    /// Makes a roster with a new key of all members, for no other reason
    Rotate(Rotate),
    /// Sends a roster to a running team, and says which hosts have it
    Spread(Spread),
}

/// Runs `key`.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    match args {
        Args::New(args) => new::run(args, registry),
        Args::Revoke(args) => args.run(),
        Args::Add(args) => args.run(),
        Args::Rotate(args) => args.run(),
        Args::Spread(args) => args.run(registry),
    }
}
