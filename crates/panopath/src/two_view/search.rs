//! Consensus among random small samples (Fischler and Bolles 1981), each new best one improved over all matches
//! (Chum, Matas and Kittler 2003), until a better one would have been drawn with the confidence asked for.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::geometry::{Matrix, Rotation, Vector, cross, dot, normalized, scale, sub};

use super::degenerate::RotationFit;
use super::epipolar::{Fitting, Pose, Score, poses_of, score, sighting};
use super::five_point::essential_matrices;

/// Samples drawn at least: a sample of true matches may be a poor one.
const LEAST_SAMPLES: usize = 12;
/// Samples drawn at most for a rotation; it is only one of the ways to a pose.
const MOST_ROTATIONS: usize = 100;

/// Samples drawn at most from the matches that a rotation does not explain: all of them may be false.
const MOST_APART: usize = 250;

/// A limit is so many standard deviations of the noise.
const LIMIT_DEVIATIONS: f64 = 4.0;

/// What a search works on.
pub struct Search<'a> {
    pub arch: pulp::Arch,
    pub fitting: Fitting<'a>,
    /// Odds of each match to be true where its error is zero; before anything is known they are all the same.
    pub odds: Vec<f64>,
    /// Errors up to this agree.
    pub limit: f64,
    pub confidence: f64,
    pub max_iterations: usize,
}

/// A pose and how well it fits.
#[derive(Clone, Copy)]
pub struct Candidate {
    pub pose: Pose,
    pub score: Score,
    /// Under which it was scored.
    pub limit: f64,
}

impl Search<'_> {
    /// Poses from five matches each, and from the best direction for a rotation that is proposed.
    pub fn pose(&self, rng: &mut ChaCha8Rng, proposed: Option<&RotationFit>) -> Option<Candidate> {
        let matches = self.fitting.matches;
        let samples = |c: &Candidate| self.samples(c.score.n_inliers as f64 / matches.len() as f64, 5);
        let mut best = proposed.and_then(|fit| self.direction(rng, fit)).and_then(|c| self.improved(&c.pose, c.limit));
        let mut limit = best.map_or(self.limit, |b| b.limit);
        let mut raw_cost = f64::INFINITY;
        let (mut drawn, mut needed) = (0, best.as_ref().map_or(self.max_iterations, samples));
        while drawn < needed {
            drawn += 1;
            let sample = draw::<5>(rng, matches.len());
            let (first, second) = (sample.map(|i| matches.first[i]), sample.map(|i| matches.second[i]));
            let mut raw = None;
            essential_matrices(&first, &second, |e| {
                for pose in poses_of(e).iter().flatten().filter(|p| self.all_in_front(p, &first, &second)) {
                    let score = score(self.arch, matches, pose, limit, raw_cost);
                    if score.cost < raw_cost {
                        raw_cost = score.cost;
                        raw = Some(*pose);
                    }
                }
            });
            let Some((pose, candidate)) = raw.and_then(|pose| Some((pose, self.improved(&pose, limit)?))) else {
                continue;
            };
            let score = self.scored(&candidate.pose, limit).score;
            if best.is_none_or(|b| score.cost < b.score.cost) {
                best = Some(candidate);
                if candidate.limit < limit {
                    // scores compare under one limit only
                    limit = candidate.limit;
                    raw_cost = self.scored(&pose, limit).score.cost;
                }
            }
            needed = best.as_ref().map_or(needed, samples);
        }
        best
    }

    /// Directions from two matches each, the rotation being given: `s` is perpendicular to `R b1 x b2` of both.
    ///
    /// Matches that the rotation explains alone agree with every direction within the noise. Where most are of that kind the
    /// others are few and decide: every second sample is drawn from them.
    pub fn direction(&self, rng: &mut ChaCha8Rng, rotation: &RotationFit) -> Option<Candidate> {
        let matches = self.fitting.matches;
        let all: Vec<usize> = (0..matches.len()).collect();
        let apart: Vec<usize> = all.iter().copied().filter(|&i| !rotation.explained[i]).collect();
        let turns = if apart.len() < 2 { [&all, &all] } else { [&all, &apart] };
        let mut best: Option<Candidate> = None;
        let (mut drawn, mut needed) = (0, self.max_iterations);
        while drawn < needed {
            let among = turns[drawn % 2];
            drawn += 1;
            let normals = draw::<2>(rng, among.len()).map(|k| {
                let i = among[k];
                cross(&rotation.second_from_first.apply(&matches.first[i]), &matches.second[i])
            });
            let s = cross(&normals[0], &normals[1]);
            if dot(&s, &s) < 1e-24 {
                continue;
            }
            for baseline in [normalized(&s), normalized(&scale(-1.0, &s))] {
                let pose = Pose { second_from_first: rotation.second_from_first, baseline };
                let at_most = best.map_or(f64::INFINITY, |b| b.score.cost);
                let score = score(self.arch, matches, &pose, self.limit, at_most);
                if score.cost < at_most {
                    best = Some(Candidate { pose, score, limit: self.limit });
                    let agreeing = score.n_inliers.saturating_sub(matches.len() - apart.len());
                    let of_all = self.samples(score.n_inliers as f64 / matches.len() as f64, 2);
                    let of_apart = self.samples(agreeing as f64 / apart.len().max(1) as f64, 2).min(MOST_APART);
                    needed = 2 * of_all.max(of_apart);
                }
            }
        }
        best
    }

    /// Rotations from two matches each, for views without a baseline.
    pub fn rotation(&self, rng: &mut ChaCha8Rng) -> Option<Rotation<3>> {
        let matches = self.fitting.matches;
        let squared_limit = 2.0 * self.limit * self.limit;
        let (mut best, mut best_cost) = (None, f64::INFINITY);
        let (mut drawn, mut needed) = (0, MOST_ROTATIONS.min(self.max_iterations));
        while drawn < needed {
            drawn += 1;
            let [i, j] = draw::<2>(rng, matches.len());
            let apart = dot(&matches.first[i], &matches.first[j]) - dot(&matches.second[i], &matches.second[j]);
            // a rotation keeps the angle between two bearings
            if apart.abs() > 4.0 * self.limit {
                continue;
            }
            let (Some(from), Some(to)) =
                (frame(&matches.first[i], &matches.first[j]), frame(&matches.second[i], &matches.second[j]))
            else {
                continue;
            };
            let Some(rotation) = Rotation::from_matrix(std::array::from_fn(|r| {
                std::array::from_fn(|c| (0..3).map(|k| to[k][r] * from[k][c]).sum())
            })) else {
                continue;
            };
            let (mut cost, mut n_inliers) = (0.0, 0usize);
            for (a, b) in matches.first.iter().zip(&matches.second) {
                let d = sub(&rotation.apply(a), b);
                let squared = dot(&d, &d);
                cost += squared.min(squared_limit);
                n_inliers += usize::from(squared < squared_limit);
                if cost >= best_cost {
                    break;
                }
            }
            if cost < best_cost {
                (best, best_cost) = (Some(rotation), cost);
                needed = needed.min(self.samples(n_inliers as f64 / matches.len() as f64, 2));
            }
        }
        best
    }

    /// A few steps of descent over all matches, the limit lowered to what the errors of those that agree allow: the fewer
    /// false matches agree by chance, the less they turn the pose to themselves.
    fn improved(&self, start: &Pose, limit: f64) -> Option<Candidate> {
        let mut best = self.scored(start, limit);
        for _ in 0..3 {
            let sigma = best.limit / 3.0;
            let pose = self.fitting.descend(&best.pose, sigma, &self.odds, 4).pose;
            best = self.scored(&pose, best.limit);
            let disagreeing = (self.fitting.matches.len() - best.score.n_inliers) as f64;
            let squares = best.score.cost - disagreeing * best.limit * best.limit;
            // five of the errors can always be made small
            let freedom = (best.score.n_inliers as f64 - 5.0).max(1.0);
            let lower = LIMIT_DEVIATIONS * (squares.max(0.0) / freedom).sqrt();
            if lower > 0.8 * best.limit {
                break;
            }
            best = self.scored(&pose, lower.max(0.5 * best.limit).max(0.05 * self.limit));
        }
        best.score.cost.is_finite().then_some(best)
    }

    fn scored(&self, pose: &Pose, limit: f64) -> Candidate {
        let score = score(self.arch, self.fitting.matches, pose, limit, f64::INFINITY);
        Candidate { pose: *pose, score, limit }
    }

    fn all_in_front(&self, pose: &Pose, first: &[Vector<3>; 5], second: &[Vector<3>; 5]) -> bool {
        first.iter().zip(second).all(|(a, b)| sighting(pose, a, b, self.limit).in_front)
    }

    /// Samples after which one of true matches only has been drawn, with the confidence asked for.
    fn samples(&self, share: f64, size: i32) -> usize {
        let miss = (1.0 - share.powi(size)).clamp(1e-12, 1.0 - 1e-12);
        let samples = ((1.0 - self.confidence).ln() / miss.ln()).ceil().min(1e9) as usize;
        samples.max(LEAST_SAMPLES).min(self.max_iterations)
    }
}

/// `N` different numbers below `n`, which is at least `N`.
fn draw<const N: usize>(rng: &mut ChaCha8Rng, n: usize) -> [usize; N] {
    let mut sample = [usize::MAX; N];
    for k in 0..N {
        while sample[k] == usize::MAX || sample[..k].contains(&sample[k]) {
            sample[k] = rng.random_range(0..n);
        }
    }
    sample
}

/// Right-handed frame of two directions that enter alike: their mean, their difference and the perpendicular of both.
fn frame(a: &Vector<3>, b: &Vector<3>) -> Option<Matrix<3>> {
    let (mean, difference) = (std::array::from_fn(|c| a[c] + b[c]), sub(a, b));
    let (long, short) =
        (dot(&mean, &mean).max(dot(&difference, &difference)), dot(&mean, &mean).min(dot(&difference, &difference)));
    // nearly the same or nearly opposite bearings turn about themselves freely
    if short < 1e-6 * long {
        return None;
    }
    let (x, y) = (normalized(&mean), normalized(&difference));
    Some([x, y, cross(&x, &y)])
}
