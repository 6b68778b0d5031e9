"""What a user calls an image -> one plane of numbers, with what is known of its pixels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from star_tracker.detection.planes import Plane, plane

#: Larger images are refused: the largest sensors have 150 million pixels.
MAX_PIXELS = 160_000_000
#: No camera's counts, and a square of it is near the end of single precision.
_LARGEST_VALUE = 1e18
#: Colours of the first two pixels of the first two rows.
BAYER_PATTERNS = ("rggb", "bggr", "grbg", "gbrg")
#: A sensor leaves its straight line a little below its end, and JPEG ripples there.
_STRAIGHT_TO = 0.98
#: So far above the background, in its noises, some pixels side by side that are exactly equal are
#: no chance: the photons' noise alone would tell them apart.
_PLATEAU_NOISES, _PLATEAU_NEIGHBOURS = 50.0, 3
#: Every so many pixels are enough to know an image's level and noise roughly.
_SAMPLES = 2048
#: So many pixels are looked at in one go.
_BLOCK = 50_000


@dataclass(frozen=True)
class Frame:
    """An image as the detector works on it.

    Attributes:
        pixels: (h, w) values, NaN where a pixel is not to be used.
        saturation_level: values from here on are saturated; infinity for none.
        step: smallest difference of two values, 0 where it is not known.
        channel: (2, 2) which of the colours 0 to 2 the pixels of even and odd rows and columns
            see; all 0 but for a Bayer pattern.
    """

    pixels: Plane
    saturation_level: float
    step: float
    channel: NDArray[np.int64]

    @property
    def is_blank(self) -> bool:
        """Whether no pixel is to be used."""
        return self.pixels.size == 0 or bool(np.isnan(np.fmax.reduce(self.pixels, axis=None)))


def as_frame(
    image: ArrayLike,
    *,
    bayer: str = "",
    mask: ArrayLike | None = None,
    dark: ArrayLike | None = None,
    saturation_level: float | None = None,
) -> Frame:
    """Return an image as one plane: colours averaged, dark subtracted, masked pixels NaN.

    `star_tracker.detection.detect.detect_stars` describes the arguments. Raises ValueError for
    what is no image, naming the remedy.
    """
    values = np.asarray(image)
    _check(values, "image")
    _check_bayer(bayer, values)
    pixels = _one_plane(values, "pixels")
    usable = _only_finite(pixels) if values.dtype.kind == "f" else pixels.size > 0
    level = saturation_level
    if level is None:
        level = _saturation(values, pixels) if usable else np.inf
    clipped = None
    if values.ndim == 3 and np.isfinite(level):
        clipped = np.any(values[:, :, :3] >= level, axis=2)
    if dark is not None:
        clipped = pixels >= level if clipped is None else clipped
        pixels -= _companion(dark, pixels.shape, "dark")
        usable = _only_finite(pixels)
    if clipped is not None:
        pixels[clipped & ~np.isnan(pixels)] = level
    if mask is not None:
        pixels[_companion(mask, pixels.shape, "mask") != 0] = np.nan
    return Frame(pixels, level, _step(pixels) if usable else 0.0, _channels(bayer))


def _check(values: NDArray[np.generic], name: str) -> None:
    """Raise ValueError unless these are the pixels of an image."""
    if values.dtype.kind not in "uifb":
        raise ValueError(
            f"the {name} holds {values.dtype}: give real numbers, such as uint8, uint16 or float32"
        )
    if values.ndim not in {2, 3} or (values.ndim == 3 and values.shape[2] not in {1, 3, 4}):
        raise ValueError(
            f"the {name} has shape {values.shape}: give (height, width), or (height, width, "
            "colours) with 1, 3 or 4 colours"
        )
    if values.shape[0] * values.shape[1] > MAX_PIXELS:
        raise ValueError(
            f"the {name} has {values.shape[1]} x {values.shape[0]} pixels, more than "
            f"{MAX_PIXELS // 1_000_000} million: bin or crop it"
        )


def _check_bayer(bayer: str, values: NDArray[np.generic]) -> None:
    if bayer and bayer not in BAYER_PATTERNS:
        raise ValueError(f"bayer {bayer!r} is unknown: use {', '.join(BAYER_PATTERNS)} or none")
    if bayer and values.ndim == 3:
        raise ValueError("a Bayer pattern belongs to an image of one plane: leave bayer empty")


def _one_plane(values: NDArray[np.generic], name: str) -> Plane:
    """Return (h, w) float32, a copy: the mean of the colours without the opacity."""
    pixels = plane(name, values.shape[:2])
    with np.errstate(over="ignore", invalid="ignore"):
        if values.ndim == 2:
            np.copyto(pixels, values, casting="unsafe")
            return pixels
        colours = values[:, :, :3]
        np.copyto(pixels, colours[:, :, 0], casting="unsafe")
        for colour in range(1, colours.shape[2]):
            pixels += np.asarray(colours[:, :, colour], np.float32)
        pixels /= np.float32(colours.shape[2])
    return pixels


def _only_finite(pixels: Plane) -> bool:
    """Turn what is not finite into NaN; return whether a finite pixel is left.

    Raises ValueError for pixels whose squares single precision does not hold.
    """
    # A sum is not finite where a pixel is not: one quick look, nearly always enough.
    with np.errstate(over="ignore", invalid="ignore"):
        total = np.sum(pixels, dtype=np.float64)
        if np.isfinite(total) and abs(total) < _LARGEST_VALUE:
            return pixels.size > 0
        largest = np.max(np.abs(pixels, where=np.isfinite(pixels), out=np.zeros_like(pixels)))
    if largest > _LARGEST_VALUE:
        raise ValueError(
            f"the image holds values of {largest:.3g}: scale them to below {_LARGEST_VALUE:g}"
        )
    bad = ~np.isfinite(pixels)
    pixels[bad] = np.nan
    return not bool(bad.all())


def _companion(values: ArrayLike, shape: tuple[int, ...], name: str) -> Plane:
    """Return a dark frame or a mask as a plane of the image's shape."""
    given = np.asarray(values)
    _check(given, name)
    if given.shape[:2] != shape:
        raise ValueError(
            f"the {name} has {given.shape[1]} x {given.shape[0]} pixels, the image "
            f"{shape[1]} x {shape[0]}: take it with the same camera and size"
        )
    return _one_plane(given, "companion")


def _saturation(values: NDArray[np.generic], pixels: Plane) -> float:
    """Return from which value on pixels count as saturated, infinity where none does.

    A pixel at least is finite.
    """
    colours = values if values.ndim == 2 else values[:, :, :3]
    largest = float(np.nanmax(pixels) if values.dtype.kind == "f" else colours.max())
    if np.issubdtype(values.dtype, np.integer) and largest == np.iinfo(values.dtype.str).max:
        return _STRAIGHT_TO * largest
    return _STRAIGHT_TO * largest if _is_plateau(pixels, largest) else np.inf


def _is_plateau(pixels: Plane, largest: float) -> bool:
    """Return whether an image ends in a plateau at its largest value."""
    y, x = _first_places(pixels, largest, _SAMPLES // 2)
    if len(y) <= _PLATEAU_NEIGHBOURS:
        return False
    sample = pixels.ravel()[:: max(1, pixels.size // _SAMPLES)]
    sample = sample[~np.isnan(sample)]
    if len(sample) == 0:
        return False
    middle = np.median(sample)
    noise = 1.4826 * np.median(np.abs(sample - middle))
    if not largest - middle > _PLATEAU_NOISES * max(noise, 1e-6 * abs(largest)):
        return False
    near = (np.abs(y[:, None] - y) <= 1) & (np.abs(x[:, None] - x) <= 1)
    return bool(near.sum(axis=1).max() > _PLATEAU_NEIGHBOURS)


def _first_places(
    pixels: Plane, value: float, most: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of the first pixels that have a value.

    Of a plateau this large it does not matter where it ends. Blocks of rows stay in the cache.
    """
    rows = max(1, _BLOCK // pixels.shape[1])
    y, x, n = [np.empty(0, np.int64)], [np.empty(0, np.int64)], 0
    for top in range(0, len(pixels), rows):
        here = pixels[top : top + rows] == value
        if n < most and here.any():
            places = np.nonzero(here)
            y.append(places[0] + top)
            x.append(places[1])
            n += len(places[0])
    return np.concatenate(y)[:most], np.concatenate(x)[:most]


def _step(pixels: Plane) -> float:
    """Return the smallest difference of two values of an image, from a sample of it.

    Whole numbers need not be the step: twelve bits are often stored as the upper ones of sixteen.
    """
    sample = pixels.ravel()[:: max(1, pixels.size // _SAMPLES)]
    values = np.unique(sample[~np.isnan(sample)])
    return float(np.diff(values).min()) if len(values) > 1 else 0.0


def _channels(bayer: str) -> NDArray[np.int64]:
    colours = ["rgb".index(letter) for letter in bayer] if bayer else [0, 0, 0, 0]
    return np.array(colours, np.int64).reshape(2, 2)
