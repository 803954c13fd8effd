//! Murmurate's program with a scenario, a policy and a plant more. Start from a copy of this crate.

mod plant;
mod policy;
mod scenario;

use std::process::ExitCode;

use murmurate::program;
use murmurate::registry::Registry;

fn main() -> ExitCode {
    let registry = Registry::builtin()
        .with_scenario(scenario::ROUND)
        .with_policy(policy::GIVE_WAY)
        .with_plant(plant::GLIDE);
    program::main(&registry)
}
