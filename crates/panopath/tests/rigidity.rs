//! The certificate against a dense null space: nullity, components and values; symmetries, threads, input that is no scene.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used)]

mod common;

use std::collections::BTreeSet;

use common::poses::{moved, some_similarity, structure, truth};
use common::*;
use panopath::geometry::{Rotation, Similarity, Vector, add, dot, norm, scale, sub, tangent_basis};
use panopath::least_squares::right_singular;
use panopath::positions::Structure;
use panopath::rigidity::conditions::CauseKind;
use panopath::rigidity::*;
use panopath::synthetic::{WeakMode, WorldKind, WorldOptions};
use panopath::tracks::Tracks;

use OrientationModel::{Free, Known, Vertical};

/// Views and tracks of a component.
type Members = (Vec<u32>, Vec<u32>);

/// Positions, and who sees whom.
#[derive(Clone, Default)]
struct Case<const D: usize> {
    centers: Vec<Vector<D>>,
    points: Vec<Vector<D>>,
    seen: Vec<(usize, usize)>,
}

impl<const D: usize> Case<D> {
    fn of_world(kind: WorldKind, o: &WorldOptions) -> Self {
        let world = simulate::<D>(kind, o);
        let ids = world.tracks.view().iter().zip(world.tracks.track());
        let seen = ids.map(|(&i, &j)| (i as usize, j as usize)).collect();
        Self { centers: world.centers, points: world.points, seen }
    }

    fn tracks(&self) -> Tracks<D> {
        see(&self.centers, &self.points, self.seen.iter().copied())
    }

    fn scene(&self) -> Structure<D> {
        structure(&vec![Rotation::identity(); self.centers.len()], &self.centers, &self.points)
    }

    /// A blob of views and points about a place, each point seen by some of the views; returns the ranges of the new ones.
    fn add_blob(
        &mut self,
        middle: Vector<D>,
        n_views: usize,
        n_points: usize,
        seed: u64,
    ) -> [std::ops::Range<usize>; 2] {
        let (v, p) = (self.centers.len(), self.points.len());
        self.centers.extend(places(n_views, &middle, 2.0, seed));
        self.points.extend(places(n_points, &middle, 3.0, seed + 1000));
        let mut noise = Noise::new(seed + 2000);
        for j in p..p + n_points {
            let order = noise.permutation(n_views);
            self.seen.extend(order[..n_views.min(6)].iter().map(|i| (v + i, j)));
        }
        [v..v + n_views, p..p + n_points]
    }
}

fn turn_axes(model: OrientationModel, d: usize) -> Vec<[f64; 3]> {
    match (model, d) {
        (Known, _) => vec![],
        (Free, 2) | (Vertical, _) => vec![[0.0, 0.0, 1.0]],
        (Free, _) => vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
    }
}

fn cross(a: &[f64; 3], x: &[f64]) -> [f64; 3] {
    let at = |k: usize| x.get(k).copied().unwrap_or(0.0);
    [a[1] * at(2) - a[2] * at(1), a[2] * at(0) - a[0] * at(2), a[0] * at(1) - a[1] * at(0)]
}

fn run<const D: usize>(case: &Case<D>, options: &CertifyOptions) -> Certificate<D> {
    certificate(&case.tracks(), &case.scene(), options)
}

fn certificate<const D: usize>(tracks: &Tracks<D>, scene: &Structure<D>, o: &CertifyOptions) -> Certificate<D> {
    // the second number of generics follows from the first
    let any: Box<dyn std::any::Any> = match D {
        2 => Box::new(certify::<2, 3>(downcast(tracks), downcast(scene), o).unwrap()),
        _ => Box::new(certify::<3, 6>(downcast(tracks), downcast(scene), o).unwrap()),
    };
    *any.downcast().unwrap()
}

fn downcast<A: 'static, B: 'static>(x: &A) -> &B {
    (x as &dyn std::any::Any).downcast_ref().unwrap()
}

fn options(orientation: OrientationModel) -> CertifyOptions {
    CertifyOptions { orientation, sigma_rad: Some(1e-9), ..Default::default() }
}

// ---- the reference: all displacements of the views, by singular values ----------------------------------------------

struct Reference {
    nullity: usize,
    components: BTreeSet<Members>,
    /// Values of modes that are not null, ascending.
    values: Vec<f64>,
}

/// The rows that all observations of a point leave on the unknowns of the views, the point following, and what it does.
struct Eliminated<const D: usize> {
    rows: Vec<Vec<f64>>,
    /// Displacement of the point that each unknown of its views brings about.
    follows: Vec<Vector<D>>,
    slides: Vec<Vector<D>>,
}

/// Unknowns: of each view its turns, then its shift.
fn eliminate<const D: usize>(case: &Case<D>, axes: &[[f64; 3]], j: usize, viewers: &[usize]) -> Eliminated<D> {
    let width = axes.len() + D;
    let n = width * case.centers.len();
    let (mut of_views, mut of_point) = (Vec::new(), Vec::new());
    for &i in viewers {
        let u = sub(&case.points[j], &case.centers[i]);
        let (v, r) = (scale(1.0 / norm(&u), &u), norm(&u));
        for t in &tangent_basis(&v)[..D - 1] {
            let mut row = vec![0.0; n];
            for (k, axis) in axes.iter().enumerate() {
                row[i * width + k] = -(0..D).map(|c| cross(axis, &v)[c] * t[c]).sum::<f64>();
            }
            (0..D).for_each(|c| row[i * width + axes.len() + c] = -t[c] / r);
            of_views.push(row);
            of_point.push(scale(1.0 / r, t));
        }
    }
    let n_rows = of_point.len();
    let (values, axes_of_point) = right_singular(D, &of_point.concat()).unwrap();
    let held: Vec<usize> = (0..D).filter(|&k| values[k] > 1e-9 * values[0]).collect();
    let left: Vec<Vec<f64>> = held
        .iter()
        .map(|&k| {
            of_point.iter().map(|b| (0..D).map(|c| b[c] * axes_of_point[k][c]).sum::<f64>() / values[k]).collect()
        })
        .collect();
    let transposed: Vec<f64> = left.concat();
    let complement = right_singular(n_rows, &transposed).unwrap().1.split_off(held.len());
    let combined = |weights: &Vec<f64>| -> Vec<f64> {
        (0..n).map(|c| (0..n_rows).map(|r| weights[r] * of_views[r][c]).sum()).collect()
    };
    let follows = (0..n)
        .map(|c| {
            held.iter().zip(&left).fold([0.0; D], |sum, (&k, u)| {
                let pull = -(0..n_rows).map(|r| u[r] * of_views[r][c]).sum::<f64>() / values[k];
                std::array::from_fn(|d| sum[d] + pull * axes_of_point[k][d])
            })
        })
        .collect();
    let slides = (0..D).filter(|k| !held.contains(k)).map(|k| std::array::from_fn(|c| axes_of_point[k][c])).collect();
    Eliminated { rows: complement.iter().map(combined).collect(), follows, slides }
}

/// The frame of the certificate: centroid of the views at zero, rms distance one.
fn in_frame<const D: usize>(case: &Case<D>) -> Case<D> {
    let n = case.centers.len() as f64;
    let middle = case.centers.iter().fold([0.0; D], |sum, c| add(&sum, &scale(1.0 / n, c)));
    let size = path_size(&case.centers);
    let place = |x: &Vector<D>| scale(1.0 / size, &sub(x, &middle));
    Case {
        centers: case.centers.iter().map(place).collect(),
        points: case.points.iter().map(place).collect(),
        seen: case.seen.clone(),
    }
}

fn reference<const D: usize>(case: &Case<D>, model: OrientationModel) -> Reference {
    let case = in_frame(case);
    let axes = turn_axes(model, D);
    let n = (axes.len() + D) * case.centers.len();
    let mut viewers: Vec<Vec<usize>> = vec![Vec::new(); case.points.len()];
    case.seen.iter().for_each(|&(i, j)| viewers[j].push(i));
    let asked: Vec<usize> = (0..case.points.len()).filter(|&j| !viewers[j].is_empty()).collect();
    let eliminated: Vec<Eliminated<D>> = asked.iter().map(|&j| eliminate(&case, &axes, j, &viewers[j])).collect();
    let entries: Vec<f64> = eliminated.iter().flat_map(|e| e.rows.iter().flatten().copied()).collect();
    let (mut values, mut vectors) = right_singular(n, &entries).unwrap();
    values.reverse();
    vectors.reverse();
    let unit = (case.seen.len() as f64 / case.centers.len() as f64).sqrt();
    values.iter_mut().for_each(|v| *v /= unit);
    let n_null = values.iter().take_while(|v| **v < 1e-9).count();
    assert!(values.iter().all(|v| *v < 1e-11 || *v > 1e-8), "no clear answer: {:?}", &values[..n_null + 2]);
    let slides: usize = eliminated.iter().map(|e| e.slides.len()).sum();
    Reference {
        nullity: n_null + slides,
        components: components(&case, &axes, &asked, &eliminated, &vectors[..n_null]),
        values: values.split_off(n_null),
    }
}

/// Sets of observations that every null vector moves by one similarity.
fn components<const D: usize>(
    case: &Case<D>,
    axes: &[[f64; 3]],
    asked: &[usize],
    eliminated: &[Eliminated<D>],
    null: &[Vec<f64>],
) -> BTreeSet<Members> {
    let width = axes.len() + D;
    let mut noise = Noise::new(7);
    // one number for each observation: equal where all rates are, but for chance
    let mut key = vec![0.0; case.seen.len()];
    let mut add_mode = |x: &[f64], slide: Option<(usize, Vector<D>)>| {
        let weights: Vec<f64> = (0..1 + width).map(|_| noise.normal()).collect();
        let moved = |j: usize| -> Vector<D> {
            let Ok(place) = asked.binary_search(&j) else { return [0.0; D] };
            let follows = &eliminated[place].follows;
            let start = slide.filter(|s| s.0 == j).map_or([0.0; D], |s| s.1);
            (0..x.len()).filter(|&c| x[c] != 0.0).fold(start, |sum, c| add(&sum, &scale(x[c], &follows[c])))
        };
        let moved: Vec<Vector<D>> = (0..case.points.len()).map(moved).collect();
        for (key, &(i, j)) in key.iter_mut().zip(&case.seen) {
            let (u, own) = (sub(&case.points[j], &case.centers[i]), &x[i * width..(i + 1) * width]);
            let dc: Vector<D> = std::array::from_fn(|c| own[axes.len() + c]);
            let stretch = dot(&u, &sub(&moved[j], &dc)) / dot(&u, &u);
            let turn = axes.iter().zip(own).fold([0.0; 3], |s, (a, w)| std::array::from_fn(|c| s[c] + w * a[c]));
            let turned = cross(&turn, &case.centers[i]);
            *key += weights[0] * stretch;
            (0..axes.len()).for_each(|k| *key += weights[1 + k] * own[k]);
            (0..D)
                .for_each(|c| *key += weights[1 + axes.len() + c] * (dc[c] - stretch * case.centers[i][c] - turned[c]));
        }
    };
    null.iter().for_each(|x| add_mode(x, None));
    for (&j, e) in asked.iter().zip(eliminated) {
        e.slides.iter().for_each(|s| add_mode(&vec![0.0; width * case.centers.len()], Some((j, *s))));
    }
    let mut order: Vec<usize> = (0..key.len()).collect();
    order.sort_by(|&a, &b| key[a].total_cmp(&key[b]));
    let sets = order.chunk_by(|&a, &b| key[b] - key[a] < 1e-6).filter(|set| set.len() > 1);
    sets.map(|set| {
        let ids = |of: &dyn Fn(usize) -> usize| -> Vec<u32> {
            set.iter().map(|&o| of(o) as u32).collect::<BTreeSet<u32>>().into_iter().collect()
        };
        (ids(&|o| case.seen[o].0), ids(&|o| case.seen[o].1))
    })
    .collect()
}

fn members<const D: usize>(found: &Certificate<D>) -> BTreeSet<Members> {
    found.components.iter().map(|c| (c.views.clone(), c.tracks.clone())).collect()
}

/// Nullity and components are those of the reference; so are the values, where the scene is one piece without loose ends.
fn agree<const D: usize>(case: &Case<D>, model: OrientationModel, is_one_piece: bool) -> Certificate<D> {
    let expected = reference(case, model);
    let found = run(case, &options(model));
    assert_eq!(found.nullity, expected.nullity, "nullity");
    assert_eq!(found.gauge_freedoms, D + 1 + turn_axes(model, D).len());
    assert_eq!(members(&found), expected.components, "components");
    assert_eq!(found.verdict == Verdict::Undetermined, found.nullity > found.gauge_freedoms, "{:?}", found.verdict);
    if is_one_piece {
        let (found, wanted) = (found.first_other, expected.values[0]);
        // a value that is far from zero has no need to settle
        assert!(found > (1.0 - 1e-6) * wanted && found < 1.04 * wanted, "first value {found}, expected {wanted}");
    }
    found
}

/// The weakest values, all of them asked for.
fn values_agree<const D: usize>(case: &Case<D>, model: OrientationModel) {
    let expected = reference(case, model);
    let all = CertifyOptions { weak_movement: 1e-300, ..options(model) };
    let found = run(case, &all);
    let values: Vec<f64> = found.modes.iter().map(|mode| mode.value).collect();
    assert!(values.len() >= 5, "{} modes", values.len());
    for (k, (value, wanted)) in values.iter().zip(&expected.values).enumerate() {
        // what is firmly held has no need to settle
        let limit = if k < 3 { 1.06 } else { f64::INFINITY };
        let within = *value > (1.0 - 1e-6) * wanted && *value < limit * wanted;
        assert!(within, "value {k} is {value}, expected {wanted}");
    }
}

// ---- large scenes ---------------------------------------------------------------------------------------------------

/// Enough views for the factorised system, few enough for the reference.
fn large(model: OrientationModel, d: usize) -> usize {
    200usize.div_ceil(d + turn_axes(model, d).len())
}

#[test]
fn streets_and_rooms_have_the_modes_of_the_dense_matrix() {
    for kind in [WorldKind::Street, WorldKind::Room] {
        for model in [Known, Free, Vertical] {
            let o = common::options(large(model, 3), 170, 5);
            let case = Case::<3>::of_world(kind, &o);
            let found = agree(&case, model, true);
            assert_eq!(found.components.len(), 1, "{} {model:?}", kind.name());
            values_agree(&case, model);
        }
    }
}

#[test]
fn so_have_planar_scenes() {
    for model in [Known, Free] {
        let o = WorldOptions { min_views: Some(5), ..common::options(large(model, 2), 300, 6) };
        let case = Case::<2>::of_world(WorldKind::Street, &o);
        agree(&case, model, true);
        values_agree(&case, model);
    }
}

#[test]
fn points_that_are_fewer_stay_in_the_system() {
    for model in [Known, Free, Vertical] {
        let n = large(model, 3);
        let case = Case {
            centers: places(n, &[0.0; 3], 2.0, 1),
            points: places(12, &[1.0, 0.0, 0.0], 4.0, 2),
            seen: all_pairs(n, 12).filter(|(i, j)| (i + 3 * j) % 7 != 0).collect(),
        };
        let found = agree(&case, model, true);
        assert_eq!(found.verdict, Verdict::Determined);
        values_agree(&case, model);
    }
}

/// Parts of three views, the last of each the first of the next; every track lives in one part only.
fn windows<const D: usize>(n_parts: usize) -> Case<D> {
    let centers = places(2 * n_parts + 1, &[0.0; D], 1.0, 3);
    let mut case = Case::<D> { centers, ..Case::default() };
    for (i, center) in case.centers.iter_mut().enumerate() {
        center[0] += i as f64;
    }
    for k in 0..n_parts {
        let middle = std::array::from_fn(|c| if c == 0 { 2.0 * k as f64 + 1.0 } else { 0.0 });
        let first = case.points.len();
        case.points.extend(places(9, &middle, 4.0, 100 + k as u64));
        case.seen.extend((first..first + 9).flat_map(|j| (2 * k..2 * k + 3).map(move |i| (i, j))));
    }
    case
}

#[test]
fn windows_are_as_many_components_as_there_are() {
    for n_parts in [3, 12, 40] {
        for model in [Known, Free, Vertical] {
            let found = agree(&windows::<3>(n_parts), model, true);
            assert_eq!(found.components.len(), n_parts, "{model:?}");
            assert_eq!(found.nullity, found.gauge_freedoms + n_parts - 1, "a scale for each {model:?}");
            assert!(found.causes.iter().any(|c| c.kind == CauseKind::WeakJoin), "{:?}", found.causes);
        }
        for model in [Known, Free] {
            let found = agree(&windows::<2>(n_parts), model, true);
            assert_eq!((found.components.len(), found.nullity), (n_parts, found.gauge_freedoms + n_parts - 1));
        }
    }
}

#[test]
fn very_many_windows_are_all_counted() {
    for n_parts in [160, 300] {
        let found = run(&windows::<3>(n_parts), &options(Known));
        assert_eq!((found.nullity, found.components.len()), (4 + n_parts - 1, n_parts));
        assert_eq!(found.modes.len(), 12, "not all are written out");
    }
}

/// Two blobs far apart, without anything between them.
fn two_blobs<const D: usize>(model: OrientationModel) -> (Case<D>, [[std::ops::Range<usize>; 2]; 2]) {
    let mut case = Case::<D>::default();
    let n = large(model, D) / 2 + 1;
    let a = case.add_blob([0.0; D], n, 80, 11);
    let b = case.add_blob(std::array::from_fn(|c| if c == 0 { 9.0 } else { 1.0 }), n, 80, 12);
    (case, [a, b])
}

fn hinges<const D: usize>(model: OrientationModel) {
    let (case, [a, b]) = two_blobs::<D>(model);
    let turns = turn_axes(model, D).len();
    // a view that sees enough of both
    let mut at_view = case.clone();
    at_view.seen.extend(b[1].clone().take(6).map(|j| (a[0].start, j)));
    let found = agree(&at_view, model, true);
    assert_eq!((found.components.len(), found.nullity), (2, found.gauge_freedoms + 1), "at a view, {model:?}");
    let mut at_point = case.clone();
    at_point.seen.extend(b[0].clone().take(6).map(|i| (i, a[1].start)));
    let found = agree(&at_point, model, true);
    assert_eq!((found.components.len(), found.nullity), (2, found.gauge_freedoms + 1 + turns), "at a point, {model:?}");
    for found in [run(&at_view, &options(model)), found] {
        assert!(found.causes.iter().any(|c| c.kind == CauseKind::WeakJoin), "{:?}", found.causes);
    }
    let apart = agree(&case, model, false);
    assert_eq!((apart.components.len(), apart.nullity), (2, 2 * apart.gauge_freedoms));
    assert!(apart.causes.iter().any(|c| c.kind == CauseKind::Disconnected));
}

#[test]
fn hinges_at_a_view_and_at_a_point() {
    for model in [Known, Free, Vertical] {
        hinges::<3>(model);
    }
    for model in [Known, Free] {
        hinges::<2>(model);
    }
}

#[test]
fn each_two_view_track_takes_one_freedom_of_a_join() {
    for (model, needed) in [(Known, 4), (Vertical, 5), (Free, 7)] {
        let (case, [a, b]) = two_blobs::<3>(model);
        for n_tracks in 1..=needed + 1 {
            let mut joined = case.clone();
            for k in 0..n_tracks {
                let j = joined.points.len();
                joined.points.extend(places::<3>(1, &[4.0, 3.0, -2.0], 3.0, 50 + k as u64));
                joined.seen.extend([(a[0].start + k, j), (b[0].start + k, j)]);
            }
            let found = agree(&joined, model, true);
            let free = needed.saturating_sub(n_tracks);
            assert_eq!(found.nullity, found.gauge_freedoms + free, "{n_tracks} tracks, {model:?}");
            assert_eq!(found.components.len(), if free > 0 { 2 } else { 1 });
        }
    }
}

#[test]
fn loose_ends_are_counted_and_left_out() {
    for model in [Known, Free, Vertical] {
        let mut case = Case::<3>::of_world(WorldKind::Street, &common::options(large(model, 3), 170, 5));
        let (m, n) = (case.centers.len(), case.points.len());
        case.points.extend(places::<3>(3, &[4.0; 3], 3.0, 9));
        case.seen.extend([(0, n), (1, n + 1), (2, n + 2)]);
        case.centers.extend(places::<3>(2, &[2.0; 3], 1.0, 8));
        case.seen.extend([(m, 0), (m + 1, 0), (m + 1, 1)]);
        let found = agree(&case, model, false);
        let turns = turn_axes(model, 3).len();
        // two views with one ray and two: known orientation fixes the second
        let of_views = 3 + turns - 2 + (3 + turns).saturating_sub(4);
        assert_eq!(found.nullity, found.gauge_freedoms + 3 + of_views);
        let looks = |j: usize| norm(&found.track_line[j]);
        assert!((n..n + 3).all(|j| (looks(j) - 1.0).abs() < 1e-12), "points with one ray may move along it");
        assert!((0..n).all(|j| found.track_line[j][0].is_nan()));
    }
}

#[test]
fn a_chain_of_two_view_tracks_has_a_scale_at_every_link() {
    let o = WorldOptions { weak_mode: Some(WeakMode::Chain), ..common::options(70, 700, 4) };
    let case = Case::<3>::of_world(WorldKind::Weak, &o);
    let found = agree(&case, Known, true);
    assert_eq!(found.nullity, 4 + 68);
    assert_eq!(found.components.len(), 69);
}

#[test]
fn points_at_infinity_hold_orientations_and_no_positions() {
    for model in [Known, Free, Vertical] {
        let base = common::options(large(model, 3), 240, 5);
        let near = Case::<3>::of_world(WorldKind::Street, &base);
        let far = WorldOptions { infinity_fraction: 0.3, ..base };
        let found = run(&Case::<3>::of_world(WorldKind::Street, &far), &options(model));
        let without = run(&near, &options(model));
        assert_eq!((found.nullity, found.components.len()), (without.nullity, 1), "{model:?}");
        // rays that are parallel to the last bit leave the distance of their point free
        let parallel = WorldOptions { infinity_distance: (1e17, 1e18), ..far };
        let found = run(&Case::<3>::of_world(WorldKind::Street, &parallel), &options(model));
        assert!(found.components[0].views.len() == large(model, 3), "{model:?}");
    }
}

// ---- what must not matter -------------------------------------------------------------------------------------------

/// Scenes with several of everything, for what must hold always.
fn several() -> Vec<(Tracks<3>, Structure<3>)> {
    let noisy = |kind, o: WorldOptions| {
        let world = simulate::<3>(kind, &WorldOptions { noise_rad: 1e-3, ..o });
        (world.tracks.clone(), truth(&world))
    };
    let exact = |case: Case<3>| (case.tracks(), case.scene());
    vec![
        noisy(WorldKind::Street, common::options(90, 900, 1)),
        noisy(WorldKind::Room, common::options(20, 60, 2)),
        exact(windows(14)),
        exact(two_blobs::<3>(Known).0),
    ]
}

fn text<const D: usize>(found: &Certificate<D>) -> String {
    format!("{found:?}")
}

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    for (k, (tracks, scene)) in several().into_iter().enumerate() {
        for model in [Known, Free, Vertical] {
            let o = CertifyOptions { orientation: model, weak_movement: 1e-3, ..Default::default() };
            let on = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                text(&pool.install(|| certify::<3, 6>(&tracks, &scene, &o).unwrap()))
            };
            let one = on(1);
            for threads in [1, 2, 3] {
                assert!(on(threads) == one, "scene {k}, {model:?}, {threads} threads");
            }
        }
    }
}

/// What a change of unit, frame or order leaves as it is.
fn assert_same<const D: usize>(found: &Certificate<D>, expected: &Certificate<D>, unit: f64, what: &str) {
    assert_eq!((found.nullity, found.verdict), (expected.nullity, expected.verdict), "{what}");
    assert_eq!(members(found), members(expected), "{what}");
    let kinds =
        |c: &Certificate<D>| c.causes.iter().map(|c| (c.kind, c.views.len(), c.tracks.len())).collect::<Vec<_>>();
    assert_eq!(kinds(found), kinds(expected), "{what}");
    let close = |a: f64, b: f64| a == b || (a - b).abs() < 1e-3 * b.abs() || (a.is_nan() && b.is_nan());
    // firm modes, and firm points, are looked for no longer than it takes to see that they are firm
    let near = |a: f64, b: f64| close(a, b) || (a - b).abs() < 2e-2 * b;
    for (a, b) in found.components.iter().zip(&expected.components) {
        assert!(near(a.weakest_movement, b.weakest_movement), "{what}: {a:?}, expected {b:?}");
    }
    let looseness = |c: &Certificate<D>| [c.view_looseness.clone(), c.track_looseness.clone()].concat();
    for (k, (a, b)) in looseness(found).into_iter().zip(looseness(expected)).enumerate() {
        assert!(near(a, b), "{what}: looseness {k} is {a}, expected {b}");
    }
    for (a, b) in found.modes.iter().zip(&expected.modes).filter(|(a, _)| !a.is_null).take(3) {
        assert!(close(a.value, b.value) && close(a.movement, b.movement), "{what}: {} {}", a.value, b.value);
        let length = |m: &ReportedMode<D>| m.views.iter().chain(&m.points).map(|x| dot(x, x)).sum::<f64>().sqrt();
        assert!(close(length(a), unit * length(b)), "{what}: {}, expected {}", length(a), unit * length(b));
    }
}

#[test]
fn scale_shift_turn_and_order_do_not_matter() {
    for (k, (tracks, scene)) in several().into_iter().enumerate() {
        for model in [Known, Free, Vertical] {
            let o = CertifyOptions { orientation: model, weak_movement: 1e-3, sigma_rad: Some(1e-4) };
            let expected = certify::<3, 6>(&tracks, &scene, &o).unwrap();
            let resized = |s: f64| Similarity { scale: s, ..Similarity::identity() };
            let mut turn = some_similarity::<3>(3);
            if model == Vertical {
                turn.rotation = Rotation::exp(&[0.0, 0.0, 2.0]);
            }
            let path = path_size(&scene.centers);
            let far = Similarity { translation: [300.0 * path, -200.0 * path, 100.0 * path], ..Similarity::identity() };
            for (what, by) in [("small", resized(1e-9)), ("large", resized(1e9)), ("turned", turn), ("far", far)] {
                let found = certify::<3, 6>(&tracks, &moved(&scene, &by), &o).unwrap();
                assert_same(&found, &expected, by.scale, &format!("scene {k}, {model:?}, {what}"));
            }
            let order = Noise::new(5).permutation(tracks.len());
            let pick = |ids: &[u32]| -> Vec<u32> { order.iter().map(|&o| ids[o]).collect() };
            let bearing = order.iter().map(|&o| tracks.bearing()[o]).collect();
            let (view, track) = (pick(tracks.view()), pick(tracks.track()));
            let shuffled = Tracks::new(view, track, bearing, None, tracks.n_views(), tracks.n_tracks()).unwrap();
            let found = certify::<3, 6>(&shuffled, &scene, &o).unwrap();
            assert_same(&found, &expected, 1.0, &format!("scene {k}, {model:?}, shuffled"));
            let own: Vec<i32> = order.iter().map(|&o| expected.component_of_observation[o]).collect();
            assert_eq!(found.component_of_observation, own);
        }
    }
}

#[test]
fn seen_twice_counts_once_and_sigmas_count_by_their_ratio() {
    let case = Case::<3>::of_world(WorldKind::Room, &common::options(20, 60, 2));
    let (tracks, scene, o) = (case.tracks(), case.scene(), options(Known));
    let once = certificate(&tracks, &scene, &o);
    let mut twice = case.clone();
    twice.seen.extend(case.seen.iter().rev());
    let found = run(&twice, &o);
    assert_same(&found, &once, 1.0, "twice");
    assert_eq!(found.counts, [vec![true; tracks.len()], vec![false; tracks.len()]].concat());
    let with = |sigma: f64| {
        let (view, track, bearing) = (tracks.view().to_vec(), tracks.track().to_vec(), tracks.bearing().to_vec());
        Tracks::new(view, track, bearing, Some(vec![sigma; tracks.len()]), 20, 60).unwrap()
    };
    for (sigma, option) in [(1e-4, None), (1e-2, Some(1e-4))] {
        let found = certificate(&with(sigma), &scene, &CertifyOptions { sigma_rad: option, ..o });
        let expected = certificate(&tracks, &scene, &CertifyOptions { sigma_rad: Some(1e-4), ..o });
        assert_same(&found, &expected, 1.0, "one sigma for all");
        assert_eq!(found.sigma_source, if option.is_some() { SigmaSource::Given } else { SigmaSource::Tracks });
    }
}

// ---- input that is hardly a scene -----------------------------------------------------------------------------------

#[test]
fn what_is_not_known_does_not_count() {
    let case = Case::<3>::of_world(WorldKind::Room, &common::options(20, 60, 2));
    let (tracks, scene, o) = (case.tracks(), case.scene(), options(Known));
    let whole = certificate(&tracks, &scene, &o);
    assert_eq!(whole.verdict, Verdict::Determined);
    let mut holes = scene.clone();
    (holes.centers[3], holes.points[5]) = ([f64::NAN; 3], [0.0, f64::INFINITY, 0.0]);
    holes.view_component[3] = -1;
    let found = certificate(&tracks, &holes, &o);
    assert_eq!((found.components[0].views.len(), found.components[0].tracks.len()), (19, 59));
    assert_eq!(found.verdict, Verdict::Determined, "one of twenty may be left out");
    assert!(found.view_looseness[3].is_nan() && found.track_looseness[5].is_nan());
    holes.centers[4] = [f64::NAN; 3];
    assert_eq!(certificate(&tracks, &holes, &o).verdict, Verdict::Weak, "two of twenty may not");
    let mut masked = scene.clone();
    masked.inlier = (0..tracks.len()).map(|k| tracks.view()[k] != 7).collect();
    let found = certificate(&tracks, &masked, &o);
    assert!(!found.components[0].views.contains(&7));
    assert_eq!(found.counts, masked.inlier);
}

#[test]
fn nothing_is_undetermined() {
    let (nobody, none) = (see::<3>(&[], &[], []), structure::<3>(&[], &[], &[]));
    let empty = see::<3>(&[[0.0; 3]; 2], &[[1.0; 3]; 3], []);
    let unseen = structure(&[Rotation::identity(); 2], &[[0.0; 3]; 2], &[[1.0; 3]; 3]);
    for model in [Known, Free, Vertical] {
        for (tracks, scene) in [(&nobody, &none), (&empty, &unseen)] {
            let found = certify::<3, 6>(tracks, scene, &options(model)).unwrap();
            assert_eq!((found.verdict, found.components.len()), (Verdict::Undetermined, 0));
            assert!(found.modes.is_empty() && found.first_other.is_nan());
        }
        let case = Case::<3>::of_world(WorldKind::Room, &common::options(20, 60, 2));
        let lost = structure(&[Rotation::identity(); 20], &[[f64::NAN; 3]; 20], &[[f64::NAN; 3]; 60]);
        let found = certify::<3, 6>(&case.tracks(), &lost, &options(model)).unwrap();
        assert_eq!((found.verdict, found.components.len()), (Verdict::Undetermined, 0));
    }
}

#[test]
fn members_in_one_place_and_extreme_sizes_are_no_matter() {
    let room = Case::<3>::of_world(WorldKind::Room, &common::options(20, 60, 2));
    for model in [Known, Free, Vertical] {
        let mut at_one = room.clone();
        at_one.centers.fill([1.0, 2.0, 3.0]);
        assert_eq!(run(&at_one, &options(model)).verdict, Verdict::Undetermined, "views in one place");
        let mut at_one = room.clone();
        at_one.points.fill([1.0, 2.0, 3.0]);
        assert_eq!(run(&at_one, &options(model)).verdict, Verdict::Undetermined, "points in one place");
        let mut all = at_one.clone();
        all.centers.fill([1.0, 2.0, 3.0]);
        let found = certify::<3, 6>(&room.tracks(), &all.scene(), &options(model)).unwrap();
        assert_eq!((found.verdict, found.components.len()), (Verdict::Undetermined, 0), "all in one place");
        let mut meeting = room.clone();
        let (i, j) = meeting.seen[0];
        meeting.points[j] = meeting.centers[i];
        let found = certify::<3, 6>(&room.tracks(), &meeting.scene(), &options(model)).unwrap();
        assert_eq!(found.verdict, Verdict::Determined, "a view at a point");
        for size in [1e-200, 1e-100, 1e100, 1e200, 1e300] {
            let by = Similarity { scale: size, ..Similarity::identity() };
            let found = certify::<3, 6>(&room.tracks(), &moved(&room.scene(), &by), &options(model)).unwrap();
            assert!(found.verdict == Verdict::Determined || found.components.is_empty(), "size {size:e}, {model:?}");
        }
    }
}

#[test]
fn what_does_not_fit_together_is_named() {
    let case = Case::<3>::of_world(WorldKind::Room, &common::options(4, 10, 2));
    let (tracks, scene, o) = (case.tracks(), case.scene(), options(Known));
    let error = |scene: &Structure<3>, o: &CertifyOptions| certify::<3, 6>(&tracks, scene, o).unwrap_err().to_string();
    let changed = |change: &dyn Fn(&mut Structure<3>)| {
        let mut other = scene.clone();
        change(&mut other);
        error(&other, &o)
    };
    let n = tracks.len();
    assert_eq!(changed(&|s| s.centers.truncate(3)), "centers has 3 entries, expected 4");
    assert_eq!(changed(&|s| s.view_component.push(0)), "view_component has 5 entries, expected 4");
    assert_eq!(changed(&|s| s.points.clear()), "points has 0 entries, expected 10");
    assert_eq!(changed(&|s| s.track_component.truncate(9)), "track_component has 9 entries, expected 10");
    assert_eq!(changed(&|s| s.cam_from_world.truncate(1)), "cam_from_world has 1 entries, expected 4");
    assert_eq!(changed(&|s| s.inlier = vec![true]), format!("inlier has 1 entries, expected {n}"));
    assert_eq!(changed(&|s| s.residual_rad = vec![0.0; 2]), format!("residual_rad has 2 entries, expected {n}"));
    for sigma in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let said = error(&scene, &CertifyOptions { sigma_rad: Some(sigma), ..o });
        assert_eq!(said, format!("sigma_rad is {sigma}, expected a positive number"));
        let said = error(&scene, &CertifyOptions { weak_movement: sigma, ..o });
        assert_eq!(said, format!("weak_movement is {sigma}, expected a positive number"));
    }
    let flat = Case::<2>::of_world(WorldKind::Room, &common::options(6, 10, 2));
    let said = certify::<2, 3>(&flat.tracks(), &flat.scene(), &options(Vertical)).unwrap_err().to_string();
    assert_eq!(said, "the vertical tells nothing in the plane, expected known or free");
}
