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
    """Return (frames,) angles in rad by which the array is ahead towards +Z of its motor.

    It lags behind by half of the play; the motor of a single frame does not move.
    """
    if frames == 1:
        return np.zeros(1)
    lag = -0.5 * direction * parameters.backlash_deg
    return np.deg2rad(lag + parameters.error_deg * rng.standard_normal(frames))


def turned(
    X_TP: NDArray[np.float64], angles: NDArray[np.float64], geometry: SweepGeometry
) -> NDArray[np.float64]:
    """Return (frames, 4, 4) poses of a probe turned about its motor's axis, in rad towards +Z.

    A frame acquired from such a pose is the one that the motor's error makes of it.
    """
    turn = np.tile(np.eye(4), (len(angles), 1, 1))
    turn[:, 1, 1] = turn[:, 2, 2] = cosine = np.cos(angles)
    turn[:, 2, 1] = sine = np.sin(angles)
    turn[:, 1, 2] = -sine
    turn[:, 1, 3] = geometry.motor_radius * (cosine - 1)
    turn[:, 2, 3] = geometry.motor_radius * sine
    return np.asarray(X_TP @ turn)
