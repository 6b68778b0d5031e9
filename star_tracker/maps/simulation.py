"""Simulated frames of known truth, and the seeded conditions of all measurements."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import Floats, separation
from star_tracker.optics.camera import Camera

#: Standard deviation of a simulated brightness, magnitudes.
_MAGNITUDE_NOISE = 0.1
CAMERAS = {
    "12 deg": Camera.from_fov(12, 512, 512),
    "20 deg": Camera.from_fov(20, 1024, 1024),
}
#: A solution whose boresight is farther than this from the true one is wrong.
CORRECT_DEG = 0.1
#: With much noise a right solution of few stars can be farther off; one that is farther than so
#: many standard deviations of the centroid noise is wrong.
_CORRECT_NOISES = 4.0


@dataclass(frozen=True)
class Condition:
    """Noise per axis, px; fraction of stars missing; false stars per true star."""

    name: str
    noise_px: float
    missing: float = 0.0
    false_stars: float = 0.0

    @property
    def short_name(self) -> str:
        """What stands before the colon of the name, for narrow tables."""
        return self.name.split(":")[0]

    def correct_deg(self, camera: Camera) -> float:
        """Return the boresight error up to which a solution is correct."""
        noise_deg = float(np.degrees(self.noise_px / camera.focal_length_px))
        return max(CORRECT_DEG, _CORRECT_NOISES * noise_deg)


CONDITIONS = (
    Condition("clean", 0.0),
    Condition("0.5 px", 0.5),
    Condition("1 px", 1.0),
    Condition("2 px", 2.0),
    Condition("3 px", 3.0),
    Condition("5 px", 5.0),
    Condition("m40: 40 % missing", 0.0, 0.4),
    Condition("m60: 60 % missing", 0.0, 0.6),
    Condition("f100: 100 % false", 0.0, 0.0, 1.0),
    Condition("f200: 200 % false", 0.0, 0.0, 2.0),
    Condition("comb: 0.5 px, 20 % missing, 50 % false", 0.5, 0.2, 0.5),
    Condition("hard: 1 px, 40 % missing, 100 % false", 1.0, 0.4, 1.0),
    Condition("sparse: 0.5 px, 60 % missing", 0.5, 0.6),
)


@dataclass(frozen=True)
class SyntheticField:
    """A simulated frame.

    Attributes:
        xy_px: (n, 2) centroids.
        catalog_index: (n,) the true catalogue index of each, -1 = false star.
        rotation: the true attitude.
        v_mag: (n,) measured V magnitudes, for identifiers that make use of brightness.
    """

    xy_px: Floats
    catalog_index: NDArray[np.int64]
    rotation: Floats
    v_mag: Floats


def visible_stars(
    catalog: StarCatalog, camera: Camera, rotation: Floats
) -> tuple[NDArray[np.intp], Floats]:
    """Return the catalogue indices (m,) and pixels (m, 2) of the stars in a camera's image."""
    index = np.flatnonzero(catalog.vectors @ rotation[:, 2] > np.cos(camera.radius_rad))
    pixels = camera.pixels(catalog.vectors[index] @ rotation)
    inside = camera.contains(pixels)
    return index[inside], pixels[inside]


def synthetic_field(
    catalog: StarCatalog,
    camera: Camera,
    rotation: Floats,
    rng: np.random.Generator,
    *,
    noise_px: float = 0.0,
    missing: float = 0.0,
    false_stars: float = 0.0,
) -> SyntheticField:
    """Simulate a frame at a rotation (3, 3), camera to ICRS.

    Args:
        catalog: the stars of the sky.
        camera: the camera, of definite parity.
        rotation: the true attitude.
        rng: source of all chance.
        noise_px: standard deviation of a centroid along each axis.
        missing: fraction of the stars that are not seen, rounded to a whole number of them.
        false_stars: number of false stars as a fraction of the number of true stars in the field.
    """
    index, pixels = visible_stars(catalog, camera, rotation)
    n_false = round(false_stars * len(index))
    seen = np.sort(rng.permutation(len(index))[round(missing * len(index)) :])
    xy = pixels[seen] + rng.normal(0.0, noise_px, (len(seen), 2))
    false = uniform_noise(camera, n_false, rng)
    order = rng.permutation(len(xy) + n_false)
    truth = np.concatenate([index[seen], np.full(n_false, -1)])
    v_mag = _measured_magnitudes(catalog, truth[order], rng.spawn(1)[0])
    return SyntheticField(np.concatenate([xy, false])[order], truth[order], rotation, v_mag)


def _measured_magnitudes(
    catalog: StarCatalog, index: NDArray[np.int64], rng: np.random.Generator
) -> Floats:
    """Return magnitudes (n,): a true star's own with noise, a false star's as any star's.

    `rng` is a stream of its own, so that the positions of a seed do not depend on this.
    """
    measured = catalog.v_mag[index] + rng.normal(0.0, _MAGNITUDE_NOISE, len(index))
    return np.where(index >= 0, measured, rng.choice(catalog.v_mag, len(index)))


def uniform_noise(camera: Camera, n: int, rng: np.random.Generator) -> Floats:
    """Return centroids (n, 2) that have nothing to do with any star."""
    return rng.random((n, 2)) * (camera.width_px, camera.height_px)


def random_rotation(rng: np.random.Generator) -> Floats:
    """Return a rotation (3, 3) from the uniform distribution over all attitudes."""
    ra, roll = rng.uniform(0, 2 * np.pi, 2)
    return rotation_from_boresight(float(ra), float(np.arcsin(rng.uniform(-1, 1))), float(roll))


def frames(
    catalog: StarCatalog, camera: Camera, condition: Condition, n: int,
    seed: int | np.random.SeedSequence,
) -> Iterator[SyntheticField]:
    """Yield `n` frames at random attitudes; the same seed gives the same frames."""
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield synthetic_field(
            catalog, camera, random_rotation(rng), rng, noise_px=condition.noise_px,
            missing=condition.missing, false_stars=condition.false_stars,
        )


def boresight_angle_deg(found: Floats, true: Floats) -> float:
    """Return the angle between the boresights of two rotations (3, 3), camera to ICRS, degrees."""
    return float(np.degrees(separation(found[:, 2], true[:, 2])))
