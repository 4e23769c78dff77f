//! Cars and people that move through a world, each with tracks of its own.
//!
//! A body keeps its shape and its orientation. It meets one view: at that time it is abreast of it, give or take, and
//! from there every point of it follows `P(t) = P(t_meet) + v (t - t_meet) + a (t - t_meet)^2 / 2`. Cars drive along
//! the path of the views, in either direction; people walk anywhere, and half of them turn.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::ops::Range;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::layout::{CARRIED_AT_M, direction};
use super::measure::{Stream, stream};
use super::{Motion, WorldKind, WorldOptions, window};
use crate::geometry::{Vector, add, dot, norm, scale, sub};

/// Share of the bodies that are cars.
const CARS: f64 = 0.5;
const CAR_SPEED_M_S: (f64, f64) = (3.0, 14.0);
const WALKING_SPEED_M_S: (f64, f64) = (1.0, 2.0);
/// Rate at which people turn: their acceleration is this times their speed, across their way.
const TURNING_RAD_S: (f64, f64) = (0.02, 0.08);
/// They are seen until their velocity has changed by this share, which turns them by 37 degrees.
const TURNED: f64 = 0.75;
/// How far to the side a body passes the view that it meets, and how far ahead or behind it is at that time.
const BESIDE_M: (f64, f64) = (3.0, 9.0);
const AHEAD_M: f64 = 8.0;
/// Length, width and height of what carries the tracks; its lowest point above the ground.
const CAR_M: [f64; 3] = [4.4, 1.8, 1.3];
const PERSON_M: [f64; 3] = [0.5, 0.5, 1.7];
/// Bodies are seen from no farther than this.
const CAR_SEEN_M: f64 = 60.0;
const PERSON_SEEN_M: f64 = 30.0;
/// A path of order two takes five rays in the plane. One more shows whether it fits.
const FEWEST_VIEWS: usize = 6;
/// Nothing drives through the camera: a body that would come nearer is drawn again, this many times.
const CLEAR_M: f64 = 2.0;
const TRIES: usize = 30;

struct Body<const D: usize> {
    /// Middle of the body when it meets its view.
    position: Vector<D>,
    /// The way it faces.
    forward: Vector<D>,
    velocity: Vector<D>,
    acceleration: Vector<D>,
    meets_s: f64,
    size_m: [f64; 3],
    /// The views that are near it, and the one that it meets.
    near: Range<usize>,
    meets: usize,
}

impl<const D: usize> Body<D> {
    fn displacement(&self, time_s: f64) -> Vector<D> {
        let since_s = time_s - self.meets_s;
        add(&scale(since_s, &self.velocity), &scale(0.5 * since_s * since_s, &self.acceleration))
    }

    fn distance(&self, center: &Vector<D>, time_s: f64) -> f64 {
        norm(&sub(&add(&self.position, &self.displacement(time_s)), center))
    }
}

/// One track on a body.
pub(super) struct Ride<const D: usize> {
    /// The views that see it.
    pub views: Range<usize>,
    /// The middle of the time that it is seen, and where it is then.
    pub time_s: f64,
    pub point: Vector<D>,
    pub motion: Motion<D>,
}

/// All bodies of a world, from which tracks are drawn.
pub(super) struct Traffic<'a, const D: usize> {
    bodies: Vec<Body<D>>,
    time_s: &'a [f64],
    /// Fewest and most views of a track.
    window: (usize, usize),
    rng: ChaCha8Rng,
}

impl<'a, const D: usize> Traffic<'a, D> {
    pub(super) fn new(kind: WorldKind, o: &WorldOptions, centers: &[Vector<D>], time_s: &'a [f64]) -> Self {
        let (fewest, most) = window(kind, o);
        let fewest = fewest.max(FEWEST_VIEWS).min(most);
        let mut rng = stream(o.seed, Stream::Bodies);
        let bodies = (0..o.n_bodies).map(|_| draw(centers, time_s, fewest, &mut rng)).collect();
        Self { bodies, time_s, window: (fewest, most), rng }
    }

    /// Draws a track. Called for every track of the world, moving or not: more movers keep the ones there were.
    pub(super) fn ride(&mut self) -> Ride<D> {
        let (fewest, most) = self.window;
        let which = self.rng.random_range(0..self.bodies.len());
        let body = &self.bodies[which];
        let within: [f64; 3] = std::array::from_fn(|c| body.size_m[c] * self.rng.random_range(-0.5..0.5));
        let share: f64 = self.rng.random();
        let anchor = self.rng.random_range(body.near.clone());
        let room = body.near.len().min(most);
        let count = (fewest + ((room + 1 - fewest) as f64 * share) as usize).min(room);
        let start = anchor.saturating_sub(count / 2).clamp(body.near.start, body.near.end - count);
        let time_s = 0.5 * (self.time_s[start] + self.time_s[start + count - 1]);
        let middle = add(&body.position, &body.displacement(time_s));
        let motion = Motion::Moves {
            body: which as u32,
            velocity: add(&body.velocity, &scale(time_s - body.meets_s, &body.acceleration)),
            acceleration: body.acceleration,
        };
        Ride { views: start..start + count, time_s, point: add(&middle, &facing(&body.forward, within)), motion }
    }
}

/// A vector given by its parts forward, to the left and up.
fn facing<const D: usize>(forward: &Vector<D>, part: [f64; 3]) -> Vector<D> {
    let left = left_of(forward);
    std::array::from_fn(|c| if c < 2 { part[0] * forward[c] + part[1] * left[c] } else { part[2] })
}

fn left_of<const D: usize>(forward: &Vector<D>) -> Vector<D> {
    std::array::from_fn(|c| match c {
        0 => -forward[1],
        1 => forward[0],
        _ => 0.0,
    })
}

fn draw<const D: usize>(centers: &[Vector<D>], time_s: &[f64], fewest: usize, rng: &mut ChaCha8Rng) -> Body<D> {
    let mut body = draw_once(centers, time_s, fewest, rng);
    for _ in 1..TRIES {
        if body.near.clone().all(|view| body.distance(&centers[view], time_s[view]) > CLEAR_M + 0.5 * body.size_m[0]) {
            break;
        }
        body = draw_once(centers, time_s, fewest, rng);
    }
    body
}

fn draw_once<const D: usize>(centers: &[Vector<D>], time_s: &[f64], fewest: usize, rng: &mut ChaCha8Rng) -> Body<D> {
    let meets = rng.random_range(0..centers.len());
    let street = along(centers, meets);
    let ahead = rng.random_range(-AHEAD_M..AHEAD_M);
    let beside = side(rng) * uniform(BESIDE_M, rng);
    let mut position = add(&centers[meets], &facing(&street, [ahead, beside, 0.0]));
    let is_car = rng.random_bool(CARS);
    let (speed, anywhere) = (rng.random::<f64>(), direction(rng.random_range(0.0..TAU), 0.0));
    let (way, turns, turning) = (side(rng), rng.random::<bool>(), side(rng) * uniform(TURNING_RAD_S, rng));
    let forward = if is_car { scale(way, &street) } else { anywhere };
    let range = if is_car { CAR_SPEED_M_S } else { WALKING_SPEED_M_S };
    let velocity = scale(range.0 + (range.1 - range.0) * speed, &forward);
    let turning = if is_car || !turns { 0.0 } else { turning };
    let size_m = if is_car { CAR_M } else { PERSON_M };
    if D == 3 {
        // wheels and shoes touch the ground that the camera is carried above
        position[2] = centers[meets][2] - CARRIED_AT_M + if is_car { 0.2 } else { 0.0 } + 0.5 * size_m[2];
    }
    let acceleration = scale(turning, &left_of(&velocity));
    let meets_s = time_s[meets];
    let mut body = Body { position, forward, velocity, acceleration, meets_s, size_m, near: 0..0, meets };
    body.near = near_views(&body, centers, time_s, fewest, if is_car { CAR_SEEN_M } else { PERSON_SEEN_M });
    body
}

/// The run of views about the meeting from which the body is near; at least `fewest`.
fn near_views<const D: usize>(
    body: &Body<D>,
    centers: &[Vector<D>],
    time_s: &[f64],
    fewest: usize,
    seen_m: f64,
) -> Range<usize> {
    let is_near = |view: &usize| {
        let since_s = (time_s[*view] - body.meets_s).abs();
        let has_turned = since_s * norm(&body.acceleration) > TURNED * norm(&body.velocity);
        !has_turned && body.distance(&centers[*view], time_s[*view]) <= seen_m
    };
    let after = (body.meets..centers.len()).take_while(is_near).count();
    let before = (0..body.meets).rev().take_while(is_near).count();
    let (mut start, mut end) = (body.meets - before, body.meets + after);
    while end - start < fewest.min(centers.len()) {
        start = start.saturating_sub(1);
        if end - start < fewest && end < centers.len() {
            end += 1;
        }
    }
    start..end
}

/// Horizontal direction of the path at a view.
fn along<const D: usize>(centers: &[Vector<D>], view: usize) -> Vector<D> {
    let (first, last) = (view.saturating_sub(2), (view + 2).min(centers.len() - 1));
    let step: Vector<D> = std::array::from_fn(|c| if c < 2 { centers[last][c] - centers[first][c] } else { 0.0 });
    let length = dot(&step, &step).sqrt();
    if length > 1e-9 { scale(1.0 / length, &step) } else { direction(FRAC_PI_2, 0.0) }
}

fn side(rng: &mut ChaCha8Rng) -> f64 {
    if rng.random() { 1.0 } else { -1.0 }
}

fn uniform(range: (f64, f64), rng: &mut ChaCha8Rng) -> f64 {
    rng.random_range(range.0..range.1)
}
