//! The Python module `murmurate._murmurate`: Murmurate's environments on numpy buffers, its simulations and its program.
//! The package around it is in `murmurate/`.

mod program;
mod vec_env;

use pyo3::prelude::*;

#[pymodule]
fn _murmurate(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<vec_env::VecEnv>()?;
    module.add_function(wrap_pyfunction!(program::sim_json, module)?)?;
    module.add_function(wrap_pyfunction!(program::run_program, module)?)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
