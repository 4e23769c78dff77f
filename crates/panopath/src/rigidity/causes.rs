//! Causes of what was found free, and of what is nearly so.

use super::conditions::{Cause, CauseKind, Flexibility, Members, Sightings, failing_conditions, name_causes};
use super::{Inquiry, LOOSE_POINT, LOOSE_VIEW, OrientationModel};
use crate::geometry::Vector;

/// Distance from a shape, relative to its size, at which members lie on it exactly.
const ON_SHAPE: f64 = 1e-7;
/// Members lie nearly on a shape within this many standard deviations of a bearing.
const NEARLY_SIGMAS: f64 = 30.0;
/// Pairs of a view and a point above which no such shape is looked for: nobody arranges so many.
const MANY_PAIRS: usize = 10_000;

/// All causes: of null modes first.
pub(super) fn find<const D: usize>(inquiry: &Inquiry<'_, D>, gauge_freedoms: usize) -> Vec<Cause> {
    let mut causes = Vec::new();
    if inquiry.nullity > gauge_freedoms || inquiry.components.len() != 1 {
        causes.extend(of_null_modes(inquiry, gauge_freedoms));
    }
    let mut weakened = inquiry.weakened.clone();
    weakened.sort_unstable();
    weakened.dedup();
    for component in weakened {
        causes.extend(of_weak_modes(inquiry, component));
    }
    causes.extend(loose_members(inquiry));
    causes
}

/// Names for what is exactly free.
fn of_null_modes<const D: usize>(inquiry: &Inquiry<'_, D>, gauge_freedoms: usize) -> Vec<Cause> {
    let known = |positions: &[Vector<D>]| -> Vec<Vector<D>> {
        positions.iter().map(|x| if x.iter().all(|v| v.is_finite()) { *x } else { [0.0; D] }).collect()
    };
    let (centers, points) = (known(inquiry.scene.centers), known(inquiry.scene.points));
    let counting = || (0..inquiry.counts.len()).filter(|&o| inquiry.counts[o]);
    let view: Vec<u32> = counting().map(|o| inquiry.scene.view[o]).collect();
    let track: Vec<u32> = counting().map(|o| inquiry.scene.track[o]).collect();
    let component_of_observation: Vec<i32> = counting().map(|o| inquiry.component_of_observation[o]).collect();
    let members = inquiry.components.iter();
    let members: Vec<Members> = members.map(|c| Members { views: c.views.clone(), tracks: c.tracks.clone() }).collect();
    let scene = Sightings { centers: &centers, points: &points, view: &view, track: &track };
    let found = Flexibility {
        nullity: inquiry.nullity,
        gauge_freedoms,
        component_of_observation: &component_of_observation,
        components: &members,
        free_orientation: inquiry.orientation != OrientationModel::Known,
    };
    name_causes(&scene, &found, ON_SHAPE.max(inquiry.null_below))
}

/// A component that is rigid, and perhaps ambiguous but for the noise: the shape that its members nearly lie on. A conic through
/// all of them, or two lines, is a reason however little of them is seen; other shapes are where every view sees every point.
fn of_weak_modes<const D: usize>(inquiry: &Inquiry<'_, D>, component: usize) -> Vec<Cause> {
    let found = &inquiry.components[component];
    let sees_all = found.n_observations == found.views.len() * found.tracks.len();
    let mut causes = Vec::new();
    if inquiry.orientation == OrientationModel::Known && found.views.len() * found.tracks.len() < MANY_PAIRS {
        let at = |ids: &[u32], x: &[Vector<D>]| -> Vec<Vector<D>> { ids.iter().map(|&i| x[i as usize]).collect() };
        let (centers, points) = (at(&found.views, inquiry.scene.centers), at(&found.tracks, inquiry.scene.points));
        causes = failing_conditions(&centers, &points, NEARLY_SIGMAS * inquiry.noise.sigma_rad);
        causes.retain(|cause| {
            sees_all || matches!(cause.kind, CauseKind::Conic | CauseKind::TwoLines1 | CauseKind::TwoLines2)
        });
        for cause in &mut causes {
            cause.views = cause.views.iter().map(|&v| found.views[v as usize]).collect();
            cause.tracks = cause.tracks.iter().map(|&t| found.tracks[t as usize]).collect();
            cause.components = vec![component as u32];
            cause.is_exact = false;
        }
    }
    if causes.is_empty() {
        let mut cause = Cause::new(CauseKind::Other, "");
        (cause.views, cause.tracks) = (found.views.clone(), found.tracks.clone());
        cause.components = vec![component as u32];
        cause.is_exact = false;
        causes.push(cause);
    }
    causes
}

/// Members that their rays hardly hold.
fn loose_members<const D: usize>(inquiry: &Inquiry<'_, D>) -> Vec<Cause> {
    let beyond = |looseness: &[f64], limit: f64| -> Vec<u32> {
        let loose = |k: &usize| looseness[*k] > limit && looseness[*k].is_finite();
        (0..looseness.len()).filter(loose).map(|k| k as u32).collect()
    };
    let mut causes = Vec::new();
    let (views, tracks) = (beyond(&inquiry.view_looseness, LOOSE_VIEW), beyond(&inquiry.track_looseness, LOOSE_POINT));
    if !views.is_empty() {
        let mut cause = Cause::new(CauseKind::Other, "held by little");
        (cause.views, cause.is_exact) = (views, false);
        causes.push(cause);
    }
    if !tracks.is_empty() {
        let mut cause = Cause::new(CauseKind::CameraCollinear, "");
        if let [track] = tracks[..] {
            let sees = |o: &usize| inquiry.counts[*o] && inquiry.scene.track[*o] == track;
            cause.views = (0..inquiry.counts.len()).filter(sees).map(|o| inquiry.scene.view[o]).collect();
            cause.views.sort_unstable();
        }
        (cause.tracks, cause.is_exact) = (tracks, false);
        causes.push(cause);
    }
    causes
}
