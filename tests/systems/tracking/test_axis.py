import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.signals import NeedleCurve, NotFound
from sonoservo.systems.tracking.axis import axis_through
from sonoservo.systems.tracking.axis_fit import fit_axis

angles = st.floats(-3, 3)


def curve(order, bend=0.05):
    a = np.linspace(0, 0.06, order)
    return np.stack([a, bend * a * (0.06 - a) / 0.06 * 4, 0 * a], axis=1)


@given(st.sampled_from([2, 3]), angles, angles, angles)
def test_passes_through_its_points_in_any_pose(order, roll, pitch, yaw):
    X = RigidTransform(RollPitchYaw(roll, pitch, yaw), [0.1, -0.2, 0.3])
    points = X.multiply(curve(order).T).T
    axis = axis_through(points)
    np.testing.assert_allclose(axis.position(axis.abscissa(points)), points, atol=1e-12)
    np.testing.assert_allclose(axis.distance(points), 0, atol=1e-12)
    expected = NeedleCurve(points).position(np.linspace(0, 1, 9))
    np.testing.assert_allclose(axis.position(np.linspace(0, 0.06, 9)), expected, atol=1e-12)


@pytest.mark.parametrize("points", [np.zeros((2, 3)), [[0, 0, 0], [0, 1, 0], [1, 0, 0.0]]])
def test_points_that_determine_no_axis(points):
    assert not axis_through(np.array(points))


@given(st.sampled_from([2, 3]), angles, angles, angles)
def test_fit_recovers_a_noiseless_curve(order, roll, pitch, yaw):
    X = RigidTransform(RollPitchYaw(roll, pitch, yaw), [0.1, -0.2, 0.3])
    truth = axis_through(X.multiply(curve(order, bend=0.03).T).T)
    points = truth.position(np.linspace(0, 0.06, 200))
    fit = fit_axis(points, np.ones(200), order)
    # The principal direction differs from the chord's: the parabola is the same to second order.
    assert fit.axis.distance(points).max() < (1e-12 if order == 2 else 2e-5)
    other = fit_axis(points, np.ones(200), order, -fit.axis.direction)
    np.testing.assert_allclose(other.axis.direction, -fit.axis.direction, atol=1e-12)
    np.testing.assert_allclose(other.axis.position(-0.01), fit.axis.position(0.01), atol=1e-12)


def test_weights_count():
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 5, 0.0]])
    fit = fit_axis(points, np.array([1, 1, 1, 0.0]), 2)
    assert abs(fit.axis.direction[0]) == pytest.approx(1)
    assert fit.axis.distance(points[3]) == pytest.approx(5)


def test_covariance_is_that_of_repeated_fits():
    rng = np.random.default_rng(0)
    a = np.linspace(0, 0.04, 40)
    deviations = np.array([0, 0.6e-3, 0.3e-3])
    at = np.array([0.0, 0.02, 0.06])
    found, predicted = [], []
    for _ in range(400):
        points = np.outer(a, [1, 0, 0]) + deviations * rng.normal(size=(40, 3))
        fit = fit_axis(points, np.ones(40), 2, towards=[1, 0, 0])
        here = fit.axis.abscissa(np.outer(at, [1, 0, 0]))
        found.append(fit.axis.position(here).ravel())
        predicted.append(np.sqrt(np.diag(fit.covariance(here, 40))))
    across = np.arange(9) % 3 > 0
    np.testing.assert_allclose(
        np.std(found, axis=0)[across], np.mean(predicted, axis=0)[across], rtol=0.12
    )


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), np.zeros((1, 3)), np.zeros((9, 3)), np.vstack([np.eye(3), -np.eye(3)])],
)
@pytest.mark.parametrize("order", [2, 3])
def test_points_that_determine_no_fit(points, order):
    assert isinstance(fit_axis(points, np.ones(len(points)), order), NotFound)
