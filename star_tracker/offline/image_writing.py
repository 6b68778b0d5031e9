"""Images to files: PNG, TIFF and BMP by Pillow, FITS, numpy arrays."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.offline.image_file import ARRAY, FITS, require_pillow

#: Endings that Pillow writes without loss, and its names for them.
PILLOW = {".png": "PNG", ".tif": "TIFF", ".tiff": "TIFF", ".bmp": "BMP"}


def check_image_name(path: Path) -> None:
    """Raise ValueError for a name whose ending says no format that is written."""
    endings = (*PILLOW, *FITS, *ARRAY)
    if path.suffix.lower() not in endings:
        raise ValueError(
            f"{path} names no format that is written: let it end in {', '.join(endings[:-1])} or "
            f"{endings[-1]}"
        )


def write_image(path: Path, pixels: NDArray[Any]) -> None:
    """Write an image (h, w) uint8 or uint16, in the format of the name's ending.

    Rows lie in the file as in the array. Raises ValueError for another ending, a missing library,
    more than 8 bits where the format has no more, and a place that does not take it.
    """
    check_image_name(path)
    ending = path.suffix.lower()
    if ending == ".bmp" and pixels.dtype != np.uint8:
        raise ValueError(f"{path} cannot hold {pixels.dtype}: BMP has 8 bits, write PNG or TIFF")
    encode: Callable[[NDArray[Any], str], bytes] = _with_pillow
    if ending in FITS:
        encode = _fits
    elif ending in ARRAY:
        encode = _array
    try:
        data = encode(pixels, ending)
    except ImportError as error:
        raise ValueError(f"{path} needs {error}") from error
    try:
        path.write_bytes(data)
    except OSError as error:
        raise ValueError(f"{path} cannot be written: {error.strerror or error}") from error


def _with_pillow(pixels: NDArray[Any], ending: str) -> bytes:
    require_pillow()
    from PIL import Image  # noqa: PLC0415  an extra

    file = io.BytesIO()
    Image.fromarray(pixels).save(file, PILLOW[ending])
    return file.getvalue()


def _array(pixels: NDArray[Any], _: str) -> bytes:
    file = io.BytesIO()
    np.save(file, pixels, allow_pickle=False)
    return file.getvalue()


def _fits(pixels: NDArray[Any], _: str) -> bytes:
    try:
        from astropy.io import fits  # noqa: PLC0415  an extra
    except ImportError as error:
        raise ImportError(
            "astropy: apt install python3-astropy, or pip install astropy"
        ) from error
    file = io.BytesIO()
    fits.PrimaryHDU(pixels).writeto(file)
    return file.getvalue()
