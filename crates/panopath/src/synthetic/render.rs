//! A walk through a street, filmed by a panoramic camera: frames with exact truth.
//!
//! The colour of a pixel is that of the first thing along `world_from_cam * bearing(pixel)` from the centre, averaged over
//! the solid angle of a pixel: surfaces average themselves (`filter`, `surfaces`), thin things cover a known share of the
//! pixel, and on edges between solids eight samples say how much of the pixel each of them has. Frames are COLMAP's
//! `EQUIRECTANGULAR`, `width x width / 2` pixels of 8-bit RGB, row by row. World z is up, the ground is `z = 0`, metres and
//! seconds.
//!
//! The city is a grid of streets without end: their middles lie at x = multiples of 75 m and y = multiples of 52 m,
//! kerbs 4 m and houses 8 m from these. Middles are marked by dashes that start at multiples of 6 m and are 3 m long.

use std::str::FromStr;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use super::{WorldError, choose, require};
use crate::geometry::{Rotation, Vector, dot};
use city::{Ball, Block, City, FAR_M, GROUND, Hit, Item, Kind, Post, Ray, SKY, Veil};
use filter::{Colour, Spot, hash, lit, mix};
use tiles::{Frame, Tiles};

mod city;
mod filter;
mod path;
mod surfaces;
mod tiles;

/// Where the walk leads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WalkPath {
    /// Along one street.
    #[default]
    Straight,
    /// Along one street and, half way, to the left into another.
    Corner,
    /// Round a block, once in [`Walk::lap_m`] metres, and on into the next lap.
    Loop,
}

impl FromStr for WalkPath {
    type Err = WorldError;

    fn from_str(text: &str) -> Result<Self, WorldError> {
        choose("path", text, &[("straight", Self::Straight), ("corner", Self::Corner), ("loop", Self::Loop)])
    }
}

/// How the camera turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WalkRotation {
    /// Not at all: upright, forward is the world's x, as of footage with a locked direction.
    None,
    /// It follows the path and sways by a few degrees.
    #[default]
    Sway,
    /// It turns over slowly, about all axes.
    Tumble,
}

impl FromStr for WalkRotation {
    type Err = WorldError;

    fn from_str(text: &str) -> Result<Self, WorldError> {
        choose("rotation", text, &[("none", Self::None), ("sway", Self::Sway), ("tumble", Self::Tumble)])
    }
}

/// What is to be filmed, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct WalkOptions {
    /// Width of a frame, twice its height: 1280.
    pub width_px: usize,
    /// Number of frames: 264, which is 37 m.
    pub n_frames: usize,
    /// Frames in a second: 10.
    pub frame_rate_hz: f64,
    /// Speed of the walk: 1.4.
    pub speed_m_s: f64,
    /// Where it leads: straight on.
    pub path: WalkPath,
    /// How the camera turns: it sways.
    pub rotation: WalkRotation,
    /// Cars that pass by while the camera is there: 0.
    pub n_movers: usize,
    /// Share of the sphere, about the camera's y axis, that the one who carries it covers: 0.
    pub operator_share: f64,
    /// From the darkest frame to the lightest, in factors of two of the light: 0.
    pub exposure_drift_stops: f64,
    /// Standard deviation of the noise, in steps of the 8-bit values: 0.
    pub noise_gray: f64,
    /// Seed of the city, of the wavering of the walk and of the noise: 0.
    pub seed: u64,
}

impl Default for WalkOptions {
    fn default() -> Self {
        Self {
            width_px: 1280,
            n_frames: 264,
            frame_rate_hz: 10.0,
            speed_m_s: 1.4,
            path: WalkPath::default(),
            rotation: WalkRotation::default(),
            n_movers: 0,
            operator_share: 0.0,
            exposure_drift_stops: 0.0,
            noise_gray: 0.0,
            seed: 0,
        }
    }
}

impl WalkOptions {
    fn length_m(&self) -> f64 {
        self.speed_m_s * self.duration_s()
    }

    fn duration_s(&self) -> f64 {
        self.n_frames.saturating_sub(1) as f64 / self.frame_rate_hz
    }

    fn check(&self) -> Result<(), WorldError> {
        let width = self.width_px;
        require(
            "width_px",
            width,
            width.is_multiple_of(2) && (64..=16384).contains(&width),
            "an even number from 64 to 16384",
        )?;
        require("n_frames", self.n_frames, (1..=1_000_000).contains(&self.n_frames), "a number from 1 to 1000000")?;
        require("n_movers", self.n_movers, self.n_movers <= 100, "a number up to 100")?;
        for (option, value, most, expected) in [
            ("operator_share", self.operator_share, 0.5, "a share from 0 to 0.5"),
            ("exposure_drift_stops", self.exposure_drift_stops, 4.0, "a number from 0 to 4"),
            ("noise_gray", self.noise_gray, 64.0, "a number from 0 to 64"),
            ("speed_m_s", self.speed_m_s, 50.0, "a number from 0 to 50"),
        ] {
            require(option, value, (0.0..=most).contains(&value), expected)?;
        }
        let rate = self.frame_rate_hz;
        require("frame_rate_hz", rate, (0.01..=1000.0).contains(&rate), "a number from 0.01 to 1000")?;
        let length = self.length_m();
        require("length of the walk", length, self.path == WalkPath::Loop || length <= 5000.0, "at most 5000 m")
    }
}

/// A walk that can be filmed: the city, and the truth of each frame.
pub struct Walk {
    /// When each frame is taken.
    pub time_s: Vec<f64>,
    /// Where the camera is.
    pub centers: Vec<Vector<3>>,
    /// How it is turned.
    pub cam_from_world: Vec<Rotation<3>>,
    options: WalkOptions,
    city: City,
    cars: Vec<Car>,
    phase: [f64; 8],
}

/// A car on its way: where it is at time zero, and how fast.
struct Car {
    at: [f64; 2],
    axis: usize,
    speed_m_s: f64,
    paint: Colour,
    seed: u32,
}

/// Samples of a pixel that lies on an edge: one in each row and column of an 8 x 8 grid.
const SAMPLES: [[f64; 2]; 8] = [
    [0.0625, 0.4375],
    [0.1875, 0.8125],
    [0.3125, 0.1875],
    [0.4375, 0.6875],
    [0.5625, 0.3125],
    [0.6875, 0.9375],
    [0.8125, 0.5625],
    [0.9375, 0.0625],
];
/// Of what a pixel is said to show: that something in front covers all of it.
const OPAQUE: u32 = 1;
/// Towards the sun.
const SUN: Vector<3> = [-0.42, -0.55, 0.72];

/// Builds the city about a walk; the same options give the same frames.
///
/// # Errors
/// [`WorldError::Range`] naming the option that is out of range.
///
/// # Examples
/// ```
/// use panopath::synthetic::render::{WalkOptions, render_frame, walk};
/// # fn main() -> Result<(), panopath::synthetic::WorldError> {
/// let street = walk(&WalkOptions { width_px: 64, n_frames: 2, ..Default::default() })?;
/// assert_eq!(render_frame(&street, 1)?.len(), 64 * 32 * 3);
/// # Ok(())
/// # }
/// ```
pub fn walk(options: &WalkOptions) -> Result<Walk, WorldError> {
    options.check()?;
    // a stream for each, so that the same seed with more cars is the same street
    let stream = |which: u64| {
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        rng.set_stream(which);
        rng
    };
    let mut wavering = stream(0);
    let phase = std::array::from_fn(|_| wavering.random());
    let time_s: Vec<f64> = (0..options.n_frames).map(|k| k as f64 / options.frame_rate_hz).collect();
    let (centers, cam_from_world): (Vec<_>, Vec<_>) = time_s.iter().map(|&t| path::pose(options, t, &phase)).unzip();
    let mut traffic = stream(1);
    let cars = (0..options.n_movers).map(|k| Car::passing(options, k, &mut traffic)).collect();
    let city = City::about(&centers, &mut stream(2));
    Ok(Walk { time_s, centers, cam_from_world, options: options.clone(), city, cars, phase })
}

/// Renders frame `k`: `height * width * 3` bytes, row by row, RGB.
///
/// # Errors
/// [`WorldError::Range`] where there is no such frame.
pub fn render_frame(walk: &Walk, k: usize) -> Result<Vec<u8>, WorldError> {
    let shot = Shot::of(walk, k)?;
    let (width, height) = (walk.width_px(), walk.height_px());
    let mut frame = vec![0; 3 * width * height];
    let mut shown = vec![0_u32; width * height];
    let rows = frame.par_chunks_mut(3 * width).zip(shown.par_chunks_mut(width));
    rows.enumerate().for_each(|(y, (row, shown))| shot.see_row(y, row.as_chunks_mut().0, shown));
    frame.par_chunks_mut(3 * width).enumerate().for_each(|(y, row)| {
        let mut veils = Vec::new();
        let [above, below] = [y.saturating_sub(1), (y + 1).min(height - 1)];
        let [above, here, below] = [above, y, below].map(|y| &shown[y * width..(y + 1) * width]);
        for (x, bytes) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let (left, right) = (if x == 0 { width - 1 } else { x - 1 }, if x + 1 == width { 0 } else { x + 1 });
            let other = [here[left], here[right], above[x], below[x]].map(|id| (id ^ here[x]) & !OPAQUE);
            if here[x] & OPAQUE == 0
                && other != [0; 4]
                && let Some(colour) = shot.see_again(x, y, here[x], &mut veils)
            {
                *bytes = shot.develop(colour, y * width + x);
            }
        }
    });
    Ok(frame)
}

/// Distance from the centre to what the middle of each pixel of frame `k` shows, row by row; infinite for the sky, NaN for
/// the operator.
///
/// # Errors
/// [`WorldError::Range`] where there is no such frame.
pub fn render_ranges(walk: &Walk, k: usize) -> Result<Vec<f32>, WorldError> {
    let shot = Shot::of(walk, k)?;
    let mut ranges = vec![0.0; walk.width_px() * walk.height_px()];
    ranges.par_chunks_mut(walk.width_px()).enumerate().for_each(|(y, row)| {
        let mut veils = Vec::new();
        for (x, range) in row.iter_mut().enumerate() {
            *range = shot.range(x, y, &mut veils);
        }
    });
    Ok(ranges)
}

impl Walk {
    /// Width of a frame.
    pub fn width_px(&self) -> usize {
        self.options.width_px
    }

    /// Height of a frame.
    pub fn height_px(&self) -> usize {
        self.options.width_px / 2
    }

    /// Length of a lap of [`WalkPath::Loop`], along the line about which the walk wavers.
    pub fn lap_m() -> f64 {
        path::lap_m()
    }
}

impl Car {
    /// The `k`-th car: beside the camera at its share of the time, on the street that the camera then is in.
    fn passing(o: &WalkOptions, k: usize, rng: &mut ChaCha8Rng) -> Self {
        let apart_s = (o.duration_s() / o.n_movers as f64).max(1.2);
        let time_s = 0.5 * o.duration_s() + (k as f64 - 0.5 * (o.n_movers as f64 - 1.0)) * apart_s;
        let place = path::place(o, o.speed_m_s * time_s);
        let axis = place.side % 2;
        let middle = [0.0, path::BLOCK_M[0], path::BLOCK_M[1], 0.0][place.side];
        // one speed for each lane, so that none runs into another; traffic keeps to the right
        let forward = k.is_multiple_of(2);
        let speed_m_s = if forward { 7.0 } else { -8.5 };
        let mut at = place.at;
        at[axis] -= speed_m_s * time_s;
        let right = if axis == 0 { -1.0 } else { 1.0 };
        at[1 - axis] = middle + if forward { 1.15 * right } else { -1.15 * right };
        Self { at, axis, speed_m_s, paint: city::paint(rng), seed: hash(k as i32, 0, 18) }
    }

    fn blocks(&self, time_s: f64) -> [Block; 2] {
        let mut at = self.at;
        at[self.axis] += self.speed_m_s * time_s;
        city::car(at, self.axis, self.speed_m_s > 0.0, self.paint, self.seed)
    }
}

/// One frame in the making.
struct Shot<'a> {
    walk: &'a Walk,
    frame: Frame,
    movers: Vec<Block>,
    tiles: Tiles,
    /// Sine and cosine of the azimuth of each column, and of the angle below the horizon of each row.
    columns: Vec<[f64; 2]>,
    rows: Vec<[f64; 2]>,
    gain: f32,
    salt: u32,
}

impl<'a> Shot<'a> {
    fn of(walk: &'a Walk, k: usize) -> Result<Self, WorldError> {
        require("frame", k, k < walk.time_s.len(), "a number below the number of frames")?;
        let (o, time_s) = (&walk.options, walk.time_s[k]);
        let drift = (std::f64::consts::TAU * (1.3 * time_s / o.duration_s().max(1.0) + walk.phase[7])).sin();
        let frame = Frame::of(walk.centers[k], &walk.cam_from_world[k], o.width_px);
        let movers: Vec<Block> = walk.cars.iter().flat_map(|car| car.blocks(time_s)).collect();
        let angles = |n: usize| {
            let angle = |i: usize| (i as f64 + 0.5 - 0.5 * n as f64) * frame.delta;
            (0..n).map(|i| angle(i).sin_cos().into()).collect()
        };
        Ok(Self {
            walk,
            tiles: Tiles::of(&frame, &walk.city, &movers),
            movers,
            columns: angles(frame.width_px),
            rows: angles(frame.height_px),
            frame,
            // displays raise to the power of 2.2, so light of 2^s is a value of 2^(s / 2.2)
            gain: (0.5 * o.exposure_drift_stops * drift / 2.2).exp2() as f32,
            salt: hash(k as i32, o.seed as i32, (o.seed >> 32) as u32),
        })
    }

    /// Bearing of the middle of a pixel.
    #[inline(always)]
    fn middle(&self, x: usize, y: usize) -> Vector<3> {
        let ([aside, ahead], [down, level]) = (self.columns[x], self.rows[y]);
        [level * aside, down, level * ahead]
    }

    /// Bearing of a place in a pixel, given from its middle.
    #[inline(always)]
    fn bearing(&self, x: usize, y: usize, [right, down]: [f64; 2]) -> Vector<3> {
        let turned = |[sin, cos]: [f64; 2], px: f64| {
            let by = px * self.frame.delta;
            let (c, s) = (1.0 - 0.5 * by * by, by * (1.0 - by * by / 6.0));
            [sin * c + cos * s, cos * c - sin * s]
        };
        let ([aside, ahead], [down, level]) = (turned(self.columns[x], right), turned(self.rows[y], down));
        [level * aside, down, level * ahead]
    }

    #[inline(always)]
    fn ray(&self, bearing: &Vector<3>) -> Ray {
        let [right, down, forward] = &self.frame.axes;
        let along = std::array::from_fn(|c| bearing[0] * right[c] + bearing[1] * down[c] + bearing[2] * forward[c]);
        Ray::new(self.frame.center, along, self.frame.delta)
    }

    /// Colour about a bearing in a pixel, and a number that differs between the solids of two neighbouring pixels.
    #[inline(always)]
    fn see(&self, x: usize, y: usize, bearing: &Vector<3>, veils: &mut Vec<Veil>) -> (Colour, u32) {
        let operator = self.operator(bearing);
        if operator >= 1.0 {
            return (surfaces::operator(bearing, self.frame.delta), number(SKY - 1, 0));
        }
        let ray = self.ray(bearing);
        let hit = self.tiles.at(x, y).trace(&ray, &self.walk.city, veils);
        let id = number(hit.block, hit.axis);
        let opaque = veils.iter().position(|veil| veil.share >= 1.0);
        let mut colour = match opaque {
            Some(k) => self.veil(&veils[k], &ray.along),
            None => self.solid(&hit, &ray.along),
        };
        for veil in veils[..opaque.unwrap_or(veils.len())].iter().rev() {
            colour = mix(colour, self.veil(veil, &ray.along), veil.share);
        }
        if operator > 0.0 {
            colour = mix(colour, surfaces::operator(bearing, self.frame.delta), operator);
        }
        (colour, if opaque.is_some() { id | OPAQUE } else { id })
    }

    /// One row: its bytes, and what it shows. Towards the poles columns are closer than a footprint is wide, and only every
    /// second, fourth or eighth pixel is looked at, less than 0.7 footprints apart; those between two that show the same solid are interpolated.
    fn see_row(&self, y: usize, row: &mut [[u8; 3]], shown: &mut [u32]) {
        let mut veils = Vec::new();
        let (width, level) = (row.len(), self.rows[y][1]);
        let stride = [8, 4, 2].into_iter().find(|&n| level * n as f64 <= 0.7 && width.is_multiple_of(n)).unwrap_or(1);
        let mut see = |x: usize| self.see(x, y, &self.middle(x, y), &mut veils);
        let first = see(0);
        let mut before = first;
        for x in (0..width).step_by(stride) {
            let after = if x + stride < width { see(x + stride) } else { first };
            for k in 0..stride {
                let (colour, id) = if k == 0 {
                    before
                } else if before.1 == after.1 {
                    (mix(before.0, after.0, k as f32 / stride as f32), before.1)
                } else {
                    see(x + k)
                };
                (row[x + k], shown[x + k]) = (self.develop(colour, y * width + x + k), id);
            }
            before = after;
        }
    }

    /// Mean of a pixel with an edge in it: each solid is seen once, in the middle of the samples that meet it. None where
    /// the edge lies in the neighbour.
    fn see_again(&self, x: usize, y: usize, shown: u32, veils: &mut Vec<Veil>) -> Option<Colour> {
        let tile = self.tiles.at(x, y);
        let mut solids = [(0, [0.0; 2], 0.0); SAMPLES.len()];
        let mut n = 0;
        for place in SAMPLES.map(|place| place.map(|px| px - 0.5)) {
            let hit = tile.solid(&self.ray(&self.bearing(x, y, place)));
            let id = number(hit.block, hit.axis);
            let k = solids[..n].iter().position(|solid| solid.0 == id).unwrap_or(n);
            n = n.max(k + 1);
            let (_, sum, count) = solids[k];
            solids[k] = (id, std::array::from_fn(|c| sum[c] + place[c]), count + 1.0);
        }
        if n == 1 && solids[0].0 == shown {
            return None;
        }
        let mut mean = [0.0; 3];
        for (_, sum, count) in &solids[..n] {
            let (colour, _) = self.see(x, y, &self.bearing(x, y, sum.map(|px| px / count)), veils);
            let share = (count / SAMPLES.len() as f64) as f32;
            mean = std::array::from_fn(|c| mean[c] + share * colour[c]);
        }
        Some(mean)
    }

    fn range(&self, x: usize, y: usize, veils: &mut Vec<Veil>) -> f32 {
        let bearing = self.middle(x, y);
        if self.operator(&bearing) >= 0.5 {
            return f32::NAN;
        }
        let hit = self.tiles.at(x, y).trace(&self.ray(&bearing), &self.walk.city, veils);
        let mut seen = 1.0;
        for veil in veils.iter() {
            seen *= 1.0 - veil.share;
            if seen < 0.5 {
                return veil.distance as f32;
            }
        }
        if hit.block == SKY { f32::INFINITY } else { hit.distance as f32 }
    }

    /// Share of the pixel that the operator covers: a cap about the camera's y axis whose rim wavers in height but not on
    /// average, so that it covers just the share that was asked for (a zone's area goes with its height).
    fn operator(&self, bearing: &Vector<3>) -> f32 {
        let share = self.walk.options.operator_share;
        if share <= 0.0 || bearing[1] < 0.6 - 2.0 * share {
            return 0.0;
        }
        let azimuth = bearing[0].atan2(bearing[2]);
        let waver = 0.5 * (2.0 * azimuth).cos() + 0.3 * (3.0 * azimuth + 1.0).sin() + 0.2 * (7.0 * azimuth).sin();
        let rim = 1.0 - 2.0 * share + share.min(0.2) * waver;
        let slope = (1.0 - rim * rim).max(0.01).sqrt();
        ((bearing[1] - rim) / (slope * self.frame.delta) + 0.5).clamp(0.0, 1.0) as f32
    }

    #[inline(always)]
    fn solid(&self, hit: &Hit, along: &Vector<3>) -> Colour {
        if hit.block == SKY {
            return surfaces::sky(along, self.frame.delta);
        }
        let at: Vector<3> = std::array::from_fn(|c| self.frame.center[c] + hit.distance * along[c]);
        let (u, v) = [(1, 2), (0, 2), (0, 1)][hit.axis];
        // tangent offset e of the ray moves the spot by distance * (e - along (n e) / (n along))
        let (facing, width) = (1.0 / along[hit.axis] as f32, (hit.distance * self.frame.delta) as f32);
        let widen = |c: usize| {
            let slope = along[c] as f32 * facing;
            width * (1.0 + slope * slope).sqrt()
        };
        let spot = |u_from: f64| Spot::new((at[u] - u_from) as f32, at[v] as f32, widen(u), widen(v));
        let colour = if hit.block == GROUND {
            lit(surfaces::ground(&spot(0.0)), 0.72 + 0.36 * SUN[2] as f32)
        } else {
            let block = tiles::block_of(&self.walk.city, &self.movers, hit.block);
            self.face(block, hit.axis, along, u, &spot(block.low[u]))
        };
        self.haze(colour, hit.distance)
    }

    /// Face of a block; `u` is its horizontal axis, on which the spot is given from the block's lower end.
    fn face(&self, block: &Block, axis: usize, along: &Vector<3>, u: usize, spot: &Spot) -> Colour {
        let outwards = -along[axis].signum();
        let light = 0.72 + 0.36 * (outwards * SUN[axis]).max(-0.4) as f32;
        let width = (block.high[u] - block.low[u]) as f32;
        let colour = match &block.kind {
            Kind::House(house) => {
                let face = 2 * axis as u32 + u32::from(outwards > 0.0);
                surfaces::facade(house, face, width, block.high[2] as f32, spot)
            }
            Kind::Car { paint, axis: ahead, forward, cabin, seed } if axis != 2 => {
                let middle = spot.about(0.5 * width, 0.0);
                let local = if *forward { middle } else { middle.at(-middle.u, middle.v) };
                surfaces::car(*paint, axis == *ahead, *cabin, *seed, &local)
            }
            Kind::Car { paint, seed, .. } => surfaces::car_top(*paint, *seed, spot),
            Kind::Awning(paint, seed) => surfaces::awning(*paint, *seed, spot),
        };
        lit(colour, light)
    }

    fn veil(&self, veil: &Veil, along: &Vector<3>) -> Colour {
        let at: Vector<3> = std::array::from_fn(|c| self.frame.center[c] + veil.distance * along[c]);
        let width = (veil.distance * self.frame.delta) as f32;
        let colour = match veil.item {
            Item::Post(k) => {
                let Post { at: axis, radius, colour, seed, .. } = self.walk.city.posts[k as usize];
                let normal = [(at[0] - axis[0]) / radius, (at[1] - axis[1]) / radius];
                let facing = (normal[0] * along[0] + normal[1] * along[1]).abs().max(0.2) as f32;
                let round = radius * normal[1].atan2(normal[0]);
                let light = 0.78 + 0.3 * (normal[0] * SUN[0] + normal[1] * SUN[1]) as f32;
                let spot = Spot::new(round as f32, at[2] as f32, width / facing, width);
                lit(surfaces::post(colour, seed, &spot), light)
            }
            Item::Ball(k) => {
                let Ball { center, radius, colour, seed } = self.walk.city.balls[k as usize];
                let normal: Vector<3> = std::array::from_fn(|c| (at[c] - center[c]) / radius);
                let facing = dot(&normal, along).abs().max(0.25) as f32;
                let light = 0.8 + 0.35 * dot(&normal, &SUN) as f32;
                lit(surfaces::ball(colour, seed, &at, width / facing), light)
            }
            Item::Block(_) => surfaces::HAZE,
        };
        self.haze(colour, veil.distance)
    }

    fn haze(&self, colour: Colour, distance: f64) -> Colour {
        let share = (distance / FAR_M) as f32;
        mix(colour, surfaces::HAZE, share * share * (3.0 - 2.0 * share))
    }

    /// Values of 8 bits: exposure, then noise.
    #[inline(always)]
    fn develop(&self, colour: Colour, pixel: usize) -> [u8; 3] {
        let noise = self.walk.options.noise_gray as f32;
        std::array::from_fn(|c| {
            let mut value = 255.0 * self.gain * colour[c];
            if noise > 0.0 {
                // four bytes add up to nearly a Gaussian of standard deviation sqrt(4 / 12) of a byte
                let bits = hash(pixel as i32, c as i32, self.salt);
                let sum: u32 = bits.to_le_bytes().iter().map(|&byte| u32::from(byte)).sum();
                value += noise * (sum as f32 - 510.0) * (1.0 / 147.8);
            }
            (value + 0.5) as u8
        })
    }
}

/// A number for what is seen, with a bit left for [`OPAQUE`].
fn number(block: u32, axis: usize) -> u32 {
    block << 3 | (axis as u32) << 1
}
