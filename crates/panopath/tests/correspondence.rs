//! Tracks from matches: exact, cut where wrong, and what cannot be read.

#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

use panopath::correspondence::{
    CorrespondenceError, CorrespondenceOptions, FeatureTracks, Matches, tracks_from_matches,
};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;

/// Matches that own their arrays, with the point of each feature of each image.
#[derive(Default)]
struct Case {
    point: Vec<Vec<usize>>,
    pairs: Vec<[u32; 2]>,
    starts: Vec<usize>,
    features: Vec<[u32; 2]>,
}

impl Case {
    /// Images with `n` features each and no matches.
    fn empty(n_images: usize, n: usize) -> Self {
        Self { point: vec![(0..n).collect(); n_images], starts: vec![0], ..Self::default() }
    }

    fn pair(mut self, images: [u32; 2], matches: &[[u32; 2]]) -> Self {
        self.pairs.push(images);
        self.features.extend(matches);
        self.starts.push(self.features.len());
        self
    }

    fn solve(&self, options: &CorrespondenceOptions) -> Result<FeatureTracks, CorrespondenceError> {
        let n_features: Vec<usize> = self.point.iter().map(Vec::len).collect();
        let matches =
            Matches { n_features: &n_features, pairs: &self.pairs, starts: &self.starts, features: &self.features };
        tracks_from_matches(&matches, options)
    }

    /// Tracks by default options, each as `(image, feature)`.
    fn tracks(&self) -> Vec<Vec<(u32, u32)>> {
        let found = self.solve(&CorrespondenceOptions::default()).expect("the case can be read");
        lists(&found)
    }
}

fn lists(found: &FeatureTracks) -> Vec<Vec<(u32, u32)>> {
    let mut tracks = vec![Vec::new(); found.n_tracks];
    for o in 0..found.image.len() {
        tracks[found.track[o] as usize].push((found.image[o], found.feature[o]));
    }
    tracks
}

/// Points on a ring seen by the images near them; `wrong` of each pair's matches join any feature with any other.
fn ring(n_images: usize, n_points: usize, found: f64, wrong: f64, seed: u64) -> Case {
    let rng = &mut ChaCha8Rng::seed_from_u64(seed);
    let mut case = Case { starts: vec![0], ..Case::default() };
    let place: Vec<f64> = (0..n_points).map(|_| rng.random_range(0.0..n_images as f64)).collect();
    for image in 0..n_images {
        let off = |p: &usize| (image as f64 - place[*p]).abs();
        let is_near = |p: &usize| off(p).min(n_images as f64 - off(p)) < 6.0;
        let mut seen: Vec<usize> = (0..n_points).filter(is_near).filter(|_| rng.random_bool(0.8)).collect();
        seen.shuffle(rng);
        case.point.push(seen);
    }
    for a in 0..n_images {
        for b in a + 1..n_images {
            let at = |p: &usize| case.point[b].iter().position(|q| q == p);
            let right = case.point[a].iter().enumerate().filter_map(|(f, p)| Some([f as u32, at(p)? as u32]));
            let mut matches: Vec<[u32; 2]> = right.filter(|_| rng.random_bool(found)).collect();
            if matches.len() < 10 {
                continue;
            }
            let n_wrong = (matches.len() as f64 * wrong / (1.0 - wrong)).round() as usize;
            let mut any = |image: usize| rng.random_range(0..case.point[image].len()) as u32;
            matches.extend((0..n_wrong).map(|_| [any(a), any(b)]).collect::<Vec<_>>());
            case = case.pair([a as u32, b as u32], &matches);
        }
    }
    case
}

/// Share of the observations that show the point of most of their track, and number of those.
fn agreement(case: &Case, tracks: &[Vec<(u32, u32)>]) -> (f64, usize) {
    let (mut right, mut all) = (0, 0);
    for track in tracks {
        let mut points: Vec<usize> = track.iter().map(|&(i, f)| case.point[i as usize][f as usize]).collect();
        points.sort_unstable();
        right += points.chunk_by(|a, b| a == b).map(<[usize]>::len).max().unwrap_or(0);
        all += points.len();
    }
    (right as f64 / all as f64, right)
}

fn assert_one_feature_an_image(tracks: &[Vec<(u32, u32)>]) {
    for track in tracks {
        assert!(track.windows(2).all(|w| w[0].0 < w[1].0), "{track:?}");
    }
}

#[test]
fn right_matches_give_the_components() {
    let case = ring(30, 400, 0.9, 0.0, 1);
    let tracks = case.tracks();
    let (share, right) = agreement(&case, &tracks);
    assert_eq!(share, 1.0);
    // every point seen twice or more is one track with all its observations
    assert!(right as f64 > 0.999 * case.point.iter().map(Vec::len).sum::<usize>() as f64);
    assert_eq!(tracks.len(), 400);
}

#[test]
fn chains_without_triangles_are_joined() {
    let case = (0..9).fold(Case::empty(10, 3), |case, i| case.pair([i, i + 1], &[[0, 0], [1, 2], [2, 1]]));
    let tracks = case.tracks();
    assert_eq!(tracks.iter().map(Vec::len).collect::<Vec<_>>(), [10, 10, 10]);
    assert_eq!(tracks[1][..3], [(0, 1), (1, 2), (2, 1)]);
}

#[test]
fn one_wrong_match_does_not_join_two_points() {
    // two points in five images, all pairs matched; image 0's first point is also matched with image 1's second
    let mut case = Case::empty(5, 2);
    for a in 0..5 {
        for b in a + 1..5 {
            case = case.pair([a, b], if (a, b) == (0, 1) { &[[0, 1], [0, 0], [1, 1]] } else { &[[0, 0], [1, 1]] });
        }
    }
    let whole = |f| (0..5).map(|i| (i, f)).collect::<Vec<_>>();
    assert_eq!(case.tracks(), [whole(0), whole(1)]);
    assert_eq!(case.solve(&CorrespondenceOptions::default()).map(|t| t.n_cut), Ok(1));
}

#[test]
fn one_wrong_match_does_not_join_tracks_without_a_common_image() {
    // points seen by images 0-4 and 5-9; all pairs are matched, and one match goes across
    let mut case = Case::empty(10, 1);
    for a in 0..10 {
        for b in a + 1..10 {
            let across = (a < 5) != (b < 5) && (a, b) != (2, 7);
            case = case.pair([a, b], if across { &[] } else { &[[0, 0]] });
        }
    }
    assert_eq!(case.tracks().iter().map(Vec::len).collect::<Vec<_>>(), [5, 5]);
    // where every match that was tried is there, it joins: pairs that were never matched say nothing against it
    let mut sparse = Case::empty(10, 1);
    for (a, b) in [(0, 1), (1, 2), (0, 2), (2, 3), (3, 4), (4, 5), (3, 5)] {
        sparse = sparse.pair([a, b], &[[0, 0]]);
    }
    assert_eq!(sparse.tracks().iter().map(Vec::len).collect::<Vec<_>>(), [6]);
}

#[test]
fn most_is_kept_where_many_are_wrong() {
    for (wrong, least_share, least_kept) in [(0.1, 0.98, 0.98), (0.3, 0.95, 0.95)] {
        let case = ring(40, 600, 0.8, wrong, 2);
        let tracks = case.tracks();
        assert_one_feature_an_image(&tracks);
        let (share, right) = agreement(&case, &tracks);
        let kept = right as f64 / case.point.iter().map(Vec::len).sum::<usize>() as f64;
        assert!(share > least_share && kept > least_kept, "{wrong} wrong: {share} right, {kept} kept");
    }
}

#[test]
fn the_same_on_any_number_of_threads() {
    let case = ring(30, 400, 0.6, 0.3, 3);
    let on = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool");
        pool.install(|| case.solve(&CorrespondenceOptions::default()))
    };
    assert_eq!(on(1), on(4));
}

#[test]
fn matches_given_twice_count_once() {
    let case = ring(20, 200, 0.6, 0.2, 4);
    let mut twice = Case { point: case.point.clone(), starts: vec![0], ..Case::default() };
    for (p, &pair) in case.pairs.iter().enumerate() {
        let matches = &case.features[case.starts[p]..case.starts[p + 1]];
        twice = twice.pair(pair, &[matches, matches].concat());
    }
    assert_eq!(case.tracks(), twice.tracks());
}

#[test]
fn short_tracks_are_left_out() {
    let case = Case::empty(3, 2).pair([0, 1], &[[0, 0], [1, 1]]).pair([1, 2], &[[0, 0]]);
    let options = CorrespondenceOptions { min_images: 3, ..CorrespondenceOptions::default() };
    assert_eq!(lists(&case.solve(&options).expect("readable")), [vec![(0, 0), (1, 0), (2, 0)]]);
}

#[test]
fn nothing_is_an_answer() {
    for case in [Case::empty(0, 0), Case::empty(3, 0), Case::empty(3, 5), Case::empty(3, 5).pair([0, 2], &[])] {
        assert_eq!(case.solve(&CorrespondenceOptions::default()), Ok(FeatureTracks::default()));
    }
}

#[test]
fn many_images_without_a_table() {
    let n = 20_000;
    let linked = (0..n - 1).filter(|i| i % 10 != 9);
    let case = linked.fold(Case::empty(n as usize, 1), |case, i| case.pair([i + 1, i], &[[0, 0]]));
    assert_eq!(case.tracks().iter().map(Vec::len).collect::<Vec<_>>(), vec![10; n as usize / 10]);
}

#[test]
fn errors_name_the_entry() {
    let message = |case: Case, options| case.solve(&options).map_err(|e| e.to_string()).expect_err("an error");
    let default = CorrespondenceOptions::default();
    let text = message(Case::empty(2, 3).pair([0, 0], &[]), default);
    assert_eq!(text, "pairs[0] is (0, 0), expected two different images below 2");
    let text = message(Case::empty(2, 3).pair([0, 2], &[]), default);
    assert_eq!(text, "pairs[0] is (0, 2), expected two different images below 2");
    let text = message(Case::empty(2, 3).pair([0, 1], &[[0, 2], [1, 3]]), default);
    assert_eq!(text, "matches[1] names feature 3 of image 1, which has 3 features");
    let broken = Case { starts: vec![0, 5], ..Case::empty(2, 3).pair([0, 1], &[[0, 2]]) };
    let text = message(broken, default);
    assert_eq!(text, "match_starts has 2 entries, expected 2 that ascend from 0 to 1, the number of matches");
    for (options, text) in [
        (CorrespondenceOptions { min_images: 1, ..default }, "min_images is 1, expected 2 or more"),
        (
            CorrespondenceOptions { min_linkage: f64::NAN, ..default },
            "min_linkage is NaN, expected a share from 0 to 1",
        ),
    ] {
        assert_eq!(message(Case::empty(2, 3), options), text);
    }
}

proptest! {
    /// Whatever the matches, no track has an image twice, none is short, and no feature is in two.
    #[test]
    fn tracks_are_tracks(matches in prop::collection::vec((0u32..6, 0u32..6, 0u32..4, 0u32..4), 0..80)) {
        let mut case = Case::empty(6, 4);
        for (a, b, f, g) in matches {
            if a != b {
                case = case.pair([a, b], &[[f, g]]);
            }
        }
        let tracks = case.tracks();
        assert_one_feature_an_image(&tracks);
        let mut seen: Vec<(u32, u32)> = tracks.concat();
        prop_assert!(tracks.iter().all(|t| t.len() >= 2));
        let n = seen.len();
        seen.sort_unstable();
        seen.dedup();
        prop_assert_eq!(n, seen.len());
    }
}
