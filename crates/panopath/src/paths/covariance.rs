//! Covariances of the vectors of all paths, to first order.
//!
//! A path adds `A_j^-1` to what the cameras that saw it pass on through `A_j^-1 J^T M K`. The covariance of the cameras is
//! in the gauge of the scene, centroid of the centres and their rms distance from it (and their turn, where orientations
//! are sought): `bundle::gauged`.

use rayon::prelude::*;

use super::joint::{CourseWeights, PoseSystem};
use crate::bundle::courses::CourseSystem;
use crate::bundle::determinacy::Motions;
use crate::bundle::gauged::{Fixing, GaugedCovariance, farthest_coordinate};
use crate::bundle::part::Course;
use crate::bundle::reduced::{Damping, Quadratic, Weighing, most_observed_node};
use crate::bundle::turns::{Turns, origin_shift};
use crate::least_squares::{LeastSquaresError, LinearSolver, SelectedInverse, inner, symmetric_eigen_of};

/// Covariances of the vectors of each track of the part, by rows, in its unit; those of tracks that nothing tells of are
/// NaN. `bends` says which observations the cameras rest on, `weights.keep` which tell of the paths.
pub(super) fn covariances<const D: usize, const V: usize>(
    weights: &CourseWeights<'_, D>,
    bends: &[bool],
    free_turns: bool,
    sigma: f64,
) -> Result<Vec<Vec<f64>>, LeastSquaresError> {
    let cameras = of_cameras::<D, V>(weights, bends, free_turns)?;
    let tracks = 0..weights.state.part.n_tracks();
    Ok(tracks.into_par_iter().with_min_len(64).map(|j| of_path(weights, &cameras, j, sigma * sigma)).collect())
}

/// Covariance of all cameras, in the gauge of their centres (and of their turn, where orientations are sought).
fn of_cameras<const D: usize, const V: usize>(
    weights: &CourseWeights<'_, D>,
    bends: &[bool],
    free_turns: bool,
) -> Result<GaugedCovariance<V>, LeastSquaresError> {
    let state = weights.state;
    let part = &state.part;
    let (centers, n_turns) = (&state.estimate.centers, V - D);
    let mut held: Vec<bool> = (0..part.n_nodes * V).map(|k| k % V < n_turns && !free_turns).collect();
    let pinned = most_observed_node(part);
    held[pinned * V..(pinned + 1) * V].fill(true);
    held[farthest_coordinate::<D, V>(centers, &centers[pinned].vector())] = true;
    let mut system = PoseSystem::<D, V>::analyse(part, LinearSolver::Direct, held.clone())?;
    let turning = Turns { part, centers, points: &state.estimate.points, vectors: &state.vectors };
    let bending = CourseWeights { keep: bends, ..*weights };
    system.assemble(part, &bending, &turning, &[], Damping { point: 0.0, view: 0.0 });
    let inverse = SelectedInverse::<V>::new(system.pattern(), system.values())?;
    let axes: Vec<[f64; 3]> = if free_turns {
        (0..n_turns).map(|k| std::array::from_fn(|c| f64::from(c == k))).collect()
    } else {
        Vec::new()
    };
    let motions = Motions { translation: true, axes: &axes, scale: true };
    let basis = motions.of_cameras::<D, V>(centers, &[0.0; D]);
    // W: the centres' part of the basis
    let mut conditions = basis.clone();
    for column in &mut conditions {
        column.chunks_exact_mut(V).for_each(|x| x[..n_turns].fill(0.0));
    }
    let product_inverse = pseudo_inverse(&conditions)?;
    let fixing = Fixing { basis: &basis, conditions: &conditions, product_inverse: &product_inverse };
    GaugedCovariance::new(system.pattern(), &inverse, &held, &fixing)
}

/// `(W^T W)^+`, which is `(W^T G)^+` too: where all centres lie on a line, a turn is left that no centre tells of.
fn pseudo_inverse(conditions: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, LeastSquaresError> {
    let gram: Vec<Vec<f64>> = conditions.iter().map(|w| conditions.iter().map(|g| inner(w, g)).collect()).collect();
    let (sizes, axes) = symmetric_eigen_of(&gram)?;
    let largest = sizes.last().copied().unwrap_or(0.0);
    let n = conditions.len();
    let entry = |r: usize, c: usize| -> f64 {
        let told = (0..n).filter(|&k| sizes[k] > 1e-12 * largest);
        told.map(|k| axes[k][r] * axes[k][c] / sizes[k]).sum()
    };
    Ok((0..n).map(|r| (0..n).map(|c| entry(r, c)).collect()).collect())
}

/// Covariance of the vectors of one path.
fn of_path<const D: usize, const V: usize>(
    weights: &CourseWeights<'_, D>,
    cameras: &GaugedCovariance<V>,
    j: usize,
    variance: f64,
) -> Vec<f64> {
    let state = weights.state;
    let part = &state.part;
    let models: Vec<Quadratic> = part.observations(j).map(|o| weights.observe(o, j)).collect();
    let ones;
    let course = if part.courses.moves(j) {
        part.course(j)
    } else {
        ones = vec![1.0; models.len()];
        Course { n_functions: 1, values: &ones, bends: None }
    };
    let (n, all) = (D * course.n_functions, course.unknowns(D));
    let mut system = CourseSystem::default();
    if !system.assemble::<D>(course, &models) || !system.factorise(0.0) {
        return vec![f64::NAN; n * n];
    }
    let mut covariance = system.inverse();
    // what each camera passes on: `A^-1 J^T M K`, one row of V numbers for each unknown
    let mut passed: Vec<(usize, Vec<[f64; V]>)> = Vec::with_capacity(models.len());
    for (k, o) in part.observations(j).enumerate().filter(|(k, _)| models[*k].direction.0[3] > 0.0) {
        let node = part.node_of(o) as usize;
        let arm = state.position(o, j).minus(&state.estimate.centers[node]);
        let mut rows = vec![[0.0; V]; all];
        for v in 0..V {
            let shift = origin_shift::<D, V>(&std::array::from_fn(|c| f64::from(c == v)), &arm);
            let mut x = vec![0.0; all];
            system.add_pull::<D>(k, &shift, &mut x);
            system.solve(&mut x);
            rows.iter_mut().zip(&x).for_each(|(row, x)| row[v] = *x);
        }
        passed.push((node, rows));
    }
    for (i, (a, rows_a)) in passed.iter().enumerate() {
        for (k, (b, rows_b)) in passed[..=i].iter().enumerate() {
            let Some(block) = cameras.block(*a, *b) else { continue };
            for r in 0..all {
                let left: [f64; V] = std::array::from_fn(|c| (0..V).map(|v| rows_a[r][v] * block[v][c]).sum());
                for c in 0..all {
                    let entry: f64 = (0..V).map(|v| left[v] * rows_b[c][v]).sum();
                    covariance[r * all + c] += entry;
                    if k < i {
                        covariance[c * all + r] += entry;
                    }
                }
            }
        }
    }
    (0..n * n).map(|k| variance * covariance[k / n * all + k % n]).collect()
}
