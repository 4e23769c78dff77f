"""Readers of measured planar sets: Roh's beacons, UTIAS MRCLAM, Victoria Park. Positions in metres, angles in radians.

Bearings are relative to the heading, anticlockwise; a heading is the angle of the sensor's axis in the world.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from panopath.model import Float, Int

from benchmarks.optional import load

#: Roh's sensor looked along the world's y axis at every station.
ROH_HEADING_RAD = np.pi / 2


@dataclass(frozen=True)
class PlanarSet:
    """Stations with known heading that saw landmarks, with the truth."""

    name: str
    #: Indices of station and landmark of each bearing, (N,) int32.
    station: Int
    landmark: Int
    bearing_rad: Float
    #: (n_stations,)
    heading_rad: Float
    #: (n_stations, 2) and (n_landmarks, 2) true positions.
    stations: Float
    landmarks: Float


@dataclass(frozen=True)
class RohSet:
    """Six stations, four beacons, 200 repeats."""

    #: (6, 2) and (4, 2)
    stations: Float
    beacons: Float
    #: (6, repeats, 4)
    bearing_rad: Float

    def mean(self) -> PlanarSet:
        """Average the repeats of each bearing on the circle."""
        bearing = np.angle(np.exp(1j * self.bearing_rad).mean(axis=1))
        return self._planar("mean of all repeats", bearing)

    def shot(self, repeat: int) -> PlanarSet:
        """Take one repeat at every station."""
        return self._planar(f"repeat {repeat}", self.bearing_rad[:, repeat])

    @property
    def n_repeats(self) -> int:
        """Number of repeats at each station."""
        return int(self.bearing_rad.shape[1])

    def _planar(self, name: str, bearing: Float) -> PlanarSet:
        n_stations, n_beacons = bearing.shape
        return PlanarSet(
            name=name,
            station=np.repeat(np.arange(n_stations, dtype=np.int32), n_beacons),
            landmark=np.tile(np.arange(n_beacons, dtype=np.int32), n_stations),
            bearing_rad=bearing.ravel(),
            heading_rad=np.full(n_stations, ROH_HEADING_RAD),
            stations=self.stations,
            landmarks=self.beacons,
        )


def read_roh(folder: Path) -> RohSet:
    """Read the files ``(Xx,Yy).csv``, one a station and named by its position, and ``landmark.csv``."""
    beacons = np.loadtxt(folder / "landmark.csv", delimiter=",")
    stations, bearings = [], []
    for path in sorted(folder.glob("(X*,Y*).csv")):
        found = re.fullmatch(r"\(X([\d.]+),Y([\d.]+)\)\.csv", path.name)
        if found is None:
            raise ValueError(f"{path}: expected a name like (X1.5,Y3.0).csv")
        stations.append([float(found[1]), float(found[2])])
        bearings.append(np.radians(np.loadtxt(path, delimiter=",")))
    return RohSet(np.array(stations), beacons, np.stack(bearings))


def read_mrclam(path: Path) -> PlanarSet:
    """Read one MRCLAM log: a station wherever the camera saw something new.

    The file repeats a camera reading at 50 Hz until the next one comes: of rows of stations with equal readings only
    the first is a measurement. Landmarks that were never seen are left out.
    """
    content = load("scipy.io").loadmat(path)
    landmark, truth, measured = content["landmark"], content["groundtruth"], content["measurement"]
    order = np.argsort(measured[:, 0], kind="stable")
    measured = measured[order]
    first = np.searchsorted(measured[:, 0], truth[:, 0])
    last = np.searchsorted(measured[:, 0], truth[:, 0], side="right")
    fresh = [0]
    for k in range(1, len(truth)):
        if not np.array_equal(measured[first[k] : last[k], 1:], measured[first[k - 1] : last[k - 1], 1:]):
            fresh.append(k)
    count = last[fresh] - first[fresh]
    rows = np.concatenate([np.arange(first[k], last[k]) for k in fresh])
    seen, index = np.unique(measured[rows, 1], return_inverse=True)
    position = {int(row[0]): row[1:3] for row in landmark}
    return PlanarSet(
        name=path.stem,
        station=np.repeat(np.arange(len(fresh), dtype=np.int32), count),
        landmark=index.astype(np.int32),
        bearing_rad=measured[rows, 3].copy(),
        heading_rad=truth[fresh, 3].copy(),
        stations=truth[fresh, 1:3].copy(),
        landmarks=np.array([position[int(name)] for name in seen]),
    )


@dataclass(frozen=True)
class VictoriaPark:
    """A drive through a park: odometry from pose to pose, and trees seen by a laser scanner."""

    #: (n_poses - 1, 3) motion from each pose to the next in its frame: forward, left (m), turn (rad).
    odometry: Float
    #: (n_poses - 1, 3) standard deviations of these.
    odometry_sigma: Float
    #: Pose and tree of each sighting, (N,) int32.
    pose: Int
    tree: Int
    #: (N, 2) forward and left, metres.
    offset_m: Float

    def dead_reckoning(self) -> Float:
        """Chain the odometry from pose (0, 0, 0): (n_poses, 3) x, y, heading."""
        heading = np.concatenate([[0.0], np.cumsum(self.odometry[:, 2])])
        step = turn(self.odometry[:, :2], heading[:-1])
        return np.column_stack([np.vstack([[0.0, 0.0], np.cumsum(step, axis=0)]), heading])

    @property
    def n_trees(self) -> int:
        """Number of trees."""
        return int(self.tree.max()) + 1


def read_victoria_park(path: Path) -> VictoriaPark:
    """Read the GTSAM form: ``ODOMETRY i j dx dy dtheta`` and ``LANDMARK pose tree dx dy``, one numbering for both.

    The six numbers after a motion are the upper half of its covariance (xx, xy, xt, yy, yt, tt).
    """
    motions, sightings = [], []
    for number, line in enumerate(path.read_text(encoding="ascii").splitlines(), start=1):
        words = line.split()
        if words[0] == "ODOMETRY" and len(words) == 12:
            motions.append([float(word) for word in words[1:]])
        elif words[0] == "LANDMARK" and len(words) == 8:
            sightings.append([float(word) for word in words[1:5]])
        else:
            raise ValueError(f"{path}, line {number}: expected ODOMETRY or LANDMARK, found {line[:40]!r}")
    motion, sighting = np.array(motions), np.array(sightings)
    if not np.array_equal(motion[1:, 0], motion[:-1, 1]):
        raise ValueError(f"{path}: expected odometry from each pose to the next")
    keys = np.append(motion[0, 0], motion[:, 1])
    pose = np.searchsorted(keys, sighting[:, 0])
    if not np.array_equal(keys[pose], sighting[:, 0]):
        raise ValueError(f"{path}: a tree was seen from a pose without odometry")
    _, tree = np.unique(sighting[:, 1], return_inverse=True)
    return VictoriaPark(
        odometry=motion[:, 2:5],
        odometry_sigma=_sigmas(motion[:, 5:11]),
        pose=pose.astype(np.int32),
        tree=tree.astype(np.int32),
        offset_m=sighting[:, 2:4],
    )


def _sigmas(upper: Float) -> Float:
    return np.asarray(np.sqrt(upper[:, [0, 3, 5]]))


def turn(vectors: Float, angle_rad: Float) -> Float:
    """Turn (n, 2) vectors by (n,) angles, anticlockwise."""
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    x, y = vectors[:, 0], vectors[:, 1]
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])
