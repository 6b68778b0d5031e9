"""Bags that `ros2 bag play` streams: MCAP or sqlite3, a folder or a single file, without ROS."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

from star_tracker.bags.message_types import BagTypes, long_name
from star_tracker.msg_adapters.message_class import classes_from

#: Storages, and the endings of their files.
STORAGES = {"mcap": ".mcap", "sqlite3": ".db3"}
#: Of the file of metadata: that of Jazzy.
_VERSION: Literal[9] = 9


class BagWriter:
    """Writes messages of the adapters into an open bag. Use `new_bag`.

    Args:
        types: what makes the messages.
        writer: of rosbags, open.
    """

    def __init__(self, types: BagTypes, writer: Any) -> None:
        self._types, self._writer = types, writer
        self._topics: dict[str, Any] = {}
        self.n_written = 0

    def header(self, stamp_ns: int, frame_id: str) -> Any:
        """Return the header of a message."""
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        stamp = self._types("builtin_interfaces/Time")(sec=seconds, nanosec=nanoseconds)
        return self._types("std_msgs/Header")(stamp=stamp, frame_id=frame_id)

    def declare(self, topic: str, name: str) -> None:
        """Add a topic of messages of a type, `sensor_msgs/Imu` for instance."""
        connection = self._writer.add_connection(
            topic, long_name(name), typestore=self._types.store
        )
        self._topics[topic] = (connection, name)

    def write(self, topic: str, message: object, logged_ns: int) -> None:
        """Write a message of a topic that was declared, under the time when it is played."""
        connection, name = self._topics[topic]
        self._writer.write(connection, logged_ns, self._types.serialized(message, name))
        self.n_written += 1


@contextmanager
def new_bag(path: Path, storage: str | None = None) -> Iterator[BagWriter]:
    """Give a bag to write; meanwhile the adapters make its messages.

    A path that ends in .mcap or .db3 becomes one file, in place of one that was there; any other a
    folder with its metadata, of a storage out of `STORAGES` (MCAP). It stands there when all is
    written, or not at all. Raises ValueError for a folder that is there already, a place that
    takes nothing, another storage than the ending's, and where rosbags is not installed.
    """
    types = BagTypes()
    from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: PLC0415  an extra

    of_ending = next((name for name, end in STORAGES.items() if path.suffix == end), None)
    if path.is_dir() or (path.exists() and of_ending is None):
        raise ValueError(f"{path} is there already: remove it, or write to another place")
    if of_ending and storage not in (None, of_ending):
        raise ValueError(f"{path} cannot be of storage {storage}: {path.suffix} is {of_ending}")
    storage = of_ending or storage or "mcap"
    try:
        room = Path(tempfile.mkdtemp(prefix=f".{path.name}-", dir=path.parent))
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror or error}") from error
    try:
        folder = room / (path.stem if of_ending else path.name)
        writer = Writer(
            folder, version=_VERSION, storage_plugin=getattr(StoragePlugin, storage.upper())
        )
        with writer, classes_from(types):
            yield BagWriter(types, writer)
        if of_ending is None:
            folder.replace(path)
        else:
            (folder / f"{folder.name}{path.suffix}").replace(path)
    except BrokenPipeError:  # of who reads what is printed meanwhile
        raise
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(room, ignore_errors=True)
