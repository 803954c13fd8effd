//! The commands of a robot (`host`, `doctor`, `stop` and so on), and what all commands of the program have in common:
//! output, team files, keys, files that get their name once they are complete, exit codes. Its own program has these
//! commands alone; `crates/cli` adds all others.
//!
//! Exit codes: 0 done; 1 the run, one of its processes, its output or a check of `doctor` failed; 2 a flag or a file is
//! wrong, and nothing was run; 101 a bug (a panic); 130 interrupted, with the results until then printed.

// Doc comments of flags are help texts for a terminal, where [m] is a unit and <FILE> a name.
#![allow(rustdoc::broken_intra_doc_links, rustdoc::invalid_html_tags)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

pub mod background_writer;
pub mod build;
mod checks;
mod config;
pub mod destination;
mod doctor;
pub mod features;
pub mod host;
pub mod key;
mod logging;
#[cfg(feature = "watch")]
pub mod metrics;
mod names;
mod outlets;
pub mod output;
pub mod paths;
mod place;
pub mod policy;
#[cfg_attr(not(feature = "record"), path = "unrecorded.rs")]
pub mod recording;
pub mod signals;
mod stop;
pub mod team;
pub mod temporary;
pub mod whole_file;

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::ExitCode;
use std::sync::OnceLock;

use anyhow::Context;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use murmurate::live;
use murmurate::live::links::LinkError;
use murmurate::registry::Registry;

pub use self::logging::Logging;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Name of this project's own program.
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
struct Cli<C: Subcommand> {
    #[command(subcommand)]
    command: C,
}

/// Commands of a program.
pub trait Commands: Subcommand {
    /// Parts that the program can be built without.
    const PARTS: &'static [features::Part];

    /// Returns the level and the way of the command's log.
    fn logging(&self) -> Logging;

    /// Runs the command with the parts (scenarios, policies and so on) of the registry.
    fn run(self, registry: &Registry) -> anyhow::Result<Ended>;
}

/// Commands of a robot.
#[derive(Subcommand)]
pub enum Command {
    /// Examines policy files.
    #[command(subcommand)]
    Policy(policy::Args),
    /// Runs one host of a team in real time: what is started on a robot.
    Host(Box<host::Args>),
    /// Checks that this machine is fit to be one host of a team, and says what to do where it is not.
    Doctor(Box<doctor::Args>),
    /// Engages a team's emergency stop, or takes it back with --rearm.
    Stop(stop::Args),
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
}

impl Commands for Command {
    const PARTS: &'static [features::Part] = features::OF_ROBOT;

    fn logging(&self) -> Logging {
        match self {
            Command::Host(_) => Logging::RealTime,
            Command::Stop(_) => Logging::Urgent,
            Command::Doctor(_) => Logging::Findings,
            _ => Logging::Errors,
        }
    }

    fn run(self, registry: &Registry) -> anyhow::Result<Ended> {
        match self {
            Command::Policy(args) => policy::run(&args, registry),
            Command::Host(args) => host::run(&args, registry),
            Command::Doctor(args) => doctor::run(&args, registry),
            Command::Stop(args) => stop::run(&args, registry),
            Command::Resume(args) => stop::resume(&args, registry),
            Command::Place(args) => place::run(&args, registry),
            Command::Key(args) => key::run(&args),
            Command::Config(args) => config::run(&args, registry),
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
pub fn bad<T>(why: String) -> anyhow::Result<T> {
    Err(BadInput(why).into())
}

/// File name of the program that runs: `murmurate`, or that of another crate's program that uses this one.
static NAME: OnceLock<String> = OnceLock::new();

/// Words of the command that starts this program, if it runs within another one, such as a Python interpreter.
static STARTED_BY: OnceLock<Vec<OsString>> = OnceLock::new();

/// Returns the words of the command that starts this program again, to which arguments are added.
pub fn this_program() -> anyhow::Result<Vec<OsString>> {
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
    let registry = murmurate_ros2::add(murmurate_devices::add(Registry::builtin()));
    registry.with_transport(murmurate_zenoh::ENTRY).of_program()
}

/// Runs the command among `C` that the arguments of this process name, with the parts (scenarios, policies and so on)
/// of the registry. Returns the exit code.
pub fn main<C: Commands>(registry: &Registry) -> ExitCode {
    run_command::<C>(registry, &std::env::args_os().collect::<Vec<_>>())
}

/// Runs the command in `arguments` (without the program's name) with the parts of the registry, and returns the exit
/// code. It is for a program that runs within another one, such as a Python interpreter; `started_by` are the words of
/// the command that starts this program. It must be called at most once in a process.
pub fn main_within<C: Commands>(registry: &Registry, started_by: Vec<OsString>, arguments: Vec<OsString>) -> ExitCode {
    // A second call would be an error of its caller; the words are the same then.
    let _ = STARTED_BY.set(started_by);
    let name = OsString::from(MURMURATE);
    run_command::<C>(registry, &[vec![name], arguments].concat())
}

fn run_command<C: Commands>(registry: &Registry, arguments: &[OsString]) -> ExitCode {
    let started = arguments.first().map(Path::new).and_then(Path::file_name).and_then(OsStr::to_str);
    // A second call, which is an error of its caller, has the same name.
    let _ = NAME.set(started.unwrap_or(MURMURATE).to_owned());
    // The DDS process of a ROS 2 driver or source, which this program starts itself.
    #[cfg(feature = "ros2")]
    if arguments.get(1).is_some_and(|word| word == murmurate_ros2::SUBCOMMAND) {
        return murmurate_ros2::node::run();
    }
    let mut definition = command::<C>(registry);
    let found = definition.try_get_matches_from_mut(arguments);
    let found = found.and_then(|found| Cli::from_arg_matches(&found).map_err(|error| error.format(&mut definition)));
    let Cli { command }: Cli<C> = match found {
        Ok(cli) => cli,
        Err(error) => return refuse(&error, C::PARTS),
    };
    let logging = command.logging();
    if logging.is_asynchronous()
        && let Err(why) = output::open_log_lane()
    {
        output::talk(&format!("error: cannot start a thread to write the log: {why}"));
        return ExitCode::from(1);
    }
    if let Err(why) = logging.start() {
        output::talk(&format!("error: MURMURATE_LOG: {why}"));
        output::flush_log();
        return ExitCode::from(2);
    }
    let status = exit_code(command.run(registry));
    output::flush_log();
    status
}

/// Returns the definition of a command line: all commands and flags of `C`, with the names of the registry's entries as
/// values.
pub fn command<C: Commands>(registry: &Registry) -> clap::Command {
    names::rename(names::add(Cli::<C>::command(), registry), own_name())
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
pub fn own_name() -> &'static str {
    NAME.get().map_or(MURMURATE, |name| name)
}

/// Handles an error of the command-line parser: prints help and version as they are, and other errors as one line.
/// Returns the exit code.
fn refuse(error: &clap::Error, parts: &[features::Part]) -> ExitCode {
    if !error.use_stderr() {
        // Help was requested, so it is output; a pipe closed by its reader is not an error.
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    if let Some(why) = features::missing(error, parts) {
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
