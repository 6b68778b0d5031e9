"""Lines of right ascension and declination as a camera sees them: no matplotlib in here."""

from dataclasses import dataclass

import numpy as np

from star_tracker.geometry.spherical import Floats, ra_dec, unit_vectors
from star_tracker.optics.camera import Camera

#: Steps between lines, degrees, and how many lines a field should have about.
_STEPS_DEG = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0)
_LINES = 5.5
_SAMPLES = 241
#: Beyond this from the boresight nothing is projected.
_FARTHEST_RAD = float(np.radians(80))


@dataclass(frozen=True)
class GridLine:
    """A line of the grid: its label, whether of right ascension, and its pixels (k, 2).

    Pixels outside of the image are NaN but for the one next to the border.
    """

    label: str
    is_ra: bool
    xy_px: Floats


def grid_lines(camera: Camera, rotation: Floats) -> list[GridLine]:
    """Return the lines in the image of a camera at a rotation (3, 3), camera to ICRS."""
    ra_deg, dec_deg = _extent_deg(camera, rotation)
    dec_step = _step_deg(float(np.ptp(dec_deg)))
    lines = []
    for dec in _multiples(dec_deg, dec_step):
        if abs(dec) < 90:
            low, high = _widened(ra_deg)
            along = np.linspace(low, high, _SAMPLES)
            path = _in_image(camera, rotation, along, np.full(_SAMPLES, dec))
            lines.append(GridLine(f"δ {degrees_text(dec, _decimals(dec_step), '+')}", False, path))
    ra_step = _step_deg(float(np.ptp(ra_deg)))
    # Near a pole all lines of right ascension come together: leave its surroundings free.
    low, high = np.clip(_widened(dec_deg), -90 + dec_step, 90 - dec_step)
    for ra in np.unique(np.round(_multiples(ra_deg, ra_step) % 360, 6)):
        path = _in_image(camera, rotation, np.full(_SAMPLES, ra), np.linspace(low, high, _SAMPLES))
        lines.append(GridLine(f"α {degrees_text(ra, _decimals(ra_step))}", True, path))
    return [line for line in lines if np.isfinite(line.xy_px).any()]


def _extent_deg(camera: Camera, rotation: Floats) -> tuple[Floats, Floats]:
    """Return the smallest and largest right ascension and declination in the image, degrees.

    Right ascensions are continuous, about that of the boresight: the first may be below 0.
    """
    x, y = np.meshgrid(
        np.linspace(0, camera.width_px, 25), np.linspace(0, camera.height_px, 25)
    )
    sky = camera.vectors(np.column_stack([x.ravel(), y.ravel()])) @ rotation.T
    ra, dec = np.degrees(ra_dec(sky))
    middle = float(np.degrees(ra_dec(rotation[:, 2])[0]))
    off = (ra - middle + 180) % 360 - 180
    ra_range = np.array([middle + off.min(), middle + off.max()])
    dec_range = np.array([dec.min(), dec.max()])
    for sign in (-1, 1):
        pole = sign * rotation[2]
        if pole[2] > 0 and camera.contains(camera.pixels(pole))[0]:
            ra_range = np.array([0.0, 360.0])
            dec_range[(sign + 1) // 2] = 90.0 * sign
    return ra_range, dec_range


def _step_deg(width_deg: float) -> float:
    steps = np.array(_STEPS_DEG)
    return float(steps[np.argmin(np.abs(np.log(width_deg / steps / _LINES)))])


def _multiples(range_deg: Floats, step_deg: float) -> Floats:
    low, high = range_deg / step_deg
    return np.asarray(np.arange(np.ceil(low - 1e-9), np.floor(high + 1e-9) + 1) * step_deg)


def _widened(range_deg: Floats) -> Floats:
    """Return a range with a margin, lest a line end within the image."""
    margin = 0.05 * np.ptp(range_deg)
    return np.asarray(range_deg + np.array([-margin, margin]))


def _in_image(camera: Camera, rotation: Floats, ra_deg: Floats, dec_deg: Floats) -> Floats:
    vectors = unit_vectors(np.radians(ra_deg), np.radians(dec_deg)) @ rotation
    path = np.full((len(vectors), 2), np.nan)
    ahead = vectors[:, 2] > np.cos(_FARTHEST_RAD)
    path[ahead] = camera.pixels(vectors[ahead])
    inside = camera.contains(path)
    near = inside.copy()
    near[1:] |= inside[:-1]
    near[:-1] |= inside[1:]
    path[~near] = np.nan
    return path


def _decimals(step_deg: float) -> int:
    return 0 if step_deg >= 1 else 1


def degrees_text(angle_deg: float, decimals: int, sign: str = "") -> str:
    """Return an angle as a picture has it; with sign `+` also in front of one above 0."""
    text = f"{angle_deg:{sign if angle_deg else ''}.{decimals}f}°"
    return text.replace("-", "−")
