//! Why bearings leave a scene undetermined: the exact condition where every view sees every point, named causes elsewhere.
//!
//! Orientations are known, so a null vector moves view `p_i` and point `q_j` such that every segment changes only along
//! itself: `dq_j - dp_i = lambda_ij (q_j - p_i)`, the parallel redrawings of the bipartite graph of sightings. Where all
//! `m` views see all `n` points of the plane, these are the infinitesimal motions of the bar framework K(m, n), each turned
//! by a right angle, and the stresses of that framework are known (Bolker and Roth 1980). With `P` and `Q` the ranks of the
//! homogeneous coordinates `(p_i, 1)` and `(q_j, 1)`,
//!
//! `nullity = 2 (m + n) - m n + (m - P)(n - Q) + dim { (lambda, mu) : sum lambda_i p_i p_i^T = sum mu_j q_j q_j^T }`,
//!
//! where `lambda_i` counts for views in the span of the points and `mu_j` for points in the span of the views. With both sets
//! off every line that is `3 + ` the number of independent conics through all views and points. In space a set that is not
//! coplanar has nullity 4, and 1 more for each member that lies on one line with all it sees. The derivation, and what the
//! theorems of Knill and Ramirez-Herran (2007) leave out, is in `docs/method/conditions.md`.
//!
//! A *tolerance* is a distance from the fitted shape, relative to the size of the configuration: the largest distance of a
//! member from the centroid of all.

mod arrangement;
mod blocks;
mod graph;
mod inside;
mod joins;
mod loose;
mod naming;
mod shapes;

use crate::geometry::Vector;
use arrangement::Arrangement;
pub use naming::name_causes;

/// Why something is not determined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CauseKind {
    /// No observation ties these parts to each other.
    Disconnected,
    /// A single view, or several at one place: points have no depth.
    OneCamera,
    /// Two views in the plane, however many points.
    TwoCameras,
    /// Two points in the plane, however many views.
    TwoPoints,
    /// Two views and two points in space that lie in one plane.
    CoplanarTwoByTwo,
    /// All views on one line and all points on another.
    TwoLines1,
    /// Views and points spread over two lines in any other way.
    TwoLines2,
    /// Views and points on one conic.
    Conic,
    /// Rigid parts that hold each other by too little to share one scale.
    WeakJoin,
    /// Fewer equations than unknowns.
    TooFewEquations,
    /// All views of a point lie on one line with it.
    CameraCollinear,
    /// All points that a view sees lie on one line with it.
    PointCollinear,
    /// A point seen in one direction only, or a view that sees one point only.
    HiddenPoint,
    /// None of these; the null vector is the evidence.
    Other,
}

impl CauseKind {
    /// The name in Python and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Disconnected => "disconnected",
            Self::OneCamera => "one_camera",
            Self::TwoCameras => "two_cameras",
            Self::TwoPoints => "two_points",
            Self::CoplanarTwoByTwo => "coplanar_two_by_two",
            Self::TwoLines1 => "two_lines_1",
            Self::TwoLines2 => "two_lines_2",
            Self::Conic => "conic",
            Self::WeakJoin => "weak_join",
            Self::TooFewEquations => "too_few_equations",
            Self::CameraCollinear => "camera_collinear",
            Self::PointCollinear => "point_collinear",
            Self::HiddenPoint => "hidden_point",
            Self::Other => "other",
        }
    }
}

/// One cause, with the members it concerns.
#[derive(Debug, Clone, PartialEq)]
pub struct Cause {
    /// Its name.
    pub kind: CauseKind,
    /// Views it concerns, ascending.
    pub views: Vec<u32>,
    /// Tracks it concerns, ascending.
    pub tracks: Vec<u32>,
    /// Rigid components it keeps apart, ascending.
    pub components: Vec<u32>,
    /// More words: "ellipse", "2 of 4 constraints".
    pub detail: String,
    /// For drawing. Lines: a point and a direction each, `2 D` numbers a line. A conic of the plane: `a, b, c, d, e, f` of
    /// `a x^2 + b x y + c y^2 + d x + e y + f = 0`. Empty where there is none, as for a conic in space.
    pub shape: Vec<f64>,
    /// Whether it holds to [`EXACT`], or only to the tolerance. What is counted is exact.
    pub is_exact: bool,
}

/// A shape that members miss by no more than this, relative to the size of the configuration, is met exactly.
pub const EXACT: f64 = 1e-9;

/// Observations of a scene: view `view[k]`, which stands at `centers[view[k]]`, sees point `track[k]`.
#[derive(Debug, Clone, Copy)]
pub struct Sightings<'a, const D: usize> {
    /// Position of each view.
    pub centers: &'a [Vector<D>],
    /// Position of each point.
    pub points: &'a [Vector<D>],
    /// View of each observation, an index into `centers`.
    pub view: &'a [u32],
    /// Track of each observation, an index into `points`.
    pub track: &'a [u32],
}

/// Members of a rigid component.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Members {
    /// Views, ascending.
    pub views: Vec<u32>,
    /// Tracks, ascending.
    pub tracks: Vec<u32>,
}

/// What a numerical test found free.
#[derive(Debug, Clone, Copy)]
pub struct Flexibility<'a> {
    /// Dimension of the null space.
    pub nullity: usize,
    /// Of which any scene has this many: shifts, scale, and the turns that free orientations share.
    pub gauge_freedoms: usize,
    /// Rigid component of each observation; -1 where it is alone.
    pub component_of_observation: &'a [i32],
    /// The components. A hinge is a member of more than one.
    pub components: &'a [Members],
    /// Whether orientations are unknown, or unknown about the vertical.
    pub free_orientation: bool,
}

/// Dimension of the null space where every view sees every point, from the geometry alone: 3 in the plane and 4 in space where
/// the scene is determined.
///
/// `tolerance` is relative to the size of the configuration. `None` where a view is at a point, which leaves no segment to
/// observe, or where a coordinate is not finite.
///
/// ```
/// use panopath::rigidity::conditions::full_visibility_nullity;
/// // three views and three points on a circle are ambiguous, whatever the angles between them
/// let on_circle = |angle: f64| [angle.cos(), angle.sin()];
/// let views = [0.1, 1.3, 2.8].map(on_circle);
/// let points = [0.6, 3.9, 5.0].map(on_circle);
/// assert_eq!(full_visibility_nullity(&views, &points, 1e-9), Some(4));
/// ```
pub fn full_visibility_nullity<const D: usize>(
    views: &[Vector<D>],
    points: &[Vector<D>],
    tolerance: f64,
) -> Option<usize> {
    if views.iter().chain(points).flatten().any(|x| !x.is_finite()) {
        return None;
    }
    if views.is_empty() || points.is_empty() {
        return Some(D * (views.len() + points.len()));
    }
    let set = Arrangement::new(views, points, tolerance)?;
    (!set.has_view_at_point()).then(|| set.nullity())
}

/// The conditions that fail where every view sees every point: empty where, and only where, the scene is determined.
///
/// Members are indices into the arguments. Empty, too, where [`full_visibility_nullity`] is `None`.
pub fn failing_conditions<const D: usize>(views: &[Vector<D>], points: &[Vector<D>], tolerance: f64) -> Vec<Cause> {
    if full_visibility_nullity(views, points, tolerance).is_none() {
        return Vec::new();
    }
    if views.is_empty() || points.is_empty() {
        let mut cause = Cause::new(CauseKind::Disconnected, "nothing is observed");
        cause.views = (0..views.len() as u32).collect();
        cause.tracks = (0..points.len() as u32).collect();
        return if views.len() + points.len() > 1 { vec![cause] } else { Vec::new() };
    }
    Arrangement::new(views, points, tolerance).map_or_else(Vec::new, |set| set.failing())
}

impl Cause {
    pub(super) fn new(kind: CauseKind, detail: impl Into<String>) -> Self {
        let none = Vec::new();
        Self {
            kind,
            views: none.clone(),
            tracks: none.clone(),
            components: none,
            detail: detail.into(),
            shape: Vec::new(),
            is_exact: true,
        }
    }
}

/// "1 view", "3 views".
fn count_of(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}
