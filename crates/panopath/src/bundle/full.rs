//! The system of cameras and points together, for inputs with fewer points than cameras.
//!
//! Every pair of cameras that share a point is coupled once points are eliminated; where thousands of cameras see a dozen
//! landmarks, that is all of them. Left in the system, points couple to cameras alone, and the order of elimination takes
//! the cameras first.

use super::part::{Lanes, Part};
use super::reduced::{CameraTerm, Damping, Factorised, Freedoms, Row, Weighing};
use crate::least_squares::{BlockPattern, BlockSolver, LeastSquaresError, LinearSolver, scalar_slots};

pub(crate) struct FullSystem<const V: usize> {
    pattern: BlockPattern,
    n_cameras: usize,
    /// Of cameras and points, `V` for each.
    held: Vec<bool>,
    values: Vec<f64>,
    rhs: Vec<f64>,
    diagonal: Vec<[f64; V]>,
    solver: BlockSolver<V>,
}

impl<const V: usize> FullSystem<V> {
    /// Finds which cameras see which points and orders them all. `held` are the unknowns of cameras that stay zero.
    pub fn analyse<const D: usize>(part: &Part<D>, mut held: Vec<bool>) -> Result<Self, LeastSquaresError> {
        let (n_cameras, n_points) = (part.n_nodes, part.n_tracks());
        let mut rows: Vec<Vec<u32>> = (0..n_cameras as u32).map(|i| vec![i]).collect();
        for j in 0..n_points {
            for o in part.observations(j) {
                let column = &mut rows[part.node_of(o) as usize];
                let row = (n_cameras + j) as u32;
                if column.last() != Some(&row) {
                    column.push(row);
                }
            }
        }
        rows.extend((0..n_points).map(|j| vec![(n_cameras + j) as u32]));
        let mut col_start = vec![0u32];
        for column in &rows {
            col_start.push(col_start.last().copied().unwrap_or(0) + column.len() as u32);
        }
        let pattern = BlockPattern { col_start, row: rows.concat() };
        // points have fewer unknowns than cameras: the others of their block are held
        held.extend((0..n_points).flat_map(|_| (0..V).map(|k| k >= D)));
        let n_nodes = n_cameras + n_points;
        Ok(Self {
            n_cameras,
            values: vec![0.0; pattern.row.len() * V * V - n_nodes * (V * (V - 1) / 2)],
            rhs: vec![0.0; n_nodes * V],
            diagonal: vec![[0.0; V]; n_cameras],
            solver: BlockSolver::analyse(&pattern, LinearSolver::Direct)?,
            held,
            pattern,
        })
    }

    /// Sums the observations and the cameras' own terms.
    pub fn assemble<const D: usize>(
        &mut self,
        part: &Part<D>,
        weighing: &impl Weighing<D>,
        freedoms: &impl Freedoms<D, V>,
        terms: &[CameraTerm<V>],
        damping: Damping,
    ) {
        self.values.fill(0.0);
        self.rhs.fill(0.0);
        self.diagonal.fill([0.0; V]);
        let mut point_diagonal = vec![[0.0; V]; part.n_tracks()];
        for j in 0..part.n_tracks() {
            let point = self.n_cameras + j;
            let point_stays = freedoms.holds_point(j);
            self.held[point * V..point * V + D].fill(point_stays);
            for o in part.observations(j) {
                let model = weighing.observe(o, j);
                let camera = part.node_of(o) as usize;
                let unit = |r: usize| Lanes(std::array::from_fn(|c| f64::from(c == r)));
                let rows: [Lanes; D] = std::array::from_fn(|r| model.apply::<D>(&unit(r)));
                let lifted = std::array::from_fn(|r| freedoms.lift(o, j, &rows[r]));
                let own = freedoms.lift_rows(o, j, &lifted);
                let pull = freedoms.lift(o, j, &model.gradient);
                self.add(camera, camera, |r, c| own[r].at(c));
                self.add(point, camera, |r, c| if r < D { -lifted[r].at(c) } else { 0.0 });
                self.add(point, point, |r, c| if r < D && c < D { rows[r].0[c] } else { 0.0 });
                for r in 0..V {
                    self.diagonal[camera][r] += own[r].at(r);
                    self.rhs[camera * V + r] -= pull.at(r);
                }
                for r in 0..D {
                    point_diagonal[j][r] += rows[r].0[r];
                    self.rhs[point * V + r] += model.gradient.0[r];
                }
            }
        }
        for term in terms {
            let camera = term.node as usize;
            self.add(camera, camera, |r, c| term.information[r][c]);
            for r in 0..V {
                self.diagonal[camera][r] += term.information[r][r];
                self.rhs[camera * V + r] += term.gradient[r];
            }
        }
        self.hold_and_damp(&point_diagonal, damping);
    }

    /// Adds to the block (row, column), row >= column, of the lower triangle.
    fn add(&mut self, row: usize, column: usize, entry: impl Fn(usize, usize) -> f64) {
        let blocks = self.pattern.column(column);
        let k = blocks.start + self.pattern.row[blocks].partition_point(|&r| (r as usize) < row);
        for c in 0..V {
            let slot = scalar_slots::<V>(&self.pattern, column, k, c);
            let first = if row == column { c } else { 0 };
            for r in first..V {
                self.values[slot + r - first] += entry(r, c);
            }
        }
    }

    fn hold_and_damp(&mut self, point_diagonal: &[[f64; V]], damping: Damping) {
        let all = || self.diagonal.iter().chain(point_diagonal);
        let largest = all().flatten().copied().fold(f64::MIN_POSITIVE, f64::max);
        let diagonal: Vec<[f64; V]> = all().copied().collect();
        // an unknown that nothing tells of is held as well, until something does
        let held: Vec<bool> =
            self.held.iter().zip(diagonal.iter().flatten()).map(|(held, d)| *held || *d <= 0.0).collect();
        for column in 0..self.pattern.n_nodes() {
            let relative = if column < self.n_cameras { damping.view } else { damping.point };
            for k in self.pattern.column(column) {
                let row = self.pattern.row[k] as usize;
                for c in 0..V {
                    let slot = scalar_slots::<V>(&self.pattern, column, k, c);
                    let first = if row == column { c } else { 0 };
                    let hold = held[column * V + c];
                    for r in first..V {
                        if hold || held[row * V + r] {
                            self.values[slot + r - first] = 0.0;
                        }
                    }
                    if row == column {
                        self.values[slot] += if hold { largest } else { relative * diagonal[column][c] };
                    }
                }
            }
        }
        for (right, _) in self.rhs.iter_mut().zip(&held).filter(|(_, held)| **held) {
            *right = 0.0;
        }
    }

    /// Which nodes are coupled, and the lower triangle as it was assembled last.
    pub fn matrix(&self) -> (&BlockPattern, &[f64]) {
        (&self.pattern, &self.values)
    }

    /// Factorises the assembled system.
    pub fn factorise(&mut self) -> Result<(), LeastSquaresError> {
        self.solver.factorise(&self.pattern, &self.values)
    }

    /// The step of the cameras.
    pub fn solve(&mut self) -> Result<Vec<[f64; V]>, LeastSquaresError> {
        self.factorise()?;
        let mut x = self.rhs.clone();
        self.solver.solve(&mut x, 1)?;
        Ok(x.as_chunks::<V>().0[..self.n_cameras].to_vec())
    }
}

impl<const V: usize> Factorised for FullSystem<V> {
    fn solve_for(&self, right: &mut [f64]) -> Result<(), LeastSquaresError> {
        let mut x = vec![0.0; self.rhs.len()];
        x[..right.len()].copy_from_slice(right);
        self.solver.solve(&mut x, 1)?;
        right.copy_from_slice(&x[..right.len()]);
        Ok(())
    }

    fn held(&self) -> &[bool] {
        &self.held[..self.n_cameras * V]
    }

    fn diagonal(&self) -> &[f64] {
        self.diagonal.as_flattened()
    }
}
