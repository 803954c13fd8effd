//! A team key given by mistake: to every flag that takes a file, instead of a name, and inside other files. Its digits
//! appear in no error, log or output.

use std::fs::write;
use std::process::{Command, Output};

use crate::program::{murmurate, text};
use tempfile::TempDir;

const KEY: &str = "0f1e2d3c4b5a69788796a5b4c3d2e1f01f2e3d4c5b6a79889786b5a4d3c2f1e0";

/// Number of consecutive digits of the key that must not appear.
const SEEN: usize = 8;

struct Place(TempDir);

impl Place {
    fn file(&self, name: &str, content: &str) -> String {
        let path = self.0.path().join(name);
        write(&path, content).expect("it can be written");
        path.to_string_lossy().into_owned()
    }
}

/// Runs a command, which must fail, and returns its output, which must not contain the key.
fn hides(command: &mut Command) -> String {
    let Output { status, stdout, stderr } = command.output().expect("it starts");
    let said = format!("{}{}", text(&stdout), text(&stderr));
    assert!(matches!(status.code(), Some(1 | 2)), "{command:?} ends with {status}: {said}");
    let lower = said.to_lowercase();
    for at in 0..=KEY.len() - SEEN {
        assert!(!lower.contains(&KEY[at..at + SEEN]), "{command:?} shows digits of the key: {said}");
    }
    said
}

#[test]
fn every_flag_that_takes_a_file_recognises_a_key_and_does_not_show_it() {
    let place = Place(TempDir::new().expect("a temporary folder"));
    let key = place.file("team.key", &format!("{KEY}\n"));
    let out = place.0.path().join("out").to_string_lossy().into_owned();
    let commands: [&[&str]; 22] = [
        &["sim", "--deployment", &key],
        &["sim", "--mode", "offboard", "--radio", &key],
        &["sim", "--mode", "offboard", "--faults", &key],
        &["sim", "--episodes-file", &key],
        &["sim", "--policy", &key],
        &["sim", "--mode", "offboard", "--conditions", &key],
        &["deployment", "offboard", "--radio", &key],
        &["study", "modes", "--policy", &key],
        &["study", "delay", "--episodes-file", &key],
        &["study", "network", "--medium", &key],
        &["study", "network", "--rows", &key, "--fit", &out],
        &["study", "network", "--live", &key],
        &["study", "network", "--live", &key, "--host", "robot-0"],
        &["train", "passage", "--minutes", "1", "--config", &key, "--out", &out],
        &["train", "passage", "--minutes", "1", "--radio", &key, "--out", &out],
        &["train", "passage", "--minutes", "1", "--conditions", &key, "--out", &out],
        &["train", "passage", "--minutes", "1", "--from", &key, "--out", &out],
        &["host", &key, "--robot", "0"],
        &["launch", &key],
        &["doctor", &key, "--robot", "0"],
        &["stop", &key],
        &["config", "check", &key],
    ];
    for command in commands {
        let said = hides(&mut murmurate(command));
        assert!(said.contains("is a key file, no "), "{command:?}: {said}");
    }
}

#[test]
fn a_key_instead_of_a_name_is_not_shown() {
    let place = Place(TempDir::new().expect("a temporary folder"));
    let team = "team = 1\nmode = \"offboard\"\n[link.infra]\ninterface = \"lo\"\n[link.loopback]\ninterface = \"lo\"\n";
    let file = place.file("team.toml", team);
    let set = |field: &str| format!("{field}={KEY}");
    for field in ["key_file", "policy", "team", "mode", "lag_s", "link.infra.interface", "link.infra.group", KEY] {
        hides(&mut murmurate(&["config", "check", &file, "--set", &set(field)]));
        hides(&mut murmurate(&["config", "show", &file, "--set", &set(field)]));
    }
    hides(&mut murmurate(&["config", "check", &file, "--set", KEY]));
    hides(&mut murmurate(&["config", "check", &file, "--key-file", KEY]));
    hides(&mut murmurate(&["config", "show", &file, "--key-file", KEY]));
    hides(murmurate(&["config", "show", &file]).env("MURMURATE_KEY_FILE", KEY));
    hides(&mut murmurate(&["host", &file, "--host", KEY]));
    for flag in ["--deployment", "--policy", "--radio", "--faults", "--mode", "--seed"] {
        hides(&mut murmurate(&["sim", flag, &KEY.to_uppercase()]));
    }
    hides(murmurate(&["sim"]).env("MURMURATE_LOG", KEY));
}

#[test]
fn a_key_inside_a_file_is_not_quoted() {
    let place = Place(TempDir::new().expect("a temporary folder"));
    let toml = [
        format!("key = \"{KEY}\"\n"),
        format!("robots = \"{KEY}\"\n"),
        format!("mode = \"{KEY}\"\nrobots = 5\n"),
        format!("{KEY} = 5\n"),
        format!("rate = \"{KEY}\"\n"),
        format!("# a comment\n{KEY}"),
        format!("key = \"{KEY}"),
        format!("rate_bit_s = \"{KEY}\"\n"),
    ];
    for (at, content) in toml.iter().enumerate() {
        let file = place.file(&format!("{at}.toml"), content);
        hides(&mut murmurate(&["sim", "--deployment", &file]));
        hides(&mut murmurate(&["sim", "--mode", "offboard", "--radio", &file]));
        hides(&mut murmurate(&["sim", "--mode", "offboard", "--faults", &file]));
        hides(&mut murmurate(&["study", "network", "--medium", &file]));
        hides(&mut murmurate(&["config", "check", &file]));
    }
    let json = [
        format!("\"{KEY}\""),
        format!("{{\"episodes\": \"{KEY}\"}}"),
        format!("{{\"{KEY}\": 5}}"),
        format!("[{{\"source\": \"{KEY}\"}}]"),
        format!("{{\"rows\": [{{\"network\": \"{KEY}\", \"source\": \"{KEY}\"}}]}}"),
    ];
    for (at, content) in json.iter().enumerate() {
        let file = place.file(&format!("{at}.json"), content);
        hides(&mut murmurate(&["sim", "--episodes-file", &file]));
        let fit = place.0.path().join("fit.toml").to_string_lossy().into_owned();
        hides(&mut murmurate(&["study", "network", "--rows", &file, "--fit", &fit]));
        // As the header of a policy file: its length, then JSON.
        let header = (content.len() as u64).to_le_bytes();
        let policy = place.0.path().join(format!("{at}.safetensors"));
        write(&policy, [&header[..], content.as_bytes()].concat()).expect("it can be written");
        hides(&mut murmurate(&["sim", "--policy", &policy.to_string_lossy()]));
    }
}

#[test]
fn a_key_that_anybody_can_guess_is_refused_by_name() {
    let place = Place(TempDir::new().expect("a temporary folder"));
    let team = place.file(
        "team.toml",
        "team = 1\nmode = \"offboard\"\nkey_file = \"team.key\"\n\
         [link.loopback]\ninterface = \"lo\"\n[link.infra]\ninterface = \"lo\"\n",
    );
    for digits in
        ["00".repeat(32), "5a".repeat(32), "FF".repeat(32), "0123456789abcdef".repeat(4), "deadbeef".repeat(8)]
    {
        let key = place.file("team.key", &format!("{digits}\n"));
        std::fs::set_permissions(&key, std::os::unix::fs::PermissionsExt::from_mode(0o600)).expect("it is mine");
        for command in [&["config", "check", &team][..], &["stop", &team], &["host", &team, "--robot", "0"]] {
            let said = murmurate(command).output().expect("it starts");
            let (code, said) = (said.status.code(), text(&said.stderr));
            assert_eq!(code, Some(2), "{command:?}: {said}");
            assert!(said.contains("team.key") && said.contains("guess") && said.contains("key new"), "{said}");
            assert!(!said.contains(&digits[..8]), "{said}");
        }
    }
}
