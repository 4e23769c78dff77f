//! Levenberg and Marquardt's loop, against a problem that can propose a step and take it.
//!
//! Damping starts at 1e-12 and rises only when a step is rejected: larger damping holds the weak drift modes of long
//! chains.

use super::newton::FIRST_DAMPING;
use crate::least_squares::LeastSquaresError;

/// It stops when the squared error in units of sigma falls by less than this: one would be a standard deviation along one
/// mode.
const GAIN_TOLERANCE: f64 = 0.02;
/// Or by less than this share of the cost.
const RELATIVE_TOLERANCE: f64 = 1e-9;
/// A mean squared chord below this is exact to the last digits of the input.
const EXACT: f64 = 1e-27;

/// How far a descent is driven.
#[derive(Clone, Copy)]
pub(crate) struct Effort {
    pub max_iterations: usize,
    /// In units of sigma squared.
    pub gain_tolerance: f64,
}

impl Effort {
    /// To the minimum, as far as the noise lets it matter.
    pub fn full(max_iterations: usize) -> Self {
        Self { max_iterations, gain_tolerance: GAIN_TOLERANCE }
    }

    /// Is it the last?
    pub fn is_full(&self) -> bool {
        self.gain_tolerance <= GAIN_TOLERANCE
    }

    /// Near enough to judge observations: their squared errors are right to about a percent.
    pub fn rough(max_iterations: usize, kept: usize) -> Self {
        Self { max_iterations, gain_tolerance: 1e-3 * kept as f64 + 2.0 * GAIN_TOLERANCE }
    }
}

/// How a descent ended.
pub(crate) struct Descent {
    pub iterations: usize,
    pub converged: bool,
}

/// What is minimised.
pub(crate) trait Problem {
    /// An estimate that a step leads to.
    type Candidate;

    /// Robust squared error at the present estimate.
    fn cost(&self) -> f64;
    /// The estimate that a step of this damping leads to, and its cost.
    fn propose(&mut self, damping: f64) -> Result<(Self::Candidate, f64), LeastSquaresError>;
    /// Goes there.
    fn accept(&mut self, candidate: Self::Candidate, cost: f64);
}

/// Minimises a cost of `kept` observations whose noise is `sigma`.
pub(crate) fn minimise(
    problem: &mut impl Problem,
    kept: usize,
    sigma: f64,
    effort: Effort,
) -> Result<Descent, LeastSquaresError> {
    let (mut damping, mut growth) = (FIRST_DAMPING, 2.0);
    for iteration in 0..effort.max_iterations {
        let cost = problem.cost();
        if cost <= EXACT * kept as f64 {
            return Ok(Descent { iterations: iteration, converged: true });
        }
        let (candidate, next) = match problem.propose(damping) {
            Ok(proposed) => proposed,
            Err(LeastSquaresError::Singular { .. }) if damping < 1.0 => {
                damping = (damping * 10.0).max(1e-11);
                continue;
            }
            Err(error) => return Err(error),
        };
        let gain = cost - next;
        // on exact data the errors are far below the least sigma
        let squared = (sigma * sigma).min(next / kept.max(1) as f64);
        let negligible = (effort.gain_tolerance * squared).max(RELATIVE_TOLERANCE * cost);
        if gain > 0.0 {
            problem.accept(candidate, next);
            damping = (damping * 0.1).max(FIRST_DAMPING);
            growth = 2.0;
        } else {
            damping = damping.max(1e-10) * growth;
            growth *= 2.0;
        }
        // a step that neither gains nor loses is the end too: the cost cannot be computed any finer
        if gain.abs() < negligible || damping > 1e8 {
            return Ok(Descent { iterations: iteration + 1, converged: true });
        }
    }
    Ok(Descent { iterations: effort.max_iterations, converged: false })
}
