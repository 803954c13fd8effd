//! Parts for Murmurate's registry: a scenario, policy, plant, driver, source and sense. Start from a copy of this
//! crate.

mod driver;
mod plant;
mod policy;
mod scenario;
mod sense;
mod source;

use murmurate::registry::Registry;

/// Returns the registry with the built-in parts and those of this crate.
pub fn registry() -> Registry {
    murmurate_cli::registry()
        .with_scenario(scenario::ROUND)
        .with_policy(policy::GIVE_WAY)
        .with_plant(plant::GLIDE)
        .with_driver(driver::DATAGRAMS)
        .with_source(source::BENCH)
        .with_sense(sense::CROWD)
}
