"""What there is to see in one solved (or unsolved) frame, as arrays: no matplotlib in here."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.catalog import StarCatalog
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.labels import StarState
from star_tracker.maps.simulation import visible_stars
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution

#: How far outside of the image a centroid is drawn, in its longer sides: as far as the tracker
#: makes use of one.
_DRAWN_MARGIN = 0.05


@dataclass(frozen=True)
class FieldView:
    """One frame with its solution.

    Attributes:
        name: what the picture calls it.
        camera: the camera that was told, of parity `auto` too.
        labels: (n,) the centroids' names.
        xy_px: (n, 2) centroids.
        solution: how the frame was solved, or why it was not.
        catalog: the guide stars.
    """

    name: str
    camera: Camera
    labels: tuple[str, ...]
    xy_px: Floats
    solution: Solution
    catalog: StarCatalog

    @cached_property
    def optics(self) -> Camera:
        """The camera of definite parity: the one found, else the first possible one."""
        parity = self.solution.parity
        return self.camera.with_parity(parity) if parity else self.camera.definite()[0]

    @property
    def rotation(self) -> Floats | None:
        """The rotation (3, 3), camera to ICRS; None where the frame is unsolved."""
        attitude = self.solution.attitude
        return None if attitude is None else attitude.rotation

    @cached_property
    def guide_stars(self) -> tuple[NDArray[np.intp], Floats]:
        """Catalogue indices (m,) and predicted pixels (m, 2) of the guide stars in the image."""
        if self.rotation is None:
            return np.zeros(0, np.intp), np.zeros((0, 2))
        return visible_stars(self.catalog, self.optics, self.rotation)

    @cached_property
    def missing(self) -> NDArray[np.bool_]:
        """Which of `guide_stars` (m,) no centroid was labelled with."""
        return ~np.isin(self.guide_stars[0], self.solution.identification.catalog_index)

    @property
    def boresight_deg(self) -> Floats | None:
        """Right ascension, declination and roll (3,); None where the frame is unsolved."""
        attitude = self.solution.attitude
        if attitude is None:
            return None
        return np.degrees([attitude.ra_rad, attitude.dec_rad, attitude.roll_rad])

    @cached_property
    def predicted_px(self) -> Floats:
        """Where each centroid's guide star should be (n, 2), NaN for those without one."""
        places = np.full(self.xy_px.shape, np.nan)
        index = self.solution.identification.catalog_index
        if self.rotation is not None:
            named = index >= 0
            directions = self.catalog.vectors[index[named]] @ self.rotation
            places[named] = self.optics.pixels(directions)
        return places

    def arrows(self, state: StarState) -> tuple[Floats, Floats]:
        """Return where the stars of a state should be (k, 2) and how far off they are (k, 2)."""
        which = self.of_state(state)
        start = self.predicted_px[which]
        return start, self.xy_px[which] - start

    @cached_property
    def drawn(self) -> NDArray[np.intp]:
        """Indices of the centroids in the image or next to it: those that are drawn."""
        margin = _DRAWN_MARGIN * max(self.camera.width_px, self.camera.height_px)
        return np.flatnonzero(self.camera.contains(self.xy_px, margin))

    def of_state(self, state: StarState) -> NDArray[np.intp]:
        """Return the centroids of a state, as indices."""
        return np.flatnonzero(self.solution.identification.state == state)

    @property
    def summary(self) -> str:
        """How the frame ended, in a line."""
        solution = self.solution
        if solution.attitude is None:
            n = len(self.xy_px)
            return f"not solved, {solution.status.value}: {solution.reason} ({n} centroids)"
        states = (StarState.IDENTIFIED, StarState.DISPLACED, StarState.UNIDENTIFIED)
        counts = [f"{len(self.of_state(state))} {state.name.lower()}" for state in states]
        missing = f"{int(self.missing.sum())} guide stars missing"
        outside = [f"{solution.n_ignored} of them outside"] if solution.n_ignored else []
        return f"{solution.status.value}, {', '.join([*counts, *outside, missing])}"

    def guide_star_name(self, index: int) -> str:
        """Return its number in the paper where all guide stars have one, else its own name."""
        number = self.catalog.number
        return str(number[index]) if np.all(number > 0) else self.catalog.name(index)

    def record(self) -> dict[str, object]:
        """Return what the picture shows as plain values, units in the names."""
        solution, camera, boresight = self.solution, self.camera, self.boresight_deg
        index, places = self.guide_stars
        names = ("ra_deg", "dec_deg", "roll_deg")
        return {
            "status": solution.status.value, "reason": solution.reason,
            "method": solution.method, "parity": solution.parity,
            "catalog": self.catalog.description,
            "camera": {
                name: getattr(camera, name)
                for name in ("fov_deg", "width_px", "height_px", "parity")
            },
            "boresight": boresight if boresight is None
            else dict(zip(names, boresight.tolist(), strict=True)),
            "rms_px": solution.rms_px, "wrong_probability": solution.wrong_probability,
            "ignored": solution.n_ignored,
            **{state.name.lower(): len(self.of_state(state)) for state in StarState},
            "missing": int(self.missing.sum()),
            "stars": [self._star(i) for i in range(len(self.xy_px))],
            "missing_guide_stars": [
                {**self._guide_star(int(i)), "x_px": float(x), "y_px": float(y)}
                for i, (x, y) in zip(index[self.missing], places[self.missing], strict=True)
            ],
        }

    def _star(self, i: int) -> dict[str, object]:
        found = self.solution.identification
        names = ("x_px", "y_px", "predicted_x_px", "predicted_y_px", "residual_px")
        values = [*self.xy_px[i], *self.predicted_px[i], found.residual_px[i]]
        return {
            "label": self.labels[i], "state": StarState(found.state[i]).name.lower(),
            **self._guide_star(int(found.catalog_index[i])),
            **dict(zip(names, map(float, values), strict=True)),
        }

    def _guide_star(self, index: int) -> dict[str, object]:
        if index < 0:
            return {"star_number": None, "hip": None, "v_mag": None}
        catalog = self.catalog
        return {
            "star_number": int(catalog.number[index]) or None,
            "hip": int(catalog.hip[index]) or None,
            "v_mag": round(float(catalog.v_mag[index]), 2),
        }
