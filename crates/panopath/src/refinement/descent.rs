//! Gauss-Newton over orientations, centres and points.

use super::poses::{Poses, Sights};
use super::priors::PartPriors;
use crate::bundle::estimate::Estimate;
use crate::bundle::levenberg::{Descent, Effort, Problem, minimise};
use crate::bundle::newton::{NewtonWeights, Residuals, follow_cameras, sum_in_chunks};
use crate::bundle::part::{Lanes, Part};
use crate::bundle::reduced::Damping;
use crate::bundle::system::CameraSystem;
use crate::bundle::turns::{PoseRow, PoseStep, Turns};
use crate::least_squares::LeastSquaresError;

/// What does not change while a part is refined.
pub(super) struct Given<'a, const D: usize> {
    pub sights: &'a Sights<D>,
    pub priors: &'a PartPriors<D>,
    /// Rows of observations that each node needs, so that its unknowns are determined.
    pub wanted: &'a [usize],
    /// Are observations judged anew between rounds?
    pub judges: bool,
    pub huber_sigmas: f64,
}

/// Where a refinement stands: the rays of `part` and the stations in `estimate.centers` follow from the poses.
#[derive(Clone)]
pub(super) struct State<const D: usize> {
    pub poses: Poses<D>,
    pub part: Part<D>,
    pub estimate: Estimate,
}

impl<const D: usize> State<D> {
    /// Turns rays and places stations as the poses say.
    pub fn new(sights: &Sights<D>, part: &Part<D>, poses: Poses<D>, points: Vec<Lanes>) -> Self {
        let centers = sights.stations(part, &poses);
        let part = part.with_rays(sights.rays(part, &poses));
        Self { poses, part, estimate: Estimate { centers, points } }
    }
}

/// Minimises over the kept observations, from `state` as it stands.
pub(super) fn descend<const D: usize, const V: usize>(
    given: &Given<'_, D>,
    system: &mut CameraSystem<D, V, PoseRow>,
    state: &mut State<D>,
    keep: &[bool],
    sigma: f64,
    effort: Effort,
) -> Result<Descent, LeastSquaresError> {
    let huber = given.huber_sigmas * sigma;
    let residuals = Residuals { part: &state.part, keep, huber };
    let costs = residuals.costs(&state.estimate);
    let cost = sum_in_chunks(&state.part, &costs) + given.priors.cost(&state.poses, sigma);
    let kept = keep.iter().filter(|&&k| k).count();
    let mut problem = Bundle { given, system, state, keep, huber, sigma, cost, costs };
    match minimise(&mut problem, kept, sigma, effort) {
        // no damping makes the system regular: what is free is said by the status
        Err(LeastSquaresError::Singular { .. }) => Ok(Descent { iterations: 0, converged: false }),
        ended => ended,
    }
}

struct Bundle<'a, const D: usize, const V: usize> {
    given: &'a Given<'a, D>,
    system: &'a mut CameraSystem<D, V, PoseRow>,
    state: &'a mut State<D>,
    keep: &'a [bool],
    huber: f64,
    sigma: f64,
    cost: f64,
    /// Of each point.
    costs: Vec<f64>,
}

impl<const D: usize, const V: usize> Problem for Bundle<'_, D, V> {
    type Candidate = (State<D>, Vec<f64>);

    fn cost(&self) -> f64 {
        self.cost
    }

    fn propose(&mut self, damping: f64) -> Result<(Self::Candidate, f64), LeastSquaresError> {
        let State { poses, part, estimate } = &*self.state;
        let Given { sights, priors, .. } = *self.given;
        let residuals = Residuals { part, keep: self.keep, huber: self.huber };
        let weights = NewtonWeights { residuals, estimate };
        let turns = Turns { part, centers: &poses.centers, points: &estimate.points, vectors: &[] };
        let terms = priors.terms(poses, self.sigma);
        self.system.assemble(part, &weights, &turns, &terms, Damping { point: damping, view: damping });
        let step = self.system.solve()?;
        let next = State::new(sights, part, poses.moved(&step), Vec::new());
        let follow = PoseStep::<D, V> { layout: part, centers: &poses.centers, step };
        let stations = &next.estimate.centers;
        let (mut points, mut costs) = follow_cameras(&weights, &self.costs, &follow, &next.part, stations, damping);
        let after = Residuals { part: &next.part, ..residuals };
        for (j, _) in part.held_points.iter().enumerate().filter(|(_, held)| **held) {
            points[j] = estimate.points[j];
            costs[j] = after.cost(j, stations, &points[j]);
        }
        let cost = sum_in_chunks(part, &costs) + priors.cost(&next.poses, self.sigma);
        let State { poses, part, estimate } = next;
        let estimate = Estimate { points, ..estimate };
        Ok(((State { poses, part, estimate }, costs), cost))
    }

    fn accept(&mut self, (state, costs): Self::Candidate, cost: f64) {
        *self.state = state;
        (self.costs, self.cost) = (costs, cost);
    }
}
