"""Scenes of every kind of trouble, each with a seed of its own, for `wrong_solutions.py`."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import (
    CONDITIONS, Condition, frames, random_rotation, synthetic_field, uniform_noise
)
from star_tracker.optics.camera import Camera
from star_tracker.optics.distortion import Distortion

NOISE, MIRROR = "noise", "mirror"
#: Points of a noise scene, from and to (not included), and of a tight clump.
_NOISE_POINTS, _CLUMP_POINTS = (4, 61), (25, 41)
_NOISE_PX = 0.5
_TROUBLE = Condition("trouble", _NOISE_PX)


@dataclass(frozen=True)
class Troubled:
    """A scene: centroids (n, 2), pixels, and the true rotation, None where it shows no sky."""

    xy_px: Floats
    rotation: Floats | None
    condition: Condition = _TROUBLE


Maker = Callable[[Camera, StarCatalog, np.random.Generator], Troubled]


def _noise(camera: Camera, _: StarCatalog, rng: np.random.Generator) -> Troubled:
    return Troubled(uniform_noise(camera, int(rng.integers(*_NOISE_POINTS)), rng), None)


def _clump(camera: Camera, _: StarCatalog, rng: np.random.Generator) -> Troubled:
    """Nothing but a tight clump: a satellite's glint, a smudge, a hot corner."""
    n, width = int(rng.integers(*_CLUMP_POINTS)), camera.width_px
    middle = rng.uniform(0.2, 0.8, 2) * (width, camera.height_px)
    xy = middle + rng.normal(0, rng.uniform(0.01, 0.1) * width, (n, 2))
    return Troubled(np.clip(xy, 0, (width - 1, camera.height_px - 1)), None)


def _lines(camera: Camera, _: StarCatalog, rng: np.random.Generator) -> Troubled:
    """Points along one to three lines, as streaks and power lines leave them."""
    parts = []
    for _line in range(int(rng.integers(1, 4))):
        start, end = uniform_noise(camera, 2, rng)
        n = int(rng.integers(6, 16))
        even = rng.random() < 0.5
        along = np.linspace(0, 1, n) if even else rng.random(n)
        parts.append(start + along[:, None] * (end - start) + rng.normal(0, 0.3, (n, 2)))
    xy = np.concatenate(parts)
    return Troubled(xy[camera.contains(xy)], None)


def _grid(camera: Camera, _: StarCatalog, rng: np.random.Generator) -> Troubled:
    """A regular grid of any angle, with some of its points missing."""
    step = rng.uniform(0.08, 0.25) * camera.width_px
    turn = rng.uniform(0, np.pi / 2)
    at = np.stack(np.meshgrid(*[np.arange(-12, 13)] * 2), -1).reshape(-1, 2) * step
    c, s = np.cos(turn), np.sin(turn)
    xy = at @ np.array([[c, s], [-s, c]]) + uniform_noise(camera, 1, rng)
    xy = xy[camera.contains(xy)]
    kept = rng.random(len(xy)) < rng.uniform(0.7, 1.0)
    return Troubled(xy[kept] + rng.normal(0, 0.2, (int(kept.sum()), 2)), None)


def _other_stars(camera: Camera, catalog: StarCatalog, rng: np.random.Generator) -> Troubled:
    """A sky of as many stars, that is not ours: the field turned star by star about itself."""
    frame = synthetic_field(
        catalog, camera, random_rotation(rng), rng, Condition(noise_px=_NOISE_PX)
    )
    n = len(frame.xy_px)
    # The same magnitudes and density, other places: each quadrant is another part of the sky.
    xy = np.empty((0, 2))
    for quadrant in range(4):
        part = synthetic_field(
            catalog, camera, random_rotation(rng), rng, Condition(noise_px=_NOISE_PX)
        )
        side = np.array([quadrant % 2, quadrant // 2])
        size = np.array([camera.width_px, camera.height_px])
        mine = np.all((part.xy_px // (size / 2)).astype(int) == side, axis=1)
        few = part.xy_px[mine][: max(1, min(2, n // 4))]
        xy = np.concatenate([xy, few])
    return Troubled(xy, None)


def _mirror(camera: Camera, catalog: StarCatalog, rng: np.random.Generator) -> Troubled:
    """A true sky in a mirror, for a camera that is said not to have one."""
    seen = synthetic_field(
        catalog, camera, random_rotation(rng), rng, Condition(noise_px=_NOISE_PX)
    ).xy_px
    return Troubled(seen * (1, -1) + (0, camera.height_px), None)


def _scale(camera: Camera, catalog: StarCatalog, rng: np.random.Generator) -> Troubled:
    """A field of view that is up to 10 % another than was told."""
    true = camera.scaled(1 + rng.uniform(-0.1, 0.1))
    frame = synthetic_field(
        catalog, true, random_rotation(rng), rng, Condition(noise_px=_NOISE_PX)
    )
    return Troubled(frame.xy_px, frame.rotation)


def _lens(camera: Camera, catalog: StarCatalog, rng: np.random.Generator) -> Troubled:
    """A lens that bends, of which nothing was told."""
    bent = Distortion("plumb_bob", (float(rng.uniform(-0.3, 0.1)), 0.0, 0.0, 0.0, 0.0))
    frame = synthetic_field(
        catalog, replace(camera, distortion=bent), random_rotation(rng), rng,
        Condition(noise_px=_NOISE_PX),
    )
    return Troubled(frame.xy_px, frame.rotation)


def _planets(camera: Camera, catalog: StarCatalog, rng: np.random.Generator) -> Troubled:
    """Up to five planets near one line, as the ecliptic has them, among the stars."""
    frame = synthetic_field(
        catalog, camera, random_rotation(rng), rng, Condition(noise_px=_NOISE_PX)
    )
    start, end = uniform_noise(camera, 2, rng)
    along = rng.random((int(rng.integers(1, 6)), 1))
    return Troubled(np.concatenate([frame.xy_px, start + along * (end - start)]), frame.rotation)


def _condition(condition: Condition) -> Maker:
    def make(camera: Camera, catalog: StarCatalog, rng: np.random.Generator) -> Troubled:
        seed = np.random.SeedSequence(int(rng.integers(2**62)))
        frame = next(frames(catalog, camera, condition, 1, seed))
        return Troubled(frame.xy_px, frame.rotation, condition)
    return make


#: All kinds of scenes by name.
KINDS: dict[str, Maker] = {
    **{condition.name: _condition(condition) for condition in CONDITIONS},
    NOISE: _noise, "clump": _clump, "lines": _lines, "grid": _grid, "other stars": _other_stars,
    MIRROR: _mirror, "scale": _scale, "lens": _lens, "planets": _planets,
}
#: Those that show no sky, or none that is to be found.
NO_SKY = frozenset({NOISE, "clump", "lines", "grid", "other stars", MIRROR})
