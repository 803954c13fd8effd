//! The compiled module of Murmurate's Python package with the parts of a crate of one's own beside the built-in ones.

use pyo3::prelude::*;

#[pymodule]
fn stranger_parts(module: &Bound<'_, PyModule>) -> PyResult<()> {
    murmurate_python::fill(module, stranger::registry())
}
