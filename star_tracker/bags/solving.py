"""The frames of a bag solved in their order, as identify_node solves them.

The camera is that of CameraInfo where there is one; what a frame tells of it is used for those
after it, and after a fix the predicted attitude is tried first. Nothing of a later frame is used
for an earlier one, so that the results are those of the nodes, bit for bit.
"""

from collections.abc import Iterator
from dataclasses import replace

from star_tracker.attitude.prediction import Predictor
from star_tracker.bags.frames import ReadFrame, Reading, read_frames
from star_tracker.bags.reading import Bag, BagFrame
from star_tracker.bags.topics import CENTROIDS
from star_tracker.calibration.learning import LearningTracker
from star_tracker.identification.searcher import METHODS
from star_tracker.offline.frame_file import FileFrame
from star_tracker.offline.solving import Asked, Place, Result
from star_tracker.offline.spreading import Spread
from star_tracker.optics.camera import Camera
from star_tracker.solution import Solution

#: How far the focal length of CameraInfo may be off, %, as calibrations age; identify_node has the
#: same by default.
_INFO_TOLERANCE_PERCENT = 1.0


class BagSolver:
    """Solves the frames of one bag one after the other.

    Args:
        bag: that is open.
        asked: what the user says of camera and sky; it goes before CameraInfo.

    Attributes:
        note: a sentence about CameraInfo that could not be used, empty for none.

    Raises ValueError where the size of centroids' images is not known.
    """

    def __init__(self, bag: Bag, asked: Asked) -> None:
        self._bag, self._asked = bag, asked
        announced, told = bag.announced(), asked.camera
        self.note = ""
        if announced.refused and not announced and not asked.tells_camera:
            self.note = f"{bag.path}: {announced.refused}; the camera is found out instead"
        self._announced = None if asked.tells_camera or not announced else announced
        self._size_px = asked.size_px or announced.size_px
        if told is not None:
            self._size_px = told.width_px, told.height_px
        if bag.kind == CENTROIDS and not any(self._size_px):
            raise ValueError(
                f"{bag.path} has centroids without CameraInfo: give the size of their image with "
                "--width-px and --height-px"
            )
        self._tracker: LearningTracker | None = None
        self._made_for: tuple[tuple[int, int], Camera | None] | None = None
        self._predictor = Predictor()

    def results(self, spread: Spread) -> Iterator[tuple[BagFrame, Result]]:
        """Yield each frame, without its message, with what became of it.

        Raises DamagedBagError, after the last frame before the damage, where the bag cannot be
        read any further.
        """
        bag, asked = self._bag, self._asked
        with_info = self._announced is not None
        reading = Reading(
            bag.path, asked.detect, asked.bayer, from_center=with_info,
            added_px=0.0 if with_info else asked.added_px,
        )
        for read in read_frames(bag.frames(), bag.kind, reading, spread):
            yield read.bag_frame, self._result(read)

    def _result(self, read: ReadFrame) -> Result:
        at, found, path = read.bag_frame, read.found, self._bag.path
        place = Place(self._bag.topic, at.number, at.stamp_ns)
        where = f"{path}, frame {at.number} of {place.topic}"
        if isinstance(found, ValueError):
            return Result(path, None, None, f"{where}: {found}", place)
        try:
            camera = self._camera(found, at)
            frame = self._sized(found, camera)
            return Result(path, frame, self._solution(frame, camera, at.stamp_ns), "", place)
        except ValueError as error:
            return Result(path, None, None, f"{where}: {error}", place)

    def _camera(self, frame: FileFrame, at: BagFrame) -> Camera | None:
        """Return the camera of a frame, None for any. Raises ValueError where it is not clear."""
        if self._announced is None:
            return self._asked.told(frame.size_px if any(frame.size_px) else self._size_px)
        camera = self._announced.at(at.stamp_ns, at.frame_id)
        return replace(camera, tolerance_percent=_INFO_TOLERANCE_PERCENT)

    def _sized(self, frame: FileFrame, camera: Camera | None) -> FileFrame:
        """Return a frame with the size of its image. Raises ValueError for a camera of another."""
        size = self._size_px if camera is None else (camera.width_px, camera.height_px)
        if not any(frame.size_px):
            return replace(frame, size_px=size)
        if camera is not None and size != frame.size_px:
            raise ValueError(
                "CameraInfo is for {} x {} px, the image has {} x {}: ".format(
                    *size, *frame.size_px
                ) + "give the camera with --camera or --fov-deg"
            )
        return frame

    def _solution(self, frame: FileFrame, camera: Camera | None, stamp_ns: int) -> Solution:
        made_for = frame.size_px, camera
        asked = self._asked
        if self._tracker is None or asked.independent or made_for != self._made_for:
            self._tracker, self._made_for = self._new_tracker(frame, camera), made_for
        predicted = None if asked.independent else self._predictor.predict(stamp_ns)
        solution = self._tracker.solve(frame.xy_px, frame.intensity, predicted=predicted)
        if solution.attitude is not None:
            self._predictor.add(stamp_ns, solution.attitude.quaternion_xyzw)
        return solution

    def _new_tracker(self, frame: FileFrame, camera: Camera | None) -> LearningTracker:
        """Return a tracker of both methods, as the node's, where the camera is known."""
        method = METHODS[0] if camera is None else "auto"
        asked = replace(self._asked, settings=replace(self._asked.settings, method=method))
        return asked.tracker(frame.size_px, camera)
