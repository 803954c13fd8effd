//! The command `murmurate record import`: makes a record of a run of another program.

use std::path::PathBuf;

use anyhow::Result;

use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use murmurate_import::{Imported, record};
use murmurate_record::identity::Identity;
use murmurate_robot::output::{print, talk};
use murmurate_robot::{BadInput, Ended, bad, build};

/// Flags of `murmurate record import`.
#[derive(clap::Args)]
pub struct Args {
    /// Mapping (docs/lab-run.md): which files the run is in, and what their columns or topics are
    #[arg(value_name = "MAPPING.toml")]
    mapping: PathBuf,
    /// The record
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
}

/// Runs `record import`: reads the files that a mapping names, writes them as a record, and prints what it holds.
pub fn run(args: &Args, registry: &Registry) -> Result<Ended> {
    if args.output.exists() {
        return bad(format!("--output: '{}' is there already: name another file", args.output.display()));
    }
    let imported = murmurate_import::read(&args.mapping, registry).map_err(|error| BadInput(error.to_string()))?;
    let Imported { mapping, text, steps, samples, stage } = imported;
    let name = args.mapping.display().to_string();
    let arguments = ["record", "import", &name].map(str::to_owned).to_vec();
    let identity = Identity::here(build::digest(), arguments, "");
    record::write(&args.output, (identity, &stage), (name, text), (&steps, &samples))?;
    if steps.repeated > 0 {
        let poses = counted(steps.repeated, "pose");
        talk(&format!("left out: {poses} of a robot and a time that had one already"));
    }
    if steps.unmeasured > 0 {
        talk(&format!("left out: {} without a velocity, which the others have", counted(steps.unmeasured, "pose")));
    }
    let sum = |all: &[usize]| all.iter().sum::<usize>();
    let poses = sum(&samples.poses.iter().map(Vec::len).collect::<Vec<_>>());
    let commands = sum(&samples.commands.iter().map(Vec::len).collect::<Vec<_>>());
    print(&format!(
        "{}: {}, {}, {} as {}, {}, {}",
        args.output.display(),
        counted(mapping.names.len(), "robot"),
        counted(steps.episodes, "episode"),
        counted(poses, "pose"),
        counted(steps.steps.len(), "step"),
        counted(commands, "command"),
        counted(samples.receipts.len(), "receipt"),
    ))?;
    Ok(Ended::Done)
}
