"""Identified stars and the field of view -> MarkerArray, on a sphere of 1 m around the camera.

The markers stand in the reference frame with the camera at its origin. Their colours and sizes are
for a view from within a few metres, as RViz and Foxglove open with.
"""

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution

_STAR_M, _LABEL_M, _LINE_M = 0.004, 0.01, 0.001
_STAR = ColorRGBA(r=1.0, g=0.9, b=0.4, a=1.0)
_LABEL = ColorRGBA(r=0.8, g=0.8, b=0.8, a=1.0)
_LINE = ColorRGBA(r=0.2, g=0.7, b=1.0, a=1.0)
#: Points of each side of the field of view: a lens bends them.
_SIDE = 9


def markers_from_solution(
    solution: Solution, camera: Camera, catalog: StarCatalog, header: Header
) -> MarkerArray:
    """Draw a solved frame; of an unsolved one only the order to remove what was drawn before."""
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
        label.text = star_name(catalog, int(star))
        markers.append(label)
    outline = _marker(header, "field_of_view", Marker.LINE_STRIP, _LINE)
    outline.scale.x = _LINE_M
    border = camera.with_parity(solution.parity).vectors(_border(camera))
    outline.points = [_point(vector) for vector in border @ solution.attitude.rotation.T]
    markers.append(outline)
    return MarkerArray(markers=markers)


def star_name(catalog: StarCatalog, index: int) -> str:
    """Return the Hipparcos number where a star has one, else its number in the catalogue."""
    hip = int(catalog.hip[index])
    return f"HIP {hip}" if hip > 0 else f"star {int(catalog.number[index])}"


def _marker(header: Header, namespace: str, kind: int, colour: ColorRGBA) -> Marker:
    marker = Marker(header=header, ns=namespace, type=int(kind), action=Marker.ADD, color=colour)
    marker.pose.orientation.w = 1.0
    return marker


def _border(camera: Camera) -> Floats:
    """Return pixels (n, 2) around the image; the last is the first again."""
    along = np.linspace(0.0, 1.0, _SIDE)[:-1]
    back, none = 1 - along, np.zeros_like(along)
    unit = np.concatenate([
        np.column_stack([along, none]), np.column_stack([none + 1, along]),
        np.column_stack([back, none + 1]), np.column_stack([none, back]), [[0.0, 0.0]],
    ])
    return unit * (camera.width_px, camera.height_px)


def _point(vector: Floats) -> Point:
    x, y, z = (float(value) for value in vector)
    return Point(x=x, y=y, z=z)
