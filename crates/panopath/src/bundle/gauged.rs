//! The covariance of cameras in a gauge, block by block.
//!
//! The information `S` of the cameras is inverted with as many unknowns held as the gauge has freedoms: `S^-`. With `G` the
//! basis of these freedoms, `W` the conditions that fix them and `A = (W^T G)^-1`, `Q = I - G A W^T` takes errors to the
//! gauge, and the covariance is `Q S^- Q^T`. With `K = S^- W` its blocks are
//! `S^-_ab - G_a A K_b^T - K_a A^T G_b^T + G_a A (W^T K) A^T G_b^T`, so that only blocks on the pattern are needed.

use rayon::prelude::*;

use super::part::Lanes;
use crate::least_squares::{BlockPattern, LeastSquaresError, SelectedInverse, inner};

/// Freedoms of a gauge and what fixes them, over all unknowns of the cameras, a column a freedom.
pub struct Fixing<'a> {
    /// `G`.
    pub basis: &'a [Vec<f64>],
    /// `W`.
    pub conditions: &'a [Vec<f64>],
    /// `A = (W^T G)^-1`, by rows: `G A` has the column `c` as the sum of `basis[k] product_inverse[c][k]`.
    pub product_inverse: &'a [Vec<f64>],
}

/// Blocks of `Q S^- Q^T` on the pattern of cameras that share a track, in units of sigma squared.
pub struct GaugedCovariance<const V: usize> {
    pattern: BlockPattern,
    blocks: Vec<[[f64; V]; V]>,
}

impl<const V: usize> GaugedCovariance<V> {
    /// Takes `S^-`, in which the unknowns `held` are, to the gauge.
    pub fn new(
        pattern: &BlockPattern,
        inverse: &SelectedInverse<V>,
        held: &[bool],
        fixing: &Fixing<'_>,
    ) -> Result<Self, LeastSquaresError> {
        let projection = Projection::<V>::new(inverse, held, fixing)?;
        let columns: Vec<(usize, usize)> =
            (0..pattern.n_nodes()).flat_map(|c| pattern.column(c).map(move |k| (c, k))).collect();
        let block = |&(column, k): &(usize, usize)| {
            let row = pattern.row[k] as usize;
            let mut block = inverse.block(row, column).unwrap_or([[0.0; V]; V]);
            for r in 0..V {
                for c in 0..V {
                    if held[row * V + r] || held[column * V + c] {
                        block[r][c] = 0.0;
                    }
                }
            }
            projection.apply(row, column, block)
        };
        let blocks = columns.par_iter().with_min_len(64).map(block).collect();
        Ok(Self { pattern: pattern.clone(), blocks })
    }

    /// The covariance of one camera.
    pub fn of(&self, node: usize) -> &[[f64; V]; V] {
        &self.blocks[self.pattern.column(node).start]
    }

    /// Block (a, b), transposed where the pattern holds (b, a); none where the two share no track.
    pub fn block(&self, a: usize, b: usize) -> Option<[[f64; V]; V]> {
        let (row, column) = (a.max(b), a.min(b));
        let range = self.pattern.column(column);
        let k = range.start + self.pattern.row[range.clone()].partition_point(|&r| (r as usize) < row);
        if k >= range.end || self.pattern.row[k] as usize != row {
            return None;
        }
        let block = &self.blocks[k];
        Some(if a >= b { *block } else { std::array::from_fn(|r| std::array::from_fn(|c| block[c][r])) })
    }
}

struct Projection<const V: usize> {
    /// `G A`, by columns.
    turned: Vec<Vec<f64>>,
    /// `K = S^- W`, by columns.
    pushed: Vec<Vec<f64>>,
    /// `W^T K`.
    core: Vec<Vec<f64>>,
}

impl<const V: usize> Projection<V> {
    fn new(inverse: &SelectedInverse<V>, held: &[bool], fixing: &Fixing<'_>) -> Result<Self, LeastSquaresError> {
        let &Fixing { basis, conditions, product_inverse } = fixing;
        let mut pushed = conditions.to_vec();
        for column in &mut pushed {
            column.iter_mut().zip(held).filter(|(_, held)| **held).for_each(|(x, _)| *x = 0.0);
            inverse.solve(column, 1)?;
        }
        let core = conditions.iter().map(|w| pushed.iter().map(|k| inner(w, k)).collect()).collect();
        let turn = |row: &Vec<f64>| -> Vec<f64> {
            (0..held.len()).map(|i| basis.iter().zip(row).map(|(g, a)| g[i] * a).sum()).collect()
        };
        Ok(Self { turned: product_inverse.iter().map(turn).collect(), pushed, core })
    }

    /// Block (a, b) of the covariance from that of `S^-`.
    fn apply(&self, a: usize, b: usize, mut block: [[f64; V]; V]) -> [[f64; V]; V] {
        let n = self.turned.len();
        for r in 0..V {
            for c in 0..V {
                let (i, j) = (a * V + r, b * V + c);
                for k in 0..n {
                    block[r][c] -= self.turned[k][i] * self.pushed[k][j] + self.pushed[k][i] * self.turned[k][j];
                    let across: f64 = (0..n).map(|l| self.core[k][l] * self.turned[l][j]).sum();
                    block[r][c] += self.turned[k][i] * across;
                }
            }
        }
        block
    }
}

/// The coordinate of a centre that is farthest from the same of `origin`: held, it fixes the scale.
pub fn farthest_coordinate<const D: usize, const V: usize>(centers: &[Lanes], origin: &[f64; D]) -> usize {
    let mut farthest = (0, 0.0);
    for (node, center) in centers.iter().enumerate() {
        for c in 0..D {
            let distance = (center.0[c] - origin[c]).abs();
            if distance > farthest.1 {
                farthest = (node * V + V - D + c, distance);
            }
        }
    }
    farthest.0
}
