"""Which pairs of views to orient against each other, and what they see in common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.errors import InputError
from panopath.model import Int, Tracks, read_only
from panopath.steps.common import call_core, observations_of


@dataclass(frozen=True)
class ViewGraphOptions:
    """Choices of :func:`view_pairs`."""

    #: Tracks that two views must share.
    min_shared: int = 12
    #: Partners kept for each view: half of them those with which it shares most, half spread over the others.
    max_partners: int = 12
    #: Most matches of a pair; more are thinned evenly.
    max_matches: int = 400

    def __post_init__(self) -> None:
        for name, value in self.__dict__.items():
            if not isinstance(value, int) or value < 1:
                raise InputError(f"{name} is {value!r}, expected a whole number of at least 1")


@dataclass(frozen=True, eq=False)
class ViewPairs:
    """Pairs of views with their matches."""

    #: (n_pairs, 2) int32, the smaller view first, ascending.
    pair: Int
    #: (n_pairs + 1,) int64: the matches of pair ``p`` are rows ``start[p]`` to ``start[p + 1]``.
    start: npt.NDArray[np.int64]
    #: (n_matches, 2) int32, observations of the same track by the first and by the second view.
    observation: Int

    def __len__(self) -> int:
        return len(self.pair)


def view_pairs(tracks: Tracks, options: ViewGraphOptions | None = None) -> ViewPairs:
    """List pairs of views that share enough tracks, a bounded number for each view.

    Parameters
    ----------
    tracks
        The observations, in space.
    options
        Choices; default ``ViewGraphOptions()``.

    Raises
    ------
    InputError
        For tracks in the plane, where two views tell nothing of each other.
    """
    chosen = ViewGraphOptions() if options is None else options
    if tracks.d != 3:
        raise InputError("tracks are planar, where two views tell nothing of each other, expected d = 3")
    pair, start, observation = call_core(
        _core.view_pairs,
        observations_of(tracks),
        chosen.min_shared,
        chosen.max_partners,
        chosen.max_matches,
    )
    return ViewPairs(read_only(pair), read_only(start), read_only(observation))
