"""The symbols of a frame's stars: what they look like, where they lie and how they are drawn.

guide star in view      grey disc, larger = brighter    missing: an open one
identified centroid     ring around a dot               residual: an exaggerated arrow
displaced centroid      diamond, with an arrow from where the star should be
unidentified centroid   cross
"""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from star_tracker.figures.field_view import FieldView
from star_tracker.figures.style import BLUE, VERMILION, Looks
from star_tracker.geometry.spherical import Floats
from star_tracker.identification.labels import StarState

#: How a symbol is drawn: arguments of `Axes.plot`, sizes in points.
GUIDE: Looks = {
    "marker": "o", "markerfacecolor": "0.75", "markeredgecolor": "0.45", "linestyle": "",
}
MISSING: Looks = {
    "marker": "o", "markerfacecolor": "white", "markeredgecolor": "0.1", "linestyle": "",
}
DOT: Looks = {"marker": ".", "color": "black", "markersize": 3.0, "linestyle": ""}
RING: Looks = {
    "marker": "o", "markerfacecolor": "none", "markeredgecolor": BLUE, "markeredgewidth": 1.3,
    "markersize": 12.0, "linestyle": "",
}
DIAMOND: Looks = {
    "marker": "D", "markerfacecolor": "none", "markeredgecolor": VERMILION,
    "markeredgewidth": 1.5, "markersize": 10.0, "linestyle": "",
}
CROSS: Looks = {
    "marker": "x", "color": "black", "markeredgewidth": 1.4, "markersize": 6.0, "linestyle": "",
}
BORESIGHT: Looks = {"marker": "+", "color": "0.4", "markersize": 9.0, "linestyle": ""}
#: Half the size of the box that a symbol takes, points.
_REACH = {StarState.UNIDENTIFIED: 4.0, StarState.IDENTIFIED: 7.0, StarState.DISPLACED: 8.0}
#: The largest residual is drawn about this long, in widths of the image.
_LONGEST = 0.07
#: More stars than this are drawn smaller, but not below a share of the size.
_CROWD, _SMALLEST = 50, 0.55
_SMALLEST_PT, _LARGEST_PT, _PT_PER_MAGNITUDE = 2.6, 10.0, 1.5


@dataclass(frozen=True)
class Symbols:
    """The symbols of one frame.

    Attributes:
        view: the frame.
        residual_scale: how many times too long residuals are drawn; 0 = none are.
        size: of the symbols, 1 = that of a field that is not crowded.
    """

    view: FieldView
    residual_scale: float
    size: float

    @classmethod
    def of(cls, view: FieldView) -> "Symbols":
        """Choose the scale of the residuals and the size of the symbols."""
        largest = float(np.max(np.hypot(*residuals_px(view).T), initial=0.0))
        scale = 0.0
        if largest > 0:
            scale = max(1.0, round_down(_LONGEST * view.camera.width_px / largest))
        crowd = len(view.drawn) + int(view.missing.sum())
        return cls(view, scale, float(np.clip(np.sqrt(_CROWD / max(crowd, 1)), _SMALLEST, 1.0)))

    def scaled(self, looks: Looks) -> Looks:
        """Return how a symbol is drawn in a picture as crowded as this."""
        return {**looks, "markersize": looks["markersize"] * self.size}

    def disc_pt(self, v_mag: Floats) -> Floats:
        """Return the diameters (k,) of discs for magnitudes (k,)."""
        faintest = float(np.max(self.view.catalog.v_mag))
        size = _SMALLEST_PT + _PT_PER_MAGNITUDE * (faintest - v_mag)
        return np.asarray(np.clip(size, _SMALLEST_PT, _LARGEST_PT) * self.size)

    def draw(self, axes: Axes) -> None:
        """Draw all stars."""
        view = self.view
        axes.plot(view.optics.cx_px, view.optics.cy_px, zorder=1.5, **BORESIGHT)
        self._draw_guide_stars(axes)
        for state, style in (
            (StarState.IDENTIFIED, RING), (StarState.DISPLACED, DIAMOND),
            (StarState.UNIDENTIFIED, CROSS),
        ):
            which = np.intersect1d(view.of_state(state), view.drawn)
            axes.plot(*view.xy_px[which].T, zorder=3, clip_on=False, **self.scaled(style))
        named = view.xy_px[view.solution.identification.state > 0]
        axes.plot(*named.T, zorder=4, clip_on=False, **self.scaled(DOT))
        for i in view.of_state(StarState.DISPLACED):
            axes.annotate(
                "", view.xy_px[i], view.predicted_px[i], zorder=5, annotation_clip=False,
                arrowprops={
                    "arrowstyle": "-|>", "color": VERMILION, "shrinkA": 0, "shrinkB": 0,
                    "mutation_scale": 6, "linewidth": 1.2,
                },
            )
        self.draw_residuals(axes, view.predicted_px[view.of_state(StarState.IDENTIFIED)],
                            residuals_px(view))

    def draw_residuals(self, axes: Axes, start_px: Floats, residual_px: Floats) -> None:
        """Draw residuals (k, 2), exaggerated, from where the stars should be."""
        if self.residual_scale == 0:
            return
        axes.quiver(
            *start_px.T, *(residual_px * self.residual_scale).T, angles="xy", scale_units="xy",
            scale=1, units="inches", width=0.016, headwidth=4, headlength=5, headaxislength=4.5,
            minlength=0, minshaft=1, color="black", zorder=5,
            clip_on=False,
        )

    def _draw_guide_stars(self, axes: Axes) -> None:
        index, places = self.view.guide_stars
        sizes = self.disc_pt(self.view.catalog.v_mag[index])
        for (x, y), size, missing in zip(places, sizes, self.view.missing, strict=True):
            looks = MISSING if missing else GUIDE
            axes.plot(x, y, markersize=size, zorder=2, clip_on=False, **looks)

    def reach_pt(self, centroids: NDArray[np.intp]) -> Floats:
        """Return how far the symbols of some centroids (k,) reach, points."""
        states = self.view.solution.identification.state[centroids]
        return np.array([_REACH[StarState(state)] * self.size for state in states])

    def boxes(self, axes: Axes) -> Floats:
        """Return the boxes (k, 4) of all symbols in display units, for labels to keep clear of."""
        places, half_pt = self._covered_px()
        at = axes.transData.transform(places)
        half = half_pt[:, None] * axes.figure.dpi / 72
        return np.hstack([at - half, at + half])

    def _covered_px(self) -> tuple[Floats, Floats]:
        """Return places (k, 2), px, and half sizes (k,), points, of symbols and arrows."""
        view = self.view
        index, places = view.guide_stars
        discs = self.disc_pt(view.catalog.v_mag[index]) / 2
        moved = view.of_state(StarState.DISPLACED)
        along = [
            _along(view.predicted_px[moved], view.xy_px[moved] - view.predicted_px[moved]),
            _along(view.predicted_px[view.of_state(StarState.IDENTIFIED)],
                   residuals_px(view) * self.residual_scale),
        ]
        arrows, shown = np.concatenate(along), view.drawn
        return (
            np.concatenate([view.xy_px[shown], places, arrows]),
            np.concatenate([self.reach_pt(shown), discs, np.full(len(arrows), 1.5)]),
        )


def residuals_px(view: FieldView) -> Floats:
    """Return observed minus predicted place of the identified stars (k, 2), px."""
    which = view.of_state(StarState.IDENTIFIED)
    return np.asarray(view.xy_px[which] - view.predicted_px[which])


def round_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a number > 0."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(digit for digit in (1, 2, 5) if digit * power <= value * (1 + 1e-9)) * power)


def _along(start: Floats, step: Floats) -> Floats:
    """Return points (k, 2) along arrows from `start` (m, 2) by `step` (m, 2)."""
    share = np.linspace(0, 1, 7)[:, None, None]
    return np.asarray((start + share * step).reshape(-1, 2))
