//! Hosts whose network interface or address comes late, changes, or goes and comes: the cases of `tests/cases/robots`
//! that need nothing but root and `ip`, which skip with a notice where they cannot run.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::beside;
use crate::program::skip::skip;
use tempfile::TempDir;

/// Runs a case, and checks that the program does what is expected there.
fn case(name: &str) {
    let _beside = beside();
    // Of its own: another case may look at the same time.
    let probe = format!("murmurate-{}", name.split('-').next().expect("a number"));
    let may = Command::new("ip").args(["netns", "add", &probe]).stderr(Stdio::null()).status();
    let _ = Command::new("ip").args(["netns", "del", &probe]).stderr(Stdio::null()).status();
    if !may.is_ok_and(|status| status.success()) {
        return skip("namespaces", "network namespaces need root and the program 'ip'");
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join("tests/cases/robots").join(name);
    let work = TempDir::new().expect("a temporary folder");
    let output = Command::new("bash")
        .arg(script)
        .args([env!("CARGO_BIN_EXE_murmurate"), "python3"])
        .env("CASE_WORK", work.path())
        .stdin(Stdio::null())
        .output()
        .expect("bash is there");
    let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    assert!(output.status.success(), "{name}: {said}");
}

#[test]
fn a_host_waits_for_its_interface_or_its_address_and_begins_when_they_are_there() {
    case("03-boot-before-address.sh");
}

#[test]
fn a_team_goes_on_after_a_host_has_got_another_address_or_its_interface_was_made_again() {
    case("04-dhcp-gives-another-address.sh");
}
