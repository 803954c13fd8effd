//! Output, errors and exit codes of the program, above all of `sim`.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::program::{murmurate, refuses, run, text};
use murmurate::policy::manifest::{KEY, Manifest};
use murmurate::policy::weights;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use tempfile::TempDir;

struct Folder(TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(TempDir::new().expect("a temporary folder"))
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file; returns its path as text.
    fn file(&self, name: &str, content: impl AsRef<[u8]>) -> String {
        let path = self.path(name);
        std::fs::write(&path, content).expect("a temporary file");
        path.to_string_lossy().into_owned()
    }
}

#[test]
fn wrong_flags_are_refused_in_one_line() {
    refuses(&["sim", "--mode", "telepathy"], &["--mode", "telepathy", "onboard-adhoc"]);
    refuses(&["sim", "--scenario", "maze"], &["--scenario", "maze", "passage"]);
    refuses(&["sim", "--colour"], &["--colour"]);
    refuses(&["stop", "teams/offboard.toml", "--wait", "0.1"], &["--wait", "0.5 to 60 seconds"]);
    refuses(&["resume", "teams/offboard.toml", "--wait", "NaN"], &["--wait", "0.5 to 60 seconds"]);
    refuses(&["sim", "--episodes", "0"], &["--episodes", "0"]);
    refuses(&["sim", "--episodes", "many"], &["--episodes", "many"]);
    refuses(&["sim", "--repeats", "0"], &["--repeats"]);
    refuses(&["sim", "--jobs", "0"], &["--jobs"]);
    refuses(&["sim", "--robots", "13"], &["--robots", "2 to 12", "13"]);
    refuses(&["sim", "--seed", "-1"], &["-1"]);
    refuses(&["sim", "--policy", "orca", "--action", "mean"], &["--action", "orca"]);
    refuses(&["sim", "--action", "median"], &["--action", "median", "sample"]);
    refuses(&["sim", "--mode", "offboard", "--loss", "1.5"], &["--loss", "1.5"]);
    refuses(&["sim", "--mode", "offboard", "--loss", "NaN"], &["--loss", "NaN"]);
    refuses(&["sim", "--mode", "offboard", "--delay-ms=-3"], &["--delay-ms", "-3"]);
    refuses(&["sim", "--delay-ms", "20"], &["--delay-ms", "mode 'sim'", "crosses"]);
    refuses(&["sim", "--mode", "centralized", "--loss", "0.1"], &["--loss", "mode 'centralized'"]);
    refuses(&["sim", "--comm-range-m=-1"], &["--comm-range-m", "-1"]);
    refuses(&["sim", "--comm-range-std-m=-1"], &["--comm-range-std-m", "-1"]);
    refuses(&["sim", "--comm-range-m", "inf", "--comm-range-std-m", "1"], &["--comm-range-std-m"]);
    refuses(&["sim", "--impair", "some"], &["--impair", "some"]);
    refuses(&["sim", "--lag-s=-0.1"], &["--lag-s", "-0.1", "0 to 10"]);
    refuses(&["sim", "--lag-s", "11"], &["--lag-s", "11"]);
    refuses(&["sim", "--lag-s", "NaN"], &["--lag-s", "NaN"]);
    refuses(&["sim", "--lag-s", "slow"], &["--lag-s", "slow"]);
    refuses(&["sim", "--contacts", "bounce"], &["--contacts", "bounce", "judge"]);
    refuses(&["sim", "--wall-radius-m", "0"], &["--wall-radius-m", "0"]);
    refuses(&["sim", "--wall-radius-m", "10.5"], &["--wall-radius-m", "10.5"]);
    refuses(&["sim", "--wall-radius-m", "NaN"], &["--wall-radius-m", "NaN"]);
    refuses(&["sim", "--drive", "legs"], &["--drive", "legs", "differential"]);
    refuses(&["sim", "--drive", "differential"], &["--point-ahead-m", "missing"]);
    refuses(&["sim", "--point-ahead-m", "0.1"], &["--point-ahead-m", "differential"]);
    refuses(&["sim", "--speed-m-s", "0"], &["--speed-m-s", "above zero"]);
    refuses(&["sim", "--plant", "water"], &["--plant", "water", "rigid"]);
    refuses(&["sim", "--plant", "rigid", "--contacts", "judge"], &["--contacts", "'rigid'", "leave it out"]);
    refuses(&["sim", "--plant", "rigid", "--wall-radius-m", "0.2"], &["--wall-radius-m", "'rigid'", "0.16 m"]);
    refuses(&["sim", "--sensor", "radar"], &["--sensor", "radar", "motion-capture"]);
    refuses(&["sim", "--clamp", "none"], &["--clamp", "none", "deployed"]);
    refuses(&["sim", "--handling", "forget"], &["--handling", "forget", "as-published"]);
    refuses(&["sim", "--safety", "none"], &["--safety", "none", "deployed"]);
    refuses(&["sim", "--placement", "fly"], &["--placement", "fly", "drive"]);
    refuses(&["sim", "--radio", "wifi"], &["--radio", "'sim'"]);
    refuses(&["sim", "--mode", "offboard", "--radio", "smoke"], &["--radio", "smoke", "wifi-n"]);
    refuses(&["sim", "--mode", "offboard", "--impair", "all"], &["--impair", "--loss"]);
    refuses(&["deployment", "offboard", "--robots", "70000"], &["--robots", "70000"]);
    refuses(&["fly"], &["fly"]);
    refuses(&["deployment", "telepathy"], &["telepathy"]);
    refuses(&["deployment", "offboard", "--robots", "0"], &["robots", "0"]);
}

#[test]
fn wrong_files_are_refused_in_one_line_that_names_the_place() {
    let folder = Folder::new();
    let missing = folder.path("missing").to_string_lossy().into_owned();
    refuses(&["sim", "--policy", &missing], &["policy file", &missing]);
    refuses(&["sim", "--episodes-file", &missing], &["episodes file", &missing]);
    refuses(&["sim", "--faults", &missing], &["fault plan", &missing]);
    refuses(&["sim", "--deployment", &missing], &["deployment file", &missing]);
    refuses(&["sim", "--mode", "offboard", "--radio", &missing], &["radio file", &missing]);
    let radio = folder.file("room.toml", "noise_loss = 2\n");
    refuses(&["sim", "--mode", "offboard", "--radio", &radio], &["room.toml", "noise_loss", "2"]);
    refuses(&["sim", "--trajectories", "/nowhere/at/all.csv"], &["/nowhere/at/all.csv"]);
    refuses(&["sim", "--trajectories", &folder.0.path().to_string_lossy()], &["folder"]);

    let layouts = |content: &str, words: &[&str]| {
        let file = folder.file("episodes.json", content);
        refuses(&["sim", "--robots", "2", "--episodes", "1", "--episodes-file", &file], words);
    };
    layouts("not json", &["episodes.json", "line 1"]);
    layouts(r#"{"episodes": [], "more": 1}"#, &["more"]);
    layouts(r#"{"episodes": []}"#, &["0 episodes", "1 are wanted"]);
    layouts(r#"{"episodes": [[{"start": [0, -1], "goal": [0, 1]}]]}"#, &["episodes[0]", "1 robots"]);
    layouts(
        r#"{"episodes": [[{"start": [0, 0.3], "goal": [0, 1]}, {"start": [1.5, 0], "goal": [1, 1]}]]}"#,
        &["episodes[0]", "robot 1", "start"],
    );

    // Robots that drive to their starts must end the previous episode there.
    let episode = r#"[{"start": [0, -1.5], "goal": [0, 1.5]}, {"start": [1, -1.5], "goal": [1, 1.5]}]"#;
    let file = folder.file("apart.json", format!(r#"{{"episodes": [{episode}, {episode}]}}"#));
    let args = ["sim", "--robots", "2", "--episodes", "2", "--episodes-file", &file, "--placement"];
    refuses(&[&args[..], &["drive"]].concat(), &["--placement drive", "apart.json"]);
    assert_eq!(run(&[&args[..], &["exact", "--repeats", "1"]].concat()).status.code(), Some(0));

    let faults = |content: &str, words: &[&str]| {
        let file = folder.file("faults.toml", content);
        refuses(&["sim", "--mode", "offboard", "--faults", &file], words);
    };
    let crash = "[[actor]]\nactor = \"cache\"\nfault = \"crash\"\nat_s = 1\nfor_s = 1\n";
    faults(&crash.replace("cache", "cook"), &["faults.toml", "line 2", "actor", "controller"]);
    faults(&crash.replace("at_s", "at_ms"), &["at_ms"]);
    faults(&format!("{crash}robot = 7\n"), &["actor[0].robot", "7"]);
    faults("[[link]]\nlink = \"ad-hoc\"\nfault = \"drop\"\nfrom_s = 0\nuntil_s = 1\n", &["ad-hoc", "loopback"]);

    let deployment = |change: (&str, &str), words: &[&str]| {
        let sound = text(&run(&["deployment", "offboard"]).stdout);
        assert!(sound.contains(change.0), "{sound}");
        let file = folder.file("team.toml", sound.replacen(change.0, change.1, 1));
        refuses(&["sim", "--deployment", &file], words);
    };
    deployment(("robots = 5", "robots = 6"), &["team.toml", "robot 5 has no agent"]);
    deployment(("robots = 5", "robots = \"five\""), &["robots"]);
    deployment(("placement = \"drive\"", "placement = \"fly\""), &["line 3", "placement", "drive"]);
    deployment(("state_server = true", "state_sever = true"), &["state_sever"]);
    deployment(("\"latent\", ", ""), &["link.carries", "Latent"]);
    deployment(("name = \"agent-1\"", "name = \"agent-0\""), &["host.name"]);
    deployment(("agents = [[1]]", "agents = [[0]]"), &["robot 0", "second agent"]);
}

/// Tensors by name, with shape and bytes.
type Tensor = (String, Vec<usize>, Vec<u8>);

fn small() -> (Manifest, Vec<u8>) {
    let mut manifest = Manifest::published();
    (manifest.encoder, manifest.message, manifest.update) = (vec![6, 4, 3], vec![3, 5, 4], vec![4, 4]);
    let layers = |widths: &[usize]| -> Vec<(Vec<f32>, Vec<f32>)> {
        widths.windows(2).map(|pair| (vec![0.1; pair[0] * pair[1]], vec![0.2; pair[1]])).collect()
    };
    let tensors = [layers(&manifest.encoder), layers(&manifest.message), layers(&manifest.update)];
    let bytes = weights::write(&manifest, &tensors);
    (manifest, bytes)
}

/// Returns the small policy file with changed tensors or a changed manifest.
fn changed(tensors: impl Fn(&mut Vec<Tensor>), manifest: impl Fn(String) -> Option<String>) -> Vec<u8> {
    let (_, bytes) = small();
    let file = safetensors::SafeTensors::deserialize(&bytes).expect("it was just written");
    let (_, header) = safetensors::SafeTensors::read_metadata(&bytes).expect("it was just written");
    let metadata = header.metadata().clone().expect("it has a manifest");
    let mut all: Vec<Tensor> =
        file.tensors().iter().map(|(name, view)| (name.clone(), view.shape().to_vec(), view.data().to_vec())).collect();
    tensors(&mut all);
    let views = all.iter().map(|(name, shape, data)| {
        (name.as_str(), TensorView::new(Dtype::F32, shape.clone(), data).expect("shape and bytes agree"))
    });
    let text = manifest(metadata[KEY].clone());
    safetensors::serialize(views, text.map(|text| [(KEY.to_owned(), text)].into())).expect("it serialises")
}

#[test]
fn wrong_policy_files_are_refused_by_tensor_and_shape() {
    let folder = Folder::new();
    let whole = small().1;
    let refused = |content: Vec<u8>, words: &[&str]| {
        let file = folder.file("policy.safetensors", content);
        refuses(&["sim", "--policy", &file], words);
    };
    let same = |text: String| Some(text);
    refused(b"this is no policy".to_vec(), &["policy.safetensors", "safetensors file"]);
    refused(whole[..whole.len() - 7].to_vec(), &["not a complete safetensors file"]);
    refused(Vec::new(), &["not a complete safetensors file"]);
    refused(
        changed(|t| t.retain(|(name, ..)| name != "message.2.bias"), same),
        &["'message.2.bias'", "missing", "[4]"],
    );
    let transposed = |t: &mut Vec<Tensor>| {
        t.iter_mut().filter(|(name, ..)| name == "encoder.2.weight").for_each(|(_, shape, _)| shape.reverse());
    };
    refused(changed(transposed, same), &["'encoder.2.weight'", "[4, 3]", "expected [3, 4]"]);
    let poisoned = |t: &mut Vec<Tensor>| {
        let bias = t.iter_mut().find(|(name, ..)| name == "update.0.bias").expect("it is there");
        bias.2[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    };
    refused(changed(poisoned, same), &["'update.0.bias'", "NaN", "index 1", "[4]"]);
    let extra = |t: &mut Vec<Tensor>| t.push(("critic.0.bias".to_owned(), vec![1], vec![0; 4]));
    refused(changed(extra, same), &["'critic.0.bias'", "not part of the network"]);
    let retouched = |t: &mut Vec<Tensor>| t[0].2[0] ^= 1;
    refused(changed(retouched, same), &["SHA-256"]);
    refused(changed(|_| (), |_| None), &["'encoder.0.weight'", "expected [16, 6]"]);
    refused(
        changed(|_| (), |text| Some(text.replace("\"radius_m\":2.0", "\"radius_m\":-2.0"))),
        &["manifest", "radius_m"],
    );
    refused(changed(|_| (), |text| Some(text.replace("\"format\":1", "\"format\":2"))), &["manifest", "format"]);
    refused(changed(|_| (), |text| Some(text.replace("rate_hz", "rate"))), &["manifest", "rate"]);
    refused(changed(|_| (), |text| Some(text.replace("\"rate_hz\":20.0", "\"rate_hz\":2.0"))), &["rate_hz"]);
    refused(changed(|_| (), |_| Some("{".to_owned())), &["manifest"]);
    refused(changed(|_| (), |text| Some(text.replace("passage", "swap"))), &["scenario 'swap'"]);

    let file = folder.file("policy.safetensors", whole);
    let sound = run(&["sim", "--policy", &file, "--episodes", "1", "--repeats", "1"]);
    assert_eq!(sound.status.code(), Some(0), "the unchanged file runs: {}", text(&sound.stderr));
    refuses(&["sim", "--policy", &file, "--scenario", "swap"], &["scenario 'passage'", "'swap'"]);
}

#[test]
fn a_wrong_log_level_is_refused() {
    for (wanted, named) in [("[[[", "'[[['"), ("inof", "'inof'"), ("warn,murmurate=loud", "loud")] {
        let output = murmurate(&["sim", "--episodes", "1"]).env("MURMURATE_LOG", wanted).output().expect("it starts");
        assert_eq!(output.status.code(), Some(2), "{wanted}");
        let said = text(&output.stderr);
        assert!(said.contains("MURMURATE_LOG") && said.contains(named), "{said}");
    }
}

#[cfg(unix)]
#[test]
fn trajectories_go_through_links_and_into_devices() {
    let folder = Folder::new();
    let target = folder.file("target.csv", "before");
    let link = folder.path("link.csv");
    std::os::unix::fs::symlink(&target, &link).expect("a link");
    let args = ["sim", "--episodes", "1", "--repeats", "1", "--trajectories"];
    assert!(run(&[&args[..], &[&link.to_string_lossy()]].concat()).status.success());
    assert!(link.is_symlink() && std::fs::read_to_string(&target).expect("it is there").starts_with("repeat,"));
    let output = run(&[&args[..], &["/dev/stdout", "--quiet"]].concat());
    assert!(output.status.success() && text(&output.stdout).contains("repeat,episode,phase"));
}

#[test]
fn the_beginning_of_a_mode_is_answered_with_the_modes_that_begin_so() {
    refuses(&["sim", "--mode", "onboard"], &["onboard-infra or onboard-adhoc"]);
    refuses(&["sim", "--mode", "swarm"], &["swarm", "centralized", "offboard"]);
}

#[test]
fn json_is_one_object_with_the_documented_fields_for_any_number_of_jobs() {
    let json = |jobs: &str| {
        let args = ["sim", "--mode", "offboard", "--episodes", "2", "--repeats", "3", "--json", "--jobs", jobs];
        let output = run(&args);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert_eq!(text(&output.stderr), "", "there is nothing to say");
        serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("one JSON object")
    };
    let (one, two) = (json("1"), json("2"));
    let fields = [
        "mode",
        "episodes",
        "successes",
        "success_rate",
        "success_ci95",
        "makespan_median_s",
        "robot_collisions",
        "wall_collisions",
        "timeouts",
        "aborted",
        "unseen",
        "collisions_robot",
        "collisions_wall",
        "aborts",
        "virtual_s",
        "wall_s",
        "messages",
        "trace_hash",
        "seed",
    ];
    for field in fields {
        assert!(one.get(field).is_some_and(|value| !value.is_null()), "{field} is there");
        if field != "wall_s" {
            assert_eq!(one[field], two[field], "{field} does not depend on the jobs");
        }
    }
    assert_eq!(one["episodes"], 6);
    assert_eq!(one["safety"]["stop"], 0);
}

#[test]
fn flags_of_the_robots_take_effect_and_their_defaults_change_nothing() {
    let trace = |args: &[&str]| {
        let common = ["sim", "--mode", "onboard-adhoc", "--loss", "0.5", "--episodes", "1", "--repeats", "1", "--json"];
        let output = run(&[&common[..], args].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("one JSON object")["trace_hash"].clone()
    };
    let flags = [
        ("--lag-s", "0", "0.3"),
        ("--wall-radius-m", "0.25", "0.49"),
        ("--clamp", "training", "deployed"),
        ("--handling", "hold", "as-published"),
        ("--safety", "deployed", "emulated"),
        ("--placement", "drive", "exact"),
    ];
    let plain = trace(&[]);
    for (flag, default, other) in flags {
        assert_eq!(trace(&[flag, default]), plain, "{flag} {default}");
        assert_ne!(trace(&[flag, other]), plain, "{flag} {other}");
    }
    // With a limit of speed the reported velocities are not rounded above it, so the trace is another than without.
    let speed = |most| trace(&["--speed-m-s", most]);
    assert_eq!(speed("10"), speed("20"), "neither is reached");
    assert_ne!(speed("10"), speed("0.2"));
    // Nearly as wide as the gap and without the filter, so that contacts occur.
    let wide = ["--safety", "emulated", "--wall-radius-m", "0.49"];
    let contacts = |contacts| trace(&[&wide[..], &["--contacts", contacts]].concat());
    assert_eq!(contacts("block"), trace(&wide));
    assert_ne!(contacts("block"), contacts("judge"));
}

#[test]
fn a_policy_that_was_trained_for_another_drive_is_named() {
    let said = |args: &[&str]| {
        let common = ["sim", "--episodes", "1", "--repeats", "1"];
        let output = run(&[&common[..], args].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stderr)
    };
    let wheels = ["--drive", "differential", "--point-ahead-m", "0.1"];
    let warned = said(&wheels);
    let words = ["warning", "shipped", "holonomic", "robot 0", "0.1 m ahead", "--drive"];
    assert!(words.iter().all(|word| warned.contains(word)), "{warned}");
    assert_eq!(said(&[&wheels[..], &["--quiet"]].concat()), "");
    assert!(!said(&[&wheels[..], &["--policy", "orca"]].concat()).contains("warning"), "it is trained for none");
    assert!(!said(&[]).contains("warning"));
}

#[test]
fn trajectories_are_written_completely() {
    let folder = Folder::new();
    let path = folder.file("paths.csv", "what was there before");
    let output = run(&["sim", "--episodes", "1", "--repeats", "2", "--trajectories", &path]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let mut reader = csv::Reader::from_path(&path).expect("it can be read");
    let columns = reader.headers().expect("it has a head").len();
    let rows: Vec<csv::StringRecord> = reader.records().map(|row| row.expect("a whole row")).collect();
    assert!(rows.len() > 500 && rows.len().is_multiple_of(5), "{} rows", rows.len());
    assert!(rows.iter().all(|row| row.len() == columns));
    assert_eq!(rows.last().expect("there are rows")[0].to_owned(), "1", "the last repeat is there");
    assert_eq!(std::fs::read_dir(folder.0.path()).expect("the folder").count(), 1, "nothing else is left behind");
}

#[test]
fn ctrl_c_prints_the_results_so_far() {
    let mut child = murmurate(&["sim", "--episodes", "100000", "--repeats", "4", "--json"])
        .env("MURMURATE_LOG", "info")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut line = String::new();
    let mut talk = BufReader::new(child.stderr.take().expect("it was piped"));
    talk.read_line(&mut line).expect("it says that it listens");
    assert!(line.contains("Ctrl-C"), "{line}");
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill is there");
    assert!(killed.success());
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(output.status.code(), Some(130));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert_eq!(json["interrupted"], true);
    assert!(json["trace_hash"].is_null(), "half a run has no trace to compare");
}

#[test]
fn a_printed_deployment_can_be_run() {
    let folder = Folder::new();
    let printed = run(&["deployment", "onboard-adhoc", "--robots", "3"]);
    let file = folder.file("team.toml", printed.stdout);
    let trace = |args: &[&str]| {
        let output = run(&[&["sim", "--episodes", "1", "--repeats", "1", "--json"], args].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).expect("one JSON object")["trace_hash"].clone()
    };
    assert_eq!(trace(&["--deployment", &file]), trace(&["--mode", "onboard-adhoc", "--robots", "3"]));
}

#[test]
fn output_has_no_colours_and_help_goes_to_stdout() {
    for args in [&["--help"][..], &["sim", "--help"], &["--version"]] {
        let output = run(args);
        assert_eq!(output.status.code(), Some(0));
        assert!(!output.stdout.is_empty() && output.stderr.is_empty());
        assert!(!text(&output.stdout).contains('\u{1b}'), "no colour where there is no terminal");
    }
    assert!(Path::new(env!("CARGO_BIN_EXE_murmurate")).exists());
}
