//! The graph of views and edges: who neighbours whom, what hangs together, which edges are bridges.

use crate::sets::Sets;

/// One end of an edge, seen from the other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Neighbour {
    pub view: u32,
    pub edge: u32,
    /// Is this neighbour the second view of the edge?
    pub is_second: bool,
}

/// Views and edges, each view's neighbours in ascending order.
#[derive(Debug)]
pub(super) struct Graph {
    pub first: Vec<u32>,
    pub second: Vec<u32>,
    start: Vec<u32>,
    neighbour: Vec<Neighbour>,
}

impl Graph {
    /// `ends` are distinct views below `n_views`.
    pub fn new(n_views: usize, ends: impl Iterator<Item = (u32, u32)>) -> Self {
        let (first, second): (Vec<u32>, Vec<u32>) = ends.unzip();
        let mut start = vec![0u32; n_views + 1];
        for &view in first.iter().chain(&second) {
            start[view as usize + 1] += 1;
        }
        for view in 0..n_views {
            start[view + 1] += start[view];
        }
        let mut next = start.clone();
        let mut neighbour = vec![Neighbour { view: 0, edge: 0, is_second: false }; 2 * first.len()];
        for (edge, (&a, &b)) in first.iter().zip(&second).enumerate() {
            for (own, view, is_second) in [(a, b, true), (b, a, false)] {
                let slot = &mut next[own as usize];
                neighbour[*slot as usize] = Neighbour { view, edge: edge as u32, is_second };
                *slot += 1;
            }
        }
        for view in 0..n_views {
            neighbour[start[view] as usize..start[view + 1] as usize].sort_unstable_by_key(|n| (n.view, n.edge));
        }
        Self { first, second, start, neighbour }
    }

    pub fn n_views(&self) -> usize {
        self.start.len() - 1
    }

    pub fn n_edges(&self) -> usize {
        self.first.len()
    }

    pub fn ends(&self, edge: usize) -> (usize, usize) {
        (self.first[edge] as usize, self.second[edge] as usize)
    }

    /// Neighbours of a view, ascending.
    pub fn neighbours(&self, view: usize) -> &[Neighbour] {
        &self.neighbour[self.start[view] as usize..self.start[view + 1] as usize]
    }

    /// The part of each view along the edges that are kept, named by its lowest view.
    pub fn parts(&self, keep: &[bool]) -> Vec<u32> {
        let mut sets = Sets::new(self.n_views());
        for (a, b) in (0..self.n_edges()).filter(|&e| keep[e]).map(|e| self.ends(e)) {
            sets.join(a, b);
        }
        (0..self.n_views()).map(|view| sets.find(view) as u32).collect()
    }

    /// Block of each view, named by its lowest view: what no single kept edge can part.
    pub fn blocks(&self, keep: &[bool]) -> Vec<u32> {
        let block = BlockTree::new(self, keep).block;
        let mut lowest = vec![u32::MAX; block.len()];
        for (view, &b) in block.iter().enumerate() {
            lowest[b as usize] = lowest[b as usize].min(view as u32);
        }
        block.iter().map(|&b| lowest[b as usize]).collect()
    }

    /// Kept bridges between two blocks of at least three views that a rejected edge contradicts.
    ///
    /// A bridge closes no loop, so that its residual says nothing. One that a rejected edge spans too stands word against
    /// word. Single views along a chain are left together: a chain with one wrong closure is still the best guess.
    pub fn contested_bridges(&self, keep: &[bool]) -> Vec<usize> {
        let tree = BlockTree::new(self, keep);
        let mut contested = vec![false; self.n_views()];
        for edge in (0..self.n_edges()).filter(|&e| !keep[e]) {
            let (a, b) = self.ends(edge);
            tree.mark_path(tree.block[a], tree.block[b], &mut contested);
        }
        let mut found: Vec<usize> = (0..self.n_views())
            .filter(|&block| contested[block])
            .filter_map(|block| {
                let (edge, above) = tree.parent[block]?;
                (tree.size[block] >= 3 && tree.size[above as usize] >= 3).then_some(edge as usize)
            })
            .collect();
        found.sort_unstable();
        found
    }
}

/// What no single edge can part (two-edge-connected blocks), and the bridges between: a forest.
struct BlockTree {
    /// Block of each view, named by the view where the search entered it.
    block: Vec<u32>,
    /// Bridge towards the root, and the block at its other end.
    parent: Vec<Option<(u32, u32)>>,
    size: Vec<u32>,
    depth: Vec<u32>,
    part: Vec<u32>,
}

impl BlockTree {
    /// Depth-first search with the lowest entry time that each subtree reaches (Tarjan 1974).
    fn new(graph: &Graph, keep: &[bool]) -> Self {
        let n = graph.n_views();
        let (entered, low, above, order) = search(graph, keep);
        let mut block: Vec<u32> = (0..n as u32).collect();
        let mut parent = vec![None; n];
        let (mut size, mut depth) = (vec![0u32; n], vec![0u32; n]);
        // parents come before their children
        for &view in &order {
            let view = view as usize;
            if let Some((edge, up)) = above[view] {
                let up_block = block[up as usize];
                if low[view] == entered[view] {
                    parent[view] = Some((edge, up_block));
                    depth[view] = depth[up_block as usize] + 1;
                } else {
                    block[view] = up_block;
                }
            }
            size[block[view] as usize] += 1;
        }
        Self { block, parent, size, depth, part: graph.parts(keep) }
    }

    fn mark_path(&self, mut a: u32, mut b: u32, marked: &mut [bool]) {
        if self.part[a as usize] != self.part[b as usize] {
            return;
        }
        while a != b {
            if self.depth[a as usize] < self.depth[b as usize] {
                std::mem::swap(&mut a, &mut b);
            }
            marked[a as usize] = true;
            match self.parent[a as usize] {
                Some((_, up)) => a = up,
                None => return,
            }
        }
    }
}

/// Tree edge and view above each view.
type Above = Vec<Option<(u32, u32)>>;

/// Entry times, lowest entry times reached, tree edges, and views in the order they were entered.
fn search(graph: &Graph, keep: &[bool]) -> (Vec<u32>, Vec<u32>, Above, Vec<u32>) {
    let n = graph.n_views();
    let (mut entered, mut low) = (vec![u32::MAX; n], vec![u32::MAX; n]);
    let (mut above, mut order, mut next): (Above, _, _) = (vec![None; n], Vec::with_capacity(n), vec![0usize; n]);
    for root in 0..n {
        if entered[root] != u32::MAX {
            continue;
        }
        let mut stack = vec![root];
        entered[root] = order.len() as u32;
        low[root] = entered[root];
        order.push(root as u32);
        while let Some(&view) = stack.last() {
            let Some(n) = graph.neighbours(view).get(next[view]) else {
                stack.pop();
                if let Some((_, up)) = above[view] {
                    low[up as usize] = low[up as usize].min(low[view]);
                }
                continue;
            };
            next[view] += 1;
            let other = n.view as usize;
            if !keep[n.edge as usize] || above[view].is_some_and(|(edge, _)| edge == n.edge) {
                continue;
            }
            if entered[other] == u32::MAX {
                entered[other] = order.len() as u32;
                low[other] = entered[other];
                above[other] = Some((n.edge, view as u32));
                order.push(other as u32);
                stack.push(other);
            } else {
                low[view] = low[view].min(entered[other]);
            }
        }
    }
    (entered, low, above, order)
}
