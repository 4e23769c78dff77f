//! The bipartite graph of sightings: views and tracks are nodes, views first; observations are edges.

use super::Sightings;
use crate::geometry::Vector;
use crate::lists::Lists;

/// An edge between two nodes.
pub(super) type Edge = (u32, u32);

/// Lists the edges for which `keep` holds at each of their nodes.
pub(super) fn edges_at(n_nodes: usize, edges: &[Edge], keep: impl Fn(usize) -> bool + Copy) -> Lists {
    let kept = (0..edges.len()).filter(move |&e| keep(e));
    Lists::new(n_nodes, kept.flat_map(|e| [(edges[e].0, e as u32), (edges[e].1, e as u32)]))
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
        let all = edges_at(n_nodes, &edges, with_length);
        let mut counts = vec![false; edges.len()];
        let mut last_view = vec![u32::MAX; scene.points.len()];
        for view in 0..n_views {
            for &e in all.of(view) {
                let track = scene.track[e as usize] as usize;
                counts[e as usize] = last_view[track] != view as u32;
                last_view[track] = view as u32;
            }
        }
        let at = edges_at(n_nodes, &edges, |e| counts[e]);
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

/// Groups `items` by a key, groups in the order of their key, items in their own order.
pub(super) fn grouped(items: impl IntoIterator<Item = usize>, mut key: impl FnMut(usize) -> usize) -> Vec<Vec<usize>> {
    let mut keyed: Vec<(usize, usize)> = items.into_iter().map(|item| (key(item), item)).collect();
    keyed.sort_by_key(|&(key, _)| key);
    keyed.chunk_by(|a, b| a.0 == b.0).map(|group| group.iter().map(|&(_, item)| item).collect()).collect()
}
