"""Image files as arrays: what Pillow reads, numpy arrays, FITS and raw files of cameras."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from star_tracker.detection.image import MAX_PIXELS

#: Endings by reader; whatever else is tried with Pillow.
FITS = (".fits", ".fit", ".fts")
RAW = (".arw", ".cr2", ".cr3", ".dng", ".nef", ".orf", ".pef", ".raf", ".rw2")
PILLOW = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".webp")
ARRAY = (".npy",)
#: Tags of a TIFF.
_SUBFILE_TYPE, _BITS_PER_SAMPLE = 254, 258


def read_image(path: Path) -> NDArray[Any]:
    """Return an image (h, w) or (h, w, colours) as it lies in the file.

    Raises ValueError with the file's name and what is wrong with it, or which library it needs.
    """
    ending = path.suffix.lower()
    reader = _fits if ending in FITS else _raw if ending in RAW else _pillow
    reader = _array if ending in ARRAY else reader
    if not path.is_file():
        what = "it is no file" if path.exists() else "there is no such file"
        raise ValueError(f"{path} cannot be read: {what}")
    try:
        image = reader(path)
    except ImportError as error:
        raise ValueError(f"{path} needs {error}") from error
    except Exception as error:  # readers raise errors of many kinds for damaged files
        raise ValueError(f"{path} cannot be read: {' '.join(str(error).split())}") from error
    if image.ndim not in (2, 3):
        raise ValueError(f"{path} holds an array of shape {image.shape}: no image")
    return image


def decode_image(data: bytes) -> NDArray[Any]:
    """Return the image (h, w) or (h, w, colours) that the bytes of a PNG or JPEG file hold.

    Raises ValueError for what Pillow cannot decode or what has more than `MAX_PIXELS`, and
    ImportError with the remedy where there is no Pillow.
    """
    pillow = _pillow_module()
    try:
        return _opened(pillow, io.BytesIO(data))
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
    return _opened(_pillow_module(), path)


def _opened(pillow: Any, file: Any) -> NDArray[Any]:
    """Return the pixels of a file or a stream that Pillow opens. Raises ValueError."""
    with warnings.catch_warnings():
        # Of sizes, which are looked at here, odd tags, and transparency, which does not matter.
        warnings.simplefilter("ignore")
        with pillow.open(file) as image:
            if image.width * image.height > MAX_PIXELS:
                raise ValueError(
                    f"it has {image.width} x {image.height} px, more than "
                    f"{MAX_PIXELS // 1_000_000} million: bin or crop it"
                )
            n = _n_pages(image)
            if n > 1:
                raise ValueError(f"it holds {n} images: save each as a file of its own")
            return _values(image)


def _n_pages(image: Any) -> int:
    """Return how many images there are besides smaller copies, as a TIFF may hold for previews."""
    n = getattr(image, "n_frames", 1)
    if n > 1 and image.format == "TIFF":
        n = 0
        for page in range(image.n_frames):
            image.seek(page)
            n += not image.tag_v2.get(_SUBFILE_TYPE, 0) & 1
        image.seek(0)
    return n


def _bits(image: Any) -> int:
    """Return how many bits a file has for each colour, of which Pillow may keep 8."""
    if image.format == "TIFF":
        return int(max(image.tag_v2.get(_BITS_PER_SAMPLE, (8,))))
    how = image.tile[0][3] if image.tile else ""
    if image.format == "PPM" and isinstance(how, tuple):
        return int(max(one for one in how if isinstance(one, int))).bit_length()
    return 16 if isinstance(how, str) and ";16" in how else 8


def _values(image: Any) -> NDArray[Any]:
    """Return the pixels of an image of Pillow's. Raises ValueError where it keeps a part alone."""
    if len(image.getbands()) > 1 and _bits(image) > 8:
        raise ValueError(
            f"it is a colour image of {_bits(image)} bits, of which Pillow keeps 8: save it as "
            "grey of 16 bits, or as .npy or FITS"
        )
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
