//! Angular frequencies that nobody gave: a scan, then golden sections about the best of it.
//!
//! With cameras known the cost of a frequency is that of the track's own robust fit. Without, a body and one point at rest
//! suffice in space ([`beside`]).
//!
//! A frequency that fits has fractions that fit as well, and others whose harmonics look like it at the times that were
//! sampled. All of these go by a higher harmonic, so of nearly equal costs one whose first harmonic is the largest is taken.

mod beside;

use std::f64::consts::PI;

use rayon::prelude::*;

use super::basis::Form;
use super::track::{Fit, Sightings, fit};
use super::{Found, Input, select};
use crate::bundle::noise::SIGMA_FLOOR_RAD;
use crate::structure::Structure;
use beside::{Beside, frequency_of};

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
/// Multiples of a frequency that are looked at once cameras are known, and divisions of each golden section.
const AGAIN: [f64; 6] = [1.0 / 3.0, 0.5, 2.0 / 3.0, 1.5, 2.0, 3.0];
const AGAIN_DIVISIONS: usize = 18;
/// Share of a track's observations that a frequency is given up below.
const LOST_SHARE: f64 = 0.25;
/// Squared costs are much less by this factor.
const MUCH: f64 = 25.0;
/// Share of the coarse step that the closer look goes over.
const FINE_REACH: f64 = 0.125;

impl<const D: usize> Input<'_, D> {
    /// Tracks whose frequency is sought and not found yet.
    pub(super) fn without_frequency(&self) -> Vec<usize> {
        (0..self.forms.len()).filter(|&t| lacks_frequency(&self.forms[t])).collect()
    }

    /// Tracks whose frequency the caller did not say, found since or not.
    fn sought(&self) -> impl Iterator<Item = usize> {
        (0..self.forms.len()).filter(|&t| lacks_frequency(&self.motion.forms[t]))
    }

    /// Harmonics that a track may have.
    fn order(&self, track: usize) -> usize {
        self.forms[track].as_ref().map_or(1, Form::len) / 2
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
            self.forms[*track].as_ref().map_or(f64::INFINITY, |form| cost::<D>(seen, form, omega, noise, sigma))
        };
        let search = |group: &[(usize, Sightings)]| {
            let times: Vec<f64> = group.iter().flat_map(|(_, seen)| seen.time_s.iter().copied()).collect();
            let highest = group.iter().map(|(t, _)| self.order(*t)).max()?;
            let total = |omega: f64, noise: f64| group.iter().map(|one| cost(one, omega, noise)).sum::<f64>();
            let grid = Grid::over(times, highest)?;
            let minima = grid.minima(&|omega| total(omega, COARSE_RAD));
            let reach = FINE_REACH * grid.step;
            let closer: Vec<(f64, f64)> = minima
                .into_par_iter()
                .map(|(_, w)| golden(w - reach, w + reach, DIVISIONS, &|w| total(w, FINE_RAD)))
                .collect();
            let first = |omega: f64| {
                let shares = group.iter().filter_map(|(t, seen)| {
                    let form = with_frequency(self.forms[*t].as_ref()?, omega);
                    fit::<D>(seen, &form, FINE_RAD.max(sigma)).map(|path| first_share::<D>(&path))
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
        let of = |t: usize| (t, Beside::new(self, anchor, t), self.order(t));
        let seen: Vec<(usize, Beside, usize)> = self.without_frequency().into_iter().map(of).collect();
        let seen: Vec<(usize, Beside, usize)> = seen.into_iter().filter(|(_, b, order)| b.suffices(*order)).collect();
        let found: Vec<(usize, f64)> = if self.motion.common_frequency {
            let all: Vec<(&Beside, usize)> = seen.iter().map(|(_, beside, order)| (beside, *order)).collect();
            let common = frequency_of(&all);
            seen.iter().filter_map(|(t, ..)| common.map(|omega| (*t, omega))).collect()
        } else {
            let own = |(t, b, order): &(usize, Beside, usize)| frequency_of(&[(b, *order)]).map(|omega| (*t, omega));
            seen.iter().filter_map(own).collect()
        };
        self.fill_in(&found);
    }

    /// Looks at frequencies again that were found without cameras, now that these are known: does a multiple or a fraction
    /// fit better? True where one does, and the path is that one's.
    pub(super) fn look_again(&self, found: &mut Found<D>) -> bool {
        if self.motion.common_frequency || found.structure.summary.n_components != 1 {
            return false;
        }
        let sigma = found.structure.summary.sigma_rad.max(SIGMA_FLOOR_RAD);
        let again = |t: usize| -> Option<(usize, Option<Fit>)> {
            let Form::Fourier { omega_rad_s, .. } = found.fits[t].as_ref()?.form else { return None };
            let form = self.motion.forms[t].as_ref()?;
            let (seen, _) = self.sightings_turned(&found.structure, t);
            let (first, last) = seen.span();
            let reach = PI / (4.0 * (last - first));
            let near = |omega: f64| {
                golden(omega - reach, omega + reach, AGAIN_DIVISIONS, &|w| cost::<D>(&seen, form, w, FINE_RAD, sigma))
            };
            let tried = AGAIN.into_par_iter().map(|share| share * omega_rad_s);
            // more than a turn: less of one fits whatever is smooth
            let minima: Vec<(f64, f64)> = tried.filter(|omega| *omega > 8.0 * reach).map(near).collect();
            let present = near(omega_rad_s).0;
            let path = |omega: f64| fit::<D>(&seen, &with_frequency(form, omega), FINE_RAD.max(sigma));
            let share = |omega: f64| path(omega).map_or(0.0, |path| first_share::<D>(&path));
            // a multiple must go by its first harmonic where this one does not; cameras lean on what was found, so others
            // must do much better
            let goes_by_higher = share(omega_rad_s) <= FIRST_SHARE;
            let is_better = |(cost, omega): &(f64, f64)| {
                *cost <= present / MUCH
                    || goes_by_higher
                        && *omega > omega_rad_s
                        && *cost <= NEARLY * present
                        && share(*omega) > FIRST_SHARE
            };
            let minima: Vec<(f64, f64)> = minima.into_iter().filter(is_better).collect();
            let omega = chosen(&minima, share)?;
            let is_another = (omega - omega_rad_s).abs() > 2.0 * reach;
            is_another.then(|| (t, fit::<D>(&seen, &with_frequency(form, omega), sigma).or_else(|| path(omega))))
        };
        let other: Vec<(usize, Option<Fit>)> = self.sought().filter_map(again).collect();
        let is_any = !other.is_empty();
        other.into_iter().for_each(|(t, fit)| found.fits[t] = fit);
        is_any
    }

    /// Gives up the frequencies of tracks that hardly anything agrees with now that cameras are known, and looks for others
    /// there. True where any is found.
    pub(super) fn find_lost(&mut self, found: &mut Found<D>) -> bool {
        let is_lost = |fit: &Fit| (fit.n_kept() as f64) < LOST_SHARE * fit.keep.len() as f64;
        let lost: Vec<usize> = self.sought().filter(|&t| found.fits[t].as_ref().is_none_or(is_lost)).collect();
        if lost.is_empty() || self.motion.common_frequency {
            return false;
        }
        for &t in &lost {
            self.forms[t] = self.motion.forms[t].clone();
        }
        self.find_what_is_left(found);
        lost.iter().any(|&t| found.fits[t].is_some())
    }

    fn fill_in(&mut self, found: &[(usize, f64)]) {
        for &(track, omega) in found {
            self.forms[track] = self.forms[track].as_ref().map(|form| with_frequency(form, omega));
        }
    }
}

/// Squared errors of the best path of a frequency, in radians squared, where the noise is taken to be at least `noise`.
fn cost<const D: usize>(seen: &Sightings, form: &Form, omega: f64, noise: f64, sigma: f64) -> f64 {
    let noise = noise.max(sigma);
    let floor = seen.len() as f64 * sigma * sigma;
    let found = fit::<D>(seen, &with_frequency(form, omega), noise);
    // as much as outliers everywhere
    let lost = 25.0 * seen.len() as f64;
    floor + noise * noise * found.map_or(lost, |fit| fit.cost)
}

/// Is a form one whose frequency is known, or that has none?
pub(super) fn has_frequency(form: &Form) -> bool {
    !matches!(form, Form::Fourier { omega_rad_s, .. } if omega_rad_s.is_nan())
}

fn lacks_frequency(form: &Option<Form>) -> bool {
    form.as_ref().is_some_and(|form| !has_frequency(form))
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
    /// From a quarter of a period in the time seen, to half a period in the time between observations.
    ///
    /// Where these come as they come, the short times between them tell of periods that the long ones do not.
    fn over(mut times: Vec<f64>, order: usize) -> Option<Self> {
        times.sort_by(f64::total_cmp);
        times.dedup();
        let span = times.last()? - times.first()?;
        let mut gaps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        gaps.sort_by(f64::total_cmp);
        let gap = *gaps.get(gaps.len() / 4)?;
        // the phase of the highest harmonics must not run away between two steps
        let step = PI / (4.0 * span) / (0.5 * order as f64).max(1.0);
        let first = 2.0 * PI * LEAST_SHARE / span;
        let n = ((PI / gap - first) / step).floor();
        (n >= 1.0 && first.is_finite()).then(|| Self { first, step, n: (n as usize + 1).min(STEPS) })
    }

    /// The lowest minima among the frequencies that are tried.
    fn lowest(&self, cost: &(impl Fn(f64) -> f64 + Sync)) -> Vec<f64> {
        let at = |k: usize| self.first + k as f64 * self.step;
        let costs: Vec<f64> = (0..self.n).into_par_iter().map(|k| cost(at(k))).collect();
        let is_low = |k: &usize| {
            let near = k.saturating_sub(1)..(k + 2).min(self.n);
            costs[*k].is_finite() && costs[near].iter().all(|other| costs[*k] <= *other)
        };
        let mut low: Vec<usize> = (0..self.n).filter(is_low).collect();
        low.sort_by(|&a, &b| costs[a].total_cmp(&costs[b]).then(b.cmp(&a)));
        low.truncate(MINIMA);
        low.into_iter().map(at).collect()
    }

    /// The lowest minima, looked at closer, as cost and frequency.
    fn minima(&self, cost: &(impl Fn(f64) -> f64 + Sync)) -> Vec<(f64, f64)> {
        let closer = |omega| golden(omega - self.step, omega + self.step, DIVISIONS, cost);
        self.lowest(cost).into_par_iter().map(closer).collect()
    }
}

/// Least cost between two frequencies, and where it is (Kiefer 1953).
fn golden(mut a: f64, mut b: f64, divisions: usize, cost: &impl Fn(f64) -> f64) -> (f64, f64) {
    const SHARE: f64 = 0.618_033_988_749_894_9;
    a = a.max(f64::MIN_POSITIVE);
    let (mut c, mut d) = (b - SHARE * (b - a), a + SHARE * (b - a));
    let (mut at_c, mut at_d) = (cost(c), cost(d));
    for _ in 0..divisions {
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

/// Share of the first harmonic, of the squared lengths of the vectors of all harmonics.
fn first_share<const D: usize>(path: &Fit) -> f64 {
    let harmonics: Vec<f64> = path.vectors.iter().skip(1).map(|p| p.dot::<D>(p)).collect();
    harmonics.iter().take(2).sum::<f64>() / harmonics.iter().sum::<f64>().max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::{Grid, chosen, golden};

    #[test]
    fn the_equal_that_goes_by_its_first_harmonic_is_found() {
        let cost = |w: f64| 1.0 + (2.0 * (w - 3.7)).sin().powi(2).min((2.0 * (w - 5.1)).sin().powi(2));
        let times: Vec<f64> = (0..60).map(|k| 0.5 * f64::from(k)).collect();
        let minima = Grid::over(times, 1).map(|grid| grid.minima(&cost)).unwrap_or_default();
        let found = chosen(&minima, |w| f64::from((w - 5.27).abs() < 0.01)).unwrap_or(f64::NAN);
        assert!((found - 5.270_796_326_794_897).abs() < 1e-6, "{found}, {minima:?}");
        assert!((golden(0.5, 4.0, 55, &|w| (w - 2.0).powi(2)).1 - 2.0).abs() < 1e-7);
        assert!(Grid::over(vec![1.0], 1).is_none() && Grid::over(Vec::new(), 1).is_none());
    }
}
