"""Places on the earth: WGS84 to local axes and back, and paths as GeoJSON and GPX.

Degrees and metres on the WGS84 ellipsoid (latitude, longitude, height above it) go through geocentric coordinates, so
that nothing is approximated:

    X = (N + h) cos(lat) cos(lon),  Y = (N + h) cos(lat) sin(lon),  Z = (N (1 - e^2) + h) sin(lat),
    N = a / sqrt(1 - e^2 sin^2(lat))

and local axes east, north and up at an origin are a turn and a shift of these (IOGP Guidance Note 7-2, sections 4.1.1
and 4.1.2). GeoJSON is RFC 7946, GPX is version 1.1.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath.errors import InputError
from panopath.formats.files import read_bytes, write_bytes
from panopath.model import Float, Scene, labels, read_only

#: Semi-major axis in metres and flattening of WGS84 (EPSG 7030).
_AXIS_M, _FLATTENING = 6378137.0, 1.0 / 298.257223563
_ECCENTRICITY_2 = _FLATTENING * (2.0 - _FLATTENING)
#: Steps of Bowring's iteration; each gains some seven digits near the ground.
_MOST_STEPS = 12
_GPX = "http://www.topografix.com/GPX/1/1"
#: Decimals of degrees: a hundredth of a millimetre; and of metres.
_DEGREE_DECIMALS, _METRE_DECIMALS = 10, 4


@dataclass(frozen=True)
class LocalFrame:
    """Axes east, north and up at a place on the earth, in metres."""

    #: Degrees north and east, and metres above the ellipsoid.
    latitude_deg: float
    longitude_deg: float
    height_m: float = 0.0

    def __post_init__(self) -> None:
        _check_wgs84("origin", np.array([[self.latitude_deg, self.longitude_deg, self.height_m]]))
        if not np.isfinite([self.latitude_deg, self.longitude_deg, self.height_m]).all():
            raise InputError("origin is not finite, expected latitude, longitude and height")

    def enu_from_wgs84(self, position: npt.ArrayLike) -> Float:
        """(n, 3) latitude and longitude in degrees and height in metres to (n, 3) east, north, up in metres.

        NaN rows stay NaN.

        Raises
        ------
        InputError
            For another shape, or a latitude beyond 90 degrees.
        """
        return np.asarray((ecef_from_wgs84(position) - self._origin) @ self._enu_from_ecef.T)

    def wgs84_from_enu(self, position: npt.ArrayLike) -> Float:
        """(n, 3) east, north, up in metres to (n, 3) latitude, longitude in degrees and height in metres."""
        return wgs84_from_ecef(_rows("position", position) @ self._enu_from_ecef + self._origin)

    @property
    def _origin(self) -> Float:
        return np.asarray(ecef_from_wgs84([[self.latitude_deg, self.longitude_deg, self.height_m]])[0])

    @property
    def _enu_from_ecef(self) -> Float:
        latitude, longitude = np.radians(self.latitude_deg), np.radians(self.longitude_deg)
        (sin_lat, cos_lat), (sin_lon, cos_lon) = ((np.sin(a), np.cos(a)) for a in (latitude, longitude))
        return np.array(
            [
                [-sin_lon, cos_lon, 0.0],
                [-sin_lat * cos_lon, -sin_lat * sin_lon, cos_lat],
                [cos_lat * cos_lon, cos_lat * sin_lon, sin_lat],
            ]
        )


def ecef_from_wgs84(position: npt.ArrayLike) -> Float:
    """(n, 3) latitude and longitude in degrees and height in metres to (n, 3) geocentric metres.

    Raises
    ------
    InputError
        For another shape, or a latitude beyond 90 degrees.
    """
    rows = _rows("position", position)
    _check_wgs84("position", rows)
    latitude, longitude, height = np.radians(rows[:, 0]), np.radians(rows[:, 1]), rows[:, 2]
    normal = _AXIS_M / np.sqrt(1.0 - _ECCENTRICITY_2 * np.sin(latitude) ** 2)
    across = (normal + height) * np.cos(latitude)
    along = (normal * (1.0 - _ECCENTRICITY_2) + height) * np.sin(latitude)
    return np.stack((across * np.cos(longitude), across * np.sin(longitude), along), axis=1)


def wgs84_from_ecef(position: npt.ArrayLike) -> Float:
    """(n, 3) geocentric metres to (n, 3) latitude, longitude in degrees and height in metres.

    Bowring's iteration on the parametric latitude (Survey Review 23, 1976), to the last digits for all places farther
    than some tens of kilometres from the centre of the earth.
    """
    rows = _rows("position", position)
    across, along = np.hypot(rows[:, 0], rows[:, 1]), rows[:, 2]
    polar_axis = _AXIS_M * (1.0 - _FLATTENING)
    parametric = np.arctan2(along, (1.0 - _FLATTENING) * across)
    for _ in range(_MOST_STEPS):
        latitude = np.arctan2(
            along + _ECCENTRICITY_2 / (1.0 - _ECCENTRICITY_2) * polar_axis * np.sin(parametric) ** 3,
            across - _ECCENTRICITY_2 * _AXIS_M * np.cos(parametric) ** 3,
        )
        before, parametric = parametric, np.arctan2((1.0 - _FLATTENING) * np.sin(latitude), np.cos(latitude))
        if not np.any(np.abs(parametric - before) > 1e-15):
            break
    sin, cos = np.sin(latitude), np.cos(latitude)
    # the distance from the ellipsoid along its normal: no division, so it holds at the poles and at the equator
    height = across * cos + along * sin - _AXIS_M * np.sqrt(1.0 - _ECCENTRICITY_2 * sin**2)
    return np.stack((np.degrees(latitude), np.degrees(np.arctan2(rows[:, 1], rows[:, 0])), height), axis=1)


@dataclass(frozen=True, eq=False)
class GeoPath:
    """A path on the earth: one place a view, and what is known of each."""

    #: (n, 3) latitude, longitude in degrees, metres above the ellipsoid. NaN rows are not written.
    position: Float
    #: (n,) part of each place; parts are lines of their own. -1 = none.
    component: npt.NDArray[np.int64]
    #: Names of the places.
    names: tuple[str, ...]
    #: (n,) seconds, NaN where unknown.
    time_s: Float
    #: When second 0 was; None where that is not known, and times are then not dates.
    start: datetime | None = None

    @classmethod
    def from_arrays(
        cls,
        position: npt.ArrayLike,
        component: npt.ArrayLike | None = None,
        names: Sequence[str] | None = None,
        time_s: npt.ArrayLike | None = None,
        start: datetime | None = None,
    ) -> GeoPath:
        """Check the arrays and make the record.

        Raises
        ------
        InputError
            Naming the argument that does not fit.
        """
        rows = _rows("position", position)
        _check_wgs84("position", rows)
        n = len(rows)
        part = np.zeros(n, dtype=np.int64) if component is None else np.array(component, dtype=np.int64)
        time = np.full(n, np.nan) if time_s is None else np.array(time_s, dtype=np.float64)
        called = tuple(labels(None if names is None else tuple(names), n))
        for name, found in (("component", len(part)), ("names", len(called)), ("time_s", len(time))):
            if found != n:
                raise InputError(f"{name} has {found} entries, expected {n}")
        if start is not None and start.tzinfo is None:
            raise InputError("start has no time zone, expected one such as UTC")
        return cls(read_only(rows), read_only(part), called, read_only(time), start)

    @classmethod
    def of_scene(cls, scene: Scene, frame: LocalFrame, start: datetime | None = None) -> GeoPath:
        """Path of a scene whose world is ``frame``: x east, y north, z up, metres.

        Raises
        ------
        InputError
            For a planar scene.
        """
        if scene.d != 3:
            raise InputError("a path on the earth needs a scene in space, but this one is planar")
        time_s = None if scene.tracks is None else scene.tracks.time_s
        position = frame.wgs84_from_enu(scene.centers)
        return cls.from_arrays(position, scene.view_component, scene.view_labels(), time_s, start)

    @property
    def is_known(self) -> npt.NDArray[np.bool_]:
        """(n,) which places are known."""
        return np.asarray(np.isfinite(self.position).all(axis=1))

    def lines(self) -> Iterator[tuple[int, npt.NDArray[np.intp]]]:
        """Each part and its known places in the order they were taken."""
        for part in np.unique(self.component[self.is_known & (self.component >= 0)]).tolist():
            rows = np.flatnonzero(self.is_known & (self.component == part))
            if np.isfinite(self.time_s[rows]).all():
                rows = rows[np.argsort(self.time_s[rows], kind="stable")]
            yield part, rows

    def moment(self, row: int) -> str | None:
        """Date and time of a place as ISO 8601 in UTC, None where not known."""
        if self.start is None or not np.isfinite(self.time_s[row]):
            return None
        when = self.start.astimezone(UTC) + timedelta(seconds=float(self.time_s[row]))
        return when.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def write_geojson(path: GeoPath, file: str | PathLike[str]) -> None:
    """Write a feature collection: the line of each part, then each place as a point (RFC 7946).

    Coordinates are longitude, latitude, height; a line that crosses the date line is cut there (section 3.1.9).

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    features: list[dict[str, Any]] = []
    for part, rows in path.lines():
        if len(rows) < 2:
            continue  # a LineString has two positions or more
        pieces = _cut_at_date_line(_lon_lat_height(path.position[rows]))
        geometry: dict[str, Any] = (
            {"type": "LineString", "coordinates": pieces[0]}
            if len(pieces) == 1
            else {"type": "MultiLineString", "coordinates": pieces}
        )
        features.append(_feature(geometry, {"kind": "path", "component": part, "n_views": len(rows)}))
    for part, rows in path.lines():
        for row, place in zip(rows.tolist(), _lon_lat_height(path.position[rows]), strict=True):
            told: dict[str, Any] = {"kind": "view", "name": path.names[row], "index": row, "component": part}
            if np.isfinite(path.time_s[row]):
                told["time_s"] = float(path.time_s[row])
            moment = path.moment(row)
            if moment is not None:
                told["time"] = moment
            features.append(_feature({"type": "Point", "coordinates": place}, told))
    content = {"type": "FeatureCollection", "features": features}
    lines = ",\n".join(json.dumps(feature, ensure_ascii=False, allow_nan=False) for feature in features)
    text = json.dumps({"type": content["type"]})[:-1] + ', "features": [\n' + lines + "\n]}\n"
    write_bytes(Path(file), text.encode("utf-8"))


def read_geojson(file: str | PathLike[str]) -> GeoPath:
    """Read the places (points) of a GeoJSON file that :func:`write_geojson` wrote, or of any other.

    Points without a height get 0, without a name their number. Dates become seconds since the first one.

    Raises
    ------
    InputError
        Where the file is not GeoJSON, or has no point.
    """
    source = Path(file)
    try:
        content = json.loads(read_bytes(source).decode("utf-8"))
        features = [f for f in content["features"] if (f.get("geometry") or {}).get("type") == "Point"]
        told = [feature.get("properties") or {} for feature in features]
        places = [[*map(float, feature["geometry"]["coordinates"])] for feature in features]
        position = [(p[1], p[0], p[2] if len(p) > 2 else 0.0) for p in places]
        component = [int(t.get("component", 0)) for t in told]
        seconds = [float(t.get("time_s", np.nan)) for t in told]
    except (ValueError, KeyError, TypeError, AttributeError, IndexError):
        raise InputError(f"{source}: is not a GeoJSON feature collection") from None
    if not position:
        raise InputError(f"{source}: has no feature that is a point")
    start, dated = _seconds([t.get("time") for t in told], source)
    known = np.isfinite(seconds)
    if start is not None and known.any() and np.isfinite(dated[known]).any():
        # the file's own seconds count from another moment than its first date
        first = int(np.flatnonzero(known & np.isfinite(dated))[0])
        start += timedelta(seconds=float(dated[first]) - seconds[first])
    names = [str(t.get("name", i)) for i, t in enumerate(told)]
    return GeoPath.from_arrays(position, component, names, np.where(known, seconds, dated), start)


def write_gpx(path: GeoPath, file: str | PathLike[str]) -> None:
    """Write a track with one segment a part, in GPX 1.1.

    Heights are above the ellipsoid, as WGS84 has them; GPX leaves open which.

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    ET.register_namespace("", _GPX)
    root = ET.Element(f"{{{_GPX}}}gpx", {"version": "1.1", "creator": "panopath"})
    track = ET.SubElement(root, f"{{{_GPX}}}trk")
    ET.SubElement(track, f"{{{_GPX}}}name").text = "camera path"
    for _, rows in path.lines():
        segment = ET.SubElement(track, f"{{{_GPX}}}trkseg")
        for row in rows.tolist():
            latitude, longitude, height = path.position[row].tolist()
            place = {"lat": _fixed(latitude, _DEGREE_DECIMALS), "lon": _fixed(_longitude(longitude), _DEGREE_DECIMALS)}
            point = ET.SubElement(segment, f"{{{_GPX}}}trkpt", place)
            # the schema wants these in this order
            ET.SubElement(point, f"{{{_GPX}}}ele").text = _fixed(height, _METRE_DECIMALS)
            moment = path.moment(row)
            if moment is not None:
                ET.SubElement(point, f"{{{_GPX}}}time").text = moment
            ET.SubElement(point, f"{{{_GPX}}}name").text = _xml_text(path.names[row])
    ET.indent(root)
    write_bytes(Path(file), b'<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="utf-8") + b"\n")


def read_gpx(file: str | PathLike[str]) -> GeoPath:
    """Read all track points of a GPX file (1.0 or 1.1); each segment is a part. A height that is absent is NaN.

    Times become seconds since the first one, which is ``start``.

    Raises
    ------
    InputError
        Where the file is not GPX, or has no track point.
    """
    source = Path(file)
    data = read_bytes(source)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise InputError(f"{source}: declares entities, which a GPX file does not need")
    try:
        root = ET.fromstring(data)
    except ET.ParseError as error:
        raise InputError(f"{source}: is not XML ({error})") from None
    space = root.tag.removesuffix("gpx")
    if root.tag == space:
        raise InputError(f"{source}: is not a GPX file, its root is {root.tag}")
    position: list[tuple[float, float, float]] = []
    component: list[int] = []
    names: list[str] = []
    moments: list[str | None] = []
    for part, segment in enumerate(root.iter(f"{space}trkseg")):
        for point in segment.iter(f"{space}trkpt"):
            try:
                height = float(point.findtext(f"{space}ele", default="nan"))
                position.append((float(point.attrib["lat"]), float(point.attrib["lon"]), height))
            except (KeyError, ValueError):
                raise InputError(
                    f"{source}: track point {len(position)}: expected lat, lon and ele as numbers"
                ) from None
            component.append(part)
            names.append(point.findtext(f"{space}name", default=str(len(names))))
            moments.append(point.findtext(f"{space}time"))
    if not position:
        raise InputError(f"{source}: has no track point")
    start, seconds = _seconds(moments, source)
    return GeoPath.from_arrays(position, component, names, seconds, start)


def _seconds(moments: Sequence[str | None], source: Path) -> tuple[datetime | None, Float]:
    """First date, and seconds since it."""
    dates: list[datetime | None] = []
    for moment in moments:
        try:
            date = None if moment is None else datetime.fromisoformat(moment.strip())
        except (ValueError, AttributeError):
            raise InputError(f"{source}: found the time {moment!r}, expected ISO 8601") from None
        # a time without zone is UTC in GPX
        dates.append(date if date is None or date.tzinfo is not None else date.replace(tzinfo=UTC))
    start = next((date for date in dates if date is not None), None)
    seconds = [np.nan if date is None or start is None else (date - start).total_seconds() for date in dates]
    return start, np.array(seconds, dtype=np.float64)


def _feature(geometry: dict[str, Any], told: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": told}


def _lon_lat_height(position: Float) -> list[list[float]]:
    return [
        [_longitude(lon), round(lat, _DEGREE_DECIMALS), round(height, _METRE_DECIMALS)]
        for lat, lon, height in position.tolist()
    ]


def _longitude(degrees: float) -> float:
    """Bring to [-180, 180), which both formats want; a longitude in it keeps the digits that are written."""
    degrees = round(degrees, _DEGREE_DECIMALS)
    return degrees if -180.0 <= degrees < 180.0 else (degrees + 180.0) % 360.0 - 180.0


def _cut_at_date_line(places: list[list[float]]) -> list[list[list[float]]]:
    pieces = [[places[0]]]
    for before, after in pairwise(places):
        if abs(after[0] - before[0]) > 180.0:
            side = 180.0 if before[0] > 0.0 else -180.0
            share = (side - before[0]) / (after[0] + 2.0 * side - before[0])
            middle = [b + share * (a - b) for b, a in zip(before[1:], after[1:], strict=True)]
            pieces[-1].append([side, *middle])
            pieces.append([[-side, *middle]])
        pieces[-1].append(after)
    return pieces


def _fixed(value: float, decimals: int) -> str:
    """Plain decimals: an exponent is no xsd:decimal."""
    text = f"{value:.{decimals}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _xml_text(name: str) -> str:
    """XML 1.0 has no control characters."""
    return "".join(c for c in name if c in "\t\n\r" or (ord(c) >= 0x20 and ord(c) not in (0xFFFE, 0xFFFF)))


def _rows(name: str, values: npt.ArrayLike) -> Float:
    try:
        rows = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} does not hold numbers") from None
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{name} has shape {rows.shape}, expected (n, 3)")
    return rows


def _check_wgs84(name: str, rows: Float) -> None:
    wrong = np.abs(rows[:, 0]) > 90.0
    if wrong.any():
        first = int(np.argmax(wrong))
        raise InputError(f"{name}[{first}] has the latitude {rows[first, 0]}, expected -90 to 90 degrees")
