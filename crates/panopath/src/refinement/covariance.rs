//! How well a scene is determined: covariances of all cameras and points, exact to first order.
//!
//! At a scene, the system with points eliminated, weighted by `1/sigma^2`, is the Fisher information `S` of the cameras. Its
//! blocks of `S^-` on the pattern come from a selected inversion, with as many unknowns held as there are
//! freedoms of the gauge; `bundle::gauged` takes them to the gauge asked for. A point adds `A_j^-1` to what the cameras of
//! its track pass on to it through `B = A_j^-1 M K`.

use rayon::prelude::*;

use super::descent::State;
use super::gauge::{Gauge, solve_small};
use super::options::{RefineError, RefineOptions};
use super::{Piece, check, components_of_tracks, components_of_views, without_starved};
use crate::bundle::gauged::{Fixing, GaugedCovariance, farthest_coordinate};
use crate::bundle::newton::{NewtonWeights, Residuals};
use crate::bundle::noise::FitSize;
use crate::bundle::part::{Lanes, Part};
use crate::bundle::reduced::{
    Damping, Factorised, Freedoms, PointSum, ReducedSystem, Row, Weighing, most_observed_node,
};
use crate::bundle::turns::{PoseRow, Turns, turns};
use crate::geometry::Matrix;
use crate::least_squares::{BlockPattern, LeastSquaresError, LinearSolver, SelectedInverse, inner};
use crate::structure::Structure;
use crate::tracks::Tracks;

/// The condition under which what nothing determines is fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CovarianceGauge {
    /// Inner constraints over the centres: errors after a fit by similarity over all centres of the component (and over
    /// all orientations too, where the centres lie on a line).
    #[default]
    Cameras,
    /// Relative to a view: errors after its pose is brought to the truth, and the rms distance of the centres from it.
    View(u32),
}

/// Covariances of a scene; NaN where nothing is determined.
#[derive(Debug, Clone, PartialEq)]
pub struct Covariances<const D: usize, const V: usize> {
    /// Of each view: the turn in the camera, on the left (`D (D - 1) / 2` entries), and the centre in the world.
    pub cameras: Vec<[[f64; V]; V]>,
    /// Of each point.
    pub points: Vec<Matrix<D>>,
}

/// Covariances of all cameras and points at a scene that [`refine`](super::refine) ended with, or at the truth.
///
/// `sigma_rad` is the standard deviation of an observation of median sigma. `scene.inlier` says which observations
/// count, all where it is empty. `options` are those of the refinement: priors, rig and what was held.
///
/// # Errors
/// [`RefineError`] where the arguments do not fit together, or a component is not determined.
pub fn covariance<const D: usize, const V: usize>(
    tracks: &Tracks<D>,
    scene: &Structure<D>,
    options: &RefineOptions<D>,
    gauge: CovarianceGauge,
    sigma_rad: f64,
) -> Result<Covariances<D, V>, RefineError> {
    const { assert!((D == 2 || D == 3) && V == D * (D + 1) / 2) }
    check(tracks, scene, options)?;
    if !scene.inlier.is_empty() && scene.inlier.len() != tracks.len() {
        return Err(RefineError::Length { name: "inlier", found: scene.inlier.len(), expected: tracks.len() });
    }
    if !(sigma_rad.is_finite() && sigma_rad > 0.0) {
        return Err(RefineError::Option(format!("sigma_rad is {sigma_rad}, expected a positive number")));
    }
    let component_of_track = components_of_tracks(tracks, scene);
    let mut answer = Covariances {
        cameras: vec![[[f64::NAN; V]; V]; tracks.n_views()],
        points: vec![[[f64::NAN; D]; D]; tracks.n_tracks()],
    };
    for component in components_of_views(scene) {
        let Some((piece, keep)) = told_piece(tracks, scene, &component_of_track, component, options)? else { continue };
        let reference = match gauge {
            CovarianceGauge::Cameras => None,
            CovarianceGauge::View(view) => match piece.views.binary_search(&view) {
                Ok(node) => Some(node),
                // a view of another component says nothing of this one
                Err(_) => continue,
            },
        };
        let information = Information::<D, V>::assemble(&piece, keep, sigma_rad)?;
        information.write(&piece, reference, sigma_rad, &mut answer)?;
    }
    Ok(answer)
}

/// A component without the views that too few observations tell of, and the observations that count.
fn told_piece<const D: usize>(
    tracks: &Tracks<D>,
    scene: &Structure<D>,
    component_of_track: &[i32],
    component: i32,
    options: &RefineOptions<D>,
) -> Result<Option<(Piece<D>, Vec<bool>)>, RefineError> {
    let mut told = scene.clone();
    loop {
        let Some(piece) = Piece::lay_out(tracks, &told, component_of_track, component, options)? else {
            return Ok(None);
        };
        let part = &piece.part;
        let counts = |o: usize| scene.inlier.is_empty() || scene.inlier[part.input_observation[o] as usize];
        let mut keep: Vec<bool> = (0..part.n_observations()).map(counts).collect();
        for j in (0..part.n_tracks()).filter(|&j| !piece.points[j].0.iter().all(|x| x.is_finite())) {
            keep[part.observations(j)].fill(false);
        }
        let keep = without_starved(part, &keep, &piece.wanted);
        let mut is_told = vec![false; piece.views.len()];
        (0..part.n_observations()).filter(|&o| keep[o]).for_each(|o| is_told[part.node_of(o) as usize] = true);
        if !is_told.contains(&false) {
            return Ok(Some((piece, keep)));
        }
        for (&view, _) in piece.views.iter().zip(&is_told).filter(|(_, told)| !**told) {
            told.view_component[view as usize] = -1;
        }
    }
}

/// The information of one component and what its inversion needs.
struct Information<const D: usize, const V: usize> {
    state: State<D>,
    keep: Vec<bool>,
    pattern: BlockPattern,
    inverse: SelectedInverse<V>,
    held: Vec<bool>,
}

impl<const D: usize, const V: usize> Information<D, V> {
    fn assemble(piece: &Piece<D>, keep: Vec<bool>, sigma: f64) -> Result<Self, LeastSquaresError> {
        let state = State::new(&piece.sights, &piece.part, piece.poses.clone(), piece.points.clone());
        let part = &state.part;
        let size = FitSize::of(part, |o| keep[o]);
        let known: usize = piece.priors.rows(piece.views.len()).iter().sum();
        if size.equations + known < size.unknowns {
            return Err(LeastSquaresError::Singular { pivot: 0 });
        }
        let held = with_scale_held::<D, V>(piece, &state);
        let mut system = ReducedSystem::<D, V, PoseRow>::analyse(part, LinearSolver::Direct, held.clone())?;
        let weights = weights(part, &state, &keep);
        let turns = turns_of(&state);
        let terms = piece.priors.terms(&state.poses, sigma);
        system.assemble(part, &weights, &turns, &terms, Damping { point: 0.0, view: 0.0 });
        let pattern = system.pattern().clone();
        let inverse = SelectedInverse::new(&pattern, system.values())?;
        if let Some(pivot) = undetermined(&inverse, &pattern, system.diagonal(), &held) {
            return Err(LeastSquaresError::Singular { pivot });
        }
        Ok(Self { keep, pattern, inverse, held, state })
    }

    fn write(
        &self,
        piece: &Piece<D>,
        reference: Option<usize>,
        sigma: f64,
        answer: &mut Covariances<D, V>,
    ) -> Result<(), RefineError> {
        let cameras = self.gauged(&piece.gauge, reference)?;
        let to_world = 1.0 / piece.piece_from_world.scale;
        for (node, &view) in piece.views.iter().enumerate() {
            let to_answer = self.in_camera(node, to_world);
            answer.cameras[view as usize] =
                congruent(&to_answer, cameras.of(node)).map(|row| row.map(|x| x * sigma * sigma));
        }
        let points = self.points(&cameras);
        for (&track, point) in piece.part.input_track.iter().zip(points) {
            answer.points[track as usize] = point.map(|row| row.map(|x| x * (sigma * to_world).powi(2)));
        }
        Ok(())
    }

    /// The covariance of the cameras in the gauge asked for.
    fn gauged(&self, gauge: &Gauge<D>, reference: Option<usize>) -> Result<GaugedCovariance<V>, RefineError> {
        /// A condition number beyond which the centres count as lying on a line.
        const FLAT: f64 = 1e-9;
        let centers = &self.state.poses.centers;
        let basis = gauge.basis::<V>(centers);
        let with_centers_only = conditions::<D, V>(gauge, &basis, centers, reference, 0.0);
        let (conditions, product_inverse) = match inverse_of_product(&with_centers_only, &basis, FLAT) {
            Some(inverse) => (with_centers_only, inverse),
            None => {
                let with_turns = conditions::<D, V>(gauge, &basis, centers, reference, 1.0);
                let inverse = inverse_of_product(&with_turns, &basis, FLAT).ok_or_else(|| {
                    RefineError::Option("the views stand in one place: nothing fixes a scale".to_owned())
                })?;
                (with_turns, inverse)
            }
        };
        let fixing = Fixing { basis: &basis, conditions: &conditions, product_inverse: &product_inverse };
        Ok(GaugedCovariance::new(&self.pattern, &self.inverse, &self.held, &fixing)?)
    }

    /// Takes the unknowns `(omega, dc)` of a node to the turn in the camera and the centre in the unit of the answer.
    fn in_camera(&self, node: usize, to_world: f64) -> [[f64; V]; V] {
        let n_turns = turns(D);
        let mut change = [[0.0; V]; V];
        let cam_from_world = self.state.poses.cam_from_world[node].matrix();
        for r in 0..n_turns {
            for c in 0..n_turns {
                change[r][c] = if D == 2 { 1.0 } else { cam_from_world[r][c] };
            }
        }
        for k in n_turns..V {
            change[k][k] = to_world;
        }
        change
    }

    /// Covariance of each point of the part, in its own unit and that of sigma.
    fn points(&self, cameras: &GaugedCovariance<V>) -> Vec<Matrix<D>> {
        let State { part, .. } = &self.state;
        let weights = weights(part, &self.state, &self.keep);
        let turns = turns_of(&self.state);
        let tracks: Vec<usize> = (0..part.n_tracks()).collect();
        let covariance = |&j: &usize| {
            if part.holds_point(j) {
                return [[0.0; D]; D];
            }
            let mut sum = PointSum::<D>::new();
            let models: Vec<_> = part.observations(j).map(|o| weights.observe(o, j)).collect();
            models.iter().for_each(|model| sum.add(model));
            if sum.is_empty() {
                return [[f64::NAN; D]; D];
            }
            let factor = sum.factor(0.0, &Lanes::ZERO);
            let unit = |r: usize| Lanes(std::array::from_fn(|c| f64::from(c == r)));
            let mut covariance: Matrix<D> = std::array::from_fn(|r| factor.solve(&unit(r)).vector::<D>());
            // what each camera passes on: D rows of V numbers
            let mut passed: Vec<(usize, [PoseRow; D])> = Vec::with_capacity(models.len());
            for (model, o) in models.iter().zip(part.observations(j)) {
                let across: Matrix<D> =
                    std::array::from_fn(|r| factor.solve(&model.apply::<D>(&unit(r))).vector::<D>());
                let rows = std::array::from_fn(|r| {
                    let row = Lanes::from_vector::<D>(&std::array::from_fn(|c| across[c][r]));
                    Freedoms::<D, V>::lift(&turns, o, j, &row)
                });
                passed.push((part.node_of(o) as usize, rows));
            }
            for (i, (a, rows_a)) in passed.iter().enumerate() {
                for (b, rows_b) in &passed[..=i] {
                    let Some(block) = cameras.block(*a, *b) else { continue };
                    let twice = !std::ptr::eq(rows_a, rows_b);
                    for r in 0..D {
                        let left: [f64; V] =
                            std::array::from_fn(|c| (0..V).map(|k| rows_a[r].at(k) * block[k][c]).sum());
                        for c in 0..D {
                            let entry: f64 = (0..V).map(|k| left[k] * rows_b[c].at(k)).sum();
                            covariance[r][c] += entry;
                            if twice {
                                covariance[c][r] += entry;
                            }
                        }
                    }
                }
            }
            covariance
        };
        tracks.par_iter().with_min_len(256).map(covariance).collect()
    }
}

/// An unknown whose variance is beyond what rounding lets a singular system have; `diagonal` is what it would cost alone.
fn undetermined<const V: usize>(
    inverse: &SelectedInverse<V>,
    pattern: &BlockPattern,
    diagonal: &[f64],
    held: &[bool],
) -> Option<usize> {
    const LOST: f64 = 1e13;
    let is_lost = |&k: &usize| {
        let block = inverse.block(k / V, k / V).unwrap_or([[f64::NAN; V]; V]);
        let share = block[k % V][k % V] * diagonal[k];
        !held[k] && (share.is_nan() || share > LOST)
    };
    (0..pattern.n_nodes() * V).find(is_lost)
}

fn weights<'a, const D: usize>(part: &'a Part<D>, state: &'a State<D>, keep: &'a [bool]) -> NewtonWeights<'a, D> {
    let residuals = Residuals { part, keep, huber: f64::INFINITY };
    NewtonWeights { residuals, estimate: &state.estimate }
}

fn turns_of<const D: usize>(state: &State<D>) -> Turns<'_, D> {
    let State { poses, part, estimate } = state;
    Turns { part, centers: &poses.centers, points: &estimate.points, vectors: &[] }
}

/// The unknowns that the piece holds, and one coordinate of the centre farthest from the pinned one where the scale is free.
fn with_scale_held<const D: usize, const V: usize>(piece: &Piece<D>, state: &State<D>) -> Vec<bool> {
    let mut held = piece.held.clone();
    if piece.gauge.scale {
        let origin = match piece.gauge.translation {
            true => state.poses.centers[most_observed_node(&state.part)].vector::<D>(),
            false => piece.gauge.origin,
        };
        held[farthest_coordinate::<D, V>(&state.poses.centers, &origin)] = true;
    }
    held
}

/// `t block t^T`.
fn congruent<const V: usize>(t: &[[f64; V]; V], block: &[[f64; V]; V]) -> [[f64; V]; V] {
    let left: [[f64; V]; V] =
        std::array::from_fn(|r| std::array::from_fn(|c| (0..V).map(|k| t[r][k] * block[k][c]).sum()));
    std::array::from_fn(|r| std::array::from_fn(|c| (0..V).map(|k| left[r][k] * t[c][k]).sum()))
}

/// `W`: the parts of the basis that belong to centres, and those of turns with a weight; or the unknowns of one node and the
/// spread of the centres about it.
fn conditions<const D: usize, const V: usize>(
    gauge: &Gauge<D>,
    basis: &[Vec<f64>],
    centers: &[Lanes],
    reference: Option<usize>,
    turn_weight: f64,
) -> Vec<Vec<f64>> {
    let n_turns = turns(D);
    let scale_column = gauge.scale.then(|| basis.len() - 1);
    let mut conditions = basis.to_vec();
    for (k, column) in conditions.iter_mut().enumerate() {
        for (node, x) in column.chunks_exact_mut(V).enumerate() {
            match reference {
                None => x[..n_turns].iter_mut().for_each(|x| *x *= turn_weight),
                Some(view) if Some(k) == scale_column => {
                    x[n_turns..].copy_from_slice(&centers[node].minus(&centers[view]).vector::<D>());
                }
                Some(view) if node != view => x.fill(0.0),
                // turns are about this view: its centre stays
                Some(_) if x[..n_turns].iter().any(|x| *x != 0.0) => x[n_turns..].fill(0.0),
                Some(_) => {}
            }
        }
    }
    conditions
}

/// `(W^T G)^-1` by columns; `None` where it is singular.
fn inverse_of_product(conditions: &[Vec<f64>], basis: &[Vec<f64>], tolerance: f64) -> Option<Vec<Vec<f64>>> {
    let product: Vec<Vec<f64>> = conditions.iter().map(|w| basis.iter().map(|g| inner(w, g)).collect()).collect();
    let n = basis.len();
    let identity = (0..n).map(|c| (0..n).map(|r| f64::from(r == c)).collect()).collect();
    solve_small(product, identity, tolerance)
}
