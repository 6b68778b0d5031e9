"""Votes by the shape of triangles: the true star, roll and scale at any focal length."""

import math

import numpy as np
import pytest
from engines import Bench, catalog_of, centroids_of, pose_parts, random_sky
from scipy.stats import poisson

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.triangles import (
    ANY_SCALE,
    KNOWN_SCALE,
    RATIO_LOW,
    RATIO_RANGE,
    SIZE_LOW,
    SIZE_RANGE,
)
from star_tracker.compiled import compiled
from star_tracker.geometry.spherical import position_angle, separation
from star_tracker.identification.cells import best_cells
from star_tracker.identification.ended import Ended
from star_tracker.identification.evidence import ScalePrior, scale_prior
from star_tracker.identification.fallback import CAMERA_POLE
from star_tracker.identification.shapes import (
    cast_by_shape,
    choose_runs,
    keep_agreeing,
    members_at_any_scale,
    spread,
)
from star_tracker.identification.votes import ROLL_BINS, clear
from star_tracker.maps.simulation import random_rotation, uniform_noise, visible_stars
from star_tracker.optics.camera import Camera

#: As told; some 13 of the 800 stars are in its image.
CAMERA = Camera.from_fov(26, 1024, 1024)
TOLERANCE_PX = 2.0
#: Of so many companions, 45 pairs vote.
COMPANIONS = 10
TOLERANCE = TOLERANCE_PX / CAMERA.focal_length_px
SCALES = [0.95, 0.98, 1.0, 1.03, 1.05]
UNTOLD = ScalePrior(-0.25, 0.25, 2.0, told=False, sigma=math.inf)


@compiled
def fan_lists(fan):
    return fan.star, fan.companion, fan.guide, fan.log_ratio, fan.roll, fan.slack


@compiled
def runs_of(fan):
    return fan.first[: fan.n_runs], fan.last[: fan.n_runs]


@compiled
def orders_of(fan):
    return fan.orders[: fan.n_runs]


@compiled
def room_lists(room):
    return room.observed, room.catalog


@pytest.fixture(scope="module", params=[KNOWN_SCALE, ANY_SCALE], ids=["known", "any"])
def database(request):
    return FeatureDatabase.build(catalog_of(random_sky(800, 5)), triangle_grid=request.param)


@pytest.fixture(scope="module")
def bench(database):
    return Bench(database, CAMERA, prior=scale_prior(10.0))


def seen(bench, database, scale, rng):
    """A frame of a camera of another focal length: attitude, true star of each centroid."""
    camera = CAMERA.scaled(scale)
    while True:
        rotation = random_rotation(rng)
        index, pixels = visible_stars(database.catalog, camera, rotation)
        if len(index) >= 8:
            bench.show(pixels)
            return rotation, index[bench.centroids.row]


def voted(bench, main, most=COMPANIONS):
    """Let all triangles of a main star vote: companions, cells best first."""
    n_fan = spread(bench.frame, main, most, bench.fan, in_order=False)
    choose_runs(bench.engine, 0, n_fan, TOLERANCE)
    cast_by_shape(bench.engine, 3)
    cells, scores = np.empty(64, np.int64), np.empty(64, np.int64)
    n = best_cells(bench.votes, 0, bench.votes.n_reached, cells, scores)
    clear(bench.votes)
    return n_fan, cells[:n].tolist()


@pytest.mark.parametrize("turn", [-0.01, 0.01])
def test_a_triangle_that_is_larger_than_any_of_the_catalogue_has_no_rows(database, turn):
    """Its shape is in the last cell of ratios and of angles, its size beyond the last one."""
    wide = Camera.from_fov(90, 1024, 1024)
    bench = Bench(database, wide, prior=scale_prior(1.0))
    far = wide.focal_length_px * math.tan(math.radians(28))
    near = wide.focal_length_px * math.tan(math.radians(28) / math.exp(1.72))
    bench.show(512 + np.array([
        (0, 0), (near, 0), (far * math.cos(turn), far * math.sin(turn)), (-480, 480), (-480, -480)
    ]))
    main = central(bench)
    assert spread(bench.frame, main, 2, bench.fan, in_order=True) == 2
    ratio = bench.fan.log_separation[1] - bench.fan.log_separation[0]
    assert RATIO_LOW + RATIO_RANGE - 0.05 < ratio < RATIO_LOW + RATIO_RANGE
    assert choose_runs(bench.engine, 0, 2, 1e-4) == 0
    assert len(runs_of(bench.fan)[0]) == 0


def central(bench):
    return int(np.argmax(bench.centroids.vectors[:, 2]))


@pytest.mark.parametrize("most", [1, 5, 12])
def test_companions_are_the_nearest_stars_with_their_places(bench, database, most):
    seen(bench, database, 1.0, np.random.default_rng(1))
    vectors = bench.centroids.vectors
    star = fan_lists(bench.fan)[0]
    for main in range(len(vectors)):
        n = spread(bench.frame, main, most, bench.fan, in_order=False)
        apart = np.array(separation(vectors, vectors[main]))
        near = np.argsort(apart)[1 : most + 1]
        np.testing.assert_array_equal(star[:n], near)
        np.testing.assert_allclose(bench.fan.separation[:n], apart[near], rtol=1e-9)
        np.testing.assert_allclose(bench.fan.log_separation[:n], np.log(apart[near]), rtol=1e-9)
        turn = bench.fan.azimuth[:n] - position_angle(vectors[main], vectors[near], CAMERA_POLE)
        np.testing.assert_allclose(np.exp(1j * turn), 1, atol=1e-9)


@pytest.mark.parametrize("scale", SCALES)
def test_the_highest_cell_is_the_true_star_and_roll_at_any_scale(bench, database, scale):
    rng = np.random.default_rng(2)
    for _ in range(10):
        _, truth = seen(bench, database, scale, rng)
        vectors, main = bench.centroids.vectors, central(bench)
        _, cells = voted(bench, main)
        assert cells[0] // ROLL_BINS == truth[main]
        others = np.delete(np.arange(len(truth)), main)
        sky = database.catalog.vectors
        roll = position_angle(sky[truth[main]], sky[truth[others]]) - position_angle(
            vectors[main], vectors[others], CAMERA_POLE
        )
        mean = np.angle(np.mean(np.exp(1j * roll)))
        # A vote counts in its own bin and in the next one: the middle of the two is their edge.
        off = mean - (cells[0] % ROLL_BINS) * 2 * np.pi / ROLL_BINS
        assert abs(np.angle(np.exp(1j * off))) < 2 * np.pi / ROLL_BINS + 0.03


@pytest.mark.parametrize("scale", SCALES)
def test_members_that_agree_are_true_and_tell_the_scale(bench, database, scale):
    """At t = tan(13 deg) from the axis separations grow by s (1 + t^2) / (1 + s^2 t^2): 0.5 %."""
    rng = np.random.default_rng(3)
    observed, catalog = room_lists(bench.room)
    for _ in range(10):
        _, truth = seen(bench, database, scale, rng)
        main = central(bench)
        n_fan, cells = voted(bench, main)
        n = members_at_any_scale(bench.engine, n_fan, cells[0], TOLERANCE)
        k, log_scale, slack, worth = keep_agreeing(bench.engine, n, n_fan, int(truth[main]))
        assert 0.6 * n_fan < k <= n
        assert worth > 3
        np.testing.assert_array_equal(catalog[:k], truth[observed[:k]])
        assert log_scale == pytest.approx(math.log(scale), abs=5e-3)
        assert 0 < slack < 0.05


def test_the_true_cell_of_a_full_frame_is_the_highest_too(bench, database):
    """All of the nearest 12 or 14 companions are seen and are among the 20 of the guide star."""
    rng = np.random.default_rng(2)
    for _ in range(6):
        _, truth = seen(bench, database, 1.0, rng)
        main = central(bench)
        _, cells = voted(bench, main, 14)
        assert cells[0] // ROLL_BINS == truth[main]


def shape_is_kept(table, main, first, second):
    """Whether the sky has a triangle of these stars in its table, and not too vague to vote."""
    fan = table.fan_star[main].tolist()
    if first not in fan or second not in fan:
        return False
    near, far = (float(table.fan_log_separation[main, fan.index(s)]) for s in (first, second))
    ratio, size = far - near, far - table.log_spacing
    vague = TOLERANCE * math.hypot(math.exp(-near), math.exp(-far))
    in_ratio = RATIO_LOW < ratio < RATIO_LOW + RATIO_RANGE
    return vague < 0.1 and in_ratio and SIZE_LOW < size < SIZE_LOW + SIZE_RANGE


def test_the_triangles_of_the_sky_are_among_those_that_vote(bench, database):
    """Of each main star with all pairs of its companions, also where an angle crosses 0."""
    rng = np.random.default_rng(4)
    sky, table, star = database.catalog.vectors, database.triangles, fan_lists(bench.fan)[0]
    n_found = 0
    for scale in SCALES:
        _, truth = seen(bench, database, scale, rng)
        for main, true in enumerate(truth):
            for j in range(1, spread(bench.frame, main, 6, bench.fan, in_order=True)):
                rows = choose_runs(bench.engine, j, j + 1, TOLERANCE)
                first, last = runs_of(bench.fan)
                assert rows == np.sum(last - first)
                second = truth[star[j]]
                if not any(shape_is_kept(table, true, truth[star[i]], second) for i in range(j)):
                    continue
                turn = float(position_angle(sky[true], sky[second])) / (2 * np.pi)
                chosen = np.concatenate(
                    [table.rows[a:b] for a, b in zip(first, last, strict=True)]
                )
                units = math.floor(turn * 256)
                assert np.any((chosen >> 11 == true) & (chosen % 256 == units))
                n_found += 1
    assert n_found > 100


@pytest.mark.parametrize(("mags", "allowed"), [
    # Main star, first and second companion: main < first, main < second, first < second.
    ((1.0, 2.0, 3.0), {0b111}), ((3.0, 2.0, 1.0), {0b000}), ((2.0, 1.0, 3.0), {0b110}),
    ((2.0, 3.0, 1.0), {0b001}), ((1.0, 3.0, 2.0), {0b011}), ((3.0, 1.0, 2.0), {0b100}),
    ((1.0, 2.0, 2.4), {0b011, 0b111}), ((1.0, 1.4, 1.2), set(range(8))),
    ((1.0, 2.0, math.nan), {0b001, 0b011, 0b101, 0b111}), ((math.nan, 1.0, 1.6), {4, 5, 6, 7}),
    ((1.0, 1.49, 1.51), {0b010, 0b011, 0b110, 0b111}),
])
@pytest.mark.parametrize("in_order", [True, False])
def test_triangles_stand_in_the_order_of_brightness_that_the_frame_shows(
    bench, mags, allowed, in_order
):
    """Of stars that differ by half a magnitude or more; a companion's place tells which it is."""
    near_to_far = [(500.0, 500), (560, 520), (480, 620), (900, 100), (60, 900)]
    intensity = 10 ** (-0.4 * np.array([*mags, 9.0, 9.0]))
    bench.show(near_to_far, intensity)
    main = int(bench.places([0])[0])
    assert spread(bench.frame, main, 2, bench.fan, in_order) == 2
    assert choose_runs(bench.engine, 0, 2, TOLERANCE) > 0
    orders = set(orders_of(bench.fan).tolist())
    assert orders == {sum(1 << order for order in (allowed if in_order else range(8)))}


def test_the_true_triangles_are_among_those_of_their_order(database):
    """With magnitudes that are 0.1 mag off as with exact ones."""
    rng = np.random.default_rng(8)
    v_mag = rng.uniform(1.0, 6.0, 800)
    sky = FeatureDatabase.build(
        catalog_of(database.catalog.vectors, v_mag), triangle_grid=database.triangle_grid
    )
    bench = Bench(sky, CAMERA, prior=scale_prior(10.0))
    n_found = n_kept = n_all = 0
    for _ in range(8):
        index, pixels = visible_stars(sky.catalog, CAMERA, random_rotation(rng))
        bench.show(pixels, 10 ** (-0.4 * (v_mag[index] + rng.normal(0, 0.1, len(index)))))
        truth, star = index[bench.centroids.row], fan_lists(bench.fan)[0]
        for main, true in enumerate(truth):
            for j in range(1, spread(bench.frame, main, 6, bench.fan, in_order=True)):
                choose_runs(bench.engine, j, j + 1, TOLERANCE)
                first, last = runs_of(bench.fan)
                rows = [sky.triangles.rows[a:b] for a, b in zip(first, last, strict=True)]
                wanted = np.repeat(orders_of(bench.fan), last - first)
                rows = np.concatenate([*rows, np.empty(0, np.int32)])
                kept = rows[wanted >> (rows >> 8 & 7) & 1 == 1]
                n_all, n_kept = n_all + len(rows), n_kept + len(kept)
                second = truth[star[j]]
                partners = [
                    truth[star[i]] for i in range(j)
                    if shape_is_kept(sky.triangles, true, truth[star[i]], second)
                ]
                if len(partners) == j:
                    assert np.sum(kept >> 11 == true) >= j
                    n_found += 1
    assert n_found > 50
    assert n_kept < 0.4 * n_all


def listed(bench, members, star=0):
    """Keep the members, given as (companion, guide, log ratio, roll, slack), that agree."""
    star_of, *columns = fan_lists(bench.fan)
    star_of[:] = np.arange(len(star_of)) + 50
    for column, values in zip(columns, zip(*members, strict=True), strict=True):
        column[: len(members)] = values
    k, log_scale, slack, _ = keep_agreeing(bench.engine, len(members), 0, star)
    observed, catalog = room_lists(bench.room)
    return observed[:k].tolist(), catalog[:k].tolist(), log_scale, slack


def test_members_agree_in_scale_and_roll(bench, database):
    """Three at a scale of e^0.02; one is off in scale, one in roll."""
    fan_star = database.triangles.fan_star[0]
    observed, catalog, log_scale, slack = listed(bench, [
        (0, 3, 0.020, 0.010, 0.004), (1, 5, 0.022, 0.011, 0.002), (2, 6, 0.019, 0.012, 0.004),
        (3, 7, 0.040, 0.011, 0.004), (4, 8, 0.021, 0.025, 0.004),
    ])
    assert observed == [50, 51, 52]
    assert catalog == fan_star[[3, 5, 6]].tolist()
    # Weighted by 1 / slack^2: 1, 4 and 1.
    assert log_scale == pytest.approx((0.020 + 4 * 0.022 + 0.019) / 6)
    assert slack == pytest.approx(0.004 / math.sqrt(6))


def test_a_companion_or_a_guide_star_counts_once(bench):
    """A companion that might be two guide stars does not agree with itself, nor the reverse."""
    assert listed(bench, [(0, 3, 0.0, 0.0, 0.01), (0, 4, 0.0, 0.0, 0.01)]) == ([], [], 0.0, 0.0)
    assert listed(bench, [(0, 3, 0.0, 0.0, 0.01), (1, 3, 0.0, 0.0, 0.01)]) == ([], [], 0.0, 0.0)


@pytest.mark.parametrize("n_fan", [3, 8])
def test_members_are_worth_how_rarely_chance_brings_so_many_together(bench, database, n_fan):
    """Poisson's law: of the other companions each has a place of the tolerance's size.

    Stars are as dense as the 20 about the guide star, the last at their border.
    """
    apart = np.linspace(0.05, 0.15, n_fan)
    bench.fan.separation[:n_fan] = apart
    slack, (*_, border) = 0.02, np.exp(database.triangles.fan_log_separation[0].astype(float))
    _, *columns = fan_lists(bench.fan)
    for column, values in zip(columns, ([0, 1, 2], [3, 5, 6], [0] * 3, [0] * 3, [slack] * 3),
                              strict=True):
        column[:3] = values
    k, _, _, worth = keep_agreeing(bench.engine, 3, n_fan, 0)
    area = (slack * apart[0]) ** 2 + (slack * apart[1:]) ** 2  # over pi
    expected = -np.log10(poisson.pmf(2, np.sum(20 / border**2 * area)))
    assert k == 3
    assert worth == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("members", [[], [(0, 3, 0.0, 0.0, 0.01)]])
def test_fewer_than_two_members_do_not_agree(bench, members):
    assert keep_agreeing(bench.engine, len(members), 2, 0) == (0, 0.0, 0.0, 0.0)


# The search


def searched(bench, xy):
    """Search a frame to the end; return how that ended, and the labels."""
    task = bench.task_of(xy)
    bench.searcher.follow(task)
    while bench.searcher.ended == Ended.MORE:
        bench.searcher.go_on(task)
    return bench.searcher.ended, task.labels


@pytest.mark.parametrize("prior", [scale_prior(10.0), UNTOLD], ids=["10 %", "not told"])
@pytest.mark.parametrize("scale", [0.93, 1.0, 1.07])
def test_a_frame_is_solved_at_any_scale_and_the_scale_found(database, prior, scale):
    """0.3 px of noise; errors are held to five of the standard errors told."""
    bench = Bench(database, CAMERA, prior=prior)
    rng = np.random.default_rng(6)
    for _ in range(5):
        rotation, truth = seen(bench, database, scale, rng)
        row = np.argsort(bench.centroids.row)
        xy = CAMERA.pixels_of_plane(bench.centroids.plane_px / CAMERA.focal_length_px)[row]
        xy += rng.normal(0, 0.3, xy.shape)
        ended, labels = searched(bench, xy)
        assert ended == Ended.SOLVED
        named = labels["state"] == 1
        assert np.count_nonzero(named) >= len(xy) - 1
        np.testing.assert_array_equal(labels["catalog_index"][named], truth[row][named])
        outcome = bench.results.outcome[0]
        assert outcome["scale"] == pose_parts(bench.best)[1]
        error = math.log(outcome["scale"] / scale)
        assert abs(error) < 5 * math.sqrt(outcome["scale_variance"]) < 0.005
        boresight = separation(bench.results.rotation[:, 2], rotation[:, 2])
        assert boresight < 5 * 0.3 / CAMERA.focal_length_px


def test_noise_is_searched_to_its_end_and_nothing_is_certain(database):
    bench = Bench(database, CAMERA, prior=UNTOLD)
    rng = np.random.default_rng(7)
    for n in (4, 5, 6, 8):
        xy = uniform_noise(CAMERA, n, rng)
        ended, labels = searched(bench, xy)
        assert ended == Ended.EXHAUSTED
        assert bench.searcher.score < 3
        assert bench.searcher.n_hypotheses > 0
        assert np.all(labels["catalog_index"] == -1)


def test_a_frame_of_two_stars_has_no_triangle(bench):
    bench.show([(100.0, 100), (300, 200)])
    assert spread(bench.frame, 0, 12, bench.fan, in_order=True) == 1
    assert choose_runs(bench.engine, 0, 1, TOLERANCE) == 0
    assert centroids_of(bench.frame).n == 2
