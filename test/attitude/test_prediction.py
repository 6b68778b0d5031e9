"""Prediction of the attitude, and tracking along simulated slews."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.attitude.prediction import Predictor
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import separation
from star_tracker.identification.searcher import LOST_IN_SPACE, TRACKING
from star_tracker.maps.simulation import CAMERAS, Condition, synthetic_field
from star_tracker.solution import Status

SECOND = 1_000_000_000
START = Rotation.from_rotvec([0.3, -1.2, 0.7])
#: rad/s about the camera's axes.
RATE = np.array([0.02, -0.01, 0.05])


def turned(seconds):
    return START * Rotation.from_rotvec(RATE * seconds)


def add(predictor, seconds, rotation=None):
    rotation = turned(seconds) if rotation is None else rotation
    predictor.add(round(seconds * SECOND), rotation.as_quat())


def after(*seconds, max_age_s=2.0):
    """Return a predictor that has seen fixes at these seconds."""
    predictor = Predictor(max_age_s)
    for one in seconds:
        add(predictor, one)
    return predictor


def angle_to(matrix, rotation):
    return (Rotation.from_matrix(matrix).inv() * rotation).magnitude()


# ---- the prediction --------------------------------------------------------------------------


def test_nothing_is_predicted_before_a_fix():
    assert Predictor().predict(SECOND) is None


def test_one_fix_predicts_rest():
    assert angle_to(after(1.0).predict(2 * SECOND), turned(1.0)) < 1e-12


def test_two_fixes_predict_a_constant_rate():
    for ahead in (0.0, 0.1, 1.9):
        predicted = after(1.0, 1.1).predict(round((1.1 + ahead) * SECOND))
        assert angle_to(predicted, turned(1.1 + ahead)) < 1e-9


def test_the_last_two_fixes_count():
    predictor = after(1.0, 1.1)
    add(predictor, 1.2, turned(1.1))
    assert angle_to(predictor.predict(round(1.3 * SECOND)), turned(1.1)) < 1e-9


def test_a_rotation_proper_comes_back():
    assert np.linalg.det(after(1.0, 1.1).predict(2 * SECOND)) == pytest.approx(1.0)


@pytest.mark.parametrize(("age", "known"), [(1.9, True), (2.0, True), (2.1, False)])
def test_an_old_fix_predicts_nothing(age, known):
    predicted = after(1.0, max_age_s=2.0).predict(round((1.0 + age) * SECOND))
    assert (predicted is not None) == known


def test_fixes_far_apart_give_no_rate():
    predictor = after(1.0, 3.5)
    assert angle_to(predictor.predict(round(3.6 * SECOND)), turned(3.5)) < 1e-9


def test_a_jump_gives_no_rate():
    predictor = after(1.0)
    far = START * Rotation.from_rotvec([math.pi / 2, 0, 0])
    add(predictor, 1.1, far)
    assert angle_to(predictor.predict(round(1.2 * SECOND)), far) < 1e-9


def test_a_repeated_stamp_keeps_the_rate_and_takes_the_new_fix():
    predictor = after(1.0, 1.1)
    add(predictor, 1.1, START)
    predicted = predictor.predict(round(1.2 * SECOND))
    assert angle_to(predicted, START * Rotation.from_rotvec(0.1 * RATE)) < 1e-9


def test_reset_forgets():
    predictor = after(1.0, 1.1)
    predictor.reset()
    assert predictor.predict(round(1.2 * SECOND)) is None


def test_a_stamp_that_goes_back_forgets():
    predictor = after(1.0, 1.1)
    assert predictor.predict(round(1.05 * SECOND)) is None
    assert predictor.predict(round(1.2 * SECOND)) is None


def test_a_stamp_that_goes_back_after_an_unsolved_frame_forgets():
    predictor = after(1.0, 1.1)
    assert predictor.predict(round(1.5 * SECOND)) is not None
    assert predictor.predict(round(1.4 * SECOND)) is None


def test_a_fix_that_goes_back_starts_anew():
    predictor = after(2.0, 2.1)
    add(predictor, 1.0)
    assert angle_to(predictor.predict(round(1.5 * SECOND)), turned(1.0)) < 1e-9


@pytest.mark.parametrize("max_age_s", [-1.0, math.nan])
def test_impossible_age_is_refused(max_age_s):
    with pytest.raises(ValueError, match="max_age_s must be 0 or more"):
        Predictor(max_age_s)


# ---- tracking a slew -------------------------------------------------------------------------

CAMERA = CAMERAS["12 deg"]
RATE_HZ, N_FRAMES = 10, 60
NOISE_PX, FALSE_STARS = 0.5, 0.5
#: With a handful of stars, 0.5 px are some 0.3 px in the boresight, 0.007 deg.
LIMIT_DEG = 0.05


@pytest.fixture
def tracker(trackers):
    return trackers["12 deg"]


def follow(tracker, rotations, seed):
    """Solve noisy frames at these attitudes as a node does; return solutions and errors, deg."""
    predictor, rng, solutions, errors = Predictor(), np.random.default_rng(seed), [], []
    for i, rotation in enumerate(rotations):
        stamp = (i + 1) * SECOND // RATE_HZ
        frame = synthetic_field(
            tracker.database.catalog, CAMERA, rotation, rng,
            Condition(noise_px=NOISE_PX, false_stars=FALSE_STARS),
        )
        solution = tracker.solve(frame.xy_px, predicted=predictor.predict(stamp))
        solutions.append(solution)
        assert solution.status is Status.SOLVED, f"frame {i}: {solution.reason}"
        predictor.add(stamp, solution.attitude.quaternion_xyzw)
        found = solution.attitude.rotation
        errors.append(math.degrees(separation(found[:, 2], rotation[:, 2])))
    return solutions, errors


def slew(deg_per_s, n=N_FRAMES):
    """Return attitudes of a slew across the image and about its axis."""
    start = rotation_from_boresight(1.9, 0.2, 0.3)
    axis = np.array([0.8, 0.5, 0.33]) / np.linalg.norm([0.8, 0.5, 0.33])
    step = math.radians(deg_per_s) / RATE_HZ
    return [start @ Rotation.from_rotvec(i * step * axis).as_matrix() for i in range(n)]


@pytest.mark.parametrize("deg_per_s", [0.1, 1.0, 3.0])
def test_no_frame_of_a_slew_is_lost_after_the_first_fix(tracker, deg_per_s):
    solutions, errors = follow(tracker, slew(deg_per_s), seed=4)
    assert max(errors) < LIMIT_DEG
    modes = [solution.mode for solution in solutions]
    assert modes[0] == LOST_IN_SPACE
    # A frame of weak evidence goes the whole way; nearly all others are found where expected.
    assert modes[2:].count(TRACKING) >= 0.9 * len(modes[2:])


def test_a_jump_of_90_deg_is_found_in_the_same_frame(tracker):
    before = slew(1.0, 10)
    turn = Rotation.from_rotvec([math.pi / 2, 0, 0]).as_matrix()
    solutions, errors = follow(tracker, before + [one @ turn for one in before], seed=5)
    assert max(errors) < LIMIT_DEG
    modes = [solution.mode for solution in solutions]
    assert modes[10] == LOST_IN_SPACE
    assert TRACKING in modes[8:10]
    assert modes[12:].count(TRACKING) >= 6
