//! Patterns averaged over the footprint of a pixel, so that nothing finer than a pixel is left to alias.
//!
//! A footprint is a box of widths `(w_u, w_v)` on a surface with coordinates `(u, v)` in metres. The average of a step, a
//! bar or a row of bars over a box is known in closed form; noise loses its octaves as the box outgrows their cells.
//!
//! Colours are worth eight bits, so all of this is in single precision: half a millimetre at the end of the longest walk.

use std::sync::LazyLock;

pub(super) type Colour = [f32; 3];

/// A place on a surface with the widths of the footprint there.
#[derive(Clone, Copy)]
pub(super) struct Spot {
    pub u: f32,
    pub v: f32,
    pub w_u: f32,
    pub w_v: f32,
    /// One over the widths.
    per_u: f32,
    per_v: f32,
}

impl Spot {
    #[inline(always)]
    pub fn new(u: f32, v: f32, w_u: f32, w_v: f32) -> Self {
        Self { u, v, w_u, w_v, per_u: 1.0 / w_u, per_v: 1.0 / w_v }
    }

    #[inline(always)]
    pub fn widest(&self) -> f32 {
        greater(self.w_u, self.w_v)
    }

    /// The same footprint in coordinates about another origin.
    #[inline(always)]
    pub fn about(&self, u: f32, v: f32) -> Self {
        Self { u: self.u - u, v: self.v - v, ..*self }
    }

    /// The same footprint at another place.
    #[inline(always)]
    pub fn at(&self, u: f32, v: f32) -> Self {
        Self { u, v, ..*self }
    }

    /// The two coordinates exchanged.
    #[inline(always)]
    pub fn exchanged(&self) -> Self {
        Self { u: self.v, v: self.u, w_u: self.w_v, w_v: self.w_u, per_u: self.per_v, per_v: self.per_u }
    }

    /// The same footprint, left and right of the origin folded together.
    #[inline(always)]
    pub fn folded(&self) -> Self {
        Self { u: self.u.abs(), ..*self }
    }

    /// Share of the footprint between two values of `u`.
    #[inline(always)]
    pub fn in_u(&self, from: f32, to: f32) -> f32 {
        inside(self.u, self.w_u, self.per_u, from, to)
    }

    /// Share of the footprint between two values of `v`.
    #[inline(always)]
    pub fn in_v(&self, from: f32, to: f32) -> f32 {
        inside(self.v, self.w_v, self.per_v, from, to)
    }

    /// Share of the footprint in bars `[0, bar]` of `u` repeated every `period`.
    #[inline(always)]
    pub fn bars_u(&self, period: f32, bar: f32) -> f32 {
        bars(self.u, self.w_u, self.per_u, period, bar)
    }

    /// Share of the footprint in bars `[0, bar]` of `v` repeated every `period`.
    #[inline(always)]
    pub fn bars_v(&self, period: f32, bar: f32) -> f32 {
        bars(self.v, self.w_v, self.per_v, period, bar)
    }

    /// Share of the footprint inside a rectangle.
    #[inline(always)]
    pub fn in_rectangle(&self, u: (f32, f32), v: (f32, f32)) -> f32 {
        self.in_u(u.0, u.1) * self.in_v(v.0, v.1)
    }

    /// Share of the footprint inside a disc, near enough.
    #[inline(always)]
    pub fn in_disc(&self, u: f32, v: f32, radius: f32) -> f32 {
        let width = self.widest();
        let (u, v) = (self.u - u, self.v - v);
        let reach = radius + 0.5 * width;
        let square = u * u + v * v;
        if square >= reach * reach {
            return 0.0;
        }
        lesser((reach - square.sqrt()) / width, 1.0) * lesser(2.0 * radius / width, 1.0)
    }

    /// Share of the footprint above the line `v = at + slope * u`, near enough.
    #[inline(always)]
    pub fn above(&self, at: f32, slope: f32) -> f32 {
        let width = self.w_v + slope.abs() * self.w_u;
        clamp((self.v - at - slope * self.u) / width + 0.5)
    }
}

// `f32::min` and `f32::max` mind NaN, which takes three more instructions

#[inline(always)]
pub(super) fn lesser(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
pub(super) fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// Nothing below 0 or above 1.
#[inline(always)]
pub(super) fn clamp(x: f32) -> f32 {
    lesser(greater(x, 0.0), 1.0)
}

#[inline(always)]
fn inside(x: f32, w: f32, per_w: f32, from: f32, to: f32) -> f32 {
    greater(lesser(x + 0.5 * w, to) - greater(x - 0.5 * w, from), 0.0) * per_w
}

#[inline(always)]
fn bars(x: f32, w: f32, per_w: f32, period: f32, bar: f32) -> f32 {
    let up_to = |x: f32| {
        let whole = floor(x * (1.0 / period)) as f32;
        whole * bar + lesser(x - whole * period, bar)
    };
    (up_to(x + 0.5 * w) - up_to(x - 0.5 * w)) * per_w
}

/// How much of a pattern survives a footprint of `width`: all up to 0.4 of its period, nothing from 1.1.
#[inline(always)]
pub(super) fn kept(width: f32, period: f32) -> f32 {
    clamp((1.1 - width * (1.0 / period)) * (1.0 / 0.7))
}

/// A random number in -1..1 for the cell of a grid, zero at the borders of the cell so that it needs no more filtering.
#[inline(always)]
pub(super) fn tint(spot: &Spot, cell_u: f32, cell_v: f32, salt: u32) -> f32 {
    let (i, j) = (floor(spot.u * (1.0 / cell_u)), floor(spot.v * (1.0 / cell_v)));
    let (u, v) = (i as f32 * cell_u, j as f32 * cell_v);
    let share = spot.in_rectangle((u, u + cell_u), (v, v + cell_v));
    greater(2.0 * share - 1.0, 0.0) * signed(hash(i, j, salt))
}

/// Octaves of the noise are finer by 0.38 each, and weaker by a quarter. They are taken in fours, since processors do four
/// of the same in the time of one.
const FREQUENCY: [f32; 4] = [1.0, 2.631_579, 6.925_208, 18.224_23];
const WEIGHT: [f32; 4] = [0.6, 0.45, 0.3375, 0.253_125];
/// Of the next four octaves against these.
const FINER: f32 = 47.958_5;
const WEAKER: f32 = 0.316_406;

/// Noise of up to eight scales in about -1..1, as many as the footprint leaves; the coarsest has cells of `coarsest` metres.
#[inline(always)]
pub(super) fn detail(spot: &Spot, coarsest: f32, salt: u32) -> f32 {
    let [coarse, fine] = scales(spot, coarsest, salt);
    coarse + WEAKER * fine
}

/// The four coarser scales of [`detail`], and the four finer ones made as strong.
#[inline(always)]
pub(super) fn scales(spot: &Spot, coarsest: f32, salt: u32) -> [f32; 2] {
    let coarse = mottle(spot, coarsest, salt);
    let finer = coarsest * (1.0 / FINER);
    [coarse, if spot.widest() < 1.1 * finer { mottle(spot, finer, salt.wrapping_add(1)) } else { 0.0 }]
}

/// Noise of four scales in about -1..1, the coarsest of cells of `coarsest` metres.
#[inline(always)]
pub(super) fn mottle(spot: &Spot, coarsest: f32, salt: u32) -> f32 {
    let per = 1.0 / coarsest;
    octaves(spot.u * per, spot.v * per, spot.widest() * per, salt)
}

fn octaves(u: f32, v: f32, width: f32, salt: u32) -> f32 {
    let value = noises(u, v, salt);
    let mut share = [0.0; 4];
    for k in 0..4 {
        share[k] = WEIGHT[k] * kept(width * FREQUENCY[k], 1.0) * value[k];
    }
    (share[0] + share[1]) + (share[2] + share[3])
}

/// Noise at the four frequencies, in -1..1.
#[inline(always)]
fn noises(u: f32, v: f32, salt: u32) -> [f32; 4] {
    let shift = salt.wrapping_mul(0x9e37_79b1) >> 8;
    let (mut a, mut b, mut corners) = ([0.0_f32; 4], [0.0_f32; 4], [0_u32; 4]);
    let (mut i, mut j) = ([0_u32; 4], [0_u32; 4]);
    for k in 0..4 {
        let (x, y) = (u * FREQUENCY[k], v * FREQUENCY[k]);
        let (low_x, low_y) = (x - 0.5 + ROUND, y - 0.5 + ROUND);
        (i[k], j[k]) = (low_x.to_bits(), low_y.to_bits());
        (a[k], b[k]) = (x - (low_x - ROUND), y - (low_y - ROUND));
        a[k] = a[k] * a[k] * (3.0 - 2.0 * a[k]);
        b[k] = b[k] * b[k] * (3.0 - 2.0 * b[k]);
    }
    // each octave has its own part of the lattice, so that octaves never repeat together
    for k in 0..4 {
        i[k] = i[k].wrapping_add(shift).wrapping_add(67 * k as u32) & 0xff;
        j[k] = j[k].wrapping_add(shift >> 8).wrapping_add(91 * k as u32) & 0xff;
        i[k] |= j[k] << 8;
    }
    let lattice = &**LATTICE;
    for k in 0..4 {
        corners[k] = lattice[usize::from(i[k] as u16)];
    }
    let mut value = [0.0; 4];
    for k in 0..4 {
        let corner = |n: u32| ((corners[k] << (24 - 8 * n)) as i32 >> 24) as f32;
        let low = corner(0) + a[k] * (corner(1) - corner(0));
        let high = corner(2) + a[k] * (corner(3) - corner(2));
        value[k] = (low + b[k] * (high - low)) * (1.0 / 128.0);
    }
    value
}

/// Noise of one scale in -1..1: random values on the integer lattice, joined smoothly.
pub(super) fn noise(u: f32, v: f32, salt: u32) -> f32 {
    let shift = salt.wrapping_mul(0x9e37_79b1) >> 8;
    let (i, j) = (floor(u), floor(v));
    let (a, b) = (u - i as f32, v - j as f32);
    let (a, b) = (a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b));
    let (i, j) = ((i as u32).wrapping_add(shift) & 0xff, (j as u32).wrapping_add(shift >> 8) & 0xff);
    let corners = LATTICE[usize::from((j << 8 | i) as u16)];
    let corner = |n: u32| ((corners << (24 - 8 * n)) as i32 >> 24) as f32;
    let low = corner(0) + a * (corner(1) - corner(0));
    let high = corner(2) + a * (corner(3) - corner(2));
    (low + b * (high - low)) * (1.0 / 128.0)
}

/// Random values of the noise at 256 x 256 lattice points, each with those of its neighbours to the right, above and
/// both, as signed bytes: one look-up is all that noise needs.
static LATTICE: LazyLock<Box<[u32; 65536]>> = LazyLock::new(|| {
    let at = |i: u32, j: u32| hash((j % 256 * 256 + i % 256) as i32, 0, 2007) >> 24;
    let corners = |i, j| at(i, j) | at(i + 1, j) << 8 | at(i, j + 1) << 16 | at(i + 1, j + 1) << 24;
    Box::new(std::array::from_fn(|k| corners(k as u32 % 256, k as u32 / 256)))
});

/// Bits that depend on all three arguments.
#[inline(always)]
pub(super) fn hash(i: i32, j: i32, salt: u32) -> u32 {
    let mut h = (i as u32).wrapping_mul(0x9e37_79b1)
        ^ (j as u32).wrapping_mul(0x85eb_ca6b).rotate_left(13)
        ^ salt.wrapping_mul(0xc2b2_ae35).rotate_left(7);
    h ^= h >> 15;
    h = h.wrapping_mul(0x2c1b_3c6d);
    h ^= h >> 12;
    h = h.wrapping_mul(0x297a_2d39);
    h ^ (h >> 15)
}

/// A number in 0..1 from bits.
#[inline(always)]
pub(super) fn unit(bits: u32) -> f32 {
    (bits >> 8) as i32 as f32 * (1.0 / 16_777_216.0)
}

/// A number in 0..1 from one of the four bytes of `bits`: cheaper than bits of its own.
#[inline(always)]
pub(super) fn byte(bits: u32, which: u32) -> f32 {
    (bits >> (8 * which) & 0xff) as i32 as f32 * (1.0 / 256.0)
}

/// A number in -1..1 from bits.
#[inline(always)]
pub(super) fn signed(bits: u32) -> f32 {
    2.0 * unit(bits) - 1.0
}

/// One of the choices.
#[inline(always)]
pub(super) fn pick<T: Copy, const N: usize>(choices: [T; N], bits: u32) -> T {
    choices[(bits >> 5) as usize % N]
}

/// Added to a number, leaves its nearest integer in the lowest bits: 1.5 * 2^23.
const ROUND: f32 = 12_582_912.0;

/// Largest integer not above, for numbers up to four millions; an integer may become the one below, to which it is a
/// border as well. Two additions, where a conversion in Rust minds NaN and overflow.
#[inline(always)]
pub(super) fn floor(x: f32) -> i32 {
    (x - 0.5 + ROUND).to_bits().wrapping_sub(ROUND.to_bits()) as i32
}

/// From `a` to `b` by the share `t`.
#[inline(always)]
pub(super) fn mix(a: Colour, b: Colour, t: f32) -> Colour {
    std::array::from_fn(|c| a[c] + t * (b[c] - a[c]))
}

/// Brighter or darker.
#[inline(always)]
pub(super) fn lit(a: Colour, by: f32) -> Colour {
    a.map(|c| c * by)
}
