//! From the solver's frame to the frame the caller asked for.

use super::options::{Control, Gauge, PositionError};
use crate::geometry::{Rotation, Similarity, Vector, add, norm, scale, sub};

/// Known positions and where the solution has them: `(solution, known)`.
type Pairs<const D: usize> = Vec<(Vector<D>, Vector<D>)>;

/// The similarity that takes one solved part to the gauge. `centers` and `points` are those of the part, with their views
/// and tracks; `None` where control holds too little of the part to place it.
pub(super) fn gauge_from_solution<const D: usize>(
    gauge: &Gauge<D>,
    centers: &[(u32, Vector<D>)],
    points: &[(u32, Vector<D>)],
) -> Result<Option<Similarity<D>>, PositionError> {
    match gauge {
        Gauge::Normalized => Ok(Some(normalized(centers))),
        Gauge::Paper | Gauge::PaperDistance => Ok(first_two_points(gauge, points)),
        Gauge::Control(control) => fit_control(control, centers, points),
    }
}

fn normalized<const D: usize>(centers: &[(u32, Vector<D>)]) -> Similarity<D> {
    let n = centers.len() as f64;
    let centroid = centers.iter().fold([0.0; D], |sum, (_, c)| add(&sum, &scale(1.0 / n, c)));
    let squared: f64 = centers.iter().map(|(_, c)| norm(&sub(c, &centroid)).powi(2)).sum();
    let factor = if squared > 0.0 { (n / squared).sqrt() } else { 1.0 };
    Similarity { scale: factor, rotation: Rotation::identity(), translation: scale(-factor, &centroid) }
}

fn first_two_points<const D: usize>(gauge: &Gauge<D>, points: &[(u32, Vector<D>)]) -> Option<Similarity<D>> {
    let [(_, first), (_, second), ..] = points else { return None };
    let between = sub(second, first);
    // a negative scale would put every point behind its cameras: the sign stays, and x2 = -1 is possible
    let length = if *gauge == Gauge::Paper { between[0].abs() } else { norm(&between) };
    (length > 0.0).then(|| Similarity {
        scale: 1.0 / length,
        rotation: Rotation::identity(),
        translation: scale(-1.0 / length, first),
    })
}

fn fit_control<const D: usize>(
    control: &Control<D>,
    centers: &[(u32, Vector<D>)],
    points: &[(u32, Vector<D>)],
) -> Result<Option<Similarity<D>>, PositionError> {
    let mut pairs: Pairs<D> = Vec::new();
    for (solved, known) in [(centers, &control.views), (points, &control.tracks)] {
        for (id, position) in known {
            if let Ok(place) = solved.binary_search_by_key(id, |(solved_id, _)| *solved_id) {
                pairs.push((solved[place].1, *position));
            }
        }
    }
    if pairs.len() < 2 {
        return Ok(None);
    }
    let fit =
        if control.rotation && pairs.len() >= D { Similarity::fit(&pairs) } else { Similarity::fit_unrotated(&pairs) };
    fit.map(Some).ok_or_else(|| {
        PositionError::Control(format!("the {} known positions lie at one place or mirror the solution", pairs.len()))
    })
}
