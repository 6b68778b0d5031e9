"""identify_node follows its focal length: /diagnostics, the service, and what it applies."""

from contextlib import contextmanager

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from ros_helpers import IdentifyClient, frame_of, health_from_diagnostics, open_bench
from std_srvs.srv import Trigger

from star_tracker.maps.star_map import paper_maps
from star_tracker.nodes.identify import focal_length_follower
from star_tracker.nodes.identify_node import IdentifyNode

#: The 12 deg camera's maps without displaced stars.
MAPS = paper_maps((1, 2, 4, 5))
TRUE_PX = MAPS[0].camera.focal_length_px
#: A focal length 2 % too long is a field of view 2 % too small, nearly.
FOV_DEG = float(np.degrees(2 * np.arctan(256 / (1.02 * TRUE_PX))))


@contextmanager
def client(mode):
    parameters = {
        "parity": "mirrored", "deadline_ms": 60_000.0, "keep_up": False, "fov_deg": FOV_DEG,
        "calibrate_focal_length": mode,
    }
    with open_bench() as bench:
        result = IdentifyClient(bench)
        result.calibrate = bench.probe.create_client(
            Trigger, f"{bench.namespace}/identify_node/calibrate"
        )
        bench.start(IdentifyNode, parameters)
        yield result.connect()


@pytest.fixture(autouse=True)
def every_frame_counts(monkeypatch):
    monkeypatch.setattr(focal_length_follower, "_FRAME_S", 0.0)


def loops(node_client, n):
    """Send the maps n times; return the residuals of each loop, px."""
    return [
        [float(node_client.send(frame_of(m.xy_px)).values["rms_px"]) for m in MAPS]
        for _ in range(n)
    ]


def ask(node_client):
    bench = node_client.bench
    bench.until(node_client.calibrate.service_is_ready, "service calibrate")
    answer = node_client.calibrate.call_async(Trigger.Request())
    answer.add_done_callback(lambda _: bench._event())
    bench.until(answer.done, "answer of calibrate")
    return answer.result()


def test_apply_converges_and_the_residuals_fall():
    with client("apply") as node:
        first, *_, last = loops(node, 3)
        camera = node.bench.node._solver.tracker.camera
        assert camera.focal_length_px == pytest.approx(TRUE_PX, rel=1e-3)
        # 2 % of some 150 px from the centre, and the rounding of the centroids.
        assert first[0] > 1.0
        assert max(last) < 0.02


def test_report_leaves_the_camera_alone_and_tells_the_drift():
    with client("report") as node:
        reports = node.bench.inbox(DiagnosticArray, "/diagnostics")
        loops(node, 2)
        node.bench.until(
            lambda: any(
                s.name.endswith(": focal length") and s.level == DiagnosticStatus.OK
                for m in reports.messages for s in m.status
            ), "report in /diagnostics",
        )
        name = f"{node.bench.node.get_fully_qualified_name()[1:]}: focal length"
        values = health_from_diagnostics(reports.messages[-1], name)
        assert float(values["drift_percent"]) == pytest.approx(100 / 1.02 - 100, abs=0.1)
        assert float(values["drift_standard_error_percent"]) < 0.1
        camera = node.bench.node._solver.tracker.camera
        assert camera.focal_length_px == pytest.approx(1.02 * TRUE_PX)
        answer = ask(node)
        assert answer.success
        assert answer.message.startswith(f"focal length {TRUE_PX:.0f}"[:16])


def test_off_reports_nothing_and_says_how_to_switch_it_on():
    with client("off") as node:
        loops(node, 1)
        answer = ask(node)
        assert not answer.success
        assert answer.message == (
            "calibrate_focal_length is off: restart the node with it set to report or apply"
        )
        assert [s.name for s in node.bench.node._statuses()] == [
            f"{node.bench.node.get_fully_qualified_name()[1:]}: health"
        ]


def test_before_any_frame_there_is_no_estimate():
    with client("report") as node:
        answer = ask(node)
        assert (answer.success, answer.message) == (False, "no frame has come yet")
