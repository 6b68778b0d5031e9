"""Which topic of a bag has the frames, and which their cameras."""

from collections.abc import Mapping, Sequence
from pathlib import Path

IMAGE, COMPRESSED, CENTROIDS = (
    f"sensor_msgs/msg/{kind}" for kind in ("Image", "CompressedImage", "PointCloud2")
)
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
#: Clouds that identify_node publishes: no frames.
_OUTPUT = "identified_stars"


def frames_topic(
    path: Path, by_kind: Mapping[str, set[str]], topic: str
) -> tuple[str, str]:
    """Return the topic of the frames and its type.

    Args:
        path: of the bag, for errors.
        by_kind: the bag's topics by type.
        topic: the one that is wanted, empty for the only one.

    Raises ValueError where it is not there, or unless there is just one.
    """
    found = {
        one: kind for kind in (IMAGE, COMPRESSED, CENTROIDS)
        for one in sorted(by_kind.get(kind, ()))
    }
    if topic:
        if topic not in found:
            raise ValueError(
                f"{path} has no images or centroids on {topic}"
                + (f": choose of {', '.join(found)} with --topic" if found else "")
            )
        return topic, found[topic]
    inputs = [one for one in found if one.rpartition("/")[2] != _OUTPUT]
    if not inputs:
        raise ValueError(
            f"{path} has neither images nor centroids: record a topic of sensor_msgs/Image, "
            "CompressedImage or PointCloud2"
        )
    if len(inputs) > 1:
        raise ValueError(
            f"{path} has several topics, choose one with --topic: {', '.join(inputs)}"
        )
    return inputs[0], found[inputs[0]]


def info_topic(path: Path, infos: Sequence[str], topic: str, asked: str) -> str:
    """Return the topic of the CameraInfo that belongs to a topic of frames, empty for none.

    It is the one that is asked for, else the one beside the frames', else the only one. Raises
    ValueError where it is not there, and where there are several.
    """
    if asked:
        if asked not in infos:
            raise ValueError(
                f"{path} has no CameraInfo on {asked}: there is {', '.join(infos) or 'none'}"
            )
        return asked
    beside = topic.rpartition("/")[0] + "/camera_info"
    if topic.endswith("/compressed"):  # /camera/image_raw/compressed has /camera/camera_info
        beside = topic.rsplit("/", 2)[0] + "/camera_info"
    if beside in infos or len(infos) < 2:
        return beside if beside in infos else "".join(infos)
    raise ValueError(
        f"{path} has several topics of CameraInfo, choose one with --camera-info-topic: "
        f"{', '.join(infos)}"
    )

