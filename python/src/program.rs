//! The program and its simulations, called from Python.

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use murmurate_cli::BadInput;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

/// Time between two checks for a signal such as Ctrl-C.
const SIGNALS: Duration = Duration::from_millis(50);

/// Runs `murmurate sim` with these arguments (those after `sim`) and returns its results as JSON. A wrong flag or file
/// is a `ValueError`, a failure a `RuntimeError`; Ctrl-C ends the run with `KeyboardInterrupt`. `started_by` are the
/// words of the command that starts the program, which checks the graphs of a policy.
#[pyfunction]
pub fn sim_json(py: Python<'_>, started_by: Vec<OsString>, arguments: Vec<String>) -> PyResult<String> {
    let stop = AtomicBool::new(false);
    let interrupted = std::cell::RefCell::new(None);
    let ended = std::thread::scope(|scope| {
        let caller = std::thread::current();
        let (arguments, stop) = (&arguments, &stop);
        let work = move || {
            let results = murmurate_cli::sim_results(started_by, arguments, crate::registry(), stop);
            caller.unpark();
            results
        };
        let worker = std::thread::Builder::new().name("sim".to_owned()).spawn_scoped(scope, work)?;
        while !worker.is_finished() {
            py.detach(|| std::thread::park_timeout(SIGNALS));
            if let Err(error) = py.check_signals() {
                stop.store(true, Ordering::Relaxed);
                interrupted.borrow_mut().get_or_insert(error);
            }
        }
        Ok::<_, std::io::Error>(py.detach(|| worker.join()))
    })?;
    if let Some(error) = interrupted.into_inner() {
        return Err(error);
    }
    let results = ended.map_err(|_| PyRuntimeError::new_err("a simulation has panicked: a defect of murmurate"))?;
    results.map_err(exception)
}

/// Converts an error of the program to an exception of Python: a `ValueError` for a wrong flag or file, else a
/// `RuntimeError`.
pub fn exception(error: anyhow::Error) -> PyErr {
    match error.downcast_ref::<BadInput>() {
        Some(bad) => PyValueError::new_err(bad.0.clone()),
        None => PyRuntimeError::new_err(format!("{error:#}")),
    }
}

/// Runs the program `murmurate` with these arguments, which do not contain its name, and returns its exit code.
/// `started_by` are the words of the command that starts the program, such as `python -m murmurate`, with which
/// `launch` starts the processes of a team.
#[pyfunction]
pub fn run_program(py: Python<'_>, started_by: Vec<OsString>, arguments: Vec<OsString>) -> u8 {
    let code = py.detach(|| murmurate_cli::main_within(crate::registry(), started_by, arguments));
    // An exit code shows its number only to the operating system and in its text.
    (0..=u8::MAX).find(|number| ExitCode::from(*number) == code).unwrap_or(1)
}
