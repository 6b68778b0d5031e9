"""Lines of right ascension and declination as a camera sees them: no matplotlib in here."""

from dataclasses import dataclass

import numpy as np
from contourpy import contour_generator  # matplotlib needs it, too

from star_tracker.geometry.spherical import Floats, ra_dec
from star_tracker.optics.camera import Camera

#: Steps between lines, degrees, and how many lines a field should have about.
_STEPS_DEG = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
_LINES = 5.5
#: Points of the image along x and along y between which a line is straight.
_SAMPLES = 121


@dataclass(frozen=True)
class GridLine:
    """A line of the grid.

    Attributes:
        label: what it is called.
        is_ra: whether it is one of right ascension.
        paths: its parts (k, 2), px, each closed or from border to border of the image.
    """

    label: str
    is_ra: bool
    paths: list[Floats]


def grid_lines(camera: Camera, rotation: Floats) -> list[GridLine]:
    """Return the lines in the image of a camera at a rotation (3, 3), camera to ICRS.

    Where the lens has no ray, as in the corners of some, there are none.
    """
    x = np.linspace(0, camera.width_px, _SAMPLES)
    y = np.linspace(0, camera.height_px, _SAMPLES)
    ra, dec = _sky_deg(camera, rotation, x, y)
    middle = float(np.degrees(ra_dec(rotation[:, 2])[0]))
    around = middle + (ra - middle + 180) % 360 - 180  # continuous, but opposite of the boresight
    ra_step, dec_step = _step_deg(float(np.ptp(around))), _step_deg(float(np.ptp(dec)))
    lines = [
        GridLine(f"δ {_text(level, dec_step, '+')}", False, _zeros(x, y, dec - level))
        for level in _multiples(dec, dec_step)
    ]
    for level in np.unique(np.round(_multiples(around, ra_step) % 360, 6)):
        turn = np.radians(ra - level)
        # Near a pole all lines of right ascension come together: leave its surroundings free.
        hidden = (np.abs(dec) > 90 - dec_step) | (np.cos(turn) < 0)
        paths = _zeros(x, y, np.ma.masked_where(hidden, np.sin(turn)))
        lines.append(GridLine(f"α {_text(level, ra_step)}", True, paths))
    return [line for line in lines if line.paths]


def _sky_deg(
    camera: Camera, rotation: Floats, x: Floats, y: Floats
) -> tuple[Floats, Floats]:
    """Return right ascension and declination (len(y), len(x)) of pixels, masked without a ray."""
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    shown = camera.has_ray(points)
    sky = np.tile(rotation[:, 2], (len(points), 1))  # something finite under the mask
    sky[shown] = camera.vectors(points[shown]) @ rotation.T
    shape = len(y), len(x)
    ra, dec = (
        np.ma.masked_array(np.degrees(angle).reshape(shape), ~shown.reshape(shape))
        for angle in ra_dec(sky)
    )
    return ra, dec


def _zeros(x: Floats, y: Floats, values: Floats) -> list[Floats]:
    """Return the lines along which values (len(y), len(x)), some of them masked, are 0."""
    return [np.asarray(line, float) for line in contour_generator(x, y, values).lines(0.0)]


def _step_deg(width_deg: float) -> float:
    steps = np.array(_STEPS_DEG)
    return float(steps[np.argmin(np.abs(np.log(width_deg / steps / _LINES)))])


def _multiples(angles_deg: Floats, step_deg: float) -> Floats:
    first, last = np.ceil(np.min(angles_deg) / step_deg), np.floor(np.max(angles_deg) / step_deg)
    return np.asarray(np.arange(first, last + 1) * step_deg)


def _text(angle_deg: float, step_deg: float, sign: str = "") -> str:
    return degrees_text(angle_deg, 0 if step_deg >= 1 else 1, sign)


def degrees_text(angle_deg: float, decimals: int, sign: str = "") -> str:
    """Return an angle as a picture has it; with sign `+` also in front of one above 0."""
    text = f"{angle_deg:{sign if angle_deg else ''}.{decimals}f}°"
    return text.replace("-", "−")
