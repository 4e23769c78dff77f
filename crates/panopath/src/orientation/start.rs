//! From nothing to orientations good enough to re-weight from: votes of triangles, then growth by consensus.
//!
//! A true edge closes its triangles, `third_from_first = third_from_second * second_from_first`; a wrong one almost never
//! does. Views are then placed one at a time, always the one whose placed neighbours agree most about where it looks: a
//! spanning tree that sees loops of every length as it grows (after Govindu 2006, who draws trees at random).

use std::collections::BinaryHeap;

use rayon::prelude::*;

use crate::geometry::{Vector, add, norm, scale};

use super::graph::{Graph, Neighbour};
use super::turns::Turn;

/// Triangles looked at for each edge.
const TRIANGLES: usize = 8;
/// Two estimates of one rotation agree where they are nearer than this many standard deviations of their difference.
const AGREEMENT: f64 = 4.0;
/// No two estimates farther apart than this agree, whatever the noise: 15 degrees.
const WIDEST_AGREEMENT: f64 = 0.26;

/// What the start needs of the problem.
pub(super) struct Edges<'a, T> {
    pub graph: &'a Graph,
    /// `second_from_first` of each edge.
    pub relative: &'a [T],
    pub sigma: &'a [f64],
    /// False where something else than loops speaks against an edge already.
    pub credible: &'a [bool],
}

impl<T> Edges<'_, T> {
    fn neighbour_from<const K: usize>(&self, n: &Neighbour) -> T
    where
        T: Turn<K>,
    {
        let relative = self.relative[n.edge as usize];
        if n.is_second { relative } else { relative.inverse() }
    }
}

/// Noise over the stated sigma, judged from triangles: a low quantile, since wrong edges spoil the high ones. `None`
/// where there are too few triangles to say.
pub(super) fn noise_from_triangles<T: Turn<K>, const K: usize>(edges: &Edges<'_, T>) -> Option<f64> {
    let ratios: Vec<Option<f64>> = (0..edges.graph.n_edges())
        .into_par_iter()
        .map(|edge| {
            let mut ratio = None;
            for_triangles(edges, edge, 1, |closure, sigma| ratio = Some(closure / sigma));
            ratio
        })
        .collect();
    let mut ratios: Vec<f64> = ratios.into_iter().flatten().collect();
    if ratios.len() < 20 {
        return None;
    }
    // with 0 to 40 % of the edges wrong, the tenth part lies between the 10 and the 46 % quantile of true triangles
    let tenth = ratios.len() / 10;
    let (_, found, _) = ratios.select_nth_unstable_by(tenth, f64::total_cmp);
    let expected = if K == 3 { 1.19 } else { 0.39 };
    Some(*found / expected)
}

/// Calls `visit(closure error, its sigma)` for up to `most` triangles over an edge.
fn for_triangles<T: Turn<K>, const K: usize>(
    edges: &Edges<'_, T>,
    edge: usize,
    most: usize,
    mut visit: impl FnMut(f64, f64),
) {
    let graph = edges.graph;
    let (a, b) = graph.ends(edge);
    let (mut left, mut right) = (graph.neighbours(a).iter().peekable(), graph.neighbours(b).iter().peekable());
    let mut seen = 0;
    while let (Some(l), Some(r)) = (left.peek(), right.peek()) {
        if l.view < r.view {
            left.next();
        } else if l.view > r.view {
            right.next();
        } else {
            let (third_from_a, third_from_b) = (edges.neighbour_from(l), edges.neighbour_from(r));
            let around = third_from_b.compose(&edges.relative[edge]);
            let sigma = [edge, l.edge as usize, r.edge as usize].iter().map(|&e| edges.sigma[e].powi(2)).sum::<f64>();
            let closure = 2.0 * third_from_a.closeness(&around).min(1.0).sqrt().acos();
            visit(closure, sigma.sqrt());
            seen += 1;
            if seen == most {
                return;
            }
            left.next();
            right.next();
        }
    }
}

/// Trust in each edge: 0 where its triangles fail, 1 where there are none, more for each that closes.
fn trust<T: Turn<K>, const K: usize>(edges: &Edges<'_, T>, noise: f64) -> Vec<u32> {
    (0..edges.graph.n_edges())
        .into_par_iter()
        .map(|edge| {
            if !edges.credible[edge] {
                return 0;
            }
            let (mut closed, mut seen) = (0, 0);
            for_triangles(edges, edge, TRIANGLES, |closure, sigma| {
                seen += 1;
                closed += u32::from(closure < (AGREEMENT * noise * sigma).min(WIDEST_AGREEMENT));
            });
            if seen > 0 && closed == 0 { 0 } else { 1 + closed }
        })
        .collect()
}

/// Where one placed neighbour says that a view looks.
struct Opinion<T> {
    cam_from_world: T,
    /// Squared cosine of half the angle within which another opinion agrees.
    agreement: f64,
    trust: u32,
    /// Own trust and that of all that agree.
    support: u32,
}

/// Grows orientations over the graph; each part of it starts from the identity. `noise` is relative to sigma.
pub(super) fn grow<T: Turn<K>, const K: usize>(edges: &Edges<'_, T>, noise: f64) -> Vec<T> {
    let graph = edges.graph;
    let n = graph.n_views();
    let trust = trust(edges, noise);
    let mut seeds: Vec<(u32, u32)> =
        (0..n).map(|view| (graph.neighbours(view).iter().map(|e| trust[e.edge as usize]).sum(), view as u32)).collect();
    seeds.sort_unstable_by_key(|&(total, view)| (std::cmp::Reverse(total), view));
    let mut found = vec![T::identity(); n];
    let mut placed = vec![false; n];
    let mut opinions: Vec<Vec<Opinion<T>>> = (0..n).map(|_| Vec::new()).collect();
    let mut queue: BinaryHeap<(u32, std::cmp::Reverse<u32>)> = BinaryHeap::new();
    for (_, seed) in seeds {
        if placed[seed as usize] {
            continue;
        }
        queue.push((0, std::cmp::Reverse(seed)));
        while let Some((_, std::cmp::Reverse(view))) = queue.pop() {
            let view = view as usize;
            if placed[view] {
                continue;
            }
            placed[view] = true;
            if let Some(agreed) = consensus(&std::mem::take(&mut opinions[view])) {
                found[view] = agreed;
            }
            for neighbour in graph.neighbours(view).iter().filter(|e| !placed[e.view as usize]) {
                let edge = neighbour.edge as usize;
                let within = (AGREEMENT * noise * edges.sigma[edge] * std::f64::consts::SQRT_2).min(WIDEST_AGREEMENT);
                let opinion = Opinion {
                    cam_from_world: edges.neighbour_from(neighbour).compose(&found[view]),
                    agreement: (0.5 * within).cos().powi(2),
                    trust: trust[edge],
                    support: trust[edge],
                };
                let support = hear(&mut opinions[neighbour.view as usize], opinion);
                queue.push((support, std::cmp::Reverse(neighbour.view)));
            }
        }
    }
    found
}

/// Adds an opinion to the others about a view; the best support now.
fn hear<T: Turn<K>, const K: usize>(others: &mut Vec<Opinion<T>>, mut new: Opinion<T>) -> u32 {
    let mut best = 0;
    for other in others.iter_mut() {
        if other.cam_from_world.closeness(&new.cam_from_world) >= other.agreement.min(new.agreement) {
            other.support += new.trust;
            new.support += other.trust;
        }
        best = best.max(other.support);
    }
    best = best.max(new.support);
    others.push(new);
    best
}

/// Mean of the opinions that agree with the best supported one.
fn consensus<T: Turn<K>, const K: usize>(opinions: &[Opinion<T>]) -> Option<T> {
    let best = opinions.iter().reduce(|a, b| if b.support > a.support { b } else { a })?;
    let (mut sum, mut total): (Vector<K>, f64) = ([0.0; K], 0.0);
    for other in opinions {
        if other.trust > 0
            && other.cam_from_world.closeness(&best.cam_from_world) >= other.agreement.min(best.agreement)
        {
            let off = best.cam_from_world.inverse().compose(&other.cam_from_world).log();
            debug_assert!(norm(&off).is_finite());
            sum = add(&sum, &scale(f64::from(other.trust), &off));
            total += f64::from(other.trust);
        }
    }
    Some(if total > 0.0 {
        best.cam_from_world.compose(&T::exp(&scale(1.0 / total, &sum)))
    } else {
        best.cam_from_world
    })
}
