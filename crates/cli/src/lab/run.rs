//! `murmurate lab run`: a laboratory for one run of a command in every station.

use std::io::Read;
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};
use serde::Serialize;

use super::up::Source;
use murmurate_lab::file::Laboratory;
use murmurate_lab::machine::crew::{Crew, CrewEnd};
use murmurate_lab::machine::{self, Running, needs};
use murmurate_lab::report::LabReport;
use murmurate_robot::output::{print, talk};
use murmurate_robot::{BadInput, Ended, signals};

/// Flags of `murmurate lab run`.
#[derive(clap::Args)]
#[command(
    after_help = "A station's command finds LAB_STATION, LAB_STATIONS, LAB_ADDRESS, LAB_ADDRESSES (all, with commas), \
    LAB_INTERFACE and LAB_NAME in its environment; its output goes to stderr, with the station's number before each \
    line. Exit codes: 0 every command has ended well, or was ended after --seconds; 1 a command has failed; 2 the file \
    is wrong; 130 interrupted by Ctrl-C. The counters until then are printed, and nothing is left."
)]
pub struct Args {
    #[command(flatten)]
    source: Source,
    /// Ends the commands after this time [s]
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Prints one JSON object instead of the table
    #[arg(long)]
    json: bool,
    /// Command and its arguments, after '--', for every station without a 'command' of its own in the file
    #[arg(last = true, value_name = "COMMAND")]
    command: Vec<String>,
}

/// Counters of a laboratory, with the commands that have failed.
#[derive(Serialize)]
struct RunReport<'a> {
    #[serde(flatten)]
    lab: &'a LabReport,
    failed: Vec<FailedCommand<'a>>,
    interrupted: bool,
}

#[derive(Serialize)]
struct FailedCommand<'a> {
    station: u16,
    how: &'a str,
}

/// Runs `lab run`.
pub fn run(args: &Args) -> Result<Ended> {
    let lab = args.source.read()?;
    let commands = lab.commands_or(&args.command);
    if commands.is_empty() {
        let why = "no station has a command: give one after '--', or as 'command' of a [[station]] in the file";
        return Err(BadInput(why.to_owned()).into());
    }
    let limit = match args.seconds {
        None => None,
        Some(seconds) if (0.0..=1e6).contains(&seconds) => Some(Duration::from_secs_f64(seconds)),
        Some(_) => return Err(BadInput("--seconds: it is not 0 to 1000000".to_owned()).into()),
    };
    needs::check()?;
    let (report, end) = with_lab(&lab, &args.source, commands, limit)?;
    for (station, how) in &end.failed {
        talk(&format!("the command of station {station} has failed ({how})"));
    }
    let failed = end.failed.iter().map(|(station, how)| FailedCommand { station: *station, how }).collect();
    print(&if args.json {
        let all = RunReport { lab: &report, failed, interrupted: end.interrupted };
        serde_json::to_string(&all).context("a report is JSON")?
    } else {
        report.to_string()
    })?;
    Ok(match (end.interrupted, end.failed.is_empty()) {
        (true, _) => Ended::Interrupted,
        (false, false) => Ended::Unfit,
        (false, true) => Ended::Done,
    })
}

/// Makes a laboratory, runs the commands in its stations, and removes it. Returns the counters and how the commands
/// have ended.
fn with_lab(
    lab: &Laboratory,
    source: &Source,
    commands: Vec<(u16, Vec<String>)>,
    limit: Option<Duration>,
) -> Result<(LabReport, CrewEnd)> {
    let (_, signals) = signals::listen()?;
    let signals = signals.try_clone().context("cannot listen for signals")?;
    let capture = source.capture()?;
    let running = Running::start(lab, capture, talk)?;
    let about = running.about.clone();
    let prepared = commands.into_iter().map(|(station, words)| {
        let mut command = machine::command(&lab.namespace(station));
        command.args(words).envs(about.variables(station));
        (station, command)
    });
    let crew = Crew::start(prepared.collect())?;
    let stopper = crew.stopper();
    thread::spawn(move || {
        signals.set_nonblocking(false).ok();
        while (&signals).read(&mut [0]).is_ok_and(|length| length > 0) {
            stopper.stop();
        }
    });
    let end = crew.wait(limit, |station, line| talk(&format!("{station} | {line}")));
    Ok((running.end()?, end))
}
