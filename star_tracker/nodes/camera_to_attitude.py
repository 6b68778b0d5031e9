"""camera_to_attitude: centroid_node and identify_node in one process.

Both stand in the graph under their own names, with all of their topics and parameters. The
centroids are handed over as they are: `centroids` is published for others, and not read back.
"""

import sys
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node

from star_tracker.nodes.centroid_node import CentroidNode
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.running import run


def make_nodes(**node_options: Any) -> list[Node]:
    """Return both nodes, the one that hands over first; one executor has to spin them.

    Raises ParameterError for a configuration that cannot be used.
    """
    identify = IdentifyNode(listens=False, **node_options)
    try:
        return [CentroidNode(hand_over=identify.take, **node_options), identify]
    except ValueError:
        identify.destroy_node()
        raise


def main(args: Sequence[str] | None = None) -> int:
    """Run both nodes; return the exit code."""
    return run("camera_to_attitude", make_nodes, args)


if __name__ == "__main__":
    sys.exit(main())
