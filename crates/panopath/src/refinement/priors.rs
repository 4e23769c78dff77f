//! What is known of views beforehand, as terms of the camera system.
//!
//! With `e` the error of a prior and `H` its information, the squared error `e^T H e` counts in units of the bearings'
//! sigma. Huber's rule holds for priors too, in standard deviations. Errors and their derivatives by the unknowns
//! `(omega, dc)` of a camera:
//!
//! | prior | error | derivative |
//! |---|---|---|
//! | orientation `P` | `rho = log(R P^T)`, in the camera | `J_l(rho)^-1 R` by `omega` |
//! | direction `d`, measured along `b` | `R^T b - d` across `d` | `[d]_x` by `omega` |
//! | position `p` | `c - p` | `I` by `dc` |

use super::options::{DirectionPrior, PositionPrior, Priors, RefineError, RotationPrior};
use super::poses::Poses;
use crate::bundle::newton::{huber_cost, huber_weight};
use crate::bundle::reduced::CameraTerm;
use crate::bundle::turns::turns;
use crate::geometry::{Matrix, Rotation, Similarity, Vector, dot, inverse_left_jacobian, norm, sub};
use crate::least_squares::inverse_of_positive;

/// Error, its derivative by the unknowns of the camera, and the information: of at most three rows.
struct Model<const V: usize> {
    node: u32,
    error: [f64; 3],
    derivative: [[f64; V]; 3],
    information: [[f64; 3]; 3],
}

/// Priors of the views of one part, by node.
pub(super) struct PartPriors<const D: usize> {
    rotations: Vec<(u32, Rotation<D>, [[f64; 3]; 3])>,
    directions: Vec<(u32, DirectionPrior<D>)>,
    positions: Vec<(u32, Vector<D>, [[f64; 3]; 3])>,
    huber_sigmas: f64,
}

impl<const D: usize> PartPriors<D> {
    /// Those of the views that `node_of` knows, in the frame of the piece.
    pub fn of(
        priors: &Priors<D>,
        node_of: impl Fn(u32) -> Option<u32>,
        piece_from_world: &Similarity<D>,
        huber_sigmas: f64,
    ) -> Result<Self, RefineError> {
        let mut found = Self { rotations: vec![], directions: vec![], positions: vec![], huber_sigmas };
        for (index, prior) in priors.rotations.iter().enumerate() {
            if let Some(node) = node_of(prior.view) {
                let information =
                    information_of(&prior.covariance, turns(D)).ok_or_else(|| not_positive("rotation", index))?;
                found.rotations.push((node, prior.cam_from_world, information));
            }
        }
        for prior in &priors.directions {
            found.directions.extend(node_of(prior.view).map(|node| (node, prior.clone())));
        }
        for (index, prior) in priors.positions.iter().enumerate() {
            if let Some(node) = node_of(prior.view) {
                let information =
                    information_of(&prior.covariance, D).ok_or_else(|| not_positive("position", index))?;
                let per_unit = information.map(|row| row.map(|x| x / piece_from_world.scale.powi(2)));
                found.positions.push((node, piece_from_world.apply(&prior.center), per_unit));
            }
        }
        Ok(found)
    }

    /// Does any fix an orientation altogether?
    pub fn fix_rotation(&self) -> bool {
        !self.rotations.is_empty() || self.directions.len() > 1 && !self.directions_are_parallel()
    }

    /// The direction of the world that is measured, where there is just one.
    pub fn only_direction(&self) -> Option<Vector<D>> {
        let first = self.directions.first()?;
        (self.rotations.is_empty() && self.directions_are_parallel()).then_some(first.1.direction)
    }

    fn directions_are_parallel(&self) -> bool {
        const PARALLEL: f64 = 1e-3;
        self.directions.iter().all(|(_, d)| 1.0 - dot(&d.direction, &self.directions[0].1.direction).abs() < PARALLEL)
    }

    /// Unknowns of each node that its own priors fix, at most as many as it has of a kind.
    pub fn rows(&self, n_nodes: usize) -> Vec<usize> {
        let (mut of_turn, mut of_place) = (vec![0; n_nodes], vec![0; n_nodes]);
        self.rotations.iter().for_each(|(node, ..)| of_turn[*node as usize] += turns(D));
        self.directions.iter().for_each(|(node, _)| of_turn[*node as usize] += D - 1);
        self.positions.iter().for_each(|(node, ..)| of_place[*node as usize] += D);
        of_turn.iter().zip(&of_place).map(|(turn, place)| turns(D).min(*turn) + D.min(*place)).collect()
    }

    /// Nodes with a known position, and where, in the frame of the piece.
    pub fn positions(&self) -> impl Iterator<Item = (u32, Vector<D>)> {
        self.positions.iter().map(|(node, center, _)| (*node, *center))
    }

    fn models<const V: usize>(&self, poses: &Poses<D>) -> Vec<Model<V>> {
        let rotations = self.rotations.iter().map(|(node, prior, information)| {
            let cam_from_world = &poses.cam_from_world[*node as usize];
            let error = cam_from_world.compose(&prior.inverse()).turn();
            let derivative = turn_derivative::<D, V>(&error, cam_from_world);
            Model { node: *node, error, derivative, information: *information }
        });
        let directions = self
            .directions
            .iter()
            .map(|(node, prior)| direction_model(*node, prior, &poses.cam_from_world[*node as usize]));
        let positions = self.positions.iter().map(|(node, prior, information)| {
            let difference = sub(&poses.centers[*node as usize].vector::<D>(), prior);
            let mut derivative = [[0.0; V]; 3];
            (0..D).for_each(|c| derivative[c][turns(D) + c] = 1.0);
            Model { node: *node, error: padded(&difference), derivative, information: *information }
        });
        rotations.chain(directions).chain(positions).collect()
    }

    /// Terms of the camera system, in units of squared radians where the bearings' noise is `sigma`.
    pub fn terms<const V: usize>(&self, poses: &Poses<D>, sigma: f64) -> Vec<CameraTerm<V>> {
        let term = |model: Model<V>| {
            let weight = sigma * sigma * huber_weight(model.squared(), self.huber_sigmas);
            let weighted: [[f64; V]; 3] = std::array::from_fn(|r| {
                std::array::from_fn(|c| {
                    weight * (0..3).map(|k| model.information[r][k] * model.derivative[k][c]).sum::<f64>()
                })
            });
            let column = |c: usize| (0..3).map(|r| model.error[r] * weighted[r][c]).sum::<f64>();
            CameraTerm {
                node: model.node,
                information: std::array::from_fn(|r| {
                    std::array::from_fn(|c| (0..3).map(|k| model.derivative[k][r] * weighted[k][c]).sum())
                }),
                gradient: std::array::from_fn(|c| -column(c)),
            }
        };
        self.models(poses).into_iter().map(term).collect()
    }

    /// Their part of the cost, in the same units.
    pub fn cost(&self, poses: &Poses<D>, sigma: f64) -> f64 {
        // the number of unknowns makes no difference to the errors
        let models = self.models::<6>(poses);
        models.iter().map(|model| sigma * sigma * huber_cost(model.squared(), self.huber_sigmas)).sum()
    }
}

impl<const V: usize> Model<V> {
    fn squared(&self) -> f64 {
        (0..3).map(|r| self.error[r] * dot(&self.information[r], &self.error)).sum()
    }
}

fn direction_model<const D: usize, const V: usize>(
    node: u32,
    prior: &DirectionPrior<D>,
    cam_from_world: &Rotation<D>,
) -> Model<V> {
    let d = &prior.direction;
    let measured = cam_from_world.inverse().apply(&prior.bearing);
    let mut error: Vector<D> = sub(&measured, d);
    let along = dot(&error, d);
    // straight across, the chord of an error of more than a right angle would shrink again: its length is kept
    let across: Vector<D> = std::array::from_fn(|c| error[c] - along * d[c]);
    let length = norm(&across);
    if length > 0.0 {
        let chord = norm(&error);
        error = std::array::from_fn(|c| across[c] * chord / length);
    }
    let mut derivative = [[0.0; V]; 3];
    if D == 2 {
        derivative[0][0] = d[1];
        derivative[1][0] = -d[0];
    } else {
        let [x, y, z] = padded(d);
        for (r, row) in [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]].iter().enumerate() {
            derivative[r][..3].copy_from_slice(row);
        }
    }
    let weight = prior.sigma_rad.powi(-2);
    let information = std::array::from_fn(|r| std::array::from_fn(|c| if r == c { weight } else { 0.0 }));
    Model { node, error: padded(&error), derivative, information }
}

/// Derivative of `log(R exp(omega) P^T)` by `omega`: `J_l(rho)^-1 R`.
fn turn_derivative<const D: usize, const V: usize>(rho: &[f64; 3], cam_from_world: &Rotation<D>) -> [[f64; V]; 3] {
    let mut derivative = [[0.0; V]; 3];
    if D == 2 {
        derivative[0][0] = 1.0;
        return derivative;
    }
    let inverse = inverse_left_jacobian(rho);
    for r in 0..3 {
        for c in 0..3 {
            derivative[r][c] = (0..3).map(|k| inverse[r][k] * cam_from_world.matrix()[k][c]).sum();
        }
    }
    derivative
}

fn padded<const D: usize>(x: &Vector<D>) -> [f64; 3] {
    std::array::from_fn(|c| if c < D { x[c] } else { 0.0 })
}

/// Inverse of the leading `n` rows and columns of a covariance, zero beyond; `None` where it is not positive definite.
fn information_of<const D: usize>(covariance: &Matrix<D>, n: usize) -> Option<[[f64; 3]; 3]> {
    let entry = |r: usize, c: usize| match (r < n, c < n) {
        (true, true) => 0.5 * (covariance[r][c] + covariance[c][r]),
        _ => f64::from(r == c),
    };
    let padded: Matrix<3> = std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)));
    if padded.iter().flatten().any(|x| !x.is_finite()) {
        return None;
    }
    let inverse = inverse_of_positive(&padded)?;
    Some(std::array::from_fn(|r| std::array::from_fn(|c| if r < n && c < n { inverse[r][c] } else { 0.0 })))
}

fn not_positive(kind: &'static str, index: usize) -> RefineError {
    let problem = "its covariance is not positive definite, expected a covariance of every direction".to_owned();
    RefineError::Prior { kind, index, problem }
}

/// Checks priors against the number of views.
pub(super) fn check<const D: usize>(priors: &Priors<D>, n_views: usize) -> Result<(), RefineError> {
    let fault = |kind, index, problem: String| Err(RefineError::Prior { kind, index, problem });
    let view = |view: u32| format!("names the view {view}, but there are {n_views}");
    for (index, RotationPrior { view: id, .. }) in priors.rotations.iter().enumerate() {
        if *id as usize >= n_views {
            return fault("rotation", index, view(*id));
        }
    }
    for (index, prior) in priors.directions.iter().enumerate() {
        if prior.view as usize >= n_views {
            return fault("direction", index, view(prior.view));
        }
        for (name, x) in [("bearing", &prior.bearing), ("direction", &prior.direction)] {
            let length = norm(x);
            if length.is_nan() || (length - 1.0).abs() > crate::tracks::UNIT_TOLERANCE {
                return fault("direction", index, format!("its {name} has length {length}, expected a unit vector"));
            }
        }
        if !(prior.sigma_rad.is_finite() && prior.sigma_rad > 0.0) {
            return fault("direction", index, format!("sigma_rad is {}, expected a positive number", prior.sigma_rad));
        }
    }
    for (index, PositionPrior { view: id, center, .. }) in priors.positions.iter().enumerate() {
        if *id as usize >= n_views {
            return fault("position", index, view(*id));
        }
        if center.iter().any(|x| !x.is_finite()) {
            return fault("position", index, "its centre is not finite".to_owned());
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::differences::by_unknowns;
    use super::*;
    use crate::bundle::part::Lanes;
    use crate::geometry::normalized;

    const SIZES: [f64; 8] = [0.0, 1e-9, 1e-3, 9e-3, 1.1e-2, 0.7, 2.0, 3.0];

    fn axis(k: usize) -> Vector<3> {
        let s = k as f64;
        normalized(&[(1.3 * s).sin(), (2.1 * s + 0.4).cos(), (0.7 * s - 1.0).sin()])
    }

    fn poses<const D: usize>(turn: &[f64]) -> Poses<D> {
        let centers = vec![Lanes::from_vector::<D>(&std::array::from_fn(|c| 0.3 + c as f64))];
        Poses { cam_from_world: vec![Rotation::exp_of(turn)], centers }
    }

    fn priors<const D: usize>() -> PartPriors<D> {
        PartPriors { rotations: vec![], directions: vec![], positions: vec![], huber_sigmas: f64::INFINITY }
    }

    const UNIT: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

    fn check_derivative<const D: usize, const V: usize>(priors: &PartPriors<D>, poses: &Poses<D>, what: &str) {
        let model = &priors.models::<V>(poses)[0];
        let columns = by_unknowns::<D, V, 3>(poses, |moved| priors.models::<V>(moved)[0].error);
        for r in 0..3 {
            for c in 0..V {
                let (found, wanted) = (model.derivative[r][c], columns[c][r]);
                assert!((found - wanted).abs() < 2e-7, "{what} ({r}, {c}): {found}, by differences {wanted}");
            }
        }
    }

    #[test]
    fn derivatives_of_orientations_are_right_at_any_error() {
        for (k, size) in SIZES.into_iter().enumerate() {
            for a in 0..5 {
                let turn = axis(a);
                let off = Rotation::<3>::exp(&crate::geometry::scale(size, &axis(a + k)));
                let prior = off.compose(&Rotation::exp_of(&turn));
                let known = PartPriors { rotations: vec![(0, prior, UNIT)], ..priors::<3>() };
                check_derivative::<3, 6>(&known, &poses(&turn), &format!("{size} about {a}"));
            }
            let known = PartPriors { rotations: vec![(0, Rotation::from_angle(0.4 + size), UNIT)], ..priors::<2>() };
            check_derivative::<2, 3>(&known, &poses(&[0.4]), &format!("{size} in the plane"));
        }
    }

    #[test]
    fn derivatives_of_positions_are_right() {
        let of_space = PartPriors { positions: vec![(0, [2.0, -3.0, 0.5], UNIT)], ..priors::<3>() };
        check_derivative::<3, 6>(&of_space, &poses(&[0.1, 0.2, 0.3]), "space");
        let of_plane = PartPriors { positions: vec![(0, [2.0, -3.0], UNIT)], ..priors::<2>() };
        check_derivative::<2, 3>(&of_plane, &poses(&[0.1]), "plane");
    }

    /// The derivative is that of a small error; of a large one, the gradient has the direction of the true one.
    fn check_direction<const D: usize, const V: usize>(turn: &[f64], off: &[f64], size: f64, what: &str) {
        let poses = poses::<D>(turn);
        let direction: Vector<D> = normalized(&std::array::from_fn(|c| 1.0 - 1.7 * c as f64));
        let bearing = Rotation::<D>::exp_of(off).compose(&poses.cam_from_world[0]).apply(&direction);
        let prior = DirectionPrior { view: 0, bearing, direction, sigma_rad: 1.0 };
        let known = PartPriors { directions: vec![(0, prior)], ..priors::<D>() };
        if size < 1e-8 {
            check_derivative::<D, V>(&known, &poses, what);
        }
        let term = &known.terms::<V>(&poses, 1.0)[0];
        let slope = by_unknowns::<D, V, 1>(&poses, |moved| [0.5 * known.cost(moved, 1.0)]);
        let length = |x: &[f64]| x.iter().map(|v| v * v).sum::<f64>().sqrt();
        let slope: Vec<f64> = slope.iter().map(|s| -s[0]).collect();
        let along: f64 = term.gradient.iter().zip(&slope).map(|(g, s)| g * s).sum();
        if length(&slope) > 1e-4 {
            let cosine = along / (length(&slope) * length(&term.gradient));
            assert!(cosine > 1.0 - 1e-6, "{what}: {cosine}, {:?}, {slope:?}", term.gradient);
        }
        // the chord is what the error is of: the cost rises all the way to the opposite
        let angle = crate::geometry::angle_between(&poses.cam_from_world[0].inverse().apply(&bearing), &direction);
        let chord = 2.0 * (0.5 * angle).sin();
        assert!((known.cost(&poses, 1.0) - chord * chord).abs() < 1e-12, "{what}");
    }

    #[test]
    fn measured_directions_pull_the_right_way_at_any_error() {
        for (k, size) in SIZES.into_iter().enumerate() {
            for a in 0..5 {
                let off = crate::geometry::scale(size, &axis(a + k));
                check_direction::<3, 6>(&axis(a), &off, size, &format!("{size} about {a}"));
            }
            check_direction::<2, 3>(&[0.8], &[size], size, &format!("{size} in the plane"));
        }
    }

    #[test]
    fn the_inverse_jacobian_is_smooth_where_its_series_takes_over() {
        for (below, above) in [(0.01 * (1.0 - 1e-9), 0.01 * (1.0 + 1e-9))] {
            let [a, b] = [below, above].map(|size| inverse_left_jacobian(&crate::geometry::scale(size, &axis(2))));
            for (x, y) in a.as_flattened().iter().zip(b.as_flattened()) {
                assert!((x - y).abs() < 1e-10, "{x} {y}");
            }
        }
    }

    #[test]
    fn a_covariance_becomes_its_inverse_and_nothing_else() {
        let found = information_of::<3>(&[[4.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.5]], 3).unwrap_or(UNIT);
        let wanted = [[2.0 / 7.0, -1.0 / 7.0, 0.0], [-1.0 / 7.0, 4.0 / 7.0, 0.0], [0.0, 0.0, 2.0]];
        for (x, y) in found.as_flattened().iter().zip(wanted.as_flattened()) {
            assert!((x - y).abs() < 1e-15, "{found:?}");
        }
        // in the plane a turn has one entry
        assert_eq!(information_of::<2>(&[[4.0, 9.0], [9.0, 0.0]], 1).map(|m| m[0]), Some([0.25, 0.0, 0.0]));
        for bad in [[[1.0, 2.0], [2.0, 1.0]], [[0.0; 2]; 2], [[f64::INFINITY, 0.0], [0.0, 1.0]]] {
            assert!(information_of::<2>(&bad, 2).is_none());
        }
    }
}
