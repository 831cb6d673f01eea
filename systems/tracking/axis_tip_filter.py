"""Kalman filter on a straight needle's direction, its tip and the tip's velocity."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated, ClassVar

import numpy as np
from filterpy.kalman import predict, update
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from scipy.spatial.transform import Rotation

from sonoservo.systems.signals.confidence import squared_distance
from sonoservo.systems.signals.immutable import Immutable, Matrix3, Shape, Vector3
from sonoservo.systems.signals.needle_curve import NeedleCurve
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    check_bounds,
    require,
)
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.tracking.needle_motion import NeedleMotionParameters, constant_velocity


@dataclass(frozen=True, eq=False)
class AxisTipState(Immutable):
    """State X = (alpha, beta, p_t, v_t) of Zhao 2012, eq. 6, with a unit vector for the angles.

    Alpha and beta wrap, and are singular at the pole. The direction's errors are therefore taken
    along two unit vectors across it. The entry is at rest, and follows from the needle's length.
    """

    time: float
    frame: Matrix3
    """Rotation matrix whose rows are two unit vectors across the needle and its direction k, in W.
    """
    tip: Vector3
    tip_velocity: Vector3
    length: float
    """Distance from the entry to the tip, in m."""
    P: Annotated[NDArray[np.float64], Shape(8, 8)]
    """Covariance of the direction's two deviations in rad, the tip and its velocity."""

    @property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit vector k from entry to tip."""
        return self.frame[2]

    @property
    def mean(self) -> NDArray[np.float64]:
        """(8,) mean of the state; its first two elements, the direction's deviations, are zero."""
        return np.concatenate([np.zeros(2), self.tip, self.tip_velocity])

    @property
    def curve(self) -> NeedleCurve:
        """Curve through entry and tip in W."""
        return NeedleCurve(np.stack([self.tip - self.length * self.direction, self.tip]))

    @property
    def velocity(self) -> NDArray[np.float64]:
        """(2, 3) velocities of entry and tip in W, in m/s; the entry is at rest."""
        return np.stack([np.zeros(3), self.tip_velocity])

    @property
    def covariance(self) -> NDArray[np.float64]:
        """(12, 12) covariance of entry, tip and their velocities."""
        J = np.zeros((12, 8))
        J[:3, :2] = -self.length * self.frame[:2].T
        J[:3, 2:5] = J[3:6, 2:5] = J[9:, 5:] = np.eye(3)
        return J @ self.P @ J.T

    def transformed(self, X: RigidTransform) -> "AxisTipState":
        """Return the state moved by a rigid transform, with its velocity rotated."""
        R = X.rotation().matrix()
        T = np.eye(8)
        T[2:5, 2:5] = T[5:, 5:] = R
        return replace(
            self,
            frame=self.frame @ R.T,
            tip=X.multiply(self.tip),
            tip_velocity=R @ self.tip_velocity,
            P=T @ self.P @ T.T,
        )


def direction_angles(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (..., 2) angles alpha and beta in rad of (..., 3) directions, for reports only.

    Zhao 2012 defines them only in its figure 1. Here alpha is the azimuth from the first axis
    towards the second, and beta the angle from the third axis.
    """
    x, y, z = np.moveaxis(np.asarray(direction, dtype=float), -1, 0)
    return np.stack([np.arctan2(y, x), np.arctan2(np.hypot(x, y), z)], axis=-1)


@dataclass(kw_only=True)
class AxisTipFilter:
    """Kalman filter on direction, tip and tip velocity of a straight needle (Zhao 2012, eqs. 1-7).

    A measurement is the axis with the tip, the tip's velocity, or both. The paper publishes no
    noise.

    Parameters
    ----------
    kind
        Name of the filter, always "axis_tip".
    motion
        Spectral densities of the tip's acceleration, along the needle and in every direction. The
        density of the bending is not used, as the needle is straight.
    turning
        Spectral density of the direction's rate, in rad^2/s.
    first_speed_std, first_drift_std
        Standard deviations of the tip's velocity along the needle and in every direction, at the
        start of a track, in m/s.
    velocity_gate
        Probability that a true velocity passes the gate on its innovation.
    """

    orders: ClassVar[tuple[int, ...]] = (2,)

    kind: str = "axis_tip"
    motion: NeedleMotionParameters = field(default_factory=NeedleMotionParameters)
    turning: NotNegative = 2e-4
    first_speed_std: Positive = 4e-3
    first_drift_std: Positive = 2e-3
    velocity_gate: float = 0.999

    def __post_init__(self) -> None:
        require(self.kind == "axis_tip", "kind", self.kind, '"axis_tip"')
        check_bounds(self)
        gate = self.velocity_gate
        require(0 < gate < 1, "velocity_gate", gate, "between 0 and 1")

    def start(self, measurement: NeedleMeasurement) -> AxisTipState:
        """Return the state after a first measurement, with an unknown velocity."""
        curve = measurement.curve
        require(curve.order == 2, "curve.order", curve.order, "2: the needle is straight")
        k = curve.direction
        frame = np.vstack([np.linalg.svd(k[np.newaxis])[2][1:], k])
        frame[0] *= np.sign(np.linalg.det(frame))
        P = np.zeros((8, 8))
        P[:5, :5] = _axis_and_tip(frame, measurement)[1]
        P[5:, 5:] = self.first_drift_std**2 * np.eye(3) + self.first_speed_std**2 * np.outer(k, k)
        length = float((curve.tip - curve.entry) @ k)
        return AxisTipState(measurement.time, frame, curve.tip, np.zeros(3), length, P)

    def predict(self, state: AxisTipState, time: float) -> AxisTipState:
        """Return the state at a later time in s (eqs. 6 and 7); an earlier time changes nothing.

        The right-hand sides of the equations belong to the previous step.
        """
        dt = time - state.time
        if dt <= 0:
            return state
        k = state.direction
        density = self.motion.insertion * np.outer(k, k) + self.motion.body * np.eye(3)
        A, Q = np.eye(8), self.turning * dt * np.eye(8)
        A[2:, 2:], Q[2:, 2:] = constant_velocity(dt, density)
        mean, P = predict(state.mean, state.P, A, Q)
        return _moved(state, replace(state, time=time, tip=mean[2:5], tip_velocity=mean[5:], P=P))

    def update(
        self,
        state: AxisTipState,
        measurement: NeedleMeasurement | None,
        velocity: VelocityMeasurement | None,
    ) -> AxisTipState:
        """Return the state corrected by the measured axis and tip, the velocity, both or neither.

        H consists of the rows of the published I_8 that were measured. A velocity that fails its
        gate is ignored.
        """
        z: list[NDArray[np.float64]] = []
        R = np.zeros((8, 8))
        if measurement is not None:
            points = state.curve.control_points.ravel()
            measurement = measurement.given(points, state.covariance[:6, :6])
            values, R[:5, :5] = _axis_and_tip(state.frame, measurement)
            z.append(values)
        believed = velocity is not None and self._believes(state, velocity)
        if velocity is not None and believed:
            z.append(velocity.velocity)
            R[5:, 5:] = velocity.covariance
        if not z:
            return state
        rows = np.repeat([measurement is not None, believed], [5, 3])
        mean, P = update(
            state.mean, state.P, np.concatenate(z), R[np.ix_(rows, rows)], np.eye(8)[rows]
        )
        # The frame turns by the shortest rotation, which keeps P valid in the new frame.
        turn = np.cross(state.direction, mean[:2] @ state.frame[:2])
        frame = state.frame @ Rotation.from_rotvec(turn).as_matrix().T
        updated = replace(
            state, frame=frame, tip=mean[2:5], tip_velocity=mean[5:], P=0.5 * (P + P.T)
        )
        return _moved(state, updated)

    def _believes(self, state: AxisTipState, measured: VelocityMeasurement) -> bool:
        innovation = measured.velocity - state.tip_velocity
        S = state.P[5:, 5:] + measured.covariance
        return float(innovation @ np.linalg.solve(S, innovation)) <= _gate(self.velocity_gate)


@lru_cache
def _gate(probability: float) -> float:
    return squared_distance(probability, 3)


def _moved(before: AxisTipState, after: AxisTipState) -> AxisTipState:
    """Return the state after a step, with the entry at the same place along the needle."""
    return replace(after, length=float((after.tip - before.curve.entry) @ after.direction))


def _axis_and_tip(
    frame: NDArray[np.float64], measurement: NeedleMeasurement
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the (5,) measured deviations of the direction and tip, and their (5, 5) covariance."""
    curve, across = measurement.curve, frame[:2]
    # A measured axis may have either sense. The one closer to the state's direction is taken.
    sense = 1.0 if curve.direction @ frame[2] >= 0 else -1.0
    k = sense * curve.direction
    aside = across @ k
    sine = float(np.linalg.norm(aside))
    angle = np.arctan2(sine, k @ frame[2])
    deviation = aside * (angle / sine if sine > 0 else 1.0)
    J = np.zeros((5, 6))
    J[:2, 3:] = sense * across / curve.chord
    J[:2, :3] = -J[:2, 3:]
    J[2:, 3:] = np.eye(3)
    return np.concatenate([deviation, curve.tip]), J @ measurement.covariance @ J.T
