//! The flags of `sim` as a sweep takes them: those that are given, to which a point adds its values.

use std::ffi::OsString;
use std::path::Path;

use anyhow::Result;
use clap::{ArgMatches, Args, Command, Error, FromArgMatches, parser::ValueSource};
use murmurate_robot::BadInput;

use murmurate_study::sweep::NAME;

use super::place::{Place, toml_value};
use crate::sim::changes::{Change, Changes};
use crate::sim::setup::Setup;

/// Flags of `sim` that define its trials, as they are given on the command line.
pub struct Given {
    /// Flags without `--`, each with one value.
    words: Vec<(String, OsString)>,
}

/// Returns the command that parses the flags of `sim` for one point.
fn command() -> Command {
    Setup::augment_args(Command::new(NAME).no_binary_name(true))
}

impl Given {
    /// Returns no flags: what holds at a point is of the point alone.
    pub fn none() -> Given {
        Given { words: Vec::new() }
    }

    /// Returns whether the flag `flag` (without `--`) is given.
    pub fn has(&self, flag: &str) -> bool {
        self.words.iter().any(|(name, _)| name == flag)
    }

    /// Returns whether `sim` has the flag `flag` (without `--`).
    pub fn exists(flag: &str) -> bool {
        command().get_arguments().any(|argument| argument.get_long() == Some(flag))
    }

    /// Returns the names of all flags, without `--`.
    pub fn names() -> Vec<String> {
        command().get_arguments().filter_map(|argument| argument.get_long().map(str::to_owned)).collect()
    }

    /// Returns the flags and their values as text, in the order of the program's help.
    pub fn words(&self) -> impl Iterator<Item = (&str, String)> {
        self.words.iter().map(|(name, value)| (name.as_str(), value.to_string_lossy().into_owned()))
    }

    /// Returns the flags at a point: those that are given, with the values of the axes. An error names the axis.
    pub fn at(&self, point: &[(Place, &str)]) -> Result<Setup> {
        let mut words: Vec<OsString> = Vec::new();
        let mut add = |flag: &str, value: &OsString| {
            let mut word = OsString::from(format!("--{flag}="));
            word.push(value);
            words.push(word);
        };
        self.words.iter().for_each(|(flag, value)| add(flag, value));
        for (place, value) in point {
            if let Place::Flag(flag) = place {
                add(flag, &OsString::from(value));
            }
        }
        let wrong = |error: &Error| BadInput(first_line(error));
        let found = command().try_get_matches_from(words).map_err(|error| wrong(&error))?;
        let mut setup = Setup::from_arg_matches(&found).map_err(|error| wrong(&error))?;
        let change = |(place, value): &(Place, &str)| match place {
            Place::Flag(_) => None,
            Place::Field { flag, field } => {
                let (flag, field) = (flag.clone(), field.clone());
                Some(Change { flag, field, value: toml_value(value) })
            }
        };
        setup.changes = Changes(point.iter().filter_map(change).collect());
        Ok(setup)
    }
}

/// Returns what is wrong in one line.
fn first_line(error: &Error) -> String {
    let text = error.to_string();
    let first = text.lines().next().unwrap_or_default();
    first.trim_start_matches("error: ").to_owned()
}

impl FromArgMatches for Given {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Given, Error> {
        // Fails where a flag is wrong without a sweep.
        Setup::from_arg_matches(matches)?;
        let mut words = Vec::new();
        for argument in command().get_arguments() {
            let (id, Some(long)) = (argument.get_id().as_str(), argument.get_long()) else { continue };
            if matches.value_source(id) != Some(ValueSource::CommandLine) {
                continue;
            }
            let values = matches.get_raw(id).into_iter().flatten();
            words.extend(values.map(|value| (long.to_owned(), value.to_owned())));
        }
        Ok(Given { words })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Given::from_arg_matches(matches)?;
        Ok(())
    }
}

impl Args for Given {
    fn augment_args(command: Command) -> Command {
        Setup::augment_args(command)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Setup::augment_args_for_update(command)
    }
}

/// Returns path and digest of a file, which tell files of one name apart; `None` if there is none at `path`.
pub fn digest(path: &Path) -> Option<String> {
    let bytes = path.is_file().then(|| std::fs::read(path).ok())??;
    Some(format!("{} {}", path.display(), &blake3::hash(&bytes).to_hex()[..16]))
}
