//! Where every view knows the vertical well, only turns about it are left.
//!
//! With `cam_from_level` the shortest rotation that takes the z axis to the measured up, `cam_from_world =
//! cam_from_level * Rz(psi)`, and an edge says `psi_second - psi_first` = the turn about z nearest to
//! `cam_from_level_second^-1 * second_from_first * cam_from_level_first`. What is left of that rotation is a tilt. It must
//! be small: a wrong edge seldom keeps the vertical.

use crate::geometry::{Vector, apply, dot};

use super::averaging::{cut, median};
use super::turns::{Angle, AnglePrior, LEAST_HORIZONTAL, Quaternion, SpatialPrior, Turn, wrapped};

/// An up no worse than this share of an edge's sigma counts as exact: less than a hundredth of the information is lost.
const TIGHT: f64 = 0.1;
/// Median of the length of two normal variables.
const MEDIAN_TILT: f64 = 1.177;
/// Tilts are never judged by a noise greater than this, radians (10 degrees).
const MOST_NOISE_RAD: f64 = 0.175;

/// Up of each view; `None` where some view has none, or none as tight as the edges ask. `noise` is relative to their sigma.
pub(super) fn tight_ups(
    n_views: usize,
    priors: &[(u32, SpatialPrior)],
    edge_sigma: &[f64],
    noise: f64,
) -> Option<Vec<Vector<3>>> {
    let least = noise * edge_sigma.iter().copied().fold(f64::INFINITY, f64::min);
    let mut ups = vec![None; n_views];
    for (view, prior) in priors {
        match prior {
            SpatialPrior::Up { up, weight } if weight.powf(-0.5) <= TIGHT * least => ups[*view as usize] = Some(*up),
            SpatialPrior::Heading { .. } => {}
            _ => return None,
        }
    }
    ups.into_iter().collect()
}

/// The problem of turns about the vertical.
pub(super) struct Levelled {
    pub cam_from_level: Vec<Quaternion>,
    pub turn: Vec<Angle>,
    /// Does the edge keep the vertical?
    pub upright: Vec<bool>,
    pub priors: Vec<(u32, AnglePrior)>,
}

/// Reduces edges and priors to turns about the vertical.
pub(super) fn level(
    ups: &[Vector<3>],
    ends: &[(u32, u32)],
    relative: &[Quaternion],
    sigma: &[f64],
    priors: &[(u32, SpatialPrior)],
) -> Levelled {
    let cam_from_level: Vec<Quaternion> = ups.iter().map(Quaternion::from_z_to).collect();
    let level_turn = |(&(a, b), second_from_first): (&(u32, u32), &Quaternion)| {
        let (a, b) = (&cam_from_level[a as usize], &cam_from_level[b as usize]);
        b.inverse().compose(&second_from_first.compose(a))
    };
    let turns: Vec<Quaternion> = ends.iter().zip(relative).map(level_turn).collect();
    let mut ratios: Vec<f64> = turns.iter().zip(sigma).map(|(turn, sigma)| turn.tilt() / sigma).collect();
    // half of the edges or more are taken to be right, and noisier than stated if they say so
    let noise = (median(&mut ratios).unwrap_or(1.0) / MEDIAN_TILT).max(1.0);
    let widest = |sigma: f64| cut(3) * (noise * sigma).min(MOST_NOISE_RAD.max(sigma));
    let psi = |(view, prior): &(u32, SpatialPrior)| {
        let view = *view;
        Some((view, about_vertical(&cam_from_level[view as usize], &ups[view as usize], prior)?))
    };
    Levelled {
        turn: turns.iter().map(|turn| Angle(turn.angle_about_z())).collect(),
        upright: turns.iter().zip(sigma).map(|(turn, sigma)| turn.tilt() <= widest(*sigma)).collect(),
        priors: priors.iter().filter_map(psi).collect(),
        cam_from_level,
    }
}

/// What a prior says of `psi`. A compass: the camera axis points along its azimuth in the level frame less `psi`.
fn about_vertical(cam_from_level: &Quaternion, up: &Vector<3>, prior: &SpatialPrior) -> Option<AnglePrior> {
    match prior {
        SpatialPrior::Up { .. } => None,
        SpatialPrior::Heading { heading_rad, forward, weight } => {
            let f = cam_from_level.inverse().apply(forward);
            (f[0].hypot(f[1]) >= LEAST_HORIZONTAL)
                .then(|| AnglePrior { cam_from_world: Angle(wrapped(f[1].atan2(f[0]) - heading_rad)), weight: *weight })
        }
        SpatialPrior::Orientation { cam_from_world, information } => Some(AnglePrior {
            cam_from_world: Angle(cam_from_level.inverse().compose(cam_from_world).angle_about_z()),
            weight: dot(up, &apply(information, up)),
        }),
    }
}
