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
from star_tracker.nodes.identify.camera_report import camera_report
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

SIZE_PX = (512, 512)
SETTINGS = SolveSettings(deadline_ms=60_000.0)
SKY, BRIGHT_SKY, BRIGHTEST_SKY = (
    StarCatalog.hipparcos(limiting_magnitude=v) for v in (6.5, 5.0, 4.5)
)


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
    # Each frame is searched to its end, in vain: stars that any camera sees are enough.
    seen = frames(true, learning._PATIENCE + 1, sky=BRIGHTEST_SKY)
    ended = [learnt.solve(xy).status for xy, _ in seen]
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
    (xy, _), = frames(true, 1, sky=BRIGHT_SKY)
    assert learnt.solve(xy).status is not Status.SOLVED
    assert learnt.hint == "image looks mirrored: parity normal solves it"


def test_a_longer_search_is_worth_while_now_and_then():
    camera = Camera.from_fov(20.0, *SIZE_PX)
    learnt, worth = tracker(camera), []
    rng = np.random.default_rng(2)
    for _ in range(21):
        assert learnt.solve(uniform_noise(camera, 5, rng)).status is not Status.SOLVED
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


def sparse(camera, n, *, stars, noise_px, false_stars=0, seed=0):
    """n frames (xy, true rotation) of so many of the stars in view, and false ones."""
    rng = np.random.default_rng(seed)
    for xy, rotation in frames(camera, n, noise_px=noise_px, seed=seed):
        false = uniform_noise(camera, false_stars, rng)
        yield np.concatenate([rng.permutation(xy)[:stars], false]), rotation


@pytest.mark.parametrize("tolerance_percent", [0.0, 1.0])
def test_noise_and_false_stars_are_learnt_of_any_camera(tolerance_percent):
    camera = Camera.from_fov(12.0, *SIZE_PX)
    learnt = tracker(replace(camera, tolerance_percent=tolerance_percent))
    for xy, _ in sparse(camera, 30, stars=9, noise_px=0.3, false_stars=3, seed=1):
        learnt.solve(xy)
    # Known from 100 degrees of freedom, and from 100 centroids.
    assert learnt.noise.sigma_px == pytest.approx(0.3, rel=4 * 0.07)
    assert learnt.noise.false_share == pytest.approx(0.25, abs=0.05)
    learnt.forget()
    assert learnt.noise.sigma_px is None


@pytest.mark.slow
def test_a_stream_of_few_stars_has_more_evidence_and_is_more_precise_than_lone_frames():
    camera = Camera.from_fov(12.0, *SIZE_PX)
    learnt, gains, variances = tracker(camera), [], []
    alone = StarTracker(FeatureDatabase.for_camera(camera), camera, SETTINGS)
    for at, (xy, _) in enumerate(sparse(camera, 30, stars=5, noise_px=0.3, seed=2)):
        of_stream, lone = learnt.solve(xy), alone.solve(xy)
        if at >= 10 and lone.status is Status.SOLVED:
            assert of_stream.status is Status.SOLVED
            gains.append(lone.log10_false_alarms - of_stream.log10_false_alarms)
            variances.append((of_stream.centroid_sigma_px**2, lone.centroid_sigma_px**2))
    assert min(gains) > -0.302  # half of the evidence
    assert np.median(gains) > 0.3
    # That of 7 degrees of freedom is widened by 2.2 and that of 27 by 1.2: a ratio of 0.55, which
    # 20 frames tell to 0.12.
    of_stream, lone = np.mean(variances, axis=0)
    assert of_stream / lone < 0.55 + 3 * 0.12


@pytest.mark.slow
def test_a_stream_whose_noise_grows_at_once_is_solved_as_lone_frames_are():
    camera = Camera.from_fov(12.0, *SIZE_PX)
    learnt, n_stream, n_alone, beyond = tracker(camera), 0, 0, 0
    alone = StarTracker(FeatureDatabase.for_camera(camera), camera, SETTINGS)
    for xy, _ in sparse(camera, 15, stars=8, noise_px=0.3, seed=3):
        learnt.solve(xy)
    for xy, rotation in sparse(camera, 25, stars=8, noise_px=0.9, false_stars=4, seed=4):
        solution = learnt.solve(xy)
        n_stream += solution.status is Status.SOLVED
        n_alone += alone.solve(xy).status is Status.SOLVED
        if solution.attitude is not None:
            assert off_deg(solution, rotation) < 0.1
            error = Rotation.from_matrix(solution.attitude.rotation.T @ rotation).as_rotvec()
            beyond += error @ np.linalg.solve(solution.attitude.covariance_rad2, error) > 11.3
    assert n_stream >= n_alone
    assert beyond <= 2  # of 25, where one in 100 is expected: the first one may be
    assert learnt.noise.sigma_px == pytest.approx(0.9, rel=4 * 0.07)


def test_unrelated_frames_after_a_good_sky_are_not_solved():
    camera = Camera.from_fov(12.0, *SIZE_PX)
    settings = replace(SETTINGS, method="match_group")
    learnt, rng = LearningTracker(SOURCES, camera, settings), np.random.default_rng(5)
    for xy, _ in sparse(camera, 10, stars=9, noise_px=0.1, seed=6):
        learnt.solve(xy)
    assert learnt.noise.expectation is not None
    for _ in range(51):
        noise = uniform_noise(camera, int(rng.integers(4, 12)), rng)
        assert learnt.solve(noise).status is not Status.SOLVED
    assert learnt.noise.expectation is None


def test_another_camera_begins_with_nothing_known_of_its_noise():
    learnt = tracker()
    for xy, _ in frames(Camera.from_fov(30.0, *SIZE_PX), 8, noise_px=0.3):
        learnt.solve(xy)
    assert learnt.noise.n_frames > 1  # it begins anew when the camera is known better
    learnt.solve(frames(Camera.from_fov(15.0, *SIZE_PX), 1, seed=15)[0][0])
    assert learnt.noise.n_frames <= 1


def report(learnt):
    """The values of the status of the camera in /diagnostics."""
    return camera_report(learnt, lambda camera: camera)[2]


def test_diagnostics_say_what_was_learnt_of_the_centroids():
    camera = Camera.from_fov(12.0, *SIZE_PX)
    learnt = tracker(camera)
    assert "learnt_sigma_px" not in report(learnt)
    for xy, _ in sparse(camera, 5, stars=9, noise_px=0.3, false_stars=3, seed=1):
        learnt.solve(xy)
    values = report(learnt)
    assert values["learnt_sigma_px"] == learnt.noise.sigma_px
    assert values["learnt_false_star_ratio"] == learnt.noise.false_share


def test_a_noise_that_is_told_is_not_said_to_be_learnt():
    camera = Camera.from_fov(12.0, *SIZE_PX)
    told = LearningTracker(SOURCES, camera, replace(SETTINGS, centroid_sigma_px=0.5))
    for xy, _ in sparse(camera, 5, stars=9, noise_px=0.3, false_stars=3, seed=1):
        told.solve(xy)
    values = report(told)
    assert "learnt_sigma_px" not in values
    assert values["learnt_false_star_ratio"] == told.noise.false_share


def test_the_fallback_alone_cannot_find_a_field_of_view():
    with pytest.raises(ValueError, match="method radial_cyclic cannot find out a field of view"):
        LearningTracker(SOURCES, None, SolveSettings(method="radial_cyclic"))
