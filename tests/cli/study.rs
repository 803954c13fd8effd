//! Studies on the command line: rows and their schema, files that do not depend on threads or interruptions, refusals
//! before anything is computed, and properties of any result.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use crate::program::{murmurate, refuses, run, text};
use serde_json::Value;
use tempfile::TempDir;

/// Study that takes a second or two in a debug build.
const SMALL: [&str; 12] = [
    "study",
    "modes",
    "--robots",
    "3",
    "--layouts",
    "2",
    "--repeats",
    "2",
    "--columns",
    "sim,onboard-adhoc-noise",
    "--seed",
    "5",
];

/// Folder of a test.
pub struct Place(TempDir);

impl Place {
    /// Makes the folder.
    pub fn new() -> Place {
        Place(TempDir::new().expect("a temporary folder"))
    }

    /// Returns the path of the name in it.
    pub fn at(&self, name: &str) -> String {
        self.0.path().join(name).to_string_lossy().into_owned()
    }
}

/// Returns every file of a folder, by its relative path.
pub fn files(folder: &str) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![PathBuf::from(folder)];
    while let Some(next) = folders.pop() {
        for entry in std::fs::read_dir(&next).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).expect("it is below").to_owned();
                found.insert(name, std::fs::read(&path).expect("a file"));
            }
        }
    }
    found
}

/// Runs a study with more flags, to its end.
pub fn done(args: &[&str], more: &[&str]) -> Output {
    let output = run(&[args, more].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    output
}

fn columns(args: &[&str]) -> Vec<Value> {
    let output = done(args, &["--json", "--quiet"]);
    assert_eq!(text(&output.stderr), "");
    let json: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert!(json["wall_s"].is_f64() && json["seed"].is_u64(), "{json}");
    json["columns"].as_array().expect("rows").clone()
}

/// Fails unless two folders have the same files, with a report.
pub fn same(one: &str, other: &str) {
    let (one, other) = (files(one), files(other));
    assert!(one.contains_key(Path::new("report.html")), "{:?}", one.keys());
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(other[name] == *bytes, "{} differs", name.display());
    }
}

#[test]
fn every_column_of_the_table_has_its_row() {
    let both =
        ["--policy", "shipped", "--policy", "orca@as-published", "--robots", "3", "--layouts", "1", "--repeats", "1"];
    let rows = columns(&[&["study", "modes"], &both[..]].concat());
    let names: Vec<&str> = rows.iter().map(|row| row["name"].as_str().expect("a name")).collect();
    let table = murmurate_study::columns::MODES;
    let expected: Vec<&str> = table.iter().flat_map(|&name| [name, name]).collect();
    assert_eq!(names, expected);
    for row in &rows {
        assert_eq!(row["episodes"], 1, "{row}");
        let [rate, low, high] = [&row["success_rate"], &row["success_ci95"][0], &row["success_ci95"][1]]
            .map(|value| value.as_f64().expect("a share"));
        assert!(low <= rate && rate <= high && (0.0..=1.0).contains(&rate), "{row}");
        assert_eq!(row["makespan_median_s"].is_f64(), rate > 0.0, "{row}");
        let crosses = !matches!(row["name"].as_str(), Some("sim" | "centralized"));
        assert_eq!(row["delivered"].is_f64(), crosses, "{row}");
        let paper = [&row["paper_success_rate"], &row["paper_makespan_median_s"]];
        assert!(paper.iter().all(|value| value.is_null()), "the paper had five robots: {row}");
    }
    assert_eq!((&rows[0]["policy"], &rows[0]["handling"]), (&"shipped".into(), &"default".into()));
    assert_eq!((&rows[1]["policy"], &rows[1]["handling"]), (&"orca".into(), &"as-published".into()));
}

#[test]
fn the_paper_s_results_stand_only_beside_what_the_paper_ran() {
    let small = ["study", "modes", "--columns", "sim", "--layouts", "1", "--repeats", "1", "--quiet"];
    let both = ["--policy", "published", "--policy", "shipped"];
    let rows = columns(&[&small[..8], &both].concat());
    let paper = |row: &Value| [row["paper_success_rate"].as_f64(), row["paper_makespan_median_s"].as_f64()];
    assert_eq!(rows.iter().map(paper).collect::<Vec<_>>(), [[Some(0.958), Some(6.3)], [None, None]]);
    let said = |args: &[&str]| text(&done(&[&small[..], args].concat(), &[]).stdout);
    let table = said(&both);
    let (ours, shipped) = table.split_once("policy shipped").expect("a table for each policy");
    assert!(ours.contains("paper") && !shipped.contains("paper"), "{table}");
    assert!(table.contains("1 layout x 1 repeat,") && table.contains("of 2 trials;"), "{table}");
    for other in [
        &["--policy", "published", "--robots", "3"][..],
        &["--policy", "published", "--gap-m", "1.5"],
        &["--policy", "published", "--drive", "differential", "--point-ahead-m", "0.1"],
        &["--policy", "orca"],
        &["--policy", "orca", "--scenario", "swap"],
    ] {
        let table = said(other);
        assert!(!table.contains("paper") && table.contains("sim"), "{other:?}: {table}");
    }
}

#[test]
fn files_do_not_depend_on_threads_and_the_report_loads_no_file() {
    let place = Place::new();
    let (one, two) = (place.at("one"), place.at("two"));
    done(&SMALL, &["--jobs", "1", "--out", &one]);
    done(&SMALL, &["--jobs", "2", "--out", &two]);
    same(&one, &two);

    let files = files(&one);
    let page = text(&files[Path::new("report.html")]);
    for word in ["src=", "href=", "url(", "@import", "<script"] {
        assert!(!page.contains(word), "the page loads something: {word}");
    }
    for word in
        ["murmurate study modes", "--seed 5", "onboard-adhoc-noise", "makespan [s]", "d_origin [m]", "delay [ms]"]
    {
        assert!(page.contains(word), "the page does not say {word}");
    }
    for figure in ["success-modes", "makespan-1", "position-1", "separation-1", "delay-1"] {
        assert!(files[&PathBuf::from(format!("figures/{figure}.svg"))].starts_with(b"<svg"), "{figure}");
        #[cfg(feature = "png")]
        assert!(files[&PathBuf::from(format!("figures/{figure}.png"))].starts_with(b"\x89PNG"), "{figure}");
    }
    let mut csv = csv::Reader::from_reader(&files[Path::new("episodes.csv")][..]);
    assert_eq!(csv.headers().expect("heads").iter().next(), Some("column"));
    assert_eq!(csv.records().count(), 2 * 2 * 2, "columns x repeats x layouts");
}

/// Starts a study on one thread and waits until it has written the record of a trial.
pub fn begun(args: &[&str], out: &str) -> (Child, impl Iterator<Item = String> + use<>) {
    let mut command = murmurate(&[args, &["--jobs", "1", "--out", out]].concat());
    let command = command.env("MURMURATE_LOG", "murmurate=info").stdout(Stdio::null()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("the program starts");
    let mut lines = BufReader::new(child.stderr.take().expect("it is piped")).lines().map_while(Result::ok);
    assert!(lines.any(|line| line.contains("kept ")), "it keeps a trial");
    (child, lines)
}

#[test]
fn a_killed_or_interrupted_study_continues_to_the_same_files() {
    let place = Place::new();
    let (whole, halves) = (place.at("whole"), place.at("halves"));
    // Twenty trials: the first is recorded long before the last begins.
    let args = ["study", "delay", "--robots", "2", "--layouts", "1", "--repeats", "1", "--quiet"];
    done(&args, &["--out", &whole]);

    let (mut child, _) = begun(&args, &halves);
    child.kill().expect("SIGKILL");
    child.wait().expect("it ends");
    let kept = files(&halves);
    assert!(!kept.contains_key(Path::new("report.html")), "it was killed half-way");

    let (mut child, lines) = begun(&args, &halves);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill is there");
    assert!(sent.success());
    let told: Vec<String> = lines.collect();
    assert_eq!(child.wait().expect("it ends").code(), Some(130), "{told:?}");
    assert!(told.iter().any(|line| line.contains("the same command goes on from there")), "{told:?}");

    // An incomplete file is not used as a record.
    let torn = kept.keys().find(|name| name.starts_with("trials")).expect("a trial was kept");
    std::fs::write(Path::new(&halves).join(torn), "{\"column\":").expect("a file");
    done(&args, &["--out", &halves]);
    same(&whole, &halves);
}

/// Changes each trial's file in a folder, runs the study again, and returns its output.
fn with_changed_trials(args: &[&str], out: &str, change: impl Fn(&str, &[u8]) -> Vec<u8>) -> (String, String) {
    let whole = files(out);
    let trials: Vec<&PathBuf> = whole.keys().filter(|name| name.starts_with("trials")).collect();
    assert!(!trials.is_empty());
    for name in trials {
        let changed = change(&name.to_string_lossy(), &whole[name]);
        assert!(changed != whole[name], "{} is changed", name.display());
        std::fs::write(Path::new(out).join(name), changed).expect("it can be written");
    }
    let output = done(args, &["--out", out]);
    assert!(files(out) == whole, "every trial is run again and its record is as it was");
    (text(&output.stdout), text(&output.stderr))
}

const JOURNAL: [&str; 10] =
    ["study", "delay", "--robots", "2", "--layouts", "1", "--repeats", "1", "--delays-ms", "0,50"];

#[test]
fn trials_of_another_seed_or_policy_are_run_again() {
    let place = Place::new();
    let policy = place.at("policy.safetensors");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("policies");
    let take = |name: &str| assert!(std::fs::copy(root.join(name), &policy).expect("a policy") > 0);
    let args = [&JOURNAL[..], &["--losses", "0", "--policy", &policy]].concat();
    take("passage.safetensors");
    let (ours, seed, other) = (place.at("ours"), place.at("seed"), place.at("other"));
    done(&args, &["--out", &ours]);
    done(&args, &["--seed", "1", "--out", &seed]);
    // The same name with other weights.
    take("passage-published.safetensors");
    done(&args, &["--out", &other]);
    take("passage.safetensors");
    let output = done(&args, &["--out", &ours]);
    assert!(text(&output.stderr).contains("2 of 2 trials are finished already"), "equal runs go on");
    for theirs in [seed, other] {
        let theirs = files(&theirs);
        let (_, said) = with_changed_trials(&args, &ours, |name, _| theirs[Path::new(name)].clone());
        assert!(!said.contains("are finished already"), "{said}");
    }
}

#[test]
fn trials_of_another_version_or_build_or_other_conditions_are_run_again() {
    let place = Place::new();
    let out = place.at("out");
    let args = [&JOURNAL[..], &["--losses", "0,0.2"]].concat();
    done(&args, &["--out", &out]);
    for (field, value) in
        [("version", "0.0.9"), ("build", "0123456789abcdef"), ("conditions", "none"), ("study", "range")]
    {
        let (_, said) = with_changed_trials(&args, &out, |_, bytes| {
            let mut record: Value = serde_json::from_slice(bytes).expect("a record");
            assert!(record["origin"][field].is_string(), "{record}");
            record["origin"][field] = value.into();
            record.to_string().into_bytes()
        });
        assert!(!said.contains("are finished already"), "{field}: {said}");
    }
    // A folder of another build is refused as a whole: its report would mix two programs.
    let study = Path::new(&out).join("study.json");
    let mut identity: Value = serde_json::from_slice(&std::fs::read(&study).expect("it is there")).expect("JSON");
    identity["build"] = "0123456789abcdef".into();
    std::fs::write(&study, identity.to_string()).expect("it can be written");
    refuses(&[&args[..], &["--out", &out]].concat(), &["another study", "build", "0123456789abcdef"]);
}

#[test]
fn errors_are_reported_before_anything_is_computed() {
    let place = Place::new();
    let modes = |args: &[&str], words: &[&str]| refuses(&[&["study", "modes"], args].concat(), words);
    modes(&["--handling", "best"], &["--handling", "best", "as-published"]);
    modes(&["--policy", "shipped@best"], &["shipped@best", "no handling 'best'", "as-published"]);
    modes(&["--policy", "/nowhere/policy"], &["/nowhere/policy"]);
    modes(&["--policy", "shipped", "--policy", "shipped@default"], &["--policy", "twice"]);
    modes(&["--columns", "sim,telepathy"], &["--columns", "telepathy", "onboard-adhoc-rinf"]);
    modes(&["--columns", "sim,sim"], &["--columns", "sim", "twice"]);
    modes(&["--robots", "40"], &["--robots", "2 to 12", "40"]);
    modes(&["--gap-m", "0.3"], &["--gap-m", "0.3 m", "0.6 to 3 m"]);
    modes(&["--gap-m", "NaN"], &["--gap-m", "NaN"]);
    modes(&["--scenario", "swap", "--gap-m", "1"], &["--gap-m", "no walls"]);
    modes(&["--scenario", "swap", "--policy", "published"], &["published", "swap"]);
    modes(&["--layouts", "0"], &["--layouts"]);
    modes(&["--repeats", "0"], &["--repeats"]);
    modes(&["--episodes-file", "/nowhere/episodes.json"], &["/nowhere/episodes.json"]);
    modes(&["--out", "/dev/null/report"], &["--out", "/dev/null/report"]);
    refuses(&["study", "delay", "--losses", "0,2"], &["--losses", "2", "0 to 1"]);
    refuses(&["study", "delay", "--delays-ms=-1"], &["--delays-ms", "-1"]);
    refuses(&["study", "range", "--ranges-m", "1,NaN"], &["--ranges-m", "NaN"]);
    refuses(&["study", "dreams"], &["dreams"]);

    let out = place.at("study");
    done(&SMALL, &["--quiet", "--out", &out]);
    let before = files(&out);
    refuses(
        &[&SMALL[..10], &["--seed", "6", "--out", &out]].concat(),
        &["another study", "seed is 5 there and 6 here"],
    );
    refuses(&[&SMALL[..], &["--policy", "orca", "--out", &out]].concat(), &["another study", "entrants", "orca"]);
    assert!(files(&out) == before, "nothing is lost");
    let other = place.at("other");
    std::fs::create_dir(&other).expect("a folder");
    std::fs::write(Path::new(&other).join("report.html"), "mine").expect("a file");
    refuses(&[&SMALL[..], &["--out", &other]].concat(), &["other", "something else", "another folder"]);
    assert_eq!(files(&other).len(), 1, "nothing was made there");
}

#[test]
fn losses_are_measured_and_do_not_raise_success_much() {
    let args = ["study", "delay", "--policy", "published@as-published", "--delays-ms", "0,50", "--losses", "0,0.9"];
    let rows = columns(&[&args[..], &["--layouts", "5", "--repeats", "2"]].concat());
    let of = |name: &str, field: &str| -> f64 {
        let row = rows.iter().find(|row| row["name"] == name).expect("the column is there");
        row[field].as_f64().unwrap_or_else(|| panic!("{field} of {row}"))
    };
    assert_eq!(of("0ms-0%", "delivered"), 1.0);
    assert!((of("0ms-90%", "delivered") - 0.1).abs() < 0.01);
    assert!(of("50ms-0%", "delivered") > 0.98 && of("50ms-0%", "within_20ms") == 0.0);
    assert_eq!(of("50ms-0%", "within_50ms"), 1.0);
    assert!(of("50ms-0%", "age_p50_ms") >= of("0ms-0%", "age_p50_ms") + 45.0);
    assert!(of("0ms-90%", "neighbours") < 0.2 * of("0ms-0%", "neighbours"));
    assert!(of("0ms-90%", "success_rate") <= of("0ms-0%", "success_rate") + 0.1);
}

#[test]
fn a_study_has_the_drive_of_its_robots() {
    let place = Place::new();
    let folder = place.at("wheels");
    let wheels = ["--drive", "differential", "--point-ahead-m", "0.1"];
    let output = done(&SMALL, &[&wheels[..], &["--out", &folder]].concat());
    let warning = "it was trained for a holonomic drive, and robot 0 has a differential drive";
    assert!(text(&output.stderr).contains(warning), "{}", text(&output.stderr));
    let read =
        |folder: &str, name: &str| std::fs::read_to_string(Path::new(folder).join(name)).expect("a file of the study");
    assert!(read(&folder, "study.json").contains("--drive differential --point-ahead-m 0.1"));
    assert!(read(&folder, "report.html").contains("drive = differential, point_ahead_m = 0.1"));
    let plain = place.at("plain");
    done(&SMALL, &["--quiet", "--out", &plain]);
    assert_ne!(read(&folder, "episodes.csv"), read(&plain, "episodes.csv"), "wheels drive otherwise");
    refuses(&[&SMALL[..], &wheels[..], &["--quiet", "--out", &plain]].concat(), &["plain", "conditions"]);
    refuses(&[&SMALL[..], &["--point-ahead-m", "0.1"]].concat(), &["--point-ahead-m", "differential"]);
}

#[test]
fn parts_of_a_study_in_one_folder_are_the_study_of_one_machine() {
    let place = Place::new();
    let (whole, parts) = (place.at("whole"), place.at("parts"));
    done(&SMALL, &["--quiet", "--out", &whole]);
    for (shard, missing) in [("2/3", "3 trials"), ("1/3", "1 trial of"), ("3/3", "without --shard")] {
        let output = done(&SMALL, &["--json", "--out", &parts, "--shard", shard]);
        let part: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
        assert_eq!((&part["shard"], &part["interrupted"]), (&Value::from(shard), &Value::from(false)), "{part}");
        assert_eq!(part["trials"][0], part["trials"][1], "{part}");
        assert!(text(&output.stderr).contains(missing), "{}", text(&output.stderr));
        assert!(!Path::new(&parts).join("report.html").exists(), "a part writes trials alone");
    }
    done(&SMALL, &["--quiet", "--out", &parts]);
    same(&whole, &parts);
    refuses(&[&SMALL[..], &["--shard", "1/3"]].concat(), &["--out"]);
    refuses(&[&SMALL[..], &["--out", &parts, "--shard", "4/3"]].concat(), &["--shard", "K/N"]);
}
