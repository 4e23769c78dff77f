//! Gauss-Newton over centres and points: orientations are known.

use super::PositionSystem;
use crate::bundle::estimate::Estimate;
use crate::bundle::levenberg::{Descent, Effort, Problem, minimise};
use crate::bundle::newton::{NewtonWeights, Residuals, Shifts, follow_cameras, sum_in_chunks};
use crate::bundle::part::{Lanes, Part};
use crate::bundle::reduced::{Damping, Translations};
use crate::least_squares::LeastSquaresError;

/// Minimises over the kept observations, from `estimate` as it stands.
pub(super) fn descend<const D: usize>(
    part: &Part<D>,
    system: &mut PositionSystem<D>,
    estimate: &mut Estimate,
    keep: &[bool],
    sigma: f64,
    effort: Effort,
) -> Result<Descent, LeastSquaresError> {
    let residuals = Residuals::new(part, keep, sigma);
    let costs = residuals.costs(estimate);
    let kept = keep.iter().filter(|&&k| k).count();
    let mut problem = Positions { residuals, system, estimate, cost: sum_in_chunks(part, &costs), costs };
    minimise(&mut problem, kept, sigma, effort)
}

struct Positions<'a, const D: usize> {
    residuals: Residuals<'a, D>,
    system: &'a mut PositionSystem<D>,
    estimate: &'a mut Estimate,
    cost: f64,
    /// Of each point.
    costs: Vec<f64>,
}

impl<const D: usize> Problem for Positions<'_, D> {
    type Candidate = (Estimate, Vec<f64>);

    fn cost(&self) -> f64 {
        self.cost
    }

    fn propose(&mut self, damping: f64) -> Result<(Self::Candidate, f64), LeastSquaresError> {
        let part = self.residuals.part;
        let weights = NewtonWeights { residuals: self.residuals, estimate: self.estimate };
        self.system.assemble(part, &weights, &Translations, &[], Damping { point: damping, view: damping });
        let step = Shifts(self.system.solve()?.iter().map(Lanes::from_vector::<D>).collect());
        let centers: Vec<Lanes> = self.estimate.centers.iter().zip(&step.0).map(|(c, d)| c.plus(d)).collect();
        let (points, costs) = follow_cameras(&weights, &self.costs, &step, part, &centers, damping);
        let cost = sum_in_chunks(part, &costs);
        Ok(((Estimate { centers, points }, costs), cost))
    }

    fn accept(&mut self, (estimate, costs): Self::Candidate, cost: f64) {
        *self.estimate = estimate;
        (self.costs, self.cost) = (costs, cost);
    }
}
