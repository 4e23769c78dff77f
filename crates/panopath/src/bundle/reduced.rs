//! The reduced camera system: points eliminated, one block for each pair of cameras that share a track.
//!
//! The nodes of the system are cameras with `V` unknowns each: the `D` coordinates of a centre, or those and a turn. They
//! move the origin of a ray, as seen from its point, by `K` times the unknowns ([`Freedoms`]); `K = I` for a centre alone.
//!
//! Each observation `(i, j)` contributes `1/2 (x_j - c_i)^T M (x_j - c_i) - q^T (x_j - c_i)` with
//! `M = w (I - d d^T)`. With `A_j = sum_i M_ij` and `g_j = sum_i q_ij`, stationarity in the points leaves
//! `S c = b`, `S = diag(sum_j M_ij) - sum_j M_ij A_j^-1 M_lj` and `b_i = sum_j (M_ij A_j^-1 g_j - q_ij)`.
//! Where a node has more unknowns, `M_ij` is multiplied by `K_ij` on the side of the camera. Unknowns may be held (zero
//! rows), which takes away a gauge.
//!
//! [`assemble`](ReducedSystem::assemble) is the hot loop of the whole package; it is compiled for the widest
//! instruction set found at run time. `tests` holds a dense reference.

use rayon::prelude::*;

use super::courses::{CourseSystem, observation_rows};
use super::part::{Lanes, Layout, Part};
use crate::least_squares::{BlockPattern, BlockSolver, LeastSquaresError, LinearSolver, scalar_slots};

/// Quadratic model of one observation: see the module's text. `direction` has the weight `w` in lane 3.
pub(crate) struct Quadratic {
    pub direction: Lanes,
    pub gradient: Lanes,
}

/// Gives the quadratic model of each observation at the current estimate.
pub(crate) trait Weighing<const D: usize>: Sync {
    /// Model of observation `o` of track `j`; a weight of zero leaves the observation out.
    fn observe(&self, o: usize, j: usize) -> Quadratic;
    /// Depth axis of point `j`, a unit vector, for the damping frame.
    fn depth_axis(&self, j: usize) -> Lanes;
}

/// One row of a block of the camera system, `V` numbers padded to the width of registers.
pub(crate) trait Row: Copy + Send + Sync {
    const ZERO: Self;
    fn plus(&self, other: &Self) -> Self;
    /// `self + s * other`.
    fn plus_scaled(&self, s: f64, other: &Self) -> Self;
    fn at(&self, k: usize) -> f64;
}

impl Row for Lanes {
    const ZERO: Self = Lanes::ZERO;

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        Lanes::plus(self, other)
    }

    #[inline(always)]
    fn plus_scaled(&self, s: f64, other: &Self) -> Self {
        Lanes::plus_scaled(self, s, other)
    }

    #[inline(always)]
    fn at(&self, k: usize) -> f64 {
        self.0[k]
    }
}

/// What the `V` unknowns of a camera do to the rays of its stations: they displace their origins, as seen from a point, by
/// a `D x V` matrix `K`.
pub(crate) trait Freedoms<const D: usize, const V: usize>: Sync {
    type Row: Row;
    /// `row K` for observation `o` of track `j`.
    fn lift(&self, o: usize, j: usize, row: &Lanes) -> Self::Row;
    /// `K^T rows`.
    fn lift_rows(&self, o: usize, j: usize, rows: &[Self::Row; D]) -> [Self::Row; V];
    /// Is the point known already, and not to be eliminated?
    fn holds_point(&self, _j: usize) -> bool {
        false
    }
}

/// Cameras that have a position and nothing else.
pub(crate) struct Translations;

impl<const D: usize> Freedoms<D, D> for Translations {
    type Row = Lanes;

    #[inline(always)]
    fn lift(&self, _o: usize, _j: usize, row: &Lanes) -> Lanes {
        *row
    }

    #[inline(always)]
    fn lift_rows(&self, _o: usize, _j: usize, rows: &[Lanes; D]) -> [Lanes; D] {
        *rows
    }
}

/// Squared error of a camera's own unknowns, which no point takes part in: a prior. Adds `1/2 x^T H x - b^T x`.
pub(crate) struct CameraTerm<const V: usize> {
    pub node: u32,
    pub information: [[f64; V]; V],
    pub gradient: [f64; V],
}

/// Levenberg-Marquardt damping, relative to the diagonal.
#[derive(Clone, Copy)]
pub(crate) struct Damping {
    pub point: f64,
    pub view: f64,
}

/// Keeps the eliminated block positive definite where rays are parallel, relative to its trace.
const POINT_FLOOR: f64 = 1e-14;

/// Cholesky factor of the block `A` of one point, with the reciprocals of its diagonal.
pub(crate) struct PointFactor<const D: usize> {
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
    /// `M` by rows.
    #[inline(always)]
    pub fn rows<const D: usize>(&self) -> [Lanes; D] {
        let d = &self.direction;
        let weight = d.0[3];
        let weighted = d.times(weight);
        std::array::from_fn(|r| {
            let mut row = weighted.times(-d.0[r]);
            row.0[r] += weight;
            row.0[3] = 0.0;
            row
        })
    }

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
pub(crate) struct PointSum<const D: usize> {
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

/// Sums of one chunk of tracks, over the block columns and nodes that the chunk touches.
struct Accumulator<const D: usize, const V: usize, R> {
    nodes: std::ops::Range<usize>,
    blocks: std::ops::Range<usize>,
    block: Vec<[R; V]>,
    /// Diagonal of the unreduced camera block, for damping.
    diagonal: Vec<[f64; V]>,
    rhs: Vec<R>,
    scratch: Scratch<D, R>,
}

struct Scratch<const D: usize, R> {
    models: Vec<Quadratic>,
    /// `L^-1 M K` for each node of the track.
    rows: Vec<[R; D]>,
    nodes: Vec<u32>,
    course: CourseSystem,
}

pub(crate) struct ReducedSystem<const D: usize, const V: usize, R> {
    pattern: BlockPattern,
    locator: Locator,
    accumulators: Vec<Accumulator<D, V, R>>,
    held: Vec<bool>,
    values: Vec<f64>,
    rhs: Vec<f64>,
    diagonal: Vec<[f64; V]>,
    solver: BlockSolver<V>,
}

impl<const D: usize, const V: usize, R: Row> ReducedSystem<D, V, R> {
    /// Finds which nodes share a track, orders them and chooses the linear solver. `held` are the unknowns that stay zero,
    /// `V` for each node.
    pub fn analyse(part: &Part<D>, solver: LinearSolver, held: Vec<bool>) -> Result<Self, LeastSquaresError> {
        let pattern = co_visibility(part);
        let locator = Locator::new(&pattern);
        let accumulators = part.chunks.iter().map(|tracks| Accumulator::over(part, tracks, &pattern)).collect();
        let (n_blocks, n_nodes) = (pattern.row.len(), part.n_nodes);
        Ok(Self {
            held,
            values: vec![0.0; n_blocks * V * V - n_nodes * (V * (V - 1) / 2)],
            rhs: vec![0.0; n_nodes * V],
            diagonal: vec![[0.0; V]; n_nodes],
            accumulators,
            solver: BlockSolver::analyse(&pattern, solver)?,
            pattern,
            locator,
        })
    }

    /// Sums the observations and the cameras' own terms into the reduced system.
    pub fn assemble(
        &mut self,
        part: &Part<D>,
        weighing: &impl Weighing<D>,
        freedoms: &impl Freedoms<D, V, Row = R>,
        terms: &[CameraTerm<V>],
        damping: Damping,
    ) {
        let (pattern, locator) = (&self.pattern, &self.locator);
        self.accumulators.par_iter_mut().zip(&part.chunks).for_each(|(sums, tracks)| {
            pulp::Arch::new().dispatch(Elimination {
                part,
                tracks: tracks.clone(),
                pattern,
                locator,
                weighing,
                freedoms,
                point_damping: damping.point,
                sums,
            });
        });
        self.gather(terms, damping.view);
    }

    /// Adds the chunks, in their order, into the values of the lower triangle and the right-hand side.
    fn gather(&mut self, terms: &[CameraTerm<V>], view_damping: f64) {
        let mut diagonal = std::mem::take(&mut self.diagonal);
        diagonal.fill([0.0; V]);
        self.rhs.fill(0.0);
        for sums in &self.accumulators {
            for (slot, node) in sums.nodes.clone().enumerate() {
                for c in 0..V {
                    diagonal[node][c] += sums.diagonal[slot][c];
                    self.rhs[node * V + c] += sums.rhs[slot].at(c);
                }
            }
        }
        for term in terms {
            let node = term.node as usize;
            for c in 0..V {
                diagonal[node][c] += term.information[c][c];
                self.rhs[node * V + c] += term.gradient[c];
            }
        }
        let largest = diagonal.iter().flatten().copied().fold(0.0, f64::max);
        let (pattern, accumulators, held) = (&self.pattern, &self.accumulators, &self.held);
        let mut columns: Vec<&mut [f64]> = Vec::with_capacity(pattern.n_nodes());
        let mut rest = self.values.as_mut_slice();
        for node in 0..pattern.n_nodes() {
            let length = pattern.column(node).len() * V * V - V * (V - 1) / 2;
            let (column, tail) = rest.split_at_mut(length);
            columns.push(column);
            rest = tail;
        }
        let terms_of = terms_by_node(terms, pattern.n_nodes());
        columns.into_par_iter().enumerate().with_min_len(64).for_each(|(node, column)| {
            sum_column(pattern, accumulators, node, column);
            for &term in &terms_of[node] {
                add_term(pattern, node, &terms[term as usize].information, column);
            }
            hold_and_damp(pattern, node, held, &diagonal[node], view_damping, largest, column);
        });
        for (right, _) in self.rhs.iter_mut().zip(held).filter(|(_, held)| **held) {
            *right = 0.0;
        }
        self.diagonal = diagonal;
    }

    /// Factorises the assembled system.
    pub fn factorise(&mut self) -> Result<(), LeastSquaresError> {
        self.solver.factorise(&self.pattern, &self.values)
    }

    /// Solves the assembled system for its right-hand side.
    pub fn solve(&mut self) -> Result<Vec<[f64; V]>, LeastSquaresError> {
        self.factorise()?;
        let mut x = self.rhs.clone();
        self.solver.solve(&mut x, 1)?;
        Ok(x.as_chunks::<V>().0.to_vec())
    }

    /// Solves the system factorised last for other right-hand sides, one after the other in `right`; entries of unknowns
    /// that are held must be zero.
    pub fn solve_for(&self, right: &mut [f64], n_right: usize) -> Result<(), LeastSquaresError> {
        self.solver.solve(right, n_right)
    }

    /// The unknowns that stay zero.
    pub fn held(&self) -> &[bool] {
        &self.held
    }

    /// Which nodes are coupled.
    pub fn pattern(&self) -> &BlockPattern {
        &self.pattern
    }

    /// Lower triangle of the system as it was assembled last, in the order of [`scalar_slots`].
    pub fn values(&self) -> &[f64] {
        &self.values
    }
}

fn terms_by_node<const V: usize>(terms: &[CameraTerm<V>], n_nodes: usize) -> Vec<Vec<u32>> {
    let mut of = vec![Vec::new(); n_nodes];
    for (k, term) in terms.iter().enumerate() {
        of[term.node as usize].push(k as u32);
    }
    of
}

/// Sums one block column over the chunks.
fn sum_column<const D: usize, const V: usize, R: Row>(
    pattern: &BlockPattern,
    accumulators: &[Accumulator<D, V, R>],
    node: usize,
    column: &mut [f64],
) {
    column.fill(0.0);
    let blocks = pattern.column(node);
    let base = scalar_slots::<V>(pattern, node, blocks.start, 0);
    for sums in accumulators.iter().filter(|s| s.blocks.start < blocks.end && blocks.start < s.blocks.end) {
        for k in blocks.clone() {
            let block = &sums.block[k - sums.blocks.start];
            for c in 0..V {
                let slot = scalar_slots::<V>(pattern, node, k, c) - base;
                let first = if k == blocks.start { c } else { 0 };
                for r in first..V {
                    column[slot + r - first] += block[r].at(c);
                }
            }
        }
    }
}

/// Adds a term of the camera's own to its diagonal block.
fn add_term<const V: usize>(pattern: &BlockPattern, node: usize, information: &[[f64; V]; V], column: &mut [f64]) {
    let first = pattern.column(node).start;
    let base = scalar_slots::<V>(pattern, node, first, 0);
    for c in 0..V {
        let slot = scalar_slots::<V>(pattern, node, first, c) - base;
        for r in c..V {
            column[slot + r - c] += information[r][c];
        }
    }
}

/// Clears rows and columns of held unknowns and damps the others.
fn hold_and_damp<const V: usize>(
    pattern: &BlockPattern,
    node: usize,
    held: &[bool],
    diagonal: &[f64; V],
    view_damping: f64,
    largest: f64,
    column: &mut [f64],
) {
    let blocks = pattern.column(node);
    let base = scalar_slots::<V>(pattern, node, blocks.start, 0);
    for k in blocks.clone() {
        let is_diagonal = k == blocks.start;
        let row = pattern.row[k] as usize;
        for c in 0..V {
            let slot = scalar_slots::<V>(pattern, node, k, c) - base;
            let first = if is_diagonal { c } else { 0 };
            // an unknown that nothing tells of is held like those that are to be
            let hold = held[node * V + c] || diagonal[c] <= 0.0;
            for r in first..V {
                if hold || held[row * V + r] {
                    column[slot + r - first] = 0.0;
                }
            }
            if is_diagonal {
                column[slot] += if hold { largest.max(f64::MIN_POSITIVE) } else { view_damping * diagonal[c] };
            }
        }
    }
}

/// A system of cameras as it was factorised last.
pub(crate) trait Factorised {
    /// Solves in place for one right-hand side of the cameras' unknowns; those that are held must be zero.
    fn solve_for(&self, right: &mut [f64]) -> Result<(), LeastSquaresError>;
    /// The unknowns that stay zero.
    fn held(&self) -> &[bool];
    /// Diagonal of the camera blocks without what points take away.
    fn diagonal(&self) -> &[f64];
}

impl<const D: usize, const V: usize, R: Row> Factorised for ReducedSystem<D, V, R> {
    fn solve_for(&self, right: &mut [f64]) -> Result<(), LeastSquaresError> {
        self.solver.solve(right, 1)
    }

    fn held(&self) -> &[bool] {
        &self.held
    }

    fn diagonal(&self) -> &[f64] {
        self.diagonal.as_flattened()
    }
}

/// The node that saw most.
pub(crate) fn most_observed_node(layout: &Layout) -> usize {
    let mut count = vec![0u32; layout.n_nodes];
    for o in 0..layout.n_observations() {
        count[layout.node_of(o) as usize] += 1;
    }
    (0..layout.n_nodes).fold(0, |best, v| if count[v] > count[best] { v } else { best })
}

/// Which nodes share a track. Pairs repeat from track to track: a small direct-mapped memory of pairs already listed
/// keeps the list short before it is sorted.
fn co_visibility(layout: &Layout) -> BlockPattern {
    const MEMORY: usize = 1 << 14;
    let lists: Vec<Vec<u64>> = layout
        .chunks
        .par_iter()
        .map(|tracks| {
            let mut seen = vec![u64::MAX; MEMORY];
            let mut pairs = Vec::new();
            for j in tracks.clone() {
                let observations = layout.observations(j);
                for i in observations.clone() {
                    for k in observations.start..i {
                        let pair = u64::from(layout.node_of(k)) << 32 | u64::from(layout.node_of(i));
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
    let mut pairs: Vec<u64> = (0..layout.n_nodes as u64).map(|v| v << 32 | v).collect();
    pairs.extend(lists.into_iter().flatten());
    pairs.par_sort_unstable();
    pairs.dedup();
    let mut col_start = vec![0u32; layout.n_nodes + 1];
    for &pair in &pairs {
        col_start[(pair >> 32) as usize + 1] += 1;
    }
    for v in 0..layout.n_nodes {
        col_start[v + 1] += col_start[v];
    }
    BlockPattern { col_start, row: pairs.into_iter().map(|pair| pair as u32).collect() }
}

impl<const D: usize, const V: usize, R: Row> Accumulator<D, V, R> {
    fn over(layout: &Layout, tracks: &std::ops::Range<usize>, pattern: &BlockPattern) -> Self {
        let (mut low, mut high) = (usize::MAX, 0);
        for j in tracks.clone() {
            let observations = layout.observations(j);
            low = low.min(layout.node_of(observations.start) as usize);
            high = high.max(layout.node_of(observations.end - 1) as usize + 1);
        }
        let low = low.min(high);
        let blocks = pattern.col_start[low] as usize..pattern.col_start[high] as usize;
        let scratch =
            Scratch { models: Vec::new(), rows: Vec::new(), nodes: Vec::new(), course: CourseSystem::default() };
        Self { nodes: low..high, blocks, block: Vec::new(), diagonal: Vec::new(), rhs: Vec::new(), scratch }
    }

    fn reset(&mut self) {
        self.block.clear();
        self.block.resize(self.blocks.len(), [R::ZERO; V]);
        self.diagonal.clear();
        self.diagonal.resize(self.nodes.len(), [0.0; V]);
        self.rhs.clear();
        self.rhs.resize(self.nodes.len(), R::ZERO);
    }
}

/// The arguments of [`eliminate_points`], to be run with the widest instruction set. A closure would not do: it is compiled
/// by itself, for the narrowest.
struct Elimination<'a, const D: usize, const V: usize, W, F: Freedoms<D, V>> {
    part: &'a Part<D>,
    tracks: std::ops::Range<usize>,
    pattern: &'a BlockPattern,
    locator: &'a Locator,
    weighing: &'a W,
    freedoms: &'a F,
    point_damping: f64,
    sums: &'a mut Accumulator<D, V, F::Row>,
}

impl<const D: usize, const V: usize, W: Weighing<D>, F: Freedoms<D, V>> pulp::WithSimd for Elimination<'_, D, V, W, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let Self { part, tracks, pattern, locator, weighing, freedoms, point_damping, sums } = self;
        eliminate_points(part, tracks, pattern, locator, weighing, freedoms, point_damping, sums);
    }
}

/// Eliminates the points of one chunk of tracks. Inlined into each instruction set's copy.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn eliminate_points<const D: usize, const V: usize, F: Freedoms<D, V>>(
    part: &Part<D>,
    tracks: std::ops::Range<usize>,
    pattern: &BlockPattern,
    locator: &Locator,
    weighing: &impl Weighing<D>,
    freedoms: &F,
    point_damping: f64,
    sums: &mut Accumulator<D, V, F::Row>,
) {
    sums.reset();
    for j in tracks {
        if part.courses.moves(j) {
            eliminate_course(part, j, pattern, locator, weighing, freedoms, point_damping, sums);
            continue;
        }
        let Some((factor, gradient)) = point_block(part, j, weighing, point_damping, &mut sums.scratch) else {
            continue;
        };
        let y = factor.forward(&gradient);
        let eliminated = !freedoms.holds_point(j);
        camera_blocks(part, j, freedoms, eliminated.then_some((&factor, &y)), pattern, locator, sums);
        if eliminated {
            subtract_products(pattern, locator, sums);
        }
    }
}

/// Eliminates the vectors of a point that moves: as many rows as it has unknowns, in groups of `D` as a point at rest has.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
fn eliminate_course<const D: usize, const V: usize, F: Freedoms<D, V>>(
    part: &Part<D>,
    j: usize,
    pattern: &BlockPattern,
    locator: &Locator,
    weighing: &impl Weighing<D>,
    freedoms: &F,
    point_damping: f64,
    sums: &mut Accumulator<D, V, F::Row>,
) {
    let mut course = std::mem::take(&mut sums.scratch.course);
    sums.scratch.models.clear();
    sums.scratch.models.extend(part.observations(j).map(|o| weighing.observe(o, j)));
    if course.assemble::<D>(part.course(j), &sums.scratch.models) && course.factorise(point_damping) {
        course.solve_forward();
        let n_groups = course.len().div_ceil(D);
        sums.scratch.rows.clear();
        sums.scratch.nodes.clear();
        for (k, o) in part.observations(j).enumerate() {
            let node = part.node_of(o);
            let slot = node as usize - sums.nodes.start;
            let model = &sums.scratch.models[k];
            let at = locator.find(pattern, node as usize, node as usize) - sums.blocks.start;
            add_own::<D, V, F>(freedoms, o, j, &model.rows(), &mut sums.block[at], &mut sums.diagonal[slot]);
            let mut pull = model.gradient.times(-1.0);
            if sums.scratch.nodes.last() != Some(&node) {
                let length = sums.scratch.rows.len();
                sums.scratch.rows.resize(length + n_groups, [F::Row::ZERO; D]);
                sums.scratch.nodes.push(node);
            }
            let first = sums.scratch.rows.len() - n_groups;
            for (group, own) in sums.scratch.rows[first..].iter_mut().enumerate() {
                let (rows, right) = observation_rows::<D>(&course, k, group);
                for (own, row) in own.iter_mut().zip(&rows) {
                    *own = own.plus(&freedoms.lift(o, j, row));
                }
                pull = pull.plus(&right);
            }
            sums.rhs[slot] = sums.rhs[slot].plus(&freedoms.lift(o, j, &pull));
        }
        subtract_courses(pattern, locator, sums, n_groups);
    }
    sums.scratch.course = course;
}

/// Sums the models of one track's observations into the factor of `A` and the gradient `g`; keeps the models in scratch.
#[inline(always)]
fn point_block<const D: usize, R>(
    part: &Part<D>,
    j: usize,
    weighing: &impl Weighing<D>,
    point_damping: f64,
    scratch: &mut Scratch<D, R>,
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

/// Adds each observation's own camera block and right-hand side, and leaves `L^-1 M K` of each node in scratch. Without a
/// factor the point is held.
#[inline(always)]
fn camera_blocks<const D: usize, const V: usize, F: Freedoms<D, V>>(
    part: &Part<D>,
    j: usize,
    freedoms: &F,
    eliminated: Option<(&PointFactor<D>, &[f64; D])>,
    pattern: &BlockPattern,
    locator: &Locator,
    sums: &mut Accumulator<D, V, F::Row>,
) {
    let Scratch { models, rows: stored, nodes, .. } = &mut sums.scratch;
    stored.clear();
    nodes.clear();
    for (model, o) in models.iter().zip(part.observations(j)) {
        let node = part.node_of(o);
        let mut rows = model.rows::<D>();
        let slot = node as usize - sums.nodes.start;
        let block = &mut sums.block[locator.find(pattern, node as usize, node as usize) - sums.blocks.start];
        let mut lifted = add_own::<D, V, F>(freedoms, o, j, &rows, block, &mut sums.diagonal[slot]);
        let mut right = model.gradient.times(-1.0);
        if let Some((factor, y)) = eliminated {
            factor.forward_rows(&mut rows);
            for r in 0..D {
                right = right.plus_scaled(y[r], &rows[r]);
                lifted[r] = freedoms.lift(o, j, &rows[r]);
            }
        }
        sums.rhs[slot] = sums.rhs[slot].plus(&freedoms.lift(o, j, &right));
        if part.has_repeats && nodes.last() == Some(&node) {
            let last = stored.len() - 1;
            for r in 0..D {
                stored[last][r] = stored[last][r].plus(&lifted[r]);
            }
        } else {
            stored.push(lifted);
            nodes.push(node);
        }
    }
}

/// Adds `K^T M K` to the block of the node that made an observation; gives `M K`.
#[inline(always)]
fn add_own<const D: usize, const V: usize, F: Freedoms<D, V>>(
    freedoms: &F,
    o: usize,
    j: usize,
    rows: &[Lanes; D],
    block: &mut [F::Row; V],
    diagonal: &mut [f64; V],
) -> [F::Row; D] {
    let mut lifted = [F::Row::ZERO; D];
    for r in 0..D {
        lifted[r] = freedoms.lift(o, j, &rows[r]);
    }
    let own = freedoms.lift_rows(o, j, &lifted);
    for r in 0..V {
        block[r] = block[r].plus(&own[r]);
        diagonal[r] += own[r].at(r);
    }
    lifted
}

/// Subtracts `T_a^T T_b`, `T = L^-1 M K`, from the block of every pair of nodes of the track.
#[inline(always)]
fn subtract_products<const D: usize, const V: usize, R: Row>(
    pattern: &BlockPattern,
    locator: &Locator,
    sums: &mut Accumulator<D, V, R>,
) {
    let Scratch { rows, nodes, .. } = &sums.scratch;
    for (i, (a, &row)) in rows.iter().zip(nodes).enumerate() {
        for (b, &column) in rows[..=i].iter().zip(nodes) {
            let block = &mut sums.block[locator.find(pattern, row as usize, column as usize) - sums.blocks.start];
            for r in 0..V {
                let mut sum = block[r];
                for c in 0..D {
                    sum = sum.plus_scaled(-a[c].at(r), &b[c]);
                }
                block[r] = sum;
            }
        }
    }
}

/// The same for a point with several groups of rows; a block is fetched once for all of them.
#[inline(always)]
fn subtract_courses<const D: usize, const V: usize, R: Row>(
    pattern: &BlockPattern,
    locator: &Locator,
    sums: &mut Accumulator<D, V, R>,
    n_groups: usize,
) {
    let Scratch { rows, nodes, .. } = &sums.scratch;
    for (i, (own, &row)) in rows.chunks_exact(n_groups).zip(nodes).enumerate() {
        for (others, &column) in rows[..(i + 1) * n_groups].chunks_exact(n_groups).zip(nodes) {
            let block = &mut sums.block[locator.find(pattern, row as usize, column as usize) - sums.blocks.start];
            let mut sum = *block;
            for (a, b) in own.iter().zip(others) {
                for (r, sum) in sum.iter_mut().enumerate() {
                    for c in 0..D {
                        *sum = sum.plus_scaled(-a[c].at(r), &b[c]);
                    }
                }
            }
            *block = sum;
        }
    }
}
