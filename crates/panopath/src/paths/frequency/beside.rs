//! Frequencies of bodies that are seen beside a point at rest, by cameras of which nothing is known.
//!
//! The camera lies on the plane of both directions, `s` to the point at rest and `v` to the body, so `m . P = 0`, `m = s x v`,
//! for the path `P` about that point: linear in the vectors of the path. A bearing that is off by `e` across that plane moves
//! `m . P` by `e |P x s|` or `e |P x v|`, so errors are told in radians by `m . P / sqrt(|P x s|^2 + |P x v|^2)`.
//!
//! `P` times any number that changes in time passes the same test. So few harmonics say more than many: an ellipse with the
//! Sun in a focus is met, in direction, by a circle with the Sun beside its centre, to the square of the eccentricity, while
//! with harmonics to spare nearly every frequency has some path. Orders are tried from the lowest on. And the camera and the
//! body must be in front of each other: `P + r s = d v` with `r, d > 0`, which wrong frequencies meet half of the time.

use rayon::prelude::*;

use super::{Grid, golden};
use crate::bundle::noise::median;
use crate::bundle::part::Lanes;
use crate::geometry::{Vector, cross, dot};
use crate::paths::Input;

/// Error of a direction that every path is reckoned with, radians: a path that goes with the camera fits, but says nothing.
const ERROR_RAD: f64 = 3e-4;
/// Rounds of weighing, and power iterations in each.
const ROUNDS: usize = 3;
const ITERATIONS: usize = 8;
/// Scale of Geman and McClure's weights over the median error.
const SCALE_OVER_MEDIAN: f64 = 3.0;
/// Share of the views for which body and point must be in front, where a frequency is believed.
const IN_FRONT: f64 = 0.9;
/// A path of more harmonics is believed where its errors are smaller by this factor.
const BETTER: f64 = 5.0;
/// Frequencies of the lowest order whose fractions the higher orders try.
const TRIED: usize = 8;
/// Divisions of a golden section, where one is chosen and for the one that is.
const DIVISIONS: usize = 16;
const FINE_DIVISIONS: usize = 40;

/// A body beside a point at rest.
pub(super) struct Beside {
    pub time_s: Vec<f64>,
    /// Directions to the point at rest and to the body, and their product.
    sights: Vec<[Vector<3>; 3]>,
}

/// What a frequency comes to.
#[derive(Debug, Clone, Copy)]
struct Told {
    /// Median error, radians.
    error: f64,
    /// Share of the views that agree for which body and point are in front.
    in_front: f64,
}

impl Told {
    /// Errors, raised where half of everything is behind the camera.
    fn score(&self) -> f64 {
        self.error / (2.0 * self.in_front - 1.0).max(0.02)
    }

    fn is_believed(&self) -> bool {
        self.in_front >= IN_FRONT
    }
}

impl Beside {
    pub fn new<const D: usize>(input: &Input<'_, D>, anchor: usize, track: usize) -> Self {
        let mut own = Self { time_s: Vec::new(), sights: Vec::new() };
        let view = |o: u32| input.tracks.view()[o as usize];
        let space = |o: u32| Lanes::from_vector::<D>(&input.world_direction(o)).vector::<3>();
        for &o in input.observations(track) {
            let Ok(place) = input.observations(anchor).binary_search_by_key(&view(o), |&a| view(a)) else { continue };
            own.push(input.time_s[view(o) as usize], space(input.observations(anchor)[place]), space(o));
        }
        own
    }

    fn push(&mut self, time_s: f64, s: Vector<3>, v: Vector<3>) {
        self.time_s.push(time_s);
        self.sights.push([s, v, cross(&s, &v)]);
    }

    /// Are there more views than a path of an order has unknowns?
    pub fn suffices(&self, order: usize) -> bool {
        self.time_s.len() > unknowns(order)
    }

    /// The path of a frequency by re-weighted least squares, and what it comes to.
    fn told(&self, omega: f64, order: usize) -> Told {
        let n = unknowns(order);
        let turns = self.turns(omega, 2 * order);
        let mut weights = vec![1.0; self.time_s.len()];
        let mut x: Vec<f64> = (0..n).map(|k| ((k + 1) as f64 * 0.618_033_988_749_894_9).fract() - 0.5).collect();
        let mut told = Told { error: f64::INFINITY, in_front: 0.0 };
        for _ in 0..ROUNDS {
            if !self.softest(&self.sums(&turns, &weights, 2 * order), order, &mut x) {
                return told;
            }
            told = self.weigh(&turns, 2 * order, &x, &mut weights);
        }
        told
    }

    /// Cosine and sine of the multiples of a frequency up to `highest`, one row for each view.
    fn turns(&self, omega: f64, highest: usize) -> Vec<[f64; 2]> {
        let origin = self.time_s[self.time_s.len() / 2];
        let mut turns = Vec::with_capacity(self.time_s.len() * (highest + 1));
        for time in &self.time_s {
            let (sin, cos) = (omega * (time - origin)).sin_cos();
            let (mut c, mut s) = (1.0, 0.0);
            for _ in 0..=highest {
                turns.push([c, s]);
                (c, s) = (c * cos - s * sin, s * cos + c * sin);
            }
        }
        turns
    }

    /// Weighted sums of `m m^T`, of `I - s s^T` (six numbers each, lower triangles by rows) and of ones, times cosine and sine.
    fn sums(&self, turns: &[[f64; 2]], weights: &[f64], highest: usize) -> Vec<[[f64; 13]; 2]> {
        let mut sums = vec![[[0.0; 13]; 2]; highest + 1];
        for ((turns, [s, _, m]), weight) in turns.chunks_exact(highest + 1).zip(&self.sights).zip(weights) {
            let mut form = [*weight; 13];
            for (k, (r, c)) in [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)].into_iter().enumerate() {
                form[k] *= m[r] * m[c];
                form[6 + k] *= f64::from(r == c) - s[r] * s[c];
            }
            for ([even, odd], [cos, sin]) in sums.iter_mut().zip(turns) {
                for k in 0..13 {
                    even[k] += cos * form[k];
                    odd[k] += sin * form[k];
                }
            }
        }
        sums
    }

    /// Least `sum w ((m . P)^2 + e^2 |P|^2)` over `sum w |(I - s s^T) P|^2`, by power iterations from `x` on.
    fn softest(&self, sums: &[[[f64; 13]; 2]], order: usize, x: &mut Vec<f64>) -> bool {
        const PLACE: [[usize; 3]; 3] = [[0, 1, 3], [1, 2, 4], [3, 4, 5]];
        let n = unknowns(order);
        let (mut off, mut across) = (vec![0.0; n * n], vec![0.0; n * n]);
        for a in 0..n / 3 {
            for b in 0..n / 3 {
                let product = product(sums, a, b);
                for r in 0..3 {
                    for c in 0..3 {
                        let at = (3 * a + r) * n + 3 * b + c;
                        let ridge = if r == c { ERROR_RAD * ERROR_RAD * product[12] } else { 0.0 };
                        off[at] = product[PLACE[r][c]] + ridge;
                        across[at] = product[6 + PLACE[r][c]];
                    }
                }
            }
        }
        if !factorise(&mut off, n) {
            return false;
        }
        for _ in 0..ITERATIONS {
            let y: Vec<f64> =
                (0..n).map(|r| across[r * n..(r + 1) * n].iter().zip(x.iter()).map(|(a, v)| a * v).sum()).collect();
            *x = y;
            forward(&off, n, x);
            backward(&off, n, x);
            let length = x.iter().map(|v| v * v).sum::<f64>().sqrt();
            if !(length > 0.0 && length.is_finite()) {
                return false;
            }
            x.iter_mut().for_each(|v| *v /= length);
        }
        true
    }

    /// What a path comes to, and the weights of its errors.
    fn weigh(&self, turns: &[[f64; 2]], highest: usize, x: &[f64], weights: &mut [f64]) -> Told {
        let mut errors = Vec::with_capacity(weights.len());
        let mut sides = Vec::with_capacity(weights.len());
        for ((turns, [s, v, m]), weight) in turns.chunks_exact(highest + 1).zip(&self.sights).zip(weights.iter_mut()) {
            let mut path = [x[0], x[1], x[2]];
            for (p, [cos, sin]) in x[3..].chunks_exact(6).zip(&turns[1..]) {
                (0..3).for_each(|c| path[c] += cos * p[c] + sin * p[3 + c]);
            }
            let (by_s, by_v) = (cross(s, &path), cross(&path, v));
            let size = dot(&by_s, &by_s) + dot(&by_v, &by_v);
            *weight = 1.0 / size.max(f64::MIN_POSITIVE);
            errors.push((dot(m, &path).powi(2) * *weight).sqrt());
            // s x P = d m, P x v = -r m
            sides.push([dot(&by_s, m) > 0.0, dot(&by_v, m) < 0.0]);
        }
        let error = median(&mut errors.clone()).max(f64::MIN_POSITIVE);
        let (mut agree, mut in_front) = (0usize, [0usize; 2]);
        for ((weight, e), sides) in weights.iter_mut().zip(&errors).zip(sides) {
            let off = e / (SCALE_OVER_MEDIAN * error);
            *weight /= (1.0 + off * off).powi(2);
            if off < 1.0 {
                agree += 1;
                (0..2).for_each(|k| in_front[k] += usize::from(sides[k]));
            }
        }
        // the sign of a path is free, but the same for both
        let share = (in_front[0] + in_front[1]) as f64 / (2 * agree).max(1) as f64;
        Told { error, in_front: share.max(1.0 - share) }
    }
}

/// The frequency that some bodies have in common, each with the harmonics that it may have; `None` where none is believed.
pub(super) fn frequency_of(group: &[(&Beside, usize)]) -> Option<f64> {
    let times: Vec<f64> = group.iter().flat_map(|(beside, _)| beside.time_s.iter().copied()).collect();
    let highest = group.iter().map(|(_, order)| *order).max()?;
    let told = |omega: f64, order: usize| {
        let each = group.iter().map(|(beside, own)| beside.told(omega, order.min(*own)));
        each.fold((0.0, true), |(sum, all), told| (sum + told.score(), all && told.is_believed()))
    };
    let grid = Grid::over(times, 2)?;
    let low = grid.lowest(&|omega| told(omega, 1).0);
    let refined = |omega: f64, order: usize| {
        let reach = grid.step / order as f64;
        golden(omega - reach, omega + reach, DIVISIONS, &|w| told(w, order).0)
    };
    let mut best: Option<(f64, f64, usize)> = None;
    for order in 1..=highest {
        // with as many harmonics the one that was best may do as well
        if let Some((least, omega, _)) = &mut best {
            *least = least.min(refined(*omega, order).0);
        }
        let fractions = low.iter().take(if order == 1 { low.len() } else { TRIED });
        let tried = fractions.flat_map(|w| (1..=order).map(move |part| w / part as f64));
        let tried: Vec<f64> = tried.filter(|omega| *omega >= grid.first).collect();
        let found: Vec<(f64, f64)> = tried.into_par_iter().map(|omega| refined(omega, order)).collect();
        let believed = found.into_iter().filter(|(_, omega)| told(*omega, order).1);
        let Some((score, omega)) = believed.min_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
        if best.is_none_or(|(least, _, _)| BETTER * score < least) {
            best = Some((score, omega, order));
        }
    }
    let (_, omega, order) = best?;
    let reach = grid.step / order as f64 / 8.0;
    Some(golden(omega - reach, omega + reach, FINE_DIVISIONS, &|w| told(w, order).0).1)
}

fn unknowns(order: usize) -> usize {
    3 * (2 * order + 1)
}

/// Weighted sums of the product of two functions: `2 cos a cos b = cos(a - b) + cos(a + b)`, and so on.
fn product(sums: &[[[f64; 13]; 2]], a: usize, b: usize) -> [f64; 13] {
    let (la, lb) = (a.div_ceil(2), b.div_ceil(2));
    let is_sine = |f: usize| f > 0 && f.is_multiple_of(2);
    let (high, low) = (&sums[la + lb], &sums[la.abs_diff(lb)]);
    std::array::from_fn(|k| {
        0.5 * match (is_sine(a), is_sine(b)) {
            (false, false) => low[0][k] + high[0][k],
            (true, true) => low[0][k] - high[0][k],
            (true, false) => high[1][k] + if la >= lb { low[1][k] } else { -low[1][k] },
            (false, true) => high[1][k] + if lb >= la { low[1][k] } else { -low[1][k] },
        }
    })
}

/// Cholesky's factor in the lower triangle; false where a pivot is not positive.
fn factorise(matrix: &mut [f64], n: usize) -> bool {
    for r in 0..n {
        for c in 0..=r {
            let inner: f64 = (0..c).map(|k| matrix[r * n + k] * matrix[c * n + k]).sum();
            let rest = matrix[r * n + c] - inner;
            if r == c {
                if rest.is_nan() || rest <= 0.0 {
                    return false;
                }
                matrix[r * n + r] = rest.sqrt();
            } else {
                matrix[r * n + c] = rest / matrix[c * n + c];
            }
        }
    }
    true
}

fn forward(factor: &[f64], n: usize, x: &mut [f64]) {
    for r in 0..n {
        let inner: f64 = (0..r).map(|k| factor[r * n + k] * x[k]).sum();
        x[r] = (x[r] - inner) / factor[r * n + r];
    }
}

fn backward(factor: &[f64], n: usize, x: &mut [f64]) {
    for r in (0..n).rev() {
        let inner: f64 = (r + 1..n).map(|k| factor[k * n + r] * x[k]).sum();
        x[r] = (x[r] - inner) / factor[r * n + r];
    }
}

#[cfg(test)]
mod tests {
    use super::{Beside, frequency_of};

    fn beside(body: impl Fn(f64) -> [f64; 3]) -> Beside {
        let mut beside = Beside { time_s: Vec::new(), sights: Vec::new() };
        let unit = |v: [f64; 3]| v.map(|x| x / v.iter().map(|y| y * y).sum::<f64>().sqrt());
        for k in 0..80 {
            let t = 0.25 * f64::from(k);
            let camera = [2.0 * (0.31 * t).cos(), 1.5 * (0.47 * t).sin(), 0.4 * (0.9 * t).sin() + 0.1 * t];
            let place = body(t);
            beside.push(t, unit(camera.map(|x| -x)), unit(std::array::from_fn(|c| place[c] - camera[c])));
        }
        beside
    }

    #[test]
    fn a_circle_beside_a_point_at_rest_shows_its_frequency() {
        let one = beside(|t| [3.0 + (1.3 * t).cos(), 1.0 + (1.3 * t).sin(), 0.7 + 0.5 * (1.3 * t).cos()]);
        for order in [1, 2, 4] {
            let found = frequency_of(&[(&one, order)]).unwrap_or(f64::NAN);
            assert!((found - 1.3).abs() < 1e-5, "order {order}: {found}");
        }
    }

    #[test]
    fn harmonics_that_a_path_needs_are_seen() {
        let one = beside(|t| {
            let (a, b) = (0.9 * t, 1.8 * t);
            [3.0 + a.cos() + b.sin(), 1.0 + a.sin() + 0.8 * b.cos(), 0.7 + 0.5 * a.cos() - 0.6 * b.sin()]
        });
        // one harmonic tells it, to what the other leaves; the joint solution makes it exact
        let found = frequency_of(&[(&one, 2)]).unwrap_or(f64::NAN);
        assert!((found - 0.9).abs() < 2e-3, "{found}");
    }

    #[test]
    fn of_no_bodies_there_is_none() {
        assert!(frequency_of(&[]).is_none());
        assert!(frequency_of(&[(&Beside { time_s: Vec::new(), sights: Vec::new() }, 1)]).is_none());
    }
}
