import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RotationMatrix
from scipy.linalg import expm

from sonoservo.systems.estimation.needle_kalman_filter import (
    NeedleKalmanFilter,
    NeedleKalmanFilterParameters,
    innovation_distance,
    restart_track,
    start_track,
    update_track,
)
from sonoservo.systems.estimation.track import (
    NeedleMotionParameters,
    NeedleTrack,
    constant_velocity,
)
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.insertion_detection import InsertionDetection
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.volume import Volume

PARAMETERS = NeedleKalmanFilterParameters()
R = np.diag([1, 0.2, 0.3, 0.5, 0.2, 0.4]) * 1e-6


def measurement(tip=0.03, time=0.0, y=0.0, entry=0.0):
    curve = NeedleCurve([[entry, y, 0], [tip, y, 0]])
    return NeedleMeasurement(curve, R, time, 100, 0.8)


def detection(x, time):
    at = np.array([x, 0, 0])
    return InsertionDetection(np.zeros(3), at, at, 1e-3, 6.0, time)


def volume(time, X_WP=None):
    X_WP = X_WP or RigidTransform()
    return Volume(np.zeros((2, 2, 2), np.uint8), np.zeros(3), np.ones(3), X_WP, time)


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


def test_update_is_equations_12_to_14():
    rng = np.random.default_rng(0)
    B = rng.normal(size=(12, 12)) * 1e-3
    prior = restart_track(measurement(), PARAMETERS)
    prior = dataclasses.replace(prior, covariance=B @ B.T)
    z = measurement(0.031, y=1e-4)
    C = np.hstack([np.eye(6), np.zeros((6, 6))])
    K = prior.covariance @ C.T @ np.linalg.inv(C @ prior.covariance @ C.T + R)
    y = z.curve.control_points.ravel() - C @ prior.mean
    posterior = update_track(prior, z)
    np.testing.assert_allclose(posterior.mean, prior.mean + K @ y, atol=1e-12)
    np.testing.assert_allclose(
        posterior.covariance, (np.eye(12) - K @ C) @ prior.covariance, atol=1e-14
    )
    S = C @ prior.covariance @ C.T + R
    assert innovation_distance(prior, z) == pytest.approx(y @ np.linalg.inv(S) @ y)


@pytest.mark.parametrize("order", [2, 3])
def test_insertion_moves_the_tip_and_leaves_the_entry(order):
    curve = NeedleCurve(np.outer(np.linspace(0, 0.03, order), [1, 0, 0]))
    S = NeedleMotionParameters(insertion=1.0, body=0.0, bending=0.0).density(curve)
    expected = np.zeros((3 * order, 3 * order))
    u = np.linspace(0, 1, order)
    expected[::3, ::3] = np.outer(u, u)
    np.testing.assert_array_equal(S, expected)


def test_innovations_are_consistent():
    """Simulated with the filter's own model, the mean squared Mahalanobis distance is 3 n."""
    rng = np.random.default_rng(4)
    motion = NeedleMotionParameters()
    parameters = NeedleKalmanFilterParameters(motion=motion)
    distances = []
    for _ in range(30):
        track = restart_track(measurement(), parameters)
        truth = rng.multivariate_normal(track.mean, track.covariance)
        for step in range(1, 25):
            A, Q = constant_velocity(0.3, motion.density(track.curve))
            truth = A @ truth + rng.multivariate_normal(np.zeros(12), Q)
            points = truth[:6] + rng.multivariate_normal(np.zeros(6), R)
            z = NeedleMeasurement(NeedleCurve(points.reshape(2, 3)), R, 0.3 * step, 1, 1)
            predicted = track.predicted(z.time)
            distances.append(innovation_distance(predicted, z))
            track = update_track(predicted, z)
    assert np.mean(distances) == pytest.approx(6, rel=0.1)


def test_velocity_converges():
    track = restart_track(measurement(0.02), PARAMETERS)
    for k in range(1, 30):
        z = measurement(0.02 + 5e-3 * 0.3 * k, 0.3 * k)
        track = update_track(track.predicted(z.time), z)
    np.testing.assert_allclose(track.velocity[1], [5e-3, 0, 0], atol=2e-4)
    np.testing.assert_allclose(track.velocity[0], 0, atol=3e-4)


def test_prediction_never_goes_back():
    track = restart_track(measurement(time=1.0), PARAMETERS)
    assert track.predicted(0.5) is track


def test_detections_that_advance_start_a_track():
    track = NeedleTrack(TrackingMode.SEARCHING, 0.0, PARAMETERS.motion)
    for x in (2e-3, 2.5e-3, 2e-3, 3.2e-3):
        track = start_track(track, detection(x, 1.0), PARAMETERS)
        assert not track
    started = start_track(track, detection(5e-3, 1.5), PARAMETERS)
    np.testing.assert_allclose(started.curve.control_points, [[2e-3, 0, 0], [5e-3, 0, 0]])
    elsewhere = start_track(track, detection(30e-3, 1.5), PARAMETERS)
    assert not elsewhere


def test_a_needle_that_is_withdrawn_starts_no_track():
    track = NeedleTrack(TrackingMode.SEARCHING, 0.0, PARAMETERS.motion)
    for x in (12e-3, 9e-3, 6e-3, 3e-3):
        track = start_track(track, detection(x, 1.0), PARAMETERS)
        assert not track
    started = start_track(track, detection(6e-3, 1.5), PARAMETERS)
    np.testing.assert_allclose(started.curve.control_points, [[3e-3, 0, 0], [6e-3, 0, 0]])


class Bench:
    """The filter with its inputs in hand."""

    def __init__(self, **parameters):
        self.filter = NeedleKalmanFilter(
            parameters=NeedleKalmanFilterParameters(**parameters), period=0.1
        )
        self.context = self.filter.CreateDefaultContext()
        self.fix("detection", NotFound("nothing moved"))
        self.fix("measurement", NotFound("nothing seen"))

    def fix(self, port, value):
        self.filter.GetInputPort(port).FixValue(self.context, Value[object](value))

    def step(self, time, X_WP=None, **values):
        self.fix("volume", volume(time, X_WP))
        for port in ("detection", "measurement"):
            self.fix(port, values.get(port, NotFound(f"no {port}")))
        self.filter.ExecuteForcedEvents(self.context)
        return self.estimate

    @property
    def estimate(self) -> NeedleEstimate:
        return self.filter.GetOutputPort("estimate").Eval(self.context)

    def track_from(self, time=0.0):
        """Detect and confirm a needle whose tip is at 30 mm."""
        self.step(time, detection=detection(3e-3, time))
        self.step(time + 0.3, detection=detection(6e-3, time + 0.3))
        return self.step(time + 0.6, measurement=measurement(time=time + 0.6))


def test_outputs_do_not_depend_on_inputs():
    assert not NeedleKalmanFilter(period=1.0).HasAnyDirectFeedthrough()


def test_detection_then_confirmation():
    bench = Bench()
    assert bench.estimate.mode == TrackingMode.SEARCHING
    estimate = bench.step(0.0, detection=detection(3e-3, 0.0))
    estimate = bench.step(0.3, detection=detection(6e-3, 0.3))
    assert (estimate.mode, bool(estimate)) == (TrackingMode.SEARCHING, False)
    estimate = bench.step(0.6, measurement=measurement(time=0.58))
    assert estimate.mode == TrackingMode.TRACKING
    assert (estimate.time, estimate.volume_time) == (0.58, 0.6)
    np.testing.assert_allclose(estimate.curve.tip, [0.03, 0, 0], atol=1e-3)


def test_unconfirmed_detection_is_forgotten():
    bench = Bench(volumes_to_confirm=2)
    bench.step(0.0, detection=detection(3e-3, 0.0))
    bench.step(0.3, detection=detection(6e-3, 0.3))
    for k in range(3):
        bench.step(0.6 + 0.3 * k)
    assert not bench.filter.GetOutputPort("prediction").Eval(bench.context)
    assert not bench.step(2.0, measurement=measurement(time=2.0))


def test_loss_ladder():
    bench = Bench(volumes_to_lose=3, seconds_to_give_up=2.0)
    bench.track_from()
    modes = [bench.step(0.9 + 0.3 * k).mode for k in range(8)]
    assert modes == ["coasting"] * 2 + ["lost"] * 4 + ["searching"] * 2
    assert bench.estimate.reason == "no detection"


def test_lost_needle_found_elsewhere_is_tracked_at_once():
    bench = Bench(volumes_to_lose=1)
    bench.track_from()
    assert bench.step(0.9).mode == TrackingMode.LOST
    estimate = bench.step(1.2, measurement=measurement(0.08, 1.2, y=0.04, entry=0.05))
    assert estimate.mode == TrackingMode.TRACKING
    np.testing.assert_allclose(estimate.curve.tip, [0.08, 0.04, 0])


def test_gate_rejects_once_and_believes_twice():
    bench = Bench()
    bench.track_from()
    estimate = bench.step(0.9, measurement=measurement(0.03, 0.9, y=0.02))
    assert estimate.mode == TrackingMode.COASTING
    assert "deviations from the prediction" in estimate.reason
    assert abs(estimate.curve.tip[1]) < 1e-3
    estimate = bench.step(1.2, measurement=measurement(0.03, 1.2, y=0.0201))
    assert estimate.mode == TrackingMode.TRACKING
    assert estimate.curve.tip[1] == pytest.approx(0.0201)


def test_without_filtering_each_measurement_is_the_estimate():
    bench = Bench(filtering=False)
    bench.track_from()
    for k, tip in enumerate((0.031, 0.05, 0.029)):
        estimate = bench.step(0.9 + 0.3 * k, measurement=measurement(tip, 0.9 + 0.3 * k))
        assert estimate.mode == TrackingMode.TRACKING
        assert estimate.curve.tip[0] == tip
        np.testing.assert_array_equal(estimate.velocity, 0)
    assert bench.step(2.1).curve.tip[0] == 0.029


def test_in_the_probe_s_frame_the_prediction_is_carried_along():
    turned = RigidTransform(RotationMatrix.MakeZRotation(0.3), [0.01, 0.02, 0.0])
    coasted = {}
    for probe_frame in (False, True):
        bench = Bench(probe_frame=probe_frame)
        bench.track_from()
        before = bench.estimate
        coasted[probe_frame] = bench.step(0.9, X_WP=turned)
    np.testing.assert_allclose(coasted[False].curve.tip, before.curve.tip, atol=1e-12)
    np.testing.assert_allclose(
        coasted[True].curve.tip, turned.multiply(before.curve.tip), atol=1e-12
    )
    R = np.kron(np.eye(4), turned.rotation().matrix())
    np.testing.assert_allclose(
        coasted[True].covariance, R @ coasted[False].covariance @ R.T, atol=1e-12
    )


def test_in_the_probe_s_frame_velocity_is_that_in_the_image():
    """A probe that keeps up with the needle sees it at rest."""
    velocity = {}
    for probe_frame in (False, True):
        bench = Bench(probe_frame=probe_frame)
        bench.track_from()
        for k in range(1, 30):
            x, time = 5e-3 * 0.3 * k, 0.6 + 0.3 * k
            seen = measurement(0.03 + x, time, entry=x)
            estimate = bench.step(time, X_WP=RigidTransform([x, 0, 0]), measurement=seen)
        velocity[probe_frame] = estimate.tip_velocity[0]
    assert velocity[False] == pytest.approx(5e-3, abs=1e-4)
    assert velocity[True] == pytest.approx(0, abs=1e-4)


def test_withdrawn_needle_is_awaited_again():
    bench = Bench()
    bench.track_from()
    for k in range(10):
        tip = 0.03 - 2.6e-3 * (k + 1)
        bench.step(0.9 + 0.3 * k, measurement=measurement(tip, 0.9 + 0.3 * k))
    estimate = bench.step(3.9)
    assert estimate.mode == TrackingMode.SEARCHING
    assert estimate.reason == "the needle was withdrawn"


def test_repeated_and_missing_volumes_change_nothing():
    bench = Bench()
    before = bench.track_from()
    for value in (volume(0.6), volume(0.1), NotFound("dropped")):
        bench.fix("volume", value)
        bench.fix("measurement", measurement(0.05, 0.9))
        bench.filter.ExecuteForcedEvents(bench.context)
        assert bench.estimate.time == before.time
        np.testing.assert_array_equal(bench.estimate.curve.tip, before.curve.tip)


def test_log_shows_what_was_used():
    bench = Bench()
    bench.track_from()
    used = bench.filter.GetOutputPort("last_measurement").Eval(bench.context)
    assert used.time == 0.6
    bench.fix("measurement", measurement(0.05, 9.0))
    assert bench.filter.GetOutputPort("last_measurement").Eval(bench.context) is used
    assert not bench.filter.GetOutputPort("last_detection").Eval(bench.context)


@pytest.mark.parametrize(
    ("field", "value"),
    [("gate", 1.0), ("order", 4), ("volumes_to_lose", 0), ("first_speed_std", -1.0)],
)
def test_parameters_are_checked(field, value):
    with pytest.raises(ValueError, match=field):
        NeedleKalmanFilterParameters(**{field: value})
