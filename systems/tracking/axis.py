"""Axis of a needle: a polynomial over its projection on a line."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals.immutable import NotFound


@dataclass(frozen=True, eq=False)
class Axis:
    """Curve C(a) = sum of c_i a^i, with a = (v - origin) . k_0 in m (Chatelain 2013, eq. 16)."""

    origin: NDArray[np.float64]
    """(3,) position where a = 0, in m."""
    direction: NDArray[np.float64]
    """(3,) unit vector k_0."""
    coefficients: NDArray[np.float64]
    """(n, 3) coefficients c_i: c_0 in m, c_1 dimensionless, c_2 in 1/m."""

    @property
    def order(self) -> int:
        """Number n of coefficients."""
        return len(self.coefficients)

    def abscissa(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the (...) abscissae a of (..., 3) points in m: projections on the direction."""
        return (np.asarray(points) - self.origin) @ self.direction

    def position(self, a: ArrayLike) -> NDArray[np.float64]:
        """Return the (..., 3) positions in m at abscissae a in m."""
        a = np.asarray(a, dtype=float)
        powers = np.vander(a.ravel(), self.order, increasing=True)
        return (powers @ self.coefficients).reshape(*a.shape, 3)

    def distance(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return the (...) approximate distances of (..., 3) points from the curve in m (eq. 18).

        They are exact for a straight axis.
        """
        points = np.asarray(points)
        return np.linalg.norm(points - self.position(self.abscissa(points)), axis=-1)


def axis_through(
    points: NDArray[np.float64], along: NDArray[np.float64] | None = None
) -> Axis | NotFound:
    """Fit an axis of order n through (n, 3) points; ``along`` is by default from first to last."""
    along = points[-1] - points[0] if along is None else along
    length = float(np.linalg.norm(along))
    if not length > 0:
        return NotFound("the first and the last point coincide")
    direction = along / length
    a = (points - points[0]) @ direction
    if np.min(np.abs(np.diff(np.sort(a)))) <= 1e-9 * length:
        return NotFound("two points share an abscissa")
    coefficients = np.linalg.solve(np.vander(a, increasing=True), points - points[0])
    coefficients[0] += points[0]
    return Axis(points[0], direction, coefficients)
