//! Which pairs of views to orient against each other, and what they see in common.
//!
//! Input: tracks. Output: pairs `(i, k)`, `i < k`, with the observations that both made of the same tracks. Every view keeps
//! the partners with which it shares most, and some of the others, spread over the rest of its list: near pairs are many and
//! alike, far ones close loops.

use rayon::prelude::*;

use crate::tracks::Tracks;

/// Options of [`view_pairs`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ViewGraphOptions {
    /// Tracks that two views must share. Default: 12.
    pub min_shared: usize,
    /// Partners kept for each view. Default: 12.
    pub max_partners: usize,
    /// Most matches of a pair; more are thinned evenly. Default: 400.
    pub max_matches: usize,
}

impl Default for ViewGraphOptions {
    fn default() -> Self {
        Self { min_shared: 12, max_partners: 12, max_matches: 400 }
    }
}

/// Pairs of views, with the matches of pair `p` at `start[p]..start[p + 1]`.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ViewPairs {
    /// Views of each pair, the smaller first; ascending.
    pub pair: Vec<[u32; 2]>,
    /// Where the matches of each pair begin; one more entry than pairs.
    pub start: Vec<u32>,
    /// Observations that match: by the first view, and by the second.
    pub observation: Vec<[u32; 2]>,
}

/// Tracks longer than this pair each view with near ones and with some far ones only.
const LONG_TRACK: usize = 24;

/// Lists the pairs to orient; see the module's text.
pub fn view_pairs<const D: usize>(tracks: &Tracks<D>, options: &ViewGraphOptions) -> ViewPairs {
    let by_track = observations_by_track(tracks);
    let mut shared: Vec<u64> = by_track
        .par_iter()
        .with_min_len(256)
        .flat_map_iter(|observations| matches_of(observations).map(|[a, b]| key(tracks, a, b)))
        .collect();
    shared.par_sort_unstable();
    let counted = count(&shared, options.min_shared);
    let kept = choose(&counted, tracks.n_views(), options.max_partners);
    gather(tracks, &by_track, &kept, options.max_matches)
}

/// Observations of each track, one a view, in the order of their views.
fn observations_by_track<const D: usize>(tracks: &Tracks<D>) -> Vec<Vec<u32>> {
    let mut by_track = vec![Vec::new(); tracks.n_tracks()];
    for (o, &track) in tracks.track().iter().enumerate() {
        by_track[track as usize].push(o as u32);
    }
    by_track.par_iter_mut().for_each(|observations| {
        observations.sort_by_key(|&o| tracks.view()[o as usize]);
        observations.dedup_by_key(|o| tracks.view()[*o as usize]);
    });
    by_track
}

/// Pairs of observations of one track: all of them, or of a long one those a few views or a power of two apart.
fn matches_of(observations: &[u32]) -> impl Iterator<Item = [u32; 2]> + '_ {
    let n = observations.len();
    let is_taken = move |gap: usize| n <= LONG_TRACK || gap <= LONG_TRACK / 2 || gap.is_power_of_two();
    (1..n)
        .filter(move |&gap| is_taken(gap))
        .flat_map(move |gap| (0..n - gap).map(move |i| [observations[i], observations[i + gap]]))
}

fn key<const D: usize>(tracks: &Tracks<D>, a: u32, b: u32) -> u64 {
    u64::from(tracks.view()[a as usize]) << 32 | u64::from(tracks.view()[b as usize])
}

/// Pairs that occur often enough, with how often, in ascending order.
fn count(sorted: &[u64], min_shared: usize) -> Vec<(u64, u32)> {
    let runs = sorted.chunk_by(|a, b| a == b);
    runs.filter(|run| run.len() >= min_shared.max(1)).map(|run| (run[0], run.len() as u32)).collect()
}

/// Pairs that one of their views keeps, in ascending order.
fn choose(counted: &[(u64, u32)], n_views: usize, max_partners: usize) -> Vec<u64> {
    let mut partners: Vec<Vec<(u32, u64)>> = vec![Vec::new(); n_views];
    for &(pair, n) in counted {
        partners[(pair >> 32) as usize].push((n, pair));
        partners[(pair & u64::from(u32::MAX)) as usize].push((n, pair));
    }
    let mut kept = Vec::new();
    for list in &mut partners {
        list.sort_unstable_by_key(|&(n, pair)| (std::cmp::Reverse(n), pair));
        let near = max_partners.div_ceil(2).min(list.len());
        kept.extend(list[..near].iter().map(|&(_, pair)| pair));
        let others = &list[near..];
        let far = (max_partners - max_partners.div_ceil(2)).min(others.len());
        kept.extend((0..far).map(|k| others[(k + 1) * others.len() / far.max(1) - 1].1));
    }
    kept.sort_unstable();
    kept.dedup();
    kept
}

/// The matches of the pairs that are kept, thinned where they are many.
fn gather<const D: usize>(tracks: &Tracks<D>, by_track: &[Vec<u32>], kept: &[u64], max_matches: usize) -> ViewPairs {
    let mut matches: Vec<(u32, [u32; 2])> = by_track
        .par_iter()
        .with_min_len(256)
        .flat_map_iter(|observations| {
            matches_of(observations)
                .filter_map(|[a, b]| kept.binary_search(&key(tracks, a, b)).ok().map(|pair| (pair as u32, [a, b])))
        })
        .collect();
    matches.par_sort_unstable();
    let mut found = ViewPairs { start: vec![0], ..ViewPairs::default() };
    for run in matches.chunk_by(|a, b| a.0 == b.0) {
        let n = run.len().min(max_matches.max(1));
        found.observation.extend((0..n).map(|k| run[k * run.len() / n].1));
        found.start.push(found.observation.len() as u32);
        let pair = kept[run[0].0 as usize];
        found.pair.push([(pair >> 32) as u32, pair as u32]);
    }
    found
}
