//! The program `murmurate`: the command line of `crates/cli`, and an allocator for it.

use std::process::ExitCode;

#[cfg(all(feature = "mimalloc", target_os = "linux"))]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    murmurate_cli::main(&murmurate_cli::registry())
}
