"""Whatever arrives as PointCloud2: arrays or one sentence, and no solution out of garbage."""

import time
import tracemalloc
from collections import Counter

import numpy as np
import pytest

pytest.importorskip("hypothesis", reason="needs hypothesis: pip install hypothesis")

from fuzz_clouds import camera_infos, clouds, few, few_or_many, fuzzed, garbage
from hypothesis import given
from hypothesis import strategies as st

from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.camera_info import camera_from_info
from star_tracker.msg_adapters.point_cloud import centroids_from_cloud
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

#: Bytes that reading may take on top of the message: its values once more as float64 and a
#: little for the rest. The messages hold up to 4 kB.
MEMORY_BYTES = 200_000
#: Longest that reading a cloud may take, CPU time; a millisecond is usual.
LONGEST_S = 1.0
#: Characters of a sentence of refusal, whatever names the message holds.
LONGEST_SENTENCE = 300
#: So many of the cameras that are taken are solved with: it takes 10 ms each.
MOST_TRACKERS = 200


@pytest.fixture(scope="module")
def trackers(database):
    """By parity: trackers for the maps of the 12 deg camera, with little time for noise."""
    camera = paper_maps((1,))[0].camera
    settings = SolveSettings(deadline_ms=5.0)
    return {
        parity: StarTracker(database, camera.with_parity(parity), settings)
        for parity in ("normal", "mirrored", "auto")
    }


def read(message):
    """Return the centroids of a message, None where it is refused with a sentence."""
    try:
        centroids = centroids_from_cloud(message)
    except MessageError as error:
        sentence = str(error)
    else:
        sentence = None
    if sentence is not None:
        assert sentence.startswith("PointCloud2 ")
        assert sentence.isprintable()
        assert len(sentence) < LONGEST_SENTENCE
        return None
    n = message.width * message.height
    assert centroids.xy_px.shape == (n, 2)
    assert centroids.xy_px.dtype == np.float64
    if centroids.intensity is not None:
        assert centroids.intensity.shape == (n,)
        assert centroids.intensity.dtype == np.float64
    return centroids


@few_or_many
def test_any_cloud_is_read_or_refused_in_a_sentence(n_cases):
    outcomes = Counter()

    @fuzzed(n_cases)
    @given(message=clouds())
    def each(message):
        started = time.process_time()
        found = read(message)
        assert time.process_time() - started < LONGEST_S
        outcomes["refused" if found is None else "empty" if not len(found.xy_px) else "read"] += 1

    each()
    print(outcomes)
    # Neither side is left out, or the fuzz would tell little.
    assert min(outcomes[key] for key in ("refused", "empty", "read")) > 0.02 * n_cases, outcomes


@few
@given(message=clouds())
def test_reading_takes_no_more_memory_than_the_message_asks_for(message):
    tracemalloc.start()
    try:
        read(message)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < MEMORY_BYTES


# ---- solving what comes out --------------------------------------------------------------------


def judge(tracker, xy_px, intensity):
    """Solve a frame that shows no sky: it ends with a reason and without an attitude."""
    solution = tracker.solve(xy_px, intensity)
    assert solution.status is not Status.SOLVED, (xy_px, solution)
    assert solution.attitude is None
    assert solution.reason
    assert len(solution.identification.state) == len(xy_px)
    return solution.status


@few_or_many
def test_no_solution_out_of_garbage(trackers, n_cases):
    outcomes = Counter()

    @fuzzed(n_cases)
    @given(frame=garbage(), parity=st.sampled_from(sorted(trackers)))
    def each(frame, parity):
        outcomes[judge(trackers[parity], *frame)] += 1

    each()
    print(outcomes)
    searched = outcomes[Status.NO_MATCH] + outcomes[Status.TIMEOUT]
    assert min(searched, outcomes[Status.TOO_FEW_STARS], outcomes[Status.BAD_INPUT]) > 0, outcomes


@few_or_many
def test_noise_of_any_cloud_is_solved_no_oftener_than_promised(trackers, n_cases):
    """Random bytes that pass for pixels are frames of noise: one in a thousand may be accepted."""
    tracker = trackers["mirrored"]
    promised = 10**tracker.settings.max_log10_false_alarms
    outcomes = Counter()

    @fuzzed(n_cases)
    @given(message=clouds())
    def each(message):
        found = read(message)
        if found is not None:
            outcomes[tracker.solve(found.xy_px, found.intensity).status] += 1

    each()
    expected = promised * n_cases
    # Four standard deviations of a Poisson count.
    assert outcomes[Status.SOLVED] <= expected + 4 * expected**0.5, outcomes


@pytest.mark.parametrize("outlier", [1e12, 1e300, 5e-324])
def test_intensities_of_no_sky_are_no_evidence(trackers, outlier):
    """Many alike and some apart: each star of a wrong pose seemed to have its magnitude right."""
    rng = np.random.default_rng(5)
    for _ in range(100):
        intensity = np.where(np.arange(30) % 3 == 0, outlier, 1.0)
        judge(trackers["mirrored"], rng.uniform(0, 512, (30, 2)), intensity)


def test_a_good_frame_is_solved_after_any_garbage(trackers):
    """The memory that a tracker uses again for each frame carries nothing over."""
    star_map, tracker = paper_maps((1,))[0], trackers["mirrored"]
    first = tracker.solve(star_map.xy_px)

    @few
    @given(frame=garbage())
    def each(frame):
        judge(tracker, *frame)
        again = tracker.solve(star_map.xy_px)
        np.testing.assert_array_equal(
            again.attitude.quaternion_xyzw, first.attitude.quaternion_xyzw
        )

    each()


# ---- cameras -----------------------------------------------------------------------------------


@few_or_many
def test_any_camera_info_is_a_camera_or_refused_in_a_sentence(trackers, n_cases):
    """What is taken for a camera can be solved with."""
    database = trackers["mirrored"].database
    frame = np.random.default_rng(1).uniform(0, 64, (6, 2))
    outcomes = Counter()

    @fuzzed(n_cases)
    @given(message=camera_infos(), rectified=st.booleans())
    def each(message, rectified):
        try:
            camera = camera_from_info(message, "normal", rectified=rectified)
        except MessageError as error:
            camera, sentence = None, str(error)
        outcomes["refused" if camera is None else "taken"] += 1
        if camera is None:
            assert sentence.startswith("CameraInfo")
            assert sentence.isprintable()
            return
        if outcomes["taken"] <= MOST_TRACKERS:
            tracker = StarTracker(database, camera, SolveSettings(deadline_ms=5.0))
            assert tracker.solve(frame).reason

    each()
    print(outcomes)
    assert min(outcomes.values()) > 0.02 * n_cases, outcomes
