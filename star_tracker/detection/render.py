"""A catalogue, an attitude and a camera -> the image that the camera would take."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, zoom
from scipy.spatial.transform import Rotation

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.compiled import compiled
from star_tracker.detection.image import MAX_PIXELS
from star_tracker.detection.psf import Psf, round_shape
from star_tracker.detection.render_settings import RenderedImage, RenderSettings
from star_tracker.geometry.spherical import Floats, unit_vectors
from star_tracker.optics.camera import Camera

#: Half of a star's window, in widths: what is left out is below the noise of any sensor.
_REACH_SIGMAS = 6.0
#: A moving star is drawn with steps of so many widths: smooth to 0.1 %.
_STEP_SIGMAS = 0.5
#: Stars so many widths outside of the image still shine into it.
_MARGIN_SIGMAS = 5.0
#: Clouds are computed on a grid this much finer than a cloud, and so many of their own standard
#: deviations below the thickest the sky is clear.
_CLOUD_CELLS, _CLOUD_SIGMAS = 4.0, 2.0
#: Charge that overflows runs so far at the most, in rows.
_MOST_ROWS = 10_000


def render(
    camera: Camera,
    rotation: Floats,
    catalog: StarCatalog,
    settings: RenderSettings | None = None,
) -> RenderedImage:
    """Return the image of the sky at a rotation (3, 3), camera to ICRS.

    Stars are Gaussians summed over pixels. All light has shot noise. The camera's distortion and
    parity hold; its parity must be definite. Raises ValueError for parity `auto`, and for an image
    larger than those that stars are looked for in.
    """
    check_size(camera)
    asked = settings or RenderSettings()
    rng = np.random.default_rng(asked.seed)
    shape = (camera.height_px, camera.width_px)
    vectors, v_mag, index = _lights(camera, rotation, catalog, asked)
    paths = _paths(camera, rotation, vectors, asked)
    xy = paths[:, paths.shape[1] // 2]
    electrons = asked.electrons(v_mag)
    clouds = _clouds(shape, asked, rng)
    if clouds is not None:
        at = np.clip(xy.astype(int), 0, (shape[1] - 1, shape[0] - 1))
        electrons = electrons * 10 ** (-0.4 * clouds[at[:, 1], at[:, 0]])
    light = np.zeros(shape)
    _draw(light, paths, electrons / paths.shape[1], asked.psf_sigma_px)
    light += _sky(shape, asked)
    if asked.bayer:
        for k, letter in enumerate(asked.bayer):
            light[k // 2 :: 2, k % 2 :: 2] *= asked.bayer_response["rgb".index(letter)]
    return RenderedImage(_read_out(light, asked, rng), xy, index, electrons, rotation)


def check_size(camera: Camera) -> None:
    """Raise ValueError where an image would have too many pixels."""
    if camera.width_px * camera.height_px > MAX_PIXELS:
        raise ValueError(
            f"an image of {camera.width_px} x {camera.height_px} px has more than "
            f"{MAX_PIXELS // 1_000_000} million pixels: make it smaller"
        )


def _lights(
    camera: Camera, rotation: Floats, catalog: StarCatalog, asked: RenderSettings
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return directions (n, 3), magnitudes and catalogue indices of what shines into the image."""
    planets = asked.planets
    where = np.radians([(p.ra_deg, p.dec_deg) for p in planets]).reshape(-1, 2)
    vectors = np.vstack([catalog.vectors, unit_vectors(where[:, 0], where[:, 1])])
    v_mag = np.concatenate([catalog.v_mag, [p.v_mag for p in planets]])
    index = np.concatenate([np.arange(len(catalog)), np.full(len(planets), -1)])
    # A star may enter the image while the camera turns.
    margin_px = _MARGIN_SIGMAS * asked.psf_sigma_px + _motion_px(camera, asked)
    margin = margin_px / camera.focal_length_px
    near = np.flatnonzero(vectors @ rotation[:, 2] > math.cos(
        min(camera.radius_rad + margin, math.radians(89.0))
    ))
    inside = near[camera.contains(camera.pixels(vectors[near] @ rotation), margin_px)]
    return vectors[inside], v_mag[inside], index[inside].astype(np.int64)


def _motion_px(camera: Camera, asked: RenderSettings) -> float:
    """Return how far a star moves at the most during the exposure."""
    x, y, z = np.radians(asked.rate_deg_s) * asked.exposure_s
    diagonal = math.hypot(camera.width_px, camera.height_px) / 2
    return float(math.hypot(x, y) * camera.focal_length_px + abs(z) * diagonal)


def _paths(camera: Camera, rotation: Floats, vectors: Floats, asked: RenderSettings) -> Floats:
    """Return where each star is at an odd number of moments of the exposure, (n, m, 2)."""
    half = math.ceil(_motion_px(camera, asked) / (2 * _STEP_SIGMAS * asked.psf_sigma_px))
    moments = np.arange(-half, half + 1) / (2 * half + 1) * asked.exposure_s
    turned = [
        rotation @ Rotation.from_rotvec(np.radians(asked.rate_deg_s) * moment).as_matrix()
        for moment in moments
    ]
    return np.stack([camera.pixels(vectors @ one) for one in turned], axis=1)


@compiled
def _draw(light: Floats, paths: Floats, electrons: Floats, sigma_px: float) -> None:
    """Add to the light (h, w) what stars give at each moment of their paths (n, m, 2)."""
    height, width = light.shape
    reach = math.ceil(_REACH_SIGMAS * sigma_px + 0.5)
    shape = np.empty((4, 2 * reach + 1, 2 * reach + 1))
    psf = Psf(sigma_px, 0.0, 0.0)
    for star in range(paths.shape[0]):
        for moment in range(paths.shape[1]):
            x, y = paths[star, moment]
            left, top = math.floor(x) - reach, math.floor(y) - reach
            round_shape(psf, x, y, (left, top), shape)
            for i in range(max(0, -top), min(2 * reach + 1, height - top)):
                for j in range(max(0, -left), min(2 * reach + 1, width - left)):
                    light[top + i, left + j] += electrons[star] * shape[0, i, j]


def _sky(shape: tuple[int, int], asked: RenderSettings) -> Floats:
    """Return the background (h, w), electrons."""
    height, width = shape
    across = asked.sky_gradient[0] * ((np.arange(width) + 0.5) / width - 0.5)
    down = asked.sky_gradient[1] * ((np.arange(height) + 0.5) / height - 0.5)
    level = asked.sky_e_per_s * asked.exposure_s
    return np.maximum(level * (1 + across[None, :] + down[:, None]), 0.0)


def _clouds(
    shape: tuple[int, int], asked: RenderSettings, rng: np.random.Generator
) -> Floats | None:
    """Return the extinction (h, w), magnitudes, None for a clear sky."""
    if asked.clouds_mag == 0:
        return None
    cell = max(1.0, asked.clouds_scale_px / _CLOUD_CELLS)
    coarse = [math.ceil(n / cell) + 1 for n in shape]
    field = gaussian_filter(rng.normal(size=coarse), _CLOUD_CELLS / 2, mode="nearest")
    field = (field - field.mean()) / max(field.std(), 1e-12)
    fine = zoom(field, [n / m for n, m in zip(shape, coarse, strict=True)], order=1)
    part = np.clip((fine / _CLOUD_SIGMAS + 1) / 2, 0.0, 1.0)
    return np.asarray(asked.clouds_mag * part)


def _read_out(
    light: Floats, asked: RenderSettings, rng: np.random.Generator
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Turn mean charges (h, w) into an image: noise, saturation, offsets, rounding."""
    height, width = light.shape
    charge = rng.poisson(light).astype(float)
    hot = rng.random(light.shape) < asked.hot_pixels
    charge[hot] += rng.exponential(asked.hot_pixel_e, np.count_nonzero(hot))
    if asked.bleeding:
        _bleed(charge, asked.full_well_e)
    charge = np.minimum(charge, asked.full_well_e)
    charge += rng.normal(0.0, asked.read_noise_e, light.shape)
    charge += rng.normal(0.0, asked.row_banding_e, (height, 1))
    charge += rng.normal(0.0, asked.column_banding_e, (1, width))
    values = np.rint(asked.bias_dn + charge / asked.gain_e_per_dn)
    # The well's end is as sharp as the converter's: nothing is read beyond it.
    values = np.clip(values, 0, math.floor(asked.saturation_dn))
    return np.asarray(values, np.uint8) if asked.bits == 8 else np.asarray(values, np.uint16)


@compiled
def _bleed(charge: Floats, full_well: float) -> None:
    """Let half of what a pixel cannot hold run up the column and half of it down."""
    height, width = charge.shape
    for column in range(width):
        for row in range(height):
            excess = charge[row, column] - full_well
            if excess <= 0.0:
                continue
            charge[row, column] = full_well
            for step in (-1, 1):
                left, at = 0.5 * excess, row + step
                while left > 0.0 and 0 <= at < height and abs(at - row) < _MOST_ROWS:
                    taken = min(left, max(0.0, full_well - charge[at, column]))
                    charge[at, column] += taken
                    left -= taken
                    at += step
