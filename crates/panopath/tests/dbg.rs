#![allow(warnings)]
mod common;
use common::*;
use panopath::geometry::*;
use panopath::positions::*;
use panopath::synthetic::*;
#[test]
fn chain() {
    for (k, n, m) in [(WorldKind::Chain, 150, 2500), (WorldKind::Line, 40, 500)] {
    let w = common::simulate::<2>(k, &options(n, m, 9));
    let s = solve(&w, &PositionOptions::default());
    println!("{:?} {:?} {:?}", s.summary.status, s.summary.sigma_rad, world_errors(&s, &w));
    println!("iters {} comps {} worst resid inl {:e}", s.summary.iterations, s.summary.n_components, s.residual_rad.iter().cloned().fold(0.0, f64::max));
    for j in 0..m { if s.track_component[j] < 0 {
        for o in 0..w.tracks.len() { if w.tracks.track()[o] as usize == j { print!("{} {:?} ", w.tracks.view()[o], w.tracks.bearing()[o]); } } println!("{j} {:?}", w.points[j]); } }
    }
}
#[test]
fn conic() {
    for conic in [Conic::Ellipse, Conic::Circle, Conic::Parabola, Conic::Hyperbola] {
        for noise_rad in [0.0, 1e-5, 1e-3, 0.5 * DEG] {
            for seed in 0..6 {
                let o = WorldOptions { conic: Some(conic), noise_rad, ..options(10, 30, seed) };
                let world = common::simulate::<2>(WorldKind::Ellipse, &o);
                let s = solve(&world, &PositionOptions::default());
                if s.summary.status != Status::Ambiguous { println!("{conic:?} {noise_rad} {seed} {:?} {:?}", s.summary, world_errors(&s, &world).camera_worst); }
            }
        }
    }
}
#[test]
fn huge() {
    let (centers, points) = (places::<3>(6, &[0.0; 3], 1.0, 1), places::<3>(20, &[0.0; 3], 2.0, 2));
    let near = see(&centers, &points, all_pairs(6, 20));
    let (n_views, n_tracks) = (200_000, 3_000_000);
    let view = near.view().iter().map(|v| v * 33_333 + 7).collect();
    let track = near.track().iter().map(|t| t * 150_000 + 11).collect();
    let tracks = panopath::Tracks::new(view, track, near.bearing().to_vec(), None, n_views, n_tracks).unwrap();
    let clock = std::time::Instant::now();
    let scene = solve_positions(&tracks, None, &PositionOptions::default()).unwrap();
    println!("{:?} {:?}", clock.elapsed(), scene.summary);
}
#[test]
fn two() {
    for m in [2, 3, 6, 40] {
        let (centers, points) = (places(2, &[0.0; 2], 1.0, 1), places(m, &[0.0; 2], 2.0, 2));
        for split_parts in [true, false] { for method in [Method::Robust, Method::Linear{form: LinearForm::Joint, gauge: LinearGauge::Functional}, Method::Linear{form: LinearForm::Joint, gauge: LinearGauge::Paper}, Method::Linear{form: LinearForm::Joint, gauge: LinearGauge::PaperDistance}] {
            let scene = solve_tracks(&see(&centers, &points, all_pairs(2, m)), None, &PositionOptions{split_parts, method, ..Default::default()});
            println!("{m} {split_parts} {method:?} {:?}", scene.summary.status);
        } }
    }
}
#[test]
fn start() {
    let world = common::simulate::<3>(WorldKind::Street, &options(40, 500, 2));
    let mut start = (world.centers.clone(), world.points.clone());
    for point in start.1.iter_mut().step_by(7) { *point = [f64::NAN; 3]; }
    let s = solve(&world, &PositionOptions { start: Some(start), ..Default::default() });
    println!("{:?} {:?}", s.summary, world_errors(&s, &world));
}
