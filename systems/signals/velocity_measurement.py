"""Velocity of the needle's tip, measured between two volumes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only


@dataclass(frozen=True, eq=False)
class VelocityMeasurement(Immutable):
    """Measured velocity of the tip. If there is none, a `NotFound` takes its place.

    Parameters
    ----------
    velocity
        (3,) mean velocity between the two volumes in W, in m/s.
    covariance
        (3, 3) covariance of the velocity, in m^2/s^2.
    correlation
        Correlation coefficient of the best match, from 0 to 1, as a measure of confidence.
    """

    velocity: NDArray[np.float64]
    covariance: NDArray[np.float64]
    correlation: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity", read_only(self.velocity, "velocity", (3,)))
        object.__setattr__(self, "covariance", read_only(self.covariance, "covariance", (3, 3)))
