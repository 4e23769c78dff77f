"""From films and pictures to models, ours beside the peer: ``python -m benchmarks.end_to_end [--only CASE] [--quick]``.

The films are rendered walks with exact truth, kept in a temporary folder; making them is not measured. The peer is
pycolmap: ``extract_features``, ``match_sequential`` and ``global_mapping`` with equirectangular cameras on the
processor. Each run is a fresh process, ours first. Results are kept in a JSON file beside the page, so that a long run
can be done in pieces.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any, Literal

import numpy as np
from panopath.frontend.video import read_frames
from panopath.images import encoded
from panopath.model import Float
from panopath.walk import LAP_M, Walk, render_walk

from benchmarks.end_to_end_page import render
from benchmarks.end_to_end_tools import Answer, in_fresh_process
from benchmarks.run import load, machine, versions
from benchmarks.scoring import align, distances, rms

TIME_LIMIT_S = 3600.0
#: Frames that the peer is given of a film.
PEER_FRAMES = 60
_SPEED_M_S, _RATE_HZ, _LAPS = 2.8, 10.0, 1.05

Film = dict[str, Any]
STREET: Film = {"width_px": 1280, "n_frames": 264, "rotation": "tumble"}
HARD: Film = STREET | {"n_movers": 8, "operator_share": 0.2, "exposure_drift_stops": 1.0}
LOOP: Film = STREET | {
    "path": "loop",
    "rotation": "sway",
    "speed_m_s": _SPEED_M_S,
    "n_frames": round(_LAPS * LAP_M / _SPEED_M_S * _RATE_HZ),
}
LARGE: Film = STREET | {"width_px": 1920}


@dataclass(frozen=True)
class Case:
    """One film, and how it is taken."""

    title: str
    film: Film
    source: Literal["video", "images"] = "video"
    has_peer: bool = False
    #: The same without what makes it hard.
    clean: str | None = None
    #: Limits of the figures of :func:`figures_of`, by their names.
    at_least: dict[str, float] = field(default_factory=dict)
    at_most: dict[str, float] = field(default_factory=dict)

    def quick(self) -> Case:
        """Make it smaller: a quarter of the pixels and a third of the frames."""
        small = {"width_px": self.film["width_px"] // 2, "n_frames": self.film["n_frames"] // 3}
        faster = {"speed_m_s": 3.0 * _SPEED_M_S} if self.film.get("path") == "loop" else {}
        return Case(
            self.title, self.film | small | faster, self.source, self.has_peer, self.clean, self.at_least, self.at_most
        )


CASES: dict[str, Case] = {
    "street": Case(
        "street video, turning over",
        STREET,
        has_peer=True,
        at_least={"speedup": 10.0, "posed_share": 1.0},
        at_most={"rmse_over_allowed": 1.0},
    ),
    "images": Case(
        "60 of its frames as images",
        STREET,
        source="images",
        has_peer=True,
        at_least={"speedup": 5.0},
        at_most={"rmse_over_peer": 1.2},
    ),
    "hard": Case(
        "8 cars, operator over 20 % of the sphere, exposure drifts by a stop",
        HARD,
        clean="street",
        at_least={"is_determined": 1.0},
        at_most={"rmse_over_clean": 2.0},
    ),
    "loop": Case("closed loop", LOOP, at_least={"is_determined": 1.0}, at_most={"end_drift_percent": 0.1}),
    "large": Case("street video, turning over", LARGE, at_most={"peak_mb": 1500.0, "seconds_a_frame": 0.15}),
}


def film_of(options: Film, cache: Path) -> tuple[Walk, Path]:
    """Film a walk, unless the same film is there; another renderer makes another film."""
    walk = render_walk(**options)
    digest = hashlib.sha256(json.dumps(options, sort_keys=True).encode())
    digest.update(walk.frame(0).tobytes())
    path = cache / f"{digest.hexdigest()[:16]}.mp4"
    if not path.exists():
        cache.mkdir(parents=True, exist_ok=True)
        draft = path.with_name(f"part-{path.name}")
        print(f"  filming {len(walk)} frames ...", flush=True)
        walk.write_video(draft)
        draft.replace(path)
    return walk, path


def images_of(film: Path, n_frames: int, most: int) -> Path:
    """Write frames of a film, evenly spaced, as JPEG of high quality: what both tools see went through the film."""
    folder = film.with_suffix("")
    chosen = np.unique(np.linspace(0, n_frames - 1, min(most, n_frames)).round().astype(int)).tolist()
    if folder.exists() and len(list(folder.iterdir())) == len(chosen):
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    draft = folder.with_name(f"part-{folder.name}")
    shutil.rmtree(draft, ignore_errors=True)
    draft.mkdir(parents=True)
    for frame in read_frames(film, chosen, 2, color=True):
        assert frame.color is not None
        (draft / f"frame_{frame.index:06d}.jpg").write_bytes(encoded(frame.color, ".jpg", 95))
    draft.replace(folder)
    return folder


def run(tool: str, source: Path, time_limit_s: float) -> Answer:
    """One run in a fresh process."""
    print(f"  {tool} ... ", end="", flush=True)
    load_before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as out:
        answer = in_fresh_process(tool, source, Path(out) / "out", time_limit_s)
    if "error" in answer:
        print(answer["error"], flush=True)
    else:
        print(f"{answer['seconds']:.1f} s, {answer['cpu_s']:.1f} cpu s, {answer['peak_mb']:.0f} MB", flush=True)
    return answer | {"load_before": load_before}


def score(answer: Answer, walk: Walk) -> Answer:
    """Put errors against the truth in the place of positions."""
    if "error" in answer:
        return answer
    truth = walk.truth.centers
    frame = [int(name.removeprefix("frame_").split(".")[0]) for name in answer["names"]]
    at = truth[frame]
    centers = np.array(answer["centers"], dtype=np.float64).reshape(-1, 3)
    posed = np.asarray(np.isfinite(centers).all(axis=1))
    kept = {key: value for key, value in answer.items() if key not in {"names", "centers"}}
    kept |= {"n_posed": int(posed.sum()), "n_views": len(posed)}
    if posed.sum() < 3:
        return kept
    aligned = align(centers[posed], at[posed], rotate=True).apply(centers[posed])
    errors = distances(aligned, at[posed])
    length = path_length(truth)
    return kept | {
        "rmse_m": rms(errors),
        "rmse_percent": 100.0 * rms(errors) / length,
        "largest_m": float(errors.max()),
        # how far the way from the first to the last is off, where both agree on the whole
        "end_drift_percent": 100.0 * _end_drift(aligned, at[posed]) / length,
    }


def _end_drift(found: Float, truth: Float) -> float:
    return float(np.linalg.norm((found[-1] - found[0]) - (truth[-1] - truth[0])))


def path_length(centers: Float) -> float:
    """Length of a path in metres."""
    return float(np.linalg.norm(np.diff(centers, axis=0), axis=1).sum())


def middle(runs: Sequence[Answer]) -> Answer:
    """Choose the run of the median time, or the first that failed."""
    failed = next((one for one in runs if "error" in one), None)
    if failed is not None:
        return failed
    half = median([one["seconds"] for one in runs])
    return min(runs, key=lambda one: abs(one["seconds"] - half))


def figures_of(result: dict[str, Any], clean: dict[str, Any] | None) -> dict[str, float]:
    """Figures that limits are for; those that cannot be told are not there."""
    ours, peer = result["ours"], result.get("peer") or {}
    found: dict[str, float] = {}
    if "error" in ours:
        return {"is_determined": 0.0, "posed_share": 0.0}
    found["is_determined"] = float(ours["is_determined"])
    found["posed_share"] = ours["n_posed"] / ours["n_views"]
    found["peak_mb"] = ours["peak_mb"]
    found["seconds_a_frame"] = ours["seconds"] / result["n_frames"]
    if "rmse_m" not in ours:
        return found
    found |= {key: ours[key] for key in ("rmse_m", "rmse_percent", "end_drift_percent")}
    allowed = 1e-4 * result["path_m"]
    if "seconds" in peer:
        found["speedup"] = peer["seconds"] / ours["seconds"]
        found["cpu_ratio"] = peer["cpu_s"] / ours["cpu_s"]
    if "rmse_m" in peer:
        found["rmse_over_peer"] = ours["rmse_m"] / peer["rmse_m"]
        allowed = max(allowed, 1.5 * peer["rmse_m"])
    found["rmse_over_allowed"] = ours["rmse_m"] / allowed
    if clean is not None and "rmse_m" in clean["ours"]:
        found["rmse_over_clean"] = ours["rmse_m"] / clean["ours"]["rmse_m"]
    return found


def measure(case: Case, chosen: argparse.Namespace, peers: dict[str, Answer]) -> dict[str, Any]:
    """All runs of one case; a peer's run is used again for the same frames."""
    started = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    walk, film = film_of(case.film, chosen.cache)
    images = images_of(film, len(walk), PEER_FRAMES) if case.has_peer or case.source == "images" else None
    source = images if case.source == "images" and images is not None else film
    ours = middle([run("panopath", source, TIME_LIMIT_S) for _ in range(chosen.repeats)])
    peer = None
    if case.has_peer and images is not None and not chosen.no_peer:
        if film.name not in peers:
            peers[film.name] = run("pycolmap", images, TIME_LIMIT_S)
        peer = score(peers[film.name], walk)
    return {
        "film": case.film,
        "date": started,
        "machine": machine(),
        "versions": versions(),
        "n_frames": len(walk) if case.source == "video" or images is None else len(list(images.iterdir())),
        "path_m": path_length(walk.truth.centers),
        "repeats": chosen.repeats,
        "ours": score(ours, walk),
        "peer": peer,
    }


def verdicts(results: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """Figures beside their limits, of each case."""
    listed: dict[str, list[dict[str, Any]]] = {}
    for name, result in results.items():
        case = CASES[name]
        figures = figures_of(result, results.get(case.clean or ""))
        result["figures"] = figures
        listed[name] = [
            {"figure": key, "limit": limit, "value": figures.get(key), "at_least": at_least}
            for limits, at_least in ((case.at_least, True), (case.at_most, False))
            for key, limit in limits.items()
        ]
    return listed


def save(path: Path, results: dict[str, Any]) -> None:
    """Results in the order of the cases; written beside and moved, so that a broken run loses nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".json.part")
    draft.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)


def parse(arguments: list[str]) -> argparse.Namespace:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.end_to_end", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(CASES), help="only this case (may be repeated)")
    parser.add_argument("--quick", action="store_true", help="small and short films: proves the plumbing")
    parser.add_argument("--repeats", type=int, default=1, help="runs of ours; the median one counts")
    parser.add_argument("--no-peer", action="store_true", help="ours alone")
    parser.add_argument("--render", action="store_true", help="write the page from the results so far; measure nothing")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "panopath-end-to-end")
    parser.add_argument("-o", "--output", type=Path, help="page to write; results go beside it as .json")
    chosen = parser.parse_args(arguments)
    if chosen.output is None:
        chosen.output = Path("out/end-to-end-quick.md" if chosen.quick else "docs/benchmarks-end-to-end.md")
    return chosen


def main(arguments: list[str] | None = None) -> None:
    """Measure what was asked for, merge it into the results, write the page."""
    chosen = parse(sys.argv[1:] if arguments is None else arguments)
    store = chosen.output.with_suffix(".json")
    results = load(store)
    peers: dict[str, Answer] = {}
    if not chosen.render:
        for name in chosen.only or CASES:
            case = CASES[name].quick() if chosen.quick else CASES[name]
            print(f"{name}: {case.title}", flush=True)
            results[name] = measure(case, chosen, peers)
            results = {key: results[key] for key in CASES if key in results}
            save(store, results)
    listed = verdicts(results)
    save(store, results)
    page = render(results, {name: case.title for name, case in CASES.items()}, listed)
    chosen.output.write_text(page, encoding="utf-8")
    print(f"wrote {chosen.output}")


if __name__ == "__main__":
    main()
