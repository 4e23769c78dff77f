//! The reduced camera system: points eliminated, one `D x D` block for each pair of views that share a track.
//!
//! Each observation `(i, j)` contributes `1/2 (x_j - c_i)^T M (x_j - c_i) - q^T (x_j - c_i)` with
//! `M = w (I - d d^T)`. With `A_j = sum_i M_ij` and `g_j = sum_i q_ij`, stationarity in the points leaves
//! `S c = b`, `S = diag(sum_j M_ij) - sum_j M_ij A_j^-1 M_lj` and `b_i = sum_j (M_ij A_j^-1 g_j - q_ij)`.
//! One view is pinned (a zero row), which takes away the common translation.
//!
//! [`assemble`](ReducedSystem::assemble) is the hot loop of the whole package; it is compiled for the widest
//! instruction set found at run time. `tests` holds a dense reference.

use rayon::prelude::*;

use super::part::{Lanes, Part};
use crate::least_squares::{BlockPattern, BlockSolver, LeastSquaresError, LinearSolver, scalar_slots};

/// Quadratic model of one observation: see the module's text. `direction` has the weight `w` in lane 3.
pub(super) struct Quadratic {
    pub direction: Lanes,
    pub gradient: Lanes,
}

/// Gives the quadratic model of each observation at the current estimate.
pub(super) trait Weighing<const D: usize>: Sync {
    /// Model of observation `o` of track `j`; a weight of zero leaves the observation out.
    fn observe(&self, o: usize, j: usize) -> Quadratic;
    /// Depth axis of point `j`, a unit vector, for the damping frame.
    fn depth_axis(&self, j: usize) -> Lanes;
}

/// Levenberg-Marquardt damping, relative to the diagonal.
#[derive(Clone, Copy)]
pub(super) struct Damping {
    pub point: f64,
    pub view: f64,
}

/// Keeps the eliminated block positive definite where rays are parallel, relative to its trace.
const POINT_FLOOR: f64 = 1e-14;

/// Cholesky factor of the block `A` of one point, with the reciprocals of its diagonal.
pub(super) struct PointFactor<const D: usize> {
    lower: [[f64; D]; D],
    reciprocal: [f64; D],
}

impl<const D: usize> PointFactor<D> {
    /// Factorises `weight_sum I - outer`, damped in the frame (tangents, depth axis).
    #[inline(always)]
    fn new(weight_sum: f64, outer: &[Lanes; D], damping: f64, axis: &Lanes) -> Self {
        let mut a: [[f64; D]; D] = std::array::from_fn(|r| {
            std::array::from_fn(|c| if r == c { weight_sum - outer[r].0[c] } else { -outer[r].0[c] })
        });
        let mut trace = 0.0;
        for (r, row) in a.iter().enumerate() {
            trace += row[r];
        }
        if damping > 0.0 {
            let mut depth = 0.0;
            for (r, row) in a.iter().enumerate() {
                for c in 0..D {
                    depth += axis.0[r] * row[c] * axis.0[c];
                }
            }
            let tangent = (trace - depth) / (D - 1) as f64;
            for (r, row) in a.iter_mut().enumerate() {
                for c in 0..D {
                    row[c] += damping * (depth - tangent) * axis.0[r] * axis.0[c];
                }
                row[r] += damping * tangent;
            }
        }
        let floor = POINT_FLOOR * trace;
        let mut lower = [[0.0; D]; D];
        let mut reciprocal = [0.0; D];
        for r in 0..D {
            for c in 0..=r {
                let mut sum = a[r][c];
                for k in 0..c {
                    sum -= lower[r][k] * lower[c][k];
                }
                if r == c {
                    let pivot = (sum + floor).max(floor).sqrt();
                    lower[r][r] = pivot;
                    reciprocal[r] = 1.0 / pivot;
                } else {
                    lower[r][c] = sum * reciprocal[c];
                }
            }
        }
        Self { lower, reciprocal }
    }

    /// `L^-1 b`.
    #[inline(always)]
    pub fn forward(&self, b: &Lanes) -> [f64; D] {
        let mut y = [0.0; D];
        for r in 0..D {
            let mut sum = b.0[r];
            for c in 0..r {
                sum -= self.lower[r][c] * y[c];
            }
            y[r] = sum * self.reciprocal[r];
        }
        y
    }

    /// `A^-1 b`.
    #[inline(always)]
    pub fn solve(&self, b: &Lanes) -> Lanes {
        let y = self.forward(b);
        let mut x = Lanes::ZERO;
        for r in (0..D).rev() {
            let mut sum = y[r];
            for c in r + 1..D {
                sum -= self.lower[c][r] * x.0[c];
            }
            x.0[r] = sum * self.reciprocal[r];
        }
        x
    }

    /// `L^-1 M` for `M` given by rows, in place.
    #[inline(always)]
    fn forward_rows(&self, rows: &mut [Lanes; D]) {
        for r in 0..D {
            let mut row = rows[r];
            for c in 0..r {
                row = row.plus_scaled(-self.lower[r][c], &rows[c]);
            }
            rows[r] = row.times(self.reciprocal[r]);
        }
    }
}

impl Quadratic {
    /// `M a`.
    #[inline(always)]
    pub fn apply<const D: usize>(&self, a: &Lanes) -> Lanes {
        let d = &self.direction;
        let mut product = a.plus_scaled(-d.dot::<D>(a), d).times(d.0[3]);
        product.0[3] = 0.0;
        product
    }
}

/// Sum of the models of one point: `A = weight_sum I - outer`, and `g`.
pub(super) struct PointSum<const D: usize> {
    pub weight_sum: f64,
    outer: [Lanes; D],
    pub gradient: Lanes,
}

impl<const D: usize> PointSum<D> {
    #[inline(always)]
    pub fn new() -> Self {
        Self { weight_sum: 0.0, outer: [Lanes::ZERO; D], gradient: Lanes::ZERO }
    }

    #[inline(always)]
    pub fn add(&mut self, model: &Quadratic) {
        let d = &model.direction;
        let weighted = d.times(d.0[3]);
        for (r, row) in self.outer.iter_mut().enumerate() {
            *row = row.plus_scaled(d.0[r], &weighted);
        }
        self.weight_sum += d.0[3];
        self.gradient = self.gradient.plus(&model.gradient);
    }

    /// Does anything count?
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.weight_sum.is_nan() || self.weight_sum <= 0.0
    }

    /// `axis^T A axis`.
    #[inline(always)]
    pub fn along(&self, axis: &Lanes) -> f64 {
        let mut sum = self.weight_sum;
        for (r, row) in self.outer.iter().enumerate() {
            sum -= axis.0[r] * row.dot::<D>(axis);
        }
        sum
    }

    /// Factor of `A`, damped in the frame (tangents, depth axis).
    #[inline(always)]
    pub fn factor(&self, damping: f64, axis: &Lanes) -> PointFactor<D> {
        PointFactor::new(self.weight_sum.max(f64::MIN_POSITIVE), &self.outer, damping, axis)
    }
}

/// Where a block stands: by table over the span of each column, or by search where spans are far wider than filled.
struct Locator {
    table: Vec<u32>,
    offset: Vec<usize>,
}

impl Locator {
    fn new(pattern: &BlockPattern) -> Self {
        let n = pattern.n_nodes();
        let span = |c: usize| (pattern.row[pattern.col_start[c + 1] as usize - 1] as usize) - c + 1;
        let total: usize = (0..n).map(span).sum();
        if total > 32 * pattern.row.len() + (1 << 20) {
            return Self { table: Vec::new(), offset: Vec::new() };
        }
        let mut table = vec![u32::MAX; total];
        let mut offset = Vec::with_capacity(n);
        let mut next = 0;
        for c in 0..n {
            offset.push(next);
            for k in pattern.column(c) {
                table[next + pattern.row[k] as usize - c] = k as u32;
            }
            next += span(c);
        }
        Self { table, offset }
    }

    /// Index of block (row, column), row >= column.
    #[inline(always)]
    fn find(&self, pattern: &BlockPattern, row: usize, column: usize) -> usize {
        if let Some(&base) = self.offset.get(column) {
            self.table[base + row - column] as usize
        } else {
            let blocks = pattern.column(column);
            blocks.start + pattern.row[blocks].partition_point(|&r| (r as usize) < row)
        }
    }
}

/// Sums of one chunk of tracks, over the block columns and views that the chunk touches.
#[derive(Default)]
struct Accumulator {
    views: std::ops::Range<usize>,
    blocks: std::ops::Range<usize>,
    /// `D` rows of each block.
    block: Vec<Lanes>,
    /// Diagonal of the unreduced camera block, for damping.
    diagonal: Vec<Lanes>,
    rhs: Vec<Lanes>,
    scratch: Scratch,
}

#[derive(Default)]
struct Scratch {
    models: Vec<Quadratic>,
    /// `D` rows of `L^-1 M` for each view of the track.
    rows: Vec<Lanes>,
    views: Vec<u32>,
}

pub(super) struct ReducedSystem<const D: usize> {
    pattern: BlockPattern,
    locator: Locator,
    accumulators: Vec<Accumulator>,
    pinned: usize,
    values: Vec<f64>,
    rhs: Vec<f64>,
    diagonal: Vec<Lanes>,
    solver: BlockSolver<D>,
}

impl<const D: usize> ReducedSystem<D> {
    /// Finds which views share a track, orders them and chooses the linear solver.
    pub fn analyse(part: &Part<D>, solver: LinearSolver) -> Result<Self, LeastSquaresError> {
        let pattern = co_visibility(part);
        let locator = Locator::new(&pattern);
        let accumulators = part.chunks.iter().map(|tracks| Accumulator::over::<D>(part, tracks, &pattern)).collect();
        let (n_blocks, n_views) = (pattern.row.len(), part.n_views);
        Ok(Self {
            pinned: most_observed_view(part),
            values: vec![0.0; n_blocks * D * D - n_views * (D * (D - 1) / 2)],
            rhs: vec![0.0; n_views * D],
            diagonal: vec![Lanes::ZERO; n_views],
            accumulators,
            solver: BlockSolver::analyse(&pattern, solver)?,
            pattern,
            locator,
        })
    }

    /// Sums the observations into the reduced system.
    pub fn assemble(&mut self, part: &Part<D>, weighing: &impl Weighing<D>, damping: Damping) {
        let (pattern, locator) = (&self.pattern, &self.locator);
        self.accumulators.par_iter_mut().zip(&part.chunks).for_each(|(sums, tracks)| {
            pulp::Arch::new().dispatch(Elimination {
                part,
                tracks: tracks.clone(),
                pattern,
                locator,
                weighing,
                point_damping: damping.point,
                sums,
            });
        });
        self.gather(damping.view);
    }

    /// Adds the chunks, in their order, into the values of the lower triangle and the right-hand side.
    fn gather(&mut self, view_damping: f64) {
        let mut diagonal = std::mem::take(&mut self.diagonal);
        diagonal.fill(Lanes::ZERO);
        self.rhs.fill(0.0);
        for sums in &self.accumulators {
            for (slot, view) in sums.views.clone().enumerate() {
                diagonal[view] = diagonal[view].plus(&sums.diagonal[slot]);
                for c in 0..D {
                    self.rhs[view * D + c] += sums.rhs[slot].0[c];
                }
            }
        }
        let largest = diagonal.iter().flat_map(|d| d.0).fold(0.0, f64::max);
        let (pattern, accumulators, pinned) = (&self.pattern, &self.accumulators, self.pinned);
        let mut columns: Vec<&mut [f64]> = Vec::with_capacity(pattern.n_nodes());
        let mut rest = self.values.as_mut_slice();
        for node in 0..pattern.n_nodes() {
            let length = pattern.column(node).len() * D * D - D * (D - 1) / 2;
            let (column, tail) = rest.split_at_mut(length);
            columns.push(column);
            rest = tail;
        }
        columns.into_par_iter().enumerate().with_min_len(64).for_each(|(node, column)| {
            gather_column::<D>(pattern, accumulators, node, pinned, &diagonal[node], view_damping, largest, column);
        });
        self.rhs[pinned * D..(pinned + 1) * D].fill(0.0);
        self.diagonal = diagonal;
    }

    /// Factorises the assembled system.
    pub fn factorise(&mut self) -> Result<(), LeastSquaresError> {
        self.solver.factorise(&self.pattern, &self.values)
    }

    /// Solves the assembled system for its right-hand side.
    pub fn solve(&mut self) -> Result<Vec<Lanes>, LeastSquaresError> {
        self.factorise()?;
        let mut x = self.rhs.clone();
        self.solver.solve(&mut x, 1)?;
        Ok(x.as_chunks::<D>().0.iter().map(Lanes::from_vector::<D>).collect())
    }

    /// Solves the system factorised last for other right-hand sides, one after the other in `right`; the pinned view's
    /// entries must be zero.
    pub fn solve_for(&self, right: &mut [f64], n_right: usize) -> Result<(), LeastSquaresError> {
        self.solver.solve(right, n_right)
    }

    /// The view that is held.
    pub fn pinned(&self) -> usize {
        self.pinned
    }

    /// Diagonal of the unreduced camera blocks, to which the damping of views is relative.
    pub fn diagonal(&self) -> &[Lanes] {
        &self.diagonal
    }
}

#[allow(clippy::too_many_arguments)]
fn gather_column<const D: usize>(
    pattern: &BlockPattern,
    accumulators: &[Accumulator],
    node: usize,
    pinned: usize,
    diagonal: &Lanes,
    view_damping: f64,
    largest: f64,
    column: &mut [f64],
) {
    column.fill(0.0);
    let blocks = pattern.column(node);
    let base = scalar_slots::<D>(pattern, node, blocks.start, 0);
    for sums in accumulators.iter().filter(|s| s.blocks.start < blocks.end && blocks.start < s.blocks.end) {
        let (blocks_of_chunk, _) = sums.block.as_chunks::<D>();
        for k in blocks.clone() {
            let block = &blocks_of_chunk[k - sums.blocks.start];
            for c in 0..D {
                let slot = scalar_slots::<D>(pattern, node, k, c) - base;
                let first = if k == blocks.start { c } else { 0 };
                for r in first..D {
                    column[slot + r - first] += block[r].0[c];
                }
            }
        }
    }
    for k in blocks.clone() {
        let is_diagonal = k == blocks.start;
        let touches_pinned = node == pinned || pattern.row[k] as usize == pinned;
        for c in 0..D {
            let slot = scalar_slots::<D>(pattern, node, k, c) - base;
            let length = if is_diagonal { D - c } else { D };
            if touches_pinned {
                column[slot..slot + length].fill(0.0);
            }
            if is_diagonal {
                // a view without a single kept observation is held, like the pinned one
                let held = touches_pinned || diagonal.0[c] <= 0.0;
                column[slot] += if held { largest.max(f64::MIN_POSITIVE) } else { view_damping * diagonal.0[c] };
            }
        }
    }
}

fn most_observed_view<const D: usize>(part: &Part<D>) -> usize {
    let mut count = vec![0u32; part.n_views];
    for &v in &part.view {
        count[v as usize] += 1;
    }
    (0..part.n_views).fold(0, |best, v| if count[v] > count[best] { v } else { best })
}

/// Which views share a track. Pairs repeat from track to track: a small direct-mapped memory of pairs already listed
/// keeps the list short before it is sorted.
fn co_visibility<const D: usize>(part: &Part<D>) -> BlockPattern {
    const MEMORY: usize = 1 << 14;
    let lists: Vec<Vec<u64>> = part
        .chunks
        .par_iter()
        .map(|tracks| {
            let mut seen = vec![u64::MAX; MEMORY];
            let mut pairs = Vec::new();
            for j in tracks.clone() {
                let views = &part.view[part.observations(j)];
                for (i, &row) in views.iter().enumerate() {
                    for &column in &views[..i] {
                        let pair = u64::from(column) << 32 | u64::from(row);
                        let slot = (pair.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 50) as usize;
                        if seen[slot] != pair {
                            seen[slot] = pair;
                            pairs.push(pair);
                        }
                    }
                }
            }
            pairs.sort_unstable();
            pairs.dedup();
            pairs
        })
        .collect();
    let mut pairs: Vec<u64> = (0..part.n_views as u64).map(|v| v << 32 | v).collect();
    pairs.extend(lists.into_iter().flatten());
    pairs.par_sort_unstable();
    pairs.dedup();
    let mut col_start = vec![0u32; part.n_views + 1];
    for &pair in &pairs {
        col_start[(pair >> 32) as usize + 1] += 1;
    }
    for v in 0..part.n_views {
        col_start[v + 1] += col_start[v];
    }
    BlockPattern { col_start, row: pairs.into_iter().map(|pair| pair as u32).collect() }
}

impl Accumulator {
    fn over<const D: usize>(part: &Part<D>, tracks: &std::ops::Range<usize>, pattern: &BlockPattern) -> Self {
        let (mut low, mut high) = (usize::MAX, 0);
        for j in tracks.clone() {
            let views = &part.view[part.observations(j)];
            low = low.min(views[0] as usize);
            high = high.max(views[views.len() - 1] as usize + 1);
        }
        let low = low.min(high);
        let blocks = pattern.col_start[low] as usize..pattern.col_start[high] as usize;
        Self { views: low..high, blocks, ..Self::default() }
    }

    fn reset<const D: usize>(&mut self) {
        for (lanes, n) in [
            (&mut self.block, self.blocks.len() * D),
            (&mut self.diagonal, self.views.len()),
            (&mut self.rhs, self.views.len()),
        ] {
            lanes.clear();
            lanes.resize(n, Lanes::ZERO);
        }
    }
}

/// The arguments of [`eliminate_points`], to be run with the widest instruction set. A closure would not do: it is compiled
/// by itself, for the narrowest.
struct Elimination<'a, const D: usize, W> {
    part: &'a Part<D>,
    tracks: std::ops::Range<usize>,
    pattern: &'a BlockPattern,
    locator: &'a Locator,
    weighing: &'a W,
    point_damping: f64,
    sums: &'a mut Accumulator,
}

impl<const D: usize, W: Weighing<D>> pulp::WithSimd for Elimination<'_, D, W> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { part, tracks, pattern, locator, weighing, point_damping, sums } = self;
        eliminate_points(part, tracks, pattern, locator, weighing, point_damping, sums);
    }
}

/// Eliminates the points of one chunk of tracks. Inlined into each instruction set's copy.
#[inline(always)]
fn eliminate_points<const D: usize>(
    part: &Part<D>,
    tracks: std::ops::Range<usize>,
    pattern: &BlockPattern,
    locator: &Locator,
    weighing: &impl Weighing<D>,
    point_damping: f64,
    sums: &mut Accumulator,
) {
    sums.reset::<D>();
    for j in tracks {
        let Some((factor, gradient)) = point_block(part, j, weighing, point_damping, &mut sums.scratch) else {
            continue;
        };
        let y = factor.forward(&gradient);
        camera_blocks(part, j, &factor, &y, pattern, locator, sums);
        subtract_products::<D>(pattern, locator, sums);
    }
}

/// Sums the models of one track's observations into the factor of `A` and the gradient `g`; keeps the models in scratch.
#[inline(always)]
fn point_block<const D: usize>(
    part: &Part<D>,
    j: usize,
    weighing: &impl Weighing<D>,
    point_damping: f64,
    scratch: &mut Scratch,
) -> Option<(PointFactor<D>, Lanes)> {
    scratch.models.clear();
    let mut sum = PointSum::<D>::new();
    for o in part.observations(j) {
        let model = weighing.observe(o, j);
        sum.add(&model);
        scratch.models.push(model);
    }
    // a closure in `then` would not be inlined into the wide instruction set
    if sum.is_empty() { None } else { Some((sum.factor(point_damping, &weighing.depth_axis(j)), sum.gradient)) }
}

/// Adds each observation's own camera block and right-hand side, and leaves `L^-1 M` of each view in scratch.
#[inline(always)]
fn camera_blocks<const D: usize>(
    part: &Part<D>,
    j: usize,
    factor: &PointFactor<D>,
    y: &[f64; D],
    pattern: &BlockPattern,
    locator: &Locator,
    sums: &mut Accumulator,
) {
    let Scratch { models, rows: stored, views } = &mut sums.scratch;
    let (blocks, _) = sums.block.as_chunks_mut::<D>();
    let seen_by = &part.view[part.observations(j)];
    stored.clear();
    views.clear();
    for (model, &view) in models.iter().zip(seen_by) {
        let d = &model.direction;
        let weight = d.0[3];
        let weighted = d.times(weight);
        let mut rows: [Lanes; D] = std::array::from_fn(|r| {
            let mut row = weighted.times(-d.0[r]);
            row.0[r] += weight;
            row.0[3] = 0.0;
            row
        });
        let slot = view as usize - sums.views.start;
        let block = &mut blocks[locator.find(pattern, view as usize, view as usize) - sums.blocks.start];
        for r in 0..D {
            block[r] = block[r].plus(&rows[r]);
            sums.diagonal[slot].0[r] += rows[r].0[r];
        }
        factor.forward_rows(&mut rows);
        let mut right = model.gradient.times(-1.0);
        for r in 0..D {
            right = right.plus_scaled(y[r], &rows[r]);
        }
        sums.rhs[slot] = sums.rhs[slot].plus(&right);
        if part.has_repeats && views.last() == Some(&view) {
            let n = stored.len();
            for r in 0..D {
                stored[n - D + r] = stored[n - D + r].plus(&rows[r]);
            }
        } else {
            stored.extend_from_slice(&rows);
            views.push(view);
        }
    }
}

/// Subtracts `T_a^T T_b`, `T = L^-1 M`, from the block of every pair of views of the track.
#[inline(always)]
fn subtract_products<const D: usize>(pattern: &BlockPattern, locator: &Locator, sums: &mut Accumulator) {
    let (rows, _) = sums.scratch.rows.as_chunks::<D>();
    let (blocks, _) = sums.block.as_chunks_mut::<D>();
    for (i, (a, &row)) in rows.iter().zip(&sums.scratch.views).enumerate() {
        for (b, &column) in rows[..=i].iter().zip(&sums.scratch.views) {
            let block = &mut blocks[locator.find(pattern, row as usize, column as usize) - sums.blocks.start];
            for r in 0..D {
                let mut sum = block[r];
                for c in 0..D {
                    sum = sum.plus_scaled(-a[c].0[r], &b[c]);
                }
                block[r] = sum;
            }
        }
    }
}
