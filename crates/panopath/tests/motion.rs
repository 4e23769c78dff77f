//! Mean motion: exact on turns, right about wrap and poles, steady against outliers, silent where nothing is known.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{Noise, all_pairs, places, see};
use panopath::geometry::*;
use panopath::motion::{
    Flow, Motion, MotionError, MotionOptions, MotionStatus, Vertical, Weighting, fit_rotations, mean_motion,
};
use panopath::synthetic::{Orientations, WorldKind, WorldOptions, simulate};
use panopath::{Rotation, Tracks, solve_positions};

/// What turned cameras see of fixed directions, every view all of them.
fn turned<const D: usize>(cam_from_world: &[Rotation<D>], directions: &[Vector<D>]) -> Tracks<D> {
    let (n, m) = (cam_from_world.len(), directions.len());
    let (view, track): (Vec<u32>, Vec<u32>) = all_pairs(n, m).map(|(i, j)| (i as u32, j as u32)).unzip();
    let bearing = all_pairs(n, m).map(|(i, j)| cam_from_world[i].apply(&directions[j])).collect();
    Tracks::new(view, track, bearing, None, n, m).unwrap()
}

/// Bearings of a world of identical orientations, as cameras turned by `cam_from_world` see them.
fn seen_by<const D: usize>(tracks: &Tracks<D>, cam_from_world: &[Rotation<D>]) -> Tracks<D> {
    let bearing =
        tracks.view().iter().zip(tracks.bearing()).map(|(&v, b)| cam_from_world[v as usize].apply(b)).collect();
    let (view, track) = (tracks.view().to_vec(), tracks.track().to_vec());
    Tracks::new(view, track, bearing, None, tracks.n_views(), tracks.n_tracks()).unwrap()
}

fn planar(angles: impl IntoIterator<Item = f64>) -> Vec<Rotation<2>> {
    angles.into_iter().map(Rotation::from_angle).collect()
}

/// Rotations that start at the identity, each step within `largest` per axis.
fn wander(n: usize, largest: f64, seed: u64) -> Vec<Rotation<3>> {
    let mut noise = Noise::new(seed);
    let mut cam = Rotation::identity();
    let mut all = vec![cam];
    while all.len() < n {
        cam = Rotation::exp(&std::array::from_fn(|_| largest * (2.0 * noise.uniform() - 1.0))).compose(&cam);
        all.push(cam);
    }
    all
}

fn distance<const D: usize>(a: &Rotation<D>, b: &Rotation<D>) -> f64 {
    let entries = a.matrix().iter().flatten().zip(b.matrix().iter().flatten());
    let chord = entries.map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt();
    2.0 * (chord / 8f64.sqrt()).min(1.0).asin()
}

/// Largest angle between found and true orientations after the first view is laid on the truth.
fn worst<const D: usize>(motion: &Motion<D>, truth: &[Rotation<D>]) -> f64 {
    let world_from_map = truth[0].inverse().compose(&motion.cam_from_world[0].unwrap());
    let errors = motion
        .cam_from_world
        .iter()
        .zip(truth)
        .map(|(found, truth)| distance(&found.expect("every view is oriented"), &truth.compose(&world_from_map)));
    errors.fold(0.0, f64::max)
}

const WEIGHTINGS: [Weighting; 3] = [Weighting::Mean, Weighting::Robust, Weighting::Slowest { share: 0.5 }];

fn directions<const D: usize>(n: usize, seed: u64) -> Vec<Vector<D>> {
    let mut noise = Noise::new(seed);
    (0..n).map(|_| noise.direction()).collect()
}

#[test]
fn pure_turns_are_exact() {
    for weighting in WEIGHTINGS {
        let options = MotionOptions { weighting, ..MotionOptions::default() };
        // steps up to half a turn and many windings: nothing depends on a turn being small
        let truth = wander(40, 1.5, 1);
        let motion = mean_motion(&turned(&truth, &directions(12, 2)), &options).unwrap();
        assert!(worst(&motion, &truth) < 1e-13, "{weighting:?}: {}", worst(&motion, &truth));
        assert_eq!(motion.status, MotionStatus::Converged);
        assert!(motion.steps.iter().all(|s| s.residual_rad < 1e-14 && s.turn_sigma_rad < 1e-13));

        let truth = planar((0..40).map(|k| 0.9 * f64::from(k)));
        for flow in [Flow::Sphere, Flow::Horizon] {
            let options = MotionOptions { flow, ..options.clone() };
            let motion = mean_motion(&turned(&truth, &directions(12, 3)), &options).unwrap();
            assert!(worst(&motion, &truth) < 1e-13, "{weighting:?} {flow:?}: {}", worst(&motion, &truth));
        }
    }
}

#[test]
fn angles_wrap() {
    // a track at every azimuth, so that at each step some cross +-pi, and turns of nearly half a circle
    for turn in [0.1, -0.1, 3.1, -3.1, std::f64::consts::PI] {
        let truth = planar((0..9).map(|k| turn * f64::from(k)));
        let all_round: Vec<Vector<2>> =
            (0..72).map(|k| f64::from(k).to_radians() * 5.0).map(|a| [a.cos(), a.sin()]).collect();
        for (flow, weighting) in [Flow::Sphere, Flow::Horizon].into_iter().flat_map(|f| WEIGHTINGS.map(|w| (f, w))) {
            let options = MotionOptions { flow, weighting, ..MotionOptions::default() };
            let motion = mean_motion(&turned(&truth, &all_round), &options).unwrap();
            assert!(worst(&motion, &truth) < 1e-12, "turn {turn}, {flow:?}, {weighting:?}");
        }
    }
}

#[test]
fn poles_are_no_special_places() {
    let mut about_poles = directions::<3>(10, 4);
    for (k, d) in about_poles.iter_mut().enumerate() {
        let side = if k % 2 == 0 { 1.0 } else { -1.0 };
        *d = normalized(&[0.01 * d[0], 0.01 * d[1], side]);
    }
    about_poles.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]);
    let truth = wander(20, 0.3, 5);
    let motion = mean_motion(&turned(&truth, &about_poles), &MotionOptions::default()).unwrap();
    assert!(worst(&motion, &truth) < 1e-11, "{}", worst(&motion, &truth));
}

#[test]
fn a_limited_field_is_enough_for_an_exact_turn() {
    let truth = wander(20, 0.05, 6);
    for half_width in [0.3, 0.02] {
        let ahead: Vec<Vector<3>> = places::<3>(15, &[0.0, 0.0, 1.0], half_width, 7).iter().map(normalized).collect();
        let motion = mean_motion(&turned(&truth, &ahead), &MotionOptions::default()).unwrap();
        assert!(worst(&motion, &truth) < 1e-10 / half_width, "{half_width}: {}", worst(&motion, &truth));
    }
}

#[test]
fn horizon_flow_is_first_order_right_near_the_horizon() {
    let mut low = directions::<3>(60, 8);
    for d in &mut low {
        *d = normalized(&[d[0], d[1], 0.05 * d[2]]);
    }
    for (size, bound) in [(1e-2, 1e-3), (1e-3, 1e-5)] {
        let truth = wander(2, size, 9);
        let options = MotionOptions { flow: Flow::Horizon, weighting: Weighting::Mean, ..MotionOptions::default() };
        let motion = mean_motion(&turned(&truth, &low), &options).unwrap();
        // relative error: the elevations near 0.05 enter in the next order
        assert!(worst(&motion, &truth) < bound, "{size}: {}", worst(&motion, &truth));
    }
    // a turn about z alone is exact
    let truth: Vec<Rotation<3>> = (0..10).map(|k| Rotation::exp(&[0.0, 0.0, 0.7 * f64::from(k)])).collect();
    let options = MotionOptions { flow: Flow::Horizon, ..MotionOptions::default() };
    assert!(worst(&mean_motion(&turned(&truth, &low), &options).unwrap(), &truth) < 1e-12);
}

#[test]
fn known_gravity_leaves_the_turn_about_it() {
    let mut noise = Noise::new(10);
    let upright: Vec<Rotation<3>> = (0..15).map(|k| Rotation::exp(&[0.0, 0.0, 0.4 * f64::from(k)])).collect();
    let stars = directions::<3>(12, 11);
    for flow in [Flow::Sphere, Flow::Horizon] {
        let options = MotionOptions { vertical: Vertical::Upright, flow, ..MotionOptions::default() };
        let motion = mean_motion(&turned(&upright, &stars), &options).unwrap();
        assert!(worst(&motion, &upright) < 1e-13);
        assert_eq!(motion.cam_from_world[0], Some(Rotation::identity()));
    }
    // tilted at random, upside down included
    let mut tilted: Vec<Rotation<3>> =
        upright.iter().map(|cam| Rotation::exp(&std::array::from_fn(|_| 2.0 * noise.normal())).compose(cam)).collect();
    tilted[3] = Rotation::exp(&[std::f64::consts::PI, 0.0, 0.0]).compose(&upright[3]);
    let up: Vec<Vector<3>> = tilted.iter().map(|cam| scale(3.0, &cam.apply(&[0.0, 0.0, 1.0]))).collect();
    let options = MotionOptions { vertical: Vertical::Up(up.clone()), ..MotionOptions::default() };
    let motion = mean_motion(&turned(&tilted, &stars), &options).unwrap();
    assert!(worst(&motion, &tilted) < 1e-12, "{}", worst(&motion, &tilted));
    for (cam, up) in motion.cam_from_world.iter().zip(&up) {
        let vertical = cam.unwrap().apply(&[0.0, 0.0, 1.0]);
        assert!(norm(&sub(&vertical, &normalized(up))) < 1e-12, "the world's z is up in every camera");
    }
    // one line of sight fixes the turn about a known vertical, and nothing without it
    let one = turned(&upright, &stars[..1]);
    let few = MotionOptions { min_tracks: 1, ..MotionOptions::default() };
    assert_eq!(mean_motion(&one, &few).unwrap().status, MotionStatus::Undetermined);
    let motion = mean_motion(&one, &MotionOptions { vertical: Vertical::Upright, ..few }).unwrap();
    assert!(worst(&motion, &upright) < 1e-12);
}

fn far_world<const D: usize>(noise_rad: f64, outlier_fraction: f64) -> panopath::synthetic::World<D> {
    let options = WorldOptions {
        n_views: 30,
        n_points: 600,
        seed: 3,
        noise_rad,
        outlier_fraction,
        spacing_m: Some(1e-3),
        wobble_m: Some(0.0),
        ..WorldOptions::default()
    };
    simulate(WorldKind::Street, &options).unwrap()
}

#[test]
fn noise_is_averaged_and_false_bearings_are_left_out() {
    let noise_rad = 1e-3;
    let truth = wander(30, 0.2, 12);
    for outlier_fraction in [0.0, 0.3] {
        let tracks = seen_by(&far_world::<3>(noise_rad, outlier_fraction).tracks, &truth);
        let motion = mean_motion(&tracks, &MotionOptions::default()).unwrap();
        let error = worst(&motion, &truth);
        // about 100 common tracks a step, 29 steps: noise * sqrt(2) / sqrt(100) * sqrt(29) is 0.8 of it; parallax adds
        assert!(error < 3.0 * noise_rad, "{outlier_fraction}: {error}");
        let mean = MotionOptions { weighting: Weighting::Mean, ..MotionOptions::default() };
        if outlier_fraction > 0.0 {
            assert!(worst(&mean_motion(&tracks, &mean).unwrap(), &truth) > 10.0 * noise_rad);
        }
        let truth = planar((0..30).map(|k| 0.3 * f64::from(k)));
        let tracks = seen_by(&far_world::<2>(noise_rad, outlier_fraction).tracks, &truth);
        let error = worst(&mean_motion(&tracks, &MotionOptions::default()).unwrap(), &truth);
        assert!(error < 3.0 * noise_rad, "plane, {outlier_fraction}: {error}");
    }
}

#[test]
fn the_stated_deviation_covers_noise() {
    let truth = wander(30, 0.2, 13);
    let tracks = seen_by(&far_world::<3>(1e-3, 0.0).tracks, &truth);
    let options = MotionOptions { weighting: Weighting::Mean, ..MotionOptions::default() };
    let motion = mean_motion(&tracks, &options).unwrap();
    let mut ratio = 0.0;
    for step in &motion.steps {
        let (from, to) = (step.from as usize, step.to as usize);
        let error = distance(&step.turn.unwrap(), &truth[to].compose(&truth[from].inverse()));
        ratio += (error / step.turn_sigma_rad).powi(2) / motion.steps.len() as f64;
    }
    // three axes, each at most as uncertain as the one stated
    assert!((0.8..4.5).contains(&ratio), "{ratio}");
}

#[test]
fn leaving_near_points_out_removes_their_bias() {
    // far points all round, near ones on one side: two fifths of all, none in the way of the median
    let mut points = directions::<3>(60, 14).iter().map(|d| scale(1e4, d)).collect::<Vec<_>>();
    points.extend(places::<3>(40, &[0.0, 4.0, 0.0], 1.5, 15));
    let centers: Vec<Vector<3>> = (0..20).map(|k| [0.1 * f64::from(k) - 1.0, 0.0, 0.0]).collect();
    let truth = wander(20, 0.1, 16);
    let tracks = seen_by(&see(&centers, &points, all_pairs(20, 100)), &truth);
    let error = |weighting| {
        let options = MotionOptions { weighting, ..MotionOptions::default() };
        worst(&mean_motion(&tracks, &options).unwrap(), &truth)
    };
    assert!(error(Weighting::Mean) > 0.1, "{}", error(Weighting::Mean));
    assert!(error(Weighting::Slowest { share: 0.5 }) < 1e-3, "{}", error(Weighting::Slowest { share: 0.5 }));
    assert!(error(Weighting::Robust) < 1e-3, "{}", error(Weighting::Robust));
}

#[test]
fn fine_tuning_removes_the_bias_of_parallax() {
    // the paper's loop: mean motion, positions, orientations again, and so on
    let centers = places::<3>(8, &[0.0; 3], 0.3, 17);
    let points = places::<3>(60, &[0.0, 0.0, 0.0], 4.0, 18);
    let truth = wander(8, 0.2, 19);
    let tracks = seen_by(&see(&centers, &points, all_pairs(8, 60)), &truth);
    let motion = mean_motion(&tracks, &MotionOptions::default()).unwrap();
    let before = worst(&motion, &truth);
    let mut cams: Vec<Rotation<3>> = motion.cam_from_world.iter().map(|r| r.unwrap()).collect();
    for _ in 0..60 {
        let scene = solve_positions(&tracks, Some(&cams), &Default::default()).unwrap();
        cams = fit_rotations(&tracks, &scene.centers, &scene.points, &cams, Weighting::Robust).unwrap();
    }
    let after = worst(&Motion { cam_from_world: cams.into_iter().map(Some).collect(), ..motion }, &truth);
    assert!(after < 0.2 * before, "{before} -> {after}");
}

#[test]
fn rotations_are_fitted_exactly_to_exact_points() {
    let centers = places::<3>(6, &[0.0; 3], 1.0, 20);
    let points = places::<3>(20, &[0.0; 3], 3.0, 21);
    let truth = wander(6, 2.0, 22);
    let tracks = seen_by(&see(&centers, &points, all_pairs(6, 20)), &truth);
    let unknown = vec![Rotation::identity(); 6];
    for weighting in WEIGHTINGS {
        let found = fit_rotations(&tracks, &centers, &points, &unknown, weighting).unwrap();
        assert!(found.iter().zip(&truth).all(|(a, b)| distance(a, b) < 1e-13), "{weighting:?}");
    }
    // a view of unknown place keeps what it has
    let mut lost = centers.clone();
    lost[2] = [f64::NAN; 3];
    let found = fit_rotations(&tracks, &lost, &points, &unknown, Weighting::Robust).unwrap();
    assert!(found[2] == Rotation::identity() && distance(&found[1], &truth[1]) < 1e-13);
    let error = fit_rotations(&tracks, &lost[..5], &points, &unknown, Weighting::Robust).unwrap_err();
    assert_eq!(error.to_string(), "centers has 5 rows, expected 6");
}

#[test]
fn what_is_not_shared_breaks_the_chain() {
    // views 0-3 see tracks 0-9, views 4-9 see tracks 10-19, view 10 nothing
    let truth = wander(11, 0.3, 23);
    let stars = directions::<3>(20, 24);
    let whole = turned(&truth, &stars);
    let keep = |o: &usize| match whole.view()[*o] {
        0..4 => whole.track()[*o] < 10,
        4..10 => whole.track()[*o] >= 10,
        _ => false,
    };
    let kept: Vec<usize> = (0..whole.len()).filter(keep).collect();
    let pick = |ids: &[u32]| kept.iter().map(|&o| ids[o]).collect::<Vec<_>>();
    let bearing = kept.iter().map(|&o| whole.bearing()[o]).collect();
    let tracks = Tracks::new(pick(whole.view()), pick(whole.track()), bearing, None, 11, 20).unwrap();
    let motion = mean_motion(&tracks, &MotionOptions::default()).unwrap();
    assert_eq!(motion.status, MotionStatus::Disconnected);
    assert_eq!(motion.view_component, [1, 1, 1, 1, 0, 0, 0, 0, 0, 0, -1]);
    assert_eq!(motion.cam_from_world[4], Some(Rotation::identity()));
    assert!(motion.cam_from_world[10].is_none());
    assert!(motion.steps[3].turn.is_none() && motion.steps[3].residual_rad.is_nan() && motion.steps[3].n_common == 0);
    assert!(distance(&motion.cam_from_world[9].unwrap(), &truth[9].compose(&truth[4].inverse())) < 1e-12);
}

#[test]
fn directions_on_one_line_fix_no_turn_of_space() {
    let truth = wander(3, 0.3, 25);
    let line = vec![[0.0, 0.6, 0.8], [0.0, -0.6, -0.8], [0.0, 0.6, 0.8], [0.0, 0.6, 0.8]];
    let motion = mean_motion(&turned(&truth, &line), &MotionOptions::default()).unwrap();
    assert_eq!(motion.status, MotionStatus::Undetermined);
    assert!(motion.cam_from_world.iter().all(Option::is_none) && motion.view_component == [-1, -1, -1]);
    // two different lines do
    let motion = mean_motion(&turned(&truth, &[line[0], line[1], [1.0, 0.0, 0.0]]), &MotionOptions::default()).unwrap();
    assert!(worst(&motion, &truth) < 1e-12);
}

#[test]
fn times_order_the_views() {
    let truth = wander(6, 0.3, 26);
    let taken = [3usize, 0, 5, 1, 4, 2]; // view k was taken as number taken[k]
    let shuffled: Vec<Rotation<3>> = taken.iter().map(|&k| truth[k]).collect();
    let mut time_s: Vec<f64> = taken.iter().map(|&k| 0.5 * k as f64).collect();
    let tracks = turned(&shuffled, &directions(8, 27));
    let motion =
        mean_motion(&tracks, &MotionOptions { time_s: Some(time_s.clone()), ..MotionOptions::default() }).unwrap();
    assert_eq!(motion.steps.iter().map(|s| s.from).collect::<Vec<_>>(), [1, 3, 5, 0, 4]);
    assert!(motion.steps.iter().all(|s| s.interval_s == 0.5));
    assert_eq!(motion.cam_from_world[1], Some(Rotation::identity()));
    assert!(worst(&motion, &shuffled) < 1e-13);
    time_s[3] = f64::NAN;
    let motion = mean_motion(&tracks, &MotionOptions { time_s: Some(time_s), ..MotionOptions::default() }).unwrap();
    assert_eq!((motion.steps.len(), motion.view_component[3], motion.status), (4, -1, MotionStatus::Disconnected));
}

#[test]
fn repeated_and_few_observations_are_ordinary() {
    let truth = wander(3, 0.3, 28);
    let stars = directions::<3>(5, 29);
    let whole = turned(&truth, &stars);
    let twice = |ids: &[u32]| [ids, ids].concat();
    let bearing = [whole.bearing(), whole.bearing()].concat();
    let doubled = Tracks::new(twice(whole.view()), twice(whole.track()), bearing, None, 3, 5).unwrap();
    let motion = mean_motion(&doubled, &MotionOptions::default()).unwrap();
    assert!(worst(&motion, &truth) < 1e-13 && motion.steps[0].n_common == 5);
    for n in [0, 1, 2] {
        let nothing = Tracks::<3>::new(vec![], vec![], vec![], None, n, 0).unwrap();
        let motion = mean_motion(&nothing, &MotionOptions::default()).unwrap();
        assert_eq!((motion.status, motion.view_component), (MotionStatus::Undetermined, vec![-1; n]));
    }
}

#[test]
fn unusable_options_are_named() {
    let tracks = turned(&wander(3, 0.3, 30), &directions(5, 31));
    let message = |options: MotionOptions| mean_motion(&tracks, &options).unwrap_err().to_string();
    let base = MotionOptions::default;
    assert_eq!(message(MotionOptions { time_s: Some(vec![0.0; 2]), ..base() }), "time_s has 2 rows, expected 3");
    let up = |up: Vec<Vector<3>>| MotionOptions { vertical: Vertical::Up(up), ..base() };
    assert_eq!(message(up(vec![[0.0, 0.0, 1.0]; 2])), "up has 2 rows, expected 3");
    let mut one_wrong = vec![[0.0, 0.0, 1.0]; 3];
    for bad in [[0.0; 3], [f64::NAN, 0.0, 0.0], [f64::INFINITY, 0.0, 0.0]] {
        one_wrong[1] = bad;
        assert!(message(up(one_wrong.clone())).starts_with("up[1] has length"));
    }
    for share in [0.0, -1.0, 1.5, f64::NAN] {
        let weighting = Weighting::Slowest { share };
        assert!(message(MotionOptions { weighting, ..base() }).starts_with("share is"));
    }
    assert!(message(MotionOptions { min_tracks: 0, ..base() }).starts_with("min_tracks is 0"));
    let planar = turned(&planar([0.0, 0.1]), &directions(5, 32));
    let upright = MotionOptions { vertical: Vertical::Upright, ..base() };
    assert!(matches!(mean_motion(&planar, &upright), Err(MotionError::Option(_))));
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    let options = WorldOptions {
        n_views: 50,
        n_points: 500,
        seed: 1,
        noise_rad: 1e-3,
        outlier_fraction: 0.2,
        orientations: Orientations::Random,
        ..WorldOptions::default()
    };
    let tracks = simulate::<3>(WorldKind::Street, &options).unwrap().tracks;
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| mean_motion(&tracks, &MotionOptions::default()).unwrap())
    };
    assert_eq!(on(1).cam_from_world, on(3).cam_from_world);
}
