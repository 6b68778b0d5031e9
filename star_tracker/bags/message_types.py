"""Messages of bags without ROS: the classes of the library rosbags, with every field in place.

The adapters write into messages as ROS makes them: fields that are not told are zero or empty, and
a list will do for an array. Those of rosbags have neither, so both are seen to here.
"""

from typing import Any

import numpy as np

_MISSING = "bags need rosbags: pip install rosbags"
#: What fields of a basic type hold that are not told; all others hold 0.
_BLANK: dict[str, object] = {"string": "", "wstring": "", "bool": False}
#: Types of arrays that numpy calls by another name.
_NUMPY = {"bool": "?", "byte": "u1", "char": "u1", "octet": "u1"}


def require_rosbags() -> None:
    """Raise ValueError with what to install where rosbags is not there."""
    try:
        import rosbags.highlevel  # noqa: F401, PLC0415  an extra
    except ImportError as error:
        raise ValueError(_MISSING) from error


class BagTypes:
    """The types of messages of ROS 2 Jazzy. Raises ValueError where rosbags is not installed.

    An instance returns the class of a type by its short name, as `msg_adapters.message_class`
    asks for it.
    """

    def __init__(self) -> None:
        require_rosbags()
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415  an extra

        self.store: Any = get_typestore(Stores.ROS2_JAZZY)

    def __call__(self, name: str) -> "_MessageClass":
        """Return the class of a type such as `sensor_msgs/Imu`."""
        return _MessageClass(self.store, long_name(name))

    def serialized(self, message: object, name: str) -> memoryview:
        """Return a message of a type as CDR, as it lies in a bag."""
        kind = long_name(name)
        return memoryview(self.store.serialize_cdr(_fitted(self.store, kind, message), kind))


def long_name(name: str) -> str:
    """Return the full name of a type: `sensor_msgs/msg/Imu` of `sensor_msgs/Imu`."""
    package, *_, kind = name.split("/")
    return f"{package}/msg/{kind}"


class _MessageClass:
    """Makes messages of one type. Its constants are attributes."""

    def __init__(self, store: Any, name: str) -> None:
        self._store, self._name = store, name

    def __call__(self, **values: object) -> Any:
        fields = {
            field: values.pop(field) if field in values else _blank(self._store, described)
            for field, described in self._store.fielddefs[self._name][1]
        }
        return self._store.types[self._name](**fields, **values)

    def __getattr__(self, constant: str) -> Any:
        return getattr(self._store.types[self._name], constant)


def _blank(store: Any, described: Any) -> object:
    """Return what a field of a described type holds before anything is told."""
    kind, what = described
    if kind.name == "BASE":
        return _BLANK.get(what[0], 0)
    if kind.name == "NAME":
        return _MessageClass(store, what)()
    return [_blank(store, what[0]) for _ in range(what[1])] if kind.name == "ARRAY" else []


def _fitted(store: Any, name: str, message: Any) -> Any:
    """Return a message of rosbags with the fields of any object, as the serialiser wants them."""
    return store.types[name](**{
        field: _fitted_value(store, described, getattr(message, field))
        for field, described in store.fielddefs[name][1]
    })


def _fitted_value(store: Any, described: Any, value: Any) -> Any:
    kind, what = described
    if kind.name == "NAME":
        return _fitted(store, what, value)
    if kind.name == "BASE":
        return value[0] if isinstance(value, bytes) else value  # ROS has a byte so
    of, _ = what
    if of[0].name == "BASE" and of[1][0] not in ("string", "wstring"):
        return np.asarray(value, _NUMPY.get(of[1][0], of[1][0]))
    return [_fitted_value(store, of, one) for one in value]
