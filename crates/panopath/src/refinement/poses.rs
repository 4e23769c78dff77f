//! Cameras that turn and move, and what that does to rays.
//!
//! A view has `cam_from_world = R` and the centre `c`. Its unknowns are a turn `omega` in the world and a shift:
//! `R <- R exp(omega)`, `c <- c + dc` (the same turn in the camera, on the left, is `phi = R omega`). A bearing `b` that starts
//! at the lever arm `a` in the view's frame is the ray `v = R^T b` from the station `s = c + R^T a`. The turn takes
//! both with it: `dv = v x omega`, `ds = dc + (s - c) x omega`. Seen from a point `x` that is met along `u = x - s`,
//! the residual `v - u/|u|` changes as if the station had moved by `q = dc + (x - c) x omega`, up to second order in the
//! residual: `K = [[x - c]_x, I]`.

use rayon::prelude::*;

use crate::bundle::part::{Lanes, Layout};
use crate::bundle::turns::{shift_of, turns};
use crate::geometry::{Rotation, Vector, apply};

/// Where the nodes of a part stand and how they are turned.
#[derive(Clone)]
pub(super) struct Poses<const D: usize> {
    pub cam_from_world: Vec<Rotation<D>>,
    pub centers: Vec<Lanes>,
}

/// What the views measured, in their own frames.
pub(super) struct Sights<const D: usize> {
    /// Bearing of each observation of a part, with its precision in lane 3.
    pub bearing: Vec<Lanes>,
    /// Lever arm of each station.
    pub lever: Vec<Vector<D>>,
}

impl<const D: usize> Sights<D> {
    /// Rays in the world, as the poses turn them.
    pub fn rays(&self, layout: &Layout, poses: &Poses<D>) -> Vec<Lanes> {
        let world_from_cam: Vec<Rotation<D>> = poses.cam_from_world.iter().map(Rotation::inverse).collect();
        let turn = |(o, bearing): (usize, &Lanes)| {
            let world_from_cam = world_from_cam[layout.node_of(o) as usize].matrix();
            let mut ray = Lanes::from_vector::<D>(&apply(world_from_cam, &bearing.vector::<D>()));
            ray.0[3] = bearing.0[3];
            ray
        };
        self.bearing.par_iter().enumerate().with_min_len(4096).map(turn).collect()
    }

    /// Where the stations are.
    pub fn stations(&self, layout: &Layout, poses: &Poses<D>) -> Vec<Lanes> {
        let at = |(lever, &node): (&Vector<D>, &u32)| {
            let arm = poses.cam_from_world[node as usize].inverse().apply(lever);
            poses.centers[node as usize].plus(&Lanes::from_vector::<D>(&arm))
        };
        self.lever.iter().zip(&layout.node).map(at).collect()
    }
}

impl<const D: usize> Poses<D> {
    /// The poses after a step.
    pub fn moved<const V: usize>(&self, step: &[[f64; V]]) -> Self {
        let turned = self.cam_from_world.iter().zip(step).map(|(r, x)| r.compose(&turn_of::<D, V>(x)));
        let moved = self.centers.iter().zip(step).map(|(c, x)| c.plus(&shift_of::<D, V>(x)));
        Self { cam_from_world: turned.collect(), centers: moved.collect() }
    }
}

/// Rotation by the first unknowns of a camera.
pub(super) fn turn_of<const D: usize, const V: usize>(x: &[f64; V]) -> Rotation<D> {
    Rotation::exp_of(&x[..turns(D)])
}

#[cfg(test)]
mod tests {
    use super::super::differences::{by_place, by_unknowns};
    use super::*;
    use crate::bundle::newton::CameraStep;
    use crate::bundle::part::{Part, Stations};
    use crate::bundle::reduced::{Freedoms, Row};
    use crate::bundle::turns::{PoseRow, PoseStep, Turns};
    use crate::geometry::normalized;

    /// One observation of one point from a station off the centre.
    struct Sight<const D: usize> {
        part: Part<D>,
        sights: Sights<D>,
        poses: Poses<D>,
        point: Lanes,
    }

    /// With the point where it was seen: residuals are zero, where the module's text says the derivative is exact.
    fn sight<const D: usize>(k: usize, arm: f64) -> Sight<D> {
        let wave = |p: usize, c: usize| (1.7 * (p + 3 * k) as f64 + 2.3 * c as f64).sin();
        let turn: Vec<f64> = (0..turns(D)).map(|c| 2.0 * wave(0, c)).collect();
        let cam_from_world = Rotation::<D>::exp_of(&turn);
        let center: Vector<D> = std::array::from_fn(|c| wave(1, c));
        let point: Vector<D> = std::array::from_fn(|c| center[c] + 3.0 * wave(2, c) + 0.5);
        let lever: Vector<D> = std::array::from_fn(|c| arm * wave(3, c));
        let seen = cam_from_world.apply(&crate::geometry::sub(&point, &center));
        let bearing = normalized(&crate::geometry::sub(&seen, &lever));
        let stations = Stations { node: vec![0], node_freedom: vec![turns(D) + D], gauge_freedom: 0 };
        let part = Part::new(stations, 1, &[0], &[0], |_| 0, |_| Lanes::from_vector::<D>(&bearing));
        let sights = Sights { bearing: vec![Lanes::from_vector::<D>(&bearing)], lever: vec![lever] };
        let poses = Poses { cam_from_world: vec![cam_from_world], centers: vec![Lanes::from_vector::<D>(&center)] };
        Sight { part, sights, poses, point: Lanes::from_vector::<D>(&point) }
    }

    impl<const D: usize> Sight<D> {
        /// `v - u / |u|` in the frame of the camera.
        fn residual(&self, poses: &Poses<D>, point: &Lanes) -> Vector<D> {
            let ray = self.sights.rays(&self.part, poses)[0];
            let u = point.minus(&self.sights.stations(&self.part, poses)[0]);
            let error = ray.plus_scaled(-1.0 / u.dot::<D>(&u).sqrt(), &u);
            poses.cam_from_world[0].apply(&error.vector::<D>())
        }
    }

    fn close(found: f64, wanted: f64, what: &str) {
        assert!((found - wanted).abs() < 1e-8 * (1.0 + wanted.abs()), "{what}: {found}, by differences {wanted}");
    }

    fn check<const D: usize, const V: usize>(k: usize, arm: f64) {
        let what = format!("d = {D}, case {k}, lever {arm}");
        let it = sight::<D>(k, arm);
        let (centers, points) = (&it.poses.centers, [it.point]);
        let turns = Turns { part: &it.part, centers, points: &points, vectors: &[] };
        // the derivative by the point, turned back to the world: rows of -(I - u u^T) / r
        let by_point = by_place::<D, D>(&it.point, |x| it.residual(&it.poses, x));
        let by_pose = by_unknowns::<D, V, D>(&it.poses, |poses| it.residual(poses, &it.point));
        let mut rows = [PoseRow::ZERO; D];
        for r in 0..D {
            let row = Lanes::from_vector::<D>(&std::array::from_fn(|c| -by_point[c][r]));
            rows[r] = Freedoms::<D, V>::lift(&turns, 0, 0, &row);
            for c in 0..V {
                close(rows[r].at(c), by_pose[c][r], &format!("{what}, lift ({r}, {c})"));
            }
        }
        // K^T, against K by rows of the identity
        let unit = |r: usize| Lanes(std::array::from_fn(|c| f64::from(u8::from(c == r))));
        let k_rows: [PoseRow; D] = std::array::from_fn(|r| Freedoms::<D, V>::lift(&turns, 0, 0, &unit(r)));
        let lifted = Freedoms::<D, V>::lift_rows(&turns, 0, 0, &rows);
        for r in 0..V {
            for c in 0..V {
                let wanted = (0..D).map(|k| k_rows[k].at(r) * rows[k].at(c)).sum();
                close(lifted[r].at(c), wanted, &format!("{what}, lift_rows ({r}, {c})"));
            }
        }
        // K times a step
        let step: [f64; V] = std::array::from_fn(|c| 0.3 - 0.2 * c as f64);
        let follow = PoseStep::<D, V> { layout: &it.part, centers, step: vec![step] };
        let displaced = follow.displacement(0, &it.point);
        for r in 0..D {
            let wanted = (0..V).map(|c| k_rows[r].at(c) * step[c]).sum();
            close(displaced.0[r], wanted, &format!("{what}, displacement {r}"));
        }
        assert!(displaced.0[D..].iter().all(|&x| x == 0.0), "{what}: lanes beyond the dimension stay zero");
    }

    #[test]
    fn derivatives_by_poses_are_right() {
        for k in 0..8 {
            for arm in [0.0, 0.4] {
                check::<3, 6>(k, arm);
                check::<2, 3>(k, arm);
            }
        }
    }
}
