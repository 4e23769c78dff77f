//! Conditions of uniqueness from geometry, against the rank of the rigidity matrix; named causes, against its null space.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

use panopath::geometry::{Rotation, Vector, add, dot, norm, scale, sub, tangent_basis};
use panopath::least_squares::right_singular;
use panopath::rigidity::conditions::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const TOLERANCE: f64 = 1e-9;

// ---- the reference: dense null space, stretch rates -----------------------------------------------------------------

/// Null vectors of the rigidity matrix: centres, then points, then turns of the views (one axis in space: the vertical).
fn null_space<const D: usize>(scene: &Sightings<'_, D>, turns: usize) -> Vec<Vec<f64>> {
    let (m, n) = (scene.centers.len(), scene.points.len());
    let columns = D * (m + n) + turns * m;
    let mut rows = Vec::new();
    for (&i, &j) in scene.view.iter().zip(scene.track) {
        let (i, j) = (i as usize, j as usize);
        let u = sub(&scene.points[j], &scene.centers[i]);
        let length = norm(&u);
        let v = scale(1.0 / length, &u);
        for t in tangent_basis(&v).iter().take(D - 1) {
            let mut row = vec![0.0; columns];
            for c in 0..D {
                row[D * (m + j) + c] = t[c] / length;
                row[D * i + c] = -t[c] / length;
            }
            // the bearing of a camera that turns by w: d = (dx / r) - w x v
            for k in 0..turns {
                row[D * (m + n) + turns * i + k] = if D == 2 {
                    -(t[1] * v[0] - t[0] * v[1])
                } else {
                    let axis = if turns == 1 { 2 } else { k };
                    let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
                    -(v[a] * t[b] - v[b] * t[a])
                };
            }
            rows.extend(row);
        }
    }
    let (values, vectors) = right_singular(columns, &rows).unwrap();
    let largest = values[0].max(1e-300);
    values.iter().zip(vectors).filter(|(value, _)| **value <= 1e-9 * largest).map(|(_, vector)| vector).collect()
}

struct Found {
    nullity: usize,
    gauge_freedoms: usize,
    component: Vec<i32>,
    components: Vec<Members>,
    free_orientation: bool,
}

/// Rigid components by stretch rates (and turns), from the dense null space.
fn flexibility<const D: usize>(scene: &Sightings<'_, D>, free_orientation: bool) -> Found {
    turning(scene, if free_orientation { D * (D - 1) / 2 } else { 0 })
}

fn turning<const D: usize>(scene: &Sightings<'_, D>, turns: usize) -> Found {
    let basis = null_space(scene, turns);
    let (m, n, n_obs) = (scene.centers.len(), scene.points.len(), scene.view.len());
    let signature: Vec<Vec<f64>> = (0..n_obs)
        .map(|o| {
            let (i, j) = (scene.view[o] as usize, scene.track[o] as usize);
            let u = sub(&scene.points[j], &scene.centers[i]);
            let rate =
                |x: &Vec<f64>| (0..D).map(|c| u[c] * (x[D * (m + j) + c] - x[D * i + c])).sum::<f64>() / dot(&u, &u);
            let turn = |x: &Vec<f64>| x[D * (m + n) + turns * i..D * (m + n) + turns * (i + 1)].to_vec();
            basis.iter().flat_map(|x| [vec![rate(x)], turn(x)].concat()).collect()
        })
        .collect();
    let alike = |a: usize, b: usize| {
        let (share, far) = (scene.view[a] == scene.view[b] || scene.track[a] == scene.track[b], 1e-7);
        share && signature[a].iter().zip(&signature[b]).all(|(x, y)| (x - y).abs() < far)
    };
    let mut group: Vec<usize> = (0..n_obs).collect();
    loop {
        let mut changed = false;
        for a in 0..n_obs {
            for b in 0..n_obs {
                if group[a] > group[b] && alike(a, b) {
                    group[a] = group[b];
                    changed = true;
                }
            }
        }
        if !changed {
            break;
        }
    }
    let mut component = vec![-1; n_obs];
    let mut components = Vec::new();
    for g in 0..n_obs {
        let members: Vec<usize> = (0..n_obs).filter(|&o| group[o] == g).collect();
        if members.len() > 1 {
            let sorted = |ids: &[u32]| {
                let mut ids: Vec<u32> = members.iter().map(|&o| ids[o]).collect();
                ids.sort_unstable();
                ids.dedup();
                ids
            };
            members.iter().for_each(|&o| component[o] = components.len() as i32);
            components.push(Members { views: sorted(scene.view), tracks: sorted(scene.track) });
        }
    }
    // members that nothing observes have freedoms of their own, which are no question here
    let unseen = (0..m as u32).filter(|i| !scene.view.contains(i)).count()
        + (0..n as u32).filter(|j| !scene.track.contains(j)).count();
    Found {
        nullity: basis.len() - D * unseen - turns * (0..m as u32).filter(|i| !scene.view.contains(i)).count(),
        gauge_freedoms: D + 1 + turns,
        component,
        components,
        free_orientation: turns > 0,
    }
}

/// A scene of its own, who sees whom, and helpers to make one.
#[derive(Clone, Default, Debug)]
struct World<const D: usize> {
    centers: Vec<Vector<D>>,
    points: Vec<Vector<D>>,
    view: Vec<u32>,
    track: Vec<u32>,
}

impl<const D: usize> World<D> {
    fn new(centers: Vec<Vector<D>>, points: Vec<Vector<D>>) -> Self {
        Self { centers, points, view: Vec::new(), track: Vec::new() }
    }

    fn full(centers: &[Vector<D>], points: &[Vector<D>]) -> Self {
        let mut world = Self::new(centers.to_vec(), points.to_vec());
        world.all_see(0..centers.len() as u32, 0..points.len() as u32);
        world
    }

    fn see(&mut self, view: u32, track: u32) {
        self.view.push(view);
        self.track.push(track);
    }

    fn all_see(&mut self, views: impl IntoIterator<Item = u32>, tracks: impl IntoIterator<Item = u32> + Clone) {
        for view in views {
            for track in tracks.clone() {
                self.see(view, track);
            }
        }
    }

    fn sightings(&self) -> Sightings<'_, D> {
        Sightings { centers: &self.centers, points: &self.points, view: &self.view, track: &self.track }
    }

    fn causes(&self, free_orientation: bool) -> Vec<Cause> {
        let found = flexibility(&self.sightings(), free_orientation);
        let flexible = found.nullity > found.gauge_freedoms;
        let causes = self.named(&found, TOLERANCE);
        assert_eq!(flexible, !causes.is_empty(), "nullity {}: {causes:?}", found.nullity);
        causes
    }

    fn named(&self, found: &Found, tolerance: f64) -> Vec<Cause> {
        let flexibility = Flexibility {
            nullity: found.nullity,
            gauge_freedoms: found.gauge_freedoms,
            component_of_observation: &found.component,
            components: &found.components,
            free_orientation: found.free_orientation,
        };
        name_causes(&self.sightings(), &flexibility, tolerance)
    }
}

fn nullity<const D: usize>(views: &[Vector<D>], points: &[Vector<D>]) -> usize {
    null_space(&World::full(views, points).sightings(), 0).len()
}

fn kinds(causes: &[Cause]) -> Vec<&'static str> {
    causes.iter().map(|cause| cause.kind.name()).collect()
}

// ---- places ---------------------------------------------------------------------------------------------------------

fn generator(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

fn generic<const D: usize>(rng: &mut impl Rng, n: usize) -> Vec<Vector<D>> {
    (0..n).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect()
}

/// Places on the line `at + t along`.
fn on_line<const D: usize>(rng: &mut impl Rng, n: usize, at: &Vector<D>, along: &Vector<D>) -> Vec<Vector<D>> {
    (0..n).map(|_| add(at, &scale(rng.random_range(-1.0..1.0), along))).collect()
}

/// Places on a conic of the plane.
fn on_conic(rng: &mut impl Rng, n: usize, name: &str) -> Vec<[f64; 2]> {
    (0..n)
        .map(|_| {
            let t: f64 = rng.random_range(0.0..std::f64::consts::TAU);
            let s: f64 = rng.random_range(-1.5..1.5);
            match name {
                "circle" => [t.cos(), t.sin()],
                "ellipse" => [2.0 * t.cos(), t.sin()],
                "parabola" => [s, s * s],
                _ => [s.cosh() * if t > 3.0 { 1.0 } else { -1.0 }, s.sinh()],
            }
        })
        .collect()
}

/// A similarity at random, the same for both sets; `turn` holds angles.
fn posed<const D: usize>(rng: &mut impl Rng, sets: [&[Vector<D>]; 2]) -> [Vec<Vector<D>>; 2] {
    let turn: [f64; 3] = std::array::from_fn(|_| rng.random_range(-2.0..2.0));
    let rotation = Rotation::<D>::exp_of(&turn);
    let size = 10f64.powf(rng.random_range(-2.0..2.0));
    let shift: Vector<D> = std::array::from_fn(|_| size * rng.random_range(-3.0..3.0));
    sets.map(|set| set.iter().map(|x| add(&shift, &scale(size, &rotation.apply(x)))).collect())
}

fn lifted(plane: &[[f64; 2]]) -> Vec<[f64; 3]> {
    plane.iter().map(|x| [x[0], x[1], 0.0]).collect()
}

// ---- full visibility ------------------------------------------------------------------------------------------------

/// The nullity agrees with the rank, and there is a cause where and only where there is more than the gauge.
fn check_full<const D: usize>(views: &[Vector<D>], points: &[Vector<D>]) -> Vec<Cause> {
    let expected = nullity(views, points);
    let found = full_visibility_nullity(views, points, TOLERANCE);
    assert_eq!(found, Some(expected), "views {views:?}, points {points:?}");
    let causes = failing_conditions(views, points, TOLERANCE);
    assert_eq!(
        causes.is_empty(),
        expected <= D + 1,
        "nullity {expected}: {causes:?}, views {views:?}, points {points:?}"
    );
    assert!(causes.iter().all(|cause| cause.is_exact), "{causes:?}");
    causes
}

/// Few different places: every coincidence that there is comes up.
fn on_grid<const D: usize>(rng: &mut impl Rng, reach: i32) -> Option<[Vec<Vector<D>>; 2]> {
    let sets = [rng.random_range(1..=6), rng.random_range(1..=6)].map(|n: usize| -> Vec<Vector<D>> {
        (0..n).map(|_| std::array::from_fn(|_| rng.random_range(-reach..=reach) as f64)).collect()
    });
    let apart = sets[0].iter().all(|p| !sets[1].contains(p));
    apart.then_some(sets)
}

#[test]
fn nullity_agrees_with_the_rank_on_grids() {
    let rng = &mut generator(1);
    let (mut n_plane, mut n_space) = (0, 0);
    while n_plane < 4000 {
        if let Some([views, points]) = on_grid::<2>(rng, 1 + n_plane % 3) {
            let [views, points] = posed(rng, [&views, &points]);
            check_full(&views, &points);
            n_plane += 1;
        }
    }
    while n_space < 2000 {
        if let Some([views, points]) = on_grid::<3>(rng, 1 + n_space % 2) {
            let [views, points] = posed(rng, [&views, &points]);
            check_full(&views, &points);
            n_space += 1;
        }
    }
}

/// A configuration, and the names and details of what fails. Poses are random.
type Case<const D: usize> = (Vec<Vector<D>>, Vec<Vector<D>>, Vec<&'static str>, &'static str);

fn plane_cases(rng: &mut impl Rng) -> Vec<Case<2>> {
    let (m, n) = (rng.random_range(3..=8), rng.random_range(3..=8));
    let line = |rng: &mut ChaCha8Rng, k: usize, x: f64| on_line(rng, k, &[x, 0.3], &[0.5 * x, 1.0]);
    let mut own = generator(rng.random());
    let rng = &mut own;
    let mut cases = vec![
        (generic(rng, m), generic(rng, n), vec![], ""),
        // views on a line are no ambiguity of their own
        (line(rng, m, 1.0), generic(rng, n), vec![], ""),
        (line(rng, m, 1.0), [line(rng, n, 1.0), generic(rng, 2)].concat(), vec!["camera_collinear"], ""),
        ([line(rng, m, 1.0), generic(rng, 2)].concat(), line(rng, n, 1.0), vec!["point_collinear"], ""),
        (line(rng, m, 1.0), line(rng, n, 1.0), vec!["camera_collinear", "point_collinear"], ""),
        (line(rng, m, 1.0), line(rng, n, -1.0), vec!["two_lines_1"], "views on one line, points on another"),
        (
            [line(rng, 2, 1.0), line(rng, 1, -1.0)].concat(),
            [line(rng, 1, 1.0), line(rng, 2, -1.0)].concat(),
            vec!["two_lines_2"],
            "",
        ),
        (
            [line(rng, m, 1.0), line(rng, 2, -1.0)].concat(),
            [line(rng, n, 1.0), line(rng, 3, -1.0)].concat(),
            vec!["two_lines_2"],
            "",
        ),
        // parallel lines
        (
            [on_line(rng, 2, &[0.0; 2], &[1.0, 0.4]), on_line(rng, 1, &[0.0, 1.0], &[1.0, 0.4])].concat(),
            [on_line(rng, 1, &[0.0; 2], &[1.0, 0.4]), on_line(rng, n, &[0.0, 1.0], &[1.0, 0.4])].concat(),
            vec!["two_lines_2"],
            "",
        ),
        (generic(rng, 2), generic(rng, n), vec!["two_cameras"], ""),
        (generic(rng, m), generic(rng, 2), vec!["two_points"], ""),
        (generic(rng, 2), generic(rng, 2), vec!["two_cameras", "two_points"], ""),
        (generic(rng, 1), generic(rng, n), vec!["one_camera"], ""),
        (generic(rng, m), generic(rng, 1), vec!["hidden_point"], ""),
        (vec![[0.5, 0.5]; m], generic(rng, n), vec!["one_camera"], ""),
        (generic(rng, 1), generic(rng, 1), vec![], ""),
    ];
    for name in ["circle", "ellipse", "parabola", "hyperbola"] {
        cases.push((on_conic(rng, m, name), on_conic(rng, n, name), vec!["conic"], name));
    }
    cases
}

/// Does every member lie on the shape that a cause draws?
fn check_shape<const D: usize>(cause: &Cause, views: &[Vector<D>], points: &[Vector<D>], within: f64) {
    let members =
        cause.views.iter().map(|&i| views[i as usize]).chain(cause.tracks.iter().map(|&j| points[j as usize]));
    let members: Vec<Vector<D>> = members.collect();
    let size = members.iter().map(|x| norm(&sub(x, &members[0]))).fold(0.0, f64::max);
    let is_conic = cause.kind == CauseKind::Conic;
    for x in &members {
        let off = if is_conic && cause.shape.len() == 6 {
            let [a, b, c, d, e, f] = cause.shape[..].try_into().unwrap();
            let (s, t) = (x[0], x[1]);
            let value: f64 = a * s * s + b * s * t + c * t * t + d * s + e * t + f;
            value.abs() / (2.0 * a * s + b * t + d).hypot(b * s + 2.0 * c * t + e)
        } else {
            let from_line = |line: &[f64]| {
                let (at, along): (Vector<D>, Vector<D>) =
                    (line[..D].try_into().unwrap(), line[D..].try_into().unwrap());
                let v = sub(x, &at);
                norm(&sub(&v, &scale(dot(&v, &along), &along)))
            };
            cause.shape.chunks(2 * D).map(from_line).fold(f64::INFINITY, f64::min)
        };
        assert!(off <= within * size, "{cause:?}: {x:?} is off by {off}");
    }
}

fn check_case<const D: usize>((views, points, names, detail): &Case<D>, rng: &mut impl Rng) {
    let [views, points] = posed(rng, [views, points]);
    let causes = check_full(&views, &points);
    assert_eq!(kinds(&causes), *names, "{causes:?}");
    if !detail.is_empty() {
        assert_eq!(causes[0].detail, *detail);
    }
    for cause in causes.iter().filter(|cause| {
        matches!(cause.kind, CauseKind::Conic | CauseKind::TwoLines1 | CauseKind::TwoLines2) && !cause.shape.is_empty()
    }) {
        check_shape(cause, &views, &points, 1e-7);
    }
    // the same names from the null space
    let named = World::full(&views, &points).causes(false);
    assert_eq!(kinds(&named), *names, "{named:?}");
}

#[test]
fn each_ambiguity_of_the_plane_has_its_name() {
    let rng = &mut generator(4);
    for _ in 0..60 {
        for case in plane_cases(rng) {
            check_case(&case, rng);
        }
    }
}

#[test]
fn in_space_the_ambiguities_of_the_plane_need_one_plane() {
    let rng = &mut generator(5);
    for _ in 0..30 {
        for (views, points, names, detail) in plane_cases(rng) {
            let names = if names == ["two_cameras", "two_points"] { vec!["coplanar_two_by_two"] } else { names };
            check_case(&(lifted(&views), lifted(&points), names.clone(), detail), rng);
            // heights at random
            let mut lift = |set: &[[f64; 2]]| -> Vec<[f64; 3]> {
                set.iter().map(|x| [x[0], x[1], rng.random_range(-1.0..1.0)]).collect()
            };
            let (views, points) = (lift(&views), lift(&points));
            let alone = |name: &str| ["one_camera", "hidden_point"].contains(&name);
            let names = names.into_iter().filter(|name| alone(name)).collect::<Vec<_>>();
            if !views.windows(2).any(|pair| pair[0][..2] == pair[1][..2]) {
                check_case(&(views, points, names, ""), rng);
            }
        }
    }
}

#[test]
fn members_on_a_line_are_loose_in_space() {
    let rng = &mut generator(6);
    for n_loose in 1..4 {
        let axis = [0.2, 1.0, -0.4];
        let views = on_line(rng, 5, &[0.0; 3], &axis);
        let points = [generic(rng, 4), on_line(rng, n_loose, &[0.0; 3], &axis)].concat();
        let [views, points] = posed(rng, [&views, &points]);
        let causes = check_full(&views, &points);
        assert_eq!(kinds(&causes), ["camera_collinear"]);
        assert_eq!(causes[0].tracks, (4..4 + n_loose as u32).collect::<Vec<_>>());
        assert_eq!(full_visibility_nullity(&views, &points, TOLERANCE), Some(4 + n_loose));
        assert_eq!(kinds(&check_full(&points, &views)), ["point_collinear"]);
    }
}

/// The counter-examples to the theorems of the paper.
#[test]
fn theorems_of_the_paper_miss_the_conics() {
    let rng = &mut generator(7);
    // three cameras and four points, no three of them on a line: the second theorem
    let (views, points) = (on_conic(rng, 3, "circle"), on_conic(rng, 4, "circle"));
    assert_eq!((nullity(&views, &points), full_visibility_nullity(&views, &points, TOLERANCE)), (4, Some(4)));
    // two cameras and points that are not coplanar, one of them in line with the cameras
    let (views, mut points) = (generic::<3>(rng, 2), generic::<3>(rng, 4));
    points.push(add(&scale(-0.5, &views[0]), &scale(1.5, &views[1])));
    assert_eq!((nullity(&views, &points), full_visibility_nullity(&views, &points, TOLERANCE)), (5, Some(5)));
    for size in [3, 4, 10] {
        let (views, points) = (on_conic(rng, size, "ellipse"), on_conic(rng, size, "ellipse"));
        assert_eq!(nullity(&views, &points), 4);
        assert_eq!(full_visibility_nullity(&views, &points, TOLERANCE), Some(4));
        // one member more, off the conic, and all is determined
        let more = [points.clone(), vec![[0.1, 0.2]]].concat();
        assert_eq!(full_visibility_nullity(&views, &more, TOLERANCE), Some(3));
        assert_eq!(nullity(&views, &more), 3);
        let mut lift = |set: &[[f64; 2]]| -> Vec<[f64; 3]> {
            set.iter().map(|x| [x[0], x[1], rng.random_range(-1.0..1.0)]).collect()
        };
        let (views, points) = (lift(&views), lift(&points));
        assert_eq!((nullity(&views, &points), full_visibility_nullity(&views, &points, TOLERANCE)), (4, Some(4)));
        assert!(failing_conditions(&views, &points, TOLERANCE).is_empty());
    }
}

#[test]
fn tolerance_is_a_distance_relative_to_the_size() {
    let rng = &mut generator(8);
    for round in 0..40 {
        for (views, points, names, _) in plane_cases(rng) {
            let far = 1e-6;
            let mut shaken = |set: &[[f64; 2]]| -> Vec<[f64; 2]> {
                set.iter().map(|x| x.map(|x| x + far * rng.random_range(-1.0..1.0))).collect()
            };
            let (near_views, near_points) = (shaken(&views), shaken(&points));
            // whatever the unit of length
            let size = 10f64.powi(round % 7 - 3);
            let [views, points, near_views, near_points] = [views, points, near_views, near_points]
                .map(|set| set.iter().map(|x| scale(size, x)).collect::<Vec<_>>());
            let exact = full_visibility_nullity(&views, &points, TOLERANCE);
            let wide = full_visibility_nullity(&near_views, &near_points, 100.0 * far);
            // places drawn at random may be within the wide limit of each other, or of a common shape
            if full_visibility_nullity(&views, &points, 1000.0 * far) != exact {
                continue;
            }
            assert_eq!(wide, exact, "round {round}, {names:?}");
            let causes = failing_conditions(&near_views, &near_points, 100.0 * far);
            assert_eq!(kinds(&causes), names);
            let special = causes.iter().filter(|cause| cause.kind == CauseKind::Conic);
            assert!(special.into_iter().all(|cause| !cause.is_exact));
            if names == ["conic"] {
                assert_eq!(full_visibility_nullity(&near_views, &near_points, TOLERANCE), Some(3));
            }
        }
    }
}

#[test]
fn unusable_and_empty_sets() {
    let (p, q) = ([[0.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [1.0, 0.0]]);
    assert_eq!(full_visibility_nullity(&p, &q, TOLERANCE), None, "a view is at a point");
    assert_eq!(full_visibility_nullity(&[[f64::NAN, 0.0]], &q, TOLERANCE), None);
    assert_eq!(full_visibility_nullity(&p, &[[f64::INFINITY, 0.0]], TOLERANCE), None);
    assert!(failing_conditions(&p, &q, TOLERANCE).is_empty());
    assert_eq!(full_visibility_nullity::<2>(&[], &[], TOLERANCE), Some(0));
    assert_eq!(full_visibility_nullity::<3>(&[], &[[1.0; 3], [2.0; 3]], TOLERANCE), Some(6));
    assert_eq!(kinds(&failing_conditions::<3>(&[], &[[1.0; 3], [2.0; 3]], TOLERANCE)), ["disconnected"]);
    assert_eq!(full_visibility_nullity(&[[0.0; 3]], &[[1e150, 0.0, 0.0]], TOLERANCE), Some(4));
    // many members: nothing is built that grows with the product
    let rng = &mut generator(9);
    let (views, points) = (generic::<2>(rng, 3000), generic::<2>(rng, 40_000));
    assert_eq!(full_visibility_nullity(&views, &points, TOLERANCE), Some(3));
}

// ---- partial visibility ---------------------------------------------------------------------------------------------

#[test]
fn causes_agree_with_those_of_full_visibility() {
    let rng = &mut generator(2);
    fn check<const D: usize>(rng: &mut impl Rng, reach: i32) {
        if let Some([views, points]) = on_grid::<D>(rng, reach) {
            let mut expected = kinds(&check_full(&views, &points));
            let mut found = kinds(&World::full(&views, &points).causes(false));
            expected.sort_unstable();
            found.sort_unstable();
            assert_eq!(expected, found, "{views:?} {points:?}");
        }
    }
    for k in 0..3000 {
        check::<2>(rng, 1 + k % 3);
        check::<3>(rng, 1 + k % 2);
    }
}

/// Freedoms beyond the gauge that a cause stands for, in general position and with orientations known.
fn freedoms_of<const D: usize>(cause: &Cause) -> usize {
    let number = |k: usize| cause.detail.split(' ').nth(k).unwrap().parse::<usize>().unwrap();
    match cause.kind {
        CauseKind::Disconnected => (number(0) - 1) * (D + 1),
        CauseKind::OneCamera => cause.tracks.len() - 1,
        CauseKind::HiddenPoint if cause.detail.starts_with("views") => cause.views.len() - 1,
        CauseKind::HiddenPoint => cause.views.len() + cause.tracks.len(),
        CauseKind::TooFewEquations => number(3) - number(0),
        CauseKind::WeakJoin if cause.detail.starts_with("shares") => 1,
        CauseKind::WeakJoin if cause.detail.ends_with("between") => number(2) + number(4),
        CauseKind::WeakJoin => number(2) - number(0),
        // two views and two points are named twice
        CauseKind::TwoCameras => usize::from(cause.tracks.len() > 2),
        CauseKind::TwoPoints => 1,
        _ => unreachable!("{cause:?}"),
    }
}

/// In general position there is nothing but hanging members, pairs and counts, and together they explain every freedom.
#[test]
fn general_positions_need_no_other() {
    let rng = &mut generator(3);
    let mut n_flexible = 0;
    for round in 0..1200 {
        let (m, n) = (rng.random_range(1..8), rng.random_range(1..10));
        let share = rng.random_range(0.2..1.0);
        let mut plane = World::new(generic::<2>(rng, m), generic::<2>(rng, n));
        let mut space = World::new(generic::<3>(rng, m), generic::<3>(rng, n));
        for (i, j) in (0..m as u32).flat_map(|i| (0..n as u32).map(move |j| (i, j))) {
            if rng.random_bool(share) {
                plane.see(i, j);
                space.see(i, j);
            }
        }
        if plane.view.is_empty() {
            continue;
        }
        let free = round % 2 == 0;
        if !free {
            check_freedoms(&plane);
            check_freedoms(&space);
        }
        for causes in [plane.causes(free), space.causes(free)] {
            assert!(!kinds(&causes).contains(&"other"), "{causes:?}");
            assert!(causes.iter().all(|cause| !cause.detail.contains("independent")), "{causes:?}");
            n_flexible += usize::from(!causes.is_empty());
        }
    }
    assert!((1000..2000).contains(&n_flexible), "{n_flexible}");
}

fn check_freedoms<const D: usize>(world: &World<D>) {
    let explained: usize = world.causes(false).iter().map(freedoms_of::<D>).sum();
    let found = flexibility(&world.sightings(), false);
    assert_eq!(explained, found.nullity - found.gauge_freedoms, "{:?} {world:?}", world.causes(false));
}

#[test]
fn sightings_on_grids_always_have_a_cause() {
    let rng = &mut generator(10);
    let mut names = std::collections::BTreeMap::new();
    fn draw<const D: usize>(rng: &mut impl Rng, reach: i32) -> Option<World<D>> {
        let [views, points] = on_grid::<D>(rng, reach)?;
        let (m, n) = (views.len(), points.len());
        let mut world = World::new(views, points);
        let share = rng.random_range(0.5..1.0);
        for (i, j) in (0..m).flat_map(|i| (0..n).map(move |j| (i, j))) {
            if rng.random_bool(share) {
                world.see(i as u32, j as u32);
            }
        }
        (!world.view.is_empty()).then_some(world)
    }
    for k in 0..1500 {
        let plane = draw::<2>(rng, 2).map(|world| world.causes(k % 2 == 0));
        let space = draw::<3>(rng, 2).map(|world| world.causes(k % 2 == 0));
        for name in plane.iter().chain(&space).flat_map(|causes| kinds(causes)) {
            *names.entry(name).or_insert(0) += 1;
        }
    }
    // every kind comes up, and few special positions have no name
    for kind in ["camera_collinear", "conic", "coplanar_two_by_two", "disconnected", "hidden_point", "one_camera"] {
        assert!(names.contains_key(kind), "{names:?}");
    }
    for kind in ["point_collinear", "too_few_equations", "two_cameras", "two_lines_2", "two_points", "weak_join"] {
        assert!(names.contains_key(kind), "{names:?}");
    }
    assert!(names.get("other").is_none_or(|&n| n < 10), "{names:?}");
}

/// Noise hides which members are exactly on a shape; within the tolerance the names are the same.
#[test]
fn names_are_the_same_through_noise() {
    let rng = &mut generator(26);
    for _ in 0..20 {
        for (views, points, names, _) in plane_cases(rng) {
            let world = World::full(&views, &points);
            let found = flexibility(&world.sightings(), false);
            // what is near to special by chance has more names within a tolerance
            if kinds(&world.named(&found, 1e-3)) != names {
                continue;
            }
            let mut near = world.clone();
            let noise = near.centers.iter_mut().chain(&mut near.points).flatten();
            noise.for_each(|x| *x += 1e-6 * rng.random_range(-1.0..1.0));
            let causes = near.named(&found, 1e-4);
            assert_eq!(kinds(&causes), names, "{causes:?}");
            let by_shape = |kind| matches!(kind, CauseKind::Conic | CauseKind::TwoLines1 | CauseKind::CameraCollinear);
            assert!(causes.iter().all(|cause| !by_shape(cause.kind) || !cause.is_exact), "{causes:?}");
        }
    }
}

/// Rigid groups of views and points side by side, not joined.
fn groups<const D: usize>(rng: &mut impl Rng, n_groups: usize, n_views: u32, n_points: u32) -> World<D> {
    let mut world = World::new(Vec::new(), Vec::new());
    for g in 0..n_groups as u32 {
        let middle: Vector<D> = std::array::from_fn(|c| if c == 0 { 3.0 * g as f64 } else { 0.2 * g as f64 });
        world.centers.extend(generic::<D>(rng, n_views as usize).iter().map(|x| add(x, &middle)));
        world.points.extend(generic::<D>(rng, n_points as usize).iter().map(|x| add(x, &middle)));
        world.all_see(g * n_views..(g + 1) * n_views, g * n_points..(g + 1) * n_points);
    }
    world
}

fn only(causes: &[Cause]) -> &Cause {
    assert_eq!(causes.len(), 1, "{causes:?}");
    &causes[0]
}

#[test]
fn parts_that_nothing_joins() {
    let rng = &mut generator(11);
    let causes = groups::<3>(rng, 3, 4, 6).causes(false);
    let cause = only(&causes);
    assert_eq!((cause.kind, cause.detail.as_str()), (CauseKind::Disconnected, "3 parts that no observation joins"));
    assert_eq!(cause.components, [0, 1, 2]);
    assert_eq!(cause.views, (4..12).collect::<Vec<_>>());
    // many of a kind are one
    let causes = groups::<2>(rng, 40, 1, 2).causes(false);
    assert_eq!(kinds(&causes), ["disconnected", "one_camera"]);
    assert_eq!(causes[1].views.len(), 40);
}

fn hinged<const D: usize>(rng: &mut impl Rng, n_groups: u32) -> World<D> {
    // the last view of each group sees the points of the next one too
    let mut world = groups::<D>(rng, n_groups as usize, 5, 6);
    for g in 1..n_groups {
        world.all_see([5 * g - 1], 6 * g..6 * (g + 1));
    }
    world
}

#[test]
fn windows_that_share_one_view_each() {
    fn check<const D: usize>(free: bool) {
        let rng = &mut generator(12);
        let causes = hinged::<D>(rng, 4).causes(free);
        assert_eq!(kinds(&causes), ["weak_join"; 3]);
        for (k, cause) in causes.iter().enumerate() {
            assert_eq!(cause.detail, format!("shares only view {}", 5 * k + 4));
            assert_eq!((&cause.views[..], &cause.tracks[..]), (&[5 * k as u32 + 4][..], &[][..]));
            assert_eq!(cause.components.len(), 2);
        }
        let mut world = groups::<D>(rng, 2, 6, 6);
        world.all_see(6..12, [2]);
        let causes = world.causes(free);
        assert_eq!(only(&causes).detail, "shares only track 2");
    }
    check::<2>(false);
    check::<3>(false);
    check::<2>(true);
    check::<3>(true);
}

#[test]
fn a_ring_of_hinges_is_one_join() {
    let rng = &mut generator(13);
    let mut world = hinged::<2>(rng, 4);
    // back to the first group
    world.all_see([19], 0..6);
    let causes = world.causes(false);
    let cause = only(&causes);
    assert_eq!((cause.kind, cause.detail.as_str()), (CauseKind::WeakJoin, "8 of 9 constraints among 4 parts"));
    assert_eq!((cause.views.clone(), cause.components.clone()), (vec![4, 9, 14, 19], vec![0, 1, 2, 3]));
}

#[test]
fn two_view_tracks_between_two_parts() {
    fn check<const D: usize>(free: bool, needed: u32) {
        let rng = &mut generator(14);
        for k in 1..=needed + 1 {
            let mut world = groups::<D>(rng, 2, 6, 6);
            for t in 0..k {
                let track = world.points.len() as u32;
                world.points.extend(generic::<D>(rng, 1));
                world.see(t % 6, track);
                world.see(6 + (t + t / 6) % 6, track);
            }
            let causes = world.causes(free);
            if k >= needed && D == 3 {
                assert!(causes.is_empty(), "{k}: {causes:?}");
                continue;
            }
            let constraints = if D == 3 { k } else { 0 };
            for cause in &causes {
                assert_eq!(cause.kind, CauseKind::WeakJoin);
                assert_eq!(cause.detail, format!("{constraints} of {needed} constraints"));
                assert_eq!(cause.components, [0, 1]);
            }
            assert_eq!(causes.len(), 1, "{causes:?}");
        }
    }
    check::<3>(false, 4);
    check::<3>(true, 7);
    check::<2>(false, 3);
    check::<2>(true, 4);
}

#[test]
fn headings_free_about_the_vertical() {
    let rng = &mut generator(28);
    for k in 1..=5u32 {
        let mut world = groups::<3>(rng, 2, 6, 6);
        for t in 0..k {
            world.points.extend(generic::<3>(rng, 1));
            world.all_see([t, 6 + t], [12 + t]);
        }
        // a view of two points is just determined, one of one point hangs
        world.centers.extend(generic::<3>(rng, 2));
        world.all_see([12], [0, 1]);
        world.see(13, 3);
        let found = turning(&world.sightings(), 1);
        assert_eq!(found.gauge_freedoms, 5);
        let causes = world.named(&found, TOLERANCE);
        let hidden = causes.last().unwrap();
        assert_eq!((hidden.kind, hidden.views.clone()), (CauseKind::HiddenPoint, vec![13]));
        if k < 5 {
            assert_eq!((causes.len(), causes[0].detail.clone()), (2, format!("{k} of 5 constraints")));
        } else {
            assert_eq!(causes.len(), 1);
        }
    }
}

#[test]
fn rays_from_one_part_onto_another() {
    let rng = &mut generator(15);
    for k in 1..=3u32 {
        let mut world = groups::<2>(rng, 2, 4, 6);
        (0..k).for_each(|t| world.see(t, 6 + t));
        let causes = world.causes(false);
        if k == 3 {
            assert!(causes.is_empty(), "{causes:?}");
        } else {
            assert_eq!(only(&causes).detail, format!("{k} of 3 constraints"));
        }
    }
}

#[test]
fn enough_constraints_that_are_not_independent() {
    let rng = &mut generator(25);
    // three parallel rays say three times that the parts do not shift across them
    let mut world = groups::<2>(rng, 2, 4, 6);
    for t in 0..3 {
        world.points[6 + t] = add(&world.centers[t], &scale(2.0 + 0.3 * t as f64, &[1.0, 0.1]));
        world.see(t as u32, 6 + t as u32);
    }
    let causes = world.causes(false);
    let cause = only(&causes);
    assert_eq!((cause.kind, cause.detail.as_str()), (CauseKind::WeakJoin, "3 of 3 constraints, not independent"));
    assert_eq!((cause.views.clone(), cause.tracks.clone()), (vec![0, 1, 2], vec![6, 7, 8]));
}

#[test]
fn what_hangs_loose() {
    fn check<const D: usize>(free: bool) {
        let rng = &mut generator(16);
        let mut world = groups::<D>(rng, 1, 6, 8);
        world.points.extend(generic::<D>(rng, 4));
        world.centers.extend(generic::<D>(rng, 1));
        // two points of one view each; a view of one point; points in a chain behind it
        world.see(0, 8);
        world.see(3, 9);
        world.see(6, 2);
        world.see(6, 10);
        world.see(6, 11);
        let causes = world.causes(free);
        let cause = only(&causes);
        assert_eq!(cause.kind, CauseKind::HiddenPoint);
        assert_eq!((cause.views.clone(), cause.tracks.clone()), (vec![6], vec![8, 9, 10, 11]));
        assert_eq!(cause.detail, "4 points of one ray, 1 view of one ray");
    }
    check::<2>(false);
    check::<3>(false);
    check::<2>(true);
    check::<3>(true);
}

#[test]
fn what_slides_along_a_line() {
    fn check<const D: usize>(free: bool) {
        let rng = &mut generator(17);
        let mut world = groups::<D>(rng, 1, 7, 8);
        // a point in line with the views 1 and 4, another one with 2 and 5
        let between = |a: usize, b: usize| add(&scale(0.4, &world.centers[a]), &scale(0.6, &world.centers[b]));
        let more = [between(1, 4), between(2, 5)];
        world.points.extend(more);
        world.all_see([1, 4], [8]);
        world.all_see([2, 5], [9]);
        // a view in line with two points
        let middle = add(&scale(1.7, &world.points[0]), &scale(-0.7, &world.points[1]));
        world.centers.push(middle);
        world.all_see([7], [0, 1]);
        let causes = world.causes(free);
        assert_eq!(kinds(&causes), ["camera_collinear", "point_collinear"]);
        assert_eq!((causes[1].views.clone(), causes[1].tracks.clone()), (vec![7], vec![0, 1]));
        assert_eq!(causes[1].shape.len(), 2 * D);
        let line = causes.iter().find(|cause| cause.kind == CauseKind::CameraCollinear).unwrap();
        assert_eq!((line.views.clone(), line.tracks.clone()), (vec![1, 2, 4, 5], vec![8, 9]));
        assert!(line.shape.is_empty(), "two lines have no line in common");
    }
    check::<2>(false);
    check::<3>(false);
    check::<2>(true);
    check::<3>(true);
}

#[test]
fn a_point_too_far_for_its_views() {
    for (distance, tolerance) in [(1e12, 1e-9), (1e8, 1e-6), (1e4, 1e-3)] {
        let rng = &mut generator(18);
        let mut world = groups::<3>(rng, 1, 6, 8);
        let mut found = flexibility(&world.sightings(), false);
        world.points.push([distance, 2.0 * distance, 3.0 * distance]);
        world.all_see(0..6, [8]);
        found.component.extend([-1; 6]);
        found.nullity += 1;
        let causes = world.named(&found, tolerance);
        let cause = only(&causes);
        assert_eq!((cause.kind, cause.detail.as_str()), (CauseKind::HiddenPoint, "1 point seen in one direction only"));
        assert_eq!((cause.tracks.clone(), cause.is_exact), (vec![8], distance > 1e10));
    }
}

#[test]
fn a_line_of_loose_members_is_no_part_to_join() {
    let rng = &mut generator(27);
    // beside a hinge at view 4, which is one
    let mut world = hinged::<2>(rng, 2);
    let at = world.centers[2];
    let on_line = |t: f64| add(&at, &scale(t, &[0.8, 0.6]));
    world.points.extend([on_line(1.0), on_line(-2.0)]);
    world.centers.push(on_line(3.0));
    world.all_see([2, 10], [12, 13]);
    let causes = world.causes(false);
    assert_eq!(kinds(&causes), ["weak_join", "camera_collinear", "point_collinear"]);
    let members = (causes[0].views.clone(), causes[1].tracks.clone(), causes[2].views.clone());
    assert_eq!(members, (vec![4], vec![12, 13], vec![10]));
}

#[test]
fn a_conic_that_is_part_of_a_scene() {
    let rng = &mut generator(19);
    // an ellipse seen in full, hinged at view 5 to a rigid group
    let mut world = groups::<2>(rng, 1, 6, 6);
    let at = world.centers[5];
    let ellipse = on_conic(rng, 9, "ellipse");
    let onto = sub(&at, &ellipse[0]);
    world.centers.extend(ellipse[1..4].iter().map(|x| add(x, &onto)));
    world.points.extend(ellipse[4..].iter().map(|x| add(x, &onto)));
    world.all_see(5..9, 6..11);
    let causes = world.causes(false);
    assert_eq!(kinds(&causes), ["conic", "weak_join"], "{causes:?}");
    assert_eq!((causes[0].views.clone(), causes[0].tracks.clone()), ((5..9).collect(), (6..11).collect()));
    assert_eq!((causes[1].views.clone(), causes[0].detail.as_str()), (vec![5], "ellipse"));
    // held at a second member, the ellipse alone remains
    world.points.push(world.points[8]);
    let copy = world.points.len() as u32 - 1;
    world.all_see(0..6, [copy]);
    let mut joined = world.clone();
    joined.track.iter_mut().filter(|track| **track == copy).for_each(|track| *track = 8);
    let causes = joined.causes(false);
    assert_eq!(kinds(&causes), ["conic"], "{causes:?}");

    // a conic stays ambiguous however few of its pairs see each other; 40 such scenes
    for seed in 0..40 {
        let rng = &mut generator(100 + seed);
        let mut world = World::new(on_conic(rng, 6, "hyperbola"), on_conic(rng, 7, "hyperbola"));
        for (i, j) in (0..6).flat_map(|i| (0..7).map(move |j| (i, j))) {
            if !(i + 2 * j + seed as u32).is_multiple_of(5) {
                world.see(i, j);
            }
        }
        assert_eq!(kinds(&world.causes(false)), ["conic"]);
    }
}

#[test]
fn two_views_and_two_points_in_one_plane_of_space() {
    let rng = &mut generator(20);
    // view 6 and point 8 hang between view 0 and point 0 of a group: a circuit of four, which is rigid but in one plane
    let mut world = groups::<3>(rng, 1, 6, 8);
    let (p, q) = (world.centers[0], world.points[0]);
    let in_plane = |s: f64, t: f64| add(&p, &add(&scale(s, &sub(&q, &p)), &scale(t, &[0.3, -0.2, 0.9])));
    world.centers.push(in_plane(1.5, 0.7));
    world.points.push(in_plane(-0.3, 1.1));
    world.see(0, 8);
    world.see(6, 8);
    world.see(6, 0);
    let causes = world.causes(false);
    let cause = only(&causes);
    assert_eq!(cause.kind, CauseKind::CoplanarTwoByTwo);
    assert_eq!((cause.views.clone(), cause.tracks.clone()), (vec![0, 6], vec![0, 8]));
    world.points[8][0] += 0.5;
    assert!(world.causes(false).is_empty());
}

#[test]
fn headings_unknown() {
    let rng = &mut generator(21);
    // a view on one circle with the three points that it sees
    let mut world = groups::<2>(rng, 1, 6, 8);
    let circle = on_conic(rng, 4, "circle");
    world.points[..3].copy_from_slice(&circle[..3]);
    world.centers.push(circle[3]);
    world.all_see([6], 0..3);
    let causes = world.causes(true);
    let cause = only(&causes);
    assert_eq!((cause.kind, cause.detail.as_str(), cause.views.clone()), (CauseKind::Conic, "circle", vec![6]));
    check_shape(cause, &world.centers, &world.points, 1e-9);
    assert!(world.causes(false).is_empty());
    // all views on one circle with all points are one cause
    let world = World::full(&on_conic(rng, 5, "circle"), &on_conic(rng, 6, "circle"));
    let causes = world.causes(true);
    assert_eq!((only(&causes).kind, only(&causes).views.len()), (CauseKind::Conic, 5));
    // two views never do in the plane; in space five points do
    let (views, points) = (generic::<2>(rng, 2), generic::<2>(rng, 9));
    assert_eq!(kinds(&World::full(&views, &points).causes(true)), ["two_cameras"]);
    let (views, points) = (generic::<3>(rng, 2), generic::<3>(rng, 5));
    assert!(World::full(&views, &points).causes(true).is_empty());
    let causes = World::full(&views, &points[..4]).causes(true);
    assert_eq!(
        (only(&causes).kind, only(&causes).detail.as_str()),
        (CauseKind::TooFewEquations, "16 equations for 17 unknowns")
    );
}

#[test]
fn repeated_and_empty_observations_change_nothing() {
    let rng = &mut generator(22);
    let mut world = groups::<3>(rng, 1, 5, 6);
    world.points.extend(generic::<3>(rng, 1));
    world.points.push(world.centers[2]);
    world.see(1, 6);
    let plain = world.causes(false);
    let mut found = flexibility(&world.sightings(), false);
    // seen twice along the same ray, and from its own place
    world.see(1, 6);
    world.see(2, 7);
    found.component.extend([-1, -1]);
    assert_eq!(world.named(&found, TOLERANCE), plain);
}

#[test]
fn the_order_of_observations_does_not_matter() {
    let rng = &mut generator(23);
    for seed in 0..20 {
        let mut world = hinged::<2>(&mut generator(seed), 3);
        world.points.extend(generic::<2>(rng, 3));
        world.see(0, 18);
        world.all_see([1, 9], [19]);
        world.all_see([2, 8], [20]);
        let found = flexibility(&world.sightings(), false);
        let first = world.named(&found, TOLERANCE);
        let mut order: Vec<usize> = (0..world.view.len()).collect();
        for k in (1..order.len()).rev() {
            order.swap(k, rng.random_range(0..=k));
        }
        let mut shuffled = world.clone();
        shuffled.view = order.iter().map(|&o| world.view[o]).collect();
        shuffled.track = order.iter().map(|&o| world.track[o]).collect();
        let component = order.iter().map(|&o| found.component[o]).collect();
        assert_eq!(shuffled.named(&Found { component, ..found }, TOLERANCE), first);
    }
}

#[test]
fn a_flexibility_without_a_reason_is_other() {
    let rng = &mut generator(24);
    let world = groups::<3>(rng, 1, 5, 6);
    let mut found = flexibility(&world.sightings(), false);
    found.nullity += 1;
    assert_eq!(kinds(&world.named(&found, TOLERANCE)), ["other"]);
    found.component.fill(-1);
    found.components.clear();
    assert_eq!(kinds(&world.named(&found, TOLERANCE)), ["other"]);
}
