//! What bearings and priors leave free of a component: its place, its turn, its size.

use super::options::Held;
use super::priors::PartPriors;
use crate::bundle::determinacy::Motions;
use crate::bundle::part::Lanes;
use crate::bundle::turns::turns;
use crate::geometry::{Vector, normalized};

/// Freedoms of a component that nothing fixes.
#[derive(Clone)]
pub(super) struct Gauge<const D: usize> {
    pub translation: bool,
    pub rotation: FreeRotation<D>,
    pub scale: bool,
    /// What turns and changes of size leave in place: the one place that is known, or the centroid.
    pub origin: Vector<D>,
}

/// Which turns are free.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum FreeRotation<const D: usize> {
    None,
    /// About a direction of the world that is measured.
    About(Vector<D>),
    All,
}

impl<const D: usize> Gauge<D> {
    pub fn of(
        views: &[u32],
        centers: &[Lanes],
        held: &Held,
        priors: &PartPriors<D>,
        holds_points: bool,
        has_levers: bool,
    ) -> Self {
        let is_held = |list: &[bool], view: u32| list.get(view as usize) == Some(&true);
        let held_centers =
            views.iter().zip(centers).filter(|(v, _)| is_held(&held.centers, **v)).map(|(_, c)| c.vector::<D>());
        let known: Vec<Vector<D>> = held_centers.chain(priors.positions().map(|(_, p)| p)).collect();
        let turned = views.iter().any(|&v| is_held(&held.rotations, v));
        let rotation = if turned || known.len() > 1 || holds_points || priors.fix_rotation() {
            FreeRotation::None
        } else {
            match priors.only_direction() {
                Some(_) if D == 2 => FreeRotation::None,
                Some(direction) => FreeRotation::About(normalized(&direction)),
                None => FreeRotation::All,
            }
        };
        Self {
            translation: known.is_empty() && !holds_points,
            rotation,
            scale: known.len() < 2 && !holds_points && !has_levers,
            origin: if known.len() == 1 { known[0] } else { centroid(centers) },
        }
    }

    /// All freedoms of a similarity, or of a rigid motion where lever arms tell the size.
    pub fn whole(centers: &[Lanes], has_levers: bool) -> Self {
        Self { translation: true, rotation: FreeRotation::All, scale: !has_levers, origin: centroid(centers) }
    }

    /// Is the component known up to a similarity, and no better?
    pub fn is_free(&self) -> bool {
        self.translation && self.rotation == FreeRotation::All
    }

    /// Number of freedoms.
    pub fn dim(&self) -> usize {
        let rotations = match self.rotation {
            FreeRotation::None => 0,
            FreeRotation::About(_) => 1,
            FreeRotation::All => turns(D),
        };
        usize::from(self.translation) * D + rotations + usize::from(self.scale)
    }

    /// Axes of the free turns; in the plane the one entry counts.
    fn axes(&self) -> Vec<[f64; 3]> {
        match self.rotation {
            FreeRotation::None => Vec::new(),
            FreeRotation::About(axis) => vec![std::array::from_fn(|c| if c < D { axis[c] } else { 0.0 })],
            FreeRotation::All => (0..turns(D)).map(|k| std::array::from_fn(|c| f64::from(c == k))).collect(),
        }
    }

    /// What each freedom does to the unknowns `(omega, dc)` of all cameras: one vector of `V` numbers a camera for each.
    pub fn basis<const V: usize>(&self, centers: &[Lanes]) -> Vec<Vec<f64>> {
        let motions = Motions { translation: self.translation, axes: &self.axes(), scale: self.scale };
        motions.of_cameras::<D, V>(centers, &self.origin)
    }

    /// What has to stay zero of the unknowns of a node, so that turns and places are fixed: its own.
    pub fn pinned_unknowns(&self, node: usize) -> Vec<usize> {
        let (n_turns, unknowns) = (turns(D), turns(D) + D);
        let first = node * unknowns;
        let mut pinned = Vec::new();
        match self.rotation {
            FreeRotation::None => {}
            // the component that has most of the axis
            FreeRotation::About(axis) => {
                pinned.push(first + (0..D).fold(0, |best, c| if axis[c].abs() > axis[best].abs() { c } else { best }));
            }
            FreeRotation::All => pinned.extend(first..first + n_turns),
        }
        if self.translation {
            pinned.extend(first + n_turns..first + unknowns);
        }
        pinned
    }
}

fn centroid<const D: usize>(centers: &[Lanes]) -> Vector<D> {
    std::array::from_fn(|c| centers.iter().map(|x| x.0[c]).sum::<f64>() / centers.len() as f64)
}

/// Solves a small system by Gaussian elimination with pivoting, for several right-hand sides given by columns; `None` where
/// it is singular, with `tolerance` relative to the largest entry.
pub(super) fn solve_small(mut a: Vec<Vec<f64>>, mut b: Vec<Vec<f64>>, tolerance: f64) -> Option<Vec<Vec<f64>>> {
    let n = a.len();
    let largest = a.iter().flatten().fold(0.0f64, |m, x| m.max(x.abs()));
    for k in 0..n {
        let pivot = (k..n).fold(k, |best, r| if a[r][k].abs() > a[best][k].abs() { r } else { best });
        if a[pivot][k].abs().is_nan() || a[pivot][k].abs() <= tolerance * largest {
            return None;
        }
        a.swap(k, pivot);
        b.iter_mut().for_each(|column| column.swap(k, pivot));
        for r in (0..n).filter(|&r| r != k) {
            let factor = a[r][k] / a[k][k];
            for c in k..n {
                let from = a[k][c];
                a[r][c] -= factor * from;
            }
            for column in &mut b {
                column[r] -= factor * column[k];
            }
        }
    }
    for column in &mut b {
        for (k, x) in column.iter_mut().enumerate() {
            *x /= a[k][k];
        }
    }
    Some(b)
}
