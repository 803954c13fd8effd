//! Roles on the command line: teams of different robots in `sim`, their records, and what is refused.

use std::path::Path;

use crate::program::{ROOT, refuses, run, text};
use serde_json::Value;
use tempfile::TempDir;

const ROLES: &str = "examples/roles.toml";
const TEAM: [&str; 7] = ["sim", "--scenario", "swap", "--robots", "4", "--repeats", "1"];

/// Copies the example with the policies of its roles and their graphs into a folder, after `change` of the contract of
/// the carriers, which lies in a folder of its own. Returns the path of the roles.
fn copied(folder: &TempDir, change: impl Fn(String) -> String) -> String {
    let (data, below) = (Path::new(ROOT).join("tests/onnx/data"), folder.path().join("my carriers"));
    std::fs::create_dir_all(&below).expect("a folder");
    for place in [folder.path(), &below] {
        for graph in ["field-say.onnx", "field-act.onnx"] {
            std::fs::copy(data.join(graph), place.join(graph)).expect("a copy");
        }
    }
    let read = |path: &Path| std::fs::read_to_string(path).expect("a text");
    let carrier = change(read(&data.join("carrier.policy.toml")));
    std::fs::write(below.join("carrier.policy.toml"), carrier).expect("a file");
    std::fs::copy(data.join("scout.policy.toml"), folder.path().join("scout.policy.toml")).expect("a copy");
    let roles = read(&Path::new(ROOT).join(ROLES));
    let roles = roles.replace("../tests/onnx/data/carrier", "my carriers/carrier").replace("../tests/onnx/data/", "");
    let path = folder.path().join("roles.toml");
    std::fs::write(&path, roles).expect("a file");
    path.to_string_lossy().into_owned()
}

#[test]
fn a_team_of_two_roles_runs_in_every_mode_and_names_the_policies() {
    for mode in ["sim", "centralized", "offboard", "onboard-infra", "onboard-adhoc"] {
        let output = run(&[&TEAM[..], &["--mode", mode, "--roles", ROLES, "--episodes", "2", "--json"]].concat());
        assert_eq!(output.status.code(), Some(0), "{mode}: {}", text(&output.stderr));
        let said: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
        let policy = said["policy"].as_str().expect("a name");
        assert!(policy.starts_with("scout: ") && policy.contains("carrier.policy.toml"), "{policy}");
        assert!(said["successes"].as_u64().is_some_and(|successes| successes > 0), "{mode}: {said}");
    }
}

#[test]
fn a_record_of_roles_holds_all_policies_and_replays_alike() {
    let folder = TempDir::new().expect("a folder");
    let (roles, records) = (copied(&folder, |contract| contract), folder.path().join("records"));
    // One policy by a path from the roles' folder with a space in it, one by a path from the root.
    let content = std::fs::read_to_string(&roles).expect("a text");
    let scout = folder.path().join("scout.policy.toml");
    let content = content.replace("\"scout.policy.toml", &format!("\"{}", scout.display()));
    assert!(content.contains("my carriers/") && content.contains(&*scout.to_string_lossy()), "{content}");
    std::fs::write(&roles, content).expect("a file");
    let record = ["--record", &*records.to_string_lossy()];
    let output =
        run(&[&TEAM[..], &["--mode", "onboard-infra", "--roles", &roles, "--episodes", "1"], &record].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    for gone in
        [&roles, &*scout.to_string_lossy(), &*folder.path().join("my carriers/carrier.policy.toml").to_string_lossy()]
    {
        std::fs::remove_file(gone).expect("it was there");
    }
    let output = run(&["replay", &records.join("repeat-0000.mcap").to_string_lossy()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("equal"), "{}", text(&output.stdout));
}

#[test]
fn roles_with_another_kind_of_message_are_refused_by_name() {
    let refused = |change: fn(String) -> String, words: &[&str]| {
        let folder = TempDir::new().expect("a folder");
        let roles = copied(&folder, change);
        refuses(&[&TEAM[..], &["--roles", &roles]].concat(), words);
    };
    let encoded = |contract: String| contract.replace("floats = 2\n", "floats = 2\nencoding = \"f16\"\n");
    refused(encoded, &["roles.carrier.policy", "the encoding f16", "'scout' f32"]);
    let named = |contract: String| contract.replace("name = \"potential field\"\n", "name = \"other\"\n");
    refused(named, &["roles.carrier.policy", "the name 'other'", "'scout' 'potential field'"]);
    let unnamed = |contract: String| contract.replace("name = \"potential field\"\n", "");
    refused(unnamed, &["roles.carrier.policy", "message.name"]);
    let odd = |contract: String| contract.replace("rate_hz = 10", "rate_hz = 13");
    refused(odd, &["roles.carrier.policy", "13.0 steps a second", "20.0"]);
    let wide = |contract: String| contract.replace("floats = 2\n", "floats = 3\n");
    refused(wide, &["roles.carrier.policy", "its output 'message' is [2]"]);
    let folder = TempDir::new().expect("a folder");
    let roles = copied(&folder, |contract| contract);
    let part =
        std::fs::read_to_string(&roles).expect("a text").replace("policy = \"my carriers/carrier.policy.toml\"\n", "");
    std::fs::write(&roles, part).expect("a file");
    // Robots of a role without a policy have the team's.
    refuses(&[&TEAM[..], &["--roles", &roles]].concat(), &["error: policy: its message", "floats", "'scout'"]);
    let built_in = [&TEAM[..], &["--roles", ROLES, "--policy", "orca"]].concat();
    refuses(&built_in, &["the policy 'orca' is of no robot"]);
}
