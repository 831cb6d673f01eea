"""Estimate of the needle by a tracker."""

import math
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.signals.immutable import Immutable, read_only
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
    """Estimate of the needle by a tracker; falsy while there is no curve.

    Parameters
    ----------
    mode
        Stage of tracking.
    time
        Time for which the estimate holds, in s.
    curve
        Curve of the needle in W, in m; None while searching.
    velocity
        (n, 3) velocities of the control points in W, in m/s; None while searching.
    covariance
        (6n, 6n) covariance of the stacked control points and their velocities; None while
        searching.
    volume_time
        Time of the newest volume seen, in s; -inf before the first one.
    reason
        Reason why the last volume did not confirm the needle; empty if it did.
    probability
        Probability that what is estimated is a needle; 0 while nothing is.
    X_WP
        Pose of the probe at the newest volume, if the tracker keeps the needle in the probe's frame
        and not in W; otherwise None.
    """

    mode: TrackingMode
    time: float
    curve: NeedleCurve | None = None
    velocity: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    volume_time: float = -np.inf
    reason: str = ""
    X_WP: RigidTransform | None = None
    probability: float = 0.0

    def __post_init__(self) -> None:
        if self.curve is None:
            return
        order = self.curve.order
        for name, shape in (("velocity", (order, 3)), ("covariance", (6 * order, 6 * order))):
            object.__setattr__(self, name, read_only(getattr(self, name), name, shape))

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
