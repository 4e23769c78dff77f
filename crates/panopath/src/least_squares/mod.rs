//! Sparse symmetric positive definite systems `S x = b`, the pattern analysed once and the values factorised many times.
//!
//! `S` is made of dense `D x D` blocks, one for each pair of coupled nodes. The nodes are ordered by approximate minimum
//! degree on the block graph, and the order is expanded to scalars. This folder alone names faer.
//!
//! Same values, same bytes: the factorisation is told a fixed degree of parallelism, whatever the number of threads.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{LltError, LltRegularization};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::linalg::svd::{ComputeSvdVectors, svd, svd_scratch};
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, Mat, MatMut, Par, Side};
use rayon::prelude::*;

use crate::geometry::{Matrix, Rotation, Vector};

mod inverse;

pub use inverse::SelectedInverse;

/// Why a system could not be solved.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum LeastSquaresError {
    /// A pivot was not positive: the matrix is singular to working precision.
    #[error("the system is singular: pivot {pivot} is not positive")]
    Singular {
        /// Index of the scalar unknown, in elimination order.
        pivot: usize,
    },
    /// The factorisation ran out of memory or of index range.
    #[error("the system is too large to factorise: {0}")]
    TooLarge(String),
}

/// Lower triangle of a symmetric block matrix, by columns: block rows `row[col_start[c]..col_start[c + 1]]` of column `c`
/// ascend and begin with the diagonal block.
#[derive(Debug, Clone)]
pub struct BlockPattern {
    /// Where each block column begins in `row`; one more entry than columns.
    pub col_start: Vec<u32>,
    /// Block row of each block.
    pub row: Vec<u32>,
}

impl BlockPattern {
    /// Number of block columns.
    pub fn n_nodes(&self) -> usize {
        self.col_start.len() - 1
    }

    /// Block indices of column `c`.
    pub fn column(&self, c: usize) -> std::ops::Range<usize> {
        self.col_start[c] as usize..self.col_start[c + 1] as usize
    }
}

/// Degree of parallelism that the factorisation is told: a constant, so that its result does not depend on the threads.
const FACTOR_PARALLELISM: usize = 4;
/// Below this many flops a factorisation is not worth splitting.
const PARALLEL_FLOPS: f64 = 2e7;

/// Order of elimination, and what it will cost.
#[derive(Debug, Clone)]
pub struct Ordering {
    forward: Vec<u32>,
    inverse: Vec<u32>,
    /// Multiplications and additions of one factorisation, predicted.
    pub factor_flops: f64,
}

/// Orders the nodes of the block graph by approximate minimum degree.
///
/// # Errors
/// [`LeastSquaresError::TooLarge`].
pub fn minimum_degree<const D: usize>(pattern: &BlockPattern) -> Result<Ordering, LeastSquaresError> {
    let n = pattern.n_nodes();
    let graph = SymbolicSparseColMatRef::new_checked(n, n, &pattern.col_start, None, &pattern.row);
    let mut memory = MemBuffer::try_new(amd::order_maybe_unsorted_scratch::<u32>(n, pattern.row.len()))
        .map_err(|e| LeastSquaresError::TooLarge(format!("{e:?}")))?;
    let (mut forward, mut inverse) = (vec![0u32; n], vec![0u32; n]);
    let count = amd::order_maybe_unsorted(
        &mut forward,
        &mut inverse,
        graph,
        amd::Control::default(),
        MemStack::new(&mut memory),
    )
    .map_err(|e| LeastSquaresError::TooLarge(format!("{e:?}")))?;
    let factor_flops = 2.0 * (D * D * D) as f64 * (count.n_mult_subs_ldl + n as f64);
    Ok(Ordering { forward, inverse, factor_flops })
}

/// A sparse Cholesky factorisation `S = L L^T` whose pattern is fixed.
pub struct SparseCholesky {
    symbolic: SymbolicCholesky<u32>,
    col_ptr: Vec<u32>,
    row_idx: Vec<u32>,
    factor: Vec<f64>,
    memory: MemBuffer,
    par: Par,
}

impl SparseCholesky {
    /// Analyses the pattern of a matrix of `D x D` blocks.
    ///
    /// # Errors
    /// [`LeastSquaresError::TooLarge`].
    pub fn analyse<const D: usize>(pattern: &BlockPattern, ordering: &Ordering) -> Result<Self, LeastSquaresError> {
        Self::analyse_with::<D>(pattern, ordering, CholeskySymbolicParams::default())
    }

    fn analyse_with<const D: usize>(
        pattern: &BlockPattern,
        ordering: &Ordering,
        params: CholeskySymbolicParams<'_>,
    ) -> Result<Self, LeastSquaresError> {
        let n = pattern.n_nodes() * D;
        let (col_ptr, row_idx) = scalar_pattern::<D>(pattern);
        let expand = |perm: &[u32]| -> Vec<u32> {
            perm.iter().flat_map(|&node| (0..D as u32).map(move |c| node * D as u32 + c)).collect()
        };
        let (forward, inverse) = (expand(&ordering.forward), expand(&ordering.inverse));
        let matrix = SymbolicSparseColMatRef::new_checked(n, n, &col_ptr, None, &row_idx);
        let perm = faer::perm::PermRef::new_checked(&forward, &inverse, n);
        let symbolic = factorize_symbolic_cholesky(matrix, Side::Lower, SymmetricOrdering::Custom(perm), params)
            .map_err(|e| LeastSquaresError::TooLarge(format!("{e:?}")))?;
        let par = if ordering.factor_flops > PARALLEL_FLOPS { Par::rayon(FACTOR_PARALLELISM) } else { Par::Seq };
        let factor_scratch = symbolic.factorize_numeric_llt_scratch::<f64>(par, Default::default());
        let memory = MemBuffer::try_new(factor_scratch).map_err(|e| LeastSquaresError::TooLarge(format!("{e:?}")))?;
        let factor = vec![0.0; symbolic.len_val()];
        Ok(Self { symbolic, col_ptr, row_idx, factor, memory, par })
    }

    /// Number of scalar unknowns.
    pub fn dim(&self) -> usize {
        self.col_ptr.len() - 1
    }

    /// Number of stored values of the lower triangle.
    pub fn n_values(&self) -> usize {
        self.row_idx.len()
    }

    /// Factorises the matrix with these lower-triangle values, in the order of [`scalar_slots`].
    ///
    /// # Errors
    /// [`LeastSquaresError::Singular`] where a pivot is not positive.
    pub fn factorise(&mut self, values: &[f64]) -> Result<(), LeastSquaresError> {
        let n = self.dim();
        let symbolic = SymbolicSparseColMatRef::new_checked(n, n, &self.col_ptr, None, &self.row_idx);
        let matrix = SparseColMatRef::new(symbolic, values);
        self.symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                matrix,
                Side::Lower,
                LltRegularization::default(),
                self.par,
                MemStack::new(&mut self.memory),
                Default::default(),
            )
            .map(|_| ())
            .map_err(|LltError::NonPositivePivot { index }| LeastSquaresError::Singular { pivot: index })
    }

    /// Solves in place for `n_rhs` right-hand sides, stored one after the other.
    ///
    /// # Errors
    /// [`LeastSquaresError::TooLarge`] where the work space cannot be had.
    pub fn solve(&self, rhs: &mut [f64], n_rhs: usize) -> Result<(), LeastSquaresError> {
        let n = self.dim();
        let scratch = self.symbolic.solve_in_place_scratch::<f64>(n_rhs, Par::Seq);
        let mut memory = MemBuffer::try_new(scratch).map_err(|e| LeastSquaresError::TooLarge(format!("{e:?}")))?;
        let rhs = MatMut::from_column_major_slice_mut(rhs, n, n_rhs);
        LltRef::<u32, f64>::new(&self.symbolic, &self.factor).solve_in_place_with_conj(
            Conj::No,
            rhs,
            Par::Seq,
            MemStack::new(&mut memory),
        );
        Ok(())
    }
}

/// Scalar lower-triangle pattern (compressed columns) of a block pattern.
fn scalar_pattern<const D: usize>(pattern: &BlockPattern) -> (Vec<u32>, Vec<u32>) {
    let n = pattern.n_nodes();
    let mut col_ptr = Vec::with_capacity(n * D + 1);
    let mut row_idx = Vec::with_capacity(pattern.row.len() * D * D);
    col_ptr.push(0u32);
    for node in 0..n {
        for c in 0..D {
            for k in pattern.column(node) {
                let row = pattern.row[k] as usize;
                let first = if row == node { c } else { 0 };
                row_idx.extend((first..D).map(|r| (row * D + r) as u32));
            }
            col_ptr.push(row_idx.len() as u32);
        }
    }
    (col_ptr, row_idx)
}

/// Slot of scalar column `c` of block `k` of block column `node` in the values of [`SparseCholesky::factorise`]; entries of
/// the block's column follow one another there. The diagonal block stores rows `c..D` only.
#[inline]
pub fn scalar_slots<const D: usize>(pattern: &BlockPattern, node: usize, k: usize, c: usize) -> usize {
    // column c of a node holds (D - c) entries of the diagonal block and D of each other block
    let blocks = pattern.column(node);
    let before_node = D * D * blocks.start - node * (D * (D - 1) / 2);
    let off = blocks.len() - 1;
    let before_column: usize = (0..c).map(|p| (D - p) + D * off).sum();
    let within = if k == blocks.start { 0 } else { (D - c) + D * (k - blocks.start - 1) };
    before_node + before_column + within
}

/// Which linear solver to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LinearSolver {
    /// The one with the lower predicted cost.
    #[default]
    Auto,
    /// Sparse Cholesky.
    Direct,
    /// Conjugate gradients, preconditioned by the diagonal blocks.
    Iterative,
}

/// A symmetric positive definite system of `D x D` blocks, solved directly or by conjugate gradients.
pub struct BlockSolver<const D: usize> {
    method: SolverMethod<D>,
}

enum SolverMethod<const D: usize> {
    Direct(Box<SparseCholesky>),
    Iterative(BlockProduct<D>),
}

/// Residual at which conjugate gradients stop, relative to the right-hand side in the preconditioner's metric. An outer
/// iteration corrects what is left.
const GRADIENT_TOLERANCE: f64 = 1e-6;
/// Products after which they give up, for each unknown.
const PRODUCTS_PER_UNKNOWN: usize = 4;

impl<const D: usize> BlockSolver<D> {
    /// Orders and analyses the pattern, and chooses the method.
    ///
    /// # Errors
    /// [`LeastSquaresError::TooLarge`].
    pub fn analyse(pattern: &BlockPattern, solver: LinearSolver) -> Result<Self, LeastSquaresError> {
        let ordering = minimum_degree::<D>(pattern)?;
        let iterative = match solver {
            LinearSolver::Direct => false,
            LinearSolver::Iterative => true,
            LinearSolver::Auto => ordering.factor_flops > iterative_flops::<D>(pattern),
        };
        let method = if iterative {
            SolverMethod::Iterative(BlockProduct::new(pattern))
        } else {
            SolverMethod::Direct(Box::new(SparseCholesky::analyse::<D>(pattern, &ordering)?))
        };
        Ok(Self { method })
    }

    /// Takes these lower-triangle values, in the order of [`scalar_slots`].
    ///
    /// # Errors
    /// [`LeastSquaresError::Singular`] where the matrix is not positive definite.
    pub fn factorise(&mut self, pattern: &BlockPattern, values: &[f64]) -> Result<(), LeastSquaresError> {
        match &mut self.method {
            SolverMethod::Direct(cholesky) => cholesky.factorise(values),
            SolverMethod::Iterative(product) => product.load(pattern, values),
        }
    }

    /// Solves in place for right-hand sides stored one after the other.
    ///
    /// # Errors
    /// [`LeastSquaresError`] where the work space cannot be had or conjugate gradients do not converge.
    pub fn solve(&self, right: &mut [f64], n_right: usize) -> Result<(), LeastSquaresError> {
        match &self.method {
            SolverMethod::Direct(cholesky) => cholesky.solve(right, n_right),
            SolverMethod::Iterative(product) => {
                let n = right.len() / n_right.max(1);
                right.chunks_exact_mut(n).try_for_each(|side| product.solve(side))
            }
        }
    }
}

/// Flops of a direct factorisation that cost as much time as conjugate gradients would, predicted.
fn iterative_flops<const D: usize>(pattern: &BlockPattern) -> f64 {
    const EXPECTED_PRODUCTS: f64 = 300.0;
    // a product runs at the speed of memory, many times slower per flop than the dense kernels of a factorisation
    const SLOWDOWN: f64 = 10.0;
    SLOWDOWN * EXPECTED_PRODUCTS * 4.0 * (pattern.row.len() * D * D) as f64
}

/// The matrix by block rows, both triangles, with the inverses of its diagonal blocks.
struct BlockProduct<const D: usize> {
    start: Vec<u32>,
    /// Other node and block of each entry of a row.
    entry: Vec<(u32, u32)>,
    /// Blocks of the lower triangle; an entry beyond the diagonal reads its block transposed.
    block: Vec<Matrix<D>>,
    inverse: Vec<Matrix<D>>,
}

impl<const D: usize> BlockProduct<D> {
    fn new(pattern: &BlockPattern) -> Self {
        let n = pattern.n_nodes();
        let mut lists: Vec<Vec<(u32, u32)>> = vec![Vec::new(); n];
        for column in 0..n {
            for k in pattern.column(column) {
                let row = pattern.row[k] as usize;
                lists[row].push((column as u32, k as u32));
                if row != column {
                    lists[column].push((row as u32, k as u32));
                }
            }
        }
        let mut start = vec![0u32];
        let mut entry = Vec::with_capacity(2 * pattern.row.len());
        for list in lists {
            entry.extend(list);
            start.push(entry.len() as u32);
        }
        let block = vec![[[0.0; D]; D]; pattern.row.len()];
        Self { start, entry, block, inverse: vec![[[0.0; D]; D]; n] }
    }

    fn load(&mut self, pattern: &BlockPattern, values: &[f64]) -> Result<(), LeastSquaresError> {
        for node in 0..pattern.n_nodes() {
            for k in pattern.column(node) {
                let diagonal = pattern.row[k] as usize == node;
                for c in 0..D {
                    let slot = scalar_slots::<D>(pattern, node, k, c);
                    let first = if diagonal { c } else { 0 };
                    for r in first..D {
                        self.block[k][r][c] = values[slot + r - first];
                        if diagonal {
                            self.block[k][c][r] = values[slot + r - first];
                        }
                    }
                }
                if diagonal {
                    self.inverse[node] =
                        inverse_of_positive(&self.block[k]).ok_or(LeastSquaresError::Singular { pivot: node * D })?;
                }
            }
        }
        Ok(())
    }

    fn rows(&self, node: usize, x: &[f64]) -> Vector<D> {
        let mut sum = [0.0; D];
        for &(other, k) in &self.entry[self.start[node] as usize..self.start[node + 1] as usize] {
            let block = &self.block[k as usize];
            let x = &x[other as usize * D..];
            for r in 0..D {
                for c in 0..D {
                    sum[r] += if other as usize <= node { block[r][c] } else { block[c][r] } * x[c];
                }
            }
        }
        sum
    }

    /// `y = S x`, row by row, so that the sums do not depend on the threads.
    fn multiply(&self, x: &[f64], y: &mut [f64]) {
        y.par_chunks_exact_mut(D).enumerate().with_min_len(64).for_each(|(node, y)| {
            y.copy_from_slice(&self.rows(node, x));
        });
    }

    fn precondition(&self, x: &[f64], y: &mut [f64]) {
        for ((x, y), inverse) in x.chunks_exact(D).zip(y.chunks_exact_mut(D)).zip(&self.inverse) {
            for r in 0..D {
                y[r] = (0..D).map(|c| inverse[r][c] * x[c]).sum();
            }
        }
    }

    fn solve(&self, right: &mut [f64]) -> Result<(), LeastSquaresError> {
        let mut x = vec![0.0; right.len()];
        let ended = conjugate_gradients(
            |x, y| self.multiply(x, y),
            |x, y| self.precondition(x, y),
            right,
            &mut x,
            GRADIENT_TOLERANCE,
            PRODUCTS_PER_UNKNOWN * right.len(),
        );
        if ended.relative_residual.is_nan() || ended.relative_residual > 1e-2 {
            return Err(LeastSquaresError::Singular { pivot: 0 });
        }
        right.copy_from_slice(&x);
        Ok(())
    }
}

/// Inverse of a small symmetric positive definite matrix, by Gauss and Jordan; `None` where a pivot is not positive.
pub(crate) fn inverse_of_positive<const D: usize>(m: &Matrix<D>) -> Option<Matrix<D>> {
    let mut a = *m;
    for p in 0..D {
        let pivot = a[p][p];
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        a[p][p] = 1.0;
        a[p] = a[p].map(|x| x / pivot);
        for r in (0..D).filter(|&r| r != p) {
            let factor = a[r][p];
            a[r][p] = 0.0;
            for c in 0..D {
                a[r][c] -= factor * a[p][c];
            }
        }
    }
    Some(a)
}

/// How preconditioned conjugate gradients ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Iterations {
    /// Products with the matrix.
    pub count: usize,
    /// Final residual norm relative to the right-hand side, in the preconditioner's metric.
    pub relative_residual: f64,
}

/// Solves `S x = b` by preconditioned conjugate gradients from `x` as it stands.
///
/// Stops when the residual has fallen to `tolerance` times that of `b` (in the preconditioner's metric), or after
/// `max_iterations`.
pub fn conjugate_gradients(
    multiply: impl Fn(&[f64], &mut [f64]),
    precondition: impl Fn(&[f64], &mut [f64]),
    b: &[f64],
    x: &mut [f64],
    tolerance: f64,
    max_iterations: usize,
) -> Iterations {
    let n = b.len();
    let (mut r, mut z, mut p, mut q) = (b.to_vec(), vec![0.0; n], vec![0.0; n], vec![0.0; n]);
    precondition(b, &mut z);
    let reference = inner(b, &z);
    if x.iter().any(|&v| v != 0.0) {
        multiply(x, &mut q);
        for i in 0..n {
            r[i] -= q[i];
        }
        precondition(&r, &mut z);
    }
    let mut rz = inner(&r, &z);
    let target = tolerance * tolerance * reference;
    let mut count = 0;
    p.copy_from_slice(&z);
    while count < max_iterations && rz > target {
        multiply(&p, &mut q);
        let curvature = inner(&p, &q);
        if curvature.is_nan() || curvature <= 0.0 {
            break;
        }
        let alpha = rz / curvature;
        for i in 0..n {
            x[i] += alpha * p[i];
            r[i] -= alpha * q[i];
        }
        precondition(&r, &mut z);
        let next = inner(&r, &z);
        let beta = next / rz;
        for i in 0..n {
            p[i] = z[i] + beta * p[i];
        }
        rz = next;
        count += 1;
    }
    let relative_residual = if reference > 0.0 { (rz.max(0.0) / reference).sqrt() } else { 0.0 };
    Iterations { count, relative_residual }
}

/// Inner product of two long vectors.
pub(crate) fn inner(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// The rotation `R` that maximises `trace(R^T m)`, by singular values; `None` where the decomposition fails.
pub fn nearest_rotation<const D: usize>(m: &Matrix<D>) -> Option<Rotation<D>> {
    if m.iter().flatten().any(|x| !x.is_finite()) {
        return None;
    }
    let svd = faer::Mat::from_fn(D, D, |r, c| m[r][c]).svd().ok()?;
    let (u, v) = (svd.U(), svd.V());
    let sign = (u.determinant() * v.determinant()).signum();
    Rotation::from_matrix(std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..D).map(|k| u[(r, k)] * v[(c, k)] * if k == D - 1 { sign } else { 1.0 }).sum())
    }))
}

/// Eigenvalues of a small symmetric matrix in ascending order, with their unit eigenvectors.
///
/// # Errors
/// [`LeastSquaresError::Singular`] where the entries are not finite.
pub fn symmetric_eigen<const D: usize>(m: &Matrix<D>) -> Result<([f64; D], [Vector<D>; D]), LeastSquaresError> {
    if m.iter().flatten().any(|x| !x.is_finite()) {
        return Err(LeastSquaresError::Singular { pivot: 0 });
    }
    let matrix = faer::Mat::from_fn(D, D, |r, c| 0.5 * (m[r][c] + m[c][r]));
    let eigen = matrix.self_adjoint_eigen(Side::Lower).map_err(|_| LeastSquaresError::Singular { pivot: 0 })?;
    let (values, vectors) = (eigen.S(), eigen.U());
    Ok((std::array::from_fn(|k| values[k]), std::array::from_fn(|k| std::array::from_fn(|r| vectors[(r, k)]))))
}

/// Eigenvalues of a symmetric matrix given by rows, in ascending order, with their unit eigenvectors.
///
/// # Errors
/// [`LeastSquaresError::Singular`] where the entries are not finite.
pub fn symmetric_eigen_of(rows: &[Vec<f64>]) -> Result<(Vec<f64>, Vec<Vec<f64>>), LeastSquaresError> {
    let n = rows.len();
    if rows.iter().flatten().any(|x| !x.is_finite()) {
        return Err(LeastSquaresError::Singular { pivot: 0 });
    }
    let matrix = Mat::from_fn(n, n, |r, c| 0.5 * (rows[r][c] + rows[c][r]));
    let (mut values, mut vectors) = (Diag::<f64>::zeros(n), Mat::<f64>::zeros(n, n));
    let scratch = self_adjoint_evd_scratch::<f64>(n, ComputeEigenvectors::Yes, Par::Seq, Default::default());
    let mut memory = MemBuffer::try_new(scratch).map_err(|e| LeastSquaresError::TooLarge(format!("{e:?}")))?;
    let (s, u) = (values.as_mut(), Some(vectors.as_mut()));
    // in sequence: faer's own choice would follow the number of threads, and the last digits with it
    self_adjoint_evd(matrix.as_ref(), s, u, Par::Seq, MemStack::new(&mut memory), Default::default())
        .map_err(|_| LeastSquaresError::Singular { pivot: 0 })?;
    let columns = (0..n).map(|k| (0..n).map(|r| vectors[(r, k)]).collect()).collect();
    Ok(((0..n).map(|k| values[k]).collect(), columns))
}

/// Singular values of a matrix given row by row, largest first, with the right singular vector of each.
///
/// There are as many as columns, whatever the number of rows. `None` where the entries are not finite.
pub fn right_singular(n_columns: usize, entries: &[f64]) -> Option<(Vec<f64>, Vec<Vec<f64>>)> {
    if n_columns == 0 || entries.iter().any(|x| !x.is_finite()) {
        return None;
    }
    let n_rows = entries.len() / n_columns;
    // rows of zeros complete a wide matrix, so that its null space is given too
    let height = n_rows.max(n_columns);
    let entry = |r: usize, c: usize| if r < n_rows { entries[r * n_columns + c] } else { 0.0 };
    let matrix = Mat::from_fn(height, n_columns, entry);
    let (mut values, mut v) = (Diag::<f64>::zeros(n_columns), Mat::<f64>::zeros(n_columns, n_columns));
    let (no, thin) = (ComputeSvdVectors::No, ComputeSvdVectors::Thin);
    let scratch = svd_scratch::<f64>(height, n_columns, no, thin, Par::Seq, Default::default());
    let mut memory = MemBuffer::try_new(scratch).ok()?;
    // in sequence, as above
    let (s, stack) = (values.as_mut(), MemStack::new(&mut memory));
    svd(matrix.as_ref(), s, None, Some(v.as_mut()), Par::Seq, stack, Default::default()).ok()?;
    let vectors = (0..n_columns).map(|k| (0..n_columns).map(|r| v[(r, k)]).collect()).collect();
    Some(((0..n_columns).map(|k| values[k]).collect(), vectors))
}
