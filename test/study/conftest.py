"""A small study that the tests of this folder share: run once, where a test needs its results."""

from functools import cached_property

import pytest
import yaml

from star_tracker.study import execution
from star_tracker.study.configuration import read_study
from star_tracker.study.plan import plan
from star_tracker.study.records import summarise
from star_tracker.study.store import Store

SMALL = {
    "frames": 3, "quick_frames": 1, "block_frames": 2, "seed": 7, "deadline_ms": float("inf"),
    "contestants": [{"method": "match_group"}, {"method": "match_group", "form": "paper"}],
    "cameras": ["12 deg", {"name": "wide", "fov_deg": 14, "width_px": 900, "height_px": 700}],
    "maps": [1, 3], "combined": ["comb"],
    "sweeps": {
        "noise_px": {"values": [0, 1]},
        "mirrored_sky_parity": {"values": ["normal", "auto"], "with": {"noise_px": 0.5}},
    },
}


def write(folder, content):
    path = folder / "study.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def run_here(chunks, folder, ran=None):
    """Run chunks in this process; those that the folder lacks are added to `ran`."""
    local = execution.local(1)

    def execute(missing):
        (ran if ran is not None else []).extend(missing)
        return local(missing)

    return execution.run_all(chunks, Store(folder), execute, lambda n: None)


class SmallStudy:
    """The study; and the folder of its chunks, their results and the records, for which it runs.

    Many tests ask for its plan only.
    """

    content, write, run_here = SMALL, staticmethod(write), staticmethod(run_here)

    def __init__(self, folder, chunks):
        self.study = read_study(write(folder, SMALL))
        self._chunks = chunks

    @cached_property
    def results(self):
        return run_here(plan(self.study), self._chunks)

    @property
    def folder(self):
        assert self.results
        return self._chunks

    @cached_property
    def records(self):
        return summarise(self.study, self.results)


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    return SmallStudy(tmp_path_factory.mktemp("study"), tmp_path_factory.mktemp("chunks"))
