"""Paths of bodies that move: as plain arrays that come back exactly, in few words, and as a table for people.

A path has a few numbers, and a scene may have ten thousands of paths; so the numbers stand in ``scene.npz``, flat, and
``scene.json`` says in words what was found. ``paths.csv`` is worked out from them, at the times of the views.
"""

from __future__ import annotations

import json
from collections import Counter
from itertools import repeat
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.csv import quoted, table_bytes
from panopath.model import Float, Scene
from panopath.movers import form_text, left_out, samples_at_views
from panopath.paths import Paths, PathVerdict, core_model, model_of

_FORMS = ("static", "taylor", "fourier", "spline")


def path_arrays(paths: Paths) -> dict[str, npt.NDArray[Any]]:
    """All of the paths as named arrays without objects.

    Raises
    ------
    InputError
        Where a covariance is not one of the coefficients of its track.
    """
    forms = [core_model(one) for one in paths.models]
    verdicts = tuple(PathVerdict)
    words = {
        "forms": _FORMS,
        "verdicts": [one.value for one in verdicts],
        "assumption": paths.assumption,
        "freedoms": paths.freedoms,
    }
    arrays: dict[str, npt.NDArray[Any]] = {
        "paths_words": np.frombuffer(json.dumps(words).encode("utf-8"), dtype=np.uint8),
        "paths_form": np.array([_FORMS.index(name) for name, _, _ in forms], dtype=np.uint8),
        "paths_order": np.array([order for _, order, _ in forms], dtype=np.int32),
        "paths_number_starts": np.cumsum([0, *(len(numbers) for _, _, numbers in forms)], dtype=np.int64),
        "paths_numbers": np.array([number for _, _, numbers in forms for number in numbers], dtype=np.float64),
        "paths_coefficients": paths.coefficients,
        "paths_seen_s": paths.seen_s,
        "paths_verdict": np.array([verdicts.index(one) for one in paths.verdicts], dtype=np.uint8),
        "paths_hidden_by": paths.hidden_by,
        "paths_body": paths.body,
    }
    if paths.covariances is not None:
        sizes = (paths.d * np.diff(paths.starts)).tolist()
        for track, (size, found) in enumerate(zip(sizes, paths.covariances, strict=True)):
            if found.shape != (size, size):
                raise InputError(f"covariances[{track}] has shape {found.shape}, expected {(size, size)}")
        flat = [np.empty(0), *(np.ravel(one) for one in paths.covariances)]
        arrays["paths_covariances"] = np.concatenate(flat)
    return arrays


def paths_of_arrays(arrays: dict[str, Any]) -> Paths | None:
    """Make paths again of their arrays; None where a scene has none, as those of older files.

    Raises
    ------
    LookupError, ValueError
        Where arrays are absent, or do not go together.
    """
    if "paths_words" not in arrays:
        return None
    words = json.loads(arrays["paths_words"].tobytes())
    numbers = np.split(arrays["paths_numbers"], arrays["paths_number_starts"][1:-1])
    kinds = zip(arrays["paths_form"].tolist(), arrays["paths_order"].tolist(), numbers, strict=False)
    models = tuple(model_of(words["forms"][form], order, found.tolist()) for form, order, found in kinds)
    starts = np.cumsum([0, *(one.n_functions for one in models)], dtype=np.int64)
    coefficients = arrays["paths_coefficients"]
    covariances = None
    if "paths_covariances" in arrays:
        covariances = _blocks(arrays["paths_covariances"], (coefficients.shape[1] * np.diff(starts)).tolist())
    return Paths(
        models=models,
        starts=starts,
        coefficients=coefficients,
        covariances=covariances,
        seen_s=arrays["paths_seen_s"],
        verdicts=tuple(PathVerdict(words["verdicts"][code]) for code in arrays["paths_verdict"].tolist()),
        hidden_by=arrays["paths_hidden_by"],
        body=arrays["paths_body"],
        assumption=str(words["assumption"]),
        freedoms=tuple(map(str, words["freedoms"])),
    )


def _blocks(flat: Float, sizes: list[int]) -> tuple[Float, ...]:
    """Square matrices of these sizes, one after the other."""
    ends = np.cumsum([0, *(size * size for size in sizes)])
    if ends[-1] != len(flat):
        raise ValueError(f"paths_covariances has {len(flat)} numbers, expected {ends[-1]}")
    blocks = []
    for begin, end, size in zip(ends[:-1].tolist(), ends[1:].tolist(), sizes, strict=True):
        block = flat[begin:end].reshape(size, size)
        block.setflags(write=False)
        blocks.append(block)
    return tuple(blocks)


def paths_dict(scene: Scene) -> dict[str, Any] | None:
    """Say what ``scene.json`` says of the paths: plain values, a few lines whatever their number."""
    paths = scene.paths
    if paths is None:
        return None
    count = Counter(one.value for one in paths.verdicts)
    forms = Counter(form_text(paths.models[track]) for track in np.flatnonzero(paths.moving).tolist())
    return {
        "verdicts": {one.value: count[one.value] for one in PathVerdict},
        "forms": dict(sorted(forms.items())),
        "bodies": len(np.unique(paths.body[paths.body >= 0])),
        "covariances": paths.covariances is not None,
        "not_among_points": left_out(scene),
        "assumption": paths.assumption,
        "freedoms": list(paths.freedoms),
    }


def paths_csv(scene: Scene) -> bytes:
    """Write a table with a row a moving track and time of a view, while it was seen.

    Digits beyond the ninth are left out, those of velocities beyond the sixth, of deviations beyond the fourth: the
    table is for people, and ``scene.npz`` holds the paths themselves.
    """
    samples, axes = samples_at_views(scene), "xyz"[: scene.d]
    header = ["time_s", "track", "body", *axes, *(f"v{axis}" for axis in axes), *(f"s{axis}" for axis in axes)]
    if scene.paths is None or not len(samples.track):
        return table_bytes(header, ())
    names = quoted(scene.track_labels())
    tracks = samples.track.tolist()
    bodies = scene.paths.body[samples.track].tolist()
    cells: list[Any] = [map(repr, samples.time_s.tolist()), [names[track] for track in tracks], map(str, bodies)]
    for values, digits in ((samples.position, 9), (samples.velocity, 6), (samples.deviation, 4)):
        texts = _texts(values.ravel(), digits)
        cells += [texts[axis :: scene.d] for axis in range(scene.d)]
    return table_bytes(header, zip(*cells, strict=True))


def _texts(values: Float, digits: int) -> list[str]:
    """Numbers of so many digits, empty where not known; what is rounding of nothing is nothing, without a minus."""
    least = 1e-13 * np.nanmax(np.abs(values), initial=0.0)
    texts = map(format, np.where(np.abs(values) <= least, 0.0, values).tolist(), repeat(f".{digits}g"))
    return ["" if text == "nan" else text for text in texts]
