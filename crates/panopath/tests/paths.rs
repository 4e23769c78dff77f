//! Cameras and the paths of bodies that move.

use panopath::geometry::{Rotation, Vector, norm, sub};
use panopath::paths::{Assumption, Form, Motion as Allowed, MovingStructure, Verdict, solve_paths};
use panopath::positions::{Control, Gauge, PositionOptions};
use panopath::structure::Status;
use panopath::synthetic::{Motion, World, WorldKind, WorldOptions, simulate};

fn street(noise_rad: f64, outlier_fraction: f64) -> World<3> {
    let options = WorldOptions {
        n_views: 60,
        n_points: 900,
        noise_rad,
        outlier_fraction,
        mover_fraction: 0.3,
        n_bodies: 12,
        ..WorldOptions::default()
    };
    simulate::<3>(WorldKind::Street, &options).unwrap_or_else(|error| panic!("{error}"))
}

fn auto(n_tracks: usize) -> Allowed {
    let taylor = |order| Form::Taylor { order, origin_s: f64::NAN, unit_s: f64::NAN };
    Allowed {
        forms: vec![None; n_tracks],
        candidates: vec![taylor(1), taylor(2)],
        common_frequency: false,
        free_orientations: false,
        covariance: true,
    }
}

fn solve(world: &World<3>, motion: &Allowed) -> MovingStructure<3> {
    let views = world.centers.iter().enumerate().map(|(i, c)| (i as u32, *c)).collect();
    let options = PositionOptions {
        gauge: Gauge::Control(Control { views, tracks: Vec::new(), rotation: false }),
        ..PositionOptions::default()
    };
    solve_paths::<3, 6>(&world.tracks, &world.time_s, None, motion, &options).unwrap_or_else(|error| panic!("{error}"))
}

fn rms(found: &[Vector<3>], truth: &[Vector<3>]) -> f64 {
    let squared: f64 = found.iter().zip(truth).map(|(a, b)| norm(&sub(a, b)).powi(2)).sum();
    (squared / truth.len() as f64).sqrt()
}

fn is_moving(verdict: Verdict) -> bool {
    matches!(verdict, Verdict::Moving | Verdict::Imitated | Verdict::Hidden { .. })
}

#[test]
fn exact_bearings_give_cameras_and_paths_exactly() {
    let world = street(0.0, 0.0);
    let scene = solve(&world, &auto(world.tracks.n_tracks()));
    assert_eq!(scene.structure.summary.status, Status::Converged);
    assert_eq!(scene.assumption, Assumption::MostStatic);
    assert!(rms(&scene.structure.centers, &world.centers) < 1e-7);
    let mut n_moving = 0;
    for (track, verdict) in scene.verdict.iter().enumerate() {
        // a body that moves with the camera looks like a point at rest, exactly
        if *verdict == Verdict::Moving {
            n_moving += 1;
            let off = norm(&sub(&scene.structure.points[track], &world.points[track]));
            let distance = norm(&sub(&world.points[track], &world.centers[0]));
            assert!(off < 1e-5 * (1.0 + distance), "track {track} is {off} off");
        }
    }
    assert!(n_moving > 200, "{n_moving} tracks move");
}

#[test]
fn movers_are_told_from_what_rests_in_noise_and_outliers() {
    let world = street(0.05_f64.to_radians(), 0.1);
    let scene = solve(&world, &auto(world.tracks.n_tracks()));
    let truly = |track: usize| matches!(world.motion[track], Motion::Moves { .. });
    let seen: Vec<usize> =
        (0..world.tracks.n_tracks()).filter(|&t| world.tracks.track().contains(&(t as u32))).collect();
    let of = |moves: bool| seen.iter().filter(move |&&t| truly(t) == moves).copied().collect::<Vec<_>>();
    let share =
        |tracks: &[usize]| tracks.iter().filter(|&&t| is_moving(scene.verdict[t])).count() as f64 / tracks.len() as f64;
    assert!(share(&of(true)) >= 0.95, "{}", share(&of(true)));
    assert!(share(&of(false)) <= 0.01, "{}", share(&of(false)));
    // some 2 cm where tracks at rest alone give 1
    assert!(rms(&scene.structure.centers, &world.centers) < 0.05);
}

#[test]
fn the_same_input_gives_the_same_bytes_on_any_number_of_threads() {
    let world = street(0.05_f64.to_radians(), 0.1);
    let motion = auto(world.tracks.n_tracks());
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let pool = pool.unwrap_or_else(|error| panic!("{error}"));
        let scene = pool.install(|| solve(&world, &motion));
        format!("{:?} {:?} {:?} {:?}", scene.structure.centers, scene.vectors, scene.covariance, scene.verdict)
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn orientations_that_are_off_are_found_with_the_paths() {
    let mut world = street(1e-4, 0.0);
    let turn = |k: usize| Rotation::<3>::exp(&[0.004 * (k as f64).sin(), 0.003, 0.005 * (k as f64).cos()]);
    world.cam_from_world = (0..world.centers.len()).map(turn).collect();
    let motion = auto(world.tracks.n_tracks());
    let options = PositionOptions::default();
    let solve = |free: bool| {
        let motion = Allowed { free_orientations: free, covariance: false, ..motion.clone() };
        let rotations = Some(world.cam_from_world.as_slice());
        let scene = solve_paths::<3, 6>(&world.tracks, &world.time_s, rotations, &motion, &options);
        scene.unwrap_or_else(|error| panic!("{error}")).structure.summary.sigma_rad
    };
    assert!(solve(true) < 1.5e-4, "{}", solve(true));
    assert!(solve(false) > 5e-4, "{}", solve(false));
}

#[test]
fn unusable_arguments_are_named() {
    let world = street(0.0, 0.0);
    let motion = auto(world.tracks.n_tracks());
    let options = PositionOptions::default();
    let message =
        |time_s: &[f64], motion: &Allowed| match solve_paths::<3, 6>(&world.tracks, time_s, None, motion, &options) {
            Ok(_) => String::new(),
            Err(error) => error.to_string(),
        };
    assert!(message(&world.time_s[1..], &motion).starts_with("time_s has 59 entries, expected 60"));
    let mut times = world.time_s.clone();
    times[7] = f64::NAN;
    assert!(message(&times, &motion).starts_with("time_s[7] is not finite"));
    let short = Allowed { forms: vec![None; 3], ..motion };
    assert!(message(&world.time_s, &short).starts_with("forms has 3 entries"));
}
