"""The eight states of a straight needle: its direction, its tip and the tip's velocity."""

from dataclasses import dataclass, replace

import numpy as np
from filterpy.kalman import predict, update
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sonoservo.systems.estimation.track import NeedleMotionParameters, constant_velocity
from sonoservo.systems.signals.immutable import Immutable, read_only
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement


@dataclass(frozen=True, eq=False)
class AxisTipState(Immutable):
    """X = (alpha, beta, p_t, v_t) of Zhao 2012, eq. 6, free of the angles' poles.

    The angles are replaced by a unit vector, and their errors by those along two unit vectors
    across it: alpha and beta are singular where the needle points along their pole, and wrap.

    Parameters
    ----------
    frame
        (3, 3) rotation: its rows are two unit vectors across the needle and the needle's direction
        k from entry to tip, in W.
    tip, velocity
        (3,) p_t in m and v_t in m/s, in W.
    covariance
        (8, 8) P of the direction's two deviations in rad, the tip and the velocity.
    """

    frame: NDArray[np.float64]
    tip: NDArray[np.float64]
    velocity: NDArray[np.float64]
    covariance: NDArray[np.float64]

    def __post_init__(self) -> None:
        for name, shape in (
            ("frame", (3, 3)), ("tip", (3,)), ("velocity", (3,)), ("covariance", (8, 8))
        ):  # fmt: skip
            object.__setattr__(self, name, read_only(getattr(self, name), name, shape))

    @property
    def direction(self) -> NDArray[np.float64]:
        """(3,) unit vector k from entry to tip."""
        return self.frame[2]

    @property
    def mean(self) -> NDArray[np.float64]:
        """(8,) state; the direction does not deviate from itself."""
        return np.concatenate([np.zeros(2), self.tip, self.velocity])


def direction_angles(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Angles (..., 2) alpha and beta in rad of (..., 3) directions: for reports only.

    The paper's figure 1 does not define them in words. Here alpha is the azimuth from the first
    axis towards the second, beta the angle from the third one.
    """
    x, y, z = np.moveaxis(np.asarray(direction, dtype=float), -1, 0)
    return np.stack([np.arctan2(y, x), np.arctan2(np.hypot(x, y), z)], axis=-1)


def start_axis_tip(
    measurement: NeedleMeasurement, first_speed_std: float, first_drift_std: float
) -> AxisTipState:
    """Start at a measurement, with a velocity that is not known.

    Parameters
    ----------
    measurement
        Of a straight needle.
    first_speed_std, first_drift_std
        Standard deviations of the tip's velocity along the needle and in every direction, in m/s.
    """
    k = measurement.curve.direction
    frame = np.vstack([np.linalg.svd(k[np.newaxis])[2][1:], k])
    frame[0] *= np.sign(np.linalg.det(frame))
    P = np.zeros((8, 8))
    P[:5, :5] = _axis_and_tip(frame, measurement)[1]
    P[5:, 5:] = first_drift_std**2 * np.eye(3) + first_speed_std**2 * np.outer(k, k)
    return AxisTipState(frame, measurement.curve.tip, np.zeros(3), P)


def predict_axis_tip(
    state: AxisTipState, dt: float, motion: NeedleMotionParameters, turning: float
) -> AxisTipState:
    """Predict (Zhao 2012, eqs. 6 and 7, whose right-hand sides belong to the step before).

    Parameters
    ----------
    state
        Now.
    dt
        Time step in s.
    motion
        Spectral densities of the tip's acceleration.
    turning
        Spectral density of the direction's rate, in rad^2/s.
    """
    k = state.direction
    density = motion.insertion * np.outer(k, k) + motion.body * np.eye(3)
    A, Q = np.eye(8), turning * dt * np.eye(8)
    A[2:, 2:], Q[2:, 2:] = constant_velocity(dt, density)
    mean, covariance = predict(state.mean, state.covariance, A, Q)
    return replace(state, tip=mean[2:5], velocity=mean[5:], covariance=covariance)


def update_axis_tip(
    state: AxisTipState,
    measurement: NeedleMeasurement | None,
    velocity: VelocityMeasurement | None,
) -> AxisTipState:
    """Update with what has been measured: axis and tip, the velocity, both, or neither.

    H is the rows of the published I_8 that were measured.
    """
    z: list[NDArray[np.float64]] = []
    R = np.zeros((8, 8))
    if measurement is not None:
        values, R[:5, :5] = _axis_and_tip(state.frame, measurement)
        z.append(values)
    if velocity is not None:
        z.append(velocity.velocity)
        R[5:, 5:] = velocity.covariance
    if not z:
        return state
    measured = np.repeat([measurement is not None, velocity is not None], [5, 3])
    mean, P = update(
        state.mean,
        state.covariance,
        np.concatenate(z),
        R[np.ix_(measured, measured)],
        np.eye(8)[measured],
    )
    # The frame turns along the shortest way, so that P means the same in the new one.
    turn = np.cross(state.direction, mean[:2] @ state.frame[:2])
    frame = state.frame @ Rotation.from_rotvec(turn).as_matrix().T
    return AxisTipState(frame, mean[2:5], mean[5:], 0.5 * (P + P.T))


def _axis_and_tip(
    frame: NDArray[np.float64], measurement: NeedleMeasurement
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(5,) deviations of a measured direction and tip, and their (5, 5) covariance."""
    curve, across = measurement.curve, frame[:2]
    # An axis has no sense: it is taken as the one that it nearly has already.
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
