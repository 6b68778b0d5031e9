"""Identified stars and the field of view -> MarkerArray, on a sphere of 1 m around the camera.

The markers stand in the reference frame with the camera at its origin. Their colours and sizes are
for a view from within a few metres, as RViz and Foxglove open with.
"""

from typing import TYPE_CHECKING

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution

if TYPE_CHECKING:
    import geometry_msgs.msg
    import std_msgs.msg
    import visualization_msgs.msg

_STAR_M, _LABEL_M, _LINE_M = 0.004, 0.01, 0.001
_STAR, _LABEL, _LINE = (1.0, 0.9, 0.4), (0.8, 0.8, 0.8), (0.2, 0.7, 1.0)  # red, green, blue


def markers_from_solution(
    solution: Solution, camera: Camera, catalog: StarCatalog, header: "std_msgs.msg.Header"
) -> "visualization_msgs.msg.MarkerArray":
    """Draw a solved frame; of an unsolved one only the order to remove what was drawn before."""
    from visualization_msgs.msg import Marker, MarkerArray

    markers = [Marker(header=header, action=Marker.DELETEALL)]
    if solution.attitude is None:
        return MarkerArray(markers=markers)
    index = solution.identification.catalog_index
    index = index[index >= 0]
    vectors = catalog.vectors[index]
    stars = _marker(header, "stars", Marker.POINTS, _STAR)
    stars.scale.x = stars.scale.y = _STAR_M
    stars.points = [_point(vector) for vector in vectors]
    markers.append(stars)
    for i, (star, vector) in enumerate(zip(index, vectors, strict=True)):
        label = _marker(header, "labels", Marker.TEXT_VIEW_FACING, _LABEL)
        label.id = i
        label.scale.z = _LABEL_M
        label.pose.position = _point(vector)
        label.text = catalog.name(int(star))
        markers.append(label)
    outline = _marker(header, "field_of_view", Marker.LINE_STRIP, _LINE)
    outline.scale.x = _LINE_M
    border = camera.with_parity(solution.parity).outline
    outline.points = [_point(vector) for vector in border @ solution.attitude.rotation.T]
    markers.append(outline)
    return MarkerArray(markers=markers)


def _marker(
    header: "std_msgs.msg.Header", namespace: str, kind: int, colour: tuple[float, float, float]
) -> "visualization_msgs.msg.Marker":
    from std_msgs.msg import ColorRGBA
    from visualization_msgs.msg import Marker

    red, green, blue = colour
    marker = Marker(header=header, ns=namespace, type=int(kind), action=Marker.ADD)
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    marker.pose.orientation.w = 1.0
    return marker


def _point(vector: Floats) -> "geometry_msgs.msg.Point":
    from geometry_msgs.msg import Point

    x, y, z = (float(value) for value in vector)
    return Point(x=x, y=y, z=z)
