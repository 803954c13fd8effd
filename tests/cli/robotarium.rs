//! Folders for the Robotarium: what they hold, whether their actor answers as this program does, and what is refused.
//! `just full-robotarium` runs them in the Robotarium's simulator.

use std::path::Path;
use std::process::{Command, Output};

use crate::program::skip::skip;
use crate::program::{refuses, run, text};
use serde_json::Value;
use tempfile::TempDir;

const WAREHOUSE: [&str; 4] =
    ["--policy", "policies/warehouse.safetensors", "--scenario", "examples/robotarium/warehouse.toml"];
const PASSAGE: [&str; 6] = ["--scenario", "passage", "--scale", "0.47", "--hull-m", "0.06"];

fn export(folder: &Path, flags: &[&str]) -> Output {
    let out = folder.to_str().expect("its path is text");
    run(&[&["export", "robotarium"], flags, &[out]].concat())
}

fn exported(flags: &[&str]) -> TempDir {
    let folder = TempDir::new().expect("a temporary folder");
    let output = export(folder.path(), flags);
    assert_eq!(output.status.code(), Some(0), "{flags:?}: {}", text(&output.stderr));
    folder
}

fn experiment(folder: &TempDir) -> Value {
    let text = std::fs::read_to_string(folder.path().join("experiment.json")).expect("the experiment");
    serde_json::from_str(&text).expect("it is JSON")
}

/// Runs the folder's comparison; `None` without numpy.
fn checked(folder: &TempDir) -> Option<Output> {
    let numpy = Command::new("python3").args(["-c", "import numpy"]).output();
    if !numpy.is_ok_and(|output| output.status.success()) {
        skip("numpy", "python3 has no numpy");
        return None;
    }
    Some(Command::new("python3").arg(folder.path().join("check.py")).output().expect("python3 starts"))
}

#[test]
fn a_folder_has_the_task_as_simulations_draw_it_and_turns_long_ground() {
    let folder = exported(&[&WAREHOUSE[..], &["--episodes", "3"]].concat());
    for file in ["README.md", "main.py", "actor.py", "guard.py", "way.py", "check.py", "weights.npy"] {
        assert!(folder.path().join(file).is_file(), "{file}");
    }
    let warehouse = experiment(&folder);
    assert_eq!((&warehouse["robots"], &warehouse["turned"]), (&4.into(), &false.into()));
    assert_eq!(warehouse["episodes"].as_array().map(Vec::len), Some(3));
    assert_eq!(warehouse["episodes"][0]["goal"], warehouse["episodes"][1]["start"]);
    let floats: u64 = warehouse["tensors"].as_array().expect("tensors").iter().map(floats).sum();
    let bytes = std::fs::metadata(folder.path().join("weights.npy")).expect("the weights").len();
    assert_eq!(bytes, 128 + 4 * floats, "a header, and all floats");
    let passage = experiment(&exported(&[&["--policy", "shipped", "--robots", "4"], &PASSAGE[..]].concat()));
    assert_eq!((&passage["turned"], passage["walls"].as_array().map(Vec::len)), (&true.into(), Some(2)));
}

fn floats(tensor: &Value) -> u64 {
    tensor["shape"].as_array().expect("a shape").iter().map(|axis| axis.as_u64().expect("a length")).product()
}

#[test]
fn the_actor_in_numpy_answers_as_this_program_does() {
    let hops = |file: &'static str| [&["--policy", file, "--robots", "5"], &PASSAGE[..]].concat();
    let all = [
        WAREHOUSE.to_vec(),
        hops("shipped"),
        hops("published"),
        hops("tests/data/conv_three_hops.safetensors"),
        hops("tests/data/conv_transformer.safetensors"),
    ];
    for flags in &all {
        let folder = exported(flags);
        let Some(output) = checked(&folder) else { return };
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(output.status.success(), "{flags:?}: {said}");
    }
}

#[test]
fn a_weight_that_is_another_one_is_found() {
    let folder = exported(&WAREHOUSE);
    let path = folder.path().join("weights.npy");
    let mut bytes = std::fs::read(&path).expect("the weights");
    bytes[128..132].copy_from_slice(&9.0_f32.to_le_bytes());
    std::fs::write(&path, bytes).expect("a file");
    if let Some(output) = checked(&folder) {
        assert!(!output.status.success());
        assert!(text(&output.stderr).contains("the actor is not the policy"), "{}", text(&output.stderr));
    }
}

#[test]
fn what_the_robotarium_cannot_run_is_refused_in_one_line() {
    let folder = TempDir::new().expect("a temporary folder");
    let out = folder.path().join("out");
    let out = out.to_str().expect("its path is text");
    let refused = |flags: &[&str], said: &[&str]| {
        refuses(&[&["export", "robotarium"], flags, &[out]].concat(), said);
        assert!(!Path::new(out).exists(), "{flags:?}: nothing was written");
    };
    let shipped = ["--policy", "shipped"];
    refused(&[&["--policy", "absent.safetensors"], &PASSAGE[..]].concat(), &["absent.safetensors"]);
    refused(&[&["--policy", "orca"], &PASSAGE[..]].concat(), &["--policy orca", "no trained policy"]);
    let graph = ["--policy", "tests/onnx/data/field-act.onnx"];
    refused(&[&graph, &PASSAGE[..]].concat(), &["format 3, an ONNX graph", "numpy"]);
    let channels = ["--policy", "tests/data/memory.safetensors"];
    refused(&[&channels, &PASSAGE[..]].concat(), &["it observes 'turned'"]);
    let large = ["--scenario", "passage", "--hull-m", "0.08", "--scale", "0.5"];
    refused(&[&shipped, &large[..]].concat(), &["2.00 m x 3.00 m", "0.12 m too wide", "--scale, 0.94 of"]);
    let many = ["--scenario", "swap", "--robots", "60", "--hull-m", "0.06"];
    refused(&[&["--policy", "policies/swap-any-size.safetensors"], &many[..]].concat(), &["--robots", "at most 50"]);
    refused(&[&shipped, &["--task", "flocking"][..]].concat(), &["'flocking' has a cost in place of goals"]);
    let small = ["--scenario", "passage", "--hull-m", "0.05", "--scale", "0.4"];
    refused(&[&shipped, &small[..]].concat(), &["--hull-m", "0.055"]);
    let unlabelled = ["--scenario", "examples/tasks/unlabelled-table.toml"];
    refused(&[&shipped, &unlabelled[..]].concat(), &["unlabelled goals"]);
    let senses = ["--scenario", "examples/tasks/scouts.toml"];
    refused(&[&shipped, &senses[..]].concat(), &["--scenario: 'scouts'"]);
}

#[test]
fn a_folder_that_has_files_is_left_as_it_is() {
    let folder = TempDir::new().expect("a temporary folder");
    std::fs::write(folder.path().join("mine.txt"), "mine").expect("a file");
    let output = export(folder.path(), &WAREHOUSE);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("it exists and is not empty"), "{}", text(&output.stderr));
    assert_eq!(std::fs::read_dir(folder.path()).expect("the folder").count(), 1);
}
