//! `murmurate train` on the command line: its files, its interruption, and its refusals.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::program::{murmurate, refuses, run, text};
use murmurate::chassis::DriveKind;
use murmurate_train::config::Config;
use tempfile::TempDir;

/// Returns a configuration that trains quickly, changed by `change`.
fn small(change: impl Fn(&mut Config)) -> String {
    let mut config = Config::preset("robust").expect("it is a preset");
    (config.ppo.environments, config.ppo.decisions, config.ppo.minibatch) = (40, 4, 80);
    (config.policy.encoder, config.policy.update) = (vec![6, 6], vec![8]);
    config.policy.message = vec![8, 8, 8];
    change(&mut config);
    toml::to_string(&config).expect("a configuration is TOML")
}

/// Folder with the small configuration in it.
struct Place(TempDir);

impl Place {
    fn new() -> Place {
        let place = Place(TempDir::new().expect("a temporary folder"));
        std::fs::write(place.at("small.toml"), small(|_| ())).expect("a temporary file");
        place
    }

    fn at(&self, name: &str) -> String {
        self.0.path().join(name).to_string_lossy().into_owned()
    }
}

#[test]
fn a_training_ends_in_a_policy_that_runs() {
    let place = Place::new();
    let (config, out) = (place.at("small.toml"), place.at("runs/first"));
    let trained = run(&["train", "passage", "--config", &config, "--steps", "800", "--out", &out, "--json"]);
    assert_eq!(trained.status.code(), Some(0), "{}", text(&trained.stderr));
    let json: serde_json::Value = serde_json::from_slice(&trained.stdout).expect("one JSON object");
    assert_eq!((&json["decisions"], &json["interrupted"]), (&800.into(), &false.into()));
    assert_eq!(json["evaluation"][0]["conditions"], "perfect");
    for name in ["policy.safetensors", "checkpoint.bin", "curve.csv", "curve.svg", "config.toml"] {
        assert!(Path::new(&out).join(name).is_file(), "{name}");
    }
    let curve = std::fs::read_to_string(place.at("runs/first/curve.csv")).expect("the curve");
    assert_eq!(curve.lines().count(), 1 + 5, "a row for each of 5 iterations of 160 decisions");
    assert!(curve.starts_with("elapsed_s,progress,iteration,decisions"), "{curve}");
    let plot = std::fs::read_to_string(place.at("runs/first/curve.svg")).expect("the plot");
    assert!(plot.contains("success [%]") && plot.contains("decisions [million]"), "axes have names and units");

    let policy = place.at("runs/first/policy.safetensors");
    let ran = run(&["sim", "--policy", &policy, "--episodes", "2", "--repeats", "1", "--json"]);
    assert_eq!(ran.status.code(), Some(0), "{}", text(&ran.stderr));

    // The written file is a valid configuration.
    let again = place.at("runs/second");
    let written = place.at("runs/first/config.toml");
    let trained = run(&["train", "passage", "--config", &written, "--steps", "800", "--out", &again, "--quiet"]);
    assert_eq!((trained.status.code(), text(&trained.stderr)), (Some(0), String::new()));
    let read = |path: &str| std::fs::read(path).expect("the policy");
    assert_eq!(read(&policy), read(&place.at("runs/second/policy.safetensors")), "and gives the same weights");
}

#[test]
fn ctrl_c_saves_and_a_resumed_training_is_the_same_bit_for_bit() {
    let place = Place::new();
    let config = place.at("small.toml");
    let train = |out: &str, more: &[&str]| {
        let args = ["train", "passage", "--config", &config, "--steps", "800", "--seed", "4", "--out", out];
        murmurate(&[&args, more].concat())
    };
    let (whole, halves) = (place.at("whole"), place.at("halves"));
    assert!(train(&whole, &["--quiet"]).status().expect("it starts").success());

    let mut child =
        train(&halves, &[]).env("MURMURATE_LOG", "murmurate=info").stderr(Stdio::piped()).spawn().expect("it starts");
    // It handles Ctrl-C once it logs that it trains; five iterations and their evaluations take seconds.
    let mut lines = BufReader::new(child.stderr.take().expect("it is piped")).lines();
    assert!(lines.any(|line| line.is_ok_and(|line| line.contains("Ctrl-C saves"))));
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill is there");
    assert!(killed.success());
    let told: Vec<String> = lines.map_while(Result::ok).collect();
    assert_eq!(child.wait().expect("it ends").code(), Some(130), "{told:?}");
    assert!(told.iter().any(|line| line.contains("--resume")), "{told:?}");

    refuses(
        &["train", "passage", "--config", &config, "--steps", "800", "--out", &halves],
        &["halves", "holds a training already", "--resume"],
    );
    assert!(train(&halves, &["--resume", "--quiet"]).status().expect("it starts").success());
    let read = |folder: &str, name: &str| std::fs::read(Path::new(folder).join(name)).expect("it was written");
    for name in ["policy.safetensors", "checkpoint.bin"] {
        assert_eq!(read(&whole, name), read(&halves, name), "{name}");
    }
}

#[test]
fn a_printed_configuration_is_for_the_team_of_the_scenario() {
    let printed = |args: &[&str]| {
        let output = run(&[args, &["--print-config"]].concat());
        assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
        Config::from_toml(&text(&output.stdout)).expect("it is a configuration")
    };
    let swap = printed(&["train", "swap"]);
    assert_eq!((&swap.curriculum[0].groups, &swap.curriculum[1].groups), (&vec![vec![3, 5]], &vec![vec![8]]));
    assert_eq!(printed(&["train", "passage"]), Config::preset("robust").expect("it is a preset"));
    let any = printed(&["train", "passage", "--preset", "any-size"]);
    assert_eq!((any.robots, &any.curriculum[0].groups[0]), (Some(12), &vec![2, 3, 2, 3, 2]));
    let two = printed(&["train", "passage", "--preset", "published", "--robots", "2"]);
    assert_eq!((two.robots, &two.curriculum[0].groups), (Some(2), &vec![vec![2]]), "no robot trains by itself");
    let wheels = printed(&["train", "passage", "--drive", "differential", "--point-ahead-m", "0.1"]);
    assert_eq!((wheels.chassis().drive, wheels.chassis().point_ahead_m), (DriveKind::Differential, 0.1));
    refuses(&["train", "passage", "--print-config", "--drive", "differential"], &["--point-ahead-m", "missing"]);
    refuses(&["train", "passage", "--print-config", "--robots", "40"], &["--robots", "2 to 12"]);
    let set =
        run(&["train", "passage", "--print-config", "--set", "ppo.clip=0.1", "--set", "conditions.loss=[0.1, 0.2]"]);
    let said = text(&set.stdout);
    assert!(said.contains("clip = 0.1\n") && said.contains("loss = [0.1, 0.2]"), "{said}");
    for (wrong, words) in [
        ("ppo.clip", "FIELD=VALUE"),
        ("ppo.clap=1", "--set ppo.clap=1: ppo.clap: unknown field"),
        ("ppo.clip=much", "--set ppo.clip=much: ppo.clip: invalid type"),
        ("ppo.clip=-1", "clip"),
        ("episode_s.most=1", "'episode_s' has no fields"),
    ] {
        refuses(&["train", "passage", "--print-config", "--set", wrong], &["--set", words]);
    }
    refuses(&["train", "passage", "--print-config", "--steps", "5"], &["--print-config", "--steps"]);
}

#[test]
fn wrong_flags_files_and_folders_are_refused_in_one_line() {
    let place = Place::new();
    let (config, out) = (place.at("small.toml"), place.at("out"));
    let base = ["train", "passage", "--config", &config, "--out", &out];
    let refused = |more: &[&str], words: &[&str]| refuses(&[&base, more].concat(), words);
    refused(&[], &["--minutes", "--steps"]);
    refused(&["--minutes", "0"], &["--minutes", "0"]);
    refused(&["--minutes", "nan"], &["--minutes"]);
    refused(&["--steps", "0"], &["--steps"]);
    refused(&["--steps", "5", "--minutes", "1"], &["--steps", "--minutes"]);
    refused(&["--steps", "5", "--preset", "robust"], &["--preset", "--config"]);
    refused(&["--steps", "5", "--threads", "0"], &["--threads"]);
    refused(&["--steps", "5", "--resume"], &["cannot resume", "checkpoint.bin"]);
    refuses(&["train", "passage", "--steps", "5", "--out", &out, "--preset", "best"], &["best", "published", "robust"]);
    refuses(&["train", "ballet", "--steps", "5", "--out", &out], &["ballet", "passage"]);
    let unlabelled = "examples/tasks/unlabelled.toml";
    refuses(
        &["train", unlabelled, "--steps", "5", "--out", &out],
        &["goals are unlabelled", "\"near-goals\", shape = [4, 2]"],
    );
    refuses(&["train", "passage", "--steps", "5"], &["--out"]);
    refuses(
        &["train", "swap", "--config", &config, "--steps", "5", "--out", &out],
        &["groups", "5", "8", "--print-config"],
    );

    let wrong = |text: String, words: &[&str]| {
        let file = place.at("wrong.toml");
        std::fs::write(&file, text).expect("a temporary file");
        let args = ["train", "passage", "--config", &file, "--steps", "5", "--out", &out];
        refuses(&args, &[&["wrong.toml"], words].concat());
    };
    wrong("episode_s = 15".to_owned(), &["missing field"]);
    wrong(small(|_| ()).replace("gamma", "gama"), &["gama"]);
    wrong(small(|config| config.ppo.gamma = 2.0), &["ppo.gamma", "2"]);
    wrong(small(|config| config.ppo.environments = 0), &["ppo.environments"]);
    wrong(small(|config| config.conditions.loss = [0.5, 0.2]), &["conditions.loss"]);
    wrong(small(|config| config.reward.wall = f32::NAN), &["reward.wall"]);
    wrong(small(|config| config.curriculum[0].groups = vec![vec![2, 4]]), &["groups", "6", "5"]);
    wrong(small(|config| config.curriculum[0].gap_m = Some(9.0)), &["gap", "9"]);
    wrong(small(|config| config.curriculum.truncate(1)), &["curriculum[0].until"]);
    wrong(small(|config| config.policy.message = vec![8]), &["policy.message"]);
    wrong(small(|config| config.policy.hold_s = 0.0), &["policy.hold_s"]);
    wrong(small(|config| config.policy.encoder = vec![8, 300]), &["policy.encoder", "300"]);

    let file = place.at("file");
    std::fs::write(&file, "here").expect("a temporary file");
    refuses(&["train", "passage", "--steps", "5", "--out", &file], &["--out", "file"]);
    refuses(&["train", "passage", "--steps", "5", "--out", "/proc/nowhere"], &["--out", "/proc/nowhere"]);
}

#[test]
fn another_training_s_checkpoint_is_not_resumed() {
    let place = Place::new();
    let (config, out) = (place.at("small.toml"), place.at("out"));
    let train = ["train", "passage", "--steps", "320", "--out", &out];
    let begun = run(&[&train[..], &["--config", &config, "--seed", "4"]].concat());
    assert_eq!(begun.status.code(), Some(0), "{}", text(&begun.stderr));
    let resumed = |more: &[&str], words: &[&str]| refuses(&[&train[..], &["--resume"], more].concat(), words);
    resumed(&["--seed", "5"], &["cannot resume", "seed", "4", "5"]);
    resumed(&["--preset", "published"], &["cannot resume", "preset", "published"]);
    let other = place.at("other.toml");
    std::fs::write(&other, small(|config| config.ppo.clip = 0.1)).expect("a temporary file");
    resumed(&["--config", &other], &["cannot resume", "configuration"]);
    refuses(&["train", "swap", "--steps", "320", "--out", &out, "--resume"], &["cannot resume", "swap", "passage"]);

    // Training can start from its weights if the networks are the same.
    let (checkpoint, next) = (place.at("out/checkpoint.bin"), place.at("next"));
    let begin = |config: &str| {
        run(&["train", "passage", "--steps", "160", "--out", &next, "--config", config, "--from", &checkpoint])
    };
    assert_eq!(begin(&other).status.code(), Some(0), "another configuration is what it is for");
    std::fs::remove_dir_all(&next).expect("it was made");
    let wider = place.at("wider.toml");
    std::fs::write(&wider, small(|config| config.policy.update = vec![9])).expect("a temporary file");
    let refused = text(&begin(&wider).stderr);
    assert!(refused.contains("cannot begin with") && refused.contains("9, 4]"), "{refused}");

    let whole = std::fs::read(&checkpoint).expect("it was written");
    std::fs::write(&checkpoint, &whole[..whole.len() / 2]).expect("a temporary file");
    resumed(&[], &["cannot resume", "checkpoint"]);
}

#[test]
fn a_diverged_training_keeps_the_last_good_checkpoint() {
    let place = Place::new();
    let config = place.at("wild.toml");
    let wild = |config: &mut Config| {
        (config.ppo.learning_rate, config.ppo.kl_stop) = ([1.0, 1.0], f32::INFINITY);
        (config.ppo.epochs, config.reward.scale) = (20, 1e4);
    };
    std::fs::write(&config, small(wild)).expect("a temporary file");
    let out = place.at("out");
    let ended = run(&["train", "passage", "--config", &config, "--steps", "100000", "--out", &out]);
    let told = text(&ended.stderr);
    assert_eq!(ended.status.code(), Some(1), "{told}");
    let last = told.trim_end().lines().last().unwrap_or_default();
    for word in ["iteration", "non-finite value", "learning rate", "kept"] {
        assert!(last.contains(word), "'{word}' is missing in: {last}");
    }
    assert!(Path::new(&out).join("checkpoint.bin").is_file(), "there is one from the beginning");
}
