"""Simulated frames of known truth, and the seeded conditions of all measurements."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import Floats, separation
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

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
CORRECT_NOISES = 4.0
#: Between these lies a field of view that is not told, degrees.
UNKNOWN_FOV_DEG = (4.0, 70.0)
#: Where a field of view is told, it is known to the first, or to so many times its error.
_LEAST_FOV_TOLERANCE, _FOV_TOLERANCE_ERRORS = 0.01, 1.2


@dataclass(frozen=True)
class Condition:
    """What the frames suffer from, and what is wrong with the camera that an identifier is told.

    Attributes:
        name: what tables call it.
        noise_px: standard deviation of a centroid along each axis.
        missing: fraction of the stars that are not seen, rounded to a whole number of them.
        false_stars: false stars for each true star of the field, rounded in the same way.
        title: what a short name stands for.
        brightness_noise_mag: noise of the measured magnitudes; None = brightness is not measured.
        fov_error_percent: how much larger than the true field of view the one told is; None = no
            field of view is told.
        principal_point_offset_px: from the principal point told to the true one, along x and y.
        mirrored_sky_parity: parity told where the true one is `mirrored`; empty = the camera's
            own is true and told.
        lens_k1: first radial coefficient of the true lens (`plumb_bob`), added to the camera's
            own, which has none; it is not told.
    """

    name: str = ""
    noise_px: float = 0.0
    missing: float = 0.0
    false_stars: float = 0.0
    title: str = ""
    brightness_noise_mag: float | None = None
    fov_error_percent: float | None = 0.0
    principal_point_offset_px: float = 0.0
    mirrored_sky_parity: str = ""
    lens_k1: float = 0.0

    @property
    def words(self) -> str:
        """The name, with what it stands for."""
        return f"{self.name}: {self.title}" if self.title else self.name

    def correct_deg(self, camera: Camera, noises: float = CORRECT_NOISES) -> float:
        """Return the boresight error up to which a solution is correct: the rule for all.

        That is 0.1 deg, or so many standard deviations of the centroid noise where that is more.
        """
        noise_deg = float(np.degrees(self.noise_px / camera.focal_length_px))
        return max(CORRECT_DEG, noises * noise_deg)

    def true_camera(self, camera: Camera) -> Camera:
        """Return the camera that takes the frames."""
        true, offset = camera, self.principal_point_offset_px
        if offset:
            true = replace(camera, cx_px=camera.cx_px + offset, cy_px=camera.cy_px + offset)
        if self.lens_k1:
            lens = Distortion("plumb_bob", (self.lens_k1, 0.0, 0.0, 0.0, 0.0))
            true = replace(true, distortion=lens)
        return true.with_parity("mirrored") if self.mirrored_sky_parity else true

    def told_camera(self, camera: Camera) -> Camera:
        """Return the camera that is told; one in the middle of the range where none is."""
        parity = self.mirrored_sky_parity or camera.parity
        if self.fov_error_percent == 0:
            return camera.with_parity(parity)
        if self.fov_error_percent is None:
            fov_deg = float(np.sqrt(np.prod(UNKNOWN_FOV_DEG)))
        else:
            fov_deg = camera.fov_deg * (1 + self.fov_error_percent / 100)
        return Camera.from_fov(
            fov_deg, camera.width_px, camera.height_px, parity=parity,
            principal_point_px=(camera.cx_px, camera.cy_px),
        )

    def fov_range_deg(self, camera: Camera) -> tuple[float, float]:
        """Return between which fields of view the true one is told to lie, degrees."""
        if self.fov_error_percent is None:
            return UNKNOWN_FOV_DEG
        error = abs(self.fov_error_percent) / 100
        tolerance = max(_LEAST_FOV_TOLERANCE, _FOV_TOLERANCE_ERRORS * error)
        told_deg = self.told_camera(camera).fov_deg
        return told_deg * (1 - tolerance), told_deg * (1 + tolerance)


#: The conditions of all measurements.
CONDITIONS = (
    Condition("clean"),
    Condition("0.5 px", 0.5),
    Condition("1 px", 1.0),
    Condition("2 px", 2.0),
    Condition("3 px", 3.0),
    Condition("5 px", 5.0),
    Condition("m40", missing=0.4, title="40 % missing"),
    Condition("m60", missing=0.6, title="60 % missing"),
    Condition("f100", false_stars=1.0, title="100 % false"),
    Condition("f200", false_stars=2.0, title="200 % false"),
    Condition("comb", 0.5, 0.2, 0.5, title="0.5 px, 20 % missing, 50 % false"),
    Condition("hard", 1.0, 0.4, 1.0, title="1 px, 40 % missing, 100 % false"),
    Condition("sparse", 0.5, 0.6, title="0.5 px, 60 % missing"),
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
    condition: Condition = CONDITIONS[0],
) -> SyntheticField:
    """Simulate a frame at a rotation (3, 3), camera to ICRS.

    Args:
        catalog: the stars of the sky.
        camera: the camera, of definite parity, before the condition changes it.
        rotation: the true attitude.
        rng: source of all chance.
        condition: what the frame suffers from; by default nothing.
    """
    camera = condition.true_camera(camera)
    index, pixels = visible_stars(catalog, camera, rotation)
    n_false = round(condition.false_stars * len(index))
    seen = np.sort(rng.permutation(len(index))[round(condition.missing * len(index)) :])
    xy = pixels[seen] + rng.normal(0.0, condition.noise_px, (len(seen), 2))
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
    """Yield `n` frames of the condition's true camera at random attitudes.

    The same seed gives the same frames.
    """
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield synthetic_field(catalog, camera, random_rotation(rng), rng, condition)


def boresight_angle_deg(found: Floats, true: Floats) -> float:
    """Return the angle between the boresights of two rotations (3, 3), camera to ICRS, degrees."""
    return float(np.degrees(separation(found[:, 2], true[:, 2])))
