//! Arrays in, arrays out: the Python face of the `panopath` crate. No algorithm lives here.
use pyo3::prelude::*;

mod conditions;
mod consistency;
mod convert;
mod correspondence;
mod descriptors;
mod freedoms;
mod headings;
mod machine;
mod motion;
mod orientation;
mod paths;
mod positions;
mod refinement;
mod rigidity;
mod sphere;
mod synthetic;
mod table;
mod trials;
mod two_view;
mod view_graph;
mod walk;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    orientation::register(module)?;
    conditions::register(module)?;
    consistency::register(module)?;
    correspondence::register(module)?;
    descriptors::register(module)?;
    freedoms::register(module)?;
    headings::register(module)?;
    machine::register(module)?;
    motion::register(module)?;
    paths::register(module)?;
    positions::register(module)?;
    refinement::register(module)?;
    rigidity::register(module)?;
    sphere::register(module)?;
    synthetic::register(module)?;
    table::register(module)?;
    trials::register(module)?;
    view_graph::register(module)?;
    walk::register(module)?;
    two_view::register(module)
}
