"""Tracks from matches, from Python; the method is tested in Rust."""

from __future__ import annotations

from typing import Any

import numpy as np
import panopath as pp
import pytest

N_FEATURES = [2, 3, 2]
PAIRS = [[0, 1], [1, 2]]
STARTS = [0, 2, 3]
MATCHES = [[0, 2], [1, 0], [2, 1]]


def test_tracks() -> None:
    found = pp.tracks_from_matches(N_FEATURES, PAIRS, STARTS, MATCHES)
    assert found.n_tracks == 2
    assert len(found) == 5
    assert found.n_cut == 0
    assert found.image.tolist() == [0, 1, 2, 0, 1]
    assert found.feature.tolist() == [0, 2, 1, 1, 0]
    assert found.track.tolist() == [0, 0, 0, 1, 1]
    assert {array.dtype for array in (found.image, found.track, found.feature)} == {np.dtype(np.int32)}
    with pytest.raises(ValueError, match="read-only"):
        found.track[0] = 1
    long = pp.tracks_from_matches(N_FEATURES, PAIRS, STARTS, MATCHES, pp.CorrespondenceOptions(min_images=3))
    assert long.n_tracks == 1


def test_a_wrong_match_is_cut() -> None:
    # points 0 and 1 in four images, all pairs matched, and one match from the one to the other
    pairs = [(a, b) for a in range(4) for b in range(a + 1, 4)]
    matches = [[[0, 0], [1, 1]] for _ in pairs]
    matches[2].insert(0, [0, 1])
    starts = np.cumsum([0, *map(len, matches)])
    found = pp.tracks_from_matches([2] * 4, pairs, starts, np.concatenate(matches))
    assert (found.n_tracks, found.n_cut) == (2, 1)
    np.testing.assert_array_equal(found.feature, found.track)


def test_nothing_is_an_answer() -> None:
    assert pp.tracks_from_matches([], [], [0], []).n_tracks == 0
    assert len(pp.tracks_from_matches([4, 4], [[0, 1]], [0, 0], [])) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n_features": [2, -3, 2]}, r"n_features\[1\] is -3, expected 0 or more"),
        ({"n_features": [2.5, 3, 2]}, "n_features has type float64, expected whole numbers"),
        ({"pairs": [[0, 1], [1, 3]]}, r"pairs\[1\] is \(1, 3\), expected two different images below 3"),
        ({"pairs": [[0, 1], [1, -1]]}, r"pairs\[1\] is \[1, -1\], expected 0 or more"),
        ({"pairs": [0, 1]}, r"pairs has shape \(2,\), expected \(n, 2\)"),
        ({"match_starts": [0, 2]}, "match_starts has 2 entries, expected 3"),
        ({"match_starts": [0, 4, 3]}, "match_starts has 3 entries, expected 3 that ascend from 0 to 3"),
        ({"matches": [[0, 2], [1, 3], [2, 1]]}, r"matches\[1\] names feature 3 of image 1, which has 3 features"),
        ({"matches": [[0, 2], [1, 2**40], [2, 1]]}, "matches holds 1099511627776, expected numbers below 2147483648"),
        ({"options": pp.CorrespondenceOptions(min_images=1)}, "min_images is 1, expected a whole number, 2 or more"),
        ({"options": pp.CorrespondenceOptions(min_linkage=1.5)}, "min_linkage is 1.5, expected a share from 0 to 1"),
        ({"options": {"min_images": 2}}, "options is a dict, expected CorrespondenceOptions"),
    ],
)
def test_errors_name_the_argument(change: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {"n_features": N_FEATURES, "pairs": PAIRS, "match_starts": STARTS, "matches": MATCHES}
    with pytest.raises(pp.InputError, match=message):
        pp.tracks_from_matches(**{**good, **change})
