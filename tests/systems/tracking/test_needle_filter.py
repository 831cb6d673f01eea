"""Properties that every needle filter has."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import predict, update
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.interacting_filter import InteractingFilter
from sonoservo.systems.tracking.needle_filter import FILTERS
from sonoservo.systems.tracking.needle_motion import NeedleMotionParameters, constant_velocity

X = RigidTransform(RollPitchYaw(0.4, -1.1, 2.0), [0.3, -0.2, 0.1])
K = np.array([2.0, 1.0, -1.0]) / np.sqrt(6)
TO_POLE = RigidTransform(RotationMatrix.MakeFromOneVector(K, 2).inverse(), [0, 0, 0])
SPEED = 4e-3


def measurement(length, order, time=0.0, noise=0.0, rng=None, frame=None):
    points = np.outer(np.linspace(0, length, order), K)
    if rng is not None:
        points = points + noise * rng.normal(size=points.shape)
    covariance = np.diag(np.linspace(0.3, 1.0, points.size)) * 1e-7
    if frame is not None:
        points = frame.multiply(points.T).T
        both = np.kron(np.eye(order), frame.rotation().matrix())
        covariance = both @ covariance @ both.T
    return NeedleMeasurement(NeedleCurve(points), covariance, time, 1, 1.0)


def velocity(frame=None):
    R = np.eye(3) if frame is None else frame.rotation().matrix()
    noise = np.diag([3.0, 1.0, 2.0]) * 1e-7
    return VelocityMeasurement(R @ (SPEED * K), R @ noise @ R.T, 0.9)


@pytest.fixture(params=[(each, n) for each in FILTERS for n in each.orders], ids=str)
def case(request):
    make, order = request.param
    return make(), order


def followed(needle_filter, order, steps=6, frame=None, noise=0.0):
    rng = np.random.default_rng(3)
    state = needle_filter.start(measurement(0.02, order, frame=frame))
    for n in range(1, steps):
        z = measurement(0.02 + SPEED * n, order, float(n), noise, rng, frame)
        state = needle_filter.update(needle_filter.predict(state, z.time), z, velocity(frame))
    return state


def with_motion(needle_filter, motion):
    """The filter with one motion model, and errors that do not repeat themselves."""
    if isinstance(needle_filter, InteractingFilter):
        motions = dict.fromkeys(("steady", "unsteady", "carried", "jerked"), motion)
        return InteractingFilter(**motions, constant=0.0, repeated=0.0)
    needle_filter.motion = motion
    return needle_filter


def is_covariance(P):
    np.testing.assert_allclose(P, P.T, atol=1e-12 * np.abs(P).max())
    return np.linalg.eigvalsh(P).min() > -1e-12 * np.abs(P).max()


def test_start_is_the_measurement(case):
    needle_filter, order = case
    first = measurement(0.02, order, 0.7)
    state = needle_filter.start(first)
    assert state.time == 0.7
    np.testing.assert_allclose(state.curve.control_points, first.curve.control_points, atol=1e-15)
    np.testing.assert_array_equal(state.velocity, np.zeros((order, 3)))
    # Of the tip all is measured.
    tip = slice(3 * order - 3, 3 * order)
    np.testing.assert_allclose(state.covariance[tip, tip], first.covariance[-3:, -3:], atol=1e-15)


def test_covariance_is_symmetric_and_not_negative_all_along(case):
    needle_filter, order = case
    state = needle_filter.start(measurement(0.02, order))
    for n in range(1, 7):
        state = needle_filter.predict(state, float(n))
        assert state.covariance.shape == (6 * order, 6 * order)
        assert is_covariance(state.covariance)
        z = measurement(0.02 + SPEED * n, order, float(n)) if n % 3 else None
        state = needle_filter.update(state, z, velocity() if n % 2 else None)
        assert is_covariance(state.covariance)


def test_prediction_grows_uncertain_and_never_goes_back(case):
    needle_filter, order = case
    state = followed(needle_filter, order)
    variances = [
        np.trace(needle_filter.predict(state, state.time + dt).covariance) for dt in (0, 0.5, 2)
    ]
    assert variances[0] < variances[1] < variances[2]
    assert needle_filter.predict(state, state.time - 1.0) is state


def test_two_predictions_are_one(case):
    needle_filter, order = case
    needle_filter = with_motion(needle_filter, NeedleMotionParameters())
    state = followed(needle_filter, order)
    halfway = needle_filter.predict(state, state.time + 0.4)
    twice, once = (needle_filter.predict(each, state.time + 1.0) for each in (halfway, state))
    assert twice.time == once.time
    np.testing.assert_allclose(twice.curve.control_points, once.curve.control_points, atol=1e-12)
    tip = slice(3 * order - 3, 3 * order)
    # The direction in which Q is largest turns a little with the curve in between.
    np.testing.assert_allclose(twice.covariance[tip, tip], once.covariance[tip, tip], rtol=2e-2)


def test_tip_agrees_with_a_kalman_filter_on_the_tip_alone(case):
    """The tip moves at constant velocity; a closed form if nothing else is uncertain."""
    needle_filter, order = case
    motion = NeedleMotionParameters(insertion=1e-5, body=1e-6, bending=0.0)
    needle_filter = with_motion(needle_filter, motion)
    covariance = 1e-7 * np.eye(3 * order)
    state = needle_filter.start(
        NeedleMeasurement(measurement(0.02, order).curve, covariance, 0.0, 1, 1.0)
    )
    if isinstance(needle_filter, InteractingFilter):
        # Its end advances, as it did for ever.
        state = replace(state, weights=np.eye(12)[0])
        needle_filter = replace(needle_filter, lasting=1e12)
    tip = np.r_[3 * order - 3 : 3 * order, 6 * order - 3 : 6 * order]
    x = np.concatenate([state.curve.tip, np.zeros(3)])
    P = state.covariance[np.ix_(tip, tip)]
    density = 1e-5 * np.outer(K, K) + 1e-6 * np.eye(3)
    A, Q = constant_velocity(0.5, density)
    x, P = predict(x, P, A, Q)
    state = needle_filter.predict(state, 0.5)
    np.testing.assert_allclose(np.r_[state.curve.tip, state.velocity[-1]], x, atol=1e-12)
    np.testing.assert_allclose(state.covariance[np.ix_(tip, tip)], P, atol=1e-15)
    # A measurement of the tip only: all else is measured without any precision.
    vague = np.diag(np.r_[np.full(3 * order - 3, 1e6), np.full(3, 1e-7)])
    curve = NeedleCurve(np.outer(np.linspace(0, 0.0225, order), K))
    z = NeedleMeasurement(curve, vague, 0.5, 1, 1.0)
    x, P = update(x, P, curve.tip, 1e-7 * np.eye(3), np.eye(3, 6))
    state = needle_filter.update(state, z, None)
    np.testing.assert_allclose(np.r_[state.curve.tip, state.velocity[-1]], x, atol=1e-9)
    np.testing.assert_allclose(state.covariance[np.ix_(tip, tip)], P, atol=1e-12)


@pytest.mark.parametrize("frame", [X, TO_POLE], ids=["anywhere", "along Z"])
def test_no_frame_is_special(case, frame):
    """A moved world moves the result, also one in which the needle stands at the angles' pole."""
    needle_filter, order = case
    plain = followed(needle_filter, order, noise=1e-4).transformed(frame)
    moved = followed(needle_filter, order, noise=1e-4, frame=frame)
    np.testing.assert_allclose(moved.curve.control_points, plain.curve.control_points, atol=1e-10)
    np.testing.assert_allclose(moved.velocity, plain.velocity, atol=1e-10)
    np.testing.assert_allclose(moved.covariance, plain.covariance, atol=1e-12)


def test_update_with_nothing_changes_nothing(case):
    needle_filter, order = case
    state = followed(needle_filter, order)
    again = needle_filter.update(state, None, None)
    np.testing.assert_array_equal(again.curve.control_points, state.curve.control_points)
    np.testing.assert_array_equal(again.covariance, state.covariance)
