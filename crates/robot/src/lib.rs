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
pub mod command;
mod config;
mod cut;
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
use murmurate::live;
use murmurate::live::links::LinkError;
use murmurate::registry::Registry;

use self::command::{Command, Run};
pub use self::logging::Logging;

/// Digest of this package's sources. Packages with equal digests behave equally.
pub const DIGEST: &str = env!("SOURCE_DIGEST");

/// Name of this project's own program.
const MURMURATE: &str = "murmurate";

/// What the help says below the commands.
const AFTER_HELP: &str = "Exit codes: 0 done; 1 the run, its output or a check failed; 2 a flag or a file is wrong, \
    nothing was run; 101 a bug; 130 interrupted, results until then printed.\n\
    Logs go to stderr; MURMURATE_LOG sets their level (error, warn, info, debug; by default warn for 'host' and \
    'launch', else error).";

/// A program: its commands, and the optional parts of its build.
pub struct Program {
    /// All commands, in the order of the help.
    pub commands: Vec<Command>,
    /// Parts that the program can be built without.
    pub parts: &'static [features::Part],
    /// Advice on a command that the program does not know, if another program may have it.
    pub unknown: Option<&'static str>,
}

impl Program {
    /// Returns the definition of its command line: all commands and flags, with the names of the registry's entries as
    /// values.
    pub fn definition(&self, registry: &Registry) -> clap::Command {
        let all = clap::Command::new(MURMURATE)
            .version(env!("CARGO_PKG_VERSION"))
            .about("Runs message-passing policies on teams of robots")
            .after_help(AFTER_HELP)
            .subcommand_required(true)
            .arg_required_else_help(true)
            .subcommands(self.commands.iter().map(Command::definition));
        names::rename(names::add(all, registry), own_name())
    }

    /// Finds the command that the arguments name and reads its flags. Returns the function that runs it, and the level
    /// and the way of its log.
    fn read(&self, arguments: &[OsString], registry: &Registry) -> Result<(Run, Logging), clap::Error> {
        let mut definition = self.definition(registry);
        let found = definition.try_get_matches_from_mut(arguments)?;
        let (name, found) = found.subcommand().expect("the parser asks for a command");
        let command = self.commands.iter().find(|command| command.name() == name);
        command.expect("the parser knows these alone").read(found).map_err(|error| error.format(&mut definition))
    }
}

/// The program with the commands of a robot alone.
pub fn program() -> Program {
    let commands = vec![
        Command::with_subcommands("policy", policy::run),
        Command::of("host", host::run).logging(Logging::RealTime),
        Command::of("doctor", doctor::run).logging(Logging::Findings),
        Command::of("stop", stop::run).logging(Logging::Urgent),
        Command::of("resume", stop::resume),
        Command::of("place", place::run),
        Command::of("cut", cut::run).logging(Logging::Urgent),
        Command::with_subcommands("key", key::command::run),
        Command::with_subcommands("config", config::run),
    ];
    Program { commands, parts: features::OF_ROBOT, unknown: Some(features::WHOLE) }
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

/// Arguments of the command that runs, without the program's name.
static ARGUMENTS: OnceLock<Vec<OsString>> = OnceLock::new();

/// Returns the arguments of the command that runs, without the program's name.
pub fn own_arguments() -> Vec<OsString> {
    ARGUMENTS.get().cloned().unwrap_or_else(|| std::env::args_os().skip(1).collect())
}

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

/// Sets the words of the command that starts this program, for a program that runs within another one. The first call
/// counts.
pub fn runs_within(started_by: Vec<OsString>) {
    // A second call would be an error of its caller; the words are the same then.
    let _ = STARTED_BY.set(started_by);
}

/// Returns the registry of the program: the parts of the library, of MAVLink, of ROS 2, of Zenoh and of the library of
/// tasks.
/// Another program adds its own parts to it.
pub fn registry() -> Registry {
    let devices = murmurate_crazyflie::add(murmurate_mavlink::add(murmurate_devices::add(Registry::builtin())));
    let registry = murmurate_tasks::add(murmurate_ros2::add(devices));
    registry.with_transport(murmurate_zenoh::ENTRY).reading_tasks(read_task).of_program()
}

/// Returns the text of a task file.
fn read_task(path: &str) -> Result<String, String> {
    output::read_text(Path::new(path), "task file").map_err(|error| error.to_string())
}

/// Runs the command of the program that the arguments of this process name, with the parts (scenarios, policies and so
/// on) of the registry. Returns the exit code.
pub fn main(program: &Program, registry: &Registry) -> ExitCode {
    run_command(program, registry, &std::env::args_os().collect::<Vec<_>>())
}

/// Runs the command in `arguments` (without the program's name) with the parts of the registry, and returns the exit
/// code. It is for a program that runs within another one, such as a Python interpreter; `started_by` are the words of
/// the command that starts this program. It must be called at most once in a process.
pub fn main_within(
    program: &Program,
    registry: &Registry,
    started_by: Vec<OsString>,
    arguments: Vec<OsString>,
) -> ExitCode {
    runs_within(started_by);
    let name = OsString::from(MURMURATE);
    run_command(program, registry, &[vec![name], arguments].concat())
}

fn run_command(program: &Program, registry: &Registry, arguments: &[OsString]) -> ExitCode {
    let started = arguments.first().map(Path::new).and_then(Path::file_name).and_then(OsStr::to_str);
    // A second call, which is an error of its caller, has the same name.
    let _ = NAME.set(started.unwrap_or(MURMURATE).to_owned());
    let _ = ARGUMENTS.set(arguments.iter().skip(1).cloned().collect());
    // The DDS process of a ROS 2 driver or source, which this program starts itself.
    #[cfg(feature = "ros2")]
    if arguments.get(1).is_some_and(|word| word == murmurate_ros2::SUBCOMMAND) {
        return murmurate_ros2::node::run();
    }
    let (run, logging) = match program.read(arguments, registry) {
        Ok(read) => read,
        Err(error) => return refuse(&error, program, arguments),
    };
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
    let status = exit_code(run(registry));
    output::flush_log();
    status
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
fn refuse(error: &clap::Error, program: &Program, arguments: &[OsString]) -> ExitCode {
    if !error.use_stderr() {
        // Help was requested, so it is output; a pipe closed by its reader is not an error.
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    let unknown = || features::unknown(error, arguments.get(1)?, program);
    if let Some(why) = features::missing(error, program.parts).or_else(unknown) {
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
