//! Orientations of a graph: start, re-weighting, and least squares over the edges that agree.
//!
//! The residual of an edge is `rho = log((second_from_first R_first)^-1 R_second)`, a rotation vector in the world. Its
//! squared length has the gradients `rho` by `w_second` and `-rho` by `w_first`, exactly, since a rotation vector is its own
//! eigenvector under the Jacobian of the logarithm. Taking the identity for that Jacobian in the matrix too leaves the
//! minimum where it is, makes the matrix a graph Laplacian (`system.rs`), and costs a convergence rate of `|rho|^2 / 12`.

use rayon::prelude::*;

use crate::geometry::{Matrix, Vector, norm};
use crate::least_squares::{LeastSquaresError, LinearSolver};

use super::graph::Graph;
use super::start::{Edges, grow, noise_from_triangles};
use super::system::{Coupling, Pin, System, Values, add_matrix, pins};
use super::turns::{Pull, Role, Turn};

/// What there is to average.
pub(super) struct Problem<'a, T: Turn<K>, const K: usize> {
    pub edges: Edges<'a, T>,
    /// What is known of single views.
    pub priors: Vec<(u32, T::Prior)>,
    pub linear: LinearSolver,
    pub max_iterations: usize,
    /// Are the sigmas of the edges only ratios?
    pub estimate_noise: bool,
    pub covariance: bool,
}

/// What was found.
pub(super) struct Average<T, const K: usize> {
    pub cam_from_world: Vec<T>,
    /// Part of each view, named by its lowest view.
    pub part: Vec<u32>,
    pub inlier: Vec<bool>,
    /// Noise over stated sigma; NaN where no loop tells.
    pub noise: f64,
    pub iterations: usize,
    pub converged: bool,
    /// Covariance of each view's turn in the world.
    pub covariance: Option<Vec<Matrix<K>>>,
}

/// Rounds of the L1-like weights (Chatterjee and Govindu 2013 begin with L1 too: it needs no good start).
const L1_ROUNDS: usize = 5;
/// Widths of the Geman-McClure weights in standard deviations, one a round; the last is kept.
const WIDTHS: [f64; 3] = [8.0, 6.0, 4.0];
/// Weights are kept above this, or what hangs by outliers alone would make the matrix singular.
const LEAST_WEIGHT: f64 = 1e-8;
/// Rounds of choosing inliers and fitting them.
const MASK_ROUNDS: usize = 8;
/// How much wider the first choice of inliers is.
const SECOND_CHANCE: f64 = 1.6;
/// Steps shorter than this end a least-squares fit, radians.
const LAST_STEP: f64 = 1e-11;
/// Noise is estimated within these bounds: relative to sigma below, in radians above (10 degrees).
const LEAST_NOISE: f64 = 1e-3;
const MOST_NOISE_RAD: f64 = 0.175;
/// With fewer independent loops the stated noise is taken.
const LEAST_LOOPS: usize = 20;

/// Median of the length of a residual over its standard deviation per axis (chi with `K` freedoms).
fn median_of_chi(freedoms: usize) -> f64 {
    if freedoms == 3 { 1.538 } else { 0.6745 }
}

/// Residuals beyond this many standard deviations are outliers: one good edge in 5,000 (space) or 16,000 (plane).
pub(super) fn cut(freedoms: usize) -> f64 {
    if freedoms == 3 { 4.5 } else { 4.0 }
}

/// Averages rotations.
pub(super) fn average<T: Turn<K>, const K: usize>(
    problem: &Problem<'_, T, K>,
) -> Result<Average<T, K>, LeastSquaresError> {
    let noise = noise_from_triangles(&problem.edges).unwrap_or(1.0);
    let coupling = Coupling::of(problem.priors.iter().map(|(_, prior)| T::role(prior)));
    let mut state = State {
        problem,
        system: System::analyse(problem.edges.graph, coupling, problem.linear)?,
        coupling,
        noise: problem.bounded(noise),
        found: Vec::new(),
        rho: Vec::new(),
        ratio: Vec::new(),
        iterations: 0,
    };
    state.found = grow(&problem.edges, state.noise);
    let everything = vec![true; problem.edges.graph.n_edges()];
    let joined = Parts::new(problem, &everything);
    state.align(&joined);
    state.measure();
    state.reweight(&joined)?;
    state.refit()
}

impl<T: Turn<K>, const K: usize> Problem<'_, T, K> {
    /// A noise factor within what is believed.
    fn bounded(&self, noise: f64) -> f64 {
        let mut sigma: Vec<f64> = self.edges.sigma.to_vec();
        let least = if self.estimate_noise { LEAST_NOISE } else { 1.0 };
        let most = (MOST_NOISE_RAD / median(&mut sigma).unwrap_or(1.0)).max(1.0);
        if noise.is_finite() { noise.clamp(least, most) } else { 1.0 }
    }
}

/// What hangs together along the kept edges, and which priors count there.
struct Parts<T: Turn<K>, const K: usize> {
    part: Vec<u32>,
    priors: Vec<(u32, T::Prior)>,
}

impl<T: Turn<K>, const K: usize> Parts<T, K> {
    /// A heading is measured about the vertical: it says nothing in a part whose vertical nobody knows.
    fn new(problem: &Problem<'_, T, K>, keep: &[bool]) -> Self {
        let part = problem.edges.graph.parts(keep);
        let mut has_up = vec![false; part.len()];
        for (view, prior) in &problem.priors {
            has_up[part[*view as usize] as usize] |= T::role(prior) != Role::Heading;
        }
        let counts = |view: u32| has_up[part[view as usize] as usize];
        let priors = problem.priors.iter().filter(|(view, _)| counts(*view)).copied().collect();
        Self { part, priors }
    }
}

/// The orientations on their way, and how well the edges agree with them.
struct State<'a, T: Turn<K>, const K: usize> {
    problem: &'a Problem<'a, T, K>,
    system: System<K>,
    coupling: Coupling,
    found: Vec<T>,
    rho: Vec<Vector<K>>,
    /// Length of `rho` over sigma.
    ratio: Vec<f64>,
    /// Noise over stated sigma, as judged so far.
    noise: f64,
    iterations: usize,
}

impl<T: Turn<K>, const K: usize> State<'_, T, K> {
    fn graph(&self) -> &Graph {
        self.problem.edges.graph
    }

    /// Turns whole parts to where their priors want them.
    fn align(&mut self, parts: &Parts<T, K>) {
        let mut known: Vec<Vec<(T, T::Prior)>> = vec![Vec::new(); parts.part.len()];
        for (view, prior) in &parts.priors {
            known[parts.part[*view as usize] as usize].push((self.found[*view as usize], *prior));
        }
        let turn: Vec<Option<T>> = known.iter().map(|k| (!k.is_empty()).then(|| T::alignment(k))).collect();
        for (found, part) in self.found.iter_mut().zip(&parts.part) {
            if let Some(turn) = &turn[*part as usize] {
                *found = found.compose(turn);
            }
        }
    }

    /// Residuals of all edges.
    fn measure(&mut self) {
        let Edges { graph, relative, sigma, .. } = &self.problem.edges;
        let found = &self.found;
        (self.rho, self.ratio) = (0..graph.n_edges())
            .into_par_iter()
            .with_min_len(1024)
            .map(|edge| {
                let (a, b) = graph.ends(edge);
                let rho = residual(&relative[edge], &found[a], &found[b]);
                (rho, norm(&rho) / sigma[edge])
            })
            .unzip();
    }

    /// Median noise of the edges within `limit` standard deviations, corrected for what the fit took away.
    fn judge_noise(&mut self, limit: f64, parts: &[u32]) {
        let mut near: Vec<f64> = self.ratio.iter().copied().filter(|r| *r <= limit * self.noise).collect();
        let n_parts = parts.iter().enumerate().filter(|(view, part)| *view == **part as usize).count();
        let loops = (near.len() + n_parts).saturating_sub(parts.len());
        if loops >= LEAST_LOOPS
            && let Some(middle) = {
                let n = near.len() as f64;
                let lost = (n / loops as f64).sqrt().min(3.0);
                median(&mut near).map(|m| m * lost)
            }
        {
            self.noise = self.problem.bounded(middle / median_of_chi(K));
        }
    }

    /// Weight of an edge that counts fully.
    fn full_weight(&self, edge: usize) -> f64 {
        let noise = if self.problem.estimate_noise { self.noise } else { 1.0 };
        (noise * self.problem.edges.sigma[edge]).powi(-2)
    }

    fn pulls(&self, parts: &Parts<T, K>) -> Vec<(u32, Pull<K>)> {
        parts.priors.iter().map(|(view, prior)| (*view, self.found[*view as usize].pull(prior))).collect()
    }

    fn factorise(
        &mut self,
        weight: &[f64],
        parts: &Parts<T, K>,
        pulls: &[(u32, Pull<K>)],
    ) -> Result<Vec<Pin<K>>, LeastSquaresError> {
        let pins = pins(self.problem.edges.graph, &parts.part, weight, pulls, self.coupling)?;
        let values = Values { weight, pulls, pins: &pins };
        self.system.factorise(self.problem.edges.graph, &values)?;
        Ok(pins)
    }

    /// One step with the matrix factorised last; the longest turn in it.
    fn step(&mut self, weight: &[f64], pulls: &[(u32, Pull<K>)]) -> Result<f64, LeastSquaresError> {
        let mut turn = forces(self.graph(), weight, &self.rho, pulls);
        self.system.solve(&mut turn)?;
        for (found, w) in self.found.iter_mut().zip(&turn) {
            *found = found.compose(&T::exp(w));
        }
        self.iterations += 1;
        self.measure();
        Ok(turn.iter().map(norm).fold(0.0, f64::max))
    }

    /// Re-weighted steps until they are short against the noise: first L1-like weights, then Geman-McClure's.
    fn reweight(&mut self, joined: &Parts<T, K>) -> Result<(), LeastSquaresError> {
        for round in 0..self.problem.max_iterations {
            let limit = if round < L1_ROUNDS { f64::INFINITY } else { cut(K) };
            self.judge_noise(limit, &joined.part);
            let weight: Vec<f64> = (0..self.graph().n_edges())
                .map(|edge| {
                    let x = self.ratio[edge] / self.noise;
                    let robust = match round.checked_sub(L1_ROUNDS) {
                        None => 1.0 / x.max(1.0),
                        Some(k) => (1.0 + (x / WIDTHS[k.min(WIDTHS.len() - 1)]).powi(2)).powi(-2),
                    };
                    robust.max(LEAST_WEIGHT) * self.full_weight(edge)
                })
                .collect();
            let pulls = self.pulls(joined);
            self.factorise(&weight, joined, &pulls)?;
            let longest = self.step(&weight, &pulls)?;
            if longest < LAST_STEP || round >= L1_ROUNDS + WIDTHS.len() && longest < 0.05 * self.typical_sigma() {
                break;
            }
        }
        Ok(())
    }

    fn typical_sigma(&self) -> f64 {
        self.noise * median(&mut self.problem.edges.sigma.to_vec()).unwrap_or(0.0)
    }

    /// Least squares over the edges that agree, until the choice of edges rests.
    fn refit(mut self) -> Result<Average<T, K>, LeastSquaresError> {
        let mut banned = vec![false; self.graph().n_edges()];
        let mut chosen: Option<(Vec<bool>, Parts<T, K>)> = None;
        let mut converged = true;
        for round in 0..MASK_ROUNDS {
            let inlier = self.agreeing(round, &mut banned);
            if chosen.as_ref().is_some_and(|(before, _)| *before == inlier) {
                break;
            }
            let parts = Parts::new(self.problem, &inlier);
            if chosen.as_ref().is_none_or(|(_, before)| before.part != parts.part) {
                self.align(&parts);
                self.measure();
            }
            converged = self.least_squares(&inlier, &parts)?;
            self.judge_noise(cut(K), &parts.part);
            chosen = Some((inlier, parts));
        }
        let (inlier, parts) = chosen.unwrap_or_else(|| {
            let none = vec![false; self.graph().n_edges()];
            let alone = Parts::new(self.problem, &none);
            (none, alone)
        });
        self.finish(inlier, parts, converged)
    }

    /// Edges within the limit for outliers, but for bridges that are contested: those are banned for good.
    fn agreeing(&self, round: usize, banned: &mut [bool]) -> Vec<bool> {
        // an edge that re-weighting left aside gets the chance to pull: without it, its residual is larger
        let limit = cut(K) * self.noise * if round == 0 { SECOND_CHANCE } else { 1.0 };
        let mut agree: Vec<bool> = self.ratio.iter().zip(&*banned).map(|(r, b)| *r <= limit && !b).collect();
        for edge in self.graph().contested_bridges(&agree) {
            (agree[edge], banned[edge]) = (false, true);
        }
        agree
    }

    fn weights(&self, inlier: &[bool]) -> Vec<f64> {
        (0..inlier.len()).map(|edge| if inlier[edge] { self.full_weight(edge) } else { 0.0 }).collect()
    }

    /// Gauss-Newton with fixed weights; whether the steps died out. Only coupled priors change the matrix on the way.
    fn least_squares(&mut self, inlier: &[bool], parts: &Parts<T, K>) -> Result<bool, LeastSquaresError> {
        let weight = self.weights(inlier);
        let mut before = f64::INFINITY;
        for round in 0..self.problem.max_iterations {
            let pulls = self.pulls(parts);
            if round == 0 || self.coupling == Coupling::Full {
                self.factorise(&weight, parts, &pulls)?;
            }
            let longest = self.step(&weight, &pulls)?;
            if longest < LAST_STEP || (longest < 1e-7 && longest > 0.3 * before) {
                return Ok(true);
            }
            before = longest;
        }
        Ok(before < 1e-3 * self.typical_sigma())
    }

    fn finish(
        mut self,
        inlier: Vec<bool>,
        parts: Parts<T, K>,
        converged: bool,
    ) -> Result<Average<T, K>, LeastSquaresError> {
        let covariance = if self.problem.covariance { Some(self.covariance(&inlier, &parts)?) } else { None };
        let n_parts = parts.part.iter().enumerate().filter(|(view, part)| *view == **part as usize).count();
        let used: Vec<f64> = self.ratio.iter().zip(&inlier).filter(|(_, kept)| **kept).map(|(r, _)| *r).collect();
        let freedoms = K * (used.len() + n_parts).saturating_sub(parts.part.len());
        let squares: f64 = used.iter().map(|r| r * r).sum();
        Ok(Average {
            cam_from_world: self.found,
            part: parts.part,
            inlier,
            noise: if freedoms > 0 { (squares / freedoms as f64).sqrt() } else { f64::NAN },
            iterations: self.iterations,
            converged,
            covariance,
        })
    }

    /// Blocks of the inverse matrix, less what the pins put in.
    fn covariance(&mut self, inlier: &[bool], parts: &Parts<T, K>) -> Result<Vec<Matrix<K>>, LeastSquaresError> {
        let weight = self.weights(inlier);
        let pulls = self.pulls(parts);
        let pins = self.factorise(&weight, parts, &pulls)?;
        let mut blocks = self.system.inverse_blocks(self.graph().n_views())?;
        for pin in &pins {
            let free = std::array::from_fn(|r| std::array::from_fn(|c| pin.direction[r] * pin.direction[c]));
            for (block, _) in blocks.iter_mut().zip(&parts.part).filter(|(_, part)| **part == pin.view) {
                add_matrix(block, &free, -1.0 / pin.strength);
            }
        }
        Ok(blocks)
    }
}

/// `log((second_from_first R_first)^-1 R_second)`.
pub(super) fn residual<T: Turn<K>, const K: usize>(second_from_first: &T, first: &T, second: &T) -> Vector<K> {
    second_from_first.compose(first).inverse().compose(second).log()
}

/// Right-hand side: what residuals and priors ask of each view, edge by edge in order.
fn forces<const K: usize>(
    graph: &Graph,
    weight: &[f64],
    rho: &[Vector<K>],
    pulls: &[(u32, Pull<K>)],
) -> Vec<Vector<K>> {
    let mut force = vec![[0.0; K]; graph.n_views()];
    for edge in 0..graph.n_edges() {
        let (a, b) = graph.ends(edge);
        for k in 0..K {
            force[a][k] += weight[edge] * rho[edge][k];
            force[b][k] -= weight[edge] * rho[edge][k];
        }
    }
    for (view, pull) in pulls {
        for k in 0..K {
            force[*view as usize][k] += pull.force[k];
        }
    }
    force
}

pub(super) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
