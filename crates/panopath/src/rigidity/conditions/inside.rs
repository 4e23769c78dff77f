//! What keeps a block flexible: shapes of clusters, joins of bodies, counts.
//!
//! A *body* is a rigid component with observations in the block. A *cluster* is a set of observations of no body that hang
//! together through members of no body.

use super::graph::grouped;
use super::joins::{Join, Link, joins};
use super::loose::Loose;
use super::naming::Naming;
use super::{Cause, CauseKind, count_of};
use crate::sets::Sets;

/// More shared members than this are counted, not named.
const MOST_NAMES: usize = 4;

/// Bodies and clusters of one block.
pub(super) struct Inside<'a, const D: usize> {
    naming: &'a Naming<'a, D>,
    loose: &'a Loose,
    block: &'a [usize],
    /// Components of the block. Further bodies are clusters that a shape explains.
    components: Vec<u32>,
    n_bodies: usize,
    /// (node, body), sorted.
    membership: Vec<(usize, usize)>,
    clusters: Vec<Vec<usize>>,
    causes: Vec<Cause>,
}

impl<'a, const D: usize> Inside<'a, D> {
    pub(super) fn new(naming: &'a Naming<'a, D>, block: &'a [usize], loose: &'a Loose) -> Self {
        let components = naming.components_on(block.iter().copied());
        let nodes = naming.nodes_of(block.iter().copied());
        let mut membership = Vec::new();
        for &node in &nodes {
            let bodies = naming.components_of(node).filter_map(|c| components.binary_search(&c).ok());
            membership.extend(bodies.map(|body| (node, body)));
        }
        let n_bodies = components.len();
        let mut inside =
            Self { naming, loose, block, components, n_bodies, membership, clusters: Vec::new(), causes: Vec::new() };
        inside.clusters = inside.find_clusters(block, &nodes);
        inside
    }

    fn bodies_of(&self, node: usize) -> impl Iterator<Item = usize> {
        let start = self.membership.partition_point(|&(other, _)| other < node);
        self.membership[start..].iter().take_while(move |(other, _)| *other == node).map(|&(_, body)| body)
    }

    fn is_free(&self, node: usize) -> bool {
        self.bodies_of(node).next().is_none()
    }

    fn find_clusters(&self, block: &[usize], nodes: &[usize]) -> Vec<Vec<usize>> {
        let alone: Vec<usize> = block.iter().copied().filter(|&e| self.naming.component[e] < 0).collect();
        let slot = |node: usize| nodes.binary_search(&node).ok();
        let free: Vec<bool> = nodes.iter().map(|&node| self.is_free(node)).collect();
        let ends = |e: usize| [self.naming.graph.edges[e].0 as usize, self.naming.graph.edges[e].1 as usize];
        // sets of free nodes, and behind them one for each observation
        let mut sets = Sets::new(nodes.len() + alone.len());
        for (k, &e) in alone.iter().enumerate() {
            for slot in ends(e).into_iter().filter_map(slot).filter(|&slot| free[slot]) {
                sets.join(slot, nodes.len() + k);
            }
        }
        let groups = grouped(0..alone.len(), |k| sets.find(nodes.len() + k));
        groups.into_iter().map(|group| group.into_iter().map(|k| alone[k]).collect()).collect()
    }

    pub(super) fn causes(mut self) -> Vec<Cause> {
        let shaped: Vec<Option<Vec<usize>>> = (0..self.clusters.len()).map(|k| self.name_shape(k)).collect();
        for nodes in shaped.iter().flatten() {
            self.membership.extend(nodes.iter().map(|&node| (node, self.n_bodies)));
            self.n_bodies += 1;
        }
        self.membership.sort_unstable();
        let mut links = self.hinges();
        for k in (0..self.clusters.len()).filter(|&k| shaped[k].is_none()) {
            links.extend(self.count(k));
        }
        let found = joins(self.n_bodies, &links);
        let is_short = |join: &Join| join.constraints < (join.bodies.len() - 1) * self.naming.freedoms.body();
        let (short, special): (Vec<Join>, Vec<Join>) = found.into_iter().partition(is_short);
        self.weak_joins(&short, &links);
        if self.causes.is_empty() {
            self.causes.extend(self.count_all());
        }
        if self.causes.is_empty() {
            self.weak_joins(&special, &links);
        }
        self.causes
    }

    /// Names the shape that leaves a cluster flexible, where it is on one: its nodes are a body from then on.
    fn name_shape(&mut self, k: usize) -> Option<Vec<usize>> {
        let cluster = &self.clusters[k];
        let nodes = self.naming.nodes_of(cluster.iter().copied());
        let n_views = nodes.partition_point(|&node| self.naming.graph.is_view(node));
        let smaller = n_views.min(nodes.len() - n_views);
        let has_circuit = cluster.len() >= nodes.len();
        let bodies = self.touched(&nodes);
        // in space an observation of the body itself may close the circuit of two views and two points
        let fits = if smaller == 2 { bodies.len() < 2 && (has_circuit || D == 3) } else { smaller > 2 && has_circuit };
        if !fits {
            return None;
        }
        let mut found = self.naming.shapes_of(&nodes);
        for cause in &mut found {
            cause.components = self.component_ids(&bodies);
        }
        let is_named = !found.is_empty();
        self.causes.extend(found);
        is_named.then_some(nodes)
    }

    /// One body for each of these nodes that is a member of any.
    fn touched(&self, nodes: &[usize]) -> Vec<usize> {
        let mut bodies: Vec<usize> = nodes.iter().filter_map(|&node| self.bodies_of(node).next()).collect();
        bodies.sort_unstable();
        bodies.dedup();
        bodies
    }

    fn component_ids(&self, bodies: &[usize]) -> Vec<u32> {
        bodies.iter().filter_map(|&body| self.components.get(body).copied()).collect()
    }

    fn hinges(&self) -> Vec<Link> {
        let shared = self.membership.chunk_by(|a, b| a.0 == b.0).filter(|bodies| bodies.len() > 1);
        shared
            .map(|bodies| {
                let node = bodies[0].0;
                let each = self.naming.freedoms.member(self.naming.graph.is_view(node));
                Link {
                    nodes: vec![node],
                    bodies: bodies.iter().map(|&(_, body)| body).collect(),
                    constraints: (bodies.len() - 1) * each,
                    is_hinge: true,
                }
            })
            .collect()
    }

    /// A cluster with fewer equations than unknowns is a cause, another one between bodies a link.
    fn count(&mut self, k: usize) -> Option<Link> {
        let (naming, cluster) = (self.naming, &self.clusters[k]);
        let nodes = naming.nodes_of(cluster.iter().copied());
        let bodies = self.touched(&nodes);
        let free = nodes.iter().filter(|&&node| self.is_free(node));
        let taken: usize = free.map(|&node| self.freedoms_of(node)).sum();
        let unknowns = if bodies.is_empty() { taken.saturating_sub(naming.freedoms.body()) } else { taken };
        let equations = cluster.len() * naming.freedoms.ray();
        if equations < unknowns {
            let detail = equation_words(equations, unknowns);
            let mut cause = naming.cause_of(CauseKind::TooFewEquations, detail, nodes);
            cause.components = self.component_ids(&bodies);
            self.causes.push(cause);
            return None;
        }
        (bodies.len() > 1).then(|| Link { nodes, bodies, constraints: equations - taken, is_hinge: false })
    }

    /// The count over the whole block, its bodies taken to pieces: by a special position a body may be rigid with fewer
    /// equations than it needs, as part of a flexible whole.
    fn count_all(&self) -> Option<Cause> {
        let naming = self.naming;
        let nodes = naming.nodes_of(self.block.iter().copied());
        let taken: usize = nodes.iter().map(|&node| self.freedoms_of(node)).sum();
        let unknowns = taken.saturating_sub(naming.freedoms.body());
        let equations = self.block.len() * naming.freedoms.ray();
        let mut cause = naming.cause_of(CauseKind::TooFewEquations, equation_words(equations, unknowns), nodes);
        cause.components.clone_from(&self.components);
        (equations < unknowns).then_some(cause)
    }

    fn freedoms_of(&self, node: usize) -> usize {
        self.naming.freedoms.member(self.naming.graph.is_view(node)) - usize::from(self.loose.sliding[node])
    }

    fn weak_joins(&mut self, joins: &[Join], links: &[Link]) {
        for join in joins {
            let nodes: Vec<usize> = join.links.iter().flat_map(|&k| links[k].nodes.iter().copied()).collect();
            let only_hinges = join.bodies.len() == 2 && join.links.iter().all(|&k| links[k].is_hinge);
            let detail = if only_hinges && nodes.len() <= MOST_NAMES {
                self.naming.shares_only(&nodes)
            } else {
                self.naming.constraint_words(join.constraints, join.bodies.len())
            };
            let mut cause = self.naming.cause_of(CauseKind::WeakJoin, detail, nodes);
            cause.components = self.component_ids(&join.bodies);
            self.causes.push(cause);
        }
    }
}

fn equation_words(equations: usize, unknowns: usize) -> String {
    format!("{} for {}", count_of(equations, "equation"), count_of(unknowns, "unknown"))
}
