"""Where a scene stands: which way is up, how large it is, and where on the earth.

gravity tags, camera axes or the plane of motion -> z up
places known, height of the camera or a known distance -> metres        (else the scale is arbitrary, and said so)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.frontend.images import ImageHeader
from panopath.georeference import Georeference, georeference, scale_from_baseline
from panopath.model import Float, Scene
from panopath.moves import moved_scene
from panopath.upright import Up, UpSource, find_up, make_upright

#: Tags of gravity that differ by more than this from one another are not used: radians.
_TAGS_AGREE_RAD = float(np.radians(5.0))
#: Rays of the ground go down at least so steeply, and it is seen by so many of them.
_STEEP_RAD, _FEWEST_GROUND = float(np.radians(30.0)), 30
#: Places that agree, for the scale to rest on them: two fit any path, by scale and heading.
_FEWEST_PLACES = 3
#: Heights in one bin of the search for the ground differ by this factor.
_HEIGHT_BIN = 1.06
#: A lower layer is the ground where it is this share as full as the fullest.
_LAYER_SHARE = 0.4


@dataclass(frozen=True, eq=False)
class Placed:
    """A scene in the frame of the world, and what that rests on."""

    scene: Scene
    #: One a component.
    up: tuple[Up, ...]
    georeference: Georeference | None
    #: ``m``, or empty where the scale is arbitrary.
    unit: str
    statements: tuple[str, ...]

    @property
    def is_upright(self) -> bool:
        """Whether z is up in the largest component."""
        return bool(self.up) and self.up[0].source is not UpSource.UNKNOWN


def place_on_earth(  # noqa: PLR0917
    scene: Scene,
    gravity: npt.ArrayLike | None = None,
    position_wgs84: npt.ArrayLike | None = None,
    camera_height_m: float | None = None,
    baseline: tuple[str, str, float] | None = None,
    scale_is_known: bool = False,
) -> Placed:
    """Bring a scene into the frame of the world as far as it is known.

    Parameters
    ----------
    scene
        In space.
    gravity
        (n_views, 3) the upward vertical in each camera, NaN where unknown.
    position_wgs84
        (n_views, 3) latitude and longitude in degrees, height in metres; NaN where unknown.
    camera_height_m
        Height of the camera above the ground: see :func:`camera_height`.
    baseline
        Names of two views and their distance in metres.
    scale_is_known
        Whether the scene is in metres already, as that of a calibrated rig is.

    Raises
    ------
    InputError
        Where the height or the distance cannot be applied.
    """
    said: list[str] = []
    up = find_up(scene, gravity)
    if gravity is not None and up and up[0].source is UpSource.GRAVITY and up[0].spread_rad > _TAGS_AGREE_RAD:
        said.append(
            f"the pictures' tags of gravity differ by {np.degrees(up[0].spread_rad):.0f} deg from one another and "
            "were not used"
        )
        up = find_up(scene)
    scene = make_upright(scene, up)
    if up:
        said.append(up[0].sentence())
    unit, earth = "m" if scale_is_known else "", None
    if camera_height_m is not None:
        scene, unit = _sized(scene, camera_height_m / camera_height(scene)), "m"
        said.append(f"scale is from the camera's height above the ground, {camera_height_m:g} m")
    elif baseline is not None:
        first, second = (picture_named(scene.view_labels(), name) for name in baseline[:2])
        scene, unit = _sized(scene, scale_from_baseline(scene, first, second, baseline[2])), "m"
        said.append(f"scale is from the distance of {baseline[0]} and {baseline[1]}, {baseline[2]:g} m")
    elif position_wgs84 is not None and np.isfinite(np.asarray(position_wgs84)[:, :2]).all(axis=1).any():
        earth = georeference(scene, position_wgs84)
        n_agree = int(earth.fits[0].inlier.sum()) if earth.fits else 0
        if earth.is_fitted and n_agree < _FEWEST_PLACES:
            said.append(
                f"GPS was not used: any {n_agree} positions fit a path, so that nothing tells whether they are right"
            )
            earth = None
        else:
            said += [fit.sentence() for fit in earth.fits[:1]]
        if earth is not None and earth.is_fitted:
            scene, unit = earth.scene, "m"
        else:
            earth = None
    if not unit:
        said.append("scale is arbitrary: give the camera's height or a distance to have metres")
    elif scale_is_known and earth is None:
        said.append("scale is from the calibration of the rig")
    return Placed(scene, up, earth, unit, tuple(said))


def camera_height(scene: Scene, component: int = 0) -> float:
    """Height of the camera above the ground, in the scene's unit: the lowest layer that many steep rays end on.

    Parameters
    ----------
    scene
        With z up, and its observations.
    component
        Which part.

    Raises
    ------
    InputError
        Where too few points below the cameras are seen.
    """
    if scene.tracks is None:
        raise InputError("the scene holds no observations, expected some to find the ground by")
    view, track = scene.tracks.view[scene.inlier], scene.tracks.track[scene.inlier]
    own = (scene.view_component[view] == component) & (scene.track_component[track] == component)
    ray = scene.points[track[own]] - scene.centers[view[own]]
    below = -ray[:, 2]
    steep = below > np.sin(_STEEP_RAD) * np.linalg.norm(ray, axis=1)
    height = below[steep]
    if len(height) < _FEWEST_GROUND:
        raise InputError(
            f"camera height: {len(height)} points are seen steeply below the cameras, expected at least "
            f"{_FEWEST_GROUND}; give the distance of two views in its place"
        )
    bins = np.floor(np.log(height) / np.log(_HEIGHT_BIN)).astype(np.int64)
    level, count = np.unique(bins, return_counts=True)
    # a layer is a bin with its neighbours, since its middle may lie on an edge
    layer = np.array([count[np.abs(level - one) <= 1].sum() for one in level.tolist()])
    lowest = int(level[layer >= _LAYER_SHARE * layer.max()].max())
    around = [int(one) for one in level if abs(int(one) - lowest) <= 2]
    fullest = max(around, key=lambda one: (int(layer[level == one][0]), one))
    return float(np.median(height[np.abs(bins - fullest) <= 1]))


def gravity_of(headers: Sequence[ImageHeader]) -> Float:
    """(n, 3) upward verticals in panoramas by the tags of their poses (GPano), NaN where there are none."""
    up: Float = np.full((len(headers), 3), np.nan)
    for row, header in zip(up, headers, strict=True):
        if header.pose_deg is not None:
            _, pitch, roll = np.radians(header.pose_deg)
            # pitch lifts the middle above the horizon; with roll the horizon turns counterclockwise
            row[:] = (-np.sin(roll) * np.cos(pitch), -np.cos(roll) * np.cos(pitch), np.sin(pitch))
    return up


def _sized(scene: Scene, scale: float) -> Scene:
    return moved_scene(scene, scale=scale)


def picture_named(labels: Sequence[str], name: str) -> int:
    """Find the end of a baseline among the names of pictures; endings may be left out.

    Raises
    ------
    InputError
        Where there is none of this name.
    """
    labels = list(labels)
    if name in labels:
        return labels.index(name)
    # an image of a folder may be called without its ending, a frame of a video by its number
    stems = [label.rsplit(".", 1)[0] for label in labels]
    if name in stems:
        return stems.index(name)
    some = ", ".join(labels[:2])
    raise InputError(f"baseline: there is no picture {name!r} among those used, expected a name such as {some}")


def with_times(scene: Scene, time_s: Float) -> Scene:
    """Tell a scene when its views were taken, where that is known."""
    if scene.tracks is None or not np.isfinite(time_s).any():
        return scene
    return replace(scene, tracks=replace(scene.tracks, time_s=np.array(time_s), view_names=scene.view_names))
