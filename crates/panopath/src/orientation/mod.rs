//! Orientations of views from relative rotations of pairs of them.
//!
//! An edge says `R_second = second_from_first * R_first` with `R = cam_from_world`; the answer minimises
//! `sum |log(second_from_first R_first R_second^-1)|^2 / sigma^2` over the edges that agree, plus the squared deviations from
//! priors. Without priors it is known up to a rotation of the world, one for each part that hangs together.
//!
//! [`average_rotations`] reads: check; where every view knows the vertical well, reduce to turns about it; vote and grow a
//! start (`start.rs`), re-weight and fit (`averaging.rs`, on the sparse system of `system.rs`); split into parts; choose
//! the frame of each part. The start follows Govindu (2006) in spirit, the weights Chatterjee and Govindu (2013).

mod averaging;
mod graph;
mod start;
mod system;
mod turns;
mod vertical;

use crate::geometry::{Matrix, ROTATION_TOLERANCE, Rotation, Vector, angle_between, norm, scale};
use crate::least_squares::{LeastSquaresError, LinearSolver, symmetric_eigen};

use averaging::{Average, Problem, average, cut, median, residual};
use graph::Graph;
use start::{Edges, noise_from_triangles};
use turns::{Angle, Quaternion, SpatialPrior, Turn, wrapped};
use vertical::{level, tight_ups};

/// `R_second = second_from_first * R_first`, measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RelativeRotation<const D: usize = 3> {
    /// The view it starts from.
    pub first: u32,
    /// The view it leads to.
    pub second: u32,
    /// Takes directions in the first camera to directions in the second.
    pub second_from_first: Rotation<D>,
    /// Standard deviation of the measured rotation about each axis, radians.
    pub sigma_rad: f64,
}

/// What is known beforehand of the orientation of a view.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientationPrior<const D: usize = 3> {
    /// Of which view.
    pub view: u32,
    /// What is known.
    pub kind: PriorKind<D>,
}

/// Kinds of prior.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PriorKind<const D: usize = 3> {
    /// The whole orientation.
    Orientation {
        /// As measured.
        cam_from_world: Rotation<D>,
        /// Covariance of the small rotation that, applied on the left, leads from the measured to the true orientation,
        /// radians squared. In the plane entry `[2][2]`, about the vertical, alone counts.
        covariance_rad2: Matrix<3>,
    },
    /// The direction of the world's up, as an accelerometer tells it; in space only.
    Gravity {
        /// World z in the camera, unit length.
        up_in_cam: Vector<3>,
        /// Standard deviation along each tangent direction.
        sigma_rad: f64,
    },
    /// A compass: the angle, anticlockwise from world x, of the horizontal direction in which a camera axis points. In
    /// space it counts where the vertical is known in the view's part, by gravity or orientation of any view.
    Heading {
        /// The angle.
        heading_rad: f64,
        /// Standard deviation of the angle.
        sigma_rad: f64,
        /// The camera axis, unit length; in the plane its first two coordinates count, and x is the usual one.
        forward: Vector<3>,
    },
}

/// Options of [`average_rotations`].
#[derive(Debug, Clone, PartialEq)]
pub struct OrientationOptions {
    /// Re-weighted steps, and steps of each final fit. Default: 50.
    pub max_iterations: usize,
    /// Default: the one with the lower predicted cost.
    pub linear_solver: LinearSolver,
    /// Take the sigmas of the edges as ratios and find their size from the loops. Otherwise a noise greater than stated
    /// widens the limits for outliers, but leaves the weights against priors alone. Default: false.
    pub estimate_noise: bool,
    /// Work out the covariance of each view, at the price of a solve for each. Default: false.
    pub covariance: bool,
}

impl Default for OrientationOptions {
    fn default() -> Self {
        Self { max_iterations: 50, linear_solver: LinearSolver::Auto, estimate_noise: false, covariance: false }
    }
}

/// How averaging ended. A status is an answer, not an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OrientationStatus {
    /// One part, solved.
    Converged,
    /// Solved, but in parts whose relative orientation nothing tells, or with views in none.
    Disconnected,
    /// The iterations ran out first.
    MaxIterations,
    /// No two views hang together, and no prior fixes any.
    Undetermined,
}

impl OrientationStatus {
    /// The name used in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Disconnected => "disconnected",
            Self::MaxIterations => "max_iterations",
            Self::Undetermined => "undetermined",
        }
    }
}

/// Orientations, and what became of the edges.
#[derive(Debug, Clone, PartialEq)]
pub struct Orientations<const D: usize = 3> {
    /// Orientation of each view; NaN where not determined. The first view of a part without priors has the identity; in
    /// one with gravity alone it is as near the identity as the vertical lets it.
    pub cam_from_world: Vec<Rotation<D>>,
    /// Part of each view, 0 the largest, -1 none.
    pub view_component: Vec<i32>,
    /// Was the edge used to the end?
    pub edge_inlier: Vec<bool>,
    /// Angle between each edge and the answer; NaN between views of different parts.
    pub residual_rad: Vec<f64>,
    /// How it ended.
    pub status: OrientationStatus,
    /// Linear systems solved.
    pub iterations: usize,
    /// Noise about each axis of an edge of median sigma, from the inliers' loops; NaN without loops.
    pub sigma_rad: f64,
    /// Covariance of the small rotation on the left of each view, against the frame of its part (so that the first view of
    /// a part without priors has none); in the plane entry `[2][2]` alone. Empty unless asked for.
    pub covariance_rad2: Vec<Matrix<3>>,
}

/// Why averaging could not be tried.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OrientationError {
    /// An edge that cannot be one.
    #[error("edges[{edge}] {what}")]
    Edge {
        /// Which.
        edge: usize,
        /// What is wrong.
        what: String,
    },
    /// A prior that cannot be one.
    #[error("priors[{prior}] {what}")]
    Prior {
        /// Which.
        prior: usize,
        /// What is wrong.
        what: String,
    },
    /// The linear algebra failed.
    #[error(transparent)]
    LeastSquares(#[from] LeastSquaresError),
}

/// Finds `cam_from_world` of every view from relative rotations and priors.
///
/// # Errors
/// [`OrientationError`] where an edge or a prior cannot be used; it is named by its index. Two edges of one pair of views,
/// in either direction, are an error too.
///
/// # Example
/// ```
/// use panopath::geometry::Rotation;
/// use panopath::orientation::{OrientationOptions, RelativeRotation, average_rotations};
/// let quarter = Rotation::exp(&[0.0, 0.0, std::f64::consts::FRAC_PI_2]);
/// let edge = |first, second| RelativeRotation { first, second, second_from_first: quarter, sigma_rad: 0.01 };
/// let ring = [edge(0, 1), edge(1, 2), edge(2, 3), edge(3, 0)];
/// let found = average_rotations(4, &ring, &[], &OrientationOptions::default())?;
/// assert!((found.cam_from_world[2].log()[2].abs() - std::f64::consts::PI).abs() < 1e-9);
/// # Ok::<(), panopath::orientation::OrientationError>(())
/// ```
pub fn average_rotations<const D: usize>(
    n_views: usize,
    edges: &[RelativeRotation<D>],
    priors: &[OrientationPrior<D>],
    options: &OrientationOptions,
) -> Result<Orientations<D>, OrientationError> {
    const { assert!(D == 2 || D == 3) }
    let relative = check_edges(n_views, edges)?;
    let known = check_priors(n_views, priors)?;
    let sigma: Vec<f64> = edges.iter().map(|e| e.sigma_rad).collect();
    let input = Input { n_views, ends: edges.iter().map(|e| (e.first, e.second)).collect(), relative, sigma, known };
    let ups = if D == 2 { Some(vec![[0.0, 0.0, 1.0]; n_views]) } else { ups_for_good(&input, options) };
    let average = match &ups {
        Some(ups) => about_the_vertical(&input, ups, options)?,
        None => in_space(&input, options)?,
    };
    Ok(present(&input, average, D == 2))
}

/// The input in space; the plane is embedded as turns about z.
struct Input {
    n_views: usize,
    ends: Vec<(u32, u32)>,
    relative: Vec<Quaternion>,
    sigma: Vec<f64>,
    known: Vec<(u32, SpatialPrior)>,
}

/// Up of each view, where all are known so well against the edges that they need not be sought.
fn ups_for_good(input: &Input, options: &OrientationOptions) -> Option<Vec<Vector<3>>> {
    let ups = tight_ups(input.n_views, &input.known, &input.sigma, 1.0)?;
    if !options.estimate_noise {
        return Some(ups);
    }
    // edges better than their sigma says ask for better ups
    let graph = Graph::new(input.n_views, input.ends.iter().copied());
    let credible = vec![true; graph.n_edges()];
    let edges = Edges { graph: &graph, relative: &input.relative, sigma: &input.sigma, credible: &credible };
    tight_ups(input.n_views, &input.known, &input.sigma, noise_from_triangles(&edges).unwrap_or(1.0))
}

fn in_space(input: &Input, options: &OrientationOptions) -> Result<Average<Quaternion, 3>, OrientationError> {
    let graph = Graph::new(input.n_views, input.ends.iter().copied());
    let mut up = vec![None; input.n_views];
    for (view, prior) in &input.known {
        if let SpatialPrior::Up { up: measured, weight } = prior {
            up[*view as usize] = Some((*measured, 1.0 / weight));
        }
    }
    let credible: Vec<bool> = (0..graph.n_edges()).map(|edge| keeps_the_vertical(input, edge, &up)).collect();
    let edges = Edges { graph: &graph, relative: &input.relative, sigma: &input.sigma, credible: &credible };
    Ok(average(&problem(edges, input.known.clone(), options))?)
}

/// Does an edge take a known up to a known up?
fn keeps_the_vertical(input: &Input, edge: usize, up: &[Option<(Vector<3>, f64)>]) -> bool {
    let (first, second) = input.ends[edge];
    let (Some((a, va)), Some((b, vb))) = (up[first as usize], up[second as usize]) else { return true };
    let sigma = (input.sigma[edge].powi(2) + va + vb).sqrt();
    angle_between(&input.relative[edge].apply(&a), &b) <= cut(3) * sigma
}

/// Solves for turns about the vertical alone, and brings the answer back to space.
fn about_the_vertical(
    input: &Input,
    ups: &[Vector<3>],
    options: &OrientationOptions,
) -> Result<Average<Quaternion, 3>, OrientationError> {
    let levelled = level(ups, &input.ends, &input.relative, &input.sigma, &input.known);
    let upright: Vec<usize> = (0..input.ends.len()).filter(|&edge| levelled.upright[edge]).collect();
    let graph = Graph::new(input.n_views, upright.iter().map(|&edge| input.ends[edge]));
    let relative: Vec<Angle> = upright.iter().map(|&edge| levelled.turn[edge]).collect();
    let sigma: Vec<f64> = upright.iter().map(|&edge| input.sigma[edge]).collect();
    let credible = vec![true; upright.len()];
    let edges = Edges { graph: &graph, relative: &relative, sigma: &sigma, credible: &credible };
    let found = average(&problem(edges, levelled.priors, options))?;
    let mut inlier = vec![false; input.ends.len()];
    for (&edge, &kept) in upright.iter().zip(&found.inlier) {
        inlier[edge] = kept;
    }
    let mut tilt = vec![0.0; input.n_views];
    for (view, prior) in &input.known {
        if let SpatialPrior::Up { weight, .. } = prior {
            tilt[*view as usize] = 1.0 / weight;
        }
    }
    let in_space = |(m, t): (&Matrix<1>, &f64)| [[*t, 0.0, 0.0], [0.0, *t, 0.0], [0.0, 0.0, m[0][0]]];
    let turns = levelled.cam_from_level.iter().zip(&found.cam_from_world);
    Ok(Average {
        cam_from_world: turns.map(|(level, psi)| level.compose(&Quaternion::about_z(psi.0))).collect(),
        part: found.part,
        inlier,
        noise: found.noise,
        iterations: found.iterations,
        converged: found.converged,
        covariance: found.covariance.map(|blocks| blocks.iter().zip(&tilt).map(in_space).collect()),
    })
}

fn problem<'a, T: Turn<K>, const K: usize>(
    edges: Edges<'a, T>,
    priors: Vec<(u32, T::Prior)>,
    options: &OrientationOptions,
) -> Problem<'a, T, K> {
    Problem {
        edges,
        priors,
        linear: options.linear_solver,
        max_iterations: options.max_iterations,
        estimate_noise: options.estimate_noise,
        covariance: options.covariance,
    }
}

/// What priors hold of a part.
#[derive(Debug, Clone, Copy, Default)]
struct Held {
    vertical: bool,
    heading: bool,
}

fn held(input: &Input, part: &[u32], is_planar: bool) -> Vec<Held> {
    let mut held = vec![Held { vertical: is_planar, heading: false }; part.len()];
    for (view, prior) in &input.known {
        let held = &mut held[part[*view as usize] as usize];
        match prior {
            SpatialPrior::Orientation { .. } => *held = Held { vertical: true, heading: true },
            SpatialPrior::Up { .. } => held.vertical = true,
            SpatialPrior::Heading { .. } => held.heading = true,
        }
    }
    held
}

/// The answer in the frames that the parts are given in.
fn present<const D: usize>(input: &Input, mut found: Average<Quaternion, 3>, is_planar: bool) -> Orientations<D> {
    let held = held(input, &found.part, is_planar);
    let view_component = components(&found.part, &held);
    let covariance_rad2 = covariances(&found, &view_component);
    frame(&mut found, &held);
    let n_components = view_component.iter().max().map_or(0, |c| c + 1);
    let status = match n_components {
        0 => OrientationStatus::Undetermined,
        _ if !found.converged => OrientationStatus::MaxIterations,
        1 if view_component.iter().all(|&c| c == 0) => OrientationStatus::Converged,
        _ => OrientationStatus::Disconnected,
    };
    let residual_of = |(edge, &(first, second)): (usize, &(u32, u32))| {
        let (a, b) = (first as usize, second as usize);
        if view_component[a] < 0 || view_component[a] != view_component[b] {
            return f64::NAN;
        }
        norm(&residual(&input.relative[edge], &found.cam_from_world[a], &found.cam_from_world[b]))
    };
    let mut sigma = input.sigma.clone();
    Orientations {
        residual_rad: input.ends.iter().enumerate().map(residual_of).collect(),
        cam_from_world: (0..input.n_views)
            .map(|view| extracted(&found.cam_from_world[view].rotation(), view_component[view] >= 0))
            .collect(),
        edge_inlier: found.inlier,
        view_component,
        status,
        iterations: found.iterations,
        sigma_rad: found.noise * median(&mut sigma).unwrap_or(f64::NAN),
        covariance_rad2,
    }
}

/// Number of each view's part: the largest first, equals by their first view; single views only where priors fix them.
fn components(part: &[u32], held: &[Held]) -> Vec<i32> {
    let mut size = vec![0usize; part.len()];
    for &p in part {
        size[p as usize] += 1;
    }
    let mut order: Vec<usize> =
        (0..part.len()).filter(|&p| size[p] > 1 || (size[p] == 1 && held[p].vertical && held[p].heading)).collect();
    order.sort_by_key(|&p| std::cmp::Reverse(size[p]));
    let mut number = vec![-1; part.len()];
    for (rank, &p) in order.iter().enumerate() {
        number[p] = rank as i32;
    }
    part.iter().map(|&p| number[p as usize]).collect()
}

/// From the world to the cameras: a turn `w` in the world is `R w` in the camera.
fn covariances(found: &Average<Quaternion, 3>, component: &[i32]) -> Vec<Matrix<3>> {
    let in_camera = |(view, block): (usize, &Matrix<3>)| {
        if component[view] < 0 {
            return [[f64::NAN; 3]; 3];
        }
        let turn = found.cam_from_world[view].rotation();
        *turn.compose(&Rotation::trusted(*block)).compose(&turn.inverse()).matrix()
    };
    found.covariance.iter().flatten().enumerate().map(in_camera).collect()
}

/// Turns each part that is free as a whole so that its first view has the identity, or is as near it as the vertical lets.
fn frame(found: &mut Average<Quaternion, 3>, held: &[Held]) {
    let turn: Vec<Quaternion> = (0..held.len())
        .map(|view| match held[found.part[view] as usize] {
            Held { vertical: true, heading: true } => Quaternion::identity(),
            Held { vertical: true, heading: false } => Quaternion::about_z(-found.cam_from_world[view].angle_about_z()),
            Held { vertical: false, .. } => found.cam_from_world[view].inverse(),
        })
        .collect();
    for (own, part) in found.cam_from_world.iter_mut().zip(&found.part) {
        *own = own.compose(&turn[*part as usize]);
    }
    for (view, own) in found.cam_from_world.iter_mut().enumerate() {
        if found.part[view] as usize == view && !held[view].vertical {
            // to the last digit
            *own = Quaternion::identity();
        }
    }
}

/// The rotation as the caller's dimension holds it; NaN where it is not determined.
fn extracted<const D: usize>(rotation: &Rotation<3>, is_determined: bool) -> Rotation<D> {
    let entry = |r: usize, c: usize| if is_determined { rotation.matrix()[r][c] } else { f64::NAN };
    Rotation::trusted(std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c))))
}

/// A rotation of the plane is one about z.
fn embedded<const D: usize>(rotation: &Rotation<D>) -> Quaternion {
    let m = rotation.matrix();
    if D == 2 {
        return Quaternion::about_z(m[1][0].atan2(m[0][0]));
    }
    Quaternion::of(&Rotation::trusted(std::array::from_fn(|r| std::array::from_fn(|c| m[r][c]))))
}

/// The relative rotations, where every edge can be one.
fn check_edges<const D: usize>(
    n_views: usize,
    edges: &[RelativeRotation<D>],
) -> Result<Vec<Quaternion>, OrientationError> {
    let mut pairs = Vec::with_capacity(edges.len());
    for (edge, e) in edges.iter().enumerate() {
        let refuse = |what: String| Err(OrientationError::Edge { edge, what });
        for view in [e.first, e.second] {
            if view as usize >= n_views {
                return refuse(format!("names the view {view}, expected one below {n_views}"));
            }
        }
        if e.first == e.second {
            return refuse(format!("joins the view {} with itself, expected two views", e.first));
        }
        if e.second_from_first.matrix().iter().flatten().any(|x| !x.is_finite()) {
            return refuse("has a rotation that is not finite".to_owned());
        }
        if !(e.sigma_rad > 0.0 && e.sigma_rad.is_finite()) {
            return refuse(format!("has sigma_rad {}, expected a positive finite number", e.sigma_rad));
        }
        pairs.push((e.first.min(e.second), e.first.max(e.second), edge));
    }
    pairs.sort_unstable();
    let again = pairs.windows(2).filter(|w| (w[0].0, w[0].1) == (w[1].0, w[1].1)).min_by_key(|w| w[1].2);
    if let Some([(a, b, before), (_, _, edge)]) = again {
        let what = format!("joins the views {a} and {b} again, as edges[{before}] does, expected each pair once");
        return Err(OrientationError::Edge { edge: *edge, what });
    }
    Ok(edges.iter().map(|e| embedded(&e.second_from_first)).collect())
}

/// The priors as the solver takes them, where every one can be used.
fn check_priors<const D: usize>(
    n_views: usize,
    priors: &[OrientationPrior<D>],
) -> Result<Vec<(u32, SpatialPrior)>, OrientationError> {
    let mut seen = std::collections::HashSet::new();
    let mut known = Vec::with_capacity(priors.len());
    for (prior, p) in priors.iter().enumerate() {
        let refused = |what: String| OrientationError::Prior { prior, what };
        if p.view as usize >= n_views {
            return Err(refused(format!("names the view {}, expected one below {n_views}", p.view)));
        }
        if !seen.insert((p.view, std::mem::discriminant(&p.kind))) {
            return Err(refused(format!("is the second of its kind for the view {}, expected one", p.view)));
        }
        known.push((p.view, check_prior(&p.kind).map_err(refused)?));
    }
    Ok(known)
}

fn check_prior<const D: usize>(kind: &PriorKind<D>) -> Result<SpatialPrior, String> {
    let weight = |sigma: f64| match sigma {
        s if s > 0.0 && s.is_finite() && s.powi(-2).is_finite() => Ok(s.powi(-2)),
        s => Err(format!("has sigma_rad {s}, expected a positive finite number")),
    };
    let unit = |name: &str, v: &Vector<3>| match norm(v) {
        length if (length - 1.0).abs() <= ROTATION_TOLERANCE => Ok(scale(1.0 / length, v)),
        length => Err(format!("has {name} of length {length}, expected a unit vector")),
    };
    match kind {
        PriorKind::Orientation { cam_from_world, covariance_rad2 } => {
            if cam_from_world.matrix().iter().flatten().any(|x| !x.is_finite()) {
                return Err("has a rotation that is not finite".to_owned());
            }
            let information = if D == 2 {
                let spread = covariance_rad2[2][2].max(0.0).sqrt();
                [[0.0; 3], [0.0; 3], [0.0, 0.0, weight(spread)?]]
            } else {
                inverse_of_covariance(covariance_rad2)?
            };
            Ok(SpatialPrior::Orientation { cam_from_world: embedded(cam_from_world), information })
        }
        PriorKind::Gravity { .. } if D == 2 => Err("is a gravity, which the plane has not".to_owned()),
        PriorKind::Gravity { up_in_cam, sigma_rad } => {
            Ok(SpatialPrior::Up { up: unit("up_in_cam", up_in_cam)?, weight: weight(*sigma_rad)? })
        }
        PriorKind::Heading { heading_rad, sigma_rad, forward } => {
            if !heading_rad.is_finite() {
                return Err(format!("has heading_rad {heading_rad}, expected a finite number"));
            }
            let axis = if D == 2 { [forward[0], forward[1], 0.0] } else { *forward };
            let forward = unit("forward", &axis)?;
            Ok(SpatialPrior::Heading { heading_rad: wrapped(*heading_rad), forward, weight: weight(*sigma_rad)? })
        }
    }
}

/// Inverse of a covariance; an isotropic one stays isotropic to the last digit.
fn inverse_of_covariance(m: &Matrix<3>) -> Result<Matrix<3>, String> {
    let refused = || "has a covariance that is not symmetric and positive definite".to_owned();
    let largest = m.iter().flatten().fold(0.0, |a: f64, b| a.max(b.abs()));
    let skew = (0..3).any(|r| (0..3).any(|c| (m[r][c] - m[c][r]).abs() > 1e-9 * largest));
    let (values, vectors) = symmetric_eigen(m).map_err(|_| refused())?;
    if skew || values[0].is_nan() || values[0] <= 1e-14 * values[2] || !(1.0 / values[0]).is_finite() {
        return Err(refused());
    }
    let isotropic = (0..3).all(|r| (0..3).all(|c| m[r][c] == if r == c { m[0][0] } else { 0.0 }));
    Ok(std::array::from_fn(|r| {
        std::array::from_fn(|c| match isotropic {
            true => f64::from(u8::from(r == c)) / m[0][0],
            false => (0..3).map(|k| vectors[k][r] * vectors[k][c] / values[k]).sum(),
        })
    }))
}
