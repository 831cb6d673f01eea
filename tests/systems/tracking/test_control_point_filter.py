import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from sonoservo.systems.signals import NeedleCurve, NeedleMeasurement
from sonoservo.systems.tracking import NeedleMotionParameters
from sonoservo.systems.tracking.control_point_filter import ControlPointFilter
from sonoservo.systems.tracking.needle_motion import constant_velocity
from sonoservo.systems.tracking.track_lifecycle import innovation_distance

FILTER = ControlPointFilter()
R = np.diag([1, 0.2, 0.3, 0.5, 0.2, 0.4]) * 1e-6


def measurement(tip=0.03, time=0.0, y=0.0, entry=0.0, covariance=R):
    curve = NeedleCurve([[entry, y, 0], [tip, y, 0]])
    return NeedleMeasurement(curve, covariance, time, 100, 0.8)


@given(st.floats(1e-3, 2.0))
def test_prediction_is_the_integral_of_white_acceleration(dt):
    """Van Loan 1978: A and Q from one matrix exponential."""
    density = np.diag([2.0, 0.5])
    n = 4
    M = np.zeros((2 * n, 2 * n))
    M[:2, 2:4] = np.eye(2)
    M[2:4, 6:8] = density
    M[n:, n:] = -M[:n, :n].T
    exponential = expm(M * dt)
    A, Q = constant_velocity(dt, density)
    np.testing.assert_allclose(A, exponential[:n, :n], atol=1e-12)
    np.testing.assert_allclose(Q, exponential[:n, n:] @ A.T, rtol=1e-9, atol=1e-12)


@given(st.floats(1e-3, 2.0), st.floats(0.1, 10.0))
def test_a_velocity_that_fades_falls_to_its_share(dt, fades):
    drift = np.array([[0.0, 1.0], [0.0, -1.0 / fades]])
    A, _ = constant_velocity(dt, np.eye(1), fades=fades)
    np.testing.assert_allclose(A, expm(drift * dt), atol=1e-12)


@pytest.mark.parametrize("order", [2, 3])
def test_insertion_moves_the_tip_and_leaves_the_entry(order):
    curve = NeedleCurve(np.outer(np.linspace(0, 0.03, order), [1, 0, 0]))
    S = NeedleMotionParameters(insertion=1.0, body=0.0, bending=0.0).density(curve)
    expected = np.zeros((3 * order, 3 * order))
    u = np.linspace(0, 1, order)
    expected[::3, ::3] = np.outer(u, u)
    np.testing.assert_array_equal(S, expected)


def test_entry_rests_along_an_axis_that_does_not_show_it():
    """A volume says nothing of where along the axis the entry is: it must not slide forwards."""
    covariance = np.diag([1e-6, 1e-8, 1e-8, 0.36e-6, 1e-8, 1e-8])
    state = FILTER.start(measurement(0.02, covariance=covariance))
    for k in range(1, 100):
        tip = 0.02 + min(0.3 * k * 5e-3, 0.04)
        # As the localizer does: where the entry was last, projected on the axis.
        z = measurement(tip, 0.3 * k, entry=state.curve.entry[0], covariance=covariance)
        state = FILTER.update(FILTER.predict(state, z.time), z, None)
    assert abs(state.curve.entry[0]) < 1e-3


def test_innovation_is_the_mahalanobis_distance():
    B = np.random.default_rng(0).normal(size=(12, 12)) * 1e-3
    prior = dataclasses.replace(FILTER.start(measurement()), covariance=B @ B.T)
    z = measurement(0.031, y=1e-4)
    y = (z.curve.control_points - prior.curve.control_points).ravel()
    S = prior.covariance[:6, :6] + R
    assert innovation_distance(prior, z) == pytest.approx(np.sqrt(y @ np.linalg.inv(S) @ y))
