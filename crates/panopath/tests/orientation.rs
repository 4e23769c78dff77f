//! Rotation averaging: exact, noisy, with wrong edges, with priors, degenerate.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::needless_range_loop)]

mod common;

use common::{DEG, Noise};
use panopath::geometry::{Matrix, Rotation, Vector, angle_between, norm};
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

#[test]
fn wrong_edges_that_agree_among_themselves_lose_against_the_majority() {
    let mut g = graph(60, &complete(60), 1.0 * DEG, 0.1, 3);
    let turn = Rotation::exp(&[0.0, 1.0, 0.5]);
    for (e, wrong) in g.edges.iter_mut().zip(&mut g.wrong) {
        // views below 10 see those from 50 up as if the world were another: a repeated structure
        if e.first < 10 && e.second >= 50 {
            let (a, b) = (&g.truth[e.first as usize], &g.truth[e.second as usize]);
            e.second_from_first = b.compose(&turn).compose(&a.inverse());
            *wrong = true;
        }
    }
    let found = solve(60, &g.edges, &[]);
    assert!(found.edge_inlier.iter().zip(&g.wrong).all(|(kept, wrong)| *kept != *wrong || !*kept));
    assert!(worst(&errors(&found, &g.truth, 0)) < 1.0 * DEG);
}

/// Twice the cost that the answer should minimise, over edges that were kept.
fn cost(found: &[Rotation<3>], edges: &[RelativeRotation<3>], keep: &[bool], priors: &[OrientationPrior<3>]) -> f64 {
    let kept = edges.iter().zip(keep).filter(|(_, k)| **k);
    let of_edges: f64 = kept
        .map(|(e, _)| {
            let predicted = e.second_from_first.compose(&found[e.first as usize]);
            (norm(&predicted.inverse().compose(&found[e.second as usize]).log()) / e.sigma_rad).powi(2)
        })
        .sum();
    let of_priors: f64 = priors
        .iter()
        .map(|p| {
            let now = &found[p.view as usize];
            match &p.kind {
                PriorKind::Orientation { cam_from_world, covariance_rad2 } => {
                    let phi = cam_from_world.compose(&now.inverse()).log();
                    let inverse = invert(covariance_rad2.iter().map(|r| r.to_vec()).collect());
                    (0..3).map(|r| (0..3).map(|c| phi[r] * inverse[r][c] * phi[c]).sum::<f64>()).sum::<f64>()
                }
                PriorKind::Gravity { up_in_cam, sigma_rad } => {
                    (angle_between(&now.apply(&[0.0, 0.0, 1.0]), up_in_cam) / sigma_rad).powi(2)
                }
                PriorKind::Heading { heading_rad, sigma_rad, forward } => {
                    let f = now.inverse().apply(forward);
                    let off = heading_rad - f[1].atan2(f[0]);
                    ((off - std::f64::consts::TAU * (off / std::f64::consts::TAU).round()) / sigma_rad).powi(2)
                }
            }
        })
        .sum();
    of_edges + of_priors
}

/// Newton's step that central differences of the cost still ask for, the longest of any view and axis.
fn remaining_step(g: &Graph, found: &Orientations<3>, priors: &[OrientationPrior<3>]) -> f64 {
    let h = 1e-4;
    let mut longest: f64 = 0.0;
    for view in 0..g.truth.len() {
        for axis in 0..3 {
            let at = |t: f64| {
                let mut moved = found.cam_from_world.clone();
                let turn: Vector<3> = std::array::from_fn(|k| if k == axis { t } else { 0.0 });
                moved[view] = Rotation::exp(&turn).compose(&moved[view]);
                cost(&moved, &g.edges, &found.edge_inlier, priors)
            };
            let (low, middle, high) = (at(-h), at(0.0), at(h));
            longest = longest.max((0.5 * (high - low) / h / ((high - 2.0 * middle + low) / (h * h))).abs());
        }
    }
    longest
}

fn gravity(truth: &Rotation<3>, view: u32, sigma_rad: f64, noise: &mut Noise) -> OrientationPrior<3> {
    let up_in_cam = small(noise, sigma_rad).compose(truth).apply(&[0.0, 0.0, 1.0]);
    OrientationPrior { view, kind: PriorKind::Gravity { up_in_cam, sigma_rad } }
}

fn compass(truth: &Rotation<3>, view: u32, sigma_rad: f64, noise: &mut Noise) -> OrientationPrior<3> {
    let forward = [0.0, 0.6, 0.8];
    let f = truth.inverse().apply(&forward);
    let heading_rad = f[1].atan2(f[0]) + sigma_rad * noise.normal();
    OrientationPrior { view, kind: PriorKind::Heading { heading_rad, sigma_rad, forward } }
}

fn imu(truth: &Rotation<3>, view: u32, noise: &mut Noise) -> OrientationPrior<3> {
    // a covariance with axes across the camera's: known well about one, badly about another
    let axes = random_rotation(noise);
    let sigmas = [0.3 * DEG, 2.0 * DEG, 5.0 * DEG];
    let turn = axes.apply(&std::array::from_fn(|k| sigmas[k] * noise.normal()));
    let m = axes.matrix();
    let covariance_rad2: Matrix<3> = std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..3).map(|k| m[r][k] * sigmas[k] * sigmas[k] * m[c][k]).sum())
    });
    let cam_from_world = Rotation::exp(&turn).compose(truth);
    OrientationPrior { view, kind: PriorKind::Orientation { cam_from_world, covariance_rad2 } }
}

#[test]
fn the_answer_is_stationary_whatever_the_priors() {
    let g = graph(12, &band(12, 3), 2.0 * DEG, 0.0, 5);
    let mut noise = Noise::new(6);
    let every = |f: &mut dyn FnMut(u32) -> OrientationPrior<3>| (0..12).map(f).collect::<Vec<_>>();
    let gravities = every(&mut |i| gravity(&g.truth[i as usize], i, 2.0 * DEG, &mut noise));
    let imus = every(&mut |i| imu(&g.truth[i as usize], i, &mut noise));
    let compasses = every(&mut |i| compass(&g.truth[i as usize], i, 3.0 * DEG, &mut noise));
    let some = |a: &[OrientationPrior<3>], b: &[OrientationPrior<3>]| [&a[..4], &b[3..8]].concat();
    for (what, priors) in [
        ("none", vec![]),
        ("gravity", gravities.clone()),
        ("some gravity", gravities[2..5].to_vec()),
        ("imu", imus.clone()),
        ("one imu", imus[7..8].to_vec()),
        ("gravity and compass", some(&gravities, &compasses)),
        ("imu and gravity", some(&imus, &gravities)),
        ("all", [gravities, imus, compasses].concat()),
    ] {
        let found = solve(12, &g.edges, &priors);
        assert_eq!(found.status, OrientationStatus::Converged, "{what}");
        let step = remaining_step(&g, &found, &priors);
        assert!(step < 1e-8, "{what}: {step}");
    }
}

#[test]
fn a_world_turned_turns_the_answer_and_nothing_else() {
    let g = graph(20, &band(20, 4), 1.0 * DEG, 0.1, 7);
    let mut noise = Noise::new(8);
    let priors: Vec<_> = (0..20).step_by(3).map(|i| imu(&g.truth[i], i as u32, &mut noise)).collect();
    let turn = random_rotation(&mut noise);
    let turned: Vec<_> = priors
        .iter()
        .map(|p| {
            let PriorKind::Orientation { cam_from_world, covariance_rad2 } = p.kind else { unreachable!() };
            let cam_from_world = cam_from_world.compose(&turn);
            OrientationPrior { view: p.view, kind: PriorKind::Orientation { cam_from_world, covariance_rad2 } }
        })
        .collect();
    let (a, b) = (solve(20, &g.edges, &priors), solve(20, &g.edges, &turned));
    assert_eq!(a.edge_inlier, b.edge_inlier);
    for (x, y) in a.cam_from_world.iter().zip(&b.cam_from_world) {
        assert!(norm(&x.compose(&turn).inverse().compose(y).log()) < 1e-9);
    }
}

#[test]
fn direction_and_order_of_edges_do_not_matter() {
    let g = graph(30, &band(30, 5), 1.0 * DEG, 0.2, 9);
    let order = Noise::new(10).permutation(g.edges.len());
    let shuffled: Vec<_> = order
        .iter()
        .map(|&k| {
            let e = g.edges[k];
            let back = e.second_from_first.inverse();
            if k % 2 == 0 {
                e
            } else {
                RelativeRotation { first: e.second, second: e.first, second_from_first: back, ..e }
            }
        })
        .collect();
    let (a, b) = (solve(30, &g.edges, &[]), solve(30, &shuffled, &[]));
    for (place, &k) in order.iter().enumerate() {
        assert_eq!(a.edge_inlier[k], b.edge_inlier[place]);
    }
    for (x, y) in a.cam_from_world.iter().zip(&b.cam_from_world) {
        assert!(norm(&x.inverse().compose(y).log()) < 1e-9);
    }
}

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    let g = graph(600, &band(600, 12), 1.0 * DEG, 0.2, 11);
    let mut noise = Noise::new(12);
    let priors: Vec<_> = (0..600).step_by(7).map(|i| gravity(&g.truth[i], i as u32, 1.0 * DEG, &mut noise)).collect();
    let on = |n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| solve(600, &g.edges, &priors))
    };
    let (one, three) = (on(1), on(3));
    assert_eq!(one.cam_from_world, three.cam_from_world);
    assert_eq!(one.residual_rad, three.residual_rad);
}

#[test]
fn a_tight_vertical_leaves_turns_about_it() {
    for share in [0.0, 0.3] {
        let g = graph(80, &band(80, 8), 1.0 * DEG, share, 13);
        let mut noise = Noise::new(14);
        let priors: Vec<_> = (0..80).map(|i| gravity(&g.truth[i], i as u32, 1e-4 * DEG, &mut noise)).collect();
        let found = solve(80, &g.edges, &priors);
        for (r, p) in found.cam_from_world.iter().zip(&priors) {
            let PriorKind::Gravity { up_in_cam, .. } = p.kind else { unreachable!() };
            assert!(angle_between(&r.apply(&[0.0, 0.0, 1.0]), &up_in_cam) < 1e-12);
        }
        let alone = rms(&errors(&solve(80, &g.edges, &[]), &g.truth, 0));
        let error = rms(&errors(&found, &g.truth, 0));
        // one freedom of three is left
        assert!(error < 0.85 * alone, "{error} against {alone}");
        let mistaken = g.wrong.iter().zip(&found.edge_inlier).filter(|(wrong, kept)| **wrong == **kept).count();
        assert!(mistaken <= 3, "{mistaken} edges mistaken");
        // the first view is as near the identity as its vertical lets it
        let tilt = angle_between(&found.cam_from_world[0].apply(&[0.0, 0.0, 1.0]), &[0.0, 0.0, 1.0]);
        assert!((norm(&found.cam_from_world[0].log()) - tilt).abs() < 1e-9);
    }
}

#[test]
fn edges_better_than_their_vertical_are_not_bent_to_it() {
    let mut g = graph(80, &band(80, 8), 0.005 * DEG, 0.1, 30);
    let mut noise = Noise::new(31);
    let priors: Vec<_> = (0..80).map(|i| gravity(&g.truth[i], i as u32, 0.09 * DEG, &mut noise)).collect();
    for e in &mut g.edges {
        e.sigma_rad = 1.0 * DEG;
    }
    let options = OrientationOptions { estimate_noise: true, ..Default::default() };
    let found = average_rotations(80, &g.edges, &priors, &options).unwrap();
    let error = worst(&errors(&found, &g.truth, 0));
    assert!(error < 0.02 * DEG, "{}", error / DEG);
}

#[test]
fn hubs_and_unequal_edges_are_ordinary() {
    let star: Pairs = (1..3000).map(|i| (0, i)).collect();
    let g = graph(3000, &star, 1.0 * DEG, 0.0, 32);
    assert_eq!(solve(3000, &g.edges, &[]).status, OrientationStatus::Converged);
    let mut g = graph(40, &band(40, 6), 1e-6, 0.0, 33);
    for (k, e) in g.edges.iter_mut().enumerate() {
        e.sigma_rad = [1e-6, 1.0, 1e-3][k % 3];
    }
    let found = solve(40, &g.edges, &[]);
    assert!(worst(&errors(&found, &g.truth, 0)) < 1e-4);
}

#[test]
fn a_vertical_in_some_views_helps_all_and_levels_the_world() {
    let g = graph(100, &band(100, 3), 1.0 * DEG, 0.1, 15);
    let mut noise = Noise::new(16);
    let priors: Vec<_> = (0..100).step_by(2).map(|i| gravity(&g.truth[i], i as u32, 0.05 * DEG, &mut noise)).collect();
    let found = solve(100, &g.edges, &priors);
    let tilt = |r: &Rotation<3>, t: &Rotation<3>| angle_between(&r.apply(&[0.0, 0.0, 1.0]), &t.apply(&[0.0, 0.0, 1.0]));
    let tilts: Vec<f64> = found.cam_from_world.iter().zip(&g.truth).map(|(r, t)| tilt(r, t)).collect();
    assert!(worst(&tilts) < 2.5 * DEG && rms(&tilts) < 0.7 * DEG, "{} {}", worst(&tilts), rms(&tilts));
    let alone = rms(&errors(&solve(100, &g.edges, &[]), &g.truth, 0));
    let error = rms(&errors(&found, &g.truth, 0));
    assert!(error < 0.9 * alone, "{error} against {alone}");
}

#[test]
fn compass_and_gravity_give_the_world_itself() {
    let g = graph(30, &band(30, 4), 0.5 * DEG, 0.0, 17);
    let mut noise = Noise::new(18);
    for sigma in [1e-3 * DEG, 0.5 * DEG] {
        let mut priors: Vec<_> = (0..30).map(|i| gravity(&g.truth[i], i as u32, sigma, &mut noise)).collect();
        priors.extend((0..30).step_by(5).map(|i| compass(&g.truth[i], i as u32, 0.5 * DEG, &mut noise)));
        let found = solve(30, &g.edges, &priors);
        let off: Vec<f64> =
            found.cam_from_world.iter().zip(&g.truth).map(|(r, t)| norm(&r.inverse().compose(t).log())).collect();
        assert!(worst(&off) < 1.5 * DEG, "sigma {sigma}: {}", worst(&off));
    }
    // a compass without a vertical says nothing: the first view keeps the identity
    let lost = solve(30, &g.edges, &[compass(&g.truth[3], 3, 0.5 * DEG, &mut noise)]);
    assert_eq!(*lost.cam_from_world[0].matrix(), *Rotation::<3>::identity().matrix());
}

#[test]
fn covariances_are_those_of_a_dense_inverse() {
    let g = graph(15, &band(15, 3), 1.0 * DEG, 0.0, 19);
    let options = OrientationOptions { covariance: true, ..Default::default() };
    let found = average_rotations(15, &g.edges, &[], &options).unwrap();
    let mut l = vec![vec![0.0; 15]; 15];
    for e in &g.edges {
        let (a, b, w) = (e.first as usize, e.second as usize, e.sigma_rad.powi(-2));
        l[a][a] += w;
        l[b][b] += w;
        l[a][b] -= w;
        l[b][a] -= w;
    }
    let pinned = invert((1..15).map(|r| l[r][1..].to_vec()).collect());
    for view in 0..15 {
        let expected = if view == 0 { 0.0 } else { pinned[view - 1][view - 1] };
        for r in 0..3 {
            for c in 0..3 {
                let wanted = if r == c { expected } else { 0.0 };
                assert!((found.covariance_rad2[view][r][c] - wanted).abs() < 1e-6 * (1.0 * DEG).powi(2), "view {view}");
            }
        }
    }
    // an orientation alone, coupled: its own covariance comes back
    let mut noise = Noise::new(20);
    let prior = imu(&g.truth[0], 0, &mut noise);
    let found = average_rotations(1, &[], &[prior], &options).unwrap();
    let PriorKind::Orientation { covariance_rad2, .. } = prior.kind else { unreachable!() };
    for (a, b) in found.covariance_rad2[0].iter().flatten().zip(covariance_rad2.iter().flatten()) {
        assert!((a - b).abs() < 1e-12);
    }
}

#[test]
fn what_nothing_holds_together_comes_apart() {
    // two rings and a lone view
    let mut pairs = ring(5);
    pairs.extend(ring(7).iter().map(|(a, b)| (a + 5, b + 5)));
    let g = graph(13, &pairs, 1.0 * DEG, 0.0, 21);
    let found = solve(13, &g.edges, &[]);
    assert_eq!(found.status, OrientationStatus::Disconnected);
    assert_eq!(found.view_component, [[1; 5].as_slice(), &[0; 7], &[-1]].concat());
    for first in [0, 5] {
        assert_eq!(*found.cam_from_world[first].matrix(), *Rotation::<3>::identity().matrix());
    }
    // priors place parts, and single views, in one world
    let mut noise = Noise::new(22);
    let priors: Vec<_> = [1, 6, 12].map(|i| imu(&g.truth[i], i as u32, &mut noise)).to_vec();
    let found = solve(13, &g.edges, &priors);
    assert_eq!(found.view_component[12], 2);
    let off = norm(&found.cam_from_world[9].inverse().compose(&g.truth[9]).log());
    assert!(off < 20.0 * DEG, "{off}");
}

/// Two complete graphs of six views and edges between them, each with a rotation of its own before the true one.
fn joined_by(errors: &[[f64; 3]]) -> Graph {
    let mut pairs = complete(6);
    pairs.extend(complete(6).iter().map(|(a, b)| (a + 6, b + 6)));
    pairs.extend((0..errors.len() as u32).map(|k| (k, 11 - k)));
    let mut g = graph(12, &pairs, 1.0 * DEG, 0.0, 23);
    for (e, phi) in g.edges[30..].iter_mut().zip(errors) {
        e.second_from_first = Rotation::exp(phi).compose(&e.second_from_first);
    }
    g
}

#[test]
fn a_join_that_only_wrong_edges_make_is_no_join() {
    let (x, y, z) = ([1.0, 0.0, 0.0], [0.0, 1.5, 0.0], [0.0, 0.0, -1.2]);
    let parts = |errors: &[[f64; 3]]| {
        let g = joined_by(errors);
        let found = solve(12, &g.edges, &[]);
        (found.view_component.iter().max().unwrap() + 1, found.edge_inlier[30..].to_vec())
    };
    assert_eq!(parts(&[[0.0; 3]]), (1, vec![true]), "one edge, nothing against it");
    assert_eq!(parts(&[x, y]), (2, vec![false; 2]), "word against word");
    assert_eq!(parts(&[x, y, z]), (2, vec![false; 3]), "three that disagree");
    assert_eq!(
        parts(&[x, [0.0; 3], y, [0.0; 3]]),
        (1, vec![false, true, false, true]),
        "two that agree, two that do not"
    );
    // a chain with a wrong closure is still the best guess
    let mut g = graph(12, &ring(12), 0.5 * DEG, 0.0, 24);
    g.edges[11].second_from_first = Rotation::exp(&[2.0, 0.0, 0.0]).compose(&g.edges[11].second_from_first);
    assert_eq!(solve(12, &g.edges, &[]).view_component.iter().max(), Some(&0));
}

#[test]
fn nothing_and_next_to_nothing_are_answers() {
    for n in [0, 1, 3] {
        let found = solve(n, &[], &[]);
        assert_eq!((found.status, found.iterations <= 60), (OrientationStatus::Undetermined, true));
        assert!(found.view_component.iter().all(|&c| c == -1) && found.sigma_rad.is_nan());
    }
    let found = average_rotations::<2>(0, &[], &[], &OrientationOptions::default()).unwrap();
    assert_eq!(found.status, OrientationStatus::Undetermined);
}

#[test]
fn what_cannot_be_used_is_named() {
    let g = graph(4, &ring(4), 1.0 * DEG, 0.0, 25);
    let refused = |change: &dyn Fn(&mut Vec<RelativeRotation<3>>), priors: &[OrientationPrior<3>]| {
        let mut edges = g.edges.clone();
        change(&mut edges);
        average_rotations(4, &edges, priors, &OrientationOptions::default()).unwrap_err().to_string()
    };
    let nan = Rotation::exp(&[f64::NAN; 3]);
    assert_eq!(refused(&|e| e[2].second = 4, &[]), "edges[2] names the view 4, expected one below 4");
    assert_eq!(refused(&|e| e[1].second = 1, &[]), "edges[1] joins the view 1 with itself, expected two views");
    assert_eq!(refused(&|e| e[3].second_from_first = nan, &[]), "edges[3] has a rotation that is not finite");
    assert!(refused(&|e| e[0].sigma_rad = 0.0, &[]).starts_with("edges[0] has sigma_rad 0"));
    assert!(refused(&|e| e[0].sigma_rad = f64::NAN, &[]).starts_with("edges[0] has sigma_rad NaN"));
    let again = refused(&|e| e.push(RelativeRotation { first: 2, second: 1, ..e[1] }), &[]);
    assert_eq!(again, "edges[4] joins the views 1 and 2 again, as edges[1] does, expected each pair once");
    let prior = |view, kind| vec![OrientationPrior { view, kind }];
    let up = |v: [f64; 3], sigma_rad| PriorKind::Gravity { up_in_cam: v, sigma_rad };
    let z = [0.0, 0.0, 1.0];
    assert!(refused(&|_| (), &prior(4, up(z, 0.1))).starts_with("priors[0] names the view 4"));
    assert!(refused(&|_| (), &prior(0, up([0.0; 3], 0.1))).starts_with("priors[0] has up_in_cam of length 0"));
    assert!(refused(&|_| (), &prior(0, up([f64::NAN; 3], 0.1))).contains("up_in_cam of length NaN"));
    assert!(refused(&|_| (), &prior(0, up(z, -1.0))).contains("sigma_rad -1"));
    let twice = [prior(0, up(z, 0.1)), prior(0, up(z, 0.1))].concat();
    assert!(refused(&|_| (), &twice).starts_with("priors[1] is the second of its kind for the view 0"));
    for covariance_rad2 in [[[0.0; 3]; 3], [[f64::NAN; 3]; 3], [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]] {
        let kind = PriorKind::Orientation { cam_from_world: Rotation::identity(), covariance_rad2 };
        assert!(refused(&|_| (), &prior(1, kind)).contains("not symmetric and positive definite"));
    }
    let planar = OrientationPrior::<2> { view: 0, kind: PriorKind::Gravity { up_in_cam: z, sigma_rad: 0.1 } };
    let error = average_rotations::<2>(1, &[], &[planar], &OrientationOptions::default()).unwrap_err();
    assert_eq!(error.to_string(), "priors[0] is a gravity, which the plane has not");
}

#[test]
fn the_noise_is_found_where_it_is_not_stated() {
    for noise in [0.01, 1.0, 4.0] {
        let mut g = graph(80, &band(80, 8), noise * DEG, 0.2, 26);
        for e in &mut g.edges {
            e.sigma_rad = 1.0 * DEG;
        }
        let options = OrientationOptions { estimate_noise: true, ..Default::default() };
        let found = average_rotations(80, &g.edges, &[], &options).unwrap();
        let ratio = found.sigma_rad / (noise * DEG);
        assert!((0.85..1.15).contains(&ratio), "{noise}: {ratio}");
        let mistaken = g.wrong.iter().zip(&found.edge_inlier).filter(|(wrong, kept)| **wrong == **kept).count();
        assert!(mistaken <= 6, "{noise}: {mistaken} edges mistaken");
    }
}

fn planar_graph(n: usize, pairs: &Pairs, sigma: f64, share: f64, seed: u64) -> (Vec<f64>, Vec<RelativeRotation<2>>) {
    let mut noise = Noise::new(seed);
    let truth: Vec<f64> = (0..n).map(|_| std::f64::consts::TAU * noise.uniform()).collect();
    let edges = pairs.iter().map(|&(first, second)| {
        let exact = truth[second as usize] - truth[first as usize];
        let wrong = noise.uniform() < share;
        let angle = if wrong { std::f64::consts::TAU * noise.uniform() } else { exact + sigma * noise.normal() };
        RelativeRotation { first, second, second_from_first: Rotation::from_angle(angle), sigma_rad: sigma.max(1e-4) }
    });
    let edges = edges.collect();
    (truth, edges)
}

#[test]
fn headings_in_the_plane() {
    for (sigma, share, tolerance) in [(0.0, 0.0, 1e-12), (1.0 * DEG, 0.0, 2.0 * DEG), (1.0 * DEG, 0.3, 2.0 * DEG)] {
        let (truth, edges) = planar_graph(60, &band(60, 8), sigma, share, 27);
        let found = average_rotations(60, &edges, &[], &OrientationOptions::default()).unwrap();
        assert_eq!(found.status, OrientationStatus::Converged);
        assert!(found.cam_from_world[0].angle().abs() < 1e-15);
        for (r, t) in found.cam_from_world.iter().zip(&truth) {
            let off = Rotation::from_angle(t - truth[0]).inverse().compose(r).angle();
            assert!(off.abs() < tolerance, "{sigma} {share}: {off}");
        }
        // a compass on one view, an orientation on another: both say where the world's x is
        let heading = OrientationPrior {
            view: 5,
            kind: PriorKind::Heading { heading_rad: -truth[5], sigma_rad: 1e-3, forward: [1.0, 0.0, 0.0] },
        };
        let mut covariance_rad2 = [[0.0; 3]; 3];
        covariance_rad2[2][2] = 1e-6;
        let cam_from_world = Rotation::from_angle(truth[50]);
        let whole = OrientationPrior { view: 50, kind: PriorKind::Orientation { cam_from_world, covariance_rad2 } };
        let found = average_rotations(60, &edges, &[heading, whole], &OrientationOptions::default()).unwrap();
        for (r, t) in found.cam_from_world.iter().zip(&truth) {
            let off = Rotation::from_angle(*t).inverse().compose(r).angle();
            assert!(off.abs() < tolerance.max(1e-9), "{sigma} {share} with priors: {off}");
        }
    }
}
