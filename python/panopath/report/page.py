"""``report.html``: one page that says first whether a scene can be believed, then shows it, then how it came about.

The page is one file. Styles, script, pictures and numbers are inside; it asks for nothing from any network, and its
content policy forbids it to. Light and dark follow the reader's system. It is made from the records alone: thumbnails
need pictures (extra ``images``), everything else nothing but numpy.
"""

from __future__ import annotations

import base64
import contextlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from panopath import _core
from panopath.certificate import Certificate, Verdict
from panopath.certificate_text import LOOSE_VIEW
from panopath.errors import InputError
from panopath.images import Images, ImageSource, encoded, image_source, load_opencv
from panopath.model import Float, Scene, Status
from panopath.movers import resting
from panopath.report import page_figures as figures
from panopath.report.page_paths import Bodies, bodies_data, bodies_of, paths_section
from panopath.report.pictures import _axes, _in_time_order

#: Points drawn of a part, and parts offered.
_MOST_POINTS, _MOST_PARTS = 30_000, 8
#: Thumbnails, and their width in pixels.
_MOST_THUMBS, _THUMB_PX = 24, 320
#: Coordinates are kept as whole numbers up to this.
_STEPS = 65_535
#: Places of a path that is longer are thinned for the drawing.
_MOST_PLACES = 6_000

_Ids = npt.NDArray[np.intp]


@dataclass(frozen=True)
class ReportNotes:
    """What the page says beyond scene and certificate; everything may be left out."""

    title: str = "Camera path and space"
    #: A line below the title: what the source was recognised as.
    subtitle: str = ""
    #: Unit of the scene's coordinates, such as ``m``; empty where the scale is arbitrary.
    unit: str = ""
    #: Whether the world's z is up, so that the maps show x to the right and y ahead; else up is the cameras'.
    is_upright: bool = False
    #: Statements that belong to the answer: where up and scale come from, what was masked.
    statements: tuple[str, ...] = ()
    #: Seconds of each stage; default: those of ``scene.summary``.
    seconds: Mapping[str, float] | None = None
    #: What was written, path from the page's folder and what it is; files that are there get a link and their size.
    outputs: Mapping[str, str] = field(default_factory=dict)


def write_report(
    scene: Scene,
    certificate: Certificate | None,
    path: str | PathLike[str],
    images: Images | None = None,
    settings: Mapping[str, Any] | None = None,
    *,
    notes: ReportNotes | None = None,
    colours: npt.NDArray[np.uint8] | None = None,
) -> Path:
    """Write the report page.

    Parameters
    ----------
    scene
        What was found, in the plane or in space, of any of the solvers.
    certificate
        What is certain of it; None: the page says that nothing was certified.
    path
        The file. Links to outputs are relative to its folder.
    images
        Pictures of the views for thumbnails: files, or a function of the view's index; only those shown are asked for.
    settings
        Names and values, nested or not, that the result was made with.
    notes
        Title, statements, timings and outputs.
    colours
        (n_tracks, 3) uint8 colours of the points; default: by their error alone.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        Where an argument does not fit the scene, or the file cannot be written.
    """
    said = ReportNotes() if notes is None else notes
    if colours is not None and (colours.shape != (len(scene.points), 3) or colours.dtype != np.uint8):
        raise InputError(f"colours has shape {colours.shape}, expected uint8 ({len(scene.points)}, 3)")
    if certificate is not None and len(certificate.view_component) != len(scene.centers):
        raise InputError(
            f"certificate is of {len(certificate.view_component)} views, expected the scene's {len(scene.centers)}"
        )
    place = Path(path)
    parts = _parts(scene, said.is_upright)
    thumbs = [] if images is None else _thumbs(scene, parts, image_source(images, len(scene.centers)))
    data = {
        "unit": said.unit,
        "colours": colours is not None,
        "parts": [_part_data(scene, certificate, part, colours) for part in parts],
        "thumbs": thumbs,
    }
    body = "\n".join(
        part
        for part in (
            _header(said),
            _banner(scene, certificate),
            _facts(scene, parts, said),
            _map_section(scene, parts, colours is not None),
            paths_section(scene, said.unit),
            _thumb_section(thumbs, parts),
            _chosen(said),
            _charts(scene, parts),
            _certainty(scene, certificate),
            _outcome(scene, said, settings, place.parent),
        )
        if part
    )
    _write(place, _page(said, body, data))
    return place


def _page(notes: ReportNotes, body: str, data: dict[str, Any]) -> str:
    # `<` inside the data could end the script element
    plain = json.dumps(data, separators=(",", ":"), allow_nan=False, ensure_ascii=False).replace("<", "\\u003c")
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="generator" content="panopath {escape(_core.__version__)}">\n'
        f"<title>{escape(notes.title)}</title>\n<style>\n{_resource('page.css')}</style>\n</head>\n<body>\n<main>\n"
        f'{body}\n</main>\n<script type="application/json" id="data">{plain}</script>\n'
        f"<script>\n{_resource('page.js')}</script>\n</body>\n</html>\n"
    )


def _resource(name: str) -> str:
    return resources.files("panopath.report").joinpath(name).read_text(encoding="utf-8")


def _header(notes: ReportNotes) -> str:
    subtitle = f"<p class=quiet>{escape(notes.subtitle)}</p>" if notes.subtitle else ""
    return f"<header><h1>{escape(notes.title)}</h1>{subtitle}</header>"


# the verdict

_MEANING = {
    "determined": ("good", "✓", "Determined", "The path and the points are unique, and noise moves them little."),
    "weak": ("warn", "!", "Weak", "The shape is unique, but noise moves some of it far: use it with care."),
    "undetermined": (
        "bad",
        "✗",
        "Not determined",
        "Other scenes fit the same observations: do not measure here.",
    ),
    "contradicted": (
        "bad",
        "✗",
        "Contradicted",
        "The scene does not fit its own observations: something is wrong.",
    ),
    "unknown": ("none", "?", "Not certified", "Nothing was said about how certain this scene is."),
    "nothing": ("bad", "✗", "No answer", "Nothing could be determined from these observations."),
}


def _banner(scene: Scene, certificate: Certificate | None) -> str:
    if not np.isfinite(scene.centers).all(axis=1).any():
        kind = "nothing"
    elif certificate is None:
        kind = "unknown"
    elif certificate.verdict is not Verdict.UNDETERMINED and not certificate.consistency.passed:
        kind = "contradicted"
    else:
        kind = certificate.verdict.value
    tone, mark, word, meaning = _MEANING[kind]
    said = f"The solver ended as: {scene.summary.status.value.replace('_', ' ')}."
    reasons: list[str] = []
    if certificate is not None:
        said = certificate.sentence(scene.view_labels(), scene.track_labels()).partition(": ")[2]
        said = said[:1].upper() + said[1:] + "."
        reasons = list(certificate.consistency.reasons)
    listed = f"<ul>{''.join(f'<li>{escape(reason)}</li>' for reason in reasons)}</ul>" if reasons else ""
    return (
        f'<div class="banner {tone}" id="verdict">'
        f"<p class=word><span class=mark aria-hidden=true>{mark}</span>{word}</p>"
        f"<p class=meaning>{meaning}</p><p>{escape(said)}</p>{listed}</div>"
    )


def _facts(scene: Scene, parts: Sequence[_Part], notes: ReportNotes) -> str:
    summary = scene.summary
    solved = int(np.isfinite(scene.centers).all(axis=1).sum())
    facts = [
        (f"{solved:,} of {len(scene.centers):,}", "views placed"),
        (f"{int((np.isfinite(scene.points).all(axis=1) & resting(scene)).sum()):,}", "points"),
    ]
    if scene.paths is not None:
        facts.append((f"{int(scene.paths.moving.sum()):,}", "tracks that move"))
    known = np.isfinite(scene.residual_rad)
    if known.any():
        facts.append((f"{100.0 * scene.inlier[known].mean():.3g} %", "observations used"))
    if np.isfinite(summary.sigma_rad):
        facts.append((f"{np.degrees(summary.sigma_rad):.2g}°", "noise of a bearing"))
    if parts:
        steps = np.linalg.norm(np.diff(parts[0].path, axis=0), axis=1).sum()
        of = " (largest part)" if scene.n_components > 1 else ""
        facts.append((f"{steps:.3g} {notes.unit}".strip(), f"path length{of}" + ("" if notes.unit else ", no unit")))
    if scene.n_components > 1:
        facts.append((str(scene.n_components), "parts, each with its own scale"))
    seconds = sum(_seconds(scene, notes).values())
    if seconds > 0.0:
        facts.append((figures.duration(seconds), "in total"))
    told = "".join(f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>" for value, name in facts)
    return f'<section class="facts">{told}</section>'


def _seconds(scene: Scene, notes: ReportNotes) -> dict[str, float]:
    """Time of each stage; a total among them is not a stage."""
    seconds = scene.summary.seconds if notes.seconds is None else notes.seconds
    return {name: value for name, value in seconds.items() if name != "total" or len(seconds) == 1}


def _chosen(notes: ReportNotes) -> str:
    stated = "".join(f"<li>{escape(text)}</li>" for text in notes.statements)
    return f'<section class="chosen"><h2>What was chosen</h2><ul>{stated}</ul></section>' if stated else ""


# path and points


@dataclass(frozen=True, eq=False)
class _Part:
    """One component as it is drawn: coordinates right, ahead and up."""

    index: int
    views: _Ids
    tracks: _Ids
    #: (n, 3) and (m, 3); up is 0 in the plane.
    path: Float
    points: Float
    #: What moves, where anything does.
    bodies: Bodies | None = None


def _parts(scene: Scene, is_upright: bool) -> list[_Part]:
    sizes = np.bincount(scene.view_component[scene.view_component >= 0], minlength=scene.n_components)
    axes = np.zeros((3, scene.d))
    axes[: scene.d] = np.eye(3) if is_upright and scene.d == 3 else _axes(scene)
    parts = []
    for index in np.argsort(-sizes, kind="stable")[:_MOST_PARTS].tolist():
        members = (scene.view_component == index) & np.isfinite(scene.centers).all(axis=1)
        views = _in_order(scene, np.flatnonzero(members))
        placed = (scene.track_component == index) & np.isfinite(scene.points).all(axis=1) & resting(scene)
        tracks = np.flatnonzero(placed)
        if len(views):
            path, points = scene.centers[views] @ axes.T, scene.points[tracks] @ axes.T
            parts.append(_Part(index, views, tracks, path, points, bodies_of(scene, index, axes)))
    return parts


def _in_order(scene: Scene, views: _Ids) -> _Ids:
    """Put views as they were taken: by time, or else by name, since pictures of a walk are numbered."""
    time_s = None if scene.tracks is None else scene.tracks.time_s
    if scene.view_names is None or (time_s is not None and np.isfinite(time_s[views]).all()):
        return _in_time_order(scene, views)
    return views[np.asarray(_core.natural_order([scene.view_names[v] for v in views.tolist()]), dtype=np.intp)]


def _part_data(
    scene: Scene, certificate: Certificate | None, part: _Part, colours: npt.NDArray[np.uint8] | None
) -> dict[str, Any]:
    shown = _spread(len(part.tracks), _MOST_POINTS)
    # far points would take the digits of near ones: what lies beyond every picture is not drawn
    drawings = _drawings(part, scene.d)
    reach = 6.0 * max(max(box[2] - box[0], box[3] - box[1]) for _, box in drawings)
    middle = part.path.mean(axis=0)
    near = np.abs(part.points[shown] - middle).max(axis=1) <= reach
    shown = shown[near]
    points = part.points[shown]
    low = points.min(axis=0) if len(points) else np.zeros(3)
    step = (points.max(axis=0) - low) / _STEPS if len(points) else np.ones(3)
    step = np.where(step > 0.0, step, 1.0)
    error = scene.point_statistics().rms_rad[part.tracks[shown]]
    known = np.isfinite(error)
    top = float(np.percentile(error[known], 95.0)) if known.any() else 1.0
    graded = np.full(len(shown), 255, dtype=np.uint8)
    graded[known] = np.clip(error[known] / (top or 1.0), 0.0, 1.0) * 254
    places = _spread(len(part.views), _MOST_PLACES)
    views = part.views[places]
    counts = scene.view_statistics().n_inliers[views]
    labels = scene.view_labels()
    return {
        "moving": None if part.bodies is None else bodies_data(scene, part.bodies, views, middle, reach),
        "points": _base64(((points - low) / step).round().astype("<u2").tobytes()),
        "total": len(part.tracks),
        "low": low.tolist(),
        "step": step.tolist(),
        "rgb": None if colours is None else _base64(colours[part.tracks[shown]].tobytes()),
        "error": _base64(graded.tobytes()),
        "path": [[float(f"{value:.6g}") for value in row] for row in part.path[places].tolist()],
        "views": views.tolist(),
        "names": [labels[v] for v in views.tolist()],
        "counts": counts.tolist(),
        "loose": _loose(certificate, views),
        "axes": [axes.tolist() for axes, _ in drawings],
        "boxes": [box for _, box in drawings],
    }


def _loose(certificate: Certificate | None, views: _Ids) -> list[int]:
    """Places of the views that nothing holds, or that are held loosely."""
    if certificate is None:
        return []
    loose = (certificate.view_component[views] < 0) | ~(certificate.view_looseness[views] <= LOOSE_VIEW)
    return np.flatnonzero(loose).tolist()


def _drawings(part: _Part, d: int) -> list[tuple[Float, list[float]]]:
    """Axes (2, 3) and box of the views from above and from the side, along which the path is longest."""
    above = np.eye(3)[:2]
    flat = (part.path - part.path.mean(axis=0))[:, :2]
    main = np.linalg.svd(flat, full_matrices=False)[2][0] if len(flat) > 1 and flat.any() else np.array([1.0, 0.0])
    main = main if main[np.argmax(np.abs(main))] > 0.0 else -main
    side = np.array([[main[0], main[1], 0.0], [0.0, 0.0, 1.0]])
    return [(axes, _box(part, axes)) for axes in ((above,) if d == 2 else (above, side))]


def _box(part: _Part, axes: Float) -> list[float]:
    """Left, low, right and high of a picture: the path, and the points around it."""
    places = part.points if part.bodies is None else np.concatenate((part.points, part.bodies.places))
    path, points = part.path @ axes.T, places @ axes.T
    low, high = path.min(axis=0), path.max(axis=0)
    size = float((high - low).max())
    if len(points):
        away = np.abs(points - 0.5 * (low + high)).max(axis=1)
        reach = min(float(np.percentile(away, 92.0)), 2.0 * float(np.median(away)))
        near = points[away <= min(max(reach, size), 5.0 * size if size > 0.0 else np.inf)]
        if len(near):
            inner = np.percentile(near, (1.0, 99.0), axis=0)
            low, high = np.minimum(low, inner[0]), np.maximum(high, inner[1])
    pad = 0.06 * float((high - low).max()) or 1.0
    return [*(low - pad).tolist(), *(high + pad).tolist()]


def _map_section(scene: Scene, parts: Sequence[_Part], has_colours: bool) -> str:
    if not parts:
        return ""
    names = ["From above"] + (["From the side, along the path"] if scene.d == 3 else [])
    maps = "".join(
        f'<figure><canvas role="img" aria-label="{name}"></canvas><div class=tip hidden></div>'
        f"<figcaption>{name}</figcaption></figure>"
        for name in names
    )
    choice = ""
    if len(parts) > 1:
        options = "".join(
            f"<option value={k}>part {part.index + 1}: {len(part.views):,} views, {len(part.tracks):,} points</option>"
            for k, part in enumerate(parts)
        )
        choice = f'<select id="part" aria-label="part">{options}</select>'
    kinds = [("picture", "Colours of the pictures", True), ("error", "Error of each point", False)]
    if not has_colours:
        kinds = [("error", "Error of each point", True)]
    painted = "".join(
        f'<button data-colour={kind} aria-pressed={str(on).lower()}>{text}</button>' for kind, text, on in kinds
    ) if has_colours else "<span class=quiet>points by their error, blue small, red large</span>"  # fmt: skip
    bar = (
        f"<div class=bar>{choice}{painted}<span id=shown class='quiet grow'></span>"
        '<button data-zoom=1.5 aria-label="nearer">+</button><button data-zoom=0.667 aria-label="farther">-</button>'
        "<button data-zoom=0>whole</button></div>"
    )
    note = (
        "<p class=quiet>White: first view, black: last, red: held loosely. Drag to move, double click or Ctrl + wheel "
        "to zoom, point at the path for its views.</p>"
    )
    clock = ""
    if any(part.bodies is not None for part in parts):
        clock = (
            "<div class=bar id=clock><button id=play aria-pressed=false>Play</button>"
            '<input type=range id=time class=grow min=0 max=1000 value=500 step=1 aria-label="time">'
            "<output id=now></output></div><p class=quiet id=moving></p>"
        )
    return f"<section id=map><h2>Path and points</h2>{note}{bar}<div class=maps>{maps}</div>{clock}</section>"


# pictures


def _thumbs(scene: Scene, parts: Sequence[_Part], source: ImageSource) -> list[dict[str, Any]]:
    """Small pictures of views, spread evenly along the parts."""
    views = np.concatenate([part.views for part in parts]) if parts else np.empty(0, dtype=np.intp)
    cv2, labels = load_opencv(), scene.view_labels()
    found = []
    for view in views[_spread(len(views), _MOST_THUMBS)].tolist():
        picture = source(view)
        if picture is None:
            continue
        height = max(1, round(picture.shape[0] * _THUMB_PX / picture.shape[1]))
        small = cv2.resize(picture, (_THUMB_PX, height), interpolation=cv2.INTER_AREA)
        data = _base64(encoded(small, ".jpg", 72))
        found.append({"view": view, "name": labels[view], "src": f"data:image/jpeg;base64,{data}"})
    return found


def _thumb_section(thumbs: Sequence[dict[str, Any]], parts: Sequence[_Part]) -> str:
    if not thumbs:
        return ""
    n_views = sum(len(part.views) for part in parts)
    shown = "".join(
        f'<button data-view={thumb["view"]} aria-pressed=false title="{escape(thumb["name"])}">'
        f'<img src="{thumb["src"]}" alt=""><span>{escape(thumb["name"])}</span></button>'
        for thumb in thumbs
    )
    note = f"{len(thumbs)} of {n_views:,} placed views, evenly along the path. Click one to find it in the maps above."
    return f"<section id=views><h2>Views</h2><p class=quiet>{note}</p><div class=strip>{shown}</div></section>"


# figures and lists


def _charts(scene: Scene, parts: Sequence[_Part]) -> str:
    order = np.concatenate([part.views for part in parts]) if parts else np.empty(0, dtype=np.intp)
    charts = (
        figures.sphere_maps(scene)
        + figures.residuals(scene)
        + figures.track_lengths(scene)
        + figures.observations_along(scene, order)
    )
    return f"<div class=two>{charts}</div>" if charts else ""


def _certainty(scene: Scene, certificate: Certificate | None) -> str:
    if certificate is None:
        return ""
    lines = certificate.explain(scene.view_labels(), scene.track_labels(), (scene.centers, scene.points))[1:]
    rows = []
    for name, (value, limit) in sorted(certificate.consistency.statistics.items()):
        rows.append((name.replace("_", " "), f"{value:.3g} (limit {limit:.3g})"))
    gate = f"<h2 style='margin-top:14px'>Against its bearings</h2>{figures.table(rows)}" if rows else ""
    told = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<section><details><summary>The certificate in full</summary><ul>{told}</ul>{gate}</details></section>"


def _outcome(scene: Scene, notes: ReportNotes, settings: Mapping[str, Any] | None, folder: Path) -> str:
    parts = [figures.timings(list(_seconds(scene, notes).items())), _outputs(notes.outputs, folder)]
    pair = "".join(part for part in parts if part)
    told = f"<div class=two>{pair}</div>" if pair else ""
    rows = figures.flattened(dict(settings)) if settings else []
    rows.append(("panopath", _core.__version__))
    rows.append(("status of the solver", scene.summary.status.value.replace("_", " ")))
    if scene.summary.status is Status.MAX_ITERATIONS:
        rows.append(("note", "the solver stopped at its limit of steps; the scene may still move"))
    return f"{told}<section><details><summary>Settings</summary>{figures.table(rows)}</details></section>"


def _outputs(outputs: Mapping[str, str], folder: Path) -> str:
    if not outputs:
        return ""
    rows = []
    for name, what in outputs.items():
        there = folder / name
        size = figures.size_of(there.stat().st_size) if there.is_file() else ""
        shown = f'<a href="{escape(_address(name))}">{escape(name)}</a>' if there.exists() else escape(name)
        rows.append(f"<tr><td>{shown}<br><span class=quiet>{escape(what)}</span></td><td class=number>{size}</td></tr>")
    return f"<section><h2>Files</h2><p class=quiet>Beside this page.</p><table>{''.join(rows)}</table></section>"


def _address(name: str) -> str:
    """Relative address of a file; what has a meaning in addresses is escaped."""
    return "./" + "".join(c if c.isalnum() or c in "-_./~" else "".join(f"%{b:02X}" for b in c.encode()) for c in name)


def _write(path: Path, text: str) -> None:
    staged = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        staged.write_text(text, encoding="utf-8")
        os.replace(staged, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
    finally:
        with contextlib.suppress(OSError):
            staged.unlink(missing_ok=True)


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _spread(count: int, most: int) -> _Ids:
    """At most ``most`` indices, evenly spread, first and last among them."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).astype(np.intp)
