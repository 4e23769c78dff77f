//! Headings of planar views from bearings alone: a start for a refinement of everything at once.
//!
//! A planar view has a place and a heading, a point a place; two views give no constraint, three views of five points do. So
//!
//! 1. triplets of views that share enough tracks give differences of headings (`triplet`: closed form, sampled against
//!    false bearings, refined);
//! 2. the differences are averaged over all views (`average`);
//! 3. with headings known, positions are a solved problem; views that no triplet reached are resected onto the points found so
//!    (`resect`), and that again until nothing is added.
//!
//! Shapes: one angle for each observation, one heading for each view; headings of a component are up to one turn.

use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::geometry::{Rotation, Vector};
use crate::least_squares::LeastSquaresError;
use crate::positions::{PositionError, PositionOptions, solve_positions};
use crate::tracks::{Tracks, TracksError};

mod average;
mod complex;
mod resect;
mod triplet;

use average::{Averaged, Edge, average_headings};
use complex::{Complex, wrapped};
use resect::{Sight, resect};
use triplet::{Sighting, solve_triplet};

/// Options of [`start_headings`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingOptions {
    /// Standard deviation of a bearing. Default: the median of the tracks' `sigma_rad`, or half a degree.
    pub noise_rad: Option<f64>,
    /// Fewest tracks that three views must share to be a triplet. Default: 7; 5 fix it, the others are the check.
    pub min_tracks: usize,
    /// Triplets sought for each view. Default: 12.
    pub triplets: usize,
    /// Fewest known points onto which a view is resected. Default: 4; 3 fix it, without a check.
    pub min_points: usize,
    /// Seed of the samples. Default: 0.
    pub seed: u64,
}

impl Default for HeadingOptions {
    fn default() -> Self {
        Self { noise_rad: None, min_tracks: 7, triplets: 12, min_points: 4, seed: 0 }
    }
}

/// How the search ended. A status is an answer, not an error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HeadingStatus {
    /// All views in one component.
    Converged,
    /// Views in several components, or in none.
    Disconnected,
    /// No view has a heading.
    Undetermined,
}

impl HeadingStatus {
    /// The name used in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Disconnected => "disconnected",
            Self::Undetermined => "undetermined",
        }
    }
}

/// Headings of views.
#[derive(Debug, Clone, PartialEq)]
pub struct Headings {
    /// Heading of each view, `world_from_cam` being the rotation by it; NaN where not determined.
    pub heading_rad: Vec<f64>,
    /// Component of each view, 0 the largest, -1 none; headings of different components share no zero.
    pub view_component: Vec<i32>,
    /// True where a view was resected, false where triplets oriented it.
    pub resected: Vec<bool>,
    /// Triplets that were tried and those that had an answer.
    pub n_triplets: [usize; 2],
    /// How it ended.
    pub status: HeadingStatus,
}

/// Why headings cannot be sought at all.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum HeadingError {
    /// An option out of its range.
    #[error("{0}")]
    Option(String),
    /// The linear algebra failed.
    #[error(transparent)]
    LeastSquares(#[from] LeastSquaresError),
    /// Positions could not be sought.
    #[error(transparent)]
    Positions(#[from] PositionError),
    /// A part of the tracks made no tracks.
    #[error(transparent)]
    Tracks(#[from] TracksError),
}

/// Headings of planar views, each component up to a common turn.
///
/// # Errors
/// [`HeadingError`] where an option is out of its range. Views that nothing orients are no error: they are NaN.
///
/// # Example
/// ```
/// use panopath::headings::{HeadingOptions, HeadingStatus, start_headings};
/// use panopath::synthetic::{Orientations, WorldKind, WorldOptions, simulate};
/// let options = WorldOptions { n_views: 6, n_points: 30, orientations: Orientations::Random, ..Default::default() };
/// let world = simulate::<2>(WorldKind::Box, &options)?;
/// let found = start_headings(&world.tracks, &HeadingOptions::default())?;
/// assert_eq!(found.status, HeadingStatus::Converged);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn start_headings(tracks: &Tracks<2>, options: &HeadingOptions) -> Result<Headings, HeadingError> {
    let noise_rad = check(tracks, options)?;
    let seen = Seen::new(tracks);
    let triples = seen.triples(options);
    let solved: Vec<Vec<Edge>> =
        triples.par_iter().enumerate().map(|(k, triple)| seen.edges(triple, noise_rad, options, k)).collect();
    let n_solved = solved.iter().filter(|edges| !edges.is_empty()).count();
    let averaged = average_headings(tracks.n_views(), &solved.concat())?;
    let mut found = Headings::from_average(averaged, [triples.len(), n_solved]);
    found.resect_the_rest(tracks, &seen, noise_rad, options)?;
    found.name_status();
    Ok(found)
}

fn check(tracks: &Tracks<2>, options: &HeadingOptions) -> Result<f64, HeadingError> {
    const HALF_A_DEGREE: f64 = 0.5 * std::f64::consts::PI / 180.0;
    for (name, value, least) in [
        ("min_tracks", options.min_tracks, 6),
        ("triplets", options.triplets, 1),
        ("min_points", options.min_points, 3),
    ] {
        if value < least {
            return Err(HeadingError::Option(format!("{name} is {value}, expected at least {least}")));
        }
    }
    let median = |sigma: &[f64]| {
        let mut sorted = sigma.to_vec();
        let middle = sorted.len() / 2;
        (!sorted.is_empty()).then(|| *sorted.select_nth_unstable_by(middle, f64::total_cmp).1)
    };
    let noise_rad = options.noise_rad.or_else(|| tracks.sigma_rad().and_then(median)).unwrap_or(HALF_A_DEGREE);
    if noise_rad > 0.0 && noise_rad < 0.5 {
        Ok(noise_rad)
    } else {
        Err(HeadingError::Option(format!("noise_rad is {noise_rad}, expected a number above 0, below 0.5")))
    }
}

/// Observations by view and by track, the first of several of one track in one view.
struct Seen {
    /// `(track, angle)` of each view, by track.
    of_view: Vec<Vec<(u32, f64)>>,
    /// Views of each track, ascending.
    of_track: Vec<Vec<u32>>,
}

impl Seen {
    fn new(tracks: &Tracks<2>) -> Self {
        let mut of_view = vec![Vec::new(); tracks.n_views()];
        let mut of_track = vec![Vec::new(); tracks.n_tracks()];
        for ((&view, &track), [x, y]) in tracks.view().iter().zip(tracks.track()).zip(tracks.bearing()) {
            of_view[view as usize].push((track, y.atan2(*x)));
        }
        for (view, list) in of_view.iter_mut().enumerate() {
            list.sort_by_key(|(track, _)| *track);
            list.dedup_by_key(|(track, _)| *track);
            for (track, _) in list {
                of_track[*track as usize].push(view as u32);
            }
        }
        Self { of_view, of_track }
    }

    /// Triplets to try: each view with pairs drawn from those it shares most tracks with.
    fn triples(&self, options: &HeadingOptions) -> Vec<[u32; 3]> {
        /// Views from which partners are drawn.
        const PARTNERS: usize = 16;
        let of_view = |view: usize| {
            let mut rng = stream(options.seed, view as u64);
            let mut partners: Vec<(usize, u64, u32)> = self
                .shared(view)
                .into_iter()
                .filter(|(_, count)| *count >= options.min_tracks)
                .map(|(other, count)| (count, rng.random(), other))
                .collect();
            partners.sort_by(|a, b| b.cmp(a));
            partners.truncate(PARTNERS);
            let mut chosen = Vec::new();
            for _ in 0..if partners.len() < 2 { 0 } else { options.triplets } {
                let a = rng.random_range(0..partners.len());
                let b = (a + rng.random_range(1..partners.len())) % partners.len();
                let mut triple = [view as u32, partners[a].2, partners[b].2];
                triple.sort_unstable();
                chosen.push(triple);
            }
            chosen
        };
        let mut triples: Vec<[u32; 3]> = (0..self.of_view.len()).into_par_iter().flat_map_iter(of_view).collect();
        triples.sort_unstable();
        triples.dedup();
        triples
    }

    /// Number of tracks shared with each other view.
    fn shared(&self, view: usize) -> std::collections::BTreeMap<u32, usize> {
        let mut count = std::collections::BTreeMap::new();
        for (track, _) in &self.of_view[view] {
            for &other in self.of_track[*track as usize].iter().filter(|&&other| other as usize != view) {
                *count.entry(other).or_insert(0) += 1;
            }
        }
        count
    }

    /// Angles of the tracks that three views share.
    fn common(&self, triple: &[u32; 3]) -> Vec<Sighting> {
        let [a, b, c] = triple.map(|view| &self.of_view[view as usize]);
        let angle_in = |list: &[(u32, f64)], track: u32| {
            list.binary_search_by_key(&track, |(track, _)| *track).ok().map(|place| list[place].1)
        };
        a.iter().filter_map(|(track, angle)| Some([*angle, angle_in(b, *track)?, angle_in(c, *track)?])).collect()
    }

    /// The three differences of headings of a triplet, or none.
    fn edges(&self, triple: &[u32; 3], noise_rad: f64, options: &HeadingOptions, index: usize) -> Vec<Edge> {
        /// Differences less certain than this (radians) say nothing.
        const WORST_SIGMA: f64 = 0.2;
        let common = self.common(triple);
        if common.len() < options.min_tracks {
            return Vec::new();
        }
        let mut rng = stream(options.seed ^ 0x7472_6970, index as u64);
        let Some(found) = solve_triplet(&common, noise_rad, &mut rng) else { return Vec::new() };
        let ([h2, h3], cov) = (found.heading, found.covariance);
        let between = (cov[0][0] + cov[1][1] - 2.0 * cov[0][1]).max(0.0);
        let [a, b, c] = *triple;
        [(a, b, h2, cov[0][0]), (a, c, h3, cov[1][1]), (b, c, wrapped(h3 - h2), between)]
            .into_iter()
            .map(|(from, to, turn, variance)| Edge { from, to, turn, sigma: variance.sqrt().max(1e-9) })
            .filter(|edge| edge.sigma < WORST_SIGMA)
            .collect()
    }
}

fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

impl Headings {
    fn from_average(averaged: Averaged, n_triplets: [usize; 2]) -> Self {
        let Averaged { mut heading, component } = averaged;
        for (h, &c) in heading.iter_mut().zip(&component) {
            *h = if c < 0 { f64::NAN } else { *h };
        }
        let resected = vec![false; heading.len()];
        let status = HeadingStatus::Undetermined;
        Self { heading_rad: heading, view_component: component, resected, n_triplets, status }
    }

    fn name_status(&mut self) {
        let oriented = |component: i32| self.view_component.iter().filter(|&&c| c == component).count();
        self.status = match oriented(0) {
            0 => HeadingStatus::Undetermined,
            n if n == self.view_component.len() => HeadingStatus::Converged,
            _ => HeadingStatus::Disconnected,
        };
    }

    /// Solves for the points of each component and resects views that have no heading, until none is added.
    fn resect_the_rest(
        &mut self,
        tracks: &Tracks<2>,
        seen: &Seen,
        noise_rad: f64,
        options: &HeadingOptions,
    ) -> Result<(), HeadingError> {
        const ROUNDS: usize = 5;
        let n_components = self.view_component.iter().fold(0, |n, &c| n.max(c + 1));
        for component in 0..n_components {
            for _ in 0..ROUNDS {
                if !self.view_component.contains(&-1) {
                    return Ok(());
                }
                let points = self.points(tracks, component)?;
                let open: Vec<usize> = (0..seen.of_view.len()).filter(|&v| self.view_component[v] < 0).collect();
                let found: Vec<_> = open
                    .into_par_iter()
                    .filter_map(|view| {
                        let sights: Vec<Sight> = seen.of_view[view]
                            .iter()
                            .filter_map(|(track, angle)| points[*track as usize].map(|z| (z, *angle)))
                            .collect();
                        let mut rng = stream(options.seed ^ 0x7265_7365, view as u64);
                        resect(&sights, noise_rad, options.min_points, &mut rng).map(|found| (view, found.heading))
                    })
                    .collect();
                for &(view, heading) in &found {
                    self.heading_rad[view] = heading;
                    self.view_component[view] = component;
                    self.resected[view] = true;
                }
                if found.is_empty() {
                    break;
                }
            }
        }
        Ok(())
    }

    /// Points of a component, by track.
    fn points(&self, tracks: &Tracks<2>, component: i32) -> Result<Vec<Option<Complex>>, HeadingError> {
        let part = self.observations_of(tracks, component)?;
        let rotations: Vec<Rotation<2>> =
            self.heading_rad.iter().map(|h| Rotation::from_angle(if h.is_nan() { 0.0 } else { -h })).collect();
        let scene = solve_positions(&part, Some(&rotations), &PositionOptions::default())?;
        let place = |(x, &c): (&Vector<2>, &i32)| (c == 0).then(|| Complex::new(x[0], x[1]));
        Ok(scene.points.iter().zip(&scene.track_component).map(place).collect())
    }

    fn observations_of(&self, tracks: &Tracks<2>, component: i32) -> Result<Tracks<2>, TracksError> {
        let keep: Vec<usize> =
            (0..tracks.len()).filter(|&o| self.view_component[tracks.view()[o] as usize] == component).collect();
        let ids = |all: &[u32]| keep.iter().map(|&o| all[o]).collect::<Vec<u32>>();
        let sigma = tracks.sigma_rad().map(|all| keep.iter().map(|&o| all[o]).collect());
        let bearing = keep.iter().map(|&o| tracks.bearing()[o]).collect();
        let (view, track) = (ids(tracks.view()), ids(tracks.track()));
        Tracks::new(view, track, bearing, sigma, tracks.n_views(), tracks.n_tracks())
    }
}
