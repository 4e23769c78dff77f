//! Covariances of the vectors of all paths, to first order.
//!
//! A path adds `A_j^-1` to what the cameras that saw it pass on through `A_j^-1 J^T M K`. The covariance of the cameras is
//! that of `refinement::covariance`: `S^-` from a selected inversion, then brought to the gauge of the scene, centroid of
//! the centres and their rms distance from it (and their turn, where orientations are sought), by `Q = I - G (W^T G)^-1 W^T`.

use rayon::prelude::*;

use super::joint::{CourseWeights, PoseSystem};
use crate::bundle::courses::CourseSystem;
use crate::bundle::determinacy::Motions;
use crate::bundle::part::{Course, Lanes};
use crate::bundle::reduced::{Damping, Quadratic, Weighing, most_observed_node};
use crate::bundle::turns::{Turns, origin_shift};
use crate::least_squares::{BlockPattern, LeastSquaresError, LinearSolver, SelectedInverse, inner, symmetric_eigen_of};

/// Covariances of the vectors of each track of the part, by rows, in its unit; those of tracks that nothing tells of are
/// NaN. `bends` says which observations the cameras rest on, `weights.keep` which tell of the paths.
pub(super) fn covariances<const D: usize, const V: usize>(
    weights: &CourseWeights<'_, D>,
    bends: &[bool],
    free_turns: bool,
    sigma: f64,
) -> Result<Vec<Vec<f64>>, LeastSquaresError> {
    let cameras = Cameras::<V>::assemble(weights, bends, free_turns)?;
    let tracks = 0..weights.state.part.n_tracks();
    Ok(tracks.into_par_iter().with_min_len(64).map(|j| of_path(weights, &cameras, j, sigma * sigma)).collect())
}

/// Covariance of all cameras on the pattern of those that share a track, in units of sigma squared.
struct Cameras<const V: usize> {
    pattern: BlockPattern,
    blocks: Vec<[[f64; V]; V]>,
}

impl<const V: usize> Cameras<V> {
    fn assemble<const D: usize>(
        weights: &CourseWeights<'_, D>,
        bends: &[bool],
        free_turns: bool,
    ) -> Result<Self, LeastSquaresError> {
        let state = weights.state;
        let part = &state.part;
        let (centers, n_turns) = (&state.estimate.centers, V - D);
        let mut held: Vec<bool> = (0..part.n_nodes * V).map(|k| k % V < n_turns && !free_turns).collect();
        let pinned = most_observed_node(part);
        held[pinned * V..(pinned + 1) * V].fill(true);
        held[farthest_unknown::<D, V>(centers, pinned)] = true;
        let mut system = PoseSystem::<D, V>::analyse(part, LinearSolver::Direct, held.clone())?;
        let turning = Turns { part, centers, points: &state.estimate.points, vectors: &state.vectors };
        let bending = CourseWeights { keep: bends, ..*weights };
        system.assemble(part, &bending, &turning, &[], Damping { point: 0.0, view: 0.0 });
        let pattern = system.pattern().clone();
        let inverse = SelectedInverse::<V>::new(&pattern, system.values())?;
        let axes: Vec<[f64; 3]> = if free_turns {
            (0..n_turns).map(|k| std::array::from_fn(|c| f64::from(c == k))).collect()
        } else {
            Vec::new()
        };
        let motions = Motions { translation: true, axes: &axes, scale: true };
        let basis = motions.of_cameras::<D, V>(centers, &[0.0; D]);
        let projection = Projection::<V>::new(basis, &held, &inverse, n_turns)?;
        let columns: Vec<(usize, usize)> =
            (0..pattern.n_nodes()).flat_map(|c| pattern.column(c).map(move |k| (c, k))).collect();
        let block = |&(column, k): &(usize, usize)| {
            let row = pattern.row[k] as usize;
            let mut block = inverse.block(row, column).unwrap_or([[0.0; V]; V]);
            for r in 0..V {
                for c in 0..V {
                    if held[row * V + r] || held[column * V + c] {
                        block[r][c] = 0.0;
                    }
                }
            }
            projection.apply(row, column, block)
        };
        let blocks = columns.par_iter().with_min_len(64).map(block).collect();
        Ok(Self { pattern, blocks })
    }

    /// Block (a, b), transposed where the pattern holds (b, a).
    fn block(&self, a: usize, b: usize) -> Option<[[f64; V]; V]> {
        let (row, column) = (a.max(b), a.min(b));
        let range = self.pattern.column(column);
        let k = range.start + self.pattern.row[range.clone()].partition_point(|&r| (r as usize) < row);
        if k >= range.end || self.pattern.row[k] as usize != row {
            return None;
        }
        let block = &self.blocks[k];
        Some(if a >= b { *block } else { std::array::from_fn(|r| std::array::from_fn(|c| block[c][r])) })
    }
}

/// The coordinate of a centre that is farthest from the same of the pinned one: held, it fixes the scale.
fn farthest_unknown<const D: usize, const V: usize>(centers: &[Lanes], pinned: usize) -> usize {
    let mut farthest = (0, -1.0);
    for (node, center) in centers.iter().enumerate() {
        for c in 0..D {
            let distance = (center.0[c] - centers[pinned].0[c]).abs();
            if distance > farthest.1 {
                farthest = (node * V + V - D + c, distance);
            }
        }
    }
    farthest.0
}

/// From a generalised inverse to the gauge of the centres; see the module's text.
struct Projection<const V: usize> {
    /// `G A`, by columns.
    turned: Vec<Vec<f64>>,
    /// `K = S^- W`, by columns.
    pushed: Vec<Vec<f64>>,
    /// `W^T K`.
    core: Vec<Vec<f64>>,
}

impl<const V: usize> Projection<V> {
    fn new(
        basis: Vec<Vec<f64>>,
        held: &[bool],
        inverse: &SelectedInverse<V>,
        n_turns: usize,
    ) -> Result<Self, LeastSquaresError> {
        // W: the centres' part of the basis
        let mut conditions = basis.clone();
        for column in &mut conditions {
            column.chunks_exact_mut(V).for_each(|x| x[..n_turns].fill(0.0));
        }
        let gram: Vec<Vec<f64>> = conditions.iter().map(|w| conditions.iter().map(|g| inner(w, g)).collect()).collect();
        let (sizes, axes) = symmetric_eigen_of(&gram)?;
        let largest = sizes.last().copied().unwrap_or(0.0);
        let n = basis.len();
        // centres on a line leave a turn that no centre tells of
        let part = |r: usize, c: usize| -> f64 {
            let told = (0..n).filter(|&k| sizes[k] > 1e-12 * largest);
            told.map(|k| axes[k][r] * axes[k][c] / sizes[k]).sum()
        };
        let turned =
            (0..n).map(|c| (0..held.len()).map(|i| (0..n).map(|k| basis[k][i] * part(k, c)).sum()).collect()).collect();
        let mut pushed = conditions.clone();
        for column in &mut pushed {
            column.iter_mut().zip(held).filter(|(_, held)| **held).for_each(|(x, _)| *x = 0.0);
            inverse.solve(column, 1)?;
            column.iter_mut().zip(held).filter(|(_, held)| **held).for_each(|(x, _)| *x = 0.0);
        }
        let core = conditions.iter().map(|w| pushed.iter().map(|k| inner(w, k)).collect()).collect();
        Ok(Self { turned, pushed, core })
    }

    fn apply(&self, a: usize, b: usize, mut block: [[f64; V]; V]) -> [[f64; V]; V] {
        let n = self.turned.len();
        for r in 0..V {
            for c in 0..V {
                let (i, j) = (a * V + r, b * V + c);
                for k in 0..n {
                    block[r][c] -= self.turned[k][i] * self.pushed[k][j] + self.pushed[k][i] * self.turned[k][j];
                    let across: f64 = (0..n).map(|l| self.core[k][l] * self.turned[l][j]).sum();
                    block[r][c] += self.turned[k][i] * across;
                }
            }
        }
        block
    }
}

/// Covariance of the vectors of one path.
fn of_path<const D: usize, const V: usize>(
    weights: &CourseWeights<'_, D>,
    cameras: &Cameras<V>,
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
