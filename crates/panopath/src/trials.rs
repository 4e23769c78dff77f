//! Many small worlds, each simulated, solved by several methods and compared with its truth.
//!
//! Let `e_k` be where an answer has node `k`, a view or a point, less where it truly is, both in one frame
//! ([`Alignment`]). What is told of the `N` nodes of a trial is `max |e_k|`, `sum |e_k| / N`, `|sum e_k| / N` and
//! `sqrt(sum |e_k|^2 / N)` ([`Deviations`]), and how far the answer's bearings are from the true ones and from those it
//! was made from ([`Refilmed`]).
//!
//! [`run_trials`] spreads trials over the threads; a trial depends on its own description alone, so that the answers
//! are the same on any number of them.

use rayon::prelude::*;

use crate::geometry::{Rotation, Similarity, Vector, add, angle_between, norm, normalized, scale, sub};
use crate::positions::{Method, PositionError, PositionOptions, solve_positions};
use crate::structure::{Status, Structure};
use crate::synthetic::{World, WorldError, WorldKind, WorldOptions, simulate};

/// One world of [`WorldKind::Box`], seen in full.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trial {
    /// Number of views.
    pub n_views: usize,
    /// Number of points.
    pub n_points: usize,
    /// Seed of the world and of the errors of its angles.
    pub seed: u64,
    /// Largest error of an angle: [`WorldOptions::angle_error_rad`].
    pub angle_error_rad: f64,
}

/// How an answer and the truth are brought into one frame: shift and scale, orientations being known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Alignment {
    /// The fit that leaves the least squares over all views and points.
    All,
    /// Over the views alone, where there are two or more.
    Views,
    /// First point at the origin, second with first coordinate one, in both; errors are in that unit.
    Paper,
}

impl Alignment {
    /// Every alignment, in the order of [`Outcome::deviations`].
    pub const EVERY: [Self; 3] = [Self::All, Self::Views, Self::Paper];

    /// The name used in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Views => "views",
            Self::Paper => "paper",
        }
    }
}

/// How far the nodes of an answer are from the truth, those that are determined; NaN where there is no frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviations {
    /// Largest distance.
    pub max: f64,
    /// Mean distance.
    pub mean_abs: f64,
    /// Length of the mean displacement.
    pub mean: f64,
    /// Root mean square distance.
    pub rms: f64,
    /// The same over the views.
    pub camera_rms: f64,
    /// The same over the points.
    pub point_rms: f64,
    /// Largest deviation of a coordinate of a point.
    pub point_coordinate_max: f64,
}

impl Deviations {
    const NOWHERE: Self = Self {
        max: f64::NAN,
        mean_abs: f64::NAN,
        mean: f64::NAN,
        rms: f64::NAN,
        camera_rms: f64::NAN,
        point_rms: f64::NAN,
        point_coordinate_max: f64::NAN,
    };

    /// The values with their names.
    pub fn named(&self) -> [(&'static str, f64); 7] {
        [
            ("max", self.max),
            ("mean_abs", self.mean_abs),
            ("mean", self.mean),
            ("rms", self.rms),
            ("camera_rms", self.camera_rms),
            ("point_rms", self.point_rms),
            ("point_coordinate_max", self.point_coordinate_max),
        ]
    }
}

/// Angles between bearings when the answer is filmed again; NaN where nothing is determined.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Refilmed {
    /// Largest angle to a true bearing.
    pub max_rad: f64,
    /// Root mean square angle to the true bearings.
    pub rms_rad: f64,
    /// Largest angle to a measured bearing.
    pub residual_max_rad: f64,
    /// Root mean square angle to the measured bearings.
    pub residual_rms_rad: f64,
}

impl Refilmed {
    /// The values with their names.
    pub fn named(&self) -> [(&'static str, f64); 4] {
        [
            ("max_rad", self.max_rad),
            ("rms_rad", self.rms_rad),
            ("residual_max_rad", self.residual_max_rad),
            ("residual_rms_rad", self.residual_rms_rad),
        ]
    }
}

/// What one method made of one trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcome {
    /// How the solve ended. What is ambiguous may have positions, and they are compared too.
    pub status: Status,
    /// Views and points that have no position in the largest part.
    pub n_missing: usize,
    /// In the order of [`Alignment::EVERY`].
    pub deviations: [Deviations; 3],
    /// How the answer looks when it is filmed again.
    pub refilmed: Refilmed,
}

/// Why a batch cannot be run.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum TrialError {
    /// A world that cannot be simulated.
    #[error("trial {index}: {source}")]
    World {
        /// Which trial.
        index: usize,
        /// Why.
        source: WorldError,
    },
    /// A method that cannot be used.
    #[error("trial {index}: {source}")]
    Positions {
        /// Which trial.
        index: usize,
        /// Why.
        source: PositionError,
    },
}

/// Runs every trial with every method: `answer[trial][method]`.
///
/// # Errors
/// [`TrialError`] naming the first trial that is wrong.
///
/// # Examples
/// ```
/// use panopath::positions::Method;
/// use panopath::trials::{Trial, run_trials};
/// # fn main() -> Result<(), panopath::trials::TrialError> {
/// let exact = Trial { n_views: 5, n_points: 8, seed: 1, angle_error_rad: 0.0 };
/// let outcomes = run_trials::<3>(&[exact], &[Method::Robust])?;
/// assert!(outcomes[0][0].deviations[0].max < 1e-9);
/// # Ok(())
/// # }
/// ```
pub fn run_trials<const D: usize>(trials: &[Trial], methods: &[Method]) -> Result<Vec<Vec<Outcome>>, TrialError> {
    // collected one by one: of several errors the first is told, on any number of threads
    let outcomes: Vec<_> =
        trials.par_iter().enumerate().map(|(index, trial)| run::<D>(index, trial, methods)).collect();
    outcomes.into_iter().collect()
}

fn run<const D: usize>(index: usize, trial: &Trial, methods: &[Method]) -> Result<Vec<Outcome>, TrialError> {
    let Trial { n_views, n_points, seed, angle_error_rad } = *trial;
    let options = WorldOptions { n_views, n_points, seed, angle_error_rad, ..WorldOptions::default() };
    let world = simulate::<D>(WorldKind::Box, &options).map_err(|source| TrialError::World { index, source })?;
    methods
        .iter()
        .map(|&method| {
            let options = PositionOptions { method, ..PositionOptions::default() };
            let found = solve_positions(&world.tracks, None, &options);
            Ok(compare(&world, &found.map_err(|source| TrialError::Positions { index, source })?))
        })
        .collect()
}

/// A view or a point: where the answer has it, and where it is.
type Node<const D: usize> = (Vector<D>, Vector<D>);

/// Views and points of the largest part.
struct Nodes<const D: usize> {
    views: Vec<Node<D>>,
    points: Vec<Node<D>>,
    /// First and second point, where both are determined.
    first_two: Option<[Node<D>; 2]>,
}

fn compare<const D: usize>(world: &World<D>, found: &Structure<D>) -> Outcome {
    let centers = determined(&found.view_component, &found.centers);
    let points = determined(&found.track_component, &found.points);
    let pair = |(found, truth): (&Option<Vector<D>>, &Vector<D>)| found.map(|x| (x, *truth));
    let pairs = |found: &[Option<Vector<D>>], truth: &[Vector<D>]| found.iter().zip(truth).filter_map(pair).collect();
    let node = |k: usize| pair((points.get(k)?, world.points.get(k)?));
    let nodes = Nodes {
        views: pairs(&centers, &world.centers),
        points: pairs(&points, &world.points),
        first_two: node(0).zip(node(1)).map(|(a, b)| [a, b]),
    };
    Outcome {
        status: found.summary.status,
        n_missing: centers.iter().chain(&points).filter(|place| place.is_none()).count(),
        deviations: Alignment::EVERY.map(|alignment| nodes.deviations(alignment)),
        refilmed: refilm(world, &centers, &points),
    }
}

/// Positions of the largest part.
fn determined<const D: usize>(component: &[i32], place: &[Vector<D>]) -> Vec<Option<Vector<D>>> {
    let is_there = |x: &Vector<D>| x.iter().all(|v| v.is_finite());
    component.iter().zip(place).map(|(&c, x)| (c == 0 && is_there(x)).then_some(*x)).collect()
}

impl<const D: usize> Nodes<D> {
    fn deviations(&self, alignment: Alignment) -> Deviations {
        let everything = || [self.views.as_slice(), &self.points].concat();
        let shift_and_scale = match alignment {
            Alignment::Views if self.views.len() > 1 => Similarity::fit_unrotated(&self.views),
            Alignment::All | Alignment::Views => Similarity::fit_unrotated(&everything()),
            Alignment::Paper => return self.paper_deviations(),
        };
        shift_and_scale.map_or(Deviations::NOWHERE, |fit| self.measure(|(found, truth)| sub(&fit.apply(found), truth)))
    }

    /// Both scenes put where the paper has them; nothing is fitted.
    fn paper_deviations(&self) -> Deviations {
        let Some([(found_1, true_1), (found_2, true_2)]) = self.first_two else { return Deviations::NOWHERE };
        let (found_unit, true_unit) = (found_2[0] - found_1[0], true_2[0] - true_1[0]);
        if found_unit == 0.0 || true_unit == 0.0 {
            return Deviations::NOWHERE;
        }
        self.measure(|(found, truth)| {
            sub(&scale(1.0 / found_unit, &sub(found, &found_1)), &scale(1.0 / true_unit, &sub(truth, &true_1)))
        })
    }

    fn measure(&self, displacement: impl Fn(&Node<D>) -> Vector<D>) -> Deviations {
        let views: Vec<Vector<D>> = self.views.iter().map(&displacement).collect();
        let points: Vec<Vector<D>> = self.points.iter().map(&displacement).collect();
        let count = (views.len() + points.len()) as f64;
        let lengths = || views.iter().chain(&points).map(norm);
        let sum = views.iter().chain(&points).fold([0.0; D], |sum, e| add(&sum, e));
        Deviations {
            max: lengths().fold(0.0, f64::max),
            mean_abs: lengths().sum::<f64>() / count,
            mean: norm(&sum) / count,
            rms: root_mean_square(lengths()),
            camera_rms: root_mean_square(views.iter().map(norm)),
            point_rms: root_mean_square(points.iter().map(norm)),
            point_coordinate_max: points.iter().flatten().fold(0.0, |most: f64, e| most.max(e.abs())),
        }
    }
}

/// Angles of the answer's bearings to the true and to the measured ones. Shift and scale change none.
fn refilm<const D: usize>(world: &World<D>, centers: &[Option<Vector<D>>], points: &[Option<Vector<D>>]) -> Refilmed {
    let (mut to_truth, mut to_measured) = (Vec::new(), Vec::new());
    let tracks = &world.tracks;
    let world_from_cam: Vec<Rotation<D>> = world.cam_from_world.iter().map(Rotation::inverse).collect();
    for ((&view, &track), measured) in tracks.view().iter().zip(tracks.track()).zip(tracks.bearing()) {
        let (view, track) = (view as usize, track as usize);
        let (Some(center), Some(point)) = (&centers[view], &points[track]) else { continue };
        let seen = normalized(&sub(point, center));
        let truth = normalized(&sub(&world.points[track], &world.centers[view]));
        to_truth.push(angle_between(&seen, &truth));
        to_measured.push(angle_between(&seen, &world_from_cam[view].apply(measured)));
    }
    let most = |angles: &[f64]| angles.iter().fold(f64::NAN, |most: f64, a| most.max(*a));
    Refilmed {
        max_rad: most(&to_truth),
        rms_rad: root_mean_square(to_truth.iter().copied()),
        residual_max_rad: most(&to_measured),
        residual_rms_rad: root_mean_square(to_measured.iter().copied()),
    }
}

/// NaN of nothing.
fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), x| (sum + x * x, count + 1.0));
    f64::sqrt(sum / count)
}
