//! Rigid components, from how fast each segment stretches.
//!
//! A null vector changes every observed segment along itself alone: `dX_j - q_ij = lambda_ij u_ij`. So it moves each observation
//! by a similarity of its own: the stretch `lambda`, the turn `theta` of its view, and the shift
//! `tau = dc - lambda c - theta x c`. Two observations belong to one rigid component if and only if these are equal in every
//! null vector. Most are joined through shared members, where stretch and turn decide; what is left are bodies that move as
//! one although no member is shared: two bodies held by points on the line between a view of each, say.

use super::frame::Frame;
use super::spectrum::{Mode, scattered};
use crate::bundle::determinacy::across;
use crate::bundle::noise::median;
use crate::bundle::part::Lanes;
use crate::geometry::{Vector, add, dot, norm, scale, sub};
use crate::sets::Sets;

/// Combinations of null vectors that stand for all of them: rates that differ in one differ in a random combination.
const COMBINATIONS: usize = 6;
/// Rates differ where their difference moves an end of a segment by more than this share of the size.
const SAME: f64 = 1e-6;
/// Views nearer to one line with their point fix no distance.
pub(super) const PARALLEL: f64 = 1e-8;

/// Rigid components of the observations of a frame, in its order; -1 where an observation stands alone. Tracks in `slides`,
/// ascending, hold nothing.
pub(super) fn components<const D: usize, const W: usize>(
    frame: &Frame<D>,
    null: &[Mode],
    slides: &[usize],
) -> Vec<i32> {
    let part = &frame.part;
    let rates = rates::<D, W>(frame, &combinations(null));
    let mut sets = Sets::new(part.n_observations());
    let mut of_view: Vec<Vec<usize>> = vec![Vec::new(); part.n_views];
    let mut infinite = Vec::new();
    for j in 0..part.n_tracks() {
        if slides.binary_search(&j).is_ok() {
            continue;
        }
        if frame.is_infinite(j) {
            infinite.push(j);
            continue;
        }
        join_equal(&rates, part.observations(j), &mut sets);
        part.observations(j).for_each(|o| of_view[part.view[o] as usize].push(o));
    }
    for observations in &of_view {
        join_equal(&rates, observations.iter().copied(), &mut sets);
    }
    join_bodies(&rates, &mut sets);
    // a point at infinity goes with its views, where these all go together
    for j in infinite {
        let homes = part.observations(j).map(|o| of_view[part.view[o] as usize].first().copied());
        let mut roots: Vec<Option<usize>> = homes.map(|home| home.map(|o| sets.find(o))).collect();
        roots.dedup();
        if let [Some(home)] = roots[..] {
            for o in part.observations(j) {
                sets.join(home, o);
            }
        }
    }
    slides.iter().for_each(|&j| join_at_one_place(frame, &rates, j, &mut sets));
    labels(part.n_observations(), &mut sets)
}

/// A few null vectors that tell apart what all of them do.
fn combinations(null: &[Mode]) -> Vec<Vec<f64>> {
    if null.len() <= COMBINATIONS {
        return null.iter().map(|mode| mode.step.clone()).collect();
    }
    let mixed = |k: usize| {
        let mut sum = vec![0.0; null[0].step.len()];
        for (m, mode) in null.iter().enumerate() {
            let weight = scattered(k * null.len() + m);
            sum.iter_mut().zip(&mode.step).for_each(|(s, x)| *s += weight * x);
        }
        sum
    };
    (0..COMBINATIONS).map(mixed).collect()
}

/// The similarity by which each null vector moves an observation, and how exactly it is known.
struct Rates {
    /// Numbers of an observation: of each null vector the stretch, the turn and the shift.
    each: usize,
    rate: Vec<f64>,
    /// Smallest difference that is one.
    tolerance: Vec<f64>,
}

fn rates<const D: usize, const W: usize>(frame: &Frame<D>, null: &[Vec<f64>]) -> Rates {
    let part = &frame.part;
    let n_turns = W - D;
    let of_one = 1 + n_turns + D;
    let each = null.len() * of_one;
    let mut rate = vec![0.0; part.n_observations() * each];
    let mut tolerance = vec![0.0; part.n_observations()];
    for (k, step) in null.iter().enumerate() {
        let followers = frame.followers::<W>(step);
        for (j, follower) in followers.iter().enumerate() {
            for o in part.observations(j) {
                let u = frame.segment(o, j);
                let squared = u.dot::<D>(&u);
                let moved = follower.minus(&frame.origin_shift::<W>(step, o, j));
                let row = &mut rate[o * each + k * of_one..][..of_one];
                row[0] = u.dot::<D>(&moved) / squared;
                let node = part.node_of(o) as usize;
                let unknowns = &step[node * W..(node + 1) * W];
                row[1..=n_turns].copy_from_slice(&unknowns[..n_turns]);
                let center = frame.estimate.centers[node].vector::<D>();
                // a view turns against its body
                let turn = std::array::from_fn(|c| if c < n_turns { -unknowns[c] } else { 0.0 });
                let turned = across(&turn, &center);
                for c in 0..D {
                    row[1 + n_turns + c] = unknowns[n_turns + c] - row[0] * center[c] - turned[c];
                }
                let reach = 1.0 + follower.dot::<D>(follower).sqrt();
                tolerance[o] = SAME * f64::max(tolerance[o] / SAME, reach / squared.sqrt() + 1.0);
            }
        }
    }
    Rates { each, rate, tolerance }
}

impl Rates {
    fn equal(&self, a: usize, b: usize) -> bool {
        let limit = self.tolerance[a] + self.tolerance[b];
        let (x, y) = (&self.rate[a * self.each..][..self.each], &self.rate[b * self.each..][..self.each]);
        x.iter().zip(y).all(|(x, y)| (x - y).abs() <= limit)
    }
}

/// Joins the observations of one member whose rates are equal.
fn join_equal(rates: &Rates, observations: impl Iterator<Item = usize>, sets: &mut Sets) {
    let mut kinds: Vec<usize> = Vec::new();
    for o in observations {
        match kinds.iter().find(|&&kind| rates.equal(kind, o)) {
            Some(&kind) => {
                sets.join(kind, o);
            }
            None => kinds.push(o),
        }
    }
}

/// Joins the observations of a point that slides which slide alike: those from one place.
fn join_at_one_place<const D: usize>(frame: &Frame<D>, rates: &Rates, j: usize, sets: &mut Sets) {
    let observations: Vec<usize> = frame.part.observations(j).collect();
    for (k, &a) in observations.iter().enumerate() {
        let apart = |b: usize| {
            let u = frame.segment(a, j).minus(&frame.segment(b, j));
            u.dot::<D>(&u).sqrt()
        };
        for &b in observations[k + 1..].iter().filter(|&&b| rates.equal(a, b)) {
            if apart(b) < PARALLEL {
                sets.join(a, b);
            }
        }
    }
}

/// Joins sets that move alike though they share no member.
fn join_bodies(rates: &Rates, sets: &mut Sets) {
    let mut bodies = roots_of_many(rates.tolerance.len(), sets);
    // what moves alike has equal numbers, the first of them too: candidates are neighbours in their order
    let key = |o: usize| rates.rate.get(o * rates.each).copied().unwrap_or(0.0);
    bodies.sort_by(|&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
    for (k, &a) in bodies.iter().enumerate() {
        let within = |b: &&usize| key(**b) - key(a) <= rates.tolerance[a] + rates.tolerance[**b];
        for &b in bodies[k + 1..].iter().take_while(within) {
            if rates.equal(a, b) {
                sets.join(a, b);
            }
        }
    }
}

/// The sets that observations are in: numbers from 0 for sets of two and more, -1 for single ones.
fn labels(n: usize, sets: &mut Sets) -> Vec<i32> {
    let mut number = vec![-1; n];
    for (next, root) in roots_of_many(n, sets).into_iter().enumerate() {
        number[root] = next as i32;
    }
    (0..n).map(|o| number[sets.find(o)]).collect()
}

/// Roots of the sets of two and more.
fn roots_of_many(n: usize, sets: &mut Sets) -> Vec<usize> {
    let mut count = vec![0u32; n];
    (0..n).for_each(|o| count[sets.find(o)] += 1);
    (0..n).filter(|&root| count[root] > 1).collect()
}

/// How a body moves in a mode: `dx = shift + growth (x - centroid) + turn x (x - centroid)`.
pub(super) struct BodyMotion<const D: usize> {
    centroid: Vector<D>,
    shift: Vector<D>,
    growth: f64,
    /// About the axes; in the plane the first counts. Zero where turns are not free.
    turn: [f64; 3],
}

/// What every member of a frame does in a mode.
pub(super) struct Motion<const D: usize> {
    pub views: Vec<Vector<D>>,
    pub turns: Vec<[f64; 3]>,
    pub points: Vec<Vector<D>>,
}

impl<const D: usize> Motion<D> {
    pub fn of<const W: usize>(frame: &Frame<D>, step: &[f64]) -> Self {
        let unknowns = step.as_chunks::<W>().0.iter();
        Self {
            views: unknowns.clone().map(|x| std::array::from_fn(|c| x[W - D + c])).collect(),
            turns: unknowns.map(|x| std::array::from_fn(|c| if c < W - D { x[c] } else { 0.0 })).collect(),
            points: frame.followers::<W>(step).iter().map(Lanes::vector::<D>).collect(),
        }
    }

    /// Rms displacement of all members.
    pub fn rms(&self) -> f64 {
        let squares = self.views.iter().chain(&self.points).map(|dx| dot(dx, dx));
        (squares.sum::<f64>() / (self.views.len() + self.points.len()) as f64).sqrt()
    }

    /// Seen from the members that stand still in it, or nearly: those that move the most are left out of the body that the
    /// motion is taken off of, again and again.
    pub fn settle(&mut self, frame: &Frame<D>) {
        const ROUNDS: usize = 6;
        const BEYOND: f64 = 3.0;
        let mut views: Vec<usize> = (0..self.views.len()).collect();
        for _ in 0..ROUNDS {
            self.relative_to(&BodyMotion::of(frame, self, &views, &[]), frame);
            let speeds: Vec<f64> = self.views.iter().map(norm).collect();
            let limit = BEYOND * median(&mut speeds.clone());
            views = (0..speeds.len()).filter(|&v| speeds[v] <= limit).collect();
        }
    }

    /// Takes the motion of a body off every member, so that the body stands still.
    pub fn relative_to(&mut self, body: &BodyMotion<D>, frame: &Frame<D>) {
        for (dx, x) in self.views.iter_mut().zip(&frame.estimate.centers) {
            *dx = sub(dx, &body.at(&x.vector::<D>()));
        }
        for (dx, x) in self.points.iter_mut().zip(&frame.estimate.points) {
            *dx = sub(dx, &body.at(&x.vector::<D>()));
        }
        for turn in &mut self.turns {
            // a body that turns takes its cameras with it: their own turn is the opposite
            (0..3).for_each(|k| turn[k] += body.turn[k]);
        }
    }
}

impl<const D: usize> BodyMotion<D> {
    /// The motion of some views and points that move as one.
    pub fn of(frame: &Frame<D>, motion: &Motion<D>, views: &[usize], tracks: &[usize]) -> Self {
        let members = || {
            let views = views.iter().map(|&v| (frame.estimate.centers[v].vector::<D>(), motion.views[v]));
            views.chain(tracks.iter().map(|&j| (frame.estimate.points[j].vector::<D>(), motion.points[j])))
        };
        let n = (views.len() + tracks.len()) as f64;
        let mean = |of: &dyn Fn(&(Vector<D>, Vector<D>)) -> Vector<D>| -> Vector<D> {
            members().fold([0.0; D], |sum, m| add(&sum, &scale(1.0 / n, &of(&m))))
        };
        let (centroid, shift) = (mean(&|m| m.0), mean(&|m| m.1));
        let turn = std::array::from_fn(|k| {
            -views.iter().map(|&v| motion.turns[v][k]).sum::<f64>() / views.len().max(1) as f64
        });
        let (mut along, mut squared) = (0.0, 0.0);
        for (x, dx) in members() {
            let arm = sub(&x, &centroid);
            along += dot(&arm, &sub(&dx, &shift));
            squared += dot(&arm, &arm);
        }
        Self { centroid, shift, growth: if squared > 0.0 { along / squared } else { 0.0 }, turn }
    }

    fn at(&self, x: &Vector<D>) -> Vector<D> {
        let arm = sub(x, &self.centroid);
        let turned = across(&self.turn, &arm);
        std::array::from_fn(|c| self.shift[c] + self.growth * arm[c] + turned[c])
    }
}
