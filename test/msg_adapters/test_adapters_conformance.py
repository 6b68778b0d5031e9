"""CameraInfo as its definition says: one sky, seen by each camera, gives one boresight.

The table of docs/camera_info.md names these tests. The frames are rendered in pixels of the full
raw image; the camera's region and binning are then applied to the centroids, not to the camera.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, RegionOfInterest

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.maps.simulation import Condition, synthetic_field, visible_stars
from star_tracker.msg_adapters.camera_info import camera_from_info
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.solution import SolveSettings, Status
from star_tracker.tracker import StarTracker

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "camera_info.md"
#: Standard deviation of a centroid along each axis, in pixels of the full image.
NOISE_PX = 0.2
#: 24 deg over 2048 px; the principal point is far enough off the middle to be missed.
FULL = Camera(2048, 1536, 4817.5, 4817.5, 1060.25, 740.5)
#: Towards Orion.
ROTATION = rotation_from_boresight(*np.radians([84.0, 1.0, 30.0]))
BARREL = Distortion("plumb_bob", (-0.25, 0.08, 0.0008, -0.0006, -0.01))
PATIENT = SolveSettings(deadline_ms=60_000.0)


@dataclass(frozen=True)
class Readout:
    """What of the full image is read out: a region, then binned."""

    x: int = 0
    y: int = 0
    width: int = 0
    height: int = 0
    bin_x: int = 1
    bin_y: int = 1

    def image(self, xy_px):
        """Return the centroids (n, 2) in the image, in its own pixels."""
        size = np.array([self.width or FULL.width_px, self.height or FULL.height_px])
        xy = xy_px - (self.x, self.y)
        return xy[np.all((xy >= 0) & (xy <= size), axis=1)] / (self.bin_x, self.bin_y)

    @property
    def fields(self):
        """Its fields of a CameraInfo."""
        roi = RegionOfInterest(
            x_offset=self.x, y_offset=self.y, width=self.width, height=self.height
        )
        return {"roi": roi, "binning_x": self.bin_x, "binning_y": self.bin_y}


def info_of(camera, readout=Readout(), **changes):
    """A CameraInfo of a full image, with the readout's fields; D in full, also zeros."""
    lens = camera.distortion
    return CameraInfo(**{
        "width": camera.width_px, "height": camera.height_px,
        "k": [camera.fx_px, 0.0, camera.cx_px, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 1.0],
        "distortion_model": lens.model if lens else "plumb_bob",
        "d": list(lens.coefficients) if lens else [0.0] * 5, **readout.fields, **changes,
    })


def rendered(database, camera):
    """The centroids of the sky in the full image of a camera, pixels."""
    rng = np.random.default_rng(15)
    return synthetic_field(
        database.catalog, camera, ROTATION, rng, Condition(noise_px=NOISE_PX)
    ).xy_px


def solved(database, message, xy_px, *, rectified=False):
    """Solve a frame with the camera of a message."""
    camera = camera_from_info(message, "normal", rectified=rectified)
    solution = StarTracker(database, camera, PATIENT).solve(xy_px)
    assert solution.status is Status.SOLVED, solution.reason
    assert solution.n_ignored == 0
    assert len(solution.identification.identified) == len(xy_px) > 9
    return solution


def is_right(solution, rms_px=2 * NOISE_PX):
    """Whether the attitude is within three standard deviations about each of the camera's axes.

    And these no larger than the noise makes them: residuals of a wrong camera widen them.
    """
    attitude = solution.attitude
    error = Rotation.from_matrix(ROTATION.T @ attitude.rotation).as_rotvec()
    deviations = np.abs(error) / np.sqrt(np.diag(attitude.covariance_rad2))
    return deviations.max() < 3 and solution.rms_px < rms_px


READOUTS = {
    "the full image": Readout(),
    "a region": Readout(x=700, y=500, width=1024, height=768),
    "a region in the corner": Readout(x=1000, y=700, width=1048, height=836),
    "binning": Readout(bin_x=2, bin_y=2),
    "binning unlike in x and y": Readout(bin_x=4, bin_y=2),
    "a region, binned": Readout(x=300, y=200, width=1400, height=1000, bin_x=2, bin_y=2),
}
LENSES = {
    "none": None,
    "plumb_bob": BARREL,
    "rational_polynomial of 8": Distortion(
        "rational_polynomial", (0.4, 0.1, 0.0002, -0.0001, 0.01, 0.6, 0.2, 0.02)
    ),
    "rational_polynomial of 12": Distortion("rational_polynomial", (
        -0.2, 0.05, 0.0005, -0.0004, 0.01, 0.02, 0.01, 0.0, 0.01, -0.02, 0.015, 0.005,
    )),
    "rational_polynomial of 14": Distortion("rational_polynomial", (
        -0.2, 0.05, 0.0005, -0.0004, 0.01, 0.02, 0.01, 0.0, 0.01, -0.02, 0.015, 0.005, 0.05, -0.03,
    )),
    # As fits of all eight give them: numerator and denominator nearly cancel.
    "rational_polynomial of large numbers": Distortion(
        "rational_polynomial", (680.0, 1357.0, 0.0004, -0.0003, 240.0, 680.3, 1361.0, 420.0)
    ),
    "equidistant": Distortion("equidistant", (-0.02, 0.004, -0.001, 0.0002)),
    "equidistant of zeros": Distortion("equidistant", (0.0,) * 4),
}


@pytest.mark.parametrize("readout", READOUTS.values(), ids=READOUTS)
@pytest.mark.parametrize("lens", [None, BARREL], ids=["no lens", "a lens"])
def test_each_readout_gives_the_boresight(database, readout, lens):
    camera = replace(FULL, distortion=lens)
    xy = readout.image(rendered(database, camera))
    assert is_right(solved(database, info_of(camera, readout), xy))


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_each_distortion_model_gives_the_boresight(database, lens):
    camera = replace(FULL, distortion=lens)
    xy = rendered(database, camera)
    assert is_right(solved(database, info_of(camera), xy))


def test_unlike_focal_lengths_give_the_boresight(database):
    camera = replace(FULL, fy_px=4000.0, distortion=BARREL)
    xy = rendered(database, camera)
    assert is_right(solved(database, info_of(camera), xy))


@pytest.mark.parametrize("name", ["the full image", "a region", "a region, binned"])
def test_rectified_centroids_give_the_boresight(database, name):
    """P is not K: calibrations scale the rectified image to lose no corner of it."""
    readout, projected = READOUTS[name], Camera(2048, 1536, 4600.0, 4650.0, 1010.0, 770.0)
    xy = readout.image(rendered(database, projected))
    p = [4600.0, 0.0, 1010.0, -35.0, 0.0, 4650.0, 770.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    message = info_of(replace(FULL, distortion=BARREL), readout, p=p)
    assert is_right(solved(database, message, xy, rectified=True))


@pytest.mark.parametrize("ignored", ["roi", "binning_x", "binning_y", "d", "k"])
def test_a_field_that_was_ignored_would_be_noticed(database, ignored):
    """The tests above can fail: each of these fields is needed for what they hold."""
    readout = Readout(x=800, y=500, width=1240, height=1000, bin_x=2, bin_y=2)
    camera = replace(FULL, distortion=BARREL)
    xy = readout.image(rendered(database, camera))
    default = {
        "roi": RegionOfInterest(), "binning_x": 1, "binning_y": 1, "d": [],
        "k": [4817.5, 0.0, 1024.0, 0.0, 4817.5, 768.0, 0.0, 0.0, 1.0],
    }[ignored]
    message = info_of(camera, readout, **{ignored: default})
    tracker = StarTracker(database, camera_from_info(message, "normal"), SolveSettings())
    solution = tracker.solve(xy)
    assert solution.status is not Status.SOLVED or not is_right(solution)


@pytest.mark.parametrize(("focal", "widest_deg", "rms_px"), [
    (800.0, 45.0, 2 * NOISE_PX),
    # 180 deg from corner to corner but for the last two. Residuals grow there, as they are those
    # of the tangent plane, which stretches.
    (522.0, 88.0, 4 * NOISE_PX),
])
def test_a_fisheye_by_hand_gives_the_boresight(focal, widest_deg, rms_px):
    """Wide ones, r = f theta: taken for a pinhole it would be off by half a degree."""
    catalog = StarCatalog.hipparcos(limiting_magnitude=4.5)
    local = catalog.vectors @ ROTATION
    theta = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
    ahead = theta < np.radians(widest_deg)
    direction = local[ahead, :2] / np.hypot(local[ahead, 0], local[ahead, 1])[:, None]
    xy = (640.0, 512.0) + focal * theta[ahead, None] * direction
    xy = xy[np.all((xy > 1) & (xy < (1279, 1023)), axis=1)]
    xy += np.random.default_rng(16).normal(0, NOISE_PX, xy.shape)
    message = CameraInfo(
        width=1280, height=1024, k=[focal, 0.0, 640.0, 0.0, focal, 512.0, 0.0, 0.0, 1.0],
        distortion_model="equidistant", d=[],
    )
    tracker = StarTracker(
        FeatureDatabase.build(catalog), camera_from_info(message, "normal"), PATIENT
    )
    solution = tracker.solve(xy)
    assert solution.status is Status.SOLVED
    assert is_right(solution, rms_px)


# A lens that has no ray for the corners of its image (ros-perception/image_pipeline #154)


BLIND = CameraInfo(
    width=752, height=480, k=[531.4, 0.0, 376.0, 0.0, 531.4, 240.0, 0.0, 0.0, 1.0],
    distortion_model="plumb_bob", d=[-0.405, 0.267, 0.0, 0.0, -0.130],
)
CORNERS = np.array([(5.0, 5.0), (745.0, 8.0), (4.0, 470.0), (748.0, 474.0)])


def blind_places(catalog):
    """Tangent of the angle off the axis of each star ahead, its place by the polynomial, index."""
    local = catalog.vectors @ ROTATION
    index = np.flatnonzero(local[:, 2] > 0.1)
    plane = local[index, :2] / local[index, 2:]
    r2 = (plane**2).sum(axis=1)
    bent = 1 - 0.405 * r2 + 0.267 * r2**2 - 0.130 * r2**3
    return np.sqrt(r2), (376.0, 240.0) + 531.4 * plane * bent[:, None], index


def in_image(xy):
    return np.all((xy >= 0) & (xy <= (752, 480)), axis=1)


@pytest.fixture(scope="module")
def bright():
    return StarCatalog.hipparcos(limiting_magnitude=4.0)


def test_a_lens_with_blind_corners_is_used_and_what_lies_there_is_left_out(bright):
    r, xy, index = blind_places(bright)
    seen = in_image(xy) & (r < 1.06)
    xy = xy[seen] + np.random.default_rng(17).normal(0, NOISE_PX, (seen.sum(), 2))
    tracker = StarTracker(
        FeatureDatabase.build(bright), camera_from_info(BLIND, "normal"), PATIENT
    )
    solution = tracker.solve(np.concatenate([CORNERS, xy]))
    assert solution.status is Status.SOLVED
    assert solution.n_ignored == len(CORNERS)
    labels = solution.identification.catalog_index
    assert np.all(labels[: len(CORNERS)] == -1)
    named = labels[len(CORNERS) :] >= 0
    # Next to the turning point the lens magnifies noise without bound.
    assert named.mean() > 0.9
    np.testing.assert_array_equal(labels[len(CORNERS) :][named], index[seen][named])
    assert is_right(solution)


def test_no_guide_star_folds_back_into_the_image_of_such_a_lens(bright):
    """Beyond its turning point the polynomial puts stars back into the image, among the others."""
    r, xy, index = blind_places(bright)
    folded = in_image(xy) & (r > 1.07)
    assert folded.sum() > 5
    camera = camera_from_info(BLIND, "normal")
    found, _ = visible_stars(bright, camera, ROTATION)
    np.testing.assert_array_equal(found, index[in_image(xy) & (r < 1.068)])
    # A centroid where such a star would be is any star but that one.
    tracker = StarTracker(FeatureDatabase.build(bright), camera, PATIENT)
    seen = in_image(xy) & (r < 1.06)
    labels = tracker.solve(np.concatenate([xy[seen], xy[folded]])).identification.catalog_index
    assert (labels[: seen.sum()] >= 0).mean() > 0.9
    assert not np.isin(labels, index[folded]).any()


def test_frames_of_nothing_but_blind_corners_are_bad_input(bright):
    tracker = StarTracker(FeatureDatabase.build(bright), camera_from_info(BLIND, "normal"))
    solution = tracker.solve(CORNERS)
    assert (solution.status, solution.n_ignored) == (Status.BAD_INPUT, 4)


# The page


def rows():
    """The rows of the page's table: field, its fate, the tests that hold it."""
    table = PAGE.read_text(encoding="utf-8").split("| field |")[1].split("\n\n")[0]
    return [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in table.splitlines()[2:] if line.startswith("|")
    ]


def test_the_page_tells_what_becomes_of_each_field():
    fields = set(CameraInfo.get_fields_and_field_types()) - {"roi"}
    fields |= {f"roi.{name}" for name in RegionOfInterest.get_fields_and_field_types()}
    told = {name for row in rows() for name in re.findall(r"`([\w.]+)`", row[0])}
    assert told == fields


def test_the_page_names_tests_that_there_are():
    tests = set()
    for path in (ROOT / "test").rglob("test_*.py"):
        tests |= set(re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.M))
    for field, *_, held in rows():
        names = re.findall(r"`(test_\w+)`", held)
        assert names, field
        assert set(names) <= tests, set(names) - tests
