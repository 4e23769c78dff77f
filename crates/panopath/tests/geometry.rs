//! The laws of vectors, rotations and similarities, written once and run in the plane and in space.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use common::{Noise, places};
use panopath::geometry::*;
use proptest::prelude::*;

fn random_rotation<const D: usize>(noise: &mut Noise) -> Rotation<D> {
    let plane = Rotation::from_angle(std::f64::consts::TAU * noise.uniform());
    let phi: [f64; 3] = std::array::from_fn(|_| 2.0 * noise.normal());
    let space = Rotation::exp(&phi);
    let entry = |r: usize, c: usize| if D == 2 { plane.matrix()[r][c] } else { space.matrix()[r][c] };
    Rotation::from_matrix(std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)))).unwrap()
}

fn distance<const D: usize>(a: &Rotation<D>, b: &Rotation<D>) -> f64 {
    let pairs = a.matrix().iter().flatten().zip(b.matrix().iter().flatten());
    pairs.map(|(x, y)| (x - y).abs()).fold(0.0, f64::max)
}

fn check_group<const D: usize>(seed: u64) {
    let mut noise = Noise::new(seed);
    let one = Rotation::<D>::identity();
    let (a, b, c) = (random_rotation::<D>(&mut noise), random_rotation(&mut noise), random_rotation(&mut noise));
    assert!(distance(&a.compose(&a.inverse()), &one) < 1e-14);
    assert!(distance(&a.inverse().compose(&a), &one) < 1e-14);
    assert!(distance(&a.compose(&one), &a) == 0.0 && distance(&one.compose(&a), &a) == 0.0);
    assert!(distance(&a.compose(&b).compose(&c), &a.compose(&b.compose(&c))) < 1e-14);
    let x: Vector<D> = noise.direction();
    assert!(norm(&sub(&a.compose(&b).apply(&x), &a.apply(&b.apply(&x)))) < 1e-14);
    assert!((norm(&a.apply(&x)) - 1.0).abs() < 1e-14);
    assert!(a.inverse().inverse() == a);
    if D == 2 {
        assert!(distance(&a.compose(&b), &b.compose(&a)) < 1e-15);
    }
}

fn check_tangents<const D: usize>(direction: &Vector<D>) {
    let basis = tangent_basis(direction);
    for tangent in &basis[..D - 1] {
        assert!(dot(tangent, direction).abs() < 1e-14 && (norm(tangent) - 1.0).abs() < 1e-14, "{direction:?}");
    }
    if D == 3 {
        assert!(dot(&basis[0], &basis[1]).abs() < 1e-14, "{direction:?}");
    }
}

fn check_similarity<const D: usize>(seed: u64) {
    let mut noise = Noise::new(seed);
    let truth = Similarity {
        scale: (noise.normal() * 3.0).exp(),
        rotation: random_rotation::<D>(&mut noise),
        translation: std::array::from_fn(|_| 10.0 * noise.normal()),
    };
    let a = places::<D>(D + 2, &[0.5; D], 2.0, seed);
    let pairs: Vec<_> = a.iter().map(|x| (*x, truth.apply(x))).collect();
    let fit = Similarity::fit(&pairs).unwrap();
    let lost = 1.0 + norm(&truth.translation) / truth.scale;
    assert!((fit.scale / truth.scale - 1.0).abs() < 1e-13 * lost);
    assert!(distance(&fit.rotation, &truth.rotation) < 1e-12 * lost);
    for (x, y) in &pairs {
        assert!(norm(&sub(&fit.apply(x), y)) < 1e-10 * (1.0 + norm(y)));
    }
    let straight = Similarity { rotation: Rotation::identity(), ..truth };
    let pairs: Vec<_> = a.iter().map(|x| (*x, straight.apply(x))).collect();
    let fit = Similarity::fit_unrotated(&pairs).unwrap();
    // centred differences of places far from the origin lose digits in proportion
    let lost = 1.0 + norm(&truth.translation) / truth.scale;
    assert!((fit.scale / truth.scale - 1.0).abs() < 1e-14 * lost * 10.0);
    assert!(norm(&sub(&fit.translation, &truth.translation)) < 1e-11 * (1.0 + norm(&truth.translation) + truth.scale));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn rotations_are_a_group(seed in any::<u64>()) {
        check_group::<2>(seed);
        check_group::<3>(seed);
    }

    #[test]
    fn a_similarity_is_recovered_from_pairs(seed in any::<u64>()) {
        check_similarity::<2>(seed);
        check_similarity::<3>(seed);
    }

    #[test]
    fn the_exponential_turns_by_its_angle_about_its_axis(phi in prop::array::uniform3(-3.0..3.0f64), log_size in -12.0..0.0f64) {
        let phi = scale(10f64.powf(log_size), &phi);
        let r = Rotation::exp(&phi);
        let angle = norm(&phi);
        prop_assert!(norm(&sub(&r.apply(&phi), &phi)) <= 1e-15 * (1.0 + angle));
        // a vector across the axis turns by the angle
        let across = tangent_basis(&normalized(&phi))[0];
        let turned = angle_between(&r.apply(&across), &across);
        let wanted = if angle > std::f64::consts::PI { std::f64::consts::TAU - angle } else { angle };
        prop_assert!((turned - wanted).abs() < 4e-15);
        prop_assert!(distance(&Rotation::exp(&scale(-1.0, &phi)), &r.inverse()) < 1e-15);
        prop_assert!(distance(&Rotation::exp(&scale(0.5, &phi)).compose(&Rotation::exp(&scale(0.5, &phi))), &r) < 1e-14);
        prop_assert!(Rotation::from_matrix(*r.matrix()).is_some());
    }

    #[test]
    fn the_logarithm_undoes_the_exponential(seed in any::<u64>(), log_angle in -300.0..0.4971f64, log_short in -17.0..0.0f64) {
        let axis: Vector<3> = Noise::new(seed).direction();
        for angle in [10f64.powf(log_angle), std::f64::consts::PI - 10f64.powf(log_short)] {
            let phi = scale(angle, &axis);
            let r = Rotation::exp(&phi);
            let found = r.log();
            prop_assert!(norm(&found) <= std::f64::consts::PI + 1e-15);
            // at half a turn the axis has two signs
            let off = norm(&sub(&found, &phi)).min(norm(&add(&found, &phi)) + 2.0 * (std::f64::consts::PI - angle));
            prop_assert!(off < 4e-15 * angle.max(1e-290), "{} {}", angle, off / angle);
            prop_assert!(distance(&Rotation::exp(&found), &r) < 4e-15);
            prop_assert!(norm(&add(&r.inverse().log(), &found)) < 1e-14 || angle > 3.1);
            prop_assert!(distance(&Rotation::from_quaternion(&r.quaternion()), &r) < 2e-15);
            prop_assert!(r.quaternion()[0] >= 0.0);
        }
        let angle = 3.1 * axis[0];
        prop_assert!((Rotation::from_angle(angle).angle() - angle).abs() < 1e-15);
    }

    #[test]
    fn logarithms_turn_with_the_frame(seed in any::<u64>()) {
        // log(a b a^-1) = a log(b)
        let mut noise = Noise::new(seed);
        let (a, b) = (random_rotation::<3>(&mut noise), random_rotation::<3>(&mut noise));
        let turned = a.compose(&b).compose(&a.inverse()).log();
        if norm(&turned) < 3.1 {
            prop_assert!(norm(&sub(&turned, &a.apply(&b.log()))) < 1e-12);
        }
    }

    #[test]
    fn tangent_bases_are_orthonormal_everywhere(seed in any::<u64>()) {
        let mut noise = Noise::new(seed);
        check_tangents::<2>(&noise.direction());
        check_tangents::<3>(&noise.direction());
    }

    #[test]
    fn angles_are_accurate_from_zero_to_pi(log_angle in -14.0..0.49f64, seed in any::<u64>()) {
        let mut noise = Noise::new(seed);
        let angle = 10f64.powf(log_angle).min(std::f64::consts::PI);
        let a: Vector<3> = noise.direction();
        let across = tangent_basis(&a)[0];
        let b = add(&scale(angle.cos(), &a), &scale(angle.sin(), &across));
        prop_assert!((angle_between(&a, &b) - angle).abs() < 4e-16 + 1e-15 * angle);
        let near_pi = add(&scale(-angle.cos(), &a), &scale(angle.sin(), &across));
        prop_assert!((angle_between(&a, &near_pi) - (std::f64::consts::PI - angle)).abs() < 2e-15);
    }
}

#[test]
fn the_exponential_is_smooth_where_its_series_takes_over() {
    for angle in [0.0, 1e-300, 1e-9, 9.999e-5, 1.0001e-4] {
        let r = Rotation::exp(&[0.0, 0.0, angle]);
        let wanted = Rotation::from_angle(angle);
        for row in 0..2 {
            for col in 0..2 {
                assert!((r.matrix()[row][col] - wanted.matrix()[row][col]).abs() < 1e-16, "{angle}");
            }
        }
    }
}

#[test]
fn half_turns_have_logarithms() {
    for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [-0.6, 0.48, 0.64]] {
        let r = Rotation::exp(&scale(std::f64::consts::PI, &axis));
        assert!((norm(&r.log()) - std::f64::consts::PI).abs() < 1e-15, "{axis:?}");
        assert!(distance(&Rotation::exp(&r.log()), &r) < 1e-15, "{axis:?}");
    }
    assert_eq!(Rotation::<3>::identity().log(), [0.0; 3]);
    assert_eq!(Rotation::<2>::identity().angle(), 0.0);
    assert!(Rotation::exp(&[f64::NAN; 3]).log().iter().all(|x| x.is_nan()));
}

#[test]
fn axes_and_poles_have_tangents() {
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let mut direction = [0.0; 3];
            direction[axis] = sign;
            check_tangents::<3>(&direction);
        }
    }
    // in the plane the tangent is the direction turned by +90 degrees
    assert_eq!(tangent_basis(&[1.0, 0.0])[0], [-0.0, 1.0]);
}

#[test]
fn matrices_that_are_no_rotations_are_refused() {
    assert!(Rotation::from_matrix([[1.0, 0.0], [0.0, -1.0]]).is_none());
    assert!(Rotation::from_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]).is_none());
    assert!(Rotation::from_matrix([[1.0, 1e-4], [0.0, 1.0]]).is_none());
    assert!(Rotation::from_matrix([[f64::NAN, 0.0], [0.0, 1.0]]).is_none());
    assert!(Rotation::from_matrix([[0.0; 3]; 3]).is_none());
    assert!(Rotation::from_matrix([[2.0, 0.0], [0.0, 2.0]]).is_none());
}

#[test]
fn a_fit_is_never_a_reflection() {
    let a = places::<3>(6, &[0.0; 3], 1.0, 1);
    let mirrored: Vec<_> = a.iter().map(|x| (*x, [x[0], x[1], -x[2]])).collect();
    if let Some(fit) = Similarity::fit(&mirrored) {
        assert!(Rotation::from_matrix(*fit.rotation.matrix()).is_some() && fit.scale > 0.0);
    }
    let inside_out: Vec<_> = a.iter().map(|x| (*x, scale(-1.0, x))).collect();
    assert!(Similarity::fit_unrotated(&inside_out).is_none());
}

#[test]
fn too_few_places_fix_nothing() {
    for pairs in [vec![], vec![([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])], vec![([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]); 3]] {
        assert!(Similarity::fit(&pairs).is_none(), "{} pairs at one place", pairs.len());
        assert!(Similarity::fit_unrotated(&pairs).is_none(), "{} pairs at one place", pairs.len());
    }
    let onto_one: Vec<_> = places::<3>(4, &[0.0; 3], 1.0, 1).into_iter().map(|x| (x, [1.0; 3])).collect();
    assert!(Similarity::fit_unrotated(&onto_one).is_none());
}

#[test]
fn a_fit_minimises_the_squared_distance() {
    let (a, b) = (places::<3>(8, &[0.0; 3], 1.0, 1), places::<3>(8, &[3.0; 3], 1.0, 2));
    // correlated pairs with errors far larger than rounding
    let pairs: Vec<_> = a.iter().zip(&b).map(|(x, e)| (*x, add(&scale(2.0, x), &scale(0.3, e)))).collect();
    let cost = |s: &Similarity<3>| pairs.iter().map(|(x, y)| norm(&sub(&s.apply(x), y)).powi(2)).sum::<f64>();
    let fit = Similarity::fit(&pairs).unwrap();
    let best = cost(&fit);
    for k in 0..7 {
        for sign in [-1e-4, 1e-4] {
            let mut other = fit;
            match k {
                0 => other.scale *= 1.0 + sign,
                1..=3 => other.translation[k - 1] += sign,
                _ => {
                    let mut phi = [0.0; 3];
                    phi[k - 4] = sign;
                    other.rotation = Rotation::exp(&phi).compose(&fit.rotation);
                    // about the centroid, as a fit would
                    let middle = pairs.iter().fold([0.0; 3], |m, (x, _)| add(&m, &scale(0.125, x)));
                    other.translation = add(&other.translation, &sub(&fit.apply(&middle), &other.apply(&middle)));
                }
            }
            assert!(cost(&other) >= best, "parameter {k}");
        }
    }
}

/// Exponential and turn are inverse to each other, and agree with the group.
fn check_turns<const D: usize>(phi: &[f64; 3], what: &str) {
    let n_turns = D * (D - 1) / 2;
    let angle = norm(phi);
    let r = Rotation::<D>::exp_of(&phi[..n_turns]);
    assert!(Rotation::from_matrix(*r.matrix()).is_some(), "{what}: no rotation");
    let turn = r.turn();
    assert!(turn[n_turns..].iter().all(|&x| x == 0.0), "{what}: entries beyond the turn");
    assert!(norm(&turn) <= std::f64::consts::PI * (1.0 + 1e-15), "{what}: of at most pi");
    let again = Rotation::<D>::exp_of(&turn[..n_turns]);
    assert!(distance(&again, &r) < 1e-14 + 4e-15 * angle, "{what}: exp(turn(R)) is R, {}", distance(&again, &r));
    if angle < std::f64::consts::PI - 1e-5 {
        let off = norm(&sub(&turn, phi));
        assert!(off <= 1e-15 + 1e-14 * angle, "{what}: turn(exp(phi)) is phi, {off}");
    }
    let back = r.inverse().turn();
    let off = norm(&add(&back, &turn)).min(norm(&sub(&back, &turn)));
    assert!(off < 1e-9, "{what}: the inverse turns back, {off}");
    let half: Vec<f64> = turn[..n_turns].iter().map(|x| 0.5 * x).collect();
    let half = Rotation::<D>::exp_of(&half);
    assert!(distance(&half.compose(&half), &again) < 1e-14, "{what}: two halves");
    // missing entries are zero
    assert!(Rotation::<D>::exp_of(&[]) == Rotation::identity());
}

#[test]
fn turns_are_the_logarithm_near_zero_between_and_near_half_a_turn() {
    let pi = std::f64::consts::PI;
    let mut noise = Noise::new(3);
    let sizes =
        [0.0, 1e-300, 1e-12, 1e-7, 9e-7, 1.1e-6, 1e-3, 1.0, 3.0, pi - 1e-3, pi - 1.1e-6, pi - 9e-7, pi - 1e-9, pi];
    for size in sizes {
        for k in 0..40 {
            let axis: Vector<3> = match k {
                0..3 => std::array::from_fn(|c| f64::from(u8::from(c == k))),
                3..6 => std::array::from_fn(|c| -f64::from(u8::from(c + 3 == k))),
                6 => normalized(&[1.0, 1.0, 0.0]),
                7 => normalized(&[1.0, -1.0, 1e-9]),
                _ => noise.direction(),
            };
            check_turns::<3>(&scale(size, &axis), &format!("{size} about {axis:?}"));
        }
        for sign in [-1.0, 1.0] {
            check_turns::<2>(&[sign * size, 0.0, 0.0], &format!("{sign} {size} in the plane"));
        }
    }
    // about one axis turns add up, past half a turn as well
    for (a, b) in [(0.3, 0.4), (2.0, 2.0), (-3.0, -3.0), (3.0, 3.2)] {
        let axis: Vector<3> = noise.direction();
        let sum = Rotation::exp(&scale(a, &axis)).compose(&Rotation::exp(&scale(b, &axis))).turn();
        let wrapped = (a + b + pi).rem_euclid(2.0 * pi) - pi;
        assert!(norm(&sub(&sum, &scale(wrapped, &axis))) < 1e-13);
        let sum = Rotation::<2>::exp_of(&[a]).compose(&Rotation::exp_of(&[b])).turn()[0];
        assert!((sum - wrapped).abs() < 1e-14);
    }
}
