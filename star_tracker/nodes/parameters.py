"""Parameters of the nodes, each declared once with unit, range and description.

A value of a wrong type or out of range raises ParameterError, whose text is one line that names
the parameter and what is allowed. An integer is accepted for a floating-point parameter: leaving
out the decimal point is the commonest mistake in a YAML file. So is a false for the choice `off`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node

from star_tracker.attitude.prediction import PREDICTION_MODES
from star_tracker.calibration.focal_length import MODES as FOCAL_LENGTH_MODES
from star_tracker.catalogue.catalog import CATALOGS, EPOCH_RANGE, LIMITING_MAGNITUDE_RANGE
from star_tracker.catalogue.database import DEFAULT_MAX_SEPARATION_DEG, MAX_SEPARATION_RANGE_DEG
from star_tracker.identification.searcher import METHODS
from star_tracker.optics.camera import FOV_RANGE_DEG, PARITIES


class ParameterError(ValueError):
    """A parameter's value cannot be used."""


@dataclass(frozen=True)
class Parameter:
    """One parameter: the type is that of its default (bool, int, float, str or a tuple of them).

    Attributes:
        name: as in YAML.
        default: value and type.
        description: what it does.
        unit: of the value, empty where it has none.
        allowed: lowest and highest value of a number, or of each number of a list.
        choices: allowed words of a text.
        fixed: whether it cannot change while the node runs.
    """

    name: str
    default: Any
    description: str
    unit: str = ""
    allowed: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    fixed: bool = False

    def descriptor(self) -> ParameterDescriptor:
        """Describe the parameter for `ros2 param describe`."""
        unit = f" [{self.unit}]" if self.unit else ""
        descriptor = ParameterDescriptor(
            name=self.name, description=f"{self.description}{unit}",
            additional_constraints=self._constraint(), read_only=self.fixed,
            # The type is checked below, where an int may stand for a float.
            dynamic_typing=True,
        )
        if self.allowed and isinstance(self.default, float):
            low, high = self.allowed
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        elif self.allowed and isinstance(self.default, int):
            low, high = (int(bound) for bound in self.allowed)
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=1)]
        return descriptor

    def checked(self, value: Any) -> Any:
        """Return the value in the parameter's own type. Raises ParameterError."""
        if not isinstance(self.default, tuple):
            return self._checked_item(value, type(self.default), value)
        if isinstance(value, (str, bytes)) or not isinstance(value, Sequence):
            raise self.error(value)
        if len(value) == 0:
            raise self.error(value)
        kind = type(self.default[0])
        return tuple(self._checked_item(item, kind, value) for item in value)

    def _checked_item(self, item: Any, kind: type, shown: Any) -> Any:
        if kind is float and type(item) is int:
            item = float(item)
        if item is False and "off" in self.choices:  # YAML reads off without quotes as false
            item = "off"
        if type(item) is not kind:
            raise self.error(shown)
        if kind in (int, float):
            low, high = self.allowed or (-math.inf, math.inf)
            if not low <= item <= high:  # NaN is in no range
                raise self.error(shown)
        if self.choices and item not in self.choices:
            raise self.error(shown)
        return item

    def _constraint(self) -> str:
        kind = self.default[0] if isinstance(self.default, tuple) else self.default
        words = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}
        text = words[type(kind)]
        if isinstance(self.default, tuple):
            text = f"a list, each item {text}"
        if self.choices:
            return f"one of {', '.join(self.choices)}"
        if self.allowed and all(math.isfinite(bound) for bound in self.allowed):
            return f"{text} from {self.allowed[0]:.10g} to {self.allowed[1]:.10g}"
        return text

    def error(self, value: Any) -> ParameterError:
        """Return the error that says in one line what the value must be."""
        shown = list(value) if not isinstance(value, (str, bytes)) and isinstance(
            value, Sequence
        ) else value
        unit = f" {self.unit}" if self.unit else ""
        return ParameterError(
            f"parameter {self.name} is {shown!r}: it must be {self._constraint()}{unit}"
        )


IDENTIFY_PARAMETERS = (
    Parameter("fov_deg", 12.0, "field of view across the image's width", "deg", FOV_RANGE_DEG),
    Parameter("width_px", 512, "image width", "px", (16, 65536)),
    Parameter("height_px", 512, "image height", "px", (16, 65536)),
    Parameter("cx_px", -1.0, "principal point, x; -1 = half of the width", "px", (-1.0, 65536.0)),
    Parameter("cy_px", -1.0, "principal point, y; -1 = half of the height", "px", (-1.0, 65536.0)),
    Parameter(
        "parity", "normal", "normal: y down; mirrored: y up or seen in a mirror; auto: find out",
        choices=PARITIES,
    ),
    Parameter(
        "use_camera_info", False, "take camera and size from camera_info, not from parameters",
        fixed=True,
    ),
    Parameter(
        "camera_info_wait_ms", 100.0, "longest wait of a frame for its camera_info", "ms",
        (0.0, 10000.0),
    ),
    Parameter(
        "method", "auto",
        "match_group, radial_cyclic, or auto: the first, then the second as its fallback",
        choices=("auto", *METHODS),
    ),
    Parameter(
        "pair_tolerance_px", (2.0, 6.0, 12.0),
        "tolerances of a star pair's separation, tried in turn", "px", (0.01, 100.0),
    ),
    Parameter(
        "centroid_sigma_px", 0.0, "noise of a centroid along each axis; 0 = find out", "px",
        (0.0, 100.0),
    ),
    Parameter(
        "displaced_gate_px", 40.0,
        "farthest that a displaced star may lie from its place; 0 = label none", "px",
        (0.0, 1000.0),
    ),
    Parameter(
        "max_log10_false_alarms", -3.0,
        "accept a solution whose log10 of expected false alarms is below", "", (-100.0, 0.0),
    ),
    Parameter(
        "calibrate_focal_length", "off",
        "estimate the focal length from solved frames: report it, or apply it to later frames too",
        choices=FOCAL_LENGTH_MODES, fixed=True,
    ),
    Parameter(
        "mode", "auto",
        "auto: after a fix try the predicted attitude first; lost_in_space: never",
        choices=PREDICTION_MODES,
    ),
    Parameter(
        "tracking_max_age_s", 2.0, "oldest fix from which an attitude is predicted", "s",
        (0.0, 3600.0),
    ),
    Parameter("deadline_ms", 200.0, "give up on a frame after this time", "ms", (0.1, 60000.0)),
    Parameter(
        "keep_up", True,
        "give up on a frame sooner where frames come faster: after 3/4 of the time between two",
    ),
    Parameter("max_centroids", 1000, "refuse a frame with more centroids", "", (4, 10000)),
    Parameter(
        "queue_depth", 10, "frames that wait at most; the oldest ones are dropped", "", (1, 1000),
        fixed=True,
    ),
    Parameter(
        "catalog", "paper", "paper: the 4908 numbered stars; hipparcos: for real skies",
        choices=CATALOGS,
    ),
    Parameter(
        "limiting_magnitude", 6.0, "faintest guide stars of catalog hipparcos", "V mag",
        LIMITING_MAGNITUDE_RANGE,
    ),
    Parameter(
        "min_separation_deg", 0.05, "closer stars of catalog hipparcos are merged into one", "deg",
        (0.0, 1.0),
    ),
    Parameter(
        "epoch", 2000.0, "epoch to which proper motion carries the guide stars", "Julian year",
        EPOCH_RANGE,
    ),
    Parameter(
        "max_separation_deg", DEFAULT_MAX_SEPARATION_DEG,
        "largest separation of a guide-star pair", "deg", MAX_SEPARATION_RANGE_DEG,
    ),
    Parameter("reference_frame", "icrs", "frame_id of the attitude", fixed=True),
    Parameter(
        "camera_frame", "", "frame_id of the stars; empty = that of the centroids", fixed=True
    ),
    Parameter("publish_markers", False, "publish markers for RViz and Foxglove"),
)

_OF_REPLAY = (
    Parameter("maps", (1, 2, 3, 4, 5, 6, 7, 8), "numbers of the star maps, in order", "", (1, 8)),
    Parameter("folder", "", "folder with map1.csv ... map8.csv; empty = the shipped maps"),
    Parameter("rate_hz", 10.0, "frames per second", "Hz", (0.001, 10000.0)),
    Parameter("loop", False, "start again after the last map, without end"),
    Parameter("noise_px", 0.0, "standard deviation of noise added to x and y", "px", (0.0, 100.0)),
    Parameter("seed", 0, "seed of noise and shuffling", "", (0, 2**31 - 1)),
    Parameter("shuffle", False, "put the centroids of each frame in random order"),
    Parameter(
        "publish_camera_info", True,
        "publish camera_info too, and wait up to 3 s for its subscriber",
    ),
    Parameter("camera_frame", "camera", "frame_id of the frames"),
)
REPLAY_PARAMETERS = tuple(replace(parameter, fixed=True) for parameter in _OF_REPLAY)


def declare(node: Node, parameters: Sequence[Parameter]) -> dict[str, Any]:
    """Declare parameters on a node and return their checked values by name."""
    values = {}
    for parameter in parameters:
        default = parameter.default
        default = list(default) if isinstance(default, tuple) else default
        try:
            declared = node.declare_parameter(parameter.name, default, parameter.descriptor())
        except (InvalidParameterTypeException, InvalidParameterValueException) as error:
            # rclpy refuses an override outside of the descriptor's range before we see it.
            override = node._parameter_overrides.get(parameter.name)  # noqa: SLF001
            shown = override.value if override is not None else default
            raise parameter.error(shown) from error
        values[parameter.name] = parameter.checked(declared.value)
    return values
