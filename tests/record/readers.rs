//! Records in the readers of others: `mcap` and `mcap-protobuf-support` of PyPI.

use std::process::Command;

use tempfile::TempDir;

use crate::program::skip::skip;
use crate::program::{ROOT, run, text};
use crate::records;

/// Python with the packages `packages`: the variable `RECORD_PYTHON`, or else `python3` if it has them.
pub fn python(packages: &str) -> Option<String> {
    let python = std::env::var("RECORD_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let found = Command::new(&python).args(["-c", &format!("import {packages}")]).output();
    found.is_ok_and(|output| output.status.success()).then_some(python)
}

#[test]
fn python_reads_what_was_recorded() {
    let Some(python) = python("mcap, mcap_protobuf") else {
        return skip("readers", "RECORD_PYTHON is no Python with mcap and mcap-protobuf-support");
    };
    let folder = TempDir::new().unwrap();
    let (to, csv) = (folder.path().join("records"), folder.path().join("trajectories.csv"));
    let (to, csv) = (to.to_str().unwrap(), csv.to_str().unwrap());
    let sim = ["sim", "--mode", "offboard", "--episodes", "2", "--repeats", "1", "--trajectories", csv, "--record", to];
    assert!(run(&sim).status.success());
    let record = records(to.as_ref()).remove(0);
    let check = ["tests/peers/record/check.py", record.to_str().unwrap(), csv];
    let output = Command::new(python).args(check).current_dir(ROOT).output().expect("it starts");
    assert!(output.status.success(), "{}{}", text(&output.stdout), text(&output.stderr));
    println!("{}", text(&output.stdout));
}
