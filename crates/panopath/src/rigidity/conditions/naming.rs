//! Names for what a numerical test found free, from who sees whom, where things are, and which observations are rigid.
//!
//! From the outside in: parts that nothing ties; members that hang loose by themselves; blocks, which hold each other at one
//! member only; inside a block the shapes, then rigid parts and what is between them, counted.

use super::arrangement::Arrangement;
use super::blocks::blocks;
use super::graph::{Graph, Lists, Sets, grouped};
use super::joins::{Freedoms, Join, Link, joins};
use super::loose::Loose;
use super::{Cause, CauseKind, Flexibility, Sightings, count_of};
use crate::geometry::{Vector, norm, sub};

/// More causes of one kind than this are told as one.
const MOST_OF_A_KIND: usize = 32;
/// More shared members than this are counted, not named.
const MOST_NAMES: usize = 4;

/// Names the causes of a flexibility, each with its members: the most specific name for each part of the scene.
///
/// Empty where the nullity is that of the gauge. Never empty elsewhere: [`CauseKind::Other`] stands for what no rule fits.
/// `tolerance` is relative to the size of the set that a shape is fitted to; for rays of a single member, to the longest ray.
/// Takes time linear in the observations but for sorting. Indices must be in range and positions finite; an observation twice
/// counts once, and one of no length not at all.
pub fn name_causes<const D: usize>(scene: &Sightings<'_, D>, found: &Flexibility<'_>, tolerance: f64) -> Vec<Cause> {
    if found.nullity <= found.gauge_freedoms {
        return Vec::new();
    }
    let naming = Naming::new(scene, found, tolerance);
    let (parts, mut causes) = naming.parts();
    let (loose, more) = Loose::find(
        &naming.graph,
        found.component_of_observation,
        found.free_orientation,
        |node| parts.is_explained[parts.of[node]],
        tolerance,
    );
    causes.extend(more);
    causes.extend(naming.inside(&parts, &loose));
    if causes.is_empty() {
        let edges = (0..naming.graph.edges.len()).filter(|&e| naming.graph.counts[e]);
        causes.push(naming.cause_of(CauseKind::Other, "", naming.nodes_of(edges)));
    }
    condensed(causes)
}

/// Connected parts, each known by its smallest node.
struct Parts {
    of: Vec<usize>,
    is_explained: Vec<bool>,
}

struct Naming<'a, const D: usize> {
    graph: Graph<'a, D>,
    component: &'a [i32],
    /// (node, component), sorted: which components each node is a member of.
    membership: Vec<(u32, u32)>,
    freedoms: Freedoms,
    free_orientation: bool,
    tolerance: f64,
}

impl<'a, const D: usize> Naming<'a, D> {
    fn new(scene: &Sightings<'a, D>, found: &Flexibility<'a>, tolerance: f64) -> Self {
        let graph = Graph::new(scene);
        let mut membership = Vec::new();
        for (component, members) in found.components.iter().enumerate() {
            membership.extend(members.views.iter().map(|&view| (view, component as u32)));
            let n_views = graph.n_views as u32;
            membership.extend(members.tracks.iter().map(|&track| (n_views + track, component as u32)));
        }
        membership.sort_unstable();
        Self {
            graph,
            component: found.component_of_observation,
            membership,
            freedoms: Freedoms::new(D, found.free_orientation),
            free_orientation: found.free_orientation,
            tolerance,
        }
    }

    fn components_of(&self, node: usize) -> impl Iterator<Item = u32> {
        let start = self.membership.partition_point(|&(other, _)| (other as usize) < node);
        self.membership[start..].iter().take_while(move |(other, _)| *other as usize == node).map(|&(_, c)| c)
    }

    fn nodes_of(&self, edges: impl IntoIterator<Item = usize>) -> Vec<usize> {
        let mut nodes: Vec<usize> =
            edges.into_iter().flat_map(|e| [self.graph.edges[e].0 as usize, self.graph.edges[e].1 as usize]).collect();
        nodes.sort_unstable();
        nodes.dedup();
        nodes
    }

    /// Components of these observations, ascending.
    fn components_on(&self, edges: impl IntoIterator<Item = usize>) -> Vec<u32> {
        let mut found: Vec<u32> = edges.into_iter().filter_map(|e| u32::try_from(self.component[e]).ok()).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    fn cause_of(&self, kind: CauseKind, detail: impl Into<String>, nodes: Vec<usize>) -> Cause {
        let mut cause = Cause::new(kind, detail);
        (cause.views, cause.tracks) = self.graph.split(nodes);
        cause
    }

    // ---- connected parts --------------------------------------------------------------------------------------------

    /// Splits into connected parts, says so, and explains those of a single view or point.
    fn parts(&self) -> (Parts, Vec<Cause>) {
        let n = self.graph.n_nodes;
        let mut sets = Sets::new(n);
        for (e, &(view, track)) in self.graph.edges.iter().enumerate() {
            if self.graph.counts[e] {
                sets.unite(view as usize, track as usize);
            }
        }
        let mut parts = Parts { of: (0..n).map(|node| sets.find(node)).collect(), is_explained: vec![false; n] };
        let groups = grouped((0..n).filter(|&node| !self.graph.at.of(node).is_empty()), |node| parts.of[node]);
        let mut causes: Vec<Cause> = self.disconnected(&groups).into_iter().collect();
        for nodes in &groups {
            let explained = self.single(nodes);
            parts.is_explained[parts.of[nodes[0]]] = !explained.is_empty();
            causes.extend(explained);
        }
        (parts, causes)
    }

    fn disconnected(&self, groups: &[Vec<usize>]) -> Option<Cause> {
        let largest = (0..groups.len()).max_by_key(|&g| (groups[g].len(), std::cmp::Reverse(g)))?;
        if groups.len() == 1 {
            return None;
        }
        let rest = (0..groups.len()).filter(|&g| g != largest).flat_map(|g| groups[g].iter().copied()).collect();
        let detail = format!("{} that no observation joins", count_of(groups.len(), "part"));
        let mut cause = self.cause_of(CauseKind::Disconnected, detail, rest);
        // the largest component of each part
        cause.components =
            groups.iter().filter_map(|nodes| nodes.iter().flat_map(|&node| self.components_of(node)).min()).collect();
        cause.components.sort_unstable();
        Some(cause)
    }

    /// A part of one view, of one point, of views at one place; without orientations, of two views or points of a plane.
    fn single(&self, nodes: &[usize]) -> Vec<Cause> {
        let n_views = nodes.partition_point(|&node| self.graph.is_view(node));
        let n_tracks = nodes.len() - n_views;
        if nodes.len() == 2 {
            return Vec::new();
        }
        if n_tracks == 1 {
            return vec![self.cause_of(CauseKind::HiddenPoint, "views that see one point only", nodes.to_vec())];
        }
        if n_views == 1 {
            return vec![self.cause_of(CauseKind::OneCamera, "", nodes.to_vec())];
        }
        let pair = self.free_orientation && (n_views == 2 || n_tracks == 2);
        if pair || self.are_at_one_place(nodes, n_views) { self.shapes_of(nodes) } else { Vec::new() }
    }

    fn are_at_one_place(&self, nodes: &[usize], n_views: usize) -> bool {
        let first = self.graph.position(nodes[0]);
        let far = |nodes: &[usize]| {
            nodes.iter().map(|&node| norm(&sub(self.graph.position(node), first))).fold(0.0, f64::max)
        };
        far(&nodes[..n_views]) <= self.tolerance * far(nodes)
    }

    /// The special shape that all these members lie on.
    fn shapes_of(&self, nodes: &[usize]) -> Vec<Cause> {
        let (views, tracks) = self.graph.split(nodes.iter().copied());
        let place = |node: usize| *self.graph.position(node);
        let centers: Vec<Vector<D>> = views.iter().map(|&view| place(view as usize)).collect();
        let points: Vec<Vector<D>> = tracks.iter().map(|&track| place(self.graph.n_views + track as usize)).collect();
        let mut causes = Arrangement::new(&centers, &points, self.tolerance).map_or_else(Vec::new, |set| set.shapes());
        for cause in &mut causes {
            cause.views.iter_mut().for_each(|view| *view = views[*view as usize]);
            cause.tracks.iter_mut().for_each(|track| *track = tracks[*track as usize]);
        }
        causes
    }

    // ---- blocks -----------------------------------------------------------------------------------------------------

    /// Causes inside the parts that are flexible beyond their loose members.
    fn inside(&self, parts: &Parts, loose: &Loose) -> Vec<Cause> {
        let flexible = self.flexible_parts(parts, loose);
        let graph = &self.graph;
        let keep = |e: usize| loose.live[e] && flexible[parts.of[graph.edges[e].0 as usize]];
        let found = blocks(graph.n_nodes, &graph.edges, &Lists::new(graph.n_nodes, &graph.edges, keep));
        let (firm, bridges): (Vec<_>, Vec<_>) = found.into_iter().partition(|block| block.len() > 1);
        let mut n_blocks = vec![0u32; graph.n_nodes];
        let mut causes = Vec::new();
        for block in &firm {
            for node in self.nodes_of(block.iter().copied()) {
                n_blocks[node] += 1;
            }
            causes.extend(self.inside_block(block, loose));
        }
        causes.extend(self.hinges(&firm, &n_blocks, loose));
        causes.extend(self.bridges(&bridges.concat(), &n_blocks));
        causes
    }

    /// Parts whose observations, those of loose members aside, are not all in one rigid component.
    fn flexible_parts(&self, parts: &Parts, loose: &Loose) -> Vec<bool> {
        let mut first = vec![None; self.graph.n_nodes];
        let mut flexible = vec![false; self.graph.n_nodes];
        for e in (0..self.component.len()).filter(|&e| self.is_firm(e, loose)) {
            let part = parts.of[self.graph.edges[e].0 as usize];
            let component = self.component[e];
            flexible[part] |= component < 0 || *first[part].get_or_insert(component) != component;
        }
        for (flexible, explained) in flexible.iter_mut().zip(&parts.is_explained) {
            *flexible &= !explained;
        }
        flexible
    }

    /// An observation between two members neither of which is loose by itself.
    fn is_firm(&self, e: usize, loose: &Loose) -> bool {
        let (a, b) = self.graph.edges[e];
        loose.live[e] && !loose.sliding[a as usize] && !loose.sliding[b as usize]
    }

    /// Members that alone join two blocks or more.
    fn hinges(&self, firm: &[Vec<usize>], n_blocks: &[u32], loose: &Loose) -> Vec<Cause> {
        let mut at_hinge: Vec<(usize, u32)> = Vec::new();
        let mut joined = vec![0u32; self.graph.n_nodes];
        for block in firm {
            let nodes = self.nodes_of(block.iter().copied());
            for &hinge in nodes.iter().filter(|&&node| n_blocks[node] > 1) {
                // a block of nothing but loose members is no part to join
                joined[hinge] += u32::from(nodes.iter().any(|&node| node != hinge && !loose.sliding[node]));
            }
            for &e in block {
                for node in [self.graph.edges[e].0, self.graph.edges[e].1] {
                    if n_blocks[node as usize] > 1 && self.component[e] >= 0 {
                        at_hinge.push((node as usize, self.component[e] as u32));
                    }
                }
            }
        }
        at_hinge.sort_unstable();
        at_hinge.dedup();
        let hinges = (0..self.graph.n_nodes).filter(|&node| joined[node] > 1);
        hinges
            .map(|node| {
                let mut cause = self.cause_of(CauseKind::WeakJoin, self.shares_only(&[node]), vec![node]);
                let start = at_hinge.partition_point(|&(other, _)| other < node);
                let here = at_hinge[start..].iter().take_while(|&&(other, _)| other == node);
                cause.components = here.map(|&(_, component)| component).collect();
                cause
            })
            .collect()
    }

    /// Chains of single rays between blocks.
    fn bridges(&self, edges: &[usize], n_blocks: &[u32]) -> Vec<Cause> {
        let mut sets = Sets::new(self.graph.n_nodes);
        for &e in edges {
            sets.unite(self.graph.edges[e].0 as usize, self.graph.edges[e].1 as usize);
        }
        let groups = grouped(edges.iter().copied(), |e| sets.find(self.graph.edges[e].0 as usize));
        let mut causes = Vec::new();
        for group in groups {
            let nodes = self.nodes_of(group.iter().copied());
            let (ends, between): (Vec<usize>, Vec<usize>) = nodes.iter().partition(|&&node| n_blocks[node] > 0);
            // the last segment of a part that fell to pieces joins nothing
            if ends.len() < 2 {
                continue;
            }
            let taken: usize = between.iter().map(|&node| self.freedoms.member(self.graph.is_view(node))).sum();
            let constraints = (group.len() * self.freedoms.ray()).saturating_sub(taken);
            let detail = self.constraint_words(constraints, ends.len());
            let mut cause = self.cause_of(CauseKind::WeakJoin, detail, nodes);
            cause.components = ends.iter().flat_map(|&node| self.components_of(node)).collect();
            cause.components.sort_unstable();
            cause.components.dedup();
            causes.push(cause);
        }
        causes
    }

    fn constraint_words(&self, constraints: usize, n_parts: usize) -> String {
        let needed = (n_parts - 1) * self.freedoms.part();
        let among = if n_parts > 2 { format!(" among {n_parts} parts") } else { String::new() };
        let special = if constraints >= needed { ", not independent" } else { "" };
        format!("{constraints} of {needed} constraints{among}{special}")
    }

    /// "shares only view 10", "shares only tracks 3, 4".
    fn shares_only(&self, nodes: &[usize]) -> String {
        let (views, tracks) = self.graph.split(nodes.iter().copied());
        let words = |what: &str, ids: &[u32]| {
            let names: Vec<String> = ids.iter().map(u32::to_string).collect();
            format!("{what}{} {}", if ids.len() == 1 { "" } else { "s" }, names.join(", "))
        };
        let shared = match (views.is_empty(), tracks.is_empty()) {
            (false, false) => [words("view", &views), words("track", &tracks)].join(" and "),
            (false, true) => words("view", &views),
            _ => words("track", &tracks),
        };
        format!("shares only {shared}")
    }

    // ---- inside one block -------------------------------------------------------------------------------------------

    fn inside_block(&self, block: &[usize], loose: &Loose) -> Vec<Cause> {
        let firm: Vec<usize> = block.iter().copied().filter(|&e| self.is_firm(e, loose)).collect();
        let components = self.components_on(firm.iter().copied());
        let is_rigid = components.len() == 1 && firm.iter().all(|&e| self.component[e] >= 0);
        if firm.is_empty() || is_rigid {
            return Vec::new();
        }
        let nodes = self.nodes_of(firm.iter().copied());
        let mut causes = self.shapes_of(&nodes);
        if causes.is_empty() {
            causes = Inside::new(self, block, loose).causes();
        } else {
            causes.iter_mut().for_each(|cause| cause.components.clone_from(&components));
        }
        if causes.is_empty() {
            let mut cause = self.cause_of(CauseKind::Other, "", nodes);
            cause.components = components;
            causes.push(cause);
        }
        causes
    }
}

/// Rigid parts of a block, and clusters: observations of no part that hang together through members of no part.
struct Inside<'a, const D: usize> {
    naming: &'a Naming<'a, D>,
    loose: &'a Loose,
    /// Components of the block. Further parts are clusters that a shape explains.
    components: Vec<u32>,
    n_parts: usize,
    /// (node, part), sorted.
    membership: Vec<(usize, usize)>,
    clusters: Vec<Vec<usize>>,
    causes: Vec<Cause>,
}

impl<'a, const D: usize> Inside<'a, D> {
    fn new(naming: &'a Naming<'a, D>, block: &[usize], loose: &'a Loose) -> Self {
        let components = naming.components_on(block.iter().copied());
        let nodes = naming.nodes_of(block.iter().copied());
        let mut membership = Vec::new();
        for &node in &nodes {
            let parts = naming.components_of(node).filter_map(|c| components.binary_search(&c).ok());
            membership.extend(parts.map(|part| (node, part)));
        }
        let n_parts = components.len();
        let mut inside =
            Self { naming, loose, components, n_parts, membership, clusters: Vec::new(), causes: Vec::new() };
        inside.clusters = inside.find_clusters(block, &nodes);
        inside
    }

    fn parts_of(&self, node: usize) -> impl Iterator<Item = usize> {
        let start = self.membership.partition_point(|&(other, _)| other < node);
        self.membership[start..].iter().take_while(move |(other, _)| *other == node).map(|&(_, part)| part)
    }

    fn is_free(&self, node: usize) -> bool {
        self.parts_of(node).next().is_none()
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
                sets.unite(slot, nodes.len() + k);
            }
        }
        let groups = grouped(0..alone.len(), |k| sets.find(nodes.len() + k));
        groups.into_iter().map(|group| group.into_iter().map(|k| alone[k]).collect()).collect()
    }

    fn causes(mut self) -> Vec<Cause> {
        let named: Vec<bool> = (0..self.clusters.len()).map(|k| self.name_shape(k)).collect();
        let mut links = self.hinges();
        for k in (0..self.clusters.len()).filter(|&k| !named[k]) {
            links.extend(self.count(k));
        }
        self.weak_joins(&links);
        self.causes
    }

    /// Is the cluster on a shape that leaves it flexible? Then it is named, and a part from now on.
    fn name_shape(&mut self, k: usize) -> bool {
        let cluster = &self.clusters[k];
        let nodes = self.naming.nodes_of(cluster.iter().copied());
        let n_views = nodes.partition_point(|&node| self.naming.graph.is_view(node));
        let smaller = n_views.min(nodes.len() - n_views);
        let has_circuit = cluster.len() >= nodes.len();
        let parts = self.touched(&nodes);
        // in space an observation of the part itself may close the circuit of two views and two points
        let fits = if smaller == 2 { parts.len() < 2 && (has_circuit || D == 3) } else { smaller > 2 && has_circuit };
        if !fits {
            return false;
        }
        let mut found = self.naming.shapes_of(&nodes);
        for cause in &mut found {
            cause.components = self.component_ids(&parts);
        }
        if found.is_empty() {
            return false;
        }
        self.causes.extend(found);
        self.membership.extend(nodes.into_iter().map(|node| (node, self.n_parts)));
        self.membership.sort_unstable();
        self.n_parts += 1;
        true
    }

    /// One part for each of these nodes that is a member of any.
    fn touched(&self, nodes: &[usize]) -> Vec<usize> {
        let mut parts: Vec<usize> = nodes.iter().filter_map(|&node| self.parts_of(node).next()).collect();
        parts.sort_unstable();
        parts.dedup();
        parts
    }

    fn component_ids(&self, parts: &[usize]) -> Vec<u32> {
        parts.iter().filter_map(|&part| self.components.get(part).copied()).collect()
    }

    fn hinges(&self) -> Vec<Link> {
        let shared = self.membership.chunk_by(|a, b| a.0 == b.0).filter(|parts| parts.len() > 1);
        shared
            .map(|parts| {
                let node = parts[0].0;
                let each = self.naming.freedoms.member(self.naming.graph.is_view(node));
                Link {
                    nodes: vec![node],
                    parts: parts.iter().map(|&(_, part)| part).collect(),
                    constraints: (parts.len() - 1) * each,
                    is_hinge: true,
                }
            })
            .collect()
    }

    /// A cluster with fewer equations than unknowns is a cause, another one between parts a link.
    fn count(&mut self, k: usize) -> Option<Link> {
        let (naming, cluster) = (self.naming, &self.clusters[k]);
        let nodes = naming.nodes_of(cluster.iter().copied());
        let parts = self.touched(&nodes);
        let freedoms_of =
            |&node: &usize| naming.freedoms.member(naming.graph.is_view(node)) - usize::from(self.loose.sliding[node]);
        let taken: usize = nodes.iter().filter(|&&node| self.is_free(node)).map(freedoms_of).sum();
        let unknowns = if parts.is_empty() { taken.saturating_sub(naming.freedoms.part()) } else { taken };
        let equations = cluster.len() * naming.freedoms.ray();
        if equations < unknowns {
            let detail = format!("{} for {}", count_of(equations, "equation"), count_of(unknowns, "unknown"));
            let mut cause = naming.cause_of(CauseKind::TooFewEquations, detail, nodes);
            cause.components = self.component_ids(&parts);
            self.causes.push(cause);
            return None;
        }
        (parts.len() > 1).then(|| Link { nodes, parts, constraints: equations - taken, is_hinge: false })
    }

    fn weak_joins(&mut self, links: &[Link]) {
        let found = joins(self.n_parts, links);
        let is_short = |join: &Join| join.constraints < (join.parts.len() - 1) * self.naming.freedoms.part();
        let explained = !self.causes.is_empty() || found.iter().any(is_short);
        for join in found.iter().filter(|join| is_short(join) || !explained) {
            let nodes: Vec<usize> = join.links.iter().flat_map(|&k| links[k].nodes.iter().copied()).collect();
            let only_hinges = join.parts.len() == 2 && join.links.iter().all(|&k| links[k].is_hinge);
            let detail = if only_hinges && nodes.len() <= MOST_NAMES {
                self.naming.shares_only(&nodes)
            } else {
                self.naming.constraint_words(join.constraints, join.parts.len())
            };
            let mut cause = self.naming.cause_of(CauseKind::WeakJoin, detail, nodes);
            cause.components = self.component_ids(&join.parts);
            self.causes.push(cause);
        }
    }
}

/// Causes in the order of their kinds, very many of a kind as one.
fn condensed(mut causes: Vec<Cause>) -> Vec<Cause> {
    causes.sort_by(|a, b| (a.kind, &a.views, &a.tracks).cmp(&(b.kind, &b.views, &b.tracks)));
    let mut all = Vec::new();
    for group in causes.chunk_by(|a, b| a.kind == b.kind) {
        if group.len() <= MOST_OF_A_KIND {
            all.extend_from_slice(group);
            continue;
        }
        let mut one = Cause::new(group[0].kind, format!("{} of this kind", group.len()));
        one.views = union(group, |cause| &cause.views);
        one.tracks = union(group, |cause| &cause.tracks);
        one.components = union(group, |cause| &cause.components);
        one.is_exact = group.iter().all(|cause| cause.is_exact);
        all.push(one);
    }
    all
}

fn union(group: &[Cause], ids: impl Fn(&Cause) -> &Vec<u32>) -> Vec<u32> {
    let mut all: Vec<u32> = group.iter().flat_map(|cause| ids(cause).iter().copied()).collect();
    all.sort_unstable();
    all.dedup();
    all
}
