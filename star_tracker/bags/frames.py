"""The messages of a bag's frames as centroids: read, or detected, as centroid_node does."""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from star_tracker.bags.reading import BagFrame, DamagedBagError
from star_tracker.bags.topics import CENTROIDS, COMPRESSED
from star_tracker.detection.centroids import DetectSettings
from star_tracker.detection.detect import detect_stars
from star_tracker.msg_adapters import MessageError
from star_tracker.msg_adapters.image import Picture, picture_from_compressed, picture_from_image
from star_tracker.msg_adapters.point_cloud import centroids_from_cloud
from star_tracker.offline.frame_file import FileFrame
from star_tracker.offline.spreading import Spread
from star_tracker.optics.camera import PIXEL_ORIGINS


@dataclass(frozen=True)
class Reading:
    """How messages become frames.

    Attributes:
        path: of the bag.
        detect: of the detector.
        bayer: pattern of raw images whose encoding does not tell it.
        from_center: whether pixels of images are counted as CameraInfo counts them.
        added_px: what is added to listed centroids, so that they are counted as the camera is.
    """

    path: Path
    detect: DetectSettings
    bayer: str = ""
    from_center: bool = False
    added_px: float = 0.0


@dataclass(frozen=True)
class ReadFrame:
    """A frame of a bag without its message, and what the message holds or why it is of no use."""

    bag_frame: BagFrame
    found: FileFrame | ValueError


def read_frames(
    frames: Iterable[BagFrame], kind: str, reading: Reading, spread: Spread
) -> Iterator[ReadFrame]:
    """Yield what the frames of a topic hold, in order.

    Centroids have the size (0, 0): their messages do not tell it. Raises
    DamagedBagError, after the last frame before the damage, where the bag cannot be read any
    further.
    """
    work = partial(_read, reading)
    items = _until_damage(frames)
    for one in map(work, items) if kind == CENTROIDS else spread.map(work, items):
        if isinstance(one, DamagedBagError):
            raise one
        yield one


def _until_damage(frames: Iterable[BagFrame]) -> Iterator[BagFrame | DamagedBagError]:
    """Yield the frames, and last the error if there is one, so that none is lost on the way."""
    try:
        yield from frames
    except DamagedBagError as error:
        yield error


def _read(reading: Reading, frame: BagFrame | DamagedBagError) -> ReadFrame | DamagedBagError:
    if isinstance(frame, DamagedBagError):
        return frame
    if isinstance(frame.message, MessageError):
        return ReadFrame(replace(frame, message=None), frame.message)
    try:
        found: FileFrame | ValueError = (
            _listed(reading, frame) if frame.kind == CENTROIDS else _detected(reading, frame)
        )
    except ValueError as error:
        found = error
    return ReadFrame(replace(frame, message=None), found)


def _listed(reading: Reading, frame: BagFrame) -> FileFrame:
    centroids = centroids_from_cloud(frame.message)
    return FileFrame(
        reading.path, (0, 0), centroids.xy_px + reading.added_px, centroids.intensity, 0.0,
        added_px=reading.added_px,
    )


def _detected(reading: Reading, frame: BagFrame) -> FileFrame:
    """Return the stars of an image, rounded as in a message of centroid_node."""
    started_ns = time.thread_time_ns()
    picture = _picture(frame)
    stars = detect_stars(
        picture.pixels, reading.detect, bayer=picture.bayer or reading.bayer
    )
    with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite
        intensity = np.asarray(stars.flux, np.float32).astype(float)
    height, width = picture.pixels.shape[:2]
    return FileFrame(
        reading.path, (int(width), int(height)),
        stars.xy_px - (PIXEL_ORIGINS["center"] if reading.from_center else 0.0), intensity,
        (time.thread_time_ns() - started_ns) / 1e6,
    )


def _picture(frame: BagFrame) -> Picture:
    message: Any = frame.message
    if frame.kind == COMPRESSED:
        return picture_from_compressed(message)
    return picture_from_image(message)
