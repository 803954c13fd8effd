//! `murmurate deployment`: prints a preset mode as a deployment file. Also puts the radio of `--radio` on links.

use std::path::Path;

use crate::deploy::{Deployment, MODES};
use crate::net::media::radio::{PRESETS, Radio};
use anyhow::Result;
use clap::builder::PossibleValuesParser;

use crate::program::BadInput;
use crate::program::Ended;
use crate::program::output::{print, read_text};

/// Flags of `murmurate deployment`.
#[derive(clap::Args)]
pub struct Args {
    /// Preset mode to print
    #[arg(value_parser = PossibleValuesParser::new(MODES))]
    mode: String,
    /// Size of the team
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=5000))]
    robots: u16,
    /// Radio of its links: 'none' (ideal links), a preset (wifi, wifi-n, wifi-slow), or a radio file (docs/radio.md)
    #[arg(long, value_name = "NAME|FILE.toml", default_value = "none")]
    radio: String,
}

/// Prints the deployment.
pub fn run(args: &Args) -> Result<Ended> {
    let deployment =
        Deployment::preset(&args.mode, usize::from(args.robots)).expect("the parser lets only modes through");
    let deployment = with_radio(deployment, &args.radio)?;
    deployment.check().map_err(|e| BadInput(format!("--{e}")))?;
    print(deployment.to_toml().trim_end())?;
    Ok(Ended::Done)
}

/// Returns the deployment with this radio, a preset or a file, on its links.
pub fn with_radio(deployment: Deployment, given: &str) -> Result<Deployment> {
    if given == "none" {
        return Ok(deployment);
    }
    let radio = match Radio::preset(given) {
        Some(radio) => radio,
        None if !given.contains(['.', '/']) => {
            let names = PRESETS.join(", ");
            let why = format!("--radio: there is no radio '{given}'; there are: none, {names}, or a file FILE.toml");
            return Err(BadInput(why).into());
        }
        None => Radio::from_toml(&read_text(Path::new(given), "radio file")?)
            .map_err(|e| BadInput(format!("the radio file '{given}': {e}")))?,
    };
    let deployment = deployment.with_radio(&radio);
    if deployment.links.iter().all(|link| link.radio.is_none()) {
        return Err(BadInput(format!("--radio: in mode '{}' no link is a radio", deployment.mode)).into());
    }
    Ok(deployment)
}
