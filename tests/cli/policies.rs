//! `murmurate policy check`, and the comparison of policies by `murmurate sim`.

use std::path::Path;

use crate::program::{refuses, run, text};
use tempfile::TempDir;

fn path(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name).to_string_lossy().into_owned()
}

/// Writes a copy of a file with one text replaced by another of the same length.
fn changed(folder: &TempDir, name: &str, from: &str, to: &str) -> String {
    let mut bytes = std::fs::read(path(name)).expect("the file is there");
    assert_eq!(from.len(), to.len());
    let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).expect("the text is in the file");
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    let path = folder.path().join("changed.safetensors");
    std::fs::write(&path, bytes).expect("a temporary file");
    path.to_string_lossy().into_owned()
}

#[test]
fn policy_check_says_what_a_file_is() {
    let output = run(&["policy", "check", &path("policies/passage.safetensors")]);
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
    let said = text(&output.stdout);
    for words in
        ["can run it", "passage", "relu", "sum", "velocity [m/s], policy frame", "128 bytes", "none in the file"]
    {
        assert!(said.contains(words), "'{words}' is missing in: {said}");
    }
    let built_in = run(&["policy", "check", "shipped"]);
    let own = |text: &str| text.split_once('\n').expect("several lines").1.to_owned();
    assert_eq!(own(&text(&built_in.stdout)), own(&said), "the same policy");
    let output = run(&["policy", "check", &path("tests/data/python_full.safetensors"), "--json"]);
    let facts: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!(facts["manifest"]["activation"], "relu");
    assert_eq!((&facts["probe"]["robots"], &facts["warnings"]), (&5.into(), &serde_json::json!([])));
    assert!(facts["probe"]["output_difference"].as_f64().is_some_and(|difference| difference < 1e-4), "{facts}");
}

#[test]
fn policy_check_refuses_what_the_program_cannot_run() {
    let folder = TempDir::new().expect("a temporary folder");
    let of = |from: &str, to: &str| changed(&folder, "tests/data/python_full.safetensors", from, to);
    let tanh = of("relu", "tanh");
    refuses(&["policy", "check", &tanh], &["changed.safetensors", "activation", "relu"]);
    refuses(&["sim", "--policy", &tanh], &["changed.safetensors", "activation", "relu"]);
    refuses(&["policy", "check", &of("\\\"sum\\\"", "\\\"max\\\"")], &["aggregation", "sum"]);
    refuses(&["policy", "check", &of("probe.age", "probe.old")], &["probe.age", "missing"]);
    refuses(&["policy", "check", "orca"], &["orca", "code"]);
    refuses(&["policy", "check", "shipped", "--scenario", "swap"], &["shipped", "swap"]);
    refuses(&["policy", "check", "nowhere.safetensors"], &["nowhere.safetensors"]);
    refuses(&["policy", "check", &path("Cargo.toml")], &["Cargo.toml", "safetensors"]);
}

#[test]
fn sim_compares_policies_on_the_same_episodes() {
    let both = ["sim", "--policy", "shipped", "--policy", "orca", "--episodes", "2", "--repeats", "2"];
    let output = run(&both);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.contains("policy shipped") && said.contains("policy orca") && said.contains("it alone"), "{said}");
    let output = run(&[&both[..], &["--json"]].concat());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    let alone = run(&["sim", "--policy", "orca", "--episodes", "2", "--repeats", "2", "--json"]);
    let alone: serde_json::Value = serde_json::from_slice(&alone.stdout).expect("one JSON object");
    assert_eq!(json["policies"][1]["trace_hash"], alone["trace_hash"], "the same run as by itself");
    assert_eq!(json["alone_successful"].as_array().map(Vec::len), Some(2));
    refuses(&[&both[..], &["--svg", "episode.svg"]].concat(), &["--policy", "one"]);
}
