"""identify_node in this process: what goes in over ROS, and what comes out."""

import array
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.qos import ReliabilityPolicy
from ros_helpers import (
    IdentifyClient,
    array_from_quaternion,
    frame_of,
    new_header,
    open_bench,
    stamp_ns,
)
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, PointCloud2
from waiting import longest_s

from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import separation, unit_vectors
from star_tracker.identification.labels import StarState
from star_tracker.maps.simulation import uniform_noise
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.attitude import array_from_boresight
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.point_cloud import stars_from_cloud
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.optics.distortion import Distortion

MAPS = dict(enumerate(paper_maps(), start=1))
#: Maps of the 12 deg camera without displaced stars, whose pose is therefore exact.
EXACT_MAPS = (1, 2, 4, 5)
#: The maps' camera, and time enough that no result depends on the speed of the machine.
MAPS_12 = {"parity": "mirrored", "deadline_ms": 60_000.0, "keep_up": False}
#: Three times the rounding of the centroids to 0.01 px, 84 arcsec a pixel.
ARCSEC = np.radians(1 / 3600)
BORESIGHT_LIMIT = 1.0 * ARCSEC
BEST_EFFORT, RELIABLE = ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE


@contextmanager
def identify_client(parameters=None, **options):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, parameters, **options)
        yield client.connect()


@pytest.fixture(scope="module")
def client():
    """A node for the maps of the 12 deg camera."""
    with identify_client(MAPS_12) as result:
        yield result


@pytest.fixture
def info_client():
    """A node that takes its camera from camera_info; `infos` publishes it."""
    with identify_client({**MAPS_12, "use_camera_info": True}) as result:
        result.infos = result.bench.connected_outbox(CameraInfo, "camera_info")
        yield result


@pytest.fixture
def patient_client():
    """As `info_client`, but it waits for a frame's camera_info for longer than any test."""
    parameters = {**MAPS_12, "use_camera_info": True, "camera_info_wait_ms": 10_000.0}
    with identify_client(parameters) as result:
        result.infos = result.bench.connected_outbox(CameraInfo, "camera_info")
        yield result


def map_frame(number, header=None):
    return frame_of(MAPS[number].xy_px, header)


def rejected(client):
    return client.bench.node.rejected


def rotation_of(outcome):
    return Rotation.from_quat(array_from_quaternion(outcome.attitude)).as_matrix()


# ---- a frame in, the answer out --------------------------------------------------------------


@pytest.mark.parametrize("number", EXACT_MAPS)
def test_quaternion_rotates_the_boresight_to_where_the_map_was_taken(client, number):
    rotation = rotation_of(client.send(map_frame(number)))
    truth = MAPS[number].pose.rotation
    assert separation(rotation @ [0, 0, 1], truth @ [0, 0, 1]) < BORESIGHT_LIMIT
    # Stars are at most 6 deg from the boresight: a tenth of the lever that the boresight has.
    assert separation(rotation @ [0, -1, 0], truth @ [0, -1, 0]) < 10 * BORESIGHT_LIMIT


@pytest.mark.parametrize("number", EXACT_MAPS)
def test_quaternion_is_a_unit_quaternion_with_positive_w(client, number):
    quaternion = array_from_quaternion(client.send(map_frame(number)).attitude)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-12)
    assert quaternion[3] >= 0


def test_quaternion_rotates_each_star_to_its_place_in_the_sky(client):
    outcome = client.send(map_frame(1))
    stars = outcome.stars
    x, y = stars["x"].astype(float) - 256, stars["y"].astype(float) - 256
    focal_px = 256 / np.tan(np.radians(6))
    camera_vectors = np.column_stack([x, -y, np.full(len(x), focal_px)])  # the maps' y points up
    camera_vectors /= np.linalg.norm(camera_vectors, axis=1, keepdims=True)
    sky_vectors = unit_vectors(np.radians(stars["ra_deg"]), np.radians(stars["dec_deg"]))
    error = separation(camera_vectors @ rotation_of(outcome).T, sky_vectors)
    assert np.max(error) < 3 * BORESIGHT_LIMIT


@pytest.mark.parametrize("number", EXACT_MAPS)
def test_boresight_is_the_quaternions_in_degrees(client, number):
    outcome = client.send(map_frame(number))
    ra, dec, roll = array_from_boresight(outcome.boresight)
    expected = rotation_from_boresight(*np.radians([ra, dec, roll]))
    np.testing.assert_allclose(rotation_of(outcome), expected, atol=1e-9)
    assert 0 <= ra < 360
    assert -90 <= dec <= 90
    assert 0 <= roll < 360


@pytest.mark.parametrize("number", range(1, 7))
def test_stars_have_the_papers_numbers_in_input_order(client, number):
    stars = client.send(map_frame(number)).stars
    np.testing.assert_array_equal(stars["star_number"], MAPS[number].star_number)
    np.testing.assert_array_equal(
        np.column_stack([stars["x"], stars["y"]]), MAPS[number].xy_px.astype(np.float32)
    )


def test_shuffled_stars_keep_their_numbers(client):
    order = np.random.default_rng(3).permutation(len(MAPS[1].xy_px))
    stars = client.send(frame_of(MAPS[1].xy_px[order])).stars
    np.testing.assert_array_equal(stars["star_number"], MAPS[1].star_number[order])


def test_solution_tells_how_the_frame_was_solved(client):
    outcome = client.send(map_frame(1))
    values = outcome.values
    assert outcome.solution.status[0].level == DiagnosticStatus.OK
    assert values["status"] == "SOLVED"
    assert values["parity"] == "mirrored"
    assert (values["matched"], values["total"], values["displaced"]) == ("15", "15", "0")
    assert float(values["rms_px"]) < 0.01  # centroids are rounded to 0.01 px
    assert float(values["wrong_probability"]) < 1e-6


def test_solution_carries_the_nodes_name(client):
    assert client.send(map_frame(1)).solution.status[0].name == "identify_node"


def test_every_output_carries_the_frames_stamp(client):
    frame = map_frame(1)
    outcome = client.send(frame)
    for message in (outcome.solution, outcome.attitude, outcome.boresight, outcome.cloud):
        assert message.header.stamp == frame.header.stamp


def test_sky_outputs_are_in_the_reference_frame_and_image_outputs_in_the_input_frame(client):
    outcome = client.send(map_frame(1, new_header("star_camera")))
    assert outcome.attitude.header.frame_id == "icrs"
    assert outcome.boresight.header.frame_id == "icrs"
    assert outcome.cloud.header.frame_id == "star_camera"
    assert outcome.solution.header.frame_id == "star_camera"


def test_each_frame_is_answered_once_and_in_order(client):
    frames = [map_frame(number) for number in (1, 2, 3, 4, 5, 6)]
    for frame in frames:
        client.publish(frame)
    outcomes = [client.outcome(frame) for frame in frames]
    assert [outcome.status for outcome in outcomes] == ["SOLVED"] * 6
    stamps = [stamp_ns(m.header) for m in client.attitudes.messages[-6:]]
    assert stamps == [stamp_ns(frame.header) for frame in frames]


# ---- parameters ------------------------------------------------------------------------------


def test_frame_id_parameters():
    parameters = {**MAPS_12, "reference_frame": "gcrs", "camera_frame": "optical"}
    with identify_client(parameters) as client:
        outcome = client.send(map_frame(1))
    assert outcome.attitude.header.frame_id == "gcrs"
    assert outcome.boresight.header.frame_id == "gcrs"
    assert outcome.cloud.header.frame_id == "optical"


def test_parameters_from_a_yaml_file_are_honoured_also_integers_for_floats(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text(
        "/**:\n"
        "  ros__parameters:\n"
        "    fov_deg: 20\n"
        "    width_px: 1024\n"
        "    height_px: 1024\n"
        "    parity: mirrored\n"
        "    catalog: paper\n"
        "    pair_tolerance_px: [2, 6]\n"
        "    deadline_ms: 60000\n",
        encoding="utf-8",
    )
    with identify_client(cli_args=["--ros-args", "--params-file", str(path)]) as client:
        outcome = client.send(map_frame(7))
    assert (outcome.status, outcome.values["matched"]) == ("SOLVED", "41")


def test_principal_point_parameters_are_honoured():
    moved = np.add(MAPS[1].xy_px, (10.0, -20.0))
    with identify_client({**MAPS_12, "cx_px": 266.0, "cy_px": 236.0}) as client:
        rotation = rotation_of(client.send(frame_of(moved)))
    truth = MAPS[1].pose.rotation
    assert separation(rotation @ [0, 0, 1], truth @ [0, 0, 1]) < BORESIGHT_LIMIT


def test_hipparcos_catalogue_solves_with_hipparcos_numbers(client):
    hip = client.send(map_frame(1)).stars["hip"]
    with identify_client({**MAPS_12, "catalog": "hipparcos"}) as other:
        stars = other.send(map_frame(1)).stars
    known = stars["hip"] > 0
    assert known.sum() >= 10
    np.testing.assert_array_equal(stars["hip"][known], hip[known])


@pytest.mark.parametrize(("flip", "parity"), [(False, "mirrored"), (True, "normal")])
def test_parity_auto_finds_and_reports_the_parity(flip, parity):
    xy = MAPS[1].xy_px * (1, -1) + (0, 512) if flip else MAPS[1].xy_px
    with identify_client({**MAPS_12, "parity": "auto"}) as client:
        outcome = client.send(frame_of(xy))
    assert (outcome.status, outcome.values["parity"]) == ("SOLVED", parity)
    rotation = rotation_of(outcome)
    truth = MAPS[1].pose.rotation
    assert separation(rotation @ [0, 0, 1], truth @ [0, 0, 1]) < BORESIGHT_LIMIT
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_wrong_parity_gives_no_attitude():
    with identify_client({**MAPS_12, "parity": "normal"}) as client:
        good = frame_of(MAPS[1].xy_px * (1, -1) + (0, 512))
        assert client.unsolved(map_frame(1), good).status == "NO_MATCH"


TOLERANCES = "it must be a list, each item a number from 0.01 to 100 px"


@pytest.mark.parametrize(("parameters", "text"), [
    ({"catalog": "tycho"},
     "parameter catalog is 'tycho': it must be one of paper, hipparcos, gaia"),
    ({"fov_deg": 500.0}, "parameter fov_deg is 500.0: it must be a number from 0 to 120 deg"),
    ({"fov_deg": float("nan")},
     "parameter fov_deg is nan: it must be a number from 0 to 120 deg"),
    ({"fov_deg": 500}, "parameter fov_deg is 500: it must be a number from 0 to 120 deg"),
    ({"fov_deg": "wide"}, "parameter fov_deg is 'wide': it must be a number from 0 to 120 deg"),
    ({"width_px": 512.0},
     "parameter width_px is 512.0: it must be a whole number from 0 to 65536 px"),
    ({"width_px": 1}, "parameter width_px is 1: it must be 16 to 65536 px"),
    ({"parity": "upside down"},
     "parameter parity is 'upside down': it must be one of normal, mirrored, auto"),
    ({"pair_tolerance_px": [1.0, float("nan")]},
     f"parameter pair_tolerance_px is [1.0, nan]: {TOLERANCES}"),
    ({"pair_tolerance_px": []}, f"parameter pair_tolerance_px is []: {TOLERANCES}"),
    ({"use_camera_info": "yes"},
     "parameter use_camera_info is 'yes': it must be true or false"),
])
def test_configuration_that_cannot_be_used_is_refused_in_one_line(parameters, text):
    with open_bench() as bench, pytest.raises(ParameterError) as caught:
        bench.start(IdentifyNode, parameters)
    assert str(caught.value) == text


def test_refused_node_leaves_nothing_behind():
    with open_bench() as bench:
        with pytest.raises(ParameterError):
            bench.start(IdentifyNode, {"catalog": "tycho"})
        bench.start(IdentifyNode)
        nodes = bench.probe.get_node_names_and_namespaces()
        assert nodes.count(("identify_node", bench.namespace)) == 1


def test_parameter_services_answer():
    """`ros2 param get` and rqt ask the running node."""
    with open_bench() as bench:
        bench.start(IdentifyNode, {"fov_deg": 15.0})
        ask = bench.probe.create_client(GetParameters, "identify_node/get_parameters")
        assert ask.wait_for_service(timeout_sec=longest_s())
        reply = ask.call_async(GetParameters.Request(names=["fov_deg", "width_px"]))
        bench.executor.spin_until_future_complete(reply, timeout_sec=longest_s())
        values = reply.result().values
    assert (values[0].double_value, values[1].integer_value) == (15.0, 512)


# ---- camera_info -----------------------------------------------------------------------------


def send_info(client, camera, header):
    client.infos.publish(info_from_camera(camera, header))


def send_with_info(client, number, camera=None):
    """Publish a map's camera_info and then its frame; return the frame."""
    frame = map_frame(number)
    send_info(client, camera or MAPS[number].camera, frame.header)
    client.publish(frame)
    return frame


def test_camera_changes_from_frame_to_frame(info_client):
    for number in (6, 7, 6):
        stars = info_client.outcome(send_with_info(info_client, number)).stars
        np.testing.assert_array_equal(stars["star_number"], MAPS[number].star_number)


def test_two_cameras_of_one_topic_are_told_apart_by_frame_id(info_client):
    """Of the same stamps, as one trigger gives: the last CameraInfo of a stamp is not for both."""
    for swap in (False, True):
        frames = {}
        for side, number in (("left", 6), ("right", 7)):
            header = new_header(side)
            header.stamp.sec = 5_000 + swap
            send_info(info_client, MAPS[number].camera, header)
            frames[number] = frame_of(MAPS[number].xy_px, header)
        for number in sorted(frames, reverse=swap):
            info_client.publish(frames[number])
        stamp = stamp_ns(header)
        info_client.bench.until(lambda stamp=stamp: len(info_client.clouds.at(stamp)) == 2, "both")
        for cloud in info_client.clouds.at(stamp):
            number = {"left": 6, "right": 7}[cloud.header.frame_id]
            stars = stars_from_cloud(cloud)
            np.testing.assert_array_equal(stars["star_number"], MAPS[number].star_number)


def test_a_frame_of_no_camera_of_the_topic_is_refused_by_its_frame_id():
    with open_bench() as bench:
        client = IdentifyClient(bench)
        client.infos = bench.outbox(CameraInfo, "camera_info")
        bench.start(IdentifyNode, {**MAPS_12, "use_camera_info": True})
        client.connect()
        heard = bench.calls_of("camera_info")
        bench.until(lambda: client.infos.n_subscribers, "subscriber to camera_info")
        for side, number in (("left", 6), ("right", 7)):
            send_info(client, MAPS[number].camera, new_header(side))
        bench.until(lambda: len(heard) == 2, "camera_info heard by the node")
        outcome = client.send(frame_of(MAPS[6].xy_px, new_header("")))
    assert (outcome.status, outcome.values["reason"]) == ("BAD_INPUT", (
        f"the CameraInfo of {bench.namespace}/camera_info have frame_id left, right, this frame "
        "has '': give it that of its camera"
    ))


def test_camera_info_may_come_after_its_frame(patient_client):
    client = patient_client
    assert client.outcome(send_with_info(client, 6)).status == "SOLVED"
    frame, taken = map_frame(7), client.bench.calls_of("centroids")
    client.publish(frame)
    client.bench.until(lambda: taken, "frame taken by the node")
    assert not client.solutions.at(stamp_ns(frame.header))
    send_info(client, MAPS[7].camera, frame.header)
    assert client.outcome(frame).values["matched"] == "41"


def test_frames_that_waited_are_answered_in_order(patient_client):
    client = patient_client
    frames, taken = [map_frame(number) for number in (6, 7, 8)], client.bench.calls_of("centroids")
    for frame in frames:
        client.publish(frame)
    client.bench.until(lambda: len(taken) == 3, "three frames taken by the node")
    for number, frame in zip((6, 7, 8), frames, strict=True):
        send_info(client, MAPS[number].camera, frame.header)
    assert [client.outcome(frame).status for frame in frames] == ["SOLVED"] * 3
    stamps = [stamp_ns(message.header) for message in client.solutions.messages]
    assert stamps == [stamp_ns(frame.header) for frame in frames]


def test_camera_info_published_once_holds_for_all_later_frames(patient_client):
    send_info(patient_client, MAPS[7].camera, new_header())
    for number in (7, 8, 7):
        assert patient_client.send(map_frame(number)).status == "SOLVED"


def test_frame_whose_own_camera_info_stays_out_takes_the_one_before(info_client):
    assert info_client.outcome(send_with_info(info_client, 7)).status == "SOLVED"
    assert info_client.send(map_frame(8)).status == "SOLVED"


def test_frame_without_any_camera_info_is_bad_input_and_counted(info_client):
    frame = map_frame(6)
    outcome = info_client.send(frame)
    assert outcome.status == "BAD_INPUT"
    assert "its publisher has sent none yet" in outcome.values["reason"]
    assert outcome.solution.status[0].level == DiagnosticStatus.ERROR
    assert rejected(info_client) == {"camera_info_missing": 1}
    assert info_client.outcome(send_with_info(info_client, 6)).status == "SOLVED"
    assert info_client.gathered(frame).attitude is None


def test_camera_info_that_cannot_be_used_is_counted_and_the_next_one_is_used(info_client):
    header = new_header()
    useless = info_from_camera(MAPS[6].camera, header)
    useless.k = np.zeros(9)
    info_client.infos.publish(useless)
    assert info_client.send(map_frame(6, header)).status == "BAD_INPUT"
    assert rejected(info_client)["camera_info"] == 1
    assert info_client.outcome(send_with_info(info_client, 6)).status == "SOLVED"


def test_distortion_of_camera_info_is_undone(info_client):
    lens = Distortion("plumb_bob", (-0.3, 0.1, 1e-3, -1e-3, 0.0))
    ideal, camera = MAPS[7].camera, replace(MAPS[7].camera, distortion=lens)
    bent = camera.pixels_of_plane(ideal.plane(MAPS[7].xy_px))
    assert np.max(np.abs(bent - MAPS[7].xy_px)) > 1  # or else there is nothing to undo
    frame = frame_of(bent)
    send_info(info_client, camera, frame.header)
    info_client.publish(frame)
    outcome = info_client.outcome(frame)
    assert float(outcome.values["rms_px"]) < 0.01


def test_centroids_that_the_lens_has_no_ray_for_are_left_out_and_counted(info_client):
    """A lens of k1 = -5 turns 14.5 deg from its axis: it has no ray for the image's corners."""
    ideal = MAPS[7].camera
    camera = replace(ideal, distortion=Distortion("plumb_bob", (-5.0, 0.0, 0.0, 0.0, 0.0)))
    bent = camera.pixels_of_plane(ideal.plane(MAPS[7].xy_px))
    seen = np.flatnonzero(camera.contains(bent))
    frame = frame_of(np.concatenate([[(1.0, 1.0), (1020.0, 1020.0)], bent[seen]]))
    send_info(info_client, camera, frame.header)
    info_client.publish(frame)
    outcome = info_client.outcome(frame)
    assert (outcome.status, outcome.values["ignored"]) == ("SOLVED", "2")
    star = outcome.stars["star_number"]
    np.testing.assert_array_equal(star, [0, 0, *MAPS[7].star_number[seen]])


@pytest.mark.parametrize("lens", [
    Distortion("plumb_bob", (-500.0, 0.0, 0.0, 0.0, 0.0)),
    Distortion("equidistant", (-500.0, 0.0, 0.0, 0.0)),
    Distortion("plumb_bob", (1e30,) * 5),
])
def test_a_lens_that_does_not_show_the_middle_is_refused_and_the_node_goes_on(info_client, lens):
    camera = replace(MAPS[7].camera, distortion=lens)
    frame = send_with_info(info_client, 7, camera)
    assert info_client.outcome(frame).status == "BAD_INPUT"
    assert sum(rejected(info_client).values()) > 0
    assert info_client.outcome(send_with_info(info_client, 7)).status == "SOLVED"


# ---- frames without a solution ---------------------------------------------------------------


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_few_stars_are_too_few(client, n):
    outcome = client.unsolved(frame_of(MAPS[1].xy_px[:n]), map_frame(1))
    assert outcome.status == "TOO_FEW_STARS"
    assert outcome.values["reason"] == f"{n} stars, at least 4 are needed"
    assert outcome.solution.status[0].level == DiagnosticStatus.WARN


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_has_no_match(client, seed):
    noise = uniform_noise(MAPS[1].camera, 8, np.random.default_rng(seed))
    outcome = client.unsolved(frame_of(noise), map_frame(1))
    assert outcome.status == "NO_MATCH"
    assert outcome.values["wrong_probability"] == "1"


def test_unsolved_frame_still_reports_its_centroids(client):
    noise = uniform_noise(MAPS[1].camera, 8, np.random.default_rng(1))
    stars = client.unsolved(frame_of(noise), map_frame(1)).stars
    np.testing.assert_array_equal(stars["x"], noise[:, 0].astype(np.float32))
    assert not np.any(stars["star_number"])
    assert np.all(stars["state"] == StarState.UNIDENTIFIED)


def test_empty_frame_reports_no_stars(client):
    outcome = client.unsolved(frame_of(np.empty((0, 2))), map_frame(1))
    assert outcome.cloud.width == 0
    assert len(outcome.stars) == 0


def test_identical_centroids_have_no_match(client):
    outcome = client.unsolved(frame_of(np.full((10, 2), 100.0)), map_frame(1))
    assert outcome.status == "NO_MATCH"


def test_deadline_ends_a_long_search():
    noise = uniform_noise(MAPS[1].camera, 200, np.random.default_rng(1))
    with identify_client({"parity": "mirrored", "deadline_ms": 1.0}) as client:
        outcome = client.send(frame_of(noise))
    assert outcome.status == "TIMEOUT"
    assert outcome.attitude is None
    assert "deadline 1 ms passed" in outcome.values["reason"]


def test_of_ten_thousand_centroids_some_are_searched_and_the_rest_is_counted():
    """Those that are searched for would take seconds: they are cut off, and the node goes on."""
    noise = uniform_noise(MAPS[1].camera, 10_000, np.random.default_rng(1))
    with identify_client({"parity": "mirrored", "deadline_ms": 1.0}) as client:
        outcome = client.send(frame_of(noise))
        assert (outcome.status, outcome.attitude) == ("TIMEOUT", None)
        assert rejected(client)["surplus_centroids"] == 9000
        assert client.send(frame_of(np.empty((0, 2)))).status == "TOO_FEW_STARS"


def test_ten_thousand_centroids_end_with_the_deadline_where_they_are_allowed():
    noise = uniform_noise(MAPS[1].camera, 10_000, np.random.default_rng(1))
    parameters = {"parity": "mirrored", "max_centroids": 10_000, "deadline_ms": 1.0}
    with identify_client(parameters) as client:
        outcome = client.send(frame_of(noise))
    assert outcome.status == "TIMEOUT"
    assert outcome.values["total"] == "10000"


# ---- values that no image has ----------------------------------------------------------------

IMPOSSIBLE = np.array([
    [np.nan, 100.0], [100.0, np.nan], [np.inf, 5.0], [5.0, -np.inf], [1e30, 1e30], [-1e30, 7.0],
])


def test_impossible_centroids_are_left_out_and_counted(client):
    before = rejected(client)["ignored_centroids"]
    outcome = client.send(frame_of(np.concatenate([IMPOSSIBLE, MAPS[1].xy_px])))
    assert (outcome.status, outcome.values["ignored"]) == ("SOLVED", "6")
    assert rejected(client)["ignored_centroids"] == before + 6
    stars = outcome.stars
    np.testing.assert_array_equal(stars["star_number"][:6], 0)
    np.testing.assert_array_equal(stars["star_number"][6:], MAPS[1].star_number)


def test_frame_of_impossible_centroids_only_is_bad_input(client):
    before = rejected(client)["bad_centroids"]
    outcome = client.unsolved(frame_of(IMPOSSIBLE), map_frame(1))
    assert outcome.status == "BAD_INPUT"
    assert "all 6 centroids are non-finite or outside of the 512 x 512 px image" in (
        outcome.values["reason"]
    )
    assert rejected(client)["bad_centroids"] == before + 1


def test_coordinates_beyond_float32_are_left_out_like_any_others(client):
    xy = np.concatenate([[[1e300, -1e300]], MAPS[1].xy_px])
    outcome = client.send(frame_of(xy))
    assert (outcome.status, outcome.values["ignored"]) == ("SOLVED", "1")


# ---- clouds that cannot be read --------------------------------------------------------------


def malformed(**changes):
    message = map_frame(1)
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def malformed_field(index, **changes):
    message = map_frame(1)
    for name, value in changes.items():
        setattr(message.fields[index], name, value)
    return message


@pytest.mark.parametrize(("make", "reason"), [
    (lambda: malformed(fields=[]), "has no field x"),
    (lambda: malformed(height=2), "data has 240 bytes, but height 2 x row_step 240 is 480"),
    (lambda: malformed(data=array.array("B", bytes(7))), "data has 7 bytes"),
    (lambda: malformed(point_step=0), "data has 240 bytes, but width 15 x point_step 0 is 0"),
    (lambda: malformed(width=2**32 - 1), "data has 240 bytes"),
    (lambda: malformed_field(1, name="x"), "names a field twice"),
    (lambda: malformed_field(0, datatype=7, count=2), "field x must hold one value"),
    (lambda: malformed_field(0, datatype=77), "field x has no valid datatype"),
    (lambda: malformed_field(1, offset=2**32 - 1), "field y at offset 4294967295 does not fit"),
    (lambda: malformed_field(1, count=2**32 - 1), "field y at offset 8 does not fit"),
], ids=lambda value: value if isinstance(value, str) else "")
def test_malformed_cloud_is_bad_input_and_the_next_frame_is_solved(client, make, reason):
    frame = make()
    frame.header = new_header()
    before = rejected(client)["malformed_cloud"]
    outcome = client.unsolved(frame, map_frame(1))
    assert outcome.status == "BAD_INPUT"
    assert reason in outcome.values["reason"]
    assert outcome.solution.header == frame.header
    assert outcome.solution.status[0].level == DiagnosticStatus.ERROR
    assert outcome.cloud is None
    assert rejected(client)["malformed_cloud"] == before + 1


# ---- publishers of either reliability --------------------------------------------------------


@pytest.mark.parametrize("reliability", [RELIABLE, BEST_EFFORT])
def test_publisher_that_is_there_before_the_node_connects(reliability):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        client.centroids = bench.outbox(PointCloud2, "centroids", reliability)
        bench.start(IdentifyNode, MAPS_12)
        assert client.connect().send(map_frame(1)).status == "SOLVED"


@pytest.mark.parametrize("reliability", [RELIABLE, BEST_EFFORT])
def test_publisher_that_starts_after_the_node_connects(reliability):
    with open_bench() as bench:
        client = IdentifyClient(bench)
        bench.start(IdentifyNode, MAPS_12)
        assert client.connect(reliability).send(map_frame(1)).status == "SOLVED"


def test_reliable_publisher_stays_connected_when_a_best_effort_one_joins(client):
    other = client.bench.connected_outbox(PointCloud2, "centroids", BEST_EFFORT)
    for outbox in (other, client.centroids, other):
        frame = map_frame(1)
        client.bench.until(lambda box=outbox: box.n_subscribers, "subscriber to centroids")
        outbox.publish(frame)
        assert client.outcome(frame).status == "SOLVED"


def test_camera_info_of_a_best_effort_publisher_is_heard(patient_client):
    late = patient_client.bench.connected_outbox(CameraInfo, "camera_info", BEST_EFFORT)
    frame = map_frame(7)
    late.publish(info_from_camera(MAPS[7].camera, frame.header))
    assert patient_client.send(frame).status == "SOLVED"
