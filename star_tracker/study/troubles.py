"""What a frame suffers from: the quantities that can be varied, and the frames that show them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeGuard

import numpy as np

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.maps.simulation import CONDITIONS, Condition, SyntheticField, frames
from star_tracker.optics.camera import PARITIES, Camera

Value = float | str


@dataclass(frozen=True)
class Quantity:
    """Something that can be varied.

    Attributes:
        field: the attribute of `Trouble` that holds it.
        title: heading of its figure.
        axis: label of its axis, with the unit.
        short: format of a value in narrow tables.
        scale: factor from the value to what `axis` and `short` show.
        low, high: least and largest value allowed; both 0 for a parity.
    """

    field: str
    title: str
    axis: str
    short: str
    scale: float = 1.0
    low: float = 0.0
    high: float = 0.0

    def shown(self, value: Value) -> Value:
        """Return a value in the unit of the axis."""
        return value if isinstance(value, str) else value * self.scale

    def label(self, value: Value) -> str:
        """Return a value as the tables show it."""
        return self.short.format(self.shown(value))


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
        "view {:+g} %", low=-50, high=50,
    ),
    "principal_point_offset_px": Quantity(
        "principal_point_offset_px", "Principal point off",
        "principal point off along x and y, px", "offset {:g} px", low=-100, high=100,
    ),
    "mirrored_sky_parity": Quantity(
        "mirrored_sky_parity", "Mirrored sky", "parity told, while the true one is mirrored",
        "mirror/{}",
    ),
}


@dataclass(frozen=True)
class Trouble(Condition):
    """A condition with what the detector and the camera's description may add to it.

    Attributes:
        brightness_noise_mag: noise of the measured magnitudes; None = brightness is not told.
        fov_error_percent: how much larger than the true field of view the one told is.
        principal_point_offset_px: from the principal point told to the true one, along x and y.
        mirrored_sky_parity: parity told where the true one is `mirrored`; empty = the camera's
            own is true and told.
    """

    brightness_noise_mag: float | None = None
    fov_error_percent: float = 0.0
    principal_point_offset_px: float = 0.0
    mirrored_sky_parity: str = ""

    @classmethod
    def of(cls, values: Mapping[str, Value]) -> "Trouble":
        """Return the trouble of these values by `QUANTITIES`, named after them."""
        fields: dict[str, Any] = {QUANTITIES[key].field: value for key, value in values.items()}
        told = (
            quantity.label(values[key]) for key, quantity in QUANTITIES.items()
            if key in values and (key == "brightness_noise_mag" or values[key] != 0)
        )
        return cls(**{"noise_px": 0.0, **fields, "name": ", ".join(told) or "clean"})

    def true_camera(self, camera: Camera) -> Camera:
        """Return the camera that takes the frames."""
        offset = self.principal_point_offset_px
        true = replace(camera, cx_px=camera.cx_px + offset, cy_px=camera.cy_px + offset)
        return true.with_parity("mirrored") if self.mirrored_sky_parity else true

    def told_camera(self, camera: Camera) -> Camera:
        """Return the camera that the tracker is told."""
        parity = self.mirrored_sky_parity or camera.parity
        if not self.fov_error_percent:
            return camera.with_parity(parity)
        return Camera.from_fov(
            camera.fov_deg * (1 + self.fov_error_percent / 100), camera.width_px,
            camera.height_px, cx_px=camera.cx_px, cy_px=camera.cy_px, parity=parity,
        )

    def frames(
        self, catalog: StarCatalog, camera: Camera, n: int, seed: np.random.SeedSequence
    ) -> Iterator[tuple[SyntheticField, Floats | None]]:
        """Yield `n` frames at random attitudes, each with its intensities (m,) where told."""
        positions, brightness = seed.spawn(2)
        rng = np.random.default_rng(brightness)
        for frame in frames(catalog, self.true_camera(camera), self, n, positions):
            yield frame, self._intensity(catalog, frame, rng)

    def _intensity(
        self, catalog: StarCatalog, frame: SyntheticField, rng: np.random.Generator
    ) -> Floats | None:
        if self.brightness_noise_mag is None:
            return None
        index = frame.catalog_index
        # A false star is as bright as any star, see `synthetic_field`.
        noise = rng.normal(0.0, 1.0, len(index)) * self.brightness_noise_mag
        v_mag = np.where(index >= 0, catalog.v_mag[index] + noise, frame.v_mag)
        return np.asarray(10.0 ** (-0.4 * v_mag))


#: The combined troubles by their short names.
COMBINED = {
    condition.short_name: Trouble(
        condition.name, condition.noise_px, condition.missing, condition.false_stars
    )
    for condition in CONDITIONS if ":" in condition.name
}


def is_number(value: object) -> TypeGuard[float]:
    """Return whether YAML read a number; true and false are none."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def check_value(key: str, value: object) -> Value:
    """Return a value of a quantity. Raises ValueError, naming it, for one that is out of range."""
    quantity = QUANTITIES[key]
    if quantity.low == quantity.high:
        if value not in PARITIES:
            raise ValueError(f"{key} is {value!r}: use {', '.join(PARITIES)}")
        return str(value)
    if not is_number(value) or not quantity.low <= value <= quantity.high:
        raise ValueError(
            f"{key} is {value!r}: give numbers from {quantity.low:g} to {quantity.high:g}"
        )
    # As its label tells it, lest two conditions have one name.
    return float(f"{value:g}")
