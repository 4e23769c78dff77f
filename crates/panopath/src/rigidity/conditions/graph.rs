//! The bipartite graph of sightings: views and tracks are nodes, views first; observations are edges.

use super::Sightings;
use crate::geometry::Vector;

/// An edge between two nodes.
pub(super) type Edge = (u32, u32);

/// Lists of the edges at each node.
pub(super) struct Lists {
    start: Vec<u32>,
    item: Vec<u32>,
}

impl Lists {
    /// Lists the edges for which `keep` holds.
    pub(super) fn new(n_nodes: usize, edges: &[Edge], keep: impl Fn(usize) -> bool) -> Self {
        let mut start = vec![0u32; n_nodes + 1];
        let kept = || (0..edges.len()).filter(|&e| keep(e));
        for e in kept() {
            start[edges[e].0 as usize + 1] += 1;
            start[edges[e].1 as usize + 1] += 1;
        }
        for node in 0..n_nodes {
            start[node + 1] += start[node];
        }
        let mut next = start.clone();
        let mut item = vec![0u32; start[n_nodes] as usize];
        for e in kept() {
            for node in [edges[e].0, edges[e].1] {
                let slot = &mut next[node as usize];
                item[*slot as usize] = e as u32;
                *slot += 1;
            }
        }
        Self { start, item }
    }

    pub(super) fn of(&self, node: usize) -> &[u32] {
        &self.item[self.start[node] as usize..self.start[node + 1] as usize]
    }
}

/// Sightings that count, as a graph.
pub(super) struct Graph<'a, const D: usize> {
    scene: Sightings<'a, D>,
    pub n_views: usize,
    pub n_nodes: usize,
    /// Edge of each observation.
    pub edges: Vec<Edge>,
    /// The edges at each node; only the first of equal ones, and none without length.
    pub at: Lists,
    /// Whether an edge is listed.
    pub counts: Vec<bool>,
}

impl<'a, const D: usize> Graph<'a, D> {
    pub(super) fn new(scene: &Sightings<'a, D>) -> Self {
        let n_views = scene.centers.len();
        let n_nodes = n_views + scene.points.len();
        let edges: Vec<Edge> =
            scene.view.iter().zip(scene.track).map(|(&view, &track)| (view, n_views as u32 + track)).collect();
        let with_length = |e: usize| scene.centers[scene.view[e] as usize] != scene.points[scene.track[e] as usize];
        let all = Lists::new(n_nodes, &edges, with_length);
        let mut counts = vec![false; edges.len()];
        let mut last_view = vec![u32::MAX; scene.points.len()];
        for view in 0..n_views {
            for &e in all.of(view) {
                let track = scene.track[e as usize] as usize;
                counts[e as usize] = last_view[track] != view as u32;
                last_view[track] = view as u32;
            }
        }
        let at = Lists::new(n_nodes, &edges, |e| counts[e]);
        Self { scene: *scene, n_views, n_nodes, edges, at, counts }
    }

    pub(super) fn is_view(&self, node: usize) -> bool {
        node < self.n_views
    }

    pub(super) fn position(&self, node: usize) -> &Vector<D> {
        if self.is_view(node) { &self.scene.centers[node] } else { &self.scene.points[node - self.n_views] }
    }

    pub(super) fn other_end(&self, edge: u32, node: usize) -> usize {
        let (a, b) = self.edges[edge as usize];
        (if a as usize == node { b } else { a }) as usize
    }

    /// Views and tracks of a set of nodes, each ascending.
    pub(super) fn split(&self, nodes: impl IntoIterator<Item = usize>) -> (Vec<u32>, Vec<u32>) {
        let mut nodes: Vec<usize> = nodes.into_iter().collect();
        nodes.sort_unstable();
        nodes.dedup();
        let views = nodes.partition_point(|&node| node < self.n_views);
        let tracks = nodes[views..].iter().map(|&node| (node - self.n_views) as u32).collect();
        (nodes[..views].iter().map(|&node| node as u32).collect(), tracks)
    }
}

/// Disjoint sets, each known by its smallest member.
pub(super) struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    pub(super) fn new(n: usize) -> Self {
        Self { parent: (0..n as u32).collect() }
    }

    pub(super) fn find(&mut self, x: usize) -> usize {
        let mut root = x as u32;
        while self.parent[root as usize] != root {
            // halves the path on the way
            self.parent[root as usize] = self.parent[self.parent[root as usize] as usize];
            root = self.parent[root as usize];
        }
        root as usize
    }

    pub(super) fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b)] = a.min(b) as u32;
    }
}

/// Groups `items` by a key, groups in the order of their key, items in their own order.
pub(super) fn grouped(items: impl IntoIterator<Item = usize>, mut key: impl FnMut(usize) -> usize) -> Vec<Vec<usize>> {
    let mut keyed: Vec<(usize, usize)> = items.into_iter().map(|item| (key(item), item)).collect();
    keyed.sort_by_key(|&(key, _)| key);
    keyed.chunk_by(|a, b| a.0 == b.0).map(|group| group.iter().map(|&(_, item)| item).collect()).collect()
}
