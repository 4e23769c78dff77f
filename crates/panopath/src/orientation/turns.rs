//! The two groups that orientations live in, written so that one solver serves both: angles (1 freedom) and unit
//! quaternions (3).
//!
//! A small turn `w` is applied as `R exp(w)`, in the world: in the camera it is `exp(R w) R`. Seen from the world the
//! linear equations of an edge are `w_second - w_first`, without rotations in them; that makes the system a graph
//! Laplacian.

use crate::geometry::{Rotation, Vector, dot, inverse_left_jacobian, norm, scale};

/// An element of a rotation group with `K` freedoms.
pub(super) trait Turn<const K: usize>: Copy + Send + Sync {
    /// What is known beforehand of one view.
    type Prior: Copy + Send + Sync;
    fn identity() -> Self;
    fn exp(w: &Vector<K>) -> Self;
    fn log(&self) -> Vector<K>;
    /// `c_from_a = c_from_b.compose(b_from_a)`, kept on the group against rounding.
    fn compose(&self, other: &Self) -> Self;
    fn inverse(&self) -> Self;
    /// Squared cosine of half the angle between the two: cheap, and 1 where they are equal.
    fn closeness(&self, other: &Self) -> f64;
    /// What a prior asks of a view of this orientation.
    fn pull(&self, prior: &Self::Prior) -> Pull<K>;
    /// What a prior says whatever the others do.
    fn role(prior: &Self::Prior) -> Role;
    /// The common turn `g` that brings `R g` of all these views near their priors.
    fn alignment(known: &[(Self, Self::Prior)]) -> Self;
}

/// The quadratic model of a prior about the current orientation: `information * w = force`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pull<const K: usize> {
    pub information: [Vector<K>; K],
    pub force: Vector<K>,
}

/// How a prior takes part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// Fixes the orientation with the same weight about every axis.
    Isotropic,
    /// Fixes the orientation, the axes coupled.
    Coupled,
    /// Fixes the vertical: the same weight about x and y, none about z.
    Up,
    /// Fixes the turn about a vertical that others must fix.
    Heading,
}

/// A rotation of the plane, or about the vertical, by its angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Angle(pub f64);

/// The angle that `cam_from_world` should have.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AnglePrior {
    pub cam_from_world: Angle,
    pub weight: f64,
}

/// The same angle in `[-pi, pi]`.
pub(super) fn wrapped(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}

impl Turn<1> for Angle {
    type Prior = AnglePrior;

    fn identity() -> Self {
        Self(0.0)
    }

    fn exp(w: &Vector<1>) -> Self {
        Self(w[0])
    }

    fn log(&self) -> Vector<1> {
        [self.0]
    }

    fn compose(&self, other: &Self) -> Self {
        Self(wrapped(self.0 + other.0))
    }

    fn inverse(&self) -> Self {
        Self(-self.0)
    }

    fn closeness(&self, other: &Self) -> f64 {
        (0.5 * (self.0 - other.0)).cos().powi(2)
    }

    fn pull(&self, prior: &AnglePrior) -> Pull<1> {
        let off = wrapped(prior.cam_from_world.0 - self.0);
        Pull { information: [[prior.weight]], force: [prior.weight * off] }
    }

    fn role(_: &AnglePrior) -> Role {
        Role::Isotropic
    }

    fn alignment(known: &[(Self, AnglePrior)]) -> Self {
        let sum = known.iter().fold([0.0, 0.0], |[x, y], (now, prior)| {
            let (sin, cos) = (prior.cam_from_world.0 - now.0).sin_cos();
            [x + prior.weight * cos, y + prior.weight * sin]
        });
        Self(sum[1].atan2(sum[0]))
    }
}

/// A rotation of space as the unit quaternion `(w, x, y, z)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Quaternion(pub [f64; 4]);

impl Quaternion {
    pub fn of(rotation: &Rotation<3>) -> Self {
        Self(rotation.quaternion())
    }

    /// The rotation about z by `angle`.
    pub fn about_z(angle: f64) -> Self {
        let (sin, cos) = (0.5 * angle).sin_cos();
        Self([cos, 0.0, 0.0, sin])
    }

    /// The shortest rotation that takes the z axis to the unit vector `up`.
    pub fn from_z_to(up: &Vector<3>) -> Self {
        // half-way between z and up: (1 + up_z, z x up), or any axis across z for up = -z
        let q = [1.0 + up[2], -up[1], up[0], 0.0];
        let length = dot(&q, &q).sqrt();
        if length > 1e-9 { Self(scale(1.0 / length, &q)) } else { Self([0.0, 1.0, 0.0, 0.0]) }
    }

    /// Angle of the rotation about z that is nearest.
    pub fn angle_about_z(&self) -> f64 {
        let [w, _, _, z] = self.0;
        wrapped(2.0 * z.atan2(w))
    }

    /// Angle between the z axis and where it is taken.
    pub fn tilt(&self) -> f64 {
        let [w, x, y, z] = self.0;
        2.0 * x.hypot(y).atan2(z.hypot(w))
    }

    pub fn apply(&self, a: &Vector<3>) -> Vector<3> {
        self.rotation().apply(a)
    }

    pub fn rotation(&self) -> Rotation<3> {
        Rotation::from_quaternion(&self.0)
    }
}

/// What may be known of a view in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum SpatialPrior {
    /// The orientation, with the inverse covariance of a small rotation in the camera.
    Orientation { cam_from_world: Quaternion, information: [Vector<3>; 3] },
    /// Where up is in the camera.
    Up { up: Vector<3>, weight: f64 },
    /// Along which angle of the horizontal plane the camera axis `forward` points.
    Heading { heading_rad: f64, forward: Vector<3>, weight: f64 },
}

/// A camera axis nearer to the vertical than this sine has no heading.
pub(super) const LEAST_HORIZONTAL: f64 = 0.05;

impl Turn<3> for Quaternion {
    type Prior = SpatialPrior;

    fn identity() -> Self {
        Self([1.0, 0.0, 0.0, 0.0])
    }

    #[inline]
    fn exp(w: &Vector<3>) -> Self {
        let squared = dot(w, w);
        let half = 0.5 * squared.sqrt();
        let factor = if half < 1e-4 { 0.5 - squared / 48.0 } else { 0.5 * half.sin() / half };
        Self([half.cos(), factor * w[0], factor * w[1], factor * w[2]])
    }

    #[inline]
    fn log(&self) -> Vector<3> {
        let [w, x, y, z] = self.0;
        let sine = norm(&[x, y, z]);
        let sign = if w < 0.0 { -1.0 } else { 1.0 };
        let factor = if sine > 1e-150 { 2.0 * sine.atan2(w.abs()) / sine } else { 2.0 };
        scale(sign * factor, &[x, y, z])
    }

    #[inline]
    fn compose(&self, other: &Self) -> Self {
        let ([aw, ax, ay, az], [bw, bx, by, bz]) = (self.0, other.0);
        let q = [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ];
        // one step of Newton's towards length one
        Self(scale(1.5 - 0.5 * dot(&q, &q), &q))
    }

    #[inline]
    fn inverse(&self) -> Self {
        let [w, x, y, z] = self.0;
        Self([w, -x, -y, -z])
    }

    #[inline]
    fn closeness(&self, other: &Self) -> f64 {
        dot(&self.0, &other.0).powi(2)
    }

    fn pull(&self, prior: &SpatialPrior) -> Pull<3> {
        match prior {
            SpatialPrior::Orientation { cam_from_world, information } => {
                pull_of_orientation(self, cam_from_world, information)
            }
            SpatialPrior::Up { up, weight } => {
                // the rotation that takes the predicted to the measured up, seen in the world, where predicted up is z
                let turn = Self::from_z_to(&self.inverse().apply(up)).log();
                let information = [[*weight, 0.0, 0.0], [0.0, *weight, 0.0], [0.0; 3]];
                Pull { information, force: [weight * turn[0], weight * turn[1], 0.0] }
            }
            SpatialPrior::Heading { heading_rad, forward, weight } => {
                let f = self.inverse().apply(forward);
                let horizontal = f[0] * f[0] + f[1] * f[1];
                if horizontal.sqrt() < LEAST_HORIZONTAL {
                    return Pull { information: [[0.0; 3]; 3], force: [0.0; 3] };
                }
                let off = wrapped(heading_rad - f[1].atan2(f[0]));
                // derivative of the heading by w
                let j = [f[2] * f[0] / horizontal, f[2] * f[1] / horizontal, -1.0];
                let information = std::array::from_fn(|r| std::array::from_fn(|c| weight * j[r] * j[c]));
                Pull { information, force: scale(weight * off, &j) }
            }
        }
    }

    fn role(prior: &SpatialPrior) -> Role {
        match prior {
            SpatialPrior::Orientation { information: m, .. } => {
                let equal = m[0][0] == m[1][1] && m[1][1] == m[2][2];
                let uncoupled = (0..3).all(|r| (0..3).all(|c| r == c || m[r][c] == 0.0));
                if equal && uncoupled { Role::Isotropic } else { Role::Coupled }
            }
            SpatialPrior::Up { .. } => Role::Up,
            SpatialPrior::Heading { .. } => Role::Heading,
        }
    }

    fn alignment(known: &[(Self, SpatialPrior)]) -> Self {
        let mut sum = [0.0; 4];
        let mut up_in_world = [0.0; 3];
        for (now, prior) in known {
            match prior {
                SpatialPrior::Orientation { cam_from_world, information } => {
                    let q = now.inverse().compose(cam_from_world).0;
                    let weight = information[0][0] + information[1][1] + information[2][2];
                    let weight = if dot(&sum, &q) < 0.0 { -weight } else { weight };
                    sum = std::array::from_fn(|k| sum[k] + weight * q[k]);
                }
                SpatialPrior::Up { up, weight } => {
                    let u = now.inverse().apply(up);
                    up_in_world = std::array::from_fn(|k| up_in_world[k] + weight * u[k]);
                }
                SpatialPrior::Heading { .. } => {}
            }
        }
        if dot(&sum, &sum) > 0.0 {
            return Self(scale(1.0 / dot(&sum, &sum).sqrt(), &sum));
        }
        let length = norm(&up_in_world);
        if length == 0.0 {
            return Self::identity();
        }
        let level = Self::from_z_to(&scale(1.0 / length, &up_in_world));
        level.compose(&Self::about_z(-mean_heading_error(known, &level)))
    }
}

/// Mean of measured less predicted heading, once the world is level.
fn mean_heading_error(known: &[(Quaternion, SpatialPrior)], level: &Quaternion) -> f64 {
    let (mut x, mut y) = (0.0, 0.0);
    for (now, prior) in known {
        if let SpatialPrior::Heading { heading_rad, forward, weight } = prior {
            let f = now.compose(level).inverse().apply(forward);
            let strength = weight * f[0].hypot(f[1]);
            let (sin, cos) = (heading_rad - f[1].atan2(f[0])).sin_cos();
            (x, y) = (x + strength * cos, y + strength * sin);
        }
    }
    y.atan2(x)
}

/// `phi = log(prior R^-1)` in the camera, of cost `phi^T information phi`; the small rotation `R w` changes it by
/// `-B R w` with `B` the inverse right Jacobian of the exponential at `phi`, which is the left one at `-phi`.
fn pull_of_orientation(now: &Quaternion, prior: &Quaternion, information: &[Vector<3>; 3]) -> Pull<3> {
    let phi = prior.compose(&now.inverse()).log();
    let jacobian = matmul(&inverse_left_jacobian(&scale(-1.0, &phi)), now.rotation().matrix());
    let weighted = matmul(information, &jacobian);
    let transposed = Rotation::trusted(jacobian).inverse();
    let force = transposed.apply(&crate::geometry::apply(information, &phi));
    Pull { information: matmul(transposed.matrix(), &weighted), force }
}

fn matmul(a: &[Vector<3>; 3], b: &[Vector<3>; 3]) -> [Vector<3>; 3] {
    *Rotation::trusted(*a).compose(&Rotation::trusted(*b)).matrix()
}
