//! Names for the null space, and for what noise leaves nearly free.
//!
//! Beyond what views and tracks can do by themselves a null vector `(dc, dx)` is
//! - a *common motion* where `dc` lies in the span of the functions of every track: all move along;
//! - a *scale in time* where all segments of a view stretch alike, `dx - dc = lambda(t_i) u`, with a `lambda` that is a function
//!   of time such as those of the paths (a scale that jumps from one set of views to the next is a set that hangs loose);
//! - else the movement of a set: of all null vectors that differ from it by the others, the one that moves the fewest members.

use rayon::prelude::*;

use super::eliminate::stretch;
use super::families::{self, Family};
use super::reach::{Reach, TrackReach};
use super::system::{Mode, Spectrum, System, mixed, orthonormal};
use super::{Freedom, FreedomKind, FreedomOptions, MovingScene, NullVector, TimeFunction};
use crate::geometry::{Vector, dot, norm, scale};
use crate::least_squares::{LeastSquaresError, inner, symmetric_eigen_of};

/// How far from its form a null vector may be, relative to its size; and a mode that is nearly null.
const EXACTLY: f64 = 1e-5;
const NEARLY: f64 = 0.2;
/// A mode that one standard deviation moves by more than this share of the distance is free as far as noise tells.
const LOOSE_MOVEMENT: f64 = 0.3;
/// An exact freedom seen through noise is this many times stiffer than expected, at most.
const NOISE_MULTIPLE: f64 = 5.0;
/// A mode belongs to tracks that are refused by themselves where more than this share of its movement does.
const OF_REFUSED: f64 = 0.5;
/// Members move where they move by more than this share of what the fastest one does.
const MOVES: f64 = 0.01;
/// Rounds of re-weighting that find the fewest members.
const ROUNDS: usize = 30;
/// Chunks of tracks: a constant, so that sums do not depend on the threads.
const CHUNKS: usize = 32;

pub(super) struct Named<const D: usize> {
    pub freedoms: Vec<Freedom<D>>,
    pub weakest_movement: f64,
}

/// What is free in one part.
pub(super) fn freedoms<const D: usize>(
    system: &System<'_, D>,
    spectrum: &Spectrum,
    scene: &MovingScene<'_, D>,
    starts: &[usize],
    reaches: &[TrackReach<D>],
    number: usize,
    options: &FreedomOptions,
) -> Result<Named<D>, LeastSquaresError> {
    let teller = Teller { system, scene, starts, number, options };
    let families = families::of_part(system.part, scene.forms);
    let mut space = Space::of(system, spectrum.core.clone())?;
    let mut found = Vec::new();
    space.take(&gauge(system)[..D]);
    let motions = space.series(&families, EXACTLY, Space::common)?;
    let scale_counts = space.take(&gauge(system)[D..]) > 0;
    let scales = space.series(&families, EXACTLY, Space::scaled)?;
    teller.tell(&space, FreedomKind::CommonMotion, motions, true, &mut found);
    teller.tell(&space, FreedomKind::ScaleInTime, scales, true, &mut found);
    teller.tell_tracks(reaches, scale_counts, &mut found);
    teller.tell_views(&mut found);
    let rest = space.rest();
    teller.tell_set(&space, rest, true, &mut found)?;

    let weak: Vec<Mode> = spectrum.others.iter().filter(|mode| teller.is_weak(mode, reaches)).cloned().collect();
    let mut weakest_movement = if spectrum.others.is_empty() { 0.0 } else { teller.movement(&spectrum.others[0]) };
    if !weak.is_empty() {
        weakest_movement = weak.iter().fold(weakest_movement, |most, mode| most.max(teller.movement(mode)));
        space.rest().into_iter().for_each(|rest| space.named.push(rest));
        space.extend(weak.into_iter().map(|mode| system.settled(mode.step)).collect())?;
        let motions = space.series(&families, NEARLY, Space::common)?;
        let scales = space.series(&families, NEARLY, Space::scaled)?;
        teller.tell(&space, FreedomKind::CommonMotion, motions, false, &mut found);
        teller.tell(&space, FreedomKind::ScaleInTime, scales, false, &mut found);
        let rest = space.rest();
        teller.tell_set(&space, rest, false, &mut found)?;
    }
    Ok(Named { freedoms: found, weakest_movement })
}

/// Shifts, then scale.
fn gauge<const D: usize>(system: &System<'_, D>) -> Vec<Vec<f64>> {
    let part = system.part;
    let displaced = |view: &dyn Fn(usize) -> Vector<D>, far: &dyn Fn(usize) -> Vector<D>| {
        let mut step: Vec<f64> = (0..part.views.len()).flat_map(view).collect();
        for (j, track) in system.tracks.iter().enumerate() {
            let mut z = vec![0.0; D * track.k];
            for (a, o) in part.observations(j).enumerate() {
                let moved = far(o);
                for f in 0..track.k {
                    (0..D).for_each(|c| z[f * D + c] += track.q[a * track.k + f] * moved[c]);
                }
            }
            step.extend(z);
        }
        system.settled(step)
    };
    let axis = |k: usize| -> Vector<D> { std::array::from_fn(|c| f64::from(u8::from(c == k))) };
    let mut all: Vec<Vec<f64>> = (0..D).map(|k| displaced(&|_| axis(k), &|_| axis(k))).collect();
    let place = |o: usize| {
        let center = &part.center[part.node[o] as usize];
        std::array::from_fn(|c| center[c] + part.length[o] * part.ray[o][c])
    };
    all.push(displaced(&|node| part.center[node], &place));
    all
}

/// Null vectors, with the combinations of them that have a name. The metric is the movement of both ends of all segments.
struct Space<'a, const D: usize> {
    system: &'a System<'a, D>,
    /// Orthonormal.
    basis: Vec<Vec<f64>>,
    /// Orthonormal combinations.
    named: Vec<Vec<f64>>,
}

/// Combinations, and the function of time along which they change.
type Step = (TimeFunction, Vec<Vec<f64>>);

impl<'a, const D: usize> Space<'a, D> {
    fn of(system: &'a System<'a, D>, vectors: Vec<Vec<f64>>) -> Result<Self, LeastSquaresError> {
        let mut space = Self { system, basis: Vec::new(), named: Vec::new() };
        space.extend(vectors)?;
        Ok(space)
    }

    /// Movements of both ends, added up over all observations.
    fn products(&self, steps: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let far = self.system.products(steps, |step, o| self.system.path_shift(step, o));
        let mut both = self.system.products(steps, |step, o| self.system.view_shift(step, o));
        both.iter_mut().zip(&far).for_each(|(x, y)| x.iter_mut().zip(y).for_each(|(x, y)| *x += y));
        both
    }

    /// Takes further vectors in, orthonormal to those that are there.
    fn extend(&mut self, vectors: Vec<Vec<f64>>) -> Result<(), LeastSquaresError> {
        let known = self.basis.len();
        let mut all = self.basis.clone();
        all.extend(vectors);
        let gram = self.products(&all);
        let mut fresh: Vec<Vec<f64>> = all.split_off(known);
        for (k, vector) in fresh.iter_mut().enumerate() {
            for (other, along) in self.basis.iter().zip(&gram[known + k]) {
                vector.iter_mut().zip(other).for_each(|(x, y)| *x -= along * y);
            }
        }
        let (squares, mixes) = symmetric_eigen_of(&self.products(&fresh))?;
        let kept: Vec<usize> =
            (0..squares.len()).filter(|&k| squares[k] > 1e-12 * squares[squares.len() - 1]).collect();
        let weights: Vec<Vec<f64>> =
            kept.iter().map(|&k| mixes[k].iter().map(|w| w / squares[k].sqrt()).collect()).collect();
        self.basis.extend(mixed(&fresh, &weights));
        self.named.iter_mut().for_each(|combination| combination.resize(self.basis.len(), 0.0));
        Ok(())
    }

    /// Names these vectors, and tells how many of them are new.
    fn take(&mut self, vectors: &[Vec<f64>]) -> usize {
        let mut all = self.basis.clone();
        all.extend_from_slice(vectors);
        let gram = self.products(&all);
        let n = self.basis.len();
        let part = self.system.part;
        let whole = (2 * part.n_observations()) as f64;
        let combinations: Vec<Vec<f64>> = (0..vectors.len())
            // what is small against a shift by one is rounding
            .filter(|k| gram[n + k][n + k] > 1e-12 * whole)
            .map(|k| gram[n + k][..n].to_vec())
            .collect();
        let fresh = orthonormal(combinations, &self.named);
        let count = fresh.len();
        self.named.extend(fresh);
        count
    }

    /// For each family, with those before it, what passes a test and is not yet named.
    fn series(
        &mut self,
        families: &[Family],
        limit: f64,
        test: impl Fn(&Self, &[Vec<f64>]) -> Vec<Vec<f64>>,
    ) -> Result<Vec<Step>, LeastSquaresError> {
        let mut functions: Vec<Vec<f64>> = Vec::new();
        let mut steps = Vec::new();
        for family in families {
            functions.extend(family.functions.clone());
            if self.basis.len() == self.named.len() {
                break;
            }
            let (squares, mixes) = symmetric_eigen_of(&test(self, &functions))?;
            let passed = squares.iter().zip(mixes).filter(|(square, _)| **square < limit * limit).map(|(_, mix)| mix);
            let fresh = independent(passed.collect(), &self.named);
            if !fresh.is_empty() {
                self.named.extend(fresh.clone());
                steps.push((family.name, fresh));
            }
        }
        Ok(steps)
    }

    /// How far each combination is from moving everything alike along some functions of time.
    fn common(&self, functions: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let (system, part) = (self.system, self.system.part);
        let within = |j: usize| part.observations(j).all(|o| system.views[part.node[o] as usize].loose == 0);
        let mut gram = by_track(system, &self.basis, |j, step| {
            if !within(j) {
                return Vec::new();
            }
            let moved: Vec<Vector<D>> = part.observations(j).map(|o| system.view_shift(step, o)).collect();
            system.tracks[j].beyond(&moved).into_flattened()
        });
        let nodes: Vec<usize> = (0..part.views.len()).filter(|&node| system.views[node].loose == 0).collect();
        let rows: Vec<Vec<f64>> = self
            .basis
            .iter()
            .map(|step| {
                let columns = (0..D).flat_map(|c| {
                    let column: Vec<f64> = nodes.iter().map(|&node| step[node * D + c]).collect();
                    outside(&column, functions, &nodes)
                });
                columns.collect()
            })
            .collect();
        add_products(&mut gram, &rows, part.n_observations() as f64 / part.views.len() as f64);
        gram
    }

    /// How far each combination is from stretching all segments of a view alike, as some functions of time do.
    fn scaled(&self, functions: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let (system, part) = (self.system, self.system.part);
        let tight = |o: usize| system.tracks[part.owner[o] as usize].loose::<D>() == 0;
        let nodes: Vec<usize> = (0..part.views.len())
            .filter(|&node| system.views[node].loose == 0)
            .filter(|&node| part.of_node.of(node).iter().any(|&o| tight(o as usize)))
            .collect();
        if nodes.is_empty() {
            // nothing tells of a scale
            let n = self.basis.len();
            return (0..n).map(|a| (0..n).map(|b| f64::from(u8::from(a == b))).collect()).collect();
        }
        let rates: Vec<Vec<f64>> = self.basis.iter().map(|step| stretches(system, step)).collect();
        let steps: Vec<Vec<f64>> =
            self.basis.iter().zip(&rates).map(|(step, rates)| [step.as_slice(), rates.as_slice()].concat()).collect();
        let n = self.basis.first().map_or(0, Vec::len);
        let mut gram = by_track(system, &steps, |j, step| {
            if system.tracks[j].loose::<D>() > 0 {
                return Vec::new();
            }
            let apart = |o: usize| {
                let rate = step[n + part.node[o] as usize];
                part.length[o] * (stretch(part, o, &system.across(&step[..n], o)) - rate)
            };
            part.observations(j).map(apart).collect()
        });
        let column = |rates: &Vec<f64>| nodes.iter().map(|&node| rates[node]).collect::<Vec<f64>>();
        let rows: Vec<Vec<f64>> = rates.iter().map(|rates| outside(&column(rates), functions, &nodes)).collect();
        add_products(&mut gram, &rows, part.n_observations() as f64 / part.views.len() as f64);
        gram
    }

    /// Combinations that have no name.
    fn rest(&self) -> Vec<Vec<f64>> {
        let n = self.basis.len();
        let unit = |k: usize| (0..n).map(|a| f64::from(u8::from(a == k))).collect::<Vec<f64>>();
        let mut rest = independent((0..n).map(unit).collect(), &self.named);
        rest.truncate(n - self.named.len().min(n));
        rest
    }

    fn steps(&self, combinations: &[Vec<f64>]) -> Vec<Vec<f64>> {
        mixed(&self.basis, combinations)
    }
}

/// Combinations orthonormal to some and to each other; those that are hardly new are left out.
fn independent(vectors: Vec<Vec<f64>>, known: &[Vec<f64>]) -> Vec<Vec<f64>> {
    const NEW: f64 = 1e-3;
    let mut fresh: Vec<Vec<f64>> = Vec::new();
    let mut left: Vec<Vec<f64>> = vectors;
    // the one that is newest first
    loop {
        for vector in &mut left {
            for other in known.iter().chain(&fresh) {
                let along = inner(vector, other);
                vector.iter_mut().zip(other).for_each(|(x, y)| *x -= along * y);
            }
        }
        let best = (0..left.len()).max_by(|&a, &b| inner(&left[a], &left[a]).total_cmp(&inner(&left[b], &left[b])));
        let Some(best) = best else { return fresh };
        let mut vector = left.swap_remove(best);
        let length = inner(&vector, &vector).sqrt();
        if length < NEW {
            return fresh;
        }
        vector.iter_mut().for_each(|x| *x /= length);
        fresh.push(vector);
    }
}

/// Sums over all tracks of the inner products of what each step makes of a track.
fn by_track<const D: usize>(
    system: &System<'_, D>,
    steps: &[Vec<f64>],
    of: impl Fn(usize, &[f64]) -> Vec<f64> + Sync,
) -> Vec<Vec<f64>> {
    let (n, q) = (system.part.tracks.len(), steps.len());
    let size = n.div_ceil(CHUNKS).max(1);
    let of_chunk = |chunk: usize| {
        let mut sum = vec![vec![0.0; q]; q];
        for j in chunk * size..((chunk + 1) * size).min(n) {
            let rows: Vec<Vec<f64>> = steps.iter().map(|step| of(j, step)).collect();
            add_products(&mut sum, &rows, 1.0);
        }
        sum
    };
    let sums: Vec<Vec<Vec<f64>>> = (0..CHUNKS).into_par_iter().map(of_chunk).collect();
    let mut gram = vec![vec![0.0; q]; q];
    for sum in sums {
        gram.iter_mut().zip(&sum).for_each(|(x, y)| x.iter_mut().zip(y).for_each(|(x, y)| *x += y));
    }
    gram
}

fn add_products(gram: &mut [Vec<f64>], rows: &[Vec<f64>], weight: f64) {
    for a in 0..rows.len() {
        for b in 0..=a {
            let product = weight * inner(&rows[a], &rows[b]);
            gram[a][b] += product;
            if a != b {
                gram[b][a] += product;
            }
        }
    }
}

/// The part of some numbers over the nodes that functions of time cannot express.
fn outside(numbers: &[f64], functions: &[Vec<f64>], nodes: &[usize]) -> Vec<f64> {
    let at_nodes = functions.iter().map(|f| nodes.iter().map(|&node| f[node]).collect()).collect();
    let mut left = numbers.to_vec();
    for function in orthonormal(at_nodes, &[]) {
        let along = inner(&left, &function);
        left.iter_mut().zip(&function).for_each(|(x, f)| *x -= along * f);
    }
    left
}

/// Mean stretch of the segments of each view to tracks that are not loose by themselves; 0 where there are none.
fn stretches<const D: usize>(system: &System<'_, D>, step: &[f64]) -> Vec<f64> {
    let part = system.part;
    let mean = |node: usize| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for &o in part.of_node.of(node) {
            let o = o as usize;
            if system.tracks[part.owner[o] as usize].loose::<D>() == 0 {
                let own = part.length[o] * part.length[o];
                sum += own * stretch(part, o, &system.across(step, o));
                weight += own;
            }
        }
        if weight > 0.0 { sum / weight } else { 0.0 }
    };
    (0..part.views.len()).map(mean).collect()
}

/// Writes freedoms for the caller.
struct Teller<'a, const D: usize> {
    system: &'a System<'a, D>,
    scene: &'a MovingScene<'a, D>,
    starts: &'a [usize],
    number: usize,
    options: &'a FreedomOptions,
}

impl<const D: usize> Teller<'_, D> {
    fn freedom(&self, kind: FreedomKind, dimension: usize, is_exact: bool) -> Freedom<D> {
        Freedom {
            kind,
            function: TimeFunction::Any,
            dimension,
            is_exact,
            part: self.number as i32,
            views: Vec::new(),
            tracks: Vec::new(),
            vectors: Vec::new(),
        }
    }

    /// Common motions and scales in time, a freedom for each function of time.
    fn tell(
        &self,
        space: &Space<'_, D>,
        kind: FreedomKind,
        series: Vec<Step>,
        is_exact: bool,
        to: &mut Vec<Freedom<D>>,
    ) {
        for (function, mut combinations) in series {
            let mut freedom = self.freedom(kind, combinations.len(), is_exact);
            combinations.truncate(self.options.most_vectors);
            freedom.function = function;
            freedom.vectors = space.steps(&combinations).into_iter().map(|step| self.vector(step, is_exact)).collect();
            if kind == FreedomKind::ScaleInTime {
                let part = self.system.part;
                let at_rest = |j: &usize| part.n_functions(*j) == 1 && self.system.tracks[*j].loose::<D>() == 0;
                freedom.tracks = (0..part.tracks.len()).filter(at_rest).map(|j| part.tracks[j]).collect();
            }
            to.push(freedom);
        }
    }

    /// Tracks that are loose by themselves, those of one reason together. Where the scale of everything is made of common
    /// motion and of tracks drawn towards the camera, it is one of their freedoms.
    fn tell_tracks(&self, reaches: &[TrackReach<D>], scale_counts: bool, to: &mut Vec<Freedom<D>>) {
        let first = to.len();
        for (reason, kind) in [
            (Reach::Imitated, FreedomKind::Imitated),
            (Reach::Hidden, FreedomKind::Hidden),
            (Reach::InLine, FreedomKind::InLine),
            (Reach::TooFew, FreedomKind::TooFew),
            (Reach::Loose, FreedomKind::LooseTrack),
        ] {
            for is_exact in [true, false] {
                let of = |id: &u32| {
                    let reach = &reaches[*id as usize];
                    reach.reason == reason && reach.is_exact == is_exact && reach.dimension > 0
                };
                let tracks: Vec<u32> = self.system.part.tracks.iter().copied().filter(of).collect();
                if !tracks.is_empty() {
                    let dimension = tracks.iter().map(|&id| reaches[id as usize].dimension).sum();
                    let mut freedom = self.freedom(kind, dimension, is_exact);
                    freedom.tracks = tracks;
                    to.push(freedom);
                }
            }
        }
        let told = to[first..].iter_mut().filter(|freedom| freedom.is_exact);
        if let (false, Some(largest)) = (scale_counts, told.max_by_key(|freedom| freedom.dimension)) {
            largest.dimension -= 1;
        }
        let mut position = 0;
        to.retain(|freedom| {
            position += 1;
            position <= first || freedom.dimension > 0
        });
    }

    fn tell_views(&self, to: &mut Vec<Freedom<D>>) {
        let part = self.system.part;
        let loose: Vec<usize> = (0..part.views.len()).filter(|&node| self.system.views[node].loose > 0).collect();
        if loose.is_empty() {
            return;
        }
        let dimension = loose.iter().map(|&node| self.system.views[node].loose).sum();
        let mut freedom = self.freedom(FreedomKind::LooseView, dimension, true);
        freedom.views = loose.iter().map(|&node| part.views[node]).collect();
        let directions = loose.iter().flat_map(|&node| self.system.views[node].free().map(move |v| (node, v)));
        for (node, direction) in directions.take(self.options.most_vectors) {
            let mut step = vec![0.0; self.system.offset[part.tracks.len()]];
            step[node * D..node * D + D].copy_from_slice(direction);
            freedom.vectors.push(self.vector(step, true));
        }
        to.push(freedom);
    }

    /// What has no other name: who moves.
    fn tell_set(
        &self,
        space: &Space<'_, D>,
        mut rest: Vec<Vec<f64>>,
        is_exact: bool,
        to: &mut Vec<Freedom<D>>,
    ) -> Result<(), LeastSquaresError> {
        if rest.is_empty() {
            return Ok(());
        }
        let mut freedom = self.freedom(FreedomKind::LooseSet, rest.len(), is_exact);
        rest.truncate(self.options.most_vectors);
        let part = self.system.part;
        let mut moves = vec![false; part.views.len() + part.tracks.len()];
        let named = space.steps(&space.named);
        for step in space.steps(&rest) {
            let (step, moved) = fewest_members(self.system, step, &named)?;
            let most = moved.iter().fold(0.0f64, |most, x| most.max(*x));
            moves.iter_mut().zip(&moved).for_each(|(moves, moved)| *moves |= *moved > MOVES * most);
            freedom.vectors.push(self.vector(step, is_exact));
        }
        let (views, tracks) = moves.split_at(part.views.len());
        freedom.views = (0..views.len()).filter(|&node| views[node]).map(|node| part.views[node]).collect();
        freedom.tracks = (0..tracks.len()).filter(|&j| tracks[j]).map(|j| part.tracks[j]).collect();
        to.push(freedom);
        Ok(())
    }

    /// A displacement as the caller knows views and coefficients.
    fn vector(&self, mut step: Vec<f64>, is_exact: bool) -> NullVector<D> {
        let (system, part) = (self.system, self.system.part);
        let size = system.size(&step).max(f64::MIN_POSITIVE);
        step.iter_mut().for_each(|x| *x /= size);
        let mut vector = NullVector {
            centers: vec![[0.0; D]; self.scene.centers.len()],
            coefficients: vec![[0.0; D]; self.scene.coefficients.len()],
            stretch: vec![f64::NAN; self.scene.centers.len()],
            value: (system.energy(&step) / part.n_observations() as f64).sqrt(),
            movement: f64::INFINITY,
        };
        for ((node, rate), &id) in stretches(system, &step).into_iter().enumerate().zip(&part.views) {
            vector.centers[id as usize] = std::array::from_fn(|c| step[node * D + c]);
            // lengths of the part are in units of its own
            vector.stretch[id as usize] = rate / part.unit;
        }
        for (j, &id) in part.tracks.iter().enumerate() {
            let own = system.tracks[j].coefficients::<D>(&step[system.offset[j]..system.offset[j + 1]]);
            vector.coefficients[self.starts[id as usize]..][..own.len()].copy_from_slice(&own);
        }
        if !is_exact {
            vector.movement = self.movement(&Mode { value: vector.value, step });
        }
        vector
    }

    /// What one standard deviation makes of a mode of size one.
    fn movement(&self, mode: &Mode) -> f64 {
        let n = self.system.part.n_observations() as f64;
        self.system.part.sigma / (mode.value.max(f64::MIN_POSITIVE) * n.sqrt())
    }

    /// Is a mode free as far as noise tells, and not only because of tracks that are refused by themselves?
    fn is_weak(&self, mode: &Mode, reaches: &[TrackReach<D>]) -> bool {
        let (system, part) = (self.system, self.system.part);
        if part.sigma <= 0.0 {
            return false;
        }
        let (mut spread, mut of_refused, mut moved) = (0.0, 0.0, 0.0);
        for (j, &id) in part.tracks.iter().enumerate() {
            let rates: Vec<f64> =
                part.observations(j).map(|o| stretch(part, o, &system.across(&mode.step, o))).collect();
            let mean = rates.iter().sum::<f64>() / rates.len() as f64;
            let weights = part.observations(j).map(|o| part.gain[o] * part.length[o]);
            spread += rates.iter().zip(weights).map(|(rate, w)| (w * (rate - mean)).powi(2)).sum::<f64>();
            let own: f64 = part.observations(j).map(|o| norm(&system.path_shift(&mode.step, o)).powi(2)).sum();
            let views: f64 = part.observations(j).map(|o| norm(&system.view_shift(&mode.step, o)).powi(2)).sum();
            moved += own + views;
            if reaches[id as usize].dimension > 0 {
                of_refused += own;
            }
        }
        if of_refused > OF_REFUSED * moved {
            return false;
        }
        let energy = mode.value * mode.value * part.n_observations() as f64;
        let noise = NOISE_MULTIPLE * (D - 1) as f64 * part.sigma * part.sigma * spread;
        self.movement(mode) > LOOSE_MOVEMENT || energy < noise
    }
}

/// Of all vectors that differ from one by others, the one that moves the fewest views and tracks, and how far it moves each;
/// by re-weighted least squares.
fn fewest_members<const D: usize>(
    system: &System<'_, D>,
    step: Vec<f64>,
    others: &[Vec<f64>],
) -> Result<(Vec<f64>, Vec<f64>), LeastSquaresError> {
    let part = system.part;
    let n_views = part.views.len();
    let all: Vec<&Vec<f64>> = others.iter().chain([&step]).collect();
    let q = others.len();
    let products = |member: usize| -> Vec<f64> {
        let mut sum = vec![0.0; (q + 1) * (q + 1)];
        let mut add = |vectors: &[Vector<D>], weight: f64| {
            for a in 0..=q {
                (0..=q).for_each(|b| sum[a * (q + 1) + b] += weight * dot(&vectors[a], &vectors[b]));
            }
        };
        if member < n_views {
            let at = |step: &&Vec<f64>| std::array::from_fn(|c| step[member * D + c]);
            add(&all.iter().map(at).collect::<Vec<Vector<D>>>(), 1.0);
        } else {
            let j = member - n_views;
            let share = 1.0 / part.observations(j).len() as f64;
            for o in part.observations(j) {
                add(&all.iter().map(|step| scale(1.0, &system.path_shift(step, o))).collect::<Vec<Vector<D>>>(), share);
            }
        }
        sum
    };
    let members: Vec<Vec<f64>> = (0..n_views + part.tracks.len()).into_par_iter().map(products).collect();
    let moved = |mix: &[f64], gram: &[f64]| {
        let squared: f64 = (0..=q).map(|a| mix[a] * (0..=q).map(|b| mix[b] * gram[a * (q + 1) + b]).sum::<f64>()).sum();
        squared.max(0.0).sqrt()
    };
    let mut mix = vec![0.0; q + 1];
    mix[q] = 1.0;
    for round in 0..ROUNDS {
        let distances: Vec<f64> = members.iter().map(|gram| moved(&mix, gram)).collect();
        let most = distances.iter().fold(0.0f64, |most, x| most.max(*x));
        let least = most * f64::max(0.5f64.powi(round as i32), 1e-6);
        let mut sum = vec![0.0; (q + 1) * (q + 1)];
        for (gram, distance) in members.iter().zip(&distances) {
            let weight = 1.0 / distance.max(least).max(f64::MIN_POSITIVE);
            sum.iter_mut().zip(gram).for_each(|(s, g)| *s += weight * g);
        }
        let rows: Vec<Vec<f64>> = (0..q).map(|a| sum[a * (q + 1)..a * (q + 1) + q].to_vec()).collect();
        let (values, vectors) = symmetric_eigen_of(&rows)?;
        let right: Vec<f64> = (0..q).map(|a| -sum[a * (q + 1) + q]).collect();
        mix[..q].fill(0.0);
        for (value, vector) in values.iter().zip(&vectors) {
            if *value > 1e-13 * values[q - 1] {
                let along = inner(vector, &right) / value;
                (0..q).for_each(|a| mix[a] += along * vector[a]);
            }
        }
    }
    let distances = members.iter().map(|gram| moved(&mix, gram)).collect();
    let mut sum = step;
    for (weight, other) in mix.iter().zip(others) {
        sum.iter_mut().zip(other).for_each(|(s, x)| *s += weight * x);
    }
    Ok((sum, distances))
}
