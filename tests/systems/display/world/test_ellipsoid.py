import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw

from sonoservo.systems.display.world.parts import confidence_ellipsoid

angle = st.floats(-1.5, 1.5)


@given(angle, angle, angle)
def test_axes_and_half_axes_are_those_of_the_covariance(roll, pitch, yaw):
    R = RollPitchYaw(roll, pitch, yaw).ToRotationMatrix().matrix()
    deviations = np.array([1e-4, 3e-4, 2e-3])
    axes, half_axes = confidence_ellipsoid(R @ np.diag(deviations**2) @ R.T)
    np.testing.assert_allclose(half_axes, np.sqrt(7.814728) * deviations, rtol=1e-6)
    assert np.linalg.det(axes.matrix()) == pytest.approx(1)
    np.testing.assert_allclose(np.abs(axes.matrix().T @ R), np.eye(3), atol=1e-6)


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_as_many_normal_samples_lie_inside_as_it_says(probability):
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(3, 3))
    samples = rng.normal(size=(20_000, 3)) @ factor.T
    axes, half_axes = confidence_ellipsoid(factor @ factor.T, probability)
    inside = (((samples @ axes.matrix()) / half_axes) ** 2).sum(axis=1) < 1
    assert inside.mean() == pytest.approx(probability, abs=0.015)


def test_what_is_known_exactly_is_a_point():
    _, half_axes = confidence_ellipsoid(np.zeros((3, 3)))
    np.testing.assert_array_equal(half_axes, 0)


def test_a_probability_is_one():
    with pytest.raises(ValueError, match="probability: 95 is not allowed"):
        confidence_ellipsoid(np.eye(3), 95)
