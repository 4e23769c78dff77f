//! One jointly scaled part of the input, laid out for the solver: observations by track, sorted by view.

use std::ops::Range;

use crate::geometry::Vector;

/// Four numbers in one register: a vector padded with zeros, with room for a weight in the last lane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub(super) struct Lanes(pub [f64; 4]);

impl Lanes {
    pub const ZERO: Self = Self([0.0; 4]);

    #[inline(always)]
    pub fn from_vector<const D: usize>(v: &Vector<D>) -> Self {
        let mut lanes = [0.0; 4];
        lanes[..D].copy_from_slice(v);
        Self(lanes)
    }

    #[inline(always)]
    pub fn vector<const D: usize>(&self) -> Vector<D> {
        std::array::from_fn(|c| self.0[c])
    }

    /// Inner product over the first `D` lanes.
    #[inline(always)]
    pub fn dot<const D: usize>(&self, other: &Self) -> f64 {
        let mut sum = self.0[0] * other.0[0];
        for c in 1..D {
            sum += self.0[c] * other.0[c];
        }
        sum
    }

    #[inline(always)]
    pub fn plus(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|c| self.0[c] + other.0[c]))
    }

    #[inline(always)]
    pub fn minus(&self, other: &Self) -> Self {
        Self(std::array::from_fn(|c| self.0[c] - other.0[c]))
    }

    #[inline(always)]
    pub fn times(&self, s: f64) -> Self {
        Self(std::array::from_fn(|c| s * self.0[c]))
    }

    /// `self + s * other`.
    #[inline(always)]
    pub fn plus_scaled(&self, s: f64, other: &Self) -> Self {
        Self(std::array::from_fn(|c| self.0[c] + s * other.0[c]))
    }
}

/// Observations a chunk should hold at least, so that splitting the work costs less than it saves.
const CHUNK_OBSERVATIONS: usize = 8_192;
/// Most chunks; a constant, so that sums do not depend on the number of threads.
const MAX_CHUNKS: usize = 32;

/// A part: observation `o` of track `j` (`start[j] <= o < start[j + 1]`) was made by `view[o]` along `ray[o]`, a world
/// direction whose lane 3 holds the precision relative to the reference sigma.
pub(super) struct Part<const D: usize> {
    pub n_views: usize,
    pub start: Vec<u32>,
    pub view: Vec<u32>,
    pub ray: Vec<Lanes>,
    /// True where a view saw a point more than once.
    pub has_repeats: bool,
    /// Runs of tracks that are summed apart and then added in this order.
    pub chunks: Vec<Range<usize>>,
    /// Which track of the input each track is.
    pub input_track: Vec<u32>,
    /// Which observation of the input each observation is.
    pub input_observation: Vec<u32>,
}

impl<const D: usize> Part<D> {
    pub fn n_tracks(&self) -> usize {
        self.start.len() - 1
    }

    pub fn n_observations(&self) -> usize {
        self.view.len()
    }

    #[inline(always)]
    pub fn observations(&self, j: usize) -> Range<usize> {
        self.start[j] as usize..self.start[j + 1] as usize
    }

    /// The same observations with other rays.
    pub fn with_rays<const E: usize>(&self, ray: impl Fn(&Lanes) -> Lanes) -> Part<E> {
        Part {
            n_views: self.n_views,
            start: self.start.clone(),
            view: self.view.clone(),
            ray: self.ray.iter().map(ray).collect(),
            has_repeats: self.has_repeats,
            chunks: self.chunks.clone(),
            input_track: self.input_track.clone(),
            input_observation: self.input_observation.clone(),
        }
    }

    /// Lays out these observations of the input, with their local views and rays.
    ///
    /// Tracks are ordered by their first view, so that neighbours in memory touch neighbouring blocks of the reduced
    /// system.
    pub fn new(
        n_views: usize,
        n_tracks: usize,
        observations: &[u32],
        track_of: &[u32],
        local_view: impl Fn(usize) -> u32,
        ray: impl Fn(usize) -> Lanes,
    ) -> Self {
        let mut first = vec![u32::MAX; n_tracks];
        let mut length = vec![0u32; n_tracks];
        for &o in observations {
            let j = track_of[o as usize] as usize;
            length[j] += 1;
            first[j] = first[j].min(local_view(o as usize));
        }
        let input_track = order_by_first_view(n_views, &first);
        let mut place = vec![u32::MAX; n_tracks];
        let mut start = vec![0u32; input_track.len() + 1];
        for (j, &t) in input_track.iter().enumerate() {
            place[t as usize] = start[j];
            start[j + 1] = start[j] + length[t as usize];
        }
        let total = start[input_track.len()] as usize;
        let mut input_observation = vec![0u32; total];
        for &o in observations {
            let slot = &mut place[track_of[o as usize] as usize];
            if *slot != u32::MAX {
                input_observation[*slot as usize] = o;
                *slot += 1;
            }
        }
        let mut has_repeats = false;
        for j in 0..input_track.len() {
            let run = &mut input_observation[start[j] as usize..start[j + 1] as usize];
            run.sort_unstable_by_key(|&o| (local_view(o as usize), o));
            has_repeats |= run.windows(2).any(|w| local_view(w[0] as usize) == local_view(w[1] as usize));
        }
        let view = input_observation.iter().map(|&o| local_view(o as usize)).collect();
        let ray = input_observation.iter().map(|&o| ray(o as usize)).collect();
        let chunks = split_evenly(&start);
        Self { n_views, start, view, ray, has_repeats, chunks, input_track, input_observation }
    }
}

/// Tracks that were seen, in order of their first view and then of their index (counting sort).
fn order_by_first_view(n_views: usize, first: &[u32]) -> Vec<u32> {
    let mut count = vec![0u32; n_views + 1];
    let kept: Vec<u32> = (0..first.len()).filter(|&j| first[j] != u32::MAX).map(|j| j as u32).collect();
    for &j in &kept {
        count[first[j as usize] as usize + 1] += 1;
    }
    for v in 0..n_views {
        count[v + 1] += count[v];
    }
    let mut order = vec![0u32; kept.len()];
    for &j in &kept {
        let slot = &mut count[first[j as usize] as usize];
        order[*slot as usize] = j;
        *slot += 1;
    }
    order
}

/// Splits the tracks into chunks of equal work; the number depends on the size of the input alone.
fn split_evenly(start: &[u32]) -> Vec<Range<usize>> {
    let n_tracks = start.len() - 1;
    let work: Vec<u64> = start
        .windows(2)
        .scan(0u64, |sum, w| {
            let k = u64::from(w[1] - w[0]);
            *sum += k * k + 8 * k;
            Some(*sum)
        })
        .collect();
    let total = work.last().copied().unwrap_or(0);
    let n_chunks = (start[n_tracks] as usize / CHUNK_OBSERVATIONS).clamp(1, MAX_CHUNKS);
    let mut chunks = Vec::with_capacity(n_chunks);
    let mut begin = 0;
    for c in 1..=n_chunks {
        let end = if c == n_chunks {
            n_tracks
        } else {
            work.partition_point(|&sum| sum < total * c as u64 / n_chunks as u64).max(begin)
        };
        chunks.push(begin..end);
        begin = end;
    }
    chunks
}
