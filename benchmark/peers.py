"""Other star identifiers behind one interface, so that `peers_benchmark.py` can run them.

All of them know the same stars, the camera's exact focal length and no distortion, and are handed
pixels of a camera of normal parity with its principal point in the image's centre. A contestant
takes a frame in three steps, of which only `solve` is timed: `prepare` puts our data into its
form, `solve` is its own call, `rotation` reads the answer. A peer is imported only where it is
built, so a peer that is not installed costs nobody else anything.
"""

import importlib
import struct
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from star_tracker.optics.camera import Camera
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import SyntheticField
from star_tracker.tracker import StarTracker

#: A field of view given to a peer may be wrong by this fraction. Noise makes it look wrong, too:
#: a smaller one loses frames of 3 px, a larger one costs time.
FOV_TOLERANCE = 0.01


class Contestant(ABC):
    """An identifier set up for one camera."""

    def tell_noise(self, noise_px: float) -> None:  # noqa: B027  not everyone listens
        """Hear the true centroid noise of the frames to come; most have no use for it."""

    @abstractmethod
    def prepare(self, frame: SyntheticField) -> Any:
        """Put a frame's centroids into the form that `solve` takes."""

    @abstractmethod
    def solve(self, given: Any) -> Any:
        """Identify the stars: the identifier's own call, which is timed, and nothing else."""

    @abstractmethod
    def rotation(self, answer: Any) -> Floats | None:
        """Return the rotation (3, 3), camera to ICRS, in an answer; None where there is none."""


@dataclass(frozen=True)
class Entry:
    """What stands on the starting list.

    Attributes:
        name: what tables call it.
        settings: how it is set up, in words.
        build: makes the contestant; raises ImportError where the peer is not installed.
        package: what has to be installed for it, empty for this package itself.
        every: it sees only every so-many-th frame, as it is slow.
    """

    name: str
    settings: str
    build: Callable[[StarCatalog, Camera], Contestant]
    package: str = ""
    every: int = 1


def centred_pixels(camera: Camera, xy_px: Floats) -> Floats:
    """Return pixels (n, 2) from the principal point, x right, y down, without distortion."""
    return camera.plane(xy_px) * camera.fx_px


class Ours(Contestant):
    """Our own, all settings the defaults, with or without brightness."""

    def __init__(self, catalog: StarCatalog, camera: Camera, *, brightness: bool = False) -> None:
        self._tracker = StarTracker(FeatureDatabase.build(catalog), camera)
        self._brightness = brightness

    def prepare(self, frame: SyntheticField) -> tuple[Floats, Floats | None]:
        """Return the centroids as they are, and intensities."""
        return frame.xy_px, 10 ** (-0.4 * frame.v_mag) if self._brightness else None

    def solve(self, given: Any) -> Any:
        """Solve from pixels to attitude."""
        return self._tracker.solve(*given)

    def rotation(self, answer: Any) -> Floats | None:
        """Return the solution's rotation."""
        return None if answer.attitude is None else np.asarray(answer.attitude.rotation)


@dataclass(frozen=True)
class Tetra3Settings:
    """Settings of tetra3rs that differ between its entries.

    Attributes:
        pattern_max_error: edge-ratio error of the pattern hash; the package's default is 0.001.
        brightness: hand it the magnitudes. Without, it takes the centroids in their random order.
        patterns_per_field: patterns stored for each lattice field.
        match_threshold: false-positive probability up to which it accepts a solution.
    """

    pattern_max_error: float
    brightness: bool = True
    patterns_per_field: int = 50
    match_threshold: float = 1e-5


class Tetra3(Contestant):
    """tetra3rs: hashes of four-star patterns. Its origin is the image's centre, y down."""

    def __init__(self, catalog: StarCatalog, camera: Camera, settings: Tetra3Settings) -> None:
        tetra3rs = importlib.import_module("tetra3rs")
        self._camera = camera
        self._settings = settings
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "catalog.bin"
            path.write_bytes(gaia_binary(catalog))
            self._database = tetra3rs.SolverDatabase.generate_from_gaia(
                str(path),
                max_fov_deg=camera.fov_deg,
                star_max_magnitude=float(np.max(catalog.v_mag)) + 1.0,
                pattern_max_error=settings.pattern_max_error,
                patterns_per_lattice_field=settings.patterns_per_field,
                epoch_proper_motion_year=None,
            )
        if self._database.num_stars != len(catalog):
            raise ValueError(f"tetra3rs took {self._database.num_stars} of {len(catalog)} stars")
        self._model = tetra3rs.CameraModel(camera.fx_px, camera.width_px, camera.height_px)

    def prepare(self, frame: SyntheticField) -> Floats:
        """Return centroids from the image's centre (n, 2), or (n, 3) with their brightness."""
        xy = centred_pixels(self._camera, frame.xy_px)
        if not self._settings.brightness:
            return np.ascontiguousarray(xy)
        return np.column_stack([xy, 10 ** (-0.4 * frame.v_mag)])

    def solve(self, given: Any) -> Any:
        """Solve from pixels to attitude."""
        return self._database.solve_from_centroids(
            given,
            camera_model=self._model,
            fov_max_error_deg=FOV_TOLERANCE * self._camera.fov_deg,
            match_threshold=self._settings.match_threshold,
        )

    def rotation(self, answer: Any) -> Floats | None:
        """Return its ICRS-to-camera rotation the other way round; its failures are falsy."""
        return np.asarray(answer.rotation_matrix_icrs_to_camera).T if answer else None


def gaia_binary(catalog: StarCatalog) -> bytes:
    """Return a catalogue in the binary form that tetra3rs reads: version 1, no proper motion."""
    rows = np.zeros(len(catalog), [
        ("id", "<i8"), ("ra", "<f8"), ("dec", "<f8"),
        ("mag", "<f4"), ("pm_ra", "<f4"), ("pm_dec", "<f4"),
    ])
    ra, dec = catalog.ra_dec_rad
    rows["id"] = np.arange(1, len(catalog) + 1)
    rows["ra"], rows["dec"] = np.degrees(ra) % 360, np.degrees(dec)
    rows["mag"] = catalog.v_mag
    return b"GDR3" + struct.pack("<IQ", 1, len(catalog)) + rows.tobytes()


class RustStarTracker(Contestant):
    """ruststartracker: triangles of stars, tried in the centroids' order.

    Its documentation leaves the settings to the user, and its defaults (0.0008 rad, 10 matches)
    refuse a fifth of the clean fields of 12 deg. So it is told the noise: the tolerance is two
    standard deviations of it, and the wider that is, the more matches a solution needs.
    """

    #: As its own path from an image does: the brightest so many centroids, brightest first.
    _CANDIDATES = 30
    #: Narrower ones only lose stars to rounding; its numbers have single precision.
    _LEAST_TOLERANCE_RAD = 0.0004
    _TOLERANCE_NOISES = 2.0
    #: Its own integration test has 5; one more for each 0.0008 rad keeps it from wrong solutions.
    _LEAST_MATCHES, _RAD_PER_MATCH = 5, 0.0008

    def __init__(self, catalog: StarCatalog, camera: Camera) -> None:
        self._package = importlib.import_module("ruststartracker")
        self._catalog, self._camera = catalog, camera
        self._centre = np.array([camera.width_px / 2, camera.height_px / 2])
        self.tell_noise(0.0)

    def tell_noise(self, noise_px: float) -> None:
        """Set the tracker up for a noise."""
        tolerance = max(
            self._LEAST_TOLERANCE_RAD, self._TOLERANCE_NOISES * noise_px / self._camera.fx_px
        )
        (x, y), f = self._centre, self._camera.fx_px
        parameters = self._package.CameraParameters(
            np.array([[f, 0, x], [0, f, y], [0, 0, 1]]),
            (self._camera.width_px, self._camera.height_px), None,
        )
        self._tracker = self._package.StarTracker(
            self._catalog.vectors.astype(np.float32), self._catalog.v_mag.astype(np.float32),
            parameters, inter_star_angle_tolerance=tolerance,
            n_minimum_matches=self._LEAST_MATCHES + round(tolerance / self._RAD_PER_MATCH),
        )

    def prepare(self, frame: SyntheticField) -> Floats:
        """Return the brightest centroids, brightest first, y down."""
        brightest = np.argsort(frame.v_mag)[: self._CANDIDATES]
        return centred_pixels(self._camera, frame.xy_px[brightest]) + self._centre

    def solve(self, given: Any) -> Any:
        """Solve from pixels to attitude; it says by an exception that it found nothing."""
        try:
            return self._tracker.process_image_coordiantes(given)
        except self._package.StarTrackerError:
            return None

    def rotation(self, answer: Any) -> Floats | None:
        """Return the matrix of its quaternion x, y, z, w, which is camera to ICRS."""
        return None if answer is None else rotation_of_quaternion(np.asarray(answer.quat, float))


def rotation_of_quaternion(quaternion: Floats) -> Floats:
    """Return the matrix (3, 3) of a quaternion x, y, z, w of any length but 0."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def _tetra3_entry(name: str, words: str, settings: Tetra3Settings) -> Entry:
    """Return an entry of tetra3rs; `words` say what its settings are."""
    return Entry(
        f"tetra3rs {name}", f"{words}; field of view known to 1 %, the rest its defaults",
        lambda catalog, camera: Tetra3(catalog, camera, settings), "tetra3rs",
    )


def starting_list(rust_every: int) -> tuple[Entry, ...]:
    """Return all entries, our own first; ruststartracker sees every `rust_every`-th frame."""
    return (
        Entry("star_tracker", "default settings, without brightness", Ours),
        _tetra3_entry(".001", "pattern_max_error .001, with brightness", Tetra3Settings(0.001)),
        _tetra3_entry(".01", "pattern_max_error .01, with brightness", Tetra3Settings(0.01)),
        _tetra3_entry(
            ".01 strong",
            "pattern_max_error .01, with brightness, match_threshold 1e-3, "
            "500 patterns per lattice field",
            Tetra3Settings(0.01, patterns_per_field=500, match_threshold=1e-3),
        ),
        _tetra3_entry(
            ".01 dark", "pattern_max_error .01, without brightness: the centroids in random order",
            Tetra3Settings(0.01, brightness=False),
        ),
        Entry(
            "ruststartracker",
            "told the true noise: tolerance of 2 standard deviations, at least 0.0004 rad; 5 "
            "matches, one more for each 0.0008 rad of tolerance; timeout 1 s (its default); with "
            "brightness: the 30 brightest, brightest first",
            RustStarTracker, "ruststartracker", rust_every,
        ),
        Entry(
            "star_tracker bright", "default settings, with brightness",
            partial(Ours, brightness=True),
        ),
    )
