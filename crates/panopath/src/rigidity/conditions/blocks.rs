//! Blocks of a graph: the largest sets of edges of which any two lie on a common circuit (Hopcroft and Tarjan 1973).
//!
//! Two blocks have at most one node in common. A block of one edge is a bridge.

use super::graph::Edge;
use crate::lists::Lists;

/// The edges of each block. Edges between the same two nodes are told apart; edges that `at` does not list are in none.
pub(super) fn blocks(n_nodes: usize, edges: &[Edge], at: &Lists) -> Vec<Vec<usize>> {
    let mut search = Search {
        order: vec![0; n_nodes],
        lowest: vec![0; n_nodes],
        taken: vec![false; edges.len()],
        open: Vec::new(),
        found: Vec::new(),
        n_visited: 0,
    };
    for root in 0..n_nodes {
        if search.order[root] == 0 {
            search.from(root, edges, at);
        }
    }
    search.found
}

struct Search {
    /// When each node was first reached, from 1; 0 not yet.
    order: Vec<u32>,
    /// Earliest node that its subtree reaches by one edge more.
    lowest: Vec<u32>,
    taken: Vec<bool>,
    /// Edges that are in no block yet, as they were met.
    open: Vec<usize>,
    found: Vec<Vec<usize>>,
    n_visited: u32,
}

/// A node on the path of the search: how it was reached, and which of its edges comes next.
struct Step {
    node: usize,
    /// Length of `open` before the edge that led here.
    first_open: usize,
    next: usize,
}

impl Search {
    fn visit(&mut self, node: usize) {
        self.n_visited += 1;
        self.order[node] = self.n_visited;
        self.lowest[node] = self.n_visited;
    }

    fn from(&mut self, root: usize, edges: &[Edge], at: &Lists) {
        self.visit(root);
        let mut path = vec![Step { node: root, first_open: 0, next: 0 }];
        while let Some(step) = path.last_mut() {
            let node = step.node;
            let Some(&edge) = at.of(node).get(step.next) else {
                let first_open = step.first_open;
                path.pop();
                if let Some(above) = path.last() {
                    self.close(above.node, node, first_open);
                }
                continue;
            };
            step.next += 1;
            let edge = edge as usize;
            if std::mem::replace(&mut self.taken[edge], true) {
                continue;
            }
            let first_open = self.open.len();
            self.open.push(edge);
            let (a, b) = edges[edge];
            let other = (if a as usize == node { b } else { a }) as usize;
            if self.order[other] == 0 {
                self.visit(other);
                path.push(Step { node: other, first_open, next: 0 });
            } else {
                self.lowest[node] = self.lowest[node].min(self.order[other]);
            }
        }
    }

    /// The subtree of `below` is done: it is a block where it reaches nothing beyond `above`.
    fn close(&mut self, above: usize, below: usize, first_open: usize) {
        if self.lowest[below] >= self.order[above] {
            self.found.push(self.open.split_off(first_open));
        } else {
            self.lowest[above] = self.lowest[above].min(self.lowest[below]);
        }
    }
}
