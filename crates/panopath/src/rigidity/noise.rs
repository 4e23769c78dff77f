//! The accuracy of a bearing that a verdict is for.

use super::options::CertifyOptions;
use crate::bundle::noise::median;
use crate::structure::Structure;
use crate::tracks::Tracks;

/// Where it comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SigmaSource {
    /// The caller.
    Given,
    /// The tracks.
    Tracks,
    /// What the fit left over: the largest that would leave so little in one case of twenty.
    Residuals,
    /// Nothing: the fit left nothing over. Then 0.1 degrees.
    Assumed,
}

impl SigmaSource {
    /// The name used in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Tracks => "tracks",
            Self::Residuals => "residuals",
            Self::Assumed => "assumed",
        }
    }
}

/// Where nothing tells.
const ASSUMED_RAD: f64 = 0.1 * std::f64::consts::PI / 180.0;

pub(super) struct Noise {
    pub sigma_rad: f64,
    pub source: SigmaSource,
    /// Rms residual in one tangent direction; infinite where there is none.
    pub residual_rad: f64,
}

impl Noise {
    pub fn of<const D: usize>(
        tracks: &Tracks<D>,
        scene: &Structure<D>,
        counts: &[bool],
        options: &CertifyOptions,
        turns: usize,
    ) -> Self {
        let used = |o: &usize| counts[*o] && scene.residual_rad.get(*o).is_some_and(|r| r.is_finite());
        let squares: Vec<f64> = (0..tracks.len()).filter(used).map(|o| scene.residual_rad[o].powi(2)).collect();
        let (sum, n) = (squares.iter().sum::<f64>(), squares.len());
        let residual_rad = if n > 0 { (sum / (n * (D - 1)) as f64).sqrt() } else { f64::INFINITY };
        let (sigma_rad, source) = if let Some(sigma) = options.sigma_rad {
            (sigma, SigmaSource::Given)
        } else if let Some(sigma) = tracks.sigma_rad() {
            (median(&mut sigma.to_vec()), SigmaSource::Tracks)
        } else {
            let members = |of: &[u32], n: usize| {
                let mut is_told = vec![false; n];
                (0..of.len()).filter(|&o| counts[o]).for_each(|o| is_told[of[o] as usize] = true);
                is_told.iter().filter(|told| **told).count()
            };
            let views = members(tracks.view(), tracks.n_views());
            let points = members(tracks.track(), tracks.n_tracks());
            let parts: std::collections::BTreeSet<i32> = (0..tracks.len())
                .filter(|&o| counts[o])
                .map(|o| scene.view_component[tracks.view()[o] as usize])
                .collect();
            // each part has a gauge of its own: shifts, scale and the turns that all views share
            let unknowns = (D + turns) * views + D * points;
            let freedom = ((D - 1) * n + (D + 1 + turns) * parts.len()) as f64 - unknowns as f64;
            if freedom >= 1.0 && residual_rad.is_finite() {
                ((sum / low_quantile(freedom)).sqrt(), SigmaSource::Residuals)
            } else {
                (ASSUMED_RAD, SigmaSource::Assumed)
            }
        };
        Self { sigma_rad: sigma_rad.max(f64::MIN_POSITIVE.sqrt()), source, residual_rad }
    }
}

/// What a sum of squares of so many standard normal numbers exceeds in 19 cases of 20 (Wilson & Hilferty, 1931).
fn low_quantile(freedom: f64) -> f64 {
    let share = 2.0 / (9.0 * freedom);
    freedom * (1.0 - share - 1.645 * share.sqrt()).max(0.02).powi(3)
}
