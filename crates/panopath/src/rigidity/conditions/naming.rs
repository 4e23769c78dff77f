//! Names for what a numerical test found free, from who sees whom, where things are, and which observations are rigid.
//!
//! From the outside in: parts that nothing ties; members that hang loose by themselves; blocks, which hold each other at one
//! member only; inside a block the shapes, then rigid parts and what is between them, counted.

use super::arrangement::Arrangement;
use super::blocks::blocks;
use super::graph::{Graph, edges_at, grouped};
use super::inside::Inside;
use super::joins::Freedoms;
use super::loose::Loose;
use super::{Cause, CauseKind, Flexibility, Sightings, count_of};
use crate::geometry::{Vector, norm, sub};
use crate::sets::Sets;

/// More causes of one kind than this are told as one.
const MOST_OF_A_KIND: usize = 32;

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
        naming.freedoms,
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

/// A scene, what was found of it, and how to speak of it.
pub(super) struct Naming<'a, const D: usize> {
    pub graph: Graph<'a, D>,
    /// Rigid component of each observation, -1 where it is alone.
    pub component: &'a [i32],
    /// (node, component), sorted: which components each node is a member of.
    membership: Vec<(u32, u32)>,
    pub freedoms: Freedoms,
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
            freedoms: Freedoms::new(D, found.free_orientation, found.gauge_freedoms),
            tolerance,
        }
    }

    pub(super) fn components_of(&self, node: usize) -> impl Iterator<Item = u32> {
        let start = self.membership.partition_point(|&(other, _)| (other as usize) < node);
        self.membership[start..].iter().take_while(move |(other, _)| *other as usize == node).map(|&(_, c)| c)
    }

    /// Ends of these observations, ascending.
    pub(super) fn nodes_of(&self, edges: impl IntoIterator<Item = usize>) -> Vec<usize> {
        let mut nodes: Vec<usize> =
            edges.into_iter().flat_map(|e| [self.graph.edges[e].0 as usize, self.graph.edges[e].1 as usize]).collect();
        if nodes.len() > self.graph.n_nodes {
            // marks are faster than sorting where most nodes are met
            let mut is_met = vec![false; self.graph.n_nodes];
            nodes.iter().for_each(|&node| is_met[node] = true);
            return (0..self.graph.n_nodes).filter(|&node| is_met[node]).collect();
        }
        nodes.sort_unstable();
        nodes.dedup();
        nodes
    }

    /// Components of these observations, ascending.
    pub(super) fn components_on(&self, edges: impl IntoIterator<Item = usize>) -> Vec<u32> {
        let mut found: Vec<u32> = edges.into_iter().filter_map(|e| u32::try_from(self.component[e]).ok()).collect();
        // long runs of one component are the rule
        found.dedup();
        found.sort_unstable();
        found.dedup();
        found
    }

    pub(super) fn cause_of(&self, kind: CauseKind, detail: impl Into<String>, nodes: Vec<usize>) -> Cause {
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
                sets.join(view as usize, track as usize);
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

    /// A part of one view, of one point, of views or points at one place; without orientations, of two views or points of a plane.
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
        let (views, tracks) = nodes.split_at(n_views);
        let pair = self.freedoms.is_turning() && (n_views == 2 || n_tracks == 2);
        let is_special = pair || self.are_at_one_place(views, tracks) || self.are_at_one_place(tracks, views);
        if is_special { self.shapes_of(nodes) } else { Vec::new() }
    }

    /// Are these within the tolerance of each other, as the nearest of the others sees them? Far ones are no measure.
    fn are_at_one_place(&self, these: &[usize], others: &[usize]) -> bool {
        let first = self.graph.position(these[0]);
        let distance = |&node: &usize| norm(&sub(self.graph.position(node), first));
        let spread = these.iter().map(distance).fold(0.0, f64::max);
        let nearest = others.iter().map(distance).filter(|&r| r > 0.0).fold(f64::INFINITY, f64::min);
        spread <= self.tolerance * nearest
    }

    /// The special shape that all these members lie on.
    pub(super) fn shapes_of(&self, nodes: &[usize]) -> Vec<Cause> {
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
        let found = blocks(graph.n_nodes, &graph.edges, &edges_at(graph.n_nodes, &graph.edges, keep));
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
            sets.join(self.graph.edges[e].0 as usize, self.graph.edges[e].1 as usize);
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
            let equations = group.len() * self.freedoms.ray();
            let mut detail = self.constraint_words(equations.saturating_sub(taken), ends.len());
            if taken > equations {
                detail.push_str(&format!(", {} loose in between", taken - equations));
            }
            let mut cause = self.cause_of(CauseKind::WeakJoin, detail, nodes);
            cause.components = ends.iter().flat_map(|&node| self.components_of(node)).collect();
            cause.components.sort_unstable();
            cause.components.dedup();
            causes.push(cause);
        }
        causes
    }

    pub(super) fn constraint_words(&self, constraints: usize, n_parts: usize) -> String {
        let needed = (n_parts - 1) * self.freedoms.body();
        let among = if n_parts > 2 { format!(" among {n_parts} parts") } else { String::new() };
        let special = if constraints >= needed { ", not independent" } else { "" };
        format!("{constraints} of {needed} constraints{among}{special}")
    }

    /// "shares only view 10", "shares only tracks 3, 4".
    pub(super) fn shares_only(&self, nodes: &[usize]) -> String {
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
