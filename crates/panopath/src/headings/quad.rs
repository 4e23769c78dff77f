//! Headings of many planar views from four tracks that all of them see: the dual of a triplet.
//!
//! With the first point at the origin, a view at `1 / y` sees the others under the angles `t_k = a_k - a_1` to it, and
//! `Im[(1 - P_k y) exp(-i t_k)] = 0` (inversion makes the circles of equal angle straight lines). That the three lines of
//! `k = 2, 3, 4` meet is one equation for each view,
//!
//! ```text
//! Re sum_k B_k e_k(t) = 0,    B_2 = P_2 conj(P_4 - P_3),   B_3, B_4 in turn,    Re(B_2 + B_3 + B_4) = 0,
//! ```
//!
//! with the exponentials `e_k` of a triplet: linear in five real numbers up to scale, so four views fix them. The shape of the four
//! points follows from a quadratic equation, up to two solutions; that the points lie in front of the views tells
//! them apart. The exchange of points and views is that of Carlsson and Weinshall, Dual computation of projective shape and camera
//! positions from multiple images (1998). Shape and views are then refined together, the views eliminated.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::complex::{Complex, wrapped};
use super::resect::{Resection, linear_resection};
use crate::least_squares::symmetric_eigen;

/// The four angles that a view measured.
pub(super) type FourAngles = [f64; 4];

/// Heading of a view in the frame of the quad.
#[derive(Debug, Clone, Copy)]
pub(super) struct QuadView {
    /// Which of the views handed in.
    pub index: usize,
    pub heading: f64,
    pub sigma: f64,
}

type Shape = [Complex; 4];

const SIGNS: [[f64; 3]; 3] = [[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]];
/// Views that fix the linear form.
const SAMPLE: usize = 4;
const INLIER_SIGMAS: f64 = 3.0;
/// Share of views by which a solution must beat its rival.
const FRONT_MARGIN: f64 = 0.15;

/// Finds the headings of the views that agree on a shape of the four points; empty where they fix none.
pub(super) fn solve_quad(seen: &[FourAngles], noise_rad: f64, rng: &mut ChaCha8Rng) -> Vec<QuadView> {
    const SAMPLES: usize = 40;
    if seen.len() <= SAMPLE + 1 {
        return Vec::new();
    }
    let rows: Vec<[f64; 5]> = seen.iter().map(row).collect();
    let mut candidates: Vec<Shape> = linear(&rows, &(0..rows.len()).collect::<Vec<_>>());
    for _ in 0..SAMPLES {
        let sample: Vec<usize> = (0..SAMPLE).map(|_| rng.random_range(0..rows.len())).collect();
        candidates.extend(linear(&rows, &sample));
    }
    // judged on some of the views where there are many
    let judges: Vec<FourAngles> = seen.iter().step_by(seen.len().div_ceil(60)).copied().collect();
    let mut best: Vec<(f64, Fitted)> = candidates
        .into_iter()
        .map(|shape| Fitted::new(shape, &judges))
        .map(|fitted| (fitted.cost(noise_rad), fitted))
        .collect();
    best.sort_by(|a, b| a.0.total_cmp(&b.0));
    best.truncate(4);
    let mut refined: Vec<(f64, Fitted)> = best
        .into_iter()
        .map(|(_, fitted)| Fitted::new(fitted.shape, seen).refined(seen, noise_rad))
        .map(|fitted| (fitted.cost(noise_rad), fitted))
        .collect();
    refined.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some((cost, fitted)) = refined.first() else { return Vec::new() };
    let rival = refined.iter().find(|(_, other)| other.differs_from(fitted));
    if rival.is_some_and(|(other, _)| *other < cost + FRONT_MARGIN * seen.len() as f64) {
        return Vec::new();
    }
    fitted.views(seen, noise_rad)
}

/// One row of the linear system in `(re B_2, re B_3, im B_2, im B_3, im B_4)`.
fn row(a: &FourAngles) -> [f64; 5] {
    let t = [a[1] - a[0], a[2] - a[0], a[3] - a[0]];
    let e = SIGNS.map(|s| Complex::cis(s[0] * t[0] + s[1] * t[1] + s[2] * t[2]));
    [e[0].re - e[2].re, e[1].re - e[2].re, -e[0].im, -e[1].im, -e[2].im]
}

/// Shapes through the chosen views.
fn linear(rows: &[[f64; 5]], chosen: &[usize]) -> Vec<Shape> {
    let mut squares = [[0.0; 5]; 5];
    for &v in chosen {
        for r in 0..5 {
            for c in 0..5 {
                squares[r][c] += rows[v][r] * rows[v][c];
            }
        }
    }
    match symmetric_eigen(&squares) {
        Ok((values, vectors)) if values[1] > 1e-14 * values[4] => {
            let [r2, r3, i2, i3, i4] = vectors[0];
            shapes(Complex::new(r2, i2), Complex::new(r3, i3), Complex::new(-r2 - r3, i4))
        }
        _ => Vec::new(),
    }
}

/// The two shapes `0, 1, x, y` with `conj(y - x)`, `x conj(1 - y)`, `y conj(x - 1)` a real multiple of the coefficients.
fn shapes(b2: Complex, b3: Complex, b4: Complex) -> Vec<Shape> {
    // the sum of the three gives Im(b2 x) = k; x = (t + i k) / b2 in the second leaves a quadratic equation for t
    let k = 0.5 * (b2.im - b3.im - b4.im);
    let (r, m, p, q) = (b2.re, b2.im, b3.re, b3.im + k);
    let (a, b, c) = (q - m, k * r - m * p - q * r, k * r * p - q * k * m + q * k * k);
    let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
    let shape = |t: f64| -> Option<Shape> {
        let x = Complex::new(t, k).over(b2);
        let scale = (x * (Complex::new(1.0, 0.0) - x.conj())).over(b3 + Complex::new(t, k)).re;
        let y = x + b2.conj().times(scale);
        let usable = [x.re, x.im, y.re, y.im].iter().all(|v| v.is_finite() && v.abs() < 1e6);
        usable.then_some([Complex::default(), Complex::new(1.0, 0.0), x, y])
    };
    [root, -root].into_iter().filter_map(|root| shape((-b + root) / (2.0 * a))).collect()
}

/// A shape and the views resected onto it, `None` where a view cannot be.
struct Fitted {
    shape: Shape,
    views: Vec<Option<Resection>>,
    /// Largest miss of each view, over its four angles.
    miss: Vec<f64>,
}

impl Fitted {
    fn new(shape: Shape, seen: &[FourAngles]) -> Self {
        let views: Vec<Option<Resection>> = seen
            .iter()
            .map(|angles| linear_resection(&std::array::from_fn::<_, 4, _>(|k| (shape[k], angles[k]))))
            .collect();
        let mut fitted = Self { shape, views, miss: Vec::new() };
        fitted.judge(seen);
        fitted
    }

    fn judge(&mut self, seen: &[FourAngles]) {
        let miss = |(view, angles): (&Option<Resection>, &FourAngles)| {
            let worst =
                |view: &Resection| (0..4).map(|k| view.miss(&(self.shape[k], angles[k])).abs()).fold(0.0, f64::max);
            view.as_ref().map_or(f64::INFINITY, worst)
        };
        self.miss = self.views.iter().zip(seen).map(miss).collect();
    }

    /// Truncated sum of squares.
    fn cost(&self, noise_rad: f64) -> f64 {
        self.miss.iter().map(|miss| (miss / (INLIER_SIGMAS * noise_rad)).powi(2).min(1.0)).sum()
    }

    /// Do the headings mean something else?
    fn differs_from(&self, other: &Self) -> bool {
        const ALIKE: f64 = 0.1;
        let turns: Vec<f64> = self
            .views
            .iter()
            .zip(&other.views)
            .filter_map(|(a, b)| Some(wrapped(a.as_ref()?.heading - b.as_ref()?.heading)))
            .collect();
        let mean = turns.iter().fold(Complex::default(), |sum, turn| sum + Complex::cis(*turn));
        turns.iter().filter(|turn| wrapped(*turn - mean.arg()).abs() > ALIKE).count() * 4 > turns.len()
    }

    /// Gauss-Newton over the third and fourth point, with each view at its own optimum to first order.
    fn refined(mut self, seen: &[FourAngles], noise_rad: f64) -> Self {
        const STEPS: usize = 12;
        for _ in 0..STEPS {
            let Some((normal, right)) = self.reduced(seen, noise_rad, |_, _| ()) else { break };
            let Ok((values, vectors)) = symmetric_eigen(&normal) else { break };
            let mut step = [0.0; 4];
            for (value, vector) in values.iter().zip(&vectors) {
                let along: f64 = (0..4).map(|k| vector[k] * right[k]).sum();
                let damped = value + 1e-6 * values[3];
                (0..4).for_each(|k| step[k] += along / damped * vector[k]);
            }
            let longest = step.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
            let shrink = (0.3 / longest).min(1.0);
            self.shape[2] = self.shape[2] + Complex::new(step[0], step[1]).times(shrink);
            self.shape[3] = self.shape[3] + Complex::new(step[2], step[3]).times(shrink);
            for (view, angles) in self.views.iter_mut().zip(seen) {
                let sights: [_; 4] = std::array::from_fn(|k| (self.shape[k], angles[k]));
                *view = view.or_else(|| linear_resection(&sights)).map(|v| v.descended(&sights, noise_rad, 3));
            }
            self.judge(seen);
        }
        self
    }

    /// Normal equations of the shape, views eliminated; `each` is told a view's heading variance of its own and how its
    /// heading moves with the shape.
    fn reduced(
        &self,
        seen: &[FourAngles],
        noise_rad: f64,
        mut each: impl FnMut(usize, (f64, [f64; 4])),
    ) -> Option<([[f64; 4]; 4], [f64; 4])> {
        let (mut normal, mut right, mut used) = ([[0.0; 4]; 4], [0.0; 4], 0);
        for (index, (view, angles)) in self.views.iter().zip(seen).enumerate() {
            let Some(view) = view.filter(|_| self.miss[index] < 2.0 * INLIER_SIGMAS * noise_rad) else { continue };
            let weight = (1.0 + (self.miss[index] / (INLIER_SIGMAS * noise_rad)).powi(2)).powi(-2);
            let (mut own, mut mixed, mut shape) = ([[0.0; 3]; 3], [[0.0; 4]; 3], [[0.0; 4]; 4]);
            let (mut own_right, mut shape_right) = ([0.0; 3], [0.0; 4]);
            for k in 0..4 {
                let sight = (self.shape[k], angles[k]);
                let Some(by_view) = view.slopes(&sight) else { continue };
                let mut by_shape = [0.0; 4];
                if k >= 2 {
                    // moving the point is moving the view the other way
                    by_shape[2 * k - 4] = -by_view[0];
                    by_shape[2 * k - 3] = -by_view[1];
                }
                let miss = view.miss(&sight);
                for r in 0..3 {
                    own_right[r] -= by_view[r] * miss;
                    (0..3).for_each(|c| own[r][c] += by_view[r] * by_view[c]);
                    (0..4).for_each(|c| mixed[r][c] += by_view[r] * by_shape[c]);
                }
                for r in 0..4 {
                    shape_right[r] -= by_shape[r] * miss;
                    (0..4).for_each(|c| shape[r][c] += by_shape[r] * by_shape[c]);
                }
            }
            let Some(inverse) = inverse3(&own) else { continue };
            // how the view follows the shape
            let follow: [[f64; 4]; 3] = std::array::from_fn(|r| {
                std::array::from_fn(|c| -(0..3).map(|k| inverse[r][k] * mixed[k][c]).sum::<f64>())
            });
            for r in 0..4 {
                right[r] += weight * (shape_right[r] + (0..3).map(|k| follow[k][r] * own_right[k]).sum::<f64>());
                for c in 0..4 {
                    normal[r][c] += weight * (shape[r][c] + (0..3).map(|k| mixed[k][r] * follow[k][c]).sum::<f64>());
                }
            }
            used += 1;
            each(index, (inverse[2][2], follow[2]));
        }
        (used > SAMPLE).then_some((normal, right))
    }

    /// Headings of the views that agree, with what noise and the uncertain shape do to them.
    fn views(&self, seen: &[FourAngles], noise_rad: f64) -> Vec<QuadView> {
        /// A view may be off by its own noise; a majority must not.
        const LEAST_SHARE: f64 = 0.6;
        let mut parts = Vec::new();
        let Some((normal, _)) = self.reduced(seen, noise_rad, |index, part| parts.push((index, part))) else {
            return Vec::new();
        };
        let Ok((values, vectors)) = symmetric_eigen(&normal) else { return Vec::new() };
        parts.retain(|(index, _)| self.miss[*index] < INLIER_SIGMAS * noise_rad);
        if parts.len() <= SAMPLE + 1 || (parts.len() as f64) < LEAST_SHARE * seen.len() as f64 {
            return Vec::new();
        }
        // a turn of all views alike is no error
        let share = 1.0 / parts.len() as f64;
        let mean: [f64; 4] = std::array::from_fn(|c| parts.iter().map(|(_, (_, follow))| share * follow[c]).sum());
        let variance = |own: f64, follow: &[f64; 4]| {
            let along = |vector: &[f64; 4]| (0..4).map(|c| vector[c] * (follow[c] - mean[c])).sum::<f64>();
            let shape = values.iter().zip(&vectors).map(|(value, v)| along(v).powi(2) / value.max(1e-12 * values[3]));
            noise_rad * noise_rad * (own + shape.sum::<f64>())
        };
        let view = |(index, (own, follow)): &(usize, (f64, [f64; 4]))| {
            let heading = self.views[*index].as_ref()?.heading;
            Some(QuadView { index: *index, heading, sigma: variance(*own, follow).sqrt() })
        };
        parts.iter().filter_map(view).collect()
    }
}

fn inverse3(matrix: &[[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let (values, vectors) = symmetric_eigen(matrix).ok()?;
    (values[0] > 1e-12 * values[2]).then(|| {
        std::array::from_fn(|r| {
            std::array::from_fn(|c| (0..3).map(|k| vectors[k][r] * vectors[k][c] / values[k]).sum())
        })
    })
}
