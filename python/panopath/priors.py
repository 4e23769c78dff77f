"""What is known of cameras beforehand: orientations, directions such as gravity, positions, and where sensors sit.

Every prior has a standard deviation or a covariance; a refinement weighs it against the bearings. Views are indices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.model import Float, Int, check_orientations, read_only

#: Directions count as unit vectors to within this.
_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class RotationPriors:
    """Orientations that are known beforehand, from a compass or an inertial unit. Make them with :meth:`of`."""

    #: (n,) int32.
    view: Int
    #: (n, 3, 3), or headings (n,) in radians in the plane.
    cam_from_world: Float
    #: (n, d, d) covariance of the turn, in the camera, from this orientation to the true one, rad^2. In the plane only
    #: the first entry counts.
    covariance: Float

    @classmethod
    def of(
        cls,
        view: npt.ArrayLike,
        cam_from_world: npt.ArrayLike,
        sigma_rad: npt.ArrayLike | None = None,
        covariance: npt.ArrayLike | None = None,
    ) -> RotationPriors:
        """Check and make them; give ``sigma_rad`` (one number or (n,), about every axis) or ``covariance``.

        Raises
        ------
        InputError
            Naming the argument that cannot be used.
        """
        ids = _views(view)
        d = 2 if np.ndim(cam_from_world) == 1 else 3
        rotations = check_orientations(cam_from_world, len(ids), d)
        return cls(ids, rotations, _covariances(len(ids), d, sigma_rad, covariance, "sigma_rad"))


@dataclass(frozen=True, eq=False)
class DirectionPriors:
    """Directions of the world that cameras measured: gravity, the sun. Make them with :meth:`of` or :meth:`gravity`."""

    #: (n,) int32.
    view: Int
    #: (n, d) unit vectors in the cameras.
    bearing: Float
    #: (n, d) the same directions in the world.
    direction: Float
    #: (n,) standard deviation along each tangent direction, radians.
    sigma_rad: Float

    @classmethod
    def of(
        cls, view: npt.ArrayLike, bearing: npt.ArrayLike, direction: npt.ArrayLike, sigma_rad: npt.ArrayLike
    ) -> DirectionPriors:
        """Check and make them; one ``direction`` (d,) and one ``sigma_rad`` may stand for all.

        Raises
        ------
        InputError
            Naming the argument and the first entry that is wrong.
        """
        ids = _views(view)
        bearings = _units("bearing", bearing, len(ids))
        towards = np.asarray(direction, dtype=np.float64)
        if towards.shape not in (bearings.shape, bearings.shape[1:]):
            raise InputError(
                f"direction has shape {towards.shape}, expected {bearings.shape[1:]} or {bearings.shape} as of bearing"
            )
        towards = np.broadcast_to(towards, bearings.shape)
        return cls(ids, bearings, _units("direction", towards, len(ids)), _positive("sigma_rad", sigma_rad, len(ids)))

    @classmethod
    def gravity(cls, view: npt.ArrayLike, up: npt.ArrayLike, sigma_rad: npt.ArrayLike) -> DirectionPriors:
        """Gravity: ``up`` (n, 3) is the upward vertical in each camera, which is z in the world."""
        return cls.of(view, up, (0.0, 0.0, 1.0), sigma_rad)


@dataclass(frozen=True, eq=False)
class PositionPriors:
    """Positions that are known beforehand, from satellites or a survey. Make them with :meth:`of`."""

    #: (n,) int32.
    view: Int
    #: (n, d) positions in the world.
    center: Float
    #: (n, d, d) in the unit of the positions, squared.
    covariance: Float

    @classmethod
    def of(
        cls,
        view: npt.ArrayLike,
        center: npt.ArrayLike,
        sigma: npt.ArrayLike | None = None,
        covariance: npt.ArrayLike | None = None,
    ) -> PositionPriors:
        """Check and make them; give ``sigma`` (one number or (n,), along every axis) or ``covariance``.

        Raises
        ------
        InputError
            Naming the argument that cannot be used.
        """
        ids = _views(view)
        centers = np.ascontiguousarray(center, dtype=np.float64)
        if centers.ndim != 2 or len(centers) != len(ids) or centers.shape[1] not in (2, 3):
            raise InputError(f"center has shape {centers.shape}, expected ({len(ids)}, 2) or ({len(ids)}, 3)")
        if not np.isfinite(centers).all():
            row = int(np.argmin(np.isfinite(centers).all(axis=1)))
            raise InputError(f"center[{row}] is not finite, expected a position")
        d = centers.shape[1]
        return cls(ids, read_only(centers), _covariances(len(ids), d, sigma, covariance, "sigma"))


@dataclass(frozen=True, eq=False)
class HeadingPriors:
    """Compass readings: the horizontal direction in which an axis of a camera points. Make them with :meth:`of`.

    In space they count where the vertical is known, by gravity or by an orientation.
    """

    #: (n,) int32.
    view: Int
    #: (n,) angles in the world, anticlockwise from x, radians.
    heading_rad: Float
    #: (n,) standard deviation, radians.
    sigma_rad: Float
    #: (n, 3) the axis in the camera: z in space (forward), x in the plane, unless said otherwise.
    forward: Float

    @classmethod
    def of(
        cls,
        view: npt.ArrayLike,
        heading_rad: npt.ArrayLike,
        sigma_rad: npt.ArrayLike,
        forward: npt.ArrayLike = (0.0, 0.0, 1.0),
    ) -> HeadingPriors:
        """Check and make them; one ``sigma_rad`` and one ``forward`` (3,) may stand for all.

        Raises
        ------
        InputError
            Naming the argument and the first entry that is wrong.
        """
        ids = _views(view)
        headings = np.array(np.asarray(heading_rad, dtype=np.float64))
        if headings.shape != ids.shape:
            raise InputError(f"heading_rad has shape {headings.shape}, expected {ids.shape}")
        if not np.isfinite(headings).all():
            raise InputError(f"heading_rad[{int(np.argmin(np.isfinite(headings)))}] is not finite, expected an angle")
        axes = np.broadcast_to(np.asarray(forward, dtype=np.float64), (len(ids), 3))
        return cls(
            ids, read_only(headings), _positive("sigma_rad", sigma_rad, len(ids)), _units("forward", axes, len(ids))
        )

    def as_rotations(self, cam_from_world: Float) -> RotationPriors:
        """Priors of orientation that say the same near the given ones: about the vertical, next to nothing about tilt.

        Parameters
        ----------
        cam_from_world
            (n_views, 3, 3) rotations, or (n_views,) headings in radians.
        """
        if cam_from_world.ndim == 1:
            return RotationPriors.of(self.view, self.heading_rad, self.sigma_rad)
        rotation = cam_from_world[self.view]
        ahead = np.einsum("nji,nj->ni", rotation, self.forward)
        turn = self.heading_rad - np.arctan2(ahead[:, 1], ahead[:, 0])
        cos, sin, zero, one = np.cos(turn), np.sin(turn), np.zeros_like(turn), np.ones_like(turn)
        # cameras turn by `turn` about z: cam_from_world Rz(-turn)
        about_z = np.stack((cos, sin, zero, -sin, cos, zero, zero, zero, one), axis=1).reshape(-1, 3, 3)
        up = rotation[:, :, 2]
        vertical = up[:, :, None] * up[:, None, :]
        covariance = self.sigma_rad[:, None, None] ** 2 * vertical + _NO_TILT_RAD2 * (np.eye(3) - vertical)
        return RotationPriors.of(self.view, rotation @ about_z, covariance=covariance)


#: Variance of a tilt of which nothing is known, rad^2.
_NO_TILT_RAD2 = 100.0


@dataclass(frozen=True)
class Priors:
    """All that is known beforehand."""

    rotations: RotationPriors | None = None
    directions: DirectionPriors | None = None
    headings: HeadingPriors | None = None
    positions: PositionPriors | None = None

    def __post_init__(self) -> None:
        kinds = (
            ("rotations", RotationPriors),
            ("directions", DirectionPriors),
            ("headings", HeadingPriors),
            ("positions", PositionPriors),
        )
        for name, kind in kinds:
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise InputError(f"{name} is a {type(value).__name__}, expected {kind.__name__}")

    @property
    def is_empty(self) -> bool:
        """Whether nothing is known."""
        return all(prior is None for prior in (self.rotations, self.directions, self.headings, self.positions))


@dataclass(frozen=True, eq=False)
class Rig:
    """Sensors that are fixed to each view but do not look out from its centre. Make one with :meth:`of`.

    Bearings that go with a rig are in the frame of the view (the rig), not of the sensor: :meth:`to_view` turns them.
    """

    #: (N,) int32, sensor of each observation.
    sensor: Int
    #: (n_sensors, 3, 3), or (n_sensors,) angles in the plane, in the sense of headings.
    sensor_from_rig: Float
    #: (n_sensors, d) centre of each sensor in the rig.
    center: Float

    @classmethod
    def of(cls, sensor: npt.ArrayLike, sensor_from_rig: npt.ArrayLike, center: npt.ArrayLike) -> Rig:
        """Check and make one.

        Raises
        ------
        InputError
            Naming the argument that cannot be used.
        """
        ids = _views(sensor, "sensor")
        centers = np.ascontiguousarray(center, dtype=np.float64)
        if centers.ndim != 2 or centers.shape[1] not in (2, 3) or not np.isfinite(centers).all():
            raise InputError(f"center has shape {centers.shape}, expected (n_sensors, d) finite numbers")
        if len(ids) and ids.max() >= len(centers):
            raise InputError(f"sensor holds {ids.max()}, but there are {len(centers)} sensors")
        rotations = check_orientations(sensor_from_rig, len(centers), centers.shape[1])
        return cls(ids, rotations, read_only(centers))

    def to_view(self, bearing: Float) -> Float:
        """Turn (N, d) bearings in the sensors to bearings in the frame of the view."""
        if bearing.shape[1] == 2:
            angle = self.sensor_from_rig[self.sensor]
            cos, sin = np.cos(angle), np.sin(angle)
            return np.column_stack(
                [cos * bearing[:, 0] - sin * bearing[:, 1], sin * bearing[:, 0] + cos * bearing[:, 1]]
            )
        return np.asarray(np.einsum("nkc,nk->nc", self.sensor_from_rig[self.sensor], bearing))


def _views(values: npt.ArrayLike, name: str = "view") -> Int:
    ids = np.asarray(values)
    if ids.ndim != 1 or (ids.size and not np.issubdtype(ids.dtype, np.integer)):
        raise InputError(f"{name} has type {ids.dtype} and shape {ids.shape}, expected (n,) whole numbers")
    if ids.size and ids.min() < 0:
        raise InputError(f"{name} holds {ids.min()}, expected 0 or more")
    if ids.size and ids.max() > np.iinfo(np.int32).max:
        raise InputError(f"{name} holds {ids.max()}, expected at most {np.iinfo(np.int32).max}")
    return read_only(np.ascontiguousarray(ids, dtype=np.int32))


def _units(name: str, values: npt.ArrayLike, n: int) -> Float:
    vectors = np.ascontiguousarray(values, dtype=np.float64)
    if vectors.ndim != 2 or len(vectors) != n or vectors.shape[1] not in (2, 3):
        raise InputError(f"{name} has shape {vectors.shape}, expected ({n}, 2) or ({n}, 3)")
    wrong = ~(np.abs(np.linalg.norm(vectors, axis=1) - 1.0) <= _UNIT_TOLERANCE)
    if wrong.any():
        raise InputError(f"{name}[{int(np.argmax(wrong))}] is not a unit vector")
    return read_only(vectors)


def _positive(name: str, values: npt.ArrayLike, n: int) -> Float:
    numbers = np.asarray(values, dtype=np.float64)
    if numbers.shape not in ((), (n,)):
        raise InputError(f"{name} has shape {numbers.shape}, expected one number or ({n},)")
    numbers = np.array(np.broadcast_to(numbers, (n,)))
    wrong = ~(np.isfinite(numbers) & (numbers > 0.0))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(f"{name}[{row}] is {numbers[row]}, expected a positive number")
    return read_only(numbers)


def _covariances(
    n: int, d: int, sigma: npt.ArrayLike | None, covariance: npt.ArrayLike | None, sigma_name: str
) -> Float:
    if (sigma is None) == (covariance is None):
        raise InputError(f"expected either {sigma_name} or covariance")
    if sigma is not None:
        variances = _positive(sigma_name, sigma, n) ** 2
        return read_only(np.ascontiguousarray(variances[:, None, None] * np.eye(d)))
    found = np.array(np.asarray(covariance, dtype=np.float64))
    if found.shape != (n, d, d):
        raise InputError(f"covariance has shape {found.shape}, expected {(n, d, d)}")
    return read_only(found)
