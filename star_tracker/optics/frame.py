"""A frame: the usable centroids of one image as directions, for compiled code."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.compiled import compiled, inlined, struct
from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import in_image, plane_of_pixel

#: A centroid farther outside of the image than this (in image sizes) cannot have come from it:
#: noise may push some over its edge. With distortion it is 1 px, as nothing is known of the lens
#: any farther: the half pixel that is outside where pixels are counted from the first one's
#: centre, and as much for noise.
_OUTSIDE_MARGIN, _LENS_MARGIN_PX = 0.05, 1.0
#: Two stars closer than 15 px have no good position angle; squared.
_CLOSEST_PX2 = 225.0
#: Strips of an image in which centroids are looked up.
COLUMNS = 64
#: So few centroids are compared all with all.
_FEW = 96
#: Square of a distance that there is not, px^2.
_FAR = 1e30

#: The usable centroids, from left to right, in arrays with room for `len(row)` of them:
#:
#: - n: how many centroids are usable, which may be more than there is room for;
#: - vectors: (room, 3) unit vectors in the optical frame, for a focal length that is `scale` times
#:   the camera's own;
#: - plane_px: (room, 2) undistorted image coordinates about the principal point, px, y down;
#:   plane_px[:n, 0] ascends;
#: - row: (room,) index of the centroid in the input;
#: - mains: (room,) indices in the order in which stars are tried as main star;
#: - column: (`COLUMNS` + 1,) the first centroid of each of as many strips of the image, which all
#:   are as wide as `strip_px`, from the leftmost centroid on;
#: - intensity: (room,) larger = brighter, on any linear scale, 0 = not known;
#: - magnitude, usual: (room,) the same as instrumental magnitudes, NaN = not known, and how usual
#:   each of them is; both once `usual_is_known` (`identification/brightness.py`);
#: - has_brightness: whether intensities were given;
#: - points, input_row, key, near: room for sorting.
FrameType, Frame = struct("Frame", __name__, (
    "n", "vectors", "scale", "plane_px", "row", "mains", "column", "strip_px", "intensity",
    "magnitude", "usual", "usual_is_known", "has_brightness", "points", "input_row", "key", "near",
))


@compiled
def empty_frame(vectors: Floats) -> Any:
    """Return a frame without centroids, with room for as many as `vectors` (room, 3) has."""
    room = len(vectors)
    return Frame(
        0, vectors, 1.0, np.empty((room, 2)), np.empty(room, np.int64),
        np.empty(room, np.int64), np.zeros(COLUMNS + 1, np.int64), 1.0, np.empty(room),
        np.empty(room), np.empty(room), False, False,
        np.empty((room, 2)), np.empty(room, np.int64), np.empty(room), np.empty((5, room)),
    )


@compiled
def fill_frame(frame: Any, optics: Floats, xy_px: Floats, intensity: Floats) -> None:
    """Take in centroids (m, 2), pixels, and intensities (m,), or (0,) where there are none.

    Centroids that are not finite, outside of the image or without a ray of the lens are left out;
    so are those beyond the room that there is.
    """
    frame.n = _take_usable(frame, optics, xy_px)
    frame.has_brightness, frame.usual_is_known, frame.scale = len(intensity) > 0, False, 1.0
    n, vectors, plane_px, row = frame.n, frame.vectors, frame.plane_px, frame.row
    ascending(row, frame.key, n)
    focal_px = np.sqrt(optics[2] * optics[3])
    points, input_row = frame.points, frame.input_row
    for i in range(n):
        x, y = points[row[i], 0], points[row[i], 1]
        scale = 1.0 / np.sqrt(1.0 + x * x + y * y)
        vectors[i, 0], vectors[i, 1], vectors[i, 2] = x * scale, y * scale, scale
        plane_px[i, 0], plane_px[i, 1] = x * focal_px, y * focal_px
        row[i] = input_row[row[i]]
    _lay_strips(frame)
    if frame.has_brightness:
        for i in range(n):
            value = intensity[row[i]]
            frame.intensity[i] = value if 0.0 < value < np.inf else 0.0
    _order_mains(frame)


@compiled
def see_at_scale(frame: Any, focal_px: float, scale: float) -> None:
    """Give the directions for a focal length of `scale` times `focal_px`, the camera's own."""
    if frame.scale == scale:
        return
    frame.scale = scale
    vectors, plane_px, inverse = frame.vectors, frame.plane_px, 1.0 / (focal_px * scale)
    for i in range(frame.n):
        x, y = plane_px[i, 0] * inverse, plane_px[i, 1] * inverse
        z = 1.0 / np.sqrt(1.0 + x * x + y * y)
        vectors[i, 0], vectors[i, 1], vectors[i, 2] = x * z, y * z, z


@compiled
def _take_usable(frame: Any, optics: Floats, xy_px: Floats) -> int:
    """Write the usable centroids' normalised coordinates and rows; return their number."""
    points, input_row, key = frame.points, frame.input_row, frame.key
    margin = _OUTSIDE_MARGIN * max(optics[0], optics[1])
    if optics[7] != 0.0:
        margin = _LENS_MARGIN_PX
    n = 0
    for i in range(len(xy_px)):
        if n == len(input_row):
            break
        if in_image(optics, xy_px[i, 0], xy_px[i, 1], margin):
            x, y, exists = plane_of_pixel(optics, xy_px[i, 0], xy_px[i, 1])
            if exists:
                points[n, 0], points[n, 1] = x, y
                input_row[n], key[n] = i, x
                n += 1
    return n


@compiled
def _lay_strips(frame: Any) -> None:
    """Note where each strip of the image begins among the centroids."""
    n, plane_px, column = frame.n, frame.plane_px, frame.column
    if n == 0:
        return
    frame.strip_px = max((plane_px[n - 1, 0] - plane_px[0, 0]) / COLUMNS, 1e-9)
    at = 0
    for i in range(n):
        strip = min(int((plane_px[i, 0] - plane_px[0, 0]) / frame.strip_px), COLUMNS - 1)
        while at <= strip:
            column[at] = i
            at += 1
    while at <= COLUMNS:
        column[at] = n
        at += 1


@inlined
def first_right_of(frame: Any, x_px: float) -> int:
    """Return the first centroid whose undistorted x is not below `x_px`, n for none."""
    n, plane_px = frame.n, frame.plane_px
    strip = (x_px - plane_px[0, 0]) / frame.strip_px
    at = frame.column[int(min(max(strip, 0.0), float(COLUMNS)))]
    while at > 0 and plane_px[at - 1, 0] >= x_px:  # rounding may have put it a strip too far
        at -= 1
    while at < n and plane_px[at, 0] < x_px:
        at += 1
    return at


@compiled
def _order_mains(frame: Any) -> None:
    """Order the stars with the nearest companions first, bright ones before faint ones.

    Close pairs have the fewest look-alikes in the catalogue, so that they are compared fastest.
    Those too close for a good position angle count as if they were farther. Bright stars are less
    likely to be false.
    """
    n, intensity, key = frame.n, frame.intensity, frame.key
    if n <= _FEW:
        _reach_of_few(frame)
    else:
        _reach_of_many(frame)
    if frame.has_brightness:
        for i in range(n):
            brighter = 0
            for j in range(n):
                brighter += intensity[j] > intensity[i]
            key[i] *= 1.0 + brighter / n
    ascending(frame.mains, key, n)


@compiled
def _reach_of_few(frame: Any) -> None:
    """Write the sum of the distances of each star's three nearest to `key`, px.

    All stars are compared with all, without a branch and several at a time.
    """
    n, plane_px, near = frame.n, frame.plane_px, frame.near
    x, y, first, second, third = near[0], near[1], near[2], near[3], near[4]
    for i in range(n):
        x[i], y[i] = plane_px[i, 0], plane_px[i, 1]
        first[i] = second[i] = third[i] = _FAR
    for j in range(n):
        x0, y0 = x[j], y[j]
        for i in range(n):
            d = (x0 - x[i]) ** 2 + (y0 - y[i]) ** 2
            d = _CLOSEST_PX2 if d < _CLOSEST_PX2 else d
            d = _FAR if i == j else d
            d1, d2, d3 = first[i], second[i], third[i]
            first[i] = d if d < d1 else d1
            d = d if d > d1 else d1
            second[i] = d if d < d2 else d2
            d = d if d > d2 else d2
            third[i] = d if d < d3 else d3
    for i in range(n):
        frame.key[i] = np.sqrt(first[i]) + np.sqrt(second[i]) + np.sqrt(third[i])


@compiled
def _reach_of_many(frame: Any) -> None:
    """Write the same as `_reach_of_few`, from each star outwards, no farther than need be."""
    n, plane_px = frame.n, frame.plane_px
    for i in range(n):
        d1 = d2 = d3 = _FAR
        for direction in (-1, 1):
            j = i + direction
            while 0 <= j < n:
                dx, dy = plane_px[j, 0] - plane_px[i, 0], plane_px[j, 1] - plane_px[i, 1]
                if dx * dx >= d3 or d3 <= _CLOSEST_PX2:  # no other one can be nearer
                    break
                d = max(dx * dx + dy * dy, _CLOSEST_PX2)
                if d < d1:
                    d1, d2, d3 = d, d1, d2
                elif d < d2:
                    d2, d3 = d, d2
                elif d < d3:
                    d3 = d
                j += direction
        frame.key[i] = np.sqrt(d1) + np.sqrt(d2) + np.sqrt(d3)


@compiled
def ascending(values: NDArray[np.int64], key: Floats, n: int) -> None:
    """Write the places of the first `n` keys to `values`, in ascending order of the keys.

    Those of few are counted, without a branch: how many are smaller. Many are sorted, keys and all
    (Shell 1959; gaps of Ciura 2001).
    """
    if n <= _FEW:
        for i in range(n):
            own, rank = key[i], 0
            for j in range(i):
                rank += key[j] <= own
            for j in range(i + 1, n):
                rank += key[j] < own
            values[rank] = i
        return
    for i in range(n):
        values[i] = i
    for gap in (701, 301, 132, 57, 23, 10, 4, 1):
        for i in range(gap, n):
            value, k, at = values[i], key[i], i
            while at >= gap and key[at - gap] > k:
                values[at], key[at] = values[at - gap], key[at - gap]
                at -= gap
            values[at], key[at] = value, k
