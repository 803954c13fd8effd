//! `murmurate policy check`, and the comparison of policies by `murmurate sim`.

use std::path::Path;

use crate::program::{refuses, run, text};
use safetensors::tensor::{SafeTensors, TensorView};
use serde_json::{Value, json};
use tempfile::TempDir;

fn path(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(name).to_string_lossy().into_owned()
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
    let output = run(&["policy", "check", &path("policies/passage-any-size.safetensors")]);
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
    refuses(&["policy", "check", "robust", "--scenario", "swap"], &["robust", "swap"]);
    refuses(&["policy", "check", "nowhere.safetensors"], &["nowhere.safetensors"]);
    refuses(&["policy", "check", &path("Cargo.toml")], &["Cargo.toml", "its contract", "format: it is missing"]);
}

/// Writes a copy of the policy file `name` with the manifest as `change` leaves it; without one if it returns false.
fn with_manifest(folder: &TempDir, name: &str, change: impl Fn(&mut Value) -> bool) -> String {
    let bytes = std::fs::read(path(name)).expect("the file is there");
    let file = SafeTensors::deserialize(&bytes).expect("it is a policy file");
    let (_, header) = SafeTensors::read_metadata(&bytes).expect("it has a header");
    let mut manifest = serde_json::from_str(&header.metadata().as_ref().unwrap()["murmurate"]).expect("it is JSON");
    let metadata = change(&mut manifest).then(|| [("murmurate".to_owned(), manifest.to_string())].into());
    let views: Vec<(String, TensorView)> = file.tensors();
    let bytes = safetensors::serialize(views, metadata).expect("it serialises");
    let path = folder.path().join("changed.safetensors");
    std::fs::write(&path, bytes).expect("a temporary file");
    path.to_string_lossy().into_owned()
}

/// Sets the field at a path such as `/hops/0/heads`.
fn set(at: &'static str, value: Value) -> impl Fn(&mut Value) -> bool {
    move |manifest| {
        let (table, field) = at.rsplit_once('/').expect("a path");
        match manifest.pointer_mut(table).expect("the table is there") {
            Value::Array(list) => list[field.parse::<usize>().expect("an index")] = value.clone(),
            fields => fields[field] = value.clone(),
        }
        true
    }
}

#[test]
fn an_error_of_a_manifest_names_the_field_with_its_path_its_value_and_what_may_be_there() {
    let folder = TempDir::new().expect("a temporary folder");
    let [one, two] = ["tests/data/python_full.safetensors", "tests/data/conv_gatv2.safetensors"];
    for (name, at, value, words) in [
        (one, "/format", json!("1"), "format: \"1\"; this program reads 1 and 2, as a number"),
        (one, "/format", json!(3), "format: 3; this program reads 1 and 2"),
        (one, "/observation", json!("position"), "observation: \"position\"; expected a list"),
        (one, "/observation/1", json!("lidar"), "observation.1: \"lidar\"; expected goal-minus-position, "),
        (one, "/activation", json!("gelu"), "activation: \"gelu\"; this program runs relu only"),
        (one, "/architecture", json!("Full"), "architecture: \"Full\"; expected published or full"),
        (one, "/encoder/0", json!(-6), "encoder.0: -6; expected a whole number, 0 or more"),
        (one, "/draw", json!(null), "draw: null; expected mean or sample"),
        (one, "/radius_m", json!("2 m"), "radius_m: \"2 m\"; expected a number"),
        (one, "/author", json!("x"), "author: there is no such field; there are format, scenario, "),
        (two, "/observation/1", json!("lidar"), "observation.1: \"lidar\"; expected goal-minus-position, "),
        (two, "/action", json!("force"), "action: \"force\"; expected velocity or acceleration"),
        (two, "/hops/0/aggregation", json!("median"), "hops.0.aggregation: \"median\"; expected sum, mean, max, "),
        (two, "/hops/0/score/activation", json!("sigmoid"), "hops.0.score.activation: \"sigmoid\"; expected linear, "),
        (
            two,
            "/hops/0/score/activation",
            json!("leaky-relu"),
            "hops.0.score.activation: \"leaky-relu\"; expected a num",
        ),
        (two, "/hops/0/self_loop", json!(true), "hops.0.self_loop: true; expected zero-edge or mean-edge"),
        (two, "/hops/0/heads", json!(3), "hops.0.heads: 3; expected 1 to 64"),
        (two, "/hops/0/update/bias", json!(0), "hops.0.update.bias: there is no such field; there are inputs, "),
        (two, "/decoder/widths", json!(8), "decoder.widths: 8; expected a list"),
    ] {
        let file = with_manifest(&folder, name, set(at, value));
        let serdes = ["variant", "invalid type", " line ", " column ", "u32", "usize", "sequence", "struct"];
        for command in [&["policy", "check", &file][..], &["sim", "--policy", &file]] {
            refuses(command, &["changed.safetensors", "manifest", words]);
            let said = text(&run(command).stderr);
            assert!(serdes.iter().all(|word| !said.contains(word)), "words of the parser: {said}");
        }
    }
    let missing = with_manifest(&folder, two, |manifest| {
        manifest["hops"][0].as_object_mut().is_some_and(|hop| hop.remove("aggregation").is_some())
    });
    refuses(&["policy", "check", &missing], &["hops.0.aggregation: it is missing"]);
}

#[test]
fn policy_check_refuses_a_scenario_that_the_program_does_not_have_as_sim_does() {
    let folder = TempDir::new().expect("a temporary folder");
    for name in ["tests/data/python_full.safetensors", "tests/data/conv_gatv2.safetensors"] {
        let file = with_manifest(&folder, name, set("/scenario", json!("football")));
        for flags in [&[][..], &["--json"]] {
            refuses(&[&["policy", "check", &file], flags].concat(), &["'football'", "passage", "swap"]);
        }
        refuses(&["sim", "--policy", &file], &["'football'"]);
    }
}

#[test]
fn what_is_no_policy_file_is_called_by_its_name_with_what_to_do() {
    let folder = TempDir::new().expect("a temporary folder");
    let one = "tests/data/python_full.safetensors";
    let forgotten = with_manifest(&folder, one, |_| false);
    refuses(&["sim", "--policy", &forgotten], &["it has no manifest", "'murmurate'", "docs/bring-your-policy.md"]);
    let upper = |manifest: &mut Value| {
        manifest["sha256"] = manifest["sha256"].as_str().expect("a digest").to_uppercase().into();
        true
    };
    refuses(&["sim", "--policy", &with_manifest(&folder, one, upper)], &["sha256", "upper case", "lower case"]);
    let short = with_manifest(&folder, one, set("/sha256", json!("abc")));
    refuses(&["policy", "check", &short], &["sha256: \"abc\"; expected 64 hexadecimal digits"]);
    let other = with_manifest(&folder, one, set("/sha256", json!("0".repeat(64))));
    refuses(&["policy", "check", &other], &["SHA-256", "changed"]);
    for (content, words) in [
        (&b"PK\x03\x04\0\0data.pkl"[..], ["torch.save", "murmurate.export"]),
        (b"\x80\x02}q\0.", ["torch.save", "murmurate.export"]),
        (b"\x89HDF\r\n\x1a\n", ["HDF5", "docs/bring-your-policy.md"]),
        (b"\x89MCAP0\r\n", ["record of a run", "record info"]),
        (b"\x8c\xa6format\x01", ["checkpoint of a training", "'policy.safetensors'"]),
        (b"robots = 5\n", ["a text", "safetensors file"]),
    ] {
        let file = folder.path().join("a.pt");
        std::fs::write(&file, content).expect("a temporary file");
        refuses(&["sim", "--policy", &file.to_string_lossy()], &[&["a.pt"], &words[..]].concat());
    }
}

#[test]
fn a_training_that_is_given_a_policy_in_place_of_a_checkpoint_asks_for_the_checkpoint() {
    let folder = TempDir::new().expect("a temporary folder");
    let out = folder.path().join("out").to_string_lossy().into_owned();
    let args = ["train", "passage", "--steps", "1", "--out", &out, "--from"];
    let policy = path("policies/passage.safetensors");
    refuses(&[&args[..], &[&policy]].concat(), &["policy file", "optimiser", "checkpoint.bin"]);
    let checkpoint = folder.path().join("a.pt");
    std::fs::write(&checkpoint, b"PK\x03\x04\0\0data.pkl").expect("a temporary file");
    refuses(&[&args[..], &[&*checkpoint.to_string_lossy()]].concat(), &["a.pt", "PyTorch"]);
}

#[test]
fn the_default_policy_is_the_shipped_one_with_the_filter_where_robots_act_by_themselves() {
    let of = |flags: &[&str]| {
        let output = run(&[&["sim", "--episodes", "2", "--json", "--quiet"], flags].concat());
        assert_eq!(output.status.code(), Some(0), "{flags:?}: {}", text(&output.stderr));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("one JSON object")
    };
    let trace = |flags: &[&str]| of(flags)["trace_hash"].clone();
    let usual = of(&["--mode", "offboard"]);
    assert_eq!((&usual["policy"], &usual["episodes"]), (&"shipped".into(), &2.into()));
    let written = ["--mode", "offboard", "--policy", "shipped", "--safety", "deployed", "--repeats", "1"];
    assert_eq!(usual["trace_hash"], trace(&written));
    assert_eq!(usual["trace_hash"], trace(&["--mode", "offboard", "--policy", "any-size"]), "a former name");
    assert_ne!(usual["trace_hash"], trace(&["--mode", "offboard", "--policy", "robust"]));
    assert_ne!(usual["trace_hash"], trace(&["--mode", "offboard", "--safety", "emulated"]));
    assert_eq!(trace(&[]), trace(&["--mode", "sim", "--safety", "emulated"]), "lock step: the conditions of training");
    let swap = ["--scenario", "swap", "--robots", "4", "--mode", "offboard"];
    assert_eq!(of(&swap)["policy"], "orca", "which is better there in most conditions");
    assert_eq!(of(&[&swap[..], &["--policy", "shipped"]].concat())["successes"], 2);
}

#[test]
fn without_flags_there_are_many_layouts_once_and_a_file_has_as_many_as_it_holds() {
    let folder = TempDir::new().expect("a temporary folder");
    let of = |flags: &[&str]| {
        let output = run(&[&["sim", "--scenario", "swap", "--robots", "2", "--json", "--quiet"], flags].concat());
        assert_eq!(output.status.code(), Some(0), "{flags:?}: {}", text(&output.stderr));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("one JSON object")
    };
    assert_eq!(of(&[])["episodes"], 200);
    let file = folder.path().join("layouts.json");
    let robots = "[{\"start\":[-1,0],\"goal\":[1,0]},{\"start\":[1,0],\"goal\":[-1,0]}]";
    std::fs::write(&file, format!("{{\"episodes\":[{robots},{robots},{robots}]}}")).expect("a temporary file");
    let file = file.to_str().expect("its path is text");
    assert_eq!(of(&["--episodes-file", file])["episodes"], 3);
    assert_eq!(of(&["--episodes-file", file, "--episodes", "2", "--repeats", "2"])["episodes"], 4);
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
