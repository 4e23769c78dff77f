//! The default method: linear start, re-weighting, repair, mask and Gauss-Newton for one part.

use std::time::Instant;

use super::descent::{chords, descend, inliers, noise_scale};
use super::information::{assemble_information, weakest_mode_is_loose};
use super::linear::solve_linear;
use super::options::{LinearForm, LinearGauge};
use super::part::{Lanes, Part};
use super::reduced::{LinearSolver, ReducedSystem};
use super::start::{Estimate, normalise, repair_cheirality, robust_start};
use super::{Status, Timings};
use crate::least_squares::LeastSquaresError;

/// Rounds of descent and mask; a further one changes nothing that counts.
const MAX_ROUNDS: usize = 2;
/// A round whose noise estimate changes by less than this is the last.
const SIGMA_TOLERANCE: f64 = 0.05;

/// Solution of one part, in its own gauge.
pub(super) struct PartSolution {
    pub estimate: Estimate,
    /// For each observation of the part: is it within the noise of its prediction?
    pub inlier: Vec<bool>,
    /// Chord between ray and prediction of each observation, times the square root of its precision.
    pub chord: Vec<f64>,
    /// Noise estimate, radians at the reference sigma.
    pub sigma: f64,
    pub iterations: usize,
    pub status: Status,
}

/// Solves one part. `start` replaces the linear start.
pub(super) fn solve_part<const D: usize>(
    part: &Part<D>,
    start: Option<Estimate>,
    solver: LinearSolver,
    max_iterations: usize,
    timings: &mut Timings,
) -> Result<PartSolution, LeastSquaresError> {
    let clock = Instant::now();
    let mut system = ReducedSystem::analyse(part, solver)?;
    timings.analyse_s += clock.elapsed().as_secs_f64();

    let clock = Instant::now();
    let (mut estimate, mut iterations) = match start {
        Some(mut estimate) => {
            scale_to_unit(&mut estimate);
            (estimate, 0)
        }
        None => robust_start(part, &mut system)?,
    };
    repair_cheirality(part, &mut estimate);
    timings.start_s += clock.elapsed().as_secs_f64();

    let clock = Instant::now();
    let mut errors = chords(part, &estimate);
    let mut sigma = noise_scale::<D>(&errors, |_| true);
    let mut inlier = inliers(part, &errors, sigma);
    let mut converged = false;
    for _ in 0..MAX_ROUNDS {
        let descent = descend(part, &mut system, &mut estimate, &inlier, sigma, max_iterations)?;
        iterations += descent.iterations;
        converged = descent.converged;
        errors = chords(part, &estimate);
        let next = noise_scale::<D>(&errors, |o| inlier[o]);
        inlier = inliers(part, &errors, next);
        let settled = (next / sigma - 1.0).abs() < SIGMA_TOLERANCE;
        sigma = next;
        if settled {
            break;
        }
    }
    let status = match (converged, weakest_mode_is_loose(part, &mut system, &estimate, sigma)?) {
        (_, true) => Status::Ambiguous,
        (true, false) => Status::Converged,
        (false, false) => Status::MaxIterations,
    };
    timings.descent_s += clock.elapsed().as_secs_f64();
    Ok(PartSolution { estimate, inlier, chord: errors, sigma, iterations, status })
}

/// Solves one part by the paper's least squares and judges the observations afterwards.
pub(super) fn solve_part_linearly<const D: usize>(
    part: &Part<D>,
    form: LinearForm,
    gauge: LinearGauge,
    timings: &mut Timings,
) -> Result<PartSolution, LeastSquaresError> {
    let clock = Instant::now();
    let (mut estimate, mut status) = match solve_linear(part, form, gauge) {
        Ok(estimate) => (estimate, Status::Converged),
        Err(LeastSquaresError::Singular { .. }) => (Estimate::nowhere(part), Status::Ambiguous),
        Err(error) => return Err(error),
    };
    scale_to_unit(&mut estimate);
    let chord = chords(part, &estimate);
    let sigma = noise_scale::<D>(&chord, |_| true);
    let inlier = inliers(part, &chord, sigma);
    if status == Status::Converged {
        let mut system = ReducedSystem::analyse(part, LinearSolver::Direct)?;
        assemble_information(part, &mut system, &estimate, &inlier, sigma);
        system.factorise()?;
        if weakest_mode_is_loose(part, &mut system, &estimate, sigma)? {
            status = Status::Ambiguous;
        }
    }
    timings.start_s += clock.elapsed().as_secs_f64();
    Ok(PartSolution { estimate, inlier, chord, sigma, iterations: 1, status })
}

/// Brings a given start to the scale at which the solver works.
fn scale_to_unit(estimate: &mut Estimate) {
    let n = estimate.centers.len() as f64;
    let centroid = estimate.centers.iter().fold(Lanes::ZERO, |sum, c| sum.plus(c)).times(1.0 / n);
    let scale = normalise(&mut estimate.centers);
    for point in &mut estimate.points {
        *point = point.minus(&centroid).times(scale);
    }
}
