//! The certificate: what of a scene is determined by who saw whom, what is not, and how well.
//!
//! The bearing-rigidity matrix maps displacements of views and points to turns of the observed segments,
//! `P_ij (dX_j - q_ij) / r_ij`, with `q_ij` the displacement of view `i` as seen from point `j` (a turn of the view takes part
//! in it where orientations are free). Its null space at a scene holds the gauge; every further dimension is a family of
//! scenes with the same bearings. Rigid components follow from the stretch rates of the segments (`stretch`); with noise,
//! a mode of energy `E` moves by `sigma / sqrt(E)` at one standard deviation.
//!
//! Who saw whom and where all are is everything that counts: measured bearings do not enter. Members that hang loose by
//! themselves are left out first (`ends`); each connected rest is looked at in a frame of its own, and each rigid
//! component in turn.

mod causes;
pub mod conditions;
mod ends;
mod frame;
mod looseness;
mod noise;
mod options;
mod placing;
mod spectrum;
mod stretch;

use crate::bundle::determinacy::{GaugeBasis, Motions};
use crate::bundle::noise::{OUTLIER_SIGMAS, SIGMA_FLOOR_RAD, precisions};
use crate::geometry::{Vector, norm, normalized, scale, sub};
use crate::least_squares::symmetric_eigen;
use crate::sets::Sets;
use crate::structure::Structure;
use crate::tracks::Tracks;

pub use noise::SigmaSource;
pub use options::{CertifyError, CertifyOptions, OrientationModel};

use conditions::Cause;
use frame::Frame;
use noise::Noise;
use placing::place_together;
use spectrum::{Analysis, Mobility, Mode, Shifting, Turning};
use stretch::{BodyMotion, Motion, PARALLEL};

/// Positions, and who saw whom.
struct Sightings<'a, const D: usize> {
    /// Of all views.
    pub centers: &'a [Vector<D>],
    /// Of all tracks.
    pub points: &'a [Vector<D>],
    /// View of each observation.
    pub view: &'a [u32],
    /// Track of each observation.
    pub track: &'a [u32],
    /// Precision of each observation relative to one of median sigma.
    pub precision: Option<&'a [f64]>,
}

/// How far a component, or a whole scene, can be believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Unique up to the gauge, and noise moves it little.
    Determined,
    /// Unique, but noise moves it far, or hides whether it is.
    Weak,
    /// Other scenes have the same bearings.
    Undetermined,
}

impl Verdict {
    /// The name used in files and in Python.
    pub fn name(self) -> &'static str {
        match self {
            Self::Determined => "determined",
            Self::Weak => "weak",
            Self::Undetermined => "undetermined",
        }
    }
}

/// A maximal set of views and points that is determined up to one common similarity.
#[derive(Debug, Clone, PartialEq)]
pub struct RigidComponent {
    /// Views, ascending. A hinge is a member of more than one component.
    pub views: Vec<u32>,
    /// Tracks, ascending.
    pub tracks: Vec<u32>,
    /// Observations between them.
    pub n_observations: usize,
    /// How far it can be believed.
    pub verdict: Verdict,
    /// Movement of the weakest mode at one standard deviation, as a share of the size.
    pub weakest_movement: f64,
}

/// A way in which the scene moves, for nothing or for little.
#[derive(Debug, Clone, PartialEq)]
pub struct ReportedMode<const D: usize> {
    /// Rms angle by which rays turn where the views move by their size, radians.
    pub value: f64,
    /// Do the bearings not resist at all?
    pub is_null: bool,
    /// Rms movement of the views at one standard deviation, as a share of their size; infinite where null.
    pub movement: f64,
    /// The component that moves in itself, or that the others are seen from.
    pub component: Option<u32>,
    /// Of each view, in the unit of the scene: at one standard deviation, or of the size of the scene where null.
    pub views: Vec<Vector<D>>,
    /// Of each point.
    pub points: Vec<Vector<D>>,
    /// Of each view: its turn in the world, radians.
    pub turns: Vec<[f64; 3]>,
}

/// What is determined in a scene, and how well.
#[derive(Debug, Clone, PartialEq)]
pub struct Certificate<const D: usize> {
    /// Of the whole scene.
    pub verdict: Verdict,
    /// Dimension of the null space of the bearing-rigidity matrix.
    pub nullity: usize,
    /// What a determined scene has.
    pub gauge_freedoms: usize,
    /// Largest value of a mode that counts as null (zero where there is none beyond the gauge).
    pub last_null: f64,
    /// Smallest value of one that does not; NaN where there is none.
    pub first_other: f64,
    /// Largest first.
    pub components: Vec<RigidComponent>,
    /// Component of each observation of the input, -1 where it stands alone or does not count.
    pub component_of_observation: Vec<i32>,
    /// Null modes beyond the gauge, then weak ones, weakest first; not all where there are very many.
    pub modes: Vec<ReportedMode<D>>,
    /// Why something is not determined, or not well.
    pub causes: Vec<Cause>,
    /// Which observations count: one for each pair of a view and a point with known positions.
    pub counts: Vec<bool>,
    /// Angular standard deviation that the verdict is for.
    pub sigma_rad: f64,
    /// Where it comes from.
    pub sigma_source: SigmaSource,
    /// Direction in which a view may move alone; NaN where it may not.
    pub view_line: Vec<Vector<D>>,
    /// The same for points.
    pub track_line: Vec<Vector<D>>,
    /// Standard deviation of each view against those it shares tracks with, as a share of its distance from them.
    pub view_looseness: Vec<f64>,
    /// Standard deviation of each point, its views held, as a share of its distance.
    pub track_looseness: Vec<f64>,
}

/// Modes with a value below this are null: what is left of them is rounding.
const NULL_VALUE: f64 = 1e-9;
/// What residuals of this size say about a scene counts as rounding too: it comes from a solver that stopped.
const ROUNDING_RAD: f64 = 1e-7;
/// Such a scene has modes that are null but for this multiple of its residuals.
const ROUNDING_MULTIPLE: f64 = 30.0;
/// An exact ambiguity seen through noise has at most this energy, in units of what noise gives it on average: the first where
/// very many segments share in it, and more, by the second over the root of their number, where few do.
const NOISE_MULTIPLE: (f64, f64) = (1.5, 75.0);
/// Modes, the weakest, that are tested for being such an ambiguity.
const NOISE_MODES: usize = 3;
/// A view whose standard deviation is beyond this share of its distance from its neighbours is held loosely.
pub const LOOSE_VIEW: f64 = 0.1;
/// A point whose standard deviation is beyond this share of its distance is.
pub const LOOSE_POINT: f64 = 0.2;
/// Share of points that may hang loose in a determined component of few points.
const LOOSE_POINTS: f64 = 0.05;
/// The same in one of many: a walk has points straight ahead, and points that were seen only while it stood still.
const LOOSE_OF_MANY: f64 = 0.3;
/// Points from which on there are many.
const MANY_POINTS: usize = 100;
/// Share of the views, and of the tracks, with observations that a determined scene may leave out.
const LEFT_OUT: f64 = 0.05;
/// A mode that moves by more than this at one standard deviation is followed, to see whether it gets weaker on its way.
const FOLLOWED_MOVEMENT: f64 = 0.005;
/// It does where its value falls below this share: what is ambiguous to first order alone is a double root, which noise
/// takes apart by the root of itself.
const WEAKER: f64 = 0.85;
/// Most modes written out.
const MOST_REPORTED: usize = 12;

/// Says what of a scene is determined.
///
/// Observations count where the scene calls them inliers (all where `scene.inlier` is empty) and their view and point
/// belong to the same part; a view that saw a track more than once counts once.
///
/// # Errors
/// [`CertifyError`] where the arguments do not fit together.
///
/// # Example
/// ```
/// use panopath::positions::{PositionOptions, solve_positions};
/// use panopath::rigidity::{CertifyOptions, Verdict, certify};
/// use panopath::synthetic::{WorldKind, WorldOptions, simulate};
/// let options = WorldOptions { n_views: 8, n_points: 60, ..Default::default() };
/// let world = simulate::<3>(WorldKind::Box, &options)?;
/// let scene = solve_positions(&world.tracks, Some(&world.cam_from_world), &PositionOptions::default())?;
/// let certificate = certify::<3, 6>(&world.tracks, &scene, &CertifyOptions::default())?;
/// assert_eq!((certificate.nullity, certificate.gauge_freedoms), (4, 4));
/// assert_eq!(certificate.verdict, Verdict::Determined);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn certify<const D: usize, const V: usize>(
    tracks: &Tracks<D>,
    scene: &Structure<D>,
    options: &CertifyOptions,
) -> Result<Certificate<D>, CertifyError> {
    const { assert!((D == 2 || D == 3) && V == D * (D + 1) / 2) }
    check(tracks, scene, options)?;
    let precision = precisions(tracks).map(|(_, precision)| precision);
    let mut counts = observations_that_count(tracks, scene);
    let noise = Noise::of(tracks, scene, &counts, options, axes::<D>(options.orientation).len());
    let mut placed = None;
    if options.orientation == OrientationModel::Known {
        // members of parts that were solved apart meet here
        let found = place_together(tracks, scene, OUTLIER_SIGMAS * noise.sigma_rad.max(SIGMA_FLOOR_RAD));
        counts.iter_mut().zip(&found.ties).for_each(|(counts, ties)| *counts |= ties);
        placed = Some(found);
    }
    let (centers, points) = placed.as_ref().map_or((&scene.centers, &scene.points), |p| (&p.centers, &p.points));
    let sightings =
        Sightings { centers, points, view: tracks.view(), track: tracks.track(), precision: precision.as_deref() };
    let mut inquiry = Inquiry::new(sightings, counts, noise, options);
    let observations: Vec<u32> = (0..tracks.len() as u32).filter(|&o| inquiry.counts[o as usize]).collect();
    match options.orientation {
        OrientationModel::Known => inquiry.examine::<D, Shifting>(&observations)?,
        _ => inquiry.examine::<V, Turning>(&observations)?,
    }
    Ok(inquiry.conclude())
}

fn check<const D: usize>(
    tracks: &Tracks<D>,
    scene: &Structure<D>,
    options: &CertifyOptions,
) -> Result<(), CertifyError> {
    let (n_views, n_tracks, n) = (tracks.n_views(), tracks.n_tracks(), tracks.len());
    let inliers = if scene.inlier.is_empty() { n } else { scene.inlier.len() };
    let residuals = if scene.residual_rad.is_empty() { n } else { scene.residual_rad.len() };
    for (name, found, expected) in [
        ("centers", scene.centers.len(), n_views),
        ("view_component", scene.view_component.len(), n_views),
        ("points", scene.points.len(), n_tracks),
        ("track_component", scene.track_component.len(), n_tracks),
        ("cam_from_world", scene.cam_from_world.len(), n_views),
        ("inlier", inliers, n),
        ("residual_rad", residuals, n),
    ] {
        if found != expected {
            return Err(CertifyError::Length { name, found, expected });
        }
    }
    if let Some(sigma) = options.sigma_rad.filter(|s| !(s.is_finite() && *s > 0.0)) {
        return Err(CertifyError::Option(format!("sigma_rad is {sigma}, expected a positive number")));
    }
    if !(options.weak_movement.is_finite() && options.weak_movement > 0.0) {
        let found = options.weak_movement;
        return Err(CertifyError::Option(format!("weak_movement is {found}, expected a positive number")));
    }
    if D == 2 && options.orientation == OrientationModel::Vertical {
        return Err(CertifyError::Option("the vertical tells nothing in the plane, expected known or free".to_owned()));
    }
    Ok(())
}

/// Inliers between members of one part, one for each pair.
fn observations_that_count<const D: usize>(tracks: &Tracks<D>, scene: &Structure<D>) -> Vec<bool> {
    let finite = |x: &Vector<D>| x.iter().all(|v| v.is_finite());
    let view_part: Vec<i32> =
        scene.view_component.iter().zip(&scene.centers).map(|(&c, x)| if finite(x) { c } else { -1 }).collect();
    let track_part: Vec<i32> =
        scene.track_component.iter().zip(&scene.points).map(|(&c, x)| if finite(x) { c } else { -1 }).collect();
    let mut counts: Vec<bool> = (0..tracks.len())
        .map(|o| {
            let part = view_part[tracks.view()[o] as usize];
            part >= 0 && part == track_part[tracks.track()[o] as usize] && (scene.inlier.is_empty() || scene.inlier[o])
        })
        .collect();
    // sorted input needs no table: pairs are looked for among the observations of a track
    let mut seen = std::collections::HashSet::new();
    let mut last = None;
    let is_sorted = (0..tracks.len()).all(|o| {
        let pair = (tracks.track()[o], tracks.view()[o]);
        let ascends = last.is_none_or(|l| l < pair);
        last = Some(pair);
        ascends
    });
    if !is_sorted {
        for (o, count) in counts.iter_mut().enumerate().filter(|(_, count)| **count) {
            *count = seen.insert((tracks.track()[o], tracks.view()[o]));
        }
    }
    counts
}

/// A component with a weak mode, and who moves in it.
struct Weakened {
    component: usize,
    views: Vec<u32>,
    tracks: Vec<u32>,
}

impl Weakened {
    /// Members that move by a good share of what the fastest view does; all where most do.
    fn by<const D: usize>(component: usize, frame: &Frame<D>, motion: &Motion<D>) -> Self {
        const GOOD_SHARE: f64 = 0.3;
        let fastest = motion.views.iter().map(norm).fold(0.0, f64::max);
        let moves = |moved: &Vector<D>| norm(moved) >= GOOD_SHARE * fastest;
        let most = 2 * motion.views.iter().filter(|dx| moves(dx)).count() > frame.views.len();
        let moving = |moved: &[Vector<D>], ids: &[u32]| -> Vec<u32> {
            let mut moving: Vec<u32> =
                ids.iter().zip(moved).filter(|(_, dx)| most || moves(dx)).map(|(id, _)| *id).collect();
            moving.sort_unstable();
            moving
        };
        let (views, tracks) = (moving(&motion.views, &frame.views), moving(&motion.points, &frame.part.input_track));
        Self { component, views, tracks }
    }
}

/// The certificate as it grows, part by part.
struct Inquiry<'a, const D: usize> {
    scene: Sightings<'a, D>,
    counts: Vec<bool>,
    noise: Noise,
    orientation: OrientationModel,
    weak_movement: f64,
    null_below: f64,
    nullity: usize,
    last_null: f64,
    first_other: f64,
    components: Vec<RigidComponent>,
    component_of_observation: Vec<i32>,
    modes: Vec<ReportedMode<D>>,
    /// Modes of components that noise moves far, or takes for an ambiguity.
    weakened: Vec<Weakened>,
    view_line: Vec<Vector<D>>,
    track_line: Vec<Vector<D>>,
    view_looseness: Vec<f64>,
    track_looseness: Vec<f64>,
}

impl<'a, const D: usize> Inquiry<'a, D> {
    fn new(scene: Sightings<'a, D>, counts: Vec<bool>, noise: Noise, options: &CertifyOptions) -> Self {
        let (n_views, n_tracks) = (scene.centers.len(), scene.points.len());
        let rounding = if noise.residual_rad < ROUNDING_RAD { ROUNDING_MULTIPLE * noise.residual_rad } else { 0.0 };
        Self {
            component_of_observation: vec![-1; scene.view.len()],
            scene,
            counts,
            noise,
            orientation: options.orientation,
            weak_movement: options.weak_movement,
            null_below: NULL_VALUE.max(rounding),
            nullity: 0,
            last_null: 0.0,
            first_other: f64::NAN,
            components: Vec::new(),
            modes: Vec::new(),
            weakened: Vec::new(),
            view_line: vec![[f64::NAN; D]; n_views],
            track_line: vec![[f64::NAN; D]; n_tracks],
            view_looseness: vec![f64::NAN; n_views],
            track_looseness: vec![f64::NAN; n_tracks],
        }
    }

    /// Turns that a view is free to make, by its unknowns.
    fn absent<const W: usize>(&self) -> [bool; W] {
        std::array::from_fn(|k| self.orientation == OrientationModel::Vertical && k < W - D && k + 1 != W - D)
    }

    fn axes(&self) -> Vec<[f64; 3]> {
        axes::<D>(self.orientation)
    }

    fn gauge_freedoms(&self) -> usize {
        D + 1 + self.axes().len()
    }

    fn unknowns_of_a_view(&self) -> usize {
        D + self.axes().len()
    }

    /// Looks at one part of the scene: what hangs loose, then each connected rest.
    fn examine<const W: usize, M: Mobility<D, W>>(&mut self, observations: &[u32]) -> Result<(), CertifyError> {
        let ends = ends::without_ends(&self.scene, observations, self.unknowns_of_a_view());
        self.nullity += ends.freedoms;
        self.point_along_single_rays(observations, &ends.core);
        for piece in connected(&self.scene, &ends.core) {
            self.examine_piece::<W, M>(&piece)?;
        }
        Ok(())
    }

    /// A member with one ray may move along it.
    fn point_along_single_rays(&mut self, observations: &[u32], core: &[u32]) {
        let mut inside = vec![false; self.scene.view.len()];
        core.iter().for_each(|&o| inside[o as usize] = true);
        let mut rays = vec![0u32; self.scene.centers.len() + self.scene.points.len()];
        let n_views = self.scene.centers.len();
        for &o in observations {
            rays[self.scene.view[o as usize] as usize] += 1;
            rays[n_views + self.scene.track[o as usize] as usize] += 1;
        }
        for &o in observations.iter().filter(|&&o| !inside[o as usize]) {
            let (view, track) = (self.scene.view[o as usize] as usize, self.scene.track[o as usize] as usize);
            let ray = normalized(&sub(&self.scene.points[track], &self.scene.centers[view]));
            if rays[n_views + track] == 1 {
                self.track_line[track] = ray;
                self.track_looseness[track] = f64::INFINITY;
            }
            if rays[view] == 1 && self.orientation == OrientationModel::Known {
                self.view_line[view] = ray;
            }
        }
    }

    fn gauge_of<const W: usize>(&self, frame: &Frame<D>) -> GaugeBasis {
        let axes = self.axes();
        let motions = Motions { translation: true, axes: &axes, scale: true };
        GaugeBasis::new(motions.of_cameras::<D, W>(&frame.estimate.centers, &[0.0; D]))
    }

    fn lay_out(&self, observations: &[u32]) -> Option<Frame<D>> {
        Frame::lay_out(&self.scene, observations, self.unknowns_of_a_view(), self.gauge_freedoms())
    }

    /// Looks at one connected set of observations without loose ends.
    fn examine_piece<const W: usize, M: Mobility<D, W>>(&mut self, observations: &[u32]) -> Result<(), CertifyError> {
        let Some(frame) = self.lay_out(observations) else { return Ok(()) };
        let gauge = self.gauge_of::<W>(&frame);
        let analysis = Analysis::<D, W, M>::new(&frame, self.absent::<W>(), &gauge);
        let modes = analysis.modes(self.null_below)?;
        let n_null = modes.iter().take_while(|mode| mode.value < self.null_below).count();
        let slides: Vec<usize> =
            (0..frame.part.n_tracks()).filter(|&j| frame.slides(j, self.parallel_below())).collect();
        self.nullity += gauge.len() + n_null + slides.len();
        self.note_gap(&modes[..n_null], modes.get(n_null));
        for &j in &slides {
            let track = frame.part.input_track[j] as usize;
            self.track_line[track] = frame.part.ray[frame.part.start[j] as usize].vector();
            self.track_looseness[track] = f64::INFINITY;
        }
        if n_null == 0 && slides.is_empty() {
            if let [component] = self.add_components(&frame, &vec![0; frame.part.n_observations()])[..] {
                self.judge_component(component, &analysis, &modes)?;
            }
            return Ok(());
        }
        let own = stretch::components::<D, W>(&frame, &modes[..n_null], &slides);
        let found = self.add_components(&frame, &own);
        self.report_null_modes::<W>(&frame, &modes[..n_null], &own, &found, &slides);
        for component in found {
            self.examine_component::<W, M>(component)?;
        }
        Ok(())
    }

    /// Views nearer to one line with their point fix no distance.
    fn parallel_below(&self) -> f64 {
        PARALLEL.max(self.null_below)
    }

    fn note_gap(&mut self, null: &[Mode], first_other: Option<&Mode>) {
        self.last_null = null.iter().map(|mode| mode.value).fold(self.last_null, f64::max);
        if let Some(mode) = first_other {
            self.first_other = self.first_other.min(mode.value);
        }
    }

    /// Writes down the components of a frame, by the label of each of its observations; returns their numbers.
    fn add_components(&mut self, frame: &Frame<D>, own: &[i32]) -> Vec<usize> {
        let n = own.iter().copied().max().map_or(0, |largest| (largest + 1) as usize);
        let first = self.components.len();
        let mut views: Vec<Vec<u32>> = vec![Vec::new(); n];
        let mut tracks: Vec<Vec<u32>> = vec![Vec::new(); n];
        let mut count = vec![0usize; n];
        for j in 0..frame.part.n_tracks() {
            for o in frame.part.observations(j).filter(|&o| own[o] >= 0) {
                let k = own[o] as usize;
                count[k] += 1;
                views[k].push(frame.views[frame.part.node_of(o) as usize]);
                if tracks[k].last() != Some(&frame.part.input_track[j]) {
                    tracks[k].push(frame.part.input_track[j]);
                }
                self.component_of_observation[frame.part.input_observation[o] as usize] = (first + k) as i32;
            }
        }
        for ((mut views, mut tracks), n_observations) in views.into_iter().zip(tracks).zip(count) {
            for members in [&mut views, &mut tracks] {
                members.sort_unstable();
                members.dedup();
            }
            self.components.push(RigidComponent {
                views,
                tracks,
                n_observations,
                verdict: Verdict::Determined,
                weakest_movement: 0.0,
            });
        }
        (first..first + n).collect()
    }

    /// Looks at one of several components by itself.
    fn examine_component<const W: usize, M: Mobility<D, W>>(&mut self, component: usize) -> Result<(), CertifyError> {
        let members = |o: &u32| self.component_of_observation[*o as usize] == component as i32;
        let observations: Vec<u32> = (0..self.scene.view.len() as u32).filter(members).collect();
        let Some(frame) = self.lay_out(&observations) else { return Ok(()) };
        let gauge = self.gauge_of::<W>(&frame);
        let analysis = Analysis::<D, W, M>::new(&frame, self.absent::<W>(), &gauge);
        let modes = analysis.modes(self.null_below)?;
        self.judge_component(component, &analysis, &modes)
    }

    /// What noise does to a component that is rigid.
    fn judge_component<const W: usize, M: Mobility<D, W>>(
        &mut self,
        component: usize,
        analysis: &Analysis<'_, D, W, M>,
        modes: &[Mode],
    ) -> Result<(), CertifyError> {
        let frame = analysis.frame;
        let sigma = self.noise.sigma_rad;
        let mut verdict = Verdict::Determined;
        for (k, mode) in modes.iter().enumerate() {
            let movement = sigma / (mode.value * (frame.part.n_observations() as f64).sqrt());
            if mode.value < self.null_below {
                verdict = Verdict::Undetermined;
                continue;
            }
            let found = &mut self.components[component];
            found.weakest_movement = found.weakest_movement.max(movement);
            let near_null = k < NOISE_MODES
                && (is_noise::<D, W>(frame, mode, sigma)
                    || (W > D && movement > FOLLOWED_MOVEMENT && gets_weaker(analysis, modes, k, movement)?));
            if movement > self.weak_movement || near_null {
                verdict = verdict.max(Verdict::Weak);
                let mut motion = Motion::of::<W>(frame, &mode.step);
                self.report(frame, mode, movement, component, &motion);
                motion.settle(frame);
                self.weakened.push(Weakened::by(component, frame, &motion));
            }
        }
        let views = if verdict == Verdict::Undetermined {
            vec![f64::INFINITY; frame.views.len()]
        } else {
            looseness::of_views(analysis)?
        };
        let mut loose_views = 0;
        for (&view, looseness) in frame.views.iter().zip(views) {
            let slot = &mut self.view_looseness[view as usize];
            // a hinge is as firm as its firmest component makes it
            *slot = slot.min(looseness * sigma);
            loose_views += usize::from(looseness * sigma > LOOSE_VIEW);
        }
        let mut loose_points = 0;
        for (&track, looseness) in frame.part.input_track.iter().zip(looseness::of_points(frame)) {
            let slot = &mut self.track_looseness[track as usize];
            *slot = slot.min(looseness * sigma);
            loose_points += usize::from(looseness.is_nan() || looseness * sigma > LOOSE_POINT);
        }
        let n_points = frame.part.n_tracks();
        let loose_share = if n_points < MANY_POINTS { LOOSE_POINTS } else { LOOSE_OF_MANY };
        if loose_views > 0 || loose_points as f64 > loose_share * n_points as f64 {
            verdict = verdict.max(Verdict::Weak);
        }
        self.components[component].verdict = verdict;
        Ok(())
    }

    /// Null modes as they are seen from the largest component, and the lines along which members may move alone.
    fn report_null_modes<const W: usize>(
        &mut self,
        frame: &Frame<D>,
        null: &[Mode],
        own: &[i32],
        found: &[usize],
        slides: &[usize],
    ) {
        let largest = (0..found.len()).max_by_key(|&k| {
            let c = &self.components[found[k]];
            (c.views.len() + c.tracks.len(), std::cmp::Reverse(k))
        });
        let (views, tracks) = largest.map_or((Vec::new(), Vec::new()), |k| members_of(frame, own, k as i32));
        let alone = alone(frame, own);
        let mut scatter_of_views = vec![[[0.0; D]; D]; frame.views.len()];
        let mut scatter_of_points = vec![[[0.0; D]; D]; frame.part.n_tracks()];
        for mode in null {
            let mut motion = Motion::of::<W>(frame, &mode.step);
            motion.relative_to(&BodyMotion::of(frame, &motion, &views, &tracks), frame);
            for (sum, dx) in scatter_of_views.iter_mut().zip(&motion.views) {
                add_outer(sum, dx);
            }
            for (sum, dx) in scatter_of_points.iter_mut().zip(&motion.points) {
                add_outer(sum, dx);
            }
            let component = largest.map_or(0, |k| found[k]);
            self.report(frame, mode, f64::INFINITY, component, &motion);
        }
        for (node, _) in alone.0.iter().enumerate().filter(|(_, alone)| **alone) {
            self.view_line[frame.views[node] as usize] = principal(&scatter_of_views[node]);
        }
        for (j, _) in alone.1.iter().enumerate().filter(|(j, alone)| **alone && slides.binary_search(j).is_err()) {
            self.track_line[frame.part.input_track[j] as usize] = principal(&scatter_of_points[j]);
        }
    }

    /// Writes a mode out in the unit of the scene.
    fn report(&mut self, frame: &Frame<D>, mode: &Mode, movement: f64, component: usize, motion: &Motion<D>) {
        if self.modes.len() >= MOST_REPORTED {
            return;
        }
        let is_null = movement.is_infinite();
        let amplitude = if is_null { 1.0 / motion.rms().max(f64::MIN_POSITIVE) } else { movement };
        let mut written = ReportedMode {
            value: mode.value,
            is_null,
            movement,
            component: self.components.get(component).map(|_| component as u32),
            views: vec![[0.0; D]; self.scene.centers.len()],
            points: vec![[0.0; D]; self.scene.points.len()],
            turns: vec![[0.0; 3]; self.scene.centers.len()],
        };
        let scaled = |dx: &Vector<D>| scale(amplitude * frame.size, dx);
        for ((&view, dx), turn) in frame.views.iter().zip(&motion.views).zip(&motion.turns) {
            written.views[view as usize] = scaled(dx);
            written.turns[view as usize] = turn.map(|x| x * amplitude);
        }
        for (&track, dx) in frame.part.input_track.iter().zip(&motion.points) {
            written.points[track as usize] = scaled(dx);
        }
        self.modes.push(written);
    }

    /// Are there views or tracks with observations, more than a few, that the scene has no place for?
    fn leaves_out_many(&self) -> bool {
        let are_out = |of: &[u32], n: usize| {
            let (mut asked, mut placed) = (vec![false; n], vec![false; n]);
            for (o, &member) in of.iter().enumerate() {
                asked[member as usize] = true;
                placed[member as usize] |= self.counts[o];
            }
            let count = |flags: &[bool]| flags.iter().filter(|f| **f).count();
            (count(&asked) - count(&placed)) as f64 > LEFT_OUT * count(&asked) as f64
        };
        are_out(self.scene.view, self.scene.centers.len()) || are_out(self.scene.track, self.scene.points.len())
    }

    /// Puts the components in order and draws the conclusion.
    fn conclude(mut self) -> Certificate<D> {
        let mut order: Vec<usize> = (0..self.components.len()).collect();
        order.sort_by_key(|&k| {
            let c = &self.components[k];
            (usize::MAX - c.views.len(), usize::MAX - c.tracks.len(), c.views.first().copied())
        });
        let mut place = vec![0i32; order.len()];
        for (new, &old) in order.iter().enumerate() {
            place[old] = new as i32;
        }
        for label in self.component_of_observation.iter_mut().filter(|label| **label >= 0) {
            *label = place[*label as usize];
        }
        for weakened in &mut self.weakened {
            weakened.component = place[weakened.component] as usize;
        }
        for mode in &mut self.modes {
            mode.component = mode.component.map(|c| place[c as usize] as u32);
        }
        self.modes.sort_by(|a, b| b.is_null.cmp(&a.is_null).then(b.movement.total_cmp(&a.movement)));
        let gauge_freedoms = self.gauge_freedoms();
        let weakest = self.components.iter().map(|c| c.verdict).max().unwrap_or(Verdict::Undetermined);
        let verdict = if self.nullity > gauge_freedoms || self.components.len() != 1 {
            Verdict::Undetermined
        } else if self.leaves_out_many() {
            weakest.max(Verdict::Weak)
        } else {
            weakest
        };
        self.components = order.iter().map(|&k| self.components[k].clone()).collect();
        let causes = causes::find(&self, gauge_freedoms);
        Certificate {
            verdict,
            nullity: self.nullity,
            gauge_freedoms,
            last_null: self.last_null,
            first_other: self.first_other,
            components: self.components,
            component_of_observation: self.component_of_observation,
            modes: self.modes,
            causes,
            counts: self.counts,
            sigma_rad: self.noise.sigma_rad,
            sigma_source: self.noise.source,
            view_line: self.view_line,
            track_line: self.track_line,
            view_looseness: self.view_looseness,
            track_looseness: self.track_looseness,
        }
    }
}

/// Does the mode cost less at scenes that lie within three standard deviations along it?
fn gets_weaker<const D: usize, const W: usize, M: Mobility<D, W>>(
    analysis: &Analysis<'_, D, W, M>,
    modes: &[Mode],
    k: usize,
    movement: f64,
) -> Result<bool, CertifyError> {
    for sigmas in [-3.0, -2.0, -1.0, 1.0, 2.0, 3.0] {
        let moved = analysis.frame.moved::<W>(&modes[k].step, sigmas * movement);
        let there = Analysis::<D, W, M>::new(&moved, analysis.absent, analysis.gauge);
        if there.least_among(modes)? < WEAKER * modes[0].value {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Axes that a view may turn about; in the plane the first entry counts.
fn axes<const D: usize>(orientation: OrientationModel) -> Vec<[f64; 3]> {
    let about = |c: usize| std::array::from_fn(|k| f64::from(u8::from(k == c)));
    match (orientation, D) {
        (OrientationModel::Known, _) => Vec::new(),
        (OrientationModel::Free, 3) => (0..3).map(about).collect(),
        (OrientationModel::Free, _) => vec![about(0)],
        (OrientationModel::Vertical, _) => vec![about(2)],
    }
}

/// Could the mode be an exact ambiguity seen through noise? A deformation that stretches segment `(i, j)` by `lambda_ij`
/// turns it, at positions that err by the noise, by about `sigma lambda_ij`. The mean over a track is taken off: a scale of
/// its own leaves the directions of one track exact.
fn is_noise<const D: usize, const W: usize>(frame: &Frame<D>, mode: &Mode, sigma: f64) -> bool {
    let part = &frame.part;
    let followers = frame.followers::<W>(&mode.step);
    let (mut spread, mut fourth) = (0.0, 0.0);
    for (j, follower) in followers.iter().enumerate() {
        let rate = |o: usize| {
            let u = frame.segment(o, j);
            u.dot::<D>(&follower.minus(&frame.origin_shift::<W>(&mode.step, o, j))) / u.dot::<D>(&u)
        };
        let observations = part.observations(j);
        let mean = observations.clone().map(rate).sum::<f64>() / observations.len() as f64;
        for squared in observations.map(|o| (rate(o) - mean).powi(2)) {
            spread += squared;
            fourth += squared * squared;
        }
    }
    let sharing = (D - 1) as f64 * spread * spread / f64::max(fourth, f64::MIN_POSITIVE);
    let energy = mode.value * mode.value * part.n_observations() as f64;
    energy < noise_multiple(sharing) * (D - 1) as f64 * sigma * sigma * spread
}

/// How far above its average the energy that noise gives to an ambiguity may lie.
fn noise_multiple(sharing: f64) -> f64 {
    NOISE_MULTIPLE.0 + NOISE_MULTIPLE.1 / sharing.max(1.0).sqrt()
}

/// Nodes and tracks of the frame in a component.
fn members_of<const D: usize>(frame: &Frame<D>, own: &[i32], component: i32) -> (Vec<usize>, Vec<usize>) {
    let (mut views, mut tracks) = (Vec::new(), Vec::new());
    for j in 0..frame.part.n_tracks() {
        for o in frame.part.observations(j).filter(|&o| own[o] == component) {
            views.push(frame.part.node_of(o) as usize);
            tracks.push(j);
        }
    }
    for members in [&mut views, &mut tracks] {
        members.sort_unstable();
        members.dedup();
    }
    (views, tracks)
}

/// Nodes and tracks that belong to no component.
fn alone<const D: usize>(frame: &Frame<D>, own: &[i32]) -> (Vec<bool>, Vec<bool>) {
    let (mut views, mut tracks) = (vec![true; frame.views.len()], vec![true; frame.part.n_tracks()]);
    for j in 0..frame.part.n_tracks() {
        for o in frame.part.observations(j).filter(|&o| own[o] >= 0) {
            views[frame.part.node_of(o) as usize] = false;
            tracks[j] = false;
        }
    }
    (views, tracks)
}

fn add_outer<const D: usize>(sum: &mut [[f64; D]; D], x: &Vector<D>) {
    for r in 0..D {
        for c in 0..D {
            sum[r][c] += x[r] * x[c];
        }
    }
}

/// The direction of most scatter; NaN of none.
fn principal<const D: usize>(scatter: &[[f64; D]; D]) -> Vector<D> {
    match symmetric_eigen(scatter) {
        Ok((values, vectors)) if values[D - 1] > 0.0 => vectors[D - 1],
        _ => [f64::NAN; D],
    }
}

/// Connected sets of observations.
fn connected<const D: usize>(scene: &Sightings<'_, D>, observations: &[u32]) -> Vec<Vec<u32>> {
    let n_views = scene.centers.len();
    let mut sets = Sets::new(n_views + scene.points.len());
    for &o in observations {
        sets.join(scene.view[o as usize] as usize, n_views + scene.track[o as usize] as usize);
    }
    let mut pieces: std::collections::BTreeMap<usize, Vec<u32>> = std::collections::BTreeMap::new();
    for &o in observations {
        pieces.entry(sets.find(scene.view[o as usize] as usize)).or_default().push(o);
    }
    pieces.into_values().collect()
}
