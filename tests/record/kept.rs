//! Records in several files, and records of the seconds around what has happened.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use murmurate_record::reader;
use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;

use crate::program::{murmurate, refuses, run, text};

/// Names of the records in a folder, in order.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the folder").map(|entry| entry.expect("an entry").file_name());
    let mut names: Vec<String> = entries.map(|name| name.to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn sim(folder: &Path, more: &[&str]) -> PathBuf {
    let flags = ["sim", "--mode", "offboard", "--episodes", "4", "--repeats", "1", "--seed", "3", "--quiet"];
    let output = run(&[&flags[..], &["--record", folder.to_str().expect("a path in UTF-8")], more].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    folder.to_owned()
}

/// Runs a command on a record and returns what it prints.
fn printed(command: &[&str], record: &Path) -> String {
    let output = run(&[command, &[record.to_str().expect("a path in UTF-8")]].concat());
    assert!(output.status.success(), "{command:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

#[test]
fn a_record_in_parts_replays_as_one() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let whole = sim(&folder.path().join("whole"), &[]);
    let parts = sim(&folder.path().join("parts"), &["--record-size", "1"]);
    assert_eq!(names(&whole), ["repeat-0000.mcap"]);
    let found = names(&parts);
    assert!(found.len() >= 3 && found.contains(&"repeat-0000.2.mcap".to_owned()), "{found:?}");
    let equal = printed(&["replay"], &whole);
    assert!(equal.contains("equal"), "{equal}");
    assert_eq!(printed(&["replay"], &parts), equal, "as many messages");
    let later = parts.join("repeat-0000.1.mcap");
    refuses(&["replay", later.to_str().expect("a path in UTF-8")], &["repeat-0000.1.mcap", "first"]);
    // Without its last file the record ends early, and the replay says so.
    let last = parts.join(format!("repeat-0000.{}.mcap", found.len() - 1));
    std::fs::remove_file(&last).expect("the last file");
    let output = run(&["replay", parts.to_str().expect("a path in UTF-8")]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stdout));
    assert!(text(&output.stdout).contains("the record ends here"), "{}", text(&output.stdout));
}

#[test]
fn a_record_of_which_a_file_is_absent_or_of_something_else_is_damaged_and_the_rest_is_read() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let parts = sim(&folder.path().join("parts"), &["--record-size", "1"]);
    assert!(names(&parts).len() >= 3);
    let (first, second) = (parts.join("repeat-0000.mcap"), parts.join("repeat-0000.1.mcap"));
    let read = || {
        let mut record = reader::Reader::open(&first).expect("it is a record");
        let mut count = 0;
        while record.next_message().expect("it can be read").is_some() {
            count += 1;
        }
        (count, record.gaps(), record.health().lines(0).join("; "))
    };
    let whole = read();
    assert_eq!((whole.1, &*whole.2), (0, ""));
    let original = std::fs::read(&second).expect("the second file");
    let within = reader::Reader::open_one(&second).map(|mut file| {
        let mut count = 0;
        while file.next_message().expect("it can be read").is_some() {
            count += 1;
        }
        count
    });
    let left = whole.0 - within.expect("it is a file of a record");
    let third = std::fs::read(parts.join("repeat-0000.2.mcap")).expect("the third file");
    let cases: [(Option<&[u8]>, &str); 4] = [
        (None, "absent: 1"),
        (Some(b"no record"), "it is no MCAP file"),
        (Some(&third), "it is of another record"),
        (Some(&[0; 5000]), "nothing but zeros"),
    ];
    for (bytes, named) in cases {
        match bytes {
            Some(bytes) => std::fs::write(&second, bytes).expect("it can be written"),
            None => std::fs::remove_file(&second).expect("it was there"),
        }
        let (count, gaps, said) = read();
        assert_eq!((count, gaps > 0 || named.contains("zeros")), (left, true), "{named}: {said}");
        assert!(said.contains(named), "{named}: {said}");
        let info = run(&["record", "info", parts.to_str().expect("a path in UTF-8")]);
        let said = text(&info.stdout);
        assert!(info.status.code() == Some(1) && !said.contains("whole"), "{named}: {said}");
    }
    std::fs::write(&second, original).expect("it can be written");
    assert_eq!(read(), whole);
}

#[test]
fn only_the_seconds_around_an_aborted_episode_are_kept() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let quiet = sim(&folder.path().join("quiet"), &["--record-last", "2"]);
    assert!(names(&quiet).is_empty(), "nothing has happened");
    // The body of a robot is down from the second episode's first second on, so that the state server aborts it.
    let faults = folder.path().join("faults.toml");
    let fault =
        "[[actor]]\nactor = \"controller\"\nrobot = 1\nfault = \"crash\"\nepisode = 1\nat_s = 1.0\nfor_s = 4.0\n";
    std::fs::write(&faults, fault).expect("a file");
    let faults = faults.to_str().expect("a path in UTF-8");
    let kept = sim(&folder.path().join("kept"), &["--record-last", "2", "--faults", faults]);
    assert_eq!(names(&kept), ["repeat-0000.1.mcap"]);
    let record = kept.join("repeat-0000.1.mcap");
    let said: serde_json::Value = serde_json::from_str(&printed(&["record", "info", "--json"], &record)).expect("JSON");
    let of_s = said["records"][0]["duration_s"].as_f64().unwrap_or_else(|| panic!("{said}"));
    assert!((3.5..=4.5).contains(&of_s), "{of_s} s: two before and two after");
    refuses(&["replay", record.to_str().expect("a path in UTF-8")], &["--record-last", "--watch"]);
}

#[test]
fn a_host_keeps_its_last_seconds_when_it_is_asked_to() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let team = concat!(env!("CARGO_MANIFEST_DIR"), "/../../teams/offboard.toml");
    let number = format!("team={}", 1000 + (4 * std::process::id() + 1) % 60_000);
    let to = folder.path().to_str().expect("a path in UTF-8");
    let own = ["host", team, "--host", "world", "--set", &number, "--json"];
    let mut command = murmurate(&[&own[..], &["--record", to, "--record-last", "1"]].concat());
    let mut host = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("a host");
    let mut lines = BufReader::new(host.stdout.take().expect("its stdout")).lines();
    let mut line = || lines.next().expect("the host runs on").expect("text");
    while !line().contains("counted") {}
    assert!(names(folder.path()).is_empty(), "nothing has happened");
    let pid = Pid::from_raw(host.id().cast_signed());
    kill(pid, Signal::SIGUSR1).expect("a child");
    // It prints its counts every second.
    let kept = (0..5).any(|_| line().contains("counted") && !names(folder.path()).is_empty());
    assert!(kept, "a file within five seconds");
    kill(pid, Signal::SIGINT).expect("a child");
    host.wait().expect("a child");
    let info = printed(&["record", "info"], folder.path());
    assert!(info.contains("/tape/turn"), "{info}");
}

#[test]
fn trials_of_a_study_are_recorded_and_run_again() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let runs = folder.path().join("runs");
    let (to, out) = (runs.to_str().expect("a path in UTF-8"), folder.path().join("out"));
    let study = ["study", "delay", "--delays-ms", "0,50", "--losses", "0.3", "--layouts", "1", "--repeats", "2"];
    let policies = ["--policy", "orca", "--policy", "shipped@as-published", "--quiet", "--out"];
    let kept = [&study[..], &policies, &[out.to_str().expect("a path in UTF-8")]].concat();
    let output = run(&[&kept[..], &["--record", to]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let found = names(&runs);
    assert_eq!((found.len(), &*found[0]), (8, "0ms-30-1-0000.mcap"), "{found:?}");
    let equal = printed(&["replay"], &runs);
    assert_eq!(equal.lines().filter(|line| line.contains("equal")).count(), 8, "{equal}");
    // The study is complete, so the same command runs and records nothing more.
    let output = run(&[&kept[..], &["--record", to]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    refuses(&[&study[..], &["--record", to]].concat(), &["--record", "0ms-30-1-0000.mcap"]);
}

#[test]
fn lines_that_a_host_has_logged_are_in_its_record_and_do_not_disturb_a_replay() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let team = concat!(env!("CARGO_MANIFEST_DIR"), "/../../teams/offboard.toml");
    let number = format!("team={}", 1000 + (4 * std::process::id() + 3) % 60_000);
    let to = folder.path().to_str().expect("a path in UTF-8");
    let mut command = murmurate(&["host", team, "--host", "world", "--set", &number, "--json", "--record", to]);
    let mut host = command.env("MURMURATE_LOG", "info").stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    let mut lines = BufReader::new(host.stdout.take().expect("its stdout")).lines();
    while !lines.next().expect("the host runs on").expect("text").contains("counted") {}
    kill(Pid::from_raw(host.id().cast_signed()), Signal::SIGINT).expect("a child");
    host.wait().expect("a child");
    let mut opened = reader::open(&folder.path().join(&names(folder.path())[0])).expect("a record");
    let mut logged = Vec::new();
    while let Some(message) = opened.messages.next_message().expect("a whole record") {
        if message.channel.topic == "/log/program" {
            logged.push(String::from_utf8_lossy(&message.data).into_owned());
        }
    }
    assert!(logged.iter().any(|line| line.contains("starts host=\"world\"")), "{logged:?}");
    assert!(printed(&["replay"], folder.path()).contains("equal"));
}

#[test]
fn flags_of_records_are_refused_where_they_make_no_sense() {
    refuses(&["sim", "--record-last", "5"], &["--record-last", "--record DIR"]);
    let team = concat!(env!("CARGO_MANIFEST_DIR"), "/../../teams/offboard.toml");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let to = folder.path().to_str().expect("a path in UTF-8");
    refuses(&["sim", "--record", to, "--record-last", "0"], &["--record-last", "3600"]);
    refuses(&["sim", "--record", to, "--record-size", "0"], &["--record-size"]);
    refuses(&["config", "show", team, "--set", "record_last_s=0"], &["record_last_s"]);
    assert!(!murmurate(&["sim", "--record-size", "x"]).output().expect("the program starts").status.success());
}
