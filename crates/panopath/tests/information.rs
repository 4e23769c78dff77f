//! The Cramer-Rao covariance against a dense information matrix and against the scatter of many solves.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use common::*;
use panopath::geometry::{Matrix, Similarity, Vector, add, dot, norm, normalized, scale, sub, tangent_basis};
use panopath::positions::*;
use panopath::synthetic::{Orientations, World, WorldKind, WorldOptions};
use panopath::tracks::Tracks;

/// A dense symmetric matrix, by rows.
type Dense = Vec<Vec<f64>>;

/// Fisher information of all centres and points, by central differences of the tangent coordinates of each prediction.
fn dense_information<const D: usize>(
    world: &World<D>,
    sigma: impl Fn(usize) -> f64,
    keep: impl Fn(usize) -> bool,
) -> Dense {
    let n = world.centers.len() + world.points.len();
    let mut information = vec![vec![0.0; n * D]; n * D];
    for o in (0..world.tracks.len()).filter(|&o| keep(o)) {
        let (i, j) = (world.tracks.view()[o] as usize, world.tracks.track()[o] as usize);
        let (c, x) = (world.centers[i], world.points[j]);
        let seen = normalized(&sub(&x, &c));
        let step = 1e-5 * norm(&sub(&x, &c));
        for axis in &tangent_basis(&seen)[..D - 1] {
            let coordinate = |c: &Vector<D>, x: &Vector<D>| dot(axis, &normalized(&sub(x, c)));
            let mut slopes: Vec<(usize, f64)> = Vec::new();
            for k in 0..D {
                let e: Vector<D> = std::array::from_fn(|r| if r == k { step } else { 0.0 });
                let by_x = (coordinate(&c, &add(&x, &e)) - coordinate(&c, &sub(&x, &e))) / (2.0 * step);
                let by_c = (coordinate(&add(&c, &e), &x) - coordinate(&sub(&c, &e), &x)) / (2.0 * step);
                slopes.push((i * D + k, by_c));
                slopes.push(((world.centers.len() + j) * D + k, by_x));
            }
            for &(p, a) in &slopes {
                for &(q, b) in &slopes {
                    information[p][q] += a * b / sigma(o).powi(2);
                }
            }
        }
    }
    information
}

/// Inverse of a positive definite matrix by Gauss-Jordan elimination with the diagonal as pivots.
fn inverse(mut a: Dense) -> Dense {
    let n = a.len();
    let mut b: Dense = (0..n).map(|r| (0..n).map(|c| f64::from(u8::from(r == c))).collect()).collect();
    for p in 0..n {
        let pivot = a[p][p];
        assert!(pivot > 0.0, "pivot {p} is {pivot}");
        for c in 0..n {
            a[p][c] /= pivot;
            b[p][c] /= pivot;
        }
        let (row_a, row_b) = (a[p].clone(), b[p].clone());
        for r in (0..n).filter(|&r| r != p) {
            let factor = a[r][p];
            if factor != 0.0 {
                for c in 0..n {
                    a[r][c] -= factor * row_a[c];
                    b[r][c] -= factor * row_b[c];
                }
            }
        }
    }
    b
}

/// Covariance of the centres in the gauge of a fit by shift and scale over the centres.
fn dense_covariance<const D: usize>(world: &World<D>, information: &Dense) -> Vec<Matrix<D>> {
    let n = world.centers.len() * D;
    let total = information.len();
    // points out: Schur complement
    let inner: Dense = information[n..].iter().map(|row| row[n..].to_vec()).collect();
    let inner = inverse(inner);
    let mut reduced: Dense = information[..n].iter().map(|row| row[..n].to_vec()).collect();
    for r in 0..n {
        let across: Vec<f64> =
            (0..total - n).map(|q| (0..total - n).map(|p| information[r][n + p] * inner[p][q]).sum()).collect();
        for c in 0..n {
            reduced[r][c] -= (0..total - n).map(|q| across[q] * information[n + q][c]).sum::<f64>();
        }
    }
    // the null space is known: shifts and the scale. S^+ = (S + g G G^T)^-1 - G G^T / g, G orthonormal
    let middle = world.centers.iter().fold([0.0; D], |s, c| add(&s, &scale(1.0 / world.centers.len() as f64, c)));
    let mut gauge: Vec<Vec<f64>> = (0..D)
        .map(|k| (0..n).map(|p| f64::from(u8::from(p % D == k)) / (world.centers.len() as f64).sqrt()).collect())
        .collect();
    let outward: Vec<f64> = world.centers.iter().flat_map(|c| sub(c, &middle)).collect();
    let length = outward.iter().map(|v| v * v).sum::<f64>().sqrt();
    gauge.push(outward.iter().map(|v| v / length).collect());
    let strength = (0..n).map(|p| reduced[p][p]).sum::<f64>() / n as f64;
    for r in 0..n {
        for c in 0..n {
            reduced[r][c] += strength * gauge.iter().map(|g| g[r] * g[c]).sum::<f64>();
        }
    }
    let covariance = inverse(reduced);
    let entry = |r: usize, c: usize| covariance[r][c] - gauge.iter().map(|g| g[r] * g[c]).sum::<f64>() / strength;
    (0..world.centers.len())
        .map(|i| std::array::from_fn(|r| std::array::from_fn(|c| entry(i * D + r, i * D + c))))
        .collect()
}

fn assert_close<const D: usize>(found: &[Matrix<D>], wanted: &[Matrix<D>], what: &str) {
    for (i, (a, b)) in found.iter().zip(wanted).enumerate() {
        let size = (0..D).map(|c| b[c][c]).sum::<f64>();
        for r in 0..D {
            for c in 0..D {
                assert!((a[r][c] - b[r][c]).abs() < 1e-5 * size, "{what} (d = {D}), view {i}: {a:?}, dense {b:?}");
            }
        }
    }
}

fn check_dense<const D: usize>(kind: WorldKind, o: &WorldOptions) {
    let o = WorldOptions { orientations: Orientations::Random, ..o.clone() };
    let world = simulate::<D>(kind, &o);
    let (rotations, sigma) = (Some(&world.cam_from_world[..]), 2e-3);
    let covariance = |tracks: &Tracks<D>, keep: Option<&[bool]>| {
        position_covariance(tracks, rotations, &world.centers, &world.points, sigma, keep).unwrap()
    };
    let wanted = dense_covariance(&world, &dense_information(&world, |_| sigma, |_| true));
    assert_close(&covariance(&world.tracks, None), &wanted, "all observations");

    let keep: Vec<bool> = (0..world.tracks.len()).map(|o| o % 5 != 2).collect();
    let wanted = dense_covariance(&world, &dense_information(&world, |_| sigma, |o| keep[o]));
    assert_close(&covariance(&world.tracks, Some(&keep)), &wanted, "some observations");

    let each = |o: usize| 1e-3 * (1.0 + (o % 7) as f64);
    let t = &world.tracks;
    let sigmas = Some((0..t.len()).map(each).collect());
    let weighted =
        Tracks::new(t.view().to_vec(), t.track().to_vec(), t.bearing().to_vec(), sigmas, t.n_views(), t.n_tracks())
            .unwrap();
    let wanted = dense_covariance(&world, &dense_information(&world, each, |_| true));
    assert_close(&covariance(&weighted, None), &wanted, "a sigma for each observation");
}

#[test]
fn the_covariance_equals_that_of_the_dense_information() {
    check_dense::<2>(WorldKind::Box, &options(6, 20, 1));
    check_dense::<3>(WorldKind::Box, &options(6, 20, 1));
    check_dense::<2>(WorldKind::Room, &options(12, 50, 2));
    check_dense::<3>(WorldKind::Room, &options(12, 50, 2));
    check_dense::<3>(WorldKind::Street, &WorldOptions { min_views: Some(6), ..options(12, 60, 3) });
}

#[test]
fn more_views_than_one_block_of_solves_are_covered() {
    let world = simulate::<3>(WorldKind::Room, &options(40, 120, 2));
    let found =
        position_covariance(&world.tracks, Some(&world.cam_from_world), &world.centers, &world.points, 1e-3, None)
            .unwrap();
    let wanted = dense_covariance(&world, &dense_information(&world, |_| 1e-3, |_| true));
    assert_close(&found, &wanted, "40 views");
}

fn check_scatter<const D: usize>(kind: WorldKind, o: &WorldOptions, runs: u64) {
    let mut variance = vec![0.0; o.n_views];
    let mut bound = vec![0.0; o.n_views];
    for run in 0..runs {
        // the same scene, seen again: noise has a stream of its own
        let world = simulate::<D>(kind, o);
        let mut noise = Noise::new(run);
        let t = &world.tracks;
        let bearing = t.bearing().iter().map(|b| {
            let step: Vector<D> = std::array::from_fn(|_| o.noise_rad.max(1e-3) * noise.normal());
            normalized(&add(b, &sub(&step, &scale(dot(&step, b), b))))
        });
        let tracks =
            Tracks::new(t.view().to_vec(), t.track().to_vec(), bearing.collect(), None, t.n_views(), t.n_tracks())
                .unwrap();
        let scene = solve_tracks(&tracks, Some(&world.cam_from_world), &PositionOptions::default());
        let pairs: Vec<_> = scene.centers.iter().copied().zip(world.centers.iter().copied()).collect();
        let fit = Similarity::fit_unrotated(&pairs).unwrap();
        for (i, (found, truth)) in pairs.iter().enumerate() {
            variance[i] += norm(&sub(&fit.apply(found), truth)).powi(2) / runs as f64;
        }
        if run == 0 {
            let covariance =
                position_covariance(t, Some(&world.cam_from_world), &world.centers, &world.points, 1e-3, None).unwrap();
            bound = covariance.iter().map(|m| (0..D).map(|c| m[c][c]).sum()).collect();
        }
    }
    let ratio = (variance.iter().sum::<f64>() / bound.iter().sum::<f64>()).sqrt();
    eprintln!("{} (d = {D}): scatter over bound {ratio:.3}", kind.name());
    assert!((ratio - 1.0).abs() < 0.1, "{} (d = {D}): scatter over bound {ratio:.3}", kind.name());
    // and view by view: a variance of several coordinates over that many runs is known to some 2 / sqrt(runs)
    for (i, (v, b)) in variance.iter().zip(&bound).enumerate() {
        let one = (v / b).sqrt();
        assert!((0.7..1.4).contains(&one), "{} (d = {D}), view {i}: {one:.3}", kind.name());
    }
}

#[test]
fn the_scatter_of_many_solves_is_the_covariance() {
    check_scatter::<3>(WorldKind::Box, &options(8, 60, 1), 300);
    check_scatter::<2>(WorldKind::Box, &options(8, 60, 1), 300);
    check_scatter::<3>(WorldKind::Room, &options(20, 250, 2), 300);
    check_scatter::<3>(WorldKind::Street, &options(20, 300, 2), 300);
}

#[test]
fn the_covariance_scales_as_it_should() {
    let world = simulate::<3>(WorldKind::Box, &options(6, 25, 1));
    let at = |factor: f64, sigma: f64| {
        let centers: Vec<_> = world.centers.iter().map(|c| scale(factor, c)).collect();
        let points: Vec<_> = world.points.iter().map(|x| scale(factor, x)).collect();
        position_covariance(&world.tracks, None, &centers, &points, sigma, None).unwrap()
    };
    let (one, large, noisy) = (at(1.0, 1e-3), at(1e4, 1e-3), at(1.0, 1e-2));
    for ((a, b), c) in one.iter().zip(&large).zip(&noisy) {
        for k in 0..3 {
            assert!((b[k][k] / a[k][k] / 1e8 - 1.0).abs() < 1e-6);
            assert!((c[k][k] / a[k][k] / 1e2 - 1.0).abs() < 1e-6);
            assert!(a[k][k] > 0.0);
        }
    }
}

#[test]
fn views_that_take_no_part_have_no_covariance() {
    let world = simulate::<3>(WorldKind::Box, &options(6, 25, 1));
    let mut centers = world.centers.clone();
    centers[4] = [f64::NAN; 3];
    let covariance = position_covariance(&world.tracks, None, &centers, &world.points, 1e-3, None).unwrap();
    for (i, m) in covariance.iter().enumerate() {
        assert_eq!(m.iter().flatten().all(|x| x.is_nan()), i == 4, "view {i}");
        assert_eq!(m.iter().flatten().all(|x| x.is_finite()), i != 4, "view {i}");
    }
    let nothing = vec![false; world.tracks.len()];
    let covariance =
        position_covariance(&world.tracks, None, &world.centers, &world.points, 1e-3, Some(&nothing)).unwrap();
    assert!(covariance.iter().flatten().flatten().all(|x| x.is_nan()));
}

#[test]
fn arguments_that_do_not_fit_are_named() {
    let world = simulate::<3>(WorldKind::Box, &options(6, 25, 1));
    let error = |rotations, centers: &[Vector<3>], points: &[Vector<3>]| {
        position_covariance(&world.tracks, rotations, centers, points, 1e-3, None).unwrap_err().to_string()
    };
    assert!(error(None, &world.centers[1..], &world.points).contains("5 centres"));
    assert!(error(None, &world.centers, &world.points[1..]).contains("24 points"));
    assert!(error(Some(&world.cam_from_world[1..]), &world.centers, &world.points).contains("cam_from_world"));
}
