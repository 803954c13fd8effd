//! What holds for every command that the help lists, and the program's error for those that it was built without.

use crate::pages::pages;
use crate::program::{commands, refuses, run, text};

#[test]
fn every_command_has_help_in_one_sentence_and_is_on_a_page() {
    let (all, pages) = (commands(), pages());
    assert!(all.len() > 15, "{all:?}");
    for name in &all {
        let output = run(&[name, "--help"]);
        assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()), "{name}");
        let help = text(&output.stdout);
        let (about, _) = help.split_once("\n\nUsage: ").unwrap_or_else(|| panic!("{name} has no help: {help}"));
        let sentence = about.starts_with(char::is_uppercase) && !about.contains(". ") && !about.contains("\n\n");
        assert!(sentence, "{name}: one sentence, not '{about}'");
        let shown = format!("murmurate {name}");
        let named = |text: &str| {
            text.match_indices(&shown).any(|(at, _)| text[at + shown.len()..].starts_with([' ', '`', '\n']))
        };
        assert!(pages.iter().any(|page| named(&page.text)), "no page has '{shown}'");
    }
}

#[test]
fn every_command_refuses_a_flag_that_it_does_not_have() {
    for name in commands() {
        refuses(&[&name, "--no-such-flag"], &["'--no-such-flag'"]);
    }
}

#[test]
fn a_command_of_a_missing_feature_says_which_one_the_program_needs() {
    if !cfg!(feature = "lab") {
        refuses(&["lab", "--help"], &["'lab'", "without the feature 'lab'", "cargo build", "--features lab"]);
        refuses(&["lab", "up", "lab.toml"], &["the feature 'lab'", "--features lab"]);
        refuses(&["launch", "team.toml", "--lab", "lab.toml"], &["'--lab'", "--features lab"]);
    }
    refuses(&["labs", "up"], &["labs"]);
}
