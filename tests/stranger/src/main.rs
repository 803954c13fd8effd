//! Murmurate's program with an additional scenario, policy, plant, driver and source. Start from a copy of this crate.

mod driver;
mod plant;
mod policy;
mod scenario;
mod source;

use std::process::ExitCode;

use murmurate::program;
use murmurate::registry::Registry;

fn main() -> ExitCode {
    let registry = Registry::builtin()
        .with_scenario(scenario::ROUND)
        .with_policy(policy::GIVE_WAY)
        .with_plant(plant::GLIDE)
        .with_driver(driver::DATAGRAMS)
        .with_source(source::BENCH);
    program::main(&registry)
}
