"""The study's YAML file (`config/evaluation.yaml`): read, checked, and made smaller."""

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TypeVar

import yaml

from star_tracker.maps.simulation import CAMERAS
from star_tracker.maps.star_map import PAPER_MAPS
from star_tracker.optics.camera import Camera
from star_tracker.study.contestants import Contestant
from star_tracker.study.troubles import (
    COMBINED,
    QUANTITIES,
    Trouble,
    Value,
    check_value,
    is_number,
)

_Item = TypeVar("_Item", bound=Hashable)
_MOST_FRAMES = 1_000_000


@dataclass(frozen=True)
class Sweep:
    """One quantity over its values, in rising order, while others stay as `base` says."""

    quantity: str
    values: tuple[Value, ...]
    base: tuple[tuple[str, Value], ...] = ()

    def trouble(self, value: Value) -> Trouble:
        """Return the trouble at one value."""
        return Trouble.of({**dict(self.base), self.quantity: value})


@dataclass(frozen=True)
class Study:
    """What is measured: the keys of the file, checked."""

    frames: int
    quick_frames: int
    block_frames: int
    seed: int
    deadline_ms: float
    contestants: tuple[Contestant, ...]
    cameras: tuple[tuple[str, Camera], ...]
    maps: tuple[int, ...]
    combined: tuple[str, ...]
    sweeps: tuple[Sweep, ...]

    def quick(self) -> "Study":
        """Return a small form of it: few frames, three values of each sweep."""
        return replace(self, frames=self.quick_frames, sweeps=tuple(
            replace(sweep, values=_three(sweep.values)) for sweep in self.sweeps
        ))


def read_study(path: Path) -> Study:
    """Read a study. Raises ValueError with the file, the key and the remedy in one line."""
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    except yaml.YAMLError as error:
        text = " ".join(str(error).split())
        raise ValueError(f"{path} is no YAML, mend this place: {text}") from error
    try:
        return _study(content)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _study(content: object) -> Study:
    given = _mapping("the file", content, [field.name for field in fields(Study)])
    return Study(
        _whole("frames", given["frames"], 1, _MOST_FRAMES),
        _whole("quick_frames", given["quick_frames"], 1, _MOST_FRAMES),
        _whole("block_frames", given["block_frames"], 1, _MOST_FRAMES),
        _whole("seed", given["seed"], 0, 2**63 - 1),
        _deadline_ms(given["deadline_ms"]),
        _several("contestants", given["contestants"], _contestant),
        _cameras(given["cameras"]),
        _several("maps", given["maps"], _map, least=0),
        _several("combined", given["combined"], _combined, least=0),
        _sweeps(given["sweeps"]),
    )


def _mapping(
    name: str, content: object, needed: Iterable[str], allowed: Iterable[str] = ()
) -> Mapping[str, object]:
    """Return a mapping that has all needed keys and besides only allowed ones."""
    needed, known = list(needed), [*needed, *allowed]
    if not isinstance(content, dict):
        raise ValueError(  # noqa: TRY004  a user's mistake like all others
            f"{name} must hold keys with values: {', '.join(known)}"
        )
    for key in content:
        if key not in known:
            raise ValueError(f"{name} has an unknown key {key!r}: use {', '.join(known)}")
    for key in needed:
        if key not in content:
            raise ValueError(f"{name} has no key {key!r}: add it")
    return content


def _several(
    name: str, content: object, read: Callable[[object], _Item], least: int = 1
) -> tuple[_Item, ...]:
    """Return the items of a list, none of them twice."""
    if not isinstance(content, list) or len(content) < least:
        raise ValueError(f"{name} must be a list" + (" of one item or more" if least else ""))
    items = []
    for each in content:
        try:
            item = read(each)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
        if item in items:
            raise ValueError(f"{name} lists {each!r} twice: leave one of them out")
        items.append(item)
    return tuple(items)


def _whole(name: str, value: object, low: int, high: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{name} is {value!r}: give a whole number from {low} to {high}")
    return value


def _deadline_ms(value: object) -> float:
    if not is_number(value) or not value > 0:
        raise ValueError(
            f"deadline_ms is {value!r}: give a number greater than 0, .inf for no deadline"
        )
    return float(value)


def _contestant(content: object) -> Contestant:
    given = _mapping("a contestant", content, ["method"], ["form"])
    return Contestant(str(given["method"]), str(given.get("form", "own")))


def _cameras(content: object) -> tuple[tuple[str, Camera], ...]:
    cameras = _several("cameras", content, _camera)
    names = [name for name, _ in cameras]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ValueError(f"cameras gives the name {twice[0]!r} twice: choose another")
    return cameras


def _camera(content: object) -> tuple[str, Camera]:
    if isinstance(content, str):
        if content not in CAMERAS:
            raise ValueError(
                f"there is no camera {content!r}: use {', '.join(CAMERAS)}, or give "
                "{name, fov_deg, width_px, height_px}"
            )
        return content, CAMERAS[content]
    given = _mapping("a camera", content, ["name", "fov_deg", "width_px", "height_px"])
    fov_deg = given["fov_deg"]
    if not is_number(fov_deg):
        raise ValueError(f"fov_deg is {fov_deg!r}: give a number of degrees")
    width, height = (_whole(k, given[k], 16, 65536) for k in ("width_px", "height_px"))
    return str(given["name"]), Camera.from_fov(float(fov_deg), width, height)


def _map(content: object) -> int:
    return _whole("a map", content, PAPER_MAPS[0], PAPER_MAPS[-1])


def _combined(content: object) -> str:
    if not isinstance(content, str) or content not in COMBINED:
        raise ValueError(f"there is no condition {content!r}: use {', '.join(COMBINED)}")
    return content


def _sweeps(content: object) -> tuple[Sweep, ...]:
    given = _mapping("sweeps", content, [], QUANTITIES)
    return tuple(_sweep(key, given[key]) for key in QUANTITIES if key in given)


def _sweep(quantity: str, content: object) -> Sweep:
    given = _mapping(f"sweep {quantity}", content, ["values"], ["with"])
    values = _several(
        f"sweep {quantity}", given["values"], lambda value: check_value(quantity, value)
    )
    others = [key for key in QUANTITIES if key != quantity]
    base = _mapping(f"with of sweep {quantity}", given.get("with", {}), [], others)
    fixed = tuple((key, check_value(key, value)) for key, value in base.items())
    if not isinstance(values[0], str):
        values = tuple(sorted(values))
    return Sweep(quantity, values, fixed)


def _three(values: tuple[Value, ...]) -> tuple[Value, ...]:
    """Return the first, the middle and the last value."""
    return tuple(dict.fromkeys((values[0], values[(len(values) - 1) // 2], values[-1])))
