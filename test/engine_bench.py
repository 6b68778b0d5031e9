"""What compiled code works with, for tests of its parts: frames, engines, tables of pairs."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numba
import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.engine import Pairs
from star_tracker.identification.evidence import EXACT, strongest
from star_tracker.identification.fallback import StarField
from star_tracker.identification.judge import associate, look_up
from star_tracker.identification.labels import LABEL, Identification
from star_tracker.identification.search import Limits
from star_tracker.identification.searcher import Task
from star_tracker.identification.setup import Setup
from star_tracker.optics.camera import Camera
from star_tracker.optics.frame import empty_frame, fill_frame

#: Room for the centroids of every test.
_ROOM = 1000


@dataclass(frozen=True)
class Field(StarField):
    """The stars of a frame, whose arrays are just as long as there are usable centroids."""

    camera: Camera
    frame: Any

    @classmethod
    def at(cls, camera, xy_px, intensity=None):
        """Return the field of centroids (n, 2), pixels."""
        task = task_of(xy_px, intensity)
        frame = empty_frame(np.empty((len(task.xy_px), 3)))
        fill_frame(frame, camera.optics, task.xy_px, task.intensity)
        if frame.n < len(task.xy_px):
            frame = empty_frame(np.empty((frame.n, 3)))
            fill_frame(frame, camera.optics, task.xy_px, task.intensity)
        return cls(frame.vectors, camera.focal_length_px, camera, frame)

    def __len__(self):
        return len(self.vectors)


def task_of(xy_px, intensity=None):
    """Return a frame on its way that has all the time it needs."""
    xy = np.array(xy_px, float).reshape(-1, 2)
    bright = np.empty(0) if intensity is None else np.array(intensity, float)
    return Task(xy, bright, np.empty(len(xy), LABEL), 0.0, np.inf)


class Verified(NamedTuple):
    """A pose that the judge has looked at."""

    rotation: np.ndarray
    log10_false_alarms: float


class EngineBench:
    """An engine for a few guide stars, and a look at what its verbs leave behind.

    Args:
        vectors: (n, 3) guide stars.
        camera: that looks at them.
        v_mag: (n,) their magnitudes.
        sigma_px: noise of a centroid, 0 = not known.
        displaced_gate_px: of displaced stars.
    """

    def __init__(self, vectors, camera, *, v_mag=None, sigma_px=0.0, displaced_gate_px=0.0):
        n = len(vectors)
        none = np.zeros(n, np.int64)
        magnitudes = np.full(n, 4.0) if v_mag is None else np.array(v_mag, float)
        database = FeatureDatabase.build(
            StarCatalog(vectors, magnitudes, none, none), max_separation_deg=0.5
        )
        limits = Limits(8.0, 3.0, 10.0, np.inf, displaced_gate_px)
        setup = Setup(MatchGroupSettings(), limits, sigma_px, _ROOM)
        (self.searcher,) = setup.searchers(database, (camera,), EXACT)
        self.engine, self.vectors = self.searcher._engine, vectors

    def associated(self, xy_px, rotation, gate_px):
        """Associate a frame with the guide stars at a pose.

        Returns the guide star of each row of the input (-1 = none), squared residuals (NaN) and
        how many guide stars are in the image.
        """
        engine = self._begun(task_of(xy_px), rotation)
        matches, pose = engine.matches, engine.best
        n_near = look_up(engine.sky, pose, 2 * gate_px, matches)
        k, inside = associate(engine.sky, engine.frame, pose, gate_px, n_near, matches)
        assert np.all(np.diff(matches.residual2[:k]) >= 0)
        guide, residual2 = np.full(len(xy_px), -1), np.full(len(xy_px), np.nan)
        row = engine.frame.row[matches.observed[:k]]
        guide[row], residual2[row] = matches.catalog[:k], matches.residual2[:k]
        return guide, residual2, inside

    def strongest(self, xy_px, rows, residual2, n_inside):
        """How many matches of these rows carry most evidence, and its log10."""
        engine = self._begun(task_of(xy_px), np.eye(3))
        order = np.argsort(residual2, kind="stable")
        place = np.argsort(engine.frame.row[: engine.frame.n])
        k = len(rows)
        engine.matches.observed[:k] = place[np.asarray(rows)[order]]
        engine.matches.residual2[:k] = np.asarray(residual2, float)[order]
        return strongest(engine.sky, engine.frame, engine.best, engine.matches, (k, n_inside))

    def verify(self, xy_px, candidate, intensity=None):
        """Judge a candidate alone; None where it is no hypothesis."""
        self._begun(task_of(xy_px, intensity), np.eye(3))
        self.searcher.judge(candidate)
        if self.searcher.score == -np.inf:
            return None
        return Verified(self.searcher.rotation.copy(), -self.searcher.score)

    def label(self, xy_px, rotation, tolerance_px=2.0):
        """Label a frame at a pose; return its identification and the fitted rotation."""
        task = task_of(xy_px)
        self._begun(task, rotation)
        self.searcher._progress["tolerance_px"] = tolerance_px
        return self._labelled(task)

    def judge_and_label(self, xy_px, candidate):
        """Judge a candidate and label the frame with what becomes of it."""
        task = task_of(xy_px)
        self._begun(task, np.eye(3))
        self.searcher.judge(candidate)
        return self._labelled(task)

    def _begun(self, task, rotation):
        self.searcher.begin(task)
        self.searcher.results.rotation[:] = rotation
        return self.engine

    def _labelled(self, task):
        task.labels["catalog_index"], task.labels["state"] = -1, 0
        task.labels["residual_px"] = np.nan
        self.searcher.label(task)
        named = Identification(*(
            task.labels[name].copy() for name in ("catalog_index", "state", "residual_px")
        ))
        return named, self.searcher.rotation.copy()


@numba.njit
def pairs_of(table):
    """Return a `PairTable` as compiled code knows it."""
    return Pairs(
        table.separation_rad, table.main_azimuth, table.bin_start, table.near_start,
        table.near_separation_rad, table.near_azimuth, table.near_companion,
        table.max_separation_rad,
    )
