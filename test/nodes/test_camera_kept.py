"""What identify_node learnt of its camera is kept, and what was told of it is not touched."""

from contextlib import contextmanager

import pytest
from rclpy.parameter import Parameter
from ros_helpers import IdentifyClient, frame_of, open_bench
from sensor_msgs.msg import CameraInfo
from std_srvs.srv import Trigger

from star_tracker.calibration.camera_file import read_camera, write_camera
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.identify_node import IdentifyNode

(MAP7,) = paper_maps((7,))
PATIENT = {
    "deadline_ms": 60_000.0, "keep_up": False, "catalog": "paper", "width_px": 0, "height_px": 0,
    "parity": "auto",
}
#: Nothing is told of the camera but the size of its image.
UNTOLD = {
    **PATIENT, "fov_deg": 0.0, "parity": "auto", "fov_min_deg": 8.0, "fov_max_deg": 30.0,
    "width_px": 1024, "height_px": 1024,
}
INFO = {**PATIENT, "use_camera_info": True, "parity": "mirrored"}


@contextmanager
def client_of(parameters):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, parameters)
        yield client.connect()


def solved(client):
    answer = client.send(frame_of(MAP7.xy_px))
    return answer.status == "SOLVED"


def change(client, name, value):
    return client.bench.node.set_parameters_atomically([Parameter(name, value=value)])


def saved(client):
    response = client.bench.node._on_save_camera(Trigger.Request(), Trigger.Response())
    return response.success, response.message


@pytest.fixture
def path(tmp_path):
    return tmp_path / "camera.yaml"


def test_a_calibration_that_nothing_was_learnt_of_stays_to_the_last_byte(path):
    write_camera(MAP7.camera, path, name="flight unit 7")
    told = "# in the lab, 2026-03-01\n" + path.read_text()
    path.write_text(told)
    with client_of({**PATIENT, "camera_file": str(path)}) as client:
        assert solved(client)
    assert path.read_text() == told


@pytest.mark.parametrize("there", [True, False])
def test_no_camera_is_made_up_while_camera_info_is_waited_for(there, path):
    if there:
        write_camera(MAP7.camera, path)
        told = path.read_bytes()
    with client_of({**INFO, "camera_file": str(path)}) as client:
        client.bench.until_ready()
        assert saved(client) == (False, "no camera is known yet: show the node some stars")
        (report,) = [
            one for one in client.bench.node._statuses() if one.name.endswith("camera")
        ]
        assert (report.message, report.values) == ("no frame with a camera_info has come yet", [])
    assert path.exists() == there
    if there:
        assert path.read_bytes() == told


@pytest.mark.parametrize(("name", "value"), [
    ("log_frames", True), ("deadline_ms", 50_000.0), ("tracking_max_age_s", 1.0),
    ("min_separation_deg", 0.2),
])
def test_what_was_learnt_outlasts_a_change_of_other_parameters(name, value, path, capfd):
    with client_of({**UNTOLD, "camera_file": str(path)}) as client:
        assert solved(client)
        solver = client.bench.node._solver
        learnt, frames = solver.camera, solver.tracker.estimate.n_frames
        assert change(client, name, value).successful
        client.bench.until_true(lambda: client.bench.node._solver is not solver, "change")
        assert client.bench.node._solver.camera == learnt
        assert solved(client)
        assert client.bench.node._solver.tracker.estimate.n_frames == frames + 1
        assert client.bench.node._solver.camera.fov_deg == pytest.approx(20.0, rel=1e-3)
    assert read_camera(path).fov_deg == pytest.approx(20.0, rel=1e-3)
    log = capfd.readouterr().err
    assert log.count("camera found") == 1
    assert f"written to {path}" in log


def test_another_range_of_fields_of_view_begins_anew():
    with client_of(UNTOLD) as client:
        assert solved(client)
        solver = client.bench.node._solver
        assert change(client, "fov_max_deg", 29.0).successful
        client.bench.until_true(lambda: client.bench.node._solver is not solver, "change")
        assert client.bench.node._solver.camera is None
        assert solved(client)


def test_a_file_that_was_written_meanwhile_is_read_at_the_next_start_alone(path):
    with client_of({**UNTOLD, "camera_file": str(path)}) as client:
        assert solved(client)
        database = client.bench.node._solver.database
        assert saved(client)[0]
        assert change(client, "log_frames", True).successful
        assert client.bench.node._setup.camera is None
        assert client.bench.node._solver.database is database
        assert solved(client)
        path.unlink()
        assert change(client, "log_frames", False).successful
        assert solved(client)


def test_a_folder_that_is_not_there_is_told_before_anything_is_learnt(tmp_path):
    lost = tmp_path / "lost" / "camera.yaml"
    with open_bench() as bench, pytest.raises(ParameterError, match=r"there is no folder .*lost"):
        bench.start(IdentifyNode, {**UNTOLD, "camera_file": str(lost)})


def test_a_camera_that_cannot_be_kept_is_told_at_the_end(tmp_path, capfd):
    folder = tmp_path / "gone"
    folder.mkdir()
    with client_of({**UNTOLD, "camera_file": str(folder / "camera.yaml")}) as client:
        assert solved(client)
        folder.rmdir()
    assert "cannot be written: No such file or directory" in capfd.readouterr().err


def test_a_parity_that_is_told_holds_above_that_of_the_file(path):
    write_camera(MAP7.camera.with_parity("normal"), path)
    with client_of({**PATIENT, "camera_file": str(path)}) as client:
        answer = client.send(frame_of(MAP7.xy_px))
        assert answer.values["hint"] == "image looks mirrored: parity mirrored solves it"
        assert change(client, "parity", "mirrored").successful
        assert solved(client)


def test_a_hint_names_what_the_user_has_told(path):
    write_camera(MAP7.camera.scaled(1.04), path)
    with client_of({**PATIENT, "camera_file": str(path)}) as client:
        hint = client.send(frame_of(MAP7.xy_px)).values["hint"]
    assert hint.startswith("improves if the field of view of camera_file is 20.")
    with client_of({**INFO, "camera_info_tolerance_percent": 0.0}) as client:
        infos = client.bench.connected_outbox(CameraInfo, "camera_info")
        infos.publish(info_from_camera(MAP7.camera.scaled(1.04), frame_of(MAP7.xy_px).header))
        hint = client.send(frame_of(MAP7.xy_px)).values["hint"]
        assert hint.startswith("improves if the field of view of camera_info is 20.")
        assert hint.endswith("or may be off: camera_info_tolerance_percent")
        # What the hint says can be done, and helps.
        assert change(client, "camera_info_tolerance_percent", 5.0).successful
        assert solved(client)
        camera = client.bench.node._solver.camera
        assert camera.fov_deg == pytest.approx(20.0, rel=1e-3)


def test_rectified_without_camera_info_is_refused():
    with open_bench() as bench, pytest.raises(ParameterError, match="rectified is true and use_"):
        bench.start(IdentifyNode, {**UNTOLD, "rectified": True})
