//! Patterns averaged over the footprint of a pixel, so that nothing finer than a pixel is left to alias.
//!
//! A footprint is a box of widths `(w_u, w_v)` on a surface with coordinates `(u, v)` in metres. The average of a step, a
//! bar or a row of bars over a box is known in closed form; noise loses its octaves as the box outgrows their cells.

use std::sync::LazyLock;

pub(super) type Colour = [f32; 3];

/// A place on a surface with the widths of the footprint there.
#[derive(Clone, Copy)]
pub(super) struct Spot {
    pub u: f64,
    pub v: f64,
    pub w_u: f64,
    pub w_v: f64,
}

impl Spot {
    pub fn widest(&self) -> f64 {
        self.w_u.max(self.w_v)
    }

    /// The same footprint in coordinates about another origin.
    pub fn about(&self, u: f64, v: f64) -> Self {
        Self { u: self.u - u, v: self.v - v, ..*self }
    }

    /// Share of the footprint inside a rectangle.
    pub fn in_rectangle(&self, u: (f64, f64), v: (f64, f64)) -> f32 {
        let across = inside(self.u, self.w_u, u.0, u.1);
        if across > 0.0 { across * inside(self.v, self.w_v, v.0, v.1) } else { 0.0 }
    }

    /// Share of the footprint inside a disc, near enough.
    pub fn in_disc(&self, u: f64, v: f64, radius: f64) -> f32 {
        let width = self.widest();
        let (u, v) = (self.u - u, self.v - v);
        let distance = (u * u + v * v).sqrt();
        inside(distance, width, -radius, radius) * (2.0 * radius / width).min(1.0) as f32
    }
}

/// Share of `[x - w/2, x + w/2]` inside `[from, to]`.
#[inline(always)]
pub(super) fn inside(x: f64, w: f64, from: f64, to: f64) -> f32 {
    (((x + 0.5 * w).min(to) - (x - 0.5 * w).max(from)).max(0.0) / w) as f32
}

/// Share of `[x - w/2, x + w/2]` inside the bars `[0, bar]` repeated every `period`.
pub(super) fn bars(x: f64, w: f64, period: f64, bar: f64) -> f32 {
    let up_to = |x: f64| {
        let whole = f64::from(floor(x / period));
        whole * bar + (x - whole * period).min(bar)
    };
    ((up_to(x + 0.5 * w) - up_to(x - 0.5 * w)) / w) as f32
}

/// How much of a pattern survives a footprint of `width`: all up to 0.4 of its period, nothing from 1.1.
#[inline(always)]
pub(super) fn kept(width: f64, period: f64) -> f32 {
    ((1.1 - width / period) / 0.7).clamp(0.0, 1.0) as f32
}

/// A random number in -1..1 for the cell of a grid, zero at the borders of the cell so that it needs no more filtering.
pub(super) fn tint(spot: &Spot, cell_u: f64, cell_v: f64, salt: u32) -> f32 {
    let (i, j) = (floor(spot.u / cell_u), floor(spot.v / cell_v));
    let (u, v) = (f64::from(i) * cell_u, f64::from(j) * cell_v);
    let share = spot.in_rectangle((u, u + cell_u), (v, v + cell_v));
    (2.0 * share - 1.0).max(0.0) * signed(hash(i, j, salt))
}

/// Noise of several scales in about -1..1: cells of `coarsest` metres, each octave finer by 0.38 and weaker by a quarter.
pub(super) fn detail(spot: &Spot, coarsest: f64, octaves: u32, salt: u32) -> f32 {
    let width = spot.widest();
    let (mut frequency, mut weight, mut sum) = (1.0 / coarsest, 0.6, 0.0);
    for octave in 0..octaves {
        let share = kept(width * frequency, 1.0);
        if share <= 0.0 {
            break;
        }
        sum += weight * share * noise(spot.u * frequency, spot.v * frequency, salt.wrapping_add(octave));
        frequency *= 1.0 / 0.38;
        weight *= 0.75;
    }
    sum
}

/// Random values of the noise at lattice points. A look-up takes a third of the time of a hash; the pattern of 256 x 256
/// cells is shifted by each salt, so that octaves never repeat together.
static LATTICE: LazyLock<Box<[i8; 65536]>> =
    LazyLock::new(|| Box::new(std::array::from_fn(|k| (hash(k as i32, 0, 2007) >> 24) as i8)));

/// Noise of one scale in -1..1: random values on the integer lattice, joined smoothly.
#[inline(always)]
pub(super) fn noise(u: f64, v: f64, salt: u32) -> f32 {
    let (i, j) = (floor(u), floor(v));
    let (a, b) = ((u - f64::from(i)) as f32, (v - f64::from(j)) as f32);
    let (a, b) = (a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b));
    let shift = salt.wrapping_mul(0x9e37_79b1);
    let (i, j) = ((i as u32).wrapping_add(shift >> 24) as u8, (j as u32).wrapping_add(shift >> 16) as u8);
    let lattice = &**LATTICE;
    let at = |i: u8, j: u8| f32::from(lattice[usize::from(u16::from_be_bytes([j, i]))]);
    let (i1, j1) = (i.wrapping_add(1), j.wrapping_add(1));
    let low = at(i, j) + a * (at(i1, j) - at(i, j));
    let high = at(i, j1) + a * (at(i1, j1) - at(i, j1));
    (low + b * (high - low)) * (1.0 / 128.0)
}

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
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A number in -1..1 from bits.
#[inline(always)]
pub(super) fn signed(bits: u32) -> f32 {
    2.0 * unit(bits) - 1.0
}

/// One of the choices.
pub(super) fn pick<T: Copy, const N: usize>(choices: [T; N], bits: u32) -> T {
    choices[(bits >> 5) as usize % N]
}

/// Largest integer not above; a conversion is one instruction where `f64::floor` may be a call.
#[inline(always)]
pub(super) fn floor(x: f64) -> i32 {
    let i = x as i32;
    i - i32::from(x < f64::from(i))
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
