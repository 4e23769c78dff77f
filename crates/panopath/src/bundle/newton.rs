//! Gauss-Newton on the sphere for `min sum rho(|v - (x - c)/r| / sigma)`, Huber's rho: what a single point does.
//!
//! The model of an observation is `M = p (I - u u^T)/r^2`, `u` the predicted direction. A point of low parallax steps in
//! inverse depth; a point whose cost rises is fitted again to the moved cameras.

use super::estimate::{Estimate, squared_error};
use super::noise::HUBER_SIGMAS;
use super::part::{Lanes, Part, for_each_chunk};
use super::reduced::{PointFactor, PointSum, Quadratic, Weighing};

/// Damping of the first step, relative to the diagonal.
pub(crate) const FIRST_DAMPING: f64 = 1e-12;
/// A point whose normal matrix holds less than this share of its trace in depth steps in inverse depth.
const LOW_PARALLAX: f64 = 0.05;
/// A point whose squared error rises by more than this, in units of sigma, is fitted again to the moved cameras.
const POINT_RISE: f64 = 0.5;
/// Steps of such a fit.
const POINT_ITERATIONS: usize = 4;

/// Which observations count, and how much.
#[derive(Clone, Copy)]
pub(crate) struct Residuals<'a, const D: usize> {
    pub part: &'a Part<D>,
    pub keep: &'a [bool],
    /// Huber's threshold, in radians at the reference sigma.
    pub huber: f64,
}

impl<'a, const D: usize> Residuals<'a, D> {
    /// The observations in `keep`, with Huber's threshold at its multiple of `sigma`.
    pub fn new(part: &'a Part<D>, keep: &'a [bool], sigma: f64) -> Self {
        Self { part, keep, huber: HUBER_SIGMAS * sigma }
    }

    /// Model of observation `o` of a point seen from a centre.
    #[inline(always)]
    pub fn model(&self, o: usize, point: &Lanes, center: &Lanes) -> Quadratic {
        chord_model::<D>(&self.part.ray[o], point, center, self.keep[o], self.huber)
    }

    /// Robust cost of one point.
    #[inline(always)]
    pub fn cost(&self, j: usize, centers: &[Lanes], point: &Lanes) -> f64 {
        let mut cost = 0.0;
        for o in self.part.observations(j) {
            if self.keep[o] {
                cost += huber_cost(squared_error(self.part, o, centers, point), self.huber);
            }
        }
        cost
    }

    /// Robust cost of each point.
    pub fn costs(&self, estimate: &Estimate) -> Vec<f64> {
        let mut costs = vec![0.0; self.part.n_tracks()];
        for_each_chunk(self.part, &mut costs, |tracks, out| {
            for (j, cost) in tracks.zip(out) {
                *cost = self.cost(j, &estimate.centers, &estimate.points[j]);
            }
        });
        costs
    }
}

/// Model of a ray's chord to a point seen from a centre; without weight where it is not kept.
#[inline(always)]
pub(crate) fn chord_model<const D: usize>(
    ray: &Lanes,
    point: &Lanes,
    center: &Lanes,
    keep: bool,
    huber: f64,
) -> Quadratic {
    let u = point.minus(center);
    let reciprocal = 1.0 / u.dot::<D>(&u).sqrt().max(f64::MIN_POSITIVE);
    let mut direction = u.times(reciprocal);
    let error = ray.minus(&direction);
    let chord = error.dot::<D>(&error) * ray.0[3];
    let rho = if keep { ray.0[3] * huber_weight(chord, huber) } else { 0.0 };
    let along = ray.dot::<D>(&direction);
    let mut gradient = ray.plus_scaled(-along, &direction).times(rho * reciprocal);
    gradient.0[3] = 0.0;
    direction.0[3] = rho * reciprocal * reciprocal;
    Quadratic { direction, gradient }
}

/// Gauss-Newton's model of each observation at an estimate.
pub(crate) struct NewtonWeights<'a, const D: usize> {
    pub residuals: Residuals<'a, D>,
    pub estimate: &'a Estimate,
}

impl<'a, const D: usize> NewtonWeights<'a, D> {
    /// Weights at an estimate for the observations in `keep`, Huber's threshold at its multiple of `sigma`.
    pub fn new(part: &'a Part<D>, estimate: &'a Estimate, keep: &'a [bool], sigma: f64) -> Self {
        Self { residuals: Residuals::new(part, keep, sigma), estimate }
    }
}

impl<const D: usize> Weighing<D> for NewtonWeights<'_, D> {
    #[inline(always)]
    fn observe(&self, o: usize, j: usize) -> Quadratic {
        let station = self.residuals.part.view[o] as usize;
        self.residuals.model(o, &self.estimate.points[j], &self.estimate.centers[station])
    }

    #[inline(always)]
    fn depth_axis(&self, j: usize) -> Lanes {
        let part = self.residuals.part;
        let first = part.view[part.start[j] as usize] as usize;
        unit::<D>(&self.estimate.points[j].minus(&self.estimate.centers[first]))
    }
}

#[inline(always)]
pub(crate) fn huber_weight(squared: f64, threshold: f64) -> f64 {
    if squared <= threshold * threshold { 1.0 } else { threshold / squared.sqrt() }
}

#[inline(always)]
pub(crate) fn huber_cost(squared: f64, threshold: f64) -> f64 {
    if squared <= threshold * threshold { squared } else { threshold * (2.0 * squared.sqrt() - threshold) }
}

/// Sum of one number for each track, chunk by chunk.
pub(crate) fn sum_in_chunks<const D: usize>(part: &Part<D>, values: &[f64]) -> f64 {
    part.chunks.iter().map(|tracks| values[tracks.clone()].iter().sum::<f64>()).sum()
}

/// A step of the cameras, as the points see it.
pub(crate) trait CameraStep: Sync {
    /// How the origin of the rays of a station moves, to first order, as seen from a point: a turn of the camera about
    /// itself is a move across the line of sight.
    fn displacement(&self, station: usize, point: &Lanes) -> Lanes;
}

/// Centres that move, and nothing else.
pub(crate) struct Shifts(pub Vec<Lanes>);

impl CameraStep for Shifts {
    #[inline(always)]
    fn displacement(&self, station: usize, _point: &Lanes) -> Lanes {
        self.0[station]
    }
}

/// Lets every point follow a step of the cameras, which takes them to the rays of `after` and to `centers`; returns the
/// points with the cost of each.
pub(crate) fn follow_cameras<const D: usize>(
    weights: &NewtonWeights<'_, D>,
    costs: &[f64],
    step: &impl CameraStep,
    after: &Part<D>,
    centers: &[Lanes],
    damping: f64,
) -> (Vec<Lanes>, Vec<f64>) {
    let after = Residuals { part: after, ..weights.residuals };
    let mut moved = vec![(Lanes::ZERO, 0.0); after.part.n_tracks()];
    for_each_chunk(after.part, &mut moved, |tracks, moved| {
        pulp::Arch::new().dispatch(PointMoves { tracks, weights, costs, step, after, centers, damping, moved });
    });
    moved.into_iter().unzip()
}

/// Moves a chunk of points; see [`Elimination`](super::reduced) for why this is no closure.
struct PointMoves<'a, const D: usize, S> {
    tracks: std::ops::Range<usize>,
    weights: &'a NewtonWeights<'a, D>,
    costs: &'a [f64],
    step: &'a S,
    after: Residuals<'a, D>,
    centers: &'a [Lanes],
    damping: f64,
    moved: &'a mut [(Lanes, f64)],
}

impl<const D: usize, S: CameraStep> pulp::WithSimd for PointMoves<'_, D, S> {
    type Output = ();

    #[inline(always)]
    fn with_simd<I: pulp::Simd>(self, _: I) {
        let Self { tracks, weights, costs, step, after, centers, damping, moved } = self;
        for (j, moved) in tracks.zip(moved) {
            *moved = move_point(j, weights, costs[j], step, &after, centers, damping);
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

/// Cameras that stay where they are.
struct Still;

impl CameraStep for Still {
    #[inline(always)]
    fn displacement(&self, _station: usize, _point: &Lanes) -> Lanes {
        Lanes::ZERO
    }
}

/// Sums the models of a point's observations under a step of the cameras. `None` where nothing is kept.
#[inline(always)]
fn point_model<const D: usize>(
    residuals: &Residuals<'_, D>,
    j: usize,
    point: &Lanes,
    centers: &[Lanes],
    step: &impl CameraStep,
    damping: f64,
) -> Option<PointModel<D>> {
    let part = residuals.part;
    let mut sum = PointSum::<D>::new();
    let mut pull = Lanes::ZERO;
    for o in part.observations(j) {
        let station = part.view[o] as usize;
        let model = residuals.model(o, point, &centers[station]);
        sum.add(&model);
        pull = pull.plus(&model.apply::<D>(&step.displacement(station, point)));
    }
    if sum.is_empty() {
        return None;
    }
    let axis = unit::<D>(&point.minus(&centers[part.view[part.start[j] as usize] as usize]));
    let depth_share = sum.along(&axis) / (sum.weight_sum * (D - 1) as f64);
    Some(PointModel { factor: sum.factor(damping, &axis), gradient: sum.gradient.plus(&pull), axis, depth_share })
}

/// How a point follows small displacements of the cameras; `None` where nothing of it is kept.
pub(crate) fn point_displacement<const D: usize>(
    weights: &NewtonWeights<'_, D>,
    j: usize,
    step: &impl CameraStep,
) -> Option<Lanes> {
    let Estimate { centers, points } = weights.estimate;
    let still = point_model(&weights.residuals, j, &points[j], centers, &Still, FIRST_DAMPING)?;
    let moved = point_model(&weights.residuals, j, &points[j], centers, step, FIRST_DAMPING)?;
    Some(still.factor.solve(&moved.gradient.minus(&still.gradient)))
}

#[inline(always)]
fn unit<const D: usize>(u: &Lanes) -> Lanes {
    u.times(1.0 / u.dot::<D>(u).sqrt().max(f64::MIN_POSITIVE))
}

/// The new position of one point at rest after a camera step, and its cost; one that moves is left to its own step.
#[inline(always)]
fn move_point<const D: usize>(
    j: usize,
    weights: &NewtonWeights<'_, D>,
    before: f64,
    step: &impl CameraStep,
    after: &Residuals<'_, D>,
    centers: &[Lanes],
    damping: f64,
) -> (Lanes, f64) {
    let old = weights.estimate.points[j];
    if weights.residuals.part.courses.moves(j) {
        return (old, 0.0);
    }
    let old_centers = &weights.estimate.centers;
    let Some(model) = point_model(&weights.residuals, j, &old, old_centers, step, damping) else { return (old, 0.0) };
    let delta = model.factor.solve(&model.gradient);
    let first = after.part.view[after.part.start[j] as usize] as usize;
    let moved = follow(&model, &old, &delta, &old_centers[first], &centers[first].minus(&old_centers[first]));
    let cost = after.cost(j, centers, &moved);
    let allowed = before + POINT_RISE * (after.huber / HUBER_SIGMAS).powi(2);
    if cost <= allowed { (moved, cost) } else { fit_again(j, &old, step, after, centers, [moved, old.plus(&delta)]) }
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
    j: usize,
    old: &Lanes,
    step: &impl CameraStep,
    after: &Residuals<'_, D>,
    centers: &[Lanes],
    [moved, euclidean]: [Lanes; 2],
) -> (Lanes, f64) {
    let observations = after.part.observations(j);
    let count = observations.len() as f64;
    let stations = observations.clone().map(|o| after.part.view[o] as usize);
    let shift = stations.fold(Lanes::ZERO, |sum, s| sum.plus_scaled(1.0 / count, &step.displacement(s, old)));
    let mut best = (moved, f64::INFINITY);
    let triangulated = intersect_rays(after.part, observations.filter(|&o| after.keep[o]), centers, &moved);
    for candidate in [moved, euclidean, old.plus(&shift), triangulated] {
        let cost = after.cost(j, centers, &candidate);
        if cost < best.1 {
            best = (candidate, cost);
        }
    }
    fit_point(after, j, centers, best)
}

/// Gauss-Newton on one point alone, from a position and its cost.
pub(crate) fn fit_point<const D: usize>(
    residuals: &Residuals<'_, D>,
    j: usize,
    centers: &[Lanes],
    (mut point, mut cost): (Lanes, f64),
) -> (Lanes, f64) {
    let part = residuals.part;
    let center = &centers[part.view[part.start[j] as usize] as usize];
    let mut damping = FIRST_DAMPING;
    for _ in 0..POINT_ITERATIONS {
        let Some(model) = point_model(residuals, j, &point, centers, &Still, damping) else { break };
        let delta = model.factor.solve(&model.gradient);
        let moved = follow(&model, &point, &delta, center, &Lanes::ZERO);
        let next = residuals.cost(j, centers, &moved);
        if next < cost {
            (point, cost) = (moved, next);
        } else {
            damping = damping.max(1e-3) * 10.0;
        }
    }
    (point, cost)
}

/// The point nearest to some rays, each weighted by its distance to `near`.
pub(crate) fn intersect_rays<const D: usize>(
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
