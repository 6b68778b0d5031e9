"""Units of work: a contestant on a block of frames of one condition, or on a star map.

A chunk says all that its result depends on, but for the sources: it gives the same result in any
process, in any order.
"""

import json
import threading
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache, lru_cache
from hashlib import sha256
from xml.etree import ElementTree as ET

import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.maps.simulation import random_rotation, synthetic_field
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.resources import resource_path, sources_digest
from star_tracker.solution import Status
from star_tracker.study.configuration import Study
from star_tracker.study.contestants import Contestant
from star_tracker.study.scoring import boresight_error_deg, score_map, timed_solve
from star_tracker.study.troubles import COMBINED, Trouble
from star_tracker.tracker import StarTracker

#: How a frame, or a star of a map, ended; other outcomes are the names of `Status`.
IDENTIFIED, WRONG, UNANSWERED = "IDENTIFIED", "WRONG", "UNANSWERED"
MAPS = "maps"
_MAP_REPEATS = 5
#: A tracker uses its memory again for each frame, and CPU time is that of the whole process: one
#: chunk at a time in each, also where a Dask worker has several threads.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True)
class Outcomes:
    """What a chunk gave.

    Attributes:
        outcomes: (n,) how each frame, or each star of a map, ended.
        error_deg: angle between the found and the true boresight of each frame, None = unsolved;
            empty for a map.
        cpu_ms: CPU time of each solve.
        storage_bytes: size of the features that were searched.
    """

    outcomes: list[str]
    error_deg: list[float | None]
    cpu_ms: list[float]
    storage_bytes: int


@dataclass(frozen=True)
class FramesChunk:
    """A block of frames of one condition.

    The frames follow from the seed and the names of camera and condition and the block's number,
    not from the contestant: all contestants see the same frames.
    """

    contestant: Contestant
    camera_name: str
    camera: Camera
    condition: Trouble
    block: int
    n: int
    seed: int
    deadline_ms: float

    @property
    def cell(self) -> tuple[str, str, str]:
        """Names of contestant, camera and condition: what the chunk's result counts for."""
        return self.contestant.name, self.camera_name, self.condition.name

    def seed_sequence(self) -> np.random.SeedSequence:
        """Return the source of all chance of these frames."""
        name = json.dumps([self.camera_name, self.condition.name, self.block])
        words = np.frombuffer(sha256(name.encode()).digest(), ">u4")
        return np.random.SeedSequence(entropy=self.seed, spawn_key=tuple(words.tolist()))

    def solve(self) -> Outcomes:
        """Solve the frames."""
        told = self.condition.told_camera(self.camera)
        tracker = _tracker(self.contestant, told, self.deadline_ms)
        limit_deg = self.condition.correct_deg(self.camera)
        result = Outcomes([], [], [], self.contestant.storage_bytes(database()))
        catalog = tracker.database.catalog
        for frame, intensity in self.condition.frames(
            catalog, self.camera, self.n, self.seed_sequence()
        ):
            solution, cpu_ms = timed_solve(tracker, frame.xy_px, intensity)
            result.cpu_ms.append(cpu_ms)
            if solution.status is Status.SOLVED:
                error_deg = boresight_error_deg(solution, frame)
                result.error_deg.append(error_deg)
                result.outcomes.append(IDENTIFIED if error_deg <= limit_deg else WRONG)
            else:
                result.error_deg.append(None)
                result.outcomes.append(solution.status.value)
        return result


@dataclass(frozen=True)
class MapChunk:
    """One of the paper's star maps, whose labels are judged."""

    contestant: Contestant
    number: int
    deadline_ms: float

    @property
    def cell(self) -> tuple[str, str, str]:
        """Names of contestant, camera and condition: what the chunk's result counts for."""
        return self.contestant.name, MAPS, f"map {self.number}"

    def solve(self) -> Outcomes:
        """Solve the map several times and judge the labels of its stars."""
        star_map = paper_maps((self.number,))[0]
        tracker = _tracker(self.contestant, star_map.camera, self.deadline_ms)
        score = score_map(tracker, star_map, _MAP_REPEATS)
        counts = {
            IDENTIFIED: score.n_correct, WRONG: score.n_wrong,
            UNANSWERED: score.n - score.n_correct - score.n_wrong,
        }
        outcomes = [name for name, count in counts.items() for _ in range(count)]
        bytes_ = self.contestant.storage_bytes(database())
        return Outcomes(outcomes, [], score.cpu_ms.tolist(), bytes_)


Chunk = FramesChunk | MapChunk


def run(chunk: Chunk, sources: str) -> Outcomes:
    """Solve a chunk. Raises ValueError in a process that has other sources than these."""
    if sources != sources_digest():
        raise ValueError(
            "a worker has another version of star_tracker: install the same one everywhere"
        )
    with _ONE_AT_A_TIME:
        return chunk.solve()


def key(chunk: Chunk) -> str:
    """Return the name of a chunk's result: of all that it depends on."""
    described = [type(chunk).__name__, asdict(chunk), version(), sources_digest()]
    return sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:24]


def plan(study: Study) -> list[Chunk]:
    """Return all chunks of a study, none of them twice."""
    chunks: list[Chunk] = [
        MapChunk(contestant, number, study.deadline_ms)
        for number in study.maps for contestant in study.contestants
    ]
    for condition in conditions(study):
        for camera_name, camera in study.cameras:
            for contestant in study.contestants:
                chunks += [
                    FramesChunk(
                        contestant, camera_name, camera, condition, block, n, study.seed,
                        study.deadline_ms,
                    )
                    for block, n in _blocks(study)
                ]
    return chunks


def conditions(study: Study) -> list[Trouble]:
    """Return the conditions of all sweeps and the combined ones; many sweeps share their first."""
    swept = [sweep.trouble(value) for sweep in study.sweeps for value in sweep.values]
    return list(dict.fromkeys([*swept, *(COMBINED[name] for name in study.combined)]))


def _blocks(study: Study) -> Iterator[tuple[int, int]]:
    """Yield number and size of each block of frames; only the last may be smaller."""
    size = study.block_frames
    for block, first in enumerate(range(0, study.frames, size)):
        yield block, min(size, study.frames - first)


@cache
def version() -> str:
    """Return the package's version."""
    root = ET.parse(resource_path("package.xml")).getroot()
    return root.findtext("version", "")


@cache
def database() -> FeatureDatabase:
    """Return the features of the paper's catalogue, once in each process."""
    return FeatureDatabase.cached(StarCatalog.paper())


@lru_cache(maxsize=32)
def _tracker(contestant: Contestant, camera: Camera, deadline_ms: float) -> StarTracker:
    """Return a tracker whose caches are filled: the first frame that counts is like any other."""
    tracker = StarTracker(database(), camera, contestant.settings(deadline_ms))
    rng = np.random.default_rng(0)
    easy = synthetic_field(
        tracker.database.catalog, camera.definite()[0], random_rotation(rng), rng
    )
    tracker.solve(easy.xy_px)
    return tracker
