//! Headings of all views from differences between some: rotation averaging in the plane.
//!
//! An edge says `h_to - h_from = turn`, give or take `sigma`. Sought are headings that minimise `sum rho(r_e / sigma_e)` with the wrapped
//! residual `r_e = wrap(h_to - h_from - turn_e)`. Repeated edges of one pair vote first; a spanning tree of the best
//! supported pairs gives a start without windings to guess; re-weighted linear least squares do the rest.

use std::collections::BTreeMap;

use super::complex::wrapped;
use crate::least_squares::{BlockPattern, BlockSolver, LeastSquaresError, LinearSolver};
use crate::sets::Sets;

/// `h_to - h_from = turn`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    pub from: u32,
    pub to: u32,
    pub turn: f64,
    pub sigma: f64,
}

/// Headings with the component that each belongs to, -1 where there is no edge to be trusted.
pub(super) struct Averaged {
    pub heading: Vec<f64>,
    pub component: Vec<i32>,
}

/// Residuals beyond this many standard deviations (of what is usual among the edges) are contradictions.
const CONTRADICTION: f64 = 4.0;

/// Averages the edges over `n` views.
pub(super) fn average_headings(n: usize, edges: &[Edge]) -> Result<Averaged, LeastSquaresError> {
    let pairs = merged(edges);
    let mut heading = along_the_tree(n, &pairs);
    let pairs: Vec<Edge> = pairs.into_iter().map(|pair| pair.edge).collect();
    let scale = descend(&mut heading, &pairs)?;
    let agree = |edge: &&Edge| residual(&heading, edge).abs() < CONTRADICTION * scale * edge.sigma;
    let component = components(n, pairs.iter().filter(agree));
    Ok(Averaged { heading, component })
}

fn residual(heading: &[f64], edge: &Edge) -> f64 {
    wrapped(heading[edge.to as usize] - heading[edge.from as usize] - edge.turn)
}

/// All edges of one pair made one, and how many more agreed with it than did not.
struct Pair {
    edge: Edge,
    votes: i64,
}

fn merged(edges: &[Edge]) -> Vec<Pair> {
    let mut by_pair: BTreeMap<(u32, u32), Vec<(f64, f64)>> = BTreeMap::new();
    for edge in edges {
        let (key, turn) =
            if edge.from < edge.to { ((edge.from, edge.to), edge.turn) } else { ((edge.to, edge.from), -edge.turn) };
        by_pair.entry(key).or_default().push((turn, edge.sigma));
    }
    let merge = |((from, to), turns): ((u32, u32), Vec<(f64, f64)>)| {
        let near = |a: &(f64, f64), b: &(f64, f64)| wrapped(a.0 - b.0).abs() < CONTRADICTION * a.1.hypot(b.1);
        let support = |a: &(f64, f64)| turns.iter().filter(|b| near(a, b)).map(|b| b.1.powi(-2)).sum::<f64>();
        let best = turns.iter().fold((f64::NEG_INFINITY, turns[0]), |best, a| {
            let own = support(a);
            if own > best.0 { (own, *a) } else { best }
        });
        let (mut weight, mut sum, mut votes) = (0.0, 0.0, 0);
        for b in &turns {
            let agrees = near(&best.1, b);
            votes += if agrees { 1 } else { -1 };
            if agrees {
                weight += b.1.powi(-2);
                sum += b.1.powi(-2) * wrapped(b.0 - best.1.0);
            }
        }
        Pair { edge: Edge { from, to, turn: best.1.0 + sum / weight, sigma: weight.powf(-0.5) }, votes }
    };
    by_pair.into_iter().map(merge).collect()
}

/// Headings along a spanning tree (forest) of the pairs with most votes, the more certain first among equals.
fn along_the_tree(n: usize, pairs: &[Pair]) -> Vec<f64> {
    let mut order: Vec<&Pair> = pairs.iter().collect();
    order.sort_by(|a, b| b.votes.cmp(&a.votes).then(a.edge.sigma.total_cmp(&b.edge.sigma)));
    let mut forest = Sets::new(n);
    let mut neighbours: Vec<Vec<(u32, f64)>> = vec![Vec::new(); n];
    for Pair { edge, .. } in order {
        if forest.join(edge.from as usize, edge.to as usize) {
            neighbours[edge.from as usize].push((edge.to, edge.turn));
            neighbours[edge.to as usize].push((edge.from, -edge.turn));
        }
    }
    let mut heading = vec![f64::NAN; n];
    for root in 0..n {
        if !heading[root].is_nan() {
            continue;
        }
        heading[root] = 0.0;
        let mut stack = vec![root as u32];
        while let Some(view) = stack.pop() {
            for &(next, turn) in &neighbours[view as usize] {
                if heading[next as usize].is_nan() {
                    heading[next as usize] = wrapped(heading[view as usize] + turn);
                    stack.push(next);
                }
            }
        }
    }
    heading
}

/// Re-weighted least squares; the median of `|r| / sigma` as a standard deviation.
fn descend(heading: &mut [f64], edges: &[Edge]) -> Result<f64, LeastSquaresError> {
    const ROUNDS: usize = 30;
    if edges.is_empty() {
        return Ok(1.0);
    }
    let pattern = pattern(heading.len(), edges);
    let mut solver = BlockSolver::<1>::analyse(&pattern, LinearSolver::Auto)?;
    let mut scale = 1.0;
    for round in 0..ROUNDS {
        let residuals: Vec<f64> = edges.iter().map(|edge| residual(heading, edge)).collect();
        scale = typical(edges, &residuals);
        let weight = |edge: &Edge, r: f64| {
            let reduced = r / (scale * edge.sigma);
            let factor = if round < ROUNDS / 3 {
                1.0 / reduced.abs().max(1.0)
            } else {
                (1.0 + (reduced / CONTRADICTION).powi(2)).powi(-2)
            };
            factor / (edge.sigma * edge.sigma)
        };
        let weights: Vec<f64> = edges.iter().zip(&residuals).map(|(edge, r)| weight(edge, *r)).collect();
        let (values, mut step) = normal_equations(&pattern, edges, &weights, &residuals);
        solver.factorise(&pattern, &values)?;
        solver.solve(&mut step, 1)?;
        for (h, s) in heading.iter_mut().zip(&step) {
            *h = wrapped(*h + s);
        }
        if round > ROUNDS / 3 && step.iter().all(|s| s.abs() < 1e-12) {
            break;
        }
    }
    Ok(scale)
}

/// Median of `|r| / sigma` over its value for normal noise, at least the rounding.
fn typical(edges: &[Edge], residuals: &[f64]) -> f64 {
    let mut reduced: Vec<f64> = edges.iter().zip(residuals).map(|(edge, r)| r.abs() / edge.sigma).collect();
    let middle = reduced.len() / 2;
    (*reduced.select_nth_unstable_by(middle, f64::total_cmp).1 / 0.6745).max(1.0)
}

/// Edges as the lower triangle of a matrix; edges are sorted by pair and each pair occurs once.
fn pattern(n: usize, edges: &[Edge]) -> BlockPattern {
    let mut col_start = Vec::with_capacity(n + 1);
    let mut row = Vec::with_capacity(n + edges.len());
    let mut next = edges.iter().peekable();
    for column in 0..n as u32 {
        col_start.push(row.len() as u32);
        row.push(column);
        while let Some(edge) = next.next_if(|edge| edge.from == column) {
            row.push(edge.to);
        }
    }
    col_start.push(row.len() as u32);
    BlockPattern { col_start, row }
}

/// Weighted graph Laplacian, made definite by a trace of damping, and the right-hand side.
fn normal_equations(
    pattern: &BlockPattern,
    edges: &[Edge],
    weights: &[f64],
    residuals: &[f64],
) -> (Vec<f64>, Vec<f64>) {
    let mut values = vec![0.0; pattern.row.len()];
    let mut right = vec![0.0; pattern.n_nodes()];
    let damping = 1e-10 * weights.iter().fold(0.0, |a: f64, w| a.max(*w));
    for column in 0..pattern.n_nodes() {
        values[pattern.col_start[column] as usize] = damping.max(f64::MIN_POSITIVE);
    }
    for (k, (edge, (w, r))) in edges.iter().zip(weights.iter().zip(residuals)).enumerate() {
        let (from, to) = (edge.from as usize, edge.to as usize);
        values[pattern.col_start[from] as usize] += w;
        values[pattern.col_start[to] as usize] += w;
        // columns before this one and this one have a diagonal entry each
        values[k + from + 1] = -w;
        right[from] += w * r;
        right[to] -= w * r;
    }
    (values, right)
}

/// Components of a graph, 0 the largest; -1 for what no edge touches.
pub(super) fn components<'a>(n: usize, edges: impl Iterator<Item = &'a Edge>) -> Vec<i32> {
    let mut forest = Sets::new(n);
    for edge in edges {
        forest.join(edge.from as usize, edge.to as usize);
    }
    let root: Vec<usize> = (0..n).map(|view| forest.find(view)).collect();
    let mut size = vec![0usize; n];
    for &r in &root {
        size[r] += 1;
    }
    let mut roots: Vec<usize> = (0..n).filter(|&r| size[r] > 1).collect();
    roots.sort_by_key(|&r| std::cmp::Reverse(size[r]));
    let mut label = vec![-1; n];
    for (component, &r) in (0..).zip(&roots) {
        label[r] = component;
    }
    root.iter().map(|&r| label[r]).collect()
}
