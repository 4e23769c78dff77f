"""Certificates of real scenes: ``python -m benchmarks.real_certificates [--only NAME] [-o docs/real-data.md]``.

Solves every set as ``benchmarks.real_data`` and ``benchmarks.real_orientation`` do, certifies what was found, and holds
what the certificate says against the truth or the reference. Writes the last sections of their page. The data lies
outside the project, in ``../shared/data``; a set that is absent is skipped, saying so.
"""

from __future__ import annotations

import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
import panopath as pp
from panopath.certificate_text import percent
from panopath.mapping import map_database
from panopath.model import Float, Int, Scene, Tracks
from panopath.pipeline import reconstruct_tracks
from panopath.planar import complete_planar

from benchmarks import kerry
from benchmarks.certificate_checks import (
    COVARIANCE_COLUMN,
    LOOSE_POINT,
    LOOSE_VIEW,
    LOOSENESS_COLUMN,
    Case,
    Certified,
    certified,
    check_row,
    checks,
    errors,
    movers,
    named,
    picture,
    rank_correlation,
    share,
    share_along_modes,
    signed,
    timed,
    truth_of,
    verdicts,
    with_truth,
)
from benchmarks.page import table
from benchmarks.planar_sets import PlanarSet, read_mrclam, read_roh
from benchmarks.real_data import CERTIFICATES, MRCLAM, Writer, planar_tracks, prose, read_park, renew
from benchmarks.real_orientation import aligned, found_headings
from benchmarks.reference import Bundle, bundle_adjust_bal
from benchmarks.scoring import distances, rms

#: Databases of Kerry Park's fisheyes: COLMAP's matching makes another one each time.
KERRY_RUNS = 6


# planar sets


def planar_case(name: str, data: PlanarSet) -> Case:
    """Positions from the true headings."""
    tracks = planar_tracks(data.station, data.landmark, data.bearing_rad)
    case = timed(name, tracks, "known", lambda: pp.solve_positions(tracks, data.heading_rad))
    return with_truth(case, (data.stations, data.landmarks))


def unknown_case(name: str, data: PlanarSet) -> Case:
    """Headings from nothing, completed."""
    tracks = planar_tracks(data.station, data.landmark, data.bearing_rad)
    case = timed(name, tracks, "free", lambda: complete_planar(tracks, found_headings(tracks)))
    return with_truth(case, (data.stations, data.landmarks))


def without(case: Case, views: Int) -> Certified:
    """Solve and certify again without the observations of some views; orientations known."""
    keep = ~np.isin(case.tracks.view, views)
    tracks = Tracks.from_arrays(
        case.tracks.view[keep],
        case.tracks.track[keep],
        case.tracks.bearing[keep],
        case.tracks.n_views,
        case.tracks.n_tracks,
    )
    solve = partial(pp.solve_positions, tracks, case.scene.cam_from_world)
    return certified(timed(f"{case.name}, without {len(views)} views", tracks, "known", solve))


def roh(folder: Path, images: Path) -> str:
    """Section on Roh's beacons."""
    data = read_roh(folder / "dataset_roh").mean()
    every = [certified(planar_case("headings known", data)), certified(unknown_case("headings unknown", data))]
    known, unknown = (one.certificate for one in every)
    return "\n\n".join(
        [
            "## Certificate: Roh beacons",
            verdicts(every),
            checks(every, "m"),
            prose(
                f"""
                24 bearings for 17 unknowns: unique, but held by little. The few equations to spare tell the noise
                badly, so the certificate takes the largest that they do not rule out
                ({np.degrees(known.sigma_rad):.2g} deg; the bearings are off by 2.9 deg rms) and finds that it moves
                the stations by {percent(known.components[0].weakest_movement)} of their size: weak, rightly, as the
                stations are off by 0.17 m on a grid of 1.5 m. With headings unknown the biases go into headings and
                places and the fit is better: the certificate, which knows residuals alone, puts the noise at
                {np.degrees(unknown.sigma_rad):.2g} deg and the movement at
                {percent(unknown.components[0].weakest_movement)}, while the stations are off by 0.31 m. A bias that
                fits cannot be told from residuals.
                """
            ),
        ]
    )


def mrclam(folder: Path, images: Path) -> str:
    """Section on the MRCLAM logs with true headings."""
    every = [certified(planar_case(name, read_mrclam(folder / "dataset_mrclam" / f"{name}.mat"))) for name in MRCLAM]
    by_name = {one.case.name: one for one in every}
    second, fourth, ninth = (by_name[name] for name in ("mrclam2", "mrclam4", "mrclam9"))
    runaway = int(movers(second, second.certificate.modes[0])[0])
    second_off, fourth_off, ninth_off = (errors(one.case, truth_of(one)) for one in (second, fourth, ninth))
    blamed = np.unique(np.concatenate([movers(fourth, mode) for mode in fourth.certificate.modes])).astype(np.int32)
    again = without(fourth.case, blamed)
    loosest = np.flatnonzero(ninth.certificate.view_looseness > LOOSE_VIEW)
    below = 100.0 * np.mean(ninth_off.view < np.median(ninth_off.view[loosest]))
    return "\n\n".join(
        [
            "## Certificate: UTIAS MRCLAM",
            verdicts(every),
            checks(every, "m"),
            "Which stations the weak modes are about, seen from the landmarks (medians where they are several):",
            named(every),
            prose(
                f"""
                mrclam1 is determined, and all of it is well placed. **mrclam2** is weak because of single stations,
                and they are the ones that are wrong: its first mode is about station {runaway} alone, which two
                bearings 2.5 deg apart hold (a third was left out as an outlier); it lies
                {second_off.view[runaway]:.0f} m off, with {share(share_along_modes(second, second_off))} of the
                squared error of all {len(second_off.view)} stations. The next two modes are about the next stations
                by error. The status was `converged` throughout. **mrclam4** is weak for the sake of {len(blamed)} of
                {fourth.certificate.n_views} stations ({", ".join(map(str, blamed))}): what each sees are three
                landmarks within 5 deg, all but in line with it. They are off by {fourth_off.view[blamed].max():.2f} m
                and {fourth_off.view[blamed].min():.2f} m, the median of all stations by
                {np.nanmedian(fourth_off.view):.2f} m; without them the verdict is
                "{again.certificate.verdict.value}". **mrclam6** is two scenes, 464 and 463 stations with six
                landmarks each, which no station ties: the certificate says so and finds nothing else that is free. In
                mrclam9 the loosest are stations {loosest.min()} to {loosest.max()}; their median error is larger than
                those of {below:.0f} % of the stations.
                """
            ),
        ]
    )


def victoria_park(folder: Path, images: Path) -> str:
    """Section on Victoria Park, with headings of the reference and of dead reckoning."""
    park = read_park(folder)
    tracks, truth = park.tracks, park.truth
    headings = {
        "headings of the reference": park.reference.poses[park.seen.pose, 2],
        "headings of the dead reckoning": park.drive.dead_reckoning()[park.seen.pose, 2],
    }
    every = []
    for name, heading in headings.items():
        case = timed(name, tracks, "known", partial(pp.solve_positions, tracks, heading))
        every.append(certified(with_truth(case, truth)))
    good = every[0].certificate
    off = errors(every[0].case, truth)
    loosest = int(np.nanargmax(np.where(np.isfinite(off.view), good.view_looseness, np.nan)))
    below = 100.0 * np.mean(off.view[np.isfinite(off.view)] < off.view[loosest])
    return "\n\n".join(
        [
            "## Certificate: Victoria Park",
            verdicts(every),
            checks(every, "m"),
            prose(
                f"""
                Three stretches of the drive that share no tree: three parts, each with a scale of its own, which the
                status called `disconnected` and the certificate names with members. Each of them is weak by itself,
                since 280 bearings for 245 unknowns leave little to spare: noise of {np.degrees(good.sigma_rad):.2g}
                deg moves the largest by {percent(good.components[0].weakest_movement)} of its size. The loosest of
                its views, {loosest} ({percent(good.view_looseness[loosest])} of its distance from the trees), is off
                by {off.view[loosest]:.1f} m, farther than {below:.0f} % of the views, and the weak modes named hold
                {share(share_along_modes(every[0], off))} of the squared error against the reference. But for that
                view neither looseness nor the covariance tells which views err (rank correlations). With headings of
                the dead reckoning there is no scene: the solver draws most trees together in one place, residuals are
                of 20 deg, and the certificate calls it undetermined. Its further words (parts of one view, noise of
                77 deg) mean nothing there.
                """
            ),
            picture(every[0], images, "victoria_park", "Victoria Park: three parts, and the weak mode of each", "m"),
        ]
    )


# Ladybug and Lund


def ladybug(folder: Path, images: Path) -> str:
    """Section on Ladybug 49: the file's rotations, those of the optimum, none."""
    path = folder / "problem-49-7776-pre.txt"
    problem = pp.read_problem(path)
    if problem.cam_from_world is None:
        raise ValueError(f"{path}: expected orientations")
    given = problem.cam_from_world
    fixed, free = (bundle_adjust_bal(path, fixed_rotations=held) for held in (True, False))
    adjusted = Tracks.from_arrays(free.view, free.track, free.bearing, len(free.centers), len(free.points))
    seen = problem.tracks
    cases = [
        (timed("the file's rotations", seen, "known", lambda: pp.solve_positions(seen, given)), fixed),
        (
            timed(
                "the optimum's rotations and lenses",
                adjusted,
                "known",
                lambda: pp.solve_positions(adjusted, free.cam_from_world),
            ),
            free,
        ),
        (
            timed("the optimum's lenses, rotations unknown", adjusted, "free", lambda: reconstruct_tracks(adjusted)),
            free,
        ),
        (timed("the file's lenses, rotations unknown", seen, "free", lambda: reconstruct_tracks(seen)), free),
    ]
    every = [certified(with_truth(case, _per_cent(best, free))) for case, best in cases]
    known, unknown = every[0].certificate, every[2].certificate
    order = np.argsort(-unknown.view_looseness, kind="stable")
    loose = int((known.track_looseness > LOOSE_POINT).sum())
    ranks = [check_row(one, "%")[COVARIANCE_COLUMN] for one in every]
    return "\n\n".join(
        [
            "## Certificate: Ladybug 49",
            verdicts(every),
            checks(every, "%"),
            prose(
                f"""
                Which views are weakly held? None: with known rotations every view is held to
                {percent(float(np.nanmax(known.view_looseness)))} of its distance from those it shares most with or
                better, with unknown ones to {percent(float(np.nanmax(unknown.view_looseness)))}; the loosest then are
                views {", ".join(map(str, order[:4]))}. Differences of that size decide nothing, and looseness does
                not tell which views are farthest from COLMAP's optimum (rank correlations in the table): these stand
                towards an end of the path, where small errors of all views add up. The covariance over the whole path
                ranks them better ({min(ranks)} to {max(ranks)}). Of points the certificate tells much: the few that
                it calls loose (with the file's rotations {loose}, each seen under less than 1 deg of parallax, all
                but one by two views only) lie at quite another distance than COLMAP puts them, and the rest does not.
                """
            ),
            picture(
                every[2],
                images,
                "ladybug",
                "Ladybug 49, rotations unknown: one part",
                "rms size of the path",
            ),
        ]
    )


def _per_cent(bundle: Bundle, unit: Bundle) -> tuple[Float, Float]:
    """Centres and points in per cent of the size of a path."""
    size = rms(distances(unit.centers, unit.centers.mean(axis=0))) / 100.0
    return bundle.centers / size, bundle.points / size


def lund_door(folder: Path, images: Path) -> str:
    """Section on the Lund door."""
    problem = pp.read_problem(folder)
    if problem.scene is None or problem.cam_from_world is None:
        raise ValueError(f"{folder}: expected a model with poses")
    tracks, rotations = problem.tracks, problem.cam_from_world
    size = rms(distances(problem.scene.centers, problem.scene.centers.mean(axis=0))) / 100.0
    truth = (problem.scene.centers / size, problem.scene.points / size)
    known = timed("COLMAP's rotations", tracks, "known", lambda: pp.solve_positions(tracks, rotations))
    free = timed("the same, refined with rotations free", tracks, "free", lambda: pp.refine(tracks, known.scene))
    every = [certified(with_truth(case, truth)) for case in (known, free)]
    found = every[0].certificate
    return "\n\n".join(
        [
            "## Certificate: Lund door",
            verdicts(every),
            checks(every, "%"),
            prose(
                f"""
                The easy case, and the certificate says so: determined with rotations known or free, no view held
                worse than to {percent(float(np.nanmax(found.view_looseness)))} of its distance from its neighbours,
                no loose point. Twelve views around one door, each point seen by six on average, leave no mode that
                noise moves by more than
                {percent(max(one.certificate.components[0].weakest_movement for one in every))} of the size. All views
                err alike.
                """
            ),
        ]
    )


# Kerry Park


def kerry_park(folder: Path, images: Path) -> str:
    """Section on Kerry Park: panoramas, and several databases of the fisheyes."""
    with tempfile.TemporaryDirectory() as scratch:
        work = Path(scratch)
        panoramas = kerry.make_panorama_database(folder, work / "panoramas.db")
        reference = kerry.map_with_colmap(panoramas, work / "reference", "incremental").centers
        every = [_mapped("panoramas", panoramas)]
        for run in range(KERRY_RUNS):
            database = kerry.make_fisheye_database(folder, work / f"fisheyes-{run}.db")
            every.append(_mapped(f"fisheyes, run {run + 1}", database))
    rows = [_kerry_row(one, reference) for one in every]
    worst = max(every[1:], key=lambda one: float(np.nanmax(_off(one, reference))))
    header = (
        *("scene", "off the reference: median, largest", "frame that is off most", "its looseness", "its rank"),
        *("loosest frames", "looseness ranks errors", "farthest point, in sizes of the walk"),
    )
    return "\n\n".join(
        [
            "## Certificate: Kerry Park",
            prose(
                """
                Rays of the two fisheyes start up to 31 mm beside the frame's centre, which the certificate does not
                model (`panopath map` makes none for such rigs): here all start in it. Of a walk of 6 m that is
                little, but it leaves the scale to the gauge. COLMAP's matching makes other databases every time, so
                there are several. The reference is COLMAP's incremental mapper on the panoramas.
                """
            ),
            verdicts(every),
            table(header, rows),
            _kerry_text(every, reference),
            picture(worst, images, "kerry_park", f"Kerry Park, {worst.case.name}, as certified", "m"),
        ]
    )


#: Index of the frame with the fewest matches.
FRAME_IN_GAP = 17
#: Per cent of the walk's size; a frame farther off than this is at a wrong place.
KERRY_ASTRAY = 20.0


def _mapped(name: str, database: Path) -> Certified:
    began = time.perf_counter()
    scene = map_database(pp.read_database(database)).scene
    seconds = time.perf_counter() - began
    if scene.tracks is None:
        raise ValueError(f"{database}: expected observations")
    return certified(Case(name, scene.tracks, scene, "free", seconds))


def _off(one: Certified, reference: Float) -> Float:
    """Distance of each frame from the reference, per cent of its size."""
    size = rms(distances(reference, np.nanmean(reference, axis=0))) / 100.0
    return distances(aligned(one.case.scene.centers, reference), reference) / size


def _kerry_row(one: Certified, reference: Float) -> tuple[str, ...]:
    off, held = _off(one, reference), one.certificate.view_looseness
    most = int(np.nanargmax(off))
    loosest = np.argsort(-np.nan_to_num(held, nan=-1.0), kind="stable")[:3]
    return (
        one.case.name,
        f"{np.nanmedian(off):.1f} %, {np.nanmax(off):.0f} %",
        str(most + 1),
        percent(float(held[most])),
        f"{_rank(one, reference)} of {kerry.N_FRAMES}",
        ", ".join(f"{frame + 1} ({percent(float(held[frame]))})" for frame in loosest),
        signed(rank_correlation(held, off)),
        f"{_farthest(one.case.scene):.1g}",
    )


def _rank(one: Certified, reference: Float) -> int:
    """Rank by looseness of the frame that is off most; 1 is the loosest."""
    held = one.certificate.view_looseness
    return 1 + int((held > held[int(np.nanargmax(_off(one, reference)))]).sum())


def _farthest(scene: Scene) -> float:
    """Distance of the farthest point from the middle of the views, in sizes of the path."""
    away = scene.centers - np.nanmean(scene.centers, axis=0)
    far = np.nanmax(np.linalg.norm(scene.points - np.nanmean(scene.centers, axis=0), axis=1))
    return float(far / rms(np.linalg.norm(away, axis=1)))


def _kerry_text(every: list[Certified], reference: Float) -> str:
    is_astray = [bool(np.nanmax(_off(one, reference)) > KERRY_ASTRAY) for one in every]
    flagged = 0
    for one in (one for one, astray in zip(every, is_astray, strict=True) if astray):
        flagged += int(one.certificate.view_looseness[int(np.nanargmax(_off(one, reference)))] > LOOSE_VIEW)
    gaps = {
        kind: [one.certificate.gap.first_other for one, astray in zip(every, is_astray, strict=True) if astray is kind]
        for kind in (True, False)
    }
    spectrum = " and ".join(f"{min(found):.2g} to {max(found):.2g}" for found in gaps.values() if found)
    n_astray = sum(is_astray)
    ranks = [_rank(one, reference) for one, astray in zip(every, is_astray, strict=True) if astray]
    told_ranks = (
        f"by looseness they rank {', '.join(map(str, ranks))} of {kerry.N_FRAMES}" if ranks else "there is none"
    )
    in_gap = sum(int(np.nanargmax(one.certificate.view_looseness)) == FRAME_IN_GAP for one in every)
    return prose(
        f"""
        {n_astray} of {len(every)} walks have a frame more than {KERRY_ASTRAY:g} % off the reference. **Does the
        certificate flag that frame? {"Yes" if n_astray and flagged == n_astray else "No"}**: {flagged} of {n_astray}
        such frames are beyond the limit of {percent(LOOSE_VIEW)}, {told_ranks}. A frame at a wrong place is held
        there about as firmly as it would be at the right one: looseness is about what the observations that count
        leave open, not about whether they are right. The smallest value of a mode beyond the gauge is {spectrum} rad
        in walks with and without such a frame. No walk is called determined, right or wrong, since most points are
        far and have no distance; so the verdict does not tell right walks from wrong ones. What looseness does find
        is the gap in the walk: frame 18, which has the fewest matches (640 in one of the databases; the median of all
        frames is 4178), is the loosest in {in_gap} of {len(every)} walks.
        """
    )


# headings unknown


def planar_unknown(folder: Path, images: Path) -> str:
    """Section on the planar logs with unknown headings."""
    every = [certified(unknown_case(name, read_mrclam(folder / "dataset_mrclam" / f"{name}.mat"))) for name in MRCLAM]
    ranks = [check_row(one, "m")[LOOSENESS_COLUMN] for one in every]
    ninth = every[-1]
    return "\n\n".join(
        [
            "## Certificate: MRCLAM, headings unknown",
            verdicts(every),
            checks(every, "m"),
            named(every),
            prose(
                f"""
                Three landmarks fix a station without a check, and the certificate finds which of these stations are
                fixed badly: looseness ranks their errors by {min(ranks, key=float)} to {max(ranks, key=float)}
                (Spearman), and the modes name stations that are among the worst. mrclam1 is undetermined and is:
                three landmarks stay outside with stations that see nothing else, tied to the rest by nothing. mrclam6
                is two scenes here too. Of mrclam9 only {len(ninth.certificate.components[0].views)} stations have
                places, and noise of {np.degrees(ninth.certificate.sigma_rad):.2g} deg moves them by
                {percent(ninth.certificate.components[0].weakest_movement)} of their size: what stands there is not to
                be used, and that is what it says.
                """
            ),
        ]
    )


SECTIONS: dict[str, tuple[str, Writer]] = {
    "roh": ("planar_bearings", roh),
    "mrclam": ("planar_bearings", mrclam),
    "victoria_park": ("victoria_park", victoria_park),
    "ladybug": ("bal_ladybug49", ladybug),
    "lund_door": ("lund_door_colmap", lund_door),
    "kerry_park": ("kerry_park", kerry_park),
    "planar_unknown": ("planar_bearings", planar_unknown),
}


def main(arguments: list[str] | None = None) -> None:
    """Write the sections into the page; those that were not asked for are kept as they stand."""
    renew(
        "benchmarks.real_certificates",
        __doc__,
        SECTIONS,
        lambda name: f"Certificate: {name.replace('_', ' ')}",
        arguments=arguments,
        prefix=CERTIFICATES,
    )


if __name__ == "__main__":
    main()
