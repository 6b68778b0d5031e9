"""A study's conditions in the order of its report, and the work that they mean."""

import importlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

from star_tracker.maps.simulation import CORRECT_DEG, Condition
from star_tracker.study.chunks import IMAGES, MAPS, Chunk, FramesChunk, ImageChunk, MapChunk
from star_tracker.study.configuration import Study, Sweep
from star_tracker.study.contestants import Contestant
from star_tracker.study.quantities import NAMED, Value
from star_tracker.study.scenes import Image

#: Names of what is no sweep: the star maps, and the conditions with names of their own.
MAP, COMBINED = "map", "combined"


@dataclass(frozen=True)
class Place:
    """Where records stand: all of them but the contestant.

    Attributes:
        camera: name of the camera, `MAPS` or `IMAGES`.
        sweep: the quantity that is varied, `COMBINED` or `MAP`.
        value: its value, the name of the condition or the number of the map.
        condition: what the frames suffer from.
        tolerance_deg: boresight error up to which a solution is right; None for a map.
    """

    camera: str
    sweep: str
    value: Value
    condition: Condition
    tolerance_deg: float | None = None

    def takes_part(self, contestant: Contestant) -> bool:
        """Return whether a contestant can be measured here."""
        if self.sweep == MAP and not contestant.names_stars:
            return False
        return not contestant.declines(self.condition)


def places(study: Study) -> Iterator[Place]:
    """Yield the maps, then sweep after sweep, then what is combined, then real images."""
    for number in study.maps:
        yield Place(MAPS, MAP, float(number), Condition(f"map {number}"))
    for sweep, value, condition in _swept(study.sweeps):
        yield from _at_cameras(study, sweep, value, condition)
    for name in study.combined:
        yield from _at_cameras(study, COMBINED, name, NAMED[name])
    for sweep, value, condition in _swept(study.images):
        yield Place(IMAGES, sweep, value, condition, CORRECT_DEG)


def _swept(sweeps: Iterable[Sweep]) -> Iterator[tuple[str, Value, Condition]]:
    for sweep in sweeps:
        for value in sweep.values:
            yield sweep.quantity, value, sweep.condition(value)


def _at_cameras(study: Study, sweep: str, value: Value, condition: Condition) -> Iterator[Place]:
    measured = condition
    if condition.brightness_noise_mag is None:
        measured = replace(condition, brightness_noise_mag=study.brightness_noise_mag)
    for name, camera in study.cameras:
        limit_deg = condition.correct_deg(camera, study.correct_noises)
        yield Place(name, sweep, value, measured, limit_deg)


def plan(study: Study, images: Sequence[Image] = ()) -> list[Chunk]:
    """Return all chunks of a study, none of them twice: many sweeps share a condition."""
    chunks: list[Chunk] = []
    for place in places(study):
        able = tuple(one for one in study.contestants if place.takes_part(one))
        for group in [able] if study.interleave and able else [(one,) for one in able]:
            chunks += _chunks(study, place, group, images)
    return list(dict.fromkeys(chunks))


def _chunks(
    study: Study, place: Place, group: tuple[Contestant, ...], images: Sequence[Image]
) -> Iterator[Chunk]:
    if place.tolerance_deg is None:
        yield MapChunk(group, int(place.value), study.deadline_ms)
    elif place.camera == IMAGES:
        for image in images:
            yield ImageChunk(group, image, place.condition, study.deadline_ms, place.tolerance_deg)
    else:
        camera = dict(study.cameras)[place.camera]
        for block, first in enumerate(range(0, study.frames, study.block_frames)):
            yield FramesChunk(
                group, place.camera, camera, place.condition, block, first,
                min(study.block_frames, study.frames - first), study.seed, study.deadline_ms,
                place.tolerance_deg,
            )


def installed(study: Study) -> tuple[Study, list[str]]:
    """Return a study of the contestants that can be imported, and a sentence for each package.

    Raises ValueError where none is left.
    """
    missing = {
        package: reason for package in {one.package for one in study.contestants if one.package}
        if (reason := _why_missing(package))
    }
    present = tuple(one for one in study.contestants if one.package not in missing)
    if not present:
        raise ValueError("; ".join(missing.values()))
    return replace(study, contestants=present), sorted(missing.values())


def _why_missing(package: str) -> str:
    try:
        importlib.import_module(package)
    except ImportError as error:
        return f"{package} is left out: {error}; pip install {package} typing-extensions"
    return ""


def absences(study: Study) -> list[str]:
    """Return a sentence for each reason why a contestant takes no part everywhere."""
    reasons = {
        (one.title, reason): sum(one.declines(each.condition) == reason for each in places(study))
        for place in places(study) for one in study.contestants
        if (reason := one.declines(place.condition))
    }
    return [
        f"{title} is left out of {count} condition{'s' * (count > 1)}: {reason}"
        for (title, reason), count in reasons.items()
    ]
