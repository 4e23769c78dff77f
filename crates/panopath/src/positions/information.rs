//! What the noise lets one know: the Fisher information of the centres, its weakest mode and its inverse.
//!
//! At an estimate, the reduced system assembled with weights `1/sigma^2` is the Fisher information of the camera centres
//! with the points eliminated. Its inverse, in the gauge of a fit by translation and scale over the cameras, bounds the
//! covariance of any unbiased estimate (Cramer and Rao).

use super::options::PositionError;
use super::{Members, PositionSystem, Rays, position_system};
use crate::bundle::determinacy::{GUARD, GaugeBasis, MEANINGLESS_RAD, Motions, clear_held, weakest_mode_is_loose};
use crate::bundle::estimate::{Estimate, normalise};
use crate::bundle::newton::{NewtonWeights, Shifts};
use crate::bundle::noise::median;
use crate::bundle::part::{Lanes, Part};
use crate::bundle::reduced::{Damping, Translations};
use crate::geometry::{Matrix, Rotation, Vector};
use crate::least_squares::{LeastSquaresError, LinearSolver};
use crate::tracks::Tracks;

/// Right-hand sides solved together when the covariance is formed.
const BLOCK_OF_SOLVES: usize = 48;

/// Assembles and factorises the information at an estimate, in units of `1/sigma^2`.
fn assemble_information<const D: usize>(
    part: &Part<D>,
    system: &mut PositionSystem<D>,
    weights: &NewtonWeights<'_, D>,
) -> Result<(), LeastSquaresError> {
    system.assemble(part, weights, &Translations, &[], Damping { point: GUARD, view: GUARD });
    system.factorise()
}

/// Does the geometry leave a freedom beyond shift and scale, as far as the noise lets one tell?
pub(super) fn is_loose<const D: usize>(
    part: &Part<D>,
    system: &mut PositionSystem<D>,
    weights: &NewtonWeights<'_, D>,
    sigma: f64,
) -> Result<bool, LeastSquaresError> {
    if sigma.is_nan() || sigma > MEANINGLESS_RAD {
        return Ok(true);
    }
    match assemble_information(part, system, weights) {
        Err(LeastSquaresError::Singular { .. }) => return Ok(true),
        other => other?,
    }
    let gauge = gauge_of::<D>(&weights.estimate.centers);
    let unpack = |x: &[f64]| x.as_chunks::<D>().0.iter().map(Lanes::from_vector::<D>).collect::<Vec<Lanes>>();
    weakest_mode_is_loose(system, weights, &gauge, |x| Shifts(unpack(x)), sigma)
}

/// Translations and the scale of a set of centres.
fn gauge_of<const D: usize>(centers: &[Lanes]) -> GaugeBasis {
    let mut centred = centers.to_vec();
    normalise(&mut centred);
    let motions = Motions { translation: true, axes: &[], scale: true };
    GaugeBasis::new(motions.of_cameras::<D, D>(&centred, &[0.0; D]))
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
    let gauge = gauge_of::<D>(&estimate.centers);
    let blocks = diagonal_blocks_of_inverse(&system, &gauge, part.n_views)?;
    for (&view, block) in views.iter().zip(blocks) {
        covariance[view as usize] = block.map(|row| row.map(|x| x * reference * reference));
    }
    Ok(covariance)
}

/// Diagonal blocks of `Q S^-1 Q^T`, `Q` the projection that takes the gauge out: by solves, a block of columns at a time.
fn diagonal_blocks_of_inverse<const D: usize>(
    system: &PositionSystem<D>,
    gauge: &GaugeBasis,
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
