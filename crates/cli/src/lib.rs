//! The command-line program: flags, files, progress and exit codes. The work of a run is done by other modules.
//!
//! Exit codes: 0 done; 1 the run, one of its processes, its output or a check of `doctor` failed; 2 a flag or a file is
//! wrong, and nothing was run; 101 a bug (a panic); 130 interrupted, with the results until then printed.

// Doc comments of flags are help texts for a terminal, where [m] is a unit and <FILE> a name.
#![deny(clippy::print_stdout, clippy::print_stderr)]
#![allow(rustdoc::broken_intra_doc_links, rustdoc::invalid_html_tags)]

mod background_writer;
#[cfg(feature = "record")]
mod build;
#[cfg(feature = "sim")]
mod conditions;
mod config;
#[cfg(feature = "sim")]
mod deployment;
mod destination;
mod doctor;
#[cfg(any(feature = "sim", feature = "train"))]
mod drive;
mod features;
mod host;
#[cfg(feature = "sim")]
mod jobs;
mod key;
#[cfg(feature = "lab")]
mod lab;
#[cfg(feature = "sim")]
mod launch;
mod names;
mod outlets;
mod output;
mod paths;
#[cfg(feature = "sim")]
mod picture;
mod place;
mod policy;
#[cfg(feature = "sim")]
mod progress;
#[cfg(feature = "sim")]
mod record;
#[cfg_attr(not(feature = "record"), path = "unrecorded.rs")]
mod recording;
#[cfg(feature = "sim")]
mod replay;
#[cfg(feature = "completions")]
mod shells;
mod signals;
#[cfg(feature = "sim")]
mod sim;
#[cfg(any(feature = "sim", feature = "train"))]
mod size;
mod stop;
#[cfg(feature = "study")]
mod study;
mod team;
mod temporary;
#[cfg(feature = "train")]
mod train;
#[cfg(feature = "watch")]
mod watch;
#[cfg(any(feature = "completions", feature = "sim"))]
mod whole_file;

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::ExitCode;
use std::sync::OnceLock;
#[cfg(feature = "sim")]
use std::sync::atomic::AtomicBool;

#[cfg(any(feature = "sim", feature = "lab"))]
use anyhow::Context;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

use murmurate::live;
use murmurate::live::links::LinkError;
use murmurate::registry::Registry;

/// Name of this crate's own program.
const MURMURATE: &str = "murmurate";

/// Runs message-passing policies on teams of robots.
#[derive(Parser)]
#[command(
    name = MURMURATE,
    version,
    after_help = "Exit codes: 0 done; 1 the run, its output or a check failed; 2 a flag or a file is wrong, nothing \
                  was run; 101 a bug; 130 interrupted, results until then printed.\n\
                  Logs go to stderr; MURMURATE_LOG sets their level (error, warn, info, debug; by default warn for \
                  'host' and 'launch', else error)."
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    #[cfg(feature = "sim")]
    /// Runs episodes in one process, faster than real time, and prints success rate and makespan.
    Sim(Box<sim::Args>),
    #[cfg(feature = "sim")]
    /// Prints a preset mode as a deployment file, to be changed and run with `sim --deployment`.
    Deployment(deployment::Args),
    #[cfg(feature = "study")]
    /// Runs a whole study: the same policies in several columns of conditions, with a report.
    #[command(subcommand)]
    Study(study::Args),
    #[cfg(feature = "train")]
    /// Trains a policy.
    Train(Box<train::Args>),
    /// Examines policy files.
    #[command(subcommand)]
    Policy(policy::Args),
    /// Runs one host of a team in real time: what is started on a robot.
    Host(Box<host::Args>),
    #[cfg(feature = "sim")]
    /// Runs every process of a team on this machine, in real time, and prints the same table as `sim`.
    Launch(Box<launch::Args>),
    #[cfg(feature = "lab")]
    /// Runs any program in stations whose frames travel over the emulated radio channel, in real time.
    #[command(subcommand)]
    Lab(lab::Args),
    /// Looks at records, repairs, merges and exports them.
    #[cfg(feature = "sim")]
    #[command(subcommand)]
    Record(record::Args),
    /// Runs again what a record is of, a simulation or a host, and compares it to the bit.
    #[cfg(feature = "sim")]
    Replay(replay::Args),
    /// Checks that this machine is fit to be one host of a team, and says what to do where it is not.
    Doctor(Box<doctor::Args>),
    /// Engages a team's emergency stop, or takes it back with --rearm.
    Stop(stop::Args),
    #[cfg(feature = "watch")]
    /// Shows a running team on a page in the browser, with its emergency stop.
    Watch(watch::team::Args),
    /// Lets a team go on that was stopped and re-armed: the next episode begins.
    Resume(stop::ResumeArgs),
    /// Says where a robot stands whose pose has jumped, or whose odometry has begun anew.
    Place(place::Args),
    /// Makes the key that a team's messages are authenticated with.
    #[command(subcommand)]
    Key(key::Args),
    /// Checks a team file, or shows every value of it with its origin.
    #[command(subcommand)]
    Config(config::Args),
    #[cfg(feature = "completions")]
    /// Prints what a shell needs to complete commands and flags.
    Completions(shells::Completions),
    #[cfg(feature = "completions")]
    /// Prints the program's man page, or writes one for every command.
    Man(shells::Manual),
}

impl Command {
    /// Whether the command drives robots in real time.
    fn in_real_time(&self) -> bool {
        match self {
            Command::Host(_) => true,
            #[cfg(feature = "sim")]
            Command::Launch(_) => true,
            _ => false,
        }
    }
}

/// End of a command that was not refused: done, done with a failed check, or interrupted. It sets the exit code 0, 1 or
/// 130.
pub enum Ended {
    /// The command has done what was requested: exit code 0.
    Done,
    /// The command has done what was requested, and one of its checks has failed, such as one of `doctor`. The output
    /// says which. Exit code 1.
    Unfit,
    /// The user has interrupted the command by Ctrl-C; the results until then were printed. Exit code 130.
    Interrupted,
}

/// Error of a command, found before anything was run: a flag or a file is wrong. The text says which. Exit code 2.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct BadInput(pub String);

/// Returns [`BadInput`] with this text as an error.
fn bad<T>(why: String) -> anyhow::Result<T> {
    Err(BadInput(why).into())
}

/// Starts logging to stderr. `wanted` is a level, or levels of modules as in `warn,murmurate::net=debug`. With `notes`,
/// warnings are also collected for the findings of `doctor`.
fn log(wanted: &str, notes: bool) -> Result<(), String> {
    // Without this check, the parser would take a misspelt level for a module's name.
    let odd = wanted.split(',').find(|part| !part.contains('=') && part.trim().parse::<LevelFilter>().is_err());
    if let Some(odd) = odd {
        return Err(format!("'{odd}' is no level; there are off, error, warn, info, debug and trace"));
    }
    let targets: Targets = wanted.parse().map_err(|error| format!("'{wanted}': {error}"))?;
    let (registry, coloured) = (tracing_subscriber::registry(), output::colour());
    if notes {
        let lines = tracing_subscriber::fmt::layer()
            .with_timer(output::Stamp)
            .with_writer(|| output::LogLines)
            .with_ansi(coloured);
        let notes = doctor::Notes.with_filter(doctor::Warnings);
        registry.with(lines.with_filter(targets)).with(notes).init();
    } else {
        // A single filter for all is the cheapest.
        let lines = tracing_subscriber::fmt::layer()
            .with_timer(output::Stamp)
            .with_writer(|| output::LogLines)
            .with_ansi(coloured);
        #[cfg(feature = "record")]
        let registry = registry.with(recording::log::Lines);
        registry.with(targets).with(lines).init();
    }
    Ok(())
}

/// Runs `murmurate sim` with these arguments (without the program's name), and returns its results as JSON without
/// printing them. Ends early once `stop` is set. An error about a flag or a file is a `BadInput`.
#[cfg(feature = "sim")]
pub fn sim_results(arguments: &[String], registry: &Registry, stop: &AtomicBool) -> anyhow::Result<String> {
    sim::results_of(arguments, registry, stop)
}

/// Sets the delay and loss of messages in the training conditions `conditions` to those of a medium, for a team of
/// `robots` robots. `radio` is a preset or a radio file, as for `murmurate train --radio`. An error about it is a
/// `BadInput` that begins with `argument`, the name of the caller's argument.
#[cfg(feature = "train")]
pub fn with_radio(
    argument: &str,
    radio: &str,
    robots: usize,
    conditions: &mut murmurate_train::config::Conditions,
) -> anyhow::Result<()> {
    train::with_radio(argument, radio, robots, conditions)
}

/// File name of the program that runs: `murmurate`, or that of another crate's program that uses this one.
static NAME: OnceLock<String> = OnceLock::new();

/// Words of the command that starts this program, if it runs within another one, such as a Python interpreter.
static STARTED_BY: OnceLock<Vec<OsString>> = OnceLock::new();

/// Returns the words of the command that starts this program again, to which arguments are added.
#[cfg(any(feature = "sim", feature = "lab"))]
fn this_program() -> anyhow::Result<Vec<OsString>> {
    match STARTED_BY.get() {
        Some(words) => Ok(words.clone()),
        None => {
            let program = std::env::current_exe().context("cannot find this program to start it again")?;
            Ok(vec![program.into()])
        }
    }
}

/// Returns the registry of the program: the parts of the library, of ROS 2 and of Zenoh. Another program adds its own
/// parts to it.
pub fn registry() -> Registry {
    murmurate_ros2::add(Registry::builtin()).with_transport(murmurate_zenoh::ENTRY).of_program()
}

/// Runs the command that the arguments of this process name, with the parts (scenarios, policies and so on) of the
/// registry. Returns the exit code.
pub fn main(registry: &Registry) -> ExitCode {
    run_command(registry, &std::env::args_os().collect::<Vec<_>>())
}

/// Runs the command in `arguments` (without the program's name) with the parts of the registry, and returns the exit
/// code. It is for a program that runs within another one, such as a Python interpreter; `started_by` are the words of
/// the command that starts this program. It must be called at most once in a process.
pub fn main_within(registry: &Registry, started_by: Vec<OsString>, arguments: Vec<OsString>) -> ExitCode {
    // A second call would be an error of its caller; the words are the same then.
    let _ = STARTED_BY.set(started_by);
    let name = OsString::from(MURMURATE);
    run_command(registry, &[vec![name], arguments].concat())
}

fn run_command(registry: &Registry, arguments: &[OsString]) -> ExitCode {
    let started = arguments.first().map(Path::new).and_then(Path::file_name).and_then(OsStr::to_str);
    // A second call, which is an error of its caller, has the same name.
    let _ = NAME.set(started.unwrap_or(MURMURATE).to_owned());
    // The DDS process of a ROS 2 driver or source, which this program starts itself.
    #[cfg(feature = "ros2")]
    if arguments.get(1).is_some_and(|word| word == murmurate_ros2::SUBCOMMAND) {
        return murmurate_ros2::node::run();
    }
    let cli = match parse(registry, arguments) {
        Ok(cli) => cli,
        Err(error) => return refuse(&error),
    };
    let real_time = cli.command.in_real_time();
    let waits_for_nobody = real_time || matches!(cli.command, Command::Stop(_));
    if waits_for_nobody && let Err(why) = output::open_log_lane() {
        output::talk(&format!("error: cannot start a thread to write the log: {why}"));
        return ExitCode::from(1);
    }
    // Warnings are shown, since the operator of a robot has to see what its guard does.
    let notes = matches!(cli.command, Command::Doctor(_));
    let level = match (real_time, notes) {
        // Zenoh's library warns of every attempt to reach a router; the transport says it once.
        (true, _) => "warn,zenoh=error",
        (false, true) => doctor::LEVEL,
        (false, false) => "error",
    };
    if let Err(why) = log(std::env::var("MURMURATE_LOG").as_deref().unwrap_or(level), notes) {
        output::talk(&format!("error: MURMURATE_LOG: {why}"));
        output::flush_log();
        return ExitCode::from(2);
    }
    let status = exit_code(run(cli.command, registry));
    output::flush_log();
    status
}

/// Returns the definition of the command line: all commands and flags, with the names of the registry's entries as
/// values.
fn command(registry: &Registry) -> clap::Command {
    names::rename(names::add(Cli::command(), registry), own_name())
}

fn parse(registry: &Registry, arguments: &[OsString]) -> Result<Cli, clap::Error> {
    let mut command = command(registry);
    let found = command.try_get_matches_from_mut(arguments)?;
    Cli::from_arg_matches(&found).map_err(|error| error.format(&mut command))
}

fn run(command: Command, registry: &Registry) -> anyhow::Result<Ended> {
    match command {
        #[cfg(feature = "sim")]
        Command::Sim(args) => sim::run(&args, registry),
        #[cfg(feature = "sim")]
        Command::Deployment(args) => deployment::run(&args),
        #[cfg(feature = "study")]
        Command::Study(args) => study::run(&args, registry),
        #[cfg(feature = "train")]
        Command::Train(args) => train::run(&args, registry),
        Command::Policy(args) => policy::run(&args, registry),
        Command::Host(args) => host::run(&args, registry),
        #[cfg(feature = "sim")]
        Command::Launch(args) => launch::run(&args, registry),
        #[cfg(feature = "lab")]
        Command::Lab(args) => lab::run(&args),
        #[cfg(feature = "sim")]
        Command::Record(args) => record::run(&args),
        #[cfg(feature = "sim")]
        Command::Replay(args) => replay::run(&args, registry),
        Command::Doctor(args) => doctor::run(&args, registry),
        Command::Stop(args) => stop::run(&args, registry),
        #[cfg(feature = "watch")]
        Command::Watch(args) => watch::team::run(&args, registry),
        Command::Resume(args) => stop::resume(&args, registry),
        Command::Place(args) => place::run(&args, registry),
        Command::Key(args) => key::run(&args),
        Command::Config(args) => config::run(&args, registry),
        #[cfg(feature = "completions")]
        Command::Completions(args) => shells::complete(&args, registry),
        #[cfg(feature = "completions")]
        Command::Man(args) => shells::manual(&args, registry),
    }
}

/// Prints the error of a command, and returns its exit code.
fn exit_code(ended: anyhow::Result<Ended>) -> ExitCode {
    match ended {
        Ok(Ended::Done) => ExitCode::SUCCESS,
        Ok(Ended::Unfit) => ExitCode::from(1),
        Ok(Ended::Interrupted) => ExitCode::from(130),
        Err(error) => {
            output::talk(&format!("error: {error:#}"));
            let wrong = error.downcast_ref().is_some_and(live::OpenError::is_wrong_input)
                || matches!(error.downcast_ref(), Some(LinkError::Wrong(_)));
            ExitCode::from(if wrong || error.is::<BadInput>() { 2 } else { 1 })
        }
    }
}

/// Returns the name of the running program, for texts that name a command: `murmurate`, or the file name of another
/// crate's program that uses this one.
fn own_name() -> &'static str {
    NAME.get().map_or(MURMURATE, |name| name)
}

/// Handles an error of the command-line parser: prints help and version as they are, and other errors as one line.
/// Returns the exit code.
fn refuse(error: &clap::Error) -> ExitCode {
    if !error.use_stderr() {
        // Help was requested, so it is output; a pipe closed by its reader is not an error.
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    if let Some(why) = features::missing(error) {
        output::talk(&why);
        return ExitCode::from(2);
    }
    let text = error.render().to_string();
    if error.kind() == clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        output::talk_lines(text.trim_end());
        return ExitCode::from(2);
    }
    let said: Vec<&str> = text
        .lines()
        .map(str::trim)
        .take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more information"))
        .filter(|line| !line.is_empty())
        .collect();
    output::talk(&format!("{} (see '{} --help')", said.join(" ").replace(" tip: ", "; tip: "), own_name()));
    ExitCode::from(2)
}
