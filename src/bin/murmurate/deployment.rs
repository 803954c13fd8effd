//! `murmurate deployment`: a preset mode as a file to start from.

use anyhow::Result;
use clap::builder::PossibleValuesParser;
use murmurate::deploy::{Deployment, MODES};

use crate::{BadInput, Ended, output};

/// Flags of `murmurate deployment`.
#[derive(clap::Args)]
pub struct Args {
    /// The preset mode
    #[arg(value_parser = PossibleValuesParser::new(MODES))]
    mode: String,
    /// Size of the team
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=5000))]
    robots: u16,
}

/// Prints the deployment.
pub fn run(args: &Args) -> Result<Ended> {
    let deployment =
        Deployment::preset(&args.mode, usize::from(args.robots)).expect("the parser lets only modes through");
    deployment.check().map_err(|e| BadInput(format!("--{e}")))?;
    output::print(deployment.to_toml().trim_end())?;
    Ok(Ended::Done)
}
