"""Two revisions: do they solve the same frames in the same way, bit for bit?.

    python benchmark/same_frames.py record FILE.npz     on one revision
    python benchmark/same_frames.py compare FILE.npz    on the other

FILE holds the frames and what came of them: status, labels, states, quaternion, covariance and
evidence of frames of all conditions and both cameras, with and without brightness, the parity told
and not told. A change that only moves code leaves all of it as it was; `compare` ends with exit
code 1 where it does not, and names the first frames that differ.
"""

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.maps.simulation import CAMERAS, CONDITIONS, frames
from star_tracker.solution import SolveSettings
from star_tracker.tracker import StarTracker

FRAMES_PER_CONDITION = 50
SEED = 20260


def cases(n: int) -> Iterator[tuple[str, StarTracker, np.ndarray, np.ndarray | None]]:
    """Yield a name, a tracker, centroids and intensities for each frame to solve."""
    database = FeatureDatabase.build(StarCatalog.paper())
    settings = SolveSettings(deadline_ms=float("inf"))
    for camera_name, camera in CAMERAS.items():
        trackers = {
            parity: StarTracker(database, camera.with_parity(parity), settings)
            for parity in ("normal", "auto")
        }
        for at, condition in enumerate(CONDITIONS):
            seed = np.random.SeedSequence([SEED, at])
            for i, frame in enumerate(frames(database.catalog, camera, condition, n, seed)):
                bright = 10 ** (-0.4 * frame.v_mag)
                for parity, tracker in trackers.items():
                    for intensity in (None, bright):
                        told = "plain" if intensity is None else "bright"
                        name = f"{camera_name} {condition.name} {i} {parity} {told}"
                        yield name, tracker, frame.xy_px, intensity


def results(n: int) -> dict[str, np.ndarray]:
    """Solve all frames; return what came of them as arrays by name."""
    names, parts = [], []
    for name, tracker, xy_px, intensity in cases(n):
        solution = tracker.solve(xy_px, intensity)
        found = solution.identification
        pose = np.full(13, np.nan)
        if solution.attitude is not None:
            pose[:4] = solution.attitude.quaternion_xyzw
            pose[4:] = solution.attitude.covariance_rad2.ravel()
        names.append(name)
        parts.append((
            solution.status.value, np.column_stack([
                found.catalog_index, found.state, found.residual_px,
            ]).ravel(), pose, solution.log10_false_alarms, solution.parity,
        ))
    return {
        "name": np.array(names),
        "status": np.array([part[0] for part in parts]),
        "labels_at": np.cumsum([0] + [len(part[1]) for part in parts]),
        "labels": np.concatenate([part[1] for part in parts]),
        "pose": np.array([part[2] for part in parts]),
        "evidence": np.array([part[3] for part in parts]),
        "parity": np.array([part[4] for part in parts]),
    }


def differing(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> list[str]:
    """Return the names of the frames that came out otherwise."""
    if not np.array_equal(before["name"], after["name"]):
        return ["the frames are not the same ones"]
    if not np.array_equal(before["labels_at"], after["labels_at"]):
        return ["the frames have other numbers of centroids"]
    same = before["status"] == after["status"]
    same &= before["parity"] == after["parity"]
    same &= before["evidence"] == after["evidence"]
    same &= np.all((before["pose"] == after["pose"]) | np.isnan(before["pose"]), axis=1)
    labels = (before["labels"] == after["labels"]) | (
        np.isnan(before["labels"]) & np.isnan(after["labels"])
    )
    same &= np.logical_and.reduceat(labels, before["labels_at"][:-1])
    return [str(name) for name in before["name"][~same]]


def main() -> int:
    """Record or compare; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("record", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--frames", type=int, default=FRAMES_PER_CONDITION)
    options = parser.parse_args()
    after = results(options.frames)
    if options.action == "record":
        np.savez_compressed(options.file, **after)
        print(f"{len(after['name'])} solutions recorded in {options.file}")
        return 0
    with np.load(options.file) as content:
        before = {name: content[name] for name in content.files}
    different = differing(before, after)
    for name in different[:10]:
        print(f"differs: {name}")
    n = len(after["name"])
    print(f"{n - len(different)} of {n} solutions are equal")
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
