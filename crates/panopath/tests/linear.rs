//! The paper's own least squares: exact worlds under every form, axis and gauge, and where they fall short.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use common::*;
use panopath::positions::*;
use panopath::synthetic::{Orientations, WorldKind, WorldOptions};

const GAUGES: [LinearGauge; 3] = [LinearGauge::Functional, LinearGauge::Paper, LinearGauge::PaperDistance];

fn linear<const D: usize>(form: LinearForm, gauge: LinearGauge) -> PositionOptions<D> {
    PositionOptions { method: Method::Linear { form, gauge }, ..PositionOptions::default() }
}

fn forms() -> Vec<LinearForm> {
    let mut forms = vec![LinearForm::Joint];
    forms.extend((0..3).map(|vertical_axis| LinearForm::TwoStage { vertical_axis }));
    forms
}

#[test]
fn exact_worlds_are_recovered_by_every_form_axis_and_gauge() {
    let worlds = [
        ("box", WorldKind::Box, options(6, 25, 1)),
        ("box seen in part", WorldKind::Box, WorldOptions { visible_fraction: Some(0.5), ..options(15, 50, 2) }),
        ("room", WorldKind::Room, options(30, 200, 3)),
        ("corridor", WorldKind::Corridor, options(20, 200, 4)),
        ("street", WorldKind::Street, WorldOptions { depth_max_m: Some(20.0), ..options(30, 300, 5) }),
    ];
    for (name, kind, o) in worlds {
        let o = WorldOptions { orientations: Orientations::Random, ..o };
        let (space, plane) = (simulate::<3>(kind, &o), simulate::<2>(kind, &o));
        for gauge in GAUGES {
            for form in forms() {
                assert_exact(&solve(&space, &linear(form, gauge)), &space, &format!("{name}, {form:?}, {gauge:?}"));
            }
            assert_exact(&solve(&plane, &linear(LinearForm::Joint, gauge)), &plane, &format!("{name}, {gauge:?}"));
        }
    }
}

#[test]
fn the_least_input_that_counting_allows_is_enough() {
    // nm >= 2(n + m) - 3 in the plane: 3 x 3; 2nm >= 3(n + m) - 4 in space: 2 x 2 off one plane
    let plane = simulate::<2>(WorldKind::Box, &options(3, 3, 4));
    let space = simulate::<3>(WorldKind::Box, &options(2, 2, 4));
    for gauge in GAUGES {
        assert_exact(&solve(&plane, &linear(LinearForm::Joint, gauge)), &plane, "3 x 3");
        assert_exact(&solve(&space, &linear(LinearForm::Joint, gauge)), &space, "2 x 2");
    }
    assert_exact(&solve(&plane, &PositionOptions::default()), &plane, "3 x 3, robust");
    assert_exact(&solve(&space, &PositionOptions::default()), &space, "2 x 2, robust");
}

#[test]
fn planar_first_is_only_sufficient() {
    for seed in 0..4 {
        let world = simulate::<3>(WorldKind::Cylinder, &options(10, 40, seed));
        for gauge in GAUGES {
            assert_exact(&solve(&world, &linear(LinearForm::Joint, gauge)), &world, "cylinder, joint");
            // seen along the axis the scene is an ellipse, and the first stage cannot be unique
            let above = solve(&world, &linear(LinearForm::TwoStage { vertical_axis: 2 }, gauge));
            let recovered = above.summary.n_components == 1 && world_errors(&above, &world).worst() < EXACT;
            let flagged = !matches!(above.summary.status, Status::Converged | Status::MaxIterations);
            assert!(flagged && !recovered, "seed {seed}, {gauge:?}: {:?}", above.summary.status);
        }
        for vertical_axis in [0, 1] {
            let form = LinearForm::TwoStage { vertical_axis };
            assert_exact(&solve(&world, &linear(form, LinearGauge::Functional)), &world, "cylinder seen from its side");
        }
    }
}

#[test]
fn a_conic_is_ambiguous_to_the_linear_method_too() {
    for noise_rad in [0.0, 1e-4] {
        for seed in 0..4 {
            let world = simulate::<2>(WorldKind::Ellipse, &WorldOptions { noise_rad, ..options(8, 20, seed) });
            for gauge in GAUGES {
                let status = solve(&world, &linear(LinearForm::Joint, gauge)).summary.status;
                assert!(
                    !matches!(status, Status::Converged | Status::MaxIterations),
                    "{noise_rad}, {gauge:?}: {status:?}"
                );
            }
        }
    }
}

#[test]
fn small_noise_moves_the_answer_in_proportion() {
    // to first order the error is linear in the noise, under every form and gauge
    let error = |noise_rad: f64, form, gauge| {
        let world = simulate::<3>(WorldKind::Box, &WorldOptions { noise_rad, ..options(8, 40, 3) });
        world_errors(&solve(&world, &linear(form, gauge)), &world).camera_rms / noise_rad
    };
    for gauge in GAUGES {
        for form in forms() {
            let (small, large) = (error(1e-7, form, gauge), error(1e-5, form, gauge));
            assert!((small / large - 1.0).abs() < 0.05, "{form:?}, {gauge:?}: {small} and {large} per radian");
            assert!(small < 100.0, "{form:?}, {gauge:?}: {small} per radian");
        }
    }
}

#[test]
fn plain_least_squares_is_biased_where_the_robust_method_is_not() {
    let o = WorldOptions { noise_rad: 0.5 * DEG, ..options(120, 2500, 1) };
    let world = simulate::<3>(WorldKind::Corridor, &o);
    let plain = world_errors(&solve(&world, &linear(LinearForm::Joint, LinearGauge::Functional)), &world).camera_rms;
    let robust = world_errors(&solve(&world, &PositionOptions::default()), &world).camera_rms;
    assert!(plain > 3.0 * robust, "plain {plain}, robust {robust}");
    let bound = bound_rms(&world);
    assert!(robust < 2.0 * bound, "robust {robust}, bound {bound}");
}

#[test]
fn sigmas_weigh_the_linear_equations() {
    let exact = simulate::<3>(WorldKind::Box, &options(8, 40, 3));
    let mut noise = Noise::new(3);
    let t = &exact.tracks;
    let sigma: Vec<f64> =
        (0..t.len()).map(|o| if (t.view()[o] + 2 * t.track()[o]) % 3 > 0 { 1e-6 } else { 1e-3 }).collect();
    let bearing: Vec<_> = t
        .bearing()
        .iter()
        .zip(&sigma)
        .map(|(b, s)| panopath::geometry::normalized(&std::array::from_fn(|c| b[c] + s * noise.normal())))
        .collect();
    let error = |sigma: Option<Vec<f64>>, form| {
        let (view, track) = (t.view().to_vec(), t.track().to_vec());
        let tracks = panopath::Tracks::new(view, track, bearing.clone(), sigma, 8, 40).unwrap();
        let scene = solve_tracks(&tracks, None, &linear(form, LinearGauge::Functional));
        errors(&scene, &exact.centers, &exact.points, 0).camera_rms
    };
    for form in forms() {
        let (weighted, plain) = (error(Some(sigma.clone()), form), error(None, form));
        assert!(weighted < 0.05 * plain, "{form:?}: weighted {weighted}, unweighted {plain}");
    }
}

#[test]
fn planar_input_has_one_form() {
    let world = simulate::<2>(WorldKind::Box, &options(6, 25, 1));
    for vertical_axis in [0, 1] {
        let scene = solve(&world, &linear(LinearForm::TwoStage { vertical_axis }, LinearGauge::Functional));
        assert_exact(&scene, &world, "two stages of a planar world");
    }
}

#[test]
fn the_gauge_of_the_equations_does_not_move_exact_answers() {
    let world = simulate::<3>(WorldKind::Box, &options(6, 25, 9));
    let scenes: Vec<_> = GAUGES.iter().map(|&gauge| solve(&world, &linear(LinearForm::Joint, gauge))).collect();
    for scene in &scenes[1..] {
        for (a, b) in scene.centers.iter().zip(&scenes[0].centers) {
            assert!(panopath::geometry::norm(&panopath::geometry::sub(a, b)) < EXACT);
        }
    }
}
