//! Normal equations of a few unknowns, `J^T W J x = -J^T W r`, held on the stack: the search calls them by the thousand.

use crate::geometry::dot;

/// Sums of one least-squares problem in `N` unknowns.
#[derive(Clone, Copy)]
pub struct Normal<const N: usize> {
    matrix: [[f64; N]; N],
    gradient: [f64; N],
}

impl<const N: usize> Normal<N> {
    pub fn new() -> Self {
        Self { matrix: [[0.0; N]; N], gradient: [0.0; N] }
    }

    /// Adds one equation `r + jacobian . x = 0`.
    #[inline(always)]
    pub fn add(&mut self, jacobian: &[f64; N], r: f64, weight: f64) {
        for a in 0..N {
            let weighted = weight * jacobian[a];
            self.gradient[a] += weighted * r;
            for b in 0..=a {
                self.matrix[a][b] += weighted * jacobian[b];
            }
        }
    }

    /// Takes the first `n` unknowns out: they keep their value.
    pub fn hold_first(&mut self, n: usize) {
        for a in 0..N {
            for b in 0..=a {
                if b < n {
                    self.matrix[a][b] = if a == b { 1.0 } else { 0.0 };
                }
            }
        }
        self.gradient[..n].fill(0.0);
    }

    /// The step that the equations ask for, the diagonal raised by the factor `1 + damping`; none where they are singular.
    pub fn step(&self, damping: f64) -> Option<[f64; N]> {
        let mut x = self.gradient.map(|g| -g);
        solve(&self.factor(damping)?, &mut x);
        x.iter().all(|v| v.is_finite()).then_some(x)
    }

    /// Inverse of the matrix; none where it is singular.
    pub fn inverse(&self) -> Option<[[f64; N]; N]> {
        let factor = self.factor(0.0)?;
        let mut inverse = [[0.0; N]; N];
        for (c, row) in inverse.iter_mut().enumerate() {
            row[c] = 1.0;
            solve(&factor, row);
        }
        inverse.iter().flatten().all(|v| v.is_finite()).then_some(inverse)
    }

    /// Cholesky factor, lower triangle.
    fn factor(&self, damping: f64) -> Option<[[f64; N]; N]> {
        let mut l = self.matrix;
        for a in 0..N {
            for b in 0..=a {
                let done: f64 = (0..b).map(|k| l[a][k] * l[b][k]).sum();
                if a == b {
                    let diagonal = self.matrix[a][a] * (1.0 + damping);
                    let pivot = diagonal - done;
                    // what cancellation leaves of a dependent column is rounding, not information
                    if !(pivot > 1e-14 * diagonal && pivot.is_finite()) {
                        return None;
                    }
                    l[a][a] = pivot.sqrt();
                } else {
                    l[a][b] = (self.matrix[a][b] - done) / l[b][b];
                }
            }
        }
        Some(l)
    }
}

fn solve<const N: usize>(l: &[[f64; N]; N], x: &mut [f64; N]) {
    for a in 0..N {
        let known: f64 = (0..a).map(|k| l[a][k] * x[k]).sum();
        x[a] = (x[a] - known) / l[a][a];
    }
    for a in (0..N).rev() {
        let known: f64 = (a + 1..N).map(|k| l[k][a] * x[k]).sum();
        x[a] = (x[a] - known) / l[a][a];
    }
}

/// Largest standard deviation along any axis of a covariance: at least the largest, at most `sqrt(N)` times it.
pub fn largest_deviation<const N: usize>(covariance: &[[f64; N]; N]) -> f64 {
    let trace: f64 = (0..N).map(|c| covariance[c][c]).sum();
    trace.max(0.0).sqrt()
}

/// `basis m basis^T` for a basis of two tangent vectors.
pub fn lift(m: &[[f64; 2]; 2], basis: &[[f64; 3]; 2]) -> [[f64; 3]; 3] {
    std::array::from_fn(|r| {
        std::array::from_fn(|c| {
            let row = [basis[0][r], basis[1][r]];
            let column = [basis[0][c], basis[1][c]];
            row[0] * dot(&m[0], &column) + row[1] * dot(&m[1], &column)
        })
    })
}
