"""Is a solution wrong when it claims not to be? Many scenes of every kind, and what was claimed.

`python benchmark/wrong_solutions.py --scenes 100000` solves scenes of all conditions, of pure
noise and of skies seen in a mirror, in equal parts for both cameras, and counts wrong solutions
(boresight more than 0.1 deg off, or four times the noise if that is more; of noise and mirrored
skies every one). `--threshold 0` accepts all that is more likely true than not and shows how the
claimed wrong-identification probability holds; `--plot FILE` draws that. Each scene has a seed of
its own, so that any one of them can be looked at again; the command prints them.
"""

import argparse
import os
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
from rich.console import Console
from rich.progress import track

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.maps.simulation import (
    CAMERAS, CONDITIONS, Condition, boresight_angle_deg, frames, uniform_noise
)
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

NOISE, MIRROR = "noise", "mirror"
#: Points of a noise scene, from and to (not included).
_NOISE_POINTS = (4, 61)
_CHUNK = 200
#: Edges of the bins of the claimed wrong-identification probability.
_EDGES = 10.0 ** np.arange(-6, 0.5)


@dataclass(frozen=True)
class Outcome:
    """How one scene ended: `right`, `wrong` or the status of an unsolved one."""

    seed: int
    camera: str
    kind: str
    verdict: str
    claimed: float


def scene_kinds() -> list[tuple[str, str, Condition | None]]:
    """Return camera, name and condition of every kind of scene; noise has no condition."""
    return [
        (camera, kind, condition)
        for camera in CAMERAS
        for kind, condition in (
            *((c.name, c) for c in CONDITIONS),
            (NOISE, None), (MIRROR, Condition(MIRROR, 0.5)),
        )
    ]


def outcomes(seeds: range, threshold: float, deadline_ms: float, method: str) -> list[Outcome]:
    """Solve the scenes of these seeds."""
    kinds, database = scene_kinds(), FeatureDatabase.build(StarCatalog.paper())
    settings = SolveSettings(
        method=method, max_log10_false_alarms=threshold, deadline_ms=deadline_ms
    )
    trackers = {
        (camera, parity): StarTracker(database, CAMERAS[camera].with_parity(parity), settings)
        for camera in CAMERAS for parity in ("normal", "mirrored")
    }
    result = []
    for seed in seeds:
        camera, kind, condition = kinds[seed % len(kinds)]
        rng = np.random.default_rng(seed)
        tracker = trackers[camera, "mirrored" if kind == MIRROR else "normal"]
        if condition is None:
            frame = None
            xy = uniform_noise(CAMERAS[camera], int(rng.integers(*_NOISE_POINTS)), rng)
        else:
            frame = next(frames(database.catalog, CAMERAS[camera], condition, 1, seed))
            xy = frame.xy_px
        solution = tracker.solve(xy)
        verdict = solution.status.value
        if solution.attitude is not None:
            good = frame is not None and condition is not None and kind != MIRROR
            good = good and boresight_angle_deg(
                solution.attitude.rotation, frame.rotation
            ) <= condition.correct_deg(CAMERAS[camera])
            verdict = "right" if good else "wrong"
        result.append(Outcome(seed, camera, kind, verdict, solution.wrong_probability))
    return result


def run(n: int, first: int, work: partial[list[Outcome]]) -> Iterator[Outcome]:
    """Yield the outcomes of `n` scenes, solved by all processors."""
    chunks = [range(at, min(at + _CHUNK, first + n)) for at in range(first, first + n, _CHUNK)]
    console = Console(stderr=True)
    with ProcessPoolExecutor() as pool:
        parts = pool.map(work, chunks)
        for part in track(
            parts, "solving", len(chunks), console=console, disable=not console.is_terminal
        ):
            yield from part


def print_counts(found: list[Outcome]) -> None:
    """Print a line for each camera and kind of scene, and each wrong one's seed."""
    counts = Counter((o.camera, o.kind, o.verdict) for o in found)
    verdicts = sorted({o.verdict for o in found}, key=lambda v: (v != "right", v != "wrong", v))
    print(f"{'':>16}" + "".join(f"{v:>15}" for v in verdicts))
    for camera, kind, _ in scene_kinds():
        row = "".join(f"{counts[camera, kind, v]:>15}" for v in verdicts)
        print(f"{camera + ' ' + kind:>16}{row}")
    for o in found:
        if o.verdict == "wrong":
            print(f"WRONG: seed {o.seed}, {o.camera} {o.kind}, claimed {o.claimed:.1e}")


def reliability(found: list[Outcome]) -> list[tuple[float, float, int, int]]:
    """Return of each bin with solutions: lower edge, mean claim, solutions, wrong ones."""
    solved = [o for o in found if o.verdict in ("right", "wrong")]
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


def plot(rows: list[tuple[float, float, int, int]], path: Path) -> None:
    """Draw measured over claimed probability, with 95 % intervals (Wilson 1927)."""
    import matplotlib  # noqa: PLC0415 - only for those who want a picture

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    from star_tracker.study.records import wilson  # noqa: PLC0415

    figure, axes = plt.subplots(figsize=(5.6, 4.6), layout="constrained")
    axes.plot([1e-9, 1], [1e-9, 1], color="0.6", linestyle="--", label="claim = truth")
    for _, mean, n, wrong in rows:
        at, (low, high) = max(mean, 1e-8), wilson(wrong, n)
        axes.plot([at, at], [max(low, 1e-6), high], color="0.2")
        if wrong:
            axes.plot(at, wrong / n, "o", color="0.1")
        else:
            axes.plot(at, high, "v", color="0.1", markerfacecolor="white")
    axes.plot([], [], "o", color="0.1", label="measured, 95 % interval")
    axes.plot([], [], "v", color="0.1", markerfacecolor="white", label="none wrong: 95 % limit")
    axes.set(
        xscale="log", yscale="log", xlim=(5e-9, 1), ylim=(1e-6, 1),
        xlabel="claimed wrong-identification probability", ylabel="measured share of wrong ones",
    )
    axes.legend()
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
    parser.add_argument("--plot", type=Path, help="draw claimed against measured")
    options = parser.parse_args()
    work = partial(
        outcomes, threshold=options.threshold, deadline_ms=options.deadline_ms,
        method=options.method,
    )
    found = list(run(options.scenes, options.seed, work))
    print_counts(found)
    rows = reliability(found)
    print_reliability(rows)
    n_wrong = sum(o.verdict == "wrong" for o in found)
    last = options.seed + options.scenes - 1
    print(f"{len(found)} scenes, seeds {options.seed} to {last}: {n_wrong} wrong")
    if options.plot:
        plot(rows, options.plot)
    return int(n_wrong > 0 and options.threshold <= default.max_log10_false_alarms)


if __name__ == "__main__":
    sys.exit(main())
