"""Why was a frame not solved, or solved badly? Tries the mistakes in the set-up that users make.

A wrong parity looks like an empty sky. So does a field of view that is off by a few percent, or
the frame is solved with residuals of many pixels: the search bears much. Each is tried with the
primary matcher, and only an identification that is certain, and fits better, becomes a hint.
"""

import time
from collections.abc import Iterator
from dataclasses import replace

from star_tracker.calibration.lens import calibrate
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.searcher import METHODS
from star_tracker.optics.camera import FOV_RANGE_DEG, Camera
from star_tracker.solution import Solution, SolveSettings, Status
from star_tracker.tracker import StarTracker

#: Tried fields of view, relative to the configured one; in between the search itself is tolerant.
_FOV_FACTORS = (1.02, 0.98, 1.04, 0.96)
#: What a trial has to reach: as several are made, more than a solution.
_MAX_LOG10_FALSE_ALARMS = -8.0
#: Solved frames with smaller residuals need no hint; a better camera at least halves them. With a
#: field of view that was 4 to 6 % off, the eight maps had 7 to 26 px.
_BAD_RMS_PX, _BETTER = 2.0, 0.5
#: Trials that got less time than this would find nothing.
_SHORTEST_MS = 1.0


def wants_hint(solution: Solution) -> bool:
    """Return whether a frame ended so that `hint` may know something."""
    unsolved = solution.status in (Status.NO_MATCH, Status.TIMEOUT)
    return unsolved or solution.rms_px > _BAD_RMS_PX


def hint(
    database: FeatureDatabase,
    tried: tuple[Camera, SolveSettings],
    xy_px: Floats,
    solution: Solution,
    budget_ms: float,
) -> str:
    """Return a sentence on what would solve a frame or solve it better, empty where none is known.

    Args:
        database: guide stars and their features.
        tried: camera and settings as configured.
        xy_px: (n, 2) the frame's centroids.
        solution: what became of it.
        budget_ms: time for all trials together.
    """
    if not wants_hint(solution):
        return ""
    stop = time.perf_counter() + budget_ms / 1e3
    camera, settings = tried
    trials = list(_trials(database, camera, xy_px, solution))
    for i, trial in enumerate(trials):
        left_ms = 1e3 * (stop - time.perf_counter()) / (len(trials) - i)
        if left_ms < _SHORTEST_MS:
            return ""
        strict = replace(
            settings, method=METHODS[0], deadline_ms=left_ms,
            max_log10_false_alarms=min(_MAX_LOG10_FALSE_ALARMS, settings.max_log10_false_alarms),
        )
        found = StarTracker(database, trial, strict).solve(xy_px)
        if found.attitude is None or found.rms_px > _BETTER * solution.rms_px:
            continue
        if trial.parity != camera.parity:
            return f"image looks mirrored: parity {trial.parity} solves it"
        fitted = _fitted(database, trial, xy_px, found)
        # A camera that is off still has wrong matches, which the fitted one has not.
        again = StarTracker(database, fitted, strict).solve(xy_px)
        if again.attitude is not None:
            fitted = _fitted(database, fitted, xy_px, again)
        return f"improves if fov_deg is {fitted.fov_deg:.2f} instead of {camera.fov_deg:.2f}"
    return ""


def _trials(
    database: FeatureDatabase, camera: Camera, xy_px: Floats, solution: Solution
) -> Iterator[Camera]:
    """Yield the cameras to try, the likeliest mistake first."""
    if solution.attitude is not None:
        yield _fitted(database, camera, xy_px, solution)
    elif camera.parity != "auto":
        yield camera.with_parity("normal" if camera.parity == "mirrored" else "mirrored")
    low, high = FOV_RANGE_DEG
    for factor in _FOV_FACTORS:
        if low <= camera.fov_deg * factor <= high:
            yield replace(camera, fx_px=camera.fx_px / factor, fy_px=camera.fy_px / factor)


def _fitted(
    database: FeatureDatabase, camera: Camera, xy_px: Floats, solution: Solution
) -> Camera:
    """Return the camera with the focal length that fits a solved frame best."""
    which = solution.identification.identified
    stars = database.catalog.vectors[solution.identification.catalog_index[which]]
    try:
        fit = calibrate(camera.with_parity(solution.parity), xy_px[which], stars, terms=())
        factor = float(fit.values[0]) / camera.focal_length_px
        return replace(camera, fx_px=camera.fx_px * factor, fy_px=camera.fy_px * factor)
    except ValueError:  # too few stars, too close together, or a focal length no camera has
        return camera
