"""From an image to an attitude: both nodes in one process, held against the rendered truth."""

import signal
from contextlib import contextmanager

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import QuaternionStamped
from processes import (
    assert_ended_well,
    assert_refused,
    ended,
    run_to_the_end,
    running,
    wait_for_line,
)
from ros_helpers import open_bench, stamp_ns
from sensor_msgs.msg import CameraInfo, PointCloud2

from star_tracker.geometry.rotation import rotation_matrix
from star_tracker.msg_adapters.attitude import array_from_quaternion
from star_tracker.msg_adapters.solution import values_from_diagnostics
from star_tracker.nodes.camera_to_attitude import make_nodes
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.sky_image_node import SkyImageNode

pytestmark = pytest.mark.usefixtures("solver_compiled")
BOTH = "star_tracker.nodes.camera_to_attitude"
SKY = "star_tracker.nodes.sky_image_node"
FOV_DEG, WIDTH_PX = 20.0, 640
PIXEL_ARCSEC = 3600 * FOV_DEG / WIDTH_PX
#: Busy machines may take their time.
PATIENT = [
    "-p", "deadline_ms:=60000.0", "-p", "keep_up:=false",
    "-p", "camera_info_wait_ms:=10000.0",
]
WITH_INFO = [*PATIENT, "-p", "use_camera_info:=true"]
#: As camera.launch.py has it with use_camera_info:=false.
WITHOUT_INFO = [
    *PATIENT, "-p", "pixel_origin:=corner",
    "-p", "width_px:=640", "-p", "height_px:=480",
]


class Answers:
    """What is published for images, and the truth."""

    def __init__(self, bench):
        self.bench = bench
        self.centroids = bench.inbox(PointCloud2, "centroids")
        self.solutions = bench.inbox(DiagnosticArray, "solution")
        self.attitudes = bench.inbox(QuaternionStamped, "attitude")
        self.truths = bench.inbox(QuaternionStamped, "truth/attitude")
        # Without a listener the sky would wait for one, some seconds.
        bench.inbox(CameraInfo, "camera_info")
        self._outputs = (self.centroids, self.solutions, self.attitudes)

    def until_connected(self):
        self.bench.until(lambda: all(i.n_publishers for i in self._outputs), "publishers")

    def rotations(self, n=1):
        """The attitudes found and true, (3, 3) each, of the first n images that have both."""

        def pairs():
            return [
                (message, self.truths.at(stamp_ns(message.header))[0])
                for message in self.attitudes.messages
                if self.truths.at(stamp_ns(message.header))
            ]

        self.bench.until(lambda: len(pairs()) >= n, "attitude with its truth")
        return [
            tuple(rotation_matrix(array_from_quaternion(message)) for message in pair)
            for pair in pairs()[:n]
        ]


@contextmanager
def chain(arguments, sky):
    """Both nodes and a sky in this process; gives what they publish."""
    with open_bench() as bench:
        answers = Answers(bench)
        centroid, identify = make_nodes(
            context=bench.context, namespace=bench.namespace, cli_args=["--ros-args", *arguments]
        )
        bench._add(centroid)
        bench._add(identify)
        bench.until_true(lambda: centroid.ready and identify.ready, "solver and detector")
        answers.until_connected()
        bench.start(SkyImageNode, {"fov_deg": FOV_DEG, "width_px": WIDTH_PX, **sky})
        yield answers


def boresight_error_px(pair):
    """How far the found boresight is off along the true image's x and y."""
    found, true = pair
    x, y, _ = true.T @ found[:, 2]
    return np.degrees([x, y]) * 3600 / PIXEL_ARCSEC


@pytest.mark.parametrize(("arguments", "sky", "parity"), [
    (WITH_INFO, {}, "normal"),
    (WITHOUT_INFO, {}, "normal"),
    (WITH_INFO, {"parity": "mirrored", "ra_deg": 200.0, "dec_deg": 60.0}, "mirrored"),
    (WITHOUT_INFO, {"parity": "mirrored", "encoding": "mono8"}, "mirrored"),
    (WITH_INFO, {"distortion": [-0.3, 0.2]}, "normal"),
])
def test_the_attitude_of_an_image_is_the_true_one_and_no_half_pixel_off(arguments, sky, parity):
    with chain(arguments, sky) as answers:
        (pair,) = answers.rotations()
    # Dozens of stars of some hundredths of a pixel each; half a pixel is what a mix-up costs.
    assert np.abs(boresight_error_px(pair)).max() < 0.1
    found, true = pair
    angle = np.degrees(np.arccos(np.clip((np.trace(true.T @ found) - 1) / 2, -1, 1)))
    assert angle < 0.1
    values = values_from_diagnostics(answers.solutions.messages[-1])
    assert (values["status"], values["parity"]) == ("SOLVED", parity)


def test_centroids_are_published_once_and_not_read_back():
    with chain(WITH_INFO, {}) as answers:
        answers.rotations(3)
        stamps = [stamp_ns(message.header) for message in answers.solutions.messages]
        assert len(stamps) == len(set(stamps))
        assert set(stamps) <= {stamp_ns(m.header) for m in answers.centroids.messages}
        (topic,) = {
            info.node_name for info in answers.bench.probe.get_subscriptions_info_by_topic(
                f"{answers.bench.namespace}/centroids"
            )
        }
        assert topic == "probe"


def test_a_configuration_of_either_node_that_cannot_be_used_is_refused():
    for arguments, text in (
        (["-p", "max_stars:=0"], "parameter max_stars is 0"),
        ([], "parameters width_px and height_px are 0"),
    ):
        told = [*WITH_INFO, *arguments] if arguments else []
        with open_bench() as bench, pytest.raises(ParameterError) as caught:
            make_nodes(
                context=bench.context, namespace=bench.namespace, cli_args=["--ros-args", *told]
            )
        assert str(caught.value).startswith(text)


def test_a_parameter_that_neither_node_has_is_named(capfd):
    with chain([*WITH_INFO, "-p", "max_star:=3", "-p", "max_stars:=30"], {}):
        pass
    lines = [line for line in capfd.readouterr().err.splitlines() if "[WARN]" in line]
    assert len(lines) == 2
    assert all("there is no parameter max_star: " in line or line.endswith("max_star")
               for line in lines)


@pytest.mark.slow
def test_in_a_process_it_says_in_one_line_what_cannot_be_used():
    code, messages = run_to_the_end(BOTH, "-p", "fov_deg:=-1.0")
    assert_refused(code, messages, "parameter fov_deg is -1.0")


def test_a_file_that_has_nothing_for_either_node_is_named(tmp_path):
    paths = {name: tmp_path / f"{name}.yaml" for name in ("named", "other")}
    arguments = list(WITH_INFO)
    for name, path in paths.items():
        text = f"/{name}/identify_node:\n  ros__parameters:\n    fov_deg: 20.0\n"
        path.write_text(text, encoding="utf-8")
        arguments += ["--params-file", str(path)]
    with running(BOTH, "/named", arguments) as process:
        messages = wait_for_line(process, "ready: ")
        process.send_signal(signal.SIGTERM)
        code, rest = ended(process)
    assert code == 0
    assert (
        f"parameter file {paths['other']} has nothing for /named/centroid_node and "
        "/named/identify_node, only for /other/identify_node: name it"
    ) in messages + rest
    assert str(paths["named"]) not in messages + rest


@pytest.mark.slow
def test_real_processes_as_the_launch_file_starts_them():
    """A sky, and both nodes in one process, with camera_info; all end quietly."""
    with open_bench() as bench:
        answers = Answers(bench)
        with running(BOTH, bench.namespace, WITH_INFO) as both:
            answers.until_connected()
            arguments = ["-p", f"fov_deg:={FOV_DEG}", "-p", "rate_deg_s:=[0.0, 0.1, 0.0]"]
            with running(SKY, bench.namespace, arguments) as sky:
                pairs = answers.rotations(3)
                for process in (sky, both):
                    process.send_signal(signal.SIGINT)
                    assert_ended_well(*ended(process))
    assert max(np.abs(boresight_error_px(pair)).max() for pair in pairs) < 0.2
