//! What the faces of the city look like, averaged over the footprint of a pixel.
//!
//! Everything is a function of the place in the world (cars and the operator: of the place on them), so that a feature
//! stays where it is however it is looked at. Windows, bricks, slabs, signs and posters differ from one to the next.

use super::city::House;
use super::filter::{Colour, Spot, bars, detail, floor, hash, inside, kept, lit, mix, noise, pick, tint, unit};
use super::path::{BLOCK_M, HOUSES_M, KERB_M};
use crate::geometry::Vector;

/// Height of the ground floor.
const SHOP_M: f64 = 3.6;
const GLASS: Colour = [0.16, 0.2, 0.25];

/// The face of a house: `u` from its left or right end over `width`, `v` above the ground of `height`.
pub(super) fn facade(house: &House, face: u32, width: f64, height: f64, spot: &Spot) -> Colour {
    let salt = hash(face as i32, 0, house.seed);
    let mut colour = wall(house, salt, spot);
    let columns = ((width - 0.8) / house.column_m).floor().max(1.0);
    let margin = 0.5 * (width - columns * house.column_m);
    let across = spot.u - margin;
    let column = floor(across / house.column_m).clamp(0, columns as i32 - 1);
    if spot.v < SHOP_M {
        colour = ground_floor(colour, house, salt, width, spot);
    } else if spot.v < height - 0.7 {
        let storey = floor((spot.v - SHOP_M) / house.storey_m);
        let middle = margin + (f64::from(column) + 0.5) * house.column_m;
        let sill = SHOP_M + f64::from(storey) * house.storey_m + 0.9;
        colour = window(colour, house, hash(column, storey, salt), &spot.about(middle, sill));
    }
    let ledge = |from: f64, to: f64| inside(spot.v, spot.w_v, from, to);
    let ledges = ledge(height - 0.7, height) + ledge(SHOP_M - 0.16, SHOP_M);
    if ledges > 0.0 {
        let stone = lit(house.trim, 0.92 + 0.2 * detail(spot, 0.5, 4, salt ^ 0x51));
        colour = mix(colour, lit(stone, 1.0 - 0.3 * ledge(height - 0.7, height - 0.55)), ledges.min(1.0));
    }
    colour = mix(colour, [0.34, 0.33, 0.32], 0.8 * ledge(0.0, 0.45));
    // dirt from the ground and under ledges
    let dirt = ledge(0.0, 1.2) * 0.12 + ledge(SHOP_M - 0.5, SHOP_M - 0.16) * 0.15;
    lit(colour, 1.0 - dirt + 0.1 * noise(spot.u / 0.7, spot.v / 5.0, salt))
}

/// Bricks or plaster.
fn wall(house: &House, salt: u32, spot: &Spot) -> Colour {
    let rough = detail(spot, 2.2, 6, salt);
    if !house.bricks {
        let stain = (detail(spot, 0.9, 4, salt ^ 0x77) - 0.35).max(0.0);
        return lit(mix(house.wall, [0.4, 0.38, 0.35], stain), 1.0 + 0.3 * rough);
    }
    let row = floor(spot.v / 0.1);
    let shifted = spot.about(0.15 * f64::from(row & 1), 0.0);
    let course = bars(spot.v, spot.w_v, 0.1, 0.014);
    let joint = bars(shifted.u, spot.w_u, 0.3, 0.014) * kept(spot.w_v, 0.1);
    let brick = lit(house.wall, 1.0 + 0.26 * tint(&shifted, 0.3, 0.1, salt) + 0.22 * rough);
    mix(brick, [0.66, 0.63, 0.58], 0.7 * (course + joint - course * joint))
}

/// A window in its wall, from the middle of its sill; each is furnished by its own `bits`.
fn window(wall: Colour, house: &House, bits: u32, spot: &Spot) -> Colour {
    let [half, high] = house.window_m;
    let mut colour = wall;
    if house.shutters {
        let slats = 0.8 + 0.3 * bars(spot.v, spot.w_v, 0.08, 0.05);
        let green = pick([[0.25, 0.36, 0.3], [0.3, 0.26, 0.2], [0.32, 0.4, 0.48]], house.seed);
        let leaf = Spot { u: spot.u.abs(), ..*spot }.in_rectangle((half + 0.1, 1.85 * half + 0.1), (0.0, high));
        colour = mix(colour, lit(green, slats), leaf);
    }
    if spot.u.abs() - spot.w_u > 2.0 * half + 0.3 {
        return colour;
    }
    let frame = spot.in_rectangle((-half - 0.1, half + 0.1), (-0.1, high + 0.12));
    let sill = spot.in_rectangle((-half - 0.2, half + 0.2), (-0.2, -0.1));
    let shadow = spot.in_rectangle((-half - 0.15, half + 0.15), (-0.28, -0.2));
    colour = mix(lit(colour, 1.0 - 0.45 * shadow), house.trim, frame.max(sill));
    let pane = spot.in_rectangle((-half, half), (0.0, high));
    if pane > 0.0 {
        colour = mix(colour, glass(half, high, bits, spot), pane);
    }
    let flower_box = if bits & 3 == 0 { spot.in_rectangle((-half, half), (-0.12, 0.2)) } else { 0.0 };
    if flower_box > 0.0 {
        let leaves = lit([0.24, 0.38, 0.16], 1.0 + 0.9 * detail(spot, 0.2, 3, bits));
        let flowers = pick([[0.8, 0.2, 0.25], [0.9, 0.75, 0.2], [0.85, 0.5, 0.75]], bits >> 7);
        let share = (3.0 * noise(spot.u / 0.07, spot.v / 0.07, bits) - 1.2).clamp(0.0, 1.0) * kept(spot.widest(), 0.1);
        colour = mix(colour, mix(leaves, flowers, share), flower_box);
    }
    colour
}

/// Panes, bars, curtains, a blind that is let down by some length, and a reflected sky.
fn glass(half: f64, high: f64, bits: u32, spot: &Spot) -> Colour {
    let reflected = 0.25 * detail(spot, 1.1, 4, bits) + 0.25 * (spot.v / high) as f32 * unit(bits.wrapping_mul(31));
    let mut colour = mix(GLASS, [0.62, 0.7, 0.78], (0.22 + reflected).clamp(0.0, 1.0));
    let open = f64::from(0.25 + 0.75 * unit(bits.wrapping_mul(0x9e37_79b1)));
    if bits & 16 != 0 {
        let folds = 0.9 + 0.14 * bars(spot.u, spot.w_u, 0.11, 0.05) - 0.1 * noise(spot.u / 0.15, spot.v, bits);
        let cloth = pick([[0.85, 0.83, 0.78], [0.7, 0.5, 0.4], [0.75, 0.78, 0.85]], bits >> 3);
        let outside = 1.0 - inside(spot.u, spot.w_u, -half * open, half * open);
        colour = mix(colour, lit(cloth, folds), 0.85 * outside);
    } else if bits & 32 != 0 {
        let slats = 0.86 + 0.2 * bars(spot.v, spot.w_v, 0.06, 0.04);
        colour = mix(colour, lit([0.78, 0.75, 0.66], slats), inside(spot.v, spot.w_v, open * high, high + 1.0));
    }
    let cross = if bits & 64 != 0 { 0.68 * high } else { 0.5 * high };
    let upright = inside(spot.u, spot.w_u, -0.035, 0.035);
    let level = inside(spot.v, spot.w_v, cross - 0.03, cross + 0.03);
    mix(colour, [0.88, 0.87, 0.84], upright.max(level))
}

/// Bays of shops, doors and walls with posters.
fn ground_floor(wall: Colour, house: &House, salt: u32, width: f64, spot: &Spot) -> Colour {
    let bays = (width / 3.4).floor().max(1.0);
    let bay_m = width / bays;
    let bay = floor(spot.u / bay_m).clamp(0, bays as i32 - 1);
    let bits = hash(bay, 99, salt);
    let here = spot.about((f64::from(bay) + 0.5) * bay_m, 0.0);
    match bits % 4 {
        0 => poster(wall, bits, &here),
        1 => door(wall, house, bits, &here),
        _ => shop(wall, house, bits, 0.5 * bay_m - 0.25, &here),
    }
}

fn shop(wall: Colour, house: &House, bits: u32, half: f64, spot: &Spot) -> Colour {
    let wood = pick([[0.22, 0.3, 0.26], [0.36, 0.2, 0.16], [0.2, 0.22, 0.3], [0.75, 0.72, 0.66]], bits >> 4);
    let front = spot.in_rectangle((-half - 0.1, half + 0.1), (0.45, 3.3));
    if front <= 0.0 {
        return wall;
    }
    let mut colour = mix(wall, wood, front);
    let pane = spot.in_rectangle((-half, half), (0.6, 2.4));
    if pane > 0.0 {
        // goods: boxes of all colours on two shelves behind the glass
        let goods = Spot { v: spot.v - 0.6, ..*spot };
        let salt = hash(floor(goods.u / 0.28), floor(goods.v / 0.45), bits);
        let bright: Colour = std::array::from_fn(|c| 0.2 + 0.6 * unit(salt.wrapping_mul(3 + 2 * c as u32)));
        let share = (0.7 * tint(&goods, 0.28, 0.45, bits ^ 5) + 0.5).clamp(0.0, 1.0) * kept(spot.widest(), 0.28);
        let inner = mix([0.2, 0.19, 0.18], bright, share * inside(goods.v, spot.w_v, 0.05, 1.3));
        let reflected = (0.18 + 0.25 * detail(spot, 1.4, 5, bits)).clamp(0.0, 1.0);
        colour = mix(colour, mix(inner, [0.6, 0.66, 0.72], reflected), pane);
        let upright = inside(spot.u, spot.w_u, 0.3 * half - 0.04, 0.3 * half + 0.04);
        colour = mix(colour, wood, upright * pane);
    }
    let board = spot.in_rectangle((-half, half), (2.5, 3.25));
    if board > 0.0 {
        let ground =
            pick([house.trim, [0.16, 0.2, 0.4], [0.5, 0.12, 0.12], [0.9, 0.8, 0.3], [0.12, 0.3, 0.2]], bits >> 9);
        let ink = if ground[0] + ground[1] > 1.0 { [0.12, 0.1, 0.1] } else { [0.95, 0.92, 0.82] };
        let text = letters(&spot.about(-0.85 * half, 2.62), 1.7 * half, 0.5, bits);
        colour = mix(colour, mix(ground, ink, text), board);
    }
    colour
}

fn door(wall: Colour, house: &House, bits: u32, spot: &Spot) -> Colour {
    let wood = pick([[0.4, 0.24, 0.14], [0.16, 0.26, 0.36], [0.45, 0.1, 0.12], [0.2, 0.3, 0.2]], bits >> 6);
    let mut colour = mix(wall, house.trim, spot.in_rectangle((-0.72, 0.72), (0.0, 2.85)));
    let grain = lit(wood, 1.0 + 0.25 * noise(spot.u / 0.05, spot.v / 0.6, bits) * kept(spot.w_u, 0.1));
    colour = mix(colour, grain, spot.in_rectangle((-0.55, 0.55), (0.1, 2.2)));
    let panels = Spot { u: spot.u.abs(), ..*spot };
    for (low, high) in [(0.25, 0.95), (1.1, 2.05)] {
        colour = mix(colour, lit(grain, 0.7), panels.in_rectangle((0.08, 0.45), (low, high)));
    }
    colour = mix(colour, GLASS, spot.in_rectangle((-0.55, 0.55), (2.3, 2.72)));
    colour = mix(colour, [0.85, 0.7, 0.3], spot.in_disc(0.46, 1.03, 0.05));
    // number and letter box beside it
    let plate = spot.in_rectangle((0.85, 1.15), (1.6, 1.85));
    let digits = letters(&spot.about(0.89, 1.64), 0.24, 0.17, bits);
    colour = mix(colour, mix([0.15, 0.2, 0.5], [0.95, 0.95, 0.95], digits), plate);
    mix(colour, [0.3, 0.3, 0.32], spot.in_rectangle((-1.25, -0.9), (1.1, 1.5)))
}

fn poster(wall: Colour, bits: u32, spot: &Spot) -> Colour {
    let mut colour = wall;
    for k in 0..2_u32 {
        let bits = hash(k as i32, 7, bits);
        let (left, low) = (-1.25 + 1.3 * f64::from(k), 0.8 + 0.5 * f64::from(unit(bits)));
        let size = [0.8 + 0.3 * f64::from(unit(bits >> 3)), 1.0 + 0.4 * f64::from(unit(bits << 3))];
        let paper = spot.in_rectangle((left, left + size[0]), (low, low + size[1]));
        if paper > 0.0 {
            let ground: Colour = std::array::from_fn(|c| 0.35 + 0.6 * unit(bits.wrapping_mul(5 + 6 * c as u32)));
            let ink: Colour = std::array::from_fn(|c| 0.5 * unit(bits.wrapping_mul(9 + 4 * c as u32)));
            let text = letters(&spot.about(left + 0.08, low + 0.1), size[0] - 0.16, 0.22, bits);
            let above = spot.about(left, low + 0.42);
            let picture = (2.5 * detail(&above, 0.4, 4, bits)).clamp(0.0, 1.0);
            let picture = picture * above.in_rectangle((0.08, size[0] - 0.08), (0.0, size[1] - 0.5));
            colour = mix(colour, mix(ground, ink, text.max(picture)), paper);
        }
    }
    colour
}

/// A line of writing from its lower left corner: letters of 3 by 5 random bits.
fn letters(spot: &Spot, width: f64, height: f64, salt: u32) -> f32 {
    let letter_m = 0.72 * height;
    let letter = floor(spot.u / letter_m);
    if letter < 0 || f64::from(letter + 1) * letter_m > width || spot.v < 0.0 || spot.v > height {
        return 0.0;
    }
    let bits = hash(letter, 3, salt) | 0x0421;
    let (bit_u, bit_v) = (letter_m / 4.0, height / 5.0);
    let u = spot.u - f64::from(letter) * letter_m;
    let (i, j) = (floor(u / bit_u).min(3), floor(spot.v / bit_v).min(4));
    let cell = Spot { u: u - f64::from(i) * bit_u, v: spot.v - f64::from(j) * bit_v, ..*spot };
    let is_ink = i < 3 && bits >> (3 * j + i) & 1 == 1;
    let share = cell.in_rectangle((0.0, bit_u), (0.0, bit_v));
    let fade = kept(spot.widest(), 2.0 * bit_u);
    0.35 * (1.0 - fade) + fade * if is_ink { share } else { 0.0 }
}

/// The ground: carriageways with markings, kerbs, pavements of slabs. Coordinates are the world's x and y.
pub(super) fn ground(spot: &Spot) -> Colour {
    let from_middle = |x: f64, block: f64| x - block * f64::from(floor(x / block + 0.5));
    let (x, y) = (from_middle(spot.u, BLOCK_M[0]), from_middle(spot.v, BLOCK_M[1]));
    let road = |half: f64| {
        let (a, b) = (inside(x, spot.w_u, -half, half), inside(y, spot.w_v, -half, half));
        a + b - a * b
    };
    let rough = detail(spot, 3.1, 7, 11);
    let carriageway = road(KERB_M);
    let kerb = (road(KERB_M + 0.18) - carriageway).max(0.0);
    let mut colour = [0.0; 3];
    if carriageway > 0.0 {
        colour = lit(asphalt(spot, [x, y], rough), carriageway);
    }
    if kerb > 0.0 {
        let joints = (bars(spot.u, spot.w_u, 0.9, 0.03) + bars(spot.v, spot.w_v, 0.9, 0.03)).min(1.0);
        let stone = lit([0.66, 0.65, 0.62], 1.0 + 0.3 * rough - 0.4 * joints);
        colour = std::array::from_fn(|c| colour[c] + kerb * stone[c]);
    }
    let rest = 1.0 - carriageway - kerb;
    if rest > 0.0 {
        let slab = pavement(spot, rough);
        colour = std::array::from_fn(|c| colour[c] + rest * slab[c]);
    }
    // less sky lights the ground beside a house
    let to_wall = HOUSES_M - x.abs().min(y.abs());
    lit(specks(colour, spot), 1.0 - 0.3 * (1.0 - to_wall / 0.7).clamp(0.0, 1.0) as f32)
}

/// Asphalt with patches, markings and covers; `middle` is the place relative to the nearest middles of streets.
fn asphalt(spot: &Spot, [x, y]: [f64; 2], rough: f32) -> Colour {
    let patch = tint(spot, 2.7, 1.9, 5) + 0.6 * tint(spot, 7.3, 3.1, 6);
    let mut colour = lit([0.3, 0.3, 0.31], 1.0 + 0.4 * rough + 0.13 * patch);
    let (i, j) = (floor(spot.u / 6.0), floor(spot.v / 3.0));
    let bits = hash(i, j, 21);
    if bits & 3 == 0 {
        let (u, v) = (6.0 * f64::from(i) + 1.0 + 4.0 * f64::from(unit(bits)), 3.0 * f64::from(j) + 1.5);
        let iron = lit([0.24, 0.22, 0.2], 1.0 + 0.5 * tint(&spot.about(u, v), 0.09, 0.09, bits));
        colour = mix(colour, [0.42, 0.41, 0.4], spot.in_disc(u, v, 0.42));
        colour = mix(colour, iron, spot.in_disc(u, v, 0.34));
    }
    let mut paint = 0.0_f32;
    for (along, across, at, w_along, w_across) in
        [(x, y, spot.u, spot.w_u, spot.w_v), (y, x, spot.v, spot.w_v, spot.w_u)]
    {
        // dashes in the middle, away from crossings; a zebra before each crossing
        let away = 1.0 - inside(along, w_along, -10.0, 10.0);
        let dash = bars(at, w_along, 6.0, 3.0) * inside(across, w_across, -0.06, 0.06) * away;
        let zebra = inside(along.abs(), w_along, 5.2, 8.2) * bars(across, w_across, 1.0, 0.5);
        let zebra = zebra * inside(across, w_across, -KERB_M + 0.3, KERB_M - 0.3);
        paint = paint.max(dash).max(zebra);
    }
    mix(colour, [0.86, 0.86, 0.83], paint * (0.85 + 0.25 * rough).clamp(0.4, 1.0))
}

fn pavement(spot: &Spot, rough: f32) -> Colour {
    let joints = (bars(spot.u, spot.w_u, 0.5, 0.016) + bars(spot.v, spot.w_v, 0.5, 0.016)).min(1.0);
    let slab = tint(spot, 0.5, 0.5, 31) + 0.5 * tint(spot, 3.0, 1.5, 32);
    lit([0.56, 0.54, 0.51], 1.0 + 0.35 * rough + 0.11 * slab - 0.55 * joints)
}

/// Leaves, gum and litter.
fn specks(ground: Colour, spot: &Spot) -> Colour {
    let width = spot.widest();
    let mut colour = ground;
    for (cell, salt) in [(0.21, 41), (0.5, 42)] {
        let share = kept(width, 0.35 * cell);
        if share > 0.0 {
            let (i, j) = (floor(spot.u / cell), floor(spot.v / cell));
            let bits = hash(i, j, salt);
            let at = |k: u32| cell * (0.3 + 0.4 * f64::from(unit(hash(i, j, salt + 10 * k))));
            let (u, v) = (f64::from(i) * cell + at(1), f64::from(j) * cell + at(2));
            let dot = spot.in_disc(u, v, cell * f64::from(0.02 + 0.08 * unit(bits).powi(2)));
            let tone = pick([[0.2, 0.18, 0.16], [0.6, 0.42, 0.16], [0.75, 0.74, 0.7], [0.36, 0.34, 0.16]], bits);
            colour = mix(colour, tone, 0.8 * share * dot);
        }
    }
    colour
}

/// A car's side (`end` false) or end: `u` from its middle, towards its front where that is seen.
pub(super) fn car(paint: Colour, end: bool, cabin: bool, spot: &Spot) -> Colour {
    let mut colour = lit(paint, 0.85 + 0.25 * (spot.v / 1.4) as f32 + 0.06 * noise(spot.u / 0.5, spot.v / 0.2, 1));
    if cabin {
        let half = if end { 0.64 } else { 3.0 };
        let pillars = if end { 0.0 } else { inside(spot.u, spot.w_u, -0.4, -0.3) };
        let pane = spot.in_rectangle((-half, half), (0.93, 1.36)) * (1.0 - pillars);
        let sky = (0.3 + 0.4 * (spot.v - 0.9) + 0.1 * f64::from(noise(spot.u / 0.4, spot.v / 0.4, 2))) as f32;
        return mix(colour, mix(GLASS, [0.7, 0.78, 0.85], sky), pane);
    }
    colour = mix(colour, [0.06, 0.06, 0.07], inside(spot.v, spot.w_v, -1.0, 0.2));
    if end {
        let lamps = Spot { u: spot.u.abs(), ..*spot }.in_rectangle((0.5, 0.78), (0.55, 0.72));
        let plate = spot.in_rectangle((-0.26, 0.26), (0.36, 0.48));
        let digits = letters(&spot.about(-0.23, 0.375), 0.46, 0.09, (paint[0] * 4e6) as u32);
        colour = mix(mix(colour, [0.9, 0.88, 0.75], lamps), [0.93, 0.92, 0.85], plate);
        return mix(colour, [0.1, 0.1, 0.1], digits * plate);
    }
    for wheel in [-1.3, 1.3] {
        colour = mix(colour, [0.09, 0.09, 0.1], spot.in_disc(wheel, 0.32, 0.33));
        colour = mix(colour, [0.6, 0.6, 0.62], spot.in_disc(wheel, 0.32, 0.19));
    }
    let seams = inside(spot.u, spot.w_u, -0.35, -0.335) + inside(spot.u, spot.w_u, 0.75, 0.765);
    lit(colour, 1.0 - 0.6 * seams.min(1.0) * inside(spot.v, spot.w_v, 0.3, 0.88))
}

/// Bark or painted metal round a post.
pub(super) fn post(colour: Colour, seed: u32, spot: &Spot) -> Colour {
    let rings = bars(spot.v, spot.w_v, 0.7, 0.04);
    lit(colour, 1.0 + 0.6 * detail(spot, 0.12, 4, seed) + 0.3 * detail(spot, 1.1, 2, seed ^ 9) - 0.3 * rings)
}

/// Leaves of a crown, or a lamp's globe (seed 0), at a point of the world.
pub(super) fn ball(colour: Colour, seed: u32, at: &Vector<3>, width: f64) -> Colour {
    if seed == 0 {
        return colour;
    }
    let on = |u: f64, v: f64| Spot { u, v, w_u: width, w_v: width };
    let (p, q) = (on(at[0] + 0.6 * at[2], at[1] - 0.7 * at[2]), on(at[0] - at[1], at[2] + 0.5 * at[1]));
    let leaves = detail(&p, 0.17, 4, 61) + detail(&q, 0.14, 4, 62);
    lit(colour, (0.85 + 0.9 * leaves).max(0.15))
}

/// Blue with clouds, and haze at the horizon; it does not move with the camera.
pub(super) fn sky(along: &Vector<3>, delta: f64) -> Colour {
    let height = along[2].max(0.0);
    let blue = mix(HAZE, [0.3, 0.5, 0.82], (1.6 * height as f32).min(1.0));
    let flat = 1.0 / (height + 0.22);
    let spot = Spot { u: along[0] * flat, v: along[1] * flat, w_u: delta * flat, w_v: delta * flat };
    let cloud = (1.5 * detail(&spot, 0.9, 6, 71) + 0.05).clamp(0.0, 1.0) * (6.0 * height).min(1.0) as f32;
    mix(blue, lit([0.96, 0.96, 0.97], 1.0 - 0.25 * cloud), cloud)
}

/// What everything fades to with distance.
pub(super) const HAZE: Colour = [0.78, 0.82, 0.87];

/// The operator: cloth, in the camera's own directions.
pub(super) fn operator(bearing: &Vector<3>, delta: f64) -> Colour {
    let flat = 1.0 / (bearing[1].abs() + 0.6);
    let spot = Spot { u: bearing[0] * flat, v: bearing[2] * flat, w_u: delta, w_v: delta };
    let folds = detail(&spot, 0.3, 6, 81);
    let shirt = mix([0.16, 0.18, 0.3], [0.5, 0.16, 0.14], bars(spot.v, delta, 0.12, 0.05));
    let skin = spot.in_disc(0.0, 0.0, 0.22);
    mix(lit(shirt, 1.0 + 0.5 * folds), lit([0.36, 0.25, 0.18], 1.0 + 0.8 * folds), skin)
}
