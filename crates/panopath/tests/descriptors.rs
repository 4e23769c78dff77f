//! Matching of descriptors: exhaustive, guided by a motion, and what cannot be matched.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

use panopath::Rotation;
use panopath::descriptors::{Features, Guide, ImagePair, LENGTH, MatchError, MatchOptions, match_features};
use panopath::geometry::{Vector, dot, normalized, sub};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

type Descriptor = [u8; LENGTH];

struct Scene {
    starts: Vec<usize>,
    descriptors: Vec<Descriptor>,
    bearings: Vec<Vector<3>>,
    turn: Rotation<3>,
    direction: Vector<3>,
}

impl Scene {
    /// `n` points around two cameras; feature `k` of the first image is feature `n - 1 - k` of the second.
    fn new(n: usize, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let turn = Rotation::exp(&[0.4, -1.1, 0.7]);
        let center = [0.3, -0.2, 0.5];
        let mut first: Vec<(Descriptor, Vector<3>)> = Vec::new();
        let mut second: Vec<(Descriptor, Vector<3>)> = Vec::new();
        for _ in 0..n {
            let axis = normalized(&std::array::from_fn(|_| rng.random::<f64>() - 0.5));
            let depth = 2.0 + 8.0 * rng.random::<f64>();
            let point = axis.map(|x| depth * x);
            let descriptor: Descriptor = std::array::from_fn(|_| (rng.random::<f64>() * 90.0) as u8);
            let noisy = descriptor.map(|x| x.saturating_add((rng.random::<f64>() * 8.0) as u8));
            first.push((descriptor, axis));
            second.push((noisy, turn.apply(&normalized(&sub(&point, &center)))));
        }
        second.reverse();
        first.extend(second);
        let (descriptors, bearings) = first.into_iter().unzip();
        Self { starts: vec![0, n, 2 * n], descriptors, bearings, turn, direction: normalized(&center) }
    }

    fn features(&self) -> Features<'_> {
        Features { starts: &self.starts, descriptors: &self.descriptors, bearings: &self.bearings }
    }

    fn guide(&self, direction: bool, radius_rad: f64, band_rad: f64) -> Guide {
        let direction = direction.then_some(self.direction);
        Guide { second_from_first: self.turn, direction, radius_rad, band_rad }
    }

    fn matches(&self, guide: Option<Guide>, options: &MatchOptions) -> Vec<[u32; 2]> {
        let pair = ImagePair { first: 0, second: 1, guide };
        match_features(&self.features(), &[pair], options).unwrap().remove(0)
    }
}

fn all(n: u32) -> Vec<[u32; 2]> {
    (0..n).map(|k| [k, n - 1 - k]).collect()
}

#[test]
fn every_feature_finds_its_own() {
    let scene = Scene::new(300, 1);
    assert_eq!(scene.matches(None, &MatchOptions::default()), all(300));
    for (direction, radius, band) in [(false, 0.5, 0.1), (true, 0.5, 0.01), (true, 3.0, 0.001), (true, 3.1, 1.5)] {
        let guide = scene.guide(direction, radius, band);
        assert_eq!(scene.matches(Some(guide), &MatchOptions::default()), all(300), "{direction} {radius} {band}");
    }
}

/// What the index finds is exactly what the test of the motion allows, at the poles of the motion too.
#[test]
fn guides_allow_what_they_say() {
    let mut scene = Scene::new(200, 2);
    let n = 200;
    // every descriptor alike: the match is then the first feature that the motion allows, if no other is
    scene.bearings[3] = scene.direction;
    scene.bearings[7] = scene.direction.map(|x| -x);
    for (direction, radius, band) in [(true, 0.6_f64, 0.02_f64), (true, 0.2, 0.3), (false, 0.3, 1.0)] {
        let guide = scene.guide(direction, radius, band);
        let e = scene.turn.apply(&scene.direction);
        for i in 0..n {
            let q = scene.turn.apply(&scene.bearings[i]);
            let normal = [q[1] * e[2] - q[2] * e[1], q[2] * e[0] - q[0] * e[2], q[0] * e[1] - q[1] * e[0]];
            let away = sub(&q.map(|x| x * dot(&q, &e)), &e);
            let outward = sub(&q, &e.map(|x| x * dot(&q, &e)));
            let allowed: Vec<usize> = (0..n)
                .filter(|&j| {
                    let b = scene.bearings[n + j];
                    let at_pole = dot(&normal, &normal).sqrt() <= band.sin();
                    let on_path = !direction
                        || at_pole
                        || (dot(&normalized(&normal), &b).abs() <= band.sin()
                            && dot(&normalized(&away), &b) >= -band.sin()
                            && dot(&normalized(&outward), &b) >= -band.sin());
                    on_path && dot(&q, &b) >= radius.cos()
                })
                .collect();
            // one feature alone on the first side; all of the second alike but for one, which must be found if allowed
            for &j in &[allowed.first().copied(), allowed.last().copied(), Some((i * 7) % n)] {
                let Some(j) = j else { continue };
                let mut descriptors = vec![[0; LENGTH]; n + 1];
                descriptors[0] = [30; LENGTH];
                descriptors[1 + j] = [30; LENGTH];
                let mut bearings = vec![scene.bearings[i]];
                bearings.extend_from_slice(&scene.bearings[n..]);
                let features = Features { starts: &[0, 1, n + 1], descriptors: &descriptors, bearings: &bearings };
                let pair = ImagePair { first: 0, second: 1, guide: Some(guide) };
                let options = MatchOptions { max_distance: 0.1, ..MatchOptions::default() };
                let found = match_features(&features, &[pair], &options).unwrap().remove(0);
                let expected = if allowed.contains(&j) { vec![[0, j as u32]] } else { vec![] };
                assert_eq!(found, expected, "feature {i} against {j}, {direction} {radius} {band}");
            }
        }
    }
}

#[test]
fn features_alike_do_not_match() {
    let mut scene = Scene::new(50, 3);
    scene.descriptors[50 + 10] = scene.descriptors[50 + 11];
    let found = scene.matches(None, &MatchOptions::default());
    assert!(!found.iter().any(|m| m[1] == 10 || m[1] == 11));
    assert_eq!(found.len(), 48);
    let far = MatchOptions { max_distance: 1e-3, ..MatchOptions::default() };
    assert!(scene.matches(None, &far).is_empty());
}

#[test]
fn only_the_first_features_take_part() {
    let scene = Scene::new(40, 4);
    let found = scene.matches(None, &MatchOptions { max_features: 25, ..MatchOptions::default() });
    assert!(found.iter().all(|m| m[0] < 25 && m[1] < 25));
    assert_eq!(found.len(), 10);
}

#[test]
fn unknown_bearings_and_empty_images_are_ordinary() {
    let mut scene = Scene::new(30, 5);
    scene.bearings[4] = [f64::NAN; 3];
    scene.bearings[30 + 3] = [f64::NAN; 3];
    for direction in [false, true] {
        let found = scene.matches(Some(scene.guide(direction, 0.5, 0.1)), &MatchOptions::default());
        assert_eq!(found.len(), 28);
    }
    let empty = Features { starts: &[0, 0, 0], descriptors: &[], bearings: &[] };
    let pair = ImagePair { first: 0, second: 1, guide: None };
    assert_eq!(match_features(&empty, &[pair], &MatchOptions::default()), Ok(vec![vec![]]));
    assert_eq!(match_features(&empty, &[], &MatchOptions::default()), Ok(vec![]));
}

#[test]
fn errors_name_the_entry() {
    let scene = Scene::new(10, 6);
    let try_with = |features: &Features, pair: ImagePair, options: &MatchOptions| {
        match_features(features, &[pair], options).unwrap_err().to_string()
    };
    let good = ImagePair { first: 0, second: 1, guide: None };
    let plain = MatchOptions::default();
    let same = ImagePair { first: 1, second: 1, guide: None };
    assert_eq!(try_with(&scene.features(), same, &plain), "pairs[0] is [1, 1], expected two different images of 2");
    let wide = ImagePair { guide: Some(scene.guide(true, 4.0, 0.1)), ..good };
    assert_eq!(try_with(&scene.features(), wide, &plain), "radius_rad[0] is 4, expected an angle above 0, at most pi");
    let short = Features { descriptors: &scene.descriptors[1..], ..scene.features() };
    assert_eq!(try_with(&short, good, &plain), "descriptors has 19 entries, expected 20");
    let unordered = Features { starts: &[0, 20, 10], ..scene.features() };
    assert_eq!(match_features(&unordered, &[], &plain), Err(MatchError::Starts(2)));
    let ratio = MatchOptions { max_ratio: f64::NAN, ..plain };
    assert!(try_with(&scene.features(), good, &ratio).starts_with("max_ratio is NaN"));
}
