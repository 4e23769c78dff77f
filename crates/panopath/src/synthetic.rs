//! Worlds with exact truth: where the views stood, where the points lie, and what was seen.
//!
//! An observation of point `X` by a view at `C` is the unit vector
//! `bearing = exp(noise) * cam_from_world * (X - C) / |X - C|`,
//! where `exp` is the exponential map of the sphere and `noise` an isotropic Gaussian of its tangent plane. Or the angles
//! of the camera are off, each by an error of its own, as in Knill & Ramirez-Herran's experiments. A world is
//! laid out (`layout`: path, points, who sees whom) and then measured (`measure`: orientation, noise, outliers). Each
//! of these draws from a stream of its own, so that the same seed with more noise is the same scene seen worse. Cars and
//! people move through a world where that is asked for (`bodies`).

use std::str::FromStr;

use crate::geometry::{Rotation, Vector};
use crate::tracks::{Tracks, TracksError};

mod bodies;
mod layout;
mod measure;
pub mod render;

/// A scene, what was seen of it, and what of that is wrong. `D` is 2 in the plane and 3 in space.
///
/// Observations are sorted by track, then by view.
#[derive(Debug, Clone, PartialEq)]
pub struct World<const D: usize = 3> {
    /// What was seen; bearings are in the camera frame (which is the world frame under [`Orientations::Identity`]).
    pub tracks: Tracks<D>,
    /// Orientation of each view as a solver is told it: the true one, turned by the orientation error.
    pub cam_from_world: Vec<Rotation<D>>,
    /// True position of each view.
    pub centers: Vec<Vector<D>>,
    /// True position of each track's point; of a carried one and of the one body's, where its anchor view saw it; of one
    /// of many bodies', in the middle of the time that it was seen.
    pub points: Vec<Vector<D>>,
    /// What each track's point does while the views are taken.
    pub motion: Vec<Motion<D>>,
    /// When each track's point was where `points` says.
    pub point_time_s: Vec<f64>,
    /// Per observation: a false direction, or the sighting of something that is carried with the camera or, with one
    /// body, of that. Sightings of many bodies are right.
    pub outlier: Vec<bool>,
    /// When each view was taken.
    pub time_s: Vec<f64>,
    /// Standard deviation of the noise along each tangent direction.
    pub noise_rad: f64,
}

/// What a track's point does while the views are taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion<const D: usize> {
    /// It stays where it is.
    Still,
    /// `point + velocity s + acceleration s^2 / 2`, `s` the time since `point_time_s`.
    Moves {
        /// The body it rides on.
        body: u32,
        /// Velocity at `point_time_s`.
        velocity: Vector<D>,
        /// Constant acceleration.
        acceleration: Vector<D>,
    },
    /// Constant position in the camera frame.
    Carried(Vector<D>),
}

/// The worlds there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WorldKind {
    /// Uniform points and views in the square or cube `[-1, 1]^D` (Knill & Ramirez-Herran's experiment).
    Box,
    /// A closed walk; near points are seen by few consecutive views, far ones by many.
    Street,
    /// A random walk in a room of 8 x 6 x 2.6 m; points on its walls, seen again when the walk comes back.
    Room,
    /// A straight walk along a corridor 3 m wide and 2.6 m high; points on its sides.
    Corridor,
    /// An exactly straight path, points off the line.
    Line,
    /// The street's closed walk with pauses, during which the camera does not move at all.
    StopAndGo,
    /// A long winding walk that never closes.
    Chain,
    /// Views and points on one conic of the plane: ambiguous although richly seen.
    Ellipse,
    /// Views and points on an elliptic cylinder at generic heights: ambiguous seen from above, unique in space.
    Cylinder,
    /// A graph that hangs together by little: clusters joined by two-view tracks, or a chain of such joints.
    Weak,
}

const KINDS: [(&str, WorldKind); 10] = [
    ("box", WorldKind::Box),
    ("street", WorldKind::Street),
    ("room", WorldKind::Room),
    ("corridor", WorldKind::Corridor),
    ("line", WorldKind::Line),
    ("stop_and_go", WorldKind::StopAndGo),
    ("chain", WorldKind::Chain),
    ("ellipse", WorldKind::Ellipse),
    ("cylinder", WorldKind::Cylinder),
    ("weak", WorldKind::Weak),
];

impl WorldKind {
    /// Every world, in the order in which they are documented.
    pub fn all() -> impl Iterator<Item = Self> {
        KINDS.iter().map(|(_, kind)| *kind)
    }

    /// The name by which commands and Python know the world.
    pub fn name(self) -> &'static str {
        KINDS.iter().find(|(_, kind)| *kind == self).map_or("", |(name, _)| name)
    }

    /// The dimensions in which the world exists; the first is the natural one.
    pub fn dimensions(self) -> &'static [usize] {
        match self {
            Self::Ellipse => &[2],
            Self::Cylinder => &[3],
            _ => &[3, 2],
        }
    }
}

impl FromStr for WorldKind {
    type Err = WorldError;

    fn from_str(text: &str) -> Result<Self, WorldError> {
        choose("world", text, &KINDS)
    }
}

/// The frame in which bearings are given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Orientations {
    /// Camera axes are the world's: a bearing is a world direction.
    #[default]
    Identity,
    /// Every view is turned by a rotation drawn uniformly.
    Random,
}

impl FromStr for Orientations {
    type Err = WorldError;

    fn from_str(text: &str) -> Result<Self, WorldError> {
        choose("orientations", text, &[("identity", Self::Identity), ("random", Self::Random)])
    }
}

/// The curve of [`WorldKind::Ellipse`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Conic {
    /// Half axes 2 and 1.
    #[default]
    Ellipse,
    /// The unit circle.
    Circle,
    /// `y = x^2`.
    Parabola,
    /// `x^2 - y^2 = 1`, views and points on both branches.
    Hyperbola,
}

impl FromStr for Conic {
    type Err = WorldError;

    fn from_str(text: &str) -> Result<Self, WorldError> {
        let choices = [
            ("ellipse", Self::Ellipse),
            ("circle", Self::Circle),
            ("parabola", Self::Parabola),
            ("hyperbola", Self::Hyperbola),
        ];
        choose("conic", text, &choices)
    }
}

/// How [`WorldKind::Weak`] hangs together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum WeakMode {
    /// Well-connected clusters, each joined to the next by `n_links` tracks of two views.
    #[default]
    Clusters,
    /// A chain whose consecutive views share only tracks of two views: loose at every link.
    Chain,
}

impl FromStr for WeakMode {
    type Err = WorldError;

    fn from_str(text: &str) -> Result<Self, WorldError> {
        choose("weak_mode", text, &[("clusters", Self::Clusters), ("chain", Self::Chain)])
    }
}

/// What is to be simulated. Fields of type `Option` belong to some worlds only: `None` is the world's own default, and a
/// value given to a world that has no use for it is an error.
#[derive(Debug, Clone, PartialEq)]
pub struct WorldOptions {
    /// Number of views: 100.
    pub n_views: usize,
    /// Number of points, which is the number of tracks: 1000.
    pub n_points: usize,
    /// Seed of everything random: 0.
    pub seed: u64,
    /// Standard deviation of a bearing along each tangent direction: 0.
    pub noise_rad: f64,
    /// Azimuth and elevation of every bearing are each off by an error uniform in `[-angle_error_rad, angle_error_rad]`: 0.
    /// In the plane there is the one angle. Near the poles an azimuth tells less, so this is no isotropic noise.
    pub angle_error_rad: f64,
    /// Probability with which a bearing is replaced by a uniformly random direction: 0.
    pub outlier_fraction: f64,
    /// Share of the tracks that ride on bodies moving through the scene: 0.
    pub mover_fraction: f64,
    /// Speed of the body where there is one: 1.5.
    pub mover_speed_m_s: f64,
    /// Number of these bodies: 1. More of them, in worlds with a long path, are cars and people, seen while near.
    pub n_bodies: usize,
    /// Share of the tracks that are fixed in the camera frame, as the operator who carries it is: 0.
    pub operator_fraction: f64,
    /// Share of the points that are sent, along their ray, to `infinity_distance`: 0.
    pub infinity_fraction: f64,
    /// Range of that distance, log-uniform: (1e5, 1e6). At 1e17 the rays of a small scene are parallel to the last bit.
    pub infinity_distance: (f64, f64),
    /// Frame of the bearings: identity.
    pub orientations: Orientations,
    /// Standard deviation, per axis, by which the returned orientations are off: 0.
    pub orientation_error_rad: f64,
    /// Time from view to view: 1.
    pub frame_interval_s: f64,
    /// Fewest views of a track: 3; box, ellipse, cylinder 2.
    pub min_views: Option<usize>,
    /// Most views of a track: 15; box, ellipse, cylinder all.
    pub max_views: Option<usize>,
    /// Box, ellipse, cylinder: probability that a view sees a point: 1.
    pub visible_fraction: Option<f64>,
    /// Street, line, stop_and_go, chain, weak chain: least distance of a point from its anchor view: 1.
    pub depth_min_m: Option<f64>,
    /// The same worlds: largest distance: 200; weak chain 20.
    pub depth_max_m: Option<f64>,
    /// Worlds with a path, weak chain: distance between consecutive views: 1; room 0.25.
    pub spacing_m: Option<f64>,
    /// Worlds with a path, weak chain: standard deviation of a view about it, per axis: 0.05; line, weak chain 0.
    pub wobble_m: Option<f64>,
    /// Room: views up to this far from a track's anchor view may share the track: 1.
    pub near_m: Option<f64>,
    /// Stop_and_go: steps between two pauses: 10.
    pub go_views: Option<usize>,
    /// Stop_and_go: views taken during a pause, at one and the same place: 5.
    pub stop_views: Option<usize>,
    /// Weak: number of clusters: 2.
    pub n_clusters: Option<usize>,
    /// Weak: two-view tracks that join a cluster to the next; they are the last tracks: 4.
    pub n_links: Option<usize>,
    /// Weak: what is weak about it: clusters.
    pub weak_mode: Option<WeakMode>,
    /// Ellipse: the curve: ellipse.
    pub conic: Option<Conic>,
    /// Ellipse, cylinder: standard deviation by which points leave the curve; above 0 the scene is unique: 0.
    pub off_conic: Option<f64>,
}

impl Default for WorldOptions {
    fn default() -> Self {
        Self {
            n_views: 100,
            n_points: 1000,
            seed: 0,
            noise_rad: 0.0,
            angle_error_rad: 0.0,
            outlier_fraction: 0.0,
            mover_fraction: 0.0,
            mover_speed_m_s: 1.5,
            n_bodies: 1,
            operator_fraction: 0.0,
            infinity_fraction: 0.0,
            infinity_distance: (1e5, 1e6),
            orientations: Orientations::Identity,
            orientation_error_rad: 0.0,
            frame_interval_s: 1.0,
            min_views: None,
            max_views: None,
            visible_fraction: None,
            depth_min_m: None,
            depth_max_m: None,
            spacing_m: None,
            wobble_m: None,
            near_m: None,
            go_views: None,
            stop_views: None,
            n_clusters: None,
            n_links: None,
            weak_mode: None,
            conic: None,
            off_conic: None,
        }
    }
}

/// Why a world cannot be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// A name that is not among the choices.
    #[error("{what} is \"{found}\", expected one of {choices}")]
    Choice {
        /// What was named.
        what: &'static str,
        /// The name found.
        found: String,
        /// The names there are.
        choices: String,
    },
    /// An option outside its range.
    #[error("{option} is {found}, expected {expected}")]
    Range {
        /// The option.
        option: &'static str,
        /// Its value.
        found: String,
        /// The range.
        expected: &'static str,
    },
    /// An option that the world has no use for.
    #[error("{option} has no meaning in the world \"{world}\"; it belongs to {worlds}")]
    NotUsed {
        /// The option.
        option: &'static str,
        /// The world.
        world: &'static str,
        /// The worlds that use it.
        worlds: String,
    },
    /// A world that does not exist in this dimension.
    #[error("dimension is {found}, but the world \"{world}\" exists in dimension {expected} only")]
    Dimension {
        /// The world.
        world: &'static str,
        /// The dimension asked for.
        found: usize,
        /// The dimensions there are.
        expected: usize,
    },
    /// The arrays made no tracks.
    #[error(transparent)]
    Tracks(#[from] TracksError),
}

/// Simulates a world; the same kind, options and dimension give the same bytes.
///
/// # Errors
/// [`WorldError`] naming the option that is out of range or of no use to this world.
///
/// # Examples
/// ```
/// use panopath::synthetic::{WorldKind, WorldOptions, simulate};
/// # fn main() -> Result<(), panopath::synthetic::WorldError> {
/// let world = simulate::<3>(WorldKind::Street, &WorldOptions { noise_rad: 1e-3, ..Default::default() })?;
/// assert_eq!(world.centers.len(), 100);
/// # Ok(())
/// # }
/// ```
pub fn simulate<const D: usize>(kind: WorldKind, options: &WorldOptions) -> Result<World<D>, WorldError> {
    check_dimension(kind, D)?;
    check_used(kind, options)?;
    check_ranges(options)?;
    check_counts(kind, options)?;
    let scene = layout::lay_out::<D>(kind, options);
    measure::measure(kind, scene, options)
}

fn choose<T: Copy>(what: &'static str, found: &str, choices: &[(&str, T)]) -> Result<T, WorldError> {
    choices.iter().find(|(name, _)| *name == found).map(|(_, choice)| *choice).ok_or_else(|| WorldError::Choice {
        what,
        found: found.to_owned(),
        choices: choices.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "),
    })
}

fn check_dimension(kind: WorldKind, found: usize) -> Result<(), WorldError> {
    let dimensions = kind.dimensions();
    if dimensions.contains(&found) {
        return Ok(());
    }
    if let [expected] = *dimensions {
        return Err(WorldError::Dimension { world: kind.name(), found, expected });
    }
    Err(WorldError::Range { option: "dimension", found: found.to_string(), expected: "2 or 3" })
}

fn check_used(kind: WorldKind, o: &WorldOptions) -> Result<(), WorldError> {
    use WorldKind::{Box, Chain, Corridor, Cylinder, Ellipse, Line, Room, StopAndGo, Street, Weak};
    let seen_at_random: &[WorldKind] = &[Box, Ellipse, Cylinder];
    let with_depth: &[WorldKind] = &[Street, Line, StopAndGo, Chain, Weak];
    let with_path: &[WorldKind] = &[Street, Room, Corridor, Line, StopAndGo, Chain, Weak];
    let given: [(&'static str, bool, &[WorldKind]); 12] = [
        ("visible_fraction", o.visible_fraction.is_some(), seen_at_random),
        ("depth_min_m", o.depth_min_m.is_some(), with_depth),
        ("depth_max_m", o.depth_max_m.is_some(), with_depth),
        ("spacing_m", o.spacing_m.is_some(), with_path),
        ("wobble_m", o.wobble_m.is_some(), with_path),
        ("near_m", o.near_m.is_some(), &[Room]),
        ("go_views", o.go_views.is_some(), &[StopAndGo]),
        ("stop_views", o.stop_views.is_some(), &[StopAndGo]),
        ("n_clusters", o.n_clusters.is_some(), &[Weak]),
        ("n_links", o.n_links.is_some(), &[Weak]),
        ("weak_mode", o.weak_mode.is_some(), &[Weak]),
        ("conic", o.conic.is_some(), &[Ellipse]),
    ];
    let off = ("off_conic", o.off_conic.is_some(), &[Ellipse, Cylinder][..]);
    let many = ("n_bodies", o.n_bodies > 1, &[Street, Corridor, Line, StopAndGo, Chain][..]);
    for (option, is_given, worlds) in given.into_iter().chain([off, many]) {
        if is_given && !worlds.contains(&kind) {
            let worlds = worlds.iter().map(|world| world.name()).collect::<Vec<_>>().join(", ");
            return Err(WorldError::NotUsed { option, world: kind.name(), worlds });
        }
    }
    if kind == Weak { check_used_by_weak(o) } else { Ok(()) }
}

fn check_used_by_weak(o: &WorldOptions) -> Result<(), WorldError> {
    let of_chain = [
        ("depth_min_m", o.depth_min_m.is_some()),
        ("depth_max_m", o.depth_max_m.is_some()),
        ("spacing_m", o.spacing_m.is_some()),
        ("wobble_m", o.wobble_m.is_some()),
    ];
    let of_clusters = [
        ("min_views", o.min_views.is_some()),
        ("max_views", o.max_views.is_some()),
        ("n_clusters", o.n_clusters.is_some()),
        ("n_links", o.n_links.is_some()),
    ];
    let (unused, world, worlds) = match o.weak_mode.unwrap_or_default() {
        WeakMode::Clusters => (of_chain, "weak (clusters)", "weak (chain)"),
        WeakMode::Chain => (of_clusters, "weak (chain)", "weak (clusters)"),
    };
    match unused.into_iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => Err(WorldError::NotUsed { option, world, worlds: worlds.to_owned() }),
        None => Ok(()),
    }
}

fn check_ranges(o: &WorldOptions) -> Result<(), WorldError> {
    let fractions = [
        ("outlier_fraction", o.outlier_fraction),
        ("mover_fraction", o.mover_fraction),
        ("operator_fraction", o.operator_fraction),
        ("infinity_fraction", o.infinity_fraction),
        ("visible_fraction", o.visible_fraction.unwrap_or(1.0)),
    ];
    for (option, value) in fractions {
        require(option, value, (0.0..=1.0).contains(&value), "a fraction from 0 to 1")?;
    }
    let both = o.mover_fraction + o.operator_fraction;
    require("mover_fraction + operator_fraction", both, both <= 1.0, "at most 1")?;
    let not_negative = [
        ("noise_rad", o.noise_rad),
        ("angle_error_rad", o.angle_error_rad),
        ("orientation_error_rad", o.orientation_error_rad),
        ("mover_speed_m_s", o.mover_speed_m_s),
        ("wobble_m", o.wobble_m.unwrap_or(0.0)),
        ("off_conic", o.off_conic.unwrap_or(0.0)),
        ("near_m", o.near_m.unwrap_or(0.0)),
    ];
    for (option, value) in not_negative {
        require(option, value, value.is_finite() && value >= 0.0, "a finite number, 0 or more")?;
    }
    let positive = [
        ("frame_interval_s", o.frame_interval_s),
        ("spacing_m", o.spacing_m.unwrap_or(1.0)),
        ("depth_min_m", o.depth_min_m.unwrap_or(1.0)),
        ("depth_max_m", o.depth_max_m.unwrap_or(1.0)),
        ("infinity_distance", o.infinity_distance.0),
        ("infinity_distance", o.infinity_distance.1),
    ];
    for (option, value) in positive {
        require(option, value, value.is_finite() && value > 0.0, "a finite number above 0")?;
    }
    let (near, far) = o.infinity_distance;
    require("infinity_distance", near, near <= far, "the smaller distance first")
}

fn check_counts(kind: WorldKind, o: &WorldOptions) -> Result<(), WorldError> {
    // ids are int32 in Python
    let limit = i32::MAX as usize;
    require("n_views", o.n_views, (1..=limit).contains(&o.n_views), "a number from 1 to 2^31 - 1")?;
    require("n_points", o.n_points, (1..=limit).contains(&o.n_points), "a number from 1 to 2^31 - 1")?;
    require("n_bodies", o.n_bodies, (1..=limit).contains(&o.n_bodies), "a number from 1 to 2^31 - 1")?;
    let (fewest, most) = window(kind, o);
    if let Some(given) = o.min_views {
        require("min_views", given, (1..=o.n_views).contains(&given), "a number from 1 to n_views")?;
    }
    if let Some(given) = o.max_views {
        require("max_views", given, given >= 1, "a number of 1 or more")?;
    }
    require("min_views", fewest, fewest <= most, "a number not above max_views")?;
    let (near, far) = depth_range(kind, o);
    require("depth_min_m", near, near <= far, "a number not above depth_max_m")?;
    if kind == WorldKind::StopAndGo {
        let go = o.go_views.unwrap_or(layout::GO_VIEWS);
        require("go_views", go, go >= 1, "a number of 1 or more")?;
    }
    if kind == WorldKind::Weak {
        check_weak_counts(o)?;
    }
    Ok(())
}

fn check_weak_counts(o: &WorldOptions) -> Result<(), WorldError> {
    if o.weak_mode.unwrap_or_default() == WeakMode::Chain {
        return require("n_views", o.n_views, o.n_views >= 2, "at least 2 for a weak chain");
    }
    let (clusters, links) = (o.n_clusters.unwrap_or(layout::CLUSTERS), o.n_links.unwrap_or(layout::LINKS));
    require("n_clusters", clusters, clusters >= 2, "at least 2")?;
    require("n_views", o.n_views, o.n_views >= clusters.saturating_mul(2), "at least 2 views a cluster")?;
    let joints = links.saturating_mul(clusters - 1);
    require("n_points", o.n_points, o.n_points >= joints.saturating_add(clusters), "a point a cluster beside the links")
}

fn require<T: ToString>(option: &'static str, found: T, holds: bool, expected: &'static str) -> Result<(), WorldError> {
    if holds { Ok(()) } else { Err(WorldError::Range { option, found: found.to_string(), expected }) }
}

/// Fewest and most views of a track.
fn window(kind: WorldKind, o: &WorldOptions) -> (usize, usize) {
    let (fewest, most) = match kind {
        WorldKind::Box | WorldKind::Ellipse | WorldKind::Cylinder => (2, o.n_views),
        _ => (3, 15),
    };
    // a default gives way to what was asked for, and both to the number of views there are
    let max_views = o.max_views.unwrap_or(most.max(o.min_views.unwrap_or(0))).min(o.n_views);
    (o.min_views.unwrap_or(fewest.min(max_views)), max_views)
}

/// Least and largest distance of a point from its anchor view.
fn depth_range(kind: WorldKind, o: &WorldOptions) -> (f64, f64) {
    let far = if kind == WorldKind::Weak { 20.0 } else { 200.0 };
    let near = 1.0_f64;
    let max = o.depth_max_m.unwrap_or(f64::max(far, o.depth_min_m.unwrap_or(near)));
    (o.depth_min_m.unwrap_or(near.min(max)), max)
}
