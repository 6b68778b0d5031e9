"""How engines are put together: for one camera, or for one step of a ladder of cameras."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.catalogue.database import FeatureDatabase
from star_tracker.catalogue.depth import stars_in_view
from star_tracker.catalogue.triangles import TriangleTable
from star_tracker.identification import plan
from star_tracker.identification.cells import MatchGroupSettings
from star_tracker.identification.engine import Results, Sizes, make_engine, make_scratch
from star_tracker.identification.evidence import ScalePrior, evidence
from star_tracker.identification.judge import View
from star_tracker.identification.search import Limits
from star_tracker.identification.searcher import Searcher
from star_tracker.identification.stream import nothing_expected
from star_tracker.optics.camera import Camera


@dataclass(frozen=True)
class Setup:
    """What all searchers of a tracker share.

    Attributes:
        match_group: the primary matcher's settings; None where it does not search.
        limits: when a search ends.
        centroid_sigma_px: noise of a centroid, 0 = not known.
        max_centroids: room for so many.
        expected: (1,) of `stream.EXPECTED`, what all of them expect of the next frame.
    """

    match_group: MatchGroupSettings | None
    limits: Limits
    centroid_sigma_px: float
    max_centroids: int
    expected: NDArray[np.void] = field(default_factory=nothing_expected)

    def searchers(
        self, database: FeatureDatabase, cameras: tuple[Camera, ...], prior: ScalePrior
    ) -> list[Searcher]:
        """Return a searcher for each camera, which differ in parity only."""
        n_expected = stars_in_view(len(database.catalog), cameras[0])
        levels = plan.levels(self.match_group or MatchGroupSettings(), prior, n_expected)
        if self.match_group is None:
            levels = levels[:0]
        v_mag = np.ascontiguousarray(database.catalog.v_mag, float)
        sizes = Sizes(
            len(database.catalog), self.max_centroids, max(levels["companions"], default=1),
            max(levels["cells"], default=1),
        )
        scratch = make_scratch(sizes)
        shapes = database.triangles if np.any(levels["by_shape"]) else TriangleTable.empty()
        known = evidence(
            len(database.catalog) + self.max_centroids, self.centroid_sigma_px, self.expected
        )
        found = []
        for camera in cameras:
            view = View(
                database.sky_index, v_mag, camera.optics, camera.focal_length_px,
                camera.radius_rad, known, prior,
            )
            results = Results.blank(self.max_centroids)
            engine: Any = make_engine(
                view, database.pairs, shapes, (levels, self.limits), scratch, results
            )
            found.append(Searcher(
                camera, database.catalog, engine, results, scale_is_told=prior.told
            ))
        return found


def with_mirror_image(camera: Camera) -> tuple[Camera, ...]:
    """Return cameras of both parities, the one that is asked for first."""
    cameras = camera.definite()
    if len(cameras) == 2:
        return cameras
    return camera, camera.with_parity("normal" if camera.parity == "mirrored" else "mirrored")
