"""Colours of points: the mean of what the pictures show where the point was seen (extra ``images``)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.colmap import equirectangular_pixels
from panopath.images import ImageSource, Picture, check_panorama
from panopath.model import Float, Scene

#: What a point is painted that no picture shows.
_GREY = 128


class ColourSum:
    """Adds the colours of the points up, picture by picture; holds two arrays of the length of the points."""

    def __init__(self, scene: Scene) -> None:
        if scene.tracks is None or scene.d != 3:
            raise InputError("colours need a scene in space that knows its tracks")
        self._scene, self._tracks = scene, scene.tracks
        # by view: begin[v] : begin[v + 1] are the observations of view v
        self._order = np.argsort(scene.tracks.view, kind="stable")
        self._begin = np.searchsorted(scene.tracks.view[self._order], np.arange(scene.tracks.n_views + 1))
        self._sum = np.zeros((scene.tracks.n_tracks, 3))
        self._count = np.zeros(scene.tracks.n_tracks, dtype=np.int64)

    def observations(self, view: int) -> npt.NDArray[np.intp]:
        """Observations that a view made and that were used to the end."""
        rows = self._order[self._begin[view] : self._begin[view + 1]]
        return np.asarray(rows[self._scene.inlier[rows]])

    def add(self, view: int, picture: Picture) -> None:
        """Count one picture in."""
        rows = self.observations(view)
        tracks = self._tracks.track[rows]
        np.add.at(self._sum, tracks, sampled(picture, self._tracks.bearing[rows]))
        np.add.at(self._count, tracks, 1)

    def colours(self) -> npt.NDArray[np.uint8]:
        """(n_tracks, 3) mean colours so far; grey where there are none."""
        mean = self._sum / np.maximum(self._count, 1)[:, None]
        return np.where(self._count[:, None] > 0, mean.round(), _GREY).astype(np.uint8)


def point_colours(scene: Scene, images: ImageSource) -> npt.NDArray[np.uint8]:
    """Colours of all points from the panoramas of the views, one picture in memory at a time.

    Parameters
    ----------
    scene
        In space, with its tracks.
    images
        Gives the panorama of a view, None where there is none.

    Returns
    -------
    array
        (n_tracks, 3) uint8 red, green, blue; grey where no picture shows the point.

    Raises
    ------
    InputError
        Where a picture is not a panorama.
    """
    total = ColourSum(scene)
    for view in range(len(scene.centers)):
        if len(total.observations(view)):
            picture = images(view)
            if picture is not None:
                total.add(view, check_panorama(picture, scene.view_labels()[view]))
    return total.colours()


def sampled(picture: Picture, bearing: Float) -> Float:
    """(n, 3) colours of a panorama along bearings, bilinear; columns wrap round, rows end at the poles."""
    height, width = picture.shape[:2]
    pixel = equirectangular_pixels(bearing, width, height) - 0.5
    low = np.floor(pixel)
    share = pixel - low
    x0, y0 = low.astype(np.int64).T
    total = np.zeros((len(bearing), 3))
    for dx in (0, 1):
        for dy in (0, 1):
            weight = np.abs(1 - dx - share[:, 0]) * np.abs(1 - dy - share[:, 1])
            total += weight[:, None] * picture[np.clip(y0 + dy, 0, height - 1), (x0 + dx) % width]
    return total
