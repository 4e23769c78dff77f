//! Single members that hang loose: held by one ray, or by rays that all lie on one line.

use std::collections::VecDeque;

use super::graph::Graph;
use super::joins::Freedoms;
use super::shapes::Flat;
use super::{Cause, CauseKind, EXACT, count_of};
use crate::geometry::{Vector, dot, norm, normalized, scale, sub};

/// Members that are loose by themselves.
pub(super) struct Loose {
    /// Held by too few rays to hold anything in turn: removed, one after the other.
    pub hanging: Vec<bool>,
    /// Sees along one line only. It still ties others to that line.
    pub sliding: Vec<bool>,
    /// Observations that remain without those that hang.
    pub live: Vec<bool>,
}

/// Neighbours whose offsets across the ray are below this share of their spread are on one line with the member; others see
/// it from beside, and it is too far to tell the directions apart.
const ALONG: f64 = 0.01;

impl Loose {
    /// Looks everywhere but at the nodes to `skip`, whose parts are explained.
    pub(super) fn find<const D: usize>(
        graph: &Graph<'_, D>,
        component: &[i32],
        freedoms: Freedoms,
        skip: impl Fn(usize) -> bool,
        tolerance: f64,
    ) -> (Self, Vec<Cause>) {
        let n = graph.n_nodes;
        let mut loose = Self { hanging: vec![false; n], sliding: vec![false; n], live: graph.counts.clone() };
        let (mut causes, lined) = loose.peel(graph, freedoms, &skip, tolerance);
        causes.extend(loose.slide(graph, component, freedoms, &skip, tolerance, lined));
        (loose, causes)
    }

    /// Edges that are left at a node.
    pub(super) fn edges_at<'a, const D: usize>(
        &'a self,
        graph: &'a Graph<'_, D>,
        node: usize,
    ) -> impl Iterator<Item = u32> + 'a {
        graph.at.of(node).iter().copied().filter(|&e| self.live[e as usize])
    }

    /// Takes away what too few rays hold, until nothing more falls off. A last segment stays: a view and a point that see each
    /// other have no freedom but the gauge. Views of two points in line with them are given back: they have a name of their own.
    fn peel<const D: usize>(
        &mut self,
        graph: &Graph<'_, D>,
        freedoms: Freedoms,
        skip: &impl Fn(usize) -> bool,
        tolerance: f64,
    ) -> (Vec<Cause>, Vec<Slider>) {
        let needed = |node: usize| freedoms.rays(graph.is_view(node));
        let mut degree: Vec<usize> = (0..graph.n_nodes).map(|node| graph.at.of(node).len()).collect();
        // tracks before views: a view whose points hang on it alone is held by what remains
        let mut queue: VecDeque<usize> =
            (0..graph.n_nodes).rev().filter(|&node| (1..needed(node)).contains(&degree[node]) && !skip(node)).collect();
        let (mut hidden, mut short, mut lined) = (Vec::new(), Vec::new(), Vec::new());
        while let Some(node) = queue.pop_front() {
            if self.hanging[node] || degree[node] == 0 {
                continue;
            }
            let rays: Vec<u32> = self.edges_at(graph, node).collect();
            if rays.iter().all(|&e| degree[graph.other_end(e, node)] == 1) {
                continue;
            }
            self.hanging[node] = true;
            match Slider::find(graph, node, &rays, tolerance) {
                Some(slider) if slider.is_line => lined.push(slider),
                Some(_) => hidden.push(node),
                None => short.push(node),
            }
            for e in rays {
                self.live[e as usize] = false;
                let other = graph.other_end(e, node);
                degree[other] -= 1;
                if degree[other] > 0 && degree[other] < needed(other) {
                    queue.push_back(other);
                }
            }
            degree[node] = 0;
        }
        let mut causes = Vec::new();
        if !hidden.is_empty() {
            let mut cause = Cause::new(CauseKind::HiddenPoint, "");
            (cause.views, cause.tracks) = graph.split(hidden);
            cause.detail = one_ray_words(cause.views.len(), cause.tracks.len());
            causes.push(cause);
        }
        if !short.is_empty() {
            let mut cause = Cause::new(CauseKind::TooFewEquations, "");
            (cause.views, cause.tracks) = graph.split(short);
            cause.detail = format!("{} of two points, orientation unknown", count_of(cause.views.len(), "view"));
            causes.push(cause);
        }
        (causes, lined)
    }

    /// Finds what sees along one line only, among members no two of whose rays are known to be rigid to each other.
    fn slide<const D: usize>(
        &mut self,
        graph: &Graph<'_, D>,
        component: &[i32],
        freedoms: Freedoms,
        skip: &impl Fn(usize) -> bool,
        tolerance: f64,
        lined: Vec<Slider>,
    ) -> Vec<Cause> {
        let mut kinds: [Vec<Slider>; 4] = [Vec::new(), Vec::new(), Vec::new(), lined];
        let mut circles = Vec::new();
        for node in (0..graph.n_nodes).filter(|&node| !self.hanging[node] && !skip(node)) {
            let rays: Vec<u32> = self.edges_at(graph, node).collect();
            if rays.len() < 2 || is_held(graph, node, &rays, component, tolerance) {
                continue;
            }
            if let Some(slider) = Slider::find(graph, node, &rays, tolerance) {
                self.sliding[node] = true;
                kinds[2 * usize::from(graph.is_view(node)) + usize::from(slider.is_line)].push(slider);
            } else if D == 2
                && freedoms.is_turning()
                && graph.is_view(node)
                && let Some(cause) = danger_circle(graph, node, &rays, tolerance)
            {
                self.sliding[node] = true;
                join_circle(&mut circles, cause);
            }
        }
        let named = [
            (CauseKind::HiddenPoint, "point", "seen in one direction only"),
            (CauseKind::CameraCollinear, "point", ""),
            (CauseKind::HiddenPoint, "view", "that see in one direction only"),
            (CauseKind::PointCollinear, "view", ""),
        ];
        let causes = kinds.iter().zip(named).filter(|(sliders, _)| !sliders.is_empty());
        let mut causes: Vec<Cause> =
            causes.map(|(sliders, (kind, what, words))| sliding_cause(graph, sliders, kind, what, words)).collect();
        causes.extend(circles);
        causes
    }
}

fn sliding_cause<const D: usize>(
    graph: &Graph<'_, D>,
    sliders: &[Slider],
    kind: CauseKind,
    what: &str,
    words: &str,
) -> Cause {
    let mut cause = Cause::new(kind, [&count_of(sliders.len(), what), words].join(" ").trim_end());
    let mut nodes: Vec<usize> = sliders.iter().map(|slider| slider.node).collect();
    let largest = sliders.iter().map(|slider| slider.misfit).fold(0.0, f64::max);
    cause.is_exact = largest <= EXACT;
    if kind != CauseKind::HiddenPoint {
        nodes.extend(sliders.iter().flat_map(|slider| slider.ends.iter().copied()));
        let places: Vec<Vector<D>> = nodes.iter().map(|&node| *graph.position(node)).collect();
        // members of several lines have none in common
        let line = Flat::fit(&places).filter(|line| line.misfit(1) <= largest.max(EXACT));
        cause.shape = line.map_or_else(Vec::new, |line| line.line());
    }
    (cause.views, cause.tracks) = graph.split(nodes);
    cause
}

fn one_ray_words(n_views: usize, n_tracks: usize) -> String {
    let tracks = format!("{} of one ray", count_of(n_tracks, "point"));
    let views = format!("{} of one ray", count_of(n_views, "view"));
    match (n_views, n_tracks) {
        (0, _) => tracks,
        (_, 0) => views,
        _ => format!("{tracks}, {views}"),
    }
}

/// Are observations of two places in one rigid component?
fn is_held<const D: usize>(graph: &Graph<'_, D>, node: usize, rays: &[u32], component: &[i32], tolerance: f64) -> bool {
    let x = graph.position(node);
    let place = |ray: u32| graph.position(graph.other_end(ray, node));
    let apart = |a: u32, b: u32| norm(&sub(place(a), place(b))) > tolerance * norm(&sub(place(a), x));
    let of = |ray: u32| component[ray as usize];
    let alike = |a: u32, b: u32| of(a) >= 0 && of(a) == of(b) && apart(a, b);
    // most often the first ray tells already
    if rays.iter().any(|&ray| alike(rays[0], ray)) {
        return true;
    }
    let mut sorted: Vec<(i32, u32)> = rays.iter().map(|&ray| (of(ray), ray)).collect();
    sorted.sort_unstable();
    sorted.chunk_by(|a, b| a.0 == b.0).any(|group| group.iter().any(|&(_, ray)| alike(group[0].1, ray)))
}

/// A member that sees along one line only.
struct Slider {
    node: usize,
    /// What it sees.
    ends: Vec<usize>,
    /// Whether that lies along the line, rather than at one place or too far off.
    is_line: bool,
    /// Farthest end from the line, relative to the length of the longest ray.
    misfit: f64,
}

impl Slider {
    /// `None` where the rays differ in direction (sign aside).
    fn find<const D: usize>(graph: &Graph<'_, D>, node: usize, rays: &[u32], tolerance: f64) -> Option<Self> {
        let x = graph.position(node);
        let ends: Vec<usize> = rays.iter().map(|&e| graph.other_end(e, node)).collect();
        let from = |start: &Vector<D>| ends.iter().map(|&end| sub(graph.position(end), start)).collect::<Vec<_>>();
        let seen = from(x);
        let longest = seen.iter().fold([0.0; D], |a, b| if dot(b, b) > dot(&a, &a) { *b } else { a });
        let (length, along) = (norm(&longest), normalized(&longest));
        let across = |v: &Vector<D>| norm(&sub(v, &scale(dot(v, &along), &along)));
        let off = seen.iter().map(across).fold(0.0, f64::max);
        if off.is_nan() || off > tolerance * length {
            return None;
        }
        let spread = from(graph.position(ends[0]));
        let reach = spread.iter().map(norm).fold(0.0, f64::max);
        let beside = spread.iter().map(across).fold(0.0, f64::max);
        let is_line = reach > EXACT * length && beside <= ALONG * reach;
        Some(Self { node, ends, is_line, misfit: off / length })
    }
}

/// A view of unknown heading on one circle with all its points: it moves on the circle and turns, and sees the same angles.
fn danger_circle<const D: usize>(graph: &Graph<'_, D>, view: usize, rays: &[u32], tolerance: f64) -> Option<Cause> {
    let x = graph.position(view);
    // circles through the view are lines after an inversion about it
    let inverted: Vec<[f64; 2]> = rays
        .iter()
        .map(|&ray| {
            let v = sub(graph.position(graph.other_end(ray, view)), x);
            let squared = dot(&v, &v);
            [v[0] / squared, v[1] / squared]
        })
        .collect();
    let line = Flat::fit(&inverted).filter(|line| line.misfit(1) <= tolerance)?;
    let mut cause = Cause::new(CauseKind::Conic, "circle");
    (cause.views, cause.tracks) = graph.split(rays.iter().map(|&ray| graph.other_end(ray, view)).chain([view]));
    cause.is_exact = line.misfit(1) <= EXACT;
    // n . v / |v|^2 = h becomes h |v|^2 - n . v = 0
    let n = [-line.axes[0][1], line.axes[0][0]];
    let h = dot(&n, &line.center);
    let (d, e) = (-2.0 * h * x[0] - n[0], -2.0 * h * x[1] - n[1]);
    let f = h * (x[0] * x[0] + x[1] * x[1]) + n[0] * x[0] + n[1] * x[1];
    cause.shape = normalized(&[h, 0.0, h, d, e, f].map(|x| x * h.signum())).to_vec();
    Some(cause)
}

/// Views on the circle of the view before them are one cause with it.
fn join_circle(circles: &mut Vec<Cause>, cause: Cause) {
    const SAME: f64 = 1e-6;
    let is_same = |last: &Cause| last.shape.iter().zip(&cause.shape).all(|(a, b)| (a - b).abs() <= SAME);
    match circles.last_mut().filter(|last| is_same(last)) {
        Some(last) => {
            last.views.extend(&cause.views);
            last.tracks.extend(&cause.tracks);
            last.tracks.sort_unstable();
            last.tracks.dedup();
            last.is_exact &= cause.is_exact;
        }
        None => circles.push(cause),
    }
}
