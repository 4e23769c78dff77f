//! Arrays in, arrays out: the Python face of the `panopath` crate. No algorithm lives here.
use pyo3::prelude::*;

mod convert;
mod headings;
mod motion;
mod positions;
mod sphere;
mod synthetic;
mod table;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    headings::register(module)?;
    motion::register(module)?;
    positions::register(module)?;
    sphere::register(module)?;
    synthetic::register(module)?;
    table::register(module)
}
