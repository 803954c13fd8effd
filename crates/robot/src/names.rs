//! Names in the command line's definition: those of the registry's entries (policies, scenarios, estimators, plants)
//! and of radio presets, in the values and help texts of flags, and the program's own name.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, PossibleValuesParser, StyledStr, TypedValueParser};
use clap::{Arg, Command};

use super::MURMURATE;
use murmurate::net::media::radio;
use murmurate::registry::Registry;
use murmurate::scenario::task_file::is_task_file;

/// Returns `command` with the names of the registry's entries (policies, scenarios and so on) added to its flags and
/// those of its subcommands: as permitted values, or in the help text.
pub fn add(command: Command, registry: &Registry) -> Command {
    command.mut_args(|arg| named(arg, registry)).mut_subcommands(|below| add(below, registry))
}

fn named(arg: Arg, registry: &Registry) -> Arg {
    let one_of = |arg: Arg, names: Vec<(&'static str, &'static str)>| {
        arg.value_parser(PossibleValuesParser::new(
            names.into_iter().map(|(name, about)| PossibleValue::new(name).help(about)),
        ))
    };
    match arg.get_id().as_str() {
        "scenario" => {
            let names = registry.scenarios().iter();
            arg.value_parser(ScenarioParser { names: names.map(|entry| (entry.name, entry.about)).collect() })
        }
        "estimator" => one_of(arg, registry.estimators().iter().map(|entry| (entry.name, entry.about)).collect()),
        "plant" => one_of(arg, registry.plants().iter().map(|entry| (entry.name, entry.about)).collect()),
        "policy" | "policies" => {
            let named: Vec<String> =
                registry.policies().iter().map(|entry| format!("'{}' ({})", entry.name, entry.about)).collect();
            let help = help_of(&arg);
            let (text, default) = help.split_at(help.find(" [default").unwrap_or(help.len()));
            arg.help(format!("{text}. Named policies: {}{default}", named.join("; ")))
        }
        "radio" => {
            let help = help_of(&arg).replace("PRESETS", &radio::PRESETS.join(", "));
            arg.help(help)
        }
        _ => arg,
    }
}

/// Parser of a scenario's name, or of the path of a task file, which ends with `.toml`.
#[derive(Clone)]
struct ScenarioParser {
    /// Name and description of each scenario of the registry.
    names: Vec<(&'static str, &'static str)>,
}

impl TypedValueParser for ScenarioParser {
    type Value = String;

    fn parse_ref(&self, cmd: &Command, arg: Option<&Arg>, value: &OsStr) -> Result<String, clap::Error> {
        match value.to_str() {
            Some(path) if is_task_file(path) => Ok(path.to_owned()),
            _ => PossibleValuesParser::new(self.possible()).parse_ref(cmd, arg, value),
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.possible()))
    }
}

impl ScenarioParser {
    fn possible(&self) -> impl Iterator<Item = PossibleValue> + use<> {
        let values = self.names.iter().map(|(name, about)| PossibleValue::new(*name).help(*about));
        values.collect::<Vec<_>>().into_iter()
    }
}

fn help_of(arg: &Arg) -> String {
    arg.get_help().map(ToString::to_string).unwrap_or_default()
}

/// Returns the command line of a program called `name`, whose help texts have that name in place of `murmurate`.
pub fn rename(command: Command, name: &'static str) -> Command {
    if name == MURMURATE { command } else { renamed(command, name).name(name) }
}

fn renamed(mut command: Command, name: &str) -> Command {
    let own = |text: Option<&StyledStr>| {
        let (text, named) = (text?.to_string(), format!("{name} "));
        // A path has the name at its end, such as that of the file with completions.
        let text = text.replace(&format!("{MURMURATE} "), &named);
        Some(match text.strip_suffix(&format!("/{MURMURATE}")) {
            Some(folder) => format!("{folder}/{name}"),
            None => text,
        })
    };
    if let Some(text) = own(command.get_about()) {
        command = command.about(text);
    }
    if let Some(text) = own(command.get_after_help()) {
        command = command.after_help(text);
    }
    let of_arg = |arg: Arg| match own(arg.get_help()) {
        Some(text) => arg.help(text),
        None => arg,
    };
    command.mut_args(of_arg).mut_subcommands(|below| renamed(below, name))
}
