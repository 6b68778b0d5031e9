"""Structs of compiled code: fields by name behind one pointer, also for Python."""

import sys

import numpy as np
import pytest

from star_tracker.compiled import compiled, struct

#: At the top of the module, as the cache looks them up there.
PointType, Point = struct("Point", __name__, ("place", "name", "bright"))
OuterType, Outer = struct("Outer", __name__, ("point", "n"))


@compiled
def make_point(place, name, bright):
    return Point(place, name, bright)


@compiled
def make_outer(point, n):
    return Outer(point, n)


@compiled
def rename(point, name):
    point.name = name
    point.place[0] = 7.0


@compiled
def sum_of(outer):
    return outer.point.place.sum() + outer.point.name + outer.n


def test_fields_are_read_by_their_names():
    point = make_point(np.array([1.0, 2.0]), 3, True)
    np.testing.assert_array_equal(point.place, [1, 2])
    assert (point.name, point.bright) == (3, True)


def test_a_struct_is_handed_over_and_not_copied():
    """What one function writes, Python and the next one see."""
    place = np.array([1.0, 2.0])
    point = make_point(place, 3, False)
    rename(point, 5)
    assert point.name == 5
    assert place[0] == 7.0
    assert point.place.ctypes.data == place.ctypes.data


def test_structs_hold_structs():
    point = make_point(np.array([1.0, 2.0]), 3, False)
    outer = make_outer(point, 10)
    assert sum_of(outer) == 16
    rename(point, 4)
    assert sum_of(outer) == 7 + 2 + 4 + 10
    assert outer.point.name == 4


@pytest.mark.parametrize("dtype", [float, np.int32])
def test_fields_have_the_types_of_what_they_are_made_with(dtype):
    point = make_point(np.array([1, 2], dtype), 3, False)
    assert point.place.dtype == dtype


def test_there_is_no_other_field():
    point = make_point(np.zeros(2), 3, False)
    with pytest.raises(AttributeError):
        _ = point.colour


def test_a_struct_is_made_by_compiled_code_that_is_kept():
    """In Python it would be compiled in each process."""
    module = sys.modules[__name__]
    assert module.PointType.__name__ == "PointType"
    assert PointType.__module__ == Point.__module__ == __name__
    assert make_point.stats.cache_path
