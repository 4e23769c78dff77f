//! Which views and tracks share a scale: disconnected worlds, weak joins, chains of two-view tracks.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::print_stderr, clippy::needless_range_loop)]

mod common;

use common::*;
use panopath::geometry::{Vector, normalized, sub};
use panopath::positions::*;
use panopath::synthetic::{WeakMode, WorldKind, WorldOptions};
use panopath::tracks::Tracks;

fn default<const D: usize>() -> PositionOptions<D> {
    PositionOptions::default()
}

/// A scene of several clusters of views and points, and who sees whom.
struct Clusters<const D: usize> {
    centers: Vec<Vector<D>>,
    points: Vec<Vector<D>>,
    seen: Vec<(usize, usize)>,
    n_views: usize,
}

impl<const D: usize> Clusters<D> {
    /// Clusters of `n_views` views and `n_points` points each, rigid in themselves and not joined.
    fn apart(n_clusters: usize, n_views: usize, n_points: usize) -> Self {
        let mut scene = Self { centers: Vec::new(), points: Vec::new(), seen: Vec::new(), n_views };
        for k in 0..n_clusters {
            let middle = std::array::from_fn(|c| if c == 0 { 6.0 * k as f64 } else { 0.3 * k as f64 });
            scene.centers.extend(places::<D>(n_views, &middle, 1.0, 2 * k as u64 + 1));
            scene.points.extend(places::<D>(n_points, &middle, 2.0, 2 * k as u64 + 2));
            scene.seen.extend(all_pairs(n_views, n_points).map(|(i, j)| (k * n_views + i, k * n_points + j)));
        }
        scene
    }

    /// One more point, seen by these views, each a pair (cluster, view of it).
    fn link(&mut self, views: &[(usize, usize)]) -> usize {
        let seed = 1000 + self.points.len() as u64;
        let place = places::<D>(1, &std::array::from_fn(|c| if c == 0 { 3.0 } else { 0.0 }), 4.0, seed)[0];
        self.points.push(place);
        let track = self.points.len() - 1;
        self.seen.extend(views.iter().map(|&(cluster, i)| (cluster * self.n_views + i, track)));
        track
    }

    fn tracks(&self) -> Tracks<D> {
        see(&self.centers, &self.points, self.seen.iter().copied())
    }

    fn solve(&self) -> Structure<D> {
        solve_tracks(&self.tracks(), None, &default())
    }

    /// Asserts that there are these many parts, each right up to its own gauge.
    fn assert_parts(&self, n: usize, what: &str) -> Structure<D> {
        let scene = self.solve();
        assert_eq!(scene.summary.n_components, n, "{what} (d = {D}): number of parts");
        let status = if n == 1 { Status::Converged } else { Status::Disconnected };
        assert_eq!(scene.summary.status, status, "{what} (d = {D})");
        for c in 0..n as i32 {
            let e = errors(&scene, &self.centers, &self.points, c);
            assert!(e.worst() < EXACT, "{what} (d = {D}): part {c}: {e:?}");
        }
        scene
    }
}

fn check_disconnected<const D: usize>() {
    for n in [2, 3] {
        let world = Clusters::<D>::apart(n, 6, 20);
        for method in [Method::Robust, Method::Linear { form: LinearForm::Joint, gauge: LinearGauge::Functional }] {
            let scene = solve_tracks(&world.tracks(), None, &PositionOptions { method, ..default() });
            assert_eq!((scene.summary.status, scene.summary.n_components), (Status::Disconnected, n));
        }
        let scene = world.assert_parts(n, "apart");
        for k in 0..n {
            let views = &scene.view_component[6 * k..6 * k + 6];
            let tracks = &scene.track_component[20 * k..20 * k + 20];
            assert!(views.iter().chain(tracks).all(|&c| c == views[0]), "cluster {k} is one part");
        }
        let scene = solve_tracks(&world.tracks(), None, &PositionOptions { split_parts: false, ..default() });
        let status = scene.summary.status;
        assert!(matches!(status, Status::Ambiguous | Status::Undetermined), "{n} clusters solved as one: {status:?}");
    }
}

#[test]
fn worlds_that_share_nothing_are_solved_apart() {
    check_disconnected::<2>();
    check_disconnected::<3>();
}

#[test]
fn the_part_with_most_views_comes_first() {
    let mut world = Clusters::<3>::apart(2, 6, 20);
    // one view less in the first cluster
    world.seen.retain(|&(i, _)| i != 2);
    let scene = world.assert_parts(2, "one view less");
    assert_eq!((scene.view_component[0], scene.view_component[6], scene.view_component[2]), (1, 0, -1));
}

#[test]
fn each_part_has_the_normalized_gauge() {
    let scene = Clusters::<3>::apart(2, 6, 20).solve();
    for c in 0..2 {
        let own: Vec<_> = scene.centers.iter().zip(&scene.view_component).filter(|p| *p.1 == c).map(|p| *p.0).collect();
        assert!((path_size(&own) - 1.0).abs() < 1e-12);
    }
}

#[test]
fn not_splitting_a_connected_world_changes_nothing() {
    let world = simulate::<3>(WorldKind::Street, &WorldOptions { noise_rad: 1e-3, ..options(40, 600, 1) });
    let split = solve(&world, &default());
    let whole = solve(&world, &PositionOptions { split_parts: false, ..default() });
    assert_eq!(split.summary.status, whole.summary.status);
    for (a, b) in split.centers.iter().zip(&whole.centers) {
        assert!(panopath::geometry::norm(&sub(a, b)) < 1e-9);
    }
}

#[test]
fn four_two_view_links_join_two_clusters_in_space() {
    for (k, parts) in [(0, 2), (1, 2), (2, 2), (3, 2), (4, 1), (6, 1)] {
        for seed in 0..3 {
            let o = WorldOptions { n_links: Some(k), ..options(16, 80, seed) };
            let world = simulate::<3>(WorldKind::Weak, &o);
            let scene = solve(&world, &default());
            assert_eq!(scene.summary.n_components, parts, "{k} links, seed {seed}");
            for c in 0..parts as i32 {
                let e = errors(&scene, &world.centers, &world.points, c);
                assert!(e.worst() < 1e-7, "{k} links, seed {seed}, part {c}: {e:?}");
            }
            if parts == 2 {
                // what only a loose join would determine is not determined
                assert!(scene.track_component[80 - k..].iter().all(|&c| c == -1), "{k} links, seed {seed}");
            }
        }
    }
}

#[test]
fn no_number_of_two_view_links_joins_clusters_in_the_plane() {
    for k in [0, 1, 4, 10] {
        let o = WorldOptions { n_links: Some(k), ..options(16, 80, 1) };
        let world = simulate::<2>(WorldKind::Weak, &o);
        let scene = solve(&world, &default());
        assert_eq!((scene.summary.n_components, scene.summary.status), (2, Status::Disconnected), "{k} links");
        for c in 0..2 {
            assert!(errors(&scene, &world.centers, &world.points, c).worst() < EXACT, "{k} links");
        }
    }
}

#[test]
fn links_between_the_same_two_views_are_not_independent() {
    // they fix the direction from one view to the other and nothing else, however many they are
    for k in [4, 5, 12] {
        let mut world = Clusters::<3>::apart(2, 6, 20);
        for _ in 0..k {
            world.link(&[(0, 2), (1, 4)]);
        }
        world.assert_parts(2, &format!("{k} links between one pair of views"));
    }
}

#[test]
fn links_from_one_view_fix_at_most_three_of_four_freedoms() {
    // all planes through one view: the other cluster can still grow about that view
    for k in [4, 8] {
        let mut world = Clusters::<3>::apart(2, 8, 20);
        for i in 0..k {
            world.link(&[(0, 2), (1, i)]);
        }
        world.assert_parts(2, &format!("{k} links from one view"));
    }
}

#[test]
fn longer_links_count_more() {
    // a track of one cluster seen from the other gives d - 1 equations: d + 1 are needed
    let mut space = Clusters::<3>::apart(2, 6, 20);
    space.link(&[(0, 1), (0, 2), (1, 3)]);
    space.assert_parts(2, "one three-view link");
    space.link(&[(0, 4), (1, 5), (1, 0)]);
    space.assert_parts(1, "two three-view links");

    let mut plane = Clusters::<2>::apart(2, 6, 20);
    plane.link(&[(0, 1), (0, 2), (1, 3)]);
    plane.link(&[(0, 4), (1, 5), (1, 0)]);
    plane.assert_parts(2, "two three-view links");
    plane.link(&[(0, 5), (0, 3), (1, 1)]);
    plane.assert_parts(1, "three three-view links");

    // a track that both clusters can place gives d, and two of them all
    for firmly in 1..3 {
        let mut space = Clusters::<3>::apart(2, 6, 20);
        let mut plane = Clusters::<2>::apart(2, 6, 20);
        for k in 0..firmly {
            space.link(&[(0, k), (0, k + 1), (1, k + 2), (1, k + 3)]);
            plane.link(&[(0, k), (0, k + 1), (1, k + 2), (1, k + 3)]);
        }
        space.assert_parts(3 - firmly, "common points");
        plane.assert_parts(3 - firmly, "common points");
    }
}

fn check_hinge<const D: usize>() {
    // a view that stands in both clusters: their scales are independent
    let mut world = Clusters::<D>::apart(2, 6, 20);
    world.seen.extend((20..40).map(|j| (3, j)));
    let scene = world.solve();
    assert_eq!((scene.summary.n_components, scene.summary.status), (2, Status::Disconnected), "d = {D}");
    for c in 0..2 {
        assert!(errors(&scene, &world.centers, &world.points, c).worst() < EXACT, "d = {D}, part {c}");
    }
    // a second common view makes one part of them
    world.seen.extend((20..40).map(|j| (5, j)));
    world.assert_parts(1, "two common views");
}

#[test]
fn a_common_view_is_a_hinge_and_two_are_a_joint() {
    check_hinge::<2>();
    check_hinge::<3>();
}

#[test]
fn a_chain_of_two_view_tracks_is_loose_at_every_link() {
    let o = WorldOptions { weak_mode: Some(WeakMode::Chain), ..options(12, 240, 3) };
    let world = simulate::<3>(WorldKind::Weak, &o);
    let scene = solve(&world, &default());
    assert_eq!((scene.summary.status, scene.summary.n_components), (Status::Disconnected, 11));
    // each pair is right in itself
    for c in 0..11 {
        let e = errors(&scene, &world.centers, &world.points, c);
        assert!(e.worst() < EXACT, "pair {c}: {e:?}");
    }
    let plane = simulate::<2>(WorldKind::Weak, &o);
    assert_eq!(solve(&plane, &default()).summary.status, Status::Undetermined);
}

#[test]
fn three_view_tracks_hold_a_chain_together() {
    let o = WorldOptions { min_views: Some(3), max_views: Some(3), ..options(40, 400, 3) };
    let world = simulate::<3>(WorldKind::Chain, &o);
    let scene = solve(&world, &default());
    assert_eq!((scene.summary.status, scene.summary.n_components), (Status::Converged, 1));
    assert!(world_errors(&scene, &world).worst() < 1e-8, "{:?}", world_errors(&scene, &world));
}

fn check_false_join<const D: usize>(n_links: usize) {
    for seed in 0..4 {
        let mut world = Clusters::<D>::apart(2, 8, 40);
        let mut noise = Noise::new(seed);
        // tracks of both clusters that are matched to views of the other, and see nothing real there
        let mut false_sightings = Vec::new();
        for k in 0..n_links {
            let (view, track) = (8 + (3 * k + seed as usize) % 8, (7 * k) % 40);
            if !world.seen.contains(&(view, track)) {
                world.seen.push((view, track));
                false_sightings.push(world.seen.len() - 1);
            }
        }
        let exact = world.tracks();
        let mut bearing: Vec<Vector<D>> = exact
            .bearing()
            .iter()
            .map(|b| normalized(&std::array::from_fn(|c| b[c] + 2e-4 * noise.normal())))
            .collect();
        for &o in &false_sightings {
            bearing[o] = noise.direction();
        }
        let tracks = Tracks::new(exact.view().to_vec(), exact.track().to_vec(), bearing, None, 16, 80).unwrap();
        let scene = solve_tracks(&tracks, None, &default());
        let what = format!("d = {D}, {n_links} false links, seed {seed}");
        assert_eq!((scene.summary.status, scene.summary.n_components), (Status::Disconnected, 2), "{what}");
        for c in 0..2 {
            let e = errors(&scene, &world.centers, &world.points, c);
            assert!(e.n_views == 8 && e.camera_worst < 0.01, "{what}, part {c}: {e:?}");
        }
    }
}

#[test]
fn what_only_outliers_join_is_taken_apart() {
    for n_links in [2, 6, 15] {
        check_false_join::<3>(n_links);
        check_false_join::<2>(n_links);
    }
}

#[test]
fn control_places_the_part_that_it_holds() {
    let world = Clusters::<3>::apart(2, 6, 20);
    let known = |i: usize| (i as u32, world.centers[i]);
    let control = Control { views: [6, 8, 9, 11].map(known).to_vec(), ..Control::default() };
    let scene = solve_tracks(&world.tracks(), None, &PositionOptions { gauge: Gauge::Control(control), ..default() });
    for i in 6..12 {
        assert!(panopath::geometry::norm(&sub(&scene.centers[i], &world.centers[i])) < EXACT);
    }
    // the other part has no control: it is given for itself
    assert!((path_size(&scene.centers[..6]) - 1.0).abs() < 1e-9);
}
