//! Murmurate's program with the additional parts of this crate.

use std::process::ExitCode;

fn main() -> ExitCode {
    murmurate_cli::main(&stranger::registry())
}
