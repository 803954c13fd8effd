//! The program and its simulations, called from Python.

use std::ffi::OsString;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use murmurate::registry::Registry;
use murmurate::scenario::{ScenarioError, Settings, TaskFile, contract};
use murmurate_cli::BadInput;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::task::PythonTask;

/// Results of a simulation as JSON, and for each judged episode the index of its repeat, its own, and its return.
type Judged = (String, Vec<(u32, u32, f64)>);

/// Time between two checks for a signal such as Ctrl-C.
const SIGNALS: Duration = Duration::from_millis(50);

/// Runs `murmurate sim` with these arguments (those after `sim`) and returns its results as JSON. A wrong flag or file
/// is a `ValueError`, a failure a `RuntimeError`; Ctrl-C ends the run with `KeyboardInterrupt`. `started_by` are the
/// words of the command that starts the program, which checks the graphs of a policy.
#[pyfunction]
pub fn sim_json(py: Python<'_>, started_by: Vec<OsString>, arguments: Vec<String>) -> PyResult<String> {
    simulated(py, started_by, &arguments, (crate::registry(), &|| false))
}

/// Runs `murmurate sim` with these arguments (those after `sim`, without a scenario) and a task in Python. Returns its
/// results as JSON, and the sums of the rewards of each episode, with the indices of its repeat and of itself.
#[pyfunction]
pub fn sim_task_json(
    py: Python<'_>,
    started_by: Vec<OsString>,
    arguments: Vec<String>,
    task: &Bound<'_, PyAny>,
) -> PyResult<Judged> {
    let (task, file) = sound(task)?;
    let name = file.name().to_owned();
    let registry = crate::registry().clone().with_task(&name, file);
    let arguments: Vec<String> = ["--scenario".to_owned(), name].into_iter().chain(arguments).collect();
    let results = simulated(py, started_by, &arguments, (&registry, &|| task.has_failed()));
    // What a method has raised is the cause of all else.
    task.take_failure().map_or(Ok(()), Err)?;
    let returns = task.returns().into_iter().map(|((repeat, episode), sum)| (repeat, episode, sum));
    Ok((results?, returns.collect()))
}

/// Runs the contract tests of scenarios for a task in Python. Returns the first broken promise; `None` if all hold.
#[pyfunction]
pub fn broken_contract(py: Python<'_>, task: &Bound<'_, PyAny>) -> PyResult<Option<String>> {
    let (task, file) = sound(task)?;
    let checked = py.detach(|| contract::check_file(&file));
    task.take_failure().map_or(Ok(()), Err)?;
    Ok(checked.err())
}

/// Returns a task in Python and its task file, of which a scenario can be made for the default team.
fn sound(task: &Bound<'_, PyAny>) -> PyResult<(Arc<PythonTask>, TaskFile)> {
    let task = PythonTask::of(task)?.ok_or_else(|| PyValueError::new_err("scenario: it is no task in Python"))?;
    let file = task.file()?;
    match file.scenario(&Settings::default()) {
        Ok(_) => Ok((task, file)),
        Err(ScenarioError::TaskFile { error, .. }) => Err(task.wrong(error)),
        Err(error) => Err(PyValueError::new_err(error.to_string())),
    }
}

/// Runs `murmurate sim` with the parts of a registry until it ends, Ctrl-C, or `has_failed` returns true.
fn simulated(
    py: Python<'_>,
    started_by: Vec<OsString>,
    arguments: &[String],
    (registry, has_failed): (&Registry, &dyn Fn() -> bool),
) -> PyResult<String> {
    let stop = AtomicBool::new(false);
    let interrupted = std::cell::RefCell::new(None);
    let ended = std::thread::scope(|scope| {
        let caller = std::thread::current();
        let stop = &stop;
        let work = move || {
            let results = murmurate_cli::sim_results(started_by, arguments, registry, stop);
            caller.unpark();
            results
        };
        let worker = std::thread::Builder::new().name("sim".to_owned()).spawn_scoped(scope, work)?;
        while !worker.is_finished() {
            py.detach(|| std::thread::park_timeout(SIGNALS));
            if has_failed() {
                stop.store(true, Ordering::Relaxed);
            }
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
