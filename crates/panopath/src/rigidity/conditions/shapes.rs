//! Shapes fitted to places: flats (a place, a line, a plane), conics and pairs of lines.
//!
//! Distances are in the units of the places. A set lies on a shape where its farthest member does, to within a limit.

use crate::geometry::{Vector, add, dot, norm, normalized, scale, sub};
use crate::least_squares::{right_singular, symmetric_eigen};

/// Coefficients `a, b, c, d, e, f` of `a x^2 + b x y + c y^2 + d x + e y + f = 0`.
pub(super) type Coefficients = [f64; 6];

/// The flat through the centroid that fits best, for each dimension at once: principal axes.
pub(super) struct Flat<const D: usize> {
    pub center: Vector<D>,
    /// Unit vectors, the one of the largest spread first.
    pub axes: [Vector<D>; D],
    /// Largest distance of a member from the centre, from the line, from the plane.
    off: [f64; D],
}

impl<const D: usize> Flat<D> {
    /// `None` for an empty set, and where a coordinate is not finite.
    pub(super) fn fit(members: &[Vector<D>]) -> Option<Self> {
        let share = 1.0 / members.len() as f64;
        let center = members.iter().fold([0.0; D], |sum, x| add(&sum, &scale(share, x)));
        let mut spread = [[0.0; D]; D];
        for x in members {
            let x = sub(x, &center);
            for (r, row) in spread.iter_mut().enumerate() {
                for (c, entry) in row.iter_mut().enumerate() {
                    *entry += share * x[r] * x[c];
                }
            }
        }
        let (_, mut axes) = symmetric_eigen(&spread).ok()?;
        axes.reverse();
        let mut flat = Self { center, axes, off: [0.0; D] };
        for dimension in 0..D {
            flat.off[dimension] = members.iter().map(|x| flat.distance(x, dimension)).fold(0.0, f64::max);
        }
        Some(flat)
    }

    /// Largest distance of a member from the centroid: the size of the set.
    pub(super) fn radius(&self) -> f64 {
        self.off[0]
    }

    /// Dimension of the smallest of these flats that holds every member to within `limit`.
    pub(super) fn dimension(&self, limit: f64) -> usize {
        (0..D).find(|&k| self.off[k] <= limit).unwrap_or(D)
    }

    /// How far the members are from the flat of this dimension, relative to their size.
    pub(super) fn misfit(&self, dimension: usize) -> f64 {
        if dimension < D && self.off[0] > 0.0 { self.off[dimension] / self.off[0] } else { 0.0 }
    }

    /// Distance of a place from the flat of this dimension.
    pub(super) fn distance(&self, x: &Vector<D>, dimension: usize) -> f64 {
        let mut rest = sub(x, &self.center);
        for axis in &self.axes[..dimension] {
            rest = sub(&rest, &scale(dot(&rest, axis), axis));
        }
        norm(&rest)
    }

    /// Coordinates along the first two axes.
    pub(super) fn in_plane(&self, x: &Vector<D>) -> [f64; 2] {
        let x = sub(x, &self.center);
        [dot(&x, &self.axes[0]), dot(&x, &self.axes[1])]
    }

    /// A line as the record has it: a point, then the direction.
    pub(super) fn line(&self) -> Vec<f64> {
        self.center.iter().chain(&self.axes[0]).copied().collect()
    }
}

/// Number of different places, counted up to `most`; places nearer than `limit` are the same.
pub(super) fn count_places<const D: usize>(members: impl Iterator<Item = Vector<D>>, limit: f64, most: usize) -> usize {
    let mut places: Vec<Vector<D>> = Vec::new();
    for x in members {
        if places.iter().all(|y| norm(&sub(&x, y)) > limit) {
            places.push(x);
            if places.len() == most {
                break;
            }
        }
    }
    places.len()
}

/// Plane coordinates in which a set has unit spread along both of its axes: `y = b (x - center)`.
struct Whitening {
    center: [f64; 2],
    b: [[f64; 2]; 2],
}

impl Whitening {
    fn of(members: &[[f64; 2]]) -> Option<Self> {
        let flat = Flat::fit(members)?;
        let share = 1.0 / members.len() as f64;
        let spread = |axis: &[f64; 2]| -> f64 {
            members.iter().map(|x| share * dot(&sub(x, &flat.center), axis).powi(2)).sum::<f64>().sqrt()
        };
        let b = flat.axes.map(|axis| scale(1.0 / spread(&axis), &axis));
        b.iter().flatten().all(|x| x.is_finite()).then_some(Self { center: flat.center, b })
    }

    fn apply(&self, x: &[f64; 2]) -> [f64; 2] {
        crate::geometry::apply(&self.b, &sub(x, &self.center))
    }

    /// The line `l . (y, 1) = 0`, in the original coordinates.
    fn line_back(&self, l: &[f64; 3]) -> [f64; 3] {
        let a = [0, 1].map(|c| l[0] * self.b[0][c] + l[1] * self.b[1][c]);
        [a[0], a[1], l[2] - dot(&a, &self.center)]
    }

    /// A conic of `y`, in the original coordinates and of unit length.
    fn conic_back(&self, conic: &Coefficients) -> Coefficients {
        // (y, 1) = h (x, 1), so the matrix of the conic becomes h^T m h
        let shift = crate::geometry::apply(&self.b, &self.center);
        let h = [[self.b[0][0], self.b[0][1], -shift[0]], [self.b[1][0], self.b[1][1], -shift[1]], [0.0, 0.0, 1.0]];
        let m = matrix_of(conic);
        let entry = |r: usize, c: usize| -> f64 {
            (0..3).map(|i| (0..3).map(|j| h[i][r] * m[i][j] * h[j][c]).sum::<f64>()).sum()
        };
        let back = [entry(0, 0), 2.0 * entry(0, 1), entry(1, 1), 2.0 * entry(0, 2), 2.0 * entry(1, 2), entry(2, 2)];
        normalized(&back)
    }
}

fn matrix_of(conic: &Coefficients) -> [[f64; 3]; 3] {
    let [a, b, c, d, e, f] = *conic;
    [[a, 0.5 * b, 0.5 * d], [0.5 * b, c, 0.5 * e], [0.5 * d, 0.5 * e, f]]
}

/// The conics through all members of a set that is on no line.
pub(super) struct Conics {
    frame: Whitening,
    /// Independent ones, in the coordinates of the frame.
    pub through: Vec<Coefficients>,
    /// Farthest member from the first of them.
    pub misfit: f64,
}

/// Value of a conic at a member below which only rounding is left; coordinates and coefficients are of order one.
const ROUNDING: f64 = 1e-13;

impl Conics {
    /// Conics that pass all members at a distance of at most `limit`, the value at a member being taken for a distance by
    /// the rms gradient. (By its own gradient, a member where two lines cross would look far away for any noise at all.)
    pub(super) fn through(members: &[[f64; 2]], limit: f64) -> Option<Self> {
        let frame = Whitening::of(members)?;
        let places: Vec<[f64; 2]> = members.iter().map(|x| frame.apply(x)).collect();
        let rows: Vec<f64> = places.iter().flat_map(|&[x, y]| [x * x, x * y, y * y, x, y, 1.0]).collect();
        let (_, vectors) = right_singular(6, &rows)?;
        let (mut through, mut misfit) = (Vec::new(), 0.0);
        for vector in vectors.iter().rev() {
            let conic: Coefficients = std::array::from_fn(|k| vector[k]);
            let distance = frame.distance(&conic, &places);
            if distance.is_nan() || distance > limit {
                break;
            }
            misfit = f64::max(misfit, if through.is_empty() { distance } else { 0.0 });
            through.push(conic);
        }
        Some(Self { frame, through, misfit })
    }

    /// The first conic in the coordinates of the members.
    pub(super) fn coefficients(&self) -> Option<Coefficients> {
        self.through.first().map(|conic| self.frame.conic_back(conic))
    }

    /// The two lines that the first conic is made of, as points and directions, where every member lies on one of them
    /// to within `limit`.
    pub(super) fn two_lines(&self, members: &[[f64; 2]], limit: f64) -> Option<[Flat<2>; 2]> {
        let (values, vectors) = symmetric_eigen(&matrix_of(self.through.first()?)).ok()?;
        if values[0] >= 0.0 || values[2] <= 0.0 {
            return None;
        }
        let (p, q) = (scale(values[2].sqrt(), &vectors[2]), scale((-values[0]).sqrt(), &vectors[0]));
        let lines = [add(&p, &q), sub(&p, &q)].map(|l| self.frame.line_back(&l));
        let off = |l: &[f64; 3], x: &[f64; 2]| (l[0] * x[0] + l[1] * x[1] + l[2]).abs() / l[0].hypot(l[1]);
        let (mut first, mut second) = (Vec::new(), Vec::new());
        for x in members {
            if off(&lines[0], x) <= off(&lines[1], x) { first.push(*x) } else { second.push(*x) }
        }
        // a line that fits its own members best, rather than a factor of the conic that fits all
        let (first, second) = (Flat::fit(&first)?, Flat::fit(&second)?);
        (first.off[1] <= limit && second.off[1] <= limit).then_some([first, second])
    }
}

impl Whitening {
    /// Farthest member from a conic, in the original units.
    fn distance(&self, conic: &Coefficients, places: &[[f64; 2]]) -> f64 {
        let [a, b, c, d, e, f] = *conic;
        let (mut largest, mut squares) = (0.0f64, 0.0);
        for &[x, y] in places {
            let value = a * x * x + b * x * y + c * y * y + d * x + e * y + f;
            largest = largest.max(value.abs());
            let slope = [2.0 * a * x + b * y + d, b * x + 2.0 * c * y + e];
            let slope: [f64; 2] = std::array::from_fn(|k| slope[0] * self.b[0][k] + slope[1] * self.b[1][k]);
            squares += dot(&slope, &slope);
        }
        let gradient = (squares / places.len() as f64).sqrt();
        if largest <= ROUNDING { 0.0 } else { largest / gradient }
    }
}

/// Which conic it is; `slack` is how far a ratio of axes may be from that of a circle or a parabola.
pub(super) fn name_of_conic(conic: &Coefficients, slack: f64) -> &'static str {
    let [a, b, c, ..] = *conic;
    let (half_trace, split) = (0.5 * (a + c), (0.5 * (a - c)).hypot(0.5 * b));
    // eigenvalues of the quadratic part, the larger one by magnitude first
    let large = half_trace + split.copysign(half_trace);
    let small = half_trace - split.copysign(half_trace);
    let ratio = small / large;
    if (ratio - 1.0).abs() <= slack {
        "circle"
    } else if ratio.is_nan() || ratio.abs() <= slack {
        "parabola"
    } else if ratio > 0.0 {
        "ellipse"
    } else {
        "hyperbola"
    }
}
