//! Sweeps on the command line: points that are simulations of their own, files that do not depend on kills and parts,
//! and refusals before anything is computed.

use std::path::Path;

use crate::program::{refuses, run, text};
use crate::study::{Place, begun, done, files, same};
use serde_json::Value;

/// Flags of `sim` that make a point take a tenth of a second.
const SHORT: [&str; 4] = ["--mode", "onboard-adhoc", "--episodes", "2"];

fn sweep(axes: &[&str]) -> Vec<String> {
    let axes = axes.iter().flat_map(|axis| ["--axis", axis]);
    ["study", "sweep"].into_iter().chain(axes).chain(SHORT).map(str::to_owned).collect()
}

fn words(args: &[String]) -> Vec<&str> {
    args.iter().map(String::as_str).collect()
}

fn rows(axes: &[&str], more: &[&str]) -> Vec<Value> {
    let output = done(&words(&sweep(axes)), &[more, &["--json", "--quiet"]].concat());
    let report: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    report["rows"].as_array().expect("rows").clone()
}

#[test]
fn every_point_is_the_simulation_with_its_values() {
    let found = rows(&["robots=3,5", "delay-ms=0,80"], &["--loss", "0.1", "--seed", "7"]);
    let at = |row: &Value| (row["at"]["robots"].as_f64(), row["at"]["delay-ms"].as_f64());
    let expected = [(3.0, 0.0), (5.0, 0.0), (3.0, 80.0), (5.0, 80.0)].map(|(robots, ms)| (Some(robots), Some(ms)));
    assert_eq!(found.iter().map(at).collect::<Vec<_>>(), expected);
    for row in &found {
        let [robots, delay] = ["robots", "delay-ms"].map(|axis| row["at"][axis].to_string());
        let sim =
            ["sim", "--loss", "0.1", "--seed", "7", "--robots", &robots, "--delay-ms", &delay, "--json", "--quiet"];
        let whole = |flag: &str| flag.trim_end_matches(".0").to_owned();
        let sim: Vec<String> = sim.iter().map(|word| whole(word)).collect();
        let output = run(&[&words(&sim)[..], &SHORT].concat());
        let alone: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
        for field in ["success_rate", "makespan_median_s", "robot_collisions"] {
            assert_eq!(row[field], alone[field], "{field} of {row}");
        }
        assert!((row["delivered"].as_f64().expect("latents cross links") - 0.9).abs() < 0.05, "{row}");
    }
}

#[test]
fn a_field_of_a_file_is_an_axis_and_so_is_the_rate_of_messages() {
    let place = Place::new();
    let task = place.at("task.toml");
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/tasks/four-rooms.toml");
    std::fs::copy(&file, &task).expect("an example");
    let time = ["--scenario", &task, "--policy", "orca", "--robots", "2"];
    let found = rows(&["scenario.rules.limit_s=1,120"], &time);
    assert_eq!(found[0]["timeouts"], 2, "a second is too short: {}", found[0]);
    assert_eq!(found[1]["timeouts"], 0, "{}", found[1]);
    assert_eq!(std::fs::read(&file).expect("it is there"), std::fs::read(&task).expect("it is there"));

    let delivered = |row: &Value| row["delivered"].as_f64().expect("messages cross links");
    let radio = rows(&["radio.noise_loss=0,0.5"], &["--radio", "wifi"]);
    assert!(delivered(&radio[0]) > delivered(&radio[1]) + 0.3, "{radio:?}");

    let late = |row: &Value| row["age_p50_ms"].as_f64().expect("messages cross links");
    let rates = rows(&["latent-rate-hz=4,20"], &[]);
    assert!(late(&rates[0]) > late(&rates[1]) + 30.0, "{rates:?}");
}

#[test]
fn a_killed_sweep_and_one_in_parts_have_the_files_of_one_that_ran_through() {
    let place = Place::new();
    let [whole, halves, parts] = ["whole", "halves", "parts"].map(|name| place.at(name));
    let sweep = sweep(&["robots=2,3,4,5,6,7", "radio=none,wifi"]);
    let args = [&words(&sweep)[..], &["--repeats", "2", "--quiet"]].concat();
    done(&args, &["--out", &whole]);
    let names = files(&whole);
    for name in ["points.csv", "points.json", "episodes.csv", "table.txt", "figures/sweep.svg"] {
        assert!(names.contains_key(Path::new(name)), "{name}");
    }
    let heads = text(&names[Path::new("points.csv")]);
    assert!(heads.starts_with("robots,radio,policy,episodes,success_rate,success_ci95_low,"), "{heads}");

    let (mut child, _) = begun(&args, &halves);
    child.kill().expect("SIGKILL");
    child.wait().expect("it ends");
    assert!(!files(&halves).contains_key(Path::new("report.html")), "it was killed half-way");
    done(&args, &["--out", &halves]);
    same(&whole, &halves);

    done(&args, &["--out", &parts, "--shard", "2/2"]);
    assert!(!files(&parts).contains_key(Path::new("report.html")), "a part writes no report");
    done(&args, &["--out", &parts, "--shard", "1/2"]);
    done(&args, &["--out", &parts]);
    same(&whole, &parts);
}

#[test]
fn an_axis_without_an_effect_is_told() {
    let place = Place::new();
    let conditions = place.at("conditions.toml");
    std::fs::write(&conditions, "lag_s = 0.1\n").expect("it can be written");
    let said = |args: &[&str]| {
        let sweep = sweep(&["conditions.lag_s=0.1,0.4"]);
        text(&done(&words(&sweep), &[&["--plant", "rigid", "--conditions", &conditions], args].concat()).stderr)
    };
    assert!(!said(&[]).contains("warning"));
    let covered = said(&["--lag-s", "0.3"]);
    assert!(covered.contains("warning: the points '0.1' and '0.4' are one simulation"), "{covered}");
}

#[test]
fn a_changed_file_is_another_sweep() {
    let place = Place::new();
    let (task, out) = (place.at("task.toml"), place.at("out"));
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/tasks/four-rooms.toml");
    let text = std::fs::read_to_string(file).expect("an example");
    std::fs::write(&task, &text).expect("it can be written");
    let sweep = sweep(&["robots=2,3"]);
    let args = [&words(&sweep)[..], &["--scenario", &task, "--policy", "orca", "--quiet", "--out", &out]].concat();
    done(&args, &[]);
    std::fs::write(&task, format!("{text}\n# changed\n")).expect("it can be written");
    refuses(&args, &["another study", "conditions"]);
}

#[test]
fn wrong_axes_are_refused_before_anything_is_computed() {
    let wrong = |axes: &[&str], more: &[&str], said: &[&str]| {
        refuses(&[&words(&sweep(axes))[..], more].concat(), said);
    };
    wrong(&["robots=40"], &[], &["--axis robots=40", "2 to 12"]);
    wrong(&["robots=4,x"], &[], &["--axis robots=x", "invalid digit"]);
    wrong(&["robots=4", "radio=wifi,telepathy"], &[], &["--axis robots=4, radio=telepathy", "no radio 'telepathy'"]);
    wrong(&["robots=4"], &["--robots", "5"], &["--axis robots", "--robots is given, too"]);
    wrong(&["robots=4", "robots=5"], &[], &["--axis", "robots", "twice"]);
    wrong(&["robots=4", "loss=0", "delay-ms=0"], &[], &["--axis: 3 of them", "one or two"]);
    wrong(&["telepathy=4"], &[], &["no flag '--telepathy'"]);
    wrong(&["repeats=4"], &[], &["repeats is no axis"]);
    wrong(&["latent-rate-hz=0"], &[], &["latent-rate-hz=0", "0 is not 0.1 to 1000"]);
    for flag in ["conditions", "faults", "radio", "roles", "scenario", "senses"] {
        wrong(&[&format!("{flag}.some.field=3")], &[], &[&format!("--{flag}: it names no file")]);
    }
    wrong(&["faults.some.field=3"], &["--faults", "7"], &["--faults: it names no file"]);
    wrong(&["deployment.gap_m=1.5"], &[], &["a mode takes its size from", "--gap-m"]);
    let modes = ["study", "sweep", "--axis", "mode=onboard-adhoc,sim", "--latent-rate-hz", "5"];
    refuses(&modes, &["--axis mode=sim: --latent-rate-hz", "no latent message"]);
    wrong(&["scenario=passage,flocking"], &[], &["some points have goals and others a cost"]);
    wrong(&["radio.telepathy=3"], &["--radio", "wifi"], &["--axis radio.telepathy=3", "telepathy"]);
    wrong(&["robots=4"], &["--policy", "shipped", "--policy", "orca"], &["--policy", "axis policy="]);
    wrong(&["robots=4"], &["--policy", "/nowhere/policy"], &["/nowhere/policy"]);
    refuses(&["study", "sweep"], &["--axis"]);
}
