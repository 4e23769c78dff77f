//! Camera positions and points from bearings of known orientation.
use crate::geometry::Rotation;
use crate::tracks::Tracks;

mod descent;
mod part;
mod parts;
mod reduced;
mod robust;
mod start;

pub use reduced::LinearSolver;
use part::{Lanes, Part};

/// Wall-clock seconds of each stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Timings {
    pub layout_s: f64,
    pub analyse_s: f64,
    pub start_s: f64,
    pub descent_s: f64,
}

pub fn trial<const D: usize>(tracks: &Tracks<D>, cam_from_world: Option<&[Rotation<D>]>) -> (Vec<[f64; D]>, Timings, usize, f64) {
    let clock = std::time::Instant::now();
    let mut timings = Timings::default();
    let all: Vec<u32> = (0..tracks.len() as u32).collect();
    let world_from_cam: Option<Vec<Rotation<D>>> = cam_from_world.map(|r| r.iter().map(Rotation::inverse).collect());
    let part = Part::<D>::new(
        tracks.n_views(), tracks.n_tracks(), &all, tracks.track(), |o| tracks.view()[o],
        |o| { let b = &tracks.bearing()[o]; let mut l = Lanes::from_vector::<D>(&world_from_cam.as_ref().map_or(*b, |r| r[tracks.view()[o] as usize].apply(b))); l.0[3] = 1.0; l },
        |_| true);
    timings.layout_s = clock.elapsed().as_secs_f64();
    let s = robust::solve_part(&part, None, LinearSolver::Auto, 50, &mut timings).unwrap();
    (s.estimate.centers.iter().map(|c| c.vector()).collect(), timings, s.iterations, s.sigma)
}
