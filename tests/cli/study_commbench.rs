//! The benchmark of communication on the command line: its rows and verdicts, files that do not depend on kills and
//! parts, policies that are entered, and refusals before anything is computed.

use std::path::Path;

use crate::program::{refuses, text};
use crate::study::{Place, begun, done, files, same};
use serde_json::Value;

/// Benchmark that takes a few seconds in a debug build.
const SMALL: [&str; 8] =
    ["study", "commbench", "--tasks", "passage", "--channels", "iid-30,bursts,wifi-3-20", "--episodes", "3"];

fn report(args: &[&str], more: &[&str]) -> Value {
    let output = done(args, &[more, &["--json", "--quiet"]].concat());
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

#[test]
fn every_policy_has_a_row_in_every_cell_and_is_held_against_the_others_and_the_perfect_channel() {
    let found = report(&SMALL, &["--seed", "4"]);
    let rows = found["rows"].as_array().expect("rows");
    let cells = [("perfect", 3), ("perfect", 5), ("iid-30", 5), ("bursts", 5), ("wifi-3-20", 3)];
    let expected = cells.iter().flat_map(|(channel, robots)| {
        ["scripted", "without", "trained"].map(|kind| (Some(*channel), Some(*robots), Some(kind)))
    });
    let place = |row: &Value| (row["channel"].as_str().map(str::to_owned), row["robots"].as_u64());
    let kinds = rows.iter().map(|row| row["entrant"].as_str());
    let there: Vec<_> = rows.iter().map(place).zip(kinds).collect();
    let expected: Vec<_> =
        expected.map(|(channel, robots, kind)| ((channel.map(str::to_owned), robots), kind)).collect();
    assert_eq!(there, expected);
    for row in rows {
        assert_eq!(row["episodes"], 3, "{row}");
        assert!(row["score"].as_f64().is_some_and(|score| score > 0.0) && row["unit"] == "s", "{row}");
    }
    // Three pairs of policies in each of five cells, and three policies against 'perfect' in three; two measures.
    let comparisons = found["comparisons"].as_array().expect("comparisons");
    assert_eq!(comparisons.len(), 2 * (3 * 5 + 3 * 3));
    assert!(comparisons.iter().all(|found| found["verdict"] == "tie" && found["pairs"] == 3), "three are too few");
    let delivered = |channel: &str| {
        let row = rows.iter().find(|row| row["channel"] == channel && row["entrant"] == "trained").expect("a row");
        row["delivered"].as_f64().expect("messages cross links")
    };
    assert!((delivered("iid-30") - 0.7).abs() < 0.05 && delivered("bursts") < 0.9 && delivered("perfect") == 1.0);
}

#[test]
fn a_killed_benchmark_and_one_in_parts_have_the_files_of_one_that_ran_through() {
    let place = Place::new();
    let [whole, halves, parts] = ["whole", "halves", "parts"].map(|name| place.at(name));
    let args = [&SMALL[..6], &["--episodes", "25", "--policies", "scripted,trained", "--quiet"]].concat();
    done(&args, &["--out", &whole]);
    let names = files(&whole);
    for name in ["rows.json", "comparisons.json", "empty.json", "episodes.csv", "table.txt"] {
        assert!(names.contains_key(Path::new(name)), "{name}");
    }
    for name in
        ["figures/passage-channels.svg", "figures/passage-wifi.svg", "trials/passage.iid-30.5.trained.0001.json"]
    {
        assert!(names.contains_key(Path::new(name)), "{name}");
    }
    let page = text(&names[Path::new("report.html")]);
    assert!(page.contains("Empty places") && page.contains("study commbench --tasks passage"), "{page}");

    let (mut child, _) = begun(&args, &halves);
    child.kill().expect("SIGKILL");
    child.wait().expect("it ends");
    assert!(!files(&halves).contains_key(Path::new("report.html")), "it was killed half-way");
    done(&args, &["--out", &halves]);
    same(&whole, &halves);

    done(&args, &["--out", &parts, "--shard", "2/2"]);
    assert!(!files(&parts).contains_key(Path::new("report.html")), "a part writes no report");
    done(&args, &["--out", &parts, "--shard", "1/2", "--jobs", "1"]);
    done(&args, &["--out", &parts]);
    same(&whole, &parts);
    refuses(&[&args[..], &["--out", &whole, "--seed", "9"]].concat(), &["another study", "seed"]);
}

#[test]
fn an_entered_policy_has_a_column_in_the_tasks_that_it_fits() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../policies/flocking-k1.safetensors");
    let mine = format!("mine={}", file.display());
    let args = ["study", "commbench", "--tasks", "passage,flocking", "--channels", "perfect", "--episodes", "1"];
    let found = report(&args, &["--policies", "scripted", "--enter", &mine]);
    let rows = found["rows"].as_array().expect("rows");
    let there: Vec<_> = rows.iter().map(|row| (row["task"].as_str(), row["entrant"].as_str())).collect();
    let expected = [("passage", "scripted"), ("flocking", "scripted"), ("flocking", "mine")];
    assert_eq!(there, expected.map(|(task, entrant)| (Some(task), Some(entrant))));
    let empty = found["empty"].as_array().expect("places");
    assert!(empty.iter().any(|place| place["task"] == "passage" && place["policy"] == "mine"), "{empty:?}");
    refuses(&[&args[..], &["--enter", &format!("{mine}:passage")]].concat(), &["mine", "flocking-k1"]);
}

#[test]
fn wrong_names_are_refused_with_what_there_is() {
    let wrong = |more: &[&str], said: &[&str]| refuses(&[&["study", "commbench"][..], more].concat(), said);
    wrong(&["--tasks", "chess"], &["chess", "passage"]);
    wrong(&["--channels", "telepathy"], &["telepathy", "iid-30"]);
    wrong(&["--policies", "best"], &["best", "scripted"]);
    wrong(&["--tasks", "passage,passage"], &["--tasks", "twice"]);
    wrong(&["--enter", "mine"], &["--enter", "NAME=POLICY"]);
    wrong(&["--enter", "mine=orca:chess"], &["no task 'chess'", "passage"]);
    wrong(&["--enter", "trained=orca"], &["'trained' is taken"]);
    wrong(&["--enter", "mine=/nowhere/policy"], &["/nowhere/policy"]);
    wrong(&["--enter", "a=orca:swap", "--enter", "a=shipped"], &["'a' is entered twice"]);
    wrong(&["--enter", "a=orca:swap", "--tasks", "passage"], &["'swap' is not among those of --tasks"]);
    wrong(&["--seed", "4294967296"], &["--seed", "4294967295"]);
    wrong(&["--episodes", "0"], &["--episodes"]);
    wrong(&["--shard", "1/2"], &["--out"]);
}
