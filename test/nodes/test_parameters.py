"""Parameters: their checks, their descriptions and the files in config/."""

import re
from itertools import pairwise

import pytest
import yaml
from rcl_interfaces.msg import FloatingPointRange, IntegerRange
from rclpy.parameter import Parameter as RosParameter
from ros_helpers import PAPER_CAMERA, open_bench

from star_tracker.nodes.centroid_node import CentroidNode
from star_tracker.nodes.declaring import Parameter, ParameterError, unheard_files
from star_tracker.nodes.identify.solver_setup import SolverSetup
from star_tracker.nodes.identify_node import IdentifyNode
from star_tracker.nodes.parameters import (
    IDENTIFY_PARAMETERS,
    REPLAY_PARAMETERS,
    IdentifyParameters,
)
from star_tracker.nodes.replay_node import ReplayNode
from star_tracker.nodes.sky_image_node import SkyImageNode
from star_tracker.resources import resource_path
from star_tracker.solution import SolveSettings

NODES = {
    "identify_node": (IdentifyNode, IDENTIFY_PARAMETERS),
    "replay_node": (ReplayNode, REPLAY_PARAMETERS),
}
EVERY_PARAMETER = [*IDENTIFY_PARAMETERS, *REPLAY_PARAMETERS]
NUMBER = Parameter("angle_deg", 10.0, "an angle", "deg", (0.5, 120.0))
WHOLE = Parameter("count", 5, "a number of things", allowed=(1, 10))
NUMBERS = Parameter("steps_px", (1.0, 2.0), "steps", "px", (0.5, 100.0))
WHOLES = Parameter("maps", (1, 2), "maps", allowed=(1, 8))
CHOICE = Parameter("colour", "red", "a colour", choices=("red", "blue"))
TEXT = Parameter("frame", "icrs", "a frame_id")
SWITCH = Parameter("loop", False, "again")


# ---- the check of one value ------------------------------------------------------------------


@pytest.mark.parametrize(("parameter", "value", "checked"), [
    (NUMBER, 10.5, 10.5),
    (NUMBER, 0.5, 0.5),
    (NUMBER, 120.0, 120.0),
    (NUMBER, 20, 20.0),
    (WHOLE, 1, 1),
    (WHOLE, 10, 10),
    (NUMBERS, [1.5], (1.5,)),
    (NUMBERS, [2, 6, 12], (2.0, 6.0, 12.0)),
    (NUMBERS, (1.0, 3), (1.0, 3.0)),
    (WHOLES, [8, 1, 8], (8, 1, 8)),
    (CHOICE, "blue", "blue"),
    (TEXT, "", ""),
    (SWITCH, True, True),
])
def test_good_value_comes_back_in_the_parameters_type(parameter, value, checked):
    result = parameter.checked(value)
    assert result == checked
    assert type(result) is type(parameter.default)
    if isinstance(result, tuple):
        assert {type(item) for item in result} == {type(parameter.default[0])}


ANGLE = "it must be a number from 0.5 to 120 deg"
COUNT = "it must be a whole number from 1 to 10"
STEPS = "it must be a list, each item a number from 0.5 to 100 px"


@pytest.mark.parametrize(("parameter", "value", "text"), [
    (NUMBER, float("nan"), f"parameter angle_deg is nan: {ANGLE}"),
    (NUMBER, float("inf"), f"parameter angle_deg is inf: {ANGLE}"),
    (NUMBER, 0.49, f"parameter angle_deg is 0.49: {ANGLE}"),
    (NUMBER, 120.01, f"parameter angle_deg is 120.01: {ANGLE}"),
    (NUMBER, 121, f"parameter angle_deg is 121: {ANGLE}"),
    (NUMBER, "12", f"parameter angle_deg is '12': {ANGLE}"),
    (NUMBER, True, f"parameter angle_deg is True: {ANGLE}"),
    (NUMBER, [12.0], f"parameter angle_deg is [12.0]: {ANGLE}"),
    (NUMBER, None, f"parameter angle_deg is None: {ANGLE}"),
    (WHOLE, 0, f"parameter count is 0: {COUNT}"),
    (WHOLE, 11, f"parameter count is 11: {COUNT}"),
    (WHOLE, 5.0, f"parameter count is 5.0: {COUNT}"),
    (WHOLE, True, f"parameter count is True: {COUNT}"),
    (NUMBERS, [], f"parameter steps_px is []: {STEPS}"),
    (NUMBERS, 2.0, f"parameter steps_px is 2.0: {STEPS}"),
    (NUMBERS, "2.0", f"parameter steps_px is '2.0': {STEPS}"),
    (NUMBERS, [1.0, 0.1], f"parameter steps_px is [1.0, 0.1]: {STEPS}"),
    (NUMBERS, [1.0, float("nan")], f"parameter steps_px is [1.0, nan]: {STEPS}"),
    (NUMBERS, ["a"], f"parameter steps_px is ['a']: {STEPS}"),
    (WHOLES, [1, 9],
     "parameter maps is [1, 9]: it must be a list, each item a whole number from 1 to 8"),
    (CHOICE, "green", "parameter colour is 'green': it must be one of red, blue"),
    (CHOICE, "Red", "parameter colour is 'Red': it must be one of red, blue"),
    (CHOICE, 3, "parameter colour is 3: it must be one of red, blue"),
    (TEXT, 3, "parameter frame is 3: it must be a text"),
    (SWITCH, "true", "parameter loop is 'true': it must be true or false"),
    (SWITCH, 1, "parameter loop is 1: it must be true or false"),
])
def test_bad_value_is_refused_in_one_line_that_names_the_parameter(parameter, value, text):
    with pytest.raises(ParameterError) as caught:
        parameter.checked(value)
    assert str(caught.value) == text


# ---- what the nodes declare ------------------------------------------------------------------


def test_defaults_are_allowed():
    for parameter in EVERY_PARAMETER:
        assert parameter.checked(parameter.default) == parameter.default


def test_descriptions_have_words_and_the_unit():
    for parameter in EVERY_PARAMETER:
        text = parameter.descriptor().description
        assert text.startswith(parameter.description)
        assert len(parameter.description.split()) > 1, parameter.name
        assert text.endswith(f" [{parameter.unit}]" if parameter.unit else parameter.description)


def test_unit_in_a_name_is_the_unit():
    units = {"deg": "deg", "px": "px", "ms": "ms", "hz": "Hz", "magnitude": "mag", "percent": "%"}
    for parameter in EVERY_PARAMETER:
        suffix = parameter.name.rpartition("_")[2]
        assert parameter.unit == units.get(suffix, parameter.unit), parameter.name


def test_each_number_has_a_range():
    for parameter in EVERY_PARAMETER:
        is_list = isinstance(parameter.default, tuple)
        kind = type(parameter.default[0] if is_list else parameter.default)
        descriptor = parameter.descriptor()
        ranges = descriptor.floating_point_range or descriptor.integer_range
        if kind in (str, bool):
            assert not ranges, parameter.name
            continue
        low, high = parameter.allowed
        words = re.search(r"from (\S+) to (\S+)$", descriptor.additional_constraints)
        assert (float(words[1]), float(words[2])) == (low, high), parameter.name
        if not is_list:  # a list has no range in a descriptor
            assert type(ranges[0]) is {float: FloatingPointRange, int: IntegerRange}[kind]
            assert (ranges[0].from_value, ranges[0].to_value) == (low, high), parameter.name


def test_choices_are_in_the_constraints():
    for parameter in EVERY_PARAMETER:
        constraints = parameter.descriptor().additional_constraints
        assert all(choice in constraints for choice in parameter.choices), parameter.name


def test_names_are_unique():
    for _, parameters in NODES.values():
        names = [parameter.name for parameter in parameters]
        assert len(set(names)) == len(names)


@pytest.mark.parametrize("node", NODES)
def test_node_declares_its_parameters_and_refuses_changes_of_fixed_ones(node):
    make, parameters = NODES[node]
    with open_bench() as bench:
        running = bench.start(make)
        for parameter in parameters:
            assert running.describe_parameter(parameter.name).read_only == parameter.fixed
            same = running.get_parameter(parameter.name)
            assert running.set_parameters([same])[0].successful != parameter.fixed


def test_fixed_parameters():
    fixed = {parameter.name for parameter in IDENTIFY_PARAMETERS if parameter.fixed}
    assert fixed == {
        "base_frame", "earth_frame", "publish_tf", "publish_quality", "use_fix",
        "use_velocity", "camera_frame", "queue_depth", "rectified", "reference_frame",
        "use_camera_info", "camera_file", "pixel_origin",
    }
    assert all(parameter.fixed for parameter in REPLAY_PARAMETERS)


@pytest.mark.parametrize("node", NODES)
def test_node_runs_with_its_defaults(node):
    make, parameters = NODES[node]
    with open_bench() as bench:
        running = bench.start(make)
        values = {p.name: p.checked(running.get_parameter(p.name).value) for p in parameters}
    told = PAPER_CAMERA if node == "identify_node" else {}
    assert values == {p.name: told.get(p.name, p.default) for p in parameters}


def test_what_is_given_a_value_but_no_parameter_is_named_at_the_start(capfd):
    with open_bench() as bench:
        node = bench.start(ReplayNode, {"rate": 5.0, "noise_pix": 1.0, "seed": 3, "whatever": 1})
        assert node.get_parameter("seed").value == 3
        assert not node.has_parameter("rate")
    lines = capfd.readouterr().err.splitlines()
    assert {line.split("replay_node]: ")[1] for line in lines if "[WARN]" in line} == {
        "there is no parameter rate: rate_hz?", "there is no parameter noise_pix: noise_px?",
        "there is no parameter whatever",
    }


@pytest.mark.parametrize(("make", "wrong", "meant"), [
    (IdentifyNode, "fov", "fov_deg"), (ReplayNode, "rate", "rate_hz"),
    (CentroidNode, "threshold", "threshold_sigma"), (SkyImageNode, "fov", "fov_deg"),
])
def test_a_change_of_a_parameter_that_does_not_exist_is_refused_by_name(make, wrong, meant):
    with open_bench() as bench:
        result = bench.start(make).set_parameters_atomically([RosParameter(wrong, value=1)])
    assert not result.successful
    assert result.reason == f"there is no parameter {wrong}: {meant}?"


def test_parameters_of_every_node_are_not_named_at_the_start(capfd):
    with open_bench() as bench:
        node = bench.start(
            ReplayNode, {"use_sim_time": True, "start_type_description_service": False}
        )
        assert node.get_parameter("use_sim_time").value
    assert "there is no parameter" not in capfd.readouterr().err


def test_the_dataclass_has_the_values_in_their_types():
    overrides = {"fov_deg": 20, "pair_tolerance_px": [1, 2], "parity": "auto"}
    with open_bench() as bench:
        p = bench.start(IdentifyNode, overrides)._setup.parameters
    assert (p.fov_deg, p.pair_tolerance_px, p.parity) == (20.0, (1.0, 2.0), "auto")
    told = {**PAPER_CAMERA, "fov_deg": 20.0, "pair_tolerance_px": (1.0, 2.0), "parity": "auto"}
    assert p == IdentifyParameters(**told)


@pytest.mark.parametrize(("cx_px", "middle"), [(-1.0, None), (0.0, 0.0), (12.5, 12.5)])
def test_the_principal_point_is_the_middle_unless_told(cx_px, middle):
    p = IdentifyParameters(cx_px=cx_px, width_px=512, height_px=512)
    assert p.principal_point_px == (middle, None)


def test_the_settings_defaults_are_those_of_the_solver():
    sized = IdentifyParameters(width_px=512, height_px=512)
    assert SolverSetup.of(sized).settings == SolveSettings()


# ---- files that are for another node ---------------------------------------------------------

FILE = "{}:\n  ros__parameters:\n    rate_hz: 5.0\n"
NESTED = "left:\n  {}:\n    ros__parameters:\n      rate_hz: 5.0\n"


@pytest.mark.parametrize(("text", "namespace", "heard"), [
    (FILE.format("/**"), "/left", True),
    (FILE.format("replay_node"), "/", True),
    (FILE.format("/replay_node"), "/", True),
    (FILE.format("/left/replay_node"), "/left", True),
    (FILE.format("/*/replay_node"), "/left", True),
    (FILE.format("/**/replay_node"), "/left/inner", True),
    (FILE.format("/**/replay_node"), "/", True),
    (NESTED.format("replay_node"), "/left", True),
    (FILE.format("star_tracker") + FILE.format("replay_node"), "/", True),
    (FILE.format("star_tracker"), "/", False),
    (FILE.format("replay_node"), "/left", False),
    (FILE.format("/*"), "/left", False),
    (NESTED.format("replay_node"), "/", False),
])
def test_a_parameter_file_for_another_node_is_named_as_rcl_takes_it(
    text, namespace, heard, tmp_path
):
    path = tmp_path / "other.yaml"
    path.write_text(text, encoding="utf-8")
    arguments = ["--ros-args", "-r", f"__ns:={namespace}", "--params-file", str(path)]
    with open_bench() as bench:
        node = bench._add(ReplayNode(context=bench.context, cli_args=arguments))
        sentences = unheard_files([node], arguments)
        assert node.get_parameter("rate_hz").value == (5.0 if heard else 10.0)  # what rcl says
        me = node.get_fully_qualified_name()
    assert bool(sentences) != heard
    for sentence in sentences:
        assert sentence.startswith(f"parameter file {path} has nothing for {me}, only for /")
        assert sentence.endswith(f": name it {me} or /**")


def test_an_empty_parameter_file_is_for_nobody(tmp_path):
    path = tmp_path / "empty.yaml"
    path.touch()
    with open_bench() as bench:
        node = bench.start(ReplayNode)
        assert unheard_files([node], ["--params-file", str(path), "--params-file"]) == []


def test_a_file_as_launch_writes_it_is_read(tmp_path):
    """It marks a list of numbers as a tuple of Python's, which rcl overlooks."""
    path = tmp_path / "launch_params"
    text = "/**:\n  ros__parameters:\n    maps: !!python/tuple\n    - 1\n    - 2\n"
    path.write_text(text, encoding="utf-8")
    with open_bench() as bench:
        node = bench.start(ReplayNode)
        assert unheard_files([node], ["--params-file", str(path)]) == []
        path.write_text(text.replace("/**", "other"), encoding="utf-8")
        assert len(unheard_files([node], ["--params-file", str(path)])) == 1


# ---- the files in config/ --------------------------------------------------------------------

CONFIGS = ("fov12.yaml", "fov20.yaml")


def read_config(name):
    text = resource_path(f"config/{name}").read_text(encoding="utf-8")
    return yaml.safe_load(text)["/**"]["ros__parameters"]


@pytest.mark.parametrize("name", CONFIGS)
def test_config_file_has_exactly_the_parameters_of_identify_node(name):
    assert set(read_config(name)) == {parameter.name for parameter in IDENTIFY_PARAMETERS}


@pytest.mark.parametrize("name", CONFIGS)
def test_config_file_has_only_allowed_values(name):
    values = read_config(name)
    for parameter in IDENTIFY_PARAMETERS:
        parameter.checked(values[parameter.name])


@pytest.mark.parametrize("name", CONFIGS)
def test_config_file_writes_floats_with_a_decimal_point(name):
    # An integer would do, but a file to copy from should show the type.
    values = read_config(name)
    for parameter in IDENTIFY_PARAMETERS:
        value = values[parameter.name]
        default, first = parameter.default, value
        if isinstance(default, tuple):
            default, first = default[0], value[0]
        assert type(first) is type(default), parameter.name


@pytest.mark.parametrize(("name", "camera"), [
    ("fov12.yaml", (12.0, 512, 512, "mirrored")),
    ("fov20.yaml", (20.0, 1024, 1024, "mirrored")),
])
def test_config_file_describes_the_papers_camera(name, camera):
    values = read_config(name)
    assert tuple(values[n] for n in ("fov_deg", "width_px", "height_px", "parity")) == camera


@pytest.mark.parametrize("name", CONFIGS)
def test_config_file_explains_every_parameter(name):
    """A comment stands above each parameter or above the group it ends."""
    text = resource_path(f"config/{name}").read_text(encoding="utf-8")
    lines = [line.strip() for line in text.splitlines()]
    # By the line above, together with another.
    explained = {"height_px", "cy_px", "y_field", "fov_max_deg"}
    for above, line in pairwise(lines):
        match = re.match(r"(\w+): ", line)
        if match and (above.startswith("#") or "#" in line):
            explained.add(match[1])
    assert explained >= {parameter.name for parameter in IDENTIFY_PARAMETERS}


@pytest.mark.parametrize("name", CONFIGS)
def test_identify_node_starts_with_the_config_file(name):
    arguments = ["--ros-args", "--params-file", str(resource_path(f"config/{name}"))]
    with open_bench() as bench:
        node = bench.start(IdentifyNode, cli_args=arguments)
        expected = read_config(name)
        assert {n: _plain(node.get_parameter(n).value) for n in expected} == expected


def _plain(value):
    return value if isinstance(value, (str, bool, int, float)) else list(value)
