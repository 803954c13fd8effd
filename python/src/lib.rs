//! The Python module `murmurate._murmurate`: Murmurate's environments on numpy buffers, its simulations and its
//! program. The package around it is in `murmurate/`. A crate with scenarios of its own fills a module with [`fill`].

mod arguments;
mod arrays;
mod channel;
mod memory;
mod picture;
mod program;
mod task;
mod tasked;
mod turn;
mod vec_env;

use std::sync::OnceLock;

use murmurate::registry::Registry;
use pyo3::prelude::*;

/// Registry of this process, in which the module's classes and functions look up names.
static REGISTRY: OnceLock<Registry> = OnceLock::new();

/// Adds the classes and functions of Murmurate to a Python module. They find scenarios, policies and other parts by
/// name in `registry`.
///
/// # Errors
/// An exception of Python while the module is filled.
///
/// # Panics
/// If the process has filled a module before.
pub fn fill(module: &Bound<'_, PyModule>, registry: Registry) -> PyResult<()> {
    assert!(REGISTRY.set(registry).is_ok(), "a process has one module of murmurate");
    module.add_class::<vec_env::VecEnv>()?;
    module.add_class::<channel::Channel>()?;
    module.add_function(wrap_pyfunction!(program::sim_json, module)?)?;
    module.add_function(wrap_pyfunction!(program::sim_task_json, module)?)?;
    module.add_function(wrap_pyfunction!(program::broken_contract, module)?)?;
    module.add_function(wrap_pyfunction!(program::run_program, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}

/// Returns the registry that the module was filled with.
fn registry() -> &'static Registry {
    REGISTRY.get().expect("the module was filled before anything in it is called")
}

#[cfg(feature = "module")]
#[pymodule]
fn _murmurate(module: &Bound<'_, PyModule>) -> PyResult<()> {
    fill(module, murmurate_cli::registry())
}
