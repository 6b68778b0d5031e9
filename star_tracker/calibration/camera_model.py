"""What frames tell of a camera: its parameters, what is believed of them, what they move.

The values of the parameters are an array (p,) in the order of `CameraModel.names`.
"""

from dataclasses import replace

import numpy as np

from star_tracker.geometry.spherical import Floats
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

#: What is always estimated: log of the focal length as a multiple of the first one, and the lens,
#: radial and tangential (Brown 1966).
PARAMETERS = ("log_focal_length", "k1", "k2", "p1", "p2")
#: And where that is asked for. The camera's frame is defined by the principal point: moved, it
#: turns the attitude of all frames by as much. Where it stays, a lens off the axis shows in the
#: tangential terms, as far as these can tell it.
CENTER = ("cx_px", "cy_px")
#: Standard deviations of the lens beforehand: of lenses without a calibration.
_LENS = (0.15, 0.1, 0.01, 0.01)
#: Of tangential terms that need not stand in for the principal point, as calibrations have them;
#: and of the principal point, as a part of the image's width.
_TANGENTIAL, _CENTER = 0.002, 0.03
#: Of a lens that is kept.
_NONE = 1e-9
#: Random walk a frame, of a lens that warms up or is touched: of the terms, of the principal point
#: in focal lengths.
_WALK = 1e-5
#: Lenses of one term each.
_TERMS = tuple(Distortion("plumb_bob", tuple(map(float, one))) for one in np.eye(5)[:4])
#: For derivatives.
_STEP = 1e-5


class CameraModel:
    """A camera as a function of the parameters that are estimated.

    Args:
        first: where the parameters begin, of definite parity. A lens of another model is kept.
        with_center: whether the principal point is one of them.

    Attributes:
        first: as given.
        names: of the parameters.
        start: their values (p,) for `first`.
    """

    def __init__(self, first: Camera, *, with_center: bool = False) -> None:
        self.first = first
        self.names = PARAMETERS + (CENTER if with_center else ())
        self._with_center = with_center
        given = first.distortion
        self._keeps_lens = given is not None and not _is_brown(given)
        self.start = self.values_of(first)

    def values_of(self, camera: Camera) -> Floats:
        """Return the values (p,) of the parameters of another camera of the same lens model."""
        lens = (0.0,) * len(_LENS)
        if camera.distortion is not None and _is_brown(camera.distortion):
            lens = camera.distortion.coefficients[:4]
        scale = np.log(camera.focal_length_px / self.first.focal_length_px)
        center = (camera.cx_px, camera.cy_px) if self._with_center else ()
        return np.array([scale, *lens, *center])

    def deviations(self, tolerance: float) -> Floats:
        """Return the standard deviations (p,) beforehand, that of the log focal length given."""
        lens = (_NONE,) * len(_LENS) if self._keeps_lens else _LENS
        if not self._with_center:
            return np.array([tolerance, *lens])
        if not self._keeps_lens:
            lens = (*_LENS[:2], _TANGENTIAL, _TANGENTIAL)
        return np.array([tolerance, *lens, *(_CENTER * self.first.width_px,) * len(CENTER)])

    @property
    def walk(self) -> Floats:
        """Standard deviations (p,) of the change from a frame to the next."""
        center = (_WALK * self.first.focal_length_px,) * len(CENTER)
        return np.array([*(_WALK,) * len(PARAMETERS), *(center if self._with_center else ())])

    def camera(self, values: Floats) -> Camera:
        """Return the camera of some values of the parameters."""
        first, scale = self.first, float(np.exp(values[0]))
        lens, center = first.distortion, (first.cx_px, first.cy_px)
        if not self._keeps_lens:
            terms = tuple(float(value) for value in values[1:5])
            lens = Distortion("plumb_bob", (*terms, 0.0)) if any(terms) else None
        if self._with_center:
            center = float(values[5]), float(values[6])
        return replace(
            first, fx_px=first.fx_px * scale, fy_px=first.fy_px * scale, cx_px=center[0],
            cy_px=center[1], distortion=lens,
        )

    def moves(self, values: Floats, in_camera: Floats) -> tuple[Floats, Floats, Floats]:
        """Return where directions (n, 3) are seen (n, 2), px, and what moves that.

        A turn about the camera's axes (2 n, 3), px/rad, and the parameters (2 n, p).
        """
        camera = self.camera(values)
        at = camera.pixels(in_camera)
        of_pose = []
        for axis in np.eye(3):
            turned = camera.pixels(in_camera + _STEP * np.cross(axis, in_camera))
            of_pose.append(((turned - at) / _STEP).ravel())
        size = camera.fx_px, camera.fy_px
        of_camera = [at - (camera.cx_px, camera.cy_px), *self._of_terms(in_camera, size)]
        if self._with_center:
            of_camera.extend(np.broadcast_to(axis, at.shape) for axis in np.eye(2))
        return at, np.column_stack(of_pose), np.column_stack([one.ravel() for one in of_camera])

    def _of_terms(self, in_camera: Floats, size_px: tuple[float, float]) -> list[Floats]:
        """Return what each term of the lens moves (n, 2): they enter linearly."""
        points = in_camera[:, :2] / in_camera[:, 2:]
        if self._keeps_lens:
            return [np.zeros_like(points) for _ in _TERMS]
        if self.first.parity == "mirrored":
            points[:, 1] *= -1
        return [(term.distort(points) - points) * size_px for term in _TERMS]


def _is_brown(lens: Distortion) -> bool:
    """Return whether a lens is described by the terms that are estimated."""
    return lens.model == "plumb_bob" and lens.coefficients[4] == 0
