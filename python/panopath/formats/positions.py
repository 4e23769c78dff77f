"""Positions to compare with: from a panopath folder, a COLMAP model, a BAL file, or a table of positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.csv import header_of, read_control
from panopath.formats.detect import read_problem
from panopath.formats.files import check_text, read_bytes
from panopath.formats.folder import is_scene_folder, read_scene
from panopath.model import Float, Scene


@dataclass(frozen=True, eq=False)
class Truth:
    """True positions in the order of a scene, NaN rows where not known."""

    #: (n_views, d).
    centers: Float
    #: (n_tracks, d).
    points: Float


def read_truth(path: str | PathLike[str], scene: Scene) -> Truth:
    """Read true positions and put them in the order of ``scene``, by name.

    Parameters
    ----------
    path
        A folder that panopath wrote, a COLMAP model folder, a BAL file, or a CSV with ``view`` or ``track`` and
        ``x,y[,z]``.
    scene
        Whose names say the order.

    Raises
    ------
    InputError
        Where the file cannot be read, or names no view of the scene.
    """
    place = Path(path)
    if place.is_file() and _is_position_table(place):
        control = read_control(place)
        views: dict[str, npt.ArrayLike] = {str(k): v for k, v in control.views.items()}
        points: dict[str, npt.ArrayLike] = {str(k): v for k, v in control.points.items()}
        d = control.d
    else:
        known = read_scene(place) if is_scene_folder(place) else read_problem(place).scene
        if known is None:
            raise InputError(f"{place}: has bearings but no positions to compare with")
        views = dict(zip(known.view_labels(), known.centers, strict=True))
        points = dict(zip(known.track_labels(), known.points, strict=True))
        d = known.d
    if d != scene.d:
        raise InputError(f"{place}: has positions of {d} coordinates, but the scene has {scene.d}")
    truth = Truth(_in_order(views, scene.view_labels(), d), _in_order(points, scene.track_labels(), d))
    if np.isnan(truth.centers).all() and np.isnan(truth.points).all():
        example = scene.view_labels()[0]
        raise InputError(f"{place}: names no view and no track of the scene (whose first view is {example!r})")
    return truth


def _is_position_table(path: Path) -> bool:
    data = read_bytes(path)
    try:
        header = header_of(check_text(data, str(path)), str(path))
    except InputError:
        return False
    # a table of bearings has both; one of positions may have both too, but then one of them is empty in each row
    return ("view" in header) != ("track" in header)


def _in_order(table: Mapping[str, npt.ArrayLike], labels: Sequence[str], d: int) -> Float:
    unknown = (np.nan,) * d
    return np.array([table.get(name, unknown) for name in labels], dtype=np.float64).reshape(len(labels), d)
