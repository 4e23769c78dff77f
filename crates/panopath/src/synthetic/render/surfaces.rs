//! What the faces of the city look like, averaged over the footprint of a pixel.
//!
//! Everything is a function of the place in the world (cars and the operator: of the place on them), so that a feature
//! stays where it is however it is looked at. No two windows, bricks, slabs, signs or cars are alike, and stains, cracks
//! and repairs cross them, so that places can be told from one another.

use super::city::House;
use super::filter::{
    Colour, Spot, byte, clamp, detail, floor, greater, hash, kept, lesser, lit, mix, mottle, noise, pick, scales, tint,
    unit,
};
use super::path::{BLOCK_M, HOUSES_M, KERB_M};
use crate::geometry::Vector;

/// Height of the ground floor.
const SHOP_M: f32 = 3.6;
const GLASS: Colour = [0.16, 0.2, 0.25];

/// The face of a house: `u` from its left or right end over `width`, `v` above the ground of `height`.
pub(super) fn facade(house: &House, face: u32, width: f32, height: f32, spot: &Spot) -> Colour {
    let salt = hash(face as i32, 0, house.seed);
    let cornice = spot.in_v(height - 0.7, height);
    let ledges = cornice + spot.in_v(SHOP_M - 0.16, SHOP_M);
    let mut colour = if ledges >= 1.0 {
        house.trim
    } else if spot.v < SHOP_M {
        ground_floor(house, salt, width, spot)
    } else if spot.v < height - 0.7 {
        let columns = greater(floor((width - 0.8) / house.column_m) as f32, 1.0);
        let margin = 0.5 * (width - columns * house.column_m);
        let column = floor((spot.u - margin) / house.column_m).clamp(0, columns as i32 - 1);
        let storey = floor((spot.v - SHOP_M) / house.storey_m);
        let middle = margin + (column as f32 + 0.5) * house.column_m;
        let sill = SHOP_M + storey as f32 * house.storey_m + 0.9;
        window(house, salt, hash(column, storey, salt), spot, [middle, sill])
    } else {
        wall(house, salt, spot)
    };
    if ledges > 0.0 {
        let stone = lit(house.trim, 0.92 + 0.3 * mottle(spot, 0.8, salt ^ 0x51));
        let shade = spot.in_v(height - 0.7, height - 0.55);
        colour = mix(colour, lit(stone, 1.0 - 0.3 * shade), lesser(ledges, 1.0));
    }
    if spot.v > SHOP_M {
        return colour;
    }
    // a base of stone; dirt from the ground, and under ledges
    colour = mix(colour, [0.34, 0.33, 0.32], 0.6 * spot.in_v(0.0, 0.45));
    lit(colour, 1.0 - spot.in_v(0.0, 1.2) * 0.12 - spot.in_v(SHOP_M - 0.5, SHOP_M - 0.16) * 0.15)
}

/// Bricks or plaster, with what years have done to them.
fn wall(house: &House, salt: u32, spot: &Spot) -> Colour {
    let [old, fine] = scales(spot, 4.5, salt);
    let rough = 0.55 * old + 0.5 * fine;
    let cracked = crack(old, 0.12, 0.006, spot);
    if !house.bricks {
        let stained = mix(house.wall, [0.4, 0.38, 0.35], 0.5 * clamp(7.0 * (old - 0.22)));
        // where the plaster has come off
        let bare = mix(stained, [0.56, 0.38, 0.3], 0.8 * clamp(9.0 * (-0.42 - old)));
        return lit(mix(bare, [0.2, 0.18, 0.17], 0.7 * cracked), 1.0 + 0.36 * rough);
    }
    let row = floor(spot.v * 10.0);
    let shifted = spot.about(0.15 * (row & 1) as f32, 0.0);
    let course = spot.bars_v(0.1, 0.014);
    let joint = shifted.bars_u(0.3, 0.014) * kept(spot.w_v, 0.1);
    let tone = tint(&shifted, 0.3, 0.1, salt);
    let brick = lit(house.wall, 0.97 + tone * (0.18 + 0.2 * tone.abs()) + 0.26 * rough);
    let bricks = mix(brick, [0.66, 0.63, 0.58], 0.7 * (course + joint - course * joint));
    // where it has been rendered over
    let plaster = lit(mix(house.wall, [0.72, 0.69, 0.63], 0.75), 1.0 + 0.3 * rough - 0.5 * cracked);
    mix(bricks, plaster, clamp(9.0 * (old - 0.34)))
}

/// Share of a thin line where a field is `at`, wide `width` metres; the field's slope is about one in its coarsest cell.
fn crack(field: f32, at: f32, width: f32, spot: &Spot) -> f32 {
    let footprint = greater(spot.widest(), width);
    clamp(1.2 - (field - at).abs() / (1.1 * footprint)) * lesser(width / footprint, 1.0)
}

/// A window in its wall, from the middle of its sill at `place`; each is furnished by its own `bits`.
fn window(house: &House, salt: u32, bits: u32, on_wall: &Spot, place: [f32; 2]) -> Colour {
    let [half, high] = house.window_m;
    let spot = &on_wall.about(place[0], place[1]);
    let pane = spot.in_rectangle((-half, half), (0.0, high));
    if pane >= 1.0 && (bits & 3 != 0 || spot.v > 0.3) {
        return glass(half, high, bits, spot);
    }
    let mut colour = fittings(wall(house, salt, on_wall), house, hash(3, 5, bits), spot);
    // beyond its frame and its sill there is nothing of the window but the rain that has run down from it
    if spot.u.abs() < half + 0.3 + spot.w_u {
        if spot.v < -0.1 {
            let runs = clamp(1.5 * noise(spot.u * 9.0, spot.v * 0.9, bits)) * clamp(1.0 + 1.2 * spot.v);
            let runs = runs * spot.in_rectangle((-half - 0.25, half + 0.25), (-0.9, -0.2));
            let shadow = spot.in_rectangle((-half - 0.15, half + 0.15), (-0.28, -0.2));
            colour = lit(colour, 1.0 - 0.45 * shadow - 0.3 * runs);
        }
        let frame = spot.in_rectangle((-half - 0.1, half + 0.1), (-0.1, high + 0.12));
        let sill = spot.in_rectangle((-half - 0.2, half + 0.2), (-0.2, -0.1));
        let trim = lit(house.trim, 0.84 + 0.26 * byte(bits, 2));
        colour = mix(colour, trim, greater(frame, sill));
    }
    if pane > 0.0 {
        colour = mix(colour, glass(half, high, bits, spot), pane);
    }
    let flower_box = if bits & 3 == 0 && spot.v < 0.3 { spot.in_rectangle((-half, half), (-0.12, 0.2)) } else { 0.0 };
    if flower_box > 0.0 {
        let leaves = lit([0.24, 0.38, 0.16], 1.0 + 0.9 * mottle(spot, 0.2, bits));
        let flowers = pick([[0.8, 0.2, 0.25], [0.9, 0.75, 0.2], [0.85, 0.5, 0.75]], bits >> 7);
        let share = clamp(3.0 * noise(spot.u / 0.07, spot.v / 0.07, bits) - 1.2) * kept(spot.widest(), 0.1);
        colour = mix(colour, mix(leaves, flowers, share), flower_box);
    }
    colour
}

/// What is fixed to the wall about a window: shutters, ventilators, boxes, plates, repaired plaster.
fn fittings(wall: Colour, house: &House, bits: u32, spot: &Spot) -> Colour {
    let [half, high] = house.window_m;
    let mut colour = wall;
    if spot.u.abs() + 0.5 * spot.w_u < half {
        return colour;
    }
    let side = if bits & 1 == 0 { 1.0 } else { -1.0 };
    let (at_u, at_v) = (side * (half + 0.3 + 0.3 * byte(bits, 1)), -0.7 + 2.2 * byte(bits, 2));
    let size = [0.08 + 0.3 * byte(bits, 3), 0.1 + 0.35 * byte(bits, 1)];
    let tone = 0.25 + 0.6 * byte(bits.wrapping_mul(0x9e37_79b1), 3);
    match bits >> 1 & 3 {
        0 => {
            let patch = lit(mix(wall, house.trim, 0.5), 0.7 + 0.6 * tone);
            let share = spot.in_rectangle((at_u - size[0], at_u + size[0]), (at_v - size[1], at_v + size[1]));
            colour = mix(colour, patch, share);
        }
        1 => colour = mix(colour, [tone, tone, tone], spot.in_disc(at_u, at_v, 0.05 + 0.4 * size[0])),
        2 => {
            let case = spot.in_rectangle((at_u - 0.3, at_u + 0.3), (-0.75, -0.75 + 0.42));
            let fan = spot.in_disc(at_u - 0.08, -0.54, 0.16);
            colour = mix(mix(colour, [0.8, 0.8, 0.77], case), [0.25, 0.25, 0.26], 0.8 * fan);
        }
        _ => {}
    }
    if house.shutters {
        let slats = 0.8 + 0.3 * spot.bars_v(0.08, 0.05);
        let green = pick([[0.25, 0.36, 0.3], [0.3, 0.26, 0.2], [0.32, 0.4, 0.48]], house.seed);
        // some are half closed, some are gone
        let leaf = |outer: f32, bits: u32, spot: &Spot| {
            let outer = if bits & 7 == 0 { half + 0.1 } else { outer * (0.8 + 0.2 * byte(bits, 0)) };
            spot.in_rectangle((half + 0.1, outer), (0.0, high))
        };
        let bits = if spot.u > 0.0 { bits >> 8 } else { bits >> 16 };
        let share = leaf(1.85 * half + 0.1, bits, &spot.folded());
        let worn = 0.78 + 0.4 * byte(bits, 0) + 0.3 * noise(spot.u / 0.3, spot.v / 0.5, bits);
        colour = mix(colour, lit(green, slats * worn), share);
    }
    colour
}

/// Panes with what is behind them - a room, curtains, a blind let down by some length, things on the sill - and the
/// houses and the sky that they reflect.
fn glass(half: f32, high: f32, bits: u32, spot: &Spot) -> Colour {
    let more = hash(1, 2, bits);
    let room = mix(GLASS, [0.5, 0.42, 0.3], 0.6 * byte(more, 0) * byte(more, 1));
    let mut colour = lit(room, 0.9 + 0.5 * noise(spot.u * 1.9, spot.v * 1.9, bits));
    if spot.v < 0.6 {
        colour = on_sill(colour, half, bits, more, spot);
    }
    let open = 0.2 + 0.75 * byte(bits, 3);
    if bits & 16 != 0 {
        let folds = 0.9 + 0.14 * spot.bars_u(0.11, 0.05) - 0.2 * noise(spot.u / 0.13, spot.v * 0.8, bits);
        let cloth = pick(
            [[0.85, 0.83, 0.78], [0.7, 0.5, 0.4], [0.75, 0.78, 0.85], [0.5, 0.55, 0.42], [0.62, 0.3, 0.28]],
            bits >> 3,
        );
        let outside = 1.0 - spot.in_u(-half * open, half * (1.1 - 0.9 * byte(more, 1)));
        colour = mix(colour, lit(cloth, folds), 0.85 * outside);
    }
    if bits & 32 != 0 {
        let slats = 0.8 + 0.2 * spot.bars_v(0.06, 0.04) + 0.15 * noise(spot.u * 1.5, spot.v * 4.0, bits);
        let blind = pick([[0.78, 0.75, 0.66], [0.6, 0.62, 0.66], [0.72, 0.6, 0.44]], more);
        colour = mix(colour, lit(blind, slats), spot.in_v(open * high, high + 1.0));
    }
    // above a slanting roof line the sky is reflected, below it another wall
    let roof = spot.above(high * (0.15 + 0.8 * byte(more, 0)), 2.4 * (byte(more, 3) - 0.5));
    let shine = (0.1 + 0.3 * byte(bits, 1)) * (0.35 + 0.65 * roof);
    colour = mix(colour, [0.66, 0.74, 0.82], shine);
    let cross = if bits & 64 != 0 { 0.68 * high } else { 0.5 * high };
    let upright = spot.in_u(-0.035, 0.035);
    let level = spot.in_v(cross - 0.03, cross + 0.03);
    mix(colour, [0.88, 0.87, 0.84], greater(upright, level))
}

/// A plant in its pot, or what looks like it.
fn on_sill(behind: Colour, half: f32, bits: u32, more: u32, spot: &Spot) -> Colour {
    let (u, size) = (half * (1.6 * byte(more, 2) - 0.8), 0.06 + 0.12 * byte(more, 3));
    let tone = bits.wrapping_mul(0x85eb_ca6b);
    let thing: Colour = std::array::from_fn(|c| 0.15 + 0.7 * byte(tone, c as u32));
    let pot = spot.in_rectangle((u - 0.7 * size, u + 0.7 * size), (0.0, 1.3 * size));
    let colour = mix(behind, [0.5, 0.28, 0.18], pot);
    let colour = mix(colour, thing, spot.in_disc(u + 0.3 * size, 2.0 * size, size));
    mix(colour, thing, spot.in_disc(u - 0.6 * size, 3.0 * size, 0.7 * size))
}

/// Bays of shops, doors and walls with posters.
fn ground_floor(house: &House, salt: u32, width: f32, spot: &Spot) -> Colour {
    let bays = greater(floor(width * (1.0 / 3.4)) as f32, 1.0);
    let bay_m = width / bays;
    let bay = floor(spot.u / bay_m).clamp(0, bays as i32 - 1);
    let bits = hash(bay, 99, salt);
    let middle = (bay as f32 + 0.5) * bay_m;
    let here = spot.about(middle, 0.0);
    match bits % 4 {
        0 => poster(painted(wall(house, salt, spot), bits, &here), bits, &here),
        1 => door(wall(house, salt, spot), house, bits, &here),
        _ => shop(house, salt, bits, 0.5 * bay_m - 0.25, spot, middle),
    }
}

fn shop(house: &House, salt: u32, bits: u32, half: f32, on_wall: &Spot, middle: f32) -> Colour {
    let spot = &on_wall.about(middle, 0.0);
    let wood = pick([[0.22, 0.3, 0.26], [0.36, 0.2, 0.16], [0.2, 0.22, 0.3], [0.75, 0.72, 0.66]], bits >> 4);
    let front = spot.in_rectangle((-half - 0.1, half + 0.1), (0.45, 3.3));
    let pane = spot.in_rectangle((-half, half), (0.6, 2.4));
    if pane >= 1.0 {
        return shop_window(bits, half, wood, spot);
    }
    let worn = lit(wood, 1.0 + 0.3 * mottle(spot, 0.7, bits));
    let mut colour = if front >= 1.0 { worn } else { mix(wall(house, salt, on_wall), worn, front) };
    if pane > 0.0 {
        colour = mix(colour, shop_window(bits, half, wood, spot), pane);
    }
    let board = spot.in_rectangle((-half, half), (2.5, 3.25));
    if board > 0.0 {
        let ground =
            pick([house.trim, [0.16, 0.2, 0.4], [0.5, 0.12, 0.12], [0.9, 0.8, 0.3], [0.12, 0.3, 0.2]], bits >> 9);
        let ink = if ground[0] + ground[1] > 1.0 { [0.12, 0.1, 0.1] } else { [0.95, 0.92, 0.82] };
        let text = letters(&spot.about(-0.85 * half, 2.62), 1.7 * half, 0.5, bits);
        let faded = 1.0 + 0.25 * noise(spot.u * 2.0, spot.v * 3.0, bits);
        colour = mix(colour, lit(mix(ground, ink, text), faded), board);
    }
    colour
}

/// Goods of all sizes and colours on shelves, a bill on the pane, and what it reflects.
fn shop_window(bits: u32, half: f32, wood: Colour, spot: &Spot) -> Colour {
    let mut colour = lit([0.2, 0.19, 0.18], 0.8 + 0.5 * byte(bits, 1));
    let kept = kept(spot.widest(), 0.3);
    if kept > 0.0 {
        let shelf_m = 0.42 + 0.2 * byte(bits, 2);
        let (i, j) = (floor((spot.u + 40.0) * (1.0 / 0.34)), floor((spot.v - 0.65) / shelf_m));
        let goods = hash(i, j, bits);
        let on_shelf = spot.about(0.34 * i as f32 - 40.0, 0.65 + shelf_m * j as f32);
        let (left, right) = (0.02 + 0.12 * byte(goods, 0), 0.32 - 0.1 * byte(goods, 1));
        let tall = shelf_m * (0.3 + 0.55 * byte(goods, 2));
        let bright: Colour = std::array::from_fn(|c| 0.15 + 0.65 * byte(goods.wrapping_mul(0x9e37_79b1), c as u32));
        let share = if goods & 0x7000_0000 == 0 { 0.0 } else { on_shelf.in_rectangle((left, right), (0.0, tall)) };
        let label = on_shelf.in_rectangle((left + 0.04, right - 0.03), (0.3 * tall, 0.6 * tall));
        let label_tone = [byte(goods, 3), 0.9 - 0.8 * byte(goods, 0), byte(goods, 2)];
        colour = mix(colour, mix(bright, label_tone, label), kept * share);
        colour = mix(colour, lit(wood, 0.8), kept * on_shelf.in_v(0.0, 0.03));
    }
    let at = (half - 0.4) * (2.0 * byte(bits, 3) - 1.0);
    let bill = spot.in_rectangle((at - 0.2, at + 0.2), (1.5, 2.05));
    if bill > 0.0 {
        let text = letters(&spot.about(at - 0.16, 1.78), 0.34, 0.15, bits ^ 0x33);
        colour = mix(colour, mix([0.92, 0.9, 0.84], [0.6, 0.1, 0.12], text), bill);
    }
    let roof = spot.above(1.0 + 1.2 * byte(bits, 0), 1.4 * (byte(bits, 2) - 0.5));
    let reflected = 0.1 + 0.16 * roof + 0.3 * greater(noise(spot.u * 1.3, spot.v * 1.3, bits), 0.0);
    colour = mix(colour, [0.6, 0.66, 0.72], clamp(reflected));
    mix(colour, wood, spot.in_u(0.3 * half - 0.04, 0.3 * half + 0.04))
}

fn door(wall: Colour, house: &House, bits: u32, spot: &Spot) -> Colour {
    let wood = pick([[0.4, 0.24, 0.14], [0.16, 0.26, 0.36], [0.45, 0.1, 0.12], [0.2, 0.3, 0.2]], bits >> 6);
    let mut colour = mix(wall, house.trim, spot.in_rectangle((-0.72, 0.72), (0.0, 2.85)));
    let leaf = spot.in_rectangle((-0.55, 0.55), (0.1, 2.2));
    if leaf > 0.0 {
        let grain = lit(wood, 1.0 + 0.3 * noise(spot.u / 0.05, spot.v / 0.6, bits) * kept(spot.w_u, 0.1));
        colour = mix(colour, lit(grain, 1.0 + 0.4 * mottle(spot, 0.6, bits)), leaf);
        let panels = spot.folded();
        let split = 0.6 + 0.8 * byte(bits, 2);
        for (low, high) in [(0.25, split), (split + 0.15, 2.05)] {
            colour = mix(colour, lit(grain, 0.7), panels.in_rectangle((0.08, 0.45), (low, high)));
        }
    }
    colour = mix(colour, GLASS, spot.in_rectangle((-0.55, 0.55), (2.3, 2.72)));
    colour = mix(colour, [0.85, 0.7, 0.3], spot.in_disc(0.46, 1.03, 0.05));
    // number and letter box beside it
    let plate = spot.in_rectangle((0.85, 1.15), (1.6, 1.85));
    let digits = letters(&spot.about(0.89, 1.64), 0.24, 0.17, bits);
    colour = mix(colour, mix([0.15, 0.2, 0.5], [0.95, 0.95, 0.95], digits), plate);
    mix(colour, [0.3, 0.3, 0.32], spot.in_rectangle((-1.25, -0.9), (1.1, 1.5)))
}

/// Lines of spray paint on a wall.
fn painted(wall: Colour, bits: u32, spot: &Spot) -> Colour {
    let field = mottle(spot, 1.3, bits ^ 0x19);
    let line = clamp(1.3 - (field - 0.1).abs() / greater(0.05, 0.8 * spot.widest()));
    let bright = pick([[0.2, 0.3, 0.75], [0.8, 0.2, 0.3], [0.15, 0.15, 0.16], [0.2, 0.6, 0.4]], bits >> 11);
    mix(wall, bright, 0.8 * line * spot.in_rectangle((-1.5, 1.5), (0.5, 1.9)) * kept(spot.widest(), 0.3))
}

fn poster(wall: Colour, bits: u32, spot: &Spot) -> Colour {
    let mut colour = wall;
    for k in 0..3_u32 {
        let bits = hash(k as i32, 7, bits);
        let (left, low) = (-1.5 + 1.05 * k as f32 + 0.2 * byte(bits, 0), 0.7 + 0.8 * byte(bits, 1));
        let size = [0.55 + 0.35 * byte(bits, 2), 0.8 + 0.5 * byte(bits, 3)];
        let paper = spot.in_rectangle((left, left + size[0]), (low, low + size[1]));
        if paper > 0.0 && bits & 3 != 0 {
            let ground: Colour = std::array::from_fn(|c| 0.35 + 0.6 * unit(bits.wrapping_mul(5 + 6 * c as u32)));
            let ink: Colour = std::array::from_fn(|c| 0.5 * unit(bits.wrapping_mul(9 + 4 * c as u32)));
            let text = letters(&spot.about(left + 0.08, low + 0.1), size[0] - 0.16, 0.18, bits);
            let above = spot.about(left, low + 0.36);
            let picture = clamp(4.0 * mottle(&above, 0.4, bits));
            let picture = picture * above.in_rectangle((0.08, size[0] - 0.08), (0.0, size[1] - 0.44));
            // torn off along one corner
            let torn = 1.0 - spot.about(left, low).above(size[1] * (0.75 + byte(bits, 1)), 2.0 * byte(bits, 2) - 1.0);
            colour = mix(colour, mix(ground, ink, greater(text, picture)), paper * torn);
        }
    }
    colour
}

/// A line of writing from its lower left corner: letters of 3 by 5 random bits.
fn letters(spot: &Spot, width: f32, height: f32, salt: u32) -> f32 {
    let letter_m = 0.72 * height;
    let letter = floor(spot.u / letter_m);
    if letter < 0 || (letter + 1) as f32 * letter_m > width || spot.v < 0.0 || spot.v > height {
        return 0.0;
    }
    let bits = hash(letter, 3, salt) | 0x0421;
    let (bit_u, bit_v) = (letter_m / 4.0, height / 5.0);
    let u = spot.u - letter as f32 * letter_m;
    let (i, j) = (floor(u / bit_u).clamp(0, 3), floor(spot.v / bit_v).clamp(0, 4));
    let cell = spot.at(u - i as f32 * bit_u, spot.v - j as f32 * bit_v);
    let is_ink = i < 3 && bits >> (3 * j + i) & 1 == 1;
    let share = cell.in_rectangle((0.0, bit_u), (0.0, bit_v));
    let fade = kept(spot.widest(), 2.0 * bit_u);
    0.35 * (1.0 - fade) + fade * if is_ink { share } else { 0.0 }
}

/// The ground: carriageways with markings, kerbs, pavements of slabs. Coordinates are the world's x and y.
pub(super) fn ground(spot: &Spot) -> Colour {
    let from_middle = |x: f32, block: f32| x - block * floor(x * (1.0 / block) + 0.5) as f32;
    let [x, y] = [from_middle(spot.u, BLOCK_M[0] as f32), from_middle(spot.v, BLOCK_M[1] as f32)];
    let here = spot.at(x, y);
    let [old, fine] = scales(spot, 5.0, 11);
    let rough = 0.4 * old + 0.5 * fine;
    let (carriageway, kerb) = road(&here);
    let mut colour = [0.0; 3];
    if carriageway > 0.0 {
        colour = lit(asphalt(spot, &here, rough, old), carriageway);
    }
    if kerb > 0.0 {
        let joints = lesser(spot.bars_u(0.9, 0.03) + spot.bars_v(0.9, 0.03), 1.0);
        let stone = 1.0 + 0.4 * rough - 0.4 * joints + 0.16 * tint(spot, 0.9, 0.9, 15);
        colour = std::array::from_fn(|c| colour[c] + kerb * stone * [0.66, 0.65, 0.62][c]);
    }
    let rest = 1.0 - carriageway - kerb;
    if rest > 0.0 {
        let slab = pavement(spot, rough, old);
        colour = std::array::from_fn(|c| colour[c] + rest * slab[c]);
    }
    // less sky lights the ground beside a house
    let to_wall = HOUSES_M as f32 - lesser(x.abs(), y.abs());
    lit(specks(colour, spot), 1.0 - 0.3 * clamp(1.0 - to_wall * (1.0 / 0.7)))
}

/// Shares of the carriageway and of the kerb, from the nearest middles of streets.
fn road(here: &Spot) -> (f32, f32) {
    let kerb_m = KERB_M as f32;
    let nearest = lesser(here.u.abs() - 0.5 * here.w_u, here.v.abs() - 0.5 * here.w_v);
    if nearest > kerb_m + 0.18 {
        return (0.0, 0.0);
    }
    let within = |half: f32| {
        let (a, b) = (here.in_u(-half, half), here.in_v(-half, half));
        a + b - a * b
    };
    let carriageway = within(kerb_m);
    (carriageway, if carriageway < 1.0 { greater(within(kerb_m + 0.18) - carriageway, 0.0) } else { 0.0 })
}

/// Asphalt with repairs, cracks, markings and covers; `here` is the place relative to the nearest middles of streets.
fn asphalt(spot: &Spot, here: &Spot, rough: f32, old: f32) -> Colour {
    let mut colour = lit([0.3, 0.3, 0.31], 1.0 + 0.6 * rough + 0.25 * old);
    // a repair somewhere in each cell, with a seam of tar
    let (i, j) = (floor(spot.u * (1.0 / 4.6)), floor(spot.v * (1.0 / 3.1)));
    let bits = hash(i, j, 5);
    let patch = spot.about(4.6 * i as f32, 3.1 * j as f32);
    let (u, v) = (0.2 + 1.6 * byte(bits, 0), 0.2 + byte(bits, 1));
    let (to_u, to_v) = (u + 0.5 + 2.0 * byte(bits, 2), v + 0.4 + 1.2 * byte(bits, 3));
    let seam = patch.in_rectangle((u - 0.04, to_u + 0.04), (v - 0.04, to_v + 0.04));
    if seam > 0.0 {
        let inner = patch.in_rectangle((u, to_u), (v, to_v));
        colour = lit(colour, 1.0 - 0.45 * (seam - inner));
        colour = lit(colour, 1.0 + inner * (0.55 * byte(bits.wrapping_mul(0x9e37_79b1), 3) - 0.32));
    }
    colour = lit(colour, 1.0 - 0.6 * crack(old, 0.02, 0.012, spot));
    colour = lit(colour, 1.0 - 0.35 * clamp(8.0 * (old - 0.45)));
    let (i, j) = (floor(spot.u * (1.0 / 6.0)), floor(spot.v * (1.0 / 3.0)));
    let bits = hash(i, j, 21);
    if bits & 3 == 0 {
        let (u, v) = (6.0 * i as f32 + 1.0 + 4.0 * byte(bits, 1), 3.0 * j as f32 + 1.5);
        let rim = spot.in_disc(u, v, 0.42);
        if rim > 0.0 {
            let iron = lit([0.24, 0.22, 0.2], 1.0 + 0.6 * tint(&spot.about(u, v), 0.09, 0.09, bits) + 0.4 * rough);
            colour = mix(mix(colour, [0.42, 0.41, 0.4], rim), iron, spot.in_disc(u, v, 0.34));
        }
    }
    let along_x = spot.at(spot.u, here.v);
    let along_y = spot.at(here.u, spot.v).exchanged();
    let paint = greater(markings(&along_x, here.u), markings(&along_y, here.v));
    if paint > 0.0 { mix(colour, [0.86, 0.86, 0.83], paint * clamp(0.85 + 0.25 * rough)) } else { colour }
}

/// Dashes in the middle, away from crossings, and a zebra before each; `along` is counted from the nearest crossing.
fn markings(spot: &Spot, along: f32) -> f32 {
    let away = spot.at(along, spot.v);
    let middle = spot.in_v(-0.06, 0.06);
    let mut paint = if middle > 0.0 { middle * spot.bars_u(6.0, 3.0) * (1.0 - away.in_u(-10.0, 10.0)) } else { 0.0 };
    let zebra = away.folded().in_u(5.2, 8.2);
    if zebra > 0.0 {
        let half = KERB_M as f32 - 0.3;
        paint = greater(paint, zebra * spot.bars_v(1.0, 0.5) * spot.in_v(-half, half));
    }
    paint
}

/// Rows of slabs, each row laid as it came.
fn pavement(spot: &Spot, rough: f32, old: f32) -> Colour {
    let row = floor(spot.v * 2.0);
    let laid = hash(row, 0, 31);
    let long = 0.5 + 0.5 * byte(laid, 0);
    let shifted = spot.about(long * byte(laid, 1), 0.0);
    let (joint_u, joint_v) = (shifted.bars_u(long, 0.016) * kept(spot.w_v, 0.5), spot.bars_v(0.5, 0.016));
    let joints = joint_u + joint_v - joint_u * joint_v;
    let slab = floor(shifted.u / long);
    let share = shifted.in_u(slab as f32 * long, (slab + 1) as f32 * long)
        * spot.in_v(0.5 * row as f32, 0.5 * (row + 1) as f32);
    let share = greater(2.0 * share - 1.0, 0.0);
    let bits = hash(slab, row, 32);
    let tone = 0.32 * (byte(bits, 0) - 0.5) * share;
    // some were replaced, by others or by asphalt
    let stone = match bits >> 27 {
        0 => mix([0.56, 0.54, 0.51], [0.27, 0.27, 0.28], share),
        1 | 2 => mix([0.56, 0.54, 0.51], [0.58, 0.45, 0.38], share),
        _ => [0.56, 0.54, 0.51],
    };
    let cracked = crack(old, 0.06, 0.007, spot);
    let stain = clamp(7.0 * (old - 0.3));
    lit(stone, 1.0 + 0.4 * rough + tone - 0.55 * greater(joints, 0.8 * cracked) - 0.22 * stain)
}

/// Leaves, gum and litter.
fn specks(ground: Colour, spot: &Spot) -> Colour {
    let width = spot.widest();
    let mut colour = ground;
    for (cell, salt) in [(0.23, 41), (0.57, 42)] {
        let share = kept(width, 0.35 * cell);
        if share > 0.0 {
            let (i, j) = (floor(spot.u * (1.0 / cell)), floor(spot.v * (1.0 / cell)));
            let bits = hash(i, j, salt);
            // a leaf is a disc that is pressed flat along some direction
            let place = |at: i32, bits: f32| cell * (at as f32 + 0.3 + 0.4 * bits);
            let leaf = spot.about(place(i, byte(bits, 0)), place(j, byte(bits, 1)));
            let (slant, size) = (2.0 * byte(bits, 2) - 1.0, byte(bits, 3));
            let leaf = leaf.at(leaf.u + slant * leaf.v, leaf.v - slant * leaf.u);
            let leaf = if bits & 1 == 0 { leaf.at(1.6 * leaf.u, leaf.v) } else { leaf };
            let dot = leaf.in_disc(0.0, 0.0, cell * (0.02 + 0.11 * size * size));
            if dot > 0.0 {
                let tone = pick([[0.2, 0.18, 0.16], [0.6, 0.42, 0.16], [0.75, 0.74, 0.7], [0.36, 0.34, 0.16]], bits);
                colour = mix(colour, tone, 0.8 * share * dot);
            }
        }
    }
    colour
}

/// A car's side (`end` false) or end: `u` from its middle, towards its front where that is seen.
pub(super) fn car(paint: Colour, end: bool, cabin: bool, seed: u32, spot: &Spot) -> Colour {
    let dust = 0.3 * mottle(spot, 1.1, seed);
    let mut colour = lit(paint, 0.76 + 0.2 * byte(seed, 0) + 0.25 * spot.v * (1.0 / 1.4) + 0.5 * dust);
    if cabin {
        let half = if end { 0.64 } else { 3.0 };
        let pillars = if end { 0.0 } else { spot.in_u(-0.4, -0.3) };
        let pane = spot.in_rectangle((-half, half), (0.93, 1.36)) * (1.0 - pillars);
        let roof = spot.above(1.0 + 0.3 * byte(seed, 1), 0.5 * byte(seed, 2) - 0.25);
        let sky = clamp(0.22 + 0.4 * (spot.v - 0.9) + 0.22 * roof + dust);
        let seat = spot.in_rectangle((0.1, 0.35), (0.9, 1.2)) + spot.in_rectangle((-0.75, -0.5), (0.9, 1.2));
        return mix(colour, mix(lit(GLASS, 1.0 - 0.6 * seat), [0.7, 0.78, 0.85], sky), pane);
    }
    colour = mix(colour, [0.06, 0.06, 0.07], spot.in_v(-1.0, 0.2));
    // mud above the sill
    colour = mix(colour, [0.36, 0.32, 0.27], spot.in_v(0.15, 0.2 + 0.35 * byte(seed, 3)) * clamp(0.45 + 2.0 * dust));
    if end {
        let lamps = spot.folded().in_rectangle((0.5, 0.78), (0.55, 0.72));
        let plate = spot.in_rectangle((-0.26, 0.26), (0.36, 0.48));
        let digits = letters(&spot.about(-0.23, 0.375), 0.46, 0.09, seed);
        colour = mix(mix(colour, [0.9, 0.88, 0.75], lamps), [0.93, 0.92, 0.85], plate);
        return mix(colour, [0.1, 0.1, 0.1], digits * plate);
    }
    for (wheel, bits) in [(-1.3, seed), (1.3, seed >> 9)] {
        let tyre = spot.in_disc(wheel, 0.32, 0.33);
        if tyre > 0.0 {
            // spokes stand as they stopped
            let (u, v) = (spot.u - wheel, spot.v - 0.32);
            let (a, b) = (byte(bits, 0) - 0.5, byte(bits, 1) - 0.5);
            let spoke = clamp(1.2 - (a * u + b * v).abs() / greater(0.03, spot.widest()));
            let rim = lit([0.6, 0.6, 0.62], 1.0 - 0.5 * spoke);
            colour = mix(mix(colour, [0.09, 0.09, 0.1], tyre), rim, spot.in_disc(wheel, 0.32, 0.19));
        }
    }
    let seams = lesser(spot.in_u(-0.35, -0.335) + spot.in_u(0.75, 0.765), 1.0);
    lit(colour, 1.0 - 0.6 * seams * spot.in_v(0.3, 0.88))
}

/// A car from above.
pub(super) fn car_top(paint: Colour, seed: u32, spot: &Spot) -> Colour {
    lit(paint, 0.86 + 0.2 * byte(seed, 0) + 0.2 * mottle(spot, 0.9, seed))
}

/// Striped cloth, faded and stained.
pub(super) fn awning(paint: Colour, seed: u32, spot: &Spot) -> Colour {
    let wide = 0.3 + 0.4 * byte(seed, 0);
    let stripes = spot.about(byte(seed, 1), 0.0).bars_u(wide, 0.5 * wide);
    lit(mix(paint, [0.92, 0.9, 0.84], stripes), 0.95 + 0.3 * mottle(spot, 1.1, seed))
}

/// Bark or painted metal round a post, with bills on some.
pub(super) fn post(colour: Colour, seed: u32, spot: &Spot) -> Colour {
    let rings = spot.bars_v(0.7, 0.04);
    let bark = lit(colour, 1.0 + 0.6 * mottle(spot, 0.12, seed) + 0.4 * mottle(spot, 1.1, seed ^ 9) - 0.3 * rings);
    if seed & 1 == 0 {
        return bark;
    }
    let bill = spot.in_v(1.1 + 0.5 * byte(seed, 1), 1.3 + 0.8 * byte(seed, 2));
    mix(bark, lit([0.85, 0.82, 0.7], 1.0 + 0.6 * noise(spot.u * 20.0, spot.v * 16.0, seed)), bill)
}

/// Leaves of a crown, or a lamp's globe (seed 0), at a point of the world.
pub(super) fn ball(colour: Colour, seed: u32, at: &Vector<3>, width: f32) -> Colour {
    if seed == 0 {
        return colour;
    }
    let [x, y, z] = at.map(|x| x as f32);
    let on = |u: f32, v: f32| Spot::new(u, v, width, width);
    let (p, q) = (on(x + 0.6 * z, y - 0.7 * z), on(x - y, z + 0.5 * y));
    let leaves = mottle(&p, 0.17, 61) + mottle(&q, 0.31, 62);
    lit(colour, greater(0.85 + 1.2 * leaves, 0.15))
}

/// Blue with clouds, and haze at the horizon; it does not move with the camera.
pub(super) fn sky(along: &Vector<3>, delta: f64) -> Colour {
    let [x, y, height] = along.map(|x| x as f32);
    let height = greater(height, 0.0);
    let blue = mix(HAZE, [0.3, 0.5, 0.82], lesser(1.6 * height, 1.0));
    let flat = 1.0 / (height + 0.22);
    let width = delta as f32 * flat;
    let cloud = clamp(1.7 * mottle(&Spot::new(x * flat, y * flat, width, width), 0.45, 71) - 0.02);
    let cloud = cloud * lesser(6.0 * height, 1.0);
    mix(blue, lit([0.96, 0.96, 0.97], 1.0 - 0.25 * cloud), cloud)
}

/// What everything fades to with distance.
pub(super) const HAZE: Colour = [0.78, 0.82, 0.87];

/// The operator: cloth, in the camera's own directions.
pub(super) fn operator(bearing: &Vector<3>, delta: f64) -> Colour {
    let [x, y, z] = bearing.map(|x| x as f32);
    let flat = 1.0 / (y.abs() + 0.6);
    let spot = Spot::new(x * flat, z * flat, delta as f32, delta as f32);
    let folds = detail(&spot, 0.3, 81);
    let shirt = mix([0.16, 0.18, 0.3], [0.5, 0.16, 0.14], spot.bars_v(0.12, 0.05));
    let skin = spot.in_disc(0.0, 0.0, 0.22);
    mix(lit(shirt, 1.0 + 0.5 * folds), lit([0.36, 0.25, 0.18], 1.0 + 0.8 * folds), skin)
}
