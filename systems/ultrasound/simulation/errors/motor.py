"""Errors of the motor that sweeps the array."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import (
    Bounded,
    NotNegative,
)
from sonoservo.systems.signals.sweep import SweepGeometry


@dataclass(kw_only=True)
class MotorParameters(Bounded):
    """Differences between the angle at which a frame is acquired and the angle it is shown at.

    Parameters
    ----------
    backlash_deg
        Play of the sweeping motor's gear, by which sweeps to and fro differ, in deg.
    error_deg
        Standard deviation of the sweeping motor's angle at each frame, in deg.
    """

    backlash_deg: NotNegative = 0.0
    error_deg: NotNegative = 0.0


def motor_error(
    parameters: MotorParameters, frames: int, direction: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return the angles in rad by which the array is ahead towards +Z of where its motor says.

    The array lags behind its motor by half of the play.

    Parameters
    ----------
    parameters
        Errors of the motor.
    frames
        Number of frames of the sweep; the motor of a single frame does not move.
    direction
        +1 for a sweep towards +Z, -1 towards -Z.
    rng
        Source of the random errors.

    Returns
    -------
    (frames,) angles.
    """
    if frames == 1:
        return np.zeros(1)
    lag = -0.5 * direction * parameters.backlash_deg
    return np.deg2rad(lag + parameters.error_deg * rng.standard_normal(frames))


def turned(
    X_TP: NDArray[np.float64], angles: NDArray[np.float64], geometry: SweepGeometry
) -> NDArray[np.float64]:
    """Return (frames, 4, 4) poses of a probe turned about its motor's axis.

    A frame acquired from such a pose is the one that the motor's error makes of it.

    Parameters
    ----------
    X_TP
        (frames, 4, 4) poses of the probe.
    angles
        (frames,) angles in rad, positive towards +Z.
    geometry
        Geometry of the sweep, which has the motor's axis.
    """
    turn = np.tile(np.eye(4), (len(angles), 1, 1))
    turn[:, 1, 1] = turn[:, 2, 2] = cosine = np.cos(angles)
    turn[:, 2, 1] = sine = np.sin(angles)
    turn[:, 1, 2] = -sine
    turn[:, 1, 3] = geometry.motor_radius * (cosine - 1)
    turn[:, 2, 3] = geometry.motor_radius * sine
    return np.asarray(X_TP @ turn)
