//! Cameras that turn and move, as points see them.
//!
//! A turn `omega` in the world and a shift `dc` move the origin of a ray, as seen from its point `x`, by
//! `q = dc + (x - c) x omega`, up to second order in the residual: `K = [[x - c]_x, I]`.

use super::newton::CameraStep;
use super::part::{Lanes, Layout, Part};
use super::reduced::{Freedoms, Row};

/// Components of a turn: one in the plane, three in space.
pub(crate) const fn turns(d: usize) -> usize {
    d * (d - 1) / 2
}

/// The unknowns that follow them.
pub(crate) fn shift_of<const D: usize, const V: usize>(x: &[f64; V]) -> Lanes {
    Lanes::from_vector::<D>(&std::array::from_fn(|c| x[V - D + c]))
}

/// A row of a block of poses: at most six numbers.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct PoseRow([f64; 8]);

impl Row for PoseRow {
    const ZERO: Self = Self([0.0; 8]);

    #[inline(always)]
    fn plus(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|c| self.0[c] + other.0[c]))
    }

    #[inline(always)]
    fn plus_scaled(&self, s: f64, other: &Self) -> Self {
        Self(std::array::from_fn(|c| self.0[c] + s * other.0[c]))
    }

    #[inline(always)]
    fn at(&self, k: usize) -> f64 {
        self.0[k]
    }
}

/// Cameras that turn and move about the given centres.
pub(crate) struct Turns<'a, const D: usize> {
    pub part: &'a Part<D>,
    pub centers: &'a [Lanes],
    pub points: &'a [Lanes],
    /// Vectors of the points that move.
    pub vectors: &'a [Lanes],
}

impl<const D: usize> Turns<'_, D> {
    /// `x - c`.
    #[inline(always)]
    fn arm(&self, o: usize, j: usize) -> Lanes {
        let point = self.part.position(o, j, self.points, self.vectors);
        point.minus(&self.centers[self.part.node_of(o) as usize])
    }
}

impl<const D: usize, const V: usize> Freedoms<D, V> for Turns<'_, D> {
    type Row = PoseRow;

    #[inline(always)]
    fn lift(&self, o: usize, j: usize, row: &Lanes) -> PoseRow {
        let Lanes([x, y, z, _]) = *row;
        if V == D {
            return PoseRow([x, y, z, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        let Lanes([dx, dy, dz, _]) = self.arm(o, j);
        if D == 2 {
            PoseRow([x * dy - y * dx, x, y, 0.0, 0.0, 0.0, 0.0, 0.0])
        } else {
            PoseRow([y * dz - z * dy, z * dx - x * dz, x * dy - y * dx, x, y, z, 0.0, 0.0])
        }
    }

    #[inline(always)]
    fn lift_rows(&self, o: usize, j: usize, rows: &[PoseRow; D]) -> [PoseRow; V] {
        let mut lifted = [PoseRow::ZERO; V];
        if V == D {
            lifted[..D].copy_from_slice(rows);
            return lifted;
        }
        let Lanes([dx, dy, dz, _]) = self.arm(o, j);
        let zero = PoseRow::ZERO;
        if D == 2 {
            lifted[0] = zero.plus_scaled(dy, &rows[0]).plus_scaled(-dx, &rows[1]);
        } else {
            lifted[0] = zero.plus_scaled(dz, &rows[1]).plus_scaled(-dy, &rows[2]);
            lifted[1] = zero.plus_scaled(dx, &rows[2]).plus_scaled(-dz, &rows[0]);
            lifted[2] = zero.plus_scaled(dy, &rows[0]).plus_scaled(-dx, &rows[1]);
        }
        lifted[turns(D)..turns(D) + D].copy_from_slice(rows);
        lifted
    }

    #[inline(always)]
    fn holds_point(&self, j: usize) -> bool {
        self.part.holds_point(j)
    }
}

/// A step of all poses, as points see it.
pub(crate) struct PoseStep<'a, const D: usize, const V: usize> {
    pub layout: &'a Layout,
    pub centers: &'a [Lanes],
    pub step: Vec<[f64; V]>,
}

impl<const D: usize, const V: usize> CameraStep for PoseStep<'_, D, V> {
    #[inline(always)]
    fn displacement(&self, station: usize, point: &Lanes) -> Lanes {
        let node = self.layout.node[station] as usize;
        origin_shift::<D, V>(&self.step[node], &point.minus(&self.centers[node]))
    }
}

/// How the origin of a ray moves, as seen from its point at `arm` from the centre: `dc + arm x omega`, or `dc` alone where
/// the camera cannot turn (`V = D`).
#[inline(always)]
pub(crate) fn origin_shift<const D: usize, const V: usize>(step: &[f64; V], arm: &Lanes) -> Lanes {
    let Lanes([dx, dy, dz, _]) = *arm;
    let shift = Lanes::from_vector::<D>(&std::array::from_fn(|c| step[V - D + c]));
    if V == D {
        shift
    } else if D == 2 {
        shift.plus(&Lanes([step[0] * dy, -step[0] * dx, 0.0, 0.0]))
    } else {
        let (x, y, z) = (step[0], step[1], step[2]);
        shift.plus(&Lanes([dy * z - dz * y, dz * x - dx * z, dx * y - dy * x, 0.0]))
    }
}
