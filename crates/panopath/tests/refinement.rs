//! Orientations, centres and points together: exact worlds, noise, outliers; held parts, priors, rigs; laws and statuses.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use common::poses::*;
use common::*;
use panopath::geometry::{Matrix, Rotation, Similarity, Vector, add, norm, scale, sub};
use panopath::refinement::*;
use panopath::structure::{Status, Structure};
use panopath::synthetic::{Orientations, World, WorldKind, WorldOptions};
use panopath::tracks::Tracks;
use panopath::{PositionOptions, solve_positions};

fn turned_world<const D: usize>(kind: WorldKind, o: WorldOptions) -> World<D> {
    simulate(kind, &WorldOptions { orientations: Orientations::Random, ..o })
}

fn plain<const D: usize>() -> RefineOptions<D> {
    RefineOptions { huber_sigmas: f64::INFINITY, reject_outliers: false, ..Default::default() }
}

fn diagonal<const D: usize>(variance: f64) -> Matrix<D> {
    std::array::from_fn(|r| std::array::from_fn(|c| if r == c { variance } else { 0.0 }))
}

// ---------------------------------------------------------------------------------------------------------- exact

fn check_exact<const D: usize, const V: usize>(kind: WorldKind, o: WorldOptions) {
    let world = turned_world::<D>(kind, o);
    let start = disturbed(&truth(&world), 0.03, 0.03, 5);
    for options in [RefineOptions::default(), plain()] {
        let scene = refined::<D, V>(&world.tracks, &start, &options);
        let what = format!("{} (d = {D}), reject_outliers = {}", kind.name(), options.reject_outliers);
        assert_eq!(scene.summary.status, Status::Converged, "{what}");
        let residual = scene.residual_rad.iter().fold(0.0f64, |a, &r| if r > a || r.is_nan() { r } else { a });
        assert!(residual < 1e-9, "{what}: residual {residual}");
        assert!(scene.inlier.iter().all(|&k| k), "{what}: exact observations are inliers");
        let e = fitted_errors(&scene, &truth(&world), true);
        assert!(e.worst() < 1e-8, "{what}: {e:?}");
        assert_gauge_of_start(&scene, &start);
    }
}

/// Mean orientation, centroid and size are those of the start.
fn assert_gauge_of_start<const D: usize>(scene: &Structure<D>, start: &Structure<D>) {
    let n = start.centers.len() as f64;
    let mean = |s: &Structure<D>| s.centers.iter().fold([0.0; D], |sum, c| add(&sum, &scale(1.0 / n, c)));
    let size = path_size(&start.centers);
    assert!(norm(&sub(&mean(scene), &mean(start))) < 1e-9 * size, "the centroid stays");
    let (mut correlation, mut along, mut spread) = ([[0.0; D]; D], 0.0, 0.0);
    for i in 0..start.centers.len() {
        let turn = start.cam_from_world[i].inverse().compose(&scene.cam_from_world[i]);
        (0..D).for_each(|r| (0..D).for_each(|c| correlation[r][c] += turn.matrix()[r][c]));
        let after = sub(&scene.centers[i], &mean(scene));
        along += panopath::geometry::dot(&after, &sub(&start.centers[i], &mean(start)));
        spread += panopath::geometry::dot(&after, &after);
    }
    let mean_turn = panopath::least_squares::nearest_rotation(&correlation).unwrap().turn();
    assert!(norm(&mean_turn) < 1e-8, "the mean orientation stays: {mean_turn:?}");
    assert!((along / spread - 1.0).abs() < 1e-8, "the size stays: {}", along / spread);
}

#[test]
fn exact_worlds_are_recovered_from_a_disturbed_start() {
    check_exact::<3, 6>(WorldKind::Box, options(8, 60, 1));
    check_exact::<3, 6>(WorldKind::Street, options(20, 300, 2));
    check_exact::<3, 6>(WorldKind::Room, options(20, 300, 3));
    check_exact::<2, 3>(WorldKind::Box, options(6, 40, 1));
    check_exact::<2, 3>(WorldKind::Room, WorldOptions { min_views: Some(5), ..options(20, 300, 3) });
    check_exact::<2, 3>(WorldKind::Street, WorldOptions { min_views: Some(6), ..options(20, 300, 2) });
}

#[test]
fn two_views_in_space_are_enough() {
    check_exact::<3, 6>(WorldKind::Box, options(2, 40, 4));
}

// ---------------------------------------------------------------------------------------------------------- noise

fn check_noise<const D: usize, const V: usize>(kind: WorldKind, o: WorldOptions) {
    let world = turned_world::<D>(kind, WorldOptions { noise_rad: 1e-3, ..o });
    let best = refined::<D, V>(&world.tracks, &truth(&world), &plain());
    let start = disturbed(&truth(&world), 0.03, 0.03, 5);
    let scene = refined::<D, V>(&world.tracks, &start, &plain());
    let (found, wanted) = (squared_residuals(&scene), squared_residuals(&best));
    assert!(found <= wanted * (1.0 + 1e-6), "{} (d = {D}): {found} against {wanted}", kind.name());
    // a fit is below the truth by its unknowns, and not below zero
    let at_truth: f64 = (0..world.tracks.len()).map(|o| residual_of(&truth(&world), &world.tracks, o).powi(2)).sum();
    assert!(wanted < at_truth && wanted > 0.0);
    assert!((scene.summary.sigma_rad / 1e-3 - 1.0).abs() < 0.15, "{} {}", kind.name(), scene.summary.sigma_rad);
}

#[test]
fn the_cost_from_a_disturbed_start_is_that_from_the_truth() {
    check_noise::<3, 6>(WorldKind::Box, options(8, 60, 1));
    check_noise::<3, 6>(WorldKind::Street, options(20, 300, 2));
    check_noise::<3, 6>(WorldKind::Room, options(20, 300, 3));
    check_noise::<2, 3>(WorldKind::Box, options(6, 60, 1));
    check_noise::<2, 3>(WorldKind::Room, WorldOptions { min_views: Some(5), ..options(20, 300, 3) });
}

#[test]
fn outliers_and_turned_orientations_do_little_harm() {
    for (kind, n, m) in [(WorldKind::Box, 10, 80), (WorldKind::Street, 25, 400), (WorldKind::Room, 20, 300)] {
        for seed in 0..3 {
            let o = WorldOptions {
                noise_rad: 1e-3,
                outlier_fraction: 0.2,
                orientations: Orientations::Random,
                min_views: Some(4),
                ..options(n, m, seed)
            };
            let exact = simulate::<3>(kind, &o);
            let told = simulate::<3>(kind, &WorldOptions { orientation_error_rad: 3.0 * DEG, ..o });
            let start = solve_positions(&told.tracks, Some(&told.cam_from_world), &PositionOptions::default()).unwrap();
            let scene = refined::<3, 6>(&told.tracks, &start, &RefineOptions::default());
            let best = refined::<3, 6>(&exact.tracks, &truth(&exact), &RefineOptions::default());
            let [found, wanted] = [&scene, &best].map(|s| fitted_errors(s, &truth(&exact), false).camera_rms);
            let what = format!("{} seed {seed}: {found} against {wanted}", kind.name());
            assert_eq!(scene.summary.status, Status::Converged, "{what}");
            assert!(found <= 1.1 * wanted + 1e-12, "{what}");
            assert!((scene.summary.sigma_rad / 1e-3 - 1.0).abs() < 0.1, "{what}, {}", scene.summary.sigma_rad);
            let wrong = (0..told.tracks.len()).filter(|&o| scene.inlier[o] && told.outlier[o]).count();
            assert!(wrong * 100 < told.tracks.len(), "{what}: {wrong} outliers are believed");
        }
    }
}

// ---------------------------------------------------------------------------------------------------------- held parts

fn same<const D: usize>(a: &Vector<D>, b: &Vector<D>) -> bool {
    a.iter().zip(b).all(|(x, y)| x.to_bits() == y.to_bits())
}

fn check_held<const D: usize, const V: usize>(kind: WorldKind, o: WorldOptions) {
    let world = turned_world::<D>(kind, WorldOptions { noise_rad: 1e-3, outlier_fraction: 0.1, ..o });
    let start = disturbed(&truth(&world), 0.002, 0.002, 5);
    let (n, m) = (world.centers.len(), world.points.len());
    let every_third = |count: usize| (0..count).map(|k| k % 3 == 1).collect::<Vec<bool>>();
    for (rotations, centers, points) in
        [(true, false, false), (false, true, false), (false, false, true), (true, true, true)]
    {
        let list = |on: bool, count: usize| if on { every_third(count) } else { Vec::new() };
        let held = Held { rotations: list(rotations, n), centers: list(centers, n), points: list(points, m) };
        let options = RefineOptions { held: held.clone(), ..Default::default() };
        let scene = refined::<D, V>(&world.tracks, &start, &options);
        let is = |list: &[bool], k: usize| list.get(k) == Some(&true);
        let mut moved = 0;
        for i in (0..n).filter(|&i| scene.view_component[i] >= 0) {
            let kept = scene.cam_from_world[i] == start.cam_from_world[i];
            assert!(kept || !is(&held.rotations, i), "the orientation of view {i}");
            assert!(same(&scene.centers[i], &start.centers[i]) || !is(&held.centers, i), "the centre of view {i}");
            let moves = !kept && !same(&scene.centers[i], &start.centers[i]);
            moved += usize::from(moves);
        }
        // the others move, but for the one that fixes the place where nothing held does
        let free = (0..n).filter(|&i| !is(&held.rotations, i) && !is(&held.centers, i)).count();
        assert!(moved + 1 >= free && moved <= free, "{moved} of {free} views move");
        for j in (0..m).filter(|&j| is(&held.points, j)) {
            assert!(same(&scene.points[j], &start.points[j]), "point {j} is held");
            assert_eq!(scene.track_component[j], 0, "point {j} is held");
        }
        let moved = (0..m).filter(|&j| !is(&held.points, j) && !same(&scene.points[j], &start.points[j])).count();
        assert!(moved * 2 > m, "other points move: {moved} of {m}");
    }
}

#[test]
fn what_is_held_stays_to_the_last_bit() {
    check_held::<3, 6>(WorldKind::Street, options(20, 300, 2));
    check_held::<3, 6>(WorldKind::Box, options(8, 60, 1));
    check_held::<2, 3>(WorldKind::Box, options(8, 40, 1));
}

#[test]
fn held_points_stay_even_where_few_rays_agree_with_them() {
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-3, ..options(8, 60, 1) });
    let mut start = truth(&world);
    // behind every view, and far off
    start.points[3] = scale(-50.0, &start.points[3]);
    start.points[4] = [900.0, -2000.0, 1000.0];
    let mut held = Held { points: vec![false; 60], ..Default::default() };
    for j in 0..10 {
        held.points[j] = true;
    }
    let scene = refined::<3, 6>(&world.tracks, &start, &RefineOptions { held, ..Default::default() });
    for j in 0..10 {
        assert!(same(&scene.points[j], &start.points[j]), "point {j}: {:?}", scene.points[j]);
    }
    let told = |j: usize| {
        (0..world.tracks.len()).filter(|&o| world.tracks.track()[o] as usize == j && scene.inlier[o]).count()
    };
    assert_eq!((told(3), told(4)), (0, 0));
    assert!(raw_errors(&Structure { track_component: vec![-1; 60], ..scene.clone() }, &truth(&world)).worst() < 0.01);
}

#[test]
fn with_all_poses_held_points_are_triangulated() {
    for noise in [0.0, 1e-3] {
        let o = WorldOptions { noise_rad: noise, min_views: Some(3), max_views: Some(4), ..options(20, 200, 2) };
        let world = turned_world::<3>(WorldKind::Street, o);
        let mut start = truth(&world);
        start.points.fill([f64::NAN; 3]);
        let held = Held { rotations: vec![true; 20], centers: vec![true; 20], points: Vec::new() };
        let options = RefineOptions { held, ..plain() };
        let scene = refined::<3, 6>(&world.tracks, &start, &options);
        assert_eq!(scene.summary.status, Status::Converged, "noise {noise}");
        if noise == 0.0 {
            assert!(raw_errors(&scene, &truth(&world)).worst() < 1e-6, "{:?}", raw_errors(&scene, &truth(&world)));
        } else {
            // the residuals of a triangulation alone: its unknowns are the points and nothing else
            assert!((scene.summary.sigma_rad / noise - 1.0).abs() < 0.06, "sigma {}", scene.summary.sigma_rad);
        }
    }
}

#[test]
fn with_all_points_held_views_are_resected() {
    for noise in [0.0, 1e-3] {
        for (n_views, n_points) in [(1, 30), (6, 30)] {
            let scene = walk::<3>(6, n_points, 3);
            let seen: Vec<_> = everything(n_views, n_points, 1).collect();
            let (tracks, _) = look(&scene, &[[0.0; 3]], seen);
            let tracks = noisy(&tracks, noise, 8);
            let mut start = disturbed(&scene, 0.05, 0.05, 4);
            start.points.clone_from(&scene.points);
            let held = Held { points: vec![true; n_points], ..Default::default() };
            let found = refined::<3, 6>(&tracks, &start, &RefineOptions { held, ..plain() });
            let what = format!("{n_views} views, noise {noise}: {:?}", found.summary);
            assert_eq!(found.summary.status, Status::Converged, "{what}");
            assert_eq!(found.view_component.iter().filter(|&&c| c == 0).count(), n_views, "{what}");
            let e = raw_errors(&found, &scene);
            assert!(e.turn < 1e-8 + 2.0 * noise && e.camera < 1e-8 + 4.0 * noise && e.point == 0.0, "{what}: {e:?}");
            let freedom = (2 * n_points * n_views - 6 * n_views) as f64;
            let rms = (squared_residuals(&found) / freedom).sqrt();
            assert!(noise == 0.0 || (found.summary.sigma_rad / rms - 1.0).abs() < 1e-6, "{what}: {rms}");
        }
    }
}

#[test]
fn with_everything_held_nothing_moves() {
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-3, ..options(6, 40, 1) });
    let held = Held { rotations: vec![true; 6], centers: vec![true; 6], points: vec![true; 40] };
    let scene = refined::<3, 6>(&world.tracks, &truth(&world), &RefineOptions { held, ..Default::default() });
    assert_eq!(scene.summary.status, Status::Converged);
    assert!(scene.centers == world.centers && scene.points == world.points);
    assert!((scene.summary.sigma_rad / 1e-3 - 1.0).abs() < 0.1, "{}", scene.summary.sigma_rad);
}

// ---------------------------------------------------------------------------------------------------------- priors

fn position_priors<const D: usize>(centers: &[Vector<D>], views: &[usize], sigma: f64) -> Vec<PositionPrior<D>> {
    let prior = |&i: &usize| PositionPrior { view: i as u32, center: centers[i], covariance: diagonal(sigma * sigma) };
    views.iter().map(prior).collect()
}

fn with_priors<const D: usize>(priors: Priors<D>) -> RefineOptions<D> {
    RefineOptions { priors, ..Default::default() }
}

fn check_positions_give_the_frame<const D: usize, const V: usize>() {
    let o = WorldOptions { noise_rad: 1e-3, ..options(8, 60, 1) };
    let world = turned_world::<D>(WorldKind::Box, o);
    let true_scene = truth(&world);
    let free = refined::<D, V>(&world.tracks, &true_scene, &RefineOptions::default());
    let wanted = fitted_errors(&free, &true_scene, false);
    for seed in 0..4 {
        let start = moved(&disturbed(&true_scene, 0.03, 0.03, 5), &some_similarity(seed));
        let views: Vec<usize> = (0..8).collect();
        let positions = position_priors(&world.centers, &views, 1e-3);
        let scene = refined::<D, V>(&world.tracks, &start, &with_priors(Priors { positions, ..Default::default() }));
        assert_eq!(scene.summary.status, Status::Converged, "seed {seed}");
        let e = raw_errors(&scene, &true_scene);
        assert!(e.camera < 3.0 * wanted.camera + 1e-3 && e.turn < 3.0 * wanted.turn + 1e-3, "{e:?}, {wanted:?}");
    }
}

#[test]
fn known_positions_give_the_frame() {
    check_positions_give_the_frame::<3, 6>();
    check_positions_give_the_frame::<2, 3>();
}

#[test]
fn known_positions_give_the_frame_beside_gravity_and_a_compass() {
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-3, ..options(8, 60, 1) });
    let true_scene = truth(&world);
    for seed in 0..6 {
        let start = moved(&disturbed(&true_scene, 0.02, 0.02, 5), &some_similarity(seed));
        let up = |view: usize| DirectionPrior {
            view: view as u32,
            bearing: world.cam_from_world[view].apply(&[0.0, 0.0, 1.0]),
            direction: [0.0, 0.0, 1.0],
            sigma_rad: 0.01,
        };
        let compass = RotationPrior { view: 2, cam_from_world: world.cam_from_world[2], covariance: diagonal(1e-4) };
        let positions = position_priors(&world.centers, &[0, 2, 3, 5, 7], 1e-3);
        for priors in [
            Priors { positions: positions.clone(), directions: (0..8).map(up).collect(), rotations: vec![] },
            Priors { positions, directions: vec![], rotations: vec![compass] },
        ] {
            let scene = refined::<3, 6>(&world.tracks, &start, &with_priors(priors));
            let e = raw_errors(&scene, &true_scene);
            assert_eq!(scene.summary.status, Status::Converged, "seed {seed}: {e:?}");
            assert!(e.worst() < 0.01, "seed {seed}: {e:?}");
        }
    }
}

#[test]
fn a_wrong_position_does_little_harm() {
    let world = turned_world::<3>(WorldKind::Street, WorldOptions { noise_rad: 1e-3, ..options(20, 300, 2) });
    let true_scene = truth(&world);
    let views: Vec<usize> = (0..20).collect();
    let run = |positions: Vec<PositionPrior>| {
        let scene =
            refined::<3, 6>(&world.tracks, &true_scene, &with_priors(Priors { positions, ..Default::default() }));
        raw_errors(&scene, &true_scene).camera_rms
    };
    let mut positions = position_priors(&world.centers, &views, 0.02);
    let right = run(positions.clone());
    positions[11].center[2] += 10.0;
    let wrong = run(positions);
    // Huber lets it pull with three standard deviations: 0.06 on one of twenty
    assert!(wrong < right + 0.03, "{wrong} against {right}");
}

#[test]
fn gravity_leaves_a_turn_about_the_vertical() {
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-4, ..options(8, 60, 1) });
    let true_scene = truth(&world);
    for seed in 0..4 {
        // tilted by any angle
        let tilt = Similarity { scale: 1.0, translation: [0.0; 3], ..some_similarity(seed) };
        let start = moved(&disturbed(&true_scene, 0.02, 0.02, 5), &tilt);
        let directions = (0..8).map(|view| DirectionPrior {
            view,
            bearing: world.cam_from_world[view as usize].apply(&[0.0, 0.0, 1.0]),
            direction: [0.0, 0.0, 1.0],
            sigma_rad: 1e-3,
        });
        let priors = Priors { directions: directions.collect(), ..Default::default() };
        let scene = refined::<3, 6>(&world.tracks, &start, &with_priors(priors));
        assert_eq!(scene.summary.status, Status::Converged, "seed {seed}");
        for (rotation, right) in scene.cam_from_world.iter().zip(&world.cam_from_world) {
            let up = right.inverse().compose(rotation).apply(&[0.0, 0.0, 1.0]);
            assert!(norm(&sub(&up, &[0.0, 0.0, 1.0])) < 2e-3, "seed {seed}: up is {up:?}");
        }
        assert!(
            fitted_errors(&scene, &true_scene, true).worst() < 2e-3,
            "{:?}",
            fitted_errors(&scene, &true_scene, true)
        );
    }
}

fn check_one_orientation<const D: usize, const V: usize>() {
    let world = turned_world::<D>(WorldKind::Box, WorldOptions { noise_rad: 1e-4, ..options(8, 60, 1) });
    let true_scene = truth(&world);
    for seed in 0..6 {
        let turn = Similarity { scale: 1.0, translation: [0.0; D], ..some_similarity(seed) };
        let start = moved(&disturbed(&true_scene, 0.02, 0.02, 5), &turn);
        let rotations =
            vec![RotationPrior { view: 3, cam_from_world: world.cam_from_world[3], covariance: diagonal(1e-4) }];
        let priors = Priors { rotations, ..Default::default() };
        let scene = refined::<D, V>(&world.tracks, &start, &with_priors(priors));
        assert_eq!(scene.summary.status, Status::Converged, "seed {seed}");
        let e = raw_errors(&scene, &true_scene);
        assert!(e.turn < 1e-3, "seed {seed} (d = {D}): {e:?}");
    }
}

#[test]
fn one_known_orientation_fixes_the_turn() {
    check_one_orientation::<3, 6>();
    check_one_orientation::<2, 3>();
}

#[test]
fn priors_of_one_thing_are_weighed_by_their_covariances() {
    // nothing else holds the place of the scene: its shift is the weighted mean of what the priors say
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-4, ..options(8, 60, 1) });
    let mut rotations = vec![true; 8];
    rotations.truncate(8);
    let held = Held { rotations, ..Default::default() };
    let covariances: [Matrix<3>; 3] = [
        [[4e-4, 1e-4, 0.0], [1e-4, 1e-4, 0.0], [0.0, 0.0, 9e-4]],
        [[1e-4, 0.0, 5e-5], [0.0, 4e-4, 0.0], [5e-5, 0.0, 1e-4]],
        diagonal(2e-4),
    ];
    let offsets = [[0.01, 0.0, -0.02], [-0.01, 0.02, 0.0], [0.0, -0.005, 0.01]];
    let prior =
        |k: usize| PositionPrior { view: 2, center: add(&world.centers[2], &offsets[k]), covariance: covariances[k] };
    let priors = Priors { positions: (0..3).map(prior).collect(), ..Default::default() };
    let options = RefineOptions { held, priors, ..plain() };
    let scene = refined::<3, 6>(&world.tracks, &truth(&world), &options);
    let mut information = [[0.0; 3]; 3];
    let mut right = [0.0; 3];
    for k in 0..3 {
        let inverse = inverse3(&covariances[k]);
        for r in 0..3 {
            for c in 0..3 {
                information[r][c] += inverse[r][c];
                right[r] += inverse[r][c] * offsets[k][c];
            }
        }
    }
    let mean = panopath::geometry::apply(&inverse3(&information), &right);
    let found = sub(&scene.centers[2], &world.centers[2]);
    assert!(norm(&sub(&found, &mean)) < 1e-6, "{found:?}, {mean:?}");
}

fn inverse3(m: &Matrix<3>) -> Matrix<3> {
    let minor = |r: usize, c: usize| {
        let (r1, r2, c1, c2) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
        m[r1][c1] * m[r2][c2] - m[r1][c2] * m[r2][c1]
    };
    let determinant: f64 = (0..3).map(|c| m[0][c] * minor(0, c)).sum();
    std::array::from_fn(|r| std::array::from_fn(|c| minor(c, r) / determinant))
}

#[test]
fn two_orientations_of_one_view_are_weighed_by_their_covariances() {
    let world = turned_world::<2>(WorldKind::Box, WorldOptions { noise_rad: 1e-5, ..options(6, 60, 1) });
    let off = [0.01, -0.02];
    let variance = [1e-4, 4e-4];
    let prior = |k: usize| RotationPrior {
        view: 4,
        cam_from_world: Rotation::from_angle(off[k]).compose(&world.cam_from_world[4]),
        covariance: diagonal(variance[k]),
    };
    let priors = Priors { rotations: (0..2).map(prior).collect(), ..Default::default() };
    let scene = refined::<2, 3>(&world.tracks, &truth(&world), &RefineOptions { priors, ..plain() });
    let found = scene.cam_from_world[4].compose(&world.cam_from_world[4].inverse()).turn()[0];
    let wanted = (off[0] / variance[0] + off[1] / variance[1]) / (1.0 / variance[0] + 1.0 / variance[1]);
    assert!((found - wanted).abs() < 1e-7, "{found}, {wanted}");
}

#[test]
fn priors_that_cannot_be_used_are_named() {
    let world = turned_world::<3>(WorldKind::Box, options(4, 20, 1));
    let message =
        |priors: Priors| refine::<3, 6>(&world.tracks, &truth(&world), &with_priors(priors)).unwrap_err().to_string();
    let rotation = RotationPrior { view: 1, cam_from_world: Rotation::identity(), covariance: diagonal(1.0) };
    let direction = DirectionPrior { view: 1, bearing: [0.0, 0.0, 1.0], direction: [0.0, 0.0, 1.0], sigma_rad: 0.1 };
    let position = PositionPrior { view: 1, center: [0.0; 3], covariance: diagonal(1.0) };
    let cases: Vec<(Priors, &str)> = vec![
        (
            Priors {
                rotations: vec![rotation.clone(), RotationPrior { view: 4, ..rotation.clone() }],
                ..Default::default()
            },
            "rotation prior 1: names the view 4, but there are 4",
        ),
        (
            Priors {
                rotations: vec![RotationPrior { covariance: diagonal(0.0), ..rotation.clone() }],
                ..Default::default()
            },
            "rotation prior 0: its covariance is not positive definite",
        ),
        (
            Priors {
                rotations: vec![RotationPrior { covariance: diagonal(f64::NAN), ..rotation }],
                ..Default::default()
            },
            "rotation prior 0: its covariance is not positive definite",
        ),
        (
            Priors { directions: vec![DirectionPrior { view: 9, ..direction.clone() }], ..Default::default() },
            "direction prior 0: names the view 9",
        ),
        (
            Priors {
                directions: vec![DirectionPrior { bearing: [0.0; 3], ..direction.clone() }],
                ..Default::default()
            },
            "direction prior 0: its bearing has length 0",
        ),
        (
            Priors {
                directions: vec![DirectionPrior { direction: [f64::NAN; 3], ..direction.clone() }],
                ..Default::default()
            },
            "direction prior 0: its direction has length NaN",
        ),
        (
            Priors { directions: vec![DirectionPrior { sigma_rad: -1.0, ..direction }], ..Default::default() },
            "direction prior 0: sigma_rad is -1",
        ),
        (
            Priors { positions: vec![PositionPrior { view: 7, ..position.clone() }], ..Default::default() },
            "position prior 0: names the view 7",
        ),
        (
            Priors {
                positions: vec![PositionPrior { center: [f64::INFINITY; 3], ..position.clone() }],
                ..Default::default()
            },
            "position prior 0: its centre is not finite",
        ),
        (
            Priors { positions: vec![PositionPrior { covariance: diagonal(-1.0), ..position }], ..Default::default() },
            "position prior 0: its covariance is not positive definite",
        ),
    ];
    for (priors, wanted) in cases {
        let found = message(priors);
        assert!(found.starts_with(wanted), "{found:?}, expected {wanted:?}");
    }
}

#[test]
fn arguments_that_do_not_fit_are_named() {
    let world = turned_world::<3>(WorldKind::Box, options(4, 20, 1));
    let run = |start: &Structure, options: RefineOptions| {
        refine::<3, 6>(&world.tracks, start, &options).unwrap_err().to_string()
    };
    let good = truth(&world);
    let short = Structure { centers: vec![[0.0; 3]; 3], ..good.clone() };
    assert_eq!(run(&short, plain()), "centers has 3 entries, expected 4");
    let held = Held { points: vec![true; 5], ..Default::default() };
    assert_eq!(run(&good, RefineOptions { held, ..plain() }), "held points has 5 entries, expected 20");
    let rig = |sensor: u32, center: [f64; 3], n: usize| Some(Rig { sensor: vec![sensor; n], center: vec![center] });
    let n = world.tracks.len();
    assert_eq!(
        run(&good, RefineOptions { rig: rig(0, [0.0; 3], 2), ..plain() }),
        format!("sensor has 2 entries, expected {n}")
    );
    assert!(run(&good, RefineOptions { rig: rig(1, [0.0; 3], n), ..plain() }).starts_with("sensor[0] is 1"));
    assert!(run(&good, RefineOptions { rig: rig(0, [f64::NAN; 3], n), ..plain() }).contains("sensor 0 is not finite"));
    for huber_sigmas in [0.0, -1.0, f64::NAN] {
        assert!(run(&good, RefineOptions { huber_sigmas, ..plain() }).starts_with("huber_sigmas is"));
    }
}

// ---------------------------------------------------------------------------------------------------------- rigs

/// A walk seen by two sensors 0.3 steps apart.
fn two_sensors<const D: usize>(noise: f64) -> (Structure<D>, Tracks<D>, Rig<D>) {
    let scene = walk::<D>(8, 60, 3);
    let arm: Vector<D> = std::array::from_fn(|c| if c == 1 { 0.15 } else { 0.0 });
    let center = vec![arm, scale(-1.0, &arm)];
    let (tracks, sensor) = look(&scene, &center, everything(8, 60, 2));
    (scene, noisy(&tracks, noise, 6), Rig { sensor, center })
}

fn check_rig<const D: usize, const V: usize>() {
    for noise in [0.0, 1e-4] {
        let (scene, tracks, rig) = two_sensors::<D>(noise);
        let options = RefineOptions { rig: Some(rig), ..plain() };
        for size in [0.1, 0.7, 1.0, 10.0] {
            let smaller = Similarity { scale: size, ..Similarity::identity() };
            let start = moved(&disturbed(&scene, 0.02, 0.02, 5), &smaller);
            let found = refined::<D, V>(&tracks, &start, &options);
            assert_eq!(found.summary.status, Status::Converged, "noise {noise}, start at {size}");
            let ratio = path_size(&found.centers) / path_size(&scene.centers);
            let allowed = 1e-8 + 60.0 * noise;
            assert!((ratio - 1.0).abs() < allowed, "noise {noise}, start at {size} (d = {D}): scale {ratio}");
            let e = fitted_errors(&found, &scene, true);
            assert!(e.worst() < allowed, "noise {noise}, start at {size} (d = {D}): {e:?}");
        }
    }
}

#[test]
fn two_sensors_of_a_rig_give_the_scale() {
    check_rig::<3, 6>();
    check_rig::<2, 3>();
}

#[test]
fn a_rig_without_levers_is_no_rig() {
    let world = turned_world::<3>(
        WorldKind::Street,
        WorldOptions { noise_rad: 1e-3, outlier_fraction: 0.1, ..options(15, 200, 2) },
    );
    let start = disturbed(&truth(&world), 0.02, 0.02, 5);
    let without = refined::<3, 6>(&world.tracks, &start, &RefineOptions::default());
    let rig = Rig { sensor: vec![0; world.tracks.len()], center: vec![[0.0; 3]] };
    let with = refined::<3, 6>(&world.tracks, &start, &RefineOptions { rig: Some(rig), ..Default::default() });
    assert!(with.centers == without.centers && with.cam_from_world == without.cam_from_world);
    let alike = with.points.iter().zip(&without.points).all(|(a, b)| a == b || a[0].is_nan() && b[0].is_nan());
    assert!(alike && with.inlier == without.inlier);
    // two sensors at one place are one
    let sensor = (0..world.tracks.len()).map(|o| (o % 2) as u32).collect();
    let rig = Rig { sensor, center: vec![[0.0; 3]; 2] };
    let with = refined::<3, 6>(&world.tracks, &start, &RefineOptions { rig: Some(rig), ..Default::default() });
    assert_eq!(with.summary.status, without.summary.status);
    assert!(raw_errors(&with, &without).camera < 1e-4, "{:?}", raw_errors(&with, &without));
}

#[test]
fn a_rig_refines_beside_positions_and_held_parts() {
    let (scene, tracks, rig) = two_sensors::<3>(1e-4);
    let start = disturbed(&scene, 0.02, 0.02, 5);
    let positions = position_priors(&scene.centers, &[0, 3, 7], 1e-3);
    let priors = Priors { positions, ..Default::default() };
    let found = refined::<3, 6>(&tracks, &start, &RefineOptions { rig: Some(rig.clone()), priors, ..plain() });
    assert_eq!(found.summary.status, Status::Converged);
    assert!(raw_errors(&found, &scene).worst() < 2e-3, "{:?}", raw_errors(&found, &scene));
    let held = Held { points: vec![true; 60], ..Default::default() };
    let start = Structure { points: scene.points.clone(), ..start };
    let found = refined::<3, 6>(&tracks, &start, &RefineOptions { rig: Some(rig), held, ..plain() });
    assert_eq!(found.summary.status, Status::Converged);
    assert!(raw_errors(&found, &scene).worst() < 1e-3, "{:?}", raw_errors(&found, &scene));
}

// ---------------------------------------------------------------------------------------------------------- laws

fn check_similarity<const D: usize, const V: usize>(kind: WorldKind, o: WorldOptions) {
    let world = turned_world::<D>(kind, WorldOptions { noise_rad: 1e-3, outlier_fraction: 0.05, ..o });
    let start = disturbed(&truth(&world), 0.02, 0.02, 5);
    let one = refined::<D, V>(&world.tracks, &start, &RefineOptions::default());
    for seed in 0..3 {
        let there = some_similarity::<D>(seed);
        let other = refined::<D, V>(&world.tracks, &moved(&start, &there), &RefineOptions::default());
        assert_eq!(one.summary.status, other.summary.status);
        assert_eq!((&one.inlier, &one.view_component), (&other.inlier, &other.view_component));
        let e = raw_errors(&other, &moved(&one, &there));
        assert!(e.worst() < 1e-7, "{} seed {seed} (d = {D}): {e:?}", kind.name());
    }
}

#[test]
fn a_start_in_another_frame_gives_the_answer_there() {
    check_similarity::<3, 6>(WorldKind::Box, options(8, 60, 1));
    check_similarity::<3, 6>(WorldKind::Room, WorldOptions { min_views: Some(5), ..options(15, 200, 3) });
    check_similarity::<2, 3>(WorldKind::Box, options(8, 60, 1));
}

#[test]
fn names_of_views_and_tracks_do_not_matter() {
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-3, ..options(8, 60, 1) });
    let start = disturbed(&truth(&world), 0.02, 0.02, 5);
    let one = refined::<3, 6>(&world.tracks, &start, &RefineOptions::default());
    let mut noise = Noise::new(4);
    let (of_view, of_track) = (noise.permutation(8), noise.permutation(60));
    let order = noise.permutation(world.tracks.len());
    let pick = |old: &[u32], new: &[usize]| order.iter().map(|&o| new[old[o] as usize] as u32).collect::<Vec<u32>>();
    let bearing = order.iter().map(|&o| world.tracks.bearing()[o]).collect();
    let (view, track) = (pick(world.tracks.view(), &of_view), pick(world.tracks.track(), &of_track));
    let tracks = Tracks::new(view, track, bearing, None, 8, 60).unwrap();
    let mut renamed = start.clone();
    for i in 0..8 {
        renamed.centers[of_view[i]] = start.centers[i];
        renamed.cam_from_world[of_view[i]] = start.cam_from_world[i];
    }
    for j in 0..60 {
        renamed.points[of_track[j]] = start.points[j];
    }
    let other = refined::<3, 6>(&tracks, &renamed, &RefineOptions::default());
    let mut back = other.clone();
    for i in 0..8 {
        back.centers[i] = other.centers[of_view[i]];
        back.cam_from_world[i] = other.cam_from_world[of_view[i]];
    }
    for j in 0..60 {
        back.points[j] = other.points[of_track[j]];
    }
    let e = raw_errors(&back, &one);
    assert!(e.worst() < 1e-7, "{e:?}");
}

#[test]
fn the_answer_has_the_same_bytes_on_any_number_of_threads() {
    let o = WorldOptions { noise_rad: 1e-3, outlier_fraction: 0.1, ..options(60, 4000, 2) };
    let world = turned_world::<3>(WorldKind::Street, o);
    let start = disturbed(&truth(&world), 0.01, 0.001, 5);
    let bits = |threads: usize| -> Vec<u64> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let scene = pool.install(|| refine::<3, 6>(&world.tracks, &start, &RefineOptions::default()).unwrap());
        let covariances = pool.install(|| {
            let sigma = scene.summary.sigma_rad;
            covariance::<3, 6>(&world.tracks, &scene, &RefineOptions::default(), CovarianceGauge::Cameras, sigma)
                .unwrap()
        });
        let rotations = scene.cam_from_world.iter().flat_map(|r| r.matrix().as_flattened().to_vec());
        let places = scene.centers.iter().chain(&scene.points).flatten().copied();
        let cameras = covariances.cameras.iter().flatten().flatten().copied();
        let points = covariances.points.iter().flatten().flatten().copied();
        rotations.chain(places).chain(scene.residual_rad).chain(cameras).chain(points).map(f64::to_bits).collect()
    };
    let one = bits(1);
    assert!(one == bits(4), "4 threads");
    assert!(one == bits(1), "the same again");
}

// ---------------------------------------------------------------------------------------------------------- degenerate

#[test]
fn nothing_gives_nothing() {
    let tracks = Tracks::<3>::new(vec![], vec![], vec![], None, 0, 0).unwrap();
    let scene = refined::<3, 6>(&tracks, &structure(&[], &[], &[]), &RefineOptions::default());
    assert_eq!(scene.summary.status, Status::Undetermined);
    // views and points that nobody saw
    let tracks = Tracks::<3>::new(vec![], vec![], vec![], None, 3, 2).unwrap();
    let start = structure(&[Rotation::identity(); 3], &[[0.0; 3]; 3], &[[1.0; 3]; 2]);
    let scene = refined::<3, 6>(&tracks, &start, &RefineOptions::default());
    assert_eq!(scene.summary.status, Status::Undetermined);
    assert!(scene.view_component == [-1; 3] && scene.track_component == [-1; 2]);
}

/// The observations for which `keep` holds.
fn some_of<const D: usize>(tracks: &Tracks<D>, keep: impl Fn(usize, usize) -> bool) -> Tracks<D> {
    let chosen: Vec<usize> =
        (0..tracks.len()).filter(|&o| keep(tracks.view()[o] as usize, tracks.track()[o] as usize)).collect();
    let view = chosen.iter().map(|&o| tracks.view()[o]).collect();
    let track = chosen.iter().map(|&o| tracks.track()[o]).collect();
    let bearing = chosen.iter().map(|&o| tracks.bearing()[o]).collect();
    Tracks::new(view, track, bearing, None, tracks.n_views(), tracks.n_tracks()).unwrap()
}

#[test]
fn views_that_saw_too_little_are_left_out_and_do_no_harm() {
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-4, ..options(8, 60, 1) });
    for n_seen in 0..4 {
        let tracks = some_of(&world.tracks, |i, j| i != 5 || j < n_seen);
        let start = disturbed(&truth(&world), 0.01, 0.01, 5);
        for options in [RefineOptions::default(), plain()] {
            let scene = refined::<3, 6>(&tracks, &start, &options);
            assert_eq!(scene.view_component[5] >= 0, n_seen >= 3, "{n_seen} observations");
            assert!((0..8).filter(|&i| i != 5).all(|i| scene.view_component[i] == 0));
            if n_seen < 3 {
                assert_eq!(scene.summary.status, Status::Converged, "{n_seen} observations");
            }
            let e = fitted_errors(
                &Structure { view_component: (0..8).map(|i| if i == 5 { -1 } else { 0 }).collect(), ..scene },
                &truth(&world),
                true,
            );
            assert!(e.worst() < 5e-3, "{n_seen} observations: {e:?}");
        }
    }
}

#[test]
fn gravity_or_a_compass_of_others_does_not_make_a_view_known() {
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-4, ..options(8, 60, 1) });
    let tracks = some_of(&world.tracks, |i, j| i != 5 || j < 2);
    let rotations =
        vec![RotationPrior { view: 0, cam_from_world: world.cam_from_world[0], covariance: diagonal(1e-4) }];
    let priors = Priors { rotations, ..Default::default() };
    let scene = refined::<3, 6>(&tracks, &truth(&world), &with_priors(priors));
    assert_eq!(scene.view_component[5], -1, "two rays do not fix six unknowns");
    // but its own orientation and two rays do
    let rotations =
        vec![RotationPrior { view: 5, cam_from_world: world.cam_from_world[5], covariance: diagonal(1e-8) }];
    let priors = Priors { rotations, ..Default::default() };
    let scene = refined::<3, 6>(&tracks, &truth(&world), &with_priors(priors));
    assert_eq!(scene.view_component[5], 0);
    assert!(raw_errors(&scene, &truth(&world)).turn < 5e-3);
}

#[test]
fn points_seen_once_are_left_out() {
    let world = turned_world::<3>(WorldKind::Box, options(6, 40, 1));
    let tracks = some_of(&world.tracks, |i, j| j > 4 || i == j);
    let scene = refined::<3, 6>(&tracks, &disturbed(&truth(&world), 0.02, 0.02, 5), &RefineOptions::default());
    assert_eq!(scene.summary.status, Status::Converged);
    for j in 0..40 {
        assert_eq!(scene.track_component[j] >= 0, j > 4, "track {j}");
    }
    let e = fitted_errors(&scene, &truth(&world), true);
    assert!(e.worst() < 1e-7, "{e:?}");
}

#[test]
fn repeated_observations_count_twice_and_no_more() {
    let world = turned_world::<3>(WorldKind::Box, options(6, 40, 1));
    let t = &world.tracks;
    let twice = |ids: &[u32]| ids.iter().flat_map(|&v| [v, v]).collect::<Vec<u32>>();
    let bearing = t.bearing().iter().flat_map(|&b| [b, b]).collect();
    let tracks = Tracks::new(twice(t.view()), twice(t.track()), bearing, None, 6, 40).unwrap();
    let start = disturbed(&truth(&world), 0.02, 0.02, 5);
    let scene = refined::<3, 6>(&tracks, &start, &RefineOptions::default());
    assert_eq!(scene.summary.status, Status::Converged);
    assert!(fitted_errors(&scene, &truth(&world), true).worst() < 1e-7);
    // a track seen twice by one view alone has no point
    let (mut view, mut track) = (t.view().to_vec(), t.track().to_vec());
    let mut bearing = t.bearing().to_vec();
    view.extend([2, 2]);
    track.extend([40, 40]);
    bearing.extend([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]);
    let tracks = Tracks::new(view, track, bearing, None, 6, 41).unwrap();
    let mut start = start;
    start.points.push([1.0, 2.0, 3.0]);
    start.track_component.push(0);
    let scene = refined::<3, 6>(&tracks, &start, &RefineOptions::default());
    assert_eq!(scene.track_component[40], -1);
    assert_eq!(scene.summary.status, Status::Converged);
}

#[test]
fn components_are_refined_apart() {
    let (one, other) = (walk::<3>(6, 40, 1), walk::<3>(5, 30, 2));
    let (a, _) = look(&one, &[[0.0; 3]], everything(6, 40, 1));
    let (b, _) = look(&other, &[[0.0; 3]], everything(5, 30, 1));
    let join = |x: &[u32], y: &[u32], by: u32| x.iter().copied().chain(y.iter().map(|v| v + by)).collect::<Vec<u32>>();
    let bearing = a.bearing().iter().chain(b.bearing()).copied().collect();
    let tracks =
        Tracks::new(join(a.view(), b.view(), 6), join(a.track(), b.track(), 40), bearing, None, 11, 70).unwrap();
    let chain = |x: &[Vector<3>], y: &[Vector<3>]| x.iter().chain(y).copied().collect::<Vec<_>>();
    let cams: Vec<_> = one.cam_from_world.iter().chain(&other.cam_from_world).copied().collect();
    let mut start = disturbed(
        &structure(&cams, &chain(&one.centers, &other.centers), &chain(&one.points, &other.points)),
        0.02,
        0.0,
        5,
    );
    // numbers of components may have gaps; the second may be far from the first
    for far in [1, 5, i32::MAX] {
        start.view_component[6..].fill(far);
        start.track_component[40..].fill(far);
        let scene = refined::<3, 6>(&tracks, &start, &RefineOptions::default());
        assert_eq!(scene.summary.status, Status::Disconnected);
        assert_eq!(scene.summary.n_components, 2);
        assert!(scene.view_component[..6].iter().all(|&c| c == 0) && scene.view_component[6..].iter().all(|&c| c == 1));
        assert!(scene.residual_rad.iter().all(|r| *r < 1e-9));
    }
    // a component that saw nothing
    start.view_component[6..].fill(-1);
    start.track_component[40..].fill(-1);
    start.view_component[6] = 1;
    let scene = refined::<3, 6>(&tracks, &start, &RefineOptions::default());
    assert_eq!((scene.summary.status, scene.summary.n_components), (Status::Converged, 1));
}

#[test]
fn a_component_of_which_nothing_is_left_is_none() {
    // two views, two points: no view sees as much as it has unknowns
    let scene = walk::<3>(2, 2, 1);
    let (tracks, _) = look(&scene, &[[0.0; 3]], everything(2, 2, 1));
    let found = refined::<3, 6>(&tracks, &scene, &RefineOptions::default());
    assert_eq!(found.summary.status, Status::Undetermined);
}

#[test]
fn rows_that_are_not_known_are_found_or_left_out() {
    let world = turned_world::<3>(WorldKind::Box, options(6, 40, 1));
    let mut start = disturbed(&truth(&world), 0.01, 0.01, 5);
    start.centers[4] = [f64::NAN; 3];
    start.points[7] = [f64::NAN; 3];
    start.points[8] = [1.0, f64::INFINITY, 0.0];
    start.track_component[8] = -1;
    let scene = refined::<3, 6>(&world.tracks, &start, &RefineOptions::default());
    assert_eq!(scene.view_component, [0, 0, 0, 0, -1, 0]);
    assert!(scene.track_component.iter().all(|&c| c == 0), "points are intersected anew");
    assert_eq!(scene.summary.status, Status::Converged);
    assert!(fitted_errors(&scene, &truth(&world), true).worst() < 1e-7);
}

#[test]
fn points_behind_all_views_are_found_again() {
    let world = turned_world::<3>(WorldKind::Box, options(6, 40, 1));
    let mut start = disturbed(&truth(&world), 0.01, 0.01, 5);
    for point in &mut start.points {
        *point = scale(-1.0, point);
    }
    let scene = refined::<3, 6>(&world.tracks, &start, &RefineOptions::default());
    let e = fitted_errors(&scene, &truth(&world), true);
    assert!(e.worst() < 1e-7 && scene.summary.status == Status::Converged, "{e:?} {:?}", scene.summary);
}

fn check_few_points<const D: usize, const V: usize>() {
    // more views than points: points stay in the system
    let scene = walk::<D>(30, 12, 4);
    let (tracks, _) = look(&scene, &[[0.0; D]], everything(30, 12, 1));
    let start = disturbed(&scene, 0.01, 0.01, 5);
    let found = refined::<D, V>(&tracks, &start, &RefineOptions::default());
    assert_eq!(found.summary.status, Status::Converged, "d = {D}");
    let e = fitted_errors(&found, &scene, true);
    assert!(e.worst() < 1e-7, "d = {D}: {e:?}");
    // with noise the answer is that of the other system: the same scene with points that add nothing
    let tracks = noisy(&tracks, 1e-3, 3);
    let few = refined::<D, V>(&tracks, &start, &plain());
    let held = Held { points: (0..12).map(|j| j < 2).collect(), ..Default::default() };
    let pinned = refined::<D, V>(&tracks, &few, &RefineOptions { held, ..plain() });
    assert!(squared_residuals(&pinned) <= squared_residuals(&few) * (1.0 + 1e-9), "what is at its minimum stays there");
    let (view, track) = (tracks.view().to_vec(), tracks.track().to_vec());
    let (mut view2, mut track2, mut bearing2) = (view, track, tracks.bearing().to_vec());
    let mut more = start.clone();
    for k in 0..30u32 {
        // seen once each: no equations beyond their unknowns
        view2.push(k);
        track2.push(12 + k);
        bearing2.push(tracks.bearing()[0]);
        let ahead = start.cam_from_world[k as usize].inverse().apply(&tracks.bearing()[0]);
        more.points.push(add(&start.centers[k as usize], &scale(3.0, &ahead)));
        more.track_component.push(0);
    }
    let more_tracks = Tracks::new(view2, track2, bearing2, None, 30, 42).unwrap();
    let many = refined::<D, V>(&more_tracks, &more, &plain());
    let squared = |s: &Structure<D>| s.residual_rad[..tracks.len()].iter().map(|r| r * r).sum::<f64>();
    assert!((squared(&many) / squared(&few) - 1.0).abs() < 1e-6, "{} {}", squared(&many), squared(&few));
}

#[test]
fn more_views_than_points_are_solved_with_points_in_the_system() {
    check_few_points::<3, 6>();
    check_few_points::<2, 3>();
}

#[test]
fn a_single_view_determines_nothing() {
    let scene = walk::<3>(1, 20, 1);
    let (tracks, _) = look(&scene, &[[0.0; 3]], everything(1, 20, 1));
    let found = refined::<3, 6>(&tracks, &scene, &RefineOptions::default());
    assert!(matches!(found.summary.status, Status::Undetermined | Status::Ambiguous), "{:?}", found.summary.status);
    assert!(found.track_component.iter().all(|&c| c == -1));
}

#[test]
fn iterations_that_run_out_are_said_to() {
    let world = turned_world::<3>(WorldKind::Street, WorldOptions { noise_rad: 1e-3, ..options(20, 300, 2) });
    let start = disturbed(&truth(&world), 0.05, 0.05, 5);
    let scene = refined::<3, 6>(&world.tracks, &start, &RefineOptions { max_iterations: 1, ..plain() });
    assert_eq!(scene.summary.status, Status::MaxIterations);
    assert!((1..=20).contains(&scene.summary.iterations), "{}", scene.summary.iterations);
    let again = refined::<3, 6>(&world.tracks, &truth(&world), &RefineOptions::default());
    assert_eq!(again.summary.status, Status::Converged);
}

#[test]
fn a_planar_pair_is_ambiguous() {
    let scene = walk::<2>(2, 30, 1);
    let (tracks, _) = look(&scene, &[[0.0; 2]], everything(2, 30, 1));
    let found = refined::<2, 3>(&tracks, &scene, &RefineOptions::default());
    assert_eq!(found.summary.status, Status::Ambiguous);
    let three = walk::<2>(3, 30, 1);
    let (tracks, _) = look(&three, &[[0.0; 2]], everything(3, 30, 1));
    let found = refined::<2, 3>(&tracks, &disturbed(&three, 0.01, 0.01, 2), &RefineOptions::default());
    assert_eq!(found.summary.status, Status::Converged);
}

#[test]
fn views_at_one_place_are_ambiguous() {
    for noise in [0.0, 1e-3] {
        let mut scene = walk::<3>(6, 50, 1);
        scene.centers.fill([1.0, 2.0, 3.0]);
        let (tracks, _) = look(&scene, &[[0.0; 3]], everything(6, 50, 1));
        let tracks = noisy(&tracks, noise, 3);
        for shift in [0.0, 1e-3] {
            let mut start = scene.clone();
            let mut random = Noise::new(1);
            start.centers.iter_mut().for_each(|c| *c = c.map(|x| x + shift * random.normal()));
            let found = refined::<3, 6>(&tracks, &start, &RefineOptions::default());
            let status = found.summary.status;
            assert!(
                matches!(status, Status::Ambiguous | Status::Undetermined),
                "noise {noise}, shift {shift}: {status:?}"
            );
        }
    }
}

#[test]
fn two_known_positions_leave_a_turn_about_their_line() {
    let world = turned_world::<3>(WorldKind::Box, WorldOptions { noise_rad: 1e-4, ..options(6, 40, 1) });
    let positions = position_priors(&world.centers, &[0, 3], 1e-3);
    let priors = Priors { positions, ..Default::default() };
    let scene = refined::<3, 6>(&world.tracks, &truth(&world), &with_priors(priors));
    // whatever it is called, the shape is right
    assert!(fitted_errors(&scene, &truth(&world), true).worst() < 2e-3);
}
