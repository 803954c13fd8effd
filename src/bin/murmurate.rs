//! The program `murmurate`: the library's command line, and an allocator for it.

use std::process::ExitCode;

use murmurate::program;
use murmurate::registry::Registry;

#[cfg(feature = "mimalloc")]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    program::main(&Registry::builtin())
}
