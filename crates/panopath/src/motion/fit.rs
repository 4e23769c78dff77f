//! One rotation that takes the first of each pair of unit vectors to the second.
//!
//! `min over R of sum_k w_k |q_k - R p_k|^2` is the rotation nearest to `sum_k w_k q_k p_k^T` (Wahba's problem); about a known
//! vertical it is one angle, in closed form. The weights `w_k` make it robust: fit, look at what is left, weight again.
//! What is left of a point is its parallax and its noise. Both are smallest for far points, so every weighting but
//! the plain mean seeks the rotation about which the flow of many points lies closest together.

use crate::geometry::{Matrix, Rotation, Vector, norm, sub};
use crate::least_squares::{nearest_rotation, symmetric_eigen};

/// A direction in one frame and the same direction in another.
pub(super) type Pair<const D: usize> = (Vector<D>, Vector<D>);

/// How much a pair counts.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Weighting {
    /// All alike: the mean flow of the paper.
    Mean,
    /// The less the more flow is left to it, compared with the others: Geman and McClure's weights.
    #[default]
    Robust,
    /// Only this share of the pairs, those with the least flow left: near points and false ones drop out.
    Slowest {
        /// Above 0, at most 1.
        share: f64,
    },
}

/// What the rotation may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FitModel {
    /// Any rotation.
    Free,
    /// A turn about the z axis.
    AboutVertical,
    /// Any rotation, from the mean flow of azimuth and elevation.
    Horizon,
    /// A turn about the z axis, from the mean flow of azimuth.
    HorizonAboutVertical,
}

/// The rotation found.
pub(super) struct Fit<const D: usize> {
    pub rotation: Rotation<D>,
    /// Median angle left.
    pub residual_rad: f64,
    /// Standard deviation about the least certain axis.
    pub sigma_rad: f64,
}

/// Chords below this are taken for rounding.
const ROUNDING: f64 = 1e-12;
/// Least information about the weakest axis, for unit weights of sum one: directions within a milliradian of one line
/// leave the turn about it open.
const LEAST_INFORMATION: f64 = 1e-6;
const ROUNDS: usize = 60;

/// Fits a rotation, or `None` where the pairs leave it open.
pub(super) fn fit_rotation<const D: usize>(pairs: &[Pair<D>], model: FitModel, weighting: Weighting) -> Option<Fit<D>> {
    let mut weights = vec![1.0; pairs.len()];
    let mut rotation = solve(pairs, &weights, model)?;
    let mut chords = chords(pairs, &rotation);
    if weighting != Weighting::Mean {
        // least absolute chords first: they need no scale
        for round in 0..ROUNDS {
            match weighting {
                Weighting::Slowest { share } if round >= ROUNDS / 6 => keep_slowest(&chords, share, &mut weights),
                Weighting::Robust if round >= ROUNDS / 6 => geman_mcclure::<D>(&chords, &mut weights),
                _ => least_absolute(&chords, &mut weights),
            }
            let Some(next) = solve(pairs, &weights, model) else { break };
            let settled = norm_of_difference(&next, &rotation) < ROUNDING;
            rotation = next;
            chords = self::chords(pairs, &rotation);
            if settled && round > ROUNDS / 6 {
                break;
            }
        }
    }
    Some(Fit {
        rotation,
        residual_rad: 2.0 * (0.5 * median(&chords)).min(1.0).asin(),
        sigma_rad: standard_deviation(pairs, &weights, &chords, model),
    })
}

fn chords<const D: usize>(pairs: &[Pair<D>], rotation: &Rotation<D>) -> Vec<f64> {
    pairs.iter().map(|(p, q)| norm(&sub(q, &rotation.apply(p)))).collect()
}

fn least_absolute(chords: &[f64], weights: &mut [f64]) {
    // the floor keeps one exact pair from deciding alone
    let floor = (0.1 * median(chords)).max(ROUNDING);
    for (weight, chord) in weights.iter_mut().zip(chords) {
        *weight = floor / chord.max(floor);
    }
}

fn geman_mcclure<const D: usize>(chords: &[f64], weights: &mut [f64]) {
    /// The noise is read off the slowest quarter, so that up to two thirds may be near or false.
    const SHARE: f64 = 0.25;
    /// Standard deviations at which a pair counts a quarter.
    const REACH: f64 = 2.0;
    // lower quartile of the length of a normal vector of D - 1 coordinates
    let quartile = if D == 2 { 0.3186 } else { 0.7585 };
    let scale = (REACH * quantile(chords, SHARE) / quartile).max(ROUNDING);
    for (weight, chord) in weights.iter_mut().zip(chords) {
        *weight = (1.0 + (chord / scale).powi(2)).powi(-2);
    }
}

fn keep_slowest(chords: &[f64], share: f64, weights: &mut [f64]) {
    let kept = ((share * chords.len() as f64).ceil() as usize).clamp(1, chords.len().max(1));
    let mut order: Vec<usize> = (0..chords.len()).collect();
    order.sort_by(|&i, &k| chords[i].total_cmp(&chords[k]).then(i.cmp(&k)));
    for (rank, &k) in order.iter().enumerate() {
        weights[k] = if rank < kept { 1.0 } else { 0.0 };
    }
}

fn median(values: &[f64]) -> f64 {
    quantile(values, 0.5)
}

fn quantile(values: &[f64], share: f64) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let mut sorted = values.to_vec();
    let place = ((share * sorted.len() as f64) as usize).min(sorted.len() - 1);
    *sorted.select_nth_unstable_by(place, f64::total_cmp).1
}

fn norm_of_difference<const D: usize>(a: &Rotation<D>, b: &Rotation<D>) -> f64 {
    let pairs = a.matrix().iter().flatten().zip(b.matrix().iter().flatten());
    pairs.map(|(x, y)| (x - y) * (x - y)).sum::<f64>().sqrt()
}

/// One weighted fit.
fn solve<const D: usize>(pairs: &[Pair<D>], weights: &[f64], model: FitModel) -> Option<Rotation<D>> {
    let information = information(pairs, weights, model);
    if information.is_nan() || information < LEAST_INFORMATION {
        return None;
    }
    if D == 2 {
        return match model {
            FitModel::Free | FitModel::AboutVertical => about_vertical(pairs, weights),
            FitModel::Horizon | FitModel::HorizonAboutVertical => azimuth_flow(pairs, weights),
        };
    }
    match model {
        FitModel::Free => nearest_rotation(&correlation(pairs, weights)),
        FitModel::AboutVertical => about_vertical(pairs, weights),
        FitModel::HorizonAboutVertical => azimuth_flow(pairs, weights),
        FitModel::Horizon => horizon(pairs, weights),
    }
}

fn correlation<const D: usize>(pairs: &[Pair<D>], weights: &[f64]) -> Matrix<D> {
    let mut sum = [[0.0; D]; D];
    for ((p, q), w) in pairs.iter().zip(weights) {
        for (row, q) in sum.iter_mut().zip(q) {
            for (entry, p) in row.iter_mut().zip(p) {
                *entry += w * q * p;
            }
        }
    }
    sum
}

/// Smallest eigenvalue of `sum w (I - q q^T) / sum w`, what the pairs say about the weakest axis.
fn information<const D: usize>(pairs: &[Pair<D>], weights: &[f64], model: FitModel) -> f64 {
    let total: f64 = weights.iter().sum();
    let planar = pairs.iter().zip(weights).map(|((_, q), w)| w * (q[0] * q[0] + q[1] * q[1])).sum::<f64>();
    let about_z = planar / total;
    if D == 2 || matches!(model, FitModel::AboutVertical | FitModel::HorizonAboutVertical) {
        return about_z;
    }
    let mut spread = [[0.0; 3]; 3];
    for ((_, q), w) in pairs.iter().zip(weights) {
        for r in 0..3 {
            for c in 0..3 {
                spread[r][c] += w * (if r == c { 1.0 } else { 0.0 } - q[r] * q[c]) / total;
            }
        }
    }
    symmetric_eigen(&spread).map_or(f64::NAN, |(values, _)| values[0])
}

/// Standard deviation of the turn about its weakest axis when the chords left are noise of the pairs that count.
fn standard_deviation<const D: usize>(pairs: &[Pair<D>], weights: &[f64], chords: &[f64], model: FitModel) -> f64 {
    let total: f64 = weights.iter().sum();
    let squares: f64 = weights.iter().zip(chords).map(|(w, e)| w * e * e).sum();
    // the rotation takes up D (D - 1) / 2 of the D - 1 numbers that each pair brings
    let spare = (total - 0.5 * D as f64).max(0.0);
    (squares / (spare * (D - 1) as f64) / (total * information(pairs, weights, model))).sqrt()
}

/// The plane's rotation by the angle, or space's about z.
fn turn_about_z<const D: usize>(cos: f64, sin: f64) -> Option<Rotation<D>> {
    Rotation::from_matrix(std::array::from_fn(|r| {
        std::array::from_fn(|c| match (r, c) {
            (0, 0) | (1, 1) => cos,
            (0, 1) => -sin,
            (1, 0) => sin,
            _ => 1.0 - f64::from(u8::from(r != c)),
        })
    }))
}

fn about_vertical<const D: usize>(pairs: &[Pair<D>], weights: &[f64]) -> Option<Rotation<D>> {
    let (mut cos, mut sin) = (0.0, 0.0);
    for ((p, q), w) in pairs.iter().zip(weights) {
        cos += w * (p[0] * q[0] + p[1] * q[1]);
        sin += w * (p[0] * q[1] - p[1] * q[0]);
    }
    let length = cos.hypot(sin);
    turn_about_z(cos / length, sin / length)
}

/// Mean flow of azimuth, wrapped about the mean direction of the flow, every point with the same weight however steep.
fn mean_azimuth_flow<const D: usize>(pairs: &[Pair<D>], weights: &[f64]) -> Option<f64> {
    let flow = |(p, q): &Pair<D>| (p[0] * q[1] - p[1] * q[0]).atan2(p[0] * q[0] + p[1] * q[1]);
    let about = about_vertical(pairs, weights)?;
    let middle = about.matrix()[1][0].atan2(about.matrix()[0][0]);
    let wrapped = |pair: &Pair<D>| {
        let (sin, cos) = (flow(pair) - middle).sin_cos();
        sin.atan2(cos)
    };
    let total: f64 = weights.iter().sum();
    Some(middle + pairs.iter().zip(weights).map(|(pair, w)| w * wrapped(pair)).sum::<f64>() / total)
}

fn azimuth_flow<const D: usize>(pairs: &[Pair<D>], weights: &[f64]) -> Option<Rotation<D>> {
    let angle = mean_azimuth_flow(pairs, weights)?;
    turn_about_z(angle.cos(), angle.sin())
}

/// The turn about z from the mean flow of azimuth, the two tilts from the flow of elevation that is left.
///
/// Near the horizon a small tilt `(x, y)` moves elevations by `x sin(theta) - y cos(theta)`. It raises one side of a panorama
/// and lowers the other, so that the plain mean of the elevations, which the paper writes, would see none of it.
fn horizon<const D: usize>(pairs: &[Pair<D>], weights: &[f64]) -> Option<Rotation<D>> {
    let about = azimuth_flow(pairs, weights)?;
    let (mut xx, mut xy, mut yy, mut xe, mut ye) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for ((p, q), w) in pairs.iter().zip(weights) {
        let p = about.apply(p);
        let along = p[0].hypot(p[1]);
        if along == 0.0 {
            continue; // a pole has no azimuth
        }
        let (sin, cos) = (p[1] / along, p[0] / along);
        let rise = q[D - 1].atan2(q[0].hypot(q[1])) - p[D - 1].atan2(along);
        xx += w * sin * sin;
        xy -= w * sin * cos;
        yy += w * cos * cos;
        xe += w * sin * rise;
        ye -= w * cos * rise;
    }
    let determinant = xx * yy - xy * xy;
    let tilt = [(yy * xe - xy * ye) / determinant, (xx * ye - xy * xe) / determinant, 0.0];
    let tilt = *Rotation::exp(&tilt).matrix();
    let tilt = Rotation::from_matrix(std::array::from_fn(|r| std::array::from_fn(|c| tilt[r][c])))?;
    Some(tilt.compose(&about))
}
