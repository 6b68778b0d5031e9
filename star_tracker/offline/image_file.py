"""Image files as arrays: what Pillow reads, numpy arrays, FITS and raw files of cameras."""

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


def _pillow(path: Path) -> NDArray[Any]:
    try:
        from PIL import Image  # noqa: PLC0415  an extra
    except ImportError as error:
        raise ImportError("Pillow: apt install python3-pil, or pip install Pillow") from error
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a picture of a size that is an attack is refused
        with Image.open(path) as image:
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
