//! What the tests of the solver share: scenes made by hand, what every answer must hold, and errors up to gauge.
#![allow(dead_code)]

pub mod poses;

use panopath::geometry::{Rotation, Similarity, Vector, add, angle_between, norm, normalized, scale, sub};
use panopath::positions::*;
use panopath::synthetic::{World, WorldKind, WorldOptions};
use panopath::tracks::Tracks;

pub const DEG: f64 = std::f64::consts::PI / 180.0;
/// "Exactly recovered": the tolerance, relative to the size of the path (points: and to their distance).
pub const EXACT: f64 = 1e-9;

pub fn options(n_views: usize, n_points: usize, seed: u64) -> WorldOptions {
    WorldOptions { n_views, n_points, seed, ..Default::default() }
}

pub fn simulate<const D: usize>(kind: WorldKind, o: &WorldOptions) -> World<D> {
    panopath::synthetic::simulate::<D>(kind, o).unwrap()
}

/// Solves a world with its own orientations and checks what every answer must hold.
pub fn solve<const D: usize>(world: &World<D>, o: &PositionOptions<D>) -> Structure<D> {
    solve_tracks(&world.tracks, Some(&world.cam_from_world), o)
}

pub fn solve_tracks<const D: usize>(
    tracks: &Tracks<D>,
    cam_from_world: Option<&[Rotation<D>]>,
    o: &PositionOptions<D>,
) -> Structure<D> {
    let scene = solve_positions(tracks, cam_from_world, o).unwrap();
    check_invariants(&scene, tracks);
    scene
}

/// The optimum that a solver started from the truth finds.
pub fn from_truth<const D: usize>(world: &World<D>) -> PositionOptions<D> {
    PositionOptions { start: Some((world.centers.clone(), world.points.clone())), ..Default::default() }
}

/// What holds for every answer, whatever the input.
pub fn check_invariants<const D: usize>(scene: &Structure<D>, tracks: &Tracks<D>) {
    let (n, m) = (tracks.n_views(), tracks.n_tracks());
    assert_eq!((scene.centers.len(), scene.view_component.len(), scene.cam_from_world.len()), (n, n, n));
    assert_eq!((scene.points.len(), scene.track_component.len()), (m, m));
    assert_eq!((scene.inlier.len(), scene.residual_rad.len()), (tracks.len(), tracks.len()));
    let n_components = scene.summary.n_components as i32;
    for (what, positions, component) in
        [("view", &scene.centers, &scene.view_component), ("track", &scene.points, &scene.track_component)]
    {
        for (id, (x, &c)) in positions.iter().zip(component).enumerate() {
            assert!((-1..n_components).contains(&c), "{what} {id} is in component {c} of {n_components}");
            if c < 0 {
                assert!(x.iter().all(|v| v.is_nan()), "{what} {id} is in no component but has a position {x:?}");
            } else {
                assert!(x.iter().all(|v| v.is_finite()), "{what} {id} is in component {c} but lies at {x:?}");
            }
        }
    }
    let sizes: Vec<usize> =
        (0..n_components).map(|c| scene.view_component.iter().filter(|&&v| v == c).count()).collect();
    assert!(sizes.iter().all(|&s| s > 0), "a component without a view: {sizes:?}");
    match scene.summary.status {
        Status::Undetermined => assert_eq!(n_components, 0),
        Status::Converged => assert_eq!(n_components, 1),
        Status::Disconnected => assert!(n_components > 1),
        Status::MaxIterations | Status::Ambiguous => assert!(n_components > 0),
    }
    assert_eq!(scene.summary.sigma_rad.is_finite(), n_components > 0, "sigma_rad {}", scene.summary.sigma_rad);
    for o in 0..tracks.len() {
        check_observation(scene, tracks, o);
    }
}

/// The residual is the angle that the outputs themselves give.
fn check_observation<const D: usize>(scene: &Structure<D>, tracks: &Tracks<D>, o: usize) {
    let (i, j) = (tracks.view()[o] as usize, tracks.track()[o] as usize);
    let (view, track) = (scene.view_component[i], scene.track_component[j]);
    let residual = scene.residual_rad[o];
    if view < 0 || track < 0 {
        assert!(residual.is_nan() && !scene.inlier[o], "observation {o} has no prediction, residual {residual}");
        return;
    }
    assert!(!scene.inlier[o] || residual.is_finite(), "observation {o} is an inlier without a residual");
    let u = sub(&scene.points[j], &scene.centers[i]);
    if view == track && norm(&u) > 1e-9 * spread(&scene.centers, &scene.view_component, view) {
        let angle = angle_between(&scene.cam_from_world[i].apply(&normalized(&u)), &tracks.bearing()[o]);
        assert!((angle - residual).abs() < 1e-7, "observation {o}: residual {residual}, from the outputs {angle}");
    }
}

/// Rms distance of the centres of a component from their centroid; one where there is a single centre.
fn spread<const D: usize>(centers: &[Vector<D>], component: &[i32], c: i32) -> f64 {
    let own: Vec<Vector<D>> = centers.iter().zip(component).filter(|(_, k)| **k == c).map(|(x, _)| *x).collect();
    let size = path_size(&own);
    if size > 0.0 { size } else { 1.0 }
}

/// Rms distance from the centroid.
pub fn path_size<const D: usize>(centers: &[Vector<D>]) -> f64 {
    let n = centers.len().max(1) as f64;
    let middle = centers.iter().fold([0.0; D], |sum, c| add(&sum, &scale(1.0 / n, c)));
    (centers.iter().map(|c| norm(&sub(c, &middle)).powi(2)).sum::<f64>() / n).sqrt()
}

/// Errors of one component after a fit by shift and scale, in the units of the truth.
#[derive(Debug, Clone, Copy)]
pub struct Errors {
    pub n_views: usize,
    pub n_points: usize,
    /// Root of the mean squared distance of the cameras.
    pub camera_rms: f64,
    /// Largest camera error over the size of the path.
    pub camera_worst: f64,
    /// Largest point error over path size plus distance of the point.
    pub point_worst: f64,
}

impl Errors {
    /// Worst relative error of cameras and points.
    pub fn worst(&self) -> f64 {
        self.camera_worst.max(self.point_worst)
    }
}

/// Errors of component `c` against the truth, after a fit by shift and scale alone.
///
/// The fit is over the cameras, and over the points as well where the component has fewer than two cameras.
pub fn errors<const D: usize>(
    scene: &Structure<D>,
    true_centers: &[Vector<D>],
    true_points: &[Vector<D>],
    c: i32,
) -> Errors {
    let of = |found: &[Vector<D>], truth: &[Vector<D>], component: &[i32]| -> Vec<(Vector<D>, Vector<D>)> {
        let all = found.iter().zip(truth).zip(component);
        all.filter(|(_, k)| **k == c).map(|((a, b), _)| (*a, *b)).collect()
    };
    let cameras = of(&scene.centers, true_centers, &scene.view_component);
    let points = of(&scene.points, true_points, &scene.track_component);
    let mut pairs = cameras.clone();
    if pairs.len() < 2 {
        pairs.extend(&points);
    }
    let fit = Similarity::fit_unrotated(&pairs).expect("a component that fits the truth at no scale");
    let size = path_size(&pairs.iter().map(|p| p.1).collect::<Vec<_>>());
    let middle = pairs.iter().fold([0.0; D], |sum, p| add(&sum, &scale(1.0 / pairs.len() as f64, &p.1)));
    let error = |p: &(Vector<D>, Vector<D>)| norm(&sub(&fit.apply(&p.0), &p.1));
    let worst =
        |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |a: f64, b| if b > a || b.is_nan() { b } else { a });
    Errors {
        n_views: cameras.len(),
        n_points: points.len(),
        camera_rms: (cameras.iter().map(|p| error(p).powi(2)).sum::<f64>() / cameras.len() as f64).sqrt(),
        camera_worst: worst(&mut cameras.iter().map(|p| error(p) / size)),
        point_worst: worst(&mut points.iter().map(|p| error(p) / (size + norm(&sub(&p.1, &middle))))),
    }
}

/// Errors of the first component against the world's truth.
pub fn world_errors<const D: usize>(scene: &Structure<D>, world: &World<D>) -> Errors {
    errors(scene, &world.centers, &world.points, 0)
}

/// Asserts that everything is solved as one part and equals the truth to [`EXACT`].
pub fn assert_exact<const D: usize>(scene: &Structure<D>, world: &World<D>, what: &str) {
    assert_eq!(scene.summary.status, Status::Converged, "{what} (d = {D})");
    let e = world_errors(scene, world);
    assert_eq!((e.n_views, e.n_points), (world.centers.len(), world.points.len()), "{what} (d = {D}): all are solved");
    assert!(e.worst() < EXACT, "{what} (d = {D}): {e:?}");
    assert!(scene.inlier.iter().all(|&k| k), "{what} (d = {D}): exact observations are inliers");
}

/// Rms of the Cramer-Rao bound over the cameras, at the truth, over the observations that are no outliers.
pub fn bound_rms<const D: usize>(world: &World<D>) -> f64 {
    let keep: Vec<bool> = world.outlier.iter().map(|o| !o).collect();
    let covariance = position_covariance(
        &world.tracks,
        Some(&world.cam_from_world),
        &world.centers,
        &world.points,
        world.noise_rad,
        Some(&keep),
    )
    .unwrap();
    rms_of_covariance(&covariance)
}

pub fn rms_of_covariance<const D: usize>(covariance: &[[[f64; D]; D]]) -> f64 {
    let traces: f64 = covariance.iter().map(|m| (0..D).map(|c| m[c][c]).sum::<f64>()).sum();
    (traces / covariance.len() as f64).sqrt()
}

/// Observations of points by views made by hand: which view sees which track, exactly, in world directions.
pub fn see<const D: usize>(
    centers: &[Vector<D>],
    points: &[Vector<D>],
    seen: impl IntoIterator<Item = (usize, usize)>,
) -> Tracks<D> {
    let (mut view, mut track, mut bearing) = (Vec::new(), Vec::new(), Vec::new());
    for (i, j) in seen {
        view.push(i as u32);
        track.push(j as u32);
        bearing.push(normalized(&sub(&points[j], &centers[i])));
    }
    Tracks::new(view, track, bearing, None, centers.len(), points.len()).unwrap()
}

/// Every view sees every track.
pub fn all_pairs(n_views: usize, n_tracks: usize) -> impl Iterator<Item = (usize, usize)> + Clone {
    (0..n_tracks).flat_map(move |j| (0..n_views).map(move |i| (i, j)))
}

/// `n` places that no test depends on the details of, in the box of half width `half` about `middle`.
pub fn places<const D: usize>(n: usize, middle: &Vector<D>, half: f64, seed: u64) -> Vec<Vector<D>> {
    let mut state = Noise::new(seed);
    (0..n).map(|_| std::array::from_fn(|c| middle[c] + half * (2.0 * state.uniform() - 1.0))).collect()
}

/// A small generator of random numbers (splitmix64), so that tests need no other.
#[derive(Clone)]
pub struct Noise(u64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0xD134_2543_DE82_EF95).wrapping_add(0x9E37_79B9_7F4A_7C15))
    }

    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let r = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        r * (std::f64::consts::TAU * self.uniform()).cos()
    }

    pub fn direction<const D: usize>(&mut self) -> Vector<D> {
        normalized(&std::array::from_fn(|_| self.normal()))
    }

    pub fn permutation(&mut self, n: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..n).collect();
        for k in (1..n).rev() {
            order.swap(k, (self.bits() % (k as u64 + 1)) as usize);
        }
        order
    }
}
