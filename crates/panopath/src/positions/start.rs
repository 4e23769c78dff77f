//! A start without any initial guess: linear steps under a linear gauge, re-weighted until the noise scale settles.
//!
//! One step solves `min sum w |(I - v v^T)(x - c)|^2` subject to `sum omega v^T (x - c) = 1`, which is one solve with
//! the reduced system. The first weights come from parallax alone; later ones are Geman-McClure in the chord
//! `e = |v - (x - c)/r|`: `w = (1 + e^2/s^2)^-2 / r^2`, `omega = w r`.

use rayon::prelude::*;

use super::part::{Lanes, Part};
use super::reduced::{Damping, PointSum, Quadratic, ReducedSystem, Weighing};
use crate::least_squares::LeastSquaresError;

/// Where the solver stands: camera centres and points of one part.
#[derive(Clone)]
pub(super) struct Estimate {
    pub centers: Vec<Lanes>,
    pub points: Vec<Lanes>,
}

impl Estimate {
    /// Nothing known.
    pub fn nowhere<const D: usize>(part: &Part<D>) -> Self {
        let nan = Lanes([f64::NAN; 4]);
        Self { centers: vec![nan; part.n_views], points: vec![nan; part.n_tracks()] }
    }
}

impl Estimate {
    /// The same with every position that is not finite found from the others: a camera from the points it sees, then a
    /// point from the cameras that see it. `None` where a camera sees too few known points.
    pub fn completed<const D: usize>(mut self, part: &Part<D>) -> Option<Self> {
        let known = |x: &Lanes| x.vector::<D>().iter().all(|v| v.is_finite());
        let missing: Vec<bool> = self.centers.iter().map(|c| !known(c)).collect();
        if missing.iter().any(|&m| m) {
            let mut seen: Vec<(PointSum<D>, Lanes)> =
                (0..part.n_views).map(|_| (PointSum::new(), Lanes::ZERO)).collect();
            for j in (0..part.n_tracks()).filter(|&j| known(&self.points[j])) {
                for o in part.observations(j).filter(|&o| missing[part.view[o] as usize]) {
                    let (sum, right) = &mut seen[part.view[o] as usize];
                    let model = weighted_ray(&part.ray[o], 1.0, 0.0);
                    sum.add(&model);
                    *right = right.plus(&model.apply::<D>(&self.points[j]));
                }
            }
            for (view, (sum, right)) in seen.iter().enumerate().filter(|(view, _)| missing[*view]) {
                self.centers[view] = sum.factor(0.0, &Lanes::ZERO).solve(right);
                if sum.weight_sum <= 0.0 || !known(&self.centers[view]) {
                    return None;
                }
            }
        }
        for j in (0..part.n_tracks()).filter(|&j| !known(&self.points[j])).collect::<Vec<_>>() {
            let mut sum = PointSum::<D>::new();
            let mut right = Lanes::ZERO;
            for o in part.observations(j) {
                let model = weighted_ray(&part.ray[o], 1.0, 0.0);
                sum.add(&model);
                right = right.plus(&model.apply::<D>(&self.centers[part.view[o] as usize]));
            }
            self.points[j] = sum.factor(0.0, &Lanes::ZERO).solve(&right);
        }
        Some(self)
    }
}

/// Smallest noise scale, in radians: keeps weights finite on exact data.
const SCALE_FLOOR_RAD: f64 = 2e-4;
/// The scale is this multiple of the noise: twice the median of a chord.
const SCALE_OVER_SIGMA: f64 = 2.35;
/// No track starts with more than this multiple of the median weight: bodies that pass close by move, as often as not.
const LARGEST_WEIGHT: f64 = 4.0;
/// Re-weighting stops when the scale changes by less than this.
const SCALE_TOLERANCE: f64 = 0.05;
/// More rounds make long open chains drift.
const MAX_ROUNDS: usize = 10;
/// Damping of the linear steps; only guards the factorisation, since exact data leaves the scale as a null vector.
const LINEAR_DAMPING: Damping = Damping { point: 0.0, view: 1e-12 };

/// Runs `task` over the chunks of a part in parallel, each with its own slice of `out` (one entry per track).
pub(super) fn for_each_chunk<T: Send, const D: usize>(
    part: &Part<D>,
    out: &mut [T],
    task: impl Fn(std::ops::Range<usize>, &mut [T]) + Sync,
) {
    let mut pieces = Vec::with_capacity(part.chunks.len());
    let mut rest = out;
    for tracks in &part.chunks {
        let (piece, tail) = rest.split_at_mut(tracks.len());
        pieces.push((tracks.clone(), piece));
        rest = tail;
    }
    pieces.into_par_iter().for_each(|(tracks, piece)| task(tracks, piece));
}

/// Squared chord between the ray and the predicted direction, and the reciprocal distance.
#[inline(always)]
pub(super) fn squared_chord<const D: usize>(ray: &Lanes, point: &Lanes, center: &Lanes) -> (f64, f64) {
    let u = point.minus(center);
    let reciprocal = 1.0 / u.dot::<D>(&u).sqrt().max(f64::MIN_POSITIVE);
    let error = ray.plus_scaled(-reciprocal, &u);
    (error.dot::<D>(&error), reciprocal)
}

/// Squared chord of an observation of a point, times its precision.
#[inline(always)]
pub(super) fn squared_error<const D: usize>(part: &Part<D>, o: usize, centers: &[Lanes], point: &Lanes) -> f64 {
    let ray = &part.ray[o];
    squared_chord::<D>(ray, point, &centers[part.view[o] as usize]).0 * ray.0[3]
}

/// One weight for each track, which needs no positions.
struct TrackWeights<'a, const D: usize> {
    part: &'a Part<D>,
    weight: Vec<f64>,
}

impl<const D: usize> Weighing<D> for TrackWeights<'_, D> {
    #[inline(always)]
    fn observe(&self, o: usize, j: usize) -> Quadratic {
        weighted_ray(&self.part.ray[o], self.weight[j], self.weight[j])
    }

    #[inline(always)]
    fn depth_axis(&self, j: usize) -> Lanes {
        self.part.ray[self.part.start[j] as usize]
    }
}

/// Geman-McClure weights at an estimate.
struct RobustWeights<'a, const D: usize> {
    part: &'a Part<D>,
    estimate: &'a Estimate,
    inverse_scale_squared: f64,
}

impl<const D: usize> Weighing<D> for RobustWeights<'_, D> {
    #[inline(always)]
    fn observe(&self, o: usize, j: usize) -> Quadratic {
        let ray = &self.part.ray[o];
        let center = &self.estimate.centers[self.part.view[o] as usize];
        let (chord, reciprocal) = squared_chord::<D>(ray, &self.estimate.points[j], center);
        let root = 1.0 / (1.0 + ray.0[3] * chord * self.inverse_scale_squared);
        let omega = root * root * reciprocal;
        weighted_ray(ray, omega * reciprocal, omega)
    }

    #[inline(always)]
    fn depth_axis(&self, j: usize) -> Lanes {
        self.part.ray[self.part.start[j] as usize]
    }
}

/// Model of an observation in the linear step; both weights are multiplied by the ray's precision.
#[inline(always)]
fn weighted_ray(ray: &Lanes, weight: f64, omega: f64) -> Quadratic {
    let precision = ray.0[3];
    let mut direction = *ray;
    direction.0[3] = weight * precision;
    let mut gradient = ray.times(omega * precision);
    gradient.0[3] = 0.0;
    Quadratic { direction, gradient }
}

/// Smallest eigenvalue of `sum (I - v v^T)` over the number of rays, the mean squared parallax of each track, turned into
/// a weight: what noise alone would give is taken off. With unit weights, points at infinity would collapse the start.
fn parallax_weights<const D: usize>(part: &Part<D>) -> TrackWeights<'_, D> {
    let noise = SCALE_FLOOR_RAD * SCALE_FLOOR_RAD;
    let mut weight = vec![0.0; part.n_tracks()];
    for_each_chunk(part, &mut weight, |tracks, out| {
        for (j, q) in tracks.zip(out) {
            let observations = part.observations(j);
            let count = observations.len() as f64;
            let mut outer = [[0.0; 3]; 3];
            for o in observations {
                let v = &part.ray[o].0;
                for r in 0..D {
                    for c in 0..D {
                        outer[r][c] += v[r] * v[c];
                    }
                }
            }
            let parallax = (1.0 - largest_eigenvalue(&outer) / count).max(0.0);
            *q = (parallax - noise).max(1e-3 * noise);
        }
    });
    let mut beyond_noise: Vec<f64> = weight.iter().copied().filter(|&q| q > 2.0 * noise).collect();
    let cap = if beyond_noise.is_empty() { f64::INFINITY } else { LARGEST_WEIGHT * median(&mut beyond_noise) };
    weight.iter_mut().for_each(|q| *q = q.min(cap));
    TrackWeights { part, weight }
}

/// Largest eigenvalue of a symmetric 3 x 3 matrix (trigonometric solution of the cubic).
fn largest_eigenvalue(m: &[[f64; 3]; 3]) -> f64 {
    let mean = (m[0][0] + m[1][1] + m[2][2]) / 3.0;
    let off = m[0][1].powi(2) + m[0][2].powi(2) + m[1][2].powi(2);
    let (a, b, c) = (m[0][0] - mean, m[1][1] - mean, m[2][2] - mean);
    let p = ((a * a + b * b + c * c + 2.0 * off) / 6.0).sqrt();
    if p == 0.0 {
        return mean;
    }
    let det = a * (b * c - m[1][2] * m[1][2]) - m[0][1] * (m[0][1] * c - m[1][2] * m[0][2])
        + m[0][2] * (m[0][1] * m[1][2] - b * m[0][2]);
    let angle = (det / (2.0 * p * p * p)).clamp(-1.0, 1.0).acos() / 3.0;
    mean + 2.0 * p * angle.cos()
}

/// One linear step: centres from the reduced system, points from back-substitution, rms distance of the centres one.
fn linear_step<const D: usize>(
    part: &Part<D>,
    system: &mut ReducedSystem<D>,
    weighing: &impl Weighing<D>,
) -> Result<Estimate, LeastSquaresError> {
    system.assemble(part, weighing, LINEAR_DAMPING);
    let mut centers = system.solve()?;
    let scale = normalise(&mut centers);
    let mut points = vec![Lanes::ZERO; part.n_tracks()];
    for_each_chunk(part, &mut points, |tracks, points| {
        pulp::Arch::new().dispatch(Triangulation { part, tracks, centers: &centers, scale, weighing, points });
    });
    Ok(Estimate { centers, points })
}

/// Triangulates a chunk of tracks; see [`Elimination`](super::reduced) for why this is no closure.
struct Triangulation<'a, const D: usize, W> {
    part: &'a Part<D>,
    tracks: std::ops::Range<usize>,
    centers: &'a [Lanes],
    scale: f64,
    weighing: &'a W,
    points: &'a mut [Lanes],
}

impl<const D: usize, W: Weighing<D>> pulp::WithSimd for Triangulation<'_, D, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        for (j, point) in self.tracks.zip(self.points) {
            *point = triangulate(self.part, j, self.centers, self.scale, self.weighing);
        }
    }
}

/// The point that minimises the models of its observations, given the centres. `scale` is that of the gradients.
#[inline(always)]
fn triangulate<const D: usize>(
    part: &Part<D>,
    j: usize,
    centers: &[Lanes],
    scale: f64,
    weighing: &impl Weighing<D>,
) -> Lanes {
    let mut sum = PointSum::<D>::new();
    let mut right = Lanes::ZERO;
    for o in part.observations(j) {
        let model = weighing.observe(o, j);
        sum.add(&model);
        right = right.plus(&model.apply::<D>(&centers[part.view[o] as usize]));
    }
    sum.factor(0.0, &Lanes::ZERO).solve(&right.plus_scaled(scale, &sum.gradient))
}

/// Moves the centroid to zero and scales to rms distance one; returns the factor applied.
pub(super) fn normalise(centers: &mut [Lanes]) -> f64 {
    let n = centers.len() as f64;
    let centroid = centers.iter().fold(Lanes::ZERO, |sum, c| sum.plus(c)).times(1.0 / n);
    let squared: f64 = centers.iter().map(|c| c.minus(&centroid)).map(|c| c.dot::<3>(&c)).sum();
    let scale = if squared > 0.0 { (n / squared).sqrt() } else { 1.0 };
    for center in centers {
        *center = center.minus(&centroid).times(scale);
    }
    scale
}

/// Noise of one tangent direction from the chords of some observations that `unknowns` were fitted to.
///
/// A fit with few degrees of freedom makes many residuals vanish: a share `1 - freedom` of them can be zero whatever the
/// noise. The quantile that is looked at lies beyond these, and the residuals that remain are scaled up to the noise.
pub(super) fn sigma_from_chords<const D: usize>(chords: &mut [f64], n_observations: usize, unknowns: usize) -> f64 {
    let equations = ((D - 1) * n_observations) as f64;
    let freedom = ((equations - unknowns as f64) / equations).clamp(LEAST_FREEDOM, 1.0);
    let share = (1.0 - BEYOND_FITTED * freedom).max(0.5);
    let place = ((share * chords.len() as f64) as usize).min(chords.len().saturating_sub(1));
    if chords.is_empty() {
        return 0.0;
    }
    let quantile = *chords.select_nth_unstable_by(place, f64::total_cmp).1;
    quantile / (freedom.sqrt() * normal_quantile(D, share))
}

/// Share of degrees of freedom below which the noise estimate is not corrected any further.
const LEAST_FREEDOM: f64 = 0.05;
/// The quantile looked at is one less this share of the freedom, and the median at least.
const BEYOND_FITTED: f64 = 0.75;

/// Length that a share of normal vectors of `d - 1` unit components stays below.
fn normal_quantile(d: usize, share: f64) -> f64 {
    if d == 3 {
        return (-2.0 * (1.0 - share).ln()).sqrt();
    }
    // one component: invert the error function (Winitzki's approximation, good to 0.2 %)
    let (a, log) = (0.147, (1.0 - share * share).ln());
    let half = 2.0 / (std::f64::consts::PI * a) + 0.5 * log;
    std::f64::consts::SQRT_2 * ((half * half - log / a).sqrt() - half).sqrt()
}

/// Noise estimate in units of the reference sigma's radian, over at most some 20,000 observations of evenly spaced tracks.
fn noise_of<const D: usize>(part: &Part<D>, estimate: &Estimate) -> f64 {
    let tracks_per_sample = part.n_tracks().div_ceil(4_000);
    let mut chords: Vec<f64> = (0..part.n_tracks())
        .step_by(tracks_per_sample.max(1))
        .flat_map(|j| part.observations(j).map(move |o| (o, j)))
        .map(|(o, j)| squared_error(part, o, &estimate.centers, &estimate.points[j]).sqrt())
        .collect();
    let unknowns = D * (part.n_tracks() + part.n_views) - D - 1;
    sigma_from_chords::<D>(&mut chords, part.n_observations(), unknowns)
}

/// Median; zero of nothing. Reorders its argument.
pub(super) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// A start and the linear steps it took.
pub(super) struct Start {
    pub estimate: Estimate,
    pub steps: usize,
}

/// Linear start from parallax weights, and re-weighting.
pub(super) fn robust_start<const D: usize>(
    part: &Part<D>,
    system: &mut ReducedSystem<D>,
) -> Result<Start, LeastSquaresError> {
    let estimate = linear_step(part, system, &parallax_weights(part))?;
    reweighted(part, system, estimate)
}

/// Weights of a single linear step.
#[derive(Clone, Copy)]
pub(super) enum StartWeights {
    Parallax,
    Equal,
}

/// The start of a single linear step, without re-weighting.
pub(super) fn linear_start<const D: usize>(
    part: &Part<D>,
    system: &mut ReducedSystem<D>,
    weights: StartWeights,
) -> Result<Estimate, LeastSquaresError> {
    match weights {
        StartWeights::Parallax => linear_step(part, system, &parallax_weights(part)),
        StartWeights::Equal => linear_step(part, system, &TrackWeights { part, weight: vec![1.0; part.n_tracks()] }),
    }
}

fn reweighted<const D: usize>(
    part: &Part<D>,
    system: &mut ReducedSystem<D>,
    mut estimate: Estimate,
) -> Result<Start, LeastSquaresError> {
    let mut previous = f64::INFINITY;
    for round in 1..=MAX_ROUNDS {
        let scale = (SCALE_OVER_SIGMA * noise_of(part, &estimate)).max(SCALE_FLOOR_RAD);
        if (scale / previous - 1.0).abs() < SCALE_TOLERANCE {
            return Ok(Start { estimate, steps: round });
        }
        previous = scale;
        let weights = RobustWeights { part, estimate: &estimate, inverse_scale_squared: 1.0 / (scale * scale) };
        estimate = linear_step(part, system, &weights)?;
    }
    Ok(Start { estimate, steps: MAX_ROUNDS + 1 })
}

/// Distance, in baselines of the track, beyond which depth means nothing.
pub(super) const FAR: f64 = 300.0;

/// Moves points that lie behind most of their views, or farther than [`FAR`] baselines of their track, to that distance
/// along the mean ray.
pub(super) fn repair_cheirality<const D: usize>(part: &Part<D>, estimate: &mut Estimate) {
    let Estimate { centers, points } = estimate;
    for_each_chunk(part, points, |tracks, out| {
        for (j, point) in tracks.zip(out) {
            let observations = part.observations(j);
            let count = observations.len() as f64;
            let (mut middle, mut ray) = (Lanes::ZERO, Lanes::ZERO);
            let mut behind = 0;
            for o in observations.clone() {
                let center = &centers[part.view[o] as usize];
                middle = middle.plus_scaled(1.0 / count, center);
                ray = ray.plus(&part.ray[o]);
                behind += usize::from(
                    part.ray[o].dot::<D>(&point.minus(center)).is_nan()
                        || part.ray[o].dot::<D>(&point.minus(center)) <= 0.0,
                );
            }
            let distance = |a: &Lanes| a.minus(&middle).dot::<D>(&a.minus(&middle)).sqrt();
            let baseline = observations.map(|o| distance(&centers[part.view[o] as usize])).fold(0.0, f64::max);
            let far = FAR * baseline;
            if 2 * behind > count as usize || distance(point) > far {
                let length = ray.dot::<D>(&ray).sqrt().max(f64::MIN_POSITIVE);
                *point = middle.plus_scaled(far / length, &ray);
                point.0[3] = 0.0;
            }
        }
    });
}
