"""The quantities that a study can vary: names, units, ranges, and the conditions they make."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeGuard

from star_tracker.maps.simulation import CONDITIONS, Condition
from star_tracker.optics.camera import PARITIES

Value = float | str
#: The value of a field of view that is not told.
NOT_TOLD = "unknown"


@dataclass(frozen=True)
class Quantity:
    """A field of `Condition` that can be varied.

    Attributes:
        field: its name.
        title: heading of its figure.
        axis: label of its axis, with the unit.
        short: format of a number in narrow tables.
        scale: factor from the number to what `axis` and `short` show.
        low, high: least and largest number allowed; both 0 where it takes words only.
        words: the words allowed, with what narrow tables call them.
    """

    field: str
    title: str
    axis: str
    short: str = ""
    scale: float = 1.0
    low: float = 0.0
    high: float = 0.0
    words: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def tick(self, value: Value) -> str:
        """Return a value as its axis shows it."""
        return value if isinstance(value, str) else f"{value * self.scale:g}"

    def label(self, value: Value) -> str:
        """Return a value as narrow tables show it."""
        if isinstance(value, str):
            return self.words[value]
        return self.short.format(value * self.scale)

    def check(self, key: str, value: object) -> Value:
        """Return a value. Raises ValueError, naming the key, for one that is out of range."""
        if isinstance(value, str) and value in self.words:
            return value
        if is_number(value) and self.low <= value <= self.high and self.low < self.high:
            # As its label tells it, lest two conditions have one name.
            return float(f"{value:g}")
        allowed = [f"numbers from {self.low:g} to {self.high:g}"] if self.low < self.high else []
        raise ValueError(f"{key} is {value!r}: give {' or '.join([*allowed, *self.words])}")


#: By the key of the configuration, in the order of names and pages.
QUANTITIES = {
    "noise_px": Quantity(
        "noise_px", "Position noise", "noise of a centroid along each axis, px", "{:g} px",
        high=100,
    ),
    "missing_fraction": Quantity(
        "missing", "Missing stars", "stars missing, %", "{:g} % missing", 100, high=1
    ),
    "false_stars": Quantity(
        "false_stars", "False stars", "false stars, % of the true ones", "{:g} % false", 100,
        high=20,
    ),
    "brightness_noise_mag": Quantity(
        "brightness_noise_mag", "Brightness noise", "noise of the measured magnitudes, mag",
        "{:g} mag", high=20,
    ),
    "fov_error_percent": Quantity(
        "fov_error_percent", "Wrong field of view", "field of view told against the true one, %",
        "view {:+g} %", low=-50, high=50, words={NOT_TOLD: "view not told"},
    ),
    "principal_point_offset_px": Quantity(
        "principal_point_offset_px", "Principal point off",
        "principal point off along x and y, px", "offset {:g} px", low=-100, high=100,
    ),
    "mirrored_sky_parity": Quantity(
        "mirrored_sky_parity", "Mirrored sky", "parity told, while the true one is mirrored",
        words={parity: f"mirror/{parity}" for parity in PARITIES},
    ),
    "lens_k1": Quantity(
        "lens_k1", "Lens not told", "k1 of the lens, which is not told", "k1 {:+g}",
        low=-0.5, high=0.5,
    ),
}
#: Those of the camera that is told: all that can be varied of a real image.
TOLD = ("fov_error_percent",)
#: The conditions with names of their own.
NAMED = {condition.name: condition for condition in CONDITIONS}
#: Those, as if they were a quantity.
COMBINED = Quantity(
    "name", "Combined troubles", "condition", words={name: name for name in NAMED}
)


def condition_of(values: Mapping[str, Value]) -> Condition:
    """Return the condition of these values by `QUANTITIES`, named after them."""
    return Condition(", ".join(
        quantity.label(values[key]) for key, quantity in QUANTITIES.items()
        if key in values and (key == "brightness_noise_mag" or values[key] != 0)
    ) or "clean", **fields_of(values))


def fields_of(values: Mapping[str, Value]) -> dict[str, Any]:
    """Return the fields of `Condition` that these values stand for."""
    return {
        QUANTITIES[key].field: None if value == NOT_TOLD else value
        for key, value in values.items()
    }


def is_number(value: object) -> TypeGuard[float]:
    """Return whether YAML read a number; true and false are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
