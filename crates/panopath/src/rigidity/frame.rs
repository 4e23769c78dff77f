//! Members that observations tie together, laid out in a frame of their own.

use crate::bundle::estimate::Estimate;
use crate::bundle::noise::median;
use crate::bundle::part::{Lanes, Part, Stations};
use crate::geometry::{Vector, norm, sub};

use super::Sightings;

/// Segments shorter than this share of the size have no direction.
const NO_LENGTH: f64 = 1e-12;
/// Rays that are parallel to this do not say how fast their point moves away.
const INFINITE_RAD: f64 = 1e-6;

/// A set of observations with their members: centroid of the views at zero, their rms distance from it one. The rays are the
/// directions of the segments themselves, whatever was measured.
pub(super) struct Frame<const D: usize> {
    /// View of each node, ascending.
    pub views: Vec<u32>,
    pub part: Part<D>,
    pub estimate: Estimate,
    /// Unit of the frame in that of the scene.
    pub size: f64,
    /// Observations that count, all of them.
    pub keep: Vec<bool>,
}

impl<const D: usize> Frame<D> {
    /// Lays out some observations; those without length are left out. `None` where nothing is left.
    pub fn lay_out(scene: &Sightings<'_, D>, observations: &[u32], unknowns: usize, gauge: usize) -> Option<Self> {
        let views = ascending(observations.iter().map(|&o| scene.view[o as usize]));
        let tracks = ascending(observations.iter().map(|&o| scene.track[o as usize]));
        let (origin, size) = extent(scene, &views, &tracks)?;
        let place = |x: &Vector<D>| Lanes::from_vector::<D>(&std::array::from_fn(|c| (x[c] - origin[c]) / size));
        let segment = |o: usize| {
            let (center, point) = (&scene.centers[scene.view[o] as usize], &scene.points[scene.track[o] as usize]);
            place(point).minus(&place(center))
        };
        let length = |u: &Lanes| u.dot::<D>(u).sqrt();
        let observations: Vec<u32> =
            observations.iter().copied().filter(|&o| length(&segment(o as usize)) > NO_LENGTH).collect();
        if observations.is_empty() {
            return None;
        }
        let views = ascending(observations.iter().map(|&o| scene.view[o as usize]));
        let mut node = vec![u32::MAX; scene.centers.len()];
        for (k, &view) in views.iter().enumerate() {
            node[view as usize] = k as u32;
        }
        let stations = Stations {
            node: (0..views.len() as u32).collect(),
            node_freedom: vec![unknowns; views.len()],
            gauge_freedom: gauge,
        };
        let ray = |o: usize| {
            let u = segment(o);
            let mut ray = u.times(1.0 / length(&u));
            ray.0[3] = scene.precision.map_or(1.0, |p| p[o]);
            ray
        };
        let local_view = |o: usize| node[scene.view[o] as usize];
        let part = Part::new(stations, scene.points.len(), &observations, scene.track, local_view, ray);
        let estimate = Estimate {
            centers: views.iter().map(|&v| place(&scene.centers[v as usize])).collect(),
            points: part.input_track.iter().map(|&t| place(&scene.points[t as usize])).collect(),
        };
        let keep = vec![true; part.n_observations()];
        Some(Self { views, part, estimate, size, keep })
    }

    /// The frame after a displacement of the views, the points following.
    pub fn moved<const W: usize>(&self, step: &[f64], amplitude: f64) -> Self {
        let followers = self.followers::<W>(step);
        let shifts =
            step.as_chunks::<W>().0.iter().map(|x| Lanes::from_vector::<D>(&std::array::from_fn(|c| x[W - D + c])));
        let move_by = |(x, dx): (&Lanes, Lanes)| x.plus_scaled(amplitude, &dx);
        let estimate = Estimate {
            centers: self.estimate.centers.iter().zip(shifts).map(move_by).collect(),
            points: self.estimate.points.iter().zip(followers).map(move_by).collect(),
        };
        Self { views: self.views.clone(), part: self.part.clone(), estimate, size: self.size, keep: self.keep.clone() }
    }

    /// From the centre of the view to the point.
    pub fn segment(&self, o: usize, j: usize) -> Lanes {
        self.estimate.points[j].minus(&self.estimate.centers[self.part.node_of(o) as usize])
    }

    /// Is a point free to slide along its rays? It is where all its views lie on one line with it.
    pub fn slides(&self, j: usize, tolerance: f64) -> bool {
        let observations = self.part.observations(j);
        let first = observations.start;
        observations.skip(1).all(|o| {
            let baseline = self.center(o).minus(self.center(first));
            let ray = &self.part.ray[first];
            let across = baseline.plus_scaled(-baseline.dot::<D>(ray), ray);
            across.dot::<D>(&across) <= tolerance * tolerance * baseline.dot::<D>(&baseline)
        })
    }

    /// Is a point so far that its rays are parallel as far as numbers go?
    pub fn is_infinite(&self, j: usize) -> bool {
        let observations = self.part.observations(j);
        let first = self.part.ray[observations.start];
        observations.skip(1).all(|o| {
            let ray = &self.part.ray[o];
            let across = ray.plus_scaled(-ray.dot::<D>(&first), &first);
            across.dot::<D>(&across) < INFINITE_RAD * INFINITE_RAD
        })
    }

    /// Centre of the view.
    pub fn center(&self, o: usize) -> &Lanes {
        &self.estimate.centers[self.part.node_of(o) as usize]
    }
}

fn ascending(ids: impl Iterator<Item = u32>) -> Vec<u32> {
    let mut ids: Vec<u32> = ids.collect();
    ids.sort_unstable();
    ids.dedup();
    ids
}

/// Centroid and rms radius of the views; where these stand in one place as far as numbers go, how far half of the points are.
fn extent<const D: usize>(scene: &Sightings<'_, D>, views: &[u32], tracks: &[u32]) -> Option<(Vector<D>, f64)> {
    let centers: Vec<&Vector<D>> = views.iter().map(|&v| &scene.centers[v as usize]).collect();
    let n = centers.len() as f64;
    let origin: Vector<D> = std::array::from_fn(|c| centers.iter().map(|x| x[c]).sum::<f64>() / n);
    let squared: f64 = centers.iter().flat_map(|x| (0..D).map(|c| (x[c] - origin[c]).powi(2))).sum();
    let largest = centers.iter().flat_map(|x| x.iter()).fold(0.0f64, |m, x| m.max(x.abs()));
    let mut size = (squared / n).sqrt();
    if size <= NO_LENGTH * largest || size == 0.0 {
        let mut far: Vec<f64> = tracks.iter().map(|&t| norm(&sub(&scene.points[t as usize], &origin))).collect();
        size = median(&mut far);
    }
    (size > 0.0 && size.is_finite()).then_some((origin, size))
}
