"""What the front end leaves in checkpoints, and how it comes back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from panopath.checkpoints import Arrays, Checkpoints, key_of, key_of_file
from panopath.frontend.features import Features
from panopath.frontend.fixed import FixedContent
from panopath.frontend.images import image_files
from panopath.frontend.matching import ImageMatches
from panopath.frontend.sources import Source
from panopath.frontend.video import VideoKind, VideoMotion


@dataclass(frozen=True, eq=False)
class Looked:
    """What stays of a picture."""

    name: str
    time_s: float
    features: Features


@dataclass(frozen=True, eq=False)
class Store:
    """Checkpoints, or none, and the key of what is read and written now."""

    checkpoints: Checkpoints | None
    key: str

    def read(self, name: str) -> Arrays | None:
        """Give what is there under a name."""
        return None if self.checkpoints is None else self.checkpoints.read(name, self.key)

    def write(self, name: str, arrays: dict[str, Any]) -> None:
        """Leave something under a name."""
        if self.checkpoints is not None:
            self.checkpoints.write(name, self.key, arrays)

    def look(self, k: int) -> Looked | None:
        """Give what an earlier run has found in picture ``k``."""
        arrays = self.read(_picture(k))
        if arrays is None:
            return None
        features = Features(arrays["pixels"], arrays["descriptors"], arrays.get("color"))
        return Looked(str(arrays["name"]), float(arrays["time_s"]), features)

    def leave_look(self, k: int, looked: Looked) -> None:
        """Leave what was found in picture ``k``."""
        if self.checkpoints is not None:
            self.write(_picture(k), _arrays(looked.features) | {"name": looked.name, "time_s": looked.time_s})

    def motion(self, make: Callable[[], VideoMotion]) -> VideoMotion:
        """Give the motion of a video, made where it is not there."""
        arrays: dict[str, Any] | None = self.read("motion")
        if arrays is None:
            motion = make()
            self.write("motion", _arrays(motion))
            return motion
        return VideoMotion(**arrays | {"n_corrupt": int(arrays["n_corrupt"]), "kind": VideoKind(str(arrays["kind"]))})

    def fixed(self, make: Callable[[], tuple[FixedContent, ...]]) -> tuple[FixedContent, ...]:
        """Give what goes with each camera, found where it is not there."""
        arrays: dict[str, Any] | None = self.read("fixed")
        if arrays is None:
            found = make()
            every = [_arrays(content) for content in found]
            self.write("fixed", {name: np.stack([one[name] for one in every]) for name in every[0]})
            return found
        return tuple(
            FixedContent(
                cell_rad=float(arrays["cell_rad"][k]),
                is_fixed=arrays["is_fixed"][k],
                n_tried=arrays["n_tried"][k],
                n_stayed=arrays["n_stayed"][k],
                share=float(arrays["share"][k]),
                refused_share=float(arrays["refused_share"][k]),
            )
            for k in range(len(arrays["share"]))
        )

    def matches(self, make: Callable[[], ImageMatches]) -> ImageMatches:
        """Give the matches, made where they are not there."""
        arrays: dict[str, Any] | None = self.read("matches")
        if arrays is None:
            matches = make()
            self.write("matches", _arrays(matches))
            return matches
        return ImageMatches(**arrays | {"n_tried": int(arrays["n_tried"])})


def _picture(k: int) -> str:
    return f"features/{k:06d}"


def _arrays(record: Any) -> dict[str, Any]:
    values = {entry.name: getattr(record, entry.name) for entry in fields(record)}
    return {name: np.asarray(value) for name, value in values.items() if value is not None}


def key_of_source(source: Source) -> str:
    """Key of the files of a source, and of what is known of its cameras."""
    if source.video is not None:
        return key_of_file(source.path)
    rig = (source.cameras, source.sensor_from_rig.tolist(), source.center_in_rig.tolist())
    return key_of(source.kind.value, rig, *(key_of_file(path) for path in source.images))


def key_of_masks(masks: Path | None) -> str:
    """Key of a mask, or of a folder of them."""
    if masks is None:
        return ""
    return key_of(*(key_of_file(path) for path in ([masks] if masks.is_file() else image_files(masks))))
