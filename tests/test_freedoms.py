"""What bodies that move leave free: ranks against a matrix built apart, names, null vectors that are followed far."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import panopath as pp
import pytest
from panopath.counting import PathGroup, mixed_inequality, shared_functions
from panopath.paths import PathModel

Float = npt.NDArray[np.float64]

LINE, PARABOLA, CUBIC = (pp.Taylor(k, 5.0, 5.0) for k in (1, 2, 3))
WAVE = pp.Fourier(1, 0.9)
SPLINE = pp.Spline((0.0, 3.0, 6.0, 10.0), 2)


@dataclass(frozen=True)
class World:
    """Views, paths, and who sees whom."""

    centers: Float
    time_s: Float
    models: tuple[PathModel, ...]
    coefficients: tuple[Float, ...]
    seen: npt.NDArray[np.bool_]

    @property
    def pairs(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        view, track = np.nonzero(self.seen)
        return view, track

    def positions(self, centers: Float, coefficients: Float) -> Float:
        """Segments of all observations."""
        starts = np.cumsum([0, *(model.n_functions for model in self.models)])
        place = np.stack(
            [
                pp.paths.path_functions(model, self.time_s) @ coefficients[starts[j] : starts[j + 1]]
                for j, model in enumerate(self.models)
            ]
        )
        view, track = self.pairs
        return np.asarray(place[track, view] - centers[view])

    def ask(self, sigma_rad: float = 0.0, count: bool = True, **options: Any) -> pp.PathCertificate:
        """Certify it."""
        view, track = self.pairs
        flat = np.concatenate(self.coefficients)
        segments = self.positions(self.centers, flat)
        length = np.linalg.norm(segments, axis=1, keepdims=True)
        known = np.isfinite(length[:, 0])
        d, n, m = self.centers.shape[1], len(self.models), len(self.centers)
        bearing = np.where(known[:, None], segments / length, np.eye(d)[0])
        tracks = pp.Tracks.from_arrays(
            view=view, track=track, bearing=bearing, n_views=m, n_tracks=n, time_s=self.time_s
        )
        nowhere = np.full((n, d), np.nan)
        paths = pp.Paths(
            models=self.models,
            starts=np.cumsum([0, *(model.n_functions for model in self.models)]),
            coefficients=flat,
            covariances=None,
            seen_s=np.full((n, 2), np.nan),
            verdicts=(pp.PathVerdict.UNDETERMINED,) * n,
            hidden_by=np.full(n, -1),
            body=np.full(n, -1),
        )
        scene = pp.Scene(
            centers=self.centers,
            points=nowhere,
            view_component=np.zeros(m, dtype=np.int32),
            track_component=np.zeros(n, dtype=np.int32),
            inlier=np.full(len(view), count),
            residual_rad=np.zeros(len(view)),
            cam_from_world=np.zeros(m) if d == 2 else np.tile(np.eye(3), (m, 1, 1)),
            summary=pp.Summary(status=pp.Status.CONVERGED, iterations=0, sigma_rad=float("nan")),
            paths=paths,
        )
        return pp.certify_paths(tracks, scene, pp.FreedomOptions(sigma_rad=sigma_rad, **options))

    def nullity(self) -> int:
        """By singular values of all equations, columns scaled, members that nothing sees left out."""
        view, track = self.pairs
        d, m = self.centers.shape[1], len(self.centers)
        starts = np.cumsum([0, *(model.n_functions for model in self.models)])
        rows = np.zeros((len(view), d, m + starts[-1], d))
        u = self.positions(self.centers, np.concatenate(self.coefficients))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        across = np.eye(d) - u[:, :, None] * u[:, None, :]
        rows[np.arange(len(view)), :, view] = -across
        for j, model in enumerate(self.models):
            mine = np.flatnonzero(track == j)
            functions = pp.paths.path_functions(model, self.time_s[view[mine]])
            rows[mine, :, m + starts[j] : m + starts[j + 1]] = np.einsum("nk,nrc->nrkc", functions, across[mine])
        matrix = rows.reshape(len(view) * d, -1)
        size = np.linalg.norm(matrix, axis=0)
        matrix = matrix[:, size > 0.0] / size[size > 0.0]
        values = np.linalg.svd(matrix, compute_uv=False)
        return int(matrix.shape[1] - (values > 1e-9 * values[0]).sum())


def world(  # noqa: PLR0917
    d: int,
    models: Sequence[PathModel],
    n_views: int = 16,
    moves: bool = True,
    center: Callable[[Float], Float] | None = None,
    seed: int = 1,
) -> World:
    """Bodies around a camera that wanders, or goes as it is told; everything seen."""
    rng = np.random.default_rng(seed)
    time_s = np.sort(rng.uniform(0.0, 10.0, n_views))
    coefficients = []
    for model in models:
        place = rng.normal(size=d)
        place *= 4.0 / np.linalg.norm(place)
        path = 0.3 * rng.normal(size=(model.n_functions, d)) * moves
        path[: None if isinstance(model, pp.Spline) else 1] += place
        coefficients.append(path)
    centers = rng.normal(size=(n_views, d)) if center is None else center(time_s)
    return World(centers, time_s, tuple(models), tuple(coefficients), np.ones((n_views, len(models)), dtype=np.bool_))


def along(direction: Sequence[float]) -> Callable[[Float], Float]:
    """Go straight on at constant speed."""
    return lambda time_s: np.asarray(1.0 + np.outer(time_s, direction))


def noisy(of: World, sigma: float, seed: int = 3) -> World:
    """Where noise of about this size puts all."""
    rng = np.random.default_rng(seed)
    moved = tuple(c + 0.3 * sigma * rng.normal(size=c.shape) for c in of.coefficients)
    return replace(of, centers=of.centers + 0.3 * sigma * rng.normal(size=of.centers.shape), coefficients=moved)


def kinds(found: pp.PathCertificate) -> list[str]:
    return [freedom.kind.value for freedom in found.freedoms]


def check(of: World, found: pp.PathCertificate) -> None:
    """Compare the nullity with the rank; dimensions add up; null vectors keep the bearings however far one goes."""
    assert found.nullity == of.nullity()
    assert sum(freedom.dimension for freedom in found.freedoms if freedom.is_exact) == found.extra
    flat = np.concatenate(of.coefficients)
    before = of.positions(of.centers, flat)
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    for freedom in found.freedoms:
        for vector in freedom.vectors if freedom.is_exact else ():
            assert vector.value < 1e-9
            after = of.positions(*vector.moved(of.centers, flat, 0.7))
            sideways = after - (after * before).sum(axis=1, keepdims=True) * before
            assert np.abs(sideways).max() < 1e-9
    for track, vectors in found.null.items():
        start = sum(model.n_functions for model in of.models[:track])
        for vector in vectors:
            moved = flat.copy()
            moved[start : start + len(vector)] += vector
            after = of.positions(of.centers, moved)
            sideways = after - (after * before).sum(axis=1, keepdims=True) * before
            assert np.abs(sideways).max() < 1e-6


FORMS: dict[str, tuple[PathModel, int]] = {
    "taylor:1": (LINE, 1),
    "taylor:2": (PARABOLA, 2),
    "taylor:3": (CUBIC, 3),
    "fourier:1": (WAVE, 2),
    "fourier:2": (pp.Fourier(2, 0.9), 4),
    "fourier:3": (pp.Fourier(3, 0.7), 6),
    "spline": (SPLINE, 4),
}


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("anchors", [0, 1, 2])
@pytest.mark.parametrize("moves", [True, False])
def test_nullities_are_those_of_the_page(d: int, form: str, anchors: int, moves: bool) -> None:
    model, beyond = FORMS[form]
    of = world(d, [pp.Static()] * anchors + [model] * (5 + beyond), 12 + 3 * beyond, moves)
    found = of.ask()
    check(of, found)
    common = 0 if anchors else d * beyond
    scales = beyond if not moves and anchors < 2 else 0
    assert found.extra == common + scales
    assert sum(freedom.dimension for freedom in found.freedoms if freedom.kind == "common_motion") == common
    assert sum(freedom.dimension for freedom in found.freedoms if freedom.kind == "scale_in_time") == scales
    assert all(reach is pp.Reach.DETERMINED for reach in found.reaches)
    assert found.is_determined == (found.extra == 0)


def test_the_paper_s_linear_model_in_space() -> None:
    """Point 7 of the errata: 7 is the gauge of bodies that move, 8 that of the same model where nothing does."""
    assert world(3, [LINE] * 6).ask().nullity == 7
    found = world(3, [LINE] * 6, moves=False).ask()
    assert found.nullity == 8
    assert kinds(found) == ["common_motion", "scale_in_time"]
    one_moves = world(3, [LINE] * 6, moves=False)
    one_moves.coefficients[2][1] = [0.3, 0.1, -0.2]
    assert one_moves.ask().nullity == 7


@pytest.mark.parametrize("d", [2, 3])
def test_orders_and_harmonics_are_named(d: int) -> None:
    orders = [(f.kind.value, f.order, f.dimension) for f in world(d, [PARABOLA] * 8, 20, moves=False).ask().freedoms]
    assert orders == [("common_motion", k, d) for k in (1, 2)] + [("scale_in_time", k, 1) for k in (1, 2)]
    mixed = world(d, [LINE] * 4 + [PARABOLA] * 4 + [SPLINE] * 4, 24).ask()
    assert [(f.kind.value, f.order, f.dimension) for f in mixed.freedoms] == [("common_motion", 1, d)]
    waves = world(d, [pp.Static()] + [pp.Fourier(2, 0.9)] * 8, 24, moves=False).ask()
    assert [(f.order, f.omega_rad_s, f.dimension) for f in waves.freedoms] == [(1, 0.9, 2), (2, 0.9, 2)]
    assert waves.freedoms[0].tracks.tolist() == [0]
    assert world(d, [LINE] * 6 + [WAVE] * 6, 24).ask().is_determined


def test_the_stretch_of_a_scale_in_time_is_its_lambda() -> None:
    of = world(3, [pp.Static()] + [LINE] * 8, moves=False)
    (freedom,) = of.ask().freedoms
    stretch = freedom.vectors[0].stretch
    line = np.polyfit(of.time_s, stretch, 1)
    assert abs(line[0]) > 1e-3
    assert np.allclose(np.polyval(line, of.time_s), stretch, atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_a_camera_at_constant_speed_imitates_lines(d: int) -> None:
    straight = along([0.3, 0.5, -0.2][:d])
    of = world(d, [pp.Static()] * 6 + [LINE] * 2 + [PARABOLA] * 2, center=straight)
    found = of.ask()
    check(of, found)
    assert kinds(found) == ["imitated"]
    assert found.freedoms[0].tracks.tolist() == [6, 7, 8, 9]
    assert found.verdict(6, moves=True) is pp.PathVerdict.IMITATED
    assert np.isinf(found.movement[6])
    assert found.camera_part[6] < 1e-9
    # drawing all tracks along is the scale of everything, which is not counted twice
    of = world(d, [LINE] * 6, center=straight)
    found = of.ask()
    check(of, found)
    assert [(f.kind.value, f.dimension) for f in found.freedoms] == [("common_motion", d), ("imitated", 5)]


@pytest.mark.parametrize("d", [2, 3])
def test_a_camera_at_rest_imitates_everything(d: int) -> None:
    of = world(d, [pp.Static()] * 6 + [LINE] * 2 + [WAVE], center=lambda time_s: np.ones((len(time_s), d)))
    found = of.ask()
    check(of, found)
    assert kinds(found) == ["imitated", "in_line"]
    assert found.reaches[0] is pp.Reach.IN_LINE


@pytest.mark.parametrize("d", [2, 3])
def test_what_hides_behind_a_point_is_named_with_it(d: int) -> None:
    of = world(d, [pp.Static()] * 8 + [LINE] * 2)
    s = (of.time_s - 5.0) / 5.0
    place, velocity = np.arange(1.0, d + 1.0), np.arange(1.0, d + 1.0)[::-1] * 0.8
    ahead = place + np.outer(s, velocity)
    of = replace(of, centers=ahead / (1.0 + s**2)[:, None])
    of.coefficients[0][:] = 0.0
    # on the far side of point 0, for a camera that swings about it
    of.coefficients[8][:] = [-0.5 * place, -0.5 * velocity]
    found = of.ask()
    check(of, found)
    assert kinds(found) == ["hidden"]
    assert (found.hidden_by[8], found.reaches[8]) == (0, pp.Reach.HIDDEN)
    assert found.verdict(8, moves=True) is pp.PathVerdict.HIDDEN
    assert found.track_words(8) == (
        "point 8 is not determined because it is in one direction with point 0 whenever it is seen"
    )


@pytest.mark.parametrize("d", [2, 3])
def test_sets_that_hang_loose(d: int) -> None:
    of = world(d, [pp.Static()] * 8 + [LINE] * 8, 20)
    early = np.arange(20) < 10
    of.seen[:] = early[:, None] == (np.arange(16) % 2 == 0)
    found = of.ask()
    check(of, found)
    assert kinds(found) == ["disconnected"]
    of.seen[:, 1] = True
    found = of.ask()
    check(of, found)
    (loose,) = found.freedoms
    assert loose.kind is pp.FreedomKind.LOOSE_SET
    # one half moves against the other, about the point that both see
    assert len({bool(early[view]) for view in loose.views}) == 1
    assert 1 not in loose.tracks

    alone = world(d, [pp.Static()] * 8 + [LINE] * 8, 20)
    alone.seen[3, 1:] = False
    found = alone.ask()
    check(alone, found)
    assert [(f.kind.value, f.views.tolist()) for f in found.freedoms] == [("loose_view", [3])]

    few = world(d, [pp.Static()] * 8 + [LINE] * 8, 20)
    few.seen[1:, 9] = False
    found = few.ask()
    check(few, found)
    assert (kinds(found), found.freedoms[0].tracks.tolist()) == (["too_few"], [9])


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("sigma", [1e-4, 1e-3])
def test_what_noise_leaves_free_has_the_same_names(d: int, sigma: float) -> None:
    still = noisy(world(d, [pp.Static()] + [PARABOLA] * 30, 40, moves=False), sigma).ask(sigma)
    assert still.nullity == d + 1
    assert [(f.kind.value, f.order, f.is_exact) for f in still.freedoms] == [
        ("scale_in_time", 1, False),
        ("scale_in_time", 2, False),
    ]
    assert noisy(world(d, [pp.Static()] + [PARABOLA] * 30, 40), sigma).ask(sigma).is_determined

    road = [pp.Static()] * 30 + [LINE] * 3
    straight = noisy(world(d, road, 40, center=along([0.3, 0.5, -0.2][:d])), sigma).ask(sigma)
    assert [(f.kind.value, f.is_exact, f.tracks.tolist()) for f in straight.freedoms] == [
        ("imitated", False, [30, 31, 32])
    ]
    assert (straight.movement[30:] > 0.5).all()
    assert "as far as noise tells" in straight.track_words(30)

    def swinging(time_s: Float) -> Float:
        sway = 0.5 * np.sin(np.outer(time_s, [1.0, 2.0, 3.0][:d]))
        return np.asarray(along([0.3, 0.5, -0.2][:d])(time_s) + sway)

    swings = noisy(world(d, road, 40, center=swinging), sigma).ask(sigma)
    assert swings.is_determined
    assert (swings.movement < 0.1).all()
    assert (swings.camera_part[30:] > 10.0 * sigma).all()


@pytest.mark.parametrize("d", [2, 3])
def test_many_views_and_many_tracks_by_inverse_iteration(d: int) -> None:
    """More than 400 unknowns on both sides; what is free is known from smaller worlds."""
    for models, beyond in (([LINE] * 220, d), ([pp.Static()] * 2 + [LINE] * 220, 0)):
        of = world(d, models, 220)
        of.seen[:] = np.random.default_rng(5).uniform(size=of.seen.shape) < 0.1
        found = of.ask()
        assert found.extra == beyond
        assert found.gap.last_null < 1e-10 < found.gap.first_other


def test_few_tracks_of_many_views_and_the_other_way_round() -> None:
    """Whichever side is eliminated, both count the same."""
    wide, tall = world(3, [LINE] * 6, 60, moves=False), world(3, [PARABOLA] * 40, 8, moves=False)
    for of in (wide, tall):
        check(of, of.ask())


@pytest.mark.parametrize("d", [2, 3])
def test_counting_agrees_with_ranks_where_points_move_in_different_ways(d: int) -> None:
    model = pp.CameraModel.ORIENTED_PLANE if d == 2 else pp.CameraModel.ORIENTED_SPACE
    for groups in ([(2, 0), (3, 1)], [(3, 1), (2, 2)], [(1, 0), (4, 2)], [(5, 1)]):
        counted = [PathGroup(*group) for group in groups]
        forms = [form for n, k in groups for form in [(pp.Static(), LINE, PARABOLA)[k]] * n]
        for m in range(2, 14):
            row, found = model.mixed(counted, m), world(d, forms, m, seed=m).ask()
            assert row.g == d + 1 + d * (shared_functions(counted) - 1)
            assert (found.equations, found.unknowns) == (row.equations, row.unknowns + row.g)
            free = found.nullity - row.g
            assert free >= -row.slack
            # a point that has fewer equations than vectors moves by itself, whatever the sum of all
            if (d - 1) * m >= d * row.vectors:
                assert free == max(0, -row.slack), (groups, m)


def test_shared_functions_are_those_that_every_group_has() -> None:
    assert shared_functions([PathGroup(3, 2), PathGroup(4, 1)]) == 2
    assert shared_functions([PathGroup(3, 2), PathGroup(4)]) == 1
    assert shared_functions([PathGroup(3, 2, "fourier"), PathGroup(4, 3, "fourier")]) == 5
    assert shared_functions([PathGroup(3, 2, "fourier"), PathGroup(4, 3)]) == 1
    assert shared_functions([PathGroup(3, 0, 6), PathGroup(4, 0, 6)]) == 6
    assert shared_functions([PathGroup(3, 0, 6), PathGroup(4, 0, 7)]) == 1
    same = pp.structure_from_motion_inequality(3, 3, 10, 0, 7, 9, 2)
    mixed = mixed_inequality(3, 3, 4, 0, [PathGroup(3, 2), PathGroup(4, 2)], 9)
    assert (mixed.slack, mixed.holds, mixed.is_settled, str(mixed)) == (
        same.slack,
        same.holds,
        same.is_settled,
        str(same),
    )
    with pytest.raises(pp.InputError, match="groups is empty"):
        mixed_inequality(3, 3, 4, 0, [], 9)


def test_words() -> None:
    found = world(3, [pp.Static()] + [LINE] * 8, moves=False).ask()
    told = found.words(track_labels=["tower", *(f"car {j}" for j in range(8))])
    assert told == (
        "everything may be multiplied by a scale linear in time about point tower because no motion of a track speaks "
        "against it (1 freedom)",
    )
    assert str(found).startswith("undetermined: 5 free movements, of which the gauge has 4; everything may be")
    assert str(world(3, [pp.Static()] * 2 + [LINE] * 8).ask()) == (
        "determined: 4 free movements, of which the gauge has 4: no further one"
    )
    found = world(3, [WAVE] * 8, 20).ask()
    assert found.words() == (
        "everything, cameras and all, may share a motion in time of period 6.981 s because no track is known to be "
        "without it (6 freedoms)",
    )
    assert len(found.explain()) == 3


def test_threads_make_no_difference() -> None:
    of = noisy(world(3, [pp.Static()] + [LINE] * 200, 150, moves=False), 1e-3)
    of.seen[:] = np.random.default_rng(5).uniform(size=of.seen.shape) < 0.2
    one, two = (of.ask(1e-3, threads=n) for n in (1, 2))
    assert one.gap == two.gap
    assert np.array_equal(one.movement, two.movement)
    for a, b in zip(one.freedoms, two.freedoms, strict=True):
        assert all(np.array_equal(x.coefficients, y.coefficients) for x, y in zip(a.vectors, b.vectors, strict=True))


def test_what_is_not_known_is_passed_over() -> None:
    of = world(3, [pp.Static()] * 3 + [LINE] * 6)
    of.centers[4] = np.nan
    of.coefficients[5][1, 0] = np.nan
    of.time_s[7] = np.nan
    found = of.ask()
    assert found.nullity == 4
    assert [track for track, reach in enumerate(found.reaches) if reach is pp.Reach.NOT_SEEN] == [5]
    found = of.ask(count=False)
    assert (found.nullity, found.extra, found.freedoms) == (0, 0, ())
    one = world(3, [LINE])
    one.seen[1:] = False
    assert one.ask().nullity == one.nullity()


def test_what_cannot_be_used_is_named() -> None:
    with pytest.raises(pp.InputError, match="track 1 has numbers that are not filled in"):
        replace(world(2, [LINE] * 4), models=(LINE, pp.Taylor(1), LINE, LINE)).ask()
    with pytest.raises(pp.InputError, match="null_below is -1"):
        pp.FreedomOptions(null_below=-1.0)
