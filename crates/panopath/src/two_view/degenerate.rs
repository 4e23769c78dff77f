//! The two scenes in which matches say less than a relative pose: no baseline, and a single plane.
//!
//! Without a baseline `b2 = R b1`. With all points on one plane, whose inverse depth along `b1` is `m . b1` (in baselines),
//! `b2 ~ R b1 - (m . b1) s`, a homography. Both predict the second bearing entirely: two equations a match where the
//! epipolar plane gives one. Whether the second equation holds as well as the first is asked of the noise: the two sums of
//! squares are compared by their ratio, each over its degrees of freedom. Matches that the special scene does not explain
//! speak for the general one only if there are more of them than false matches would supply: the two that fix the direction
//! of the baseline, and those that fall within the noise of it by chance.

use crate::geometry::{Matrix, Rotation, Vector, add, cross, dot, normalized, scale, sub, tangent_basis};

use super::epipolar::{Matches, Pose};
use super::normal::Normal;

/// A match is explained where its two errors are within this many standard deviations (exp(-8) of true ones are beyond).
const GATE: f64 = 4.0;
/// Agreement that would come about by chance less often than this is no chance.
const SURPRISE: f64 = 0.01;

/// How far above the noise a ratio may be, in its standard deviations, where a baseline is in question. The direction of
/// one that is not there is the best of a whole sphere for the noise at hand, and makes the noise look small: over views
/// without a baseline the ratio exceeds this once in a hundred.
pub const BASELINE_DEVIATIONS: f64 = 7.0;
/// The same where a second plane is in question.
pub const RELIEF_DEVIATIONS: f64 = 4.0;

/// A rotation without a baseline.
pub struct RotationFit {
    pub second_from_first: Rotation<3>,
    /// Deviation of one bearing along one tangent direction, from the matches it explains.
    pub sigma: f64,
    pub explained: Vec<bool>,
    pub n_explained: usize,
    /// Normal equations in `phi` over the explained matches.
    pub normal: Normal<3>,
}

impl RotationFit {
    /// Square of the distance of predicted and measured bearing.
    pub fn squared_chord(&self, first: &Vector<3>, second: &Vector<3>) -> f64 {
        let d = sub(&self.second_from_first.apply(first), second);
        dot(&d, &d)
    }

    /// Whether a match is within the noise. Both bearings are noisy: the angle between them has twice the variance.
    pub fn explains(&self, first: &Vector<3>, second: &Vector<3>) -> bool {
        self.squared_chord(first, second) < 2.0 * (GATE * self.sigma).powi(2)
    }
}

/// Fits a rotation to the matches within the noise of it, or only the noise where it is `known`: Gauss-Newton, the noise and
/// the matches in turn. The noise is `sigma` at first, and `within` two bounds later.
pub fn fit_rotation(
    matches: &Matches,
    start: &Rotation<3>,
    known: bool,
    sigma: f64,
    within: (f64, f64),
) -> RotationFit {
    let mut fit = RotationFit {
        second_from_first: *start,
        sigma,
        explained: vec![false; matches.len()],
        n_explained: 0,
        normal: Normal::new(),
    };
    for _ in 0..20 {
        gather(matches, &mut fit);
        let phi = if known { [0.0; 3] } else { fit.normal.step(0.0).unwrap_or_default() };
        fit.second_from_first = Rotation::exp(&phi).compose(&fit.second_from_first);
        let explained = (0..matches.len()).filter(|&i| fit.explained[i]);
        let squares: f64 = explained.map(|i| fit.squared_chord(&matches.first[i], &matches.second[i])).sum();
        let freedom = 2.0 * fit.n_explained as f64 - if known { 0.0 } else { 3.0 };
        if freedom <= 0.0 {
            break;
        }
        let before = fit.sigma;
        fit.sigma = (0.5 * squares / freedom).sqrt().clamp(within.0, within.1);
        if dot(&phi, &phi).sqrt() < 1e-9 && (fit.sigma - before).abs() < 1e-3 * before {
            break;
        }
    }
    gather(matches, &mut fit);
    fit
}

/// The matches that are within the noise, and their normal equations.
fn gather(matches: &Matches, fit: &mut RotationFit) {
    fit.normal = Normal::new();
    fit.n_explained = 0;
    for (i, (a, b)) in matches.first.iter().zip(&matches.second).enumerate() {
        fit.explained[i] = fit.explains(a, b);
        if fit.explained[i] {
            fit.n_explained += 1;
            let q = fit.second_from_first.apply(a);
            for t in tangent_basis(&q) {
                // exp(phi) q moves by (q x t) . phi along t, away from the measured bearing
                fit.normal.add(&scale(-1.0, &cross(&q, &t)), dot(&t, b), 1.0);
            }
        }
    }
}

/// Relative pose and plane that together make a homography.
#[derive(Clone, Copy)]
pub struct PlanarPose {
    pub pose: Pose,
    /// Inverse depth of the plane along a bearing of the first camera is `plane . b1`, in baselines.
    pub plane: Vector<3>,
}

/// What a plane makes of the matches.
pub struct PlaneFit {
    pub planar: PlanarPose,
    /// Sum over the explained matches of their whitened squares: two a match, each of variance `sigma^2`.
    pub squares: f64,
    pub explained: Vec<bool>,
    pub n_explained: usize,
    /// Normal equations in `(phi, alpha, plane)` over the explained matches.
    pub normal: Normal<8>,
    pub basis: [Vector<3>; 2],
}

/// Fits pose and plane together to the matches in `inlier`, from a pose. None where nothing like a plane is there.
pub fn fit_plane(matches: &Matches, inlier: &[bool], pose: &Pose, sigma: f64) -> Option<PlaneFit> {
    let plane = plane_of(matches, inlier, pose)?;
    let mut fit = judge_plane(matches, inlier, &PlanarPose { pose: *pose, plane }, sigma);
    let mut damping = 1e-9;
    for _ in 0..12 {
        let step = fit.normal.step(damping)?;
        let next = judge_plane(matches, inlier, &moved(&fit, &step), sigma);
        let (gained, size) = (robust_cost(&fit, inlier, sigma) - robust_cost(&next, inlier, sigma), dot(&step, &step));
        if gained >= 0.0 {
            fit = next;
            damping *= 0.1;
        } else {
            damping = (damping * 100.0).max(1e-4);
        }
        if gained.abs() < 1e-3 * sigma * sigma || size < 1e-24 || damping > 1e4 {
            break;
        }
    }
    Some(fit)
}

/// Squares of what is explained, and the gate's square for each match that is not.
fn robust_cost(fit: &PlaneFit, inlier: &[bool], sigma: f64) -> f64 {
    let n = inlier.iter().filter(|&&k| k).count();
    fit.squares + (n - fit.n_explained) as f64 * (GATE * sigma).powi(2)
}

fn moved(fit: &PlaneFit, step: &[f64; 8]) -> PlanarPose {
    let PlanarPose { pose, plane } = fit.planar;
    let shift = add(&scale(step[3], &fit.basis[0]), &scale(step[4], &fit.basis[1]));
    PlanarPose {
        pose: Pose {
            second_from_first: Rotation::exp(&[step[0], step[1], step[2]]).compose(&pose.second_from_first),
            baseline: normalized(&add(&pose.baseline, &shift)),
        },
        plane: std::array::from_fn(|c| plane[c] + step[5 + c]),
    }
}

/// The plane nearest to the points that a pose gives, re-weighted against those off it.
fn plane_of(matches: &Matches, inlier: &[bool], pose: &Pose) -> Option<Vector<3>> {
    // rho (b2 x s) = b2 x q for inverse depth rho
    let rows: Vec<(Vector<3>, f64)> = (0..matches.len())
        .filter(|&i| inlier[i])
        .map(|i| {
            let (first, second) = (&matches.first[i], &matches.second[i]);
            let lever = cross(second, &pose.baseline);
            let size = dot(&lever, &lever).sqrt().max(1e-12);
            let across = cross(second, &pose.second_from_first.apply(first));
            (scale(size, first), dot(&lever, &across) / size)
        })
        .collect();
    let mut plane = [0.0; 3];
    let mut spread = f64::INFINITY;
    for _ in 0..6 {
        let mut normal = Normal::<3>::new();
        for (row, value) in &rows {
            let r = dot(row, &plane) - value;
            normal.add(row, r, (1.0 + (r / spread).powi(2)).powi(-2));
        }
        plane = add(&plane, &normal.step(0.0)?);
        let mut errors: Vec<f64> = rows.iter().map(|(row, value)| (dot(row, &plane) - value).abs()).collect();
        let middle = errors.len() / 2;
        spread = 3.0 * errors.select_nth_unstable_by(middle, f64::total_cmp).1.max(1e-12);
    }
    Some(plane)
}

/// What a pose and a plane make of the matches in `inlier`.
pub fn judge_plane(matches: &Matches, inlier: &[bool], planar: &PlanarPose, sigma: f64) -> PlaneFit {
    let basis = tangent_basis(&planar.pose.baseline);
    let mut fit = PlaneFit {
        planar: *planar,
        squares: 0.0,
        explained: vec![false; matches.len()],
        n_explained: 0,
        normal: Normal::new(),
        basis,
    };
    for i in (0..matches.len()).filter(|&i| inlier[i]) {
        let Some((z, jacobian)) = transfer(planar, &basis, &matches.first[i], &matches.second[i]) else { continue };
        let squared = z[0] * z[0] + z[1] * z[1];
        if squared < (GATE * sigma).powi(2) {
            fit.explained[i] = true;
            fit.n_explained += 1;
            fit.squares += squared;
            for k in 0..2 {
                fit.normal.add(&jacobian[k], z[k], 1.0);
            }
        }
    }
    fit
}

/// Where the homography misses the second bearing, along two tangent directions, whitened so that each has the variance of
/// one bearing along one tangent direction; with its derivatives by `(phi, alpha, plane)`. None behind the second camera.
fn transfer(
    planar: &PlanarPose,
    basis: &[Vector<3>; 2],
    first: &Vector<3>,
    second: &Vector<3>,
) -> Option<([f64; 2], [[f64; 8]; 2])> {
    let (r, s, m) = (planar.pose.second_from_first, planar.pose.baseline, planar.plane);
    let q = r.apply(first);
    let inverse_depth = dot(&m, first);
    let w = sub(&q, &scale(inverse_depth, &s));
    let length = dot(&w, &w).sqrt();
    let predicted = normalized(&w);
    if dot(&predicted, second) <= 0.0 || length < 1e-9 {
        return None;
    }
    let across = tangent_basis(&predicted);
    let moves = tangent_basis(first).map(|t| sub(&r.apply(&t), &scale(dot(&m, &t), &s)));
    let spread: [[f64; 2]; 2] = std::array::from_fn(|a| std::array::from_fn(|b| dot(&across[a], &moves[b]) / length));
    // covariance 1 + spread spread^T and its Cholesky factor
    let covariance = |a: usize, b: usize| f64::from(u8::from(a == b)) + dot(&spread[a], &spread[b]);
    let l00 = covariance(0, 0).sqrt();
    let l10 = covariance(1, 0) / l00;
    let l11 = (covariance(1, 1) - l10 * l10).sqrt();
    let whiten = |d: [f64; 2]| [d[0] / l00, (d[1] - l10 * d[0] / l00) / l11];
    let derivative = |of: &Vector<3>| whiten([-dot(&across[0], of) / length, -dot(&across[1], of) / length]);
    let mut jacobian = [[0.0; 8]; 2];
    for k in 0..8 {
        let of = match k {
            // exp(phi) q = q + phi x q
            0..3 => cross(&std::array::from_fn(|c| if c == k { 1.0 } else { 0.0 }), &q),
            3 | 4 => scale(-inverse_depth, &basis[k - 3]),
            _ => scale(-first[k - 5], &s),
        };
        let [a, b] = derivative(&of);
        (jacobian[0][k], jacobian[1][k]) = (a, b);
    }
    Some((whiten([dot(&across[0], second), dot(&across[1], second)]), jacobian))
}

/// The other pose and plane with the same homography (Longuet-Higgins 1986 shows that there are two).
///
/// With `c` the second centre in the first frame, `H = R (1 - c m^T)` and `H^T H = 1 + a m^T + m a^T`, where
/// `a = m / 2 - c`. A symmetric product does not tell its factors apart, so `m' = a` and `a' = m` fit as well, with
/// `c' = |c'|^2 m' / 2 - a'`; that `H` keeps its determinant asks for `|c'|^2 = |m|^2 / |a|^2`.
pub fn other_pose(planar: &PlanarPose) -> Option<PlanarPose> {
    let r = planar.pose.second_from_first;
    let (m, c) = (planar.plane, r.inverse().apply(&planar.pose.baseline));
    let a = sub(&scale(0.5, &m), &c);
    let squared = dot(&m, &m) / dot(&a, &a);
    let center = sub(&scale(0.5 * squared, &a), &m);
    let shrink = 1.0 - dot(&center, &a);
    // (1 - c' m'^T)^-1 = 1 + c' m'^T / (1 - c' . m')
    let undo: Matrix<3> =
        std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j)) + center[i] * a[j] / shrink));
    let forward: Matrix<3> =
        std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j)) - c[i] * m[j]));
    let product = |x: &Matrix<3>, y: &Matrix<3>| -> Matrix<3> {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| x[i][k] * y[k][j]).sum()))
    };
    let rotation = Rotation::from_matrix(product(&product(r.matrix(), &forward), &undo))?;
    let length = dot(&center, &center).sqrt();
    if length.is_nan() || length < 1e-9 {
        return None;
    }
    Some(PlanarPose {
        pose: Pose { second_from_first: rotation, baseline: rotation.apply(&scale(1.0 / length, &center)) },
        plane: scale(length, &a),
    })
}

impl PlanarPose {
    /// The same homography with the second centre on the other side, and with it all points on the other side of the first.
    pub fn mirrored(&self) -> Self {
        let pose = Pose { baseline: scale(-1.0, &self.pose.baseline), ..self.pose };
        Self { pose, plane: scale(-1.0, &self.plane) }
    }
}

/// How many of the explained matches lie on the plane in front of the first camera.
pub fn n_before(matches: &Matches, fit: &PlaneFit, planar: &PlanarPose) -> usize {
    let ahead = |i: &usize| fit.explained[*i] && dot(&planar.plane, &matches.first[*i]) > 0.0;
    (0..matches.len()).filter(ahead).count()
}

/// Whether a sum of squares over `more` further degrees of freedom is what the noise makes of them: not above their number
/// by so many `deviations` of the ratio to the noise, itself known from `known` degrees of freedom.
pub fn is_noise(squares: f64, more: f64, sigma: f64, known: f64, deviations: f64) -> bool {
    let ratio = squares / (more * sigma * sigma);
    ratio < 1.0 + deviations * (2.0 / more + 2.0 / known).sqrt()
}

/// The number of matches, out of `n` false ones, that the best direction of a baseline agrees with by chance: two fix it,
/// each of the others agrees with probability `chance`. More have a probability below 1 %, over all pairs that fix it.
pub fn by_chance(n: usize, chance: f64) -> usize {
    if n <= 2 {
        return n;
    }
    let rest = n - 2;
    let expected = |k: usize| ln_choose(n, 2) + ln_choose(rest, k) + k as f64 * chance.ln();
    // the least number of further matches that chance would not bring
    let surprising = (1..=rest).find(|&k| expected(k) < SURPRISE.ln()).unwrap_or(rest + 1);
    1 + surprising
}

/// Logarithm of the number of ways to choose `k` of `n`.
pub fn ln_choose(n: usize, k: usize) -> f64 {
    (0..k.min(n - k)).map(|i| ((n - i) as f64 / (i + 1) as f64).ln()).sum()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn planar() -> PlanarPose {
        PlanarPose {
            pose: Pose { second_from_first: Rotation::exp(&[0.3, -0.2, 0.5]), baseline: normalized(&[0.4, 1.0, -0.3]) },
            plane: [0.1, 0.25, 0.3],
        }
    }

    #[test]
    fn derivatives_of_the_homography_are_those_of_central_differences() {
        let planar = planar();
        let basis = tangent_basis(&planar.pose.baseline);
        let first = normalized(&[0.3, 0.5, 0.8]);
        let predicted = {
            let q = planar.pose.second_from_first.apply(&first);
            normalized(&sub(&q, &scale(dot(&planar.plane, &first), &planar.pose.baseline)))
        };
        let (z, jacobian) = transfer(&planar, &basis, &first, &predicted).unwrap();
        assert!(z[0].abs().max(z[1].abs()) < 1e-15);
        for c in 0..8 {
            let at = |h: f64| {
                let mut step = [0.0; 8];
                step[c] = h;
                let fit = PlaneFit {
                    planar,
                    squares: 0.0,
                    explained: Vec::new(),
                    n_explained: 0,
                    normal: Normal::new(),
                    basis,
                };
                let next = moved(&fit, &step);
                transfer(&next, &basis, &first, &predicted).unwrap().0
            };
            let (ahead, behind) = (at(1e-6), at(-1e-6));
            for k in 0..2 {
                let numeric = (ahead[k] - behind[k]) / 2e-6;
                assert!((numeric - jacobian[k][c]).abs() < 1e-8, "{k} {c}: {numeric} {}", jacobian[k][c]);
            }
        }
    }

    #[test]
    fn the_other_pose_has_the_same_homography() {
        let (one, other) = (planar(), other_pose(&planar()).unwrap());
        let homography = |p: &PlanarPose, b: &Vector<3>| {
            sub(&p.pose.second_from_first.apply(b), &scale(dot(&p.plane, b), &p.pose.baseline))
        };
        for b in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            let apart = sub(&homography(&one, &b), &homography(&other, &b));
            assert!(dot(&apart, &apart).sqrt() < 1e-14, "{apart:?}");
        }
        let turn = one.pose.second_from_first.inverse().compose(&other.pose.second_from_first);
        assert!((turn.matrix()[0][0] - 1.0).abs() > 1e-3, "it is another one");
        let back = other_pose(&other).unwrap();
        assert!(dot(&back.pose.baseline, &one.pose.baseline) > 1.0 - 1e-12, "and the other of the other is the first");
    }

    #[test]
    fn chance_grows_with_the_number_of_false_matches() {
        assert_eq!((by_chance(0, 0.01), by_chance(1, 0.01), by_chance(2, 0.01)), (0, 1, 2));
        let few: Vec<usize> = [3, 10, 30, 100, 300].iter().map(|&n| by_chance(n, 0.005)).collect();
        assert!(few.is_sorted() && few[0] == 3 && few[4] < 30, "{few:?}");
    }
}
