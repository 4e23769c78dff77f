"""Real pedestrians seen by a simulated observer who moves among them: bearings in the plane, with exact truth.

The paths are those of the ETH and UCY sets (Pellegrini et al. 2009, Lerner et al. 2007), outside the project in
``../shared/data``. The observer goes round the place and sways as he goes: a path of a form that he moves in himself
could not be told from other such paths. Landmarks at rest, whose places are known, stand about.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import panopath as pp
from panopath.model import Bool, Float
from panopath.paths import PathModel, path_functions

#: Seconds from one number of a frame to the next: frames 10 apart are 0.4 s apart.
FRAME_S = 0.04
N_LANDMARKS = 12
NOISE_RAD = float(np.radians(0.2))
#: Whoever is seen less often is left out: a cubic path takes 8 bearings in the plane.
FEWEST_SIGHTINGS = 10
#: Longest piece of a spline.
PIECE_S = 4.0
#: Files, with the first of their frames that are filmed, by index.
PLACES = {"biwi_eth": 651, "crowds_zara01": 501, "students001": 151}
N_FRAMES = 150

MODELS = ("taylor:1", "taylor:2", "taylor:3", "fourier:2", "spline", "auto")


@dataclass(frozen=True, eq=False)
class Crowd:
    """What the observer measured, and the truth."""

    #: World directions in the plane; landmarks come first.
    tracks: pp.Tracks
    #: (n_views, 2) where the observer stood, metres.
    centers: Float
    #: (N_LANDMARKS, 2)
    landmarks: Float
    #: (N, 2) where the sighted thing was.
    position: Float

    @property
    def pedestrians(self) -> range:
        """Tracks that are people."""
        return range(N_LANDMARKS, self.tracks.n_tracks)

    def seen(self, track: int) -> tuple[Float, Float]:
        """Find the times and the true positions of the sightings of a track."""
        assert self.tracks.time_s is not None
        mine = self.tracks.track == track
        return self.tracks.time_s[self.tracks.view[mine]], self.position[mine]


def read_crowd(path: Path, first: int, n_frames: int = N_FRAMES, seed: int = 0) -> Crowd:
    """Film some frames of a file: rows of frame, person, x and y in metres."""
    rows = np.loadtxt(path)
    frames = np.unique(rows[:, 0])[first : first + n_frames]
    rows = rows[np.isin(rows[:, 0], frames)]
    people, index, count = np.unique(rows[:, 1], return_inverse=True, return_counts=True)
    rows = rows[count[index] >= FEWEST_SIGHTINGS]
    people = np.unique(rows[:, 1])
    time_s = (frames - frames[0]) * FRAME_S
    place = np.stack((rows[:, 2:].min(axis=0), rows[:, 2:].max(axis=0)))
    centers = observer(time_s, place)
    landmarks = around(place, N_LANDMARKS)

    view = np.concatenate((np.repeat(np.arange(len(frames)), N_LANDMARKS), np.searchsorted(frames, rows[:, 0])))
    track = np.concatenate(
        (np.tile(np.arange(N_LANDMARKS), len(frames)), N_LANDMARKS + np.searchsorted(people, rows[:, 1]))
    )
    position = np.concatenate((np.tile(landmarks, (len(frames), 1)), rows[:, 2:]))
    ray = position - centers[view]
    angle = np.arctan2(ray[:, 1], ray[:, 0])
    angle += NOISE_RAD * np.random.default_rng(seed).normal(size=len(angle))
    names = [*(f"landmark {k + 1}" for k in range(N_LANDMARKS)), *(f"person {one:g}" for one in people)]
    tracks = pp.Tracks.from_arrays(
        view, track, np.stack((np.cos(angle), np.sin(angle)), axis=1), time_s=time_s, track_names=names
    )
    return Crowd(tracks, centers, landmarks, position)


def observer(time_s: Float, place: Float) -> Float:
    """Round the middle of the place in 20 s, swaying in and out every 4 s and a little every 2.7 s: about 1.6 m/s."""
    turn, sway = 2.0 * np.pi * time_s / 20.0, 2.0 * np.pi * time_s
    reach = 1.0 + 0.2 * np.cos(sway / 4.0) + 0.1 * np.sin(sway / 2.7)
    half = np.minimum(0.3 * (place[1] - place[0]), (4.5, 3.5))
    return np.asarray(place.mean(axis=0) + half * reach[:, None] * np.stack((np.cos(turn), np.sin(turn)), axis=1))


def around(place: Float, n: int) -> Float:
    """Places on an ellipse about a place."""
    angle = 2.0 * np.pi * (np.arange(n) + 0.3) / n
    half = 0.75 * (place[1] - place[0])
    return np.asarray(place.mean(axis=0) + half * np.stack((np.cos(angle), np.sin(angle)), axis=1))


def form_of(model: str, time_s: Float) -> PathModel | Literal["auto"]:
    """Give a path seen at these times the form of a model's name."""
    first, last = float(time_s[0]), float(time_s[-1])
    kind, _, order = model.partition(":")
    if kind == "taylor":
        return pp.Taylor(int(order), 0.5 * (first + last), 0.5 * (last - first))
    if kind == "fourier":
        # half a period: what begins in one place need not end there
        return pp.Fourier(int(order), np.pi / (last - first))
    if kind == "spline":
        pieces = max(1, round((last - first) / PIECE_S))
        return pp.Spline(tuple(np.linspace(first, last, pieces + 1).tolist()))
    return "auto"


@dataclass(frozen=True, eq=False)
class Found:
    """How far the paths of a solved crowd are off, metres."""

    #: Rms error of each pedestrian over his sightings; NaN where his path was refused.
    error_m: Float
    #: The same of the best path of this form, fitted to the true positions; NaN where forms were chosen.
    misfit_m: Float
    #: Predicted deviation, of the bearings' noise alone; NaN where there is none.
    predicted_m: Float
    camera_rms_m: float
    #: Pedestrians said to stand.
    standing: Bool


def solve_crowd(crowd: Crowd, model: str) -> Found:
    """Solve a crowd by one model of paths, and compare with the truth."""
    forms: dict[str | int, PathModel | Literal["auto"]] = {
        track: form_of(model, crowd.seen(track)[0]) for track in crowd.pedestrians
    }
    control = pp.Control(points={k: row.tolist() for k, row in enumerate(crowd.landmarks)}, rotation=False)
    scene = pp.solve_positions(
        crowd.tracks,
        options=pp.PositionOptions(gauge="control", control=control),
        motion=pp.Motion(tracks=forms, static=tuple(range(N_LANDMARKS))),
    )
    paths = scene.paths
    assert paths is not None
    error, misfit, predicted = (np.full(len(crowd.pedestrians), np.nan) for _ in range(3))
    for k, track in enumerate(crowd.pedestrians):
        time_s, truth = crowd.seen(track)
        error[k] = rms(paths.position(track, time_s, outside=True) - truth)
        form = forms[track]
        if form != "auto":
            functions = path_functions(form, time_s)
            misfit[k] = rms(truth - functions @ np.linalg.lstsq(functions, truth, rcond=None)[0])
        if paths.covariances is not None:
            covariance = paths.position_covariance(track, time_s)
            predicted[k] = np.sqrt(np.trace(covariance, axis1=1, axis2=2).mean())
    standing = np.array([paths.verdicts[track] is pp.PathVerdict.STATIC for track in crowd.pedestrians])
    return Found(error, misfit, predicted, rms(scene.centers - crowd.centers), standing)


def rms(vectors: Float) -> float:
    """Root of the mean squared length."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
