//! The command `murmurate deployment`: prints a preset mode as a deployment file. Also adds the radio of `--radio` to
//! links.

use std::ffi::OsStr;
use std::path::Path;

use anyhow::Result;
use clap::Arg;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use murmurate::config::ConfigError;
use murmurate::deploy::{Deployment, Impair, MODES};
use murmurate::net::media::radio::{PRESETS, Radio};
use murmurate::registry::Registry;

use crate::sim::changes::Changes;
use murmurate_robot::output::print;
use murmurate_robot::{BadInput, Ended, bad};

/// Parser of the whole name of a preset mode. For a mere beginning of names, the error lists the modes with it.
#[derive(Clone)]
pub struct ModeParser;

impl TypedValueParser for ModeParser {
    type Value = String;

    fn parse_ref(&self, cmd: &clap::Command, arg: Option<&Arg>, value: &OsStr) -> Result<String, clap::Error> {
        let given = value.to_str().unwrap_or_default();
        let begin: Vec<&str> = MODES.into_iter().filter(|mode| !given.is_empty() && mode.starts_with(given)).collect();
        if begin.is_empty() || begin.contains(&given) {
            return PossibleValuesParser::new(MODES).parse_ref(cmd, arg, value);
        }
        let why = format!("there is no mode '{given}'; choose {}", begin.join(" or "));
        Err(clap::Error::raw(ErrorKind::InvalidValue, why).with_cmd(cmd))
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(MODES.into_iter().map(PossibleValue::new)))
    }
}

/// Prints a preset mode as a deployment file, to be changed and run with `sim --deployment`.
#[derive(clap::Args)]
pub struct Args {
    /// Preset mode to print
    #[arg(value_parser = ModeParser)]
    mode: String,
    /// Size of the team
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=5000))]
    robots: u16,
    /// Radio of its links: 'none' (ideal links), a preset (PRESETS), or a radio file (docs/radio.md)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "none")]
    radio: String,
}

/// Runs `deployment`: prints the preset mode that the arguments select, as a deployment file (TOML).
pub fn run(args: &Args, _: &Registry) -> Result<Ended> {
    let deployment =
        Deployment::preset(&args.mode, usize::from(args.robots)).expect("the parser lets only modes through");
    let deployment = with_radio(deployment, &args.radio, &Changes::default())?;
    deployment.check().map_err(|e| BadInput(format!("--{e}")))?;
    print(deployment.to_toml().trim_end())?;
    Ok(Ended::Done)
}

/// Sets the delay \[ms\] and the loss (0 to 1) of the messages of links that `impair` selects, as `--delay-ms` and
/// `--loss` do; zero leaves a link as it is.
pub fn impaired(deployment: Deployment, (delay_ms, loss): (f64, f64), impair: Impair) -> Result<Deployment> {
    for (flag, value, most) in [("--delay-ms", delay_ms, 60_000.0), ("--loss", loss, 1.0)] {
        if !(0.0..=most).contains(&value) {
            return bad(format!("{flag}: {value} is not 0 to {most}"));
        }
    }
    if delay_ms == 0.0 && loss == 0.0 {
        return Ok(deployment);
    }
    let flag = if delay_ms > 0.0 { "--delay-ms" } else { "--loss" };
    let given = |value: f64| Some(value).filter(|value| *value > 0.0);
    let impaired = deployment.impaired(given(delay_ms / 1000.0), given(loss), impair);
    Ok(impaired.map_err(|e| BadInput(format!("{flag}: {e}")))?)
}

/// Adds a radio to the links of a deployment. `given` is the name of a radio preset, the path of a radio file, or
/// `none`. Fields of the radio are changed by `changes`.
pub fn with_radio(deployment: Deployment, given: &str, changes: &Changes) -> Result<Deployment> {
    if given == "none" {
        return Ok(deployment);
    }
    let wrong = |error: ConfigError| BadInput(format!("the radio file '{given}': {error}"));
    let radio = match Radio::preset(given) {
        Some(radio) if !changes.concern("radio") => radio,
        Some(radio) => {
            let text = toml::to_string(&radio).expect("a radio is TOML");
            Radio::from_toml(&changes.over("radio", text)?).map_err(wrong)?
        }
        None if !given.contains(['.', '/']) => {
            let names = PRESETS.join(", ");
            let why = format!("--radio: there is no radio '{given}'; there are: none, {names}, or a file FILE.toml");
            return Err(BadInput(why).into());
        }
        None => Radio::from_toml(&changes.read("radio", Path::new(given), "radio file")?).map_err(wrong)?,
    };
    let deployment = deployment.with_radio(&radio);
    if deployment.links.iter().all(|link| link.radio.is_none()) {
        return Err(BadInput(format!("--radio: in mode '{}' no link is a radio", deployment.mode)).into());
    }
    Ok(deployment)
}

/// Describes the emulated network as text; `None` if it is ideal. `delay_ms` \[ms\] and `loss` (0 to 1) apply to all
/// messages if `all` is true, or else only to those between robots. `radio` is the name of a radio preset, the path of
/// a radio file, or `none`.
pub fn conditions(delay_ms: f64, loss: f64, all: bool, radio: &str) -> Option<String> {
    let of = if all { "all messages" } else { "messages between robots" };
    let parts = [
        (delay_ms > 0.0).then(|| format!("delay {delay_ms} ms")),
        (loss > 0.0).then(|| format!("loss {:.0} %", 100.0 * loss)),
    ];
    let impaired: Vec<String> = parts.into_iter().flatten().collect();
    let impaired = (!impaired.is_empty()).then(|| format!("{} of {of}", impaired.join(", ")));
    let radio = (radio != "none").then(|| format!("radio {radio}"));
    let words: Vec<String> = impaired.into_iter().chain(radio).collect();
    (!words.is_empty()).then(|| words.join("; "))
}
