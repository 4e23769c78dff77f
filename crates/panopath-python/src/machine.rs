//! What the compiled module is made for and runs on.

use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Platform, vector instructions in use, and threads that a step takes by itself.
#[pyfunction]
fn build_info(py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
    let info = PyDict::new(py);
    info.set_item("platform", format!("{}-{}", std::env::consts::OS, std::env::consts::ARCH))?;
    info.set_item("vector_instructions", panopath::machine::vector_instructions())?;
    info.set_item("threads", panopath::machine::default_threads())?;
    Ok(info)
}

pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(build_info, module)?)
}
