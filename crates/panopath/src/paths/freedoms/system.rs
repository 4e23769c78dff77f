//! The null space of a part, and the modes that are nearly null.
//!
//! `E(dc, dp) = sum_o gain_o^2 |P_o (sum_f q_af z_f - dc_i)|^2`. Tracks are eliminated, or views where these have more unknowns: of
//! a matrix in blocks that is positive semidefinite the null space is that of the eliminated blocks and that of the Schur
//! complement, with the pseudo-inverse where a block is singular (Albert 1969). So what is loose by itself is counted at once.
//! What is left are all displacements, or where they are many the few weakest by inverse iteration, then Rayleigh-Ritz with
//! energies that are summed from the displacements themselves, which can tell a weak mode from none.

use rayon::prelude::*;

use super::eliminate::Eliminated;
use super::part::Part;
use crate::geometry::{Matrix, Vector, add, dot, scale, sub};
use crate::least_squares::{
    BlockPattern, BlockSolver, LeastSquaresError, LinearSolver, inner, scalar_slots, symmetric_eigen,
    symmetric_eigen_of,
};

/// Unknowns up to which all displacements are looked at.
const COMPLETE: usize = 400;
/// Modes beyond the null ones that are looked at, and at first where they are sought.
const BEYOND: usize = 8;
const FIRST: usize = 24;
/// Most modes sought.
const MOST: usize = 1200;
/// Inverse iterations.
const ITERATIONS: usize = 5;
/// What makes the matrix regular, as a share of its largest entry.
const GUARDS: [f64; 3] = [1e-12, 1e-10, 1e-8];
/// Eigenvalues below this share of the largest may be null, as far as rounding tells.
const PERHAPS_NULL: f64 = 1e-9;
/// Modes below this share of the largest energy are put in order once more among themselves.
const LOW: f64 = 1e-6;
/// Chunks of observations: a constant, so that sums do not depend on the threads.
const CHUNKS: usize = 32;

/// What the tracks that it sees tell of a view by themselves, `sum gain^2 P`.
pub(super) struct Held<const D: usize> {
    values: [f64; D],
    vectors: [Vector<D>; D],
    /// How many of the eigenvalues, which ascend, are null.
    pub loose: usize,
}

impl<const D: usize> Held<D> {
    fn of(part: &Part<D>, node: usize, null_below: f64) -> Self {
        let mut sum = [[0.0; D]; D];
        for &o in part.of_node.of(node) {
            let one = part.resistance(o as usize);
            (0..D).for_each(|r| (0..D).for_each(|c| sum[r][c] += one[r][c]));
        }
        let (values, vectors) = symmetric_eigen(&sum).unwrap_or(([0.0; D], [[0.0; D]; D]));
        let limit = values[D - 1] * f64::max(null_below * null_below, 1e-14);
        Self { values, vectors, loose: values.iter().take_while(|&&v| v <= limit).count() }
    }

    /// `N^+ x`.
    pub fn inverse_times(&self, x: &Vector<D>) -> Vector<D> {
        (self.loose..D)
            .fold([0.0; D], |sum, k| add(&sum, &scale(dot(&self.vectors[k], x) / self.values[k], &self.vectors[k])))
    }

    /// Directions that are free.
    pub fn free(&self) -> impl Iterator<Item = &Vector<D>> {
        self.vectors[..self.loose].iter()
    }

    /// Takes off what is free.
    fn settle(&self, x: &mut [f64]) {
        for v in &self.vectors[..self.loose] {
            let along: f64 = v.iter().zip(x.iter()).map(|(v, x)| v * x).sum();
            x.iter_mut().zip(v).for_each(|(x, v)| *x -= along * v);
        }
    }
}

/// A part with the blocks of its matrix.
pub(super) struct System<'a, const D: usize> {
    pub part: &'a Part<D>,
    pub tracks: Vec<Eliminated>,
    pub views: Vec<Held<D>>,
    /// Where the numbers of each track begin in a displacement, behind those of the views; one more entry.
    pub offset: Vec<usize>,
}

/// A displacement of all: `D` numbers of each view, then those of each track.
#[derive(Clone)]
pub(super) struct Mode {
    /// Of rms one over all ends of segments.
    pub step: Vec<f64>,
    /// Rms angle by which rays turn.
    pub value: f64,
}

pub(super) struct Spectrum {
    pub nullity: usize,
    /// Null vectors beyond what is loose by itself, orthonormal.
    pub core: Vec<Vec<f64>>,
    /// Modes that are not null, weakest first; a few of them.
    pub others: Vec<Mode>,
    pub last_null: f64,
    pub first_other: f64,
}

impl<'a, const D: usize> System<'a, D> {
    pub fn new(part: &'a Part<D>, null_below: f64) -> Self {
        let tracks: Vec<Eliminated> =
            (0..part.tracks.len()).into_par_iter().map(|j| Eliminated::new(part, j, null_below)).collect();
        let views = (0..part.views.len()).into_par_iter().map(|node| Held::of(part, node, null_below)).collect();
        let mut offset = vec![D * part.views.len()];
        for track in &tracks {
            offset.push(offset[offset.len() - 1] + D * track.k);
        }
        Self { part, tracks, views, offset }
    }

    /// How the path of an observation moves.
    #[inline]
    pub fn path_shift(&self, step: &[f64], o: usize) -> Vector<D> {
        let j = self.part.owner[o] as usize;
        self.tracks[j].shift(&step[self.offset[j]..self.offset[j + 1]], o - self.part.start[j])
    }

    /// How its view moves.
    #[inline]
    pub fn view_shift(&self, step: &[f64], o: usize) -> Vector<D> {
        let node = self.part.node[o] as usize;
        std::array::from_fn(|c| step[node * D + c])
    }

    /// How its far end moves against the near one.
    #[inline]
    pub fn across(&self, step: &[f64], o: usize) -> Vector<D> {
        sub(&self.path_shift(step, o), &self.view_shift(step, o))
    }

    /// Null vectors and a few of the weakest other modes.
    pub fn spectrum(&self, null_below: f64) -> Result<Spectrum, LeastSquaresError> {
        let part = self.part;
        let eliminates_tracks = D * part.views.len() <= self.offset[part.tracks.len()] - self.offset[0];
        let matrix = if eliminates_tracks { self.view_matrix() } else { self.track_matrix() };
        let complete = |side: Vec<f64>| if eliminates_tracks { self.following(side) } else { self.followed(&side) };
        let modes = matrix.weakest(
            |sides| {
                let steps = sides.into_par_iter().map(complete).collect();
                self.ritz(steps)
            },
            null_below,
        )?;
        let n_null = modes.iter().take_while(|mode| mode.value < null_below).count();
        let alone: usize = if eliminates_tracks {
            self.tracks.iter().map(Eliminated::loose::<D>).sum()
        } else {
            let unseen: usize = self.tracks.iter().map(|track| D * track.unseen.len()).sum();
            unseen + self.views.iter().map(|view| view.loose).sum::<usize>()
        };
        let (null, others) = modes.split_at(n_null);
        let settled = null.iter().map(|mode| self.settled(mode.step.clone())).collect();
        Ok(Spectrum {
            nullity: n_null + alone,
            core: orthonormal(settled, &[]),
            last_null: null.last().map_or(0.0, |mode| mode.value),
            first_other: others.first().map_or(f64::INFINITY, |mode| mode.value),
            others: others.to_vec(),
        })
    }

    /// Tracks follow their views.
    fn following(&self, mut views: Vec<f64>) -> Vec<f64> {
        let z: Vec<Vec<f64>> =
            self.tracks.iter().enumerate().map(|(j, track)| track.follow(self.part, j, &views)).collect();
        z.iter().for_each(|z| views.extend(z));
        views
    }

    /// Views follow their tracks.
    fn followed(&self, tracks: &[f64]) -> Vec<f64> {
        let mut step = vec![0.0; self.offset[0]];
        step.extend(tracks);
        // the second time takes off what rounding left
        for _ in 0..2 {
            for (node, held) in self.views.iter().enumerate() {
                let pull = self.part.of_node.of(node).iter().fold([0.0; D], |sum, &o| {
                    add(&sum, &self.part.resist(o as usize, &self.across(&step, o as usize)))
                });
                let moved = held.inverse_times(&pull);
                (0..D).for_each(|c| step[node * D + c] += moved[c]);
            }
        }
        step
    }

    /// Without what views and tracks could do by themselves.
    pub fn settled(&self, mut step: Vec<f64>) -> Vec<f64> {
        for (node, held) in self.views.iter().enumerate() {
            held.settle(&mut step[node * D..node * D + D]);
        }
        for (j, track) in self.tracks.iter().enumerate() {
            let z = &mut step[self.offset[j]..self.offset[j + 1]];
            for vector in &track.vectors[track.rank..] {
                let along = inner(vector, z);
                z.iter_mut().zip(vector).for_each(|(z, v)| *z -= along * v);
            }
        }
        step
    }

    /// Rms movement of all ends of segments.
    pub fn size(&self, step: &[f64]) -> f64 {
        let n = self.part.n_observations();
        let squared = |o: usize| {
            let (far, near) = (self.path_shift(step, o), self.view_shift(step, o));
            dot(&far, &far) + dot(&near, &near)
        };
        ((0..n).map(squared).sum::<f64>() / (2 * n) as f64).sqrt()
    }

    /// Energy of a displacement.
    pub fn energy(&self, step: &[f64]) -> f64 {
        let one = |o: usize| {
            let across = self.across(step, o);
            dot(&across, &self.part.resist(o, &across))
        };
        (0..self.part.n_observations()).map(one).sum()
    }

    /// Combinations of displacements that are modes, weakest first.
    fn ritz(&self, basis: Vec<Vec<f64>>) -> Result<Vec<Mode>, LeastSquaresError> {
        let (energies, mixes) = symmetric_eigen_of(&self.gram(&basis))?;
        let mut steps = mixed(&basis, &mixes);
        // what is low among what is high is known to rounding errors of the high
        let limit = LOW * energies.last().copied().unwrap_or(0.0);
        let low = energies.iter().take_while(|&&e| e < limit).count();
        if low > 0 && low < steps.len() {
            let rest = steps.split_off(low);
            let (_, mixes) = symmetric_eigen_of(&self.gram(&steps))?;
            steps = mixed(&steps, &mixes);
            steps.extend(rest);
        }
        let n = self.part.n_observations() as f64;
        let mode = |mut step: Vec<f64>| {
            let size = self.size(&step).max(f64::MIN_POSITIVE);
            step.iter_mut().for_each(|x| *x /= size);
            Mode { value: (self.energy(&step) / n).sqrt(), step }
        };
        let mut modes: Vec<Mode> = steps.into_par_iter().map(mode).collect();
        modes.sort_by(|a, b| a.value.total_cmp(&b.value));
        Ok(modes)
    }

    /// Inner products of displacements in the energy.
    fn gram(&self, basis: &[Vec<f64>]) -> Vec<Vec<f64>> {
        self.products(basis, |step, o| {
            let x = self.across(step, o);
            let along = dot(&self.part.ray[o], &x);
            let gain = self.part.gain[o];
            std::array::from_fn(|c| gain * (x[c] - along * self.part.ray[o][c]))
        })
    }

    /// Inner products, over all observations, of a vector that each displacement has there.
    pub fn products(&self, basis: &[Vec<f64>], vector: impl Fn(&[f64], usize) -> Vector<D> + Sync) -> Vec<Vec<f64>> {
        let (n, q) = (self.part.n_observations(), basis.len());
        let size = n.div_ceil(CHUNKS).max(1);
        let of_chunk = |chunk: usize| {
            let mut sum = vec![0.0; q * q];
            for o in chunk * size..((chunk + 1) * size).min(n) {
                let vectors: Vec<Vector<D>> = basis.iter().map(|step| vector(step, o)).collect();
                for a in 0..q {
                    for b in 0..=a {
                        sum[a * q + b] += dot(&vectors[a], &vectors[b]);
                    }
                }
            }
            sum
        };
        let sums: Vec<Vec<f64>> = (0..CHUNKS).into_par_iter().map(of_chunk).collect();
        let mut gram = vec![vec![0.0; q]; q];
        for sum in sums {
            for a in 0..q {
                (0..=a).for_each(|b| gram[a][b] += sum[a * q + b]);
            }
        }
        for a in 0..q {
            (0..a).for_each(|b| gram[b][a] = gram[a][b]);
        }
        gram
    }

    /// The matrix of the views, tracks eliminated.
    fn view_matrix(&self) -> Blocks<D> {
        let part = self.part;
        // `G_a = S^-1 V^T q_a gain^2 P`, so that the track takes `G_b^T G_a` off
        let of_track = |(j, track): (usize, &Eliminated)| -> Vec<f64> {
            let mut rows = Vec::with_capacity(part.observations(j).len() * track.rank * D);
            for (a, o) in part.observations(j).enumerate() {
                let resist = part.resistance(o);
                for (value, vector) in track.values.iter().zip(&track.vectors).take(track.rank) {
                    let arm = track.shift::<D>(vector, a);
                    rows.extend((0..D).map(|c| (0..D).map(|r| arm[r] * resist[r][c]).sum::<f64>() / value));
                }
            }
            rows
        };
        let pulls: Vec<Vec<f64>> = self.tracks.par_iter().enumerate().map(of_track).collect();
        let pull = |o: usize| {
            let j = part.owner[o] as usize;
            let (a, each) = (o - part.start[j], self.tracks[j].rank * D);
            pulls[j][a * each..(a + 1) * each].as_chunks::<D>().0
        };
        let column = |slot: &mut Vec<u32>, node: usize| {
            let mut found = Column::new(node as u32, slot);
            for &o in part.of_node.of(node) {
                let own = pull(o as usize);
                found.add(node as u32, &part.resistance(o as usize), 1.0);
                for b in part.observations(part.owner[o as usize] as usize).filter(|&b| part.node[b] as usize >= node) {
                    let product: Matrix<D> = std::array::from_fn(|r| {
                        std::array::from_fn(|c| pull(b).iter().zip(own).map(|(x, y)| x[r] * y[c]).sum())
                    });
                    found.add(part.node[b], &product, -1.0);
                }
            }
            found.sorted()
        };
        Blocks::of(part.views.len(), column)
    }

    /// The matrix of the tracks, views eliminated.
    fn track_matrix(&self) -> Blocks<D> {
        let part = self.part;
        let first = |j: usize| (self.offset[j] - self.offset[0]) / D;
        let n = first(part.tracks.len());
        let column = |slot: &mut Vec<u32>, node: usize| {
            let j = self.offset.partition_point(|&offset| (offset - self.offset[0]) / D <= node) - 1;
            let f = node - first(j);
            let value = |o: usize, f: usize| {
                let track = part.owner[o] as usize;
                self.tracks[track].q[(o - part.start[track]) * self.tracks[track].k + f]
            };
            let mut found = Column::new(node as u32, slot);
            for o in part.observations(j) {
                let (own, resist) = (value(o, f), part.resistance(o));
                for other in f..self.tracks[j].k {
                    found.add((first(j) + other) as u32, &resist, own * value(o, other));
                }
                let held = &self.views[part.node[o] as usize];
                let columns: [Vector<D>; D] =
                    std::array::from_fn(|c| held.inverse_times(&std::array::from_fn(|r| resist[r][c])));
                for &b in part.of_node.of(part.node[o] as usize) {
                    let (b, other) = (b as usize, part.owner[b as usize] as usize);
                    if first(other + 1) <= node {
                        continue;
                    }
                    let moved: [Vector<D>; D] = std::array::from_fn(|c| part.resist(b, &columns[c]));
                    let product: Matrix<D> = std::array::from_fn(|r| std::array::from_fn(|c| moved[c][r]));
                    for g in (0..self.tracks[other].k).filter(|g| first(other) + g >= node) {
                        found.add((first(other) + g) as u32, &product, -own * value(b, g));
                    }
                }
            }
            found.sorted()
        };
        Blocks::of(n, column)
    }
}

/// Combinations of displacements.
pub(super) fn mixed(basis: &[Vec<f64>], mixes: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let mix = |weights: &Vec<f64>| {
        let mut sum = vec![0.0; basis.first().map_or(0, Vec::len)];
        for (weight, vector) in weights.iter().zip(basis) {
            sum.iter_mut().zip(vector).for_each(|(s, x)| *s += weight * x);
        }
        sum
    };
    mixes.par_iter().map(mix).collect()
}

/// Makes vectors orthonormal and free of others that are, those that depend on others left out.
pub(super) fn orthonormal(vectors: Vec<Vec<f64>>, known: &[Vec<f64>]) -> Vec<Vec<f64>> {
    const DEPENDENT: f64 = 1e-6;
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(vectors.len());
    for mut vector in vectors {
        let before = inner(&vector, &vector).sqrt();
        // what is taken off is taken off twice: once loses digits
        for _ in 0..2 {
            for other in known.iter().chain(&basis) {
                let along = inner(&vector, other);
                vector.iter_mut().zip(other).for_each(|(x, y)| *x -= along * y);
            }
        }
        let length = inner(&vector, &vector).sqrt();
        if length > DEPENDENT * before && length > f64::MIN_POSITIVE {
            vector.iter_mut().for_each(|x| *x /= length);
            basis.push(vector);
        }
    }
    basis
}

/// Blocks of one column, on and below the diagonal, while they are summed.
struct Column<'a, const D: usize> {
    slot: &'a mut Vec<u32>,
    rows: Vec<u32>,
    blocks: Vec<Matrix<D>>,
}

impl<'a, const D: usize> Column<'a, D> {
    /// `slot` holds `u32::MAX` for each row, before and after.
    fn new(node: u32, slot: &'a mut Vec<u32>) -> Self {
        let mut column = Self { slot, rows: Vec::new(), blocks: Vec::new() };
        column.add(node, &[[0.0; D]; D], 0.0);
        column
    }

    fn add(&mut self, row: u32, block: &Matrix<D>, factor: f64) {
        let slot = &mut self.slot[row as usize];
        if *slot == u32::MAX {
            *slot = self.rows.len() as u32;
            self.rows.push(row);
            self.blocks.push([[0.0; D]; D]);
        }
        let sum = &mut self.blocks[*slot as usize];
        (0..D).for_each(|r| (0..D).for_each(|c| sum[r][c] += factor * block[r][c]));
    }

    fn sorted(self) -> Vec<(u32, Matrix<D>)> {
        self.rows.iter().for_each(|&row| self.slot[row as usize] = u32::MAX);
        let mut entries: Vec<(u32, Matrix<D>)> = self.rows.into_iter().zip(self.blocks).collect();
        entries.sort_unstable_by_key(|entry| entry.0);
        entries
    }
}

/// A symmetric matrix of blocks, its lower triangle by columns.
struct Blocks<const D: usize> {
    pattern: BlockPattern,
    block: Vec<Matrix<D>>,
}

impl<const D: usize> Blocks<D> {
    fn of(n: usize, column: impl Fn(&mut Vec<u32>, usize) -> Vec<(u32, Matrix<D>)> + Sync) -> Self {
        let columns: Vec<Vec<(u32, Matrix<D>)>> =
            (0..n).into_par_iter().map_init(|| vec![u32::MAX; n], |slot, node| column(slot, node)).collect();
        let mut pattern = BlockPattern { col_start: vec![0], row: Vec::new() };
        let mut block = Vec::new();
        for entries in columns {
            for (row, entry) in entries {
                pattern.row.push(row);
                block.push(entry);
            }
            pattern.col_start.push(pattern.row.len() as u32);
        }
        Self { pattern, block }
    }

    fn dim(&self) -> usize {
        D * self.pattern.n_nodes()
    }

    /// Null vectors and a few of the weakest others, as `ritz` puts them in order.
    fn weakest(
        &self,
        ritz: impl Fn(Vec<Vec<f64>>) -> Result<Vec<Mode>, LeastSquaresError>,
        null_below: f64,
    ) -> Result<Vec<Mode>, LeastSquaresError> {
        if self.dim() <= COMPLETE {
            return ritz(self.low_eigenvectors()?);
        }
        let solver = self.factorised()?;
        let mut count = FIRST;
        loop {
            let modes = ritz(self.inverse_iteration(&solver, count.min(self.dim()))?)?;
            let null = modes.iter().filter(|mode| mode.value < null_below).count();
            if null + BEYOND <= modes.len() || modes.len() >= MOST.min(self.dim()) {
                return Ok(modes);
            }
            count = (2 * count).min(MOST);
        }
    }

    fn low_eigenvectors(&self) -> Result<Vec<Vec<f64>>, LeastSquaresError> {
        let n = self.dim();
        let mut rows = vec![vec![0.0; n]; n];
        for node in 0..self.pattern.n_nodes() {
            for k in self.pattern.column(node) {
                let row = self.pattern.row[k] as usize;
                for r in 0..D {
                    for c in 0..D {
                        rows[row * D + r][node * D + c] = self.block[k][r][c];
                        rows[node * D + c][row * D + r] = self.block[k][r][c];
                    }
                }
            }
        }
        let (values, mut vectors) = symmetric_eigen_of(&rows)?;
        let limit = PERHAPS_NULL * values.last().copied().unwrap_or(0.0);
        let low = values.iter().take_while(|&&v| v <= limit).count();
        vectors.truncate(low + BEYOND);
        Ok(vectors)
    }

    /// The matrix with the lightest guard that makes it regular.
    fn factorised(&self) -> Result<BlockSolver<D>, LeastSquaresError> {
        let largest = self.block.iter().flatten().flatten().fold(0.0f64, |most, x| most.max(x.abs()));
        let mut solver = BlockSolver::<D>::analyse(&self.pattern, LinearSolver::Direct)?;
        let mut ended = LeastSquaresError::Singular { pivot: 0 };
        for guard in GUARDS {
            match solver.factorise(&self.pattern, &self.values(guard * largest)) {
                Ok(()) => return Ok(solver),
                Err(singular @ LeastSquaresError::Singular { .. }) => ended = singular,
                Err(other) => return Err(other),
            }
        }
        Err(ended)
    }

    /// Lower triangle in the order of the solver, with something added to the diagonal.
    fn values(&self, guard: f64) -> Vec<f64> {
        let n = self.pattern.n_nodes();
        let mut values = vec![0.0; D * D * self.block.len() - n * (D * (D - 1) / 2)];
        for node in 0..n {
            for k in self.pattern.column(node) {
                let diagonal = self.pattern.row[k] as usize == node;
                for c in 0..D {
                    let slot = scalar_slots::<D>(&self.pattern, node, k, c);
                    let first = if diagonal { c } else { 0 };
                    for r in first..D {
                        values[slot + r - first] = self.block[k][r][c] + if diagonal && r == c { guard } else { 0.0 };
                    }
                }
            }
        }
        values
    }

    fn inverse_iteration(&self, solver: &BlockSolver<D>, count: usize) -> Result<Vec<Vec<f64>>, LeastSquaresError> {
        let n = self.dim();
        let start = |a: usize| (0..n).map(|k| scattered(a * n + k)).collect::<Vec<f64>>();
        let mut basis = orthonormal((0..count).map(start).collect(), &[]);
        for _ in 0..ITERATIONS {
            let solved: Result<Vec<Vec<f64>>, LeastSquaresError> = basis
                .into_par_iter()
                .map(|mut x| {
                    solver.solve(&mut x, 1)?;
                    Ok(x)
                })
                .collect();
            basis = orthonormal_all(solved?);
        }
        Ok(basis)
    }
}

/// Orthonormal, with nothing left out but zeros: of vectors that nearly depend on each other, what is new counts.
fn orthonormal_all(vectors: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(vectors.len());
    for mut vector in vectors {
        for _ in 0..3 {
            let length = inner(&vector, &vector).sqrt();
            if length <= f64::MIN_POSITIVE {
                break;
            }
            vector.iter_mut().for_each(|x| *x /= length);
            for other in &basis {
                let along = inner(&vector, other);
                vector.iter_mut().zip(other).for_each(|(x, y)| *x -= along * y);
            }
        }
        let length = inner(&vector, &vector).sqrt();
        if length > 0.5 {
            vector.iter_mut().for_each(|x| *x /= length);
            basis.push(vector);
        }
    }
    basis
}

/// A number between -1 and 1 without pattern, the same on every run.
fn scattered(k: usize) -> f64 {
    let mut z = (k as u64).wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}
