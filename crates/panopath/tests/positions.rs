//! Positions from bearings: exact worlds, noise against the bound, outliers, degenerate input, invariance.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use common::*;
use panopath::geometry::{Rotation, Similarity, Vector, add, angle_between, dot, norm, normalized, scale, sub};
use panopath::positions::*;
use panopath::synthetic::{Conic, Orientations, World, WorldKind, WorldOptions};
use panopath::tracks::Tracks;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const NOISE: f64 = 0.05 * DEG;

fn random(o: WorldOptions) -> WorldOptions {
    WorldOptions { orientations: Orientations::Random, ..o }
}

fn default<const D: usize>() -> PositionOptions<D> {
    PositionOptions::default()
}

// ---- exact ----------------------------------------------------------------------------------------------------------

/// Worlds that are unique in both dimensions.
fn unique_worlds() -> Vec<(&'static str, WorldKind, WorldOptions)> {
    let box_world = options(8, 40, 1);
    vec![
        ("box", WorldKind::Box, box_world.clone()),
        ("box seen in part", WorldKind::Box, WorldOptions { visible_fraction: Some(0.5), ..options(20, 60, 2) }),
        (
            "box, short tracks",
            WorldKind::Box,
            WorldOptions { max_views: Some(3), min_views: Some(3), ..options(12, 90, 3) },
        ),
        ("street", WorldKind::Street, options(60, 800, 4)),
        ("room", WorldKind::Room, options(60, 600, 5)),
        ("corridor", WorldKind::Corridor, options(50, 600, 6)),
        ("line", WorldKind::Line, options(40, 500, 7)),
        ("stop and go", WorldKind::StopAndGo, WorldOptions { min_views: Some(8), ..options(60, 800, 8) }),
        ("chain", WorldKind::Chain, options(150, 2500, 9)),
    ]
}

#[test]
fn exact_worlds_are_recovered_in_plane_and_space() {
    for (name, kind, o) in unique_worlds() {
        let o = random(o);
        let plane = simulate::<2>(kind, &o);
        assert_exact(&solve(&plane, &default()), &plane, name);
        let space = simulate::<3>(kind, &o);
        assert_exact(&solve(&space, &default()), &space, name);
    }
}

#[test]
fn without_orientations_bearings_are_world_directions() {
    let world = simulate::<3>(WorldKind::Box, &options(6, 30, 3));
    let scene = solve_tracks(&world.tracks, None, &default());
    assert_exact(&scene, &world, "box");
    assert!(scene.cam_from_world.iter().all(|r| *r == Rotation::identity()));
}

#[test]
fn a_cylinder_is_unique_in_space_although_not_from_above() {
    let world = simulate::<3>(WorldKind::Cylinder, &random(options(10, 40, 1)));
    assert_exact(&solve(&world, &default()), &world, "cylinder");
}

#[test]
fn scenes_on_a_conic_are_never_called_determined() {
    for conic in [Conic::Ellipse, Conic::Circle, Conic::Parabola, Conic::Hyperbola] {
        for noise_rad in [0.0, 1e-5, NOISE, 0.5 * DEG] {
            for seed in 0..3 {
                let o = WorldOptions { conic: Some(conic), noise_rad, ..options(10, 30, seed) };
                let world = simulate::<2>(WorldKind::Ellipse, &o);
                let scene = solve(&world, &default());
                assert!(
                    matches!(scene.summary.status, Status::Ambiguous | Status::Undetermined),
                    "{conic:?}, noise {noise_rad}, seed {seed}: {:?}",
                    scene.summary.status
                );
            }
        }
    }
}

#[test]
fn leaving_the_conic_makes_the_scene_unique() {
    for noise_rad in [0.0, 1e-4] {
        let o = WorldOptions { off_conic: Some(0.3), noise_rad, ..options(10, 60, 1) };
        let world = simulate::<2>(WorldKind::Ellipse, &o);
        let scene = solve(&world, &default());
        assert_eq!(scene.summary.status, Status::Converged);
        assert!(world_errors(&scene, &world).camera_worst < if noise_rad > 0.0 { 0.02 } else { EXACT });
    }
}

#[test]
fn coplanar_scenes_are_recovered_in_space() {
    let flat = |x: Vector<3>| [x[0], x[1], 0.25 * x[0] - 0.5 * x[1]];
    let centers: Vec<_> = places(8, &[0.0; 3], 1.0, 1).into_iter().map(flat).collect();
    let points: Vec<_> = places(40, &[0.0; 3], 2.0, 2).into_iter().map(flat).collect();
    let tracks = see(&centers, &points, all_pairs(8, 40));
    let scene = solve_tracks(&tracks, None, &default());
    assert_eq!(scene.summary.status, Status::Converged);
    assert!(errors(&scene, &centers, &points, 0).worst() < EXACT);
}

// ---- the output's gauge ---------------------------------------------------------------------------------------------

/// Runs a check for each method, in the plane and in space.
fn methods<const D: usize>() -> Vec<PositionOptions<D>> {
    let linear = |gauge| Method::Linear { form: LinearForm::Joint, gauge };
    [Method::Robust, linear(LinearGauge::Functional), linear(LinearGauge::Paper), linear(LinearGauge::PaperDistance)]
        .into_iter()
        .map(|method| PositionOptions { method, ..default() })
        .collect()
}

fn check_gauges<const D: usize>() {
    let world = simulate::<D>(WorldKind::Box, &random(options(7, 25, 3)));
    for o in methods::<D>() {
        let with = |gauge: Gauge<D>| {
            let scene = solve(&world, &PositionOptions { gauge, ..o.clone() });
            assert_exact(&scene, &world, "gauge");
            scene
        };
        let scene = with(Gauge::Normalized);
        assert!((path_size(&scene.centers) - 1.0).abs() < 1e-12);
        let middle = scene.centers.iter().fold([0.0; D], |sum, c| add(&sum, c));
        assert!(norm(&middle) < 1e-12);

        let sign = (world.points[1][0] - world.points[0][0]).signum();
        let scene = with(Gauge::Paper);
        assert!(norm(&scene.points[0]) < 1e-12);
        assert!((scene.points[1][0] - sign).abs() < 1e-12, "x2 = {}", scene.points[1][0]);

        let scene = with(Gauge::PaperDistance);
        assert!(norm(&scene.points[0]) < 1e-12);
        assert!((norm(&scene.points[1]) - 1.0).abs() < 1e-12);
    }
}

#[test]
fn each_gauge_holds_what_it_promises() {
    check_gauges::<2>();
    check_gauges::<3>();
}

/// A turn of the world: the same in the plane (about z) and in space.
fn turn<const D: usize>(angle_rad: f64) -> Rotation<D> {
    let (sin, cos) = angle_rad.sin_cos();
    let mut matrix = *Rotation::<D>::identity().matrix();
    (matrix[0][0], matrix[0][1], matrix[1][0], matrix[1][1]) = (cos, -sin, sin, cos);
    Rotation::from_matrix(matrix).unwrap()
}

fn known<const D: usize>(ids: &[u32], x: &[Vector<D>], known_from_world: &Similarity<D>) -> Vec<(u32, Vector<D>)> {
    ids.iter().map(|&id| (id, known_from_world.apply(&x[id as usize]))).collect()
}

fn check_control<const D: usize>() {
    let world = simulate::<D>(WorldKind::Box, &random(options(7, 25, 3)));
    let translation: Vector<D> = std::array::from_fn(|c| 100.0 - 7.0 * c as f64);
    for o in methods::<D>() {
        for (rotation, angle) in [(false, 0.0), (true, 2.5)] {
            let known_from_world = Similarity { scale: 37.0, rotation: turn(angle), translation };
            for (views, tracks) in [(&[0, 2, 5, 6][..], &[][..]), (&[], &[3, 20, 7, 11]), (&[4, 1], &[0, 9])] {
                let control = Control {
                    views: known(views, &world.centers, &known_from_world),
                    tracks: known(tracks, &world.points, &known_from_world),
                    rotation,
                };
                let gauge = Gauge::Control(control);
                let scene = solve(&world, &PositionOptions { gauge, ..o.clone() });
                assert_eq!(scene.summary.status, Status::Converged);
                for (found, truth) in
                    scene.centers.iter().zip(&world.centers).chain(scene.points.iter().zip(&world.points))
                {
                    let error = norm(&sub(found, &known_from_world.apply(truth)));
                    assert!(error < 1e-9 * 37.0, "d = {D}, rotation {rotation}, {views:?} {tracks:?}: {error}");
                }
                // orientations follow the frame: cam_from_known = cam_from_world world_from_known
                for (found, truth) in scene.cam_from_world.iter().zip(&world.cam_from_world) {
                    let wanted = truth.compose(&known_from_world.rotation.inverse());
                    let off = found.matrix().iter().flatten().zip(wanted.matrix().iter().flatten());
                    assert!(off.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) < 1e-9);
                }
            }
        }
    }
}

#[test]
fn control_places_the_scene_with_and_without_rotation() {
    check_control::<2>();
    check_control::<3>();
}

#[test]
fn control_is_a_least_squares_fit_under_noise() {
    let o = WorldOptions { noise_rad: NOISE, ..options(30, 300, 3) };
    let world = simulate::<3>(WorldKind::Street, &o);
    let all: Vec<u32> = (0..30).collect();
    let control = Control { views: known(&all, &world.centers, &Similarity::identity()), ..Control::default() };
    let scene = solve(&world, &PositionOptions { gauge: Gauge::Control(control), ..default() });
    let rms =
        (scene.centers.iter().zip(&world.centers).map(|(a, b)| norm(&sub(a, b)).powi(2)).sum::<f64>() / 30.0).sqrt();
    let fitted = world_errors(&scene, &world).camera_rms;
    assert!((rms / fitted - 1.0).abs() < 1e-6, "as placed {rms}, after another fit {fitted}");
}

// ---- noise ----------------------------------------------------------------------------------------------------------

/// Rms error over the bound, both averaged over seeds, and the mean ratio of the noise estimate to the noise.
fn against_the_bound<const D: usize>(kind: WorldKind, o: &WorldOptions, seeds: std::ops::Range<u64>) -> (f64, f64) {
    let (mut error, mut bound, mut sigma) = (0.0, 0.0, 0.0);
    let n = (seeds.end - seeds.start) as f64;
    for seed in seeds {
        let world = simulate::<D>(kind, &WorldOptions { seed, ..o.clone() });
        let scene = solve(&world, &default());
        assert_eq!(scene.summary.status, Status::Converged, "{} seed {seed}", kind.name());
        let e = world_errors(&scene, &world);
        assert_eq!(e.n_views, o.n_views, "{} seed {seed}", kind.name());
        error += e.camera_rms.powi(2);
        bound += bound_rms(&world).powi(2);
        sigma += scene.summary.sigma_rad / o.noise_rad / n;
        assert!((scene.summary.sigma_rad / o.noise_rad - 1.0).abs() < 0.3, "seed {seed}: {}", scene.summary.sigma_rad);
    }
    ((error / bound).sqrt(), sigma)
}

#[test]
fn noise_is_averaged_down_to_the_cramer_rao_bound() {
    let noisy = |n_views, n_points, noise_rad| random(WorldOptions { noise_rad, ..options(n_views, n_points, 0) });
    let cases = [
        ("street", WorldKind::Street, noisy(60, 3000, NOISE), 6),
        ("room", WorldKind::Room, noisy(60, 1500, NOISE), 8),
        ("box", WorldKind::Box, noisy(8, 60, 0.2 * DEG), 30),
    ];
    for (name, kind, o, seeds) in cases {
        for (dimension, (ratio, sigma)) in
            [(2, against_the_bound::<2>(kind, &o, 0..seeds)), (3, against_the_bound::<3>(kind, &o, 0..seeds))]
        {
            eprintln!("{name}, d = {dimension}: {ratio:.3} of the bound, sigma {sigma:.3} of the truth");
            assert!(ratio <= 1.15, "{name}, d = {dimension}: {ratio:.3} times the bound");
            assert!((sigma - 1.0).abs() < 0.1, "{name}, d = {dimension}: sigma {sigma:.3} of the truth");
        }
    }
}

/// The world with a standard deviation for each observation, and noise to match.
fn with_noise<const D: usize>(world: &World<D>, sigma_rad: Vec<f64>, seed: u64) -> Tracks<D> {
    let mut noise = Noise::new(seed);
    let bearing = world.tracks.bearing().iter().zip(&sigma_rad).map(|(b, s)| {
        let step: Vector<D> = std::array::from_fn(|_| s * noise.normal());
        // a Gaussian of the tangent plane: the part along the bearing does not turn it
        normalized(&add(b, &sub(&step, &scale(dot(&step, b), b))))
    });
    let bearing = bearing.collect();
    let t = &world.tracks;
    Tracks::new(t.view().to_vec(), t.track().to_vec(), bearing, Some(sigma_rad), t.n_views(), t.n_tracks()).unwrap()
}

fn check_sigmas<const D: usize>(kind: WorldKind, o: &WorldOptions) {
    let world = simulate::<D>(kind, o);
    let (mut weighted, mut unweighted, mut bound, mut sigma_ratio) = (0.0, 0.0, 0.0, 0.0);
    const SEEDS: u64 = 8;
    for seed in 0..SEEDS {
        let mut pick = Noise::new(1000 + seed);
        let sigma: Vec<f64> =
            (0..world.tracks.len()).map(|_| NOISE * if pick.uniform() < 0.4 { 0.1 } else { 1.0 }).collect();
        let tracks = with_noise(&world, sigma, seed);
        let plain = Tracks::new(
            tracks.view().to_vec(),
            tracks.track().to_vec(),
            tracks.bearing().to_vec(),
            None,
            tracks.n_views(),
            tracks.n_tracks(),
        )
        .unwrap();
        let rotations = Some(&world.cam_from_world[..]);
        let scene = solve_tracks(&tracks, rotations, &default());
        assert_eq!(scene.summary.status, Status::Converged);
        weighted += world_errors(&scene, &world).camera_rms.powi(2);
        // the estimate is that of an observation of median sigma
        sigma_ratio += scene.summary.sigma_rad / NOISE / SEEDS as f64;
        unweighted += world_errors(&solve_tracks(&plain, rotations, &default()), &world).camera_rms.powi(2);
        let covariance = position_covariance(&tracks, rotations, &world.centers, &world.points, 1.0, None).unwrap();
        bound += rms_of_covariance(&covariance).powi(2);
    }
    let (weighted, unweighted) = ((weighted / bound).sqrt(), (unweighted / bound).sqrt());
    eprintln!("d = {D}: weighted {weighted:.3}, unweighted {unweighted:.3} of the bound, sigma {sigma_ratio:.3}");
    assert!(weighted <= 1.15, "d = {D}: {weighted:.3} times its own bound");
    assert!(unweighted > 1.3 * weighted, "d = {D}: weighted {weighted:.3}, unweighted {unweighted:.3}");
    assert!((sigma_ratio - 1.0).abs() < 0.1, "d = {D}: sigma estimate {sigma_ratio:.3} of the truth");
}

#[test]
fn each_observation_counts_by_its_own_sigma() {
    check_sigmas::<3>(WorldKind::Street, &random(options(50, 1500, 2)));
    check_sigmas::<2>(WorldKind::Box, &random(options(10, 100, 2)));
}

#[test]
fn a_common_sigma_changes_nothing_but_units() {
    let world = simulate::<3>(WorldKind::Room, &WorldOptions { noise_rad: NOISE, ..options(30, 400, 2) });
    let plain = solve(&world, &default());
    let t = &world.tracks;
    for sigma in [1e-6, NOISE, 10.0 * NOISE] {
        let sigmas = Some(vec![sigma; t.len()]);
        let tracks =
            Tracks::new(t.view().to_vec(), t.track().to_vec(), t.bearing().to_vec(), sigmas, t.n_views(), t.n_tracks());
        let scene = solve_tracks(&tracks.unwrap(), Some(&world.cam_from_world), &default());
        let off = path_difference(&plain.centers, &scene.centers);
        assert!(off < 1e-8, "sigma {sigma}: {off}");
    }
}

/// Largest distance between two paths.
fn path_difference<const D: usize>(a: &[Vector<D>], b: &[Vector<D>]) -> f64 {
    a.iter().zip(b).map(|(a, b)| norm(&sub(a, b))).fold(0.0, |m, x| if x > m || x.is_nan() { x } else { m })
}

// ---- outliers -------------------------------------------------------------------------------------------------------

/// Solves, and compares with the optimum started from the truth: success and at most 1.2 times its error.
fn check_robust<const D: usize>(name: &str, kind: WorldKind, o: &WorldOptions) {
    let world = simulate::<D>(kind, o);
    let scene = solve(&world, &default());
    let (found, best) = (world_errors(&scene, &world), world_errors(&solve(&world, &from_truth(&world)), &world));
    let size = path_size(&world.centers);
    let what = format!("{name}, seed {}: {:?}, {found:?}, from truth {best:?}", o.seed, scene.summary.status);
    assert_eq!(scene.summary.status, Status::Converged, "{what}");
    assert_eq!(found.n_views, world.centers.len(), "{what}");
    assert!(found.camera_rms < 0.05 * size, "{what}");
    assert!(found.camera_rms <= 1.2 * best.camera_rms, "{what}");
    let wrong_kept = scene.inlier.iter().zip(&world.outlier).filter(|(kept, outlier)| **kept && **outlier).count();
    let right_lost = scene.inlier.iter().zip(&world.outlier).filter(|(kept, outlier)| !**kept && !**outlier).count();
    let n = world.tracks.len() as f64;
    assert!((wrong_kept as f64) < 0.01 * n, "{what}: {wrong_kept} of {n} are outliers that were kept");
    assert!((right_lost as f64) < 0.05 * n, "{what}: {right_lost} of {n} are good observations that were lost");
}

#[test]
fn outliers_do_not_move_the_answer() {
    for fraction in [0.05, 0.2, 0.35] {
        for seed in 0..3 {
            let o = random(WorldOptions { noise_rad: NOISE, outlier_fraction: fraction, ..options(60, 3000, seed) });
            check_robust::<3>(&format!("street with {fraction} outliers"), WorldKind::Street, &o);
            let o = WorldOptions {
                seed,
                ..random(WorldOptions { noise_rad: NOISE, outlier_fraction: fraction, ..options(60, 2000, seed) })
            };
            check_robust::<3>(&format!("room with {fraction} outliers"), WorldKind::Room, &o);
        }
    }
}

#[test]
fn outliers_in_the_plane_do_not_move_the_answer() {
    for fraction in [0.05, 0.2] {
        for seed in 0..3 {
            let o = random(WorldOptions { noise_rad: NOISE, outlier_fraction: fraction, ..options(40, 2000, seed) });
            check_robust::<2>(&format!("planar room with {fraction} outliers"), WorldKind::Room, &o);
        }
    }
}

#[test]
fn movers_and_the_operator_do_not_move_the_answer() {
    for seed in 0..3 {
        let o = random(WorldOptions {
            noise_rad: NOISE,
            mover_fraction: 0.1,
            operator_fraction: 0.05,
            ..options(60, 3000, seed)
        });
        let world = simulate::<3>(WorldKind::Street, &o);
        let scene = solve(&world, &default());
        let (found, best) = (world_errors(&scene, &world), world_errors(&solve(&world, &from_truth(&world)), &world));
        assert_eq!(scene.summary.status, Status::Converged, "seed {seed}");
        assert_eq!(found.n_views, 60, "seed {seed}");
        assert!(found.camera_rms <= 1.2 * best.camera_rms, "seed {seed}: {found:?}, from truth {best:?}");
        assert!(found.camera_rms < 0.05 * path_size(&world.centers), "seed {seed}: {found:?}");
    }
}

#[test]
fn tracks_of_three_views_survive_ten_percent_of_outliers() {
    for seed in 0..6 {
        let o = random(WorldOptions {
            noise_rad: NOISE,
            outlier_fraction: 0.1,
            min_views: Some(3),
            max_views: Some(3),
            ..options(60, 6000, seed)
        });
        let world = simulate::<3>(WorldKind::Street, &o);
        let scene = solve(&world, &default());
        let (found, best) = (world_errors(&scene, &world), world_errors(&solve(&world, &from_truth(&world)), &world));
        assert_eq!(scene.summary.status, Status::Converged, "seed {seed}");
        assert!(found.n_views == 60 && found.camera_rms <= 1.2 * best.camera_rms, "seed {seed}: {found:?}, {best:?}");
    }
}

#[test]
fn points_at_infinity_do_not_collapse_the_scene() {
    for seed in 0..6 {
        let o = random(WorldOptions { noise_rad: NOISE, infinity_fraction: 0.8, ..options(60, 6000, seed) });
        check_robust::<3>("80 % at infinity", WorldKind::Street, &o);
    }
}

#[test]
fn straight_paths_and_pauses_are_no_trouble() {
    for seed in 0..6 {
        let o = random(WorldOptions { noise_rad: NOISE, ..options(60, 3000, seed) });
        check_robust::<3>("straight", WorldKind::Line, &o);
        check_robust::<3>("stop and go", WorldKind::StopAndGo, &o);
    }
}

#[test]
fn wrong_orientations_leave_the_shape_of_the_path() {
    for (error_deg, allowed) in [(0.2, 0.02), (1.0, 0.1)] {
        for seed in 0..3 {
            let o = random(WorldOptions {
                noise_rad: NOISE,
                orientation_error_rad: error_deg * DEG,
                ..options(60, 3000, seed)
            });
            let world = simulate::<3>(WorldKind::Street, &o);
            let scene = solve(&world, &default());
            let found = world_errors(&scene, &world);
            let share = found.camera_rms / path_size(&world.centers);
            assert_eq!(scene.summary.status, Status::Converged, "{error_deg} deg, seed {seed}");
            assert!(found.n_views == 60 && share < allowed, "{error_deg} deg, seed {seed}: {share} of the path");
        }
    }
}

#[test]
fn a_false_match_stands_out_by_its_residual() {
    let world = simulate::<3>(WorldKind::Box, &WorldOptions { noise_rad: NOISE, ..options(10, 80, 3) });
    let mut bearing = world.tracks.bearing().to_vec();
    bearing[123] = turn::<3>(10.0 * DEG).apply(&bearing[123]);
    let t = &world.tracks;
    let tracks = Tracks::new(t.view().to_vec(), t.track().to_vec(), bearing, None, t.n_views(), t.n_tracks()).unwrap();
    let scene = solve_tracks(&tracks, Some(&world.cam_from_world), &default());
    assert!(!scene.inlier[123]);
    let true_angle = angle_between(&t.bearing()[123], &tracks.bearing()[123]);
    assert!((scene.residual_rad[123] - true_angle).abs() < 5.0 * NOISE);
    assert!(scene.inlier.iter().filter(|&&k| !k).count() < 10);
}

// ---- the minimum is one ---------------------------------------------------------------------------------------------

/// Noise of one size for all: below Huber's threshold and below the mask, so that the cost is the sum of squares.
fn with_even_noise<const D: usize>(world: &World<D>, size_rad: f64) -> Tracks<D> {
    let mut noise = Noise::new(5);
    let t = &world.tracks;
    let bearing = t.bearing().iter().map(|b| {
        let any: Vector<D> = noise.direction();
        let across = normalized(&sub(&any, &scale(dot(&any, b), b)));
        normalized(&add(b, &scale(size_rad, &across)))
    });
    Tracks::new(t.view().to_vec(), t.track().to_vec(), bearing.collect(), None, t.n_views(), t.n_tracks()).unwrap()
}

/// Summed squared angle of the observations for which `among` holds.
fn squared_angles<const D: usize>(
    scene: &Structure<D>,
    tracks: &Tracks<D>,
    among: impl Fn(usize, usize) -> bool,
) -> f64 {
    let mut sum = 0.0;
    for o in 0..tracks.len() {
        let (i, j) = (tracks.view()[o] as usize, tracks.track()[o] as usize);
        if among(i, j) {
            let u = normalized(&sub(&scene.points[j], &scene.centers[i]));
            sum += angle_between(&scene.cam_from_world[i].apply(&u), &tracks.bearing()[o]).powi(2);
        }
    }
    sum
}

/// By central differences, no coordinate of a camera or point can be improved by more than a hundredth of its own
/// standard deviation.
fn check_minimum<const D: usize>(kind: WorldKind, o: &WorldOptions) {
    let world = simulate::<D>(kind, o);
    let size = 1e-3;
    let tracks = with_even_noise(&world, size);
    let mut scene = solve_tracks(&tracks, Some(&world.cam_from_world), &default());
    assert_eq!(scene.summary.status, Status::Converged);
    let lost = scene.inlier.iter().filter(|&&k| !k).count();
    assert_eq!(lost, 0, "{} (d = {D}): noise of one size leaves no outlier", kind.name());
    let sigma = size / ((D - 1) as f64).sqrt();
    let mut worst: f64 = 0.0;
    for node in 0..world.centers.len() + world.points.len() {
        for c in 0..D {
            let (is_view, id) = (node < world.centers.len(), node.wrapping_sub(world.centers.len()));
            let mut cost_at = |shift: f64| {
                let x = if is_view { &mut scene.centers[node] } else { &mut scene.points[id] };
                x[c] += shift;
                let cost = squared_angles(&scene, &tracks, |i, j| if is_view { i == node } else { j == id });
                let x = if is_view { &mut scene.centers[node] } else { &mut scene.points[id] };
                x[c] -= shift;
                cost
            };
            let h = 1e-5;
            let (left, here, right) = (cost_at(-h), cost_at(0.0), cost_at(h));
            let (slope, curvature) = ((right - left) / (2.0 * h), (right - 2.0 * here + left) / (h * h));
            // step to the minimum over the standard deviation of this coordinate alone
            worst = worst.max(slope.abs() / (sigma * (2.0 * curvature.abs()).sqrt()));
        }
    }
    assert!(worst < 0.01, "{} (d = {D}): a coordinate is {worst} standard deviations off the minimum", kind.name());
}

#[test]
fn the_answer_minimises_the_squared_angles() {
    check_minimum::<3>(
        WorldKind::Street,
        &random(WorldOptions { min_views: Some(4), depth_max_m: Some(20.0), ..options(25, 250, 1) }),
    );
    check_minimum::<2>(WorldKind::Corridor, &random(WorldOptions { min_views: Some(6), ..options(20, 200, 1) }));
    check_minimum::<3>(WorldKind::Room, &random(options(25, 200, 2)));
    check_minimum::<2>(WorldKind::Room, &random(options(25, 200, 2)));
}

// ---- degenerate input -----------------------------------------------------------------------------------------------

fn assert_nothing<const D: usize>(scene: &Structure<D>) {
    assert_eq!(scene.summary.status, Status::Undetermined);
    assert!(scene.view_component.iter().chain(&scene.track_component).all(|&c| c == -1));
    assert!(scene.inlier.iter().all(|&k| !k) && scene.residual_rad.iter().all(|r| r.is_nan()));
}

fn every_way<const D: usize>() -> Vec<PositionOptions<D>> {
    let mut ways = methods::<D>();
    let whole: Vec<_> = ways.iter().map(|o| PositionOptions { split_parts: false, ..o.clone() }).collect();
    ways.extend(whole);
    ways
}

#[test]
fn no_observations_determine_nothing() {
    for (n_views, n_tracks) in [(0, 0), (3, 0), (0, 3), (5, 7)] {
        for o in every_way::<3>() {
            let tracks = Tracks::<3>::new(vec![], vec![], vec![], None, n_views, n_tracks).unwrap();
            assert_nothing(&solve_tracks(&tracks, None, &o));
            let tracks = Tracks::<3>::new(vec![], vec![], vec![], Some(vec![]), n_views, n_tracks).unwrap();
            assert_nothing(&solve_tracks(&tracks, None, &o));
        }
        for o in every_way::<2>() {
            let tracks = Tracks::<2>::new(vec![], vec![], vec![], None, n_views, n_tracks).unwrap();
            assert_nothing(&solve_tracks(&tracks, None, &o));
        }
    }
}

#[test]
fn a_single_view_determines_nothing() {
    let points = places(10, &[0.0; 3], 1.0, 1);
    let tracks = see(&[[0.1, 0.2, 0.3]], &points, all_pairs(1, 10));
    for o in every_way() {
        assert_nothing(&solve_tracks(&tracks, None, &o));
    }
}

#[test]
fn a_single_observation_determines_nothing() {
    let tracks = see(&[[0.0; 2]], &[[1.0, 2.0]], [(0, 0)]);
    for o in every_way() {
        assert_nothing(&solve_tracks(&tracks, None, &o));
    }
}

#[test]
fn two_views_fix_each_other_in_space_but_not_in_the_plane() {
    for m in [2, 3, 6, 40] {
        let (centers, points) = (places(2, &[0.0; 3], 1.0, 1), places(m, &[0.0; 3], 2.0, 2));
        let scene = solve_tracks(&see(&centers, &points, all_pairs(2, m)), None, &default());
        assert_eq!(scene.summary.status, Status::Converged, "{m} points");
        assert!(errors(&scene, &centers, &points, 0).worst() < EXACT, "{m} points");

        let (centers, points) = (places(2, &[0.0; 2], 1.0, 1), places(m, &[0.0; 2], 2.0, 2));
        for o in every_way() {
            let scene = solve_tracks(&see(&centers, &points, all_pairs(2, m)), None, &o);
            let status = scene.summary.status;
            assert!(
                matches!(status, Status::Undetermined | Status::Ambiguous),
                "{m} points in the plane: {o:?} {status:?}"
            );
        }
    }
}

#[test]
fn two_views_and_two_points_are_unique_only_off_one_plane() {
    let centers = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]];
    let off = [[0.3, 1.0, 0.4], [0.5, -0.2, 1.3]];
    let scene = solve_tracks(&see(&centers, &off, all_pairs(2, 2)), None, &default());
    assert_eq!(scene.summary.status, Status::Converged);
    assert!(errors(&scene, &centers, &off, 0).worst() < EXACT);
    let coplanar = [[0.3, 1.0, 0.5], [0.7, 2.0, 1.0]];
    for o in every_way() {
        let scene = solve_tracks(&see(&centers, &coplanar, all_pairs(2, 2)), None, &o);
        let status = scene.summary.status;
        assert!(matches!(status, Status::Undetermined | Status::Ambiguous), "coplanar: {status:?}");
    }
}

#[test]
fn a_track_seen_once_stays_unknown_and_harms_nothing() {
    let (centers, mut points) = (places(6, &[0.0; 3], 1.0, 1), places(20, &[0.0; 3], 2.0, 2));
    points.push([1.0, 1.0, 1.0]);
    let seen = all_pairs(6, 20).chain([(3, 20)]);
    for o in every_way() {
        let scene = solve_tracks(&see(&centers, &points, seen.clone()), None, &o);
        assert_eq!(scene.summary.status, Status::Converged);
        assert_eq!(scene.track_component[20], -1);
        assert!(errors(&scene, &centers, &points, 0).worst() < EXACT);
    }
}

#[test]
fn repeated_observations_that_agree_change_nothing() {
    let (centers, points) = (places(6, &[0.0; 3], 1.0, 1), places(20, &[0.0; 3], 2.0, 2));
    for o in every_way() {
        let twice = all_pairs(6, 20).chain(all_pairs(6, 20)).chain([(2, 5), (2, 5)]);
        let scene = solve_tracks(&see(&centers, &points, twice), None, &o);
        assert_eq!(scene.summary.status, Status::Converged);
        assert!(errors(&scene, &centers, &points, 0).worst() < EXACT);
        assert!(scene.inlier.iter().all(|&k| k));
    }
}

#[test]
fn a_track_seen_twice_by_one_view_alone_is_not_determined() {
    let (centers, points) = (places(6, &[0.0; 3], 1.0, 1), places(21, &[0.0; 3], 2.0, 2));
    let mut tracks = see(&centers, &points, all_pairs(6, 20).chain([(4, 20), (4, 20)]));
    // the two sightings contradict each other
    let mut bearing = tracks.bearing().to_vec();
    *bearing.last_mut().unwrap() = turn::<3>(0.3).apply(bearing.last().unwrap());
    tracks = Tracks::new(tracks.view().to_vec(), tracks.track().to_vec(), bearing, None, 6, 21).unwrap();
    for o in every_way() {
        let scene = solve_tracks(&tracks, None, &o);
        assert_eq!(scene.track_component[20], -1);
        assert_eq!(scene.summary.status, Status::Converged);
        assert!(errors(&scene, &centers, &points, 0).worst() < EXACT);
    }
}

#[test]
fn of_two_contradicting_sightings_the_right_one_is_kept() {
    let (centers, points) = (places(8, &[0.0; 3], 1.0, 1), places(30, &[0.0; 3], 2.0, 2));
    for wrong_first in [false, true] {
        let tracks = see(&centers, &points, all_pairs(8, 30).chain((0..30).step_by(3).map(|j| (j % 8, j))));
        let mut bearing = tracks.bearing().to_vec();
        let n = 8 * 30;
        for (k, j) in (0..30).step_by(3).enumerate() {
            let right = bearing[n + k];
            let wrong = turn::<3>(0.2).apply(&right);
            let first = j * 8 + j % 8;
            assert_eq!(bearing[first], right);
            bearing[if wrong_first { first } else { n + k }] = wrong;
        }
        let tracks = Tracks::new(tracks.view().to_vec(), tracks.track().to_vec(), bearing, None, 8, 30).unwrap();
        let scene = solve_tracks(&tracks, None, &default());
        assert_eq!(scene.summary.status, Status::Converged);
        assert!(errors(&scene, &centers, &points, 0).worst() < EXACT, "{:?}", errors(&scene, &centers, &points, 0));
        for (k, j) in (0..30).step_by(3).enumerate() {
            let (first, last) = (scene.inlier[j * 8 + j % 8], scene.inlier[n + k]);
            assert_eq!((first, last), (!wrong_first, wrong_first), "track {j}");
        }
    }
}

/// A scene of six views and twenty points, with one more track whose bearings are given.
fn with_odd_track(
    directions: impl Fn(usize, &Vector<3>) -> Option<Vector<3>>,
) -> (Vec<Vector<3>>, Vec<Vector<3>>, Tracks<3>) {
    let (centers, mut points) = (places(6, &[0.0; 3], 1.0, 1), places(20, &[0.0; 3], 2.0, 2));
    points.push([f64::NAN; 3]);
    let exact = see(&centers, &points[..20], all_pairs(6, 20));
    let (mut view, mut track, mut bearing) = (exact.view().to_vec(), exact.track().to_vec(), exact.bearing().to_vec());
    for (i, center) in centers.iter().enumerate() {
        if let Some(direction) = directions(i, center) {
            view.push(i as u32);
            track.push(20);
            bearing.push(normalized(&direction));
        }
    }
    let tracks = Tracks::new(view, track, bearing, None, 6, 21).unwrap();
    (centers, points, tracks)
}

fn check_odd_track_unknown(directions: impl Fn(usize, &Vector<3>) -> Option<Vector<3>>, what: &str) {
    let (centers, points, tracks) = with_odd_track(directions);
    for o in every_way() {
        let scene = solve_tracks(&tracks, None, &o);
        assert_eq!(scene.track_component[20], -1, "{what}: {:?}", o.method);
        assert_eq!(scene.summary.status, Status::Converged, "{what}: {:?}", o.method);
        assert!(errors(&scene, &centers, &points, 0).worst() < EXACT, "{what}: {:?}", o.method);
    }
}

#[test]
fn parallel_rays_leave_their_point_unknown() {
    check_odd_track_unknown(|_, _| Some([0.3, -0.4, 0.5]), "all parallel");
    check_odd_track_unknown(|i, _| (i < 2).then_some([0.3, -0.4, 0.5]), "two parallel");
    check_odd_track_unknown(|i, _| Some(if i % 2 == 0 { [0.0, 0.0, 1.0] } else { [0.0, 0.0, -1.0] }), "antiparallel");
}

#[test]
fn a_point_between_two_views_is_unknown_to_them_and_known_with_a_third() {
    let (centers, _, _) = with_odd_track(|_, _| None);
    let middle = scale(0.5, &add(&centers[0], &centers[1]));
    check_odd_track_unknown(|i, c| (i < 2).then(|| sub(&middle, c)), "antipodal");
    let (centers, mut points, tracks) = with_odd_track(|i, c| (i < 3).then(|| sub(&middle, c)));
    points[20] = middle;
    let scene = solve_tracks(&tracks, None, &default());
    assert_eq!(scene.track_component[20], 0);
    assert!(errors(&scene, &centers, &points, 0).worst() < EXACT);
}

#[test]
fn rays_that_are_all_parallel_determine_nothing() {
    let (centers, ways) = (places::<3>(5, &[0.0; 3], 1.0, 1), every_way());
    let mut noise = Noise::new(3);
    let directions: Vec<Vector<3>> = (0..30).map(|_| noise.direction()).collect();
    let (view, track): (Vec<u32>, Vec<u32>) = all_pairs(centers.len(), 30).map(|(i, j)| (i as u32, j as u32)).unzip();
    let bearing = track.iter().map(|&j| directions[j as usize]).collect();
    let tracks = Tracks::new(view, track, bearing, None, 5, 30).unwrap();
    for o in ways {
        assert_nothing(&solve_tracks(&tracks, None, &o));
    }
}

#[test]
fn a_camera_that_only_turned_is_not_called_determined() {
    for noise_rad in [1e-5, NOISE] {
        for seed in 0..4 {
            let still = vec![[0.5, -0.2, 0.1]; 12];
            let points = places(60, &[0.0; 3], 3.0, seed);
            let exact = see(&still, &points, all_pairs(12, 60));
            let mut noise = Noise::new(seed);
            let bearing = exact
                .bearing()
                .iter()
                .map(|b| normalized(&add(b, &std::array::from_fn(|_| noise_rad * noise.normal()))));
            let tracks =
                Tracks::new(exact.view().to_vec(), exact.track().to_vec(), bearing.collect(), None, 12, 60).unwrap();
            let status = solve_tracks(&tracks, None, &default()).summary.status;
            assert!(
                matches!(status, Status::Ambiguous | Status::Undetermined),
                "noise {noise_rad}, seed {seed}: {status:?}"
            );
        }
    }
}

#[test]
fn tracks_of_outliers_alone_are_not_called_points() {
    let o = random(WorldOptions { noise_rad: 1e-4, ..options(10, 100, 4) });
    let world = simulate::<3>(WorldKind::Box, &o);
    let mut noise = Noise::new(9);
    let bearing = world.tracks.bearing().iter().zip(world.tracks.track());
    let bearing = bearing.map(|(b, &j)| if j < 10 { noise.direction() } else { *b }).collect();
    let t = &world.tracks;
    let tracks = Tracks::new(t.view().to_vec(), t.track().to_vec(), bearing, None, t.n_views(), t.n_tracks()).unwrap();
    let scene = solve_tracks(&tracks, Some(&world.cam_from_world), &default());
    assert_eq!(scene.summary.status, Status::Converged);
    let true_points: Vec<Vector<3>> = world.points.clone();
    let e = errors(&scene, &world.centers, &true_points, 0);
    assert!(e.camera_worst < 0.01, "{e:?}");
    // two random rays nearly never agree to within 5 sigma of 1e-4 rad: 45 pairs a track, each a chance of 1e-3
    let kept = (0..10).filter(|&j| scene.track_component[j] >= 0).count();
    assert!(kept <= 2, "{kept} of 10 tracks of random bearings became points");
}

#[test]
fn nothing_but_outliers_is_not_called_a_scene() {
    for seed in 0..5 {
        let mut noise = Noise::new(seed);
        let (view, track): (Vec<u32>, Vec<u32>) = all_pairs(8, 40).map(|(i, j)| (i as u32, j as u32)).unzip();
        let bearing = view.iter().map(|_| noise.direction()).collect();
        let tracks = Tracks::<3>::new(view, track, bearing, None, 8, 40).unwrap();
        let status = solve_tracks(&tracks, None, &default()).summary.status;
        assert_ne!(status, Status::Converged, "seed {seed}");
    }
}

#[test]
fn views_that_coincide_are_placed_together() {
    let (mut centers, points) = (places(6, &[0.0; 3], 1.0, 1), places(20, &[0.0; 3], 2.0, 2));
    centers[4] = centers[1];
    centers[5] = centers[1];
    let scene = solve_tracks(&see(&centers, &points, all_pairs(6, 20)), None, &default());
    assert_eq!(scene.summary.status, Status::Converged);
    assert!(errors(&scene, &centers, &points, 0).worst() < EXACT);
    assert!(norm(&sub(&scene.centers[4], &scene.centers[1])) < EXACT);
}

#[test]
fn a_camera_at_a_point_harms_nothing() {
    let (centers, mut points) = (places(8, &[0.0; 3], 1.0, 1), places(30, &[0.0; 3], 2.0, 2));
    points[7] = centers[3];
    // what a camera sees of a point inside it is any direction
    let tracks = see(&centers, &points, all_pairs(8, 30));
    for o in methods() {
        let scene = solve_tracks(&tracks, None, &o);
        assert_eq!(scene.summary.status, Status::Converged, "{:?}", o.method);
        if o.method == Method::Robust {
            let e = errors(&scene, &centers, &points, 0);
            assert!(e.n_views == 8 && e.worst() < EXACT, "{e:?}");
        }
    }
}

#[test]
fn a_line_of_everything_determines_nothing() {
    let on_line = |t: f64| [1.0 + 2.0 * t, 3.0 - t, 0.5 * t];
    let centers: Vec<Vector<3>> = (0..5).map(|i| on_line(f64::from(i))).collect();
    let points: Vec<Vector<3>> = (0..9).map(|j| on_line(0.37 + 0.51 * f64::from(j))).collect();
    for o in every_way() {
        let scene = solve_tracks(&see(&centers, &points, all_pairs(5, 9)), None, &o);
        assert_nothing(&scene);
    }
}

#[test]
fn a_point_on_the_line_of_the_cameras_stays_unknown() {
    let centers: Vec<Vector<3>> = (0..6).map(|i| [f64::from(i), 0.0, 0.0]).collect();
    let mut points = places(20, &[2.5, 0.0, 3.0], 2.0, 2);
    points.push([9.0, 0.0, 0.0]);
    let scene = solve_tracks(&see(&centers, &points, all_pairs(6, 21)), None, &default());
    assert_eq!(scene.track_component[20], -1);
    assert_eq!(scene.summary.status, Status::Converged);
    assert!(errors(&scene, &centers, &points, 0).worst() < EXACT);
}

#[test]
fn huge_ids_and_views_without_observations_cost_nothing() {
    let (centers, points) = (places(6, &[0.0; 3], 1.0, 1), places(20, &[0.0; 3], 2.0, 2));
    let near = see(&centers, &points, all_pairs(6, 20));
    let (n_views, n_tracks) = (200_000, 3_000_000);
    // (a second of passes over arrays of that length; anything quadratic would take hours)
    let view = near.view().iter().map(|v| v * 33_333 + 7).collect();
    let track = near.track().iter().map(|t| t * 150_000 + 11).collect();
    let tracks = Tracks::new(view, track, near.bearing().to_vec(), None, n_views, n_tracks).unwrap();
    let clock = std::time::Instant::now();
    let scene = solve_positions(&tracks, None, &default()).unwrap();
    assert!(clock.elapsed().as_secs_f64() < 20.0, "{:?}", clock.elapsed());
    assert_eq!(scene.summary.status, Status::Converged);
    assert_eq!(scene.view_component.iter().filter(|&&c| c >= 0).count(), 6);
    assert_eq!(scene.track_component.iter().filter(|&&c| c >= 0).count(), 20);
    let same = solve_tracks(&near, None, &default());
    for (i, c) in same.centers.iter().enumerate() {
        assert!(norm(&sub(c, &scene.centers[i * 33_333 + 7])) < EXACT);
    }
}

#[test]
fn views_with_a_single_observation_stay_unknown() {
    let (mut centers, points) = (places(6, &[0.0; 3], 1.0, 1), places(20, &[0.0; 3], 2.0, 2));
    centers.extend([[5.0, 5.0, 5.0], [6.0, 6.0, 6.0]]);
    let scene = solve_tracks(&see(&centers, &points, all_pairs(6, 20).chain([(6, 3)])), None, &default());
    assert_eq!((scene.view_component[6], scene.view_component[7]), (-1, -1));
    assert_eq!(scene.summary.status, Status::Converged);
    assert!(errors(&scene, &centers, &points, 0).worst() < EXACT);
}

#[test]
fn a_view_of_outliers_alone_is_not_placed() {
    let world = simulate::<3>(WorldKind::Box, &WorldOptions { noise_rad: 1e-4, ..options(12, 100, 4) });
    let mut noise = Noise::new(9);
    let bearing = world.tracks.bearing().iter().zip(world.tracks.view());
    let bearing = bearing.map(|(b, &i)| if i == 5 { noise.direction() } else { *b }).collect();
    let t = &world.tracks;
    let tracks = Tracks::new(t.view().to_vec(), t.track().to_vec(), bearing, None, t.n_views(), t.n_tracks()).unwrap();
    let scene = solve_tracks(&tracks, Some(&world.cam_from_world), &default());
    let e = errors(&scene, &world.centers, &world.points, 0);
    assert_eq!(scene.view_component[5], -1, "a view whose bearings are all random was placed");
    assert!(e.n_views == 11 && e.camera_worst < 0.01, "{e:?}");
}

#[test]
fn missing_points_of_a_start_are_found_anew() {
    let world = simulate::<3>(WorldKind::Street, &random(options(40, 500, 2)));
    let mut start = (world.centers.clone(), world.points.clone());
    for point in start.1.iter_mut().step_by(7) {
        *point = [f64::NAN; 3];
    }
    let scene = solve(&world, &PositionOptions { start: Some(start), ..default() });
    assert_exact(&scene, &world, "start without some points");
}

#[test]
fn missing_centres_of_a_start_are_found_anew_or_refused() {
    let world = simulate::<3>(WorldKind::Box, &random(options(8, 40, 2)));
    let mut start = (world.centers.clone(), world.points.clone());
    start.0[3][1] = f64::NAN;
    match solve_positions(
        &world.tracks,
        Some(&world.cam_from_world),
        &PositionOptions { start: Some(start), ..default() },
    ) {
        Ok(scene) => assert_exact(&scene, &world, "start without a centre"),
        Err(error) => assert_eq!(error.to_string(), "start: the centre of view 3 is not finite"),
    }
}

#[test]
fn a_start_of_truth_stays_there_and_a_bad_start_is_no_panic() {
    let world = simulate::<3>(WorldKind::Box, &random(options(8, 40, 2)));
    assert_exact(&solve(&world, &from_truth(&world)), &world, "start at the truth");
    for fill in [0.0, 1e300, f64::MIN_POSITIVE, f64::INFINITY] {
        let start = Some((vec![[fill; 3]; 8], vec![[fill; 3]; 40]));
        if let Ok(scene) = solve_positions(&world.tracks, None, &PositionOptions { start, ..default() }) {
            check_invariants(&scene, &world.tracks);
        }
    }
}

#[test]
fn too_few_iterations_are_said() {
    let world = simulate::<3>(
        WorldKind::Street,
        &WorldOptions { noise_rad: NOISE, outlier_fraction: 0.2, ..options(40, 800, 2) },
    );
    for max_iterations in [0, 1] {
        let scene = solve(&world, &PositionOptions { max_iterations, ..default() });
        assert_eq!(scene.summary.status, Status::MaxIterations);
    }
}

#[test]
fn arguments_that_do_not_fit_are_named() {
    let world = simulate::<3>(WorldKind::Box, &options(6, 20, 2));
    let error = |rotations: Option<&[Rotation<3>]>, o: PositionOptions<3>| {
        solve_positions(&world.tracks, rotations, &o).unwrap_err().to_string()
    };
    let text = error(Some(&world.cam_from_world[..5]), default());
    assert!(text.contains("cam_from_world") && text.contains('5') && text.contains('6'), "{text}");
    let text = error(None, PositionOptions { start: Some((vec![[0.0; 3]; 6], vec![[0.0; 3]; 19])), ..default() });
    assert!(text.contains("start") && text.contains("19") && text.contains("20"), "{text}");
    let form = LinearForm::TwoStage { vertical_axis: 3 };
    let method = Method::Linear { form, gauge: LinearGauge::Functional };
    assert!(error(None, PositionOptions { method, ..default() }).contains("vertical_axis"));
    for (control, wanted) in [
        (Control { views: vec![(6, [0.0; 3])], ..Default::default() }, "view 6"),
        (Control { tracks: vec![(20, [0.0; 3])], ..Default::default() }, "track 20"),
        (Control { views: vec![(1, [0.0, f64::NAN, 0.0])], ..Default::default() }, "view 1"),
        (Control { views: vec![(1, [0.0; 3])], ..Default::default() }, "two"),
        (Control { views: vec![(1, [2.0; 3]), (2, [2.0; 3])], ..Default::default() }, "one place"),
        (Control::default(), "two"),
    ] {
        let text = error(None, PositionOptions { gauge: Gauge::Control(control), ..default() });
        assert!(text.contains("control") && text.contains(wanted), "{text}");
    }
}

#[test]
fn arrays_that_make_no_tracks_are_named() {
    let b = vec![[1.0, 0.0, 0.0]; 2];
    let text = |r: Result<Tracks<3>, panopath::TracksError>| r.unwrap_err().to_string();
    assert!(text(Tracks::new(vec![0, 1], vec![0], b.clone(), None, 2, 1)).contains("track has 1"));
    assert!(text(Tracks::new(vec![0, 1], vec![0, 0], b[..1].to_vec(), None, 2, 1)).contains("bearing has 1"));
    assert!(text(Tracks::new(vec![0, 1], vec![0, 0], b.clone(), Some(vec![1.0]), 2, 1)).contains("sigma_rad has 1"));
    assert!(text(Tracks::new(vec![0, 2], vec![0, 0], b.clone(), None, 2, 1)).contains("view[1] is 2"));
    assert!(text(Tracks::new(vec![0, 1], vec![0, 1], b.clone(), None, 2, 1)).contains("track[1] is 1"));
    for wrong in [[0.0; 3], [f64::NAN, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0], [1.001, 0.0, 0.0]] {
        assert!(text(Tracks::new(vec![0, 1], vec![0, 0], vec![b[0], wrong], None, 2, 1)).contains("bearing[1]"));
    }
    for wrong in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(
            text(Tracks::new(vec![0, 1], vec![0, 0], b.clone(), Some(vec![1.0, wrong]), 2, 1)).contains("sigma_rad[1]")
        );
    }
}

// ---- invariance -----------------------------------------------------------------------------------------------------

/// A small world with noise and outliers, as rays in the world.
fn noisy_world<const D: usize>(seed: u64) -> World<D> {
    // in the plane any two of three rays agree: which one is the outlier is then a matter of chance
    let outlier_fraction = if D == 2 { 0.0 } else { 0.05 };
    let o = WorldOptions { noise_rad: NOISE, outlier_fraction, min_views: Some(5), ..options(15, 150, seed) };
    simulate::<D>(WorldKind::Room, &o)
}

fn rebuilt<const D: usize>(
    t: &Tracks<D>,
    order: &[usize],
    view: impl Fn(u32) -> u32,
    track: impl Fn(u32) -> u32,
) -> Tracks<D> {
    Tracks::new(
        order.iter().map(|&o| view(t.view()[o])).collect(),
        order.iter().map(|&o| track(t.track()[o])).collect(),
        order.iter().map(|&o| t.bearing()[o]).collect(),
        None,
        t.n_views(),
        t.n_tracks(),
    )
    .unwrap()
}

/// Two answers are one: same members, as many inliers, centres within a fifth of what noise does to them. (An observation at
/// the very limit of the outliers may take part in one descent and not in the other.)
fn assert_same<const D: usize>(
    one: &Structure<D>,
    other: &Structure<D>,
    view: impl Fn(usize) -> usize,
    track: impl Fn(usize) -> usize,
    turned: impl Fn(&Vector<D>) -> Vector<D>,
) {
    /// The noise moves a centre by some 1e-3 of the path's size.
    const TOLERANCE: f64 = 2e-4;
    /// Farther than any wall of the room that the worlds are in.
    const FAR: f64 = 20.0;
    assert_eq!(one.summary.status, other.summary.status);
    assert_eq!(one.summary.n_components, other.summary.n_components);
    for i in 0..one.centers.len() {
        assert_eq!(one.view_component[i], other.view_component[view(i)]);
        let off = norm(&sub(&turned(&one.centers[i]), &other.centers[view(i)]));
        assert!(off < TOLERANCE, "view {i} is off by {off}");
    }
    for j in 0..one.points.len() {
        let far = 1.0 + norm(&one.points[j]);
        assert_eq!(one.track_component[j], other.track_component[track(j)]);
        let off = norm(&sub(&turned(&one.points[j]), &other.points[track(j)]));
        // a point that its views cannot tell from one at infinity has no distance to compare
        let determined = one.track_component[j] >= 0 && far < FAR;
        assert!(!determined || off < TOLERANCE * far * far * 10.0, "point {j} is off by {off}");
    }
    let count = |s: &Structure<D>| s.inlier.iter().filter(|&&k| k).count();
    assert_eq!(count(one), count(other));
}

fn check_order_does_not_matter<const D: usize>(seed: u64) {
    let world = noisy_world::<D>(seed);
    let t = &world.tracks;
    let reference = solve_tracks(t, None, &default());
    let mut noise = Noise::new(seed ^ 77);
    let (views, tracks) = (noise.permutation(t.n_views()), noise.permutation(t.n_tracks()));
    let order = noise.permutation(t.len());
    let straight: Vec<usize> = (0..t.len()).collect();
    let same = |x: u32| x;

    let shuffled = solve_tracks(&rebuilt(t, &order, same, same), None, &default());
    assert_same(&reference, &shuffled, |i| i, |j| j, |x| *x);
    for (o, &from) in order.iter().enumerate() {
        assert_eq!(shuffled.inlier[o], reference.inlier[from]);
    }
    let renamed = rebuilt(t, &straight, |i| views[i as usize] as u32, |j| tracks[j as usize] as u32);
    assert_same(&reference, &solve_tracks(&renamed, None, &default()), |i| views[i], |j| tracks[j], |x| *x);
}

fn check_turn_does_not_matter<const D: usize>(seed: u64, rotation: &Rotation<D>) {
    let world = noisy_world::<D>(seed);
    let t = &world.tracks;
    let reference = solve_tracks(t, None, &default());
    let bearing: Vec<Vector<D>> = t.bearing().iter().map(|b| rotation.apply(b)).collect();
    let turned = Tracks::new(t.view().to_vec(), t.track().to_vec(), bearing, None, t.n_views(), t.n_tracks()).unwrap();
    let scene = solve_tracks(&turned, None, &default());
    assert_same(&reference, &scene, |i| i, |j| j, |x| rotation.apply(x));
    // the same said by orientations: cameras turned against the world
    let orientations = vec![rotation.inverse(); t.n_views()];
    let scene = solve_tracks(t, Some(&orientations), &default());
    assert_same(&reference, &scene, |i| i, |j| j, |x| rotation.apply(x));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, failure_persistence: None, rng_seed: RngSeed::Fixed(2007), ..ProptestConfig::default() })]

    #[test]
    fn the_order_of_views_tracks_and_observations_does_not_matter(seed in 0u64..1000) {
        check_order_does_not_matter::<2>(seed);
        check_order_does_not_matter::<3>(seed);
    }

    #[test]
    fn a_turn_of_the_world_turns_the_answer(seed in 0u64..1000, phi in prop::array::uniform3(-4.0..4.0f64)) {
        check_turn_does_not_matter::<2>(seed, &Rotation::from_angle(phi[0]));
        check_turn_does_not_matter::<3>(seed, &Rotation::exp(&phi));
    }

    #[test]
    fn a_similarity_of_an_exact_world_is_recovered(
        seed in 0u64..1000, log_scale in -6.0..6.0f64, shift in prop::array::uniform3(-1.0..1.0f64), angle in -3.2..3.2f64,
    ) {
        let mut world = simulate::<3>(WorldKind::Box, &options(7, 30, seed));
        let factor = 10f64.powf(log_scale);
        let moved = Similarity { scale: factor, rotation: turn(angle), translation: scale(3.0 * factor, &shift) };
        for x in world.centers.iter_mut().chain(&mut world.points) {
            *x = moved.apply(x);
        }
        world.tracks = see(&world.centers, &world.points, all_pairs(7, 30));
        let scene = solve_tracks(&world.tracks, None, &default());
        prop_assert_eq!(scene.summary.status, Status::Converged);
        let e = world_errors(&scene, &world);
        prop_assert!(e.worst() < EXACT, "{:?}", e);
    }
}

#[test]
fn seam_and_poles_are_like_any_other_place() {
    let quarter = std::f64::consts::FRAC_PI_2;
    for seed in 0..2 {
        for k in 0..4 {
            check_turn_does_not_matter::<2>(seed, &Rotation::from_angle(f64::from(k) * quarter));
            for axis in 0..3 {
                let mut phi = [0.0; 3];
                phi[axis] = f64::from(k) * quarter;
                check_turn_does_not_matter::<3>(seed, &Rotation::exp(&phi));
            }
        }
    }
}

#[test]
fn an_exact_pole_and_seam_are_recovered() {
    // rays along every axis and exactly on the seam of each angle
    let centers = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, -1.0, 0.0]];
    let points = [
        [0.0, 0.0, 3.0],
        [-4.0, 0.0, 0.0],
        [0.0, 0.0, -3.0],
        [0.0, 5.0, 0.0],
        [1.0, 0.0, 2.0],
        [-3.0, 1.0, 0.0],
        [-2.0, 0.0, 1.0],
    ];
    for o in methods() {
        let scene = solve_tracks(&see(&centers, &points, all_pairs(5, 7)), None, &o);
        assert_eq!(scene.summary.status, Status::Converged, "{:?}", o.method);
        assert!(errors(&scene, &centers, &points, 0).worst() < EXACT, "{:?}", o.method);
    }
}

// ---- determinism ----------------------------------------------------------------------------------------------------

fn bits<const D: usize>(scene: &Structure<D>) -> Vec<u64> {
    let positions = scene.centers.iter().chain(&scene.points).flatten();
    positions.chain(&scene.residual_rad).chain([&scene.summary.sigma_rad]).map(|x| x.to_bits()).collect()
}

#[test]
fn the_same_bytes_come_out_on_one_thread_or_many() {
    let o = random(WorldOptions { noise_rad: NOISE, outlier_fraction: 0.1, ..options(120, 6000, 3) });
    for (kind, method) in [
        (WorldKind::Street, Method::Robust),
        (WorldKind::Room, Method::Robust),
        (WorldKind::Room, Method::Linear { form: LinearForm::Joint, gauge: LinearGauge::Functional }),
    ] {
        for linear_solver in [LinearSolver::Auto, LinearSolver::Direct, LinearSolver::Iterative] {
            let world = simulate::<3>(kind, &o);
            let run = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let chosen = PositionOptions { method, linear_solver, ..default() };
                pool.install(|| solve(&world, &chosen))
            };
            let one = run(1);
            for threads in [1, 2, 3] {
                let other = run(threads);
                assert!(
                    bits(&one) == bits(&other),
                    "{} {method:?} {linear_solver:?} on {threads} threads",
                    kind.name()
                );
                assert_eq!((&one.inlier, &one.view_component), (&other.inlier, &other.view_component));
            }
        }
    }
}

#[test]
fn both_linear_solvers_find_the_same_minimum() {
    let o = random(WorldOptions { noise_rad: NOISE, ..options(80, 3000, 3) });
    for kind in [WorldKind::Room, WorldKind::Street] {
        let world = simulate::<3>(kind, &o);
        let run = |linear_solver| solve(&world, &PositionOptions { linear_solver, ..default() });
        let (direct, iterative) = (run(LinearSolver::Direct), run(LinearSolver::Iterative));
        assert_eq!(iterative.summary.status, Status::Converged, "{}", kind.name());
        let off = path_difference(&direct.centers, &iterative.centers);
        let noise = bound_rms(&world) / path_size(&world.centers);
        assert!(off < 0.1 * noise, "{}: {off} apart, noise {noise}", kind.name());
    }
}
