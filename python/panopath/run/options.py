"""What a caller of :func:`panopath.reconstruct` may choose; the defaults need no thought."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from panopath.errors import InputError
from panopath.formats.crops import CropOptions
from panopath.frontend import FrontEndOptions
from panopath.mapping import MapOptions
from panopath.steps import CertifyOptions


@dataclass(frozen=True)
class RunOptions:
    """Choices of :func:`panopath.reconstruct`."""

    #: Calibration of a rig (COLMAP's JSON), where it is not beside its pictures.
    rig: Path | None = None
    #: A mask for all pictures, or a folder of masks named like them: nothing is measured where they are black.
    masks: Path | None = None
    #: Whether the camera keeps its direction in the world, as stabilised footage may; None: find out.
    direction_locked: bool | None = None
    #: Whether the horizon was levelled in the footage: the picture's up is the world's, to
    #: ``mapping.gravity_sigma_rad``.
    horizon_locked: bool = False
    #: Whether places that pictures know give scale, heading and place.
    use_gps: bool = True
    #: Height of the camera above the ground, metres: gives the scale.
    camera_height_m: float | None = None
    #: Names of two pictures and their distance in metres: gives the scale.
    baseline: tuple[str, str, float] | None = None
    #: Write the keyframes of a video.
    keep_images: bool = True
    #: Crops for programs that know pinholes only; None: none are cut.
    crops: CropOptions | None = None
    #: Quality of the keyframes' JPEG.
    jpeg_quality: int = 95
    front_end: FrontEndOptions = field(default_factory=FrontEndOptions)
    mapping: MapOptions = field(default_factory=MapOptions)
    certify: CertifyOptions = field(default_factory=lambda: CertifyOptions(orientation="free"))

    def __post_init__(self) -> None:
        if self.camera_height_m is not None and not (np.isfinite(self.camera_height_m) and self.camera_height_m > 0.0):
            raise InputError(f"camera_height_m is {self.camera_height_m!r}, expected a positive number of metres")
        if self.baseline is not None:
            if len(self.baseline) != 3:
                raise InputError(f"baseline is {self.baseline!r}, expected two names and metres")
            if self.baseline[0] == self.baseline[1]:
                raise InputError(f"baseline is from {self.baseline[0]!r} to itself, expected two pictures")
            if not (np.isfinite(self.baseline[2]) and self.baseline[2] > 0.0):
                raise InputError(f"baseline is {self.baseline[2]!r} metres, expected a positive number")
            if self.camera_height_m is not None:
                raise InputError("camera_height_m and baseline both give the scale, expected one of them")
        if not 1 <= self.jpeg_quality <= 100:
            raise InputError(f"jpeg_quality is {self.jpeg_quality!r}, expected 1 to 100")
        if self.crops is not None and not self.keep_images:
            raise InputError("crops are cut from kept images, expected keep_images with them")
