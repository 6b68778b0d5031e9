"""Bags of each storage, and what is said of those that cannot be used."""

import shutil
from dataclasses import replace

import bag_files
import numpy as np
import pytest
from bag_files import HERE, asked_for, maps_bag, raw_messages
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from star_tracker.bags.frames import Reading, read_frames
from star_tracker.bags.message_types import BagTypes, long_name
from star_tracker.bags.reading import DamagedBagError, Wanted, is_bag, open_bag
from star_tracker.bags.solving import BagSolver
from star_tracker.bags.topics import CENTROIDS
from star_tracker.bags.writing import new_bag
from star_tracker.detection.centroids import DetectSettings
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.maps.star_map import paper_maps
from star_tracker.msg_adapters.camera_info import info_from_camera
from star_tracker.msg_adapters.centroids import Centroids
from star_tracker.msg_adapters.image import compressed_from_picture, picture_from_image
from star_tracker.msg_adapters.message_class import classes_from, message_class
from star_tracker.msg_adapters.point_cloud import cloud_from_centroids
from star_tracker.offline.spreading import Spread
from star_tracker.optics.camera import Camera

MAP1, MAP2 = paper_maps((1, 2))
#: As all maps are: where it has to be found out, a tracker is made twice.
MIRRORED = asked_for(parity="mirrored")
#: Of a camera that is not told, but not just any: each kind has its own guide stars.
KNOWN_SIZE = replace(MIRRORED, size_px=(512, 512), fov_range_deg=(10.0, 14.0))


def solved(path, asked=MIRRORED, **options):
    """Return the results of a bag's frames."""
    return bag_files.solved(path, asked, **options)


def refusal(path, asked=MIRRORED, **wanted):
    """Return what is said of a bag that cannot be used."""
    with pytest.raises(ValueError, match=r"\w") as caught:
        solved(path, asked, **wanted)
    text = str(caught.value)
    assert "\n" not in text
    return text


def written(path, *frames, camera=None):
    """Write frames (topic, xy, stamp_ns) and the CameraInfo of a camera, in their order."""
    with new_bag(path) as writer:
        if camera is not None:
            writer.declare("/camera_info", "sensor_msgs/CameraInfo")
            writer.write("/camera_info", info_from_camera(camera, writer.header(1, "c")), 1)
        for topic in dict.fromkeys(topic for topic, *_ in frames):
            writer.declare(topic, "sensor_msgs/PointCloud2")
        for topic, xy, stamp_ns in frames:
            cloud = cloud_from_centroids(Centroids(xy), writer.header(stamp_ns, "c"))
            writer.write(topic, cloud, stamp_ns)
    return path


def test_centroids_without_camera_info_are_counted_as_is_told(tmp_path):
    """The boresight is the same for those counted from the middle of the first pixel."""
    corner = solved(
        written(tmp_path / "a.mcap", ("/c", MAP1.xy_px, 5)), asked_for(camera=MAP1.camera)
    )
    center = solved(
        written(tmp_path / "b.mcap", ("/c", MAP1.xy_px - 0.5, 5)),
        asked_for(camera=MAP1.camera, pixel_origin="center"),
    )
    np.testing.assert_allclose(center[0].frame.told_px, MAP1.xy_px - 0.5)
    np.testing.assert_allclose(
        center[0].solution.attitude.rotation, corner[0].solution.attitude.rotation, atol=1e-9
    )


def as_rosbag1(source, path):
    """Write the messages of a bag of ROS 2 as one of ROS 1."""
    new, old = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        connections = {}
        for topic, kind, logged_ns, raw in raw_messages(source):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=old)
            message = in_ros1(old, kind, new.deserialize_cdr(raw, kind))
            writer.write(connections[topic], logged_ns, old.serialize_ros1(message, kind))
    return path


def in_ros1(store, kind, message):
    """Return a message with the fields of ROS 1: headers with a number, capitals in CameraInfo."""
    values = {}
    for name, (node, what) in store.fielddefs[kind][1]:
        value = 0 if name == "seq" else getattr(message, name.lower())
        if node.name == "NAME":
            value = in_ros1(store, what, value)
        elif node.name == "SEQUENCE" and what[0][0].name == "NAME":
            value = [in_ros1(store, what[0][1], one) for one in value]
        values[name] = value
    return store.types[kind](**values)


def test_each_storage_gives_the_same(tmp_path):
    """MCAP and sqlite3, a folder and a file, and a bag of ROS 1."""
    mcap = maps_bag(tmp_path / "maps.mcap", (1, 6))
    bags = [
        mcap, maps_bag(tmp_path / "maps.db3", (1, 6)),
        maps_bag(tmp_path / "folder", (1, 6)),
        maps_bag(tmp_path / "folder.2", (1, 6), storage="sqlite3"),
        as_rosbag1(mcap, tmp_path / "maps.bag"),
    ]
    found = []
    for path in bags:
        assert is_bag(path)
        results = solved(path)
        assert [one.place.stamp_ns % 10**9 for one in results] == [0, 10**8]
        found.append([one.solution.attitude.rotation.tolist() for one in results])
    assert all(one == found[0] for one in found)


def test_images_of_ros_1_are_detected(tmp_path):
    bag = maps_bag(tmp_path / "images.mcap", (1,), rendered=RenderSettings())
    (new,), (old,) = solved(bag), solved(as_rosbag1(bag, tmp_path / "images.bag"))
    assert new.is_solved
    assert old.solution.attitude.rotation.tolist() == new.solution.attitude.rotation.tolist()


def test_compressed_images_have_the_camera_info_of_their_camera(tmp_path):
    """As image_transport records them; another camera's CameraInfo lies in the same bag."""
    pytest.importorskip("PIL", reason="needs Pillow, an extra")
    source = maps_bag(tmp_path / "images.mcap", (1,), rendered=RenderSettings())
    path, types = tmp_path / "bag.mcap", BagTypes()
    raw = {topic: types.store.deserialize_cdr(raw, kind)
           for topic, kind, _, raw in raw_messages(source)}
    with new_bag(path) as writer:
        for name in ("/left", "/right"):
            writer.declare(f"{name}/camera_info", "sensor_msgs/CameraInfo")
        writer.declare("/left/image_raw/compressed", "sensor_msgs/CompressedImage")
        picture, header = picture_from_image(raw["/image"]), raw["/image"].header
        writer.write("/left/camera_info", raw["/camera_info"], 1)
        other = info_from_camera(Camera.from_fov(40, 64, 64), header)
        writer.write("/right/camera_info", other, 2)
        compressed = compressed_from_picture(picture, header)
        writer.write("/left/image_raw/compressed", compressed, 3)
    (result,), (plain,) = solved(path), solved(source)
    assert result.solution.attitude.rotation.tolist() == (
        plain.solution.attitude.rotation.tolist()
    )
    assert "CameraInfo is for 64 x 64 px" in (
        solved(path, info_topic="/right/camera_info")[0].error
    )
    assert refusal(path, info_topic="/up") == (
        f"{path} has no CameraInfo on /up: there is /left/camera_info, /right/camera_info"
    )


def test_several_cameras_elsewhere_are_named_and_one_can_be_chosen(tmp_path):
    path = tmp_path / "bag.mcap"
    with new_bag(path) as writer:
        header = writer.header(1, "c")
        writer.declare("/stars", "sensor_msgs/PointCloud2")
        writer.write("/stars", cloud_from_centroids(Centroids(MAP1.xy_px), header), 1)
        for name in ("/left", "/right"):
            writer.declare(f"{name}/camera_info", "sensor_msgs/CameraInfo")
            writer.write(f"{name}/camera_info", info_from_camera(MAP1.camera, header), 1)
    assert refusal(path) == (
        f"{path} has several topics of CameraInfo, choose one with --camera-info-topic: "
        "/left/camera_info, /right/camera_info"
    )
    assert solved(path, info_topic="/left/camera_info")[0].is_solved


def test_cameras_that_are_all_younger_and_differ_are_none(tmp_path):
    path = tmp_path / "bag.mcap"
    with new_bag(path) as writer:
        writer.declare("/stars", "sensor_msgs/PointCloud2")
        writer.declare("/camera_info", "sensor_msgs/CameraInfo")
        cloud = cloud_from_centroids(Centroids(MAP1.xy_px), writer.header(1, "c"))
        writer.write("/stars", cloud, 1)
        for stamp_ns, fov_deg in ((5, 12), (6, 20)):
            info = info_from_camera(
                Camera.from_fov(fov_deg, 512, 512), writer.header(stamp_ns, "c")
            )
            writer.write("/camera_info", info, stamp_ns)
    (result,) = solved(path)
    assert "all CameraInfo are younger than this frame, and not of one camera" in result.error


def test_cameras_of_one_topic_are_told_apart_by_frame_id(tmp_path):
    path, maps = tmp_path / "bag.mcap", {"left": paper_maps((6,))[0], "right": paper_maps((7,))[0]}
    with new_bag(path) as writer:
        writer.declare("/stars", "sensor_msgs/PointCloud2")
        writer.declare("/camera_info", "sensor_msgs/CameraInfo")
        for side, star_map in maps.items():
            info = info_from_camera(star_map.camera, writer.header(5, side))
            writer.write("/camera_info", info, 5)
        for frame_id in ("left", "right", "middle"):
            xy = maps.get(frame_id, maps["left"]).xy_px
            header = writer.header(5, frame_id)
            writer.write("/stars", cloud_from_centroids(Centroids(xy), header), 5)
    left, right, middle = solved(path)
    assert left.is_solved
    assert right.is_solved
    assert middle.error.endswith(
        "the CameraInfo have frame_id left, right, this frame has middle: "
        "give the camera with --camera or --fov-deg"
    )


def test_the_truth_of_rendered_maps_is_found(tmp_path):
    """CameraInfo counts from the middle of the first pixel: half a pixel off is 0.012 deg."""
    path = maps_bag(tmp_path / "images.mcap", (1,), rendered=RenderSettings())
    (result,) = solved(path, asked_for())
    assert result.solution.parity == "mirrored"
    boresight = np.degrees([result.solution.attitude.ra_rad, result.solution.attitude.dec_rad])
    np.testing.assert_allclose(boresight, [109.6, 34.5], atol=0.001)


def test_the_camera_that_the_user_tells_goes_before_camera_info(tmp_path):
    wrong = Camera.from_fov(40, 512, 512)
    path = written(tmp_path / "bag", ("/centroids", MAP1.xy_px, 5), camera=wrong)
    assert not solved(path)[0].is_solved
    assert solved(path, replace(MIRRORED, fov_deg=12.0))[0].is_solved
    assert solved(path, asked_for(camera=MAP1.camera))[0].is_solved


def test_a_camera_without_calibration_tells_the_size_alone(tmp_path):
    path = tmp_path / "bag.mcap"
    with new_bag(path) as writer:
        writer.declare("/camera_info", "sensor_msgs/CameraInfo")
        writer.declare("/stars", "sensor_msgs/PointCloud2")
        header = writer.header(1, "c")
        info = message_class("sensor_msgs/CameraInfo")(header=header, width=512, height=512)
        info.k, info.r, info.p = [0.0] * 9, [0.0] * 9, [0.0] * 12
        writer.write("/camera_info", info, 1)
        writer.write("/stars", cloud_from_centroids(Centroids(MAP1.xy_px), header), 1)
    with open_bag(path, Wanted()) as bag:
        solver = BagSolver(bag, asked_for())
        ((_, result),) = solver.results(HERE)
    assert "CameraInfo: K is zero" in solver.note
    assert result.is_solved


def test_frames_of_changing_cameras_get_theirs(tmp_path):
    """Maps 6 and 7 are of cameras of 12 and 20 deg, each told before its frame."""
    results = solved(maps_bag(tmp_path / "maps.mcap", (6, 7, 6)))
    fields = [round(one.solution.camera.fov_deg, 1) for one in results]
    assert fields == [12.0, 20.0, 12.0]


def test_independent_frames_are_all_lost_in_space(tmp_path):
    path = written(
        tmp_path / "bag", *[("/stars", MAP1.xy_px, stamp) for stamp in (1, 2, 3)],
        camera=MAP1.camera,
    )
    assert [one.solution.mode for one in solved(path)][1:] == ["tracking"] * 2
    alone = solved(path, replace(MIRRORED, independent=True))
    assert {one.solution.mode for one in alone} == {"lost_in_space"}


def test_several_topics_are_named_and_one_can_be_chosen(tmp_path):
    path = written(
        tmp_path / "bag.mcap", ("/left/stars", MAP1.xy_px, 1), ("/right/stars", MAP2.xy_px, 1),
        ("/identified_stars", MAP1.xy_px, 1),
    )
    assert refusal(path, KNOWN_SIZE) == (
        f"{path} has several topics, choose one with --topic: /left/stars, /right/stars"
    )
    (result,) = solved(path, KNOWN_SIZE, topic="/right/stars")
    assert result.is_solved
    assert result.place.topic == "/right/stars"
    assert refusal(path, KNOWN_SIZE, topic="/up").startswith(
        f"{path} has no images or centroids on /up: choose of "
    )


def test_centroids_need_the_size_of_their_image(tmp_path):
    path = written(tmp_path / "bag.mcap", ("/stars", MAP1.xy_px, 1))
    assert refusal(path) == (
        f"{path} has centroids without CameraInfo: give the size of their image with --width-px "
        "and --height-px"
    )


def test_a_bag_without_frames_says_so(tmp_path):
    path = tmp_path / "bag.mcap"
    with new_bag(path) as writer:
        writer.declare("/camera_info", "sensor_msgs/CameraInfo")
        info = info_from_camera(MAP1.camera, writer.header(1, "c"))
        writer.write("/camera_info", info, 1)
    assert refusal(path).startswith(f"{path} has neither images nor centroids: record a topic of")


@pytest.mark.parametrize("name", ["bag.mcap", "bag.db3", "bag.bag"])
@pytest.mark.parametrize("content", [b"", b"no bag at all", bytes(100_000)])
def test_what_is_no_bag_is_refused_in_a_sentence(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    assert refusal(path).startswith(f"{path} cannot be read: ")


def test_a_folder_that_is_no_bag_is_refused(tmp_path):
    assert "is a folder without metadata.yaml, so it is no bag" in refusal(tmp_path)
    (tmp_path / "metadata.yaml").write_text("a: [", encoding="utf-8")
    assert refusal(tmp_path).startswith(f"{tmp_path} cannot be read: ")


@pytest.mark.parametrize("jobs", [1, 2])
def test_frames_before_the_damage_are_not_lost(tmp_path, jobs):
    path = maps_bag(tmp_path / "images.mcap", (1, 2), rendered=RenderSettings())

    def until_damage(frames):
        yield from frames
        raise DamagedBagError("no more of it")

    seen = []
    reading = Reading(path, DetectSettings())
    with open_bag(path, Wanted()) as bag:
        frames = read_frames(until_damage(bag.frames()), bag.kind, reading, Spread(jobs))
        with pytest.raises(DamagedBagError, match="no more of it"):
            seen.extend(read.found.size_px for read in frames)
    assert seen == [(512, 512)] * 2


def test_a_bag_that_was_cut_off_is_told(tmp_path):
    """Its metadata still promises all frames."""
    path = maps_bag(tmp_path / "bag", (1, 2, 4), storage="sqlite3")
    cut = path / "bag.db3"
    cut.write_bytes(cut.read_bytes()[:-4096])
    with pytest.raises(DamagedBagError, match="cannot be read: "):
        solved(path, KNOWN_SIZE)


def test_bytes_that_are_no_message_are_told_and_the_others_are_solved(tmp_path):
    path, types = tmp_path / "bag", BagTypes()
    with classes_from(types):
        header = types("std_msgs/Header")(frame_id="c")
        cloud = cloud_from_centroids(Centroids(MAP1.xy_px), header)
    raw = bytes(types.serialized(cloud, "sensor_msgs/PointCloud2"))
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        stars = writer.add_connection("/stars", CENTROIDS, typestore=types.store)
        writer.write(stars, 1, raw[:30])
        writer.write(stars, 2, raw)
    first, second = solved(path, KNOWN_SIZE)
    assert ", frame 0 of /stars: its 30 bytes are no sensor_msgs/msg/PointCloud2: " in first.error
    assert second.is_solved


def test_a_malformed_frame_is_told_and_the_others_are_solved(tmp_path):
    path = tmp_path / "bag.mcap"
    with new_bag(path) as writer:
        writer.declare("/stars", "sensor_msgs/PointCloud2")
        for stamp in (1, 2):
            cloud = cloud_from_centroids(Centroids(MAP1.xy_px), writer.header(stamp, "c"))
            cloud.point_step += 2 - stamp
            writer.write("/stars", cloud, stamp)
    first, second = solved(path, KNOWN_SIZE)
    assert first.solution is None
    assert first.error.startswith(f"{path}, frame 0 of /stars: PointCloud2 data has ")
    assert second.is_solved


def test_an_image_of_another_size_than_its_camera_is_told(tmp_path):
    source = maps_bag(tmp_path / "images.mcap", (1,), rendered=RenderSettings())
    path, types = tmp_path / "bag.mcap", BagTypes()
    with new_bag(path) as writer:
        for topic, kind, logged_ns, raw in raw_messages(source):
            message = types.store.deserialize_cdr(raw, kind)
            if topic == "/camera_info":
                message.width = 1024
            writer.declare(topic, kind)
            writer.write(topic, message, logged_ns)
    (result,) = solved(path)
    assert "CameraInfo is for 1024 x 512 px, the image has 512 x 512" in result.error


def test_processes_give_what_one_process_gives(tmp_path):
    path = maps_bag(tmp_path / "images.mcap", (1, 5, 6), rendered=RenderSettings())
    one, two = solved(path), solved(path, spread=Spread(jobs=2))
    assert [r.solution.attitude.rotation.tolist() for r in one] == [
        r.solution.attitude.rotation.tolist() for r in two
    ]


@pytest.mark.slow
def test_a_dask_cluster_gives_what_this_process_gives(tmp_path):
    distributed = pytest.importorskip("distributed", reason="needs distributed, an extra")
    path = maps_bag(tmp_path / "images.mcap", (1, 5), rendered=RenderSettings())
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None,
        scheduler_port=0,
    ) as cluster:
        found = solved(path, spread=Spread(scheduler=cluster.scheduler_address))
    assert [one.solution.attitude.rotation.tolist() for one in found] == [
        one.solution.attitude.rotation.tolist() for one in solved(path)
    ]


# Writing


def test_a_folder_that_is_there_is_not_written_over(tmp_path):
    path = maps_bag(tmp_path / "bag", (1,))
    with pytest.raises(ValueError, match="is there already: remove it, or write to another"):
        maps_bag(path, (1,))
    assert len(raw_messages(path)) == 2


def test_a_file_is_replaced_as_a_whole_or_not_at_all(tmp_path):
    path = maps_bag(tmp_path / "bag.mcap", (1,))
    with pytest.raises(RuntimeError, match="no more"), new_bag(path):
        raise RuntimeError("no more")
    assert len(raw_messages(path)) == 2
    assert len(raw_messages(maps_bag(path, (1, 2)))) == 4
    assert [one.name for one in tmp_path.iterdir()] == ["bag.mcap"]


def test_a_storage_that_the_ending_denies_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"cannot be of storage sqlite3: \.mcap is mcap"):
        maps_bag(tmp_path / "bag.mcap", (1,), storage="sqlite3")


def test_a_place_that_is_not_there_takes_no_bag(tmp_path):
    with pytest.raises(ValueError, match="cannot be written: "):
        maps_bag(tmp_path / "no" / "bag.mcap", (1,))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_metadata_and_messages_are_those_of_jazzy(tmp_path, storage):
    """No QoS is offered: the player takes its default, reliable, the last ten, volatile."""
    yaml = pytest.importorskip("yaml", reason="reading the metadata needs PyYAML")
    path = maps_bag(tmp_path / "maps", (1, 2), storage)
    told = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (told["version"], told["storage_identifier"]) == (9, storage)
    assert (told["message_count"], told["compression_mode"]) == (4, "")
    assert told["starting_time"] == {"nanoseconds_since_epoch": 946_684_800_000_000_000}
    assert told["duration"] == {"nanoseconds": 100_000_000}
    (file,) = told["files"]
    assert [file["path"]] == told["relative_file_paths"]
    assert (path / file["path"]).is_file()
    for one in told["topics_with_message_count"]:
        topic = one["topic_metadata"]
        assert one["message_count"] == 2
        assert (topic["serialization_format"], topic["offered_qos_profiles"]) == ("cdr", [])
        assert topic["type_description_hash"] == (
            get_typestore(Stores.ROS2_JAZZY).hash_rihs01(topic["type"])
        )
    with AnyReader([path]) as reader:
        kinds = [
            type(reader.deserialize(raw, one.msgtype)).__name__
            for one, _, raw in reader.messages()
        ]
    assert len(kinds) == 4


def test_types_have_long_names():
    assert long_name("sensor_msgs/Imu") == long_name("sensor_msgs/msg/Imu") == (
        "sensor_msgs/msg/Imu"
    )


def test_a_copied_folder_is_still_a_bag(tmp_path):
    """The metadata names its files without a path."""
    path = maps_bag(tmp_path / "bag", (1,))
    shutil.copytree(path, tmp_path / "copy")
    assert solved(tmp_path / "copy")[0].is_solved
