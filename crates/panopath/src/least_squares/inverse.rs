//! Entries of an inverse on the pattern of its factor: selected inversion.
//!
//! With `S = L L^T` and the columns in supernodes `J`, each with rows `I` below its triangle,
//! `Z_IJ = -Z_II Y` and `Z_JJ = (L_JJ L_JJ^T)^-1 - Y^T Z_IJ`, `Y = L_IJ L_JJ^-1`, from the last supernode to the first
//! (Takahashi, Fagan & Chin, 1973; Lin et al., SelInv, 2011). All entries that a step reads have been found before.

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::supernodal::{SupernodalLltRef, SymbolicSupernodalCholesky};
use faer::sparse::linalg::cholesky::{CholeskySymbolicParams, SymbolicCholeskyRaw};
use faer::{Accum, Mat, MatMut, MatRef, Par};

use super::{BlockPattern, LeastSquaresError, SparseCholesky, minimum_degree};

/// The blocks of `S^-1` at the places where `S`, or its Cholesky factor, has blocks.
pub struct SelectedInverse<const D: usize> {
    cholesky: SparseCholesky,
    /// Entries of the inverse, laid out as the factor is.
    values: Vec<f64>,
    /// Supernode of each column, in the order of elimination.
    supernode_of: Vec<u32>,
    /// Place of each unknown in that order.
    place: Vec<u32>,
}

impl<const D: usize> SelectedInverse<D> {
    /// Factorises a matrix, given as to [`SparseCholesky::factorise`], and inverts it on the pattern of its factor.
    ///
    /// # Errors
    /// [`LeastSquaresError`] where the matrix is singular or too large.
    pub fn new(pattern: &BlockPattern, values: &[f64]) -> Result<Self, LeastSquaresError> {
        let ordering = minimum_degree::<D>(pattern)?;
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..CholeskySymbolicParams::default()
        };
        let mut cholesky = SparseCholesky::analyse_with::<D>(pattern, &ordering, params)?;
        cholesky.factorise(values)?;
        let dim = cholesky.dim();
        let place = match cholesky.symbolic.perm() {
            Some(perm) => perm.arrays().1.to_vec(),
            None => (0..dim as u32).collect(),
        };
        let SymbolicCholeskyRaw::Supernodal(symbolic) = cholesky.symbolic.raw() else {
            return Err(LeastSquaresError::TooLarge("the factor has no supernodes".to_owned()));
        };
        let mut supernode_of = vec![0u32; dim];
        for (s, (&begin, &end)) in symbolic.supernode_begin().iter().zip(symbolic.supernode_end()).enumerate() {
            supernode_of[begin as usize..end as usize].fill(s as u32);
        }
        let values = invert(symbolic, &cholesky.factor, &supernode_of, cholesky.par);
        Ok(Self { values, supernode_of, place, cholesky })
    }

    /// Entries of the inverse where nodes `a` and `b` meet: a block of the pattern, transposed as needed. `None` where the
    /// factor has no such block.
    pub fn block(&self, a: usize, b: usize) -> Option<[[f64; D]; D]> {
        let SymbolicCholeskyRaw::Supernodal(symbolic) = self.cholesky.symbolic.raw() else { return None };
        let mut block = [[0.0; D]; D];
        for (r, row) in block.iter_mut().enumerate() {
            for (c, entry) in row.iter_mut().enumerate() {
                let (i, j) = (self.place[a * D + r], self.place[b * D + c]);
                *entry = self.values[slot(symbolic, &self.supernode_of, i.max(j), i.min(j))?];
            }
        }
        Some(block)
    }

    /// Solves in place for right-hand sides stored one after the other.
    ///
    /// # Errors
    /// [`LeastSquaresError::TooLarge`] where the work space cannot be had.
    pub fn solve(&self, right: &mut [f64], n_right: usize) -> Result<(), LeastSquaresError> {
        self.cholesky.solve(right, n_right)
    }
}

/// Where entry (row, column), row >= column, is stored.
fn slot(symbolic: &SymbolicSupernodalCholesky<u32>, supernode_of: &[u32], row: u32, column: u32) -> Option<usize> {
    let s = supernode_of[column as usize] as usize;
    let (begin, end) = (symbolic.supernode_begin()[s], symbolic.supernode_end()[s]);
    let below = symbolic.supernode(s).pattern();
    let n_columns = (end - begin) as usize;
    let within = if row < end {
        (row - begin) as usize
    } else {
        // the rows below a supernode ascend
        let k = below.partition_point(|&r| r < row);
        if below.get(k) != Some(&row) {
            return None;
        }
        n_columns + k
    };
    let first = symbolic.col_ptr_for_val()[s] as usize;
    Some(first + (column - begin) as usize * (n_columns + below.len()) + within)
}

/// The recursion over supernodes.
fn invert(symbolic: &SymbolicSupernodalCholesky<u32>, factor: &[f64], supernode_of: &[u32], par: Par) -> Vec<f64> {
    let llt = SupernodalLltRef::new(symbolic, factor);
    let mut values = vec![0.0; factor.len()];
    let mut gathered = Vec::new();
    for s in (0..symbolic.n_supernodes()).rev() {
        let supernode = llt.supernode(s);
        let (lower, below) = (supernode.val(), supernode.pattern());
        let (n_columns, n_below) = (lower.ncols(), below.len());
        let triangle = lower.get(..n_columns, ..);
        let range = symbolic.col_ptr_for_val()[s] as usize..symbolic.col_ptr_for_val()[s + 1] as usize;
        // Y^T = L_JJ^-T L_IJ^T
        let mut y = Mat::from_fn(n_columns, n_below, |r, c| lower[(n_columns + c, r)]);
        solve_upper_triangular_in_place(triangle.transpose(), y.as_mut(), par);
        gather(symbolic, &values, supernode_of, below, &mut gathered);
        let ancestors = MatRef::from_column_major_slice(&gathered, n_below, n_below);
        let mut inverse = Mat::<f64>::identity(n_columns, n_columns);
        solve_lower_triangular_in_place(triangle, inverse.as_mut(), par);
        solve_upper_triangular_in_place(triangle.transpose(), inverse.as_mut(), par);
        let (mut own, mut off) =
            MatMut::from_column_major_slice_mut(&mut values[range], n_columns + n_below, n_columns)
                .split_at_row_mut(n_columns);
        matmul(off.as_mut(), Accum::Replace, ancestors, y.transpose(), -1.0, par);
        matmul(inverse.as_mut(), Accum::Add, y.as_ref(), off.as_ref(), -1.0, par);
        own.copy_from(&inverse);
    }
    values
}

/// Entries of the inverse between all rows below a supernode, both triangles.
fn gather(
    symbolic: &SymbolicSupernodalCholesky<u32>,
    values: &[f64],
    supernode_of: &[u32],
    rows: &[u32],
    gathered: &mut Vec<f64>,
) {
    let n = rows.len();
    gathered.clear();
    gathered.resize(n * n, 0.0);
    for (a, &column) in rows.iter().enumerate() {
        let s = supernode_of[column as usize] as usize;
        let (begin, end) = (symbolic.supernode_begin()[s], symbolic.supernode_end()[s]);
        let below = symbolic.supernode(s).pattern();
        let n_columns = (end - begin) as usize;
        let first = symbolic.col_ptr_for_val()[s] as usize + (column - begin) as usize * (n_columns + below.len());
        // both lists ascend: one pass finds all rows
        let mut k = 0;
        for (b, &row) in rows.iter().enumerate().skip(a) {
            let within = if row < end {
                (row - begin) as usize
            } else {
                while below[k] < row {
                    k += 1;
                }
                n_columns + k
            };
            gathered[a * n + b] = values[first + within];
            gathered[b * n + a] = values[first + within];
        }
    }
}
