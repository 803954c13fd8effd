//! The program of a robot: its commands, and nothing else.

use std::process::ExitCode;

fn main() -> ExitCode {
    murmurate_robot::main(&murmurate_robot::program(), &murmurate_robot::registry())
}
