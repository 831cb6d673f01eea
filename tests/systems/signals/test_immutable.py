import copy

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from sonoservo.systems.signals.immutable import NotFound, read_only
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.requirements import require_positive


def test_values_deep_copy_to_themselves_even_inside_drake():
    curve = NeedleCurve(np.eye(3)[:2])
    assert copy.deepcopy(curve) is curve
    assert copy.copy(curve) is curve
    assert Value[object](curve).Clone().get_value() is curve


def test_arrays_are_read_only_and_not_copied():
    array = np.zeros((2, 3))
    view = read_only(array, "points", (None, 3))
    assert np.shares_memory(view, array)
    with pytest.raises(ValueError, match="read-only"):
        view[0, 0] = 1
    array[0, 0] = 1  # the caller's own array stays writeable


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((2, 2)), r"points has shape \(2, 2\); \(any, 3\) is wanted"),
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
            self.DeclareAbstractInputPort("curve", Value[object](None))

    reader = Reader()
    context = reader.CreateDefaultContext()
    reader.GetInputPort("curve").FixValue(context, Value[object](3))
    assert evaluate(reader, context, "curve", int) == 3
    with pytest.raises(TypeError, match="'curve' of 'reader' received a int; NeedleCurve or Not"):
        evaluate(reader, context, "curve", (NeedleCurve, NotFound))
