"""Which camera holds for a frame? Needs no ROS."""

from star_tracker.nodes.identify.camera_feed import CameraFeed, CameraFeeds
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


def answered(cameras, *stamps):
    """Take frames of these stamps through; return whether each was settled without waiting."""
    settled = []
    for stamp in stamps:
        settled.append(cameras.settled(stamp) is not None)
        assert settled[-1] or cameras.best(stamp)
        cameras.answered(stamp)
    return settled


def test_camera_published_with_each_frame_is_waited_for():
    cameras = feed((5, NARROW))
    assert answered(cameras, 5) == [True]
    assert cameras.settled(6) is None
    cameras.announce(6, WIDE)
    assert cameras.settled(6) == WIDE


def test_best_camera_after_waiting_is_the_one_before():
    cameras = feed((5, NARROW))
    answered(cameras, 5)
    assert cameras.best(6) == NARROW


def test_camera_published_for_the_first_frame_only_costs_one_wait():
    cameras = feed((5, NARROW))
    assert answered(cameras, *range(5, 30)) == [True, False, *[True] * 23]


def test_camera_published_for_every_third_frame_costs_one_wait():
    cameras, settled = feed(), []
    for stamp in range(0, 60):
        if stamp % 3 == 0:
            cameras.announce(stamp, NARROW)
        settled += answered(cameras, stamp)
    assert settled.count(False) == 1


def test_camera_that_stays_out_now_and_then_is_waited_for_all_the_same():
    cameras = feed()
    for stamp in range(10):
        if stamp != 7:
            cameras.announce(stamp, NARROW)
        answered(cameras, stamp)
    assert cameras.settled(10) is None


def test_cameras_that_come_after_their_frames_count_too():
    cameras = feed((0, NARROW))
    for stamp in range(1, 4):
        answered(cameras, stamp)
        cameras.announce(stamp, NARROW)
    assert cameras.settled(4) is None  # waits for its own from now on
    cameras.announce(4, WIDE)
    assert cameras.settled(4) == WIDE


def test_the_only_camera_serves_older_frames_too_after_one_wait():
    cameras = feed((5, NARROW))
    assert cameras.settled(4) is None
    assert not cameras.timeless
    assert cameras.best(4) == NARROW
    assert cameras.timeless
    assert cameras.settled(0) == NARROW
    assert cameras.settled(3) == NARROW


def test_one_camera_announced_again_and_again_is_the_only_one():
    cameras = feed(*((stamp, Camera.from_fov(12.0, 512, 512)) for stamp in (7, 8, 9)))
    assert cameras.best(4) == NARROW


def test_of_two_cameras_that_are_younger_than_the_frame_none_is_taken():
    cameras = feed((5, NARROW), (6, WIDE))
    assert cameras.best(4) is None
    assert not cameras.timeless


def test_another_camera_ends_the_time_of_the_only_one():
    cameras = feed((5, NARROW))
    assert cameras.best(0) == NARROW
    cameras.announce(6, WIDE)
    assert cameras.settled(0) is None
    assert cameras.best(0) is None
    assert cameras.best(5) == NARROW


def test_cameras_may_arrive_out_of_order():
    cameras = feed((9, WIDE), (5, NARROW))
    assert cameras.best(7) == NARROW
    assert cameras.best(20) == WIDE


def test_of_two_cameras_of_one_stamp_the_later_announced_holds():
    cameras = feed((5, NARROW), (5, WIDE))
    assert cameras.settled(5) == WIDE
    assert cameras.best(6) == WIDE


def test_old_cameras_are_forgotten():
    cameras = feed(*((stamp, (NARROW, WIDE)[stamp % 2]) for stamp in range(10_000)))
    assert cameras.best(100) is None
    assert cameras.best(9_999) == WIDE


# ---- several cameras on one topic ------------------------------------------------------------


def feeds(*announced):
    result = CameraFeeds()
    for frame_id, stamp, camera in announced:
        result.announce(frame_id, stamp, camera)
    return result


def test_each_camera_of_a_topic_serves_the_frames_of_its_own_frame_id():
    """Taken at the same moments, as by a rig with one trigger."""
    cameras = feeds(("left", 5, NARROW), ("right", 5, WIDE))
    for find in (cameras.settled, cameras.best):
        assert (find("left", 5), find("right", 5)) == (NARROW, WIDE)
    cameras.announce("left", 6, NARROW)
    assert cameras.best("right", 6) == WIDE


def test_a_frame_of_no_camera_of_several_has_none():
    cameras = feeds(("left", 5, NARROW), ("right", 5, WIDE))
    for frame_id in ("", "middle"):
        assert cameras.settled(frame_id, 6) is None
        assert cameras.best(frame_id, 6) is None
        cameras.answered(frame_id, 6)
    assert cameras.frame_ids == ["left", "right"]


def test_where_there_is_one_camera_the_frames_may_be_without_a_frame_id():
    assert feeds(("left", 5, NARROW)).settled("", 6) == NARROW


def test_a_frame_of_another_frame_id_takes_the_only_camera_after_one_wait():
    """As long as its own camera may still be on its way."""
    cameras = feeds(("left", 5, NARROW))
    assert cameras.settled("right", 6) is None
    assert cameras.best("right", 6) == NARROW
    assert cameras.settled("right", 7) == NARROW
    cameras.announce("right", 5, WIDE)
    assert cameras.settled("right", 8) == WIDE


def test_without_any_camera_no_frame_has_one_whatever_its_frame_id():
    cameras = feeds()
    cameras.answered("left", 1)
    assert cameras.settled("left", 1) is None
    assert cameras.best("left", 1) is None
    assert not cameras.timeless


def test_as_many_frame_ids_as_anybody_sends_take_no_more_memory():
    cameras = feeds(*((str(n), n, NARROW) for n in range(200)))
    assert len(cameras.frame_ids) == 16
    only = feeds(("left", 5, NARROW))
    for n in range(200):
        only.best(str(n), 6)
    assert len(only._strangers) == 16
