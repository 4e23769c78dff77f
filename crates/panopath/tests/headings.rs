//! Headings of planar views: exact where it is determined, near the noise elsewhere, silent where it is not.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{Noise, all_pairs, places, see};
use panopath::geometry::*;
use panopath::headings::{HeadingOptions, HeadingStatus, Headings, start_headings};
use panopath::synthetic::{Orientations, World, WorldKind, WorldOptions, simulate};
use panopath::{Rotation, Tracks};

fn wrapped(angle: f64) -> f64 {
    angle.sin().atan2(angle.cos())
}

/// Heading errors of a component after the best common turn, ascending.
fn errors(found: &Headings, truth: &[f64], component: i32) -> Vec<f64> {
    let of_component = found.heading_rad.iter().zip(truth).zip(&found.view_component);
    let turns: Vec<f64> = of_component.filter(|(_, c)| **c == component).map(|((h, t), _)| h - t).collect();
    let mean = turns.iter().map(|t| t.sin()).sum::<f64>().atan2(turns.iter().map(|t| t.cos()).sum());
    let mut off: Vec<f64> = turns.iter().map(|t| wrapped(t - mean).abs()).collect();
    off.sort_by(f64::total_cmp);
    off
}

fn true_headings(world: &World<2>) -> Vec<f64> {
    world.cam_from_world.iter().map(|r| r.matrix()[0][1].atan2(r.matrix()[0][0])).collect()
}

/// Bearings in cameras of these headings.
fn turned(tracks: &Tracks<2>, heading: &[f64]) -> Tracks<2> {
    let turn = |(v, b): (&u32, &Vector<2>)| Rotation::from_angle(-heading[*v as usize]).apply(b);
    let bearing = tracks.view().iter().zip(tracks.bearing()).map(turn).collect();
    let (view, track) = (tracks.view().to_vec(), tracks.track().to_vec());
    Tracks::new(view, track, bearing, None, tracks.n_views(), tracks.n_tracks()).unwrap()
}

fn random_headings(n: usize, seed: u64) -> Vec<f64> {
    let mut noise = Noise::new(seed);
    (0..n).map(|_| std::f64::consts::TAU * noise.uniform()).collect()
}

fn world(kind: WorldKind, n_views: usize, n_points: usize, noise_deg: f64, outlier_fraction: f64) -> World<2> {
    let options = WorldOptions {
        n_views,
        n_points,
        seed: 1,
        noise_rad: noise_deg.to_radians(),
        outlier_fraction,
        orientations: Orientations::Random,
        ..WorldOptions::default()
    };
    simulate(kind, &options).unwrap()
}

#[test]
fn exact_bearings_give_exact_headings() {
    for (kind, n_views, n_points) in [
        (WorldKind::Box, 3, 7),
        (WorldKind::Box, 8, 12),
        (WorldKind::Street, 30, 400),
        (WorldKind::Room, 30, 300),
        (WorldKind::Chain, 30, 400),
    ] {
        let world = world(kind, n_views, n_points, 0.0, 0.0);
        let found = start_headings(&world.tracks, &HeadingOptions::default()).unwrap();
        assert_eq!(found.status, HeadingStatus::Converged, "{kind:?}");
        let worst = *errors(&found, &true_headings(&world), 0).last().unwrap();
        assert!(worst < 1e-6, "{kind:?}: {worst}");
    }
}

#[test]
fn half_a_degree_and_a_tenth_of_false_bearings_leave_a_start() {
    for (kind, n_views, n_points, bound_deg) in [
        (WorldKind::Box, 20, 60, 1.0),
        (WorldKind::Street, 50, 800, 1.5),
        (WorldKind::Room, 50, 600, 3.0),
        (WorldKind::Chain, 50, 800, 4.0),
        (WorldKind::StopAndGo, 40, 600, 1.5),
    ] {
        let world = world(kind, n_views, n_points, 0.5, 0.1);
        let found = start_headings(&world.tracks, &HeadingOptions::default()).unwrap();
        assert_eq!(found.status, HeadingStatus::Converged, "{kind:?}");
        let worst = errors(&found, &true_headings(&world), 0).last().unwrap().to_degrees();
        assert!(worst < bound_deg, "{kind:?}: {worst} degrees");
    }
}

#[test]
fn false_bearings_alone_orient_nothing() {
    let world = world(WorldKind::Box, 20, 20, 0.0, 1.0);
    let found = start_headings(&world.tracks, &HeadingOptions::default()).unwrap();
    let oriented = found.view_component.iter().filter(|&&c| c >= 0).count();
    assert!(oriented <= 4, "{oriented} of 20");
}

#[test]
fn views_on_one_line_are_oriented_to_the_root_of_the_noise() {
    // the misses grow with the square of a common bend of the headings: a weak start, but one
    let centers: Vec<Vector<2>> = (0..12).map(|k| [0.5 * f64::from(k), 0.0]).collect();
    let points = places::<2>(60, &[3.0, 0.0], 6.0, 2);
    let heading = random_headings(12, 3);
    let tracks = turned(&see(&centers, &points, all_pairs(12, 60)), &heading);
    let found = start_headings(&tracks, &HeadingOptions::default()).unwrap();
    assert_eq!(found.status, HeadingStatus::Converged);
    assert!(errors(&found, &heading, 0).last().unwrap().to_degrees() < 1.0);
}

#[test]
fn four_landmarks_are_enough_for_many_views() {
    let mut noise = Noise::new(4);
    let centers = places::<2>(25, &[0.0; 2], 3.0, 5);
    let points = vec![[4.0, 1.0], [-3.0, 5.0], [-2.0, -6.0], [5.0, -4.0]];
    let heading = random_headings(25, 6);
    let exact = turned(&see(&centers, &points, all_pairs(25, 4)), &heading);
    let found = start_headings(&exact, &HeadingOptions::default()).unwrap();
    assert_eq!((found.status, found.n_quads), (HeadingStatus::Converged, [1, 1]));
    assert!(*errors(&found, &heading, 0).last().unwrap() < 1e-6);
    // with noise, and with one view of false bearings
    let sigma = 0.2f64.to_radians();
    let jitter: Vec<Vector<2>> = exact
        .bearing()
        .iter()
        .zip(exact.view())
        .map(|(b, &v)| {
            Rotation::from_angle(if v == 7 { 6.0 * noise.uniform() } else { sigma * noise.normal() }).apply(b)
        })
        .collect();
    let noisy = Tracks::new(exact.view().to_vec(), exact.track().to_vec(), jitter, None, 25, 4).unwrap();
    let found = start_headings(&noisy, &HeadingOptions::default()).unwrap();
    let off = errors(&found, &heading, 0);
    assert!(off.len() >= 22 && off[off.len() / 2] < 10.0 * sigma, "{} views, {:?}", off.len(), off);
}

#[test]
fn two_clusters_without_a_common_track_stay_apart() {
    let (centers, points) = (places::<2>(16, &[0.0; 2], 2.0, 8), places::<2>(40, &[0.0; 2], 5.0, 9));
    let heading = random_headings(17, 10);
    // views 0-5 see the first 20 points, 6-15 the others; 16 sees nothing
    let seen = all_pairs(16, 40).filter(|(i, j)| (*i < 6) == (*j < 20));
    let mut all = centers.clone();
    all.push([0.0, 0.0]);
    let tracks = turned(&see(&all, &points, seen), &heading);
    let found = start_headings(&tracks, &HeadingOptions::default()).unwrap();
    assert_eq!(found.status, HeadingStatus::Disconnected);
    let wanted: Vec<i32> = [[1; 6].as_slice(), &[0; 10], &[-1]].concat();
    assert_eq!(found.view_component, wanted);
    assert!(found.heading_rad[16].is_nan());
    for component in [0, 1] {
        assert!(*errors(&found, &heading, component).last().unwrap() < 1e-6);
    }
}

#[test]
fn a_view_of_few_known_points_is_resected() {
    let (mut centers, points) = (places::<2>(8, &[0.0; 2], 2.0, 11), places::<2>(20, &[0.0; 2], 5.0, 12));
    centers.push([1.0, -2.5]);
    let heading = random_headings(9, 13);
    // the last view sees four points only: too few for a triplet
    let seen = all_pairs(9, 20).filter(|(i, j)| *i < 8 || *j % 5 == 0);
    let found = start_headings(&turned(&see(&centers, &points, seen), &heading), &HeadingOptions::default()).unwrap();
    assert_eq!(found.status, HeadingStatus::Converged);
    assert_eq!(found.resected, (0..9).map(|v| v == 8).collect::<Vec<_>>());
    assert!(*errors(&found, &heading, 0).last().unwrap() < 1e-6);
    // three points fix a view, but nothing checks them
    let seen = all_pairs(9, 20).filter(|(i, j)| *i < 8 || *j % 7 == 0);
    let tracks = turned(&see(&centers, &points, seen), &heading);
    let found = start_headings(&tracks, &HeadingOptions::default()).unwrap();
    assert_eq!((found.status, found.view_component[8]), (HeadingStatus::Disconnected, -1));
    let found = start_headings(&tracks, &HeadingOptions { min_points: 3, ..HeadingOptions::default() }).unwrap();
    assert_eq!(found.status, HeadingStatus::Converged);
    assert!(*errors(&found, &heading, 0).last().unwrap() < 1e-6);
}

#[test]
fn what_is_not_determined_is_not_oriented() {
    // two views give no constraint, nor do five points in three views without a sixth to check
    for (n, m) in [(0, 0), (1, 10), (2, 50), (3, 5)] {
        let (centers, points) = (places::<2>(n, &[0.0; 2], 2.0, 14), places::<2>(m, &[0.0; 2], 5.0, 15));
        let found = start_headings(&see(&centers, &points, all_pairs(n, m)), &HeadingOptions::default()).unwrap();
        assert_eq!(found.status, HeadingStatus::Undetermined, "{n} views, {m} points");
        assert!(found.heading_rad.iter().all(|h| h.is_nan()) && found.view_component == vec![-1; n]);
    }
    // all rays alike: points and views on one line
    let centers: Vec<Vector<2>> = (0..5).map(|k| [f64::from(k), 0.0]).collect();
    let points: Vec<Vector<2>> = (0..20).map(|k| [f64::from(k) - 10.5, 0.0]).collect();
    let found = start_headings(&see(&centers, &points, all_pairs(5, 20)), &HeadingOptions::default()).unwrap();
    assert_eq!(found.status, HeadingStatus::Undetermined);
}

#[test]
fn repeated_observations_count_once() {
    let world = world(WorldKind::Box, 5, 12, 0.0, 0.0);
    let t = &world.tracks;
    let twice = |ids: &[u32]| [ids, ids].concat();
    let bearing = [t.bearing(), t.bearing()].concat();
    let doubled = Tracks::new(twice(t.view()), twice(t.track()), bearing, None, 5, 12).unwrap();
    let solve = |tracks: &Tracks<2>| start_headings(tracks, &HeadingOptions::default()).unwrap().heading_rad;
    // the bearings differ by rounding: they were normalised twice
    assert!(solve(t).iter().zip(solve(&doubled)).all(|(a, b)| (a - b).abs() < 1e-12));
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let world = world(WorldKind::Street, 30, 400, 0.5, 0.1);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| start_headings(&world.tracks, &HeadingOptions::default()).unwrap())
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn unusable_options_are_named() {
    let world = world(WorldKind::Box, 5, 12, 0.0, 0.0);
    let message = |options| start_headings(&world.tracks, &options).unwrap_err().to_string();
    let base = HeadingOptions::default;
    assert_eq!(message(HeadingOptions { min_tracks: 5, ..base() }), "min_tracks is 5, expected at least 6");
    assert_eq!(message(HeadingOptions { triplets: 0, ..base() }), "triplets is 0, expected at least 1");
    assert_eq!(message(HeadingOptions { min_points: 2, ..base() }), "min_points is 2, expected at least 3");
    for noise in [0.0, -1.0, 1.0, f64::NAN] {
        assert!(message(HeadingOptions { noise_rad: Some(noise), ..base() }).starts_with("noise_rad is"));
    }
}
