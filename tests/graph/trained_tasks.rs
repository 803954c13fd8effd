//! The policies that were trained for tasks of the library: each is for its task, and brings a team through it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use murmurate::config::shown::counted;
use murmurate::deploy::{Deployment, roles_of};
use murmurate::hearing::CommRange;
use murmurate::policy::{Model, Models};
use murmurate::registry::Registry;
use murmurate::safety::{Clamp, Safety};
use murmurate::scenario::{Scenario, Settings, TaskFile};
use murmurate::trial::Trial;
use murmurate::world::ContactRule;

/// Tasks with a policy of their name.
const TRAINED: [&str; 4] = ["four-rooms", "navigation", "unlabelled", "warehouse"];

fn read(file: &str) -> Vec<u8> {
    let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join(file);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns four episodes of a team in the conditions by which trained policies are judged.
fn judged(scenario: Arc<dyn Scenario>, models: Models) -> Trial {
    let deployment = Deployment::preset("onboard-adhoc", scenario.robots()).expect("it is a mode");
    let mut trial = Trial::with_registry(&Registry::builtin(), deployment, scenario, models).seed(5).episodes(4);
    (trial.physics.contacts, trial.physics.wall_radius_m, trial.physics.lag_s) = (ContactRule::Judge, 0.16, 0.5);
    let trial = trial.clamp(Clamp::Deployed).safety(Safety::deployed());
    trial.check().expect("the team has what the policy takes");
    trial
}

#[test]
fn a_trained_policy_brings_the_default_team_of_its_task_through_it() {
    for name in TRAINED {
        let text = String::from_utf8(read(&format!("examples/tasks/{name}.toml"))).expect("a task file is text");
        let task = TaskFile::read(&text).expect("it is sound");
        let scenario = task.scenario(&Settings::default()).expect("its default team is sound");
        let model = Model::from_file(&read(&format!("policies/{name}.safetensors")), name).expect("it is for the task");
        let report = judged(scenario, model.into()).run();
        let succeeded = counted(report.successes(), "success");
        assert!(report.successes() >= 3, "{name}: {succeeded} in four episodes: {:?}", report.episodes);
    }
}

#[test]
fn carriers_come_to_goals_that_scouts_alone_see_and_without_their_messages_do_not() {
    let text = String::from_utf8(read("examples/tasks/scouts.toml")).expect("a task file is text");
    let task = TaskFile::read(&text).expect("it is sound");
    let scenario = task.scenario(&Settings::default()).expect("its default team is sound");
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("policies/scouts");
    let text = String::from_utf8(read("policies/scouts/roles.toml")).expect("it is text");
    let roles = roles_of(&Registry::builtin(), &text, &folder).expect("they are sound");
    let mut of = vec![0; scenario.robots()];
    let mut models = Vec::new();
    for (index, (name, role)) in roles.iter().enumerate() {
        role.robots.iter().for_each(|robot| of[usize::from(*robot)] = index);
        let file = std::fs::read(role.policy.as_ref().expect("each role has one")).expect("it is there");
        models.push((name.clone(), Model::from_file(&file, "scouts").expect("it is for the task")));
    }
    let models = Models::of_roles(models, of).expect("they were trained together");
    let told = judged(Arc::clone(&scenario), models.clone()).run();
    let succeeded = counted(told.successes(), "success");
    assert!(told.successes() >= 3, "{succeeded} in four episodes: {:?}", told.episodes);
    let mut alone = judged(scenario, models);
    alone.range = Some(CommRange::fixed(0.01));
    // A carrier may stand at a goal by chance: in one of 200 layouts one did.
    assert!(alone.run().successes() <= 1, "carriers that hear no scout find goals");
}
