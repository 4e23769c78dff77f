//! Gauss-Newton on the sphere: `min sum rho(|v - (x - c)/r| / sigma)` over centres and points, Huber's rho.
//!
//! Points are eliminated as in the linear steps, with `M = p (I - u u^T)/r^2`, `u` the predicted direction. Damping starts
//! at 1e-12 and rises only when a step is rejected: larger damping holds the weak drift modes of long chains. A point of
//! low parallax steps in inverse depth; a point whose cost rises is fitted again to the moved cameras.

use rayon::prelude::*;

use super::part::{Lanes, Part};
use super::reduced::{Damping, PointFactor, PointSum, Quadratic, ReducedSystem, Weighing};
use super::start::{Estimate, for_each_chunk, sigma_from_chords, squared_error};
use crate::least_squares::LeastSquaresError;

/// Damping of the first step, relative to the diagonal.
const FIRST_DAMPING: f64 = 1e-12;
/// A point whose normal matrix holds less than this share of its trace in depth steps in inverse depth.
const LOW_PARALLAX: f64 = 0.05;
/// Gauss-Newton stops when the squared error in units of sigma falls by less than this: one would be a standard deviation
/// along one mode.
const GAIN_TOLERANCE: f64 = 0.02;
/// Or by less than this share of the cost.
const RELATIVE_TOLERANCE: f64 = 1e-9;
/// A point whose squared error rises by more than this, in units of sigma, is fitted again to the moved cameras.
const POINT_RISE: f64 = 0.5;
/// Steps of such a fit.
const POINT_ITERATIONS: usize = 4;
/// A mean squared chord below this is exact to the last digits of the input.
const EXACT: f64 = 1e-27;

/// Smallest noise estimate in radians, so that exact data keeps all its observations.
pub(super) const SIGMA_FLOOR_RAD: f64 = 1e-7;

/// Observations farther than this many sigma from their prediction are outliers.
pub(super) const OUTLIER_SIGMAS: f64 = 5.0;
/// The same before the first descent: the cameras still err by more than the noise, most of all as seen from near points.
pub(super) const FIRST_OUTLIER_SIGMAS: f64 = 20.0;
/// Huber's threshold in sigma.
pub(super) const HUBER_SIGMAS: f64 = 3.0;

/// Gauss-Newton's model of each observation at an estimate.
pub(super) struct NewtonWeights<'a, const D: usize> {
    part: &'a Part<D>,
    estimate: &'a Estimate,
    keep: &'a [bool],
    huber: f64,
}

impl<'a, const D: usize> NewtonWeights<'a, D> {
    /// Weights at an estimate for the observations in `keep`, Huber's threshold at its multiple of `sigma`.
    pub fn new(part: &'a Part<D>, estimate: &'a Estimate, keep: &'a [bool], sigma: f64) -> Self {
        Self { part, estimate, keep, huber: HUBER_SIGMAS * sigma }
    }

    /// The estimate at which the weights are taken.
    pub fn estimate(&self) -> &'a Estimate {
        self.estimate
    }

    /// Which observations count.
    pub fn keep(&self) -> &'a [bool] {
        self.keep
    }

    /// Huber's threshold, in radians at the reference sigma.
    pub fn huber(&self) -> f64 {
        self.huber
    }

    /// Model of observation `o` of a point seen from a centre.
    #[inline(always)]
    fn model(&self, o: usize, point: &Lanes, center: &Lanes) -> Quadratic {
        let ray = &self.part.ray[o];
        let u = point.minus(center);
        let reciprocal = 1.0 / u.dot::<D>(&u).sqrt().max(f64::MIN_POSITIVE);
        let mut direction = u.times(reciprocal);
        let error = ray.minus(&direction);
        let chord = error.dot::<D>(&error) * ray.0[3];
        let rho = if self.keep[o] { ray.0[3] * huber_weight(chord, self.huber) } else { 0.0 };
        let along = ray.dot::<D>(&direction);
        let mut gradient = ray.plus_scaled(-along, &direction).times(rho * reciprocal);
        gradient.0[3] = 0.0;
        direction.0[3] = rho * reciprocal * reciprocal;
        Quadratic { direction, gradient }
    }
}

impl<const D: usize> Weighing<D> for NewtonWeights<'_, D> {
    #[inline(always)]
    fn observe(&self, o: usize, j: usize) -> Quadratic {
        self.model(o, &self.estimate.points[j], &self.estimate.centers[self.part.view[o] as usize])
    }

    #[inline(always)]
    fn depth_axis(&self, j: usize) -> Lanes {
        let first = self.part.view[self.part.start[j] as usize] as usize;
        unit::<D>(&self.estimate.points[j].minus(&self.estimate.centers[first]))
    }
}

#[inline(always)]
fn huber_weight(squared: f64, threshold: f64) -> f64 {
    if squared <= threshold * threshold { 1.0 } else { threshold / squared.sqrt() }
}

#[inline(always)]
fn huber_cost(squared: f64, threshold: f64) -> f64 {
    if squared <= threshold * threshold { squared } else { threshold * (2.0 * squared.sqrt() - threshold) }
}

/// How far a descent is driven.
#[derive(Clone, Copy)]
pub(super) struct Effort {
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
pub(super) struct Descent {
    pub iterations: usize,
    pub converged: bool,
}

/// Minimises over the kept observations, from `estimate` as it stands. `gain_tolerance` is in units of sigma squared.
pub(super) fn descend<const D: usize>(
    part: &Part<D>,
    system: &mut ReducedSystem<D>,
    estimate: &mut Estimate,
    keep: &[bool],
    sigma: f64,
    effort: Effort,
) -> Result<Descent, LeastSquaresError> {
    let huber = HUBER_SIGMAS * sigma;
    let kept = keep.iter().filter(|&&k| k).count();
    let mut costs = point_costs(part, estimate, keep, huber);
    let mut cost: f64 = sum_in_chunks(part, &costs);
    let (mut damping, mut growth) = (FIRST_DAMPING, 2.0);
    for iteration in 0..effort.max_iterations {
        if cost <= EXACT * kept as f64 {
            return Ok(Descent { iterations: iteration, converged: true });
        }
        let weights = NewtonWeights::new(part, estimate, keep, sigma);
        system.assemble(part, &weights, Damping { point: damping, view: damping });
        let step = match system.solve() {
            Ok(step) => step,
            Err(LeastSquaresError::Singular { .. }) if damping < 1.0 => {
                damping = (damping * 10.0).max(1e-11);
                continue;
            }
            Err(error) => return Err(error),
        };
        let (candidate, next_costs) = take_step(part, &weights, &costs, &step, damping);
        let next: f64 = sum_in_chunks(part, &next_costs);
        let gain = cost - next;
        // on exact data the errors are far below the least sigma
        let squared = (sigma * sigma).min(next / kept.max(1) as f64);
        let negligible = (effort.gain_tolerance * squared).max(RELATIVE_TOLERANCE * cost);
        if gain > 0.0 {
            (*estimate, costs, cost) = (candidate, next_costs, next);
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

/// Robust cost of each point.
fn point_costs<const D: usize>(part: &Part<D>, estimate: &Estimate, keep: &[bool], huber: f64) -> Vec<f64> {
    let mut costs = vec![0.0; part.n_tracks()];
    for_each_chunk(part, &mut costs, |tracks, out| {
        for (j, cost) in tracks.zip(out) {
            *cost = point_cost(part, j, &estimate.centers, &estimate.points[j], keep, huber);
        }
    });
    costs
}

/// Sum of one number for each track, chunk by chunk.
fn sum_in_chunks<const D: usize>(part: &Part<D>, values: &[f64]) -> f64 {
    part.chunks.iter().map(|tracks| values[tracks.clone()].iter().sum::<f64>()).sum()
}

/// Robust cost of one point.
#[inline(always)]
pub(super) fn point_cost<const D: usize>(
    part: &Part<D>,
    j: usize,
    centers: &[Lanes],
    point: &Lanes,
    keep: &[bool],
    huber: f64,
) -> f64 {
    let mut cost = 0.0;
    for o in part.observations(j) {
        if keep[o] {
            cost += huber_cost(squared_error(part, o, centers, point), huber);
        }
    }
    cost
}

/// Applies a camera step, lets every point follow, and returns the new estimate with the cost of each point.
fn take_step<const D: usize>(
    part: &Part<D>,
    weights: &NewtonWeights<'_, D>,
    costs: &[f64],
    step: &[Lanes],
    damping: f64,
) -> (Estimate, Vec<f64>) {
    let centers: Vec<Lanes> = weights.estimate.centers.iter().zip(step).map(|(c, d)| c.plus(d)).collect();
    let mut moved = vec![(Lanes::ZERO, 0.0); part.n_tracks()];
    for_each_chunk(part, &mut moved, |tracks, moved| {
        pulp::Arch::new().dispatch(PointMoves {
            part,
            tracks,
            weights,
            costs,
            step,
            centers: &centers,
            damping,
            moved,
        });
    });
    let (points, costs) = moved.into_iter().unzip();
    (Estimate { centers, points }, costs)
}

/// Moves a chunk of points; see [`Elimination`](super::reduced) for why this is no closure.
struct PointMoves<'a, const D: usize> {
    part: &'a Part<D>,
    tracks: std::ops::Range<usize>,
    weights: &'a NewtonWeights<'a, D>,
    costs: &'a [f64],
    step: &'a [Lanes],
    centers: &'a [Lanes],
    damping: f64,
    moved: &'a mut [(Lanes, f64)],
}

impl<const D: usize> pulp::WithSimd for PointMoves<'_, D> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { part, tracks, weights, costs, step, centers, damping, moved } = self;
        for (j, moved) in tracks.zip(moved) {
            *moved = move_point(part, j, weights, costs[j], step, centers, damping);
        }
    }
}

/// Normal equations of one point: the factor, the gradient, and the share of information that lies in depth.
struct PointModel<const D: usize> {
    factor: PointFactor<D>,
    gradient: Lanes,
    axis: Lanes,
    depth_share: f64,
}

/// Sums the models of a point's observations; `step` moves each view's centre. `None` where nothing is kept.
#[inline(always)]
fn point_model<const D: usize>(
    part: &Part<D>,
    j: usize,
    weights: &NewtonWeights<'_, D>,
    point: &Lanes,
    centers: &[Lanes],
    step: Option<&[Lanes]>,
    damping: f64,
) -> Option<PointModel<D>> {
    let mut sum = PointSum::<D>::new();
    let mut pull = Lanes::ZERO;
    for o in part.observations(j) {
        let view = part.view[o] as usize;
        let model = weights.model(o, point, &centers[view]);
        sum.add(&model);
        if let Some(step) = step {
            pull = pull.plus(&model.apply::<D>(&step[view]));
        }
    }
    if sum.is_empty() {
        return None;
    }
    let axis = unit::<D>(&point.minus(&centers[part.view[part.start[j] as usize] as usize]));
    let depth_share = sum.along(&axis) / (sum.weight_sum * (D - 1) as f64);
    Some(PointModel { factor: sum.factor(damping, &axis), gradient: sum.gradient.plus(&pull), axis, depth_share })
}

/// How a point follows small displacements of the centres; `None` where nothing of it is kept.
pub(super) fn point_displacement<const D: usize>(
    part: &Part<D>,
    j: usize,
    weights: &NewtonWeights<'_, D>,
    displacement: &[Lanes],
) -> Option<Lanes> {
    let Estimate { centers, points } = weights.estimate;
    let still = point_model(part, j, weights, &points[j], centers, None, FIRST_DAMPING)?;
    let moved = point_model(part, j, weights, &points[j], centers, Some(displacement), FIRST_DAMPING)?;
    Some(still.factor.solve(&moved.gradient.minus(&still.gradient)))
}

#[inline(always)]
fn unit<const D: usize>(u: &Lanes) -> Lanes {
    u.times(1.0 / u.dot::<D>(u).sqrt().max(f64::MIN_POSITIVE))
}

/// The new position of one point after a camera step, and its cost.
#[inline(always)]
fn move_point<const D: usize>(
    part: &Part<D>,
    j: usize,
    weights: &NewtonWeights<'_, D>,
    before: f64,
    step: &[Lanes],
    centers: &[Lanes],
    damping: f64,
) -> (Lanes, f64) {
    let old = weights.estimate.points[j];
    let old_centers = &weights.estimate.centers;
    let Some(model) = point_model(part, j, weights, &old, old_centers, Some(step), damping) else { return (old, 0.0) };
    let delta = model.factor.solve(&model.gradient);
    let first = part.view[part.start[j] as usize] as usize;
    let moved = follow(&model, &old, &delta, &old_centers[first], &step[first]);
    let cost = point_cost(part, j, centers, &moved, weights.keep, weights.huber);
    let allowed = before + POINT_RISE * (weights.huber / HUBER_SIGMAS).powi(2);
    if cost <= allowed { (moved, cost) } else { fit_again(part, j, weights, step, centers, [moved, old.plus(&delta)]) }
}

/// Where a step takes a point: in inverse depth where its parallax is low.
#[inline(always)]
fn follow<const D: usize>(
    model: &PointModel<D>,
    old: &Lanes,
    delta: &Lanes,
    center: &Lanes,
    center_step: &Lanes,
) -> Lanes {
    if model.depth_share < LOW_PARALLAX {
        inverse_depth_move::<D>(old, delta, &model.axis, center, center_step)
    } else {
        old.plus(delta)
    }
}

/// The Euclidean step read as a change of direction and of inverse depth, seen from the track's first view.
#[inline(always)]
fn inverse_depth_move<const D: usize>(
    old: &Lanes,
    delta: &Lanes,
    axis: &Lanes,
    center: &Lanes,
    center_step: &Lanes,
) -> Lanes {
    let u = old.minus(center);
    let distance = u.dot::<D>(&u).sqrt();
    let relative = delta.minus(center_step).times(1.0 / distance.max(f64::MIN_POSITIVE));
    let depth = relative.dot::<D>(axis);
    let direction = axis.plus(&relative.plus_scaled(-depth, axis));
    let length = direction.dot::<D>(&direction).sqrt();
    let inverse_depth = (1.0 - depth).clamp(0.1, 10.0);
    center.plus(center_step).plus_scaled(distance / (inverse_depth * length), &direction)
}

/// Where a point's cost rose: the best of its moves, a shift with its views and a new triangulation, fitted to the moved
/// cameras.
#[cold]
fn fit_again<const D: usize>(
    part: &Part<D>,
    j: usize,
    weights: &NewtonWeights<'_, D>,
    step: &[Lanes],
    centers: &[Lanes],
    [moved, euclidean]: [Lanes; 2],
) -> (Lanes, f64) {
    let count = part.observations(j).len() as f64;
    let views = part.observations(j).map(|o| part.view[o] as usize);
    let shift = views.fold(Lanes::ZERO, |sum, view| sum.plus_scaled(1.0 / count, &step[view]));
    let mut best = (moved, f64::INFINITY);
    let kept = part.observations(j).filter(|&o| weights.keep[o]);
    let triangulated = intersect_rays(part, kept, centers, &moved);
    for candidate in [moved, euclidean, weights.estimate.points[j].plus(&shift), triangulated] {
        let cost = point_cost(part, j, centers, &candidate, weights.keep, weights.huber);
        if cost < best.1 {
            best = (candidate, cost);
        }
    }
    fit_point(part, j, weights, centers, best)
}

/// Gauss-Newton on one point alone, from a position and its cost.
pub(super) fn fit_point<const D: usize>(
    part: &Part<D>,
    j: usize,
    weights: &NewtonWeights<'_, D>,
    centers: &[Lanes],
    (mut point, mut cost): (Lanes, f64),
) -> (Lanes, f64) {
    let center = &centers[part.view[part.start[j] as usize] as usize];
    let mut damping = FIRST_DAMPING;
    for _ in 0..POINT_ITERATIONS {
        let Some(model) = point_model(part, j, weights, &point, centers, None, damping) else { break };
        let delta = model.factor.solve(&model.gradient);
        let moved = follow(&model, &point, &delta, center, &Lanes::ZERO);
        let next = point_cost(part, j, centers, &moved, weights.keep, weights.huber);
        if next < cost {
            (point, cost) = (moved, next);
        } else {
            damping = damping.max(1e-3) * 10.0;
        }
    }
    (point, cost)
}

/// The point nearest to some rays, each weighted by its distance to `near`.
pub(super) fn intersect_rays<const D: usize>(
    part: &Part<D>,
    observations: impl Iterator<Item = usize>,
    centers: &[Lanes],
    near: &Lanes,
) -> Lanes {
    let mut sum = PointSum::<D>::new();
    let mut right = Lanes::ZERO;
    for o in observations {
        let center = &centers[part.view[o] as usize];
        let mut direction = part.ray[o];
        let u = near.minus(center);
        direction.0[3] /= u.dot::<D>(&u).max(f64::MIN_POSITIVE);
        let model = Quadratic { direction, gradient: Lanes::ZERO };
        sum.add(&model);
        right = right.plus(&model.apply::<D>(center));
    }
    sum.factor(0.0, &Lanes::ZERO).solve(&right)
}

/// Chord of every observation in units of the reference sigma's radian.
pub(super) fn chords<const D: usize>(part: &Part<D>, estimate: &Estimate) -> Vec<f64> {
    let track_chords: Vec<Vec<f64>> = part
        .chunks
        .par_iter()
        .map(|tracks| {
            let mut out = Vec::new();
            for j in tracks.clone() {
                for o in part.observations(j) {
                    out.push(squared_error(part, o, &estimate.centers, &estimate.points[j]).sqrt());
                }
            }
            out
        })
        .collect();
    track_chords.concat()
}

/// Observations for which `among` holds, and the equations and unknowns (gauge taken off) of a fit to them.
pub(super) struct FitSize {
    pub observations: usize,
    pub equations: usize,
    pub unknowns: usize,
}

impl FitSize {
    pub fn of<const D: usize>(part: &Part<D>, among: impl Fn(usize) -> bool) -> Self {
        let (mut observations, mut points) = (0, 0);
        for j in 0..part.n_tracks() {
            let kept = part.observations(j).filter(|&o| among(o)).count();
            observations += kept;
            points += usize::from(kept > 0);
        }
        let unknowns = (D * (points + part.n_views)).saturating_sub(D + 1);
        Self { observations, equations: (D - 1) * observations, unknowns }
    }
}

/// Noise estimate from the chords of the observations for which `among` holds.
pub(super) fn noise_scale<const D: usize>(part: &Part<D>, chords: &[f64], among: impl Fn(usize) -> bool) -> f64 {
    let stride = (chords.len() / 200_000).max(1);
    let mut sample: Vec<f64> = (0..chords.len()).step_by(stride).filter(|&o| among(o)).map(|o| chords[o]).collect();
    let size = FitSize::of(part, among);
    sigma_from_chords::<D>(&mut sample, size.observations, size.unknowns).max(SIGMA_FLOOR_RAD)
}

/// Root mean square of the kept chords over the degrees of freedom: steadier than a quantile once outliers are gone.
/// `None` where nothing is left over.
pub(super) fn sigma_of_inliers<const D: usize>(part: &Part<D>, chords: &[f64], keep: &[bool]) -> Option<f64> {
    let size = FitSize::of(part, |o| keep[o]);
    let freedom = size.equations.checked_sub(size.unknowns)?;
    let squared: f64 = chords.iter().zip(keep).filter(|(_, k)| **k).map(|(e, _)| e * e).sum();
    (freedom > 0).then(|| (squared / freedom as f64).sqrt().max(SIGMA_FLOOR_RAD))
}

/// Observations within a limit of their prediction, of points that keep at least two views.
pub(super) fn inliers<const D: usize>(part: &Part<D>, chords: &[f64], limit: f64) -> Vec<bool> {
    let mut keep: Vec<bool> = chords.iter().map(|&e| e < limit).collect();
    for j in 0..part.n_tracks() {
        let mut views = part.observations(j).filter(|&o| keep[o]).map(|o| part.view[o]);
        let first = views.next();
        if !views.any(|view| Some(view) != first) {
            keep[part.observations(j)].fill(false);
        }
    }
    keep
}
