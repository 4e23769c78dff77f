//! One group a step, accuracy printed beside time: `cargo bench -p panopath --bench steps`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use panopath::geometry::{Similarity, norm, sub};
use panopath::orientation::{OrientationOptions, RelativeRotation, average_rotations};
use panopath::positions::*;
use panopath::refinement::{CovarianceGauge, RefineOptions, refine};
use panopath::synthetic::{Orientations, World, WorldKind, WorldOptions, simulate};
use panopath::two_view::{TwoViewOptions, relative_poses};
use panopath::view_graph::{ViewGraphOptions, view_pairs};

const NOISE_RAD: f64 = 0.05 * std::f64::consts::PI / 180.0;

fn noisy(kind: WorldKind, n_views: usize, n_points: usize) -> World<3> {
    simulate(kind, &WorldOptions { n_views, n_points, noise_rad: NOISE_RAD, seed: 1, ..Default::default() }).unwrap()
}

/// Rms of the camera error after a fit by shift and scale.
fn camera_rms(scene: &Structure<3>, world: &World<3>) -> f64 {
    let pairs = scene.centers.iter().zip(&world.centers).filter(|(c, _)| c[0].is_finite());
    let pairs: Vec<_> = pairs.map(|(a, b)| (*a, *b)).collect();
    let Some(fit) = Similarity::fit_unrotated(&pairs) else { return f64::NAN };
    (pairs.iter().map(|(a, b)| norm(&sub(&fit.apply(a), b)).powi(2)).sum::<f64>() / pairs.len() as f64).sqrt()
}

/// Rms that the noise allows (Cramer and Rao).
fn bound_rms(world: &World<3>) -> f64 {
    let covariance = position_covariance(&world.tracks, None, &world.centers, &world.points, NOISE_RAD, None).unwrap();
    (covariance.iter().map(|m| m[0][0] + m[1][1] + m[2][2]).sum::<f64>() / covariance.len() as f64).sqrt()
}

fn bench_solve(c: &mut Criterion, name: &str, worlds: &[(WorldKind, usize, usize)], options: &PositionOptions<3>) {
    let mut group = c.benchmark_group(name);
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(5));
    for &(kind, n_views, n_points) in worlds {
        let world = noisy(kind, n_views, n_points);
        let scene = solve_positions(&world.tracks, None, options).unwrap();
        let id = BenchmarkId::new(kind.name(), n_views);
        eprintln!(
            "{name}/{}/{n_views}: {:?}, camera rms {:.3e}, bound {:.3e}, {} observations, {} iterations",
            kind.name(),
            scene.summary.status,
            camera_rms(&scene, &world),
            bound_rms(&world),
            world.tracks.len(),
            scene.summary.iterations
        );
        group.throughput(Throughput::Elements(world.tracks.len() as u64));
        group.bench_with_input(id, &world, |b, world| {
            b.iter(|| solve_positions(black_box(&world.tracks), None, options).unwrap());
        });
    }
    group.finish();
}

fn robust(c: &mut Criterion) {
    let worlds =
        [(WorldKind::Street, 100, 10_000), (WorldKind::Street, 1000, 100_000), (WorldKind::Room, 1000, 100_000)];
    bench_solve(c, "robust", &worlds, &PositionOptions::default());
}

fn linear(c: &mut Criterion) {
    let method = Method::Linear { form: LinearForm::Joint, gauge: LinearGauge::Functional };
    bench_solve(c, "linear", &[(WorldKind::Box, 50, 500)], &PositionOptions { method, ..Default::default() });
}

/// The split into parts has no entry of its own: a world that falls into many parts shows its cost.
fn parts(c: &mut Criterion) {
    let mut group = c.benchmark_group("parts");
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(3));
    for n_clusters in [2, 20] {
        let o = WorldOptions {
            n_views: 400,
            n_points: 20_000,
            n_clusters: Some(n_clusters),
            n_links: Some(3),
            noise_rad: NOISE_RAD,
            ..Default::default()
        };
        let world = simulate::<3>(WorldKind::Weak, &o).unwrap();
        let scene = solve_positions(&world.tracks, None, &PositionOptions::default()).unwrap();
        let found = scene.summary.n_components;
        eprintln!(
            "parts/{n_clusters}: {found} parts found of {n_clusters}, layout {:.1} ms",
            1e3 * scene.summary.timings.layout_s
        );
        group.throughput(Throughput::Elements(world.tracks.len() as u64));
        group.bench_function(BenchmarkId::from_parameter(n_clusters), |b| {
            b.iter(|| solve_positions(black_box(&world.tracks), None, &PositionOptions::default()).unwrap());
        });
    }
    group.finish();
}

fn covariance(c: &mut Criterion) {
    let mut group = c.benchmark_group("covariance");
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(3));
    let world = noisy(WorldKind::Street, 300, 10_000);
    eprintln!("covariance/street/300: rms {:.3e}", bound_rms(&world));
    group.bench_function("street/300", |b| b.iter(|| bound_rms(black_box(&world))));
    group.finish();
}

/// Worlds whose orientations, as told, err by half a degree.
fn turned(kind: WorldKind, n_views: usize, n_points: usize) -> World<3> {
    let o = WorldOptions {
        n_views,
        n_points,
        noise_rad: NOISE_RAD,
        orientations: Orientations::Random,
        orientation_error_rad: 0.01,
        seed: 1,
        ..Default::default()
    };
    simulate(kind, &o).unwrap()
}

fn refinement(c: &mut Criterion) {
    let mut group = c.benchmark_group("refinement");
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(5));
    for (kind, n_views, n_points) in [(WorldKind::Street, 100, 10_000), (WorldKind::Street, 1000, 100_000)] {
        let world = turned(kind, n_views, n_points);
        let start = solve_positions(&world.tracks, Some(&world.cam_from_world), &PositionOptions::default()).unwrap();
        let options = RefineOptions::default();
        let scene = refine::<3, 6>(&world.tracks, &start, &options).unwrap();
        let similarity: Vec<_> = scene.centers.iter().copied().zip(world.centers.iter().copied()).collect();
        let fit = Similarity::fit(&similarity).unwrap();
        let squared: f64 = similarity.iter().map(|(a, b)| norm(&sub(&fit.apply(a), b)).powi(2)).sum();
        let rms = (squared / n_views as f64).sqrt();
        let (name, summary) = (kind.name(), &scene.summary);
        eprintln!(
            "refinement/{name}/{n_views}: {:?}, camera rms {rms:.3e}, {} iterations",
            summary.status, summary.iterations
        );
        group.throughput(Throughput::Elements(world.tracks.len() as u64));
        group.bench_function(BenchmarkId::new(name, n_views), |b| {
            b.iter(|| refine::<3, 6>(black_box(&world.tracks), &start, &options).unwrap());
        });
        group.bench_function(BenchmarkId::new(format!("{name} covariance"), n_views), |b| {
            let gauge = CovarianceGauge::default();
            b.iter(|| {
                panopath::refinement::covariance::<3, 6>(&world.tracks, &scene, &options, gauge, NOISE_RAD).unwrap()
            });
        });
    }
    group.finish();
}

/// From tracks to orientations: pairs of views, their relative poses, the average.
fn orientations(c: &mut Criterion) {
    let mut group = c.benchmark_group("orientations");
    group.sample_size(10).warm_up_time(Duration::from_millis(500)).measurement_time(Duration::from_secs(5));
    let world = turned(WorldKind::Street, 100, 10_000);
    let graph = view_pairs(&world.tracks, &ViewGraphOptions::default());
    let start: Vec<usize> = graph.start.iter().map(|&s| s as usize).collect();
    let side = |k: usize| -> Vec<[f64; 3]> {
        graph.observation.iter().map(|pair| world.tracks.bearing()[pair[k] as usize]).collect()
    };
    let (first, second) = (side(0), side(1));
    let options = TwoViewOptions::default();
    let relative = relative_poses(&start, &first, &second, None, &options).unwrap();
    let edges: Vec<RelativeRotation> = (graph.pair.iter().zip(&relative))
        .map(|(&[first, second], pair)| RelativeRotation {
            first,
            second,
            second_from_first: pair.second_from_first,
            sigma_rad: NOISE_RAD,
        })
        .collect();
    let averaged = average_rotations(100, &edges, &[], &OrientationOptions::default()).unwrap();
    let kept = averaged.edge_inlier.iter().filter(|&&k| k).count();
    eprintln!("orientations/street/100: {:?}, {kept} of {} edges agree", averaged.status, edges.len());
    group.bench_function("view_pairs", |b| {
        b.iter(|| view_pairs(black_box(&world.tracks), &ViewGraphOptions::default()));
    });
    group.throughput(Throughput::Elements(edges.len() as u64));
    group.bench_function("relative_poses", |b| {
        b.iter(|| relative_poses(&start, black_box(&first), &second, None, &options).unwrap());
    });
    group.bench_function("average_rotations", |b| {
        b.iter(|| average_rotations(100, black_box(&edges), &[], &OrientationOptions::default()).unwrap());
    });
    group.finish();
}

criterion_group!(steps, robust, linear, parts, covariance, refinement, orientations);
criterion_main!(steps);
