//! What every study is told on the command line of how it runs, and what it says when it ends.

use std::fmt::Display;
use std::path::PathBuf;

use anyhow::Result;

use super::folder::Folder;
use crate::program::bad;
use crate::program::output::talk;

/// Flags of all studies.
#[derive(clap::Args)]
pub struct Run {
    /// The root of all randomness
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Pieces of work at the same time [default: one per core]; the numbers do not depend on it
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: Option<u16>,
    /// Where report, figures and rows go. What is finished is kept there, and the same command goes on from it
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Prints one JSON object in place of the table
    #[arg(long)]
    pub json: bool,
    /// Says nothing on stderr but errors and what an interruption leaves
    #[arg(long)]
    pub quiet: bool,
}

/// A command line that grows; what a shell would not take as it is stands in quotes.
pub struct Typed(pub String);

impl Typed {
    /// Adds a flag, if it has a value.
    pub fn add(&mut self, flag: &str, value: Option<String>) {
        if let Some(value) = value {
            let plain = value.chars().all(|c| c.is_ascii_alphanumeric() || "-_./@,:".contains(c));
            let value = if plain { value } else { format!("'{}'", value.replace('\'', r"'\''")) };
            self.0 += &format!(" --{flag} {value}");
        }
    }

    /// Adds a flag with a list, if there is anything in it.
    pub fn add_all(&mut self, flag: &str, values: impl IntoIterator<Item = impl ToString>) {
        let values: Vec<String> = values.into_iter().map(|value| value.to_string()).collect();
        self.add(flag, (!values.is_empty()).then(|| values.join(",")));
    }
}

/// Each of these is there once.
pub fn once<T: PartialEq + Display>(flag: &str, values: &[T]) -> Result<()> {
    match values.iter().enumerate().find(|(at, value)| values[..*at].contains(value)) {
        Some((_, twice)) => bad(format!("{flag}: {twice} is there twice")),
        None => Ok(()),
    }
}

impl Run {
    /// Says where everything is; `what` is what there are `done` of `all`.
    pub fn farewell(&self, folder: Option<&Folder>, what: &str, done: usize, all: usize) {
        match (folder, done < all) {
            (Some(folder), true) => talk(&format!(
                "interrupted; {done} of {all} {what} are kept in '{}': the same command goes on from there",
                folder.path().display()
            )),
            (None, true) => {
                talk(&format!("interrupted after {done} of {all} {what}; with --out DIR they would be kept"));
            }
            (Some(folder), false) if !self.quiet => talk(&format!("report in '{}'", folder.page().display())),
            _ => {}
        }
    }
}
