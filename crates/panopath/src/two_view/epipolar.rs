//! One pair of views: how far matches are from a relative pose, and the pose nearest to them.
//!
//! With `q = second_from_first b1`, `b2` the bearing in the second camera, and the unit vector `s` towards the second
//! centre as seen from the first, in the second camera's frame, rays that meet have `e = b2 . (s x q) = 0`. To first order
//! the angle by which both bearings have to move together to meet is Sampson's
//!
//! `r = e / g,   g^2 = |s x q|^2 + |s x b2|^2 - 2 e^2`,
//!
//! which has the standard deviation of one bearing along one tangent direction: one equation a match, in the five unknowns
//! `second_from_first <- exp(phi) second_from_first` and `s <- s + S alpha` with `S` a basis of the tangent plane at `s`.
//! The depths along the two rays, in baselines, have the signs of `s . q - (s . b2) (q . b2)` and
//! `(s . q) (q . b2) - s . b2`.

use crate::geometry::{Matrix, Rotation, Vector, add, apply, cross, dot, norm, normalized, scale, sub, tangent_basis};

use super::normal::Normal;

/// Matches that are scored together: what the widest registers hold.
const LANES: usize = 8;

/// Coordinates of [`LANES`] matches. Lanes without a match are zero, which no pose has in front of it.
#[derive(Clone, Copy)]
struct Block {
    first: [[f64; LANES]; 3],
    second: [[f64; LANES]; 3],
}

/// The matches of a pair of views, unit vectors; kept twice, match by match and in blocks for scoring.
pub struct Matches {
    pub first: Vec<Vector<3>>,
    pub second: Vec<Vector<3>>,
    blocks: Vec<Block>,
}

impl Matches {
    pub fn new(first: Vec<Vector<3>>, second: Vec<Vector<3>>) -> Self {
        let lanes =
            |of: &[Vector<3>]| std::array::from_fn(|c| std::array::from_fn(|k| of.get(k).map_or(0.0, |b| b[c])));
        let blocks = first.chunks(LANES).zip(second.chunks(LANES));
        let blocks = blocks.map(|(a, b)| Block { first: lanes(a), second: lanes(b) }).collect();
        Self { first, second, blocks }
    }

    pub fn len(&self) -> usize {
        self.first.len()
    }
}

/// A relative pose; `s` is `baseline`: the unit vector from the first centre to the second, in the second camera's frame.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    pub second_from_first: Rotation<3>,
    pub baseline: Vector<3>,
}

impl Pose {
    /// The pose moved by `(phi, alpha)`.
    fn moved(&self, step: &[f64; 5], basis: &[Vector<3>; 2]) -> Self {
        let turn = Rotation::exp(&[step[0], step[1], step[2]]);
        let shift = add(&scale(step[3], &basis[0]), &scale(step[4], &basis[1]));
        Self {
            second_from_first: turn.compose(&self.second_from_first),
            baseline: normalized(&add(&self.baseline, &shift)),
        }
    }
}

/// What one match says about a pose.
#[derive(Clone, Copy, Debug)]
pub struct Sighting {
    /// The signed angle `r`.
    pub error: f64,
    /// Whether the rays meet in front of both cameras, or are parallel as far as the tolerance can tell.
    pub in_front: bool,
}

/// The error of one match; `tolerance` is the angle by which rays may diverge and still be called parallel.
#[inline(always)]
pub fn sighting(pose: &Pose, first: &Vector<3>, second: &Vector<3>, tolerance: f64) -> Sighting {
    let q = pose.second_from_first.apply(first);
    let s = &pose.baseline;
    let e = dot(s, &cross(&q, second));
    let (along_first, along_second, c) = (dot(s, &q), dot(s, second), dot(&q, second));
    Sighting {
        error: e / gradient_squared(e, along_first, along_second).sqrt(),
        in_front: in_front(along_first, along_second, c, tolerance * tolerance),
    }
}

/// `g^2`; the last term keeps rays along the baseline, about which nothing is known, from dividing zero by zero.
#[inline(always)]
fn gradient_squared(e: f64, along_first: f64, along_second: f64) -> f64 {
    (2.0 - along_first * along_first - along_second * along_second - 2.0 * e * e).max(1e-14)
}

#[inline(always)]
fn in_front(along_first: f64, along_second: f64, c: f64, squared_tolerance: f64) -> bool {
    let depth_first = along_first - along_second * c;
    let depth_second = along_first * c - along_second;
    let parallel = (c > 0.0)
        & (depth_first * depth_first < squared_tolerance * (1.0 - along_second * along_second))
        & (depth_second * depth_second < squared_tolerance * (1.0 - along_first * along_first));
    ((depth_first > 0.0) & (depth_second > 0.0)) | parallel
}

/// The error of one match with its derivatives by `phi` and by `alpha`.
#[inline(always)]
fn linearised(pose: &Pose, basis: &[Vector<3>; 2], first: &Vector<3>, second: &Vector<3>) -> (f64, [f64; 5]) {
    let q = pose.second_from_first.apply(first);
    let s = &pose.baseline;
    let normal = cross(&q, second);
    let e = dot(s, &normal);
    let (along_first, along_second) = (dot(s, &q), dot(s, second));
    let g = gradient_squared(e, along_first, along_second).sqrt();
    // r = e / g and g dg = -(s.q) d(s.q) - (s.b2) d(s.b2) - 2 e de
    let of_e = 1.0 / g + 2.0 * e * e / (g * g * g);
    let (of_first, of_second) = (e * along_first / (g * g * g), e * along_second / (g * g * g));
    let (turn_e, turn_first) = (cross(&q, &cross(second, s)), cross(&q, s));
    let mut jacobian = [0.0; 5];
    for k in 0..3 {
        jacobian[k] = of_e * turn_e[k] + of_first * turn_first[k];
    }
    for k in 0..2 {
        let t = &basis[k];
        jacobian[3 + k] = of_e * dot(t, &normal) + of_first * dot(t, &q) + of_second * dot(t, second);
    }
    (e / g, jacobian)
}

/// How well a pose fits: the sum of `min(r^2, limit^2)`, and how many matches are within the limit and in front.
#[derive(Clone, Copy, Debug)]
pub struct Score {
    pub cost: f64,
    pub n_inliers: usize,
}

/// Scores a pose; given up, with an infinite cost, as soon as it costs more than `at_most`.
pub fn score(arch: pulp::Arch, matches: &Matches, pose: &Pose, limit: f64, at_most: f64) -> Score {
    arch.dispatch(Scoring { blocks: &matches.blocks, pose, limit, at_most })
}

struct Scoring<'a> {
    blocks: &'a [Block],
    pose: &'a Pose,
    limit: f64,
    at_most: f64,
}

impl pulp::WithSimd for Scoring<'_> {
    type Output = Score;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Score {
        let r = *self.pose.second_from_first.matrix();
        let (s, squared_limit) = (self.pose.baseline, self.limit * self.limit);
        let mut total = Score { cost: 0.0, n_inliers: 0 };
        for block in self.blocks {
            let [mut cost, mut inliers] = [[0.0; LANES]; 2];
            for k in 0..LANES {
                let a: Vector<3> = std::array::from_fn(|c| block.first[c][k]);
                let b: Vector<3> = std::array::from_fn(|c| block.second[c][k]);
                let q = apply(&r, &a);
                let e = dot(&s, &cross(&q, &b));
                let (along_first, along_second, c) = (dot(&s, &q), dot(&s, &b), dot(&q, &b));
                let squared = e * e / gradient_squared(e, along_first, along_second);
                let fits = (squared < squared_limit) & in_front(along_first, along_second, c, squared_limit);
                cost[k] = if fits { squared } else { squared_limit };
                inliers[k] = if fits { 1.0 } else { 0.0 };
            }
            total.cost += cost.iter().sum::<f64>();
            total.n_inliers += inliers.iter().sum::<f64>() as usize;
            if total.cost > self.at_most {
                return Score { cost: f64::INFINITY, n_inliers: 0 };
            }
        }
        total
    }
}

/// How true and false matches differ.
///
/// True ones have normal errors of deviation `sigma`, false ones are spread evenly: `chance_density` of them a radian of
/// `|r|`, those that are not in front left out. True ones also have about the parallax that the scene has, a half-Cauchy
/// density of median `parallax`, false ones any. Where all points are far that counts: a false match whose rays happen to
/// meet nearby would turn the baseline to itself by a lever that no true match has.
#[derive(Clone, Copy, Debug)]
pub struct Mixture {
    pub sigma: f64,
    /// Share of true matches.
    pub share: f64,
    pub chance_density: f64,
    /// Median parallax of true matches.
    pub parallax: f64,
    /// Largest parallax of false ones, below which all are as frequent.
    pub chance_parallax: f64,
}

impl Mixture {
    /// Density of a true match of the usual parallax at `r = 0` over that of a false one.
    fn odds(&self) -> f64 {
        let peak = (2.0 / std::f64::consts::PI).sqrt() / self.sigma;
        self.share / (1.0 - self.share) * peak / self.chance_density
    }

    /// The error at which a match is as likely true as false.
    pub fn gate(&self) -> f64 {
        self.sigma * (2.0 * self.odds().ln().max(0.0)).sqrt()
    }

    /// The same density for each match, at the parallax it has.
    fn odds_of(&self, matches: &Matches, pose: &Pose) -> Vec<f64> {
        let odds = self.odds() * 2.0 / std::f64::consts::PI * self.chance_parallax * self.parallax;
        let squared = self.parallax * self.parallax;
        parallaxes(matches, pose).map(|p| odds / (squared + p * p)).collect()
    }
}

/// Angles (as chords) between the two rays of each match.
pub fn parallaxes(matches: &Matches, pose: &Pose) -> impl Iterator<Item = f64> {
    let turn = pose.second_from_first;
    matches.first.iter().zip(&matches.second).map(move |(a, b)| norm(&sub(&turn.apply(a), b)))
}

/// Rays that diverge by up to so many standard deviations of the angle between them are parallel.
const PARALLEL: f64 = 4.0 * std::f64::consts::SQRT_2;

/// What errors cost at a given noise.
#[derive(Clone, Copy)]
struct Loss {
    half_precision: f64,
    tolerance: f64,
    squared_limit: f64,
}

impl Loss {
    fn new(sigma: f64, limit: f64) -> Self {
        Self { half_precision: 0.5 / (sigma * sigma), tolerance: PARALLEL * sigma, squared_limit: limit * limit }
    }

    /// How sure it is that a match is true, and what it adds to the negative logarithm of the likelihood; `odds` are those
    /// of being true if the error were zero.
    #[inline(always)]
    fn weigh(&self, seen: &Sighting, odds: f64) -> (f64, f64) {
        let squared = seen.error * seen.error;
        if !seen.in_front || squared > self.squared_limit {
            return (0.0, 0.0);
        }
        let odds = odds * (-squared * self.half_precision).exp();
        (odds / (1.0 + odds), -(1.0 + odds).ln())
    }
}

/// A pose and how sure each match is.
pub struct Fit {
    pub pose: Pose,
    /// Probability of each match to be a true one.
    pub weight: Vec<f64>,
    /// Normal equations in `(phi, alpha)` at the pose, of weighted matches in units of radians squared.
    pub normal: Normal<5>,
    /// Basis that `alpha` refers to.
    pub basis: [Vector<3>; 2],
}

/// What stays fixed while a pose is fitted.
#[derive(Clone, Copy)]
pub struct Fitting<'a> {
    pub matches: &'a Matches,
    /// No error beyond this is a true match's.
    pub limit: f64,
    /// Whether the rotation is sought too.
    pub free_rotation: bool,
    /// Standard deviations below this are not believed.
    pub least_sigma: f64,
}

impl Fitting<'_> {
    /// Cost of a pose and, in `weight`, how sure each match is.
    fn weigh(&self, pose: &Pose, loss: &Loss, odds: &[f64], weight: &mut [f64]) -> f64 {
        let mut cost = 0.0;
        for (((a, b), o), w) in self.matches.first.iter().zip(&self.matches.second).zip(odds).zip(weight) {
            let (sure, added) = loss.weigh(&sighting(pose, a, b, loss.tolerance), *o);
            *w = sure;
            cost += added;
        }
        cost
    }

    fn assemble(&self, pose: &Pose, basis: &[Vector<3>; 2], weight: &[f64]) -> Normal<5> {
        let mut normal = Normal::new();
        for ((a, b), w) in self.matches.first.iter().zip(&self.matches.second).zip(weight) {
            // what hardly counts does not count: most of the false matches
            if *w > 1e-6 {
                let (r, jacobian) = linearised(pose, basis, a, b);
                normal.add(&jacobian, r, *w);
            }
        }
        if !self.free_rotation {
            normal.hold_first(3);
        }
        normal
    }

    /// Levenberg and Marquardt's descent from a pose, with the noise and the odds of each match to be true held.
    pub fn descend(&self, start: &Pose, sigma: f64, odds: &[f64], max_iterations: usize) -> Fit {
        let loss = Loss::new(sigma, self.limit);
        let (mut pose, mut damping) = (*start, 1e-9);
        let mut weight = vec![0.0; self.matches.len()];
        let mut trial = weight.clone();
        let mut cost = self.weigh(&pose, &loss, odds, &mut weight);
        let mut basis = tangent_basis(&pose.baseline);
        let mut normal = self.assemble(&pose, &basis, &weight);
        for _ in 0..max_iterations {
            let Some(step) = normal.step(damping) else {
                if damping > 1.0 {
                    break;
                }
                damping = (damping * 1e3).max(1e-9);
                continue;
            };
            let next = pose.moved(&step, &basis);
            let next_cost = self.weigh(&next, &loss, odds, &mut trial);
            let size = dot(&step, &step).sqrt();
            if next_cost <= cost {
                (pose, cost, damping) = (next, next_cost, damping * 0.1);
                std::mem::swap(&mut weight, &mut trial);
                basis = tangent_basis(&pose.baseline);
                normal = self.assemble(&pose, &basis, &weight);
            } else {
                damping = (damping * 100.0).max(1e-4);
            }
            if size < 1e-3 * sigma.min(1e-6) || damping > 1e6 {
                break;
            }
        }
        Fit { pose, weight, normal, basis }
    }

    /// Descent and the mixture's own estimate in turn: expectation and maximisation.
    pub fn settle(&self, start: &Pose, first_guess: &Mixture, max_rounds: usize) -> (Fit, Mixture) {
        let mut mixture = *first_guess;
        let mut fit = self.descend(start, mixture.sigma, &mixture.odds_of(self.matches, start), 3);
        for _ in 0..max_rounds {
            let Some(next) = self.mixture_of(&fit, &mixture) else { break };
            let change =
                (next.sigma / mixture.sigma).ln().abs().max(0.2 * (next.parallax / mixture.parallax).ln().abs());
            mixture = next;
            let odds = mixture.odds_of(self.matches, &fit.pose);
            fit = self.descend(&fit.pose, mixture.sigma, &odds, if change < 0.02 { 10 } else { 3 });
            if change < 0.02 {
                break;
            }
        }
        (fit, mixture)
    }

    /// Noise, parallax and share of true matches as the errors show them.
    fn mixture_of(&self, fit: &Fit, before: &Mixture) -> Option<Mixture> {
        let (mut total, mut squares) = (0.0, 0.0);
        for ((a, b), w) in self.matches.first.iter().zip(&self.matches.second).zip(&fit.weight) {
            total += w;
            squares += w * sighting(&fit.pose, a, b, 0.0).error.powi(2);
        }
        let unknowns = if self.free_rotation { 5.0 } else { 2.0 };
        let freedom = total - unknowns;
        if freedom <= 0.5 {
            return None;
        }
        let n = self.matches.len() as f64;
        let sigma = (squares / freedom).sqrt().clamp(self.least_sigma, self.limit);
        Some(Mixture {
            sigma,
            // one match of them all may always be wrong, or none could be found to be
            share: (total / n).clamp(0.5 / n, 1.0 - 0.5 / n),
            parallax: usual_parallax(self.matches, fit)?.clamp(sigma, before.chance_parallax),
            ..*before
        })
    }
}

/// Median of the parallaxes of the matches that are rather true than false.
fn usual_parallax(matches: &Matches, fit: &Fit) -> Option<f64> {
    let all = parallaxes(matches, &fit.pose).zip(&fit.weight);
    let mut of_true: Vec<f64> = all.filter(|(_, w)| **w > 0.5).map(|(p, _)| p).collect();
    let middle = of_true.len() / 2;
    (middle > 0).then(|| *of_true.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The relative poses of an essential matrix `E = [s]x R`, without singular vectors (Horn 1990): two rotations, each with
/// `s` and `-s`.
pub fn poses_of(e: &Matrix<3>) -> Option<[Pose; 4]> {
    let gram: Matrix<3> = std::array::from_fn(|r| std::array::from_fn(|c| dot(&e[r], &e[c])));
    let half = 0.5 * (gram[0][0] + gram[1][1] + gram[2][2]);
    // s s^T = tr(E E^T) / 2 - E E^T: its largest column is the safest
    let k = (0..3).fold(0, |best, k| if gram[k][k] < gram[best][best] { k } else { best });
    let column: Vector<3> = std::array::from_fn(|r| if r == k { half - gram[r][k] } else { -gram[r][k] });
    let s = scale(1.0 / column[k].max(0.0).sqrt(), &column);
    let squared = dot(&s, &s);
    if squared.is_nan() || !(1e-9..1e9).contains(&squared) {
        return None;
    }
    let rotation = |sign: f64| {
        let rows: Matrix<3> = std::array::from_fn(|r| {
            let cofactor = cross(&e[(r + 1) % 3], &e[(r + 2) % 3]);
            let (i, j) = ((r + 1) % 3, (r + 2) % 3);
            // row r of [s]x E
            std::array::from_fn(|c| (cofactor[c] - sign * (s[i] * e[j][c] - s[j] * e[i][c])) / squared)
        });
        orthonormal(&rows)
    };
    let (one, other) = (rotation(1.0)?, rotation(-1.0)?);
    let (there, back) = (normalized(&s), normalized(&scale(-1.0, &s)));
    Some(
        [(one, there), (one, back), (other, there), (other, back)]
            .map(|(second_from_first, baseline)| Pose { second_from_first, baseline }),
    )
}

/// Rows made orthonormal one after another.
fn orthonormal(rows: &Matrix<3>) -> Option<Rotation<3>> {
    let x = normalized(&rows[0]);
    let z = normalized(&cross(&x, &rows[1]));
    Rotation::from_matrix([x, cross(&z, &x), z])
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn pose(k: f64) -> Pose {
        Pose {
            second_from_first: Rotation::exp(&[0.3 * k, -1.2, 0.4 + k]),
            baseline: normalized(&[0.2 - k, 0.5, -0.7 * k]),
        }
    }

    #[test]
    fn derivatives_are_those_of_central_differences() {
        for k in 0..20 {
            let k = f64::from(k);
            let pose = pose(0.3 * k);
            let first = normalized(&[k.sin(), (2.0 * k).cos(), 0.3]);
            // near the epipolar plane and far from it
            let second = normalized(&[(k + 0.1).sin(), (3.0 * k).cos(), 0.4 - 0.1 * k]);
            let basis = tangent_basis(&pose.baseline);
            let (r, jacobian) = linearised(&pose, &basis, &first, &second);
            assert!((r - sighting(&pose, &first, &second, 0.0).error).abs() < 1e-14);
            for c in 0..5 {
                let at = |h: f64| {
                    let mut step = [0.0; 5];
                    step[c] = h;
                    sighting(&pose.moved(&step, &basis), &first, &second, 0.0).error
                };
                let h = 1e-5;
                let numeric = (at(h) - at(-h)) / (2.0 * h);
                assert!((numeric - jacobian[c]).abs() < 1e-7 * (1.0 + numeric.abs()), "{c}: {numeric} {}", jacobian[c]);
            }
        }
    }

    #[test]
    fn the_error_is_the_least_movement_of_both_bearings() {
        // move both bearings along the gradient by r / 2 each in the sum of squares: the rays then meet
        let pose = pose(0.7);
        let x = [1.5, -2.0, 3.0];
        let first = normalized(&x);
        let s_in_first = pose.second_from_first.inverse().apply(&pose.baseline);
        let second = pose.second_from_first.apply(&normalized(&crate::geometry::sub(&x, &s_in_first)));
        assert!(sighting(&pose, &first, &second, 0.0).error.abs() < 1e-15);
        let q = pose.second_from_first.apply(&first);
        let across = |v: &Vector<3>| normalized(&cross(&cross(&pose.baseline, v), v));
        let out_of_plane = |v: &Vector<3>| normalized(&cross(v, &across(v)));
        let moved = normalized(&add(&second, &scale(1e-4, &out_of_plane(&second))));
        let r = sighting(&pose, &first, &moved, 0.0).error.abs();
        let (a, b) = (dot(&cross(&pose.baseline, &q), &cross(&pose.baseline, &q)).sqrt(), {
            let c = cross(&pose.baseline, &second);
            dot(&c, &c).sqrt()
        });
        // only the second was moved: its share of the gradient is |s x q|
        assert!((r - 1e-4 * a / (a * a + b * b).sqrt()).abs() < 1e-8, "{r}");
    }

    #[test]
    fn a_matrix_gives_back_the_pose_it_was_made_of() {
        for k in 0..10 {
            let truth = pose(0.4 * f64::from(k));
            let r = truth.second_from_first.matrix();
            let e: Matrix<3> = std::array::from_fn(|row| {
                std::array::from_fn(|c| 0.7 * cross(&truth.baseline, &[r[0][c], r[1][c], r[2][c]])[row])
            });
            let nearest = poses_of(&e).unwrap().iter().fold(f64::MAX, |least, p| {
                let turn = p.second_from_first.matrix().iter().flatten().zip(r.iter().flatten());
                let turn = turn.map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
                let apart = (0..3).map(|c| (p.baseline[c] - truth.baseline[c]).abs()).fold(0.0, f64::max);
                least.min(turn.max(apart))
            });
            assert!(nearest < 1e-12, "{nearest}");
        }
    }
}
