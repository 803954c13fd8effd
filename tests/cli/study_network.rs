//! The network study on the command line: its rows, its folder, the medium fitted to the paper, and a fit.

use std::fs;

use crate::program::{refuses, run, text};
use serde_json::Value;

fn rows(args: &[&str]) -> Vec<Value> {
    let output = run(&[&["study", "network", "--teams", "none", "--json", "--quiet"][..], args].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    report["rows"].as_array().unwrap().clone()
}

fn number(row: &Value, field: &str) -> f64 {
    row[field].as_f64().unwrap_or_else(|| panic!("{field} of {row}"))
}

/// Medium that was fitted to two figures of the paper with RTPS as Fast DDS speaks it (docs/evidence/network-fit.md).
const REFITTED: &str = "rate = \"ofdm-18\"\nnoise_loss = 0.147\nbackground = 0.168\n";

#[test]
fn one_set_of_parameters_reproduces_the_paper_s_curves() {
    let folder = tempfile::tempdir().unwrap();
    let refitted = folder.path().join("refitted.toml");
    fs::write(&refitted, REFITTED).unwrap();
    let adhoc = |medium: &str, rest: &[&str]| {
        rows(&[&["--medium", medium, "--networks", "ad-hoc", "--seconds", "40"][..], rest].concat())
    };
    let unicast = ["--addressing", "unicast", "--reliability", "ack,ack-off", "--retries", "1,7", "--rates", "100,200"];
    let all = adhoc(&refitted.to_string_lossy(), &unicast);
    let row = |reliability: &str, retries: u64, rate: f64| {
        all.iter().find(|r| r["reliability"] == reliability && r["retries"] == retries && r["rate"] == rate).unwrap()
    };
    let seven = row("ack", 7, 200.0);
    assert!((number(seven, "within_20ms") - 0.44).abs() < 0.12, "fitted: {seven}");
    assert!(number(row("ack", 7, 100.0), "within_20ms") > 0.95, "it is saturation: half the rate is carried");
    let faster = |one: &Value, other: &Value| {
        number(one, "within_20ms") > number(other, "within_20ms") && number(one, "p50_ms") < number(other, "p50_ms")
    };
    assert!(faster(row("ack", 1, 200.0), seven), "predicted: one retry is faster than seven");
    assert!(faster(row("ack-off", 7, 200.0), seven), "predicted: without positive acknowledgements delays are shorter");
    for medium in ["paper", &refitted.to_string_lossy()] {
        let multicast = ["--addressing", "multicast", "--reliability", "best-effort", "--rates", "60"];
        let all = adhoc(medium, &multicast);
        let within = number(&all[0], "within_20ms");
        assert!((within - 0.84).abs() < 0.05, "fitted: {}", all[0]);
        assert!(number(&all[0], "delivered") - within < 0.01, "the rest is lost, not late: {}", all[0]);
    }
}

#[test]
fn a_report_does_not_depend_on_threads_and_can_be_continued() {
    let folder = tempfile::tempdir().unwrap();
    let small =
        ["study", "network", "--rates", "20,60", "--seconds", "2", "--retries", "7", "--teams", "none", "--quiet"];
    let report = |name: &str, jobs: &str| {
        let out = folder.path().join(name);
        let output = run(&[&small[..], &["--jobs", jobs, "--out", &out.to_string_lossy()]].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        fs::read(out.join("report.html")).unwrap()
    };
    let one = report("one", "1");
    assert!(one == report("two", "2"), "the same bytes");
    fs::remove_file(folder.path().join("one/cases/emulated-0003.json")).unwrap();
    assert!(one == report("one", "2"), "what is missing is run again");
    let out = folder.path().join("one");
    refuses(&["study", "network", "--rates", "30", "--out", &out.to_string_lossy()], &["--out", "another study"]);
    refuses(&["study", "network", "--teams", "5,many"], &["--teams", "many"]);
    refuses(&["study", "network", "--teams", "5,5"], &["--teams", "5", "twice"]);
    refuses(&["study", "network", "--teams", "1"], &["--teams", "1"]);
    refuses(&["study", "network", "--teams", "none,5"], &["--teams", "alone"]);
    refuses(&["study", "network", "--medium", "shaped", "--retries", "3"], &["--retries", "shaped"]);
    refuses(&["study", "network", "--rates", "1", "--seconds", "2"], &["--seconds", "too short", "5 at least"]);
    let narrow = folder.path().join("narrow.toml");
    fs::write(&narrow, "rate_bit_s = 1e6\nburst_bytes = 200\nqueue_bytes = 9000\n").unwrap();
    refuses(&["study", "network", "--medium", &narrow.to_string_lossy()], &["--medium", "burst_bytes", "234"]);
    refuses(&["study", "network", "--medium", "telepathy"], &["--medium", "telepathy", "paper"]);
    refuses(&["study", "network", "--reliability", "hope"], &["--reliability", "hope"]);
    refuses(&["study", "network", "--bytes", "7"], &["--bytes", "7"]);
}

#[test]
fn cases_and_teams_of_another_seed_version_or_build_are_run_again() {
    let folder = tempfile::tempdir().unwrap();
    let small = ["study", "network", "--rates", "60", "--networks", "ad-hoc", "--addressing", "multicast"];
    let study = |name: &str, seed: &str| {
        let out = folder.path().join(name);
        let more = ["--reliability", "repeat", "--seconds", "2", "--teams", "5", "--seed", seed, "--quiet", "--out"];
        let output = run(&[&small[..], &more, &[&out.to_string_lossy()]].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        let cases = out.join("cases");
        ["emulated-0000.json", "team-sim-0005.json"].map(|name| (cases.join(name), fs::read(cases.join(name)).unwrap()))
    };
    let origin = |bytes: &[u8]| serde_json::from_slice::<Value>(bytes).unwrap()["origin"].clone();
    let ours = study("ours", "0");
    let theirs = study("theirs", "1");
    assert!(study("ours", "0") == ours, "what is kept is not done again");
    let outcome = |bytes: &[u8]| serde_json::from_slice::<Value>(bytes).unwrap()["outcome"].clone();
    for ((path, own), (_, other)) in ours.iter().zip(&theirs) {
        fs::write(path, other).unwrap();
        let again = study("ours", "0");
        let (_, again) = again.iter().find(|(name, _)| name == path).unwrap();
        assert_eq!((origin(again), outcome(again)), (origin(own), outcome(own)), "of another seed");
        for field in ["version", "build"] {
            let mut changed: Value = serde_json::from_slice(own).unwrap();
            changed["origin"][field] = "of old".into();
            fs::write(path, changed.to_string()).unwrap();
            let again = study("ours", "0");
            let (_, again) = again.iter().find(|(name, _)| name == path).unwrap();
            assert_eq!(origin(again), origin(own), "of another {field}");
        }
    }
}

#[test]
fn the_cost_of_a_robot_in_a_growing_team_is_measured_once_and_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let small = ["study", "network", "--rates", "60", "--networks", "ad-hoc", "--addressing", "multicast"];
    let study = || {
        let more = ["--reliability", "repeat", "--seconds", "2", "--teams", "5,60", "--json", "--out"];
        let output = run(&[&small[..], &more, &[&out.to_string_lossy()]].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        let report: Value = serde_json::from_slice(&output.stdout).unwrap();
        (report["growth"].as_array().unwrap().clone(), fs::read(out.join("report.html")).unwrap())
    };
    let (grown, page) = study();
    let of = |mode: &str, robots: u64| grown.iter().find(|row| row["mode"] == mode && row["robots"] == robots).unwrap();
    assert_eq!(grown.len(), 4);
    for mode in ["sim", "onboard-adhoc"] {
        let [small, large] = [5, 60].map(|robots| of(mode, robots));
        assert!(number(large, "messages") < 1.02 * number(small, "messages"), "{small} {large}");
        assert!(number(small, "cpu_us") > 0.0 && number(large, "cpu_us") > 0.0);
    }
    assert!(of("sim", 60)["airtime"].is_null());
    let [small, large] = [5, 60].map(|robots| of("onboard-adhoc", robots));
    assert!((number(small, "airtime") / number(large, "airtime") - 1.0).abs() < 0.05, "{small} {large}");
    assert!(number(large, "airtime_around") > 2.0 * number(small, "airtime_around"), "{small} {large}");
    // Processor time varies between measurements; recorded teams are not measured again.
    assert!(study() == (grown, page));
    assert!(text(&fs::read(out.join("table.txt")).unwrap()).contains("cost per robot"));
}

#[test]
fn a_fit_recovers_the_radio_that_generated_the_rows() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    fs::write(path("truth.toml"), "noise_loss = 0.12\nbackground = 0.24\nrate = \"ofdm-12\"\n").unwrap();
    let sweep = ["--rates", "60,250", "--networks", "ad-hoc", "--reliability", "best-effort", "--retries", "1"];
    let made = ["study", "network", "--medium", &path("truth.toml"), "--seconds", "5", "--seed", "5"];
    let output = run(&[&made[..], &sweep, &["--teams", "none", "--json", "--quiet"]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    fs::write(path("rows.json"), &output.stdout).unwrap();
    // Started from another radio, and with other random numbers than those of the rows.
    let fit = ["study", "network", "--rows", &path("rows.json"), "--fit", &path("fit.toml"), "--medium", "wifi"];
    let output = run(&[&fit[..], &["--json", "--quiet"]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let fitted: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(fitted["rate"], "ofdm-12", "{fitted}");
    let off = |field: &str, truth: f64| (number(&fitted, field) / truth - 1.0).abs();
    assert!(off("noise_loss", 0.12) < 0.1 && off("background", 0.24) < 0.1, "{fitted}");
    assert!(number(&fitted, "residual_shares") < 0.02, "{fitted}");
    assert!(fitted["rivals"].as_array().is_some_and(Vec::is_empty), "{fitted}");
    assert!(fs::read_to_string(path("fit.toml")).unwrap().contains("ofdm-12"));

    // In a file with measured rows only those count; an invalid row is named.
    let mut rows: Value = serde_json::from_slice(&fs::read(path("rows.json")).unwrap()).unwrap();
    let refused = |name: &str, change: &dyn Fn(&mut Value), named: &[&str]| {
        let mut changed = rows["rows"].clone();
        change(&mut changed[1]);
        fs::write(path(name), changed.to_string()).unwrap();
        let fit = ["study", "network", "--rows", &path(name), "--fit", &path("no.toml"), "--medium", "wifi"];
        refuses(&fit, &[&["--rows"], named].concat());
    };
    refused("rate.json", &|row| row["rate"] = 0.into(), &["row 2", "rates", "0 is not"]);
    refused("share.json", &|row| row["delivered"] = 2.into(), &["row 2", "share"]);
    refused("links.json", &|row| row["network"] = "shaped".into(), &["row 2", "shaped"]);
    rows["rows"][0]["source"] = "live".into();
    fs::write(path("mixed.json"), rows.to_string()).unwrap();
    let fit = ["study", "network", "--rows", &path("mixed.json"), "--fit", &path("mixed.toml"), "--medium", "wifi"];
    let output = run(&[&fit[..], &["--json"]].concat());
    let fitted: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(fitted["rows"] == 1 && text(&output.stderr).contains("1 measured rows"), "{fitted}");
    refuses(&["study", "network", "--fit", &path("no.toml")], &["--fit", "--rows", "--live"]);
    let shaped = ["--medium", "shaped", "--rows", &path("rows.json"), "--fit", &path("no.toml")];
    refuses(&[&["study", "network"][..], &shaped].concat(), &["--fit", "radio"]);
    assert!(fs::metadata(path("no.toml")).is_err());
}
