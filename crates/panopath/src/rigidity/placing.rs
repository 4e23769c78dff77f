//! Parts of a scene, each of its own place and size, brought into one frame where observations tie them together.
//!
//! Parts that share one view, or too few tracks, are solved apart: what ties them leaves their relation `x -> varsigma x + tau`
//! free in part. But it is not nothing, and a certificate is about all that was observed. So each part is put where the
//! ties hold, `P_v (varsigma x + tau - c) = 0` for a ray from one part onto a point of another, and
//! `(v_a x v_b)^T (varsigma c_b + tau - c_a) = 0` for a track that is seen once from each; what they leave free is chosen.

use super::spectrum::scattered;
use crate::geometry::{Vector, add, angle_between, apply, dot, norm, normalized, scale, sub};
use crate::least_squares::symmetric_eigen_of;
use crate::structure::Structure;
use crate::tracks::Tracks;

/// Eigenvalues of the ties below this share of the largest leave a direction free.
const FREE: f64 = 1e-5;
/// Parts are rather shifted than made to grow: growth weighs this much in the choice of what ties leave free.
const GROWTH_WEIGHT: f64 = 0.02;

/// Positions in one frame, and which observations of different parts they satisfy.
pub(super) struct Placed<const D: usize> {
    pub centers: Vec<Vector<D>>,
    pub points: Vec<Vector<D>>,
    /// Of each observation: do its view and its point belong to different parts, and does it fit all the same?
    pub ties: Vec<bool>,
}

/// Places all parts; rays must fit within `limit_rad` to tie.
pub(super) fn place_together<const D: usize>(tracks: &Tracks<D>, scene: &Structure<D>, limit_rad: f64) -> Placed<D> {
    let mut placed =
        Placed { centers: scene.centers.clone(), points: scene.points.clone(), ties: vec![false; tracks.len()] };
    let n_parts = scene.view_component.iter().chain(&scene.track_component).copied().max().unwrap_or(-1) + 1;
    if n_parts < 2 {
        return placed;
    }
    let rays: Vec<Vector<D>> = (0..tracks.len())
        .map(|o| apply(scene.cam_from_world[tracks.view()[o] as usize].inverse().matrix(), &tracks.bearing()[o]))
        .collect();
    let ties = Ties { tracks, scene, rays: &rays };
    let mut is_placed = vec![false; n_parts as usize];
    is_placed[0] = true;
    while let Some((part, rows)) = ties.next(&placed, &is_placed) {
        is_placed[part] = true;
        if let Some((growth, shift)) = choose::<D>(part, &rows) {
            placed.shift_part(scene, part as i32, growth, &shift);
        }
    }
    ties.mark(&mut placed, limit_rad);
    placed
}

impl<const D: usize> Placed<D> {
    fn shift_part(&mut self, scene: &Structure<D>, part: i32, growth: f64, shift: &Vector<D>) {
        let move_all = |positions: &mut [Vector<D>], label: &[i32]| {
            for (x, _) in positions.iter_mut().zip(label).filter(|(_, c)| **c == part) {
                *x = add(&scale(growth, x), shift);
            }
        };
        move_all(&mut self.centers, &scene.view_component);
        move_all(&mut self.points, &scene.track_component);
    }
}

/// `row^T (tau, varsigma) = right`, unknowns of the part that is to be placed.
type Row = (Vec<f64>, f64);

struct Ties<'a, const D: usize> {
    tracks: &'a Tracks<D>,
    scene: &'a Structure<D>,
    rays: &'a [Vector<D>],
}

impl<const D: usize> Ties<'_, D> {
    /// The part with most ties to what is placed, with these.
    fn next(&self, placed: &Placed<D>, is_placed: &[bool]) -> Option<(usize, Vec<Row>)> {
        let mut rows: Vec<Vec<Row>> = vec![Vec::new(); is_placed.len()];
        for (part, row) in self.across(placed, is_placed) {
            rows[part].push(row);
        }
        for (part, bridges) in self.bridges(placed, is_placed).into_iter().enumerate() {
            // as many as that, were they right, would have made one part of the two
            if bridges.len() <= D {
                rows[part].extend(bridges);
            }
        }
        let most = (0..rows.len()).max_by_key(|&p| (rows[p].len(), std::cmp::Reverse(p)))?;
        (!rows[most].is_empty()).then(|| (most, std::mem::take(&mut rows[most])))
    }

    /// Rays from a part onto a point of another, one of them placed.
    fn across(&self, placed: &Placed<D>, is_placed: &[bool]) -> Vec<(usize, Row)> {
        let mut rows = Vec::new();
        for o in (0..self.tracks.len()).filter(|&o| self.scene.inlier.get(o) != Some(&false)) {
            let (view, track) = (self.tracks.view()[o] as usize, self.tracks.track()[o] as usize);
            let (a, b) = (self.scene.view_component[view], self.scene.track_component[track]);
            if a < 0 || b < 0 || a == b || is_placed[a as usize] == is_placed[b as usize] {
                continue;
            }
            let (moving, still, part) = if is_placed[a as usize] {
                (&placed.points[track], &placed.centers[view], b)
            } else {
                (&placed.centers[view], &placed.points[track], a)
            };
            for normal in normals(&self.rays[o]) {
                rows.push((part as usize, tie(&normal, moving, still)));
            }
        }
        rows
    }

    /// Tracks without a place that are seen once from what is placed, and once from one part that is not.
    fn bridges(&self, placed: &Placed<D>, is_placed: &[bool]) -> Vec<Vec<Row>> {
        let mut rows = vec![Vec::new(); is_placed.len()];
        if D < 3 {
            return rows;
        }
        for seen in self.unplaced() {
            let [a, b] = seen[..] else { continue };
            let part = |o: usize| self.scene.view_component[self.tracks.view()[o] as usize] as usize;
            let (still, moving) = if is_placed[part(a)] { (a, b) } else { (b, a) };
            if !is_placed[part(still)] || is_placed[part(moving)] {
                continue;
            }
            let center = |o: usize| &placed.centers[self.tracks.view()[o] as usize];
            let (u, v) = (&self.rays[still], &self.rays[moving]);
            let normal: Vector<D> =
                std::array::from_fn(|c| u[(c + 1) % D] * v[(c + 2) % D] - u[(c + 2) % D] * v[(c + 1) % D]);
            if norm(&normal) > FREE {
                rows[part(moving)].push(tie(&normalized(&normal), center(moving), center(still)));
            }
        }
        rows
    }

    /// Observations, by views of parts, of each track without a place.
    fn unplaced(&self) -> impl Iterator<Item = Vec<usize>> {
        let mut seen: std::collections::BTreeMap<u32, Vec<usize>> = std::collections::BTreeMap::new();
        for o in 0..self.tracks.len() {
            let (view, track) = (self.tracks.view()[o], self.tracks.track()[o]);
            if self.scene.track_component[track as usize] < 0 && self.scene.view_component[view as usize] >= 0 {
                seen.entry(track).or_default().push(o);
            }
        }
        seen.into_values()
    }

    /// Marks what ties, and gives a place to the tracks that bridge parts.
    fn mark(&self, placed: &mut Placed<D>, limit_rad: f64) {
        for o in (0..self.tracks.len()).filter(|&o| self.scene.inlier.get(o) != Some(&false)) {
            let (view, track) = (self.tracks.view()[o] as usize, self.tracks.track()[o] as usize);
            let (a, b) = (self.scene.view_component[view], self.scene.track_component[track]);
            placed.ties[o] = a >= 0 && b >= 0 && a != b && self.fits(placed, o, limit_rad);
        }
        for seen in self.unplaced() {
            let [a, b] = seen[..] else { continue };
            let part = |o: usize| self.scene.view_component[self.tracks.view()[o] as usize];
            if D < 3 || part(a) == part(b) {
                continue;
            }
            let center = |o: usize| placed.centers[self.tracks.view()[o] as usize];
            let track = self.tracks.track()[a] as usize;
            let Some(point) = crossing([&center(a), &center(b)], [&self.rays[a], &self.rays[b]]) else { continue };
            placed.points[track] = point;
            let fit = self.fits(placed, a, limit_rad) && self.fits(placed, b, limit_rad);
            if fit {
                (placed.ties[a], placed.ties[b]) = (true, true);
            } else {
                placed.points[track] = [f64::NAN; D];
            }
        }
    }

    /// Is the segment along the ray, or against it? What is chosen of a part's place may put points behind their views; what
    /// is determined does not depend on it.
    fn fits(&self, placed: &Placed<D>, o: usize, limit_rad: f64) -> bool {
        let (view, track) = (self.tracks.view()[o] as usize, self.tracks.track()[o] as usize);
        let segment = sub(&placed.points[track], &placed.centers[view]);
        let angle = angle_between(&normalized(&segment), &self.rays[o]);
        norm(&segment) > 0.0 && angle.min(std::f64::consts::PI - angle) < limit_rad
    }
}

/// Directions across a ray.
fn normals<const D: usize>(ray: &Vector<D>) -> Vec<Vector<D>> {
    crate::geometry::tangent_basis(ray)[..D - 1].to_vec()
}

/// `normal^T (varsigma x + tau - y) = 0`.
fn tie<const D: usize>(normal: &Vector<D>, x: &Vector<D>, y: &Vector<D>) -> Row {
    let mut row = normal.to_vec();
    row.push(dot(normal, x));
    (row, dot(normal, y))
}

/// Growth and shift of a part: those nearest to some that are drawn at random among all that satisfy the ties.
fn choose<const D: usize>(part: usize, rows: &[Row]) -> Option<(f64, Vector<D>)> {
    let drawn = |k: usize| if k == D { 1.0 + 0.5 * scattered(part) } else { 5.0 * scattered(31 * part + k) };
    let mut normal = vec![vec![0.0; D + 1]; D + 1];
    let mut right = vec![0.0; D + 1];
    let weight = |k: usize| if k == D { GROWTH_WEIGHT } else { 1.0 };
    for (row, wanted) in rows {
        let missing = wanted - (0..=D).map(|k| row[k] * drawn(k)).sum::<f64>();
        let row: Vec<f64> = row.iter().enumerate().map(|(k, x)| weight(k) * x).collect();
        for r in 0..=D {
            right[r] += row[r] * missing;
            for c in 0..=D {
                normal[r][c] += row[r] * row[c];
            }
        }
    }
    let (values, vectors) = symmetric_eigen_of(&normal).ok()?;
    let mut found: Vec<f64> = (0..=D).map(drawn).collect();
    for (value, vector) in values.iter().zip(&vectors).filter(|(value, _)| **value > FREE * values[D]) {
        let along = (0..=D).map(|k| vector[k] * right[k]).sum::<f64>() / value;
        (0..=D).for_each(|k| found[k] += along * weight(k) * vector[k]);
    }
    (found[D] > 0.0).then(|| (found[D], std::array::from_fn(|c| found[c])))
}

/// The point nearest to two rays.
fn crossing<const D: usize>(center: [&Vector<D>; 2], ray: [&Vector<D>; 2]) -> Option<Vector<D>> {
    let (between, cosine) = (sub(center[1], center[0]), dot(ray[0], ray[1]));
    let determinant = 1.0 - cosine * cosine;
    if determinant < 1e-12 {
        return None;
    }
    let (p, q) = (dot(&between, ray[0]), dot(&between, ray[1]));
    let (s, t) = ((p - cosine * q) / determinant, (cosine * p - q) / determinant);
    let (a, b) = (add(center[0], &scale(s, ray[0])), add(center[1], &scale(t, ray[1])));
    Some(scale(0.5, &add(&a, &b)))
}
