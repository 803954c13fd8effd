//! Tests of the library of tasks: whole trials with its scenarios and policies.

use murmurate::registry::Registry;
use murmurate::trial::Trial;

mod coverage;
mod field;
mod formation;

/// Returns a trial of a scenario of the library with one of its policies, for the given or the usual number of robots.
fn trial(mode: &str, (scenario, robots): (&str, Option<usize>), policy: &str) -> Trial {
    let registry = murmurate_tasks::add(Registry::builtin());
    let trial = Trial::from_registry(&registry, mode, scenario, robots).expect("a preset");
    let entry = registry.policy(policy).expect("it is registered");
    let model = (entry.build)(&*trial.scenario).expect("it is for the scenario");
    let trial = trial.model(model).seed(3);
    trial.check().expect("it is sound");
    trial
}
