"""A tracker that learns its camera over frames."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from star_tracker.calibration import learning
from star_tracker.calibration.learning import LearningTracker, Sources
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.ladder import ladder
from star_tracker.maps.simulation import Condition, synthetic_field, uniform_noise
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.solution import SolveSettings, Status

SIZE_PX = (512, 512)
SETTINGS = SolveSettings(deadline_ms=60_000.0)
SKY, BRIGHT_SKY = (StarCatalog.hipparcos(limiting_magnitude=v) for v in (6.5, 5.0))


@lru_cache
def steps():
    return ladder((8.0, 60.0), SIZE_PX)


SOURCES = Sources(FeatureDatabase.for_camera, steps)


def tracker(camera=None, **options):
    return LearningTracker(SOURCES, camera, SETTINGS, **options)


def frames(camera, n, *, noise_px=0.3, seed=0, least=10, sky=SKY):
    """n frames (xy, true rotation) of a camera with at least so many stars."""
    rng, found = np.random.default_rng(seed), []
    while len(found) < n:
        rotation = Rotation.from_quat(rng.normal(size=4)).as_matrix()
        frame = synthetic_field(sky, camera, rotation, rng, Condition(noise_px=noise_px))
        if len(frame.xy_px) >= least:
            found.append((frame.xy_px, rotation))
    return found


def off_deg(solution, rotation):
    """Angle between a solution's boresight and the true one."""
    cosine = solution.attitude.rotation[:, 2] @ rotation[:, 2]
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def test_a_field_of_view_told_wrong_is_corrected():
    true = Camera.from_fov(20.0, *SIZE_PX)
    learnt = tracker(Camera.from_fov(20.8, *SIZE_PX, tolerance_percent=5.0))
    for xy, rotation in frames(true, 10):
        solution = learnt.solve(xy)
        assert solution.status is Status.SOLVED
        assert off_deg(solution, rotation) < 0.1
    assert learnt.camera.fov_deg == pytest.approx(20.0, rel=1e-3)
    assert learnt.estimate.n_frames >= 9
    assert learnt.news == []  # within what was told


def test_a_camera_that_was_found_is_told_once_and_found_again_when_it_changes():
    learnt = tracker()
    for fov_deg in (30.0, 15.0):
        for xy, rotation in frames(Camera.from_fov(fov_deg, *SIZE_PX), 4, seed=int(fov_deg)):
            solution = learnt.solve(xy)
            assert solution.status is Status.SOLVED
            assert off_deg(solution, rotation) < 0.1
        assert learnt.camera.fov_deg == pytest.approx(fov_deg, rel=2e-3)
    assert len(learnt.news) == 2
    assert learnt.news[0].startswith("camera found: field of view 30")
    assert learnt.news[1].startswith("camera found: field of view 15")


def test_a_wide_lens_that_bends_is_learnt_from_nothing():
    true = replace(
        Camera.from_fov(50.0, *SIZE_PX), distortion=Distortion(
            "plumb_bob", (-0.25, 0.0, 0.0, 0.0, 0.0)
        ),
    )
    learnt, left = tracker(), []
    for xy, rotation in frames(true, 25, noise_px=0.2, seed=5, least=20, sky=BRIGHT_SKY):
        solution = learnt.solve(xy)
        if solution.status is Status.SOLVED:
            left.append(solution.rms_px)
            assert off_deg(solution, rotation) < 0.1
    assert len(left) == 25
    # At the noise of the centroids, in both coordinates.
    assert np.median(left[20:]) < 1.2 * 0.2 * np.sqrt(2)
    assert learnt.camera.distortion.coefficients[0] == pytest.approx(-0.25, abs=0.02)


def test_a_camera_told_far_off_is_given_up_after_some_frames():
    true = Camera.from_fov(30.0, *SIZE_PX)
    learnt = tracker(Camera.from_fov(20.0, *SIZE_PX, tolerance_percent=5.0))
    ended = [learnt.solve(xy).status for xy, _ in frames(true, learning._PATIENCE + 1)]
    assert ended[-2:] == [Status.SOLVED] * 2
    assert "instead of 20 deg: correct fov_deg, or the lens has changed" in learnt.news[0]


def test_an_exact_camera_is_taken_at_its_word_and_the_hint_says_what_the_stars_show():
    true = Camera.from_fov(20.0, *SIZE_PX)
    told = Camera.from_fov(19.0, *SIZE_PX)
    learnt, hints = tracker(told), []
    for xy, _ in frames(true, 2):
        learnt.solve(xy)
        hints.append(learnt.hint)
    assert learnt.camera == told
    assert all(text.startswith("improves if fov_deg is 20.0") for text in hints)
    mirrored = tracker(true.with_parity("mirrored"))
    assert mirrored.solve(frames(true, 1)[0][0]).status is not Status.SOLVED
    assert mirrored.hint == "image looks mirrored: parity normal solves it"


def test_a_told_parity_that_is_wrong_is_named_where_the_camera_is_learnt_too():
    true = Camera.from_fov(20.0, *SIZE_PX)
    learnt = tracker(Camera.from_fov(20.0, *SIZE_PX, parity="mirrored", tolerance_percent=5.0))
    assert learnt.solve(frames(true, 1)[0][0]).status is not Status.SOLVED
    assert learnt.hint == "image looks mirrored: parity normal solves it"


def test_a_longer_search_is_worth_while_now_and_then():
    camera = Camera.from_fov(20.0, *SIZE_PX)
    learnt, worth = tracker(camera), []
    rng = np.random.default_rng(2)
    for _ in range(21):
        assert learnt.solve(uniform_noise(camera, 8, rng)).status is not Status.SOLVED
        worth.append(learnt.at_a_loss)
    # Before the 20th.
    assert [i + 2 for i, value in enumerate(worth) if value] == [20]
    (xy, _), = frames(camera, 1)
    assert learnt.solve(xy).status is Status.SOLVED
    assert not learnt.at_a_loss


def test_what_was_learnt_can_be_forgotten():
    learnt = tracker()
    learnt.solve(frames(Camera.from_fov(30.0, *SIZE_PX), 1)[0][0])
    assert learnt.camera is not None
    learnt.forget()
    assert learnt.camera is None
    assert learnt.estimate is None


def test_the_fallback_alone_cannot_find_a_field_of_view():
    with pytest.raises(ValueError, match="method radial_cyclic cannot find out a field of view"):
        LearningTracker(SOURCES, None, SolveSettings(method="radial_cyclic"))
