"""A night of a camera that is fixed to the ground, six hours of it: what it would see."""

from datetime import datetime, timezone

import numpy as np
from scipy.spatial.transform import Rotation

from star_tracker.earth.apparent import Atmosphere, aberrated, refracted
from star_tracker.earth.rotation import (
    EarthOrientation,
    earth_velocity_m_per_s,
    itrs_from_gcrs,
)
from star_tracker.earth.site import Site
from star_tracker.optics.camera import Camera

START_NS = int(datetime(2024, 11, 2, 18, tzinfo=timezone.utc).timestamp()) * 10**9
HOURS = 6
SITE = Site(47.3, 8.5, 500.0)
ORIENTATION = EarthOrientation(0.05, 0.15, 0.3)
AIR = Atmosphere(955.0, 8.0)
#: Of 35" pixels. With less noise, what refraction does unevenly across the field shows in the
#: residuals, and the covariance is larger than chance alone would have it.
SIGMA_PX = 0.3
CAMERA = Camera.from_fov(20.0, 2048, 2048)
#: The camera's axes in ENU: it looks 55 deg up, towards azimuth 140 deg, turned by 25 deg.
POSE = (
    Rotation.from_euler("z", -140, degrees=True)  # x right of the view, y its direction
    * Rotation.from_euler("x", 55, degrees=True)
    * Rotation.from_matrix(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))  # REP-103, optical
    * Rotation.from_euler("z", 25, degrees=True)
).as_matrix()


def seen_at(stamp_ns, catalog):
    """Return the directions (n, 3) of all stars, ENU, as the camera would see them."""
    to_itrs = itrs_from_gcrs(stamp_ns, ORIENTATION)
    ground = to_itrs.T @ SITE.velocity_itrs_m_per_s
    seen = aberrated(catalog.vectors, earth_velocity_m_per_s(stamp_ns) + ground)
    to_enu = SITE.enu_from_itrs @ to_itrs
    high = seen[seen @ to_enu[2] > 0.2]
    return refracted(high, to_enu[2], AIR) @ to_enu.T


def centroids_at(stamp_ns, catalog, rng):
    """Return the noisy centroids (n, 2) of a frame, pixels, in no order."""
    in_camera = seen_at(stamp_ns, catalog) @ POSE
    in_camera = in_camera[in_camera[:, 2] > 0.5]
    xy = CAMERA.focal_length_px * in_camera[:, :2] / in_camera[:, 2:] + 1024
    xy = xy[np.all((xy > 0) & (xy < 2048), axis=1)]
    return xy + rng.normal(scale=SIGMA_PX, size=xy.shape)
