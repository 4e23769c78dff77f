//! Matches between the features of two images: nearest descriptors, where geometry allows them.
//!
//! Descriptors are 128 bytes of about equal length; between two of them stands the squared distance
//!
//! ```text
//! |a - b|^2 = |a|^2 + |b|^2 - 2 a.b,
//! ```
//!
//! in whole numbers, so that every machine finds the same matches (all of them are below 2^24, which single precision
//! holds exactly). A match is mutual (each is the other's nearest), near
//! (`max_distance`) and distinct (nearer than `max_ratio` times the second nearest, on both sides: Lowe, IJCV 2004,
//! section 7.1).
//!
//! What is known of the motion saves most of the work. A point seen along `q = second_from_first b` from the place of the
//! first camera moves, seen from the second, along the great circle from `q` away from the motion `e`,
//!
//! ```text
//! n = q x e / |q x e|,   t = (q (q.e) - e) / |q x e|,   |n.b'| <= sin(band),   t.b' >= -sin(band),   q.b' >= cos(radius),
//! ```
//!
//! and never gets beyond `-e`: with `o` along `q - (q.e) e`, `o.b' >= -sin(band)`.
//!
//! Only features `b'` there are compared. Great circles through `e` are meridians about it, so the features of the second
//! image are kept by their distance to `e` and their azimuth about it; where no direction is known, in a grid of cubes
//! around the sphere, which has no poles.

use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::{Range, RangeInclusive};
use std::slice::from_ref;

use pulp::bytemuck::cast_slice;
use rayon::prelude::*;

use crate::geometry::{Rotation, Vector, dot, norm, normalized, scale, sub, tangent_basis};

/// Numbers in a descriptor.
pub const LENGTH: usize = 128;

/// Cubes of the grid along each axis, at most.
const MAX_CELLS: usize = 40;

/// Features of all images, image by image.
#[derive(Debug, Clone, Copy)]
pub struct Features<'a> {
    /// Where the features of each image begin, and where the last ones end.
    pub starts: &'a [usize],
    /// One descriptor a feature.
    pub descriptors: &'a [[u8; LENGTH]],
    /// Bearings, unit vectors; a feature without one is not finite, and is never found where a motion is known.
    pub bearings: &'a [Vector<3>],
}

/// What is known of the motion between two images.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guide {
    /// Takes bearings of the first image to the second.
    pub second_from_first: Rotation<3>,
    /// Unit vector from the first centre to the second, in the frame of the first image.
    pub direction: Option<Vector<3>>,
    /// Largest parallax, radians.
    pub radius_rad: f64,
    /// Largest angle to the great circle of the motion, radians.
    pub band_rad: f64,
}

/// Two images to match.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImagePair {
    /// Index of the first image.
    pub first: usize,
    /// Index of the second image.
    pub second: usize,
    /// What is known of the motion; without it every feature is compared with every other.
    pub guide: Option<Guide>,
}

/// What a caller may choose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MatchOptions {
    /// The nearest descriptor is nearer than this share of the distance to the second nearest; above 0, at most 1.
    pub max_ratio: f64,
    /// Largest distance, in units of the descriptors' length; above 0.
    pub max_distance: f64,
    /// Only the first so many features of an image take part.
    pub max_features: usize,
}

impl Default for MatchOptions {
    fn default() -> Self {
        Self { max_ratio: 0.8, max_distance: 0.7, max_features: usize::MAX }
    }
}

/// Why features cannot be matched.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MatchError {
    /// Arrays that do not belong together.
    #[error("{name} has {found} entries, expected {expected}")]
    Length {
        /// Which array.
        name: &'static str,
        /// What it has.
        found: usize,
        /// What the others ask for.
        expected: usize,
    },
    /// Starts that do not ascend from 0.
    #[error("feature_starts[{0}] is below the entry before it, expected numbers that ascend from 0")]
    Starts(usize),
    /// A pair of an image that there is not, or of one image.
    #[error("pairs[{index}] is [{first}, {second}], expected two different images of {n_images}")]
    Pair {
        /// Row.
        index: usize,
        /// Its first image.
        first: usize,
        /// Its second image.
        second: usize,
        /// How many images there are.
        n_images: usize,
    },
    /// A guide that is not of this world.
    #[error("{name}[{index}] is {found}, expected {expected}")]
    Guide {
        /// Which argument.
        name: &'static str,
        /// Row of the pair.
        index: usize,
        /// The value given.
        found: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// An option out of its range.
    #[error("{name} is {found}, expected {expected}")]
    Option {
        /// Which option.
        name: &'static str,
        /// The value given.
        found: f64,
        /// What it may be.
        expected: &'static str,
    },
}

/// Matches the features of pairs of images; see the module's text for the rules.
///
/// For each pair, the features of the first image and of the second that match, counted within their images, in the order
/// of the first. The answer does not depend on the number of threads.
///
/// # Errors
/// [`MatchError`] naming the first entry that cannot be used.
pub fn match_features(
    features: &Features,
    pairs: &[ImagePair],
    options: &MatchOptions,
) -> Result<Vec<Vec<[u32; 2]>>, MatchError> {
    check(features, pairs, options)?;
    let arch = pulp::Arch::new();
    let squared: Vec<i32> = features.descriptors.par_iter().map(|d| product(d, d)).collect();
    Ok(pairs
        .par_iter()
        .map(|pair| {
            let first = Side::new(features, &squared, pair.first, options.max_features);
            let second = Side::new(features, &squared, pair.second, options.max_features);
            let nearest = match &pair.guide {
                None => arch.dispatch(Exhaustive { first: &first, second: &second }),
                Some(guide) => {
                    let allowed = Allowed::new(guide, &second);
                    arch.dispatch(Guided { first: &first, second: &second, allowed: &allowed })
                }
            };
            nearest.matches(options, first.scale.max(second.scale))
        })
        .collect())
}

fn check(features: &Features, pairs: &[ImagePair], options: &MatchOptions) -> Result<(), MatchError> {
    let starts = features.starts;
    if let Some(k) = (0..starts.len()).find(|&k| if k == 0 { starts[0] != 0 } else { starts[k] < starts[k - 1] }) {
        return Err(MatchError::Starts(k));
    }
    let n = starts.last().copied().unwrap_or(0);
    for (name, found) in [("descriptors", features.descriptors.len()), ("bearings", features.bearings.len())] {
        if found != n {
            return Err(MatchError::Length { name, found, expected: n });
        }
    }
    let n_images = starts.len().saturating_sub(1);
    for (index, pair) in pairs.iter().enumerate() {
        let &ImagePair { first, second, .. } = pair;
        if first >= n_images || second >= n_images || first == second {
            return Err(MatchError::Pair { index, first, second, n_images });
        }
        check_guide(index, pair.guide.as_ref())?;
    }
    for (name, found) in [("max_ratio", options.max_ratio), ("max_distance", options.max_distance)] {
        let most = if name == "max_ratio" { 1.0 } else { f64::INFINITY };
        if !(found > 0.0 && found <= most) {
            let expected = if name == "max_ratio" { "a number above 0, at most 1" } else { "a number above 0" };
            return Err(MatchError::Option { name, found, expected });
        }
    }
    Ok(())
}

fn check_guide(index: usize, guide: Option<&Guide>) -> Result<(), MatchError> {
    let Some(guide) = guide else { return Ok(()) };
    for (name, found) in [("radius_rad", guide.radius_rad), ("band_rad", guide.band_rad)] {
        if !(found > 0.0 && found <= PI) {
            return Err(MatchError::Guide { name, index, found, expected: "an angle above 0, at most pi" });
        }
    }
    let length = guide.direction.map_or(1.0, |e| norm(&e));
    if length.is_nan() || (length - 1.0).abs() > 1e-6 {
        return Err(MatchError::Guide { name: "direction", index, found: length, expected: "a unit vector" });
    }
    Ok(())
}

/// Features of one image that take part.
struct Side<'a> {
    descriptors: &'a [[u8; LENGTH]],
    squared: &'a [i32],
    bearings: &'a [Vector<3>],
    /// Longest descriptor.
    scale: f64,
}

impl<'a> Side<'a> {
    fn new(features: &Features<'a>, squared: &'a [i32], image: usize, at_most: usize) -> Self {
        let begin = features.starts[image];
        let range = begin..features.starts[image + 1].min(begin.saturating_add(at_most));
        let squared = &squared[range.clone()];
        let scale = f64::from(squared.iter().copied().max().unwrap_or(0)).sqrt();
        Self { descriptors: &features.descriptors[range.clone()], squared, bearings: &features.bearings[range], scale }
    }

    fn len(&self) -> usize {
        self.squared.len()
    }
}

#[inline(always)]
fn product(a: &[u8; LENGTH], b: &[u8; LENGTH]) -> i32 {
    a.iter().zip(b).map(|(&x, &y)| i32::from(x) * i32::from(y)).sum()
}

const NONE: u32 = u32::MAX;

/// Nearest and second nearest so far.
#[derive(Clone, Copy)]
struct Best {
    squared: i32,
    second: i32,
    index: u32,
}

impl Best {
    const NOTHING: Self = Self { squared: i32::MAX, second: i32::MAX, index: NONE };

    #[inline(always)]
    fn see(&mut self, squared: i32, index: u32) {
        if squared < self.squared {
            *self = Self { squared, second: self.squared, index };
        } else if squared < self.second {
            self.second = squared;
        }
    }

    /// The nearest two of those that two have seen.
    fn nearer(self, other: Self) -> Self {
        let (near, far) = if other.squared < self.squared { (other, self) } else { (self, other) };
        Self { second: near.second.min(far.squared), ..near }
    }
}

/// Nearest of the second image to each feature of the first, and the other way round.
struct Nearest {
    of_first: Vec<Best>,
    of_second: Vec<Best>,
}

impl Nearest {
    fn new(first: &Side, second: &Side) -> Self {
        Self { of_first: vec![Best::NOTHING; first.len()], of_second: vec![Best::NOTHING; second.len()] }
    }

    fn matches(&self, options: &MatchOptions, scale: f64) -> Vec<[u32; 2]> {
        let (ratio, limit) = (options.max_ratio.powi(2), (options.max_distance * scale).powi(2));
        let distinct = |best: &Best| {
            let squared = f64::from(best.squared);
            squared <= limit && (best.second == i32::MAX || squared < ratio * f64::from(best.second))
        };
        let one = |(i, best): (usize, &Best)| {
            let back = self.of_second.get(best.index as usize)?;
            (back.index as usize == i && distinct(best) && distinct(back)).then_some([i as u32, best.index])
        };
        self.of_first.iter().enumerate().filter_map(one).collect()
    }
}

/// Every feature against every other.
struct Exhaustive<'a> {
    first: &'a Side<'a>,
    second: &'a Side<'a>,
}

/// Features of the first image and registers of features of the second whose products are summed at once: as many sums
/// as there are registers for.
const ROWS: usize = 4;
const COLUMNS: usize = 3;

impl pulp::WithSimd for Exhaustive<'_> {
    type Output = Nearest;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, simd: S) -> Nearest {
        let (n_first, n_second) = (self.first.len(), self.second.len());
        let (width, n_rows) = (COLUMNS * S::F32_LANES, n_first.next_multiple_of(ROWS));
        let rows = by_feature(self.first, n_rows);
        let row_squared = lengths(self.first, n_rows);
        let panels = by_number(self.second, width);
        let panel_squared = lengths(self.second, n_second.next_multiple_of(width));
        let lane: Vec<u32> = (0..width as u32).collect();
        let mut of_first = vec![[Lanes::<S>::nothing(simd); COLUMNS]; n_rows];
        let mut nearest = Nearest { of_first: Vec::with_capacity(n_first), of_second: Vec::with_capacity(n_second) };
        let panels = S::as_simd_f32s(&panels).0.as_chunks::<COLUMNS>().0;
        let panel_squared = S::as_simd_f32s(&panel_squared).0.as_chunks::<COLUMNS>().0;
        let lane: [S::u32s; COLUMNS] = std::array::from_fn(|c| simd.partial_load_u32s(&lane[c * S::F32_LANES..]));
        for (p, (panel, squared)) in panels.chunks_exact(LENGTH).zip(panel_squared).enumerate() {
            let mut of_panel = [Lanes::<S>::nothing(simd); COLUMNS];
            let index = lane.map(|lane| simd.add_u32s(lane, simd.splat_u32s((p * width) as u32)));
            for begin in (0..n_rows).step_by(ROWS) {
                let Some(block) = rows[begin..].first_chunk::<ROWS>() else { continue };
                let products = products(simd, block, panel);
                for (i, products) in (begin..).zip(&products) {
                    let (own, own_squared) = (simd.splat_u32s(i as u32), simd.splat_f32s(row_squared[i]));
                    for c in 0..COLUMNS {
                        let total = simd.add_f32s(own_squared, squared[c]);
                        let squared = simd.mul_add_e_f32s(simd.splat_f32s(-2.0), products[c], total);
                        of_first[i][c].see(simd, squared, index[c]);
                        of_panel[c].see(simd, squared, own);
                    }
                }
            }
            nearest.of_second.extend(of_panel.iter().flat_map(Lanes::each));
        }
        nearest.of_second.truncate(n_second);
        let best = |lanes: &[Lanes<S>; COLUMNS]| lanes.iter().flat_map(Lanes::each).fold(Best::NOTHING, Best::nearer);
        nearest.of_first.extend(of_first[..n_first].iter().map(best));
        nearest
    }
}

/// Descriptors one after another; those that fill up are zero.
fn by_feature(side: &Side, n: usize) -> Vec<[f32; LENGTH]> {
    let filling = std::iter::repeat_n([0.0; LENGTH], n - side.len());
    side.descriptors.iter().map(|d| d.map(f32::from)).chain(filling).collect()
}

/// Descriptors in panels of `width`, of each panel the first number of all, then the second of all, and so on.
fn by_number(side: &Side, width: usize) -> Vec<f32> {
    let mut found = vec![0.0; side.len().next_multiple_of(width) * LENGTH];
    for (panel, own) in found.chunks_exact_mut(width * LENGTH).zip(side.descriptors.chunks(width)) {
        for (k, numbers) in panel.chunks_exact_mut(width).enumerate() {
            for (number, descriptor) in numbers.iter_mut().zip(own) {
                *number = f32::from(descriptor[k]);
            }
        }
    }
    found
}

/// Squared lengths; those that fill up are infinitely far from all.
fn lengths(side: &Side, n: usize) -> Vec<f32> {
    let filling = std::iter::repeat_n(f32::INFINITY, n - side.len());
    side.squared.iter().map(|&x| x as f32).chain(filling).collect()
}

/// Scalar products of a few features with a panel.
#[inline(always)]
fn products<S: pulp::Simd>(
    simd: S,
    rows: &[[f32; LENGTH]; ROWS],
    panel: &[[S::f32s; COLUMNS]],
) -> [[S::f32s; COLUMNS]; ROWS] {
    let mut sums = [[simd.splat_f32s(0.0); COLUMNS]; ROWS];
    for (k, numbers) in panel.iter().enumerate() {
        for r in 0..ROWS {
            let own = simd.splat_f32s(rows[r][k]);
            for c in 0..COLUMNS {
                sums[r][c] = simd.mul_add_e_f32s(own, numbers[c], sums[r][c]);
            }
        }
    }
    sums
}

/// [`Best`] of as many features as a register holds.
#[derive(Clone, Copy)]
struct Lanes<S: pulp::Simd> {
    squared: S::f32s,
    second: S::f32s,
    index: S::u32s,
}

impl<S: pulp::Simd> Lanes<S> {
    #[inline(always)]
    fn nothing(simd: S) -> Self {
        let far = simd.splat_f32s(f32::INFINITY);
        Self { squared: far, second: far, index: simd.splat_u32s(NONE) }
    }

    #[inline(always)]
    fn see(&mut self, simd: S, squared: S::f32s, index: S::u32s) {
        let nearer = simd.less_than_f32s(squared, self.squared);
        let farther = simd.select_f32s(nearer, self.squared, squared);
        self.squared = simd.select_f32s(nearer, squared, self.squared);
        self.index = simd.select_u32s(nearer, index, self.index);
        self.second = simd.select_f32s(simd.less_than_f32s(farther, self.second), farther, self.second);
    }

    fn each(&self) -> impl Iterator<Item = Best> {
        let [squared, second] = [&self.squared, &self.second].map(|x| cast_slice::<S::f32s, f32>(from_ref(x)));
        let index = cast_slice::<S::u32s, u32>(from_ref(&self.index));
        // what is infinite becomes the largest number
        (0..S::F32_LANES).map(|l| Best { squared: squared[l] as i32, second: second[l] as i32, index: index[l] })
    }
}

/// Only what the motion allows.
struct Guided<'a> {
    first: &'a Side<'a>,
    second: &'a Side<'a>,
    allowed: &'a Allowed,
}

impl pulp::WithSimd for Guided<'_> {
    type Output = Nearest;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Nearest {
        let (first, second) = (self.first, self.second);
        let mut nearest = Nearest::new(first, second);
        let mut candidates = Vec::new();
        for (i, bearing) in first.bearings.iter().enumerate() {
            self.allowed.list(bearing, &mut candidates);
            for &j in &candidates {
                let at = j as usize;
                let squared =
                    first.squared[i] + second.squared[at] - 2 * product(&first.descriptors[i], &second.descriptors[at]);
                nearest.of_first[i].see(squared, j);
                nearest.of_second[at].see(squared, i as u32);
            }
        }
        nearest
    }
}

/// Features of the second image by where they are, and the test of the motion.
struct Allowed {
    second_from_first: Rotation<3>,
    /// In the frame of the second image.
    direction: Option<Vector<3>>,
    radius: f64,
    cos_radius: f64,
    band: f64,
    sin_band: f64,
    index: Index,
}

impl Allowed {
    fn new(guide: &Guide, second: &Side) -> Self {
        let direction = guide.direction.map(|e| guide.second_from_first.apply(&e));
        let band = guide.band_rad.min(FRAC_PI_2);
        let index = match direction {
            Some(e) => Index::Meridians(Meridians::new(second.bearings, &e, band)),
            None => Index::Grid(Grid::new(second.bearings, 2.0 * (0.5 * guide.radius_rad).sin())),
        };
        Self {
            second_from_first: guide.second_from_first,
            direction,
            radius: guide.radius_rad,
            cos_radius: guide.radius_rad.cos(),
            band,
            sin_band: band.sin(),
            index,
        }
    }

    /// Features of the second image where that along `bearing` may be seen, ascending.
    fn list(&self, bearing: &Vector<3>, found: &mut Vec<u32>) {
        found.clear();
        if !bearing.iter().all(|x| x.is_finite()) {
            return;
        }
        let q = self.second_from_first.apply(bearing);
        let circle = self.direction.and_then(|e| great_circle(&q, &e, self.sin_band));
        let visit = |j: u32, b: &Vector<3>| {
            let on_path = circle.as_ref().is_none_or(|[normal, along, outward]| {
                dot(normal, b).abs() <= self.sin_band
                    && dot(along, b) >= -self.sin_band
                    && dot(outward, b) >= -self.sin_band
            });
            if on_path && dot(&q, b) >= self.cos_radius {
                found.push(j);
            }
        };
        match &self.index {
            Index::Grid(grid) => grid.near(&q, visit),
            Index::Meridians(meridians) => meridians.near(&q, self.radius, self.band, circle.is_none(), visit),
        }
        // ties between descriptors go to the first, however the features are laid out
        found.sort_unstable();
    }
}

/// Where to look for features near a place.
enum Index {
    /// Around it.
    Grid(Grid),
    /// Along its great circle.
    Meridians(Meridians),
}

/// Rings about the direction of motion, from the pole that it points at to the other, and parts of each by azimuth.
const RINGS: usize = 36;
const PARTS: usize = 256;

/// Bearings by the ring that they are in, and within it by their azimuth about the direction of motion: great circles
/// through the direction are meridians, and a band about one is a short range of every ring.
struct Meridians {
    axes: [Vector<3>; 3],
    /// By part of a ring.
    listed: Listed,
    /// Half the range of azimuths in each ring that lies in the band; none where it is about all of them.
    half_widths: Vec<Option<f64>>,
}

impl Meridians {
    fn new(bearings: &[Vector<3>], direction: &Vector<3>, band: f64) -> Self {
        let [x, y] = tangent_basis(direction);
        let half_width = |r: usize| {
            let thinnest = (r as f64 * PI / RINGS as f64).sin().min(((r + 1) as f64 * PI / RINGS as f64).sin());
            // nearer to a pole the band is about all meridians
            (1.5 * band.sin() < thinnest).then(|| (band.sin() / thinnest).asin())
        };
        let mut found = Self {
            axes: [x, y, *direction],
            listed: Listed::default(),
            half_widths: (0..RINGS).map(half_width).collect(),
        };
        let known = (0..bearings.len() as u32).filter(|&j| bearings[j as usize].iter().all(|x| x.is_finite()));
        let place = |j: u32| {
            let (from_pole, azimuth) = found.polar(&bearings[j as usize]);
            (ring(from_pole) * PARTS + part(azimuth), j)
        };
        found.listed = Listed::new(RINGS * PARTS, &known.map(place).collect::<Vec<_>>(), bearings);
        found
    }

    fn polar(&self, b: &Vector<3>) -> (f64, f64) {
        let [x, y, z] = self.axes.map(|axis| dot(&axis, b));
        (x.hypot(y).atan2(z), y.atan2(x))
    }

    /// Calls `visit` with all features that may be in the band about the meridian of `q`, up to `radius` from it; of all
    /// azimuths where `q` is at a pole.
    fn near(&self, q: &Vector<3>, radius: f64, band: f64, at_pole: bool, mut visit: impl FnMut(u32, &Vector<3>)) {
        let (from_pole, azimuth) = self.polar(q);
        // points move away from the pole that the motion points at, but for the band: by its width in the plane, and by
        // at most three times that where it bends round the pole
        let first = from_pole - if at_pole { radius } else { radius.min(4.0 * band) };
        for r in ring(first)..=ring(from_pole + radius) {
            let mut all_of = |parts: RangeInclusive<usize>| {
                self.listed.visit(r * PARTS + parts.start()..r * PARTS + parts.end() + 1, &mut visit);
            };
            let Some(half) = self.half_widths[r].filter(|_| !at_pole) else {
                all_of(0..=PARTS - 1);
                continue;
            };
            let (low, high) = (azimuth - half, azimuth + half);
            all_of(part(low)..=part(high));
            if low < -PI {
                all_of(part(low + 2.0 * PI)..=PARTS - 1);
            } else if high > PI {
                all_of(0..=part(high - 2.0 * PI));
            }
        }
    }
}

/// Part of a ring where an azimuth is; the nearest for those beyond half a turn.
fn part(azimuth: f64) -> usize {
    (((azimuth + PI) / (2.0 * PI) * PARTS as f64).max(0.0) as usize).min(PARTS - 1)
}

/// Features by the place that they are in, with their bearings.
#[derive(Default)]
struct Listed {
    /// Where the features of each place begin.
    starts: Vec<u32>,
    features: Vec<(u32, Vector<3>)>,
}

impl Listed {
    /// Sorts places below `n` and the features in them.
    fn new(n: usize, placed: &[(usize, u32)], bearings: &[Vector<3>]) -> Self {
        let mut starts = vec![0; n + 1];
        for &(place, _) in placed {
            starts[place + 1] += 1;
        }
        for k in 1..starts.len() {
            starts[k] += starts[k - 1];
        }
        let (mut next, mut features) = (starts.clone(), vec![(0, [0.0; 3]); placed.len()]);
        for &(place, j) in placed {
            features[next[place] as usize] = (j, bearings[j as usize]);
            next[place] += 1;
        }
        Self { starts, features }
    }

    /// Calls `visit` with the features of places that follow one another.
    fn visit(&self, places: Range<usize>, visit: &mut impl FnMut(u32, &Vector<3>)) {
        let features = self.starts[places.start] as usize..self.starts[places.end] as usize;
        self.features[features].iter().for_each(|(j, b)| visit(*j, b));
    }
}

fn ring(from_pole: f64) -> usize {
    ((from_pole.max(0.0) / PI * RINGS as f64) as usize).min(RINGS - 1)
}

/// Normal of the great circle through `q` and `e`, its tangent at `q` away from `e`, and the direction in its plane that
/// is square to `e`, on the side of `q`; none where `q` is at a pole of the motion, which all great circles pass.
fn great_circle(q: &Vector<3>, e: &Vector<3>, sin_band: f64) -> Option<[Vector<3>; 3]> {
    let normal = [q[1] * e[2] - q[2] * e[1], q[2] * e[0] - q[0] * e[2], q[0] * e[1] - q[1] * e[0]];
    let along = dot(q, e);
    let vectors = [normal, sub(&scale(along, q), e), sub(q, &scale(along, e))];
    (norm(&normal) > sin_band).then(|| vectors.map(|v| normalized(&v)))
}

/// Bearings sorted by the cube of space that they are in.
struct Grid {
    n: usize,
    /// By cube.
    listed: Listed,
}

impl Grid {
    fn new(bearings: &[Vector<3>], chord: f64) -> Self {
        let n = ((2.0 / chord).floor() as usize).clamp(1, MAX_CELLS);
        let known = (0..bearings.len() as u32).filter(|&j| bearings[j as usize].iter().all(|x| x.is_finite()));
        let place = |j: u32| (index(n, bearings[j as usize].map(|x| cell(x, n))), j);
        Self { n, listed: Listed::new(n * n * n, &known.map(place).collect::<Vec<_>>(), bearings) }
    }

    /// Calls `visit` with the features of the cube of `q` and of those around it.
    fn near(&self, q: &Vector<3>, mut visit: impl FnMut(u32, &Vector<3>)) {
        let middle = q.map(|x| cell(x, self.n));
        let [low, high] = [middle.map(|c| c.saturating_sub(1)), middle.map(|c| (c + 1).min(self.n - 1))];
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                // cubes along z follow one another
                let [begin, end] = [low, high].map(|z| index(self.n, [x, y, z[2]]));
                self.listed.visit(begin..end + 1, &mut visit);
            }
        }
    }
}

fn cell(x: f64, n: usize) -> usize {
    (((x + 1.0) * 0.5 * n as f64).max(0.0) as usize).min(n - 1)
}

fn index(n: usize, at: [usize; 3]) -> usize {
    (at[0] * n + at[1]) * n + at[2]
}
