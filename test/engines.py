"""Engines, frames and poses of tiny skies: what the tests of compiled steps work with."""

import math
from typing import NamedTuple

import numpy as np

from star_tracker.attitude.pose import Pose
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.compiled import compiled
from star_tracker.geometry.rotation import rotation_from_boresight
from star_tracker.geometry.spherical import unit_vectors
from star_tracker.identification.brightness import brightness, how_usual
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.engine import Pairs
from star_tracker.identification.evidence import EXACT, strongest
from star_tracker.identification.fallback import Candidate
from star_tracker.identification.judge import associate, look_up
from star_tracker.identification.labels import Identification, blank_labels
from star_tracker.identification.progress import PROGRESS
from star_tracker.identification.search import Limits
from star_tracker.identification.searcher import Task
from star_tracker.identification.setup import Setup
from star_tracker.maps.simulation import visible_stars
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion
from star_tracker.optics.frame import empty_frame, fill_frame, see_at_scale

CAMERA = Camera.from_fov(12, 512, 512)
ROTATION = rotation_from_boresight(2.0, 0.4, 1.0)
#: Ten stars at places in the image, far from each other.
PLACES = np.array([
    (60.0, 70), (250, 40), (450, 90), (90, 250), (256, 240), (430, 280), (50, 440), (210, 460),
    (360, 400), (480, 470),
])
#: A figure as large as a field of 12 deg: (RA, Dec) in degrees.
FIGURE = {
    "Hub": (56.9, 24.1), "North": (57.1, 28.2), "East": (61.2, 24.9), "South": (56.2, 20.4),
    "West": (53.0, 23.2), "Corner": (59.9, 27.4), "Near": (57.9, 23.1), "Odd": (54.6, 26.6),
}
#: Two stars of another part of the sky, 0.9 deg apart.
ELSEWHERE = {"One": (200.0, -40.0), "Other": (200.0, -40.9)}
NONE = np.empty(0)
#: The progress of a search that has all the time that it wants, and of one that has none left.
PATIENT, LATE = np.zeros(2, PROGRESS)
PATIENT["stop_s"], LATE["stop_s"] = math.inf, 0.0


def of_brightness(magnitude, v_mag, observed, catalog, k):
    """What brightness adds to the evidence of the first `k` matches of a frame."""
    usual = np.empty(len(magnitude))
    how_usual(magnitude, len(magnitude), usual)
    return brightness((magnitude, usual), v_mag, observed, catalog, k)


# Skies


def rotation_to(ra_deg, dec_deg, roll_deg=0.0):
    return rotation_from_boresight(*np.radians([ra_deg, dec_deg, roll_deg]))


def catalog_of(vectors, v_mag=None):
    n = len(vectors)
    none = np.zeros(n, np.int64)
    return StarCatalog(vectors, np.full(n, 4.0) if v_mag is None else v_mag, none, none)


def database_of(*groups, **options):
    """Features of named stars."""
    places = [place for group in groups for place in group.values()]
    return FeatureDatabase.build(catalog_of(unit_vectors(*np.radians(places).T)), **options)


def database_at(xy_px, camera=CAMERA, rotation=ROTATION, v_mag=None):
    """A guide star for each place in the image of a camera at a rotation."""
    vectors = camera.vectors(xy_px) @ rotation.T
    return FeatureDatabase.build(
        catalog_of(vectors, None if v_mag is None else np.array(v_mag, float))
    )


def random_sky(n, seed):
    """Directions (n, 3) all over the sky."""
    vectors = np.random.default_rng(seed).normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def folding_lens(edge_px):
    """A 512 px camera whose lens shows nothing beyond `edge_px` from its axis.

    r (1 - 0.3 r^2) has its largest value, 0.7027, at r = 1.054.
    """
    focal = edge_px / 0.7027
    lens = Distortion("plumb_bob", (-0.3, 0.0, 0.0, 0.0, 0.0))
    return Camera(512, 512, focal, focal, 256, 256, "normal", lens)


# Frames


class Centroids(NamedTuple):
    """What a frame says of its usable centroids, from left to right; see `Frame`."""

    n: int
    vectors: np.ndarray
    plane_px: np.ndarray
    row: np.ndarray
    mains: np.ndarray
    intensity: np.ndarray
    has_brightness: bool
    scale: float


@compiled
def _arrays_of_frame(frame):
    return (
        frame.n, frame.vectors, frame.plane_px, frame.row, frame.mains, frame.intensity,
        frame.has_brightness, frame.scale,
    )


def centroids_of(frame):
    n, *arrays, has_brightness, scale = _arrays_of_frame(frame)
    return Centroids(n, *(array[:n] for array in arrays), has_brightness, scale)


def frame_of(xy_px, camera=CAMERA, intensity=None, *, room=1000):
    """A frame of centroids, as compiled code has it."""
    frame = empty_frame(np.empty((room, 3)))
    xy = np.ascontiguousarray(xy_px, float).reshape(-1, 2)
    fill_frame(frame, camera.optics, xy, NONE if intensity is None else np.array(intensity, float))
    return frame


def view(database, rotation, camera=CAMERA):
    """A frame of all stars that a camera sees, without noise, and its true stars."""
    index, pixels = visible_stars(database.catalog, camera, rotation)
    frame = frame_of(pixels, camera)
    return frame, index[centroids_of(frame).row]


# Engines


@compiled
def pose_of(rotation, scale, free):
    """A pose of a rotation (3, 3), which it keeps."""
    return Pose(rotation, scale, free)


@compiled
def pose_parts(pose):
    return pose.rotation, pose.scale, pose.free


@compiled
def pairs_of(table):
    """A pair table as the engine has it."""
    return Pairs(
        table.separation_rad, table.main_azimuth, table.bin_start, table.near_start,
        table.near_separation_rad, table.near_azimuth, table.near_companion,
        table.max_separation_rad,
    )


@compiled
def _parts(engine):
    return (
        engine.sky, engine.frame, engine.room, engine.matches, engine.best, engine.votes,
        engine.fan,
    )


@compiled
def match_lists(matches):
    return matches.observed, matches.catalog, matches.listed, matches.residual2


class Judged(NamedTuple):
    """The best pose so far: decades of evidence, rotation, scale."""

    score: float
    rotation: np.ndarray
    scale: float


class Bench:
    """One engine: guide stars and the camera that looks at them, and one frame after the other.

    `sky`, `frame`, `room`, `matches`, `votes` and `fan` are the engine's own.
    """

    def __init__(
        self, database, camera=CAMERA, *, prior=EXACT, displaced_gate_px=40.0, sigma_px=0.0,
        settings=None,
    ):
        limits = Limits(8.0, 3.0, 10.0, 20_000.0, displaced_gate_px)
        setup = Setup(settings or MatchGroupSettings(), limits, sigma_px, 1000)
        self.expected = setup.expected
        (self.searcher,) = setup.searchers(database, (camera,), prior)
        self.engine, self.results = self.searcher.engine, self.searcher.results
        self.camera, self.guides = camera, database.catalog.vectors
        (
            self.sky, self.frame, self.room, self.matches, self.best, self.votes, self.fan,
        ) = _parts(self.engine)

    def show(self, xy_px, intensity=None):
        """Take a frame in."""
        xy = np.ascontiguousarray(xy_px, float)
        self.n_rows = len(xy)
        self.searcher.begin(self.task_of(xy, intensity))
        return self.searcher.ended

    def task_of(self, xy, intensity=None):
        """A frame for the searcher, which has all the time that it wants."""
        given = NONE if intensity is None else np.array(intensity, float)
        self.task = Task(xy, given, blank_labels(len(xy)), 0.0, math.inf)
        return self.task

    @property
    def centroids(self):
        return centroids_of(self.frame)

    def places(self, rows):
        """Where in the frame these rows of the input stand; all of them are usable."""
        return np.argsort(self.centroids.row)[np.asarray(rows, np.int64)]

    def matched(self, rotation=ROTATION, gate_px=4.0):
        """Association at a pose: guide star of each row, squared residuals, how many inside."""
        pose = pose_of(np.ascontiguousarray(rotation), 1.0, False)
        n_near = look_up(self.sky, pose, 2 * gate_px, self.matches)
        k, inside = associate(self.sky, self.frame, pose, gate_px, n_near, self.matches)
        observed, catalog, _, listed2 = (array[:k] for array in match_lists(self.matches))
        assert np.all(np.diff(listed2) >= 0)
        row = self.centroids.row[observed]
        guide, residual2 = np.full(self.n_rows, -1), np.full(self.n_rows, np.nan)
        guide[row], residual2[row] = catalog, listed2
        return guide.tolist(), residual2, inside

    def judge(self, rows, stars, tolerance_px=2.0):
        """Judge the hypothesis that these rows of the input are these guide stars."""
        match = Candidate(self.places(rows), np.asarray(stars), tolerance_px)
        self.searcher.judge(self.task, match)
        rotation, scale, _ = pose_parts(self.best)
        return Judged(self.searcher.score, rotation.copy(), scale)

    def weigh(self, rows, residual2, n_inside, *, scale=1.0, free=False):
        """How many of matches that are listed by hand carry most evidence, and its log10."""
        pose = pose_of(np.eye(3), scale, free)
        see_at_scale(self.frame, self.camera.focal_length_px, scale)
        residual2 = np.asarray(residual2, float)
        order = np.argsort(residual2, kind="stable")
        k = len(order)
        observed, _, _, listed2 = match_lists(self.matches)
        observed[:k], listed2[:k] = self.places(rows)[order], residual2[order]
        return strongest(self.sky, self.frame, pose, self.matches, (k, n_inside))

    def label(self, rotation=None, tolerance_px=2.0):
        """Label the frame at a rotation, by default the best one so far.

        Returns the identification and the rotation fitted.
        """
        self.task.labels = labels = blank_labels(self.n_rows)
        if rotation is not None:
            self.results.rotation[:] = rotation
            self.results.progress["tolerance_px"] = tolerance_px
        self.searcher.label(self.task)
        return identification_of(labels), self.results.rotation.copy()


def identification_of(labels):
    return Identification(
        labels["catalog_index"].copy(), labels["state"].copy(), labels["residual_px"].copy()
    )
