//! Bundle adjustment on the sphere: orientations, centres and points together.
//!
//! Minimises `sum rho(angle(b, R (x - c) - a) / sigma)` over the orientations `R = cam_from_world` and centres `c` of the views
//! and the points `x`, with `b` the measured bearing and `a` the place of its sensor in the view (zero for a
//! panorama with one centre), plus what is known beforehand. Up to a similarity, where nothing known fixes it.
//!
//! `D` is 2 or 3 and `V = D (D + 1) / 2` the number of unknowns of a view: `refine::<3, 6>`, `refine::<2, 3>`. Residuals are on the
//! sphere, which has neither a seam nor poles. Points are eliminated; `poses` says how a view's unknowns move its rays.

use std::time::Instant;

use crate::bundle::determinacy::{GUARD, GaugeBasis, MEANINGLESS_RAD, weakest_mode_is_loose};
use crate::bundle::levenberg::Effort;
use crate::bundle::newton::{NewtonWeights, Residuals};
use crate::bundle::noise::{
    FIRST_OUTLIER_SIGMAS, OUTLIER_SIGMAS, chords, inliers, noise_scale, precisions, sigma_of_inliers,
};
use crate::bundle::part::{Lanes, Part, Stations};
use crate::bundle::points::{reconsider, repair_cheirality, without_parallax, without_tracks};
use crate::bundle::reduced::{Damping, Factorised, most_observed_node};
use crate::bundle::system::CameraSystem;
use crate::bundle::turns::{PoseRow, PoseStep, Turns, turns};
use crate::geometry::{Rotation, Similarity, Vector};
use crate::least_squares::{LeastSquaresError, nearest_rotation};
use crate::structure::{Status, Structure, Summary, Timings};
use crate::tracks::Tracks;

mod align;
mod covariance;
mod descent;
#[cfg(test)]
mod differences;
mod gauge;
mod options;
mod poses;
mod priors;

pub use options::{DirectionPrior, Held, PositionPrior, Priors, RefineError, RefineOptions, Rig, RotationPrior};

pub use covariance::{CovarianceGauge, Covariances, covariance};

use descent::{Given, State, descend};
use gauge::Gauge;
use poses::{Poses, Sights};
use priors::PartPriors;

/// Refines orientations, centres and points together, each component of `start` by itself.
///
/// Rows of `start` that are NaN are left out, but for points: those are intersected anew where two views or more of one
/// component see them. Bearings are in the frames of the views.
///
/// # Errors
/// [`RefineError`] where the arguments do not fit together.
///
/// # Example
/// ```
/// use panopath::positions::{PositionOptions, solve_positions};
/// use panopath::refinement::{RefineOptions, refine};
/// use panopath::synthetic::{WorldKind, WorldOptions, simulate};
/// let options = WorldOptions { n_views: 8, n_points: 60, orientation_error_rad: 0.01, ..Default::default() };
/// let world = simulate::<3>(WorldKind::Box, &options)?;
/// let start = solve_positions(&world.tracks, Some(&world.cam_from_world), &PositionOptions::default())?;
/// let scene = refine::<3, 6>(&world.tracks, &start, &RefineOptions::default())?;
/// assert!(scene.residual_rad.iter().all(|r| *r < 1e-6));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn refine<const D: usize, const V: usize>(
    tracks: &Tracks<D>,
    start: &Structure<D>,
    options: &RefineOptions<D>,
) -> Result<Structure<D>, RefineError> {
    const { assert!((D == 2 || D == 3) && V == D * (D + 1) / 2) }
    check(tracks, start, options)?;
    let mut answer = nothing_refined(tracks, start);
    let component_of_track = components_of_tracks(tracks, start);
    let mut largest: Option<(Status, f64)> = None;
    for component in components_of_views(start) {
        let Some(piece) = Piece::lay_out(tracks, start, &component_of_track, component, options)? else { continue };
        let refined = piece.refine::<V>(options, &mut answer.summary.timings)?;
        answer.summary.iterations += refined.iterations;
        if !piece.write(&refined, answer.summary.n_components as i32, &mut answer) {
            continue;
        }
        piece.restore_held(start, &options.held, &mut answer);
        answer.summary.n_components += 1;
        largest.get_or_insert((refined.status(), refined.sigma));
    }
    (answer.summary.status, answer.summary.sigma_rad) = match largest {
        Some((Status::Converged, sigma)) if answer.summary.n_components > 1 => (Status::Disconnected, sigma),
        Some(largest) => largest,
        None => (Status::Undetermined, f64::NAN),
    };
    Ok(answer)
}

fn check<const D: usize>(
    tracks: &Tracks<D>,
    start: &Structure<D>,
    options: &RefineOptions<D>,
) -> Result<(), RefineError> {
    let (n_views, n_tracks) = (tracks.n_views(), tracks.n_tracks());
    let held = &options.held;
    let unless_empty = |found: usize, expected: usize| if found == 0 { expected } else { found };
    let sensors = options.rig.as_ref().map_or(tracks.len(), |rig| rig.sensor.len());
    for (name, found, expected) in [
        ("centers", start.centers.len(), n_views),
        ("cam_from_world", start.cam_from_world.len(), n_views),
        ("view_component", start.view_component.len(), n_views),
        ("points", start.points.len(), n_tracks),
        ("track_component", start.track_component.len(), n_tracks),
        ("held rotations", unless_empty(held.rotations.len(), n_views), n_views),
        ("held centers", unless_empty(held.centers.len(), n_views), n_views),
        ("held points", unless_empty(held.points.len(), n_tracks), n_tracks),
        ("sensor", sensors, tracks.len()),
    ] {
        if found != expected {
            return Err(RefineError::Length { name, found, expected });
        }
    }
    if let Some(rig) = &options.rig {
        if let Some(o) = rig.sensor.iter().position(|&s| s as usize >= rig.center.len()) {
            let (sensor, n) = (rig.sensor[o], rig.center.len());
            return Err(RefineError::Option(format!("sensor[{o}] is {sensor}, expected an index below {n}")));
        }
        if let Some(s) = rig.center.iter().position(|c| c.iter().any(|x| !x.is_finite())) {
            return Err(RefineError::Option(format!("the centre of sensor {s} is not finite")));
        }
    }
    if options.huber_sigmas.is_nan() || options.huber_sigmas <= 0.0 {
        return Err(RefineError::Option(format!("huber_sigmas is {}, expected more than 0", options.huber_sigmas)));
    }
    priors::check(&options.priors, n_views)
}

/// An answer in which nothing is determined yet.
fn nothing_refined<const D: usize>(tracks: &Tracks<D>, start: &Structure<D>) -> Structure<D> {
    Structure {
        centers: vec![[f64::NAN; D]; tracks.n_views()],
        points: vec![[f64::NAN; D]; tracks.n_tracks()],
        view_component: vec![-1; tracks.n_views()],
        track_component: vec![-1; tracks.n_tracks()],
        inlier: vec![false; tracks.len()],
        residual_rad: vec![f64::NAN; tracks.len()],
        cam_from_world: start.cam_from_world.clone(),
        summary: Summary {
            status: Status::Undetermined,
            iterations: 0,
            sigma_rad: f64::NAN,
            n_components: 0,
            timings: Timings::default(),
        },
    }
}

fn is_finite<const D: usize>(x: &Vector<D>) -> bool {
    x.iter().all(|v| v.is_finite())
}

/// Numbers of the components, ascending.
fn components_of_views<const D: usize>(start: &Structure<D>) -> std::collections::BTreeSet<i32> {
    start.view_component.iter().copied().filter(|&c| c >= 0).collect()
}

/// Component of each track: its own, or that of most of the views that see it.
fn components_of_tracks<const D: usize>(tracks: &Tracks<D>, start: &Structure<D>) -> Vec<i32> {
    let mut component = start.track_component.clone();
    for (c, point) in component.iter_mut().zip(&start.points) {
        if !is_finite(point) {
            *c = -1;
        }
    }
    let mut votes: Vec<std::collections::BTreeMap<i32, usize>> = Vec::new();
    votes.resize_with(tracks.n_tracks(), Default::default);
    for (&view, &track) in tracks.view().iter().zip(tracks.track()) {
        let c = start.view_component[view as usize];
        if c >= 0 && component[track as usize] < 0 {
            *votes[track as usize].entry(c).or_insert(0) += 1;
        }
    }
    for (c, votes) in component.iter_mut().zip(&votes) {
        if *c < 0
            && let Some((&best, &n)) = votes.iter().max_by_key(|&(&c, &n)| (n, std::cmp::Reverse(c)))
            && n > 1
        {
            *c = best;
        }
    }
    component
}

/// One component, laid out in a frame of its own: centroid of the centres at zero, their rms distance one.
struct Piece<const D: usize> {
    /// View of each node.
    views: Vec<u32>,
    part: Part<D>,
    sights: Sights<D>,
    poses: Poses<D>,
    points: Vec<Lanes>,
    priors: PartPriors<D>,
    /// Rows of observations that each view needs, so that its unknowns are determined.
    wanted: Vec<usize>,
    /// Unknowns that stay zero: those of views that are held, and a gauge.
    held: Vec<bool>,
    /// From the frame of the answer to that of the piece; no rotation.
    piece_from_world: Similarity<D>,
    gauge: Gauge<D>,
    /// What the judgement of what is determined leaves out: how well priors fix a similarity is their own affair.
    judged_up_to: Gauge<D>,
    huber_sigmas: f64,
}

impl<const D: usize> Piece<D> {
    /// The component's views with what they see; `None` where that is nothing.
    fn lay_out(
        tracks: &Tracks<D>,
        start: &Structure<D>,
        component_of_track: &[i32],
        component: i32,
        options: &RefineOptions<D>,
    ) -> Result<Option<Self>, RefineError> {
        let is_member = |v: usize| start.view_component[v] == component && is_finite(&start.centers[v]);
        let views: Vec<u32> = (0..tracks.n_views()).filter(|&v| is_member(v)).map(|v| v as u32).collect();
        let mut nodes = vec![u32::MAX; tracks.n_views()];
        for (node, &view) in views.iter().enumerate() {
            nodes[view as usize] = node as u32;
        }
        let node_of = |view: u32| Some(nodes[view as usize]).filter(|&node| node != u32::MAX);
        let belongs = |o: &u32| {
            let (view, track) = (tracks.view()[*o as usize], tracks.track()[*o as usize]);
            node_of(view).is_some() && component_of_track[track as usize] == component
        };
        let observations: Vec<u32> = (0..tracks.len() as u32).filter(belongs).collect();
        if observations.is_empty() {
            return Ok(None);
        }
        let world_from_start = align::world_from_start(&views, start, options);
        let centers: Vec<Vector<D>> =
            views.iter().map(|&v| world_from_start.apply(&start.centers[v as usize])).collect();
        let piece_from_world = unit_frame(&centers);
        let priors = PartPriors::of(&options.priors, node_of, &piece_from_world, options.huber_sigmas)?;
        let place = |x: &Vector<D>| Lanes::from_vector::<D>(&piece_from_world.apply(&world_from_start.apply(x)));
        let poses = Poses {
            cam_from_world: turned(&views, start, &world_from_start.rotation.inverse()),
            centers: views.iter().map(|&v| place(&start.centers[v as usize])).collect(),
        };
        let stations = Levers::of(&observations, tracks, &nodes, options.rig.as_ref());
        let known = |t: usize| is_finite(&start.points[t]);
        let holds_points = options
            .held
            .points
            .iter()
            .enumerate()
            .any(|(t, held)| *held && component_of_track[t] == component && known(t));
        let has_levers = stations.lever.iter().any(|a| a.iter().any(|x| *x != 0.0));
        let gauge = Gauge::of(&views, &poses.centers, &options.held, &priors, holds_points, has_levers);
        let holds = holds_any(&options.held, &views);
        let judged_up_to = if holds { gauge.clone() } else { Gauge::whole(&poses.centers, has_levers) };
        let free = free_unknowns::<D>(&views, &options.held);
        let known_rows = priors.rows(views.len());
        let wanted = free.iter().zip(&known_rows).map(|(free, known)| free.saturating_sub(*known)).collect();
        let precision = precisions(tracks).map(|(_, precision)| precision);
        let part = Part::new(
            Stations { node: stations.node.clone(), node_freedom: free, gauge_freedom: gauge.dim() },
            tracks.n_tracks(),
            &observations,
            tracks.track(),
            |o| stations.station(nodes[tracks.view()[o] as usize], sensor_of(options.rig.as_ref(), o)),
            |o| {
                let mut bearing = Lanes::from_vector::<D>(&tracks.bearing()[o]);
                bearing.0[3] = precision.as_ref().map_or(1.0, |p| p[o]);
                bearing
            },
        )
        .holding(|t| options.held.points.get(t as usize) == Some(&true) && known(t as usize));
        let points = part.input_track.iter().map(|&t| place(&start.points[t as usize])).collect();
        let lever = stations.lever.iter().map(|a| crate::geometry::scale(piece_from_world.scale, a)).collect();
        let sights = Sights { bearing: part.ray.clone(), lever };
        let huber_sigmas = options.huber_sigmas;
        let held = held_unknowns(&part, &views, &options.held, &gauge);
        Ok(Some(Self {
            views,
            part,
            sights,
            poses,
            points,
            priors,
            wanted,
            held,
            piece_from_world,
            gauge,
            judged_up_to,
            huber_sigmas,
        }))
    }

    /// Refines until observations and noise have settled.
    fn refine<const V: usize>(
        &self,
        options: &RefineOptions<D>,
        timings: &mut Timings,
    ) -> Result<Refined<D>, LeastSquaresError> {
        let clock = Instant::now();
        let mut system = CameraSystem::<D, V, PoseRow>::analyse(&self.part, options.linear_solver, self.held.clone())?;
        timings.analyse_s += clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let mut state = State::new(&self.sights, &self.part, self.poses.clone(), self.points.clone());
        if let Some(estimate) = state.estimate.clone().completed(&state.part) {
            state.estimate = estimate;
        }
        let given = Given {
            sights: &self.sights,
            priors: &self.priors,
            wanted: &self.wanted,
            judges: options.reject_outliers,
            huber_sigmas: self.huber_sigmas,
        };
        let mut refined = settle(&given, &mut system, state, options.max_iterations)?;
        timings.descent_s += clock.elapsed().as_secs_f64();
        refined.loose |= self.is_loose(&mut system, &refined)?;
        if self.gauge.is_free() {
            self.align_to_start(&mut refined.state);
        }
        Ok(refined)
    }

    /// Do the kept observations leave a freedom beyond the gauge, as far as the noise lets one tell?
    fn is_loose<const V: usize>(
        &self,
        system: &mut CameraSystem<D, V, PoseRow>,
        refined: &Refined<D>,
    ) -> Result<bool, LeastSquaresError> {
        if refined.sigma.is_nan() || refined.sigma > MEANINGLESS_RAD {
            return Ok(true);
        }
        let State { poses, part, estimate } = &refined.state;
        let residuals = Residuals { part, keep: &refined.active, huber: self.huber_sigmas * refined.sigma };
        let weights = NewtonWeights { residuals, estimate };
        let turns = Turns { part, centers: &poses.centers, points: &estimate.points, vectors: &[] };
        let terms = self.priors.terms(poses, refined.sigma);
        system.assemble(part, &weights, &turns, &terms, Damping { point: GUARD, view: GUARD });
        match system.factorise() {
            Err(LeastSquaresError::Singular { .. }) => return Ok(true),
            other => other?,
        }
        let mut basis = self.judged_up_to.basis::<V>(&poses.centers);
        for freedom in &mut basis {
            // views that nothing tells of do not move
            freedom.iter_mut().zip(system.diagonal()).filter(|(_, d)| **d <= 0.0).for_each(|(x, _)| *x = 0.0);
        }
        let gauge = GaugeBasis::new(basis);
        let step_of =
            |x: &[f64]| PoseStep::<D, V> { layout: part, centers: &poses.centers, step: x.as_chunks::<V>().0.to_vec() };
        weakest_mode_is_loose(system, &weights, &gauge, step_of, refined.sigma)
    }

    /// Takes out what the gauge let drift: the mean turn of the views, their centroid and, where nothing fixes it, their rms
    /// distance from it are those of the start again.
    fn align_to_start(&self, state: &mut State<D>) {
        let mut correlation = [[0.0; D]; D];
        for (before, after) in self.poses.cam_from_world.iter().zip(&state.poses.cam_from_world) {
            let turn = before.inverse().compose(after);
            for r in 0..D {
                for c in 0..D {
                    correlation[r][c] += turn.matrix()[r][c];
                }
            }
        }
        let rotation = nearest_rotation(&correlation).unwrap_or(Rotation::identity());
        let pairs: Vec<(Vector<D>, Vector<D>)> = (state.poses.centers.iter().zip(&self.poses.centers))
            .map(|(after, before)| (rotation.apply(&after.vector::<D>()), before.vector::<D>()))
            .collect();
        let start_from_end = if self.gauge.scale {
            let Some(shift) = Similarity::fit_unrotated(&pairs) else { return };
            Similarity { rotation, ..shift }
        } else {
            // lever arms fix the size
            Similarity { scale: 1.0, rotation, translation: mean_difference(&pairs) }
        };
        let place = |x: &mut Lanes| *x = Lanes::from_vector::<D>(&start_from_end.apply(&x.vector::<D>()));
        state.poses.centers.iter_mut().for_each(place);
        state.estimate.centers.iter_mut().for_each(place);
        state.estimate.points.iter_mut().for_each(place);
        let inverse = rotation.inverse();
        state.poses.cam_from_world.iter_mut().for_each(|r| *r = r.compose(&inverse));
    }

    /// Writes down what is determined: points that two views or more still see, views that see as many of these as
    /// their unknowns need. False where that is no view at all.
    fn write(&self, refined: &Refined<D>, component: i32, answer: &mut Structure<D>) -> bool {
        let world_from_piece = |x: &Lanes| {
            let Similarity { scale, translation, .. } = self.piece_from_world;
            crate::geometry::scale(1.0 / scale, &crate::geometry::sub(&x.vector::<D>(), &translation))
        };
        let (state, part) = (&refined.state, &refined.state.part);
        let told = without_starved(part, &refined.inlier, &self.wanted);
        let mut is_known = vec![false; self.views.len()];
        for o in (0..part.n_observations()).filter(|&o| told[o]) {
            is_known[part.node_of(o) as usize] = true;
        }
        for (node, &view) in self.views.iter().enumerate().filter(|(node, _)| is_known[*node]) {
            let view = view as usize;
            answer.centers[view] = world_from_piece(&state.poses.centers[node]);
            answer.cam_from_world[view] = state.poses.cam_from_world[node];
            answer.view_component[view] = component;
        }
        for (j, &track) in part.input_track.iter().enumerate() {
            if !part.holds_point(j) && !part.observations(j).any(|o| told[o]) {
                continue;
            }
            answer.points[track as usize] = world_from_piece(&state.estimate.points[j]);
            answer.track_component[track as usize] = component;
            for o in part.observations(j).filter(|&o| is_known[part.node_of(o) as usize]) {
                let input = part.input_observation[o] as usize;
                answer.inlier[input] = told[o];
                let chord = refined.chord[o] / state.part.ray[o].0[3].sqrt();
                answer.residual_rad[input] = 2.0 * (0.5 * chord).min(1.0).asin();
            }
        }
        is_known.contains(&true)
    }

    /// What is held is that of the start to the last bit: the frame of the piece and back would round it.
    fn restore_held(&self, start: &Structure<D>, held: &Held, answer: &mut Structure<D>) {
        let is_held = |list: &[bool], k: usize| list.get(k) == Some(&true);
        for view in self.views.iter().map(|&v| v as usize).filter(|&v| answer.view_component[v] >= 0) {
            if is_held(&held.rotations, view) {
                answer.cam_from_world[view] = start.cam_from_world[view];
            }
            if is_held(&held.centers, view) {
                answer.centers[view] = start.centers[view];
            }
        }
        for (j, &track) in self.part.input_track.iter().enumerate() {
            if self.part.holds_point(j) && answer.track_component[track as usize] >= 0 {
                answer.points[track as usize] = start.points[track as usize];
            }
        }
    }
}

/// Mean of the second of each pair less that of the first.
fn mean_difference<const D: usize>(pairs: &[(Vector<D>, Vector<D>)]) -> Vector<D> {
    let n = pairs.len().max(1) as f64;
    std::array::from_fn(|c| pairs.iter().map(|(a, b)| b[c] - a[c]).sum::<f64>() / n)
}

/// Where a refinement ended.
struct Refined<const D: usize> {
    state: State<D>,
    inlier: Vec<bool>,
    /// Chord between ray and prediction, times the root of the precision.
    chord: Vec<f64>,
    sigma: f64,
    iterations: usize,
    converged: bool,
    /// The inliers that the last descent used.
    active: Vec<bool>,
    /// More is free than the gauge; for one, so few tracks may show parallax that the views cannot be told from one place.
    loose: bool,
}

impl<const D: usize> Refined<D> {
    fn status(&self) -> Status {
        match (self.converged, self.loose) {
            (_, true) => Status::Ambiguous,
            (true, false) => Status::Converged,
            (false, false) => Status::MaxIterations,
        }
    }
}

/// Most rounds in which observations are judged anew before the last.
const MAX_ROUNDS: usize = 12;
/// Steps of such a round.
const ROUND_ITERATIONS: usize = 6;
/// Rounds go on while the noise falls by more than this share.
const NOISE_FALLS: f64 = 0.03;

/// Rounds of a few steps, each on the observations that agree so far; then to the minimum.
///
/// Orientations that err by degrees leave errors far beyond the noise. The limit is a multiple of the errors found, which
/// shrink from round to round.
fn settle<const D: usize, const V: usize>(
    given: &Given<'_, D>,
    system: &mut CameraSystem<D, V, PoseRow>,
    mut state: State<D>,
    max_iterations: usize,
) -> Result<Refined<D>, LeastSquaresError> {
    repair_cheirality(&state.part, &mut state.estimate);
    let errors = chords(&state.part, &state.estimate);
    let mut sigma = noise_scale(&state.part, &errors, |_| true);
    let first_limit = if given.judges { FIRST_OUTLIER_SIGMAS * sigma } else { f64::INFINITY };
    let mut inlier = inliers(&state.part, &errors, first_limit);
    let mut iterations = 0;
    for _ in 0..MAX_ROUNDS {
        let parallel = without_parallax(&state.part, &inlier, sigma);
        let active = without_tracks(&state.part, &inlier, &parallel.left_out);
        let active = without_starved(&state.part, &active, given.wanted);
        let effort = Effort::rough(max_iterations.min(ROUND_ITERATIONS), state.part.n_observations());
        iterations += descend(given, system, &mut state, &active, sigma, effort)?.iterations;
        let before = sigma;
        sigma = noise_scale(&state.part, &chords(&state.part, &state.estimate), |o| active[o]);
        if given.judges {
            inlier = reconsider(&state.part, &mut state.estimate, &parallel.left_out, sigma);
        }
        if sigma > (1.0 - NOISE_FALLS) * before {
            break;
        }
    }
    let refined = finish(given, system, state, inlier, sigma, max_iterations)?;
    Ok(Refined { iterations: refined.iterations + iterations, ..refined })
}

/// The last round, to the minimum.
fn finish<const D: usize, const V: usize>(
    given: &Given<'_, D>,
    system: &mut CameraSystem<D, V, PoseRow>,
    mut state: State<D>,
    keep: Vec<bool>,
    sigma: f64,
    max_iterations: usize,
) -> Result<Refined<D>, LeastSquaresError> {
    let parallel = without_parallax(&state.part, &keep, sigma);
    let active = without_tracks(&state.part, &keep, &parallel.left_out);
    let active = without_starved(&state.part, &active, given.wanted);
    let descent = descend(given, system, &mut state, &active, sigma, Effort::full(max_iterations))?;
    let sigma = noise_scale(&state.part, &chords(&state.part, &state.estimate), |o| active[o]);
    let inlier = look_again(given, &mut state, &parallel.left_out, sigma);
    let chord = chords(&state.part, &state.estimate);
    let kept: Vec<bool> = active.iter().zip(&inlier).map(|(a, i)| *a && *i).collect();
    let sigma = sigma_of_inliers(&state.part, &chord, &kept).unwrap_or(sigma);
    Ok(Refined {
        inlier,
        chord,
        sigma,
        iterations: descent.iterations,
        converged: descent.converged,
        loose: parallel.everything,
        active,
        state,
    })
}

/// Judges all observations. Where the caller wants them all to count, points stay at the minimum of all but for those
/// that the descent left out.
fn look_again<const D: usize>(given: &Given<'_, D>, state: &mut State<D>, left_out: &[bool], sigma: f64) -> Vec<bool> {
    let before = state.estimate.points.clone();
    let inlier = reconsider(&state.part, &mut state.estimate, left_out, sigma);
    if given.judges {
        return inlier;
    }
    for (j, point) in before.into_iter().enumerate().filter(|(j, _)| !left_out[*j]) {
        state.estimate.points[j] = point;
    }
    inliers(&state.part, &chords(&state.part, &state.estimate), OUTLIER_SIGMAS * sigma)
}

/// The kept observations less those of views that have too few to be determined, and of points that lose their second view
/// with these.
fn without_starved<const D: usize>(part: &Part<D>, keep: &[bool], wanted: &[usize]) -> Vec<bool> {
    let mut kept = keep.to_vec();
    loop {
        for j in (0..part.n_tracks()).filter(|&j| !part.holds_point(j)) {
            let mut nodes = part.observations(j).filter(|&o| kept[o]).map(|o| part.node_of(o));
            let first = nodes.next();
            if !nodes.any(|node| Some(node) != first) {
                kept[part.observations(j)].fill(false);
            }
        }
        let mut rows = vec![0; part.n_nodes];
        (0..part.n_observations()).filter(|&o| kept[o]).for_each(|o| rows[part.node_of(o) as usize] += D - 1);
        let is_starved = |o: usize| rows[part.node_of(o) as usize] < wanted[part.node_of(o) as usize];
        let starved: Vec<usize> = (0..part.n_observations()).filter(|&o| kept[o] && is_starved(o)).collect();
        if starved.is_empty() {
            return kept;
        }
        starved.into_iter().for_each(|o| kept[o] = false);
    }
}

/// Stations of a component: pairs of a node and a sensor that made an observation, with their lever arms.
struct Levers<const D: usize> {
    node: Vec<u32>,
    sensor: Vec<u32>,
    lever: Vec<Vector<D>>,
}

fn sensor_of<const D: usize>(rig: Option<&Rig<D>>, o: usize) -> u32 {
    rig.map_or(0, |rig| rig.sensor[o])
}

impl<const D: usize> Levers<D> {
    fn of(observations: &[u32], tracks: &Tracks<D>, nodes: &[u32], rig: Option<&Rig<D>>) -> Self {
        let station = |&o: &u32| (nodes[tracks.view()[o as usize] as usize], sensor_of(rig, o as usize));
        let mut used: Vec<(u32, u32)> = observations.iter().map(station).collect();
        // nodes that made no observation of the component have a station nevertheless: numbers stay in step
        let n_nodes = nodes.iter().filter(|&&node| node != u32::MAX).count() as u32;
        used.extend((0..n_nodes).map(|node| (node, 0)));
        used.sort_unstable();
        used.dedup();
        let arm = |sensor: u32| rig.and_then(|rig| rig.center.get(sensor as usize)).copied().unwrap_or([0.0; D]);
        Self {
            node: used.iter().map(|&(node, _)| node).collect(),
            sensor: used.iter().map(|&(_, sensor)| sensor).collect(),
            lever: used.iter().map(|&(_, sensor)| arm(sensor)).collect(),
        }
    }

    fn station(&self, node: u32, sensor: u32) -> u32 {
        let first = self.node.partition_point(|&n| n < node);
        let within = self.node[first..].iter().zip(&self.sensor[first..]);
        (first + within.take_while(|&(&n, &s)| n == node && s < sensor).count()) as u32
    }
}

fn turned<const D: usize>(views: &[u32], start: &Structure<D>, start_from_world: &Rotation<D>) -> Vec<Rotation<D>> {
    views.iter().map(|&v| start.cam_from_world[v as usize].compose(start_from_world)).collect()
}

/// Centroid to zero, rms distance from it to one.
fn unit_frame<const D: usize>(centers: &[Vector<D>]) -> Similarity<D> {
    let n = centers.len().max(1) as f64;
    let mean: Vector<D> = std::array::from_fn(|c| centers.iter().map(|x| x[c]).sum::<f64>() / n);
    let squared: f64 =
        centers.iter().map(|x| crate::geometry::sub(x, &mean)).map(|d| crate::geometry::dot(&d, &d)).sum();
    // centres that differ in their last digits only stand in one place
    let rounding = (1e-14 * crate::geometry::norm(&mean)).powi(2) * n;
    let scale = if squared > rounding { (n / squared).sqrt() } else { 1.0 };
    Similarity { scale, rotation: Rotation::identity(), translation: mean.map(|x| -scale * x) }
}

/// Unknowns of each view that the caller does not hold.
fn free_unknowns<const D: usize>(views: &[u32], held: &Held) -> Vec<usize> {
    let is_held = |list: &[bool], view: u32| list.get(view as usize) == Some(&true);
    let free = |&v: &u32| {
        let (turn, place) = (is_held(&held.rotations, v), is_held(&held.centers, v));
        usize::from(!turn) * turns(D) + usize::from(!place) * D
    };
    views.iter().map(free).collect()
}

/// Does the caller hold anything of these views, or any point?
fn holds_any(held: &Held, views: &[u32]) -> bool {
    let of_views = |list: &[bool]| views.iter().any(|&v| list.get(v as usize) == Some(&true));
    of_views(&held.rotations) || of_views(&held.centers) || held.points.contains(&true)
}

/// Unknowns that stay zero: what the caller holds, and of the node that saw most as much of its pose as nothing else fixes.
/// The scale is left to the damping.
fn held_unknowns<const D: usize>(part: &Part<D>, views: &[u32], held: &Held, gauge: &Gauge<D>) -> Vec<bool> {
    let (n_turns, unknowns) = (turns(D), turns(D) + D);
    let mut zero = vec![false; views.len() * unknowns];
    for (node, &view) in views.iter().enumerate() {
        if held.rotations.get(view as usize) == Some(&true) {
            zero[node * unknowns..node * unknowns + n_turns].fill(true);
        }
        if held.centers.get(view as usize) == Some(&true) {
            zero[node * unknowns + n_turns..(node + 1) * unknowns].fill(true);
        }
    }
    for k in gauge.pinned_unknowns(most_observed_node(part)) {
        zero[k] = true;
    }
    zero
}
