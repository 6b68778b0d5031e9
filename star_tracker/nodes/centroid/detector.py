"""One image message -> the stars of it, or why there are none."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from star_tracker.detection.centroids import Centroids, DetectSettings
from star_tracker.detection.detect import detect_stars
from star_tracker.msg_adapters.image import (
    ImageError,
    Picture,
    picture_from_compressed,
    picture_from_image,
)

#: Smaller images hold no star with sky around it.
_SMALLEST_PX = 5


@dataclass(frozen=True)
class IncomingImage:
    """An image that has come, and when: seconds of `time.monotonic`."""

    message: Image | CompressedImage
    received_s: float

    @property
    def header(self) -> Header:
        """The image's header."""
        return self.message.header


@dataclass(frozen=True)
class Detection:
    """What became of an image.

    Attributes:
        image: the message.
        stars: what was found; None where the image cannot be read.
        kind, trouble: why it is of no use, as a word and a sentence; empty where it is.
    """

    image: IncomingImage
    stars: Centroids | None
    kind: str = ""
    trouble: str = ""


@dataclass(frozen=True)
class Detector:
    """What is asked of the images of one camera.

    Attributes:
        settings: of the detector.
        companions: mask and dark frame, (h, w), where there are any.
    """

    settings: DetectSettings
    companions: dict[str, NDArray[Any]] = field(default_factory=dict)

    def detect(self, image: IncomingImage) -> Detection:
        """Return the stars of an image. Never raises: it must not end a thread."""
        try:
            picture = _picture(image.message)
            stars = detect_stars(
                picture.pixels, self.settings, bayer=picture.bayer, **self.companions
            )
        except ImageError as error:
            return Detection(image, None, error.kind, str(error))
        except ValueError as error:  # a mask or a dark frame of another size
            return Detection(image, None, "unusable", " ".join(str(error).split()))
        except Exception as error:  # one image must not end the node
            return Detection(image, None, "internal_error", f"{type(error).__name__}: {error}")
        kind, trouble = ("", "") if len(stars) else why_empty(picture.pixels)
        return Detection(image, stars, kind, trouble)


def why_empty(pixels: NDArray[Any]) -> tuple[str, str]:
    """Say, as a word and a sentence, why an image cannot show a star; empty where it could."""
    height, width = pixels.shape[:2]
    if min(height, width) < _SMALLEST_PX:
        return "too_small", (
            f"image is {width} x {height} px: a star needs sky around it, {_SMALLEST_PX} x "
            f"{_SMALLEST_PX} px at the least"
        )
    values = pixels[np.isfinite(pixels)] if pixels.dtype.kind == "f" else pixels
    if values.size == 0:
        return "not_finite", (
            "image has no pixel that is a finite number: check what the driver publishes"
        )
    low, high = values.min(), values.max()
    if low == high:
        what = "the lens cap and the exposure" if low == 0 else "exposure and gain"
        return "uniform", f"all pixels of the image are {low:g}: check {what}"
    return "", ""


def _picture(message: Image | CompressedImage) -> Picture:
    if isinstance(message, CompressedImage):
        return picture_from_compressed(message)
    return picture_from_image(message)
