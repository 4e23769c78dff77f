//! Brings the start of a component near what is known beforehand, so that the refinement begins near its end.
//!
//! The rotation `T = world_from_start` maximises `trace(T^T B)`, where `B` adds for each kind of prior the mean of
//!
//! | prior | term |
//! |---|---|
//! | orientation `P` | `P^T R` |
//! | direction `d`, measured along `b` | `d (R^T b)^T` |
//! | position `p` | `(p - mean) (c - mean)^T`, over the lengths of all |
//!
//! (Wahba's problem, and Kabsch's for positions.) Gravity and positions together fix a turn that neither fixes alone. The
//! present frame has a small weight: it decides where a turn is left free. Scale and shift follow from the positions.

use super::options::{Priors, RefineOptions};
use super::{holds_any, is_finite};
use crate::bundle::noise::median;
use crate::geometry::{Matrix, Rotation, Similarity, Vector, norm, sub};
use crate::least_squares::nearest_rotation;
use crate::structure::Structure;

/// Weight of the frame of the start against one kind of prior.
const PRESENT_FRAME: f64 = 1e-6;
/// Positions that miss by more than this many times the median are left out of the fit.
const GROSS: f64 = 3.0;
/// Rounds of leaving out.
const ROUNDS: usize = 5;

/// The similarity that takes the start of these views to the world of the priors; none where nothing is known, or where
/// something is held where it stands.
pub(super) fn world_from_start<const D: usize>(
    views: &[u32],
    start: &Structure<D>,
    options: &RefineOptions<D>,
) -> Similarity<D> {
    if holds_any(&options.held, views) {
        return Similarity::identity();
    }
    let is_member = |view: u32| views.binary_search(&view).is_ok() && is_finite(&start.centers[view as usize]);
    let priors = &options.priors;
    let pairs: Vec<(Vector<D>, Vector<D>)> = (priors.positions.iter())
        .filter(|p| is_member(p.view))
        .map(|p| (start.centers[p.view as usize], p.center))
        .collect();
    let turned = turn_of_orientations(priors, start, is_member);
    let mut fitted = fit(&turned, &pairs);
    let mut kept = pairs.clone();
    for _ in 0..ROUNDS {
        let miss = |(from, to): &(Vector<D>, Vector<D>)| norm(&sub(&fitted.apply(from), to));
        let limit = GROSS * median(&mut pairs.iter().map(miss).collect::<Vec<f64>>());
        let near: Vec<_> = pairs.iter().filter(|pair| miss(pair) <= limit).copied().collect();
        if near == kept || near.len() < 2 {
            break;
        }
        fitted = fit(&turned, &near);
        kept = near;
    }
    fitted
}

/// `B` of the orientations and directions; zero where there are none.
fn turn_of_orientations<const D: usize>(
    priors: &Priors<D>,
    start: &Structure<D>,
    is_member: impl Fn(u32) -> bool,
) -> Matrix<D> {
    let mut sum = [[0.0; D]; D];
    let rotations: Vec<_> = priors.rotations.iter().filter(|p| is_member(p.view)).collect();
    for prior in &rotations {
        let turn = prior.cam_from_world.inverse().compose(&start.cam_from_world[prior.view as usize]);
        add_scaled(&mut sum, turn.matrix(), 1.0 / rotations.len() as f64);
    }
    let directions: Vec<_> = priors.directions.iter().filter(|p| is_member(p.view)).collect();
    for prior in &directions {
        let found = start.cam_from_world[prior.view as usize].inverse().apply(&prior.bearing);
        add_scaled(&mut sum, &outer(&prior.direction, &found), 1.0 / directions.len() as f64);
    }
    sum
}

/// The similarity for these pairs of positions and this evidence of a turn.
fn fit<const D: usize>(turned: &Matrix<D>, pairs: &[(Vector<D>, Vector<D>)]) -> Similarity<D> {
    let mut evidence = *turned;
    let mean = |of: fn(&(Vector<D>, Vector<D>)) -> Vector<D>| -> Vector<D> {
        std::array::from_fn(|c| pairs.iter().map(|pair| of(pair)[c]).sum::<f64>() / pairs.len().max(1) as f64)
    };
    let (from, to) = (mean(|pair| pair.0), mean(|pair| pair.1));
    let squares = |of: fn(&(Vector<D>, Vector<D>)) -> Vector<D>, mean: &Vector<D>| -> f64 {
        pairs.iter().map(|pair| norm(&sub(&of(pair), mean)).powi(2)).sum()
    };
    let length = (squares(|pair| pair.0, &from) * squares(|pair| pair.1, &to)).sqrt();
    if length > 0.0 {
        for (a, b) in pairs {
            add_scaled(&mut evidence, &outer(&sub(b, &to), &sub(a, &from)), 1.0 / length);
        }
    }
    if evidence.iter().flatten().all(|x| *x == 0.0) && pairs.is_empty() {
        return Similarity::identity();
    }
    add_scaled(&mut evidence, Rotation::<D>::identity().matrix(), PRESENT_FRAME);
    let rotation = nearest_rotation(&evidence).unwrap_or(Rotation::identity());
    let turned: Vec<_> = pairs.iter().map(|(a, b)| (rotation.apply(a), *b)).collect();
    match Similarity::fit_unrotated(&turned) {
        Some(shifted) => Similarity { rotation, ..shifted },
        // one position fixes a shift
        None => Similarity { scale: 1.0, rotation, translation: sub(&to, &rotation.apply(&from)) },
    }
}

fn outer<const D: usize>(a: &Vector<D>, b: &Vector<D>) -> Matrix<D> {
    a.map(|x| b.map(|y| x * y))
}

fn add_scaled<const D: usize>(sum: &mut Matrix<D>, m: &Matrix<D>, s: f64) {
    for (row, other) in sum.iter_mut().zip(m) {
        for (x, y) in row.iter_mut().zip(other) {
            *x += s * y;
        }
    }
}
