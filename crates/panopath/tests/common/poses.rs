//! Scenes with orientations: starts near the truth, bearings of views that are turned and have several sensors, errors
//! after a fit by similarity.

use panopath::geometry::{Rotation, Similarity, Vector, add, angle_between, norm, normalized, scale, sub};
use panopath::refinement::{RefineOptions, refine};
use panopath::structure::{Status, Structure, Summary, Timings};
use panopath::synthetic::World;
use panopath::tracks::Tracks;

use super::{Noise, check_invariants, path_size};

/// Unknowns of a turn.
pub const fn turns(d: usize) -> usize {
    d * (d - 1) / 2
}

/// Everything known, in one component.
pub fn structure<const D: usize>(
    cam_from_world: &[Rotation<D>],
    centers: &[Vector<D>],
    points: &[Vector<D>],
) -> Structure<D> {
    Structure {
        centers: centers.to_vec(),
        points: points.to_vec(),
        view_component: vec![0; centers.len()],
        track_component: vec![0; points.len()],
        inlier: Vec::new(),
        residual_rad: Vec::new(),
        cam_from_world: cam_from_world.to_vec(),
        summary: Summary {
            status: Status::Converged,
            iterations: 0,
            sigma_rad: f64::NAN,
            n_components: 1,
            timings: Timings::default(),
        },
    }
}

pub fn truth<const D: usize>(world: &World<D>) -> Structure<D> {
    structure(&world.cam_from_world, &world.centers, &world.points)
}

/// A random rotation, or one near the identity.
pub fn random_turn<const D: usize>(noise: &mut Noise, sigma: f64) -> Rotation<D> {
    Rotation::exp_of(&(0..turns(D)).map(|_| sigma * noise.normal()).collect::<Vec<f64>>())
}

/// The scene with its orientations off by `turn` radians an axis, its centres by `shift` of the size of the path, its
/// points by `shift` of their distance from the middle of the path.
pub fn disturbed<const D: usize>(scene: &Structure<D>, turn: f64, shift: f64, seed: u64) -> Structure<D> {
    let mut noise = Noise::new(seed);
    let mut start = scene.clone();
    let size = path_size(&scene.centers);
    let n = scene.centers.len() as f64;
    let middle = scene.centers.iter().fold([0.0; D], |sum, c| add(&sum, &scale(1.0 / n, c)));
    for rotation in &mut start.cam_from_world {
        *rotation = random_turn::<D>(&mut noise, turn).compose(rotation);
    }
    for center in &mut start.centers {
        *center = center.map(|x| x + shift * size * noise.normal());
    }
    for point in &mut start.points {
        let distance = norm(&sub(point, &middle));
        *point = point.map(|x| x + shift * distance * noise.normal());
    }
    start
}

/// Refines, and checks what every answer must hold.
pub fn refined<const D: usize, const V: usize>(
    tracks: &Tracks<D>,
    start: &Structure<D>,
    options: &RefineOptions<D>,
) -> Structure<D> {
    let scene = refine::<D, V>(tracks, start, options).unwrap();
    if options.rig.is_none() {
        check_invariants(&scene, tracks);
    }
    scene
}

/// The scene seen from another frame: `b_from_a` takes its places there.
pub fn moved<const D: usize>(scene: &Structure<D>, b_from_a: &Similarity<D>) -> Structure<D> {
    let a_from_b = b_from_a.rotation.inverse();
    Structure {
        centers: scene.centers.iter().map(|x| b_from_a.apply(x)).collect(),
        points: scene.points.iter().map(|x| b_from_a.apply(x)).collect(),
        cam_from_world: scene.cam_from_world.iter().map(|r| r.compose(&a_from_b)).collect(),
        ..scene.clone()
    }
}

/// A similarity that leaves nothing where it was.
pub fn some_similarity<const D: usize>(seed: u64) -> Similarity<D> {
    let mut noise = Noise::new(seed);
    Similarity {
        scale: (1.0 + noise.uniform()) * 3.0,
        rotation: random_turn(&mut noise, 1.0),
        translation: std::array::from_fn(|_| 20.0 * noise.normal()),
    }
}

/// Errors of a scene as it stands, without any fit.
#[derive(Debug, Clone, Copy)]
pub struct PoseErrors {
    /// Largest angle between an orientation and the truth.
    pub turn: f64,
    /// Rms distance of the centres.
    pub camera_rms: f64,
    /// Largest distance of a centre, over the size of the path.
    pub camera: f64,
    /// Largest distance of a point, over the size of the path plus its distance.
    pub point: f64,
}

impl PoseErrors {
    pub fn worst(&self) -> f64 {
        [self.turn, self.camera, self.point].into_iter().fold(0.0, |a, b| if b > a || b.is_nan() { b } else { a })
    }
}

/// Errors of everything that is in a component.
pub fn raw_errors<const D: usize>(scene: &Structure<D>, truth: &Structure<D>) -> PoseErrors {
    let size = path_size(&truth.centers);
    let n = truth.centers.len() as f64;
    let middle = truth.centers.iter().fold([0.0; D], |sum, c| add(&sum, &scale(1.0 / n, c)));
    let mut e = PoseErrors { turn: 0.0, camera_rms: 0.0, camera: 0.0, point: 0.0 };
    let worse = |a: &mut f64, b: f64| *a = if b > *a || b.is_nan() { b } else { *a };
    let (mut squared, mut count) = (0.0, 0.0);
    for i in (0..truth.centers.len()).filter(|&i| scene.view_component[i] >= 0) {
        let turn = scene.cam_from_world[i].compose(&truth.cam_from_world[i].inverse()).turn();
        worse(&mut e.turn, norm(&turn));
        let distance = norm(&sub(&scene.centers[i], &truth.centers[i]));
        worse(&mut e.camera, distance / size);
        squared += distance * distance;
        count += 1.0;
    }
    e.camera_rms = f64::sqrt(squared / count);
    for j in (0..truth.points.len()).filter(|&j| scene.track_component[j] >= 0) {
        let distance = norm(&sub(&scene.points[j], &truth.points[j]));
        worse(&mut e.point, distance / (size + norm(&sub(&truth.points[j], &middle))));
    }
    e
}

/// Errors after a fit by similarity over the centres (`over_points`: and the points, where centres lie on a line).
pub fn fitted_errors<const D: usize>(scene: &Structure<D>, truth: &Structure<D>, over_points: bool) -> PoseErrors {
    let mut pairs: Vec<_> = (scene.centers.iter().zip(&truth.centers).zip(&scene.view_component))
        .filter(|(_, c)| **c >= 0)
        .map(|((a, b), _)| (*a, *b))
        .collect();
    if over_points {
        let points = scene.points.iter().zip(&truth.points).zip(&scene.track_component);
        pairs.extend(points.filter(|(_, c)| **c >= 0).map(|((a, b), _)| (*a, *b)));
    }
    let fit = Similarity::fit(&pairs).expect("centres that fit the truth at no scale");
    raw_errors(&moved(scene, &fit), truth)
}

/// What turned views see exactly: `seen` lists view, track and sensor; `levers` are the centres of the sensors.
pub fn look<const D: usize>(
    truth: &Structure<D>,
    levers: &[Vector<D>],
    seen: impl IntoIterator<Item = (usize, usize, usize)>,
) -> (Tracks<D>, Vec<u32>) {
    let (mut view, mut track, mut bearing, mut sensors) = (vec![], vec![], vec![], vec![]);
    for (i, j, sensor) in seen {
        let in_view = truth.cam_from_world[i].apply(&sub(&truth.points[j], &truth.centers[i]));
        view.push(i as u32);
        track.push(j as u32);
        bearing.push(normalized(&sub(&in_view, &levers[sensor])));
        sensors.push(sensor as u32);
    }
    let (n, m) = (truth.centers.len(), truth.points.len());
    (Tracks::new(view, track, bearing, None, n, m).unwrap(), sensors)
}

/// The same tracks with noise on their bearings.
pub fn noisy<const D: usize>(tracks: &Tracks<D>, sigma: f64, seed: u64) -> Tracks<D> {
    let mut noise = Noise::new(seed);
    let bearing = tracks.bearing().iter().map(|b| {
        let basis = panopath::geometry::tangent_basis(b);
        let off = basis[..D - 1].iter().fold(*b, |sum, t| add(&sum, &scale(sigma * noise.normal(), t)));
        normalized(&off)
    });
    let bearing = bearing.collect();
    let (view, track) = (tracks.view().to_vec(), tracks.track().to_vec());
    Tracks::new(view, track, bearing, None, tracks.n_views(), tracks.n_tracks()).unwrap()
}

/// Views turned at random on a wavy path of steps of one, points about it.
pub fn walk<const D: usize>(n_views: usize, n_points: usize, seed: u64) -> Structure<D> {
    let mut noise = Noise::new(seed);
    let centers: Vec<Vector<D>> = (0..n_views)
        .map(|i| {
            let s = i as f64;
            std::array::from_fn(|c| if c == 0 { s } else { (0.7 * s + c as f64).sin() + 0.1 * noise.normal() })
        })
        .collect();
    let points: Vec<Vector<D>> = (0..n_points)
        .map(|_| {
            let along = noise.uniform() * (n_views as f64 - 1.0);
            let off: Vector<D> = scale(2.0 + 6.0 * noise.uniform(), &noise.direction());
            std::array::from_fn(|c| off[c] + if c == 0 { along } else { 0.0 })
        })
        .collect();
    let cams: Vec<Rotation<D>> = (0..n_views).map(|_| random_turn(&mut noise, 2.0)).collect();
    structure(&cams, &centers, &points)
}

/// Every view sees every track, sensors in turn.
pub fn everything(n_views: usize, n_tracks: usize, n_sensors: usize) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..n_tracks).flat_map(move |j| (0..n_views).map(move |i| (i, j, (i + j) % n_sensors)))
}

/// Sum of squared residual angles.
pub fn squared_residuals<const D: usize>(scene: &Structure<D>) -> f64 {
    scene.residual_rad.iter().filter(|r| r.is_finite()).map(|r| r * r).sum()
}

/// Angle between a bearing and the prediction of a scene.
pub fn residual_of<const D: usize>(scene: &Structure<D>, tracks: &Tracks<D>, o: usize) -> f64 {
    let (i, j) = (tracks.view()[o] as usize, tracks.track()[o] as usize);
    let u = normalized(&sub(&scene.points[j], &scene.centers[i]));
    angle_between(&scene.cam_from_world[i].apply(&u), &tracks.bearing()[o])
}
