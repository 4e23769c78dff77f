"""Tracks from matches of which some are wrong: ``python -m benchmarks.correspondence``.

Images stand on a ring and see the points near them; a visible point is found in an image with a chance of 0.8, and a
point that both images of a pair found is matched with the chance ``found``. A share of each pair's matches is wrong:
any feature of the one with any of the other (``random``), or with a look-alike of the right one (``twins``: a tenth of
the points have one near by, and these matches are wrong alike in all pairs).

The peer is union-find over all matches, ambiguous components dropped (Moulon and Monasse 2012).
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from panopath.steps.correspondence import CorrespondenceOptions, tracks_from_matches

from benchmarks.optional import load

Ids = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Matching:
    """Matches with their truth; features of all images in one count."""

    #: (n_images + 1,) where the features of each image begin.
    feature_starts: Ids
    #: (K,) the point that each feature shows.
    point: Ids
    #: (P, 2), (P + 1,), (N, 2) as :func:`panopath.steps.correspondence.tracks_from_matches` takes them.
    pairs: Ids
    match_starts: Ids
    matches: Ids

    def nodes(self) -> Ids:
        """(N, 2) the features of each match in the count of all."""
        first = self.feature_starts[np.repeat(self.pairs, np.diff(self.match_starts), axis=0)]
        return np.asarray(first + self.matches)

    def right(self) -> npt.NDArray[np.bool_]:
        """(N,) whether both features of a match show one point."""
        ends = self.point[self.nodes()]
        return np.asarray(ends[:, 0] == ends[:, 1])


def ring(
    n_images: int, n_points: int, span: int, *, found: float, wrong: float, kind: str = "random", seed: int = 0
) -> Matching:
    """Make matches; see the module's text. A point is in sight of about ``span`` images."""
    rng = np.random.default_rng(seed)
    place = rng.uniform(0, n_images, n_points)
    off = np.abs((np.arange(n_images)[:, None] - place[None, :] + n_images / 2) % n_images - n_images / 2)
    seen = (off < span / 2) & (rng.random(off.shape) < 0.8)
    points = [rng.permutation(np.flatnonzero(row)) for row in seen]
    feature = np.full(seen.shape, -1)
    for image, order in enumerate(points):
        feature[image, order] = np.arange(len(order))
    # the twin of a point is its neighbour along the ring
    by_place = np.argsort(place)
    twin = np.empty(n_points, dtype=np.int64)
    twin[by_place] = np.roll(by_place, 1)
    has_twin = rng.random(n_points) < 0.1
    pairs, matches = [], []
    for a in range(n_images):
        for b in range(a + 1, n_images):
            common = np.flatnonzero(seen[a] & seen[b])
            common = common[rng.random(len(common)) < found]
            if len(common) < 15:
                continue
            target = common.copy()
            if kind == "twins":
                confused = has_twin[common] & seen[b][twin[common]] & (rng.random(len(common)) < wrong)
                target[confused] = twin[common[confused]]
                right, false = np.stack((feature[a, common], feature[b, target]), axis=1), np.empty((0, 2), dtype=int)
            else:
                n_wrong = round(len(common) * wrong / (1 - wrong))
                right = np.stack((feature[a, common], feature[b, target]), axis=1)
                false = np.stack(
                    (rng.integers(len(points[a]), size=n_wrong), rng.integers(len(points[b]), size=n_wrong)), 1
                )
            pairs.append((a, b))
            matches.append(rng.permutation(np.concatenate((right, false))))
    return Matching(
        np.concatenate(([0], np.cumsum([len(p) for p in points]))),
        np.concatenate(points),
        np.array(pairs, dtype=np.int64),
        np.concatenate(([0], np.cumsum([len(m) for m in matches]))),
        np.concatenate(matches),
    )


def drop_ambiguous(matching: Matching) -> tuple[Ids, Ids]:
    """Node and track of each observation: components of all matches, those with two features of an image left out."""
    sparse, csgraph = load("scipy.sparse"), load("scipy.sparse.csgraph")
    nodes, n = matching.nodes(), len(matching.point)
    graph = sparse.coo_matrix((np.ones(len(nodes), dtype=np.int8), (nodes[:, 0], nodes[:, 1])), shape=(n, n))
    n_components, label = csgraph.connected_components(graph, directed=False)
    image = np.repeat(np.arange(len(matching.feature_starts) - 1), np.diff(matching.feature_starts))
    key = label.astype(np.int64) * len(matching.feature_starts) + image
    seen, count = np.unique(key, return_counts=True)
    bad = np.zeros(n_components, dtype=bool)
    bad[seen[count > 1] // len(matching.feature_starts)] = True
    keep = ~bad[label] & (np.bincount(label, minlength=n_components)[label] > 1)
    return np.flatnonzero(keep), label[keep].astype(np.int64)


def cut(min_linkage: float | None = None) -> Callable[[Matching], tuple[Ids, Ids]]:
    """Give our tracks in the form of :func:`drop_ambiguous`."""
    options = CorrespondenceOptions() if min_linkage is None else CorrespondenceOptions(min_linkage=min_linkage)

    def run(matching: Matching) -> tuple[Ids, Ids]:
        n_features = np.diff(matching.feature_starts)
        found = tracks_from_matches(n_features, matching.pairs, matching.match_starts, matching.matches, options)
        return matching.feature_starts[found.image] + found.feature, found.track.astype(np.int64)

    return run


def score(matching: Matching, node: Ids, track: Ids) -> dict[str, float]:
    """``kept``: observations that agree with most of their track, of those that a right match reaches; ``wrong``: the
    others, of all observations given; ``pieces``: tracks a point that has one.
    """  # noqa: D205
    reachable = len(np.unique(matching.nodes()[matching.right()]))
    if not len(node):
        return {"kept": 0.0, "wrong": 0.0, "pieces": float("nan")}
    point, key_of = matching.point[node], int(matching.point.max()) + 1
    keys, inverse, count = np.unique(track * key_of + point, return_inverse=True, return_counts=True)
    most = np.zeros(int(track.max()) + 1, dtype=np.int64)
    np.maximum.at(most, keys // key_of, count)
    agrees = (count[inverse] == most[track]) & (count[inverse] > 1)
    good = np.unique(track[agrees] * key_of + point[agrees])
    pieces = len(good) / len(np.unique(good % key_of)) if len(good) else float("nan")
    return {"kept": agrees.sum() / reachable, "wrong": 1 - agrees.mean(), "pieces": pieces}


METHODS: dict[str, Callable[[Matching], tuple[Ids, Ids]]] = {
    "drop ambiguous": drop_ambiguous,
    "cut, no linkage": cut(0.0),
    "cut": cut(),
}

CASES: dict[str, dict[str, Any]] = {
    f"{kind}, {found:.0%} found, {wrong:.0%} wrong": {
        "n_images": 100, "n_points": 4000, "span": 12, "found": found, "wrong": wrong, "kind": kind
    }
    for kind, found, wrong in (
        ("random", 0.9, 0.0), ("random", 0.9, 0.1), ("random", 0.9, 0.3), ("random", 0.4, 0.1), ("random", 0.4, 0.3),
        ("random", 0.2, 0.3), ("twins", 0.6, 0.1), ("twins", 0.6, 0.3),
    )
}  # fmt: skip


def main(repeats: int = 3) -> None:
    """Print the table."""
    print(f"{'case':34} {'method':16} {'matches':>9} {'kept':>7} {'wrong':>7} {'pieces':>7} {'seconds':>8}")
    large = {"n_images": 500, "n_points": 40000, "span": 26, "found": 0.6, "wrong": 0.2}
    for name, options in {**CASES, "500 images, random, 20% wrong": large}.items():
        matching = ring(**options)
        for method, run in METHODS.items():
            seconds = []
            for _ in range(repeats):
                began = time.perf_counter()
                node, track = run(matching)
                seconds.append(time.perf_counter() - began)
            figures = score(matching, node, track)
            print(
                f"{name:34} {method:16} {len(matching.matches):9d} {figures['kept']:7.1%} {figures['wrong']:7.2%} "
                f"{figures['pieces']:7.2f} {statistics.median(seconds):8.3f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
