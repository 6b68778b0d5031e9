"""Bags of ROS 2 (MCAP, sqlite3) and ROS 1 as frames with their cameras. No ROS, but rosbags."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from star_tracker.bags.message_types import require_rosbags
from star_tracker.bags.topics import CAMERA_INFO, frames_topic, info_topic
from star_tracker.msg_adapters import MessageError, shown
from star_tracker.msg_adapters.camera_info import camera_from_info
from star_tracker.msg_adapters.stamp import nanoseconds_from_header
from star_tracker.optics.camera import Camera

#: Endings of bags that are one file, beside folders with a file of metadata.
ENDINGS = (".mcap", ".db3", ".bag")
METADATA = "metadata.yaml"


class DamagedBagError(ValueError):
    """A bag that cannot be read, or not any further; the text names it and says why."""


def is_bag(path: Path) -> bool:
    """Return whether a path is that of a bag: by its ending, or a folder."""
    return path.suffix.lower() in ENDINGS or path.is_dir()


@dataclass(frozen=True)
class Wanted:
    """What is to be read of a bag; empty = what there is.

    Attributes:
        topic: of images or centroids.
        info_topic: of CameraInfo.
        parity: of the cameras.
    """

    topic: str = ""
    info_topic: str = ""
    parity: str = "auto"


@dataclass(frozen=True)
class BagFrame:
    """A message with a frame, before anything is made of it.

    Attributes:
        kind: its type: `topics.IMAGE`, `COMPRESSED` or `CENTROIDS`.
        number: its place in the topic, from 0.
        stamp_ns, frame_id: of its header.
        logged_ns: when it was recorded.
        message: its fields; a MessageError where its bytes cannot be read.
    """

    kind: str
    number: int
    stamp_ns: int
    frame_id: str
    logged_ns: int
    message: Any


class Announced:
    """The cameras that CameraInfo tells, by stamp; a frame gets its own, or the last one before.

    As with identify_node: of CameraInfo with a frame's stamp the last one holds, else the newest
    that is not younger; one camera for all serves frames of any stamp. Where CameraInfo has
    several frame_id, those of the frame's own hold.

    Args:
        messages: CameraInfo in the order of their recording.
        parity: of the images, as CameraInfo says nothing of it.
    """

    def __init__(self, messages: Sequence[Any], parity: str) -> None:
        self._of: dict[str, list[tuple[int, Camera]]] = {}
        self.refused, self.size_px = "", (0, 0)
        for message in messages:
            size = int(message.width), int(message.height)
            self.size_px = size if all(size) else self.size_px
            try:
                camera = camera_from_info(message, parity)
            except MessageError as error:
                self.refused = str(error)
                continue
            told = self._of.setdefault(str(message.header.frame_id), [])
            told.append((nanoseconds_from_header(message.header), camera))
        for cameras in self._of.values():
            cameras.sort(key=_stamp)  # stable: of equal stamps the last stays last

    def __bool__(self) -> bool:
        return bool(self._of)

    def at(self, stamp_ns: int, frame_id: str) -> Camera:
        """Return the camera of a frame. Raises ValueError with the reason why there is none."""
        if len(self._of) > 1 and frame_id not in self._of:
            raise ValueError(
                f"the CameraInfo have frame_id {', '.join(map(shown, sorted(self._of)))}, this "
                f"frame has {shown(frame_id)}: give the camera with --camera or --fov-deg"
            )
        cameras = self._of[frame_id if len(self._of) > 1 else next(iter(self._of))]
        i = bisect_right(cameras, stamp_ns, key=_stamp)
        if i == 0 and any(camera != cameras[0][1] for _, camera in cameras):
            raise ValueError(
                "all CameraInfo are younger than this frame, and not of one camera: give the "
                "camera with --camera or --fov-deg"
            )
        return cameras[max(i - 1, 0)][1]


def _stamp(told: tuple[int, Camera]) -> int:
    return told[0]


class Bag:
    """A bag that is open, with one topic of frames. Use `open_bag`.

    Attributes:
        path: of the bag.
        topic, kind: of the frames, and their type.
        info_topic: of the CameraInfo that belongs to them, empty = none.
        n_frames: how many there are, as far as the bag knows.
    """

    def __init__(self, path: Path, reader: Any, wanted: Wanted) -> None:
        self.path, self._reader, self._parity = path, reader, wanted.parity
        by_kind: dict[str, set[str]] = {}
        for one in reader.connections:
            by_kind.setdefault(one.msgtype, set()).add(one.topic)
        self.topic, self.kind = frames_topic(path, by_kind, wanted.topic)
        infos = sorted(by_kind.get(CAMERA_INFO, ()))
        self.info_topic = info_topic(path, infos, self.topic, wanted.info_topic)
        self.n_frames = sum(one.msgcount for one in self._connections(self.topic))

    def announced(self) -> Announced:
        """Return the cameras of the bag, up to where it is damaged: its frames tell that."""
        messages: list[Any] = []
        with suppress(DamagedBagError):
            messages.extend(message for _, message in self._messages(self.info_topic))
        messages = [one for one in messages if not isinstance(one, MessageError)]
        return Announced(messages, self._parity)

    def frames(self) -> Iterator[BagFrame]:
        """Yield the frames in the order of their recording.

        Raises DamagedBagError where it cannot be read any further.
        """
        for number, (logged_ns, message) in enumerate(self._messages(self.topic)):
            stamp_ns, frame_id = 0, ""
            if not isinstance(message, MessageError):
                stamp_ns = nanoseconds_from_header(message.header)
                frame_id = str(message.header.frame_id)
            yield BagFrame(self.kind, number, stamp_ns, frame_id, logged_ns, message)

    def _connections(self, topic: str) -> list[Any]:
        return [one for one in self._reader.connections if one.topic == topic]

    def _messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        connections = self._connections(topic)
        if not connections:
            return
        with _readable(self.path):
            for connection, logged_ns, raw in self._reader.messages(connections):
                yield logged_ns, self._message(raw, connection.msgtype)

    def _message(self, raw: bytes, kind: str) -> Any:
        """Return a message; an error in its place where its bytes are none of its type."""
        try:
            return _plain(self._reader.deserialize(raw, kind))
        except Exception as error:  # errors of many kinds
            return MessageError(f"its {len(raw)} bytes are no {kind}: {_why(error)}")


@contextmanager
def open_bag(path: Path, wanted: Wanted) -> Iterator[Bag]:
    """Open a bag.

    Raises ValueError where rosbags is not installed, and naming the bag where it cannot be read,
    has no frames, or has several topics of them and none is chosen.
    """
    require_rosbags()
    from rosbags.highlevel import AnyReader  # noqa: PLC0415  an extra
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    if not path.exists():
        raise ValueError(f"{path} cannot be read: there is no such file")
    if path.is_dir() and not (path / METADATA).is_file():
        raise ValueError(
            f"{path} is a folder without {METADATA}, so it is no bag: name the files in it"
        )
    with ExitStack() as stack:
        with _readable(path):
            # Older bags do not tell their types; those that are read here have stayed as they are.
            reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY))
            stack.enter_context(reader)
        yield Bag(path, reader, wanted)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Say in a sentence that a bag cannot be read: its reader raises errors of many kinds."""
    try:
        yield
    except Exception as error:
        raise DamagedBagError(f"{path} cannot be read: {_why(error)}") from error


def _why(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__


def _plain(message: Any) -> Any:
    """Return a message with the fields' names of ROS 2, and nothing that other processes lack."""
    if isinstance(message, list):
        return [_plain(one) for one in message]
    if not is_dataclass(message):
        return message
    return SimpleNamespace(**{name.lower(): _plain(one) for name, one in vars(message).items()})
