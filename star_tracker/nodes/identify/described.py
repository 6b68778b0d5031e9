"""A field of a dataclass that is a parameter of a node."""

from dataclasses import field
from typing import Any


def parameter(default: Any, description: str, unit: str = "", **options: Any) -> Any:
    """Return a field with type and default of a parameter, and unit, range and words on it."""
    said = {"description": description, "unit": unit, **options}
    return field(default=default, metadata={"parameter": said})
