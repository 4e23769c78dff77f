//! Rest or motion, and of what order: the simplest form of path that a track's errors allow.
//!
//! Forms are compared by `cost + unknowns ln(rows)` (Schwarz 1978), the cost in units of the noise and no error counted
//! beyond the outlier limit. Rest is given up only where the gain is beyond chance by a likelihood ratio too: of a hundred
//! thousand tracks at rest few may be called moving.

use super::basis::Form;
use super::track::{Fit, Sightings, fit, fit_near, has_spare, still_at};
use crate::bundle::part::Lanes;

/// Standard deviations of a normal variable that a gain by chance stays below, for leaving rest.
const MOVES_Z: f64 = 4.0;
/// And that the errors of a track at rest stay below, for looking no further.
const AT_REST_Z: f64 = 2.3;
/// Share of the observations that agree with a track at rest, for looking no further, and with any path.
const AT_REST_SHARE: f64 = 0.6;
const LEAST_SHARE: f64 = 0.5;
/// And that a gain by chance stays below, for the next richer form of a path that suffices.
const RICHER_Z: f64 = 1.645;

/// The path that a track shows among rest and the candidates; `None` where nothing agrees with most of its observations.
///
/// `at_rest` is where the point would be if it were at rest, as far as that is known; `before` the path found with cameras that
/// stood a little elsewhere.
pub(super) fn choose<const D: usize>(
    sightings: &Sightings,
    candidates: &[Form],
    sigma: f64,
    at_rest: Lanes,
    before: Option<&Fit>,
) -> Option<Fit> {
    let rows = ((D - 1) * sightings.len()) as f64;
    let agrees = |fit: &Fit, share: f64| fit.n_kept() as f64 >= share * sightings.len() as f64;
    let suffices =
        |fit: &Fit| agrees(fit, AT_REST_SHARE) && inlier_cost(fit) <= chi_squared(freedom::<D>(fit), AT_REST_Z);
    let before = before.filter(|fit| fit.form.len() > 1);
    if before.is_none() && at_rest.0[0].is_finite() {
        // most tracks rest where the cameras were solved with them
        let still = still_at::<D>(sightings, sigma, at_rest);
        if suffices(&still) {
            return Some(still);
        }
    }
    let middle = before.map_or(at_rest, |fit| middle_of(fit, sightings));
    let near = fit_near::<D>(sightings, &Form::Static, sigma, vec![middle]);
    let again = before.and_then(|fit| fit_near::<D>(sightings, &fit.form, sigma, fit.vectors.clone())).filter(suffices);
    // a point that the cameras were solved with was sought well enough there
    let is_known = again.is_some() || before.is_none() && at_rest.0[0].is_finite();
    let still =
        if is_known { near } else { near.filter(suffices).or_else(|| fit::<D>(sightings, &Form::Static, sigma)) };
    if let Some(still) = still.as_ref().filter(|still| suffices(still)) {
        return Some(still.clone());
    }
    let score = |fit: &Fit| fit.cost + (D * fit.form.len()) as f64 * rows.ln();
    let mut moving = again.map(|fit| enriched::<D>(sightings, candidates, sigma, fit));
    for form in if moving.is_some() { &[] } else { candidates } {
        // candidates go from the simple to the rich: what suffices ends the search
        let found = fit::<D>(sightings, form, sigma).filter(|fit| has_spare::<D>(fit) && agrees(fit, LEAST_SHARE));
        let Some(found) = found else { continue };
        let is_enough = suffices(&found);
        if moving.as_ref().is_none_or(|best| score(&found) < score(best)) {
            moving = Some(found);
        }
        if is_enough {
            moving = moving.map(|fit| enriched::<D>(sightings, candidates, sigma, fit));
            break;
        }
    }
    match (still, moving) {
        (Some(still), Some(moving)) => {
            let more = (D * (moving.form.len() - 1)) as f64;
            let leaves_rest = score(&moving) < score(&still) && still.cost - moving.cost > chi_squared(more, MOVES_Z);
            if leaves_rest { Some(moving) } else { agrees(&still, LEAST_SHARE).then_some(still) }
        }
        (None, moving) => moving,
        (still, None) => still.filter(|still| agrees(still, LEAST_SHARE)),
    }
}

/// A path that suffices, or the richer one of its kind that gains more than chance does.
///
/// Where the camera's own path is nearly of the richer form, `C + s (P - C)` can be of the poorer one for some `s`: what
/// suffices there may stand at a wrong distance, and its deviation does not tell.
fn enriched<const D: usize>(sightings: &Sightings, candidates: &[Form], sigma: f64, mut fit: Fit) -> Fit {
    while let Some(form) = candidates.iter().find_map(|form| richer(&fit.form, form)) {
        let mut vectors = fit.vectors.clone();
        vectors.resize(form.len(), Lanes::ZERO);
        let more = (D * (form.len() - fit.form.len())) as f64;
        let Some(found) = fit_near::<D>(sightings, &form, sigma, vectors).filter(has_spare::<D>) else { break };
        if fit.cost - found.cost <= chi_squared(more, RICHER_Z) {
            break;
        }
        fit = found;
    }
    fit
}

/// A candidate whose functions begin with those of a form, with the numbers of that form.
fn richer(form: &Form, candidate: &Form) -> Option<Form> {
    match (form, candidate) {
        (&Form::Taylor { order, origin_s, unit_s }, &Form::Taylor { order: more, .. }) if more > order => {
            Some(Form::Taylor { order: more, origin_s, unit_s })
        }
        (&Form::Fourier { order, omega_rad_s }, &Form::Fourier { order: more, omega_rad_s: same })
            if more > order && same == omega_rad_s =>
        {
            Some(Form::Fourier { order: more, omega_rad_s })
        }
        _ => None,
    }
}

/// Does rest explain a track?
pub(super) fn is_at_rest<const D: usize>(sightings: &Sightings, sigma: f64) -> bool {
    let still = fit::<D>(sightings, &Form::Static, sigma);
    still.is_some_and(|fit| {
        fit.n_kept() as f64 >= AT_REST_SHARE * sightings.len() as f64
            && inlier_cost(&fit) <= chi_squared(freedom::<D>(&fit), MOVES_Z)
    })
}

/// Where a path is in the middle of the time that its track was seen.
fn middle_of(fit: &Fit, sightings: &Sightings) -> Lanes {
    let (first, last) = sightings.span();
    let mut values = vec![0.0; fit.form.len()];
    fit.form.values(0.5 * (first + last), 0, &mut values);
    values.iter().zip(&fit.vectors).fold(Lanes::ZERO, |sum, (b, p)| sum.plus_scaled(*b, p))
}

/// Cost of the observations that agree.
fn inlier_cost(fit: &Fit) -> f64 {
    use crate::bundle::noise::OUTLIER_SIGMAS;
    fit.cost - (fit.keep.len() - fit.n_kept()) as f64 * OUTLIER_SIGMAS * OUTLIER_SIGMAS
}

/// Equations that agree, less the unknowns.
fn freedom<const D: usize>(fit: &Fit) -> f64 {
    ((D - 1) * fit.n_kept()) as f64 - (D * fit.form.len()) as f64
}

/// What a chi-squared variable stays below at a normal variable's quantile (Wilson and Hilferty 1931).
pub(super) fn chi_squared(freedom: f64, z: f64) -> f64 {
    if freedom <= 0.0 {
        return 0.0;
    }
    let a = 2.0 / (9.0 * freedom);
    freedom * (1.0 - a + z * a.sqrt()).powi(3)
}

#[cfg(test)]
mod tests {
    use super::chi_squared;

    #[test]
    fn quantiles_are_those_of_tables() {
        // 99 % of chi squared: 11.34 for 3 freedoms, 23.21 for 10
        assert!((chi_squared(3.0, 2.326) - 11.34).abs() < 0.1);
        assert!((chi_squared(10.0, 2.326) - 23.21).abs() < 0.05);
        assert_eq!(chi_squared(0.0, 4.0), 0.0);
    }
}
