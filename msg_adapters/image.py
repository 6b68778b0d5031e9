"""Image and CompressedImage <-> arrays, as sensor_msgs/image_encodings.h names their pixels."""

import array
import re
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.detection.image import BAYER_PATTERNS, MAX_PIXELS
from star_tracker.msg_adapters import MessageError, shown
from star_tracker.msg_adapters.message_class import message_class
from star_tracker.offline.image_file import decode_image, encode_png

if TYPE_CHECKING:
    import sensor_msgs.msg
    import std_msgs.msg

#: Each encoding: numpy's type of a value, values of a pixel, and where its red, green, blue and
#: opacity lie, None where they lie in this order.
_FORMATS: dict[str, tuple[str, int, tuple[int, ...] | None]] = {
    "mono8": ("u1", 1, None), "8UC1": ("u1", 1, None),
    "mono16": ("u2", 1, None), "16UC1": ("u2", 1, None), "32FC1": ("f4", 1, None),
    "rgb8": ("u1", 3, None), "bgr8": ("u1", 3, (2, 1, 0)), "8UC3": ("u1", 3, None),
    "rgba8": ("u1", 4, None), "bgra8": ("u1", 4, (2, 1, 0, 3)),
    "rgb16": ("u2", 3, None), "bgr16": ("u2", 3, (2, 1, 0)),
    "rgba16": ("u2", 4, None), "bgra16": ("u2", 4, (2, 1, 0, 3)),
    **{f"bayer_{name}{bits}": (f"u{bits // 8}", 1, None)
       for name in BAYER_PATTERNS for bits in (8, 16)},
}
ENCODINGS = tuple(_FORMATS)


class ImageError(MessageError):
    """An image that cannot be read; `kind` is a word for the trouble, as for a count of it."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True)
class Picture:
    """An image as an array.

    Attributes:
        pixels: (h, w), or (h, w, 3 or 4) in the order red, green, blue, opacity.
        bayer: colours of the first two pixels of the first two rows, such as `rggb`; empty where
            the image is not a colour sensor's raw one.
    """

    pixels: NDArray[Any]
    bayer: str = ""


def picture_from_image(message: "sensor_msgs.msg.Image") -> Picture:
    """View an Image as an array, of any step and byte order; BGR alone is copied.

    Raises ImageError for another encoding, no pixels or too many, and a step or data that do not
    fit the size.
    """
    encoding = str(message.encoding)
    if encoding not in _FORMATS:
        raise ImageError("encoding", (
            f"Image encoding {shown(encoding)} is not known: convert it to mono8, mono16, 32FC1, "
            "rgb8, bgr8 or a bayer pattern"
        ))
    height, width, step = int(message.height), int(message.width), int(message.step)
    _check_size("Image", width, height)
    form, n_values, order = _FORMATS[encoding]
    dtype = np.dtype((">" if message.is_bigendian else "<") + form)
    pixel, n_bytes = n_values * dtype.itemsize, len(message.data)
    if step < width * pixel:
        raise ImageError("step", (
            f"Image step {step} is less than width {width} x {pixel} bytes of a {encoding} pixel: "
            "make them agree"
        ))
    # Of the last row some drivers leave out what pads it.
    if n_bytes < (height - 1) * step + width * pixel:
        raise ImageError("data", (
            f"Image data has {n_bytes} bytes, but height {height} x step {step} is "
            f"{height * step}: make them agree"
        ))
    values = np.ndarray(
        (height, width, n_values), dtype, message.data, strides=(step, pixel, dtype.itemsize)
    )
    if n_values == 1:
        return Picture(values[:, :, 0], _bayer_of(encoding))
    return Picture(values if order is None else values[:, :, list(order)])


def image_from_picture(
    picture: Picture, encoding: str, header: "std_msgs.msg.Header"
) -> "sensor_msgs.msg.Image":
    """Write an array whose type and colours are those of an encoding, in this machine's order.

    Raises ValueError where the array does not fit the encoding.
    """
    if encoding not in _FORMATS:
        raise ValueError(f"encoding {encoding!r} is unknown: use {', '.join(ENCODINGS)}")
    form, n_values, order = _FORMATS[encoding]
    pixels, dtype = picture.pixels, np.dtype(form)
    n_given = 1 if pixels.ndim == 2 else pixels.shape[-1]
    if pixels.ndim not in {2, 3} or n_given != n_values or pixels.dtype.newbyteorder("=") != dtype:
        raise ValueError(
            f"an image of {pixels.dtype} and shape {pixels.shape} is not {encoding}: convert it"
        )
    if picture.bayer != _bayer_of(encoding):
        raise ValueError(f"encoding {encoding} is not of a pattern {picture.bayer or 'none'!r}")
    if order is not None:
        pixels = pixels[:, :, np.argsort(order)]
    height, width = pixels.shape[:2]
    return message_class("sensor_msgs/Image")(
        header=header, height=int(height), width=int(width), encoding=str(encoding),
        is_bigendian=int(sys.byteorder == "big"), step=int(width * n_values * dtype.itemsize),
        data=array.array("B", np.ascontiguousarray(pixels, dtype).tobytes()),
    )


def picture_from_compressed(message: "sensor_msgs.msg.CompressedImage") -> Picture:
    """Decode a CompressedImage: PNG, JPEG and what else Pillow reads.

    Raises ImageError for data that cannot be decoded and for no pixels or too many.
    """
    try:
        pixels = decode_image(bytes(message.data))
    except ImportError as error:
        raise ImageError("pillow", f"CompressedImage needs {error}") from error
    except ValueError as error:
        raise ImageError("compressed", (
            f"CompressedImage of format {shown(str(message.format))} cannot be decoded ({error}): "
            "send JPEG or PNG, of 8 bits or grey of 16"
        )) from error
    _check_size("CompressedImage", pixels.shape[1], pixels.shape[0])
    # `bayer_rggb8; png compressed bayer_rggb8`, as image_transport writes it; where colours were
    # made of the pattern the last word is another.
    last = str(message.format).split()[-1:] or [""]
    return Picture(pixels, _bayer_of(last[0]) if pixels.ndim == 2 else "")


def compressed_from_picture(
    picture: Picture, header: "std_msgs.msg.Header"
) -> "sensor_msgs.msg.CompressedImage":
    """Write (h, w) uint8 or uint16, or (h, w, 3) uint8, as PNG. Needs Pillow."""
    pixels = picture.pixels
    bits = 8 * pixels.dtype.itemsize
    name = f"bayer_{picture.bayer}{bits}" if picture.bayer else f"mono{bits}"
    return message_class("sensor_msgs/CompressedImage")(
        header=header, format=f"{name if pixels.ndim == 2 else 'rgb8'}; png compressed "
        f"{name if pixels.ndim == 2 else 'bgr8'}",
        data=array.array("B", encode_png(pixels)),
    )


def _check_size(kind: str, width: int, height: int) -> None:
    if width == 0 or height == 0:
        raise ImageError("empty", (
            f"{kind} is {width} x {height} px and holds no pixel: check the camera's driver"
        ))
    if width * height > MAX_PIXELS:
        raise ImageError("too_large", (
            f"{kind} is {width} x {height} px, more than {MAX_PIXELS // 1_000_000} million "
            "pixels: bin or crop it"
        ))


def _bayer_of(encoding: str) -> str:
    """Return the pattern that an encoding names, empty for none."""
    found = re.fullmatch(r"bayer_(\w{4})(?:8|16)", encoding)
    return found[1] if found and found[1] in BAYER_PATTERNS else ""
