//! Names in the command line's definition: those of the registry's entries (policies, scenarios, estimators, plants)
//! and of radio presets, in the values and help texts of flags.

use clap::builder::{PossibleValue, PossibleValuesParser};
use clap::{Arg, Command};

use crate::net::media::radio;
use crate::registry::Registry;

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
        "scenario" => one_of(arg, registry.scenarios().iter().map(|entry| (entry.name, entry.about)).collect()),
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

fn help_of(arg: &Arg) -> String {
    arg.get_help().map(ToString::to_string).unwrap_or_default()
}
