//! Numpy arrays: those that the caller gives, and the buffers of environments, which the caller can change.

use murmurate_train::vector::Options;
use numpy::{
    Element, PyArray, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyReadwriteArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods, dtype,
};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use crate::arguments::wrong;

/// Shapes of the buffers of environments.
pub struct Shapes {
    pub obs: [usize; 3],
    pub rows: [usize; 2],
    pub environments: [usize; 1],
    pub edges: [usize; 3],
    pub said: [usize; 4],
    pub scan: [usize; 3],
}

impl Shapes {
    pub fn of(options: &Options) -> Shapes {
        let (n, lengths) = (options.environments, options.lengths());
        let (r, f, m) = (lengths.robots, lengths.observation, lengths.message);
        let hearing = if m > 0 { n } else { 0 };
        Shapes {
            obs: [n, r, f],
            rows: [n, r],
            environments: [n],
            edges: [hearing, r, r],
            said: [hearing, r, r, m],
            scan: [n, r, lengths.rays],
        }
    }
}

/// Makes an array of zeros. Without memory for it, it is the `MemoryError` of numpy.
pub fn zeros<T: Element>(py: Python<'_>, shape: &[usize]) -> PyResult<Py<PyArrayDyn<T>>> {
    let made = py.import("numpy")?.call_method1("zeros", (shape.to_vec(), dtype::<T>(py)))?;
    Ok(made.cast_into::<PyArray<T, _>>().map_err(PyErr::from)?.unbind())
}

/// Checks that an argument is an array of this type and shape, in row-major order, and returns its values.
pub fn values<'py, T: Element + Copy>(
    (argument, given): (&str, &Bound<'py, PyAny>),
    shape: &[usize],
) -> PyResult<PyReadonlyArrayDyn<'py, T>> {
    let array = given
        .cast::<PyUntypedArray>()
        .map_err(|_| wrong(argument, format!("a {} is no numpy array", given.get_type())))?;
    checked::<T>(argument, array, shape).map_err(|why| wrong(argument, why))?;
    let array = given.cast::<PyArrayDyn<T>>().map_err(|error| wrong(argument, error))?;
    array.try_readonly().map_err(|error| wrong(argument, error))
}

/// Returns what keeps an array from being one of this type and shape, with its values one after the other.
fn checked<T: Element>(argument: &str, array: &Bound<'_, PyUntypedArray>, shape: &[usize]) -> Result<(), String> {
    let kind = dtype::<T>(array.py());
    if !array.dtype().is_equiv_to(&kind) {
        return Err(format!("its type is {} and not {kind}", array.dtype()));
    }
    if array.shape() != shape {
        return Err(format!("its shape is {:?} and not {shape:?}", array.shape()));
    }
    let order = if array.is_c_contiguous() { "aligned" } else { "contiguous in row-major order" };
    if !array.is_c_contiguous() || !array.is_aligned() {
        return Err(format!("it is not {order}: pass numpy.ascontiguousarray({argument}).copy()"));
    }
    Ok(())
}

/// Returns an error if a value is not finite.
pub fn finite(argument: &str, values: &[f32]) -> PyResult<()> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(at) => Err(wrong(argument, format!("the value at flat index {at} is {}", values[at]))),
        None => Ok(()),
    }
}

/// Opens a buffer for writing. Its owner may have changed its type, shape or flags in the meantime.
pub fn opened<'py, T: Element>(
    (buffer, array): (&str, &Bound<'py, PyArrayDyn<T>>),
    shape: &[usize],
) -> PyResult<PyReadwriteArrayDyn<'py, T>> {
    let changed = |why: String| wrong(buffer, format!("this buffer was changed from outside: {why}"));
    checked::<T>(buffer, array.as_untyped(), shape).map_err(changed)?;
    array.try_readwrite().map_err(|error| match error {
        numpy::BorrowError::AlreadyBorrowed => PyRuntimeError::new_err(format!("{buffer}: it is in use elsewhere")),
        _ => changed("it is not writeable".to_owned()),
    })
}
