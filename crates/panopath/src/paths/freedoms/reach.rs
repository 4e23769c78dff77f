//! What the rays of one track tell of its path, the cameras held.
//!
//! The camera imitates a path where its own way, at the times of the track, lies in the span of the functions: then
//! `C + s (P - C)` is a path of that form for every `s`. How near it comes to that is measured by the part of its way that the
//! functions cannot express (the reconstructability of Park, Shiratori, Matthews and Sheikh, ECCV 2010), against what noise
//! makes of it.

use rayon::prelude::*;

use super::eliminate::{Eliminated, stretch, typical_length};
use super::part::position;
use super::system::System;
use super::{FreedomOptions, MovingScene};
use crate::geometry::{Vector, add, dot, norm, scale, sub};

/// A mode is no more than noise where its energy is below this multiple of what errors of the views give to an exact one.
const NOISE_MULTIPLE: f64 = 5.0;
/// Share of a weak mode that is drawn towards the camera, from which on it is called imitated.
const MOSTLY: f64 = 0.5;
/// Directions are one within this many standard deviations.
const ONE_DIRECTION: f64 = 5.0;
/// Tracks that one may hide behind, at most this many are tried.
const MOST_TRIED: usize = 64;

/// What the rays of a track tell, the cameras held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reach {
    /// Where it was, each time that it was seen.
    Determined,
    /// Nothing: it has no observation that counts.
    NotSeen,
    /// Too little: fewer observations, or times, than unknowns.
    TooFew,
    /// The camera moves in the form of the path.
    Imitated,
    /// It is in one direction with another track, whenever it is seen.
    Hidden,
    /// A point at rest whose views are on one line with it.
    InLine,
    /// There are other paths, for a reason without a name.
    Loose,
}

impl Reach {
    /// Name in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Determined => "determined",
            Self::NotSeen => "not_seen",
            Self::TooFew => "too_few",
            Self::Imitated => "imitated",
            Self::Hidden => "hidden",
            Self::InLine => "in_line",
            Self::Loose => "loose",
        }
    }
}

/// What the rays of a track tell of its path, the cameras held.
#[derive(Debug, Clone, PartialEq)]
pub struct TrackReach<const D: usize> {
    /// In a word.
    pub reason: Reach,
    /// That holds exactly, rather than as far as noise tells.
    pub is_exact: bool,
    /// Null vectors, or modes that noise moves too far.
    pub dimension: usize,
    /// The track that it hides behind, -1 = none.
    pub hidden_by: i32,
    /// Rms movement of its path at one standard deviation along its weakest mode, over its distance; infinite where that is free.
    pub movement: f64,
    /// Rms of the part of the camera's way, across the rays, that the functions cannot express; units of the scene.
    pub camera_part: f64,
    /// What noise is at the distance of the track; units of the scene.
    pub noise_part: f64,
    /// Displacements of its coefficients along these modes.
    pub null: Vec<Vec<Vector<D>>>,
}

/// All tracks, before any is looked at.
pub(super) fn unseen<const D: usize>(scene: &MovingScene<'_, D>) -> Vec<TrackReach<D>> {
    let nothing = TrackReach {
        reason: Reach::NotSeen,
        is_exact: true,
        dimension: 0,
        hidden_by: -1,
        movement: f64::INFINITY,
        camera_part: f64::NAN,
        noise_part: f64::NAN,
        null: Vec::new(),
    };
    vec![nothing; scene.forms.len()]
}

/// What there is to say of each track of a part, with its index in the scene.
pub(super) fn of_part<const D: usize>(
    system: &System<'_, D>,
    scene: &MovingScene<'_, D>,
    starts: &[usize],
    options: &FreedomOptions,
) -> Vec<(u32, TrackReach<D>)> {
    let looked = Looked { system, scene, starts, options };
    (0..system.part.tracks.len()).into_par_iter().map(|j| (system.part.tracks[j], looked.at(j))).collect()
}

struct Looked<'a, const D: usize> {
    system: &'a System<'a, D>,
    scene: &'a MovingScene<'a, D>,
    starts: &'a [usize],
    options: &'a FreedomOptions,
}

impl<const D: usize> Looked<'_, D> {
    fn at(&self, j: usize) -> TrackReach<D> {
        let (part, track) = (self.system.part, &self.system.tracks[j]);
        let n = part.observations(j).len() as f64;
        let far = typical_length(part, j);
        let exact = track.loose::<D>();
        let weak = (0..track.rank).rev().take_while(|&mode| self.is_noise(j, mode)).count();
        let is_exact = exact > 0 || weak == 0;
        let movement = match track.values.get(track.rank.wrapping_sub(1)) {
            Some(value) if exact == 0 => part.sigma / (value * n.sqrt() * far),
            _ => f64::INFINITY,
        };
        let mut found = TrackReach {
            reason: Reach::Determined,
            is_exact,
            dimension: if exact > 0 { exact } else { weak },
            hidden_by: -1,
            movement,
            camera_part: self.camera_part(j) * part.unit,
            noise_part: part.sigma * far * part.unit,
            null: Vec::new(),
        };
        if found.dimension > 0 {
            let first = if exact > 0 { track.rank } else { track.rank - weak };
            (found.reason, found.hidden_by) = self.reason(j, first, is_exact);
            found.null = null_vectors(track, first);
        }
        found
    }

    /// Does noise move the path too far along a mode, or make as much of an exact null vector?
    fn is_noise(&self, j: usize, mode: usize) -> bool {
        let (part, track) = (self.system.part, &self.system.tracks[j]);
        if part.sigma <= 0.0 {
            return false;
        }
        let (value, vector) = (track.values[mode], &track.vectors[mode]);
        let n = part.observations(j).len() as f64;
        if part.sigma > self.options.refuse_movement * value * n.sqrt() * typical_length(part, j) {
            return true;
        }
        let of_views = |(a, o): (usize, usize)| {
            let rate = part.gain[o] * stretch(part, o, &track.shift::<D>(vector, a));
            let held = &self.system.views[part.node[o] as usize];
            let free: f64 = (0..D)
                .map(|c| {
                    let axis = std::array::from_fn(|r| f64::from(u8::from(r == c)));
                    let along = part.ray[o][c];
                    let across = sub(&axis, &scale(along, &part.ray[o]));
                    dot(&across, &held.inverse_times(&across))
                })
                .sum();
            rate * rate * free
        };
        let expected: f64 = part.observations(j).enumerate().map(of_views).sum();
        value * value < NOISE_MULTIPLE * part.sigma * part.sigma * expected
    }

    /// The part of the camera's way, across the rays, that the functions cannot express.
    fn camera_part(&self, j: usize) -> f64 {
        let part = self.system.part;
        let way: Vec<Vector<D>> = part.observations(j).map(|o| part.center[part.node[o] as usize]).collect();
        let beyond = self.system.tracks[j].beyond(&way);
        let across = |(o, x): (usize, &Vector<D>)| dot(x, x) - dot(x, &part.ray[o]).powi(2);
        let sum: f64 = part.observations(j).zip(&beyond).map(across).sum();
        (sum.max(0.0) / way.len() as f64).sqrt()
    }

    fn reason(&self, j: usize, first: usize, is_exact: bool) -> (Reach, i32) {
        let (part, track) = (self.system.part, &self.system.tracks[j]);
        let rows = (D - 1) * part.observations(j).len();
        if !track.unseen.is_empty() || rows < D * part.n_functions(j) {
            return (Reach::TooFew, -1);
        }
        if part.n_functions(j) == 1 {
            return (Reach::InLine, -1);
        }
        if self.is_imitated(j, first, is_exact) {
            return (Reach::Imitated, -1);
        }
        match self.hider(j, is_exact) {
            Some(other) => (Reach::Hidden, other),
            None => (Reach::Loose, -1),
        }
    }

    /// Is drawing the path towards the camera one of the modes from `first` on?
    fn is_imitated(&self, j: usize, first: usize, is_exact: bool) -> bool {
        let (part, track) = (self.system.part, &self.system.tracks[j]);
        let segments: Vec<Vector<D>> = part.observations(j).map(|o| scale(part.length[o], &part.ray[o])).collect();
        let squared = |x: &[Vector<D>]| x.iter().map(|x| dot(x, x)).sum::<f64>();
        if is_exact {
            let limit = 10.0 * self.options.null_below;
            return squared(&track.beyond(&segments)) < limit * limit * squared(&segments);
        }
        let along = |vector: &Vec<f64>| {
            segments.iter().enumerate().map(|(a, u)| dot(u, &track.shift::<D>(vector, a))).sum::<f64>().powi(2)
        };
        track.vectors[first..].iter().map(along).sum::<f64>() > MOSTLY * squared(&segments)
    }

    /// Another track in one direction with this one at all of its times, towards which it can be drawn.
    fn hider(&self, j: usize, is_exact: bool) -> Option<i32> {
        let part = self.system.part;
        let noise = if is_exact { 0.0 } else { ONE_DIRECTION * part.sigma };
        let limit = f64::max(10.0 * self.options.null_below, noise);
        let first = part.start[j];
        let parallel = |a: &Vector<D>, b: &Vector<D>| dot(a, b) > 0.0 && norm(&sub(a, b)) <= limit;
        let near = part.of_node.of(part.node[first] as usize).iter().map(|&o| o as usize);
        let near = near.filter(|&o| part.owner[o] as usize != j && parallel(&part.ray[o], &part.ray[first]));
        near.take(MOST_TRIED)
            .map(|o| part.owner[o] as usize)
            .find(|&other| self.hides(other, j, limit))
            .map(|other| part.tracks[other] as i32)
    }

    fn hides(&self, other: usize, j: usize, limit: f64) -> bool {
        let part = self.system.part;
        let id = part.tracks[other] as usize;
        let mut values = Vec::new();
        let mut apart = Vec::with_capacity(part.observations(j).len());
        for o in part.observations(j) {
            let view = part.views[part.node[o] as usize] as usize;
            let coefficients = &self.scene.coefficients[self.starts[id]..];
            let place = position(&self.scene.forms[id], coefficients, self.scene.time_s[view], &mut values);
            let segment = scale(1.0 / part.unit, &sub(&place, &self.scene.centers[view]));
            let length = norm(&segment);
            if norm(&sub(&scale(1.0 / length, &segment), &part.ray[o])) > limit {
                return false;
            }
            apart.push(sub(&segment, &scale(part.length[o], &part.ray[o])));
        }
        let squared = |x: &[Vector<D>]| x.iter().map(|x| dot(x, x)).sum::<f64>();
        let beyond = self.system.tracks[j].beyond(&apart);
        squared(&beyond) <= limit * limit * squared(&apart).max(f64::MIN_POSITIVE)
    }
}

/// Displacements of the coefficients along the modes from `first` on, and along functions that were never seen.
fn null_vectors<const D: usize>(track: &Eliminated, first: usize) -> Vec<Vec<Vector<D>>> {
    let mut found: Vec<Vec<Vector<D>>> = track.vectors[first..].iter().map(|z| track.coefficients(z)).collect();
    for function in &track.unseen {
        for c in 0..D {
            let axis: Vector<D> = std::array::from_fn(|r| f64::from(u8::from(r == c)));
            found.push(function.iter().map(|&value| add(&[0.0; D], &scale(value, &axis))).collect());
        }
    }
    found
}
