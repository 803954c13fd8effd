//! Turns of threads: who works on an object of Python keeps out others meanwhile.

use std::sync::atomic::{AtomicBool, Ordering};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;

use crate::arguments::wrong;

/// Mark that a thread works on an object; dropping it takes it away.
pub struct Turn<'a>(&'a AtomicBool);

impl Turn<'_> {
    /// Keeps out other threads until the result is dropped, by the mark `busy` of an object of the kind `of`. If one works
    /// on it, that is an error of the method `what`.
    pub fn of<'a>(busy: &'a AtomicBool, (what, of): (&str, &str)) -> PyResult<Turn<'a>> {
        if busy.swap(true, Ordering::Acquire) {
            let why = format!("another thread is in a step, a reset or a state of this {of}; give each thread its own");
            return Err(PyRuntimeError::new_err(format!("{what}: {why}")));
        }
        Ok(Turn(busy))
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Release);
    }
}

/// Returns the bytes of a state.
pub fn bytes_of(state: &Bound<'_, PyAny>) -> PyResult<PyBackedBytes> {
    state.extract().map_err(|_| wrong("state", format!("a {} is not what state() returns", state.get_type())))
}
