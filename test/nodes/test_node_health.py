"""identify_node: /diagnostics, imu, markers, and the hints of `solution`."""

from contextlib import contextmanager

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from ros_helpers import (
    IdentifyClient,
    array_from_quaternion,
    frame_of,
    health_from_diagnostics,
    new_header,
    open_bench,
    stamp_ns,
)
from sensor_msgs.msg import Imu
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker, MarkerArray

from star_tracker.maps.simulation import uniform_noise
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.imu import orientation_from_imu
from star_tracker.msg_adapters.solution import QUALITIES
from star_tracker.nodes.identify import health as health_module
from star_tracker.nodes.identify_node import IdentifyNode

MAP1 = paper_maps((1,))[0]
MAPS_12 = {"parity": "mirrored", "deadline_ms": 60_000.0, "keep_up": False}


@pytest.fixture(autouse=True)
def quick_reports(monkeypatch):
    monkeypatch.setattr(health_module, "_PERIOD_S", 0.1)


@contextmanager
def identify_client(parameters=None):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        client.reports = bench.inbox(DiagnosticArray, "/diagnostics")
        bench.start(IdentifyNode, {**MAPS_12, **(parameters or {})})
        bench.until(lambda: client.reports.n_publishers, "publisher of /diagnostics")
        client.connect()
        # A report from before it was ready may still be under way; topics keep their order.
        bench.until(lambda: reports_of_a_ready_node(client), "report of the ready node")
        yield client


def reports_of_a_ready_node(client):
    return [m for m in client.reports.messages if not m.status[0].message.startswith("starting: ")]


@pytest.fixture(scope="module")
def client():
    with identify_client() as result:
        yield result


def name_of(client):
    return f"{client.bench.node.get_fully_qualified_name()[1:]}: health"


def health(client, condition=lambda _: True):
    """Return the values of the next report that meets a condition."""
    seen, found = len(client.reports.messages), []

    def look():
        for message in client.reports.messages[seen:]:
            values = health_from_diagnostics(message, name_of(client))
            if condition(values):
                found.append(values)
        return found

    client.bench.until(look, "report in /diagnostics")
    return found[0]


def map1():
    return frame_of(MAP1.xy_px)


def some_of_map1():
    """Stars enough for a solution, and so few that a search in vain is soon at its end."""
    return frame_of(MAP1.xy_px[:9])


# ---- /diagnostics ----------------------------------------------------------------------------


def test_health_comes_without_any_frame_and_says_so():
    with identify_client() as client:
        values = health(client)
        status = client.reports.messages[-1].status[0]
    assert (status.level, status.message) == (DiagnosticStatus.WARN, "no frame in the last 10 s")
    assert (values["frames"], values["solve_ratio"], values["input_age_s"]) == ("0", "n/a", "n/a")


def test_health_counts_what_happens():
    with identify_client() as client:
        for _ in range(3):
            client.send(map1())
        client.send(frame_of(uniform_noise(MAP1.camera, 8, np.random.default_rng(1))))
        broken = map1()
        broken.height = 2
        client.send(broken)
        values = health(client, lambda values: values["frames"] == "5")
        assert (values["solved"], values["solve_ratio"]) == ("3", "0.600")
        assert values["rejected_malformed_cloud"] == "1"
        assert values["last_reason"].startswith("BAD_INPUT: PointCloud2 data has ")
        assert values["false_star_ratio"] == "0.000"
        assert 0 < float(values["latency_p50_ms"]) <= float(values["latency_p95_ms"])
        assert float(values["latency_p95_ms"]) <= float(values["latency_max_ms"])
        # All frames of less than a second ago, which counts as one.
        assert 0.2 < float(values["frames_per_s"]) <= 5.0
        assert values["dropped"] == "0"


def test_false_stars_show_in_their_ratio():
    false = uniform_noise(MAP1.camera, 5, np.random.default_rng(2))
    with identify_client() as client:
        client.send(frame_of(np.concatenate([MAP1.xy_px, false])))
        values = health(client, lambda values: values["frames"] == "1")
    assert float(values["false_star_ratio"]) == pytest.approx(5 / 20, abs=0.051)


def test_input_age_is_known_where_stamps_are_of_the_nodes_clock(client):
    frame = map1()
    client.send(frame)
    assert health(client)["input_age_s"] == "n/a"  # stamps of 1970
    frame = map1()
    frame.header.stamp = client.bench.probe.get_clock().now().to_msg()
    client.send(frame)
    age = health(client, lambda values: values["input_age_s"] != "n/a")["input_age_s"]
    assert 0 <= float(age) < 10


def test_health_names_catalogue_configuration_and_version(client):
    client.send(map1())
    values = health(client)
    assert values["catalog"] == client.bench.node._solver.catalog.description
    assert len(values["configuration"]) == 12
    assert int(values["configuration"], 16) >= 0
    assert values["version"]


def test_configuration_digest_follows_the_parameters():
    digests = []
    for parameters in ({}, {}, {"displaced_gate_px": 39.0}):
        with open_bench() as bench:
            digests.append(bench.start(IdentifyNode, parameters)._setup.digest)
    assert digests[0] == digests[1] != digests[2]


def test_an_error_inside_costs_one_frame_only(client, monkeypatch):
    def fail(*_, **__):
        raise RuntimeError("out of order")

    before = client.bench.node.rejected["internal_error"]
    with monkeypatch.context() as patch:
        patch.setattr(client.bench.node._solver.tracker, "solve", fail)
        outcome = client.send(map1())
    assert outcome.status == "BAD_INPUT"
    assert outcome.values["reason"] == "RuntimeError: out of order"
    assert client.bench.node.rejected["internal_error"] == before + 1
    assert client.send(map1()).status == "SOLVED"


# ---- imu and markers -------------------------------------------------------------------------


def test_imu_is_the_attitude_of_the_camera_frame(client):
    imus = client.bench.inbox(Imu, "imu")
    client.bench.until(lambda: imus.n_publishers, "publisher of imu")
    frame = frame_of(MAP1.xy_px, new_header("star_camera"))
    outcome = client.send(frame)
    client.bench.until(lambda: imus.messages, "imu")
    (message,) = imus.messages
    quaternion, covariance = orientation_from_imu(message)
    np.testing.assert_array_equal(quaternion, array_from_quaternion(outcome.attitude))
    assert message.header == frame.header
    # Of 15 stars at a pixel of 84 arcsec: some arcsec, ten times that in roll. The noise is not
    # told, so that what a detector usually has is in it, not only the rounding to 0.01 px.
    sigma = np.degrees(np.sqrt(np.linalg.eigvalsh(covariance))) * 3600
    assert np.all((sigma > 0.01) & (sigma < 100))
    assert message.angular_velocity_covariance[0] == -1.0
    assert message.linear_acceleration_covariance[0] == -1.0


def test_markers_are_published_on_request():
    with identify_client({"publish_markers": True}) as client:
        markers = client.bench.inbox(MarkerArray, "markers")
        client.bench.until(lambda: markers.n_publishers, "publisher of markers")
        frame = map1()
        client.send(frame)
        client.bench.until(lambda: markers.messages, "markers")
    message = markers.messages[0]
    assert {m.ns for m in message.markers} == {"", "stars", "labels", "field_of_view"}
    assert all(m.header.frame_id == "icrs" for m in message.markers)
    assert stamp_ns(message.markers[1].header) == stamp_ns(frame.header)


def test_markers_are_off_by_default_and_can_be_switched_on(client):
    markers = client.bench.inbox(MarkerArray, "markers")
    client.bench.until(lambda: markers.n_publishers, "publisher of markers")
    node, parameter = client.bench.node, client.bench.node.get_parameter("publish_markers")
    client.send(map1())
    assert node.set_parameters([_with(parameter, True)])[0].successful
    client.send(map1())
    client.bench.until(lambda: markers.messages, "markers")
    assert node.set_parameters([_with(parameter, False)])[0].successful
    assert len(markers.messages) == 1
    assert markers.messages[0].markers[0].action == Marker.DELETEALL


def test_numbers_for_plots_are_published_on_request():
    """rqt_plot draws no text: each is a Float64 of its own."""
    with identify_client({"publish_quality": True}) as client:
        drawn = {name: client.bench.inbox(Float64, f"quality/{name}") for name in QUALITIES}
        client.bench.until(lambda: all(i.n_publishers for i in drawn.values()), "publishers")
        solved, unsolved = client.send(map1()).values, client.send(frame_of(MAP1.xy_px[:3])).values
        client.bench.until(lambda: len(drawn["solve_ms"].messages) == 2, "both frames' numbers")
    assert unsolved["status"] != "SOLVED"
    for name, inbox in drawn.items():
        numbers = [message.data for message in inbox.messages]
        expected = [solved, unsolved] if name in {"matched", "solve_ms"} else [solved]
        assert numbers == pytest.approx([float(v[name]) for v in expected], abs=0.006)
    assert [message.data for message in drawn["matched"].messages] == [15.0, 0.0]


def test_numbers_for_plots_are_no_topics_by_default(client):
    assert not [p for p in client.bench.node.publishers if "quality" in p.topic_name]


def _with(parameter, value):
    return type(parameter)(parameter.name, value=value)


# ---- hints -----------------------------------------------------------------------------------


def test_solved_frame_has_no_hint(client):
    assert client.send(map1()).values["hint"] == ""


def test_mirrored_image_is_recognised():
    with identify_client({"parity": "normal"}) as client:
        values = client.send(map1()).values
    assert values["status"] == "NO_MATCH"
    assert values["hint"] == "image looks mirrored: parity mirrored solves it"


def test_wrong_field_of_view_is_recognised():
    with identify_client({"fov_deg": 12.5}) as client:
        values = client.send(map1()).values
    # The stars, all found, contradict it: with the focal length that they show they fit.
    assert values["status"] == "SOLVED"
    assert float(values["rms_px"]) < 0.1
    assert values["hint"] == (
        "improves if fov_deg is 12.00 instead of 12.50, or may be off: fov_tolerance_percent"
    )


def test_a_hint_fits_into_the_default_deadline():
    """A sky in a mirror takes the whole deadline: the frame after it leaves some time."""
    with identify_client({"parity": "normal", "deadline_ms": 200.0, "keep_up": False}) as client:
        values = [client.send(map1()).values for _ in range(3)]
    assert "image looks mirrored: parity mirrored solves it" in [v["hint"] for v in values]


def test_hints_are_rare():
    """They cost a search: the first two frames in a row without a solution, and each tenth."""
    with identify_client({"parity": "normal"}) as client:
        hints = [client.send(some_of_map1()).values["hint"] for _ in range(12)]
    assert [bool(text) for text in hints] == [i + 1 in (1, 2, 10) for i in range(12)]


def test_frame_that_used_up_its_deadline_gets_no_hint():
    noise = uniform_noise(MAP1.camera, 900, np.random.default_rng(4))
    with identify_client({"deadline_ms": 1.0}) as client:
        values = client.send(frame_of(noise)).values
    assert (values["status"], values["hint"]) == ("TIMEOUT", "")


def test_an_empty_frame_gets_no_hint(client):
    values = client.send(frame_of(np.empty((0, 2)))).values
    assert (values["status"], values["hint"]) == ("TOO_FEW_STARS", "")
