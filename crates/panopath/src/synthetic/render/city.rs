//! The city as boxes, posts and balls on a plane, and the ray that meets them.
//!
//! Boxes are solid. Posts (upright cylinders) and balls may be thinner than a pixel, so they cover a share of it that is
//! known in closed form: the nearest distance of the ray from the axis or the centre, against the footprint.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::filter::{Colour, hash, pick};
use super::path::{BLOCK_M, HOUSES_M, KERB_M};
use crate::geometry::{Vector, dot, sub};

/// How far beyond the path there are houses, and from where there is haze only.
const SURROUND_M: f64 = 130.0;
pub(super) const FAR_M: f64 = 220.0;

/// What a box is, which says how its faces look.
#[derive(Clone, Copy)]
pub(super) enum Kind {
    House(House),
    /// A car that heads along the axis, forwards or backwards; `true` for its cabin.
    Car {
        paint: Colour,
        axis: usize,
        forward: bool,
        cabin: bool,
        seed: u32,
    },
    /// An awning of one colour with stripes, and its seed.
    Awning(Colour, u32),
}

/// How a house looks.
#[derive(Clone, Copy)]
pub(super) struct House {
    pub seed: u32,
    pub wall: Colour,
    pub trim: Colour,
    pub bricks: bool,
    pub shutters: bool,
    pub storey_m: f32,
    pub column_m: f32,
    pub window_m: [f32; 2],
}

#[derive(Clone, Copy)]
pub(super) struct Block {
    pub low: Vector<3>,
    pub high: Vector<3>,
    pub kind: Kind,
}

/// An upright cylinder.
#[derive(Clone, Copy)]
pub(super) struct Post {
    pub at: [f64; 2],
    pub radius: f64,
    pub low: f64,
    pub high: f64,
    pub colour: Colour,
    pub seed: u32,
}

#[derive(Clone, Copy)]
pub(super) struct Ball {
    pub center: Vector<3>,
    pub radius: f64,
    pub colour: Colour,
    pub seed: u32,
}

/// Where a ray meets a solid face.
#[derive(Clone, Copy)]
pub(super) struct Hit {
    pub distance: f64,
    /// Its number; [`GROUND`] and [`SKY`] have numbers too.
    pub block: u32,
    /// Axis of the face's normal.
    pub axis: usize,
}

/// A ray through the middle of a pixel, with what all that it may meet needs of it.
pub(super) struct Ray {
    pub from: Vector<3>,
    pub along: Vector<3>,
    /// Angle of the pixel.
    delta: f64,
    pub inverse: Vector<3>,
}

impl Ray {
    #[inline(always)]
    pub fn new(from: Vector<3>, along: Vector<3>, delta: f64) -> Self {
        Self { from, along, delta, inverse: along.map(|x| 1.0 / x) }
    }
}

/// Something that covers a share of the pixel, in front of the solid.
#[derive(Clone, Copy)]
pub(super) struct Veil {
    pub distance: f64,
    pub share: f32,
    pub item: Item,
}

#[derive(Clone, Copy)]
pub(super) enum Item {
    Block(u32),
    Post(u32),
    Ball(u32),
}

/// Numbers of the ground and the sky as blocks.
pub(super) const GROUND: u32 = u32::MAX;
pub(super) const SKY: u32 = u32::MAX - 1;

pub(super) struct City {
    pub blocks: Vec<Block>,
    pub posts: Vec<Post>,
    pub balls: Vec<Ball>,
}

impl City {
    /// The city about places of a walk.
    pub fn about(places: &[Vector<3>], rng: &mut ChaCha8Rng) -> Self {
        let reach = |c: usize, sign: f64| places.iter().map(|p| sign * p[c]).fold(f64::MIN, f64::max) + SURROUND_M;
        let mut city = Self { blocks: vec![], posts: vec![], balls: vec![] };
        let quarter = |c: usize, at: f64| (at / BLOCK_M[c]).floor() as i32;
        let span = |c: usize| {
            quarter(c, -reach(c, -1.0))
                ..=quarter(c, -reach(c, -1.0) + ((reach(c, 1.0) + reach(c, -1.0)) / 5.0).ceil() * 5.0)
        };
        for i in span(0) {
            for j in span(1) {
                city.add_quarter([f64::from(i) * BLOCK_M[0], f64::from(j) * BLOCK_M[1]], rng);
            }
        }
        city
    }

    /// Houses between four streets, and what stands along these.
    fn add_quarter(&mut self, corner: [f64; 2], rng: &mut ChaCha8Rng) {
        let [west, south] = corner.map(|c| c + HOUSES_M);
        let (east, north) = (corner[0] + BLOCK_M[0] - HOUSES_M, corner[1] + BLOCK_M[1] - HOUSES_M);
        let middle = 0.5 * (south + north);
        for (from, to) in [(south, middle), (middle, north)] {
            let mut x = west;
            while x < east {
                let width = if east - x < 17.0 { east - x } else { rng.random_range(8.0..14.0) };
                let house = house(rng);
                let height = 3.8 + f64::from(house.storey_m) * f64::from(rng.random_range(2..6_u32)) + 0.7;
                self.blocks.push(Block {
                    low: [x, from, 0.0],
                    high: [x + width, to, height],
                    kind: Kind::House(house),
                });
                let (out_low, out_high) = if from == south { (from - 1.1, from) } else { (to, to + 1.1) };
                if rng.random_bool(0.5) {
                    let colour =
                        pick([[0.72, 0.2, 0.16], [0.18, 0.42, 0.3], [0.2, 0.3, 0.6], [0.85, 0.7, 0.3]], rng.random());
                    let (low, high) = ([x + 1.0, out_low, 2.75], [x + 0.6 * width, out_high, 2.95]);
                    self.blocks.push(Block { low, high, kind: Kind::Awning(colour, seed_at([x, out_low])) });
                }
                x += width;
            }
        }
        self.add_furniture(corner, rng);
    }

    /// Trees, lamps and parked cars along the four kerbs of a quarter.
    fn add_furniture(&mut self, corner: [f64; 2], rng: &mut ChaCha8Rng) {
        for side in 0..4 {
            let axis = side % 2;
            let far = side >= 2;
            let length = BLOCK_M[axis];
            let across = |from_middle: f64| if far { BLOCK_M[1 - axis] - from_middle } else { from_middle };
            let at = |along: f64, from_middle: f64| {
                let mut at = corner;
                at[axis] += along;
                at[1 - axis] += across(from_middle);
                at
            };
            let mut along = 11.0 + rng.random_range(0.0..2.0);
            while along < length - 13.0 {
                match rng.random_range(0..5) {
                    0 | 1 => self.add_tree(at(along, KERB_M + 0.55), rng),
                    2 => self.add_lamp(at(along, KERB_M + 0.45), rng),
                    _ => {}
                }
                if rng.random_bool(0.5) {
                    let paint = paint(rng);
                    let place = at(along + 2.5, KERB_M - 1.0);
                    let [body, cabin] = car(place, axis, far, paint, seed_at(place));
                    self.blocks.extend([body, cabin]);
                }
                along += 5.5 + rng.random_range(0.0..1.5);
            }
        }
    }

    fn add_tree(&mut self, at: [f64; 2], rng: &mut ChaCha8Rng) {
        let high = rng.random_range(2.6..3.8);
        let bark = [0.3, 0.24, 0.18];
        self.posts.push(Post { at, radius: 0.14, low: 0.0, high: high + 0.5, colour: bark, seed: rng.random() });
        let green = [rng.random_range(0.2..0.34_f32), rng.random_range(0.36..0.46_f32), 0.14];
        for _ in 0..7 {
            let offset: [f64; 3] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let center = [at[0] + offset[0], at[1] + offset[1], high + 1.0 + 0.9 * offset[2]];
            let radius = rng.random_range(0.6..1.05);
            self.balls.push(Ball { center, radius, colour: green, seed: rng.random() });
        }
    }

    fn add_lamp(&mut self, at: [f64; 2], rng: &mut ChaCha8Rng) {
        let colour = [0.2, 0.23, 0.22];
        self.posts.push(Post { at, radius: 0.1, low: 0.0, high: 0.9, colour, seed: rng.random() });
        self.posts.push(Post { at, radius: 0.05, low: 0.9, high: 4.6, colour, seed: rng.random() });
        let globe = [0.95, 0.93, 0.85];
        self.balls.push(Ball { center: [at[0], at[1], 4.8], radius: 0.22, colour: globe, seed: 0 });
    }
}

impl Post {
    /// Distance and covered share of the pixel, where there is any.
    #[inline(always)]
    pub fn cover(&self, ray: &Ray) -> Option<(f64, f32)> {
        let to = [self.at[0] - ray.from[0], self.at[1] - ray.from[1]];
        let flat = 1.0 / (ray.along[0] * ray.along[0] + ray.along[1] * ray.along[1]).sqrt().max(1e-9);
        let distance = (to[0] * ray.along[0] + to[1] * ray.along[1]) * flat * flat;
        let off = (to[0] * ray.along[1] - to[1] * ray.along[0]) * flat;
        let width = distance * ray.delta;
        if distance <= 0.0 || off.abs() > self.radius + width {
            return None;
        }
        let share = inside(off, width, -self.radius, self.radius)
            * inside(ray.from[2] + distance * ray.along[2], width * flat, self.low, self.high);
        let depth = (self.radius * self.radius - off * off).max(0.0).sqrt() * flat;
        (share > 0.0).then_some((distance - depth, share))
    }
}

impl Ball {
    #[inline(always)]
    pub fn cover(&self, ray: &Ray) -> Option<(f64, f32)> {
        let to = sub(&self.center, &ray.from);
        let distance = dot(&to, &ray.along);
        let off2 = dot(&to, &to) - distance * distance;
        let width = distance * ray.delta;
        if distance <= 0.0 || off2 > (self.radius + width) * (self.radius + width) {
            return None;
        }
        let share = inside(off2.max(0.0).sqrt(), width, -self.radius, self.radius);
        let depth = (self.radius * self.radius - off2).max(0.0).sqrt();
        (share > 0.0).then_some((distance - depth, share))
    }
}

/// Share of `[x - w/2, x + w/2]` inside `[from, to]`.
#[inline(always)]
fn inside(x: f64, w: f64, from: f64, to: f64) -> f32 {
    (((x + 0.5 * w).min(to) - (x - 0.5 * w).max(from)).max(0.0) / w) as f32
}

/// Body and cabin of a car about a place.
pub(super) fn car(at: [f64; 2], axis: usize, forward: bool, paint: Colour, seed: u32) -> [Block; 2] {
    let block = |from: f64, to: f64, half: f64, low: f64, high: f64, cabin: bool| {
        let (from, to) = if forward { (from, to) } else { (-to, -from) };
        let (mut a, mut b) = ([at[0], at[1], low], [at[0], at[1], high]);
        a[axis] += from;
        b[axis] += to;
        a[1 - axis] -= half;
        b[1 - axis] += half;
        Block { low: a, high: b, kind: Kind::Car { paint, axis, forward, cabin, seed } }
    };
    [block(-2.1, 2.1, 0.86, 0.0, 0.88, false), block(-1.6, 0.9, 0.74, 0.88, 1.45, true)]
}

/// A seed for what stands at a place.
fn seed_at(at: [f64; 2]) -> u32 {
    let [x, y] = at.map(|x| (64.0 * x).round() as i32);
    hash(x, y, 17)
}

/// A colour that cars have.
pub(super) fn paint(rng: &mut ChaCha8Rng) -> Colour {
    let paints = [
        [0.75, 0.75, 0.77],
        [0.16, 0.17, 0.2],
        [0.55, 0.1, 0.1],
        [0.14, 0.24, 0.45],
        [0.85, 0.84, 0.8],
        [0.35, 0.4, 0.36],
        [0.8, 0.65, 0.2],
    ];
    pick(paints, rng.random())
}

fn house(rng: &mut ChaCha8Rng) -> House {
    let walls = [
        [0.62, 0.36, 0.28],
        [0.78, 0.7, 0.56],
        [0.7, 0.56, 0.46],
        [0.56, 0.6, 0.62],
        [0.82, 0.78, 0.72],
        [0.68, 0.6, 0.42],
        [0.5, 0.3, 0.26],
        [0.6, 0.66, 0.58],
    ];
    let trims = [[0.9, 0.88, 0.84], [0.86, 0.8, 0.68], [0.3, 0.24, 0.2], [0.55, 0.52, 0.48]];
    let (seed, wall, trim) = (rng.random(), pick(walls, rng.random()), pick(trims, rng.random()));
    let (bricks, shutters) = (rng.random_bool(0.5), rng.random_bool(0.35));
    let mut metres = |from: f64, to: f64| rng.random_range(from..to) as f32;
    House {
        seed,
        wall,
        trim,
        bricks,
        shutters,
        storey_m: metres(2.9, 3.4),
        column_m: metres(2.1, 3.0),
        window_m: [metres(0.42, 0.65), metres(1.3, 1.8)],
    }
}
