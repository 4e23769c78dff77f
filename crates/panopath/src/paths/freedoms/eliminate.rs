//! One track, its cameras held: which of its paths the rays tell apart.
//!
//! Its functions are made orthonormal over the times at which it was seen, so that nothing depends on how they are written:
//! `dx_a = sum_f q_af z_f`, `|z|^2 = sum_a |dx_a|^2`, `dp = back z`. The rays resist `M z`, rows `gain_a P_a q_af`; its singular
//! values are angles a length.

use super::part::Part;
use crate::geometry::{Vector, dot, sub, tangent_basis};
use crate::least_squares::{right_singular, symmetric_eigen};

/// Functions whose values over all times are below this share of the largest were not seen.
const UNSEEN: f64 = 1e-9;
/// Ratio of eigenvalues beyond which three numbers are looked at closely.
const SUSPICIOUS: f64 = 1e6;

pub(super) struct Eliminated {
    /// Functions that were seen.
    pub k: usize,
    /// Their values, observation by observation.
    pub q: Vec<f64>,
    /// `K x k`, row by row.
    pub back: Vec<f64>,
    /// Combinations of the `K` functions that are zero whenever the track was seen.
    pub unseen: Vec<Vec<f64>>,
    /// Singular values of `M`, largest first, and their vectors, function by function.
    pub values: Vec<f64>,
    pub vectors: Vec<Vec<f64>>,
    /// How many of them are not null.
    pub rank: usize,
}

impl Eliminated {
    pub fn new<const D: usize>(part: &Part<D>, j: usize, null_below: f64) -> Self {
        let all = part.n_functions(j);
        let observations = part.observations(j);
        if all == 1 {
            return Self::at_rest(part, j, null_below);
        }
        let (sizes, mixes) = right_singular(all, &part.functions[j]).unwrap_or_default();
        let k = sizes.iter().take_while(|&&s| s > UNSEEN * sizes[0]).count();
        let mut back = vec![0.0; all * k];
        for f in 0..k {
            (0..all).for_each(|l| back[l * k + f] = mixes[f][l] / sizes[f]);
        }
        let row = |values: &[f64], f: usize| values.iter().enumerate().map(|(l, b)| b * back[l * k + f]).sum::<f64>();
        let q: Vec<f64> =
            part.functions[j].chunks_exact(all).flat_map(|values| (0..k).map(move |f| row(values, f))).collect();
        let mut entries = Vec::with_capacity(observations.len() * (D - 1) * k * D);
        for (o, q) in observations.clone().zip(q.chunks_exact(k.max(1))) {
            for tangent in &tangent_basis(&part.ray[o])[..D - 1] {
                entries.extend(q.iter().flat_map(|q| tangent.iter().map(move |t| part.gain[o] * q * t)));
            }
        }
        let (values, vectors) = right_singular(k * D, &entries).unwrap_or_default();
        let limit = null_below / typical_length(part, j);
        let rank = values.iter().take_while(|&&s| s > limit).count();
        Self { k, q, back, unseen: mixes[k..].to_vec(), values, vectors, rank }
    }

    /// A point at rest, without the machinery.
    fn at_rest<const D: usize>(part: &Part<D>, j: usize, null_below: f64) -> Self {
        let observations = part.observations(j);
        let q = 1.0 / (observations.len() as f64).sqrt();
        let mut sum = [[0.0; D]; D];
        for o in observations.clone() {
            let one = part.resistance(o);
            (0..D).for_each(|r| (0..D).for_each(|c| sum[r][c] += q * q * one[r][c]));
        }
        let (squares, vectors) = symmetric_eigen(&sum).unwrap_or(([0.0; D], [[0.0; D]; D]));
        let mut values: Vec<f64> = squares.iter().rev().map(|s| s.max(0.0).sqrt()).collect();
        let mut vectors: Vec<Vec<f64>> = vectors.iter().rev().map(|v| v.to_vec()).collect();
        if squares[0] * SUSPICIOUS < squares[D - 1] {
            // squares lose half of the digits
            let rows = observations.clone().flat_map(|o| {
                let tangents = tangent_basis(&part.ray[o]);
                let gain = part.gain[o] * q;
                (0..(D - 1) * D).map(move |n| gain * tangents[n / D][n % D])
            });
            (values, vectors) = right_singular(D, &rows.collect::<Vec<f64>>()).unwrap_or((values, vectors));
        }
        let limit = null_below / typical_length(part, j);
        let rank = values.iter().take_while(|&&s| s > limit).count();
        Self { k: 1, q: vec![q; observations.len()], back: vec![q], unseen: Vec::new(), values, vectors, rank }
    }

    /// Null vectors of the track by itself.
    pub fn loose<const D: usize>(&self) -> usize {
        self.vectors.len() - self.rank + D * self.unseen.len()
    }

    /// Displacement of the path at its observation `a`.
    #[inline]
    pub fn shift<const D: usize>(&self, z: &[f64], a: usize) -> Vector<D> {
        let mut sum = [0.0; D];
        for (q, z) in self.q[a * self.k..(a + 1) * self.k].iter().zip(z.as_chunks::<D>().0) {
            (0..D).for_each(|c| sum[c] += q * z[c]);
        }
        sum
    }

    /// The shortest displacement that follows those of the views best.
    pub fn follow<const D: usize>(&self, part: &Part<D>, j: usize, views: &[f64]) -> Vec<f64> {
        let mut z = vec![0.0; self.k * D];
        // the second time takes off what rounding left
        for _ in 0..2 {
            let mut pull = vec![0.0; self.k * D];
            for (a, o) in part.observations(j).enumerate() {
                let node = part.node[o] as usize;
                let mut own = [0.0; D];
                own.copy_from_slice(&views[node * D..node * D + D]);
                let force = part.resist(o, &sub(&own, &self.shift::<D>(&z, a)));
                for f in 0..self.k {
                    (0..D).for_each(|c| pull[f * D + c] += self.q[a * self.k + f] * force[c]);
                }
            }
            for (value, vector) in self.values.iter().zip(&self.vectors).take(self.rank) {
                let along: f64 = vector.iter().zip(&pull).map(|(v, p)| v * p).sum::<f64>() / (value * value);
                z.iter_mut().zip(vector).for_each(|(z, v)| *z += along * v);
            }
        }
        z
    }

    /// The part of numbers over the observations that the functions cannot express.
    pub fn beyond<const D: usize>(&self, x: &[Vector<D>]) -> Vec<Vector<D>> {
        let mut z = vec![0.0; self.k * D];
        for (a, x) in x.iter().enumerate() {
            for f in 0..self.k {
                (0..D).for_each(|c| z[f * D + c] += self.q[a * self.k + f] * x[c]);
            }
        }
        x.iter().enumerate().map(|(a, x)| sub(x, &self.shift::<D>(&z, a))).collect()
    }

    /// Coefficients of a displacement.
    pub fn coefficients<const D: usize>(&self, z: &[f64]) -> Vec<Vector<D>> {
        if self.k == 0 {
            return Vec::new();
        }
        let z = z.as_chunks::<D>().0;
        let combined = |row: &[f64]| std::array::from_fn(|c| row.iter().zip(z).map(|(b, z)| b * z[c]).sum());
        self.back.chunks_exact(self.k).map(combined).collect()
    }
}

/// Rms length of the segments of a track.
pub(super) fn typical_length<const D: usize>(part: &Part<D>, j: usize) -> f64 {
    let observations = part.observations(j);
    let n = observations.len() as f64;
    (observations.map(|o| part.length[o] * part.length[o]).sum::<f64>() / n).sqrt()
}

/// How a displacement of both ends stretches a segment.
#[inline]
pub(super) fn stretch<const D: usize>(part: &Part<D>, o: usize, across: &Vector<D>) -> f64 {
    dot(&part.ray[o], across) / part.length[o]
}
