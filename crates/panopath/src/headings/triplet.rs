//! Relative headings of three planar views from the tracks that they share.
//!
//! A point is seen at the angles `a_1, a_2, a_3` by views with centres `c_k` (complex) and headings `h_k`. Its three rays meet,
//! which is one equation (the trifocal constraint of a calibrated one-dimensional retina),
//!
//! ```text
//! f(a) = Re sum_k A_k e_k(a) = 0,     e_1 = exp i(-a_1 + a_2 + a_3),   e_2, e_3 likewise,
//! A_1 = conj(c_2 - c_3) exp i(-h_1 + h_2 + h_3),    A_2, A_3 in turn (1, 2, 3 in a cycle).
//! ```
//!
//! It is linear in six real numbers known up to scale: five points fix them. The three sides `conj(A_k) exp(-2 i h_k)` close to
//! a triangle, which leaves two solutions, mirror images of each other, and each heading up to half a turn; that
//! points lie in front of all three views tells them apart. (The count and the twofold ambiguity: Astrom and Oskarsson,
//! Solutions and ambiguities of the structure and motion problem for 1D retinal vision, 2000; uncalibrated: Quan and Kanade 1997.)
//! `f / |grad f|` is, to first order, the angle by which the three bearings miss each other.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::complex::{Complex, wrapped};
use crate::least_squares::symmetric_eigen;

/// Angles of one track in the three views.
pub(super) type Sighting = [f64; 3];

/// Headings of the second and third view, that of the first being zero.
#[derive(Debug, Clone, Copy)]
pub(super) struct Triplet {
    pub heading: [f64; 2],
    /// Covariance of the two.
    pub covariance: [[f64; 2]; 2],
    /// Standard deviation of a bearing, from the tracks that agree.
    pub noise_rad: f64,
}

const SIGNS: [[f64; 3]; 3] = [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]];
/// Tracks that fix the linear form.
const SAMPLE: usize = 5;
/// Bearings that miss each other by more standard deviations than this do not belong together.
const INLIER_SIGMAS: f64 = 3.0;
/// Agreement that chance brings about more often than this says nothing.
const MOST_FALSE_ALARMS: f64 = 0.1;
/// The share of tracks in front of all views must be larger than that of the mirror image by this much.
const FRONT_MARGIN: f64 = 0.15;

/// Mirror images whose headings differ by less are one answer to the descent.
const NEARLY_ALIKE: f64 = 0.15;
const DESCENT_STEPS: usize = 8;
/// No step of the descent turns a view or moves a centre (of a triplet of size one) further.
const LONGEST_STEP: f64 = 0.2;

/// The coefficients `A_k`.
type Tensor = [Complex; 3];

/// Finds the relative headings, or `None` where too few tracks agree or the mirror image explains them as well.
pub(super) fn solve_triplet(seen: &[Sighting], noise_rad: f64, rng: &mut ChaCha8Rng) -> Option<Triplet> {
    if seen.len() <= SAMPLE {
        return None;
    }
    let rows: Vec<[Complex; 3]> = seen.iter().map(exponentials).collect();
    let limit = INLIER_SIGMAS * noise_rad;
    let start = best_of_samples(&rows, limit, rng)?;
    let inliers =
        |tensor: &Tensor| -> Vec<usize> { (0..rows.len()).filter(|&p| miss(tensor, &rows[p]).abs() < limit).collect() };
    let kept = inliers(&start);
    // least squares over all that agree; where the sample was better (few tracks, all needed) keep it
    let tensor = linear(&rows, &kept, Some(&start)).filter(|t| inliers(t).len() >= kept.len()).unwrap_or(start);
    let mut pose = in_front(&tensor, seen, &inliers(&tensor))?;
    let mut kept = inliers(&pose.tensor());
    let mut covariance = None;
    for _ in 0..DESCENT_STEPS {
        let (next, found) = pose.improved(&rows, &kept, noise_rad)?;
        pose = next;
        kept = inliers(&pose.tensor());
        covariance = Some(found);
    }
    let agree = 2 * kept.len() > seen.len() && false_alarms(seen.len(), kept.len(), limit) < MOST_FALSE_ALARMS;
    let heading = [wrapped(pose.heading[0]), wrapped(pose.heading[1])];
    let missed: Vec<f64> = kept.iter().map(|&p| miss(&pose.tensor(), &rows[p]).abs()).collect();
    let found = Triplet { heading, covariance: covariance?, noise_rad: spread(missed) };
    agree.then_some(found)
}

/// Standard deviation from the median of absolute misses, five of which the fit could choose.
fn spread(mut missed: Vec<f64>) -> f64 {
    let n = missed.len();
    if n <= SAMPLE {
        return f64::NAN;
    }
    let median = *missed.select_nth_unstable_by(n / 2, f64::total_cmp).1;
    1.4826 * median * (n as f64 / (n - SAMPLE) as f64).sqrt()
}

/// How many sets of `k` of `n` tracks would agree by chance, each track within `limit` (Moisan and Stival 2004): what is left
/// of `n choose k` and `k choose 5` hypotheses when all but five must agree.
fn false_alarms(n: usize, k: usize, limit: f64) -> f64 {
    if k <= SAMPLE {
        return f64::INFINITY;
    }
    let log_choose = |n: usize, k: usize| (1..=k).map(|i| ((n - k + i) as f64 / i as f64).ln()).sum::<f64>();
    let log = ((n - SAMPLE) as f64).ln() + log_choose(n, k) + log_choose(k, SAMPLE) + (k - SAMPLE) as f64 * limit.ln();
    log.exp()
}

fn exponentials(a: &Sighting) -> [Complex; 3] {
    SIGNS.map(|s| Complex::cis(s[0] * a[0] + s[1] * a[1] + s[2] * a[2]))
}

/// `f / |grad f|`, an angle.
fn miss(tensor: &Tensor, row: &[Complex; 3]) -> f64 {
    let (f, slope) = value_and_slope(tensor, row);
    if slope > 0.0 { f / slope } else { f64::INFINITY }
}

fn value_and_slope(tensor: &Tensor, row: &[Complex; 3]) -> (f64, f64) {
    let terms: [Complex; 3] = std::array::from_fn(|k| tensor[k] * row[k]);
    let f = terms[0].re + terms[1].re + terms[2].re;
    let gradient = |view: usize| -> f64 { (0..3).map(|k| SIGNS[k][view] * terms[k].im).sum() };
    (f, gradient(0).hypot(gradient(1)).hypot(gradient(2)))
}

/// The form that most tracks agree with, of those through five tracks drawn at random; ties go to the smaller misses.
fn best_of_samples(rows: &[[Complex; 3]], limit: f64, rng: &mut ChaCha8Rng) -> Option<Tensor> {
    /// With 10 % false bearings a sample of five tracks in three views is clean one time in five.
    const SAMPLES: usize = 60;
    let mut best: Option<(f64, Tensor)> = None;
    for _ in 0..SAMPLES {
        let sample = distinct(rows.len(), rng);
        let Some(tensor) = linear(rows, &sample, None) else { continue };
        let cost: f64 = rows.iter().map(|row| (miss(&tensor, row) / limit).powi(2).min(1.0)).sum();
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, tensor));
        }
    }
    best.map(|(_, tensor)| tensor)
}

fn distinct(n: usize, rng: &mut ChaCha8Rng) -> [usize; SAMPLE] {
    let mut sample = [usize::MAX; SAMPLE];
    for k in 0..SAMPLE {
        loop {
            let drawn = rng.random_range(0..n);
            if !sample[..k].contains(&drawn) {
                sample[k] = drawn;
                break;
            }
        }
    }
    sample
}

/// The six numbers that make the sum of squares of `f` smallest, weighted by the slopes at a form known so far.
fn linear(rows: &[[Complex; 3]], chosen: &[usize], weigh_at: Option<&Tensor>) -> Option<Tensor> {
    let mut squares = [[0.0; 6]; 6];
    for &p in chosen {
        let row = &rows[p];
        let slope = weigh_at.map_or(1.0, |tensor| value_and_slope(tensor, row).1);
        if slope == 0.0 {
            continue;
        }
        let numbers: [f64; 6] = std::array::from_fn(|k| if k < 3 { row[k].re } else { -row[k - 3].im });
        for (line, a) in squares.iter_mut().zip(&numbers) {
            for (entry, b) in line.iter_mut().zip(&numbers) {
                *entry += a * b / (slope * slope);
            }
        }
    }
    let (values, vectors) = symmetric_eigen(&squares).ok()?;
    let fixed = values[1] > 1e-14 * values[5];
    fixed.then(|| std::array::from_fn(|k| Complex::new(vectors[0][k], vectors[0][k + 3])))
}

/// Three views, the first at the origin with heading zero.
#[derive(Clone, Copy)]
struct Pose {
    heading: [f64; 2],
    center: [Complex; 2],
}

/// The solution with most tracks in front, if it beats its mirror image or hardly differs from it.
fn in_front(tensor: &Tensor, seen: &[Sighting], kept: &[usize]) -> Option<Pose> {
    let [first, second] = decompose(tensor)?.map(|pose| pose.turned_to_the_front(seen, kept));
    let (best, other) = if first.1 >= second.1 { (first, second) } else { (second, first) };
    // views on one line are their own mirror image
    let apart = |k: usize| wrapped(best.0.heading[k] - other.0.heading[k]).abs();
    (best.1 > other.1 + FRONT_MARGIN || apart(0).max(apart(1)) < NEARLY_ALIKE).then_some(best.0)
}

/// The two triangles that the sides close to.
fn decompose(tensor: &Tensor) -> Option<[Pose; 2]> {
    let side = tensor.map(Complex::conj);
    let length = side.map(Complex::abs);
    if !(length[0] > 0.0 && length[1] > 0.0) {
        return None;
    }
    let cosine =
        (length[2] * length[2] - length[0] * length[0] - length[1] * length[1]) / (2.0 * length[0] * length[1]);
    let between = cosine.clamp(-1.0, 1.0).acos();
    Some([between, -between].map(|angle| {
        let one = side[0];
        let two = Complex::cis(side[0].arg() + angle).times(length[1]);
        let three = -(one + two);
        let heading = [0.5 * (side[1].arg() - two.arg()), 0.5 * (side[2].arg() - three.arg())];
        let turn = Complex::cis(heading[0] + heading[1]);
        // the sides are c_2 - c_3, c_3 - c_1, c_1 - c_2
        Pose { heading, center: [-(three * turn), two * turn] }.normalized()
    }))
}

impl Pose {
    fn normalized(mut self) -> Self {
        let size = self.center[0].abs().hypot(self.center[1].abs());
        if size > 0.0 {
            self.center = self.center.map(|c| c.times(1.0 / size));
        }
        self
    }

    /// Headings turned by half a turn where that brings the points in front; the share of tracks that end up there.
    fn turned_to_the_front(self, seen: &[Sighting], kept: &[usize]) -> (Self, f64) {
        // one count for each pattern of signs of the three depths
        let mut count = [0usize; 8];
        for &p in kept {
            let depth = self.depths(&seen[p]);
            let pattern = depth.iter().enumerate().map(|(k, d)| usize::from(*d < 0.0) << k).sum::<usize>();
            count[pattern] += 1;
        }
        let best = (0..8).fold(0, |best, k| if count[k] > count[best] { k } else { best });
        let behind = |k: usize| best >> k & 1 == 1;
        // what is behind the first view comes to the front by reversing the scale, for all three views
        let mut pose = self;
        if behind(0) {
            pose.center = pose.center.map(|c| -c);
        }
        for k in 0..2 {
            if behind(k + 1) != behind(0) {
                pose.heading[k] += std::f64::consts::PI;
            }
        }
        (pose, count[best] as f64 / kept.len().max(1) as f64)
    }

    /// Distances along the three rays to the place nearest to all three lines.
    fn depths(&self, a: &Sighting) -> [f64; 3] {
        let centers = [Complex::default(), self.center[0], self.center[1]];
        let angles = [a[0], a[1] + self.heading[0], a[2] + self.heading[1]];
        let (mut xx, mut xy, mut yy, mut x, mut y) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (c, angle) in centers.iter().zip(angles) {
            let (sin, cos) = angle.sin_cos();
            let offset = cos * c.im - sin * c.re;
            xx += sin * sin;
            xy -= sin * cos;
            yy += cos * cos;
            x -= sin * offset;
            y += cos * offset;
        }
        // only signs count: the (positive) determinant stays out of the division
        let determinant = xx * yy - xy * xy;
        let place = Complex::new(yy * x - xy * y, xx * y - xy * x);
        std::array::from_fn(|k| ((place - centers[k].times(determinant)) * Complex::cis(-angles[k])).re)
    }

    fn tensor(&self) -> Tensor {
        let ([c2, c3], turn) = (self.center, self.turns());
        [(c2 - c3).conj() * turn[0], c3.conj() * turn[1], -(c2.conj() * turn[2])]
    }

    /// `exp i(-h_1 + h_2 + h_3)` and so on.
    fn turns(&self) -> [Complex; 3] {
        let [h2, h3] = self.heading;
        [Complex::cis(h2 + h3), Complex::cis(h3 - h2), Complex::cis(h2 - h3)]
    }

    /// Derivatives of the tensor by the two headings and the coordinates of the two centres.
    fn tensor_slopes(&self) -> [Tensor; 6] {
        let (i, none) = (Complex::new(0.0, 1.0), Complex::default());
        let ([a1, a2, a3], [t1, t2, t3]) = (self.tensor(), self.turns());
        [
            [i * a1, -(i * a2), i * a3],
            [i * a1, i * a2, -(i * a3)],
            [t1, none, -t3],
            [-(i * t1), none, i * t3],
            [-t1, t2, none],
            [i * t1, -(i * t2), none],
        ]
    }

    /// One robust Gauss-Newton step over the tracks that agree, and the covariance of the headings before it.
    fn improved(self, rows: &[[Complex; 3]], kept: &[usize], noise_rad: f64) -> Option<(Self, [[f64; 2]; 2])> {
        let (tensor, slopes) = (self.tensor(), self.tensor_slopes());
        let (mut normal, mut right, mut squares, mut total) = ([[0.0; 6]; 6], [0.0; 6], 0.0, 0.0);
        for &p in kept {
            let (f, slope) = value_and_slope(&tensor, &rows[p]);
            if slope == 0.0 {
                continue;
            }
            let missed = f / slope;
            let weight = (1.0 + (missed / (2.0 * noise_rad)).powi(2)).powi(-2);
            let row: [f64; 6] = slopes.map(|by| (0..3).map(|k| (by[k] * rows[p][k]).re).sum::<f64>() / slope);
            for r in 0..6 {
                right[r] -= weight * row[r] * missed;
                for c in 0..6 {
                    normal[r][c] += weight * row[r] * row[c];
                }
            }
            squares += weight * missed * missed;
            total += weight;
        }
        let inverse = without_scale(normal, &self.center, total * noise_rad)?;
        // five numbers are fitted; with few tracks the noise said to be there is the better guess
        let variance = (squares + 5.0 * noise_rad * noise_rad) / total.max(1.0);
        let step: [f64; 6] = std::array::from_fn(|r| (0..6).map(|c| inverse[r][c] * right[c]).sum());
        let covariance = [0, 1].map(|r| [0, 1].map(|c| variance * inverse[r][c]));
        let shrink = (LONGEST_STEP / step.iter().fold(0.0, |a: f64, b| a.max(b.abs()))).min(1.0);
        let next = Self {
            heading: [self.heading[0] + shrink * step[0], self.heading[1] + shrink * step[1]],
            center: [
                self.center[0] + Complex::new(step[2], step[3]).times(shrink),
                self.center[1] + Complex::new(step[4], step[5]).times(shrink),
            ],
        };
        Some((next.normalized(), covariance))
    }
}

/// Inverse of the normal matrix with the scale of the centres held.
///
/// Where the views stand on one line a direction is seen in second order only: misses grow with the square of the way,
/// which noise then hides up to its root. `least` is the information that corresponds to this.
fn without_scale(mut normal: [[f64; 6]; 6], center: &[Complex; 2], least: f64) -> Option<[[f64; 6]; 6]> {
    let scale = [0.0, 0.0, center[0].re, center[0].im, center[1].re, center[1].im];
    let stiff: f64 = (0..6).map(|k| normal[k][k]).sum();
    for r in 0..6 {
        for c in 0..6 {
            normal[r][c] += stiff * scale[r] * scale[c];
        }
    }
    let (values, vectors) = symmetric_eigen(&normal).ok()?;
    let floor = least.max(1e-12 * values[5]);
    if floor.is_nan() || floor <= 0.0 {
        return None;
    }
    Some(std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..6).map(|k| vectors[k][r] * vectors[k][c] / values[k].max(floor)).sum())
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: Pose =
        Pose { heading: [0.7, -2.1], center: [Complex { re: 0.3, im: -0.5 }, Complex { re: -0.6, im: 0.55 }] };
    const SEEN: Sighting = [0.4, -1.3, 2.2];
    const STEP: f64 = 1e-6;

    #[test]
    fn tensor_slopes_are_central_differences() {
        for (k, slopes) in POSE.tensor_slopes().iter().enumerate() {
            let moved = |by: f64| {
                let mut pose = POSE;
                match k {
                    0 | 1 => pose.heading[k] += by,
                    2 | 4 => pose.center[k / 2 - 1].re += by,
                    _ => pose.center[k / 2 - 1].im += by,
                }
                pose.tensor()
            };
            for (slope, (after, before)) in slopes.iter().zip(moved(STEP).iter().zip(moved(-STEP))) {
                let difference = (*after - before).times(0.5 / STEP);
                assert!((*slope - difference).abs() < 1e-9, "parameter {k}");
            }
        }
    }

    #[test]
    fn the_slope_is_the_gradient_by_the_three_angles() {
        let tensor = POSE.tensor();
        let value = |a: &Sighting| value_and_slope(&tensor, &exponentials(a)).0;
        let mut squares = 0.0;
        for view in 0..3 {
            let moved = |by: f64| {
                let mut a = SEEN;
                a[view] += by;
                value(&a)
            };
            squares += (0.5 * (moved(STEP) - moved(-STEP)) / STEP).powi(2);
        }
        assert!((squares.sqrt() - value_and_slope(&tensor, &exponentials(&SEEN)).1).abs() < 1e-9);
    }

    #[test]
    fn a_decomposed_tensor_is_the_tensor() {
        let tensor = POSE.tensor();
        for pose in decompose(&tensor).into_iter().flatten() {
            let again = pose.tensor();
            let factor = again[0].over(tensor[0]);
            assert!(factor.im.abs() < 1e-12, "the two agree up to a real factor");
            assert!((0..3).all(|k| (tensor[k].times(factor.re) - again[k]).abs() < 1e-12));
        }
    }
}
