//! The system of all cameras of a part, by the cheaper of two ways.

use super::full::FullSystem;
use super::part::Part;
use super::reduced::{CameraTerm, Damping, Factorised, Freedoms, ReducedSystem, Row, Weighing};
use crate::least_squares::{BlockPattern, LeastSquaresError, LinearSolver};

/// The system of all cameras: points eliminated, or kept where they are fewer.
pub(crate) enum CameraSystem<const D: usize, const V: usize, R> {
    Reduced(ReducedSystem<D, V, R>),
    Full(FullSystem<V>),
}

impl<const D: usize, const V: usize, R: Row> CameraSystem<D, V, R> {
    /// Analyses a part; `held` are the unknowns of cameras that stay zero.
    pub fn analyse(part: &Part<D>, solver: LinearSolver, held: Vec<bool>) -> Result<Self, LeastSquaresError> {
        if part.n_tracks() < part.n_nodes {
            FullSystem::analyse(part, held).map(Self::Full)
        } else {
            ReducedSystem::analyse(part, solver, held).map(Self::Reduced)
        }
    }

    pub fn assemble(
        &mut self,
        part: &Part<D>,
        weighing: &impl Weighing<D>,
        freedoms: &impl Freedoms<D, V, Row = R>,
        terms: &[CameraTerm<V>],
        damping: Damping,
    ) {
        match self {
            Self::Reduced(system) => system.assemble(part, weighing, freedoms, terms, damping),
            Self::Full(system) => system.assemble(part, weighing, freedoms, terms, damping),
        }
    }

    /// Which nodes are coupled, and the lower triangle as it was assembled last: first the cameras.
    pub fn matrix(&self) -> (&BlockPattern, &[f64]) {
        match self {
            Self::Reduced(system) => (system.pattern(), system.values()),
            Self::Full(system) => system.matrix(),
        }
    }

    pub fn factorise(&mut self) -> Result<(), LeastSquaresError> {
        match self {
            Self::Reduced(system) => system.factorise(),
            Self::Full(system) => system.factorise(),
        }
    }

    pub fn solve(&mut self) -> Result<Vec<[f64; V]>, LeastSquaresError> {
        match self {
            Self::Reduced(system) => system.solve(),
            Self::Full(system) => system.solve(),
        }
    }
}

impl<const D: usize, const V: usize, R: Row> Factorised for CameraSystem<D, V, R> {
    fn solve_for(&self, right: &mut [f64]) -> Result<(), LeastSquaresError> {
        match self {
            Self::Reduced(system) => Factorised::solve_for(system, right),
            Self::Full(system) => system.solve_for(right),
        }
    }

    fn held(&self) -> &[bool] {
        match self {
            Self::Reduced(system) => Factorised::held(system),
            Self::Full(system) => system.held(),
        }
    }

    fn diagonal(&self) -> &[f64] {
        match self {
            Self::Reduced(system) => system.diagonal(),
            Self::Full(system) => system.diagonal(),
        }
    }
}
