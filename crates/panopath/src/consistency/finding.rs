//! What can be wrong with a scene, each as one sentence that names its members.

use std::fmt;

/// Something that a right scene does not show.
#[derive(Debug, Clone, PartialEq)]
pub enum Finding {
    /// No camera is that bad.
    Noise {
        /// "the scene", or which part.
        part: String,
        /// Noise of the accepted observations.
        sigma_rad: f64,
        /// The most that is believed.
        limit: f64,
    },
    /// More noise than the tracks say they have.
    NoiseOverGiven {
        /// "the scene", or which part.
        part: String,
        /// Noise over what the tracks give.
        ratio: f64,
    },
    /// Accepted observations that do not fit.
    Misfits {
        /// "the scene", or which part.
        part: String,
        /// Share of the accepted observations.
        share: f64,
    },
    /// Tracks that were seen well and hardly used.
    Lost {
        /// How many.
        lost: usize,
        /// Of how many.
        judged: usize,
    },
    /// Points behind the views that accepted them.
    Behind {
        /// "the scene", or which part.
        part: String,
        /// Share of the accepted observations.
        share: f64,
        /// Views with any.
        views: Vec<u32>,
    },
    /// Views that nothing accepted ties to the rest of their part.
    Untied {
        /// "the scene", or which part.
        part: String,
        /// The views.
        views: Vec<u32>,
    },
    /// Views that see much of the scene and have no place in it.
    Unplaced {
        /// The views.
        views: Vec<u32>,
    },
    /// Views that share tracks which do not fit both.
    Torn {
        /// The views on one side.
        first: Vec<u32>,
        /// Those on the other; empty where there are no two sides.
        second: Vec<u32>,
        /// Tracks shared, summed over pairs of views.
        shared: u64,
        /// Share of them that fit both views.
        share: f64,
        /// The same in the whole scene.
        elsewhere: f64,
    },
    /// Neighbouring views fit better among themselves than in the scene, everywhere.
    Tension {
        /// "the scene", or which part.
        part: String,
        /// Noise of a few views by themselves.
        alone_rad: f64,
        /// Noise in the scene.
        scene_rad: f64,
    },
    /// Some views would fit better in another shape.
    Strained {
        /// Views of all windows that are strained and overlap.
        views: Vec<u32>,
        /// Gain a freedom, in units of noise, of the worst window.
        strain: f64,
        /// Noise that views of that window have in the scene.
        scene_rad: f64,
        /// Noise that they have by themselves.
        alone_rad: f64,
    },
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Noise { part, sigma_rad, limit } => write!(
                f,
                "{part}: the observations that were used miss by {:.2} deg, more than {:.2} deg",
                sigma_rad.to_degrees(),
                limit.to_degrees()
            ),
            Self::NoiseOverGiven { part, ratio } => {
                write!(f, "{part}: the observations that were used miss by {ratio:.2} times what their sigma says")
            }
            Self::Misfits { part, share } => {
                write!(f, "{part}: {} of the observations that were used lie far beyond the others", percent(*share))
            }
            Self::Lost { lost, judged } => {
                let share = percent(*lost as f64 / *judged as f64);
                write!(f, "{share} of the tracks ({lost} of {judged}) fit nowhere: they move, or show another scene")
            }
            Self::Behind { part, share, views } => write!(
                f,
                "{part}: {} of the observations that were used point away from their points ({})",
                percent(*share),
                name_views(views)
            ),
            Self::Untied { part, views } => {
                write!(f, "{part}: no observation that was used ties {} to the rest", name_views(views))
            }
            Self::Unplaced { views } => {
                write!(f, "{} see much of the scene, yet found no place in it", name_views(views))
            }
            Self::Torn { first, second, shared, share, elsewhere } => {
                let sides = if second.is_empty() {
                    format!("{} share {shared} tracks with one another", name_views(first))
                } else {
                    format!("{} and {} share {shared} tracks", name_views(first), name_views(second))
                };
                let (share, elsewhere) = (percent(*share), percent(*elsewhere));
                write!(f, "{sides} (counted by pairs), of which {share} fit both sides; elsewhere {elsewhere} do")
            }
            Self::Tension { part, alone_rad, scene_rad } => write!(
                f,
                "{part}: neighbouring views agree to {:.4} deg among themselves, but miss by {:.4} deg in the scene",
                alone_rad.to_degrees(),
                scene_rad.to_degrees()
            ),
            Self::Strained { views, strain, scene_rad, alone_rad } => write!(
                f,
                "{} are forced into a shape they do not fit: {:.4} deg in the scene, {:.4} deg by themselves ({strain:.1} \
                 times what noise explains)",
                name_views(views),
                scene_rad.to_degrees(),
                alone_rad.to_degrees()
            ),
        }
    }
}

fn percent(share: f64) -> String {
    let value = 100.0 * share;
    if value > 0.0 && value < 1.0 { format!("{value:.2} %") } else { format!("{value:.0} %") }
}

/// Most runs of views that a sentence names.
const MOST_RUNS: usize = 4;

/// "view 3", "views 31 to 44", "views 3, 5 to 9 and 12 others"; `views` ascends.
fn name_views(views: &[u32]) -> String {
    let mut runs: Vec<[u32; 2]> = Vec::new();
    for &view in views {
        match runs.last_mut() {
            Some(run) if run[1] + 1 == view => run[1] = view,
            _ => runs.push([view, view]),
        }
    }
    let named: Vec<String> = runs
        .iter()
        .take(MOST_RUNS)
        .map(|&[from, to]| match to - from {
            0 => from.to_string(),
            1 => format!("{from}, {to}"),
            _ => format!("{from} to {to}"),
        })
        .collect();
    let others: u32 = runs.iter().skip(MOST_RUNS).map(|[from, to]| to - from + 1).sum();
    let plural = if views.len() == 1 { "view" } else { "views" };
    let rest = if others > 0 { format!(" and {others} others") } else { String::new() };
    format!("{plural} {}{rest}", named.join(", "))
}

#[cfg(test)]
mod tests {
    use super::name_views;

    #[test]
    fn views_are_named_by_runs() {
        assert_eq!(name_views(&[3]), "view 3");
        assert_eq!(name_views(&[3, 4]), "views 3, 4");
        assert_eq!(name_views(&[1, 3, 4, 5]), "views 1, 3 to 5");
        assert_eq!(name_views(&[1, 3, 5, 7, 9, 10]), "views 1, 3, 5, 7 and 2 others");
    }
}
