"""The compiled core: arrays in, arrays out. Use ``panopath.steps``, which wraps these in records."""

from collections.abc import Mapping
from typing import Any, final

import numpy as np
import numpy.typing as npt

__all__ = [
    "RenderedWalk",
    "__version__",
    "average_rotations",
    "bearings_from_circular",
    "bearings_from_compass",
    "bearings_from_cylindrical",
    "bearings_from_equirectangular",
    "bearings_from_perspective",
    "bearings_from_planar_compass",
    "bearings_from_spherical",
    "build_info",
    "certify",
    "check_consistency",
    "circular_from_bearings",
    "compass_from_bearings",
    "cylindrical_from_bearings",
    "equirectangular_from_bearings",
    "fit_rotations",
    "freedoms_of_paths",
    "full_visibility",
    "match_features",
    "matches_that_agree",
    "mean_motion",
    "natural_order",
    "path_functions",
    "perspective_from_bearings",
    "planar_compass_from_bearings",
    "position_covariance",
    "read_numbers",
    "read_table",
    "refine",
    "relative_poses",
    "render_walk",
    "run_trials",
    "scene_covariance",
    "simulate",
    "solve_paths",
    "solve_positions",
    "spherical_from_bearings",
    "start_headings",
    "tracks_from_matches",
    "vertical_field_of_view",
    "view_pairs",
    "walk_lap_m",
]

__version__: str

_Observations = tuple[
    npt.NDArray[np.int32],
    npt.NDArray[np.int32],
    npt.NDArray[np.float64],
    int,
    int,
    npt.NDArray[np.float64] | None,
]
_Start = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int32], npt.NDArray[np.int32]]

def average_rotations(
    first: npt.NDArray[np.int32],
    second: npt.NDArray[np.int32],
    second_from_first: npt.NDArray[np.float64],
    n_views: int,
    sigma_rad: npt.NDArray[np.float64],
    priors: list[tuple[Any, ...]],
    options: Mapping[str, Any],
) -> dict[str, Any]: ...
def freedoms_of_paths(
    observations: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32], npt.NDArray[np.float64] | None],
    scene: tuple[
        npt.NDArray[np.float64], npt.NDArray[np.float64], list[tuple[str, int, list[float]]], npt.NDArray[np.float64]
    ],
    options: Mapping[str, Any],
) -> dict[str, Any]: ...
def path_functions(
    model: tuple[str, int, list[float]], time_s: npt.NDArray[np.float64], derivative: int
) -> npt.NDArray[np.float64]: ...
def solve_paths(
    observations: _Observations,
    time_s: npt.NDArray[np.float64],
    cam_from_world: npt.NDArray[np.float64] | None,
    motion: tuple[
        list[tuple[str, int, list[float]]],
        npt.NDArray[np.int32],
        list[tuple[str, int, list[float]]],
        bool,
        bool,
        bool,
    ],
    options: dict[str, Any],
    start: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None,
) -> dict[str, Any]: ...
def solve_positions(
    observations: _Observations,
    cam_from_world: npt.NDArray[np.float64] | None,
    options: Mapping[str, Any],
    start: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None,
) -> dict[str, Any]: ...
def check_consistency(
    observations: _Observations,
    cam_from_world: npt.NDArray[np.float64] | None,
    scene: _Start,
    inlier: npt.NDArray[np.bool_],
    options: Mapping[str, Any],
) -> tuple[list[str], list[tuple[str, float, float]]]: ...
def refine(
    observations: _Observations,
    cam_from_world: npt.NDArray[np.float64] | None,
    start: _Start,
    options: Mapping[str, Any],
) -> dict[str, Any]: ...
def run_trials(
    dimension: int,
    trials: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.float64]],
    methods: list[dict[str, Any]],
    threads: int | None,
) -> dict[str, Any]: ...
def view_pairs(
    observations: _Observations,
    min_shared: int,
    max_partners: int,
    max_matches: int,
) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int64], npt.NDArray[np.int32]]: ...
def certify(
    observations: _Observations,
    cam_from_world: npt.NDArray[np.float64],
    scene: _Start,
    fit: tuple[npt.NDArray[np.bool_], npt.NDArray[np.float64]],
    options: Mapping[str, Any],
) -> dict[str, Any]: ...
def full_visibility(
    centers: npt.NDArray[np.float64], points: npt.NDArray[np.float64], tolerance: float
) -> tuple[int, list[dict[str, Any]]] | None: ...
def scene_covariance(
    observations: _Observations,
    cam_from_world: npt.NDArray[np.float64] | None,
    start: _Start,
    inlier: npt.NDArray[np.bool_] | None,
    reference: int | None,
    sigma: float,
    options: Mapping[str, Any],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]: ...
def position_covariance(
    observations: _Observations,
    cam_from_world: npt.NDArray[np.float64] | None,
    centers: npt.NDArray[np.float64],
    points: npt.NDArray[np.float64],
    inlier: npt.NDArray[np.bool_] | None,
) -> npt.NDArray[np.float64]: ...
def matches_that_agree(
    pair_start: npt.NDArray[np.int64],
    matches: npt.NDArray[np.int64],
    bearing: npt.NDArray[np.float64],
    tolerance_rad: npt.NDArray[np.float64],
    second_from_first: npt.NDArray[np.float64],
    baseline: npt.NDArray[np.float64],
    limit_rad: npt.NDArray[np.float64],
) -> npt.NDArray[np.bool_]: ...
def relative_poses(
    pair_start: npt.NDArray[np.int64],
    first: npt.NDArray[np.float64],
    second: npt.NDArray[np.float64],
    second_from_first: npt.NDArray[np.float64] | None,
    options: Mapping[str, Any],
) -> dict[str, Any]: ...
def tracks_from_matches(
    n_features: npt.NDArray[np.int64],
    pairs: npt.NDArray[np.int32],
    match_starts: npt.NDArray[np.int64],
    matches: npt.NDArray[np.int32],
    min_images: int,
    min_linkage: float,
) -> dict[str, Any]: ...
def match_features(
    feature_starts: npt.NDArray[np.int64],
    descriptors: npt.NDArray[np.uint8],
    bearings: npt.NDArray[np.float64],
    pairs: npt.NDArray[np.int32],
    guides: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]
    | None,
    max_ratio: float,
    max_distance: float,
    max_features: int | None,
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]: ...
def mean_motion(
    observations: _Observations,
    options: Mapping[str, Any],
) -> dict[str, Any]: ...
def fit_rotations(
    observations: _Observations,
    centers: npt.NDArray[np.float64],
    points: npt.NDArray[np.float64],
    cam_from_world: npt.NDArray[np.float64],
    weighting: str,
    share: float,
) -> npt.NDArray[np.float64]: ...
def start_headings(
    observations: _Observations,
    options: Mapping[str, Any],
) -> dict[str, Any]: ...

_Column = npt.NDArray[np.float64] | tuple[npt.NDArray[np.int32], list[str]] | None

def read_table(data: bytes, source: str, roles: list[str]) -> tuple[list[_Column], npt.NDArray[np.int64]]: ...
def read_numbers(data: bytes, source: str, skip_lines: int) -> npt.NDArray[np.float64]: ...
def natural_order(names: list[str]) -> npt.NDArray[np.int64]: ...

@final
class RenderedWalk:
    @property
    def centers(self) -> npt.NDArray[np.float64]: ...
    @property
    def cam_from_world(self) -> npt.NDArray[np.float64]: ...
    @property
    def time_s(self) -> npt.NDArray[np.float64]: ...
    def frame(self, k: int) -> npt.NDArray[np.uint8]: ...
    def ranges(self, k: int) -> npt.NDArray[np.float32]: ...

def render_walk(options: dict[str, Any]) -> RenderedWalk: ...
def walk_lap_m() -> float: ...
def simulate(world: str, options: dict[str, Any]) -> dict[str, Any]: ...
def bearings_from_spherical(angle_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def spherical_from_bearings(bearing: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def bearings_from_circular(theta_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def circular_from_bearings(bearing: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def bearings_from_compass(angle_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def compass_from_bearings(bearing: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def bearings_from_planar_compass(azimuth_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def planar_compass_from_bearings(bearing: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]: ...
def bearings_from_cylindrical(theta_height: npt.NDArray[np.float64], radius: float) -> npt.NDArray[np.float64]: ...
def cylindrical_from_bearings(bearing: npt.NDArray[np.float64], radius: float) -> npt.NDArray[np.float64]: ...
def bearings_from_perspective(
    pixel: npt.NDArray[np.float64], focal_px: tuple[float, float], principal_px: tuple[float, float]
) -> npt.NDArray[np.float64]: ...
def perspective_from_bearings(
    bearing: npt.NDArray[np.float64], focal_px: tuple[float, float], principal_px: tuple[float, float]
) -> npt.NDArray[np.float64]: ...
def bearings_from_equirectangular(
    pixel: npt.NDArray[np.float64], width_px: float, height_px: float
) -> npt.NDArray[np.float64]: ...
def equirectangular_from_bearings(
    bearing: npt.NDArray[np.float64], width_px: float, height_px: float
) -> npt.NDArray[np.float64]: ...
def vertical_field_of_view(
    bearing: npt.NDArray[np.float64], low_rad: float, high_rad: float, y_down: bool
) -> npt.NDArray[np.float64]: ...
def build_info() -> dict[str, Any]: ...
