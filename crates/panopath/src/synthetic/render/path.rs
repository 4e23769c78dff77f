//! Where the camera is at a time, and how it is turned.
//!
//! Streets run along x and y, their middles at multiples of [`BLOCK_M`]; houses stand [`HOUSES_M`] from the middle. The
//! walk follows the pavement round the block between `(0, 0)` and `BLOCK_M`, anticlockwise, and wavers about that line.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::{WalkOptions, WalkPath, WalkRotation};
use crate::geometry::{Rotation, Vector};

/// From street to street, along x and along y.
pub(super) const BLOCK_M: [f64; 2] = [75.0, 52.0];
/// From the middle of a street to the kerb, and to the houses.
pub(super) const KERB_M: f64 = 4.0;
pub(super) const HOUSES_M: f64 = 8.0;
/// From the middle of a street to the line that is walked.
const WALKED_M: f64 = 5.9;
/// Radius of the turn at a corner.
const TURN_M: f64 = 3.0;
/// Where the straight walk and the lap begin.
const START_X_M: f64 = 14.0;
const CARRIED_AT_M: f64 = 1.65;

/// Length of a lap round the block.
pub(super) fn lap_m() -> f64 {
    2.0 * (straights()[0] + straights()[1]) + TAU * TURN_M
}

fn straights() -> [f64; 2] {
    BLOCK_M.map(|block| block - 2.0 * WALKED_M - 2.0 * TURN_M)
}

/// A place on the line that is walked: position, heading, and the side of the block, 0 to 3 from south anticlockwise.
pub(super) struct Place {
    pub at: [f64; 2],
    pub heading_rad: f64,
    pub side: usize,
}

/// The place after `walked_m` metres.
pub(super) fn place(o: &WalkOptions, walked_m: f64) -> Place {
    let first_corner = BLOCK_M[0] - WALKED_M - TURN_M;
    let straight_on = Place { at: [START_X_M + walked_m, WALKED_M], heading_rad: 0.0, side: 0 };
    match o.path {
        WalkPath::Straight => straight_on,
        WalkPath::Loop => round_the_block(START_X_M - WALKED_M - TURN_M + walked_m),
        WalkPath::Corner => {
            // the middle of the walk is the middle of the turn
            let to_corner = walked_m - 0.5 * o.length_m() + 0.5 * FRAC_PI_2 * TURN_M;
            if to_corner <= 0.0 {
                Place { at: [first_corner + to_corner, WALKED_M], ..straight_on }
            } else if to_corner <= FRAC_PI_2 * TURN_M {
                round_the_block(straights()[0] + to_corner)
            } else {
                let y = WALKED_M + TURN_M + to_corner - FRAC_PI_2 * TURN_M;
                Place { at: [BLOCK_M[0] - WALKED_M, y], heading_rad: FRAC_PI_2, side: 1 }
            }
        }
    }
}

/// The place `s` metres from the south-west corner, on the lap.
fn round_the_block(s: f64) -> Place {
    let mut rest = s.rem_euclid(lap_m());
    let (low, turn) = (WALKED_M + TURN_M, FRAC_PI_2 * TURN_M);
    // start of each side, and the centre of the turn at its end
    let far = BLOCK_M.map(|block| block - WALKED_M - TURN_M);
    let starts = [[low, WALKED_M], [BLOCK_M[0] - WALKED_M, low], [far[0], BLOCK_M[1] - WALKED_M], [WALKED_M, far[1]]];
    let turns = [[far[0], low], far, [low, far[1]], [low, low]];
    for side in 0..3 {
        let length = straights()[side % 2];
        if rest <= length + turn {
            return on_side(starts[side], turns[side], side, rest, length);
        }
        rest -= length + turn;
    }
    on_side(starts[3], turns[3], 3, rest, straights()[1])
}

fn on_side(start: [f64; 2], turn: [f64; 2], side: usize, rest: f64, length: f64) -> Place {
    let heading_rad = side as f64 * FRAC_PI_2;
    if rest <= length {
        let (sin, cos) = heading_rad.sin_cos();
        return Place { at: [start[0] + rest * cos, start[1] + rest * sin], heading_rad, side };
    }
    let heading_rad = heading_rad + (rest - length) / TURN_M;
    let (sin, cos) = heading_rad.sin_cos();
    Place { at: [turn[0] + TURN_M * sin, turn[1] - TURN_M * cos], heading_rad, side }
}

/// Centre and orientation of the camera at a time. `phase` are numbers in 0..1 that make walks differ.
pub(super) fn pose(o: &WalkOptions, time_s: f64, phase: &[f64; 8]) -> (Vector<3>, Rotation<3>) {
    let wave = |k: usize, hertz: f64| (TAU * (hertz * time_s + phase[k])).sin();
    let walked_m = o.speed_m_s * time_s;
    let Place { at, heading_rad, .. } = place(o, walked_m);
    let (sin, cos) = heading_rad.sin_cos();
    let wander = (TAU * (walked_m / 17.0 + phase[0])).sin();
    let left = 0.25 * wander + 0.03 * wave(1, 0.93);
    let up = 0.05 * (TAU * (walked_m / 23.0 + phase[2])).sin() + 0.02 * wave(3, 1.87);
    let center = [at[0] - left * sin, at[1] + left * cos, CARRIED_AT_M + up];
    let ahead = match o.rotation {
        WalkRotation::None => upright(0.0),
        WalkRotation::Sway => {
            let turn = [0.06 * wave(4, 0.31), 0.12 * wave(5, 0.17), 0.05 * wave(6, 0.93)];
            Rotation::exp(&turn).compose(&upright(heading_rad))
        }
        WalkRotation::Tumble => {
            let about_x = Rotation::exp(&[0.35 * time_s + 0.5 * wave(4, 0.07), 0.0, 0.0]);
            let about_y = Rotation::exp(&[0.0, 0.23 * time_s + TAU * phase[5], 0.0]);
            let about_z = Rotation::exp(&[0.0, 0.0, 0.6 * wave(6, 0.05)]);
            about_z.compose(&about_x).compose(&about_y).compose(&upright(heading_rad))
        }
    };
    (center, ahead)
}

/// `cam_from_world` of a camera held upright: z along the heading, x to its right, y down.
fn upright(heading_rad: f64) -> Rotation<3> {
    let (sin, cos) = heading_rad.sin_cos();
    let rows = [[sin, -cos, 0.0], [0.0, 0.0, -1.0], [cos, sin, 0.0]];
    Rotation::from_matrix(rows).unwrap_or_else(Rotation::identity)
}
