"""The parameters of centroid_node, and what the detector is told by them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.detection.centroids import PSF_RANGE_PX, DetectSettings
from star_tracker.nodes.declaring import ParameterError, parameter, parameters_of
from star_tracker.offline.image_file import read_image, require_pillow
from star_tracker.optics.camera import PIXEL_ORIGINS

_DETECT = DetectSettings()
#: Topic of each way in which images come.
TOPICS = {"raw": "image", "compressed": "image/compressed"}


@dataclass(frozen=True)
class CentroidParameters:
    """What centroid_node is told. Raises ValueError for values that do not go together."""

    image_transport: str = parameter(
        "raw", "raw: Image on image; compressed: CompressedImage on image/compressed",
        choices=tuple(TOPICS), fixed=True,
    )
    pixel_origin: str = parameter(
        "center", "where centroids are counted from: center of the first pixel, as camera_info "
        "does, or its outer corner, as identify_node does without camera_info",
        choices=tuple(PIXEL_ORIGINS), fixed=True,
    )
    threshold_sigma: float = parameter(
        _DETECT.threshold_sigma, "least signal to noise of a star", allowed=(3.0, 100.0)
    )
    max_stars: int = parameter(
        _DETECT.max_stars, "the brightest so many stars of an image are published",
        allowed=(1, 1000),
    )
    psf_sigma_px: float = parameter(
        0.0, "width of a star, the standard deviation of a Gaussian; 0 = find out", "px",
        allowed=(0.0, PSF_RANGE_PX[1]),
    )
    saturation_level: float = parameter(
        0.0, "pixel value from which on pixels are saturated; 0 = find out", allowed=(0.0, 1e9)
    )
    mask_file: str = parameter(
        "", "image file, not 0 where a pixel is not to be used; empty = none", fixed=True
    )
    dark_file: str = parameter(
        "", "image file of an exposure without light, which is subtracted; empty = none",
        fixed=True,
    )

    def __post_init__(self) -> None:
        if 0 < self.psf_sigma_px < PSF_RANGE_PX[0]:
            raise ParameterError(
                f"parameter psf_sigma_px is {self.psf_sigma_px:g}: it must be 0 (find it out) or "
                f"from {PSF_RANGE_PX[0]:g} to {PSF_RANGE_PX[1]:g} px"
            )

    @property
    def settings(self) -> DetectSettings:
        """What the detector is asked for."""
        return DetectSettings(
            self.threshold_sigma, self.max_stars, self.psf_sigma_px or None,
            self.saturation_level or None,
        )

    def companions(self) -> dict[str, NDArray[Any]]:
        """Read mask and dark frame, by the names of the detector's arguments.

        Raises ParameterError for a file that cannot be read, or where Pillow is missing.
        """
        if self.image_transport == "compressed":
            try:
                require_pillow()
            except ImportError as error:
                raise ParameterError(f"image_transport compressed needs {error}") from error
        files = {"mask": self.mask_file, "dark": self.dark_file}
        try:
            found = {
                name: read_image(Path(file).expanduser()) for name, file in files.items() if file
            }
        except ValueError as error:
            raise ParameterError(str(error)) from error
        if "mask" in found and np.all(found["mask"] != 0):
            raise ParameterError(
                f"mask_file {self.mask_file} hides every pixel: it has 0 where a pixel is used"
            )
        return found


CENTROID_PARAMETERS = parameters_of(CentroidParameters)
