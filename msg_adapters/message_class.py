"""Where adapters that write get the classes of messages from: ROS, or a writer of bags."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib import import_module
from typing import Any

#: Returns what makes messages of a type, such as `sensor_msgs/Imu`.
Classes = Callable[[str], Any]


@cache
def _of_ros(name: str) -> Any:
    package, _, kind = name.partition("/")
    return getattr(import_module(f"{package}.msg"), kind)


_classes: ContextVar[Classes] = ContextVar("classes", default=_of_ros)


def message_class(name: str) -> Any:
    """Return the class of a type of messages, `sensor_msgs/Imu` for instance.

    Raises ImportError where ROS is not installed and no other classes are in use.
    """
    return _classes.get()(name)


@contextmanager
def classes_from(classes: Classes) -> Iterator[None]:
    """Let adapters write messages of other classes, so that bags are written without ROS."""
    token = _classes.set(classes)
    try:
        yield
    finally:
        _classes.reset(token)
