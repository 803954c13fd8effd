//! Policies of format 3 on the command line: `policy check`, `sim`, and what is refused.

use std::path::Path;

use crate::program::{refuses, run, text};
use serde_json::Value;
use tempfile::TempDir;

const FIELD: &str = "tests/onnx/data/field.policy.toml";
/// Messages of 1500 floats.
const WIDE: &str = "tests/onnx/data/wide.policy.toml";
const LIDAR: &str = "tests/onnx/data/lidar.policy.toml";
const RECURRENT: &str = "tests/onnx/data/recurrent.policy.toml";

/// Copies a policy's contract into a folder, with one text replaced by another, and its graphs beside it.
fn changed(folder: &TempDir, contract: &str, from: &str, to: &str) -> String {
    let data = Path::new(crate::program::ROOT).join("tests/onnx/data");
    for entry in std::fs::read_dir(&data).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.extension().is_some_and(|ending| ending == "onnx") {
            std::fs::copy(&path, folder.path().join(path.file_name().expect("a name"))).expect("a copy");
        }
    }
    let content = std::fs::read_to_string(Path::new(crate::program::ROOT).join(contract)).expect("a contract");
    assert!(content.contains(from), "{from:?}");
    let path = folder.path().join("changed.policy.toml");
    std::fs::write(&path, content.replacen(from, to, 1)).expect("a file");
    path.to_string_lossy().into_owned()
}

#[test]
fn policy_check_says_what_a_policy_takes_gives_and_remembers() {
    let output = run(&["policy", "check", RECURRENT]);
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
    let said = text(&output.stdout);
    for words in [
        "recurrent with attention",
        "rten 0.24.0",
        "goal = goal-minus-position [2] [m, policy frame], velocity [2] [m/s, policy frame]",
        "own - theirs, policy frame",
        "velocity [m/s], policy frame, at most 1.5 along each axis, 20 times a second",
        "6 floats (24 bytes as f32), used within 2 m for 0.2 s",
        "12 floats, from zeros at each episode and after a gap of 0.5 s",
        "us with 4 neighbours, here",
    ] {
        assert!(said.contains(words), "'{words}' is missing in: {said}");
    }
    let output = run(&["policy", "check", RECURRENT, "--json"]);
    let facts: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!((&facts["manifest"]["format"], &facts["manifest"]["state"]["floats"]), (&3.into(), &12.into()));
    assert!(facts["step_us"].as_f64().is_some_and(|us| us > 0.0), "{facts}");
}

#[test]
fn a_policy_of_format_3_runs_in_every_mode_and_twice_alike() {
    for mode in ["sim", "onboard-adhoc"] {
        let flags = ["--mode", mode, "--episodes", "2", "--repeats", "1", "--json", "--policy"];
        let traces = [FIELD, RECURRENT, FIELD].map(|policy| {
            let output = run(&[&["sim", "--scenario", "swap"], &flags[..], &[policy]].concat());
            assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
            let facts: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
            facts["trace_hash"].as_str().expect("a trace").to_owned()
        });
        assert_eq!(traces[0], traces[2], "{mode}");
        assert_ne!(traces[0], traces[1], "{mode}: another policy");
    }
}

#[test]
fn a_record_of_a_policy_of_two_graphs_holds_them_and_replays_alike() {
    let folder = TempDir::new().expect("a folder");
    let (records, policy) = (folder.path().join("records"), changed(&folder, FIELD, "field", "field"));
    let place = records.to_string_lossy();
    let flags = ["--episodes", "1", "--repeats", "1", "--quiet", "--record", &*place, "--policy", &*policy];
    let output = run(&[&["sim", "--scenario", "swap"], &flags[..]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    // The record needs none of the files.
    for entry in std::fs::read_dir(folder.path()).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_file() {
            std::fs::remove_file(path).expect("it is there");
        }
    }
    let output = run(&["replay", &*place]);
    assert!(text(&output.stdout).contains("equal"), "{} {}", text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(0));
}

#[test]
fn a_policy_with_a_lidar_runs_in_every_mode_twice_alike_and_from_its_record() {
    let folder = TempDir::new().expect("a folder");
    for mode in ["sim", "centralized", "offboard", "onboard-infra", "onboard-adhoc"] {
        let records = folder.path().join(mode).to_string_lossy().into_owned();
        let flags = ["--mode", mode, "--senses", "examples/lidar.toml", "--policy", LIDAR, "--record", &*records];
        let more = ["--episodes", "2", "--repeats", "1", "--json"];
        let output = run(&[&["sim", "--scenario", "swap"], &flags[..], &more].concat());
        assert_eq!(output.status.code(), Some(0), "{mode}: {}", text(&output.stderr));
        let facts: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
        assert!(facts["successes"].as_u64() >= Some(1), "{mode}: {facts}");
        // The record has the file of the senses, and its replay runs the trial again.
        let output = run(&["replay", &records]);
        assert!(text(&output.stdout).contains("equal"), "{} {}", text(&output.stdout), text(&output.stderr));
        assert_eq!(output.status.code(), Some(0), "{mode}");
    }
}

#[test]
fn a_policy_without_its_sense_and_senses_that_do_not_fit_are_refused() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("senses.toml").to_string_lossy().into_owned();
    let sim = |more: &[&str], words: &[&str]| {
        refuses(&[&["sim", "--scenario", "swap", "--policy", LIDAR], more].concat(), words);
    };
    sim(&[], &["observation 'lidar'", "there is no channel 'lidar' here", "[senses.lidar]"]);
    for (content, words) in [
        ("[senses.lidar]\nkind = \"lidar\"\nrays = 16\nrange_m = 2.0", ["takes an array [32]", "'lidar' is [16]"]),
        ("[senses.lidar]\nkind = \"lidar\"\nrays = 32\nrange_m = 1.5", ["as far as 2 m", "'lidar' 1.5 m"]),
        ("[senses.lidar]\nkind = \"lidar\"\nrays = 32\nrange_m = 2.0\nopening_rad = 3.0", ["all around", "'body'"]),
        ("[senses.lidar]\nkind = \"nose\"", ["senses.toml", "senses.lidar.kind: there is no kind of sense 'nose'"]),
        ("[senses.lidar]\nkind = \"lidar\"\nrange_m = 2.0", ["senses.lidar", "missing field `rays`"]),
        ("[lidar]\nkind = \"lidar\"", ["senses.toml", "unknown field `lidar`"]),
        (
            "[senses.lidar]\nkind = \"program\"\ncommand = [\"x\"]\nshape = [32]\nunit = \"m\"",
            ["senses.lidar.kind", "'program' runs in real time"],
        ),
    ] {
        std::fs::write(&path, content).expect("a file");
        sim(&["--senses", &path], &words);
    }
}

#[test]
fn what_does_not_fit_is_refused_in_one_line_with_both_sides() {
    let folder = TempDir::new().expect("a folder");
    let sim = |policy: &str, words: &[&str]| refuses(&["sim", "--policy", policy, "--scenario", "swap"], words);
    let of = |from: &str, to: &str| changed(&folder, RECURRENT, from, to);
    sim(&of("velocity]", "lidar]"), &["changed.policy.toml", "input 'velocity' is no observation of the contract"]);
    let gap = of("source = \"goal-minus-position\"", "source = \"gap\"");
    sim(&gap, &["policy", "observation 'goal'", "there is no channel 'gap' here; there are: position, velocity"]);
    sim(&of("recurrent.onnx", "../recurrent.onnx"), &["names a graph that is not beside it"]);
    sim(&of("recurrent.onnx", "gone.onnx"), &["cannot read the graph of the policy", "gone.onnx"]);
    sim(&of("kind = \"velocity\"", "kind = \"velocity\"\nspeed = 1"), &["its contract: line", "unknown field `speed`"]);
    let twist = of(
        "kind = \"velocity\"\nunit = \"m/s\"\nframe = \"policy\"",
        "kind = \"twist\"\nunit = \"m/s\"\nframe = \"body\"",
    );
    sim(&twist, &["it commands a yaw rate", "has a holonomic drive"]);
    refuses(&["policy", "check", "tests/onnx/data/recurrent.onnx"], &["its metadata 'murmurate' are missing"]);
    refuses(&["policy", "check", "tests/onnx/data/bad-nobody.policy.toml"], &["with no neighbour", "is not finite"]);
    refuses(&["policy", "check", "tests/onnx/data/bad-chance.policy.toml"], &["RandomNormalLike"]);
    let path = folder.path().join("key.policy.toml");
    std::fs::write(&path, "0f1e2d3c4b5a69788796a5b4c3d2e1f00f1e2d3c4b5a69788796a5b4c3d2e1f0\n").expect("a file");
    refuses(&["policy", "check", &path.to_string_lossy()], &["is a key file, no policy file"]);
}

#[test]
fn a_graph_that_takes_too_much_memory_is_refused_by_a_process_that_may_not() {
    refuses(&["policy", "check", "tests/onnx/data/bad-memory.policy.toml"], &["its check ended without an answer"]);
}

#[test]
fn a_message_of_many_floats_travels_in_parts_and_is_heard_as_it_was_sent() {
    let said = text(&run(&["policy", "check", WIDE]).stdout);
    assert!(
        said.contains("1500 floats (3000 bytes as f16 in 3 parts: a missing one is that of the message before)"),
        "{said}"
    );
    let folder = TempDir::new().expect("a folder");
    let flags = ["--scenario", "swap", "--episodes", "1", "--repeats", "1", "--json", "--policy"];
    let messages = |mode: &str, policy: &str| {
        let output = run(&[&["sim", "--mode", mode], &flags[..], &[policy]].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let facts: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
        (facts["trace_hash"].clone(), facts["successes"].clone())
    };
    // Within one process they are rounded as on the wire.
    for encoding in ["f32", "bf16", "int8"] {
        let policy = changed(&folder, WIDE, "\"f16\"", &format!("\"{encoding}\""));
        let [one, again] = [0; 2].map(|_| messages("onboard-adhoc", &policy));
        assert_eq!(one, again, "{encoding}");
        assert_eq!(one.1, 1, "{encoding}");
    }
}

#[test]
fn a_radio_that_cannot_carry_the_messages_is_refused_with_both_figures() {
    let folder = TempDir::new().expect("a folder");
    let large = changed(&folder, WIDE, "rate_hz = 10", "rate_hz = 50");
    let sim = |radio: &str| {
        ["sim", "--scenario", "swap", "--mode", "onboard-adhoc", "--radio", radio, "--policy"].map(str::to_owned)
    };
    let args = [&sim("wifi")[..], std::slice::from_ref(&large)].concat();
    let words =
        ["8 robots x 1500 floats as f16 at 50 Hz need 10.", "Mbit/s of 'ad-hoc'; this channel's multicast carries 0.6"];
    refuses(&args.iter().map(String::as_str).collect::<Vec<_>>(), &words);
}
