//! Gauss-Newton on the sphere: `min sum rho(|v - (x - c)/r| / sigma)` over centres and points, Huber's rho.
//!
//! Points are eliminated as in the linear steps, with `M = p (I - u u^T)/r^2`, `u` the predicted direction. Damping starts
//! at 1e-12 and rises only when a step is rejected: larger damping holds the weak drift modes of long chains. A point of
//! low parallax steps in inverse depth; a point whose cost jumps takes the best of three other moves.

use rayon::prelude::*;

use super::part::{Lanes, Part};
use super::reduced::{Damping, PointFactor, Quadratic, ReducedSystem, Weighing, add_outer};
use super::start::{Estimate, for_each_chunk, median, squared_chord};
use crate::least_squares::LeastSquaresError;

/// Damping of the first step, relative to the diagonal.
const FIRST_DAMPING: f64 = 1e-12;
/// A point whose normal matrix holds less than this share of its trace in depth steps in inverse depth.
const LOW_PARALLAX: f64 = 0.05;
/// Gauss-Newton stops when the cost falls by less than this share.
const COST_TOLERANCE: f64 = 1e-6;
/// A mean squared chord below this is exact to the last digits of the input.
const EXACT: f64 = 1e-27;

/// Median of a chord (two tangent directions) over its standard deviation in each; for d = 2 of a single one.
pub(super) const fn median_over_sigma(d: usize) -> f64 {
    if d == 2 { 0.6745 } else { 1.1774 }
}

/// Smallest noise estimate in radians, so that exact data keeps all its observations.
pub(super) const SIGMA_FLOOR_RAD: f64 = 1e-9;

/// Observations farther than this many sigma from their prediction are outliers.
pub(super) const OUTLIER_SIGMAS: f64 = 5.0;
/// Huber's threshold in sigma.
pub(super) const HUBER_SIGMAS: f64 = 3.0;

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
}

impl<const D: usize> Weighing<D> for NewtonWeights<'_, D> {
    #[inline(always)]
    fn observe(&self, o: usize, j: usize) -> Quadratic {
        let ray = &self.part.ray[o];
        let u = self.estimate.points[j].minus(&self.estimate.centers[self.part.view[o] as usize]);
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

    #[inline(always)]
    fn depth_axis(&self, j: usize) -> Lanes {
        let first = self.part.start[j] as usize;
        let u = self.estimate.points[j].minus(&self.estimate.centers[self.part.view[first] as usize]);
        u.times(1.0 / u.dot::<D>(&u).sqrt().max(f64::MIN_POSITIVE))
    }
}

#[inline(always)]
fn huber_weight(squared: f64, threshold: f64) -> f64 {
    if squared <= threshold * threshold { 1.0 } else { threshold / squared.sqrt() }
}

#[inline(always)]
fn huber_cost(squared: f64, threshold: f64) -> f64 {
    if squared <= threshold * threshold {
        squared
    } else {
        threshold * (2.0 * squared.sqrt() - threshold)
    }
}

/// How a descent ended.
pub(super) struct Descent {
    pub iterations: usize,
    pub converged: bool,
}

/// Minimises over the kept observations, from `estimate` as it stands.
pub(super) fn descend<const D: usize>(
    part: &Part<D>,
    system: &mut ReducedSystem<D>,
    estimate: &mut Estimate,
    keep: &[bool],
    sigma: f64,
    max_iterations: usize,
) -> Result<Descent, LeastSquaresError> {
    let huber = HUBER_SIGMAS * sigma;
    let kept = keep.iter().filter(|&&k| k).count();
    let mut cost = total_cost(part, estimate, keep, huber);
    let (mut damping, mut growth) = (FIRST_DAMPING, 2.0);
    for iteration in 0..max_iterations {
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
        let (candidate, next) = take_step(part, &weights, &step, damping);
        if next < cost {
            *estimate = candidate;
            let gain = (cost - next) / cost;
            cost = next;
            damping = (damping * 0.1).max(FIRST_DAMPING);
            growth = 2.0;
            if gain < COST_TOLERANCE {
                return Ok(Descent { iterations: iteration + 1, converged: true });
            }
        } else {
            // near the minimum of exact data the cost cannot fall any further
            if (next - cost).abs() <= COST_TOLERANCE * cost || damping > 1e8 {
                return Ok(Descent { iterations: iteration + 1, converged: true });
            }
            damping = damping.max(1e-10) * growth;
            growth *= 2.0;
        }
    }
    Ok(Descent { iterations: max_iterations, converged: false })
}

/// Robust cost of the kept observations.
fn total_cost<const D: usize>(part: &Part<D>, estimate: &Estimate, keep: &[bool], huber: f64) -> f64 {
    let sums: Vec<f64> = part
        .chunks
        .par_iter()
        .map(|tracks| {
            tracks.clone().map(|j| point_cost(part, j, &estimate.centers, &estimate.points[j], keep, huber)).sum()
        })
        .collect();
    sums.iter().sum()
}

/// Robust cost of one point.
#[inline(always)]
fn point_cost<const D: usize>(
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
            let ray = &part.ray[o];
            let chord = squared_chord::<D>(ray, point, &centers[part.view[o] as usize]).0;
            cost += huber_cost(chord * ray.0[3], huber);
        }
    }
    cost
}

/// Applies a camera step, lets every point follow, and returns the new estimate with its cost.
fn take_step<const D: usize>(
    part: &Part<D>,
    weights: &NewtonWeights<'_, D>,
    step: &[Lanes],
    damping: f64,
) -> (Estimate, f64) {
    let centers: Vec<Lanes> = weights.estimate.centers.iter().zip(step).map(|(c, d)| c.plus(d)).collect();
    let mut points = vec![Lanes::ZERO; part.n_tracks()];
    let costs = for_each_chunk(part, &mut points, |tracks, out| {
        pulp::Arch::new().dispatch(
            #[inline(always)]
            || {
                let mut cost = 0.0;
                for (j, point) in tracks.zip(out) {
                    let (moved, moved_cost) = move_point(part, j, weights, step, &centers, damping);
                    *point = moved;
                    cost += moved_cost;
                }
                cost
            },
        )
    });
    (Estimate { centers, points }, costs.iter().sum())
}

/// The new position of one point after a camera step, and its cost.
#[inline(always)]
fn move_point<const D: usize>(
    part: &Part<D>,
    j: usize,
    weights: &NewtonWeights<'_, D>,
    step: &[Lanes],
    centers: &[Lanes],
    damping: f64,
) -> (Lanes, f64) {
    let old = weights.estimate.points[j];
    let mut outer = [Lanes::ZERO; D];
    let mut right = Lanes::ZERO;
    let mut weight_sum = 0.0;
    for o in part.observations(j) {
        let Quadratic { direction: d, gradient } = weights.observe(o, j);
        let shift = &step[part.view[o] as usize];
        add_outer(&mut outer, &d);
        weight_sum += d.0[3];
        right = right.plus(&gradient).plus_scaled(d.0[3], &shift.plus_scaled(-d.dot::<D>(shift), &d));
    }
    if weight_sum.is_nan() || weight_sum <= 0.0 {
        return (old, 0.0);
    }
    right.0[3] = 0.0;
    let axis = weights.depth_axis(j);
    let mut along = Lanes::ZERO;
    for (r, row) in outer.iter().enumerate() {
        along = along.plus_scaled(axis.0[r], row);
    }
    let depth_share = (weight_sum - axis.dot::<D>(&along)) / (weight_sum * (D - 1) as f64);
    let delta = PointFactor::<D>::new(weight_sum, &outer, damping, &axis).solve(&right);
    let mut moved = old.plus(&delta);
    let first = part.view[part.start[j] as usize] as usize;
    if depth_share < LOW_PARALLAX {
        moved = inverse_depth_move::<D>(&old, &delta, &axis, &weights.estimate.centers[first], &step[first]);
    }
    let cost = point_cost(part, j, centers, &moved, weights.keep, weights.huber);
    let observations = part.observations(j).len() as f64;
    let threshold = observations * weights.huber * weights.huber;
    if cost > threshold || cost.is_nan() {
        let before = point_cost(part, j, &weights.estimate.centers, &old, weights.keep, weights.huber);
        if cost.is_nan() || cost > before + 0.5 * threshold {
            return rescue(part, j, weights, step, centers, [old.plus(&delta), moved], cost);
        }
    }
    (moved, cost)
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

/// Where a point's cost jumped: the best of its step, the Euclidean step, a shift with its views, a new triangulation.
#[cold]
fn rescue<const D: usize>(
    part: &Part<D>,
    j: usize,
    weights: &NewtonWeights<'_, D>,
    step: &[Lanes],
    centers: &[Lanes],
    [euclidean, moved]: [Lanes; 2],
    cost: f64,
) -> (Lanes, f64) {
    let count = part.observations(j).len() as f64;
    let mut shift = Lanes::ZERO;
    let mut outer = [Lanes::ZERO; D];
    let mut right = Lanes::ZERO;
    let mut weight_sum = 0.0;
    for o in part.observations(j) {
        shift = shift.plus_scaled(1.0 / count, &step[part.view[o] as usize]);
        if weights.keep[o] {
            let center = &centers[part.view[o] as usize];
            let (_, reciprocal) = squared_chord::<D>(&part.ray[o], &moved, center);
            let mut d = part.ray[o];
            d.0[3] *= reciprocal * reciprocal;
            add_outer(&mut outer, &d);
            weight_sum += d.0[3];
            right = right.plus_scaled(d.0[3], &center.plus_scaled(-d.dot::<D>(center), &d));
        }
    }
    right.0[3] = 0.0;
    let factor = PointFactor::<D>::new(weight_sum.max(f64::MIN_POSITIVE), &outer, 0.0, &Lanes::ZERO);
    let mut best = (moved, if cost.is_nan() { f64::INFINITY } else { cost });
    for candidate in [euclidean, weights.estimate.points[j].plus(&shift), factor.solve(&right)] {
        let candidate_cost = point_cost(part, j, centers, &candidate, weights.keep, weights.huber);
        if candidate_cost < best.1 {
            best = (candidate, candidate_cost);
        }
    }
    best
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
                    let ray = &part.ray[o];
                    let center = &estimate.centers[part.view[o] as usize];
                    out.push((squared_chord::<D>(ray, &estimate.points[j], center).0 * ray.0[3]).sqrt());
                }
            }
            out
        })
        .collect();
    track_chords.concat()
}

/// Noise estimate from the median chord of the observations for which `among` holds.
pub(super) fn noise_scale<const D: usize>(chords: &[f64], among: impl Fn(usize) -> bool) -> f64 {
    let step = (chords.len() / 200_000).max(1);
    let mut sample: Vec<f64> = (0..chords.len()).step_by(step).filter(|&o| among(o)).map(|o| chords[o]).collect();
    (median(&mut sample) / median_over_sigma(D)).max(SIGMA_FLOOR_RAD)
}

/// Observations within [`OUTLIER_SIGMAS`] of their prediction, of points that keep at least two views.
pub(super) fn inliers<const D: usize>(part: &Part<D>, chords: &[f64], sigma: f64) -> Vec<bool> {
    let limit = OUTLIER_SIGMAS * sigma;
    let mut keep: Vec<bool> = chords.iter().map(|&e| e < limit).collect();
    for j in 0..part.n_tracks() {
        let observations = part.observations(j);
        let mut kept = observations.clone().filter(|&o| keep[o]).map(|o| part.view[o]);
        let first = kept.next();
        if kept.all(|view| Some(view) == first) {
            keep[observations].fill(false);
        }
    }
    keep
}
