//! What bearings leave free of moving models is taken away by the weakest assumption that suffices: most tracks are at rest.
//!
//! Everything may share a motion, and be scaled by a function of time, where the forms allow it and too little is known to be
//! at rest. Such freedoms are null vectors of linear equations: a scene may be moved along them by any length. Of all
//! scenes that this leads to, the one is taken whose motions add up to least,
//!
//! `min over beta of sum_j |m_j + N_j beta|`, `m_j` the vectors of track `j` that are not a place,
//!
//! by re-weighted least squares. As a sum of lengths, not of squares, it has most tracks exactly at rest where most can be.

use super::basis::Form;
use super::freedoms::{FreedomKind, FreedomOptions, MovingScene, NullVector, freedoms_of_paths};
use super::options::{Assumption, PathError};
use super::{Found, Input};
use crate::bundle::part::Lanes;
use crate::geometry::{Vector, add, norm, scale, sub};
use crate::least_squares::symmetric_eigen_of;
use crate::structure::Status;

/// Rounds of re-weighting; each lowers the length below which a motion counts as none.
const ROUNDS: usize = 60;
const FALLS: f64 = 0.7;
/// What a track at rest seems to move by, at most, over the angle of the noise: the cameras have a spread of one.
const AT_REST_SIGMAS: f64 = 20.0;
/// Motion of exact data that is none, in the unit of the scene.
const NOTHING: f64 = 1e-7;
/// So many tracks at rest, and this share of all, leave nothing free that everything shares.
const FEW_STATIC: usize = 3;
const FEW_SHARE: f64 = 0.1;

impl<const D: usize> Input<'_, D> {
    /// Takes away what everything shares, and says what was assumed. True where there was anything to look for.
    pub(super) fn resolve_freedoms(&self, found: &mut Found<D>) -> Result<bool, PathError> {
        let n_static = found.fits.iter().flatten().filter(|fit| fit.form.len() == 1).count();
        let n_paths = found.fits.iter().flatten().count();
        let enough = FEW_STATIC.max((FEW_SHARE * n_paths as f64) as usize);
        if found.structure.summary.n_components != 1 || n_paths == 0 || n_static >= enough {
            return Ok(false);
        }
        let vectors = self.shared_freedoms(found)?;
        if vectors.is_empty() {
            return Ok(true);
        }
        let forms: Vec<Option<&Form>> = found.fits.iter().map(|fit| fit.as_ref().map(|fit| &fit.form)).collect();
        let starts = starts_of(&forms);
        let mut motions: Vec<Motion<D>> = Vec::new();
        for (track, fit) in found.fits.iter().enumerate() {
            let Some(fit) = fit.as_ref().filter(|fit| fit.form.len() > 1) else { continue };
            let own: Vec<Vector<D>> = fit.vectors.iter().map(Lanes::vector::<D>).collect();
            let follow =
                vectors.iter().map(|v| moving_part(&fit.form, &v.coefficients[starts[track]..starts[track + 1]]));
            motions.push(Motion { own: moving_part(&fit.form, &own), follow: follow.collect() });
        }
        let by = least_motion(&motions, vectors.len());
        for (k, vector) in vectors.iter().enumerate() {
            for (center, change) in found.structure.centers.iter_mut().zip(&vector.centers) {
                *center = add(center, &scale(by[k], change));
            }
            for (track, fit) in found.fits.iter_mut().enumerate() {
                let Some(fit) = fit else { continue };
                for (p, change) in fit.vectors.iter_mut().zip(&vector.coefficients[starts[track]..]) {
                    *p = p.plus_scaled(by[k], &Lanes::from_vector::<D>(change));
                }
            }
        }
        let sigma = found.structure.summary.sigma_rad;
        let limit = NOTHING + AT_REST_SIGMAS * sigma;
        let resting = motions.iter().filter(|m| m.length(&by) < limit).count() + n_static;
        let most_rest = 2 * resting > n_paths;
        if self.n_known_static() == 0 {
            found.assumption = if most_rest { Assumption::MostStatic } else { Assumption::LeastMotion };
        }
        if !most_rest {
            // one choice among many, and no reason for it
            found.structure.summary.status = Status::Ambiguous;
        }
        Ok(true)
    }

    /// Null vectors beyond the gauge that are not of single tracks or views.
    fn shared_freedoms(&self, found: &Found<D>) -> Result<Vec<NullVector<D>>, PathError> {
        let (mut view, mut track, mut coefficients, mut forms) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for (t, fit) in found.fits.iter().enumerate() {
            let Some(fit) = fit else {
                forms.push(Form::Static);
                coefficients.push([f64::NAN; D]);
                continue;
            };
            let (_, rows) = self.sightings(&found.structure, t);
            for &o in rows.iter().zip(&fit.keep).filter(|(_, keep)| **keep).map(|(o, _)| o) {
                view.push(self.tracks.view()[o as usize]);
                track.push(t as u32);
            }
            forms.push(fit.form.clone());
            coefficients.extend(fit.vectors.iter().map(Lanes::vector::<D>));
        }
        let scene = MovingScene {
            view: &view,
            track: &track,
            sigma_rad: &[],
            centers: &found.structure.centers,
            time_s: self.time_s,
            forms: &forms,
            coefficients: &coefficients,
        };
        let options = FreedomOptions { sigma_rad: found.structure.summary.sigma_rad, ..FreedomOptions::default() };
        let certificate = freedoms_of_paths(&scene, &options).map_err(|error| PathError::Option(error.to_string()))?;
        // a view that hangs loose moves nothing else: it is told of, and the rest stands
        let shared = certificate.freedoms.into_iter().filter(|freedom| freedom.kind != FreedomKind::LooseView);
        Ok(shared.flat_map(|freedom| freedom.vectors).collect())
    }
}

/// What of a track is motion, and how the freedoms change that.
struct Motion<const D: usize> {
    own: Vec<Vector<D>>,
    follow: Vec<Vec<Vector<D>>>,
}

impl<const D: usize> Motion<D> {
    fn after(&self, by: &[f64]) -> Vec<Vector<D>> {
        let moved =
            |l: usize| by.iter().zip(&self.follow).fold(self.own[l], |sum, (b, n)| add(&sum, &scale(*b, &n[l])));
        (0..self.own.len()).map(moved).collect()
    }

    /// Length of the motion.
    fn length(&self, by: &[f64]) -> f64 {
        self.after(by).iter().map(|v| norm(v).powi(2)).sum::<f64>().sqrt()
    }
}

/// The vectors of a path less its place.
fn moving_part<const D: usize>(form: &Form, vectors: &[Vector<D>]) -> Vec<Vector<D>> {
    if let Form::Spline { .. } = form {
        let n = vectors.len() as f64;
        let mean = vectors.iter().fold([0.0; D], |sum, p| add(&sum, &scale(1.0 / n, p)));
        return vectors.iter().map(|p| sub(p, &mean)).collect();
    }
    vectors[1..].to_vec()
}

fn starts_of(forms: &[Option<&Form>]) -> Vec<usize> {
    let mut starts = vec![0];
    for form in forms {
        starts.push(starts[starts.len() - 1] + form.map_or(1, Form::len));
    }
    starts
}

/// How far to go along each freedom, so that the lengths of all motions add up to least.
fn least_motion<const D: usize>(motions: &[Motion<D>], n: usize) -> Vec<f64> {
    let mut by = vec![0.0; n];
    let mut short = motions.iter().map(|m| m.length(&by)).fold(0.0, f64::max);
    for _ in 0..ROUNDS {
        let (mut system, mut right) = (vec![vec![0.0; n]; n], vec![0.0; n]);
        for motion in motions {
            let weight = 1.0 / motion.length(&by).max(short).max(f64::MIN_POSITIVE);
            for a in 0..n {
                let pull = |other: &[Vector<D>]| -> f64 {
                    motion.follow[a].iter().flatten().zip(other.iter().flatten()).map(|(x, y)| x * y).sum()
                };
                right[a] -= weight * pull(&motion.own);
                for (b, entry) in system[a].iter_mut().enumerate() {
                    *entry += weight * pull(&motion.follow[b]);
                }
            }
        }
        let Ok((sizes, axes)) = symmetric_eigen_of(&system) else { break };
        let largest = sizes.last().copied().unwrap_or(0.0);
        // what moves no body is of no account here
        let told = sizes.iter().zip(&axes).filter(|(size, _)| **size > 1e-12 * largest);
        let mut next = vec![0.0; n];
        for (size, axis) in told {
            let along: f64 = axis.iter().zip(&right).map(|(a, b)| a * b).sum::<f64>() / size;
            next.iter_mut().zip(axis).for_each(|(x, a)| *x += along * a);
        }
        by = next;
        short *= FALLS;
    }
    by
}
