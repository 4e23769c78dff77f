//! A start without any initial guess: the linear steps of `positions::start`, with points that move.
//!
//! `min sum w |(I - v v^T) (x(t) - c)|^2` subject to `sum omega v^T (x(t) - c) = 1`, linear in the centres and in the vectors
//! of the paths.

use super::joint::State;
use super::track::vectors_of;
use crate::bundle::courses::CourseSystem;
use crate::bundle::estimate::{normalise, squared_chord, weighted_ray};
use crate::bundle::noise::median;
use crate::bundle::part::{Course, Lanes, Part};
use crate::bundle::reduced::{Damping, Quadratic, ReducedSystem, Translations, Weighing, most_observed_node};
use crate::least_squares::{LeastSquaresError, LinearSolver};

/// Only guards the factorisation: exact data leaves the scale, and what else is free, as null vectors.
const DAMPING: f64 = 1e-12;
/// Where it fails it is raised by this factor, so many times.
const RAISED: f64 = 100.0;
const RAISES: usize = 4;
/// Least noise scale of the weights, radians, and its multiple of the median error.
const SCALE_FLOOR_RAD: f64 = 2e-4;
const SCALE_OVER_MEDIAN: f64 = 2.0;
/// Re-weighting stops when the scale changes by less than this, or after so many rounds.
const SCALE_TOLERANCE: f64 = 0.05;
const ROUNDS: usize = 10;

/// One weight for every observation.
struct Equal<'a, const D: usize>(&'a Part<D>);

impl<const D: usize> Weighing<D> for Equal<'_, D> {
    fn observe(&self, o: usize, _j: usize) -> Quadratic {
        weighted_ray(&self.0.ray[o], 1.0, 1.0)
    }

    fn depth_axis(&self, j: usize) -> Lanes {
        self.0.ray[self.0.start[j] as usize]
    }
}

/// Geman and McClure's weights at a state.
struct Robust<'a, const D: usize> {
    state: &'a State<D>,
    scale: f64,
}

impl<const D: usize> Weighing<D> for Robust<'_, D> {
    fn observe(&self, o: usize, j: usize) -> Quadratic {
        let state = self.state;
        let ray = &state.part.ray[o];
        let center = &state.estimate.centers[state.part.view[o] as usize];
        let (chord, reciprocal) = squared_chord::<D>(ray, &state.position(o, j), center);
        let root = 1.0 / (1.0 + ray.0[3] * chord / (self.scale * self.scale));
        let omega = root * root * reciprocal;
        weighted_ray(ray, omega * reciprocal, omega)
    }

    fn depth_axis(&self, j: usize) -> Lanes {
        self.state.part.ray[self.state.part.start[j] as usize]
    }
}

/// Finds centres and vectors from nothing; orientations, layout and functions are those of the state.
pub(super) fn start<const D: usize>(mut state: State<D>) -> Result<State<D>, LeastSquaresError> {
    let part = state.part.clone();
    let mut held = vec![false; part.n_nodes * D];
    let pinned = most_observed_node(&part);
    held[pinned * D..(pinned + 1) * D].fill(true);
    let mut system = ReducedSystem::<D, D, Lanes>::analyse(&part, LinearSolver::Direct, held)?;
    linear_step(&mut state, &mut system, |_| Equal(&part))?;
    let mut before = f64::INFINITY;
    for _ in 0..ROUNDS {
        let scale = (SCALE_OVER_MEDIAN * median(&mut state.chords())).max(SCALE_FLOOR_RAD);
        if (scale / before - 1.0).abs() < SCALE_TOLERANCE {
            break;
        }
        before = scale;
        let at = state.clone();
        linear_step(&mut state, &mut system, |_| Robust { state: &at, scale })?;
    }
    Ok(state)
}

fn linear_step<const D: usize, W: Weighing<D>>(
    state: &mut State<D>,
    system: &mut ReducedSystem<D, D, Lanes>,
    weighing: impl Fn(()) -> W,
) -> Result<(), LeastSquaresError> {
    let weighing = weighing(());
    let part = state.part.clone();
    let mut damping = Damping { point: 0.0, view: DAMPING };
    let mut raises = 0;
    let solved = loop {
        system.assemble(&part, &weighing, &Translations, &[], damping);
        match system.solve() {
            Err(LeastSquaresError::Singular { .. }) if raises < RAISES => {
                damping.view *= RAISED;
                raises += 1;
            }
            ended => break ended?,
        }
    };
    let mut centers: Vec<Lanes> = solved.iter().map(Lanes::from_vector::<D>).collect();
    let scale = normalise(&mut centers);
    let mut equations = CourseSystem::default();
    for j in 0..part.n_tracks() {
        let models: Vec<Quadratic> = part.observations(j).map(|o| weighing.observe(o, j)).collect();
        let ones;
        let course = if part.courses.moves(j) {
            Course { bends: None, ..part.course(j) }
        } else {
            ones = vec![1.0; models.len()];
            Course { n_functions: 1, values: &ones, bends: None }
        };
        if !equations.assemble::<D>(course, &models) || !equations.factorise(0.0) {
            continue;
        }
        let mut x: Vec<f64> = equations.right().iter().map(|g| g * scale).collect();
        for (k, o) in part.observations(j).enumerate() {
            equations.add_pull::<D>(k, &centers[part.view[o] as usize], &mut x);
        }
        equations.solve(&mut x);
        let found = vectors_of::<D>(&x, course.n_functions);
        if part.courses.moves(j) {
            state.vectors[part.courses.vectors(j)].copy_from_slice(&found);
        } else {
            state.estimate.points[j] = found[0];
        }
    }
    state.estimate.centers = centers;
    Ok(())
}
