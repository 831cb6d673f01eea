import copy
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform

from sonoservo.systems.signals import Immutable, NeedleCurve
from sonoservo.systems.signals.immutable import Shape, read_only, seal
from sonoservo.systems.signals.requirements import Positive


def test_values_deep_copy_to_themselves_even_inside_drake():
    curve = NeedleCurve(np.eye(3)[:2])
    assert copy.deepcopy(curve) is curve
    assert copy.copy(curve) is curve
    assert Value[object](curve).Clone().get_value() is curve


@pytest.mark.parametrize("take", [lambda a: a, lambda a: a[::-1]])
def test_what_a_caller_writes_later_changes_no_value(take):
    array = np.zeros((2, 3))
    given = take(array)
    kept = read_only(given, "points", (None, 3))
    with pytest.raises(ValueError, match="read-only"):
        kept[0, 0] = 1
    with pytest.raises(ValueError, match="cannot set WRITEABLE"):
        kept.flags.writeable = True
    array[:] = 1  # the caller's own array stays writeable
    assert not kept.any()


def test_a_read_only_view_does_not_hide_an_array_that_can_be_written_to():
    array = np.zeros((2, 3))
    view = array.view()
    view.flags.writeable = False
    kept = read_only(view, "points", (2, 3))
    array[:] = 1
    assert not kept.any()
    memory = bytearray(48)
    kept = read_only(np.frombuffer(memory).reshape(2, 3), "points", (2, 3))
    memory[:] = b"\x3f" * 48
    assert not kept.any()


def test_sealed_arrays_and_what_values_keep_already_are_not_copied():
    array = seal(np.zeros((4, 3)))
    kept = read_only(array, "points", (None, 3))
    assert np.shares_memory(kept, array)
    assert np.shares_memory(read_only(kept[1:], "points", (3, 3)), array)
    file = np.frombuffer(bytes(48)).reshape(2, 3)
    assert np.shares_memory(read_only(file, "points", (2, 3)), file)
    with pytest.raises(ValueError, match="read-only"):
        array[0, 0] = 1


def test_volumes_are_kept_in_the_order_that_compiled_code_takes():
    turned = np.zeros((4, 5, 6), order="F")
    assert read_only(turned, "turned", (None, None, None)).flags.c_contiguous
    assert read_only(turned[0].T, "flat", (None, None)).shape == (6, 5)


def test_a_value_says_what_it_is_in_one_line():
    @dataclass(frozen=True, eq=False)
    class Value(Immutable):
        grid: np.ndarray
        X: RigidTransform
        place: np.ndarray

    text = repr(Value(np.zeros((30, 40)), RigidTransform([0.1, 0, 0]), np.array([1.0, 2.0])))
    assert text == "Value(grid=<30 x 40 float64>, X=<pose at [0.1, 0.0, 0.0]>, place=[1., 2.])"


@dataclass(frozen=True, eq=False)
class Points(Immutable):
    order: int
    points: Annotated[Any, Shape("n", 3)]
    marks: Annotated[Any, Shape("n", dtype=np.bool_)] | None = None
    covariance: Annotated[Any, Shape("3k", "3k")] | None = None
    spacing: Positive = 1.0

    def _extents(self):
        return {"k": self.order}


def test_a_value_keeps_its_arrays_as_they_are_declared():
    value = Points(1, [[1, 2, 3], [4, 5, 6]], [0, 1], np.eye(3))
    assert (value.points.dtype, value.marks.dtype) == (np.float64, np.bool_)
    for name in ("points", "marks", "covariance"):
        assert not getattr(value, name).flags.writeable
    assert Points(1, np.zeros((0, 3))).marks is None


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points": None}, r"points has shape \(\); expected \(any, 3\)"),
        ({"points": np.zeros((2, 2))}, r"points has shape \(2, 2\); expected \(any, 3\)"),
        ({"points": np.full((2, 3), np.nan)}, "points holds values that are not finite"),
        ({"marks": [True]}, r"marks has shape \(1,\); expected \(2\)"),
        ({"covariance": np.eye(6)}, r"covariance has shape \(6, 6\); expected \(3, 3\)"),
        ({"spacing": 0.0}, "spacing: 0.0 is not allowed"),
    ],
)
def test_a_value_names_the_field_that_is_not_as_declared(changes, message):
    with pytest.raises(ValueError, match=message):
        Points(**{"order": 1, "points": np.zeros((2, 3))} | changes)
