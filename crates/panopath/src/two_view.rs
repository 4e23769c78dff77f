//! Relative orientation of two panoramas: the rotation between them and the direction from one to the other.
//!
//! A point seen along the unit vectors `b1` in the first camera and `b2` in the second satisfies
//!
//! `b2 . (s x R b1) = 0,   R = second_from_first,   s = R direction`,
//!
//! one equation a match in five unknowns: three of the rotation, two of the direction of the second centre as seen from
//! the first; the distance is not determined. The steps are
//!
//! 1. a consensus of rotations without a baseline, from pairs of matches;
//! 2. a consensus of poses from five matches each (`five_point`), from the best direction for the rotation of step 1 too;
//!    of the four poses of an essential matrix the one counts that has the points in front of both cameras, which on a
//!    full sphere replaces the image border as a test;
//! 3. descent from the best of them on the spherical Sampson error (`epipolar`), with the noise and the share of true
//!    matches estimated in turn, against false matches that agree by chance as often as wrong pairings of the same
//!    bearings do;
//! 4. tests whether that says something: is there a consensus beyond chance, a baseline beyond the noise, more than one
//!    plane (`degenerate`)?
//!
//! Bearings may point anywhere: nothing here knows of an image, its border or its centre.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::geometry::{Matrix, Rotation, Vector, cross, dot, norm, normalized, scale, sub};
use crate::tracks::UNIT_TOLERANCE;

mod degenerate;
mod epipolar;
mod five_point;
mod normal;
mod search;

use degenerate::{
    BASELINE_DEVIATIONS, PlanarPose, PlaneFit, RELIEF_DEVIATIONS, RotationFit, by_chance, fit_plane, fit_rotation,
    is_noise, judge_plane, ln_choose, n_before, other_pose,
};
use epipolar::{Fit, Fitting, Matches, Mixture, Pose, sighting};
use normal::{largest_deviation, lift};

/// Options of [`relative_pose`], [`relative_direction`] and [`relative_poses`].
#[derive(Debug, Clone, PartialEq)]
pub struct TwoViewOptions {
    /// Largest error of a match that may be true, in radians. Default: none; the search then takes 0.5 degrees, and what
    /// is true is judged by the noise that the matches turn out to have.
    pub max_error_rad: Option<f64>,
    /// Probability to draw a sample of true matches only, at the share of true ones found. Default: 0.999.
    pub confidence: f64,
    /// Samples drawn at most. Default: 1000.
    pub max_iterations: usize,
    /// Of the random numbers. Default: 0.
    pub seed: u64,
    /// Fewer distinct true matches than this are no answer. At least 6. Default: 8.
    pub min_inliers: usize,
}

impl Default for TwoViewOptions {
    fn default() -> Self {
        Self { max_error_rad: None, confidence: 0.999, max_iterations: 1000, seed: 0, min_inliers: 8 }
    }
}

/// What two views turned out to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TwoViewStatus {
    /// Rotation and direction are determined.
    General,
    /// No baseline that the noise would not hide: the rotation is good, there is no direction.
    PureRotation,
    /// All true matches agree with one plane. The pose is the best one with a plane; where a second pose explains as many
    /// matches it is given as the alternative.
    Planar,
    /// Too few matches, no consensus beyond chance, or matches that leave the pose open: nothing is given.
    Undetermined,
}

impl TwoViewStatus {
    /// The name in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::General => "general",
            Self::PureRotation => "pure_rotation",
            Self::Planar => "planar",
            Self::Undetermined => "undetermined",
        }
    }
}

/// Relative orientation of two views.
#[derive(Debug, Clone, PartialEq)]
pub struct TwoView {
    /// Takes bearings of the first camera to the second. The identity where undetermined.
    pub second_from_first: Rotation<3>,
    /// Unit vector from the first centre to the second, in the frame of the first camera. NaN where there is none.
    pub direction: Vector<3>,
    /// Which matches are true.
    pub inlier: Vec<bool>,
    /// Number of them.
    pub n_inliers: usize,
    /// What the views turned out to be.
    pub status: TwoViewStatus,
    /// Standard deviation of a bearing along each tangent direction, as the true matches show it; NaN where undetermined.
    pub sigma_rad: f64,
    /// Covariance of the rotation vector `phi` of `exp(phi) second_from_first`, direction unknown. NaN where undetermined.
    pub rotation_covariance: Matrix<3>,
    /// Covariance of the direction in the frame of the first camera, rotation unknown. NaN where there is none.
    pub direction_covariance: Matrix<3>,
    /// The second pose (`second_from_first`, `direction`) that a planar scene may leave.
    pub alternative: Option<(Rotation<3>, Vector<3>)>,
}

/// Why a relative pose could not be sought at all. What the matches do not determine is a status, not an error.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TwoViewError {
    /// Not one bearing in the second camera for each in the first.
    #[error("second has {found} rows, expected {expected}, one for each row of first")]
    Length {
        /// Rows of `second`.
        found: usize,
        /// Rows of `first`.
        expected: usize,
    },
    /// A bearing that is not finite or not of unit length.
    #[error("{name}[{row}] has length {length}, expected a finite unit vector")]
    NotUnit {
        /// `first` or `second`.
        name: &'static str,
        /// Which row.
        row: usize,
        /// Its length.
        length: f64,
    },
    /// Offsets that do not cut the matches into pairs.
    #[error("pair_start[{entry}] is {found}, expected {expected}")]
    PairStart {
        /// Which entry.
        entry: usize,
        /// The value found.
        found: usize,
        /// What it should be.
        expected: String,
    },
    /// Not one rotation for each pair.
    #[error("second_from_first has {found} rotations, expected one for each of the {expected} pairs")]
    Rotations {
        /// Number given.
        found: usize,
        /// Number of pairs.
        expected: usize,
    },
    /// An option out of its range.
    #[error("{0}")]
    Option(String),
}

/// Relative pose of two views from `first[k]` and `second[k]`, the bearings of match `k` in each camera's own frame.
///
/// # Errors
/// [`TwoViewError`] naming the argument that cannot be used.
///
/// ```
/// use panopath::geometry::{Rotation, dot, normalized, sub};
/// use panopath::two_view::{TwoViewOptions, TwoViewStatus, relative_pose};
///
/// let (turn, center) = (Rotation::exp(&[0.1, -2.0, 0.3]), [1.0, 0.5, 0.2]);
/// let points: Vec<[f64; 3]> = (1..40).map(f64::from).map(|k| [9.0 * k.sin(), 7.0 * (2.1 * k).cos(), 8.0 * (k * k).sin()]).collect();
/// let first: Vec<_> = points.iter().map(normalized).collect();
/// let second: Vec<_> = points.iter().map(|x| turn.apply(&normalized(&sub(x, &center)))).collect();
/// let found = relative_pose(&first, &second, &TwoViewOptions::default())?;
/// assert_eq!(found.status, TwoViewStatus::General);
/// assert!(dot(&found.direction, &normalized(&center)) > 1.0 - 1e-12);
/// # Ok::<(), panopath::two_view::TwoViewError>(())
/// ```
pub fn relative_pose(
    first: &[Vector<3>],
    second: &[Vector<3>],
    options: &TwoViewOptions,
) -> Result<TwoView, TwoViewError> {
    check_options(options)?;
    solve_pair(first, second, None, options, 0)
}

/// Direction between two views whose relative rotation is known: two unknowns, from samples of two matches.
///
/// # Errors
/// [`TwoViewError`] naming the argument that cannot be used.
pub fn relative_direction(
    first: &[Vector<3>],
    second: &[Vector<3>],
    second_from_first: &Rotation<3>,
    options: &TwoViewOptions,
) -> Result<TwoView, TwoViewError> {
    check_options(options)?;
    solve_pair(first, second, Some(second_from_first), options, 0)
}

/// Many pairs of views, in parallel: the matches of pair `p` are rows `pair_start[p]..pair_start[p + 1]` of `first` and
/// `second`. With `second_from_first`, one for each pair, the rotations are taken as known.
///
/// Random numbers are drawn from a stream of their own for each pair, so that an answer depends neither on the threads nor
/// on the pairs after it.
///
/// # Errors
/// [`TwoViewError`] naming the argument that cannot be used; rows are counted over all pairs.
pub fn relative_poses(
    pair_start: &[usize],
    first: &[Vector<3>],
    second: &[Vector<3>],
    second_from_first: Option<&[Rotation<3>]>,
    options: &TwoViewOptions,
) -> Result<Vec<TwoView>, TwoViewError> {
    check_options(options)?;
    check_pairs(pair_start, first, second, second_from_first)?;
    let pairs = pair_start.len().saturating_sub(1);
    let solve = |p: usize| {
        let rows = pair_start[p]..pair_start[p + 1];
        let known = second_from_first.map(|rotations| &rotations[p]);
        solve_pair(&first[rows.clone()], &second[rows.clone()], known, options, p as u64).map_err(|error| match error {
            TwoViewError::NotUnit { name, row, length } => {
                TwoViewError::NotUnit { name, row: row + rows.start, length }
            }
            other => other,
        })
    };
    (0..pairs).into_par_iter().map(solve).collect::<Vec<_>>().into_iter().collect()
}

fn check_options(options: &TwoViewOptions) -> Result<(), TwoViewError> {
    let wrong = |text: String| Err(TwoViewError::Option(text));
    if let Some(error) = options.max_error_rad
        && !(error > 0.0 && error < std::f64::consts::FRAC_PI_2)
    {
        return wrong(format!("max_error_rad is {error}, expected a positive angle below pi/2"));
    }
    if !(options.confidence > 0.0 && options.confidence < 1.0) {
        return wrong(format!("confidence is {}, expected a number between 0 and 1", options.confidence));
    }
    if options.max_iterations == 0 {
        return wrong("max_iterations is 0, expected at least 1".to_owned());
    }
    if options.min_inliers < 6 {
        return wrong(format!("min_inliers is {}, expected at least 6", options.min_inliers));
    }
    Ok(())
}

fn check_pairs(
    pair_start: &[usize],
    first: &[Vector<3>],
    second: &[Vector<3>],
    second_from_first: Option<&[Rotation<3>]>,
) -> Result<(), TwoViewError> {
    if first.len() != second.len() {
        return Err(TwoViewError::Length { found: second.len(), expected: first.len() });
    }
    let wrong = |entry: usize, expected: String| {
        Err(TwoViewError::PairStart { entry, found: pair_start.get(entry).copied().unwrap_or_default(), expected })
    };
    if pair_start.first() != Some(&0) {
        return wrong(0, "0".to_owned());
    }
    if let Some(entry) = (1..pair_start.len()).find(|&p| pair_start[p] < pair_start[p - 1]) {
        return wrong(entry, format!("{} or more", pair_start[entry - 1]));
    }
    if pair_start.last() != Some(&first.len()) {
        return wrong(pair_start.len() - 1, format!("{}, the number of rows", first.len()));
    }
    match second_from_first {
        Some(rotations) if rotations.len() + 1 != pair_start.len() => {
            Err(TwoViewError::Rotations { found: rotations.len(), expected: pair_start.len() - 1 })
        }
        _ => Ok(()),
    }
}

fn unit(name: &'static str, rows: &[Vector<3>]) -> Result<Vec<Vector<3>>, TwoViewError> {
    let checked = rows.iter().enumerate().map(|(row, b)| {
        let length = dot(b, b).sqrt();
        // a NaN is not within any tolerance
        if (length - 1.0).abs() <= UNIT_TOLERANCE {
            Ok(scale(1.0 / length, b))
        } else {
            Err(TwoViewError::NotUnit { name, row, length })
        }
    });
    checked.collect()
}

fn solve_pair(
    first: &[Vector<3>],
    second: &[Vector<3>],
    known: Option<&Rotation<3>>,
    options: &TwoViewOptions,
    stream: u64,
) -> Result<TwoView, TwoViewError> {
    if first.len() != second.len() {
        return Err(TwoViewError::Length { found: second.len(), expected: first.len() });
    }
    let matches = Matches::new(unit("first", first)?, unit("second", second)?);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(stream);
    let pair = Pair { matches: &matches, known, options };
    Ok(pair.solve(&mut rng))
}

/// Error that the search allows where the caller names none: five times a good panorama's noise.
const SEARCH_ERROR_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;
/// The largest error of a true match where the caller names none, in units of [`SEARCH_ERROR_RAD`].
const WIDEST: f64 = 4.0;
/// Odds of a match without error to be true, before anything is known of noise and share: half of them true, and the noise
/// a third of what the search allows.
const SEARCH_ODDS: f64 = 500.0;
/// Parallax that a scene is taken to have before anything is known.
const WIDE_PARALLAX: f64 = 0.2;
/// Noise below this is rounding: two hundredths of an arc second.
const LEAST_SIGMA_RAD: f64 = 1e-7;
/// Agreement that would come about by chance more often than this is no consensus.
const LARGEST_CHANCE: f64 = 0.01;
/// A rotation or direction less certain than this says nothing.
const LARGEST_DEVIATION_RAD: f64 = 0.5;

/// A pose with a baseline, before it is known whether there is one.
struct General {
    fit: Fit,
    mixture: Mixture,
    inlier: Vec<bool>,
}

impl General {
    /// Probability that a false match looks true.
    fn chance(&self) -> f64 {
        (self.mixture.gate() * self.mixture.chance_density).clamp(1e-6, 0.9)
    }
}

/// One pair of views on its way to an answer.
struct Pair<'a> {
    matches: &'a Matches,
    known: Option<&'a Rotation<3>>,
    options: &'a TwoViewOptions,
}

impl Pair<'_> {
    fn solve(&self, rng: &mut ChaCha8Rng) -> TwoView {
        if self.matches.len() < self.options.min_inliers {
            return self.undetermined();
        }
        let rotation = self.rotation(rng);
        let alone = rotation.as_ref().filter(|fit| self.stands_alone(fit));
        // a known rotation need not explain anything by itself
        let proposed = if self.known.is_some() { rotation.as_ref() } else { alone };
        match (self.general(rng, proposed), alone) {
            (Some(fit), Some(rotation)) if self.has_no_baseline(&fit, rotation) => self.pure_rotation(rotation),
            (Some(fit), _) => self.with_baseline(&fit),
            (None, Some(rotation)) => self.pure_rotation(rotation),
            (None, None) => self.undetermined(),
        }
    }

    fn search_error(&self) -> f64 {
        self.options.max_error_rad.unwrap_or(SEARCH_ERROR_RAD)
    }

    fn search(&self) -> search::Search<'_> {
        search::Search {
            arch: pulp::Arch::new(),
            fitting: Fitting { limit: 2.0 * self.search_error(), ..self.fitting() },
            odds: vec![SEARCH_ODDS; self.matches.len()],
            limit: self.search_error(),
            confidence: self.options.confidence,
            max_iterations: self.options.max_iterations,
        }
    }

    fn fitting(&self) -> Fitting<'_> {
        Fitting {
            matches: self.matches,
            limit: self.options.max_error_rad.unwrap_or(WIDEST * SEARCH_ERROR_RAD),
            free_rotation: self.known.is_none(),
            least_sigma: LEAST_SIGMA_RAD,
        }
    }

    /// The rotation that explains most matches without a baseline, or the one that is known.
    fn rotation(&self, rng: &mut ChaCha8Rng) -> Option<RotationFit> {
        let start = match self.known {
            Some(rotation) => *rotation,
            None => self.search().rotation(rng)?,
        };
        let sigma = self.search_error() / 3.0;
        Some(fit_rotation(self.matches, &start, self.known.is_some(), sigma, (LEAST_SIGMA_RAD, sigma)))
    }

    /// Whether a rotation explains more matches than chance does, and these fix it.
    fn stands_alone(&self, fit: &RotationFit) -> bool {
        let chance = self.chance(|a, b| fit.explains(a, b));
        let fixed_by = if self.known.is_some() { 0 } else { 2 };
        let certain =
            || fit.normal.inverse().is_some_and(|c| fit.sigma * largest_deviation(&c) < LARGEST_DEVIATION_RAD);
        self.is_consensus(&fit.explained, fixed_by, chance) && (self.known.is_some() || certain())
    }

    /// The pose that explains most matches, if it explains more than chance does and they fix it.
    fn general(&self, rng: &mut ChaCha8Rng, rotation: Option<&RotationFit>) -> Option<General> {
        let search = self.search();
        let search::Candidate { pose, limit, .. } = match self.known {
            Some(_) => search.direction(rng, rotation?)?,
            None => search.pose(rng, rotation)?,
        };
        let wide = 3.0 * self.search_error();
        let chance = self.chance(|a, b| {
            let seen = sighting(&pose, a, b, wide);
            seen.in_front && seen.error.abs() < wide
        });
        let first_guess = Mixture {
            sigma: limit / 3.0,
            share: 0.5,
            chance_density: chance / wide,
            parallax: WIDE_PARALLAX,
            chance_parallax: self.chance_parallax(&pose),
        };
        let (fit, mixture) = self.fitting().settle(&pose, &first_guess, 12);
        let fixed_by = if self.known.is_some() { 2 } else { 5 };
        let inlier: Vec<bool> = fit.weight.iter().map(|w| *w > 0.5).collect();
        let certain = self.covariances(&fit, mixture.sigma).is_some();
        let found = General { fit, inlier, mixture };
        (certain && self.is_consensus(&found.inlier, fixed_by, found.chance())).then_some(found)
    }

    /// How often wrong matches agree: measured on this input, its bearings paired wrongly on purpose.
    fn chance(&self, agrees: impl Fn(&Vector<3>, &Vector<3>) -> bool) -> f64 {
        let (mut count, mut all) = (0, 0);
        for (a, b) in self.wrong_pairings() {
            all += 1;
            count += usize::from(agrees(a, b));
        }
        (count as f64 + 0.5) / (all as f64 + 1.0)
    }

    /// Twice the mean parallax of wrong pairings: the largest, if all up to it are as frequent.
    fn chance_parallax(&self, pose: &Pose) -> f64 {
        let (mut sum, mut all) = (0.0, 0.0);
        for (a, b) in self.wrong_pairings() {
            sum += norm(&sub(&pose.second_from_first.apply(a), b));
            all += 1.0;
        }
        (2.0 * sum / all).max(LEAST_SIGMA_RAD)
    }

    fn wrong_pairings(&self) -> impl Iterator<Item = (&Vector<3>, &Vector<3>)> {
        let n = self.matches.len();
        let shifts = PAIRINGS.div_ceil(n).min(n - 1);
        (0..shifts).map(move |k| 1 + k * (n - 1) / shifts).flat_map(move |shift| {
            let second = self.matches.second[shift..].iter().chain(&self.matches.second[..shift]);
            self.matches.first.iter().zip(second)
        })
    }

    /// Whether so many distinct matches agree that false ones would do so less than [`LARGEST_CHANCE`] times in all samples
    /// of `fixed_by` matches (Moisan and Stival 2004).
    fn is_consensus(&self, inlier: &[bool], fixed_by: usize, chance: f64) -> bool {
        let k = self.n_distinct(inlier);
        let n = self.matches.len() - (count(inlier) - k);
        if k < self.options.min_inliers {
            return false;
        }
        let solutions = if fixed_by == 5 { 10.0f64.ln() } else { 0.0 };
        let agreeing = ln_choose(n - fixed_by, k - fixed_by) + (k - fixed_by) as f64 * chance.ln();
        solutions + ln_choose(n, fixed_by) + agreeing < LARGEST_CHANCE.ln()
    }

    /// Matches that are the same to the last digit are one.
    fn n_distinct(&self, inlier: &[bool]) -> usize {
        let key = |i: usize| (self.matches.first[i].map(f64::to_bits), self.matches.second[i].map(f64::to_bits));
        let mut keys: Vec<_> = (0..inlier.len()).filter(|&i| inlier[i]).map(key).collect();
        keys.sort_unstable();
        keys.dedup();
        keys.len()
    }

    /// Is a rotation alone as good as the noise lets it be?
    fn has_no_baseline(&self, found: &General, rotation: &RotationFit) -> bool {
        let both: Vec<bool> = found.inlier.iter().zip(&rotation.explained).map(|(a, b)| *a && *b).collect();
        let extra = count(&found.inlier) - count(&both);
        if extra > by_chance(self.matches.len() - rotation.n_explained, found.chance()) {
            return false;
        }
        let matches = self.matches.first.iter().zip(&self.matches.second);
        let two: f64 =
            matches.zip(&both).filter(|(_, k)| **k).map(|((a, b), _)| 0.5 * rotation.squared_chord(a, b)).sum();
        let (n, fixed_by) = (count(&both) as f64, if self.known.is_some() { 2.0 } else { 5.0 });
        n > fixed_by
            && is_noise(
                two - self.squares(found, &both),
                n + 2.0,
                found.mixture.sigma,
                n - fixed_by,
                BASELINE_DEVIATIONS,
            )
    }

    /// Sum of the squared errors of some matches.
    fn squares(&self, found: &General, of: &[bool]) -> f64 {
        let matches = self.matches.first.iter().zip(&self.matches.second).zip(of);
        matches.filter(|(_, k)| **k).map(|((a, b), _)| sighting(&found.fit.pose, a, b, 0.0).error.powi(2)).sum()
    }

    /// The answer where there is a baseline: general, or planar where one plane explains everything.
    fn with_baseline(&self, found: &General) -> TwoView {
        if self.known.is_none()
            && let Some(plane) = self.plane(found)
            && let Some(view) = self.planar(found, &plane)
        {
            return view;
        }
        match self.covariances(&found.fit, found.mixture.sigma) {
            Some(covariance) => view(&found.fit.pose, TwoViewStatus::General, found, covariance),
            None => self.undetermined(),
        }
    }

    /// The plane that the true matches agree with, if they do.
    fn plane(&self, found: &General) -> Option<PlaneFit> {
        let sigma = found.mixture.sigma;
        let plane = fit_plane(self.matches, &found.inlier, &found.fit.pose, sigma)?;
        if count(&found.inlier) - plane.n_explained > by_chance(self.matches.len() - plane.n_explained, found.chance())
        {
            return None;
        }
        let more = plane.squares - self.squares(found, &plane.explained);
        let n = plane.n_explained as f64;
        (n > 8.0 && is_noise(more, n - 3.0, sigma, n - 5.0, RELIEF_DEVIATIONS)).then_some(plane)
    }

    /// The better of the two poses that a plane allows; the other is kept where it has as many points in front.
    fn planar(&self, found: &General, plane: &PlaneFit) -> Option<TwoView> {
        let mut chosen = plane.planar;
        let ahead = |planar: &PlanarPose| n_before(self.matches, plane, planar);
        let mut alternative = other_pose(&chosen).map(|other| {
            let mirrored = other.mirrored();
            if ahead(&mirrored) > ahead(&other) { mirrored } else { other }
        });
        if let Some(other) = alternative {
            let (one, two) = (ahead(&chosen), ahead(&other));
            if two > one {
                alternative = Some(std::mem::replace(&mut chosen, other));
            }
            // noise may put a few far points behind, a wrong pose puts many there
            if (one.abs_diff(two) as f64) > 2.0 + 0.05 * plane.n_explained as f64 {
                alternative = None;
            }
        }
        let sigma = found.mixture.sigma;
        let at = judge_plane(self.matches, &plane.explained, &chosen, sigma);
        let inverse = at.normal.inverse()?;
        let joint = std::array::from_fn(|r| std::array::from_fn(|c| sigma * sigma * inverse[r][c]));
        let covariance = in_first_frame(&joint, &chosen.pose, &at.basis)?;
        let mut view = view(&chosen.pose, TwoViewStatus::Planar, found, covariance);
        view.alternative = alternative.map(|other| parts(&other.pose));
        Some(view)
    }

    /// Covariances of rotation and direction; none where either is open.
    fn covariances(&self, fit: &Fit, sigma: f64) -> Option<(Matrix<3>, Matrix<3>)> {
        let inverse = fit.normal.inverse()?;
        // a rotation that is held has the unit matrix for its normal equations, and no variance
        let held = |k: usize| self.known.is_some() && k < 3;
        let joint = std::array::from_fn(|r| {
            std::array::from_fn(|c| if held(r) || held(c) { 0.0 } else { sigma * sigma * inverse[r][c] })
        });
        in_first_frame(&joint, &fit.pose, &fit.basis)
    }

    fn pure_rotation(&self, found: &RotationFit) -> TwoView {
        // so far the noise was kept small, for matches with a parallax to stand out
        let within = (LEAST_SIGMA_RAD, self.search_error());
        let fit = fit_rotation(self.matches, &found.second_from_first, self.known.is_some(), found.sigma, within);
        let covariance = match (self.known, fit.normal.inverse()) {
            (Some(_), _) => [[0.0; 3]; 3],
            (None, Some(inverse)) => inverse.map(|row| row.map(|x| 2.0 * fit.sigma * fit.sigma * x)),
            (None, None) => return self.undetermined(),
        };
        TwoView {
            second_from_first: fit.second_from_first,
            inlier: fit.explained,
            n_inliers: fit.n_explained,
            status: TwoViewStatus::PureRotation,
            sigma_rad: fit.sigma,
            rotation_covariance: covariance,
            ..self.undetermined()
        }
    }

    fn undetermined(&self) -> TwoView {
        TwoView {
            second_from_first: self.known.copied().unwrap_or_else(Rotation::identity),
            direction: [f64::NAN; 3],
            inlier: vec![false; self.matches.len()],
            n_inliers: 0,
            status: TwoViewStatus::Undetermined,
            sigma_rad: f64::NAN,
            rotation_covariance: [[f64::NAN; 3]; 3],
            direction_covariance: [[f64::NAN; 3]; 3],
            alternative: None,
        }
    }
}

/// Wrong pairings tried to learn how often they agree.
const PAIRINGS: usize = 512;

/// Rotation, and direction in the first frame.
fn parts(pose: &Pose) -> (Rotation<3>, Vector<3>) {
    (pose.second_from_first, normalized(&pose.second_from_first.inverse().apply(&pose.baseline)))
}

fn view(pose: &Pose, status: TwoViewStatus, found: &General, covariance: (Matrix<3>, Matrix<3>)) -> TwoView {
    let (second_from_first, direction) = parts(pose);
    TwoView {
        second_from_first,
        direction,
        inlier: found.inlier.clone(),
        n_inliers: count(&found.inlier),
        status,
        sigma_rad: found.mixture.sigma,
        rotation_covariance: covariance.0,
        direction_covariance: covariance.1,
        alternative: None,
    }
}

fn count(of: &[bool]) -> usize {
    of.iter().filter(|&&k| k).count()
}

/// Splits a joint covariance of `(phi, alpha)`. The direction is `R^T s`, so that it moves by `R^T (d s - phi x s)`.
fn in_first_frame(joint: &[[f64; 5]; 5], pose: &Pose, basis: &[Vector<3>; 2]) -> Option<(Matrix<3>, Matrix<3>)> {
    let rotation: Matrix<3> = std::array::from_fn(|r| std::array::from_fn(|c| joint[r][c]));
    // phi x s = -(s x phi): along the basis, t . (d s + s x phi)
    let along: [[f64; 5]; 2] = std::array::from_fn(|k| {
        let turn = cross(&basis[k], &pose.baseline);
        [turn[0], turn[1], turn[2], f64::from(u8::from(k == 0)), f64::from(u8::from(k == 1))]
    });
    let tangent: [[f64; 2]; 2] =
        std::array::from_fn(|a| std::array::from_fn(|b| (0..5).map(|i| along[a][i] * dot(&joint[i], &along[b])).sum()));
    let back = pose.second_from_first.inverse();
    let direction = lift(&tangent, &[back.apply(&basis[0]), back.apply(&basis[1])]);
    let certain = largest_deviation(&rotation).max(largest_deviation(&direction)) < LARGEST_DEVIATION_RAD;
    certain.then_some((rotation, direction))
}

/// A pose that is known, and how far its matches may miss it.
#[derive(Debug, Clone, PartialEq)]
pub struct KnownPose {
    /// Takes bearings of the first camera to the second.
    pub second_from_first: Rotation<3>,
    /// From the first centre to the second, in the second camera's frame, of any length; NaN where there is no baseline that
    /// counts: bearings then have to be the same.
    pub baseline: Vector<3>,
    /// Largest angle of a match to its epipolar plane; a match's own tolerance counts where it is larger.
    pub limit_rad: f64,
}

/// Which matches agree with poses that are known: the matches of pair `p` are `matches[start[p]..start[p + 1]]`, each a
/// feature of the first and one of the second image.
///
/// A match agrees if both bearings lie within the limit of one epipolar plane and their rays meet in front of both cameras,
/// or are parallel as far as the limit can tell. `tolerance_rad` is that of each feature. Indices beyond the features, and
/// bearings that are not finite, agree with nothing.
pub fn matches_that_agree(
    poses: &[KnownPose],
    start: &[usize],
    matches: &[[u32; 2]],
    bearing: &[Vector<3>],
    tolerance_rad: &[f64],
) -> Vec<bool> {
    let judge = |p: usize| -> Vec<bool> {
        let pose = &poses[p];
        let known = epipolar::Pose { second_from_first: pose.second_from_first, baseline: normalized(&pose.baseline) };
        let has_baseline = pose.baseline.iter().all(|x| x.is_finite()) && pose.baseline != [0.0; 3];
        let rows = start.get(p).copied().unwrap_or(0)..start.get(p + 1).copied().unwrap_or(0).min(matches.len());
        let agrees = |&[a, b]: &[u32; 2]| {
            let (a, b) = (a as usize, b as usize);
            let (Some(first), Some(second)) = (bearing.get(a), bearing.get(b)) else { return false };
            let own = |f: usize| tolerance_rad.get(f).copied().unwrap_or(0.0);
            let limit = pose.limit_rad.max(own(a)).max(own(b));
            if has_baseline {
                let seen = epipolar::sighting(&known, first, second, limit);
                // the least movement of both bearings is shared by them
                seen.error.abs() * std::f64::consts::SQRT_2 < limit && seen.in_front
            } else {
                crate::geometry::angle_between(&pose.second_from_first.apply(first), second) < limit
            }
        };
        matches.get(rows).unwrap_or_default().iter().map(agrees).collect()
    };
    (0..poses.len()).into_par_iter().map(judge).collect::<Vec<_>>().concat()
}
