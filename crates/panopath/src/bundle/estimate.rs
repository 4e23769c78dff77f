//! Where the cameras and points of a part stand, and how far each ray passes by its point.

use super::part::{Lanes, Part};
use super::reduced::{PointSum, Quadratic};

/// Where the solver stands: camera centres and points of one part.
#[derive(Clone)]
pub(crate) struct Estimate {
    pub centers: Vec<Lanes>,
    pub points: Vec<Lanes>,
}

impl Estimate {
    /// Nothing known.
    pub fn nowhere<const D: usize>(part: &Part<D>) -> Self {
        let nan = Lanes([f64::NAN; 4]);
        Self { centers: vec![nan; part.n_views], points: vec![nan; part.n_tracks()] }
    }
}

impl Estimate {
    /// The same with every position that is not finite found from the others: a camera from the points it sees, then a
    /// point from the cameras that see it. `None` where a camera sees too few known points.
    pub fn completed<const D: usize>(mut self, part: &Part<D>) -> Option<Self> {
        let known = |x: &Lanes| x.vector::<D>().iter().all(|v| v.is_finite());
        let missing: Vec<bool> = self.centers.iter().map(|c| !known(c)).collect();
        if missing.iter().any(|&m| m) {
            let mut seen: Vec<(PointSum<D>, Lanes)> =
                (0..part.n_views).map(|_| (PointSum::new(), Lanes::ZERO)).collect();
            for j in (0..part.n_tracks()).filter(|&j| known(&self.points[j])) {
                for o in part.observations(j).filter(|&o| missing[part.view[o] as usize]) {
                    let (sum, right) = &mut seen[part.view[o] as usize];
                    let model = weighted_ray(&part.ray[o], 1.0, 0.0);
                    sum.add(&model);
                    *right = right.plus(&model.apply::<D>(&self.points[j]));
                }
            }
            for (view, (sum, right)) in seen.iter().enumerate().filter(|(view, _)| missing[*view]) {
                self.centers[view] = sum.factor(0.0, &Lanes::ZERO).solve(right);
                if sum.weight_sum <= 0.0 || !known(&self.centers[view]) {
                    return None;
                }
            }
        }
        for j in (0..part.n_tracks()).filter(|&j| !known(&self.points[j])).collect::<Vec<_>>() {
            let mut sum = PointSum::<D>::new();
            let mut right = Lanes::ZERO;
            for o in part.observations(j) {
                let model = weighted_ray(&part.ray[o], 1.0, 0.0);
                sum.add(&model);
                right = right.plus(&model.apply::<D>(&self.centers[part.view[o] as usize]));
            }
            self.points[j] = sum.factor(0.0, &Lanes::ZERO).solve(&right);
        }
        Some(self)
    }
}

/// Squared chord between the ray and the predicted direction, and the reciprocal distance.
#[inline(always)]
pub(crate) fn squared_chord<const D: usize>(ray: &Lanes, point: &Lanes, center: &Lanes) -> (f64, f64) {
    let u = point.minus(center);
    let reciprocal = 1.0 / u.dot::<D>(&u).sqrt().max(f64::MIN_POSITIVE);
    let error = ray.plus_scaled(-reciprocal, &u);
    (error.dot::<D>(&error), reciprocal)
}

/// Squared chord of an observation of a point, times its precision.
#[inline(always)]
pub(crate) fn squared_error<const D: usize>(part: &Part<D>, o: usize, centers: &[Lanes], point: &Lanes) -> f64 {
    let ray = &part.ray[o];
    squared_chord::<D>(ray, point, &centers[part.view[o] as usize]).0 * ray.0[3]
}

/// Model of an observation in the linear step; both weights are multiplied by the ray's precision.
#[inline(always)]
pub(crate) fn weighted_ray(ray: &Lanes, weight: f64, omega: f64) -> Quadratic {
    let precision = ray.0[3];
    let mut direction = *ray;
    direction.0[3] = weight * precision;
    let mut gradient = ray.times(omega * precision);
    gradient.0[3] = 0.0;
    Quadratic { direction, gradient }
}

/// Moves the centroid to zero and scales to rms distance one; returns the factor applied.
pub(crate) fn normalise(centers: &mut [Lanes]) -> f64 {
    let n = centers.len() as f64;
    let centroid = centers.iter().fold(Lanes::ZERO, |sum, c| sum.plus(c)).times(1.0 / n);
    let squared: f64 = centers.iter().map(|c| c.minus(&centroid)).map(|c| c.dot::<3>(&c)).sum();
    let scale = if squared > 0.0 { (n / squared).sqrt() } else { 1.0 };
    for center in centers {
        *center = center.minus(&centroid).times(scale);
    }
    scale
}

/// Brings a given start to the scale at which the solver works.
pub(crate) fn scale_to_unit(estimate: &mut Estimate) {
    let n = estimate.centers.len() as f64;
    let centroid = estimate.centers.iter().fold(Lanes::ZERO, |sum, c| sum.plus(c)).times(1.0 / n);
    let scale = normalise(&mut estimate.centers);
    for point in &mut estimate.points {
        *point = point.minus(&centroid).times(scale);
    }
}
