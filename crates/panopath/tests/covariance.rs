//! Covariances of poses and points against a dense reference, and their laws.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use common::Noise;
use common::poses::*;
use panopath::geometry::{Matrix, Rotation, Vector, add, normalized, scale, sub, tangent_basis};
use panopath::refinement::*;
use panopath::structure::Structure;
use panopath::tracks::Tracks;

const SIGMA: f64 = 1e-3;

/// What is free of a scene, as the reference understands it.
#[derive(Clone, Copy, PartialEq)]
enum Free {
    Similarity,
    /// Place and size.
    Unturned,
    /// Place, size and a turn about z.
    AboutVertical,
    /// Place and turn.
    Rigid,
    Nothing,
}

struct Case<const D: usize> {
    scene: Structure<D>,
    tracks: Tracks<D>,
    options: RefineOptions<D>,
    free: Free,
    /// Do the centres lie on a line?
    straight: bool,
}

/// Unknowns of all: poses (a turn in the camera, on the left, and the centre), then points.
fn perturbed<const D: usize>(scene: &Structure<D>, x: &[f64]) -> Structure<D> {
    let (n_turns, v, n) = (turns(D), turns(D) + D, scene.centers.len());
    let mut moved = scene.clone();
    for i in 0..n {
        let own = &x[i * v..(i + 1) * v];
        moved.cam_from_world[i] = Rotation::exp_of(&own[..n_turns]).compose(&scene.cam_from_world[i]);
        moved.centers[i] = std::array::from_fn(|c| scene.centers[i][c] + own[n_turns + c]);
    }
    for (j, own) in x[n * v..].chunks_exact(D).enumerate() {
        moved.points[j] = std::array::from_fn(|c| scene.points[j][c] + own[c]);
    }
    moved
}

/// All errors in standard deviations, near the scene `base`.
fn errors_of<const D: usize>(case: &Case<D>, base: &Structure<D>, now: &Structure<D>) -> Vec<f64> {
    let predict = |s: &Structure<D>, o: usize| -> Vector<D> {
        let (i, j) = (case.tracks.view()[o] as usize, case.tracks.track()[o] as usize);
        let lever = case.options.rig.as_ref().map_or([0.0; D], |rig| rig.center[rig.sensor[o] as usize]);
        normalized(&sub(&s.cam_from_world[i].apply(&sub(&s.points[j], &s.centers[i])), &lever))
    };
    let mut errors = Vec::new();
    for o in 0..case.tracks.len() {
        let sigma = case.tracks.sigma_rad().map_or(SIGMA, |s| s[o]);
        let (before, after) = (predict(base, o), predict(now, o));
        for t in &tangent_basis(&before)[..D - 1] {
            errors.push(panopath::geometry::dot(t, &after) / sigma);
        }
    }
    let priors = &case.options.priors;
    for p in &priors.rotations {
        let turn = now.cam_from_world[p.view as usize].compose(&p.cam_from_world.inverse()).turn();
        errors.extend((0..turns(D)).map(|k| turn[k] / p.covariance[k][k].sqrt()));
    }
    for p in &priors.directions {
        let seen = now.cam_from_world[p.view as usize].inverse().apply(&p.bearing);
        for t in &tangent_basis(&p.direction)[..D - 1] {
            errors.push(panopath::geometry::dot(t, &seen) / p.sigma_rad);
        }
    }
    for p in &priors.positions {
        errors.extend((0..D).map(|c| (now.centers[p.view as usize][c] - p.center[c]) / p.covariance[c][c].sqrt()));
    }
    errors
}

/// Derivatives by central differences: one column for each unknown.
fn jacobian<const D: usize>(case: &Case<D>) -> Vec<Vec<f64>> {
    const STEP: f64 = 1e-5;
    let n_unknowns = case.scene.centers.len() * (turns(D) + D) + case.scene.points.len() * D;
    let at = |k: usize, step: f64| {
        let mut x = vec![0.0; n_unknowns];
        x[k] = step;
        errors_of(case, &case.scene, &perturbed(&case.scene, &x))
    };
    (0..n_unknowns)
        .map(|k| at(k, STEP).iter().zip(at(k, -STEP)).map(|(a, b)| (a - b) / (2.0 * STEP)).collect())
        .collect()
}

/// What each free freedom of the gauge does to all unknowns.
fn gauge_of<const D: usize>(case: &Case<D>) -> Vec<Vec<f64>> {
    let scene = &case.scene;
    let (n_turns, v, n) = (turns(D), turns(D) + D, scene.centers.len());
    let middle = scene.centers.iter().fold([0.0; D], |sum, c| add(&sum, &scale(1.0 / n as f64, c)));
    let column = |turn: [f64; 3], shift: &dyn Fn(&Vector<D>) -> Vector<D>| -> Vec<f64> {
        let mut x = vec![0.0; n * v + scene.points.len() * D];
        for i in 0..n {
            if D == 2 {
                x[i * v] = -turn[0];
            } else {
                let r = scene.cam_from_world[i].matrix();
                (0..D).for_each(|k| x[i * v + k] = -(0..D).map(|c| r[k][c] * turn[c]).sum::<f64>());
            }
            let moved = shift(&sub(&scene.centers[i], &middle));
            x[i * v + n_turns..(i + 1) * v].copy_from_slice(&moved);
        }
        for (j, point) in scene.points.iter().enumerate() {
            let at = n * v + j * D;
            x[at..at + D].copy_from_slice(&shift(&sub(point, &middle)));
        }
        x
    };
    let across = |axis: [f64; 3]| {
        move |a: &Vector<D>| -> Vector<D> {
            let p: [f64; 3] = std::array::from_fn(|c| if c < D { a[c] } else { 0.0 });
            let w = if D == 2 { [0.0, 0.0, axis[0]] } else { axis };
            let q = [w[1] * p[2] - w[2] * p[1], w[2] * p[0] - w[0] * p[2], w[0] * p[1] - w[1] * p[0]];
            std::array::from_fn(|c| q[c])
        }
    };
    let mut basis = Vec::new();
    if case.free != Free::Nothing {
        for c in 0..D {
            basis.push(column([0.0; 3], &|_| std::array::from_fn(|k| f64::from(u8::from(k == c)))));
        }
    }
    let axes: Vec<[f64; 3]> = match case.free {
        Free::Similarity | Free::Rigid => {
            (0..n_turns).map(|k| std::array::from_fn(|c| f64::from(u8::from(c == k)))).collect()
        }
        Free::AboutVertical => vec![[0.0, 0.0, 1.0]],
        _ => vec![],
    };
    for axis in axes {
        basis.push(column(axis, &across(axis)));
    }
    if matches!(case.free, Free::Similarity | Free::Unturned | Free::AboutVertical) {
        basis.push(column([0.0; 3], &|a| *a));
    }
    basis
}

/// The inverse of a dense matrix by elimination with pivoting.
fn inverse(mut a: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let n = a.len();
    let mut b: Vec<Vec<f64>> = (0..n).map(|r| (0..n).map(|c| f64::from(u8::from(r == c))).collect()).collect();
    for k in 0..n {
        let pivot = (k..n).max_by(|&x, &y| a[x][k].abs().total_cmp(&a[y][k].abs())).unwrap();
        a.swap(k, pivot);
        b.swap(k, pivot);
        let p = a[k][k];
        assert!(p.abs() > 1e-14, "the reference is singular");
        a[k].iter_mut().for_each(|x| *x /= p);
        b[k].iter_mut().for_each(|x| *x /= p);
        for r in (0..n).filter(|&r| r != k) {
            let f = a[r][k];
            for c in 0..n {
                let (from_a, from_b) = (a[k][c], b[k][c]);
                a[r][c] -= f * from_a;
                b[r][c] -= f * from_b;
            }
        }
    }
    b
}

/// The covariance of all unknowns under the conditions of a gauge: of `min |J x - e|` with `W^T x = 0`.
fn reference<const D: usize>(case: &Case<D>, view: Option<usize>) -> Vec<Vec<f64>> {
    let (n_turns, v, n) = (turns(D), turns(D) + D, case.scene.centers.len());
    let columns = jacobian(case);
    let size = common::path_size(&case.scene.centers);
    let basis = gauge_of(case);
    let conditions: Vec<Vec<f64>> = match view {
        None => (basis.iter())
            .map(|g| {
                let weight = |k: usize| match k < n * v {
                    true if k % v >= n_turns => 1.0 / (size * size),
                    true if case.straight => 1.0,
                    _ => 0.0,
                };
                g.iter().enumerate().map(|(k, x)| x * weight(k)).collect()
            })
            .collect(),
        Some(view) => {
            let mut rows: Vec<Vec<f64>> =
                (0..v).map(|k| (0..columns.len()).map(|c| f64::from(u8::from(c == view * v + k))).collect()).collect();
            let mut spread = vec![0.0; columns.len()];
            for i in 0..n {
                let arm = sub(&case.scene.centers[i], &case.scene.centers[view]);
                spread[i * v + n_turns..(i + 1) * v].copy_from_slice(&arm);
            }
            rows.push(spread);
            rows
        }
    };
    let (n_unknowns, n_all) = (columns.len(), columns.len() + conditions.len());
    // unknowns of the same order, so that elimination keeps its digits
    let unit: Vec<f64> = columns.iter().map(|c| 1.0 / c.iter().map(|x| x * x).sum::<f64>().sqrt()).collect();
    let mut bordered = vec![vec![0.0; n_all]; n_all];
    for r in 0..n_unknowns {
        for c in 0..n_unknowns {
            let product: f64 = columns[r].iter().zip(&columns[c]).map(|(a, b)| a * b).sum();
            bordered[r][c] = product * unit[r] * unit[c];
        }
        for (k, w) in conditions.iter().enumerate() {
            let largest = (0..n_unknowns).map(|i| (w[i] * unit[i]).abs()).fold(0.0, f64::max);
            bordered[r][n_unknowns + k] = w[r] * unit[r] / largest;
            bordered[n_unknowns + k][r] = w[r] * unit[r] / largest;
        }
    }
    let found = inverse(bordered);
    (0..n_unknowns).map(|r| (0..n_unknowns).map(|c| found[r][c] * unit[r] * unit[c]).collect()).collect()
}

fn same_block(found: impl Fn(usize, usize) -> f64, wanted: impl Fn(usize, usize) -> f64, n: usize, what: &str) {
    for r in 0..n {
        for c in 0..n {
            let size = (wanted(r, r) * wanted(c, c)).sqrt().max(1e-300);
            let off = (found(r, c) - wanted(r, c)).abs();
            assert!(off <= 1e-5 * size + 1e-15, "{what} ({r}, {c}): {} against {}", found(r, c), wanted(r, c));
        }
    }
}

fn check<const D: usize, const V: usize>(case: &Case<D>, what: &str) {
    let n = case.scene.centers.len();
    let sigma = match case.tracks.sigma_rad() {
        Some(sigmas) => {
            let mut sorted = sigmas.to_vec();
            sorted.sort_by(f64::total_cmp);
            sorted[sorted.len() / 2]
        }
        None => SIGMA,
    };
    let mut gauges = vec![(CovarianceGauge::Cameras, None)];
    if case.free == Free::Similarity {
        gauges.push((CovarianceGauge::View(1), Some(1)));
    }
    for (gauge, view) in gauges {
        let found = covariance::<D, V>(&case.tracks, &case.scene, &case.options, gauge, sigma).unwrap();
        let wanted = reference(case, view);
        for i in 0..n {
            let block = |r: usize, c: usize| wanted[i * V + r][i * V + c];
            same_block(|r, c| found.cameras[i][r][c], block, V, &format!("{what}, {gauge:?}, view {i}"));
        }
        for j in 0..case.scene.points.len() {
            let block = |r: usize, c: usize| wanted[n * V + j * D + r][n * V + j * D + c];
            same_block(|r, c| found.points[j][r][c], block, D, &format!("{what}, {gauge:?}, point {j}"));
        }
    }
}

fn case<const D: usize>(scene: Structure<D>, share: f64, levers: &[Vector<D>]) -> Case<D> {
    let mut noise = Noise::new(9);
    let (n, m) = (scene.centers.len(), scene.points.len());
    let seen: Vec<_> = everything(n, m, levers.len()).filter(|_| noise.uniform() < share).collect();
    let (tracks, sensor) = look(&scene, levers, seen);
    let rig = (levers.len() > 1).then(|| Rig { sensor, center: levers.to_vec() });
    let free = if rig.is_some() { Free::Rigid } else { Free::Similarity };
    Case { scene, tracks, options: RefineOptions { rig, ..Default::default() }, free, straight: false }
}

fn variances<const D: usize>(of: [f64; 3]) -> Matrix<D> {
    std::array::from_fn(|r| std::array::from_fn(|c| if r == c { of[r] } else { 0.0 }))
}

#[test]
fn bearings_alone_equal_the_dense_reference() {
    check::<3, 6>(&case(walk::<3>(5, 14, 1), 1.0, &[[0.0; 3]]), "all seen");
    check::<3, 6>(&case(walk::<3>(7, 20, 2), 0.7, &[[0.0; 3]]), "some seen");
    check::<2, 3>(&case(walk::<2>(5, 14, 1), 1.0, &[[0.0; 2]]), "plane");
    check::<2, 3>(&case(walk::<2>(7, 20, 2), 0.8, &[[0.0; 2]]), "plane, some seen");
    // more views than points
    check::<3, 6>(&case(walk::<3>(12, 8, 3), 1.0, &[[0.0; 3]]), "few points");
}

#[test]
fn bearings_of_unequal_accuracy_equal_the_dense_reference() {
    let mut it = case(walk::<3>(5, 14, 1), 1.0, &[[0.0; 3]]);
    let mut noise = Noise::new(4);
    let t = &it.tracks;
    let sigmas: Vec<f64> = (0..t.len()).map(|_| SIGMA * (0.5 + 2.0 * noise.uniform())).collect();
    let (view, track, bearing) = (t.view().to_vec(), t.track().to_vec(), t.bearing().to_vec());
    it.tracks = Tracks::new(view, track, bearing, Some(sigmas), 5, 14).unwrap();
    check::<3, 6>(&it, "unequal");
}

#[test]
fn priors_equal_the_dense_reference() {
    let fresh = || case(walk::<3>(5, 14, 1), 1.0, &[[0.0; 3]]);
    let up = [0.0, 0.0, 1.0];
    let cams = fresh().scene.cam_from_world;
    let centers = fresh().scene.centers;
    let rotation = |view: usize| RotationPrior {
        view: view as u32,
        cam_from_world: cams[view],
        covariance: variances([1e-4, 4e-4, 2e-4]),
    };
    let direction = |view: usize| DirectionPrior {
        view: view as u32,
        bearing: cams[view].apply(&up),
        direction: up,
        sigma_rad: 0.01,
    };
    let position = |view: usize| PositionPrior {
        view: view as u32,
        center: centers[view],
        covariance: variances([1e-2, 2e-2, 4e-2]),
    };
    for (priors, free, what) in [
        (Priors { rotations: vec![rotation(2)], ..Default::default() }, Free::Unturned, "a compass"),
        (Priors { directions: (0..5).map(direction).collect(), ..Default::default() }, Free::AboutVertical, "gravity"),
        (Priors { positions: (0..5).map(position).collect(), ..Default::default() }, Free::Nothing, "positions"),
        (
            Priors {
                positions: vec![position(0), position(3)],
                directions: vec![direction(1), direction(2)],
                rotations: vec![rotation(4)],
            },
            Free::Nothing,
            "all kinds",
        ),
    ] {
        let mut it = fresh();
        it.options.priors = priors;
        it.free = free;
        check::<3, 6>(&it, what);
    }
    let mut plane = case(walk::<2>(5, 14, 1), 1.0, &[[0.0; 2]]);
    let of = |view: usize| RotationPrior {
        view: view as u32,
        cam_from_world: plane.scene.cam_from_world[view],
        covariance: variances([1e-4, 1.0, 0.0]),
    };
    plane.options.priors.rotations = vec![of(1), of(3)];
    plane.free = Free::Unturned;
    check::<2, 3>(&plane, "headings");
}

#[test]
fn rigs_equal_the_dense_reference() {
    check::<3, 6>(&case(walk::<3>(5, 14, 1), 1.0, &[[0.0, 0.3, 0.0], [0.0, -0.3, 0.1]]), "two sensors");
    check::<2, 3>(&case(walk::<2>(5, 14, 1), 1.0, &[[0.3, 0.0], [-0.3, 0.1]]), "two sensors in the plane");
}

#[test]
fn centres_on_a_line_equal_the_dense_reference() {
    let mut scene = walk::<3>(5, 16, 1);
    for (i, center) in scene.centers.iter_mut().enumerate() {
        *center = [0.6 * i as f64, 0.8 * i as f64, 0.0];
    }
    let mut it = case(scene, 1.0, &[[0.0; 3]]);
    it.straight = true;
    check::<3, 6>(&it, "on a line");
}

// ---------------------------------------------------------------------------------------------------------- laws

#[test]
fn a_similarity_takes_covariances_with_it() {
    let it = case(walk::<3>(6, 30, 1), 0.8, &[[0.0; 3]]);
    for gauge in [CovarianceGauge::Cameras, CovarianceGauge::View(2)] {
        let one = covariance::<3, 6>(&it.tracks, &it.scene, &it.options, gauge, SIGMA).unwrap();
        let there = some_similarity::<3>(3);
        let other = covariance::<3, 6>(&it.tracks, &moved(&it.scene, &there), &it.options, gauge, SIGMA).unwrap();
        let (s, r) = (there.scale, there.rotation.matrix());
        // the turn is in the camera, which does not notice
        let change: [[f64; 6]; 6] = std::array::from_fn(|a| {
            std::array::from_fn(|b| match (a < 3, b < 3) {
                (true, true) => f64::from(u8::from(a == b)),
                (false, false) => s * r[a - 3][b - 3],
                _ => 0.0,
            })
        });
        for i in 0..6 {
            let half: [[f64; 6]; 6] = std::array::from_fn(|a| {
                std::array::from_fn(|b| (0..6).map(|k| change[a][k] * one.cameras[i][k][b]).sum())
            });
            let wanted = |a: usize, b: usize| (0..6).map(|k| half[a][k] * change[b][k]).sum::<f64>();
            same_block(|a, b| other.cameras[i][a][b], wanted, 6, &format!("{gauge:?}, view {i}"));
        }
        for j in 0..30 {
            let half: Matrix<3> = std::array::from_fn(|a| {
                std::array::from_fn(|b| (0..3).map(|k| s * r[a][k] * one.points[j][k][b]).sum())
            });
            let wanted = |a: usize, b: usize| (0..3).map(|k| half[a][k] * s * r[b][k]).sum::<f64>();
            same_block(|a, b| other.points[j][a][b], wanted, 3, &format!("{gauge:?}, point {j}"));
        }
    }
}

#[test]
fn relative_to_a_view_its_pose_is_certain() {
    let it = case(walk::<3>(6, 30, 1), 0.8, &[[0.0; 3]]);
    let found = covariance::<3, 6>(&it.tracks, &it.scene, &it.options, CovarianceGauge::View(4), SIGMA).unwrap();
    let trace = |i: usize| (0..6).map(|k| found.cameras[i][k][k].abs()).sum::<f64>();
    assert!(trace(4) < 1e-12 * trace(0), "{:?}", found.cameras[4]);
    // inner constraints have the least trace of centres of all gauges that fix a similarity
    let inner = covariance::<3, 6>(&it.tracks, &it.scene, &it.options, CovarianceGauge::Cameras, SIGMA).unwrap();
    let of_centers =
        |c: &Covariances<3, 6>| c.cameras.iter().map(|m| (3..6).map(|k| m[k][k]).sum::<f64>()).sum::<f64>();
    assert!(of_centers(&inner) < of_centers(&found));
}

#[test]
fn what_nothing_tells_of_has_no_covariance() {
    let it = case(walk::<3>(6, 30, 1), 1.0, &[[0.0; 3]]);
    let whole = covariance::<3, 6>(&it.tracks, &it.scene, &it.options, CovarianceGauge::Cameras, SIGMA).unwrap();
    assert!(whole.cameras.iter().flatten().flatten().all(|x| x.is_finite()));
    for n_seen in 0..3 {
        let mut scene = it.scene.clone();
        let t = &it.tracks;
        // view 5 keeps so many observations; point 7 is kept by one view alone
        let keep = |o: usize| (t.view()[o] != 5 || t.track()[o] < n_seen) && (t.track()[o] != 7 || t.view()[o] == 1);
        scene.inlier = (0..t.len()).map(keep).collect();
        let found = covariance::<3, 6>(t, &scene, &it.options, CovarianceGauge::Cameras, SIGMA).unwrap();
        for i in 0..6 {
            let nan = found.cameras[i].iter().flatten().all(|x| x.is_nan());
            let finite = found.cameras[i].iter().flatten().all(|x| x.is_finite());
            assert!(if i == 5 { nan } else { finite }, "{n_seen} observations, view {i}: {:?}", found.cameras[i]);
        }
        for j in 0..30 {
            assert_eq!(found.points[j][0][0].is_nan(), j == 7, "{n_seen} observations, point {j}");
        }
    }
    // a view of no component, or another one
    let mut scene = it.scene.clone();
    scene.view_component[5] = -1;
    let found = covariance::<3, 6>(&it.tracks, &scene, &it.options, CovarianceGauge::View(5), SIGMA).unwrap();
    assert!(found.cameras.iter().flatten().flatten().all(|x| x.is_nan()));
}

#[test]
fn what_is_held_has_no_uncertainty() {
    let mut it = case(walk::<3>(6, 30, 1), 1.0, &[[0.0; 3]]);
    it.options.held.points = (0..30).map(|j| j < 8).collect();
    it.options.held.centers = (0..6).map(|i| i == 2).collect();
    let found = covariance::<3, 6>(&it.tracks, &it.scene, &it.options, CovarianceGauge::Cameras, SIGMA).unwrap();
    for j in 0..30 {
        assert_eq!(found.points[j] == [[0.0; 3]; 3], j < 8, "point {j}");
        assert!(found.points[j].iter().flatten().all(|x| x.is_finite()));
    }
    assert!((3..6).all(|k| found.cameras[2][k][k] == 0.0) && found.cameras[2][0][0] > 0.0);
    assert!(found.cameras[3][3][3] > 0.0);
}

#[test]
fn what_is_not_determined_is_an_error() {
    let pair = case(walk::<2>(2, 20, 1), 1.0, &[[0.0; 2]]);
    assert!(covariance::<2, 3>(&pair.tracks, &pair.scene, &pair.options, CovarianceGauge::Cameras, SIGMA).is_err());
    let mut scene = walk::<3>(5, 20, 1);
    scene.centers.fill([1.0, 2.0, 3.0]);
    let it = case(scene, 1.0, &[[0.0; 3]]);
    assert!(covariance::<3, 6>(&it.tracks, &it.scene, &it.options, CovarianceGauge::Cameras, SIGMA).is_err());
    let good = case(walk::<3>(5, 20, 1), 1.0, &[[0.0; 3]]);
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = covariance::<3, 6>(&good.tracks, &good.scene, &good.options, CovarianceGauge::Cameras, sigma);
        assert!(error.unwrap_err().to_string().starts_with("sigma_rad is"));
    }
}
