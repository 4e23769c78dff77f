//! Pairs of views, against every pair counted one by one.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use std::collections::{BTreeMap, BTreeSet};

use common::Noise;
use panopath::tracks::Tracks;
use panopath::view_graph::*;
use proptest::prelude::*;

/// Views that saw tracks at random; some observations repeated.
fn random_tracks(n_views: usize, n_tracks: usize, share: f64, seed: u64) -> Tracks<3> {
    let mut noise = Noise::new(seed);
    let (mut view, mut track) = (Vec::new(), Vec::new());
    for j in 0..n_tracks {
        for i in 0..n_views {
            if noise.uniform() < share {
                let times = if noise.uniform() < 0.05 { 2 } else { 1 };
                for _ in 0..times {
                    view.push(i as u32);
                    track.push(j as u32);
                }
            }
        }
    }
    let order = noise.permutation(view.len());
    let pick = |ids: &[u32]| order.iter().map(|&o| ids[o]).collect::<Vec<u32>>();
    let bearing = order.iter().map(|_| noise.direction()).collect();
    Tracks::new(pick(&view), pick(&track), bearing, None, n_views, n_tracks).unwrap()
}

/// How many tracks each pair of views shares.
fn shared(tracks: &Tracks<3>) -> BTreeMap<[u32; 2], usize> {
    let mut seen = vec![BTreeSet::new(); tracks.n_views()];
    for (&view, &track) in tracks.view().iter().zip(tracks.track()) {
        seen[view as usize].insert(track);
    }
    let mut counts = BTreeMap::new();
    for i in 0..tracks.n_views() {
        for k in i + 1..tracks.n_views() {
            let n = seen[i].intersection(&seen[k]).count();
            if n > 0 {
                counts.insert([i as u32, k as u32], n);
            }
        }
    }
    counts
}

/// What holds for every answer.
fn check(tracks: &Tracks<3>, options: &ViewGraphOptions) -> ViewPairs {
    let pairs = view_pairs(tracks, options);
    let counts = shared(tracks);
    assert_eq!(pairs.start.len(), pairs.pair.len() + 1);
    assert_eq!(pairs.start.last().copied().unwrap() as usize, pairs.observation.len());
    assert!(pairs.pair.windows(2).all(|w| w[0] < w[1]), "pairs ascend and differ");
    for (p, pair) in pairs.pair.iter().enumerate() {
        assert!(pair[0] < pair[1]);
        let matches = &pairs.observation[pairs.start[p] as usize..pairs.start[p + 1] as usize];
        let n = counts[pair];
        assert!(n >= options.min_shared.max(1), "{pair:?} share {n}");
        assert_eq!(matches.len(), n.min(options.max_matches), "{pair:?} share {n}");
        let mut tracks_met = BTreeSet::new();
        for &[a, b] in matches {
            assert_eq!([tracks.view()[a as usize], tracks.view()[b as usize]], *pair);
            assert_eq!(tracks.track()[a as usize], tracks.track()[b as usize]);
            assert!(tracks_met.insert(tracks.track()[a as usize]), "a track is matched twice");
        }
    }
    pairs
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn pairs_are_those_that_share_enough(n in 2usize..20, m in 1usize..80, share in 0.05..0.9f64, seed in any::<u64>()) {
        let tracks = random_tracks(n, m, share, seed);
        // no limit on partners: every pair that shares enough, and all of its matches
        let all = ViewGraphOptions { min_shared: 5, max_partners: n, max_matches: 1000 };
        let pairs = check(&tracks, &all);
        let wanted: Vec<[u32; 2]> = shared(&tracks).into_iter().filter(|(_, n)| *n >= 5).map(|(pair, _)| pair).collect();
        prop_assert_eq!(&pairs.pair, &wanted);
        // with limits
        let few = ViewGraphOptions { min_shared: 2, max_partners: 4, max_matches: 7 };
        let pairs = check(&tracks, &few);
        let counts = shared(&tracks);
        for view in 0..n as u32 {
            let of = |pair: &[u32; 2]| pair.contains(&view);
            let candidates: Vec<usize> = counts.iter().filter(|(p, n)| of(p) && **n >= 2).map(|(_, n)| *n).collect();
            let kept: Vec<usize> = pairs.pair.iter().filter(|p| of(p)).map(|p| counts[p]).collect();
            prop_assert!(kept.len() >= candidates.len().min(4), "view {} keeps {:?} of {:?}", view, kept, candidates);
            prop_assert_eq!(kept.iter().max(), candidates.iter().max(), "the best partner is kept");
        }
    }
}

#[test]
fn long_tracks_pair_near_views_and_some_far_ones() {
    // every view sees every track: too many pairs to list
    let tracks = random_tracks(100, 20, 1.1, 1);
    let pairs = view_pairs(&tracks, &ViewGraphOptions { max_partners: 100, ..Default::default() });
    let gaps: BTreeSet<u32> = pairs.pair.iter().map(|p| p[1] - p[0]).collect();
    let wanted: BTreeSet<u32> = (1..=12).chain([16, 32, 64]).collect();
    assert_eq!(gaps, wanted);
    for (p, pair) in pairs.pair.iter().enumerate() {
        assert_eq!(pairs.start[p + 1] - pairs.start[p], 20, "{pair:?}");
    }
}

#[test]
fn matches_are_thinned_evenly() {
    let tracks = random_tracks(2, 100, 1.1, 1);
    let pairs = view_pairs(&tracks, &ViewGraphOptions { max_matches: 10, ..Default::default() });
    let mut met: Vec<u32> = pairs.observation.iter().map(|[a, _]| tracks.track()[*a as usize]).collect();
    met.sort_unstable();
    assert_eq!(met.len(), 10);
    let spread = met.iter().collect::<BTreeSet<_>>();
    assert_eq!(spread.len(), 10);
}

#[test]
fn nothing_pairs_with_nothing() {
    for (n, m) in [(0, 0), (3, 0), (0, 3), (1, 5)] {
        let tracks = random_tracks(n, m, 0.9, 1);
        let pairs = view_pairs(&tracks, &ViewGraphOptions::default());
        assert!(pairs.pair.is_empty() && pairs.start == [0] && pairs.observation.is_empty());
    }
    let tracks = random_tracks(6, 50, 0.9, 1);
    for options in [
        ViewGraphOptions { max_partners: 0, ..Default::default() },
        ViewGraphOptions { min_shared: 51, ..Default::default() },
    ] {
        assert!(view_pairs(&tracks, &options).pair.is_empty());
    }
    // no limit from below means one
    let tracks = random_tracks(4, 2, 1.1, 1);
    let pairs = view_pairs(&tracks, &ViewGraphOptions { min_shared: 0, ..Default::default() });
    assert_eq!(pairs.pair.len(), 6);
}

#[test]
fn the_answer_does_not_depend_on_threads() {
    let tracks = random_tracks(30, 600, 0.3, 3);
    let run = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| view_pairs(&tracks, &ViewGraphOptions::default()))
    };
    assert_eq!(run(1), run(4));
}
