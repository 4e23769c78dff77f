//! How firmly each member is held: standard deviations at one radian of noise, from the information of a rigid frame.

use rayon::prelude::*;

use super::frame::Frame;
use super::spectrum::{Analysis, Mobility};
use crate::bundle::newton::NewtonWeights;
use crate::bundle::part::Lanes;
use crate::bundle::reduced::{PointSum, Weighing};
use crate::geometry::Vector;
use crate::least_squares::{LeastSquaresError, SelectedInverse};

/// Views that share tracks with a view and are compared with it, the nearest in the pattern.
const NEIGHBOURS: usize = 48;

/// Standard deviation of each view's centre against the view that holds it best, as a share of its distance from the
/// views that it shares tracks with (the median); infinite where the frame is not determined.
pub(super) fn of_views<const D: usize, const W: usize, M: Mobility<D, W>>(
    analysis: &Analysis<'_, D, W, M>,
    scale_is_free: bool,
) -> Result<Vec<f64>, LeastSquaresError> {
    let frame = analysis.frame;
    let n = frame.views.len();
    let mut held = analysis.pinned();
    if scale_is_free {
        let farthest = farthest_coordinate::<D, W>(frame, &held);
        held[farthest] = true;
    }
    let nothing = vec![f64::INFINITY; n];
    let system = match analysis.assemble(0.0, &held) {
        Err(LeastSquaresError::Singular { .. }) => return Ok(nothing),
        other => other?,
    };
    let (pattern, values) = system.matrix();
    let inverse = match SelectedInverse::<W>::new(pattern, values) {
        Err(LeastSquaresError::Singular { .. }) => return Ok(nothing),
        other => other?,
    };
    let neighbours = neighbours(frame);
    let looseness = |a: &usize| {
        let compared = &neighbours[*a];
        let mut apart: Vec<f64> = compared.iter().map(|&b| distance(frame, *a, b as usize)).collect();
        let typical = crate::bundle::noise::median(&mut apart).max(f64::MIN_POSITIVE);
        let variance = |b: u32| relative_variance::<D, W>(&inverse, &held, *a, b as usize);
        let least = compared.iter().map(|&b| variance(b)).fold(f64::INFINITY, f64::min);
        least.sqrt() / typical
    };
    Ok((0..n).collect::<Vec<usize>>().par_iter().map(looseness).collect())
}

fn distance<const D: usize>(frame: &Frame<D>, a: usize, b: usize) -> f64 {
    let u = frame.estimate.centers[a].minus(&frame.estimate.centers[b]);
    u.dot::<D>(&u).sqrt()
}

/// Views that share most tracks with each view.
fn neighbours<const D: usize>(frame: &Frame<D>) -> Vec<Vec<u32>> {
    /// Longest track whose views are all counted as pairs.
    const LONG: usize = 64;
    let part = &frame.part;
    let n = frame.views.len();
    let mut of_view: Vec<Vec<u32>> = vec![Vec::new(); n];
    for j in 0..part.n_tracks() {
        part.observations(j).for_each(|o| of_view[part.node_of(o) as usize].push(j as u32));
    }
    let shared = |a: &usize| {
        let mut count = std::collections::BTreeMap::new();
        for &j in &of_view[*a] {
            for o in part.observations(j as usize).take(LONG) {
                *count.entry(part.node_of(o)).or_insert(0u32) += 1;
            }
        }
        count.remove(&(*a as u32));
        let mut ranked: Vec<(u32, u32)> = count.into_iter().map(|(view, n)| (n, view)).collect();
        ranked.sort_unstable_by_key(|&(n, view)| (u32::MAX - n, view));
        ranked.into_iter().take(NEIGHBOURS).map(|(_, view)| view).collect()
    };
    (0..n).collect::<Vec<usize>>().par_iter().map(shared).collect()
}

/// Trace of the covariance of `c_a - c_b`.
fn relative_variance<const D: usize, const W: usize>(
    inverse: &SelectedInverse<W>,
    held: &[bool],
    a: usize,
    b: usize,
) -> f64 {
    let entry = |x: usize, y: usize, k: usize| {
        if held[x * W + k] || held[y * W + k] {
            return Some(0.0);
        }
        inverse.block(x, y).map(|block| block[k][k])
    };
    let along = |k: usize| Some(entry(a, a, k)? + entry(b, b, k)? - 2.0 * entry(a, b, k)?);
    (W - D..W).map(|k| along(k).unwrap_or(f64::INFINITY)).sum()
}

/// The coordinate farthest from the view that is pinned: holding it fixes the size.
fn farthest_coordinate<const D: usize, const W: usize>(frame: &Frame<D>, held: &[bool]) -> usize {
    let pinned = (0..frame.views.len()).find(|&v| held[v * W..(v + 1) * W].iter().all(|h| *h)).unwrap_or(0);
    let origin = frame.estimate.centers[pinned].vector::<D>();
    let mut farthest = (W - D, 0.0);
    for (node, center) in frame.estimate.centers.iter().enumerate() {
        for c in 0..D {
            let distance = (center.0[c] - origin[c]).abs();
            if distance > farthest.1 {
                farthest = (node * W + W - D + c, distance);
            }
        }
    }
    farthest.0
}

/// Standard deviation of each point, its views held, as a share of its distance, or of the square of its distance over the
/// spread of its views where that is less: a point may be as far as it likes, if it is known to be far.
pub(super) fn of_points<const D: usize>(frame: &Frame<D>) -> Vec<f64> {
    let weights = NewtonWeights::new(&frame.part, &frame.estimate, &frame.keep, f64::INFINITY);
    let of = |j: &usize| {
        let mut sum = PointSum::<D>::new();
        let observations = frame.part.observations(*j);
        let n = observations.len() as f64;
        let mut middle: Vector<D> = [0.0; D];
        for o in observations.clone() {
            sum.add(&weights.observe(o, *j));
            let center = &frame.estimate.centers[frame.part.node_of(o) as usize];
            (0..D).for_each(|c| middle[c] += center.0[c] / n);
        }
        let middle = Lanes::from_vector::<D>(&middle);
        let factor = sum.factor(0.0, &Lanes::ZERO);
        let variance: f64 =
            (0..D).map(|c| factor.solve(&Lanes(std::array::from_fn(|r| f64::from(u8::from(r == c))))).0[c]).sum();
        let reach = |x: &Lanes| {
            let u = x.minus(&middle);
            u.dot::<D>(&u).sqrt()
        };
        let far = reach(&frame.estimate.points[*j]);
        let spread =
            observations.map(|o| reach(&frame.estimate.centers[frame.part.node_of(o) as usize])).fold(0.0, f64::max);
        variance.sqrt() * f64::min(1.0, spread / far) / far
    };
    (0..frame.part.n_tracks()).collect::<Vec<usize>>().par_iter().map(of).collect()
}
