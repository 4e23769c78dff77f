"""Matches of a rig whose cameras stand close together: all that it sees at one moment is one picture.

Two fisheyes back to back see the whole sphere, one of them half of it, in which turning and moving look much alike and
few things are seen again when the camera turns. So the features of a moment are matched as those of one panorama, and
the matches are given to the pictures afterwards. That the rays start a few centimetres apart is less than what matching
allows; rigs that are larger are matched picture by picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from panopath.frontend.features import Features
from panopath.frontend.matching import ImageMatches, MatchingOptions, match_images
from panopath.model import Float, Int

#: Cameras of a rig at most so far from its centre are taken to stand in it, metres.
SMALL_RIG_M = 0.1


def match_moments(
    features: Sequence[Features],
    rays: Sequence[Float],
    rig: tuple[Int, Int, Float],
    pixel_rad: float,
    options: MatchingOptions,
    *,
    in_sequence: bool,
) -> ImageMatches:
    """Match pictures of a rig by what all of its cameras see.

    Parameters
    ----------
    features, rays
        Of M pictures: features, and (n, 3) bearings in their cameras.
    rig
        (M,) moments and (M,) cameras of the pictures, and (C, 3, 3) orientations of the cameras in the rig.
    pixel_rad, options, in_sequence
        See :func:`match_images`; what is in sequence are the moments.
    """
    frame, camera, sensor_from_rig = rig
    n_moments = int(frame.max()) + 1
    image, local, together, turned = [], [], [], []
    for moment in range(n_moments):
        own = np.flatnonzero(frame == moment)
        of = np.concatenate([np.full(len(features[k]), k) for k in own.tolist()])
        place = np.concatenate([np.arange(len(features[k])) for k in own.tolist()])
        # features that stand out come first, of all cameras alike
        order = np.argsort(place, kind="stable")
        image.append(of[order])
        local.append(place[order])
        together.append(
            Features(
                np.concatenate([features[k].pixels for k in own.tolist()])[order],
                np.concatenate([features[k].descriptors for k in own.tolist()])[order],
            )
        )
        turned.append(np.concatenate([rays[k] @ sensor_from_rig[camera[k]] for k in own.tolist()])[order])
    # as many leading features of each picture as where pictures are matched one by one
    leading = replace(options, leading_features=options.leading_features * len(sensor_from_rig))
    found = match_images(together, turned, pixel_rad, leading, in_sequence=in_sequence)
    return _of_pictures(found, image, local, camera, sensor_from_rig)


def _of_pictures(
    found: ImageMatches,
    image: Sequence[npt.NDArray[np.int64]],
    local: Sequence[npt.NDArray[np.int64]],
    camera: Int,
    sensor_from_rig: Float,
) -> ImageMatches:
    """Give matches of moments to the pictures that they are in."""
    start = np.concatenate(([0], np.cumsum([len(of) for of in image]))).astype(np.int64)
    row = np.repeat(np.arange(len(found.pairs)), found.counts)
    at = found.matches + start[found.pairs[row]]
    ends, within = np.concatenate(image)[at], np.concatenate(local)[at]
    backwards = ends[:, 0] > ends[:, 1]
    ends[backwards], within[backwards] = ends[backwards, ::-1], within[backwards, ::-1]
    key = ends[:, 0] * len(camera) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    first = np.unique(key[order], return_index=True)[1]
    pairs = ends[order][first]
    turn = found.second_from_first[row[order][first]]
    back = backwards[order][first]
    turn = np.where(back[:, None, None], np.swapaxes(turn, 1, 2), turn)
    a, b = (sensor_from_rig[camera[pairs[:, side]]] for side in (0, 1))
    return ImageMatches(
        pairs=pairs.astype(np.int32),
        starts=np.append(first, len(order)).astype(np.int64),
        matches=within[order].astype(np.int32),
        second_from_first=b @ turn @ np.swapaxes(a, 1, 2),
        n_tried=found.n_tried,
    )
