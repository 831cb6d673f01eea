"""Kalman filter on the needle's control points and their velocities."""

from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar

import numpy as np
from filterpy.kalman import predict, update
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.requirements import Positive, check_bounds, require
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.needle_motion import NeedleMotionParameters, constant_velocity


@dataclass(frozen=True, eq=False)
class ControlPointState(Immutable):
    """State X = (p_1 ... p_n, their velocities) in W, in m and m/s (Chatelain 2013, eq. 3)."""

    time: float
    mean: Annotated[NDArray[np.float64], Shape("n")]
    covariance: Annotated[NDArray[np.float64], Shape("n", "n")]

    @property
    def curve(self) -> NeedleCurve:
        """Curve of the control points in W."""
        return NeedleCurve(self.mean[: len(self.mean) // 2].reshape(-1, 3))

    @property
    def velocity(self) -> NDArray[np.float64]:
        """(n, 3) velocities of the control points in W, in m/s."""
        return self.mean[len(self.mean) // 2 :].reshape(-1, 3)

    def transformed(self, X: RigidTransform) -> "ControlPointState":
        """Return the state moved by a rigid transform, with its velocities rotated."""
        n = len(self.mean) // 6
        R = np.kron(np.eye(2 * n), X.rotation().matrix())
        mean = R @ self.mean
        mean[: 3 * n] += np.tile(X.translation(), n)
        return replace(self, mean=mean, covariance=R @ self.covariance @ R.T)


@dataclass(kw_only=True)
class ControlPointFilter:
    """Kalman filter on control points that move at constant velocity (Chatelain 2013, eqs. 3-14).

    The state is kept in W, whereas the paper keeps it in the probe's frame. A measured velocity is
    not used. The paper publishes no values.

    Parameters
    ----------
    kind
        Name of the filter, always "control_points".
    motion
        Spectral densities of the needle's acceleration, which give Q.
    first_speed_std, first_drift_std
        Standard deviations of the tip's velocity along the needle, and of every point's velocity in
        every direction, at the start of a track, in m/s.
    """

    orders: ClassVar[tuple[int, ...]] = (2, 3)

    kind: str = "control_points"
    motion: NeedleMotionParameters = field(default_factory=NeedleMotionParameters)
    first_speed_std: Positive = 4e-3
    first_drift_std: Positive = 2e-3

    def __post_init__(self) -> None:
        require(self.kind == "control_points", "kind", self.kind, '"control_points"')
        check_bounds(self)

    def start(self, measurement: NeedleMeasurement) -> ControlPointState:
        """Return the state after a first measurement, with an unknown velocity."""
        curve = measurement.curve
        size = 3 * curve.order
        u, k = np.linspace(0, 1, curve.order), curve.direction
        P = np.zeros((2 * size, 2 * size))
        P[:size, :size] = measurement.covariance
        P[size:, size:] = self.first_drift_std**2 * np.eye(size) + self.first_speed_std**2 * (
            np.kron(np.outer(u, u), np.outer(k, k))
        )
        mean = np.concatenate([curve.control_points.ravel(), np.zeros(size)])
        return ControlPointState(measurement.time, mean, P)

    def predict(self, state: ControlPointState, time: float) -> ControlPointState:
        """Return the state at a later time in s (eqs. 10, 11); an earlier time changes nothing."""
        dt = time - state.time
        if dt <= 0:
            return state
        A, Q = constant_velocity(dt, self.motion.density(state.curve))
        mean, covariance = predict(state.mean, state.covariance, A, Q)
        return ControlPointState(time, mean, covariance)

    def update(
        self,
        state: ControlPointState,
        measurement: NeedleMeasurement | None,
        velocity: VelocityMeasurement | None,
    ) -> ControlPointState:
        """Return the state corrected by the measured control points (eqs. 12 to 14)."""
        if measurement is None:
            return state
        size = len(state.mean) // 2
        measurement = measurement.given(state.mean[:size], state.covariance[:size, :size])
        z = measurement.curve.control_points.ravel()
        C = np.eye(len(z), len(state.mean))
        mean, P = update(state.mean, state.covariance, z, measurement.covariance, C)
        return replace(state, mean=mean, covariance=0.5 * (P + P.T))
