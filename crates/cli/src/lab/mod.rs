//! The command `murmurate lab`: stations in network namespaces, whose frames travel over the emulated radio channel in
//! real time. Any program runs in a station.
//!
//! The channel is `murmurate_lab`. The files of this folder hold the clock, the TAP interfaces, the namespaces and the
//! processes.

mod carrier;
mod check;
mod claim;
mod control;
mod crew;
mod namespace;
mod needs;
mod run;
mod running;
mod traffic;
mod up;

pub use namespace::inside;
pub use needs::check as check_needs;
pub use running::Running;

use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, anyhow};
use clap::Subcommand;

use murmurate_lab::file::Laboratory;
use murmurate_lab::report::LabReport;
use murmurate_robot::output::{print, read_text};
use murmurate_robot::{BadInput, Ended};

/// Subcommands of `murmurate lab`.
#[derive(Subcommand)]
pub enum Args {
    /// Makes the stations of a laboratory file and carries their frames, in the background until 'lab down'
    Up(up::Args),
    /// Runs a command in a station
    Exec(Exec),
    /// Makes the stations, runs a command in each, reports what the channel did, and removes everything
    Run(run::Args),
    /// Removes a laboratory with everything that it made
    Down(Which),
    /// Prints the counters of a running laboratory
    Status(Status),
    /// Compares the channel in real time on this machine with the same channel in virtual time
    Check(check::Args),
}

/// Name of a laboratory on this machine, as a flag.
#[derive(clap::Args)]
pub struct Which {
    /// Name of the laboratory, as in its file
    #[arg(long, value_name = "NAME", default_value = "lab")]
    name: String,
}

/// Flags of `murmurate lab exec`.
#[derive(clap::Args)]
#[command(after_help = "The command finds LAB_STATION, LAB_STATIONS, LAB_ADDRESS, LAB_ADDRESSES (all, with commas), \
    LAB_INTERFACE and LAB_NAME in its environment. The exit code is the command's.")]
pub struct Exec {
    /// Number of the station
    station: u16,
    #[command(flatten)]
    which: Which,
    /// Command and its arguments, after '--'
    #[arg(required = true, last = true, value_name = "COMMAND")]
    command: Vec<std::ffi::OsString>,
}

/// Flags of `murmurate lab status`.
#[derive(clap::Args)]
pub struct Status {
    #[command(flatten)]
    which: Which,
    /// Prints one JSON object
    #[arg(long)]
    json: bool,
    /// Prints the counters again and again with this period [s], until Ctrl-C
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u16).range(1..))]
    every: Option<u16>,
}

/// Runs a subcommand of `lab`.
pub fn run(args: &Args) -> Result<Ended> {
    match args {
        Args::Up(args) => up::run(args),
        Args::Exec(args) => exec(args),
        Args::Run(args) => run::run(args),
        Args::Down(which) => control::down(&which.name),
        Args::Status(args) => status(args),
        Args::Check(args) => check::run(args),
    }
}

/// Reads a laboratory file.
pub fn read(path: &Path) -> Result<Laboratory> {
    let text = read_text(path, "laboratory file")?;
    Laboratory::from_toml(&text)
        .map_err(|error| BadInput(format!("the laboratory file '{}': {error}", path.display())).into())
}

/// Returns the variables of the environment by which a command knows its station.
fn variables(report: &LabReport, station: u16) -> Vec<(&'static str, String)> {
    let addresses: Vec<&str> = report.stations.iter().map(|station| station.address.as_str()).collect();
    vec![
        ("LAB_NAME", report.name.clone()),
        ("LAB_STATION", station.to_string()),
        ("LAB_STATIONS", addresses.len().to_string()),
        ("LAB_ADDRESS", addresses[usize::from(station)].to_owned()),
        ("LAB_ADDRESSES", addresses.join(",")),
        ("LAB_INTERFACE", report.interface.clone()),
    ]
}

fn exec(args: &Exec) -> Result<Ended> {
    let report = control::report(&args.which.name)?;
    let Some(station) = report.stations.get(usize::from(args.station)) else {
        let last = report.stations.len() - 1;
        return Err(BadInput(format!("there is no station {}; there are 0 to {last}", args.station)).into());
    };
    needs::capabilities()?;
    let mut command = Command::new("ip");
    command.args(["netns", "exec", &station.namespace]).args(&args.command);
    // Replaces this process, so that signals and the exit code are the command's.
    let error = command.envs(variables(&report, args.station)).exec();
    Err(anyhow!(error)).context("cannot start 'ip' (package iproute2)")
}

fn status(args: &Status) -> Result<Ended> {
    let shown = |report: &LabReport| if args.json { serde_json::to_string(report) } else { Ok(report.to_string()) };
    let once = || -> Result<()> { print(&shown(&control::report(&args.which.name)?).context("a report is JSON")?) };
    once()?;
    let Some(every) = args.every else { return Ok(Ended::Done) };
    let (_, signals) = murmurate_robot::signals::listen()?;
    while !control::readable(&*signals, u64::from(every) * 1000)? {
        once()?;
    }
    Ok(Ended::Interrupted)
}
