"""replay_node in this process: what it publishes, when it starts and how it ends."""

from itertools import count, pairwise

import numpy as np
import pytest
from rclpy.executors import ExternalShutdownException
from rclpy.qos import ReliabilityPolicy
from ros_helpers import open_bench, stamp_ns
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, PointCloud2

from star_tracker.maps.star_map import paper_maps, write_star_map
from star_tracker.msg_adapters.camera_info import camera_from_info
from star_tracker.msg_adapters.point_cloud import centroids_from_cloud
from star_tracker.nodes import sending
from star_tracker.nodes.declaring import ParameterError
from star_tracker.nodes.replay_node import ReplayNode

MAPS = dict(enumerate(paper_maps(), start=1))
#: As fast as the timers allow: no test depends on the rate.
FAST = {"rate_hz": 10_000.0}


def replay(parameters=None):
    """Run a replay to its end; return the frames and the camera_infos that came."""
    parameters = {**FAST, **(parameters or {})}
    n_frames = len(parameters.get("maps", MAPS))
    n_infos = n_frames if parameters.get("publish_camera_info", True) else 0
    with open_bench() as bench:
        frames = bench.inbox(PointCloud2, "centroids")
        infos = bench.inbox(CameraInfo, "camera_info")
        bench.start(ReplayNode, parameters)
        spin_to_the_end(bench)
        receive(bench, frames, n_frames)
        receive(bench, infos, n_infos)
        return frames.messages, infos.messages


def spin_to_the_end(bench):
    """Spin until the node ends by itself."""
    with pytest.raises(ExternalShutdownException):
        bench.until(lambda: False, "end of the replay")
    bench.executor.remove_node(bench.node)


def receive(bench, inbox, n):
    """Wait for what the node has sent before its end."""
    bench.until(lambda: len(inbox.messages) >= n, f"message {n}")


def centroids(messages):
    return [centroids_from_cloud(message).xy_px for message in messages]


def sorted_rows(xy):
    return xy[np.lexsort(xy.T)]


def test_with_a_clock_that_has_not_begun_nothing_is_sent_and_the_log_says_why(monkeypatch, capfd):
    monkeypatch.setattr(sending, "_REMINDER_S", 0.01)
    with open_bench() as bench:
        frames = bench.inbox(PointCloud2, "centroids")
        infos = bench.inbox(CameraInfo, "camera_info")
        bench.start(ReplayNode, {**FAST, "use_sim_time": True})
        bench.until_true(lambda: "/clock" in capfd.readouterr().err, "reminder")
        assert frames.messages == []
        clock = bench.connected_outbox(Clock, "/clock")
        seconds = count(1000)

        def tell():
            message = Clock()
            message.clock.sec = next(seconds)
            clock.publish(message)

        bench.probe.create_timer(0.01, tell)
        spin_to_the_end(bench)
        receive(bench, frames, len(MAPS))
        receive(bench, infos, len(MAPS))
    assert all(message.header.stamp.sec >= 1000 for message in frames.messages)


# ---- what is published -----------------------------------------------------------------------


def test_all_maps_come_in_order_and_none_is_lost():
    frames, _ = replay()
    assert len(frames) == 8
    for star_map, xy in zip(MAPS.values(), centroids(frames), strict=True):
        np.testing.assert_array_equal(xy, star_map.xy_px)


def test_each_frame_has_the_camera_info_of_its_map_and_stamp():
    frames, infos = replay()
    assert [m.header for m in infos] == [m.header for m in frames]
    for star_map, info in zip(MAPS.values(), infos, strict=True):
        camera = camera_from_info(info, "mirrored")
        assert camera.fov_deg == pytest.approx(star_map.camera.fov_deg, abs=1e-9)
        assert (camera.width_px, camera.height_px) == (
            star_map.camera.width_px, star_map.camera.height_px
        )


def test_stamps_rise():
    frames, _ = replay()
    stamps = [stamp_ns(message.header) for message in frames]
    assert all(early < late for early, late in pairwise(stamps))


def test_frame_id_is_the_parameters():
    frames, infos = replay({"camera_frame": "optical", "maps": [1]})
    assert [m.header.frame_id for m in (*frames, *infos)] == ["optical", "optical"]


def test_without_camera_info_only_frames_are_published():
    frames, infos = replay({"publish_camera_info": False})
    assert (len(frames), len(infos)) == (8, 0)


# ---- options ---------------------------------------------------------------------------------


def test_chosen_maps_come_in_the_chosen_order():
    frames, _ = replay({"maps": [7, 3, 7]})
    for number, xy in zip((7, 3, 7), centroids(frames), strict=True):
        np.testing.assert_array_equal(xy, MAPS[number].xy_px)


def test_hundred_maps_at_full_speed_are_not_lost():
    frames, _ = replay({"maps": [1] * 100})
    assert len(frames) == 100


def test_noise_moves_the_centroids_by_its_standard_deviation():
    frames, _ = replay({"maps": [7] * 20, "noise_px": 0.5})
    error = np.concatenate([xy - MAPS[7].xy_px for xy in centroids(frames)])
    # 1640 values: their standard deviation is known to 1 / sqrt(2 * 1640) = 1.7 %, mean to 0.012.
    assert np.std(error) == pytest.approx(0.5, rel=0.07)
    assert np.mean(error) == pytest.approx(0.0, abs=0.05)


def test_noise_is_new_in_each_frame():
    frames, _ = replay({"maps": [1, 1], "noise_px": 0.5})
    first, second = centroids(frames)
    assert np.all(first != second)


def test_same_seed_gives_the_same_noise():
    options = {"noise_px": 0.5, "seed": 42, "shuffle": True}
    first, second = centroids(replay(options)[0]), centroids(replay(options)[0])
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_another_seed_gives_another_noise():
    one, two = (
        centroids(replay({"maps": [1], "noise_px": 0.5, "seed": seed})[0])[0] for seed in (1, 2)
    )
    assert np.all(one != two)


def test_shuffle_changes_the_order_and_nothing_else():
    frames, _ = replay({"maps": [7], "shuffle": True})
    xy = centroids(frames)[0]
    assert not np.array_equal(xy, MAPS[7].xy_px)
    np.testing.assert_array_equal(sorted_rows(xy), sorted_rows(MAPS[7].xy_px))


def test_loop_starts_again_after_the_last_map():
    with open_bench() as bench:
        frames = bench.inbox(PointCloud2, "centroids")
        bench.inbox(CameraInfo, "camera_info")
        bench.start(ReplayNode, {**FAST, "maps": [1, 2], "loop": True})
        receive(bench, frames, 5)
    for number, xy in zip((1, 2, 1, 2, 1), centroids(frames.messages[:5]), strict=True):
        np.testing.assert_array_equal(xy, MAPS[number].xy_px)


def test_maps_of_another_folder(tmp_path):
    write_star_map(MAPS[5], tmp_path / "map1.csv")
    frames, _ = replay({"maps": [1], "folder": str(tmp_path)})
    np.testing.assert_array_equal(centroids(frames)[0], MAPS[5].xy_px)


@pytest.mark.parametrize(("parameters", "text"), [
    ({"maps": [9]},
     "parameter maps is [9]: it must be a list, each item a whole number from 1 to 8"),
    ({"maps": []},
     "parameter maps is []: it must be a list, each item a whole number from 1 to 8"),
    ({"rate_hz": 0.0}, "parameter rate_hz is 0.0: it must be a number from 0.001 to 10000 Hz"),
    ({"rate_hz": float("nan")},
     "parameter rate_hz is nan: it must be a number from 0.001 to 10000 Hz"),
    ({"noise_px": -1.0}, "parameter noise_px is -1.0: it must be a number from 0 to 100 px"),
    ({"seed": -1}, "parameter seed is -1: it must be a whole number from 0 to 2147483647"),
])
def test_configuration_that_cannot_be_used_is_refused_in_one_line(parameters, text):
    with open_bench() as bench, pytest.raises(ParameterError) as caught:
        bench.start(ReplayNode, parameters)
    assert str(caught.value) == text


def test_folder_without_maps_is_refused_naming_the_file(tmp_path):
    with open_bench() as bench, pytest.raises(ParameterError, match="cannot be read") as caught:
        bench.start(ReplayNode, {"folder": str(tmp_path)})
    assert str(tmp_path / "map1.csv") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_integer_rate_is_accepted():
    frames, _ = replay({"rate_hz": 1000, "maps": [1]})
    assert len(frames) == 1


# ---- start and end ---------------------------------------------------------------------------


def looks_of(bench):
    """Return a list that grows whenever the replay has looked for a subscriber."""
    return bench.count_calls(next(iter(bench.node.timers)))


@pytest.mark.parametrize("first", ["centroids", "camera_info"])
def test_nothing_is_sent_before_both_topics_have_a_subscriber(first):
    kinds = {"centroids": PointCloud2, "camera_info": CameraInfo}
    second = next(topic for topic in kinds if topic != first)
    with open_bench() as bench:
        early = bench.inbox(kinds[first], first)
        bench.start(ReplayNode, FAST)
        looks = looks_of(bench)
        bench.until(lambda: early.n_publishers and len(looks) >= 3, "third look")
        assert not early.messages
        late = bench.inbox(kinds[second], second)
        spin_to_the_end(bench)
        receive(bench, early, 8)
        receive(bench, late, 8)


def test_without_camera_info_a_subscriber_of_centroids_is_enough():
    with open_bench() as bench:
        frames = bench.inbox(PointCloud2, "centroids")
        bench.start(ReplayNode, {**FAST, "publish_camera_info": False})
        spin_to_the_end(bench)
        receive(bench, frames, 8)


def test_late_subscriber_gets_the_first_map():
    with open_bench() as bench:
        bench.start(ReplayNode, FAST)
        looks = looks_of(bench)
        bench.until(lambda: len(looks) >= 3, "third look")
        frames = bench.inbox(PointCloud2, "centroids")
        bench.inbox(CameraInfo, "camera_info")
        spin_to_the_end(bench)
        receive(bench, frames, 8)
    np.testing.assert_array_equal(centroids(frames.messages)[0], MAPS[1].xy_px)


def test_replay_ends_also_for_a_best_effort_subscriber():
    with open_bench() as bench:
        for kind, topic in ((PointCloud2, "centroids"), (CameraInfo, "camera_info")):
            bench.inbox(kind, topic, ReliabilityPolicy.BEST_EFFORT)
        bench.start(ReplayNode, FAST)
        spin_to_the_end(bench)


def test_replay_ends_when_its_subscribers_leave():
    with open_bench() as bench:
        frames = bench.inbox(PointCloud2, "centroids")
        bench.inbox(CameraInfo, "camera_info")
        bench.start(ReplayNode, {**FAST, "maps": [1] * 20})
        bench.until(lambda: frames.messages, "first frame")
        for subscription in list(bench.probe.subscriptions):
            bench.probe.destroy_subscription(subscription)
        spin_to_the_end(bench)
