//! A start without any initial guess: linear steps under a linear gauge, re-weighted until the noise scale settles.
//!
//! One step solves `min sum w |(I - v v^T)(x - c)|^2` subject to `sum omega v^T (x - c) = 1`, which is one solve with
//! the reduced system. The first weights come from parallax alone; later ones are Geman-McClure in the chord
//! `e = |v - (x - c)/r|`: `w = (1 + e^2/s^2)^-2 / r^2`, `omega = w r`.

use super::PositionSystem;
use crate::bundle::estimate::{Estimate, normalise, squared_chord, squared_error, weighted_ray};
use crate::bundle::noise::{median, sigma_from_chords};
use crate::bundle::part::{Lanes, Part, for_each_chunk};
use crate::bundle::reduced::{Damping, PointSum, Quadratic, Translations, Weighing};
use crate::least_squares::LeastSquaresError;

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
    /// Points nearer than this weigh no more than at this distance.
    nearest: f64,
}

impl<const D: usize> Weighing<D> for RobustWeights<'_, D> {
    #[inline(always)]
    fn observe(&self, o: usize, j: usize) -> Quadratic {
        let ray = &self.part.ray[o];
        let center = &self.estimate.centers[self.part.view[o] as usize];
        let (chord, reciprocal) = squared_chord::<D>(ray, &self.estimate.points[j], center);
        let root = 1.0 / (1.0 + ray.0[3] * chord * self.inverse_scale_squared);
        let reciprocal = reciprocal.min(1.0 / self.nearest);
        let omega = root * root * reciprocal;
        weighted_ray(ray, omega * reciprocal, omega)
    }

    #[inline(always)]
    fn depth_axis(&self, j: usize) -> Lanes {
        self.part.ray[self.part.start[j] as usize]
    }
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
    system: &mut PositionSystem<D>,
    weighing: &impl Weighing<D>,
) -> Result<Estimate, LeastSquaresError> {
    system.assemble(part, weighing, &Translations, &[], LINEAR_DAMPING);
    let mut centers: Vec<Lanes> = system.solve()?.iter().map(Lanes::from_vector::<D>).collect();
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

/// Noise estimate in units of the reference sigma's radian, over at most some 20,000 observations of evenly spaced tracks.
fn noise_of<const D: usize>(part: &Part<D>, estimate: &Estimate) -> f64 {
    let tracks_per_sample = part.n_tracks().div_ceil(4_000);
    let mut chords: Vec<f64> = (0..part.n_tracks())
        .step_by(tracks_per_sample.max(1))
        .flat_map(|j| part.observations(j).map(move |o| (o, j)))
        .map(|(o, j)| squared_error(part, o, &estimate.centers, &estimate.points[j]).sqrt())
        .collect();
    let unknowns = D * part.n_tracks() + part.camera_freedom();
    sigma_from_chords::<D>(&mut chords, part.n_observations(), unknowns)
}

/// A start and the linear steps it took.
pub(super) struct Start {
    pub estimate: Estimate,
    pub steps: usize,
}

/// Linear start from parallax weights, and re-weighting.
pub(super) fn robust_start<const D: usize>(
    part: &Part<D>,
    system: &mut PositionSystem<D>,
    even: bool,
) -> Result<Start, LeastSquaresError> {
    let estimate = linear_step(part, system, &parallax_weights(part))?;
    reweighted(part, system, estimate, even)
}

/// Middle one of the distances of all points from their first views.
fn middle_distance<const D: usize>(part: &Part<D>, estimate: &Estimate) -> f64 {
    let distance = |j: usize| {
        let u = estimate.points[j].minus(&estimate.centers[part.view[part.start[j] as usize] as usize]);
        u.dot::<D>(&u).sqrt()
    };
    median(&mut (0..part.n_tracks()).map(distance).collect::<Vec<f64>>())
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
    system: &mut PositionSystem<D>,
    weights: StartWeights,
) -> Result<Estimate, LeastSquaresError> {
    match weights {
        StartWeights::Parallax => linear_step(part, system, &parallax_weights(part)),
        StartWeights::Equal => linear_step(part, system, &TrackWeights { part, weight: vec![1.0; part.n_tracks()] }),
    }
}

fn reweighted<const D: usize>(
    part: &Part<D>,
    system: &mut PositionSystem<D>,
    mut estimate: Estimate,
    even: bool,
) -> Result<Start, LeastSquaresError> {
    let mut previous = f64::INFINITY;
    for round in 1..=MAX_ROUNDS {
        let scale = (SCALE_OVER_SIGMA * noise_of(part, &estimate)).max(SCALE_FLOOR_RAD);
        if (scale / previous - 1.0).abs() < SCALE_TOLERANCE {
            return Ok(Start { estimate, steps: round });
        }
        previous = scale;
        let nearest = if even { middle_distance(part, &estimate) } else { f64::MIN_POSITIVE };
        let weights =
            RobustWeights { part, estimate: &estimate, inverse_scale_squared: 1.0 / (scale * scale), nearest };
        estimate = linear_step(part, system, &weights)?;
    }
    Ok(Start { estimate, steps: MAX_ROUNDS + 1 })
}
