"""identify_node finds its camera out, keeps what it learnt, and reads it at the next start."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Vector3Stamped
from ros_helpers import frame_of, new_header, open_bench, stamp_ns
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from star_tracker.calibration.camera_file import read_camera
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.solution import values_from_diagnostics
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.identify_node import IdentifyNode

MAP1, MAP7 = paper_maps((1, 7))
#: Nothing is told of the camera but the size of its image.
UNTOLD = {
    "fov_deg": 0.0, "parity": "auto", "deadline_ms": 60_000.0, "keep_up": False,
    "fov_min_deg": 8.0, "fov_max_deg": 30.0,
}


def answers(parameters, maps, less_px=0.0):
    """The status and boresight (or None) of each map's frame, and the camera as found.

    Coordinates are `less_px` less than the map's.
    """
    with open_bench() as bench:
        frames = bench.outbox(PointCloud2, "centroids")
        solutions = bench.inbox(DiagnosticArray, "solution")
        boresights = bench.inbox(Vector3Stamped, "boresight_deg")
        node = bench.start(IdentifyNode, parameters)
        bench.until(lambda: frames.n_subscribers and solutions.n_publishers, "connection")
        found = []
        for star_map in maps:
            header = new_header()
            frames.publisher.publish(frame_of(star_map.xy_px - less_px, header))
            stamp = stamp_ns(header)
            bench.until(lambda stamp=stamp: solutions.at(stamp), "solution")
            (solution,) = solutions.at(stamp)
            values = values_from_diagnostics(solution)
            if values["status"] == "SOLVED":
                bench.until(lambda stamp=stamp: boresights.at(stamp), "boresight")
            found.append((values, boresights.at(stamp)))
        return found, node._solver.camera


@pytest.mark.parametrize("catalog", ["paper", "hipparcos"])
def test_a_camera_of_which_nothing_is_told_is_found(catalog, capfd):
    parameters = {**UNTOLD, "width_px": 512, "height_px": 512, "catalog": catalog}
    found, camera = answers(parameters, [MAP1, MAP1])
    for values, (boresight,) in found:
        assert values["status"] == "SOLVED"
        assert values["parity"] == "mirrored"
        v = boresight.vector
        np.testing.assert_allclose([v.x, v.y], [109.6, 34.5], atol=0.01)
    assert camera.fov_deg == pytest.approx(12.0, rel=2e-3)
    lines = [line for line in capfd.readouterr().err.splitlines() if "camera found" in line]
    assert len(lines) == 1
    assert "field of view 12" in lines[0]


def test_what_was_learnt_is_kept_in_a_file_for_the_next_start(tmp_path, capfd):
    path = tmp_path / "camera.yaml"
    sized = {**UNTOLD, "width_px": 1024, "height_px": 1024, "catalog": "paper"}
    answers({**sized, "camera_file": str(path)}, [MAP7])
    kept = read_camera(path)
    assert (kept.width_px, kept.parity) == (1024, "mirrored")
    assert kept.fov_deg == pytest.approx(20.0, rel=1e-3)
    capfd.readouterr()
    found, _ = answers({**sized, "camera_file": str(path)}, [MAP7])
    assert found[0][0]["status"] == "SOLVED"
    assert "camera found" not in capfd.readouterr().err


def test_centroids_are_counted_as_is_told_and_the_file_as_ros_counts(tmp_path):
    """The same sky and the same file, however the detector counts: found, kept, and read."""
    sized = {**UNTOLD, "width_px": 1024, "height_px": 1024, "catalog": "paper"}
    pointed, files = [], []
    for origin, less_px in (("corner", 0.0), ("center", 0.5)):
        path = tmp_path / f"{origin}.yaml"
        told = {**sized, "camera_file": str(path), "pixel_origin": origin}
        for _ in range(2):
            (found,), _ = answers(told, [MAP7], less_px)
            v = found[1][0].vector
            pointed.append([v.x, v.y, v.z])
        files.append(read_camera(path))
    np.testing.assert_allclose(pointed[2:], pointed[:2], rtol=0, atol=1e-6)
    corner, center = files
    assert (corner.cx_px, corner.cy_px) == (center.cx_px, center.cy_px) == (512.0, 512.0)
    assert corner.fx_px == pytest.approx(center.fx_px, rel=1e-7)


def test_the_camera_is_saved_on_request(tmp_path):
    path = tmp_path / "camera.yaml"
    with open_bench() as bench:
        frames = bench.outbox(PointCloud2, "centroids")
        solutions = bench.inbox(DiagnosticArray, "solution")
        client = bench.probe.create_client(
            Trigger, f"{bench.namespace}/identify_node/save_camera"
        )
        bench.start(IdentifyNode, {
            **UNTOLD, "width_px": 512, "height_px": 512, "catalog": "paper",
            "camera_file": str(path),
        })
        bench.until(lambda: frames.n_subscribers and solutions.n_publishers, "connection")
        frames.publisher.publish(frame_of(MAP1.xy_px))
        bench.until(lambda: solutions.messages, "solution")
        future = client.call_async(Trigger.Request())
        future.add_done_callback(lambda _: bench._event())
        bench.until(future.done, "answer")
    assert future.result().success
    assert future.result().message.startswith("camera of 12")
    assert read_camera(path).fov_deg == pytest.approx(12.0, rel=2e-3)


@pytest.mark.parametrize(("parameters", "sentence"), [
    ({"fov_min_deg": 40.0, "fov_max_deg": 10.0},
     "parameter fov_min_deg is 40, more than fov_max_deg 10"),
    ({"width_px": 0}, "parameters width_px and height_px are 0"),
    ({"fov_deg": 0.2}, "parameter fov_deg is 0.2: it must be 0"),
])
def test_what_cannot_be_a_camera_is_refused_in_a_sentence(parameters, sentence):
    with open_bench() as bench, pytest.raises(ParameterError, match=sentence):
        bench.start(IdentifyNode, parameters)


def test_a_camera_file_of_another_size_is_refused(tmp_path):
    path = tmp_path / "camera.yaml"
    sized = {**UNTOLD, "width_px": 512, "height_px": 512, "catalog": "paper"}
    answers({**sized, "camera_file": str(path)}, [MAP1])
    with open_bench() as bench, pytest.raises(ParameterError, match="calibrate this size"):
        bench.start(IdentifyNode, {
            **sized, "width_px": 640, "height_px": 480, "camera_file": str(path),
        })
