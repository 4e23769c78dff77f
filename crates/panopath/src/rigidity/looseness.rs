//! How firmly each member is held: standard deviations at one radian of noise, from the information of a rigid frame.

use rayon::prelude::*;

use super::frame::Frame;
use super::spectrum::{Analysis, Mobility};
use super::{LOOSE_POINT, noise_multiple};
use crate::bundle::determinacy::clear_held;
use crate::bundle::estimate::Estimate;
use crate::bundle::newton::NewtonWeights;
use crate::bundle::noise::median;
use crate::bundle::part::{Lanes, Layout};
use crate::bundle::reduced::{PointSum, Weighing};
use crate::least_squares::{LeastSquaresError, SelectedInverse, inner};

/// A point is far where the spread of its views, or their range of sight, is less than this share of its distance.
const REALLY_FAR: f64 = 0.1;
/// A far point must show that it is: by views that stand across its ray, this many times (squared) farther apart than noise
/// would let them appear were they all on one line with a near one.
const FAR_MULTIPLE: f64 = 600.0;
/// For a near point it is what noise gives to modes, times this: its views err too.
const NEAR_MULTIPLE: f64 = 1.4;
/// Inverse iterations for what a point's rays resist least, and the relative change of the variance that ends them.
const MOST_ITERATIONS: usize = 40;
const SETTLED: f64 = 1e-4;
/// Views that share tracks with a view and are compared with it, the nearest in the pattern.
const NEIGHBOURS: usize = 48;

/// Standard deviation of each view's centre against the member that holds it best, as a share of its distance from all of
/// these (the median); infinite where the frame is not determined. The members are the views that it shares tracks with, or
/// the points that it sees, where points are fewer and stay in the system.
pub(super) fn of_views<const D: usize, const W: usize, M: Mobility<D, W>>(
    analysis: &Analysis<'_, D, W, M>,
) -> Result<Vec<f64>, LeastSquaresError> {
    let frame = analysis.frame;
    let n = frame.views.len();
    let mut held = analysis.pinned();
    let farthest = farthest_coordinate::<D, W>(frame, &held);
    held[farthest] = true;
    let system = analysis.assemble(0.0, &held)?;
    let (pattern, values) = system.matrix();
    let inverse = match SelectedInverse::<W>::new(pattern, values) {
        Err(LeastSquaresError::Singular { .. }) => return Ok(vec![f64::INFINITY; n]),
        other => other?,
    };
    let growth = Growth::of(frame, &inverse, &held, pattern.n_nodes())?;
    let members = Members { frame, inverse: &inverse, held: &held, growth, keeps_points: pattern.n_nodes() > n };
    let neighbours = members.neighbours();
    let looseness = |&a: &usize| {
        let compared = &neighbours[a];
        let mut apart: Vec<f64> = compared.iter().map(|&b| members.distance(a, b as usize)).collect();
        let typical = median(&mut apart).max(f64::MIN_POSITIVE);
        let variances = compared.iter().map(|&b| members.relative_variance(a, b as usize));
        // rounding takes what is held very firmly below zero
        variances.fold(f64::INFINITY, f64::min).max(0.0).sqrt() / typical
    };
    Ok((0..n).collect::<Vec<usize>>().par_iter().map(looseness).collect())
}

/// Nodes of the system: views, and points where these are kept.
struct Members<'a, const D: usize, const W: usize> {
    frame: &'a Frame<D>,
    inverse: &'a SelectedInverse<W>,
    held: &'a [bool],
    growth: Growth,
    keeps_points: bool,
}

/// How the size of all views errs, where one coordinate is held instead: growth is `g = sum a^T x` with arms `a` of the views.
struct Growth {
    variance: f64,
    /// Covariance of each member's position with it, views first.
    with: Vec<Lanes>,
}

impl Growth {
    fn of<const D: usize, const W: usize>(
        frame: &Frame<D>,
        inverse: &SelectedInverse<W>,
        held: &[bool],
        n_nodes: usize,
    ) -> Result<Self, LeastSquaresError> {
        let arms = Self::arms::<D, W>(frame);
        let mut with = arms.clone();
        clear_held(held, &mut with);
        // points that are kept in the system pull at nothing
        with.resize(n_nodes * W, 0.0);
        inverse.solve(&mut with, 1)?;
        with.truncate(arms.len());
        let variance = inner(&arms, &with);
        let of_views = with.as_chunks::<W>().0.iter();
        let of_views = of_views.map(|x| Lanes::from_vector::<D>(&std::array::from_fn(|c| x[W - D + c])));
        Ok(Self { variance, with: of_views.chain(frame.followers::<W>(&with)).collect() })
    }

    /// Arms of the views from their middle, none of them much longer than most: a view far off that little holds would rule
    /// the size otherwise. They add up to nothing, and to growth one where each view moves by its place.
    fn arms<const D: usize, const W: usize>(frame: &Frame<D>) -> Vec<f64> {
        const LONGEST: f64 = 2.0;
        let centers = &frame.estimate.centers;
        let middle = Lanes(std::array::from_fn(|c| median(&mut centers.iter().map(|x| x.0[c]).collect::<Vec<f64>>())));
        let length = |x: &Lanes| x.dot::<D>(x).sqrt();
        let typical = median(&mut centers.iter().map(|x| length(&x.minus(&middle))).collect::<Vec<f64>>());
        let limit = if typical > 0.0 { LONGEST * typical } else { f64::INFINITY };
        let short = |x: &Lanes| {
            let arm = x.minus(&middle);
            arm.times(f64::min(1.0, limit / length(&arm).max(f64::MIN_POSITIVE)))
        };
        let sees_much = see_much(frame);
        let firm: Vec<usize> = (0..centers.len()).filter(|&v| sees_much[v]).collect();
        let arms: Vec<Lanes> = firm.iter().map(|&v| short(&centers[v])).collect();
        let mean = arms.iter().fold(Lanes::ZERO, |sum, a| sum.plus_scaled(1.0 / arms.len() as f64, a));
        let reach: f64 = arms.iter().zip(&firm).map(|(a, &v)| a.minus(&mean).dot::<D>(&centers[v])).sum();
        let mut rows = vec![0.0; centers.len() * W];
        for (arm, &v) in arms.iter().zip(&firm) {
            (0..D).for_each(|c| rows[v * W + W - D + c] = (arm.0[c] - mean.0[c]) / reach);
        }
        rows
    }
}

/// Views that see half as many points as most do, or more: what sees less may be held by little, and is no measure.
fn see_much<const D: usize>(frame: &Frame<D>) -> Vec<bool> {
    let mut count = vec![0.0f64; frame.views.len()];
    (0..frame.part.n_observations()).for_each(|o| count[frame.part.node_of(o) as usize] += 1.0);
    let typical = median(&mut count.clone());
    count.iter().map(|&n| n >= 0.5 * typical).collect()
}

impl<const D: usize, const W: usize> Members<'_, D, W> {
    fn position(&self, node: usize) -> &Lanes {
        let Estimate { centers, points } = &self.frame.estimate;
        if node < centers.len() { &centers[node] } else { &points[node - centers.len()] }
    }

    fn distance(&self, a: usize, b: usize) -> f64 {
        let u = self.position(a).minus(self.position(b));
        u.dot::<D>(&u).sqrt()
    }

    /// What each view is compared with.
    fn neighbours(&self) -> Vec<Vec<u32>> {
        let part = &self.frame.part;
        let n = self.frame.views.len();
        let mut of_view: Vec<Vec<u32>> = vec![Vec::new(); n];
        for j in 0..part.n_tracks() {
            part.observations(j).for_each(|o| of_view[part.node_of(o) as usize].push(j as u32));
        }
        if self.keeps_points {
            return of_view.into_iter().map(|seen| seen.into_iter().map(|j| n as u32 + j).collect()).collect();
        }
        let nearest = |&a: &usize| most_shared(part, &of_view[a], a as u32);
        (0..n).collect::<Vec<usize>>().par_iter().map(nearest).collect()
    }

    /// Unknown of a node that moves it along an axis, if it is free.
    fn unknown(&self, node: usize, axis: usize) -> (usize, bool) {
        let is_view = node < self.frame.views.len();
        let k = if is_view { W - D + axis } else { axis };
        (k, is_view && self.held[node * W + k])
    }

    /// Trace of the covariance of the positions of two members against each other; infinite where the factor does not hold it.
    fn relative_variance(&self, a: usize, b: usize) -> f64 {
        let entry = |x: usize, y: usize, axis: usize| {
            let ((row, row_held), (column, column_held)) = (self.unknown(x, axis), self.unknown(y, axis));
            if row_held || column_held {
                return Some(0.0);
            }
            self.inverse.block(x, y).map(|block| block[row][column])
        };
        let apart = self.position(a).minus(self.position(b));
        let grown = |axis: usize| {
            // with the size of all views held instead of one coordinate
            let with = self.growth.with[a].minus(&self.growth.with[b]).0[axis];
            apart.0[axis] * (apart.0[axis] * self.growth.variance - 2.0 * with)
        };
        let along = |axis| Some(entry(a, a, axis)? + entry(b, b, axis)? - 2.0 * entry(a, b, axis)? + grown(axis));
        (0..D).map(|axis| along(axis).unwrap_or(f64::INFINITY)).sum()
    }
}

/// Views that share most of these tracks with a view.
fn most_shared(layout: &Layout, tracks: &[u32], view: u32) -> Vec<u32> {
    /// Views of a long track that are counted.
    const LONG: usize = 64;
    let mut count = std::collections::BTreeMap::new();
    for &j in tracks {
        for o in layout.observations(j as usize).take(LONG) {
            *count.entry(layout.node_of(o)).or_insert(0u32) += 1;
        }
    }
    count.remove(&view);
    let mut ranked: Vec<(u32, u32)> = count.into_iter().map(|(view, n)| (n, view)).collect();
    ranked.sort_unstable_by_key(|&(n, view)| (u32::MAX - n, view));
    ranked.into_iter().take(NEIGHBOURS).map(|(_, view)| view).collect()
}

/// The coordinate farthest from the view that is pinned: holding it fixes the size.
fn farthest_coordinate<const D: usize, const W: usize>(frame: &Frame<D>, held: &[bool]) -> usize {
    let pinned = (0..frame.views.len()).find(|&v| held[v * W..(v + 1) * W].iter().all(|h| *h)).unwrap_or(0);
    let origin = frame.estimate.centers[pinned].vector::<D>();
    let mut farthest = (W - D, 0.0);
    let sees_much = see_much(frame);
    for (node, center) in frame.estimate.centers.iter().enumerate().filter(|(node, _)| sees_much[*node]) {
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
/// spread of its views (or over the distance at which these see things, where that is more), if this is less: a point may be
/// as far as it likes, if it is known to be far.
///
/// A point that could slide along its rays but for the noise in them counts as [`LOOSE_POINT`] or more: sliding by `a` stretches
/// the segments by `lambda` and, at positions that err by the noise, turns them by about `sigma lambda`.
pub(super) fn of_points<const D: usize>(frame: &Frame<D>) -> Vec<f64> {
    let sight = ranges_of_sight(frame);
    let of = |j: &usize| Slide::<D>::of(frame, *j, &sight).map_or(f64::INFINITY, |slide| slide.looseness());
    (0..frame.part.n_tracks()).collect::<Vec<usize>>().par_iter().map(of).collect()
}

/// Distance of half of the points that each view sees.
fn ranges_of_sight<const D: usize>(frame: &Frame<D>) -> Vec<f64> {
    let mut distances: Vec<Vec<f64>> = vec![Vec::new(); frame.views.len()];
    for j in 0..frame.part.n_tracks() {
        for o in frame.part.observations(j) {
            let u = frame.segment(o, j);
            distances[frame.part.node_of(o) as usize].push(u.dot::<D>(&u).sqrt());
        }
    }
    distances.par_iter_mut().map(|d| median(d)).collect()
}

/// The displacement of a point that its rays resist least.
struct Slide<const D: usize> {
    /// Numbers that its rays tell.
    rows: f64,
    /// Variance along it at one radian of noise.
    variance: f64,
    /// Squared stretch rates of the segments, added up.
    stretched: f64,
    /// Rms distance from its views.
    far: f64,
    /// Largest distance of these from their middle, or how far they see, where that is more.
    reach: f64,
}

impl<const D: usize> Slide<D> {
    fn of(frame: &Frame<D>, j: usize, sight: &[f64]) -> Option<Self> {
        let observations = frame.part.observations(j);
        let n = observations.len() as f64;
        let middle = observations.clone().fold(Lanes::ZERO, |sum, o| sum.plus_scaled(1.0 / n, frame.center(o)));
        let (mut squared, mut spread, mut seen) = (0.0, 0.0f64, 0.0);
        for o in observations.clone() {
            seen += sight[frame.part.node_of(o) as usize] / n;
            let (u, arm) = (frame.segment(o, j), frame.center(o).minus(&middle));
            squared += u.dot::<D>(&u) / n;
            spread = spread.max(arm.dot::<D>(&arm).sqrt());
        }
        let far = squared.sqrt();
        let reach = frame.estimate.points[j].minus(&middle);
        let (along, variance) = if spread < REALLY_FAR * far {
            Self::from_afar(frame, j, &middle, &reach)
        } else {
            Self::weakest(frame, j, &reach)
        }?;
        let stretch = |o: usize| {
            let u = frame.segment(o, j);
            (u.dot::<D>(&along) / u.dot::<D>(&u)).powi(2)
        };
        Some(Self {
            rows: (D - 1) as f64 * n,
            variance,
            stretched: observations.map(stretch).sum(),
            far,
            reach: spread.max(seen),
        })
    }

    /// Along the mean ray. How far views stand across it is known as well as where they are, though rays from there may be
    /// parallel as far as numbers go.
    fn from_afar(frame: &Frame<D>, j: usize, middle: &Lanes, reach: &Lanes) -> Option<(Lanes, f64)> {
        let along = reach.times(1.0 / reach.dot::<D>(reach).sqrt());
        let turned = frame.part.observations(j).map(|o| {
            let (u, arm) = (frame.segment(o, j), frame.center(o).minus(middle));
            let across = arm.plus_scaled(-arm.dot::<D>(&along), &along);
            frame.part.ray[o].0[3] * across.dot::<D>(&across) / u.dot::<D>(&u).powi(2)
        });
        Some((along, 1.0 / turned.sum::<f64>()))
    }

    /// Where the rays resist least, by inverse iteration from the mean ray.
    fn weakest(frame: &Frame<D>, j: usize, reach: &Lanes) -> Option<(Lanes, f64)> {
        let weights = NewtonWeights::new(&frame.part, &frame.estimate, &frame.keep, f64::INFINITY);
        let mut sum = PointSum::<D>::new();
        frame.part.observations(j).for_each(|o| sum.add(&weights.observe(o, j)));
        let factor = sum.factor(0.0, &Lanes::ZERO);
        let unit = |x: &Lanes| {
            let length = x.dot::<D>(x).sqrt();
            (length.is_finite() && length > 0.0).then(|| x.times(1.0 / length))
        };
        let mut along = unit(&reach.plus_scaled(1e-3, &Lanes::from_vector::<D>(&[1.0; D])))?;
        let mut variance = 0.0;
        for _ in 0..MOST_ITERATIONS {
            let next = factor.solve(&along);
            let before = std::mem::replace(&mut variance, next.dot::<D>(&along));
            along = unit(&next)?;
            if variance - before <= SETTLED * variance {
                break;
            }
        }
        Some((along, variance))
    }

    fn looseness(&self) -> f64 {
        let known_far = f64::min(1.0, self.reach / self.far);
        let deviation = self.variance.sqrt() * known_far;
        let multiple = if known_far < REALLY_FAR { FAR_MULTIPLE } else { NEAR_MULTIPLE * noise_multiple(self.rows) };
        let near_null = LOOSE_POINT * ((D - 1) as f64 * multiple * self.stretched).sqrt();
        deviation * f64::max(1.0 / self.far, near_null)
    }
}
