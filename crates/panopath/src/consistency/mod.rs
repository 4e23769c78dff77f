//! Does a scene that a solver was content with look like a right one?
//!
//! A scene can be wrong though it converged: two places that look alike were taken for one, a run of views was turned, a
//! part was mirrored. It then still shows in what the solver rejected and in what is left of the residuals. With the ray
//! `v` of an observation (in the world), its prediction `u = (x - c) / |x - c|` and the tangent residual `e = B(u)^T v`
//! (`D - 1` numbers, [`tangent_basis`](crate::geometry::tangent_basis)), five things are looked at, all of them against
//! observations the scene says it uses (*accepted*):
//!
//! 1. *noise*: their rms, against a bound and against the `sigma_rad` of the tracks; how many lie far beyond the rest,
//!    how many point away from their point, and how many tracks were hardly used: they may show another scene;
//! 2. *ties*: do accepted observations tie every view to its component, and does it have all views it could have?
//! 3. *agreement* (`pairs`): of the tracks that two views share, how many fit both? Far fewer than elsewhere, and no
//!    stronger chain of pairs that joins the two: the scene is torn there, or folded;
//! 4. *tension* and 5. *strain* (`windows`): a few neighbouring views are adjusted by themselves, one linear step. Where
//!    nothing pulls at them, they gain no more than their freedoms take from noise.
//!
//! Shapes: `N` observations, `V` freedoms of a view (3 in the plane, 6 in space). Cost and memory are linear in `N`.
//! The scene may come from any solver: residuals are computed here.

use crate::geometry::{Rotation, Vector};
use crate::structure::Structure;
use crate::tracks::Tracks;

mod finding;
mod pairs;
mod rays;
mod windows;

pub use finding::Finding;

use rays::{Noise, Rays};

/// Limits of [`check_consistency`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConsistencyOptions {
    /// Largest noise that a camera is believed to have, radians in each tangent direction. Default: 5 degrees.
    pub max_noise_rad: f64,
    /// Largest noise as a multiple of the `sigma_rad` of the tracks, where they have any. Default: 1.5.
    pub max_noise_ratio: f64,
    /// Largest share of accepted observations beyond ten times the noise. Default: 0.05.
    pub max_misfit_share: f64,
    /// Largest share of tracks, of those seen five times or more, of which the scene uses less than a third. Default:
    /// 0.25.
    pub max_lost_share: f64,
    /// Largest share of accepted observations whose point lies behind them. Default: 0.001.
    pub max_behind_share: f64,
    /// Largest share of views without a position, though they see twenty points of the scene or more. Default: 0.05.
    pub max_unplaced_share: f64,
    /// Chance, over all pairs, below which a pair of views is believed to disagree. Default: 1e-4.
    pub pair_chance: f64,
    /// Largest noise in the scene as a multiple of the noise among ten neighbouring views, over what it grew from four
    /// to ten. Default: 1.08.
    pub max_tension: f64,
    /// Largest gain of four neighbouring views left to themselves, a freedom, in units of noise. Default: 6.
    pub max_near_strain: f64,
    /// The same of ten views. Default: 4.
    pub max_far_strain: f64,
}

impl Default for ConsistencyOptions {
    fn default() -> Self {
        Self {
            max_noise_rad: 5.0_f64.to_radians(),
            max_noise_ratio: 1.5,
            max_misfit_share: 0.05,
            max_lost_share: 0.25,
            max_behind_share: 0.001,
            max_unplaced_share: 0.05,
            pair_chance: 1e-4,
            max_tension: 1.08,
            max_near_strain: 6.0,
            max_far_strain: 4.0,
        }
    }
}

/// A figure with its limit; NaN where there is too little to measure it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Statistic {
    /// What is measured.
    pub name: &'static str,
    /// The worst of all components.
    pub value: f64,
    /// The most that passes.
    pub limit: f64,
}

/// What [`check_consistency`] answers.
#[derive(Debug, Clone, PartialEq)]
pub struct Consistency {
    /// What is wrong, in the order of the module's text; empty where the scene passes.
    pub findings: Vec<Finding>,
    /// Every figure that was measured.
    pub statistics: Vec<Statistic>,
}

impl Consistency {
    /// Is nothing wrong?
    pub fn passed(&self) -> bool {
        self.findings.is_empty()
    }
}

/// Why a scene cannot be checked.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConsistencyError {
    /// An array of the scene that does not go with the tracks.
    #[error("{name} has {found} entries, expected {expected}")]
    Length {
        /// Which array.
        name: &'static str,
        /// Its length.
        found: usize,
        /// The number of views, tracks or observations.
        expected: usize,
    },
    /// A limit that is no number above zero.
    #[error("{name} is {found}, expected a number above 0")]
    Limit {
        /// Which limit.
        name: &'static str,
        /// Its value.
        found: f64,
    },
}

/// Checks a scene against the tracks it was made from; `V` is 3 for `D = 2` and 6 for `D = 3`.
///
/// Views and points without a finite position, or outside every component, are left out, and observations between
/// components too. A scene without anything solved passes: it claims nothing.
///
/// # Errors
/// [`ConsistencyError`] naming the array or the limit that cannot be used.
pub fn check_consistency<const D: usize, const V: usize>(
    tracks: &Tracks<D>,
    scene: &Structure<D>,
    options: &ConsistencyOptions,
) -> Result<Consistency, ConsistencyError> {
    check_lengths(tracks, scene)?;
    check_limits(options)?;
    let rays = Rays::<D>::new(tracks, scene);
    let mut found = Consistency { findings: Vec::new(), statistics: Vec::new() };
    let noise = rays.noise::<V>();
    judge_noise(&rays, &noise, options, &mut found);
    judge_tracks(&rays, options, &mut found);
    judge_views(&rays, options, &mut found);
    judge_ties(&rays, &mut found);
    let ties = pairs::count(&rays, &rays.near_tracks(&noise));
    judge_agreement(&ties, options, &mut found);
    judge_windows::<D, V>(&rays, &noise, &ties, options, &mut found);
    Ok(found)
}

impl Consistency {
    /// Notes a figure, the largest of `values`.
    fn note(&mut self, name: &'static str, values: impl Iterator<Item = f64>, limit: f64) {
        let value = values.fold(f64::NAN, f64::max);
        self.statistics.push(Statistic { name, value, limit });
    }
}

fn judge_noise<const D: usize>(rays: &Rays<'_, D>, noise: &[Noise], o: &ConsistencyOptions, found: &mut Consistency) {
    found.note("noise_rad", noise.iter().map(|n| n.sigma_rad), o.max_noise_rad);
    if rays.has_sigma() {
        found.note("noise_over_given", noise.iter().map(|n| n.over_given), o.max_noise_ratio);
    }
    found.note("misfit_share", noise.iter().map(|n| n.misfit_share), o.max_misfit_share);
    found.note("behind_share", noise.iter().map(|n| n.behind_share), o.max_behind_share);
    for (component, n) in noise.iter().enumerate() {
        let part = rays.part_name(component);
        if n.sigma_rad > o.max_noise_rad {
            found.findings.push(Finding::Noise { part: part.clone(), sigma_rad: n.sigma_rad, limit: o.max_noise_rad });
        }
        if n.over_given > o.max_noise_ratio {
            found.findings.push(Finding::NoiseOverGiven { part: part.clone(), ratio: n.over_given });
        }
        if n.misfit_share > o.max_misfit_share {
            found.findings.push(Finding::Misfits { part: part.clone(), share: n.misfit_share });
        }
        if n.behind_share > o.max_behind_share {
            found.findings.push(Finding::Behind { part, share: n.behind_share, views: n.views_behind.clone() });
        }
    }
}

fn judge_tracks<const D: usize>(rays: &Rays<'_, D>, o: &ConsistencyOptions, found: &mut Consistency) {
    let (judged, lost) = rays.lost_tracks();
    let share = lost as f64 / judged as f64;
    found.note("lost_share", std::iter::once(share), o.max_lost_share);
    if share > o.max_lost_share {
        found.findings.push(Finding::Lost { lost, judged });
    }
}

fn judge_views<const D: usize>(rays: &Rays<'_, D>, o: &ConsistencyOptions, found: &mut Consistency) {
    let unplaced = rays.unplaced_views();
    let n_seeing = rays.n_seeing_views();
    let share = if n_seeing > 0 { unplaced.len() as f64 / n_seeing as f64 } else { f64::NAN };
    found.note("unplaced_share", std::iter::once(share), o.max_unplaced_share);
    if share > o.max_unplaced_share {
        found.findings.push(Finding::Unplaced { views: unplaced });
    }
}

fn judge_ties<const D: usize>(rays: &Rays<'_, D>, found: &mut Consistency) {
    let untied = rays.untied_views();
    let n_untied: usize = untied.iter().map(Vec::len).sum();
    found.note("untied_views", std::iter::once(n_untied as f64), 0.0);
    for (component, views) in untied.into_iter().enumerate().filter(|(_, views)| !views.is_empty()) {
        found.findings.push(Finding::Untied { part: rays.part_name(component), views });
    }
}

fn judge_agreement(ties: &pairs::Ties, o: &ConsistencyOptions, found: &mut Consistency) {
    let tears = pairs::tears(ties, o.pair_chance);
    found.note("torn_places", std::iter::once(tears.len() as f64), 0.0);
    found.findings.extend(tears);
}

fn judge_windows<const D: usize, const V: usize>(
    rays: &Rays<'_, D>,
    noise: &[Noise],
    ties: &pairs::Ties,
    o: &ConsistencyOptions,
    found: &mut Consistency,
) {
    let near = windows::adjust::<D, V>(rays, ties, windows::NEAR);
    let far = windows::adjust::<D, V>(rays, ties, windows::FAR);
    let tension = windows::tension(rays, noise, &near, &far);
    found.note("tension", tension.iter().map(|t| t.ratio()), o.max_tension);
    for (component, t) in tension.iter().enumerate().filter(|(_, t)| t.ratio() > o.max_tension) {
        let part = rays.part_name(component);
        found.findings.push(Finding::Tension { part, alone_rad: t.alone_rad, scene_rad: t.scene_rad });
    }
    for (name, of, limit) in [("near_strain", near, o.max_near_strain), ("far_strain", far, o.max_far_strain)] {
        found.note(name, of.iter().map(|w| w.strain()), limit);
        found.findings.extend(windows::strained(&of, limit));
    }
}

fn check_lengths<const D: usize>(tracks: &Tracks<D>, scene: &Structure<D>) -> Result<(), ConsistencyError> {
    let (n_views, n_tracks) = (tracks.n_views(), tracks.n_tracks());
    let wanted = [
        ("centers", scene.centers.len(), n_views),
        ("cam_from_world", scene.cam_from_world.len(), n_views),
        ("view_component", scene.view_component.len(), n_views),
        ("points", scene.points.len(), n_tracks),
        ("track_component", scene.track_component.len(), n_tracks),
        ("inlier", scene.inlier.len(), tracks.len()),
    ];
    match wanted.into_iter().find(|(_, found, expected)| found != expected) {
        Some((name, found, expected)) => Err(ConsistencyError::Length { name, found, expected }),
        None => Ok(()),
    }
}

fn check_limits(o: &ConsistencyOptions) -> Result<(), ConsistencyError> {
    let limits = [
        ("max_noise_rad", o.max_noise_rad),
        ("max_noise_ratio", o.max_noise_ratio),
        ("max_misfit_share", o.max_misfit_share),
        ("max_lost_share", o.max_lost_share),
        ("max_behind_share", o.max_behind_share),
        ("max_unplaced_share", o.max_unplaced_share),
        ("pair_chance", o.pair_chance),
        ("max_tension", o.max_tension),
        ("max_near_strain", o.max_near_strain),
        ("max_far_strain", o.max_far_strain),
    ];
    match limits.into_iter().find(|(_, value)| value.is_nan() || *value <= 0.0) {
        Some((name, found)) => Err(ConsistencyError::Limit { name, found }),
        None => Ok(()),
    }
}

/// Is every coordinate a number?
fn is_finite<const D: usize>(x: &Vector<D>) -> bool {
    x.iter().all(|c| c.is_finite())
}

/// Is every entry a number?
fn is_known<const D: usize>(rotation: &Rotation<D>) -> bool {
    rotation.matrix().iter().all(is_finite)
}
