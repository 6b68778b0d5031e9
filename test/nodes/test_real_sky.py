"""Real images of the night sky through both nodes, held against their truth."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from real_sky_files import FOLDER, rows_of
from ros_helpers import new_header, open_bench, stamp_ns
from sensor_msgs.msg import Image, PointCloud2

from star_tracker.detection.detect import detect_stars
from star_tracker.geometry.spherical import separation, unit_vectors
from star_tracker.msg_adapters.detected_stars import cloud_from_detected
from star_tracker.msg_adapters.image import Picture, image_from_picture
from star_tracker.msg_adapters.solution import values_from_diagnostics
from star_tracker.nodes.camera_to_attitude import make_nodes
from star_tracker.offline.image_file import read_image

pytest.importorskip("PIL", reason="reading pictures needs Pillow, an extra")
pytestmark = [
    pytest.mark.slow, pytest.mark.usefixtures("solver_compiled"),
    pytest.mark.skipif(FOLDER is None, reason="needs shared/real_sky beside the checkout"),
]
#: One camera of which nothing is told: the truth is good to 0.01 to 0.1 deg.
WIDTH_PX, HEIGHT_PX, RIGHT_DEG = 808, 608, 0.1
TOLD = [
    "-p", "pixel_origin:=corner", "-p", f"width_px:={WIDTH_PX}", "-p", f"height_px:={HEIGHT_PX}",
    "-p", "deadline_ms:=5000.0", "-p", "keep_up:=false",
]


def truth():
    """The boresight (ra, dec), deg, by file of that camera's images."""
    return {
        row["file"]: (float(row["ra_deg"]), float(row["dec_deg"]))
        for row in rows_of("truth.csv") if row["file"].startswith(("a16", "b16"))
    }


@pytest.fixture(scope="module")
def answers():
    """Give the cloud, the status and the boresight (or None) of each image, in their order."""
    found = {}
    with open_bench() as bench:
        clouds = bench.inbox(PointCloud2, "centroids")
        solutions = bench.inbox(DiagnosticArray, "solution")
        boresights = bench.inbox(Vector3Stamped, "boresight_deg")
        nodes = make_nodes(
            context=bench.context, namespace=bench.namespace, cli_args=["--ros-args", *TOLD]
        )
        centroid, identify = (bench._add(node) for node in nodes)
        bench.until_true(lambda: centroid.ready and identify.ready, "solver and detector")
        images = bench.connected_outbox(Image, "image")
        bench.until(
            lambda: all(one.n_publishers for one in (clouds, solutions, boresights)), "publishers"
        )
        names = [*truth(), *sorted(path.name for path in FOLDER.glob("negative_*"))]
        for name in names:
            header = new_header()
            stamp = stamp_ns(header)
            picture = Picture(read_image(FOLDER / name))
            images.publish(image_from_picture(picture, "mono8", header))
            bench.until(lambda stamp=stamp: solutions.at(stamp), f"solution of {name}")
            bench.until(lambda stamp=stamp: clouds.at(stamp), f"centroids of {name}")
            status = values_from_diagnostics(solutions.at(stamp)[0])["status"]
            if status == "SOLVED":
                bench.until(lambda stamp=stamp: boresights.at(stamp), f"boresight of {name}")
            found[name] = clouds.at(stamp)[0], status, *(boresights.at(stamp) or [None])
    return found


def test_the_centroids_are_those_of_the_detector_bit_for_bit(answers):
    for name, (cloud, *_) in answers.items():
        expected = cloud_from_detected(
            detect_stars(read_image(FOLDER / name)), cloud.header, pixel_origin="corner"
        )
        assert cloud == expected, name


def test_every_sky_is_solved_and_true(answers):
    for name, where in truth().items():
        _, status, boresight = answers[name]
        assert status == "SOLVED", name
        found = unit_vectors(*np.radians([boresight.vector.x, boresight.vector.y]))
        off_deg = np.degrees(separation(found, unit_vectors(*np.radians(where))))
        assert off_deg < RIGHT_DEG, name


def test_a_dark_frame_is_not(answers):
    dark = [status for name, (_, status, _) in answers.items() if name.startswith("negative")]
    assert len(dark) == 2
    assert "SOLVED" not in dark
