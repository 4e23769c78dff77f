//! From nothing to orientations good enough to re-weight from: votes of small loops, then growth by consensus.
//!
//! A true edge closes its triangles, `third_from_first = third_from_second * second_from_first`, and its quadrangles; a
//! wrong one almost never does. Views are then placed one at a time, always the one whose placed neighbours agree most about where it looks: a
//! spanning tree that sees loops of every length as it grows (after Govindu 2006, who draws trees at random).

use std::collections::BinaryHeap;

use rayon::prelude::*;

use crate::geometry::{Vector, add, scale};

use super::graph::{Graph, Neighbour};
use super::turns::Turn;

/// Loops of one kind looked at for each edge.
const LOOPS: usize = 8;
/// An edge none of whose loops closes is doubted from this many on.
const LOOPS_TO_DOUBT: usize = 5;
/// Pairs of neighbours tried as sides of loops of four.
const QUADRANGLES_TRIED: usize = 64;
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
            visit(closure(&third_from_a, &around), sigma.sqrt());
            seen += 1;
            if seen == most {
                return;
            }
            left.next();
            right.next();
        }
    }
}

/// Calls `visit(closure error, its sigma)` for up to [`LOOPS`] loops of four over an edge, as in grids.
fn for_quadrangles<T: Turn<K>, const K: usize>(edges: &Edges<'_, T>, edge: usize, mut visit: impl FnMut(f64, f64)) {
    let graph = edges.graph;
    let (a, b) = graph.ends(edge);
    let (left, right) = (graph.neighbours(a), graph.neighbours(b));
    let sides = left.iter().flat_map(|l| right.iter().map(move |r| (l, r)));
    let mut seen = 0;
    for (l, r) in sides.filter(|(l, r)| l.view as usize != b && r.view as usize != a).take(QUADRANGLES_TRIED) {
        let beyond = graph.neighbours(l.view as usize);
        let Ok(k) = beyond.binary_search_by_key(&r.view, |n| n.view) else { continue };
        let over_a = edges.neighbour_from(&beyond[k]).compose(&edges.neighbour_from(l));
        let over_b = edges.neighbour_from(r).compose(&edges.relative[edge]);
        let around = [edge, l.edge as usize, r.edge as usize, beyond[k].edge as usize];
        visit(closure(&over_a, &over_b), around.iter().map(|&e| edges.sigma[e].powi(2)).sum::<f64>().sqrt());
        seen += 1;
        if seen == LOOPS {
            return;
        }
    }
}

fn closure<T: Turn<K>, const K: usize>(one_way: &T, other_way: &T) -> f64 {
    2.0 * one_way.closeness(other_way).min(1.0).sqrt().acos()
}

/// Trust in each edge: little without loops, more for each that closes, none where many fail and none closes.
fn trust<T: Turn<K>, const K: usize>(edges: &Edges<'_, T>, noise: f64) -> Vec<u32> {
    (0..edges.graph.n_edges())
        .into_par_iter()
        .map(|edge| {
            let (mut closed, mut seen) = (0, 0);
            let closes = |closure: f64, sigma: f64| closure < (AGREEMENT * noise * sigma).min(WIDEST_AGREEMENT);
            for_triangles(edges, edge, LOOPS, |closure, sigma| {
                seen += 1;
                closed += u32::from(closes(closure, sigma));
            });
            if closed == 0 {
                for_quadrangles(edges, edge, |closure, sigma| {
                    seen += 1;
                    closed += u32::from(closes(closure, sigma));
                });
            }
            let doubtful = !edges.credible[edge] || (closed == 0 && seen >= LOOPS_TO_DOUBT);
            if doubtful { 0 } else { 1 + 2 * closed }
        })
        .collect()
}

/// Where one edge from what is placed says that a cluster must be turned.
struct Opinion<T> {
    turn: T,
    /// Squared cosine of half the angle within which another opinion agrees.
    agreement: f64,
    trust: u32,
    /// Own trust and that of all that agree.
    support: u32,
}

/// Opinions kept about one cluster; later ones only support these.
const OPINIONS: usize = 256;
/// Most rounds of growth, each over the clusters that the last one left.
const GROWTHS: usize = 20;

/// Orientations grown over the graph; each part of it starts from the identity. `noise` is relative to sigma.
///
/// Where consensus is thin, growth crosses a wrong edge now and then, and what lies behind it agrees with itself only. Such
/// regions are the blocks that no single edge holds together: they are grown again, as wholes.
pub(super) fn grow<T: Turn<K>, const K: usize>(edges: &Edges<'_, T>, noise: f64) -> Vec<T> {
    let n = edges.graph.n_views();
    let trust = trust(edges, noise);
    let mut found = vec![T::identity(); n];
    let mut cluster: Vec<u32> = (0..n as u32).collect();
    let n_parts = n_groups(&edges.graph.parts(&vec![true; edges.graph.n_edges()]));
    let (mut n_clusters, mut idle) = (n, 0);
    for round in 0..GROWTHS {
        if n_clusters == n_parts || idle == 2 {
            break;
        }
        // what lies between two clusters has drifted apart by more than one edge's noise
        let noise = noise * (1.0 + 0.5 * round.min(4) as f64);
        grow_clusters(edges, noise, &trust, &cluster, &mut found);
        let agrees: Vec<bool> = (0..edges.graph.n_edges())
            .into_par_iter()
            .with_min_len(1024)
            .map(|edge| {
                let (a, b) = edges.graph.ends(edge);
                trust[edge] > 0
                    && edges.relative[edge].compose(&found[a]).closeness(&found[b]) >= agreement(edges, edge, noise)
            })
            .collect();
        cluster = edges.graph.blocks(&agrees);
        let left = n_groups(&cluster);
        idle = if left < n_clusters { 0 } else { idle + 1 };
        n_clusters = left;
    }
    found
}

/// Number of groups named by their lowest member.
fn n_groups(group: &[u32]) -> usize {
    group.iter().enumerate().filter(|(view, g)| *view == **g as usize).count()
}

/// Squared cosine of half the angle within which what an edge says agrees with something else.
fn agreement<T>(edges: &Edges<'_, T>, edge: usize, noise: f64) -> f64 {
    let within = (AGREEMENT * noise * edges.sigma[edge] * std::f64::consts::SQRT_2).min(WIDEST_AGREEMENT);
    (0.5 * within).cos().powi(2)
}

/// One growth: the clusters, named by their lowest views, are turned as wholes.
fn grow_clusters<T: Turn<K>, const K: usize>(
    edges: &Edges<'_, T>,
    noise: f64,
    trust: &[u32],
    cluster: &[u32],
    found: &mut [T],
) {
    let graph = edges.graph;
    let n = graph.n_views();
    let mut members: Vec<Vec<u32>> = vec![Vec::new(); n];
    let mut weight = vec![0u64; n];
    for (view, &c) in cluster.iter().enumerate() {
        members[c as usize].push(view as u32);
        weight[c as usize] += graph.neighbours(view).iter().map(|e| u64::from(trust[e.edge as usize])).sum::<u64>();
    }
    let mut seeds: Vec<u32> = (0..n as u32).filter(|&c| !members[c as usize].is_empty()).collect();
    seeds.sort_by_key(|&c| std::cmp::Reverse(weight[c as usize]));
    let mut placed = vec![false; n];
    let mut opinions: Vec<Vec<Opinion<T>>> = (0..n).map(|_| Vec::new()).collect();
    let mut queue: BinaryHeap<(u32, std::cmp::Reverse<u32>)> = BinaryHeap::new();
    for seed in seeds {
        queue.push((0, std::cmp::Reverse(seed)));
        while let Some((_, std::cmp::Reverse(next))) = queue.pop() {
            if std::mem::replace(&mut placed[next as usize], true) {
                continue;
            }
            let turn = consensus(&std::mem::take(&mut opinions[next as usize]));
            for &view in &members[next as usize] {
                if let Some(turn) = &turn {
                    found[view as usize] = found[view as usize].compose(turn);
                }
            }
            for &view in &members[next as usize] {
                for n in graph.neighbours(view as usize) {
                    let (edge, other) = (n.edge as usize, cluster[n.view as usize]);
                    if placed[other as usize] {
                        continue;
                    }
                    let expected = edges.neighbour_from(n).compose(&found[view as usize]);
                    let opinion = Opinion {
                        turn: found[n.view as usize].inverse().compose(&expected),
                        agreement: agreement(edges, edge, noise),
                        trust: trust[edge],
                        support: trust[edge],
                    };
                    queue.push((hear(&mut opinions[other as usize], opinion), std::cmp::Reverse(other)));
                }
            }
        }
    }
}

/// Adds an opinion to the others about a cluster; the best support now.
fn hear<T: Turn<K>, const K: usize>(others: &mut Vec<Opinion<T>>, mut new: Opinion<T>) -> u32 {
    let mut best = 0;
    for other in others.iter_mut() {
        if other.turn.closeness(&new.turn) >= other.agreement.min(new.agreement) {
            other.support += new.trust;
            new.support += other.trust;
        }
        best = best.max(other.support);
    }
    best = best.max(new.support);
    if others.len() < OPINIONS {
        others.push(new);
    }
    best
}

/// Mean of the opinions that agree with the best supported one.
fn consensus<T: Turn<K>, const K: usize>(opinions: &[Opinion<T>]) -> Option<T> {
    let best = opinions.iter().reduce(|a, b| if b.support > a.support { b } else { a })?;
    let (mut sum, mut total): (Vector<K>, f64) = ([0.0; K], 0.0);
    for other in opinions.iter().filter(|o| o.trust > 0) {
        if other.turn.closeness(&best.turn) >= other.agreement.min(best.agreement) {
            let off = best.turn.inverse().compose(&other.turn).log();
            sum = add(&sum, &scale(f64::from(other.trust), &off));
            total += f64::from(other.trust);
        }
    }
    Some(if total > 0.0 { best.turn.compose(&T::exp(&scale(1.0 / total, &sum))) } else { best.turn })
}
