//! Points one by one, cameras held: which of them tell nothing, and what a second look finds in those that lost rays.

use super::estimate::{Estimate, squared_error};
use super::newton::{Residuals, fit_point, intersect_rays};
use super::noise::{OUTLIER_SIGMAS, chords, inliers};
use super::part::{Lanes, Part, for_each_chunk};

/// A track shows parallax where the squared scatter of its rays about their mean, in units of sigma, exceeds what noise
/// gives by this much: its inverse depth is then known to a quarter or better. Below, depth is too far from linear in the
/// rays for Gauss-Newton, and the track holds next to nothing.
const PARALLAX_SQUARED: f64 = 16.0;
/// Share of the observations whose tracks noise alone may show with parallax.
const CHANCE_PARALLAX: f64 = 0.1;
/// A view keeps its tracks without parallax while it has fewer than this many others.
const ENOUGH_OBSERVATIONS: u32 = 24;
/// Squared errors, over the squared limit, up to which rays take part in the next step of a hypothesis.
const NEARBY: f64 = 9.0;
/// Steps of a hypothesis, the pair itself among them.
const LOCAL_STEPS: usize = 3;
/// Pairs of rays tried for a track that lost most of its rays.
const MAX_HYPOTHESES: usize = 12;

/// Tracks whose rays are parallel within the noise.
pub(crate) struct Parallel {
    /// Those that the descent leaves out: they hold no camera in place, and their depth wanders. A track stays in where one
    /// of its views sees too little else.
    pub left_out: Vec<bool>,
    /// Are there so few others that the views cannot be told from one place?
    pub everything: bool,
}

/// Finds the tracks without parallax among the kept observations.
pub(crate) fn without_parallax<const D: usize>(part: &Part<D>, keep: &[bool], sigma: f64) -> Parallel {
    let mut parallel = vec![false; part.n_tracks()];
    for_each_chunk(part, &mut parallel, |tracks, out| {
        for (j, parallel) in tracks.zip(out) {
            let (_, scatter, count) = mean_direction(part, j, |o| keep[o]);
            let freedom = (D - 1) as f64 * (count - 1.0);
            let limit = freedom + PARALLAX_SQUARED;
            *parallel = !part.holds_point(j) && count >= 2.0 && scatter < limit * sigma * sigma;
        }
    });
    let mut others = vec![0u32; part.n_views];
    for (j, _) in parallel.iter().enumerate().filter(|(_, p)| !**p) {
        for o in part.observations(j).filter(|&o| keep[o]) {
            others[part.view[o] as usize] += 1;
        }
    }
    let informative: u32 = others.iter().sum();
    let kept = keep.iter().filter(|&&k| k).count() as f64;
    let needed = (CHANCE_PARALLAX * kept).max(2.0 * part.n_views as f64);
    let left_out = parallel.iter().enumerate().map(|(j, parallel)| {
        *parallel && part.observations(j).all(|o| others[part.view[o] as usize] >= ENOUGH_OBSERVATIONS)
    });
    Parallel { left_out: left_out.collect(), everything: f64::from(informative) < needed }
}

/// Mean direction of the rays for which `keep` holds, the squared scatter about it weighted by precision, their number.
fn mean_direction<const D: usize>(part: &Part<D>, j: usize, keep: impl Fn(usize) -> bool) -> (Lanes, f64, f64) {
    let (mut sum, mut count) = (Lanes::ZERO, 0.0);
    for o in part.observations(j).filter(|&o| keep(o)) {
        sum = sum.plus_scaled(part.ray[o].0[3], &part.ray[o]);
        count += 1.0;
    }
    let mean = sum.times(1.0 / sum.dot::<D>(&sum).sqrt().max(f64::MIN_POSITIVE));
    let scatter = part.observations(j).filter(|&o| keep(o)).map(|o| {
        let error = part.ray[o].minus(&mean);
        error.dot::<D>(&error) * part.ray[o].0[3]
    });
    let scatter = scatter.sum();
    (mean, scatter, count)
}

/// Looks again at every point with the cameras as they are, and says which observations agree with it.
///
/// A track without parallax is put far away along its mean ray and fitted; a track that lost most of its rays is
/// intersected anew from pairs of them; the others are judged where they are.
pub(crate) fn reconsider<const D: usize>(
    part: &Part<D>,
    estimate: &mut Estimate,
    parallel: &[bool],
    sigma: f64,
) -> Vec<bool> {
    let limit = (OUTLIER_SIGMAS * sigma).powi(2);
    let Estimate { centers, points } = estimate;
    let mut refit = vec![false; part.n_tracks()];
    let mut judged: Vec<(Lanes, bool)> = points.iter().map(|p| (*p, false)).collect();
    for_each_chunk(part, &mut judged, |tracks, out| {
        for (j, (point, refit)) in tracks.zip(out).filter(|(j, _)| !part.holds_point(*j)) {
            let agreeing = agree(part, j, centers, point, limit);
            let count = part.observations(j).len();
            let lost = count > 2 && agreeing < count && (agreeing < 3 || 2 * agreeing < count);
            let better = if lost { best_hypothesis(part, j, centers, point, limit) } else { None };
            if let Some(better) = better {
                (*point, *refit) = (better, true);
            } else if parallel[j] {
                (*point, *refit) = (far_away(part, j, centers, point, limit), true);
            }
        }
    });
    for (j, (point, changed)) in judged.into_iter().enumerate() {
        (points[j], refit[j]) = (point, changed);
    }
    let keep = inliers(part, &chords(part, estimate), OUTLIER_SIGMAS * sigma);
    let residuals = Residuals::new(part, &keep, sigma);
    let mut fitted = estimate.points.clone();
    for_each_chunk(part, &mut fitted, |tracks, out| {
        for (j, point) in tracks.zip(out).filter(|(j, _)| refit[*j]) {
            let cost = residuals.cost(j, &estimate.centers, point);
            *point = fit_point(&residuals, j, &estimate.centers, (*point, cost)).0;
        }
    });
    estimate.points = fitted;
    keep
}

fn agree<const D: usize>(part: &Part<D>, j: usize, centers: &[Lanes], point: &Lanes, limit: f64) -> usize {
    part.observations(j).filter(|&o| squared_error(part, o, centers, point) < limit).count()
}

/// Sum of squared errors, each at most the limit.
fn truncated_cost<const D: usize>(part: &Part<D>, j: usize, centers: &[Lanes], point: &Lanes, limit: f64) -> f64 {
    part.observations(j).map(|o| squared_error(part, o, centers, point).min(limit)).sum()
}

/// Along the mean of the rays that agree with each other, at the distance beyond which depth means nothing; the present
/// position where that is better.
fn far_away<const D: usize>(part: &Part<D>, j: usize, centers: &[Lanes], point: &Lanes, limit: f64) -> Lanes {
    let (mean, _, _) = mean_direction(part, j, |o| squared_error(part, o, centers, point) < limit);
    let first = &centers[part.view[part.start[j] as usize] as usize];
    let baseline = part.observations(j).map(|o| {
        let u = centers[part.view[o] as usize].minus(first);
        u.dot::<D>(&u).sqrt()
    });
    let mut far = first.plus_scaled(FAR * baseline.fold(f64::MIN_POSITIVE, f64::max), &mean);
    far.0[3] = 0.0;
    let better = truncated_cost(part, j, centers, &far, limit) < truncated_cost(part, j, centers, point, limit);
    if better { far } else { *point }
}

/// The intersection of two rays with which the others agree best; `None` where none is better than the present position.
fn best_hypothesis<const D: usize>(
    part: &Part<D>,
    j: usize,
    centers: &[Lanes],
    point: &Lanes,
    limit: f64,
) -> Option<Lanes> {
    let observations = part.observations(j);
    let count = observations.len();
    // wide pairs first: they fix the depth best
    let pairs = (1..count).rev().flat_map(|gap| (0..count - gap).map(move |i| (i, i + gap)));
    let mut best = (truncated_cost(part, j, centers, point, limit), None);
    for (i, k) in pairs.take(MAX_HYPOTHESES) {
        let pair = [observations.start + i, observations.start + k];
        if part.node_of(pair[0]) == part.node_of(pair[1]) {
            continue;
        }
        // two rays fix a point coarsely: those that pass it by a little more than the limit fix it better
        let mut candidate = intersect_rays::<D>(part, pair.into_iter(), centers, point);
        for _ in 0..LOCAL_STEPS {
            let cost = truncated_cost(part, j, centers, &candidate, limit);
            if cost < best.0 {
                best = (cost, Some(candidate));
            }
            let near = |&o: &usize| squared_error(part, o, centers, &candidate) < NEARBY * limit;
            let nearby: Vec<usize> = observations.clone().filter(near).collect();
            candidate = intersect_rays::<D>(part, nearby.into_iter(), centers, &candidate);
        }
    }
    best.1
}

/// Distance, in baselines of the track, beyond which depth means nothing.
pub(crate) const FAR: f64 = 300.0;

/// Moves points that lie behind most of their views, or farther than [`FAR`] baselines of their track, to that distance
/// along the mean ray.
pub(crate) fn repair_cheirality<const D: usize>(part: &Part<D>, estimate: &mut Estimate) {
    let Estimate { centers, points } = estimate;
    for_each_chunk(part, points, |tracks, out| {
        for (j, point) in tracks.zip(out).filter(|(j, _)| !part.holds_point(*j)) {
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

/// The kept observations less those of some tracks.
pub(crate) fn without_tracks<const D: usize>(part: &Part<D>, keep: &[bool], left_out: &[bool]) -> Vec<bool> {
    let mut active = keep.to_vec();
    for (j, _) in left_out.iter().enumerate().filter(|(_, out)| **out) {
        active[part.observations(j)].fill(false);
    }
    active
}
