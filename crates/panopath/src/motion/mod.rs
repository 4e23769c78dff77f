//! Orientations of a moving camera from the mean motion of what it sees (Knill & Ramirez-Herran 2007, section 7).
//!
//! Views `a`, `b` that follow each other share tracks with bearings `p_k` and `q_k`. A camera that only turned has
//! `q_k = b_from_a p_k` for all of them, so each step is a rotation fitted to all pairs at once,
//!
//! ```text
//! min over b_from_a   of   sum_k rho(|q_k - b_from_a p_k|),      cam_from_world[b] = b_from_a cam_from_world[a],
//! ```
//!
//! and the steps are chained from the first view, which is the identity. What translation adds to the flow of a point is
//! baseline over distance: it is taken for noise, which is right where points are far or lie all around, and a bias
//! where they are near and on one side. `fit` holds the fit of one rotation; [`mean_motion`] orders the views, pairs
//! them, chains the steps. [`fit_rotations`] fits each view to points that are known, the paper's fine-tuning.

use rayon::prelude::*;

use crate::geometry::{Rotation, Vector, norm, normalized, sub};
use crate::tracks::Tracks;

mod fit;

pub use fit::Weighting;
use fit::{Fit, FitModel, Pair, fit_rotation};

/// Which flow is averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Flow {
    /// Bearings on the sphere or circle.
    #[default]
    Sphere,
    /// Azimuths and elevations, as printed: for tracks near the horizon of the camera, its xy plane.
    Horizon,
}

/// What is known about the vertical.
#[derive(Debug, Clone, PartialEq, Default)]
pub enum Vertical {
    /// Nothing: the camera turns as it likes.
    #[default]
    Unknown,
    /// The z axis of every camera is vertical: it turns about that axis alone.
    Upright,
    /// The upward direction in each camera.
    Up(Vec<Vector<3>>),
}

/// Options of [`mean_motion`].
#[derive(Debug, Clone, PartialEq)]
pub struct MotionOptions {
    /// Default: on the sphere.
    pub flow: Flow,
    /// Default: robust.
    pub weighting: Weighting,
    /// Default: unknown. In the plane there is none.
    pub vertical: Vertical,
    /// Time of each view, which orders them; views whose time is NaN take no part. Default: by index.
    pub time_s: Option<Vec<f64>>,
    /// Fewest common tracks of a step. Default: 3.
    pub min_tracks: usize,
}

impl Default for MotionOptions {
    fn default() -> Self {
        Self {
            flow: Flow::default(),
            weighting: Weighting::default(),
            vertical: Vertical::default(),
            time_s: None,
            min_tracks: 3,
        }
    }
}

/// How the chain of steps ended. A status is an answer, not an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionStatus {
    /// All views in one chain.
    Converged,
    /// Views in several chains, or in none.
    Disconnected,
    /// Not one step.
    Undetermined,
}

impl MotionStatus {
    /// The name used in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Disconnected => "disconnected",
            Self::Undetermined => "undetermined",
        }
    }
}

/// From one view to the one that follows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<const D: usize> {
    /// The earlier view.
    pub from: u32,
    /// The later view.
    pub to: u32,
    /// Time between them; 1 where views are ordered by index.
    pub interval_s: f64,
    /// Tracks seen from both.
    pub n_common: usize,
    /// `to_from_from`, the turn of the camera; `None` where the common tracks do not fix it.
    pub turn: Option<Rotation<D>>,
    /// Median angle of the flow that the turn leaves; NaN without a turn.
    pub residual_rad: f64,
    /// Standard deviation of the turn about its least certain axis, as if the flow left were noise; NaN without a turn.
    pub turn_sigma_rad: f64,
}

/// Orientations up to one rotation for each chain of views.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion<const D: usize> {
    /// Orientation of each view; that of the first of a chain is the identity, or upright where the vertical is known.
    pub cam_from_world: Vec<Option<Rotation<D>>>,
    /// Chain of each view, 0 the longest; -1 for a view without a step.
    pub view_component: Vec<i32>,
    /// One for each pair of views that follow each other.
    pub steps: Vec<Step<D>>,
    /// How it ended.
    pub status: MotionStatus,
}

/// Why mean motion cannot be sought at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MotionError {
    /// An array of the wrong length.
    #[error("{name} has {found} rows, expected {expected}")]
    Length {
        /// Which array.
        name: &'static str,
        /// Its length.
        found: usize,
        /// The length that fits the tracks.
        expected: usize,
    },
    /// An upward direction without a direction.
    #[error("up[{view}] has length {length}, expected a finite vector that is not zero")]
    Up {
        /// Which view.
        view: usize,
        /// The length found.
        length: f64,
    },
    /// An option out of its range.
    #[error("{0}")]
    Option(String),
}

/// Turns of the camera between views that follow each other, chained to orientations.
///
/// # Errors
/// [`MotionError`] where options do not fit the tracks. Views that share too little are no error: they break the chain.
///
/// # Example
/// ```
/// use panopath::motion::{MotionOptions, MotionStatus, mean_motion};
/// use panopath::synthetic::{WorldKind, WorldOptions, simulate};
/// let world = simulate::<3>(WorldKind::Street, &WorldOptions { n_views: 10, n_points: 500, ..Default::default() })?;
/// let motion = mean_motion(&world.tracks, &MotionOptions::default())?;
/// assert_eq!(motion.status, MotionStatus::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn mean_motion<const D: usize>(tracks: &Tracks<D>, options: &MotionOptions) -> Result<Motion<D>, MotionError> {
    const { assert!(D == 2 || D == 3) }
    check_weighting(options.weighting)?;
    if options.min_tracks == 0 {
        return Err(MotionError::Option("min_tracks is 0, expected at least 1".to_owned()));
    }
    let level_from_cam = levelling::<D>(&options.vertical, tracks.n_views())?;
    let sequence = sequence(tracks.n_views(), options.time_s.as_deref())?;
    let sightings = Sightings::new(tracks);
    let model = match (&options.vertical, options.flow) {
        (Vertical::Unknown, Flow::Sphere) => FitModel::Free,
        (Vertical::Unknown, Flow::Horizon) => FitModel::Horizon,
        (_, Flow::Sphere) => FitModel::AboutVertical,
        (_, Flow::Horizon) => FitModel::HorizonAboutVertical,
    };
    let steps: Vec<Step<D>> = sequence
        .par_windows(2)
        .map(|pair| sightings.step(tracks, pair[0], pair[1], level_from_cam.as_deref(), model, options))
        .collect();
    Ok(chain(tracks.n_views(), &sequence, steps, level_from_cam.as_deref()))
}

/// Orientation of each view from known centres and points: the rotation that turns the directions to the points into
/// the bearings, `min over R_i of sum_j rho(|b_ij - R_i (x_j - c_i) / |x_j - c_i||)`.
///
/// Alternated with [`solve_positions`](crate::positions::solve_positions) it is the fine-tuning of section 7. A view whose
/// centre or points are not known (NaN), or do not fix a rotation, keeps the orientation it has.
///
/// # Errors
/// [`MotionError`] where an array does not fit the tracks.
pub fn fit_rotations<const D: usize>(
    tracks: &Tracks<D>,
    centers: &[Vector<D>],
    points: &[Vector<D>],
    cam_from_world: &[Rotation<D>],
    weighting: Weighting,
) -> Result<Vec<Rotation<D>>, MotionError> {
    check_weighting(weighting)?;
    let (n_views, n_tracks) = (tracks.n_views(), tracks.n_tracks());
    for (name, found, expected) in [
        ("centers", centers.len(), n_views),
        ("points", points.len(), n_tracks),
        ("cam_from_world", cam_from_world.len(), n_views),
    ] {
        if found != expected {
            return Err(MotionError::Length { name, found, expected });
        }
    }
    let sightings = Sightings::new(tracks);
    let refit = |view: usize| {
        let mut pairs: Vec<Pair<D>> = Vec::new();
        for &o in sightings.of(view) {
            let (o, offset) = (o as usize, sub(&points[tracks.track()[o as usize] as usize], &centers[view]));
            let distance = norm(&offset);
            if distance.is_finite() && distance > 0.0 {
                pairs.push((normalized(&offset), tracks.bearing()[o]));
            }
        }
        fit_rotation(&pairs, FitModel::Free, weighting).map_or(cam_from_world[view], |fit| fit.rotation)
    };
    Ok((0..n_views).into_par_iter().map(refit).collect())
}

fn check_weighting(weighting: Weighting) -> Result<(), MotionError> {
    match weighting {
        Weighting::Slowest { share } if !(share > 0.0 && share <= 1.0) => {
            Err(MotionError::Option(format!("share is {share}, expected a number above 0, at most 1")))
        }
        _ => Ok(()),
    }
}

/// Views in the order in which they were taken.
fn sequence(n_views: usize, time_s: Option<&[f64]>) -> Result<Vec<(u32, f64)>, MotionError> {
    let Some(time_s) = time_s else {
        return Ok((0..n_views as u32).map(|view| (view, f64::from(view))).collect());
    };
    if time_s.len() != n_views {
        return Err(MotionError::Length { name: "time_s", found: time_s.len(), expected: n_views });
    }
    let mut views: Vec<(u32, f64)> =
        (0u32..).zip(time_s.iter().copied()).filter(|(_, time)| time.is_finite()).collect();
    views.sort_by(|a, b| a.1.total_cmp(&b.1));
    Ok(views)
}

/// Rotations that bring the vertical of each camera to the z axis by the shortest way.
fn levelling<const D: usize>(vertical: &Vertical, n_views: usize) -> Result<Option<Vec<Rotation<D>>>, MotionError> {
    if D == 2 && *vertical != Vertical::Unknown {
        return Err(MotionError::Option("vertical is given, but there is none in the plane".to_owned()));
    }
    let up = match vertical {
        Vertical::Unknown => return Ok(None),
        Vertical::Upright => return Ok(Some(vec![Rotation::identity(); n_views])),
        Vertical::Up(up) => up,
    };
    if up.len() != n_views {
        return Err(MotionError::Length { name: "up", found: up.len(), expected: n_views });
    }
    let level = |(view, up): (usize, &Vector<3>)| {
        let length = norm(up);
        let matrix = shortest_turn_to_z(&normalized(up));
        Rotation::from_matrix(std::array::from_fn(|r| std::array::from_fn(|c| matrix[r][c])))
            .filter(|_| length > 0.0 && length.is_finite())
            .ok_or(MotionError::Up { view, length })
    };
    up.iter().enumerate().map(level).collect::<Result<_, _>>().map(Some)
}

/// The rotation with `R u = z` about the axis across both: two reflections, in closed form.
fn shortest_turn_to_z(u: &Vector<3>) -> [[f64; 3]; 3] {
    let [x, y, z] = *u;
    if z < 0.0 {
        // beyond the horizon: half a turn about x first, then the short way
        let [a, b, c] = shortest_turn_to_z(&[x, -y, -z]);
        return [[a[0], -a[1], -a[2]], [b[0], -b[1], -b[2]], [c[0], -c[1], -c[2]]];
    }
    let k = 1.0 / (1.0 + z);
    [[1.0 - k * x * x, -k * x * y, -x], [-k * x * y, 1.0 - k * y * y, -y], [x, y, z]]
}

/// Observations by view, in the order of their tracks; the first of several of one track in one view.
struct Sightings {
    first: Vec<u32>,
    observation: Vec<u32>,
}

impl Sightings {
    fn new<const D: usize>(tracks: &Tracks<D>) -> Self {
        let (view, track) = (tracks.view(), tracks.track());
        let mut observation: Vec<u32> = (0..tracks.len() as u32).collect();
        observation.sort_by_key(|&o| (view[o as usize], track[o as usize], o));
        observation.dedup_by_key(|o| (view[*o as usize], track[*o as usize]));
        let mut first = vec![0u32; tracks.n_views() + 1];
        for &o in &observation {
            first[view[o as usize] as usize + 1] += 1;
        }
        for v in 1..first.len() {
            first[v] += first[v - 1];
        }
        Self { first, observation }
    }

    fn of(&self, view: usize) -> &[u32] {
        &self.observation[self.first[view] as usize..self.first[view + 1] as usize]
    }

    /// Pairs of bearings of the tracks that two views share: a merge of two sorted lists.
    fn common<const D: usize>(&self, tracks: &Tracks<D>, from: u32, to: u32) -> Vec<Pair<D>> {
        let (mut a, mut b) = (self.of(from as usize), self.of(to as usize));
        let mut pairs = Vec::with_capacity(a.len().min(b.len()));
        while let ([o, rest_a @ ..], [p, rest_b @ ..]) = (a, b) {
            let (o, p) = (*o as usize, *p as usize);
            match tracks.track()[o].cmp(&tracks.track()[p]) {
                std::cmp::Ordering::Less => a = rest_a,
                std::cmp::Ordering::Greater => b = rest_b,
                std::cmp::Ordering::Equal => {
                    pairs.push((tracks.bearing()[o], tracks.bearing()[p]));
                    (a, b) = (rest_a, rest_b);
                }
            }
        }
        pairs
    }

    fn step<const D: usize>(
        &self,
        tracks: &Tracks<D>,
        (from, earlier): (u32, f64),
        (to, later): (u32, f64),
        level_from_cam: Option<&[Rotation<D>]>,
        model: FitModel,
        options: &MotionOptions,
    ) -> Step<D> {
        let mut pairs = self.common(tracks, from, to);
        if let Some(level) = level_from_cam {
            for (a, b) in &mut pairs {
                (*a, *b) = (level[from as usize].apply(a), level[to as usize].apply(b));
            }
        }
        let fit = if pairs.len() < options.min_tracks { None } else { fit_rotation(&pairs, model, options.weighting) };
        let in_cameras = |fit: &Fit<D>| match level_from_cam {
            None => fit.rotation,
            Some(level) => level[to as usize].inverse().compose(&fit.rotation).compose(&level[from as usize]),
        };
        Step {
            from,
            to,
            interval_s: later - earlier,
            n_common: pairs.len(),
            turn: fit.as_ref().map(in_cameras),
            residual_rad: fit.as_ref().map_or(f64::NAN, |f| f.residual_rad),
            turn_sigma_rad: fit.as_ref().map_or(f64::NAN, |f| f.sigma_rad),
        }
    }
}

/// Chains the turns; every break starts a chain of its own.
fn chain<const D: usize>(
    n_views: usize,
    sequence: &[(u32, f64)],
    steps: Vec<Step<D>>,
    level_from_cam: Option<&[Rotation<D>]>,
) -> Motion<D> {
    let mut cam_from_world = vec![None; n_views];
    let mut chains: Vec<Vec<u32>> = Vec::new();
    for (k, &(view, _)) in sequence.iter().enumerate() {
        let arrived = k.checked_sub(1).and_then(|before| {
            let step = &steps[before];
            cam_from_world[step.from as usize].as_ref().and_then(|cam: &Rotation<D>| Some(step.turn?.compose(cam)))
        });
        let starts = || level_from_cam.map_or(Rotation::identity(), |level| level[view as usize].inverse());
        match (arrived, chains.last_mut()) {
            (Some(_), Some(chain)) => chain.push(view),
            _ => chains.push(vec![view]),
        }
        cam_from_world[view as usize] = Some(arrived.unwrap_or_else(starts));
    }
    chains.sort_by_key(|chain| std::cmp::Reverse(chain.len()));
    let mut view_component = vec![-1; n_views];
    for (component, chain) in (0..).zip(chains.iter().take_while(|chain| chain.len() > 1)) {
        for &view in chain {
            view_component[view as usize] = component;
        }
    }
    for (cam, &component) in cam_from_world.iter_mut().zip(&view_component) {
        *cam = cam.filter(|_| component >= 0);
    }
    let status = match chains.first().map_or(0, Vec::len) {
        0 | 1 => MotionStatus::Undetermined,
        longest if longest == n_views => MotionStatus::Converged,
        _ => MotionStatus::Disconnected,
    };
    Motion { cam_from_world, view_component, steps, status }
}
