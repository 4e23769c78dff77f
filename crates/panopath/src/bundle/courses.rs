//! One point that moves: the normal equations of the vectors of its path.
//!
//! With `J_o = [B_1 I, .., B_K I]` (and one column more where the functions depend on a number that is sought too), the
//! models `M_o`, `q_o` of its observations give `A = sum J^T M J`, `g = sum J^T q`, and each camera takes part by
//! `T_o = L^-1 J_o^T M_o`, `A = L L^T`.

use super::part::{Course, Lanes};
use super::reduced::Quadratic;

/// Keeps the equations of a path positive definite where it is not determined, relative to their trace.
const FLOOR: f64 = 1e-14;

/// The equations of one path; its storage is used for one after the other.
#[derive(Default)]
pub(crate) struct CourseSystem {
    n: usize,
    /// Lower triangle by rows, then its factor.
    matrix: Vec<f64>,
    right: Vec<f64>,
    /// `J^T M` of each observation, `n` rows of `D` numbers; then `L^-1` of that.
    across: Vec<f64>,
    columns: usize,
}

impl CourseSystem {
    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.n
    }

    /// Sums the models of a track's observations; false where nothing counts.
    pub fn assemble<const D: usize>(&mut self, course: Course<'_>, models: &[Quadratic]) -> bool {
        let (k, n) = (course.n_functions, course.unknowns(D));
        (self.n, self.columns) = (n, D);
        for (storage, length) in
            [(&mut self.matrix, n * n), (&mut self.right, n), (&mut self.across, models.len() * n * D)]
        {
            storage.clear();
            storage.resize(length, 0.0);
        }
        let mut total = 0.0;
        for (i, (model, across)) in models.iter().zip(self.across.chunks_exact_mut(n * D)).enumerate() {
            let weight = model.direction.0[3];
            if weight <= 0.0 {
                continue;
            }
            total += weight;
            let values = &course.values[i * k..(i + 1) * k];
            let rows = model.rows::<D>();
            for (a, value) in values.iter().enumerate() {
                for r in 0..D {
                    let row = a * D + r;
                    self.right[row] += value * model.gradient.0[r];
                    for c in 0..D {
                        let entry = value * rows[r].0[c];
                        across[row * D + c] = entry;
                        for (b, other) in values[..=a].iter().enumerate() {
                            self.matrix[row * n + b * D + c] += entry * other;
                        }
                    }
                }
            }
            if let Some(bends) = course.bends {
                let row = k * D;
                let pushed = model.apply::<D>(&bends[i]);
                for c in 0..D {
                    across[row * D + c] = pushed.0[c];
                    for (b, value) in values.iter().enumerate() {
                        self.matrix[row * n + b * D + c] += value * pushed.0[c];
                    }
                }
                self.matrix[row * n + row] += bends[i].dot::<D>(&pushed);
                self.right[row] += bends[i].dot::<D>(&model.gradient);
            }
        }
        total > 0.0
    }

    /// Factorises the equations, damped along their diagonal; false where they are not finite.
    pub fn factorise(&mut self, damping: f64) -> bool {
        let n = self.n;
        let trace: f64 = (0..n).map(|i| self.matrix[i * n + i]).sum();
        if !trace.is_finite() {
            return false;
        }
        let floor = (FLOOR * trace).max(f64::MIN_POSITIVE);
        for r in 0..n {
            for c in 0..=r {
                let (before, row) = self.matrix.split_at_mut(r * n);
                let other = if c == r { &row[..c] } else { &before[c * n..c * n + c] };
                let product: f64 = row[..c].iter().zip(other).map(|(a, b)| a * b).sum();
                let entry = self.matrix[r * n + c];
                self.matrix[r * n + c] = if r == c {
                    (entry * (1.0 + damping) - product + floor).max(floor).sqrt()
                } else {
                    (entry - product) / self.matrix[c * n + c]
                };
            }
        }
        true
    }

    /// Turns the right-hand side and the rows of all observations into `L^-1` of them.
    pub fn solve_forward(&mut self) {
        let (n, d) = (self.n, self.columns);
        forward(&self.matrix, n, &mut self.right, 1);
        for across in self.across.chunks_exact_mut(n * d) {
            forward(&self.matrix, n, across, d);
        }
    }

    /// `A^-1 x` in place.
    pub fn solve(&self, x: &mut [f64]) {
        let n = self.n;
        forward(&self.matrix, n, x, 1);
        for r in (0..n).rev() {
            let known: f64 = (r + 1..n).map(|c| self.matrix[c * n + r] * x[c]).sum();
            x[r] = (x[r] - known) / self.matrix[r * n + r];
        }
    }

    /// `g`, before the equations are solved forward.
    pub fn right(&self) -> &[f64] {
        &self.right
    }

    /// Row `r` of `J^T M` of observation `k`, or of `L^-1 J^T M` once solved forward.
    pub fn across(&self, k: usize, r: usize) -> &[f64] {
        let (n, d) = (self.n, self.columns);
        &self.across[(k * n + r) * d..(k * n + r + 1) * d]
    }

    /// Inverse of the equations, by rows, once factorised.
    pub fn inverse(&self) -> Vec<f64> {
        let n = self.n;
        let mut inverse = vec![0.0; n * n];
        let mut column = vec![0.0; n];
        for c in 0..n {
            column.fill(0.0);
            column[c] = 1.0;
            self.solve(&mut column);
            (0..n).for_each(|r| inverse[r * n + c] = column[r]);
        }
        inverse
    }

    /// Adds `J^T M q` of each observation, the pull of displacements that its camera makes, to `x`.
    pub fn add_pull<const D: usize>(&self, k: usize, displacement: &Lanes, x: &mut [f64]) {
        for (r, x) in x.iter_mut().enumerate() {
            *x += self.across(k, r).iter().zip(&displacement.0[..D]).map(|(a, b)| a * b).sum::<f64>();
        }
    }

    /// The equations as they were summed, before they are factorised: full symmetric matrix by rows.
    pub fn symmetric(&self) -> Vec<Vec<f64>> {
        let n = self.n;
        (0..n).map(|r| (0..n).map(|c| self.matrix[r.max(c) * n + r.min(c)]).collect()).collect()
    }
}

/// `L^-1` of `d` columns stored row by row.
fn forward(lower: &[f64], n: usize, rows: &mut [f64], d: usize) {
    for r in 0..n {
        let (before, row) = rows.split_at_mut(r * d);
        for c in 0..r {
            let factor = lower[r * n + c];
            for k in 0..d {
                row[k] -= factor * before[c * d + k];
            }
        }
        let reciprocal = 1.0 / lower[r * n + r];
        row[..d].iter_mut().for_each(|x| *x *= reciprocal);
    }
}

/// Rows `group D .. (group + 1) D` of what observation `k` takes part with, zero beyond the last, and the share of these
/// rows in the right-hand side of its camera.
pub(crate) fn observation_rows<const D: usize>(system: &CourseSystem, k: usize, group: usize) -> ([Lanes; D], Lanes) {
    let mut rows = [Lanes::ZERO; D];
    let mut right = Lanes::ZERO;
    for (r, row) in rows.iter_mut().enumerate() {
        let index = group * D + r;
        if index < system.n {
            row.0[..D].copy_from_slice(system.across(k, index));
            right = right.plus_scaled(system.right[index], row);
        }
    }
    (rows, right)
}
