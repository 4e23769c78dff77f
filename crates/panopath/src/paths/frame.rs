//! Some tracks and the views that saw them, laid out for the solver.

use std::sync::Arc;

use super::Input;
use super::joint::{Given, PoseSystem, State};
use super::track::Fit;
use crate::bundle::estimate::Estimate;
use crate::bundle::part::{Courses, Lanes, Part, Stations};
use crate::bundle::reduced::most_observed_node;
use crate::bundle::turns::turns;
use crate::geometry::Rotation;
use crate::least_squares::LeastSquaresError;
use crate::structure::Structure;

/// One track with its path.
#[derive(Clone)]
pub(super) struct Member<'a> {
    pub track: u32,
    /// Its observations in the input, in the order of `fit.keep`.
    pub rows: Vec<u32>,
    pub fit: &'a Fit,
    pub seeks_frequency: bool,
}

/// Tracks and views of one part.
pub(super) struct Frame<const D: usize> {
    /// View of each node, ascending.
    pub views: Vec<u32>,
    pub state: State<D>,
    bearing: Vec<Lanes>,
    time_s: Vec<f64>,
}

impl<const D: usize> Frame<D> {
    /// Lays out the members, in ascending order of their track, with cameras and paths as they were found.
    pub fn lay_out(input: &Input<'_, D>, structure: &Structure<D>, members: &[Member<'_>], free_turns: bool) -> Self {
        let tracks = input.tracks;
        let mut views: Vec<u32> =
            members.iter().flat_map(|m| m.rows.iter().map(|&o| tracks.view()[o as usize])).collect();
        views.sort_unstable();
        views.dedup();
        let mut node = vec![u32::MAX; tracks.n_views()];
        views.iter().enumerate().for_each(|(k, &v)| node[v as usize] = k as u32);
        let observations: Vec<u32> = members.iter().flat_map(|m| m.rows.iter().copied()).collect();
        let stations = Stations {
            node: (0..views.len() as u32).collect(),
            node_freedom: vec![D + if free_turns { turns(D) } else { 0 }; views.len()],
            gauge_freedom: D + 1 + if free_turns { turns(D) } else { 0 },
        };
        let rotation = |view: u32| {
            let known = input.cam_from_world.is_some() || input.motion.free_orientations;
            if known { structure.cam_from_world[view as usize] } else { Rotation::identity() }
        };
        let world_from_cam: Vec<Rotation<D>> = views.iter().map(|&v| rotation(v).inverse()).collect();
        let part = Part::new(
            stations,
            tracks.n_tracks(),
            &observations,
            tracks.track(),
            |o| node[tracks.view()[o] as usize],
            |o| {
                let mut ray = Lanes::from_vector::<D>(
                    &world_from_cam[node[tracks.view()[o] as usize] as usize].apply(&tracks.bearing()[o]),
                );
                ray.0[3] = input.bearing[o].0[3];
                ray
            },
        );
        let member_of = |track: u32| members.binary_search_by_key(&track, |m| m.track).map(|k| &members[k]).ok();
        let mut courses = Courses { start: vec![0], ..Courses::default() };
        let (mut forms, mut vectors, mut points) = (Vec::new(), Vec::new(), Vec::new());
        for &track in &part.input_track {
            // every track of the part is one of the members
            let Some(member) = member_of(track) else { continue };
            forms.push(member.fit.form.clone());
            vectors.extend_from_slice(&member.fit.vectors);
            points.push(member.fit.vectors[0]);
            courses.start.push(vectors.len() as u32);
            courses.is_bent.push(member.seeks_frequency);
        }
        let centers =
            views.iter().map(|&v| Lanes::from_vector::<D>(&structure.centers[v as usize])).collect::<Vec<Lanes>>();
        let bearing = part.input_observation.iter().map(|&o| input.bearing[o as usize]).collect();
        let time_s = views.iter().map(|&v| input.time_s[v as usize]).collect();
        let mut frame = Self {
            state: State {
                cam_from_world: views.iter().map(|&v| rotation(v)).collect(),
                part: part.moving(courses),
                estimate: Estimate { centers, points },
                vectors,
                forms: Arc::new(forms),
            },
            views,
            bearing,
            time_s,
        };
        let given = Given { bearing: &frame.bearing, time_s: &frame.time_s, turns: free_turns };
        let mut state = frame.state.clone();
        state.lay_courses(&given);
        frame.state = state;
        frame
    }

    /// What does not change in a solve.
    pub fn given(&self, input: &Input<'_, D>) -> Given<'_, D> {
        Given { bearing: &self.bearing, time_s: &self.time_s, turns: input.motion.free_orientations }
    }

    /// The system of all poses; the view that saw most is pinned.
    pub fn system<const V: usize>(&self, free_turns: bool) -> Result<PoseSystem<D, V>, LeastSquaresError> {
        let part = &self.state.part;
        let mut held: Vec<bool> = (0..part.n_nodes * V).map(|k| k % V < V - D && !free_turns).collect();
        let pinned = most_observed_node(part);
        held[pinned * V..(pinned + 1) * V].fill(true);
        PoseSystem::<D, V>::analyse(part, Default::default(), held)
    }

    /// Which observations of the part agree with the paths.
    pub fn keep(&self, members: &[Member<'_>]) -> Vec<bool> {
        self.keep_where(members, |_| true)
    }

    /// The same of some members alone.
    pub fn keep_where(&self, members: &[Member<'_>], counts: impl Fn(&Member<'_>) -> bool) -> Vec<bool> {
        let part = &self.state.part;
        let mut keep = vec![false; part.n_observations()];
        for (j, &track) in part.input_track.iter().enumerate() {
            let Ok(k) = members.binary_search_by_key(&track, |m| m.track) else { continue };
            let member = &members[k];
            if counts(member) {
                for o in part.observations(j) {
                    let row = member.rows.iter().position(|&row| row == part.input_observation[o]);
                    keep[o] = row.is_some_and(|row| member.fit.keep[row]);
                }
            }
        }
        keep
    }
}
