"""Rendered images of stars whose places and signal to noise are known."""

from dataclasses import replace

import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.detection.bound import signal_to_noise
from star_tracker.detection.render import render
from star_tracker.detection.render_settings import RenderSettings
from star_tracker.optics.camera import Camera

#: One electron is one unit of the image: what is read is what was drawn.
SENSOR = RenderSettings(bits=16, gain_e_per_dn=1.0, bias_dn=100.0, full_well_e=60_000.0)


def noise_e(asked):
    """Standard deviation of a pixel without stars."""
    sky = asked.sky_e_per_s * asked.exposure_s
    return np.sqrt(sky + asked.read_noise_e**2 + asked.gain_e_per_dn**2 / 12)


def electrons_of(signal, asked=SENSOR):
    """Charge of a star with its middle on a pixel's, of a signal to noise."""
    return np.asarray(signal) / signal_to_noise(asked.psf_sigma_px, 1.0, noise_e=noise_e(asked))


def draw(xy, signal, shape=(480, 640), **settings):
    """Render stars at (n, 2) with a signal to noise; settings as of `RenderSettings`."""
    asked = replace(SENSOR, **settings)
    xy = np.asarray(xy, float).reshape(-1, 2)
    camera = Camera.from_fov(12.0, shape[1], shape[0], parity="normal")
    electrons = np.broadcast_to(electrons_of(signal, asked), len(xy))
    v_mag = asked.zero_point_mag - 2.5 * np.log10(electrons / asked.exposure_s)
    none = np.zeros(len(xy), np.int64)
    catalog = StarCatalog(camera.vectors(xy), v_mag, none, none)
    return render(camera, np.eye(3), catalog, asked)


def spread(rng, shape=(480, 640), apart=64, jitter=8.0):
    """Places (n, 2) far from each other and from the border, anywhere within a pixel."""
    half = apart // 2
    grid = np.meshgrid(
        np.arange(half, shape[1] - half + 1, apart), np.arange(half, shape[0] - half + 1, apart)
    )
    xy = np.column_stack([axis.ravel() for axis in grid]).astype(float)
    return xy + rng.uniform(-jitter, jitter, xy.shape)


def nearest(found, xy):
    """Distance (n,) from each place to the nearest centroid, and that one's index."""
    if len(found) == 0:
        return np.full(len(xy), np.inf), np.zeros(len(xy), int)
    off = np.hypot(*np.moveaxis(found.xy_px[None] - np.asarray(xy)[:, None], 2, 0))
    return off.min(axis=1), off.argmin(axis=1)


def n_false(found, xy, within=3.0):
    """How many centroids are no star."""
    if len(found) == 0 or len(xy) == 0:
        return len(found)
    off = np.hypot(*np.moveaxis(found.xy_px[:, None] - np.asarray(xy)[None], 2, 0))
    return int(np.sum(off.min(axis=1) > within))
