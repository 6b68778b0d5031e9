"""relay_node: detections of other types in, `centroids` out."""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from sensor_msgs.msg import PointCloud2

from star_tracker.msg_adapters.centroids import (
    Centroids,
    centroids_from_detections,
    centroids_from_polygon,
    centroids_from_poses,
)
from star_tracker.msg_adapters.point_cloud import cloud_from_centroids
from star_tracker.nodes.declaring import (
    DeclaringNode,
    ParameterError,
    declare,
    parameter,
    parameters_of,
    unknown_parameters,
)
from star_tracker.nodes.listening import PUBLISHED, overrides_checked, subscribe
from star_tracker.nodes.running import run

#: How the centroids are read out of each type of message.
READERS: dict[str, Callable[[Any], Centroids]] = {
    "vision_msgs/Detection2DArray": centroids_from_detections,
    "geometry_msgs/PolygonStamped": centroids_from_polygon,
    "geometry_msgs/PoseArray": centroids_from_poses,
}


@dataclass(frozen=True)
class RelayParameters:
    """What relay_node is told."""

    message_type: str = parameter(
        "vision_msgs/Detection2DArray", "type of the messages on detections",
        choices=tuple(READERS), fixed=True,
    )
    queue_depth: int = parameter(
        10, "messages that wait at most; the oldest ones are dropped", allowed=(1, 1000),
        fixed=True,
    )


RELAY_PARAMETERS = parameters_of(RelayParameters)


class RelayNode(DeclaringNode):
    """Publishes the centroids of each message of `detections` under the message's own header.

    Raises ParameterError for a configuration that cannot be used.
    """

    def __init__(self, **node_options: Any) -> None:
        super().__init__(
            "relay_node", automatically_declare_parameters_from_overrides=True, **node_options
        )
        try:
            p, given = declare(self, RelayParameters)
            kind = _message_class(p.message_type)
            with overrides_checked():
                self._centroids = self.create_publisher(
                    PointCloud2, "centroids", p.queue_depth, qos_overriding_options=PUBLISHED
                )
                subscribe(self, kind, "detections", p.queue_depth, self._on_message)
        except ParameterError:
            self.destroy_node()
            raise
        self._read = READERS[p.message_type]
        for sentence in unknown_parameters(self, given):
            self.get_logger().warning(sentence)
        self.get_logger().info(
            f"{p.message_type} on {self.resolve_topic_name('detections')} become centroids on "
            f"{self._centroids.topic_name}"
        )

    def _on_message(self, message: Any, _: Mapping[str, Any]) -> None:
        self._centroids.publish(cloud_from_centroids(self._read(message), message.header))


def _message_class(name: str) -> Any:
    """Return the class of a type of messages. Raises ParameterError where it is not installed."""
    package, kind = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), kind)
    except ImportError as error:
        raise ParameterError(
            f"message_type {name} needs {package}, which cannot be imported ({error}): "
            f"install ros-jazzy-{package.replace('_', '-')}"
        ) from error


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return run("relay_node", RelayNode, args)


if __name__ == "__main__":
    sys.exit(main())
