//! Batches of small worlds: exact data come back, answers are those of the solver, on any number of threads.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

use panopath::geometry::{Vector, norm, sub};
use panopath::positions::{LinearForm, LinearGauge, Method, PositionOptions, Status, solve_positions};
use panopath::synthetic::{WorldKind, WorldOptions, simulate};
use panopath::trials::{Alignment, Outcome, Trial, TrialError, run_trials};

const PAPER: Method = Method::Linear { form: LinearForm::TwoStage { vertical_axis: 2 }, gauge: LinearGauge::Paper };
const METHODS: [Method; 2] = [PAPER, Method::Robust];

fn trial(n_views: usize, n_points: usize, seed: u64, angle_error_rad: f64) -> Trial {
    Trial { n_views, n_points, seed, angle_error_rad }
}

#[test]
fn exact_worlds_come_back_exactly_in_every_frame() {
    let trials: Vec<Trial> = (0..4).map(|seed| trial(4 + seed as usize, 12, seed, 0.0)).collect();
    for outcome in run_trials::<3>(&trials, &METHODS).unwrap().iter().flatten() {
        assert_eq!((outcome.status, outcome.n_missing), (Status::Converged, 0));
        assert!(outcome.deviations.iter().all(|d| d.max < 1e-8), "{outcome:?}");
        assert!(outcome.refilmed.max_rad < 1e-9 && outcome.refilmed.residual_max_rad < 1e-9);
    }
    let joint = Method::Linear { form: LinearForm::Joint, gauge: LinearGauge::PaperDistance };
    for outcome in run_trials::<2>(&trials, &[joint, Method::Robust]).unwrap().iter().flatten() {
        assert!(outcome.deviations.iter().all(|d| d.max < 1e-8), "{outcome:?}");
    }
}

#[test]
fn what_is_told_is_what_the_solver_answers() {
    let chosen = trial(6, 15, 3, 0.02);
    let outcome = run_trials::<3>(&[chosen], &METHODS).unwrap()[0][1];
    let options = WorldOptions { n_views: 6, n_points: 15, seed: 3, angle_error_rad: 0.02, ..Default::default() };
    let world = simulate::<3>(WorldKind::Box, &options).unwrap();
    let scene = solve_positions(&world.tracks, None, &PositionOptions::default()).unwrap();
    let residual = scene.residual_rad.iter().fold(0.0, |most: f64, r| most.max(*r));
    assert!((outcome.refilmed.residual_max_rad - residual).abs() < 1e-12);
    // the paper's frame, written out
    let place = |x: &Vector<3>, p: &[Vector<3>]| sub(x, &p[0]).map(|c| c / (p[1][0] - p[0][0]));
    let paper = |x: &Vector<3>, truth: &Vector<3>| norm(&sub(&place(x, &scene.points), &place(truth, &world.points)));
    let errors = scene.points.iter().zip(&world.points).chain(scene.centers.iter().zip(&world.centers));
    let most = errors.map(|(x, truth)| paper(x, truth)).fold(0.0, f64::max);
    assert!((outcome.deviations[2].max / most - 1.0).abs() < 1e-9);
}

#[test]
fn measures_keep_their_order() {
    let trials: Vec<Trial> = (0..6).map(|seed| trial(5, 9, seed, 0.01)).collect();
    for outcome in run_trials::<3>(&trials, &METHODS).unwrap().iter().flatten() {
        let [all, views, _] = &outcome.deviations;
        assert!(all.mean < 1e-12, "the fit takes the mean away");
        assert!(all.mean_abs <= all.rms && all.rms <= all.max && all.point_coordinate_max <= all.max);
        assert!(all.rms < views.rms && views.camera_rms < all.camera_rms, "each fit is best at what it fits");
        assert!(outcome.refilmed.rms_rad <= outcome.refilmed.max_rad);
    }
    assert_eq!(Alignment::EVERY.map(Alignment::name), ["all", "views", "paper"]);
}

#[test]
fn the_same_on_any_number_of_threads() {
    let trials: Vec<Trial> = (0..30).map(|k| trial(2 + k % 7, 3 + k % 11, k as u64, 0.03)).collect();
    let on = |threads: usize| -> Vec<Vec<Outcome>> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run_trials::<3>(&trials, &METHODS)).unwrap()
    };
    // NaN is not equal to itself, its text is
    assert_eq!(format!("{:?}", on(1)), format!("{:?}", on(2)));
}

#[test]
fn too_few_views_or_points_have_no_errors() {
    for (views, points) in [(1, 1), (1, 20), (20, 1), (2, 20), (20, 2)] {
        let outcome = &run_trials::<2>(&[trial(views, points, 1, 0.01)], &[Method::Robust]).unwrap()[0][0];
        assert_ne!(outcome.status, Status::Converged, "{views} x {points}");
        assert!(outcome.deviations[0].max.is_nan(), "{views} x {points}: {outcome:?}");
    }
    let empty: [Trial; 0] = [];
    assert!(run_trials::<3>(&empty, &METHODS).unwrap().is_empty());
    assert!(run_trials::<3>(&[trial(3, 3, 0, 0.0)], &[]).unwrap()[0].is_empty());
}

#[test]
fn the_first_trial_that_is_wrong_is_named() {
    let good = trial(3, 3, 0, 0.0);
    let wrong = [good, trial(0, 3, 0, 0.0), trial(3, 3, 0, f64::NAN)];
    let error = run_trials::<3>(&wrong, &METHODS).unwrap_err();
    assert!(matches!(error, TrialError::World { index: 1, .. }), "{error}");
    assert!(error.to_string().starts_with("trial 1: n_views is 0"), "{error}");
    let error = run_trials::<3>(&wrong[2..], &METHODS).unwrap_err();
    assert!(error.to_string().contains("angle_error_rad is NaN"), "{error}");
}
