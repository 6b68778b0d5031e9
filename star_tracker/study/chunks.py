"""Units of work: contestants on a block of frames, on a star map or on a real image.

A chunk says all that its result depends on, but for the sources: it gives the same result in any
process, in any order.
"""

import json
import threading
import time
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from hashlib import sha256
from importlib.metadata import version

import numpy as np

from star_tracker.maps.simulation import Condition, random_rotation, synthetic_field
from star_tracker.maps.star_map import paper_maps
from star_tracker.optics.camera import Camera
from star_tracker.resources import package_version, sources_digest
from star_tracker.study.contestants import Answer, Contestant, Entrant, Told
from star_tracker.study.scenes import Image, Scene, Sky, simulated

#: How a frame, or a star of a map, ended; other outcomes are the names of `Status`.
IDENTIFIED, WRONG, UNANSWERED = "IDENTIFIED", "WRONG", "UNANSWERED"
#: What stands for a camera's name where there is none.
MAPS, IMAGES = "maps", "real images"
#: The sources that a result depends on, beside those that are compiled.
_MEASURING = (
    "any_camera.py", "frame_solution.py", "solution.py", "tracker.py", "maps/simulation.py",
    "maps/star_map.py",
    *(f"study/{name}.py" for name in (
        "chunks", "contestants", "own_methods", "paper_forms", "peers", "scenes"
    )),
)
#: An entrant uses its memory again for each frame, and CPU time is that of the whole process: one
#: chunk at a time in each, also where a Dask worker has several threads.
_ONE_AT_A_TIME = threading.Lock()
_PAPER = Sky()


@dataclass(frozen=True)
class Outcomes:
    """What a chunk gave of one contestant.

    Attributes:
        outcomes: (n,) how each frame that it saw, or each star of a map, ended.
        error_deg: angle between the found and the true boresight of each frame, None = unsolved;
            empty for a map.
        cpu_ms: CPU time of each solve.
        n_true: guide stars among the centroids of each frame; empty where that is not known.
        nees: the boresight's squared error of each frame in units of the covariance that was told
            with it; None = unsolved, or none was told.
        storage_bytes: size of the features that were searched, None = not known.
    """

    storage_bytes: int | None
    outcomes: list[str] = field(default_factory=list)
    error_deg: list[float | None] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)
    n_true: list[int] = field(default_factory=list)
    nees: list[float | None] = field(default_factory=list)

    def add(self, scene: Scene, answer: Answer, cpu_ms: float, limit_deg: float) -> None:
        """Judge an answer: identified where the boresight is within the limit, else wrong."""
        self.cpu_ms.append(cpu_ms)
        if scene.n_true is not None:
            self.n_true.append(scene.n_true)
        if answer.rotation is None:
            self.error_deg.append(None)
            self.nees.append(None)
            self.outcomes.append(answer.ended)
            return
        error_deg = scene.error_deg(answer.rotation)
        self.error_deg.append(error_deg)
        covariance = answer.covariance_rad2
        self.nees.append(None if covariance is None else scene.nees(answer.rotation, covariance))
        # A rotation of NaN is no place in the sky: wrong.
        self.outcomes.append(IDENTIFIED if error_deg <= limit_deg else WRONG)


@dataclass(frozen=True)
class FramesChunk:
    """A block of frames of one condition.

    The frames follow from the seed and the names of camera and condition and the block's number,
    not from the contestants: all contestants see the same frames.

    Attributes:
        contestants: who sees them, in turn.
        camera_name, camera: who takes them.
        condition: what they suffer from.
        block: number of the block.
        first: number of its first frame.
        n: how many there are.
        seed: of the study.
        deadline_ms: wall-clock time for a frame.
        limit_deg: boresight error up to which a solution is right.
    """

    contestants: tuple[Contestant, ...]
    camera_name: str
    camera: Camera
    condition: Condition
    block: int
    first: int
    n: int
    seed: int
    deadline_ms: float
    limit_deg: float

    @property
    def place(self) -> tuple[str, str]:
        """Names of camera and condition, which the chunk's results count for."""
        return self.camera_name, self.condition.words

    def seed_sequence(self) -> np.random.SeedSequence:
        """Return the source of all chance of these frames."""
        name = json.dumps([self.camera_name, self.condition.words, self.block])
        words = np.frombuffer(sha256(name.encode()).digest(), ">u4")
        return np.random.SeedSequence(entropy=self.seed, spawn_key=tuple(words.tolist()))

    def solve(self) -> list[Outcomes]:
        """Solve the frames; return what became of each contestant."""
        told = Told.of(_PAPER, self.camera, self.condition, self.deadline_ms)
        scenes = simulated(_PAPER, self.camera, self.condition, self.n, self.seed_sequence())
        return compete(self.contestants, told, enumerate(scenes, self.first), self.limit_deg)


@dataclass(frozen=True)
class ImageChunk:
    """A real image, of whose camera the contestants are told what a condition says."""

    contestants: tuple[Contestant, ...]
    image: Image
    condition: Condition
    deadline_ms: float
    limit_deg: float

    @property
    def place(self) -> tuple[str, str]:
        """Names of camera and condition, which the chunk's results count for."""
        return IMAGES, self.condition.words

    def solve(self) -> list[Outcomes]:
        """Solve the image; return what became of each contestant."""
        camera = self.image.camera
        fov_min_deg = self.condition.fov_range_deg(camera)[0]
        sky = Sky.for_camera(Camera.from_fov(fov_min_deg, camera.width_px, camera.height_px))
        told = Told.of(sky, camera, self.condition, self.deadline_ms)
        return compete(self.contestants, told, [(0, self.image.scene())], self.limit_deg)


@dataclass(frozen=True)
class MapChunk:
    """One of the paper's star maps, whose labels are judged."""

    contestants: tuple[Contestant, ...]
    number: int
    deadline_ms: float
    repeats: int = 5

    @property
    def place(self) -> tuple[str, str]:
        """What stands for names of camera and condition."""
        return MAPS, f"map {self.number}"

    def solve(self) -> list[Outcomes]:
        """Solve the map several times and judge the labels of its stars."""
        star_map = paper_maps((self.number,))[0]
        told = Told.of(_PAPER, star_map.camera, Condition("map"), self.deadline_ms)
        scene = Scene(star_map.xy_px, None, np.full(3, np.nan))
        result = []
        for contestant in self.contestants:
            entrant = _set_up(contestant, told)
            timed_solve(entrant, scene)  # fills caches
            solved = [timed_solve(entrant, scene) for _ in range(self.repeats)]
            index = solved[-1][0].catalog_index
            if index is None:
                raise TypeError(f"{contestant.title} names no stars")
            numbers = np.where(index >= 0, _PAPER.catalog().number[index], 0)
            right = numbers == star_map.star_number
            outcomes = np.where(right, IDENTIFIED, np.where(numbers > 0, WRONG, UNANSWERED))
            result.append(Outcomes(
                entrant.storage_bytes, outcomes.tolist(), cpu_ms=[ms for _, ms in solved]
            ))
        return result


Chunk = FramesChunk | ImageChunk | MapChunk


def compete(
    contestants: tuple[Contestant, ...], told: Told, scenes: Iterable[tuple[int, Scene]],
    limit_deg: float,
) -> list[Outcomes]:
    """Let contestants solve numbered frames in turn, so that the machine's moods hit all alike."""
    entrants = [_set_up(one, told) for one in contestants]
    result = [Outcomes(entrant.storage_bytes) for entrant in entrants]
    for number, scene in scenes:
        for at in _turns(number, len(entrants)):
            if number % contestants[at].every == 0:
                result[at].add(scene, *timed_solve(entrants[at], scene), limit_deg)
    return result


def _turns(number: int, n: int) -> list[int]:
    """Return 0 to n in a frame's own order: who follows one like it finds the caches warm."""
    return [int(at) for at in np.random.default_rng(number).permutation(n)]


def timed_solve(entrant: Entrant, scene: Scene) -> tuple[Answer, float]:
    """Solve one frame; return the answer and the CPU time of the identifier's own call, ms."""
    given = entrant.prepare(scene)
    started = time.process_time_ns()
    result = entrant.solve(given)
    cpu_ms = (time.process_time_ns() - started) / 1e6
    return entrant.answer(result), cpu_ms


@lru_cache(maxsize=64)
def _set_up(contestant: Contestant, told: Told) -> Entrant:
    """Return an entrant whose caches are filled: the first frame that counts is like any other."""
    entrant = contestant.set_up(told)
    rng = np.random.default_rng(0)
    catalog = told.sky.catalog()
    for false_stars in (0.0, 1.0):
        easy = synthetic_field(
            catalog, told.camera.definite()[0], random_rotation(rng), rng,
            Condition(false_stars=false_stars),
        )
        brightness = 10.0 ** (-0.4 * easy.v_mag)
        timed_solve(entrant, Scene(easy.xy_px, brightness, easy.rotation[:, 2]))
    return entrant


def measuring_sources() -> str:
    """Name the sources that results depend on."""
    return sources_digest(*_MEASURING)


def run(chunk: Chunk, sources: str) -> list[Outcomes]:
    """Solve a chunk. Raises ValueError in a process that has other sources than these."""
    if sources != measuring_sources():
        raise ValueError(
            "a worker has another version of star_tracker: install the same one everywhere"
        )
    with _ONE_AT_A_TIME:
        return chunk.solve()


def key(chunk: Chunk) -> str:
    """Return the name of a chunk's result: of all that it depends on."""
    packages = {one.package for one in chunk.contestants if one.package}
    described = [
        type(chunk).__name__, [type(one).__name__ for one in chunk.contestants], asdict(chunk),
        package_version(), measuring_sources(), {name: version(name) for name in packages},
    ]
    return sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:24]
