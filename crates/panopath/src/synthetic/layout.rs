//! Where views and points are, and which view sees which point.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

use rand::RngExt;
use rand::seq::{SliceRandom, index};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Binomial, Distribution, StandardNormal};

use super::{Conic, WeakMode, WorldKind, WorldOptions, depth_range, window};
use crate::geometry::{Vector, add, norm, scale, sub};
use crate::synthetic::measure::{Stream, stream};

/// Default of `go_views`.
pub(super) const GO_VIEWS: usize = 10;
const STOP_VIEWS: usize = 5;
/// Default of `n_clusters`.
pub(super) const CLUSTERS: usize = 2;
/// Default of `n_links`.
pub(super) const LINKS: usize = 4;

/// Elevation of points as seen from their anchor view: the street's ground and its houses.
const ELEVATION_RAD: (f64, f64) = (-25.0 * PI / 180.0, 60.0 * PI / 180.0);
/// A point's share `t` of the logarithmic depth range gives `t^NEAR_FEWER` of the window: the mean of 3..15 is 8.2.
const NEAR_FEWER: f64 = 1.3;
/// Least angle between a straight path and the ray of a point.
const OFF_LINE_RAD: f64 = 20.0 * PI / 180.0;
const ROOM_M: [f64; 3] = [8.0, 6.0, 2.6];
/// How far a walk keeps from the room's walls, and how high the camera is carried.
const ROOM_MARGIN_M: f64 = 0.6;
pub(super) const CARRIED_AT_M: f64 = 1.6;
const CORRIDOR_WIDTH_M: f64 = 3.0;
const CORRIDOR_HEIGHT_M: f64 = 2.6;
/// How far along the corridor a point may be from its anchor view.
const CORRIDOR_REACH_M: f64 = 5.0;

/// A scene before it is measured.
pub(super) struct Layout<const D: usize> {
    pub centers: Vec<Vector<D>>,
    pub points: Vec<Vector<D>>,
    /// The view from which each point was placed.
    pub anchor: Vec<u32>,
    /// Views of each track, ascending: `seen[first[j]..first[j + 1]]`.
    pub seen: Vec<u32>,
    pub first: Vec<usize>,
}

impl<const D: usize> Layout<D> {
    fn new(centers: Vec<Vector<D>>, n_points: usize) -> Self {
        let mut first = Vec::with_capacity(n_points + 1);
        first.push(0);
        let (points, anchor) = (Vec::with_capacity(n_points), Vec::with_capacity(n_points));
        Self { centers, points, anchor, seen: Vec::new(), first }
    }

    /// Gives some tracks other views.
    pub(super) fn see_again(&mut self, views: &[Option<Range<usize>>]) {
        let (mut seen, mut first) = (Vec::with_capacity(self.seen.len()), vec![0]);
        for (ends, views) in self.first.windows(2).zip(views) {
            match views {
                Some(views) => seen.extend(views.clone().map(|view| view as u32)),
                None => seen.extend_from_slice(&self.seen[ends[0]..ends[1]]),
            }
            first.push(seen.len());
        }
        (self.seen, self.first) = (seen, first);
    }

    fn push(&mut self, point: Vector<D>, anchor: usize, views: impl IntoIterator<Item = usize>) {
        let start = self.seen.len();
        self.seen.extend(views.into_iter().map(|view| view as u32));
        self.seen[start..].sort_unstable();
        self.first.push(self.seen.len());
        self.points.push(point);
        self.anchor.push(anchor as u32);
    }
}

/// Lays out a world whose options have been checked.
pub(super) fn lay_out<const D: usize>(kind: WorldKind, o: &WorldOptions) -> Layout<D> {
    let mut views = stream(o.seed, Stream::Views);
    let mut points = stream(o.seed, Stream::Points);
    match kind {
        WorldKind::Box => uniform_box(o, &mut views, &mut points),
        WorldKind::Street | WorldKind::StopAndGo => {
            let centers = loop_path(kind, o, &mut views);
            along_path(kind, o, centers, &mut points)
        }
        WorldKind::Line => {
            let mut centers = straight_path(o);
            wobble(&mut centers, o.wobble_m.unwrap_or(0.0), &mut views);
            along_path(kind, o, centers, &mut points)
        }
        WorldKind::Chain => {
            let centers = winding_path(o, &mut views);
            along_path(kind, o, centers, &mut points)
        }
        WorldKind::Corridor => corridor(o, &mut views, &mut points),
        WorldKind::Room => room(o, &mut views, &mut points),
        WorldKind::Ellipse | WorldKind::Cylinder => on_conic(kind, o, &mut views, &mut points),
        WorldKind::Weak if o.weak_mode.unwrap_or_default() == WeakMode::Chain => weak_chain(o, &mut views, &mut points),
        WorldKind::Weak => weak_clusters(o, &mut views, &mut points),
    }
}

/// `(cos phi cos theta, cos phi sin theta, sin phi)`; in the plane `(cos theta, sin theta)`.
pub(super) fn direction<const D: usize>(theta_rad: f64, phi_rad: f64) -> Vector<D> {
    let (sin_theta, cos_theta) = theta_rad.sin_cos();
    let (sin_phi, cos_phi) = if D == 2 { (0.0, 1.0) } else { phi_rad.sin_cos() };
    std::array::from_fn(|c| match c {
        0 => cos_phi * cos_theta,
        1 => cos_phi * sin_theta,
        _ => sin_phi,
    })
}

/// A number whose logarithm is uniform.
pub(super) fn log_uniform(range: (f64, f64), share: f64) -> f64 {
    range.0 * (range.1 / range.0).powf(share)
}

fn uniform<const D: usize>(half_width: f64, rng: &mut ChaCha8Rng) -> Vector<D> {
    std::array::from_fn(|_| half_width * rng.random_range(-1.0..1.0))
}

fn normal<const D: usize>(deviation: f64, rng: &mut ChaCha8Rng) -> Vector<D> {
    std::array::from_fn(|_| deviation * Distribution::<f64>::sample(&StandardNormal, rng))
}

fn wobble<const D: usize>(centers: &mut [Vector<D>], deviation: f64, rng: &mut ChaCha8Rng) {
    for center in centers {
        *center = add(center, &normal(deviation, rng));
    }
}

// ---- views and points seen at random --------------------------------------------------------------------------------

fn uniform_box<const D: usize>(o: &WorldOptions, views: &mut ChaCha8Rng, points: &mut ChaCha8Rng) -> Layout<D> {
    let centers = (0..o.n_views).map(|_| uniform(1.0, views)).collect();
    let positions: Vec<Vector<D>> = (0..o.n_points).map(|_| uniform(1.0, points)).collect();
    seen_at_random(WorldKind::Box, o, centers, &positions)
}

/// Every view sees every point with probability `visible_fraction`, within the window.
fn seen_at_random<const D: usize>(
    kind: WorldKind,
    o: &WorldOptions,
    centers: Vec<Vector<D>>,
    positions: &[Vector<D>],
) -> Layout<D> {
    let mut rng = stream(o.seed, Stream::Visibility);
    let (fewest, most) = window(kind, o);
    let visible = o.visible_fraction.unwrap_or(1.0);
    let binomial = Binomial::new(o.n_views as u64, visible).ok();
    let mut layout = Layout::new(centers, o.n_points);
    for point in positions {
        let drawn = binomial.map_or(o.n_views, |b| b.sample(&mut rng) as usize);
        let count = drawn.clamp(fewest, most);
        if count == o.n_views {
            layout.push(*point, rng.random_range(0..o.n_views), 0..o.n_views);
        } else {
            let seen_by = index::sample(&mut rng, o.n_views, count);
            layout.push(*point, seen_by.index(0), seen_by.iter());
        }
    }
    layout
}

/// Views and points share the slots of the curve, so that no two of them fall together.
fn on_conic<const D: usize>(
    kind: WorldKind,
    o: &WorldOptions,
    views: &mut ChaCha8Rng,
    points: &mut ChaCha8Rng,
) -> Layout<D> {
    let total = o.n_views + o.n_points;
    let mut slots: Vec<usize> = (0..total).collect();
    slots.shuffle(views);
    let conic = o.conic.unwrap_or_default();
    let mut place = |slot: usize| -> Vector<D> {
        let share = (slot as f64 + 0.5 + views.random_range(-0.3..0.3)) / total as f64;
        let [x, y] = point_of_conic(conic, share);
        let height = views.random_range(-1.0..1.0);
        std::array::from_fn(|c| [x, y, height][c])
    };
    let centers = slots[..o.n_views].iter().map(|&slot| place(slot)).collect();
    let mut positions: Vec<Vector<D>> = slots[o.n_views..].iter().map(|&slot| place(slot)).collect();
    wobble(&mut positions, o.off_conic.unwrap_or(0.0), points);
    seen_at_random(kind, o, centers, &positions)
}

fn point_of_conic(conic: Conic, share: f64) -> [f64; 2] {
    match conic {
        Conic::Ellipse => [2.0 * (TAU * share).cos(), (TAU * share).sin()],
        Conic::Circle => [(TAU * share).cos(), (TAU * share).sin()],
        Conic::Parabola => {
            let x = 3.0 * share - 1.5;
            [x, x * x]
        }
        Conic::Hyperbola => {
            let (branch, along) = if share < 0.5 { (1.0, 2.0 * share) } else { (-1.0, 2.0 * share - 1.0) };
            let u = 3.0 * along - 1.5;
            [branch * u.cosh(), u.sinh()]
        }
    }
}

// ---- views along a path ---------------------------------------------------------------------------------------------

/// A circle; `StopAndGo` advances along it in `go_views` of every `go_views + stop_views` views.
fn loop_path<const D: usize>(kind: WorldKind, o: &WorldOptions, rng: &mut ChaCha8Rng) -> Vec<Vector<D>> {
    let (go, stop) = match kind {
        WorldKind::StopAndGo => (o.go_views.unwrap_or(GO_VIEWS), o.stop_views.unwrap_or(STOP_VIEWS)),
        _ => (1, 0),
    };
    let moves = |view: usize| view % (go + stop) < go;
    let spacing = o.spacing_m.unwrap_or(1.0);
    let length = (0..o.n_views).filter(|&view| moves(view)).count() as f64 * spacing;
    let deviation = o.wobble_m.unwrap_or(0.05);
    let (mut travelled, mut centers) = (0.0, Vec::<Vector<D>>::with_capacity(o.n_views));
    for view in 0..o.n_views {
        if let (false, Some(&last)) = (moves(view), centers.last()) {
            centers.push(last);
            continue;
        }
        let on_circle = scale(length / TAU, &direction(TAU * travelled / length, 0.0));
        centers.push(add(&on_circle, &normal(deviation, rng)));
        travelled += spacing;
    }
    centers
}

fn straight_path<const D: usize>(o: &WorldOptions) -> Vec<Vector<D>> {
    let spacing = o.spacing_m.unwrap_or(1.0);
    (0..o.n_views).map(|view| scale(view as f64 * spacing, &direction(0.0, 0.0))).collect()
}

/// Two slow bends of incommensurate length: the path winds and never meets itself.
fn winding_path<const D: usize>(o: &WorldOptions, rng: &mut ChaCha8Rng) -> Vec<Vector<D>> {
    let spacing = o.spacing_m.unwrap_or(1.0);
    let (long, short) = (rng.random_range(0.0..TAU), rng.random_range(0.0..TAU));
    let mut center = [0.0; D];
    let mut centers = Vec::with_capacity(o.n_views);
    for view in 0..o.n_views {
        centers.push(center);
        let heading_rad = 0.7 * (view as f64 / 31.0 + long).sin() + 0.4 * (view as f64 / 11.7 + short).sin();
        center = add(&center, &scale(spacing, &direction(heading_rad, 0.0)));
    }
    wobble(&mut centers, o.wobble_m.unwrap_or(0.05), rng);
    centers
}

/// Points about a path, each seen by consecutive views: near points by few, far ones by many.
fn along_path<const D: usize>(
    kind: WorldKind,
    o: &WorldOptions,
    centers: Vec<Vector<D>>,
    rng: &mut ChaCha8Rng,
) -> Layout<D> {
    let depth_m = depth_range(kind, o);
    let (fewest, most) = window(kind, o);
    let closed = matches!(kind, WorldKind::Street | WorldKind::StopAndGo);
    let mut layout = Layout::new(centers, o.n_points);
    for _ in 0..o.n_points {
        let anchor = rng.random_range(0..o.n_views);
        let share: f64 = rng.random();
        let ray = direction(azimuth(kind, rng), rng.random_range(ELEVATION_RAD.0..ELEVATION_RAD.1));
        let point = add(&layout.centers[anchor], &scale(log_uniform(depth_m, share), &ray));
        // rounding up with the probability of the remainder keeps the mean
        let more = (most - fewest) as f64 * share.powf(NEAR_FEWER) + rng.random::<f64>();
        let count = (fewest + more as usize).min(most);
        layout.push(point, anchor, consecutive(anchor, count, o.n_views, closed));
    }
    layout
}

/// Azimuth of a point; about a straight path along x it keeps [`OFF_LINE_RAD`] from the line.
fn azimuth(kind: WorldKind, rng: &mut ChaCha8Rng) -> f64 {
    if kind != WorldKind::Line {
        return rng.random_range(0.0..TAU);
    }
    let side = if rng.random() { FRAC_PI_2 } else { -FRAC_PI_2 };
    side + rng.random_range(OFF_LINE_RAD - FRAC_PI_2..FRAC_PI_2 - OFF_LINE_RAD)
}

/// `count` views about the anchor; around the end of a closed path, pushed inwards at the ends of an open one.
fn consecutive(anchor: usize, count: usize, n_views: usize, closed: bool) -> impl Iterator<Item = usize> {
    let before = count / 2;
    let start = if closed { anchor + n_views - before } else { anchor.saturating_sub(before).min(n_views - count) };
    (start..start + count).map(move |view| view % n_views)
}

fn corridor<const D: usize>(o: &WorldOptions, views: &mut ChaCha8Rng, rng: &mut ChaCha8Rng) -> Layout<D> {
    let mut centers = straight_path(o);
    wobble(&mut centers, o.wobble_m.unwrap_or(0.05), views);
    let (fewest, most) = window(WorldKind::Corridor, o);
    let floor_m = -CARRIED_AT_M;
    let spacing = o.spacing_m.unwrap_or(1.0);
    let mut layout = Layout::new(centers, o.n_points);
    for _ in 0..o.n_points {
        let anchor = rng.random_range(0..o.n_views);
        let along = anchor as f64 * spacing + rng.random_range(-CORRIDOR_REACH_M..CORRIDOR_REACH_M);
        let side: f64 = if rng.random() { 1.0 } else { -1.0 };
        let (across, up) = if D == 2 || rng.random_bool(CORRIDOR_HEIGHT_M / (CORRIDOR_HEIGHT_M + CORRIDOR_WIDTH_M)) {
            (side * CORRIDOR_WIDTH_M / 2.0, floor_m + rng.random_range(0.0..CORRIDOR_HEIGHT_M))
        } else {
            let up = if side > 0.0 { floor_m + CORRIDOR_HEIGHT_M } else { floor_m };
            (CORRIDOR_WIDTH_M * rng.random_range(-0.5..0.5), up)
        };
        let count = rng.random_range(fewest..=most);
        let point = std::array::from_fn(|c| [along, across, up][c]);
        layout.push(point, anchor, consecutive(anchor, count, o.n_views, false));
    }
    layout
}

// ---- the room -------------------------------------------------------------------------------------------------------

fn room<const D: usize>(o: &WorldOptions, views: &mut ChaCha8Rng, rng: &mut ChaCha8Rng) -> Layout<D> {
    let centers = room_walk(o, views);
    let neighbours = near_views(&centers, o.near_m.unwrap_or(1.0), window(WorldKind::Room, o).1);
    let (fewest, most) = window(WorldKind::Room, o);
    let mut layout = Layout::new(centers, o.n_points);
    let mut seen_by = Vec::with_capacity(most);
    for _ in 0..o.n_points {
        let anchor = rng.random_range(0..o.n_views);
        let point = point_of_room(rng);
        let near = &neighbours[anchor];
        let count = rng.random_range(fewest..=most);
        seen_by.clear();
        seen_by.push(anchor);
        seen_by.extend(index::sample(rng, near.len(), count - 1).iter().map(|k| near[k] as usize));
        layout.push(point, anchor, seen_by.iter().copied());
    }
    layout
}

/// A random walk that turns back at the walls.
fn room_walk<const D: usize>(o: &WorldOptions, rng: &mut ChaCha8Rng) -> Vec<Vector<D>> {
    let spacing = o.spacing_m.unwrap_or(0.25);
    let mut heading_rad = rng.random_range(0.0..TAU);
    let mut position = [ROOM_M[0] / 2.0, ROOM_M[1] / 2.0];
    let mut centers = Vec::with_capacity(o.n_views);
    for _ in 0..o.n_views {
        centers.push(std::array::from_fn(|c| [position[0], position[1], CARRIED_AT_M][c]));
        heading_rad += 0.4 * Distribution::<f64>::sample(&StandardNormal, rng);
        let step = direction::<2>(heading_rad, 0.0);
        for c in 0..2 {
            position[c] += spacing * step[c];
            let (low, high) = (ROOM_MARGIN_M, ROOM_M[c] - ROOM_MARGIN_M);
            if position[c] < low || position[c] > high {
                position[c] = if position[c] < low { 2.0 * low - position[c] } else { 2.0 * high - position[c] };
                position[c] = position[c].clamp(low, high);
                heading_rad = if c == 0 { PI - heading_rad } else { -heading_rad };
            }
        }
    }
    wobble(&mut centers, o.wobble_m.unwrap_or(0.05), rng);
    centers
}

/// A point of the room's walls, floor and ceiling (in the plane: of its walls), uniform over their area.
fn point_of_room<const D: usize>(rng: &mut ChaCha8Rng) -> Vector<D> {
    let volume: f64 = ROOM_M[..D].iter().product();
    let total: f64 = ROOM_M[..D].iter().map(|side| volume / side).sum();
    let mut left = rng.random_range(0.0..total);
    let mut across = 0;
    while across + 1 < D && left >= volume / ROOM_M[across] {
        left -= volume / ROOM_M[across];
        across += 1;
    }
    let far_side: bool = rng.random();
    std::array::from_fn(|c| match c == across {
        true if far_side => ROOM_M[c],
        true => 0.0,
        false => rng.random_range(0.0..ROOM_M[c]),
    })
}

/// Of each view the other views within `radius_m`, or the nearest `most - 1` where fewer than these are so near.
fn near_views<const D: usize>(centers: &[Vector<D>], radius_m: f64, most: usize) -> Vec<Vec<u32>> {
    let needed = most.saturating_sub(1).min(centers.len() - 1);
    let of = |view: usize| -> Vec<u32> {
        let distance = |other: u32| norm(&sub(&centers[other as usize], &centers[view]));
        let others = (0..centers.len() as u32).filter(|&other| other as usize != view);
        let near: Vec<u32> = others.clone().filter(|&other| distance(other) <= radius_m).collect();
        if near.len() >= needed {
            return near;
        }
        let mut all: Vec<u32> = others.collect();
        all.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
        all.truncate(needed);
        all
    };
    (0..centers.len()).map(of).collect()
}

// ---- weak graphs ----------------------------------------------------------------------------------------------------

fn weak_chain<const D: usize>(o: &WorldOptions, views: &mut ChaCha8Rng, rng: &mut ChaCha8Rng) -> Layout<D> {
    let exact = WorldOptions { wobble_m: Some(o.wobble_m.unwrap_or(0.0)), ..o.clone() };
    let depth_m = depth_range(WorldKind::Weak, o);
    let mut layout = Layout::new(winding_path(&exact, views), o.n_points);
    for track in 0..o.n_points {
        let link = track % (o.n_views - 1);
        let ray = direction(rng.random_range(0.0..TAU), rng.random_range(ELEVATION_RAD.0..ELEVATION_RAD.1));
        let point = add(&layout.centers[link], &scale(log_uniform(depth_m, rng.random()), &ray));
        layout.push(point, link, [link, link + 1]);
    }
    layout
}

/// Clusters side by side along x; views in a box of half width 1, points in one of half width 2 about each.
fn weak_clusters<const D: usize>(o: &WorldOptions, views: &mut ChaCha8Rng, rng: &mut ChaCha8Rng) -> Layout<D> {
    let (n_clusters, n_links) = (o.n_clusters.unwrap_or(CLUSTERS), o.n_links.unwrap_or(LINKS));
    let (fewest, most) = window(WorldKind::Weak, o);
    let middle = |cluster: f64| scale(6.0 * cluster, &direction::<D>(0.0, 0.0));
    let bounds: Vec<usize> = (0..=n_clusters).map(|c| c * o.n_views / n_clusters).collect();
    let mut centers = Vec::with_capacity(o.n_views);
    for cluster in 0..n_clusters {
        centers
            .extend((bounds[cluster]..bounds[cluster + 1]).map(|_| add(&middle(cluster as f64), &uniform(1.0, views))));
    }
    let mut layout = Layout::new(centers, o.n_points);
    let n_inner = o.n_points - n_links * (n_clusters - 1);
    for track in 0..n_inner {
        let cluster = track % n_clusters;
        let (start, size) = (bounds[cluster], bounds[cluster + 1] - bounds[cluster]);
        let count = rng.random_range(fewest.min(size)..=most.min(size));
        let seen_by = index::sample(rng, size, count);
        let point = add(&middle(cluster as f64), &uniform(2.0, rng));
        layout.push(point, start + seen_by.index(0), seen_by.iter().map(|k| start + k));
    }
    for cluster in 0..n_clusters - 1 {
        // different views for different links, or the links would not be independent
        let mut left: Vec<usize> = (bounds[cluster]..bounds[cluster + 1]).collect();
        let mut right: Vec<usize> = (bounds[cluster + 1]..bounds[cluster + 2]).collect();
        left.shuffle(rng);
        right.shuffle(rng);
        for link in 0..n_links {
            let pair = [left[link % left.len()], right[link % right.len()]];
            layout.push(add(&middle(cluster as f64 + 0.5), &uniform(2.0, rng)), pair[0], pair);
        }
    }
    layout
}
