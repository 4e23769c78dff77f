//! Derivatives by central differences, for tests of the analytic ones.

use super::poses::{Poses, turn_of};
use crate::bundle::part::Lanes;
use crate::bundle::turns::shift_of;

/// One column for each of the `V` unknowns `(omega, dc)` of the node 0.
pub(super) fn by_unknowns<const D: usize, const V: usize, const N: usize>(
    poses: &Poses<D>,
    of: impl Fn(&Poses<D>) -> [f64; N],
) -> [[f64; N]; V] {
    by_entries(|step: &[f64; V]| {
        let mut moved = poses.clone();
        moved.cam_from_world[0] = poses.cam_from_world[0].compose(&turn_of::<D, V>(step));
        moved.centers[0] = poses.centers[0].plus(&shift_of::<D, V>(step));
        of(&moved)
    })
}

/// One column for each coordinate of a place.
pub(super) fn by_place<const D: usize, const N: usize>(
    place: &Lanes,
    of: impl Fn(&Lanes) -> [f64; N],
) -> [[f64; N]; D] {
    by_entries(|step: &[f64; D]| of(&place.plus(&Lanes::from_vector::<D>(step))))
}

fn by_entries<const K: usize, const N: usize>(at: impl Fn(&[f64; K]) -> [f64; N]) -> [[f64; N]; K] {
    const STEP: f64 = 1e-6;
    std::array::from_fn(|k| {
        let [ahead, behind] = [STEP, -STEP].map(|s| at(&std::array::from_fn(|c| if c == k { s } else { 0.0 })));
        std::array::from_fn(|r| (ahead[r] - behind[r]) / (2.0 * STEP))
    })
}
