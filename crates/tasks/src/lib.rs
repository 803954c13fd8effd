//! Tasks of robot teams, with their ground truth and scripted baselines. The code is pure: it uses no clock, file or
//! socket, and random numbers come from a stream that the caller passes.

pub mod coverage;
pub mod field;
pub mod formation;
pub mod ground;

use murmurate::registry::Registry;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Adds the scenarios and policies to a registry.
pub fn add(registry: Registry) -> Registry {
    registry
        .with_scenario(coverage::scenario::COVERAGE)
        .with_scenario(coverage::scenario::COVERAGE_TABLE)
        .with_policy(coverage::policy::COVERAGE_CVT)
        .with_policy(coverage::privileged::COVERAGE_CENTRALISED)
        .with_policy(coverage::privileged::COVERAGE_CLAIRVOYANT)
        .with_scenario(field::scenario::FLOCKING_FIELD)
        .with_scenario(field::scenario::FLOCKING_FIELD_TABLE)
        .with_policy(field::policy::FLOCK_FIELD)
        .with_scenario(formation::scenario::FORMATION_ENTRY)
        .with_scenario(formation::scenario::TABLE_ENTRY)
        .with_policy(formation::policy::FOLLOW_LEADER)
}
