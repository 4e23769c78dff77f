//! The weakest modes of a frame: what moves while the segments keep their directions, or nearly.
//!
//! A mode displaces views by `x` (and turns them, where they may turn), points following. Its energy is
//! `E = sum p |P_u (dX - q)|^2 / r^2`, `q` the displacement of the view as seen from the point; zero for a null vector of the
//! bearing-rigidity matrix. It is summed from the displacements themselves: as a difference of large numbers, `x^T S x`
//! could not tell a weak mode of a long path from none.
//!
//! The modes come from inverse iteration on the factor of the reduced system, followed by Rayleigh-Ritz with these
//! energies; where there are few unknowns, from all displacements there are.

use rayon::prelude::*;

use super::frame::Frame;
use crate::bundle::determinacy::{GUARD, GaugeBasis, clear_held};
use crate::bundle::newton::NewtonWeights;
use crate::bundle::part::Lanes;
use crate::bundle::reduced::{
    Damping, Factorised, Freedoms, PointSum, Quadratic, Row, Translations, Weighing, most_observed_node,
};
use crate::bundle::system::CameraSystem;
use crate::bundle::turns::{PoseRow, Turns, origin_shift};
use crate::least_squares::{LeastSquaresError, LinearSolver, inner, symmetric_eigen_of};

/// Unknowns up to which all displacements are looked at.
const COMPLETE_UNKNOWNS: usize = 160;
/// Products of unknowns squared and observations up to which they are.
const COMPLETE_WORK: usize = 100_000_000;
/// Modes sought at first beyond the gauge.
const FIRST_MODES: usize = 10;
/// Most modes sought in one go, and in all.
const MOST_AT_ONCE: usize = 40;
const MOST_MODES: usize = 2560;
/// Inverse iterations.
const ITERATIONS: usize = 4;
/// Modes below this value may owe it to rounding alone.
const UNSETTLED: f64 = 1e-6;
/// Modes below this value are put in order once more among themselves.
const LOW: f64 = 1e-3;
/// How a mode's cheapest displacement of a frame may be damped so that it can be factorised: the guard, times these.
const GUARDS: [f64; 3] = [1.0, 1e2, 1e4];

/// A displacement of all views.
#[derive(Clone)]
pub(super) struct Mode {
    /// `W` unknowns a view, of rms length one over the views.
    pub step: Vec<f64>,
    /// Rms angle by which rays turn.
    pub value: f64,
}

/// What the views of a frame may do: shift, or turn and shift.
pub(super) trait Mobility<const D: usize, const W: usize>: Sized + Sync {
    type Row: Row;
    type Freedoms<'a>: Freedoms<D, W, Row = Self::Row>;
    fn freedoms(frame: &Frame<D>) -> Self::Freedoms<'_>;
}

/// Orientations are known.
pub(super) struct Shifting;

impl<const D: usize> Mobility<D, D> for Shifting {
    type Row = Lanes;
    type Freedoms<'a> = Translations;

    fn freedoms(_: &Frame<D>) -> Translations {
        Translations
    }
}

/// Views turn.
pub(super) struct Turning;

impl<const D: usize, const W: usize> Mobility<D, W> for Turning {
    type Row = PoseRow;
    type Freedoms<'a> = Turns<'a, D>;

    fn freedoms(frame: &Frame<D>) -> Turns<'_, D> {
        Turns { part: &frame.part, centers: &frame.estimate.centers, points: &frame.estimate.points, vectors: &[] }
    }
}

/// The system of a frame, and which unknowns of a view exist.
pub(super) struct Analysis<'a, const D: usize, const W: usize, M: Mobility<D, W>> {
    pub frame: &'a Frame<D>,
    /// Unknowns that a view does not have: turns about other axes than the vertical.
    pub absent: [bool; W],
    pub gauge: &'a GaugeBasis,
    mobility: std::marker::PhantomData<M>,
}

impl<'a, const D: usize, const W: usize, M: Mobility<D, W>> Analysis<'a, D, W, M> {
    pub fn new(frame: &'a Frame<D>, absent: [bool; W], gauge: &'a GaugeBasis) -> Self {
        Self { frame, absent, gauge, mobility: std::marker::PhantomData }
    }

    /// Modes beyond the gauge in ascending order of their values: all of them, or enough for some of them not to be null.
    pub fn modes(&self, null_below: f64) -> Result<Vec<Mode>, LeastSquaresError> {
        let present = (0..W).filter(|&k| !self.absent[k]).count() * self.frame.views.len();
        let beyond = present.saturating_sub(self.gauge.len());
        let work = present * present * self.frame.part.n_observations();
        if beyond <= FIRST_MODES || (present <= COMPLETE_UNKNOWNS && work <= COMPLETE_WORK) {
            return self.ritz(self.all_displacements(), &[]);
        }
        let system = self.factorised()?;
        let (mut modes, mut count) = (Vec::new(), FIRST_MODES);
        loop {
            let found = self.weakest(&system, &modes, count.min(beyond - modes.len()))?;
            let all_null = found.last().is_none_or(|mode| mode.value < null_below);
            modes.extend(found);
            if !all_null || modes.len() >= beyond.min(MOST_MODES) {
                return Ok(modes);
            }
            count = (4 * count).min(MOST_AT_ONCE);
        }
    }

    /// The system of the frame with the lightest guard that makes it regular.
    fn factorised(&self) -> Result<CameraSystem<D, W, M::Row>, LeastSquaresError> {
        let mut ended = LeastSquaresError::Singular { pivot: 0 };
        for guard in GUARDS {
            let mut system = self.assemble(GUARD * guard, &self.pinned())?;
            match system.factorise() {
                Ok(()) => return Ok(system),
                Err(singular @ LeastSquaresError::Singular { .. }) => ended = singular,
                Err(other) => return Err(other),
            }
        }
        Err(ended)
    }

    /// The weakest modes beyond the gauge and beyond those that are known to be null.
    fn weakest(
        &self,
        system: &CameraSystem<D, W, M::Row>,
        null: &[Mode],
        count: usize,
    ) -> Result<Vec<Mode>, LeastSquaresError> {
        let modes = self.ritz(self.inverse_iteration(system, null, count)?, null)?;
        let low = modes.iter().take_while(|mode| mode.value < UNSETTLED).count();
        if low == 0 {
            return Ok(modes);
        }
        // The guard resists displacements of all that lies far from the pinned view, and bends what moves there a little. What
        // the observations themselves resist is taken off: `x - (S + g D)^-1 S x`.
        let mut steps: Vec<Vec<f64>> = modes.into_iter().map(|mode| mode.step).collect();
        let settle = |step: &mut Vec<f64>| {
            let mut bent = self.resistance(step);
            clear_held(system.held(), &mut bent);
            system.solve_for(&mut bent)?;
            step.iter_mut().zip(&bent).for_each(|(x, b)| *x -= b);
            Ok(())
        };
        steps[..low].par_iter_mut().map(settle).collect::<Result<(), LeastSquaresError>>()?;
        self.ritz(orthonormal(steps, self.gauge, null), null)
    }

    /// The least value among combinations of the displacements of some modes, found at another scene.
    pub fn least_among(&self, modes: &[Mode]) -> Result<f64, LeastSquaresError> {
        let basis = orthonormal(modes.iter().map(|mode| mode.step.clone()).collect(), self.gauge, &[]);
        let n = self.frame.part.n_observations() as f64 / self.frame.views.len() as f64;
        Ok(self.combined(&basis)?.0.first().map_or(f64::INFINITY, |least| least / n.sqrt()))
    }

    /// The unknowns to hold so that translation and turns are fixed: those of one view, and all that views do not have.
    pub fn pinned(&self) -> Vec<bool> {
        let pinned = most_observed_node(&self.frame.part);
        let held = |k: usize| k / W == pinned || self.absent[k % W];
        (0..self.frame.views.len() * W).map(held).collect()
    }

    /// The information of all cameras in units of `1/sigma^2`, with some unknowns held.
    pub fn assemble(&self, guard: f64, held: &[bool]) -> Result<CameraSystem<D, W, M::Row>, LeastSquaresError> {
        let Frame { part, estimate, keep, .. } = self.frame;
        let mut system = CameraSystem::analyse(part, LinearSolver::Direct, held.to_vec())?;
        let weights = NewtonWeights::new(part, estimate, keep, f64::INFINITY);
        let damping = Damping { point: guard, view: guard };
        system.assemble(part, &weights, &M::freedoms(self.frame), &[], damping);
        Ok(system)
    }

    /// Every displacement of one unknown, the gauge taken off, orthonormal.
    fn all_displacements(&self) -> Vec<Vec<f64>> {
        let n = self.frame.views.len() * W;
        let unit = |k: usize| (0..n).map(|i| f64::from(u8::from(i == k))).collect::<Vec<f64>>();
        let present = (0..n).filter(|k| !self.absent[k % W]);
        orthonormal(present.map(unit).collect(), self.gauge, &[])
    }

    /// An orthonormal basis of the weakest modes, beyond the gauge and some that are known.
    fn inverse_iteration(
        &self,
        system: &CameraSystem<D, W, M::Row>,
        known: &[Mode],
        count: usize,
    ) -> Result<Vec<Vec<f64>>, LeastSquaresError> {
        let n = self.frame.views.len() * W;
        let start = |a: usize| {
            let first = (known.len() + a) * n;
            let x = (0..n).map(|k| if self.absent[k % W] { 0.0 } else { scattered(first + k) });
            x.collect::<Vec<f64>>()
        };
        let mut basis = orthonormal((0..count).map(start).collect(), self.gauge, known);
        for _ in 0..ITERATIONS {
            let solved: Result<Vec<Vec<f64>>, LeastSquaresError> = basis
                .into_iter()
                .map(|mut x| {
                    clear_held(system.held(), &mut x);
                    system.solve_for(&mut x)?;
                    Ok(x)
                })
                .collect();
            basis = orthonormal(solved?, self.gauge, known);
        }
        Ok(basis)
    }

    /// Combinations of some displacements that are modes, in ascending order of their values.
    fn ritz(&self, basis: Vec<Vec<f64>>, known: &[Mode]) -> Result<Vec<Mode>, LeastSquaresError> {
        let n = self.frame.views.len() as f64;
        let scale = (self.frame.part.n_observations() as f64 / n).sqrt();
        let (mut values, mut vectors) = self.combined(&basis)?;
        // what is low among what is high is known to rounding errors of the high
        let low = values.iter().take_while(|&&v| v < LOW * scale).count();
        if low > 0 && low < values.len() {
            let rest = vectors.split_off(low);
            let (low_values, low_vectors) = self.combined(&orthonormal(vectors, self.gauge, known))?;
            debug_assert_eq!(low_vectors.len(), low);
            vectors = low_vectors;
            vectors.extend(rest);
            values.splice(..low, low_values);
        }
        let mode = |(value, vector): (f64, Vec<f64>)| Mode {
            step: vector.into_iter().map(|x| x * n.sqrt()).collect(),
            value: value / scale,
        };
        Ok(values.into_iter().zip(vectors).map(mode).collect())
    }

    /// Square roots of the energies of the combinations that diagonalise them, with these.
    fn combined(&self, basis: &[Vec<f64>]) -> Result<(Vec<f64>, Vec<Vec<f64>>), LeastSquaresError> {
        let (energies, mixes) = symmetric_eigen_of(&self.energies(basis))?;
        let mix = |weights: &Vec<f64>| {
            let mut sum = vec![0.0; basis.first().map_or(0, Vec::len)];
            for (weight, vector) in weights.iter().zip(basis) {
                sum.iter_mut().zip(vector).for_each(|(s, x)| *s += weight * x);
            }
            sum
        };
        let vectors: Vec<Vec<f64>> = mixes.par_iter().map(mix).collect();
        Ok((energies.into_iter().map(|e| e.max(0.0).sqrt()).collect(), vectors))
    }

    /// Half the gradient of the energy of a displacement, `S x`, from the displacements themselves.
    fn resistance(&self, step: &[f64]) -> Vec<f64> {
        let part = &self.frame.part;
        let freedoms = M::freedoms(self.frame);
        let mut pull = vec![0.0; step.len()];
        for j in 0..part.n_tracks() {
            let follow = Follow::<D>::of(self.frame, j);
            let moved = follow.displacement::<W>(self.frame, j, step);
            for (model, o) in follow.models.iter().zip(part.observations(j)) {
                let across = self.frame.origin_shift::<W>(step, o, j).minus(&moved);
                let own = freedoms.lift(o, j, &model.apply::<D>(&across));
                let node = part.node_of(o) as usize;
                pull[node * W..(node + 1) * W].iter_mut().enumerate().for_each(|(k, sum)| *sum += own.at(k));
            }
        }
        pull
    }

    /// Inner products of displacements in the energy.
    fn energies(&self, basis: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let q = basis.len();
        let part = &self.frame.part;
        let of_chunk = |tracks: &std::ops::Range<usize>| {
            let mut sum = vec![0.0; q * q];
            let mut across = vec![Lanes::ZERO; q];
            for j in tracks.clone() {
                let follow = Follow::<D>::of(self.frame, j);
                let moved: Vec<Lanes> = basis.iter().map(|x| follow.displacement::<W>(self.frame, j, x)).collect();
                for (model, o) in follow.models.iter().zip(part.observations(j)) {
                    for (a, x) in basis.iter().enumerate() {
                        let shift = self.frame.origin_shift::<W>(x, o, j);
                        // a unit vector's projection is its own square root
                        across[a] = moved[a].minus(&shift);
                        let along = across[a].dot::<D>(&model.direction);
                        across[a] = across[a].plus_scaled(-along, &model.direction).times(model.direction.0[3].sqrt());
                    }
                    for a in 0..q {
                        for b in 0..=a {
                            sum[a * q + b] += across[a].dot::<D>(&across[b]);
                        }
                    }
                }
            }
            sum
        };
        let sums: Vec<Vec<f64>> = part.chunks.par_iter().map(of_chunk).collect();
        let mut gram = vec![vec![0.0; q]; q];
        for sum in sums {
            for a in 0..q {
                for b in 0..=a {
                    gram[a][b] += sum[a * q + b];
                    if a != b {
                        gram[b][a] += sum[a * q + b];
                    }
                }
            }
        }
        gram
    }
}

impl<const D: usize> Frame<D> {
    /// How the origin of a ray moves, as seen from its point.
    #[inline(always)]
    pub fn origin_shift<const W: usize>(&self, step: &[f64], o: usize, j: usize) -> Lanes {
        let node = self.part.node_of(o) as usize;
        let mut own = [0.0; W];
        own.copy_from_slice(&step[node * W..node * W + W]);
        origin_shift::<D, W>(&own, &self.segment(o, j))
    }

    /// How each point follows a displacement of the views.
    pub fn followers<const W: usize>(&self, step: &[f64]) -> Vec<Lanes> {
        let tracks: Vec<usize> = (0..self.part.n_tracks()).collect();
        tracks.par_iter().map(|&j| Follow::<D>::of(self, j).displacement::<W>(self, j, step)).collect()
    }
}

/// What a point does when its views move.
struct Follow<const D: usize> {
    models: Vec<Quadratic>,
    factor: crate::bundle::reduced::PointFactor<D>,
}

impl<const D: usize> Follow<D> {
    fn of(frame: &Frame<D>, j: usize) -> Self {
        let Frame { part, estimate, keep, .. } = frame;
        let weights = NewtonWeights::new(part, estimate, keep, f64::INFINITY);
        let models: Vec<Quadratic> = part.observations(j).map(|o| weights.observe(o, j)).collect();
        let mut sum = PointSum::<D>::new();
        models.iter().for_each(|model| sum.add(model));
        Self { factor: sum.factor(0.0, &Lanes::ZERO), models }
    }

    /// The displacement of the point that costs least. It is improved once by what it leaves: the factor has a floor under
    /// its pivots, and where rays are nearly parallel that floor holds the point back by more than rounding would.
    fn displacement<const W: usize>(&self, frame: &Frame<D>, j: usize, step: &[f64]) -> Lanes {
        let shifts = frame.part.observations(j).map(|o| frame.origin_shift::<W>(step, o, j));
        let first = self.solve(shifts.clone());
        first.plus(&self.solve(shifts.map(|shift| shift.minus(&first))))
    }

    /// What the observations ask of the point whose rays start at these places.
    fn solve(&self, shifts: impl Iterator<Item = Lanes>) -> Lanes {
        let pull = self.models.iter().zip(shifts).fold(Lanes::ZERO, |sum, (model, s)| sum.plus(&model.apply::<D>(&s)));
        self.factor.solve(&pull)
    }
}

/// Makes vectors orthonormal and free of the gauge and of known modes, those that depend on others left out. What is taken
/// off is taken off twice: once loses digits.
fn orthonormal(mut vectors: Vec<Vec<f64>>, gauge: &GaugeBasis, known: &[Mode]) -> Vec<Vec<f64>> {
    const DEPENDENT: f64 = 1e-9;
    for least in [DEPENDENT, 0.0] {
        let before: Vec<f64> = vectors.iter().map(|vector| inner(vector, vector).sqrt()).collect();
        vectors.par_iter_mut().for_each(|vector| remove(vector, gauge, known));
        let mut basis: Vec<Vec<f64>> = Vec::with_capacity(vectors.len());
        for (mut vector, before) in vectors.into_iter().zip(before) {
            basis.iter().for_each(|other| take_off(&mut vector, other, 1.0));
            let length = inner(&vector, &vector).sqrt();
            if length > least * before && length > f64::MIN_POSITIVE {
                vector.iter_mut().for_each(|x| *x /= length);
                basis.push(vector);
            }
        }
        vectors = basis;
    }
    vectors
}

/// Makes a vector free of the gauge and of known modes, which are orthogonal to each other.
fn remove(vector: &mut [f64], gauge: &GaugeBasis, known: &[Mode]) {
    gauge.remove(vector);
    let squared = known.first().map_or(1.0, |mode| inner(&mode.step, &mode.step));
    known.iter().for_each(|mode| take_off(vector, &mode.step, squared));
}

/// Makes a vector orthogonal to another of this squared length.
fn take_off(vector: &mut [f64], other: &[f64], squared: f64) {
    // several sums at once are several times as fast
    let mut sums = [0.0; 8];
    let ((x, x_rest), (y, y_rest)) = (vector.as_chunks::<8>(), other.as_chunks::<8>());
    for (x, y) in x.iter().zip(y) {
        (0..8).for_each(|k| sums[k] += x[k] * y[k]);
    }
    let along = (sums.iter().sum::<f64>() + inner(x_rest, y_rest)) / squared;
    vector.iter_mut().zip(other).for_each(|(x, y)| *x -= along * y);
}

/// A number between -1 and 1 without pattern, the same on every run.
pub(super) fn scattered(k: usize) -> f64 {
    let mut z = (k as u64).wrapping_add(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}
