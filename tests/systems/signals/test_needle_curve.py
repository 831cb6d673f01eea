import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.interpolate import KroghInterpolator

from sonoservo.systems.signals import Needle, NeedleCurve, NeedlePrediction

points = arrays(float, st.tuples(st.integers(2, 4), st.just(3)), elements=st.floats(-0.2, 0.2))


@given(points, st.floats(-0.5, 1.5))
def test_passes_through_its_points_as_the_one_polynomial_that_does(control_points, u):
    curve = NeedleCurve(control_points)
    abscissae = np.linspace(0, 1, curve.order)
    np.testing.assert_allclose(curve.position(abscissae), control_points, atol=1e-12)
    expected = KroghInterpolator(abscissae, control_points)(u)
    np.testing.assert_allclose(curve.position(u), expected, atol=1e-9)
    powers = u ** np.arange(curve.order)
    np.testing.assert_allclose(curve.coefficients @ powers, expected, atol=1e-9)


@pytest.mark.parametrize("count", [1, 5])
def test_other_orders_are_refused(count):
    with pytest.raises(ValueError, match="control_points: .* 2 to 4 points"):
        NeedleCurve(np.zeros((count, 3)))


def test_needle_outside_is_falsy_and_a_single_point_refused():
    assert not Needle(np.zeros((0, 3)), 6e-4)
    with pytest.raises(ValueError, match="shaft"):
        Needle(np.zeros((1, 3)), 6e-4)
    needle = Needle([[0, 0, 0], [0.03, 0, 0], [0.03, 0.04, 0]], 6e-4)
    assert needle.length == pytest.approx(0.07)
    np.testing.assert_array_equal(needle.curve.control_points, [[0, 0, 0], [0.03, 0.04, 0]])


def test_nothing_may_be_known_of_a_needle_that_is_localized_everywhere():
    assert NeedlePrediction(3, 0.0, everywhere=True).curve is None
    with pytest.raises(ValueError, match="everywhere"):
        NeedlePrediction(3, 0.0)
    with pytest.raises(ValueError, match="curve.order: 2"):
        NeedlePrediction(3, 0.0, NeedleCurve([[0, 0, 0], [0.03, 0, 0]]))
