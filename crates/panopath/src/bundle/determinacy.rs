//! Is an estimate determined? The weakest mode of the cameras' Fisher information, beyond the gauge.

use super::newton::{CameraStep, NewtonWeights, point_displacement};
use super::noise::FitSize;
use super::part::{Lanes, for_each_chunk};
use super::reduced::Factorised;
use crate::geometry::{Vector, sub};
use crate::least_squares::{LeastSquaresError, inner};

/// Bearings that scatter by more than this about their best fit say nothing about positions: random directions do no worse.
pub(crate) const MEANINGLESS_RAD: f64 = 0.2;
/// An exact ambiguity seen through noise is this many times stiffer than expected, at most.
const NOISE_MULTIPLE: f64 = 5.0;
/// Tracks whose stretch is looked at, at most about twice this many.
const STRETCH_TRACKS: usize = 10_000;
/// Relative damping that keeps exact gauge freedoms factorisable.
pub(crate) const GUARD: f64 = 1e-12;
/// A mode whose movement at one standard deviation exceeds this share of the rms size of the path is not determined.
const LOOSE_MOVEMENT: f64 = 0.3;
/// A mode is held by the guard alone where its stiffness is less than this multiple of the guard's.
const GUARD_MULTIPLE: f64 = 3.0;
/// Inverse iterations; the sought mode is separated from the next by far where it matters.
const INVERSE_ITERATIONS: usize = 6;

/// Is the weakest mode beyond the gauge undetermined? Uses the system as it was assembled with the damping [`GUARD`] and
/// factorised last at this estimate; `step_of` reads the unknowns of all cameras as a step.
///
/// The mode, found by inverse iteration, is loose where
/// - fewer equations than unknowns were kept;
/// - it moves by a large share of the path (turns by as many radians) at one standard deviation;
/// - it is held by the guard's damping alone;
/// - its stiffness is no more than noise gives to an exact ambiguity: a deformation that stretches the segment of
///   observation `(i, j)` by `lambda_ij` turns it, at positions that err by the noise, by about `sigma lambda_ij`, so
///   that its squared error is `(d - 1) sum (lambda_ij - mean_j)^2` in units of sigma. (The mean over a track is taken
///   off, since a scale of its own leaves the directions of one track exact.)
pub(crate) fn weakest_mode_is_loose<const D: usize, S: CameraStep>(
    system: &impl Factorised,
    weights: &NewtonWeights<'_, D>,
    gauge: &GaugeBasis,
    step_of: impl Fn(&[f64]) -> S,
    sigma: f64,
) -> Result<bool, LeastSquaresError> {
    let (part, keep) = (weights.residuals.part, weights.residuals.keep);
    let size = FitSize::of(part, |o| keep[o]);
    if part.n_nodes < 2 && !gauge.basis.is_empty() || size.equations < size.unknowns {
        return Ok(true);
    }
    let Some(mode) = weakest_mode(system, gauge)? else { return Ok(false) };
    let stretch = stretch_of(weights, &step_of(&mode.displacement));
    let movement = sigma * (mode.stiffness * part.n_nodes as f64).powf(-0.5);
    let from_guard = mode.stiffness < GUARD_MULTIPLE * mode.guard;
    let from_noise = stretch.turned < NOISE_MULTIPLE * (D - 1) as f64 * sigma * sigma * stretch.spread;
    Ok(movement.is_nan() || movement > LOOSE_MOVEMENT || from_guard || from_noise)
}

/// A displacement of the unknowns of all cameras, free of gauge and of unit length.
struct Mode {
    displacement: Vec<f64>,
    /// Squared error that the displacement costs, points following.
    stiffness: f64,
    /// The guard's share of it.
    guard: f64,
}

/// The weakest mode, by inverse iteration; `None` where nothing but the gauge is free.
fn weakest_mode(system: &impl Factorised, gauge: &GaugeBasis) -> Result<Option<Mode>, LeastSquaresError> {
    let diagonal = system.diagonal();
    // any start with a share of every mode will do; this one is the same on every run
    let mut mode: Vec<f64> = (0..diagonal.len()).map(|k| (1.0 + 2.3 * k as f64).sin()).collect();
    let (mut stiffness, mut guard) = (f64::NAN, f64::NAN);
    for _ in 0..INVERSE_ITERATIONS {
        gauge.remove(&mut mode);
        let length = inner(&mode, &mode).sqrt();
        if length <= 0.0 {
            return Ok(None);
        }
        mode.iter_mut().for_each(|x| *x /= length);
        let pushed = mode.clone();
        clear_held(system.held(), &mut mode);
        system.solve_for(&mut mode)?;
        let energy = inner(&mode, &pushed);
        let held: f64 = mode.iter().zip(diagonal).map(|(x, d)| GUARD * d * x * x).sum();
        gauge.remove(&mut mode);
        let squared = inner(&mode, &mode);
        if squared == 0.0 {
            return Ok(None);
        }
        (stiffness, guard) = (energy / squared, held / squared);
    }
    let length = inner(&mode, &mode).sqrt();
    mode.iter_mut().for_each(|x| *x /= length);
    Ok(Some(Mode { displacement: mode, stiffness, guard }))
}

/// What a displacement of the cameras does to the kept observations, points following.
struct Stretch {
    /// Sum of squared turns of the segments.
    turned: f64,
    /// Sum of squared stretch rates, less the mean of each track.
    spread: f64,
}

fn stretch_of<const D: usize>(weights: &NewtonWeights<'_, D>, step: &impl CameraStep) -> Stretch {
    let (part, keep, estimate) = (weights.residuals.part, weights.residuals.keep, weights.estimate);
    let mut per_track = vec![(0.0, 0.0); part.n_tracks()];
    // only the ratio of the two sums matters: some tracks stand for all
    let stride = part.n_tracks().div_ceil(STRETCH_TRACKS);
    for_each_chunk(part, &mut per_track, |tracks, out| {
        for (j, sums) in tracks.zip(out).filter(|(j, _)| j % stride == 0) {
            let Some(follow) = point_displacement(weights, j, step) else { continue };
            let follow = if part.holds_point(j) { Lanes::ZERO } else { follow };
            let (mut rates, mut turned) = (Vec::new(), 0.0);
            for o in part.observations(j).filter(|&o| keep[o]) {
                let station = part.view[o] as usize;
                let u = estimate.points[j].minus(&estimate.centers[station]);
                let du = follow.minus(&step.displacement(station, &estimate.points[j]));
                let squared = u.dot::<D>(&u).max(f64::MIN_POSITIVE);
                let rate = u.dot::<D>(&du) / squared;
                let across = du.plus_scaled(-rate, &u);
                turned += across.dot::<D>(&across) / squared * part.ray[o].0[3];
                rates.push(rate);
            }
            let mean = rates.iter().sum::<f64>() / rates.len() as f64;
            *sums = (turned, rates.iter().map(|r| (r - mean).powi(2)).sum());
        }
    });
    let (turned, spread) = per_track.into_iter().fold((0.0, 0.0), |(t, s), (turned, spread)| (t + turned, s + spread));
    Stretch { turned, spread }
}

/// Motions of a whole part that no bearing tells of.
pub(crate) struct Motions<'a> {
    pub translation: bool,
    /// Axes that it may turn about; in the plane the first entry counts.
    pub axes: &'a [[f64; 3]],
    pub scale: bool,
}

impl Motions<'_> {
    /// What each of them does to the unknowns of all cameras, `V` numbers a camera: `(omega, dc)`, or `dc` where `V = D`.
    /// Turns and changes of size leave `origin` in place.
    pub fn of_cameras<const D: usize, const V: usize>(&self, centers: &[Lanes], origin: &Vector<D>) -> Vec<Vec<f64>> {
        let n_turns = V - D;
        let each = |of: &dyn Fn(Vector<D>, &mut [f64])| {
            let mut column = vec![0.0; centers.len() * V];
            for (center, unknowns) in centers.iter().zip(column.chunks_exact_mut(V)) {
                of(sub(&center.vector::<D>(), origin), unknowns);
            }
            column
        };
        let mut basis = Vec::new();
        if self.translation {
            basis.extend((0..D).map(|c| each(&|_, x| x[n_turns + c] = 1.0)));
        }
        for axis in self.axes {
            // turning the world by the axis turns a camera by its opposite
            basis.push(each(&|arm, x| {
                (0..n_turns).for_each(|k| x[k] = -axis[k]);
                x[n_turns..].copy_from_slice(&across(axis, &arm));
            }));
        }
        if self.scale {
            basis.push(each(&|arm, x| x[n_turns..].copy_from_slice(&arm)));
        }
        basis
    }
}

/// `axis x arm`; in the plane the turn by `axis[0]`.
pub(crate) fn across<const D: usize>(axis: &[f64; 3], arm: &Vector<D>) -> Vector<D> {
    if D == 2 {
        return std::array::from_fn(|c| axis[0] * if c == 0 { -arm[1] } else { arm[0] });
    }
    std::array::from_fn(|c| {
        let (i, j) = ((c + 1) % D, (c + 2) % D);
        axis[i] * arm[j] - axis[j] * arm[i]
    })
}

/// Displacements that change nothing, orthonormal.
pub(crate) struct GaugeBasis {
    basis: Vec<Vec<f64>>,
}

impl GaugeBasis {
    /// Makes the vectors orthonormal; those that depend on others fall away.
    pub fn new(vectors: Vec<Vec<f64>>) -> Self {
        const DEPENDENT: f64 = 1e-9;
        let mut gauge = Self { basis: Vec::new() };
        for mut vector in vectors {
            let before = inner(&vector, &vector).sqrt();
            gauge.remove(&mut vector);
            let length = inner(&vector, &vector).sqrt();
            if length > DEPENDENT * before {
                vector.iter_mut().for_each(|x| *x /= length);
                gauge.basis.push(vector);
            }
        }
        gauge
    }

    /// Number of freedoms.
    pub fn len(&self) -> usize {
        self.basis.len()
    }

    /// Takes the gauge out of a displacement of all cameras.
    pub fn remove(&self, x: &mut [f64]) {
        for vector in &self.basis {
            let along = inner(x, vector);
            x.iter_mut().zip(vector).for_each(|(x, g)| *x -= along * g);
        }
    }
}

/// Clears unknowns that are held.
pub(crate) fn clear_held(held: &[bool], x: &mut [f64]) {
    x.iter_mut().zip(held).filter(|(_, held)| **held).for_each(|(x, _)| *x = 0.0);
}
