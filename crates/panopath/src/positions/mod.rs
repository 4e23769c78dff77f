//! Camera positions and points from bearings of known orientation.
//!
//! With `v` the world direction of an observation, `c` the centre of its view and `x` the point of its track, the answer
//! minimises `sum rho(angle(v, x - c) / sigma)` over all centres and points, up to translation and scale.
//!
//! [`solve_positions`] reads: rotate bearings into the world, split the input into parts that share a scale, solve each
//! part (robustly, or by the paper's linear least squares), split again on what was kept, place each part in the gauge.

use std::time::Instant;

use rayon::prelude::*;

use crate::bundle::estimate::Estimate;
use crate::bundle::noise::precisions;
use crate::bundle::part::{Lanes, Part, Stations};
use crate::bundle::reduced::{ReducedSystem, most_observed_node};
use crate::geometry::{Rotation, Similarity, Vector};
use crate::least_squares::LeastSquaresError;
use crate::lists::most_common;
use crate::tracks::Tracks;

mod descent;
mod gauge;
mod information;
mod linear;
mod options;
mod parts;
mod robust;
mod start;

pub use crate::least_squares::LinearSolver;
pub use crate::structure::{Status, Structure, Summary, Timings};
pub use information::position_covariance;
pub use options::{Control, Gauge, LinearForm, LinearGauge, Method, PositionError, PositionOptions};

use parts::{Parts, Sightings, jointly_scaled_parts};
use robust::PartSolution;

/// Finds camera centres and points from bearings.
///
/// `cam_from_world` holds one rotation for each view; without it the bearings are world directions already.
///
/// # Errors
/// [`PositionError`] where the arguments do not fit together. Input that determines little or nothing is no error: see
/// [`Summary::status`].
///
/// # Example
/// ```
/// use panopath::positions::{PositionOptions, Status, solve_positions};
/// use panopath::synthetic::{WorldKind, WorldOptions, simulate};
/// let world = simulate::<3>(WorldKind::Box, &WorldOptions { n_views: 5, n_points: 20, ..Default::default() })?;
/// let scene = solve_positions(&world.tracks, Some(&world.cam_from_world), &PositionOptions::default())?;
/// assert_eq!(scene.summary.status, Status::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn solve_positions<const D: usize>(
    tracks: &Tracks<D>,
    cam_from_world: Option<&[Rotation<D>]>,
    options: &PositionOptions<D>,
) -> Result<Structure<D>, PositionError> {
    const { assert!(D == 2 || D == 3) }
    check(tracks, cam_from_world, options)?;
    let clock = Instant::now();
    let rays = Rays::new(tracks, cam_from_world);
    let parts = rays.parts(tracks, options.split_parts, None);
    let mut timings = Timings { layout_s: clock.elapsed().as_secs_f64(), ..Timings::default() };
    let mut answer = Answer::solve(tracks, &rays, &parts, options, &mut timings)?;

    let clock = Instant::now();
    let kept_parts = rays.parts(tracks, options.split_parts, Some(&answer.inlier));
    timings.finish_s = clock.elapsed().as_secs_f64();
    if kept_parts.views.len() > parts.views.len() {
        // what only outliers held together is solved apart, so that each part is judged by itself
        answer = Answer::solve(tracks, &rays, &kept_parts, options, &mut timings)?;
    }
    let clock = Instant::now();
    answer.keep_what_is_determined(tracks, &rays, options);
    let structure = answer.place(cam_from_world, options)?;
    timings.finish_s += clock.elapsed().as_secs_f64();
    Ok(Structure { summary: Summary { timings, ..structure.summary }, ..structure })
}

fn check<const D: usize>(
    tracks: &Tracks<D>,
    cam_from_world: Option<&[Rotation<D>]>,
    options: &PositionOptions<D>,
) -> Result<(), PositionError> {
    let expected = tracks.n_views();
    if let Some(rotations) = cam_from_world
        && rotations.len() != expected
    {
        return Err(PositionError::Orientations { found: rotations.len(), expected });
    }
    if let Some((centers, points)) = &options.start
        && (centers.len(), points.len()) != (expected, tracks.n_tracks())
    {
        let (n, m, wanted) = (centers.len(), points.len(), tracks.n_tracks());
        return Err(PositionError::Start(format!(
            "{n} centres and {m} points given, expected {expected} and {wanted}"
        )));
    }
    if let Method::Linear { form: LinearForm::TwoStage { vertical_axis }, .. } = options.method
        && vertical_axis >= D
    {
        return Err(PositionError::Option(format!("vertical_axis is {vertical_axis}, expected 0 to {}", D - 1)));
    }
    if let Gauge::Control(control) = &options.gauge {
        check_control("view", &control.views, expected)?;
        check_control("track", &control.tracks, tracks.n_tracks())?;
    }
    Ok(())
}

fn check_control<const D: usize>(name: &str, known: &[(u32, Vector<D>)], limit: usize) -> Result<(), PositionError> {
    for (id, position) in known {
        if *id as usize >= limit {
            return Err(PositionError::Control(format!("{name} {id} does not exist, there are {limit}")));
        }
        if position.iter().any(|x| !x.is_finite()) {
            return Err(PositionError::Control(format!("the position of {name} {id} is not finite")));
        }
    }
    Ok(())
}

/// World directions of all observations and their precisions.
struct Rays<const D: usize> {
    direction: Vec<Vector<D>>,
    /// `(sigma_reference / sigma)^2`.
    precision: Option<Vec<f64>>,
    /// Rays nearer to parallel than the noise fix no distance.
    parallel_rad: f64,
}

impl<const D: usize> Rays<D> {
    fn new(tracks: &Tracks<D>, cam_from_world: Option<&[Rotation<D>]>) -> Self {
        /// Parallax below this many sigma is noise.
        const NOISE_SIGMAS: f64 = 5.0;
        let direction = match cam_from_world {
            None => tracks.bearing().to_vec(),
            Some(rotations) => {
                let world_from_cam: Vec<Rotation<D>> = rotations.iter().map(Rotation::inverse).collect();
                let views = tracks.view().par_iter();
                views.zip(tracks.bearing()).map(|(&v, b)| world_from_cam[v as usize].apply(b)).collect()
            }
        };
        let (reference, precision) = precisions(tracks).unzip();
        let parallel_rad = reference.map_or(parts::PARALLEL_RAD, |s| (NOISE_SIGMAS * s).max(parts::PARALLEL_RAD));
        Self { direction, precision, parallel_rad }
    }

    /// Parts that share a scale, on the observations kept (all of them where none is given).
    fn parts(&self, tracks: &Tracks<D>, split: bool, keep: Option<&[bool]>) -> Parts {
        let all;
        let keep = match keep {
            Some(keep) => keep,
            None => {
                all = vec![true; tracks.len()];
                &all
            }
        };
        let seen = Sightings {
            n_views: tracks.n_views(),
            n_tracks: tracks.n_tracks(),
            view: tracks.view(),
            track: tracks.track(),
            direction: &self.direction,
            parallel_rad: self.parallel_rad,
        };
        if split { jointly_scaled_parts(&seen, keep) } else { parts::single_part(&seen, keep) }
    }

    /// Direction of an observation, times a sign, with its precision in lane 3.
    fn lanes(&self, o: usize, sign: f64) -> Lanes {
        let mut lanes = Lanes::from_vector::<D>(&self.direction[o]).times(sign);
        lanes.0[3] = self.precision.as_ref().map_or(1.0, |p| p[o]);
        lanes
    }
}

/// What is known so far, in the input's numbering and in each part's own frame.
struct Answer<const D: usize> {
    centers: Vec<Vector<D>>,
    points: Vec<Vector<D>>,
    view_component: Vec<i32>,
    track_component: Vec<i32>,
    inlier: Vec<bool>,
    residual_rad: Vec<f64>,
    n_components: usize,
    iterations: usize,
    /// Status and noise estimate of the largest part.
    largest: Option<(Status, f64)>,
}

const NOWHERE: f64 = f64::NAN;

impl<const D: usize> Answer<D> {
    fn nothing(tracks: &Tracks<D>) -> Self {
        Self {
            centers: vec![[NOWHERE; D]; tracks.n_views()],
            points: vec![[NOWHERE; D]; tracks.n_tracks()],
            view_component: vec![-1; tracks.n_views()],
            track_component: vec![-1; tracks.n_tracks()],
            inlier: vec![false; tracks.len()],
            residual_rad: vec![NOWHERE; tracks.len()],
            n_components: 0,
            iterations: 0,
            largest: None,
        }
    }

    /// Solves every part.
    fn solve(
        tracks: &Tracks<D>,
        rays: &Rays<D>,
        parts: &Parts,
        options: &PositionOptions<D>,
        timings: &mut Timings,
    ) -> Result<Self, PositionError> {
        let mut answer = Self::nothing(tracks);
        for index in 0..parts.views.len() {
            answer.solve_part(tracks, rays, parts, index, options, timings)?;
        }
        Ok(answer)
    }

    /// Solves one part and writes down the views and tracks that no larger part has.
    fn solve_part(
        &mut self,
        tracks: &Tracks<D>,
        rays: &Rays<D>,
        parts: &Parts,
        index: usize,
        options: &PositionOptions<D>,
        timings: &mut Timings,
    ) -> Result<(), PositionError> {
        let clock = Instant::now();
        let members = match options.method {
            Method::Robust => Members::fewest_first(&parts.views[index], &parts.tracks[index]),
            Method::Linear { .. } => Members::as_given(&parts.views[index], &parts.tracks[index]),
        };
        let part = members.lay_out(tracks, rays);
        timings.layout_s += clock.elapsed().as_secs_f64();
        if part.n_tracks() == 0 {
            return Ok(());
        }
        let start = options.start.as_ref().and_then(|(centers, points)| members.start(&part, centers, points));
        let solution = match options.method {
            Method::Robust => {
                let (solver, most) = (options.linear_solver, options.max_iterations);
                robust::solve_part(&part, start, solver, most, options.even_start, timings)?
            }
            Method::Linear { form, gauge } => robust::solve_part_linearly(&part, form, gauge, timings)?,
        };
        self.write(rays, &part, &members, &solution);
        Ok(())
    }

    fn write(&mut self, rays: &Rays<D>, part: &Part<D>, members: &Members<'_>, solution: &PartSolution) {
        let component = self.n_components as i32;
        self.n_components += 1;
        let nodes = (members.cameras.iter().zip(&solution.estimate.centers))
            .chain(part.input_track.iter().zip(&solution.estimate.points));
        for (place, (&id, position)) in nodes.enumerate() {
            let is_view = (place < members.cameras.len()) != members.exchanged;
            let (label, slot) = if is_view {
                (&mut self.view_component[id as usize], &mut self.centers[id as usize])
            } else {
                (&mut self.track_component[id as usize], &mut self.points[id as usize])
            };
            if *label < 0 {
                (*label, *slot) = (component, position.vector());
            }
        }
        for (k, &o) in part.input_observation.iter().enumerate() {
            let o = o as usize;
            self.inlier[o] |= solution.inlier[k];
            let precision = rays.precision.as_ref().map_or(1.0, |p| p[o]);
            self.residual_rad[o] = 2.0 * (0.5 * solution.chord[k] / precision.sqrt()).min(1.0).asin();
        }
        self.largest.get_or_insert((solution.status, solution.sigma));
        self.iterations += solution.iterations;
    }

    /// Splits again on the observations that were kept: what only outliers held together is taken apart, and what only
    /// outliers determined is not determined.
    fn keep_what_is_determined(&mut self, tracks: &Tracks<D>, rays: &Rays<D>, options: &PositionOptions<D>) {
        let parts = rays.parts(tracks, options.split_parts, Some(&self.inlier));
        let before = std::mem::replace(&mut self.track_component, vec![-1; tracks.n_tracks()]);
        let views_before = std::mem::replace(&mut self.view_component, vec![-1; tracks.n_views()]);
        self.n_components = 0;
        for (views, members) in parts.views.iter().zip(&parts.tracks) {
            // a hinge keeps the frame of the larger part: members of another frame are left to that part
            let Some(frame) = most_common(members.iter().map(|&t| before[t as usize])) else { continue };
            let component = self.n_components as i32;
            let mut found = false;
            for &view in views.iter().filter(|&&v| views_before[v as usize] == frame) {
                let label = &mut self.view_component[view as usize];
                if *label < 0 {
                    *label = component;
                    found = true;
                }
            }
            for &track in members.iter().filter(|&&t| before[t as usize] == frame) {
                let label = &mut self.track_component[track as usize];
                *label = if *label < 0 && found { component } else { *label };
            }
            self.n_components += usize::from(found);
        }
        for (center, &component) in self.centers.iter_mut().zip(&self.view_component) {
            if component < 0 {
                *center = [NOWHERE; D];
            }
        }
        for (point, &component) in self.points.iter_mut().zip(&self.track_component) {
            if component < 0 {
                *point = [NOWHERE; D];
            }
        }
        for (o, (&view, &track)) in tracks.view().iter().zip(tracks.track()).enumerate() {
            if self.view_component[view as usize] < 0 || self.track_component[track as usize] < 0 {
                self.inlier[o] = false;
                self.residual_rad[o] = NOWHERE;
            }
        }
    }

    /// Moves each part into the gauge asked for.
    fn place(
        self,
        cam_from_world: Option<&[Rotation<D>]>,
        options: &PositionOptions<D>,
    ) -> Result<Structure<D>, PositionError> {
        let cam_from_world =
            cam_from_world.map_or_else(|| vec![Rotation::identity(); self.centers.len()], <[Rotation<D>]>::to_vec);
        let (status, sigma_rad) = match self.largest {
            Some((Status::Converged, sigma)) if self.n_components > 1 => (Status::Disconnected, sigma),
            Some(largest) if self.n_components > 0 => largest,
            _ => (Status::Undetermined, NOWHERE),
        };
        let summary = Summary {
            status,
            iterations: self.iterations,
            sigma_rad,
            n_components: self.n_components,
            timings: Timings::default(),
        };
        let mut structure = Structure {
            centers: self.centers,
            points: self.points,
            view_component: self.view_component,
            track_component: self.track_component,
            inlier: self.inlier,
            residual_rad: self.residual_rad,
            cam_from_world,
            summary,
        };
        place_structure(&mut structure, |_| true, &options.gauge)?;
        Ok(structure)
    }
}

/// Moves each part into the gauge asked for, which the points that count and the cameras define; gives what was done to
/// each part.
pub(crate) fn place_structure<const D: usize>(
    structure: &mut Structure<D>,
    counts: impl Fn(usize) -> bool,
    gauge: &Gauge<D>,
) -> Result<Vec<Similarity<D>>, PositionError> {
    let n_components = structure.summary.n_components;
    let centers = members(&structure.view_component, &structure.centers, n_components);
    let points = members(&structure.track_component, &structure.points, n_components);
    let mut output_from_part = Vec::with_capacity(n_components);
    for (centers, points) in centers.iter().zip(&points) {
        let told: Vec<(u32, Vector<D>)> = points.iter().filter(|(track, _)| counts(*track as usize)).copied().collect();
        output_from_part.push(gauge::gauge_from_solution(gauge, centers, &told)?);
    }
    if matches!(gauge, Gauge::Control(_)) && output_from_part.iter().all(Option::is_none) {
        let text = "fewer than two of the known positions belong to one solved part, expected at least two";
        return Err(PositionError::Control(text.to_owned()));
    }
    let mut moved = Vec::with_capacity(n_components);
    for (component, (centers, points)) in centers.iter().zip(&points).enumerate() {
        let placed = match output_from_part[component] {
            Some(similarity) => similarity,
            None => gauge::gauge_from_solution(&Gauge::Normalized, centers, points)?.unwrap_or(Similarity::identity()),
        };
        let old_from_new = placed.rotation.inverse();
        for (view, center) in centers {
            structure.centers[*view as usize] = placed.apply(center);
            let rotation = &mut structure.cam_from_world[*view as usize];
            *rotation = rotation.compose(&old_from_new);
        }
        for (track, point) in points {
            structure.points[*track as usize] = placed.apply(point);
        }
        moved.push(placed);
    }
    Ok(moved)
}

/// The reduced system of cameras that have a position each.
type PositionSystem<const D: usize> = ReducedSystem<D, D, Lanes>;

/// Analyses a part; the view that saw most is pinned, which takes away the common translation.
fn position_system<const D: usize>(
    part: &Part<D>,
    solver: LinearSolver,
) -> Result<PositionSystem<D>, LeastSquaresError> {
    let mut held = vec![false; part.n_nodes * D];
    let pinned = most_observed_node(part);
    held[pinned * D..(pinned + 1) * D].fill(true);
    ReducedSystem::analyse(part, solver, held)
}

/// Views and tracks of a part, in the roles that the solver gives them.
///
/// Directions are all the solver knows, and reversing them exchanges views and tracks: the fewer of the two act as cameras,
/// whose reduced system is factorised, and the others are eliminated one by one.
struct Members<'a> {
    cameras: &'a [u32],
    points: &'a [u32],
    exchanged: bool,
}

impl<'a> Members<'a> {
    fn as_given(views: &'a [u32], tracks: &'a [u32]) -> Self {
        Self { cameras: views, points: tracks, exchanged: false }
    }

    fn fewest_first(views: &'a [u32], tracks: &'a [u32]) -> Self {
        if tracks.len() < views.len() {
            Self { cameras: tracks, points: views, exchanged: true }
        } else {
            Self::as_given(views, tracks)
        }
    }

    /// Lays out the observations between the members.
    fn lay_out<const D: usize>(&self, tracks: &Tracks<D>, rays: &Rays<D>) -> Part<D> {
        let (mut camera_of, mut point_of) = (tracks.view(), tracks.track());
        let (mut n_cameras, mut n_points) = (tracks.n_views(), tracks.n_tracks());
        if self.exchanged {
            std::mem::swap(&mut camera_of, &mut point_of);
            std::mem::swap(&mut n_cameras, &mut n_points);
        }
        let mut local = vec![u32::MAX; n_cameras];
        for (k, &camera) in self.cameras.iter().enumerate() {
            local[camera as usize] = k as u32;
        }
        let mut is_member = vec![false; n_points];
        for &point in self.points {
            is_member[point as usize] = true;
        }
        let belongs =
            |o: u32| local[camera_of[o as usize] as usize] != u32::MAX && is_member[point_of[o as usize] as usize];
        let observations: Vec<u32> = (0..tracks.len() as u32).filter(|&o| belongs(o)).collect();
        let sign = if self.exchanged { -1.0 } else { 1.0 };
        Part::new(
            Stations::positions::<D>(self.cameras.len()),
            n_points,
            &observations,
            point_of,
            |o| local[camera_of[o] as usize],
            |o| rays.lanes(o, sign),
        )
    }

    /// The caller's start; positions that are not finite are sought anew, and `None` where too few are given.
    fn start<const D: usize>(&self, part: &Part<D>, centers: &[Vector<D>], points: &[Vector<D>]) -> Option<Estimate> {
        let (cameras, others) = if self.exchanged { (points, centers) } else { (centers, points) };
        let lanes = |ids: &[u32], positions: &[Vector<D>]| {
            ids.iter().map(|&id| Lanes::from_vector::<D>(&positions[id as usize])).collect()
        };
        let given = Estimate { centers: lanes(self.cameras, cameras), points: lanes(&part.input_track, others) };
        given.completed(part)
    }
}

/// Positions of the members of each component, in ascending order of their index.
fn members<const D: usize>(component: &[i32], position: &[Vector<D>], n: usize) -> Vec<Vec<(u32, Vector<D>)>> {
    let mut members = vec![Vec::new(); n];
    for (id, (&c, x)) in component.iter().zip(position).enumerate() {
        if c >= 0 {
            members[c as usize].push((id as u32, *x));
        }
    }
    members
}
