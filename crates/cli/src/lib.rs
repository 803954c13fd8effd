//! The program `murmurate`: simulations, teams on one machine, records, studies, training, the lab and the live page,
//! beside the commands of a robot (`crates/robot`). A command is a file here, and a line in `Command`.

// Doc comments of flags are help texts for a terminal, where [m] is a unit and <FILE> a name.
#![allow(rustdoc::broken_intra_doc_links, rustdoc::invalid_html_tags)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod conditions;
mod deployment;
mod drive;
mod features;
mod jobs;
#[cfg(feature = "lab")]
mod lab;
mod launch;
mod picture;
mod progress;
mod record;
mod recording;
mod replay;
mod shells;
mod sim;
mod size;
mod study;
mod train;
mod watch;

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use clap::Subcommand;
use murmurate::registry::Registry;
use murmurate_robot::{Commands, Logging, build};

pub use murmurate_robot::{BadInput, Ended, registry};

/// Commands of the program.
#[derive(Subcommand)]
enum Command {
    /// Runs episodes in one process, faster than real time, and prints success rate and makespan.
    Sim(Box<sim::Args>),
    /// Prints a preset mode as a deployment file, to be changed and run with `sim --deployment`.
    Deployment(deployment::Args),
    /// Runs a whole study: the same policies in several columns of conditions, with a report.
    #[command(subcommand)]
    Study(study::Args),
    /// Trains a policy.
    Train(Box<train::Args>),
    #[command(flatten)]
    Robot(murmurate_robot::Command),
    /// Runs every process of a team on this machine, in real time, and prints the same table as `sim`.
    Launch(Box<launch::Args>),
    #[cfg(feature = "lab")]
    /// Runs any program in stations whose frames travel over the emulated radio channel, in real time.
    #[command(subcommand)]
    Lab(lab::Args),
    /// Looks at records, repairs, merges and exports them.
    #[command(subcommand)]
    Record(record::Args),
    /// Replays records of simulations and of hosts, and checks that every bit is the same.
    Replay(replay::Args),
    /// Shows a running team on a page in the browser, with its emergency stop.
    Watch(watch::team::Args),
    /// Prints what a shell needs to complete commands and flags.
    Completions(shells::Completions),
    /// Prints the program's man page, or writes one for every command.
    Man(shells::Manual),
}

impl Commands for Command {
    const PARTS: &'static [murmurate_robot::features::Part] = features::PARTS;

    fn logging(&self) -> Logging {
        match self {
            Command::Robot(command) => command.logging(),
            Command::Launch(_) => Logging::RealTime,
            _ => Logging::Errors,
        }
    }

    fn run(self, registry: &Registry) -> anyhow::Result<Ended> {
        match self {
            Command::Sim(args) => sim::run(&args, registry),
            Command::Deployment(args) => deployment::run(&args),
            Command::Study(args) => study::run(&args, registry),
            Command::Train(args) => train::run(&args, registry),
            Command::Robot(command) => command.run(registry),
            Command::Launch(args) => launch::run(&args, registry),
            #[cfg(feature = "lab")]
            Command::Lab(args) => lab::run(&args),
            Command::Record(args) => record::run(&args),
            Command::Replay(args) => replay::run(&args, registry),
            Command::Watch(args) => watch::team::run(&args, registry),
            Command::Completions(args) => shells::complete(&args, registry),
            Command::Man(args) => shells::manual(&args, registry),
        }
    }
}

/// Digests of the sources of all packages of this program.
const DIGESTS: &[&str] = &[
    murmurate::DIGEST,
    murmurate_devices::DIGEST,
    murmurate_report::DIGEST,
    #[cfg(feature = "lab")]
    murmurate_lab::DIGEST,
    murmurate_launch::DIGEST,
    murmurate_record::DIGEST,
    murmurate_replay::DIGEST,
    murmurate_robot::DIGEST,
    murmurate_ros2::DIGEST,
    murmurate_study::DIGEST,
    murmurate_train::DIGEST,
    murmurate_view::DIGEST,
    murmurate_zenoh::DIGEST,
    env!("SOURCE_DIGEST"),
];

/// Runs `murmurate sim` with these arguments (without the program's name), and returns its results as JSON without
/// printing them. Ends early once `stop` is set. An error about a flag or a file is a `BadInput`.
pub fn sim_results(arguments: &[String], registry: &Registry, stop: &AtomicBool) -> anyhow::Result<String> {
    build::set(DIGESTS);
    sim::results_of(arguments, registry, stop)
}

/// Sets the delay and loss of messages in the training conditions `conditions` to those of a medium, for a team of
/// `robots` robots. `radio` is a preset or a radio file, as for `murmurate train --radio`. An error about it is a
/// `BadInput` that begins with `argument`, the name of the caller's argument.
pub fn with_radio(
    argument: &str,
    radio: &str,
    robots: usize,
    conditions: &mut murmurate_train::config::Conditions,
) -> anyhow::Result<()> {
    train::with_radio(argument, radio, robots, conditions)
}

/// Runs the command that the arguments of this process name, with the parts (scenarios, policies and so on) of the
/// registry. Returns the exit code.
pub fn main(registry: &Registry) -> ExitCode {
    build::set(DIGESTS);
    murmurate_robot::main::<Command>(registry)
}

/// Runs the command in `arguments` (without the program's name) with the parts of the registry, and returns the exit
/// code. It is for a program that runs within another one, such as a Python interpreter; `started_by` are the words of
/// the command that starts this program. It must be called at most once in a process.
pub fn main_within(registry: &Registry, started_by: Vec<OsString>, arguments: Vec<OsString>) -> ExitCode {
    build::set(DIGESTS);
    murmurate_robot::main_within::<Command>(registry, started_by, arguments)
}
