//! Completion scripts and man pages, which shells and `man` accept.

use std::fs;
use std::io::Write;
use std::process::{Command, Stdio};

use tempfile::TempDir;

use crate::program::skip::skip;
use crate::program::{refuses, run, text};

const SHELLS: [&str; 5] = ["bash", "elvish", "fish", "powershell", "zsh"];

/// Runs a tool on `input`; returns its success and output, or `None`, with a notice, if it is not installed.
fn tool(program: &str, args: &[&str], input: &str) -> Option<(bool, String)> {
    let mut command = Command::new(program);
    command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let Ok(mut child) = command.spawn() else {
        skip(program, &format!("there is no program '{program}'"));
        return None;
    };
    child.stdin.take().expect("it was piped").write_all(input.as_bytes()).expect("it reads its input");
    let output = child.wait_with_output().expect("it ends");
    Some((output.status.success(), text(&output.stdout) + &text(&output.stderr)))
}

#[test]
fn every_shell_has_a_script_and_bash_accepts_its_own() {
    for shell in SHELLS {
        let output = run(&["completions", shell]);
        assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()), "{shell}");
        let script = text(&output.stdout);
        for word in ["murmurate", "doctor", "key-file", "rearm"] {
            assert!(script.contains(word), "{shell}: '{word}' is missing");
        }
        if let Some((accepted, said)) = (shell == "bash").then(|| tool("bash", &["-n"], &script)).flatten() {
            assert!(accepted && said.is_empty(), "{said}");
        }
    }
    let script = text(&run(&["completions", "bash"]).stdout);
    let ask =
        "\nCOMP_WORDS=(murmurate co); COMP_CWORD=1; _murmurate murmurate co murmurate; echo \"${COMPREPLY[@]}\"\n";
    if let Some((_, said)) = tool("bash", &["--norc"], &(script + ask)) {
        assert!(said.contains("completions") && said.contains("config"), "{said}");
    }
    refuses(&["completions", "tcsh"], &["tcsh", "bash", "zsh"]);
    refuses(&["completions"], &["<SHELL>"]);
}

#[test]
fn every_command_has_a_page_and_groff_accepts_it() {
    let folder = TempDir::new().expect("a temporary folder");
    let out = folder.path().join("share").join("man1");
    let output = run(&["man", "--out", &out.to_string_lossy()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let entries = fs::read_dir(&out).expect("the folder was made");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    for name in ["murmurate.1", "murmurate-host.1", "murmurate-key-new.1", "murmurate-config-check.1"] {
        assert!(names.iter().any(|other| other == name), "'{name}' is missing in {names:?}");
    }
    assert!(names.iter().all(|name| name.starts_with("murmurate") && name.ends_with(".1")), "{names:?}");
    for name in &names {
        let page = fs::read_to_string(out.join(name)).expect("a page is text");
        assert!(page.contains(".TH") && page.contains(".SH DESCRIPTION"), "{name}");
        let Some((accepted, said)) = tool("groff", &["-man", "-Tascii", "-ww", "-z"], &page) else { break };
        assert!(accepted && !said.contains("error"), "{name}: {said}");
    }
    let main = run(&["man"]);
    assert_eq!(text(&main.stdout).trim_end(), fs::read_to_string(out.join("murmurate.1")).expect("a page").trim_end());
    let file = folder.path().join("file");
    fs::write(&file, "").expect("it can be written");
    refuses(&["man", "--out", &file.join("below").to_string_lossy()], &["--out", "file/below"]);
}

#[test]
fn a_program_of_another_name_has_that_name_in_its_help_and_its_advice() {
    let folder = TempDir::new().expect("a temporary folder");
    let other = folder.path().join("flockers");
    std::os::unix::fs::symlink(env!("CARGO_BIN_EXE_murmurate"), &other).expect("a link");
    let said = |args: &[&str]| {
        let output = Command::new(&other).args(args).stdin(Stdio::null()).output().expect("it starts");
        text(&output.stdout) + &text(&output.stderr)
    };
    for args in [
        &["--help"][..],
        &["man", "--help"],
        &["completions", "--help"],
        &["watch", "--help"],
        &["host", "--help"],
        &["completions", "fish"],
        &["man"],
        &["sim", "--colour"],
        &["sim", "--watch", "--listen", "0.0.0.0:8137"],
        &["train", "passage", "--print-config"],
    ] {
        let said = said(args);
        assert!(said.contains("flockers") || args == ["host", "--help"], "{args:?}: {said}");
        assert!(!said.contains("murmurate"), "{args:?}: {said}");
    }
}

#[test]
fn help_texts_name_every_radio_preset() {
    for command in ["sim", "deployment", "train"] {
        let said = text(&run(&[command, "--help"]).stdout);
        for preset in murmurate::net::media::radio::PRESETS {
            let named = said.split_whitespace().any(|word| word.trim_matches(['(', ')', ',']) == preset);
            assert!(named, "{command}: '{preset}' is missing in: {said}");
        }
        assert!(!said.contains("PRESETS"), "{said}");
    }
}
