"""A tracker uses its memory again: nothing of a frame is left in the next, nor in a thread's."""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from engines import CAMERA
from processes import completed
from solutions import PATIENT, record

from star_tracker.identification.verbs import act
from star_tracker.maps.simulation import CONDITIONS, frames, uniform_noise
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker


@pytest.fixture(scope="module")
def many(database):
    """50 frames of 12 deg: all conditions in turn, and noise."""
    rng = np.random.default_rng(16)
    found = [
        next(frames(database.catalog, CAMERA, condition, 1, 100 * seed + at)).xy_px
        for seed in range(4) for at, condition in enumerate(CONDITIONS)
    ][:44]
    return [*found, *(uniform_noise(CAMERA, n, rng) for n in (0, 3, 4, 5, 8, 12))]


@pytest.mark.parametrize("parity", ["normal", pytest.param("auto", marks=pytest.mark.slow)])
def test_a_tracker_used_again_is_as_a_new_one(database, many, parity):
    """Votes, poses and labels of one frame leave no trace in the next, in whatever order."""
    camera = CAMERA.with_parity(parity)
    fresh = [record(StarTracker(database, camera, PATIENT).solve(xy)) for xy in many]
    assert len({status for status, *_ in fresh}) >= 3
    tracker = StarTracker(database, camera, PATIENT)
    for seed in (17, 18):
        for at in np.random.default_rng(seed).permutation(len(many)).tolist():
            assert record(tracker.solve(many[at])) == fresh[at]


def test_a_frame_that_was_cut_off_leaves_no_trace_either(database, frame):
    tracker = StarTracker(database, CAMERA, SolveSettings(deadline_ms=1e-6))
    expected = record(tracker.solve(frame.xy_px))
    assert tracker.solve(
        uniform_noise(CAMERA, 30, np.random.default_rng(19))
    ).status is Status.TIMEOUT
    assert record(tracker.solve(frame.xy_px)) == expected


def test_two_trackers_share_a_database(database, many):
    """Of two cameras, frame by frame in turn, and as if each were alone."""
    cameras = CAMERA, CAMERA.with_parity("mirrored")
    settings = SolveSettings(method="match_group", deadline_ms=math.inf)
    alone = [
        [record(tracker.solve(xy)) for xy in many[::3]]
        for tracker in (StarTracker(database, camera, settings) for camera in cameras)
    ]
    both = [StarTracker(database, camera, settings) for camera in cameras]
    in_turn = [[record(tracker.solve(xy)) for tracker in both] for xy in many[::3]]
    assert [list(one) for one in zip(*in_turn, strict=True)] == alone


def test_trackers_of_two_threads_share_a_database(database, many):
    """The interpreter's lock is released in the search: they run at the same time."""
    expected = [record(StarTracker(database, CAMERA, PATIENT).solve(xy)) for xy in many]

    def solve_all(_):
        tracker = StarTracker(database, CAMERA, PATIENT)
        return [record(tracker.solve(xy)) for xy in many]

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(solve_all, range(2))) == [expected, expected]


def test_the_order_of_the_centroids_never_changes_a_label(tracker, many):
    rng = np.random.default_rng(21)
    for xy in many:
        first, order = tracker.solve(xy), rng.permutation(len(xy))
        second = tracker.solve(xy[order])
        assert second.status is first.status
        for name in ("catalog_index", "state"):
            np.testing.assert_array_equal(
                getattr(second.identification, name), getattr(first.identification, name)[order]
            )


def unaligned(values):
    """The same numbers one byte beside where numbers begin."""
    raw = np.empty(values.nbytes + 1, np.uint8)
    shifted = raw[1:].view(values.dtype).reshape(values.shape)
    shifted[:] = values
    return shifted


def read_only(values):
    found = values.copy()
    found.setflags(write=False)
    return found


@pytest.mark.parametrize(
    "other",
    [unaligned, read_only, np.asfortranarray, lambda a: a.astype(">f8"), lambda a: a[::-1][::-1]],
    ids=["unaligned", "read-only", "Fortran", "big-endian", "a view"],
)
def test_no_kind_of_array_is_compiled_for_anew(database, many, other):
    tracker = StarTracker(database, CAMERA, PATIENT)
    intensity = np.linspace(1.0, 2.0, len(many[0]))
    expected = record(tracker.solve(many[0], intensity))
    before = len(act.overloads)
    assert record(tracker.solve(other(many[0]), other(intensity))) == expected
    assert len(act.overloads) == before


#: Frames that end in each way, in a process of their own; prints how they ended, and how often
#: something was compiled, or loaded from the cache, after the trackers were made.
FRAMES = """
import math
import numpy as np
from numba.core import event
from star_tracker import FeatureDatabase, SolveSettings, StarCatalog, StarTracker
from star_tracker.any_camera import AnyCameraTracker
from star_tracker.catalogue.ladder import ladder
from star_tracker.maps.simulation import uniform_noise
from star_tracker.maps.star_map import paper_maps

def tracker(camera, **options):
    return StarTracker(database, camera, SolveSettings(deadline_ms=math.inf, **options))

star_map = paper_maps((1,))[0]
camera, xy = star_map.camera, star_map.xy_px
noise, crowd = (uniform_noise(camera, n, np.random.default_rng(n)) for n in (12, 60))
database = FeatureDatabase.build(StarCatalog.paper())
known, both = tracker(camera), tracker(camera.with_parity("auto"), max_centroids=30)
fallback = tracker(camera, method="radial_cyclic")
untold = AnyCameraTracker(ladder((10.0, 14.0), (512, 512)), SolveSettings(deadline_ms=math.inf))
late = event.RecordingListener()
event.register("numba:compiler_lock", late)  # each function takes it that is not there yet
found = known.solve(xy)
solutions = [
    found, known.solve(xy, predicted=found), known.solve(noise), known.solve(noise[:2]),
    both.solve(xy), both.solve(noise, deadline_ms=1e-6),
    both.solve(crowd, 1.0 + np.arange(60.0)), fallback.solve(xy), untold.solve(xy),
]
print(*(one.status.value for one in solutions))
print(sum(one.is_start for _, one in late.buffer))
"""


def test_nothing_is_compiled_while_a_frame_waits():
    """It would take the frame's time: with an empty cache the first ones were TIMEOUT."""
    done = completed("-c", FRAMES)
    assert done.returncode == 0, done.stderr
    ends, compiled = done.stdout.splitlines()
    assert ends.split() == [
        "SOLVED", "SOLVED", "NO_MATCH", "TOO_FEW_STARS", "SOLVED", "TIMEOUT", "NO_MATCH",
        "SOLVED", "SOLVED",
    ]
    assert compiled == "0"


NUMBERS = """
import numpy as np
from numba.core import event
from star_tracker import Camera, FeatureDatabase, SolveSettings, StarCatalog, StarTracker
from star_tracker.commands.compile import exercise_detector, exercise_solver
from star_tracker.detection.centroids import DetectSettings
from star_tracker.detection.detect import detect_stars

exercise_solver()
exercise_detector()
late = event.RecordingListener()
event.register("numba:compiler_lock", late)
camera = Camera(512, np.int64(512), 2436, np.float32(2436), 256, 256, tolerance_percent=5)
settings = SolveSettings(
    centroid_sigma_px=1, displaced_gate_px=np.float32(40), max_log10_false_alarms=-3,
)
xy = np.array([(60, 70), (250, 40), (450, 90), (90, 250)])
database = FeatureDatabase.build(StarCatalog.paper())
print(StarTracker(database, camera, settings).solve(xy, np.arange(1, 5)).status.value)
print(*camera.contains(xy, 3))
image = np.zeros((256, 256), np.int16)
image[::2], image[100:102, 100:102] = 20, 3000
print(len(detect_stars(image, DetectSettings(6, psf_sigma_px=1, saturation_level=2000))))
print(sum(one.is_start for _, one in late.buffer))
"""


def test_numbers_of_other_types_compile_nothing():
    """`displaced_gate_px=40` had the search compiled anew, in a minute, and kept it so."""
    done = completed("-c", NUMBERS)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "0", done.stdout
