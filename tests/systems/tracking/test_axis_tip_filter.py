"""The filter on axis, tip and velocity, against the plain Kalman filter."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonoservo.systems.signals import NeedleCurve, NeedleMeasurement, VelocityMeasurement
from sonoservo.systems.tracking import NeedleMotionParameters
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter, direction_angles

MOTION = NeedleMotionParameters(insertion=1e-6, body=2e-7)
TURNING = 1e-4
FILTER = AxisTipFilter(motion=MOTION, turning=TURNING, velocity_gate=1 - 1e-12)
NOISE = np.diag([1, 0.2, 0.3, 0.5, 0.2, 0.4]) * 1e-8
VELOCITY_NOISE = np.diag([3, 1, 2]) * 1e-7

noises = st.integers(0, 1000).map(np.random.default_rng)


def measurement(entry, tip, time=0.0, covariance=NOISE):
    return NeedleMeasurement(NeedleCurve([entry, tip]), covariance, time, 1, 1.0)


def speed(v):
    return VelocityMeasurement(np.array(v), VELOCITY_NOISE, 0.9)


def insertion(rng, steps=6):
    """Noisy ends and velocities of a needle along (2, 1, -1), pushed at 4 mm/s."""
    k = np.array([2, 1, -1]) / np.sqrt(6)
    for n in range(steps):
        tip = (0.02 + 0.004 * n) * k
        ends = np.concatenate([np.zeros(3), tip]) + np.sqrt(np.diag(NOISE)) * rng.normal(size=6)
        yield ends[:3], ends[3:], 0.004 * k + np.sqrt(np.diag(VELOCITY_NOISE)) * rng.normal(size=3)


def test_a_measured_axis_has_no_sense():
    states = []
    J = np.kron([[-1, 2], [0, 1]], np.eye(3))
    for flip in (False, True):
        state = None
        for time, (entry, tip, v) in enumerate(insertion(np.random.default_rng(0))):
            found = measurement(entry, tip, float(time))
            if state is None:
                state = FILTER.start(found)
                continue
            if flip:  # the same line with the opposite sense, its tip where it was
                found = measurement(2 * tip - entry, tip, float(time), J @ NOISE @ J.T)
            state = FILTER.update(FILTER.predict(state, found.time), found, speed(v))
        states.append(state)
    np.testing.assert_allclose(states[1].direction, states[0].direction, atol=1e-9)
    np.testing.assert_allclose(states[1].tip, states[0].tip, atol=1e-10)


@given(rng=noises, with_axis=st.booleans(), with_velocity=st.booleans())
@settings(max_examples=15, deadline=None)
def test_one_step_is_the_textbook_filter_on_the_paper_s_states(rng, with_axis, with_velocity):
    """Eqs. 1 to 7 with alpha and beta, far from their poles and for small errors."""
    first, second = list(insertion(rng, 2))
    state = FILTER.start(measurement(*first[:2]))
    updated = FILTER.update(
        FILTER.predict(state, 0.5),
        measurement(*second[:2]) if with_axis else None,
        speed(second[2]) if with_velocity else None,
    )

    def angles_by(function, at, step=1e-7):
        return np.array(
            [(function(at + d) - function(at - d)) / (2 * step) for d in step * np.eye(len(at))]
        ).T

    # The frame's deviations to alpha and beta: X = (alpha, beta, p, v).
    turn = angles_by(lambda e: direction_angles(state.direction + e @ state.frame[:2]), np.zeros(2))
    T = np.eye(8)
    T[:2, :2] = turn
    x = np.concatenate([direction_angles(state.direction), state.tip, state.tip_velocity])
    A = np.eye(8)
    A[2:5, 5:] = 0.5 * np.eye(3)
    k = state.direction
    density = MOTION.insertion * np.outer(k, k) + MOTION.body * np.eye(3)
    Q = np.zeros((8, 8))
    Q[:2, :2] = TURNING * 0.5 * turn @ turn.T
    Q[2:, 2:] = np.kron([[0.5**3 / 3, 0.5**2 / 2], [0.5**2 / 2, 0.5]], density)
    x, P = A @ x, A @ T @ state.P @ T.T @ A.T + Q
    ends = np.concatenate(second[:2])
    axis_and_tip = lambda e: np.concatenate([direction_angles(e[3:] - e[:3]), e[3:]])  # noqa: E731
    J = angles_by(axis_and_tip, ends)
    z, R = np.concatenate([axis_and_tip(ends), second[2]]), np.zeros((8, 8))
    R[:5, :5], R[5:, 5:] = J @ NOISE @ J.T, VELOCITY_NOISE
    H = np.eye(8)[np.repeat([with_axis, with_velocity], [5, 3])]
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + H @ R @ H.T)
    x = x + K @ H @ (z - x)
    P = (np.eye(8) - K @ H) @ P
    np.testing.assert_allclose(direction_angles(updated.direction), x[:2], atol=2e-4)
    np.testing.assert_allclose(updated.tip, x[2:5], atol=3e-6)
    np.testing.assert_allclose(updated.tip_velocity, x[5:], atol=3e-5)
    np.testing.assert_allclose(np.sqrt(np.diag(updated.P)[2:]), np.sqrt(np.diag(P)[2:]), rtol=0.05)


@pytest.mark.parametrize(
    ("direction", "alpha", "beta"),
    [([0.94, 0, 0.34], 0, 70.1), ([0, 1, 0], 90, 90), ([0, 0, 2], 0, 0), ([-1, 0, 0], 180, 90)],
)
def test_reported_angles(direction, alpha, beta):
    np.testing.assert_allclose(np.degrees(direction_angles(direction)), [alpha, beta], atol=0.05)


def test_entry_rests_while_the_tip_advances():
    state = FILTER.start(measurement([0, 0, 0], [0.02, 0, 0]))
    # What the entry and the tip have in common is their covariance too.
    np.testing.assert_allclose(state.covariance[3:6, 3:6], NOISE[3:, 3:], atol=1e-12)
    np.testing.assert_allclose(state.covariance[1:3, 1:3], NOISE[1:3, 1:3], atol=1e-12)
    for n in range(1, 8):
        tip = [0.02 + 0.003 * n, 0, 0]
        found = measurement([0, 0, 0], tip, float(n))
        state = FILTER.update(FILTER.predict(state, n), found, speed([0.003, 0, 0]))
    np.testing.assert_allclose(state.curve.tip, tip, atol=2e-5)
    np.testing.assert_allclose(state.curve.entry, 0, atol=1e-9)
    np.testing.assert_allclose(state.velocity[-1], [0.003, 0, 0], atol=1e-4)


def test_an_impossible_velocity_is_not_believed():
    needle_filter = dataclasses.replace(FILTER, velocity_gate=AxisTipFilter().velocity_gate)
    state = needle_filter.start(measurement([0, 0, 0], [0.02, 0, 0]))
    for n in range(1, 6):
        found = measurement([0, 0, 0], [0.02, 0, 0], float(n))
        state = needle_filter.update(needle_filter.predict(state, n), found, speed([0, 0, 0]))
    without, told = (needle_filter.update(state, found, v) for v in (None, speed([0.5, 0, 0])))
    np.testing.assert_array_equal(told.velocity, without.velocity)


def test_a_bent_needle_and_a_gate_that_passes_all_are_refused():
    curve = NeedleCurve(np.outer([0, 0.01, 0.02], [1, 0, 0]))
    with pytest.raises(ValueError, match="straight"):
        FILTER.start(NeedleMeasurement(curve, np.eye(9), 0.0, 1, 1.0))
    with pytest.raises(ValueError, match="velocity_gate"):
        AxisTipFilter(velocity_gate=1.0)
