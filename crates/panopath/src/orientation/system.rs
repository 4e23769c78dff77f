//! The linear system of one step: a weighted graph Laplacian, plus what priors add to its diagonal.
//!
//! With `rho_e` the residual of edge `e` and `w_i` the turn of view `i`, both in the world, a step minimises
//! `sum_e weight_e |rho_e + w_second - w_first|^2` and the priors' quadratic models. No rotation enters the first sum, so
//! that the `K` axes share one scalar matrix unless a prior couples them: 27 times less work to factorise than `3 x 3`
//! blocks.

use crate::geometry::{Matrix, Vector};
use crate::least_squares::{BlockPattern, BlockSolver, LeastSquaresError, LinearSolver, scalar_slots, symmetric_eigen};

use super::graph::Graph;
use super::turns::{Pull, Role};

/// What priors make of the matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Coupling {
    /// One scalar matrix for all axes.
    Uniform,
    /// One scalar matrix for x and y, another for z.
    Vertical,
    /// One matrix of `K x K` blocks.
    Full,
}

impl Coupling {
    pub fn of(roles: impl Iterator<Item = Role>) -> Self {
        roles.fold(Self::Uniform, |coupling, role| match (coupling, role) {
            (Self::Full, _) | (_, Role::Coupled | Role::Heading) => Self::Full,
            (_, Role::Up) => Self::Vertical,
            (known, Role::Isotropic) => known,
        })
    }
}

/// The system, its pattern analysed once.
pub(super) struct System<const K: usize> {
    pattern: BlockPattern,
    /// Block of each edge in the lower triangle.
    block: Vec<u32>,
    solver: Solver<K>,
}

enum Solver<const K: usize> {
    /// A solver for each group of axes that share a matrix.
    Scalar(Vec<(Vec<usize>, BlockSolver<1>)>),
    Blocks(BlockSolver<K>),
}

/// A direction in which a part is free as a whole, held at the part's first view: adding `strength` there changes nothing
/// but which of the equal solutions is found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pin<const K: usize> {
    pub view: u32,
    pub direction: Vector<K>,
    pub strength: f64,
}

/// The values of one step.
pub(super) struct Values<'a, const K: usize> {
    /// Weight of each edge.
    pub weight: &'a [f64],
    /// Quadratic models of the priors, by view.
    pub pulls: &'a [(u32, Pull<K>)],
    pub pins: &'a [Pin<K>],
}

/// Added to the diagonal, relative to it, where the matrix is singular to working precision.
const DAMPING: f64 = 1e-9;

impl<const K: usize> System<K> {
    pub fn analyse(graph: &Graph, coupling: Coupling, linear: LinearSolver) -> Result<Self, LeastSquaresError> {
        let (pattern, block) = pattern_of(graph);
        let groups: Vec<Vec<usize>> = match coupling {
            Coupling::Vertical if K == 3 => vec![vec![0, 1], vec![2]],
            _ => vec![(0..K).collect()],
        };
        let solver = if coupling == Coupling::Full && K > 1 {
            Solver::Blocks(BlockSolver::analyse(&pattern, linear)?)
        } else {
            let analysed = groups.into_iter().map(|axes| Ok((axes, BlockSolver::analyse(&pattern, linear)?)));
            Solver::Scalar(analysed.collect::<Result<_, LeastSquaresError>>()?)
        };
        Ok(Self { pattern, block, solver })
    }

    /// Factorises the matrix of these values, a little damped where it would be singular.
    pub fn factorise(&mut self, graph: &Graph, values: &Values<'_, K>) -> Result<(), LeastSquaresError> {
        match self.factorise_damped(graph, values, 0.0) {
            Err(LeastSquaresError::Singular { .. }) => self.factorise_damped(graph, values, DAMPING),
            done => done,
        }
    }

    fn factorise_damped(
        &mut self,
        graph: &Graph,
        values: &Values<'_, K>,
        damping: f64,
    ) -> Result<(), LeastSquaresError> {
        let mut diagonal = vec![[[0.0; K]; K]; graph.n_views()];
        for edge in 0..graph.n_edges() {
            let (a, b) = graph.ends(edge);
            for k in 0..K {
                diagonal[a][k][k] += values.weight[edge];
                diagonal[b][k][k] += values.weight[edge];
            }
        }
        for (view, pull) in values.pulls {
            add_matrix(&mut diagonal[*view as usize], &pull.information, 1.0);
        }
        for pin in values.pins {
            add_matrix(&mut diagonal[pin.view as usize], &outer(&pin.direction), pin.strength);
        }
        for block in diagonal.iter_mut().filter(|_| damping > 0.0) {
            for k in 0..K {
                block[k][k] += damping * block[k][k] + f64::MIN_POSITIVE;
            }
        }
        let off: Vec<(u32, f64)> = self.block.iter().copied().zip(values.weight.iter().map(|w| -w)).collect();
        match &mut self.solver {
            Solver::Scalar(groups) => {
                for (axes, solver) in groups {
                    let axis = axes[0];
                    let own = |view: usize| [[diagonal[view][axis][axis]]];
                    solver.factorise(&self.pattern, &lower_values::<1>(&self.pattern, own, &off))?;
                }
            }
            Solver::Blocks(solver) => {
                solver.factorise(&self.pattern, &lower_values::<K>(&self.pattern, |view| diagonal[view], &off))?;
            }
        }
        Ok(())
    }

    /// Solves with the last factorisation: `force` in, turns out.
    pub fn solve(&self, force: &mut [Vector<K>]) -> Result<(), LeastSquaresError> {
        match &self.solver {
            Solver::Scalar(groups) => {
                for (axes, solver) in groups {
                    let mut right: Vec<f64> =
                        axes.iter().flat_map(|&axis| force.iter().map(move |f| f[axis])).collect();
                    solver.solve(&mut right, axes.len())?;
                    for (&axis, solved) in axes.iter().zip(right.chunks_exact(force.len().max(1))) {
                        for (f, x) in force.iter_mut().zip(solved) {
                            f[axis] = *x;
                        }
                    }
                }
                Ok(())
            }
            Solver::Blocks(solver) => solver.solve(force.as_flattened_mut(), 1),
        }
    }

    /// Diagonal block of the inverse for each view, by unit right-hand sides: a solve for each view.
    pub fn inverse_blocks(&self, n_views: usize) -> Result<Vec<Matrix<K>>, LeastSquaresError> {
        let mut blocks = vec![[[0.0; K]; K]; n_views];
        let mut force = vec![[0.0; K]; n_views];
        let rounds = if matches!(self.solver, Solver::Scalar(_)) { 1 } else { K };
        for view in 0..n_views {
            for round in 0..rounds {
                force.fill([0.0; K]);
                force[view] = std::array::from_fn(|k| f64::from(u8::from(rounds == 1 || k == round)));
                self.solve(&mut force)?;
                for k in 0..K {
                    if rounds == 1 {
                        blocks[view][k][k] = force[view][k];
                    } else {
                        blocks[view][k][round] = force[view][k];
                    }
                }
            }
        }
        Ok(blocks)
    }
}

/// Directions in which parts are free as a whole, given what priors hold in sum.
pub(super) fn pins<const K: usize>(
    graph: &Graph,
    part: &[u32],
    weight: &[f64],
    pulls: &[(u32, Pull<K>)],
    coupling: Coupling,
) -> Result<Vec<Pin<K>>, LeastSquaresError> {
    let mut held = vec![[[0.0; K]; K]; graph.n_views()];
    for (view, pull) in pulls {
        add_matrix(&mut held[part[*view as usize] as usize], &pull.information, 1.0);
    }
    let mut pins = Vec::new();
    for view in (0..graph.n_views()).filter(|&view| part[view] as usize == view) {
        let strength: f64 = graph.neighbours(view).iter().map(|n| weight[n.edge as usize]).sum();
        let strength = if strength > 0.0 { strength } else { 1.0 };
        let (values, vectors) = if coupling == Coupling::Full {
            symmetric_eigen(&held[view])?
        } else {
            (
                std::array::from_fn(|k| held[view][k][k]),
                std::array::from_fn(|k| std::array::from_fn(|r| f64::from(u8::from(r == k)))),
            )
        };
        let largest = values.iter().fold(0.0, |a: f64, &b| a.max(b));
        for (value, direction) in values.iter().zip(vectors) {
            if *value <= 1e-9 * largest {
                pins.push(Pin { view: view as u32, direction, strength });
            }
        }
    }
    Ok(pins)
}

/// Lower triangle of the Laplacian's pattern, and the block of each edge in it. Edges join distinct pairs.
fn pattern_of(graph: &Graph) -> (BlockPattern, Vec<u32>) {
    let mut pattern = BlockPattern { col_start: vec![0], row: Vec::with_capacity(graph.n_views() + graph.n_edges()) };
    let mut block = vec![0; graph.n_edges()];
    for view in 0..graph.n_views() {
        pattern.row.push(view as u32);
        for n in graph.neighbours(view).iter().filter(|n| n.view as usize > view) {
            block[n.edge as usize] = pattern.row.len() as u32;
            pattern.row.push(n.view);
        }
        pattern.col_start.push(pattern.row.len() as u32);
    }
    (pattern, block)
}

/// The values in the order of [`scalar_slots`]: `own(view)` on the diagonal, multiples of the identity off it.
fn lower_values<const B: usize>(
    pattern: &BlockPattern,
    own: impl Fn(usize) -> Matrix<B>,
    off: &[(u32, f64)],
) -> Vec<f64> {
    let mut of_block = vec![0.0; pattern.row.len()];
    for &(block, value) in off {
        of_block[block as usize] = value;
    }
    let n_values = pattern.row.len() * B * B - pattern.n_nodes() * (B * (B - 1) / 2);
    let mut values = vec![0.0; n_values];
    for view in 0..pattern.n_nodes() {
        let diagonal = own(view);
        for k in pattern.column(view) {
            for c in 0..B {
                let slot = scalar_slots::<B>(pattern, view, k, c);
                if pattern.row[k] as usize == view {
                    for r in c..B {
                        values[slot + r - c] = diagonal[r][c];
                    }
                } else {
                    values[slot + c] = of_block[k];
                }
            }
        }
    }
    values
}

fn outer<const K: usize>(v: &Vector<K>) -> Matrix<K> {
    std::array::from_fn(|r| std::array::from_fn(|c| v[r] * v[c]))
}

pub(super) fn add_matrix<const K: usize>(to: &mut Matrix<K>, m: &Matrix<K>, factor: f64) {
    for r in 0..K {
        for c in 0..K {
            to[r][c] += factor * m[r][c];
        }
    }
}
