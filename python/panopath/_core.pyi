"""The compiled core: arrays in, arrays out. Use ``panopath.steps``, which wraps these in records."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

__version__: str

def solve_positions(
    view: npt.NDArray[np.int32],
    track: npt.NDArray[np.int32],
    bearing: npt.NDArray[np.float64],
    n_views: int,
    n_tracks: int,
    sigma_rad: npt.NDArray[np.float64] | None,
    cam_from_world: npt.NDArray[np.float64] | None,
    options: Mapping[str, Any],
    start: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]] | None,
) -> dict[str, Any]: ...
def position_covariance(
    view: npt.NDArray[np.int32],
    track: npt.NDArray[np.int32],
    bearing: npt.NDArray[np.float64],
    n_views: int,
    n_tracks: int,
    sigma_rad: npt.NDArray[np.float64] | None,
    cam_from_world: npt.NDArray[np.float64] | None,
    centers: npt.NDArray[np.float64],
    points: npt.NDArray[np.float64],
    inlier: npt.NDArray[np.bool_] | None,
) -> npt.NDArray[np.float64]: ...

Column = npt.NDArray[np.float64] | tuple[npt.NDArray[np.int32], list[str]] | None

def read_table(data: bytes, source: str, roles: list[str]) -> tuple[list[Column], npt.NDArray[np.int64]]: ...
def read_numbers(data: bytes, source: str, skip_lines: int) -> npt.NDArray[np.float64]: ...
def natural_order(names: list[str]) -> npt.NDArray[np.int64]: ...
def simulate(world: str, options: dict[str, Any]) -> dict[str, Any]: ...
