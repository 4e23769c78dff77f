"""Real data: ``python -m benchmarks.real_data [--only NAME] [-o docs/real-data.md]``.

The data lies outside the project, in ``../shared/data``; a set that is absent is skipped, saying so. Every set is
solved in three ways: by the default method, by the paper's linear one, and (the yardstick) by our refinement started
from the truth or the reference.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import panopath as pp
from panopath.errors import InputError
from panopath.model import Bool, Float, Int, Scene, Tracks

from benchmarks import pictures
from benchmarks.page import table
from benchmarks.planar_sets import PlanarSet, VictoriaPark, read_mrclam, read_roh, read_victoria_park
from benchmarks.reference import bundle_adjust_bal
from benchmarks.run import machine, versions
from benchmarks.scoring import Alignment, align, distances, rms
from benchmarks.victoria import Reference, Windows, solve_reference, windows

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
MRCLAM = ("mrclam1", "mrclam2", "mrclam4", "mrclam6", "mrclam9")
VICTORIA_WINDOW_M = 4.0
LINEAR = pp.PositionOptions(method="linear")
#: Sections of ``benchmarks.real_certificates`` begin with this; they are the last of the page.
CERTIFICATES = "certificate_"


@dataclass(frozen=True)
class Fit:
    """A solve laid over the truth, by the views and tracks of its largest part."""

    scene: Scene
    seconds: float
    alignment: Alignment
    #: (n_views,) and (n_tracks,) errors in the truth's unit; NaN outside the largest part.
    view_error: Float
    track_error: Float

    @property
    def n_views(self) -> int:
        """Views in the largest part."""
        return int(np.isfinite(self.view_error).sum())

    def aligned(self) -> tuple[Float, Float]:
        """Centres and points in the truth's frame, NaN outside the largest part."""
        centers, points = self.alignment.apply(self.scene.centers), self.alignment.apply(self.scene.points)
        centers[~np.isfinite(self.view_error)] = np.nan
        points[~np.isfinite(self.track_error)] = np.nan
        return centers, points


def fit(
    tracks: Tracks,
    cam_from_world: Float,
    truth: tuple[Float, Float],
    options: pp.PositionOptions | None = None,
    *,
    from_truth: bool = False,
) -> Fit | str:
    """Solve and compare; a text says why there is nothing to compare."""
    began = time.perf_counter()
    try:
        scene = pp.solve_positions(tracks, cam_from_world, options, start=truth if from_truth else None)
    except InputError as error:
        return f"refused: {error}"
    seconds = time.perf_counter() - began
    views, points = _largest_part(scene)
    if views.sum() < 3:
        return f"{scene.summary.status.value}: {scene.summary.n_solved_views} views solved"
    centers = np.where(views[:, None], scene.centers, np.nan)
    positions = np.where(points[:, None], scene.points, np.nan)
    if tracks.d == 2:
        alignment = align(np.vstack([centers, positions]), np.vstack(truth), rotate=True)
    else:
        alignment = align(centers, truth[0], rotate=True)
    return Fit(
        scene,
        seconds,
        alignment,
        distances(alignment.apply(centers), truth[0]),
        distances(alignment.apply(positions), truth[1]),
    )


def _largest_part(scene: Scene) -> tuple[Bool, Bool]:
    """Find views and tracks of the part with the most views."""
    solved = scene.view_component[scene.view_component >= 0]
    part = int(np.bincount(solved).argmax()) if len(solved) else -2
    return scene.view_component == part, scene.track_component == part


def three_ways(tracks: Tracks, cam_from_world: Float, truth: tuple[Float, Float]) -> dict[str, Fit | str]:
    """Solve by the default, by the linear method, and by the refinement started from the truth."""
    return {
        "robust": fit(tracks, cam_from_world, truth),
        "linear": fit(tracks, cam_from_world, truth, LINEAR),
        "from truth": fit(tracks, cam_from_world, truth, from_truth=True),
    }


HEADER = (
    *("data", "method", "views", "view error: median", "rms", "point error: median", "90 % below"),
    *("angular rms", "status", "time"),
)


def _row(name: str, method: str, found: Fit | str, n_views: int, unit: str = "m") -> tuple[str, ...]:
    if isinstance(found, str):
        return (name, method, f"0 of {n_views}", "-", "-", "-", "-", "-", found, "-")
    summary = found.scene.summary
    used = found.scene.residual_rad[found.scene.inlier]
    return (
        name,
        method,
        f"{found.n_views} of {n_views}",
        f"{np.nanmedian(found.view_error):.3f} {unit}",
        f"{rms(found.view_error):.3f} {unit}",
        f"{np.nanmedian(found.track_error):.3f} {unit}",
        f"{np.nanquantile(found.track_error, 0.9):.3f} {unit}",
        f"{np.degrees(rms(used)):.2f} deg",
        summary.status.value,
        f"{found.seconds:.2g} s",
    )


def prose(text: str) -> str:
    """Make one line of a paragraph."""
    return " ".join(text.split())


def planar_tracks(station: Int, landmark: Int, bearing_rad: Float) -> Tracks:
    """Angles to planar bearings."""
    return pp.Tracks.from_arrays(station, landmark, np.column_stack([np.cos(bearing_rad), np.sin(bearing_rad)]))


def _planar(data: PlanarSet) -> dict[str, Fit | str]:
    tracks = planar_tracks(data.station, data.landmark, data.bearing_rad)
    return three_ways(tracks, data.heading_rad, (data.stations, data.landmarks))


def roh(folder: Path, images: Path) -> str:
    """Section on Roh's beacons: the mean of all repeats, and each repeat alone."""
    data = read_roh(folder)
    mean = data.mean()
    found = _planar(mean)
    rows = [_row("mean of 200", method, result, len(mean.stations)) for method, result in found.items()]
    singles = [_roh_singles(data.n_repeats, data.shot, method) for method in ("robust", "linear")]
    residual = _truth_residual(mean)
    pictures.planar(images / "roh.png", "Roh beacons, mean of 200 repeats", mean, _aligned(found))
    return "\n\n".join(
        [
            "## Roh beacons",
            prose(
                f"""
                A rotating infrared detector at six stations of a 1.5 m grid, looking along y; four beacons at the
                corners of a square of 6 m; every bearing taken 200 times. Against the true positions the mean
                bearings are off by {np.degrees(rms(residual)):.1f} deg rms (at most
                {np.degrees(np.abs(residual).max()):.1f}), hardly less than single ones: the errors are biases that
                repetition does not remove, and 24 bearings for 17 unknowns leave little to find them by.
                """
            ),
            table(HEADER, rows),
            "Each repeat solved alone (rms over the six stations, and over the four beacons):",
            table(("method", "solved", "stations: median", "90 % below", "beacons: median", "90 % below"), singles),
            picture_link("roh.png", "Stations and beacons of Roh's set, true and found"),
        ]
    )


def _roh_singles(n_repeats: int, shot: Callable[[int], PlanarSet], method: str) -> tuple[str, ...]:
    views, points = [], []
    for repeat in range(n_repeats):
        data = shot(repeat)
        tracks = planar_tracks(data.station, data.landmark, data.bearing_rad)
        options = LINEAR if method == "linear" else None
        found = fit(tracks, data.heading_rad, (data.stations, data.landmarks), options)
        if isinstance(found, Fit) and found.n_views == len(data.stations):
            views.append(rms(found.view_error))
            points.append(rms(found.track_error))
    if not views:
        return (method, f"0 of {n_repeats}", "-", "-", "-", "-")
    numbers = [np.median(views), np.quantile(views, 0.9), np.median(points), np.quantile(points, 0.9)]
    return (method, f"{len(views)} of {n_repeats}", *(f"{number:.2f} m" for number in numbers))


def _truth_residual(data: PlanarSet) -> Float:
    """Measured minus true bearing of each observation, in (-pi, pi]."""
    offset = data.landmarks[data.landmark] - data.stations[data.station]
    true = np.arctan2(offset[:, 1], offset[:, 0]) - data.heading_rad[data.station]
    return np.asarray(np.angle(np.exp(1j * (data.bearing_rad - true))))


def _aligned(found: dict[str, Fit | str]) -> dict[str, tuple[Float, Float]]:
    return {method: result.aligned() for method, result in found.items() if isinstance(result, Fit)}


def picture_link(file: str, text: str) -> str:
    """Show a picture that stands beside the page."""
    return f"![{text}](img/real-data/{file})"


def mrclam(folder: Path, images: Path) -> str:
    """Section on the MRCLAM logs."""
    rows, facts = [], []
    for name in MRCLAM:
        data = read_mrclam(folder / f"{name}.mat")
        residual = np.degrees(_truth_residual(data))
        facts.append(
            (
                name,
                str(len(data.stations)),
                str(len(data.landmarks)),
                str(len(data.station)),
                f"{np.median(np.abs(residual)):.2f} deg",
                f"{np.quantile(np.abs(residual), 0.95):.2f} deg",
                f"{np.median(residual):+.2f} deg",
            )
        )
        found = _planar(data)
        rows += [_row(name, method, result, len(data.stations)) for method, result in found.items()]
        pictures.planar(images / f"{name}.png", name, data, _aligned(found))
    return "\n\n".join(
        [
            "## UTIAS MRCLAM",
            prose(
                """
                A robot among landmarks, its true position and heading from a motion-capture system, its camera's
                field of view +-34 deg. The logs repeat each camera reading at 50 Hz until the next one comes; here
                a station is one reading. Headings are the true ones; the bearings carry a constant offset (a camera
                turned on its robot), which the similarity alignment takes up as a rotation.
                """
            ),
            table(
                ("log", "stations", "landmarks", "bearings", "off by: median", "95 % below", "offset"),
                facts,
            ),
            table(HEADER, rows),
            *(picture_link(f"{name}.png", f"Stations and landmarks of {name}, true and found") for name in MRCLAM[:1]),
        ]
    )


@dataclass(frozen=True)
class Park:
    """Victoria Park as it is solved: the drive, its reference, and the bearings taken from windows of it."""

    drive: VictoriaPark
    reference: Reference
    seen: Windows
    tracks: Tracks
    #: Positions of views and of trees.
    truth: tuple[Float, Float]


def read_park(folder: Path) -> Park:
    """Read the drive, solve its reference, and take bearings."""
    drive = read_victoria_park(folder / "victoria_park.txt")
    reference = solve_reference(drive)
    seen = windows(drive, VICTORIA_WINDOW_M)
    trees, tree = np.unique(seen.tree, return_inverse=True)
    tracks = planar_tracks(seen.view, tree.astype(np.int32), seen.bearing_rad)
    return Park(drive, reference, seen, tracks, (reference.poses[seen.pose, :2], reference.trees[trees]))


def victoria_park(folder: Path, images: Path) -> str:
    """Section on Victoria Park."""
    park = read_park(folder)
    drive, reference, seen, tracks, truth = park.drive, park.reference, park.seen, park.tracks, park.truth
    reckoned = drive.dead_reckoning()
    headings = {"dead reckoning": reckoned[seen.pose, 2], "reference": reference.poses[seen.pose, 2]}
    found = {name: three_ways(tracks, heading, truth) for name, heading in headings.items()}
    rows = [
        _row(f"headings of the {name}", method, result, tracks.n_views)
        for name, ways in found.items()
        for method, result in ways.items()
    ]
    pictures.park(images / "victoria_park.png", reckoned, reference, truth, _aligned(found["reference"]))
    return "\n\n".join(
        [
            *_victoria_text(drive.n_trees, reckoned, reference, seen, tracks),
            table(HEADER, rows),
            picture_link("victoria_park.png", "Dead reckoning, reference map, and views from bearings alone"),
        ]
    )


def _victoria_text(
    n_trees: int, reckoned: Float, reference: Reference, seen: Windows, tracks: Tracks
) -> tuple[str, ...]:
    turned = np.degrees(np.abs(np.unwrap(reference.poses[:, 2]) - reckoned[:, 2]).max())
    apart = distances(reference.poses[:, :2], reckoned[:, :2]).max()
    unknowns = 2 * (tracks.n_views + tracks.n_tracks) - 3
    limits = (
        f"""
        - Dead-reckoned headings drift by up to {turned:.0f} deg against the reference (positions by {apart:.0f} m):
        over the whole drive they are no known orientation, and the first rows below show what comes of it.
        """,
        f"""
        - The set holds 1.1 trees a scan, and a single bearing places nothing. The sightings of each
        {VICTORIA_WINDOW_M:g} m of the drive are therefore taken as one view, moved to its middle with the odometry in
        between and the laser's range (a change of {np.degrees(seen.median_change_rad):.1f} deg in the median). Of the
        drive this leaves {tracks.n_views} views of {tracks.n_tracks} trees in separate stretches, {len(tracks)}
        bearings for {unknowns} unknowns.
        """,
        "- Errors are those of the largest part, against the reference, after a similarity.",
    )
    return (
        "## Victoria Park",
        prose(
            f"""
            A vehicle's drive of 4 km, {n_trees} trees seen by a laser scanner; no ground truth. The reference is a map
            by GTSAM from odometry, bearings and ranges together. Limits, stated before the figures:
            """
        ),
        "\n".join(prose(limit) for limit in limits),
    )


def ladybug(folder: Path, images: Path) -> str:
    """Section on Ladybug 49."""
    path = folder / "problem-49-7776-pre.txt"
    problem = pp.read_problem(path)
    if problem.cam_from_world is None:
        raise ValueError(f"{path}: expected orientations")
    fixed = bundle_adjust_bal(path, fixed_rotations=True)
    free = bundle_adjust_bal(path, fixed_rotations=False)
    size = rms(distances(free.centers, free.centers.mean(axis=0)))
    rows = []
    found: Fit | str = "not solved"
    adjusted = pp.Tracks.from_arrays(free.view, free.track, free.bearing, len(free.centers), len(free.points))
    given = (problem.tracks, problem.cam_from_world)
    cases = (
        ("the file's rotations, against the optimum with these", *given, fixed),
        ("the file's rotations, against the full optimum", *given, free),
        ("the full optimum's rotations and lenses, against it", adjusted, free.cam_from_world, free),
    )
    for name, tracks, cam_from_world, reference in cases:
        truth = (reference.centers / size * 100.0, reference.points / size * 100.0)
        found = fit(tracks, cam_from_world, truth)
        rows.append(_row(name, "robust", found, tracks.n_views, "%"))
    if isinstance(found, Fit):
        pictures.space(
            images / "ladybug.png", "Ladybug 49", free.centers / size * 100.0, found.aligned(), "% of path size"
        )
    return "\n\n".join(
        [
            "## Ladybug 49",
            prose(
                f"""
                49 views from a car with an omnidirectional rig (BAL). The reference is the least-squares optimum in
                pixels by COLMAP's bundle adjustment, which shares no code with ours: once with only positions and
                points free (what known orientations leave), once with everything free. Errors are per cent of the
                path's size (the rms distance of the views from their middle). The file's own start has
                {free.rms_before_px:.2f} px rms; the optimum with its rotations {fixed.rms_after_px:.2f} px, the
                full one {free.rms_after_px:.2f} px. Pixels weigh the rays of a wide lens otherwise than angles do,
                and squares follow outliers that our loss resists: the two optima need not agree to the last digit.
                Point errors are large for far points, whose depth nothing fixes.
                """
            ),
            table(HEADER, rows),
            picture_link("ladybug.png", "Ladybug 49 along the principal axes of its path"),
        ]
    )


def lund_door(folder: Path, images: Path) -> str:
    """Section on the Lund door."""
    problem = pp.read_problem(folder)
    if problem.scene is None or problem.cam_from_world is None:
        raise ValueError(f"{folder}: expected a model with poses")
    size = rms(distances(problem.scene.centers, problem.scene.centers.mean(axis=0)))
    truth = (problem.scene.centers / size * 100.0, problem.scene.points / size * 100.0)
    rows = [
        _row("COLMAP's rotations", method, found, problem.tracks.n_views, "%")
        for method, found in three_ways(problem.tracks, problem.cam_from_world, truth).items()
    ]
    found = fit(problem.tracks, problem.cam_from_world, truth)
    if isinstance(found, Fit):
        pictures.space(images / "lund_door.png", "Lund door", truth[0], found.aligned(), "% of path size")
    return "\n\n".join(
        [
            "## Lund door",
            prose(
                """
                12 photographs, a COLMAP text model; its rotations are taken as known, its positions as the
                reference (it was adjusted with everything free, in pixels). Errors are per cent of the size of the
                camera path.
                """
            ),
            table(HEADER, rows),
            picture_link("lund_door.png", "Lund door along the principal axes of its path"),
        ]
    )


SECTIONS: dict[str, tuple[str, Callable[[Path, Path], str]]] = {
    "roh": ("planar_bearings/dataset_roh", roh),
    "mrclam": ("planar_bearings/dataset_mrclam", mrclam),
    "victoria_park": ("victoria_park", victoria_park),
    "ladybug": ("bal_ladybug49", ladybug),
    "lund_door": ("lund_door_colmap", lund_door),
}


def section(name: str, data: Path, images: Path) -> str:
    """Write one section of the page, or the sentence that says what is missing."""
    folder, write = SECTIONS[name]
    if not (data / folder).is_dir():
        return f"## {name.replace('_', ' ').capitalize()}\n\nSkipped: {folder} is absent from ../shared/data."
    print(f"{name} ...", flush=True)
    images.mkdir(parents=True, exist_ok=True)
    return write(data / folder, images)


def main(arguments: list[str] | None = None) -> None:
    """Write the page; sections that were not asked for are kept as they stand."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.real_data", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(SECTIONS), help="renew this section alone")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/real-data.md"))
    chosen = parser.parse_args(sys.argv[1:] if arguments is None else arguments)
    output: Path = chosen.output
    standing = sections_of(output)
    for name in chosen.only or SECTIONS:
        standing[name] = section(name, DATA, output.parent / "img" / "real-data")
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(page(standing), encoding="utf-8")
    print(f"wrote {output}")


def page(sections: dict[str, str]) -> str:
    """Put the page together from its sections."""
    about = machine()
    found = ", ".join(f"{package} {version}" for package, version in versions().items())
    head = [
        "# Real data",
        prose(
            """
            Written by `python -m benchmarks.real_data` (orientations given), where a heading says that they are
            unknown by `python -m benchmarks.real_orientation`, and the certificates at the end by `python -m
            benchmarks.real_certificates`; do not edit. Positions and points are found from
            bearings alone; errors are what remains after a similarity (shift, rotation, scale) laid over the
            largest jointly scaled part: over its views and landmarks in the plane, over its views in space, where far
            points have no certain distance. "From truth" is the same refinement started from the true positions: what
            these bearings can give.
            """
        ),
        f"{datetime.now(UTC).strftime('%Y-%m-%d')}, {about['cpu']}, {about['cores']} cores; {found}",
    ]
    names = [*(name for name in SECTIONS if name in sections), *(name for name in sections if name not in SECTIONS)]
    names.sort(key=lambda name: name.startswith(CERTIFICATES))
    marked = [f"<!-- {name} -->\n{sections[name]}\n<!-- end -->" for name in names]
    return "\n\n".join([*head, *marked]) + "\n"


def sections_of(path: Path) -> dict[str, str]:
    """Take apart a page written before; sections of ``benchmarks.real_orientation`` among them."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return dict(re.findall(r"^<!-- (\w+) -->\n(.*?)\n<!-- end -->", text, re.MULTILINE | re.DOTALL))


Writer = Callable[[Path, Path], str]


def renew(
    program: str,
    about: str | None,
    sections: dict[str, tuple[str, Writer]],
    heading: Callable[[str], str],
    *,
    arguments: list[str] | None = None,
    prefix: str = "",
) -> None:
    """Write sections of another module into the page, behind those of this one.

    ``sections`` gives the folder of data and the writer of each by its name, which stands in the page behind
    ``prefix``; ``heading`` titles a section whose data is absent. Sections that were not asked for are kept as they
    stand.
    """
    parser = argparse.ArgumentParser(prog=f"python -m {program}", description=about)
    parser.add_argument("--only", action="append", choices=list(sections), help="renew this section alone")
    parser.add_argument("-o", "--output", type=Path, default=Path("docs/real-data.md"))
    chosen = parser.parse_args(sys.argv[1:] if arguments is None else arguments)
    output: Path = chosen.output
    images = output.parent / "img" / "real-data"
    images.mkdir(parents=True, exist_ok=True)
    for name in chosen.only or sections:
        folder, write = sections[name]
        print(f"{name} ...", flush=True)
        if (DATA / folder).is_dir():
            text = write(DATA / folder, images)
        else:
            text = f"## {heading(name)}\n\nSkipped: {folder} is absent from ../shared/data."
        standing = sections_of(output) | {prefix + name: text}
        own = [prefix + known for known in sections if prefix + known in standing]
        ordered = {known: standing[known] for known in [*(k for k in standing if k not in own), *own]}
        output.write_text(page(ordered), encoding="utf-8")
    print(f"wrote {output}")


if __name__ == "__main__":
    main()
