//! Cameras and paths together: `min sum rho(|v - u/|u|| / sigma)`, `u = sum_l B_l(t) p_l - c`, over the poses of all views,
//! the vectors of all paths and the frequencies that are sought.
//!
//! The vectors of each path are eliminated as the position of a point at rest is, so the system to solve has the cameras
//! alone (`bundle::courses`). Where orientations are known, turns are held.

use std::sync::Arc;

use rayon::prelude::*;

use super::basis::Form;
use super::track::vectors_of;
use crate::bundle::courses::CourseSystem;
use crate::bundle::estimate::{Estimate, squared_chord};
use crate::bundle::levenberg::{Descent, Effort, Problem, minimise};
use crate::bundle::newton::{
    CameraStep, NewtonWeights, Residuals, chord_model, follow_cameras, huber_cost, sum_in_chunks,
};
use crate::bundle::noise::{FIRST_OUTLIER_SIGMAS, OUTLIER_SIGMAS, SIGMA_FLOOR_RAD, sigma_from_chords};
use crate::bundle::part::{Courses, Lanes, Part};
use crate::bundle::reduced::{Damping, Quadratic, ReducedSystem, Weighing};
use crate::bundle::turns::{PoseRow, PoseStep, Turns, shift_of, turns};
use crate::geometry::{Rotation, apply};
use crate::least_squares::LeastSquaresError;

/// What does not change while cameras and paths are sought.
pub(super) struct Given<'a, const D: usize> {
    /// Bearings in the cameras, with the precision in lane 3, in the order of the part.
    pub bearing: &'a [Lanes],
    /// Time of each station.
    pub time_s: &'a [f64],
    /// Are orientations sought too?
    pub turns: bool,
}

/// Where cameras and paths stand; the rays of `part` follow from the orientations, its courses from the frequencies.
#[derive(Clone)]
pub(super) struct State<const D: usize> {
    pub cam_from_world: Vec<Rotation<D>>,
    pub part: Part<D>,
    pub estimate: Estimate,
    /// Vectors of all paths, those at rest included.
    pub vectors: Vec<Lanes>,
    /// Form of each track of the part.
    pub forms: Arc<Vec<Form>>,
}

impl<const D: usize> State<D> {
    /// Where the point of a track is at one of its observations.
    #[inline(always)]
    pub fn position(&self, o: usize, j: usize) -> Lanes {
        self.part.position(o, j, &self.estimate.points, &self.vectors)
    }

    /// Chord of every observation in units of the reference sigma's radian.
    pub fn chords(&self) -> Vec<f64> {
        let part = &self.part;
        let chunks = part.chunks.par_iter().map(|tracks| {
            let of = |(o, j)| self.squared_error(o, j).sqrt();
            tracks.clone().flat_map(|j| part.observations(j).map(move |o| (o, j))).map(of).collect::<Vec<f64>>()
        });
        chunks.collect::<Vec<_>>().concat()
    }

    #[inline(always)]
    fn squared_error(&self, o: usize, j: usize) -> f64 {
        let ray = &self.part.ray[o];
        let center = &self.estimate.centers[self.part.view[o] as usize];
        squared_chord::<D>(ray, &self.position(o, j), center).0 * ray.0[3]
    }

    /// Turns the rays as the orientations say.
    fn turn_rays(&mut self, given: &Given<'_, D>) {
        let world_from_cam: Vec<Rotation<D>> = self.cam_from_world.iter().map(Rotation::inverse).collect();
        let part = &self.part;
        let turn = |(o, bearing): (usize, &Lanes)| {
            let matrix = world_from_cam[part.node_of(o) as usize].matrix();
            let mut ray = Lanes::from_vector::<D>(&apply(matrix, &bearing.vector::<D>()));
            ray.0[3] = bearing.0[3];
            ray
        };
        self.part.ray = given.bearing.par_iter().enumerate().with_min_len(4096).map(turn).collect();
    }

    /// Functions of all paths at all observations, and what bends them, as forms and vectors say.
    pub fn lay_courses(&mut self, given: &Given<'_, D>) {
        let part = &self.part;
        let old = &part.courses;
        let mut courses = Courses { start: old.start.clone(), is_bent: old.is_bent.clone(), ..Courses::default() };
        let has_bends = courses.is_bent.contains(&true);
        courses.first.reserve(part.n_observations());
        for j in 0..part.n_tracks() {
            let form = &self.forms[j];
            let k = form.len();
            let mut slope = vec![0.0; k];
            let (middle, half) = self.seen(given, j);
            for o in part.observations(j) {
                courses.first.push(courses.values.len() as u32);
                let time = given.time_s[part.view[o] as usize];
                let begin = courses.values.len();
                courses.values.resize(begin + k, 0.0);
                form.values(time, 0, &mut courses.values[begin..]);
                if has_bends {
                    let mut bend = Lanes::ZERO;
                    if let (true, Form::Fourier { omega_rad_s, .. }) = (courses.is_bent(j), form) {
                        // a harmonic depends on omega (t - middle) and on its phase there
                        form.values(time, 1, &mut slope);
                        let own = &self.vectors[courses.vectors(j)];
                        let rate = (time - middle) / (half * omega_rad_s);
                        bend = slope.iter().zip(own).fold(bend, |sum, (b, p)| sum.plus_scaled(rate * b, p));
                    }
                    courses.bends.push(bend);
                }
            }
        }
        self.part.courses = Arc::new(courses);
    }

    /// Middle of the time that a track was seen, and half of its length.
    fn seen(&self, given: &Given<'_, D>, j: usize) -> (f64, f64) {
        let times = self.part.observations(j).map(|o| given.time_s[self.part.view[o] as usize]);
        let [first, last] = times.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], t| [a.min(t), b.max(t)]);
        let half = 0.5 * (last - first);
        (0.5 * (first + last), if half > 0.0 { half } else { 1.0 })
    }

    /// Changes the frequency of a path by `change` radians in half of the time that it was seen; in the middle of that it
    /// stays where it is.
    fn bend(&mut self, given: &Given<'_, D>, j: usize, change: f64) {
        let (middle, half) = self.seen(given, j);
        let own = self.part.courses.vectors(j);
        let Some(Form::Fourier { omega_rad_s, .. }) = Arc::make_mut(&mut self.forms).get_mut(j) else { return };
        let before = *omega_rad_s;
        // a frequency keeps its sign, and its size to within half
        *omega_rad_s *= (1.0 + change / (half * before)).clamp(0.5, 2.0);
        let turn = (*omega_rad_s - before) * middle;
        for (l, pair) in
            self.vectors[own].get_mut(1..).unwrap_or_default().as_chunks_mut::<2>().0.iter_mut().enumerate()
        {
            let (sin, cos) = ((l + 1) as f64 * turn).sin_cos();
            let [even, odd] = *pair;
            *pair = [even.times(cos).plus_scaled(-sin, &odd), even.times(sin).plus_scaled(cos, &odd)];
        }
    }

    /// Poses after a step of `V` unknowns a view; points and paths stay.
    fn moved<const V: usize>(&self, step: &[[f64; V]], given: &Given<'_, D>) -> Self {
        let mut next = self.clone();
        for (center, x) in next.estimate.centers.iter_mut().zip(step) {
            *center = center.plus(&shift_of::<D, V>(x));
        }
        if given.turns {
            for (rotation, x) in next.cam_from_world.iter_mut().zip(step) {
                *rotation = rotation.compose(&Rotation::exp_of(&x[..turns(D)]));
            }
            next.turn_rays(given);
        }
        next
    }
}

/// Gauss-Newton's model of every observation, of points at rest and moving.
pub(super) struct CourseWeights<'a, const D: usize> {
    pub state: &'a State<D>,
    pub keep: &'a [bool],
    pub huber: f64,
}

impl<const D: usize> Weighing<D> for CourseWeights<'_, D> {
    #[inline(always)]
    fn observe(&self, o: usize, j: usize) -> Quadratic {
        let state = self.state;
        let center = &state.estimate.centers[state.part.view[o] as usize];
        chord_model::<D>(&state.part.ray[o], &state.position(o, j), center, self.keep[o], self.huber)
    }

    #[inline(always)]
    fn depth_axis(&self, j: usize) -> Lanes {
        let state = self.state;
        let o = state.part.start[j] as usize;
        let u = state.position(o, j).minus(&state.estimate.centers[state.part.view[o] as usize]);
        u.times(1.0 / u.dot::<D>(&u).sqrt().max(f64::MIN_POSITIVE))
    }
}

/// The system of all poses.
pub(super) type PoseSystem<const D: usize, const V: usize> = ReducedSystem<D, V, PoseRow>;

/// Minimises over the kept observations, from `state` as it stands.
fn descend<const D: usize, const V: usize>(
    given: &Given<'_, D>,
    system: &mut PoseSystem<D, V>,
    state: &mut State<D>,
    keep: &[bool],
    sigma: f64,
    effort: Effort,
) -> Result<Descent, LeastSquaresError> {
    let huber = crate::bundle::noise::HUBER_SIGMAS * sigma;
    let costs = costs(state, keep, huber);
    let kept = keep.iter().filter(|&&k| k).count();
    let cost = sum_in_chunks(&state.part, &costs);
    let mut problem = Bodies { given, system, state, keep, huber, cost, costs };
    match minimise(&mut problem, kept, sigma, effort) {
        Err(LeastSquaresError::Singular { .. }) => Ok(Descent { iterations: 0, converged: false }),
        ended => ended,
    }
}

/// Robust cost of each track.
fn costs<const D: usize>(state: &State<D>, keep: &[bool], huber: f64) -> Vec<f64> {
    (0..state.part.n_tracks()).into_par_iter().with_min_len(256).map(|j| track_cost(state, keep, huber, j)).collect()
}

fn track_cost<const D: usize>(state: &State<D>, keep: &[bool], huber: f64, j: usize) -> f64 {
    let kept = state.part.observations(j).filter(|&o| keep[o]);
    kept.map(|o| huber_cost(state.squared_error(o, j), huber)).sum()
}

struct Bodies<'a, const D: usize, const V: usize> {
    given: &'a Given<'a, D>,
    system: &'a mut PoseSystem<D, V>,
    state: &'a mut State<D>,
    keep: &'a [bool],
    huber: f64,
    cost: f64,
    /// Of each track.
    costs: Vec<f64>,
}

impl<const D: usize, const V: usize> Problem for Bodies<'_, D, V> {
    type Candidate = (State<D>, Vec<f64>);

    fn cost(&self) -> f64 {
        self.cost
    }

    fn propose(&mut self, damping: f64) -> Result<(Self::Candidate, f64), LeastSquaresError> {
        let (state, given, huber) = (&*self.state, self.given, self.huber);
        let weights = CourseWeights { state, keep: self.keep, huber };
        let part = &state.part;
        let Estimate { centers, points } = &state.estimate;
        let poses = Turns { part, centers, points, vectors: &state.vectors };
        self.system.assemble(part, &weights, &poses, &[], Damping { point: damping, view: damping });
        let step = self.system.solve()?;
        let mut next = state.moved::<V>(&step, given);
        let follow = PoseStep::<D, V> { layout: part, centers, step };
        let residuals = Residuals { part, keep: self.keep, huber };
        let still = NewtonWeights { residuals, estimate: &state.estimate };
        let (points, mut next_costs) =
            follow_cameras(&still, &self.costs, &follow, &next.part, &next.estimate.centers, damping);
        next.estimate.points = points;
        let moving: Vec<usize> = (0..part.n_tracks()).filter(|&j| part.courses.moves(j)).collect();
        let steps: Vec<Vec<f64>> =
            moving.par_iter().with_min_len(16).map(|&j| path_step(&weights, j, &follow, damping)).collect();
        for (&j, x) in moving.iter().zip(&steps) {
            let own = part.courses.vectors(j);
            for (vector, change) in next.vectors[own.clone()].iter_mut().zip(vectors_of::<D>(x, own.len())) {
                *vector = vector.plus(&change);
            }
            if let (true, Some(change)) = (part.courses.is_bent(j), x.last()) {
                next.bend(given, j, *change);
            }
        }
        if part.courses.is_bent.contains(&true) {
            next.lay_courses(given);
        }
        let moved_costs: Vec<f64> =
            moving.par_iter().with_min_len(64).map(|&j| track_cost(&next, self.keep, huber, j)).collect();
        for (&j, cost) in moving.iter().zip(moved_costs) {
            next_costs[j] = cost;
        }
        let cost = sum_in_chunks(part, &next_costs);
        Ok(((next, next_costs), cost))
    }

    fn accept(&mut self, (state, costs): Self::Candidate, cost: f64) {
        *self.state = state;
        (self.costs, self.cost) = (costs, cost);
    }
}

/// How the unknowns of a path follow a step of the cameras.
fn path_step<const D: usize>(
    weights: &CourseWeights<'_, D>,
    j: usize,
    step: &impl CameraStep,
    damping: f64,
) -> Vec<f64> {
    let part = &weights.state.part;
    let course = part.course(j);
    let models: Vec<Quadratic> = part.observations(j).map(|o| weights.observe(o, j)).collect();
    let mut system = CourseSystem::default();
    if !system.assemble::<D>(course, &models) || !system.factorise(damping) {
        return vec![0.0; course.unknowns(D)];
    }
    let mut x = system.right().to_vec();
    for (k, o) in part.observations(j).enumerate() {
        let displacement = step.displacement(part.view[o] as usize, &weights.state.position(o, j));
        system.add_pull::<D>(k, &displacement, &mut x);
    }
    system.solve(&mut x);
    x
}

/// Where cameras and paths were left.
pub(super) struct Settled<const D: usize> {
    pub state: State<D>,
    pub inlier: Vec<bool>,
    pub chord: Vec<f64>,
    /// Noise estimate, radians at the reference sigma.
    pub sigma: f64,
    pub iterations: usize,
    pub converged: bool,
}

/// Rounds in which observations are judged anew before the last.
const ROUNDS: usize = 6;
/// Steps of such a round.
const ROUND_ITERATIONS: usize = 8;
/// Rounds go on while the noise falls by more than this share.
const NOISE_FALLS: f64 = 0.03;

/// Rounds of a few steps on the observations that agree so far, then to the minimum.
pub(super) fn settle<const D: usize, const V: usize>(
    given: &Given<'_, D>,
    system: &mut PoseSystem<D, V>,
    mut state: State<D>,
    max_iterations: usize,
) -> Result<Settled<D>, LeastSquaresError> {
    let mut sigma = noise(&state, &state.chords(), |_| true);
    let mut keep = agreeing(&state, &state.chords(), FIRST_OUTLIER_SIGMAS * sigma);
    let mut iterations = 0;
    for _ in 0..ROUNDS {
        let effort = Effort::rough(max_iterations.min(ROUND_ITERATIONS), state.part.n_observations());
        iterations += descend(given, system, &mut state, &keep, sigma, effort)?.iterations;
        let before = sigma;
        let chord = state.chords();
        sigma = noise(&state, &chord, |o| keep[o]);
        keep = agreeing(&state, &chord, OUTLIER_SIGMAS * sigma);
        if sigma > (1.0 - NOISE_FALLS) * before {
            break;
        }
    }
    let descent = descend(given, system, &mut state, &keep, sigma, Effort::full(max_iterations))?;
    let chord = state.chords();
    sigma = noise(&state, &chord, |o| keep[o]);
    let inlier = agreeing(&state, &chord, OUTLIER_SIGMAS * sigma);
    let sigma = sigma_of(&state, &chord, &inlier).unwrap_or(sigma);
    Ok(Settled {
        state,
        inlier,
        chord,
        sigma,
        iterations: iterations + descent.iterations,
        converged: descent.converged,
    })
}

/// Observations, and unknowns of cameras and paths, that a set of observations tells of.
fn size_of<const D: usize>(state: &State<D>, among: impl Fn(usize) -> bool) -> (usize, usize) {
    let part = &state.part;
    let (mut observations, mut unknowns) = (0, 0);
    let mut told = vec![false; part.n_nodes];
    for j in 0..part.n_tracks() {
        let kept = part.observations(j).filter(|&o| among(o)).inspect(|&o| told[part.node_of(o) as usize] = true);
        let kept = kept.count();
        observations += kept;
        unknowns += if kept > 0 { part.courses.unknowns(j, D) } else { 0 };
    }
    let of_cameras: usize = part.node_freedom.iter().zip(&told).filter(|(_, told)| **told).map(|(n, _)| n).sum();
    (observations, unknowns + of_cameras.saturating_sub(part.gauge_freedom))
}

fn noise<const D: usize>(state: &State<D>, chord: &[f64], among: impl Fn(usize) -> bool) -> f64 {
    let mut sample: Vec<f64> = (0..chord.len()).filter(|&o| among(o)).map(|o| chord[o]).collect();
    let (observations, unknowns) = size_of(state, among);
    sigma_from_chords::<D>(&mut sample, observations, unknowns).max(SIGMA_FLOOR_RAD)
}

fn sigma_of<const D: usize>(state: &State<D>, chord: &[f64], keep: &[bool]) -> Option<f64> {
    let (observations, unknowns) = size_of(state, |o| keep[o]);
    let freedom = ((D - 1) * observations).checked_sub(unknowns).filter(|&f| f > 0)?;
    let squared: f64 = chord.iter().zip(keep).filter(|(_, k)| **k).map(|(e, _)| e * e).sum();
    Some((squared / freedom as f64).sqrt().max(SIGMA_FLOOR_RAD))
}

/// Observations within a limit of their prediction, of tracks that keep enough of them for their unknowns.
fn agreeing<const D: usize>(state: &State<D>, chord: &[f64], limit: f64) -> Vec<bool> {
    let part = &state.part;
    let mut keep: Vec<bool> = chord.iter().map(|&e| e < limit).collect();
    for j in 0..part.n_tracks() {
        let mut nodes: Vec<u32> = part.observations(j).filter(|&o| keep[o]).map(|o| part.node_of(o)).collect();
        nodes.dedup();
        if nodes.len() < 2 || (D - 1) * nodes.len() < part.courses.unknowns(j, D) {
            keep[part.observations(j)].fill(false);
        }
    }
    keep
}
