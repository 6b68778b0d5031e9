"""The peers as contestants: their adapters, and what is told where one is missing."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from star_tracker.maps.simulation import CAMERAS, Condition, boresight_angle_deg, frames
from star_tracker.study.chunks import timed_solve
from star_tracker.study.configuration import read_study
from star_tracker.study.contestants import Told
from star_tracker.study.own_methods import OwnMethod
from star_tracker.study.peers import PEERS, RustStarTracker, Tetra3
from star_tracker.study.plan import installed
from star_tracker.study.quantities import condition_of
from star_tracker.study.scenes import Scene, Sky

CAMERA = CAMERAS["12 deg"]
CONTESTANTS = (
    OwnMethod(), Tetra3("exact"), Tetra3("coarse", pattern_max_error=0.01),
    Tetra3("dark", brightness=False, pattern_max_error=0.01), RustStarTracker(),
)


def solved(contestant, camera, condition, n=4):
    """The rotations that a contestant finds, with the true ones."""
    sky = Sky()
    entrant = contestant.set_up(Told.of(sky, camera, condition, 1000.0))
    for frame in frames(sky.catalog(), camera, condition, n, 2019):
        scene = Scene(frame.xy_px, 10 ** (-0.4 * frame.v_mag), frame.rotation[:, 2])
        answer, cpu_ms = timed_solve(entrant, scene)
        assert cpu_ms > 0
        if answer.rotation is not None:
            yield answer.rotation, frame.rotation


@pytest.mark.parametrize("parity", ["normal", "mirrored"])
@pytest.mark.parametrize("contestant", CONTESTANTS, ids=lambda one: one.title)
def test_every_contestant_solves_clean_frames_of_either_parity(contestant, parity):
    """What fails here is an adapter: its origin, axes, handedness or direction of the rotation."""
    if contestant.package:
        pytest.importorskip(contestant.package)
    found = list(solved(contestant, CAMERA.with_parity(parity), Condition("clean")))
    for rotation, true in found:
        np.testing.assert_allclose(rotation, true, atol=1e-3)
    # Without brightness tetra3rs misses a clean frame now and then.
    assert len(found) >= 3


@pytest.mark.parametrize("error", [5.0, pytest.param("unknown", marks=pytest.mark.slow)])
def test_tetra3rs_has_patterns_for_the_fields_of_view_that_are_told(error):
    pytest.importorskip("tetra3rs")
    condition = condition_of({"fov_error_percent": error})
    contestant = Tetra3("any", pattern_max_error=0.01)
    assert contestant.declines(condition) == ""
    found = list(solved(contestant, CAMERA, condition))
    assert len(found) >= 2
    assert all(boresight_angle_deg(*pair) < 0.02 for pair in found)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({}, ""), ({"lens_k1": -0.2}, ""),
        ({"fov_error_percent": 5.0}, "it takes no tolerance of the field of view"),
        ({"fov_error_percent": "unknown"}, "it needs a field of view"),
        ({"mirrored_sky_parity": "auto"}, "it needs the parity"),
    ],
)
def test_what_ruststartracker_declines(values, reason):
    assert RustStarTracker().declines(condition_of(values)) == reason


def test_a_package_that_is_not_installed_is_left_out_with_one_sentence(small, monkeypatch):
    monkeypatch.setitem(sys.modules, "tetra3rs", None)
    study = replace(small.study, contestants=(Tetra3("a"), OwnMethod(), Tetra3("b")))
    present, notes = installed(study)
    assert present.contestants == (OwnMethod(),)
    assert notes == [
        "tetra3rs is left out: import of tetra3rs halted; None in sys.modules; "
        "pip install tetra3rs typing-extensions"
    ]
    with pytest.raises(ValueError, match="tetra3rs is left out"):
        installed(replace(study, contestants=(Tetra3("a"),)))


def test_reading_a_study_of_peers_imports_none(small, tmp_path, monkeypatch):
    for package in PEERS:
        monkeypatch.setitem(sys.modules, package, None)
    peers = [{"peer": package} for package in PEERS]
    study = read_study(small.write(tmp_path, {**small.content, "contestants": peers}))
    assert [one.title for one in study.contestants] == list(PEERS)
