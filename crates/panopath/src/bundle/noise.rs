//! How large the noise is, and which observations lie within it.

use rayon::prelude::*;

use super::estimate::{Estimate, squared_error};
use super::part::Part;
use crate::tracks::Tracks;

/// Smallest noise estimate in radians, so that exact data keeps all its observations.
pub(crate) const SIGMA_FLOOR_RAD: f64 = 1e-7;
/// Observations farther than this many sigma from their prediction are outliers.
pub(crate) const OUTLIER_SIGMAS: f64 = 5.0;
/// The same before the first descent: the cameras still err by more than the noise, most of all as seen from near points.
pub(crate) const FIRST_OUTLIER_SIGMAS: f64 = 20.0;
/// Huber's threshold in sigma.
pub(crate) const HUBER_SIGMAS: f64 = 3.0;

/// Chord of every observation in units of the reference sigma's radian.
pub(crate) fn chords<const D: usize>(part: &Part<D>, estimate: &Estimate) -> Vec<f64> {
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
pub(crate) struct FitSize {
    pub observations: usize,
    pub equations: usize,
    pub unknowns: usize,
}

impl FitSize {
    pub fn of<const D: usize>(part: &Part<D>, among: impl Fn(usize) -> bool) -> Self {
        let (mut observations, mut points) = (0, 0);
        let mut is_told = vec![false; part.n_nodes];
        for j in 0..part.n_tracks() {
            let kept =
                part.observations(j).filter(|&o| among(o)).inspect(|&o| is_told[part.node_of(o) as usize] = true);
            let kept = kept.count();
            observations += kept;
            points += usize::from(kept > 0 && !part.holds_point(j));
        }
        let of_cameras: usize = part.node_freedom.iter().zip(&is_told).filter(|(_, told)| **told).map(|(n, _)| n).sum();
        let unknowns = D * points + of_cameras.saturating_sub(part.gauge_freedom);
        Self { observations, equations: (D - 1) * observations, unknowns }
    }
}

/// Noise estimate from the chords of the observations for which `among` holds.
pub(crate) fn noise_scale<const D: usize>(part: &Part<D>, chords: &[f64], among: impl Fn(usize) -> bool) -> f64 {
    let stride = (chords.len() / 200_000).max(1);
    let mut sample: Vec<f64> = (0..chords.len()).step_by(stride).filter(|&o| among(o)).map(|o| chords[o]).collect();
    let size = FitSize::of(part, among);
    sigma_from_chords::<D>(&mut sample, size.observations, size.unknowns).max(SIGMA_FLOOR_RAD)
}

/// Root mean square of the kept chords over the degrees of freedom: steadier than a quantile once outliers are gone.
/// `None` where nothing is left over.
pub(crate) fn sigma_of_inliers<const D: usize>(part: &Part<D>, chords: &[f64], keep: &[bool]) -> Option<f64> {
    let size = FitSize::of(part, |o| keep[o]);
    let freedom = size.equations.checked_sub(size.unknowns)?;
    let squared: f64 = chords.iter().zip(keep).filter(|(_, k)| **k).map(|(e, _)| e * e).sum();
    (freedom > 0).then(|| (squared / freedom as f64).sqrt().max(SIGMA_FLOOR_RAD))
}

/// Observations within a limit of their prediction, of points that keep at least two views or are held.
pub(crate) fn inliers<const D: usize>(part: &Part<D>, chords: &[f64], limit: f64) -> Vec<bool> {
    let mut keep: Vec<bool> = chords.iter().map(|&e| e < limit).collect();
    for j in (0..part.n_tracks()).filter(|&j| !part.holds_point(j)) {
        let mut views = part.observations(j).filter(|&o| keep[o]).map(|o| part.node_of(o));
        let first = views.next();
        if !views.any(|view| Some(view) != first) {
            keep[part.observations(j)].fill(false);
        }
    }
    keep
}
/// Noise of one tangent direction from the chords of some observations that `unknowns` were fitted to.
///
/// A fit with few degrees of freedom makes many residuals vanish: a share `1 - freedom` of them can be zero whatever the
/// noise. The quantile that is looked at lies beyond these, and the residuals that remain are scaled up to the noise.
pub(crate) fn sigma_from_chords<const D: usize>(chords: &mut [f64], n_observations: usize, unknowns: usize) -> f64 {
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

/// Median; zero of nothing. Reorders its argument.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The median sigma of the observations, and the precision of each relative to it; `None` where no sigma is given.
pub(crate) fn precisions<const D: usize>(tracks: &Tracks<D>) -> Option<(f64, Vec<f64>)> {
    let sigma = tracks.sigma_rad()?;
    let reference = median(&mut sigma.to_vec());
    Some((reference, sigma.iter().map(|s| (reference / s).powi(2)).collect()))
}
