//! The program `murmurate`: simulations, teams on one machine, records, studies, training, the lab and the live page,
//! beside the commands of a robot (`crates/robot`). A command is a file here, and a line in `program`.

// Doc comments of flags are help texts for a terminal, where [m] is a unit and <FILE> a name.
#![allow(rustdoc::broken_intra_doc_links, rustdoc::invalid_html_tags)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod conditions;
mod deployment;
mod drive;
mod export;
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
mod task;
mod train;
mod watch;

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use murmurate::registry::Registry;
use murmurate_robot::command::Command;
use murmurate_robot::{Logging, Program, build};

pub use murmurate_robot::{BadInput, Ended, registry};

/// The program. Its help lists the commands in this order.
fn program() -> Program {
    let policies = [
        Command::of("sim", sim::run),
        Command::of("deployment", deployment::run),
        Command::with_subcommands("study", study::run),
        Command::of("train", train::run),
        Command::with_subcommands("task", task::run),
        Command::with_subcommands("export", export::run),
    ];
    let teams = [
        Command::of("launch", launch::run).logging(Logging::RealTime),
        #[cfg(feature = "lab")]
        Command::with_subcommands("lab", lab::run),
        Command::with_subcommands("record", record::run),
        Command::of("replay", replay::run),
        Command::of("watch", watch::team::run),
        Command::of("completions", shells::complete),
        Command::of("man", shells::manual),
    ];
    let commands = policies.into_iter().chain(murmurate_robot::program().commands).chain(teams);
    Program { commands: commands.collect(), parts: features::PARTS, unknown: None }
}

/// Digests of the sources of all packages of this program.
const DIGESTS: &[&str] = &[
    murmurate::DIGEST,
    murmurate_crazyflie::DIGEST,
    murmurate_devices::DIGEST,
    murmurate_import::DIGEST,
    murmurate_report::DIGEST,
    #[cfg(feature = "lab")]
    murmurate_lab::DIGEST,
    murmurate_launch::DIGEST,
    murmurate_mavlink::DIGEST,
    murmurate_onnx::DIGEST,
    murmurate_record::DIGEST,
    murmurate_replay::DIGEST,
    murmurate_robot::DIGEST,
    murmurate_ros2::DIGEST,
    murmurate_study::DIGEST,
    murmurate_tasks::DIGEST,
    murmurate_train::DIGEST,
    murmurate_view::DIGEST,
    murmurate_wifi::DIGEST,
    murmurate_zenoh::DIGEST,
    env!("SOURCE_DIGEST"),
];

/// Runs `murmurate sim` with these arguments (without the program's name), and returns its results as JSON without
/// printing them. Ends early once `stop` is set. `started_by` are the words of the command that starts this program,
/// which checks the graphs of a policy. An error about a flag or a file is a `BadInput`.
pub fn sim_results(
    started_by: Vec<OsString>,
    arguments: &[String],
    registry: &Registry,
    stop: &AtomicBool,
) -> anyhow::Result<String> {
    murmurate_robot::runs_within(started_by);
    build::set(DIGESTS);
    sim::results_of(arguments, registry, stop)
}

/// Sets the delay and loss of messages in the training conditions `conditions` to those of a medium, for the robots of
/// `scenario`. `radio` is a preset or a radio file, as for `murmurate train --radio`. An error about it is a `BadInput`
/// that begins with `argument`, the name of the caller's argument.
pub fn with_radio(
    argument: &str,
    radio: &str,
    scenario: &dyn murmurate::scenario::Scenario,
    conditions: &mut murmurate_train::config::Conditions,
) -> anyhow::Result<()> {
    train::with_radio(argument, radio, scenario, conditions)
}

/// Runs the command that the arguments of this process name, with the parts (scenarios, policies and so on) of the
/// registry. Returns the exit code.
pub fn main(registry: &Registry) -> ExitCode {
    build::set(DIGESTS);
    murmurate_robot::main(&program(), registry)
}

/// Runs the command in `arguments` (without the program's name) with the parts of the registry, and returns the exit
/// code. It is for a program that runs within another one, such as a Python interpreter; `started_by` are the words of
/// the command that starts this program. It must be called at most once in a process.
pub fn main_within(registry: &Registry, started_by: Vec<OsString>, arguments: Vec<OsString>) -> ExitCode {
    build::set(DIGESTS);
    murmurate_robot::main_within(&program(), registry, started_by, arguments)
}
