//! Parts for Murmurate's registry: a scenario, policy, plant, driver, source and sense. Start from a copy of this
//! crate.

mod driver;
mod mpe;
mod plant;
mod policy;
#[cfg(test)]
mod recorded;
mod scenario;
mod sense;
mod source;
mod spread;

use murmurate::registry::Registry;

/// Returns the registry with the built-in parts and those of this crate.
pub fn registry() -> Registry {
    murmurate_cli::registry()
        .with_scenario(scenario::ROUND)
        .with_scenario(spread::SPREAD)
        .with_policy(policy::GIVE_WAY)
        .with_plant(plant::GLIDE)
        .with_plant(mpe::MPE)
        .with_driver(driver::DATAGRAMS)
        .with_source(source::BENCH)
        .with_sense(sense::CROWD)
}
