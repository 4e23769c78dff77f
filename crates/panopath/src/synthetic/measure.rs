//! What the views of a scene measure: orientation, motion, noise and outliers on top of exact directions.

use std::f64::consts::{FRAC_PI_4, PI, TAU};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::bodies::Traffic;
use super::layout::{Layout, direction, log_uniform};
use super::{Motion, Orientations, World, WorldError, WorldKind, WorldOptions};
use crate::geometry::{Matrix, Rotation, Vector, add, norm, normalized, scale, sub, tangent_basis};
use crate::tracks::Tracks;

/// Independent sources of randomness under one seed.
#[derive(Clone, Copy)]
pub(super) enum Stream {
    Views,
    Points,
    Visibility,
    Infinity,
    Motion,
    Orientation,
    OrientationError,
    Noise,
    Outliers,
    Bodies,
    Angles,
}

pub(super) fn stream(seed: u64, which: Stream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(which as u64);
    rng
}

/// A body that is farther than this from its view would hardly seem to move: movers are placed within it.
const MOVER_REACH_M: (f64, f64) = (2.0, 15.0);
/// The operator's distance from the camera that he carries, and the half angle under which he is seen.
const OPERATOR_M: (f64, f64) = (0.3, 1.0);
const OPERATOR_HALF_ANGLE_RAD: f64 = FRAC_PI_4;

/// Measures a layout.
pub(super) fn measure<const D: usize>(
    kind: WorldKind,
    mut layout: Layout<D>,
    o: &WorldOptions,
) -> Result<World<D>, WorldError> {
    let time_s: Vec<f64> = (0..o.n_views).map(|view| view as f64 * o.frame_interval_s).collect();
    let cam_from_world = true_orientations::<D>(o);
    send_to_infinity(&mut layout, o);
    let mut point_time_s: Vec<f64> = layout.anchor.iter().map(|&view| time_s[view as usize]).collect();
    let motion = set_in_motion(kind, &mut layout, &mut point_time_s, &cam_from_world, &time_s, o);
    // one body is a disturbance of a world at rest; many are what is to be found
    let is_false = |motion: &Motion<D>| match motion {
        Motion::Still => false,
        Motion::Moves { .. } => o.n_bodies == 1,
        Motion::Carried(_) => true,
    };

    let n_observations = layout.seen.len();
    let mut track = Vec::with_capacity(n_observations);
    let mut bearing = Vec::with_capacity(n_observations);
    let mut outlier = Vec::with_capacity(n_observations);
    let mut noise = stream(o.seed, Stream::Noise);
    let mut angles = stream(o.seed, Stream::Angles);
    let mut wrong = stream(o.seed, Stream::Outliers);
    for (j, motion) in motion.iter().enumerate() {
        for &view in &layout.seen[layout.first[j]..layout.first[j + 1]] {
            let i = view as usize;
            let seen = match motion {
                Motion::Carried(in_camera) => *in_camera,
                Motion::Moves { velocity, acceleration, .. } => {
                    let elapsed_s = time_s[i] - point_time_s[j];
                    let on_a_line = add(&layout.points[j], &scale(elapsed_s, velocity));
                    let position = add(&on_a_line, &scale(0.5 * elapsed_s * elapsed_s, acceleration));
                    cam_from_world[i].apply(&sub(&position, &layout.centers[i]))
                }
                Motion::Still => cam_from_world[i].apply(&sub(&layout.points[j], &layout.centers[i])),
            };
            let mut measured = normalized(&seen);
            if o.noise_rad > 0.0 {
                measured = disturb(&measured, o.noise_rad, &mut noise);
            }
            if o.angle_error_rad > 0.0 {
                measured = displace_angles(&measured, o.angle_error_rad, &mut angles);
            }
            let mut is_outlier = is_false(motion);
            if o.outlier_fraction > 0.0 {
                // drawn for every observation: a larger fraction keeps the outliers of a smaller one
                let (draw, anywhere) = (wrong.random::<f64>(), uniform_direction(&mut wrong));
                if draw < o.outlier_fraction {
                    measured = anywhere;
                    is_outlier = true;
                }
            }
            track.push(j as u32);
            bearing.push(measured);
            outlier.push(is_outlier);
        }
    }
    let Layout { centers, points, seen: view, .. } = layout;
    let tracks = Tracks::new(view, track, bearing, None, o.n_views, o.n_points)?;
    let cam_from_world = with_error(cam_from_world, o);
    Ok(World { tracks, cam_from_world, centers, points, motion, point_time_s, outlier, time_s, noise_rad: o.noise_rad })
}

/// Moves chosen points outwards along the ray of their anchor view.
fn send_to_infinity<const D: usize>(layout: &mut Layout<D>, o: &WorldOptions) {
    let mut rng = stream(o.seed, Stream::Infinity);
    for (point, &anchor) in layout.points.iter_mut().zip(&layout.anchor) {
        let (draw, share) = (rng.random::<f64>(), rng.random::<f64>());
        if draw < o.infinity_fraction {
            let center = &layout.centers[anchor as usize];
            let ray = normalized(&sub(point, center));
            *point = add(center, &scale(log_uniform(o.infinity_distance, share), &ray));
        }
    }
}

/// Chooses which tracks move, brings them near, and records where and when their anchor view saw them.
fn set_in_motion<const D: usize>(
    kind: WorldKind,
    layout: &mut Layout<D>,
    point_time_s: &mut [f64],
    cam_from_world: &[Rotation<D>],
    time_s: &[f64],
    o: &WorldOptions,
) -> Vec<Motion<D>> {
    let mut rng = stream(o.seed, Stream::Motion);
    let velocity = scale(o.mover_speed_m_s, &direction(rng.random_range(0.0..TAU), 0.0));
    let moves = |draw: f64| draw < o.mover_fraction;
    let carried = |draw: f64| draw >= 1.0 - o.operator_fraction;
    let mut traffic = (o.n_bodies > 1).then(|| Traffic::new(kind, o, &layout.centers, time_s));
    let mut views = vec![None; layout.points.len()];
    let mut place = |j: usize| {
        let (point, anchor) = (&mut layout.points[j], layout.anchor[j] as usize);
        let (draw, share) = (rng.random::<f64>(), rng.random::<f64>());
        let operator = below_the_camera(&mut rng);
        let center = &layout.centers[anchor];
        let ride = traffic.as_mut().map(Traffic::ride);
        if let (true, Some(ride)) = (moves(draw), ride) {
            (*point, point_time_s[j], views[j]) = (ride.point, ride.time_s, Some(ride.views));
            ride.motion
        } else if moves(draw) {
            let ray = sub(point, center);
            if norm(&ray) > MOVER_REACH_M.1 {
                *point = add(center, &scale(log_uniform(MOVER_REACH_M, share), &normalized(&ray)));
            }
            Motion::Moves { body: 0, velocity, acceleration: [0.0; D] }
        } else if carried(draw) {
            let in_camera = scale(log_uniform(OPERATOR_M, share), &operator);
            *point = add(center, &cam_from_world[anchor].inverse().apply(&in_camera));
            Motion::Carried(in_camera)
        } else {
            Motion::Still
        }
    };
    let motion = (0..o.n_points).map(&mut place).collect();
    if o.n_bodies > 1 {
        layout.see_again(&views);
    }
    motion
}

/// A direction of the cone about the negative last axis, which is down in a camera that shares the world's axes.
fn below_the_camera<const D: usize>(rng: &mut ChaCha8Rng) -> Vector<D> {
    let (tilt_rad, azimuth_rad) = (rng.random_range(0.0..OPERATOR_HALF_ANGLE_RAD), rng.random_range(0.0..TAU));
    if D == 2 {
        let side = if azimuth_rad < PI { 1.0 } else { -1.0 };
        return direction(side * tilt_rad - PI / 2.0, 0.0);
    }
    direction(azimuth_rad, tilt_rad - PI / 2.0)
}

fn uniform_direction<const D: usize>(rng: &mut ChaCha8Rng) -> Vector<D> {
    let (azimuth_rad, height) = (rng.random_range(0.0..TAU), rng.random_range(-1.0..1.0_f64));
    direction(azimuth_rad, height.asin())
}

/// Exponential map of the sphere at `bearing`, of a Gaussian vector of its tangent plane.
fn disturb<const D: usize>(bearing: &Vector<D>, deviation_rad: f64, rng: &mut ChaCha8Rng) -> Vector<D> {
    let mut tangent = [0.0; D];
    for axis in &tangent_basis(bearing)[..D - 1] {
        let step: f64 = StandardNormal.sample(rng);
        tangent = add(&tangent, &scale(deviation_rad * step, axis));
    }
    let angle_rad = norm(&tangent);
    if angle_rad == 0.0 {
        return *bearing;
    }
    let (sin, cos) = angle_rad.sin_cos();
    normalized(&add(&scale(cos, bearing), &scale(sin / angle_rad, &tangent)))
}

/// Adds uniform errors to the angles of a spherical camera, or to the one of a circular camera.
fn displace_angles<const D: usize>(bearing: &Vector<D>, most_rad: f64, rng: &mut ChaCha8Rng) -> Vector<D> {
    let mut error = || most_rad * rng.random_range(-1.0..1.0);
    let theta_rad = bearing[1].atan2(bearing[0]) + error();
    // in the plane no second error is drawn
    let phi_rad = if D == 2 { 0.0 } else { bearing[D - 1].atan2(bearing[0].hypot(bearing[1])) + error() };
    direction(theta_rad, phi_rad)
}

fn true_orientations<const D: usize>(o: &WorldOptions) -> Vec<Rotation<D>> {
    let mut rng = stream(o.seed, Stream::Orientation);
    let mut draw = || match o.orientations {
        Orientations::Identity => Rotation::identity(),
        Orientations::Random => uniform_rotation(&mut rng),
    };
    (0..o.n_views).map(|_| draw()).collect()
}

fn with_error<const D: usize>(cam_from_world: Vec<Rotation<D>>, o: &WorldOptions) -> Vec<Rotation<D>> {
    if o.orientation_error_rad == 0.0 {
        return cam_from_world;
    }
    let mut rng = stream(o.seed, Stream::OrientationError);
    let mut normal = || o.orientation_error_rad * Distribution::<f64>::sample(&StandardNormal, &mut rng);
    let mut turn = |truth: &Rotation<D>| exp([normal(), normal(), normal()]).compose(truth);
    cam_from_world.iter().map(&mut turn).collect()
}

/// A uniformly random rotation: in space that of a uniformly random unit quaternion.
fn uniform_rotation<const D: usize>(rng: &mut ChaCha8Rng) -> Rotation<D> {
    if D == 2 {
        return exp([rng.random_range(-PI..PI), 0.0, 0.0]);
    }
    let [w, x, y, z]: [f64; 4] = std::array::from_fn(|_| StandardNormal.sample(rng));
    let angle_rad = 2.0 * norm(&[x, y, z]).atan2(w);
    exp(scale(angle_rad, &normalized(&[x, y, z])))
}

/// Exponential of a rotation vector; in the plane its first entry is the angle.
fn exp<const D: usize>(phi: Vector<3>) -> Rotation<D> {
    let in_plane = Rotation::from_angle(phi[0]);
    let in_space = Rotation::exp(&phi);
    let entry = |r: usize, c: usize| if D == 2 { in_plane.matrix()[r][c] } else { in_space.matrix()[r][c] };
    let matrix: Matrix<D> = std::array::from_fn(|r| std::array::from_fn(|c| entry(r, c)));
    Rotation::from_matrix(matrix).unwrap_or_else(Rotation::identity)
}
