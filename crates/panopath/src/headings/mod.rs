//! Headings of planar views from bearings alone: a start for a refinement of everything at once.
//!
//! A planar view has a place and a heading, a point a place; two views give no constraint, three views of five points do. So
//!
//! 1. triplets of views that share enough tracks give differences of headings (`triplet`: closed form, sampled against
//!    false bearings, refined);
//!    where views see few tracks, sets of four tracks that many views share give headings of these (`quad`, the dual);
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
mod quad;
mod resect;
mod triplet;

use average::{Averaged, Edge, average_headings};
use complex::{Complex, wrapped};
use quad::{FourAngles, solve_quad};
use resect::{Sight, resect};
use triplet::{Sighting, solve_triplet};

/// Options of [`start_headings`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingOptions {
    /// Standard deviation of a bearing. Default: the median of the tracks' `sigma_rad`, or what triplets
    /// show, half a degree at most.
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
    /// The same of sets of four tracks.
    pub n_quads: [usize; 2],
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
    let known_rad = check(tracks, options)?;
    let seen = Seen::new(tracks);
    let triples = seen.triples(options);
    let noise_rad = known_rad.unwrap_or_else(|| seen.noise(&triples, options));
    // few landmarks show no noise, and points found are off themselves: there the largest is believed
    let wide_rad = known_rad.unwrap_or(MOST_NOISE_RAD);
    let solved: Vec<Vec<Edge>> =
        triples.par_iter().enumerate().map(|(k, triple)| seen.edges(triple, noise_rad, options, k)).collect();
    let n_solved = solved.iter().filter(|edges| !edges.is_empty()).count();
    let quads = seen.quads(options);
    let dual: Vec<Vec<Edge>> =
        quads.par_iter().enumerate().map(|(k, quad)| seen.quad_edges(quad, wide_rad, options, k)).collect();
    let n_dual = dual.iter().filter(|edges| !edges.is_empty()).count();
    // each quad is a node of its own: the frame in which its views have their headings
    let averaged = average_headings(tracks.n_views() + quads.len(), &[solved.concat(), dual.concat()].concat())?;
    let mut found = Headings::from_average(averaged, tracks.n_views());
    (found.n_triplets, found.n_quads) = ([triples.len(), n_solved], [quads.len(), n_dual]);
    found.resect_the_rest(tracks, &seen, wide_rad, options)?;
    found.name_status();
    Ok(found)
}

fn check(tracks: &Tracks<2>, options: &HeadingOptions) -> Result<Option<f64>, HeadingError> {
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
    let noise_rad = options.noise_rad.or_else(|| tracks.sigma_rad().and_then(median));
    match noise_rad {
        Some(noise) if !(noise > 0.0 && noise < 0.5) => {
            Err(HeadingError::Option(format!("noise_rad is {noise}, expected a number above 0, below 0.5")))
        }
        _ => Ok(noise_rad),
    }
}

/// Noise of a bearing where nothing says what it is: half a degree.
const MOST_NOISE_RAD: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Differences of headings less certain than this (radians) say nothing.
const WORST_SIGMA: f64 = 0.2;

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
        /// Triplets drawn for each one that is kept, those that share most.
        const DRAWN: usize = 3;
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
            for _ in 0..if partners.len() < 2 { 0 } else { DRAWN * options.triplets } {
                let a = rng.random_range(0..partners.len());
                let b = (a + rng.random_range(1..partners.len())) % partners.len();
                let mut triple = [view as u32, partners[a].2, partners[b].2];
                triple.sort_unstable();
                let count = self.common(&triple).len();
                if count >= options.min_tracks {
                    chosen.push((count, triple));
                }
            }
            chosen.sort_by_key(|(count, triple)| (std::cmp::Reverse(*count), *triple));
            chosen.dedup();
            chosen.truncate(options.triplets);
            chosen.into_iter().map(|(_, triple)| triple)
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

    /// Noise of a bearing as a sample of the triplets shows it.
    fn noise(&self, triples: &[[u32; 3]], options: &HeadingOptions) -> f64 {
        const LEAST: f64 = 1e-4;
        const SAMPLE: usize = 200;
        /// Fewer triplets show nothing.
        const FEW: usize = 20;
        let every = triples.len().div_ceil(SAMPLE).max(1);
        let one = |(k, triple): (usize, &[u32; 3])| {
            Some(
                solve_triplet(&self.common(triple), MOST_NOISE_RAD, &mut stream(options.seed ^ 0x6e6f_6973, k as u64))?
                    .noise_rad,
            )
        };
        let mut found: Vec<f64> = triples.par_iter().step_by(every).enumerate().filter_map(one).collect();
        if found.len() < FEW {
            return MOST_NOISE_RAD;
        }
        let middle = found.len() / 2;
        found.select_nth_unstable_by(middle, f64::total_cmp).1.clamp(LEAST, MOST_NOISE_RAD)
    }

    /// Sets of four tracks that many views share, of those views that see few.
    fn quads(&self, options: &HeadingOptions) -> Vec<[u32; 4]> {
        /// Views that see more have triplets, and too many sets of four.
        const FEW: usize = 9;
        const LEAST_VIEWS: usize = 6;
        let mut count = std::collections::BTreeMap::<[u32; 4], usize>::new();
        for seen in self.of_view.iter().filter(|seen| seen.len() <= FEW) {
            for d in 3..seen.len() {
                for c in 2..d {
                    for b in 1..c {
                        for a in 0..b {
                            *count.entry([a, b, c, d].map(|k| seen[k].0)).or_insert(0) += 1;
                        }
                    }
                }
            }
        }
        let mut quads: Vec<(usize, [u32; 4])> =
            count.into_iter().filter(|(_, n)| *n >= LEAST_VIEWS).map(|(quad, n)| (n, quad)).collect();
        quads.sort_by_key(|(n, quad)| (std::cmp::Reverse(*n), *quad));
        quads.truncate(options.triplets * self.of_view.len());
        quads.into_iter().map(|(_, quad)| quad).collect()
    }

    /// Headings of the views of four tracks in a frame of their own, or none.
    fn quad_edges(&self, quad: &[u32; 4], noise_rad: f64, options: &HeadingOptions, index: usize) -> Vec<Edge> {
        let angle_in = |view: u32, track: u32| {
            let list = &self.of_view[view as usize];
            list.binary_search_by_key(&track, |(track, _)| *track).ok().map(|place| list[place].1)
        };
        let (mut views, mut seen) = (Vec::new(), Vec::<FourAngles>::new());
        for &view in &self.of_track[quad[0] as usize] {
            if let [Some(a), Some(b), Some(c), Some(d)] = quad.map(|track| angle_in(view, track)) {
                views.push(view);
                seen.push([a, b, c, d]);
            }
        }
        let frame = (self.of_view.len() + index) as u32;
        let mut rng = stream(options.seed ^ 0x7175_6164, index as u64);
        solve_quad(&seen, noise_rad, &mut rng)
            .into_iter()
            .filter(|found| found.sigma < WORST_SIGMA)
            .map(|found| Edge {
                from: frame,
                to: views[found.index],
                turn: found.heading,
                sigma: found.sigma.max(1e-9),
            })
            .collect()
    }

    /// The three differences of headings of a triplet, or none.
    fn edges(&self, triple: &[u32; 3], noise_rad: f64, options: &HeadingOptions, index: usize) -> Vec<Edge> {
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

/// Labels anew, the largest first.
fn by_size(component: &[i32]) -> Vec<i32> {
    let n = component.iter().fold(0, |n, &c| n.max(c + 1));
    let size = |label: i32| component.iter().filter(|&&c| c == label).count();
    let mut order: Vec<(usize, i32)> = (0..n).map(|label| (size(label), label)).filter(|(size, _)| *size > 1).collect();
    order.sort_by_key(|(size, label)| (std::cmp::Reverse(*size), *label));
    let rank = |c: &i32| order.iter().position(|(_, label)| label == c).map_or(-1, |place| place as i32);
    component.iter().map(rank).collect()
}

fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

impl Headings {
    fn from_average(averaged: Averaged, n_views: usize) -> Self {
        let Averaged { mut heading, component } = averaged;
        heading.truncate(n_views);
        let view_component = by_size(&component[..n_views]);
        for (h, &c) in heading.iter_mut().zip(&view_component) {
            *h = if c < 0 { f64::NAN } else { *h };
        }
        let resected = vec![false; heading.len()];
        let (n_triplets, n_quads, status) = ([0; 2], [0; 2], HeadingStatus::Undetermined);
        Self { heading_rad: heading, view_component, resected, n_triplets, n_quads, status }
    }

    fn name_status(&mut self) {
        let oriented = |component: i32| self.view_component.iter().filter(|&&c| c == component).count();
        self.status = match oriented(0) {
            0 => HeadingStatus::Undetermined,
            n if n == self.view_component.len() => HeadingStatus::Converged,
            _ => HeadingStatus::Disconnected,
        };
    }

    /// Solves for the points of each component and resects the views without a heading and those of smaller components onto
    /// them, until none is added.
    fn resect_the_rest(
        &mut self,
        tracks: &Tracks<2>,
        seen: &Seen,
        noise_rad: f64,
        options: &HeadingOptions,
    ) -> Result<(), HeadingError> {
        const ROUNDS: usize = 5;
        /// Points that take a view out of the component it has: two more than fix it.
        const MOVED: usize = 5;
        let n_components = self.view_component.iter().fold(0, |n, &c| n.max(c + 1));
        for component in 0..n_components {
            for _ in 0..ROUNDS {
                // views of smaller components too: so components that share points become one
                let is_open = |c: i32| c < 0 || c > component;
                let open: Vec<usize> = (0..seen.of_view.len()).filter(|&v| is_open(self.view_component[v])).collect();
                if open.is_empty() || !self.view_component.contains(&component) {
                    break;
                }
                let points = self.points(tracks, component)?;
                let found: Vec<_> = open
                    .into_par_iter()
                    .filter_map(|view| {
                        let sights: Vec<Sight> = seen.of_view[view]
                            .iter()
                            .filter_map(|(track, angle)| points[*track as usize].map(|z| (z, *angle)))
                            .collect();
                        let mut rng = stream(options.seed ^ 0x7265_7365, view as u64);
                        let has_one = self.view_component[view] >= 0;
                        let least = if has_one { options.min_points.max(MOVED) } else { options.min_points };
                        resect(&sights, noise_rad, least, &mut rng).map(|found| (view, found.heading))
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
        self.view_component = by_size(&self.view_component);
        for (h, &c) in self.heading_rad.iter_mut().zip(&self.view_component) {
            *h = if c < 0 { f64::NAN } else { *h };
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
