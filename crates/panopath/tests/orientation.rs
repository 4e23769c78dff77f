//! Rotation averaging: exact, noisy, with wrong edges, with priors, degenerate.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::needless_range_loop)]

mod common;

use common::{DEG, Noise};
use panopath::geometry::{Matrix, Rotation, Vector, norm, normalized};
use panopath::orientation::*;

type Pairs = Vec<(u32, u32)>;

/// True orientations, and edges measured between them.
struct Graph {
    truth: Vec<Rotation<3>>,
    edges: Vec<RelativeRotation<3>>,
    wrong: Vec<bool>,
}

fn random_rotation(noise: &mut Noise) -> Rotation<3> {
    let q: [f64; 4] = std::array::from_fn(|_| noise.normal());
    Rotation::from_quaternion(&q)
}

fn small(noise: &mut Noise, sigma: f64) -> Rotation<3> {
    Rotation::exp(&std::array::from_fn(|_| sigma * noise.normal()))
}

fn graph(n: usize, pairs: &Pairs, sigma: f64, wrong_share: f64, seed: u64) -> Graph {
    let mut noise = Noise::new(seed);
    let truth: Vec<Rotation<3>> = (0..n).map(|_| random_rotation(&mut noise)).collect();
    let mut wrong = Vec::new();
    let edges = pairs
        .iter()
        .map(|&(first, second)| {
            let is_wrong = noise.uniform() < wrong_share;
            wrong.push(is_wrong);
            let exact = truth[second as usize].compose(&truth[first as usize].inverse());
            let second_from_first =
                if is_wrong { random_rotation(&mut noise) } else { small(&mut noise, sigma).compose(&exact) };
            RelativeRotation { first, second, second_from_first, sigma_rad: sigma.max(0.01 * DEG) }
        })
        .collect();
    Graph { truth, edges, wrong }
}

fn chain(n: u32) -> Pairs {
    (1..n).map(|i| (i - 1, i)).collect()
}

fn ring(n: u32) -> Pairs {
    (0..n).map(|i| (i, (i + 1) % n)).collect()
}

fn complete(n: u32) -> Pairs {
    (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).collect()
}

fn grid(side: u32) -> Pairs {
    let at = move |x: u32, y: u32| y * side + x;
    let right = (0..side).flat_map(move |y| (1..side).map(move |x| (at(x - 1, y), at(x, y))));
    right.chain((1..side).flat_map(move |y| (0..side).map(move |x| (at(x, y - 1), at(x, y))))).collect()
}

/// Each view with the next `reach`, as along a path.
fn band(n: u32, reach: u32) -> Pairs {
    (0..n).flat_map(|i| (i + 1..=(i + reach).min(n - 1)).map(move |j| (i, j))).collect()
}

fn solve(n: usize, edges: &[RelativeRotation<3>], priors: &[OrientationPrior<3>]) -> Orientations<3> {
    let found = average_rotations(n, edges, priors, &OrientationOptions::default()).unwrap();
    check_invariants(n, edges, &found);
    found
}

/// What holds for every answer.
fn check_invariants(n: usize, edges: &[RelativeRotation<3>], found: &Orientations<3>) {
    assert_eq!((found.cam_from_world.len(), found.view_component.len()), (n, n));
    assert_eq!((found.edge_inlier.len(), found.residual_rad.len()), (edges.len(), edges.len()));
    for (view, (r, &c)) in found.cam_from_world.iter().zip(&found.view_component).enumerate() {
        assert_eq!(Rotation::from_matrix(*r.matrix()).is_some(), c >= 0, "view {view} in component {c}: {r:?}");
    }
    for (k, e) in edges.iter().enumerate() {
        let (a, b) = (e.first as usize, e.second as usize);
        let one = found.view_component[a] >= 0 && found.view_component[a] == found.view_component[b];
        assert_eq!(one, found.residual_rad[k].is_finite(), "edge {k}");
        assert!(one || !found.edge_inlier[k]);
        if one {
            let predicted = found.cam_from_world[b].compose(&found.cam_from_world[a].inverse());
            let angle = norm(&e.second_from_first.inverse().compose(&predicted).log());
            assert!((angle - found.residual_rad[k]).abs() < 1e-7, "edge {k}");
        }
    }
}

/// Angles to the truth of the views of component `c`, after the rotation of the world that fits best on average.
fn errors(found: &Orientations<3>, truth: &[Rotation<3>], c: i32) -> Vec<f64> {
    let own: Vec<usize> = (0..truth.len()).filter(|&i| found.view_component[i] == c).collect();
    let between = |i: usize| found.cam_from_world[i].inverse().compose(&truth[i]);
    let mut turn = between(own[0]);
    for _ in 0..20 {
        let mut mean = [0.0; 3];
        for &i in &own {
            let off = turn.inverse().compose(&between(i)).log();
            let length = norm(&off).max(1e-9);
            // a robust mean: lengths count little beyond the usual
            mean = std::array::from_fn(|k| mean[k] + off[k] / (own.len() as f64 * (1.0 + length / (5.0 * DEG))));
        }
        turn = turn.compose(&Rotation::exp(&mean));
    }
    own.iter().map(|&i| norm(&turn.inverse().compose(&between(i)).log())).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn worst(values: &[f64]) -> f64 {
    values.iter().copied().fold(0.0, f64::max)
}

#[test]
fn exact_edges_are_recovered_on_every_graph() {
    for (what, n, pairs) in [
        ("chain", 40, chain(40)),
        ("ring", 40, ring(40)),
        ("complete", 12, complete(12)),
        ("grid", 36, grid(6)),
        ("band", 60, band(60, 5)),
        ("pair", 2, chain(2)),
    ] {
        let g = graph(n, &pairs, 0.0, 0.0, 1);
        let found = solve(n, &g.edges, &[]);
        assert_eq!(found.status, OrientationStatus::Converged, "{what}");
        assert!(found.edge_inlier.iter().all(|&k| k), "{what}");
        assert!(worst(&errors(&found, &g.truth, 0)) < 1e-12, "{what}: {}", worst(&errors(&found, &g.truth, 0)));
        assert_eq!(
            *found.cam_from_world[0].matrix(),
            *Rotation::<3>::identity().matrix(),
            "{what}: the first view's frame"
        );
    }
}

/// Sum over views of the trace of the covariance that least squares has, from a dense inverse of the Laplacian.
fn bound(n: usize, edges: &[RelativeRotation<3>], keep: &[bool]) -> f64 {
    // centred gauge: pseudo-inverse = (L + 11^T/n)^-1 - 11^T/n
    let mut l = vec![vec![1.0 / n as f64; n]; n];
    for (e, _) in edges.iter().zip(keep).filter(|(_, k)| **k) {
        let (a, b, w) = (e.first as usize, e.second as usize, e.sigma_rad.powi(-2));
        l[a][a] += w;
        l[b][b] += w;
        l[a][b] -= w;
        l[b][a] -= w;
    }
    let inverse = invert(l);
    let trace: f64 = (0..n).map(|i| inverse[i][i]).sum::<f64>() - 1.0;
    (3.0 * trace / n as f64).sqrt()
}

/// Gauss and Jordan with pivots.
fn invert(mut a: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let n = a.len();
    let mut b: Vec<Vec<f64>> = (0..n).map(|i| (0..n).map(|j| f64::from(u8::from(i == j))).collect()).collect();
    for c in 0..n {
        let p = (c..n).max_by(|&x, &y| a[x][c].abs().total_cmp(&a[y][c].abs())).unwrap();
        a.swap(c, p);
        b.swap(c, p);
        let d = a[c][c];
        for j in 0..n {
            a[c][j] /= d;
            b[c][j] /= d;
        }
        for r in (0..n).filter(|&r| r != c) {
            let f = a[r][c];
            for j in 0..n {
                let (x, y) = (a[c][j], b[c][j]);
                a[r][j] -= f * x;
                b[r][j] -= f * y;
            }
        }
    }
    b
}

#[test]
fn noise_comes_out_at_the_least_squares_bound() {
    for (what, n, pairs) in
        [("complete", 30, complete(30)), ("grid", 100, grid(10)), ("band", 100, band(100, 8)), ("ring", 30, ring(30))]
    {
        let (mut squares, mut expected) = (0.0, 0.0);
        for seed in 0..8 {
            let g = graph(n, &pairs, 1.0 * DEG, 0.0, seed);
            let found = solve(n, &g.edges, &[]);
            assert!(found.edge_inlier.iter().filter(|k| !**k).count() <= 2, "{what}");
            squares += rms(&errors(&found, &g.truth, 0)).powi(2);
            expected += bound(n, &g.edges, &vec![true; g.edges.len()]).powi(2);
        }
        let ratio = (squares / expected).sqrt();
        assert!((0.6..1.25).contains(&ratio), "{what}: error over bound {ratio}");
    }
}

#[test]
fn wrong_edges_are_found_and_cost_nothing() {
    for (what, n, pairs, share) in [
        ("complete", 40, complete(40), 0.4),
        ("band", 200, band(200, 10), 0.3),
        ("band", 400, band(400, 15), 0.4),
        ("grid", 400, grid(20), 0.1),
    ] {
        for seed in 0..4 {
            let g = graph(n, &pairs, 1.0 * DEG, share, seed);
            let found = solve(n, &g.edges, &[]);
            let good: Vec<bool> = g.wrong.iter().map(|w| !w).collect();
            let solved = found.view_component.iter().filter(|c| **c == 0).count();
            assert!(solved as f64 >= 0.97 * n as f64, "{what} {share} seed {seed}: {solved} of {n}");
            let count = |f: &dyn Fn(usize) -> bool| (0..g.edges.len()).filter(|&k| f(k)).count() as f64;
            let kept_wrong = count(&|k| g.wrong[k] && found.edge_inlier[k]);
            let lost_good = count(&|k| !g.wrong[k] && !found.edge_inlier[k]);
            // on a grid a view with two good and two wrong edges has no majority
            let unlucky = if what == "grid" { 0.015 * g.edges.len() as f64 } else { 2.0 };
            assert!(kept_wrong <= unlucky, "{what} {share} seed {seed}: kept {kept_wrong}");
            assert!(
                lost_good <= 0.002 * g.edges.len() as f64 + unlucky,
                "{what} {share} seed {seed}: lost {lost_good}"
            );
            if what != "grid" {
                let ratio = rms(&errors(&found, &g.truth, 0)) / bound(n, &g.edges, &good);
                assert!(ratio < 2.0, "{what} {share} seed {seed}: error over bound {ratio}");
            }
        }
    }
}
