"""What contestants are shown: simulated frames of a condition, or centroids of real images."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import DEFAULT_MAX_SEPARATION_DEG, FeatureDatabase
from star_tracker.catalogue.depth import limiting_magnitude_for, solid_angle_sr
from star_tracker.geometry.spherical import Floats, separation, unit_vectors
from star_tracker.maps.simulation import Condition, SyntheticField, frames
from star_tracker.optics.camera import Camera


@dataclass(frozen=True)
class Sky:
    """The guide stars, alike for all contestants: the paper's, or Hipparcos to a magnitude."""

    limiting_magnitude: float | None = None

    @classmethod
    def for_camera(cls, camera: Camera) -> "Sky":
        """Return the Hipparcos stars to the depth that suits a camera (`catalogue.depth`)."""
        return cls(limiting_magnitude_for("hipparcos", solid_angle_sr(camera)))

    @cache  # noqa: B019  for as long as the process lives
    def catalog(self) -> StarCatalog:
        """Return the guide stars, made once in each process."""
        if self.limiting_magnitude is None:
            return StarCatalog.paper()
        return StarCatalog.hipparcos(limiting_magnitude=self.limiting_magnitude)

    @cache  # noqa: B019
    def database(self) -> FeatureDatabase:
        """Return the guide stars with their features, made once in each process."""
        paper = self.limiting_magnitude is None
        return FeatureDatabase.cached(
            self.catalog(), max_separation_deg=DEFAULT_MAX_SEPARATION_DEG if paper else 0.0
        )


@dataclass(frozen=True)
class Scene:
    """A frame and its truth.

    Attributes:
        xy_px: (n, 2) centroids.
        intensity: (n,) their brightness on a linear scale; None = not measured.
        boresight: (3,) the true one, unit vector, ICRS.
        n_true: how many of the centroids are guide stars; None = not known.
    """

    xy_px: Floats
    intensity: Floats | None
    boresight: Floats
    n_true: int | None = None

    def error_deg(self, rotation: Floats) -> float:
        """Return how far a found rotation (3, 3), camera to ICRS, puts the boresight off."""
        return float(np.degrees(separation(rotation[:, 2], self.boresight)))

    def nees(self, rotation: Floats, covariance_rad2: Floats) -> float:
        """Return the boresight's squared error in units of the covariance of a found rotation.

        Of true covariances it has a chi-square distribution of 2 degrees of freedom (Bar-Shalom
        et al. 2001, 5.4). The covariance is that of small rotations about the camera's axes, which
        move the boresight across: one about x towards -y, one about y towards x.
        """
        seen = rotation.T @ self.boresight
        turned = np.array([-seen[1], seen[0]]) / seen[2]
        return float(turned @ np.linalg.solve(covariance_rad2[:2, :2], turned))


def simulated(
    sky: Sky, camera: Camera, condition: Condition, n: int, seed: np.random.SeedSequence
) -> Iterator[Scene]:
    """Yield `n` frames at random attitudes; the same seed gives the same ones."""
    catalog = sky.catalog()
    positions, brightness = seed.spawn(2)
    rng = np.random.default_rng(brightness)
    for frame in frames(catalog, camera, condition, n, positions):
        yield Scene(
            frame.xy_px, _intensity(catalog, condition, frame, rng), frame.rotation[:, 2],
            int(np.sum(frame.catalog_index >= 0)),
        )


def _intensity(
    catalog: StarCatalog, condition: Condition, frame: SyntheticField, rng: np.random.Generator
) -> Floats | None:
    if condition.brightness_noise_mag is None:
        return None
    index = frame.catalog_index
    # A false star is as bright as any star, see `synthetic_field`.
    noise = rng.normal(0.0, 1.0, len(index)) * condition.brightness_noise_mag
    v_mag = np.where(index >= 0, catalog.v_mag[index] + noise, frame.v_mag)
    return np.asarray(10.0 ** (-0.4 * v_mag))


@dataclass(frozen=True)
class Image:
    """A real image as plain values, so that it can be sent to any process.

    Attributes:
        name: of its file.
        camera: the camera that took it, its lens not known.
        ra_deg, dec_deg: the true boresight.
        xy_px: what was detected in it, x and y.
        intensity: brightness of each on a linear scale; empty = not measured.
    """

    name: str
    camera: Camera
    ra_deg: float
    dec_deg: float
    xy_px: tuple[tuple[float, float], ...]
    intensity: tuple[float, ...] = ()

    def scene(self) -> Scene:
        """Return it as contestants see it."""
        return Scene(
            np.array(self.xy_px), np.array(self.intensity) if self.intensity else None,
            unit_vectors(*np.radians([self.ra_deg, self.dec_deg])),
        )


def read_images(folder: Path | None) -> list[Image]:
    """Return the real images of a folder of which there are centroids.

    `truth.csv` has file, width_px, height_px, ra_deg, dec_deg (boresight) and fov_width_deg;
    `centroids.csv`, or else `stars.csv`, has file, x_px, y_px and perhaps intensity, origin at the
    outer corner of the first pixel, y down. Raises ValueError, with what is wanted, where a file
    is missing or holds something else.
    """
    if folder is None:
        raise ValueError("give their folder with --images")
    places = [folder / name for name in ("centroids.csv", "stars.csv")]
    source = next((place for place in places if place.is_file()), places[0])
    try:
        truths, rows = _rows(folder / "truth.csv"), _rows(source)
        found = []
        for truth in truths:
            mine = [row for row in rows if row["file"] == truth["file"]]
            if mine:
                found.append(_image(truth, mine))
    except OSError as error:
        raise ValueError(f"{error.filename}: {error.strerror}") from error
    except (KeyError, ValueError) as error:
        raise ValueError(f"{folder} holds no real images: {error} in truth.csv or {source.name}") \
            from error
    return found


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _image(truth: dict[str, str], rows: list[dict[str, str]]) -> Image:
    camera = Camera.from_fov(
        float(truth["fov_width_deg"]), int(truth["width_px"]), int(truth["height_px"])
    )
    return Image(
        truth["file"], camera, float(truth["ra_deg"]), float(truth["dec_deg"]),
        tuple((float(row["x_px"]), float(row["y_px"])) for row in rows),
        tuple(float(row["intensity"]) for row in rows if "intensity" in row),
    )
