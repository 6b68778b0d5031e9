"""Where stars seem to stand: aberration by the observer's velocity, refraction by the air.

Both move each star of a field by another amount. An attitude that was fitted to the catalogue's
directions is therefore wrong by the rotation that fits the stars' shifts best, and
`absorbed_rotation` fits just that, with the unknowns of the attitude's own fit.
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np
import scipy  # its parts are loaded where they are used: together they cost a second

from star_tracker.earth.rotation import load_erfa
from star_tracker.geometry.spherical import Floats

SPEED_OF_LIGHT_M_PER_S = 299792458.0
#: What the model of refraction is made for; below this altitude the air is not known well enough.
LOWEST_ALTITUDE_DEG = 5.0
PRESSURE_RANGE_HPA, TEMPERATURE_RANGE_C = (0.0, 1100.0), (-100.0, 60.0)
#: Each round leaves the square of the angle that was left: 0.01 rad, 1e-4, 1e-8.
_ROUNDS = 3
#: Below this part of the largest, a direction of the unknowns is not determined.
_LEAST_SINGULAR = 1e-9


@dataclass(frozen=True)
class Atmosphere:
    """The air at the camera. Raises ValueError for values out of range, naming them.

    Attributes:
        pressure_hpa: at the camera, not reduced to sea level; 0 = no air, no refraction.
        temperature_c: at the camera.
        relative_humidity: 0 to 1; in visible light it counts less than 0.2" above 30 degrees.
        wavelength_um: of the light that the camera sees most.
    """

    pressure_hpa: float = 0.0
    temperature_c: float = 10.0
    relative_humidity: float = 0.0
    wavelength_um: float = 0.55

    def __post_init__(self) -> None:
        for name, unit, (low, high) in (
            ("pressure_hpa", "hPa", PRESSURE_RANGE_HPA),
            ("temperature_c", "deg C", TEMPERATURE_RANGE_C),
            ("relative_humidity", "", (0.0, 1.0)),
            ("wavelength_um", "um", (0.1, 20.0)),
        ):
            value = getattr(self, name)
            if not (isfinite(value) and low <= value <= high):
                text = f"{name} is {value}: it must be from {low:g} to {high:g} {unit}"
                raise ValueError(text.rstrip())


def aberrated(vectors: Floats, velocity_m_per_s: Floats) -> Floats:
    """Return unit vectors (n, 3) as an observer with this velocity (3,) sees them.

    Exact in special relativity (Explanatory Supplement to the Astronomical Almanac 2013,
    eq. 7.40). Stars shift towards where the observer goes, by up to 20.5" for the Earth's motion.
    """
    beta = np.asarray(velocity_m_per_s, float) / SPEED_OF_LIGHT_M_PER_S
    of_rest = np.sqrt(1 - beta @ beta)
    along = vectors @ beta
    seen = of_rest * vectors + (1 + along / (1 + of_rest))[:, None] * beta
    return np.asarray(seen / (1 + along)[:, None])


def refracted(vectors: Floats, up: Floats, air: Atmosphere) -> Floats:
    """Return unit vectors (n, 3) as they are seen through the air, raised towards `up` (3,).

    The zenith distance seen, Z, is the true one less A tan Z + B tan^3 Z (`eraRefco`): within 0.1"
    of ray tracing down to 20 degrees of altitude and some arcseconds at 5. Raises ValueError for a
    direction below `LOWEST_ALTITUDE_DEG`.
    """
    if air.pressure_hpa == 0:
        return vectors
    a, b = load_erfa().refco(
        air.pressure_hpa, air.temperature_c, air.relative_humidity, air.wavelength_um
    )
    level = vectors - (vectors @ up)[:, None] * up
    sine = np.linalg.norm(level, axis=1)
    true = np.arctan2(sine, vectors @ up)
    lowest = 90 - np.degrees(np.max(true))
    if lowest < LOWEST_ALTITUDE_DEG:
        raise ValueError(
            f"a star stands {lowest:.1f} deg above the horizon: refraction is known down to "
            f"{LOWEST_ALTITUDE_DEG:g} deg; point the camera higher, or set pressure_hpa to 0 and "
            "bear the error"
        )
    z = true
    for _ in range(10):  # the slope of the refraction is below 0.02
        tangent = np.tan(z)
        z = true - a * tangent - b * tangent**3
    towards = level / np.maximum(sine, 1e-300)[:, None]
    return np.asarray(np.sin(z)[:, None] * towards + np.cos(z)[:, None] * up)


@dataclass(frozen=True)
class ScaleFit:
    """The focal length among the unknowns of an attitude's fit.

    A field that shrinks evenly towards the axis is then no rotation, as the fit took it for
    another focal length.

    Attributes:
        axis: (3,) the boresight, in the frame of the stars.
        prior: what was known of log f beforehand, in units of a star's weight; 0 = nothing.
    """

    axis: Floats
    prior: float = 0.0


def absorbed_rotation(
    vectors: Floats, apparent: Floats, scale_fit: ScaleFit | None = None
) -> Floats:
    """Return the rotation (3, 3) that best turns directions (n, 3) into apparent ones (n, 3).

    Least squares with equal weights, as the attitude itself is fitted. A single direction is
    turned along the great circle, without rotation about itself.

    Args:
        vectors: unit vectors of the catalogue.
        apparent: the same, as seen.
        scale_fit: where the attitude's fit had the focal length among its unknowns.
    """
    rotation, scale = np.eye(3), 0.0
    outward = np.zeros_like(vectors)
    if scale_fit is not None:
        cosine = (vectors @ scale_fit.axis)[:, None]
        outward = cosine * (cosine * vectors - scale_fit.axis)
    for _ in range(_ROUNDS):
        seen = (vectors + scale * outward) @ rotation.T
        seen /= np.linalg.norm(seen, axis=1, keepdims=True)
        # A rotation w moves v by w x v: the columns are the unit vectors crossed with v.
        columns = [np.cross(unit, seen).ravel() for unit in np.eye(3)]
        wanted = (apparent - seen).ravel()
        if scale_fit is not None:
            root = np.sqrt(scale_fit.prior)
            columns = [np.append(column, 0.0) for column in columns]
            columns.append(np.append((outward @ rotation.T).ravel(), root))
            wanted = np.append(wanted, -root * scale)
        step = np.linalg.lstsq(np.column_stack(columns), wanted, rcond=_LEAST_SINGULAR)[0]
        rotation = scipy.spatial.transform.Rotation.from_rotvec(step[:3]).as_matrix() @ rotation
        scale += float(step[3]) if scale_fit is not None else 0.0
    return rotation
