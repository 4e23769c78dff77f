//! What the noise lets one know: the Fisher information of the centres, its weakest mode and its inverse.
//!
//! At an estimate, the reduced system assembled with weights `1/sigma^2` is the Fisher information of the camera centres
//! with the points eliminated. Its inverse, in the gauge of a fit by translation and scale over the cameras, bounds the
//! covariance of any unbiased estimate (Cramer and Rao).

use super::options::PositionError;
use super::{Members, PositionSystem, Rays, position_system};
use crate::bundle::estimate::{Estimate, normalise};
use crate::bundle::newton::{NewtonWeights, point_displacement};
use crate::bundle::noise::{FitSize, median};
use crate::bundle::part::{Lanes, Part, for_each_chunk};
use crate::bundle::reduced::{Damping, Translations};
use crate::geometry::{Matrix, Rotation, Vector};
use crate::least_squares::{LeastSquaresError, LinearSolver};
use crate::tracks::Tracks;

/// An exact ambiguity seen through noise is this many times stiffer than expected, at most.
const NOISE_MULTIPLE: f64 = 5.0;
/// Tracks whose stretch is looked at, at most about twice this many.
const STRETCH_TRACKS: usize = 10_000;
/// Relative damping that keeps exact gauge freedoms factorisable.
const GUARD: f64 = 1e-12;
/// A mode whose movement at one standard deviation exceeds this share of the rms size of the path is not determined.
const LOOSE_MOVEMENT: f64 = 0.3;
/// A mode is held by the guard alone where its stiffness is less than this multiple of the guard's.
const GUARD_MULTIPLE: f64 = 3.0;
/// Inverse iterations; the sought mode is separated from the next by far where it matters.
const INVERSE_ITERATIONS: usize = 6;
/// Right-hand sides solved together when the covariance is formed.
const BLOCK_OF_SOLVES: usize = 48;

/// Assembles and factorises the information at an estimate, in units of `1/sigma^2`.
pub(super) fn assemble_information<const D: usize>(
    part: &Part<D>,
    system: &mut PositionSystem<D>,
    weights: &NewtonWeights<'_, D>,
) -> Result<(), LeastSquaresError> {
    system.assemble(part, weights, &Translations, &[], Damping { point: GUARD, view: GUARD });
    system.factorise()
}

/// Is the weakest mode beyond the gauge undetermined? Uses the system as it was assembled and factorised last, by
/// [`assemble_information`] at this estimate.
///
/// The mode, found by inverse iteration, is loose where
/// - fewer equations than unknowns were kept;
/// - it moves by a large share of the path at one standard deviation;
/// - it is held by the guard's damping alone;
/// - its stiffness is no more than noise gives to an exact ambiguity: a deformation that stretches the segment of
///   observation `(i, j)` by `lambda_ij` turns it, at positions that err by the noise, by about `sigma lambda_ij`, so
///   that its squared error is `(d - 1) sum (lambda_ij - mean_j)^2` in units of sigma. (The mean over a track is taken
///   off, since a scale of its own leaves the directions of one track exact.)
pub(super) fn weakest_mode_is_loose<const D: usize>(
    part: &Part<D>,
    system: &PositionSystem<D>,
    weights: &NewtonWeights<'_, D>,
    sigma: f64,
) -> Result<bool, LeastSquaresError> {
    let size = FitSize::of(part, |o| weights.residuals.keep[o]);
    if part.n_views < 2 || size.equations < size.unknowns {
        return Ok(true);
    }
    let Some(mode) = weakest_mode(part, system, weights.estimate)? else { return Ok(false) };
    let stretch = stretch_of(part, weights, &mode.displacement);
    let movement = sigma * (mode.stiffness * part.n_views as f64).powf(-0.5);
    let from_guard = mode.stiffness < GUARD_MULTIPLE * mode.guard;
    let from_noise = stretch.turned < NOISE_MULTIPLE * (D - 1) as f64 * sigma * sigma * stretch.spread;
    Ok(movement.is_nan() || movement > LOOSE_MOVEMENT || from_guard || from_noise)
}

/// A displacement of all centres, free of gauge and of unit length.
struct Mode {
    displacement: Vec<Lanes>,
    /// Squared error that the displacement costs, points following.
    stiffness: f64,
    /// The guard's share of it.
    guard: f64,
}

/// The weakest mode, by inverse iteration; `None` where the gauge is all there is.
fn weakest_mode<const D: usize>(
    part: &Part<D>,
    system: &PositionSystem<D>,
    estimate: &Estimate,
) -> Result<Option<Mode>, LeastSquaresError> {
    let gauge = GaugeBasis::<D>::new(&estimate.centers);
    let diagonal = system.diagonal().as_flattened();
    // any start with a share of every mode will do; this one is the same on every run
    let mut mode: Vec<f64> = (0..part.n_views * D).map(|k| (1.0 + 2.3 * k as f64).sin()).collect();
    let (mut stiffness, mut guard) = (f64::NAN, f64::NAN);
    for _ in 0..INVERSE_ITERATIONS {
        gauge.remove(&mut mode);
        let length = dot_product(&mode, &mode).sqrt();
        if length <= 0.0 {
            return Ok(None);
        }
        mode.iter_mut().for_each(|x| *x /= length);
        let pushed = mode.clone();
        clear_held(system.held(), &mut mode);
        system.solve_for(&mut mode, 1)?;
        let energy = dot_product(&mode, &pushed);
        let held: f64 = mode.iter().zip(diagonal).map(|(x, d)| GUARD * d * x * x).sum();
        gauge.remove(&mut mode);
        let squared = dot_product(&mode, &mode);
        (stiffness, guard) = (energy / squared, held / squared);
    }
    let length = dot_product(&mode, &mode).sqrt();
    let displacement = mode.chunks_exact(D).map(|x| Lanes::from_vector::<D>(&std::array::from_fn(|c| x[c] / length)));
    Ok(Some(Mode { displacement: displacement.collect(), stiffness, guard }))
}

/// What a displacement of the centres does to the kept observations, points following.
struct Stretch {
    /// Sum of squared turns of the segments.
    turned: f64,
    /// Sum of squared stretch rates, less the mean of each track.
    spread: f64,
}

fn stretch_of<const D: usize>(part: &Part<D>, weights: &NewtonWeights<'_, D>, displacement: &[Lanes]) -> Stretch {
    let estimate = weights.estimate;
    let mut per_track = vec![(0.0, 0.0); part.n_tracks()];
    // only the ratio of the two sums matters: some tracks stand for all
    let stride = part.n_tracks().div_ceil(STRETCH_TRACKS);
    for_each_chunk(part, &mut per_track, |tracks, out| {
        for (j, sums) in tracks.zip(out).filter(|(j, _)| j % stride == 0) {
            let Some(follow) = point_displacement(weights, j, &displacement) else { continue };
            let (mut rates, mut turned) = (Vec::new(), 0.0);
            for o in part.observations(j).filter(|&o| weights.residuals.keep[o]) {
                let view = part.view[o] as usize;
                let u = estimate.points[j].minus(&estimate.centers[view]);
                let du = follow.minus(&displacement[view]);
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

/// Translations and the scale of a set of centres, orthonormal.
struct GaugeBasis<const D: usize> {
    n: usize,
    scale: Vec<f64>,
}

impl<const D: usize> GaugeBasis<D> {
    fn new(centers: &[Lanes]) -> Self {
        let mut centred = centers.to_vec();
        normalise(&mut centred);
        let n = centers.len();
        let unit = 1.0 / (n as f64).sqrt();
        Self { n, scale: centred.iter().flat_map(|c| c.times(unit).vector::<D>()).collect() }
    }

    /// Takes the gauge out of a displacement of all centres.
    fn remove(&self, x: &mut [f64]) {
        for c in 0..D {
            let mean = x.iter().skip(c).step_by(D).sum::<f64>() / self.n as f64;
            x.iter_mut().skip(c).step_by(D).for_each(|v| *v -= mean);
        }
        let along = dot_product(x, &self.scale);
        x.iter_mut().zip(&self.scale).for_each(|(v, s)| *v -= along * s);
    }
}

fn clear_held(held: &[bool], x: &mut [f64]) {
    x.iter_mut().zip(held).filter(|(_, held)| **held).for_each(|(x, _)| *x = 0.0);
}

fn dot_product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Covariance of the camera centres that the noise allows (the Cramer-Rao bound) at a structure, for instance the truth.
///
/// In the gauge of a least-squares fit by translation and scale over the views that take part; NaN for the others.
/// `sigma_rad` is the angular standard deviation of every observation where the tracks carry none; `keep` says which
/// observations count (all of them where it is absent). Units are those of `centers`, squared.
///
/// # Errors
/// [`PositionError`] where the arguments do not fit together or the geometry leaves the centres undetermined.
pub fn position_covariance<const D: usize>(
    tracks: &Tracks<D>,
    cam_from_world: Option<&[Rotation<D>]>,
    centers: &[Vector<D>],
    points: &[Vector<D>],
    sigma_rad: f64,
    keep: Option<&[bool]>,
) -> Result<Vec<Matrix<D>>, PositionError> {
    if (centers.len(), points.len()) != (tracks.n_views(), tracks.n_tracks()) {
        return Err(PositionError::Start(format!(
            "{} centres and {} points given, expected {} and {}",
            centers.len(),
            points.len(),
            tracks.n_views(),
            tracks.n_tracks()
        )));
    }
    if let Some(rotations) = cam_from_world
        && rotations.len() != tracks.n_views()
    {
        return Err(PositionError::Orientations { found: rotations.len(), expected: tracks.n_views() });
    }
    let finite = |x: &Vector<D>| x.iter().all(|v| v.is_finite());
    let rays = Rays::new(tracks, cam_from_world);
    let counts: Vec<bool> = (0..tracks.len())
        .map(|o| {
            let (view, track) = (tracks.view()[o] as usize, tracks.track()[o] as usize);
            keep.is_none_or(|k| k[o]) && finite(&centers[view]) && finite(&points[track])
        })
        .collect();
    let parts = rays.parts(tracks, false, Some(&counts));
    let (views, members) = (&parts.views[0], &parts.tracks[0]);
    let roles = Members::as_given(views, members);
    let part = roles.lay_out(tracks, &rays);
    let mut covariance = vec![[[f64::NAN; D]; D]; tracks.n_views()];
    if part.n_tracks() == 0 {
        return Ok(covariance);
    }
    let estimate = Estimate {
        centers: views.iter().map(|&v| Lanes::from_vector::<D>(&centers[v as usize])).collect(),
        points: part.input_track.iter().map(|&t| Lanes::from_vector::<D>(&points[t as usize])).collect(),
    };
    let kept: Vec<bool> = part.input_observation.iter().map(|&o| counts[o as usize]).collect();
    let reference = tracks.sigma_rad().map_or(sigma_rad, |s| median(&mut s.to_vec()));
    let mut system = position_system(&part, LinearSolver::Direct)?;
    assemble_information(&part, &mut system, &NewtonWeights::new(&part, &estimate, &kept, f64::INFINITY))?;
    let gauge = GaugeBasis::<D>::new(&estimate.centers);
    let blocks = diagonal_blocks_of_inverse(&system, &gauge, part.n_views)?;
    for (&view, block) in views.iter().zip(blocks) {
        covariance[view as usize] = block.map(|row| row.map(|x| x * reference * reference));
    }
    Ok(covariance)
}

/// Diagonal blocks of `Q S^-1 Q^T`, `Q` the projection that takes the gauge out: by solves, a block of columns at a time.
fn diagonal_blocks_of_inverse<const D: usize>(
    system: &PositionSystem<D>,
    gauge: &GaugeBasis<D>,
    n_views: usize,
) -> Result<Vec<Matrix<D>>, LeastSquaresError> {
    let n = n_views * D;
    let mut blocks = vec![[[0.0; D]; D]; n_views];
    for first in (0..n).step_by(BLOCK_OF_SOLVES) {
        let count = BLOCK_OF_SOLVES.min(n - first);
        let mut columns = vec![0.0; n * count];
        for (k, column) in columns.chunks_exact_mut(n).enumerate() {
            column[first + k] = 1.0;
            gauge.remove(column);
            clear_held(system.held(), column);
        }
        system.solve_for(&mut columns, count)?;
        for (k, column) in columns.chunks_exact_mut(n).enumerate() {
            gauge.remove(column);
            let (view, c) = ((first + k) / D, (first + k) % D);
            for r in 0..D {
                blocks[view][r][c] = column[view * D + r];
            }
        }
    }
    Ok(blocks)
}
