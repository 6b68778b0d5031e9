"""How parameters of a node are declared: once each, as the fields of a frozen dataclass.

A field made by `parameter` carries type and default of its parameter, and unit, range and words
for `ros2 param describe`. `declare` declares them all and returns the dataclass with what the
command line and files say. A value of a wrong type or out of range raises ParameterError, whose
text is one line that names the parameter and what is allowed. An integer is accepted for a
floating-point parameter: leaving out the decimal point is the commonest mistake in a YAML file. So
is a false for the choice `off`.
"""

import dataclasses
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, TypeVar

import yaml
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node

_Values = TypeVar("_Values")
_DESCRIPTION = "parameter"
#: Parameters that rclpy declares itself, for every node.
_OF_RCLPY = {"use_sim_time", "start_type_description_service"}
#: How those begin that rclpy declares for the QoS of a topic.
_QOS = "qos_overrides."
_WORDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


class _NamesLoader(yaml.SafeLoader):
    """Reads the names in a file, and nothing for a value with a tag: launch marks tuples so."""


_NamesLoader.add_multi_constructor("", lambda *_: None)


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
        text = _WORDS[type(kind)]
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


def parameter(default: Any, description: str, unit: str = "", **options: Any) -> Any:
    """Return a dataclass field that declares a parameter; options are those of `Parameter`."""
    said = {"description": description, "unit": unit, **options}
    return dataclasses.field(default=default, metadata={_DESCRIPTION: said})


def parameters_of(kind: type) -> tuple[Parameter, ...]:
    """Return the parameters that a dataclass declares, in order."""
    return tuple(
        Parameter(field.name, field.default, **field.metadata[_DESCRIPTION])
        for field in dataclasses.fields(kind)
    )


def declare(node: Node, kind: type[_Values]) -> tuple[_Values, frozenset[str]]:
    """Declare the parameters of a dataclass; return it, and the names that were given a value.

    The node must have been made with `automatically_declare_parameters_from_overrides`: what is
    given is then seen as it is, before a range refuses it. Raises ParameterError.
    """
    given = {
        name: one.value for name, one in node.get_parameters_by_prefix("").items()
        if name not in _OF_RCLPY
    }
    for name in given:  # declared again below, or by rclpy, with description and range
        node.undeclare_parameter(name)
    values = {}
    for one in parameters_of(kind):
        value = one.checked(given.get(one.name, one.default))
        shown = list(value) if isinstance(value, tuple) else value
        node.declare_parameter(one.name, shown, one.descriptor(), ignore_override=True)
        values[one.name] = value
    return kind(**values), frozenset(given)


def unknown_parameters(
    node: Node, given: Iterable[str], neighbours: Iterable[Parameter] = ()
) -> list[str]:
    """Return a sentence on each name that was given a value but is no parameter of the node.

    Ask when the node has made its publishers and subscriptions, which declare those of their QoS.

    Args:
        node: whose parameters have been declared.
        given: the names.
        neighbours: parameters of other nodes in the process, which hear the same command line. The
            QoS of a topic may then be that of another node's.
    """
    elsewhere = {parameter.name for parameter in neighbours}
    return [
        no_such_parameter(node, name) for name in given
        if not node.has_parameter(name) and name not in elsewhere
        and not (elsewhere and name.startswith(_QOS))
    ]


def unheard_files(nodes: Sequence[Node], arguments: Sequence[str]) -> list[str]:
    """Return a sentence on each parameter file of a command line that has nothing for any node."""
    mine, sentences = [node.get_fully_qualified_name() for node in nodes], []
    for i, argument in enumerate(arguments[:-1]):
        if argument != "--params-file":
            continue
        path = arguments[i + 1]
        with open(path, encoding="utf-8") as file:
            names = list(_nodes_of(yaml.load(file, _NamesLoader) or {}))
        if names and not any(_pattern(name).fullmatch(me) for name in names for me in mine):
            sentences.append(
                f"parameter file {path} has nothing for {' and '.join(mine)}, only for "
                f"{', '.join(names)}: name it {mine[0]} or /**"
            )
    return sentences


def _nodes_of(tree: Mapping[str, Any], above: str = "") -> Iterator[str]:
    """Yield the names of the nodes in a parameter file, from `/`, with their wildcards."""
    for key, value in tree.items():
        name = f"{above}/{str(key).strip('/')}"
        if key == "ros__parameters":
            yield above
        elif isinstance(value, Mapping):
            yield from _nodes_of(value, name)


def _pattern(name: str) -> re.Pattern[str]:
    """Return the regular expression of a node's name: `*` is one part of it, `**` any number."""
    parts = {"**": "(/[^/]+)*", "*": "/[^/]+"}
    return re.compile("".join(
        parts.get(part, "/" + re.escape(part)) for part in name.strip("/").split("/")
    ))


def no_such_parameter(node: Node, name: str) -> str:
    """Say that there is no such parameter, and which one may have been meant."""
    known = list(node.get_parameters_by_prefix(""))
    longer = [other for other in known if other.startswith(f"{name}_")]
    similar = longer or get_close_matches(name, known, n=1)
    return f"there is no parameter {name}" + (f": {similar[0]}?" if similar else "")


class DeclaringNode(Node):
    """A node that names parameters that do not exist, where rclpy only refuses them."""

    def set_parameters_atomically(self, parameter_list: list[Any]) -> SetParametersResult:
        """Set all parameters or none."""
        unknown = [p.name for p in parameter_list if not self.has_parameter(p.name)]
        if unknown:
            return SetParametersResult(
                successful=False, reason="; ".join(no_such_parameter(self, n) for n in unknown)
            )
        return super().set_parameters_atomically(parameter_list)
