"""The mapped scene as a checkpoint, and the orientations that a locked camera has beforehand."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.checkpoints import key_of
from panopath.errors import InputError
from panopath.formats.database import Database
from panopath.formats.folder import scene_arrays, scene_of_arrays, summary_of
from panopath.frontend import Measured
from panopath.frontend.stored import Store
from panopath.mapping import MapOptions, MappedDatabase, map_database
from panopath.model import Scene, summary_dict
from panopath.pipeline import ViewOrientations
from panopath.run.options import RunOptions

#: A camera keeps its direction where nearly all pairs of views are turned against one another by less, radians.
_LOCKED_RAD, _LOCKED_SHARE = float(np.radians(0.7)), 0.95
_NAME = "mapped"
#: Pictures that see a point, for its depth to be checked.
_CHECKED_BY = 3


@dataclass(frozen=True, eq=False)
class Mapped:
    """What the mapper made of the measurements."""

    #: Views are frames, tracks are points; not yet upright, of any size.
    scene: Scene
    #: (N, 3) image, feature and point of the observations in use.
    observations: npt.NDArray[np.int64]
    #: Whether the camera kept its direction, and orientations were known by that.
    is_locked: bool


def mapped(measured: Measured, options: RunOptions, store: Store) -> Mapped:
    """Map the measurements, or give what an earlier run has mapped."""
    is_locked = options.direction_locked
    if is_locked is None:
        is_locked = measured.motion is not None and _keeps_direction(measured)
    own = replace(store, key=key_of(measured.key, options.mapping, is_locked, options.horizon_locked))
    arrays: dict[str, Any] | None = own.read(_NAME)
    if arrays is not None:
        summary = summary_of(json.loads(str(arrays["summary"])))
        return Mapped(scene_of_arrays(arrays, summary), arrays["observations"], is_locked)
    database = measured.database
    if options.horizon_locked:
        database = replace(database, gravity=np.tile([0.0, 1.0, 0.0], (database.n_images, 1)))
    oriented = None
    if is_locked:
        n = database.n_frames
        oriented = ViewOrientations(np.tile(np.eye(3), (n, 1, 1)), np.zeros(n, dtype=np.int32))
    found = _best(database, options.mapping, oriented)
    of = found.reconstruction
    observations = np.stack((of.image, of.feature, of.point), axis=1).astype(np.int64)
    summary_text = json.dumps(summary_dict(found.scene.summary))
    own.write(_NAME, scene_arrays(found.scene) | {"summary": summary_text, "observations": observations})
    return Mapped(found.scene, observations, is_locked)


def _best(database: Database, options: MapOptions, oriented: ViewOrientations | None) -> MappedDatabase:
    """Map by points that three pictures see, and by those of two only where the others do not place everything.

    Nothing checks the depth of a point that two pictures see: nearly a third of them are wrong matches that lie along
    the great circle by chance. They add little to the path, and to the points that are handed on they do harm.
    """
    found: MappedDatabase | None = None
    for least in range(min(_CHECKED_BY, database.n_frames), options.min_track_length - 1, -1):
        try:
            tried = map_database(database, replace(options, min_track_length=least), oriented=oriented)
        except InputError:
            if least == options.min_track_length and found is None:
                raise
            continue
        if found is None or tried.scene.summary.n_solved_views > found.scene.summary.n_solved_views:
            found = tried
        if found.scene.summary.n_solved_views == database.n_frames and found.scene.n_components == 1:
            break
    if found is None:
        return map_database(database, options, oriented=oriented)
    return found


def _keeps_direction(measured: Measured) -> bool:
    cosine = 0.5 * (np.trace(measured.matches.second_from_first, axis1=1, axis2=2) - 1.0)
    turned = np.arccos(np.clip(cosine, -1.0, 1.0))
    return bool((turned < _LOCKED_RAD).mean() >= _LOCKED_SHARE)
