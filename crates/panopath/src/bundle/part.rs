//! One jointly scaled part of the input, laid out for the solver: observations by track, sorted by view.

use std::ops::{Deref, Range};
use std::sync::Arc;

use rayon::prelude::*;

use crate::geometry::Vector;

/// Four numbers in one register: a vector padded with zeros, with room for a weight in the last lane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub(crate) struct Lanes(pub [f64; 4]);

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

/// Which observations there are: observation `o` of track `j` (`start[j] <= o < start[j + 1]`) was made by the station
/// `view[o]`.
pub(crate) struct Layout {
    /// Number of stations.
    pub n_views: usize,
    pub start: Vec<u32>,
    pub view: Vec<u32>,
    /// Node of each station, ascending.
    pub node: Vec<u32>,
    pub n_nodes: usize,
    /// Unknowns of each node.
    pub node_freedom: Vec<usize>,
    /// Freedoms of the gauge.
    pub gauge_freedom: usize,
    /// True where a node saw a point more than once.
    pub has_repeats: bool,
    /// Runs of tracks that are summed apart and then added in this order.
    pub chunks: Vec<Range<usize>>,
    /// Tracks whose point is known and stays; empty for none.
    pub held_points: Vec<bool>,
    /// Which track of the input each track is.
    pub input_track: Vec<u32>,
    /// Which observation of the input each observation is.
    pub input_observation: Vec<u32>,
}

/// Points that move: `x(t) = sum_l B_l(t) p_l`, with the values of `B_l` at each observation. Empty where nothing moves.
#[derive(Clone, Default)]
pub(crate) struct Courses {
    /// Where the vectors of each track begin, those of tracks at rest included: one each; empty: all at rest.
    pub start: Vec<u32>,
    /// Where the values of each observation begin.
    pub first: Vec<u32>,
    pub values: Vec<f64>,
    /// By how much a number that the functions depend on, such as a frequency, moves the point at each observation. Empty: no
    /// track has one.
    pub bends: Vec<Lanes>,
    /// Has a track such a number, sought with its vectors?
    pub is_bent: Vec<bool>,
}

impl Courses {
    /// Which vectors are those of a track.
    #[inline(always)]
    pub fn vectors(&self, j: usize) -> Range<usize> {
        self.start[j] as usize..self.start[j + 1] as usize
    }

    /// Is it a track with more unknowns than a position?
    #[inline(always)]
    pub fn moves(&self, j: usize) -> bool {
        !self.start.is_empty() && self.start[j + 1] - self.start[j] > 1
    }

    /// Has a track one more unknown than its vectors?
    pub fn is_bent(&self, j: usize) -> bool {
        self.is_bent.get(j).copied().unwrap_or(false)
    }

    /// Unknowns of a track in `d` dimensions.
    pub fn unknowns(&self, j: usize, d: usize) -> usize {
        let vectors = if self.start.is_empty() { 1 } else { self.vectors(j).len() };
        d * vectors + usize::from(self.is_bent(j))
    }
}

impl Layout {
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

    /// Unknowns of all cameras, less those of the gauge.
    pub fn camera_freedom(&self) -> usize {
        self.node_freedom.iter().sum::<usize>().saturating_sub(self.gauge_freedom)
    }

    /// Is the point of a track known, and no unknown?
    #[inline(always)]
    pub fn holds_point(&self, j: usize) -> bool {
        self.held_points.get(j).copied().unwrap_or(false)
    }

    /// Node that made an observation.
    #[inline(always)]
    pub fn node_of(&self, o: usize) -> u32 {
        self.node[self.view[o] as usize]
    }
}

/// A part: a layout with the ray of each observation, a world direction whose lane 3 holds the precision relative to the
/// reference sigma.
#[derive(Clone)]
pub(crate) struct Part<const D: usize> {
    layout: Arc<Layout>,
    pub ray: Vec<Lanes>,
    /// What points are made of where they move.
    pub courses: Arc<Courses>,
}

impl<const D: usize> Deref for Part<D> {
    type Target = Layout;

    #[inline(always)]
    fn deref(&self) -> &Layout {
        &self.layout
    }
}

/// The functions of one point that moves, at its observations.
#[derive(Clone, Copy)]
pub(crate) struct Course<'a> {
    pub n_functions: usize,
    /// One row for each observation.
    pub values: &'a [f64],
    /// By how much a number that the functions depend on moves the point at each, where it is sought too.
    pub bends: Option<&'a [Lanes]>,
}

impl Course<'_> {
    /// Unknowns in `d` dimensions.
    pub fn unknowns(&self, d: usize) -> usize {
        d * self.n_functions + usize::from(self.bends.is_some())
    }

    /// Where the point is at observation `k` of its own.
    pub fn position(&self, k: usize, vectors: &[Lanes]) -> Lanes {
        let values = &self.values[k * self.n_functions..(k + 1) * self.n_functions];
        values.iter().zip(vectors).fold(Lanes::ZERO, |sum, (b, p)| sum.plus_scaled(*b, p))
    }
}

/// Stations of a part, the nodes that they belong to, and how free these are.
pub(crate) struct Stations {
    /// Node of each station, ascending.
    pub node: Vec<u32>,
    /// Unknowns of each node.
    pub node_freedom: Vec<usize>,
    /// How many of all these the gauge takes.
    pub gauge_freedom: usize,
}

impl Stations {
    /// Each station is a node of its own with an unknown position of `D` coordinates.
    pub fn positions<const D: usize>(n: usize) -> Self {
        Self { node: (0..n as u32).collect(), node_freedom: vec![D; n], gauge_freedom: D + 1 }
    }
}

impl<const D: usize> Part<D> {
    /// The same observations with other rays.
    pub fn with_rays<const E: usize>(&self, ray: Vec<Lanes>) -> Part<E> {
        Part { layout: Arc::clone(&self.layout), ray, courses: Arc::clone(&self.courses) }
    }

    /// The same with points that stay: all that `stays` holds for, by track of the input.
    pub fn holding(mut self, stays: impl Fn(u32) -> bool) -> Self {
        let held: Vec<bool> = self.input_track.iter().map(|&t| stays(t)).collect();
        if let Some(layout) = Arc::get_mut(&mut self.layout).filter(|_| held.contains(&true)) {
            layout.held_points = held;
        }
        self
    }

    /// The same with points that move.
    pub fn moving(self, courses: Courses) -> Self {
        Self { courses: Arc::new(courses), ..self }
    }

    /// Values of the functions of a track that moves, one row for each of its observations, and what bends it.
    pub fn course(&self, j: usize) -> Course<'_> {
        let (courses, observations) = (&self.courses, self.observations(j));
        let n_functions = courses.vectors(j).len();
        let first = courses.first[observations.start] as usize;
        Course {
            n_functions,
            values: &courses.values[first..first + n_functions * observations.len()],
            bends: courses.is_bent(j).then(|| &courses.bends[observations]),
        }
    }

    /// Where a point is at one of its observations.
    #[inline(always)]
    pub fn position(&self, o: usize, j: usize, points: &[Lanes], vectors: &[Lanes]) -> Lanes {
        if self.courses.moves(j) {
            let own = self.courses.vectors(j);
            let first = self.courses.first[o] as usize;
            let values = &self.courses.values[first..first + own.len()];
            values.iter().zip(&vectors[own]).fold(Lanes::ZERO, |sum, (b, p)| sum.plus_scaled(*b, p))
        } else {
            points[j]
        }
    }

    /// Lays out these observations of the input, with their local views and rays.
    ///
    /// Tracks are ordered by their first view, so that neighbours in memory touch neighbouring blocks of the reduced
    /// system.
    pub fn new(
        stations: Stations,
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
        let n_views = stations.node.len();
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
            let node = |o: u32| stations.node[local_view(o as usize) as usize];
            has_repeats |= run.windows(2).any(|w| node(w[0]) == node(w[1]));
        }
        let view = input_observation.iter().map(|&o| local_view(o as usize)).collect();
        let ray = input_observation.iter().map(|&o| ray(o as usize)).collect();
        let chunks = split_evenly(&start);
        let Stations { node, node_freedom, gauge_freedom } = stations;
        let n_nodes = node.last().map_or(0, |&last| last as usize + 1);
        let layout = Layout {
            n_views,
            start,
            view,
            node,
            n_nodes,
            node_freedom,
            gauge_freedom,
            has_repeats,
            held_points: Vec::new(),
            chunks,
            input_track,
            input_observation,
        };
        Self { layout: Arc::new(layout), ray, courses: Arc::default() }
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

/// Runs `task` over the chunks of a part in parallel, each with its own slice of `out` (one entry per track).
pub(crate) fn for_each_chunk<T: Send, const D: usize>(
    part: &Part<D>,
    out: &mut [T],
    task: impl Fn(std::ops::Range<usize>, &mut [T]) + Sync,
) {
    let mut pieces = Vec::with_capacity(part.chunks.len());
    let mut rest = out;
    for tracks in &part.chunks {
        let (piece, tail) = rest.split_at_mut(tracks.len());
        pieces.push((tracks.clone(), piece));
        rest = tail;
    }
    pieces.into_par_iter().for_each(|(tracks, piece)| task(tracks, piece));
}
