//! Flags that all studies share, and the message at the end that says where the results are.

use std::fmt::Display;
use std::path::PathBuf;

use anyhow::Result;

use super::folder::Folder;
use murmurate_robot::bad;
use murmurate_robot::output::talk;

/// Flags that all studies share.
#[derive(clap::Args)]
pub struct Run {
    /// Seed of all random numbers
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// Number of threads; the results do not depend on it [default: one per core]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub jobs: Option<u16>,
    /// Folder for report, figures and rows. Finished work is kept there, and the same command continues it
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    pub json: bool,
    /// Prints only errors and interruptions on stderr
    #[arg(long)]
    pub quiet: bool,
}

/// Text of a command line that is being built, with quotes where a shell needs them.
pub struct CommandLine(pub String);

impl CommandLine {
    /// Adds a flag (without `--`) with its value; adds nothing if the value is `None`.
    pub fn add(&mut self, flag: &str, value: Option<String>) {
        if let Some(value) = value {
            let plain = value.chars().all(|c| c.is_ascii_alphanumeric() || "-_./@,:".contains(c));
            let value = if plain { value } else { format!("'{}'", value.replace('\'', r"'\''")) };
            self.0 += &format!(" --{flag} {value}");
        }
    }

    /// Adds a flag (without `--`) with a list of values, separated by commas; adds nothing if the list is empty.
    pub fn add_all(&mut self, flag: &str, values: impl IntoIterator<Item = impl ToString>) {
        let values: Vec<String> = values.into_iter().map(|value| value.to_string()).collect();
        self.add(flag, (!values.is_empty()).then(|| values.join(",")));
    }
}

/// Checks that no value of the flag `flag` is given twice. The error names the flag.
pub fn check_unique<T: PartialEq + Display>(flag: &str, values: &[T]) -> Result<()> {
    match values.iter().enumerate().find(|(at, value)| values[..*at].contains(value)) {
        Some((_, twice)) => bad(format!("{flag}: {twice} is given twice")),
        None => Ok(()),
    }
}

impl Run {
    /// Prints on stderr where the results of a study are. After an interruption, also prints how many of `all` jobs are
    /// done; `what` is the noun for them, such as `trials`.
    pub fn print_location(&self, folder: Option<&Folder>, what: &str, done: usize, all: usize) {
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
