"""Image files as arrays: what Pillow reads, numpy arrays, FITS and raw files of cameras."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Endings by reader; whatever else is tried with Pillow.
FITS = (".fits", ".fit", ".fts")
RAW = (".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".pef", ".raf", ".rw2")
PILLOW = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".webp")
ARRAY = (".npy",)


def read_image(path: Path) -> NDArray[Any]:
    """Return an image (h, w) or (h, w, colours) as it lies in the file.

    Raises ValueError with the file's name and what is wrong with it, or which library it needs.
    """
    ending = path.suffix.lower()
    reader = _fits if ending in FITS else _raw if ending in RAW else _pillow
    reader = _array if ending in ARRAY else reader
    if not path.is_file():
        raise ValueError(f"{path} cannot be read: there is no such file")
    try:
        image = reader(path)
    except ImportError as error:
        raise ValueError(f"{path} needs {error}") from error
    except Exception as error:  # readers raise errors of many kinds for damaged files
        raise ValueError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    if image.ndim not in (2, 3):
        raise ValueError(f"{path} holds an array of shape {image.shape}: no image")
    return image


def decode_image(data: bytes, max_pixels: int) -> NDArray[Any]:
    """Return the image (h, w) or (h, w, colours) that the bytes of a PNG or JPEG file hold.

    Raises ValueError for what Pillow cannot decode or what has more than `max_pixels`, and
    ImportError with the remedy where there is no Pillow.
    """
    pillow = _pillow_module()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pillow.open(io.BytesIO(data)) as image:
                if image.width * image.height > max_pixels:
                    raise ValueError(f"it has {image.width} x {image.height} px")  # noqa: TRY301
                return _values(image)
    except Exception as error:  # Pillow raises errors of many kinds for damaged data
        text = " ".join(str(error).split())
        # Where the bytes lie in memory helps nobody.
        text = "it is no image" if "cannot identify" in text else text
        raise ValueError(text or type(error).__name__) from error


def encode_png(pixels: NDArray[Any]) -> bytes:
    """Return a PNG file of (h, w) uint8 or uint16, or (h, w, 3) uint8.

    Raises ImportError with the remedy where there is no Pillow.
    """
    file = io.BytesIO()
    _pillow_module().fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def require_pillow() -> None:
    """Raise ImportError with the remedy where there is no Pillow."""
    _pillow_module()


def _pillow_module() -> Any:
    try:
        from PIL import Image  # noqa: PLC0415  an extra
    except ImportError as error:
        raise ImportError("Pillow: apt install python3-pil, or pip install Pillow") from error
    return Image


def _pillow(path: Path) -> NDArray[Any]:
    pillow = _pillow_module()
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a picture of a size that is an attack is refused
        with pillow.open(path) as image:
            return _values(image)


def _values(image: Any) -> NDArray[Any]:
    """Return the pixels of an image of Pillow's."""
    if image.mode in ("P", "1", "LA", "PA", "CMYK", "YCbCr", "HSV", "LAB"):
        return np.asarray(image.convert("RGB"))
    return np.asarray(image)


def _array(path: Path) -> NDArray[Any]:
    return np.asarray(np.load(path, allow_pickle=False))


def _fits(path: Path) -> NDArray[Any]:
    try:
        from astropy.io import fits  # noqa: PLC0415  an extra
    except ImportError as error:
        raise ImportError(
            "astropy: apt install python3-astropy, or pip install astropy"
        ) from error
    with fits.open(path) as units:
        for unit in units:
            if unit.data is not None and np.ndim(unit.data) >= 2:
                planes = np.asarray(unit.data)
                # FITS has colours first; rows stay as they lie in the file.
                return planes if planes.ndim == 2 else np.moveaxis(planes, 0, -1)
    raise ValueError("no unit of it holds an image")


def _raw(path: Path) -> NDArray[Any]:
    try:
        import rawpy  # noqa: PLC0415  an extra
    except ImportError as error:
        raise ImportError("rawpy: pip install rawpy") from error
    with rawpy.imread(str(path)) as raw:
        return np.array(raw.raw_image_visible)
