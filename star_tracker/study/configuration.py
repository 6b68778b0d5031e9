"""A study's YAML file (`config/evaluation.yaml`): read, checked, and made smaller."""

from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import yaml

from star_tracker.maps.simulation import CAMERAS, CORRECT_NOISES, Condition
from star_tracker.maps.star_map import PAPER_MAPS
from star_tracker.optics.camera import Camera
from star_tracker.study.contestants import Contestant
from star_tracker.study.own_methods import OwnMethod
from star_tracker.study.paper_forms import PaperForm
from star_tracker.study.peers import PEERS
from star_tracker.study.quantities import NAMED, QUANTITIES, TOLD, Value, condition_of, is_number

_Item = TypeVar("_Item", bound=Hashable)
_MOST = 1_000_000
_FORMS: dict[str, type[Contestant]] = {"own": OwnMethod, "paper": PaperForm}


@dataclass(frozen=True)
class Sweep:
    """One quantity over its values, numbers in rising order, while others stay as `base` says."""

    quantity: str
    values: tuple[Value, ...]
    base: tuple[tuple[str, Value], ...] = ()

    def condition(self, value: Value) -> Condition:
        """Return the condition at one value."""
        return condition_of({**dict(self.base), self.quantity: value})


@dataclass(frozen=True)
class Study:
    """What is measured: the keys of the file, checked; those with a default may be left out."""

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
    images: tuple[Sweep, ...] = ()
    interleave: bool = False
    correct_noises: float = CORRECT_NOISES
    brightness_noise_mag: float | None = None
    title: str = "Robustness of star identification"

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
        needed = [field.name for field in fields(Study) if field.default is MISSING]
        given = _mapping("the file", content, needed, _READERS)
        return Study(**{key: read(given[key]) for key, read in _READERS.items() if key in given})
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _mapping(
    name: str, content: object, needed: Iterable[str], allowed: Iterable[str] = ()
) -> Mapping[str, object]:
    """Return a mapping that has all needed keys and besides only allowed ones."""
    needed, known = list(needed), list(dict.fromkeys([*needed, *allowed]))
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
    items: list[_Item] = []
    for each in content:
        try:
            item = read(each)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from error
        if item in items:
            raise ValueError(f"{name} lists {each!r} twice: leave one of them out")
        items.append(item)
    return tuple(items)


def _named(
    name: str, content: object, read: Callable[[object], _Item], name_of: Callable[[_Item], str]
) -> tuple[_Item, ...]:
    """Return the items of a list, each with a name of its own."""
    items = _several(name, content, read)
    names = [name_of(item) for item in items]
    for one in names:
        if names.count(one) > 1:
            raise ValueError(f"{name} gives the name {one!r} twice: choose another")
    return items


def _number(name: str, value: object, low: float, high: float, *, whole: bool = True) -> Any:
    """Return a number in a range."""
    if is_number(value) and low <= value <= high and (isinstance(value, int) or not whole):
        return value
    kind = "a whole number" if whole else "a number"
    raise ValueError(f"{name} is {value!r}: give {kind} from {low} to {high}")


def _plain(name: str, value: object, kind: Any) -> Any:
    """Return a plain value of a type."""
    if kind in (int, float):
        return kind(_number(name, value, int(kind is int), _MOST, whole=kind is int))
    if isinstance(value, kind):
        return value
    raise ValueError(f"{name} is {value!r}: give {'true or false' if kind is bool else 'a word'}")


def _deadline_ms(value: object) -> float:
    if not is_number(value) or not value > 0:
        raise ValueError(
            f"deadline_ms is {value!r}: give a number greater than 0, .inf for no deadline"
        )
    return float(value)


def _contestant(content: object) -> Contestant:
    """Return a peer where one is named, else a method of this package."""
    key = "peer" if isinstance(content, dict) and "peer" in content else "form"
    kinds = PEERS if key == "peer" else _FORMS
    form = content.get(key, "own") if isinstance(content, dict) else "own"
    if form not in kinds:
        raise ValueError(f"{key} {form!r} is unknown: use {' or '.join(kinds)}")
    settings: dict[str, Any] = {field.name: field.type for field in fields(kinds[form])}
    needed = ["method"] if key == "form" else []
    given = _mapping("a contestant", content, needed, [key, *settings])
    return kinds[form](**{
        name: _plain(name, given[name], kind) for name, kind in settings.items() if name in given
    })


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
    width, height = (_number(k, given[k], 16, 65536) for k in ("width_px", "height_px"))
    return str(given["name"]), Camera.from_fov(float(fov_deg), width, height)


def _combined(content: object) -> str:
    if not isinstance(content, str) or content not in NAMED:
        raise ValueError(f"there is no condition {content!r}: use {', '.join(NAMED)}")
    return content


def _sweeps(name: str, content: object, allowed: Iterable[str]) -> tuple[Sweep, ...]:
    given = _mapping(name, content, [], allowed)
    return tuple(_sweep(key, given[key], allowed) for key in QUANTITIES if key in given)


def _sweep(key: str, content: object, allowed: Iterable[str]) -> Sweep:
    given = _mapping(f"sweep {key}", content, ["values"], ["with"])
    values = _several(f"sweep {key}", given["values"], partial(QUANTITIES[key].check, key))
    others = [other for other in allowed if other != key]
    base = _mapping(f"with of sweep {key}", given.get("with", {}), [], others)
    fixed = tuple((other, QUANTITIES[other].check(other, value)) for other, value in base.items())
    # Numbers in rising order, then words as they stand.
    in_order = sorted(values, key=lambda value: (1, 0.0) if isinstance(value, str) else (0, value))
    return Sweep(key, tuple(in_order), fixed)


def _three(values: tuple[Value, ...]) -> tuple[Value, ...]:
    """Return the first, the middle and the last value."""
    return tuple(dict.fromkeys((values[0], values[(len(values) - 1) // 2], values[-1])))


#: How the value of each key is read.
_READERS: dict[str, Callable[[object], Any]] = {
    **{
        key: partial(_plain, key, kind=int) for key in ("frames", "quick_frames", "block_frames")
    },
    "seed": partial(_number, "seed", low=0, high=2**63 - 1),
    "deadline_ms": _deadline_ms,
    "contestants": lambda content: _named(
        "contestants", content, _contestant, lambda contestant: contestant.title
    ),
    "cameras": lambda content: _named("cameras", content, _camera, lambda camera: camera[0]),
    "maps": partial(
        _several, "maps", read=partial(_number, "a map", low=PAPER_MAPS[0], high=PAPER_MAPS[-1]),
        least=0,
    ),
    "combined": partial(_several, "combined", read=_combined, least=0),
    "sweeps": partial(_sweeps, "sweeps", allowed=QUANTITIES),
    "images": partial(_sweeps, "images", allowed=TOLD),
    "interleave": partial(_plain, "interleave", kind=bool),
    "correct_noises": partial(_plain, "correct_noises", kind=float),
    "brightness_noise_mag": partial(_plain, "brightness_noise_mag", kind=float),
    "title": partial(_plain, "title", kind=str),
}
