//! A few neighbouring views adjusted by themselves: what would they gain, and how much noise is left?
//!
//! One linear step over the views of a window and the points that at least two of them see. With `Q` an orthonormal basis of
//! the columns of a point (two across its direction, one along it), each point is eliminated by `e - Q Q^T e` and
//! `J - Q Q^T J`; then
//!
//! ```text
//! H = J^T (1 - Q Q^T) J,   g = J^T (1 - Q Q^T) e,   gain = g^T (H + r)^-1 g,   freedoms = tr (H + r)^-1 H
//! noise^2 = (|e - Q Q^T e|^2 - gain) / (equations - freedoms),   strain = gain / freedoms / noise^2
//! ```
//!
//! with a ridge `r` of a millionth of the diagonal, which takes gauge and whatever else is open out of both `gain` and
//! `freedoms`. Orientations are free, held or not in the scene. A right scene gains at most one unit of noise a freedom:
//! an F statistic. The noise of all larger windows together is what the bearings have where nothing pulls, whatever the
//! scene as a whole looks like; `tension` is what they miss by in the scene over that.
//! Shapes: `J` is `(D - 1) n x V m` for `m` views.

use rayon::prelude::*;

use super::Finding;
use super::pairs::Ties;
use super::rays::{LEAST_FREEDOM, LEAST_NOISE_RAD, Noise, Ray, Rays};
use crate::geometry::{Vector, add, dot, normalized, tangent_basis};

/// How windows are chosen.
#[derive(Clone, Copy)]
pub(super) struct Size {
    /// Views of a window.
    n_views: usize,
    /// Windows in which each view is to be, where there are enough.
    coverage: u32,
    /// Most points of a window; more are thinned.
    most_points: usize,
}

/// A view and its next neighbours: shape hardly matters, so what is left is noise.
pub(super) const NEAR: Size = Size { n_views: 4, coverage: 1, most_points: 300 };
/// Enough of a path to have a shape.
pub(super) const FAR: Size = Size { n_views: 10, coverage: 2, most_points: 300 };

/// What a window's views gain by themselves.
#[derive(Clone)]
pub(super) struct Window {
    /// Ascending.
    pub views: Vec<u32>,
    /// Squared residuals of the scene once points are left to this window, and what its views take off that.
    squares: f64,
    gain: f64,
    equations: f64,
    freedoms: f64,
    /// Squared residuals as the scene has them, and their number times `D - 1`.
    scene_squares: f64,
    scene_equations: f64,
}

impl Window {
    /// Noise among the views by themselves, squared.
    fn alone_squared(&self) -> f64 {
        let squared = (self.squares - self.gain) / (self.equations - self.freedoms);
        squared.max(LEAST_NOISE_RAD * LEAST_NOISE_RAD)
    }

    /// Gain of a freedom, in units of noise.
    pub fn strain(&self) -> f64 {
        self.gain / self.freedoms / self.alone_squared()
    }
}

/// Adjusts windows that cover all views.
pub(super) fn adjust<const D: usize, const V: usize>(rays: &Rays<'_, D>, ties: &Ties, size: Size) -> Vec<Window> {
    let windows = choose(ties, size);
    windows.into_par_iter().filter_map(|views| Adjustment::<D, V>::of(rays, views, size.most_points)).collect()
}

/// A view with its next neighbours, for each view that is not yet in enough windows.
fn choose(ties: &Ties, size: Size) -> Vec<Vec<u32>> {
    let mut covered = vec![0; ties.n_views];
    let mut windows = Vec::new();
    for i in 0..ties.n_views {
        if covered[i] >= size.coverage || ties.neighbours[i].len() < 2 {
            continue;
        }
        let mut views: Vec<u32> = ties.neighbours[i].iter().take(size.n_views - 1).copied().collect();
        views.push(i as u32);
        views.sort_unstable();
        views.iter().for_each(|&k| covered[k as usize] += 1);
        windows.push(views);
    }
    windows
}

/// Part of the diagonal that is added to it.
const RIDGE: f64 = 1e-6;
/// A column of a point that keeps less of its length than this is none of its own: no parallax.
const NO_PARALLAX: f64 = 1e-9;

/// The normal equations of one window, lower triangle.
struct Adjustment<const D: usize, const V: usize> {
    dim: usize,
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    squares: f64,
    equations: f64,
    scene_squares: f64,
    scene_equations: f64,
    point: Point<D, V>,
}

impl<const D: usize, const V: usize> Adjustment<D, V> {
    fn of(rays: &Rays<'_, D>, views: Vec<u32>, most_points: usize) -> Option<Window> {
        let dim = V * views.len();
        let mut sums = Self {
            dim,
            matrix: vec![0.0; dim * dim],
            gradient: vec![0.0; dim],
            squares: 0.0,
            equations: 0.0,
            scene_squares: 0.0,
            scene_equations: 0.0,
            point: Point::new(),
        };
        let seen = observations(rays, &views, most_points);
        let points: Vec<&[(u32, u32, u32)]> =
            seen.chunk_by(|a, b| a.0 == b.0).filter(|p| p[0].1 != p[p.len() - 1].1).collect();
        let step = points.len().div_ceil(most_points).max(1);
        for point in points.into_iter().step_by(step) {
            sums.add_point(rays, point);
        }
        sums.solve(views)
    }

    /// Adds a point with the views of the window that accepted it: `(track, slot, observation)` each.
    fn add_point(&mut self, rays: &Rays<'_, D>, seen: &[(u32, u32, u32)]) {
        self.point.load(rays, seen);
        let point = &self.point;
        let squares = product(&point.error, &point.error);
        let own: f64 = point.along.iter().map(|a| a * a).sum();
        self.squares += (squares - own).max(0.0);
        self.equations += (point.error.len() - point.rank) as f64;
        self.scene_squares += squares;
        self.scene_equations += point.error.len() as f64;
        self.add_views(seen);
    }

    /// Adds the views' columns, the point's taken out: `J^T J - (Q^T J)^T (Q^T J)` and `J^T e - (Q^T J)^T (Q^T e)`.
    fn add_views(&mut self, seen: &[(u32, u32, u32)]) {
        let Self { dim, matrix, gradient, point, .. } = self;
        for (a, columns) in point.columns.iter().enumerate() {
            let row = V * seen[a].1 as usize;
            for r in 0..V {
                let mut sum = 0.0;
                for k in 0..D - 1 {
                    sum += columns[k][r] * point.error[(D - 1) * a + k];
                }
                for c in 0..D {
                    sum -= point.reduced[a][c][r] * point.along[c];
                }
                gradient[row + r] += sum;
                let own = &mut matrix[(row + r) * *dim + row..][..V];
                for k in 0..D - 1 {
                    for c in 0..V {
                        own[c] += columns[k][r] * columns[k][c];
                    }
                }
            }
            for b in 0..=a {
                // slots ascend with the observations, so this stays in the lower triangle
                let column = V * seen[b].1 as usize;
                subtract(&mut matrix[row * *dim + column..], *dim, &point.reduced[a], &point.reduced[b]);
                if a != b && row == column {
                    // one view saw the point twice: the mirror image is of the same block
                    subtract(&mut matrix[row * *dim + column..], *dim, &point.reduced[b], &point.reduced[a]);
                }
            }
        }
    }

    /// Takes the step; nothing where too little is left over.
    fn solve(mut self, views: Vec<u32>) -> Option<Window> {
        let n = self.dim;
        // columns of unit length; one without any information stays open
        let scale: Vec<f64> = (0..n)
            .map(|c| self.matrix[c * n + c])
            .map(|d| if d > f64::MIN_POSITIVE { 1.0 / d.sqrt() } else { 0.0 })
            .collect();
        for r in 0..n {
            self.gradient[r] *= scale[r];
            for c in 0..=r {
                self.matrix[r * n + c] *= scale[r] * scale[c];
            }
            self.matrix[r * n + r] = if scale[r] > 0.0 { 1.0 + RIDGE } else { RIDGE };
        }
        factor(&mut self.matrix, n)?;
        let mut gain = 0.0;
        let mut open = 0.0;
        let mut column = vec![0.0; n];
        // L^-1 g for the gain; the columns of L^-1 for the trace of the inverse
        forward(&self.matrix, n, 0, &mut self.gradient);
        self.gradient.iter().for_each(|x| gain += x * x);
        for c in 0..n {
            column[c..].fill(0.0);
            column[c] = 1.0;
            forward(&self.matrix, n, c, &mut column);
            column[c..].iter().for_each(|x| open += RIDGE * x * x);
        }
        let freedoms = n as f64 - open;
        let window = Window {
            views,
            squares: self.squares,
            gain,
            equations: self.equations,
            freedoms,
            scene_squares: self.scene_squares,
            scene_equations: self.scene_equations,
        };
        (self.equations - freedoms >= LEAST_FREEDOM && freedoms > 0.5).then_some(window)
    }
}

/// Accepted observations of some views as `(track, slot, observation)`, ascending; of some tracks where there are far more
/// than `most_points`.
fn observations<const D: usize>(rays: &Rays<'_, D>, views: &[u32], most_points: usize) -> Vec<(u32, u32, u32)> {
    let n_all: usize = views.iter().map(|&view| rays.by_view.of(view as usize).len()).sum();
    let step = (n_all / (THINNED_LENGTH * most_points)).max(1) as u32;
    let mut seen: Vec<(u32, u32, u32)> = Vec::new();
    for (slot, &view) in views.iter().enumerate() {
        for &o in rays.by_view.of(view as usize) {
            let track = rays.tracks.track()[o as usize];
            // scattered: neighbouring tracks may have lengths or places in common
            if (track.wrapping_mul(SCATTER) >> 8).is_multiple_of(step) && rays.accepted[o as usize] {
                seen.push((track, slot as u32, o));
            }
        }
    }
    seen.sort_unstable();
    seen
}

/// Observations a point that thinning leaves room for.
const THINNED_LENGTH: usize = 4;
/// Odd, its bits spread: the golden ratio of 2^32.
const SCATTER: u32 = 0x9e37_79b9;

/// `block -= a^T b` for a block of a matrix whose rows are `stride` apart.
#[inline(always)]
fn subtract<const D: usize, const V: usize>(block: &mut [f64], stride: usize, a: &[[f64; V]; D], b: &[[f64; V]; D]) {
    for r in 0..V {
        let row = &mut block[r * stride..][..V];
        for k in 0..D {
            for c in 0..V {
                row[c] -= a[k][r] * b[k][c];
            }
        }
    }
}

/// A point of a window, with room that is used again and again. Rows: `D - 1` for each observation.
struct Point<const D: usize, const V: usize> {
    rays: Vec<Ray<D>>,
    /// Residuals.
    error: Vec<f64>,
    /// Columns of `Q`; beyond the rank they are zero.
    basis: [Vec<f64>; D],
    rank: usize,
    /// `Q^T e`.
    along: [f64; D],
    /// Rows of `J`: `(D - 1) x V` of each observation.
    columns: Vec<[[f64; V]; 2]>,
    /// `Q^T J`: `D x V` of each observation.
    reduced: Vec<[[f64; V]; D]>,
}

impl<const D: usize, const V: usize> Point<D, V> {
    fn new() -> Self {
        Self {
            rays: Vec::new(),
            error: Vec::new(),
            basis: std::array::from_fn(|_| Vec::new()),
            rank: 0,
            along: [0.0; D],
            columns: Vec::new(),
            reduced: Vec::new(),
        }
    }

    fn load(&mut self, all: &Rays<'_, D>, seen: &[(u32, u32, u32)]) {
        self.rays.clear();
        self.rays.extend(seen.iter().map(|s| all.ray(s.2 as usize)));
        let middle = normalized(&self.rays.iter().fold([0.0; D], |sum, ray| add(&sum, &ray.towards)));
        let nearest = self.rays.iter().fold(f64::INFINITY, |d, ray| d.min(ray.distance));
        let across = tangent_basis(&middle);
        let axes: [Vector<D>; D] = std::array::from_fn(|c| if c < D - 1 { across[c] } else { middle });
        self.error.clear();
        self.columns.clear();
        self.basis.iter_mut().for_each(Vec::clear);
        for ray in &self.rays {
            let near = nearest / ray.distance;
            for k in 0..D - 1 {
                self.error.push(ray.error[k]);
                for c in 0..D {
                    self.basis[c].push(near * dot(&ray.basis[k], &axes[c]));
                }
            }
            self.columns.push([view_columns(&ray.basis[0], ray), view_columns(&ray.basis[1], ray)]);
        }
        self.orthonormalise();
        self.reduce();
    }

    /// Gram and Schmidt, twice; the column along the direction last, as it may be next to nothing.
    fn orthonormalise(&mut self) {
        self.rank = 0;
        for c in 0..D {
            let mut column = std::mem::take(&mut self.basis[c]);
            let length = product(&column, &column).sqrt();
            for done in self.basis[..self.rank].iter().chain(&self.basis[..self.rank]) {
                let along = product(&column, done);
                column.iter_mut().zip(done).for_each(|(x, q)| *x -= along * q);
            }
            let left = product(&column, &column).sqrt();
            let is_new = left > NO_PARALLAX * length && left > f64::MIN_POSITIVE;
            let factor = if is_new { 1.0 / left } else { 0.0 };
            column.iter_mut().for_each(|x| *x *= factor);
            self.basis[c] = column;
            if is_new {
                self.basis.swap(c, self.rank);
                self.rank += 1;
            }
        }
    }

    fn reduce(&mut self) {
        for c in 0..D {
            self.along[c] = product(&self.basis[c], &self.error);
        }
        self.reduced.clear();
        for (a, columns) in self.columns.iter().enumerate() {
            let mut reduced = [[0.0; V]; D];
            for (of_axis, q) in reduced.iter_mut().zip(&self.basis) {
                for k in 0..D - 1 {
                    let factor = q[(D - 1) * a + k];
                    for v in 0..V {
                        of_axis[v] += factor * columns[k][v];
                    }
                }
            }
            self.reduced.push(reduced);
        }
    }
}

/// Inner product.
#[inline]
fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// How one component of a residual changes as the centre moves and the view turns.
///
/// A column's sign changes neither gain nor freedoms.
#[inline(always)]
fn view_columns<const D: usize, const V: usize>(basis: &Vector<D>, ray: &Ray<D>) -> [f64; V] {
    let mut columns = [0.0; V];
    for c in 0..D {
        columns[c] = basis[c] / ray.distance;
    }
    let towards = &ray.towards;
    if D == 2 {
        columns[2] = basis[0] * -towards[1] + basis[1] * towards[0];
    } else {
        for c in 0..3 {
            let (i, j) = ((c + 1) % 3, (c + 2) % 3);
            columns[D + c] = towards[i] * basis[j] - towards[j] * basis[i];
        }
    }
    columns
}

/// Cholesky factor in place of the lower triangle, row by row; nothing where a pivot is lost.
fn factor(matrix: &mut [f64], n: usize) -> Option<()> {
    for r in 0..n {
        let (above, rest) = matrix.split_at_mut(r * n);
        let row = &mut rest[..n];
        for c in 0..r {
            let other = &above[c * n..c * n + c + 1];
            let sum: f64 = row[..c].iter().zip(other).map(|(a, b)| a * b).sum();
            row[c] = (row[c] - sum) / other[c];
        }
        let sum: f64 = row[..r].iter().map(|a| a * a).sum();
        let pivot = row[r] - sum;
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        row[r] = pivot.sqrt();
    }
    Some(())
}

/// Solves `L x = b` in place, where `b` vanishes before entry `first`.
fn forward(factor: &[f64], n: usize, first: usize, x: &mut [f64]) {
    for r in first..n {
        let row = &factor[r * n..r * n + r + 1];
        let sum: f64 = row[first..r].iter().zip(&x[first..r]).map(|(a, b)| a * b).sum();
        x[r] = (x[r] - sum) / row[r];
    }
}

/// With fewer equations left over, chance alone may put two noises this far apart.
const LEAST_TENSION_FREEDOM: f64 = 200.0;

/// Noise of a component in the scene, and of its wide and its narrow windows by themselves.
#[derive(Clone, Copy)]
pub(super) struct Tension {
    pub narrow_rad: f64,
    pub alone_rad: f64,
    pub scene_rad: f64,
}

impl Tension {
    /// How much the noise grows from the wide windows to the scene, over what it grew from the narrow ones to the wide
    /// ones: features of pictures err alike in neighbouring views, so that a right scene has more noise too, but no jump.
    /// NaN where one is not known.
    pub fn ratio(&self) -> f64 {
        let growth = self.alone_rad / self.narrow_rad;
        self.scene_rad / self.alone_rad / if growth.is_nan() { 1.0 } else { growth.max(1.0) }
    }
}

/// Tension of each component.
pub(super) fn tension<const D: usize>(
    rays: &Rays<'_, D>,
    noise: &[Noise],
    narrow: &[Window],
    wide: &[Window],
) -> Vec<Tension> {
    let narrow = noise_alone(rays, narrow);
    let of = |(n, (narrow_rad, alone_rad)): (&Noise, (f64, f64))| Tension {
        narrow_rad,
        alone_rad,
        scene_rad: floor(n.sigma_rad),
    };
    noise.iter().zip(narrow.into_iter().zip(noise_alone(rays, wide))).map(of).collect()
}

fn floor(sigma: f64) -> f64 {
    if sigma.is_nan() { sigma } else { sigma.max(LEAST_NOISE_RAD) }
}

/// Noise of the windows of each component by themselves, NaN where they cover too little of it.
fn noise_alone<const D: usize>(rays: &Rays<'_, D>, windows: &[Window]) -> Vec<f64> {
    let of_component = |c: usize| {
        let own = windows.iter().filter(|w| rays.view_component[w.views[0] as usize] == c as i32);
        let (left, freedom) = own.clone().fold((0.0, 0.0), |(left, freedom), w| {
            (left + (w.squares - w.gain).max(0.0), freedom + w.equations - w.freedoms)
        });
        let mut covered: Vec<u32> = own.flat_map(|w| w.views.iter().copied()).collect();
        covered.sort_unstable();
        covered.dedup();
        // windows over a corner of the scene have the noise of that corner
        let n_views = rays.view_component.iter().filter(|&&v| v == c as i32).count();
        let is_enough = freedom >= LEAST_TENSION_FREEDOM && 2 * covered.len() > n_views;
        if is_enough { floor((left / freedom).sqrt()) } else { f64::NAN }
    };
    (0..rays.n_components).map(of_component).collect()
}

/// Windows strained beyond the limit, those that share views together.
pub(super) fn strained(windows: &[Window], limit: f64) -> Vec<Finding> {
    let mut groups: Vec<(Vec<u32>, &Window)> = Vec::new();
    for window in windows.iter().filter(|w| w.strain() > limit) {
        let mut views = window.views.clone();
        let mut worst = window;
        let (touched, apart) = groups.into_iter().partition(|(g, _)| g.iter().any(|i| views.binary_search(i).is_ok()));
        groups = apart;
        for (more, other) in touched {
            views.extend(more);
            worst = if other.strain() > worst.strain() { other } else { worst };
        }
        views.sort_unstable();
        views.dedup();
        groups.push((views, worst));
    }
    groups.sort_by(|a, b| a.0.cmp(&b.0));
    let finding = |(views, worst): (Vec<u32>, &Window)| Finding::Strained {
        views,
        strain: worst.strain(),
        scene_rad: (worst.scene_squares / worst.scene_equations).sqrt(),
        alone_rad: worst.alone_squared().sqrt(),
    };
    groups.into_iter().map(finding).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Rotation, scale, sub};

    /// Change of both components of the residual as the view moves and its rays turn, by central differences.
    fn by_differences<const D: usize, const V: usize>(ray: &Ray<D>) -> [[f64; V]; 2] {
        let step = 1e-6;
        let mut columns = [[0.0; V]; 2];
        for v in 0..V {
            let residual = |by: f64| -> [f64; 2] {
                let mut apart = scale(ray.distance, &ray.towards);
                let mut seen = ray.towards;
                if v < D {
                    // the centre moves back, so that the point seems to move on
                    apart[v] += by;
                } else {
                    let mut turn = [0.0; 3];
                    turn[v - D] = by;
                    seen = Rotation::<D>::exp_of(&turn).apply(&seen);
                }
                let off = if v < D { sub(&normalized(&apart), &ray.towards) } else { sub(&seen, &ray.towards) };
                [dot(&ray.basis[0], &off), dot(&ray.basis[1], &off)]
            };
            let (ahead, back) = (residual(step), residual(-step));
            for k in 0..D - 1 {
                columns[k][v] = (ahead[k] - back[k]) / (2.0 * step);
            }
        }
        columns
    }

    fn check_columns<const D: usize, const V: usize>(towards: Vector<D>) {
        let towards = normalized(&towards);
        let ray = Ray { towards, distance: 2.5, basis: tangent_basis(&towards), error: [0.0; 2] };
        let expected = by_differences::<D, V>(&ray);
        for k in 0..D - 1 {
            let found: [f64; V] = view_columns(&ray.basis[k], &ray);
            for v in 0..V {
                assert!((found[v] - expected[k][v]).abs() < 1e-8, "component {k} by freedom {v}: {found:?}");
            }
        }
    }

    #[test]
    fn columns_are_derivatives() {
        check_columns::<3, 6>([0.3, -0.5, 0.7]);
        check_columns::<2, 3>([-0.4, 0.2]);
    }

    #[test]
    fn the_factor_reproduces_the_matrix() {
        let full = [[4.0, 2.0, 0.6], [2.0, 5.0, 1.0], [0.6, 1.0, 3.0]];
        let mut lower: Vec<f64> = full.as_flattened().to_vec();
        assert_eq!(factor(&mut lower, 3), Some(()));
        let mut x = [1.0, 2.0, 3.0];
        forward(&lower, 3, 0, &mut x);
        for r in 0..3 {
            let back: f64 = (0..=r).map(|c| lower[3 * r + c] * x[c]).sum();
            assert!((back - (r + 1) as f64).abs() < 1e-14);
            let product: f64 = (0..=r).map(|c| lower[3 * r + c] * lower[3 * r + c]).sum();
            assert!((product - full[r][r]).abs() < 1e-14);
        }
        assert_eq!(factor(&mut [1.0, 0.0, 2.0, 1.0], 2), None);
    }
}
