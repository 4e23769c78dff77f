//! The observations of a scene by view and by track, which of them are accepted, and by how much they miss.

use rayon::prelude::*;

use super::{is_finite, is_known};
use crate::bundle::noise::sigma_from_chords;
use crate::geometry::{Vector, add, dot, norm, normalized, scale, sub, tangent_basis};
use crate::lists::Lists;
use crate::sets::Sets;
use crate::structure::Structure;
use crate::tracks::Tracks;

/// Below this the noise counts as this: what is left is rounding, or the last step that a solver did not take.
pub(super) const LEAST_NOISE_RAD: f64 = 1e-7;
/// Accepted observations beyond this many times the noise are misfits.
const MISFIT_SIGMAS: f64 = 10.0;
/// Share of the equations that must be beyond the unknowns before misfits are counted.
const LEAST_FREE_SHARE: f64 = 0.2;
/// Points that a view must see before it is missed.
const PLACEABLE: usize = 20;
/// Sightings from which on a track is judged as a whole: false bearings alone hardly ever take two thirds of so many.
const OFTEN: usize = 5;
/// A track tells of places where its directions spread by more than so many times the noise.
const PARALLAX_SIGMAS: f64 = 8.0;
/// Fewest equations beyond the unknowns from which a noise is estimated.
pub(super) const LEAST_FREEDOM: f64 = 12.0;

/// Observations of a scene, grouped.
pub(super) struct Rays<'a, const D: usize> {
    pub tracks: &'a Tracks<D>,
    pub scene: &'a Structure<D>,
    /// Component of each view, -1 where it has no position.
    pub view_component: Vec<i32>,
    pub n_components: usize,
    /// Of each observation: used by the scene, and by a view and a point of one component.
    pub accepted: Vec<bool>,
    /// Observations of each view that has a position, in the order of the tracks.
    pub by_view: Lists,
    /// The same of each track.
    pub by_track: Lists,
    /// Of each entry of `by_track`: the view, and whether it is accepted; what counting pairs reads, in its order.
    sightings: Vec<(u32, bool)>,
    /// Weight `sigma / sigma_rad` of an observation, the median sigma over its own; empty where none are given.
    weight: Vec<f64>,
    median_sigma: f64,
}

/// An observation as the scene has it.
pub(super) struct Ray<const D: usize> {
    /// Predicted direction.
    pub towards: Vector<D>,
    /// Distance of the point.
    pub distance: f64,
    /// Observed direction in the tangent plane of the predicted one, times the weight of the observation.
    pub basis: [Vector<D>; 2],
    pub error: [f64; 2],
}

/// How much the accepted observations of a component miss.
#[derive(Clone)]
pub(super) struct Noise {
    /// In each tangent direction; of an observation of median sigma.
    pub sigma_rad: f64,
    /// The same over the sigma of the tracks; NaN where they have none.
    pub over_given: f64,
    pub misfit_share: f64,
    pub behind_share: f64,
    pub views_behind: Vec<u32>,
}

impl<'a, const D: usize> Rays<'a, D> {
    pub fn new(tracks: &'a Tracks<D>, scene: &'a Structure<D>) -> Self {
        let solved = |i: usize| is_finite(&scene.centers[i]) && is_known(&scene.cam_from_world[i]);
        let view_component: Vec<i32> =
            (0..tracks.n_views()).map(|i| if solved(i) { scene.view_component[i].max(-1) } else { -1 }).collect();
        let n_components = view_component.iter().map(|&c| (c + 1) as usize).max().unwrap_or(0);
        let (view, track) = (tracks.view(), tracks.track());
        let accepted: Vec<bool> = (0..tracks.len())
            .into_par_iter()
            .map(|o| {
                let (i, j) = (view[o] as usize, track[o] as usize);
                let together = view_component[i] >= 0 && view_component[i] == scene.track_component[j];
                // a point in the place of a view has no direction
                scene.inlier[o] && together && is_finite(&scene.points[j]) && scene.points[j] != scene.centers[i]
            })
            .collect();
        let seen = (0..tracks.len() as u32).filter(|&o| view_component[view[o as usize] as usize] >= 0);
        let by_track = Lists::new(tracks.n_tracks(), seen.map(|o| (track[o as usize], o)));
        let by_view = Lists::new(tracks.n_views(), by_track.all().iter().map(|&o| (view[o as usize], o)));
        let sightings = by_track.all().par_iter().map(|&o| (view[o as usize], accepted[o as usize])).collect();
        let (weight, median_sigma) = weights(tracks.sigma_rad());
        Self {
            tracks,
            scene,
            view_component,
            n_components,
            accepted,
            by_view,
            by_track,
            sightings,
            weight,
            median_sigma,
        }
    }

    /// View of each observation of a track, and whether it is accepted.
    pub fn sightings(&self, track: usize) -> &[(u32, bool)] {
        &self.sightings[self.by_track.range(track)]
    }

    pub fn has_sigma(&self) -> bool {
        !self.weight.is_empty()
    }

    /// "the scene", or "part 2" where there are several.
    pub fn part_name(&self, component: usize) -> String {
        if self.n_components > 1 { format!("part {component}") } else { "the scene".to_owned() }
    }

    /// Seen and predicted direction of an accepted observation, and the distance of its point.
    #[inline]
    fn directions(&self, o: usize) -> (Vector<D>, Vector<D>, f64) {
        let (i, j) = (self.tracks.view()[o] as usize, self.tracks.track()[o] as usize);
        let apart = sub(&self.scene.points[j], &self.scene.centers[i]);
        (self.seen(o), normalized(&apart), norm(&apart).max(f64::MIN_POSITIVE))
    }

    /// Direction of an observation in the world.
    #[inline]
    fn seen(&self, o: usize) -> Vector<D> {
        let i = self.tracks.view()[o] as usize;
        let (cam_from_world, bearing) = (self.scene.cam_from_world[i].matrix(), &self.tracks.bearing()[o]);
        // the transposed rotation, row by row
        cam_from_world.iter().zip(bearing).fold([0.0; D], |sum, (row, b)| add(&sum, &scale(*b, row)))
    }

    /// Which tracks tell of places: far ones fit any, and agree on both sides of every tear.
    ///
    /// The directions of the accepted observations are looked at, or of all where fewer than two are accepted.
    pub fn near_tracks(&self, noise: &[Noise]) -> Vec<bool> {
        let largest = noise.iter().map(|n| n.sigma_rad).filter(|s| s.is_finite()).fold(0.0, f64::max);
        let is_near = |j: usize| {
            let all = self.by_track.of(j);
            let accepted = || all.iter().filter(|&&o| self.accepted[o as usize]);
            let directions: Vec<Vector<D>> = if accepted().nth(1).is_some() {
                accepted().map(|&o| self.seen(o as usize)).collect()
            } else {
                all.iter().map(|&o| self.seen(o as usize)).collect()
            };
            let mean = normalized(&directions.iter().fold([0.0; D], |sum, v| add(&sum, v)));
            directions.iter().any(|v| norm(&sub(v, &mean)) > PARALLAX_SIGMAS * largest)
        };
        (0..self.tracks.n_tracks()).into_par_iter().map(is_near).collect()
    }

    fn weight(&self, o: usize) -> f64 {
        self.weight.get(o).copied().unwrap_or(1.0)
    }

    /// An accepted observation.
    #[inline]
    pub fn ray(&self, o: usize) -> Ray<D> {
        let (seen, towards, distance) = self.directions(o);
        let basis = tangent_basis(&towards).map(|b| scale(self.weight(o), &b));
        let error = [dot(&basis[0], &seen), dot(&basis[1], &seen)];
        Ray { towards, distance, basis, error }
    }

    /// Noise of each component; `V` freedoms a view.
    pub fn noise<const V: usize>(&self) -> Vec<Noise> {
        let sums = self.sums();
        let mut lengths: Vec<Vec<f64>> = vec![Vec::new(); self.n_components];
        let mut behind: Vec<Vec<u32>> = vec![Vec::new(); self.n_components];
        for i in 0..self.tracks.n_views() {
            let Ok(c) = usize::try_from(self.view_component[i]) else { continue };
            let (of_view, n_behind) = &sums[i];
            lengths[c].extend(of_view);
            behind[c].extend(std::iter::repeat_n(i as u32, *n_behind as usize));
        }
        let unknowns = self.unknowns();
        lengths.into_iter().zip(behind).zip(unknowns).map(|((l, b), u)| self.noise_of::<V>(l, b, u)).collect()
    }

    /// Views of each component that accepted observations do not tie to the largest group of its views.
    pub fn untied_views(&self) -> Vec<Vec<u32>> {
        let n_views = self.tracks.n_views();
        // views, then tracks
        let mut sets = Sets::new(n_views + self.tracks.n_tracks());
        for o in (0..self.tracks.len()).filter(|&o| self.accepted[o]) {
            sets.join(self.tracks.view()[o] as usize, n_views + self.tracks.track()[o] as usize);
        }
        let mut size = vec![0u32; n_views];
        let root: Vec<usize> = (0..n_views).map(|i| sets.find(i)).collect();
        root.iter().for_each(|&g| size[g] += 1);
        let mut largest = vec![usize::MAX; self.n_components];
        for i in 0..n_views {
            let Ok(c) = usize::try_from(self.view_component[i]) else { continue };
            if largest[c] == usize::MAX || size[root[i]] > size[largest[c]] {
                largest[c] = root[i];
            }
        }
        let untied =
            |c: usize, i: &u32| self.view_component[*i as usize] == c as i32 && root[*i as usize] != largest[c];
        (0..self.n_components).map(|c| (0..n_views as u32).filter(|i| untied(c, i)).collect()).collect()
    }

    /// Views without a position that see points of the scene well enough to have one.
    pub fn unplaced_views(&self) -> Vec<u32> {
        let mut n_seen = vec![0usize; self.tracks.n_views()];
        for (&i, &j) in self.tracks.view().iter().zip(self.tracks.track()) {
            let is_placed = self.scene.track_component[j as usize] >= 0 && is_finite(&self.scene.points[j as usize]);
            n_seen[i as usize] += usize::from(is_placed);
        }
        let views = 0..self.tracks.n_views();
        views.filter(|&i| self.view_component[i] < 0 && n_seen[i] >= PLACEABLE).map(|i| i as u32).collect()
    }

    /// Views with any observation; none where nothing has a position.
    pub fn n_seeing_views(&self) -> usize {
        let mut sees = vec![false; self.tracks.n_views()];
        self.tracks.view().iter().for_each(|&i| sees[i as usize] = self.n_components > 0);
        sees.iter().filter(|&&s| s).count()
    }

    /// How many tracks were seen often enough to be judged, and how many of them the scene hardly uses.
    pub fn lost_tracks(&self) -> (usize, usize) {
        let often = (0..self.tracks.n_tracks()).map(|j| self.sightings(j)).filter(|seen| seen.len() >= OFTEN);
        let is_lost = |seen: &[(u32, bool)]| 3 * seen.iter().filter(|s| s.1).count() < seen.len();
        (often.clone().count(), often.filter(|seen| is_lost(seen)).count())
    }

    /// Lengths of the weighted residuals of each view, and how many of them point away.
    fn sums(&self) -> Vec<(Vec<f64>, u32)> {
        let of_view = |i: usize| {
            let mut n_behind = 0;
            let used = self.by_view.of(i).iter().filter(|&&o| self.accepted[o as usize]);
            let lengths = used.map(|&o| {
                let (seen, towards, _) = self.directions(o as usize);
                n_behind += u32::from(dot(&towards, &seen) < 0.0);
                // the chord grows up to the opposite direction
                self.weight(o as usize) * norm(&sub(&seen, &towards))
            });
            (lengths.collect(), n_behind)
        };
        (0..self.tracks.n_views()).into_par_iter().map(of_view).collect()
    }

    /// What was fitted to the accepted observations of each component.
    fn unknowns(&self) -> Vec<Unknowns> {
        let mut unknowns = vec![Unknowns::default(); self.n_components];
        for j in 0..self.tracks.n_tracks() {
            if self.sightings(j).iter().any(|s| s.1) {
                unknowns[self.scene.track_component[j] as usize].points += 1;
            }
        }
        for &c in self.view_component.iter().filter(|&&c| c >= 0) {
            unknowns[c as usize].views += 1;
        }
        unknowns
    }

    fn noise_of<const V: usize>(&self, mut lengths: Vec<f64>, behind: Vec<u32>, unknowns: Unknowns) -> Noise {
        let n = lengths.len();
        let equations = (n * (D - 1)) as f64;
        let freedom = equations - unknowns.fitted::<D>(D);
        let behind_share = behind.len() as f64 / n as f64;
        let mut views_behind = behind;
        views_behind.dedup();
        let mut noise =
            Noise { sigma_rad: f64::NAN, over_given: f64::NAN, misfit_share: f64::NAN, behind_share, views_behind };
        if freedom < LEAST_FREEDOM {
            return noise;
        }
        noise.sigma_rad = (lengths.iter().map(|l| l * l).sum::<f64>() / freedom).sqrt();
        if self.has_sigma() {
            noise.over_given = noise.sigma_rad / self.median_sigma;
        }
        // where nearly all is fitted, orientations perhaps too, most residuals vanish, and the others are no misfits
        let most = unknowns.fitted::<D>(V);
        if equations - most > LEAST_FREE_SHARE * equations {
            let typical = sigma_from_chords::<D>(&mut lengths, n, most as usize).max(LEAST_NOISE_RAD);
            let misfits = lengths.iter().filter(|&&l| l > MISFIT_SIGMAS * typical).count();
            noise.misfit_share = misfits as f64 / n as f64;
        }
        noise
    }
}

/// Views and points of a component.
#[derive(Clone, Copy, Default)]
struct Unknowns {
    views: usize,
    points: usize,
}

impl Unknowns {
    /// Numbers fitted, so many of each view.
    fn fitted<const D: usize>(self, of_view: usize) -> f64 {
        (of_view * self.views + D * self.points) as f64
    }
}

/// Weights of observations against that of median sigma, and that sigma.
fn weights(sigma_rad: Option<&[f64]>) -> (Vec<f64>, f64) {
    let Some(sigma) = sigma_rad.filter(|s| !s.is_empty()) else { return (Vec::new(), f64::NAN) };
    let mut sorted = sigma.to_vec();
    let median = *sorted.select_nth_unstable_by(sigma.len() / 2, f64::total_cmp).1;
    (sigma.iter().map(|s| median / s).collect(), median)
}
