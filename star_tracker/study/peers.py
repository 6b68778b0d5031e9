"""Other star identifiers as contestants, each imported only where it is set up.

They are given the same stars, pixels of a camera of normal parity about its principal point, and
the range in which the field of view lies.
"""

import importlib
import struct
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.rotation import rotation_matrix
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import Condition
from star_tracker.optics.camera import Camera
from star_tracker.study.contestants import Answer, Contestant, Entrant, Told
from star_tracker.study.scenes import Scene, Sky


@dataclass(frozen=True)
class Tetra3(Contestant):
    """tetra3rs: hashes of four-star patterns. Its origin is the image's centre, y down.

    Attributes:
        pattern_max_error: edge-ratio error of the pattern hash; the package's default is 0.001.
        patterns_per_field: patterns stored for each lattice field.
        match_threshold: false-positive probability up to which it accepts a solution.
    """

    pattern_max_error: float = 0.001
    patterns_per_field: int = 50
    match_threshold: float = 1e-5
    package = "tetra3rs"

    @property
    def settings(self) -> str:
        """How it is set up, in words."""
        order = "" if self.brightness else ": the centroids in random order"
        return (
            f"pattern_max_error {self.pattern_max_error:g}, {self.told_brightness()}{order}, "
            f"match_threshold {self.match_threshold:g}, {self.patterns_per_field} patterns per "
            "lattice field, a database for the range of fields of view that is told (1 % where "
            "that is right), the rest its defaults"
        )

    def declines(self, condition: Condition) -> str:
        """Return why it cannot take part under a condition; empty where it can."""
        return _declines_parity(condition)

    def set_up(self, told: Told) -> Entrant:
        """Make it ready for a camera."""
        camera, (low, high) = told.camera, told.fov_range_deg
        one_size = told.fov_tolerance_percent == 0
        database, size = _tetra3_database(
            told.sky, (camera.fov_deg,) * 2 if one_size else (low, high), self.pattern_max_error,
            self.patterns_per_field,
        )
        options = {
            "camera_model": importlib.import_module("tetra3rs").CameraModel(
                camera.fx_px, camera.width_px, camera.height_px
            ),
            "fov_max_error_deg": max(high - camera.fov_deg, camera.fov_deg - low),
            "match_threshold": self.match_threshold,
        }

        def prepare(scene: Scene) -> Floats:
            xy = _centred_pixels(camera, scene.xy_px)
            if scene.intensity is None or not self.brightness:
                return np.ascontiguousarray(xy)
            return np.column_stack([xy, scene.intensity])

        return Entrant(
            prepare, lambda given: database.solve_from_centroids(given, **options),
            _tetra3_answer, size,
        )


def _tetra3_answer(result: Any) -> Answer:
    """Turn its ICRS-to-camera rotation the other way round; its failures are falsy."""
    if not result:
        return Answer(None, "TIMEOUT" if result.status == "timeout" else "NO_MATCH")
    return Answer(np.asarray(result.rotation_matrix_icrs_to_camera).T)


@cache
def _tetra3_database(
    sky: Sky, fov_range_deg: tuple[float, float], max_error: float, patterns_per_field: int
) -> tuple[Any, int]:
    """Return a database of the guide stars and its size as a file, once in each process."""
    tetra3rs = importlib.import_module("tetra3rs")
    catalog = sky.catalog()
    low, high = fov_range_deg
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "catalog.bin"
        path.write_bytes(gaia_binary(catalog))
        database = tetra3rs.SolverDatabase.generate_from_gaia(
            str(path), max_fov_deg=high, min_fov_deg=None if low == high else low,
            star_max_magnitude=float(np.max(catalog.v_mag)) + 1.0, pattern_max_error=max_error,
            patterns_per_lattice_field=patterns_per_field, epoch_proper_motion_year=None,
        )
        database.save_to_file(str(path))
        size = path.stat().st_size
    if low == high and database.num_stars != len(catalog):
        raise ValueError(f"tetra3rs took {database.num_stars} of {len(catalog)} stars")
    return database, size


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


@dataclass(frozen=True)
class RustStarTracker(Contestant):
    """ruststartracker: triangles of stars, tried in the centroids' order.

    Its documentation leaves the settings to the user, and its defaults (0.0008 rad, 10 matches)
    refuse a fifth of the clean fields of 12 deg. So it is told the noise: the tolerance is two
    standard deviations of it, and the wider that is, the more matches a solution needs.
    """

    package = "ruststartracker"
    #: As its own path from an image does: the brightest so many centroids, brightest first.
    _CANDIDATES = 30
    #: Narrower ones only lose stars to rounding; its numbers have single precision.
    _LEAST_TOLERANCE_RAD, _TOLERANCE_NOISES = 0.0004, 2.0
    #: Its own integration test has 5; one more for each 0.0008 rad keeps it from wrong solutions.
    _LEAST_MATCHES, _RAD_PER_MATCH = 5, 0.0008

    @property
    def settings(self) -> str:
        """How it is set up, in words."""
        return (
            "told the true noise: tolerance of 2 standard deviations, at least 0.0004 rad; 5 "
            "matches, one more for each 0.0008 rad of tolerance; timeout 1 s (its default); "
            f"{self.told_brightness()}: the 30 brightest, brightest first"
        )

    def declines(self, condition: Condition) -> str:
        """Return why it cannot take part under a condition; empty where it can."""
        if condition.fov_error_percent:
            return "it takes no tolerance of the field of view"
        return super().declines(condition) or _declines_parity(condition)

    def set_up(self, told: Told) -> Entrant:
        """Make it ready for a camera and its noise."""
        package, camera = importlib.import_module("ruststartracker"), told.camera
        tolerance = max(
            self._LEAST_TOLERANCE_RAD, self._TOLERANCE_NOISES * told.noise_px / camera.fx_px
        )
        f, centre = camera.fx_px, np.array([camera.width_px / 2, camera.height_px / 2])
        parameters = package.CameraParameters(
            np.array([[f, 0, centre[0]], [0, f, centre[1]], [0, 0, 1]]),
            (camera.width_px, camera.height_px), None,
        )
        catalog = told.sky.catalog()
        tracker = package.StarTracker(
            catalog.vectors.astype(np.float32), catalog.v_mag.astype(np.float32),
            parameters, inter_star_angle_tolerance=tolerance,
            n_minimum_matches=self._LEAST_MATCHES + round(tolerance / self._RAD_PER_MATCH),
        )

        def prepare(scene: Scene) -> Floats:
            xy_px = scene.xy_px
            if scene.intensity is not None and self.brightness:
                xy_px = xy_px[np.argsort(-scene.intensity)[: self._CANDIDATES]]
            return np.asarray(_centred_pixels(camera, xy_px) + centre)

        def solve(given: Floats) -> Any:
            try:
                return tracker.process_image_coordiantes(given)
            except package.StarTrackerError:  # so it says that it found nothing
                return None

        return Entrant(prepare, solve, _rust_answer)


def _rust_answer(result: Any) -> Answer:
    """Read its quaternion x, y, z, w, which is camera to ICRS."""
    if result is None:
        return Answer(None)
    return Answer(rotation_matrix(np.asarray(result.quat, float)))


def _centred_pixels(camera: Camera, xy_px: Floats) -> Floats:
    """Return pixels (n, 2) from the principal point, x right, y down, without distortion."""
    return np.asarray(camera.plane(xy_px) * camera.fx_px)


def _declines_parity(condition: Condition) -> str:
    return "it needs the parity" if condition.mirrored_sky_parity == "auto" else ""


#: By the name that a configuration gives.
PEERS: dict[str, type[Contestant]] = {
    "tetra3rs": Tetra3, "ruststartracker": RustStarTracker,
}
