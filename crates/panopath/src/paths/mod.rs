//! Bodies that move while they are filmed: camera path and the paths of bodies (Knill and Ramirez-Herran 2007, section 6).
//!
//! An observation of a track is `v ~ P(t) - c`, `P(t) = sum_l B_l(t) p_l`, with the vectors `p_l` unknown. For known orientations
//! this is as linear in `p_l` and `c` as it is for points at rest, and the vectors are eliminated as points are.
//!
//! [`solve_paths`] reads: cameras from the tracks at rest, where they suffice; rest and motion told apart for the tracks of
//! which nothing is said, cameras and choice in turns; all together, where forms of motion were given; then what each path is
//! worth.

mod basis;
mod covariance;
mod frame;
mod freedoms;
mod frequency;
mod gauge;
mod joint;
mod options;
mod select;
mod start;
mod track;
mod verdict;

pub use basis::Form;
pub use freedoms::{
    Freedom, FreedomError, FreedomKind, FreedomOptions, MovingScene, NullVector, PathCertificate, Reach, TimeFunction,
    TrackReach, freedoms_of_paths,
};
pub use options::{Assumption, Motion, MovingStructure, PathError};
pub use verdict::Verdict;

use rayon::prelude::*;

use crate::bundle::noise::{SIGMA_FLOOR_RAD, precisions};
use crate::bundle::part::Lanes;
use crate::geometry::{Rotation, Vector, norm, sub};
use crate::least_squares::LeastSquaresError;
use crate::lists::most_common;
use crate::positions::{Gauge, Method, PositionOptions, place_structure, solve_positions};
use crate::structure::{Status, Structure};
use crate::tracks::Tracks;

use frame::{Frame, Member};
use joint::{CourseWeights, Settled, settle};
use track::{Fit, Sightings, fit};

/// Rounds of choosing and solving in turns, at most, and the share of all tracks by which a choice that stays may differ.
const ROUNDS: usize = 4;
const STAYS: f64 = 1e-2;
/// Observations a view needs of those tracks that the first cameras are found from.
const ENOUGH_FOR_A_START: usize = 150;

/// Finds cameras, points at rest and paths.
///
/// `time_s` are the times of the views; `cam_from_world` holds one rotation for each view, without it the bearings are world
/// directions. `V` is `D (D + 1) / 2`.
///
/// # Errors
/// [`PathError`] where the arguments do not fit together. What the input does not determine is said by the status and the
/// verdicts.
pub fn solve_paths<const D: usize, const V: usize>(
    tracks: &Tracks<D>,
    time_s: &[f64],
    cam_from_world: Option<&[Rotation<D>]>,
    motion: &Motion,
    options: &PositionOptions<D>,
) -> Result<MovingStructure<D>, PathError> {
    const { assert!((D == 2 || D == 3) && V == D * (D + 1) / 2) }
    check(tracks, time_s, motion, options)?;
    let mut input = Input::new(tracks, time_s, cam_from_world, motion, options);
    let at_rest = input.cameras_of_tracks_at_rest()?;
    let of_rest = at_rest.is_some();
    let mut found = match at_rest {
        Some(structure) => {
            input.find_frequencies(&structure.0);
            input.choose_in_turns(structure)?
        }
        None => {
            input.find_frequencies_without_cameras();
            let mut found = input.without_cameras::<V>()?;
            input.find_what_is_left(&mut found);
            found
        }
    };
    if input.moves_jointly(&found) {
        input.solve_jointly::<V>(&mut found)?;
        if !of_rest && (input.look_again(&mut found) | input.find_lost(&mut found)) {
            input.solve_jointly::<V>(&mut found)?;
        }
        input.choose_again(&mut found);
    }
    let resolved = input.resolve_freedoms(&mut found)?;
    let mut scene = input.conclude::<V>(&found, resolved);
    place(&mut scene, options)?;
    Ok(scene)
}

fn check<const D: usize>(
    tracks: &Tracks<D>,
    time_s: &[f64],
    motion: &Motion,
    options: &PositionOptions<D>,
) -> Result<(), PathError> {
    let lengths = [("time_s", time_s.len(), tracks.n_views()), ("forms", motion.forms.len(), tracks.n_tracks())];
    for (name, found, expected) in lengths {
        if found != expected {
            return Err(PathError::Length { name, found, expected });
        }
    }
    if !matches!(options.method, Method::Robust) {
        return Err(PathError::Option("method is linear, expected robust where tracks may move".to_owned()));
    }
    let may_move = |t: u32| !matches!(motion.forms[t as usize], Some(Form::Static));
    let seen = tracks.view().iter().zip(tracks.track());
    match seen.map(|(v, t)| (*v as usize, *t)).find(|&(v, t)| may_move(t) && !time_s[v].is_finite()) {
        Some((view, _)) => Err(PathError::Time { view }),
        None => Ok(()),
    }
}

/// What was given, and the observations of each track.
struct Input<'a, const D: usize> {
    tracks: &'a Tracks<D>,
    time_s: &'a [f64],
    cam_from_world: Option<&'a [Rotation<D>]>,
    motion: &'a Motion,
    options: &'a PositionOptions<D>,
    /// Form of each track's path, with the frequencies that were found.
    forms: Vec<Option<Form>>,
    /// Bearings with their precision in lane 3.
    bearing: Vec<Lanes>,
    start: Vec<u32>,
    /// Observations by track, then by view.
    observation: Vec<u32>,
}

/// What is known so far, in the input's numbering.
struct Found<const D: usize> {
    structure: Structure<D>,
    /// The path of each track, its observations in the order of `Input::observations`; `None` where nothing fits.
    fits: Vec<Option<Fit>>,
    assumption: Assumption,
}

impl<'a, const D: usize> Input<'a, D> {
    fn new(
        tracks: &'a Tracks<D>,
        time_s: &'a [f64],
        cam_from_world: Option<&'a [Rotation<D>]>,
        motion: &'a Motion,
        options: &'a PositionOptions<D>,
    ) -> Self {
        let precision = precisions(tracks).map(|(_, precision)| precision);
        let lanes = |(o, bearing): (usize, &Vector<D>)| {
            let mut lanes = Lanes::from_vector::<D>(bearing);
            lanes.0[3] = precision.as_ref().map_or(1.0, |p| p[o]);
            lanes
        };
        let mut observation: Vec<u32> = (0..tracks.len() as u32).collect();
        observation.sort_by_key(|&o| (tracks.track()[o as usize], tracks.view()[o as usize], o));
        let mut start = vec![0u32; tracks.n_tracks() + 1];
        tracks.track().iter().for_each(|&t| start[t as usize + 1] += 1);
        (0..tracks.n_tracks()).for_each(|t| start[t + 1] += start[t]);
        let bearing = tracks.bearing().iter().enumerate().map(lanes).collect();
        let forms = motion.forms.clone();
        Self { tracks, time_s, cam_from_world, motion, options, forms, bearing, start, observation }
    }

    fn observations(&self, track: usize) -> &[u32] {
        &self.observation[self.start[track] as usize..self.start[track + 1] as usize]
    }

    /// Direction of an observation in the world, orientations as given.
    fn world_direction(&self, o: u32) -> Vector<D> {
        let bearing = &self.tracks.bearing()[o as usize];
        match self.cam_from_world {
            Some(rotations) => rotations[self.tracks.view()[o as usize] as usize].inverse().apply(bearing),
            None => *bearing,
        }
    }

    fn is_given_moving(&self, track: usize) -> bool {
        self.motion.forms[track].as_ref().is_some_and(|form| form.len() > 1)
    }

    fn n_known_static(&self) -> usize {
        self.motion.forms.iter().filter(|form| matches!(form, Some(Form::Static))).count()
    }

    /// Observations of the tracks for which `keep` holds.
    fn tracks_where(&self, keep: impl Fn(usize) -> bool) -> Result<Option<(Tracks<D>, Vec<u32>)>, PathError> {
        let all = self.tracks;
        let rows: Vec<u32> = (0..all.len() as u32).filter(|&o| keep(all.track()[o as usize] as usize)).collect();
        if rows.is_empty() {
            return Ok(None);
        }
        let of = |o: &u32| *o as usize;
        let part = Tracks::new(
            rows.iter().map(|o| all.view()[of(o)]).collect(),
            rows.iter().map(|o| all.track()[of(o)]).collect(),
            rows.iter().map(|o| all.bearing()[of(o)]).collect(),
            all.sigma_rad().map(|sigma| rows.iter().map(|o| sigma[of(o)]).collect()),
            all.n_views(),
            all.n_tracks(),
        )?;
        Ok(Some((part, rows)))
    }

    /// Cameras and points from some tracks, taken to be at rest; residuals in the input's numbering.
    fn solve_at_rest(
        &self,
        keep: impl Fn(usize) -> bool,
        start: Option<&Structure<D>>,
    ) -> Result<Option<Structure<D>>, PathError> {
        let Some((tracks, rows)) = self.tracks_where(keep)? else { return Ok(None) };
        let options = PositionOptions {
            gauge: Gauge::Normalized,
            // bodies that pass close by would bend the cameras that they are to be told by
            even_start: self.motion.forms.contains(&None),
            start: start.map(|s| (s.centers.clone(), s.points.clone())),
            ..self.options.clone()
        };
        let mut structure = solve_positions(&tracks, self.cam_from_world, &options)?;
        let (mut inlier, mut residual) = (vec![false; self.tracks.len()], vec![f64::NAN; self.tracks.len()]);
        for (k, &o) in rows.iter().enumerate() {
            (inlier[o as usize], residual[o as usize]) = (structure.inlier[k], structure.residual_rad[k]);
        }
        (structure.inlier, structure.residual_rad) = (inlier, residual);
        Ok(Some(structure))
    }

    /// Cameras from the tracks that are or may be at rest; `None` where these do not tell of all views.
    ///
    /// Where some of the tracks are enough for that, the others are left out: true is told with the second element.
    fn cameras_of_tracks_at_rest(&self) -> Result<Option<(Structure<D>, bool)>, PathError> {
        let may_rest = |t: usize| !self.is_given_moving(t);
        let stride = self.tracks.len() / (ENOUGH_FOR_A_START * self.tracks.n_views()).max(1);
        if stride > 1 && self.options.start.is_none() && self.motion.forms.contains(&None) {
            let first = self.whole_cameras(|t| may_rest(t) && t.is_multiple_of(stride))?;
            if first.is_some() {
                return Ok(first.map(|structure| (structure, true)));
            }
        }
        Ok(self.whole_cameras(may_rest)?.map(|structure| (structure, false)))
    }

    /// Cameras from some tracks; `None` where these do not tell of all views.
    fn whole_cameras(&self, may_rest: impl Fn(usize) -> bool) -> Result<Option<Structure<D>>, PathError> {
        let start = self.options.start.as_ref().map(|(centers, points)| (centers.clone(), points.clone()));
        let given = start.map(|(centers, points)| Structure { centers, points, ..nothing(self.tracks) });
        let Some(structure) = self.solve_at_rest(may_rest, given.as_ref())? else { return Ok(None) };
        // views that hang by moving tracks alone, or parts that only these join, need the joint way
        let joins = self.motion.forms.iter().flatten().any(|form| form.len() > 1);
        let whole = self.is_whole(&structure) && structure.summary.status != Status::Ambiguous;
        Ok((whole || !joins).then_some(structure))
    }

    /// What was seen of a track, by the views of the part that most of it belongs to; with the rows of its observations.
    fn sightings(&self, structure: &Structure<D>, track: usize) -> (Sightings, Vec<u32>) {
        let view = |o: u32| self.tracks.view()[o as usize] as usize;
        let mut parts = self.observations(track).iter().map(|&o| structure.view_component[view(o)]);
        let first = parts.clone().next().filter(|part| *part >= 0 && parts.all(|other| other == *part));
        let all = self.observations(track).iter().map(|&o| structure.view_component[view(o)]);
        let Some(part) = first.or_else(|| most_common(all)) else { return Default::default() };
        let belongs = |o: &u32| structure.view_component[view(*o)] == part;
        let rows: Vec<u32> = self.observations(track).iter().copied().filter(belongs).collect();
        let mut sightings = Sightings::default();
        for &o in &rows {
            let mut ray = Lanes::from_vector::<D>(&self.world_direction(o));
            ray.0[3] = self.bearing[o as usize].0[3];
            sightings.rays.push(ray);
            sightings.centers.push(Lanes::from_vector::<D>(&structure.centers[view(o)]));
            sightings.time_s.push(self.time_s[view(o)]);
        }
        (sightings, rows)
    }

    /// Path of each track with the cameras as they are.
    fn choose(&self, structure: &Structure<D>, before: &[Option<Fit>]) -> Vec<Option<Fit>> {
        let sigma = structure.summary.sigma_rad.max(SIGMA_FLOOR_RAD);
        let path = |track: usize| {
            let (sightings, _) = self.sightings(structure, track);
            match &self.forms[track] {
                _ if sightings.len() < 2 => None,
                Some(form) => fit::<D>(&sightings, form, sigma),
                None => {
                    let at_rest = Lanes::from_vector::<D>(&structure.points[track]);
                    select::choose::<D>(
                        &sightings,
                        &self.motion.candidates,
                        sigma,
                        at_rest,
                        before.get(track).and_then(Option::as_ref),
                    )
                }
            }
        };
        (0..self.tracks.n_tracks()).into_par_iter().with_min_len(64).map(path).collect()
    }

    /// Tells rest from motion and solves for the cameras in turns, until the choice stays.
    fn choose_in_turns(&self, (mut structure, mut is_thinned): (Structure<D>, bool)) -> Result<Found<D>, PathError> {
        let may_rest: Vec<bool> = (0..self.tracks.n_tracks()).map(|t| !self.is_given_moving(t)).collect();
        let mut resting = may_rest.clone();
        let mut fits = self.choose(&structure, &[]);
        for _ in 0..ROUNDS {
            let is_whole = self.is_whole(&structure);
            let rests = |(t, fit): (usize, &Option<Fit>)| {
                let known = matches!(self.motion.forms[t], Some(Form::Static));
                // of what views without a place saw, nothing is known yet
                let unknown = !is_whole && fit.is_none() && self.is_lost(&structure, t);
                may_rest[t] && (known || unknown || fit.as_ref().is_some_and(|fit| fit.form.len() == 1))
            };
            let now: Vec<bool> = fits.iter().enumerate().map(rests).collect();
            let changed = now.iter().zip(&resting).filter(|(a, b)| a != b).count();
            // the first cameras may come from some of the tracks
            if changed as f64 <= STAYS * now.len() as f64 && !is_thinned && (is_whole || changed == 0) {
                break;
            }
            is_thinned = false;
            let start = is_whole.then_some(&structure);
            let Some(next) = self.solve_at_rest(|t| now[t], start)? else { break };
            if next.summary.n_components == 0 {
                break;
            }
            (structure, resting) = (next, now);
            fits = self.choose(&structure, &fits);
        }
        let known = self.n_known_static();
        let assumption = if known > 0 { Assumption::KnownStatic(known) } else { Assumption::MostStatic };
        Ok(Found { structure, fits, assumption })
    }

    /// Have all views that saw anything a place, in one part?
    fn is_whole(&self, structure: &Structure<D>) -> bool {
        let lost = self.tracks.view().iter().any(|&v| structure.view_component[v as usize] < 0);
        !lost && structure.summary.n_components == 1
    }

    /// Have fewer than half of the views that saw a track a place?
    fn is_lost(&self, structure: &Structure<D>, track: usize) -> bool {
        let rows = self.observations(track);
        let placed = rows.iter().filter(|&&o| structure.view_component[self.tracks.view()[o as usize] as usize] >= 0);
        2 * placed.count() < rows.len()
    }

    /// Are there paths that the cameras should be solved with?
    fn moves_jointly(&self, found: &Found<D>) -> bool {
        found.structure.summary.n_components == 1
            && (self.motion.free_orientations || (0..found.fits.len()).any(|t| self.is_given_moving(t)))
    }

    /// The tracks that the cameras rest on: those at rest, and those whose form of motion was given.
    fn bends(&self, track: usize, fit: &Fit) -> bool {
        fit.form.len() == 1 || self.is_given_moving(track)
    }

    fn members<'b>(&self, found: &'b Found<D>, keep: impl Fn(usize, &Fit) -> bool) -> Vec<Member<'b>> {
        let fits = found.fits.iter().enumerate();
        let members =
            fits.filter_map(|(track, fit)| fit.as_ref().filter(|fit| keep(track, fit)).map(|fit| (track, fit)));
        members
            .map(|(track, fit)| {
                let (_, rows) = self.sightings(&found.structure, track);
                let sought = |form: &Form| !frequency::has_frequency(form);
                // one for all stays as it was found
                let seeks = !self.motion.common_frequency && self.motion.forms[track].as_ref().is_some_and(sought);
                Member { track: track as u32, rows, fit, seeks_frequency: seeks }
            })
            .collect()
    }

    /// Paths of the tracks that show their frequency only now that cameras are known.
    fn find_what_is_left(&mut self, found: &mut Found<D>) {
        let left = self.without_frequency();
        if left.is_empty() || found.structure.summary.n_components != 1 {
            return;
        }
        self.find_frequencies(&found.structure);
        let sigma = found.structure.summary.sigma_rad.max(SIGMA_FLOOR_RAD);
        for t in left {
            let (sightings, _) = self.sightings(&found.structure, t);
            found.fits[t] = self.forms[t].as_ref().and_then(|form| fit::<D>(&sightings, form, sigma));
        }
    }

    /// Cameras, points and the paths of given form together.
    fn solve_jointly<const V: usize>(&self, found: &mut Found<D>) -> Result<(), PathError> {
        // turns that are held need no place in the equations
        if self.motion.free_orientations { self.solve_all::<V>(found) } else { self.solve_all::<D>(found) }
    }

    /// The same with `V` unknowns for each view.
    fn solve_all<const V: usize>(&self, found: &mut Found<D>) -> Result<(), PathError> {
        let members = self.members(found, |track, fit| self.bends(track, fit));
        let frame = Frame::lay_out(self, &found.structure, &members, self.motion.free_orientations);
        if frame.state.part.n_nodes == 0 {
            // no track has a path of its form that the cameras could rest on: what was found stands
            return Ok(());
        }
        let mut system = frame.system::<V>(self.motion.free_orientations)?;
        let settled =
            settle::<D, V>(&frame.given(self), &mut system, frame.state.clone(), self.options.max_iterations)?;
        let members: Vec<(u32, Vec<u32>)> = members.into_iter().map(|m| (m.track, m.rows)).collect();
        self.take(found, &frame, &members, settled);
        Ok(())
    }

    /// Writes down where cameras and paths were left.
    fn take(&self, found: &mut Found<D>, frame: &Frame<D>, members: &[(u32, Vec<u32>)], settled: Settled<D>) {
        let Settled { state, inlier, chord, sigma, iterations, converged, .. } = settled;
        let structure = &mut found.structure;
        for (node, &view) in frame.views.iter().enumerate() {
            structure.centers[view as usize] = state.estimate.centers[node].vector();
            structure.cam_from_world[view as usize] = state.cam_from_world[node];
        }
        structure.summary.sigma_rad = sigma;
        structure.summary.iterations += iterations;
        if !converged && structure.summary.status == Status::Converged {
            structure.summary.status = Status::MaxIterations;
        }
        for (j, &track) in state.part.input_track.iter().enumerate() {
            let Ok(place) = members.binary_search_by_key(&track, |(track, _)| *track) else { continue };
            let rows = &members[place].1;
            let form = state.forms[j].clone();
            let vectors = if state.part.courses.moves(j) {
                state.vectors[state.part.courses.vectors(j)].to_vec()
            } else {
                vec![state.estimate.points[j]]
            };
            let mut keep = vec![false; rows.len()];
            let mut cost = 0.0;
            for o in state.part.observations(j) {
                let row = rows.iter().position(|&row| row == state.part.input_observation[o]);
                if let Some(row) = row {
                    keep[row] = inlier[o];
                    cost += (chord[o] / sigma).powi(2);
                }
            }
            found.fits[track as usize] = keep.contains(&true).then_some(Fit { form, vectors, keep, cost });
        }
    }

    /// The tracks that the cameras do not rest on, with the cameras as they are now.
    fn choose_again(&self, found: &mut Found<D>) {
        let sigma = found.structure.summary.sigma_rad.max(SIGMA_FLOOR_RAD);
        let again: Vec<usize> = (0..found.fits.len())
            .filter(|&t| self.motion.forms[t].is_none() && found.fits[t].as_ref().is_none_or(|fit| fit.form.len() > 1))
            .collect();
        let structure = &found.structure;
        let path = |&t: &usize| {
            let (sightings, _) = self.sightings_turned(structure, t);
            if sightings.len() < 2 {
                return None;
            }
            let at_rest = Lanes::from_vector::<D>(&structure.points[t]);
            select::choose::<D>(&sightings, &self.motion.candidates, sigma, at_rest, found.fits[t].as_ref())
        };
        let fits: Vec<Option<Fit>> = again.par_iter().with_min_len(16).map(path).collect();
        for (t, fit) in again.into_iter().zip(fits) {
            found.fits[t] = fit;
        }
    }

    /// As [`Self::sightings`], with the orientations of the structure.
    fn sightings_turned(&self, structure: &Structure<D>, track: usize) -> (Sightings, Vec<u32>) {
        let (mut sightings, rows) = self.sightings(structure, track);
        if self.motion.free_orientations {
            for (ray, &o) in sightings.rays.iter_mut().zip(&rows) {
                let bearing = &self.bearing[o as usize];
                let view = self.tracks.view()[o as usize] as usize;
                let turned = structure.cam_from_world[view].inverse().apply(&bearing.vector::<D>());
                let precision = ray.0[3];
                *ray = Lanes::from_vector::<D>(&turned);
                ray.0[3] = precision;
            }
        }
        (sightings, rows)
    }

    /// Cameras from moving tracks: a linear start, or tracks taken to be at rest, whichever ends better.
    fn without_cameras<const V: usize>(&self) -> Result<Found<D>, PathError> {
        let known = self.n_known_static();
        let mut ends: Vec<(f64, Found<D>)> = Vec::new();
        // most tracks may be at rest though a form of motion was given
        if let Some(structure) = self.solve_at_rest(|_| true, None)?
            && structure.summary.n_components == 1
            && structure.summary.status == Status::Converged
        {
            let fits = self.choose(&structure, &[]);
            let mut found = Found { structure, fits, assumption: Assumption::MostStatic };
            if let Ok(cost) = self.descend_from::<V>(&mut found) {
                ends.push((cost, found));
            }
        }
        // equations that stay singular tell nothing, which is an answer
        if let Ok(mut found) = self.linear_start::<V>()
            && let Ok(cost) = self.descend_from::<V>(&mut found)
        {
            ends.push((cost, found));
        }
        let best = ends.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, found)| found);
        let mut found = best.unwrap_or_else(|| Found {
            structure: nothing(self.tracks),
            fits: vec![None; self.tracks.n_tracks()],
            assumption: Assumption::LeastMotion,
        });
        if known > 0 {
            found.assumption = Assumption::KnownStatic(known);
        }
        Ok(found)
    }

    /// Solves jointly from what was found; its truncated squared error over all observations, in radians squared.
    fn descend_from<const V: usize>(&self, found: &mut Found<D>) -> Result<f64, PathError> {
        self.solve_jointly::<V>(found)?;
        let sigma = found.structure.summary.sigma_rad;
        let kept: usize = found.fits.iter().flatten().map(Fit::n_kept).sum();
        // what is left out costs as much as an outlier
        let lost = (self.tracks.len() - kept) as f64 * 25.0;
        Ok((kept as f64 + lost) * sigma * sigma)
    }

    /// The linear solution for all tracks, those of unknown form at rest.
    fn linear_start<const V: usize>(&self) -> Result<Found<D>, PathError> {
        let mut structure = nothing(self.tracks);
        for &view in self.tracks.view() {
            structure.view_component[view as usize] = 0;
            structure.centers[view as usize] = [0.0; D];
        }
        if let Some(rotations) = self.cam_from_world {
            structure.cam_from_world = rotations.to_vec();
        }
        structure.summary.n_components = 1;
        structure.summary.status = Status::Converged;
        let fits: Vec<Option<Fit>> = (0..self.tracks.n_tracks())
            .map(|t| {
                let (sightings, rows) = self.sightings(&structure, t);
                let form = self.forms[t].clone().unwrap_or(Form::Static);
                let (first, last) = sightings.span();
                let form = form.over(first, last);
                let enough =
                    frequency::has_frequency(&form) && rows.len() >= 2 && (D - 1) * rows.len() >= D * form.len();
                let vectors = vec![Lanes::ZERO; form.len()];
                enough.then(|| Fit { form, vectors, keep: vec![true; rows.len()], cost: 0.0 })
            })
            .collect();
        let mut found = Found { structure, fits, assumption: Assumption::LeastMotion };
        let members = self.members(&found, |_, _| true);
        if members.is_empty() {
            return Err(LeastSquaresError::Singular { pivot: 0 }.into());
        }
        let frame = Frame::lay_out(self, &found.structure, &members, false);
        let members: Vec<(u32, Vec<u32>)> = members.into_iter().map(|m| (m.track, m.rows)).collect();
        let state = start::start(frame.state.clone())?;
        let n = state.part.n_observations();
        let chord = state.chords();
        let settled = Settled { state, inlier: vec![true; n], chord, sigma: 1.0, iterations: 1, converged: true };
        self.take(&mut found, &frame, &members, settled);
        Ok(found)
    }

    /// What each path is worth, and how it is told.
    fn conclude<const V: usize>(&self, found: &Found<D>, resolved: bool) -> MovingStructure<D> {
        let n_tracks = self.tracks.n_tracks();
        let mut structure = found.structure.clone();
        structure.points = vec![[f64::NAN; D]; n_tracks];
        structure.track_component = vec![-1; n_tracks];
        structure.inlier = vec![false; self.tracks.len()];
        structure.residual_rad = vec![f64::NAN; self.tracks.len()];
        let sigma = structure.summary.sigma_rad.max(SIGMA_FLOOR_RAD);
        let members = self.members(found, |_, _| true);
        let mut verdict = vec![Verdict::Undetermined; n_tracks];
        let mut covariance: Vec<Vec<f64>> = Vec::new();
        if self.motion.covariance {
            covariance.resize(n_tracks, Vec::new());
        }
        let mut of_view = vec![Vec::new(); self.tracks.n_views()];
        self.observation.iter().for_each(|&o| of_view[self.tracks.view()[o as usize] as usize].push(o));
        for part in 0..structure.summary.n_components as i32 {
            let of_part = |member: &Member<'_>| {
                let view = self.tracks.view()[member.rows[0] as usize] as usize;
                structure.view_component[view] == part
            };
            let own: Vec<Member<'_>> = members.iter().filter(|m| of_part(m)).cloned().collect();
            if own.is_empty() {
                continue;
            }
            let frame = Frame::lay_out(self, &found.structure, &own, self.motion.free_orientations);
            let keep = frame.keep(&own);
            let weights = CourseWeights { state: &frame.state, keep: &keep, huber: f64::INFINITY };
            let part_layout = &frame.state.part;
            let firmness = verdict::firmness(&weights);
            let loose: Vec<bool> = (0..part_layout.n_tracks())
                .into_par_iter()
                .with_min_len(64)
                .map(|j| {
                    part_layout.courses.moves(j)
                        && (verdict::is_loose(verdict::looseness(&weights, j, sigma))
                            || verdict::is_followed(&weights, j, &firmness, sigma))
                })
                .collect();
            for (j, loose) in loose.iter().enumerate() {
                let track = part_layout.input_track[j] as usize;
                verdict[track] = match part_layout.courses.moves(j) {
                    false => Verdict::Static,
                    true if *loose => self.why_loose(&of_view, track, sigma),
                    true => Verdict::Moving,
                };
            }
            if self.motion.covariance {
                let bends = frame.keep_where(&own, |member| self.bends(member.track as usize, member.fit));
                let free = self.motion.free_orientations;
                let blocks = if free {
                    covariance::covariances::<D, V>(&weights, &bends, free, sigma)
                } else {
                    covariance::covariances::<D, D>(&weights, &bends, free, sigma)
                };
                if let Ok(blocks) = blocks {
                    for (j, block) in blocks.into_iter().enumerate() {
                        covariance[part_layout.input_track[j] as usize] = block;
                    }
                }
            }
        }
        let mut scene = MovingStructure {
            forms: Vec::with_capacity(n_tracks),
            start: vec![0],
            vectors: Vec::new(),
            seen_s: vec![[f64::NAN; 2]; n_tracks],
            covariance,
            verdict,
            assumption: found.assumption,
            resolved,
            structure,
        };
        let mut members = members.into_iter().peekable();
        for track in 0..n_tracks {
            let member = members.next_if(|m| m.track as usize == track);
            self.write_track(&mut scene, track, member);
        }
        scene
    }

    /// Adds one track to a scene.
    fn write_track(&self, scene: &mut MovingStructure<D>, track: usize, member: Option<Member<'_>>) {
        let told = matches!(scene.verdict[track], Verdict::Static | Verdict::Moving);
        let given = self.motion.forms[track].clone().unwrap_or(Form::Static);
        let Some(member) = member else {
            scene.vectors.extend(std::iter::repeat_n([f64::NAN; D], given.len()));
            scene.start.push(scene.vectors.len());
            scene.forms.push(given);
            if let Some(block) = scene.covariance.get_mut(track) {
                block.clear();
            }
            return;
        };
        let fit = member.fit;
        let unknown = [f64::NAN; D];
        scene.vectors.extend(fit.vectors.iter().map(|p| if told { p.vector() } else { unknown }));
        scene.start.push(scene.vectors.len());
        scene.forms.push(fit.form.clone());
        let view = |o: u32| self.tracks.view()[o as usize] as usize;
        let kept = member.rows.iter().zip(&fit.keep).filter(|(_, keep)| **keep).map(|(&o, _)| self.time_s[view(o)]);
        let [first, last] = kept.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], t| [a.min(t), b.max(t)]);
        if first <= last {
            scene.seen_s[track] = [first, last];
        }
        if !told {
            if let Some(block) = scene.covariance.get_mut(track) {
                block.clear();
            }
            return;
        }
        let structure = &mut scene.structure;
        structure.track_component[track] = structure.view_component[view(member.rows[0])];
        let mut values = vec![0.0; fit.form.len()];
        let mut position = |time: f64| {
            fit.form.values(time, 0, &mut values);
            let sum = values.iter().zip(&fit.vectors).fold(Lanes::ZERO, |sum, (b, p)| sum.plus_scaled(*b, p));
            sum.vector::<D>()
        };
        structure.points[track] = position(if first <= last { 0.5 * (first + last) } else { 0.0 });
        for (&o, &keep) in member.rows.iter().zip(&fit.keep) {
            let (view, bearing) = (view(o), &self.tracks.bearing()[o as usize]);
            let along = sub(&position(self.time_s[view]), &structure.centers[view]);
            let direction = match self.cam_from_world {
                Some(_) => structure.cam_from_world[view].inverse().apply(bearing),
                None if self.motion.free_orientations => structure.cam_from_world[view].inverse().apply(bearing),
                None => *bearing,
            };
            structure.inlier[o as usize] = keep;
            structure.residual_rad[o as usize] = angle(&direction, &along);
        }
    }

    /// Hidden by another track, or imitated by the camera. `of_view` lists the observations of each view.
    fn why_loose(&self, of_view: &[Vec<u32>], track: usize, sigma: f64) -> Verdict {
        let mine = self.observations(track);
        let limit = HIDDEN_SIGMAS * sigma;
        let view = |o: u32| self.tracks.view()[o as usize];
        let is_near =
            |a: u32, b: u32| norm(&sub(&self.tracks.bearing()[a as usize], &self.tracks.bearing()[b as usize])) < limit;
        let Some(&first) = mine.first().filter(|_| mine.len() > 1) else { return Verdict::Undetermined };
        for &other in of_view[view(first) as usize].iter().filter(|&&o| is_near(o, first)) {
            let by = self.tracks.track()[other as usize];
            let theirs = self.observations(by as usize);
            let agrees = |&o: &u32| theirs.iter().any(|&same| view(same) == view(o) && is_near(same, o));
            if by as usize != track && mine.iter().all(agrees) {
                return Verdict::Hidden { by };
            }
        }
        Verdict::Imitated
    }
}

/// Bearings nearer than this many sigma, in all views, are those of tracks one behind the other.
const HIDDEN_SIGMAS: f64 = 6.0;

/// Angle between a unit vector and a direction.
fn angle<const D: usize>(unit: &Vector<D>, along: &Vector<D>) -> f64 {
    let length = norm(along).max(f64::MIN_POSITIVE);
    let chord: f64 = unit.iter().zip(along).map(|(v, u)| (v - u / length).powi(2)).sum::<f64>().sqrt();
    2.0 * (0.5 * chord).min(1.0).asin()
}

/// An answer in which nothing is determined yet.
fn nothing<const D: usize>(tracks: &Tracks<D>) -> Structure<D> {
    use crate::structure::{Summary, Timings};
    Structure {
        centers: vec![[f64::NAN; D]; tracks.n_views()],
        points: vec![[f64::NAN; D]; tracks.n_tracks()],
        view_component: vec![-1; tracks.n_views()],
        track_component: vec![-1; tracks.n_tracks()],
        inlier: vec![false; tracks.len()],
        residual_rad: vec![f64::NAN; tracks.len()],
        cam_from_world: vec![Rotation::identity(); tracks.n_views()],
        summary: Summary {
            status: Status::Undetermined,
            iterations: 0,
            sigma_rad: f64::NAN,
            n_components: 0,
            timings: Timings::default(),
        },
    }
}

/// Moves a scene, and all its paths, to the gauge asked for.
fn place<const D: usize>(scene: &mut MovingStructure<D>, options: &PositionOptions<D>) -> Result<(), PathError> {
    let resting: Vec<bool> = scene.verdict.iter().map(|v| *v == Verdict::Static).collect();
    let placed = place_structure(&mut scene.structure, |track| resting[track], &options.gauge)?;
    for (track, form) in scene.forms.iter().enumerate() {
        let Some(similarity) = usize::try_from(scene.structure.track_component[track]).ok().and_then(|c| placed.get(c))
        else {
            continue;
        };
        let rows = scene.start[track]..scene.start[track + 1];
        for (l, vector) in scene.vectors[rows].iter_mut().enumerate() {
            let turned = similarity.rotation.apply(vector).map(|x| similarity.scale * x);
            // functions add up to one, or begin with one
            let shifts = l == 0 || matches!(form, Form::Spline { .. });
            *vector = std::array::from_fn(|c| turned[c] + if shifts { similarity.translation[c] } else { 0.0 });
        }
        if let Some(block) = scene.covariance.get_mut(track).filter(|block| !block.is_empty()) {
            *block = turned_covariance(block, similarity.rotation.matrix(), similarity.scale);
        }
    }
    Ok(())
}

/// Covariance of vectors that are each turned and scaled.
fn turned_covariance<const D: usize>(block: &[f64], turn: &[[f64; D]; D], scale: f64) -> Vec<f64> {
    let n = block.len().isqrt();
    let half = |from: &dyn Fn(usize, usize) -> f64| -> Vec<f64> {
        let entry = |r: usize, c: usize| (0..D).map(|k| turn[r % D][k] * from(r / D * D + k, c)).sum::<f64>();
        (0..n * n).map(|i| scale * entry(i / n, i % n)).collect()
    };
    let left = half(&|r, c| block[r * n + c]);
    let both = half(&|r, c| left[c * n + r]);
    (0..n * n).map(|i| both[i % n * n + i / n]).collect()
}
