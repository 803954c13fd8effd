//! Murmurate's program with the additional parts of this crate.

use std::process::ExitCode;

fn main() -> ExitCode {
    murmurate::program::main(&stranger::registry())
}
