"""Velocity of the needle's tip, measured between two volumes."""

from dataclasses import dataclass

from sonoservo.systems.signals.immutable import Immutable, Matrix3, Vector3


@dataclass(frozen=True, eq=False)
class VelocityMeasurement(Immutable):
    """Measured velocity of the tip. If there is none, a `NotFound` takes its place."""

    velocity: Vector3
    """Mean velocity between the two volumes in W, in m/s."""

    covariance: Matrix3
    """Covariance of the velocity, in m^2/s^2."""

    correlation: float
    """Correlation coefficient of the best match, from 0 to 1, as a measure of confidence."""
