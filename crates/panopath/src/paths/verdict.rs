//! Does a track's path follow from its bearings, cameras held?
//!
//! If the camera's own path lies in the span of the functions, `C(t) = sum_l B_l(t) c_l`, every `C + s (P - C)` has the same
//! bearings: the path is then refused. What counts is the part of the camera's path that the functions cannot express
//! (Park, Shiratori, Matthews and Sheikh, ECCV 2010), against the noise: the weakest mode of the normal equations, in units
//! of how far it moves the point at the times it was seen.

use super::joint::CourseWeights;
use super::select::chi_squared;
use super::track::{Equations, vectors_of};
use crate::bundle::courses::CourseSystem;
use crate::bundle::part::Lanes;
use crate::bundle::reduced::{Quadratic, Weighing};
use crate::least_squares::symmetric_eigen_of;

/// A path that may move by more than this share of its distance, at one standard deviation, is not determined.
const LOOSE: f64 = 0.3;
/// A mode this much softer than the stiffest is free but for rounding.
const ROUNDING: f64 = 1e-12;

/// The camera's path has the form of a body's where it leaves it by less than this many times what its own errors do,
/// squared, at a normal variable's quantile.
const ERRORS_OVER_PREDICTED: f64 = 4.0;
const LEAVES_Z: f64 = 2.3;

/// What was found of a track.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// At rest.
    Static,
    /// It moves.
    Moving,
    /// The camera moved in the form of its path: the distance is not determined.
    Imitated,
    /// It stood before or behind another track in all its views.
    Hidden {
        /// The other track.
        by: u32,
    },
    /// Too little was seen of it, or nothing that fits a path.
    Undetermined,
}

impl Verdict {
    /// The name used in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Static => "static",
            Self::Moving => "moving",
            Self::Imitated => "imitated",
            Self::Hidden { .. } => "hidden",
            Self::Undetermined => "undetermined",
        }
    }
}

/// Deviation of the weakest mode of a path over its mean distance, cameras held; infinite where a mode is free.
pub(super) fn looseness<const D: usize>(weights: &CourseWeights<'_, D>, j: usize, sigma: f64) -> f64 {
    let state = weights.state;
    let part = &state.part;
    let (mut models, mut still): (Vec<Quadratic>, Vec<Quadratic>) = (Vec::new(), Vec::new());
    let (mut distance, mut count) = (0.0, 0.0);
    for o in part.observations(j) {
        let model = weights.observe(o, j);
        if model.direction.0[3] > 0.0 {
            let u = state.position(o, j).minus(&state.estimate.centers[part.view[o] as usize]);
            distance += u.dot::<D>(&u).sqrt();
            count += 1.0;
        }
        // a model that weighs every displacement alike
        let mut even = Lanes::ZERO;
        even.0[3] = f64::from(model.direction.0[3] > 0.0);
        still.push(Quadratic { direction: even, gradient: Lanes::ZERO });
        models.push(model);
    }
    let course = part.course(j);
    let (mut information, mut size) = (CourseSystem::default(), CourseSystem::default());
    if count == 0.0 || !information.assemble::<D>(course, &models) || !size.assemble::<D>(course, &still) {
        return f64::INFINITY;
    }
    let Some(softest) = softest(&information.symmetric(), &size.symmetric(), count) else { return f64::INFINITY };
    sigma / softest.sqrt() / (distance / count)
}

/// `1 / sigma^2` of each camera's place along an axis, in units of the noise, as points at rest hold it.
pub(super) fn firmness<const D: usize>(weights: &CourseWeights<'_, D>) -> Vec<f64> {
    let part = &weights.state.part;
    let mut firmness = vec![0.0; part.n_nodes];
    for j in (0..part.n_tracks()).filter(|&j| !part.courses.moves(j)) {
        for o in part.observations(j) {
            let model = weights.observe(o, j);
            firmness[part.node_of(o) as usize] += model.direction.0[3] * (D - 1) as f64 / D as f64;
        }
    }
    firmness
}

/// Does the camera's own path leave the form of a track's path by no more than its errors?
///
/// It would seem to by its errors alone, and a path that was drawn close to the camera would seem firm.
pub(super) fn is_followed<const D: usize>(
    weights: &CourseWeights<'_, D>,
    j: usize,
    firmness: &[f64],
    sigma: f64,
) -> bool {
    let state = weights.state;
    let part = &state.part;
    let course = part.course(j);
    let k = course.n_functions;
    // without bounds on any camera nothing is known of its errors
    let seen: Vec<(usize, usize)> = part
        .observations(j)
        .enumerate()
        .filter(|&(_, o)| weights.keep[o])
        .map(|(row, o)| (row, part.node_of(o) as usize))
        .filter(|&(_, node)| firmness[node] > 0.0)
        .collect();
    if seen.len() <= k {
        return false;
    }
    let mut equations = Equations::default();
    equations.clear(D * k);
    for &(row, node) in &seen {
        let pull = state.estimate.centers[node].times(firmness[node]);
        equations.add::<D>(&course.values[row * k..(row + 1) * k], &Lanes::ZERO, firmness[node], &pull);
    }
    let Some(x) = equations.solve(0.0) else { return false };
    let vectors = vectors_of::<D>(x, k);
    let squared = |&(row, node): &(usize, usize)| {
        let off = state.estimate.centers[node].minus(&course.position(row, &vectors));
        firmness[node] * off.dot::<D>(&off) / (sigma * sigma)
    };
    let freedom = (D * (seen.len() - k)) as f64;
    seen.iter().map(squared).sum::<f64>() < ERRORS_OVER_PREDICTED * chi_squared(freedom, LEAVES_Z)
}

/// Is it too loose to be told?
pub(super) fn is_loose(looseness: f64) -> bool {
    looseness.is_nan() || looseness > LOOSE
}

/// Least eigenvalue of `a` relative to `b / count`; `None` where it is nought but for rounding.
fn softest(a: &[Vec<f64>], b: &[Vec<f64>], count: f64) -> Option<f64> {
    let n = a.len();
    let (sizes, axes) = symmetric_eigen_of(b).ok()?;
    let largest = sizes.last().copied().unwrap_or(0.0);
    if sizes[0] <= ROUNDING * largest {
        return None;
    }
    let whitened: Vec<Vec<f64>> = (0..n)
        .map(|r| {
            (0..n)
                .map(|c| {
                    let product: f64 =
                        (0..n).map(|i| axes[r][i] * (0..n).map(|k| a[i][k] * axes[c][k]).sum::<f64>()).sum();
                    count * product / (sizes[r] * sizes[c]).sqrt()
                })
                .collect()
        })
        .collect();
    let (values, _) = symmetric_eigen_of(&whitened).ok()?;
    (values[0] > ROUNDING * values[n - 1]).then_some(values[0])
}
