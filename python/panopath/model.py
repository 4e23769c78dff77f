"""The records that flow between the steps: frozen values of flat arrays, checked when they are made.

Conventions (``CONVENTIONS.md``): ``d`` is 2 in the plane and 3 in space; ``cam_from_world`` maps world directions to
camera directions; a centre is a position in the world; angles are radians.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float64]
Int = npt.NDArray[np.int32]
Bool = npt.NDArray[np.bool_]


class PanopathError(Exception):
    """Root of every error panopath raises on purpose; its text is one clear line."""


class InputError(PanopathError, ValueError):
    """The input cannot be used; the text names the file, line or argument and what was expected."""


class Status(str, Enum):
    """How a solver ended. A status is an answer, not an exception."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "max_iterations"
    #: The geometry leaves freedoms beyond the gauge (or so nearly that noise cannot tell).
    AMBIGUOUS = "ambiguous"
    #: Solved, but in more than one part, each with a scale of its own.
    DISCONNECTED = "disconnected"
    #: No part of the input determines anything.
    UNDETERMINED = "undetermined"
