//! The default method: linear start, re-weighting, repair, mask and Gauss-Newton for one part.

use std::time::Instant;

use super::descent::descend;
use super::information::is_loose;
use super::linear::solve_linear;
use super::options::{LinearForm, LinearGauge};
use super::start::{Start, StartWeights, linear_start, robust_start};
use super::{PositionSystem, Status, Timings, position_system};
use crate::bundle::estimate::{Estimate, scale_to_unit};
use crate::bundle::levenberg::Effort;
use crate::bundle::newton::NewtonWeights;
use crate::bundle::noise::{FIRST_OUTLIER_SIGMAS, OUTLIER_SIGMAS, chords, inliers, noise_scale, sigma_of_inliers};
use crate::bundle::part::{Lanes, Part};
use crate::bundle::points::{reconsider, repair_cheirality, without_parallax, without_tracks};
use crate::least_squares::{LeastSquaresError, LinearSolver};

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

impl PartSolution {
    /// What singular equations leave: an answer, though an empty one.
    fn nothing<const D: usize>(part: &Part<D>) -> Self {
        let n = part.n_observations();
        Self {
            estimate: Estimate::nowhere(part),
            inlier: vec![false; n],
            chord: vec![f64::NAN; n],
            sigma: f64::NAN,
            iterations: 0,
            status: Status::Ambiguous,
        }
    }
}

/// Solves one part. `start` replaces the linear start.
pub(super) fn solve_part<const D: usize>(
    part: &Part<D>,
    start: Option<Estimate>,
    solver: LinearSolver,
    max_iterations: usize,
    even_start: bool,
    timings: &mut Timings,
) -> Result<PartSolution, LeastSquaresError> {
    match solve_regular_part(part, start, solver, max_iterations, even_start, timings) {
        Err(LeastSquaresError::Singular { .. }) => Ok(PartSolution::nothing(part)),
        other => other,
    }
}

fn solve_regular_part<const D: usize>(
    part: &Part<D>,
    start: Option<Estimate>,
    solver: LinearSolver,
    max_iterations: usize,
    even_start: bool,
    timings: &mut Timings,
) -> Result<PartSolution, LeastSquaresError> {
    let clock = Instant::now();
    let mut system = position_system(part, solver)?;
    timings.analyse_s += clock.elapsed().as_secs_f64();

    let given = start.is_some();
    let clock = Instant::now();
    let first = match start {
        Some(mut estimate) => {
            scale_to_unit(&mut estimate);
            Start { estimate, steps: 0 }
        }
        None => robust_start(part, &mut system, even_start)?,
    };
    timings.start_s += clock.elapsed().as_secs_f64();

    let clock = Instant::now();
    let steps = first.steps;
    let mut best = settle(part, &mut system, first.estimate, max_iterations)?;
    // an even start is one for bodies that move
    if !given
        && !even_start
        && (freedom_of(part) < LOW_REDUNDANCY || share_of_lost_tracks(part, &best.inlier) > MANY_LOST)
    {
        let mut others = Vec::new();
        for weights in [StartWeights::Parallax, StartWeights::Equal] {
            // a start that leads nowhere is no loss: there is one end already
            let start = linear_start(part, &mut system, weights);
            match start.and_then(|start| settle(part, &mut system, start, max_iterations)) {
                Ok(end) => others.push(end),
                Err(LeastSquaresError::Singular { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        best = best_of(best, others);
        // a start that was far off has left its marks on which observations are kept
        let again = settle(part, &mut system, best.estimate.clone(), max_iterations)?;
        best = best_of(best, vec![again]);
    }
    let weights = NewtonWeights::new(part, &best.estimate, &best.active, best.sigma);
    let loose = best.without_parallax || is_loose(part, &mut system, &weights, best.sigma)?;
    let status = match (best.converged, loose) {
        (_, true) => Status::Ambiguous,
        (true, false) => Status::Converged,
        (false, false) => Status::MaxIterations,
    };
    timings.descent_s += clock.elapsed().as_secs_f64();
    let iterations = steps + best.iterations;
    let Settled { estimate, inlier, chord, sigma, .. } = best;
    Ok(PartSolution { estimate, inlier, chord, sigma, iterations, status })
}

/// Below this share of equations beyond the unknowns, re-weighting may settle on a wrong half of the observations: other
/// starts are followed too, and the best end taken.
const LOW_REDUNDANCY: f64 = 0.45;

/// So too where more than this share of the longer tracks lost most of their observations: outliers that stray one by one
/// leave tracks whole, a body that moves, or a start that followed it, does not.
const MANY_LOST: f64 = 0.08;

/// Tracks of four observations and more that keep less than half of them, as a share.
fn share_of_lost_tracks<const D: usize>(part: &Part<D>, inlier: &[bool]) -> f64 {
    let (mut long, mut lost) = (0usize, 0usize);
    for j in 0..part.n_tracks() {
        let observations = part.observations(j);
        let count = observations.len();
        long += usize::from(count >= 4);
        lost += usize::from(count >= 4 && 2 * observations.filter(|&o| inlier[o]).count() < count);
    }
    lost as f64 / long.max(1) as f64
}

/// Equations beyond the unknowns, as a share of all equations.
fn freedom_of<const D: usize>(part: &Part<D>) -> f64 {
    let equations = ((D - 1) * part.n_observations()) as f64;
    1.0 - (D * (part.n_views + part.n_tracks())) as f64 / equations
}

/// Where a start led.
struct Settled {
    estimate: Estimate,
    inlier: Vec<bool>,
    /// The inliers that the last descent used.
    active: Vec<bool>,
    chord: Vec<f64>,
    sigma: f64,
    iterations: usize,
    converged: bool,
    /// So few tracks show parallax that the views cannot be told from one place.
    without_parallax: bool,
}

/// Repairs a start, then descends and judges the observations, first roughly and then in full.
fn settle<const D: usize>(
    part: &Part<D>,
    system: &mut PositionSystem<D>,
    mut estimate: Estimate,
    max_iterations: usize,
) -> Result<Settled, LeastSquaresError> {
    repair_cheirality(part, &mut estimate);
    let errors = chords(part, &estimate);
    let mut sigma = noise_scale(part, &errors, |_| true);
    let mut inlier = inliers(part, &errors, FIRST_OUTLIER_SIGMAS * sigma);
    let mut effort = Effort::rough(max_iterations, part.n_observations());
    let mut iterations = 0;
    loop {
        let parallel = without_parallax(part, &inlier, sigma);
        let active = without_tracks(part, &inlier, &parallel.left_out);
        let descent = descend(part, system, &mut estimate, &active, sigma, effort)?;
        iterations += descent.iterations;
        sigma = noise_scale(part, &chords(part, &estimate), |o| active[o]);
        inlier = reconsider(part, &mut estimate, &parallel.left_out, sigma);
        if effort.is_full() {
            let (chord, converged) = (chords(part, &estimate), descent.converged);
            let kept: Vec<bool> = active.iter().zip(&inlier).map(|(a, i)| *a && *i).collect();
            sigma = sigma_of_inliers(part, &chord, &kept).unwrap_or(sigma);
            let without_parallax = parallel.everything;
            return Ok(Settled { estimate, inlier, active, chord, sigma, iterations, converged, without_parallax });
        }
        effort = Effort::full(max_iterations);
    }
}

/// The end whose squared errors, none counted beyond the outlier limit, are least; sigma is the smallest of all ends'. Counts
/// the iterations of all.
fn best_of(first: Settled, others: Vec<Settled>) -> Settled {
    let iterations = others.iter().fold(first.iterations, |sum, end| sum + end.iterations);
    let sigma = others.iter().fold(first.sigma, |least, end| least.min(end.sigma));
    let cost = |end: &Settled| -> f64 {
        let limit = OUTLIER_SIGMAS * OUTLIER_SIGMAS;
        end.chord.iter().map(|e| (e / sigma).powi(2)).map(|e| if e < limit { e } else { limit }).sum()
    };
    let best = others.into_iter().fold(first, |best, end| if cost(&end) < cost(&best) { end } else { best });
    Settled { iterations, ..best }
}

/// Solves one part by the paper's least squares and judges the observations afterwards.
pub(super) fn solve_part_linearly<const D: usize>(
    part: &Part<D>,
    form: LinearForm,
    gauge: LinearGauge,
    timings: &mut Timings,
) -> Result<PartSolution, LeastSquaresError> {
    let clock = Instant::now();
    let mut estimate = match solve_linear(part, form, gauge) {
        Err(LeastSquaresError::Singular { .. }) => return Ok(PartSolution::nothing(part)),
        other => other?,
    };
    scale_to_unit(&mut estimate);
    let chord = chords(part, &estimate);
    let sigma = noise_scale(part, &chord, |_| true);
    let inlier = inliers(part, &chord, OUTLIER_SIGMAS * sigma);
    let mut system = position_system(part, LinearSolver::Direct)?;
    let loose = is_loose(part, &mut system, &NewtonWeights::new(part, &estimate, &inlier, sigma), sigma)?
        || plan_is_loose(part, form, &estimate)?;
    let status = if loose { Status::Ambiguous } else { Status::Converged };
    timings.start_s += clock.elapsed().as_secs_f64();
    Ok(PartSolution { estimate, inlier, chord, sigma, iterations: 1, status })
}

/// Does the first of two stages leave a freedom, which the second cannot mend?
fn plan_is_loose<const D: usize>(
    part: &Part<D>,
    form: LinearForm,
    estimate: &Estimate,
) -> Result<bool, LeastSquaresError> {
    let LinearForm::TwoStage { vertical_axis } = form else { return Ok(false) };
    let axes = [(vertical_axis + 1) % D, (vertical_axis + 2) % D];
    let flatten = |nodes: &[Lanes]| nodes.iter().map(|x| Lanes([x.0[axes[0]], x.0[axes[1]], 0.0, 0.0])).collect();
    let mut plan = Estimate { centers: flatten(&estimate.centers), points: flatten(&estimate.points) };
    scale_to_unit(&mut plan);
    let flattened = part.ray.iter().map(|ray| {
        let length = ray.0[axes[0]].hypot(ray.0[axes[1]]).max(f64::MIN_POSITIVE);
        Lanes([ray.0[axes[0]] / length, ray.0[axes[1]] / length, 0.0, ray.0[3] * length * length])
    });
    let flat: Part<2> = part.with_rays(flattened.collect());
    let chord = chords(&flat, &plan);
    let sigma = noise_scale(&flat, &chord, |_| true);
    let keep = inliers(&flat, &chord, OUTLIER_SIGMAS * sigma);
    let mut system = position_system(&flat, LinearSolver::Direct)?;
    is_loose(&flat, &mut system, &NewtonWeights::new(&flat, &plan, &keep, sigma), sigma)
}
