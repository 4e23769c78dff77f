//! Which views and tracks share one scale: a cheap sufficient test, by growth and by counting.
//!
//! A *body* is a set of views and tracks whose shape is fixed up to translation and scale. A small body is found with the
//! (d, d + 1) pebble game, the generic count for directions (Whiteley; Lee and Streinu 2008), and then grown: a track seen
//! by two of its views along rays that are not parallel belongs to it, and so does a view that sees two of its tracks.
//! Bodies that share two members are one. Two bodies are joined by rank: one may still shift and grow against the other,
//! d + 1 freedoms, of which a common member takes d, a ray from one onto a track of the other d - 1, and a track seen once
//! from each d - 2; whether they take the same ones is found at positions drawn at random.
//!
//! All this is generic: coincidences of the actual positions (conics, coplanar scenes) are left to the certificate.

use std::collections::{BTreeMap, VecDeque};

use crate::geometry::{Vector, dot, normalized, sub, tangent_basis};
use crate::lists::Lists;

/// Rays nearer to parallel than this (or to antiparallel) fix no distance, in radians.
pub(super) const PARALLEL_RAD: f64 = 1e-7;
/// Views and tracks among which a first body is sought, in turn.
const NEIGHBOURHOODS: [(usize, usize); 3] = [(6, 24), (40, 240), (300, 1_500)];
/// Observations a view lends to the first, quick attempt.
const QUICK_OBSERVATIONS: usize = 48;

/// Observations as the test sees them.
pub(super) struct Sightings<'a, const D: usize> {
    pub n_views: usize,
    pub n_tracks: usize,
    pub view: &'a [u32],
    pub track: &'a [u32],
    /// World direction of each observation.
    pub direction: &'a [Vector<D>],
    /// Rays must be farther from parallel than this to count.
    pub parallel_rad: f64,
}

/// Bodies, the one with most views first.
pub(super) struct Parts {
    /// Views of each part in ascending order; a hinge stands in more than one.
    pub views: Vec<Vec<u32>>,
    /// Tracks of each part in ascending order.
    pub tracks: Vec<Vec<u32>>,
}

/// Squared sine of the angle between two unit vectors.
fn squared_sine<const D: usize>(a: &Vector<D>, b: &Vector<D>) -> f64 {
    let cosine = dot(a, b);
    let across: Vector<D> = std::array::from_fn(|c| b[c] - cosine * a[c]);
    dot(&across, &across)
}

/// Are the rays of two observations farther from parallel (and antiparallel) than `parallel_rad`?
fn crossing<const D: usize>(seen: &Sightings<'_, D>, a: u32, b: u32, parallel_rad: f64) -> bool {
    squared_sine(&seen.direction[a as usize], &seen.direction[b as usize]) > parallel_rad.powi(2)
}

/// Splits the input into jointly scaled parts, using only the observations for which `keep` holds.
pub(super) fn jointly_scaled_parts<const D: usize>(seen: &Sightings<'_, D>, keep: &[bool]) -> Parts {
    let stride = (seen.view.len() / (QUICK_OBSERVATIONS * seen.n_views.max(1))).max(1);
    if stride > 1 {
        let quick = Search::new(seen, |o| keep[o] && (seen.track[o] as usize).is_multiple_of(stride)).bodies();
        if quick.len() == 1 && spans_all_views(seen, keep, &quick[0]) {
            return single_part(seen, keep);
        }
    }
    let search = Search::new(seen, |o| keep[o]);
    let bodies = join_by_rank(&search, search.bodies());
    in_order_of_size(search, bodies)
}

/// Does the body hold every view that can be held at all, one with at least two kept observations?
fn spans_all_views<const D: usize>(seen: &Sightings<'_, D>, keep: &[bool], body: &Body) -> bool {
    let mut count = vec![0u32; seen.n_views];
    for (o, &view) in seen.view.iter().enumerate() {
        count[view as usize] += u32::from(keep[o]);
    }
    body.views.len() == count.iter().filter(|&&c| c >= 2).count()
}

/// All views with two kept observations, and all tracks with two kept rays that are not parallel.
pub(super) fn single_part<const D: usize>(seen: &Sightings<'_, D>, keep: &[bool]) -> Parts {
    let mut count = vec![0u32; seen.n_views];
    let mut first = vec![u32::MAX; seen.n_tracks];
    let mut crossed = vec![false; seen.n_tracks];
    for (o, (&view, &track)) in seen.view.iter().zip(seen.track).enumerate().filter(|(o, _)| keep[*o]) {
        count[view as usize] += 1;
        let track = track as usize;
        if first[track] == u32::MAX {
            first[track] = o as u32;
        } else if !crossed[track] {
            crossed[track] =
                view != seen.view[first[track] as usize] && crossing(seen, first[track], o as u32, PARALLEL_RAD);
        }
    }
    let views = (0..seen.n_views as u32).filter(|&v| count[v as usize] >= 2).collect();
    let tracks = (0..seen.n_tracks as u32).filter(|&t| crossed[t as usize]).collect();
    Parts { views: vec![views], tracks: vec![tracks] }
}

#[derive(Clone, Default)]
struct Body {
    views: Vec<u32>,
    tracks: Vec<u32>,
}

impl Body {
    fn len(&self) -> usize {
        self.views.len() + self.tracks.len()
    }
}

/// Nodes are numbered views first, then tracks.
struct Search<'a, const D: usize> {
    seen: &'a Sightings<'a, D>,
    parallel_rad: f64,
    by_view: Lists,
    by_track: Lists,
}

const NONE: u32 = u32::MAX;

/// What one growth has reached.
struct Growth {
    /// Growth that reached each node last.
    reached: Vec<u32>,
    /// First ray onto each node from the body, and the growth it belongs to.
    first_ray: Vec<(u32, u32)>,
    stamp: u32,
    queue: VecDeque<u32>,
}

impl<'a, const D: usize> Search<'a, D> {
    fn new(seen: &'a Sightings<'a, D>, keep: impl Fn(usize) -> bool) -> Self {
        let kept = (0..seen.view.len()).filter(|&o| keep(o));
        let at = |of: &[u32], n: usize| Lists::new(n, kept.clone().map(|o| (of[o], o as u32)));
        Self {
            seen,
            parallel_rad: seen.parallel_rad,
            by_view: at(seen.view, seen.n_views),
            by_track: at(seen.track, seen.n_tracks),
        }
    }

    fn observations(&self, node: usize) -> &[u32] {
        if node < self.seen.n_views { self.by_view.of(node) } else { self.by_track.of(node - self.seen.n_views) }
    }

    /// The node at the other end of observation `o`.
    fn other_end(&self, o: u32, from: usize) -> usize {
        if from < self.seen.n_views {
            self.seen.n_views + self.seen.track[o as usize] as usize
        } else {
            self.seen.view[o as usize] as usize
        }
    }

    /// Bodies that cover as many views as can be covered; two of them share at most one member.
    fn bodies(&self) -> Vec<Body> {
        let n_nodes = self.seen.n_views + self.seen.n_tracks;
        let mut growth = Growth {
            reached: vec![NONE; n_nodes],
            first_ray: vec![(NONE, 0); n_nodes],
            stamp: 0,
            queue: VecDeque::new(),
        };
        let mut order: Vec<u32> = (0..self.seen.n_views as u32).collect();
        order.sort_by_key(|&v| (usize::MAX - self.by_view.of(v as usize).len(), v));
        let mut bodies: Vec<Option<Body>> = Vec::new();
        let mut member_of: Vec<Vec<u32>> = vec![Vec::new(); n_nodes];
        for &view in &order {
            if !member_of[view as usize].is_empty() {
                continue;
            }
            let Some(seed) = NEIGHBOURHOODS.iter().find_map(|&(v, t)| self.seed(view as usize, v, t)) else { continue };
            let nodes = self.grow(&seed, &mut growth, &mut bodies, &mut member_of);
            let id = bodies.len() as u32;
            let mut body = Body::default();
            for node in nodes {
                member_of[node].push(id);
                if node < self.seen.n_views {
                    body.views.push(node as u32);
                } else {
                    body.tracks.push((node - self.seen.n_views) as u32);
                }
            }
            bodies.push(Some(body));
        }
        bodies.into_iter().flatten().collect()
    }

    /// Grows a body from its seed as far as it goes, swallowing every earlier body that it shares two members with.
    fn grow(
        &self,
        seed: &[usize],
        growth: &mut Growth,
        bodies: &mut [Option<Body>],
        member_of: &mut [Vec<u32>],
    ) -> Vec<usize> {
        let stamp = growth.stamp;
        growth.stamp += 1;
        let mut nodes = Vec::new();
        let mut shared: BTreeMap<u32, u32> = BTreeMap::new();
        growth.queue.extend(seed.iter().map(|&n| n as u32));
        while let Some(node) = growth.queue.pop_front() {
            let node = node as usize;
            if growth.reached[node] == stamp {
                continue;
            }
            growth.reached[node] = stamp;
            nodes.push(node);
            for id in std::mem::take(&mut member_of[node]) {
                if bodies[id as usize].is_none() {
                    continue;
                }
                member_of[node].push(id);
                let count = shared.entry(id).or_insert(0);
                *count += 1;
                if *count == 2
                    && let Some(swallowed) = bodies[id as usize].take()
                {
                    growth.queue.extend(swallowed.views.iter());
                    growth.queue.extend(swallowed.tracks.iter().map(|&t| t + self.seen.n_views as u32));
                }
            }
            for &o in self.observations(node) {
                let target = self.other_end(o, node);
                if growth.reached[target] == stamp {
                    continue;
                }
                let (owner, ray) = growth.first_ray[target];
                if owner != stamp {
                    growth.first_ray[target] = (stamp, o);
                } else if self.independent(ray, o) {
                    growth.queue.push_back(target as u32);
                }
            }
        }
        nodes
    }

    /// Two rays onto one node fix it: they come from different nodes and are not parallel.
    fn independent(&self, a: u32, b: u32) -> bool {
        let (i, j) = (a as usize, b as usize);
        (self.seen.view[i] != self.seen.view[j] || self.seen.track[i] != self.seen.track[j])
            && crossing(self.seen, a, b, self.parallel_rad)
    }

    /// A small body around a view, by the pebble game on its neighbourhood.
    fn seed(&self, view: usize, max_views: usize, max_tracks: usize) -> Option<Vec<usize>> {
        let neighbours = self.most_linked(view, max_views);
        let mut views = vec![view];
        views.extend(&neighbours);
        let mut votes: BTreeMap<u32, u32> = BTreeMap::new();
        for &v in &views {
            for &o in self.by_view.of(v).iter().take(8 * max_tracks) {
                *votes.entry(self.seen.track[o as usize]).or_insert(0) += 1;
            }
        }
        let mut tracks: Vec<(u32, u32)> = votes.into_iter().filter(|&(_, n)| n >= 2).map(|(t, n)| (n, t)).collect();
        tracks.sort_by_key(|&(n, t)| (u32::MAX - n, t));
        tracks.truncate(max_tracks);
        let mut local: BTreeMap<usize, usize> = views.iter().enumerate().map(|(i, &v)| (v, i)).collect();
        let mut nodes = views.clone();
        for &(_, t) in &tracks {
            local.insert(self.seen.n_views + t as usize, nodes.len());
            nodes.push(self.seen.n_views + t as usize);
        }
        let mut game = PebbleGame::<D>::new(nodes.len());
        for &node in &nodes[views.len()..] {
            let rays = self.observations(node);
            // a track whose rays are all parallel ties nothing down
            if !rays.iter().any(|&o| self.independent(rays[0], o)) {
                continue;
            }
            let mut last = NONE;
            for &o in rays {
                let v = self.seen.view[o as usize];
                if v != last
                    && let Some(&i) = local.get(&(v as usize))
                {
                    game.insert(i, local[&node]);
                }
                last = v;
            }
        }
        let n_views = views.len();
        let body = (1..n_views).find_map(|partner| game.body_of(0, partner))?;
        let enough = body.iter().filter(|&&i| i >= n_views).count() >= 2;
        enough.then(|| body.into_iter().map(|i| nodes[i]).collect())
    }

    /// The views that share most tracks with a view.
    fn most_linked(&self, view: usize, limit: usize) -> Vec<usize> {
        let mut shared: BTreeMap<u32, u32> = BTreeMap::new();
        for &o in self.by_view.of(view).iter().take(512) {
            for &p in self.by_track.of(self.seen.track[o as usize] as usize) {
                let other = self.seen.view[p as usize];
                if other as usize != view && crossing(self.seen, o, p, self.parallel_rad) {
                    *shared.entry(other).or_insert(0) += 1;
                }
            }
        }
        let mut ranked: Vec<(u32, u32)> = shared.into_iter().map(|(v, n)| (n, v)).collect();
        ranked.sort_by_key(|&(n, v)| (u32::MAX - n, v));
        ranked.into_iter().take(limit).map(|(_, v)| v as usize).collect()
    }
}

/// The (D, D + 1) pebble game on a graph whose edges count D - 1 times each.
struct PebbleGame<const D: usize> {
    free: Vec<usize>,
    /// Heads of the arcs that leave each node, one for each pebble it has spent.
    out: Vec<Vec<usize>>,
}

impl<const D: usize> PebbleGame<D> {
    fn new(n: usize) -> Self {
        Self { free: vec![D; n], out: vec![Vec::new(); n] }
    }

    fn insert(&mut self, a: usize, b: usize) {
        for _ in 0..D - 1 {
            if self.gather(a, b) < D + 2 {
                return;
            }
            let (tail, head) = if self.free[a] > 0 { (a, b) } else { (b, a) };
            self.free[tail] -= 1;
            self.out[tail].push(head);
        }
    }

    /// Brings as many pebbles as it can onto `a` and `b`; returns how many lie there.
    fn gather(&mut self, a: usize, b: usize) -> usize {
        for (target, fixed) in [(a, b), (b, a)] {
            while self.free[target] < D && self.fetch(target, fixed) {}
        }
        self.free[a] + self.free[b]
    }

    /// Reverses a path from `target` to a free pebble, not taking one from `fixed`.
    fn fetch(&mut self, target: usize, fixed: usize) -> bool {
        let mut from = vec![usize::MAX; self.free.len()];
        from[target] = target;
        let mut stack = vec![target];
        while let Some(node) = stack.pop() {
            for k in 0..self.out[node].len() {
                let next = self.out[node][k];
                if from[next] != usize::MAX || next == fixed {
                    continue;
                }
                from[next] = node;
                if self.free[next] > 0 {
                    self.free[next] -= 1;
                    self.free[target] += 1;
                    self.reverse_path(&from, target, next);
                    return true;
                }
                stack.push(next);
            }
        }
        false
    }

    fn reverse_path(&mut self, from: &[usize], target: usize, end: usize) {
        let mut head = end;
        while head != target {
            let tail = from[head];
            if let Some(k) = self.out[tail].iter().position(|&n| n == head) {
                self.out[tail].swap_remove(k);
            }
            self.out[head].push(tail);
            head = tail;
        }
    }

    /// Nodes rigidly joined to both `a` and `b`, where these are joined to each other.
    fn body_of(&mut self, a: usize, b: usize) -> Option<Vec<usize>> {
        if self.gather(a, b) > D + 1 {
            return None;
        }
        let n = self.free.len();
        let others = (0..n).filter(|&i| i != a && i != b);
        let mut body = vec![a, b];
        for i in others.collect::<Vec<_>>() {
            if self.gather(a, i) == D + 1 && self.gather(b, i) == D + 1 {
                body.push(i);
            }
        }
        Some(body)
    }
}

/// Joins bodies that can neither shift nor grow against each other, until nothing changes.
fn join_by_rank<const D: usize>(search: &Search<'_, D>, mut bodies: Vec<Body>) -> Vec<Body> {
    while bodies.len() > 1 {
        let joins = constraints_between(search, &bodies);
        let Some((&(a, b), _)) = joins.iter().find(|(_, rows)| rows.len() == D + 1) else { break };
        let joined = bodies.swap_remove(b);
        let target = &mut bodies[a];
        target.views.extend(joined.views);
        target.tracks.extend(joined.tracks);
        absorb_tracks(search, target);
    }
    bodies
}

/// Independent constraints on the motion `x -> tau + varsigma x` of the second body of each pair against the first, as
/// orthonormal rows over `(tau, varsigma)`.
type Joins = BTreeMap<(usize, usize), Vec<[f64; 4]>>;

/// Keeps `normal^T (tau + varsigma x) = 0` where it is independent of what is known.
fn constrain<const D: usize>(joins: &mut Joins, a: usize, b: usize, normal: &Vector<D>, x: &Vector<D>) {
    if a == b {
        return;
    }
    let rows = joins.entry((a.min(b), a.max(b))).or_default();
    let mut row = [0.0; 4];
    row[..D].copy_from_slice(normal);
    row[D] = dot(normal, x);
    let before = dot(&row, &row);
    for known in rows.iter() {
        let along = dot(known, &row);
        row = std::array::from_fn(|c| row[c] - along * known[c]);
    }
    let after = dot(&row, &row);
    if after > 1e-12 * before {
        rows.push(row.map(|x| x / after.sqrt()));
    }
}

/// A position drawn at random, but the same on every run.
fn random_position<const D: usize>(node: usize) -> Vector<D> {
    std::array::from_fn(|c| {
        let mut z = (node * D + c) as u64;
        z = (z ^ 0x9E37_79B9_7F4A_7C15).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    })
}

/// Constraints between each pair of bodies.
fn constraints_between<const D: usize>(search: &Search<'_, D>, bodies: &[Body]) -> Joins {
    let n_views = search.seen.n_views;
    let mut home: Vec<Vec<usize>> = vec![Vec::new(); n_views + search.seen.n_tracks];
    for (id, body) in bodies.iter().enumerate() {
        let tracks = body.tracks.iter().map(|&t| t as usize + n_views);
        body.views.iter().map(|&v| v as usize).chain(tracks).for_each(|node| home[node].push(id));
    }
    let mut joins = Joins::new();
    for (node, members) in home.iter().enumerate() {
        for (i, &a) in members.iter().enumerate() {
            for &b in &members[..i] {
                for c in 0..D {
                    let axis = std::array::from_fn(|r| if r == c { 1.0 } else { 0.0 });
                    constrain::<D>(&mut joins, a, b, &axis, &random_position(node));
                }
            }
        }
    }
    for t in 0..search.seen.n_tracks {
        let track = n_views + t;
        let sightings = search.by_track.of(t).iter().map(|&o| search.seen.view[o as usize] as usize);
        let from: Vec<(usize, usize)> =
            sightings.filter(|&v| home[v].len() == 1).map(|view| (home[view][0], view)).collect();
        match home[track].as_slice() {
            [] => link_two_views::<D>(&mut joins, &from, track),
            [only] => {
                from.iter().for_each(|&(body, view)| ray_onto_track::<D>(&mut joins, (body, view), (*only, track)))
            }
            _ => {}
        }
    }
    joins
}

/// The ray of a view of one body onto a track of another: no motion across it.
fn ray_onto_track<const D: usize>(joins: &mut Joins, view: (usize, usize), track: (usize, usize)) {
    let moving = if view.0 > track.0 { view.1 } else { track.1 };
    let (x, c) = (random_position::<D>(track.1), random_position::<D>(view.1));
    let along = normalized(&sub(&x, &c));
    for across in tangent_basis(&along).iter().take(D - 1) {
        constrain::<D>(joins, view.0, track.0, across, &random_position(moving));
    }
}

/// A track seen once from each of two bodies keeps its two rays in one plane; in the plane it says nothing.
fn link_two_views<const D: usize>(joins: &mut Joins, from: &[(usize, usize)], track: usize) {
    let [(a, view_a), (b, view_b)] = from else { return };
    if D == 3 && a != b {
        let x = random_position::<D>(track);
        let (u, v) = (sub(&x, &random_position(*view_a)), sub(&x, &random_position(*view_b)));
        let normal = std::array::from_fn(|c| u[(c + 1) % D] * v[(c + 2) % D] - u[(c + 2) % D] * v[(c + 1) % D]);
        let moving = if b > a { view_b } else { view_a };
        constrain::<D>(joins, *a, *b, &normal, &random_position(*moving));
    }
}

/// Adds the tracks that two views of the body see along rays that are not parallel.
fn absorb_tracks<const D: usize>(search: &Search<'_, D>, body: &mut Body) {
    body.views.sort_unstable();
    body.views.dedup();
    let mut first = vec![NONE; search.seen.n_tracks];
    let mut tracks: Vec<u32> = std::mem::take(&mut body.tracks);
    for &v in &body.views {
        for &o in search.by_view.of(v as usize) {
            let t = search.seen.track[o as usize] as usize;
            if first[t] == NONE {
                first[t] = o;
            } else if search.independent(first[t], o) {
                tracks.push(t as u32);
            }
        }
    }
    tracks.sort_unstable();
    tracks.dedup();
    body.tracks = tracks;
}

/// Most views first; tracks near the noise in parallax are taken in as well.
fn in_order_of_size<const D: usize>(mut search: Search<'_, D>, mut bodies: Vec<Body>) -> Parts {
    search.parallel_rad = PARALLEL_RAD;
    for body in &mut bodies {
        absorb_tracks(&search, body);
    }
    bodies.sort_by_key(|b| (usize::MAX - b.views.len(), usize::MAX - b.len(), b.views.first().copied()));
    let (views, tracks) = bodies.into_iter().map(|b| (b.views, b.tracks)).unzip();
    Parts { views, tracks }
}
