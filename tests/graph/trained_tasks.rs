//! The policies that were trained for tasks of the library: each file is for its task, and carries the team.

use std::path::{Path, PathBuf};

use murmurate::deploy::Deployment;
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::safety::Safety;
use murmurate::scenario::Settings;
use murmurate::trial::Trial;

/// Names of the policies, each with the number of its robots; the task has the same name.
const TRAINED: [(&str, usize); 3] = [("four-rooms", 6), ("navigation", 8), ("warehouse", 12)];

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn trial(name: &str, robots: usize) -> Trial {
    let file = repository().join(format!("examples/tasks/{name}.toml"));
    let registry = Registry::builtin().with_task_file(&file).expect("the task is sound");
    let scenario = registry.scenario(name, &Settings::of(robots)).expect("the team is sound");
    let bytes = std::fs::read(repository().join(format!("policies/{name}.safetensors"))).expect("the policy is there");
    let model = Model::from_file(&bytes, name).expect("the policy is of this version");
    let deployment = Deployment::preset("onboard-adhoc", robots).expect("it is a mode");
    Trial::with_registry(&registry, deployment, scenario, model).seed(5).episodes(3)
}

#[test]
fn a_trained_policy_solves_its_task() {
    for (name, robots) in TRAINED {
        let report = trial(name, robots).run();
        assert_eq!(report.successes(), 3, "{name}: {:?}", report.episodes);
    }
}
