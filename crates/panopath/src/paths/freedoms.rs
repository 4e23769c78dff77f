//! What the bearings of bodies that move leave free: the certificate of moving models.
//!
//! A path is `x_j(t) = sum_l B_jl(t) p_jl`, a segment `u_ij = x_j(t_i) - c_i`. A displacement `(dc, dp)` keeps all bearings if
//! and only if
//!
//! `P_u (sum_l B_jl(t_i) dp_jl - dc_i) = 0` for each observation, `P_u = I - u u^T / |u|^2`.
//!
//! These equations are linear in the scene as well, so that moving along a null vector by any length is exact, until a
//! body comes behind a camera. Of the null vectors, `d + 1` are the gauge: shifts and scale. Others are found, counted and
//! named: motions that everything shares, a scale that changes with time, tracks that no camera held in place would tie
//! down (the camera imitates them, they hide behind another, too little was seen), sets that hang loose.
//!
//! Known: the orientations. The certificate of points at rest is [`crate::rigidity`].

mod eliminate;
mod families;
mod naming;
mod part;
mod reach;
mod system;

use super::Form;
use crate::geometry::Vector;
use crate::least_squares::LeastSquaresError;
use part::Part;
use system::System;

pub use reach::{Reach, TrackReach};

/// A scene whose points may move, and the observations that count, flat.
#[derive(Debug, Clone, Copy)]
pub struct MovingScene<'a, const D: usize> {
    /// View of each observation that counts.
    pub view: &'a [u32],
    /// Its track.
    pub track: &'a [u32],
    /// Its angular standard deviation; empty: that of the options, for all.
    pub sigma_rad: &'a [f64],
    /// Centres of all views. Observations of views or tracks whose place is NaN are passed over.
    pub centers: &'a [Vector<D>],
    /// Times of all views.
    pub time_s: &'a [f64],
    /// Forms of all tracks, every number filled in.
    pub forms: &'a [Form],
    /// Vectors `p_jl` of all tracks, one track after another.
    pub coefficients: &'a [Vector<D>],
}

/// Choices of [`freedoms_of_paths`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreedomOptions {
    /// Angular standard deviation of observations that carry none; 0: only what is free exactly is told.
    pub sigma_rad: f64,
    /// Angle of turning rays, over the relative movement of a mode, below which it is null.
    pub null_below: f64,
    /// A track is refused where one standard deviation moves it by more than this share of its distance.
    pub refuse_movement: f64,
    /// Null vectors that are given for each freedom, at most; all are counted.
    pub most_vectors: usize,
}

impl Default for FreedomOptions {
    fn default() -> Self {
        Self { sigma_rad: 0.0, null_below: 1e-7, refuse_movement: 0.5, most_vectors: 24 }
    }
}

/// Why something is free.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FreedomKind {
    /// Parts that no observation ties to each other: each has a gauge of its own.
    Disconnected,
    /// Everything may share a motion: a power of time, a harmonic, or a spline.
    CommonMotion,
    /// Every position may be multiplied by a function of time about a point, which may move: `lambda(t)`.
    ScaleInTime,
    /// The camera moves in the form of these tracks: each may be drawn towards it, `C + s (P - C)`.
    Imitated,
    /// These tracks are in one direction with another one, whenever they are seen.
    Hidden,
    /// All views of these points at rest lie on one line with them.
    InLine,
    /// Fewer observations, or times, than the path has unknowns.
    TooFew,
    /// These tracks have other paths too, for a reason without a name.
    LooseTrack,
    /// All that these views see is on one line with them.
    LooseView,
    /// These views and tracks move against the others, which may stand still.
    LooseSet,
}

impl FreedomKind {
    /// Name in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Disconnected => "disconnected",
            Self::CommonMotion => "common_motion",
            Self::ScaleInTime => "scale_in_time",
            Self::Imitated => "imitated",
            Self::Hidden => "hidden",
            Self::InLine => "in_line",
            Self::TooFew => "too_few",
            Self::LooseTrack => "loose_track",
            Self::LooseView => "loose_view",
            Self::LooseSet => "loose_set",
        }
    }
}

/// The function of time along which a common motion, or a scale, may change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TimeFunction {
    /// None in particular.
    Any,
    /// This power of time, and lower ones.
    Power(usize),
    /// This harmonic of an angular frequency.
    Harmonic(usize, f64),
    /// A spline over the breaks of this track.
    SplineOf(u32),
}

/// Something that is free beyond shifts and scale.
#[derive(Debug, Clone)]
pub struct Freedom<const D: usize> {
    /// Why.
    pub kind: FreedomKind,
    /// How it changes with time.
    pub function: TimeFunction,
    /// How many null vectors it adds to the gauge and to what stands before it in the list.
    pub dimension: usize,
    /// Free exactly, rather than as far as noise tells.
    pub is_exact: bool,
    /// The connected part it belongs to, largest first; -1: all of them.
    pub part: i32,
    /// Views that it is about, ascending; none: all of the part.
    pub views: Vec<u32>,
    /// Tracks that it is about, ascending; none: all of the part.
    pub tracks: Vec<u32>,
    /// Null vectors; of single tracks they are in [`TrackReach::null`] instead.
    pub vectors: Vec<NullVector<D>>,
}

/// A displacement of the scene that keeps the bearings, its rms movement over all ends of rays one length of the scene.
#[derive(Debug, Clone)]
pub struct NullVector<const D: usize> {
    /// Of all views; zero beyond the part.
    pub centers: Vec<Vector<D>>,
    /// Of all coefficients; zero beyond the part.
    pub coefficients: Vec<Vector<D>>,
    /// Relative stretch of the segments of each view, in the mean: `lambda(t_i)`; NaN beyond the part.
    pub stretch: Vec<f64>,
    /// Angle by which rays turn, over the relative movement.
    pub value: f64,
    /// What one standard deviation of noise makes of it, as a share of the typical distance; infinite where it is exact.
    pub movement: f64,
}

/// What is free in a scene whose points may move.
#[derive(Debug, Clone)]
pub struct PathCertificate<const D: usize> {
    /// Dimension of the null space, gauge included, over all views and tracks that have observations.
    pub nullity: usize,
    /// Shifts and scale: `d + 1`.
    pub gauge_freedoms: usize,
    /// What is free beyond the gauge. Dimensions of the exact ones add up to `nullity - gauge_freedoms`.
    pub freedoms: Vec<Freedom<D>>,
    /// One for each track.
    pub tracks: Vec<TrackReach<D>>,
    /// Largest value of a null vector, and smallest of another (of those that were looked at).
    pub gap: (f64, f64),
    /// How far one standard deviation moves the weakest of the modes that are not null, as a share of the typical distance.
    pub weakest_movement: f64,
    /// Numbers of equations and unknowns.
    pub equations: usize,
    /// See above.
    pub unknowns: usize,
}

/// Why a scene cannot be looked at.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FreedomError {
    /// Arrays of different lengths.
    #[error("{name} has {found} entries, expected {expected}")]
    Length {
        /// Which array.
        name: &'static str,
        /// Its length.
        found: usize,
        /// What it should be.
        expected: usize,
    },
    /// An index beyond the number of views or tracks.
    #[error("{name}[{observation}] is {found}, expected an index below {limit}")]
    Index {
        /// `view` or `track`.
        name: &'static str,
        /// Which observation.
        observation: usize,
        /// The index found.
        found: u32,
        /// The number of views or tracks.
        limit: usize,
    },
    /// A form whose numbers are not filled in.
    #[error("the path of track {track} has numbers that are not filled in")]
    NotFilled {
        /// The track.
        track: usize,
    },
    /// An option that cannot be used.
    #[error("{name} is {found}, expected a finite number that is not negative")]
    Option {
        /// Its name.
        name: &'static str,
        /// Its value.
        found: f64,
    },
    /// A standard deviation that is not positive and finite.
    #[error("sigma_rad[{observation}] is {found}, expected a positive finite number")]
    Sigma {
        /// Which observation.
        observation: usize,
        /// Its value.
        found: f64,
    },
    /// A system that was too large.
    #[error(transparent)]
    LeastSquares(#[from] LeastSquaresError),
}

/// Finds, counts and names what the observations of a scene leave free.
///
/// The scene is an estimate or the truth: segments are taken from its positions, so that the answer is that of the model,
/// linear and exact, whatever the residuals.
///
/// # Errors
/// [`FreedomError`] naming what cannot be used.
pub fn freedoms_of_paths<const D: usize>(
    scene: &MovingScene<'_, D>,
    options: &FreedomOptions,
) -> Result<PathCertificate<D>, FreedomError> {
    check(scene, options)?;
    let starts = coefficient_starts(scene.forms);
    let parts = Part::all(scene, &starts, options.sigma_rad);
    let mut found = PathCertificate {
        nullity: 0,
        gauge_freedoms: D + 1,
        freedoms: Vec::new(),
        tracks: reach::unseen(scene),
        gap: (0.0, f64::INFINITY),
        weakest_movement: 0.0,
        equations: parts.iter().map(|part| (D - 1) * part.n_observations()).sum(),
        unknowns: parts.iter().map(|part| part.unknowns()).sum(),
    };
    if parts.len() > 1 {
        found.freedoms.push(Freedom {
            kind: FreedomKind::Disconnected,
            function: TimeFunction::Any,
            dimension: (parts.len() - 1) * (D + 1),
            is_exact: true,
            part: -1,
            views: Vec::new(),
            tracks: Vec::new(),
            vectors: Vec::new(),
        });
    }
    for (number, part) in parts.iter().enumerate() {
        let system = System::new(part, options.null_below);
        let spectrum = system.spectrum(options.null_below)?;
        found.nullity += spectrum.nullity;
        found.gap.0 = found.gap.0.max(spectrum.last_null);
        found.gap.1 = found.gap.1.min(spectrum.first_other);
        for reach in reach::of_part(&system, scene, &starts, options) {
            let id = reach.0 as usize;
            found.tracks[id] = reach.1;
        }
        let named = naming::freedoms(&system, &spectrum, scene, &starts, &found.tracks, number, options)?;
        found.weakest_movement = found.weakest_movement.max(named.weakest_movement);
        found.freedoms.extend(named.freedoms);
    }
    Ok(found)
}

/// Where the coefficients of each track begin, and their number.
fn coefficient_starts(forms: &[Form]) -> Vec<usize> {
    let mut starts = vec![0];
    for form in forms {
        starts.push(starts[starts.len() - 1] + form.len());
    }
    starts
}

fn check<const D: usize>(scene: &MovingScene<'_, D>, options: &FreedomOptions) -> Result<(), FreedomError> {
    let n = scene.view.len();
    let sigmas = if scene.sigma_rad.is_empty() { n } else { scene.sigma_rad.len() };
    let coefficients = scene.forms.iter().map(Form::len).sum();
    for (name, found, expected) in [
        ("track", scene.track.len(), n),
        ("sigma_rad", sigmas, n),
        ("time_s", scene.time_s.len(), scene.centers.len()),
        ("coefficients", scene.coefficients.len(), coefficients),
    ] {
        if found != expected {
            return Err(FreedomError::Length { name, found, expected });
        }
    }
    for (name, ids, limit) in [("view", scene.view, scene.centers.len()), ("track", scene.track, scene.forms.len())] {
        if let Some(observation) = ids.iter().position(|&id| id as usize >= limit) {
            return Err(FreedomError::Index { name, observation, found: ids[observation], limit });
        }
    }
    if let Some(observation) = scene.sigma_rad.iter().position(|s| !(s.is_finite() && *s > 0.0)) {
        return Err(FreedomError::Sigma { observation, found: scene.sigma_rad[observation] });
    }
    for (name, found) in [
        ("sigma_rad", options.sigma_rad),
        ("null_below", options.null_below),
        ("refuse_movement", options.refuse_movement),
    ] {
        if !(found.is_finite() && found >= 0.0) {
            return Err(FreedomError::Option { name, found });
        }
    }
    // a path that was not found is seen by nobody
    let mut is_seen = vec![false; scene.forms.len()];
    scene.track.iter().for_each(|&t| is_seen[t as usize] = true);
    if let Some(track) = (0..is_seen.len()).find(|&t| is_seen[t] && !is_filled(&scene.forms[t])) {
        return Err(FreedomError::NotFilled { track });
    }
    Ok(())
}

fn is_filled(form: &Form) -> bool {
    match form {
        Form::Static => true,
        Form::Taylor { origin_s, unit_s, .. } => origin_s.is_finite() && unit_s.is_finite() && *unit_s > 0.0,
        Form::Fourier { omega_rad_s, .. } => omega_rad_s.is_finite(),
        Form::Spline { breaks_s, .. } => breaks_s.len() >= 2 && breaks_s.iter().all(|b| b.is_finite()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points around a camera that wanders; the first one at rest where `anchored`.
    fn wandering(anchored: bool, moves: bool) -> (Vec<Vector<2>>, Vec<f64>, Vec<Form>, Vec<Vector<2>>) {
        let time_s: Vec<f64> = (0..9).map(f64::from).collect();
        let centers = time_s.iter().map(|t| [0.3 * t + (1.7 * t).sin(), (0.9 * t).cos()]).collect();
        let line = Form::Taylor { order: 1, origin_s: 4.0, unit_s: 4.0 };
        let (mut forms, mut coefficients) = (Vec::new(), Vec::new());
        for j in 0..6 {
            let angle = f64::from(j);
            coefficients.push([1.0 + 5.0 * angle.cos(), 4.0 * angle.sin()]);
            if anchored && j == 0 {
                forms.push(Form::Static);
            } else {
                forms.push(line.clone());
                coefficients.push(if moves { [(2.0 * angle).sin(), 0.5 * angle.cos()] } else { [0.0; 2] });
            }
        }
        (centers, time_s, forms, coefficients)
    }

    fn found(anchored: bool, moves: bool) -> PathCertificate<2> {
        let (centers, time_s, forms, coefficients) = wandering(anchored, moves);
        let view: Vec<u32> = (0..54).map(|o| o % 9).collect();
        let track: Vec<u32> = (0..54).map(|o| o / 9).collect();
        let scene = MovingScene {
            view: &view,
            track: &track,
            sigma_rad: &[],
            centers: &centers,
            time_s: &time_s,
            forms: &forms,
            coefficients: &coefficients,
        };
        freedoms_of_paths(&scene, &FreedomOptions::default()).unwrap_or_else(|error| panic!("{error}"))
    }

    #[test]
    fn the_gauge_of_paths_is_larger_and_a_static_scene_has_a_scale_in_time() {
        for (anchored, moves, nullity) in [(true, true, 3), (true, false, 4), (false, true, 5), (false, false, 6)] {
            let found = found(anchored, moves);
            assert_eq!(found.nullity, nullity, "anchored {anchored}, moves {moves}: {:?}", found.freedoms);
            let named: usize = found.freedoms.iter().map(|freedom| freedom.dimension).sum();
            assert_eq!(named, nullity - 3);
            let scales = found.freedoms.iter().filter(|freedom| freedom.kind == FreedomKind::ScaleInTime);
            assert_eq!(scales.count(), usize::from(!moves));
        }
    }

    #[test]
    fn what_cannot_be_used_is_named() {
        let (centers, time_s, mut forms, coefficients) = wandering(true, true);
        let scene = |view: &'static [u32], forms: &[Form]| {
            let scene = MovingScene {
                view,
                track: &[2],
                sigma_rad: &[],
                centers: &centers,
                time_s: &time_s,
                forms,
                coefficients: &coefficients,
            };
            freedoms_of_paths(&scene, &FreedomOptions::default()).err()
        };
        let index = FreedomError::Index { name: "view", observation: 0, found: 9, limit: 9 };
        assert_eq!(scene(&[9], &forms), Some(index));
        assert_eq!(scene(&[], &forms), Some(FreedomError::Length { name: "track", found: 1, expected: 0 }));
        assert_eq!(scene(&[0], &forms), None);
        forms[2] = Form::Taylor { order: 1, origin_s: f64::NAN, unit_s: 1.0 };
        assert_eq!(scene(&[0], &forms), Some(FreedomError::NotFilled { track: 2 }));
    }
}
