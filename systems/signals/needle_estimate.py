"""Estimate of the needle by a tracker."""

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.needle_curve import NeedleCurve


class TrackingMode(StrEnum):
    """Stages of tracking."""

    SEARCHING = "searching"
    """The tracker waits for an insertion."""
    TRACKING = "tracking"
    """The last volume confirmed the needle."""
    COASTING = "coasting"
    """The last volumes did not confirm the needle, and the estimate is the prediction."""
    LOST = "lost"
    """The tracker searches the whole volume for the needle."""


@dataclass(frozen=True, eq=False)
class NeedleEstimate(Immutable):
    """Estimate of the needle by a tracker; falsy while there is no curve."""

    mode: TrackingMode
    """Stage of tracking."""

    time: float
    """Time for which the estimate holds, in s."""

    curve: NeedleCurve | None = None
    """Curve of the needle in W, in m; None, as the next two, while searching."""

    velocity: Annotated[NDArray[np.float64], Shape("n", 3)] | None = None
    """Velocities of the n control points in W, in m/s."""

    covariance: Annotated[NDArray[np.float64], Shape("6n", "6n")] | None = None
    """Covariance of the stacked control points and their velocities."""

    volume_time: float = -np.inf
    """Time of the newest volume seen, in s; -inf before the first one."""

    reason: str = ""
    """Reason why the last volume did not confirm the needle; empty if it did."""

    X_WP: RigidTransform | None = None
    """Pose of the probe at the newest volume, if the tracker keeps the needle in the probe's frame
    and not in W."""

    probability: float = 0.0
    """Probability that what is estimated is a needle; 0 while nothing is."""

    def _extents(self) -> dict[str, int]:
        return {"n": self.curve.order} if self.curve else {}

    def __bool__(self) -> bool:
        return self.curve is not None

    @property
    def tip_velocity(self) -> NDArray[np.float64]:
        """(3,) velocity of the tip in W, in m/s; requires a curve."""
        assert self.velocity is not None
        return self.velocity[-1]

    @property
    def tip_covariance(self) -> NDArray[np.float64]:
        """(3, 3) covariance of the tip in W, in m^2; requires a curve."""
        assert self.curve is not None
        assert self.covariance is not None
        tip = slice(3 * self.curve.order - 3, 3 * self.curve.order)
        return self.covariance[tip, tip]

    @cached_property
    def tip_std(self) -> float:
        """Standard deviation of the tip in m, the root of its covariance's trace."""
        return math.sqrt(self.tip_covariance.trace())

    @property
    def tip_velocity_covariance(self) -> NDArray[np.float64]:
        """(3, 3) covariance of the velocity of the tip in W, in m^2/s^2; requires a curve."""
        assert self.covariance is not None
        return self.covariance[-3:, -3:]

    @property
    def direction_covariance(self) -> NDArray[np.float64]:
        """(3, 3) covariance of the unit vector from entry to tip in W, of rank 2."""
        assert self.curve is not None
        assert self.covariance is not None
        n = 3 * self.curve.order
        chord = self.curve.tip - self.curve.entry
        length = np.linalg.norm(chord)
        across = (np.eye(3) - np.outer(chord, chord) / length**2) / length
        J = np.hstack([-across, across])
        ends = np.r_[0:3, n - 3 : n]
        covariance: NDArray[np.float64] = J @ self.covariance[np.ix_(ends, ends)] @ J.T
        return covariance
