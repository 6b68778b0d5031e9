"""Is a solution wrong when it claims not to be? Many scenes of every kind, and what was claimed.

`python benchmark/wrong_solutions.py --scenes 100000` solves scenes of all conditions and of all
troubles (`trouble.py`: noise, clumps, lines, grids, other stars, mirrored skies, a wrong scale or
lens, planets), in equal parts for both cameras, and counts wrong solutions: off by more than
0.1 deg, or four times the noise if that is more, **and** by more than the covariance allows in
one of 10,000 frames; of what shows no sky every one. `off` is off by the first and not by the
second. `--camera told` is told the field of view within 10 %, `--camera any` nothing about it;
`--camera tracking` knows it and predicts the attitude, of half of the scenes that show a sky
within 0.1 deg, of the others at random; `--camera tracking-told` is that with the field of view
told within 10 %; several go by commas.
`--threshold 0` accepts all that is more likely true than not and shows how the claimed
wrong-identification probability holds; `--plot FILE` draws that. Each scene has a seed of its own,
so that any one of them can be looked at again; the command prints them.
"""

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.spatial.transform import Rotation

from trouble import KINDS, MIRROR, NO_SKY, NOISE, Troubled

from star_tracker.any_camera import AnyCameraTracker
from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.ladder import ladder
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import CAMERAS, boresight_angle_deg, random_rotation
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution, SolveSettings
from star_tracker.tracker import StarTracker

__all__ = ["KINDS", "MIRROR", "NOISE", "NO_SKY", "Asked", "outcomes"]

_CHUNK = 200
#: Edges of the bins of the claimed wrong-identification probability.
_EDGES = 10.0 ** np.arange(-6, 0.5)
#: What a camera can be, and how far off its field of view may be then.
EXACT, TOLD, ANY, TRACKING, TRACKING_TOLD = CAMERA_KINDS = (
    "exact", "told", "any", "tracking", "tracking-told"
)
#: Standard deviation of a good prediction about each axis.
_PREDICTED_RAD = float(np.radians(0.1))
_TOLERANCE_PERCENT = 10.0
#: The 99.99 % bound of chi-square with 3 degrees of freedom.
_NEES_BOUND = 21.1


@dataclass(frozen=True)
class Asked:
    """How the scenes are solved, and which: all kinds, or those that are named."""

    threshold: float
    deadline_ms: float
    method: str = "auto"
    camera: str = EXACT
    kinds: tuple[str, ...] = tuple(KINDS)
    parity: str = ""

    def tracker(self, camera: Camera, database: FeatureDatabase) -> StarTracker | AnyCameraTracker:
        """Return what solves the scenes of a camera."""
        settings = SolveSettings(
            method=self.method, max_log10_false_alarms=self.threshold,
            deadline_ms=self.deadline_ms,
        )
        camera = camera.with_parity(self.parity or camera.parity)
        if self.camera == ANY:
            steps = ladder((4.0, 70.0), (camera.width_px, camera.height_px), catalog="paper")
            return AnyCameraTracker(steps, settings, parity=camera.parity)
        tolerance = _TOLERANCE_PERCENT if self.camera in (TOLD, TRACKING_TOLD) else 0.0
        return StarTracker(database, replace(camera, tolerance_percent=tolerance), settings)

    def solution(
        self, tracker: StarTracker | AnyCameraTracker, scene: Troubled, seed: int
    ) -> Solution:
        """Solve a scene."""
        predicts = self.camera in (TRACKING, TRACKING_TOLD)
        if not predicts or not isinstance(tracker, StarTracker):
            return tracker.solve(scene.xy_px)
        rng = np.random.default_rng([seed, 1])
        predicted = random_rotation(rng)
        if scene.rotation is not None and rng.random() < 0.5:
            off = Rotation.from_rotvec(rng.normal(0, _PREDICTED_RAD, 3)).as_matrix()
            predicted = scene.rotation @ off
        return tracker.solve(scene.xy_px, predicted=predicted)


@dataclass(frozen=True)
class Outcome:
    """How one scene ended: `right`, `off`, `wrong` or the status of an unsolved one."""

    seed: int
    camera: str
    kind: str
    verdict: str
    claimed: float


def outcomes(seeds: range, asked: Asked) -> list[Outcome]:
    """Solve the scenes of these seeds."""
    database = FeatureDatabase.build(StarCatalog.paper())
    kinds = [(camera, kind) for camera in CAMERAS for kind in asked.kinds]
    trackers = {name: asked.tracker(camera, database) for name, camera in CAMERAS.items()}
    result = []
    for seed in seeds:
        camera, kind = kinds[seed % len(kinds)]
        scene = KINDS[kind](CAMERAS[camera], database.catalog, np.random.default_rng(seed))
        solution = asked.solution(trackers[camera], scene, seed)
        verdict = solution.status.value
        if solution.attitude is not None:
            limit_deg = scene.condition.correct_deg(CAMERAS[camera])
            verdict = _verdict(solution, scene.rotation, limit_deg)
        result.append(Outcome(seed, camera, kind, verdict, solution.wrong_probability))
    return result


def _verdict(solution: Solution, true: Floats | None, limit_deg: float) -> str:
    """Judge a solved frame."""
    attitude = solution.attitude
    if true is None or attitude is None:
        return "wrong"
    if boresight_angle_deg(attitude.rotation, true) <= limit_deg:
        return "right"
    error = Rotation.from_matrix(attitude.rotation.T @ true).as_rotvec()
    nees = error @ np.linalg.solve(attitude.covariance_rad2, error)
    return "off" if nees < _NEES_BOUND else "wrong"


def run(n: int, first: int, work: partial[list[Outcome]]) -> Iterator[Outcome]:
    """Yield the outcomes of `n` scenes, solved by all processors that it may use."""
    chunks = [range(at, min(at + _CHUNK, first + n)) for at in range(first, first + n, _CHUNK)]
    console = Console(stderr=True)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        parts = pool.map(work, chunks)
        for part in track(
            parts, "solving", len(chunks), console=console, disable=not console.is_terminal
        ):
            yield from part


def print_counts(found: list[Outcome], kinds: Sequence[str]) -> None:
    """Print a line for each camera and kind of scene, and each wrong one's seed."""
    counts = Counter((o.camera, o.kind, o.verdict) for o in found)
    first = ("right", "off", "wrong")
    verdicts = [v for v in first if any(o.verdict == v for o in found)]
    verdicts += sorted({o.verdict for o in found} - set(first))
    print(f"{'':>20}" + "".join(f"{v:>15}" for v in verdicts))
    for camera in CAMERAS:
        for kind in kinds:
            row = "".join(f"{counts[camera, kind, v]:>15}" for v in verdicts)
            print(f"{camera + ' ' + kind:>20}{row}")
    for o in found:
        if o.verdict == "wrong":
            print(f"WRONG: seed {o.seed}, {o.camera} {o.kind}, claimed {o.claimed:.1e}")


def reliability(found: list[Outcome]) -> list[tuple[float, float, int, int]]:
    """Return of each bin with solutions: lower edge, mean claim, solutions, wrong ones."""
    solved = [o for o in found if o.verdict in ("right", "off", "wrong")]
    claimed = np.array([o.claimed for o in solved])
    wrong = np.array([o.verdict == "wrong" for o in solved])
    bins = np.digitize(claimed, _EDGES)
    return [
        (
            0.0 if b == 0 else float(_EDGES[b - 1]), float(claimed[bins == b].mean()),
            int(np.sum(bins == b)), int(wrong[bins == b].sum()),
        )
        for b in np.unique(bins)
    ]


def print_reliability(rows: list[tuple[float, float, int, int]]) -> None:
    """Print what was claimed and what was measured."""
    print(f"{'claimed from':>14}{'mean claim':>14}{'solutions':>12}{'wrong':>8}{'measured':>12}")
    for low, mean, n, wrong in rows:
        print(f"{low:>14.0e}{mean:>14.1e}{n:>12}{wrong:>8}{wrong / n:>12.1e}")


def plot(measured: dict[str, list[tuple[float, float, int, int]]], path: Path) -> None:
    """Draw measured over claimed probability by camera, with 95 % intervals (Wilson 1927)."""
    import matplotlib  # noqa: PLC0415 - only for those who want a picture

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    from star_tracker.study.records import wilson  # noqa: PLC0415

    figure, every = plt.subplots(
        1, len(measured), figsize=(1.2 + 3.6 * len(measured), 4.2), layout="constrained",
        sharey=True, squeeze=False,
    )
    for axes, (camera, rows) in zip(every[0], measured.items(), strict=True):
        axes.plot([1e-9, 1], [1e-9, 1], color="0.6", linestyle="--", label="claim = truth")
        for _, mean, n, wrong in rows:
            at, (low, high) = max(mean, 1e-8), wilson(wrong, n)
            axes.plot([at, at], [max(low, 1e-6), high], color="0.2")
            if wrong:
                axes.plot(at, wrong / n, "o", color="0.1")
            else:
                axes.plot(at, high, "v", color="0.1", markerfacecolor="white")
        axes.set(xscale="log", yscale="log", xlim=(5e-9, 1), ylim=(1e-6, 1), title=camera)
    last = every[0, -1]
    last.plot([], [], "o", color="0.1", label="measured, 95 % interval")
    last.plot([], [], "v", color="0.1", markerfacecolor="white", label="none wrong: 95 % limit")
    last.legend(loc="lower right")
    every[0, 0].set_ylabel("measured share of wrong ones")
    figure.supxlabel("claimed wrong-identification probability", fontsize="medium")
    figure.savefig(path, dpi=110)


def main() -> int:
    """Run the scenes; the exit code is 1 where a solution was wrong at the default threshold."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--scenes", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0, help="seed of the first scene")
    default = SolveSettings()
    parser.add_argument("--threshold", type=float, default=default.max_log10_false_alarms)
    parser.add_argument("--deadline-ms", type=float, default=default.deadline_ms)
    parser.add_argument("--method", default=default.method)
    parser.add_argument("--camera", default=EXACT, help=f"of {', '.join(CAMERA_KINDS)}, by commas")
    parser.add_argument("--parity", default="", help="in place of the cameras' own")
    parser.add_argument(
        "--kinds", default=",".join(KINDS), help="of scenes, by commas; no-sky = all without sky"
    )
    parser.add_argument("--plot", type=Path, help="draw claimed against measured")
    options = parser.parse_args()
    names = NO_SKY if options.kinds == "no-sky" else options.kinds.split(",")
    kinds = tuple(kind for kind in KINDS if kind in names)
    unknown = sorted(set(names) - set(kinds))
    if unknown:
        parser.error(f"there are no scenes {', '.join(unknown)}: choose from {', '.join(KINDS)}")
    cameras = options.camera.split(",")
    if not set(cameras) <= set(CAMERA_KINDS):
        parser.error(f"--camera {options.camera}: choose from {', '.join(CAMERA_KINDS)}")
    measured, n_wrong = {}, 0
    for camera in cameras:
        asked = Asked(
            options.threshold, options.deadline_ms, options.method, camera, kinds, options.parity
        )
        found = list(run(options.scenes, options.seed, partial(outcomes, asked=asked)))
        print(f"camera: {camera}")
        print_counts(found, kinds)
        measured[camera] = reliability(found)
        print_reliability(measured[camera])
        wrong = sum(o.verdict == "wrong" for o in found)
        last = options.seed + options.scenes - 1
        print(f"{len(found)} scenes, seeds {options.seed} to {last}: {wrong} wrong", flush=True)
        n_wrong += wrong
    if options.plot:
        plot(measured, options.plot)
    return int(n_wrong > 0 and options.threshold <= default.max_log10_false_alarms)


if __name__ == "__main__":
    sys.exit(main())
