//! Vectors, rotations and similarities in d = 2 and d = 3, written once for both.
//!
//! A vector is a plain `[f64; D]`. A [`Rotation`] maps one frame to another and is named for it: `cam_from_world`
//! takes world directions to camera directions. Small rotations act on the left, `exp(phi) * R`, in the target frame.

/// Vector of `D` coordinates.
pub type Vector<const D: usize> = [f64; D];
/// Square matrix, row by row.
pub type Matrix<const D: usize> = [[f64; D]; D];

/// Inner product.
#[inline(always)]
pub fn dot<const D: usize>(a: &Vector<D>, b: &Vector<D>) -> f64 {
    let mut sum = 0.0;
    for c in 0..D {
        sum += a[c] * b[c];
    }
    sum
}

/// `a + b`.
#[inline(always)]
pub fn add<const D: usize>(a: &Vector<D>, b: &Vector<D>) -> Vector<D> {
    std::array::from_fn(|c| a[c] + b[c])
}

/// `a - b`.
#[inline(always)]
pub fn sub<const D: usize>(a: &Vector<D>, b: &Vector<D>) -> Vector<D> {
    std::array::from_fn(|c| a[c] - b[c])
}

/// `s * a`.
#[inline(always)]
pub fn scale<const D: usize>(s: f64, a: &Vector<D>) -> Vector<D> {
    std::array::from_fn(|c| s * a[c])
}

/// Vector product.
#[inline]
pub fn cross(a: &Vector<3>, b: &Vector<3>) -> Vector<3> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Euclidean length.
#[inline(always)]
pub fn norm<const D: usize>(a: &Vector<D>) -> f64 {
    dot(a, a).sqrt()
}

/// `a / |a|`; the first axis where `a` has no direction.
#[inline]
pub fn normalized<const D: usize>(a: &Vector<D>) -> Vector<D> {
    let length = norm(a);
    if length > 0.0 && length.is_finite() {
        scale(1.0 / length, a)
    } else {
        std::array::from_fn(|c| if c == 0 { 1.0 } else { 0.0 })
    }
}

/// `m * a`.
#[inline(always)]
pub fn apply<const D: usize>(m: &Matrix<D>, a: &Vector<D>) -> Vector<D> {
    std::array::from_fn(|r| dot(&m[r], a))
}

/// Angle between two unit vectors, accurate from 0 to pi (Kahan's form).
pub fn angle_between<const D: usize>(a: &Vector<D>, b: &Vector<D>) -> f64 {
    2.0 * norm(&sub(a, b)).atan2(norm(&add(a, b)))
}

/// Orthonormal basis of the tangent space of the sphere at the unit vector `a`: `D - 1` vectors.
///
/// For d = 2 the single vector is `a` turned by +90 degrees, so that tangent coordinates are signed angles.
pub fn tangent_basis<const D: usize>(a: &Vector<D>) -> [Vector<D>; 2] {
    let mut basis = [[0.0; D]; 2];
    if D == 2 {
        basis[0][0] = -a[1];
        basis[0][1] = a[0];
        return basis;
    }
    let smallest = (0..D).fold(0, |best, c| if a[c].abs() < a[best].abs() { c } else { best });
    let mut first: Vector<D> = std::array::from_fn(|c| if c == smallest { 1.0 } else { 0.0 });
    first = normalized(&sub(&first, &scale(a[smallest], a)));
    basis[0] = first;
    basis[1] = std::array::from_fn(|c| {
        let (i, j) = ((c + 1) % D, (c + 2) % D);
        a[i] * first[j] - a[j] * first[i]
    });
    basis
}

/// Inverse of the left Jacobian of the exponential of rotations,
/// `I - [phi]_x / 2 + (1 - (a/2) cot(a/2)) / a^2 [phi]_x^2`, `a = |phi|` (Barfoot, State Estimation for Robotics, 2017,
/// eq. 7.77). That of the right one is the same at `-phi`.
pub(crate) fn inverse_left_jacobian(phi: &Vector<3>) -> Matrix<3> {
    let squared = dot(phi, phi);
    let half = 0.5 * squared.sqrt();
    let factor = if squared < 1e-4 { 1.0 / 12.0 + squared / 720.0 } else { (1.0 - half / half.tan()) / squared };
    let [x, y, z] = *phi;
    let cross = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
    std::array::from_fn(|r| {
        std::array::from_fn(|c| {
            let square = phi[r] * phi[c] - if r == c { squared } else { 0.0 };
            f64::from(r == c) - 0.5 * cross[r][c] + factor * square
        })
    })
}

/// A rotation of the plane (`D = 2`) or of space (`D = 3`), held as an orthonormal matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation<const D: usize = 3> {
    matrix: Matrix<D>,
}

/// How far a matrix may be from orthonormal and still be read as a rotation.
pub const ROTATION_TOLERANCE: f64 = 1e-6;

impl<const D: usize> Rotation<D> {
    /// The rotation that changes nothing.
    pub fn identity() -> Self {
        Self { matrix: std::array::from_fn(|r| std::array::from_fn(|c| if r == c { 1.0 } else { 0.0 })) }
    }

    /// Reads a matrix, or `None` where it is not a rotation to within [`ROTATION_TOLERANCE`].
    pub fn from_matrix(matrix: Matrix<D>) -> Option<Self> {
        for r in 0..D {
            for c in 0..D {
                let wanted = if r == c { 1.0 } else { 0.0 };
                let error = (dot(&matrix[r], &matrix[c]) - wanted).abs();
                if error.is_nan() || error > ROTATION_TOLERANCE {
                    return None;
                }
            }
        }
        (determinant(&matrix) > 0.0).then_some(Self { matrix })
    }

    /// A matrix that the caller vouches for; NaN means *not determined*.
    pub(crate) fn trusted(matrix: Matrix<D>) -> Self {
        Self { matrix }
    }

    /// The matrix, row by row.
    pub fn matrix(&self) -> &Matrix<D> {
        &self.matrix
    }

    /// `self * a`.
    #[inline]
    pub fn apply(&self, a: &Vector<D>) -> Vector<D> {
        apply(&self.matrix, a)
    }

    /// The inverse rotation: `world_from_cam` from `cam_from_world`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { matrix: std::array::from_fn(|r| std::array::from_fn(|c| self.matrix[c][r])) }
    }

    /// `c_from_a = c_from_b * b_from_a`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        let mut matrix = [[0.0; D]; D];
        for (r, row) in matrix.iter_mut().enumerate() {
            for (c, entry) in row.iter_mut().enumerate() {
                *entry = (0..D).map(|k| self.matrix[r][k] * other.matrix[k][c]).sum();
            }
        }
        Self { matrix }
    }
}

impl<const D: usize> Rotation<D> {
    /// Exponential of a turn: one angle in the plane, a rotation vector in space; entries that are missing are zero.
    pub fn exp_of(turn: &[f64]) -> Self {
        let entry = |k: usize| turn.get(k).copied().unwrap_or(0.0);
        let matrix = if D == 2 {
            let (sin, cos) = entry(0).sin_cos();
            [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]
        } else {
            Rotation::<3>::exp(&[entry(0), entry(1), entry(2)]).matrix
        };
        Self { matrix: std::array::from_fn(|r| std::array::from_fn(|c| matrix[r][c])) }
    }

    /// The turn whose exponential this is, of at most pi; in the plane only the first entry counts.
    pub fn turn(&self) -> [f64; 3] {
        let m = |r: usize, c: usize| self.matrix[r][c];
        if D == 2 {
            return [m(1, 0).atan2(m(0, 0)), 0.0, 0.0];
        }
        Rotation::<3> { matrix: std::array::from_fn(|r| std::array::from_fn(|c| m(r, c))) }.log()
    }
}

impl Rotation<2> {
    /// Rotation by `angle_rad`, anticlockwise.
    pub fn from_angle(angle_rad: f64) -> Self {
        let (sin, cos) = angle_rad.sin_cos();
        Self { matrix: [[cos, -sin], [sin, cos]] }
    }

    /// The angle in `(-pi, pi]` whose [`from_angle`](Self::from_angle) this is.
    pub fn angle(&self) -> f64 {
        self.matrix[1][0].atan2(self.matrix[0][0])
    }
}

impl Rotation<3> {
    /// Exponential of the rotation vector `phi` (axis times angle in radians), Rodrigues' formula.
    pub fn exp(phi: &Vector<3>) -> Self {
        let squared = dot(phi, phi);
        let angle = squared.sqrt();
        // sin(a)/a and (1 - cos a)/a^2, by series where the quotients lose digits
        let (s, c) = if angle < 1e-4 {
            (1.0 - squared / 6.0, 0.5 - squared / 24.0)
        } else {
            (angle.sin() / angle, 2.0 * (0.5 * angle).sin().powi(2) / squared)
        };
        let [x, y, z] = *phi;
        let cross = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
        let mut matrix = *Self::identity().matrix();
        for (r, row) in matrix.iter_mut().enumerate() {
            for (col, entry) in row.iter_mut().enumerate() {
                let square: f64 = (0..3).map(|k| cross[r][k] * cross[k][col]).sum();
                *entry += s * cross[r][col] + c * square;
            }
        }
        Self { matrix }
    }

    /// The rotation vector of length at most pi whose [`exp`](Self::exp) this is, to full precision from 0 to pi.
    ///
    /// At pi the axis has two signs, and either may come out.
    pub fn log(&self) -> Vector<3> {
        let [w, x, y, z] = self.quaternion();
        let sine = norm(&[x, y, z]);
        // angle / sin(angle / 2), by its limit where both vanish
        let factor = if sine > 1e-150 { 2.0 * sine.atan2(w) / sine } else { 2.0 / w };
        scale(factor, &[x, y, z])
    }

    /// The unit quaternion `(w, x, y, z)` of this rotation with `w >= 0`.
    ///
    /// The largest component is found first, so that no digits are lost near half a turn (Shepperd 1978).
    pub fn quaternion(&self) -> [f64; 4] {
        let m = &self.matrix;
        let trace = m[0][0] + m[1][1] + m[2][2];
        let largest =
            (0..3).fold(3, |best, k| if m[k][k] > if best == 3 { trace } else { m[best][best] } { k } else { best });
        let mut q = [0.0; 4];
        if largest == 3 {
            q = [1.0 + trace, m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
        } else {
            let (i, j, k) = (largest, (largest + 1) % 3, (largest + 2) % 3);
            q[0] = m[k][j] - m[j][k];
            q[1 + i] = 1.0 + m[i][i] - m[j][j] - m[k][k];
            q[1 + j] = m[i][j] + m[j][i];
            q[1 + k] = m[i][k] + m[k][i];
        }
        let length = dot(&q, &q).sqrt();
        scale(if q[0] < 0.0 { -1.0 / length } else { 1.0 / length }, &q)
    }

    /// The rotation of a quaternion `(w, x, y, z)` of any length but zero.
    pub fn from_quaternion(q: &[f64; 4]) -> Self {
        let [w, x, y, z] = *q;
        let s = 2.0 / dot(q, q);
        let matrix = [
            [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
        ];
        Self { matrix }
    }
}

fn determinant<const D: usize>(m: &Matrix<D>) -> f64 {
    match D {
        2 => m[0][0] * m[1][1] - m[0][1] * m[1][0],
        _ => (0..D)
            .map(|c| m[0][c] * (m[1][(c + 1) % D] * m[2][(c + 2) % D] - m[1][(c + 2) % D] * m[2][(c + 1) % D]))
            .sum(),
    }
}

/// `x_in_b = scale * rotation * x_in_a + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity<const D: usize = 3> {
    /// Positive factor.
    pub scale: f64,
    /// Applied before scale and shift.
    pub rotation: Rotation<D>,
    /// Where the origin of `a` lies in `b`.
    pub translation: Vector<D>,
}

impl<const D: usize> Similarity<D> {
    /// The similarity that changes nothing.
    pub fn identity() -> Self {
        Self { scale: 1.0, rotation: Rotation::identity(), translation: [0.0; D] }
    }

    /// `self * x`.
    pub fn apply(&self, x: &Vector<D>) -> Vector<D> {
        add(&scale(self.scale, &self.rotation.apply(x)), &self.translation)
    }

    /// Least-squares similarity that takes the first of each pair to the second (Umeyama 1991), never a reflection.
    /// `None` where the pairs do not fix it: fewer than two distinct places.
    pub fn fit(pairs: &[(Vector<D>, Vector<D>)]) -> Option<Self> {
        let (from, to) = centroids(pairs);
        let mut correlation = [[0.0; D]; D];
        for (a, b) in pairs {
            let (a, b) = (sub(a, &from), sub(b, &to));
            for r in 0..D {
                for c in 0..D {
                    correlation[r][c] += b[r] * a[c];
                }
            }
        }
        let rotation = crate::least_squares::nearest_rotation(&correlation)?;
        Self::fit_scale(pairs, &from, &to, rotation)
    }

    /// The same with the rotation held at the identity.
    pub fn fit_unrotated(pairs: &[(Vector<D>, Vector<D>)]) -> Option<Self> {
        let (from, to) = centroids(pairs);
        Self::fit_scale(pairs, &from, &to, Rotation::identity())
    }

    fn fit_scale(
        pairs: &[(Vector<D>, Vector<D>)],
        from: &Vector<D>,
        to: &Vector<D>,
        rotation: Rotation<D>,
    ) -> Option<Self> {
        let (mut along, mut spread) = (0.0, 0.0);
        for (a, b) in pairs {
            let a = sub(a, from);
            along += dot(&rotation.apply(&a), &sub(b, to));
            spread += dot(&a, &a);
        }
        let factor = along / spread;
        (factor.is_finite() && factor > 0.0).then(|| Self {
            scale: factor,
            rotation,
            translation: sub(to, &scale(factor, &rotation.apply(from))),
        })
    }
}

fn centroids<const D: usize>(pairs: &[(Vector<D>, Vector<D>)]) -> (Vector<D>, Vector<D>) {
    let share = 1.0 / pairs.len().max(1) as f64;
    pairs
        .iter()
        .fold(([0.0; D], [0.0; D]), |(from, to), (a, b)| (add(&from, &scale(share, a)), add(&to, &scale(share, b))))
}
