//! The paper's own least squares (Knill and Ramirez-Herran 2007, sections 4 and 5), for study and comparison.
//!
//! Every observation gives equations linear in the unknown positions, `(I - v v^T)(x - c) = 0`; in the plane this is
//! `cos(theta)(b - y) = sin(theta)(a - x)`. They are solved at once, or in two stages: first the plane across a vertical
//! axis, then `cos(phi)(z - c) = sin(phi) r` for the heights, `phi` the elevation of the point seen from the camera (the
//! printed slope has cosine and sine exchanged and the opposite sign).
//!
//! The system is homogeneous. With the first point at the origin and the second held at `p`, all else is linear in `p`,
//! and the cost is `p^T K p` with a `D x D` matrix `K`; each gauge then is a small problem in `p`:
//! `p_1 = 1`, `|p| = 1` (smallest eigenvector), or the linear functional `sum v^T (x - c) = 1`.

use super::options::{LinearForm, LinearGauge};
use crate::bundle::estimate::Estimate;
use crate::bundle::part::{Lanes, Part};
use crate::geometry::{Vector, add, dot, norm, scale, sub};
use crate::least_squares::{
    BlockPattern, LeastSquaresError, SparseCholesky, minimum_degree, scalar_slots, symmetric_eigen,
};

/// Corrections of the solution from freshly computed residuals; the normal equations alone lose half the digits.
const REFINEMENTS: usize = 3;
/// A horizontal direction shorter than this has no azimuth.
const POLE: f64 = 1e-12;

/// One observation of a linear system: node `view`, node `track`, a unit direction and the weight of its equations.
struct Equation<const D: usize> {
    view: usize,
    track: usize,
    direction: Vector<D>,
    weight: f64,
}

/// Homogeneous equations `(I - d d^T)(x_track - x_view) = 0` between nodes, the views first, then the tracks.
struct Homogeneous<'a, const D: usize> {
    n_views: usize,
    n_nodes: usize,
    equations: &'a [Equation<D>],
}

/// Solves the paper's equations for one part, up to the caller's gauge.
pub(super) fn solve_linear<const D: usize>(
    part: &Part<D>,
    form: LinearForm,
    gauge: LinearGauge,
) -> Result<Estimate, LeastSquaresError> {
    let nodes = match form {
        LinearForm::TwoStage { vertical_axis } if D == 3 => two_stage(part, vertical_axis, gauge)?,
        _ => joint(part, gauge)?,
    };
    let (centers, points) = nodes.split_at(part.n_views);
    let lanes = |nodes: &[Vector<D>]| nodes.iter().map(Lanes::from_vector::<D>).collect();
    Ok(Estimate { centers: lanes(centers), points: lanes(points) })
}

fn joint<const D: usize>(part: &Part<D>, gauge: LinearGauge) -> Result<Vec<Vector<D>>, LeastSquaresError> {
    let equations = equations_of(part, |ray| Some(ray.vector::<D>()));
    Homogeneous { n_views: part.n_views, n_nodes: part.n_views + part.n_tracks(), equations: &equations }.solve(gauge)
}

/// Equations of every observation to which `direction` gives one.
fn equations_of<const D: usize, const E: usize>(
    part: &Part<D>,
    direction: impl Fn(&Lanes) -> Option<Vector<E>>,
) -> Vec<Equation<E>> {
    let mut equations = Vec::with_capacity(part.n_observations());
    for j in 0..part.n_tracks() {
        for o in part.observations(j) {
            if let Some(direction) = direction(&part.ray[o]) {
                let (view, track) = (part.view[o] as usize, part.n_views + j);
                equations.push(Equation { view, track, direction, weight: part.ray[o].0[3] });
            }
        }
    }
    equations
}

/// Plane first, heights second.
fn two_stage<const D: usize>(
    part: &Part<D>,
    vertical_axis: usize,
    gauge: LinearGauge,
) -> Result<Vec<Vector<D>>, LeastSquaresError> {
    let (first, second) = ((vertical_axis + 1) % D, (vertical_axis + 2) % D);
    let horizontal = |ray: &Lanes| -> Option<Vector<2>> {
        let h = [ray.0[first], ray.0[second]];
        let length = norm(&h);
        (length > POLE).then(|| scale(1.0 / length, &h))
    };
    let equations = equations_of(part, horizontal);
    let (n_views, n_nodes) = (part.n_views, part.n_views + part.n_tracks());
    let plan = Homogeneous { n_views, n_nodes, equations: &equations }.solve(gauge)?;
    let heights = heights(part, &plan, vertical_axis)?;
    Ok(plan
        .iter()
        .zip(heights)
        .map(|(xy, z)| {
            let mut node = [0.0; D];
            (node[first], node[second], node[vertical_axis]) = (xy[0], xy[1], z);
            node
        })
        .collect())
}

/// Heights of all nodes from elevations and known horizontal distances, the first point at height zero.
fn heights<const D: usize>(part: &Part<D>, plan: &[Vector<2>], axis: usize) -> Result<Vec<f64>, LeastSquaresError> {
    struct Slope {
        view: usize,
        track: usize,
        cosine: f64,
        rise: f64,
        weight: f64,
    }
    let mut slopes = Vec::with_capacity(part.n_observations());
    for j in 0..part.n_tracks() {
        for o in part.observations(j) {
            let (view, track, ray) = (part.view[o] as usize, part.n_views + j, &part.ray[o]);
            let sine = ray.0[axis];
            let distance = norm(&sub(&plan[track], &plan[view]));
            let cosine = (1.0 - sine * sine).max(0.0).sqrt();
            slopes.push(Slope { view, track, cosine, rise: sine * distance, weight: ray.0[3] });
        }
    }
    let edges: Vec<(usize, usize)> = slopes.iter().map(|s| (s.view, s.track)).collect();
    let mut normal = Normal::<1>::new(plan.len(), &edges)?;
    for s in &slopes {
        normal.add(s.view, s.track, &[[s.weight * s.cosine * s.cosine]]);
    }
    normal.factorise(&[part.n_views])?;
    let mut z = vec![0.0; plan.len()];
    for _ in 0..=REFINEMENTS {
        let mut right = vec![0.0; plan.len()];
        for s in &slopes {
            let pull = s.weight * s.cosine * (s.rise - s.cosine * (z[s.track] - z[s.view]));
            right[s.track] += pull;
            right[s.view] -= pull;
        }
        normal.solve(&mut right, 1)?;
        z.iter_mut().zip(&right).for_each(|(z, step)| *z += step);
    }
    Ok(z)
}

/// Normal equations of a graph: `D x D` blocks on the nodes and on the edges between views and tracks.
struct Normal<const D: usize> {
    pattern: BlockPattern,
    values: Vec<f64>,
    cholesky: SparseCholesky,
    held: Vec<usize>,
}

impl<const D: usize> Normal<D> {
    fn new(n_nodes: usize, edges: &[(usize, usize)]) -> Result<Self, LeastSquaresError> {
        let mut pairs: Vec<(usize, usize)> = edges.to_vec();
        pairs.extend((0..n_nodes).map(|n| (n, n)));
        pairs.sort_unstable();
        pairs.dedup();
        let mut col_start = vec![0u32; n_nodes + 1];
        for &(column, _) in &pairs {
            col_start[column + 1] += 1;
        }
        for n in 0..n_nodes {
            col_start[n + 1] += col_start[n];
        }
        let pattern = BlockPattern { col_start, row: pairs.into_iter().map(|(_, row)| row as u32).collect() };
        let cholesky = SparseCholesky::analyse::<D>(&pattern, &minimum_degree::<D>(&pattern)?)?;
        let values = vec![0.0; cholesky.n_values()];
        Ok(Self { pattern, values, cholesky, held: Vec::new() })
    }

    /// Adds the block `m` of an edge: to both nodes, and its negative between them.
    fn add(&mut self, view: usize, track: usize, m: &[[f64; D]; D]) {
        for (node, other, sign) in [(view, view, 1.0), (track, track, 1.0), (view, track, -1.0)] {
            let blocks = self.pattern.column(node);
            let k = blocks.start + self.pattern.row[blocks.clone()].partition_point(|&r| (r as usize) < other);
            for c in 0..D {
                let first = if node == other { c } else { 0 };
                let slot = scalar_slots::<D>(&self.pattern, node, k, c);
                for r in first..D {
                    self.values[slot + r - first] += sign * m[r][c];
                }
            }
        }
    }

    /// Factorises with some nodes held where they are.
    fn factorise(&mut self, held: &[usize]) -> Result<(), LeastSquaresError> {
        let largest = self.values.iter().fold(0.0, |a: f64, v| a.max(v.abs())).max(f64::MIN_POSITIVE);
        let mut values = self.values.clone();
        for column in 0..self.pattern.n_nodes() {
            for k in self.pattern.column(column) {
                let row = self.pattern.row[k] as usize;
                if !held.contains(&column) && !held.contains(&row) {
                    continue;
                }
                for c in 0..D {
                    let slot = scalar_slots::<D>(&self.pattern, column, k, c);
                    let length = if row == column { D - c } else { D };
                    values[slot..slot + length].fill(0.0);
                    if row == column {
                        values[slot] = largest;
                    }
                }
            }
        }
        self.held = held.to_vec();
        self.cholesky.factorise(&values)
    }

    /// Solves in place; held nodes get zero.
    fn solve(&self, right: &mut [f64], n_right: usize) -> Result<(), LeastSquaresError> {
        for side in right.chunks_exact_mut(self.pattern.n_nodes() * D) {
            for &node in &self.held {
                side[node * D..(node + 1) * D].fill(0.0);
            }
        }
        self.cholesky.solve(right, n_right)
    }
}

impl<const D: usize> Homogeneous<'_, D> {
    /// Positions of all nodes under a gauge, points in front of their cameras.
    fn solve(&self, gauge: LinearGauge) -> Result<Vec<Vector<D>>, LeastSquaresError> {
        let (origin, second) = (self.n_views, self.n_views + 1);
        let edges: Vec<(usize, usize)> = self.equations.iter().map(|e| (e.view, e.track)).collect();
        let mut normal = Normal::<D>::new(self.n_nodes, &edges)?;
        for e in self.equations {
            normal.add(e.view, e.track, &projector(&e.direction, e.weight));
        }
        normal.factorise(&[origin, second])?;
        // one solution for each unit vector that the second point may be held at
        let basis: Vec<Vec<Vector<D>>> = (0..D)
            .map(|c| {
                let mut start = vec![[0.0; D]; self.n_nodes];
                start[second][c] = 1.0;
                self.relax(&normal, start, None)
            })
            .collect::<Result<_, _>>()?;
        let k: [Vector<D>; D] = std::array::from_fn(|c| self.gradient(&basis[c])[second]);
        let (values, vectors) = symmetric_eigen(&k)?;
        let combine = |p: &Vector<D>| -> Vec<Vector<D>> {
            (0..self.n_nodes).map(|n| (0..D).fold([0.0; D], |x, c| add(&x, &scale(p[c], &basis[c][n])))).collect()
        };
        let mut nodes = match gauge {
            LinearGauge::PaperDistance => combine(&vectors[0]),
            LinearGauge::Paper => combine(&minimise_with_first_one(&k)?),
            LinearGauge::Functional => {
                let pull = self.functional();
                let free = self.relax(&normal, vec![[0.0; D]; self.n_nodes], Some(&pull))?;
                let h = sub(&pull[second], &self.gradient(&free)[second]);
                // p = lambda K^-1 h, scaled by the smallest eigenvalue, which is zero on exact data
                let p = (0..D).fold([0.0; D], |p, c| {
                    let share = if c == 0 { 1.0 } else { values[0] / values[c] };
                    add(&p, &scale(share * dot(&vectors[c], &h), &vectors[c]))
                });
                combine(&p).iter().zip(&free).map(|(x, f)| add(x, &scale(values[0], f))).collect()
            }
        };
        self.face_forward(&mut nodes);
        Ok(nodes)
    }

    /// Minimises over all nodes but the held ones, from `nodes`; `pull` adds a linear term.
    fn relax(
        &self,
        normal: &Normal<D>,
        mut nodes: Vec<Vector<D>>,
        pull: Option<&[Vector<D>]>,
    ) -> Result<Vec<Vector<D>>, LeastSquaresError> {
        for _ in 0..=REFINEMENTS {
            let gradient = self.gradient(&nodes);
            let mut right: Vec<f64> = gradient.iter().flatten().map(|g| -g).collect();
            if let Some(pull) = pull {
                right.iter_mut().zip(pull.iter().flatten()).for_each(|(r, p)| *r += p);
            }
            normal.solve(&mut right, 1)?;
            for (node, step) in nodes.iter_mut().zip(right.chunks_exact(D)) {
                node.iter_mut().zip(step).for_each(|(x, s)| *x += s);
            }
        }
        Ok(nodes)
    }

    /// `A^T A x`, computed from the equations and not from the normal matrix.
    fn gradient(&self, nodes: &[Vector<D>]) -> Vec<Vector<D>> {
        let mut gradient = vec![[0.0; D]; self.n_nodes];
        for e in self.equations {
            let u = sub(&nodes[e.track], &nodes[e.view]);
            let across = scale(e.weight, &sub(&u, &scale(dot(&u, &e.direction), &e.direction)));
            gradient[e.track] = add(&gradient[e.track], &across);
            gradient[e.view] = sub(&gradient[e.view], &across);
        }
        gradient
    }

    /// Gradient of `sum w d^T (x - c)`.
    fn functional(&self) -> Vec<Vector<D>> {
        let mut pull = vec![[0.0; D]; self.n_nodes];
        for e in self.equations {
            pull[e.track] = add(&pull[e.track], &scale(e.weight, &e.direction));
            pull[e.view] = sub(&pull[e.view], &scale(e.weight, &e.direction));
        }
        pull
    }

    /// Reflects everything in the origin where most points lie behind their cameras.
    fn face_forward(&self, nodes: &mut [Vector<D>]) {
        let behind = self.equations.iter().filter(|e| dot(&sub(&nodes[e.track], &nodes[e.view]), &e.direction) < 0.0);
        if 2 * behind.count() > self.equations.len() {
            nodes.iter_mut().for_each(|node| *node = scale(-1.0, node));
        }
    }
}

fn projector<const D: usize>(d: &Vector<D>, weight: f64) -> [[f64; D]; D] {
    std::array::from_fn(|r| std::array::from_fn(|c| weight * (if r == c { 1.0 } else { 0.0 } - d[r] * d[c])))
}

/// The `p` with first coordinate one that minimises `p^T k p`.
fn minimise_with_first_one<const D: usize>(k: &[Vector<D>; D]) -> Result<Vector<D>, LeastSquaresError> {
    let mut p = [0.0; D];
    p[0] = 1.0;
    if D == 2 {
        p[1] = -k[1][0] / k[1][1];
    } else {
        let det = k[1][1] * k[2][2] - k[1][2] * k[2][1];
        p[1] = (k[1][2] * k[2][0] - k[2][2] * k[1][0]) / det;
        p[2] = (k[2][1] * k[1][0] - k[1][1] * k[2][0]) / det;
    }
    if p.iter().all(|x| x.is_finite()) { Ok(p) } else { Err(LeastSquaresError::Singular { pivot: 0 }) }
}
