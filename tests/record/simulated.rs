//! Records of simulations, and their replay from the seed.

use std::cell::RefCell;
use std::fs::{read, read_to_string};
use std::path::Path;
use std::rc::Rc;

use murmurate::policy::Model;
use murmurate::simulate::Proceed;
use murmurate::trial::Trial;
use murmurate_record::compare::{Compared, Comparison};
use murmurate_record::topics::{Stage, Topics};
use murmurate_record::{Event, Scope, reader};
use tempfile::TempDir;

use crate::program::{ROOT, refuses, run, text};
use crate::records;

const SIM: [&str; 8] = ["sim", "--mode", "offboard", "--safety", "emulated", "--repeats", "2", "--json"];

fn recorded(folder: &Path, more: &[&str]) -> String {
    let folder = folder.to_str().expect("a path is text");
    let output = run(&[&SIM[..], &["--episodes", "2", "--record", folder], more].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    trace(&text(&output.stdout))
}

fn trace(result: &str) -> String {
    let result: serde_json::Value = serde_json::from_str(result).expect("one JSON object");
    result["trace_hash"].as_str().expect("a trace").to_owned()
}

#[test]
fn equal_runs_have_equal_records_which_change_nothing_and_run_again() {
    let (one, other) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let traces = [recorded(one.path(), &["--jobs", "1"]), recorded(other.path(), &["--jobs", "2"])];
    let without = trace(&text(&run(&[&SIM[..], &["--episodes", "2"]].concat()).stdout));
    assert_eq!(traces, [without.clone(), without]);
    let (one_files, other_files) = (records(one.path()), records(other.path()));
    assert_eq!(one_files.len(), 2);
    for (one, other) in one_files.iter().zip(&other_files) {
        assert!(read(one).unwrap() == read(other).unwrap(), "{} has other bytes", one.display());
    }
    let replayed = run(&["replay", "--rerun", one.path().to_str().unwrap()]);
    assert!(replayed.status.success(), "{}", text(&replayed.stdout));
    assert_eq!(text(&replayed.stdout).matches("equal, ").count(), 2);
    refuses(&["replay", "--host", one_files[0].to_str().unwrap()], &["--host", "simulation", "--rerun"]);
    let again = [&SIM[..], &["--record", one.path().to_str().unwrap()]].concat();
    refuses(&again, &["--record", "repeat-0000.mcap", "name another folder"]);
}

/// Compares a trial with a record of `sim`.
fn compare(trial: &Trial, record: &Path) -> Compared {
    let opened = reader::open(record).expect("it is a record");
    let topics = Topics::new(Stage::of(trial), Scope::Simulation, 0);
    let comparison = Rc::new(RefCell::new(Comparison::new(opened.messages, topics, 0)));
    let heard = Rc::clone(&comparison);
    trial.run_observed(
        move |_, host, event| {
            if let Some(event) = Event::of(Scope::Simulation, host, event) {
                heard.borrow_mut().push(event);
            }
        },
        |_, now, _| {
            comparison.borrow_mut().push(Event::Turn(now));
            if comparison.borrow().is_over() { Proceed::Stop } else { Proceed::Continue }
        },
    );
    Rc::into_inner(comparison).expect("the run is over").into_inner().finish().expect("it can be read")
}

#[test]
fn another_seed_or_another_delay_differs_and_the_difference_is_named() {
    let folder = TempDir::new().unwrap();
    recorded(folder.path(), &[]);
    let record = &records(folder.path())[0];
    let trial = |seed| {
        let model = Model::shipped("passage").unwrap();
        Trial::preset("offboard", "passage").unwrap().model(model).seed(seed).episodes(2)
    };
    let same = compare(&trial(0), record);
    assert!(same.difference.is_none() && same.messages > 1000 && !same.cut, "{same:?}");
    let other = compare(&trial(1), record).difference.expect("another seed");
    assert!(other.at_s < 0.1 && other.to_string().contains("first difference at 0."), "{other}");
    let mut delayed = trial(0);
    delayed.deployment = delayed.deployment.impaired(Some(0.001), None, murmurate::deploy::Impair::Latent).unwrap();
    let later = compare(&delayed, record).difference.expect("a delay of a millisecond");
    assert!(later.recorded.contains(&later.topic) || later.replayed.contains(&later.topic), "{later}");
}

#[test]
fn files_of_a_run_are_in_its_record_and_a_run_without_them_is_the_same() {
    let (folder, files) = (TempDir::new().unwrap(), TempDir::new().unwrap());
    let policy = files.path().join("own.safetensors");
    std::fs::copy(Path::new(ROOT).join("policies/passage.safetensors"), &policy).expect("it is there");
    recorded(folder.path(), &["--policy", policy.to_str().unwrap(), "--delay-ms", "20", "--seed", "3"]);
    std::fs::remove_file(&policy).expect("it was there");
    let replayed = run(&["replay", folder.path().to_str().unwrap()]);
    assert!(replayed.status.success(), "{}{}", text(&replayed.stdout), text(&replayed.stderr));
}

#[test]
fn exported_trajectories_are_those_of_the_run() {
    let folder = TempDir::new().unwrap();
    let (theirs, ours) = (folder.path().join("sim.csv"), folder.path().join("record.csv"));
    let records_of = folder.path().join("records");
    recorded(&records_of, &["--trajectories", theirs.to_str().unwrap()]);
    let record = &records(&records_of)[0];
    let export = ["record", "export", record.to_str().unwrap(), "--trajectories", ours.to_str().unwrap()];
    assert!(run(&export).status.success());
    // By column: time, robot, x, y.
    let rows = |path: &Path, columns: [usize; 4], skip: &str| -> Vec<[f64; 4]> {
        let text = read_to_string(path).unwrap();
        let lines = text.lines().skip(1).filter(|line| !line.starts_with(skip));
        let cells = |line: &str| columns.map(|at| line.split(',').nth(at).unwrap().parse::<f64>().unwrap());
        lines.map(cells).collect()
    };
    let (theirs, ours) = (rows(&theirs, [3, 4, 5, 6], "1,"), rows(&ours, [2, 3, 4, 5], "none"));
    assert!(theirs.len() > 500 && theirs.len() == ours.len(), "{} and {}", theirs.len(), ours.len());
    for (one, other) in theirs.iter().zip(&ours) {
        assert!(one.iter().zip(other).all(|(a, b)| (a - b).abs() < 1e-6), "{one:?} and {other:?}");
    }
}
