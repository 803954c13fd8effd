//! Records of hosts whose robots have senses, which run again alone.

use std::fs::write;
use std::path::Path;

use murmurate::graph::inputs::{DeviceId, Input};
use tempfile::TempDir;

use crate::edited::edit;
use crate::program::{ROOT, run, text};
use crate::records;

const LIDAR: &str = "[senses.lidar]\nkind = \"lidar\"\nrays = 32\nrange_m = 2.0\nnoise_m = 0.01\ndropouts = 0.02\n";

/// Prints a scan of 32 rays without an echo, but for one, twenty times a second.
const PROGRAM: &str = r#"
import time
began = time.monotonic()
while True:
    print('{"stamp_s": %f, "values": [1.5%s]}' % (time.monotonic() - began, ", null" * 31), flush=True)
    time.sleep(0.05)
"#;

/// Runs one episode of a team in this mode whose policy takes `lidar`, and replays the records of all its hosts, of
/// which there are `hosts`. Returns the folder with the records.
fn runs_again(number: u16, mode: &str, senses: &str, hosts: usize) -> TempDir {
    let folder = TempDir::new().expect("a folder");
    let path = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
    let policy = Path::new(ROOT).join("tests/onnx/data/lidar.policy.toml").canonicalize().expect("it is there");
    let head = format!("team = {number}\nmode = \"{mode}\"\nscenario = \"swap\"\nrobots = 3\nepisodes = 1\n");
    write(path("team.toml"), format!("{head}policy = '{}'\n{senses}", policy.display())).expect("it can be written");
    let flags = ["--interface", "lo", "--quiet", "--json", "--record"];
    let output = run(&[&["launch", &*path("team.toml")], &flags[..], &[&*path("records")]].concat());
    assert!(output.status.success(), "{mode}: {}", text(&output.stderr));
    let said = text(&output.stdout);
    assert!(said.contains("\"successes\":1"), "{mode}: robots see in time, and arrive: {said}");
    let output = run(&["replay", "--host", &path("records")]);
    let said = text(&output.stdout) + &text(&output.stderr);
    assert_eq!((output.status.code(), said.matches("equal, ").count()), (Some(0), hosts), "{mode}: {said}");
    folder
}

/// Returns the number of scans of robot 1 that the record of a host has for tools.
fn scans(records_of: &Path, host: &str) -> usize {
    let name = |path: &std::path::PathBuf| path.file_name().is_some_and(|name| name.to_string_lossy().contains(host));
    let record = records(records_of).into_iter().find(name).expect("each host has a record");
    let mut reader = murmurate_record::reader::Reader::open(&record).expect("it is a record");
    let mut count = 0;
    while let Some(message) = reader.next_message().expect("it can be read") {
        count += usize::from(message.channel.topic == "/robot/1/sense/lidar");
    }
    count
}

#[test]
fn hosts_run_again_where_scans_travel_between_hosts() {
    let folder = runs_again(821, "offboard", LIDAR, 4);
    assert!(scans(&folder.path().join("records"), "agent-1") > 50, "for tools, too");
    runs_again(822, "centralized", LIDAR, 2);
}

#[test]
fn hosts_run_again_where_scans_reach_robots_by_radio() {
    runs_again(823, "onboard-infra", LIDAR, 4);
    runs_again(824, "onboard-adhoc", LIDAR, 4);
}

#[test]
fn a_host_runs_again_with_the_lines_of_a_program_and_not_without_them() {
    let script = TempDir::new().expect("a folder");
    let path = script.path().join("scan.py");
    write(&path, PROGRAM).expect("it can be written");
    let command = format!("command = [\"python3\", '{}']\n", path.display());
    let form = "shape = [32]\nunit = \"m\"\nrange_m = 2.0\n";
    let folder = runs_again(825, "sim", &format!("[senses.lidar]\nkind = \"program\"\n{command}{form}"), 1);
    let record = records(&folder.path().join("records")).remove(0);
    let (changed, mut left_out) = (folder.path().join("changed.mcap"), 0);
    edit(&record, &changed, |turn| {
        let before = turn.inputs.len();
        turn.inputs.retain(|input| !matches!(input, Input::Packet(DeviceId::Sense(..), _)));
        left_out += before - turn.inputs.len();
    });
    assert!(left_out > 60, "three robots have a line twenty times a second: {left_out}");
    let output = run(&["replay", "--host", &changed.to_string_lossy()]);
    let said = text(&output.stdout) + &text(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains("first difference at "), "{said}");
}
