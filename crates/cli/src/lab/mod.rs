//! The command `murmurate lab`: stations in network namespaces, whose frames travel over the emulated radio channel in
//! real time. Any program runs in a station.
//!
//! `murmurate_lab` has the channel and the stations.

mod check;
mod run;
mod up;

use std::os::fd::AsFd;
use std::os::unix::process::CommandExt;
use std::path::Path;

use anyhow::{Context, Result, anyhow};
use clap::Subcommand;
use murmurate::config::shown::counted;
use murmurate::registry::Registry;
use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use murmurate_lab::file::Laboratory;
use murmurate_lab::machine::control::{self, Removed};
use murmurate_lab::machine::{self, LabError, needs};
use murmurate_lab::report::LabReport;
use murmurate_robot::output::{print, read_text, talk};
use murmurate_robot::{BadInput, Ended};

/// Runs any program in stations whose frames travel over the emulated radio channel, in real time.
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
pub fn run(args: &Args, _: &Registry) -> Result<Ended> {
    let ended = match args {
        Args::Up(args) => up::run(args),
        Args::Exec(args) => exec(args),
        Args::Run(args) => run::run(args),
        Args::Down(which) => down(&which.name),
        Args::Status(args) => status(args),
        Args::Check(args) => check::run(args),
    };
    ended.map_err(sorted)
}

/// Converts the error of a command: an invalid request to a laboratory becomes a [`BadInput`].
pub fn sorted(error: anyhow::Error) -> anyhow::Error {
    match error.downcast::<LabError>() {
        Ok(LabError::Invalid(why)) => BadInput(why).into(),
        Ok(failed) => failed.into(),
        Err(other) => other,
    }
}

/// Reads a laboratory file.
pub fn read(path: &Path) -> Result<Laboratory> {
    let text = read_text(path, "laboratory file")?;
    Laboratory::from_toml(&text)
        .map_err(|error| BadInput(format!("the laboratory file '{}': {error}", path.display())).into())
}

fn exec(args: &Exec) -> Result<Ended> {
    let report = control::report(&args.which.name)?;
    let Some(station) = report.stations.get(usize::from(args.station)) else {
        let last = report.stations.len() - 1;
        return Err(BadInput(format!("there is no station {}; there are 0 to {last}", args.station)).into());
    };
    needs::capabilities()?;
    let mut command = machine::command(&station.namespace);
    // Replaces this process, so that signals and the exit code are the command's.
    let error = command.args(&args.command).envs(report.variables(args.station)).exec();
    Err(anyhow!(error)).context("cannot start 'ip' (package iproute2)")
}

fn status(args: &Status) -> Result<Ended> {
    let shown = |report: &LabReport| if args.json { serde_json::to_string(report) } else { Ok(report.to_string()) };
    let once = || -> Result<()> { print(&shown(&control::report(&args.which.name)?).context("a report is JSON")?) };
    once()?;
    let Some(every) = args.every else { return Ok(Ended::Done) };
    let (_, signals) = murmurate_robot::signals::listen()?;
    while !readable(&*signals, u64::from(every) * 1000)? {
        once()?;
    }
    Ok(Ended::Interrupted)
}

/// Waits until `source` is readable, at most `ms` \[ms\]. Returns whether it is.
fn readable(source: impl AsFd, ms: u64) -> Result<bool> {
    let timeout = PollTimeout::try_from(ms.min(600_000)).unwrap_or(PollTimeout::NONE);
    match poll(&mut [PollFd::new(source.as_fd(), PollFlags::POLLIN)], timeout) {
        Ok(count) => Ok(count > 0),
        Err(Errno::EINTR) => Ok(false),
        Err(error) => Err(anyhow!(error)).context("cannot wait for a socket"),
    }
}

/// Ends a laboratory, and prints what was removed.
fn down(name: &str) -> Result<Ended> {
    talk(&match control::down(name, talk)? {
        Removed::Running => format!("the lab '{name}' is removed"),
        Removed::Left(0) => format!("no lab '{name}' is up"),
        Removed::Left(count) => format!("removed: {} that a lab '{name}' had left behind", counted(count, "station")),
    });
    Ok(Ended::Done)
}
