"""How long a frame may take in a stream of frames."""

import numpy as np
import pytest
from ros_helpers import frame_of
from test_node_health import MAP1, identify_client, map1

from star_tracker.maps.simulation import CAMERAS, uniform_noise
from star_tracker.nodes.identify.pace import Pace


def deadlines_ms(received_s, longest_ms=200.0):
    pace = Pace()
    return [pace.deadline_ms(at, longest_ms) for at in received_s]


@pytest.mark.parametrize(("period_s", "expected_ms"), [
    (0.02, 15.0), (0.1, 75.0), (1.0, 200.0), (0.001, 5.0),
])
def test_three_quarters_of_the_period(period_s, expected_ms):
    found = deadlines_ms(np.arange(30) * period_s)
    assert found[:2] == [200.0, 200.0]
    assert found[2:] == pytest.approx([expected_ms] * 28)


def test_never_longer_than_the_deadline():
    assert deadlines_ms(np.arange(5) * 0.02, longest_ms=2.0) == [2.0] * 5


def test_a_burst_counts_as_the_stream_that_it_stands_for():
    """Five frames at once each second, as a network may deliver them: five frames a second."""
    received_s = np.repeat(np.arange(10.0), 5)
    assert deadlines_ms(received_s)[20:] == pytest.approx([150.0] * 30, rel=0.11)


def test_a_pause_is_forgotten():
    received_s = np.concatenate([np.arange(20) * 0.02, 100 + np.arange(20) * 0.02])
    found = deadlines_ms(received_s)
    assert found[20] == 200.0
    assert found[-1] == pytest.approx(15.0)


def noise_frame():
    """Points that show no sky, and take a search longer than a second."""
    return frame_of(uniform_noise(CAMERAS["12 deg"], 900, np.random.default_rng(3)))


@pytest.mark.parametrize(("keep_up", "in_step"), [(True, True), (False, False)])
def test_a_frame_without_sky_holds_up_a_stream_only_if_it_may(keep_up, in_step):
    parameters = {"parity": "mirrored", "deadline_ms": 1000.0, "keep_up": keep_up}
    with identify_client(parameters) as client:
        for _ in range(12):
            assert client.send(map1()).values["status"] == "SOLVED"
        values = client.send(noise_frame()).values
        assert values["status"] == "TIMEOUT"
        deadline_ms = float(values["reason"].split()[1])
        assert (deadline_ms < 1000.0) == in_step
        assert client.send(map1()).values["status"] == "SOLVED"


def test_a_hint_has_leisure_where_nothing_is_solved():
    """Mirrored skies: in step there is no time for a hint, after ten frames there is."""
    with identify_client({"parity": "normal"}) as client:
        hints = []
        while not any(hints) and len(hints) < 500:
            hints.append(client.send(map1()).values["hint"])
    assert hints[-1] == "image looks mirrored: parity mirrored solves it"
    assert MAP1.camera.parity == "mirrored"
