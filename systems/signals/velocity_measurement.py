"""Velocity of the needle's tip, measured between two volumes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, read_only


@dataclass(frozen=True, eq=False)
class VelocityMeasurement(Immutable):
    """The tip's velocity. Where it was not found, a `NotFound` takes its place.

    Parameters
    ----------
    velocity
        (3,) in W, in m/s: the mean between the two volumes.
    covariance
        (3, 3) in m^2/s^2.
    correlation
        Coefficient of the best match, from 0 to 1: how much to trust it.
    """

    velocity: NDArray[np.float64]
    covariance: NDArray[np.float64]
    correlation: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "velocity", read_only(self.velocity, "velocity", (3,)))
        object.__setattr__(self, "covariance", read_only(self.covariance, "covariance", (3, 3)))
