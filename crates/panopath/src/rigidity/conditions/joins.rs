//! How much rigid bodies hold each other: freedoms, constraints, and which of them hang together.

use super::blocks::blocks;
use super::graph::{Edge, edges_at, grouped};
use crate::sets::Sets;

/// Freedoms that a model counts.
#[derive(Clone, Copy)]
pub(super) struct Freedoms {
    d: usize,
    turns: usize,
}

impl Freedoms {
    /// Free orientations turn about as many axes as the gauge does.
    pub(super) fn new(d: usize, free_orientation: bool, gauge_freedoms: usize) -> Self {
        let turns = gauge_freedoms.saturating_sub(d + 1).clamp(1, d * (d - 1) / 2);
        Self { d, turns: if free_orientation { turns } else { 0 } }
    }

    /// Of a rigid body: shifts, scale, turns.
    pub(super) fn body(&self) -> usize {
        self.d + 1 + self.turns
    }

    pub(super) fn member(&self, is_view: bool) -> usize {
        self.d + if is_view { self.turns } else { 0 }
    }

    /// Observations that a member needs at least.
    pub(super) fn rays(&self, is_view: bool) -> usize {
        self.member(is_view).div_ceil(self.ray())
    }

    pub(super) fn is_turning(&self) -> bool {
        self.turns > 0
    }

    /// Equations of one observation.
    pub(super) fn ray(&self) -> usize {
        self.d - 1
    }
}

/// What holds rigid bodies together: a member that they share, or rays and the members of no body between them.
pub(super) struct Link {
    /// Nodes to name.
    pub nodes: Vec<usize>,
    /// Bodies that it holds, ascending.
    pub bodies: Vec<usize>,
    /// Equations beyond what its own members take up.
    pub constraints: usize,
    pub is_hinge: bool,
}

/// Bodies and links that hang together.
pub(super) struct Join {
    pub bodies: Vec<usize>,
    pub links: Vec<usize>,
    pub constraints: usize,
}

/// Splits what hangs together wherever it does so at a single body only, which itself is rigid.
pub(super) fn joins(n_bodies: usize, links: &[Link]) -> Vec<Join> {
    let edges: Vec<Edge> = links
        .iter()
        .enumerate()
        .flat_map(|(k, link)| link.bodies.iter().map(move |&body| (body as u32, (n_bodies + k) as u32)))
        .collect();
    let n_nodes = n_bodies + links.len();
    let mut together = Sets::new(links.len());
    for block in blocks(n_nodes, &edges, &edges_at(n_nodes, &edges, |_| true)) {
        for pair in block.windows(2) {
            together.join(edges[pair[0]].1 as usize - n_bodies, edges[pair[1]].1 as usize - n_bodies);
        }
    }
    let groups = grouped(0..links.len(), |k| together.find(k));
    groups
        .into_iter()
        .map(|members| {
            let mut bodies: Vec<usize> = members.iter().flat_map(|&k| links[k].bodies.iter().copied()).collect();
            bodies.sort_unstable();
            bodies.dedup();
            let constraints = members.iter().map(|&k| links[k].constraints).sum();
            Join { bodies, links: members, constraints }
        })
        .collect()
}
