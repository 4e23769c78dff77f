//! Relative orientation of two views: exact, noisy, with false matches, degenerate.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr)]

mod common;

use common::{DEG, Noise};
use panopath::geometry::*;
use panopath::two_view::*;

/// A pair of views and what they saw.
struct Case {
    second_from_first: Rotation<3>,
    center: Vector<3>,
    points: Vec<Vector<3>>,
    first: Vec<Vector<3>>,
    second: Vec<Vector<3>>,
    outlier: Vec<bool>,
}

fn cross(a: &Vector<3>, b: &Vector<3>) -> Vector<3> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn shaken(noise: &mut Noise, b: &Vector<3>, sigma: f64) -> Vector<3> {
    let [s, t] = tangent_basis(b);
    normalized(&add(b, &add(&scale(sigma * noise.normal(), &s), &scale(sigma * noise.normal(), &t))))
}

impl Case {
    fn new(points: Vec<Vector<3>>, turn: &Vector<3>, center: Vector<3>) -> Self {
        let second_from_first = Rotation::exp(turn);
        let first = points.iter().map(normalized).collect();
        let second = points.iter().map(|x| second_from_first.apply(&normalized(&sub(x, &center)))).collect();
        let outlier = vec![false; points.len()];
        Self { second_from_first, center, points, first, second, outlier }
    }

    /// Points all around, from 2 to 12 baselines away, cameras turned at random.
    fn around(n: usize, seed: u64) -> Self {
        let mut noise = Noise::new(seed);
        let points = (0..n).map(|_| scale(2.0 + 10.0 * noise.uniform(), &noise.direction())).collect();
        let turn = scale(std::f64::consts::PI * noise.uniform(), &noise.direction());
        let center = noise.direction();
        Self::new(points, &turn, center)
    }

    /// Points in a field of 70 degrees.
    fn ahead(n: usize, depth: impl Fn(f64, &Vector<3>) -> f64, center: Vector<3>, seed: u64) -> Self {
        let mut noise = Noise::new(seed);
        let half = (35.0 * DEG).tan();
        let points = (0..n)
            .map(|_| {
                let mut across = || half * (2.0 * noise.uniform() - 1.0);
                let b = normalized(&[across(), across(), 1.0]);
                scale(depth(noise.uniform(), &b), &b)
            })
            .collect();
        let turn = [0.1 * noise.normal(), 0.1 * noise.normal(), 0.1 * noise.normal()];
        Self::new(points, &turn, center)
    }

    /// The same views from one place.
    fn without_baseline(mut self) -> Self {
        self.center = [0.0; 3];
        self.second = self.first.iter().map(|b| self.second_from_first.apply(b)).collect();
        self
    }

    /// Both bearings moved, and a share of the second ones replaced.
    fn seen_badly(mut self, sigma: f64, share: f64, seed: u64) -> Self {
        let mut noise = Noise::new(seed ^ 0x5EED);
        for b in self.first.iter_mut().chain(&mut self.second) {
            *b = shaken(&mut noise, b, sigma);
        }
        let n = self.first.len();
        for i in noise.permutation(n).into_iter().take((share * n as f64).round() as usize) {
            self.second[i] = noise.direction();
            self.outlier[i] = true;
        }
        self
    }

    fn solve(&self) -> TwoView {
        self.solve_with(&TwoViewOptions::default())
    }

    fn solve_with(&self, options: &TwoViewOptions) -> TwoView {
        let view = relative_pose(&self.first, &self.second, options).unwrap();
        check_invariants(&view, self.first.len());
        view
    }

    fn rotation_error(&self, view: &TwoView) -> f64 {
        norm(&turn_between(&view.second_from_first, &self.second_from_first))
    }

    fn direction_error(&self, view: &TwoView) -> f64 {
        angle_between(&view.direction, &normalized(&self.center))
    }

    /// Root of the trace of the least covariance that rotation and direction can have, at the truth.
    fn bound(&self, sigma: f64) -> (f64, f64) {
        let s = normalized(&self.second_from_first.apply(&self.center));
        let basis = tangent_basis(&s);
        let mut information = [[0.0; 5]; 5];
        for (x, _) in self.points.iter().zip(&self.outlier).filter(|(_, o)| !**o) {
            let q = self.second_from_first.apply(&normalized(x));
            let b = self.second_from_first.apply(&normalized(&sub(x, &self.center)));
            let (normal, lever) = (cross(&q, &b), cross(&q, &cross(&b, &s)));
            let g = (dot(&cross(&s, &q), &cross(&s, &q)) + dot(&cross(&s, &b), &cross(&s, &b))).sqrt();
            let j = [lever[0], lever[1], lever[2], dot(&normal, &basis[0]), dot(&normal, &basis[1])];
            for r in 0..5 {
                for c in 0..5 {
                    information[r][c] += j[r] * j[c] / (g * g * sigma * sigma);
                }
            }
        }
        let (values, vectors) = panopath::least_squares::symmetric_eigen(&information).unwrap();
        let mut rotation = 0.0;
        let mut direction = 0.0;
        for (value, v) in values.iter().zip(&vectors) {
            rotation += (0..3).map(|c| v[c] * v[c]).sum::<f64>() / value;
            // the direction in the first frame moves by the tangent part of (s moved) - phi x s
            let moved = [3, 4].map(|k| v[k] + dot(&[v[0], v[1], v[2]], &cross(&basis[k - 3], &s)));
            direction += dot(&moved, &moved) / value;
        }
        (rotation.sqrt(), direction.sqrt())
    }
}

fn turn_between(a: &Rotation<3>, b: &Rotation<3>) -> Vector<3> {
    let m = *a.compose(&b.inverse()).matrix();
    let axis = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
    let angle = (0.5 * norm(&axis)).atan2(0.5 * (m[0][0] + m[1][1] + m[2][2] - 1.0));
    if angle < 1e-300 { [0.0; 3] } else { scale(angle, &normalized(&axis)) }
}

fn check_invariants(view: &TwoView, n: usize) {
    assert_eq!(view.inlier.len(), n);
    assert_eq!(view.n_inliers, view.inlier.iter().filter(|&&k| k).count());
    let known = view.status != TwoViewStatus::Undetermined;
    let directed = matches!(view.status, TwoViewStatus::General | TwoViewStatus::Planar);
    assert_eq!(view.sigma_rad.is_finite(), known);
    assert!(view.rotation_covariance.iter().flatten().all(|x| x.is_finite() == known));
    assert!(view.direction_covariance.iter().flatten().all(|x| x.is_finite() == directed));
    assert!(view.direction.iter().all(|x| x.is_finite() == directed));
    assert!(!directed || (norm(&view.direction) - 1.0).abs() < 1e-12);
    assert!(Rotation::from_matrix(*view.second_from_first.matrix()).is_some());
    assert!(view.alternative.is_none() || view.status == TwoViewStatus::Planar);
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn exact_bearings_give_the_exact_pose() {
    for seed in 0..30 {
        let mut case = Case::around(60, seed);
        if seed % 3 == 1 {
            case = Case::ahead(60, |u, _| 3.0 + 9.0 * u, [0.0, 0.0, 1.0], seed);
        } else if seed % 3 == 2 {
            // half a turn, and a path straight to a pole of the panorama
            let turn = scale(std::f64::consts::PI, &normalized(&[1.0, seed as f64 * 0.1, 0.3]));
            case = Case::new(case.points, &turn, [0.0, -1.0, 0.0]);
        }
        let view = case.solve();
        assert_eq!(view.status, TwoViewStatus::General, "seed {seed}");
        assert!(view.inlier.iter().all(|&k| k), "seed {seed}");
        let (turn, direction) = (case.rotation_error(&view), case.direction_error(&view));
        assert!(turn < 1e-9 && direction < 1e-9, "seed {seed}: {turn:e} {direction:e}");
    }
}

/// Medians of the errors over their bounds, and the number of general answers.
fn efficiency(cases: impl Iterator<Item = Case>, sigma: f64) -> (f64, f64, f64) {
    let (mut turns, mut directions, mut general) = (Vec::new(), Vec::new(), 0);
    for case in cases {
        let view = case.solve();
        let bound = case.bound(sigma);
        turns.push(case.rotation_error(&view) / bound.0);
        let error = case.direction_error(&view) / bound.1;
        directions.push(if error.is_nan() { f64::INFINITY } else { error });
        general += i32::from(view.status == TwoViewStatus::General);
    }
    let n = turns.len() as f64;
    (median(turns), median(directions), f64::from(general) / n)
}

#[test]
fn the_error_is_that_of_the_bound() {
    // the median of the length of a normal vector of two or three dimensions is 0.83 to 0.89 of its rms, less where uneven
    let sigma = 0.1 * DEG;
    for (what, share, kind) in [
        ("around", 0.0, 0),
        ("around", 0.1, 0),
        ("around", 0.3, 0),
        ("around", 0.5, 0),
        ("far", 0.2, 1),
        ("narrow", 0.2, 2),
        ("ahead", 0.2, 3),
    ] {
        let cases = (0..60).map(|seed| {
            let case = match kind {
                0 => Case::around(120, seed),
                1 => {
                    let near = Case::around(120, seed);
                    let turn = [0.2, -0.4, 1.0];
                    Case::new(near.points.iter().map(|x| scale(8.0, x)).collect(), &turn, near.center)
                }
                2 => Case::ahead(120, |u, _| 2.0 + 10.0 * u, normalized(&[1.0, 0.2, 0.1]), seed),
                _ => Case::ahead(120, |u, _| 2.0 + 10.0 * u, [0.0, 0.0, 1.0], seed),
            };
            case.seen_badly(sigma, share, seed)
        });
        let (turn, direction, general) = efficiency(cases, sigma);
        eprintln!("{what} {share}: rotation {turn:.2}, direction {direction:.2} of the bound, general {general}");
        assert!(turn < 1.2 && direction < 1.2 && general > 0.98, "{what} {share}: {turn} {direction} {general}");
        assert!(turn > 0.5 && direction > 0.5, "{what} {share}: better than possible, {turn} {direction}");
    }
}

#[test]
fn noise_and_covariance_are_what_they_claim() {
    let sigma = 0.15 * DEG;
    let (mut turns, mut directions, mut ratio) = (Vec::new(), Vec::new(), Vec::new());
    for seed in 0..80 {
        let case = Case::around(150, seed).seen_badly(sigma, 0.3, seed);
        let view = case.solve();
        let phi = turn_between(&case.second_from_first, &view.second_from_first);
        turns.push(mahalanobis(&view.rotation_covariance, &phi));
        directions.push(mahalanobis(&view.direction_covariance, &sub(&normalized(&case.center), &view.direction)));
        ratio.push(view.sigma_rad / sigma);
    }
    // medians of chi squared with three and with two degrees of freedom
    let (turn, direction, ratio) = (median(turns), median(directions), median(ratio));
    assert!((turn - 2.37).abs() < 0.9, "rotation {turn}");
    assert!((direction - 1.39).abs() < 0.6, "direction {direction}");
    assert!((ratio - 1.0).abs() < 0.05, "noise {ratio}");
}

/// `v^T C^+ v`.
fn mahalanobis(covariance: &Matrix<3>, v: &Vector<3>) -> f64 {
    let (values, vectors) = panopath::least_squares::symmetric_eigen(covariance).unwrap();
    let largest = values[2];
    values.iter().zip(&vectors).filter(|(l, _)| **l > 1e-9 * largest).map(|(l, e)| dot(e, v).powi(2) / l).sum()
}

#[test]
fn false_matches_are_told_from_true_ones() {
    for share in [0.1, 0.3, 0.5] {
        let (mut kept, mut wrong, mut n_true) = (0, 0, 0);
        for seed in 0..20 {
            let case = Case::around(150, seed).seen_badly(0.1 * DEG, share, seed);
            let view = case.solve();
            n_true += case.outlier.iter().filter(|o| !**o).count();
            kept += case.outlier.iter().zip(&view.inlier).filter(|(o, i)| !**o && **i).count();
            wrong += case.outlier.iter().zip(&view.inlier).filter(|(o, i)| **o && **i).count();
        }
        assert!(kept as f64 > 0.99 * n_true as f64, "{share}: {kept} of {n_true}");
        // a false bearing falls within four deviations of its epipolar line, in front, once in a hundred
        assert!(wrong < 20, "{share}: {wrong} false ones kept");
    }
}

#[test]
fn a_largest_error_is_kept() {
    let case = Case::around(150, 1).seen_badly(0.1 * DEG, 0.2, 1);
    let options = TwoViewOptions { max_error_rad: Some(0.1 * DEG), ..Default::default() };
    let (narrow, usual) = (case.solve_with(&options), case.solve());
    assert_eq!(narrow.status, TwoViewStatus::General);
    let share = narrow.n_inliers as f64 / usual.n_inliers as f64;
    assert!((0.55..0.8).contains(&share), "one deviation keeps two thirds: {share}");
    assert!(case.rotation_error(&narrow) < 0.2 * DEG);
}

#[test]
fn views_from_one_place_have_no_direction() {
    for (n, share, sigma) in [(40, 0.0, 0.0), (40, 0.0, 0.1), (150, 0.3, 0.1), (150, 0.5, 0.2)] {
        let mut pure = 0;
        for seed in 0..25 {
            let case = Case::around(n, seed).without_baseline().seen_badly(sigma * DEG, share, seed);
            let view = case.solve();
            pure += usize::from(view.status == TwoViewStatus::PureRotation);
            let allowed = if sigma > 0.0 { 5.0 * sigma * DEG / (n as f64 * (1.0 - share)).sqrt() } else { 1e-12 };
            assert!(case.rotation_error(&view) < 2.0 * allowed, "{n} {share} {sigma}: seed {seed}");
        }
        assert!(pure >= 24, "{n} {share} {sigma}: {pure} of 25");
    }
}

#[test]
fn few_near_points_among_far_ones_are_a_baseline() {
    for share in [0.0, 0.3] {
        let mut general = 0;
        for seed in 0..20 {
            let near = Case::around(100, seed);
            let points = near.points.iter().enumerate();
            let points = points.map(|(i, x)| if i % 5 == 0 { *x } else { scale(1e6, x) }).collect();
            let case = Case::new(points, &[0.5, 1.0, -2.0], near.center).seen_badly(0.1 * DEG, share, seed);
            let view = case.solve();
            general += usize::from(view.status == TwoViewStatus::General && case.direction_error(&view) < 3.0 * DEG);
        }
        assert!(general >= 19, "{share}: {general} of 20");
    }
}

#[test]
fn a_plane_is_said_to_be_one() {
    // a floor seen all around, and a wall in a narrow field, which two poses explain
    let (mut floor, mut wall, mut two_poses) = (0, 0, 0);
    for seed in 0..20 {
        let mut noise = Noise::new(seed);
        let ground: Vec<Vector<3>> = (0..100)
            .map(|_| {
                let d: Vector<3> = noise.direction();
                let down = d[1].abs() + 0.15;
                scale(1.6 / down, &[d[0], down, d[2]])
            })
            .collect();
        let case = Case::new(ground, &[0.3, 2.0, -0.4], [0.9, 0.1, 0.4]).seen_badly(0.1 * DEG, 0.2, seed);
        let view = case.solve();
        let found = case.rotation_error(&view) < 0.6 * DEG && case.direction_error(&view) < 1.0 * DEG;
        floor += usize::from(view.status == TwoViewStatus::Planar && view.alternative.is_none() && found);

        // sideways along the wall one of the two has half the points behind; towards it both have all in front
        for (center, plane) in [([1.0, 0.2, 0.2], [0.05, 0.1, 0.15]), ([0.3, 0.2, 1.0], [0.05, 0.1, 0.3])] {
            let case = Case::ahead(100, |_, b| 1.0 / dot(&plane, b), normalized(&center), seed);
            let case = case.seen_badly(0.05 * DEG, 0.2, seed);
            let view = case.solve();
            let near = |r: &Rotation<3>, d: &Vector<3>| {
                norm(&turn_between(r, &case.second_from_first)) < 1.0 * DEG
                    && angle_between(d, &normalized(&case.center)) < 3.0 * DEG
            };
            let other = view.alternative.is_some_and(|(r, d)| near(&r, &d));
            let found =
                view.status == TwoViewStatus::Planar && (near(&view.second_from_first, &view.direction) || other);
            wall += usize::from(found);
            two_poses += usize::from(view.alternative.is_some());
        }
    }
    assert!(floor >= 19 && wall >= 38, "floor {floor} of 20, wall {wall} of 40");
    assert!((18..=22).contains(&two_poses), "walls with two poses: {two_poses} of 40");
}

#[test]
fn nothing_is_made_of_nothing() {
    let undetermined = |first: &[Vector<3>], second: &[Vector<3>], what: &str| {
        let view = relative_pose(first, second, &TwoViewOptions::default()).unwrap();
        check_invariants(&view, first.len());
        assert_eq!(view.status, TwoViewStatus::Undetermined, "{what}: {view:?}");
        assert_eq!(view.n_inliers, 0, "{what}");
    };
    let case = Case::around(60, 3);
    undetermined(&[], &[], "no match");
    undetermined(&case.first[..4], &case.second[..4], "four matches");
    undetermined(&case.first[..7], &case.second[..7], "seven matches");
    undetermined(&[case.first[0]; 50], &[case.second[0]; 50], "one match fifty times");
    let repeated = |of: &[Vector<3>]| -> Vec<Vector<3>> { (0..60).map(|i| of[i % 5]).collect() };
    undetermined(&repeated(&case.first), &repeated(&case.second), "five matches twelve times");
    let mut noise = Noise::new(5);
    for n in [10, 50, 200] {
        let (first, second): (Vec<_>, Vec<_>) = (0..n).map(|_| (noise.direction(), noise.direction())).unzip();
        undetermined(&first, &second, "false matches");
    }
    // an antipode is on every epipolar plane and in front of no camera
    let opposite: Vec<_> = case.first.iter().map(|b| scale(-1.0, b)).collect();
    undetermined(&case.first, &opposite, "antipodes");
}

#[test]
fn points_on_one_line_leave_the_pose_open() {
    let points: Vec<Vector<3>> =
        (0..40).map(|k| add(&[3.0, 1.0, 2.0], &scale(0.2 * f64::from(k), &[-0.3, 0.5, 0.8]))).collect();
    for sigma in [0.0, 0.05 * DEG] {
        let case = Case::new(points.clone(), &[0.1, 0.2, 0.3], [1.0, 0.0, 0.0]).seen_badly(sigma, 0.0, 1);
        let view = case.solve();
        assert_ne!(view.status, TwoViewStatus::General, "{sigma}");
    }
}

#[test]
fn repeated_matches_do_no_harm() {
    let case = Case::around(60, 4).seen_badly(0.1 * DEG, 0.2, 4);
    let twice = |of: &[Vector<3>]| -> Vec<Vector<3>> { of.iter().chain(of).copied().collect() };
    let view = relative_pose(&twice(&case.first), &twice(&case.second), &TwoViewOptions::default()).unwrap();
    assert_eq!(view.status, TwoViewStatus::General);
    assert!(case.rotation_error(&view) < 0.3 * DEG && case.direction_error(&view) < 0.5 * DEG);
}

#[test]
fn a_known_rotation_leaves_the_direction() {
    let sigma = 0.1 * DEG;
    let mut errors = Vec::new();
    for seed in 0..30 {
        let case = Case::around(60, seed).seen_badly(sigma, 0.5, seed);
        let options = TwoViewOptions::default();
        let view = relative_direction(&case.first, &case.second, &case.second_from_first, &options).unwrap();
        check_invariants(&view, 60);
        assert_eq!((view.status, view.second_from_first), (TwoViewStatus::General, case.second_from_first));
        assert_eq!(view.rotation_covariance, [[0.0; 3]; 3]);
        errors.push(mahalanobis(&view.direction_covariance, &sub(&normalized(&case.center), &view.direction)));
    }
    let error = median(errors);
    assert!((0.7..2.4).contains(&error), "1.39 expected: {error}");
    let exact = Case::around(30, 1);
    let view =
        relative_direction(&exact.first, &exact.second, &exact.second_from_first, &TwoViewOptions::default()).unwrap();
    assert!(exact.direction_error(&view) < 1e-10);
    let still = Case::around(100, 2).without_baseline().seen_badly(sigma, 0.3, 2);
    let view =
        relative_direction(&still.first, &still.second, &still.second_from_first, &TwoViewOptions::default()).unwrap();
    check_invariants(&view, 100);
    assert_eq!(view.status, TwoViewStatus::PureRotation);
}

#[test]
fn pairs_are_solved_as_they_would_be_alone_on_any_number_of_threads() {
    let cases: Vec<Case> =
        (0..12).map(|seed| Case::around(40 + 7 * seed, seed as u64).seen_badly(0.1 * DEG, 0.2, seed as u64)).collect();
    let mut start = vec![0];
    let (mut first, mut second) = (Vec::new(), Vec::new());
    for case in &cases {
        first.extend(&case.first);
        second.extend(&case.second);
        start.push(first.len());
    }
    let options = TwoViewOptions { seed: 7, ..Default::default() };
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| relative_poses(&start, &first, &second, None, &options).unwrap())
    };
    let one = on(1);
    assert_eq!(format!("{one:?}"), format!("{:?}", on(4)));
    assert_eq!(
        format!("{:?}", one[0]),
        format!("{:?}", relative_pose(&cases[0].first, &cases[0].second, &options).unwrap())
    );
    for (case, view) in cases.iter().zip(&one) {
        assert!(case.rotation_error(view) < 0.3 * DEG);
    }
    let rotations: Vec<_> = cases.iter().map(|c| c.second_from_first).collect();
    let known = relative_poses(&start, &first, &second, Some(&rotations), &options).unwrap();
    assert!(cases.iter().zip(&known).all(|(c, v)| c.direction_error(v) < 1.0 * DEG));
    assert!(relative_poses(&[0], &[], &[], None, &options).unwrap().is_empty());
}

#[test]
fn what_cannot_be_used_is_named() {
    let case = Case::around(20, 1);
    let defaults = TwoViewOptions::default();
    let text = |first: &[Vector<3>], second: &[Vector<3>], o: &TwoViewOptions| {
        relative_pose(first, second, o).unwrap_err().to_string()
    };
    assert_eq!(
        text(&case.first, &case.second[..19], &defaults),
        "second has 19 rows, expected 20, one for each row of first"
    );
    for (value, said) in [(f64::NAN, "NaN"), (f64::INFINITY, "inf"), (2.0, "1.99")] {
        let mut wrong = case.second.clone();
        wrong[7] = scale(value, &wrong[7]);
        let said_of = text(&case.first, &wrong, &defaults);
        assert!(said_of.starts_with("second[7] has length ") && said_of.contains(said), "{said_of}");
    }
    for (options, name) in [
        (TwoViewOptions { max_error_rad: Some(f64::NAN), ..defaults.clone() }, "max_error_rad"),
        (TwoViewOptions { confidence: 1.0, ..defaults.clone() }, "confidence"),
        (TwoViewOptions { max_iterations: 0, ..defaults.clone() }, "max_iterations"),
        (TwoViewOptions { min_inliers: 5, ..defaults.clone() }, "min_inliers"),
    ] {
        assert!(text(&case.first, &case.second, &options).starts_with(name));
    }
    let many =
        |start: &[usize]| relative_poses(start, &case.first, &case.second, None, &defaults).unwrap_err().to_string();
    assert_eq!(many(&[]), "pair_start[0] is 0, expected 0");
    assert_eq!(many(&[1, 20]), "pair_start[0] is 1, expected 0");
    assert_eq!(many(&[0, 12, 9, 20]), "pair_start[2] is 9, expected 12 or more");
    assert_eq!(many(&[0, 12, 19]), "pair_start[2] is 19, expected 20, the number of rows");
    let rotations = relative_poses(&[0, 20], &case.first, &case.second, Some(&[]), &defaults).unwrap_err().to_string();
    assert_eq!(rotations, "second_from_first has 0 rotations, expected one for each of the 1 pairs");
    let mut wrong = case.first.clone();
    wrong[13] = [0.0; 3];
    let error = relative_poses(&[0, 10, 20], &wrong, &case.second, None, &defaults).unwrap_err().to_string();
    assert_eq!(error, "first[13] has length 0, expected a finite unit vector");
}
