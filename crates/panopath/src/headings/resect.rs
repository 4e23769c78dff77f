//! Heading and place of a view from points that are known: resection.
//!
//! A view at `c` (complex) with heading `h` sees the point `z` at the angle `a`, so `(z - c) exp(-i (a + h))` is real and positive. With
//! `q = exp(-i h)` and `p = c q` that is `Im[(z q - p) exp(-i a)] = 0`, linear in four real numbers up to scale: three
//! points fix them, the sign follows from the points being in front.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::complex::{Complex, wrapped};
use crate::least_squares::symmetric_eigen;

/// A known point and the angle at which it is seen.
pub(super) type Sight = (Complex, f64);

/// A view that was found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Resection {
    pub heading: f64,
    center: Complex,
}

/// Finds the view that most sights agree with, or `None` where fewer than `least` or no majority do.
pub(super) fn resect(sights: &[Sight], noise_rad: f64, least: usize, rng: &mut ChaCha8Rng) -> Option<Resection> {
    const SAMPLES: usize = 40;
    /// Points also move, so the limit is wider than that of a bearing alone.
    const LIMIT_SIGMAS: f64 = 4.0;
    let n = sights.len();
    if n < least.max(3) {
        return None;
    }
    let limit = LIMIT_SIGMAS * noise_rad;
    let mut best: Option<(f64, Resection)> = None;
    for round in 0..if n == 3 { 1 } else { SAMPLES } {
        let sample = if n == 3 { [0, 1, 2] } else { distinct(n, rng) };
        let Some(view) = linear_resection(&sample.map(|k| sights[k])) else { continue };
        let view = view.descended(sights, noise_rad, if round == 0 { 10 } else { 0 });
        let cost: f64 = sights.iter().map(|sight| (view.miss(sight) / limit).powi(2).min(1.0)).sum();
        if best.as_ref().is_none_or(|(lowest, _)| cost < *lowest) {
            best = Some((cost, view));
        }
    }
    let view = best?.1.descended(sights, noise_rad, 10);
    let n_inliers = sights.iter().filter(|sight| view.miss(sight).abs() < limit).count();
    let agree = n_inliers >= least.max(3) && 2 * n_inliers > n;
    agree.then(|| Resection { heading: wrapped(view.heading), ..view })
}

fn distinct(n: usize, rng: &mut ChaCha8Rng) -> [usize; 3] {
    let a = rng.random_range(0..n);
    let b = (a + rng.random_range(1..n)) % n;
    loop {
        let c = rng.random_range(0..n);
        if c != a && c != b {
            return [a, b, c];
        }
    }
}

/// The view that makes the sum of the squared equations smallest.
pub(super) fn linear_resection(sights: &[Sight]) -> Option<Resection> {
    // coordinates about the points and of their size, so that the four numbers are alike
    let share = 1.0 / sights.len() as f64;
    let middle = sights.iter().fold(Complex::default(), |sum, (z, _)| sum + z.times(share));
    let size = sights.iter().map(|(z, _)| (*z - middle).abs()).fold(0.0, f64::max);
    let mut squares = [[0.0; 4]; 4];
    for (z, angle) in sights {
        let (turn, z) = (Complex::cis(-angle), (*z - middle).times(1.0 / size));
        let row = [(z * turn).im, (z * turn).re, -turn.im, -turn.re];
        for r in 0..4 {
            for c in 0..4 {
                squares[r][c] += row[r] * row[c];
            }
        }
    }
    let (values, vectors) = symmetric_eigen(&squares).ok()?;
    let [qr, qi, pr, pi] = vectors[0];
    let q = Complex::new(qr, qi);
    if values[1] <= 1e-12 * values[3] || q.abs() < 1e-9 {
        return None;
    }
    let center = Complex::new(pr, pi).over(q).times(size) + middle;
    let mut view = Resection { heading: -q.arg(), center };
    let in_front = sights.iter().filter(|sight| view.miss(sight).abs() < std::f64::consts::FRAC_PI_2).count();
    if 2 * in_front < sights.len() {
        view.heading += std::f64::consts::PI;
    }
    Some(view)
}

impl Resection {
    /// Seen angle less predicted angle.
    pub fn miss(&self, (z, angle): &Sight) -> f64 {
        wrapped(angle + self.heading - (*z - self.center).arg())
    }

    /// Derivatives of the miss by the two coordinates of the centre and by the heading.
    pub fn slopes(&self, (z, _): &Sight) -> Option<[f64; 3]> {
        let away = *z - self.center;
        let squared = away.re * away.re + away.im * away.im;
        (squared > 0.0).then(|| [-away.im / squared, away.re / squared, 1.0])
    }

    /// Robust Gauss-Newton over place and heading.
    pub fn descended(mut self, sights: &[Sight], noise_rad: f64, steps: usize) -> Self {
        for _ in 0..steps {
            let (mut normal, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
            for sight in sights {
                let (miss, Some(row)) = (self.miss(sight), self.slopes(sight)) else { continue };
                let weight = (1.0 + (miss / (3.0 * noise_rad)).powi(2)).powi(-2);
                for r in 0..3 {
                    right[r] -= weight * row[r] * miss;
                    for c in 0..3 {
                        normal[r][c] += weight * row[r] * row[c];
                    }
                }
            }
            let Ok((values, vectors)) = symmetric_eigen(&normal) else { break };
            let mut step = [0.0; 3];
            for (value, vector) in values.iter().zip(&vectors) {
                let along: f64 = vector.iter().zip(&right).map(|(a, b)| a * b).sum();
                if *value > 1e-12 * values[2] {
                    step.iter_mut().zip(vector).for_each(|(s, v)| *s += along / value * v);
                }
            }
            self.center = self.center + Complex::new(step[0], step[1]);
            self.heading += step[2];
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_central_differences() {
        const STEP: f64 = 1e-6;
        let view = Resection { heading: 2.5, center: Complex::new(0.4, -1.1) };
        let sight = (Complex::new(-1.5, 0.8), 0.6);
        let slopes = view.slopes(&sight);
        for k in 0..3 {
            let moved = |by: f64| {
                let mut view = view;
                match k {
                    0 => view.center.re += by,
                    1 => view.center.im += by,
                    _ => view.heading += by,
                }
                view.miss(&sight)
            };
            let difference = 0.5 * (moved(STEP) - moved(-STEP)) / STEP;
            assert!(slopes.is_some_and(|slopes| (slopes[k] - difference).abs() < 1e-9), "parameter {k}");
        }
    }
}
