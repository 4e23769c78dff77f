//! The consistency gate: right scenes pass; each kind of wrong one is found, and its members are named.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::*;
use panopath::consistency::{Consistency, ConsistencyError, ConsistencyOptions, Finding, check_consistency};
use panopath::geometry::{Rotation, add, norm, scale, sub};
use panopath::structure::{Status, Structure, Summary, Timings};
use panopath::synthetic::{Orientations, World, WorldKind, WorldOptions};
use panopath::tracks::Tracks;
use panopath::{PositionOptions, solve_positions};

/// The truth as a scene that uses all but the false bearings.
fn true_scene<const D: usize>(world: &World<D>) -> Structure<D> {
    Structure {
        centers: world.centers.clone(),
        points: world.points.clone(),
        view_component: vec![0; world.centers.len()],
        track_component: vec![0; world.points.len()],
        inlier: world.outlier.iter().map(|o| !o).collect(),
        residual_rad: vec![f64::NAN; world.tracks.len()],
        cam_from_world: world.cam_from_world.clone(),
        summary: Summary {
            status: Status::Converged,
            iterations: 0,
            sigma_rad: f64::NAN,
            n_components: 1,
            timings: Timings::default(),
        },
    }
}

fn check<const D: usize, const V: usize>(tracks: &Tracks<D>, scene: &Structure<D>) -> Consistency {
    check_consistency::<D, V>(tracks, scene, &ConsistencyOptions::default()).unwrap()
}

fn figure(found: &Consistency, name: &str) -> f64 {
    found.statistics.iter().find(|s| s.name == name).unwrap_or_else(|| panic!("no figure {name}")).value
}

fn sentences(found: &Consistency) -> Vec<String> {
    found.findings.iter().map(ToString::to_string).collect()
}

fn passes(found: &Consistency) {
    assert!(found.passed(), "{:?}", sentences(found));
    assert!(found.statistics.iter().all(|s| s.value.is_nan() || s.value <= s.limit), "{:?}", found.statistics);
}

fn turned(n_views: usize, n_points: usize, seed: u64) -> WorldOptions {
    WorldOptions { orientations: Orientations::Random, noise_rad: 0.05 * DEG, ..options(n_views, n_points, seed) }
}

fn solved<const D: usize>(world: &World<D>) -> Structure<D> {
    solve_positions(&world.tracks, Some(&world.cam_from_world), &PositionOptions::default()).unwrap()
}

#[test]
fn exact_scenes_pass() {
    for kind in [WorldKind::Street, WorldKind::Room, WorldKind::Chain, WorldKind::StopAndGo] {
        let world = simulate::<3>(kind, &options(40, 800, 1));
        passes(&check::<3, 6>(&world.tracks, &true_scene(&world)));
        let world = simulate::<2>(kind, &options(40, 800, 1));
        passes(&check::<2, 3>(&world.tracks, &true_scene(&world)));
    }
}

#[test]
fn noisy_scenes_with_false_bearings_pass() {
    for (kind, seed) in [(WorldKind::Street, 1), (WorldKind::Room, 2), (WorldKind::Chain, 3), (WorldKind::Line, 4)] {
        let world = simulate::<3>(kind, &WorldOptions { outlier_fraction: 0.3, ..turned(60, 2000, seed) });
        let found = check::<3, 6>(&world.tracks, &solved(&world));
        passes(&found);
        let noise = figure(&found, "noise_rad") / world.noise_rad;
        assert!((noise - 1.0).abs() < 0.05, "{noise}");
        assert!((figure(&found, "tension") - 1.0).abs() < 0.05, "{:?}", found.statistics);
    }
    let world = simulate::<3>(WorldKind::Street, &WorldOptions { infinity_fraction: 0.6, ..turned(60, 2000, 5) });
    passes(&check::<3, 6>(&world.tracks, &solved(&world)));
    let world = simulate::<2>(WorldKind::Street, &WorldOptions { outlier_fraction: 0.1, ..turned(60, 2000, 6) });
    passes(&check::<2, 3>(&world.tracks, &solved(&world)));
}

#[test]
fn figures_do_not_depend_on_the_frame() {
    let world = simulate::<3>(WorldKind::Street, &turned(40, 1000, 7));
    let scene = solved(&world);
    let moved_from_world = Rotation::exp(&[0.3, -1.0, 0.4]);
    let place = |x: &[f64; 3]| add(&scale(37.0, &moved_from_world.apply(x)), &[5.0, -600.0, 2.0]);
    let moved = Structure {
        centers: scene.centers.iter().map(place).collect(),
        points: scene.points.iter().map(place).collect(),
        cam_from_world: scene.cam_from_world.iter().map(|r| r.compose(&moved_from_world.inverse())).collect(),
        ..scene.clone()
    };
    let (one, other) = (check::<3, 6>(&world.tracks, &scene), check::<3, 6>(&world.tracks, &moved));
    for (a, b) in one.statistics.iter().zip(&other.statistics) {
        assert!((a.value - b.value).abs() <= 1e-6 * (1.0 + a.value.abs()), "{a:?} {b:?}");
    }
}

#[test]
fn at_the_truth_a_freedom_gains_one_unit_of_noise() {
    // nothing was fitted, so strain is an F statistic: its mean over scenes is next to one
    let strain: Vec<f64> = (0..8)
        .map(|seed| simulate::<3>(WorldKind::Box, &WorldOptions { noise_rad: 1e-3, ..options(10, 60, seed) }))
        .map(|world| figure(&check::<3, 6>(&world.tracks, &true_scene(&world)), "far_strain"))
        .collect();
    let mean = strain.iter().sum::<f64>() / strain.len() as f64;
    assert!((0.75..1.3).contains(&mean), "{strain:?}");
}

#[test]
fn a_view_out_of_place_is_named() {
    let world = simulate::<3>(WorldKind::Street, &turned(40, 2000, 8));
    let mut scene = true_scene(&world);
    scene.centers[20] = add(&scene.centers[20], &[0.02, 0.0, 0.01]);
    let found = check::<3, 6>(&world.tracks, &scene);
    let names = |f: &Finding| matches!(f, Finding::Strained { views, .. } if views.contains(&20));
    assert!(found.findings.iter().any(names), "{:?}", sentences(&found));
}

#[test]
fn a_mirrored_part_lies_behind_its_views() {
    let world = simulate::<3>(WorldKind::Street, &turned(40, 1000, 9));
    let mut scene = true_scene(&world);
    let pivot = scene.centers[0];
    for x in scene.centers.iter_mut().chain(&mut scene.points) {
        *x = sub(&pivot, &sub(x, &pivot));
    }
    let found = check::<3, 6>(&world.tracks, &scene);
    assert_eq!(figure(&found, "behind_share"), 1.0);
    let sentence = "the scene: 100 % of the observations that were used point away from their points (views 0 to 39)";
    assert!(sentences(&found).contains(&sentence.to_owned()), "{:?}", sentences(&found));
}

#[test]
fn a_run_of_turned_views_is_torn_from_the_rest() {
    let world = simulate::<3>(WorldKind::Street, &turned(80, 3000, 10));
    let mut orientations = world.cam_from_world.clone();
    let turn = Rotation::exp(&[0.1, 0.0, 0.0]);
    orientations[30..40].iter_mut().for_each(|r| *r = r.compose(&turn));
    let scene = solve_positions(&world.tracks, Some(&orientations), &PositionOptions::default()).unwrap();
    let found = check::<3, 6>(&world.tracks, &scene);
    let crosses = |f: &Finding| match f {
        Finding::Torn { first, second, share, elsewhere, .. } => {
            let inside = |views: &[u32]| views.iter().any(|i| (30..40).contains(i));
            share < elsewhere && (inside(first) || inside(second))
        }
        _ => false,
    };
    assert!(found.findings.iter().any(crosses), "{:?}", sentences(&found));
}

#[test]
fn a_rejected_look_alike_is_no_tear() {
    // bearings of tracks seen at one end of a chain, as if the other end had seen them too: rejected, and rightly
    let world = simulate::<3>(WorldKind::Chain, &turned(60, 4000, 11));
    let (mut view, mut track) = (world.tracks.view().to_vec(), world.tracks.track().to_vec());
    let mut bearing = world.tracks.bearing().to_vec();
    let mut scene = solved(&world);
    for o in (0..world.tracks.len()).filter(|&o| world.tracks.view()[o] < 5 && world.tracks.track()[o] % 5 == 0) {
        view.push(50 + world.tracks.view()[o]);
        track.push(world.tracks.track()[o]);
        bearing.push(scale(-1.0, &world.tracks.bearing()[o]));
        scene.inlier.push(false);
    }
    let tracks = Tracks::new(view, track, bearing, None, 60, 4000).unwrap();
    let found = check::<3, 6>(&tracks, &scene);
    assert_eq!(figure(&found, "torn_places"), 0.0, "{:?}", sentences(&found));
    passes(&found);
}

#[test]
fn a_tear_that_nothing_outweighs_is_found() {
    let world = simulate::<3>(WorldKind::Chain, &turned(60, 3000, 12));
    let mut scene = true_scene(&world);
    let (view, track) = (world.tracks.view(), world.tracks.track());
    // a track that crosses the middle keeps its first half only
    let mut crosses = vec![[false; 2]; world.points.len()];
    for o in 0..view.len() {
        crosses[track[o] as usize][usize::from(view[o] >= 30)] = true;
    }
    for o in (0..view.len()).filter(|&o| view[o] >= 30) {
        scene.inlier[o] &= !crosses[track[o] as usize][0] || track[o] % 40 == 0;
    }
    let found = check::<3, 6>(&world.tracks, &scene);
    let across = |f: &Finding| match f {
        Finding::Torn { first, second, share, elsewhere, .. } => {
            let has = |i: u32| first.contains(&i) || second.contains(&i);
            has(29) && has(30) && share < elsewhere
        }
        _ => false,
    };
    assert!(found.findings.iter().any(across), "{:?}", sentences(&found));
}

#[test]
fn a_tear_that_the_sky_bridges_is_found() {
    // the second half of a street is stretched: near points fit one half only, far ones fit both
    let world = simulate::<3>(WorldKind::Street, &WorldOptions { infinity_fraction: 0.6, ..turned(60, 2000, 5) });
    let right = solved(&world);
    passes(&check::<3, 6>(&world.tracks, &right));
    let hinge = right.centers[30];
    let stretched = |x: &[f64; 3]| add(&hinge, &scale(2.0, &sub(x, &hinge)));
    let mut torn = right.clone();
    (30..60).for_each(|i| torn.centers[i] = stretched(&right.centers[i]));
    let mut n_seen = vec![[0, 0]; torn.points.len()];
    for (o, (&i, &j)) in world.tracks.view().iter().zip(world.tracks.track()).enumerate() {
        n_seen[j as usize][usize::from(i >= 30)] += usize::from(right.inlier[o]);
    }
    let extent = right.centers.iter().map(|c| norm(&sub(c, &hinge))).fold(0.0, f64::max);
    let is_far: Vec<bool> = right.points.iter().map(|x| norm(&sub(x, &hinge)) > 50.0 * extent).collect();
    assert!(is_far.iter().filter(|&&far| far).count() > 500);
    for j in (0..torn.points.len()).filter(|&j| !is_far[j]) {
        if n_seen[j][1] > n_seen[j][0] {
            torn.points[j] = stretched(&right.points[j]);
        }
    }
    for (o, (&i, &j)) in world.tracks.view().iter().zip(world.tracks.track()).enumerate() {
        let seen = n_seen[j as usize];
        torn.inlier[o] &= is_far[j as usize] || (i >= 30) == (seen[1] > seen[0]);
    }
    let found = check::<3, 6>(&world.tracks, &torn);
    assert!(figure(&found, "torn_places") >= 1.0, "{:?}", sentences(&found));
}

#[test]
fn views_left_out_though_they_see_the_scene_are_named() {
    let world = simulate::<3>(WorldKind::Chain, &turned(60, 3000, 22));
    let mut scene = true_scene(&world);
    for i in 20..40 {
        scene.centers[i] = [f64::NAN; 3];
        scene.view_component[i] = -1;
    }
    let found = check::<3, 6>(&world.tracks, &scene);
    assert_eq!(figure(&found, "unplaced_share"), 20.0 / 60.0);
    let sentence = "views 20 to 39 see much of the scene, yet found no place in it".to_owned();
    assert!(sentences(&found).contains(&sentence), "{:?}", sentences(&found));
}

#[test]
fn views_that_nothing_ties_are_named() {
    let world = simulate::<3>(WorldKind::Weak, &options(20, 400, 13));
    let mut scene = true_scene(&world);
    let links = world.points.len() as u32 - 4;
    for o in 0..world.tracks.len() {
        scene.inlier[o] = world.tracks.track()[o] < links;
    }
    let found = check::<3, 6>(&world.tracks, &scene);
    assert_eq!(figure(&found, "untied_views"), 10.0);
    let named = sentences(&found).iter().any(|s| s.starts_with("the scene: no observation that was used ties views "));
    assert!(named, "{:?}", sentences(&found));
}

#[test]
fn parts_that_few_scattered_tracks_join_are_torn_by_all_of_them() {
    let world = simulate::<3>(WorldKind::Weak, &WorldOptions { n_links: Some(16), ..options(40, 800, 23) });
    let mut scene = true_scene(&world);
    let links = world.points.len() as u32 - 16;
    for o in 0..world.tracks.len() {
        scene.inlier[o] = world.tracks.track()[o] < links + 3;
    }
    let found = check::<3, 6>(&world.tracks, &scene);
    let Some(Finding::Torn { first, second, shared: 16, .. }) = found.findings.first() else {
        panic!("{:?}", sentences(&found))
    };
    assert_eq!((first.len(), second.len()), (20, 20));
}

#[test]
fn tracks_that_fit_nowhere_are_counted() {
    let world = simulate::<3>(WorldKind::Street, &WorldOptions { mover_fraction: 0.5, ..turned(40, 1000, 14) });
    let found = check::<3, 6>(&world.tracks, &true_scene(&world));
    assert!((figure(&found, "lost_share") - 0.5).abs() < 0.05, "{:?}", found.statistics);
    assert!(sentences(&found).iter().any(|s| s.contains("fit nowhere")), "{:?}", sentences(&found));
}

#[test]
fn noise_is_held_against_the_sigma_of_the_tracks() {
    let world = simulate::<3>(WorldKind::Street, &turned(40, 1000, 15));
    let scene = solved(&world);
    let claim = |factor: f64| {
        let sigma = (0..world.tracks.len()).map(|o| world.noise_rad * factor * if o % 2 == 0 { 1.0 } else { 0.999 });
        let t = &world.tracks;
        let told =
            Tracks::new(t.view().to_vec(), t.track().to_vec(), t.bearing().to_vec(), Some(sigma.collect()), 40, 1000);
        check::<3, 6>(&told.unwrap(), &scene)
    };
    passes(&claim(1.0));
    assert!((figure(&claim(1.0), "noise_over_given") - 1.0).abs() < 0.05);
    let found = claim(0.5);
    assert!(
        found.findings.iter().any(|f| matches!(f, Finding::NoiseOverGiven { ratio, .. } if (ratio - 2.0).abs() < 0.1))
    );
}

#[test]
fn misfits_are_counted() {
    let world = simulate::<3>(WorldKind::Street, &WorldOptions { outlier_fraction: 0.1, ..turned(40, 1000, 16) });
    let mut scene = true_scene(&world);
    scene.inlier.fill(true);
    let found = check::<3, 6>(&world.tracks, &scene);
    assert!((figure(&found, "misfit_share") - 0.1).abs() < 0.01, "{:?}", found.statistics);
    assert!(found.findings.iter().any(|f| matches!(f, Finding::Misfits { .. })));
}

#[test]
fn a_scene_without_anything_passes() {
    let world = simulate::<3>(WorldKind::Street, &options(10, 50, 17));
    let nothing = Structure {
        centers: vec![[f64::NAN; 3]; 10],
        points: vec![[f64::NAN; 3]; 50],
        view_component: vec![-1; 10],
        track_component: vec![-1; 50],
        inlier: vec![false; world.tracks.len()],
        ..true_scene(&world)
    };
    passes(&check::<3, 6>(&world.tracks, &nothing));
    let empty = Tracks::<3>::new(Vec::new(), Vec::new(), Vec::new(), None, 0, 0).unwrap();
    let no_views = Structure {
        centers: Vec::new(),
        points: Vec::new(),
        view_component: Vec::new(),
        track_component: Vec::new(),
        inlier: Vec::new(),
        cam_from_world: Vec::new(),
        ..nothing
    };
    passes(&check::<3, 6>(&empty, &no_views));
}

#[test]
fn unknown_and_degenerate_members_are_left_out() {
    let world = simulate::<3>(WorldKind::Street, &turned(40, 1000, 18));
    let mut scene = true_scene(&world);
    scene.points[3] = [f64::NAN; 3];
    scene.points[4] = [f64::INFINITY, 0.0, 0.0];
    scene.points[5] =
        scene.centers[world.tracks.view()[world.tracks.track().iter().position(|&j| j == 5).unwrap()] as usize];
    scene.centers[7] = [f64::NAN; 3];
    scene.view_component[8] = -1;
    let found = check::<3, 6>(&world.tracks, &scene);
    assert!(found.statistics.iter().all(|s| s.value.is_finite()), "{:?}", found.statistics);
    assert_eq!(figure(&found, "torn_places"), 0.0);
}

#[test]
fn a_track_seen_twice_by_a_view_counts_twice() {
    let world = simulate::<3>(WorldKind::Street, &turned(20, 600, 19));
    let t = &world.tracks;
    let twice = |ids: &[u32]| [ids, ids].concat();
    let bearing = [t.bearing(), t.bearing()].concat();
    let tracks = Tracks::new(twice(t.view()), twice(t.track()), bearing, None, 20, 600).unwrap();
    let mut scene = true_scene(&world);
    scene.inlier = [scene.inlier.clone(), scene.inlier].concat();
    let (once, twice) = (check::<3, 6>(t, &true_scene(&world)), check::<3, 6>(&tracks, &scene));
    // every equation twice: what a window gains doubles, and its noise grows with the equations that are left over
    for name in ["near_strain", "far_strain"] {
        let ratio = figure(&twice, name) / figure(&once, name);
        assert!((1.2..4.0).contains(&ratio), "{name} {ratio}");
    }
}

#[test]
fn the_answer_does_not_depend_on_threads() {
    let world = simulate::<3>(WorldKind::Street, &WorldOptions { outlier_fraction: 0.2, ..turned(80, 3000, 20) });
    let scene = solved(&world);
    let on = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| check::<3, 6>(&world.tracks, &scene))
    };
    let one = on(1);
    assert!([2, 5].into_iter().all(|n| on(n) == one));
}

#[test]
fn what_cannot_be_used_is_named() {
    let world = simulate::<3>(WorldKind::Street, &options(10, 50, 21));
    let mut scene = true_scene(&world);
    let limits = ConsistencyOptions { max_tension: f64::NAN, ..Default::default() };
    let error = check_consistency::<3, 6>(&world.tracks, &scene, &limits).unwrap_err();
    assert_eq!(error.to_string(), "max_tension is NaN, expected a number above 0");
    scene.inlier.pop();
    let error = check_consistency::<3, 6>(&world.tracks, &scene, &ConsistencyOptions::default()).unwrap_err();
    assert!(matches!(error, ConsistencyError::Length { name: "inlier", .. }), "{error}");
}
