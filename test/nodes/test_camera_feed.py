"""Which camera holds for a frame? Needs no ROS."""

from star_tracker.nodes.identify.camera_feed import CameraFeed
from star_tracker.optics.camera import Camera

NARROW = Camera.from_fov(12.0, 512, 512)
WIDE = Camera.from_fov(20.0, 1024, 1024)


def feed(*announced):
    result = CameraFeed()
    for stamp, camera in announced:
        result.announce(stamp, camera)
    return result


def test_without_any_camera_there_is_none():
    assert feed().settled(5) is None
    assert feed().best(5) is None


def test_camera_of_the_frames_stamp_is_taken():
    cameras = feed((5, NARROW), (6, WIDE))
    assert cameras.settled(5) == NARROW
    assert cameras.settled(6) == WIDE


def test_camera_published_once_holds_for_later_frames():
    cameras = feed((5, NARROW))
    assert cameras.settled(6) == NARROW
    assert cameras.settled(1000) == NARROW


def test_camera_published_with_each_frame_is_waited_for():
    cameras = feed((5, NARROW))
    assert cameras.settled(5) == NARROW
    assert cameras.settled(6) is None


def test_best_camera_after_waiting_is_the_one_before():
    cameras = feed((5, NARROW))
    assert cameras.settled(5) == NARROW
    assert cameras.best(6) == NARROW


def test_camera_that_is_younger_than_the_frame_does_not_count():
    assert feed((5, NARROW)).best(4) is None


def test_cameras_may_arrive_out_of_order():
    cameras = feed((9, WIDE), (5, NARROW))
    assert cameras.best(7) == NARROW
    assert cameras.best(20) == WIDE


def test_of_two_cameras_of_one_stamp_the_later_announced_holds():
    cameras = feed((5, NARROW), (5, WIDE))
    assert cameras.settled(5) == WIDE
    assert cameras.best(6) == WIDE


def test_old_cameras_are_forgotten():
    cameras = feed(*((stamp, NARROW) for stamp in range(10_000)))
    assert cameras.best(100) is None
    assert cameras.best(9_999) == NARROW
