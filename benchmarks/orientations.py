"""Rotation averaging against COLMAP's, on graphs of known truth: ``python -m benchmarks.orientations``.

A path of views, each joined to its neighbours along it, and bundles of loop closures between far places. Relative
rotations are noisy, and a share of them is wrong altogether. Errors are angles to the true orientation after the one
rotation of the world that fits best (medians' mean), degrees; times are medians of repeats, of the solver's call alone.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
from panopath.model import Bool, Float, Int

from benchmarks import optional


@dataclass(frozen=True)
class ViewGraph:
    """Edges between views, and the truth."""

    name: str
    first: Int
    second: Int
    #: (E, 3, 3) measured.
    second_from_first: Float
    wrong: Bool
    #: (n, 3, 3) truth.
    cam_from_world: Float

    @property
    def n_views(self) -> int:
        """Number of views."""
        return len(self.cam_from_world)


@dataclass(frozen=True)
class Answer:
    """What a program found."""

    cam_from_world: Float
    #: Which edges it kept, where it says so.
    inlier: Bool | None
    seconds: float


def view_graph(
    n_views: int,
    *,
    neighbours: int = 30,
    wrong: float = 0.2,
    noise_deg: float = 1.0,
    kind: str = "path",
    seed: int = 0,
) -> ViewGraph:
    """Make a graph: ``path`` with loop closures, ``random`` pairs, or ``grid``.

    ``neighbours`` counts the edges of a view, ``wrong`` is the share of edges that are random rotations; ``path`` has a
    tenth of its views' number of loop closures, in bundles of ten by ten views.
    """
    rng = np.random.default_rng(seed)
    n_views = round(n_views**0.5) ** 2 if kind == "grid" else n_views
    pairs = _PAIRS[kind](n_views, neighbours, rng)
    truth = _rotations(rng.normal(size=(n_views, 4)))
    first, second = pairs.T
    exact = truth[second] @ truth[first].transpose(0, 2, 1)
    measured = _exp(np.deg2rad(noise_deg) * rng.normal(size=(len(pairs), 3))) @ exact
    is_wrong: Bool = np.asarray(rng.random(len(pairs)) < wrong)
    measured[is_wrong] = _rotations(rng.normal(size=(int(is_wrong.sum()), 4)))
    name = f"{kind} {n_views:,}, {len(pairs):,} edges, {wrong:.0%} wrong"
    return ViewGraph(name, first.astype(np.int32), second.astype(np.int32), measured, is_wrong, truth)


def _path(n: int, neighbours: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    reach = neighbours // 2
    near = [np.stack([np.arange(n - k), np.arange(k, n)], axis=1) for k in range(1, reach + 1)]
    bundles = []
    for _ in range(max(1, n // 1000)):
        a, b = sorted(rng.choice(max(n - 10, 2), size=2, replace=False))
        grid = np.stack(np.meshgrid(np.arange(a, a + 10), np.arange(b, b + 10), indexing="ij"), axis=-1).reshape(-1, 2)
        bundles.append(grid)
    return _distinct(np.concatenate(near + bundles), n)


def _random(n: int, neighbours: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    chain = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    return _distinct(np.concatenate([chain, rng.integers(0, n, size=(n * neighbours // 2 - n, 2))]), n)


def _grid(n: int, neighbours: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    del neighbours, rng
    side = round(n**0.5)
    index = np.arange(side * side).reshape(side, side)
    across = np.stack([index[:, :-1].ravel(), index[:, 1:].ravel()], axis=1)
    down = np.stack([index[:-1].ravel(), index[1:].ravel()], axis=1)
    return np.concatenate([across, down])


_PAIRS: dict[str, Callable[[int, int, np.random.Generator], npt.NDArray[np.int64]]] = {
    "path": _path,
    "random": _random,
    "grid": _grid,
}


def _distinct(pairs: npt.NDArray[np.int64], n: int) -> npt.NDArray[np.int64]:
    ordered = np.sort(pairs, axis=1)
    ordered = ordered[(ordered[:, 0] != ordered[:, 1]) & (ordered[:, 1] < n)]
    return np.unique(ordered, axis=0)


def _rotations(quaternion: Float) -> Float:
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0))


def _exp(phi: Float) -> Float:
    angle = np.linalg.norm(phi, axis=1, keepdims=True)
    axis = phi / np.maximum(angle, 1e-300)
    return _rotations(np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * axis], axis=1))


def errors_deg(found: Float, truth: Float) -> Float:
    """Angle of each orientation to the truth, after the rotation of the world that fits best."""
    apart = found.transpose(0, 2, 1) @ truth
    keep: Bool = np.asarray(np.isfinite(apart).all(axis=(1, 2)))
    turn = apart[keep][0]
    for _ in range(20):
        weight = 1.0 / np.maximum(_angle(turn.T @ apart[keep]), 1e-3)
        u, _, vt = np.linalg.svd((weight[:, None, None] * apart[keep]).sum(axis=0))
        turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.where(keep, np.rad2deg(_angle(turn.T @ np.where(keep[:, None, None], apart, turn))), np.nan)


def _angle(rotation: Float) -> Float:
    chord = np.linalg.norm(rotation - np.eye(3), axis=(1, 2)) / np.sqrt(8.0)
    angle: Float = 2.0 * np.arcsin(np.minimum(chord, 1.0))
    return angle


def solve_panopath(graph: ViewGraph) -> Answer:
    """Ours."""
    begin = time.perf_counter()
    found = pp.average_rotations(graph.first, graph.second, graph.second_from_first, n_views=graph.n_views)
    return Answer(found.cam_from_world, found.inlier, time.perf_counter() - begin)


def solve_pycolmap(graph: ViewGraph) -> Answer:
    """COLMAP's global rotation averaging (L1, then re-weighted least squares), with its defaults."""
    pycolmap = optional.load("pycolmap")
    poses, reconstruction = _colmap_graph(pycolmap, graph)
    options = pycolmap.RotationEstimatorOptions()
    begin = time.perf_counter()
    pycolmap.run_rotation_averaging(options, poses, reconstruction, [])
    seconds = time.perf_counter() - begin
    found = np.full((graph.n_views, 3, 3), np.nan)
    for view in range(graph.n_views):
        image = reconstruction.image(view + 1)
        if image.has_pose:
            found[view] = image.cam_from_world().rotation.matrix()
    return Answer(found, None, seconds)


def _colmap_graph(pycolmap: Any, graph: ViewGraph) -> tuple[Any, Any]:
    reconstruction = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 500.0, 640, 480)
    reconstruction.add_camera_with_trivial_rig(camera)
    for view in range(graph.n_views):
        image = pycolmap.Image(name=f"{view}", camera_id=1, image_id=view + 1)
        reconstruction.add_image_with_trivial_frame(image)
    poses = pycolmap.PoseGraph()
    for a, b, matrix in zip(graph.first.tolist(), graph.second.tolist(), graph.second_from_first, strict=True):
        edge = pycolmap.PoseGraphEdge(pycolmap.Rigid3d(pycolmap.Rotation3d(matrix), np.zeros(3)))
        edge.num_matches = 100
        poses.add_edge(a + 1, b + 1, edge)
    return poses, reconstruction


SOLVERS: dict[str, Callable[[ViewGraph], Answer]] = {"panopath": solve_panopath, "pycolmap": solve_pycolmap}


def compare(graph: ViewGraph, repeats: int, solvers: list[str]) -> None:
    """Print one row for each program."""
    print(graph.name)
    for name in solvers:
        answers = [SOLVERS[name](graph) for _ in range(repeats)]
        seconds = statistics.median(answer.seconds for answer in answers)
        error = errors_deg(answers[-1].cam_from_world, graph.cam_from_world)
        known = np.isfinite(error)
        row = (
            f"  {name:10s} {seconds:9.3f} s   views {known.sum():6d}   error deg: mean {error[known].mean():8.4f}"
            f"  median {np.median(error[known]):8.4f}  max {error[known].max():8.3f}"
        )
        inlier = answers[-1].inlier
        if inlier is not None:
            hit = (~inlier & graph.wrong).sum()
            precision, recall = hit / max((~inlier).sum(), 1), hit / max(graph.wrong.sum(), 1)
            row += f"   wrong edges: precision {precision:.4f} recall {recall:.4f}"
        print(row, flush=True)


def main() -> None:
    """Compare on every size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--kinds", nargs="+", choices=list(_PAIRS), default=["path"])
    parser.add_argument("--wrong", type=float, nargs="+", default=[0.2])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--solvers", nargs="+", choices=list(SOLVERS), default=list(SOLVERS))
    chosen = parser.parse_args()
    for kind in chosen.kinds:
        for size in chosen.sizes:
            for wrong in chosen.wrong:
                compare(view_graph(size, kind=kind, wrong=wrong), chosen.repeats, chosen.solvers)


if __name__ == "__main__":
    main()
