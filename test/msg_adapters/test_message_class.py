"""The classes of messages that adapters write."""

from types import SimpleNamespace

import pytest
from geometry_msgs.msg import Vector3Stamped

from star_tracker.msg_adapters.message_class import classes_from, message_class


def test_the_classes_are_those_of_ros():
    assert message_class("geometry_msgs/Vector3Stamped") is Vector3Stamped


def test_others_hold_as_long_as_they_are_asked_for():
    with classes_from(lambda name: lambda **values: SimpleNamespace(name=name, **values)):
        made = message_class("geometry_msgs/Vector3Stamped")(header=1)
    assert (made.name, made.header) == ("geometry_msgs/Vector3Stamped", 1)
    assert message_class("geometry_msgs/Vector3Stamped") is Vector3Stamped


def test_ros_holds_again_after_an_error():
    with pytest.raises(RuntimeError, match="no"), classes_from(lambda _: None):
        raise RuntimeError("no")
    assert message_class("geometry_msgs/Vector3Stamped") is Vector3Stamped


def test_a_type_that_ros_lacks_is_an_import_error():
    with pytest.raises(ImportError):
        message_class("no_msgs/Nothing")
