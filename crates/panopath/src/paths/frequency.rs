//! Angular frequencies that nobody gave: a scan, then golden sections about the best of it.
//!
//! With cameras known the cost of a frequency is that of the track's own robust fit. Without, a body and one point at rest
//! suffice in space: the camera lies on the plane of both directions `s` and `v`, so `(s x v) . (P(t) - P0) = 0`, linear in the
//! vectors of the path. A path that goes with the camera meets that too, so what is wanted is the least
//! `sum ((s x v) . P)^2 + e^2 |P|^2` for a given part of `P` across `s`.
//!
//! A frequency that fits has fractions that fit as well, and others whose harmonics look like it at the times that were
//! sampled. All of these go by a higher harmonic, so of nearly equal costs one whose first harmonic is the largest is taken.

use std::f64::consts::PI;

use rayon::prelude::*;

use super::basis::Form;
use super::track::{Sightings, fit};
use super::{Input, select};
use crate::bundle::noise::SIGMA_FLOOR_RAD;
use crate::bundle::part::Lanes;
use crate::geometry::cross;
use crate::structure::Structure;

/// Frequencies go from that of a path seen for so much of its period.
const LEAST_SHARE: f64 = 0.25;
/// Steps of a scan, at most.
const STEPS: usize = 8192;
/// Minima of a scan that are looked at closer, and divisions of each golden section.
const MINIMA: usize = 12;
const DIVISIONS: usize = 55;
/// Squared costs within this multiple of the least are nearly equal; the first harmonic then has more than this share.
const NEARLY: f64 = 4.0;
const FIRST_SHARE: f64 = 0.5;
/// Noise that the scan allows for, radians, so that frequencies nearby show; and the closer look.
const COARSE_RAD: f64 = 0.02;
const FINE_RAD: f64 = 0.002;
/// Share of the coarse step that the closer look goes over.
const FINE_REACH: f64 = 0.125;
/// Error of a direction that a scan without cameras reckons with, radians.
const ERROR_RAD: f64 = 3e-4;
/// Power iterations for the softest path.
const ITERATIONS: usize = 12;

impl<const D: usize> Input<'_, D> {
    /// Tracks whose frequency is sought and not found yet.
    pub(super) fn without_frequency(&self) -> Vec<usize> {
        let lacks = |form: &Option<Form>| form.as_ref().is_some_and(|form| !has_frequency(form));
        (0..self.forms.len()).filter(|&t| lacks(&self.forms[t])).collect()
    }

    /// Fills in the frequencies that tracks show by themselves, cameras known.
    pub(super) fn find_frequencies(&mut self, structure: &Structure<D>) {
        let sigma = structure.summary.sigma_rad.max(SIGMA_FLOOR_RAD);
        let seen: Vec<(usize, Sightings)> =
            self.without_frequency().into_iter().map(|t| (t, self.sightings(structure, t).0)).collect();
        // at rest there is nothing to come back
        let moves = |(_, seen): &(usize, Sightings)| seen.len() > 2 && !select::is_at_rest::<D>(seen, sigma);
        let seen: Vec<(usize, Sightings)> = seen.into_iter().filter(moves).collect();
        let cost = |(track, seen): &(usize, Sightings), omega: f64, noise: f64| {
            let noise = noise.max(sigma);
            let floor = seen.len() as f64 * sigma * sigma;
            let form = self.forms[*track].as_ref().map(|form| with_frequency(form, omega));
            let found = form.and_then(|form| fit::<D>(seen, &form, noise));
            // as much as outliers everywhere
            let lost = 25.0 * seen.len() as f64;
            floor + noise * noise * found.map_or(lost, |fit| fit.cost)
        };
        let order = |track: usize| self.forms[track].as_ref().map_or(1, Form::len) / 2;
        let search = |group: &[(usize, Sightings)]| {
            let times: Vec<f64> = group.iter().flat_map(|(_, seen)| seen.time_s.iter().copied()).collect();
            let highest = group.iter().map(|(t, _)| order(*t)).max()?;
            let total = |omega: f64, noise: f64| group.iter().map(|one| cost(one, omega, noise)).sum::<f64>();
            let grid = Grid::over(times, highest)?;
            let minima = grid.minima(&|omega| total(omega, COARSE_RAD));
            let reach = FINE_REACH * grid.step;
            let closer: Vec<(f64, f64)> =
                minima.into_par_iter().map(|(_, w)| golden(w - reach, w + reach, &|w| total(w, FINE_RAD))).collect();
            let first = |omega: f64| {
                let shares = group.iter().filter_map(|(t, seen)| {
                    let form = with_frequency(self.forms[*t].as_ref()?, omega);
                    let found = fit::<D>(seen, &form, FINE_RAD.max(sigma))?;
                    Some(first_share(found.vectors.iter().map(|p| p.dot::<D>(p))))
                });
                shares.fold(f64::INFINITY, f64::min)
            };
            chosen(&closer, first)
        };
        let found: Vec<(usize, f64)> = if self.motion.common_frequency {
            let common = search(&seen);
            seen.iter().filter_map(|(t, _)| common.map(|omega| (*t, omega))).collect()
        } else {
            seen.iter().filter_map(|one| search(std::slice::from_ref(one)).map(|omega| (one.0, omega))).collect()
        };
        self.fill_in(&found);
    }

    /// Fills in the frequencies that bodies show beside a point at rest, cameras unknown.
    pub(super) fn find_frequencies_without_cameras(&mut self) {
        let known = |&t: &usize| matches!(self.forms[t], Some(Form::Static));
        let anchor = (0..self.forms.len()).filter(known).max_by_key(|&t| self.observations(t).len());
        let Some(anchor) = anchor.filter(|_| D == 3) else { return };
        let of = |t: usize| {
            let order = self.forms[t].as_ref().map_or(1, Form::len) / 2;
            (t, Beside::new(self, anchor, t, order))
        };
        let seen: Vec<(usize, Beside)> = self.without_frequency().into_iter().map(of).collect();
        let seen: Vec<(usize, Beside)> = seen.into_iter().filter(|(_, beside)| beside.suffices()).collect();
        let search = |group: &[(usize, Beside)]| {
            let times: Vec<f64> = group.iter().flat_map(|(_, beside)| beside.time_s.iter().copied()).collect();
            let highest = group.iter().map(|(_, beside)| beside.order).max()?;
            let total = |omega: f64| group.iter().map(|(_, beside)| beside.cost(omega)).sum::<f64>();
            let first = |omega: f64| {
                let shares = group.iter().map(|(_, beside)| beside.softest(omega).1);
                shares.fold(f64::INFINITY, f64::min)
            };
            chosen(&Grid::over(times, highest)?.minima(&total), first)
        };
        let found: Vec<(usize, f64)> = if self.motion.common_frequency {
            let common = search(&seen);
            seen.iter().filter_map(|(t, _)| common.map(|omega| (*t, omega))).collect()
        } else {
            seen.iter().filter_map(|one| search(std::slice::from_ref(one)).map(|omega| (one.0, omega))).collect()
        };
        self.fill_in(&found);
    }

    fn fill_in(&mut self, found: &[(usize, f64)]) {
        for &(track, omega) in found {
            self.forms[track] = self.forms[track].as_ref().map(|form| with_frequency(form, omega));
        }
    }
}

/// Is a form one whose frequency is known, or that has none?
pub(super) fn has_frequency(form: &Form) -> bool {
    !matches!(form, Form::Fourier { omega_rad_s, .. } if omega_rad_s.is_nan())
}

fn with_frequency(form: &Form, omega: f64) -> Form {
    match form {
        Form::Fourier { order, .. } => Form::Fourier { order: *order, omega_rad_s: omega },
        other => other.clone(),
    }
}

/// Frequencies that are tried.
struct Grid {
    first: f64,
    step: f64,
    n: usize,
}

impl Grid {
    /// From a quarter of a period in the time seen, to half a period in the usual time between observations.
    fn over(mut times: Vec<f64>, order: usize) -> Option<Self> {
        times.sort_by(f64::total_cmp);
        times.dedup();
        let span = times.last()? - times.first()?;
        let mut gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        gaps.sort_by(f64::total_cmp);
        let gap = *gaps.get(gaps.len() / 2)?;
        // the phase of the highest harmonics must not run away between two steps
        let step = PI / (4.0 * span) / (0.5 * order as f64).max(1.0);
        let first = 2.0 * PI * LEAST_SHARE / span;
        let n = ((PI / gap - first) / step).floor();
        (n >= 1.0 && first.is_finite()).then(|| Self { first, step, n: (n as usize + 1).min(STEPS) })
    }

    /// The lowest minima, as cost and frequency.
    fn minima(&self, cost: &(impl Fn(f64) -> f64 + Sync)) -> Vec<(f64, f64)> {
        let at = |k: usize| self.first + k as f64 * self.step;
        let costs: Vec<f64> = (0..self.n).into_par_iter().map(|k| cost(at(k))).collect();
        let is_low = |k: &usize| {
            let near = k.saturating_sub(1)..(k + 2).min(self.n);
            costs[*k].is_finite() && costs[near].iter().all(|other| costs[*k] <= *other)
        };
        let mut low: Vec<usize> = (0..self.n).filter(is_low).collect();
        low.sort_by(|&a, &b| costs[a].total_cmp(&costs[b]).then(b.cmp(&a)));
        low.truncate(MINIMA);
        low.into_par_iter().map(|k| golden(at(k) - self.step, at(k) + self.step, cost)).collect()
    }
}

/// Least cost between two frequencies, and where it is (Kiefer 1953).
fn golden(mut a: f64, mut b: f64, cost: &impl Fn(f64) -> f64) -> (f64, f64) {
    const SHARE: f64 = 0.618_033_988_749_894_9;
    a = a.max(f64::MIN_POSITIVE);
    let (mut c, mut d) = (b - SHARE * (b - a), a + SHARE * (b - a));
    let (mut at_c, mut at_d) = (cost(c), cost(d));
    for _ in 0..DIVISIONS {
        if at_c < at_d {
            (b, d, at_d) = (d, c, at_c);
            c = b - SHARE * (b - a);
            at_c = cost(c);
        } else {
            (a, c, at_c) = (c, d, at_d);
            d = a + SHARE * (b - a);
            at_d = cost(d);
        }
    }
    if at_c < at_d { (at_c, c) } else { (at_d, d) }
}

/// The frequency of least cost, of those that go by their first harmonic where there are such.
fn chosen(minima: &[(f64, f64)], first: impl Fn(f64) -> f64) -> Option<f64> {
    let best = minima.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let near = minima.iter().filter(|m| m.0 <= NEARLY * best.0 && first(m.1) > FIRST_SHARE);
    Some(near.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or(best).1)
}

/// Share of the first harmonic, of the squared lengths of all vectors.
fn first_share(squared: impl Iterator<Item = f64>) -> f64 {
    let harmonics: Vec<f64> = squared.skip(1).collect();
    harmonics.iter().take(2).sum::<f64>() / harmonics.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

/// A body beside a point at rest, seen by views of which nothing is known.
struct Beside {
    order: usize,
    time_s: Vec<f64>,
    /// `m m^T` of `m = s x v`, then `I - s s^T`: six numbers each, lower triangles by rows.
    forms: Vec<[f64; 12]>,
}

impl Beside {
    fn new<const D: usize>(input: &Input<'_, D>, anchor: usize, track: usize, order: usize) -> Self {
        let mut own = Self { order, time_s: Vec::new(), forms: Vec::new() };
        let view = |o: u32| input.tracks.view()[o as usize];
        let space = |o: u32| Lanes::from_vector::<D>(&input.world_direction(o)).vector::<3>();
        for &o in input.observations(track) {
            let Ok(place) = input.observations(anchor).binary_search_by_key(&view(o), |&a| view(a)) else { continue };
            let s = space(input.observations(anchor)[place]);
            let m = cross(&s, &space(o));
            let mut form = [0.0; 12];
            for (k, (r, c)) in [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)].into_iter().enumerate() {
                form[k] = m[r] * m[c];
                form[6 + k] = f64::from(r == c) - s[r] * s[c];
            }
            own.time_s.push(input.time_s[view(o) as usize]);
            own.forms.push(form);
        }
        own
    }

    fn unknowns(&self) -> usize {
        3 * (2 * self.order + 1)
    }

    fn suffices(&self) -> bool {
        self.time_s.len() > self.unknowns()
    }

    /// Cosine and sine sums of both forms, and of ones, for every multiple of a frequency that products of harmonics have.
    fn sums(&self, omega: f64) -> Vec<[[f64; 13]; 2]> {
        let mut sums = vec![[[0.0; 13]; 2]; 2 * self.order + 1];
        let origin = self.time_s[0];
        for (time, form) in self.time_s.iter().zip(&self.forms) {
            let (sin, cos) = (omega * (time - origin)).sin_cos();
            let (mut c, mut s) = (1.0, 0.0);
            for [even, odd] in &mut sums {
                for k in 0..12 {
                    even[k] += c * form[k];
                    odd[k] += s * form[k];
                }
                even[12] += c;
                odd[12] += s;
                (c, s) = (c * cos - s * sin, s * cos + c * sin);
            }
        }
        sums
    }

    /// Least `sum (m . P)^2 + e^2 |P|^2` over `sum |(I - s s^T) P|^2`.
    fn cost(&self, omega: f64) -> f64 {
        self.softest(omega).0
    }

    /// The same, with the share that the first harmonic has of that path.
    fn softest(&self, omega: f64) -> (f64, f64) {
        let (sums, n) = (self.sums(omega), self.unknowns());
        let (mut off, mut across) = (vec![0.0; n * n], vec![0.0; n * n]);
        const PLACE: [[usize; 3]; 3] = [[0, 1, 3], [1, 2, 4], [3, 4, 5]];
        for a in 0..n / 3 {
            for b in 0..n / 3 {
                let product = product(&sums, a, b);
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
            return (f64::INFINITY, 0.0);
        }
        let mut x: Vec<f64> = (0..n).map(|k| ((k + 1) as f64 * 0.618_033_988_749_894_9).fract() - 0.5).collect();
        let mut largest = 0.0;
        for _ in 0..ITERATIONS {
            // x' = L^-1 across L^-T x, whose largest value is the inverse of the cost
            let length = x.iter().map(|v| v * v).sum::<f64>().sqrt();
            x.iter_mut().for_each(|v| *v /= length);
            let before = x.clone();
            backward(&off, n, &mut x);
            x = (0..n).map(|r| across[r * n..(r + 1) * n].iter().zip(&x).map(|(a, v)| a * v).sum()).collect();
            forward(&off, n, &mut x);
            largest = x.iter().zip(&before).map(|(a, b)| a * b).sum();
        }
        backward(&off, n, &mut x);
        let share = first_share(x.chunks_exact(3).map(|p| p.iter().map(|v| v * v).sum()));
        (if largest > 0.0 { 1.0 / largest } else { f64::INFINITY }, share)
    }
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
    use super::{Beside, Grid, chosen, golden};

    #[test]
    fn the_equal_that_goes_by_its_first_harmonic_is_found() {
        let cost = |w: f64| 1.0 + (2.0 * (w - 3.7)).sin().powi(2).min((2.0 * (w - 5.1)).sin().powi(2));
        let times: Vec<f64> = (0..60).map(|k| 0.5 * f64::from(k)).collect();
        let minima = Grid::over(times, 1).map(|grid| grid.minima(&cost)).unwrap_or_default();
        let found = chosen(&minima, |w| f64::from((w - 5.27).abs() < 0.01)).unwrap_or(f64::NAN);
        assert!((found - 5.270_796_326_794_897).abs() < 1e-6, "{found}, {minima:?}");
        assert!((golden(0.5, 4.0, &|w| (w - 2.0).powi(2)).1 - 2.0).abs() < 1e-7);
        assert!(Grid::over(vec![1.0], 1).is_none() && Grid::over(Vec::new(), 1).is_none());
    }

    #[test]
    fn a_circle_beside_a_point_at_rest_shows_its_frequency() {
        let time_s: Vec<f64> = (0..80).map(|k| 0.25 * f64::from(k)).collect();
        let mut beside = Beside { order: 2, time_s: Vec::new(), forms: Vec::new() };
        for &t in &time_s {
            let camera = [2.0 * (0.31 * t).cos(), 1.5 * (0.47 * t).sin(), 0.4 * (0.9 * t).sin() + 0.1 * t];
            let body = [3.0 + (1.3 * t).cos(), 1.0 + (1.3 * t).sin(), 0.7 + 0.5 * (1.3 * t).cos()];
            let unit = |v: [f64; 3]| v.map(|x| x / v.iter().map(|y| y * y).sum::<f64>().sqrt());
            let s = unit(camera.map(|x| -x));
            let m = crate::geometry::cross(&s, &unit(std::array::from_fn(|c| body[c] - camera[c])));
            let mut form = [0.0; 12];
            for (k, (r, c)) in [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)].into_iter().enumerate() {
                (form[k], form[6 + k]) = (m[r] * m[c], f64::from(r == c) - s[r] * s[c]);
            }
            beside.time_s.push(t);
            beside.forms.push(form);
        }
        let minima = Grid::over(time_s, 2).map(|grid| grid.minima(&|w| beside.cost(w))).unwrap_or_default();
        let found = chosen(&minima, |w| beside.softest(w).1).unwrap_or(f64::NAN);
        assert!((found - 1.3).abs() < 1e-5, "{found}, {minima:?}");
    }
}
