//! One track by itself, cameras held: the vectors of its path, robustly.
//!
//! `min sum rho(|v - u/|u|| / sigma)`, `u = sum_l B_l(t) p_l - c`. First by re-weighted linear least squares
//! `min sum w |(I - v v^T) u|^2` with Geman and McClure's weights whose scale falls with the errors, then by Gauss-Newton on
//! the chord.

use super::basis::Form;
use super::frequency::has_frequency;
use super::select::chi_squared;
use crate::bundle::newton::{chord_model, huber_cost};
use crate::bundle::noise::{HUBER_SIGMAS, OUTLIER_SIGMAS, median};
use crate::bundle::part::{Course, Lanes};

/// Rounds of re-weighting.
const ROUNDS: usize = 8;
/// The scale of the weights over the median error, and the noise below which it does not fall.
const SCALE_OVER_MEDIAN: f64 = 2.0;
/// Gauss-Newton steps.
const STEPS: usize = 8;
/// A step that lowers the cost by less than this, in units of sigma squared, is the last.
const LITTLE_GAIN: f64 = 1e-3;
/// Where a fit to all observations errs by more than noise does, fits to so many small subsets are tried.
const SUBSETS: usize = 12;
const SUBSETS_Z: f64 = 2.3;
/// They end where no more than this share errs.
const FEW_OUTLIERS: f64 = 0.2;
/// Observations beyond those that the unknowns take, so that a fit says anything.
const SPARE_ROWS: usize = 2;

/// What was seen of one track: rays with their precision in lane 3, from where, and when.
#[derive(Default)]
pub(super) struct Sightings {
    pub rays: Vec<Lanes>,
    pub centers: Vec<Lanes>,
    pub time_s: Vec<f64>,
}

impl Sightings {
    pub fn len(&self) -> usize {
        self.rays.len()
    }

    /// First and last time.
    pub fn span(&self) -> (f64, f64) {
        self.time_s.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), &t| (a.min(t), b.max(t)))
    }

    /// Values of the functions of a form, one row for each observation.
    pub fn values(&self, form: &Form) -> Vec<f64> {
        let k = form.len();
        let mut values = vec![0.0; k * self.len()];
        for (row, &time) in values.chunks_exact_mut(k).zip(&self.time_s) {
            form.values(time, 0, row);
        }
        values
    }
}

/// Normal equations of the vectors of one path; their storage is used for one step after the other.
///
/// What `bundle::courses` sums takes the cameras' part along, which is most of the work and not wanted here.
#[derive(Default)]
pub(super) struct Equations {
    n: usize,
    /// Lower triangle by rows, then its factor.
    matrix: Vec<f64>,
    right: Vec<f64>,
}

/// Keeps the equations positive definite where a path is not determined, relative to their trace.
const FLOOR: f64 = 1e-14;

impl Equations {
    pub fn clear(&mut self, n: usize) {
        self.n = n;
        self.matrix.clear();
        self.matrix.resize(n * n, 0.0);
        self.right.clear();
        self.right.resize(n, 0.0);
    }

    /// Adds `w |(I - v v^T) sum_l B_l x_l - ..|^2`, of which `pull` is the right-hand side.
    #[inline(always)]
    pub fn add<const D: usize>(&mut self, values: &[f64], along: &Lanes, weight: f64, pull: &Lanes) {
        let n = self.n;
        let block: [[f64; D]; D] =
            std::array::from_fn(|r| std::array::from_fn(|c| weight * (f64::from(r == c) - along.0[r] * along.0[c])));
        for (a, value) in values.iter().enumerate() {
            for (r, row) in block.iter().enumerate() {
                let own = a * D + r;
                self.right[own] += value * pull.0[r];
                let lower = &mut self.matrix[own * n..own * n + (a + 1) * D];
                for (other, entries) in values.iter().zip(lower.as_chunks_mut::<D>().0) {
                    let factor = value * other;
                    entries.iter_mut().zip(row).for_each(|(entry, x)| *entry += factor * x);
                }
            }
        }
    }

    /// The solution, damped along the diagonal; `None` where it is not finite.
    pub fn solve(&mut self, damping: f64) -> Option<&[f64]> {
        let n = self.n;
        let (matrix, x) = (&mut self.matrix, &mut self.right);
        let trace: f64 = (0..n).map(|i| matrix[i * n + i]).sum();
        if !trace.is_finite() || trace <= 0.0 {
            return None;
        }
        let floor = FLOOR * trace;
        for r in 0..n {
            let (before, row) = matrix.split_at_mut(r * n);
            for c in 0..r {
                let other = &before[c * n..=c * n + c];
                let known: f64 = row[..c].iter().zip(other).map(|(a, b)| a * b).sum();
                row[c] = (row[c] - known) / other[c];
            }
            let known: f64 = row[..r].iter().map(|a| a * a).sum();
            row[r] = (row[r] * (1.0 + damping) - known + floor).max(floor).sqrt();
            let behind: f64 = row[..r].iter().zip(x.iter()).map(|(a, b)| a * b).sum();
            x[r] = (x[r] - behind) / row[r];
        }
        for r in (0..n).rev() {
            x[r] /= matrix[r * n + r];
            for c in 0..r {
                x[c] -= matrix[r * n + c] * x[r];
            }
        }
        x.iter().all(|x| x.is_finite()).then_some(&self.right)
    }
}

/// A path fitted to one track.
#[derive(Clone)]
pub(super) struct Fit {
    pub form: Form,
    pub vectors: Vec<Lanes>,
    /// Which observations agree with it.
    pub keep: Vec<bool>,
    /// Squared errors in units of sigma, none counted beyond the outlier limit.
    pub cost: f64,
}

impl Fit {
    pub fn n_kept(&self) -> usize {
        self.keep.iter().filter(|&&k| k).count()
    }
}

/// Fits a path of a form. `None` where too few observations agree with any, or it lies behind the cameras.
pub(super) fn fit<const D: usize>(sightings: &Sightings, form: &Form, sigma: f64) -> Option<Fit> {
    let n = sightings.len();
    let (first, last) = sightings.span();
    let form = form.over(first, last);
    if !has_frequency(&form) {
        return None;
    }
    let needed = (D * form.len()).div_ceil(D - 1);
    if n < needed {
        return None;
    }
    let values = sightings.values(&form);
    let course = Course { n_functions: form.len(), values: &values, bends: None };
    let mut equations = Equations::default();
    let cost = |vectors: &[Lanes]| truncated_cost::<D>(sightings, course, vectors, sigma);
    let everything = vec![1.0; n];
    let mut best = reweighted::<D>(sightings, course, sigma, everything, &mut equations).map(|v| (cost(&v), v));
    let fine = chi_squared(((D - 1) * n - D * form.len().min((D - 1) * n / D)) as f64, SUBSETS_Z);
    if best.as_ref().is_none_or(|(cost, _)| *cost > fine) {
        // false rays may have drawn it away: some subset is free of them
        let size = (needed + 1).min(n);
        for subset in 0..SUBSETS {
            let Some(vectors) = linear::<D>(sightings, course, &subset_weights(n, size, subset), &mut equations) else {
                continue;
            };
            let reached = cost(&vectors);
            if best.as_ref().is_none_or(|(least, _)| reached < *least) {
                best = Some((reached, vectors));
            }
            if reached <= fine + FEW_OUTLIERS * n as f64 * OUTLIER_SIGMAS * OUTLIER_SIGMAS {
                break;
            }
        }
    }
    let (_, vectors) = best?;
    settled::<D>(sightings, form, course, vectors, sigma, &mut equations)
}

/// Fits a path of a form from vectors that are near.
pub(super) fn fit_near<const D: usize>(
    sightings: &Sightings,
    form: &Form,
    sigma: f64,
    vectors: Vec<Lanes>,
) -> Option<Fit> {
    if vectors.iter().any(|p| p.0.iter().any(|x| !x.is_finite())) {
        return None;
    }
    let values = sightings.values(form);
    let course = Course { n_functions: form.len(), values: &values, bends: None };
    settled::<D>(sightings, form.clone(), course, vectors, sigma, &mut Equations::default())
}

/// What agrees with a point at rest, as it stands.
pub(super) fn still_at<const D: usize>(sightings: &Sightings, sigma: f64, point: Lanes) -> Fit {
    let values = vec![1.0; sightings.len()];
    let course = Course { n_functions: 1, values: &values, bends: None };
    let vectors = vec![point];
    let keep = kept::<D>(sightings, course, &vectors, OUTLIER_SIGMAS * sigma);
    let cost = truncated_cost::<D>(sightings, course, &vectors, sigma);
    Fit { form: Form::Static, vectors, keep, cost }
}

/// Ones for some of the observations, spread over the track in a way of its own for each subset.
fn subset_weights(n: usize, size: usize, subset: usize) -> Vec<f64> {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let mut order: Vec<(f64, usize)> =
        (0..n).map(|k| (((k + 1) as f64 * (subset + 1) as f64 * GOLDEN).fract(), k)).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut weights = vec![0.0; n];
    order[..size].iter().for_each(|&(_, k)| weights[k] = 1.0);
    weights
}

/// The minimum near some vectors, and what agrees with it.
fn settled<const D: usize>(
    sightings: &Sightings,
    form: Form,
    course: Course<'_>,
    vectors: Vec<Lanes>,
    sigma: f64,
    equations: &mut Equations,
) -> Option<Fit> {
    let unknowns = D * form.len();
    let mut found = Fit { vectors, keep: vec![true; sightings.len()], cost: f64::INFINITY, form };
    // outliers are told better from the minimum, at first within a wider limit
    for limit in [2.0 * OUTLIER_SIGMAS, OUTLIER_SIGMAS] {
        found.keep = kept::<D>(sightings, course, &found.vectors, limit * sigma);
        if (D - 1) * found.n_kept() < unknowns {
            return None;
        }
        descend::<D>(sightings, course, sigma, &mut found, equations);
    }
    found.keep = kept::<D>(sightings, course, &found.vectors, OUTLIER_SIGMAS * sigma);
    found.cost = truncated_cost::<D>(sightings, course, &found.vectors, sigma);
    ((D - 1) * found.n_kept() >= unknowns).then_some(found)
}

/// Does a fit have observations to spare, so that agreement means something?
pub(super) fn has_spare<const D: usize>(fit: &Fit) -> bool {
    (D - 1) * fit.n_kept() >= D * fit.form.len() + SPARE_ROWS
}

/// Re-weighted linear least squares.
fn reweighted<const D: usize>(
    sightings: &Sightings,
    course: Course<'_>,
    sigma: f64,
    mut weights: Vec<f64>,
    equations: &mut Equations,
) -> Option<Vec<Lanes>> {
    let mut vectors = linear::<D>(sightings, course, &weights, equations)?;
    let mut before = f64::INFINITY;
    let (mut chords, mut errors) = (Vec::with_capacity(sightings.len()), Vec::with_capacity(sightings.len()));
    for _ in 0..ROUNDS {
        chords.clear();
        chords.extend((0..sightings.len()).map(|k| chord::<D>(sightings, course, k, &vectors)));
        errors.clear();
        errors.extend(chords.iter().map(|(error, _)| *error));
        let scale = (SCALE_OVER_MEDIAN * median(&mut errors)).max(SCALE_OVER_MEDIAN * sigma);
        for (weight, (error, distance)) in weights.iter_mut().zip(&chords) {
            let root = 1.0 / (1.0 + (error / scale).powi(2));
            *weight = root * root / (distance * distance).max(f64::MIN_POSITIVE);
        }
        vectors = linear::<D>(sightings, course, &weights, equations)?;
        if (scale / before - 1.0).abs() < 0.02 {
            break;
        }
        before = scale;
    }
    Some(vectors)
}

/// `min sum w |(I - v v^T) (x - c)|^2`.
fn linear<const D: usize>(
    sightings: &Sightings,
    course: Course<'_>,
    weights: &[f64],
    equations: &mut Equations,
) -> Option<Vec<Lanes>> {
    let k = course.n_functions;
    equations.clear(D * k);
    let rays = sightings.rays.iter().zip(&sightings.centers);
    for (((ray, center), weight), values) in rays.zip(weights).zip(course.values.chunks_exact(k)) {
        if *weight > 0.0 {
            let weight = weight * ray.0[3];
            let across = center.plus_scaled(-ray.dot::<D>(center), ray).times(weight);
            equations.add::<D>(values, ray, weight, &across);
        }
    }
    let x = equations.solve(0.0)?;
    Some(vectors_of::<D>(x, k))
}

/// The vectors among the unknowns of a path.
pub(super) fn vectors_of<const D: usize>(x: &[f64], n_functions: usize) -> Vec<Lanes> {
    x.as_chunks::<D>().0[..n_functions].iter().map(Lanes::from_vector::<D>).collect()
}

/// Chord of an observation, times the root of its precision, and its distance.
fn chord<const D: usize>(sightings: &Sightings, course: Course<'_>, k: usize, vectors: &[Lanes]) -> (f64, f64) {
    let u = course.position(k, vectors).minus(&sightings.centers[k]);
    let distance = u.dot::<D>(&u).sqrt().max(f64::MIN_POSITIVE);
    let error = sightings.rays[k].plus_scaled(-1.0 / distance, &u);
    ((error.dot::<D>(&error) * sightings.rays[k].0[3]).sqrt(), distance)
}

fn kept<const D: usize>(sightings: &Sightings, course: Course<'_>, vectors: &[Lanes], limit: f64) -> Vec<bool> {
    (0..sightings.len()).map(|k| chord::<D>(sightings, course, k, vectors).0 < limit).collect()
}

/// Squared errors in units of sigma, none counted beyond the outlier limit.
fn truncated_cost<const D: usize>(sightings: &Sightings, course: Course<'_>, vectors: &[Lanes], sigma: f64) -> f64 {
    let squared = |k| (chord::<D>(sightings, course, k, vectors).0 / sigma).powi(2);
    (0..sightings.len()).map(|k| squared(k).min(OUTLIER_SIGMAS * OUTLIER_SIGMAS)).sum()
}

/// Gauss-Newton on the observations that are kept.
fn descend<const D: usize>(
    sightings: &Sightings,
    course: Course<'_>,
    sigma: f64,
    fit: &mut Fit,
    equations: &mut Equations,
) {
    let huber = HUBER_SIGMAS * sigma;
    let k = course.n_functions;
    let cost = |vectors: &[Lanes], keep: &[bool]| -> f64 {
        (0..sightings.len())
            .filter(|&k| keep[k])
            .map(|k| huber_cost(chord::<D>(sightings, course, k, vectors).0.powi(2), huber))
            .sum()
    };
    let mut present = cost(&fit.vectors, &fit.keep);
    let mut damping = 1e-12;
    for _ in 0..STEPS {
        equations.clear(D * k);
        for (o, values) in course.values.chunks_exact(k).enumerate().filter(|&(o, _)| fit.keep[o]) {
            let point = course.position(o, &fit.vectors);
            let model = chord_model::<D>(&sightings.rays[o], &point, &sightings.centers[o], true, huber);
            equations.add::<D>(values, &model.direction, model.direction.0[3], &model.gradient);
        }
        let Some(x) = equations.solve(damping) else { return };
        let moved: Vec<Lanes> = fit.vectors.iter().zip(vectors_of::<D>(x, k)).map(|(p, d)| p.plus(&d)).collect();
        let next = cost(&moved, &fit.keep);
        if next < present {
            fit.vectors = moved;
            let gain = present - next;
            present = next;
            damping *= 0.1;
            // without noise the steps go on to rounding
            let is_noisy = present > sigma * sigma;
            if gain < LITTLE_GAIN * sigma * sigma && (is_noisy || gain < 1e-6 * present) {
                return;
            }
        } else {
            damping = f64::max(damping, 1e-6) * 100.0;
            if damping > 1e6 {
                return;
            }
        }
    }
}
