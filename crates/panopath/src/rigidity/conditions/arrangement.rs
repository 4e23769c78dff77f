//! How views and points lie to each other: ranks, common lines, common conics; the nullity of K(m, n) from these.

use super::shapes::{Conics, Flat, count_places, name_of_conic};
use super::{Cause, CauseKind, EXACT, count_of};
use crate::geometry::{Vector, norm, sub};

/// A set of views and a set of points, neither empty, and the smallest flats that hold them.
pub(super) struct Arrangement<'a, const D: usize> {
    views: &'a [Vector<D>],
    points: &'a [Vector<D>],
    /// Distance from a shape up to which a member lies on it.
    limit: f64,
    tolerance: f64,
    all: Flat<D>,
    of_views: Flat<D>,
    of_points: Flat<D>,
    /// 0 a place, 1 a line, 2 a plane, 3 space.
    dimension: usize,
    view_dimension: usize,
    point_dimension: usize,
}

impl<'a, const D: usize> Arrangement<'a, D> {
    /// `None` where a set is empty or a coordinate not finite.
    pub(super) fn new(views: &'a [Vector<D>], points: &'a [Vector<D>], tolerance: f64) -> Option<Self> {
        let members: Vec<Vector<D>> = views.iter().chain(points).copied().collect();
        let (all, of_views, of_points) = (Flat::fit(&members)?, Flat::fit(views)?, Flat::fit(points)?);
        let limit = tolerance * all.radius();
        let dimension = all.dimension(limit);
        // a subset may miss its own flat by a little more than the whole misses the common one
        let view_dimension = of_views.dimension(limit).min(dimension);
        let point_dimension = of_points.dimension(limit).min(dimension);
        Some(Self {
            views,
            points,
            limit,
            tolerance,
            all,
            of_views,
            of_points,
            dimension,
            view_dimension,
            point_dimension,
        })
    }

    /// A view at a point sees it in no direction.
    pub(super) fn has_view_at_point(&self) -> bool {
        // sorted along the longest axis, only neighbours can be at one place
        let along = |x: &Vector<D>| crate::geometry::dot(x, &self.all.axes[0]);
        let mut points: Vec<(f64, &Vector<D>)> = self.points.iter().map(|q| (along(q), q)).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.views.iter().any(|p| {
            let start = points.partition_point(|(t, _)| *t < along(p) - self.limit);
            points[start..]
                .iter()
                .take_while(|(t, _)| *t <= along(p) + self.limit)
                .any(|(_, q)| norm(&sub(p, q)) <= self.limit)
        })
    }

    fn is_planar(&self) -> bool {
        self.dimension <= 2
    }

    fn view_places(&self) -> usize {
        count_places(self.views.iter().copied(), self.limit, 3)
    }

    fn point_places(&self) -> usize {
        count_places(self.points.iter().copied(), self.limit, 3)
    }

    /// Tracks on the line of all views, where the views have one.
    fn points_on_line_of_views(&self) -> Vec<u32> {
        on_flat(self.points, &self.of_views, self.view_dimension, self.limit)
    }

    fn views_on_line_of_points(&self) -> Vec<u32> {
        on_flat(self.views, &self.of_points, self.point_dimension, self.limit)
    }

    fn members_in_plane(&self) -> Vec<[f64; 2]> {
        self.views.iter().chain(self.points).map(|x| self.all.in_plane(x)).collect()
    }

    fn conics(&self) -> Option<Conics> {
        Conics::through(&self.members_in_plane(), self.limit)
    }

    /// Dimension of the null space of K(m, n).
    pub(super) fn nullity(&self) -> usize {
        match D {
            2 => self.plane_nullity(),
            _ if self.is_planar() => self.plane_nullity() + 1,
            _ => self.space_nullity(),
        }
    }

    /// The formula of the module's head.
    fn plane_nullity(&self) -> usize {
        let (m, n) = (self.views.len() as i128, self.points.len() as i128);
        let (p, q) = (self.view_dimension as i128 + 1, self.point_dimension as i128 + 1);
        let dependencies = if p == 3 && q == 3 {
            m + n - (6 - self.conics().map_or(0, |c| c.through.len() as i128))
        } else {
            // what is in the span of both is on one line, where a quadric has three coefficients
            let views = indices_in_span(self.views, &self.of_points, self.point_dimension, self.limit);
            let points = indices_in_span(self.points, &self.of_views, self.view_dimension, self.limit);
            let places = views.iter().map(|&i| self.views[i as usize]);
            let places = places.chain(points.iter().map(|&j| self.points[j as usize]));
            (views.len() + points.len()) as i128 - count_places(places, self.limit, 3) as i128
        };
        (2 * (m + n) - m * n + (m - p) * (n - q) + dependencies).max(3) as usize
    }

    /// Not all in one plane: two views and two points that are not coplanar fix each other, and these all others but those
    /// that see along one line only. Without such four, all views are at one place, or all points.
    fn space_nullity(&self) -> usize {
        match (self.view_dimension, self.point_dimension) {
            (0, _) => 3 + self.points.len(),
            (_, 0) => 3 + self.views.len(),
            _ => 4 + self.points_on_line_of_views().len() + self.views_on_line_of_points().len(),
        }
    }

    /// All conditions that fail where every view sees every point.
    pub(super) fn failing(&self) -> Vec<Cause> {
        if self.views.len() == 1 && self.points.len() == 1 {
            return Vec::new();
        }
        if self.is_one_place() {
            return vec![self.one_place()];
        }
        // a member that slides along a line of others ties these to it: they are no longer two cameras, or two lines
        let collinear = self.collinear_members();
        if collinear.is_empty() { self.shapes() } else { collinear }
    }

    fn is_one_place(&self) -> bool {
        self.view_dimension == 0 || self.point_dimension == 0
    }

    /// All views at one place, or else all points.
    fn one_place(&self) -> Cause {
        let hidden = self.point_dimension == 0 && self.views.len() > 1;
        let (flat, mut cause) = if hidden {
            (&self.of_points, Cause::new(CauseKind::HiddenPoint, at_one_place(self.points.len(), "point")))
        } else {
            (&self.of_views, Cause::new(CauseKind::OneCamera, at_one_place(self.views.len(), "view")))
        };
        cause.is_exact = flat.radius() <= EXACT * self.all.radius();
        self.with_all_members(cause)
    }

    /// Points on the line of all views, and views on the line of all points.
    fn collinear_members(&self) -> Vec<Cause> {
        let mut causes = Vec::new();
        let tracks = self.points_on_line_of_views();
        if !tracks.is_empty() {
            let mut cause = Cause::new(CauseKind::CameraCollinear, count_of(tracks.len(), "point"));
            cause.is_exact = self.is_exact_line(&self.of_views, self.points, &tracks);
            cause.shape = self.of_views.line();
            cause.views = ids(self.views);
            cause.tracks = tracks;
            causes.push(cause);
        }
        let views = self.views_on_line_of_points();
        if !views.is_empty() {
            let mut cause = Cause::new(CauseKind::PointCollinear, count_of(views.len(), "view"));
            cause.is_exact = self.is_exact_line(&self.of_points, self.views, &views);
            cause.shape = self.of_points.line();
            cause.views = views;
            cause.tracks = ids(self.points);
            causes.push(cause);
        }
        causes
    }

    fn is_exact_line(&self, line: &Flat<D>, members: &[Vector<D>], on_it: &[u32]) -> bool {
        let limit = EXACT * self.all.radius();
        let far = on_it.iter().any(|&k| line.distance(&members[k as usize], 1) > limit);
        !far && line.misfit(1) * line.radius() <= limit
    }

    /// The shape that all members have in common and that leaves them flexible, whoever sees whom among them: none in space,
    /// one in the plane, but for two views and two points, which are both.
    pub(super) fn shapes(&self) -> Vec<Cause> {
        if self.is_one_place() {
            return vec![self.one_place()];
        }
        // where all is on one line every member slides by itself
        if !self.is_planar() || self.dimension < 2 {
            return Vec::new();
        }
        let (two_views, two_points) = (self.view_places() == 2, self.point_places() == 2);
        if D == 3 && two_views && two_points {
            let cause = Cause::new(CauseKind::CoplanarTwoByTwo, "");
            return vec![self.with_all_members(cause)];
        }
        if two_views || two_points {
            return self.pairs(two_views, two_points);
        }
        match (self.view_dimension, self.point_dimension) {
            (1, 1) => vec![self.two_lines_1()],
            (2, 2) => self.conic().into_iter().collect(),
            _ => Vec::new(),
        }
    }

    fn pairs(&self, two_views: bool, two_points: bool) -> Vec<Cause> {
        let detail = if D == 3 { "in one plane" } else { "" };
        let mut causes = Vec::new();
        for (holds, kind, line) in
            [(two_views, CauseKind::TwoCameras, &self.of_views), (two_points, CauseKind::TwoPoints, &self.of_points)]
        {
            if holds {
                let mut cause = Cause::new(kind, detail);
                cause.shape = line.line();
                causes.push(self.with_all_members(cause));
            }
        }
        causes
    }

    fn two_lines_1(&self) -> Cause {
        let mut cause = Cause::new(CauseKind::TwoLines1, "views on one line, points on another");
        cause.shape = [self.of_views.line(), self.of_points.line()].concat();
        let off = [&self.of_views, &self.of_points].map(|line| line.misfit(1) * line.radius());
        cause.is_exact = off.iter().all(|&x| x <= EXACT * self.all.radius());
        self.with_all_members(cause)
    }

    /// Two lines or another conic through all members, neither views nor points being on one line.
    fn conic(&self) -> Option<Cause> {
        let members = self.members_in_plane();
        let conics = Conics::through(&members, self.limit)?;
        let coefficients = conics.coefficients()?;
        let mut cause = match conics.two_lines(&members, self.limit) {
            Some(lines) => self.two_lines_2(&lines),
            None => {
                let slack = (10.0 * self.tolerance).max(1e-6);
                let mut cause = Cause::new(CauseKind::Conic, name_of_conic(&coefficients, slack));
                cause.shape = if D == 2 { self.conic_in_world(&coefficients).to_vec() } else { Vec::new() };
                cause
            }
        };
        cause.is_exact = conics.misfit <= EXACT * self.all.radius();
        Some(self.with_all_members(cause))
    }

    fn two_lines_2(&self, lines: &[Flat<2>; 2]) -> Cause {
        let on_first = |x: &Vector<D>| {
            let x = self.all.in_plane(x);
            lines[0].distance(&x, 1) <= lines[1].distance(&x, 1)
        };
        let share = |members: &[Vector<D>]| members.iter().filter(|x| on_first(x)).count();
        let (views, points) = (share(self.views), share(self.points));
        let words = |views, points| format!("{} and {}", count_of(views, "view"), count_of(points, "point"));
        let detail = format!(
            "{} on one line, {} on another",
            words(views, points),
            words(self.views.len() - views, self.points.len() - points)
        );
        let mut cause = Cause::new(CauseKind::TwoLines2, detail);
        cause.shape = lines.iter().flat_map(|line| self.line_in_world(line)).collect();
        cause
    }

    /// A line of the plane of all members, as the record has it.
    fn line_in_world(&self, line: &Flat<2>) -> Vec<f64> {
        let out = |x: &[f64; 2]| -> Vector<D> {
            std::array::from_fn(|c| x[0] * self.all.axes[0][c] + x[1] * self.all.axes[1][c])
        };
        let (place, direction) = (out(&line.center), out(&line.axes[0]));
        (0..D).map(|c| self.all.center[c] + place[c]).chain(direction).collect()
    }

    /// A conic of the plane, from the coordinates of [`Flat::in_plane`] to those of the world.
    fn conic_in_world(&self, conic: &[f64; 6]) -> [f64; 6] {
        let [u, v] = [0, 1].map(|k| {
            let axis = &self.all.axes[k];
            [axis[0], axis[1], -crate::geometry::dot(axis, &self.all.center)]
        });
        // products of the linear forms u and v of (x, y, 1)
        let product = |s: &[f64; 3], t: &[f64; 3]| {
            let mixed = |r: usize, c: usize| s[r] * t[c] + s[c] * t[r];
            [s[0] * t[0], mixed(0, 1), s[1] * t[1], mixed(0, 2), mixed(1, 2), s[2] * t[2]]
        };
        let one = [0.0, 0.0, 1.0];
        let terms = [
            product(&u, &u),
            product(&u, &v),
            product(&v, &v),
            product(&u, &one),
            product(&v, &one),
            product(&one, &one),
        ];
        crate::geometry::normalized(&std::array::from_fn(|k| (0..6).map(|t| conic[t] * terms[t][k]).sum::<f64>()))
    }

    fn with_all_members(&self, mut cause: Cause) -> Cause {
        cause.views = ids(self.views);
        cause.tracks = ids(self.points);
        if D == 3 && self.is_planar() {
            cause.is_exact &= self.all.misfit(2) <= EXACT;
        }
        cause
    }
}

fn ids<const D: usize>(members: &[Vector<D>]) -> Vec<u32> {
    (0..members.len() as u32).collect()
}

fn at_one_place(n: usize, what: &str) -> String {
    if n == 1 { String::new() } else { format!("{n} {what}s at one place") }
}

/// Members on a line that is one; a place is no line.
fn on_flat<const D: usize>(members: &[Vector<D>], flat: &Flat<D>, dimension: usize, limit: f64) -> Vec<u32> {
    if dimension == 1 { indices_in_span(members, flat, 1, limit) } else { Vec::new() }
}

/// Members in the flat of this dimension; all of them where it is the plane of the whole set.
fn indices_in_span<const D: usize>(members: &[Vector<D>], flat: &Flat<D>, dimension: usize, limit: f64) -> Vec<u32> {
    let inside = |x: &Vector<D>| dimension >= 2 || flat.distance(x, dimension) <= limit;
    (0..members.len() as u32).filter(|&k| inside(&members[k as usize])).collect()
}
