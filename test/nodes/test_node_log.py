"""identify_node tells a person what goes on: the log, and the same in /diagnostics."""

import numpy as np
import pytest
from ros_helpers import frame_of, new_header
from test_node_health import MAP1, health, identify_client, map1, name_of

from star_tracker.maps.simulation import uniform_noise
from star_tracker.nodes.identify import announcements

HINT = "image looks mirrored: parity mirrored solves it"


def lines(capfd):
    """Return (level, text) of all that the node has logged after it was ready."""
    logged = [
        (line.split("]")[0].strip("["), line.split("identify_node]: ")[1])
        for line in capfd.readouterr().err.splitlines() if "identify_node]: " in line
    ]
    ready = next(i for i, (_, text) in enumerate(logged) if text.startswith("ready: "))
    return logged[ready + 1 :]


def noise():
    return frame_of(uniform_noise(MAP1.camera, 8, np.random.default_rng(1)))


def test_first_fix_lost_and_found_again_are_said(capfd):
    with identify_client() as client:
        for frame in [map1(), map1(), noise(), noise(), noise(), map1(), map1()]:
            client.send(frame)
    first, lost, found = lines(capfd)
    assert first == ("INFO", "first fix: RA 109.600 Dec +34.500, 15 of 15 stars")
    assert lost[0] == "WARN"
    assert lost[1].startswith("lost after 2 solved frames: NO_MATCH: the best of ")
    assert found == ("INFO", "found again after 3 frames: RA 109.600 Dec +34.500, 15 of 15 stars")


def test_what_would_help_is_said_and_stands_in_diagnostics(capfd, monkeypatch):
    monkeypatch.setattr(announcements, "QUIET_S", 1000.0)
    with identify_client({"parity": "normal"}) as client:
        for _ in range(3):
            client.send(map1())
        values = health(client, lambda values: values["frames"] == "3")
    (line,) = lines(capfd)
    assert line[0] == "WARN"
    assert line[1].startswith("no fix in 3 frames: NO_MATCH: ")
    assert line[1].endswith(f"; {HINT}")
    assert (values["hint"], values["boresight"], values["fix_age_s"]) == (HINT, "n/a", "n/a")


def test_diagnostics_say_where_the_camera_points_and_which_hardware_it_is():
    with identify_client() as client:
        client.send(frame_of(MAP1.xy_px, new_header("star_camera")))
        values = health(client, lambda values: values["frames"] == "1")
        status = client.reports.messages[-1].status[0]
    assert values["boresight"] == "RA 109.600 Dec +34.500"
    assert float(values["fix_age_s"]) >= 0
    assert values["hint"] == "n/a"
    assert status.hardware_id == "star_camera"
    assert status.name == f"{client.bench.namespace[1:]}/identify_node: health"


@pytest.mark.parametrize("camera_frame", ["cam", ""])
def test_hardware_before_the_first_frame(camera_frame):
    with identify_client({"camera_frame": camera_frame}) as client:
        health(client)
        status = client.reports.messages[-1].status[0]
        name = name_of(client).removesuffix(": health")
    assert status.hardware_id == (camera_frame or name)


def test_each_kind_of_complaint_is_said_though_another_was_just_said(capfd):
    with identify_client() as client:
        for change in ({"fields": []}, {"point_step": 0}):
            frame = map1()
            for name, value in change.items():
                setattr(frame, name, value)
            client.send(frame)
        client.send(frame_of(np.full((10, 2), np.nan)))
        client.send(frame_of(np.concatenate([[[np.nan, 1.0]], MAP1.xy_px])))
    said = [text for level, text in lines(capfd) if level in ("ERROR", "WARN")]
    assert len(said) == 3
    assert said[0].startswith("PointCloud2 has no field x")  # and of its kind no second one
    assert said[1].startswith("all 10 centroids are non-finite")
    assert said[2].startswith("1 centroids are non-finite or outside of the image")


def test_every_frame_is_a_line_where_that_is_wanted(capfd):
    with identify_client({"log_frames": True}) as client:
        for frame in (map1(), noise(), map1()):
            client.send(frame)
    one, two, three = (text for _, text in lines(capfd))
    assert one.startswith("SOLVED: RA 109.600 Dec +34.500, 15 of 15 stars, rms 0.00 px, ")
    assert two.startswith("NO_MATCH: ")
    assert three.startswith("SOLVED: ")
