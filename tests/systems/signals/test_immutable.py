import copy
from dataclasses import dataclass

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import LeafSystem

from sonoservo.systems.signals.immutable import Immutable, NotFound, read_only, seal
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require_positive


def test_values_deep_copy_to_themselves_even_inside_drake():
    curve = NeedleCurve(np.eye(3)[:2])
    assert copy.deepcopy(curve) is curve
    assert copy.copy(curve) is curve
    assert Value[object](curve).Clone().get_value() is curve


@pytest.mark.parametrize(
    "take", [lambda a: a, lambda a: a[:], lambda a: a[::-1], lambda a: np.broadcast_to(a, (2, 3))]
)
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


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((2, 2)), r"points has shape \(2, 2\); expected \(any, 3\)"),
        (np.zeros(3), r"points has shape \(3,\)"),
        (np.full((2, 3), np.nan), "points holds values that are not finite"),
    ],
)
def test_bad_arrays_are_refused(array, message):
    with pytest.raises(ValueError, match=message):
        read_only(array, "points", (None, 3))


@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf"), "1"])
def test_require_positive_refuses(value):
    with pytest.raises(ValueError, match="rate: .* must be a number above 0"):
        require_positive(rate=value)


def test_nothing_found_is_falsy_and_says_why():
    nothing = NotFound("too few candidates")
    assert not nothing
    assert nothing.reason == "too few candidates"


def test_a_wrong_value_on_a_wire_is_caught_where_it_enters():
    class Reader(LeafSystem):
        def __init__(self):
            super().__init__()
            self.set_name("reader")
            self.DeclareAbstractInputPort("curve", Value[object]())

    reader = Reader()
    context = reader.CreateDefaultContext()
    reader.GetInputPort("curve").FixValue(context, Value[object](3))
    assert evaluate(reader, context, "curve", int) == 3
    with pytest.raises(
        TypeError, match="'curve' of 'reader' received a value of type int; expected NeedleCurve"
    ):
        evaluate(reader, context, "curve", (NeedleCurve, NotFound))


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
