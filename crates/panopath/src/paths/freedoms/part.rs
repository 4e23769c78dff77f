//! One connected part of a scene: its views, its tracks and their observations, lengths in units of the typical distance.

use super::super::Form;
use super::MovingScene;
use crate::bundle::noise::median;
use crate::geometry::{Vector, add, dot, norm, scale, sub};
use crate::lists::Lists;
use crate::sets::Sets;

pub(super) struct Part<const D: usize> {
    /// Views of the scene that take part, ascending; positions in this list are *nodes*.
    pub views: Vec<u32>,
    /// Tracks of the scene that take part, ascending.
    pub tracks: Vec<u32>,
    /// Observations `start[j]..start[j + 1]` are of track `j` of the list.
    pub start: Vec<usize>,
    /// Node of each observation.
    pub node: Vec<u32>,
    /// Track of each observation, as in the list.
    pub owner: Vec<u32>,
    /// Unit vector from the view to the track.
    pub ray: Vec<Vector<D>>,
    /// Length of the segment.
    pub length: Vec<f64>,
    /// Weight of an observation in units of length: `(sigma / sigma_o) / |u|`.
    pub gain: Vec<f64>,
    /// Where the views are, from their middle.
    pub center: Vec<Vector<D>>,
    /// When.
    pub time_s: Vec<f64>,
    /// Functions of each track at its observations, observation by observation.
    pub functions: Vec<Vec<f64>>,
    /// Observations of each node.
    pub of_node: Lists,
    /// Typical distance, in units of the scene.
    pub unit: f64,
    /// Typical standard deviation of an observation.
    pub sigma: f64,
}

/// An observation that can be used.
struct Seen<const D: usize> {
    view: u32,
    track: u32,
    segment: Vector<D>,
    sigma: f64,
}

impl<const D: usize> Part<D> {
    /// Connected parts, those with the most observations first.
    pub fn all(scene: &MovingScene<'_, D>, starts: &[usize], sigma_rad: f64) -> Vec<Self> {
        let n_views = scene.centers.len();
        let mut seen = usable(scene, starts, sigma_rad);
        seen.sort_by_key(|s| (s.track, s.view));
        let mut sets = Sets::new(n_views + scene.forms.len());
        for s in &seen {
            sets.join(s.view as usize, n_views + s.track as usize);
        }
        let mut by_root: std::collections::BTreeMap<usize, Vec<Seen<D>>> = std::collections::BTreeMap::new();
        for s in seen {
            by_root.entry(sets.find(s.view as usize)).or_default().push(s);
        }
        let mut groups: Vec<Vec<Seen<D>>> = by_root.into_values().collect();
        groups.sort_by_key(|group| std::cmp::Reverse(group.len()));
        groups.into_iter().map(|group| Self::of(scene, &group)).collect()
    }

    fn of(scene: &MovingScene<'_, D>, seen: &[Seen<D>]) -> Self {
        let unit = median(&mut seen.iter().map(|s| norm(&s.segment)).collect::<Vec<f64>>());
        let sigma = median(&mut seen.iter().map(|s| s.sigma).collect::<Vec<f64>>());
        let mut views: Vec<u32> = seen.iter().map(|s| s.view).collect();
        views.sort_unstable();
        views.dedup();
        let (mut tracks, mut start, mut functions) = (Vec::new(), vec![0], Vec::new());
        for group in seen.chunk_by(|a, b| a.track == b.track) {
            let form = &scene.forms[group[0].track as usize];
            tracks.push(group[0].track);
            start.push(start[start.len() - 1] + group.len());
            let mut values = vec![0.0; group.len() * form.len()];
            for (row, s) in values.chunks_exact_mut(form.len()).zip(group) {
                form.values(scene.time_s[s.view as usize], 0, row);
            }
            functions.push(values);
        }
        let node: Vec<u32> = seen.iter().map(|s| views.partition_point(|&v| v < s.view) as u32).collect();
        let owner: Vec<u32> = seen.iter().map(|s| tracks.partition_point(|&j| j < s.track) as u32).collect();
        let middle = views
            .iter()
            .fold([0.0; D], |sum, &v| add(&sum, &scale(1.0 / views.len() as f64, &scene.centers[v as usize])));
        let length: Vec<f64> = seen.iter().map(|s| norm(&s.segment) / unit).collect();
        // exact data carry no noise: all observations count alike
        let weight = |s: &Seen<D>| if s.sigma > 0.0 { sigma / s.sigma } else { 1.0 };
        Self {
            center: views.iter().map(|&v| scale(1.0 / unit, &sub(&scene.centers[v as usize], &middle))).collect(),
            time_s: views.iter().map(|&v| scene.time_s[v as usize]).collect(),
            ray: seen.iter().map(|s| scale(1.0 / norm(&s.segment), &s.segment)).collect(),
            gain: seen.iter().zip(&length).map(|(s, length)| weight(s) / length).collect(),
            of_node: Lists::new(views.len(), node.iter().enumerate().map(|(o, &node)| (node, o as u32))),
            views,
            tracks,
            start,
            node,
            owner,
            length,
            functions,
            unit,
            sigma,
        }
    }

    pub fn n_observations(&self) -> usize {
        self.node.len()
    }

    pub fn observations(&self, j: usize) -> std::ops::Range<usize> {
        self.start[j]..self.start[j + 1]
    }

    /// Functions of a path.
    pub fn n_functions(&self, j: usize) -> usize {
        self.functions[j].len() / self.observations(j).len()
    }

    /// Coordinates of views and coefficients.
    pub fn unknowns(&self) -> usize {
        D * (self.views.len() + (0..self.tracks.len()).map(|j| self.n_functions(j)).sum::<usize>())
    }

    /// What a displacement of an end costs, `gain^2 P x`.
    #[inline]
    pub fn resist(&self, o: usize, x: &Vector<D>) -> Vector<D> {
        let along = dot(&self.ray[o], x);
        let squared = self.gain[o] * self.gain[o];
        std::array::from_fn(|c| squared * (x[c] - along * self.ray[o][c]))
    }

    /// The same as a matrix.
    pub fn resistance(&self, o: usize) -> crate::geometry::Matrix<D> {
        let (ray, squared) = (&self.ray[o], self.gain[o] * self.gain[o]);
        std::array::from_fn(|r| std::array::from_fn(|c| squared * (f64::from(u8::from(r == c)) - ray[r] * ray[c])))
    }
}

/// Observations whose ends are known and apart.
fn usable<const D: usize>(scene: &MovingScene<'_, D>, starts: &[usize], sigma_rad: f64) -> Vec<Seen<D>> {
    let mut values = Vec::new();
    let mut seen = Vec::with_capacity(scene.view.len());
    for o in 0..scene.view.len() {
        let (view, track) = (scene.view[o] as usize, scene.track[o] as usize);
        let place =
            position(&scene.forms[track], &scene.coefficients[starts[track]..], scene.time_s[view], &mut values);
        let segment = sub(&place, &scene.centers[view]);
        let length = norm(&segment);
        if length.is_finite() && length > 0.0 {
            let sigma = scene.sigma_rad.get(o).copied().unwrap_or(sigma_rad);
            seen.push(Seen { view: view as u32, track: track as u32, segment, sigma });
        }
    }
    seen
}

/// Where a path is at a time.
pub(super) fn position<const D: usize>(
    form: &Form,
    coefficients: &[Vector<D>],
    time_s: f64,
    values: &mut Vec<f64>,
) -> Vector<D> {
    values.clear();
    values.resize(form.len(), 0.0);
    form.values(time_s, 0, values);
    values.iter().zip(coefficients).fold([0.0; D], |sum, (value, p)| add(&sum, &scale(*value, p)))
}
