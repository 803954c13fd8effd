//! The policies that were trained for tasks of the library: each is for its task, and brings a team through it.

use std::path::{Path, PathBuf};

use murmurate::config::shown::counted;
use murmurate::deploy::Deployment;
use murmurate::policy::Model;
use murmurate::registry::Registry;
use murmurate::safety::{Clamp, Safety};
use murmurate::scenario::{Settings, TaskFile};
use murmurate::trial::Trial;
use murmurate::world::ContactRule;

/// Tasks with a policy of their name.
const TRAINED: [&str; 2] = ["four-rooms", "navigation"];

fn read(file: &str) -> Vec<u8> {
    let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn a_trained_policy_brings_the_default_team_of_its_task_through_it() {
    for name in TRAINED {
        let text = String::from_utf8(read(&format!("examples/tasks/{name}.toml"))).expect("a task file is text");
        let task = TaskFile::read(&text).expect("it is sound");
        let scenario = task.scenario(&Settings::default()).expect("its default team is sound");
        let model = Model::from_file(&read(&format!("policies/{name}.safetensors")), name).expect("it is for the task");
        let deployment = Deployment::preset("onboard-adhoc", scenario.robots()).expect("it is a mode");
        let mut trial = Trial::with_registry(&Registry::builtin(), deployment, scenario, model).seed(5).episodes(4);
        (trial.physics.contacts, trial.physics.wall_radius_m, trial.physics.lag_s) = (ContactRule::Judge, 0.16, 0.5);
        let trial = trial.clamp(Clamp::Deployed).safety(Safety::deployed());
        trial.check().expect("the team has what the policy takes");
        let report = trial.run();
        let succeeded = counted(report.successes(), "success");
        assert!(report.successes() >= 3, "{name}: {succeeded} in four episodes: {:?}", report.episodes);
    }
}
